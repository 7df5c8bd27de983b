//! Do the 95 % intervals of a bin table hold the truth in 95 % of the cases? Fields that are
//! Ornstein-Uhlenbeck processes in space and time go through the whole chain, filter, bins, sums and
//! table, 1,000 times, and their ratios are known.

mod common;

use common::{GAS, POWDER};
use favre::fine::FineFields;
use favre::grid::Grid;
use favre::laws::drag::WenYu;
use favre::laws::scales::Scales;
use favre::spectral::Kernel;
use favre::statistics::{Axis, Bins, Marker, Sampler, Sampling, bin_table};
use favre::table::BinRow;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const REPLICAS: u64 = 1000;
const EDGE: usize = 8;

/// True Favre velocity and granular temperature.
const VELOCITY: f64 = 2.0;
const TEMPERATURE: f64 = 0.01;

/// A Gaussian field of mean 0 and variance 1 whose correlation falls exponentially along each axis
/// and in time.
struct OrnsteinUhlenbeck {
    random: Pcg64Mcg,
    /// Correlation of neighbouring cells, and of instants.
    space: f64,
    time: f64,
    state: Vec<f64>,
}

impl OrnsteinUhlenbeck {
    fn new(space: f64, time: f64, seed: u64) -> Self {
        let random = Pcg64Mcg::seed_from_u64(seed);
        let mut field = Self { random, space, time, state: vec![] };
        field.state = field.fresh();
        field
    }

    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.random.random::<f64>()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.random.random::<f64>()).cos()
    }

    /// Correlated in space, independent of what was.
    fn fresh(&mut self) -> Vec<f64> {
        let mut field: Vec<f64> = (0..EDGE * EDGE).map(|_| self.normal()).collect();
        let (keep, renew) = (self.space, (1.0 - self.space * self.space).sqrt());
        for cell in 0..EDGE * EDGE {
            if cell % EDGE > 0 {
                field[cell] = keep * field[cell - 1] + renew * field[cell];
            }
        }
        for cell in EDGE..EDGE * EDGE {
            field[cell] = keep * field[cell - EDGE] + renew * field[cell];
        }
        field
    }

    fn step(&mut self) -> &[f64] {
        let fresh = self.fresh();
        let (keep, renew) = (self.time, (1.0 - self.time * self.time).sqrt());
        self.state.iter_mut().zip(fresh).for_each(|(old, new)| *old = keep * *old + renew * new);
        &self.state
    }
}

/// How often intervals held the truth, of how many, and how often those would have that take all
/// filter positions as independent.
#[derive(Default)]
struct Count {
    of: u32,
    honest: u32,
    naive: u32,
    unbounded: u32,
}

impl Count {
    fn add(&mut self, row: &BinRow, truth: f64) {
        self.of += 1;
        self.honest += u32::from(row.low_95 < truth && truth < row.high_95);
        self.unbounded += u32::from(!row.standard_error.is_finite());
        let independent = row.standard_error * (row.effective_samples / row.samples as f64).sqrt();
        self.naive += u32::from((row.value - truth).abs() < 1.96 * independent);
    }

    fn honest(&self) -> f64 {
        f64::from(self.honest) / f64::from(self.of)
    }

    fn naive(&self) -> f64 {
        f64::from(self.naive) / f64::from(self.of)
    }
}

/// Coverage of the Favre velocity (normal residuals) and of the granular temperature (log-normal,
/// skewness 4), in bins of solids fraction between `edges`, from `runs` runs of `instants` each.
fn coverage(edges: &[f64], runs: u64, instants: u64, heavy: f64) -> Vec<[Count; 2]> {
    let grid = Grid::new([0.016; 2], [EDGE; 2]);
    let scales = Scales::new(&POWDER, &GAS, 9.81);
    let mut counts: Vec<[Count; 2]> = edges.windows(2).map(|_| Default::default()).collect();
    let mut fine = FineFields::zeros(grid);
    for replica in 0..REPLICAS {
        let sums: Vec<_> = (0..runs)
            .map(|run| {
                let sampling = Sampling {
                    scales,
                    gas_density: GAS.density,
                    bins: Bins { axes: vec![Axis::new(Marker::SolidsFraction, edges.to_vec())] },
                    kernel: Kernel::Box,
                    widths: vec![0.004],
                    block_duration: 4.0,
                    space: [1; 2],
                    periodic: [true; 2],
                    closest: 1,
                    parallel: false,
                };
                let law = WenYu::<f64>::new(&GAS, &POWDER);
                let mut sampler = Sampler::new(grid, law, sampling).unwrap();
                let seed = 1 + 3 * (replica * runs + run);
                let [mut weight, mut velocity, mut temperature] =
                    [0, 1, 2].map(|n| OrnsteinUhlenbeck::new(0.6, 0.85, seed + n));
                for instant in 0..instants {
                    fine.time = instant as f64 + 0.5;
                    let fields = [weight.step(), velocity.step(), temperature.step()];
                    for cell in 0..grid.len() {
                        let [w, u, t] = fields.map(|field| field[cell]);
                        fine.solids_fraction[cell] = (0.2 * (0.3 * w).exp()).min(0.6);
                        fine.solids_velocity[1][cell] = VELOCITY + u;
                        fine.granular_temperature[cell] =
                            TEMPERATURE * (heavy * t - 0.5 * heavy * heavy).exp();
                    }
                    sampler.sample(&fine);
                }
                sampler.into_sums()
            })
            .collect();
        for row in bin_table(&sums, &scales).unwrap() {
            let bin = edges.iter().position(|edge| *edge == row.solids_fraction_low).unwrap();
            match row.quantity.as_str() {
                "solids_velocity" => counts[bin][0].add(&row, VELOCITY),
                "granular_temperature" => counts[bin][1].add(&row, TEMPERATURE),
                _ => {}
            }
        }
    }
    counts
}

fn check(edges: &[f64], runs: u64, instants: u64) {
    for (bin, counts) in coverage(edges, runs, instants, 1.0).iter().enumerate() {
        for (count, what) in counts.iter().zip(["velocity", "temperature"]) {
            let (honest, naive) = (count.honest(), count.naive());
            println!("{runs} x {instants}, bin {bin}, {what}: {honest}, independent {naive}");
            assert_eq!((u64::from(count.of), count.unbounded), (REPLICAS, 0));
            assert!((0.93..=0.97).contains(&honest), "bin {bin}, {what}: {honest}");
            // The check has teeth: positions taken as independent do not cover.
            assert!(naive < 0.75, "bin {bin}, {what}: independent positions cover {naive}");
        }
    }
}

#[test]
fn intervals_of_one_long_run_cover() {
    check(&[0.0, 0.65], 1, 600);
}

#[test]
fn intervals_of_four_runs_cover_in_each_bin() {
    check(&[0.0, 0.19, 0.22, 0.65], 4, 200);
}
