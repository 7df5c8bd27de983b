//! [`LevenbergMarquardt`]: nonlinear least squares for [`argmin`], which ships none.
//!
//! Minimises ½ |r(x)|² from residuals r and their Jacobian J. Each iteration tries one step δ of
//! (JᵀJ + λ D²) δ = -Jᵀ r, found by QR of the stacked [J; √λ D] rather than from the normal
//! equations, which would square the condition number. D holds the largest column norms of J seen
//! so far (Moré 1978), which makes the path independent of the parameters' units; λ follows the
//! ratio of actual to predicted reduction (Nielsen 1999).

use argmin::core::{
    Error, IterState, Jacobian, KV, Operator, Problem, Solver, TerminationReason, TerminationStatus,
};
use faer::linalg::solvers::SolveLstsq;
use faer::{Col, Mat};

/// argmin's state of a least-squares problem; `cost` is ½ |r|².
pub(super) type LeastSquaresState = IterState<Vec<f64>, (), Mat<f64>, (), Vec<f64>, f64>;

/// The solver; see the module's documentation. `IterState::jacobian` is the one at `param`.
#[derive(Clone, Debug)]
pub(super) struct LevenbergMarquardt {
    /// λ, the weight of the damping.
    damping: f64,
    /// Factor of the next increase of λ; doubles with each rejected step in a row.
    growth: f64,
    /// D, the scale of each parameter [residual per parameter].
    scale: Vec<f64>,
    converged: bool,
}

/// Relative step, and cosine between the residuals and the columns of J, below which the solution
/// is taken. A reduction of the cost is no measure until it drowns in round-off: it is of second
/// order in the distance to the minimum.
const TOLERANCE: f64 = 1e-12;

/// λ at which even an arbitrarily small downhill step no longer lowers the cost: the cost is at
/// its round-off floor.
const LARGEST_DAMPING: f64 = 1e16;

impl LevenbergMarquardt {
    pub(super) fn new() -> Self {
        Self { damping: 1e-3, growth: 2.0, scale: Vec::new(), converged: false }
    }

    /// Takes up a new Jacobian: grows D, and reports convergence when r is orthogonal to J.
    fn take_up(&mut self, jacobian: &Mat<f64>, residuals: &[f64]) {
        let size = norm(residuals);
        self.scale.resize(jacobian.ncols(), 0.0);
        let mut steepest = 0.0_f64;
        for (j, scale) in self.scale.iter_mut().enumerate() {
            let column = jacobian.col(j);
            let length = column.norm_l2();
            *scale = scale.max(length);
            if length > 0.0 && size > 0.0 {
                let slope: f64 = column.iter().zip(residuals).map(|(a, b)| a * b).sum();
                steepest = steepest.max((slope / (length * size)).abs());
            }
        }
        self.converged = steepest < TOLERANCE;
    }

    /// δ and the reduction of the cost that the linear model predicts for it.
    fn step(&self, jacobian: &Mat<f64>, residuals: &[f64]) -> (Vec<f64>, f64) {
        let (rows, columns) = (jacobian.nrows(), jacobian.ncols());
        let root = self.damping.sqrt();
        // A parameter without any influence has D = 0; 1 keeps the system regular and its step 0.
        let weight = |j: usize| if self.scale[j] > 0.0 { self.scale[j] } else { 1.0 };
        let stacked = Mat::from_fn(rows + columns, columns, |i, j| {
            if i < rows {
                jacobian[(i, j)]
            } else if i - rows == j {
                root * weight(j)
            } else {
                0.0
            }
        });
        let right =
            Mat::from_fn(rows + columns, 1, |i, _| if i < rows { -residuals[i] } else { 0.0 });
        let solution = stacked.col_piv_qr().solve_lstsq(&right);
        let step: Vec<f64> = (0..columns).map(|j| solution[(j, 0)]).collect();
        // ½|r|² - ½|r + Jδ|² = ½|Jδ|² + λ|Dδ|² at the damped solution: a sum of squares.
        let moved = jacobian * Col::from_fn(columns, |j| step[j]);
        let damped: f64 = step.iter().enumerate().map(|(j, d)| (weight(j) * d).powi(2)).sum();
        (step, 0.5 * moved.squared_norm_l2() + self.damping * damped)
    }
}

impl<O> Solver<O, LeastSquaresState> for LevenbergMarquardt
where
    O: Operator<Param = Vec<f64>, Output = Vec<f64>>
        + Jacobian<Param = Vec<f64>, Jacobian = Mat<f64>>,
{
    fn name(&self) -> &str {
        "Levenberg-Marquardt"
    }

    fn init(
        &mut self,
        problem: &mut Problem<O>,
        mut state: LeastSquaresState,
    ) -> Result<(LeastSquaresState, Option<KV>), Error> {
        let Some(start) = state.take_param() else {
            return Err(Error::msg("Levenberg-Marquardt needs an initial parameter vector"));
        };
        let residuals = problem.apply(&start)?;
        let jacobian = problem.jacobian(&start)?;
        self.take_up(&jacobian, &residuals);
        let cost = half_square(&residuals);
        Ok((state.param(start).residuals(residuals).jacobian(jacobian).cost(cost), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<O>,
        mut state: LeastSquaresState,
    ) -> Result<(LeastSquaresState, Option<KV>), Error> {
        let (Some(at), Some(residuals), Some(jacobian)) =
            (state.take_param(), state.take_residuals(), state.take_jacobian())
        else {
            return Err(Error::msg("Levenberg-Marquardt was not initialised"));
        };
        let cost = state.get_cost();
        let (step, predicted) = self.step(&jacobian, &residuals);
        let trial: Vec<f64> = at.iter().zip(&step).map(|(x, d)| x + d).collect();
        let trial_residuals = problem.apply(&trial)?;
        let trial_cost = half_square(&trial_residuals);
        let ratio = (cost - trial_cost) / predicted;

        let scaled = |x: &[f64]| norm_scaled(x, &self.scale);
        let short = scaled(&step) <= TOLERANCE * (scaled(&at) + TOLERANCE);
        let flat = predicted <= f64::EPSILON * cost;

        // A cost that is not a number compares false and is rejected too.
        if trial_cost < cost {
            self.damping *= (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0);
            self.growth = 2.0;
            let jacobian = problem.jacobian(&trial)?;
            self.take_up(&jacobian, &trial_residuals);
            self.converged |= short || flat;
            return Ok((
                state.param(trial).residuals(trial_residuals).jacobian(jacobian).cost(trial_cost),
                None,
            ));
        }
        self.damping *= self.growth;
        self.growth *= 2.0;
        self.converged |= short || flat || self.damping > LARGEST_DAMPING;
        Ok((state.param(at).residuals(residuals).jacobian(jacobian).cost(cost), None))
    }

    fn terminate(&mut self, _state: &LeastSquaresState) -> TerminationStatus {
        if self.converged {
            TerminationStatus::Terminated(TerminationReason::SolverConverged)
        } else {
            TerminationStatus::NotTerminated
        }
    }
}

fn half_square(x: &[f64]) -> f64 {
    0.5 * x.iter().map(|x| x * x).sum::<f64>()
}

fn norm(x: &[f64]) -> f64 {
    (2.0 * half_square(x)).sqrt()
}

fn norm_scaled(x: &[f64], scale: &[f64]) -> f64 {
    x.iter().zip(scale).map(|(x, d)| (x * d).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use argmin::core::{Executor, State};

    /// A problem given by its residuals and Jacobian.
    struct Given(fn(&[f64]) -> Vec<f64>, fn(&[f64]) -> Mat<f64>);

    impl Operator for Given {
        type Param = Vec<f64>;
        type Output = Vec<f64>;
        fn apply(&self, x: &Vec<f64>) -> Result<Vec<f64>, Error> {
            Ok(self.0(x))
        }
    }

    impl Jacobian for Given {
        type Param = Vec<f64>;
        type Jacobian = Mat<f64>;
        fn jacobian(&self, x: &Vec<f64>) -> Result<Mat<f64>, Error> {
            Ok(self.1(x))
        }
    }

    fn solve(problem: Given, start: &[f64]) -> (Vec<f64>, f64, u64) {
        let result = Executor::new(problem, LevenbergMarquardt::new())
            .configure(|state| state.param(start.to_vec()).max_iters(500))
            .timer(false)
            .run()
            .unwrap();
        let state = result.state();
        assert_eq!(state.get_termination_reason(), Some(&TerminationReason::SolverConverged));
        (state.get_best_param().unwrap().clone(), state.get_best_cost(), state.get_iter())
    }

    #[test]
    fn rosenbrock_is_solved_from_its_classical_start() {
        let problem = Given(
            |x| vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]],
            |x| {
                let rows = [[-20.0 * x[0], 10.0], [-1.0, 0.0]];
                Mat::from_fn(2, 2, |i, j| rows[i][j])
            },
        );
        let (x, cost, iterations) = solve(problem, &[-1.2, 1.0]);
        assert!((x[0] - 1.0).abs() < 1e-10 && (x[1] - 1.0).abs() < 1e-10, "{x:?}");
        assert!(cost < 1e-20);
        assert!(iterations < 60, "{iterations} iterations");
    }

    /// NIST StRD "Misra1a": y = b1 (1 - exp(-b2 x)), certified to eleven digits.
    #[test]
    fn misra1a_of_nist_is_solved_to_its_certified_digits() {
        const Y: [f64; 14] = [
            10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40,
            75.47, 81.78,
        ];
        const X: [f64; 14] = [
            77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1,
            689.1, 760.0,
        ];
        for start in [[500.0, 0.0001], [250.0, 0.0005]] {
            let problem = Given(
                |b| (0..14).map(|i| b[0] * (1.0 - (-b[1] * X[i]).exp()) - Y[i]).collect(),
                |b| {
                    Mat::from_fn(14, 2, |i, j| {
                        let decay = (-b[1] * X[i]).exp();
                        if j == 0 { 1.0 - decay } else { b[0] * X[i] * decay }
                    })
                },
            );
            let (b, cost, _) = solve(problem, &start);
            assert!((b[0] / 2.389_421_291_8e2 - 1.0).abs() < 1e-9, "{b:?}");
            assert!((b[1] / 5.501_564_318_1e-4 - 1.0).abs() < 1e-9, "{b:?}");
            assert!((2.0 * cost / 1.245_513_889_4e-1 - 1.0).abs() < 1e-10);
        }
    }

    #[test]
    fn a_parameter_without_influence_stays_where_it_was() {
        let problem = Given(
            |x| vec![x[0] - 3.0, 2.0 * (x[0] - 3.0)],
            |_| Mat::from_fn(2, 2, |i, j| if j == 0 { 1.0 + i as f64 } else { 0.0 }),
        );
        let (x, cost, _) = solve(problem, &[0.0, 7.0]);
        assert!((x[0] - 3.0).abs() < 1e-12 && cost < 1e-24);
        assert_eq!(x[1], 7.0);
    }
}
