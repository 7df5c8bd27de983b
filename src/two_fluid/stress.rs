//! Viscous stress of the solids, as a sub-step that loses exactly the kinetic energy which heats;
//! and of the gas, whose heat is of no interest.
//!
//! u' = u + dt/(ρ_s φ) ∇·τ(u), and the granular energy gains τ(u) : ∇(u + u')/2, which is the
//! discrete loss of kinetic energy. An explicit stress with production τ(u) : ∇u instead creates
//! energy in nearly empty cells.

use super::GHOST;
use crate::field::{Lines, Row};
use crate::real::Real;
use crate::rows::{by_axis, cut, simd, sum_axes};

/// Pairs of axes (a, b), a < b; the place of a pair in the list is the place of its shear stress.
pub(super) fn pairs<const D: usize>() -> impl Iterator<Item = (usize, (usize, usize))> {
    (0..D).flat_map(|b| (0..b).map(move |a| (a, b))).enumerate()
}

/// Place of the pair of two axes in [`pairs`].
pub(super) fn pair(a: usize, b: usize) -> usize {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    high * (high - 1) / 2 + low
}

/// u_a here and below in b, u_b here and below in a: what shears the edges at the lower faces of
/// axes a and b.
#[inline(always)]
pub(super) fn shear_lines<R: Real, const D: usize>(
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
pub(super) fn around<R: Real, const D: usize>(
    q: &impl Lines<R, D>,
    (a, b): (usize, usize),
    row: Row<D>,
) -> [&[R]; 4] {
    let (left, below) = (row.near(a, -1), row.near(b, -1));
    [q.row(row), q.row(left), q.row(below), q.row(left.near(b, -1))]
}

simd! {
    /// τ_aa = 2 μ S_aa + μ_b ∇·u at cell centres \[Pa\], S deviatoric.
    pub(super) fn normal_row[R: Real, const D: usize](
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
    pub(super) fn shear_row[R: Real](shear: &mut [R], u: [&[R]; 4], viscosity: [&[R]; 4], inverse: [R; 2]) {
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
    /// u' = u + dt/(ρ_s φ) ∇·τ; `impulse` is dt/ρ_s.
    pub(super) fn apply_row[R: Real, const D: usize](
        new: &mut [R],
        velocity: &[R],
        stress: [[&[R]; 2]; D],
        phi: [&[R]; 2],
        impulse: R,
        inverse_spacing: [R; D],
    ) {
        let n = new.len();
        let (velocity, phi) = (&velocity[..n], cut(phi, n));
        let stress = by_axis(stress, n);
        for i in 0..n {
            let force = sum_axes!(D, stress, |[lower, upper], b| {
                inverse_spacing[b] * (upper[i] - lower[i])
            });
            let share = R::of(0.5) * (phi[0][i] + phi[1][i]) + R::of(GHOST);
            new[i] = velocity[i] + impulse * force / share;
        }
    }
}

simd! {
    /// The push of the gas's stress on both phases, each by its fraction: u_s' = u_s + dt/ρ_s ∇·τ,
    /// u_g' = u_g + dt/ρ_g ∇·τ; `impulses` are dt/ρ_s and dt/ρ_g. The ghost mass of the solids has no
    /// volume to be pushed at.
    pub(super) fn push_row[R: Real, const D: usize](
        solids: &mut [R],
        gas: &mut [R],
        velocities: [&[R]; 2],
        stress: [[&[R]; 2]; D],
        phi: [&[R]; 2],
        impulses: [R; 2],
        inverse_spacing: [R; D],
    ) {
        let n = velocities[0].len();
        let (solids, gas) = (&mut solids[..n], &mut gas[..n]);
        let (velocities, phi) = (cut(velocities, n), cut(phi, n));
        let stress = by_axis(stress, n);
        for i in 0..n {
            let force = sum_axes!(D, stress, |[lower, upper], b| {
                inverse_spacing[b] * (upper[i] - lower[i])
            });
            let face = R::of(0.5) * (phi[0][i] + phi[1][i]);
            solids[i] = velocities[0][i] + impulses[0] * force * face / (face + R::of(GHOST));
            gas[i] = velocities[1][i] + impulses[1] * force;
        }
    }
}

simd! {
    /// Shear heating of an edge over the solids fraction of its four cells \[W/m³\], from the
    /// velocities before and after.
    pub(super) fn shear_heating_row[R: Real](
        heating: &mut [R],
        shear: &[R],
        u: [[&[R]; 4]; 2],
        phi: [&[R]; 4],
        inverse: [R; 2],
    ) {
        let n = heating.len();
        let [before, after] = u;
        let (before, after) = (cut(before, n), cut(after, n));
        let (shear, phi) = (&shear[..n], cut(phi, n));
        for i in 0..n {
            let strain = |u: &[&[R]; 4]| {
                inverse[1] * (u[0][i] - u[1][i]) + inverse[0] * (u[2][i] - u[3][i])
            };
            let strain = strain(&before) + strain(&after);
            let solids = phi[0][i] + phi[1][i] + phi[2][i] + phi[3][i] + R::of(4.0 * GHOST);
            heating[i] = R::of(0.5) * shear[i] * strain / solids;
        }
    }
}
