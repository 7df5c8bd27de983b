//! [`SpectralFilter`]: filters other than the box, as factors on the Fourier modes of a periodic box.
//!
//! Each kernel is the one whose second moment on the grid is that of the box of the same width,
//! (w² - 1) h²/12 along an axis for w cells of edge h; for w = 1 all of them do nothing. With
//! c = (w² - 1)/24 and the symbol of the discrete Laplacian, s = 2 - 2 cos(2π m/n) for mode m of n:
//!
//! - Gaussian: Π exp(-c s), whose kernel e^-2c I_j(2c) is positive and its own composition
//!   (the discrete Gaussian of Lindeberg 1990);
//! - diffusion: 1 / (1 + Σ c s), the implicit step q̄ - Σ c h² ∂²q̄ = q, positive too;
//! - spectrally sharp: 1 where |m| ≤ n/(2 w) along each axis, else 0. It has no second moment; its
//!   cut-off π/Δ is that of a grid as coarse as the filter is wide. It is not positive: filtered
//!   fractions below zero occur, and Favre velocities are large where they are small.
//!
//! A width costs one inverse transform, whatever it is.

use std::f64::consts::TAU;
use std::sync::Arc;

use realfft::num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};

/// A filter kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Kernel {
    /// The mean over a box.
    #[default]
    Box,
    /// A discrete Gaussian.
    Gaussian,
    /// One implicit step of diffusion.
    Diffusion,
    /// A spectrally sharp cut-off.
    Sharp,
}

impl Kernel {
    /// All kernels, in the order of their numbers.
    pub const ALL: [Self; 4] = [Self::Box, Self::Gaussian, Self::Diffusion, Self::Sharp];

    /// Name in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Box => "box",
            Self::Gaussian => "gaussian",
            Self::Diffusion => "diffusion",
            Self::Sharp => "sharp",
        }
    }
}

/// Filters of several widths on one periodic grid.
#[derive(Clone)]
pub struct SpectralFilter<const D: usize> {
    cells: [usize; D],
    /// Factors of the modes, 1/N of the transform included, one list per width.
    factors: Vec<Vec<f64>>,
    forward: Arc<dyn RealToComplex<f64>>,
    backward: Arc<dyn ComplexToReal<f64>>,
    /// Forward and backward along the other axes.
    across: Vec<[Arc<dyn Fft<f64>>; 2]>,
}

impl<const D: usize> std::fmt::Debug for SpectralFilter<D> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SpectralFilter").field("cells", &self.cells).finish_non_exhaustive()
    }
}

/// Memory for one transform.
pub struct SpectralScratch {
    modes: Vec<Complex64>,
    filtered: Vec<Complex64>,
    line: Vec<Complex64>,
    row: Vec<f64>,
}

impl<const D: usize> SpectralFilter<D> {
    /// Filters of `widths` cells along each axis, not below one, with `kernel`, which is not the box.
    pub fn new(kernel: Kernel, cells: [usize; D], widths: &[[f64; D]]) -> Self {
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        let across = cells[1..]
            .iter()
            .map(|&n| [complex.plan_fft_forward(n), complex.plan_fft_inverse(n)])
            .collect();
        let factors = widths.iter().map(|&width| factors(kernel, cells, width)).collect();
        let (forward, backward) =
            (real.plan_fft_forward(cells[0]), real.plan_fft_inverse(cells[0]));
        Self { cells, factors, forward, backward, across }
    }

    /// Memory for [`filter`](Self::filter).
    pub fn scratch(&self) -> SpectralScratch {
        let zeros = |len: usize| vec![Complex64::default(); len];
        let modes = modes(self.cells).into_iter().product();
        let longest = self.cells.iter().max().copied().unwrap_or(0);
        SpectralScratch {
            modes: zeros(modes),
            filtered: zeros(modes),
            line: zeros(longest),
            row: vec![0.0; self.cells[0]],
        }
    }

    /// Filters `field`, and hands the result of each width, by its number, to `take`.
    ///
    /// # Panics
    /// If `field` has not one number per cell.
    pub fn filter(
        &self,
        field: &[f64],
        scratch: &mut SpectralScratch,
        mut take: impl FnMut(usize, &[f64]),
    ) {
        let n = self.cells[0];
        assert_eq!(field.len(), self.cells.iter().product::<usize>(), "one number per cell");
        let width = modes(self.cells)[0];
        for (row, modes) in field.chunks_exact(n).zip(scratch.modes.chunks_exact_mut(width)) {
            scratch.row.copy_from_slice(row);
            // Fails for a row or modes of another length only.
            let done = self.forward.process(&mut scratch.row, modes);
            debug_assert!(done.is_ok());
        }
        self.across(0, &mut scratch.modes, &mut scratch.line);
        let mut out = vec![0.0; field.len()];
        for (number, factors) in self.factors.iter().enumerate() {
            for ((filtered, mode), factor) in
                scratch.filtered.iter_mut().zip(&scratch.modes).zip(factors)
            {
                *filtered = mode * factor;
            }
            self.across(1, &mut scratch.filtered, &mut scratch.line);
            let rows = scratch.filtered.chunks_exact_mut(width);
            for (modes, row) in rows.zip(out.chunks_exact_mut(n)) {
                // The mean and, of an even number, the shortest wave of a real row are real; round-off
                // of the other axes may say otherwise.
                modes[0].im = 0.0;
                if n.is_multiple_of(2) {
                    modes[width - 1].im = 0.0;
                }
                let done = self.backward.process(modes, row);
                debug_assert!(done.is_ok());
            }
            take(number, &out);
        }
    }

    /// Transforms along all axes but the first, `way` 0 forward and 1 backward.
    fn across(&self, way: usize, modes: &mut [Complex64], line: &mut [Complex64]) {
        let mut stride = modes_of(self.cells[0]);
        for (axis, plans) in self.across.iter().enumerate() {
            let n = self.cells[axis + 1];
            let line = &mut line[..n];
            for block in modes.chunks_exact_mut(stride * n) {
                for start in 0..stride {
                    for (j, value) in line.iter_mut().enumerate() {
                        *value = block[start + j * stride];
                    }
                    plans[way].process(line);
                    for (j, value) in line.iter().enumerate() {
                        block[start + j * stride] = *value;
                    }
                }
            }
            stride *= n;
        }
    }
}

/// Modes of a real row of `n` numbers.
fn modes_of(n: usize) -> usize {
    n / 2 + 1
}

/// Modes along each axis.
fn modes<const D: usize>(cells: [usize; D]) -> [usize; D] {
    let mut modes = cells;
    modes[0] = modes_of(cells[0]);
    modes
}

/// The factors of all modes, and 1/N.
fn factors<const D: usize>(kernel: Kernel, cells: [usize; D], width: [f64; D]) -> Vec<f64> {
    let shape = modes(cells);
    let per_cell = 1.0 / cells.iter().product::<usize>() as f64;
    let factor = |mut mode: usize| {
        let (mut spread, mut kept) = (0.0, true);
        for axis in 0..D {
            let (m, n, w) = (mode % shape[axis], cells[axis], width[axis]);
            mode /= shape[axis];
            let symbol = 2.0 - 2.0 * (TAU * m as f64 / n as f64).cos();
            spread += (w * w - 1.0) / 24.0 * symbol;
            // Modes beyond the middle are those of negative wave number.
            kept &= 2.0 * w * m.min(n - m) as f64 <= n as f64 * (1.0 + 1e-9);
        }
        per_cell
            * match kernel {
                Kernel::Box => 1.0,
                Kernel::Gaussian => f64::exp(-spread),
                Kernel::Diffusion => 1.0 / (1.0 + spread),
                Kernel::Sharp => f64::from(u8::from(kept)),
            }
    };
    (0..shape.iter().product()).map(factor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    const KERNELS: [Kernel; 3] = [Kernel::Gaussian, Kernel::Diffusion, Kernel::Sharp];

    fn random_field(len: usize, seed: u64) -> Vec<f64> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        (0..len).map(|_| random.random::<f64>() - 0.3).collect()
    }

    fn filtered<const D: usize>(
        kernel: Kernel,
        cells: [usize; D],
        width: [f64; D],
        field: &[f64],
    ) -> Vec<f64> {
        let filter = SpectralFilter::new(kernel, cells, &[width]);
        let mut found = Vec::new();
        filter.filter(field, &mut filter.scratch(), |_, out| found = out.to_vec());
        found
    }

    fn dot(a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    fn near(a: &[f64], b: &[f64], within: f64) {
        for (a, b) in a.iter().zip(b) {
            assert!((a - b).abs() < within, "{a} {b}");
        }
    }

    /// The discrete convolution with a Gaussian along each axis, or the residual of the implicit
    /// step, from their definitions.
    fn check<const D: usize>(cells: [usize; D], width: [f64; D], seed: u64) {
        let len: usize = cells.iter().product();
        let (field, other) = (random_field(len, seed), random_field(len, seed ^ 99));
        let mean = field.iter().sum::<f64>() / len as f64;
        for kernel in KERNELS {
            let found = filtered(kernel, cells, width, &field);
            // The mean is kept, a constant is untouched, <a, Fb> = <Fa, b>.
            assert!((found.iter().sum::<f64>() / len as f64 - mean).abs() < 1e-13);
            near(&filtered(kernel, cells, width, &vec![0.7; len]), &vec![0.7; len], 1e-14);
            let adjoint = dot(&field, &filtered(kernel, cells, width, &other));
            assert!((dot(&found, &other) - adjoint).abs() < 1e-12 * len as f64);
            near(&filtered(kernel, cells, [1.0; D], &field), &field, 1e-14);
        }
        let strides: [usize; D] = std::array::from_fn(|axis| cells[..axis].iter().product());
        let neighbours = |cell: usize, axis: usize| {
            let (n, stride) = (cells[axis], strides[axis]);
            let here = cell / stride % n;
            [(here + n - 1) % n, (here + 1) % n].map(|to| cell - here * stride + to * stride)
        };
        let laplacian = |q: &[f64], cell: usize| -> f64 {
            (0..D)
                .map(|axis| {
                    let c = (width[axis] * width[axis] - 1.0) / 24.0;
                    let sum: f64 = neighbours(cell, axis).iter().map(|&to| q[to] - q[cell]).sum();
                    c * sum
                })
                .sum()
        };
        let found = filtered(Kernel::Diffusion, cells, width, &field);
        let back: Vec<f64> = (0..len).map(|cell| found[cell] - laplacian(&found, cell)).collect();
        near(&back, &field, 1e-12);
        // The Gaussian is the exponential of the same operator: many small explicit steps.
        let mut stepped = field.clone();
        let steps = 4000;
        for _ in 0..steps {
            let change: Vec<f64> = (0..len).map(|cell| laplacian(&stepped, cell)).collect();
            stepped.iter_mut().zip(change).for_each(|(q, change)| *q += change / f64::from(steps));
        }
        near(&filtered(Kernel::Gaussian, cells, width, &field), &stepped, 3e-3);
        // What is sharp is so once and for all.
        let sharp = filtered(Kernel::Sharp, cells, width, &field);
        near(&filtered(Kernel::Sharp, cells, width, &sharp), &sharp, 1e-13);
        let rest: Vec<f64> = field.iter().zip(&sharp).map(|(field, sharp)| field - sharp).collect();
        assert!(dot(&rest, &sharp).abs() < 1e-12 * len as f64);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn kernels_keep_their_identities(
            nx in 2usize..12, ny in 2usize..12, w in 1.0..5.0, v in 1.0..5.0, seed: u64,
        ) {
            check([nx, ny], [w, v], seed);
        }

        #[test]
        fn kernels_keep_their_identities_in_three_dimensions(
            nx in 2usize..6, ny in 2usize..6, nz in 2usize..6, w in 1.0..3.0, seed: u64,
        ) {
            check([nx, ny, nz], [w, 1.5, 2.0], seed);
        }
    }

    /// Second moment of the kernel along the first axis, from the response to a single cell.
    fn second_moment(kernel: Kernel, width: f64) -> f64 {
        let mut peak = vec![0.0; 256];
        peak[128] = 1.0;
        let found = filtered(kernel, [128, 2], [width, 1.0], &peak);
        // The peak is at cell 0 of the second row.
        found.iter().enumerate().fold(0.0, |sum, (cell, q)| {
            let x = (cell % 128) as f64;
            let distance = if x < 64.0 { x } else { x - 128.0 };
            sum + q * distance * distance
        })
    }

    #[test]
    fn second_moments_are_those_of_the_box() {
        for width in [1.0, 2.0, 3.0, 6.0, 8.0] {
            // Of w cells at unit distance.
            let cells: Vec<f64> = (0..width as usize).map(|i| i as f64).collect();
            let mean = cells.iter().sum::<f64>() / width;
            let moment = cells.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / width;
            for kernel in [Kernel::Gaussian, Kernel::Diffusion] {
                let found = second_moment(kernel, width);
                assert!((found - moment).abs() < 1e-9, "{kernel:?} {width}: {found} {moment}");
            }
        }
    }

    #[test]
    fn gaussians_compose_and_are_positive() {
        let field = random_field(24 * 16, 4);
        let twice = filtered(
            Kernel::Gaussian,
            [24, 16],
            [3.0, 2.0],
            &filtered(Kernel::Gaussian, [24, 16], [4.0, 5.0], &field),
        );
        // w² - 1 adds.
        let [w, v] = [[3.0, 4.0], [2.0, 5.0]].map(|[a, b]: [f64; 2]| (a * a + b * b - 1.0).sqrt());
        near(&filtered(Kernel::Gaussian, [24, 16], [w, v], &field), &twice, 1e-14);
        let mut peak = vec![0.0; 24 * 16];
        peak[100] = 1.0;
        for kernel in [Kernel::Gaussian, Kernel::Diffusion] {
            let found = filtered(kernel, [24, 16], [4.0, 4.0], &peak);
            assert!(found.iter().all(|&q| q > -1e-16), "{kernel:?}");
        }
    }

    #[test]
    fn a_wave_is_kept_or_cut() {
        let wave = |m: f64| -> Vec<f64> {
            (0..32 * 4).map(|i| (TAU * m * (i % 32) as f64 / 32.0).cos()).collect()
        };
        for (m, kept) in [(3.0, 1.0), (4.0, 1.0), (5.0, 0.0), (16.0, 0.0)] {
            let found = filtered(Kernel::Sharp, [32, 4], [4.0, 1.0], &wave(m));
            let exact: Vec<f64> = wave(m).iter().map(|q| kept * q).collect();
            near(&found, &exact, 1e-14);
        }
    }
}
