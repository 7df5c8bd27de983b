//! [`filter`]: from fields on disk to a bin table; and what a run does with its own fields.

use super::{RunError, RunOptions, sums_system};
use crate::case::{Case, FieldsChoice};
use crate::checkpoint::Checkpoints;
use crate::output::{Output, OutputError, RUN_FILE};
use crate::pool::Pool;
use crate::pool::grids::Grids;
use crate::resolved::Resolved;
use crate::resolved::map::Map;
use crate::resolved::series::{Instant, Reader, runs};
use crate::resolved::write::{Recorder, write_series};
use crate::simulate::{Signals, samples, stored_sampling};
use crate::statistics::Sums;
use crate::stored::{StoredFields, StoredSampler};
use crate::sums::{RunSums, SUMS_FILE, SumsFile};
use crate::table::write_rows;
use serde::Serialize;
use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Fewer instants than this are cut into blocks of space as well.
const FEW_INSTANTS: usize = 20;

/// Blocks of space along each axis then.
const SPACE_BLOCKS: usize = 2;

/// What filtering fields found.
#[derive(Clone, Debug, Serialize)]
pub struct FilterSummary {
    /// Version of the program.
    pub version: &'static str,
    /// The case, resolved to SI.
    pub case: serde_json::Value,
    /// The runs.
    pub runs: Vec<RunRead>,
    /// Filter widths \[m\].
    pub widths: Vec<f64>,
    /// Rows of the bin table.
    pub bins: usize,
    /// What the grids say of each other, if there are several.
    pub grids: Option<Grids>,
    /// What a user must know, one sentence each.
    pub warnings: Vec<String>,
}

/// One run of fields that was read.
#[derive(Clone, Debug, Serialize)]
pub struct RunRead {
    /// Its first file.
    pub first: PathBuf,
    /// Instants read.
    pub instants: usize,
    /// The first and the last time \[s\].
    pub times: [f64; 2],
    /// Time from which on the statistics were taken \[s\].
    pub start: f64,
    /// Cells along each axis, the last one vertical.
    pub cells: Vec<usize>,
    /// Edges of a cell \[m\].
    pub spacing: Vec<f64>,
    /// Along which axes it is periodic.
    pub periodic: Vec<bool>,
    /// Mean solids fraction, over the volume and the instants.
    pub solids_fraction: f64,
}

/// Filters the fields at `paths`, read as `map` says, and fills `output`, which the caller commits.
/// Statistics are taken from `from` \[s\] on; without it from where a run of Favre's became steady, and
/// of other fields from the first instant on. `order` is as for [`Pool::read`]. Ends early once `stop` is set.
///
/// # Errors
/// Fields or the case are not acceptable, `stop` was set, or a file cannot be written.
pub fn filter(
    paths: &[PathBuf],
    map: &Map,
    from: Option<f64>,
    order: Option<f64>,
    output: &Output,
    options: &RunOptions,
    stop: &AtomicBool,
) -> Result<FilterSummary, RunError> {
    let threads = options.threads;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|source| RunError::Threads { threads, source })?;
    let mut case = None;
    let (mut sums, mut read) = (Vec::new(), Vec::new());
    let mut warnings = Vec::new();
    for instants in runs(paths, map)?.iter().filter(|instants| !instants.is_empty()) {
        let one = pool.install(|| sample(instants, map, from, stop, &mut warnings))?;
        sums.push(one.0);
        read.push(one.1);
        case = case.or(Some(one.2));
    }
    let Some(case) = case else {
        return Err(RunError::NoFields);
    };
    let runs = read.iter().zip(sums).map(|(run, sums)| RunSums {
        name: run.first.display().to_string(),
        solids_fraction: run.solids_fraction,
        sums,
    });
    let pool = Pool::new(SumsFile { system: sums_system(&case), runs: runs.collect() }, order)?;
    output.write("case.toml", |file| file.write_all(case.to_toml().as_bytes()))?;
    output.write("bins.csv", |file| write_rows(&pool.bins, file).map_err(io::Error::other))?;
    output.write(SUMS_FILE, |file| pool.file.write(file))?;
    output.write("disagreements.csv", |file| {
        pool.write_disagreements(file).map_err(io::Error::other)
    })?;
    let summary = FilterSummary {
        version: env!("CARGO_PKG_VERSION"),
        case: toml::from_str(&case.to_toml()).unwrap_or_default(),
        runs: read,
        widths: case.filter.widths.clone(),
        bins: pool.bins.len(),
        grids: pool.grids.clone(),
        warnings,
    };
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, &summary)?))?;
    Ok(summary)
}

/// Samples one run.
fn sample(
    instants: &[Instant],
    map: &Map,
    from: Option<f64>,
    stop: &AtomicBool,
    warnings: &mut Vec<String>,
) -> Result<(Sums, RunRead, Case), RunError> {
    let interval = interval(instants);
    let mut reader = Reader::new(map);
    let mut sampler = None;
    let mut signals = Signals::default();
    let mut own = true;
    let (mut fraction, mut shape) = (0.0, None);
    for instant in instants {
        if stop.load(Ordering::Relaxed) {
            return Err(RunError::Stopped);
        }
        let resolved = reader.read(instant, interval)?;
        let Some(case) = reader.case() else { return Err(RunError::NoFields) };
        let path = resolved.path.clone();
        let refuse = |source| RunError::Stored { path: path.clone(), source };
        own &= resolved.case.is_some();
        match resolved.signals {
            Some([now, start]) => {
                if signals.time.is_empty() {
                    signals.push_values(0.0, start);
                }
                signals.push_values(instant.time, now);
            }
            None => own = false,
        }
        fraction += resolved.mean_solids_fraction() / instants.len() as f64;
        let sampler = match &mut sampler {
            Some(sampler) => sampler,
            None => {
                warn(&resolved, warnings);
                let mut sampling = stored_sampling(case, true);
                if !own {
                    sampling.block_duration = interval;
                    if instants.len() < FEW_INSTANTS {
                        sampling.space = SPACE_BLOCKS;
                    }
                }
                let law = || case.physics.drag.law(&case.gas, &case.powder);
                sampler.insert(StoredSampler::new(&resolved.fields, law, sampling).map_err(refuse)?)
            }
        };
        sampler.sample(&resolved.fields).map_err(refuse)?;
        let StoredFields { cells, spacing, periodic, .. } = resolved.fields;
        shape.get_or_insert((cells, spacing, periodic));
    }
    let (Some(sampler), Some(case), Some((cells, spacing, periodic))) =
        (sampler, reader.case(), shape)
    else {
        return Err(RunError::NoFields);
    };
    let [first, last] = [instants[0].time, instants[instants.len() - 1].time];
    // In flight the statistics begin where the signals say, and all samples must be there to say it.
    let step = case.run.sample_interval;
    let due = |(n, time): (usize, &f64)| (time / step - n as f64).abs() < 1e-6 * (n as f64 + 1.0);
    let complete = own && signals.time.iter().enumerate().all(due);
    let start = from.or(complete.then(|| signals.start().0));
    let mut sums = sampler.into_sums();
    // A block that began before is not whole; without a start there is none.
    if let Some(start) = start {
        sums.discard_before(start);
    }
    let start = start.unwrap_or(first);
    if sums.blocks.is_empty() {
        return Err(RunError::NothingFrom { start, last });
    }
    let run = RunRead {
        first: instants[0].paths[0].clone(),
        instants: instants.len(),
        times: [first, last],
        start,
        cells,
        spacing,
        periodic,
        solids_fraction: fraction,
    };
    Ok((sums, run, case.clone()))
}

/// Median time from one instant to the next \[s\]; 1 of a single one.
fn interval(instants: &[Instant]) -> f64 {
    let mut steps: Vec<f64> = instants.windows(2).map(|pair| pair[1].time - pair[0].time).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied().unwrap_or(1.0)
}

/// Says what is missing.
fn warn(resolved: &Resolved, warnings: &mut Vec<String>) {
    let fields = &resolved.fields;
    let missing = [
        ("pressure", fields.pressure.is_none(), "drag_correction, which needs it, has no rows"),
        ("granular_temperature", fields.granular_temperature.is_none(), "it has no rows"),
        (
            "solids_pressure and solids_stress",
            fields.solids_pressure.is_none() || fields.solids_stress.is_none(),
            "kinetic-theory stresses have no rows",
        ),
    ];
    for (field, missing, so) in missing {
        let warning = format!("no {field} in {}: {so}", resolved.path.display());
        if missing {
            warnings.push(warning);
        }
    }
    if fields.drag_coefficient.is_none() {
        let path = resolved.path.display();
        warnings.push(format!("no drag_coefficient in {path}: that of the case's law is taken"));
    }
}

impl fmt::Display for FilterSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for run in &self.runs {
            let cells: Vec<String> = run.cells.iter().map(ToString::to_string).collect();
            writeln!(
                f,
                "{}: {} instants of {} cells from t = {:.4} s to {:.4} s, ⟨φ⟩ = {:.4}, statistics \
                 from {:.4} s",
                run.first.display(),
                run.instants,
                cells.join(" x "),
                run.times[0],
                run.times[1],
                run.solids_fraction,
                run.start
            )?;
        }
        write!(f, "{} rows in bins.csv, filter widths {:?} m", self.bins, self.widths)?;
        if let Some(grids) = &self.grids {
            write!(f, "\n{grids}")?;
        }
        for warning in &self.warnings {
            write!(f, "\nwarning: {warning}")?;
        }
        Ok(())
    }
}

/// Moves the snapshots of `case` from where they were kept into `output`, and adds a series for
/// ParaView.
pub(super) fn take_fields(
    case: &Case,
    checkpoints: &Checkpoints,
    output: &Output,
) -> Result<(), RunError> {
    for &fraction in &case.domain.solids_fractions {
        let Some(recorder) = Recorder::new(case, checkpoints.fields(fraction)) else { break };
        let folder = format!("fields_{fraction}");
        let write = |source| {
            let path = output.dir().join(&folder);
            RunError::Output(OutputError::Write { path, source })
        };
        fs::rename(recorder.folder(), output.partial().join(&folder)).map_err(write)?;
        if case.output.fields == FieldsChoice::Vti {
            let files = recorder.names(samples(case)).map(|(sample, name)| {
                (sample as f64 * case.run.sample_interval, format!("{folder}/{name}"))
            });
            output.write(&format!("{folder}.pvd"), |file| write_series(file, files))?;
        }
    }
    Ok(())
}
