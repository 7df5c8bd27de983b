//! [`filter`]: from fields on disk to a bin table; and what a run does with its own fields.

use super::{RunError, RunOptions, sums_system};
use crate::case::{Case, FieldsChoice};
use crate::checkpoint::Checkpoints;
use crate::filtered_fields::{FieldFilter, FilteredArray, FilteredFields};
use crate::laws::drag::DragLaw;
use crate::output::{Output, OutputError, RUN_FILE};
use crate::pool::Pool;
use crate::pool::grids::Grids;
use crate::resolved::Resolved;
use crate::resolved::hdf::ImageSeries;
use crate::resolved::map::Map;
use crate::resolved::series::{Instant, Reader, runs};
use crate::resolved::write::{Recorder, image};
use crate::resolved::xml::{Image, Named, write_image, write_series};
use crate::simulate::{Signals, samples, stored_sampling};
use crate::statistics::Sums;
use crate::stored::{StoredError, StoredFields, StoredSampler, StoredSampling};
use crate::sums::{RunSums, SUMS_FILE, SumsFile};
use crate::table::write_rows;
use serde::Serialize;
use std::borrow::Cow;
use std::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

/// Fewer instants than this are cut into blocks of space as well.
const FEW_INSTANTS: usize = 20;

/// Blocks of space along each axis then.
const SPACE_BLOCKS: usize = 2;

/// In what the filtered fields are written, beside the bins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldFormat {
    /// A .vti file per instant and width, and a .pvd series of each width.
    Vti,
    /// A .vtkhdf file per width, and one of the resolved fields.
    Vtkhdf,
}

/// What [`filter`] is asked for.
#[derive(Clone, Debug, Default)]
pub struct FilterOptions {
    /// Time from which on statistics are taken \[s\]; without it from where a run of Favre's became
    /// steady, and of other fields from the first instant on.
    pub from: Option<f64>,
    /// As for [`Pool::read`].
    pub order: Option<f64>,
    /// Filter widths \[m\], instead of the case's.
    pub widths: Option<Vec<f64>>,
    /// Whether to write the filtered fields too, and how.
    pub fields: Option<FieldFormat>,
}

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
/// Ends early once `stop` is set.
///
/// # Errors
/// Fields or the case are not acceptable, `stop` was set, or a file cannot be written.
pub fn filter(
    paths: &[PathBuf],
    map: &Map,
    asked: &FilterOptions,
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
    let runs = runs(paths, map)?;
    let several = runs.len() > 1;
    for (n, instants) in runs.iter().filter(|instants| !instants.is_empty()).enumerate() {
        let prefix = if several { format!("{}-", n + 1) } else { String::new() };
        let mut writer = asked.fields.map(|format| FieldWriter::new(format, prefix, output));
        let one =
            pool.install(|| sample(instants, map, asked, writer.as_mut(), stop, &mut warnings))?;
        writer.map_or(Ok(()), FieldWriter::finish)?;
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
    let pool =
        Pool::new(SumsFile { system: sums_system(&case), runs: runs.collect() }, asked.order)?;
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
    asked: &FilterOptions,
    mut writer: Option<&mut FieldWriter>,
    stop: &AtomicBool,
    warnings: &mut Vec<String>,
) -> Result<(Sums, RunRead, Case), RunError> {
    let interval = interval(instants);
    let mut reader = Reader::new(map);
    let (mut sampler, mut case): (_, Option<Case>) = (None, None);
    let mut signals = Signals::default();
    let mut own = true;
    let (mut fraction, mut shape) = (0.0, None);
    for instant in instants {
        if stop.load(Ordering::Relaxed) {
            return Err(RunError::Stopped);
        }
        let resolved = reader.read(instant, interval)?;
        let Some(read) = reader.case() else { return Err(RunError::NoFields) };
        let case = case.get_or_insert_with(|| {
            let mut case = read.clone();
            if let Some(widths) = &asked.widths {
                case.filter.widths.clone_from(widths);
            }
            case
        });
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
                if let Some(writer) = &mut writer {
                    writer.begin(&resolved.fields, law(), &sampling).map_err(refuse)?;
                }
                sampler.insert(StoredSampler::new(&resolved.fields, law, sampling).map_err(refuse)?)
            }
        };
        sampler.sample(&resolved.fields).map_err(refuse)?;
        if let Some(writer) = &mut writer {
            writer.write(&resolved.fields, &refuse)?;
        }
        let StoredFields { cells, spacing, periodic, .. } = resolved.fields;
        shape.get_or_insert((cells, spacing, periodic));
    }
    let (Some(sampler), Some(case), Some((cells, spacing, periodic))) = (sampler, case, shape)
    else {
        return Err(RunError::NoFields);
    };
    let [first, last] = [instants[0].time, instants[instants.len() - 1].time];
    // In flight the statistics begin where the signals say, and all samples must be there to say it.
    let step = case.run.sample_interval;
    let due = |(n, time): (usize, &f64)| (time / step - n as f64).abs() < 1e-6 * (n as f64 + 1.0);
    let complete = own && signals.time.iter().enumerate().all(due);
    let start = asked.from.or(complete.then(|| signals.start().0));
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
    Ok((sums, run, case))
}

/// Writes the filtered fields of one run.
struct FieldWriter<'a> {
    format: FieldFormat,
    /// What the names of its files begin with.
    prefix: String,
    output: &'a Output,
    filter: Option<FieldFilter>,
    /// The resolved fields, and those of each width.
    series: Vec<ImageSeries>,
    /// Times and names of the files of each width.
    files: Vec<Vec<(f64, String)>>,
    widths: Vec<f64>,
}

impl<'a> FieldWriter<'a> {
    fn new(format: FieldFormat, prefix: String, output: &'a Output) -> Self {
        let (filter, series, files) = (None, vec![], vec![]);
        Self { format, prefix, output, filter, series, files, widths: vec![] }
    }

    /// Name of what belongs to width number `width`.
    fn name(&self, width: usize) -> String {
        format!("{}filtered_{}", self.prefix, self.widths[width])
    }

    fn begin(
        &mut self,
        first: &StoredFields,
        law: Box<dyn DragLaw<f64>>,
        sampling: &StoredSampling,
    ) -> Result<(), StoredError> {
        self.filter = Some(FieldFilter::new(first, law, sampling.clone())?);
        self.widths.clone_from(&sampling.widths);
        self.files = vec![vec![]; self.widths.len()];
        self.series = vec![ImageSeries::default(); self.widths.len() + 1];
        Ok(())
    }

    fn refuse(&self, name: &str) -> impl FnOnce(io::Error) -> RunError {
        let path = self.output.dir().join(name);
        |source| RunError::Output(OutputError::Write { path, source })
    }

    fn write(
        &mut self,
        fields: &StoredFields,
        refuse: &dyn Fn(StoredError) -> RunError,
    ) -> Result<(), RunError> {
        let Some(filter) = &mut self.filter else { return Ok(()) };
        let filtered = filter.filter(fields).map_err(refuse)?;
        if self.format == FieldFormat::Vtkhdf {
            let added = match fields.cells.len() {
                2 => add_resolved::<2>(filter, fields, &mut self.series[0]),
                _ => add_resolved::<3>(filter, fields, &mut self.series[0]),
            };
            added.map_err(refuse)?.map_err(self.refuse("resolved.vtkhdf"))?;
        }
        for (width, filtered) in filtered.iter().enumerate() {
            let image = filtered_image(filtered);
            let folder = self.name(width);
            if self.format == FieldFormat::Vtkhdf {
                self.series[width + 1].push(&image).map_err(self.refuse(&folder))?;
                continue;
            }
            let name = format!("{folder}/{:06}.vti", self.files[width].len() + 1);
            let whole = self.output.partial();
            fs::create_dir_all(whole.join(&folder))
                .and_then(|()| write_image(&whole.join(&name), &image))
                .map_err(self.refuse(&name))?;
            self.files[width].push((fields.time, name));
        }
        Ok(())
    }

    fn finish(mut self) -> Result<(), RunError> {
        for (n, series) in std::mem::take(&mut self.series).into_iter().enumerate() {
            let name = match n {
                0 => format!("{}resolved.vtkhdf", self.prefix),
                n => format!("{}.vtkhdf", self.name(n - 1)),
            };
            series.write(&self.output.partial().join(&name)).map_err(self.refuse(&name))?;
        }
        for (width, files) in std::mem::take(&mut self.files).into_iter().enumerate() {
            if self.format == FieldFormat::Vti {
                let name = format!("{}.pvd", self.name(width));
                self.output.write(&name, |file| write_series(file, files.into_iter()))?;
            }
        }
        Ok(())
    }
}

/// Adds `fields` as they were resolved to `series`, without those that are missing.
fn add_resolved<const D: usize>(
    filter: &FieldFilter,
    fields: &StoredFields,
    series: &mut ImageSeries,
) -> Result<io::Result<()>, StoredError> {
    let fine = fields.fine::<D>(filter.law())?;
    let mut image = image(&fine);
    image.arrays.retain(|array| !array.components[0].iter().all(|value| value.is_nan()));
    Ok(series.push(&image))
}

/// Filtered fields as an image; a vector has three components, and an axis that is not there no cell.
fn filtered_image(filtered: &FilteredFields) -> Image<'_> {
    let axes = filtered.positions.len();
    fn triple<T: Copy>(values: &[T], rest: T) -> [T; 3] {
        std::array::from_fn(|axis| values.get(axis).copied().unwrap_or(rest))
    }
    fn named(array: &FilteredArray) -> Named<'_> {
        let FilteredArray { name, unit, components } = array;
        let mut all: Vec<Cow<[f64]>> = components.iter().map(|list| list.into()).collect();
        if all.len() == 2 {
            all.push(vec![0.0; components[0].len()].into());
        }
        Named { name: (*name).into(), unit, components: all }
    }
    Image {
        cells: triple(&filtered.positions, 0),
        spacing: triple(&filtered.spacing, 1.0),
        origin: triple(&filtered.origin, 0.0),
        time: filtered.time,
        periodic: triple(&filtered.periodic, false),
        vertical: axes - 1,
        arrays: filtered.arrays.iter().map(named).collect(),
    }
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
        let particles: Vec<(u64, String)> = recorder.particles(samples(case)).collect();
        fs::rename(recorder.folder(), output.partial().join(&folder)).map_err(write)?;
        if case.output.fields == FieldsChoice::Vti {
            let place = |(sample, name): (u64, String)| {
                (sample as f64 * case.run.sample_interval, format!("{folder}/{name}"))
            };
            let files = recorder.names(samples(case)).map(place);
            output.write(&format!("{folder}.pvd"), |file| write_series(file, files))?;
            if !particles.is_empty() {
                let files = particles.into_iter().map(place);
                let name = format!("particles_{fraction}.pvd");
                output.write(&name, |file| write_series(file, files))?;
            }
        }
    }
    Ok(())
}
