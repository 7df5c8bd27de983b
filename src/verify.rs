//! [`verify`]: does the simulator solve its equations?
//!
//! Each check runs the simulator, or a part of it, where the answer is known from elsewhere: a
//! chosen solution, an analytic one, an independent integration, linear theory, a symmetry. A check
//! is a function that returns rows; a row is one number, what it must be, and from where that is
//! known.

mod cfd_dem;
mod cooling;
mod decay;
mod dem;
mod dual;
mod front;
mod growth;
mod manufactured;
mod pressure;
mod shear;
mod symmetry;

use crate::case::{DragChoice, FrictionChoice, RadialDistributionChoice, Terms};
use crate::laws::scales::{Gas, Powder};
use crate::two_fluid::Setup;
use serde::Serialize;
use std::error::Error;
use std::fmt;

/// What a number must be.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Expected {
    /// No less.
    AtLeast(f64),
    /// No more.
    AtMost(f64),
    /// Within a share of a value.
    Near {
        /// The value.
        value: f64,
        /// The share.
        within: f64,
    },
}

impl Expected {
    /// Whether `found` is what is expected; what is not a number never is.
    pub fn holds(self, found: f64) -> bool {
        match self {
            Self::AtLeast(least) => found >= least,
            Self::AtMost(most) => found <= most,
            Self::Near { value, within } => (found - value).abs() <= within * value.abs(),
        }
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::AtLeast(least) => write!(f, ">= {}", number(least)),
            Self::AtMost(most) => write!(f, "<= {}", number(most)),
            Self::Near { value, within } => {
                write!(f, "{} within {} %", number(value), number(100.0 * within))
            }
        }
    }
}

/// Four digits, with an exponent where that is shorter.
fn number(x: f64) -> String {
    let size = x.abs();
    if x == 0.0 || (1e-3..1e5).contains(&size) {
        let digits = if x == 0.0 { 0.0 } else { 3.0 - size.log10().floor() };
        let text = format!("{x:.*}", digits.clamp(0.0, 6.0) as usize);
        let short = if text.contains('.') { text.trim_end_matches('0') } else { &text };
        short.trim_end_matches('.').to_owned()
    } else {
        format!("{x:.2e}")
    }
}

/// One number of a check.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The check's name.
    pub check: &'static str,
    /// What was measured.
    pub quantity: String,
    /// What it must be; none if the check could not be done.
    pub expected: Option<Expected>,
    /// What it is.
    pub found: f64,
    /// How it was come by: errors behind an order, the source of what is expected.
    pub detail: String,
    /// Whether it is what it must be.
    pub pass: bool,
}

impl Row {
    fn new(quantity: impl Into<String>, expected: Expected, found: f64) -> Self {
        let (quantity, pass) = (quantity.into(), expected.holds(found));
        Self { check: "", quantity, expected: Some(expected), found, detail: String::new(), pass }
    }

    fn with(mut self, detail: impl Into<String>) -> Self {
        self.detail = detail.into();
        self
    }
}

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// What takes less than a minute.
    Quick,
    /// Everything.
    Full,
}

/// A check: its name, what it asks, and the function that does it.
struct Check {
    name: &'static str,
    run: fn(Effort) -> Checked,
}

/// The rows of a check, or why it could not be done.
type Checked = Result<Vec<Row>, Box<dyn Error>>;

/// The founding paper's powder in air, uniform.
fn setup(solids_fraction: f64) -> Setup {
    Setup {
        powder: Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 },
        gas: Gas { density: 1.3, viscosity: 1.8e-5 },
        gravity: 9.81,
        drag: DragChoice::WenYu,
        radial_distribution: RadialDistributionChoice::Princeton,
        friction: FrictionChoice::Barrier,
        terms: Terms::default(),
        solids_fraction,
        perturbation: 0.0,
        seed: 0,
        parallel: false,
    }
}

/// All checks.
const CHECKS: [Check; 12] = [
    Check { name: "manufactured", run: manufactured::check },
    Check { name: "growth", run: growth::check },
    Check { name: "cooling", run: cooling::check },
    Check { name: "decay", run: decay::check },
    Check { name: "shear", run: shear::check },
    Check { name: "front", run: front::check },
    Check { name: "symmetry", run: symmetry::check },
    Check { name: "conservation", run: symmetry::conservation },
    Check { name: "moving-frame", run: symmetry::moving_frame },
    Check { name: "pressure", run: pressure::check },
    Check { name: "dem", run: dem::check },
    Check { name: "cfd-dem", run: cfd_dem::check },
];

/// What was verified.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Version of the program.
    pub version: &'static str,
    /// Whether every row passes.
    pub pass: bool,
    /// The numbers.
    pub rows: Vec<Row>,
}

/// A check that there is not.
#[derive(Clone, Debug, thiserror::Error)]
#[error("there is no check {name:?}; the checks are {known}")]
pub struct UnknownCheck {
    /// What was asked for.
    pub name: String,
    /// What there is.
    pub known: String,
}

/// The names of the checks, in order.
pub fn names() -> impl Iterator<Item = &'static str> {
    CHECKS.iter().map(|check| check.name)
}

/// Does the checks named in `only`, or all if it is empty, and tells `progress` of each before it
/// begins. A check that cannot be done to its end is a row that does not pass.
///
/// # Errors
/// A name in `only` is not that of a check.
pub fn verify(
    only: &[String],
    effort: Effort,
    mut progress: impl FnMut(&str),
) -> Result<Report, UnknownCheck> {
    if let Some(name) = only.iter().find(|&name| names().all(|known| known != name)) {
        let known = names().collect::<Vec<_>>().join(", ");
        return Err(UnknownCheck { name: name.clone(), known });
    }
    let mut rows = Vec::new();
    for check in &CHECKS {
        if !only.is_empty() && only.iter().all(|name| name != check.name) {
            continue;
        }
        progress(check.name);
        let found = (check.run)(effort).unwrap_or_else(|error| {
            vec![Row {
                check: "",
                quantity: "ran to its end".into(),
                expected: None,
                found: f64::NAN,
                detail: error.to_string(),
                pass: false,
            }]
        });
        rows.extend(found.into_iter().map(|row| Row { check: check.name, ..row }));
    }
    let pass = rows.iter().all(|row| row.pass);
    Ok(Report { version: env!("CARGO_PKG_VERSION"), pass, rows })
}

impl Report {
    /// How many rows do not pass.
    pub fn failed(&self) -> usize {
        self.rows.iter().filter(|row| !row.pass).count()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let header = ["check", "quantity", "expected", "found", "", "from"].map(String::from);
        let mut table = vec![header];
        for row in &self.rows {
            let expected = row.expected.map_or_else(String::new, |expected| expected.to_string());
            let verdict = if row.pass { "pass" } else { "FAIL" };
            table.push([
                row.check.into(),
                row.quantity.clone(),
                expected,
                number(row.found),
                verdict.into(),
                row.detail.clone(),
            ]);
        }
        let width: [usize; 6] = std::array::from_fn(|n| {
            table.iter().map(|row| row[n].chars().count()).max().unwrap_or_default()
        });
        for row in &table {
            let line: Vec<String> =
                row.iter().zip(width).map(|(cell, width)| format!("{cell:width$}")).collect();
            writeln!(f, "{}", line.join("  ").trim_end())?;
        }
        write!(f, "{} of {} pass", self.rows.len() - self.failed(), self.rows.len())
    }
}
