//! Viscous stress of the solids, as a sub-step that loses exactly the kinetic energy which heats.
//!
//! u' = u + dt/(ρ_s φ) ∇·τ(u), and the granular energy gains τ(u) : ∇(u + u')/2, which is the
//! discrete loss of kinetic energy. An explicit stress with production τ(u) : ∇u instead creates
//! energy in nearly empty cells.

use super::GHOST;
use crate::field::{Faces, Field};
use crate::real::Real;
use crate::rows::{Rows, by_axis, simd, sum_axes};

/// Stress τ, tension positive \[Pa\], and what it heats.
#[derive(Clone, Debug)]
pub(super) struct Stress<R, const D: usize> {
    /// τ_aa at cell centres, one field per axis.
    pub(super) normal: Vec<Field<R, D>>,
    /// τ_ab on the edges at the lower faces of axes a and b, one field per pair.
    shear: Vec<Field<R, D>>,
    /// Shear heating of an edge over the solids fraction of its four cells \[W/m³\].
    shear_heating: Vec<Field<R, D>>,
}

/// Pairs of axes (a, b), a < b; the place of a pair in the list is the place of its shear stress.
pub(super) fn pairs<const D: usize>() -> impl Iterator<Item = (usize, (usize, usize))> {
    (0..D).flat_map(|b| (0..b).map(move |a| (a, b))).enumerate()
}

/// Place of the pair of two axes in [`pairs`].
fn pair(a: usize, b: usize) -> usize {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    high * (high - 1) / 2 + low
}

impl<R: Real, const D: usize> Stress<R, D> {
    pub(super) fn zeros(layout: crate::field::Layout<D>) -> Self {
        let fields = |n| (0..n).map(|_| Field::zeros(layout)).collect();
        let pairs = D * (D - 1) / 2;
        Self { normal: fields(D), shear: fields(pairs), shear_heating: fields(pairs) }
    }

    /// τ = 2 μ S + μ_b (∇·u) I, S deviatoric, of `velocity`. On an edge μ is the harmonic mean of
    /// the four cells', which bounds μ/φ beside a dense cell.
    pub(super) fn set(
        &mut self,
        rows: &Rows<D>,
        velocity: &Faces<R, D>,
        viscosity: &Field<R, D>,
        bulk_viscosity: &Field<R, D>,
        inverse_spacing: [R; D],
    ) {
        for axis in 0..D {
            rows.each([&mut self.normal[axis]], |o, [normal]| {
                let u = std::array::from_fn(|a| {
                    [velocity[a].row(o), velocity[a].row(o + rows.stride(a))]
                });
                let (mu, bulk) = (viscosity.row(o), bulk_viscosity.row(o));
                normal_row(normal, axis, u, mu, bulk, inverse_spacing);
            });
        }
        for (at, (a, b)) in pairs::<D>() {
            let (sa, sb) = (rows.stride(a), rows.stride(b));
            rows.each([&mut self.shear[at]], |o, [shear]| {
                let u = shear_lines(velocity, a, b, o, rows);
                let mu = [o, o - sa, o - sb, o - sa - sb].map(|o| viscosity.row(o));
                shear_row(shear, u, mu, [inverse_spacing[a], inverse_spacing[b]]);
            });
        }
    }

    /// u' = u + dt/(ρ_s φ) ∇·τ along `axis`; `impulse` is dt/ρ_s.
    #[allow(clippy::too_many_arguments)]
    pub(super) fn apply(
        &self,
        rows: &Rows<D>,
        axis: usize,
        new: &mut Field<R, D>,
        velocity: &Field<R, D>,
        phi: &Field<R, D>,
        impulse: R,
        inverse_spacing: [R; D],
    ) {
        let s = rows.stride(axis);
        rows.each([new], |o, [new]| {
            let stress = std::array::from_fn(|b| {
                if b == axis {
                    [self.normal[axis].row(o - s), self.normal[axis].row(o)]
                } else {
                    let shear = &self.shear[pair(axis, b)];
                    [shear.row(o), shear.row(o + rows.stride(b))]
                }
            });
            let phi = [phi.row(o - s), phi.row(o)];
            apply_row(new, velocity.row(o), stress, phi, impulse, inverse_spacing);
        });
    }

    /// Heating on the edges, from the velocities before and after.
    pub(super) fn set_shear_heating(
        &mut self,
        rows: &Rows<D>,
        before: &Faces<R, D>,
        after: &Faces<R, D>,
        phi: &Field<R, D>,
        inverse_spacing: [R; D],
    ) {
        for (at, (a, b)) in pairs::<D>() {
            let (sa, sb) = (rows.stride(a), rows.stride(b));
            let shear = &self.shear[at];
            rows.each([&mut self.shear_heating[at]], |o, [heating]| {
                let u = [before, after].map(|u| shear_lines(u, a, b, o, rows));
                let phi = [o, o - sa, o - sb, o - sa - sb].map(|o| phi.row(o));
                let inverse = [inverse_spacing[a], inverse_spacing[b]];
                shear_heating_row(heating, shear.row(o), u, phi, inverse);
            });
        }
    }

    /// Rows of the four edges around the cells of row `o` that carry shear heating, for the pair at
    /// `at` in [`pairs`].
    pub(super) fn edges(
        &self,
        rows: &Rows<D>,
        at: usize,
        a: usize,
        b: usize,
        o: usize,
    ) -> [&[R]; 4] {
        let (sa, sb) = (rows.stride(a), rows.stride(b));
        [o, o + sa, o + sb, o + sa + sb].map(|o| self.shear_heating[at].row(o))
    }
}

/// u_a here and below in b, u_b here and below in a.
fn shear_lines<'a, R: Real, const D: usize>(
    velocity: &'a Faces<R, D>,
    a: usize,
    b: usize,
    o: usize,
    rows: &Rows<D>,
) -> [&'a [R]; 4] {
    [
        velocity[a].row(o),
        velocity[a].row(o - rows.stride(b)),
        velocity[b].row(o),
        velocity[b].row(o - rows.stride(a)),
    ]
}

simd! {
    fn normal_row[R: Real, const D: usize](
        normal: &mut [R],
        axis: usize,
        u: [[&[R]; 2]; D],
        viscosity: &[R],
        bulk: &[R],
        inverse_spacing: [R; D],
    ) {
        let n = normal.len();
        let [below, above] = u[axis].map(|u| &u[..n]);
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
    fn shear_row[R: Real](shear: &mut [R], u: [&[R]; 4], viscosity: [&[R]; 4], inverse: [R; 2]) {
        let n = shear.len();
        let (u, viscosity) = (u.map(|u| &u[..n]), viscosity.map(|m| &m[..n]));
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
    fn apply_row[R: Real, const D: usize](
        new: &mut [R],
        velocity: &[R],
        stress: [[&[R]; 2]; D],
        phi: [&[R]; 2],
        impulse: R,
        inverse_spacing: [R; D],
    ) {
        let n = new.len();
        let (velocity, phi) = (&velocity[..n], phi.map(|p| &p[..n]));
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
    fn shear_heating_row[R: Real](
        heating: &mut [R],
        shear: &[R],
        u: [[&[R]; 4]; 2],
        phi: [&[R]; 4],
        inverse: [R; 2],
    ) {
        let n = heating.len();
        let [before, after] = u;
        let (before, after) = (before.map(|u| &u[..n]), after.map(|u| &u[..n]));
        let (shear, phi) = (&shear[..n], phi.map(|p| &p[..n]));
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
