//! [`estimate`]: a ratio of sums over a correlated signal, with an honest error.
//!
//! Samples close in time are alike, so that counting them as independent gives errors that are far
//! too small. The signal is cut into blocks of time; with R = Σ num / Σ den, block b misses the
//! ratio by r_b = num_b - R den_b, and to first order Var R = Var(Σ r_b) / (Σ den_b)². Were the
//! blocks independent, Var(Σ r_b) would be n/(n-1) Σ r_b². Blocks are lumped by 1, 2, 4, ... until
//! fewer than [`MINIMUM_LUMPS`] lumps remain: the error grows while lumps are correlated and
//! settles when they are not (Flyvbjerg & Petersen 1989). The largest error over all levels is
//! taken: it errs on the wide side when no plateau is in sight.

use std::collections::BTreeMap;

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Fewest lumps from which an error is estimated; below, the error is infinite.
pub const MINIMUM_LUMPS: usize = 8;

/// Sums of one block of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// The run that the block is part of. Runs are independent; lumps do not span runs.
    pub run: usize,
    /// Place of the block in its run: block 5 follows block 4 in time.
    pub place: u64,
    /// Sum of the numerators.
    pub numerator: f64,
    /// Sum of the denominators.
    pub denominator: f64,
}

/// A ratio with its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Σ num / Σ den, pooled over all blocks.
    pub ratio: f64,
    /// Standard error of the ratio; infinite with fewer than [`MINIMUM_LUMPS`] blocks.
    pub standard_error: f64,
    /// Half the width of the 95 % interval, from Student's t with `lumps` - 1 degrees of freedom.
    pub half_width_95: f64,
    /// Lumps that the error is from: those in which something was seen.
    pub lumps: usize,
}

/// Student's t quantiles for two-sided 95 % intervals, kept by degrees of freedom: computing one
/// takes longer than the rest of an estimate.
#[derive(Clone, Debug, Default)]
pub struct Quantiles {
    known: BTreeMap<usize, f64>,
}

impl Quantiles {
    /// The 97.5 % quantile of Student's t with `freedom` degrees of freedom.
    ///
    /// # Panics
    /// If `freedom` is 0.
    pub fn get(&mut self, freedom: usize) -> f64 {
        *self.known.entry(freedom).or_insert_with(|| {
            StudentsT::new(0.0, 1.0, freedom as f64)
                .expect("degrees of freedom are positive")
                .inverse_cdf(0.975)
        })
    }
}

/// The ratio of the sums of `blocks`, which are ordered by run and then by place. A block that is
/// missing saw nothing.
///
/// The error's factor n/(n-1) and degrees of freedom count the lumps that saw something: a rare bin
/// is as uncertain as the few visits it had, however long the run.
pub fn estimate(blocks: &[Block], quantiles: &mut Quantiles) -> Estimate {
    let numerator: f64 = blocks.iter().map(|block| block.numerator).sum();
    let denominator: f64 = blocks.iter().map(|block| block.denominator).sum();
    let ratio = numerator / denominator;
    let mut best = (f64::NEG_INFINITY, 0);
    for level in 0..u64::BITS {
        let (squares, lumps) = lumped(blocks, ratio, level);
        if lumps < MINIMUM_LUMPS {
            break;
        }
        let variance = squares * lumps as f64 / (lumps - 1) as f64;
        if variance > best.0 {
            best = (variance, lumps);
        }
        // Once every run is a single lump, longer lumps are the same lumps.
        if blocks.iter().all(|block| block.place >> level == 0) {
            break;
        }
    }
    let (variance, lumps) = best;
    if lumps == 0 {
        let infinite = f64::INFINITY;
        return Estimate { ratio, standard_error: infinite, half_width_95: infinite, lumps: 0 };
    }
    let standard_error = variance.sqrt() / denominator.abs();
    let half_width_95 = quantiles.get(lumps - 1) * standard_error;
    Estimate { ratio, standard_error, half_width_95, lumps }
}

/// Sum of the squared residuals of lumps of 2^`level` blocks, and the number of lumps.
fn lumped(blocks: &[Block], ratio: f64, level: u32) -> (f64, usize) {
    let same = |a: &Block, b: &Block| a.run == b.run && a.place >> level == b.place >> level;
    blocks.chunk_by(same).fold((0.0, 0), |(squares, lumps), lump| {
        let residual: f64 = lump.iter().map(|b| b.numerator - ratio * b.denominator).sum();
        (squares + residual * residual, lumps + 1)
    })
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

    /// Blocks of one run whose denominators and residuals are correlated in time; ratio 2.
    fn correlated_run(run: usize, len: u64, per_time: f64, seed: u64) -> Vec<Block> {
        let mut weight = OrnsteinUhlenbeck::new(per_time, seed);
        let mut residual = OrnsteinUhlenbeck::new(per_time, seed ^ 0x9e37_79b9_7f4a_7c15);
        (0..len)
            .map(|place| {
                let weight = weight.next();
                let denominator = 3.0 + weight;
                // The residual's size follows the weight, as in a real bin.
                let numerator = 2.0 * denominator + (1.0 + 0.3 * weight) * residual.next();
                Block { run, place, numerator, denominator }
            })
            .collect()
    }

    /// Share of replicas whose interval holds the true ratio 2, and the same for an interval that
    /// takes all blocks as independent.
    fn coverage(runs: usize, len: u64, per_time: f64) -> (f64, f64) {
        let mut quantiles = Quantiles::default();
        let replicas = 1000;
        let (mut honest, mut naive) = (0, 0);
        for replica in 0..replicas {
            let blocks: Vec<Block> = (0..runs)
                .flat_map(|run| {
                    correlated_run(run, len, per_time, (replica * runs + run) as u64 + 1)
                })
                .collect();
            let found = estimate(&blocks, &mut quantiles);
            honest += usize::from((found.ratio - 2.0).abs() < found.half_width_95);
            let (squares, _) = lumped(&blocks, found.ratio, 0);
            let sum: f64 = blocks.iter().map(|block| block.denominator).sum();
            naive += usize::from((found.ratio - 2.0).abs() < 1.96 * squares.sqrt() / sum);
        }
        (honest as f64 / replicas as f64, naive as f64 / replicas as f64)
    }

    #[test]
    fn intervals_cover_the_truth_on_correlated_signals() {
        for (runs, len, per_time) in [(1, 1024, 4.0), (1, 600, 6.0), (4, 256, 5.0)] {
            let (honest, naive) = coverage(runs, len, per_time);
            assert!((0.93..0.98).contains(&honest), "{runs} x {len}: {honest}");
            assert!(naive < 0.6, "{runs} x {len}: independent errors cover {naive}");
        }
    }

    #[test]
    fn independent_blocks_lose_little() {
        let (honest, naive) = coverage(1, 256, 0.01);
        assert!((0.93..0.99).contains(&honest), "{honest}");
        assert!((0.92..0.97).contains(&naive), "{naive}");
    }

    #[test]
    fn quantiles_are_those_of_the_tables() {
        let mut quantiles = Quantiles::default();
        for (freedom, t) in [(1, 12.706_205), (7, 2.364_624), (30, 2.042_272), (1000, 1.962_339)] {
            assert!((quantiles.get(freedom) - t).abs() < 1e-6, "{freedom}");
        }
    }

    #[test]
    fn few_blocks_have_an_infinite_error() {
        let block = |place| Block { run: 0, place, numerator: place as f64, denominator: 1.0 };
        let mut blocks: Vec<Block> = (0..7).map(block).collect();
        let few = estimate(&blocks, &mut Quantiles::default());
        assert_eq!((few.ratio, few.standard_error, few.lumps), (3.0, f64::INFINITY, 0));
        blocks.push(block(7));
        let enough = estimate(&blocks, &mut Quantiles::default());
        assert_eq!((enough.ratio, enough.lumps), (3.5, 8));
        // Eight numbers of variance 6: the textbook error of a mean.
        assert!((enough.standard_error - (6.0f64 / 8.0).sqrt()).abs() < 1e-14);
        assert!((enough.half_width_95 - 2.364_624 * enough.standard_error).abs() < 1e-5);
    }

    #[test]
    fn lumps_do_not_span_runs() {
        let block = |run, place, numerator| Block { run, place, numerator, denominator: 1.0 };
        let blocks = [block(0, 0, 1.0), block(0, 1, 3.0), block(1, 1, 5.0), block(1, 2, 7.0)];
        assert_eq!(lumped(&blocks, 4.0, 0), (9.0 + 1.0 + 1.0 + 9.0, 4));
        assert_eq!(lumped(&blocks, 4.0, 1), (16.0 + 1.0 + 9.0, 3));
        assert_eq!(lumped(&blocks, 4.0, 2), (16.0 + 16.0, 2));
    }
}
