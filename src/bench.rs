//! [`measure`]: what a step costs on this machine. [`error`]: what an error costs.

pub mod error;

use crate::case::{Case, CaseError, DEFAULT, Precision};
use crate::filter::FilterError;
use crate::filtered::{QUANTITIES, Quantity};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::real::Real;
use crate::rows::{Simd, on_threads, simd_level};
use crate::simulate::{SimulateError, sampling, setup};
use crate::statistics::{MergeError, Sampler};
use crate::two_fluid::{STAGES, StepError, StepReport, TwoFluid};
use cpu_time::ProcessTime;
use std::fmt;
use std::time::Instant;

/// Mean solids fraction of the boxes.
const SOLIDS_FRACTION: f64 = 0.15;

/// What one step costs.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Measurement {
    /// Precision of the simulator.
    pub precision: Precision,
    /// Cells along each axis.
    pub cells: Vec<usize>,
    /// Threads.
    pub threads: usize,
    /// Whether filtering and statistics are included.
    pub statistics: bool,
    /// Time steps timed.
    pub steps: u64,
    /// Core time per cell and step, median of the rounds \[µs\]: time in which the machine does
    /// something else does not count.
    pub per_cell_step: f64,
    /// The fastest and the slowest round \[µs\].
    pub range: [f64; 2],
    /// Time per cell and step on the wall clock, median of the rounds \[µs\].
    pub wall: f64,
    /// Mean length of a step \[s\].
    pub step: f64,
    /// Core seconds per simulated second: the median round's.
    pub per_simulated_second: f64,
    /// Pressure iterations and gas sub-steps per step.
    pub per_step: [f64; 2],
    /// Core time per cell and step of each of [`STAGES`] \[µs\], by their shares of the clock.
    pub stages: [f64; STAGES.len()],
    /// Variance of the solids fraction, mean over the rounds' ends: how clustered it is.
    pub solids_fraction_variance: f64,
    /// Slip seen by the particles, mean over the rounds' ends \[u_t\].
    pub particle_slip: f64,
}

/// Measurements of the default case's box.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Report {
    /// Instruction set of the kernels.
    pub simd: &'static str,
    /// Names of the stages.
    pub stages: [&'static str; STAGES.len()],
    /// The measurements.
    pub measurements: Vec<Measurement>,
    /// What filtering costs.
    pub filtering: Vec<Filtering>,
    /// Memory of the simulator.
    pub memory: Vec<Memory>,
}

/// What filtering costs: all quantities at eight widths, one thread.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Filtering {
    /// Cells along each axis.
    pub cells: Vec<usize>,
    /// Filter widths \[cells\].
    pub widths: Vec<usize>,
    /// Quantities.
    pub quantities: usize,
    /// Core time of a sample, from the simulator's fields to the sums, median \[ms\].
    pub sample: f64,
    /// Of it to bring the simulator's fields to the cells' centres \[ms\].
    pub fields: f64,
    /// Cells x quantities x widths per second of filtering \[million/s\].
    pub throughput: f64,
    /// Core time of samples at the default interval over that of the steps (f64) between them.
    pub share: f64,
}

/// Filter widths of [`Filtering`] \[cells\].
const WIDTHS: [usize; 8] = [2, 4, 6, 8, 12, 16, 24, 32];

/// Memory that a simulator adds to the process.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Memory {
    /// Precision of the simulator.
    pub precision: Precision,
    /// Cells along each axis.
    pub cells: Vec<usize>,
    /// Bytes per cell; none where the system does not tell.
    pub bytes_per_cell: Option<f64>,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grid = |cells: &[usize]| {
            let cells: Vec<String> = cells.iter().map(ToString::to_string).collect();
            cells.join("x")
        };
        writeln!(f, "{}, default case, clustered state", self.simd)?;
        writeln!(
            f,
            "                             core µs per cell and step   wall     core s per   \
             iterations of pressure,"
        )?;
        write!(
            f,
            "precision cells      threads median (range)              µs       simulated s  \
             sub-steps of gas"
        )?;
        for m in &self.measurements {
            write!(
                f,
                "\n{:<9} {:<11} {:>5} {:.4} ({:.4} to {:.4})   {:>8.4} {:>10.2} {:>10.1} {:>6.1}{}",
                name(m.precision),
                grid(&m.cells),
                m.threads,
                m.per_cell_step,
                m.range[0],
                m.range[1],
                m.wall,
                m.per_simulated_second,
                m.per_step[0],
                m.per_step[1],
                if m.statistics { "  with statistics" } else { "" },
            )?;
        }
        write!(f, "\n\ncore ns per cell and step of each stage:\nprecision cells      threads")?;
        for stage in self.stages {
            write!(f, " {stage:>10}")?;
        }
        for m in self.measurements.iter().filter(|m| !m.statistics) {
            write!(f, "\n{:<9} {:<11} {:>5}", name(m.precision), grid(&m.cells), m.threads)?;
            for stage in m.stages {
                write!(f, " {:>10.2}", 1e3 * stage)?;
            }
        }
        let quantities = self.filtering.first().map_or(0, |filtering| filtering.quantities);
        write!(
            f,
            "\n\nfiltering {quantities} quantities, widths of {WIDTHS:?} cells, one thread:\n\
             cells       ms per sample (fields)  million cells x quantities x widths per s  \
             share of a run's steps"
        )?;
        for m in &self.filtering {
            write!(
                f,
                "\n{:<11} {:>13.2} {:>8} {:>43.0} {:>22.1} %",
                grid(&m.cells),
                m.sample,
                format!("({:.2})", m.fields),
                m.throughput,
                100.0 * m.share,
            )?;
        }
        writeln!(f, "\n\nmemory:")?;
        for (n, memory) in self.memory.iter().enumerate() {
            let bytes = memory.bytes_per_cell.map_or("?".into(), |bytes| format!("{bytes:.0}"));
            let comma = if n > 0 { ", " } else { "" };
            let cells = grid(&memory.cells);
            write!(f, "{comma}{} {cells}: {bytes} bytes per cell", name(memory.precision))?;
        }
        Ok(())
    }
}

/// A precision as a case file has it.
fn name(precision: Precision) -> &'static str {
    match precision {
        Precision::Single => "f32",
        Precision::Double => "f64",
    }
}

/// Why nothing could be measured.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The embedded case is broken.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// A filter does not fit.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// A step failed.
    #[error(transparent)]
    Step(#[from] StepError),
    /// A simulation failed.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// Runs cannot be pooled.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// No threads.
    #[error("cannot start {threads} threads")]
    Threads {
        /// Threads wanted.
        threads: usize,
        /// Why not.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// How long a measurement takes.
#[derive(Clone, Copy)]
struct Effort {
    /// Development of the clustered state \[u_t/g\]: in two and in three dimensions.
    warm: [f64; 2],
    /// Rounds.
    rounds: usize,
    /// A round \[seconds, about\].
    round: f64,
}

/// Times the default case's box at mean fraction 0.15, clustered: 128 x 128 cells in f64 and f32,
/// with and without statistics, and unless `quick` larger boxes, 3-D and two threads.
///
/// A larger box is filled with copies of a developed one.
///
/// # Errors
/// A simulation fails, or there are no threads.
pub fn measure(quick: bool) -> Result<Report, BenchError> {
    let case = Case::parse(DEFAULT, "bench")?;
    let effort = match quick {
        true => Effort { warm: [60.0, 0.0], rounds: 5, round: 0.3 },
        false => Effort { warm: [80.0, 25.0], rounds: 9, round: 1.0 },
    };
    let time = case.scales().time();
    let memory = if quick { memory::<2>(&case, 128)? } else { memory::<3>(&case, 64)? };
    let flat = developed::<2>(&case, 1.0, effort.warm[0] * time)?;
    let mut measurements = Vec::new();
    for statistics in [false, true] {
        measurements.push(one::<f64, 2>(&case, &flat, [1; 2], 1, statistics, effort)?);
        measurements.push(one::<f32, 2>(&case, &flat, [1; 2], 1, statistics, effort)?);
    }
    let mut found = vec![filtering(&case, &flat, [1; 2], &measurements[0], effort)?];
    if !quick {
        for threads in [1, 2] {
            measurements.push(one::<f64, 2>(&case, &flat, [4; 2], threads, false, effort)?);
            measurements.push(one::<f32, 2>(&case, &flat, [4; 2], threads, false, effort)?);
        }
        drop(flat);
        let solid = developed::<3>(&case, 0.25, effort.warm[1] * time)?;
        for threads in [1, 2] {
            measurements.push(one::<f64, 3>(&case, &solid, [2; 3], threads, false, effort)?);
            measurements.push(one::<f32, 3>(&case, &solid, [2; 3], threads, false, effort)?);
        }
        let steps = measurements.iter().find(|m| m.cells.len() == 3);
        let steps = steps.unwrap_or(&measurements[0]);
        found.push(filtering(&case, &solid, [2; 3], steps, effort)?);
    }
    let simd = match simd_level() {
        Simd::Baseline => "baseline SIMD",
        Simd::Avx2 => "AVX2",
        Simd::Avx512 => "AVX-512",
    };
    Ok(Report { simd, stages: STAGES, measurements, filtering: found, memory })
}

/// Memory in use of a box of `edge` cells along each axis, in either precision.
fn memory<const D: usize>(case: &Case, edge: usize) -> Result<Vec<Memory>, BenchError> {
    // Both are held until both are measured: memory that is used anew would not be seen.
    let (before, cells) = (resident(), vec![edge; D]);
    let double = stepped::<f64, D>(case, edge)?;
    let between = resident();
    let single = stepped::<f32, D>(case, edge)?;
    let after = resident();
    let bytes = |before: Option<usize>, after: Option<usize>| {
        let bytes = after?.checked_sub(before?)?;
        Some(bytes as f64 / double.grid().len() as f64)
    };
    let found = vec![
        Memory {
            precision: Precision::Double,
            cells: cells.clone(),
            bytes_per_cell: bytes(before, between),
        },
        Memory { precision: Precision::Single, cells, bytes_per_cell: bytes(between, after) },
    ];
    drop(single);
    Ok(found)
}

/// A box that has used all its memory.
fn stepped<R: Real, const D: usize>(
    case: &Case,
    edge: usize,
) -> Result<TwoFluid<R, D>, BenchError> {
    let cell = case.domain.size[0] / case.domain.cells[0] as f64;
    let grid = Grid::new([cell * edge as f64; D], [edge; D]);
    let mut flow = TwoFluid::new(grid, setup(case, SOLIDS_FRACTION, false));
    for _ in 0..2 {
        flow.step(f64::INFINITY)?;
    }
    Ok(flow)
}

/// The case's box after `time` \[s\], or `share` of its edges in each of `D` dimensions.
fn developed<const D: usize>(
    case: &Case,
    share: f64,
    time: f64,
) -> Result<TwoFluid<f64, D>, BenchError> {
    let edge = case.domain.size[0] * share;
    let cells = (case.domain.cells[0] as f64 * share).round() as usize;
    let mut setup = setup(case, SOLIDS_FRACTION, false);
    // What comes of it does not depend on how it began, but comes sooner.
    setup.perturbation = 0.5;
    let mut flow = TwoFluid::new(Grid::new([edge; D], [cells; D]), setup);
    while flow.time() < time {
        flow.step(f64::INFINITY)?;
    }
    Ok(flow)
}

/// Measures the box that copies of `from` fill, `times` along each axis.
fn one<R: Real, const D: usize>(
    case: &Case,
    from: &TwoFluid<f64, D>,
    times: [usize; D],
    threads: usize,
    statistics: bool,
    effort: Effort,
) -> Result<Measurement, BenchError> {
    let work = || rounds::<R, D>(case, from, times, threads, statistics, effort);
    on_threads(threads, work)
        .map_err(|source| BenchError::Threads { threads, source: Box::new(source) })?
}

fn rounds<R: Real, const D: usize>(
    case: &Case,
    from: &TwoFluid<f64, D>,
    times: [usize; D],
    threads: usize,
    statistics: bool,
    effort: Effort,
) -> Result<Measurement, BenchError> {
    let mut flow = from.tiled::<R>(times, threads > 1).with_clock();
    let grid = flow.grid();
    // The first steps fill caches and say how many make a round.
    let begin = ProcessTime::now();
    for _ in 0..5 {
        flow.step(f64::INFINITY)?;
    }
    let per_step = begin.elapsed().as_secs_f64() / (5 * threads) as f64;
    let steps = (effort.round / per_step).ceil().max(5.0) as u64;

    let law = case.physics.drag.law(&case.gas, &case.powder);
    let mut watch = match statistics {
        true => Some(Watch::new(case, grid, law, flow.time())?),
        false => None,
    };
    let (mut times, mut walls) = (Vec::new(), Vec::new());
    let (mut iterations, mut gas_steps) = (0, 0);
    let (mut variance, mut particle_slip) = (0.0, 0.0);
    let (stages, started) = (flow.stage_seconds().unwrap_or_default(), flow.time());
    for _ in 0..effort.rounds {
        let (begin, core) = (Instant::now(), ProcessTime::now());
        for _ in 0..steps {
            let report = match &mut watch {
                Some(watch) => watch.step(&mut flow)?,
                None => flow.step(f64::INFINITY)?,
            };
            iterations += report.iterations;
            gas_steps += report.gas_steps;
        }
        times.push(core.elapsed().as_secs_f64() / steps as f64);
        walls.push(begin.elapsed().as_secs_f64() / steps as f64);
        let means = flow.means();
        variance += means.solids_fraction_variance;
        particle_slip += means.particle_slip;
    }
    // The clock sees what else the machine does; the cores' time does not.
    let share = times.iter().sum::<f64>() / walls.iter().sum::<f64>();
    times.sort_by(f64::total_cmp);
    walls.sort_by(f64::total_cmp);
    let all = steps as f64 * effort.rounds as f64;
    let per_cell = |seconds: f64| 1e6 * seconds / grid.len() as f64;
    let step = (flow.time() - started) / all;
    let median = times[times.len() / 2];
    let after = flow.stage_seconds().unwrap_or_default();
    Ok(Measurement {
        precision: if size_of::<R>() == 4 { Precision::Single } else { Precision::Double },
        cells: grid.cells.to_vec(),
        threads,
        statistics,
        steps: steps * effort.rounds as u64,
        per_cell_step: per_cell(median),
        range: [per_cell(times[0]), per_cell(times[times.len() - 1])],
        wall: per_cell(walls[walls.len() / 2]),
        step,
        per_simulated_second: median / step,
        per_step: [iterations as f64 / all, gas_steps as f64 / all],
        stages: std::array::from_fn(|n| per_cell(share * (after[n] - stages[n]) / all)),
        solids_fraction_variance: variance / effort.rounds as f64,
        particle_slip: particle_slip / effort.rounds as f64 / case.scales().terminal_velocity,
    })
}

/// Filtering and statistics at the case's interval, as a run has them.
struct Watch<const D: usize> {
    sampler: Sampler<D, Box<dyn DragLaw<f64>>>,
    fine: FineFields<D>,
    interval: f64,
    next: f64,
}

impl<const D: usize> Watch<D> {
    fn new(
        case: &Case,
        grid: Grid<D>,
        law: Box<dyn DragLaw<f64>>,
        now: f64,
    ) -> Result<Self, FilterError> {
        let interval = case.run.sample_interval;
        let sampler = Sampler::new(grid, law, sampling(case, false))?;
        Ok(Self { sampler, fine: FineFields::zeros(grid), interval, next: now + interval })
    }

    fn step<R: Real>(&mut self, flow: &mut TwoFluid<R, D>) -> Result<StepReport, StepError> {
        let report = flow.step(self.next)?;
        if flow.time() >= self.next {
            flow.fields(&mut self.fine);
            self.sampler.sample(&self.fine);
            self.next += self.interval;
        }
        Ok(report)
    }
}

/// Times samples of the box that copies of `from` fill; `steps` says what its steps cost.
fn filtering<const D: usize>(
    case: &Case,
    from: &TwoFluid<f64, D>,
    times: [usize; D],
    steps: &Measurement,
    effort: Effort,
) -> Result<Filtering, BenchError> {
    let mut flow = from.tiled::<f64>(times, false);
    let grid = flow.grid();
    let mut sampling = sampling(case, false);
    sampling.widths = WIDTHS.iter().map(|&width| width as f64 * grid.spacing[0]).collect();
    let law = case.physics.drag.law(&case.gas, &case.powder);
    let mut sampler = Sampler::new(grid, law, sampling)?;
    let mut fine = FineFields::zeros(grid);
    let (mut fields, mut samples) = (Vec::new(), Vec::new());
    // The first fills caches and makes the sums' room.
    let begin = Instant::now();
    while samples.len() <= effort.rounds || begin.elapsed().as_secs_f64() < effort.round {
        flow.step(f64::INFINITY)?;
        let core = ProcessTime::now();
        flow.fields(&mut fine);
        fields.push(core.elapsed().as_secs_f64());
        sampler.sample(&fine);
        samples.push(core.elapsed().as_secs_f64());
    }
    let median = |values: &mut Vec<f64>| {
        values.remove(0);
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let (fields, sample) = (median(&mut fields), median(&mut samples));
    let reported = |quantity: &&Quantity| D == 3 || !quantity.only_3d;
    let quantities = QUANTITIES.iter().filter(reported).count();
    let numbers = grid.len() * quantities * WIDTHS.len();
    let between = steps.per_simulated_second * case.run.sample_interval;
    Ok(Filtering {
        cells: grid.cells.to_vec(),
        widths: WIDTHS.to_vec(),
        quantities,
        sample: 1e3 * sample,
        fields: 1e3 * fields,
        throughput: 1e-6 * numbers as f64 / (sample - fields),
        share: sample / between,
    })
}

/// Memory of this process that is in use \[bytes\], where the system tells.
fn resident() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: usize = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    Some(1024 * kilobytes)
}
