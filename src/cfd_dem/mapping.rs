//! How particles and cells see each other: a particle's volume is shared among the cells around it, and
//! the particle sees the mean of those cells with the same shares. What belongs to the faces of one axis, such
//! as a component of the gas velocity, is shared among those faces and seen from them in the same way.
//!
//! Seen and shared alike, what all particles take is what all cells give, to round-off:
//! Σ_p K_p Σ_c w_pc u_c = Σ_c u_c Σ_p w_pc K_p. Shares add up to one, so that volume, mass and
//! momentum are kept.

use super::smoothing::Smoothing;
use crate::case::MappingChoice;
use crate::dem::Quad;
use crate::grid::Grid;
use std::f64::consts::PI;

/// How particles and cells see each other.
#[derive(Clone, Debug)]
pub(super) struct Mapping {
    cells: [usize; 3],
    inverse_spacing: [f64; 3],
    choice: MappingChoice,
    /// Edge of the cube of a sphere's volume, over its radius.
    cube: f64,
    smoothing: Smoothing,
    /// What [`Mapping::smooth`] writes to.
    scratch: Vec<[f64; 8]>,
}

/// The cells that share a particle, and their shares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares {
    pub cells: [u32; 8],
    pub weights: [f64; 8],
}

impl Shares {
    /// Adds a particle's numbers to its cells.
    #[inline(always)]
    pub fn give<const N: usize>(&self, to: &mut [[f64; N]], what: [f64; N]) {
        for (&cell, &weight) in self.cells.iter().zip(&self.weights) {
            let to = &mut to[cell as usize];
            for n in 0..N {
                to[n] += weight * what[n];
            }
        }
    }

    /// The mean of the cells' numbers that the particle sees.
    #[inline(always)]
    pub fn see<const N: usize>(&self, from: &[[f64; N]]) -> [f64; N] {
        let mut seen = [0.0; N];
        for (&cell, &weight) in self.cells.iter().zip(&self.weights) {
            let from = &from[cell as usize];
            for n in 0..N {
                seen[n] += weight * from[n];
            }
        }
        seen
    }
}

/// The faces of each axis that share a particle, and their shares.
#[derive(Clone, Copy, Debug)]
pub(super) struct FaceShares([Shares; 3]);

impl FaceShares {
    /// Adds a particle's numbers to its faces: `first` for those of each axis, then `second`.
    #[inline(always)]
    pub fn give(&self, to: &mut [[f64; 6]], first: [f64; 3], second: [f64; 3]) {
        for (axis, shares) in self.0.iter().enumerate() {
            for (&cell, &weight) in shares.cells.iter().zip(&shares.weights) {
                let to = &mut to[cell as usize];
                to[axis] += weight * first[axis];
                to[3 + axis] += weight * second[axis];
            }
        }
    }

    /// The mean of the faces' numbers that the particle sees; those of the faces of each axis come first in
    /// what a cell has.
    #[inline(always)]
    pub fn see<const N: usize>(&self, from: &[[f64; N]]) -> [f64; 3] {
        let mut seen = [0.0; 3];
        for (axis, shares) in self.0.iter().enumerate() {
            for (&cell, &weight) in shares.cells.iter().zip(&shares.weights) {
                seen[axis] += weight * from[cell as usize][axis];
            }
        }
        seen
    }
}

/// The two cells along an axis that share a particle, and their shares.
type Pair = ([u32; 2], [f64; 2]);

/// A place along an axis in units of cells: the lower of the two cells that share it, and its share.
///
/// Trilinear: a hat as wide as two cells. Divided: what lies in either cell of an edge `edge` of
/// the cube of the particle's volume.
#[inline(always)]
fn along(choice: MappingChoice, place: f64, edge: f64) -> (i64, f64) {
    match choice {
        MappingChoice::Trilinear => {
            let lower = floor(place - 0.5);
            (lower, 1.0 - (place - 0.5 - lower as f64))
        }
        MappingChoice::Divided => {
            let begin = place - 0.5 * edge;
            let lower = floor(begin);
            (lower, ((lower as f64 + 1.0 - begin) / edge).min(1.0))
        }
    }
}

/// The largest integer that is no larger; the standard library's is a call in portable code.
#[inline(always)]
fn floor(x: f64) -> i64 {
    let toward_zero = x as i64;
    toward_zero - i64::from(x < toward_zero as f64)
}

impl Mapping {
    /// Of particles of about `diameter`, spread to the standard deviation `width` along each axis where their
    /// shares in cells alone are narrower \[m\].
    pub fn new(grid: &Grid<3>, choice: MappingChoice, diameter: f64, width: f64) -> Self {
        let missing = |h| (width.powi(2) - choice.variance(h, diameter)).max(0.0);
        Self {
            cells: grid.cells,
            inverse_spacing: grid.spacing.map(|h| 1.0 / h),
            choice,
            cube: 2.0 * (PI / 6.0).cbrt(),
            smoothing: Smoothing::new(grid.spacing, grid.spacing.map(missing)),
            scratch: Vec::new(),
        }
    }

    /// The cells along each axis that share a particle, and the faces of that axis. (Loops, here and below:
    /// closures of `from_fn` are not inlined.)
    #[inline(always)]
    fn pairs(&self, Quad([x, y, z, radius]): Quad) -> [[Pair; 2]; 3] {
        let edge = self.cube * radius;
        let mut pairs = [[Pair::default(); 2]; 3];
        for (axis, place) in [x, y, z].into_iter().enumerate() {
            let inverse = self.inverse_spacing[axis];
            let cells = self.cells[axis] as i64;
            // A face is where the cell above it begins, half a cell below its centre.
            for (pair, shift) in pairs[axis].iter_mut().zip([0.0, 0.5]) {
                let (lower, share) = along(self.choice, place * inverse + shift, edge * inverse);
                let lower =
                    if (0..cells).contains(&lower) { lower } else { lower.rem_euclid(cells) };
                let upper = if lower + 1 == cells { 0 } else { lower + 1 };
                *pair = ([lower as u32, upper as u32], [share, 1.0 - share]);
            }
        }
        pairs
    }

    /// The cells that share what the pairs along each axis share.
    #[inline(always)]
    fn product(&self, [x, y, z]: [Pair; 3]) -> Shares {
        let [width, depth] = [self.cells[0] as u32, self.cells[1] as u32];
        let mut shares = Shares { cells: [0; 8], weights: [0.0; 8] };
        for n in 0..8 {
            let [i, j, k] = [n & 1, (n >> 1) & 1, n >> 2];
            shares.cells[n] = (z.0[k] * depth + y.0[j]) * width + x.0[i];
            shares.weights[n] = x.1[i] * y.1[j] * z.1[k];
        }
        shares
    }

    /// The cells that share a particle: its centre and radius.
    #[inline(always)]
    pub fn shares(&self, particle: Quad) -> Shares {
        let [[x, _], [y, _], [z, _]] = self.pairs(particle);
        self.product([x, y, z])
    }

    /// The faces that share it, and the cells.
    #[inline(always)]
    pub fn face_shares(&self, particle: Quad) -> (FaceShares, Shares) {
        let [x, y, z] = self.pairs(particle);
        let faces = [
            self.product([x[1], y[0], z[0]]),
            self.product([x[0], y[1], z[0]]),
            self.product([x[0], y[0], z[1]]),
        ];
        (FaceShares(faces), self.product([x[0], y[0], z[0]]))
    }

    /// Spreads what cells hold by a Gaussian to the width asked for, keeping its sum: explicit steps of
    /// diffusion. It is its own adjoint, so that what was shared is spread, and what will be seen.
    pub fn smooth<const N: usize>(&mut self, values: &mut [[f64; N]]) {
        let [nx, ny, nz] = self.cells;
        let [ax, ay, az] = self.smoothing.shares;
        self.scratch.resize(values.len(), [0.0; 8]);
        for _ in 0..self.smoothing.steps {
            for (kept, value) in self.scratch.iter_mut().zip(&*values) {
                kept[..N].copy_from_slice(value);
            }
            let from = &self.scratch;
            for k in 0..nz {
                let (below, above) = ((k + nz - 1) % nz, (k + 1) % nz);
                for j in 0..ny {
                    let (front, back) = ((j + ny - 1) % ny, (j + 1) % ny);
                    let row = |j: usize, k: usize| (k * ny + j) * nx;
                    let [here, front, back, below, above] =
                        [row(j, k), row(front, k), row(back, k), row(j, below), row(j, above)];
                    for i in 0..nx {
                        let (left, right) = ((i + nx - 1) % nx, (i + 1) % nx);
                        let near = [
                            (ax, here + left, here + right),
                            (ay, front + i, back + i),
                            (az, below + i, above + i),
                        ];
                        let value = &mut values[here + i];
                        for (n, value) in value.iter_mut().enumerate() {
                            let old = from[here + i][n];
                            for (share, lower, upper) in near {
                                *value += share * (from[lower][n] - 2.0 * old + from[upper][n]);
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GRID: [usize; 3] = [8, 10, 12];

    fn mapping(choice: MappingChoice, length: f64) -> Mapping {
        Mapping::new(&Grid::new([0.8, 1.0, 1.2], GRID), choice, 0.1, length)
    }

    proptest! {
        #[test]
        fn shares_add_up_to_one_and_have_the_particle_in_their_middle(
            place in [0.15..0.65f64, 0.15..0.85f64, 0.15..1.05f64]
        ) {
            for choice in [MappingChoice::Trilinear, MappingChoice::Divided] {
                let [x, y, z] = place;
                let shares = mapping(choice, 0.0).shares(Quad([x, y, z, 0.05]));
                let sum: f64 = shares.weights.iter().sum();
                prop_assert!((sum - 1.0).abs() < 1e-14);
                prop_assert!(shares.weights.iter().all(|weight| (0.0..=1.0).contains(weight)));
                if choice == MappingChoice::Trilinear {
                    // What is linear in space is seen exactly.
                    let centres: Vec<[f64; 3]> = (0..960)
                        .map(|c| [c % 8, c / 8 % 10, c / 80].map(|i| 0.1 * (i as f64 + 0.5)))
                        .collect();
                    let seen = shares.see(&centres);
                    let faces: Vec<[f64; 3]> =
                        centres.iter().map(|centre| centre.map(|x| x - 0.05)).collect();
                    let of_faces =
                        mapping(choice, 0.0).face_shares(Quad([x, y, z, 0.05])).0.see(&faces);
                    for axis in 0..3 {
                        prop_assert!((seen[axis] - place[axis]).abs() < 1e-14);
                        prop_assert!((of_faces[axis] - place[axis]).abs() < 1e-14);
                    }
                }
            }
        }
    }

    #[test]
    fn a_particle_within_a_cell_is_divided_to_that_cell_alone() {
        let shares = mapping(MappingChoice::Divided, 0.0).shares(Quad([0.05, 0.05, 0.05, 0.05]));
        let inside = shares.cells.iter().zip(&shares.weights).filter(|(cell, _)| **cell == 0);
        assert!((inside.map(|(_, weight)| weight).sum::<f64>() - 1.0).abs() < 1e-15);
        // Across the corner of the box.
        let shares = mapping(MappingChoice::Divided, 0.0).shares(Quad([0.0, 0.0, 0.0, 0.05]));
        assert!(shares.weights.iter().all(|weight| (weight - 0.125).abs() < 1e-12));
        assert!(shares.cells.contains(&0) && shares.cells.contains(&959));
    }

    /// Mean over many places of the variance about the particle of what it is spread to, along each axis: among
    /// cells, or among faces of the axis `faces`.
    fn variance(
        mapping: &mut Mapping,
        spacing: [f64; 3],
        radius: f64,
        faces: Option<usize>,
    ) -> [f64; 3] {
        let [nx, ny, _] = mapping.cells;
        let mut mean = [0.0; 3];
        let places = 200;
        for n in 0..places {
            let part = |step: f64| (0.5 + step * n as f64).fract();
            let shift = [part(0.618_033_988_7), part(0.754_877_666), part(0.569_840_29)];
            let place: [f64; 3] = std::array::from_fn(|axis| {
                (mapping.cells[axis] as f64 / 2.0 + shift[axis]) * spacing[axis]
            });
            let mut values = vec![[0.0]; mapping.cells.iter().product()];
            let [x, y, z] = place;
            let particle = Quad([x, y, z, radius]);
            if let Some(axis) = faces {
                let mut all = vec![[0.0; 6]; values.len()];
                mapping.face_shares(particle).0.give(&mut all, [1.0; 3], [2.0; 3]);
                assert!(all.iter().all(|all| all[3 + axis] == 2.0 * all[axis]));
                values.iter_mut().zip(&all).for_each(|(value, all)| *value = [all[axis]]);
            } else {
                mapping.shares(particle).give(&mut values, [1.0]);
            }
            mapping.smooth(&mut values);
            let sum: f64 = values.iter().map(|[v]| v).sum();
            assert!((sum - 1.0).abs() < 1e-13);
            for (c, [v]) in values.iter().enumerate() {
                let cell = [c % nx, c / nx % ny, c / (nx * ny)];
                for axis in 0..3 {
                    let half = if faces == Some(axis) { 0.0 } else { 0.5 };
                    let from = (cell[axis] as f64 + half) * spacing[axis] - place[axis];
                    mean[axis] += v * from * from / f64::from(places);
                }
            }
        }
        mean
    }

    #[test]
    fn a_particle_is_spread_to_the_width_asked_for_on_any_cells() {
        for choice in [MappingChoice::Trilinear, MappingChoice::Divided] {
            for (cells, spacing) in [([24; 3], [0.1; 3]), ([24, 32, 18], [0.1, 0.08, 0.14])] {
                let size = std::array::from_fn(|axis| cells[axis] as f64 * spacing[axis]);
                let grid = Grid::new(size, cells);
                let mut wide = Mapping::new(&grid, choice, 0.06, 0.15);
                for faces in [None, Some(0), Some(2)] {
                    for found in variance(&mut wide, spacing, 0.03, faces) {
                        assert!((found / 0.0225 - 1.0).abs() < 0.003, "{choice:?} {found}");
                    }
                }
                // Nothing makes it narrower than cells alone do.
                let mut bare = Mapping::new(&grid, choice, 0.06, 0.01);
                assert_eq!(bare.smoothing.steps, 0);
                let found = variance(&mut bare, spacing, 0.03, None);
                for axis in 0..3 {
                    let expected = choice.variance(spacing[axis], 0.06);
                    assert!((found[axis] / expected - 1.0).abs() < 0.03, "{choice:?} {found:?}");
                }
            }
        }
    }

    #[test]
    fn smoothing_is_its_own_adjoint() {
        let grid = Grid::new([1.6; 3], [16; 3]);
        let mut mapping = Mapping::new(&grid, MappingChoice::Trilinear, 0.1, 0.15);
        let at = |i: usize, j: usize, k: usize| (k * 16 + j) * 16 + i;
        let mut point = |place: usize| {
            let mut values = vec![[0.0]; 16 * 16 * 16];
            values[place] = [1.0];
            mapping.smooth(&mut values);
            values
        };
        let (a, b) = (at(8, 8, 8), at(6, 9, 7));
        let (from_a, from_b) = (point(a), point(b));
        assert!(from_a[b][0] > 1e-3 && (from_a[b][0] - from_b[a][0]).abs() < 1e-16);
    }
}
