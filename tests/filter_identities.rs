//! Identities that every filter kernel keeps, in two and three dimensions.

use favre::filter::BoxFilter;
use favre::spectral::{Kernel, SpectralFilter};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// The field filtered by boxes, or what stands for them, of `width` cells along each axis.
fn filtered<const D: usize>(
    kernel: Kernel,
    cells: [usize; D],
    width: [usize; D],
    field: &[f64],
) -> Vec<f64> {
    if kernel == Kernel::Box {
        let mut filter = BoxFilter::new(cells, &[width]).unwrap();
        let mut outputs = filter.outputs();
        filter.filter(field, &mut outputs);
        return outputs.remove(0);
    }
    let filter = SpectralFilter::new(kernel, cells, &[width.map(|w| w as f64)]);
    let mut found = Vec::new();
    filter.filter(field, &mut filter.scratch(), |_, out| found = out.to_vec());
    found
}

fn random_field(len: usize, seed: u64) -> Vec<f64> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    (0..len).map(|_| random.random::<f64>() - 0.3).collect()
}

fn near(a: &[f64], b: &[f64], within: f64, what: &str) {
    for (cell, (a, b)) in a.iter().zip(b).enumerate() {
        assert!((a - b).abs() <= within, "{what}, cell {cell}: {a} {b}");
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a * b).collect()
}

fn check<const D: usize>(cells: [usize; D], width: [usize; D], test: [usize; D], seed: u64) {
    let len: usize = cells.iter().product();
    let (a, b) = (random_field(len, seed), random_field(len, seed ^ 77));
    for kernel in Kernel::ALL {
        let name = kernel.name();
        let filter = |field: &[f64]| filtered(kernel, cells, width, field);
        let wider = |field: &[f64]| filtered(kernel, cells, test, field);

        // A constant stays, the mean is kept, sums are filtered term by term.
        near(&filter(&vec![0.7; len]), &vec![0.7; len], 1e-14, name);
        let mean = |field: &[f64]| field.iter().sum::<f64>() / len as f64;
        assert!((mean(&filter(&a)) - mean(&a)).abs() < 1e-13, "{name}");
        let sum: Vec<f64> = a.iter().zip(&b).map(|(a, b)| a - 2.0 * b).collect();
        let apart: Vec<f64> = filter(&a).iter().zip(filter(&b)).map(|(a, b)| a - 2.0 * b).collect();
        near(&filter(&sum), &apart, 1e-13, name);

        // A nested test filter is the composition, in either order.
        near(&wider(&filter(&a)), &filter(&wider(&a)), 1e-13, name);

        // Self-adjoint where the kernel is symmetric: a box of an even number of cells is not, it
        // sits on a face.
        if kernel != Kernel::Box || width.iter().all(|w| w % 2 == 1) {
            assert!((dot(&filter(&a), &b) - dot(&a, &filter(&b))).abs() < 1e-12 * len as f64);
        }

        // Germano's identity, with Favre averages: the residual stress at the nested width is the
        // test-filtered residual stress and that of the filtered fields.
        let fraction: Vec<f64> = a.iter().map(|a| 0.35 + 0.3 * a).collect();
        let residual = |outer: &dyn Fn(&[f64]) -> Vec<f64>,
                        fraction: &[f64],
                        flux: &[f64],
                        squared: &[f64]|
         -> Vec<f64> {
            let (fraction, flux) = (outer(fraction), outer(flux));
            let resolved = flux.iter().zip(&fraction).map(|(flux, phi)| flux * flux / phi);
            outer(squared).iter().zip(resolved).map(|(all, resolved)| all - resolved).collect()
        };
        let (flux, squared) = (product(&fraction, &b), product(&product(&fraction, &b), &b));
        let both = |field: &[f64]| wider(&filter(field));
        let nested = residual(&both, &fraction, &flux, &squared);
        let inner = wider(&residual(&filter, &fraction, &flux, &squared));
        let (coarse, coarse_flux) = (filter(&fraction), filter(&flux));
        let velocity: Vec<f64> = coarse_flux.iter().zip(&coarse).map(|(f, phi)| f / phi).collect();
        let resolved = residual(&wider, &coarse, &coarse_flux, &product(&coarse_flux, &velocity));
        let sum: Vec<f64> = inner.iter().zip(&resolved).map(|(a, b)| a + b).collect();
        let smallest = both(&fraction).iter().fold(f64::INFINITY, |least, phi| least.min(*phi));
        near(&nested, &sum, 1e-12 / smallest.clamp(1e-3, 1.0), name);
    }
}

/// A field that is linear but for a jump far away, away from which it stays what it is.
fn check_linear<const D: usize>(cells: [usize; D], axis: usize) {
    let stride: usize = cells[..axis].iter().product();
    let len: usize = cells.iter().product();
    let field: Vec<f64> = (0..len).map(|i| (i / stride % cells[axis]) as f64).collect();
    let mut width = [1; D];
    width[axis] = 3;
    for kernel in [Kernel::Box, Kernel::Gaussian, Kernel::Diffusion] {
        let found = filtered(kernel, cells, width, &field);
        for (i, (found, exact)) in found.iter().zip(&field).enumerate() {
            let place = i / stride % cells[axis];
            if (24..40).contains(&place) {
                assert!((found - exact).abs() < 1e-9, "{} {place}: {found}", kernel.name());
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_kernel_keeps_its_identities_in_two_dimensions(
        nx in 2usize..16, ny in 2usize..16, w in 1usize..8, v in 1usize..8, t in 1usize..8,
        seed: u64,
    ) {
        let cells = [nx, ny];
        let fit = |w: [usize; 2]| [w[0].min(nx), w[1].min(ny)];
        check(cells, fit([w, v]), fit([t, t + 1]), seed);
    }

    #[test]
    fn every_kernel_keeps_its_identities_in_three_dimensions(
        nx in 2usize..8, ny in 2usize..8, nz in 2usize..8, w in 1usize..5, t in 1usize..5,
        seed: u64,
    ) {
        let fit = |w: [usize; 3]| [w[0].min(nx), w[1].min(ny), w[2].min(nz)];
        check([nx, ny, nz], fit([w, w + 1, 3]), fit([t, 2, t]), seed);
    }
}

#[test]
fn linear_fields_stay_linear() {
    check_linear([64, 2], 0);
    check_linear([2, 64], 1);
    check_linear([2, 2, 64], 2);
    check_linear([2, 64, 3], 1);
}
