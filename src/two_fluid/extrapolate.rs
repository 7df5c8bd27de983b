//! Second order in time, by Richardson's extrapolation of every step.
//!
//! A step is first order in time: drag is implicit, and what one field does to another takes turns.
//! A step of dt, A, and two of dt/2 from the same start, B, differ by half the error of the one, so
//! that B + (B - A) has none of first order. What is extrapolated is what is conserved (φ, φ T, the
//! momentum of each phase on each face), hence mass and momentum stay kept to round-off, and the
//! total volume flux, linear in the momenta, free of divergence. Where steps are long for what
//! happens in them, B + (B - A) may be no state at all; then all cells take as much of B - A as every
//! cell can bear.
//!
//! Costs three steps for one, and memory for two more states; without it a step costs what it costs
//! without this file.

use super::sweep::Fastest;
use super::{GHOST, Limit, PACKED, StepError, StepReport, TwoFluid};
use crate::drive::GasFlux;
use crate::field::{Faces, Field, Layout};
use crate::real::Real;
use crate::rows::{cut, simd};

/// A state, as far as it is extrapolated or started from again.
struct Kept<R, const D: usize> {
    phi: Field<R, D>,
    theta: Field<R, D>,
    pressure: Field<R, D>,
    solids: Faces<R, D>,
    gas: Faces<R, D>,
    gas_flux: Option<GasFlux>,
}

impl<R: Real, const D: usize> Kept<R, D> {
    fn zeros(layout: Layout<D>) -> Self {
        let zeros = || Field::zeros(layout);
        Self {
            phi: zeros(),
            theta: zeros(),
            pressure: zeros(),
            solids: Field::zero_faces(layout),
            gas: Field::zero_faces(layout),
            gas_flux: None,
        }
    }
}

/// Where a step starts, and the end of the step of dt.
pub(super) struct Extrapolation<R, const D: usize> {
    start: Kept<R, D>,
    whole: Kept<R, D>,
}

impl<R: Real, const D: usize> Extrapolation<R, D> {
    pub(super) fn new(layout: Layout<D>) -> Self {
        Self { start: Kept::zeros(layout), whole: Kept::zeros(layout) }
    }
}

simd! {
    /// The largest share of B - A, up to 1, that leaves half of φ and of φ T of every cell of B at
    /// least, and fills none beyond `packed`. Each pair is A and B.
    fn share_row[R: Real](phi: [&[R]; 2], theta: [&[R]; 2], packed: R) -> R {
        const LANES: usize = 16;
        let n = phi[0].len();
        let (phi, theta) = (cut(phi, n), cut(theta, n));
        let (half, tiny, ghost) = (R::of(0.5), R::of(1e-30), R::of(GHOST));
        let mut least = [R::ONE; LANES];
        for i in 0..n {
            let [a, b] = [phi[0][i], phi[1][i]];
            let [heat_a, heat_b] = [(a + ghost) * theta[0][i], (b + ghost) * theta[1][i]];
            let solids = half * b / (a - b).max(tiny);
            let heat = half * heat_b / (heat_a - heat_b).max(tiny);
            let room = (packed - b).max(R::ZERO) / (b - a).max(tiny);
            // An empty cell that stays empty bears anything.
            let bears = |q: R, most: R| R::select(q > R::ZERO, most, R::ONE);
            let share = bears(a - b, solids).min(bears(heat_a - heat_b, heat)).min(bears(b - a, room));
            least[i % LANES] = least[i % LANES].min(share);
        }
        least.into_iter().fold(R::ONE, R::min)
    }
}

simd! {
    /// φ = φ_B + share (φ_B - φ_A), and T of φ T so. Each pair is A and B.
    fn cells_row[R: Real](
        phi_new: &mut [R],
        theta_new: &mut [R],
        phi: [&[R]; 2],
        theta: [&[R]; 2],
        share: R,
    ) {
        let n = phi_new.len();
        let theta_new = &mut theta_new[..n];
        let (phi, theta) = (cut(phi, n), cut(theta, n));
        let (ghost, own) = (R::of(GHOST), R::ONE + share);
        for i in 0..n {
            let [a, b] = [phi[0][i], phi[1][i]];
            let solids = own * b - share * a;
            let heat = own * (b + ghost) * theta[1][i] - share * (a + ghost) * theta[0][i];
            phi_new[i] = solids;
            theta_new[i] = heat / (solids + ghost);
        }
    }
}

simd! {
    /// u_s and u_g of (φ + ghost) u_s and (1-φ) u_g extrapolated as in [`cells_row`]; `phi` are those of
    /// A and B, each below the face and above it.
    fn faces_row[R: Real](
        us_new: &mut [R],
        ug_new: &mut [R],
        us: [&[R]; 2],
        ug: [&[R]; 2],
        phi: [[&[R]; 2]; 2],
        share: R,
    ) {
        let n = us_new.len();
        let ug_new = &mut ug_new[..n];
        let (us, ug) = (cut(us, n), cut(ug, n));
        let phi = [cut(phi[0], n), cut(phi[1], n)];
        let (half, ghost, own) = (R::of(0.5), R::of(GHOST), R::ONE + share);
        for i in 0..n {
            let [a, b] = [half * (phi[0][0][i] + phi[0][1][i]), half * (phi[1][0][i] + phi[1][1][i])];
            let face = own * b - share * a;
            let solids = own * (b + ghost) * us[1][i] - share * (a + ghost) * us[0][i];
            let gas = own * (R::ONE - b) * ug[1][i] - share * (R::ONE - a) * ug[0][i];
            us_new[i] = solids / (face + ghost);
            ug_new[i] = gas / (R::ONE - face);
        }
    }
}

simd! {
    /// q += share (q - q_A).
    fn extrapolate_row[R: Real](q: &mut [R], whole: &[R], share: R) {
        let whole = &whole[..q.len()];
        for (q, whole) in q.iter_mut().zip(whole) {
            *q += share * (*q - *whole);
        }
    }
}

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// With steps of second order in time, each made of three, where the flow is smooth.
    #[must_use]
    pub fn with_second_order(mut self) -> Self {
        self.extrapolation = Some(Box::new(Extrapolation::new(self.rows.layout())));
        self
    }

    /// A step of `dt` \[s\] from the state, of the order in time that was asked for.
    pub(super) fn advance(
        &mut self,
        dt: f64,
        limit: Limit,
    ) -> Result<(StepReport, Fastest<f64>), StepError> {
        let Some(mut extrapolation) = self.extrapolation.take() else {
            return self.advance_once(dt, limit);
        };
        let advanced = self.extrapolate(dt, limit, &mut extrapolation);
        self.extrapolation = Some(extrapolation);
        advanced
    }

    fn extrapolate(
        &mut self,
        dt: f64,
        limit: Limit,
        Extrapolation { start, whole }: &mut Extrapolation<R, D>,
    ) -> Result<(StepReport, Fastest<f64>), StepError> {
        self.copy_to(start);
        let (long, long_fastest) = self.advance_once(dt, limit)?;
        self.exchange_with(whole);
        self.exchange_with(start);
        self.find_speeds();
        let (first, _) = self.advance_half(0, dt, limit)?;
        self.find_speeds();
        let (second, fastest) = self.advance_half(1, dt, limit)?;

        let rows = self.rows;
        let packed = R::of(self.setup.powder.max_packing + PACKED);
        let (phi, theta) = ([&whole.phi, &self.phi], [&whole.theta, &self.theta]);
        let share = rows
            .fold(&|o| share_row(phi.map(|q| q.row(o)), theta.map(|q| q.row(o)), packed), &R::min);
        rows.each([&mut self.phi_new, &mut self.theta_new], |o, [phi_new, theta_new]| {
            cells_row(phi_new, theta_new, phi.map(|q| q.row(o)), theta.map(|q| q.row(o)), share);
        });
        for axis in 0..D {
            let (us, ug) =
                ([&whole.solids[axis], &self.solids[axis]], [&whole.gas[axis], &self.gas[axis]]);
            let outputs = [&mut self.solids_new[axis], &mut self.gas_new[axis]];
            rows.each(outputs, |o, [us_new, ug_new]| {
                let phi = phi.map(|q| [q.row(o.near(axis, -1)), q.row(o)]);
                faces_row(us_new, ug_new, us.map(|u| u.row(o)), ug.map(|u| u.row(o)), phi, share);
            });
        }
        rows.each([&mut self.pressure], |o, [p]| extrapolate_row(p, whole.pressure.row(o), share));
        if let (Some(flux), Some(whole)) = (&mut self.gas_flux, whole.gas_flux) {
            flux.gradient += share.f64() * (flux.gradient - whole.gradient);
        }
        std::mem::swap(&mut self.phi, &mut self.phi_new);
        std::mem::swap(&mut self.theta, &mut self.theta_new);
        std::mem::swap(&mut self.solids, &mut self.solids_new);
        std::mem::swap(&mut self.gas, &mut self.gas_new);
        let report = StepReport {
            dt,
            limit,
            gas_steps: long.gas_steps + first.gas_steps + second.gas_steps,
            iterations: long.iterations + first.iterations + second.iterations,
            volume_residual: [first.volume_residual, second.volume_residual]
                .into_iter()
                .fold(long.volume_residual, f64::max),
        };
        Ok((report, long_fastest.or(fastest)))
    }

    /// The first or the second half of a step of `dt`, with the sources of that half if it has its own.
    fn advance_half(
        &mut self,
        half: usize,
        dt: f64,
        limit: Limit,
    ) -> Result<(StepReport, Fastest<f64>), StepError> {
        let own = self.half_sources[half].is_some();
        if own {
            std::mem::swap(&mut self.sources, &mut self.half_sources[half]);
        }
        let advanced = self.advance_once(0.5 * dt, limit);
        if own {
            std::mem::swap(&mut self.sources, &mut self.half_sources[half]);
        }
        advanced
    }

    /// Leaves a copy of the state.
    fn copy_to(&self, kept: &mut Kept<R, D>) {
        kept.phi.copy_from(&self.phi);
        kept.theta.copy_from(&self.theta);
        kept.pressure.copy_from(&self.pressure);
        for axis in 0..D {
            kept.solids[axis].copy_from(&self.solids[axis]);
            kept.gas[axis].copy_from(&self.gas[axis]);
        }
        kept.gas_flux = self.gas_flux;
    }

    /// Takes the state that was kept, and leaves its own.
    fn exchange_with(&mut self, kept: &mut Kept<R, D>) {
        std::mem::swap(&mut self.phi, &mut kept.phi);
        std::mem::swap(&mut self.theta, &mut kept.theta);
        std::mem::swap(&mut self.pressure, &mut kept.pressure);
        std::mem::swap(&mut self.solids, &mut kept.solids);
        std::mem::swap(&mut self.gas, &mut kept.gas);
        std::mem::swap(&mut self.gas_flux, &mut kept.gas_flux);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::setup;
    use super::*;
    use crate::grid::Grid;

    fn flow<const D: usize>(cells: [usize; D], perturbation: f64) -> TwoFluid<f64, D> {
        let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
        TwoFluid::new(grid, setup(0.15, perturbation)).with_second_order()
    }

    #[test]
    fn mass_and_momentum_are_kept_in_a_clustered_bed() {
        let mut flow = flow([32, 32], 0.5);
        let start = flow.means();
        for _ in 0..1500 {
            flow.step(f64::INFINITY).unwrap();
            assert!(flow.phi.min() >= 0.0 && flow.theta.min() >= 0.0);
        }
        let end = flow.means();
        assert!(end.solids_fraction_variance > 5e-3, "{}", end.solids_fraction_variance);
        assert!((end.solids_fraction / start.solids_fraction - 1.0).abs() < 1e-13);
        for axis in 0..2 {
            let drift = (end.momentum[axis] - start.momentum[axis]) / (1500.0 * 0.15 * 0.22);
            assert!(drift.abs() < 1e-12, "{drift:e} along {axis}");
        }
    }

    #[test]
    fn a_state_goes_on_to_the_same_bits() {
        let mut long = flow([16, 24], 0.3);
        for _ in 0..100 {
            long.step(f64::INFINITY).unwrap();
        }
        let mut state = Vec::new();
        long.save_state(&mut state).unwrap();
        let mut again = flow([16, 24], 0.3);
        again.restore_state(&mut state.as_slice()).unwrap();
        for flow in [&mut long, &mut again] {
            for _ in 0..50 {
                flow.step(f64::INFINITY).unwrap();
            }
        }
        let bytes = |flow: &TwoFluid<f64, 2>| {
            let mut bytes = Vec::new();
            flow.save_state(&mut bytes).unwrap();
            bytes
        };
        assert!(bytes(&long) == bytes(&again));
    }
}
