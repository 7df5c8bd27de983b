//! Transport by the volume fluxes: solids fraction, granular temperature, momentum of both phases.
//!
//! All of it is conservative and moves with the same fluxes, so that a uniform velocity or
//! temperature stays uniform whatever the solids do, and a nearly empty cell takes a weighted mean
//! of what flows in.

use super::GHOST;
use crate::field::{Lines, Row};
use crate::real::Real;
use crate::rows::{by_axis, cut, simd, sum_axes};
use crate::stencil::upwind;

/// Four neighbours in a line across a face: two on either side.
#[derive(Clone, Copy)]
pub(super) struct Line<'a, R>([&'a [R]; 4]);

impl<'a, R: Real> Line<'a, R> {
    /// Across the lower faces of `row` along `axis`.
    #[inline(always)]
    pub(super) fn at<const D: usize>(q: &'a impl Lines<R, D>, row: Row<D>, axis: usize) -> Self {
        Self(q.across(row, axis))
    }

    #[inline(always)]
    fn cut(self, n: usize) -> Self {
        Self(cut(self.0, n))
    }

    #[inline(always)]
    fn upwind(&self, through: R, courant: R, i: usize) -> R {
        upwind(through, courant, self.0[0][i], self.0[1][i], self.0[2][i], self.0[3][i])
    }
}

simd! {
    /// The largest ratio of what crosses a face to what the upwind cell holds per volume at which
    /// the cell is not overdrawn, over all its faces: 1/Σ c of the faces that the cell flows out
    /// of, c their Courant numbers. A trace stays behind, so that round-off cannot overdraw it.
    pub(super) fn most_row[R: Real, const D: usize](
        most: &mut [R],
        velocity: [[&[R]; 2]; D],
        courant: [R; D],
    ) {
        let n = most.len();
        let velocity = by_axis(velocity, n);
        for i in 0..n {
            let outflow = sum_axes!(D, velocity, |[lower, upper], a| {
                courant[a] * (upper[i].max(R::ZERO) - lower[i].min(R::ZERO))
            });
            most[i] = R::of(1.0 - 1e-6) / (outflow + R::of(1e-30));
        }
    }
}

/// Whether the fluxes of the gas and those of temperature are wanted: a kernel for each answer.
#[derive(Clone, Copy)]
pub(super) struct Wanted<const GAS: bool, const HEAT: bool>;

simd! {
    /// Volume fluxes through the lower faces of a row along one axis \[m/s\]: of solids, of gas, and of
    /// solids times temperature. The gas takes what the solids leave of the total, which the
    /// pressure has made free of divergence. `most` is that of [`most_row`] on either side. `fg`
    /// and `ft` are made only if wanted.
    pub(super) fn flux_row[R: Real, const GAS: bool, const HEAT: bool](
        fs: &mut [R],
        fg: &mut [R],
        ft: &mut [R],
        phi: Line<'_, R>,
        theta: Line<'_, R>,
        us: &[R],
        ug: &[R],
        most: [&[R]; 2],
        courant: R,
        _wanted: Wanted<GAS, HEAT>,
    ) {
        let n = fs.len();
        let (phi, theta, most) = (phi.cut(n), theta.cut(n), cut(most, n));
        let (fg, ft, us, ug) = (&mut fg[..n], &mut ft[..n], &us[..n], &ug[..n]);
        for i in 0..n {
            let face = R::of(0.5) * (phi.0[1][i] + phi.0[2][i]);
            let total = face * us[i] + (R::ONE - face) * ug[i];
            let crossing = courant * us[i].abs();
            let forward = us[i] > R::ZERO;
            // Limited slopes alone keep φ and T positive up to a Courant number of one half; these
            // bounds do up to one.
            let most = R::select(forward, most[0][i], most[1][i]);
            let bound = most * R::select(forward, phi.0[1][i], phi.0[2][i]);
            let solids = phi.upwind(us[i], crossing, i).min(bound);
            fs[i] = us[i] * solids;
            if GAS {
                fg[i] = total - us[i] * solids;
            }
            if HEAT {
                let warmest = bound * R::select(forward, theta.0[1][i], theta.0[2][i]);
                let heat = (solids * theta.upwind(us[i], crossing, i)).min(warmest);
                ft[i] = us[i] * heat;
            }
        }
    }
}

simd! {
    /// φ and T after `dt` from the fluxes: φ' = φ - dt ∇·F, φ' T' = φ T - dt ∇·(F T).
    pub(super) fn advect_row[R: Real, const D: usize](
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

simd! {
    /// φ after `dt` from its fluxes: φ' = φ - dt ∇·F.
    pub(super) fn advect_solids_row[R: Real, const D: usize](
        phi_new: &mut [R],
        phi: &[R],
        fs: [[&[R]; 2]; D],
        courant: [R; D],
    ) {
        let n = phi_new.len();
        let (phi, fs) = (&phi[..n], by_axis(fs, n));
        for i in 0..n {
            let solids = sum_axes!(D, fs, |[lower, upper], a| courant[a] * (upper[i] - lower[i]));
            phi_new[i] = phi[i] - solids;
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

    /// Of the sums of the fractions on either side of the face, before and after.
    #[inline(always)]
    fn of_sums(&self, before: R, after: R) -> R {
        let half = R::of(0.5);
        self.constant + half * self.before * before + half * self.after * after
    }

    /// The gas's share a part `t` through the step.
    pub(super) fn gas(t: f64) -> Self {
        Self { constant: R::ONE, before: R::of(t - 1.0), after: R::of(-t) }
    }
}

simd! {
    /// One velocity component of a gas that carries no momentum along: what momentum there is at a
    /// face stays there, (1-φ') u' = (1-φ) u. `fractions` are those of [`momentum_row`].
    pub(super) fn stay_row[R: Real](new: &mut [R], u: &[R], fractions: [&[R]; 4]) {
        let n = new.len();
        let u = &u[..n];
        let [below, here, below_new, here_new] = cut(fractions, n);
        let two = R::of(2.0);
        for i in 0..n {
            new[i] = u[i] * (two - (below[i] + here[i])) / (two - (below_new[i] + here_new[i]));
        }
    }
}

/// What carries one velocity component of a phase across the lower sides of the component's cells along one
/// axis. Means of the pairs of fluxes and velocities cross there.
#[derive(Clone, Copy)]
pub(super) struct Crossing<'a, R> {
    pub(super) component: Line<'a, R>,
    /// Volume fluxes of the phase along the axis \[m/s\].
    pub(super) flux: [&'a [R]; 2],
    /// Its velocities along the axis \[m/s\].
    pub(super) velocity: [&'a [R]; 2],
    /// dt/h along the axis \[s/m\].
    pub(super) courant: R,
}

impl<R: Real> Crossing<'_, R> {
    #[inline(always)]
    fn cut(&self, n: usize) -> Self {
        Self {
            component: self.component.cut(n),
            flux: cut(self.flux, n),
            velocity: cut(self.velocity, n),
            courant: self.courant,
        }
    }

    /// Momentum per volume and density that is carried across, times dt/h.
    #[inline(always)]
    fn carried(&self, i: usize) -> R {
        let half = R::of(0.5) * self.courant;
        let through = half * (self.flux[0][i] + self.flux[1][i]);
        let crossing = half * (self.velocity[0][i] + self.velocity[1][i]).abs();
        through * self.component.upwind(through, crossing, i)
    }
}

simd! {
    /// [`Crossing::carried`] of a row.
    pub(super) fn carry_row[R: Real](out: &mut [R], crossing: &Crossing<'_, R>) {
        let n = out.len();
        let crossing = crossing.cut(n);
        for i in 0..n {
            out[i] = crossing.carried(i);
        }
    }
}

simd! {
    /// One velocity component of a phase after its momentum was carried: the share of a face times
    /// its velocity is conserved. `fractions` are φ below and above the face, before and after.
    ///
    /// What crosses the sides along the first axis is made here, in `within`, which has room for one side
    /// more than there are cells; `cells` make a row. What crosses the upper sides along the last axis is
    /// made here and left in `on`; what crosses the lower ones is `below`. In three dimensions `middle`
    /// crosses the lower and the upper sides along the second axis.
    pub(super) fn momentum_row[R: Real, const D: usize](
        new: &mut [R],
        on: &mut [R],
        within: &mut [R],
        cells: usize,
        u: &[R],
        first: &Crossing<'_, R>,
        last: &Crossing<'_, R>,
        below: &[R],
        middle: [[&[R]; 2]; D],
        fractions: [&[R]; 4],
        shares: [Share<R>; 2],
    ) {
        let n = new.len();
        let (on, within) = (&mut on[..n], &mut within[..n + 1]);
        let (first, last) = (first.cut(n), last.cut(n));
        {
            let within = &mut within[..n];
            for i in 0..n {
                within[i] = first.carried(i);
            }
        }
        // The last side of a row is its first.
        within[n] = within[n - cells];
        // In a loop of its own, so that the sides above are in memory when they are asked for: a processor
        // is slow to hand on what lies across two of its last writes.
        for i in 0..n {
            on[i] = last.carried(i);
        }
        let u = &u[..n];
        let (lower, upper) = (&within[..n], &within[1..]);
        let upper = &upper[..n];
        let (below, [_, [left, right], _]) = (&below[..n], by_axis(middle, n));
        let [under, here, under_new, here_new] = cut(fractions, n);
        for i in 0..n {
            let (before, after) = (under[i] + here[i], under_new[i] + here_new[i]);
            let old = shares[0].of_sums(before, after);
            let new_share = shares[1].of_sums(before, after);
            let mut outflow = upper[i] - lower[i];
            if D == 3 {
                outflow += right[i] - left[i];
            }
            outflow += on[i] - below[i];
            new[i] = (old * u[i] - outflow) / new_share;
        }
    }
}
