//! [`measure`]: what an error costs. One box, simulated on several grids, with several time steps,
//! precisions, tolerances and physics; for each what a simulated second costs, and what mean slip,
//! variance of φ and drag correction H come to, with their errors.
//!
//! Runs of different cost are compared at equal statistical error: a run of n times the length has
//! 1/n of the variance, so that `cost x (standard error)²` is what an answer costs, whatever the
//! length.

use super::{BenchError, SOLIDS_FRACTION, name};
use crate::blocking::{self, Estimator};
use crate::case::{
    Case, DEFAULT, DragChoice, FrictionChoice, GranularEnergyChoice, Physics, Precision,
    RadialDistributionChoice,
};
use crate::extrapolation::{ASSUMED_ORDER, OnGrid, PRECISE, limit, observed_order};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::real::Real;
use crate::series::Onset;
use crate::simulate::{Signals, sampling, setup};
use crate::statistics::{Sampler, Sums, bin_table};
use crate::two_fluid::{TOLERANCE, TwoFluid};
use serde::Serialize;
use std::fmt;
use std::io::Write;
use std::time::Instant;

use cpu_time::ProcessTime;

/// Names of the quantities.
pub const QUANTITIES: [&str; 5] = ["slip/u_t", "variance of φ", "H(0.05)", "H(0.15)", "H(0.25)"];

/// Filtered solids fractions of the bins of H.
const FRACTIONS: [f64; 3] = [0.05, 0.15, 0.25];

/// Filter width of H \[m\].
const FILTER: f64 = 0.01;

/// What a variant varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    /// The grid.
    Grid,
    /// The length of the time step.
    Step,
    /// The precision.
    Precision,
    /// The tolerance of the pressure.
    Tolerance,
    /// The physics.
    Physics,
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Group::Grid => "grid",
            Group::Step => "time step",
            Group::Precision => "precision",
            Group::Tolerance => "tolerance",
            Group::Physics => "physics",
        })
    }
}

/// One way to simulate the box.
#[derive(Clone, Debug)]
struct Variant {
    group: Group,
    name: String,
    cells: [usize; 2],
    precision: Precision,
    tolerance: f64,
    /// Longest step, as a share of the one that the base variant took on average.
    step: Option<f64>,
    /// Order of a step in time.
    time_order: u64,
    physics: Physics,
    seeds: u64,
}

/// A quantity found.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Found {
    /// Mean.
    pub value: f64,
    /// Its standard error; infinite (null in JSON) if there is too little to tell.
    pub standard_error: f64,
    /// Half its 95 % interval.
    pub half_width_95: f64,
    /// Core seconds for a standard error of one percent.
    pub one_percent: f64,
}

impl Found {
    /// Difference from `other` and its standard errors.
    pub fn difference(&self, other: &Self) -> [f64; 2] {
        let error = self.standard_error.hypot(other.standard_error);
        let difference = self.value - other.value;
        [difference, if difference == 0.0 { 0.0 } else { difference / error }]
    }
}

/// What one variant found and cost.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// What it varies.
    pub group: Group,
    /// Its name.
    pub name: String,
    /// Cells along each axis.
    pub cells: [usize; 2],
    /// Precision of the simulator.
    pub precision: Precision,
    /// Runs, which differ in their seed.
    pub runs: u64,
    /// Simulated time in the steady state, all runs together \[s\].
    pub simulated: f64,
    /// Core seconds per simulated second, without statistics, from when the box was steady.
    pub per_simulated_second: f64,
    /// Time per cell and step \[µs\].
    pub per_cell_step: f64,
    /// Mean length of a step \[s\].
    pub step: f64,
    /// For each of [`QUANTITIES`] what was found.
    pub found: [Found; QUANTITIES.len()],
}

/// The slip on an infinitely fine grid, from the three finest.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Extrapolation {
    /// Order of convergence that was taken.
    pub order: f64,
    /// Whether the three values show it; else it is assumed.
    pub observed: bool,
    /// The slip \[u_t\].
    pub slip: f64,
    /// Its standard error from sampling, the order taken as known.
    pub standard_error: f64,
}

/// The table.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Edges of the box \[m\].
    pub size: [f64; 2],
    /// Simulated time of each run \[u_t/g\].
    pub duration: f64,
    /// The base variant first; those of [`Group::Grid`] from coarse to fine.
    pub points: Vec<Point>,
    /// The slip on an infinitely fine grid.
    pub extrapolation: Option<Extrapolation>,
    /// Seconds that all of it took on the clock.
    pub seconds: f64,
}

/// Simulates the variants, one after the other on one core; `quick` on a small box for a short
/// time, which shows that it works but not what is better. `watch` is given each point as it is
/// found.
///
/// # Errors
/// A simulation fails.
pub fn measure(quick: bool, mut watch: impl FnMut(&Point)) -> Result<Report, BenchError> {
    let begin = Instant::now();
    let mut case = Case::parse(DEFAULT, "bench")?;
    let (size, cells, duration) =
        if quick { ([0.04, 0.04], [32, 32], 60.0) } else { ([0.08, 0.16], [64, 128], 130.0) };
    case.domain.size = size.to_vec();
    case.filter.widths = vec![FILTER];
    case.run.duration = duration * case.scales().time();
    case.run.perturbation = 0.5;
    let mut points = Vec::new();
    for variant in variants(&case.physics, cells, quick) {
        // The base variant is the first.
        let step = points.first().map_or(f64::INFINITY, |base: &Point| base.step);
        let point = match variant.precision {
            Precision::Double => one::<f64>(&case, &variant, step)?,
            Precision::Single => one::<f32>(&case, &variant, step)?,
        };
        watch(&point);
        points.push(point);
    }
    let mut grids: Vec<&Point> = points.iter().filter(|p| p.group == Group::Grid).collect();
    grids.sort_by_key(|point| point.cells[0]);
    let on_grid = |point: &&Point| {
        let Found { value, standard_error, .. } = point.found[0];
        OnGrid { cell: size[0] / point.cells[0] as f64, value, standard_error }
    };
    let extrapolation =
        grids.last_chunk::<3>().and_then(|finest| extrapolate(&finest.each_ref().map(on_grid)));
    Ok(Report { size, duration, points, extrapolation, seconds: begin.elapsed().as_secs_f64() })
}

/// The variants, the base first.
fn variants(physics: &Physics, cells: [usize; 2], quick: bool) -> Vec<Variant> {
    let seeds = if quick { 1 } else { 4 };
    let base = Variant {
        group: Group::Grid,
        name: "base".into(),
        cells,
        precision: Precision::Double,
        tolerance: TOLERANCE,
        step: None,
        time_order: 1,
        physics: physics.clone(),
        seeds,
    };
    let grid =
        |name: &str, cells, seeds| Variant { name: name.into(), cells, seeds, ..base.clone() };
    let mut variants = vec![base.clone()];
    variants.push(grid("cells twice as long", cells.map(|n| n / 2), seeds));
    variants.push(grid("cells half as long", cells.map(|n| n * 2), seeds.div_ceil(2)));
    variants.push(Variant {
        group: Group::Precision,
        name: "single precision".into(),
        precision: Precision::Single,
        ..base.clone()
    });
    for tolerance in [1e-2, 1e-4] {
        let name = format!("pressure to {tolerance:.0e}");
        variants.push(Variant { group: Group::Tolerance, name, tolerance, ..base.clone() });
    }
    for (step, name) in [(0.5, "half the step"), (0.25, "a quarter of the step")] {
        let step = Some(step);
        variants.push(Variant { group: Group::Step, name: name.into(), step, ..base.clone() });
    }
    variants.push(Variant {
        group: Group::Step,
        name: "second order in time".into(),
        time_order: 2,
        ..base.clone()
    });
    let mut vary = |name: &str, change: &dyn Fn(&mut Physics)| {
        let mut variant = Variant { group: Group::Physics, name: name.into(), ..base.clone() };
        change(&mut variant.physics);
        variants.push(variant);
    };
    vary("no friction", &|p| p.friction = FrictionChoice::None);
    vary("friction: Johnson-Jackson", &|p| p.friction = FrictionChoice::JohnsonJackson);
    vary("no gas inertia", &|p| p.terms.gas_inertia = false);
    vary("gas stress", &|p| p.terms.gas_stress = true);
    vary("algebraic granular energy", &|p| {
        p.terms.granular_energy = GranularEnergyChoice::Algebraic;
    });
    vary("contacts: Carnahan-Starling", &|p| {
        p.radial_distribution = RadialDistributionChoice::CarnahanStarling;
    });
    vary("contacts: Ma-Ahmadi", &|p| p.radial_distribution = RadialDistributionChoice::MaAhmadi);
    vary("drag: Gidaspow", &|p| p.drag = DragChoice::Gidaspow);
    vary("drag: Beetstra", &|p| p.drag = DragChoice::Beetstra);
    vary("drag: Tenneti", &|p| p.drag = DragChoice::Tenneti);
    if quick {
        variants.retain(|v| v.group != Group::Physics || v.name == "no friction");
    }
    variants
}

/// What the steps of a run cost from some time on.
#[derive(Clone, Copy, Default)]
struct Spent {
    seconds: f64,
    steps: u64,
}

/// Runs a variant, whose steps may be `step` \[s\] long if it says a share of it.
fn one<R: Real>(case: &Case, variant: &Variant, step: f64) -> Result<Point, BenchError> {
    let mut case = case.clone();
    case.physics = variant.physics.clone();
    let scales = case.scales();
    let longest = variant.step.map_or(f64::INFINITY, |share| share * step);
    let (mut blocks, mut sums) = ([Vec::new(), Vec::new()], Vec::new());
    let (mut spent, mut simulated) = (Spent::default(), 0.0);
    for seed in 0..variant.seeds {
        case.run.seed = 1 + seed;
        let run = simulate::<R>(&case, variant, longest)?;
        let time = &run.signals.time;
        let end = time.last().copied().unwrap_or_default();
        let start = match run.signals.onset() {
            Onset::Steady(start) => start,
            Onset::NotSteady | Onset::TooShort => 0.5 * end,
        };
        let from = run.signals.from(start);
        let slip: Vec<f64> =
            run.signals.slip.iter().map(|slip| slip / scales.terminal_velocity).collect();
        let signals = [&slip, &run.signals.solids_fraction_variance];
        for (blocks, signal) in blocks.iter_mut().zip(signals) {
            let values = signal[from..].iter().map(|&value| [value, 1.0]);
            blocks.push(blocking::Run::in_time(values.collect()));
        }
        let mut own = run.sums;
        own.discard_before(start);
        sums.push(own);
        let before = run.spent[from.min(run.spent.len() - 1)];
        let after = run.spent[run.spent.len() - 1];
        spent.seconds += after.seconds - before.seconds;
        spent.steps += after.steps - before.steps;
        simulated += end - time[from.min(time.len() - 1)];
    }
    let per_simulated_second = spent.seconds / simulated;
    let cells = (variant.cells[0] * variant.cells[1]) as f64;
    let one_percent = |value: f64, error: f64| spent.seconds * (error / (0.01 * value)).powi(2);
    let mut estimator = Estimator::default();
    let mut signal = |runs: &[blocking::Run]| {
        let found = estimator.estimate(runs);
        Found {
            value: found.ratio,
            standard_error: found.standard_error,
            half_width_95: found.half_width_95(),
            one_percent: one_percent(found.ratio, found.standard_error),
        }
    };
    let [slip, variance] = [signal(&blocks[0]), signal(&blocks[1])];
    let rows = bin_table(&sums, &scales)?;
    let correction = |fraction: f64| {
        let row = rows.iter().find(|row| {
            row.quantity == "drag_correction"
                && (row.solids_fraction_low..row.solids_fraction_high).contains(&fraction)
        });
        row.map_or(
            Found {
                value: f64::NAN,
                standard_error: f64::INFINITY,
                half_width_95: f64::INFINITY,
                one_percent: f64::INFINITY,
            },
            |row| Found {
                value: row.value,
                standard_error: row.standard_error,
                half_width_95: 0.5 * (row.high_95 - row.low_95),
                one_percent: one_percent(row.value, row.standard_error),
            },
        )
    };
    let [dilute, middle, dense] = FRACTIONS.map(correction);
    Ok(Point {
        group: variant.group,
        name: variant.name.clone(),
        cells: variant.cells,
        precision: variant.precision,
        runs: variant.seeds,
        simulated,
        per_simulated_second,
        per_cell_step: 1e6 * spent.seconds / (spent.steps as f64 * cells),
        step: simulated / spent.steps as f64,
        found: [slip, variance, dilute, middle, dense],
    })
}

/// One run.
struct Run {
    signals: Signals,
    sums: Sums,
    /// What the steps up to each sample cost.
    spent: Vec<Spent>,
}

fn simulate<R: Real>(case: &Case, variant: &Variant, longest: f64) -> Result<Run, BenchError> {
    let grid = Grid::new([case.domain.size[0], case.domain.size[1]], variant.cells);
    let mut flow = TwoFluid::<R, 2>::new(grid, setup(case, SOLIDS_FRACTION, false))
        .with_tolerance(variant.tolerance);
    if variant.time_order == 2 {
        flow = flow.with_second_order();
    }
    let law = case.physics.drag.law(&case.gas, &case.powder);
    let interval = case.run.sample_interval;
    let mut sampler = Sampler::new(grid, law, sampling(case, false))?;
    let mut fine = FineFields::zeros(grid);
    let (mut signals, mut spent) = (Signals::default(), Vec::new());
    let mut so_far = Spent::default();
    signals.push(0.0, &flow.means());
    spent.push(so_far);
    for sample in 1..=(case.run.duration / interval).round() as u64 {
        let until = sample as f64 * interval;
        let begin = ProcessTime::now();
        while flow.time() < until {
            let next = until.min(flow.time() + longest);
            // The last step before a sample is not to be a sliver.
            let next = if until - next < 1e-9 * interval { until } else { next };
            flow.step(next)?;
            so_far.steps += 1;
        }
        so_far.seconds += begin.elapsed().as_secs_f64();
        signals.push(until, &flow.means());
        spent.push(so_far);
        flow.fields(&mut fine);
        sampler.sample(&fine);
    }
    Ok(Run { signals, sums: sampler.into_sums(), spent })
}

/// The limit of infinitely fine cells of the slip on three grids.
fn extrapolate(grids: &[OnGrid; 3]) -> Option<Extrapolation> {
    let observed = observed_order(&[grids.to_vec()], PRECISE);
    let order = observed.unwrap_or(ASSUMED_ORDER);
    let limit = limit(grids, order)?;
    Some(Extrapolation {
        order,
        observed: observed.is_some(),
        slip: limit.value,
        standard_error: limit.standard_error,
    })
}

impl Report {
    /// The base variant.
    pub fn base(&self) -> &Point {
        &self.points[0]
    }

    /// The finest grid of the base variant: the reference.
    pub fn finest(&self) -> &Point {
        let grids = self.points.iter().filter(|point| point.group == Group::Grid);
        grids.max_by_key(|point| point.cells[0]).unwrap_or(&self.points[0])
    }

    /// Writes one row per variant and quantity.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write_csv(&self, to: impl Write) -> csv::Result<()> {
        let mut table = csv::Writer::from_writer(to);
        table.write_record([
            "varies",
            "variant",
            "cells",
            "cell [m]",
            "precision",
            "runs",
            "simulated [s]",
            "core_seconds_per_simulated_second",
            "per_cell_step [us]",
            "step [s]",
            "quantity",
            "value",
            "standard_error",
            "low_95",
            "high_95",
            "core_seconds_for_one_percent",
            "difference_from_base",
            "difference_from_base [standard errors]",
            "difference_from_finest",
            "difference_from_finest [standard errors]",
        ])?;
        for point in &self.points {
            for (n, quantity) in QUANTITIES.iter().enumerate() {
                let found = point.found[n];
                let from_base = found.difference(&self.base().found[n]);
                let from_finest = found.difference(&self.finest().found[n]);
                table.serialize((
                    (
                        point.group.to_string(),
                        &point.name,
                        format!("{}x{}", point.cells[0], point.cells[1]),
                        self.size[0] / point.cells[0] as f64,
                        name(point.precision),
                        point.runs,
                        point.simulated,
                        point.per_simulated_second,
                        point.per_cell_step,
                        point.step,
                    ),
                    (
                        quantity,
                        found.value,
                        found.standard_error,
                        found.value - found.half_width_95,
                        found.value + found.half_width_95,
                        found.one_percent,
                        from_base[0],
                        from_base[1],
                        from_finest[0],
                        from_finest[1],
                    ),
                ))?;
            }
        }
        table.flush()?;
        Ok(())
    }
}

impl fmt::Display for Point {
    /// One line: cost, then the quantities with their standard errors.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:<28} {:>3}x{:<3} {:>7.2} {:>8.4} {:>8.1e} {:>6.1} ",
            self.name,
            self.cells[0],
            self.cells[1],
            self.per_simulated_second,
            self.per_cell_step,
            self.step,
            self.simulated
        )?;
        for found in self.found {
            write!(f, " {:>8.4} ± {:<6.4}", found.value, found.standard_error)?;
        }
        write!(f, " {:>8.0} {:>8.1}", self.found[0].one_percent, self.found[3].one_percent)
    }
}

/// The heads of a [`Point`]'s columns.
pub const HEADER: &str = "\
variant                      cells   core s/s  µs/cell     step  sim s  slip/u_t          \
variance of φ     H(0.05)           H(0.15)           H(0.25)            1 % slip  1 % H [core s]";

impl fmt::Display for Report {
    /// What leaving out or changing each thing does, and the slip on an infinitely fine grid.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let base = self.base();
        writeln!(
            f,
            "differences from the base, in standard errors (beyond 2: there is one), and cost"
        )?;
        for point in &self.points[1..] {
            write!(
                f,
                "  {:<10} {:<28} cost x {:<5.2}",
                point.group.to_string(),
                point.name,
                point.per_simulated_second / base.per_simulated_second
            )?;
            for (n, quantity) in QUANTITIES.iter().enumerate() {
                let [_, errors] = point.found[n].difference(&base.found[n]);
                write!(f, "  {quantity} {errors:+.1}")?;
            }
            writeln!(f)?;
        }
        let cell = |point: &Point| 1e3 * self.size[0] / point.cells[0] as f64;
        let mut grids: Vec<&Point> =
            self.points.iter().filter(|p| p.group == Group::Grid).collect();
        grids.sort_by_key(|point| point.cells[0]);
        for point in grids {
            let slip = point.found[0];
            writeln!(
                f,
                "slip on cells of {:.4} mm: {:.3} u_t, 95 % within ± {:.3}",
                cell(point),
                slip.value,
                slip.half_width_95
            )?;
        }
        if let Some(limit) = self.extrapolation {
            let slip = base.found[0];
            let error = slip.standard_error.hypot(limit.standard_error);
            writeln!(
                f,
                "slip on infinitely fine cells: {:.3} ± {:.3} u_t ({} order {:.1}): the base grid's \
                 is {:+.3} off by its cells, with a standard error of {error:.3} by sampling",
                limit.slip,
                limit.standard_error,
                if limit.observed { "observed" } else { "assumed" },
                limit.order,
                slip.value - limit.slip,
            )?;
        }
        write!(
            f,
            "box of {} m x {} m, {} u_t/g a run; {:.0} s for all of it",
            self.size[0], self.size[1], self.duration, self.seconds
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(value: f64, standard_error: f64) -> Found {
        Found { value, standard_error, half_width_95: 2.0 * standard_error, one_percent: 1.0 }
    }

    #[test]
    fn differences_count_both_errors() {
        let [difference, errors] = found(1.5, 0.3).difference(&found(1.0, 0.4));
        assert_eq!((difference, errors), (0.5, 1.0));
        assert_eq!(found(1.0, 0.1).difference(&found(1.0, 0.1)), [0.0, 0.0]);
    }

    #[test]
    fn the_quick_table_has_all_its_columns() {
        let mut shown = 0;
        let report = measure(true, |_| shown += 1).unwrap();
        assert_eq!(shown, report.points.len());
        assert_eq!(report.points[0].name, "base");
        assert!(report.finest().cells[0] == 64 && report.extrapolation.is_some());
        let mut bytes = Vec::new();
        report.write_csv(&mut bytes).unwrap();
        let mut table = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(table.records().map(Result::unwrap).count(), 5 * report.points.len());
        // Costs are positive, and half the step takes at least about twice the steps: a bed whose
        // gas breaks through takes more.
        assert!(report.points.iter().all(|p| p.per_simulated_second > 0.0 && p.step > 0.0));
        let half = report.points.iter().find(|p| p.name == "half the step").unwrap();
        let share = half.step / report.base().step;
        assert!(share < 0.6, "{share}");
    }
}
