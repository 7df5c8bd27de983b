//! Transport by the volume fluxes: solids fraction, granular temperature, momentum of both phases.
//!
//! All of it is conservative and moves with the same fluxes, so that a uniform velocity or
//! temperature stays uniform whatever the solids do, and a nearly empty cell takes a weighted mean
//! of what flows in.

use super::GHOST;
use crate::field::{Faces, Field};
use crate::real::Real;
use crate::rows::{Rows, by_axis, simd, sum_axes};
use crate::stencil::upwind;

/// Volume fluxes through the faces [m/s]: of solids, of gas, and of solids times temperature.
#[derive(Clone, Debug)]
pub(super) struct Fluxes<R, const D: usize> {
    pub(super) solids: Faces<R, D>,
    pub(super) gas: Faces<R, D>,
    pub(super) heat: Faces<R, D>,
}

/// Four neighbours in a line across a face: two on either side.
#[derive(Clone, Copy)]
struct Line<'a, R>([&'a [R]; 4]);

impl<'a, R: Real> Line<'a, R> {
    fn at<const D: usize>(field: &'a Field<R, D>, o: usize, s: usize) -> Self {
        Self([field.row(o - 2 * s), field.row(o - s), field.row(o), field.row(o + s)])
    }

    #[inline(always)]
    fn cut(self, n: usize) -> Self {
        Self(self.0.map(|row| &row[..n]))
    }

    #[inline(always)]
    fn upwind(&self, through: R, courant: R, i: usize) -> R {
        upwind(through, courant, self.0[0][i], self.0[1][i], self.0[2][i], self.0[3][i])
    }
}

impl<R: Real, const D: usize> Fluxes<R, D> {
    /// Fluxes of `phi` and `theta` with the velocities; the gas takes what the solids leave of the
    /// total, which the pressure has made free of divergence.
    pub(super) fn set(
        &mut self,
        rows: &Rows<D>,
        phi: &Field<R, D>,
        theta: &Field<R, D>,
        solids: &Faces<R, D>,
        gas: &Faces<R, D>,
        courant: [R; D],
    ) {
        for axis in 0..D {
            let s = rows.stride(axis);
            rows.each(
                [&mut self.solids[axis], &mut self.gas[axis], &mut self.heat[axis]],
                |o, [fs, fg, ft]| {
                    let (phi, theta) = (Line::at(phi, o, s), Line::at(theta, o, s));
                    let (us, ug) = (solids[axis].row(o), gas[axis].row(o));
                    flux_row(fs, fg, ft, phi, theta, us, ug, courant[axis]);
                },
            );
        }
    }

    /// Scales the solids' outflow of each cell so that it takes no more than the cell holds, which
    /// limited slopes alone ensure only up to a Courant number of one half; the gas takes what the
    /// solids leave. `share` is scratch.
    pub(super) fn limit(
        &mut self,
        rows: &Rows<D>,
        share: &mut Field<R, D>,
        phi: &Field<R, D>,
        courant: [R; D],
    ) {
        let Self { solids, gas, heat } = self;
        rows.each([&mut *share], |o, [share]| {
            let fluxes =
                std::array::from_fn(|a| [solids[a].row(o), solids[a].row(o + rows.stride(a))]);
            share_row(share, phi.row(o), fluxes, courant);
        });
        for axis in 0..D {
            let s = rows.stride(axis);
            rows.each([&mut solids[axis], &mut gas[axis], &mut heat[axis]], |o, [fs, fg, ft]| {
                limit_row(fs, fg, ft, [share.row(o - s), share.row(o)]);
            });
        }
    }
}

simd! {
    /// Share of a cell's outflow that it can supply.
    fn share_row[R: Real, const D: usize](
        share: &mut [R],
        phi: &[R],
        fluxes: [[&[R]; 2]; D],
        courant: [R; D],
    ) {
        let n = share.len();
        let (phi, fluxes) = (&phi[..n], by_axis(fluxes, n));
        for i in 0..n {
            let outflow = sum_axes!(D, fluxes, |[lower, upper], a| {
                courant[a] * (upper[i].max(R::ZERO) - lower[i].min(R::ZERO))
            });
            // A trace stays behind, so that round-off cannot overdraw the cell.
            let held = R::of(1.0 - 1e-6) * phi[i];
            share[i] = R::select(outflow > held, held / outflow, R::ONE);
        }
    }
}

simd! {
    fn limit_row[R: Real](fs: &mut [R], fg: &mut [R], ft: &mut [R], share: [&[R]; 2]) {
        let n = fs.len();
        let (fg, ft, share) = (&mut fg[..n], &mut ft[..n], share.map(|s| &s[..n]));
        for i in 0..n {
            let upwind = R::select(fs[i] > R::ZERO, share[0][i], share[1][i]);
            let solids = upwind * fs[i];
            fg[i] += fs[i] - solids;
            ft[i] *= upwind;
            fs[i] = solids;
        }
    }
}

simd! {
    fn flux_row[R: Real](
        fs: &mut [R],
        fg: &mut [R],
        ft: &mut [R],
        phi: Line<'_, R>,
        theta: Line<'_, R>,
        us: &[R],
        ug: &[R],
        courant: R,
    ) {
        let n = fs.len();
        let (phi, theta) = (phi.cut(n), theta.cut(n));
        let (fg, ft, us, ug) = (&mut fg[..n], &mut ft[..n], &us[..n], &ug[..n]);
        for i in 0..n {
            let face = R::of(0.5) * (phi.0[1][i] + phi.0[2][i]);
            let total = face * us[i] + (R::ONE - face) * ug[i];
            let crossing = courant * us[i].abs();
            let solids = us[i] * phi.upwind(us[i], crossing, i);
            fs[i] = solids;
            fg[i] = total - solids;
            ft[i] = solids * theta.upwind(us[i], crossing, i);
        }
    }
}

/// φ and T after `dt` from the fluxes: φ' = φ - dt ∇·F, φ' T' = φ T - dt ∇·(F T).
pub(super) fn advect<R: Real, const D: usize>(
    rows: &Rows<D>,
    [phi_new, theta_new]: [&mut Field<R, D>; 2],
    phi: &Field<R, D>,
    theta: &Field<R, D>,
    fluxes: &Fluxes<R, D>,
    courant: [R; D],
) {
    rows.each([phi_new, theta_new], |o, [phi_new, theta_new]| {
        let fs: [[&[R]; 2]; D] = std::array::from_fn(|a| {
            [fluxes.solids[a].row(o), fluxes.solids[a].row(o + rows.stride(a))]
        });
        let ft: [[&[R]; 2]; D] = std::array::from_fn(|a| {
            [fluxes.heat[a].row(o), fluxes.heat[a].row(o + rows.stride(a))]
        });
        advect_row(phi_new, theta_new, phi.row(o), theta.row(o), fs, ft, courant);
    });
}

simd! {
    fn advect_row[R: Real, const D: usize](
        phi_new: &mut [R],
        theta_new: &mut [R],
        phi: &[R],
        theta: &[R],
        fs: [[&[R]; 2]; D],
        ft: [[&[R]; 2]; D],
        courant: [R; D],
    ) {
        let n = phi_new.len();
        let (theta_new, phi, theta) = (&mut theta_new[..n], &phi[..n], &theta[..n]);
        let (fs, ft) = (by_axis(fs, n), by_axis(ft, n));
        let ghost = R::of(GHOST);
        for i in 0..n {
            let solids = sum_axes!(D, fs, |[lower, upper], a| courant[a] * (upper[i] - lower[i]));
            let heat = sum_axes!(D, ft, |[lower, upper], a| courant[a] * (upper[i] - lower[i]));
            let (solids, heat) = (phi[i] - solids, (phi[i] + ghost) * theta[i] - heat);
            phi_new[i] = solids;
            theta_new[i] = heat / (solids + ghost);
        }
    }
}

/// A phase's share of a face as a linear function of the solids fraction there before and after
/// the step: `constant + before φ + after φ'`.
#[derive(Clone, Copy)]
pub(super) struct Share<R> {
    pub(super) constant: R,
    pub(super) before: R,
    pub(super) after: R,
}

impl<R: Real> Share<R> {
    /// The solids' share, ghost mass included, before and after the step.
    pub(super) fn solids() -> [Self; 2] {
        let constant = R::of(GHOST);
        [
            Self { constant, before: R::ONE, after: R::ZERO },
            Self { constant, before: R::ZERO, after: R::ONE },
        ]
    }

    /// The gas's share a part `t` through the step.
    pub(super) fn gas(t: f64) -> Self {
        Self { constant: R::ONE, before: R::of(t - 1.0), after: R::of(-t) }
    }
}

/// Momentum along `axis` of one phase carried by its `flux`: the share of a face times its
/// velocity is conserved; `courant` is dt/h along each axis.
#[allow(clippy::too_many_arguments)]
pub(super) fn advect_momentum<R: Real, const D: usize>(
    rows: &Rows<D>,
    axis: usize,
    new: &mut Field<R, D>,
    velocities: &Faces<R, D>,
    flux: &Faces<R, D>,
    [phi, phi_new]: [&Field<R, D>; 2],
    shares: [Share<R>; 2],
    courant: [R; D],
) {
    let s = rows.stride(axis);
    let velocity = &velocities[axis];
    rows.each([new], |o, [new]| {
        // Two neighbours on either side, then the pairs of fluxes, and of velocities, whose means
        // cross the lower and the upper face of the velocity's own cell.
        let axes = std::array::from_fn(|b| {
            let (sb, flux, speed) = (rows.stride(b), &flux[b], &velocities[b]);
            [
                velocity.row(o - 2 * sb),
                velocity.row(o - sb),
                velocity.row(o + sb),
                velocity.row(o + 2 * sb),
                flux.row(o - s),
                flux.row(o),
                flux.row(o - s + sb),
                flux.row(o + sb),
                speed.row(o - s),
                speed.row(o),
                speed.row(o - s + sb),
                speed.row(o + sb),
            ]
        });
        let fractions = [phi.row(o - s), phi.row(o), phi_new.row(o - s), phi_new.row(o)];
        momentum_row(new, velocity.row(o), axes, fractions, shares, courant);
    });
}

simd! {
    fn momentum_row[R: Real, const D: usize](
        new: &mut [R],
        u: &[R],
        axes: [[&[R]; 12]; D],
        fractions: [&[R]; 4],
        shares: [Share<R>; 2],
        courant: [R; D],
    ) {
        let n = new.len();
        let u = &u[..n];
        let axes = by_axis(axes, n);
        let [below, here, below_new, here_new] = fractions.map(|f| &f[..n]);
        let half = R::of(0.5);
        for i in 0..n {
            let before = half * (below[i] + here[i]);
            let after = half * (below_new[i] + here_new[i]);
            let share = shares.map(|s| s.constant + s.before * before + s.after * after);
            let outflow = sum_axes!(D, axes, |[m2, m1, p1, p2, f0, f1, f2, f3, v0, v1, v2, v3], b| {
                let lower = half * (f0[i] + f1[i]);
                let upper = half * (f2[i] + f3[i]);
                let half_courant = half * courant[b];
                let below = half_courant * (v0[i] + v1[i]).abs();
                let above = half_courant * (v2[i] + v3[i]).abs();
                courant[b]
                    * (upper * upwind(upper, above, m1[i], u[i], p1[i], p2[i])
                        - lower * upwind(lower, below, m2[i], m1[i], u[i], p1[i]))
            });
            let momentum = share[0] * u[i] - outflow;
            new[i] = momentum / share[1];
        }
    }
}
