//! [`Summary`]: what a run found, how sure it is, and what it cost; one screen, or run.json.

use crate::case::Case;
use crate::laws::scales::Scales;
use crate::refit::{Candidate, preferred};
use crate::rows::{Simd, simd_level};
use crate::series::{Onset, SeriesStatistics, mean_with_error};
use crate::simulate::{Cost, Signals, Simulated};
use crate::stability::stability;
use crate::table::BinRow;
use crate::terms::{Term, terms};
use serde::Serialize;
use std::fmt;

/// Slip above which a box is taken to be short-circuited by a gas channel through its periodic
/// boundary \[u_t\], and for how long at a stretch that is worth a word \[u_t/g\].
const CHANNEL_SLIP: f64 = 8.0;
const CHANNEL_TIME: f64 = 20.0;

/// Share of the time in which one is open that is worth a word whatever its stretches.
const CHANNEL_SHARE: f64 = 0.1;

/// A mean and how sure it is.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Measured {
    /// Mean.
    pub mean: f64,
    /// Standard error; infinite (null in JSON) if there is too little to tell.
    pub standard_error: f64,
    /// Median in time.
    pub median: f64,
    /// Lower and upper quartile in time.
    pub quartiles: [f64; 2],
}

/// What one box found.
#[derive(Clone, Debug, Serialize)]
pub struct BoxSummary {
    /// Mean solids fraction.
    pub solids_fraction: f64,
    /// Slip of the uniform state over u_t.
    pub uniform_slip: f64,
    /// Time from which on the statistics were taken \[s\].
    pub start: f64,
    /// Whether the signals had become steady by then.
    pub steady: bool,
    /// Mean slip over u_t.
    pub slip: Measured,
    /// Slip seen by the particles over u_t.
    pub particle_slip: Measured,
    /// Variance of the solids fraction.
    pub solids_fraction_variance: Measured,
    /// Mean gas pressure gradient over the weight; 1 unless the gas flux is kept.
    pub pressure_gradient: Measured,
    /// Longest time for which a gas channel short-circuited the box \[s\].
    pub channel_time: f64,
    /// Share of the time for which one did; its samples are in the means.
    pub channel_share: f64,
    /// The pictures of `film_*.png`.
    pub film: Strip,
    /// What it cost.
    pub cost: Cost,
}

/// Pictures of a box on its way.
#[derive(Clone, Debug, Serialize)]
pub struct Strip {
    /// Width of the filter \[m\].
    pub filter_width: f64,
    /// Times \[s\].
    pub times: Vec<f64>,
}

/// Frames of a film that are shown.
pub const SHOWN_FRAMES: usize = 5;

impl BoxSummary {
    /// Of the signals of `simulated` from `start` on.
    pub fn new(simulated: &Simulated, start: f64, onset: Onset, scales: &Scales) -> Self {
        let signals = &simulated.signals;
        let from = signals.from(start);
        let measure = |values: &[f64], unit: f64| {
            let nothing = Measured {
                mean: f64::NAN,
                standard_error: f64::INFINITY,
                median: f64::NAN,
                quartiles: [f64::NAN; 2],
            };
            let scaled: Vec<f64> = values[from..].iter().map(|value| value / unit).collect();
            mean_with_error(&scaled).map_or(nothing, |s: SeriesStatistics| Measured {
                mean: s.mean,
                standard_error: s.standard_error,
                median: s.median,
                quartiles: [s.lower_quartile, s.upper_quartile],
            })
        };
        let u_t = scales.terminal_velocity;
        let (channel_time, channel_share) = channels(signals, from, u_t);
        Self {
            solids_fraction: simulated.solids_fraction,
            uniform_slip: simulated.uniform_slip / u_t,
            start,
            steady: matches!(onset, Onset::Steady(_)),
            slip: measure(&signals.slip, u_t),
            particle_slip: measure(&signals.particle_slip, u_t),
            solids_fraction_variance: measure(&signals.solids_fraction_variance, 1.0),
            pressure_gradient: measure(&signals.pressure_gradient, 1.0),
            channel_time,
            channel_share,
            film: Strip {
                filter_width: simulated.film.filter_width,
                times: simulated.film.strip(start, SHOWN_FRAMES).iter().map(|f| f.time).collect(),
            },
            cost: simulated.cost,
        }
    }
}

/// Longest time for which a gas channel was open, in samples from `from` on \[s\], and the share of
/// them.
fn channels(signals: &Signals, from: usize, terminal_velocity: f64) -> (f64, f64) {
    let slip = &signals.slip[from..];
    let open = |slip: &f64| *slip > CHANNEL_SLIP * terminal_velocity;
    let interval = signals.time.get(1).copied().unwrap_or_default();
    let longest = slip.split(|slip| !open(slip)).map(<[f64]>::len).max().unwrap_or_default();
    let count = slip.iter().filter(|slip| open(slip)).count();
    (longest as f64 * interval, count as f64 / slip.len().max(1) as f64)
}

/// Where it ran.
#[derive(Clone, Debug, Serialize)]
pub struct Machine {
    /// Operating system.
    pub system: &'static str,
    /// Processor architecture.
    pub architecture: &'static str,
    /// Instruction set of the kernels.
    pub simd: &'static str,
    /// Threads used.
    pub threads: usize,
    /// Seconds of the wall clock, figures not included.
    pub seconds: f64,
}

impl Machine {
    /// This machine, no thread and no time used yet.
    pub fn here() -> Self {
        Self {
            system: std::env::consts::OS,
            architecture: std::env::consts::ARCH,
            simd: match simd_level() {
                Simd::Baseline => "baseline",
                Simd::Avx2 => "AVX2",
                Simd::Avx512 => "AVX-512",
            },
            threads: 0,
            seconds: 0.0,
        }
    }
}

/// The scales of a case, in SI.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ScalesSummary {
    /// u_t \[m/s\].
    pub terminal_velocity: f64,
    /// Fr_p.
    pub froude: f64,
    /// L_I \[m\].
    pub length_i: f64,
    /// L_II \[m\].
    pub length_ii: f64,
}

/// A drag correction found, for the table of the summary.
#[derive(Clone, Copy, Debug, Serialize)]
struct Found {
    filter_width: f64,
    solids_fraction: f64,
    value: f64,
    standard_error: f64,
}

/// What a run found, in brief.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// Version of the program.
    pub version: &'static str,
    /// The case's name.
    pub name: String,
    /// The case, resolved to SI: every key of the case file.
    pub case: serde_json::Value,
    /// Scales of the powder.
    pub scales: ScalesSummary,
    /// What of the equations was modelled, and why.
    pub terms: Vec<Term>,
    /// The boxes.
    pub boxes: Vec<BoxSummary>,
    /// Drag corrections near the boxes' mean fractions.
    drag_corrections: Vec<Found>,
    /// Rows of the bin table.
    pub bins: usize,
    /// Name of the shape that is the closure.
    pub closure: Option<&'static str>,
    /// What was fitted: coefficients with intervals, goodness, score on boxes left out.
    pub candidates: Vec<Candidate>,
    /// What a user must know, one sentence each.
    pub warnings: Vec<String>,
    /// Where it ran and how long.
    pub machine: Machine,
}

impl Summary {
    /// Puts the results of a run together.
    pub fn new(
        case: &Case,
        scales: &Scales,
        boxes: Vec<BoxSummary>,
        bins: &[BinRow],
        candidates: Result<Vec<Candidate>, String>,
        machine: Machine,
    ) -> Self {
        let warnings = warnings(case, scales, &boxes, &candidates);
        let candidates = candidates.unwrap_or_default();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            name: case.name.clone(),
            case: toml::from_str(&case.to_toml()).unwrap_or_default(),
            scales: ScalesSummary {
                terminal_velocity: scales.terminal_velocity,
                froude: scales.froude,
                length_i: scales.length_i(),
                length_ii: scales.length_ii(),
            },
            terms: terms(case),
            drag_corrections: drag_corrections(case, bins),
            boxes,
            bins: bins.len(),
            closure: preferred(&candidates, "drag_correction").map(|taken| taken.name),
            candidates,
            warnings,
            machine,
        }
    }
}

/// For each filter width and box the bin of its mean solids fraction.
fn drag_corrections(case: &Case, bins: &[BinRow]) -> Vec<Found> {
    let mut found = Vec::new();
    for &width in &case.filter.widths {
        for &phi in &case.domain.solids_fractions {
            let row = bins.iter().find(|row| {
                row.quantity == "drag_correction"
                    && row.filter_width == width
                    && (row.solids_fraction_low..row.solids_fraction_high).contains(&phi)
            });
            if let Some(row) = row {
                found.push(Found {
                    filter_width: width,
                    solids_fraction: phi,
                    value: row.value,
                    standard_error: row.standard_error,
                });
            }
        }
    }
    found
}

fn warnings(
    case: &Case,
    scales: &Scales,
    boxes: &[BoxSummary],
    candidates: &Result<Vec<Candidate>, String>,
) -> Vec<String> {
    let mut warnings = Vec::new();
    match stability(case) {
        Ok(found) => warnings.extend(found.grid_warning()),
        Err(error) => warnings.push(error.to_string()),
    }
    for summary in boxes {
        let phi = summary.solids_fraction;
        if !summary.steady {
            warnings.push(format!(
                "⟨φ⟩ = {phi}: not statistically steady within {} s, so the second half was \
                 used; a longer run.duration is needed",
                case.run.duration
            ));
        }
        let long = summary.channel_time > CHANNEL_TIME * scales.time();
        if long || summary.channel_share > CHANNEL_SHARE {
            warnings.push(format!(
                "⟨φ⟩ = {phi}: a gas channel short-circuited the periodic box for {:.2} s at a \
                 stretch and {:.0} % of the time (slip above {CHANNEL_SLIP} u_t), and the means \
                 hold it; a larger or taller box avoids it, or drive = \"gas-flux\" in [physics]",
                summary.channel_time,
                100.0 * summary.channel_share
            ));
        }
    }
    match candidates {
        Ok(found) => {
            let notes = |found: &Candidate| {
                let of = |note: &String| format!("{}: {note}", found.name);
                found.notes.iter().map(of).collect::<Vec<String>>()
            };
            warnings.extend(found.iter().flat_map(notes));
        }
        Err(why) => warnings.push(format!("no closure was fitted: {why}")),
    }
    warnings
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ScalesSummary { terminal_velocity, froude, length_i, length_ii } = self.scales;
        writeln!(
            f,
            "{}: u_t = {terminal_velocity:.4} m/s, Fr_p = {froude:.1}, L_I = {:.3} mm, L_II = \
             {:.4} mm",
            self.name,
            1e3 * length_i,
            1e3 * length_ii
        )?;
        writeln!(f)?;
        writeln!(
            f,
            "  ⟨φ⟩     slip/u_t ± s.e.  median [quartiles]      uniform  seen by particles  \
             steady from"
        )?;
        for found in &self.boxes {
            let slip = &found.slip;
            writeln!(
                f,
                "  {:<6}  {:<15}  {:.2} [{:.2}, {:.2}]       {:.3}    {:<17}  {}",
                found.solids_fraction,
                interval(slip.mean, slip.standard_error),
                slip.median,
                slip.quartiles[0],
                slip.quartiles[1],
                found.uniform_slip,
                interval(found.particle_slip.mean, found.particle_slip.standard_error),
                if found.steady { format!("{:.2} s", found.start) } else { "never".into() },
            )?;
        }
        // A gradient that balances the weight is no result.
        for found in self.boxes.iter().filter(|found| found.pressure_gradient.standard_error > 0.0)
        {
            let gradient = &found.pressure_gradient;
            writeln!(
                f,
                "  {:<6}  mean pressure gradient over the weight {}",
                found.solids_fraction,
                interval(gradient.mean, gradient.standard_error)
            )?;
        }
        writeln!(f)?;
        writeln!(f, "  drag correction H (solvers multiply the drag by 1 - H), ± standard error")?;
        let mut widths: Vec<f64> = self.drag_corrections.iter().map(|h| h.filter_width).collect();
        widths.dedup();
        write!(f, "  Δ_f                     ")?;
        for found in &self.boxes {
            write!(f, "φ = {:<12}", found.solids_fraction)?;
        }
        writeln!(f)?;
        for width in widths {
            write!(f, "  {:<24}", format!("{:.4} m = {:.2} L_I", width, width / length_i))?;
            for found in &self.boxes {
                let h = self.drag_corrections.iter().find(|h| {
                    h.filter_width == width && h.solids_fraction == found.solids_fraction
                });
                let text = h.map_or("-".into(), |h| interval(h.value, h.standard_error));
                write!(f, "{text:<16}")?;
            }
            writeln!(f)?;
        }
        for found in &self.candidates {
            writeln!(f)?;
            writeln!(f, "  {}: {}", found.name, found.fitted.formula())?;
            let coefficients: Vec<String> = found
                .coefficients
                .iter()
                .map(|c| match c.held {
                    true => format!("{} = {:.4} (not fixed)", c.symbol, c.value),
                    false => format!("{} = {}", c.symbol, interval(c.value, c.standard_error)),
                })
                .collect();
            if !coefficients.is_empty() {
                writeln!(f, "  {}", coefficients.join(", "))?;
            }
            let scatter = found.fitted.goodness().extra_scatter;
            write!(
                f,
                "  fitted to {} bins: R² = {:.3}, scatter beyond their errors {scatter:.3}",
                found.points, found.r_squared
            )?;
            if let Some(score) = found.held_out {
                write!(f, "; R² on boxes left out {score:.3}")?;
            }
            let taken = self.closure == Some(found.name);
            writeln!(f, "{}", if taken { ": the closure" } else { "" })?;
        }
        writeln!(f)?;
        for term in &self.terms {
            writeln!(f, "  {term}")?;
        }
        let steps: u64 = self.boxes.iter().map(|b| b.cost.steps).sum();
        let residual = self.boxes.iter().map(|b| b.cost.volume_residual).fold(0.0, f64::max);
        let mass = self.boxes.iter().map(|b| b.cost.mass_change.abs()).fold(0.0, f64::max);
        let momentum = self.boxes.iter().map(|b| b.cost.momentum_change).fold(0.0, f64::max);
        writeln!(
            f,
            "  {:.1} s on {} threads ({}), {steps} steps; solids mass kept to {mass:.0e}, momentum \
             to {momentum:.0e}, volume to {residual:.0e} a step",
            self.machine.seconds, self.machine.threads, self.machine.simd
        )?;
        for warning in &self.warnings {
            writeln!(f, "  warning: {warning}")?;
        }
        Ok(())
    }
}

/// A number and its standard error, two digits of it.
pub fn interval(value: f64, error: f64) -> String {
    if !error.is_finite() {
        return format!("{value:.3} ± ?");
    }
    let digits = if error > 0.0 { (1.0 - error.log10().floor()).clamp(0.0, 6.0) } else { 3.0 };
    let digits = digits as usize;
    format!("{value:.digits$} ± {error:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_show_two_digits_of_their_error() {
        assert_eq!(interval(2.345_67, 0.123), "2.35 ± 0.12");
        assert_eq!(interval(0.5, 0.0012), "0.5000 ± 0.0012");
        assert_eq!(interval(12.3, 4.0), "12.3 ± 4.0");
        assert_eq!(interval(1.0, f64::INFINITY), "1.000 ± ?");
    }

    #[test]
    fn time_in_a_gas_channel_is_found() {
        let scales = crate::case::Case::parse(crate::case::DEFAULT, "default").unwrap().scales();
        let u_t = scales.terminal_velocity;
        let mut signals = Signals::default();
        for n in 0..40 {
            signals.time.push(0.01 * f64::from(n));
            let open = (10..14).contains(&n) || (20..26).contains(&n);
            signals.slip.push(if open { 9.0 } else { 2.0 } * u_t);
            signals.particle_slip.push(u_t);
            signals.solids_fraction_variance.push(0.01);
            signals.pressure_gradient.push(1.0);
        }
        let found = |start: f64| {
            let (longest, share) = channels(&signals, signals.from(start), u_t);
            ((100.0 * longest).round(), share)
        };
        assert_eq!(found(0.0), (6.0, 0.25));
        assert_eq!(found(0.2), (6.0, 0.3));
        assert_eq!(found(0.3), (0.0, 0.0));
    }
}
