//! [`refit`]: forms fitted to runs put together, with intervals from replicates and scores on runs that
//! the fit has not seen.
//!
//! - **Intervals.** Every form is fitted again to each bootstrap replicate of the whole bin table
//!   ([`replicates`](crate::replicates)), so that the correlation of bins is in them; ends are the 2.5 and
//!   97.5 % quantiles over replicates, of each coefficient and of each point of the curve. A coefficient
//!   that one replicate in twenty or more does not fix has no interval: the data do not fix it.
//! - **Scores.** Each run is left out once: the form is fitted to the bins of the others and compared with
//!   those of the one, a bin counting as many times as filter positions fell into it. The score is
//!   1 - Σ n (value - predicted)²/Σ n (value - mean)². Runs of one mean fraction held out against others
//!   ask more of a form than bins held out would: they see another box.
//! - **Tables alone.** Bin tables without the sums behind them are drawn again from their standard errors,
//!   bin by bin; what bins share is not in such intervals, which a note says. Each table is a run.

use crate::fit::{
    Coefficient, Fit, FitError, Goodness, ReferenceLength, ValidRange, fit, fit_from, marker_of,
    one_width, student_quantile,
};
use crate::forms::ClosureForm;
use crate::laws::scales::Scales;
use crate::replicates::{ReplicateError, replicate, standard_deviation};
use crate::spline::{CEILING, SplineFit, fit_spline};
use crate::statistics::{MergeError, Sums, bin_table_among};
use crate::sums::RunSums;
use crate::table::BinRow;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use serde::Serialize;
use std::fmt;

/// Replicates below which quantiles over them mean nothing.
const FEWEST: usize = 40;

/// Share of replicates that may leave a coefficient open which the data are said to fix.
const OPEN: f64 = 0.05;

/// Smoothing of a surface fitted to a replicate, over that of the surface. What is smoothed away is a
/// bias, which no replicate shows; with less of it they scatter by more than it hides.
const SHARPER: f64 = 0.01;

/// Formula of a surface, for the reader.
const SURFACE: &str = "H = sum of c_ij N_i(x) N_j(y), x = ln(1 + phi/phi_0), y = D/(D + D_0); quadratic \
                       B-splines, 0 at phi = 0 and D = 0, never less for a wider filter; \
                       D = filter_width/L";

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

    fn fit(
        self,
        rows: &[BinRow],
        packing: f64,
        start: Option<&Fitted>,
    ) -> Result<Fitted, FitError> {
        Ok(match (self, start) {
            (Self::Form(form), Some(Fitted::Form(start))) => {
                let start: Vec<f64> = start.coefficients.iter().map(|c| c.value).collect();
                Fitted::Form(fit_from(form, rows, ReferenceLength::One, Some(&start))?)
            }
            (Self::Form(form), _) => Fitted::Form(fit(form, rows, ReferenceLength::One)?),
            (Self::Spline, start) => {
                let smoothing = match start {
                    Some(Fitted::Spline(start)) => Some(SHARPER * start.smoothing),
                    _ => None,
                };
                Fitted::Spline(fit_spline(rows, ReferenceLength::One, packing, smoothing)?)
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
    /// Scaled value at `markers`, in the order of [`ranges`](Self::ranges), each moved into its range.
    pub fn at(&self, markers: &[f64]) -> f64 {
        let ends = self.ranges().iter().zip(markers);
        let moved: Vec<f64> = ends.map(|(range, x)| x.clamp(range.low, range.high)).collect();
        match self {
            Self::Form(fit) => {
                let values: Vec<f64> = fit.coefficients.iter().map(|c| c.value).collect();
                fit.form.predict(&values, &moved)
            }
            Self::Spline(fit) => fit.spline.at(moved[0], moved[1]),
        }
    }

    fn at_row(&self, row: &BinRow) -> f64 {
        let of = |range: &ValidRange| marker_of(row, range.marker, self.reference_length());
        let markers: Vec<f64> = self.ranges().iter().map(of).collect();
        self.at(&markers)
    }

    /// Name of the shape.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Form(fit) => fit.form.name(),
            Self::Spline(_) => Shape::Spline.name(),
        }
    }

    /// The formula, for the reader.
    pub fn formula(&self) -> &'static str {
        match self {
            Self::Form(fit) => fit.form.formula(),
            Self::Spline(_) => SURFACE,
        }
    }

    /// Quantity described.
    pub fn quantity(&self) -> &'static str {
        match self {
            Self::Form(fit) => fit.form.quantity(),
            Self::Spline(_) => Shape::Spline.quantity(),
        }
    }

    /// What a value is scaled by; `-` for a number.
    pub fn unit(&self) -> &'static str {
        match self {
            Self::Form(fit) => fit.form.unit(),
            Self::Spline(_) => "-",
        }
    }

    /// Smallest and largest value.
    fn image(&self) -> (f64, f64) {
        match self {
            Self::Form(fit) => fit.form.image(),
            Self::Spline(_) => (0.0, CEILING),
        }
    }

    /// What Δ_f is scaled by.
    pub fn reference_length(&self) -> ReferenceLength {
        match self {
            Self::Form(fit) => fit.reference_length,
            Self::Spline(fit) => fit.reference_length,
        }
    }

    /// Range of each marker that the bins cover.
    pub fn ranges(&self) -> &[ValidRange] {
        match self {
            Self::Form(fit) => &fit.ranges,
            Self::Spline(fit) => &fit.ranges,
        }
    }

    /// How well it follows the bins.
    pub fn goodness(&self) -> &Goodness {
        match self {
            Self::Form(fit) => &fit.goodness,
            Self::Spline(fit) => &fit.goodness,
        }
    }

    /// Coefficients; none of a surface.
    pub fn coefficients(&self) -> &[Coefficient] {
        match self {
            Self::Form(fit) => &fit.coefficients,
            Self::Spline(_) => &[],
        }
    }

    /// Their covariance.
    pub fn covariance(&self) -> &[Vec<f64>] {
        match self {
            Self::Form(fit) => &fit.covariance,
            Self::Spline(_) => &[],
        }
    }
}

/// A value with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Value.
    pub value: f64,
    /// Standard error: that of the bins. What the form itself cannot follow is not in it; that is
    /// `goodness.extra_scatter`.
    pub standard_error: f64,
    /// Lower end of the 95 % interval, cut at the smallest value possible.
    pub low_95: f64,
    /// Upper end of the 95 % interval, cut at the largest value possible.
    pub high_95: f64,
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
    pub coefficients: Vec<Coefficient>,
    /// Replicates that could be fitted.
    pub replicates: usize,
    /// What a user must know.
    pub notes: Vec<String>,
    /// The fit, its errors and covariance those of the replicates.
    #[serde(skip)]
    pub fitted: Fitted,
    /// The fits of the replicates.
    #[serde(skip)]
    pub again: Vec<Fitted>,
}

impl Candidate {
    /// Of a fit, the fits of its replicates and its score; with fewer than 40 replicates errors are
    /// those of the one fit.
    pub fn new(mut fitted: Fitted, again: Vec<Fitted>, held_out: Option<f64>) -> Self {
        let notes = match &mut fitted {
            Fitted::Form(fit) => {
                take_errors(fit, &again);
                fit.notes.clone()
            }
            Fitted::Spline(fit) => {
                let widths = fit.ranges[1];
                (widths.low > 0.0).then(|| one_width(widths.high)).into_iter().collect()
            }
        };
        Self {
            name: fitted.name(),
            quantity: fitted.quantity(),
            points: fitted.goodness().points,
            r_squared: fitted.goodness().r_squared,
            held_out,
            coefficients: fitted.coefficients().to_vec(),
            replicates: again.len(),
            notes,
            fitted,
            again,
        }
    }

    /// The value at `markers` with its error: quantiles over the replicates; without them, of a form,
    /// the variance gᵀ C g, g the gradient by the coefficients and C their covariance. A surface without
    /// replicates has the errors of nothing: not a number.
    pub fn estimate(&self, markers: &[f64]) -> Estimate {
        let value = self.fitted.at(markers);
        let (least, greatest) = self.fitted.image();
        if self.again.len() >= FEWEST {
            let mut values: Vec<f64> = self.again.iter().map(|fit| fit.at(markers)).collect();
            let standard_error = standard_deviation(&values);
            let [low, high] = ends(&mut values);
            let (low_95, high_95) = (low.min(value).max(least), high.max(value).min(greatest));
            return Estimate { value, standard_error, low_95, high_95 };
        }
        let Fitted::Form(fit) = &self.fitted else {
            let nan = f64::NAN;
            return Estimate { value, standard_error: nan, low_95: nan, high_95: nan };
        };
        let values: Vec<f64> = fit.coefficients.iter().map(|c| c.value).collect();
        let ranges = fit.ranges.iter().zip(markers);
        let moved: Vec<f64> = ranges.map(|(range, x)| x.clamp(range.low, range.high)).collect();
        let mut gradient = vec![0.0; values.len()];
        fit.form.gradient(&values, &moved, &mut gradient);
        let mut variance = 0.0;
        for (row, a) in fit.covariance.iter().zip(&gradient) {
            for (covariance, b) in row.iter().zip(&gradient) {
                variance += a * covariance * b;
            }
        }
        // Round-off can leave a variance of zero slightly negative.
        let standard_error = variance.max(0.0).sqrt();
        let half = student_quantile(fit.goodness.degrees_of_freedom) * standard_error;
        let (low_95, high_95) = ((value - half).max(least), (value + half).min(greatest));
        Estimate { value, standard_error, low_95, high_95 }
    }
}

/// Ends between which 95 % of further values fall; sorts. Of n values the k-th least has a share of
/// k/(n + 1) of the further ones below it, on average: of few values the quantiles of the sample itself
/// lie too close together.
fn ends(values: &mut [f64]) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let last = values.len() - 1;
    let quantile = |share: f64| {
        let place = (share * (values.len() + 1) as f64 - 1.0).clamp(0.0, last as f64);
        let low = values[place as usize];
        low + place.fract() * (values[(place as usize + 1).min(last)] - low)
    };
    [quantile(0.025), quantile(0.975)]
}

/// Fits that could not be made.
#[derive(Debug, thiserror::Error)]
pub enum RefitError {
    /// A shape cannot be fitted.
    #[error("{shape}: {why}")]
    Fit {
        /// The shape.
        shape: &'static str,
        /// Why.
        why: FitError,
    },
    /// The runs do not fit together.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// Nothing can be resampled.
    #[error(transparent)]
    Replicate(#[from] ReplicateError),
}

/// Bins of several runs, ready to be fitted.
#[derive(Clone, Debug)]
pub struct Bins {
    /// Of all runs together.
    pub rows: Vec<BinRow>,
    /// Replicates of them.
    replicates: Vec<Vec<BinRow>>,
    /// For each run left out those of the others, and its own.
    parts: Vec<(Vec<BinRow>, Vec<BinRow>)>,
    /// Solids fraction of the densest packing, at which nothing moves \[-\].
    packing: f64,
    /// What is to be known of the replicates.
    note: Option<String>,
}

/// Densest packing of a powder that is not known: random spheres.
const PACKING: f64 = 0.65;

impl Bins {
    /// The bins of `runs`, with `count` replicates drawn from `seed`. Runs that are too short to be
    /// resampled are drawn from their standard errors.
    ///
    /// # Errors
    /// [`RefitError`] if the runs do not fit together.
    pub fn of_runs(
        runs: &[RunSums],
        scales: &Scales,
        count: usize,
        seed: u64,
    ) -> Result<Self, RefitError> {
        let sums: Vec<&Sums> = runs.iter().map(|run| &run.sums).collect();
        let fractions: Vec<f64> = runs.iter().map(|run| run.solids_fraction).collect();
        let mut bins = match replicate(&sums, &fractions, scales, count, seed) {
            Ok(found) => {
                let replicates = (0..count).map(|k| found.table(k)).collect();
                Self {
                    rows: found.rows,
                    replicates,
                    parts: Vec::new(),
                    packing: PACKING,
                    note: None,
                }
            }
            Err(error @ ReplicateError::TooShort { .. }) => {
                let rows = bin_table_among(&sums, &sums, scales)?;
                let note = Some(format!("{error}; {NOISE}"));
                let replicates = drawn(&rows, count, seed);
                Self { rows, replicates, parts: Vec::new(), packing: PACKING, note }
            }
            Err(error) => return Err(error.into()),
        };
        for held in 0..if runs.len() > 1 { runs.len() } else { 0 } {
            let mut others = sums.clone();
            let one = [others.remove(held)];
            let trained = bin_table_among(&others, &sums, scales)?;
            bins.parts.push((trained, bin_table_among(&one, &sums, scales)?));
        }
        Ok(bins)
    }

    /// Of a powder whose densest packing is `packing` \[-\], in place of 0.65.
    pub fn packed(self, packing: f64) -> Self {
        Self { packing, ..self }
    }

    /// Replicate number `replicate` of the rows.
    pub fn replicate(&self, replicate: usize) -> &[BinRow] {
        &self.replicates[replicate]
    }

    /// Bin tables, one of each run, with `count` replicates drawn from their standard errors.
    pub fn of_tables(tables: Vec<Vec<BinRow>>, count: usize, seed: u64) -> Self {
        let parts = match tables.len() {
            0 | 1 => Vec::new(),
            several => (0..several)
                .map(|held| {
                    let others = tables.iter().enumerate().filter(|(k, _)| *k != held);
                    (others.flat_map(|(_, rows)| rows.clone()).collect(), tables[held].clone())
                })
                .collect(),
        };
        let rows: Vec<BinRow> = tables.into_iter().flatten().collect();
        let note = Some(format!("Bin tables do not say what bins share; {NOISE}"));
        Self { replicates: drawn(&rows, count, seed), rows, parts, packing: PACKING, note }
    }
}

/// What it means that replicates are drawn from standard errors.
const NOISE: &str = "intervals take each bin's standard error as its own, and are too narrow by what bins \
                     share: give folders of longer runs.";

/// Replicates of rows by normal numbers of their standard errors.
fn drawn(rows: &[BinRow], count: usize, seed: u64) -> Vec<Vec<BinRow>> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut table = || -> Vec<BinRow> {
        let draw = |row: &BinRow| {
            let (u, v): (f64, f64) = (random.random(), random.random());
            let normal = (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos();
            let error = if row.standard_error.is_finite() { row.standard_error } else { 0.0 };
            let shift = error * normal;
            let scale = if row.value == 0.0 { 1.0 } else { row.value_scaled / row.value };
            BinRow {
                value: row.value + shift,
                value_scaled: row.value_scaled + shift * scale,
                low_95: row.low_95 + shift,
                high_95: row.high_95 + shift,
                ..row.clone()
            }
        };
        rows.iter().map(draw).collect()
    };
    (0..count).map(|_| table()).collect()
}

/// Fits a shape to `bins`, with intervals from its replicates and its score on runs left out.
///
/// # Errors
/// [`RefitError::Fit`] if it cannot be fitted to all of them.
pub fn refit(bins: &Bins, shape: Shape) -> Result<Candidate, RefitError> {
    let of = |rows: &[BinRow]| -> Vec<BinRow> {
        rows.iter().filter(|row| row.quantity == shape.quantity()).cloned().collect()
    };
    let refused = |why| RefitError::Fit { shape: shape.name(), why };
    let fitted = shape.fit(&of(&bins.rows), bins.packing, None).map_err(refused)?;
    let tables = bins.replicates.iter();
    let again = tables.filter_map(|rows| shape.fit(&of(rows), bins.packing, Some(&fitted)).ok());
    let again = again.collect();
    let mut candidate = Candidate::new(fitted, again, score(shape, bins, &of));
    candidate.notes.extend(bins.note.clone());
    Ok(candidate)
}

/// Puts errors and covariance of the replicates into a fit.
fn take_errors(fit: &mut Fit, again: &[Fitted]) {
    if again.len() < FEWEST {
        if !again.is_empty() {
            let few = again.len();
            let note = format!("{few} replicates could be fitted: errors are those of one fit.");
            fit.notes.push(note);
        }
        return;
    }
    for (k, coefficient) in fit.coefficients.iter_mut().enumerate().filter(|(_, c)| !c.held) {
        let open = again.iter().filter(|fitted| fitted.coefficients()[k].held).count();
        if open as f64 <= OPEN * again.len() as f64 {
            continue;
        }
        let Coefficient { name, symbol, value, .. } = coefficient;
        fit.notes.push(format!(
            "The data do not fix {name} ({symbol}): {open} of {} replicates leave it open; it stands at \
             {value:.4} without an interval.",
            again.len()
        ));
        (coefficient.held, coefficient.standard_error) = (true, 0.0);
        (coefficient.low_95, coefficient.high_95) = (coefficient.value, coefficient.value);
    }
    // A default that a replicate took for want of data is no estimate.
    let held = |of: &[Coefficient]| -> Vec<bool> { of.iter().map(|c| c.held).collect() };
    let fixed = held(&fit.coefficients);
    let same = |fitted: &&Fitted| {
        held(fitted.coefficients()).into_iter().zip(&fixed).all(|(there, here)| !there || *here)
    };
    let known: Vec<&Fitted> = again.iter().filter(same).collect();
    if known.len() < FEWEST {
        let few = known.len();
        fit.notes.push(format!("{few} replicates fix all: errors are those of one fit."));
        return;
    }
    let count = known.len() as f64;
    let column = |k: usize| known.iter().map(move |fitted| fitted.coefficients()[k].value);
    for (k, coefficient) in fit.coefficients.iter_mut().enumerate().filter(|(_, c)| !c.held) {
        let mut values: Vec<f64> = column(k).collect();
        coefficient.standard_error = standard_deviation(&values);
        let [low, high] = ends(&mut values);
        // The value itself is always held.
        coefficient.low_95 = low.min(coefficient.value);
        coefficient.high_95 = high.max(coefficient.value);
    }
    for k in 0..fit.coefficients.len() {
        for l in 0..fit.coefficients.len() {
            let (a, b) = (column(k).sum::<f64>() / count, column(l).sum::<f64>() / count);
            let product: f64 = column(k).zip(column(l)).map(|(x, y)| (x - a) * (y - b)).sum();
            let held = fit.coefficients[k].held || fit.coefficients[l].held;
            fit.covariance[k][l] = if held { 0.0 } else { product / (count - 1.0) };
        }
    }
}

/// The score over all runs left out; none without runs, or if the others cannot be fitted.
fn score(shape: Shape, bins: &Bins, of: &dyn Fn(&[BinRow]) -> Vec<BinRow>) -> Option<f64> {
    let mut points: Vec<[f64; 3]> = Vec::new();
    for (others, one) in &bins.parts {
        let fitted = shape.fit(&of(others), bins.packing, None).ok()?;
        for row in of(one).iter().filter(|row| row.standard_error.is_finite()) {
            let value = row.value_scaled;
            points.push([value, fitted.at_row(row), row.samples as f64]);
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
        if let Fitted::Spline(fit) = &self.fitted {
            let share = 100.0 * fit.inside;
            write!(f, "\n    {share:.1} % of the bins' 95 % intervals hold the surface")?;
        }
        for c in &self.coefficients {
            let Coefficient { symbol, value, low_95, high_95, held, .. } = c;
            match held {
                true => write!(f, "\n    {symbol} = {value:.4}, not fixed by the data")?,
                false => write!(f, "\n    {symbol} = {value:.4} [{low_95:.4}, {high_95:.4}]")?,
            }
        }
        for note in &self.notes {
            write!(f, "\n    {note}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::tests::{PLANTED, WIDTHS, synthetic};
    use crate::forms::{FormulaForm, SaturatingDrag};

    /// Grows with the filter, and knows nothing of φ.
    const POOR: &str = "name = \"poor\"\npredicts = \"drag_correction\"\nunit = \"-\"\n\
                        markers = [\"solids_fraction\", \"filter_width\"]\n\
                        formula = \"a*D/(D + b)\"\n\
                        [[parameters]]\nname = \"a\"\nstart = 0.8\nlow = 0.0\nhigh = 1.0\n\
                        [[parameters]]\nname = \"b\"\nstart = 1.0\nlow = 0.0\n";

    #[test]
    fn tables_left_out_prefer_what_was_planted() {
        let tables = (1..4).map(|seed| synthetic(&WIDTHS, 0.58, 0.02, seed)).collect();
        let bins = Bins::of_tables(tables, 40, 1);
        let poor = FormulaForm::parse(POOR).unwrap();
        let shapes = [Shape::Form(poor), Shape::Form(&SaturatingDrag), Shape::Spline];
        let found: Vec<Candidate> =
            shapes.into_iter().map(|shape| refit(&bins, shape).unwrap()).collect();
        let scores: Vec<f64> = found.iter().map(|found| found.held_out.unwrap()).collect();
        assert!(scores[0] < 0.6 && scores[1] > 0.97 && scores[2] > 0.95, "{scores:?}");
        assert_eq!(preferred(&found, "drag_correction").unwrap().name, "saturating_drag");
        assert!(preferred(&found, "slip").is_none());
        let alone = Bins::of_tables(vec![synthetic(&WIDTHS, 0.58, 0.02, 1)], 40, 1);
        let alone = refit(&alone, Shape::Form(&SaturatingDrag)).unwrap();
        assert_eq!(alone.held_out, None);
        assert!(alone.notes.iter().any(|note| note.contains("do not say what bins share")));
    }

    #[test]
    fn intervals_from_replicates_cover() {
        let mut values: Vec<f64> = (1..=79).rev().map(f64::from).collect();
        assert_eq!(ends(&mut values), [2.0, 78.0]);
        const SEEDS: u64 = 60;
        let points = [[0.05, 1.0], [0.1, 4.0], [0.3, 2.0], [0.4, 16.0], [0.5, 8.0]];
        let (mut of_form, mut of_surface, mut of_coefficients) = (0, 0, 0);
        for seed in 0..SEEDS {
            let bins = Bins::of_tables(vec![synthetic(&WIDTHS, 0.58, 0.02, 500 + seed)], 80, seed);
            let form = refit(&bins, Shape::Form(&SaturatingDrag)).unwrap();
            let surface = refit(&bins, Shape::Spline).unwrap();
            let holds = |found: &Candidate, point: &[f64; 2]| {
                let exact = SaturatingDrag.predict(&PLANTED, point);
                let Estimate { low_95, high_95, .. } = found.estimate(point);
                u32::from(low_95 <= exact && exact <= high_95)
            };
            of_form += points.iter().map(|point| holds(&form, point)).sum::<u32>();
            of_surface += points.iter().map(|point| holds(&surface, point)).sum::<u32>();
            let near = |(c, exact): (&Coefficient, &f64)| {
                u32::from(c.low_95 <= *exact && *exact <= c.high_95)
            };
            of_coefficients += form.coefficients.iter().zip(&PLANTED).map(near).sum::<u32>();
        }
        let share = |count: u32, of: usize| f64::from(count) / (SEEDS as f64 * of as f64);
        let form = share(of_form, points.len());
        let surface = share(of_surface, points.len());
        let coefficients = share(of_coefficients, PLANTED.len());
        println!("curve {form:.3}, surface {surface:.3}, coefficients {coefficients:.3}");
        assert!((0.90..=0.99).contains(&form), "{form}");
        assert!((0.92..=0.98).contains(&coefficients), "{coefficients}");
        assert!((0.85..=1.0).contains(&surface), "{surface}");
    }

    #[test]
    fn a_coefficient_that_replicates_leave_open_has_no_interval() {
        // Nothing above a solids fraction of 0.2 says where H closes.
        let rows = synthetic(&WIDTHS, 0.2, 0.02, 4);
        let bins = Bins::of_tables(vec![rows], 100, 1);
        let found = refit(&bins, Shape::Form(&SaturatingDrag)).unwrap();
        for c in &found.coefficients {
            let named = format!("The data do not fix {} ({})", c.name, c.symbol);
            assert_eq!(found.notes.iter().any(|note| note.starts_with(&named)), c.held);
            assert!(!c.held || (c.low_95 == c.high_95 && c.standard_error == 0.0), "{c:?}");
        }
        assert!(found.coefficients[5].held, "{:?}", found.coefficients[5]);
        assert!(found.fitted.covariance()[5].iter().all(|c| *c == 0.0));
        assert!(!found.coefficients[0].held);
    }
}
