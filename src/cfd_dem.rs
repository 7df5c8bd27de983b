//! [`CfdDem`]: spheres followed one by one ([`crate::dem`]) in a gas that is resolved on a grid of cells
//! larger than they are, in a periodic box of three dimensions.
//!
//! ```text
//! m dv/dt   = Σ F + V_p (g (ρ - ρ_s) - ∇p + ∇·τ) + K (u_p - v)
//! ∂(ε ρ_g u)/∂t + ∇·(ε ρ_g u u) = ε (g (ρ - ρ_g) - ∇p + ∇·τ) - Σ_p K (u_p - v)/V
//! ∂ε/∂t + ∇·(ε u) = 0
//! ```
//!
//! ε = 1 - φ from the particles' volumes, ρ the mean density of the mixture: the frame is the one in which
//! the mixture has no momentum, the mean gas pressure gradient balances the weight, and p is the periodic rest. u_p is the
//! gas velocity that the particle sees (`mapping.rs`), K = m λ with λ = β/(φ ρ_s) of the fine-grid
//! drag law at the fraction and the slip that it sees, for its own diameter ([`SphereDrag`]). The gas is
//! incompressible; τ is its molecular stress, if a case asks for it, and a mean pressure gradient may
//! keep the gas flux in place of balancing the weight (`drive.rs`).
//!
//! Staggered grid: φ and p at cell centres, u on faces. A step of [`CfdDem::step`], of length Δt:
//!
//! 1. particles: as many steps of contacts as Δt has, under the impulses that they are owed;
//! 2. φ where they are now; λ of each; K and K v shared among the faces, each component of v among those
//!    of its axis, so that drag is spread as far along that axis as along the others;
//! 3. transport of the gas's momentum by the flux ε u of the step before, with the fractions that
//!    went with that flux, so that a uniform velocity stays uniform;
//! 4. gas: weight and old pressure, drag implicit on each face;
//! 5. projection: the pressure increment that makes ∇·(ε u) what the particles' motion asks for;
//! 6. what each particle is owed: drag by the new gas velocity, the new pressure, its weight.
//!
//! Drag is implicit in the gas, whose inertia among particles is little, and explicit in the particles,
//! whose is not: λ Δt is at most a fifth. Every exchange is one number with two signs: momentum, that which is owed included, is kept to
//! round-off. It is stable while what pressure does to particles in a step is small against what it
//! does to gas, φ² λ Δt/(1-φ)² < 1, which that limit sees to as well.

mod drive;
mod fields;
mod gas;
mod mapping;
mod smoothing;
mod start;
mod state;

pub use start::{SpheresError, sauter_mean, spheres};
pub use state::StateError;

use crate::case::{DragChoice, Drive, MappingChoice, MixtureChoice, ParticlesStart};
use crate::dem::{self, Dem, Quad, SKIN, Seen};
use crate::drive::{GasFlux, uniform_velocities};
use crate::field::{Faces, Field, Layout};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::contact::{Contact, TANGENTIAL_MOBILITY};
use crate::laws::drag::{DragLaw, SphereDrag};
use crate::laws::scales::{Gas, Powder, Scales, homogeneous_slip};
use crate::poisson::Poisson;
use crate::rows::Rows;
use crate::simulation::{
    DIFFUSION, FIRST_STEP, Failure, GROWTH, LONGEST_STEP, Limit, Means, Simulation, StepReport,
    UNSOLVED,
};
use gas::Viscous;
use mapping::Mapping;
use std::f64::consts::PI;
use std::io::{self, Read, Write};

/// Largest Courant number of the gas, summed over the axes of a cell.
const GAS_COURANT: f64 = 0.9;

/// Largest way of a particle in a step, in cells: drag and pressure change little on the way.
const SOLIDS_COURANT: f64 = 0.5;

/// Largest λ Δt: drag takes at most this share of a particle's slip in a step.
const EXCHANGE: f64 = 0.2;

/// Remaining divergence of the gas flux, times Δt, that ends the pressure iteration.
const TOLERANCE: f64 = 1e-4;

/// Most pressure iterations in a step.
const MOST_ITERATIONS: usize = 100;

/// Most of a cell that spheres may fill; a mapping that gives more is refused.
const FULLEST: f64 = 0.95;

/// What CFD-DEM is asked to compute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// The powder; of several diameters its is that of reference.
    pub powder: Powder,
    /// The gas.
    pub gas: Gas,
    /// Gravity \[m/s²\].
    pub gravity: f64,
    /// Drag law.
    pub drag: DragChoice,
    /// How it serves particles of other diameters.
    pub mixture: MixtureChoice,
    /// Whether the gas carries its momentum along.
    pub gas_inertia: bool,
    /// Whether the gas's molecular stress acts between cells.
    pub gas_stress: bool,
    /// What carries the weight.
    pub drive: Drive,
    /// Mean solids fraction of the box, met by a whole number of particles.
    pub solids_fraction: f64,
    /// What two particles do that touch.
    pub contact: Contact,
    /// Steps in a contact, at least.
    pub steps_per_contact: f64,
    /// How a particle's volume is shared among cells.
    pub mapping: MappingChoice,
    /// Standard deviation of what it is spread to, its shares included, if cells alone do not spread it as
    /// far \[m\].
    pub smoothing: f64,
    /// A time that is a whole number of contact steps, such as that between samples \[s\].
    pub rhythm: f64,
    /// Of the particles' places.
    pub seed: u64,
    /// Whether a step may use the threads of the current pool.
    pub parallel: bool,
}

/// A box that cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The particles cannot be placed.
    #[error(transparent)]
    Start(#[from] SpheresError),
    /// They cannot be simulated.
    #[error("the particles cannot be simulated")]
    Particles(#[from] dem::SetupError),
}

/// Why a step could not be made; the state is of no use any more.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StepError {
    /// Of the particles.
    #[error("the particles failed")]
    Particles(#[from] dem::StepError),
    /// The pressure iteration did not converge.
    #[error(
        "the gas pressure did not converge at t = {time:.6} s: after {iterations} iterations {residual:.1e} \
         of the volume of a cell is unaccounted for (step of {dt:.2e} s); larger cells or \
         particles.smoothing may do"
    )]
    Pressure {
        /// Simulated time \[s\].
        time: f64,
        /// Iterations.
        iterations: usize,
        /// What is left, times the step.
        residual: f64,
        /// The step \[s\].
        dt: f64,
    },
    /// A cell is filled beyond what spheres fill.
    #[error(
        "particles fill {fraction:.2} of the cell at ({}, {}, {}) at t = {time:.6} s, as they are shared among \
         cells: larger cells or particles.smoothing are needed",
        cell[0], cell[1], cell[2]
    )]
    Full {
        /// Simulated time \[s\].
        time: f64,
        /// Fraction filled.
        fraction: f64,
        /// The cell.
        cell: [usize; 3],
    },
    /// The gas velocity is no longer finite.
    #[error("the gas velocity is not finite at t = {time:.6} s (step of {dt:.2e} s)")]
    NotFinite {
        /// Simulated time \[s\].
        time: f64,
        /// The step \[s\].
        dt: f64,
    },
}

/// Particles in a gas.
pub struct CfdDem {
    grid: Grid<3>,
    rows: Rows<3>,
    setup: Setup,
    scales: Scales,
    law: Box<dyn DragLaw<f64>>,
    /// The same for each of the particles.
    drag_on: Box<dyn SphereDrag>,
    dem: Dem,
    /// Contacts of the last contact step.
    touches: Vec<Seen>,
    mapping: Mapping,
    /// g (ρ - ρ_k) of particles and gas \[N/m³\].
    buoyancy: [f64; 2],
    /// Radius \[m\] and volume \[m³\] of a particle of the powder's diameter.
    radius: f64,
    volume: f64,
    /// Volume of all particles, in such particles.
    whole: f64,
    /// The gas flux that is kept, if one is.
    gas_flux: Option<GasFlux>,
    time: f64,
    next_dt: (f64, Limit),
    /// The step before \[s\]; 0 if there is none.
    last_dt: f64,
    /// Simulated seconds of the wall clock per stage.
    clock: [f64; STAGES.len()],

    /// φ now, at the end of the step before, and at that of the one before that.
    phi: [Field<f64, 3>; 3],
    pressure: Field<f64, 3>,
    increment: Field<f64, 3>,
    gas: Faces<f64, 3>,

    // What a step leaves behind, so that none is allocated in it.
    carried: Faces<f64, 3>,
    sides: Faces<f64, 3>,
    flux: Faces<f64, 3>,
    mobility: Faces<f64, 3>,
    right: Field<f64, 3>,
    poisson: Poisson<f64, 3>,
    /// The gas's molecular stress, if it acts.
    viscous: Option<Box<Viscous>>,
    /// φ per cell.
    filled: Vec<[f64; 1]>,
    /// K/V and K v/V of the faces of each axis, as shared out and as fields.
    exchange: Vec<[f64; 6]>,
    drag: Faces<f64, 3>,
    given: Faces<f64, 3>,
    /// Gas velocity on faces and φ at centres, as particles see them.
    seen: Vec<[f64; 4]>,
    /// Gas velocity on faces and pressure gradient at centres, likewise.
    pulls: Vec<[f64; 6]>,
    /// λ of each particle \[1/s\], by place in memory.
    rates: Vec<f64>,
}

/// The stages of a step, for [`CfdDem::stage_seconds`].
pub const STAGES: [&str; 3] = ["particles", "exchange", "gas"];

impl CfdDem {
    /// Particles at rest at random places without overlap, in a uniform gas that carries their weight,
    /// in the frame in which the mixture has no momentum.
    ///
    /// # Errors
    /// The particles cannot be placed or simulated.
    pub fn new(grid: Grid<3>, setup: Setup) -> Result<Self, SetupError> {
        let spheres = spheres(&grid, &setup, &ParticlesStart::default())?;
        Self::with_spheres(grid, setup, &spheres)
    }

    /// These particles, of the powder's density, their velocities taken against that of the uniform state of
    /// equal particles of the powder's diameter.
    ///
    /// # Errors
    /// They cannot be simulated.
    pub fn with_spheres(
        grid: Grid<3>,
        setup: Setup,
        spheres: &[dem::Sphere],
    ) -> Result<Self, SetupError> {
        let Setup { powder, gas, gravity, contact, .. } = setup;
        let layout = Layout::from(&grid);
        let zeros = || Field::zeros(layout);
        let volume = PI / 6.0 * powder.diameter.powi(3);
        let ratio = |sphere: &dem::Sphere| sphere.diameter / powder.diameter;
        let whole: f64 = spheres.iter().map(|sphere| ratio(sphere).powi(3)).sum();
        let mean = whole * volume / grid.size().iter().product::<f64>();
        let mixture = powder.density * mean + gas.density * (1.0 - mean);
        let law = setup.drag.law(&gas, &powder);
        let slip = match setup.drive {
            Drive::GasFlux(Some(flux)) => flux / (1.0 - mean),
            _ => homogeneous_slip(&law, &powder, &gas, gravity, mean),
        };
        let gas_flux = (setup.drive != Drive::PressureGradient)
            .then(|| GasFlux::uniform(slip, mean, &law, &powder, &gas, gravity));
        let [falling, rising] = uniform_velocities(&powder, &gas, mean, slip);
        let smallest = spheres.iter().map(ratio).fold(f64::INFINITY, f64::min).min(1e3);
        let spheres: Vec<dem::Sphere> = spheres
            .iter()
            .map(|sphere| {
                let [x, y, z] = sphere.velocity;
                dem::Sphere { velocity: [x, y, z + falling], ..*sphere }
            })
            .collect();
        // The contact's own step, shortened until the rhythm is a whole number of them.
        let stiffest =
            contact.stiffness * (TANGENTIAL_MOBILITY * contact.tangential_stiffness).max(1.0);
        let lightest = powder.density * volume * smallest.powi(3);
        let shortest = PI * (0.5 * lightest / stiffest).sqrt();
        let steps = (setup.rhythm * setup.steps_per_contact / shortest).ceil().max(1.0);
        let dem = Dem::new(
            dem::Setup {
                size: grid.size(),
                contact,
                steps_per_contact: shortest * steps / setup.rhythm,
                skin: SKIN,
                parallel: setup.parallel,
            },
            &spheres,
        )?;
        let scales = Scales::new(&powder, &gas, gravity);
        let mut carrier = Field::zero_faces(layout);
        carrier[2].set(|_| rising);
        let mut flow = Self {
            grid,
            rows: Rows::new(layout, setup.parallel),
            setup: Setup { solids_fraction: mean, ..setup },
            law,
            drag_on: setup.drag.of_spheres(setup.mixture, &gas, &powder),
            mapping: Mapping::new(&grid, setup.mapping, powder.diameter, setup.smoothing),
            buoyancy: [gravity * (mixture - powder.density), gravity * (mixture - gas.density)],
            radius: 0.5 * powder.diameter,
            volume,
            whole,
            gas_flux,
            time: 0.0,
            next_dt: (FIRST_STEP * scales.time(), Limit::Growth),
            last_dt: 0.0,
            clock: [0.0; STAGES.len()],
            scales,
            phi: [zeros(), zeros(), zeros()],
            pressure: zeros(),
            increment: zeros(),
            gas: carrier,
            carried: Field::zero_faces(layout),
            sides: Field::zero_faces(layout),
            flux: Field::zero_faces(layout),
            mobility: Field::zero_faces(layout),
            right: zeros(),
            poisson: Poisson::new(&grid, setup.parallel),
            viscous: setup.gas_stress.then(|| Box::new(Viscous::new(&grid, gas.viscosity))),
            filled: vec![[0.0]; grid.len()],
            exchange: vec![[0.0; 6]; grid.len()],
            drag: Field::zero_faces(layout),
            given: Field::zero_faces(layout),
            seen: vec![[0.0; 4]; grid.len()],
            pulls: vec![[0.0; 6]; grid.len()],
            rates: vec![0.0; spheres.len()],
            touches: Vec::new(),
            dem,
        };
        flow.dem.drives_mut();
        for _ in 0..3 {
            flow.fill();
        }
        flow.see_pulls();
        Ok(flow)
    }

    /// Advances by one step towards the time `until` \[s\], which is a whole number of contact steps away,
    /// such that equal steps end there.
    ///
    /// # Errors
    /// Particles overlap too deeply or move too fast, the pressure does not converge, or cells are filled
    /// beyond what spheres fill.
    ///
    /// # Panics
    /// When `until` is not in the future.
    pub fn step(&mut self, until: f64) -> Result<StepReport, StepError> {
        assert!(until > self.time, "a step from {} s to {until} s", self.time);
        let begin = std::time::Instant::now();
        let short = self.dem.time_step();
        let (longest, limit) = self.next_dt;
        let most = (longest / short).floor().clamp(1.0, 1e9) as u64;
        let (steps, last) = if until.is_finite() {
            let left = ((until - self.time) / short).round().max(1.0) as u64;
            let steps = left.div_ceil(left.div_ceil(most));
            (steps, steps == left)
        } else {
            (most, false)
        };
        let dt = steps as f64 * short;

        for Quad([x, y, z, _]) in self.dem.drives_mut() {
            [*x, *y, *z] = [*x / dt, *y / dt, *z / dt];
        }
        self.dem.run_seen(steps)?;
        self.touches.clear();
        self.touches.extend(self.dem.seen());
        self.time = if last { until } else { self.time + dt };
        let moved = begin.elapsed().as_secs_f64();

        self.fill();
        self.check_filled()?;
        let fastest = self.share();
        let shared = begin.elapsed().as_secs_f64();
        let (iterations, residual) = self.advance_gas(dt);
        let solved = begin.elapsed().as_secs_f64();
        let time = self.time;
        if !residual.is_finite() {
            return Err(StepError::NotFinite { time, dt });
        }
        if residual * dt > UNSOLVED {
            return Err(StepError::Pressure { time, iterations, residual: residual * dt, dt });
        }
        self.owe(dt);
        self.keep_gas_flux(dt);
        let owed = begin.elapsed().as_secs_f64();
        let stages = [moved, shared - moved + owed - solved, solved - shared];
        for (clock, seconds) in self.clock.iter_mut().zip(stages) {
            *clock += seconds;
        }
        self.last_dt = dt;
        self.next_dt = self.choose_step(longest, fastest);
        Ok(StepReport {
            dt,
            limit,
            gas_steps: usize::from(self.setup.gas_inertia),
            iterations,
            volume_residual: residual * dt,
        })
    }

    /// The longest next step after one that might have been `longest`, and what limits it. `fastest` is
    /// the largest way of a particle in cells and the largest λ \[1/s\].
    fn choose_step(&self, longest: f64, [solids, exchange]: [f64; 2]) -> (f64, Limit) {
        let tiny = 1e-300;
        let gas = if self.setup.gas_inertia { self.gas_speed() } else { 0.0 };
        [
            (SOLIDS_COURANT / (solids + tiny), Limit::Solids),
            (GAS_COURANT / (gas + tiny), Limit::Gas),
            (EXCHANGE / (exchange + tiny), Limit::Exchange),
            (LONGEST_STEP * self.scales.time(), Limit::Longest),
            (
                self.viscous.as_ref().map_or(f64::INFINITY, |_| self.longest_viscous()),
                Limit::Diffusion,
            ),
        ]
        .into_iter()
        .fold(
            (GROWTH * longest, Limit::Growth),
            |best, next| if next.0 < best.0 { next } else { best },
        )
    }

    /// Longest step of the gas's molecular stress \[s\].
    fn longest_viscous(&self) -> f64 {
        let Gas { density, viscosity } = self.setup.gas;
        let square: f64 = self.grid.spacing.iter().map(|h| 1.0 / (h * h)).sum();
        DIFFUSION * density / (viscosity * square)
    }

    /// Diameter of a particle over the powder's, from its place and radius.
    #[inline(always)]
    fn ratio(&self, position: &Quad) -> f64 {
        position.0[3] / self.radius
    }

    /// φ where the particles are, the two before kept.
    fn fill(&mut self) {
        self.phi.rotate_right(1);
        self.filled.fill([0.0]);
        let share = self.volume / self.grid.cell_volume();
        for position in self.dem.positions() {
            let volume = share * self.ratio(position).powi(3);
            self.mapping.shares(*position).give(&mut self.filled, [volume]);
        }
        self.mapping.smooth(&mut self.filled);
        let (filled, index) = (&self.filled, index(self.grid.cells));
        self.phi[0].set(|cell| filled[index(cell)][0]);
    }

    /// Whether cells are filled as spheres can fill them.
    fn check_filled(&self) -> Result<(), StepError> {
        let (mut most, mut place) = (0.0, 0);
        for (n, [fraction]) in self.filled.iter().enumerate() {
            if *fraction > most {
                (most, place) = (*fraction, n);
            }
        }
        if most > FULLEST {
            let [nx, ny, _] = self.grid.cells;
            let cell = [place % nx, place / nx % ny, place / (nx * ny)];
            return Err(StepError::Full { time: self.time, fraction: most, cell });
        }
        Ok(())
    }

    /// Finds λ of each particle by the gas as it was, and shares K and K v among the faces; returns the
    /// largest speed of a particle along an axis in cells per second, and the largest λ.
    fn share(&mut self) -> [f64; 2] {
        self.see_gas();
        let density = self.setup.powder.density;
        let cell = self.grid.cell_volume();
        let inverse = self.grid.spacing.map(|h| 1.0 / h);
        let mass = density * self.volume;
        self.exchange.fill([0.0; 6]);
        let mut fastest = [0.0f64; 2];
        let radius = self.radius;
        let particles = self.dem.positions().iter().zip(self.dem.velocities());
        for ((position, velocity), rate) in particles.zip(&mut self.rates) {
            let (faces, cells) = self.mapping.face_shares(*position);
            let [ux, uy, uz] = faces.see(&self.seen);
            let [.., phi] = cells.see(&self.seen);
            let v = velocity.vector();
            let slip = [ux - v[0], uy - v[1], uz - v[2]];
            let speed = slip.iter().map(|s| s * s).sum::<f64>().sqrt();
            let ratio = position.0[3] / radius;
            *rate = self.drag_on.of_sphere(phi, speed, ratio) / density;
            let k = mass * ratio.powi(3) * *rate / cell;
            faces.give(&mut self.exchange, [k; 3], v.map(|v| k * v));
            let way = (0..3).map(|axis| v[axis].abs() * inverse[axis]).fold(0.0, f64::max);
            fastest = [fastest[0].max(way), fastest[1].max(*rate)];
        }
        self.mapping.smooth(&mut self.exchange);
        let (exchange, index) = (&self.exchange, index(self.grid.cells));
        for axis in 0..3 {
            self.drag[axis].set(|cell| exchange[index(cell)][axis]);
            self.given[axis].set(|cell| exchange[index(cell)][3 + axis]);
        }
        fastest
    }

    /// Gas velocity on faces and φ at centres, as particles see them.
    fn see_gas(&mut self) {
        let (layout, nx) = (self.rows.layout(), self.grid.cells[0]);
        for number in 0..layout.rows() {
            let row = layout.row(number);
            let seen = &mut self.seen[number * nx..][..nx];
            for axis in 0..3 {
                for (seen, u) in seen.iter_mut().zip(self.gas[axis].row(row)) {
                    seen[axis] = *u;
                }
            }
            for (seen, phi) in seen.iter_mut().zip(self.phi[0].row(row)) {
                seen[3] = *phi;
            }
        }
        self.mapping.smooth(&mut self.seen);
    }

    /// Gas velocity on faces and pressure gradient at centres, as particles see them.
    fn see_pulls(&mut self) {
        let (layout, nx) = (self.rows.layout(), self.grid.cells[0]);
        let inverse = self.grid.spacing.map(|h| 1.0 / h);
        for number in 0..layout.rows() {
            let row = layout.row(number);
            let pulls = &mut self.pulls[number * nx..][..nx];
            for axis in 0..3 {
                let (u, pressure) = (self.gas[axis].row(row), &self.pressure);
                let (below, above) =
                    (pressure.row(row.near(axis, -1)), pressure.row(row.near(axis, 1)));
                for (i, pull) in pulls.iter_mut().enumerate() {
                    pull[axis] = u[i];
                    pull[3 + axis] = 0.5 * inverse[axis] * (above[i] - below[i]);
                }
            }
        }
        self.mapping.smooth(&mut self.pulls);
    }

    /// What each particle is owed after a step of the gas of `dt`, as a change of its velocity.
    fn owe(&mut self, dt: f64) {
        self.see_pulls();
        let density = self.setup.powder.density;
        let weight = self.driven()[0] / density;
        let Self { dem, mapping, pulls, rates, .. } = self;
        for place in 0..dem.len() {
            let position = dem.positions()[place];
            let (faces, cells) = mapping.face_shares(position);
            let u = faces.see(pulls);
            let [.., x, y, z] = cells.see(pulls);
            let slope = [x, y, z];
            let v = dem.velocities()[place].vector();
            let rate = rates[place];
            let change: [f64; 3] = std::array::from_fn(|axis| {
                let up = if axis == 2 { weight } else { 0.0 };
                dt * (rate * (u[axis] - v[axis]) - slope[axis] / density + up)
            });
            dem.drives_mut()[place] = Quad([change[0], change[1], change[2], 0.0]);
        }
        if let Some(viscous) = &mut self.viscous {
            viscous.see(self.rows.layout(), &mut self.mapping);
            let impulse = dt / density;
            for place in 0..self.dem.len() {
                let seen = self.mapping.shares(self.dem.positions()[place]).see(&viscous.seen);
                let owed = &mut self.dem.drives_mut()[place].0;
                for axis in 0..3 {
                    owed[axis] += impulse * seen[axis];
                }
            }
        }
    }

    /// The grid.
    pub fn grid(&self) -> Grid<3> {
        self.grid
    }

    /// The particles.
    pub fn particles(&self) -> &Dem {
        &self.dem
    }

    /// Simulated time \[s\].
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Seconds that each of [`STAGES`] took so far.
    pub fn stage_seconds(&self) -> [f64; STAGES.len()] {
        self.clock
    }

    /// Slip velocity of the uniform state at the box's mean solids fraction \[m/s\].
    pub fn uniform_slip(&self) -> f64 {
        let Setup { powder, gas, gravity, solids_fraction, .. } = &self.setup;
        homogeneous_slip(&self.law, powder, gas, *gravity, *solids_fraction)
    }

    /// Means over the box; the momentum includes what particles are owed.
    pub fn means(&self) -> Means<3> {
        let layout = self.rows.layout();
        let cells = self.grid.len() as f64;
        let (mut gas, mut square) = (0.0, 0.0);
        let mut momentum = [0.0; 3];
        for row in (0..layout.rows()).map(|number| layout.row(number)) {
            square += self.phi[0].row(row).iter().map(|phi| phi * phi).sum::<f64>();
            for (axis, momentum) in momentum.iter_mut().enumerate() {
                let below = row.near(axis, -1);
                let u = self.gas[axis].row(row);
                // The inertia of the gas goes with the fractions of the step before.
                let (lower, upper) = (self.phi[1].row(below), self.phi[1].row(row));
                for (i, u) in u.iter().enumerate() {
                    *momentum += (1.0 - 0.5 * (lower[i] + upper[i])) * u;
                }
            }
            let (lower, upper) = (self.phi[0].row(row.near(2, -1)), self.phi[0].row(row));
            for (i, u) in self.gas[2].row(row).iter().enumerate() {
                gas += (1.0 - 0.5 * (lower[i] + upper[i])) * u;
            }
        }
        let mean = self.setup.solids_fraction;
        let (density, whole) = (self.setup.powder.density, self.whole);
        let (mut falling, mut seen) = (0.0, 0.0);
        let mut solids = [0.0; 3];
        let particles = self.dem.velocities().iter().zip(self.dem.drives());
        for ((velocity, owed), position) in particles.zip(self.dem.positions()) {
            let volume = self.ratio(position).powi(3);
            falling += volume * velocity.0[2];
            for axis in 0..3 {
                solids[axis] += volume * (velocity.0[axis] + owed.0[axis]);
            }
            seen += volume * self.mapping.face_shares(*position).0.see(&self.pulls)[2];
        }
        let falling = falling / whole;
        Means {
            slip: gas / (cells * (1.0 - mean)) - falling,
            particle_slip: seen / whole - falling,
            solids_fraction: self.phi[0].mean(),
            solids_fraction_variance: (square / cells - mean * mean).max(0.0),
            momentum: std::array::from_fn(|axis| {
                self.setup.gas.density * momentum[axis] / cells
                    + density * mean * solids[axis] / whole
            }),
            pressure_gradient: self.pressure_gradient(),
        }
    }
}

/// The place of a cell in a list, the first axis fastest.
fn index([nx, ny, _]: [usize; 3]) -> impl Fn([usize; 3]) -> usize {
    move |[i, j, k]| (k * ny + j) * nx + i
}

impl Simulation<3> for CfdDem {
    fn step(&mut self, until: f64) -> Result<StepReport, Failure> {
        Ok(self.step(until)?)
    }
    fn time(&self) -> f64 {
        self.time
    }
    fn means(&self) -> Means<3> {
        self.means()
    }
    fn fields(&self, fine: &mut FineFields<3>) {
        self.fields(fine);
    }
    fn particles(&self) -> Option<Vec<dem::Sphere>> {
        Some(self.dem.spheres())
    }
    fn uniform_slip(&self) -> f64 {
        self.uniform_slip()
    }
    fn save_state(&self, to: &mut dyn Write) -> io::Result<()> {
        self.save_state(to)
    }
    fn restore_state(&mut self, from: &mut dyn Read) -> Result<(), Failure> {
        Ok(self.restore_state(from)?)
    }
}

#[cfg(test)]
mod tests;
