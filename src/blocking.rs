//! [`Estimator`]: a ratio of sums over a correlated signal, with an honest interval.
//!
//! Samples close in time are alike, so that counting them as independent gives errors that are far
//! too small. With R = Σ num / Σ den, block b of a run misses the ratio by r_b = num_b - R den_b, and
//! to first order the error of R is Σ r_b / Σ den_b. What Σ r_b would be in another realisation is
//! read off the slowest cosines of the signal: c_j = √2 Σ_b r_b cos(π j (b + ½)/n), j = 1 .. B, are
//! independent, without bias from the mean, and each has the variance of Σ r_b as long as the signal
//! is forgotten faster than the cosine turns. Their mean square is the variance, and Student's t has
//! B degrees of freedom (equal-weighted cosines: Lazarus, Lewis, Stock & Watson 2018). Numerator and
//! denominator go through the same cosines, which is what resampling them jointly is for.
//!
//! - **How slow is slow** follows from the measured correlation time τ: B = 0.123 n/τ, between 4 and
//!   24, so that the fastest cosine of a signal with exponential memory has lost a tenth of its
//!   variance; the mean loss is put back. A block needs no length of its own: blocks shorter than τ
//!   are right, longer ones only leave fewer cosines.
//! - **Denominators that vary** are taken at their word (Fieller 1954): the interval holds every R
//!   for which Σ (num - R den) is not further from zero than its own error allows. It is unbounded
//!   where the denominator itself is not known to differ from zero.
//! - **Heavy tails** make the sum skew. Its skewness, from lumps of 2 τ, enters by Hall's (1992)
//!   monotone transformation of Student's t.
//! - **Few visits**: a rare bin is as uncertain as the lumps that saw something are few.
//!
//! A run of few instants has no time series. If its blocks are also blocks of space, the slowest
//! waves across the box take the part of the cosines.

use std::collections::BTreeMap;
use std::f64::consts::{PI, SQRT_2};

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Fewest lumps of twice the correlation time, or blocks of space, that must have seen something;
/// below, the error is infinite.
pub const FEWEST_LUMPS: usize = 4;

/// Fewest instants that make a time series.
pub const FEWEST_TIMES: usize = 8;

/// Cosines per block and correlation time: that the mean of 1/(1 + (π j τ/n)²) over j ≤ B is 0.95,
/// (π B τ/n)²/3 = 0.05, asks for B = √0.15/π n/τ.
const COSINES: f64 = 0.123;

/// Fewest and most cosines: below, Student's quantiles are large without need; above, nothing is
/// gained.
const COSINE_RANGE: [usize; 2] = [4, 24];

/// Largest skewness of a sum that is believed: of few lumps it is mostly chance.
const MOST_SKEWNESS: f64 = 0.3;

/// Sums of one run, in blocks at equal intervals of time and space.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Blocks of space along each axis; 1 for what is not divided.
    pub space: [usize; 3],
    /// Numerator and denominator of each block, blocks of space fastest, first axis first.
    pub sums: Vec<[f64; 2]>,
}

impl Run {
    /// A run whose blocks are blocks of time only.
    pub fn in_time(sums: Vec<[f64; 2]>) -> Self {
        Self { space: [1; 3], sums }
    }

    /// Blocks of space.
    fn places(&self) -> usize {
        self.space.iter().product()
    }

    /// Blocks of time.
    fn times(&self) -> usize {
        self.sums.len() / self.places()
    }
}

/// A ratio with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Σ num / Σ den, pooled over all runs.
    pub ratio: f64,
    /// Standard error of the ratio; infinite where fewer than [`FEWEST_LUMPS`] lumps tell of it.
    pub standard_error: f64,
    /// The 95 % interval, which need not be symmetric.
    pub interval_95: [f64; 2],
    /// Degrees of freedom of the standard error.
    pub freedom: f64,
    /// Integral correlation time ½ + Σ ρ(k) of the residual, in blocks of time.
    pub correlation_time: f64,
}

impl Estimate {
    fn unknown(ratio: f64, correlation_time: f64) -> Self {
        Self {
            ratio,
            standard_error: f64::INFINITY,
            interval_95: [f64::NEG_INFINITY, f64::INFINITY],
            freedom: 0.0,
            correlation_time,
        }
    }

    /// Half the length of the interval.
    pub fn half_width_95(&self) -> f64 {
        0.5 * (self.interval_95[1] - self.interval_95[0])
    }
}

/// Variances and covariance of the sums of residuals num - R den and of denominators.
#[derive(Clone, Copy, Debug, Default)]
struct Covariance {
    residual: f64,
    product: f64,
    denominator: f64,
}

impl Covariance {
    fn add(&mut self, [residual, denominator]: [f64; 2], weight: f64) {
        self.residual += weight * residual * residual;
        self.product += weight * residual * denominator;
        self.denominator += weight * denominator * denominator;
    }

    fn merge(&mut self, other: &Self) {
        self.residual += other.residual;
        self.product += other.product;
        self.denominator += other.denominator;
    }
}

/// What can be known of lumps of a signal longer than its memory.
#[derive(Clone, Copy, Debug, Default)]
struct Lumps {
    /// Lumps that saw something.
    seen: usize,
    squares: f64,
    cubes: f64,
}

impl Lumps {
    fn add<'a>(&mut self, lump: impl Iterator<Item = &'a [f64; 2]> + Clone) {
        let residual: f64 = lump.clone().map(|[residual, _]| residual).sum();
        self.seen += usize::from(lump.clone().any(|sums| *sums != [0.0; 2]));
        self.squares += residual * residual;
        self.cubes += residual.powi(3);
    }

    /// Skewness of the sum of all lumps.
    fn skewness(&self) -> f64 {
        let skewness = self.cubes / self.squares.powf(1.5);
        if skewness.is_finite() { skewness.clamp(-MOST_SKEWNESS, MOST_SKEWNESS) } else { 0.0 }
    }
}

/// Estimates ratios; keeps the tables that estimates of like signals share.
#[derive(Clone, Debug, Default)]
pub struct Estimator {
    /// 97.5 % quantiles of Student's t by quarters of a degree of freedom.
    quantiles: BTreeMap<u64, f64>,
    /// √2 cos(π j (b + ½)/n) by n: cosine after cosine.
    cosines: BTreeMap<usize, Vec<f64>>,
    /// √2 cos and √2 sin of the slowest waves across blocks of space.
    waves: BTreeMap<[usize; 3], Vec<Vec<f64>>>,
}

impl Estimator {
    /// The ratio of the sums of `runs`, which are independent of each other.
    pub fn estimate(&mut self, runs: &[Run]) -> Estimate {
        let total = |part: usize| runs.iter().flat_map(|run| &run.sums).map(|s| s[part]).sum();
        let (numerator, denominator): (f64, f64) = (total(0), total(1));
        let ratio = numerator / denominator;
        // From here on the residual stands in the numerator's place.
        let runs: Vec<Run> = runs
            .iter()
            .map(|run| {
                let residual = |&[num, den]: &[f64; 2]| [num - ratio * den, den];
                Run { space: run.space, sums: run.sums.iter().map(residual).collect() }
            })
            .collect();
        let time = correlation_time(&runs.iter().map(residuals).collect::<Vec<_>>());

        let (mut covariance, mut lumps) = (Covariance::default(), Lumps::default());
        let mut square_per_freedom = 0.0;
        for run in &runs {
            let found = if run.times() >= FEWEST_TIMES {
                lump_in_time(run, time, &mut lumps);
                Some(self.in_time(run, time))
            } else {
                lump_in_space(run, &mut lumps);
                self.in_space(run)
            };
            let Some((of_run, freedom)) = found else { return Estimate::unknown(ratio, time) };
            covariance.merge(&of_run);
            square_per_freedom += of_run.residual.powi(2) / freedom;
        }
        let variance = covariance.residual;
        if lumps.seen < FEWEST_LUMPS || !ratio.is_finite() {
            return Estimate::unknown(ratio, time);
        }
        // The mean was taken from the same lumps.
        let seen = lumps.seen as f64;
        let few = seen / (seen - 1.0);
        let freedom = if variance > 0.0 {
            (variance * variance / square_per_freedom).min(seen - 1.0)
        } else {
            seen - 1.0
        };
        let standard_error = (few * variance).sqrt() / denominator.abs();
        let t = self.quantile(freedom);
        let skewness = lumps.skewness();
        // Of the sum's deviation in its own errors: how far below and above zero it may lie.
        let mut bounds = [-unskewed(-t, skewness), unskewed(t, skewness)];
        if denominator < 0.0 {
            bounds.reverse();
        }
        // A sum above zero means a ratio above the true one.
        let interval_95 = [(bounds[1], -1.0), (bounds[0], 1.0)].map(|(bound, side)| {
            ratio + fieller(denominator, &covariance, few.sqrt() * bound, side)
        });
        Estimate { ratio, standard_error, interval_95, freedom, correlation_time: time }
    }

    /// The 97.5 % quantile of Student's t with `freedom` degrees of freedom, to a quarter of one:
    /// computing one takes longer than the rest of an estimate.
    ///
    /// # Panics
    /// If `freedom` is not positive.
    pub fn quantile(&mut self, freedom: f64) -> f64 {
        let quarters = (4.0 * freedom).round().max(1.0);
        *self.quantiles.entry(quarters as u64).or_insert_with(|| {
            StudentsT::new(0.0, 1.0, 0.25 * quarters)
                .expect("degrees of freedom are positive")
                .inverse_cdf(0.975)
        })
    }

    /// Covariance of the sums of a run from its slowest cosines, and its degrees of freedom.
    fn in_time(&mut self, run: &Run, time: f64) -> (Covariance, f64) {
        let n = run.times();
        let most = COSINE_RANGE[1].min(n - 1);
        let count = ((COSINES * n as f64 / time) as usize).clamp(COSINE_RANGE[0], most);
        let table = self.cosines.entry(n).or_insert_with(|| {
            let angle = |j: usize, b: usize| PI * j as f64 * (b as f64 + 0.5) / n as f64;
            (1..=most).flat_map(|j| (0..n).map(move |b| SQRT_2 * angle(j, b).cos())).collect()
        });
        // What a signal of exponential memory loses on these cosines.
        let kept: f64 =
            (1..=count).map(|j| 1.0 / (1.0 + (PI * j as f64 * time / n as f64).powi(2))).sum();
        let mut covariance = Covariance::default();
        for cosine in table.chunks_exact(n).take(count) {
            let mut coefficient = [0.0; 2];
            for (block, cosine) in run.sums.chunks_exact(run.places()).zip(cosine) {
                for sums in block {
                    coefficient[0] += cosine * sums[0];
                    coefficient[1] += cosine * sums[1];
                }
            }
            covariance.add(coefficient, 1.0 / kept);
        }
        (covariance, count as f64)
    }

    /// The same from the slowest waves across a box of few instants; none if it is not divided.
    fn in_space(&mut self, run: &Run) -> Option<(Covariance, f64)> {
        let places = run.places();
        if places < FEWEST_LUMPS {
            return None;
        }
        let waves = self.waves.entry(run.space).or_insert_with(|| waves(run.space));
        let mut covariance = Covariance::default();
        for wave in &*waves {
            let mut coefficient = [0.0; 2];
            for block in run.sums.chunks_exact(places) {
                for (sums, wave) in block.iter().zip(wave) {
                    coefficient[0] += wave * sums[0];
                    coefficient[1] += wave * sums[1];
                }
            }
            covariance.add(coefficient, 1.0 / waves.len() as f64);
        }
        Some((covariance, waves.len() as f64))
    }
}

/// The slowest waves across `space` blocks: one period or none along each axis, without the mean.
fn waves(space: [usize; 3]) -> Vec<Vec<f64>> {
    let places: usize = space.iter().product();
    // Along an axis of two blocks the period's sine vanishes, and forward is backward.
    let periods = |n: usize| match n {
        0 | 1 => 0..=0,
        2 => 0..=1,
        _ => -1..=1,
    };
    let mut waves = Vec::new();
    for z in periods(space[2]) {
        for y in periods(space[1]) {
            for x in periods(space[0]) {
                let phase = |place: usize| {
                    let at = [
                        place % space[0],
                        place / space[0] % space[1],
                        place / (space[0] * space[1]),
                    ];
                    (0..3)
                        .map(|axis| {
                            f64::from([x, y, z][axis]) * at[axis] as f64 / space[axis] as f64
                        })
                        .sum::<f64>()
                        * 2.0
                        * PI
                };
                // A wave and its opposite are one cosine and one sine.
                let direction = [(z, space[2]), (y, space[1]), (x, space[0])]
                    .into_iter()
                    .find(|&(period, n)| period != 0 && n > 2);
                let forward = direction.is_none_or(|(period, _)| period > 0);
                let wave: Vec<f64> = (0..places)
                    .map(|place| if forward { phase(place).cos() } else { phase(place).sin() })
                    .collect();
                if (x, y, z) != (0, 0, 0) {
                    let squares: f64 = wave.iter().map(|w| w * w).sum();
                    let scale = (places as f64 / squares).sqrt();
                    waves.push(wave.into_iter().map(|w| scale * w).collect());
                }
            }
        }
    }
    waves
}

/// The residual of each block of time of a run.
fn residuals(run: &Run) -> Vec<f64> {
    let of_block = |block: &[[f64; 2]]| block.iter().map(|[residual, _]| residual).sum();
    run.sums.chunks_exact(run.places()).map(of_block).collect()
}

/// ½ + Σ ρ(k), k = 1 .. M, the trapezoidal integral of the autocorrelation of several series
/// together, each about its own mean, with the shortest window M that is five times the result
/// (Sokal): a longer one would add noise only. At least ½, which stands for independent values.
pub fn correlation_time(series: &[Vec<f64>]) -> f64 {
    let longest = series.iter().map(Vec::len).max().unwrap_or(0);
    let centred: Vec<Vec<f64>> = series
        .iter()
        .map(|values| {
            let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
            values.iter().map(|value| value - mean).collect()
        })
        .collect();
    let covariance = |lag: usize| -> f64 {
        let of_one = |values: &Vec<f64>| -> f64 {
            values.iter().zip(values.get(lag..).unwrap_or_default()).map(|(a, b)| a * b).sum()
        };
        centred.iter().map(of_one).sum()
    };
    let variance = covariance(0);
    let mut time = 0.5;
    if variance > 0.0 {
        for lag in 1..longest {
            time += covariance(lag) / variance;
            if lag as f64 >= 5.0 * time {
                break;
            }
        }
    }
    time.max(0.5)
}

/// Adds the lumps of twice the correlation time of a run.
fn lump_in_time(run: &Run, time: f64, lumps: &mut Lumps) {
    let length = (2.0 * time).ceil() as usize;
    for lump in run.sums.chunks(length * run.places()) {
        lumps.add(lump.iter());
    }
}

/// Adds the blocks of space of a run, all instants together, as lumps.
fn lump_in_space(run: &Run, lumps: &mut Lumps) {
    for place in 0..run.places() {
        lumps.add(run.sums[place..].iter().step_by(run.places()));
    }
}

/// The deviation y of a sum, in its errors, that a normal deviate `t` stands for when the sum has
/// this `skewness` a: the inverse of t = y + a y²/3 + a² y³/27 + a/6 (Hall 1992).
fn unskewed(t: f64, skewness: f64) -> f64 {
    if skewness.abs() < 1e-6 {
        return t;
    }
    3.0 / skewness * ((1.0 + skewness * (t - skewness / 6.0)).cbrt() - 1.0)
}

/// The change δ of the ratio, below (`side` -1) or above (1) zero, at which |Σ (residual - δ den)| is
/// `bound` of its errors; infinite if there is none.
fn fieller(denominator: f64, errors: &Covariance, bound: f64, side: f64) -> f64 {
    let square = bound * bound;
    let a = denominator * denominator - square * errors.denominator;
    if a <= 0.0 || !a.is_finite() {
        return side * f64::INFINITY;
    }
    let b = square * errors.product;
    (side * (b * b + a * square * errors.residual).sqrt() - b) / a
}

/// Synthetic signals for the tests of this module and of the series.
#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    /// An Ornstein-Uhlenbeck signal of mean 0 and variance 1, sampled `per_time` times in one
    /// correlation time.
    pub(crate) struct OrnsteinUhlenbeck {
        random: Pcg64Mcg,
        keep: f64,
        state: f64,
    }

    impl OrnsteinUhlenbeck {
        pub(crate) fn new(per_time: f64, seed: u64) -> Self {
            let mut signal = Self {
                random: Pcg64Mcg::seed_from_u64(seed),
                keep: (-1.0 / per_time).exp(),
                state: 0.0,
            };
            signal.state = signal.normal();
            signal
        }

        pub(crate) fn normal(&mut self) -> f64 {
            let radius = (-2.0 * (1.0 - self.random.random::<f64>()).ln()).sqrt();
            radius * (std::f64::consts::TAU * self.random.random::<f64>()).cos()
        }

        pub(crate) fn next(&mut self) -> f64 {
            self.state = self.keep * self.state + (1.0 - self.keep.powi(2)).sqrt() * self.normal();
            self.state
        }
    }

    /// A run of `len` blocks of ratio 2, from two signals of correlation time `per_time` blocks.
    fn run(len: usize, per_time: f64, seed: u64, sums: impl Fn(f64, f64) -> [f64; 2]) -> Run {
        let mut weight = OrnsteinUhlenbeck::new(per_time, seed);
        let mut residual = OrnsteinUhlenbeck::new(per_time, seed ^ 0x9e37_79b9_7f4a_7c15);
        Run::in_time((0..len).map(|_| sums(weight.next(), residual.next())).collect())
    }

    /// The residual's size follows the weight, as in a real bin.
    fn mild(weight: f64, residual: f64) -> [f64; 2] {
        let denominator = 3.0 + weight;
        [2.0 * denominator + (1.0 + 0.3 * weight) * residual, denominator]
    }

    /// Log-normal: skewness 6.2.
    fn heavy(weight: f64, residual: f64) -> [f64; 2] {
        let denominator = (0.5 * weight).exp();
        [2.0 * denominator * (residual - 0.5).exp(), denominator]
    }

    /// Seen only where the weight is high.
    fn rare(weight: f64, residual: f64) -> [f64; 2] {
        let denominator = (weight - 1.0).max(0.0).powf(1.5);
        [denominator * (2.0 + residual), denominator]
    }

    /// Of 1,000 replicas the share whose interval holds the true ratio 2, the same for an interval
    /// that takes all blocks as independent, and mean square error over mean squared standard error.
    fn coverage(
        runs: usize,
        len: usize,
        per_time: f64,
        sums: impl Fn(f64, f64) -> [f64; 2] + Copy,
    ) -> [f64; 3] {
        let mut estimator = Estimator::default();
        let (mut honest, mut naive, mut square, mut variance) = (0, 0, 0.0, 0.0);
        for replica in 0..1000 {
            let runs: Vec<Run> = (0..runs)
                .map(|number| run(len, per_time, 1 + (replica * runs + number) as u64, sums))
                .collect();
            let found = estimator.estimate(&runs);
            let [low, high] = found.interval_95;
            honest += usize::from(low < 2.0 && 2.0 < high);
            square += (found.ratio - 2.0).powi(2);
            variance += found.standard_error.powi(2);
            let residuals = runs.iter().flat_map(|run| &run.sums);
            let squares: f64 =
                residuals.clone().map(|[num, den]| (num - found.ratio * den).powi(2)).sum();
            let denominator: f64 = residuals.map(|[_, den]| den).sum();
            let half = 1.96 * squares.sqrt() / denominator;
            naive += usize::from((found.ratio - 2.0).abs() < half);
        }
        [f64::from(honest as u32) / 1e3, f64::from(naive as u32) / 1e3, (variance / square).sqrt()]
    }

    #[test]
    fn intervals_cover_the_truth_on_correlated_signals() {
        let cases = [(1, 1024, 4.0), (1, 130, 4.0), (1, 520, 20.0), (4, 256, 5.0), (1, 256, 0.01)];
        for (runs, len, per_time) in cases {
            let [honest, naive, error] = coverage(runs, len, per_time, mild);
            assert!((0.93..0.97).contains(&honest), "{runs} x {len}: {honest}");
            assert!((0.9..1.1).contains(&error), "{runs} x {len}: standard error {error}");
            let correlated = per_time > 1.0;
            assert!(!correlated || naive < 0.7, "{runs} x {len}: independent cover {naive}");
        }
    }

    #[test]
    fn intervals_cover_the_truth_of_heavy_tails() {
        for (runs, len, per_time) in [(4, 300, 4.0), (4, 130, 2.0), (1, 1024, 4.0)] {
            let [honest, naive, _] = coverage(runs, len, per_time, heavy);
            assert!((0.93..0.97).contains(&honest), "{runs} x {len}: {honest}");
            assert!(naive < 0.75, "{runs} x {len}: independent errors cover {naive}");
        }
    }

    #[test]
    fn intervals_of_rare_bins_err_on_the_wide_side() {
        for (runs, len) in [(4, 130), (1, 130)] {
            let [honest, ..] = coverage(runs, len, 4.0, rare);
            assert!((0.94..1.0).contains(&honest), "{runs} x {len}: {honest}");
        }
    }

    #[test]
    fn a_few_snapshots_have_errors_from_space() {
        let (mut covered, mut variance, mut square) = (0, 0.0, 0.0);
        let mut estimator = Estimator::default();
        for replica in 0..1000 {
            // Three instants that are alike; white in space.
            let mut signal = OrnsteinUhlenbeck::new(0.01, replica + 1);
            let noise: Vec<f64> = (0..16).map(|_| signal.normal()).collect();
            let instants = |_| noise.iter().map(|noise| [6.0 + noise, 3.0]);
            let run = Run { space: [4, 4, 1], sums: (0..3).flat_map(instants).collect() };
            let found = estimator.estimate(&[run]);
            let [low, high] = found.interval_95;
            covered += usize::from(low < 2.0 && 2.0 < high);
            variance += found.standard_error.powi(2);
            square += (found.ratio - 2.0).powi(2);
        }
        assert!((930..=970).contains(&covered), "{covered}");
        assert!((0.9..1.2).contains(&(variance / square).sqrt()), "{}", variance / square);
        // Each wave has the variance of the sum; undivided, there is nothing to go by.
        for (space, count) in [([4, 4, 1], 8), ([2, 4, 1], 5), ([4, 4, 4], 26), ([3, 1, 1], 2)] {
            let waves = waves(space);
            assert_eq!(waves.len(), count, "{space:?}");
            for (i, a) in waves.iter().enumerate() {
                assert!(a.iter().sum::<f64>().abs() < 1e-12);
                for (j, b) in waves.iter().enumerate() {
                    let product: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
                    let exact = if i == j { a.len() as f64 } else { 0.0 };
                    assert!((product - exact).abs() < 1e-12, "{space:?} {i} {j} {product}");
                }
            }
        }
        let undivided = Run { space: [1; 3], sums: vec![[1.0, 1.0], [2.0, 1.0], [4.0, 1.0]] };
        assert_eq!(estimator.estimate(&[undivided]).standard_error, f64::INFINITY);
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        let mut estimator = Estimator::default();
        let known = [(1.0, 12.706_205), (7.0, 2.364_624), (30.0, 2.042_272), (1000.0, 1.962_339)];
        for (freedom, t) in known {
            assert!((estimator.quantile(freedom) - t).abs() < 1e-6, "{freedom}");
        }
    }

    #[test]
    fn a_ratio_without_scatter_is_exact() {
        let signal = run(64, 4.0, 3, |weight, _| [0.3 * (3.0 + weight), 3.0 + weight]);
        let found = Estimator::default().estimate(&[signal]);
        assert!((found.ratio - 0.3).abs() < 1e-15 && found.standard_error < 1e-15, "{found:?}");
        assert!(found.interval_95.iter().all(|bound| (bound - 0.3).abs() < 1e-14), "{found:?}");
    }

    #[test]
    fn white_noise_has_the_textbook_error() {
        let (mut mean, replicas) = (0.0, 400);
        for seed in 0..replicas {
            let signal = run(200, 0.01, seed + 1, |_, residual| [residual, 1.0]);
            mean += Estimator::default().estimate(&[signal]).standard_error.powi(2);
        }
        // 1/200, to the error of that mean; the correlation time is at least that of white noise
        // and chance finds a little more.
        let ratio = 200.0 * mean / f64::from(replicas as u32);
        assert!((0.95..1.1).contains(&ratio), "{ratio}");
    }

    #[test]
    fn little_data_has_an_infinite_error() {
        let few = run(7, 1.0, 1, mild);
        let found = Estimator::default().estimate(&[few]);
        assert_eq!((found.standard_error, found.freedom), (f64::INFINITY, 0.0));
        assert!(found.ratio.is_finite());
        // Three visits.
        let visits = |block: usize| if block % 40 == 20 { [2.0, 1.0] } else { [0.0, 0.0] };
        let seldom = Run::in_time((0..120).map(visits).collect());
        assert_eq!(Estimator::default().estimate(&[seldom]).standard_error, f64::INFINITY);
    }

    #[test]
    fn intervals_do_not_depend_on_units_or_signs() {
        let base = run(300, 3.0, 5, heavy);
        let scaled = |num: f64, den: f64| {
            let sums = base.sums.iter().map(|[n, d]| [num * n, den * d]).collect();
            Estimator::default().estimate(&[Run { space: [1; 3], sums }])
        };
        let found = scaled(1.0, 1.0);
        for (num, den) in [(1e9, 1e-6), (-3.0, 1.0), (1.0, -5.0)] {
            let other = scaled(num, den);
            let mut expected = found.interval_95.map(|bound| bound * num / den);
            expected.sort_by(f64::total_cmp);
            for (a, b) in other.interval_95.iter().zip(expected) {
                assert!((a / b - 1.0).abs() < 1e-9, "{num} {den}: {other:?} {expected:?}");
            }
        }
    }
}
