//! [`Map`]: which arrays of a file are what. A map.toml, every section of which may be left out:
//!
//! ```toml
//! case = "my-powder.toml"        # powder, gas, physics and filter; or give these sections here
//!
//! [fields]                       # names or formulae of arrays; defaults below
//! solids_fraction = "1 - EP_g"
//! solids_velocity = ["U_s1", "V_s1", "W_s1"]
//! gas_velocity = "Gas_Velocity"
//! pressure = "P_g"               # may be absent, as may all below
//! granular_temperature = "Theta_m1"
//!
//! [grid]
//! vertical = "y"                 # up is positive
//! periodic = ["x", "z"]          # the other axes end at walls
//! size = [0.16, 0.32, 0.16]      # along x, y, z: only where files do not tell (NumPy, particles)
//! cells = [64, 128, 64]          # only for particles without a field on a grid
//! origin = [0, 0, 0]             # lower corner: only for particles without a field on a grid
//! axes = "zyx"                   # of NumPy arrays: "zyx" has x fastest in the usual order
//! components = "last"            # of NumPy arrays, where it could be either
//! interval = 0.01                # time between files that tell none
//!
//! [units]                        # of the files, where not SI: a name, or the factor to SI
//! length = "mm"
//! velocity = "cm/s"
//! pressure = 1000.0
//! time = "ms"
//!
//! [particles]                    # of .vtp and .csv
//! position = ["x", "y", "z"]
//! velocity = ["vx", "vy", "vz"]
//! diameter = "2 * radius"
//! kernel = "linear"              # or "nearest"
//! thickness = 0.001              # of the slice, in two dimensions
//! ```
//!
//! A formula that is not given is the first of these of which all arrays are there, whatever their
//! case:
//!
//! | field | looked for |
//! | --- | --- |
//! | `solids_fraction` | `solids_fraction`, `alpha.particles`, `alpha.solids`, `1 - EP_g`, `1 - alpha.air`, `1 - alpha.gas`, `1 - voidfraction` |
//! | `solids_velocity` | `solids_velocity`, `U.particles`, `U.solids`, `U_s1` `V_s1` `W_s1`, `Solids_Velocity_1`, `Us` |
//! | `gas_velocity` | `gas_velocity`, `U.air`, `U.gas`, `U_g` `V_g` `W_g`, `Gas_Velocity` |
//! | `pressure_gradient` | `pressure_gradient` |
//! | `pressure` | `pressure`, `p`, `P_g`; of OpenFOAM also `p_rgh`, to which (φ ρ_s + (1-φ) ρ_g) g·x is added |
//! | `drag_coefficient`, `drag` | the same names; drag that is not given is drag_coefficient times the slip |
//! | `number_density`, `contact_density` | the same names: particles per volume, and their contacts, each counted for either particle |
//! | `granular_temperature` | `granular_temperature`, `Theta.particles`, `Theta.solids`, `Theta_m1` |
//! | `solids_pressure`, `solids_stress` | the same names |
//!
//! In a formula `x`, `y` and `z` are a cell's centre, where no array has such a name. `solids_stress`
//! has its components in VTK's order: xx, yy, zz, xy, yz, xz. `trust = true` at the top takes values
//! that are possible but not plausible.

use super::numpy::Layout;
use super::particles::{DepositKernel, Particles, deposit};
use super::{AXES, Columns, Lattice, Piece, Resolved, ResolvedError};
use crate::case::{Case, CaseError};
use crate::expression::Expression;
use crate::stored::{Pressure, StoredFields};
use serde::Deserialize;
use std::fs;
use std::path::{Path, PathBuf};

/// Sections of a map that a case does not have.
const OWN: [&str; 4] = ["fields", "grid", "units", "particles"];

/// Sections of a case that a map may have.
const SHARED: [&str; 6] = ["powder", "gas", "physics", "filter", "run", "output"];

/// Densest packing of equal spheres, π/√18: more solids than that is no solids fraction.
const DENSEST: f64 = 0.7405;

/// A solids fraction below zero by more than this is not an undershoot of a scheme.
const UNDERSHOOT: f64 = 1e-3;

/// A formula or one per component.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the name or formula of an array, or a list of one for each axis"
)]
enum Formula {
    One(String),
    Components(Vec<String>),
}

/// A factor to SI, or the name of a unit.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(untagged, expecting = "expected a unit's name or its factor to SI")]
enum Unit {
    Factor(f64),
    Name(String),
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct FieldNames {
    solids_fraction: Option<Formula>,
    solids_velocity: Option<Formula>,
    gas_velocity: Option<Formula>,
    pressure: Option<Formula>,
    pressure_gradient: Option<Formula>,
    drag_coefficient: Option<Formula>,
    drag: Option<Formula>,
    number_density: Option<Formula>,
    contact_density: Option<Formula>,
    granular_temperature: Option<Formula>,
    solids_pressure: Option<Formula>,
    solids_stress: Option<Formula>,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum AxisName {
    X,
    Y,
    Z,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Side {
    First,
    Last,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct GridHints {
    vertical: Option<AxisName>,
    periodic: Option<Vec<AxisName>>,
    size: Option<Vec<f64>>,
    cells: Option<Vec<usize>>,
    origin: Option<Vec<f64>>,
    axes: Option<String>,
    components: Option<Side>,
    interval: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Units {
    length: Option<Unit>,
    velocity: Option<Unit>,
    pressure: Option<Unit>,
    time: Option<Unit>,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct ParticleNames {
    position: Option<Formula>,
    velocity: Option<Formula>,
    diameter: Option<Formula>,
    kernel: DepositKernel,
    thickness: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct MapFile {
    case: Option<PathBuf>,
    trust: bool,
    fields: FieldNames,
    grid: GridHints,
    units: Units,
    particles: ParticleNames,
    // The case's own reader reads these, with its own messages.
    powder: Option<toml::Table>,
    gas: Option<toml::Table>,
    physics: Option<toml::Table>,
    filter: Option<toml::Table>,
    run: Option<toml::Table>,
    output: Option<toml::Table>,
}

/// Factors to SI of the units.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Factors {
    length: f64,
    velocity: f64,
    pressure: f64,
    time: f64,
}

/// A map that has been read.
#[derive(Clone, Debug)]
pub struct Map {
    /// The file, for messages.
    place: String,
    file: MapFile,
    /// The file without what a case does not hold, line by line.
    case_text: String,
    /// The text and the place of the case that it names.
    base: Option<(String, String)>,
    factors: Factors,
    sought: Vec<Sought>,
    particles: Vec<Sought>,
}

/// What is looked for: its key in the map, the section of that, and formulae in the order of
/// preference.
#[derive(Clone, Debug)]
struct Sought {
    section: &'static str,
    key: &'static str,
    given: bool,
    choices: Vec<Vec<Expression>>,
}

const FIELDS: [(&str, &[&[&str]]); 12] = [
    (
        "solids_fraction",
        &[
            &["solids_fraction"],
            &["alpha.particles"],
            &["alpha.solids"],
            &["1 - EP_g"],
            &["1 - alpha.air"],
            &["1 - alpha.gas"],
            &["1 - voidfraction"],
        ],
    ),
    (
        "solids_velocity",
        &[
            &["solids_velocity"],
            &["U.particles"],
            &["U.solids"],
            &["U_s1", "V_s1", "W_s1"],
            &["Solids_Velocity_1"],
            &["Us"],
        ],
    ),
    (
        "gas_velocity",
        &[&["gas_velocity"], &["U.air"], &["U.gas"], &["U_g", "V_g", "W_g"], &["Gas_Velocity"]],
    ),
    ("pressure_gradient", &[&["pressure_gradient"]]),
    ("pressure", &[&["pressure"], &["p"], &["P_g"]]),
    ("drag_coefficient", &[&["drag_coefficient"]]),
    ("drag", &[&["drag"]]),
    ("number_density", &[&["number_density"]]),
    ("contact_density", &[&["contact_density"]]),
    (
        "granular_temperature",
        &[&["granular_temperature"], &["Theta.particles"], &["Theta.solids"], &["Theta_m1"]],
    ),
    ("solids_pressure", &[&["solids_pressure"]]),
    ("solids_stress", &[&["solids_stress"]]),
];

const PARTICLES: [(&str, &[&[&str]]); 3] = [
    (
        "position",
        &[&["Points"], &["position"], &["x", "y", "z"], &["Points:0", "Points:1", "Points:2"]],
    ),
    (
        "velocity",
        &[
            &["velocity"],
            &["vx", "vy", "vz"],
            &["velocity:0", "velocity:1", "velocity:2"],
            &["u", "v", "w"],
            &["v"],
        ],
    ),
    ("diameter", &[&["diameter"], &["d"], &["2 * radius"], &["2 * r"]]),
];

impl Map {
    /// The map of files that need none: all defaults.
    pub fn none() -> Self {
        Self::parse("", "without --map").expect("an empty map is one")
    }

    /// Reads the map at `path`.
    ///
    /// # Errors
    /// It cannot be read, is not TOML, has an unknown key or a value that is not acceptable.
    pub fn load(path: &Path) -> Result<Self, ResolvedError> {
        let text = fs::read_to_string(path).map_err(ResolvedError::read(path))?;
        let mut map = Self::parse(&text, &path.display().to_string())?;
        if let Some(case) = &map.file.case {
            let case = path.parent().unwrap_or(Path::new("")).join(case);
            let text = fs::read_to_string(&case).map_err(ResolvedError::read(&case))?;
            map.base = Some((text, case.display().to_string()));
        }
        Ok(map)
    }

    /// Reads the text of a map; `place` stands for it in messages.
    ///
    /// # Errors
    /// As [`Map::load`].
    pub fn parse(text: &str, place: &str) -> Result<Self, ResolvedError> {
        let refuse = |why: String| ResolvedError::Map { place: place.to_owned(), why };
        let file: MapFile = toml::from_str(text).map_err(|error| refuse(error.to_string()))?;
        let factor = |key: &str, unit: &Option<Unit>, known: &[(&str, f64)]| match unit {
            None => Ok(1.0),
            Some(Unit::Factor(factor)) if *factor > 0.0 && factor.is_finite() => Ok(*factor),
            Some(Unit::Factor(factor)) => {
                Err(refuse(format!("[units] {key} = {factor}: a factor above 0 is accepted")))
            }
            Some(Unit::Name(name)) => {
                let found = known.iter().find(|(known, _)| known == name);
                let names: Vec<_> = known.iter().map(|(name, _)| *name).collect();
                found.map(|(_, factor)| *factor).ok_or_else(|| {
                    let names = names.join(", ");
                    refuse(format!(
                        "[units] {key} = \"{name}\": {names} or a factor to SI is accepted"
                    ))
                })
            }
        };
        let units = &file.units;
        let length = [("m", 1.0), ("cm", 1e-2), ("mm", 1e-3), ("um", 1e-6)];
        let velocity = [("m/s", 1.0), ("cm/s", 1e-2), ("mm/s", 1e-3)];
        let pressure = [("Pa", 1.0), ("kPa", 1e3), ("bar", 1e5), ("mbar", 1e2)];
        let time = [("s", 1.0), ("ms", 1e-3), ("us", 1e-6)];
        let factors = Factors {
            length: factor("length", &units.length, &length)?,
            velocity: factor("velocity", &units.velocity, &velocity)?,
            pressure: factor("pressure", &units.pressure, &pressure)?,
            time: factor("time", &units.time, &time)?,
        };
        let sought = |section: &'static str,
                      list: &[(&'static str, &[&[&str]])],
                      given: &[&Option<Formula>]| {
            list.iter()
                .zip(given)
                .map(|((key, defaults), given)| {
                    let parse = |text: &str| {
                        Expression::parse(text)
                            .map_err(|why| refuse(format!("[{section}] {key} = \"{text}\": {why}")))
                    };
                    let choices = match given {
                        Some(Formula::One(text)) => vec![vec![parse(text)?]],
                        Some(Formula::Components(texts)) => {
                            vec![texts.iter().map(|text| parse(text)).collect::<Result<_, _>>()?]
                        }
                        None => defaults
                            .iter()
                            .map(|choice| choice.iter().map(|text| parse(text)).collect())
                            .collect::<Result<_, _>>()?,
                    };
                    Ok(Sought { section, key, given: given.is_some(), choices })
                })
                .collect::<Result<Vec<_>, ResolvedError>>()
        };
        let f = &file.fields;
        let fields = sought(
            "fields",
            &FIELDS,
            &[
                &f.solids_fraction,
                &f.solids_velocity,
                &f.gas_velocity,
                &f.pressure_gradient,
                &f.pressure,
                &f.drag_coefficient,
                &f.drag,
                &f.number_density,
                &f.contact_density,
                &f.granular_temperature,
                &f.solids_pressure,
                &f.solids_stress,
            ],
        )?;
        let p = &file.particles;
        let particles = sought("particles", &PARTICLES, &[&p.position, &p.velocity, &p.diameter])?;
        if let Some(interval) = file.grid.interval
            && (interval.is_nan() || interval <= 0.0 || interval.is_infinite())
        {
            return Err(refuse(format!(
                "[grid] interval = {interval}: a time above 0 is accepted"
            )));
        }
        let case_text = without_sections(text, &OWN, true);
        let place = place.to_owned();
        Ok(Self { place, file, case_text, base: None, factors, sought: fields, particles })
    }

    /// How NumPy arrays are laid out.
    pub fn layout(&self) -> Layout {
        Layout {
            axes: self.file.grid.axes.clone(),
            components_first: self.file.grid.components.map(|side| side == Side::First),
        }
    }

    /// Whether an array of this name may be asked for.
    pub fn wants(&self, name: &str) -> bool {
        let named = |sought: &Sought| {
            let names = sought.choices.iter().flatten().flat_map(Expression::names);
            names.into_iter().any(|wanted| wanted.eq_ignore_ascii_case(name))
        };
        name == "p_rgh" || self.sought.iter().chain(&self.particles).any(named)
    }

    /// Factor from a file's time to seconds, and seconds between files that tell no time.
    pub fn time_scale(&self) -> (f64, Option<f64>) {
        (self.factors.time, self.file.grid.interval.map(|interval| interval * self.factors.time))
    }

    /// Whether values that are possible but not plausible are taken.
    pub fn trusts(&self) -> bool {
        self.file.trust
    }

    /// The case that says what the fields are of, and how they are to be filtered: the map's own
    /// sections, then those of the case it names, then those of the case that made the fields.
    /// `interval` is the time between instants \[s\].
    ///
    /// # Errors
    /// Those of a case file.
    pub fn case(&self, first: &Resolved, interval: f64) -> Result<Case, CaseError> {
        let embedded = first.case.clone().map(|text| (text, first.path.display().to_string()));
        let own = SHARED.iter().zip([
            &self.file.powder,
            &self.file.gas,
            &self.file.physics,
            &self.file.filter,
            &self.file.run,
            &self.file.output,
        ]);
        let own: Vec<&str> = own.filter(|(_, t)| t.is_some()).map(|(name, _)| *name).collect();
        let StoredFields { cells, spacing, .. } = &first.fields;
        let (text, place) = match (&self.base, embedded) {
            // As it was in flight, to the last bit.
            (None, Some((text, place))) if own.is_empty() => {
                let case = Case::parse(&text, &place)?;
                if case.domain.cells == *cells {
                    return Ok(case);
                }
                (without_sections(&text, &["box"], false), place)
            }
            // How often that case was to be sampled is not how often these files were written.
            (Some((text, place)), _) if own.is_empty() => {
                (without_sections(text, &["box", "run", "output"], false), place.clone())
            }
            (Some((text, _)), _) => {
                let rest = [&own[..], &["box", "run", "output"]].concat();
                let rest = without_sections(text, &rest, false);
                (format!("{}\n{rest}", self.case_text), self.place.clone())
            }
            (None, Some((text, _))) => {
                let rest = without_sections(&text, &[&own[..], &["box"]].concat(), false);
                (format!("{}\n{rest}", self.case_text), self.place.clone())
            }
            (None, None) => (self.case_text.clone(), self.place.clone()),
        };
        let size = spacing.iter().zip(cells).map(|(h, n)| h * *n as f64).collect();
        Case::of_fields(&text, &place, size, cells.clone(), first.mean_solids_fraction(), interval)
    }

    /// The fields of the instant that `pieces` hold, at `time` \[s\].
    ///
    /// # Errors
    /// An array is missing, has another number of components or of cells, holds a number that is none
    /// or cannot be; or the grid is not known.
    pub fn resolve(&self, mut pieces: Vec<Piece>, time: f64) -> Result<Resolved, ResolvedError> {
        for (n, piece) in pieces.iter().enumerate() {
            for other in &pieces[..n] {
                let twice =
                    |array: &&super::Array| other.arrays.iter().any(|a| a.name == array.name);
                let alike = piece.particles == other.particles;
                if let Some(array) = piece.arrays.iter().find(twice).filter(|_| alike) {
                    return Err(ResolvedError::Pair {
                        path: other.path.clone(),
                        other: piece.path.clone(),
                        why: format!(
                            "both have {} at t = {time} s: give each run as a folder of its own",
                            array.name
                        ),
                    });
                }
            }
        }
        let (lattice, path) = self.lattice(&pieces)?;
        let first = |part: &dyn Fn(&Piece) -> bool| pieces.iter().position(part);
        let told = pieces.iter().find_map(|piece| piece.periodic);
        let hints = &self.file.grid;
        let axis = |name: &AxisName| *name as usize;
        let periodic = match (&hints.periodic, told) {
            (Some(names), _) => std::array::from_fn(|n| names.iter().any(|name| axis(name) == n)),
            (None, Some(told)) => told,
            (None, None) => {
                return Err(ResolvedError::format(
                    &path,
                    "it does not say along which axes the box repeats itself: give [grid] periodic \
                     = [\"x\", \"y\"] or such in the map, [] where walls are all around",
                ));
            }
        };
        let axes = self.axes(&pieces, &lattice, &path)?;
        if let Some(place) = first(&|piece| piece.particles) {
            let particles = pieces.remove(place);
            pieces.push(self.deposit(&particles, &lattice, periodic)?);
        }
        let finder =
            Finder { pieces: &pieces, lattice: Some(&lattice), len: lattice.len(), path: &path };
        let vector =
            |columns: Columns, label: &str| pick_axes(columns, &axes, &lattice, &path, label);
        let f = &self.factors;
        let cells: Vec<usize> = axes.iter().map(|axis| lattice.cells[*axis]).collect();
        let spacing = axes.iter().map(|axis| lattice.spacing[*axis] * f.length).collect();
        let mut fields =
            StoredFields::new(cells, spacing, axes.iter().map(|axis| periodic[*axis]).collect());
        fields.time = time;
        for sought in &self.sought {
            let needed =
                ["solids_fraction", "solids_velocity", "gas_velocity"].contains(&sought.key);
            let Some((mut columns, label)) = finder.find(sought, needed, &self.place)? else {
                continue;
            };
            let (components, factor) = match sought.key {
                "solids_velocity" | "gas_velocity" => (axes.len(), f.velocity),
                "pressure_gradient" | "drag" => (axes.len(), f.pressure / f.length),
                "number_density" | "contact_density" => (1, f.length.powi(-3)),
                "pressure" | "solids_pressure" => (1, f.pressure),
                "solids_stress" => (6, f.pressure),
                "granular_temperature" => (1, f.velocity * f.velocity),
                _ => (1, 1.0),
            };
            if components == 1 && columns.len() != 1 {
                let count = columns.len();
                let why = format!(
                    "it has {count} components and a scalar is needed for {}: take one, {label}[0]",
                    sought.key
                );
                return Err(ResolvedError::array(&path, &label, why));
            }
            if factor != 1.0 {
                columns.iter_mut().flatten().for_each(|value| *value *= factor);
            }
            if sought.key == "solids_fraction" {
                check_fraction(&mut columns[0], &lattice, &finder, &label)?;
            }
            match sought.key {
                "solids_fraction" => {
                    fields.solids_fraction = transpose(&columns[0], &axes, &lattice)
                }
                "solids_velocity" => fields.solids_velocity = vector(columns, &label)?,
                "gas_velocity" => fields.gas_velocity = vector(columns, &label)?,
                "pressure_gradient" => {
                    fields.pressure = Some(Pressure::Gradient(vector(columns, &label)?));
                }
                "pressure" if fields.pressure.is_none() => {
                    fields.pressure =
                        Some(Pressure::Field(transpose(&columns[0], &axes, &lattice)));
                }
                "drag_coefficient" => {
                    check_sign(&columns[0], &lattice, &finder, &label)?;
                    fields.drag_coefficient = Some(transpose(&columns[0], &axes, &lattice));
                }
                "drag" => fields.drag = Some(vector(columns, &label)?),
                "number_density" => {
                    check_sign(&columns[0], &lattice, &finder, &label)?;
                    fields.number_density = Some(transpose(&columns[0], &axes, &lattice));
                }
                "contact_density" => {
                    check_sign(&columns[0], &lattice, &finder, &label)?;
                    fields.contact_density = Some(transpose(&columns[0], &axes, &lattice));
                }
                "granular_temperature" => {
                    check_sign(&columns[0], &lattice, &finder, &label)?;
                    fields.granular_temperature = Some(transpose(&columns[0], &axes, &lattice));
                }
                "solids_pressure" => {
                    fields.solids_pressure = Some(transpose(&columns[0], &axes, &lattice));
                }
                "solids_stress" => {
                    fields.solids_stress = Some(tensor(columns, &axes, &lattice, &path, &label)?)
                }
                _ => {}
            }
        }
        let case = pieces.iter_mut().find_map(|piece| piece.case.take());
        let signals = pieces.iter().find_map(|piece| piece.signals);
        Ok(Resolved { path, fields, case, signals })
    }

    /// p from OpenFOAM's p_rgh, which is p less (φ ρ_s + (1-φ) ρ_g) g·x: what has to be added, and to
    /// what, needs the densities of `case`. Nothing is done where another pressure is there.
    ///
    /// # Errors
    /// The array is not acceptable.
    pub fn add_weight(
        &self,
        resolved: &mut Resolved,
        pieces: &[Piece],
        case: &Case,
    ) -> Result<(), ResolvedError> {
        if resolved.fields.pressure.is_some() {
            return Ok(());
        }
        let Some(piece) =
            pieces.iter().find(|piece| piece.arrays.iter().any(|a| a.name == "p_rgh"))
        else {
            return Ok(());
        };
        let Some(lattice) = piece.lattice else { return Ok(()) };
        let finder =
            Finder { pieces, lattice: Some(&lattice), len: lattice.len(), path: &piece.path };
        let sought = Sought {
            section: "fields",
            key: "pressure",
            given: true,
            choices: vec![vec![Expression::parse("p_rgh").expect("a name is a formula")]],
        };
        let Some((columns, _)) = finder.find(&sought, true, &self.place)? else { return Ok(()) };
        let axes = self.axes(pieces, &lattice, &piece.path)?;
        let mut pressure = transpose(&columns[0], &axes, &lattice);
        if let Some(gravity) = piece.gravity {
            let centre: Columns =
                (0..3).map(|axis| transpose(&centres(&lattice, axis), &axes, &lattice)).collect();
            for (n, pressure) in pressure.iter_mut().enumerate() {
                let phi = resolved.fields.solids_fraction[n];
                let density = phi * case.powder.density + (1.0 - phi) * case.gas.density;
                let height: f64 = (0..3).map(|a| gravity[a] * centre[a][n]).sum();
                *pressure += density * height * self.factors.length;
            }
        }
        resolved.fields.pressure = Some(Pressure::Field(pressure));
        Ok(())
    }

    /// The lattice that the pieces share, in the files' unit, and the file it is from.
    fn lattice(&self, pieces: &[Piece]) -> Result<(Lattice, PathBuf), ResolvedError> {
        let hints = &self.file.grid;
        let path = pieces.first().map_or_else(PathBuf::new, |piece| piece.path.clone());
        let triple = |key: &str, list: &[f64], rest: f64| match *list {
            [x, y] => Ok([x, y, rest]),
            [x, y, z] => Ok([x, y, z]),
            _ => Err(self.refuse(format!(
                "[grid] {key}: {} numbers; two or three are accepted, along x, y and z",
                list.len()
            ))),
        };
        let mut found: Option<(Lattice, PathBuf)> = None;
        for piece in pieces {
            let Some(mut lattice) = piece.lattice else { continue };
            if !piece.sized {
                let Some(size) = &hints.size else {
                    return Err(ResolvedError::format(
                        &piece.path,
                        "it does not say how large the box is: give [grid] size = [...] in the \
                         map, the edges along x, y and z",
                    ));
                };
                let size = triple("size", size, 1.0)?;
                lattice.spacing = std::array::from_fn(|a| size[a] / lattice.cells[a] as f64);
            } else if let Some(size) = &hints.size {
                let size = triple("size", size, f64::NAN)?;
                for axis in (0..3).filter(|axis| lattice.cells[*axis] > 1) {
                    let edge = lattice.spacing[axis] * lattice.cells[axis] as f64;
                    if (size[axis] / edge - 1.0).abs() > 1e-6 {
                        return Err(self.refuse(format!(
                            "[grid] size gives {} along {} and {} has {edge}: leave size out where \
                             files tell",
                            size[axis],
                            AXES[axis],
                            piece.path.display()
                        )));
                    }
                }
            }
            match &found {
                Some((other, path)) if !same(other, &lattice) => {
                    return Err(ResolvedError::Pair {
                        path: path.clone(),
                        other: piece.path.clone(),
                        why: format!(
                            "their grids differ, {:?} cells of {:?} and {:?} of {:?}: fields of one \
                             grid are accepted",
                            other.cells, other.spacing, lattice.cells, lattice.spacing
                        ),
                    });
                }
                Some(_) => {}
                None => found = Some((lattice, piece.path.clone())),
            }
        }
        let lattice = match found {
            Some(found) => found,
            None => {
                let (Some(size), Some(cells)) = (&hints.size, &hints.cells) else {
                    return Err(ResolvedError::format(
                        &path,
                        "it has no grid: give [grid] size and cells in the map, or a file with the \
                         gas's fields on a grid as well",
                    ));
                };
                let size = triple("size", size, 1.0)?;
                let cells = match cells[..] {
                    [x, y] => [x, y, 1],
                    [x, y, z] => [x, y, z],
                    _ => return Err(self.refuse("[grid] cells: two or three numbers are accepted")),
                };
                let origin = triple("origin", hints.origin.as_deref().unwrap_or(&[0.0; 3]), 0.0)?;
                let spacing = std::array::from_fn(|a| size[a] / cells[a] as f64);
                (Lattice { cells, spacing, origin }, path)
            }
        };
        let (found, _) = &lattice;
        let flat = found.cells.iter().filter(|cells| **cells == 1).count();
        if flat > 1 || found.is_empty() {
            return Err(ResolvedError::format(
                &lattice.1,
                format!(
                    "it has {:?} cells: fields in two or three dimensions are accepted",
                    found.cells
                ),
            ));
        }
        if let Some(axis) = (0..3).find(|a| found.spacing[*a].is_nan() || found.spacing[*a] <= 0.0)
        {
            let why = format!("its cells are {} long along {}", found.spacing[axis], AXES[axis]);
            return Err(ResolvedError::format(&lattice.1, why));
        }
        Ok(lattice)
    }

    /// The file's axis for each of the crate's: the last one is vertical.
    fn axes(
        &self,
        pieces: &[Piece],
        lattice: &Lattice,
        path: &Path,
    ) -> Result<Vec<usize>, ResolvedError> {
        let told = pieces.iter().find_map(|piece| piece.vertical);
        let named = self.file.grid.vertical.map(|axis| axis as usize);
        let wide: Vec<usize> = (0..3).filter(|axis| lattice.cells[*axis] > 1).collect();
        let vertical = match (named.or(told), wide.len()) {
            (Some(vertical), _) if wide.contains(&vertical) => vertical,
            (Some(vertical), _) => {
                return Err(ResolvedError::format(
                    path,
                    format!(
                        "{} is to be vertical and has one cell: give another axis as [grid] \
                         vertical in the map",
                        AXES[vertical]
                    ),
                ));
            }
            (None, 2) => wide[1],
            (None, _) => {
                return Err(ResolvedError::format(
                    path,
                    "it does not say which axis is vertical: give [grid] vertical = \"y\" or such \
                     in the map",
                ));
            }
        };
        Ok(match wide.len() {
            2 => vec![wide[usize::from(wide[0] == vertical)], vertical],
            // In this order a right-handed frame stays one.
            _ => vec![(vertical + 1) % 3, (vertical + 2) % 3, vertical],
        })
    }

    /// The fields of particles, as if a file had them.
    fn deposit(
        &self,
        particles: &Piece,
        lattice: &Lattice,
        periodic: [bool; 3],
    ) -> Result<Piece, ResolvedError> {
        let path = &particles.path;
        let count = particles.arrays.first().map_or(0, |array| array.columns[0].len());
        let pieces = std::slice::from_ref(particles);
        let finder = Finder { pieces, lattice: None, len: count, path };
        let find = |n: usize| {
            let found = finder.find(&self.particles[n], true, &self.place)?;
            found.ok_or_else(|| ResolvedError::format(path, "it has no particles"))
        };
        let vector = |(mut columns, label): (Columns, String)| match columns.len() {
            2 => {
                columns.push(vec![0.0; count]);
                Ok(columns)
            }
            3 => Ok(columns),
            n => {
                let why = format!("it has {n} components and 2 or 3 are needed");
                Err(ResolvedError::array(path, &label, why))
            }
        };
        let hints = &self.file.particles;
        if lattice.cells.contains(&1) && hints.thickness.is_none() {
            return Err(self.refuse(
                "[particles] thickness is missing: in two dimensions the solids fraction is the \
                 particles' volume in a slice of that thickness",
            ));
        }
        let table = Particles {
            position: vector(find(0)?)?,
            velocity: vector(find(1)?)?,
            diameter: find(2)?.0.swap_remove(0),
        };
        let [fraction, velocity, temperature] =
            deposit(path, &table, lattice, periodic, hints.thickness, hints.kernel)?;
        let array =
            |name: &str, columns| super::Array { name: name.into(), columns, dimensions: None };
        Ok(Piece {
            path: path.clone(),
            arrays: vec![
                array("solids_fraction", fraction),
                array("solids_velocity", velocity),
                array("granular_temperature", temperature),
            ],
            ..Piece::default()
        })
    }

    fn refuse(&self, why: impl Into<String>) -> ResolvedError {
        ResolvedError::Map { place: self.place.clone(), why: why.into() }
    }
}

fn same(a: &Lattice, b: &Lattice) -> bool {
    let near = |a: f64, b: f64, h: f64| (a - b).abs() <= 1e-4 * h;
    a.cells == b.cells
        && (0..3).filter(|axis| a.cells[*axis] > 1).all(|axis| {
            near(a.spacing[axis], b.spacing[axis], a.spacing[axis])
                && near(a.origin[axis], b.origin[axis], a.spacing[axis])
        })
}

/// Centres of the cells along `axis`.
fn centres(lattice: &Lattice, axis: usize) -> Vec<f64> {
    let at = |place: usize| lattice.origin[axis] + (place as f64 + 0.5) * lattice.spacing[axis];
    (0..lattice.len()).map(|n| at(lattice.cell(n)[axis])).collect()
}

/// Looks for formulae among the arrays of pieces.
struct Finder<'a> {
    pieces: &'a [Piece],
    lattice: Option<&'a Lattice>,
    len: usize,
    path: &'a Path,
}

impl Finder<'_> {
    /// The array of a name, and the file it is in.
    fn array(&self, name: &str) -> Option<(&super::Array, &Path)> {
        let all = || {
            let arrays = |piece: &'_ Piece| piece.arrays.len();
            self.pieces.iter().filter(move |piece| arrays(piece) > 0)
        };
        let exact = all().find_map(|piece| {
            let array = piece.arrays.iter().find(|array| array.name == name)?;
            Some((array, piece.path.as_path()))
        });
        exact.or_else(|| {
            all().find_map(|piece| {
                let like = |array: &&super::Array| array.name.eq_ignore_ascii_case(name);
                Some((piece.arrays.iter().find(like)?, piece.path.as_path()))
            })
        })
    }

    /// The value of the first choice of which all arrays are there, checked, and its name for
    /// messages; none if nothing is and it is not `needed`.
    fn find(
        &self,
        sought: &Sought,
        needed: bool,
        map: &str,
    ) -> Result<Option<(Columns, String)>, ResolvedError> {
        let coordinate =
            |name: &str| self.lattice.and_then(|_| AXES.iter().position(|axis| *axis == name));
        let there = |name: &str| self.array(name).is_some() || coordinate(name).is_some();
        let choice = sought
            .choices
            .iter()
            .find(|choice| sought.given || choice.iter().flat_map(Expression::names).all(there));
        let Some(choice) = choice else {
            // An array that is there and cannot be used is worth a word even where none is needed.
            let hindered =
                sought.choices.iter().flatten().flat_map(Expression::names).find_map(|name| {
                    let (path, why) = self.hindrance(name)?;
                    Some(ResolvedError::array(path, name, why))
                });
            if let Some(error) = hindered {
                return Err(error);
            }
            if !needed {
                return Ok(None);
            }
            let tried: Vec<String> = sought
                .choices
                .iter()
                .map(|choice| choice.iter().map(Expression::text).collect::<Vec<_>>().join(" "))
                .collect();
            return Err(ResolvedError::format(
                self.path,
                format!(
                    "no array for {key}: name it in the map, [{section}] {key} = \"...\"; looked for \
                     {}; there {}",
                    tried.join(", "),
                    self.available(),
                    key = sought.key,
                    section = sought.section
                ),
            ));
        };
        let label = choice.iter().map(Expression::text).collect::<Vec<_>>().join(", ");
        let mut columns = Columns::new();
        for formula in choice {
            if let Some(name) = formula.names().into_iter().find(|name| !there(name)) {
                if let Some((path, why)) = self.hindrance(name) {
                    return Err(ResolvedError::array(path, name, why));
                }
                return Err(ResolvedError::format(
                    self.path,
                    format!(
                        "no array {name}, which {map} names for {}; there {}",
                        sought.key,
                        self.available()
                    ),
                ));
            }
            let find = |name: &str| match (self.array(name), coordinate(name), self.lattice) {
                (Some((array, _)), ..) => {
                    match array.columns.iter().find(|c| c.len() != self.len) {
                        None => Ok(array.columns.clone()),
                        Some(column) => Err(format!(
                            "it has {} values and {} are needed, one per cell",
                            column.len(),
                            self.len
                        )),
                    }
                }
                (None, Some(axis), Some(lattice)) => Ok(vec![centres(lattice, axis)]),
                _ => Err(format!("no array {name}")),
            };
            let found = formula.evaluate(self.len, &find);
            let path = self.path_of(formula);
            let mut found = found.map_err(|why| ResolvedError::array(path, formula.text(), why))?;
            if choice.len() > 1 && found.len() != 1 {
                let why = format!(
                    "it has {} components and one is needed for each entry of {}",
                    found.len(),
                    sought.key
                );
                return Err(ResolvedError::array(path, formula.text(), why));
            }
            if let Some((array, _)) = formula.name().and_then(|name| self.array(name))
                && let Some(dimensions) = array.dimensions
            {
                check_dimensions(sought.key, dimensions)
                    .map_err(|why| ResolvedError::array(path, &array.name, why))?;
            }
            for (component, column) in found.iter().enumerate() {
                if let Some(n) = column.iter().position(|value| !value.is_finite()) {
                    let part = if found.len() > 1 {
                        format!(" component {component}")
                    } else {
                        String::new()
                    };
                    let array = format!("{}{part}", formula.text());
                    let why = "a finite number is needed everywhere: was the file written by a run \
                        that failed, or masked?";
                    return Err(self.value(path, &array, n, column[n], why));
                }
            }
            columns.append(&mut found);
        }
        Ok(Some((columns, label)))
    }

    fn value(&self, path: &Path, array: &str, n: usize, value: f64, why: &str) -> ResolvedError {
        match self.lattice {
            Some(lattice) => ResolvedError::Value {
                path: path.to_owned(),
                array: array.to_owned(),
                cell: lattice.cell(n),
                value,
                why: why.to_owned(),
            },
            None => {
                let why = format!("{value} for particle {n}, counted from 0: {why}");
                ResolvedError::array(path, array, why)
            }
        }
    }

    /// The file of a formula's first array.
    fn path_of(&self, formula: &Expression) -> &Path {
        let mut names = formula.names().into_iter();
        names.find_map(|name| self.array(name)).map_or(self.path, |(_, path)| path)
    }

    fn hindrance(&self, name: &str) -> Option<(&Path, &'static str)> {
        self.pieces.iter().find_map(|piece| {
            let found = piece.others.iter().find(|(other, why)| other == name && why.is_some());
            found.and_then(|(_, why)| Some((piece.path.as_path(), (*why)?)))
        })
    }

    fn available(&self) -> String {
        let mut names: Vec<String> = Vec::new();
        for piece in self.pieces {
            names.extend(piece.arrays.iter().map(|array| array.name.clone()));
            names.extend(piece.others.iter().map(|(name, _)| name.clone()));
        }
        match names.len() {
            0 => "is none".into(),
            1 => format!("is {}", names[0]),
            _ => format!("are {}", names.join(", ")),
        }
    }
}

/// Whether OpenFOAM's dimensions of an array are those of what it is to be.
fn check_dimensions(key: &str, found: [f64; 7]) -> Result<(), String> {
    // kg, m, s; the others are zero.
    let (expected, unit) = match key {
        "solids_fraction" => ([0.0, 0.0, 0.0], "a number"),
        "solids_velocity" | "gas_velocity" => ([0.0, 1.0, -1.0], "m/s"),
        "pressure" | "solids_pressure" | "solids_stress" => ([1.0, -1.0, -2.0], "Pa"),
        "pressure_gradient" | "drag" => ([1.0, -2.0, -2.0], "Pa/m"),
        "number_density" | "contact_density" => ([0.0, -3.0, 0.0], "1/m³"),
        "drag_coefficient" => ([1.0, -3.0, -1.0], "kg/m³/s"),
        "granular_temperature" => ([0.0, 2.0, -2.0], "m²/s²"),
        _ => return Ok(()),
    };
    if found[..3] == expected && found[3..].iter().all(|exponent| *exponent == 0.0) {
        return Ok(());
    }
    let kinematic = key == "pressure" && found[..3] == [0.0, 2.0, -2.0];
    let hint = if kinematic {
        "it is pressure over density: multiply by the gas's density in the map, pressure = \"1.2 * p\""
    } else {
        "give another array, or a formula, in the map"
    };
    Err(format!("its dimensions are {found:?} and {key} is in {unit}: {hint}"))
}

/// Takes traces below zero off, and refuses what is no solids fraction.
fn check_fraction(
    column: &mut [f64],
    lattice: &Lattice,
    finder: &Finder,
    label: &str,
) -> Result<(), ResolvedError> {
    let (mut low, mut high) = (0, 0);
    for (n, value) in column.iter().enumerate() {
        low = if *value < column[low] { n } else { low };
        high = if *value > column[high] { n } else { high };
    }
    let refuse = |n: usize, why: &str| {
        Err(ResolvedError::Value {
            path: finder.path.to_owned(),
            array: label.to_owned(),
            cell: lattice.cell(n),
            value: column[n],
            why: why.to_owned(),
        })
    };
    let (least, most) = (column[low], column[high]);
    if most > DENSEST {
        let why = if most <= 1.0 + UNDERSHOOT && least >= 0.2 {
            "spheres do not pack denser than 0.74: is it the gas's fraction? Then give \"1 - ...\" \
             in the map, [fields] solids_fraction"
        } else if most <= 100.0 && least >= 0.0 && most > 1.0 + UNDERSHOOT {
            "a fraction is at most 0.74: is it in percent? Then give \"0.01 * ...\" in the map, \
             [fields] solids_fraction"
        } else {
            "spheres do not pack denser than 0.74: is it the gas's fraction, or a density? Then \
             give a formula such as \"1 - ...\" in the map, [fields] solids_fraction"
        };
        return refuse(high, why);
    }
    if least < -UNDERSHOOT {
        return refuse(low, "a solids fraction is not negative; give a formula in the map");
    }
    for value in column.iter_mut().filter(|value| **value < 0.0) {
        *value = 0.0;
    }
    Ok(())
}

fn check_sign(
    column: &[f64],
    lattice: &Lattice,
    finder: &Finder,
    label: &str,
) -> Result<(), ResolvedError> {
    match column.iter().position(|value| *value < 0.0) {
        None => Ok(()),
        Some(n) => Err(ResolvedError::Value {
            path: finder.path.to_owned(),
            array: label.to_owned(),
            cell: lattice.cell(n),
            value: column[n],
            why: "it cannot be negative".into(),
        }),
    }
}

/// A vector along x, y and z, or along the two axes that are not flat, along `axes`.
fn pick_axes(
    columns: Columns,
    axes: &[usize],
    lattice: &Lattice,
    path: &Path,
    label: &str,
) -> Result<Columns, ResolvedError> {
    let mut sorted = axes.to_vec();
    sorted.sort_unstable();
    let place = |axis: usize| match columns.len() {
        3 => Some(axis),
        count if count == axes.len() => sorted.iter().position(|other| *other == axis),
        _ => None,
    };
    axes.iter()
        .map(|axis| place(*axis).map(|place| transpose(&columns[place], axes, lattice)))
        .collect::<Option<_>>()
        .ok_or_else(|| {
            let (found, needed) = (columns.len(), axes.len());
            let why = format!(
                "it has {found} component{} and {needed} are needed, one for each axis",
                if found == 1 { "" } else { "s" }
            );
            ResolvedError::array(path, label, why)
        })
}

/// A symmetric tensor in VTK's order along `axes`, in the crate's order.
fn tensor(
    columns: Columns,
    axes: &[usize],
    lattice: &Lattice,
    path: &Path,
    label: &str,
) -> Result<Columns, ResolvedError> {
    if columns.len() != 6 {
        let why =
            format!("it has {} components and 6 are needed: xx, yy, zz, xy, yz, xz", columns.len());
        return Err(ResolvedError::array(path, label, why));
    }
    let mut found = Columns::new();
    for j in 0..axes.len() {
        for i in 0..=j {
            found.push(transpose(&columns[vtk_index(axes[i], axes[j])], axes, lattice));
        }
    }
    Ok(found)
}

/// Place of component (i, j) of a symmetric tensor in VTK's order.
pub(crate) fn vtk_index(i: usize, j: usize) -> usize {
    match (i.min(j), i.max(j)) {
        (a, b) if a == b => a,
        (0, 1) => 3,
        (1, 2) => 4,
        _ => 5,
    }
}

/// Values with x fastest, with the first of `axes` fastest.
fn transpose(column: &[f64], axes: &[usize], lattice: &Lattice) -> Vec<f64> {
    if axes.is_sorted() {
        return column.to_vec();
    }
    let strides = [1, lattice.cells[0], lattice.cells[0] * lattice.cells[1]];
    let (count, step) = (
        axes.iter().map(|axis| lattice.cells[*axis]).collect::<Vec<_>>(),
        axes.iter().map(|axis| strides[*axis]).collect::<Vec<_>>(),
    );
    let layers = count.get(2).copied().unwrap_or(1);
    let mut values = Vec::with_capacity(column.len());
    for k in 0..layers {
        for j in 0..count[1] {
            let row = j * step[1] + k * step.get(2).copied().unwrap_or(0);
            values.extend((0..count[0]).map(|i| column[row + i * step[0]]));
        }
    }
    values
}

/// `text` with the lines of `sections` empty, and with `top` also those before any section: so that
/// lines keep their numbers.
fn without_sections(text: &str, sections: &[&str], top: bool) -> String {
    let mut drop = top;
    let mut kept = String::new();
    for line in text.lines() {
        let header = line.split('#').next().unwrap_or_default().trim();
        if let Some(name) = header.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            let name = name.trim();
            // A line of a list is not a header.
            if OWN.contains(&name) || SHARED.contains(&name) || name == "box" {
                drop = sections.contains(&name);
            }
        }
        if !drop {
            kept.push_str(line);
        }
        kept.push('\n');
    }
    kept
}
