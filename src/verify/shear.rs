//! Steady shear of the solids (a Kolmogorov flow): grains driven by a force f sin ky in a box without
//! weight, against an integration of the steady equations in one dimension.
//!
//! What the stress carries across is the force beside it, the solids pressure is the same
//! everywhere, and shear heats what collisions and conduction take away:
//!
//! - τ(y) = ∫ ρ_s φ f sin ky dy from y to L/4, du/dy = τ/μ_s,
//! - P_s(φ, T) = P, P such that ⟨φ⟩ is what it is,
//! - d/dy(λ dT/dy) + τ²/μ_s = J_coll + J_vis.
//!
//! The gas, next to nothing, goes with the grains. A periodic box cannot hold a uniform shear;
//! here conduction reaches about as far as the shear, so that all three terms of the balance count.

use super::symmetry::values;
use super::{Checked, Effort, Expected, Row, setup};
use crate::case::{with_drag, with_radial_distribution};
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::laws::kinetic_theory::{KineticTheory, RadialDistribution};
use crate::laws::scales::{Gas, Powder};
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};
use std::f64::consts::TAU;

/// Wavelength of the force \[m\].
const LENGTH: f64 = 4e-3;

/// Its amplitude \[m/s²\].
const FORCE: f64 = 14.0;

/// Velocity and temperature at the start \[m/s\], \[m²/s²\]: near what comes of it.
const SPEED: f64 = 0.3;
const TEMPERATURE: f64 = 0.01;

/// Time until the flow is steady, twenty times what viscosity and force need \[s\].
const TIME: f64 = 0.25;

/// Steps on 16 cells; four times as many on twice as many.
const STEPS: usize = 1024;

/// Cells of the integration, in a quarter of the wavelength.
const CELLS: usize = 400;

/// Nearly elastic grains in next to no gas.
fn grains() -> Setup {
    let base = setup(0.3);
    let powder = Powder { restitution: 0.99, ..base.powder };
    Setup { powder, gas: Gas { density: 1e-4, viscosity: 1e-7 }, gravity: 1e-12, ..base }
}

/// Orders of velocity, temperature and fraction, and the balance of energy.
pub(super) fn check(effort: Effort) -> Checked {
    let sizes: &[usize] = if effort == Effort::Full { &[16, 32, 64] } else { &[16, 32] };
    let setup = grains();
    let profile = Profile::new(&setup)?;
    let found = sizes
        .iter()
        .map(|&cells| simulated(&setup, &profile, cells))
        .collect::<Result<Vec<_>, StepError>>()?;
    let [.., coarse, fine] = &found[..] else { unreachable!("two grids at least") };
    let cells = sizes[sizes.len() - 1];
    let mut rows = Vec::new();
    for (n, symbol) in ["u_s", "T", "φ"].into_iter().enumerate() {
        let errors: Vec<String> = found.iter().map(|f| format!("{:.1e}", f.errors[n])).collect();
        rows.push(
            Row::new(
                format!("order in space of {symbol} in steady shear"),
                Expected::AtLeast(1.9),
                (coarse.errors[n] / fine.errors[n]).log2(),
            )
            .with(format!("1-D integration; L2 errors {}", errors.join(", "))),
        );
    }
    rows.push(
        Row::new(
            "mean T in steady shear [m²/s²]",
            Expected::Near {
                value: profile.mean_temperature(),
                within: (TAU / cells as f64).powi(2),
            },
            fine.temperature,
        )
        .with(format!("1-D integration; within (kh)², {cells} cells per wavelength")),
    );
    rows.push(
        // Slow relaxation, the gas's part and the divergence that the pressure leaves.
        Row::new(
            "dissipation over work of the force",
            Expected::Near { value: 1.0, within: 1e-3 },
            fine.dissipation,
        )
        .with("steady state: what is put in is dissipated"),
    );
    Ok(rows)
}

/// A flow that has become steady.
struct Steady {
    /// Of u_s, T and φ, over the exact one's standard deviation.
    errors: [f64; 3],
    /// ⟨T⟩ \[m²/s²\].
    temperature: f64,
    /// ⟨J⟩ over ⟨ρ_s φ f u⟩.
    dissipation: f64,
}

fn simulated(setup: &Setup, exact: &Profile, cells: usize) -> Result<Steady, StepError> {
    let grid = Grid::new([LENGTH; 2], [4, cells]);
    let h = grid.spacing[1];
    let place = |index: [usize; 2]| h * (index[1] as f64 + 0.5);
    let wave = |y: f64| (TAU / LENGTH * y).sin();
    let mut flow = TwoFluid::<f64, 2>::new(grid, *setup).with_tolerance(1e-9);
    flow.set_field(Quantity::Temperature, |_| TEMPERATURE);
    for quantity in [Quantity::SolidsVelocity(0), Quantity::GasVelocity(0)] {
        flow.set_field(quantity, |index| SPEED * wave(place(index)));
    }
    flow.set_sources(
        |axis, index| [if axis == 0 { FORCE * wave(place(index)) } else { 0.0 }, 0.0],
        |_| 0.0,
    );
    let steps = STEPS * (cells / 16).pow(2);
    for _ in 0..steps {
        flow.step_by(TIME / steps as f64)?;
    }
    // The first column is like the others.
    let column = |quantity| -> Vec<f64> {
        values(&flow, quantity).chunks(grid.cells[0]).map(|row| row[0]).collect()
    };
    let [u, theta, phi] =
        [Quantity::SolidsVelocity(0), Quantity::Temperature, Quantity::SolidsFraction].map(column);
    let n = cells as f64;
    let places: Vec<f64> = (0..cells).map(|j| place([0, j])).collect();
    let error = |found: &[f64], exact: &dyn Fn(f64) -> f64| {
        let mean = places.iter().map(|&y| exact(y)).sum::<f64>() / n;
        let spread: f64 = places.iter().map(|&y| (exact(y) - mean).powi(2)).sum();
        let error: f64 =
            found.iter().zip(&places).map(|(found, &y)| (found - exact(y)).powi(2)).sum();
        (error / spread).sqrt()
    };
    let rho = setup.powder.density;
    // The force takes the velocity from what viscosity left of it to what it is: its work is of the
    // mean of both.
    let dt = TIME / steps as f64;
    let work: f64 = (0..cells)
        .map(|j| {
            let force = FORCE * wave(places[j]);
            rho * phi[j] * force * (u[j] - 0.5 * dt * force)
        })
        .sum();
    let taken: f64 = (0..cells).map(|j| exact.grains.at(phi[j], theta[j]).sink * theta[j]).sum();
    Ok(Steady {
        errors: [
            error(&u, &|y| exact.velocity(y)),
            error(&theta, &|y| exact.at(&exact.theta, y)),
            error(&phi, &|y| exact.at(&exact.phi, y)),
        ],
        temperature: theta.iter().sum::<f64>() / n,
        dissipation: taken / work,
    })
}

/// The closures of [`grains`].
struct Grains {
    setup: Setup,
    theory: KineticTheory<f64>,
}

/// What the closures say of a place.
struct At {
    /// P_s \[Pa\].
    pressure: f64,
    /// μ_s \[Pa·s\].
    viscosity: f64,
    /// λ \[kg/m/s\].
    conductivity: f64,
    /// (J_coll + J_vis)/T \[kg/m³/s\].
    sink: f64,
}

impl Grains {
    fn at(&self, phi: f64, theta: f64) -> At {
        let Setup { powder, gas, drag, radial_distribution, .. } = self.setup;
        let g0 = with_radial_distribution!(radial_distribution, f64, &powder, |radial| {
            radial.contact(phi)
        });
        let drag = with_drag!(drag, f64, &gas, &powder, |law| law.beta_per_fraction(phi, 0.0));
        let theory = self.theory;
        let transport = theory.transport(phi, g0, theta, drag);
        At {
            pressure: theory.pressure(phi, g0, theta),
            viscosity: transport.viscosity,
            conductivity: transport.conductivity,
            sink: powder.density
                * phi
                * (theory.collisional_dissipation(phi, g0) * theta.sqrt()
                    + theory.viscous_dissipation(drag)),
        }
    }

    /// φ at which P_s is `pressure`.
    fn fraction(&self, pressure: f64, theta: f64) -> f64 {
        root(|phi| self.at(phi, theta).pressure - pressure, 0.0, 0.6)
    }
}

/// The root of a growing function between `low` and `high`, by false position (Illinois).
fn root(mut f: impl FnMut(f64) -> f64, mut low: f64, mut high: f64) -> f64 {
    let [mut below, mut above] = [low, high].map(&mut f);
    let scale = above - below;
    let (mut x, mut last) = (low, None);
    for _ in 0..60 {
        x = (low * above - high * below) / (above - below);
        let found = f(x);
        if found.abs() < 1e-13 * scale {
            break;
        }
        // The end that stays twice counts half, so that it moves too.
        let side = found < 0.0;
        if side {
            (low, below) = (x, found);
            above *= if last == Some(side) { 0.5 } else { 1.0 };
        } else {
            (high, above) = (x, found);
            below *= if last == Some(side) { 0.5 } else { 1.0 };
        }
        last = Some(side);
    }
    x
}

/// The steady state over a quarter of the wavelength, in [`CELLS`] cells from where the force is
/// nothing to where it is largest.
struct Profile {
    grains: Grains,
    theta: Vec<f64>,
    phi: Vec<f64>,
    /// At the upper ends of the cells.
    u: Vec<f64>,
}

/// The integration has no end.
#[derive(Debug, thiserror::Error)]
#[error("the steady state did not converge: its temperature still changes by {0:.1e}")]
struct NotConverged(f64);

impl Profile {
    /// Solves for T with coefficients of the T before, in turns with φ and τ.
    fn new(setup: &Setup) -> Result<Self, NotConverged> {
        const ROUNDS: usize = 60;
        let grains =
            Grains { setup: *setup, theory: KineticTheory::new(&setup.gas, &setup.powder) };
        let delta = 0.25 * LENGTH / CELLS as f64;
        let k = TAU / LENGTH;
        let mut profile = Self {
            grains,
            theta: vec![TEMPERATURE; CELLS],
            phi: vec![setup.solids_fraction; CELLS],
            u: vec![0.0; CELLS],
        };
        let mut change = f64::INFINITY;
        for _ in 0..ROUNDS {
            profile.spread(setup.solids_fraction);
            let Self { grains, theta, phi, u } = &mut profile;
            let at: Vec<At> = phi.iter().zip(&*theta).map(|(p, t)| grains.at(*p, *t)).collect();
            // From the middle of the crest inwards; a cell's stress is that of its middle.
            let mut stress = vec![0.0; CELLS];
            let mut above = 0.0;
            for i in (0..CELLS).rev() {
                let force = setup.powder.density * phi[i] * FORCE;
                let [low, middle, high] =
                    [0.0, 0.5, 1.0].map(|part| (k * delta * (i as f64 + part)).cos());
                stress[i] = above + force * (middle - high) / k;
                above += force * (low - high) / k;
            }
            let mut velocity = 0.0;
            for i in 0..CELLS {
                velocity += delta * stress[i] / at[i].viscosity;
                u[i] = velocity;
            }
            // Conduction between neighbours, nothing through the ends.
            let links: Vec<f64> = at
                .windows(2)
                .map(|pair| {
                    2.0 / (1.0 / pair[0].conductivity + 1.0 / pair[1].conductivity) / delta.powi(2)
                })
                .collect();
            let mut diagonal = vec![0.0; CELLS];
            let mut right = vec![0.0; CELLS];
            for i in 0..CELLS {
                let lower = if i > 0 { links[i - 1] } else { 0.0 };
                let upper = links.get(i).copied().unwrap_or_default();
                diagonal[i] = at[i].sink + lower + upper;
                right[i] = stress[i].powi(2) / at[i].viscosity;
                if i > 0 {
                    let share = lower / diagonal[i - 1];
                    diagonal[i] -= share * lower;
                    right[i] += share * right[i - 1];
                }
            }
            change = 0.0;
            let mut next = 0.0;
            for i in (0..CELLS).rev() {
                let upper = links.get(i).copied().unwrap_or_default();
                next = (right[i] + upper * next) / diagonal[i];
                change = f64::max(change, (next / theta[i] - 1.0).abs());
                // Half-way: hotter grains are heated less and cooled faster, each by a root.
                theta[i] = 0.5 * (theta[i] + next);
            }
            if change < 1e-11 {
                profile.spread(setup.solids_fraction);
                return Ok(profile);
            }
        }
        Err(NotConverged(change))
    }

    /// Spreads the solids so that their pressure is the same everywhere and their mean `mean`.
    fn spread(&mut self, mean: f64) {
        let pressures: Vec<f64> = self
            .phi
            .iter()
            .zip(&self.theta)
            .map(|(p, t)| self.grains.at(*p, *t).pressure)
            .collect();
        let bounds =
            |most: fn(f64, f64) -> f64| pressures.iter().copied().reduce(most).unwrap_or_default();
        let (low, high) = (0.5 * bounds(f64::min), 2.0 * bounds(f64::max));
        let Self { grains, theta, phi, .. } = self;
        root(
            |pressure| {
                for (phi, theta) in phi.iter_mut().zip(&*theta) {
                    *phi = grains.fraction(pressure, *theta);
                }
                phi.iter().sum::<f64>() / CELLS as f64 - mean
            },
            low,
            high,
        );
    }

    /// A place folded into the quarter, in cells.
    fn folded(y: f64) -> f64 {
        let quarter = y.rem_euclid(0.5 * LENGTH).min(0.5 * LENGTH - y.rem_euclid(0.5 * LENGTH));
        quarter / (0.25 * LENGTH) * CELLS as f64
    }

    /// A value at cell centres, at y.
    fn at(&self, values: &[f64], y: f64) -> f64 {
        let place = (Self::folded(y) - 0.5).clamp(0.0, (CELLS - 1) as f64);
        let cell = (place as usize).min(CELLS - 2);
        let part = place - cell as f64;
        (1.0 - part) * values[cell] + part * values[cell + 1]
    }

    /// u_s at y.
    fn velocity(&self, y: f64) -> f64 {
        let place = Self::folded(y);
        let cell = (place as usize).min(CELLS - 1);
        let below = if cell > 0 { self.u[cell - 1] } else { 0.0 };
        let size = below + (place - cell as f64) * (self.u[cell] - below);
        if y.rem_euclid(LENGTH) < 0.5 * LENGTH { size } else { -size }
    }

    fn mean_temperature(&self) -> f64 {
        self.theta.iter().sum::<f64>() / CELLS as f64
    }
}
