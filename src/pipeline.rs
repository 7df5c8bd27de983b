//! [`run`]: from a case to the files of a run, stage by stage; [`stability()`] likewise, and
//! [`fields::filter`] from fields on disk.

pub mod fields;
pub mod models;
mod report;

pub use report::{figures, report};

use crate::bench;
use crate::case::{Case, CaseError, Precision};
use crate::checkpoint::{CheckpointError, Checkpoints};
use crate::closure::ClosureFile;
use crate::figure::{self, FigureError};
use crate::fine::FineFields;
use crate::forms::SaturatingDrag;
use crate::laws::scales::Scales;
use crate::model::{Definitions, Model, System, binned_closure_rows, closure_rows};
use crate::output::{Output, OutputError, RUN_FILE};
use crate::pool::{Pool, PoolSummary};
use crate::progress::Progress;
use crate::refit::{Bins, Candidate, RefitError, Shape, preferred, refit};
use crate::report::{Folder, REPORT_FILE, ReportError, page};
use crate::resolved::ResolvedError;
use crate::resolved::series::SeriesError;
use crate::resolved::write::{RecordError, Recorder};
use crate::simulate::{
    Particles, Signals, SimulateError, Simulated, Underway, cfd_dem, simulate_from, two_fluid,
};
use crate::stability::{self, Stability, StabilityError};
use crate::statistics::{MergeError, Sums, bin_table};
use crate::stored::StoredError;
use crate::summary::{BoxSummary, Machine, SHOWN_FRAMES, Summary};
use crate::sums::{RunSums, SUMS_FILE, SumsFile, SumsSystem};
use crate::table::{BinRow, write_rows};
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// How to run, as opposed to what.
#[derive(Clone, Copy, Debug)]
pub struct RunOptions {
    /// Threads to use; 0 for one per core.
    pub threads: usize,
    /// Whether to be silent about progress.
    pub quiet: bool,
}

/// Why a run did not end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It was asked to stop.
    #[error("interrupted after {done:.4} s of {of:.4} s simulated: no tables were written")]
    Interrupted {
        /// Simulated time of all boxes until then \[s\].
        done: f64,
        /// Simulated time asked for, of all boxes \[s\].
        of: f64,
        /// Why it could not be kept, if a box could not.
        #[source]
        lost: Option<CheckpointError>,
    },
    /// A box could not be simulated.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    /// What was kept of a box cannot be read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The boxes' sums do not fit together.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// The threads could not be started.
    #[error("cannot start {threads} threads")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// Why.
        source: rayon::ThreadPoolBuildError,
    },
    /// A figure cannot be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// There is no linear theory of the case.
    #[error(transparent)]
    Stability(#[from] StabilityError),
    /// Fields on disk, or the case they are of, are not acceptable.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// Fields on disk are not acceptable.
    #[error(transparent)]
    Resolved(#[from] ResolvedError),
    /// Fields on disk cannot be sampled.
    #[error("{path}", path = path.display())]
    Stored {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: StoredError,
    },
    /// There was nothing to filter.
    #[error("there are no fields in what was given")]
    NoFields,
    /// Nothing is left after the start.
    #[error("no whole block of time begins between {start} s and the last instant at {last} s")]
    NothingFrom {
        /// Where the statistics were to begin \[s\].
        start: f64,
        /// The last instant \[s\].
        last: f64,
    },
    /// It was asked to stop while it read fields.
    #[error("interrupted: no tables were written")]
    Stopped,
    /// Fields could not be kept.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// Nothing could be measured.
    #[error(transparent)]
    Bench(#[from] bench::BenchError),
    /// What is to be reported cannot be read.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The case of an interrupted run is not acceptable.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// Its files cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// Runs `case` and fills `output`, which the caller commits. Ends early once `stop` is set. Goes on
/// with what was kept in `checkpoints`, and keeps the boxes there, until the caller removes them.
///
/// A bin table without a closure is a result too: when no closure can be fitted, the summary says
/// why.
///
/// # Errors
/// `stop` was set, a box failed, or a file cannot be written.
pub fn run(
    case: &Case,
    output: &mut Output,
    checkpoints: &Checkpoints,
    options: &RunOptions,
    stop: &AtomicBool,
) -> Result<Summary, RunError> {
    let threads = match options.threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads,
    };
    let scales = Scales::new(&case.powder, &case.gas, case.physics.gravity);

    let boxes = simulate_boxes(case, &scales, checkpoints, threads, options.quiet, stop)?;
    let (sums, boxes): (Vec<Sums>, Vec<(Simulated, BoxSummary)>) = boxes
        .into_iter()
        .map(|simulated| {
            let (sums, summary) = steady_part(&simulated, &scales);
            (sums, (simulated, summary))
        })
        .unzip();
    let bins = bin_table(&sums, &scales)?;
    let sums = sums_file(case, sums);
    let candidates = fit_drag_correction(&sums.runs, &scales, case.powder.max_packing);
    let system = System::new(&case.powder, &case.gas, &scales);
    let model = candidates
        .as_ref()
        .map(|found| preferred(found, DRAG).map(|taken| Model::new(taken.clone(), system)));
    let model = match model {
        Ok(model) => model.ok_or_else(String::new),
        Err(why) => Err(why.to_string()),
    };
    let summary = Summary::new(
        case,
        &scales,
        boxes.iter().map(|(_, summary)| summary.clone()).collect(),
        &bins,
        candidates.map_err(|why| why.to_string()),
        Machine { threads, seconds: checkpoints.seconds(), ..Machine::here() },
    );
    export(case, output, &boxes, &bins, model.as_ref().ok(), &summary)?;
    fields::take_fields(case, checkpoints, output)?;
    output.write(SUMS_FILE, |file| sums.write(file))?;
    // From the files, as `favre report` makes it.
    let command = format!("favre report {}", output.dir().display());
    let mut found = Folder::read(output.partial())?;
    found.path = output.dir().into();
    let page = page(&[found], &command);
    output.write(REPORT_FILE, |file| file.write_all(page.as_bytes()))?;
    Ok(summary)
}

/// The linear theory of `case` in `output`, which the caller commits: stability.csv, stability.svg
/// and run.json.
///
/// # Errors
/// There is no linear theory of the case, or a file cannot be written.
pub fn stability(case: &Case, output: &Output) -> Result<Stability, RunError> {
    let found = stability::stability(case)?;
    let cell = case.domain.spacing().into_iter().fold(0.0, f64::max);
    output.write("stability.csv", |file| found.write_csv(file).map_err(io::Error::other))?;
    let drawing = figure::stability_figure(&found, cell);
    output.write("stability.svg", |file| file.write_all(drawing.svg().as_bytes()))?;
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, &found)?))?;
    Ok(found)
}

/// Runs put together in `output`, which the caller commits: bins.csv, the pooled sums, where boxes of
/// different mean solids fraction disagree, and run.json.
///
/// # Errors
/// A file cannot be written.
pub fn pooled(pool: &Pool, output: &Output) -> Result<PoolSummary, RunError> {
    output.write("bins.csv", |file| write_rows(&pool.bins, file).map_err(io::Error::other))?;
    output.write(SUMS_FILE, |file| pool.file.write(file))?;
    output.write("disagreements.csv", |file| {
        pool.write_disagreements(file).map_err(io::Error::other)
    })?;
    let summary = pool.summary();
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, &summary)?))?;
    Ok(summary)
}

/// Fits in `output`, which the caller commits: the preferred shape of the first quantity in model.toml,
/// of others in model_QUANTITY.toml, and run.json.
///
/// # Errors
/// A file cannot be written.
pub fn fitted(
    name: &str,
    system: Option<&SumsSystem>,
    found: &[Candidate],
    output: &Output,
) -> Result<(), RunError> {
    let drag = system.map_or("not stated by the bin tables", |system| &system.drag);
    let system = system.map(|system| System::new(&system.powder, &system.gas, &system.scales()));
    let mut quantities: Vec<&str> = found.iter().map(|candidate| candidate.quantity).collect();
    quantities.dedup();
    let preferred = quantities.iter().filter_map(|quantity| preferred(found, quantity));
    for (i, taken) in preferred.enumerate() {
        let definitions = Definitions::favre(drag);
        let closure = ClosureFile::fitted(name, taken, None, system, definitions);
        // Forms have symbols of their own, so a file holds one.
        let file = match i {
            0 => "model.toml".to_owned(),
            _ => format!("model_{}.toml", taken.quantity),
        };
        output.write(&file, |to| {
            to.write_all(closure.to_toml().map_err(io::Error::other)?.as_bytes())
        })?;
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, found)?))?;
    Ok(())
}

/// Speed against error in `output`, which the caller commits: error.csv, a figure per quantity and
/// run.json. `watch` is given each point as it is found.
///
/// # Errors
/// A simulation fails, or a file cannot be written.
pub fn bench_error(
    quick: bool,
    output: &Output,
    watch: impl FnMut(&bench::error::Point),
) -> Result<bench::error::Report, RunError> {
    let found = bench::error::measure(quick, watch)?;
    output.write("error.csv", |file| found.write_csv(file).map_err(io::Error::other))?;
    for (place, file) in [(0, "slip"), (1, "variance"), (3, "drag_correction")] {
        let drawing = figure::error_figure(&found, place);
        let name = format!("error_{file}.svg");
        output.write(&name, |file| file.write_all(drawing.svg().as_bytes()))?;
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, &found)?))?;
    Ok(found)
}

/// Simulates every box of the case: as many at a time as there are threads, or, when the boxes are
/// fewer, one after the other on all of them. The results do not depend on which.
fn simulate_boxes(
    case: &Case,
    scales: &Scales,
    checkpoints: &Checkpoints,
    threads: usize,
    quiet: bool,
    stop: &AtomicBool,
) -> Result<Vec<Simulated>, RunError> {
    let fractions = &case.domain.solids_fractions;
    let progress = Progress::new(quiet, scales.terminal_velocity);
    let (next, failed) = (AtomicUsize::new(0), AtomicBool::new(false));
    let lost = Mutex::new(None);
    let results: Mutex<Vec<Option<Result<Simulated, RunError>>>> =
        Mutex::new(fractions.iter().map(|_| None).collect());
    let one_each = fractions.len() >= threads;
    let work = || {
        loop {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(&fraction) = fractions.get(place) else { return };
            let halt = || stop.load(Ordering::Relaxed) || failed.load(Ordering::Relaxed);
            let result =
                simulate_box(case, fraction, checkpoints, !one_each, &halt, &progress, &lost);
            failed.fetch_or(result.is_err(), Ordering::Relaxed);
            // A panic elsewhere poisons the lock, and ends the run anyway.
            if let Ok(mut results) = results.lock() {
                results[place] = Some(result);
            }
        }
    };
    if one_each {
        std::thread::scope(|scope| {
            for _ in 0..threads.min(fractions.len()) {
                scope.spawn(work);
            }
        });
    } else {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .map_err(|source| RunError::Threads { threads, source })?
            .install(work);
    }
    let results = results.into_inner().unwrap_or_default();
    let (mut done, mut interrupted) = (0.0, false);
    let mut boxes = Vec::new();
    let mut failure = None;
    for result in results.into_iter().flatten() {
        match result {
            Ok(simulated) => {
                done += case.run.duration;
                boxes.push(simulated);
            }
            Err(RunError::Simulate(SimulateError::Interrupted { time })) => {
                done += time;
                interrupted = true;
            }
            Err(error) => failure = failure.or(Some(error)),
        }
    }
    match failure {
        Some(error) => Err(error),
        None if interrupted => Err(RunError::Interrupted {
            done,
            of: case.run.duration * fractions.len() as f64,
            lost: lost.into_inner().unwrap_or_default(),
        }),
        None => Ok(boxes),
    }
}

/// Simulates one box, or what is left of it: the one place that picks solver, precision and dimension. Why
/// it could not be kept is left in `lost`.
fn simulate_box(
    case: &Case,
    fraction: f64,
    checkpoints: &Checkpoints,
    parallel: bool,
    stop: &dyn Fn() -> bool,
    progress: &Progress,
    lost: &Mutex<Option<CheckpointError>>,
) -> Result<Simulated, RunError> {
    let kept = checkpoints.kept(fraction)?;
    let mut keeper = checkpoints.keeper(fraction);
    let keep = |moment, underway: &Underway| {
        if let Err(error) = keeper.keep(moment, underway) {
            progress.say(&format!("warning: {error}"));
            if let Ok(mut lost) = lost.lock() {
                *lost = Some(error);
            }
        }
    };
    let mut bar = progress.start(fraction, case.run.duration);
    let watch = |signals: &_, pace| bar.update(signals, pace);
    let recorder = Recorder::new(case, checkpoints.fields(fraction));
    if let Some(recorder) = &recorder {
        recorder.begin(kept.as_ref().map_or(0, |kept| kept.signals.time.len() as u64 - 1))?;
    }
    macro_rules! simulate {
        ($flow:expr, $dimension:literal) => {{
            let record = |sample,
                          fine: &FineFields<$dimension>,
                          signals: &Signals,
                          particles: &Particles<'_>| match &recorder {
                Some(recorder) => {
                    Ok(recorder.record(sample, fine, |n| signals.values(n), particles)?)
                }
                None => Ok(()),
            };
            simulate_from($flow, case, fraction, parallel, stop, watch, kept, keep, record)
        }};
    }
    let result = match (case.run.precision, case.domain.size.len()) {
        _ if case.particles.is_some() => simulate!(cfd_dem(case, fraction, parallel)?, 3),
        (Precision::Double, 2) => simulate!(two_fluid::<f64, 2>(case, fraction, parallel), 2),
        (Precision::Double, _) => simulate!(two_fluid::<f64, 3>(case, fraction, parallel), 3),
        (Precision::Single, 2) => simulate!(two_fluid::<f32, 2>(case, fraction, parallel), 2),
        (Precision::Single, _) => simulate!(two_fluid::<f32, 3>(case, fraction, parallel), 3),
    };
    bar.finish();
    Ok(result?)
}

/// The sums of a box from the time on from which it was steady, and what its signals say. A box
/// that never became steady gives its second half, and a warning.
fn steady_part(simulated: &Simulated, scales: &Scales) -> (Sums, BoxSummary) {
    let (start, onset) = simulated.signals.start();
    let mut sums = simulated.sums.clone();
    sums.discard_before(start);
    (sums, BoxSummary::new(simulated, start, onset, scales))
}

/// The sums of a case's boxes, to be kept.
fn sums_file(case: &Case, sums: Vec<Sums>) -> SumsFile {
    let runs = case
        .domain
        .solids_fractions
        .iter()
        .zip(sums)
        .map(|(&solids_fraction, sums)| RunSums { name: case.name.clone(), solids_fraction, sums });
    SumsFile { system: sums_system(case), runs: runs.collect() }
}

/// What sums are of.
fn sums_system(case: &Case) -> SumsSystem {
    SumsSystem {
        powder: case.powder,
        gas: case.gas,
        gravity: case.physics.gravity,
        drag: case.physics.drag.to_string(),
    }
}

/// The quantity that a run's closure is of.
const DRAG: &str = "drag_correction";

/// Replicates of a run's bins, and the seed that they are drawn from.
const REPLICATES: (usize, u64) = (200, 1);

/// The surface and the form of the drag correction that fit; the reason if neither does.
fn fit_drag_correction(
    runs: &[RunSums],
    scales: &Scales,
    packing: f64,
) -> Result<Vec<Candidate>, RefitError> {
    let bins = Bins::of_runs(runs, scales, REPLICATES.0, REPLICATES.1)?.packed(packing);
    let form = refit(&bins, Shape::Form(&SaturatingDrag));
    match (refit(&bins, Shape::Spline), form) {
        (Err(_), Err(why)) => Err(why),
        (spline, form) => Ok([spline, form].into_iter().flatten().collect()),
    }
}

/// Writes the files of a run.
fn export(
    case: &Case,
    output: &Output,
    boxes: &[(Simulated, BoxSummary)],
    bins: &[BinRow],
    model: Option<&Model>,
    summary: &Summary,
) -> Result<(), RunError> {
    output.write("case.toml", |file| file.write_all(case.to_toml().as_bytes()))?;
    output.write("bins.csv", |file| write_rows(bins, file).map_err(io::Error::other))?;
    output.write("signals.csv", |file| write_signals(boxes, file).map_err(io::Error::other))?;
    if let Some(model) = model {
        output.write("model.toml", |file| {
            let definitions = Definitions::favre(&case.physics.drag.to_string());
            let (seed, system) = (Some(case.run.seed), Some(model.system));
            let closure =
                ClosureFile::fitted(&case.name, &model.candidate, seed, system, definitions);
            file.write_all(closure.to_toml().map_err(io::Error::other)?.as_bytes())
        })?;
        let mut rows = closure_rows(model, &case.filter.widths);
        let others: Vec<BinRow> =
            bins.iter().filter(|row| row.quantity != model.predicts).cloned().collect();
        rows.extend(binned_closure_rows(&others));
        output.write("closures.csv", |file| write_rows(&rows, file).map_err(io::Error::other))?;
        let drawing = figure::closure_chart(bins, &rows, &model.predicts).figure();
        output.write("closures.svg", |file| file.write_all(drawing.svg().as_bytes()))?;
    }
    let scale = summary.scales.terminal_velocity;
    let last = case.domain.size.len() - 1;
    let size = [case.domain.size[0], case.domain.size[last]];
    for (simulated, summary) in boxes {
        let phi = simulated.solids_fraction;
        let field = figure::field_figure(
            &simulated.snapshot,
            case.domain.cells[0],
            case.domain.cells[last],
            size,
        )?
        .png()?;
        output.write(&format!("field_{phi}.png"), |file| file.write_all(&field))?;
        let film = &simulated.film;
        let strip =
            figure::film_figure(film, &film.strip(summary.start, SHOWN_FRAMES), size).png()?;
        output.write(&format!("film_{phi}.png"), |file| file.write_all(&strip))?;
        let slip: Vec<f64> = simulated.signals.slip.iter().map(|slip| slip / scale).collect();
        let uniform = simulated.uniform_slip / scale;
        let times = &simulated.signals.time;
        let drawing =
            figure::series_chart(times, &slip, Some(summary.start), Some(uniform)).figure();
        output
            .write(&format!("slip_{phi}.svg"), |file| file.write_all(drawing.svg().as_bytes()))?;
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, summary)?))?;
    Ok(())
}

/// Writes the boxes' signals, one row per box and sample.
fn write_signals(boxes: &[(Simulated, BoxSummary)], writer: impl Write) -> csv::Result<()> {
    let mut table = csv::Writer::from_writer(writer);
    table.write_record([
        "box_solids_fraction [-]",
        "time [s]",
        "slip [m/s]",
        "particle_slip [m/s]",
        "solids_fraction_variance [-]",
        "pressure_gradient [weight]",
    ])?;
    for (simulated, _) in boxes {
        let signals = &simulated.signals;
        for (n, time) in signals.time.iter().enumerate() {
            table.serialize((
                simulated.solids_fraction,
                time,
                signals.slip[n],
                signals.particle_slip[n],
                signals.solids_fraction_variance[n],
                signals.pressure_gradient[n],
            ))?;
        }
    }
    table.flush()?;
    Ok(())
}
