//! [`Closure`]: any closure, published or fitted, as formulae of markers.
//!
//! A closure file is data: constants, formulae in the language of [`Expression`], and for each
//! quantity its markers with their ranges and test vectors. That of a fit ([`Model`](crate::model::Model)) has besides the
//! errors of its coefficients, in `[fit]`. What the crate ships is in [`BUILT_IN`]; a path to a file stands wherever a name does.
//!
//! | marker | in formulae | what it is |
//! | --- | --- | --- |
//! | `solids_fraction` | `phi` | filtered solids fraction |
//! | `filter_width` | `D` | Δ_f over the reference length |
//! | `slip` | `V` | filtered slip speed / u_t |
//! | `shear_rate` | `S` | S u_t/g of the filtered solids velocity, S = √(2 Sd:Sd) |
//! | `gas_shear_rate` | `S_g` | the same of the filtered gas velocity |
//! | `wall_distance` | `X` | distance from the wall × g/u_t² |
//! | `pressure_gradient` | `G` | vertical filtered pressure gradient / (ρ_s g) |
//!
//! Values are scaled; the unit of a quantity says by what.

use crate::expression::{Expression, Meaning, Program};
use crate::fit::{Coefficient, Goodness, ReferenceLength, ValidRange};
use crate::forms::Marker;
use crate::model::{Definitions, Outside, System};
use crate::refit::{Candidate, Fitted};
use crate::spline::Spline;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A closure file. The fields are its keys.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClosureFile {
    /// Name.
    pub name: String,
    /// One line for a list.
    pub title: String,
    /// Whether all of the publication is there.
    pub status: Status,
    /// What a partial closure lacks, one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<String>,
    /// What Δ_f is scaled by.
    pub reference_length: ReferenceLength,
    /// What happens outside the ranges.
    pub outside: Outside,
    /// What a user must know, one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// Where it comes from.
    pub source: Provenance,
    /// Definitions used.
    pub definitions: Definitions,
    /// Powder and gas that it was found for; none if the source does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub system: Option<System>,
    /// Named numbers in its formulae.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub constants: BTreeMap<String, f64>,
    /// Named formulae in its formulae.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub formulae: BTreeMap<String, String>,
    /// Named surfaces in its formulae.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub splines: BTreeMap<String, Spline>,
    /// Errors of its coefficients, if it was fitted to a run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<FitFile>,
    /// What it predicts.
    #[serde(default)]
    pub quantities: Vec<QuantityFile>,
    /// What is wrong with the publication itself and is left as it is.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub known_flaws: Vec<KnownFlaw>,
}

/// What a fit knows of its coefficients, which are constants of the file, and of its curve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitFile {
    /// Name of the form, see [`forms::FORMS`](crate::forms::FORMS); `spline` for a surface, or a user's.
    pub form: String,
    /// Its formula, for the reader.
    pub formula: String,
    /// Seed of the run; none where there were several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Score on runs that the fit has not seen, 1 - Σ n residual²/Σ n (value - mean)²; none of one run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub held_out: Option<f64>,
    /// Replicates of the bins that it was fitted to again: intervals are theirs; 0: those of one fit.
    #[serde(default)]
    pub replicates: usize,
    /// Covariance of the coefficients, in their order.
    pub covariance: Vec<Vec<f64>>,
    /// How well the form follows the bins.
    pub goodness: Goodness,
    /// The coefficients with their intervals; each symbol is a constant of this value.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub coefficients: Vec<Coefficient>,
    /// The curve with its intervals.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curve: Option<Curve>,
}

/// Points of a fitted curve with their 95 % intervals, column by column.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
    /// Values.
    pub value: Vec<f64>,
    /// Lower ends.
    pub low_95: Vec<f64>,
    /// Upper ends.
    pub high_95: Vec<f64>,
    /// Value of each marker.
    pub at: BTreeMap<Marker, Vec<f64>>,
}

/// Whether all of a publication is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Every coefficient is known.
    Full,
    /// Something is missing or uncertain; `missing` says what.
    Partial,
}

/// Where a closure comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Publication or run.
    pub reference: String,
    /// The text or code that the coefficients were read from.
    pub read_from: String,
    /// Where sources disagree: which was taken and why, one sentence each.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<String>,
}

/// One quantity as in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantityFile {
    /// What is predicted; in the words of the bin table where it has the quantity.
    pub predicts: String,
    /// What a value is scaled by; `-` for a number.
    pub unit: String,
    /// Formula of the markers.
    pub formula: String,
    /// Exponents of markers that the source states for the whole formula, as formulae: `"16/7"`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub exponents: BTreeMap<Marker, String>,
    /// Valid range of each marker that the formula depends on.
    pub ranges: Vec<ValidRange>,
    /// Points and the values there, computed without this crate.
    pub test_vectors: Vec<Vector>,
}

/// A point and the value that any implementation must give there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Vector {
    /// Value of each marker.
    pub at: BTreeMap<Marker, f64>,
    /// Expected value.
    pub expected: f64,
}

/// A flaw of the publication, which `check` finds and does not hold against the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KnownFlaw {
    /// Name of the check that finds it.
    pub check: String,
    /// Quantity.
    pub quantity: String,
    /// Where: values of the marker at which it was seen; empty: anywhere.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub at: Vec<f64>,
    /// Its size at most, as the check measures it.
    pub largest: f64,
    /// Why it stands.
    pub reason: String,
}

/// A closure that was read and compiled.
#[derive(Clone, Debug)]
pub struct Closure {
    /// What its file says.
    pub file: ClosureFile,
    /// Its quantities.
    pub quantities: Vec<Quantity>,
    formulae: BTreeMap<String, Expression>,
}

/// A quantity that was compiled.
#[derive(Clone, Debug)]
pub struct Quantity {
    /// What its file says.
    pub file: QuantityFile,
    /// Its formula as a tree, with the names of the closure's constants and formulae.
    pub formula: Expression,
    outside: Outside,
    program: Program,
}

/// A closure that cannot be used.
#[derive(Debug, Error)]
pub enum ClosureError {
    /// Neither a name nor a file.
    #[error("there is no closure named {name}, and no such file; known: {known}{}", near(.nearest))]
    Unknown {
        /// What was given.
        name: String,
        /// Names.
        known: String,
        /// The nearest name.
        nearest: Option<String>,
    },
    /// The file cannot be read.
    #[error("{path}: {why}")]
    Unreadable {
        /// File.
        path: PathBuf,
        /// What the system says.
        why: std::io::Error,
    },
    /// Not TOML, an unknown or missing key, a value of the wrong kind.
    #[error("{path}: {why}")]
    Invalid {
        /// File.
        path: PathBuf,
        /// What the parser says, with line and column.
        why: Box<toml::de::Error>,
    },
    /// Something in the file makes no sense.
    #[error("{path}: {place}: {why}")]
    Wrong {
        /// File.
        path: PathBuf,
        /// Key.
        place: String,
        /// What is wrong and what would be right.
        why: String,
    },
}

fn near(nearest: &Option<String>) -> String {
    nearest.as_ref().map(|name| format!("; did you mean {name}?")).unwrap_or_default()
}

macro_rules! built_in {
    ($($name:literal),* $(,)?) => {
        /// Closures that the crate ships: name and file.
        pub const BUILT_IN: &[(&str, &str)] =
            &[$(($name, include_str!(concat!("../models/", $name, ".toml")))),*];
    };
}

built_in!(
    "default",
    "igci-sundaresan-2011-2d",
    "igci-sundaresan-2011-3d",
    "milioli-2013",
    "milioli-2013-extended",
    "sarkar-2016",
    "sarkar-2016-simplified",
    "sarkar-2016-stress",
    "radl-sundaresan-2014",
    "schneiderbauer-pirker-2014",
    "cloete-2018",
    "parmentier-2012",
);

/// More characters than this in all formulae together are a mistake.
const LONGEST: usize = 100_000;

/// A range with two ends: one filter width alone holds within a thousandth.
fn ended(range: ValidRange) -> ValidRange {
    let low = if range.low < range.high { range.low } else { 0.999 * range.high };
    ValidRange { low, ..range }
}

/// Points of a grid over the ranges, at these shares of the first marker's and every other one's range,
/// and at these of the second's.
fn grid(ranges: &[ValidRange], first: &[f64], second: &[f64]) -> Vec<Vec<f64>> {
    let point = |a: f64, b: f64| {
        let at = |(k, range): (usize, &ValidRange)| {
            let share = if k % 2 == 0 { a } else { b };
            range.low + share * (range.high - range.low)
        };
        ranges.iter().enumerate().map(at).collect()
    };
    first.iter().flat_map(|a| second.iter().map(move |b| point(*a, *b))).collect()
}

/// Test vectors at the ends of the ranges, between them and beyond.
fn vectors(fitted: &Fitted, ranges: &[ValidRange]) -> Vec<Vector> {
    let clamped = |point: &[f64]| -> Vec<f64> {
        ranges.iter().zip(point).map(|(range, x)| x.clamp(range.low, range.high)).collect()
    };
    let vector = |point: Vec<f64>| Vector {
        expected: fitted.at(&clamped(&point)),
        at: ranges.iter().map(|range| range.marker).zip(point).collect(),
    };
    let shares = [0.0, 0.2, 0.5, 0.8, 1.0, 1.25];
    grid(ranges, &shares, &[0.0, 0.1, 0.3, 1.0, 2.0]).into_iter().map(vector).collect()
}

/// The curve with its intervals, on a grid over the ranges that is finer where closures bend.
fn curve(candidate: &Candidate, ranges: &[ValidRange]) -> Curve {
    let first = [0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];
    let points = grid(ranges, &first, &[0.05, 0.125, 0.25, 0.5, 1.0]);
    let estimates: Vec<_> = points.iter().map(|point| candidate.estimate(point)).collect();
    let column = |k: usize| points.iter().map(|point| point[k]).collect();
    Curve {
        value: estimates.iter().map(|e| e.value).collect(),
        low_95: estimates.iter().map(|e| e.low_95).collect(),
        high_95: estimates.iter().map(|e| e.high_95).collect(),
        at: ranges.iter().enumerate().map(|(k, range)| (range.marker, column(k))).collect(),
    }
}

impl ClosureFile {
    /// A fit as a closure file, from the run or runs `name` of `seed`.
    pub fn fitted(
        name: &str,
        candidate: &Candidate,
        seed: Option<u64>,
        system: Option<System>,
        definitions: Definitions,
    ) -> Self {
        let fitted = &candidate.fitted;
        let goodness = *fitted.goodness();
        let ranges: Vec<ValidRange> = fitted.ranges().iter().map(|range| ended(*range)).collect();
        let (formula, splines) = match fitted {
            Fitted::Form(fit) => (fit.form.expression().to_owned(), BTreeMap::new()),
            Fitted::Spline(fit) => {
                let splines = BTreeMap::from([("h".to_owned(), fit.spline.clone())]);
                ("h".to_owned(), splines)
            }
        };
        let constants = fitted.coefficients().iter().map(|c| (c.symbol.clone(), c.value)).collect();
        Self {
            name: name.into(),
            title: format!(
                "{} fitted by Favre to {} bins, R² = {:.3}",
                fitted.name(),
                goodness.points,
                goodness.r_squared
            ),
            status: Status::Full,
            missing: Vec::new(),
            reference_length: fitted.reference_length(),
            outside: Outside::Clamp,
            notes: candidate.notes.clone(),
            source: Provenance {
                reference: format!("run {name}"),
                read_from: format!("fit by favre {}", env!("CARGO_PKG_VERSION")),
                choices: Vec::new(),
            },
            definitions,
            system,
            constants,
            formulae: BTreeMap::new(),
            splines,
            fit: Some(FitFile {
                form: fitted.name().into(),
                formula: fitted.formula().into(),
                seed,
                held_out: candidate.held_out,
                replicates: candidate.replicates,
                covariance: fitted.covariance().to_vec(),
                goodness,
                coefficients: fitted.coefficients().to_vec(),
                // A surface has errors only by its replicates.
                curve: Some(curve(candidate, &ranges))
                    .filter(|curve| curve.low_95.iter().all(|low| low.is_finite())),
            }),
            quantities: vec![QuantityFile {
                predicts: fitted.quantity().into(),
                unit: fitted.unit().into(),
                formula,
                exponents: BTreeMap::new(),
                test_vectors: vectors(fitted, &ranges),
                ranges,
            }],
            known_flaws: Vec::new(),
        }
    }

    /// The file as TOML, with as many digits as give the same doubles back.
    ///
    /// # Errors
    /// A number that TOML does not have (a seed above 2⁶³ - 1).
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        toml::to_string(self)
    }
}

impl Closure {
    /// The closure named `name`, or the one in the file of that path.
    ///
    /// # Errors
    /// [`ClosureError`].
    pub fn find(name: &str) -> Result<Self, ClosureError> {
        if let Some((known, text)) = BUILT_IN.iter().find(|(known, _)| *known == name) {
            return Self::parse(text, Path::new(&format!("models/{known}.toml")));
        }
        let path = Path::new(name);
        if !path.is_file() && path.extension().is_none() && !name.contains('/') {
            let names = BUILT_IN.iter().map(|(name, _)| *name);
            let nearest = names
                .clone()
                .map(|known| (strsim::normalized_damerau_levenshtein(known, name), known))
                .filter(|(likeness, _)| *likeness > 0.4)
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .map(|(_, known)| known.to_owned());
            let known = names.collect::<Vec<_>>().join(", ");
            return Err(ClosureError::Unknown { name: name.into(), known, nearest });
        }
        let text = std::fs::read_to_string(path)
            .map_err(|why| ClosureError::Unreadable { path: path.into(), why })?;
        Self::parse(&text, path)
    }

    /// Reads and compiles the text of a closure file; `path` names it in errors. Test vectors are not
    /// compared: that is what the check is for.
    ///
    /// # Errors
    /// [`ClosureError`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, ClosureError> {
        let invalid = |e| ClosureError::Invalid { path: path.into(), why: Box::new(e) };
        Self::compile(toml::from_str(text).map_err(invalid)?, path)
    }

    fn compile(file: ClosureFile, path: &Path) -> Result<Self, ClosureError> {
        let wrong = |place: &str, why: String| ClosureError::Wrong {
            path: path.into(),
            place: place.into(),
            why,
        };
        let quantities = file.quantities.iter().map(|quantity| quantity.formula.len());
        let length: usize = file.formulae.values().map(String::len).chain(quantities).sum();
        if length > LONGEST {
            let why = format!("{length} characters, more than {LONGEST}");
            return Err(wrong("formulae", why));
        }
        if file.status == Status::Partial && file.missing.is_empty() {
            return Err(wrong("missing", "a partial closure says what it lacks".into()));
        }
        for name in file.constants.keys().chain(file.formulae.keys()) {
            if Marker::of_symbol(name).is_some() {
                let why = format!("`{name}` is the name of a marker; choose another");
                return Err(wrong("constants and formulae", why));
            }
            if file.constants.contains_key(name) && file.formulae.contains_key(name) {
                return Err(wrong(&format!("formulae.{name}"), "is a constant too".into()));
            }
        }
        check_fit(&file).map_err(|why| wrong("fit", why))?;
        let mut formulae = BTreeMap::new();
        for (name, text) in &file.formulae {
            let formula =
                Expression::parse(text).map_err(|why| wrong(&format!("formulae.{name}"), why))?;
            formulae.insert(name.clone(), formula);
        }
        for (name, spline) in &file.splines {
            let place = format!("splines.{name}");
            spline.check().map_err(|why| wrong(&place, why))?;
            for (name, text) in spline.formulae(name) {
                let taken = Marker::of_symbol(&name).is_some()
                    || file.constants.contains_key(&name)
                    || formulae.contains_key(&name);
                if taken {
                    return Err(wrong(&place, format!("`{name}` means something else here")));
                }
                let formula = Expression::parse(&text).map_err(|why| wrong(&place, why))?;
                formulae.insert(name, formula);
            }
        }
        let mut quantities: Vec<Quantity> = Vec::new();
        for quantity in &file.quantities {
            let place = format!("quantity {}", quantity.predicts);
            if quantities.iter().any(|other| other.file.predicts == quantity.predicts) {
                return Err(wrong(&place, "is given twice".into()));
            }
            let formula = Expression::parse(&quantity.formula).map_err(|why| wrong(&place, why))?;
            let program = compiled(&formula, &quantity.ranges, &file.constants, &formulae)
                .map_err(|why| wrong(&place, why))?;
            check_ranges(quantity).map_err(|why| wrong(&place, why))?;
            quantities.push(Quantity {
                file: quantity.clone(),
                formula,
                outside: file.outside,
                program,
            });
        }
        Ok(Self { file, quantities, formulae })
    }

    /// The quantity named `name`, or the first one.
    pub fn quantity(&self, name: Option<&str>) -> Option<&Quantity> {
        self.quantities.iter().find(|q| name.is_none_or(|name| q.file.predicts == name))
    }

    /// The named formula, as a tree.
    pub fn formula(&self, name: &str) -> Option<&Expression> {
        self.formulae.get(name)
    }

    /// A formula of this closure, compiled for the markers of `quantity`.
    ///
    /// # Errors
    /// As for [`Program::compile`].
    pub fn program(&self, formula: &Expression, quantity: &Quantity) -> Result<Program, String> {
        compiled(formula, &quantity.file.ranges, &self.file.constants, &self.formulae)
    }
}

fn compiled(
    formula: &Expression,
    ranges: &[ValidRange],
    constants: &BTreeMap<String, f64>,
    formulae: &BTreeMap<String, Expression>,
) -> Result<Program, String> {
    Program::compile(formula, ranges.len(), &|name| {
        if let Some(at) = ranges.iter().position(|range| range.marker.symbol() == name) {
            return Some(Meaning::Input(at));
        }
        let constant = constants.get(name).map(|value| Meaning::Constant(*value));
        constant.or_else(|| formulae.get(name).map(Meaning::Formula))
    })
    .map_err(|why| match why.split('`').nth(1).and_then(Marker::of_symbol) {
        Some(marker) => format!("{why}: it is {marker}, which has no range here"),
        None => why,
    })
}

/// Whether what the fit says belongs to the constants.
fn check_fit(file: &ClosureFile) -> Result<(), String> {
    let Some(fit) = &file.fit else { return Ok(()) };
    for Coefficient { symbol, value, low_95, high_95, standard_error, .. } in &fit.coefficients {
        match file.constants.get(symbol) {
            Some(constant) if constant == value => {}
            Some(constant) => {
                return Err(format!("coefficient {symbol} is {value}, the constant {constant}"));
            }
            None => return Err(format!("coefficient {symbol} is not among the constants")),
        }
        if !(low_95 <= value && value <= high_95 && *standard_error >= 0.0) {
            return Err(format!("coefficient {symbol}: {value} is not in {low_95} to {high_95}"));
        }
    }
    if let Some(Curve { value, low_95, high_95, at }) = &fit.curve {
        let mut columns = at.values().chain([low_95, high_95]);
        if let Some(other) = columns.find(|column| column.len() != value.len()) {
            let (one, other) = (value.len(), other.len());
            return Err(format!("columns of curve are of {one} and of {other} points"));
        }
    }
    let count = fit.coefficients.len();
    let good = |row: &Vec<f64>| row.len() == count && row.iter().all(|c| c.is_finite());
    match fit.covariance.len() == count && fit.covariance.iter().all(good) {
        true => Ok(()),
        false => Err(format!("covariance needs {count} rows of {count} numbers")),
    }
}

fn check_ranges(quantity: &QuantityFile) -> Result<(), String> {
    for (i, range) in quantity.ranges.iter().enumerate() {
        let marker = range.marker;
        if quantity.ranges[..i].iter().any(|other| other.marker == marker) {
            return Err(format!("{marker} has two ranges"));
        }
        let signed = marker == Marker::PressureGradient;
        if !(range.low < range.high && (signed || range.low >= 0.0) && range.high.is_finite()) {
            let (low, high) = (range.low, range.high);
            return Err(format!("range of {marker}: {low} to {high}, low < high is needed"));
        }
    }
    for (i, vector) in quantity.test_vectors.iter().enumerate() {
        let markers = quantity.ranges.iter().map(|range| range.marker);
        let given: Vec<Marker> = vector.at.keys().copied().collect();
        let fits =
            given.len() == quantity.ranges.len() && markers.clone().all(|m| given.contains(&m));
        if !fits || vector.at.values().any(|x| !x.is_finite()) || !vector.expected.is_finite() {
            let markers: Vec<String> = markers.map(|marker| marker.to_string()).collect();
            return Err(format!(
                "test vector {} needs a finite number for each of {}",
                i + 1,
                markers.join(", ")
            ));
        }
    }
    Ok(())
}

impl Quantity {
    /// The markers, in the order in which [`evaluate`](Self::evaluate) takes them.
    pub fn markers(&self) -> impl Iterator<Item = Marker> + '_ {
        self.file.ranges.iter().map(|range| range.marker)
    }

    /// The value at one point; markers outside their ranges are moved as the file says.
    pub fn at(&self, point: &[f64]) -> f64 {
        let moved: Vec<f64> =
            self.file.ranges.iter().zip(point).map(|(range, x)| self.moved(range, *x)).collect();
        self.program.at(&moved)
    }

    /// The value at each of `out.len()` points; `markers` are columns of so many numbers.
    ///
    /// # Panics
    /// Another number of markers, or columns of another length.
    pub fn evaluate(&self, markers: &[&[f64]], out: &mut [f64]) {
        self.program.evaluate_moved(markers, out, |number, numbers| {
            let range = &self.file.ranges[number];
            if self.outside == Outside::Clamp {
                numbers.iter_mut().for_each(|x| *x = self.moved(range, *x));
            }
        });
    }

    /// Whether a point lies inside the ranges.
    pub fn is_inside(&self, point: &[f64]) -> bool {
        self.file.ranges.iter().zip(point).all(|(r, x)| (r.low..=r.high).contains(x))
    }

    /// The point of a test vector, in the order of the markers.
    pub fn point(&self, vector: &Vector) -> Vec<f64> {
        self.markers().map(|marker| vector.at[&marker]).collect()
    }

    fn moved(&self, range: &ValidRange, x: f64) -> f64 {
        match self.outside {
            Outside::Clamp => x.clamp(range.low, range.high),
            Outside::Formula => x,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fit::tests::{WIDTHS, fitted, synthetic};
    use crate::model::tests::{candidate, model};
    use crate::refit::{Bins, Shape, refit};

    /// A fit of planted parameters with noise as a file.
    pub(crate) fn file() -> ClosureFile {
        let fit = candidate(fitted(&synthetic(&WIDTHS, 0.58, 0.02, 1)));
        let definitions = Definitions::favre("wen-yu");
        ClosureFile::fitted("base-drag", &fit, Some(7), Some(model().system), definitions)
    }

    #[test]
    fn what_is_shipped_loads_and_gives_its_test_vectors() {
        for (name, _) in BUILT_IN {
            let closure = Closure::find(name).unwrap();
            assert_eq!(closure.file.name, *name);
            let partial = closure.file.status == Status::Partial;
            assert!(partial || !closure.quantities.is_empty(), "{name}");
            for quantity in &closure.quantities {
                let vectors = &quantity.file.test_vectors;
                assert!(vectors.len() >= 4, "{name} {}", quantity.file.predicts);
                let points: Vec<Vec<f64>> = vectors.iter().map(|v| quantity.point(v)).collect();
                let columns: Vec<Vec<f64>> = (0..quantity.file.ranges.len())
                    .map(|m| points.iter().map(|point| point[m]).collect())
                    .collect();
                let columns: Vec<&[f64]> = columns.iter().map(|column| &column[..]).collect();
                let mut together = vec![0.0; vectors.len()];
                quantity.evaluate(&columns, &mut together);
                for ((vector, point), together) in vectors.iter().zip(&points).zip(together) {
                    let found = quantity.at(point);
                    let near =
                        (found - vector.expected).abs() <= 1e-12 * vector.expected.abs().max(1.0);
                    let predicts = &quantity.file.predicts;
                    assert!(near, "{name} {predicts} {point:?}: {found}, not {}", vector.expected);
                    assert_eq!(found.to_bits(), together.to_bits());
                }
            }
        }
    }

    /// The model that a fit found, and its file read again.
    #[test]
    fn a_fitted_model_is_the_same_closure() {
        let (model, file) = (model(), file());
        let text = file.to_toml().unwrap();
        let closure = Closure::parse(&text, Path::new("model.toml")).unwrap();
        assert_eq!(closure.file, file);
        assert_eq!(closure.file.to_toml().unwrap(), text);
        let coefficients = &model.candidate.coefficients;
        for (coefficient, again) in coefficients.iter().zip(&file.fit.unwrap().coefficients) {
            assert_eq!(coefficient.value.to_bits(), again.value.to_bits());
        }
        let ranges = &file.quantities[0].ranges;
        let vectors = &file.quantities[0].test_vectors;
        assert_eq!(vectors.len(), 30);
        let outside = |v: &&Vector| {
            ranges.iter().any(|range| !(range.low..=range.high).contains(&v.at[&range.marker]))
        };
        assert!(vectors.iter().filter(outside).count() >= 10);
        for i in 0..=70 {
            for width in [0.0, 0.1, 1.0, 3.0, 8.0, 20.0] {
                let phi = f64::from(i) * 0.01;
                let found = closure.quantities[0].at(&[phi, width]);
                assert!((found - model.evaluate(phi, width)).abs() < 1e-12, "{phi} {width}");
            }
        }
    }

    /// Bar 3 for the surface: its file loads and gives its test vectors.
    #[test]
    fn a_fitted_surface_is_a_closure() {
        let bins = Bins::of_tables(vec![synthetic(&WIDTHS, 0.58, 0.02, 1)], 60, 1);
        let found = refit(&bins, Shape::Spline).unwrap();
        let file = ClosureFile::fitted("s", &found, None, None, Definitions::favre("wen-yu"));
        let text = file.to_toml().unwrap();
        let closure = Closure::parse(&text, Path::new("model.toml")).unwrap();
        assert_eq!(closure.file, file);
        let quantity = &closure.quantities[0];
        assert_eq!(quantity.file.test_vectors.len(), 30);
        for vector in &quantity.file.test_vectors {
            let found = quantity.at(&quantity.point(vector));
            assert!((found - vector.expected).abs() < 1e-12, "{vector:?} {found}");
        }
        let curve = file.fit.unwrap().curve.unwrap();
        assert_eq!(curve.value.len(), 65);
        for (k, value) in curve.value.iter().enumerate() {
            let point = quantity.markers().map(|marker| curve.at[&marker][k]);
            let found = quantity.at(&point.collect::<Vec<f64>>());
            assert!((found - value).abs() < 1e-12, "{found} {value}");
            assert!(curve.low_95[k] <= *value && *value <= curve.high_95[k]);
        }
        let bad = text.replace("width_scale", "widht_scale");
        assert!(Closure::parse(&bad, Path::new("m.toml")).is_err());
    }

    #[test]
    fn a_fit_whose_numbers_do_not_belong_together_is_refused() {
        let spoil = |change: &dyn Fn(&mut ClosureFile)| {
            let mut file = file();
            change(&mut file);
            let text = file.to_toml().unwrap();
            Closure::parse(&text, Path::new("m.toml")).unwrap_err().to_string()
        };
        let fit = |file: &mut ClosureFile, change: &dyn Fn(&mut FitFile)| {
            change(file.fit.as_mut().unwrap());
        };
        let moved = spoil(&|file| *file.constants.get_mut("H_inf").unwrap() = 0.5);
        assert!(moved.starts_with("m.toml: fit: coefficient H_inf is "), "{moved}");
        assert!(moved.ends_with("the constant 0.5"), "{moved}");
        let other = spoil(&|file| fit(file, &|fit| fit.coefficients[0].symbol = "a".into()));
        assert_eq!(other, "m.toml: fit: coefficient a is not among the constants");
        let low = spoil(&|file| fit(file, &|fit| fit.coefficients[0].low_95 = 99.0));
        assert!(low.contains("is not in 99 to "), "{low}");
        let cut = |fit: &mut FitFile| fit.curve.as_mut().unwrap().low_95.truncate(3);
        let uneven = spoil(&|file| fit(file, &cut));
        assert!(uneven.ends_with("columns of curve are of 65 and of 3 points"), "{uneven}");
        let short = spoil(&|file| fit(file, &|fit| fit.covariance.truncate(5)));
        assert!(short.ends_with("covariance needs 6 rows of 6 numbers"), "{short}");
    }

    #[test]
    fn names_and_paths_are_found_or_refused() {
        let message = |name: &str| Closure::find(name).unwrap_err().to_string();
        assert!(message("miloli-2013").ends_with("did you mean milioli-2013?"));
        assert!(message("no/such.toml").starts_with("no/such.toml: "));
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("mine.toml");
        std::fs::write(&path, BUILT_IN[1].1).unwrap();
        let found = Closure::find(path.to_str().unwrap()).unwrap();
        assert_eq!(found.file.name, "igci-sundaresan-2011-2d");
        // And a file goes out as it came in.
        let again = toml::to_string(&found.file).unwrap();
        assert_eq!(Closure::parse(&again, &path).unwrap().file, found.file);
    }

    #[test]
    fn each_bad_file_is_refused_in_its_place() {
        let good = BUILT_IN.iter().find(|(name, _)| *name == "milioli-2013").unwrap().1;
        let swap = |from: &str, to: &str| {
            assert!(good.contains(from), "{from}");
            let text = good.replacen(from, to, 1);
            Closure::parse(&text, Path::new("m.toml")).unwrap_err().to_string()
        };
        let place = "m.toml: quantity drag_correction: ";
        assert_eq!(
            swap("max(h1_4, 0)", "max(h1_5, 0)"),
            format!("{place}`h1_5` is not known here")
        );
        assert!(
            swap("\"C_mu*D^2*S\"", "\"C_mu*D^2*S_g\"")
                .contains("gas_shear_rate, which has no range")
        );
        assert!(swap("0.0, high = 0.65", "0.7, high = 0.65").contains("0.7 to 0.65, low < high"));
        assert!(swap("phi*(0.59 - phi)", "phi*(0.59 - phi").contains("formulae.C_mu: "));
        assert!(swap("h1_2 = ", "phi = ").contains("`phi` is the name of a marker"));
        assert!(
            swap("predicts = \"solids_pressure\"", "predicts = \"drag_correction\"")
                .contains("twice")
        );
        assert!(
            swap("slip = 0.05 }", "slip = inf }").contains("test vector 1 needs a finite number")
        );
        assert!(swap("unit = \"-\"", "unti = \"-\"").contains("unknown field `unti`"));
        assert!(swap("status = \"full\"", "status = \"partial\"").contains("says what it lacks"));
    }
}
