//! Homogeneous cooling: granular temperature of particles at rest on the mean, against the solution
//! of its balance.
//!
//! With s = √T, γ = 8 (1-e²) φ g0/(√π d) and K = 18 μ_g (1-φ)^(-2.65)/(ρ_s d²), the Stokes drag of
//! Wen & Yu: ds/dt = -γ s²/2 - K s, so that s = s0 E/(1 + γ s0 (1 - E)/(2 K)), E = exp(-K t); without
//! drag Haff's law, s = s0/(1 + γ s0 t/2).

use super::{Checked, Effort, Expected, Row, setup};
use crate::grid::Grid;
use crate::laws::scales::Gas;
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};
use std::f64::consts::PI;

/// Temperature at the start \[m²/s²\], and time \[s\] in which collisions take 98 % of it.
const START: f64 = 0.01;
const TIME: f64 = 0.02;

/// With and without drag: order in time, and the temperature that steps without length would give.
pub(super) fn check(_: Effort) -> Checked {
    let mut rows = Vec::new();
    for (name, viscosity) in [("almost without drag (Haff)", 1e-7), ("with drag", 1.8e-5)] {
        let base = setup(0.2);
        let gas = Gas { viscosity, ..base.gas };
        // Almost no weight, so that no slip makes temperature.
        let setup = Setup { gas, gravity: 1e-12, ..base };
        let exact = exact(&setup, TIME);
        let found = [128, 256, 512].map(|steps| simulated(setup, steps).map(|t| t / exact - 1.0));
        let [first, coarse, fine] = found;
        let (first, coarse, fine) = (first?, coarse?, fine?);
        let detail =
            format!("analytic solution; errors of T {first:.1e}, {coarse:.1e}, {fine:.1e}");
        rows.push(
            Row::new(
                format!("order in time of cooling {name}"),
                Expected::AtLeast(0.9),
                (coarse / fine).abs().log2(),
            )
            .with(detail),
        );
        // What a first-order method tends to as its step vanishes.
        rows.push(
            Row::new(
                format!("T after cooling {name}, extrapolated to no step [m²/s²]"),
                Expected::Near { value: exact, within: 0.002 },
                exact * (1.0 + 2.0 * fine - coarse),
            )
            .with("analytic solution; of 256 and 512 steps"),
        );
    }
    Ok(rows)
}

/// T at `time`.
fn exact(setup: &Setup, time: f64) -> f64 {
    let Setup { powder, gas, solids_fraction: phi, .. } = setup;
    let g0 = 1.0 / (1.0 - (phi / powder.max_packing).cbrt());
    let gamma = 8.0 * (1.0 - powder.restitution.powi(2)) * phi * g0 / (PI.sqrt() * powder.diameter);
    let drag =
        18.0 * gas.viscosity * (1.0 - phi).powf(-2.65) / (powder.density * powder.diameter.powi(2));
    let s = START.sqrt();
    let lost = -(-drag * time).exp_m1();
    (s * (1.0 - lost) / (1.0 + gamma * s * lost / (2.0 * drag))).powi(2)
}

/// T after equal `steps`.
fn simulated(setup: Setup, steps: usize) -> Result<f64, StepError> {
    let mut flow = TwoFluid::<f64, 2>::new(Grid::new([0.01; 2], [8; 2]), setup);
    flow.set_field(Quantity::Temperature, |_| START);
    for _ in 0..steps {
        flow.step_by(TIME / steps as f64)?;
    }
    Ok(flow.granular_temperature().mean())
}
