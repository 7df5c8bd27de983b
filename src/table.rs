//! [`BinRow`]: one row of the bin table, the durable form between statistics and fit.

use serde::{Deserialize, Serialize};

/// One quantity at one filter width in one bin. A CSV column's header is the field's symbol and
/// its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BinRow {
    /// What is given: `drag_correction`, `solids_viscosity`, ... (see `filtered::QUANTITIES`).
    pub quantity: String,
    /// Unit of `value`, `standard_error` and the interval; `-` for a number.
    pub unit: String,
    /// Δ_f [m].
    #[serde(rename = "filter_width [m]")]
    pub filter_width: f64,
    /// Δ_f / L_I [-].
    #[serde(rename = "filter_width/L_I [-]")]
    pub filter_width_l_i: f64,
    /// Δ_f / L_II [-].
    #[serde(rename = "filter_width/L_II [-]")]
    pub filter_width_l_ii: f64,
    /// Mean filtered solids fraction of the samples in the bin [-].
    #[serde(rename = "solids_fraction [-]")]
    pub solids_fraction: f64,
    /// Lower edge of the bin of filtered solids fraction [-].
    #[serde(rename = "solids_fraction_low [-]")]
    pub solids_fraction_low: f64,
    /// Upper edge of that bin [-].
    #[serde(rename = "solids_fraction_high [-]")]
    pub solids_fraction_high: f64,
    /// Mean vertical filtered slip of the samples in the bin, scaled by u_t [-].
    #[serde(rename = "slip/u_t [-]")]
    pub slip: f64,
    /// Lower edge of the bin of vertical filtered slip / u_t [-]; -inf without slip bins.
    #[serde(rename = "slip_low/u_t [-]")]
    pub slip_low: f64,
    /// Upper edge of that bin [-]; inf without slip bins.
    #[serde(rename = "slip_high/u_t [-]")]
    pub slip_high: f64,
    /// Value.
    pub value: f64,
    /// Standard error of the value, from blocks of time, not from overlapping filter positions.
    pub standard_error: f64,
    /// Lower end of the 95 % interval.
    pub low_95: f64,
    /// Upper end of the 95 % interval.
    pub high_95: f64,
    /// Value in scaled units (stress ρ_s u_t², viscosity ρ_s u_t³/g, velocity u_t).
    #[serde(rename = "value_scaled [-]")]
    pub value_scaled: f64,
    /// Filter positions that fell into the bin.
    pub samples: u64,
    /// Independent samples that would give the same standard error.
    pub effective_samples: f64,
}
