//! What the equations keep: mass, momentum, and the sameness of a flow that is shifted, mirrored,
//! transposed or seen from a moving frame.

use super::manufactured::{Error, quantities};
use super::{Checked, Effort, Expected, Row, setup};
use crate::grid::Grid;
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};
use std::f64::consts::TAU;

/// What is done to a flow.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// Shifted along every axis, by cells.
    Shift(usize),
    /// Mirrored along an axis.
    Mirror(usize),
    /// Two axes exchanged.
    Swap(usize, usize),
}

impl Change {
    /// The quantity, cell and sign that come to lie where `quantity` of `index` is.
    fn source<const D: usize>(
        self,
        quantity: Quantity,
        mut index: [usize; D],
        cells: [usize; D],
    ) -> (Quantity, [usize; D], f64) {
        use Quantity::{GasVelocity, SolidsVelocity};
        match self {
            Self::Shift(by) => {
                (quantity, std::array::from_fn(|a| (index[a] + cells[a] - by) % cells[a]), 1.0)
            }
            Self::Mirror(axis) => {
                let n = cells[axis];
                let normal = matches!(quantity, SolidsVelocity(a) | GasVelocity(a) if a == axis);
                index[axis] = if normal { (n - index[axis]) % n } else { n - 1 - index[axis] };
                (quantity, index, if normal { -1.0 } else { 1.0 })
            }
            Self::Swap(a, b) => {
                let other = |axis| {
                    if axis == a {
                        b
                    } else if axis == b {
                        a
                    } else {
                        axis
                    }
                };
                index.swap(a, b);
                let quantity = match quantity {
                    SolidsVelocity(axis) => SolidsVelocity(other(axis)),
                    GasVelocity(axis) => GasVelocity(other(axis)),
                    scalar => scalar,
                };
                (quantity, index, 1.0)
            }
        }
    }
}

/// The values of a field, along the first axis first.
pub(super) fn values<const D: usize>(flow: &TwoFluid<f64, D>, quantity: Quantity) -> Vec<f64> {
    flow.field(quantity).interior().flatten().copied().collect()
}

/// A flow of `setup` with the fields of another, changed.
fn changed<const D: usize>(
    from: &TwoFluid<f64, D>,
    setup: Setup,
    change: Change,
) -> TwoFluid<f64, D> {
    let cells = from.grid().cells;
    let mut flow = TwoFluid::new(from.grid(), setup).with_tolerance(TOLERANCE);
    for quantity in quantities::<D>() {
        flow.set_field(quantity, |index| {
            let (quantity, index, sign) = change.source(quantity, index, cells);
            sign * values_at(from, quantity, index)
        });
    }
    flow
}

/// One value of a field.
fn values_at<const D: usize>(
    flow: &TwoFluid<f64, D>,
    quantity: Quantity,
    index: [usize; D],
) -> f64 {
    let row = (1..D).rev().fold(0, |sum, a| sum * flow.grid().cells[a] + index[a]);
    let field = flow.field(quantity);
    field.row(field.layout.row(row))[index[0]]
}

/// Divergence that the pressure may leave, so that where its iteration ends does not show.
const TOLERANCE: f64 = 1e-12;

/// Steps over which flows are compared.
const STEPS: usize = 40;

/// Largest difference between a changed flow and the change of the flow, over the largest value of
/// the same field; the worst field but the pressure, whose mean is free.
fn difference<const D: usize>(
    cells: [usize; D],
    gravity: f64,
    change: Change,
) -> Result<f64, StepError> {
    let noisy = Setup { perturbation: 0.5, seed: 5, ..setup(0.15) };
    let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
    let mut flow = TwoFluid::<f64, D>::new(grid, noisy);
    for _ in 0..100 {
        flow.step(f64::INFINITY)?;
    }
    let dt = flow.next_step().0;
    let setup = Setup { gravity, ..noisy };
    let mut plain = changed(&flow, setup, Change::Shift(0));
    let mut other = changed(&flow, setup, change);
    for _ in 0..STEPS {
        plain.step_by(dt)?;
        other.step_by(dt)?;
    }
    let mut worst: f64 = 0.0;
    for quantity in quantities::<D>().filter(|&q| q != Quantity::Pressure) {
        let other = values(&other, quantity);
        let scale = other.iter().fold(0.0f64, |m, q| m.max(q.abs()));
        let mut index = [0; D];
        for found in &other {
            let (quantity, at, sign) = change.source(quantity, index, cells);
            let expected = sign * values_at(&plain, quantity, at);
            worst = worst.max((found - expected).abs() / scale);
            for a in 0..D {
                index[a] += 1;
                if index[a] < cells[a] {
                    break;
                }
                index[a] = 0;
            }
        }
    }
    Ok(worst)
}

/// Differences of changed flows.
pub(super) fn check(effort: Effort) -> Checked {
    const WEIGHTLESS: f64 = 1e-12;
    let mut rows = Vec::new();
    let mut row = |name: &str, found: f64| {
        rows.push(
            Row::new(format!("{name}: difference"), Expected::AtMost(1e-9), found).with(format!(
                "symmetry; {STEPS} steps of a bed that noise has left, the pressure to {TOLERANCE:e}"
            )),
        );
    };
    let flat = [32; 2];
    row("2-D shifted by 5 cells", difference(flat, 9.81, Change::Shift(5))?);
    row("2-D shifted by half the box", difference(flat, 9.81, Change::Shift(16))?);
    row("2-D mirrored across", difference(flat, 9.81, Change::Mirror(0))?);
    row("2-D mirrored upside down, no weight", difference(flat, WEIGHTLESS, Change::Mirror(1))?);
    row("2-D transposed, no weight", difference(flat, WEIGHTLESS, Change::Swap(0, 1))?);
    if effort == Effort::Full {
        let deep = [12, 12, 16];
        row("3-D shifted by 5 cells", difference(deep, 9.81, Change::Shift(5))?);
        for axis in 0..2 {
            let found = difference(deep, 9.81, Change::Mirror(axis))?;
            row(&format!("3-D mirrored along axis {axis}"), found);
        }
        row("3-D upside down, no weight", difference(deep, WEIGHTLESS, Change::Mirror(2))?);
        row("3-D transposed", difference(deep, 9.81, Change::Swap(0, 1))?);
        let cube = [12; 3];
        row("3-D transposed, no weight", difference(cube, WEIGHTLESS, Change::Swap(1, 2))?);
    }
    Ok(rows)
}

/// Solids mass and momentum of the mixture over many steps from noise.
pub(super) fn conservation(effort: Effort) -> Checked {
    let steps = if effort == Effort::Full { 3000 } else { 300 };
    let mut rows = kept([32; 2], steps)?;
    rows.extend(kept([12, 12, 16], steps)?);
    Ok(rows)
}

fn kept<const D: usize>(cells: [usize; D], steps: usize) -> Result<Vec<Row>, StepError> {
    let setup = Setup { perturbation: 0.5, seed: 3, ..setup(0.15) };
    let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
    let mut flow = TwoFluid::<f64, D>::new(grid, setup);
    let start = flow.means();
    let mut least = f64::INFINITY;
    for _ in 0..steps {
        flow.step(f64::INFINITY)?;
        least = least.min(flow.solids_fraction().min()).min(flow.granular_temperature().min());
    }
    let end = flow.means();
    let scale = setup.powder.density * setup.solids_fraction * flow.uniform_slip();
    let drift = (0..D).map(|a| (end.momentum[a] - start.momentum[a]).abs() / scale);
    let exact = format!("exchanges are one number with two signs; {steps} steps");
    Ok(vec![
        Row::new(
            format!("{D}-D, change of the solids mass"),
            Expected::AtMost(1e-13),
            (end.solids_fraction / start.solids_fraction - 1.0).abs(),
        )
        .with(&exact),
        Row::new(
            format!("{D}-D, change of the momentum, over ρ_s φ slip"),
            Expected::AtMost(1e-11),
            drift.fold(0.0, f64::max),
        )
        .with(&exact),
        Row::new(format!("{D}-D, least φ and T"), Expected::AtLeast(0.0), least)
            .with(format!("neither is negative; {steps} steps")),
    ])
}

/// A wavy bed at rest and one that is carried once through the box, on finer and finer grids.
pub(super) fn moving_frame(effort: Effort) -> Checked {
    let sizes: &[usize] = if effort == Effort::Full { &[16, 32, 64] } else { &[16, 32] };
    let errors = sizes.iter().map(|&n| carried(n)).collect::<Result<Vec<_>, StepError>>()?;
    let [.., coarse, fine] = errors[..] else { unreachable!("two grids at least") };
    let texts: Vec<String> = errors.iter().map(|error| format!("{error:.1e}")).collect();
    let detail =
        format!("first order in time, step as spacing; L2 errors of φ {}", texts.join(", "));
    Ok(vec![
        Row::new(
            "order of the difference between frames",
            Expected::AtLeast(0.9),
            (coarse / fine).log2(),
        )
        .with(detail),
    ])
}

fn carried(cells: usize) -> Result<f64, StepError> {
    const SIZE: f64 = 0.02;
    const TIME: f64 = 0.05;
    let grid = Grid::new([SIZE; 2], [cells; 2]);
    let k = TAU / cells as f64;
    let bed = |boost: f64| -> Result<TwoFluid<f64, 2>, StepError> {
        let mut flow = TwoFluid::<f64, 2>::perturbed(
            grid,
            Setup { perturbation: 0.1, ..setup(0.15) },
            |cell| (k * (cell[0] as f64 + 0.5)).cos() * (k * (cell[1] as f64 + 0.5)).sin(),
        )
        .with_tolerance(1e-9);
        for quantity in quantities::<2>() {
            if matches!(quantity, Quantity::SolidsVelocity(_) | Quantity::GasVelocity(_)) {
                let still = values_at(&flow, quantity, [0; 2]);
                flow.set_field(quantity, |_| still + boost);
            }
        }
        let steps = 16 * cells;
        for _ in 0..steps {
            flow.step_by(TIME / steps as f64)?;
        }
        Ok(flow)
    };
    let (still, carried) = (bed(0.0)?, bed(SIZE / TIME)?);
    let h = grid.spacing;
    Ok(Error::of(&carried, Quantity::SolidsFraction, |x| {
        let index = [0, 1].map(|a| (x[a] / h[a]) as usize);
        values_at(&still, Quantity::SolidsFraction, index)
    })
    .square)
}
