//! The pressure equation: -∇·(k ∇x) = b on a periodic grid, k given on faces.
//!
//! Conjugate gradients in the solver's precision, preconditioned by one multigrid cycle in single
//! precision: the cycle only has to point the right way, and halving its memory traffic is most of
//! its speed. Chebyshev-Jacobi smoothing, whose rows vectorise; coarse face coefficients are means
//! of the coincident fine faces; corrections are constant per coarse cell, which keeps the
//! preconditioner symmetric and harmless across jumps of k. Of flat or tall cells the axes along which
//! they are short are halved first.
//!
//! A solve that takes long goes on with K-cycles (Notay & Vassilevski 2008): each coarse problem is
//! solved by two steps of conjugate gradients, preconditioned by what is coarser still. That makes up
//! for corrections that are constant per cell, whose size is wrong where k jumps, at twice the cost
//! of an iteration; a bed in gas is done before. If K-cycles promise to take too long as well, which they
//! do where k jumps by orders of magnitude from face to face, an approximate elimination takes their
//! place.

mod elimination;

use crate::field::{Faces, Field, Layout, Row};
use crate::grid::Grid;
use crate::real::Real;
use crate::rows::{Rows, by_axis, per_axis, simd, sum_axes};
use elimination::Elimination;

/// Precision of the preconditioner, and of the weights.
pub(crate) type Fast = f32;

/// Chebyshev smoothing: an interval of eigenvalues of D⁻¹A that it damps, and in how many sweeps.
type Smoothing = ([f64; 2], usize);

/// The upper end is exact for a weakly diagonally dominant matrix; the lower is where the coarse grid
/// takes over: waves that it does not know are damped at a rate of 1 or more in two dimensions and of 2/3 or more
/// in three. The conjugate gradients want less than that: of clustered beds these take the fewest iterations.
const fn v_cycle(dimensions: usize) -> Smoothing {
    ([if dimensions == 3 { 0.45 } else { 0.75 }, 2.0], 2)
}

/// Where k jumps from face to face, coarse grids know less.
const K_CYCLE: Smoothing = ([0.25, 2.0], 3);

/// On the coarsest grid, which nothing coarser helps.
const COARSEST: Smoothing = ([0.08, 2.0], 8);

/// Residual, in units of round-off of the first, below which one that stops falling will not fall.
const ROUND_OFF: f64 = 1e4;

/// Iterations after which a solve goes on with K-cycles.
const PATIENCE: usize = 6;

/// K-cycles from whose rate the iterations that are left are estimated.
const TRIAL: usize = 6;

/// More iterations left than this are not waited for: a step of the simulators allows itself no more. An
/// elimination costs as much as eighty K-cycles to make, and then takes about forty iterations.
const TOO_MANY: f64 = 60.0;

/// Most that a coarse solution is too small by.
const LONGEST_SHARE: f64 = 8.0;

/// How much longer than the shortest edge of a cell another is that is not yet halved.
const FLAT: f64 = 1.5;

/// How a solve went.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Solve {
    /// Iterations done.
    pub iterations: usize,
    /// Largest remaining |b + ∇·(k ∇x)|.
    pub residual: f64,
}

/// A solver for one grid; holds its scratch, allocates nothing while solving, unless it is hard and an
/// elimination must help.
#[derive(Debug)]
pub struct Poisson<R, const D: usize> {
    rows: Rows<D>,
    inverse_spacing_squared: [f64; D],
    residual: Field<R, D>,
    direction: Field<R, D>,
    image: Field<R, D>,
    levels: Vec<Level<D>>,
}

/// One grid of the multigrid hierarchy.
#[derive(Debug)]
struct Level<const D: usize> {
    rows: Rows<D>,
    /// How many of this level's cells make one of the next, along each axis.
    coarsening: [usize; D],
    /// Edges of its cells \[m\].
    spacing: [f64; D],
    /// k / h² on faces.
    weights: Faces<Fast, D>,
    inverse_diagonal: Field<Fast, D>,
    right: Field<Fast, D>,
    solution: Field<Fast, D>,
    /// The other half of the sweeps' ping-pong; also the residual.
    other: Field<Fast, D>,
    step: Field<Fast, D>,
    /// The first of a K-cycle's two solutions, and A times it; of the finest level empty.
    first: Field<Fast, D>,
    image: Field<Fast, D>,
}

impl<const D: usize> Level<D> {
    fn new(cells: [usize; D], spacing: [f64; D], parallel: bool, finest: bool) -> Self {
        let layout = Layout::new(cells);
        // An odd or tiny axis stays as it is; the others go on being halved, the shortest cells first.
        let halves = cells.map(|n| n % 2 == 0 && n >= 4);
        let short = (0..D).filter(|&a| halves[a]).map(|a| spacing[a]).fold(f64::INFINITY, f64::min);
        let coarsening =
            std::array::from_fn(|a| if halves[a] && spacing[a] < FLAT * short { 2 } else { 1 });
        let kept = if finest { Layout::new([1; D]) } else { layout };
        let zeros = || Field::zeros(layout);
        Self {
            rows: Rows::new(layout, parallel),
            coarsening,
            spacing,
            weights: Field::zero_faces(layout),
            inverse_diagonal: zeros(),
            right: zeros(),
            solution: zeros(),
            other: zeros(),
            step: zeros(),
            first: Field::zeros(kept),
            image: Field::zeros(kept),
        }
    }

    /// The next level, if there is one.
    fn coarser(&self, parallel: bool) -> Option<Self> {
        let cells = self.rows.layout().cells;
        let coarse = std::array::from_fn(|axis| cells[axis] / self.coarsening[axis]);
        let spacing = std::array::from_fn(|axis| self.spacing[axis] * self.coarsening[axis] as f64);
        // Coarse grids are too small to share out.
        let parallel = parallel && coarse.iter().product::<usize>() > 16_384;
        (coarse != cells).then(|| Self::new(coarse, spacing, parallel, false))
    }

    fn set_diagonal(&mut self) {
        let (rows, weights) = (self.rows, &self.weights);
        rows.map([&mut self.inverse_diagonal], |o, [inverse]| {
            let weights: [[&[Fast]; 2]; D] =
                per_axis!(D, |a| [weights[a].row(o), weights[a].row(o.near(a, 1))]);
            inverse_diagonal_row(inverse, weights);
        });
    }

    /// One Chebyshev sweep: step = `keep` step + `scale` D⁻¹ (right - A solution),
    /// solution += step.
    fn sweep(&mut self, keep: Fast, scale: Fast) {
        let Self { rows, weights, right, solution, other, step, inverse_diagonal, .. } = self;
        rows.map([&mut *other, step], |o, [new, step]| {
            let stencil = Stencil::at(weights, solution, o);
            sweep_row(new, step, stencil, right.row(o), inverse_diagonal.row(o), keep, scale);
        });
        std::mem::swap(solution, other);
    }

    /// The first sweep, from a zero solution.
    fn start(&mut self, scale: Fast) {
        let Self { rows, right, step, solution, inverse_diagonal, .. } = self;
        rows.map([step, solution], |o, [step, solution]| {
            first_row(step, solution, right.row(o), inverse_diagonal.row(o), scale);
        });
    }

    /// Smoothing; `first_done` says that the solution was zero and the first sweep is done.
    fn smooth(&mut self, (interval, degree): Smoothing, first_done: bool) {
        let mut coefficients = Chebyshev::new(interval);
        for n in 0..degree {
            let (keep, scale) = coefficients.next();
            if n > 0 || !first_done {
                self.sweep(keep as Fast, scale as Fast);
            }
        }
    }

    /// Takes off the solution's mean, which is nothing but round-off, grown.
    fn take_off_mean(&mut self) {
        let mean = self.solution.mean() as Fast;
        self.rows.each([&mut self.solution], |_, [solution]| {
            solution.iter_mut().for_each(|x| *x -= mean);
        });
    }

    /// right - A solution, into `other`.
    fn set_residual(&mut self) {
        let Self { rows, weights, right, solution, other, .. } = self;
        rows.map([other], |o, [residual]| {
            residual_row(residual, Stencil::at(weights, solution, o), right.row(o));
        });
    }
}

/// The three-term recursion of Chebyshev's iteration on an interval of eigenvalues.
struct Chebyshev {
    centre: f64,
    radius: f64,
    rho: Option<f64>,
}

impl Chebyshev {
    fn new([low, high]: [f64; 2]) -> Self {
        Self { centre: 0.5 * (high + low), radius: 0.5 * (high - low), rho: None }
    }

    /// (keep, scale) of the next sweep.
    fn next(&mut self) -> (f64, f64) {
        let sigma = self.centre / self.radius;
        match self.rho {
            None => {
                self.rho = Some(1.0 / sigma);
                (0.0, 1.0 / self.centre)
            }
            Some(old) => {
                let rho = 1.0 / (2.0 * sigma - old);
                self.rho = Some(rho);
                (rho * old, 2.0 * rho / self.radius)
            }
        }
    }
}

/// What the five- or seven-point operator needs of a row: the solution there, and for each axis the
/// solution beyond the lower and upper faces, and the weights of these.
#[derive(Clone, Copy)]
struct Stencil<'a, R, const D: usize> {
    x: &'a [R],
    beyond: [[&'a [R]; 2]; D],
    weights: [[&'a [Fast]; 2]; D],
}

impl<'a, R: Real, const D: usize> Stencil<'a, R, D> {
    #[inline(always)]
    fn at(weights: &'a Faces<Fast, D>, x: &'a Field<R, D>, o: Row<D>) -> Self {
        Self {
            x: x.row(o),
            beyond: per_axis!(D, |a| [x.row(o.near(a, -1)), x.row(o.near(a, 1))]),
            weights: per_axis!(D, |a| [weights[a].row(o), weights[a].row(o.near(a, 1))]),
        }
    }

    /// The slices, cut to `n`, as [`by_axis`] has them.
    #[inline(always)]
    fn cut(self, n: usize) -> Stencil<'a, R, 3> {
        let (beyond, weights) = (by_axis(self.beyond, n), by_axis(self.weights, n));
        Stencil { x: &self.x[..n], beyond, weights }
    }
}

/// (A x)_i of what [`Stencil::cut`] gives.
macro_rules! operator {
    ($real:ident, $d:ident, $stencil:expr, $i:expr) => {{
        let Stencil { x, beyond, weights } = &$stencil;
        sum_axes!($d, weights, |[lower, upper], axis| {
            let [below, above] = beyond[axis];
            let [lower, upper] = [lower[$i], upper[$i]].map(|weight| $real::of(f64::from(weight)));
            lower * (x[$i] - below[$i]) + upper * (x[$i] - above[$i])
        })
    }};
}

simd! {
    fn inverse_diagonal_row[const D: usize](out: &mut [Fast], weights: [[&[Fast]; 2]; D]) {
        let n = out.len();
        let weights = by_axis(weights, n);
        for i in 0..n {
            out[i] = 1.0 / sum_axes!(D, weights, |[lower, upper], _| lower[i] + upper[i]);
        }
    }
}

simd! {
    fn sweep_row[const D: usize](
        new: &mut [Fast],
        step: &mut [Fast],
        stencil: Stencil<'_, Fast, D>,
        right: &[Fast],
        inverse_diagonal: &[Fast],
        keep: Fast,
        scale: Fast,
    ) {
        let n = new.len();
        let stencil = stencil.cut(n);
        let (step, right, inverse_diagonal) = (&mut step[..n], &right[..n], &inverse_diagonal[..n]);
        for i in 0..n {
            let change = keep * step[i]
                + scale * inverse_diagonal[i] * (right[i] - operator!(Fast, D, stencil, i));
            step[i] = change;
            new[i] = stencil.x[i] + change;
        }
    }
}

simd! {
    /// b - A x.
    fn residual_row[R: Real, const D: usize](out: &mut [R], stencil: Stencil<'_, R, D>, right: &[R]) {
        let n = out.len();
        let (stencil, right) = (stencil.cut(n), &right[..n]);
        for i in 0..n {
            out[i] = right[i] - operator!(R, D, stencil, i);
        }
    }
}

simd! {
    /// The first sweep from a zero solution: right, step and solution at once.
    fn start_row[R: Real](
        right: &mut [Fast],
        step: &mut [Fast],
        solution: &mut [Fast],
        residual: &[R],
        inverse_diagonal: &[Fast],
        scale: Fast,
    ) {
        let n = right.len();
        let (step, solution) = (&mut step[..n], &mut solution[..n]);
        let (residual, inverse_diagonal) = (&residual[..n], &inverse_diagonal[..n]);
        for i in 0..n {
            let b = residual[i].f64() as Fast;
            right[i] = b;
            let change = scale * inverse_diagonal[i] * b;
            step[i] = change;
            solution[i] = change;
        }
    }
}

simd! {
    fn weight_row[R: Real](out: &mut [Fast], coefficient: &[R], scale: R) {
        let coefficient = &coefficient[..out.len()];
        for (out, k) in out.iter_mut().zip(coefficient) {
            *out = (scale * *k).f64() as Fast;
        }
    }
}

simd! {
    fn direction_row[R: Real](direction: &mut [R], preconditioned: &[Fast], beta: R) {
        let preconditioned = &preconditioned[..direction.len()];
        for (p, z) in direction.iter_mut().zip(preconditioned) {
            *p = R::of(f64::from(*z)) + beta * *p;
        }
    }
}

simd! {
    fn image_row[R: Real, const D: usize](image: &mut [R], stencil: Stencil<'_, R, D>) {
        let n = image.len();
        let stencil = stencil.cut(n);
        for i in 0..n {
            image[i] = operator!(R, D, stencil, i);
        }
    }
}

simd! {
    /// x += alpha p, r -= alpha A p.
    fn advance_row[R: Real](x: &mut [R], r: &mut [R], p: &[R], image: &[R], alpha: R) {
        let n = x.len();
        let (r, p, image) = (&mut r[..n], &p[..n], &image[..n]);
        for i in 0..n {
            x[i] += alpha * p[i];
            r[i] -= alpha * image[i];
        }
    }
}

impl<R: Real, const D: usize> Poisson<R, D> {
    /// A solver for `grid`; several threads if `parallel`.
    pub fn new(grid: &Grid<D>, parallel: bool) -> Self {
        let layout = Layout::from(grid);
        let zeros = || Field::zeros(layout);
        let mut levels = vec![Level::new(grid.cells, grid.spacing, parallel, true)];
        while let Some(coarser) = levels[levels.len() - 1].coarser(parallel) {
            levels.push(coarser);
        }
        Self {
            rows: Rows::new(layout, parallel),
            inverse_spacing_squared: grid.spacing.map(|h| 1.0 / (h * h)),
            residual: zeros(),
            direction: zeros(),
            image: zeros(),
            levels,
        }
    }

    /// Takes the face coefficients k, all positive.
    pub fn set_coefficient(&mut self, coefficient: &Faces<R, D>) {
        for axis in 0..D {
            let scale = R::of(self.inverse_spacing_squared[axis]);
            self.rows.map([&mut self.levels[0].weights[axis]], |o, [weights]| {
                weight_row(weights, coefficient[axis].row(o), scale);
            });
        }
        self.prepare();
    }

    /// The face weights k/h², to be set by who calls [`Poisson::prepare`] next. Of single precision
    /// whatever that of the solution: who corrects fluxes by exact weights is left with some 1e-7 of the
    /// correction.
    pub(crate) fn weights_mut(&mut self) -> &mut Faces<Fast, D> {
        &mut self.levels[0].weights
    }

    /// Makes what depends on the weights.
    pub(crate) fn prepare(&mut self) {
        self.levels[0].set_diagonal();
        for n in 1..self.levels.len() {
            let (fine, coarse) = self.levels.split_at_mut(n);
            coarsen_weights(&fine[n - 1], &mut coarse[0]);
            coarse[0].set_diagonal();
        }
    }

    /// Solves for `x`, from what it is, until the largest residual is at most `tolerance`, or until
    /// round-off stops it, or for at most `most` iterations. The mean of `right` must vanish; that of
    /// `x` is left at what it comes to.
    pub fn solve(
        &mut self,
        x: &mut Field<R, D>,
        right: &Field<R, D>,
        tolerance: f64,
        most: usize,
    ) -> Solve {
        let rows = self.rows;
        let (weights, start) = (&self.levels[0].weights, &*x);
        let layout = rows.layout();
        let mut worst = rows
            .map_reduce(
                [&mut self.residual],
                &|o, [residual]| {
                    residual_row(residual, Stencil::at(weights, start, o), right.row(o));
                    layout.largest(residual)
                },
                &R::max,
            )
            .f64();
        let (mut alpha, mut old) = (0.0, 1.0);
        let mut best = worst;
        // A residual that does not fall for a while is at its end only there: conjugate gradients
        // lower another norm than the largest.
        let round_off = ROUND_OFF * R::EPSILON.f64() * worst;
        let mut stalled = 0;
        let mut at_first_k_cycle = worst;
        let mut elimination = None;
        for iteration in 0..most {
            if worst <= tolerance || (stalled >= 8 && worst < round_off) || !worst.is_finite() {
                return Solve { iterations: iteration, residual: worst };
            }
            if iteration == PATIENCE {
                at_first_k_cycle = worst;
            }
            if elimination.is_none() && iteration >= PATIENCE + TRIAL && worst > round_off {
                let done = [at_first_k_cycle, worst];
                if iterations_left(iteration - PATIENCE, done, tolerance) > TOO_MANY {
                    elimination = Elimination::new(&self.levels[0].weights);
                }
            }
            if let Some(elimination) = &mut elimination {
                elimination.solve(&self.residual, &mut self.levels[0].solution);
                self.levels[0].take_off_mean();
            } else {
                self.precondition(iteration >= PATIENCE);
            }
            let Self { levels, residual, direction, image, .. } = self;
            let Level { solution: z, weights, .. } = &levels[0];
            let (zr, zq) = rows.map_reduce::<R, _, 0>(
                [],
                &|o, []| {
                    let z = z.row(o);
                    // At first there is no image yet.
                    let zq = if iteration == 0 { 0.0 } else { layout.dot(z, image.row(o)) };
                    (layout.dot(z, residual.row(o)), zq)
                },
                &|a, b| (a.0 + b.0, a.1 + b.1),
            );
            // Polak-Ribière: z·(r - r_old) = -alpha z·q of the step before; it forgives a
            // preconditioner that rounding makes slightly unsymmetric.
            let beta = if iteration == 0 { 0.0 } else { (-alpha * zq / old).max(0.0) };
            rows.map([&mut *direction], |o, [p]| direction_row(p, z.row(o), R::of(beta)));
            let curvature = rows.map_reduce(
                [&mut *image],
                &|o, [image]| {
                    image_row(image, Stencil::at(weights, direction, o));
                    layout.dot(image, direction.row(o))
                },
                &|a, b| a + b,
            );
            if curvature <= 0.0 {
                return Solve { iterations: iteration, residual: worst };
            }
            let along = if beta == 0.0 { zr } else { product(&rows, residual, direction) };
            alpha = along / curvature;
            old = zr;
            worst = rows
                .map_reduce(
                    [&mut *x, residual],
                    &|o, [x, r]| {
                        advance_row(x, r, direction.row(o), image.row(o), R::of(alpha));
                        layout.largest(r)
                    },
                    &R::max,
                )
                .f64();
            if worst < 0.9 * best {
                best = worst;
                stalled = 0;
            } else {
                stalled += 1;
            }
        }
        Solve { iterations: most, residual: worst }
    }

    /// One cycle on the residual; the result is the finest level's solution.
    fn precondition(&mut self, twice: bool) {
        let Self { levels, residual, .. } = self;
        let scale = first_sweep(levels, twice);
        let Level { rows, right, step, solution, inverse_diagonal, .. } = &mut levels[0];
        rows.map([right, step, solution], |o, [right, step, solution]| {
            let inverse = inverse_diagonal.row(o);
            start_row(right, step, solution, residual.row(o), inverse, scale);
        });
        cycle(levels, twice);
    }
}

/// Iterations that it takes to a tolerance at the rate at which `iterations` led from one residual to
/// another.
fn iterations_left(iterations: usize, [from, to]: [f64; 2], tolerance: f64) -> f64 {
    if to < from {
        iterations as f64 * (to / tolerance).ln() / (from / to).ln()
    } else {
        f64::INFINITY
    }
}

/// How the finest of `levels` is smoothed.
fn smoothing<const D: usize>(levels: &[Level<D>], twice: bool) -> Smoothing {
    match (levels.len(), twice) {
        (1, _) => COARSEST,
        (_, false) => v_cycle(D),
        (_, true) => K_CYCLE,
    }
}

/// The scale of its first sweep.
fn first_sweep<const D: usize>(levels: &[Level<D>], twice: bool) -> Fast {
    let (interval, _) = smoothing(levels, twice);
    Chebyshev::new(interval).next().1 as Fast
}

/// One cycle on the right-hand side of the finest of `levels`, after its first sweep; `twice`: a
/// K-cycle instead of a V-cycle.
fn cycle<const D: usize>(levels: &mut [Level<D>], twice: bool) {
    let smoothing = smoothing(levels, twice);
    let (fine, coarser) = levels.split_first_mut().expect("a level");
    let Some(coarse) = coarser.first_mut() else {
        fine.smooth(smoothing, true);
        return;
    };
    fine.smooth(smoothing, true);
    fine.set_residual();
    restrict(fine, &mut coarse.right);
    correct(coarser, twice);
    prolong(&coarser[0], fine);
    fine.smooth(smoothing, false);
}

/// What the finest of `levels` makes of its right-hand side, from a zero solution: one cycle, or two
/// steps of conjugate gradients preconditioned by it (Notay & Vassilevski 2008, algorithm 3.1).
fn correct<const D: usize>(levels: &mut [Level<D>], twice: bool) {
    let scale = first_sweep(levels, twice);
    levels[0].start(scale);
    cycle(levels, twice);
    if !twice || levels.len() == 1 {
        return;
    }
    let level = &mut levels[0];
    level.take_off_mean();
    std::mem::swap(&mut level.solution, &mut level.first);
    let Level { rows, weights, first, image, right, .. } = level;
    rows.map([&mut *image], |o, [image]| image_row(image, Stencil::at(weights, first, o)));
    let curvature = product(rows, first, image);
    let share = step_length(product(rows, first, right), curvature);
    rows.map([right], |o, [right]| subtract_row(right, image.row(o), share as Fast));
    levels[0].start(scale);
    cycle(levels, twice);
    levels[0].take_off_mean();

    let Level { rows, weights, first, image, right, solution, other, .. } = &mut levels[0];
    let (mixed, second_along) = (product(rows, solution, image), product(rows, solution, right));
    rows.map([&mut *other], |o, [image]| image_row(image, Stencil::at(weights, solution, o)));
    let shared = if curvature > 0.0 { mixed / curvature } else { 0.0 };
    let second_share = step_length(second_along, product(rows, solution, other) - mixed * shared);
    let first_share = share - shared * second_share;
    rows.map([solution], |o, [solution]| {
        combine_row(solution, first.row(o), second_share as Fast, first_share as Fast);
    });
}

/// Σ x y over the cells.
fn product<R: Real, const D: usize>(rows: &Rows<D>, x: &Field<R, D>, y: &Field<R, D>) -> f64 {
    let layout = rows.layout();
    rows.map_reduce::<R, _, 0>([], &|o, []| layout.dot(x.row(o), y.row(o)), &|a, b| a + b)
}

/// How much of a direction lowers the error most, from its product with the residual and its curvature;
/// within bounds, because a constant has no curvature, and of a solution to round-off nothing else is
/// left.
fn step_length(along: f64, curvature: f64) -> f64 {
    if along > 0.0 && curvature > 0.0 { (along / curvature).min(LONGEST_SHARE) } else { 0.0 }
}

simd! {
    /// x -= share y.
    fn subtract_row[](x: &mut [Fast], y: &[Fast], share: Fast) {
        let y = &y[..x.len()];
        for (x, y) in x.iter_mut().zip(y) {
            *x -= share * *y;
        }
    }
}

simd! {
    /// x = own x + share y.
    fn combine_row[](x: &mut [Fast], y: &[Fast], own: Fast, share: Fast) {
        let y = &y[..x.len()];
        for (x, y) in x.iter_mut().zip(y) {
            *x = own * *x + share * *y;
        }
    }
}

simd! {
    fn first_row[](step: &mut [Fast], solution: &mut [Fast], right: &[Fast], inverse_diagonal: &[Fast], scale: Fast) {
        let n = step.len();
        let (solution, right, inverse) = (&mut solution[..n], &right[..n], &inverse_diagonal[..n]);
        for i in 0..n {
            let change = scale * inverse[i] * right[i];
            step[i] = change;
            solution[i] = change;
        }
    }
}

/// The fine rows that make the coarse row `row`, and how many there are. With `face`, only those
/// whose lower faces along that axis lie on the coarse cells' lower faces.
fn fine_rows<const D: usize>(
    fine: &Level<D>,
    coarse: &Layout<D>,
    row: Row<D>,
    face: Option<usize>,
) -> ([Row<D>; 4], usize) {
    let layout = fine.rows.layout();
    let mut rest = coarse.number(row);
    let mut rows = [layout.row(0); 4];
    let mut count = 1;
    for axis in 1..D {
        let index = (rest % coarse.cells[axis] * fine.coarsening[axis]) as isize;
        rest /= coarse.cells[axis];
        rows = rows.map(|row| row.near(axis, index));
        if fine.coarsening[axis] == 2 && face != Some(axis) {
            for i in 0..count {
                rows[count + i] = rows[i].near(axis, 1);
            }
            count *= 2;
        }
    }
    (rows, count)
}

/// Means of the fine residual (in `other`), into the coarse right-hand side.
fn restrict<const D: usize>(fine: &Level<D>, right: &mut Field<Fast, D>) {
    let layout = right.layout;
    let coarse = Rows::new(layout, false);
    coarse.each([right], |o, [right]| {
        let (fine_rows, count) = fine_rows(fine, &layout, o, None);
        let residuals = fine_rows.map(|row| fine.other.row(row));
        let scale = 1.0 / (count * fine.coarsening[0]) as Fast;
        sum_row(right, &residuals[..count], Along::of(fine.coarsening[0]), scale);
    });
}

/// Adds the coarse solution to the fine one, constant per coarse cell.
fn prolong<const D: usize>(coarse: &Level<D>, fine: &mut Level<D>) {
    let Level { rows, solution, coarsening, .. } = fine;
    let layout = rows.layout();
    let coarse_layout = coarse.rows.layout();
    rows.each([solution], |o, [solution]| {
        let mut rest = layout.number(o);
        let mut from = coarse_layout.row(0);
        for axis in 1..D {
            let index = rest % layout.cells[axis];
            rest /= layout.cells[axis];
            from = from.near(axis, (index / coarsening[axis]) as isize);
        }
        spread_row(solution, coarse.solution.row(from), coarsening[0]);
    });
}

/// What of a fine row makes a coarse one.
#[derive(Clone, Copy)]
enum Along {
    /// Each element.
    Each,
    /// Each pair of elements.
    Pairs,
    /// The first of each pair.
    Firsts,
}

impl Along {
    /// All that `coarsening` fine cells have.
    fn of(coarsening: usize) -> Self {
        if coarsening == 2 { Self::Pairs } else { Self::Each }
    }
}

simd! {
    /// `scale` times the sum of fine rows.
    fn sum_row[](coarse: &mut [Fast], fine: &[&[Fast]], along: Along, scale: Fast) {
        // Of the first row, and of the others on top.
        macro_rules! add {
            (|$fine:ident, $n:literal| $value:expr) => {
                for (row, fine) in fine.iter().enumerate() {
                    let sums = coarse.iter_mut().zip(fine.chunks_exact($n));
                    if row == 0 {
                        sums.for_each(|(sum, $fine)| *sum = $value);
                    } else {
                        sums.for_each(|(sum, $fine)| *sum += $value);
                    }
                }
            };
        }
        match along {
            Along::Each => add!(|fine, 1| fine[0]),
            Along::Pairs => add!(|pair, 2| pair[0] + pair[1]),
            Along::Firsts => add!(|pair, 2| pair[0]),
        }
        coarse.iter_mut().for_each(|coarse| *coarse *= scale);
    }
}

simd! {
    /// Adds to each of `coarsening` fine cells what the coarse one has.
    fn spread_row[](fine: &mut [Fast], coarse: &[Fast], coarsening: usize) {
        if coarsening == 2 {
            for (pair, coarse) in fine.chunks_exact_mut(2).zip(coarse) {
                pair[0] += coarse;
                pair[1] += coarse;
            }
        } else {
            for (fine, coarse) in fine.iter_mut().zip(coarse) {
                *fine += coarse;
            }
        }
    }
}

/// Coarse face coefficients: the mean of the coincident fine faces, over the square of the wider
/// spacing.
fn coarsen_weights<const D: usize>(fine: &Level<D>, coarse: &mut Level<D>) {
    let layout = coarse.rows.layout();
    for axis in 0..D {
        let source = &fine.weights[axis];
        // Weights carry 1/h².
        let wider = if fine.coarsening[axis] == 2 { 0.25 } else { 1.0 };
        coarse.rows.each([&mut coarse.weights[axis]], |o, [weights]| {
            let (fine_rows, count) = fine_rows(fine, &layout, o, Some(axis));
            let rows = fine_rows.map(|row| source.row(row));
            let along = match (fine.coarsening[0], axis) {
                (2, 0) => Along::Firsts,
                (coarsening, _) => Along::of(coarsening),
            };
            let along_row = if matches!(along, Along::Pairs) { 2 } else { 1 };
            sum_row(weights, &rows[..count], along, wider / (count * along_row) as Fast);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs of low and high coefficient, as clusters make: the exponent of the contrast from a wave
    /// and noise between 0 and 1.
    fn blobs(wave: f64, noise: f64) -> f64 {
        0.5 * (wave + 0.3 * noise).clamp(-1.0, 1.0)
    }

    /// Each face for itself.
    fn jumps(_: f64, noise: f64) -> f64 {
        noise - 0.5
    }

    fn solve_random<R: Real, const D: usize>(
        cells: [usize; D],
        contrast: f64,
        exponent: fn(f64, f64) -> f64,
    ) -> (usize, f64) {
        let grid = Grid::new(cells.map(|n| n as f64), cells);
        let layout = Layout::from(&grid);
        let mut state = 7u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut k: Faces<R, D> = Field::zero_faces(layout);
        for axis in 0..D {
            k[axis].set(|index| {
                let wave: f64 = (0..D)
                    .map(|a| {
                        (std::f64::consts::TAU * 3.0 * index[a] as f64 / cells[a] as f64).sin()
                    })
                    .product();
                R::of(contrast.powf(exponent(wave, random())))
            });
        }
        let mut b = Field::<R, D>::zeros(layout);
        b.set(|_| R::of(random() - 0.5));
        let mean = b.mean();
        let copy = b.clone();
        let mut values = copy.interior().flatten().copied();
        b.set(|_| values.next().unwrap() - R::of(mean));
        let mut poisson = Poisson::<R, D>::new(&grid, false);
        poisson.set_coefficient(&k);
        let mut x = Field::zeros(layout);
        let solve = poisson.solve(&mut x, &b, 1e-5, 100);
        // The residual is what it says, computed afresh.
        let rows = Rows::new(layout, false);
        let mut image = Field::<R, D>::zeros(layout);
        rows.each([&mut image], |o, [image]| {
            image_row(image, Stencil::at(&poisson.levels[0].weights, &x, o));
        });
        let worst = image
            .interior()
            .flatten()
            .zip(b.interior().flatten())
            .fold(0.0f64, |m, (a, b)| m.max((a.f64() - b.f64()).abs()));
        let round_off = if R::of(1e-10) + R::ONE == R::ONE { 2e-3 } else { 1e-10 };
        assert!((worst - solve.residual).abs() < round_off, "{worst} {}", solve.residual);
        (solve.iterations, worst)
    }

    #[test]
    fn converges_at_the_contrast_of_clusters_on_every_shape_of_box() {
        for contrast in [1.0, 100.0, 700.0] {
            for cells in [[128, 128], [64, 256], [100, 36], [50, 34], [8, 8]] {
                let (iterations, worst) = solve_random::<f64, 2>(cells, contrast, blobs);
                println!("{cells:?} contrast {contrast}: {iterations}");
                assert!(worst <= 1e-5, "{cells:?} {contrast}: {worst}");
                assert!(iterations <= 45, "{cells:?} {contrast}: {iterations}");
            }
            for cells in [[32, 32, 32], [16, 16, 64], [10, 12, 14]] {
                let (iterations, worst) = solve_random::<f64, 3>(cells, contrast, blobs);
                println!("{cells:?} contrast {contrast}: {iterations}");
                assert!(worst <= 1e-5 && iterations <= 45, "{cells:?} {contrast}: {iterations}");
            }
        }
    }

    #[test]
    fn jumps_from_face_to_face_are_eliminated() {
        for cells in [[128, 128], [64, 256], [50, 34], [8, 8]] {
            let (iterations, worst) = solve_random::<f64, 2>(cells, 1e6, jumps);
            println!("{cells:?}: {iterations}");
            assert!(worst <= 1e-5 && iterations <= 45, "{cells:?}: {iterations} {worst}");
        }
        for cells in [[32, 32, 32], [10, 12, 14]] {
            let (iterations, worst) = solve_random::<f64, 3>(cells, 1e6, jumps);
            println!("{cells:?}: {iterations}");
            assert!(worst <= 1e-5 && iterations <= 45, "{cells:?}: {iterations} {worst}");
        }
    }

    #[test]
    fn blobs_of_any_contrast_take_no_longer_on_few_cells() {
        for cells in [[32, 32], [128, 128]] {
            let (iterations, worst) = solve_random::<f64, 2>(cells, 1e6, blobs);
            println!("{cells:?}: {iterations}");
            assert!(worst <= 1e-5 && iterations <= 45, "{cells:?}: {iterations} {worst}");
        }
        let (iterations, worst) = solve_random::<f64, 3>([16; 3], 1e6, blobs);
        assert!(worst <= 1e-5 && iterations <= 45, "{iterations} {worst}");
    }

    #[test]
    fn single_precision_stops_where_it_can_get_no_further() {
        let (iterations, worst) = solve_random::<f32, 2>([128, 128], 100.0, blobs);
        assert!(iterations < 60 && worst < 2e-3, "{iterations} {worst}");
        let (iterations, worst) = solve_random::<f32, 3>([16; 3], 1e6, jumps);
        assert!(iterations < 60 && worst < 2e-3, "{iterations} {worst}");
    }

    #[test]
    fn coarse_faces_are_means_of_the_coincident_fine_faces() {
        let mut fine = Level::<3>::new([4, 4, 8], [1.0; 3], false, true);
        for axis in 0..3 {
            fine.weights[axis].set(|i| (1 + i[0] + 10 * i[1] + 100 * i[2]) as Fast);
        }
        let mut coarse = fine.coarser(false).unwrap();
        coarsen_weights(&fine, &mut coarse);
        let at = |axis: usize, i: [usize; 3]| {
            let layout = coarse.rows.layout();
            coarse.weights[axis].row(layout.row(i[1] + i[2] * layout.cells[1]))[i[0]]
        };
        // Cell (1, 0, 2) covers fine cells 2-3, 0-1, 4-5.
        assert_eq!(at(0, [1, 0, 2]), 0.25 * (1.0 + 2.0 + 5.0 + 450.0));
        assert_eq!(at(1, [1, 0, 2]), 0.25 * (1.0 + 2.5 + 0.0 + 450.0));
        assert_eq!(at(2, [1, 0, 2]), 0.25 * (1.0 + 2.5 + 5.0 + 400.0));
    }
}
