//! [`steady_start`], [`mean_with_error`]: a signal in time decides when statistics start, and
//! says how well its mean is known.
//!
//! A fluidised box starts uniform: for a while nothing happens, then a disturbance grows
//! exponentially, overshoots, and leaves a fluctuating state with heavy-tailed excursions. The
//! marginal standard error rule (White 1997; batches of five: White, Cobb & Spratt 2000) drops the
//! d first batches for which Σ (x - mean)² / (n - d)² of the rest is least. By itself it is blind to
//! a signal that is quiet nearly to its end, and a single excursion weighs as much as a transient;
//! [`steady_start`] says what is done about either.

use crate::blocking::{Estimator, Run, correlation_time};

/// Values in a batch.
const BATCH: usize = 5;

/// Fewest values that say anything about a transient.
const FEWEST_VALUES: usize = 100;

/// Parts into which the presumed steady signal is cut to compare its end with the rest.
const PARTS: usize = 10;

/// How far the last part may lie from the median of the others, in their median deviations.
///
/// The nine others of a correlated signal may lie close together by chance: a steady signal of
/// fifteen correlation times was seen at eight of their median deviations. Growth out of a quiet
/// state, which this is for, gives dozens.
const APART: f64 = 10.0;

/// Largest difference between the halves of a steady signal, in its standard errors.
const DRIFT: f64 = 4.0;

/// A later start must halve the marginal error at least to count against one in the first half: a
/// single slow swing does less.
const BETTER: f64 = 0.5;

/// Excursions are clipped this many interquartile ranges beyond the quartiles.
const CLIP: f64 = 3.0;

/// What a signal says about when the steady state began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Onset {
    /// Steady from this time on, in the unit of the times given.
    Steady(f64),
    /// The transient takes more than the first half, or the end differs from what precedes it:
    /// run longer.
    NotSteady,
    /// Fewer than 100 values: no judgement.
    TooShort,
}

impl Onset {
    /// What several signals say together: the latest start, and no start unless each has one.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Onset::TooShort, _) | (_, Onset::TooShort) => Onset::TooShort,
            (Onset::NotSteady, _) | (_, Onset::NotSteady) => Onset::NotSteady,
            (Onset::Steady(a), Onset::Steady(b)) => Onset::Steady(a.max(b)),
        }
    }
}

/// When the signal `values`, sampled at the ascending `times`, became steady.
///
/// The marginal standard error of batch means is minimised over starts in the first half.
/// Excursions are clipped three interquartile ranges beyond the quartiles of the second half, so
/// that rare bursts do not pass for a transient. The answer is [`Onset::NotSteady`] if
///
/// - the best start is the middle, or a later one would be twice as good;
/// - the halves of what is left differ by more than four standard errors (Geweke's test, with the
///   measured correlation time);
/// - its last tenth stands apart from the other tenths, as it does while a disturbance is still
///   growing out of a long quiet state.
///
/// A constant signal is steady from the start.
///
/// A signal that has the same value before and after the onset, such as a slip may have, cannot tell
/// the uniform state from the steady one: join it by [`Onset::and`] with one that can, such as the
/// variance of the solids fraction.
///
/// # Panics
/// If there is not one time per value.
pub fn steady_start(times: &[f64], values: &[f64]) -> Onset {
    assert_eq!(times.len(), values.len(), "one time per value");
    if values.len() < FEWEST_VALUES {
        return Onset::TooShort;
    }
    // The batches end with the last value; up to four values at the front are left over.
    let lead = values.len() % BATCH;
    let clipped = clip(&values[lead..]);
    let batches: Vec<f64> =
        clipped.chunks_exact(BATCH).map(|batch| batch.iter().sum::<f64>() / BATCH as f64).collect();
    let half = batches.len() / 2;
    let (start, error) = least_marginal_error(&batches, half);
    let (_, later) = least_marginal_error(&batches, 9 * batches.len() / 10);
    let rest = &batches[start..];
    if start == half || later < BETTER * error || drifts(rest) || end_stands_apart(rest) {
        return Onset::NotSteady;
    }
    // Nothing is gained by dropping the left-over values alone.
    Onset::Steady(times[if start == 0 { 0 } else { lead + start * BATCH }])
}

/// The number of leading values to drop, at most `most`, for the least marginal standard error of
/// the rest, and the square of that error. Of equal errors the earliest start wins.
fn least_marginal_error(values: &[f64], most: usize) -> (usize, f64) {
    // About a value of the steady part, so that the sums of squares lose little to round-off.
    let origin = quantile(&sorted(&values[values.len() / 2..]), 0.5);
    let (mut sum, mut squares, mut best) = (0.0, 0.0, (0, f64::INFINITY));
    for (start, value) in values.iter().enumerate().rev() {
        let (value, left) = (value - origin, (values.len() - start) as f64);
        sum += value;
        squares += value * value;
        let error = (squares - sum * sum / left).max(0.0) / (left * left);
        if start <= most && error <= best.1 {
            best = (start, error);
        }
    }
    best
}

/// Whether the means of the two halves differ by more than [`DRIFT`] standard errors.
fn drifts(values: &[f64]) -> bool {
    let (first, second) = values.split_at(values.len() / 2);
    let moments = |values: &[f64]| {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n;
        (mean, 2.0 * correlation_time(&[values.to_vec()]) * variance / n)
    };
    let ((a, a_error), (b, b_error)) = (moments(first), moments(second));
    // Round-off in the means of a constant signal is not a change.
    (a - b).abs() > DRIFT * (a_error + b_error).sqrt() + 1e-12 * (a.abs() + b.abs())
}

/// Whether the mean of the last of [`PARTS`] equal parts lies apart from those of the others.
fn end_stands_apart(values: &[f64]) -> bool {
    let part = values.len() / PARTS;
    let means: Vec<f64> = values
        .rchunks_exact(part.max(1))
        .take(PARTS)
        .map(|part| part.iter().sum::<f64>() / part.len() as f64)
        .collect();
    let others = sorted(&means[1..]);
    let median = quantile(&others, 0.5);
    let deviations: Vec<f64> = others.iter().map(|mean| (mean - median).abs()).collect();
    let spread = quantile(&sorted(&deviations), 0.5);
    // Round-off in the means of a constant signal is not a change.
    let round_off = 1e-12 * means.iter().fold(0.0, |most: f64, mean| most.max(mean.abs()));
    (means[0] - median).abs() > APART * spread + round_off
}

/// The values, clipped [`CLIP`] interquartile ranges beyond the quartiles of the second half. No
/// clipping if that half is mostly constant.
fn clip(values: &[f64]) -> Vec<f64> {
    let half = sorted(&values[values.len() / 2..]);
    let (lower, upper) = (quantile(&half, 0.25), quantile(&half, 0.75));
    let margin = if upper > lower { CLIP * (upper - lower) } else { f64::INFINITY };
    values.iter().map(|value| value.max(lower - margin).min(upper + margin)).collect()
}

/// Statistics of a correlated signal, sampled at equal intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeriesStatistics {
    /// Mean.
    pub mean: f64,
    /// Standard error of the mean, as in [`crate::blocking`]; infinite for fewer than eight values.
    pub standard_error: f64,
    /// Half the width of the mean's 95 % interval.
    pub half_width_95: f64,
    /// Lower quartile.
    pub lower_quartile: f64,
    /// Median.
    pub median: f64,
    /// Upper quartile.
    pub upper_quartile: f64,
    /// Integral correlation time ∫₀^∞ ρ(t) dt in sampling intervals, at least 1/2, which stands
    /// for independent values. Values two of these times apart count as independent.
    pub correlation_intervals: f64,
}

/// Statistics of `values`, a steady signal sampled at equal intervals; `None` without values.
pub fn mean_with_error(values: &[f64]) -> Option<SeriesStatistics> {
    if values.is_empty() {
        return None;
    }
    let run = Run::in_time(values.iter().map(|&value| [value, 1.0]).collect());
    let found = Estimator::default().estimate(&[run]);
    let sorted = sorted(values);
    Some(SeriesStatistics {
        mean: found.ratio,
        standard_error: found.standard_error,
        half_width_95: found.half_width_95(),
        lower_quartile: quantile(&sorted, 0.25),
        median: quantile(&sorted, 0.5),
        upper_quartile: quantile(&sorted, 0.75),
        correlation_intervals: found.correlation_time,
    })
}

fn sorted(values: &[f64]) -> Vec<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted
}

/// The `share` quantile of ascending values, linear between neighbours.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let below = place as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (place - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocking::tests::OrnsteinUhlenbeck;

    const LEN: usize = 2000;

    fn times() -> Vec<f64> {
        (0..LEN).map(|i| 0.01 * i as f64).collect()
    }

    /// Quiet, exponential growth from `quiet` values on, overshoot, then fluctuations about 1 with
    /// excursions: the exponential of a normal signal. Steady about 300 values after `quiet`.
    fn fluidised(quiet: usize, seed: u64) -> Vec<f64> {
        let mut signal = OrnsteinUhlenbeck::new(10.0, seed);
        let saturation = 150.0;
        (0..LEN)
            .map(|i| {
                let since = i as f64 - quiet as f64;
                let grown = (0.08 * (since - saturation)).exp().min(1.0);
                let overshoot = if since > saturation {
                    3.0 * (-(since - saturation) / 40.0).exp()
                } else {
                    3.0
                };
                grown * ((0.5 * signal.next()).exp() + overshoot)
            })
            .collect()
    }

    #[test]
    fn the_transient_of_a_fluidised_box_is_dropped() {
        let (mut steady, replicas) = (0, 200);
        for seed in 0..replicas {
            match steady_start(&times(), &fluidised(400, seed)) {
                Onset::Steady(start) => {
                    assert!((5.3..=10.0).contains(&start), "seed {seed}: {start}");
                    steady += 1;
                }
                onset => assert_eq!(onset, Onset::NotSteady),
            }
        }
        assert!(steady as f64 > 0.85 * replicas as f64, "{steady}");
    }

    #[test]
    fn a_transient_that_lasts_too_long_is_not_steady() {
        for quiet in [1000, 1300, 1600, 1750, 1800, 1850, 1900, 5000] {
            for seed in 0..20 {
                let onset = steady_start(&times(), &fluidised(quiet, seed));
                assert_eq!(onset, Onset::NotSteady, "{quiet} {seed}");
            }
        }
    }

    #[test]
    fn a_steady_signal_keeps_most_of_itself() {
        let (mut unsteady, mut kept, replicas) = (0, 0.0, 500);
        for seed in 0..replicas {
            let mut signal = OrnsteinUhlenbeck::new(10.0, seed);
            let values: Vec<f64> = (0..LEN).map(|_| (0.5 * signal.next()).exp()).collect();
            match steady_start(&times(), &values) {
                Onset::Steady(start) => kept += 1.0 - start / 20.0,
                _ => unsteady += 1,
            }
        }
        assert!(unsteady * 10 < replicas, "{unsteady}");
        assert!(kept / (replicas - unsteady) as f64 > 0.8);
    }

    #[test]
    fn simple_signals_have_simple_onsets() {
        assert_eq!(steady_start(&times(), &vec![0.3; LEN]), Onset::Steady(0.0));
        assert_eq!(steady_start(&times()[..99], &[0.3; 99]), Onset::TooShort);
        let ramp = times();
        assert_eq!(steady_start(&times(), &ramp), Onset::NotSteady);
        // Alternating noise after a step at value 500: the start is found exactly.
        let step: Vec<f64> = (0..LEN).map(|i| if i < 500 { 5.0 } else { (i % 2) as f64 }).collect();
        assert_eq!(steady_start(&times(), &step), Onset::Steady(5.0));
    }

    #[test]
    fn several_signals_start_with_the_latest() {
        let (early, late) = (Onset::Steady(1.0), Onset::Steady(2.0));
        assert_eq!(early.and(late), late);
        assert_eq!(late.and(Onset::NotSteady), Onset::NotSteady);
        assert_eq!(Onset::NotSteady.and(Onset::TooShort), Onset::TooShort);
    }

    #[test]
    fn the_mean_of_a_correlated_signal_has_an_honest_error() {
        let (mut covered, mut naive, mut time, replicas) = (0, 0, 0.0, 1000);
        for seed in 0..replicas {
            let mut signal = OrnsteinUhlenbeck::new(8.0, seed);
            let values: Vec<f64> = (0..LEN).map(|_| signal.next()).collect();
            let found = mean_with_error(&values).unwrap();
            covered += usize::from(found.mean.abs() < found.half_width_95);
            naive += usize::from(found.mean.abs() < 1.96 / (LEN as f64).sqrt());
            time += found.correlation_intervals / replicas as f64;
        }
        let [covered, naive] = [covered, naive].map(|count| count as f64 / replicas as f64);
        assert!((0.93..0.98).contains(&covered), "{covered}");
        assert!(naive < 0.5, "independent errors cover {naive}");
        assert!((time / 8.0 - 1.0).abs() < 0.05, "{time}");
    }

    #[test]
    fn quartiles_are_those_of_the_values() {
        let found = mean_with_error(&[5.0, 1.0, 2.0, 4.0, 3.0]).unwrap();
        assert_eq!((found.lower_quartile, found.median, found.upper_quartile), (2.0, 3.0, 4.0));
        assert_eq!((found.mean, found.standard_error), (3.0, f64::INFINITY));
        assert_eq!(mean_with_error(&[]), None);
        assert_eq!(mean_with_error(&[2.0; 50]).unwrap().correlation_intervals, 0.5);
    }
}
