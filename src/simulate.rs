//! [`simulate`]: one box from its start to its end, sampled in flight.

use crate::case::{Case, Drive, EdgesChoice, FilterCase, KernelChoice, MarkerChoice, Places};
use crate::cfd_dem::{self, CfdDem, spheres};
use crate::dem::Sphere;
use crate::film::Film;
use crate::filter::FilterError;
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::scales::Scales;
use crate::real::Real;
use crate::resolved::start::{self, Expected};
use crate::series::{Onset, steady_start};
use crate::simulation::{Failure, Limit, Means, Simulation, StepReport};
use crate::spectral::Kernel;
use crate::statistics::{Axis, Bins, Marker, MergeError, Sampler, Sampling, Sums};
use crate::stored::StoredSampling;
use crate::two_fluid::{Setup, TwoFluid};
use std::io::{self, Read, Write};

/// Sampling intervals in a block of time, the smallest unit of the error estimate.
const SAMPLES_PER_BLOCK: f64 = 4.0;

/// Least distance between filter positions in flight \[cells\].
const CLOSEST: usize = 4;

/// Means over the box at equal intervals of time, the first at t = 0.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Signals {
    /// Time \[s\].
    pub time: Vec<f64>,
    /// Mean slip, vertical \[m/s\].
    pub slip: Vec<f64>,
    /// Slip seen by the particles, vertical \[m/s\].
    pub particle_slip: Vec<f64>,
    /// Variance of the solids fraction \[-\].
    pub solids_fraction_variance: Vec<f64>,
    /// Mean gas pressure gradient over the weight \[-\]: 1 unless the gas flux is kept.
    pub pressure_gradient: Vec<f64>,
}

impl Signals {
    /// Adds the `means` at `time` \[s\].
    pub fn push<const D: usize>(&mut self, time: f64, means: &Means<D>) {
        let variance = means.solids_fraction_variance;
        let values = [means.slip, means.particle_slip, variance, means.pressure_gradient];
        self.push_values(time, values);
    }

    /// Adds mean slip, slip seen by the particles, variance of φ and pressure gradient at `time`
    /// \[s\].
    pub fn push_values(&mut self, time: f64, values: [f64; 4]) {
        self.time.push(time);
        let [slip, particle_slip, variance, pressure_gradient] = values;
        self.slip.push(slip);
        self.particle_slip.push(particle_slip);
        self.solids_fraction_variance.push(variance);
        self.pressure_gradient.push(pressure_gradient);
    }

    /// The values of sample `n` in this order.
    pub fn values(&self, n: usize) -> [f64; 4] {
        [&self.slip, &self.particle_slip, &self.solids_fraction_variance, &self.pressure_gradient]
            .map(|signal| signal[n])
    }

    /// The time from which on the statistics are taken \[s\], and what the signals say: of a box that
    /// never became steady the second half.
    pub fn start(&self) -> (f64, Onset) {
        let duration = self.time.last().copied().unwrap_or_default();
        match self.onset() {
            Onset::Steady(time) => (time, Onset::Steady(time)),
            onset @ (Onset::NotSteady | Onset::TooShort) => (0.5 * duration, onset),
        }
    }

    /// When the box became statistically steady: the latest of what its signals say. The slip
    /// seen by the particles falls and the variance of φ rises as clusters form; the mean slip,
    /// heavy-tailed where gas channels open, is not asked.
    pub fn onset(&self) -> Onset {
        steady_start(&self.time, &self.particle_slip)
            .and(steady_start(&self.time, &self.solids_fraction_variance))
    }

    /// Index of the first sample at or after `time`.
    pub fn from(&self, time: f64) -> usize {
        self.time.partition_point(|&t| t < time)
    }
}

/// What simulating a box cost and how it went.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Cost {
    /// Time steps.
    pub steps: u64,
    /// Pressure iterations in all.
    pub pressure_iterations: u64,
    /// Gas sub-steps in all.
    pub gas_steps: u64,
    /// Steps limited by each of [`Limit::ALL`].
    pub limited_by: [u64; Limit::ALL.len()],
    /// Largest volume fraction that a step left unaccounted for in a cell.
    pub volume_residual: f64,
    /// Change of the solids mass over the run, relative.
    pub mass_change: f64,
    /// Change of the mixture's momentum over the run, over ρ_s ⟨φ⟩ u_t.
    pub momentum_change: f64,
    /// Seconds of the wall clock.
    pub seconds: f64,
}

/// How fast a box is simulated, as far as it has come.
#[derive(Clone, Copy, Debug)]
pub struct Pace {
    /// Steps since it was started or gone on with.
    pub steps: u64,
    /// The last of them.
    pub last: Option<StepReport>,
}

/// A box that has been simulated.
#[derive(Clone, Debug)]
pub struct Simulated {
    /// Mean solids fraction.
    pub solids_fraction: f64,
    /// Slip of the uniform state \[m/s\].
    pub uniform_slip: f64,
    /// The signals.
    pub signals: Signals,
    /// Sums of all samples, the start not yet taken off.
    pub sums: Sums,
    /// What it cost.
    pub cost: Cost,
    /// Solids fraction at the end, in the plane of the first and the last axis, first axis fastest.
    pub snapshot: Vec<f64>,
    /// A few small pictures of the way there.
    pub film: Film,
}

/// Why a box could not be simulated.
#[derive(Debug, thiserror::Error)]
pub enum SimulateError {
    /// It was asked to stop.
    #[error("interrupted at t = {time:.4} s")]
    Interrupted {
        /// Simulated time reached \[s\].
        time: f64,
    },
    /// A step failed.
    #[error("the box of mean solids fraction {solids_fraction} failed")]
    Step {
        /// Mean solids fraction of the box.
        solids_fraction: f64,
        /// The step.
        source: Failure,
    },
    /// A box cannot be set up.
    #[error("the box of mean solids fraction {solids_fraction} cannot be simulated")]
    Setup {
        /// Mean solids fraction of the box.
        solids_fraction: f64,
        /// Why.
        source: Failure,
    },
    /// A filter does not fit the box.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The fields could not be recorded.
    #[error("the fields at t = {time:.4} s cannot be kept")]
    Record {
        /// Simulated time \[s\].
        time: f64,
        /// Why.
        source: RecordError,
    },
    /// The fields that were kept are not of this box.
    #[error("what was kept of the box does not fit it")]
    State(#[source] Failure),
    /// The sums that were kept are not of this box.
    #[error("what was kept of the box does not fit it")]
    Sums(#[from] MergeError),
}

/// A box between two steps: all that is needed to go on with it later.
pub struct Underway<'a> {
    /// Simulated time \[s\].
    pub time: f64,
    /// The signals so far; the first sample is the start.
    pub signals: &'a Signals,
    /// What it cost so far; its changes of mass and momentum are known only at the end.
    pub cost: Cost,
    /// Sums of the samples so far.
    pub sums: &'a Sums,
    /// The film so far.
    pub film: &'a Film,
    /// Writes [`Simulation::save_state`].
    pub write_flow: &'a dyn Fn(&mut dyn Write) -> io::Result<()>,
}

/// What was kept of an [`Underway`].
pub struct Kept {
    /// Simulated time \[s\].
    pub time: f64,
    /// Its signals.
    pub signals: Signals,
    /// Its cost.
    pub cost: Cost,
    /// Its sums.
    pub sums: Sums,
    /// Its film.
    pub film: Film,
    /// Reads what [`Underway::write_flow`] wrote.
    pub flow: Box<dyn Read>,
}

/// When a box may be kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// After a step.
    Step,
    /// Asked to stop.
    Stop,
    /// At its end; to go on from here is to simulate it for longer.
    End,
}

/// Samples in a run of the case.
pub fn samples(case: &Case) -> u64 {
    (case.run.duration / case.run.sample_interval).round().max(1.0) as u64
}

/// What `case` asks of the two-fluid model in its box of mean solids fraction `solids_fraction`.
pub fn setup(case: &Case, solids_fraction: f64, parallel: bool) -> Setup {
    let Case { powder, gas, physics, run, .. } = case;
    Setup {
        powder: *powder,
        gas: *gas,
        gravity: physics.gravity,
        drag: physics.drag,
        radial_distribution: physics.radial_distribution,
        friction: physics.friction,
        terms: physics.terms,
        solids_fraction,
        perturbation: run.perturbation,
        seed: run.seed,
        parallel,
    }
}

/// Quantiles of a marker for which a case gives no bins.
const QUANTILES: usize = 5;

/// The bins that a case asks for.
fn bins(filter: &FilterCase, max_packing: f64) -> Bins {
    let axis = |choice: &MarkerChoice| {
        let marker = match choice {
            MarkerChoice::SolidsFraction => Marker::SolidsFraction,
            MarkerChoice::Slip => Marker::Slip,
            MarkerChoice::SlipSpeed => Marker::SlipSpeed,
            MarkerChoice::PressureGradient => Marker::PressureGradient,
            MarkerChoice::ShearRate => Marker::ShearRate,
            MarkerChoice::SolidsFractionGradient => Marker::FractionGradient,
            MarkerChoice::SolidsFractionVariance => Marker::Variance,
        };
        let given = filter.edges.iter().find(|(other, _)| other == choice);
        match (given, choice) {
            (Some((_, EdgesChoice::Given(edges))), _) => Axis::new(marker, edges.clone()),
            (Some((_, EdgesChoice::Quantiles(count))), _) => {
                Axis::in_quantiles(marker, *count, max_packing)
            }
            (None, MarkerChoice::SolidsFraction) => {
                Axis::of_fractions(filter.solids_fraction_bin, max_packing)
            }
            (None, MarkerChoice::Slip) => Axis::of_slips(filter.slip_bin),
            (None, _) => Axis::in_quantiles(marker, QUANTILES, max_packing),
        }
    };
    Bins { axes: filter.markers.iter().map(axis).collect() }
}

/// How `case` asks for its fields to be sampled, in flight.
pub fn sampling<const D: usize>(case: &Case, parallel: bool) -> Sampling<D> {
    let Case { powder, gas, filter, run, .. } = case;
    Sampling {
        scales: case.scales(),
        gas_density: gas.density,
        bins: bins(filter, powder.max_packing),
        kernel: match filter.kernel {
            KernelChoice::Box => Kernel::Box,
            KernelChoice::Gaussian => Kernel::Gaussian,
            KernelChoice::Diffusion => Kernel::Diffusion,
            KernelChoice::Sharp => Kernel::Sharp,
        },
        widths: filter.widths.clone(),
        block_duration: SAMPLES_PER_BLOCK * run.sample_interval,
        space: [1; D],
        periodic: [true; D],
        closest: CLOSEST,
        parallel,
    }
}

/// How `case` asks for fields on disk to be sampled: as in flight.
pub fn stored_sampling(case: &Case, parallel: bool) -> StoredSampling {
    let Sampling { scales, gas_density, bins, kernel, widths, block_duration, closest, .. } =
        sampling::<2>(case, parallel);
    StoredSampling {
        scales,
        gas_density,
        bins,
        kernel,
        widths,
        block_duration,
        space: 1,
        closest,
        parallel,
    }
}

/// The two-fluid model that `case` asks for, in its box of mean solids fraction `solids_fraction`; `parallel`
/// lets a step use the threads of the current pool.
///
/// # Panics
/// When the case's dimension is not `D`.
pub fn two_fluid<R: Real, const D: usize>(
    case: &Case,
    solids_fraction: f64,
    parallel: bool,
) -> TwoFluid<R, D> {
    let flow = TwoFluid::<R, D>::new(grid(case), setup(case, solids_fraction, parallel));
    let flow = match case.physics.drive {
        Drive::GasFlux(gas_flux) => flow.with_gas_flux(gas_flux),
        Drive::PressureGradient => flow,
    };
    if case.run.time_order == 2 { flow.with_second_order() } else { flow }
}

/// The particles in gas that `case` asks for, likewise.
///
/// # Errors
/// They cannot be placed or simulated.
///
/// # Panics
/// When the case has no `particles`, or is not of three dimensions.
pub fn cfd_dem(case: &Case, solids_fraction: f64, parallel: bool) -> Result<CfdDem, SimulateError> {
    let particles = case.particles.as_ref().expect("a case that follows particles");
    let setup = cfd_dem::Setup {
        powder: case.powder,
        gas: case.gas,
        gravity: case.physics.gravity,
        drag: case.physics.drag,
        mixture: particles.mixture,
        gas_inertia: case.physics.terms.gas_inertia,
        gas_stress: case.physics.terms.gas_stress,
        drive: case.physics.drive,
        solids_fraction,
        contact: particles.contact,
        steps_per_contact: particles.steps_per_contact,
        mapping: particles.mapping,
        smoothing: particles.smoothing,
        rhythm: case.run.sample_interval,
        seed: case.run.seed,
        parallel,
    };
    let refuse = |source| SimulateError::Setup { solids_fraction, source };
    let grid = grid(case);
    let spheres = match &particles.start.places {
        Places::File(path) => {
            let expected = Expected { size: grid.size(), powder: case.powder, solids_fraction };
            start::read(path, &expected).map_err(|source| refuse(source.into()))?
        }
        _ => spheres(&grid, &setup, &particles.start).map_err(|source| refuse(source.into()))?,
    };
    let flow =
        CfdDem::with_spheres(grid, setup, &spheres).map_err(|source| refuse(source.into()))?;
    if let Places::File(path) = &particles.start.places {
        let overlap = flow.particles().deepest_overlap();
        start::check_overlap(path, overlap).map_err(|source| refuse(source.into()))?;
    }
    Ok(flow)
}

/// The grid of a case's boxes.
fn grid<const D: usize>(case: &Case) -> Grid<D> {
    assert_eq!(case.domain.size.len(), D, "a case of another dimension");
    Grid::new(
        std::array::from_fn(|axis| case.domain.size[axis]),
        std::array::from_fn(|axis| case.domain.cells[axis]),
    )
}

/// Simulates a box of `case`, filtering as it goes: `flow`, whose mean solids fraction is
/// `solids_fraction`. `watch` is called after each sample with the signals so far and the number of
/// steps that this call has done.
///
/// # Errors
/// `stop` said so, a step failed, or a filter does not fit.
pub fn simulate<const D: usize>(
    flow: impl Simulation<D>,
    case: &Case,
    solids_fraction: f64,
    parallel: bool,
    stop: &dyn Fn() -> bool,
    watch: impl FnMut(&Signals, Pace),
) -> Result<Simulated, SimulateError> {
    let record = |_: u64, _: &FineFields<D>, _: &Signals, _: &Particles<'_>| Ok(());
    simulate_from(flow, case, solids_fraction, parallel, stop, watch, None, |_, _| {}, record)
}

/// Why fields could not be recorded.
pub type RecordError = Box<dyn std::error::Error + Send + Sync>;

/// Gives the particles of a simulation, if it follows them one by one.
pub type Particles<'a> = dyn Fn() -> Option<Vec<Sphere>> + 'a;

/// [`simulate`] from what was `kept` of the same case and box, which may have been asked for
/// another duration, no shorter than what was simulated: to the same bits as without a break.
/// `keep` is called whenever the box may be kept, and `record` with the number of each sample, from
/// 1, the fields that are sampled, the signals up to then, and what gives the particles.
///
/// # Errors
/// As [`simulate`], or what was kept is of another box, or `record` says so.
#[allow(clippy::too_many_arguments)]
pub fn simulate_from<const D: usize>(
    mut flow: impl Simulation<D>,
    case: &Case,
    solids_fraction: f64,
    parallel: bool,
    stop: &dyn Fn() -> bool,
    mut watch: impl FnMut(&Signals, Pace),
    kept: Option<Kept>,
    mut keep: impl FnMut(Moment, &Underway),
    mut record: impl FnMut(u64, &FineFields<D>, &Signals, &Particles<'_>) -> Result<(), RecordError>,
) -> Result<Simulated, SimulateError> {
    let begin = std::time::Instant::now();
    let Case { powder, gas, physics, run, .. } = case;
    let grid = grid::<D>(case);
    let scales = Scales::new(powder, gas, physics.gravity);
    let law = physics.drag.law(gas, powder);
    let sampling = sampling(case, parallel);
    let mut sampler = Sampler::new(grid, law, sampling)?;

    let mut fine = FineFields::zeros(grid);
    let start = flow.means();
    let (mut signals, mut cost) = (Signals::default(), Cost::default());
    // The filter in the middle: narrow ones change little, and of wide ones there are few.
    let seen = case.filter.widths.len().saturating_sub(1) / 2;
    let mut film = Film::new(&grid, case.filter.widths[seen]);
    signals.push(0.0, &start);
    if let Some(mut kept) = kept {
        flow.restore_state(&mut kept.flow).map_err(SimulateError::State)?;
        sampler.resume(kept.sums)?;
        (signals, cost, film) = (kept.signals, kept.cost, kept.film);
        // For the picture of a box that is at its end already; else the next sample overwrites it.
        flow.fields(&mut fine);
    }
    let before = cost;
    let seconds = || before.seconds + begin.elapsed().as_secs_f64();
    let mut keep = |moment, flow: &dyn Simulation<D>, signals: &_, cost, sums: &_, film: &_| {
        let cost = Cost { seconds: seconds(), ..cost };
        let write_flow = &|to: &mut dyn Write| flow.save_state(to);
        keep(moment, &Underway { time: flow.time(), signals, cost, sums, film, write_flow });
    };
    let mut last = None;
    for sample in signals.time.len() as u64..=samples(case) {
        let until = sample as f64 * run.sample_interval;
        while flow.time() < until {
            if stop() {
                keep(Moment::Stop, &flow, &signals, cost, sampler.sums(), &film);
                return Err(SimulateError::Interrupted { time: flow.time() });
            }
            let step = flow
                .step(until)
                .map_err(|source| SimulateError::Step { solids_fraction, source })?;
            last = Some(step);
            cost.steps += 1;
            cost.pressure_iterations += step.iterations as u64;
            cost.gas_steps += step.gas_steps as u64;
            cost.limited_by[step.limit as usize] += 1;
            cost.volume_residual = cost.volume_residual.max(step.volume_residual);
            keep(Moment::Step, &flow, &signals, cost, sampler.sums(), &film);
        }
        signals.push(until, &flow.means());
        flow.fields(&mut fine);
        sampler.sample(&fine);
        if film.is_due(sample) {
            let filtered = |place| sampler.filtered_fraction(seen, place);
            film.take(sample, until, &grid, &fine.solids_fraction, filtered);
        }
        record(sample, &fine, &signals, &|| flow.particles())
            .map_err(|source| SimulateError::Record { time: until, source })?;
        watch(&signals, Pace { steps: cost.steps - before.steps, last });
    }
    keep(Moment::End, &flow, &signals, cost, sampler.sums(), &film);
    let end = flow.means();
    let scale = powder.density * solids_fraction * scales.terminal_velocity;
    cost.mass_change = end.solids_fraction / start.solids_fraction - 1.0;
    cost.momentum_change = (0..D)
        .map(|axis| (end.momentum[axis] - start.momentum[axis]).abs() / scale)
        .fold(0.0, f64::max);
    cost.seconds = seconds();
    Ok(Simulated {
        solids_fraction,
        uniform_slip: flow.uniform_slip(),
        signals,
        sums: sampler.into_sums(),
        cost,
        snapshot: middle_plane(&grid, &fine.solids_fraction),
        film,
    })
}

/// The plane of the first and the last axis, in the middle of the others.
fn middle_plane<const D: usize>(grid: &Grid<D>, field: &[f64]) -> Vec<f64> {
    let width = grid.cells[0];
    let layer: usize = grid.cells[..D - 1].iter().product();
    let offset = layer / width / 2 * width;
    (0..grid.cells[D - 1])
        .flat_map(|k| &field[k * layer + offset..k * layer + offset + width])
        .copied()
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn middle_plane_holds_the_first_and_the_last_axis() {
        let grid = Grid::new([1.0; 3], [2, 4, 3]);
        let field: Vec<f64> = (0..24).map(f64::from).collect();
        assert_eq!(middle_plane(&grid, &field), [4.0, 5.0, 12.0, 13.0, 20.0, 21.0]);
        let grid = Grid::new([1.0; 2], [2, 3]);
        assert_eq!(middle_plane(&grid, &field[..6]), field[..6]);
    }
}
