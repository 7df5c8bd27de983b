//! Forces on both phases and their exchange of momentum, implicit on each face; the correction by
//! the pressure.

use super::{GHOST, Medium};
use crate::poisson::Fast;
use crate::real::Real;
use crate::rows::{BLOCK, by_axis, cut, max_abs, simd, sum_axes};

/// What a face's equations of motion need besides velocities and pressures.
#[derive(Clone, Copy)]
pub(super) struct Inertia<R> {
    /// ρ_s / dt.
    solids: R,
    /// ρ_g / dt.
    gas: R,
}

/// Mobilities of a face: how the two momentum balances
/// a_s u_s' = f_s + β (u_g' - u_s'), a_g u_g' = f_g - β (u_g' - u_s') answer to their forces.
#[derive(Clone, Copy)]
struct Mobility<R> {
    solids_inertia: R,
    gas_inertia: R,
    beta: R,
    inverse: R,
    phi: R,
}

impl<R: Real> Inertia<R> {
    pub(super) fn new(medium: &Medium<R>, dt: R) -> Self {
        Self { solids: medium.solids_density / dt, gas: medium.gas_density / dt }
    }

    /// At a face between cells of fractions `phi` and drag per fraction `drag`.
    #[inline(always)]
    fn mobility(&self, phi: [R; 2], drag: [R; 2]) -> Mobility<R> {
        let half = R::of(0.5);
        let face = half * (phi[0] + phi[1]);
        let beta = half * (phi[0] * drag[0] + phi[1] * drag[1]);
        let a_s = self.solids * (face + R::of(GHOST));
        let a_g = self.gas * (R::ONE - face);
        let inverse = R::ONE / (a_s * a_g + beta * (a_s + a_g));
        Mobility { solids_inertia: a_s, gas_inertia: a_g, beta, inverse, phi: face }
    }
}

impl<R: Real> Mobility<R> {
    /// Velocities (u_s', u_g') under forces per volume that include a_k u_k.
    #[inline(always)]
    fn velocities(&self, solids: R, gas: R) -> (R, R) {
        let total = self.beta * (solids + gas);
        (
            (self.gas_inertia * solids + total) * self.inverse,
            (self.solids_inertia * gas + total) * self.inverse,
        )
    }

    /// Loss of (u_s, u_g) per pressure gradient, which pushes each phase by its fraction.
    #[inline(always)]
    fn response(&self) -> (R, R) {
        let (solids, gas) = (self.phi, R::ONE - self.phi);
        (
            (self.gas_inertia * solids + self.beta) * self.inverse,
            (self.solids_inertia * gas + self.beta) * self.inverse,
        )
    }

    /// Gain of (u_s, u_g) by forces per volume, each phase's by its fraction.
    #[inline(always)]
    fn driven(&self, force: [R; 2]) -> (R, R) {
        self.velocities(self.phi * force[0], (R::ONE - self.phi) * force[1])
    }

    /// φ u_s + (1-φ) u_g.
    #[inline(always)]
    fn total(&self, (solids, gas): (R, R)) -> R {
        self.phi * solids + (R::ONE - self.phi) * gas
    }
}

simd! {
    /// Velocities along one axis under the old gas pressure, the solids pressure, weight, the mean
    /// pressure gradient that balances it, and drag. Leaves the total volume flux and its response
    /// to the pressure times `weight`.
    ///
    /// `buoyancy` is g (ρ_mean - ρ_k) for solids and gas along this axis: weight and mean pressure
    /// gradient together. Pairs of rows are the cells below and above the faces.
    pub(super) fn predict_row[R: Real](
        us: &mut [R],
        ug: &mut [R],
        flux: &mut [R],
        response: &mut [Fast],
        carried: [&[R]; 2],
        phi: [&[R]; 2],
        drag: [&[R]; 2],
        solids_pressure: [&[R]; 2],
        gas_pressure: [&[R]; 2],
        inertia: Inertia<R>,
        buoyancy: [R; 2],
        inverse_spacing: R,
        weight: R,
    ) {
        let n = us.len();
        let (ug, flux, response) = (&mut ug[..n], &mut flux[..n], &mut response[..n]);
        let carried = cut(carried, n);
        let (phi, drag) = (cut(phi, n), cut(drag, n));
        let solids_pressure = cut(solids_pressure, n);
        let gas_pressure = cut(gas_pressure, n);
        for i in 0..n {
            let face = inertia.mobility(phi.map(|q| q[i]), drag.map(|q| q[i]));
            let gradient = inverse_spacing * (gas_pressure[1][i] - gas_pressure[0][i]);
            let collisions = inverse_spacing * (solids_pressure[1][i] - solids_pressure[0][i]);
            let solids = face.solids_inertia * carried[0][i] - collisions
                + face.phi * (buoyancy[0] - gradient);
            let gas = face.gas_inertia * carried[1][i]
                + (R::ONE - face.phi) * (buoyancy[1] - gradient);
            let velocities = face.velocities(solids, gas);
            (us[i], ug[i]) = velocities;
            flux[i] = face.total(velocities);
            response[i] = (weight * face.total(face.response())).f64() as Fast;
        }
    }
}

simd! {
    /// Takes the response to the pressure increment off the velocities along one axis.
    pub(super) fn correct_row[R: Real](
        us: &mut [R],
        ug: &mut [R],
        phi: [&[R]; 2],
        drag: [&[R]; 2],
        increment: [&[R]; 2],
        inertia: Inertia<R>,
        inverse_spacing: R,
    ) {
        let n = us.len();
        let (ug, phi, drag) = (&mut ug[..n], cut(phi, n), cut(drag, n));
        let increment = cut(increment, n);
        for i in 0..n {
            let face = inertia.mobility(phi.map(|q| q[i]), drag.map(|q| q[i]));
            let gradient = inverse_spacing * (increment[1][i] - increment[0][i]);
            let (solids, gas) = face.response();
            us[i] -= solids * gradient;
            ug[i] -= gas * gradient;
        }
    }
}

simd! {
    /// Adds `whole` to the velocities of the solids along one axis, and to those of the gas what makes
    /// the total volume flux grow by `total`.
    pub(super) fn drive_row[R: Real](
        us: &mut [R],
        ug: &mut [R],
        phi: [&[R]; 2],
        total: R,
        whole: R,
    ) {
        let n = us.len();
        let (ug, phi) = (&mut ug[..n], cut(phi, n));
        for i in 0..n {
            let face = R::of(0.5) * (phi[0][i] + phi[1][i]);
            us[i] += whole;
            ug[i] += (total - face * whole) / (R::ONE - face);
        }
    }
}

/// Sums over a row of faces: φ, φ u_s, (1-φ) u_g, and what the last two gain by
/// forces per volume, each phase's by its fraction.
pub(super) fn driven_sums<R: Real>(
    velocities: [&[R]; 2],
    phi: [&[R]; 2],
    drag: [&[R]; 2],
    inertia: Inertia<R>,
    force: [R; 2],
) -> [f64; 5] {
    let mut sums = [0.0; 5];
    for i in 0..velocities[0].len() {
        let face = inertia.mobility(phi.map(|q| q[i]), drag.map(|q| q[i]));
        let (solids, gas) = face.driven(force);
        let phi = face.phi.f64();
        sums[0] += phi;
        sums[1] += phi * velocities[0][i].f64();
        sums[2] += (1.0 - phi) * velocities[1][i].f64();
        sums[3] += phi * solids.f64();
        sums[4] += (1.0 - phi) * gas.f64();
    }
    sums
}

simd! {
    /// -∇·`flux`, the right-hand side of the pressure equation.
    pub(super) fn convergence_row[R: Real, const D: usize](
        out: &mut [R],
        flux: [[&[R]; 2]; D],
        inverse_spacing: [R; D],
    ) {
        let n = out.len();
        let flux = by_axis(flux, n);
        for i in 0..n {
            out[i] = sum_axes!(D, flux, |[lower, upper], a| {
                inverse_spacing[a] * (lower[i] - upper[i])
            });
        }
    }
}

simd! {
    /// x += y.
    pub(super) fn add_row[R: Real](x: &mut [R], y: &[R]) {
        let y = &y[..x.len()];
        for (x, y) in x.iter_mut().zip(y) {
            *x += *y;
        }
    }
}

/// Largest rates of some cells \[1/s\], of [`rates_row`]; `blocks` says where blocks of them begin and
/// how many are in each.
pub(super) fn largest_rates<R: Real, const D: usize>(
    blocks: impl Iterator<Item = (usize, usize)>,
    solids: [[&[R]; 2]; D],
    gas: [[&[R]; 2]; D],
    phi: [[&[R]; 3]; D],
    thin: R,
    packed: [R; 2],
    inverse_spacing: [R; D],
) -> [R; 3] {
    let mut largest = [R::ZERO; 3];
    let mut rates = [[R::ZERO; BLOCK]; 3];
    for (begin, m) in blocks {
        let [fast, carrying, filling] = &mut rates;
        rates_row(
            &mut fast[..m],
            &mut carrying[..m],
            &mut filling[..m],
            solids.map(|faces| faces.map(|u| &u[begin..])),
            gas.map(|faces| faces.map(|u| &u[begin..])),
            phi.map(|line| line.map(|phi| &phi[begin..])),
            thin,
            packed,
            inverse_spacing,
        );
        for (largest, rates) in largest.iter_mut().zip(&rates) {
            *largest = largest.max(max_abs(&rates[..m]));
        }
    }
    largest
}

simd! {
    /// Rates of the cells of a row \[1/s\]: Σ_a |u_a| / h_a, each |u_a| the larger of its two
    /// faces, of the solids where their fraction is above `thin`, and of the gas; and -∇·(φ u_s), or 0,
    /// what fills a cell, over the room that is left in it: what it lacks to the fraction `packed`, at least
    /// `least`. `phi` is below, here and above along each axis.
    fn rates_row[R: Real, const D: usize](
        fast: &mut [R],
        carrying: &mut [R],
        filling: &mut [R],
        solids: [[&[R]; 2]; D],
        gas: [[&[R]; 2]; D],
        phi: [[&[R]; 3]; D],
        thin: R,
        packed: [R; 2],
        inverse_spacing: [R; D],
    ) {
        let n = fast.len();
        let (carrying, filling) = (&mut carrying[..n], &mut filling[..n]);
        let (solids, gas, phi) = (by_axis(solids, n), by_axis(gas, n), by_axis(phi, n));
        let here = phi[0][1];
        let [packed, least] = packed;
        let half = R::of(0.5);
        for i in 0..n {
            let rate = sum_axes!(D, solids, |[lower, upper], a| {
                inverse_spacing[a] * lower[i].abs().max(upper[i].abs())
            });
            fast[i] = R::select(here[i] > thin, rate, R::ZERO);
            carrying[i] = sum_axes!(D, gas, |[lower, upper], a| {
                inverse_spacing[a] * lower[i].abs().max(upper[i].abs())
            });
            // What limited slopes may make of what flows in; what flows out is a mean.
            let inflow = sum_axes!(D, solids, |[lower, upper], a| {
                let [below, here, above] = phi[a];
                let (below, here, above) = (below[i], here[i], above[i]);
                let (up, down) = (lower[i].max(R::ZERO), -upper[i].min(R::ZERO));
                let (from, to) = (lower[i].min(R::ZERO), -upper[i].max(R::ZERO));
                inverse_spacing[a]
                    * (up * below.max(here)
                        + down * above.max(here)
                        + half * (from * (below + here) + to * (here + above)))
            });
            filling[i] = (inflow / (packed - here[i]).max(least)).max(R::ZERO);
        }
    }
}
