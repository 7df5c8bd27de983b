//! Viscous stress of the solids, as a sub-step that loses exactly the kinetic energy which heats;
//! and of the gas, whose heat is of no interest.
//!
//! u' = u + dt/(ρ_s φ) ∇·τ(u), and the granular energy gains τ(u) : ∇(u + u')/2, which is the
//! discrete loss of kinetic energy. An explicit stress with production τ(u) : ∇u instead creates
//! energy in nearly empty cells.

use super::GHOST;
use crate::real::Real;
use crate::rows::{by_axis, cut, simd, sum_axes};
pub(super) use crate::viscous::{around, normal_row, pair, pairs, shear_lines, shear_row};

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
