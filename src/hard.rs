//! [`run`]: cases that break solvers, as a table.
//!
//! Very dilute, dense, fine, coarse, elastic, dissipative, in a liquid, in a thin gas, from a slab
//! over vacuum, from violent noise, on hardly any cells, on flat cells, in 3-D, in single precision.
//! Each is simulated for at least 20 u_t/g, watched in every step, and stopped and gone on with at
//! several points, which must give the same bits.

use crate::case::{DragChoice, FrictionChoice, Precision, RadialDistributionChoice, Terms};
use crate::grid::Grid;
use crate::laws::scales::{Gas, Powder, Scales};
use crate::real::Real;
use crate::two_fluid::{Limit, Setup, StepReport, TwoFluid};
use serde::Serialize;
use std::fmt;

/// How a box starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Start {
    /// Uniform but for noise of this relative amplitude.
    Noise(f64),
    /// A slab of solids fraction 0.6 over vacuum.
    Slab,
}

/// Solids fraction of a slab.
const SLAB: f64 = 0.6;

/// One case.
#[derive(Clone, Debug)]
pub struct HardCase {
    /// What is hard about it.
    pub name: &'static str,
    /// The powder.
    pub powder: Powder,
    /// The gas, or liquid.
    pub gas: Gas,
    /// Gravity \[m/s²\].
    pub gravity: f64,
    /// Fine-grid drag law.
    pub drag: DragChoice,
    /// Frictional pressure.
    pub friction: FrictionChoice,
    /// Mean solids fraction.
    pub solids_fraction: f64,
    /// Cells along each edge, two or three.
    pub cells: Vec<usize>,
    /// Edges of a cell \[m\].
    pub spacing: Vec<f64>,
    /// How it starts.
    pub start: Start,
    /// Seed of the noise.
    pub seed: u64,
    /// Precision of the simulator.
    pub precision: Precision,
}

/// Edge of a cell where a case does not say another: 4 L_II, about that of the founding study, and
/// three particles where those are longer \[m\].
fn usual_cell(powder: &Powder, gas: &Gas, gravity: f64) -> f64 {
    let scales = Scales::new(powder, gas, gravity);
    (4.0 * scales.length_ii()).max(3.0 * powder.diameter)
}

impl HardCase {
    /// The founding study's powder at mean fraction 0.15, on `edge` cells along each of two axes.
    fn base(name: &'static str, edge: usize) -> Self {
        let powder =
            Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 };
        Self {
            name,
            powder,
            gas: Gas { density: 1.3, viscosity: 1.8e-5 },
            gravity: 9.81,
            drag: DragChoice::WenYu,
            friction: FrictionChoice::Barrier,
            solids_fraction: 0.15,
            cells: vec![edge; 2],
            spacing: vec![1.25e-3; 2],
            start: Start::Noise(0.1),
            seed: 5,
            precision: Precision::Double,
        }
    }

    /// With the cells that powder, gas and gravity ask for.
    fn on_usual_cells(mut self) -> Self {
        let cell = usual_cell(&self.powder, &self.gas, self.gravity);
        self.spacing = vec![cell; self.cells.len()];
        self
    }

    fn fraction(name: &'static str, edge: usize, solids_fraction: f64) -> Self {
        Self { solids_fraction, ..Self::base(name, edge) }
    }

    fn diameter(name: &'static str, edge: usize, diameter: f64) -> Self {
        let mut case = Self::base(name, edge);
        case.powder.diameter = diameter;
        case.on_usual_cells()
    }

    fn density_ratio(name: &'static str, edge: usize, ratio: f64) -> Self {
        let mut case = Self::base(name, edge);
        case.gas.density = case.powder.density / ratio;
        case.on_usual_cells()
    }

    fn restitution(name: &'static str, edge: usize, restitution: f64) -> Self {
        let mut case = Self::base(name, edge);
        case.powder.restitution = restitution;
        case
    }

    fn setup(&self) -> Setup {
        Setup {
            powder: self.powder,
            gas: self.gas,
            gravity: self.gravity,
            drag: self.drag,
            radial_distribution: RadialDistributionChoice::Princeton,
            friction: self.friction,
            terms: Terms::default(),
            solids_fraction: self.solids_fraction,
            perturbation: match self.start {
                Start::Noise(amplitude) => amplitude,
                Start::Slab => 1.0,
            },
            seed: self.seed,
            parallel: false,
        }
    }

    fn flow<R: Real, const D: usize>(&self) -> TwoFluid<R, D> {
        let cells: [usize; D] = std::array::from_fn(|axis| self.cells[axis]);
        let size = std::array::from_fn(|axis| self.spacing[axis] * cells[axis] as f64);
        let grid = Grid::new(size, cells);
        match self.start {
            Start::Noise(_) => TwoFluid::new(grid, self.setup()),
            Start::Slab => {
                let top = cells[D - 1] as f64 * self.solids_fraction / SLAB;
                TwoFluid::perturbed(grid, self.setup(), |index| {
                    let filled = (top - index[D - 1] as f64).clamp(0.0, 1.0);
                    filled * SLAB / self.solids_fraction - 1.0
                })
            }
        }
    }
}

/// The cases; `quick` on fewer cells.
pub fn cases(quick: bool) -> Vec<HardCase> {
    let edge = if quick { 32 } else { 64 };
    let deep = if quick { 12 } else { 24 };
    let liquid = Gas { density: 1000.0, viscosity: 1e-3 };
    let heavy = Powder { diameter: 1e-3, density: 2000.0, restitution: 0.9, max_packing: 0.65 };
    let base = HardCase::base;
    let solid = |name, solids_fraction| HardCase {
        solids_fraction,
        cells: vec![deep, deep, 2 * deep],
        spacing: vec![1.25e-3; 3],
        ..base(name, edge)
    };
    vec![
        base("base: φ 0.15, 75 µm, ratio 1154, e 0.9", edge),
        HardCase::fraction("φ 0.001", edge, 0.001),
        HardCase::fraction("φ 0.01", edge, 0.01),
        HardCase::fraction("φ 0.3", edge, 0.3),
        HardCase::fraction("φ 0.45", edge, 0.45),
        HardCase::fraction("φ 0.55", edge, 0.55),
        HardCase { start: Start::Noise(0.05), ..HardCase::fraction("φ 0.6", edge, 0.6) },
        HardCase::diameter("d 10 µm", edge, 10e-6),
        HardCase::diameter("d 20 µm", edge, 20e-6),
        HardCase::diameter("d 30 µm", edge, 30e-6),
        HardCase::diameter("d 300 µm", edge, 300e-6),
        HardCase::diameter("d 1000 µm", edge, 1000e-6),
        HardCase::diameter("d 3 mm", edge, 3e-3),
        HardCase { gas: liquid, powder: heavy, ..base("ratio 2: d 1 mm in water", edge) }
            .on_usual_cells(),
        HardCase {
            gas: liquid,
            powder: Powder { diameter: 75e-6, ..heavy },
            ..base("ratio 2: d 75 µm in water", edge)
        }
        .on_usual_cells(),
        HardCase::density_ratio("ratio 100", edge, 100.0),
        HardCase::density_ratio("ratio 1e4", edge, 1e4),
        HardCase::restitution("e 0.3", edge, 0.3),
        HardCase::restitution("e 0.5", edge, 0.5),
        HardCase::restitution("e 0.99", edge, 0.99),
        HardCase::restitution("e 1", edge, 1.0),
        HardCase { start: Start::Slab, ..base("slab at 0.6 over vacuum", edge) },
        HardCase {
            start: Start::Slab,
            solids_fraction: 0.45,
            ..base("slab, three quarters", edge)
        },
        HardCase { start: Start::Noise(0.5), ..base("50 % random start", edge) },
        HardCase {
            start: Start::Noise(0.5),
            ..HardCase::fraction("50 % random start, φ 0.4", edge, 0.4)
        },
        HardCase { spacing: vec![0.02; 2], ..base("8 cells across, 2 cm each", 8) },
        HardCase { spacing: vec![1.25e-3; 2], ..base("8 cells across, 1.25 mm each", 8) },
        HardCase { spacing: vec![5e-3, 1.25e-3], ..base("flat cells, 4:1", edge) },
        HardCase { spacing: vec![1.25e-3, 5e-3], ..base("tall cells, 1:4", edge) },
        HardCase { spacing: vec![16e-3, 1e-3], ..base("flat cells, 16:1", edge) },
        HardCase { cells: vec![26, 50], ..base("odd box, 26 x 50", edge) },
        HardCase { gravity: 1.62, ..base("gravity of the Moon", edge) }.on_usual_cells(),
        HardCase {
            drag: DragChoice::Beetstra,
            friction: FrictionChoice::SrivastavaSundaresan,
            ..HardCase::fraction("φ 0.5, Beetstra, frictional pressure", edge, 0.5)
        },
        HardCase { precision: Precision::Single, ..base("f32", edge) },
        HardCase {
            precision: Precision::Single,
            ..HardCase::fraction("f32, φ 0.001", edge, 0.001)
        },
        HardCase { precision: Precision::Single, ..HardCase::fraction("f32, φ 0.55", edge, 0.55) },
        HardCase { precision: Precision::Single, start: Start::Slab, ..base("f32, slab", edge) },
        HardCase {
            precision: Precision::Single,
            start: Start::Noise(0.5),
            seed: 1,
            ..HardCase::diameter("f32, d 300 µm, 50 % start", edge, 300e-6)
        },
        solid("3-D", 0.15),
        HardCase { start: Start::Slab, ..solid("3-D, slab", 0.15) },
        HardCase { precision: Precision::Single, ..solid("3-D, f32, φ 0.45", 0.45) },
    ]
}

/// What one case came to.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The case.
    pub name: &'static str,
    /// Cells along each edge.
    pub cells: Vec<usize>,
    /// Simulated time \[u_t/g\].
    pub time: f64,
    /// Time steps.
    pub steps: u64,
    /// Shortest step since the first that was not limited by growth, and the median step \[s\].
    pub step: [f64; 2],
    /// What limited the shortest step, and most steps.
    pub limited_by: [Limit; 2],
    /// Mean slip over the second half \[u_t\].
    pub slip: f64,
    /// Least and largest solids fraction of any cell at any step.
    pub solids_fraction: [f64; 2],
    /// Least and largest granular temperature of any cell at any step \[m²/s²\].
    pub granular_temperature: [f64; 2],
    /// Relative change of the solids mass.
    pub mass_change: f64,
    /// Change of the mixture's momentum over ρ_s ⟨φ⟩ u_t, the worst axis.
    pub momentum_change: f64,
    /// Pressure iterations per step: mean and most.
    pub iterations: [f64; 2],
    /// Points at which the run was stopped and gone on with, and at how many that gave other bits.
    pub restarts: [usize; 2],
    /// What is wrong, one sentence each.
    pub failures: Vec<String>,
}

/// The table.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// One for each case.
    pub rows: Vec<Row>,
}

impl Table {
    /// Cases in which something is wrong.
    pub fn failed(&self) -> usize {
        self.rows.iter().filter(|row| !row.failures.is_empty()).count()
    }
}

/// How far φ may rise above the densest packing: the stiff pressures beyond it give a little.
const OVERFILL: f64 = 0.015;

/// Shortest step over the median one below which the step has collapsed.
const COLLAPSE: f64 = 1e-3;

/// Most steps of a case: with more it does not get anywhere.
const MOST_STEPS: u64 = 400_000;

/// Points at which a run is stopped and gone on with, and steps that are compared after each.
const RESTARTS: usize = 6;
const COMPARED: u64 = 5;

/// Change of mass and momentum that is round-off, in double and in single precision.
const DOUBLE_ROUND_OFF: [f64; 2] = [1e-12, 1e-9];
const SINGLE_ROUND_OFF: [f64; 2] = [1e-5, 1e-2];

/// Runs all cases; `watch` is given each row as it is found. `quick`: 20 u_t/g on fewer cells
/// instead of 60.
pub fn run(quick: bool, mut watch: impl FnMut(&Row)) -> Table {
    let time = if quick { 20.0 } else { 60.0 };
    let rows = cases(quick)
        .iter()
        .map(|case| {
            let row = run_case(case, time);
            watch(&row);
            row
        })
        .collect();
    Table { rows }
}

/// Runs one case for `time` \[u_t/g\].
pub fn run_case(case: &HardCase, time: f64) -> Row {
    match (case.precision, case.cells.len()) {
        (Precision::Double, 2) => simulate::<f64, 2>(case, time),
        (Precision::Double, _) => simulate::<f64, 3>(case, time),
        (Precision::Single, 2) => simulate::<f32, 2>(case, time),
        (Precision::Single, _) => simulate::<f32, 3>(case, time),
    }
}

/// A copy of a flow, gone on with beside it.
struct Twin<R, const D: usize> {
    flow: TwoFluid<R, D>,
    left: u64,
}

fn state<R: Real, const D: usize>(flow: &TwoFluid<R, D>) -> Vec<u8> {
    let mut bytes = Vec::new();
    flow.save_state(&mut bytes).expect("writing to memory does not fail");
    bytes
}

fn simulate<R: Real, const D: usize>(case: &HardCase, time: f64) -> Row {
    let scales = Scales::new(&case.powder, &case.gas, case.gravity);
    let end = time * scales.time();
    let mut flow = case.flow::<R, D>();
    let start = flow.means();
    let mut reports: Vec<StepReport> = Vec::new();
    let mut failures = Vec::new();
    let (mut fraction, mut temperature) = ([f64::INFINITY, 0.0f64], [f64::INFINITY, 0.0f64]);
    let (mut slips, mut restarts) = ((0.0, 0u64), [0, 0]);
    let mut twin: Option<Twin<R, D>> = None;
    while flow.time() < end {
        if flow.time() >= end * (restarts[0] + 1) as f64 / (RESTARTS + 1) as f64 && twin.is_none() {
            let mut again = case.flow::<R, D>();
            match again.restore_state(&mut state(&flow).as_slice()) {
                Ok(()) => twin = Some(Twin { flow: again, left: COMPARED }),
                Err(error) => failures.push(error.to_string()),
            }
            restarts[0] += 1;
        }
        match flow.step(f64::INFINITY) {
            Ok(report) => reports.push(report),
            Err(error) => {
                failures.push(error.to_string());
                break;
            }
        }
        if let Some(Twin { flow: again, left }) = &mut twin {
            *left -= 1;
            let failed = again.step(f64::INFINITY).is_err();
            if *left == 0 || failed {
                restarts[1] += usize::from(state(again) != state(&flow));
                twin = None;
            }
        }
        let (phi, theta) = (flow.solids_fraction(), flow.granular_temperature());
        fraction = [fraction[0].min(phi.min().f64()), fraction[1].max(phi.max().f64())];
        temperature =
            [temperature[0].min(theta.min().f64()), temperature[1].max(theta.max().f64())];
        if flow.time() > 0.5 * end {
            slips = (slips.0 + flow.means().slip, slips.1 + 1);
        }
        if reports.len() as u64 == MOST_STEPS {
            failures.push(format!("after {MOST_STEPS} steps it is at {:.3e} s only", flow.time()));
            break;
        }
    }
    let means = flow.means();
    let scale = case.powder.density * start.solids_fraction * scales.terminal_velocity;
    let [shortest, median] = steps(&reports);
    let row = Row {
        name: case.name,
        cells: case.cells.clone(),
        time: flow.time() / scales.time(),
        steps: reports.len() as u64,
        step: [shortest.dt, median.dt],
        limited_by: [shortest.limit, most_frequent(&reports)],
        slip: slips.0 / slips.1 as f64 / scales.terminal_velocity,
        solids_fraction: fraction,
        granular_temperature: temperature,
        mass_change: means.solids_fraction / start.solids_fraction - 1.0,
        momentum_change: (0..D)
            .map(|axis| (means.momentum[axis] - start.momentum[axis]).abs() / scale)
            .fold(0.0, f64::max),
        iterations: [
            reports.iter().map(|r| r.iterations).sum::<usize>() as f64 / reports.len() as f64,
            reports.iter().map(|r| r.iterations).max().unwrap_or_default() as f64,
        ],
        restarts,
        failures,
    };
    judged(row, case)
}

/// The shortest step since the first that growth did not limit, and the median one.
fn steps(reports: &[StepReport]) -> [StepReport; 2] {
    let nothing = StepReport {
        dt: 0.0,
        limit: Limit::Growth,
        gas_steps: 0,
        iterations: 0,
        volume_residual: 0.0,
    };
    let grown = reports.iter().position(|r| r.limit != Limit::Growth).unwrap_or_default();
    let mut counted = reports[grown..].to_vec();
    counted.sort_by(|a, b| a.dt.total_cmp(&b.dt));
    let at = |n: usize| counted.get(n).copied().unwrap_or(nothing);
    [at(0), at(counted.len() / 2)]
}

fn most_frequent(reports: &[StepReport]) -> Limit {
    let count = |limit| reports.iter().filter(|report| report.limit == limit).count();
    Limit::ALL.into_iter().max_by_key(|&limit| count(limit)).unwrap_or(Limit::Growth)
}

/// The row with what is wrong with it.
fn judged(mut row: Row, case: &HardCase) -> Row {
    let [mass, momentum] = match case.precision {
        Precision::Double => DOUBLE_ROUND_OFF,
        Precision::Single => SINGLE_ROUND_OFF,
    };
    let [least, most] = row.solids_fraction;
    let all = row.granular_temperature.into_iter().chain([row.slip, row.momentum_change]);
    let mut wrong = |is: bool, what: String| {
        if is {
            row.failures.push(what);
        }
    };
    wrong(all.chain([least, most]).any(|x| !x.is_finite()), "a mean is not finite".into());
    wrong(least < 0.0, format!("solids fraction of {least:.1e}"));
    let packing = case.powder.max_packing;
    wrong(
        most > packing + OVERFILL,
        format!("solids fraction of {most:.4} above the densest packing, {packing}"),
    );
    // Not finite is wrong too.
    let kept = |change: f64, round_off: f64| change.abs() <= round_off;
    wrong(!kept(row.mass_change, mass), format!("solids mass changed by {:.1e}", row.mass_change));
    let change = row.momentum_change;
    wrong(!kept(change, momentum), format!("momentum changed by {change:.1e}"));
    let [shortest, median] = row.step;
    wrong(
        shortest < COLLAPSE * median,
        format!("a step of {shortest:.1e} s, {:.0e} of the median", shortest / median),
    );
    let [tried, other] = row.restarts;
    wrong(other > 0, format!("{other} of {tried} restarts gave other bits"));
    row
}

impl fmt::Display for Row {
    /// One line, in the columns of [`HEADER`].
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cells: Vec<String> = self.cells.iter().map(ToString::to_string).collect();
        let [shortest, most] = self.limited_by;
        let limits =
            if shortest == most { most.to_string() } else { format!("{most} ({shortest})") };
        write!(
            f,
            "{:<38} {:<11} {:>5.0} {:>7} {:>8.1e} {:>8.1e} {:<36} {:>8.3} {:>7.4} {:>8.1e} \
             {:>8.1e} {:>8.0e} {:>8.0e} {:>5.1} {:>3} {:>4}/{}  {}",
            self.name,
            cells.join("x"),
            self.time,
            self.steps,
            self.step[0],
            self.step[1],
            limits,
            self.slip,
            self.solids_fraction[1],
            self.granular_temperature[0],
            self.granular_temperature[1],
            self.mass_change.abs(),
            self.momentum_change,
            self.iterations[0],
            self.iterations[1],
            self.restarts[0] - self.restarts[1],
            self.restarts[0],
            if self.failures.is_empty() { "ok".to_owned() } else { self.failures.join("; ") },
        )
    }
}

/// The heads of a [`Row`]'s columns.
pub const HEADER: &str = "\
what                                   cells       u_t/g   steps  dt min   median mostly limited by \
(shortest step)      slip/u_t   φ max    T min    T max    mass  momentum  iterations restarts  \
verdict";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slab_holds_the_mean_and_vacuum() {
        let case = HardCase { start: Start::Slab, ..HardCase::base("slab", 16) };
        let flow = case.flow::<f64, 2>();
        let phi = flow.solids_fraction();
        assert!((phi.mean() - 0.15).abs() < 1e-15);
        assert!(phi.min() == 0.0 && (phi.max() - SLAB).abs() < 1e-15);
    }

    #[test]
    fn every_kind_of_failure_is_named() {
        let case = HardCase::base("base", 8);
        let good = run_case(&case, 20.0);
        assert_eq!(good.failures, [""; 0]);
        assert_eq!(good.restarts, [RESTARTS, 0]);
        let bad = Row {
            solids_fraction: [-1e-9, 0.7],
            mass_change: f64::NAN,
            momentum_change: 1e-3,
            step: [1e-9, 1e-4],
            restarts: [3, 1],
            ..good
        };
        let failures = judged(bad, &case).failures.join("; ");
        for word in ["-1.0e-9", "0.7000", "mass", "momentum", "1.0e-9 s", "1 of 3 restarts"] {
            assert!(failures.contains(word), "{word}: {failures}");
        }
    }
}
