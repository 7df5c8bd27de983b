//! [`Spline`]: a closure that needs no form, as a smooth surface over φ and Δ_f.
//!
//! H(φ, D) = Σ_ij c_ij N_i(x) N_j(y) with x = ln(1 + φ/φ_0) and y = D/(D + D_0), N quadratic B-splines on
//! clamped knots: continuously differentiable. B-splines are never negative and sum to one, and a
//! surface does not turn more often than its coefficients do (de Boor, *A Practical Guide to Splines*,
//! 2001), so that three conditions on the coefficients shape the whole surface:
//!
//! - c_0j = c_i0 = 0: nothing at φ = 0 and at D = 0; c_ij = 0 for the last i: nothing at the densest
//!   packing, where nothing moves;
//! - c_ij ≤ c_i(j+1): never less for a wider filter;
//! - c_ij ≤ [`CEILING`] < 1.
//!
//! The fit minimises Σ (value - H)²/σ² + λ (Σ second differences² along i and along j), exactly under the
//! second condition (active set, Lawson & Hanson 1974). λ is the largest of a ladder for which 95 % of the
//! bins' intervals hold the surface (the discrepancy principle): what the bins' errors leave open is
//! smoothed away, and nothing else.

use crate::fit::{FitError, Goodness, ReferenceLength, ValidRange, check_rows};
use crate::forms::Marker;
use crate::table::BinRow;
use faer::linalg::solvers::Solve;
use faer::{Col, Mat, Side};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Largest coefficient.
pub const CEILING: f64 = 0.999;

/// Pieces along x.
const PIECES: usize = 12;

/// Most pieces along y.
const WIDTHS: usize = 6;

/// φ_0: half of the narrowest bins in use [-].
const FRACTION_SCALE: f64 = 0.01;

/// Share of the intervals that must hold the surface.
const HELD: f64 = 0.95;

/// A surface over filtered solids fraction and scaled filter width. The fields are keys of a closure
/// file, `[splines.NAME]`, and NAME is then a formula.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spline {
    /// φ_0 of x = ln(1 + φ/φ_0) [-].
    pub fraction_scale: f64,
    /// D_0 of y = D/(D + D_0) [-].
    pub width_scale: f64,
    /// Where pieces meet along x, both ends included; the first is 0.
    pub fraction_knots: Vec<f64>,
    /// Likewise along y.
    pub width_knots: Vec<f64>,
    /// c_ij: for each B-spline along x a list along y, one more each than there are knots.
    pub coefficients: Vec<Vec<f64>>,
}

/// A spline that was fitted.
#[derive(Clone, Debug)]
pub struct SplineFit {
    /// The surface.
    pub spline: Spline,
    /// What Δ_f is scaled by.
    pub reference_length: ReferenceLength,
    /// λ.
    pub smoothing: f64,
    /// Share of the 95 % intervals of the rows that hold the surface [-].
    pub inside: f64,
    /// How well it follows them; degrees of freedom are the rows less the trace of what maps values to
    /// fitted values, rounded.
    pub goodness: Goodness,
    /// Ranges that the bins cover.
    pub ranges: Vec<ValidRange>,
}

/// Values of the three quadratic B-splines that are not zero at `x`, and which is the first; `knots`
/// rise. Outside, those at the nearer end.
fn basis(knots: &[f64], x: f64) -> (usize, [f64; 3]) {
    let last = knots.len() - 1;
    let x = x.clamp(knots[0], knots[last]);
    let piece = knots[1..last].partition_point(|knot| *knot <= x);
    let knot = |i: isize| knots[(piece as isize + i).clamp(0, last as isize) as usize];
    let (low, high) = (knot(0), knot(1));
    let (before, after) = (knot(-1), knot(2));
    let share = (x - low) / (high - low);
    // Cox & de Boor: two linear ones, then three of degree two.
    let (left, right) = ((high - x) / (high - before), (x - low) / (after - low));
    let first = left * (1.0 - share);
    let third = right * share;
    (piece, [first, 1.0 - first - third, third])
}

/// Value, slope, half the curvature at the first knot and half the jumps of curvature at the inner ones
/// of a spline with these coefficients: what it is in powers of x and of max(x - t, 0).
fn powers(knots: &[f64], coefficients: &[f64]) -> Vec<f64> {
    let last = knots.len() - 1;
    let knot = |i: isize| knots[i.clamp(0, last as isize) as usize];
    let slopes: Vec<f64> = coefficients
        .windows(2)
        .enumerate()
        .map(|(i, c)| 2.0 * (c[1] - c[0]) / (knot(i as isize + 1) - knot(i as isize - 1)))
        .collect();
    let curvature = |piece: usize| {
        0.5 * (slopes[piece + 1] - slopes[piece]) / (knots[piece + 1] - knots[piece])
    };
    let mut powers = vec![coefficients[0], slopes[0], curvature(0)];
    powers.extend((1..last).map(|piece| curvature(piece) - curvature(piece - 1)));
    powers
}

impl Spline {
    /// What is wrong with it, if anything is.
    ///
    /// # Errors
    /// Key, what it is and what it should be.
    pub fn check(&self) -> Result<(), String> {
        for (key, value) in
            [("fraction_scale", self.fraction_scale), ("width_scale", self.width_scale)]
        {
            if !(value > 0.0 && value.is_finite()) {
                return Err(format!("{key} = {value}: a positive number is needed"));
            }
        }
        for (key, knots) in
            [("fraction_knots", &self.fraction_knots), ("width_knots", &self.width_knots)]
        {
            let rise = knots.windows(2).all(|pair| pair[0] < pair[1]);
            if !(rise && (2..=50).contains(&knots.len()) && knots[0] == 0.0)
                || knots.iter().any(|knot| !knot.is_finite())
            {
                return Err(format!("{key}: 2 to 50 numbers that rise from 0 are needed"));
            }
        }
        let (rows, columns) = (self.fraction_knots.len() + 1, self.width_knots.len() + 1);
        let shape = self.coefficients.len() == rows
            && self.coefficients.iter().all(|row| row.len() == columns);
        if !shape {
            return Err(format!("coefficients: {rows} lists of {columns} numbers are needed"));
        }
        match self.coefficients.iter().flatten().find(|c| !(0.0..1.0).contains(*c)) {
            Some(wrong) => Err(format!("coefficients: {wrong} is not from 0 to below 1")),
            None => Ok(()),
        }
    }

    /// H at solids fraction `fraction` and scaled filter width `width`; beyond the last knots that at
    /// them.
    pub fn at(&self, fraction: f64, width: f64) -> f64 {
        let (i, along_x) = basis(&self.fraction_knots, (fraction / self.fraction_scale).ln_1p());
        let (j, along_y) = basis(&self.width_knots, width / (width + self.width_scale));
        let row =
            |a: usize| (0..3).map(|b| along_y[b] * self.coefficients[i + a][j + b]).sum::<f64>();
        (0..3).map(|a| along_x[a] * row(a)).sum()
    }

    /// The surface as formulae in the language of [`Expression`](crate::expression::Expression): those
    /// that it is made of, then itself under `name`. In powers of max(x - knot, 0), which has no branch.
    pub fn formulae(&self, name: &str) -> Vec<(String, String)> {
        let along = |knots: &[f64], axis: &str| -> Vec<String> {
            let mut terms = vec!["1".to_owned(), axis.to_owned(), format!("{axis}^2")];
            let inner = &knots[1..knots.len() - 1];
            terms.extend(inner.iter().map(|knot| format!("max({axis} - {knot:?}, 0)^2")));
            terms
        };
        let (x, y) = (format!("{name}_x"), format!("{name}_y"));
        let end = |knots: &[f64]| knots[knots.len() - 1];
        let (right, top) = (end(&self.fraction_knots), end(&self.width_knots));
        let mut formulae = vec![
            (x.clone(), format!("min(ln(1 + phi/{:?}), {right:?})", self.fraction_scale)),
            (y.clone(), format!("min(D/(D + {:?}), {top:?})", self.width_scale)),
        ];
        // Powers along y of the coefficients, then along x.
        let rows: Vec<Vec<f64>> =
            self.coefficients.iter().map(|row| powers(&self.width_knots, row)).collect();
        let sum = |numbers: &[f64], terms: &[String]| {
            let mut text = String::new();
            for (number, term) in numbers.iter().zip(terms).filter(|(number, _)| **number != 0.0) {
                let sign = if *number < 0.0 { " - " } else { " + " };
                let sign = if text.is_empty() && *number > 0.0 { "" } else { sign };
                let _ = write!(text, "{sign}{:?}*{term}", number.abs());
            }
            if text.is_empty() { "0".into() } else { text }
        };
        let across = along(&self.fraction_knots, &x);
        let mut names = Vec::new();
        for b in 0..rows[0].len() {
            let column: Vec<f64> = rows.iter().map(|row| row[b]).collect();
            let text = sum(&powers(&self.fraction_knots, &column), &across);
            let term = format!("{name}_{b}");
            names.push((term.clone(), text != "0"));
            formulae.push((term, text));
        }
        let along_y = along(&self.width_knots, &y);
        let terms: Vec<String> = names
            .iter()
            .zip(&along_y)
            .filter(|((_, there), _)| *there)
            .map(|((term, _), power)| format!("{term}*{power}"))
            .collect();
        formulae.retain(|(_, text)| text != "0");
        let all = if terms.is_empty() { "0".to_owned() } else { terms.join(" + ") };
        // Sums of powers may miss zero by a rounding.
        formulae.push((name.to_owned(), format!("max({all}, 0)")));
        formulae
    }
}

/// Fits a spline to `rows`, all of one quantity with values in [0, 1), of a powder whose densest packing is
/// `packing`; `smoothing` is λ, or none to have it found.
///
/// # Errors
/// [`FitError`] for numbers that cannot be fitted, or fewer than twelve rows.
pub fn fit_spline(
    rows: &[BinRow],
    reference_length: ReferenceLength,
    packing: f64,
    smoothing: Option<f64>,
) -> Result<SplineFit, FitError> {
    check_rows(rows, reference_length)?;
    let used: Vec<&BinRow> = rows.iter().filter(|row| row.standard_error.is_finite()).collect();
    if used.len() < PIECES {
        return Err(FitError::TooFewRows { found: used.len(), needed: PIECES, parameters: PIECES });
    }
    let width = |row: &BinRow| reference_length.scaled_width(row);
    let mut widths: Vec<f64> = used.iter().map(|row| width(row)).collect();
    widths.sort_by(f64::total_cmp);
    widths.dedup();
    let (narrowest, widest) = (widths[0], widths[widths.len() - 1]);
    let densest = used.iter().map(|row| row.solids_fraction_high.min(1.0)).fold(0.0, f64::max);
    let width_scale = (narrowest * widest).sqrt();
    // A knot at each width, or at some of many.
    let pieces = widths.len().min(WIDTHS);
    let mut width_knots = vec![0.0];
    width_knots.extend((1..=pieces).map(|k| {
        let at = widths[k * widths.len() / pieces - 1];
        at / (at + width_scale)
    }));
    // Up to the bins, and one piece on to the packing.
    let scaled = |fraction: f64| (fraction / FRACTION_SCALE).ln_1p();
    let beyond = packing > 1.02 * densest;
    let end = scaled(if beyond { densest } else { packing });
    let mut fraction_knots: Vec<f64> =
        (0..=PIECES).map(|k| end * k as f64 / PIECES as f64).collect();
    fraction_knots.extend(beyond.then(|| scaled(packing)));
    let empty = Spline {
        fraction_scale: FRACTION_SCALE,
        width_scale,
        coefficients: vec![vec![0.0; width_knots.len() + 1]; fraction_knots.len() + 1],
        fraction_knots,
        width_knots,
    };
    let problem = Problem::new(&used, reference_length, &empty);
    let inside = |spline: &Spline| {
        let holds = |row: &&&BinRow| {
            let found = spline.at(row.solids_fraction, width(row));
            row.low_95 <= found && found <= row.high_95
        };
        used.iter().filter(holds).count() as f64 / used.len() as f64
    };
    let mut best: Option<(f64, Spline, f64, f64)> = None;
    let ladder: Vec<f64> = match smoothing {
        Some(smoothing) => vec![smoothing],
        None => (-8..=16).rev().map(|step| 10f64.powf(0.5 * f64::from(step))).collect(),
    };
    for smoothing in ladder {
        let (spline, freedom) = problem.solve(smoothing, &empty);
        let share = inside(&spline);
        if best.as_ref().is_none_or(|(most, ..)| share > *most) {
            best = Some((share, spline, smoothing, freedom));
        }
        if share >= HELD {
            break;
        }
    }
    let (inside, spline, smoothing, freedom) = best.expect("the ladder has a step");
    let goodness =
        problem.goodness(&used, freedom, |row| spline.at(row.solids_fraction, width(row)));
    let low = used.iter().map(|row| row.solids_fraction_low.max(0.0)).fold(1.0, f64::min);
    let ranges = vec![
        // A limit that it has by construction, as at D = 0.
        ValidRange { marker: Marker::SolidsFraction, low, high: packing },
        ValidRange {
            marker: Marker::FilterWidth,
            low: if narrowest < widest { 0.0 } else { 0.999 * narrowest },
            high: widest,
        },
    ];
    Ok(SplineFit { spline, reference_length, smoothing, inside, goodness, ranges })
}

/// The penalised least squares in the increments d_ij = c_ij - c_i(j-1), all of which are ≥ 0.
struct Problem {
    floor: f64,
    /// Bᵀ W B, Bᵀ W y and the penalty.
    matrix: Mat<f64>,
    right: Col<f64>,
    penalty: Mat<f64>,
    columns: usize,
}

impl Problem {
    fn new(rows: &[&BinRow], reference_length: ReferenceLength, spline: &Spline) -> Self {
        // The first and the last along x are zero.
        let (lines, columns) = (spline.fraction_knots.len() - 1, spline.width_knots.len());
        let count = lines * columns;
        let mean_square = rows.iter().map(|row| row.value.powi(2)).sum::<f64>() / rows.len() as f64;
        let mut problem = Self {
            floor: (1e-8 * mean_square).max(f64::MIN_POSITIVE),
            matrix: Mat::zeros(count, count),
            right: Col::zeros(count),
            penalty: Mat::zeros(count, count),
            columns,
        };
        let mut line = vec![0.0; count];
        for row in rows {
            line.fill(0.0);
            let scaled = reference_length.scaled_width(row);
            let x = (row.solids_fraction / spline.fraction_scale).ln_1p();
            let (i, along_x) = basis(&spline.fraction_knots, x);
            let (j, along_y) = basis(&spline.width_knots, scaled / (scaled + spline.width_scale));
            for (a, x) in along_x.into_iter().enumerate() {
                let Some(i) = (i + a).checked_sub(1).filter(|i| *i < lines) else { continue };
                for (b, y) in along_y.into_iter().enumerate() {
                    // c_ij is the sum of the increments up to j.
                    (0..j + b).for_each(|k| line[i * columns + k] += x * y);
                }
            }
            let weight = problem.weight(row);
            let seen: Vec<usize> = (0..count).filter(|k| line[*k] != 0.0).collect();
            for &k in &seen {
                problem.right[k] += weight * line[k] * row.value;
                for &l in &seen {
                    problem.matrix[(k, l)] += weight * line[k] * line[l];
                }
            }
        }
        // Second differences; a coefficient before the first is zero along x and along y.
        let mut add = |terms: &[(isize, isize, f64)]| {
            let mut line = vec![0.0; count];
            for &(i, j, factor) in terms {
                if i >= 0 && j >= 0 {
                    (0..=j as usize).for_each(|k| line[i as usize * columns + k] += factor);
                }
            }
            for k in 0..count {
                for l in 0..count {
                    problem.penalty[(k, l)] += line[k] * line[l];
                }
            }
        };
        let differences = [1.0, -2.0, 1.0];
        for i in 0..lines as isize {
            for j in 0..columns as isize {
                let along = |step: [isize; 2]| {
                    [0, 1, 2].map(|k| (i - k * step[0], j - k * step[1], differences[k as usize]))
                };
                // Along x the rise at small fractions is free to be steep.
                if i >= 2 {
                    add(&along([1, 0]));
                }
                if j >= 1 {
                    add(&along([0, 1]));
                }
            }
        }
        problem
    }

    fn weight(&self, row: &BinRow) -> f64 {
        1.0 / (row.standard_error.powi(2) + self.floor)
    }

    /// How well `at` follows the rows with so many parameters' `freedom`.
    fn goodness(&self, rows: &[&BinRow], freedom: f64, at: impl Fn(&BinRow) -> f64) -> Goodness {
        let points = rows.len();
        let degrees_of_freedom = points - (freedom.round() as usize).min(points - 1);
        let total: f64 = rows.iter().map(|row| self.weight(row)).sum();
        let mean = rows.iter().map(|row| self.weight(row) * row.value).sum::<f64>() / total;
        let sum = |of: &dyn Fn(&BinRow) -> f64| rows.iter().map(|row| of(row)).sum::<f64>();
        let scatter = sum(&|row| self.weight(row) * (row.value - mean).powi(2));
        let square = |row: &BinRow| (row.value - at(row)).powi(2);
        let unexplained = sum(&|row| self.weight(row) * square(row));
        // χ² with s falls in s: bisection, between none and the largest residual.
        let goal = degrees_of_freedom as f64;
        let with = |s: f64| sum(&|row| square(row) / (1.0 / self.weight(row) + s * s));
        let (mut low, mut high) =
            (0.0, rows.iter().map(|row| square(row).sqrt()).fold(0.0, f64::max));
        high *= (points as f64).sqrt();
        let extra_scatter = if unexplained <= goal {
            0.0
        } else {
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                *if with(middle) > goal { &mut low } else { &mut high } = middle;
            }
            high
        };
        let sigma = |row: &BinRow| (1.0 / self.weight(row) + extra_scatter.powi(2)).sqrt();
        let scaled: Vec<f64> = rows.iter().map(|row| (row.value - at(row)) / sigma(row)).collect();
        let neighbours = rows.windows(2).zip(scaled.windows(2));
        let pairs: Vec<f64> = neighbours
            .filter(|(rows, _)| {
                rows[0].filter_width == rows[1].filter_width
                    && rows[0].solids_fraction < rows[1].solids_fraction
            })
            .map(|(_, pair)| pair[0] * pair[1])
            .collect();
        let mean_square = scaled.iter().map(|r| r * r).sum::<f64>() / points as f64;
        let mean_product = pairs.iter().sum::<f64>() / pairs.len().max(1) as f64;
        Goodness {
            points,
            degrees_of_freedom,
            r_squared: 1.0 - unexplained / scatter,
            rmse: (sum(&square) / points as f64).sqrt(),
            reduced_chi_squared: unexplained / goal,
            extra_scatter,
            neighbour_correlation: if mean_square > 0.0 { mean_product / mean_square } else { 0.0 },
        }
    }

    /// The minimum for λ = `smoothing`, by active sets, and its freedom: the trace of what maps values to
    /// fitted values.
    fn solve(&self, smoothing: f64, empty: &Spline) -> (Spline, f64) {
        let count = self.right.nrows();
        let mean = (0..count).map(|k| self.matrix[(k, k)]).sum::<f64>() / count as f64;
        // What neither bins nor penalty fix is as small as it can be.
        let tiny = 1e-12 * mean;
        let full = Mat::from_fn(count, count, |k, l| {
            let ridge = if k == l { tiny } else { 0.0 };
            self.matrix[(k, l)] + smoothing * self.penalty[(k, l)] + ridge
        });
        let mut values = vec![0.0; count];
        let mut free: Vec<usize> = Vec::new();
        let slope = |values: &[f64], k: usize| {
            self.right[k] - (0..count).map(|l| full[(k, l)] * values[l]).sum::<f64>()
        };
        let scale = (0..count).map(|k| self.right[k].abs()).fold(0.0, f64::max);
        for _ in 0..10 * count {
            let next = (0..count)
                .filter(|k| !free.contains(k))
                .map(|k| (slope(&values, k), k))
                .max_by(|a, b| a.0.total_cmp(&b.0))
                .filter(|(slope, _)| *slope > 1e-10 * scale);
            let Some((_, next)) = next else { break };
            free.push(next);
            free.sort_unstable();
            loop {
                let part = Mat::from_fn(free.len(), free.len(), |a, b| full[(free[a], free[b])]);
                let right = Col::from_fn(free.len(), |a| self.right[free[a]]);
                let Ok(factors) = part.llt(Side::Lower) else { break };
                let wanted = factors.solve(&right);
                // As far towards it as nothing becomes negative.
                let step = (0..free.len())
                    .filter(|a| wanted[*a] <= 0.0)
                    .map(|a| values[free[a]] / (values[free[a]] - wanted[a]))
                    .fold(1.0, f64::min);
                for (a, k) in free.iter().enumerate() {
                    values[*k] += step * (wanted[a] - values[*k]);
                }
                if step == 1.0 {
                    break;
                }
                let none = 1e-14 * values.iter().copied().fold(0.0, f64::max);
                for k in &free {
                    if values[*k] <= none {
                        values[*k] = 0.0;
                    }
                }
                free.retain(|k| values[*k] > 0.0);
                if free.is_empty() {
                    break;
                }
            }
        }
        let mut spline = empty.clone();
        let lines = count / self.columns;
        for (i, row) in spline.coefficients.iter_mut().enumerate().skip(1).take(lines) {
            let mut sum = 0.0;
            for (j, coefficient) in row.iter_mut().enumerate().skip(1) {
                sum += values[(i - 1) * self.columns + j - 1].max(0.0);
                *coefficient = f64::min(sum, CEILING);
            }
        }
        let part =
            |of: &Mat<f64>| Mat::from_fn(free.len(), free.len(), |a, b| of[(free[a], free[b])]);
        let hat = part(&full).llt(Side::Lower).map(|factors| factors.solve(part(&self.matrix)));
        let freedom =
            hat.map_or(free.len() as f64, |hat| (0..free.len()).map(|k| hat[(k, k)]).sum());
        (spline, freedom)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::expression::{Expression, Meaning, Program};
    use crate::fit::tests::{PLANTED, WIDTHS, synthetic};
    use crate::forms::{ClosureForm, SaturatingDrag};
    use std::collections::BTreeMap;

    fn fitted(noise: f64, seed: u64) -> (Vec<BinRow>, SplineFit) {
        let rows = synthetic(&WIDTHS, 0.58, noise, seed);
        let fit = fit_spline(&rows, ReferenceLength::One, 0.65, None).unwrap();
        (rows, fit)
    }

    /// The surface by its formulae.
    fn program(spline: &Spline) -> Program {
        let formulae = spline.formulae("h");
        let all: BTreeMap<String, Expression> = formulae
            .into_iter()
            .map(|(name, text)| (name, Expression::parse(&text).unwrap()))
            .collect();
        let meaning = |name: &str| match name {
            "phi" => Some(Meaning::Input(0)),
            "D" => Some(Meaning::Input(1)),
            name => all.get(name).map(Meaning::Formula),
        };
        Program::compile(&all["h"], 2, &meaning).unwrap()
    }

    #[test]
    fn the_surface_follows_what_was_planted() {
        let (_, fit) = fitted(0.01, 3);
        assert!(fit.inside >= 0.93, "{}", fit.inside);
        assert!(fit.goodness.r_squared > 0.99, "{:?}", fit.goodness);
        let mut sum = 0.0;
        for i in 1..28 {
            for width in [1.0, 1.5, 3.0, 4.0, 6.0, 12.0] {
                let phi = 0.02 * f64::from(i);
                let exact = SaturatingDrag.predict(&PLANTED, &[phi, width]);
                sum += (fit.spline.at(phi, width) - exact).powi(2);
            }
        }
        let rms = f64::sqrt(sum / (27.0 * 6.0));
        // Less than the bins' own noise: it is smoothed away.
        assert!(rms < 0.007, "root mean square deviation {rms}");
    }

    #[test]
    fn it_is_shaped_by_construction() {
        for seed in 0..5 {
            let (_, fit) = fitted(0.1, seed);
            fit.spline.check().unwrap();
            for i in 0..=116 {
                let phi = 0.005 * f64::from(i);
                assert_eq!(fit.spline.at(phi, 0.0), 0.0);
                let mut before = 0.0;
                for j in 0..=200 {
                    let value = fit.spline.at(phi, 0.1 * f64::from(j));
                    assert!((0.0..1.0).contains(&value), "{value}");
                    assert!(value >= before - 1e-15, "{phi} {j}");
                    before = value;
                }
            }
            assert_eq!(fit.spline.at(0.0, 4.0), 0.0);
            assert_eq!((fit.spline.at(0.65, 4.0), fit.spline.at(0.9, 4.0)), (0.0, 0.0));
        }
    }

    #[test]
    fn slopes_are_continuous() {
        let (_, fit) = fitted(0.05, 1);
        let spline = &fit.spline;
        for knot in &spline.fraction_knots[1..PIECES] {
            let phi = spline.fraction_scale * knot.exp_m1();
            let slope = |side: f64| {
                let step = 1e-7 * phi * side;
                (spline.at(phi + step, 4.0) - spline.at(phi, 4.0)) / step
            };
            let (left, right) = (slope(-1.0), slope(1.0));
            assert!((left - right).abs() < 1e-4 * (1.0 + left.abs()), "{phi}: {left} {right}");
        }
    }

    #[test]
    fn formulae_give_the_same_surface() {
        let (_, fit) = fitted(0.05, 2);
        let program = program(&fit.spline);
        for i in 0..=60 {
            for width in [0.0, 0.3, 1.0, 2.5, 4.0, 11.0, 16.0, 100.0] {
                let phi = 0.01 * f64::from(i);
                let found = program.at(&[phi, width]);
                assert!((found - fit.spline.at(phi, width)).abs() < 1e-13, "{phi} {width}");
            }
        }
    }

    #[test]
    fn bad_rows_and_bad_files_are_refused() {
        let (rows, fit) = fitted(0.02, 1);
        let error = |rows: &[BinRow]| {
            fit_spline(rows, ReferenceLength::One, 0.65, None).unwrap_err().to_string()
        };
        let mut bad = rows.clone();
        bad[4].value = f64::NAN;
        assert_eq!(error(&bad), "row 5: value = NaN cannot be fitted; remove the row");
        assert!(
            error(&rows[..5]).starts_with("5 rows with a finite standard error, 12 are needed")
        );
        let spoil = |change: &dyn Fn(&mut Spline)| {
            let mut spline = fit.spline.clone();
            change(&mut spline);
            spline.check().unwrap_err()
        };
        assert!(spoil(&|s| s.width_scale = 0.0).starts_with("width_scale = 0: a positive"));
        assert!(spoil(&|s| s.fraction_knots[3] = 0.0).starts_with("fraction_knots: 2 to 50"));
        assert!(spoil(&|s| s.coefficients[2].truncate(1)).starts_with("coefficients: 15 lists of"));
        assert_eq!(
            spoil(&|s| s.coefficients[2][2] = 1.0),
            "coefficients: 1 is not from 0 to below 1"
        );
    }

    /// Bar 3, on the default run's bins: the curve lies within their intervals.
    #[test]
    fn the_default_runs_bins_hold_the_surface() {
        let text = include_str!("../data/default/drag_correction.csv");
        let rows = crate::table::parse_bins(text.as_bytes(), std::path::Path::new("bins.csv"));
        let fit = fit_spline(&rows.unwrap(), ReferenceLength::One, 0.65, None).unwrap();
        let points = fit.goodness.points;
        assert!(points > 100 && fit.inside >= HELD, "{} of {points}", fit.inside);
    }
}
