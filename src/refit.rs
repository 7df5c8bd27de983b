//! [`refit`]: forms fitted to runs put together, with intervals from replicates and scores on runs that
//! the fit has not seen.
//!
//! - **Intervals.** Every form is fitted again to each bootstrap replicate of the whole bin table
//!   ([`replicates`](crate::replicates)), so that the correlation of bins is in them; ends are the 2.5 and
//!   97.5 % quantiles over replicates, and the covariance of the coefficients is theirs.
//! - **Scores.** Each run is left out once: the form is fitted to the bins of the others and compared with
//!   those of the one, a bin counting as many times as filter positions fell into it. The score is
//!   1 - Σ n (value - predicted)²/Σ n (value - mean)². Runs of one mean fraction held out against others
//!   ask more of a form than bins held out would: they see another box.

use crate::fit::{Fit, FitError, ReferenceLength, fit, fit_from, marker_of};
use crate::forms::{ClosureForm, Marker};
use crate::laws::scales::Scales;
use crate::replicates::{ReplicateError, replicate, standard_deviation};
use crate::spline::{SplineFit, fit_spline};
use crate::statistics::{MergeError, Sums, bin_table_among};
use crate::sums::RunSums;
use crate::table::BinRow;
use serde::Serialize;
use std::fmt;

/// What can be fitted.
#[derive(Clone, Copy, Debug)]
pub enum Shape {
    /// A form with parameters.
    Form(&'static dyn ClosureForm),
    /// The surface that needs none, for the drag correction.
    Spline,
}

impl Shape {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Form(form) => form.name(),
            Self::Spline => "spline",
        }
    }

    /// The quantity that it describes.
    pub fn quantity(self) -> &'static str {
        match self {
            Self::Form(form) => form.quantity(),
            Self::Spline => "drag_correction",
        }
    }

    fn fit(self, rows: &[BinRow], start: Option<&Fitted>) -> Result<Fitted, FitError> {
        Ok(match (self, start) {
            (Self::Form(form), Some(Fitted::Form(start))) => {
                let start: Vec<f64> = start.coefficients.iter().map(|c| c.value).collect();
                Fitted::Form(fit_from(form, rows, ReferenceLength::One, Some(&start))?)
            }
            (Self::Form(form), _) => Fitted::Form(fit(form, rows, ReferenceLength::One)?),
            (Self::Spline, start) => {
                let smoothing = match start {
                    Some(Fitted::Spline(start)) => Some(start.smoothing),
                    _ => None,
                };
                Fitted::Spline(fit_spline(rows, ReferenceLength::One, smoothing)?)
            }
        })
    }
}

/// A shape that was fitted.
#[derive(Clone, Debug)]
pub enum Fitted {
    /// A form.
    Form(Fit),
    /// A surface.
    Spline(SplineFit),
}

impl Fitted {
    /// Scaled value at the markers of a row, moved into the ranges of the fit.
    fn at(&self, row: &BinRow) -> f64 {
        match self {
            Self::Form(fit) => {
                let values: Vec<f64> = fit.coefficients.iter().map(|c| c.value).collect();
                let ranges = fit.ranges.iter();
                let markers: Vec<f64> = ranges
                    .map(|range| {
                        let marker = marker_of(row, range.marker, fit.reference_length);
                        marker.clamp(range.low, range.high)
                    })
                    .collect();
                fit.form.predict(&values, &markers)
            }
            Self::Spline(fit) => {
                let width = marker_of(row, Marker::FilterWidth, fit.reference_length);
                fit.spline.at(row.solids_fraction, width)
            }
        }
    }

    /// 1 - Σ (residual/σ)²/Σ ((value - mean)/σ)² over the rows fitted \[-\].
    pub fn r_squared(&self) -> f64 {
        match self {
            Self::Form(fit) => fit.goodness.r_squared,
            Self::Spline(fit) => fit.r_squared,
        }
    }
}

/// A coefficient with its interval from replicates.
#[derive(Clone, Debug, Serialize)]
pub struct Interval {
    /// Symbol in the formula.
    pub symbol: String,
    /// Value.
    pub value: f64,
    /// Standard deviation over replicates; 0 if it was held.
    pub standard_error: f64,
    /// 2.5 % quantile over replicates.
    pub low_95: f64,
    /// 97.5 % quantile.
    pub high_95: f64,
    /// Whether the data did not fix it.
    pub held: bool,
}

/// What was found of one shape.
#[derive(Clone, Debug, Serialize)]
pub struct Candidate {
    /// Name of the shape.
    pub name: &'static str,
    /// Quantity.
    pub quantity: &'static str,
    /// Bins that were fitted.
    pub points: usize,
    /// R² over the bins that were fitted \[-\].
    pub r_squared: f64,
    /// Score on runs left out \[-\]; none if there is one run only, or a part could not be fitted.
    pub held_out: Option<f64>,
    /// Coefficients; none for a surface.
    pub coefficients: Vec<Interval>,
    /// Replicates that could be fitted.
    pub replicates: usize,
    /// What a user must know.
    pub notes: Vec<String>,
    /// The fit, its errors and covariance those of the replicates.
    #[serde(skip)]
    pub fitted: Fitted,
}

/// Fits that could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RefitError {
    /// A shape cannot be fitted.
    #[error("{shape}: {source}")]
    Fit {
        /// The shape.
        shape: &'static str,
        /// Why.
        source: FitError,
    },
    /// The runs do not fit together.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Nothing can be resampled.
    #[error(transparent)]
    Replicate(#[from] ReplicateError),
}

/// Fits `shapes` to `runs`, with intervals from `count` replicates drawn from `seed`.
///
/// # Errors
/// [`RefitError`] if the runs do not fit together, or a shape cannot be fitted to all of them.
pub fn refit(
    runs: &[RunSums],
    shapes: &[Shape],
    scales: &Scales,
    count: usize,
    seed: u64,
) -> Result<Vec<Candidate>, RefitError> {
    let sums: Vec<&Sums> = runs.iter().map(|run| &run.sums).collect();
    let fractions: Vec<f64> = runs.iter().map(|run| run.solids_fraction).collect();
    let replicates = replicate(&sums, &fractions, scales, count, seed)?;
    let tables: Vec<Vec<BinRow>> = (0..count).map(|k| replicates.table(k)).collect();
    // Each run's bins, and those of the others.
    let mut parts = Vec::new();
    for held in 0..if runs.len() > 1 { runs.len() } else { 0 } {
        let mut others = sums.clone();
        let one = [others.remove(held)];
        let trained = bin_table_among(&others, &sums, scales)?;
        parts.push((trained, bin_table_among(&one, &sums, scales)?));
    }
    let mut candidates = Vec::new();
    for &shape in shapes {
        let source = |source| RefitError::Fit { shape: shape.name(), source };
        let of = |rows: &[BinRow]| -> Vec<BinRow> {
            rows.iter().filter(|row| row.quantity == shape.quantity()).cloned().collect()
        };
        let mut fitted = shape.fit(&of(&replicates.rows), None).map_err(source)?;
        let again: Vec<Fitted> =
            tables.iter().filter_map(|rows| shape.fit(&of(rows), Some(&fitted)).ok()).collect();
        let held_out = score(shape, &parts, &of);
        let (points, notes) = match &fitted {
            Fitted::Form(fit) => (fit.goodness.points, fit.notes.clone()),
            Fitted::Spline(fit) => {
                let share = 100.0 * fit.inside;
                let note = format!("{share:.1} % of the bins' 95 % intervals hold the surface.");
                (fit.points, vec![note])
            }
        };
        if let Fitted::Form(fit) = &mut fitted {
            take_errors(fit, &again);
        }
        let coefficients = match &fitted {
            Fitted::Form(fit) => fit.coefficients.iter().map(interval).collect(),
            Fitted::Spline(_) => Vec::new(),
        };
        candidates.push(Candidate {
            name: shape.name(),
            quantity: shape.quantity(),
            points,
            r_squared: fitted.r_squared(),
            held_out,
            coefficients,
            replicates: again.len(),
            notes,
            fitted,
        });
    }
    Ok(candidates)
}

fn interval(c: &crate::fit::Coefficient) -> Interval {
    Interval {
        symbol: c.symbol.clone(),
        value: c.value,
        standard_error: c.standard_error,
        low_95: c.low_95,
        high_95: c.high_95,
        held: c.held,
    }
}

/// Puts errors and covariance of the replicates into a fit.
fn take_errors(fit: &mut Fit, again: &[Fitted]) {
    let values: Vec<Vec<f64>> = again
        .iter()
        .filter_map(|fitted| match fitted {
            Fitted::Form(fit) => Some(fit.coefficients.iter().map(|c| c.value).collect()),
            Fitted::Spline(_) => None,
        })
        .collect();
    if values.len() < 20 {
        fit.notes.push("Too few replicates could be fitted: errors are those of one fit.".into());
        return;
    }
    let count = values.len() as f64;
    let column = |k: usize| values.iter().map(move |row| row[k]);
    for k in 0..fit.coefficients.len() {
        if fit.coefficients[k].held {
            continue;
        }
        let mut sorted: Vec<f64> = column(k).collect();
        fit.coefficients[k].standard_error = standard_deviation(&sorted);
        sorted.sort_by(f64::total_cmp);
        let quantile = |share: f64| sorted[(share * (count - 1.0)).round() as usize];
        // The value itself is always held.
        let value = fit.coefficients[k].value;
        fit.coefficients[k].low_95 = quantile(0.025).min(value);
        fit.coefficients[k].high_95 = quantile(0.975).max(value);
        for l in 0..fit.coefficients.len() {
            let (a, b) = (column(k).sum::<f64>() / count, column(l).sum::<f64>() / count);
            let product: f64 = column(k).zip(column(l)).map(|(x, y)| (x - a) * (y - b)).sum();
            let both = !fit.coefficients[l].held;
            fit.covariance[k][l] = if both { product / (count - 1.0) } else { 0.0 };
        }
    }
}

/// The score over all runs left out; none without runs, or if the others cannot be fitted.
fn score(
    shape: Shape,
    parts: &[(Vec<BinRow>, Vec<BinRow>)],
    of: &dyn Fn(&[BinRow]) -> Vec<BinRow>,
) -> Option<f64> {
    let mut points: Vec<[f64; 3]> = Vec::new();
    for (others, one) in parts {
        let fitted = shape.fit(&of(others), None).ok()?;
        for row in of(one).iter().filter(|row| row.standard_error.is_finite()) {
            let value = row.value_scaled;
            points.push([value, fitted.at(row), row.samples as f64]);
        }
    }
    let total: f64 = points.iter().map(|[.., n]| n).sum();
    let mean = points.iter().map(|[value, _, n]| n * value).sum::<f64>() / total;
    let sum = |of: &dyn Fn(&[f64; 3]) -> f64| points.iter().map(of).sum::<f64>();
    let unexplained = sum(&|[value, found, n]| n * (value - found).powi(2));
    let scatter = sum(&|[value, _, n]| n * (value - mean).powi(2));
    (scatter > 0.0).then(|| 1.0 - unexplained / scatter)
}

/// The candidate for `quantity` with the best score on runs left out; without scores, the one that
/// follows the bins best.
pub fn preferred<'a>(candidates: &'a [Candidate], quantity: &str) -> Option<&'a Candidate> {
    let score = |c: &Candidate| c.held_out.unwrap_or(c.r_squared);
    let of_quantity = candidates.iter().filter(|candidate| candidate.quantity == quantity);
    of_quantity.max_by(|a, b| score(a).total_cmp(&score(b)))
}

impl fmt::Display for Candidate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let held_out = self.held_out.map_or("-".into(), |score| format!("{score:.4}"));
        write!(
            f,
            "{:16} {:22} {:6} {:8.4} {:>8}",
            self.name, self.quantity, self.points, self.r_squared, held_out
        )?;
        for c in &self.coefficients {
            let Interval { symbol, value, low_95, high_95, held, .. } = c;
            match held {
                true => write!(f, "\n    {symbol} = {value:.4}, held")?,
                false => write!(f, "\n    {symbol} = {value:.4} [{low_95:.4}, {high_95:.4}]")?,
            }
        }
        for note in &self.notes {
            write!(f, "\n    {note}")?;
        }
        Ok(())
    }
}
