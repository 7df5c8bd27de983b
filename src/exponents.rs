//! [`collapse`] and [`power_law`]: with which reference length runs of different powders collapse, and how
//! filtered stresses grow with the filter.
//!
//! Between L_I = u_t²/g and L_II = d Fr_p^(1/3) lie the lengths L(n) = L_I Fr_p^n: n = 0 is L_I, n = -2/3 is
//! L_II. The n that collapses a quantity y best is that for which y is one function of φ and Δ_f/L(n) for
//! all powders: for each bin of φ a parabola in z = ln(Δ_f/L_I) - n ln Fr_p, all fitted together, n the
//! least of χ². Whether n is one number or moves with the filter is asked by n = n_0 + n_1 (ln(Δ_f/L_I) -
//! its mean): n_1 = 0 is the hypothesis, and it is doubted where its 95 % interval leaves zero out; n that
//! moves from -2/3 towards 0 with the filter has n_1 > 0. The mean is over the rows fitted.
//!
//! Intervals are those of weighted least squares with errors as large as the misfit asks. Bins of one run
//! err together, which they do not know: where the exponents of replicates of all bins
//! ([`replicates`](crate::replicates)) scatter more than that, the error is their scatter.

use crate::fit::student_quantile;
use crate::replicates::standard_deviation;
use crate::table::BinRow;
use faer::linalg::solvers::SolveLstsq;
use faer::{Col, Mat};
use serde::Serialize;
use std::fmt;

/// A number with its interval.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Exponent {
    /// Value.
    pub value: f64,
    /// Standard error.
    pub standard_error: f64,
    /// Lower end of the 95 % interval.
    pub low_95: f64,
    /// Upper end.
    pub high_95: f64,
}

impl Exponent {
    fn new(value: f64, variance: f64, degrees_of_freedom: usize) -> Self {
        let standard_error = variance.max(0.0).sqrt();
        let half = student_quantile(degrees_of_freedom) * standard_error;
        Self { value, standard_error, low_95: value - half, high_95: value + half }
    }

    /// With the scatter of its replicates, if that is larger.
    fn widened(self, replicates: &[f64]) -> Self {
        let scatter = if replicates.len() < 2 { 0.0 } else { standard_deviation(replicates) };
        if scatter <= self.standard_error {
            return self;
        }
        let Self { value, low_95, high_95, .. } = self;
        // The quantile of Student's t stays that of the degrees of freedom.
        let wider = scatter / self.standard_error.max(f64::MIN_POSITIVE);
        let (low_95, high_95) =
            (value + wider * (low_95 - value), value + wider * (high_95 - value));
        Self { value, standard_error: scatter, low_95, high_95 }
    }

    /// Whether a number is in the interval.
    pub fn holds(&self, x: f64) -> bool {
        self.low_95 <= x && x <= self.high_95
    }
}

impl fmt::Display for Exponent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} [{:.3}, {:.3}]", self.value, self.low_95, self.high_95)
    }
}

/// How a quantity of several powders collapses.
#[derive(Clone, Debug, Serialize)]
pub struct Collapse {
    /// Quantity.
    pub quantity: String,
    /// Rows used.
    pub points: usize,
    /// The n that is the same for all filter widths.
    pub constant: Exponent,
    /// χ² per degree of freedom with it.
    pub reduced_chi_squared: f64,
    /// n at the mean filter width, if it may move.
    pub middle: Exponent,
    /// n_1: how much it moves when the filter grows e-fold.
    pub shift: Exponent,
    /// Δ_f/L_I of the narrowest and the widest filter.
    pub widths: [f64; 2],
}

/// A power law of a quantity of one run.
#[derive(Clone, Debug, Serialize)]
pub struct PowerLaw {
    /// Quantity.
    pub quantity: String,
    /// Rows used.
    pub points: usize,
    /// Exponent of Δ_f at given shear rate, or of Δ_f alone if the rows are not binned by it.
    pub width: Exponent,
    /// Exponent of S; none if the rows are not binned by it.
    pub shear: Option<Exponent>,
}

/// Rows of which nothing can be said.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExponentError {
    /// All runs have one Froude number.
    #[error(
        "{quantity}: all runs have Fr_p = {froude:.4}: lengths L_I Fr_p^n differ between powders only, \
         give runs of two or more"
    )]
    OneFroude {
        /// Quantity.
        quantity: String,
        /// Fr_p.
        froude: f64,
    },
    /// Too few rows.
    #[error("{quantity}: {found} rows are shared by powders and widths, {needed} are needed")]
    TooFewRows {
        /// Quantity.
        quantity: String,
        /// Rows.
        found: usize,
        /// Rows needed.
        needed: usize,
    },
    /// The least-squares problem has no answer.
    #[error("{quantity}: the rows do not fix an exponent")]
    Open {
        /// Quantity.
        quantity: String,
    },
}

/// A row as both fits see it.
struct Point {
    /// Bin of φ, counted from 0.
    bin: usize,
    width: f64,
    froude: f64,
    value: f64,
    error: f64,
}

/// Rows of `quantity` of each run with its Fr_p, in bins of φ, those with a finite error.
fn points(runs: &[(f64, &[BinRow])], quantity: &str) -> (Vec<Point>, usize) {
    let mut bins: Vec<u64> = Vec::new();
    let mut points = Vec::new();
    for (froude, rows) in runs {
        for row in rows.iter().filter(|row| row.quantity == quantity) {
            let scale = if row.value == 0.0 { f64::NAN } else { row.value_scaled / row.value };
            let error = row.standard_error * scale.abs();
            if !(error.is_finite() && error > 0.0) {
                continue;
            }
            let key = row.solids_fraction_low.to_bits();
            let bin = bins.iter().position(|other| *other == key).unwrap_or_else(|| {
                bins.push(key);
                bins.len() - 1
            });
            let (width, value) = (row.filter_width_l_i, row.value_scaled);
            points.push(Point { bin, width, froude: *froude, value, error });
        }
    }
    (points, bins.len())
}

/// Weighted residuals of the best parabola of each bin of φ, for n_0 and n_1.
fn residuals(points: &[Point], bins: usize, n: [f64; 2], middle: f64) -> Vec<f64> {
    let at = |p: &Point| p.width.ln() - (n[0] + n[1] * (p.width.ln() - middle)) * p.froude.ln();
    let mut residuals = vec![0.0; points.len()];
    for bin in 0..bins {
        let here: Vec<usize> = (0..points.len()).filter(|i| points[*i].bin == bin).collect();
        if here.is_empty() {
            continue;
        }
        let mean = here.iter().map(|i| at(&points[*i])).sum::<f64>() / here.len() as f64;
        let power = |i: usize, k: usize| (at(&points[i]) - mean).powi(k as i32) / points[i].error;
        let matrix = Mat::from_fn(here.len(), 3, |a, k| power(here[a], k));
        let right = Col::from_fn(here.len(), |a| points[here[a]].value / points[here[a]].error);
        let solution = matrix.col_piv_qr().solve_lstsq(&right);
        for (a, &i) in here.iter().enumerate() {
            residuals[i] = right[a] - (0..3).map(|k| matrix[(a, k)] * solution[k]).sum::<f64>();
        }
    }
    residuals
}

/// The n that collapses `quantity` of runs, each with its Fr_p.
///
/// # Errors
/// [`ExponentError`] for runs of one Froude number, or too few rows.
pub fn collapse(runs: &[(f64, &[BinRow])], quantity: &str) -> Result<Collapse, ExponentError> {
    let name = || quantity.to_owned();
    let first = runs.first().map_or(f64::NAN, |run| run.0);
    if runs.iter().all(|(froude, _)| (froude / first - 1.0).abs() < 0.05) {
        return Err(ExponentError::OneFroude { quantity: name(), froude: first });
    }
    let (mut points, bins) = points(runs, quantity);
    // A parabola of three parameters needs more rows than that, and of more than one powder.
    let good: Vec<bool> = (0..bins)
        .map(|bin| {
            let here: Vec<&Point> = points.iter().filter(|p| p.bin == bin).collect();
            here.len() >= 6 && here.iter().any(|p| p.froude != here[0].froude)
        })
        .collect();
    points.retain(|p| good[p.bin]);
    let fitted = 3 * good.iter().filter(|good| **good).count();
    let needed = fitted.max(3) + 4;
    if points.len() < needed {
        return Err(ExponentError::TooFewRows { quantity: name(), found: points.len(), needed });
    }
    let middle = points.iter().map(|p| p.width.ln()).sum::<f64>() / points.len() as f64;
    let square =
        |n: [f64; 2]| residuals(&points, bins, n, middle).iter().map(|r| r * r).sum::<f64>();
    let open = || ExponentError::Open { quantity: name() };
    let solve = |parameters: usize| -> Option<([f64; 2], Mat<f64>, f64)> {
        let start = (-15..=8).map(|k| [0.1 * f64::from(k), 0.0]);
        let mut n = start.min_by(|a, b| square(*a).total_cmp(&square(*b)))?;
        let slopes = |n: [f64; 2]| {
            let columns: Vec<Vec<f64>> = (0..parameters)
                .map(|k| {
                    let step = 1e-5;
                    let moved = |by: f64| {
                        let mut n = n;
                        n[k] += by;
                        residuals(&points, bins, n, middle)
                    };
                    let (high, low) = (moved(step), moved(-step));
                    high.iter().zip(low).map(|(a, b)| (a - b) / (2.0 * step)).collect()
                })
                .collect();
            Mat::from_fn(points.len(), parameters, |i, k| columns[k][i])
        };
        // Gauss-Newton steps, halved until they lead down.
        for _ in 0..50 {
            let now = residuals(&points, bins, n, middle);
            let right = Col::from_fn(now.len(), |i| -now[i]);
            let step = slopes(n).col_piv_qr().solve_lstsq(&right);
            let before = square(n);
            let mut length = 1.0;
            let moved = loop {
                let mut next = n;
                (0..parameters).for_each(|k| next[k] += length * step[k]);
                if square(next) < before {
                    break Some(next);
                }
                length *= 0.5;
                if length < 1e-6 {
                    break None;
                }
            };
            match moved {
                Some(next) => n = next,
                None => break,
            }
        }
        let slopes = slopes(n);
        let normal = slopes.transpose() * &slopes;
        let determinant = match parameters {
            1 => normal[(0, 0)],
            _ => normal[(0, 0)] * normal[(1, 1)] - normal[(0, 1)] * normal[(1, 0)],
        };
        (determinant > 0.0).then(|| {
            let inverse = match parameters {
                1 => Mat::from_fn(1, 1, |_, _| 1.0 / determinant),
                _ => Mat::from_fn(2, 2, |i, k| {
                    let sign = if i == k { 1.0 } else { -1.0 };
                    sign * normal[(1 - i, 1 - k)] / determinant
                }),
            };
            (n, inverse, square(n))
        })
    };
    let degrees = |parameters: usize| points.len() - fitted - parameters;
    let misfit = |square: f64, parameters: usize| square / degrees(parameters) as f64;
    let (one, one_inverse, one_square) = solve(1).ok_or_else(open)?;
    let (two, two_inverse, two_square) = solve(2).ok_or_else(open)?;
    let inflation = misfit(two_square, 2).max(1.0);
    let widths = points.iter().map(|p| p.width);
    let narrowest = widths.clone().fold(f64::INFINITY, f64::min);
    Ok(Collapse {
        quantity: name(),
        points: points.len(),
        constant: Exponent::new(
            one[0],
            one_inverse[(0, 0)] * misfit(one_square, 1).max(1.0),
            degrees(1),
        ),
        reduced_chi_squared: misfit(one_square, 1),
        middle: Exponent::new(two[0], two_inverse[(0, 0)] * inflation, degrees(2)),
        shift: Exponent::new(two[1], two_inverse[(1, 1)] * inflation, degrees(2)),
        widths: [narrowest, widths.fold(0.0, f64::max)],
    })
}

/// The power law of `quantity` over filter width and, if the rows are binned by it, shear rate, a factor
/// for each bin of φ.
///
/// # Errors
/// [`ExponentError`] for too few rows with a positive value.
pub fn power_law(rows: &[BinRow], quantity: &str) -> Result<PowerLaw, ExponentError> {
    let name = || quantity.to_owned();
    let good = |row: &&BinRow| {
        row.quantity == quantity
            && row.value > 0.0
            && row.standard_error > 0.0
            && row.standard_error < 0.5 * row.value
            && row.shear_rate > 0.0
    };
    let rows: Vec<&BinRow> = rows.iter().filter(good).collect();
    let mut bins: Vec<u64> = rows.iter().map(|row| row.solids_fraction_low.to_bits()).collect();
    bins.sort_unstable();
    bins.dedup();
    let by_shear = rows.iter().any(|row| row.shear_rate_low.is_finite());
    let slopes = 1 + usize::from(by_shear);
    let count = bins.len() + slopes;
    if rows.len() < count + 2 {
        return Err(ExponentError::TooFewRows {
            quantity: name(),
            found: rows.len(),
            needed: count + 2,
        });
    }
    // Error of the logarithm.
    let error = |row: &BinRow| row.standard_error / row.value;
    let matrix = Mat::from_fn(rows.len(), count, |i, k| {
        let row = rows[i];
        let number = match k {
            0 => row.filter_width_l_i.ln(),
            1 if by_shear => row.shear_rate.ln(),
            k => f64::from(u8::from(row.solids_fraction_low.to_bits() == bins[k - slopes])),
        };
        number / error(row)
    });
    let right = Col::from_fn(rows.len(), |i| rows[i].value_scaled.ln() / error(rows[i]));
    let solution = matrix.col_piv_qr().solve_lstsq(&right);
    let left_over = &right - &matrix * &solution;
    let degrees = rows.len() - count;
    let inflation = (left_over.squared_norm_l2() / degrees as f64).max(1.0);
    let decomposition = matrix.thin_svd().map_err(|_| ExponentError::Open { quantity: name() })?;
    let (singular, directions) = (decomposition.S(), decomposition.V());
    if singular[count - 1] < 1e-10 * singular[0] {
        return Err(ExponentError::Open { quantity: name() });
    }
    let variance = |k: usize| {
        inflation * (0..count).map(|j| (directions[(k, j)] / singular[j]).powi(2)).sum::<f64>()
    };
    Ok(PowerLaw {
        quantity: name(),
        points: rows.len(),
        width: Exponent::new(solution[0], variance(0), degrees),
        shear: by_shear.then(|| Exponent::new(solution[1], variance(1), degrees)),
    })
}

impl Collapse {
    /// With errors no smaller than the scatter of what was found in replicates.
    pub fn widened(mut self, replicates: &[Collapse]) -> Self {
        let of = |exponent: fn(&Collapse) -> Exponent| -> Vec<f64> {
            replicates.iter().map(|found| exponent(found).value).collect()
        };
        self.constant = self.constant.widened(&of(|found| found.constant));
        self.middle = self.middle.widened(&of(|found| found.middle));
        self.shift = self.shift.widened(&of(|found| found.shift));
        self
    }
}

impl PowerLaw {
    /// With errors no smaller than the scatter of what was found in replicates.
    pub fn widened(mut self, replicates: &[PowerLaw]) -> Self {
        let widths: Vec<f64> = replicates.iter().map(|found| found.width.value).collect();
        self.width = self.width.widened(&widths);
        let shears: Vec<f64> =
            replicates.iter().filter_map(|found| Some(found.shear?.value)).collect();
        self.shear = self.shear.map(|shear| shear.widened(&shears));
        self
    }
}

impl fmt::Display for Collapse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { quantity, points, constant, reduced_chi_squared, middle, shift, widths } = self;
        let said = match (shift.holds(0.0), shift.value > 0.0) {
            (true, _) => "a constant n is not doubted",
            (false, true) => "n grows with the filter",
            (false, false) => "n falls with the filter",
        };
        write!(
            f,
            "{quantity}: L(n) = L_I Fr_p^n collapses best with n = {constant} \
             (χ²/ν = {reduced_chi_squared:.2}, {points} rows, Δ_f = {:.2} to {:.2} L_I)\n  \
             moving: n = {middle} in the middle, {shift} more for each e-fold of the filter: {said}",
            widths[0], widths[1]
        )
    }
}

impl fmt::Display for PowerLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { quantity, points, width, shear } = self;
        write!(f, "{quantity} ~ Δ_f^({width})")?;
        match shear {
            Some(shear) => write!(f, " S^({shear}), {points} rows"),
            None => write!(f, ", {points} rows, not binned by S"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::row;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    fn normal(random: &mut Pcg64) -> f64 {
        let (u, v): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    /// Runs of Fr_p = 10, 40 and 200 that collapse with n_0 + n_1 (ln Δ_f/L_I - 0.7).
    fn planted(n: [f64; 2], noise: f64, seed: u64) -> Vec<(f64, Vec<BinRow>)> {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut runs = Vec::new();
        for froude in [10.0f64, 40.0, 200.0] {
            let mut rows = Vec::new();
            for i in 0..6 {
                let phi = 0.05 + 0.05 * f64::from(i);
                for width in [0.5f64, 1.0, 2.0, 4.0, 8.0] {
                    let n = n[0] + n[1] * (width.ln() - std::f64::consts::LN_2);
                    let z = width.ln() - n * froude.ln();
                    let exact = (1.0 - phi) * (0.5 + 0.08 * z - 0.006 * z * z);
                    rows.push(row(width, phi, exact + noise * normal(&mut random), noise));
                }
            }
            runs.push((froude, rows));
        }
        runs
    }

    fn found(runs: &[(f64, Vec<BinRow>)]) -> Collapse {
        let runs: Vec<(f64, &[BinRow])> = runs.iter().map(|(f, rows)| (*f, &rows[..])).collect();
        collapse(&runs, "drag_correction").unwrap()
    }

    #[test]
    fn planted_lengths_are_found() {
        for n in [-2.0 / 3.0, -0.3, 0.0] {
            let found = found(&planted([n, 0.0], 1e-6, 1));
            assert!((found.constant.value - n).abs() < 1e-3, "{found}");
            assert!(found.shift.value.abs() < 1e-3, "{found}");
        }
    }

    #[test]
    fn a_bin_of_one_powder_alone_says_nothing() {
        let mut runs = planted([-0.3, 0.0], 1e-6, 1);
        let without = found(&runs).constant.value;
        for i in 0..8 {
            runs[1].1.push(row(1.0 + f64::from(i), 0.55, 0.1 * f64::from(i), 1e-6));
        }
        assert_eq!(found(&runs).constant.value, without);
    }

    #[test]
    fn intervals_hold_and_the_hypothesis_is_doubted_where_it_is_wrong() {
        let (mut held, mut doubted, mut wrongly) = (0, 0, 0);
        for seed in 0..100 {
            let constant = found(&planted([-0.4, 0.0], 0.005, seed));
            held += u32::from(constant.constant.holds(-0.4));
            wrongly += u32::from(!constant.shift.holds(0.0));
            doubted += u32::from(!found(&planted([-0.4, 0.2], 0.005, seed)).shift.holds(0.0));
        }
        assert!((89..=100).contains(&held), "{held} of 100 intervals hold");
        assert!(wrongly <= 11 && doubted >= 95, "doubted {wrongly} and {doubted} of 100 times");
    }

    #[test]
    fn errors_are_no_smaller_than_the_scatter_of_replicates() {
        let one = found(&planted([-0.4, 0.0], 0.005, 1));
        let others: Vec<Collapse> =
            (2..20).map(|seed| found(&planted([-0.4, 0.0], 0.05, seed))).collect();
        let wider = one.clone().widened(&others);
        let values: Vec<f64> = others.iter().map(|other| other.constant.value).collect();
        assert_eq!(wider.constant.standard_error, standard_deviation(&values));
        assert!(wider.constant.standard_error > 4.0 * one.constant.standard_error);
        let half = |e: Exponent| e.high_95 - e.value;
        let ratio = half(wider.constant) / half(one.constant);
        let errors = wider.constant.standard_error / one.constant.standard_error;
        assert!((ratio / errors - 1.0).abs() < 1e-9, "{ratio} {errors}");
        assert_eq!(one.clone().widened(&[]).constant.high_95, one.constant.high_95);
    }

    #[test]
    fn planted_powers_are_found() {
        let mut random = Pcg64::seed_from_u64(5);
        let mut rows = Vec::new();
        for i in 0..5 {
            for width in [1.0f64, 2.0, 4.0, 8.0] {
                for shear in [0.3f64, 1.0, 3.0] {
                    let phi = 0.05 + 0.1 * f64::from(i);
                    let exact = phi * width.powf(1.2) * shear.powf(0.9);
                    let value = exact * (1.0 + 0.02 * normal(&mut random));
                    let mut row = row(width, phi, value, 0.02 * exact);
                    (row.shear_rate, row.shear_rate_low) = (shear, 0.5 * shear);
                    rows.push(row);
                }
            }
        }
        let law = power_law(&rows, "drag_correction").unwrap();
        assert!(law.width.holds(1.2) && law.width.standard_error < 0.01, "{law}");
        let shear = law.shear.unwrap();
        assert!(shear.holds(0.9) && shear.standard_error < 0.01, "{law}");
    }

    #[test]
    fn what_says_nothing_is_refused() {
        let runs = planted([0.0, 0.0], 0.01, 1);
        let one = [(10.0, &runs[0].1[..]), (10.1, &runs[1].1[..])];
        let error = collapse(&one, "drag_correction").unwrap_err().to_string();
        assert!(error.contains("all runs have Fr_p = 10.0000"), "{error}");
        let two = [(10.0, &runs[0].1[..3]), (40.0, &runs[1].1[..3])];
        let error = collapse(&two, "drag_correction").unwrap_err().to_string();
        assert!(error.contains("rows are shared by powders"), "{error}");
        let error = power_law(&runs[0].1[..3], "drag_correction").unwrap_err().to_string();
        assert!(error.contains("3 rows"), "{error}");
    }
}
