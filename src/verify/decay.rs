//! Decay of shear in one phase alone: vortices of Taylor & Green in the gas, an oblique shear wave in
//! the solids, against the analytic solutions.
//!
//! With k = 2π/L, u = U (sin kx cos ky, -cos kx sin ky) solves the Navier-Stokes equations with U
//! falling as exp(-2νk²t); so does the wave u = U (1, -1) sin(k (x + y)), which meets normal and
//! shear stresses. The kinetic energy falls as exp(-4νk²t).

use super::symmetry::values;
use super::{Checked, Effort, Expected, Row, setup};
use crate::case::{Terms, with_drag, with_radial_distribution};
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::laws::kinetic_theory::{KineticTheory, RadialDistribution};
use crate::laws::scales::{Gas, Powder};
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};
use std::f64::consts::TAU;

/// Edge of the box \[m\].
const SIZE: f64 = 0.02;

/// Decay by viscosity, and what is lost without it.
pub(super) fn check(effort: Effort) -> Checked {
    let mut rows = viscous("gas, vortices", effort, &gas_alone(true))?;
    rows.extend(inviscid(effort)?);
    rows.extend(viscous("solids, oblique wave", effort, &solids_alone())?);
    Ok(rows)
}

/// One phase in motion.
struct Alone {
    setup: Setup,
    solids: bool,
    /// ν \[m²/s\].
    viscosity: f64,
    /// U at the start \[m/s\].
    speed: f64,
    /// T at the start \[m²/s²\], and what holds it \[m²/s³\].
    temperature: f64,
    heating: f64,
    /// Time \[s\].
    time: f64,
    /// Steps on 16 cells; four times as many on twice as many.
    steps: usize,
}

/// No solids at all: the drag on nothing is nothing.
fn gas_alone(viscous: bool) -> Alone {
    let base = setup(0.0);
    let viscosity = if viscous { base.gas.viscosity / base.gas.density } else { 0.0 };
    Alone {
        setup: Setup { terms: Terms { gas_stress: viscous, ..Terms::default() }, ..base },
        solids: false,
        viscosity,
        speed: 0.02,
        temperature: 1e-6,
        heating: 0.0,
        time: 0.2,
        steps: 16,
    }
}

/// Elastic grains in next to no gas, at a temperature that is held. Their heat is 10⁵ times their
/// motion's energy, so that shear does not change the viscosity.
fn solids_alone() -> Alone {
    let base = setup(0.3);
    let powder = Powder { restitution: 1.0, ..base.powder };
    let gas = Gas { density: 1e-4, viscosity: 1e-7 };
    // Almost no weight, so that nothing falls.
    let setup = Setup { powder, gas, gravity: 1e-12, ..base };
    let (phi, temperature) = (setup.solids_fraction, 0.01);
    let g0 = with_radial_distribution!(setup.radial_distribution, f64, &powder, |radial| {
        radial.contact(phi)
    });
    let drag = with_drag!(setup.drag, f64, &gas, &powder, |law| law.beta_per_fraction(phi, 0.0));
    let theory = KineticTheory::new(&gas, &powder);
    let viscosity = theory.transport(phi, g0, temperature, drag).viscosity;
    Alone {
        setup,
        solids: true,
        viscosity: viscosity / (powder.density * phi),
        speed: 5e-4,
        temperature,
        // 3/2 dT/dt is what drag dissipates, collisions nothing.
        heating: theory.viscous_dissipation(drag) * temperature / 1.5,
        time: 0.2,
        steps: 256,
    }
}

impl Alone {
    /// The velocity at the start along `axis` at `x`, over U.
    fn shape(&self, axis: usize, x: [f64; 2]) -> f64 {
        let [x, y] = x.map(|x| TAU / SIZE * x);
        match (self.solids, axis) {
            (true, 0) => (x + y).sin(),
            (true, _) => -(x + y).sin(),
            (false, 0) => x.sin() * y.cos(),
            (false, _) => -x.cos() * y.sin(),
        }
    }

    fn quantity(&self, axis: usize) -> Quantity {
        if self.solids { Quantity::SolidsVelocity(axis) } else { Quantity::GasVelocity(axis) }
    }

    /// U at the end over U at the start.
    fn decay(&self) -> f64 {
        (-2.0 * self.viscosity * (TAU / SIZE).powi(2) * self.time).exp()
    }

    /// Share of the kinetic energy that is left, and the L2 error of the velocity over the exact
    /// one's, after the same time on `cells`² cells.
    fn simulated(&self, cells: usize) -> Result<[f64; 2], StepError> {
        let grid = Grid::new([SIZE; 2], [cells; 2]);
        let mut flow = TwoFluid::<f64, 2>::new(grid, self.setup).with_tolerance(1e-10);
        flow.set_field(Quantity::Temperature, |_| self.temperature);
        if self.heating > 0.0 {
            flow.set_sources(|_, _| [0.0; 2], |_| self.heating);
        }
        let mut shapes = Vec::new();
        for axis in 0..2 {
            let shape = |index| self.shape(axis, self.quantity(axis).position(grid.spacing, index));
            // Of both phases, so that there is no drag between them.
            for quantity in [Quantity::SolidsVelocity(axis), Quantity::GasVelocity(axis)] {
                flow.set_field(quantity, |index| self.speed * shape(index));
            }
            let index = (0..grid.len()).map(|cell| [cell % cells, cell / cells]);
            shapes.push(index.map(shape).collect::<Vec<f64>>());
        }
        let steps = self.steps * (cells / 16).pow(2);
        for _ in 0..steps {
            flow.step_by(self.time / steps as f64)?;
        }
        let exact = self.speed * self.decay();
        let [mut energy, mut start, mut error] = [0.0; 3];
        for (axis, shape) in shapes.iter().enumerate() {
            for (found, shape) in values(&flow, self.quantity(axis)).iter().zip(shape) {
                energy += found.powi(2);
                start += (self.speed * shape).powi(2);
                error += (found - exact * shape).powi(2);
            }
        }
        Ok([energy / start, (error / (exact / self.speed).powi(2) / start).sqrt()])
    }
}

/// Cells along an edge.
fn sizes(effort: Effort) -> &'static [usize] {
    if effort == Effort::Full { &[16, 32, 64] } else { &[16, 32] }
}

/// Order of the velocity's error, and the energy left.
fn viscous(name: &str, effort: Effort, alone: &Alone) -> Result<Vec<Row>, StepError> {
    let found = sizes(effort)
        .iter()
        .map(|&cells| alone.simulated(cells))
        .collect::<Result<Vec<_>, StepError>>()?;
    let [.., coarse, fine] = found[..] else { unreachable!("two grids at least") };
    let errors: Vec<String> = found.iter().map(|found| format!("{:.1e}", found[1])).collect();
    let cells = sizes(effort)[found.len() - 1];
    // The rate by which the energy fell, over the exact one.
    let rate = fine[0].ln() / (2.0 * alone.decay().ln());
    let share = (TAU / cells as f64).powi(2);
    Ok(vec![
        Row::new(
            format!("order in space of the decay of the {name}"),
            Expected::AtLeast(1.9),
            (coarse[1] / fine[1]).log2(),
        )
        .with(format!(
            "analytic solution, step as square of spacing; L2 errors {}",
            errors.join(", ")
        )),
        Row::new(
            format!("rate of decay of the {name}, over 4νk²"),
            Expected::Near { value: 1.0, within: share },
            rate,
        )
        .with(format!("analytic solution; within (kh)², {cells} cells per wavelength")),
    ])
}

/// What the scheme takes of the energy of vortices that have no viscosity, in a turnover L/U.
fn inviscid(effort: Effort) -> Result<Vec<Row>, StepError> {
    let alone = gas_alone(false);
    let alone = Alone { time: SIZE / alone.speed, steps: 64, ..alone };
    // On 16 cells a fifth is lost, which has no order yet.
    let sizes: &[usize] = if effort == Effort::Full { &[32, 64, 128] } else { &[32, 64] };
    let lost = sizes
        .iter()
        .map(|&cells| alone.simulated(cells).map(|found| 1.0 - found[0]))
        .collect::<Result<Vec<f64>, StepError>>()?;
    let [.., coarse, fine] = lost[..] else { unreachable!("two grids at least") };
    let losses: Vec<String> = lost.iter().map(|lost| format!("{lost:.1e}")).collect();
    let cells = sizes[sizes.len() - 1];
    Ok(vec![
        Row::new(
            "order of the energy that vortices without viscosity lose in L/U",
            Expected::AtLeast(1.9),
            (coarse / fine).abs().log2(),
        )
        .with(format!("the equations keep it; lost of it {}", losses.join(", "))),
        // Of second order: as the square of the phase between cells, as the flow turns by a radian.
        Row::new(
            "share of it that they lose in 1/(kU)",
            Expected::AtMost((TAU / cells as f64).powi(2)),
            fine / TAU,
        )
        .with(format!("the equations keep it; at most (kh)², {cells} cells per wavelength")),
    ])
}
