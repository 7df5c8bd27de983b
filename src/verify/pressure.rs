//! How fast the pressure's iteration converges, against the contrast of its coefficient and the
//! size of the grid.

use super::{Checked, Effort, Expected, Row};
use crate::field::{Faces, Field, Layout};
use crate::grid::Grid;
use crate::poisson::Poisson;
use rand::{RngExt, SeedableRng};
use std::f64::consts::TAU;

/// What the largest residual is reduced by.
const REDUCTION: f64 = 1e-6;

/// Iterations in which it must be: what a step of the simulator allows itself.
const ITERATIONS: usize = 60;

/// How the coefficient varies between 1 and the contrast.
#[derive(Clone, Copy)]
enum Shape {
    /// Log-uniform, each face for itself.
    Random,
    /// Blobs as clusters make, with some noise.
    Blobs,
}

/// Iterations for contrasts and shapes on the finest grid, and how they grow with its size.
///
/// Quick are the contrasts of a gas-solid bed, whose densities are a thousandfold apart; beyond them
/// is measured in full.
pub(super) fn check(effort: Effort) -> Checked {
    let (flat, deep): (&[usize], &[usize]) = match effort {
        Effort::Quick => (&[32, 128], &[16, 32]),
        Effort::Full => (&[32, 64, 128, 256, 512, 1024], &[16, 32, 64, 128]),
    };
    let mut cases = vec![(Shape::Random, 1.0), (Shape::Random, 1e3), (Shape::Blobs, 1e3)];
    if effort == Effort::Full {
        cases.extend([(Shape::Random, 1e6), (Shape::Blobs, 1e6)]);
    }
    let mut rows = Vec::new();
    for (shape, contrast) in cases {
        rows.extend(converge::<2>("2-D", flat, [1.0; 2], shape, contrast));
        rows.extend(converge::<3>("3-D", deep, [1.0; 3], shape, contrast));
    }
    if effort == Effort::Full {
        rows.extend(converge("2-D, cells 1:4", flat, [1.0, 4.0], Shape::Blobs, 1e3));
    }
    Ok(rows)
}

/// Iterations on the finest of grids of `sizes` cells along each axis, with those on all.
fn converge<const D: usize>(
    name: &str,
    sizes: &[usize],
    spacing: [f64; D],
    shape: Shape,
    contrast: f64,
) -> Option<Row> {
    let found: Vec<_> = sizes.iter().map(|&n| solve([n; D], spacing, shape, contrast)).collect();
    let (last, size) = (found.last()?, sizes.last()?);
    let texts: Vec<String> = sizes
        .iter()
        .zip(&found)
        .map(|(n, found)| match found.reduction {
            reduction if reduction <= REDUCTION => format!("{n}: {}", found.iterations),
            reduction => format!("{n}: gave up at {reduction:.0e} after {}", found.iterations),
        })
        .collect();
    let factor = last.reduction.powf(1.0 / last.iterations.max(1) as f64);
    let detail = format!(
        "the simulator's limit; residual times {factor:.2} an iteration of one cycle; by cells along an axis {}",
        texts.join(", ")
    );
    let shape = match shape {
        Shape::Random => "random",
        Shape::Blobs => "blobs",
    };
    let quantity = format!(
        "iterations for {REDUCTION:e}, {name}, {shape}, contrast {contrast:e}, {size} cells"
    );
    // What gave up never got there.
    let iterations =
        if last.reduction <= REDUCTION { last.iterations as f64 } else { f64::INFINITY };
    Some(Row::new(quantity, Expected::AtMost(ITERATIONS as f64), iterations).with(detail))
}

/// How a solve went.
struct Solved {
    iterations: usize,
    /// Largest residual at the end over that at the start.
    reduction: f64,
}

/// Solves from zero, for noise.
fn solve<const D: usize>(
    cells: [usize; D],
    spacing: [f64; D],
    shape: Shape,
    contrast: f64,
) -> Solved {
    let grid = Grid::new(std::array::from_fn(|a| spacing[a] * cells[a] as f64), cells);
    let layout = Layout::from(&grid);
    let mut random = rand_pcg::Pcg64::seed_from_u64(1);
    let mut k: Faces<f64, D> = Field::zero_faces(layout);
    for faces in &mut k {
        faces.set(|index| {
            let noise = random.random_range(-1.0..1.0);
            let exponent = match shape {
                Shape::Random => noise,
                Shape::Blobs => {
                    let angle = |a: usize| TAU * 3.0 * index[a] as f64 / cells[a] as f64;
                    let wave: f64 = (0..D).map(|a| angle(a).sin()).product();
                    (3.0 * wave + 0.3 * noise).clamp(-1.0, 1.0)
                }
            };
            contrast.powf(0.5 * (1.0 + exponent))
        });
    }
    let noise: Vec<f64> = (0..grid.len()).map(|_| random.random_range(-1.0..1.0)).collect();
    let mean = noise.iter().sum::<f64>() / noise.len() as f64;
    let mut values = noise.iter().map(|value| value - mean);
    let mut right = Field::zeros(layout);
    right.set(|_| values.next().unwrap_or_default());
    let start = right.max().max(-right.min());
    let mut poisson = Poisson::new(&grid, false);
    poisson.set_coefficient(&k);
    let tolerance = REDUCTION * start;
    let found = poisson.solve(&mut Field::zeros(layout), &right, tolerance, 10 * ITERATIONS);
    Solved { iterations: found.iterations, reduction: found.residual / start }
}
