//! [`Limit`]: what values on cells of several sizes say of infinitely fine cells.
//!
//! A value on cells of edge h misses the one on infinitely fine cells by a power of h (Richardson):
//! value(h) = value₀ + c h^p, fitted by weighted least squares, each grid weighing one over its squared
//! standard error. Sampling error and grid error stay apart: value₀ is a linear combination of the
//! values, which gives its standard error from sampling, and the error of the finest grid is
//! value − value₀ there, with a standard error of its own. The order p is given, or that of
//! [`observed_order`], which many values may share.

/// A value on one grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnGrid {
    /// Edge of its cells h \[m, or any unit that all share\].
    pub cell: f64,
    /// Value.
    pub value: f64,
    /// Standard error from sampling; finite.
    pub standard_error: f64,
}

/// The order that is taken where the values do not show one.
pub const ASSUMED_ORDER: f64 = 1.0;

/// Orders that are believed: below, values hardly converge; schemes are of second order, and what is
/// found is uncertain.
const ORDERS: [f64; 2] = [0.5, 3.0];

/// Steps of the search for an order; what remains is halved until the order is known as well as asked.
const STEPS: usize = 25;

/// How well an order may be known: beyond, it is round-off.
pub const PRECISE: f64 = 1e-10;

/// Grids whose cells are less than this many times larger than others say nothing of a limit.
const LEAST_RATIO: f64 = 1.1;

/// Errors count as at least this share of the largest value: one that is exact does not weigh
/// infinitely.
const LEAST_ERROR: f64 = 1e-9;

/// The limit of infinitely fine cells.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// value₀.
    pub value: f64,
    /// Its standard error from sampling, the order taken as known.
    pub standard_error: f64,
    /// Error of the finest grid, value − value₀ there.
    pub grid_error: f64,
    /// Standard error of that, from sampling, the order taken as known.
    pub grid_standard_error: f64,
    /// Sum of the squared residuals in standard errors, of as many degrees of freedom as there are
    /// grids beyond two.
    pub chi_squared: f64,
}

/// Least squares of value₀ + c x on x = (h/h_least)^p.
struct Line {
    /// Residual, x and weight of each grid.
    points: Vec<[f64; 3]>,
    limit: f64,
    slope: f64,
    /// What each grid's value counts for in the limit.
    shares: Vec<f64>,
}

impl Line {
    fn new(grids: &[OnGrid], order: f64) -> Self {
        let least = finest(grids);
        let largest = grids.iter().map(|grid| grid.value.abs()).fold(0.0, f64::max);
        let points: Vec<[f64; 3]> = grids
            .iter()
            .map(|grid| {
                let error = grid.standard_error.max(LEAST_ERROR * largest).max(1e-150);
                [grid.value, (grid.cell / least).powf(order), error.powi(-2)]
            })
            .collect();
        let sum = |of: &dyn Fn(&[f64; 3]) -> f64| -> f64 { points.iter().map(of).sum() };
        let weight = sum(&|[_, _, w]| *w);
        let [value, x] = [sum(&|[v, _, w]| w * v), sum(&|[_, x, w]| w * x)].map(|sum| sum / weight);
        let spread = sum(&|[_, at, w]| w * (at - x).powi(2));
        let slope = sum(&|[v, at, w]| w * (at - x) * (v - value)) / spread;
        let limit = value - slope * x;
        let share = |[_, at, w]: &[f64; 3]| w * (1.0 / weight - x * (at - x) / spread);
        let shares = points.iter().map(share).collect();
        let residual = |[v, at, w]: [f64; 3]| [v - limit - slope * at, at, w];
        Self { points: points.into_iter().map(residual).collect(), limit, slope, shares }
    }

    fn chi_squared(&self) -> f64 {
        self.points.iter().map(|[residual, _, weight]| weight * residual * residual).sum()
    }

    /// ∂χ²/∂p: limit and slope are where χ² does not change with them.
    fn derivative(&self, grids: &[OnGrid]) -> f64 {
        let least = finest(grids);
        let part = |(grid, [residual, x, weight]): (&OnGrid, &[f64; 3])| {
            -2.0 * weight * residual * self.slope * x * (grid.cell / least).ln()
        };
        grids.iter().zip(&self.points).map(part).sum()
    }
}

fn finest(grids: &[OnGrid]) -> f64 {
    grids.iter().map(|grid| grid.cell).fold(f64::INFINITY, f64::min)
}

/// Whether the grids differ enough to say something of a limit.
fn differ(grids: &[OnGrid]) -> bool {
    let coarsest = grids.iter().map(|grid| grid.cell).fold(0.0, f64::max);
    coarsest > LEAST_RATIO * finest(grids)
}

/// The limit of the values on `grids` at the order p; none of one grid, or of grids that are alike.
pub fn limit(grids: &[OnGrid], order: f64) -> Option<Limit> {
    if !differ(grids) {
        return None;
    }
    let line = Line::new(grids, order);
    let least = finest(grids);
    let finest = grids.iter().position(|grid| grid.cell == least)?;
    let error = |shares: &dyn Fn(usize) -> f64| {
        let parts = grids.iter().enumerate();
        parts.map(|(n, grid)| (shares(n) * grid.standard_error).powi(2)).sum::<f64>().sqrt()
    };
    let of_finest = |n| if n == finest { 1.0 } else { 0.0 };
    Some(Limit {
        value: line.limit,
        standard_error: error(&|n| line.shares[n]),
        grid_error: grids[finest].value - line.limit,
        grid_standard_error: error(&|n| of_finest(n) - line.shares[n]),
        chi_squared: line.chi_squared(),
    })
}

/// The order at which χ² of all `values` together, each on three grids or more, is least; values on
/// fewer grids do not count; to `within`. None if no value counts, or the best order is not one that is
/// believed, 0.5 to 3.
pub fn observed_order(values: &[Vec<OnGrid>], within: f64) -> Option<f64> {
    let counted: Vec<&Vec<OnGrid>> =
        values.iter().filter(|grids| grids.len() > 2 && differ(grids)).collect();
    if counted.is_empty() {
        return None;
    }
    let lines = |order: f64| counted.iter().map(move |grids| (*grids, Line::new(grids, order)));
    let derivative = |order| lines(order).map(|(grids, line)| line.derivative(grids)).sum::<f64>();
    let [low, high] = ORDERS;
    let at = |step: usize| low + (high - low) * step as f64 / STEPS as f64;
    let chi_squared =
        |step: usize| lines(at(step)).map(|(_, line)| line.chi_squared()).sum::<f64>();
    let all: Vec<f64> = (0..=STEPS).map(chi_squared).collect();
    let best = (0..=STEPS).min_by(|&a, &b| all[a].total_cmp(&all[b]))?;
    let (mut below, mut above) = (at(best.saturating_sub(1)), at((best + 1).min(STEPS)));
    if derivative(below) > 0.0 || derivative(above) < 0.0 {
        return None;
    }
    while above - below > within {
        let middle = 0.5 * (below + above);
        if derivative(middle) > 0.0 { above = middle } else { below = middle }
    }
    Some(0.5 * (below + above))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn on(cell: f64, value: f64, standard_error: f64) -> OnGrid {
        OnGrid { cell, value, standard_error }
    }

    #[test]
    fn a_power_law_has_its_limit_and_its_order() {
        for order in [0.7f64, 1.0, 1.9, 2.4] {
            let value = |h: f64| 2.5 + 0.3 * h.powf(order);
            // Cells need not halve, and errors need not be alike.
            let grids = [4.0, 2.5, 1.0, 0.6].map(|h| on(h, value(h), 0.01 * (1.0 + h)));
            let found = observed_order(&[grids.to_vec()], PRECISE).unwrap();
            assert!((found - order).abs() < 1e-9, "{found} {order}");
            let limit = limit(&grids, found).unwrap();
            assert!((limit.value - 2.5).abs() < 1e-9, "{limit:?}");
            assert!((limit.grid_error - 0.3 * 0.6f64.powf(order)).abs() < 1e-9, "{limit:?}");
            assert!(limit.chi_squared < 1e-12);
        }
    }

    #[test]
    fn two_grids_are_richardsons_extrapolation() {
        // At first order 2 f(h) - f(2h), and the finer grid misses by f(2h) - f(h) the other way.
        let limit = limit(&[on(2.0, 1.3, 0.03), on(1.0, 1.1, 0.04)], 1.0).unwrap();
        assert!((limit.value - 0.9).abs() < 1e-14);
        assert!((limit.grid_error - 0.2).abs() < 1e-14);
        assert!((limit.standard_error - (0.08f64.powi(2) + 0.03f64.powi(2)).sqrt()).abs() < 1e-14);
        assert!((limit.grid_standard_error - 0.05).abs() < 1e-14);
        assert_eq!(observed_order(&[vec![on(2.0, 1.3, 0.03), on(1.0, 1.1, 0.04)]], PRECISE), None);
    }

    #[test]
    fn three_grids_are_least_squares() {
        // By hand: slope -0.2/4.667 of the values on h, mean 2.1 at h = 7/3.
        let grids = [on(4.0, 2.0, 0.1), on(2.0, 2.2, 0.1), on(1.0, 2.1, 0.1)];
        let limit = limit(&grids, 1.0).unwrap();
        assert!((limit.value - 2.2).abs() < 1e-12, "{limit:?}");
        // Values up and down show no order.
        assert_eq!(observed_order(&[grids.to_vec()], PRECISE), None);
    }

    #[test]
    fn alike_or_exact_grids_do_no_harm() {
        assert_eq!(limit(&[on(1.0, 2.0, 0.1)], 1.0), None);
        assert_eq!(limit(&[on(1.0, 2.0, 0.1), on(1.05, 2.5, 0.1)], 1.0), None);
        let exact = limit(&[on(1.0, 0.0, 0.0), on(2.0, 0.0, 0.0)], 1.0).unwrap();
        assert_eq!((exact.value, exact.standard_error, exact.grid_error), (0.0, 0.0, 0.0));
        let known = limit(&[on(1.0, 3.0, 0.0), on(2.0, 4.0, 0.1)], 1.0).unwrap();
        assert!((known.value - 2.0).abs() < 1e-9);
    }
}
