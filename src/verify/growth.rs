//! The early growth of a wave in the simulator, against linear theory.

use super::{Checked, Effort, Expected, Row, setup};
use crate::case::{Case, DEFAULT};
use crate::grid::Grid;
use crate::stability::{Mode, StabilityError, Uniform};
use crate::two_fluid::{Setup, StepError, TwoFluid};
use std::f64::consts::TAU;

/// Cells per wavelength.
const CELLS: usize = 32;

/// When amplitudes are taken, in e-folding times: the other modes of the wave have decayed by the
/// first, and the wave is still small at the last.
const TAKEN: [f64; 2] = [1.2, 2.0];

/// Vertical waves shorter, as long and longer than the fastest, at three fractions.
pub(super) fn check(effort: Effort) -> Checked {
    let case = Case::parse(DEFAULT, "default")?;
    let (fractions, lengths): (&[f64], &[f64]) = match effort {
        Effort::Quick => (&[0.15], &[1.0]),
        Effort::Full => (&[0.05, 0.15, 0.25], &[0.75, 1.0, 2.0]),
    };
    let mut rows = Vec::new();
    for &phi in fractions {
        let theory = Uniform::new(&case, phi);
        let fastest = fastest(&theory)?;
        for &length in lengths {
            let mode = theory.mode(length * fastest.wavelength, 0.0)?;
            let spacing = mode.wavelength / CELLS as f64;
            let on_grid = theory.mode_on(mode.wavelength, 0.0, [spacing; 2])?;
            let (found, steps) = simulated(phi, mode)?;
            let detail = format!(
                "linear theory; on these cells with time continuous {:.2}; steps of {:.1e} s",
                on_grid.growth_rate,
                (TAKEN[1] / mode.growth_rate) / steps as f64
            );
            rows.push(
                Row::new(
                    format!("growth at φ = {phi}, {:.2} mm [1/s]", 1e3 * mode.wavelength),
                    Expected::Near { value: mode.growth_rate, within: 0.02 },
                    found,
                )
                .with(detail),
            );
        }
    }
    Ok(rows)
}

/// The fastest vertical wave.
fn fastest(theory: &Uniform) -> Result<Mode, StabilityError> {
    let mut best = theory.mode(3e-4, 0.0)?;
    for n in 1..350 {
        let mode = theory.mode(3e-4 * 1.01_f64.powi(n), 0.0)?;
        if mode.growth_rate > best.growth_rate {
            best = mode;
        }
    }
    Ok(best)
}

/// Growth rate in the simulator at its own time steps, and how many it took.
fn simulated(phi: f64, mode: Mode) -> Result<(f64, u64), StepError> {
    let h = mode.wavelength / CELLS as f64;
    let cells = [4, CELLS];
    let k = TAU / CELLS as f64;
    let mut flow = TwoFluid::<f64, 2>::perturbed(
        Grid::new(cells.map(|n| h * n as f64), cells),
        Setup { perturbation: 1e-4, ..setup(phi) },
        |cell| (k * (cell[1] as f64 + 0.5)).cos(),
    )
    .with_tolerance(1e-11);
    let mut logarithms = [0.0; 2];
    for (taken, logarithm) in TAKEN.into_iter().zip(&mut logarithms) {
        let time = taken / mode.growth_rate;
        while flow.time() < time {
            flow.step(time)?;
        }
        let mut sum = [0.0; 2];
        for (j, row) in flow.solids_fraction().interior().enumerate() {
            let (sine, cosine) = (k * (j as f64 + 0.5)).sin_cos();
            sum[0] += cosine * row[0];
            sum[1] += sine * row[0];
        }
        *logarithm = sum[0].hypot(sum[1]).ln();
    }
    let time = (TAKEN[1] - TAKEN[0]) / mode.growth_rate;
    Ok(((logarithms[1] - logarithms[0]) / time, flow.steps()))
}
