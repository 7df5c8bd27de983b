//! [`Case`]: what is to be computed, resolved to SI.

use crate::laws::scales::{Gas, Powder};

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
