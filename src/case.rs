//! [`Case`]: what is to be computed, resolved to SI, and the case file it is read from.
//!
//! A case file is TOML. Plain numbers are SI. A length may also be text with a unit: `"8 L_I"`,
//! `"3 d"`, `"75 um"` (m, cm, mm, um, the particle diameter d, the reference lengths L_I to L_V of
//! [`Scales`]); a time may be `"200 u_t/g"`, `"3 s"` or `"5 ms"`; a velocity `"0.25 u_t"` or
//! `"0.1 m/s"`. Unknown keys are refused.
//!
//! | section | key | meaning | accepted | default |
//! | --- | --- | --- | --- | --- |
//! | `[powder]` | `diameter` | particle diameter d | 1e-7 m to 0.1 m | - |
//! | | `density` | of one particle, ρ_s [kg/m³] | 1 to 30000, above the gas | - |
//! | | `restitution` | restitution coefficient e | 0 < e ≤ 1 | - |
//! | | `max_packing` | densest random packing φ_max | 0 < φ_max ≤ 0.74 | - |
//! | `[gas]` | `density` | ρ_g [kg/m³] | 1e-6 to 2000 | - |
//! | | `viscosity` | μ_g [Pa·s] | 1e-8 to 1 | - |
//! | `[box]` | `size` | edges of the periodic box, the last one vertical | two or three lengths | - |
//! | | `cells` | cells along each edge | even numbers from 8 | - |
//! | | `cell` | instead of `cells`: the edge of one cell | a length that divides every edge | - |
//! | | `solids_fraction` | mean solids fraction, or a list: one box each, pooled | 0 < φ < φ_max | - |
//! | `[physics]` | `drag` | fine-grid drag law | `"wen-yu"` | `"wen-yu"` |
//! | | `granular_energy` | how the granular temperature is found | `"transport"` | `"transport"` |
//! | | `gravity` | g [m/s²] | 1e-3 to 1e4 | 9.81 |
//! | `[filter]` | `widths` | edges of the box filters | whole cells along every axis, from 2 cells to half the box | 4, 8, 16 and 32 cells as far as they fit |
//! | | `markers` | what results are binned by | `"solids_fraction"`, and `"slip"` | `["solids_fraction"]` |
//! | | `solids_fraction_bin` | width of a bin | 1e-4 to φ_max | 0.02 |
//! | | `slip_bin` | width of a bin | 0.001 u_t to 10 u_t | `"0.25 u_t"` |
//! | `[run]` | `duration` | simulated time of each box | a time above 0 | `"200 u_t/g"` |
//! | | `sample_interval` | time between samples | above 0, to a twentieth of the duration | `"0.5 u_t/g"`, or less if the duration asks for it |
//! | | `seed` | of the initial perturbation | a whole number | 1 |
//! | | `perturbation` | relative amplitude of the initial perturbation | 0 to 0.5 | 0.05 |
//! | | `precision` | of the simulator | `"f32"`, `"f64"` | `"f64"` |
//!
//! Two stages: what was typed (types, units, places), then [`Case`] (SI, checked). Everything wrong
//! with a file is reported at once, each [`Problem`] with key, value, line and what is accepted.

mod file;

use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::laws::scales::{Gas, Powder, Scales};
pub use file::Problem;
use file::{CaseFile, DomainFile, FilterFile, Kind, Problems, Quantity, RunFile, Typed, Unit};

/// The case that `favre run` computes when none is given: the founding paper's powder in air.
pub const DEFAULT: &str = include_str!("../examples/default.toml");

/// Fewest cells along an edge: the smallest grid on which a filter of four cells is at most half
/// the box.
const FEWEST_CELLS: u64 = 8;

/// Most cells of a box: a run of this size takes hundreds of gigabytes, so more is a slip of the
/// pen, better refused here than by the memory allocator.
const MOST_CELLS: u64 = 1 << 30;

/// How far a ratio of lengths may be from a whole number and still count as one, relatively.
const WHOLE: f64 = 1e-6;

/// Samples that a run must have room for: statistics by blocks of time need some.
const FEWEST_SAMPLES: f64 = 20.0;

/// Largest case file read [bytes]: anything longer is not a case file.
const LONGEST_FILE: u64 = 1 << 20;

/// A case: everything a run needs to know, checked, in SI.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name, from the file's name (`default` for the embedded case).
    pub name: String,
    /// `[powder]`.
    pub powder: Powder,
    /// `[gas]`.
    pub gas: Gas,
    /// `[box]`.
    pub domain: Domain,
    /// `[physics]`.
    pub physics: Physics,
    /// `[filter]`.
    pub filter: FilterCase,
    /// `[run]`.
    pub run: RunCase,
}

/// `[box]`: the periodic box.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    /// Edge lengths [m], two or three; the last is vertical.
    pub size: Vec<f64>,
    /// Cells along each edge.
    pub cells: Vec<usize>,
    /// Mean solids fractions; one box is simulated for each, and their samples are pooled.
    pub solids_fractions: Vec<f64>,
}

/// `[physics]`: what is modelled, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Physics {
    /// `drag`: the fine-grid drag law.
    pub drag: DragChoice,
    /// `granular_energy`: how the granular temperature is found.
    pub granular_energy: GranularEnergyChoice,
    /// `gravity` [m/s²], a positive number.
    pub gravity: f64,
}

/// Fine-grid drag laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DragChoice {
    /// [`WenYu`](crate::laws::drag::WenYu).
    WenYu,
}

/// Ways to find the granular temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum GranularEnergyChoice {
    /// Its balance equation is solved.
    Transport,
}

/// `[filter]`: which filters, and by what their results are binned.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterCase {
    /// Filter widths [m], ascending, each a whole number of cells along every axis.
    pub widths: Vec<f64>,
    /// What the results are binned by; `solids_fraction` always.
    pub markers: Vec<MarkerChoice>,
    /// Width of a bin of filtered solids fraction.
    pub solids_fraction_bin: f64,
    /// Width of a bin of vertical filtered slip, in u_t (used with the marker `slip`).
    pub slip_bin: f64,
}

/// What filtered results are binned by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MarkerChoice {
    /// The filtered solids fraction.
    SolidsFraction,
    /// The vertical filtered slip over u_t.
    Slip,
}

/// `[run]`: how long, how precisely, from which seed.
#[derive(Clone, Debug, PartialEq)]
pub struct RunCase {
    /// Simulated time of each box [s].
    pub duration: f64,
    /// Time between samples [s].
    pub sample_interval: f64,
    /// Seed of the initial perturbation.
    pub seed: u64,
    /// Relative amplitude of the initial perturbation of the solids fraction.
    pub perturbation: f64,
    /// Precision of the simulator.
    pub precision: Precision,
}

/// Floating-point precision of the simulator. Statistics are always double.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub enum Precision {
    /// `f32`.
    #[serde(rename = "f32")]
    Single,
    /// `f64`.
    #[serde(rename = "f64")]
    Double,
}

/// Why there is no case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The file cannot be read.
    #[error("cannot read the case file {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The path is a folder.
    #[error("{path} is a folder and a case file is expected, such as {path}/case.toml", path = path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The file is longer than a case file can be.
    #[error("{path} is longer than {LONGEST_FILE} bytes: it is not a case file", path = path.display())]
    TooLong {
        /// The file.
        path: PathBuf,
    },
    /// The file is not text.
    #[error("{path}:{line}: not UTF-8 text: a case file is TOML in UTF-8", path = path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// The first line with a byte that is not UTF-8.
        line: usize,
    },
    /// The file holds nothing.
    #[error(
        "{place} is empty: a case needs [powder], [gas] and [box]; `favre run --print-case` prints \
         a complete one"
    )]
    Empty {
        /// The file.
        place: String,
    },
    /// The file holds something that is not acceptable.
    #[error("{}", list(place, problems))]
    Invalid {
        /// The file.
        place: String,
        /// All that is wrong, in the order of the lines.
        problems: Vec<Problem>,
    },
    /// The duration that is to replace the file's is not acceptable.
    #[error("duration {value}: {why}")]
    Duration {
        /// The duration given.
        value: String,
        /// What is wrong and what would be accepted.
        why: String,
    },
}

/// The problems, each with its place; their number first if there are several.
fn list(place: &str, problems: &[Problem]) -> String {
    let mut text = String::new();
    if problems.len() > 1 {
        let _ = writeln!(text, "{place} has {} problems", problems.len());
    }
    for (n, problem) in problems.iter().enumerate() {
        let newline = if n > 0 { "\n" } else { "" };
        let _ = write!(text, "{newline}{place}:{problem}");
    }
    text
}

impl Case {
    /// Reads the case file at `path`; the case is named after the file.
    ///
    /// # Errors
    /// The file cannot be read, is not text, or is refused by [`Case::parse`].
    pub fn load(path: &Path) -> Result<Self, CaseError> {
        let read = |source| CaseError::Read { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(CaseError::Folder { path: path.to_owned() });
        }
        let mut bytes = Vec::new();
        File::open(path)
            .map_err(read)?
            .take(LONGEST_FILE + 1)
            .read_to_end(&mut bytes)
            .map_err(read)?;
        if bytes.len() as u64 > LONGEST_FILE {
            return Err(CaseError::TooLong { path: path.to_owned() });
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let valid = &error.as_bytes()[..error.utf8_error().valid_up_to()];
            let line = valid.iter().filter(|byte| **byte == b'\n').count() + 1;
            CaseError::NotText { path: path.to_owned(), line }
        })?;
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        Self::parse_at(&text, &name, &path.display().to_string())
    }

    /// Reads the text of a case file; `name` becomes the case's name and stands in messages for
    /// the file.
    ///
    /// # Errors
    /// The text is empty, not TOML, or holds something that is not acceptable; all problems are
    /// reported together.
    pub fn parse(text: &str, name: &str) -> Result<Self, CaseError> {
        Self::parse_at(text, name, name)
    }

    fn parse_at(text: &str, name: &str, place: &str) -> Result<Self, CaseError> {
        let mut problems = Problems::new(text);
        let case = match file::read(text, &mut problems) {
            Some(file) => resolve(&file, name, &mut problems),
            None if problems.is_empty() => {
                return Err(CaseError::Empty { place: place.to_owned() });
            }
            None => None,
        };
        match case {
            Some(case) if problems.is_empty() => Ok(case),
            _ => {
                Err(CaseError::Invalid { place: place.to_owned(), problems: problems.into_list() })
            }
        }
    }

    /// Replaces the simulated time of each box by `text`, such as `20 u_t/g`, `3 s` or `3`.
    ///
    /// # Errors
    /// The text is not a time above 0, or the time has no room for twenty samples.
    pub fn set_duration(&mut self, text: &str) -> Result<(), CaseError> {
        let refuse = |why| CaseError::Duration { value: format!("\"{text}\""), why };
        let quantity = match text.trim().parse::<f64>() {
            Ok(seconds) if seconds.is_finite() => Quantity::from_si(seconds),
            _ => Quantity::parse(text, Kind::Time).map_err(refuse)?,
        };
        let scales = self.scales();
        let duration = quantity.si(Some(&scales)).filter(|duration| is_time(*duration));
        let duration = duration.ok_or_else(|| refuse(TIME_EXPECTED.to_owned()))?;
        let least = FEWEST_SAMPLES * self.run.sample_interval;
        if least > duration * (1.0 + WHOLE) {
            return Err(refuse(format!(
                "a run must be {FEWEST_SAMPLES} sample intervals long: give at least {:.4} u_t/g \
                 ({:.4} s), or a shorter sample_interval in [run]",
                least / scales.time(),
                least
            )));
        }
        self.run.duration = duration;
        Ok(())
    }

    /// Number of axes, 2 or 3.
    pub fn dimension(&self) -> usize {
        self.domain.size.len()
    }

    /// The scales of the powder in the gas.
    pub fn scales(&self) -> Scales {
        Scales::new(&self.powder, &self.gas, self.physics.gravity)
    }

    /// What is acceptable but probably not meant, one sentence each.
    pub fn warnings(&self) -> Vec<String> {
        let scales = self.scales();
        let (l_i, l_ii) = (scales.length_i(), scales.length_ii());
        let mut warnings = Vec::new();
        let longest = self.domain.size.iter().copied().fold(0.0, f64::max);
        let coarsest = self.domain.spacing().into_iter().fold(0.0, f64::max);
        if longest > 1e4 * l_i {
            warnings.push(format!(
                "the box is {longest} m long, {:.0} L_I: sizes are in metres, is this in mm?",
                longest / l_i
            ));
        } else if coarsest > 8.0 * l_ii {
            // Twice as coarse, in particle-scale lengths, as the founding study's grid.
            warnings.push(format!(
                "a cell is {coarsest:.3e} m long, {:.1} L_II: clusters are smeared on cells longer \
                 than about 4 L_II = {:.3e} m",
                coarsest / l_ii,
                4.0 * l_ii
            ));
        }
        warnings
    }

    /// The case as a case file with every key, in SI; [`Case::parse`] reads an equal case from it.
    pub fn to_toml(&self) -> String {
        let Self { name: _, powder, gas, domain, physics, filter, run } = self;
        format!(
            "[powder]\n\
             diameter = {:?}\n\
             density = {:?}\n\
             restitution = {:?}\n\
             max_packing = {:?}\n\
             \n[gas]\n\
             density = {:?}\n\
             viscosity = {:?}\n\
             \n[box]\n\
             size = {:?}\n\
             cells = {:?}\n\
             solids_fraction = {:?}\n\
             \n[physics]\n\
             drag = {}\n\
             granular_energy = {}\n\
             gravity = {:?}\n\
             \n[filter]\n\
             widths = {:?}\n\
             markers = {}\n\
             solids_fraction_bin = {:?}\n\
             slip_bin = \"{:?} u_t\"\n\
             \n[run]\n\
             duration = {:?}\n\
             sample_interval = {:?}\n\
             seed = {}\n\
             perturbation = {:?}\n\
             precision = {}\n",
            powder.diameter,
            powder.density,
            powder.restitution,
            powder.max_packing,
            gas.density,
            gas.viscosity,
            domain.size,
            domain.cells,
            domain.solids_fractions,
            quoted(&physics.drag),
            quoted(&physics.granular_energy),
            physics.gravity,
            filter.widths,
            quoted(&filter.markers),
            filter.solids_fraction_bin,
            filter.slip_bin,
            run.duration,
            run.sample_interval,
            run.seed,
            run.perturbation,
            quoted(&run.precision),
        )
    }
}

impl fmt::Display for Case {
    /// Writes [`Case::to_toml`].
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.to_toml())
    }
}

impl Domain {
    /// Edge of a cell along each axis [m].
    pub fn spacing(&self) -> Vec<f64> {
        self.size.iter().zip(&self.cells).map(|(size, cells)| size / *cells as f64).collect()
    }
}

/// A choice, or a list of choices, as it is typed in a case file.
fn quoted<T: serde::Serialize>(choice: &T) -> String {
    // JSON's strings and lists of plain names are TOML's too.
    serde_json::to_string(choice).expect("a choice is a name")
}

const TIME_EXPECTED: &str = "a time above 0 and at most 1e9 s is accepted";

fn is_time(seconds: f64) -> bool {
    seconds > 0.0 && seconds <= 1e9
}

/// The value where it is acceptable; else notes what would be.
fn accept(
    typed: Option<&Typed<f64>>,
    accepted: impl Fn(f64) -> bool,
    expected: &str,
    problems: &mut Problems<'_>,
) -> Option<f64> {
    let typed = typed?;
    if accepted(typed.value) {
        Some(typed.value)
    } else {
        problems.refuse(typed, format!("{expected} is accepted"));
        None
    }
}

/// Turns what was typed into a case; none if anything is missing or wrong, which is then among the
/// problems.
fn resolve(file: &CaseFile, name: &str, problems: &mut Problems<'_>) -> Option<Case> {
    let powder = resolve_powder(file, problems);
    let gas = resolve_gas(file, problems);
    let gravity = match &file.physics.gravity {
        None => Some(9.81),
        typed => accept(
            typed.as_ref(),
            |g| (1e-3..=1e4).contains(&g),
            "a number from 1e-3 to 1e4 m/s², positive: it points down the last axis,",
            problems,
        ),
    };
    // A gas as heavy as the powder has no terminal velocity, so no scales either.
    let scales = match (&powder, &gas, gravity) {
        (Some(powder), Some(gas), Some(gravity)) => Some(Scales::new(powder, gas, gravity)),
        _ => None,
    };
    let max_packing = file.powder.max_packing.as_ref().map(|typed| typed.value);
    let perturbation = match &file.run.perturbation {
        None => Some(0.05),
        typed => {
            accept(typed.as_ref(), |p| (0.0..=0.5).contains(&p), "a number from 0 to 0.5", problems)
        }
    };
    let diameter = powder.as_ref().map(|powder| powder.diameter);
    let domain = resolve_domain(&file.domain, scales.as_ref(), diameter, problems);
    let fractions = resolve_fractions(&file.domain, max_packing, perturbation, problems);
    let filter =
        resolve_filter(&file.filter, domain.as_ref(), scales.as_ref(), max_packing, problems);
    let run = resolve_run(&file.run, scales.as_ref(), perturbation, problems);
    let (size, cells) = domain?;
    Some(Case {
        name: name.to_owned(),
        powder: powder?,
        gas: gas?,
        domain: Domain { size, cells, solids_fractions: fractions? },
        physics: Physics {
            drag: file.physics.drag.as_ref().map_or(DragChoice::WenYu, |typed| typed.value),
            granular_energy: file
                .physics
                .granular_energy
                .as_ref()
                .map_or(GranularEnergyChoice::Transport, |typed| typed.value),
            gravity: gravity?,
        },
        filter: filter?,
        run: run?,
    })
}

fn resolve_powder(file: &CaseFile, problems: &mut Problems<'_>) -> Option<Powder> {
    let typed = &file.powder;
    let diameter = typed.diameter.as_ref().and_then(|typed| {
        let metres = typed.value.si(None).filter(|d| (1e-7..=0.1).contains(d));
        if metres.is_none() {
            problems.refuse(
                typed,
                "a diameter from 1e-7 to 0.1 is accepted, in metres, or text such as \"75 um\"",
            );
        }
        metres
    });
    let density = accept(
        typed.density.as_ref(),
        |rho| (1.0..=3e4).contains(&rho),
        "the density of one particle, from 1 to 30000 kg/m³,",
        problems,
    );
    let restitution = accept(
        typed.restitution.as_ref(),
        |e| e > 0.0 && e <= 1.0,
        "a number above 0 and at most 1",
        problems,
    );
    let max_packing = accept(
        typed.max_packing.as_ref(),
        |phi| phi > 0.0 && phi <= 0.74,
        "a number above 0 and at most 0.74, the densest packing of equal spheres,",
        problems,
    );
    Some(Powder {
        diameter: diameter?,
        density: density?,
        restitution: restitution?,
        max_packing: max_packing?,
    })
}

fn resolve_gas(file: &CaseFile, problems: &mut Problems<'_>) -> Option<Gas> {
    let density = accept(
        file.gas.density.as_ref(),
        |rho| (1e-6..=2e3).contains(&rho),
        "a number from 1e-6 to 2000 kg/m³",
        problems,
    );
    let viscosity = accept(
        file.gas.viscosity.as_ref(),
        |mu| (1e-8..=1.0).contains(&mu),
        "a number from 1e-8 to 1 Pa·s (air: 1.8e-5)",
        problems,
    );
    if let (Some(gas), Some(powder)) = (&file.gas.density, &file.powder.density)
        && density.is_some()
        && gas.value >= powder.value
    {
        problems.refuse(
            gas,
            format!("a gas lighter than the powder, below {} kg/m³, is accepted", powder.value),
        );
        return None;
    }
    Some(Gas { density: density?, viscosity: viscosity? })
}

/// Edge lengths and cells along each.
fn resolve_domain(
    file: &DomainFile,
    scales: Option<&Scales>,
    diameter: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<(Vec<f64>, Vec<usize>)> {
    let size = file.size.as_ref().and_then(|typed| resolve_size(typed, scales, problems));
    let axes = size.as_ref().map(Vec::len);
    let cells = match (&file.cells, &file.cell) {
        (Some(_), Some(cell)) => {
            problems.refuse(cell, "cells is given as well: keep one of the two");
            None
        }
        (Some(cells), None) => resolve_cells(cells, axes, problems),
        (None, Some(cell)) => resolve_cell(cell, file, size.as_deref(), scales, problems),
        (None, None) => None,
    };
    let (size, cells) = (size?, cells?);
    if let Some(diameter) = diameter {
        for (axis, (size, cells)) in size.iter().zip(&cells).enumerate() {
            let spacing = size / *cells as f64;
            if spacing < diameter * (1.0 - WHOLE) {
                let typed = file.size.as_ref()?.value.get(axis)?;
                problems.refuse(
                    typed,
                    format!(
                        "a cell would be {spacing:.3e} m long, less than one particle of \
                         {diameter:.3e} m, and a continuum of particles has no meaning there: \
                         sizes are in metres; with {cells} cells accepted is from {:.3e} m",
                        diameter * *cells as f64
                    ),
                );
                return None;
            }
        }
    }
    Some((size, cells))
}

fn resolve_size(
    typed: &Typed<Vec<Typed<Quantity>>>,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    if !(2..=3).contains(&typed.value.len()) {
        problems.refuse(
            typed,
            format!(
                "{} given; two edges (2-D) or three (3-D) are accepted, the last one vertical",
                plural(typed.value.len(), "edge")
            ),
        );
        return None;
    }
    let mut size = Vec::with_capacity(3);
    let mut complete = true;
    for edge in &typed.value {
        match edge.value.si(scales) {
            Some(metres) if metres > 0.0 && metres <= 1e9 => size.push(metres),
            Some(_) => {
                problems.refuse(edge, "a length above 0 and at most 1e9 m is accepted");
                complete = false;
            }
            None => complete = false,
        }
    }
    complete.then_some(size)
}

fn resolve_cells(
    typed: &Typed<Vec<Typed<u64>>>,
    axes: Option<usize>,
    problems: &mut Problems<'_>,
) -> Option<Vec<usize>> {
    if let Some(axes) = axes
        && typed.value.len() != axes
    {
        problems.refuse(
            typed,
            format!(
                "{} given and size has {}: one number for each edge is accepted",
                plural(typed.value.len(), "number"),
                plural(axes, "edge")
            ),
        );
        return None;
    }
    let mut sound = true;
    for count in &typed.value {
        if count.value < FEWEST_CELLS || count.value % 2 == 1 {
            problems.refuse(count, format!("an even number from {FEWEST_CELLS} is accepted"));
            sound = false;
        }
    }
    let product = typed.value.iter().try_fold(1u64, |product, n| product.checked_mul(n.value));
    if sound && product.is_none_or(|product| product > MOST_CELLS) {
        problems.refuse(typed, format!("at most {MOST_CELLS} cells in all are accepted"));
        sound = false;
    }
    sound.then(|| typed.value.iter().map(|count| count.value as usize).collect())
}

/// Cells along each edge from the edge of one cell.
fn resolve_cell(
    typed: &Typed<Quantity>,
    file: &DomainFile,
    size: Option<&[f64]>,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<usize>> {
    let edge = typed.value.si(scales)?;
    if edge <= 0.0 {
        problems.refuse(typed, "a length above 0 is accepted");
        return None;
    }
    let (size, typed_size) = (size?, file.size.as_ref()?);
    let mut cells = Vec::with_capacity(3);
    let mut sound = true;
    let fewest = FEWEST_CELLS as f64;
    for (length, typed) in size.iter().zip(&typed_size.value) {
        let ratio = length / edge;
        let whole = ratio.round();
        if (ratio - whole).abs() > WHOLE * whole || whole % 2.0 != 0.0 || whole < fewest {
            let below = (2.0 * (0.5 * ratio).floor()).max(fewest);
            let above = if below > ratio { below } else { below + 2.0 };
            let choice = if above > below {
                format!("{} m or {} m", significant(below * edge), significant(above * edge))
            } else {
                format!("{} m", significant(above * edge))
            };
            problems.refuse(
                typed,
                format!(
                    "this edge has {} cells of {} m and an even whole number of at least \
                     {FEWEST_CELLS} is needed: accepted nearest are {choice}, or another cell",
                    significant(ratio),
                    significant(edge)
                ),
            );
            sound = false;
        }
        cells.push(whole);
    }
    if sound && cells.iter().product::<f64>() > MOST_CELLS as f64 {
        problems.refuse(typed, format!("at most {MOST_CELLS} cells in all are accepted"));
        sound = false;
    }
    sound.then(|| cells.into_iter().map(|count| count as usize).collect())
}

fn resolve_fractions(
    file: &DomainFile,
    max_packing: Option<f64>,
    perturbation: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    let typed = &file.solids_fraction.as_ref()?.value;
    let highest = max_packing.unwrap_or(0.74);
    let mut sound = true;
    for (n, fraction) in typed.iter().enumerate() {
        let phi = fraction.value;
        let why = if phi <= 0.0 || phi >= highest {
            format!("a number above 0 and below max_packing = {highest} is accepted")
        } else if typed[..n].iter().any(|earlier| earlier.value == phi) {
            "given twice: one box is simulated for each solids fraction".to_owned()
        } else if perturbation.is_some_and(|p| phi * (1.0 + p) >= highest) {
            let p = perturbation.unwrap_or_default();
            format!(
                "with the perturbation of {p} it passes max_packing = {highest}: below {} is \
                 accepted, or a smaller perturbation in [run]",
                significant(highest / (1.0 + p))
            )
        } else {
            continue;
        };
        problems.refuse(fraction, why);
        sound = false;
    }
    sound.then(|| typed.iter().map(|fraction| fraction.value).collect())
}

fn resolve_filter(
    file: &FilterFile,
    domain: Option<&(Vec<f64>, Vec<usize>)>,
    scales: Option<&Scales>,
    max_packing: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<FilterCase> {
    let widths = domain.and_then(|(size, cells)| {
        let possible = PossibleWidths::new(size, cells);
        match &file.widths {
            Some(typed) => resolve_widths(&typed.value, &possible, scales, problems),
            None => default_widths(&possible, problems),
        }
    });
    let markers = match &file.markers {
        None => Some(vec![MarkerChoice::SolidsFraction]),
        Some(typed) => resolve_markers(typed, problems),
    };
    let solids_fraction_bin = match &file.solids_fraction_bin {
        None => Some(0.02),
        typed => {
            let highest = max_packing.unwrap_or(0.74);
            accept(
                typed.as_ref(),
                |bin| (1e-4..=highest).contains(&bin),
                &format!("a number from 1e-4 to max_packing = {highest}"),
                problems,
            )
        }
    };
    let slip_bin = match &file.slip_bin {
        None => Some(0.25),
        Some(typed) => {
            let scaled = match typed.value {
                Quantity { number, unit: Unit::TerminalVelocity } => Some(number),
                other => scales.and_then(|scales| {
                    other.si(None).map(|velocity| velocity / scales.terminal_velocity)
                }),
            };
            if scaled.is_some_and(|scaled| !(1e-3..=10.0).contains(&scaled)) {
                let u_t = scales.map_or(String::new(), |scales| {
                    format!(" (u_t is {:.4} m/s)", scales.terminal_velocity)
                });
                problems.refuse(typed, format!("from 0.001 u_t to 10 u_t is accepted{u_t}"));
                None
            } else {
                scaled
            }
        }
    };
    Some(FilterCase {
        widths: widths?,
        markers: markers?,
        solids_fraction_bin: solids_fraction_bin?,
        slip_bin: slip_bin?,
    })
}

fn resolve_markers(
    typed: &Typed<Vec<Typed<MarkerChoice>>>,
    problems: &mut Problems<'_>,
) -> Option<Vec<MarkerChoice>> {
    let mut markers: Vec<_> = typed.value.iter().map(|marker| marker.value).collect();
    for (n, marker) in typed.value.iter().enumerate() {
        if markers[..n].contains(&marker.value) {
            problems.refuse(marker, "given twice: each marker is accepted once");
            return None;
        }
    }
    let Some(place) = markers.iter().position(|marker| *marker == MarkerChoice::SolidsFraction)
    else {
        problems.refuse(
            typed,
            "\"solids_fraction\" is always a marker: [\"solids_fraction\", \"slip\"] is accepted",
        );
        return None;
    };
    markers.swap(0, place);
    Some(markers)
}

/// The widths that are a whole number of cells along every axis, from two cells to half the box.
struct PossibleWidths {
    /// Edge of a cell along each axis [m].
    spacing: Vec<f64>,
    /// The widths [m], ascending.
    widths: Vec<f64>,
}

impl PossibleWidths {
    fn new(size: &[f64], cells: &[usize]) -> Self {
        let spacing: Vec<f64> = size.iter().zip(cells).map(|(size, n)| size / *n as f64).collect();
        // Candidates are multiples of the cell along the axis with the fewest cells: any axis
        // would do, and this one keeps the list short in long boxes.
        let axis = (0..cells.len()).min_by_key(|axis| cells[*axis]).unwrap_or(0);
        let (first, half) = (spacing[axis], cells[axis] / 2);
        let whole = |width: f64| {
            spacing.iter().zip(cells).all(|(spacing, cells)| {
                let count = (width / spacing).round();
                (width / spacing - count).abs() <= WHOLE * count
                    && count >= 2.0
                    && count <= (cells / 2) as f64
            })
        };
        let widths = (2..=half).map(|n| n as f64 * first).filter(|width| whole(*width)).collect();
        Self { spacing, widths }
    }

    /// The possible width that equals `width` within round-off.
    fn find(&self, width: f64) -> Option<f64> {
        self.widths.iter().copied().find(|possible| (width / possible - 1.0).abs() <= WHOLE)
    }

    /// What is accepted near `width`, in words.
    fn near(&self, width: f64) -> String {
        let place = self.widths.partition_point(|possible| *possible < width);
        let mut near = Vec::new();
        near.extend(place.checked_sub(1).map(|below| self.widths[below]));
        near.extend(self.widths.get(place));
        let near: Vec<_> =
            near.into_iter().map(|width| format!("{} m", significant(width))).collect();
        if near.is_empty() {
            format!("no width is: cells of {} m have none in common", self.cell())
        } else {
            format!("accepted nearest: {}", near.join(", "))
        }
    }

    /// Edges of a cell, in words.
    fn cell(&self) -> String {
        let edges: Vec<_> = self.spacing.iter().map(|edge| significant(*edge)).collect();
        edges.join(" x ")
    }
}

fn resolve_widths(
    typed: &[Typed<Quantity>],
    possible: &PossibleWidths,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    let mut widths: Vec<f64> = Vec::with_capacity(typed.len());
    let mut sound = true;
    for quantity in typed {
        let width = quantity.value.si(scales)?;
        match possible.find(width) {
            Some(found) if widths.contains(&found) => {
                problems.refuse(quantity, "given twice: each filter width is accepted once");
                sound = false;
            }
            Some(found) => widths.push(found),
            None => {
                problems.refuse(
                    quantity,
                    format!(
                        "a width is a whole number of cells ({} m) along every axis, from two \
                         cells to half the box; {}",
                        possible.cell(),
                        possible.near(width)
                    ),
                );
                sound = false;
            }
        }
    }
    widths.sort_by(f64::total_cmp);
    sound.then_some(widths)
}

/// 4, 8, 16 and 32 of the longest cell edge, as far as they are possible.
fn default_widths(possible: &PossibleWidths, problems: &mut Problems<'_>) -> Option<Vec<f64>> {
    let edge = possible.spacing.iter().copied().fold(0.0, f64::max);
    let widths: Vec<_> =
        [4.0, 8.0, 16.0, 32.0].into_iter().filter_map(|n| possible.find(n * edge)).collect();
    if widths.is_empty() {
        let why = format!(
            "missing, and none of the defaults (4, 8, 16, 32 cells of {} m) fits along every axis; {}",
            possible.cell(),
            possible.near(4.0 * edge)
        );
        problems.missing("[filter] widths".to_owned(), None, why);
        return None;
    }
    Some(widths)
}

fn resolve_run(
    file: &RunFile,
    scales: Option<&Scales>,
    perturbation: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<RunCase> {
    let mut time = |typed: &Option<Typed<Quantity>>, default: f64| match typed {
        None => scales.map(|scales| default * scales.time()),
        Some(typed) => {
            let seconds = typed.value.si(scales)?;
            if !is_time(seconds) {
                problems.refuse(typed, TIME_EXPECTED);
                return None;
            }
            Some(seconds)
        }
    };
    let duration = time(&file.duration, 200.0);
    let longest = duration.map(|duration| duration / FEWEST_SAMPLES);
    let sample_interval = time(&file.sample_interval, 0.5);
    let sample_interval = match (&file.sample_interval, sample_interval, longest) {
        (Some(typed), Some(interval), Some(longest)) if interval > longest * (1.0 + WHOLE) => {
            problems.refuse(
                typed,
                format!(
                    "a run must be {FEWEST_SAMPLES} sample intervals long: with this duration at \
                     most {} s is accepted",
                    significant(longest)
                ),
            );
            None
        }
        (None, Some(interval), Some(longest)) => Some(interval.min(longest)),
        (_, interval, _) => interval,
    };
    Some(RunCase {
        duration: duration?,
        sample_interval: sample_interval?,
        seed: file.seed.as_ref().map_or(1, |typed| typed.value),
        perturbation: perturbation?,
        precision: file.precision.as_ref().map_or(Precision::Double, |typed| typed.value),
    })
}

/// A number in a message: six significant digits, without trailing zeros.
fn significant(x: f64) -> String {
    let rounded: f64 = format!("{x:.5e}").parse().unwrap_or(x);
    if (1e-4..1e6).contains(&rounded.abs()) { format!("{rounded}") } else { format!("{rounded:e}") }
}

/// `1 edge`, `2 edges`.
fn plural(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
