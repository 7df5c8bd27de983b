//! What was typed: the case file's keys, their types and units, and where each value stands.
//!
//! The file is read by hand from the spanned TOML tree and not by a derived deserialiser, because
//! that stops at the first bad key, and a user wants to hear of all of them at once. No check
//! of a value's meaning is made here: that is [`resolve`](super::resolve)'s.

use std::fmt;
use std::ops::Range;

use serde::de::DeserializeOwned;
use serde::de::IntoDeserializer;
use serde::de::value::Error as ChoiceError;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::{
    DragChoice, DriveChoice, EDGE_KEYS, EdgesChoice, FieldsChoice, FrictionChoice,
    GranularEnergyChoice, KernelChoice, MappingChoice, MarkerChoice, MixtureChoice, Precision,
    RadialDistributionChoice, SolverChoice,
};
use crate::laws::scales::{REFERENCE_LENGTHS, Scales};

/// Every section and its keys.
pub(super) const SECTIONS: [(&str, &[&str]); 8] = [
    ("powder", &["diameter", "density", "restitution", "max_packing"]),
    ("gas", &["density", "viscosity"]),
    ("box", &["size", "cells", "cell", "solids_fraction"]),
    (
        "physics",
        &[
            "solver",
            "drag",
            "radial_distribution",
            "friction",
            "granular_energy",
            "gas_inertia",
            "gas_stress",
            "drive",
            "gas_flux",
            "gravity",
        ],
    ),
    (
        "particles",
        &[
            "overlap",
            "stiffness",
            "tangential_stiffness",
            "tangential_damping",
            "friction_coefficient",
            "steps_per_contact",
            "mapping",
            "smoothing",
            "start",
            "diameters",
            "mixture_drag",
            "cohesion",
        ],
    ),
    (
        "filter",
        &[
            "widths",
            "kernel",
            "markers",
            "solids_fraction_bin",
            "slip_bin",
            "solids_fraction_edges",
            "slip_edges",
            "slip_speed_edges",
            "pressure_gradient_edges",
            "shear_rate_edges",
            "solids_fraction_gradient_edges",
            "solids_fraction_variance_edges",
        ],
    ),
    ("run", &["duration", "sample_interval", "seed", "perturbation", "precision", "time_order"]),
    ("output", &["fields", "fields_interval"]),
];

/// A value and where it stands.
#[derive(Clone, Debug)]
pub(super) struct Typed<T> {
    pub section: &'static str,
    pub key: &'static str,
    pub span: Range<usize>,
    pub value: T,
}

/// One thing wrong with a case file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line, from 1; none when what is wrong is that something is absent from the whole file.
    pub line: Option<usize>,
    /// The section and key, as `[powder] diameter`.
    pub key: String,
    /// The value as typed, where there is one.
    pub value: Option<String>,
    /// What is wrong and what would be accepted.
    pub why: String,
    /// The line as typed with a caret below the value; empty without a line.
    pub excerpt: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(line) = self.line {
            write!(f, "{line}: ")?;
        } else {
            write!(f, " ")?;
        }
        if !self.key.is_empty() {
            write!(f, "{}", self.key)?;
            if let Some(value) = &self.value {
                write!(f, " = {value}")?;
            }
            write!(f, ": ")?;
        }
        write!(f, "{}{}", self.why, self.excerpt)
    }
}

/// The problems found so far in one text.
pub(super) struct Problems<'t> {
    text: &'t str,
    list: Vec<(usize, Problem)>,
}

impl<'t> Problems<'t> {
    pub fn new(text: &'t str) -> Self {
        Self { text, list: Vec::new() }
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The problems in the order of their lines; those without a line come last.
    pub fn into_list(mut self) -> Vec<Problem> {
        self.list.sort_by_key(|(start, _)| *start);
        self.list.into_iter().map(|(_, problem)| problem).collect()
    }

    /// Notes that `typed` is not acceptable.
    pub fn refuse<T>(&mut self, typed: &Typed<T>, why: impl Into<String>) {
        let key = key_name(typed.section, typed.key);
        self.push(key, Some(typed.span.clone()), true, why.into());
    }

    /// Notes that something is absent; `near` is where one would look for it.
    pub fn missing(&mut self, key: String, near: Option<Range<usize>>, why: impl Into<String>) {
        self.push(key, near, false, why.into());
    }

    fn push(&mut self, key: String, span: Option<Range<usize>>, show_value: bool, why: String) {
        let value =
            span.as_ref().filter(|_| show_value).map(|span| shorten(&self.text[span.clone()]));
        let start = span.as_ref().map_or(usize::MAX, |span| span.start);
        let (line, excerpt) = match span {
            Some(span) => {
                let (line, excerpt) = excerpt(self.text, span);
                (Some(line), excerpt)
            }
            None => (None, String::new()),
        };
        self.list.push((start, Problem { line, key, value, why, excerpt }));
    }
}

/// `[powder] diameter`.
fn key_name(section: &str, key: &str) -> String {
    if section.is_empty() { key.to_owned() } else { format!("[{section}] {key}") }
}

/// A value on one line and not longer than a message can bear.
fn shorten(value: &str) -> String {
    const LIMIT: usize = 60;
    let mut line = value.split_whitespace().collect::<Vec<_>>().join(" ");
    if line.chars().count() > LIMIT {
        line = line.chars().take(LIMIT).chain("...".chars()).collect();
    }
    line
}

/// The number of the line on which `span` starts, and that line with carets below the span.
fn excerpt(text: &str, span: Range<usize>) -> (usize, String) {
    let start = span.start.min(text.len());
    let line_start = text[..start].rfind('\n').map_or(0, |at| at + 1);
    let line_end = text[start..].find('\n').map_or(text.len(), |at| start + at);
    let number = text[..start].matches('\n').count() + 1;
    let line = text[line_start..line_end].trim_end();
    // Tabs stay tabs, so that the caret stands below its character however wide a tab is.
    let indent: String =
        text[line_start..start].chars().map(|c| if c == '\t' { '\t' } else { ' ' }).collect();
    let end = span.end.clamp(start, line_start + line.len().max(start - line_start));
    let carets = "^".repeat(text[start..end].chars().count().max(1));
    let margin = " ".repeat(number.to_string().len());
    (number, format!("\n {margin} |\n {number} | {line}\n {margin} | {indent}{carets}"))
}

/// What a quantity may be measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A length, without the lengths that follow from the powder: the diameter itself.
    Metric,
    /// A length.
    Length,
    /// A time.
    Time,
    /// A velocity.
    Velocity,
}

/// A unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Unit {
    /// So many of this unit make one SI unit; a divisor, because 75/10⁶ is the double nearest to
    /// 75e-6 and 75 · 10⁻⁶ is not.
    PerSi(f64),
    /// d.
    Diameter,
    /// (u_t²/g) Fr_p^n.
    ReferenceLength(f64),
    /// u_t/g.
    ReferenceTime,
    /// u_t.
    TerminalVelocity,
}

/// A number with its unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Quantity {
    pub number: f64,
    pub unit: Unit,
}

impl Quantity {
    /// The quantity in SI; none if its unit needs the powder's scales and they are not known.
    pub fn si(self, scales: Option<&Scales>) -> Option<f64> {
        match self.unit {
            Unit::PerSi(divisor) => Some(self.number / divisor),
            Unit::Diameter => scales.map(|scales| self.number * scales.diameter),
            Unit::ReferenceLength(n) => scales.map(|scales| self.number * scales.length(n)),
            Unit::ReferenceTime => scales.map(|scales| self.number * scales.time()),
            Unit::TerminalVelocity => scales.map(|scales| self.number * scales.terminal_velocity),
        }
    }

    /// A number in SI.
    pub fn from_si(number: f64) -> Self {
        Self { number, unit: Unit::PerSi(1.0) }
    }

    /// Reads `8 L_I`; the unit must be given.
    pub fn parse(text: &str, kind: Kind) -> Result<Self, String> {
        let text = text.trim();
        let is_number = |c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.' | 'e' | 'E');
        let split = text.find(|c| !is_number(c)).unwrap_or(text.len());
        let (number, unit) = (text[..split].trim(), text[split..].trim());
        let number = match number.parse::<f64>() {
            Ok(number) if number.is_finite() => number,
            _ => return Err(kind.expected()),
        };
        if unit.is_empty() {
            let expected = kind.expected();
            return Err(format!("it has no unit: {expected}"));
        }
        match kind.units().iter().find(|(name, _)| *name == unit) {
            Some(&(_, unit)) => Ok(Self { number, unit }),
            None => {
                let names = kind.units();
                let near = nearest(unit, names.iter().map(|(name, _)| *name));
                let hint = near.map_or(String::new(), |near| format!("did you mean {near}? "));
                Err(format!("unknown unit {unit}: {hint}{}", kind.expected()))
            }
        }
    }
}

impl Kind {
    /// Names and meanings of the units.
    pub fn units(self) -> Vec<(&'static str, Unit)> {
        let metric = [("m", 1.0), ("cm", 1e2), ("mm", 1e3), ("um", 1e6), ("µm", 1e6), ("μm", 1e6)];
        let metric = metric.map(|(name, divisor)| (name, Unit::PerSi(divisor)));
        match self {
            Kind::Metric => metric.to_vec(),
            Kind::Length => {
                let reference = REFERENCE_LENGTHS.map(|(name, n)| (name, Unit::ReferenceLength(n)));
                let diameter = [("d", Unit::Diameter)];
                metric.into_iter().chain(diameter).chain(reference).collect()
            }
            Kind::Time => vec![
                ("s", Unit::PerSi(1.0)),
                ("ms", Unit::PerSi(1e3)),
                ("u_t/g", Unit::ReferenceTime),
            ],
            Kind::Velocity => vec![("m/s", Unit::PerSi(1.0)), ("u_t", Unit::TerminalVelocity)],
        }
    }

    /// What is accepted.
    fn expected(self) -> String {
        match self {
            Kind::Metric => {
                "accepted is a number in metres, or text such as \"75 um\" (m, cm, mm, um)".into()
            }
            Kind::Length => "accepted is a number in metres, or text such as \"8 L_I\" or \"3 d\" \
                             (m, cm, mm, um, d, L_I, L_II, L_III, L_IV, L_V)"
                .into(),
            Kind::Time => "accepted is a number in seconds, or text such as \"200 u_t/g\" or \
                           \"3 s\" (s, ms, u_t/g)"
                .into(),
            Kind::Velocity => "accepted is a number in m/s, or text such as \"0.25 u_t\" (m/s, \
                               u_t)"
                .into(),
        }
    }
}

/// The candidate nearest to `word`, if any is near enough to have been meant.
pub(super) fn nearest<'a>(
    word: &str,
    candidates: impl IntoIterator<Item = &'a str>,
) -> Option<&'a str> {
    let likeness = |candidate: &str| {
        let (word, candidate) = (word.to_lowercase(), candidate.to_lowercase());
        strsim::normalized_damerau_levenshtein(&word, &candidate)
    };
    candidates
        .into_iter()
        .map(|candidate| (likeness(candidate), candidate))
        .filter(|(likeness, _)| *likeness >= 0.5)
        // `max_by` takes the last of equals; the strict fold keeps the first.
        .fold(None, |best: Option<(f64, &str)>, next| match best {
            Some(best) if best.0 >= next.0 => Some(best),
            _ => Some(next),
        })
        .map(|(_, candidate)| candidate)
}

/// The file as typed; `None` where a key is absent, or its value was of the wrong type, which is
/// then among the problems.
#[derive(Debug)]
pub(super) struct CaseFile {
    pub powder: PowderFile,
    pub gas: GasFile,
    pub domain: DomainFile,
    pub physics: PhysicsFile,
    pub particles: ParticlesFile,
    pub filter: FilterFile,
    pub run: RunFile,
    pub output: OutputFile,
}

#[derive(Debug)]
pub(super) struct PowderFile {
    pub diameter: Option<Typed<Quantity>>,
    pub density: Option<Typed<f64>>,
    pub restitution: Option<Typed<f64>>,
    pub max_packing: Option<Typed<f64>>,
}

#[derive(Debug)]
pub(super) struct GasFile {
    pub density: Option<Typed<f64>>,
    pub viscosity: Option<Typed<f64>>,
}

#[derive(Debug)]
pub(super) struct DomainFile {
    pub size: Option<Typed<Vec<Typed<Quantity>>>>,
    pub cells: Option<Typed<Vec<Typed<u64>>>>,
    pub cell: Option<Typed<Quantity>>,
    pub solids_fraction: Option<Typed<Vec<Typed<f64>>>>,
}

#[derive(Debug)]
pub(super) struct PhysicsFile {
    pub solver: Option<Typed<SolverChoice>>,
    pub drag: Option<Typed<DragChoice>>,
    pub radial_distribution: Option<Typed<RadialDistributionChoice>>,
    pub friction: Option<Typed<FrictionChoice>>,
    pub granular_energy: Option<Typed<GranularEnergyChoice>>,
    pub gas_inertia: Option<Typed<bool>>,
    pub gas_stress: Option<Typed<bool>>,
    pub drive: Option<Typed<DriveChoice>>,
    pub gas_flux: Option<Typed<Quantity>>,
    pub gravity: Option<Typed<f64>>,
}

#[derive(Debug)]
pub(super) struct ParticlesFile {
    /// The section, if there is one.
    pub header: Option<Typed<()>>,
    pub overlap: Option<Typed<f64>>,
    pub stiffness: Option<Typed<f64>>,
    pub tangential_stiffness: Option<Typed<f64>>,
    pub tangential_damping: Option<Typed<f64>>,
    pub friction_coefficient: Option<Typed<f64>>,
    pub steps_per_contact: Option<Typed<f64>>,
    pub mapping: Option<Typed<MappingChoice>>,
    pub smoothing: Option<Typed<Quantity>>,
    pub start: Option<Typed<String>>,
    pub diameters: Option<Typed<DiametersTyped>>,
    pub mixture_drag: Option<Typed<MixtureChoice>>,
    pub cohesion: Option<Typed<f64>>,
}

/// Diameters as typed.
#[derive(Clone, Debug)]
pub(super) enum DiametersTyped {
    /// Diameters and shares of the volume.
    Shares(Vec<(Quantity, f64)>),
    /// A geometric standard deviation.
    LogNormal(f64),
}

#[derive(Debug)]
pub(super) struct FilterFile {
    pub widths: Option<Typed<Vec<Typed<Quantity>>>>,
    pub markers: Option<Typed<Vec<Typed<MarkerChoice>>>>,
    pub solids_fraction_bin: Option<Typed<f64>>,
    pub slip_bin: Option<Typed<Quantity>>,
    pub kernel: Option<Typed<KernelChoice>>,
    pub edges: Vec<(MarkerChoice, Typed<EdgesChoice>)>,
}

#[derive(Debug)]
pub(super) struct RunFile {
    pub duration: Option<Typed<Quantity>>,
    pub sample_interval: Option<Typed<Quantity>>,
    pub seed: Option<Typed<u64>>,
    pub perturbation: Option<Typed<f64>>,
    pub precision: Option<Typed<Precision>>,
    pub time_order: Option<Typed<u64>>,
}

#[derive(Debug)]
pub(super) struct OutputFile {
    pub fields: Option<Typed<FieldsChoice>>,
    pub fields_interval: Option<Typed<Quantity>>,
}

/// Reads `text`. None if it is not TOML, which is then the only problem, or if it holds nothing,
/// which is then none.
pub(super) fn read(text: &str, problems: &mut Problems<'_>) -> Option<CaseFile> {
    let root = match DeTable::parse(text) {
        Ok(root) => root.into_inner(),
        Err(error) => {
            let why = format!("this is not TOML: {}", error.message().replace('\n', "; "));
            let end = text.trim_end().len();
            let mut span = error.span().unwrap_or(end..end);
            // An error at the end of the file is shown where the text ends.
            if span.start > end {
                span = end..end;
            }
            problems.missing(String::new(), Some(span), why);
            return None;
        }
    };
    if root.is_empty() {
        return None;
    }
    for (name, value) in &root {
        if !SECTIONS.iter().any(|(section, _)| section == name.get_ref()) {
            refuse_top_level(name, value.get_ref(), problems);
        }
    }
    let powder = {
        let mut section = Section::new(&root, "powder", true, problems);
        PowderFile {
            diameter: section.required("diameter", |value| quantity(value, Kind::Metric)),
            density: section.required("density", number),
            restitution: section.required("restitution", number),
            max_packing: section.required("max_packing", number),
        }
    };
    let gas = {
        let mut section = Section::new(&root, "gas", true, problems);
        GasFile {
            density: section.required("density", number),
            viscosity: section.required("viscosity", number),
        }
    };
    let domain = {
        let mut section = Section::new(&root, "box", true, problems);
        let length = |value: &Value<'_>| quantity(value, Kind::Length);
        let size = section.required_list(
            "size",
            "the edges, such as [0.16, 0.16] or [\"8 L_I\", \"8 L_I\"]",
            length,
        );
        let cells = section.list("cells", "whole numbers, such as [128, 128]", whole_number);
        let cell = section.optional("cell", length);
        if cells.is_none() && !section.has("cells") && !section.has("cell") {
            section.missing(
                "cells",
                "missing: give the cells along each edge, or the edge of one \
                                      as cell",
            );
        }
        let solids_fraction = if section.holds_list("solids_fraction") {
            section.required_list("solids_fraction", "mean solids fractions", number)
        } else {
            // One number is a list of one.
            section.required("solids_fraction", number).map(|one| Typed {
                section: one.section,
                key: one.key,
                span: one.span.clone(),
                value: vec![one],
            })
        };
        DomainFile { size, cells, cell, solids_fraction }
    };
    let physics = {
        let mut section = Section::new(&root, "physics", false, problems);
        PhysicsFile {
            solver: section.optional("solver", choice),
            drag: section.optional("drag", choice),
            radial_distribution: section.optional("radial_distribution", choice),
            friction: section.optional("friction", choice),
            granular_energy: section.optional("granular_energy", choice),
            gas_inertia: section.optional("gas_inertia", switch),
            gas_stress: section.optional("gas_stress", switch),
            drive: section.optional("drive", choice),
            gas_flux: section.optional("gas_flux", |value| quantity(value, Kind::Velocity)),
            gravity: section.optional("gravity", number),
        }
    };
    let particles = {
        let mut section = Section::new(&root, "particles", false, problems);
        let header = section.table.as_ref().map(|(_, header)| Typed {
            section: "",
            key: "particles",
            span: header.clone(),
            value: (),
        });
        ParticlesFile {
            header,
            overlap: section.optional("overlap", number),
            stiffness: section.optional("stiffness", number),
            tangential_stiffness: section.optional("tangential_stiffness", number),
            tangential_damping: section.optional("tangential_damping", number),
            friction_coefficient: section.optional("friction_coefficient", number),
            steps_per_contact: section.optional("steps_per_contact", number),
            mapping: section.optional("mapping", choice),
            smoothing: section.optional("smoothing", |value| quantity(value, Kind::Length)),
            start: section.optional("start", words),
            diameters: section.optional("diameters", diameters),
            mixture_drag: section.optional("mixture_drag", choice),
            cohesion: section.optional("cohesion", number),
        }
    };
    let filter = {
        let mut section = Section::new(&root, "filter", false, problems);
        FilterFile {
            widths: section.list("widths", "filter widths, such as [0.005, 0.01]", |value| {
                quantity(value, Kind::Length)
            }),
            markers: section.list("markers", "markers, such as [\"solids_fraction\"]", choice),
            solids_fraction_bin: section.optional("solids_fraction_bin", number),
            slip_bin: section.optional("slip_bin", |value| quantity(value, Kind::Velocity)),
            kernel: section.optional("kernel", choice),
            edges: EDGE_KEYS
                .iter()
                .filter_map(|&(key, marker)| Some((marker, section.optional(key, edges)?)))
                .collect(),
        }
    };
    let run = {
        let mut section = Section::new(&root, "run", false, problems);
        let time = |value: &Value<'_>| quantity(value, Kind::Time);
        RunFile {
            duration: section.optional("duration", time),
            sample_interval: section.optional("sample_interval", time),
            seed: section.optional("seed", whole_number),
            perturbation: section.optional("perturbation", number),
            precision: section.optional("precision", choice),
            time_order: section.optional("time_order", whole_number),
        }
    };
    let output = {
        let mut section = Section::new(&root, "output", false, problems);
        OutputFile {
            fields: section.optional("fields", choice),
            fields_interval: section
                .optional("fields_interval", |value| quantity(value, Kind::Time)),
        }
    };
    Some(CaseFile { powder, gas, domain, physics, particles, filter, run, output })
}

/// A TOML value and where it stands.
type Value<'a> = Spanned<DeValue<'a>>;

/// What a value was read as, or what would have been accepted.
type Read<T> = Result<T, String>;

/// One section while it is read.
struct Section<'a, 't, 'p> {
    name: &'static str,
    /// The table and where its header stands; none if the section is absent.
    table: Option<(&'a DeTable<'a>, Range<usize>)>,
    problems: &'p mut Problems<'t>,
}

impl<'a, 't, 'p> Section<'a, 't, 'p> {
    /// Finds the section `name` and refuses what it must not hold.
    fn new(
        root: &'a DeTable<'a>,
        name: &'static str,
        needed: bool,
        problems: &'p mut Problems<'t>,
    ) -> Self {
        let keys = keys_of(name);
        let table = match root.get(name) {
            None => {
                if needed && !misspelt(root, &SECTIONS.map(|(section, _)| section), name) {
                    let why = format!("missing: the section needs {}", keys.join(", "));
                    problems.missing(format!("[{name}]"), None, why);
                }
                None
            }
            Some(value) => match value.get_ref() {
                DeValue::Table(table) => Some((table, value.span())),
                _ => {
                    let why = format!("a section is expected: a line [{name}] and its keys below");
                    problems.push(name.to_owned(), Some(value.span()), true, why);
                    None
                }
            },
        };
        if let Some((table, _)) = &table {
            for (key, _) in *table {
                if !keys.contains(&key.get_ref().as_ref()) {
                    let why = unknown_key(key.get_ref(), name);
                    problems.missing(key_name(name, key.get_ref()), Some(key.span()), why);
                }
            }
        }
        Self { name, table, problems }
    }

    fn value(&self, key: &str) -> Option<&'a Value<'a>> {
        self.table.as_ref().and_then(|(table, _)| table.get(key))
    }

    fn has(&self, key: &str) -> bool {
        self.value(key).is_some()
    }

    fn holds_list(&self, key: &str) -> bool {
        matches!(self.value(key).map(|value| value.get_ref()), Some(DeValue::Array(_)))
    }

    /// Notes that `key` is absent, at the section's header. An absent section is noted already,
    /// and so is a misspelt key.
    fn missing(&mut self, key: &str, why: &str) {
        if let Some((table, header)) = &self.table {
            let keys = keys_of(self.name);
            if !misspelt(table, keys, key) {
                self.problems.missing(key_name(self.name, key), Some(header.clone()), why);
            }
        }
    }

    fn optional<T>(
        &mut self,
        key: &'static str,
        read: impl Fn(&Value<'a>) -> Read<T>,
    ) -> Option<Typed<T>> {
        let value = self.value(key)?;
        self.read(key, value, read)
    }

    fn required<T>(
        &mut self,
        key: &'static str,
        read: impl Fn(&Value<'a>) -> Read<T>,
    ) -> Option<Typed<T>> {
        if !self.has(key) {
            self.missing(key, "missing, and there is no default");
        }
        self.optional(key, read)
    }

    /// A list; every bad entry is noted.
    fn list<T>(
        &mut self,
        key: &'static str,
        of: &str,
        read: impl Fn(&Value<'a>) -> Read<T>,
    ) -> Option<Typed<Vec<Typed<T>>>> {
        let value = self.value(key)?;
        let whole = Typed { section: self.name, key, span: value.span(), value: () };
        let DeValue::Array(entries) = value.get_ref() else {
            self.problems.refuse(&whole, format!("a list is expected: {of}"));
            return None;
        };
        let mut list = Vec::with_capacity(entries.len());
        for entry in entries.iter() {
            list.push(self.read(key, entry, &read));
        }
        let list = list.into_iter().collect::<Option<Vec<_>>>()?;
        if list.is_empty() {
            self.problems.refuse(&whole, format!("the list is empty: it holds {of}"));
            return None;
        }
        Some(Typed { section: whole.section, key, span: whole.span, value: list })
    }

    fn required_list<T>(
        &mut self,
        key: &'static str,
        of: &str,
        read: impl Fn(&Value<'a>) -> Read<T>,
    ) -> Option<Typed<Vec<Typed<T>>>> {
        if !self.has(key) {
            self.missing(key, &format!("missing, and there is no default: it holds {of}"));
        }
        self.list(key, of, read)
    }

    fn read<T>(
        &mut self,
        key: &'static str,
        value: &Value<'a>,
        read: impl Fn(&Value<'a>) -> Read<T>,
    ) -> Option<Typed<T>> {
        let typed = Typed { section: self.name, key, span: value.span(), value: read(value) };
        match typed.value {
            Ok(value) => Some(Typed { section: self.name, key, span: typed.span, value }),
            Err(ref why) => {
                self.problems.refuse(&typed, why.clone());
                None
            }
        }
    }
}

/// Whether `table` holds a key that is none of `known` and was probably meant to be `meant`.
fn misspelt(table: &DeTable<'_>, known: &[&str], meant: &str) -> bool {
    table.keys().map(|key| key.get_ref().as_ref()).any(|key: &str| {
        !known.contains(&key) && nearest(key, known.iter().copied()) == Some(meant)
    })
}

/// The keys of a section that exists.
fn keys_of(section: &str) -> &'static [&'static str] {
    SECTIONS.iter().find(|(name, _)| *name == section).map_or(&[], |(_, keys)| *keys)
}

/// Why `key` in `section` is refused.
fn unknown_key(key: &str, section: &str) -> String {
    let keys = keys_of(section);
    let holds = format!("[{section}] holds {}", keys.join(", "));
    let home = SECTIONS.iter().find(|(_, keys)| keys.contains(&key));
    match (nearest(key, keys.iter().copied()), home) {
        (Some(near), _) => format!("unknown key: did you mean {near}? {holds}"),
        (None, Some((home, _))) => format!("unknown key: it belongs in [{home}]; {holds}"),
        (None, None) => format!("unknown key; {holds}"),
    }
}

/// Refuses a key or section that stands at the top of the file and has no business there.
fn refuse_top_level(
    name: &Spanned<DeString<'_>>,
    value: &DeValue<'_>,
    problems: &mut Problems<'_>,
) {
    let key = name.get_ref().as_ref();
    let sections = || SECTIONS.map(|(section, _)| format!("[{section}]")).join(", ");
    let home = SECTIONS.iter().find(|(_, keys)| keys.contains(&key));
    let near = nearest(key, SECTIONS.map(|(section, _)| section));
    let is_section = matches!(value, DeValue::Table(_));
    let why = match (home, near) {
        (Some((home, _)), _) => {
            format!("unknown at the top of the file: it belongs below the line [{home}]")
        }
        (None, Some(near)) => {
            format!("unknown section: did you mean [{near}]? A case holds {}", sections())
        }
        (None, None) => format!("unknown section; a case holds {}", sections()),
    };
    let shown = if is_section { format!("[{key}]") } else { key.to_owned() };
    problems.missing(shown, Some(name.span()), why);
}

/// A finite number, typed with or without a decimal point.
fn number(value: &Value<'_>) -> Read<f64> {
    let number = match value.get_ref() {
        DeValue::Float(number) => number.as_str().parse().ok(),
        DeValue::Integer(number) => {
            i64::from_str_radix(number.as_str(), number.radix()).ok().map(|number| number as f64)
        }
        DeValue::String(text) => {
            let bare = text.trim().parse::<f64>().is_ok();
            let hint = if bare { ": remove the quotes" } else { ", in SI units" };
            return Err(format!("it is text and a number is expected{hint}"));
        }
        other => return Err(format!("a number is expected, not {}", name_of(other))),
    };
    number.filter(|number: &f64| number.is_finite()).ok_or("a finite number is expected".to_owned())
}

/// A whole number that is not negative.
fn whole_number(value: &Value<'_>) -> Read<u64> {
    match value.get_ref() {
        DeValue::Integer(number) => u64::from_str_radix(number.as_str(), number.radix())
            .ok()
            .filter(|number| *number <= i64::MAX as u64)
            .ok_or(format!("a whole number between 0 and {} is expected", i64::MAX)),
        DeValue::Float(_) => Err("a whole number is expected, without a decimal point".to_owned()),
        other => Err(format!("a whole number is expected, not {}", name_of(other))),
    }
}

/// `true` or `false`.
fn switch(value: &Value<'_>) -> Read<bool> {
    match value.get_ref() {
        DeValue::Boolean(on) => Ok(*on),
        DeValue::String(_) => {
            Err("true or false is expected, not text: remove the quotes".to_owned())
        }
        other => Err(format!("true or false is expected, not {}", name_of(other))),
    }
}

/// A number in SI, or text with a unit.
fn quantity(value: &Value<'_>, kind: Kind) -> Read<Quantity> {
    match value.get_ref() {
        DeValue::String(text) => Quantity::parse(text, kind),
        DeValue::Float(_) | DeValue::Integer(_) => number(value).map(Quantity::from_si),
        _ => Err(kind.expected()),
    }
}

/// Text.
fn words(value: &Value<'_>) -> Read<String> {
    match value.get_ref() {
        DeValue::String(text) => Ok(text.as_ref().to_owned()),
        other => Err(format!("text in quotes is expected, not {}", name_of(other))),
    }
}

/// Diameters with their shares, or the deviation of a distribution.
fn diameters(value: &Value<'_>) -> Read<DiametersTyped> {
    const EXPECTED: &str = "a list is expected, such as [{ diameter = \"60 um\", share = 0.3 }, \
                            { diameter = \"90 um\", share = 0.7 }], shares by volume, or \
                            { geometric_deviation = 1.2 }";
    match value.get_ref() {
        DeValue::Table(table) => {
            let entry = |key: &str| table.get(key);
            match entry("geometric_deviation") {
                Some(deviation) if table.len() == 1 => number(deviation)
                    .map(DiametersTyped::LogNormal)
                    .map_err(|why| format!("geometric_deviation: {why}")),
                _ => Err(EXPECTED.to_owned()),
            }
        }
        DeValue::Array(entries) if !entries.is_empty() => {
            let class = |(n, entry): (usize, &Value<'_>)| {
                let at = |why: String| format!("entry {}: {why}", n + 1);
                let DeValue::Table(table) = entry.get_ref() else {
                    return Err(at(EXPECTED.to_owned()));
                };
                if table.keys().any(|key| !["diameter", "share"].contains(&key.get_ref().as_ref()))
                {
                    return Err(at("it holds diameter and share, nothing else".to_owned()));
                }
                let (Some(diameter), Some(share)) = (table.get("diameter"), table.get("share"))
                else {
                    return Err(at("diameter and share are needed".to_owned()));
                };
                let diameter = quantity(diameter, Kind::Length)
                    .map_err(|why| at(format!("diameter: {why}")))?;
                let share = number(share).map_err(|why| at(format!("share: {why}")))?;
                Ok((diameter, share))
            };
            entries.iter().enumerate().map(class).collect::<Read<_>>().map(DiametersTyped::Shares)
        }
        _ => Err(EXPECTED.to_owned()),
    }
}

/// One of the names that `T` knows.
fn choice<T: DeserializeOwned>(value: &Value<'_>) -> Read<T> {
    match value.get_ref() {
        DeValue::String(text) => {
            T::deserialize(text.as_ref().into_deserializer()).map_err(|error: ChoiceError| {
                // The derived message names the accepted values.
                error.to_string().replace("unknown variant", "unknown choice").replace('`', "\"")
            })
        }
        other => Err(format!("a name in quotes is expected, not {}", name_of(other))),
    }
}

/// Most bins of a marker whose edges are given, and most quantiles.
const MOST_EDGES: usize = 64;
const MOST_QUANTILES: usize = 20;

/// Edges of bins, or how many quantiles.
fn edges(value: &Value<'_>) -> Read<EdgesChoice> {
    let quantiles =
        || format!("from 2 to {MOST_QUANTILES} quantiles are accepted, as \"5 quantiles\"");
    match value.get_ref() {
        DeValue::Array(entries) => {
            let edges: Option<Vec<f64>> = entries.iter().map(|edge| number(edge).ok()).collect();
            let edges = edges.filter(|edges| edges.is_sorted_by(|a, b| a < b));
            let edges = edges.ok_or("ascending numbers are expected, without a unit")?;
            if !(2..=MOST_EDGES).contains(&edges.len()) {
                return Err(format!("two edges or more are accepted, to {MOST_EDGES}"));
            }
            Ok(EdgesChoice::Given(edges))
        }
        DeValue::String(text) => {
            let count = text.trim().strip_suffix("quantiles").map(str::trim);
            let count = count.and_then(|count| count.parse().ok());
            let count = count.filter(|count| (2..=MOST_QUANTILES).contains(count));
            count.map(EdgesChoice::Quantiles).ok_or_else(quantiles)
        }
        other => Err(format!(
            "a list of ascending numbers or \"5 quantiles\" is expected, not {}",
            name_of(other)
        )),
    }
}

/// The type of a value, in words.
fn name_of(value: &DeValue<'_>) -> &'static str {
    match value {
        DeValue::String(_) => "text",
        DeValue::Integer(_) | DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_are_exact_and_their_units_are_those_of_their_kind() {
        let si = |text, kind| Quantity::parse(text, kind).map(|quantity| quantity.si(None));
        assert_eq!(si("75 um", Kind::Metric), Ok(Some(75e-6)));
        assert_eq!(si("75µm", Kind::Length), Ok(Some(75e-6)));
        assert_eq!(si(" 1.6e1 cm ", Kind::Length), Ok(Some(0.16)));
        assert_eq!(si("5 ms", Kind::Time), Ok(Some(0.005)));
        for (text, kind) in [
            ("3 d", Kind::Metric),
            ("3 s", Kind::Length),
            ("3", Kind::Length),
            ("L_I", Kind::Length),
            ("inf m", Kind::Length),
            ("1e999 m", Kind::Length),
            ("", Kind::Time),
            ("3 u_t", Kind::Time),
            ("3 u_t/g", Kind::Velocity),
        ] {
            let why = Quantity::parse(text, kind).unwrap_err();
            assert!(why.contains("accepted is a number in"), "{text}: {why}");
        }
    }

    #[test]
    fn excerpts_point_at_the_value() {
        let text = "a = 1\r\n\tµm = \"é\"\r\nc = 3";
        let start = text.find('"').unwrap();
        let (line, shown) = excerpt(text, start..start + 4);
        assert_eq!(line, 2);
        assert_eq!(shown, "\n   |\n 2 | \tµm = \"é\"\n   | \t     ^^^");
        // A span over several lines is marked on its first, one past the end by a single caret.
        assert!(excerpt(text, start..text.len()).1.ends_with("^^^"));
        assert_eq!(excerpt("a", 1..1), (1, "\n   |\n 1 | a\n   |  ^".to_owned()));
    }

    #[test]
    fn the_nearest_key_is_near() {
        let keys = ["diameter", "density", "restitution"];
        assert_eq!(nearest("diametre", keys), Some("diameter"));
        assert_eq!(nearest("Density", keys), Some("density"));
        assert_eq!(nearest("phi", keys), None);
    }
}
