//! Files in the order of time: [`runs`] sorts what was typed, [`Reader`] reads one after the other.

use super::map::Map;
use super::openfoam::{self, Mesh};
use super::{Piece, Resolved, ResolvedError, numpy, particles, vtk};
use crate::case::{Case, CaseError};
use crate::stored::{Pressure, StoredError, StoredFields};
use std::path::{Path, PathBuf};

/// Times closer than this, over the larger one, are one instant.
const SAME_TIME: f64 = 1e-9;

/// Cell edges that differ by less than this, relatively, are meant to be equal.
const TRACE: f64 = 1e-5;

/// Slip as the particles see it is plausible between these, over u_t: from a bed that is hardly
/// fluidised to far more than any gas channel gives the particles in it.
const PLAUSIBLE_SLIP: [f64; 2] = [1e-3, 50.0];

/// What is read, in words.
const FORMATS: &str = ".vti .vtr .vtu .vtp (and .pvti .pvtr .pvtu .pvd), .npy .npz, .csv, folders \
    of .npy, OpenFOAM cases and time folders are read";

/// What the fields of one instant are read from.
#[derive(Clone, Debug, PartialEq)]
pub struct Instant {
    /// Its time \[s\].
    pub time: f64,
    /// Its files and folders.
    pub paths: Vec<PathBuf>,
}

/// A file or folder, and the time that it gives, in its unit.
struct Source {
    path: PathBuf,
    time: Option<f64>,
}

impl Source {
    fn is_particles(&self) -> bool {
        matches!(extension(&self.path).as_str(), "csv" | "vtp")
    }
}

fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase()
}

/// The runs that `paths` hold, each with its instants in the order of time: every folder, series or
/// OpenFOAM case is a run of its own, single files are one run together. Files of a run that are of
/// one time are one instant, such as particles and the gas on a grid; so are single .npy files of one
/// folder.
///
/// # Errors
/// A path cannot be read, is of no known format, or times are missing.
pub fn runs(paths: &[PathBuf], map: &Map) -> Result<Vec<Vec<Instant>>, ResolvedError> {
    // The run of loose files, if there are any, stands where the first of them was given.
    let mut runs: Vec<(Option<PathBuf>, Vec<Source>)> = Vec::new();
    for path in paths {
        let run = if path.is_dir() {
            let time_folder = is_time_folder(path);
            let npy = !time_folder && is_npy_folder(path)?;
            match (time_folder, npy) {
                (true, _) => Some(openfoam::case_of(path)),
                (false, true) => None,
                (false, false) => Some(path.clone()),
            }
        } else {
            (extension(path) == "pvd").then(|| path.clone())
        };
        let mut sources = Vec::new();
        expand(path, &mut sources)?;
        match runs.iter_mut().find(|(other, _)| *other == run) {
            Some((_, all)) => all.append(&mut sources),
            None => runs.push((run, sources)),
        }
    }
    runs.into_iter().map(|(_, sources)| instants(sources, map)).collect()
}

/// Whether `path` is a time folder in an OpenFOAM case: any folder may be named as a number.
fn is_time_folder(path: &Path) -> bool {
    openfoam::is_time_folder(path) && openfoam::case_of(path).join("constant").is_dir()
}

fn is_npy_folder(path: &Path) -> Result<bool, ResolvedError> {
    for entry in std::fs::read_dir(path).map_err(ResolvedError::read(path))? {
        if extension(&entry.map_err(ResolvedError::read(path))?.path()) == "npy" {
            return Ok(true);
        }
    }
    Ok(false)
}

/// The instants of one run.
fn instants(sources: Vec<Source>, map: &Map) -> Result<Vec<Instant>, ResolvedError> {
    let (scale, interval) = map.time_scale();
    let (known, unknown): (Vec<_>, Vec<_>) =
        sources.into_iter().partition(|source| source.time.is_some());
    let mut known: Vec<(f64, PathBuf)> = known
        .into_iter()
        .map(|source| (source.time.unwrap_or_default() * scale, source.path))
        .collect();
    known.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut instants: Vec<Instant> = Vec::new();
    for (time, path) in known {
        match instants.last_mut() {
            Some(last) if (time - last.time).abs() <= SAME_TIME * time.abs() => {
                last.paths.push(path)
            }
            _ => instants.push(Instant { time, paths: vec![path] }),
        }
    }
    if unknown.is_empty() {
        return Ok(instants);
    }
    // Groups of files that belong together, in the order in which they were given.
    let mut groups: [Vec<Vec<PathBuf>>; 2] = [Vec::new(), Vec::new()];
    for source in unknown {
        let list = &mut groups[usize::from(source.is_particles())];
        let npy = |path: &Path| path.is_file() && extension(path) == "npy";
        let joins = |last: &&mut Vec<PathBuf>| {
            npy(&source.path) && npy(&last[0]) && last[0].parent() == source.path.parent()
        };
        match list.last_mut().filter(joins) {
            Some(last) => last.push(source.path),
            None => list.push(vec![source.path]),
        }
    }
    let [grids, particles] = groups;
    if !instants.is_empty() {
        // Tables of particles go with the grids that tell their time.
        if grids.is_empty() && particles.len() == instants.len() {
            for (instant, paths) in instants.iter_mut().zip(particles) {
                instant.paths.extend(paths);
            }
            return Ok(instants);
        }
        let path = grids.iter().chain(&particles).flatten().next().cloned().unwrap_or_default();
        return Err(ResolvedError::format(
            &path,
            format!(
                "it gives no time, and {} gives {} s: give files that all tell their time, or one \
                 table of particles for each",
                instants[0].paths[0].display(),
                instants[0].time
            ),
        ));
    }
    if !grids.is_empty() && !particles.is_empty() && grids.len() != particles.len() {
        return Err(ResolvedError::Pair {
            path: grids[0][0].clone(),
            other: particles[0][0].clone(),
            why: format!(
                "{} grids and {} tables of particles, none with a time, do not pair",
                grids.len(),
                particles.len()
            ),
        });
    }
    let count = grids.len().max(particles.len());
    let interval = match (interval, count) {
        (Some(interval), _) => interval,
        (None, 1) => 0.0,
        (None, _) => {
            let path = grids.iter().chain(&particles).flatten().next().cloned().unwrap_or_default();
            return Err(ResolvedError::format(
                &path,
                format!(
                    "it and {} others give no time: give [grid] interval in the map, the time from \
                     one to the next",
                    count - 1
                ),
            ));
        }
    };
    let mut both = (grids.into_iter(), particles.into_iter());
    Ok((0..count)
        .map(|n| Instant {
            time: n as f64 * interval,
            paths: [both.0.next(), both.1.next()].into_iter().flatten().flatten().collect(),
        })
        .collect())
}

/// Adds what `path` stands for.
fn expand(path: &Path, sources: &mut Vec<Source>) -> Result<(), ResolvedError> {
    if path.is_dir() {
        if is_time_folder(path) {
            sources.push(Source { path: path.to_owned(), time: openfoam::time_of(path) });
            return Ok(());
        }
        if let Some(folders) = openfoam::times(path)? {
            let source = |path: PathBuf| Source { time: openfoam::time_of(&path), path };
            sources.extend(folders.into_iter().map(source));
            return Ok(());
        }
        if is_npy_folder(path)? {
            sources.push(Source { path: path.to_owned(), time: numpy::time(path)? });
            return Ok(());
        }
        let mut files = Vec::new();
        for entry in std::fs::read_dir(path).map_err(ResolvedError::read(path))? {
            files.push(entry.map_err(ResolvedError::read(path))?.path());
        }
        files.sort();
        let of = |end: &str| files.iter().filter(|file| extension(file) == end).collect::<Vec<_>>();
        let found = ["vti", "vtr", "vtu", "npz"].map(of);
        let mut found = found.into_iter().filter(|files| !files.is_empty());
        return match (found.next(), found.next()) {
            (Some(files), None) => files.into_iter().try_for_each(|file| expand(file, sources)),
            (None, _) => {
                Err(ResolvedError::format(path, format!("nothing in it is read: {FORMATS}")))
            }
            (Some(_), Some(_)) => {
                let why = "it holds files of several formats: name those that are meant";
                Err(ResolvedError::format(path, why))
            }
        };
    }
    std::fs::metadata(path).map_err(ResolvedError::read(path))?;
    let time = match extension(path).as_str() {
        "pvd" => {
            for (time, path) in vtk::series(path)? {
                sources.push(Source { path, time: Some(time) });
            }
            return Ok(());
        }
        "vti" | "vtr" | "vtu" | "vtp" | "pvti" | "pvtr" | "pvtu" => vtk::time(path)?,
        "npz" => numpy::time(path)?,
        "npy" | "csv" => None,
        _ => {
            return Err(ResolvedError::format(path, format!("its format is not known: {FORMATS}")));
        }
    };
    sources.push(Source { path: path.to_owned(), time });
    Ok(())
}

/// Reads instants as a map says.
pub struct Reader<'a> {
    map: &'a Map,
    /// The mesh of the last OpenFOAM case: reading it is most of the work.
    mesh: Option<Mesh>,
    case: Option<Case>,
}

/// Why a series cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// A file is not acceptable.
    #[error(transparent)]
    Resolved(#[from] ResolvedError),
    /// The case is not.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// The fields are not.
    #[error("{path}", path = path.display())]
    Stored {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: StoredError,
    },
}

impl<'a> Reader<'a> {
    /// A reader by `map`.
    pub fn new(map: &'a Map) -> Self {
        Self { map, mesh: None, case: None }
    }

    /// Reads an instant, and the case of the first one; `interval` is the time between instants \[s\].
    ///
    /// # Errors
    /// A file, its fields or the case are not acceptable.
    pub fn read(&mut self, instant: &Instant, interval: f64) -> Result<Resolved, SeriesError> {
        let mut pieces: Vec<Piece> =
            instant.paths.iter().map(|path| self.piece(path)).collect::<Result<_, _>>()?;
        // Single .npy files are arrays of one piece.
        if let Some(at) = pieces.iter().position(|p| p.case.is_some()) {
            pieces.swap(0, at);
        }
        let weight: Vec<Piece> = pieces
            .iter()
            .filter(|piece| piece.arrays.iter().any(|array| array.name == "p_rgh"))
            .cloned()
            .collect();
        let mut resolved = self.map.resolve(pieces, instant.time)?;
        if self.case.is_none() {
            self.case = Some(self.map.case(&resolved, interval)?);
        }
        if let Some(case) = &self.case {
            // Corners in single precision, or summed up by another program, leave traces; the case
            // has the edges as they were meant, or as the first instant had them.
            let meant = case.domain.spacing();
            let near = |(found, meant): (&f64, &f64)| (found / meant - 1.0).abs() < TRACE;
            if resolved.fields.spacing.iter().zip(&meant).all(near) {
                resolved.fields.spacing = meant;
            }
            self.map.add_weight(&mut resolved, &weight, case)?;
            resolved
                .fields
                .check()
                .map_err(|source| SeriesError::Stored { path: resolved.path.clone(), source })?;
            if !self.map.trusts() {
                plausible(&resolved, case)?;
            }
        }
        Ok(resolved)
    }

    /// The case, once an instant has been read.
    pub fn case(&self) -> Option<&Case> {
        self.case.as_ref()
    }

    fn piece(&mut self, path: &Path) -> Result<Piece, ResolvedError> {
        let wanted = |name: &str| self.map.wants(name);
        if is_time_folder(path) {
            let mesh = match self.mesh.take().filter(|mesh| mesh.is_of(path)) {
                Some(mesh) => mesh,
                None => Mesh::of(path)?,
            };
            let piece = openfoam::read(path, &mesh, &wanted);
            self.mesh = Some(mesh);
            return piece;
        }
        match extension(path).as_str() {
            "csv" => particles::read_csv(path, &wanted),
            "npy" | "npz" | "" => numpy::read(path, &self.map.layout(), &wanted),
            _ if path.is_dir() => numpy::read(path, &self.map.layout(), &wanted),
            _ => vtk::read(path, &wanted),
        }
    }
}

/// Whether the fields can be of the case: units that are mixed up show as slips, temperatures,
/// pressures, drag coefficients or cells that no gas and powder have.
fn plausible(resolved: &Resolved, case: &Case) -> Result<(), ResolvedError> {
    let StoredFields { solids_fraction, solids_velocity, gas_velocity, spacing, .. } =
        &resolved.fields;
    let scales = case.scales();
    let u_t = scales.terminal_velocity;
    let refuse = |array: &str, found: String| {
        let why = format!(
            "{found}: are its units mixed up? Give [units] or a formula in the map, or trust = true \
             there to take it as it is"
        );
        Err(ResolvedError::array(&resolved.path, array, why))
    };
    let diameter = case.powder.diameter;
    let shortest = spacing.iter().copied().fold(f64::INFINITY, f64::min);
    let longest = spacing.iter().copied().fold(0.0, f64::max);
    if shortest < diameter || longest > 1e5 * diameter {
        let found = format!("its cells are {spacing:?} m long and a particle is {diameter} m");
        return refuse("(the grid)", found);
    }
    let total: f64 = solids_fraction.iter().sum();
    if total <= 0.0 {
        return refuse("solids_fraction", "it is 0 everywhere".into());
    }
    let mean = |q: &dyn Fn(usize) -> f64| {
        solids_fraction.iter().enumerate().map(|(n, phi)| phi * q(n)).sum::<f64>() / total
    };
    let slip_squared = |n: usize| -> f64 {
        solids_velocity.iter().zip(gas_velocity).map(|(s, g)| (g[n] - s[n]).powi(2)).sum()
    };
    let slip = mean(&slip_squared).sqrt() / u_t;
    if !(PLAUSIBLE_SLIP[0]..=PLAUSIBLE_SLIP[1]).contains(&slip) {
        let found = format!(
            "the gas passes the particles at {:.3e} m/s, {slip:.3e} times their terminal velocity, \
             and {} to {} times is plausible",
            slip * u_t,
            PLAUSIBLE_SLIP[0],
            PLAUSIBLE_SLIP[1]
        );
        return refuse("gas_velocity - solids_velocity", found);
    }
    if let Some(temperature) = &resolved.fields.granular_temperature {
        let theta = mean(&|n| temperature[n]) / (u_t * u_t);
        if theta > 100.0 {
            let found = format!("its mean is {theta:.3e} u_t², and below 100 u_t² is plausible");
            return refuse("granular_temperature", found);
        }
    }
    if let Some(beta) = &resolved.fields.drag_coefficient {
        let law = case.physics.drag.law(&case.gas, &case.powder);
        let expected = mean(&|n| law.beta_per_fraction(solids_fraction[n], slip_squared(n).sqrt()));
        // The mean over the solids of β/φ, from that of β.
        let found = beta.iter().sum::<f64>() / total;
        let ratio = found / expected;
        if !(1e-2..=1e2).contains(&ratio) {
            let found = format!(
                "it is {ratio:.3e} times what the case's drag law gives, and 0.01 to 100 times is \
                 plausible; force per volume = drag_coefficient x slip is meant, in kg/m³/s"
            );
            return refuse("drag_coefficient", found);
        }
    }
    let vertical = spacing.len() - 1;
    let weight = case.powder.density * case.physics.gravity;
    let slope = match &resolved.fields.pressure {
        Some(Pressure::Gradient(slope)) => (slope[vertical].iter().map(|q| q * q).sum::<f64>()
            / slope[vertical].len() as f64)
            .sqrt(),
        Some(Pressure::Field(pressure)) => {
            let (low, high) = pressure
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
            // From the centre of the lowest cell to that of the highest.
            let steps = (resolved.fields.cells[vertical] - 1).max(1) as f64;
            (high - low) / (steps * spacing[vertical])
        }
        None => 0.0,
    };
    if slope > 100.0 * weight {
        let found = format!(
            "it falls by {slope:.3e} Pa/m, and at most 100 ρ_s g = {:.3e} Pa/m is plausible",
            100.0 * weight
        );
        return refuse("pressure", found);
    }
    Ok(())
}
