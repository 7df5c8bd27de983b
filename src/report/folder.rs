//! [`Folder`]: what is in the folder of a run, as far as it is there.

use crate::closure::{Closure, ClosureError};
use crate::output::RUN_FILE;
use crate::table::{BinRow, ClosureRow, TableError, read_bins_of, read_closures_of};
use serde::Deserialize;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Quantities that a report shows.
pub const SHOWN: &[&str] = &[
    "drag_correction",
    "solids_viscosity",
    "solids_pressure",
    "smagorinsky_viscosity",
    "smagorinsky_pressure",
    "solids_dispersion",
    "gas_dispersion",
];

/// A folder that cannot be reported.
#[derive(Debug, Error)]
pub enum ReportError {
    /// There is no such folder.
    #[error("{path}: there is no such folder; name the folder of a run, such as favre-out/default", path = path.display())]
    Absent {
        /// The folder.
        path: PathBuf,
    },
    /// The folder holds nothing of a run.
    #[error(
        "{path}: neither {RUN_FILE} nor bins.csv is in it, so it is not the folder of a run",
        path = path.display()
    )]
    NotARun {
        /// The folder.
        path: PathBuf,
    },
    /// A file cannot be read.
    #[error("{path}: {why}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// A table cannot be read.
    #[error(transparent)]
    Table(#[from] TableError),
    /// The closure cannot be read.
    #[error(transparent)]
    Closure(#[from] ClosureError),
}

/// A mean as run.json has it; null stands for what is not known.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct Measured {
    /// Mean.
    pub mean: Option<f64>,
    /// Standard error.
    pub standard_error: Option<f64>,
}

/// Scales of the powder, as run.json has them.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct ScalesFacts {
    /// u_t \[m/s\].
    pub terminal_velocity: f64,
    /// Fr_p.
    pub froude: f64,
    /// L_I \[m\].
    pub length_i: f64,
    /// L_II \[m\].
    pub length_ii: f64,
}

/// What a box cost.
#[derive(Clone, Copy, Debug, Deserialize)]
pub struct CostFacts {
    /// Time steps.
    pub steps: u64,
    /// Pressure iterations.
    pub pressure_iterations: u64,
    /// Seconds of the wall clock.
    pub seconds: f64,
}

/// What a box found.
#[derive(Clone, Debug, Deserialize)]
pub struct BoxFacts {
    /// Mean solids fraction.
    pub solids_fraction: f64,
    /// Slip of the uniform state over u_t.
    pub uniform_slip: f64,
    /// Where the statistics begin \[s\].
    pub start: f64,
    /// Whether the signals had become steady by then.
    pub steady: bool,
    /// Mean slip over u_t.
    pub slip: Measured,
    /// Variance of the solids fraction.
    pub solids_fraction_variance: Measured,
    /// The pictures of its film strip.
    pub film: Option<StripFacts>,
    /// What it cost.
    pub cost: CostFacts,
}

/// Pictures of a box on its way.
#[derive(Clone, Debug, Deserialize)]
pub struct StripFacts {
    /// Width of the filter \[m\].
    pub filter_width: f64,
    /// Times \[s\].
    pub times: Vec<f64>,
}

/// What was modelled, and why.
#[derive(Clone, Debug, Deserialize)]
pub struct TermFacts {
    /// The term.
    pub name: String,
    /// Whether it was modelled.
    pub on: bool,
    /// Why.
    pub why: String,
}

/// Where it ran.
#[derive(Clone, Debug, Deserialize)]
pub struct MachineFacts {
    /// Operating system.
    pub system: String,
    /// Processor architecture.
    pub architecture: String,
    /// Instruction set of the kernels.
    pub simd: String,
    /// Threads.
    pub threads: usize,
    /// Seconds of the wall clock.
    pub seconds: f64,
}

/// What a report takes from run.json. A run put together from others has less of it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub struct RunFacts {
    /// Version of the program.
    pub version: Option<String>,
    /// The case's name.
    pub name: Option<String>,
    /// The case in SI.
    pub case: Option<serde_json::Value>,
    /// Scales.
    pub scales: Option<ScalesFacts>,
    /// What was modelled.
    pub terms: Vec<TermFacts>,
    /// The boxes.
    pub boxes: Vec<BoxFacts>,
    /// What a user must know.
    pub warnings: Vec<String>,
    /// Where it ran.
    pub machine: Option<MachineFacts>,
}

impl RunFacts {
    /// A number of the case, such as `powder`, `diameter`.
    pub(super) fn number(&self, section: &str, key: &str) -> Option<f64> {
        self.case.as_ref()?.get(section)?.get(key)?.as_f64()
    }

    /// Numbers of the case, such as `box`, `cells`.
    pub(super) fn numbers(&self, section: &str, key: &str) -> Vec<f64> {
        let value = self.case.as_ref().and_then(|case| case.get(section)?.get(key)?.as_array());
        value.map_or(Vec::new(), |all| all.iter().filter_map(serde_json::Value::as_f64).collect())
    }
}

/// Signals of a box over time.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    /// Mean solids fraction.
    pub solids_fraction: f64,
    /// Times \[s\].
    pub times: Vec<f64>,
    /// Mean slip \[m/s\].
    pub slip: Vec<f64>,
}

/// What is known of a run.
#[derive(Clone, Debug, Default)]
pub struct Folder {
    /// Where it stands.
    pub path: PathBuf,
    /// Its name.
    pub name: String,
    /// run.json.
    pub facts: RunFacts,
    /// case.toml.
    pub case: Option<String>,
    /// Rows of bins.csv of the quantities that are shown.
    pub bins: Vec<BinRow>,
    /// Rows of closures.csv of the quantities that have a form.
    pub curves: Vec<ClosureRow>,
    /// model.toml.
    pub model: Option<Closure>,
    /// signals.csv.
    pub traces: Vec<Trace>,
    /// Snapshots: name of the file, and the PNG.
    pub snapshots: Vec<(String, Vec<u8>)>,
    /// Film strips, likewise.
    pub films: Vec<(String, Vec<u8>)>,
    /// What a complete run has and this one has not, one sentence each.
    pub missing: Vec<String>,
}

impl Folder {
    /// What stands in the folder `path`.
    ///
    /// # Errors
    /// It is no folder of a run, or a file in it is damaged. A file that is not there is no error.
    pub fn read(path: &Path) -> Result<Self, ReportError> {
        if !path.is_dir() {
            return Err(ReportError::Absent { path: path.into() });
        }
        let mut folder = Self { path: path.into(), ..Self::default() };
        let facts = folder.text(RUN_FILE, "what the run found and cost")?;
        let bins =
            folder.table("bins.csv", "the bins, so there is no closure and no coefficient")?;
        if facts.is_none() && bins.is_none() {
            return Err(ReportError::NotARun { path: path.into() });
        }
        if let Some(text) = facts {
            folder.facts =
                serde_json::from_str(&text).map_err(|why| folder.unreadable(RUN_FILE, why))?;
        }
        folder.name = match &folder.facts.name {
            Some(name) => name.clone(),
            None => path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        };
        if let Some(file) = bins {
            folder.bins = read_bins_of(&file, &|quantity| SHOWN.contains(&quantity))?;
            if folder.bins.is_empty() {
                folder.missing.push("bins.csv has no row of a quantity that is shown here".into());
            }
        }
        folder.case = folder.text("case.toml", "the case")?;
        if let Some(text) = folder.text("model.toml", "the fitted closure")? {
            folder.model = Some(Closure::parse(&text, &path.join("model.toml"))?);
        }
        if let Some(file) = folder.table("closures.csv", "the closure's curves")? {
            folder.curves = read_closures_of(&file, &|quantity| SHOWN.contains(&quantity))?;
        }
        if let Some(file) = folder.table("signals.csv", "slip over time")? {
            folder.traces = traces(&file).map_err(|why| folder.unreadable("signals.csv", why))?;
        }
        folder.snapshots = folder.pictures("field_", "pictures of the solids fraction")?;
        folder.films = folder.pictures("film_", "pictures of the boxes on their way")?;
        Ok(folder)
    }

    fn unreadable(&self, name: &str, why: impl ToString) -> ReportError {
        ReportError::Unreadable { path: self.path.join(name), why: why.to_string() }
    }

    /// The text of a file; without it, `what` is missing.
    fn text(&mut self, name: &str, what: &str) -> Result<Option<String>, ReportError> {
        match fs::read_to_string(self.path.join(name)) {
            Ok(text) => Ok(Some(text)),
            Err(error) if error.kind() == ErrorKind::NotFound => {
                self.missing.push(format!("{name} is not there: {what}"));
                Ok(None)
            }
            Err(error) => Err(self.unreadable(name, error)),
        }
    }

    /// The path of a table; without it, `what` is missing.
    fn table(&mut self, name: &str, what: &str) -> Result<Option<PathBuf>, ReportError> {
        let path = self.path.join(name);
        if path.is_file() {
            return Ok(Some(path));
        }
        self.missing.push(format!("{name} is not there: {what}"));
        Ok(None)
    }

    /// The PNG files whose names begin with `start`, in the order of their names; without any, `what` is
    /// missing.
    fn pictures(&mut self, start: &str, what: &str) -> Result<Vec<(String, Vec<u8>)>, ReportError> {
        let entries = fs::read_dir(&self.path).map_err(|why| self.unreadable("", why))?;
        let mut names: Vec<String> = entries
            .filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()))
            .filter(|name| name.starts_with(start) && name.ends_with(".png"))
            .collect();
        names.sort();
        if names.is_empty() {
            self.missing.push(format!("{start}*.png are not there: {what}"));
        }
        let read = |name: String| match fs::read(self.path.join(&name)) {
            Ok(bytes) => Ok((name, bytes)),
            Err(why) => Err(self.unreadable(&name, why)),
        };
        names.into_iter().map(read).collect()
    }

    /// u_t \[m/s\], if it is known.
    pub(super) fn terminal_velocity(&self) -> Option<f64> {
        self.facts.scales.map(|scales| scales.terminal_velocity)
    }
}

/// The boxes' signals of a table, in the order in which they stand there.
fn traces(path: &Path) -> Result<Vec<Trace>, String> {
    let mut table = csv::Reader::from_path(path).map_err(|why| why.to_string())?;
    let headers = table.headers().map_err(|why| why.to_string())?.clone();
    let column = |name: &str| {
        let place = headers.iter().position(|header| header == name);
        place.ok_or_else(|| format!("line 1: column `{name}` is missing"))
    };
    let columns = [column("box_solids_fraction [-]")?, column("time [s]")?, column("slip [m/s]")?];
    let mut traces: Vec<Trace> = Vec::new();
    for record in table.records() {
        let record = record.map_err(|why| why.to_string())?;
        let [solids_fraction, time, slip] = columns.map(|i| record[i].parse::<f64>());
        let line = record.position().map_or(0, csv::Position::line);
        let wrong = |_| format!("line {line}: a number is needed");
        let solids_fraction = solids_fraction.map_err(wrong)?;
        if traces.last().is_none_or(|last| last.solids_fraction != solids_fraction) {
            traces.push(Trace { solids_fraction, ..Trace::default() });
        }
        if let Some(trace) = traces.last_mut() {
            trace.times.push(time.map_err(wrong)?);
            trace.slip.push(slip.map_err(wrong)?);
        }
    }
    Ok(traces)
}
