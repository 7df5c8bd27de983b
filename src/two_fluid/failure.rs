//! Why a step failed, and where: the cell to look at and what to change.

use super::{Limit, StepReport, TwoFluid};
use crate::field::{Faces, Field, Layout, Row};
use crate::grid::Grid;
use crate::real::Real;
use crate::rows::simd;
use std::fmt;

/// A cell of the box.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Its index along each axis, from 0.
    pub cell: Vec<usize>,
    /// Its centre \[m\].
    pub position: Vec<f64>,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cell: Vec<String> = self.cell.iter().map(ToString::to_string).collect();
        let position: Vec<String> = self.position.iter().map(|x| format!("{x:.4e}")).collect();
        write!(f, "cell ({}) at ({}) m", cell.join(", "), position.join(", "))
    }
}

/// A step that failed; the state is of no use any more.
#[derive(Clone, Debug, thiserror::Error)]
pub enum StepError {
    /// The pressure iteration did not converge.
    #[error(
        "the gas pressure did not converge at t = {time:.6} s: after {iterations} iterations \
         {residual:.1e} of the volume of {place} is unaccounted for (dt = {dt:.2e} s, limited by \
         {limit}); double precision (run.precision), cells of more equal edges or another run.seed \
         may do"
    )]
    Pressure {
        /// Simulated time \[s\].
        time: f64,
        /// Iterations done.
        iterations: usize,
        /// Remaining divergence times dt.
        residual: f64,
        /// Time step \[s\].
        dt: f64,
        /// What limited the step.
        limit: Limit,
        /// Where most is left.
        place: Place,
    },
    /// A field is no longer finite.
    #[error(
        "the {field} is not finite in {place} at t = {time:.6} s (dt = {dt:.2e} s, limited by \
         {limit}); double precision (run.precision), a smaller run.perturbation or finer cells may \
         do"
    )]
    NotFinite {
        /// Simulated time \[s\].
        time: f64,
        /// Time step \[s\].
        dt: f64,
        /// What limited the step.
        limit: Limit,
        /// The field, of those that are not finite the one in the fewest cells.
        field: &'static str,
        /// Where.
        place: Place,
    },
    /// The time step became too short to get anywhere.
    #[error(
        "the time step fell to {dt:.2e} s at t = {time:.6} s, limited by {limit}: {value:.3e} \
         {unit} in {place}; {}",
        remedy(*limit)
    )]
    Collapsed {
        /// Simulated time \[s\].
        time: f64,
        /// Time step \[s\].
        dt: f64,
        /// What limited the step.
        limit: Limit,
        /// Speed there \[m/s\], or granular temperature \[m²/s²\] where sound or diffusion
        /// limits.
        value: f64,
        /// Unit of the value.
        unit: &'static str,
        /// Where it is largest.
        place: Place,
    },
}

/// What to change where `limit` stops a run.
fn remedy(limit: Limit) -> &'static str {
    match limit {
        Limit::Gas => "a wider or taller box keeps gas from jetting through channels",
        Limit::Sound | Limit::Diffusion | Limit::Packing => {
            "double precision (run.precision), coarser cells or a smaller run.perturbation may do"
        }
        Limit::Growth | Limit::Solids | Limit::Longest | Limit::Exchange => {
            "coarser cells or a smaller run.perturbation may do"
        }
    }
}

/// The cell in which `value`, of a row and a place in it, is largest, and that value; a value that is
/// not a number is larger than any.
fn largest<const D: usize>(
    grid: &Grid<D>,
    layout: &Layout<D>,
    value: impl Fn(Row<D>, usize) -> f64,
) -> (f64, Place) {
    let mut best = (f64::NEG_INFINITY, 0, 0);
    for row in 0..layout.rows() {
        for i in 0..grid.cells[0] {
            let found = value(layout.row(row), i);
            if found > best.0 || found.is_nan() && !best.0.is_nan() {
                best = (found, row, i);
            }
        }
    }
    let (found, mut row, i) = best;
    let mut cell = vec![i];
    for cells in &grid.cells[1..] {
        cell.push(row % cells);
        row /= cells;
    }
    let position = cell.iter().zip(grid.spacing).map(|(&i, h)| (i as f64 + 0.5) * h).collect();
    (found, Place { cell, position })
}

simd! {
    /// Zero, or not a number if one of the row is not finite: largest values, in which comparisons
    /// pass over what is not a number, do not tell.
    fn spoilt_row[R: Real](row: &[R]) -> R {
        const LANES: usize = 16;
        let mut sums = [R::ZERO; LANES];
        let mut chunks = row.chunks_exact(LANES);
        for chunk in &mut chunks {
            for lane in 0..LANES {
                sums[lane] += R::ZERO * chunk[lane];
            }
        }
        let rest = chunks.remainder().iter().fold(R::ZERO, |sum, &q| sum + R::ZERO * q);
        sums.into_iter().fold(rest, |a, b| a + b)
    }
}

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// Whether the divergence of the total flux is finite in every cell. Every field has passed
    /// into it, so that none is spoilt unnoticed.
    pub(super) fn is_finite(&self) -> bool {
        let spoilt = self.rows.fold(&|o| spoilt_row(self.right.row(o)), &|a, b| a + b);
        spoilt.f64() == 0.0
    }

    /// Why a step of that `report` failed: a field is not finite.
    pub(super) fn not_finite(&self, report: &StepReport) -> StepError {
        let fields = [
            ("solids fraction", &self.phi),
            ("granular temperature", &self.theta),
            ("solids velocity", &self.solids[D - 1]),
            ("gas velocity", &self.gas[D - 1]),
            ("gas pressure", &self.pressure),
        ];
        let broken = |field: &Field<R, D>| {
            field.interior().flatten().filter(|q| !q.f64().is_finite()).count()
        };
        // What started it has spread least.
        let (name, field) = fields
            .into_iter()
            .filter(|(_, field)| broken(field) > 0)
            .min_by_key(|(_, field)| broken(field))
            .unwrap_or(fields[4]);
        let is_broken = |row, i: usize| f64::from(u8::from(!field.row(row)[i].f64().is_finite()));
        let (_, place) = largest(&self.grid, &self.phi.layout, is_broken);
        let StepReport { dt, limit, .. } = *report;
        StepError::NotFinite { time: self.time, dt, limit, field: name, place }
    }

    /// Why a step of that `report` failed: the pressure left too much volume unaccounted for.
    pub(super) fn not_converged(&self, report: &StepReport) -> StepError {
        let flux = |a: usize, row: Row<D>, i: usize| {
            let (below, here) = (self.phi.row(row.near(a, -1))[i], self.phi.row(row)[i]);
            let face = 0.5 * (below.f64() + here.f64());
            face * self.solids[a].row(row)[i].f64() + (1.0 - face) * self.gas[a].row(row)[i].f64()
        };
        let (_, place) = largest(&self.grid, &self.phi.layout, |row, i| {
            let change = |a: usize| flux(a, row.near(a, 1), i) - flux(a, row, i);
            (0..D).map(|a| change(a) / self.grid.spacing[a]).sum::<f64>().abs()
        });
        let StepReport { dt, limit, iterations, volume_residual: residual, .. } = *report;
        StepError::Pressure { time: self.time, iterations, residual, dt, limit, place }
    }

    /// Why there is no next step: it would be as short as [`TwoFluid::next_dt`] has it.
    pub(super) fn collapsed(&self) -> StepError {
        let (dt, limit) = self.next_dt;
        let speed = |velocity: &Faces<R, D>, row: Row<D>, i: usize| {
            let of = |a: usize, n| velocity[a].row(row.near(a, n))[i].f64().abs();
            (0..D).map(|a| of(a, 0).max(of(a, 1))).fold(0.0, f64::max)
        };
        let largest =
            |value: &dyn Fn(Row<D>, usize) -> f64| largest(&self.grid, &self.phi.layout, value);
        let ((value, place), unit) = match limit {
            Limit::Gas => (largest(&|row, i| speed(&self.gas, row, i)), "m/s of the gas"),
            Limit::Sound | Limit::Diffusion => {
                (largest(&|row, i| self.theta.row(row)[i].f64()), "m²/s² of granular temperature")
            }
            Limit::Packing => (largest(&|row, i| self.phi.row(row)[i].f64()), "of solids fraction"),
            Limit::Growth | Limit::Solids | Limit::Longest | Limit::Exchange => {
                (largest(&|row, i| speed(&self.solids, row, i)), "m/s of the solids")
            }
        };
        StepError::Collapsed { time: self.time, dt, limit, value, unit, place }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::setup;
    use super::*;

    fn flow() -> TwoFluid<f64, 3> {
        let mut flow = TwoFluid::new(Grid::new([8e-3, 12e-3, 10e-3], [8, 12, 10]), setup(0.2, 0.1));
        flow.step(f64::INFINITY).unwrap();
        flow
    }

    #[test]
    fn a_poisoned_field_is_named_with_its_cell() {
        let mut flow = flow();
        let row = flow.phi.layout.row(3 + 12 * 4);
        flow.solids[0].row_mut(row)[5] = f64::NAN;
        let error = flow.step(f64::INFINITY).unwrap_err();
        let StepError::NotFinite { place, .. } = &error else { panic!("{error}") };
        // Only the pressure carries it further than to the neighbours.
        let near = place.cell.iter().zip([5, 3, 4]).all(|(&found, cell)| found.abs_diff(cell) <= 3);
        assert!(near, "{error}");
        assert!(error.to_string().contains("run.precision"), "{error}");
    }

    #[test]
    fn the_cell_that_swells_is_found() {
        let mut flow = flow();
        let row = flow.phi.layout.row(7 + 12 * 2);
        flow.gas[1].row_mut(row)[6] += 1.0;
        flow.solids[1].row_mut(row)[6] += 1.0;
        let report = StepReport {
            dt: 1e-4,
            limit: Limit::Gas,
            gas_steps: 1,
            iterations: 60,
            volume_residual: 0.1,
        };
        let StepError::Pressure { place, .. } = flow.not_converged(&report) else { panic!() };
        // Of the two cells of the face the lower loses what the upper gains.
        assert!(place.cell == [6, 7, 2] || place.cell == [6, 6, 2], "{place}");
        let middle = place.position.iter().zip(&place.cell).map(|(x, &i)| x / (i as f64 + 0.5));
        assert!(middle.into_iter().all(|h| (h / 1e-3 - 1.0).abs() < 1e-12));
    }

    #[test]
    fn a_collapsed_step_names_the_jet() {
        let mut flow = flow();
        let row = flow.phi.layout.row(1 + 12 * 8);
        flow.gas[2].row_mut(row)[2] = -1e3;
        flow.next_dt = (1e-12, Limit::Gas);
        let error = flow.collapsed();
        let StepError::Collapsed { value, place, .. } = &error else { panic!("{error}") };
        assert_eq!((*value, &place.cell[..2]), (1e3, &[2, 1][..]));
        assert!(place.cell[2] == 8 || place.cell[2] == 7, "{place}");
        assert!(error.to_string().contains("m/s of the gas in cell (2, 1, "), "{error}");
        // And a step says so by itself.
        let mut flow = self::flow();
        flow.next_dt = (1e-12, Limit::Gas);
        let stopped = flow.step(f64::INFINITY);
        assert!(matches!(stopped, Err(StepError::Collapsed { .. })), "{stopped:?}");
    }
}
