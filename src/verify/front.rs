//! A sedimentation front: the upper edge of a dense slab that settles in a thinner suspension,
//! against kinematic waves (Kynch 1952).
//!
//! Without inertia the solids fall through the volume flux by (1-φ) V(φ), V the slip of the uniform
//! suspension. Their flux F = φ (1-φ) V has a falling slope, so that the thin suspension
//! above catches up with the dense one below: a shock, at [F]/[φ] down through the volume flux.
//! The slab's lower edge spreads.

use super::{Checked, Effort, Expected, Row, setup};
use crate::grid::Grid;
use crate::laws::scales::{Gas, Powder, homogeneous_slip};
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};

/// Height of the box \[m\], and of the slab in it.
const HEIGHT: f64 = 0.1;
const SLAB: [f64; 2] = [0.02, 0.06];

/// Solids fraction in the slab and outside.
const DENSE: f64 = 0.05;
const THIN: f64 = 0.02;

/// How far the front falls through the volume flux \[m\].
const FALL: f64 = 0.02;

/// Steps in which the front falls by a cell.
const STEPS: usize = 4;

/// Glass beads of 50 µm in water: they stop within 4e-7 m, a thousandth of a cell and less.
fn suspension() -> Setup {
    let mean = THIN + (DENSE - THIN) * (SLAB[1] - SLAB[0]) / HEIGHT;
    Setup {
        powder: Powder { diameter: 50e-6, density: 2500.0, restitution: 0.9, max_packing: 0.65 },
        gas: Gas { density: 1000.0, viscosity: 1e-3 },
        ..setup(mean)
    }
}

/// Speed of the front, and the order of the error of the profile above the slab's middle.
pub(super) fn check(effort: Effort) -> Checked {
    let sizes: &[usize] = if effort == Effort::Full { &[100, 200, 400] } else { &[100, 200] };
    let setup = suspension();
    let slip = |phi| {
        let law = setup.drag.law(&setup.gas, &setup.powder);
        homogeneous_slip(&law, &setup.powder, &setup.gas, setup.gravity, phi)
    };
    let flux = |phi: f64| phi * (1.0 - phi) * slip(phi);
    let speed = (flux(DENSE) - flux(THIN)) / (DENSE - THIN);
    let found = sizes
        .iter()
        .map(|&cells| fall(&setup, &slip, speed, cells))
        .collect::<Result<Vec<_>, StepError>>()?;
    let [.., coarse, fine] = found[..] else { unreachable!("two grids at least") };
    let speeds: Vec<String> = found.iter().map(|f| format!("{:.4e}", f.speed)).collect();
    let errors: Vec<String> = found.iter().map(|f| format!("{:.1e}", f.error)).collect();
    let from = format!("φ = {THIN} over {DENSE}, {sizes:?} cells");
    Ok(vec![
        // The front is found to a fraction of a cell at the start and the end of its fall.
        Row::new(
            "speed of the front through the volume flux [m/s]",
            Expected::Near { value: speed, within: 0.005 },
            fine.speed,
        )
        .with(format!("kinematic shock [F]/[φ], {from}: {}", speeds.join(", "))),
        Row::new(
            "order of the profile's error",
            Expected::AtLeast(0.9),
            (coarse.error / fine.error).log2(),
        )
        .with(format!(
            "a shock is first order in L1; errors over the slab's solids {}",
            errors.join(", ")
        )),
    ])
}

/// A front that has fallen.
#[derive(Clone, Copy, Debug)]
struct Front {
    /// Its speed through the volume flux, over the second half of its fall \[m/s\].
    speed: f64,
    /// ∫|φ - exact| from the slab's middle to far above the front, over (φ₁-φ₂) times the slab's
    /// height.
    error: f64,
}

/// Lets the slab settle.
fn fall(
    setup: &Setup,
    slip: &dyn Fn(f64) -> f64,
    speed: f64,
    cells: usize,
) -> Result<Front, StepError> {
    let h = HEIGHT / cells as f64;
    let grid = Grid::new([4.0 * h, HEIGHT], [4, cells]);
    let start = |j: usize| {
        let y = h * (j as f64 + 0.5);
        if (SLAB[0]..SLAB[1]).contains(&y) { DENSE } else { THIN }
    };
    let mut flow = TwoFluid::<f64, 2>::new(grid, *setup).with_tolerance(1e-9);
    flow.set_field(Quantity::SolidsFraction, |index| start(index[1]));
    // Without volume flux.
    let face = |j: usize| 0.5 * (start((j + cells - 1) % cells) + start(j));
    let [thin, dense] = [THIN, DENSE].map(slip);
    let middle = slip(0.5 * (THIN + DENSE));
    let at = move |phi: f64| {
        if phi == THIN {
            thin
        } else if phi == DENSE {
            dense
        } else {
            middle
        }
    };
    let (solids, gas) = (Quantity::SolidsVelocity(1), Quantity::GasVelocity(1));
    flow.set_field(solids, |index| (face(index[1]) - 1.0) * at(face(index[1])));
    flow.set_field(gas, |index| face(index[1]) * at(face(index[1])));

    let dt = h / (STEPS as f64 * speed);
    let steps = (FALL / h).round() as usize * STEPS;
    // How far the volume flux has carried everything.
    let mut carried = 0.0;
    let mut places = Vec::new();
    for step in 0..=steps {
        if 2 * step == steps || step == steps {
            places.push(place(&column(&flow), h, SLAB[1] - speed * step as f64 * dt) - carried);
        }
        if step == steps {
            break;
        }
        flow.step_by(dt)?;
        carried += dt * volume_flux(&flow);
    }
    let time = 0.5 * steps as f64 * dt;
    let front = SLAB[1] - 2.0 * time * speed + carried;
    let mut error = 0.0;
    for (j, phi) in column(&flow).iter().enumerate() {
        let (low, high) = (h * j as f64, h * (j as f64 + 1.0));
        if low > 0.5 * (SLAB[0] + SLAB[1]) - FALL && high < SLAB[1] + FALL {
            let above = ((high - front) / h).clamp(0.0, 1.0);
            error += h * (phi - (above * THIN + (1.0 - above) * DENSE)).abs();
        }
    }
    Ok(Front {
        speed: (places[0] - places[1]) / time,
        error: error / ((DENSE - THIN) * (SLAB[1] - SLAB[0])),
    })
}

/// φ in the first column, upwards.
fn column(flow: &TwoFluid<f64, 2>) -> Vec<f64> {
    flow.solids_fraction().interior().map(|row| row[0]).collect()
}

/// φ u_s + (1-φ) u_g through the lowest face \[m/s\]: the same through all.
fn volume_flux(flow: &TwoFluid<f64, 2>) -> f64 {
    let column = column(flow);
    let phi = 0.5 * (column[0] + column[column.len() - 1]);
    let first = |quantity| flow.field(quantity).interior().next().map_or(0.0, |row| row[0]);
    phi * first(Quantity::SolidsVelocity(1)) + (1.0 - phi) * first(Quantity::GasVelocity(1))
}

/// Where φ falls, upwards, through the mean of both sides' \[m\], nearest to `near`.
fn place(column: &[f64], h: f64, near: f64) -> f64 {
    let half = 0.5 * (DENSE + THIN);
    let mut best = f64::INFINITY;
    for (j, pair) in column.windows(2).enumerate() {
        if pair[0] >= half && pair[1] < half {
            let y = h * (j as f64 + 0.5 + (pair[0] - half) / (pair[0] - pair[1]));
            if (y - near).abs() < (best - near).abs() {
                best = y;
            }
        }
    }
    best
}
