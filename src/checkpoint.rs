//! [`Checkpoints`]: what an interrupted run has computed, so that it can go on.
//!
//! Beside the output folder `DIR` stands `DIR.checkpoint`, one file per box: `box_0.15.state`. A
//! file appears by a rename, complete and on disk, or not at all. A run that goes on from it gives
//! the tables of one that was never interrupted, byte for byte. Everything in the case must be the
//! same but `[run] duration`, which may be any that has not been passed yet: so a run can be
//! prolonged. Once the run has its folder, the checkpoint is removed.
//!
//! # Format, version 6
//!
//! Numbers, texts and lists as in all binary files of this program: little-endian, lengths u64.
//! `Signals` and `Cost` are their fields in the order in which they are declared.
//!
//! | what | type |
//! | --- | --- |
//! | `favrebox` | 8 bytes |
//! | version of the format | u32 |
//! | version of the program | text |
//! | the case, resolved to SI ([`Case::to_toml`]) | text |
//! | mean solids fraction of the box | f64 |
//! | whether the run is to replace an earlier one (`--force`) | u8, 0 or 1 |
//! | seconds of the wall clock that the run has taken so far | f64 |
//! | simulated time \[s\] | f64 |
//! | [`Signals`] | five lists of f64 |
//! | [`Cost`] | u64 and f64 |
//! | [`Sums`](crate::statistics::Sums) | as in [`sums`](crate::sums) |
//! | [`Film`]: filter width, picture elements along each axis, samples from one frame to the next, number of frames | f64, four u64 |
//! | of each frame the number of its sample, its time, its two pictures | u64, f64, two lists of f64 |
//! | the state of the flow ([`TwoFluid::save_state`](crate::two_fluid::TwoFluid::save_state)) | the rest |
//! | CRC-32 (IEEE 802.3) of all of the above | u32 |

use crate::binary::{
    Fault, Source, open, put, put_list, put_text, take, take_list, take_text, write_file,
};
use crate::case::Case;
use crate::film::{Film, Frame};
use crate::output::beside;
use crate::simulate::{Cost, Kept, Moment, Signals, Underway, samples};
use crate::sums::{put_sums, take_sums};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What a checkpoint of a box begins with.
const MAGIC: &[u8; 8] = b"favrebox";

/// Version of the format.
const FORMAT: u32 = 6;

/// Version of the program: another one may compute other bits.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// How the name of a box's file begins; how it ends, and how until the file is complete.
const BOX: &str = "box_";
const STATE: &str = ".state";
const PARTIAL: &str = ".partial";

/// What the name of the folder of checkpoints ends with.
const CHECKPOINT: &str = ".checkpoint";

/// How the name of the folder of a box's snapshots begins.
const FIELDS: &str = "fields_";

/// The checkpoints of a run: where they stand, and what they say about the run as a whole.
#[derive(Debug)]
pub struct Checkpoints {
    dir: PathBuf,
    /// How often a box is kept; `None` for never.
    interval: Option<Duration>,
    case: String,
    /// Simulated time of each box \[s\].
    duration: f64,
    replaces: bool,
    begin: Instant,
    /// Seconds of the wall clock before this piece of the run.
    before: f64,
}

/// Why a run cannot go on, or a box cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// There is nothing to go on from.
    #[error(
        "there is nothing to go on from in {dir}: no run was interrupted there, or it kept \
         nothing; run without --resume",
        dir = dir.display()
    )]
    Absent {
        /// Where it was looked for.
        dir: PathBuf,
    },
    /// A run is to start where one was interrupted.
    #[error(
        "{dir} holds an interrupted run: go on with it by --resume, or start anew with --force",
        dir = dir.display()
    )]
    Exists {
        /// The checkpoints of that run.
        dir: PathBuf,
    },
    /// The checkpoint is of another case.
    #[error(
        "{path} is of another case, of {key} = {theirs} and not {ours}: resume that case, choose \
         another folder with --out DIR, or start anew with --force",
        path = path.display()
    )]
    Case {
        /// The file.
        path: PathBuf,
        /// The first key that differs, such as `[gas] density`.
        key: String,
        /// Its value in the checkpoint.
        theirs: String,
        /// Its value in the case to be run.
        ours: String,
    },
    /// More was simulated than is asked for now.
    #[error(
        "{path} has passed the duration asked for, {duration} s: it is at t = {time} s; ask for \
         that or more with --duration, or start anew with --force",
        path = path.display()
    )]
    Passed {
        /// The file.
        path: PathBuf,
        /// Where it is \[s\].
        time: f64,
        /// The duration asked for \[s\].
        duration: f64,
    },
    /// Another version of the format.
    #[error(
        "{path} has version {found} of the checkpoint format, and this is favre {VERSION} with \
         version {FORMAT}: go on with the favre that wrote it, or start anew with --force",
        path = path.display()
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Another version of the program.
    #[error(
        "{path} was written by favre {found}, and this is favre {VERSION}, whose numbers may \
         differ: go on with favre {found}, or start anew with --force",
        path = path.display()
    )]
    Version {
        /// The file.
        path: PathBuf,
        /// The version that wrote it.
        found: String,
    },
    /// Not, or no longer, what was written.
    #[error(
        "{path} is damaged ({what}): remove it to simulate this box from the start, or start \
         anew with --force",
        path = path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// The file or the folder cannot be read.
    #[error("cannot read the checkpoint {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file cannot be removed.
    #[error("cannot remove the checkpoint {path}", path = path.display())]
    Remove {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot keep {path}, to go on from after an interruption", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl Checkpoints {
    /// For a run that starts in the output folder `output`, which its caller has locked, and keeps
    /// its boxes at every `interval`, or never. What an interrupted run left there is discarded if
    /// `replace`.
    ///
    /// # Errors
    /// An interrupted run is there and is not to be replaced, or cannot be removed.
    pub fn start(
        output: &Path,
        case: &Case,
        interval: Option<Duration>,
        replace: bool,
    ) -> Result<Self, CheckpointError> {
        let checkpoints = Self::new(output, case, interval, replace);
        if !replace && !checkpoints.is_empty() {
            return Err(CheckpointError::Exists { dir: checkpoints.dir });
        }
        checkpoints.remove()?;
        Ok(checkpoints)
    }

    /// For a run that goes on where one was interrupted.
    ///
    /// # Errors
    /// There is nothing to go on from, or a file there is damaged, of another version, of another
    /// case, or past the case's duration.
    pub fn resume(
        output: &Path,
        case: &Case,
        interval: Option<Duration>,
    ) -> Result<Self, CheckpointError> {
        let mut checkpoints = Self::new(output, case, interval, false);
        let files = files(&checkpoints.dir, STATE)?;
        if files.is_empty() {
            return Err(CheckpointError::Absent { dir: checkpoints.dir });
        }
        for path in files {
            let (header, _) = checkpoints.read(&path)?;
            checkpoints.replaces |= header.replaces;
            checkpoints.before = checkpoints.before.max(header.seconds);
        }
        Ok(checkpoints)
    }

    fn new(output: &Path, case: &Case, interval: Option<Duration>, replaces: bool) -> Self {
        Self {
            dir: beside(output, CHECKPOINT),
            interval,
            case: case.to_toml(),
            duration: samples(case) as f64 * case.run.sample_interval,
            replaces,
            begin: Instant::now(),
            before: 0.0,
        }
    }

    /// The folder that they stand in.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// Whether no box is kept.
    pub fn is_empty(&self) -> bool {
        files(&self.dir, STATE).is_ok_and(|files| files.is_empty())
    }

    /// Whether the run is to replace an earlier one of its name.
    pub fn replaces(&self) -> bool {
        self.replaces
    }

    /// Seconds of the wall clock that the run has taken, all pieces together.
    pub fn seconds(&self) -> f64 {
        self.before + self.begin.elapsed().as_secs_f64()
    }

    /// What was kept of the box of `solids_fraction`, if anything.
    ///
    /// # Errors
    /// The file is damaged, or not of this case, box and program.
    pub fn kept(&self, solids_fraction: f64) -> Result<Option<Kept>, CheckpointError> {
        let path = self.path(solids_fraction);
        if !path.exists() {
            return Ok(None);
        }
        let (header, kept) = self.read(&path)?;
        if header.solids_fraction != solids_fraction {
            let what = format!("it is of the box of {}", header.solids_fraction);
            return Err(CheckpointError::Damaged { path, what });
        }
        Ok(Some(kept))
    }

    /// What keeps the box of `solids_fraction` while it is simulated.
    pub fn keeper(&self, solids_fraction: f64) -> BoxKeeper<'_> {
        BoxKeeper { checkpoints: self, solids_fraction, last: Instant::now() }
    }

    /// Where the snapshots of the box of `solids_fraction` stand until the run has its folder: they
    /// outlive an interruption as its state does.
    pub fn fields(&self, solids_fraction: f64) -> PathBuf {
        self.dir.join(format!("{FIELDS}{solids_fraction}"))
    }

    /// Removes what was kept, at the end of the run.
    ///
    /// # Errors
    /// A file cannot be removed.
    pub fn remove(&self) -> Result<(), CheckpointError> {
        for path in entries(&self.dir)?.into_iter().filter(|path| name_starts_with(path, FIELDS)) {
            if let Err(source) = fs::remove_dir_all(&path) {
                return Err(CheckpointError::Remove { path, source });
            }
        }
        // A run that is killed while it writes leaves a partial file.
        for path in files(&self.dir, PARTIAL)?.into_iter().chain(files(&self.dir, STATE)?) {
            if let Err(source) = fs::remove_file(&path) {
                return Err(CheckpointError::Remove { path, source });
            }
        }
        self.remove_dir();
        Ok(())
    }

    /// Removes the folder if nothing is in it: what somebody else put there stays.
    fn remove_dir(&self) {
        let _ = fs::remove_dir(&self.dir);
    }

    fn path(&self, solids_fraction: f64) -> PathBuf {
        self.dir.join(format!("{BOX}{solids_fraction}{STATE}"))
    }

    /// Writes the file of a box: under another name until it is whole and on disk.
    fn write(&self, solids_fraction: f64, underway: &Underway) -> Result<(), CheckpointError> {
        let path = self.path(solids_fraction);
        let partial = beside(&path, PARTIAL);
        let result = fs::create_dir_all(&self.dir)
            .and_then(|()| self.write_to(&partial, solids_fraction, underway))
            .and_then(|()| fs::rename(&partial, &path))
            .and_then(|()| sync_folder(&self.dir));
        result.map_err(|source| {
            let _ = fs::remove_file(&partial);
            self.remove_dir();
            CheckpointError::Write { path, source }
        })
    }

    fn write_to(&self, path: &Path, solids_fraction: f64, underway: &Underway) -> io::Result<()> {
        write_file(path, MAGIC, FORMAT, |to| {
            put_text(to, VERSION)?;
            put_text(to, &self.case)?;
            put(to, solids_fraction)?;
            to.write_all(&[u8::from(self.replaces)])?;
            put(to, self.seconds())?;
            put(to, underway.time)?;
            put_signals(to, underway.signals)?;
            put_cost(to, &underway.cost)?;
            put_sums(to, underway.sums)?;
            put_film(to, underway.film)?;
            (underway.write_flow)(to)
        })
    }

    /// Reads the file of a box of this case, once all of it has been found to be as it was written.
    fn read(&self, path: &Path) -> Result<(Header, Kept), CheckpointError> {
        let (header, kept) = read(path)?;
        if let Some((key, theirs, ours)) = difference(&header.case, &self.case) {
            return Err(CheckpointError::Case { path: path.into(), key, theirs, ours });
        }
        if header.time > self.duration {
            let Self { duration, .. } = *self;
            return Err(CheckpointError::Passed { path: path.into(), time: header.time, duration });
        }
        Ok((header, kept))
    }
}

/// Reads the file of a box of any case.
fn read(path: &Path) -> Result<(Header, Kept), CheckpointError> {
    let found = open(path, MAGIC, FORMAT, "checkpoint of a box")
        .and_then(|mut file| Ok((Header::read(&mut file)?, file)));
    let (header, mut file) = found.map_err(|error| at(error, path))?;
    if header.version != VERSION {
        let found = header.version;
        return Err(CheckpointError::Version { path: path.into(), found });
    }
    let mut rest = || {
        let signals = take_signals(&mut file)?;
        let (cost, sums) = (take_cost(&mut file)?, take_sums(&mut file)?);
        Ok::<_, Fault>((signals, cost, sums, take_film(&mut file)?))
    };
    let (signals, cost, sums, film) = rest().map_err(|error| at(error, path))?;
    let time = header.time;
    Ok((header, Kept { time, signals, cost, sums, film, flow: Box::new(file) }))
}

/// What an interrupted run that was to fill `output` kept.
pub struct Interrupted {
    /// Its case file, resolved.
    pub case: String,
    /// Mean solids fraction and state of each box that was kept.
    pub boxes: Vec<(f64, Kept)>,
}

impl Interrupted {
    /// What stands beside `output`; none if nothing does.
    ///
    /// # Errors
    /// A file there is damaged or of another version.
    pub fn read(output: &Path) -> Result<Option<Self>, CheckpointError> {
        let mut found: Option<Self> = None;
        for path in files(&beside(output, CHECKPOINT), STATE)? {
            let (header, kept) = read(&path)?;
            let run = found.get_or_insert(Self { case: header.case, boxes: Vec::new() });
            run.boxes.push((header.solids_fraction, kept));
        }
        Ok(found)
    }
}

/// The boxes' files in the folder `dir` whose names end with `end`, in the order of their names.
fn files(dir: &Path, end: &str) -> Result<Vec<PathBuf>, CheckpointError> {
    let mut files = entries(dir)?;
    let name = |path: &PathBuf| path.to_string_lossy().ends_with(end);
    files.retain(|path| name_starts_with(path, BOX) && name(path));
    Ok(files)
}

/// What stands in the folder `dir`, in the order of the names.
fn entries(dir: &Path) -> Result<Vec<PathBuf>, CheckpointError> {
    let read = |source| CheckpointError::Read { path: dir.into(), source };
    let entries = match fs::read_dir(dir) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.map_err(read)?,
    };
    let mut files = Vec::new();
    for entry in entries {
        files.push(entry.map_err(read)?.path());
    }
    files.sort();
    Ok(files)
}

fn name_starts_with(path: &Path, start: &str) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(start))
}

/// Keeps one box while it is simulated.
#[derive(Debug)]
pub struct BoxKeeper<'a> {
    checkpoints: &'a Checkpoints,
    solids_fraction: f64,
    /// When the box was last kept, or begun.
    last: Instant,
}

impl BoxKeeper<'_> {
    /// Keeps the box if it is time to: at its end, when it is stopped, and at every interval. A box
    /// without a sample is not worth keeping.
    ///
    /// # Errors
    /// The file cannot be written; an earlier one stays.
    pub fn keep(&mut self, moment: Moment, underway: &Underway) -> Result<(), CheckpointError> {
        let Some(interval) = self.checkpoints.interval else { return Ok(()) };
        let due = moment != Moment::Step || self.last.elapsed() >= interval;
        if !due || underway.signals.time.len() < 2 {
            return Ok(());
        }
        // Also after a failure: a full disk is not to be tried again at every step.
        let result = self.checkpoints.write(self.solids_fraction, underway);
        self.last = Instant::now();
        result
    }
}

/// What the file of a box says about the run.
struct Header {
    version: String,
    case: String,
    solids_fraction: f64,
    replaces: bool,
    seconds: f64,
    time: f64,
}

impl Header {
    fn read(from: &mut Source) -> Result<Self, Fault> {
        Ok(Self {
            version: take_text(from)?,
            case: take_text(from)?,
            solids_fraction: take(from)?,
            replaces: from.array::<1>()? != [0],
            seconds: take(from)?,
            time: take(from)?,
        })
    }
}

/// What is wrong with the file at `path`.
fn at(fault: Fault, path: &Path) -> CheckpointError {
    let path = path.to_owned();
    match fault {
        Fault::Read(source) => CheckpointError::Read { path, source },
        Fault::Format(found) => CheckpointError::Format { path, found },
        Fault::Damaged(what) => CheckpointError::Damaged { path, what },
    }
}

fn put_signals(to: &mut dyn Write, signals: &Signals) -> io::Result<()> {
    let Signals { time, slip, particle_slip, solids_fraction_variance, pressure_gradient } =
        signals;
    [time, slip, particle_slip, solids_fraction_variance, pressure_gradient]
        .into_iter()
        .try_for_each(|signal| put_list(to, signal))
}

fn take_signals(from: &mut Source) -> Result<Signals, Fault> {
    let signals = Signals {
        time: take_list(from)?,
        slip: take_list(from)?,
        particle_slip: take_list(from)?,
        solids_fraction_variance: take_list(from)?,
        pressure_gradient: take_list(from)?,
    };
    let Signals { time, slip, particle_slip, solids_fraction_variance, pressure_gradient } =
        &signals;
    let equal = [slip, particle_slip, solids_fraction_variance, pressure_gradient]
        .iter()
        .all(|s| s.len() == time.len());
    if equal { Ok(signals) } else { Err(Fault::damaged("its signals differ in length")) }
}

fn put_cost(to: &mut dyn Write, cost: &Cost) -> io::Result<()> {
    let Cost {
        steps,
        pressure_iterations,
        gas_steps,
        limited_by,
        volume_residual,
        mass_change,
        momentum_change,
        seconds,
    } = *cost;
    [steps, pressure_iterations, gas_steps]
        .into_iter()
        .chain(limited_by)
        .try_for_each(|number| put(to, number))?;
    [volume_residual, mass_change, momentum_change, seconds]
        .into_iter()
        .try_for_each(|number| put(to, number))
}

fn take_cost(from: &mut Source) -> Result<Cost, Fault> {
    let mut cost = Cost {
        steps: take(from)?,
        pressure_iterations: take(from)?,
        gas_steps: take(from)?,
        ..Cost::default()
    };
    for count in &mut cost.limited_by {
        *count = take(from)?;
    }
    cost.volume_residual = take(from)?;
    cost.mass_change = take(from)?;
    cost.momentum_change = take(from)?;
    cost.seconds = take(from)?;
    Ok(cost)
}

fn put_film(to: &mut dyn Write, film: &Film) -> io::Result<()> {
    put(to, film.filter_width)?;
    for number in film.shape {
        put(to, number as u64)?;
    }
    put(to, film.stride)?;
    put(to, film.frames.len() as u64)?;
    film.frames.iter().try_for_each(|frame| {
        put(to, frame.sample)?;
        put(to, frame.time)?;
        put_list(to, &frame.fraction)?;
        put_list(to, &frame.filtered)
    })
}

fn take_film(from: &mut Source) -> Result<Film, Fault> {
    let mut film = Film {
        filter_width: take(from)?,
        shape: [take::<u64>(from)? as usize, take::<u64>(from)? as usize],
        stride: take(from)?,
        frames: Vec::new(),
    };
    // The shortest frame has the numbers of its sample, its time, and of two empty pictures.
    for _ in 0..from.len(32)? {
        let (sample, time) = (take(from)?, take(from)?);
        let (fraction, filtered) = (take_list(from)?, take_list(from)?);
        film.frames.push(Frame { sample, time, fraction, filtered });
    }
    let elements = film.shape[0].checked_mul(film.shape[1]);
    let whole =
        |frame: &Frame| [&frame.fraction, &frame.filtered].map(|p| Some(p.len()) == elements);
    if film.stride == 0 || film.frames.iter().any(|frame| whole(frame).contains(&false)) {
        return Err(Fault::damaged("its film has frames of another size"));
    }
    Ok(film)
}

/// The first key, but the duration, in which two resolved cases differ, with both values.
fn difference(theirs: &str, ours: &str) -> Option<(String, String, String)> {
    let (theirs, ours) = (keys(theirs), keys(ours));
    let value = |keys: &[(String, String)], name: &str| {
        let found = keys.iter().find(|(key, _)| key == name);
        found.map_or_else(|| "absent".to_owned(), |(_, value)| value.clone())
    };
    ours.iter().chain(&theirs).find_map(|(key, _)| {
        let (theirs, ours) = (value(&theirs, key), value(&ours, key));
        (key != "[run] duration" && theirs != ours).then(|| (key.clone(), theirs, ours))
    })
}

/// The keys of a resolved case, with their sections, and their values.
fn keys(case: &str) -> Vec<(String, String)> {
    let mut section = "";
    let mut keys = Vec::new();
    for line in case.lines() {
        match line.split_once(" = ") {
            Some((key, value)) => keys.push((format!("{section} {key}"), value.to_owned())),
            None if line.starts_with('[') => section = line,
            None => {}
        }
    }
    keys
}

/// Waits until the names in a folder are on disk, where that can be asked for.
fn sync_folder(dir: &Path) -> io::Result<()> {
    if cfg!(unix) { File::open(dir)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::binary::{CHECKSUM, Crc};
    use crate::real::Real;
    use crate::simulate::{SimulateError, Simulated, simulate_from, two_fluid};
    use crate::two_fluid::StateError;
    use std::cell::Cell;

    const HOUR: Option<Duration> = Some(Duration::from_secs(3600));
    const PHI: f64 = 0.15;

    /// A box of 20 samples, with bins of slip.
    fn case(dimension: usize, precision: &str) -> Case {
        let (size, cells) = match dimension {
            2 => ("[0.02, 0.03]", "[16, 24]"),
            _ => ("[0.01, 0.0125, 0.015]", "[8, 10, 12]"),
        };
        let text = format!(
            "[powder]\ndiameter = 75e-6\ndensity = 1500\nrestitution = 0.9\nmax_packing = 0.65\n\
             [gas]\ndensity = 1.3\nviscosity = 1.8e-5\n\
             [box]\nsize = {size}\ncells = {cells}\nsolids_fraction = {PHI}\n\
             [filter]\nwidths = [0.0025, 0.005]\nmarkers = [\"solids_fraction\", \"slip\"]\n\
             [run]\nduration = \"10 u_t/g\"\nsample_interval = \"0.5 u_t/g\"\n\
             perturbation = 0.3\nprecision = \"{precision}\"\n"
        );
        Case::parse(&text, "case").unwrap()
    }

    fn whole<R: Real, const D: usize>(case: &Case) -> Simulated {
        simulate_from(
            two_fluid::<R, D>(case, PHI, false),
            case,
            PHI,
            false,
            &|| false,
            |_, _| {},
            None,
            |_, _| {},
            |_, _, _, _| Ok(()),
        )
        .unwrap()
    }

    /// One piece of a run, until `samples` have been taken in all, or as many steps done in this
    /// piece as `steps` and a sample taken.
    fn piece<R: Real, const D: usize>(
        case: &Case,
        checkpoints: &Checkpoints,
        samples: usize,
        steps: usize,
    ) -> Result<Simulated, SimulateError> {
        let kept = checkpoints.kept(PHI).unwrap();
        let before = kept.as_ref().map_or(0, |kept| kept.signals.time.len() - 1);
        let (polls, sampled) = (Cell::new(0), Cell::new(before));
        let stop = || {
            let done = polls.replace(polls.get() + 1);
            sampled.get() >= samples || (done >= steps && sampled.get() > 0)
        };
        let mut keeper = checkpoints.keeper(PHI);
        simulate_from(
            two_fluid::<R, D>(case, PHI, false),
            case,
            PHI,
            false,
            &stop,
            |signals, _| sampled.set(signals.time.len() - 1),
            kept,
            |moment, underway| keeper.keep(moment, underway).unwrap(),
            |_, _, _, _| Ok(()),
        )
    }

    /// A run that was stopped after `samples`, and what it left.
    fn stopped<R: Real, const D: usize>(case: &Case, samples: usize) -> tempfile::TempDir {
        let base = tempfile::tempdir().unwrap();
        let checkpoints = Checkpoints::start(&output(&base), case, HOUR, false).unwrap();
        let result = piece::<R, D>(case, &checkpoints, samples, usize::MAX);
        assert!(matches!(result, Err(SimulateError::Interrupted { .. })));
        base
    }

    fn output(base: &tempfile::TempDir) -> PathBuf {
        base.path().join("run")
    }

    fn file(base: &tempfile::TempDir) -> PathBuf {
        base.path().join("run.checkpoint/box_0.15.state")
    }

    fn resume(base: &tempfile::TempDir, case: &Case) -> Result<Checkpoints, CheckpointError> {
        Checkpoints::resume(&output(base), case, HOUR)
    }

    #[track_caller]
    fn assert_same(found: &Simulated, expected: &Simulated) {
        assert_eq!(found.signals, expected.signals);
        assert_eq!(found.sums, expected.sums);
        assert_eq!(found.snapshot, expected.snapshot);
        assert_eq!(found.film, expected.film);
        assert_eq!(found.uniform_slip, expected.uniform_slip);
        let cost = |cost: Cost| Cost { seconds: 0.0, ..cost };
        assert_eq!(cost(found.cost), cost(expected.cost));
    }

    fn goes_on<R: Real, const D: usize>(precision: &str) {
        let case = case(D, precision);
        let expected = whole::<R, D>(&case);
        assert_eq!(expected.signals.time.len(), 21);
        // Samples 4, 8, ... begin a block of time.
        for samples in [1, 3, 4, 19] {
            let base = stopped::<R, D>(&case, samples);
            let kept = resume(&base, &case).unwrap().kept(PHI).unwrap().unwrap();
            assert_eq!(kept.signals.time.len(), samples + 1);
            let checkpoints = resume(&base, &case).unwrap();
            let found = piece::<R, D>(&case, &checkpoints, usize::MAX, usize::MAX).unwrap();
            assert_same(&found, &expected);
            assert!(found.cost.seconds > kept.cost.seconds);

            // It was kept at its end: nothing is left to do.
            let again = piece::<R, D>(&case, &resume(&base, &case).unwrap(), usize::MAX, 0);
            assert_same(&again.unwrap(), &expected);
        }
        // In many pieces, cut between samples.
        let base = stopped::<R, D>(&case, 1);
        let mut pieces = 1;
        let found = loop {
            pieces += 1;
            match piece::<R, D>(&case, &resume(&base, &case).unwrap(), usize::MAX, 37) {
                Ok(found) => break found,
                Err(error) => assert!(matches!(error, SimulateError::Interrupted { .. })),
            }
        };
        assert!(pieces > 4, "{pieces} pieces");
        assert_same(&found, &expected);
    }

    #[test]
    fn an_interrupted_box_goes_on_to_the_same_bits() {
        goes_on::<f64, 2>("f64");
        goes_on::<f32, 2>("f32");
        goes_on::<f64, 3>("f64");
        goes_on::<f32, 3>("f32");
    }

    #[test]
    fn a_run_can_be_prolonged_but_not_cut_back() {
        let short = case(2, "f64");
        let mut long = short.clone();
        long.set_duration("12.5 u_t/g").unwrap();
        let expected = whole::<f64, 2>(&long);
        // From its middle, and from its end.
        for samples in [9, 20] {
            let base = tempfile::tempdir().unwrap();
            let checkpoints = Checkpoints::start(&output(&base), &short, HOUR, false).unwrap();
            let _ = piece::<f64, 2>(&short, &checkpoints, samples, usize::MAX);
            let checkpoints = resume(&base, &long).unwrap();
            let found = piece::<f64, 2>(&long, &checkpoints, usize::MAX, usize::MAX).unwrap();
            assert_same(&found, &expected);
            let refused = resume(&base, &short).unwrap_err();
            let CheckpointError::Passed { time, duration, .. } = refused else {
                panic!("{refused}")
            };
            assert_eq!((time, duration), (long.run.duration, short.run.duration));
        }
    }

    #[test]
    fn there_must_be_a_run_to_go_on_with_and_none_to_start() {
        let case = case(2, "f32");
        let base = tempfile::tempdir().unwrap();
        assert!(matches!(resume(&base, &case), Err(CheckpointError::Absent { .. })));
        let base = stopped::<f32, 2>(&case, 2);
        let start = |replace| Checkpoints::start(&output(&base), &case, HOUR, replace);
        assert!(matches!(start(false), Err(CheckpointError::Exists { .. })));
        assert!(file(&base).exists());
        fs::write(base.path().join("run.checkpoint/notes"), "mine").unwrap();
        fs::write(base.path().join("run.checkpoint/box_0.2.state.partial"), "of a kill").unwrap();
        let checkpoints = start(true).unwrap();
        assert!(checkpoints.is_empty());
        assert_eq!(fs::read_dir(checkpoints.dir()).unwrap().count(), 1);

        // Begun with --force: so it goes on.
        let _ = piece::<f32, 2>(&case, &checkpoints, 1, usize::MAX);
        let seconds = checkpoints.seconds();
        let checkpoints = resume(&base, &case).unwrap();
        assert!(checkpoints.replaces());
        assert!(0.0 < checkpoints.before && checkpoints.before < seconds);
        fs::remove_file(base.path().join("run.checkpoint/notes")).unwrap();
        checkpoints.remove().unwrap();
        assert_eq!(fs::read_dir(base.path()).unwrap().count(), 0);
    }

    #[test]
    fn another_case_is_refused_by_the_first_key_that_differs() {
        let case = case(2, "f64");
        let base = stopped::<f64, 2>(&case, 1);
        let check = |expected: &str, change: &dyn Fn(&mut Case)| {
            let mut other = case.clone();
            change(&mut other);
            match resume(&base, &other) {
                Err(CheckpointError::Case { key, theirs, ours, .. }) => {
                    assert_eq!(format!("{key}: {theirs} {ours}"), expected);
                }
                other => panic!("{expected}: {other:?}"),
            }
        };
        check("[gas] density: 1.3 1.2", &|case| case.gas.density = 1.2);
        check("[powder] density: 1500.0 1600.0", &|case| {
            case.powder.density = 1600.0;
            case.gas.density = 1.2;
        });
        check("[box] cells: [16, 24] [32, 24]", &|case| case.domain.cells[0] = 32);
        check("[box] solids_fraction: [0.15] [0.1]", &|case| {
            case.domain.solids_fractions = vec![0.1];
        });
        check("[filter] widths: [0.0025, 0.005] [0.0025]", &|case| {
            case.filter.widths.truncate(1);
        });
        check("[run] seed: 1 2", &|case| case.run.seed = 2);
        check("[run] precision: \"f64\" \"f32\"", &|case| {
            case.run.precision = crate::case::Precision::Single;
        });
        assert_eq!(
            difference("[a]\nx = 1\n[b]\nx = 2\n", "[a]\nx = 1\n[b]\n").unwrap().2,
            "absent"
        );
        assert_eq!(difference("[run]\nduration = 1\n", "[run]\nduration = 2\n"), None);
        assert_eq!(difference(&case.to_toml(), &case.to_toml()), None);
    }

    #[test]
    fn a_file_of_another_version_or_box_is_refused() {
        let case = case(2, "f32");
        let base = stopped::<f32, 2>(&case, 1);
        let original = fs::read(file(&base)).unwrap();
        let edited = |at: usize, byte: u8| {
            let mut bytes = original[..original.len() - CHECKSUM as usize].to_vec();
            bytes[at] = byte;
            fs::write(file(&base), signed(bytes)).unwrap();
            resume(&base, &case).unwrap_err()
        };
        let refused = edited(8, 1);
        assert!(matches!(refused, CheckpointError::Format { found: 1, .. }), "{refused:?}");
        let refused = edited(20, b'x');
        let CheckpointError::Version { found, .. } = refused else { panic!("{refused:?}") };
        assert_eq!(found, format!("x{}", &VERSION[1..]));

        fs::write(file(&base), &original).unwrap();
        let checkpoints = resume(&base, &case).unwrap();
        fs::rename(file(&base), checkpoints.path(0.2)).unwrap();
        let Err(refused) = checkpoints.kept(0.2) else { panic!("a box taken for another") };
        assert!(refused.to_string().contains("it is of the box of 0.15"), "{refused}");
        assert!(checkpoints.kept(PHI).unwrap().is_none());
    }

    fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
        let mut crc = Crc::new();
        crc.add(&bytes);
        bytes.extend(crc.value().to_le_bytes());
        bytes
    }

    #[test]
    fn a_file_cut_short_or_changed_is_never_half_read() {
        let case = case(2, "f32");
        let base = stopped::<f32, 2>(&case, 5);
        let original = fs::read(file(&base)).unwrap();
        let checkpoints = resume(&base, &case).unwrap();
        let body = original.len() - CHECKSUM as usize;
        let flow = body - 7 * 16 * 24 * 4;
        let near = |at: usize, place: usize| at.abs_diff(place) < 50;
        let places: Vec<usize> = (0..original.len())
            .filter(|&at| near(at, 0) || near(at, flow) || near(at, body))
            .chain((0..2000).step_by(19))
            .chain((0..original.len()).step_by(1999))
            .collect();
        let damaged = |bytes: &[u8], what: &str| {
            fs::write(file(&base), bytes).unwrap();
            let refused = checkpoints.kept(PHI).err();
            assert!(
                matches!(refused, Some(CheckpointError::Damaged { .. })),
                "{what}: {refused:?}"
            );
            assert!(matches!(resume(&base, &case), Err(CheckpointError::Damaged { .. })));
        };
        for &at in &places {
            damaged(&original[..at], &format!("{at} bytes"));
            let mut changed = original.clone();
            changed[at] ^= 1 << (at % 8);
            damaged(&changed, &format!("a bit of byte {at}"));
        }
        damaged(&[&original[..], b"x"].concat(), "a byte more");

        // Nor where the checksum agrees.
        for &at in places.iter().filter(|at| **at < body) {
            fs::write(file(&base), signed(original[..at].to_vec())).unwrap();
            match checkpoints.kept(PHI) {
                Err(CheckpointError::Damaged { .. }) => assert!(at < flow),
                Err(other) => panic!("{at} bytes: {other:?}"),
                Ok(_) => {
                    let refused = piece::<f32, 2>(&case, &checkpoints, 20, usize::MAX);
                    let Err(SimulateError::State(failure)) = refused else {
                        panic!("{at} bytes: {refused:?}")
                    };
                    let failure = failure.downcast_ref();
                    assert!(
                        matches!(failure, Some(StateError::Read(_))),
                        "{at} bytes: {failure:?}"
                    );
                }
            }
        }
        fs::write(file(&base), &original).unwrap();
        assert!(checkpoints.kept(PHI).unwrap().is_some());
    }

    #[test]
    fn a_box_is_kept_when_it_is_time_and_worth_it() {
        let case = case(2, "f32");
        let base = tempfile::tempdir().unwrap();
        let (signals, cost) =
            (Signals { time: vec![0.0; 2], ..Signals::default() }, Cost::default());
        let none = Signals { time: vec![0.0], ..Signals::default() };
        let kept = whole::<f32, 2>(&case);
        let attempt = |interval, moment, signals: &Signals| {
            let checkpoints = Checkpoints::start(&output(&base), &case, interval, true).unwrap();
            let write_flow: &dyn Fn(&mut dyn Write) -> io::Result<()> = &|_| Ok(());
            let underway = Underway {
                time: 0.0,
                signals,
                cost,
                sums: &kept.sums,
                film: &kept.film,
                write_flow,
            };
            checkpoints.keeper(PHI).keep(moment, &underway).unwrap();
            !checkpoints.is_empty()
        };
        for moment in [Moment::Step, Moment::Stop, Moment::End] {
            assert!(attempt(Some(Duration::ZERO), moment, &signals));
            assert!(!attempt(Some(Duration::ZERO), moment, &none));
            assert!(!attempt(None, moment, &signals));
            assert_eq!(attempt(HOUR, moment, &signals), moment != Moment::Step);
        }
    }

    #[test]
    fn what_cannot_be_written_leaves_the_earlier_file() {
        let case = case(2, "f32");
        let base = stopped::<f32, 2>(&case, 3);
        let before = fs::read(file(&base)).unwrap();
        let checkpoints = resume(&base, &case).unwrap();
        let kept = checkpoints.kept(PHI).unwrap().unwrap();
        let Kept { time, signals, cost, sums, film, .. } = &kept;
        let write_flow: &dyn Fn(&mut dyn Write) -> io::Result<()> =
            &|_| Err(io::Error::from(ErrorKind::StorageFull));
        let underway = Underway { time: *time, signals, cost: *cost, sums, film, write_flow };
        let refused = checkpoints.keeper(PHI).keep(Moment::Stop, &underway).unwrap_err();
        let CheckpointError::Write { path, source } = refused else { panic!("{refused:?}") };
        assert_eq!((path, source.kind()), (file(&base), ErrorKind::StorageFull));
        assert_eq!(fs::read(file(&base)).unwrap(), before);
        assert_eq!(fs::read_dir(checkpoints.dir()).unwrap().count(), 1);

        checkpoints.remove().unwrap();
        let _ = checkpoints.keeper(PHI).keep(Moment::Stop, &underway).unwrap_err();
        assert!(!checkpoints.dir().exists());
    }
}
