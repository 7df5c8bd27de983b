//! Closures in the languages of other programs: OpenFOAM, MFIX, Fluent, C, Fortran, tables, papers.
//!
//! Every export is made from a [`Closure`] alone by one generator ([`code`]) and one small
//! description per language. It carries the closure's name, ranges, source and the SHA-256 of its
//! file, treats points outside the ranges as [`Quantity::at`](crate::closure::Quantity::at) does, and
//! comes with what is needed to compare its test vectors. Text that does not depend on the closure
//! lies in files beside this module.
//!
//! Solvers take the product (1 - H) β, β being the fine-grid drag law that the closure corrects, and
//! with it the filtered solids viscosity and pressure where the closure has them. The markers are
//! scaled by the true terminal velocity u_t of the powder that is simulated.

pub mod c;
pub mod code;
pub mod fluent;
pub mod fortran;
pub mod mfix;
pub mod openfoam;
pub mod paper;
pub mod solver;
pub mod table;

use crate::closure::{Closure, Status};
use crate::expression::Meaning;
use crate::fit::ReferenceLength;
use crate::forms::{MARKERS, Marker};
use crate::model::Outside;
use crate::output::{Output, OutputError, RUN_FILE};
use code::{Code, Lowering, digits};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::fmt;
use std::io::Write;
use std::path::Path;
use thiserror::Error;

/// What a closure is exported to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A library with a drag model, and a filtered stress where the closure has one.
    OpenFoam,
    /// User routines for drag and stress.
    Mfix,
    /// User-defined functions.
    Fluent,
    /// A header.
    C,
    /// A module.
    Fortran,
    /// Values at regular points, as CSV, NumPy and VTK.
    Table,
    /// Equation and coefficients for a paper.
    Latex,
    /// The same for a page.
    Markdown,
}

/// All targets and their names.
pub const TARGETS: [(&str, Target); 8] = [
    ("openfoam", Target::OpenFoam),
    ("mfix", Target::Mfix),
    ("fluent", Target::Fluent),
    ("c", Target::C),
    ("fortran", Target::Fortran),
    ("table", Target::Table),
    ("latex", Target::Latex),
    ("markdown", Target::Markdown),
];

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (name, _) = TARGETS[*self as usize];
        f.write_str(name)
    }
}

/// Why a closure cannot be exported.
#[derive(Debug, Error)]
pub enum ExportError {
    /// There is no formula.
    #[error(
        "{closure} has no formula to export: {missing}; nearest: `--to markdown` says what is known"
    )]
    NoFormula {
        /// The closure.
        closure: String,
        /// What it lacks.
        missing: String,
    },
    /// A solver needs what the closure does not predict.
    #[error(
        "{closure} predicts {has}, and {target} takes drag_correction [-], solids_viscosity \
         [rho_s u_t^3/g] and solids_pressure [rho_s u_t^2]; nearest: `--to c`, to be called where you \
         need it"
    )]
    NothingForSolver {
        /// The closure.
        closure: String,
        /// The target.
        target: Target,
        /// What is predicted.
        has: String,
    },
    /// The target does not know a marker.
    #[error(
        "{quantity} of {closure} depends on {marker}, which {target} does not give where it asks for \
         {quantity}; nearest: `--to c`, with {marker} from code of your own"
    )]
    Marker {
        /// The closure.
        closure: String,
        /// The quantity.
        quantity: String,
        /// The marker.
        marker: Marker,
        /// The target.
        target: Target,
    },
    /// A table of more axes than there are in space.
    #[error(
        "{quantity} of {closure} depends on {count} markers, and a table has up to 3 axes; nearest: \
         `--to c`"
    )]
    TooManyAxes {
        /// The closure.
        closure: String,
        /// The quantity.
        quantity: String,
        /// Markers.
        count: usize,
    },
    /// The drag that is corrected is not known.
    #[error(
        "{closure} corrects the drag law \"{drag}\", and {target} can be given wen-yu, gidaspow, \
         beetstra, tenneti; nearest: `--to c` exports H alone"
    )]
    Drag {
        /// The closure.
        closure: String,
        /// The drag law as its file names it.
        drag: String,
        /// The target.
        target: Target,
    },
    /// A constant that no language can write.
    #[error("constant {name} of {closure} is {value}, and a finite number is needed")]
    Constant {
        /// The closure.
        closure: String,
        /// Its name.
        name: String,
        /// Its value.
        value: f64,
    },
    /// A formula that cannot be cut into routines; compiling it should have refused it.
    #[error("{closure}: {why}")]
    Formula {
        /// The closure.
        closure: String,
        /// Why.
        why: String,
    },
    /// The closure cannot be written as a file.
    #[error("{closure} cannot be written as TOML: {source}")]
    Inexpressible {
        /// The closure.
        closure: String,
        /// Why.
        source: toml::ser::Error,
    },
    /// The folder cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// A file of an export.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    /// Its path in the folder.
    pub path: String,
    /// What is in it.
    pub bytes: Vec<u8>,
}

impl Piece {
    /// A file of text.
    pub fn text(path: &str, text: impl Into<String>) -> Self {
        Self { path: path.into(), bytes: text.into().into_bytes() }
    }
}

/// The range of a marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// The marker.
    pub marker: Marker,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Range {
    /// The name of the marker in code.
    pub fn symbol(&self) -> &'static str {
        self.marker.symbol()
    }
}

/// A quantity with its code.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// What is predicted, as the closure names it.
    pub predicts: String,
    /// The same as a name in code.
    pub name: String,
    /// What it is scaled by.
    pub unit: String,
    /// The markers, in the order in which they are given.
    pub ranges: Vec<Range>,
    /// The routine of the formula.
    pub routine: String,
    /// The markers that the routine takes.
    pub inputs: Vec<String>,
    /// Points and values.
    pub vectors: Vec<(Vec<f64>, f64)>,
}

impl Quantity {
    /// A call of its routine; the markers are variables of their own names.
    pub fn call(&self) -> String {
        let symbols: Vec<&str> = self.ranges.iter().map(|range| range.symbol()).collect();
        format!("favre_{}({})", self.name, symbols.join(", "))
    }

    /// A line for each marker: symbol, meaning, range.
    pub fn range_lines(&self) -> Vec<String> {
        self.ranges
            .iter()
            .map(|range| {
                let (low, high) = (range.low, range.high);
                format!("{}: {}, {low} to {high}", range.symbol(), meaning(range.marker))
            })
            .collect()
    }
}

/// What a marker is, in plain characters.
pub fn meaning(marker: Marker) -> &'static str {
    match marker {
        Marker::SolidsFraction => "filtered solids fraction",
        Marker::FilterWidth => "filter width over the reference length",
        Marker::Slip => "filtered slip speed over u_t",
        Marker::ShearRate => {
            "shear rate of the filtered solids velocity, S u_t/g, S = sqrt(2 Sd:Sd)"
        }
        Marker::GasShearRate => {
            "shear rate of the filtered gas velocity, S u_t/g, S = sqrt(2 Sd:Sd)"
        }
        Marker::WallDistance => "distance from the wall times g/u_t^2",
        Marker::PressureGradient => "vertical filtered pressure gradient over rho_s g",
    }
}

/// What happens outside the ranges, as a sentence.
pub fn outside_line(outside: Outside) -> &'static str {
    match outside {
        Outside::Clamp => "Outside its range a marker is moved to the nearest end.",
        Outside::Formula => "Outside the ranges the formula is taken as it stands.",
    }
}

/// The reference length as a formula of u_t, g and d.
pub fn length_line(length: ReferenceLength) -> &'static str {
    match length {
        ReferenceLength::One => "L_I = u_t^2/g",
        ReferenceLength::Two => "L_II = d (u_t^2/(g d))^(1/3)",
    }
}

/// What all targets say of a closure, and its code.
#[derive(Clone, Debug)]
pub struct Facts<'a> {
    /// The closure.
    pub closure: &'a Closure,
    /// Its name.
    pub name: String,
    /// Its file.
    pub toml: String,
    /// SHA-256 of its file, in hexadecimal.
    pub hash: String,
    /// Publication or run.
    pub reference: String,
    /// What to know, for the head of a file.
    pub about: Vec<String>,
    /// The same for a README.
    pub readme: String,
    /// What happens outside the ranges.
    pub outside: Outside,
    /// The code of all quantities, and of the base drag where that is known.
    pub code: Code,
    /// The quantities.
    pub quantities: Vec<Quantity>,
    /// The routine of the drag law that is corrected, of `phi` and `Re`: β d²/(φ μ_g).
    pub base: Option<String>,
}

impl<'a> Facts<'a> {
    /// The README of routines that belong to no solver.
    pub fn readme_of_routines(&self, template: &str) -> Piece {
        let texts = [
            ("name", &*self.name),
            ("facts", &*self.readme),
            ("call", &*self.quantities[0].call()),
        ];
        Piece::text("README.md", fill(template, &texts))
    }

    /// The facts of `closure`; `for_solver`: with the drag law that it corrects.
    ///
    /// # Errors
    /// A constant or a formula that cannot be written.
    pub fn new(closure: &'a Closure, for_solver: bool) -> Result<Self, ExportError> {
        let file = &closure.file;
        let name = || file.name.clone();
        let toml = toml::to_string_pretty(file)
            .map_err(|source| ExportError::Inexpressible { closure: name(), source })?;
        let hash: String =
            Sha256::digest(toml.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        if let Some((constant, value)) = file.constants.iter().find(|(_, x)| !x.is_finite()) {
            let (name, value) = (constant.clone(), *value);
            return Err(ExportError::Constant { closure: file.name.clone(), name, value });
        }
        // Markers by number; the Reynolds number, which only a drag law has, after them.
        let mut inputs: Vec<&str> = MARKERS.iter().map(|(_, _, symbol)| *symbol).collect();
        inputs.push("Re");
        let known = |name: &str| {
            if let Some(marker) = Marker::of_symbol(name) {
                return Some(Meaning::Input(marker as usize));
            }
            if name == solver::REYNOLDS {
                return Some(Meaning::Input(MARKERS.len()));
            }
            let constant = file.constants.get(name).map(|value| Meaning::Constant(*value));
            constant.or_else(|| closure.formula(name).map(Meaning::Formula))
        };
        let mut lowering = Lowering::new(&inputs, &known);
        let formula = |why| ExportError::Formula { closure: file.name.clone(), why };
        let mut numbers = Vec::new();
        for quantity in &closure.quantities {
            numbers
                .push(lowering.add(&quantity.file.predicts, &quantity.formula).map_err(formula)?);
        }
        let base = solver::base_drag(&file.definitions.drag).filter(|_| for_solver);
        let base = base.map(|law| lowering.add("base_drag", &law).map_err(formula)).transpose()?;
        let code = lowering.finish();
        let quantities = closure
            .quantities
            .iter()
            .zip(numbers)
            .map(|(quantity, at)| {
                let ranges = quantity.file.ranges.iter().map(|range| Range {
                    marker: range.marker,
                    low: range.low,
                    high: range.high,
                });
                let vectors = quantity
                    .file
                    .test_vectors
                    .iter()
                    .map(|vector| (quantity.point(vector), vector.expected));
                Quantity {
                    predicts: quantity.file.predicts.clone(),
                    name: plain(&quantity.file.predicts),
                    unit: quantity.file.unit.clone(),
                    ranges: ranges.collect(),
                    routine: code.routines[at].name.clone(),
                    inputs: code.routines[at].inputs.clone(),
                    vectors: vectors.collect(),
                }
            })
            .collect();
        let mut facts = Self {
            closure,
            name: file.name.clone(),
            toml,
            hash,
            reference: file.source.reference.clone(),
            about: Vec::new(),
            readme: String::new(),
            outside: file.outside,
            base: base.map(|at| code.routines[at].name.clone()),
            code,
            quantities,
        };
        facts.describe();
        Ok(facts)
    }

    fn describe(&mut self) {
        let file = &self.closure.file;
        let mut about = vec![
            format!("{}: {}", file.name, file.title),
            format!("Source: {}", file.source.reference),
            format!("Read from: {}", file.source.read_from),
        ];
        if file.status == Status::Partial {
            about.push(format!("Partial: {}", file.missing.join(" ")));
        }
        about.push(format!("SHA-256 of the closure's file, closure.toml: {}", self.hash));
        about.push(format!(
            "Written by favre {} from that file alone; change that, not this.",
            env!("CARGO_PKG_VERSION")
        ));
        about.push(format!("Reference length: {}", length_line(file.reference_length)));
        about.push(format!("u_t: {}", file.definitions.terminal_velocity));
        about.push(format!("Filter width: {}", file.definitions.filter_width));
        if self.quantities.iter().any(|quantity| quantity.predicts == "drag_correction") {
            about.push(format!("Drag: {}", file.definitions.drag_correction));
            about.push(format!("Drag law that is corrected: {}", file.definitions.drag));
        }
        about.extend(file.notes.iter().map(|note| format!("Note: {note}")));
        let mut readme = format!(
            "- Closure: {}: {}.\n- Source: {}.\n",
            file.name, file.title, file.source.reference
        );
        if file.status == Status::Partial {
            readme += &format!("- Partial: {}\n", file.missing.join(" "));
        }
        for quantity in &self.quantities {
            let (predicts, unit) = (&quantity.predicts, &quantity.unit);
            readme +=
                &format!("- `{predicts}` \\[{unit}\\]: {}.\n", quantity.range_lines().join("; "));
        }
        readme += &format!(
            "- {} Reference length {}; u_t is the {}.\n- SHA-256 of `closure.toml`: `{}`; favre {}.\n",
            outside_line(file.outside),
            length_line(file.reference_length),
            file.definitions.terminal_velocity,
            self.hash,
            env!("CARGO_PKG_VERSION")
        );
        (self.about, self.readme) = (about, readme);
    }

    /// The quantity of this name.
    pub fn quantity(&self, predicts: &str) -> Option<&Quantity> {
        self.quantities.iter().find(|quantity| quantity.predicts == predicts)
    }
}

/// A name in code.
fn plain(name: &str) -> String {
    name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).take(40).collect()
}

/// `template` with `{{key}}` replaced by its text.
///
/// # Panics
/// A key of the template has no text: templates and their keys are of this crate.
pub fn fill(template: &str, texts: &[(&str, &str)]) -> String {
    let mut out = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        let (key, after) = after.split_once("}}").expect("a key is closed");
        let (_, text) = texts
            .iter()
            .find(|(known, _)| *known == key)
            .unwrap_or_else(|| panic!("the template's {key} has no text"));
        out += before;
        out += text;
        rest = after;
    }
    out + rest
}

/// What an export holds, as its run.json.
#[derive(Debug, Serialize)]
struct Contents<'a> {
    closure: &'a str,
    target: String,
    source: &'a str,
    sha256: &'a str,
    favre: &'static str,
    files: Vec<&'a str>,
}

/// The files of `closure` for `target`, its own file among them.
///
/// # Errors
/// [`ExportError`]: what the target cannot be given, and the nearest that it can.
pub fn export(closure: &Closure, target: Target) -> Result<Vec<Piece>, ExportError> {
    let for_solver = matches!(target, Target::OpenFoam | Target::Mfix | Target::Fluent);
    let facts = Facts::new(closure, for_solver)?;
    if facts.quantities.is_empty() && target != Target::Markdown {
        let (closure, missing) = (facts.name.clone(), closure.file.missing.join(" "));
        return Err(ExportError::NoFormula { closure, missing });
    }
    let mut pieces = match target {
        Target::OpenFoam => openfoam::export(&solver::Solver::new(&facts, target)?),
        Target::Mfix => mfix::export(&solver::Solver::new(&facts, target)?),
        Target::Fluent => fluent::export(&solver::Solver::new(&facts, target)?),
        Target::C => c::export(&facts),
        Target::Fortran => fortran::export(&facts),
        Target::Table => table::export(&facts)?,
        Target::Latex => paper::latex(&facts),
        Target::Markdown => paper::markdown(&facts),
    };
    pieces.push(Piece::text("closure.toml", facts.toml.clone()));
    let contents = Contents {
        closure: &facts.name,
        target: target.to_string(),
        source: &facts.reference,
        sha256: &facts.hash,
        favre: env!("CARGO_PKG_VERSION"),
        files: pieces.iter().map(|piece| &*piece.path).collect(),
    };
    let contents = serde_json::to_string_pretty(&contents).expect("text is JSON") + "\n";
    pieces.push(Piece::text(RUN_FILE, contents));
    Ok(pieces)
}

/// Writes the files of an export into `output`.
///
/// # Errors
/// A file or a folder cannot be written.
pub fn write(pieces: &[Piece], output: &Output) -> Result<(), ExportError> {
    for piece in pieces {
        let path = Path::new(&piece.path);
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            let dir = output.dir().join(folder);
            std::fs::create_dir_all(output.partial().join(folder))
                .map_err(|source| OutputError::Folder { dir, source })?;
        }
        output.write(&piece.path, |file| file.write_all(&piece.bytes))?;
    }
    Ok(())
}

/// A number for a person: its shortest digits.
fn short(value: f64) -> String {
    let digits = digits(value);
    digits.strip_suffix(".0").map(str::to_owned).unwrap_or(digits)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closure::BUILT_IN;

    #[test]
    fn every_closure_goes_to_every_target_or_is_refused_with_what_is_nearest() {
        let mut refused = Vec::new();
        for (name, _) in BUILT_IN {
            let closure = Closure::find(name).unwrap();
            for (text, target) in TARGETS {
                assert_eq!(target.to_string(), text);
                match export(&closure, target) {
                    Ok(pieces) => {
                        for file in ["README.md", "closure.toml", RUN_FILE] {
                            assert!(pieces.iter().any(|piece| piece.path == file), "{text} {file}");
                        }
                        let facts = Facts::new(&closure, false).unwrap();
                        let readme = pieces.iter().find(|piece| piece.path == "README.md").unwrap();
                        let readme = String::from_utf8(readme.bytes.clone()).unwrap();
                        for word in [&facts.name, &facts.hash, &facts.reference] {
                            assert!(readme.contains(word), "{name} {text}: {word}");
                        }
                        // The file that goes with it is the closure, and the hash is the file's.
                        let again = Closure::parse(&facts.toml, Path::new("closure.toml")).unwrap();
                        assert_eq!(again.file, closure.file);
                    }
                    Err(error) => {
                        assert!(error.to_string().contains("nearest: `--to "), "{error}");
                        refused.push(format!("{name} {text}"));
                    }
                }
            }
        }
        let solvers = |name: &str| ["openfoam", "mfix", "fluent"].map(|to| format!("{name} {to}"));
        let mut expected = solvers("schneiderbauer-pirker-2014").to_vec();
        expected.extend(
            ["openfoam", "mfix", "fluent", "c", "fortran", "table", "latex"]
                .map(|target| format!("parmentier-2012 {target}")),
        );
        expected.sort();
        refused.sort();
        assert_eq!(refused, expected);
    }

    #[test]
    fn templates_are_filled() {
        assert_eq!(fill("a {{b}} {{c}}{{b}}", &[("b", "1"), ("c", "2")]), "a 1 21");
        assert_eq!(short(0.5), "0.5");
        assert_eq!(short(3.0), "3");
    }
}
