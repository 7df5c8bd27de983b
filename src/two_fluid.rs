//! [`TwoFluid`]: the kinetic-theory two-fluid model in a periodic box.
//!
//! Balances of mass and momentum of both phases and of granular energy (Agrawal et al. 2001; see
//! [`laws`](crate::laws) for the closures), driven by gravity and a mean gas pressure gradient that
//! balances the weight, or keeps the gas flux ([`TwoFluid::with_gas_flux`]). The gas is incompressible.
//!
//! Staggered grid: solids fraction φ, granular temperature T and gas pressure p at cell centres,
//! velocities on faces. A step of [`TwoFluid::step`]:
//!
//! 1. volume fluxes through the faces: solids upwind, gas the rest of the divergence-free total;
//! 2. φ and T by those fluxes;
//! 3. momentum of both phases by the same fluxes, the gas in as many sub-steps as it needs (if it
//!    carries momentum at all, see [`Terms`]);
//! 4. drag coefficient and kinetic-theory closures, with the frictional viscosity if there is one;
//! 5. viscous stress of the solids, with the heat that its loss of kinetic energy makes;
//! 6. balance of granular energy, implicit in each cell (its rate of change, conduction and step 2
//!    left out if it is algebraic); solids pressure;
//! 7. viscous stress of the gas (if it has one); drag implicit on each face, with weight, solids pressure and the old gas pressure;
//! 8. projection: the pressure increment that makes the total volume flux divergence-free.
//!
//! Momentum of the mixture is conserved to round-off, because every exchange is one number with
//! two signs.

mod clock;
mod drive;
mod exchange;
mod extrapolate;
mod failure;
mod fields;
mod granular;
mod imposed;
mod state;
mod stress;
mod sweep;
mod transport;

use crate::case::{
    DragChoice, FrictionChoice, GranularEnergyChoice, RadialDistributionChoice, Terms, with_drag,
    with_friction, with_radial_distribution,
};
use crate::drive::{GasFlux, uniform_velocities};
use crate::field::{Faces, Field, Layout};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::kinetic_theory::KineticTheory;
use crate::laws::scales::{Gas, Powder, Scales, homogeneous_slip};
use crate::poisson::Poisson;
use crate::real::Real;
use crate::rows::{Rows, join, per_axis, threads};
use crate::simulation::{
    DIFFUSION, FIRST_STEP, Failure, GROWTH, LONGEST_STEP, Simulation, UNSOLVED,
};
pub use crate::simulation::{Limit, Means, StepReport};
pub use clock::STAGES;
use clock::{Clock, Stage};
use exchange::Inertia;
use extrapolate::Extrapolation;
pub use failure::{Place, StepError};
use granular::{Contact, ContactRow, DragRow};
pub use imposed::Quantity;
use imposed::Sources;
use rand::{RngExt, SeedableRng};
pub use state::StateError;
use std::io::{self, Read, Write};
use sweep::{After, Before, Fastest, Sweep, both_faces};

/// Solids fraction added to the solids' inertia (not to their weight or volume), so that velocity
/// and temperature of an empty cell are defined. It takes part in no force and is not carried.
const GHOST: f64 = 1e-7;

/// Largest Courant number of the solids' and of a gas sub-step's advection, summed over the axes of
/// a cell. Unsplit advection with time-centred face values is stable up to 1; statistics at 0.95, 0.8
/// and 0.4 agree within their errors (values at the old time instead give false states at 0.8).
const COURANT: f64 = 0.95;

/// Share of the mean solids fraction below which a cell's solids do not limit the step. What blows
/// through a cell that is all but empty would otherwise set the step of the box; it is at most what
/// the cell holds, at any Courant number, so that it stays positive, and above 1 moves a cell a step.
const THIN: f64 = 0.02;

/// Most gas sub-steps in a step.
const MOST_GAS_STEPS: usize = 4;

/// Courant number of the granular sound; the staggered leap between φ and u_s is stable up to 1
/// on the norm that [`TwoFluid::step`] uses.
const SOUND_COURANT: f64 = 0.9;

/// Solids fraction above the densest packing that no step is to fill a cell beyond, and the least room
/// up to there: what has come this close is left to the contact pressure.
const PACKED: f64 = 0.01;
const LEAST_ROOM: f64 = 0.001;

/// That of a step by the diffusivities of the uniform state: a wave on a uniform bed is what is left
/// of drag, inertia and viscous stress that all but cancel, so that it grows by 1.5 % too little if a
/// step is as long as is stable, by 0.8 % with these. Clustered beds have other limits.
const SMOOTH: f64 = 0.2;

/// Share of the mean solids fraction below which a cell is nearly empty.
const NEARLY_EMPTY: f64 = 0.5;

/// Time step below which a run would not end, in u_t/g.
const SHORTEST_STEP: f64 = 1e-6;

/// Remaining divergence of the total volume flux, times dt, that ends the pressure iteration. The next
/// step's increment makes up for it. At 3e-3 and 1e-2 slip and variance of three seeds agree with these
/// within their errors, for 5 and 11 % of the time, but a mean gas flux is kept less well.
pub const TOLERANCE: f64 = 1e-3;

/// Fewest slabs of a part of the box that a thread of its own makes.
const LEAST_SLABS: usize = 16;

/// Most pressure iterations in a step.
const MOST_ITERATIONS: usize = 60;

/// What fills the box, in the solver's precision.
struct Medium<R> {
    theory: KineticTheory<R>,
    contact: Box<dyn ContactRow<R>>,
    drag: Box<dyn DragRow<R>>,
    solids_density: R,
    gas_density: R,
}

impl<R: Real> Medium<R> {
    fn new(setup: &Setup) -> Self {
        let Setup { powder, gas, .. } = setup;
        Self {
            theory: KineticTheory::new(gas, powder),
            contact: contact_rows(setup),
            drag: drag_rows(setup),
            solids_density: R::of(powder.density),
            gas_density: R::of(gas.density),
        }
    }
}

/// What the two-fluid model is asked to compute.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// The powder.
    pub powder: Powder,
    /// The gas.
    pub gas: Gas,
    /// Gravity \[m/s²\].
    pub gravity: f64,
    /// Fine-grid drag law.
    pub drag: DragChoice,
    /// Radial distribution of particles in contact.
    pub radial_distribution: RadialDistributionChoice,
    /// Frictional pressure.
    pub friction: FrictionChoice,
    /// What of the equations is modelled.
    pub terms: Terms,
    /// Mean solids fraction of the box.
    pub solids_fraction: f64,
    /// Relative amplitude of the initial random perturbation of the solids fraction.
    pub perturbation: f64,
    /// Its seed.
    pub seed: u64,
    /// Whether a step may use the threads of the current pool.
    pub parallel: bool,
}

/// The kinetic-theory two-fluid model, in a periodic box of `D` dimensions.
pub struct TwoFluid<R, const D: usize> {
    grid: Grid<D>,
    rows: Rows<D>,
    setup: Setup,
    scales: Scales,
    medium: Medium<R>,
    /// The same in double precision, for what is handed to the filter.
    seen: Medium<f64>,
    /// Weight less the mean pressure gradient's push, g (ρ_mean - ρ_k), for solids and gas \[N/m³\].
    buoyancy: [R; 2],
    time: f64,
    steps: u64,
    next_dt: (f64, Limit),
    /// The longest step at which waves of the uniform state grow as they should \[s\].
    smooth_step: f64,
    /// Largest Σ |u_a|/h_a of the gas in a cell \[1/s\].
    gas_speed: f64,
    /// What the parts of the steps cost, if [`TwoFluid::with_clock`] asked.
    clock: Option<Clock>,
    /// [`TOLERANCE`], or what [`TwoFluid::with_tolerance`] set.
    tolerance: f64,
    /// What [`TwoFluid::with_gas_flux`] asked to keep.
    gas_flux: Option<GasFlux>,
    /// What [`TwoFluid::set_sources`] set.
    sources: Option<Sources<R, D>>,
    /// What [`TwoFluid::set_half_sources`] set.
    half_sources: [Option<Sources<R, D>>; 2],
    /// What [`TwoFluid::with_second_order`] needs.
    extrapolation: Option<Box<Extrapolation<R, D>>>,

    phi: Field<R, D>,
    theta: Field<R, D>,
    pressure: Field<R, D>,
    /// Change of the pressure in the last step, where the next one's solution starts.
    increment: Field<R, D>,
    solids: Faces<R, D>,
    gas: Faces<R, D>,

    // What a step leaves behind, so that none is allocated in it.
    phi_new: Field<R, D>,
    theta_new: Field<R, D>,
    solids_new: Faces<R, D>,
    gas_new: Faces<R, D>,
    /// β/φ, which the pressure's correction asks for again.
    drag: Field<R, D>,
    right: Field<R, D>,
    sweeps: Vec<Sweep<R, D>>,
    poisson: Poisson<R, D>,
}

impl Setup {
    /// Scales of the powder in the gas.
    fn scales(&self) -> Scales {
        Scales::new(&self.powder, &self.gas, self.gravity)
    }
}

fn drag_rows<R: Real>(setup: &Setup) -> Box<dyn DragRow<R>> {
    with_drag!(setup.drag, R, &setup.gas, &setup.powder, |law| Box::new(law))
}

fn contact_rows<R: Real>(setup: &Setup) -> Box<dyn ContactRow<R>> {
    let powder = &setup.powder;
    let u_t = setup.scales().terminal_velocity;
    with_radial_distribution!(setup.radial_distribution, R, powder, |radial| {
        with_friction!(setup.friction, R, powder, u_t, |friction| {
            Box::new(Contact { radial, friction })
        })
    })
}

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// The uniform fluidised state, its solids fraction perturbed by white noise, in the frame in
    /// which the mixture has no momentum.
    pub fn new(grid: Grid<D>, setup: Setup) -> Self {
        // Of exactly zero mean, at most the amplitude.
        let mut random = rand_pcg::Pcg64::seed_from_u64(setup.seed);
        let noise: Vec<f64> = (0..grid.len()).map(|_| random.random_range(-1.0..1.0)).collect();
        let noise_mean = noise.iter().sum::<f64>() / noise.len() as f64;
        let mut noise = noise.into_iter();
        Self::perturbed(grid, setup, |_| noise.next().unwrap_or_default() - noise_mean)
    }

    /// The uniform fluidised state, perturbed as the relative change φ/⟨φ⟩ - 1 =
    /// `setup.perturbation` times `shape` of a cell's index, in the frame in which the mixture has
    /// no momentum.
    pub fn perturbed(
        grid: Grid<D>,
        setup: Setup,
        mut shape: impl FnMut([usize; D]) -> f64,
    ) -> Self {
        let Setup { powder, gas, gravity, solids_fraction: mean, .. } = setup;
        let layout = Layout::from(&grid);
        let zeros = || Field::zeros(layout);
        let slip = uniform_slip(&setup);
        let contact = contact_rows::<f64>(&setup);

        let mut phi = zeros();
        phi.set(|index| R::of(mean * (1.0 + setup.perturbation * shape(index))));
        let mean = phi.mean();

        let mixture = powder.density * mean + gas.density * (1.0 - mean);
        let mut theta = zeros();
        let g0 = contact.radial_distribution(setup.solids_fraction);
        let temperature = uniform_temperature(&setup, g0, slip);
        theta.set(|_| R::of(temperature));
        let mut solids = Field::zero_faces(layout);
        let mut carrier = Field::zero_faces(layout);
        let [falling, rising] = uniform_velocities(&powder, &gas, mean, slip);
        solids[D - 1].set(|_| R::of(falling));
        carrier[D - 1].set(|_| R::of(rising));

        let scales = setup.scales();
        let time_scale = scales.time();
        let diffusivity = uniform_diffusivity(&setup, g0, temperature, slip);
        Self {
            grid,
            rows: Rows::new(layout, setup.parallel),
            medium: Medium::new(&setup),
            seen: Medium::new(&setup),
            buoyancy: [
                R::of(gravity * (mixture - powder.density)),
                R::of(gravity * (mixture - gas.density)),
            ],
            setup,
            scales,
            time: 0.0,
            steps: 0,
            next_dt: first_step(&grid, &setup, time_scale),
            // Without solids there are no waves of theirs.
            smooth_step: if mean > 0.0 {
                SMOOTH / (diffusivity * inverse_square(&grid))
            } else {
                f64::INFINITY
            },
            gas_speed: slip / grid.spacing[D - 1],
            clock: None,
            tolerance: TOLERANCE,
            gas_flux: None,
            sources: None,
            half_sources: [None, None],
            extrapolation: None,
            phi,
            theta,
            pressure: zeros(),
            solids,
            gas: carrier,
            phi_new: zeros(),
            theta_new: zeros(),
            solids_new: Field::zero_faces(layout),
            gas_new: Field::zero_faces(layout),
            drag: zeros(),
            right: zeros(),
            sweeps: sweeps(layout, &setup),
            increment: zeros(),
            poisson: Poisson::new(&grid, setup.parallel),
        }
    }

    /// With `tolerance` for the divergence of the total volume flux, times dt, in place of [`TOLERANCE`]:
    /// what the pressure leaves of it hides a perturbation that is not much larger.
    #[must_use]
    pub fn with_tolerance(mut self, tolerance: f64) -> Self {
        self.tolerance = tolerance;
        self
    }

    /// With a clock, for [`TwoFluid::stage_seconds`].
    #[must_use]
    pub fn with_clock(mut self) -> Self {
        self.clock = Some(Clock::new());
        self
    }

    /// Seconds that each of [`STAGES`] took in all steps since [`TwoFluid::with_clock`].
    pub fn stage_seconds(&self) -> Option<[f64; STAGES.len()]> {
        self.clock.as_ref().map(|clock| clock.seconds)
    }

    /// Advances by one time step towards the time `until` \[s\], chosen by stability and such that
    /// equal steps end there.
    ///
    /// # Errors
    /// When the pressure does not converge, a field is no longer finite, or the time step collapses.
    ///
    /// # Panics
    /// When `until` is not in the future.
    pub fn step(&mut self, until: f64) -> Result<StepReport, StepError> {
        assert!(until > self.time, "a step from {} s to {until} s", self.time);
        Clock::start(&mut self.clock);
        let (longest, limit) = self.next_dt;
        let remaining = until - self.time;
        let left = (remaining / longest - 1e-9).ceil().max(1.0);
        let dt = if left.is_finite() { remaining / left } else { longest };
        let (report, fastest) = self.advance(dt, limit)?;
        // The last step ends there to the bit, whatever the sum of the steps rounds to.
        self.time = if left == 1.0 { until } else { self.time + dt };
        self.steps += 1;
        let rates = self.find_speeds();
        self.next_dt = self.choose_step(longest, rates, fastest);
        if self.next_dt.0 < SHORTEST_STEP * self.time_scale() {
            return Err(self.collapsed());
        }
        Clock::lap(&mut self.clock, Stage::Correction);
        Ok(report)
    }

    /// The algorithm of the module, once; leaves what limits the next step to be found.
    fn advance_once(
        &mut self,
        dt: f64,
        limit: Limit,
    ) -> Result<(StepReport, Fastest<f64>), StepError> {
        let rows = self.rows;
        let inverse_spacing = self.grid.spacing.map(|h| R::of(1.0 / h));
        let inverse_square = inverse_square(&self.grid);
        let gas_courant = dt * self.gas_speed;
        let gas_steps = if self.setup.terms.gas_inertia {
            ((gas_courant / COURANT).ceil() as usize).clamp(1, MOST_GAS_STEPS)
        } else {
            0
        };

        let before = Before {
            layout: rows.layout(),
            medium: &self.medium,
            phi: &self.phi,
            theta: &self.theta,
            pressure: &self.pressure,
            solids: &self.solids,
            gas: &self.gas,
            buoyancy: self.driven(),
            dt: R::of(dt),
            gas_steps,
            transports_heat: self.setup.terms.granular_energy == GranularEnergyChoice::Transport,
            gas_stress: self.setup.terms.gas_stress,
            courant: self.grid.spacing.map(|h| R::of(dt / h)),
            inverse_spacing,
            most_diffusivity: R::of(DIFFUSION / (dt * inverse_square)),
            nearly_empty: R::of(NEARLY_EMPTY * self.setup.solids_fraction),
            sources: self.sources.as_ref(),
        };
        let after = After {
            phi: self.phi_new.slabs(),
            theta: self.theta_new.slabs(),
            solids: self.solids_new.each_mut().map(Field::slabs),
            gas: self.gas_new.each_mut().map(Field::slabs),
            drag: self.drag.slabs(),
            weights: self.poisson.weights_mut().each_mut().map(Field::slabs),
            right: self.right.slabs(),
        };
        let fastest = sweep_all(&mut self.sweeps, &before, after);
        std::mem::swap(&mut self.phi, &mut self.phi_new);
        std::mem::swap(&mut self.theta, &mut self.theta_new);
        std::mem::swap(&mut self.solids, &mut self.solids_new);
        std::mem::swap(&mut self.gas, &mut self.gas_new);

        Clock::lap(&mut self.clock, Stage::Sweep);

        self.poisson.prepare();
        // The increment starts from that of the step before, which saves a third of the iterations.
        let solve = self.poisson.solve(
            &mut self.increment,
            &self.right,
            self.tolerance / dt,
            MOST_ITERATIONS,
        );
        Clock::lap(&mut self.clock, Stage::Pressure);

        let inertia = Inertia::new(&self.medium, R::of(dt));
        let (phi, drag, increment) = (&self.phi, &self.drag, &self.increment);
        for axis in 0..D {
            rows.map([&mut self.solids[axis], &mut self.gas[axis]], |row, [us, ug]| {
                let below = row.near(axis, -1);
                exchange::correct_row(
                    us,
                    ug,
                    [phi.row(below), phi.row(row)],
                    [drag.row(below), drag.row(row)],
                    [increment.row(below), increment.row(row)],
                    inertia,
                    inverse_spacing[axis],
                );
            });
        }
        rows.map([&mut self.pressure], |row, [p]| exchange::add_row(p, increment.row(row)));

        self.keep_gas_flux(dt);

        let report = StepReport {
            dt,
            limit,
            gas_steps,
            iterations: solve.iterations,
            volume_residual: solve.residual * dt,
        };
        let fastest = fastest.f64();
        if !(report.volume_residual.is_finite() && fastest.is_finite() && self.is_finite()) {
            return Err(self.not_finite(&report));
        }
        if report.volume_residual > UNSOLVED {
            return Err(self.not_converged(&report));
        }
        Clock::lap(&mut self.clock, Stage::Correction);
        Ok((report, fastest))
    }

    /// The longest next time step after one that might have been `longest`, and what limits it.
    fn choose_step(
        &self,
        longest: f64,
        [solids_speed, filling]: [f64; 2],
        Fastest { sound_squared, diffusivity }: Fastest<f64>,
    ) -> (f64, Limit) {
        let tiny = 1e-300;
        let inverse_square = inverse_square(&self.grid);
        let diffusivity = diffusivity.max(gas_diffusivity(&self.setup));
        [
            (COURANT / (solids_speed + tiny), Limit::Solids),
            (MOST_GAS_STEPS as f64 * COURANT / (self.gas_speed + tiny), Limit::Gas),
            (SOUND_COURANT / (sound_squared * inverse_square + tiny).sqrt(), Limit::Sound),
            (DIFFUSION / (diffusivity * inverse_square + tiny), Limit::Diffusion),
            (self.smooth_step, Limit::Diffusion),
            (1.0 / (filling + tiny), Limit::Packing),
            (LONGEST_STEP * self.time_scale(), Limit::Longest),
        ]
        .into_iter()
        .fold(
            (GROWTH * longest, Limit::Growth),
            |best, next| if next.0 < best.0 { next } else { best },
        )
    }

    /// Leaves how fast the gas carries momentum across a cell, 0 if it carries none; returns how fast
    /// the solids do, and how fast they fill what room is left in a cell \[1/s\].
    fn find_speeds(&mut self) -> [f64; 2] {
        let (rows, phi) = (self.rows, &self.phi);
        let inverse_spacing = self.grid.spacing.map(|h| R::of(1.0 / h));
        let thin = R::of(THIN * self.setup.solids_fraction);
        let room = [self.setup.powder.max_packing + PACKED, LEAST_ROOM].map(R::of);
        let layout = rows.layout();
        let [solids, gas, filling] = rows.map_reduce::<R, _, 0>(
            [],
            &|row, []| {
                let (us, ug) = (both_faces(&self.solids, row), both_faces(&self.gas, row));
                let phi: [[&[R]; 3]; D] =
                    per_axis!(D, |a| [-1, 0, 1].map(|n| phi.row(row.near(a, n))));
                let blocks = layout.blocks(phi[0][1].len());
                exchange::largest_rates(blocks, us, ug, phi, thin, room, inverse_spacing)
            },
            &|a: [R; 3], b: [R; 3]| std::array::from_fn(|n| a[n].max(b[n])),
        );
        self.gas_speed = if self.setup.terms.gas_inertia { gas.f64() } else { 0.0 };
        [solids.f64(), filling.f64()]
    }

    /// u_t/g \[s\].
    fn time_scale(&self) -> f64 {
        self.scales.time()
    }

    /// Simulated time \[s\].
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// The grid.
    pub fn grid(&self) -> Grid<D> {
        self.grid
    }

    /// Solids fraction at cell centres.
    pub fn solids_fraction(&self) -> &Field<R, D> {
        &self.phi
    }

    /// Granular temperature at cell centres \[m²/s²\].
    pub fn granular_temperature(&self) -> &Field<R, D> {
        &self.theta
    }

    /// Slip velocity of the uniform state at the box's mean solids fraction \[m/s\].
    pub fn uniform_slip(&self) -> f64 {
        uniform_slip(&self.setup)
    }

    /// Means over the box.
    pub fn means(&self) -> Means<D> {
        let (rows, up) = (self.rows, D - 1);
        let (rho_s, rho_g) = (self.setup.powder.density, self.setup.gas.density);
        // Σ over faces: φ u_s, (1-φ) u_g, φ u_g along the vertical; Σ φ, Σ φ² over cells.
        let [solids, gas, seen, phi, square] = rows.fold(
            &|row| {
                let mut sums = [0.0; 5];
                let (below, here) = (self.phi.row(row.near(up, -1)), self.phi.row(row));
                let (us, ug) = (self.solids[up].row(row), self.gas[up].row(row));
                for i in 0..here.len() {
                    let face = 0.5 * (below[i].f64() + here[i].f64());
                    let (us, ug, phi) = (us[i].f64(), ug[i].f64(), here[i].f64());
                    sums[0] += face * us;
                    sums[1] += (1.0 - face) * ug;
                    sums[2] += face * ug;
                    sums[3] += phi;
                    sums[4] += phi * phi;
                }
                sums
            },
            &|a, b| std::array::from_fn(|n| a[n] + b[n]),
        );
        let cells = self.grid.len() as f64;
        let mean = phi / cells;
        let momentum = std::array::from_fn(|a| {
            let sum = rows.fold(
                &|row| {
                    let phi = self.phi.row(row.near(a, -1)).iter().zip(self.phi.row(row));
                    let velocities = self.solids[a].row(row).iter().zip(self.gas[a].row(row));
                    phi.zip(velocities)
                        .map(|((below, here), (us, ug))| {
                            let face = 0.5 * (below.f64() + here.f64());
                            rho_s * (face + GHOST) * us.f64() + rho_g * (1.0 - face) * ug.f64()
                        })
                        .sum::<f64>()
                },
                &|a, b| a + b,
            );
            sum / cells
        });
        Means {
            slip: gas / (cells - phi) - solids / phi,
            particle_slip: (seen - solids) / phi,
            solids_fraction: mean,
            solids_fraction_variance: (square / cells - mean * mean).max(0.0),
            momentum,
            pressure_gradient: self.pressure_gradient(),
        }
    }
}

impl<R: Real, const D: usize> Simulation<D> for TwoFluid<R, D> {
    fn step(&mut self, until: f64) -> Result<StepReport, Failure> {
        Ok(self.step(until)?)
    }
    fn time(&self) -> f64 {
        self.time
    }
    fn means(&self) -> Means<D> {
        self.means()
    }
    fn fields(&self, fine: &mut FineFields<D>) {
        self.fields(fine);
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

/// Sweeps over the parts of a box: as many as may be made at once, none much smaller than what it
/// makes again beside its neighbours.
fn sweeps<R: Real, const D: usize>(layout: Layout<D>, setup: &Setup) -> Vec<Sweep<R, D>> {
    let slabs = layout.cells[D - 1];
    let parts = if setup.parallel { threads().min(slabs / LEAST_SLABS).max(1) } else { 1 };
    let end = |n| n * slabs / parts;
    (0..parts).map(|n| Sweep::new(layout, setup, end(n), end(n + 1))).collect()
}

/// Does all sweeps, each of its part of `after`.
fn sweep_all<R: Real, const D: usize>(
    sweeps: &mut [Sweep<R, D>],
    before: &Before<'_, R, D>,
    mut after: After<'_, R, D>,
) -> Fastest<R> {
    if let [sweep] = sweeps {
        return sweep.run(before, &mut after);
    }
    let (lower, upper) = sweeps.split_at_mut(sweeps.len() / 2);
    let (below, above) = after.split_at(upper[0].first_slab());
    let (a, b) = join(true, || sweep_all(lower, before, below), || sweep_all(upper, before, above));
    a.or(b)
}

/// Diffusivity of the gas's momentum \[m²/s\]; 0 if it has no stress.
fn gas_diffusivity(setup: &Setup) -> f64 {
    if setup.terms.gas_stress { setup.gas.viscosity / setup.gas.density } else { 0.0 }
}

/// The first time step, of [`FIRST_STEP`] or what the viscosity of the gas allows.
fn first_step<const D: usize>(grid: &Grid<D>, setup: &Setup, time_scale: f64) -> (f64, Limit) {
    let most = DIFFUSION / (gas_diffusivity(setup) * inverse_square(grid));
    let first = FIRST_STEP * time_scale;
    if most < first { (most, Limit::Diffusion) } else { (first, Limit::Growth) }
}

/// Slip velocity of the uniform state \[m/s\].
fn uniform_slip(setup: &Setup) -> f64 {
    let Setup { powder, gas, gravity, solids_fraction, .. } = setup;
    homogeneous_slip(&setup.drag.law(gas, powder), powder, gas, *gravity, *solids_fraction)
}

/// β/φ of the uniform state, at which drag carries the weight \[kg/m³/s\].
fn uniform_drag(setup: &Setup, slip: f64) -> f64 {
    let Setup { powder, gas, gravity, solids_fraction, .. } = setup;
    (1.0 - solids_fraction) * (powder.density - gas.density) * gravity / slip
}

/// Granular temperature at which production by `slip` balances dissipation \[m²/s²\].
fn uniform_temperature(setup: &Setup, g0: f64, slip: f64) -> f64 {
    let theory = KineticTheory::<f64>::new(&setup.gas, &setup.powder);
    theory.steady_temperature(setup.solids_fraction, g0, uniform_drag(setup, slip), slip)
}

/// Largest viscosity or conductivity per mass of the solids in the uniform state \[m²/s\].
fn uniform_diffusivity(setup: &Setup, g0: f64, temperature: f64, slip: f64) -> f64 {
    let theory = KineticTheory::<f64>::new(&setup.gas, &setup.powder);
    let phi = setup.solids_fraction;
    let transport = theory.transport(phi, g0, temperature, uniform_drag(setup, slip));
    transport.most_diffusive() / (setup.powder.density * phi)
}

/// Σ 1/h² \[1/m²\].
fn inverse_square<const D: usize>(grid: &Grid<D>) -> f64 {
    grid.spacing.iter().map(|h| 1.0 / (h * h)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::drag::DragLaw;
    use crate::laws::scales::Scales;
    use crate::laws::scales::tests::{GAS, POWDER};

    pub(super) fn setup(solids_fraction: f64, perturbation: f64) -> Setup {
        Setup {
            powder: POWDER,
            gas: GAS,
            gravity: 9.81,
            drag: DragChoice::WenYu,
            radial_distribution: RadialDistributionChoice::Princeton,
            friction: FrictionChoice::Barrier,
            terms: Terms::default(),
            solids_fraction,
            perturbation,
            seed: 1,
            parallel: false,
        }
    }

    fn uniform_stays<const D: usize>(cells: [usize; D]) {
        let u_t = Scales::new(&POWDER, &GAS, 9.81).terminal_velocity;
        for (phi, expected) in [(0.05, 0.8462), (0.15, 0.5847), (0.30, 0.3005)] {
            let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
            let mut flow = TwoFluid::<f64, D>::new(grid, setup(phi, 0.0));
            for _ in 0..300 {
                flow.step(f64::INFINITY).unwrap();
            }
            let slip = flow.means().slip;
            let weight = phi * (1.0 - phi) * (POWDER.density - GAS.density) * 9.81;
            let drag = DragChoice::WenYu.law(&GAS, &POWDER).beta(phi, slip) * slip;
            assert!((drag / weight - 1.0).abs() < 1e-8, "{phi}: {}", drag / weight - 1.0);
            assert!((slip / u_t - expected).abs() < 5e-5);
            let spread = flow.phi.max() - flow.phi.min();
            assert!(spread < 1e-12, "{spread}");
        }
    }

    #[test]
    fn uniform_state_stays_uniform_at_the_published_slip() {
        uniform_stays([16, 16]);
        uniform_stays([8, 8, 16]);
    }

    #[test]
    fn uniform_state_keeps_the_slip_of_its_own_drag_law() {
        use DragChoice::{Beetstra, Gidaspow, Tenneti, WenYu};
        for drag in [WenYu, Gidaspow, Beetstra, Tenneti] {
            for phi in [0.1, 0.35] {
                let grid = Grid::new([0.01, 0.01], [8, 8]);
                let mut flow = TwoFluid::<f64, 2>::new(grid, Setup { drag, ..setup(phi, 0.0) });
                for _ in 0..200 {
                    flow.step(f64::INFINITY).unwrap();
                }
                let slip = flow.means().slip;
                let weight = phi * (1.0 - phi) * (POWDER.density - GAS.density) * 9.81;
                let error = drag.law(&GAS, &POWDER).beta(phi, slip) * slip / weight - 1.0;
                assert!(error.abs() < 1e-8, "{drag} {phi}: {error}");
                assert!(flow.phi.max() - flow.phi.min() < 1e-12);
            }
        }
    }

    /// Fields after some steps of `setup`, made in as many parts as there are `threads`.
    fn in_parts<R: Real, const D: usize>(
        cells: [usize; D],
        threads: usize,
        setup: Setup,
    ) -> (Vec<u8>, usize) {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
            let setup = Setup { parallel: threads > 1, ..setup };
            let mut flow = TwoFluid::<R, D>::new(grid, setup);
            assert_eq!(flow.sweeps.len(), threads);
            let mut most_gas_steps = 0;
            for _ in 0..300 {
                most_gas_steps = most_gas_steps.max(flow.step(f64::INFINITY).unwrap().gas_steps);
            }
            let mut state = Vec::new();
            flow.save_state(&mut state).unwrap();
            (state, most_gas_steps)
        })
    }

    #[test]
    fn parts_make_what_the_whole_makes() {
        let base = setup(0.15, 0.5);
        let (flat, deep) = ([32, 49], [16, 10, 50]);
        for threads in [2, 3] {
            let parts = in_parts::<f64, 2>(flat, threads, base);
            assert!(parts == in_parts::<f64, 2>(flat, 1, base));
            assert!(parts.1 > 1);
            let parts = in_parts::<f32, 3>(deep, threads, base);
            assert!(parts == in_parts::<f32, 3>(deep, 1, base));
        }
        for setup in other_terms(base) {
            let parts = in_parts::<f64, 2>(flat, 2, setup);
            assert!(parts == in_parts::<f64, 2>(flat, 1, setup), "{:?}", setup.terms);
            assert_eq!(parts.1 > 1, setup.terms.gas_inertia, "{:?}", setup.terms);
        }
    }

    #[test]
    fn a_step_of_most_gas_steps_looks_at_no_slab_that_is_gone() {
        // A ring refuses to show what was written over.
        fn check<R: Real, const D: usize>(cells: [usize; D], setup: Setup) {
            for wanted in 1..=MOST_GAS_STEPS {
                let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
                let mut flow = TwoFluid::<R, D>::new(grid, setup);
                flow.gas[D - 1].set(|_| R::of(4.0));
                flow.find_speeds();
                let dt = (wanted as f64 - 0.5) * COURANT / flow.gas_speed;
                let [before, after] = [flow.means(), {
                    assert_eq!(flow.step_by(dt).unwrap().gas_steps, wanted);
                    flow.means()
                }];
                let scale = POWDER.density * setup.solids_fraction;
                let change = after.momentum[D - 1] - before.momentum[D - 1];
                assert!(change.abs() < 1e-5 * scale, "{wanted}: {change:e}");
                assert!(flow.theta.max().f64() < 1.0, "{wanted}: {}", flow.theta.max());
            }
        }
        check::<f64, 2>([32, 48], setup(0.15, 0.1));
        check::<f32, 3>([8, 8, 40], setup(0.15, 0.1));
    }

    /// `setup` with terms that are not the default, one set after the other.
    fn other_terms(setup: Setup) -> [Setup; 4] {
        use GranularEnergyChoice::Algebraic;
        let terms = setup.terms;
        [
            Setup { terms: Terms { gas_inertia: false, ..terms }, ..setup },
            Setup { terms: Terms { granular_energy: Algebraic, ..terms }, ..setup },
            Setup { terms: Terms { gas_stress: true, ..terms }, ..setup },
            Setup {
                terms: Terms { gas_inertia: false, gas_stress: true, granular_energy: Algebraic },
                ..setup
            },
        ]
    }

    #[test]
    fn mass_and_momentum_are_kept_whatever_terms_are_left_out() {
        for setup in other_terms(setup(0.15, 0.3)) {
            let mut flow =
                TwoFluid::<f64, 3>::new(Grid::new([0.0125, 0.0125, 0.02], [10, 10, 16]), setup);
            let start = flow.means();
            for _ in 0..1500 {
                flow.step(f64::INFINITY).unwrap();
            }
            let end = flow.means();
            let mass = end.solids_fraction / start.solids_fraction - 1.0;
            assert!(mass.abs() < 1e-13, "{:?}: {mass:e}", setup.terms);
            for axis in 0..3 {
                let drift = (end.momentum[axis] - start.momentum[axis]) / (1500.0 * 0.15 * 0.22);
                assert!(drift.abs() < 1e-12, "{:?}: {drift:e} along {axis}", setup.terms);
            }
            assert!(end.solids_fraction_variance > 1e-3, "{:?}", setup.terms);
        }
    }

    #[test]
    fn algebraic_temperature_is_that_of_the_uniform_state_at_once() {
        for phi in [0.01, 0.15, 0.4, 0.58] {
            let base = setup(phi, 0.0);
            let terms = Terms { granular_energy: GranularEnergyChoice::Algebraic, ..base.terms };
            let grid = Grid::new([0.01, 0.01], [8, 8]);
            let mut flow = TwoFluid::<f64, 2>::new(grid, Setup { terms, ..base });
            flow.theta.set(|_| 0.0);
            // The second step is from at rest to what the slip alone makes.
            for _ in 0..2 {
                flow.step(f64::INFINITY).unwrap();
            }
            let slip = flow.means().slip;
            let drag = base.drag.law(&GAS, &POWDER).beta_per_fraction(phi, slip);
            let g0 = flow.seen.contact.radial_distribution(phi);
            let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
            let expected = theory.steady_temperature(phi, g0, drag, slip);
            for found in [flow.theta.min(), flow.theta.max()] {
                assert!((found / expected - 1.0).abs() < 1e-6, "{phi}: {found} {expected}");
            }
        }
    }

    #[test]
    fn algebraic_temperature_of_a_clustered_bed_is_like_the_transported_one() {
        let base = setup(0.15, 0.5);
        let algebraic = Terms { granular_energy: GranularEnergyChoice::Algebraic, ..base.terms };
        let grid = Grid::new([0.04, 0.04], [32, 32]);
        let mut flow = TwoFluid::<f64, 2>::new(grid, base);
        // By solids mass.
        let mean = |flow: &TwoFluid<f64, 2>| {
            let cells = flow.phi.interior().flatten().zip(flow.theta.interior().flatten());
            cells.map(|(phi, theta)| phi * theta).sum::<f64>() / (0.15 * 1024.0)
        };
        for sample in 1..=4 {
            while flow.time() < 0.1 * f64::from(sample) {
                flow.step(f64::INFINITY).unwrap();
            }
            // Of the same state: two beds are not alike for long.
            let mut state = Vec::new();
            flow.save_state(&mut state).unwrap();
            let mut other = TwoFluid::<f64, 2>::new(grid, Setup { terms: algebraic, ..base });
            other.restore_state(&mut state.as_slice()).unwrap();
            other.step(f64::INFINITY).unwrap();
            let ratio = mean(&other) / mean(&flow);
            println!("{:.1} s: {ratio}", flow.time());
            assert!((0.5..2.0).contains(&ratio), "{}: {ratio}", flow.time());
            for _ in 0..50 {
                other.step(f64::INFINITY).unwrap();
                assert!(other.theta.min() > 0.0 && other.phi.min() >= 0.0);
            }
        }
        assert!(flow.means().solids_fraction_variance > 5e-3);
    }

    /// Gas almost alone that blows upward at 0.5 m/s and sways to the side as sin k z, k = 2π/1 cm:
    /// amplitude of the swaying over the first, and how far it has turned \[rad\], after `time` \[s\].
    fn swaying_gas(setup: Setup, time: f64) -> (f64, f64) {
        let (cells, edge) = ([8, 64], 0.01);
        let setup = Setup { solids_fraction: 1e-8, ..setup };
        let mut flow = TwoFluid::<f64, 2>::new(Grid::new([edge / 8.0, edge], cells), setup);
        let angle = |j: usize| std::f64::consts::TAU * (j as f64 + 0.5) / cells[1] as f64;
        flow.gas[0].set(|[_, j]| 0.1 * angle(j).sin());
        flow.gas[1].set(|_| 0.5);
        flow.find_speeds();
        while flow.time() < time {
            flow.step(time).unwrap();
        }
        let (mut sine, mut cosine) = (0.0, 0.0);
        for (j, row) in flow.gas[0].interior().enumerate() {
            sine += row[0] * angle(j).sin() / 32.0;
            cosine += row[0] * angle(j).cos() / 32.0;
        }
        (sine.hypot(cosine) / 0.1, (-cosine).atan2(sine))
    }

    #[test]
    fn gas_carries_its_momentum_along_unless_that_is_left_out() {
        let base = setup(0.15, 0.0);
        let time = 4e-3;
        let (amplitude, turned) = swaying_gas(base, time);
        let expected = std::f64::consts::TAU * 0.5 * time / 0.01;
        assert!((turned - expected).abs() < 0.02 && (amplitude - 1.0).abs() < 0.02);

        let terms = Terms { gas_inertia: false, ..base.terms };
        let (amplitude, turned) = swaying_gas(Setup { terms, ..base }, time);
        // Drag by the solids, of 1e-8, takes 2e-6 in this time.
        assert!(turned.abs() < 1e-9 && (amplitude - 1.0).abs() < 1e-5, "{amplitude} {turned}");
    }

    #[test]
    fn friction_carries_a_shear_in_as_many_parts_as_there_are() {
        use FrictionChoice::{Barrier, JohnsonJackson, SrivastavaSundaresan};
        // A bed that is sheared as sin k z, k = 2π/1 cm, gas and all: Coulomb's stress takes
        // P sin Φ ⟨|γ|⟩ of its kinetic energy, whatever the rate γ, the crests apart.
        let (phi, edge, cells) = (0.59, 0.01, 32);
        let wave = std::f64::consts::TAU / cells as f64;
        let kinetic = |friction| {
            let setup = Setup { friction, ..setup(phi, 0.0) };
            let grid = Grid::new([edge, edge], [8, cells]);
            let mut flow = TwoFluid::<f64, 2>::new(grid, setup);
            let sway = |[_, j]: [usize; 2]| 2.0 * (wave * (j as f64 + 0.5)).sin();
            flow.solids[0].set(sway);
            flow.gas[0].set(sway);
            flow.find_speeds();
            let energy = |flow: &TwoFluid<f64, 2>| {
                let squares = flow.solids[0].interior().flatten().map(|u| u * u).sum::<f64>();
                0.5 * POWDER.density * phi * squares / (8 * cells) as f64
            };
            let before = energy(&flow);
            flow.step(f64::INFINITY).unwrap();
            (before - energy(&flow)) / flow.time()
        };
        let printed = 0.05 * f64::powi(phi - 0.5, 2) / f64::powi(0.65 - phi, 5);
        // ⟨|γ|⟩ of a sine of amplitude 2 m/s is 4 · 2 per wavelength.
        let expected = printed * crate::laws::friction::SINE * 8.0 / edge;
        let without = kinetic(Barrier);
        for friction in [JohnsonJackson, SrivastavaSundaresan] {
            let found = kinetic(friction) - without;
            assert!((found / expected - 1.0).abs() < 0.05, "{friction:?}: {found} {expected}");
        }

        let dense = Setup { friction: SrivastavaSundaresan, ..setup(0.53, 0.2) };
        let whole = in_parts::<f64, 2>([16, 36], 1, dense);
        assert!(whole.0 == in_parts::<f64, 2>([16, 36], 2, dense).0);
        let unlike = in_parts::<f64, 2>([16, 36], 1, Setup { friction: Barrier, ..dense });
        assert!(whole.0 != unlike.0);
    }

    #[test]
    fn stress_of_the_gas_stops_its_swaying_at_the_rate_of_its_viscosity() {
        let base = setup(0.15, 0.0);
        let (time, wave) = (0.02, std::f64::consts::TAU / 0.01);
        for gas_inertia in [false, true] {
            let with = |gas_stress| {
                let terms = Terms { gas_inertia, gas_stress, ..base.terms };
                swaying_gas(Setup { terms, ..base }, time).0
            };
            let rate = (with(false) / with(true)).ln() / time;
            let expected = GAS.viscosity / GAS.density * wave * wave;
            assert!((rate / expected - 1.0).abs() < 0.01, "{gas_inertia}: {rate} {expected}");
        }
    }

    #[test]
    fn viscosity_of_the_gas_limits_the_step() {
        // Cells of 0.1 mm and a gas a hundred times as viscous.
        let gas = Gas { viscosity: 1.8e-3, ..GAS };
        let base = Setup { gas, ..setup(0.1, 0.0) };
        let terms = Terms { gas_stress: true, ..base.terms };
        let grid = Grid::new([8e-4, 8e-4], [8, 8]);
        let mut flow = TwoFluid::<f64, 2>::new(grid, Setup { terms, ..base });
        let most = DIFFUSION / (gas.viscosity / gas.density * 2e8);
        for _ in 0..100 {
            assert!(flow.step(f64::INFINITY).unwrap().dt <= most * (1.0 + 1e-12));
        }
        assert_eq!(flow.next_dt.1, Limit::Diffusion);
    }

    /// The most solids in a cell of a dense bed of coarse powder, in `steps` steps.
    fn densest(setup: Setup, steps: usize) -> f64 {
        let powder = Powder { diameter: 300e-6, density: 2500.0, ..POWDER };
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let mut flow = TwoFluid::<f64, 2>::new(grid, Setup { powder, ..setup });
        let mut densest: f64 = 0.0;
        for _ in 0..steps {
            flow.step(f64::INFINITY).unwrap();
            densest = densest.max(flow.phi.max());
        }
        densest
    }

    #[test]
    fn every_friction_keeps_a_dense_bed_from_being_overfilled() {
        use FrictionChoice::{Barrier, JohnsonJackson, Schaeffer, SrivastavaSundaresan};
        for friction in [Barrier, Schaeffer, JohnsonJackson, SrivastavaSundaresan] {
            let found = densest(Setup { friction, ..setup(0.55, 0.1) }, 200);
            assert!(found < POWDER.max_packing + 0.012, "{friction:?}: {found}");
        }
    }

    #[test]
    fn every_radial_distribution_runs_and_carries_a_dense_bed() {
        use RadialDistributionChoice::{CarnahanStarling, MaAhmadi, Princeton};
        let found = [Princeton, CarnahanStarling, MaAhmadi].map(|radial_distribution| {
            densest(Setup { radial_distribution, ..setup(0.55, 0.1) }, 200)
        });
        assert!(found.iter().all(|&most| most < POWDER.max_packing + 0.012), "{found:?}");
        // The choice arrives: no two beds are the same.
        assert!(found[0] != found[1] && found[1] != found[2], "{found:?}");
    }
}
