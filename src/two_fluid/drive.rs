//! A mean gas pressure gradient that keeps the flux of the gas, as of [`crate::drive`].
//!
//! A kept gas flux costs two passes over the vertical faces. A mean gradient takes no part in
//! φ' ∂p'/∂y, the covariance by which pressure enters the filtered drag.

use super::exchange::{self, Inertia};
use super::{GHOST, TwoFluid, uniform_slip};
use crate::drive::{GasFlux, uniform_velocities};
use crate::real::Real;

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// With a mean pressure gradient that keeps the superficial velocity of the gas relative to the
    /// mean velocity of the solids, ⟨(1-φ) u_g⟩ - ⟨1-φ⟩ ⟨φ u_s⟩/⟨φ⟩, at `gas_flux` \[m/s\], or at that of
    /// the uniform state; in place of one that balances the weight. For a flow that is new: its
    /// velocities become uniform ones of that flux.
    #[must_use]
    pub fn with_gas_flux(mut self, gas_flux: Option<f64>) -> Self {
        let setup = self.setup;
        let (powder, gas, up) = (&setup.powder, &setup.gas, D - 1);
        let mean = self.phi.mean();
        let slip = gas_flux.map_or_else(|| uniform_slip(&setup), |flux| flux / (1.0 - mean));
        let [solids, carrier] = uniform_velocities(powder, gas, mean, slip);
        self.solids[up].set(|_| R::of(solids));
        self.gas[up].set(|_| R::of(carrier));
        let law = setup.drag.law(gas, powder);
        self.gas_flux = Some(GasFlux::uniform(slip, mean, &law, powder, gas, setup.gravity));
        self.find_speeds();
        self
    }

    /// Mean pressure gradient over the weight of the mixture; 1 unless a gas flux is kept.
    pub fn pressure_gradient(&self) -> f64 {
        self.gas_flux.map_or(1.0, |flux| flux.gradient)
    }

    /// Weight less the mean pressure gradient's push in the frame of the mixture, for solids and
    /// gas \[N/m³\].
    pub(super) fn driven(&self) -> [R; 2] {
        let push = |flux: GasFlux| self.buoyancy.map(|b| R::of(flux.gradient) * b);
        self.gas_flux.map_or(self.buoyancy, push)
    }

    /// Makes the gas flux what is wanted after a step of `dt` \[s\], by a change of the velocities that
    /// has neither divergence nor momentum, and the mean pressure gradient one that would have
    /// made it so, for the next step: if the one is right, the other is nothing.
    pub(super) fn keep_gas_flux(&mut self, dt: f64) {
        let Some(mut flux) = self.gas_flux else { return };
        let (rows, up, force) = (self.rows, D - 1, self.buoyancy);
        let inertia = Inertia::new(&self.medium, R::of(dt));
        let (phi, drag) = (&self.phi, &self.drag);
        // Means over faces: φ, φ u_s, (1-φ) u_g, and what the last two answer to the gradient.
        let sums = rows.fold(
            &|row| {
                let below = row.near(up, -1);
                exchange::driven_sums(
                    [self.solids[up].row(row), self.gas[up].row(row)],
                    [phi.row(below), phi.row(row)],
                    [drag.row(below), drag.row(row)],
                    inertia,
                    force,
                )
            },
            &|a, b| std::array::from_fn(|n| a[n] + b[n]),
        );
        let [mean, solids, gas, solids_answer, gas_answer] =
            sums.map(|sum| sum / self.grid.len() as f64);
        let lacking = flux.lacking(mean, [solids, gas], [solids_answer, gas_answer]);
        self.gas_flux = Some(flux);
        // The solids as a whole by s, the total flux everywhere by c: ρ_s φ s + ρ_g (c - φ s) = 0 in
        // the mean, ghost mass included, and c - s is what lacks.
        let (rho_s, rho_g) = (self.setup.powder.density, self.setup.gas.density);
        let inverse = rho_g / (rho_s * (mean + GHOST) - rho_g * mean);
        let total = lacking / (1.0 + inverse);
        let [total, whole] = [total, -inverse * total].map(R::of);
        rows.each([&mut self.solids[up], &mut self.gas[up]], |row, [us, ug]| {
            exchange::drive_row(us, ug, [phi.row(row.near(up, -1)), phi.row(row)], total, whole);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::setup;
    use super::*;
    use crate::grid::Grid;

    fn flow<R: Real, const D: usize>(cells: [usize; D], flux: Option<f64>) -> TwoFluid<R, D> {
        let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
        TwoFluid::new(grid, setup(0.15, 0.2)).with_gas_flux(flux)
    }

    fn keeps_flux_and_momentum<const D: usize>(cells: [usize; D]) {
        let mut flow = flow::<f64, D>(cells, None);
        let (start, wanted) = (flow.means(), 0.85 * flow.uniform_slip());
        let (mut least, mut most) = (f64::INFINITY, 0.0f64);
        for _ in 0..2500 {
            let report = flow.step(f64::INFINITY).unwrap();
            assert!(report.volume_residual <= 1e-3, "{}", report.volume_residual);
            let means = flow.means();
            let found = (1.0 - means.solids_fraction) * means.slip;
            assert!((found / wanted - 1.0).abs() < 1e-11, "{found} of {wanted}");
            least = least.min(flow.pressure_gradient());
            most = most.max(flow.pressure_gradient());
        }
        let means = flow.means();
        let scale = 1500.0 * 0.15 * flow.uniform_slip();
        for (momentum, start) in means.momentum.iter().zip(start.momentum) {
            assert!((momentum - start).abs() < 1e-11 * scale, "{momentum} from {start}");
        }
        // Clusters let the gas pass at a smaller gradient than that of the uniform state.
        assert!(means.solids_fraction_variance > 1e-3);
        assert!(least < 0.9 && least > -1.0 && most < 3.0, "{least} to {most}");
    }

    #[test]
    fn a_gas_flux_is_kept_and_so_is_momentum() {
        keeps_flux_and_momentum([32, 32]);
        keeps_flux_and_momentum([10, 10, 12]);
    }

    #[test]
    fn the_uniform_state_of_a_flux_has_the_gradient_of_its_drag() {
        let law = setup(0.15, 0.0).drag.law(&setup(0.15, 0.0).gas, &setup(0.15, 0.0).powder);
        let grid = Grid::new([0.01; 2], [8; 2]);
        for part in [0.5, 1.0, 1.5] {
            let slip = part * uniform_slip(&setup(0.15, 0.0));
            let mut flow =
                TwoFluid::<f64, 2>::new(grid, setup(0.15, 0.0)).with_gas_flux(Some(0.85 * slip));
            for _ in 0..100 {
                flow.step(f64::INFINITY).unwrap();
            }
            let weight = 0.85 * (1500.0 - 1.3) * 9.81;
            let expected = law.beta_per_fraction(0.15, slip) * slip / weight;
            assert!((flow.pressure_gradient() / expected - 1.0).abs() < 1e-9);
            assert!((flow.means().slip / slip - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_kept_flow_goes_on_to_the_same_bits() {
        let state = |flow: &TwoFluid<f32, 2>| {
            let mut bytes = Vec::new();
            flow.save_state(&mut bytes).unwrap();
            bytes
        };
        let mut straight = flow::<f32, 2>([16, 24], Some(0.12));
        let advance = |flow: &mut TwoFluid<f32, 2>| {
            for _ in 0..60 {
                flow.step(f64::INFINITY).unwrap();
            }
        };
        advance(&mut straight);
        let kept = state(&straight);
        advance(&mut straight);
        let mut other = flow::<f32, 2>([16, 24], Some(0.12));
        other.restore_state(&mut kept.as_slice()).unwrap();
        advance(&mut other);
        assert!(state(&other) == state(&straight));
        assert_eq!(other.means(), straight.means());
    }
}
