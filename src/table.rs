//! Tables on disk: [`BinRow`], one row of the bin table, the durable form between statistics and
//! fit; [`ClosureRow`], one row of the evaluated table that a coarse solver interpolates.
//!
//! Both are CSV with one header line; numbers are written with as many digits as give the same
//! double back, `inf` and `-inf` for open ends.

use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A bin table that cannot be read.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file cannot be opened or read, or a line has the wrong number of fields.
    #[error("{path}: {source}")]
    Unreadable {
        /// File.
        path: PathBuf,
        /// What the CSV reader says, with the line.
        source: csv::Error,
    },
    /// A column is not there.
    #[error("{path}: line 1: column `{column}` is missing; a bin table has: {expected}")]
    MissingColumn {
        /// File.
        path: PathBuf,
        /// The column.
        column: &'static str,
        /// All columns.
        expected: String,
    },
    /// A column that a bin table does not have, or has twice.
    #[error("{path}: line 1: column `{column}` is unknown or given twice; remove it")]
    ExtraColumn {
        /// File.
        path: PathBuf,
        /// The column.
        column: String,
    },
    /// A field that is no such number, or a number that cannot be.
    #[error("{path}: line {line}, column `{column}`: `{value}`: {why}")]
    BadValue {
        /// File.
        path: PathBuf,
        /// Line, the header being line 1.
        line: u64,
        /// Column.
        column: String,
        /// The field as it stands in the file.
        value: String,
        /// What is wrong with it.
        why: String,
    },
    /// There is a header and nothing else.
    #[error("{path}: no rows; did the run sample any filter position?")]
    Empty {
        /// File.
        path: PathBuf,
    },
}

/// One quantity at one filter width in one bin. A CSV column's header is the field's symbol and
/// its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BinRow {
    /// What is given: `drag_correction`, `solids_viscosity`, ... (see `filtered::QUANTITIES`).
    pub quantity: String,
    /// Unit of `value`, `standard_error` and the interval; `-` for a number.
    pub unit: String,
    /// Δ_f \[m\].
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
    /// Mean filtered slip speed / u_t of the samples in the bin [-].
    #[serde(rename = "slip_speed/u_t [-]")]
    pub slip_speed: f64,
    /// Lower edge of the bin of it [-]; -inf if it is no marker.
    #[serde(rename = "slip_speed_low/u_t [-]")]
    pub slip_speed_low: f64,
    /// Upper edge of that bin [-]; inf if it is no marker.
    #[serde(rename = "slip_speed_high/u_t [-]")]
    pub slip_speed_high: f64,
    /// Mean vertical filtered pressure gradient / (ρ_s g) of the samples in the bin [-]; "not a number" if the pressure is not known.
    #[serde(rename = "pressure_gradient/(rho_s g) [-]")]
    pub pressure_gradient: f64,
    /// Lower edge of the bin of it [-]; -inf if it is no marker.
    #[serde(rename = "pressure_gradient_low/(rho_s g) [-]")]
    pub pressure_gradient_low: f64,
    /// Upper edge of that bin [-]; inf if it is no marker.
    #[serde(rename = "pressure_gradient_high/(rho_s g) [-]")]
    pub pressure_gradient_high: f64,
    /// Mean shear rate S of the filtered solids velocity × u_t/g of the samples in the bin [-].
    #[serde(rename = "shear_rate*u_t/g [-]")]
    pub shear_rate: f64,
    /// Lower edge of the bin of it [-]; -inf if it is no marker.
    #[serde(rename = "shear_rate_low*u_t/g [-]")]
    pub shear_rate_low: f64,
    /// Upper edge of that bin [-]; inf if it is no marker.
    #[serde(rename = "shear_rate_high*u_t/g [-]")]
    pub shear_rate_high: f64,
    /// Mean \|∇φ̄\| × L_I of the samples in the bin [-].
    #[serde(rename = "solids_fraction_gradient*L_I [-]")]
    pub fraction_gradient: f64,
    /// Lower edge of the bin of it [-]; -inf if it is no marker.
    #[serde(rename = "solids_fraction_gradient_low*L_I [-]")]
    pub fraction_gradient_low: f64,
    /// Upper edge of that bin [-]; inf if it is no marker.
    #[serde(rename = "solids_fraction_gradient_high*L_I [-]")]
    pub fraction_gradient_high: f64,
    /// Mean sub-filter variance of φ of the samples in the bin [-].
    #[serde(rename = "solids_fraction_variance [-]")]
    pub variance: f64,
    /// Lower edge of the bin of it [-]; -inf if it is no marker.
    #[serde(rename = "solids_fraction_variance_low [-]")]
    pub variance_low: f64,
    /// Upper edge of that bin [-]; inf if it is no marker.
    #[serde(rename = "solids_fraction_variance_high [-]")]
    pub variance_high: f64,
    /// Where runs on several grids were pooled, of which `value` is that on the finest: the value on
    /// infinitely fine cells.
    #[serde(default)]
    pub extrapolated: Option<f64>,
    /// Its standard error from sampling, an observed order of convergence and misfit included.
    #[serde(default)]
    pub extrapolated_standard_error: Option<f64>,
    /// Grid error of the finest grid, `value` − `extrapolated`.
    #[serde(default)]
    pub grid_error: Option<f64>,
    /// Its standard error, likewise.
    #[serde(default)]
    pub grid_standard_error: Option<f64>,
}

impl BinRow {
    /// Quantity, and filter width and lower edges of the bin, as their bits: what rows of different
    /// tables are compared by.
    pub fn bin(&self) -> (&str, [u64; 8]) {
        let lower = [
            self.filter_width,
            self.solids_fraction_low,
            self.slip_low,
            self.slip_speed_low,
            self.pressure_gradient_low,
            self.shear_rate_low,
            self.fraction_gradient_low,
            self.variance_low,
        ];
        (&self.quantity, lower.map(f64::to_bits))
    }
}

/// Columns of a bin table, in the order of [`BinRow`]'s fields. The last four are empty where there was
/// one grid only, and may be missing.
pub const BIN_COLUMNS: [&str; 37] = [
    "quantity",
    "unit",
    "filter_width [m]",
    "filter_width/L_I [-]",
    "filter_width/L_II [-]",
    "solids_fraction [-]",
    "solids_fraction_low [-]",
    "solids_fraction_high [-]",
    "slip/u_t [-]",
    "slip_low/u_t [-]",
    "slip_high/u_t [-]",
    "value",
    "standard_error",
    "low_95",
    "high_95",
    "value_scaled [-]",
    "samples",
    "effective_samples",
    "slip_speed/u_t [-]",
    "slip_speed_low/u_t [-]",
    "slip_speed_high/u_t [-]",
    "pressure_gradient/(rho_s g) [-]",
    "pressure_gradient_low/(rho_s g) [-]",
    "pressure_gradient_high/(rho_s g) [-]",
    "shear_rate*u_t/g [-]",
    "shear_rate_low*u_t/g [-]",
    "shear_rate_high*u_t/g [-]",
    "solids_fraction_gradient*L_I [-]",
    "solids_fraction_gradient_low*L_I [-]",
    "solids_fraction_gradient_high*L_I [-]",
    "solids_fraction_variance [-]",
    "solids_fraction_variance_low [-]",
    "solids_fraction_variance_high [-]",
    "extrapolated",
    "extrapolated_standard_error",
    "grid_error",
    "grid_standard_error",
];

/// How many of them must be there.
const REQUIRED_COLUMNS: usize = 33;

/// One quantity at one filter width and one filtered solids fraction: long format, so that any
/// quantity fits in. A solver reads the rows of one `quantity`, which form a full grid of filter
/// widths and solids fractions where `origin` is `fit`, and the occupied bins where it is `bins`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClosureRow {
    /// What is given, as in the bin table.
    pub quantity: String,
    /// Unit of `value`, `standard_error` and the interval; `-` for a number.
    pub unit: String,
    /// Where the value comes from.
    pub origin: Origin,
    /// Δ_f \[m\].
    #[serde(rename = "filter_width [m]")]
    pub filter_width: f64,
    /// Δ_f / L_I [-].
    #[serde(rename = "filter_width/L_I [-]")]
    pub filter_width_l_i: f64,
    /// Δ_f / L_II [-].
    #[serde(rename = "filter_width/L_II [-]")]
    pub filter_width_l_ii: f64,
    /// Filtered solids fraction [-].
    #[serde(rename = "solids_fraction [-]")]
    pub solids_fraction: f64,
    /// Value.
    pub value: f64,
    /// Standard error of the value.
    pub standard_error: f64,
    /// Lower end of the 95 % interval.
    pub low_95: f64,
    /// Upper end of the 95 % interval.
    pub high_95: f64,
    /// Whether the point lies inside the range of the data; outside, the value is that of the
    /// nearest point inside.
    pub inside_range: bool,
}

/// Where a value of a closure table comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Origin {
    /// A fitted form, evaluated.
    Fit,
    /// The bin table, for a quantity that has no form.
    Bins,
}

/// Writes rows ([`BinRow`] or [`ClosureRow`]) as CSV with a header; nothing for no rows.
///
/// # Errors
/// What the writer reports.
pub fn write_rows<T: Serialize>(rows: &[T], writer: impl Write) -> Result<(), csv::Error> {
    let mut csv = csv::Writer::from_writer(writer);
    for row in rows {
        csv.serialize(row)?;
    }
    csv.flush()?;
    Ok(())
}

/// Reads a bin table from a file.
///
/// # Errors
/// [`TableError`] when the file cannot be read, or as for [`parse_bins`].
pub fn read_bins(path: &Path) -> Result<Vec<BinRow>, TableError> {
    parse_bins(open(path)?, path)
}

/// Reads the rows of a bin table whose quantity is `wanted`; the others, read past, may hold anything.
/// There may be none.
///
/// # Errors
/// As for [`read_bins`].
pub fn read_bins_of(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Vec<BinRow>, TableError> {
    parse_bins_of(open(path)?, path, wanted)
}

/// Reads the rows of a closure table whose quantity is `wanted` and whose values are a form's; there
/// may be none.
///
/// # Errors
/// [`TableError::Unreadable`] when the file cannot be read or is no closure table.
pub fn read_closures_of(
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Vec<ClosureRow>, TableError> {
    let unreadable = |source| TableError::Unreadable { path: path.into(), source };
    let mut table = csv::Reader::from_reader(open(path)?);
    let headers = table.headers().map_err(unreadable)?.clone();
    let mut rows = Vec::new();
    for record in table.records() {
        let record = record.map_err(unreadable)?;
        // Quantity and origin stand first and third.
        if record.get(0).is_some_and(wanted) && record.get(2) == Some("fit") {
            rows.push(record.deserialize(Some(&headers)).map_err(unreadable)?);
        }
    }
    Ok(rows)
}

fn open(path: &Path) -> Result<File, TableError> {
    File::open(path).map_err(|e| TableError::Unreadable { path: path.into(), source: e.into() })
}

/// Reads a bin table, in whatever order its columns stand; `path` names it in errors.
///
/// # Errors
/// [`TableError`] for a missing or extra column, a field that is no number or not a possible one
/// (NaN, negative error, fraction outside 0 to 1, empty bin), or a table without rows.
pub fn parse_bins(reader: impl Read, path: &Path) -> Result<Vec<BinRow>, TableError> {
    let rows = parse_bins_of(reader, path, &|_| true)?;
    if rows.is_empty() {
        return Err(TableError::Empty { path: path.into() });
    }
    Ok(rows)
}

fn parse_bins_of(
    reader: impl Read,
    path: &Path,
    wanted: &dyn Fn(&str) -> bool,
) -> Result<Vec<BinRow>, TableError> {
    let unreadable = |source| TableError::Unreadable { path: path.into(), source };
    let mut csv = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(reader);
    let headers = csv.headers().map_err(unreadable)?.clone();
    for (i, column) in headers.iter().enumerate() {
        if !BIN_COLUMNS.contains(&column) || headers.iter().take(i).any(|other| other == column) {
            return Err(TableError::ExtraColumn { path: path.into(), column: column.into() });
        }
    }
    if let Some(column) =
        BIN_COLUMNS[..REQUIRED_COLUMNS].iter().find(|c| !headers.iter().any(|h| h == **c))
    {
        let expected = BIN_COLUMNS.join(", ");
        return Err(TableError::MissingColumn { path: path.into(), column, expected });
    }
    let quantity = headers.iter().position(|header| header == "quantity");
    let mut rows = Vec::new();
    for record in csv.records() {
        let record = record.map_err(unreadable)?;
        if quantity.and_then(|i| record.get(i)).is_some_and(|quantity| !wanted(quantity)) {
            continue;
        }
        let line = record.position().map_or(0, |position| position.line());
        let bad = |column: &str, why: String| {
            let field = headers.iter().position(|header| header == column);
            TableError::BadValue {
                path: path.into(),
                line,
                column: column.into(),
                value: field.and_then(|i| record.get(i)).unwrap_or_default().into(),
                why,
            }
        };
        let row: BinRow =
            record.deserialize(Some(&headers)).map_err(|error| match error.kind() {
                csv::ErrorKind::Deserialize { err, .. } => {
                    let column = err.field().and_then(|i| headers.get(i as usize)).unwrap_or("?");
                    bad(column, err.kind().to_string())
                }
                _ => unreadable(error),
            })?;
        if let Some((column, why)) = impossible(&row) {
            return Err(bad(column, why.into()));
        }
        rows.push(row);
    }
    Ok(rows)
}

/// The first column of a row whose number cannot be, and why.
fn impossible(row: &BinRow) -> Option<(&'static str, &'static str)> {
    let numbers = [
        row.filter_width,
        row.filter_width_l_i,
        row.filter_width_l_ii,
        row.solids_fraction,
        row.solids_fraction_low,
        row.solids_fraction_high,
        row.slip,
        row.slip_low,
        row.slip_high,
        row.value,
        row.standard_error,
        row.low_95,
        row.high_95,
        row.value_scaled,
    ];
    for (column, x) in BIN_COLUMNS[2..16].iter().zip(numbers) {
        if x.is_nan() {
            return Some((column, "not a number"));
        }
        let open_end = column.contains("_low") || column.contains("_high");
        if x.is_infinite() && !open_end && !["standard_error", "low_95", "high_95"].contains(column)
        {
            return Some((column, "must be finite"));
        }
    }
    for (column, x) in BIN_COLUMNS[2..5].iter().zip(numbers) {
        if x <= 0.0 {
            return Some((column, "must be positive"));
        }
    }
    if !(0.0..=1.0).contains(&row.solids_fraction) {
        return Some((BIN_COLUMNS[5], "must lie between 0 and 1"));
    }
    if row.standard_error < 0.0 {
        return Some((BIN_COLUMNS[12], "a standard error cannot be negative"));
    }
    if row.effective_samples.is_nan() || row.effective_samples < 0.0 {
        return Some((BIN_COLUMNS[17], "must be a number that is not negative"));
    }
    let edges = [
        [row.slip_speed_low, row.slip_speed_high],
        [row.pressure_gradient_low, row.pressure_gradient_high],
        [row.shear_rate_low, row.shear_rate_high],
        [row.fraction_gradient_low, row.fraction_gradient_high],
        [row.variance_low, row.variance_high],
    ];
    for (marker, [low, high]) in edges.into_iter().enumerate() {
        if low >= high || low.is_nan() || high.is_nan() {
            return Some((BIN_COLUMNS[19 + 3 * marker], "must be a number below the upper edge"));
        }
    }
    let of_grids = [
        row.extrapolated,
        row.extrapolated_standard_error,
        row.grid_error,
        row.grid_standard_error,
    ];
    for (column, x) in BIN_COLUMNS[REQUIRED_COLUMNS..].iter().zip(of_grids) {
        if x.is_some_and(|x| !x.is_finite()) {
            return Some((column, "must be finite, or empty"));
        }
    }
    None
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A row of the drag correction.
    pub(crate) fn row(width: f64, phi: f64, value: f64, standard_error: f64) -> BinRow {
        BinRow {
            quantity: "drag_correction".into(),
            unit: "-".into(),
            filter_width: width * 4.865e-3,
            filter_width_l_i: width,
            filter_width_l_ii: width * 16.15,
            solids_fraction: phi,
            solids_fraction_low: phi - 0.01,
            solids_fraction_high: phi + 0.01,
            slip: 1.5,
            slip_low: f64::NEG_INFINITY,
            slip_high: f64::INFINITY,
            value,
            standard_error,
            low_95: value - 2.0 * standard_error,
            high_95: value + 2.0 * standard_error,
            value_scaled: value,
            samples: 1000,
            effective_samples: 20.5,
            slip_speed: 0.5,
            slip_speed_low: f64::NEG_INFINITY,
            slip_speed_high: f64::INFINITY,
            pressure_gradient: 0.5,
            pressure_gradient_low: f64::NEG_INFINITY,
            pressure_gradient_high: f64::INFINITY,
            shear_rate: 0.5,
            shear_rate_low: f64::NEG_INFINITY,
            shear_rate_high: f64::INFINITY,
            fraction_gradient: 0.5,
            fraction_gradient_low: f64::NEG_INFINITY,
            fraction_gradient_high: f64::INFINITY,
            variance: 0.5,
            variance_low: f64::NEG_INFINITY,
            variance_high: f64::INFINITY,
            extrapolated: None,
            extrapolated_standard_error: None,
            grid_error: None,
            grid_standard_error: None,
        }
    }

    fn written(rows: &[BinRow]) -> String {
        let mut bytes = Vec::new();
        write_rows(rows, &mut bytes).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    fn parsed(text: &str) -> Result<Vec<BinRow>, TableError> {
        parse_bins(text.as_bytes(), Path::new("bins.csv"))
    }

    fn message(text: &str) -> String {
        parsed(text).unwrap_err().to_string()
    }

    #[test]
    fn header_carries_symbols_and_units() {
        assert_eq!(
            written(&[row(1.0, 0.1, 0.5, 0.1)]).lines().next(),
            Some(&*BIN_COLUMNS.join(","))
        );
    }

    #[test]
    fn columns_may_stand_in_any_order() {
        let text = written(&[row(1.0, 0.1, 0.5, 0.1)]);
        let reversed: Vec<String> =
            text.lines().map(|line| line.split(',').rev().collect::<Vec<_>>().join(",")).collect();
        assert_eq!(parsed(&reversed.join("\n")).unwrap(), [row(1.0, 0.1, 0.5, 0.1)]);
    }

    #[test]
    fn each_bad_table_is_refused_in_its_place() {
        let good = row(1.0, 0.1, 0.5, 0.1);
        let text = written(&[good.clone(), good.clone()]);
        let spoil = |change: &dyn Fn(&mut BinRow)| {
            let mut bad = good.clone();
            change(&mut bad);
            message(&written(&[good.clone(), bad]))
        };
        assert_eq!(
            spoil(&|r| r.value = f64::NAN),
            "bins.csv: line 3, column `value`: `NaN`: not a number"
        );
        assert_eq!(
            spoil(&|r| r.standard_error = -0.25),
            "bins.csv: line 3, column `standard_error`: `-0.25`: a standard error cannot be negative"
        );
        assert_eq!(
            spoil(&|r| r.filter_width = 0.0),
            "bins.csv: line 3, column `filter_width [m]`: `0.0`: must be positive"
        );
        assert_eq!(
            spoil(&|r| r.solids_fraction = 1.5),
            "bins.csv: line 3, column `solids_fraction [-]`: `1.5`: must lie between 0 and 1"
        );
        assert_eq!(
            spoil(&|r| r.value = f64::INFINITY),
            "bins.csv: line 3, column `value`: `inf`: must be finite"
        );
        assert_eq!(
            spoil(&|r| r.shear_rate_low = f64::NAN),
            "bins.csv: line 3, column `shear_rate_low*u_t/g [-]`: `NaN`: must be a number below the \
             upper edge"
        );
        assert_eq!(
            message(&text.replacen(",0.5,", ",half,", 1)),
            "bins.csv: line 2, column `value`: `half`: invalid float literal"
        );
        assert!(
            message(&text.replace("standard_error", "sigma"))
                .starts_with("bins.csv: line 1: column `sigma` is unknown or given twice")
        );
        // Tables of before there were several grids have no columns for them.
        let without = |columns: usize| {
            let fields = |line: &str| {
                line.split(',').take(BIN_COLUMNS.len() - columns).collect::<Vec<_>>().join(",")
            };
            text.lines().map(fields).collect::<Vec<_>>().join("\n")
        };
        assert_eq!(parsed(&without(4)).unwrap(), [good.clone(), good.clone()]);
        assert!(message(&without(5)).starts_with(
            "bins.csv: line 1: column `solids_fraction_variance_high [-]` is missing"
        ));
        assert_eq!(
            spoil(&|r| r.grid_error = Some(f64::INFINITY)),
            "bins.csv: line 3, column `grid_error`: `inf`: must be finite, or empty"
        );
        let mut extrapolated = good.clone();
        extrapolated.extrapolated = Some(0.25);
        assert_eq!(parsed(&written(&[extrapolated.clone()])).unwrap(), [extrapolated]);
        assert!(message(text.lines().next().unwrap()).starts_with("bins.csv: no rows"));
        let missing = read_bins(Path::new("no/such/bins.csv")).unwrap_err().to_string();
        assert!(missing.starts_with("no/such/bins.csv: "), "{missing}");
        let ragged = message(&format!("{text}1,2\n"));
        assert!(ragged.contains("line: 4"), "{ragged}");
    }

    proptest! {
        #[test]
        fn tables_round_trip_bit_for_bit(
            values in prop::collection::vec((any::<f64>(), 0.0..1e3, 0.0..1.0, 1e-9..1e9), 1..5)
        ) {
            let rows: Vec<BinRow> = values
                .into_iter()
                .filter(|(value, ..)| value.is_finite())
                .map(|(value, error, phi, width)| row(width, phi, value, error))
                .collect();
            prop_assume!(!rows.is_empty());
            let again = parsed(&written(&rows)).unwrap();
            for (a, b) in rows.iter().zip(&again) {
                prop_assert_eq!(a.value.to_bits(), b.value.to_bits());
                prop_assert_eq!(a, b);
            }
        }
    }
}
