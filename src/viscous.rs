//! Viscous stress on a staggered grid: normal stresses at cell centres, shear stresses on edges, their
//! divergence on faces. Whose stress it is, and what it pushes, is the simulator's affair.

use crate::field::{Lines, Row};
use crate::real::Real;
use crate::rows::{by_axis, cut, simd, sum_axes};

/// Pairs of axes (a, b), a < b; the place of a pair in the list is the place of its shear stress.
pub(crate) fn pairs<const D: usize>() -> impl Iterator<Item = (usize, (usize, usize))> {
    (0..D).flat_map(|b| (0..b).map(move |a| (a, b))).enumerate()
}

/// Place of the pair of two axes in [`pairs`].
pub(crate) fn pair(a: usize, b: usize) -> usize {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    high * (high - 1) / 2 + low
}

/// u_a here and below in b, u_b here and below in a: what shears the edges at the lower faces of
/// axes a and b.
#[inline(always)]
pub(crate) fn shear_lines<R: Real, const D: usize>(
    velocity: &[impl Lines<R, D>],
    (a, b): (usize, usize),
    row: Row<D>,
) -> [&[R]; 4] {
    [
        velocity[a].row(row),
        velocity[a].row(row.near(b, -1)),
        velocity[b].row(row),
        velocity[b].row(row.near(a, -1)),
    ]
}

/// The rows of the four cells around the edges at the lower faces of axes a and b.
#[inline(always)]
pub(crate) fn around<R: Real, const D: usize>(
    q: &impl Lines<R, D>,
    (a, b): (usize, usize),
    row: Row<D>,
) -> [&[R]; 4] {
    let (left, below) = (row.near(a, -1), row.near(b, -1));
    [q.row(row), q.row(left), q.row(below), q.row(left.near(b, -1))]
}

simd! {
    /// τ_aa = 2 μ S_aa + μ_b ∇·u at cell centres \[Pa\], S deviatoric.
    pub(crate) fn normal_row[R: Real, const D: usize](
        normal: &mut [R],
        axis: usize,
        u: [[&[R]; 2]; D],
        viscosity: &[R],
        bulk: &[R],
        inverse_spacing: [R; D],
    ) {
        let n = normal.len();
        let [below, above] = cut(u[axis], n);
        let u = by_axis(u, n);
        let (viscosity, bulk) = (&viscosity[..n], &bulk[..n]);
        for i in 0..n {
            let divergence = sum_axes!(D, u, |[lower, upper], a| {
                inverse_spacing[a] * (upper[i] - lower[i])
            });
            let strain = inverse_spacing[axis] * (above[i] - below[i]);
            normal[i] = R::of(2.0) * viscosity[i] * (strain - R::of(1.0 / 3.0) * divergence)
                + bulk[i] * divergence;
        }
    }
}

simd! {
    /// τ_ab = 2 μ S_ab on edges \[Pa\]; μ is the harmonic mean of the four cells', which bounds μ/φ
    /// beside a dense cell.
    pub(crate) fn shear_row[R: Real](shear: &mut [R], u: [&[R]; 4], viscosity: [&[R]; 4], inverse: [R; 2]) {
        let n = shear.len();
        let (u, viscosity) = (cut(u, n), cut(viscosity, n));
        for i in 0..n {
            let strain = inverse[1] * (u[0][i] - u[1][i]) + inverse[0] * (u[2][i] - u[3][i]);
            // 4 / (1/a + 1/b + 1/c + 1/d) with one division; zero if any is zero.
            let [a, b, c, d] = viscosity.map(|m| m[i]);
            let (ab, cd) = (a * b, c * d);
            let harmonic = R::of(4.0) * ab * cd / ((a + b) * cd + (c + d) * ab + R::of(1e-30));
            shear[i] = harmonic * strain;
        }
    }
}

simd! {
    /// ∇·τ on the lower faces of an axis \[Pa/m\], from the stresses below and above along each axis.
    pub(crate) fn divergence_row[R: Real, const D: usize](
        divergence: &mut [R],
        stress: [[&[R]; 2]; D],
        inverse_spacing: [R; D],
    ) {
        let n = divergence.len();
        let stress = by_axis(stress, n);
        for i in 0..n {
            divergence[i] = sum_axes!(D, stress, |[lower, upper], b| {
                inverse_spacing[b] * (upper[i] - lower[i])
            });
        }
    }
}
