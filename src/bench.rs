//! [`measure`]: what a step costs on this machine.

use crate::case::{Case, CaseError, DEFAULT, Precision};
use crate::grid::Grid;
use crate::real::Real;
use crate::rows::{Simd, simd_level};
use crate::simulate::{SimulateError, simulate};
use std::fmt;
use std::time::Instant;

/// What one step costs.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Measurement {
    /// Precision of the simulator.
    pub precision: Precision,
    /// Cells along each axis.
    pub cells: Vec<usize>,
    /// Time steps timed.
    pub steps: u64,
    /// Core time per cell and step, statistics included, median of the rounds \[µs\].
    pub per_cell_step: f64,
    /// The fastest and the slowest round \[µs\].
    pub range: [f64; 2],
    /// Pressure iterations and gas sub-steps per step.
    pub per_step: [f64; 2],
}

/// Measurements of the default case's box on one core.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Report {
    /// Instruction set of the kernels.
    pub simd: &'static str,
    /// One for each precision.
    pub measurements: Vec<Measurement>,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "one core, {}, default case, statistics included:", self.simd)?;
        for m in &self.measurements {
            let precision = match m.precision {
                Precision::Single => "f32",
                Precision::Double => "f64",
            };
            let cells: Vec<String> = m.cells.iter().map(ToString::to_string).collect();
            writeln!(
                f,
                "  {precision} {}: {:.4} µs per cell and step ({:.4} to {:.4}); {} steps, {:.1} \
                 pressure iterations and {:.1} gas sub-steps each",
                cells.join(" x "),
                m.per_cell_step,
                m.range[0],
                m.range[1],
                m.steps,
                m.per_step[0],
                m.per_step[1],
            )?;
        }
        Ok(())
    }
}

/// Why nothing could be measured.
#[derive(Debug, thiserror::Error)]
pub enum BenchError {
    /// The embedded case is broken.
    #[error(transparent)]
    Case(#[from] CaseError),
    /// The simulation failed.
    #[error(transparent)]
    Simulate(#[from] SimulateError),
}

/// Times the default case's box at mean fraction 0.15 in f64 and f32, on one core, from the
/// clustered state on; `quick` for a shorter time.
///
/// # Errors
/// The simulation fails.
pub fn measure(quick: bool) -> Result<Report, BenchError> {
    let mut case = Case::parse(DEFAULT, "bench")?;
    let (warm, round, rounds) = if quick { (40.0, 4.0, 5) } else { (60.0, 20.0, 9) };
    let unit = 2.0 * case.run.sample_interval;
    case.run.duration = (warm + round * f64::from(rounds)) * unit;
    let measurements = vec![
        one::<f64>(&case, Precision::Double, warm * unit, round * unit)?,
        one::<f32>(&case, Precision::Single, warm * unit, round * unit)?,
    ];
    let simd = match simd_level() {
        Simd::Baseline => "baseline SIMD",
        Simd::Avx2 => "AVX2",
        Simd::Avx512 => "AVX-512",
    };
    Ok(Report { simd, measurements })
}

fn one<R: Real>(
    case: &Case,
    precision: Precision,
    warm: f64,
    round: f64,
) -> Result<Measurement, BenchError> {
    let grid = Grid::new(
        [case.domain.size[0], case.domain.size[1]],
        [case.domain.cells[0], case.domain.cells[1]],
    );
    // The clock at the end of the warm-up and of each round.
    let mut marks: Vec<(Instant, u64)> = Vec::new();
    let mut next = warm;
    let simulated = simulate::<R, 2>(case, 0.15, false, &|| false, |signals, steps| {
        if signals.time.last().is_some_and(|&time| time >= next - 1e-9) {
            marks.push((Instant::now(), steps));
            next += round;
        }
    })?;
    let mut times: Vec<f64> = marks
        .windows(2)
        .map(|pair| {
            let seconds = (pair[1].0 - pair[0].0).as_secs_f64();
            1e6 * seconds / ((pair[1].1 - pair[0].1) as f64 * grid.len() as f64)
        })
        .collect();
    times.sort_by(f64::total_cmp);
    let cost = simulated.cost;
    let steps = cost.steps as f64;
    Ok(Measurement {
        precision,
        cells: grid.cells.to_vec(),
        steps: marks[marks.len() - 1].1 - marks[0].1,
        per_cell_step: times[times.len() / 2],
        range: [times[0], times[times.len() - 1]],
        per_step: [cost.pressure_iterations as f64 / steps, cost.gas_steps as f64 / steps],
    })
}
