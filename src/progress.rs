//! [`Progress`]: what a running box shows on standard error.

use crate::series::mean_with_error;
use crate::simulate::{Pace, Signals};
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

/// Plain lines, where there is no terminal, come no more often than this.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Half of the 95 % interval of the slip, over the slip, that a run is taken to be for: when it will be
/// that narrow is shown.
const TARGET: f64 = 0.05;

/// Standard errors in half of a 95 % interval.
const HALF_INTERVAL: f64 = 1.96;

/// The simulated time at which a mean is known to [`TARGET`] that at `time` has the relative standard error
/// `error`, which shrinks as one over the root of the time.
fn known_at(time: f64, error: f64) -> f64 {
    time * (HALF_INTERVAL * error / TARGET).powi(2)
}

/// Seconds as one would say them.
fn spoken(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{s:.0} s"),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s if s < 172_800.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

/// Progress of all boxes of a run: a bar each on a terminal, else a line now and then.
pub struct Progress {
    bars: MultiProgress,
    /// Terminal velocity, which slips are shown in \[m/s\].
    terminal_velocity: f64,
    quiet: bool,
    lines: bool,
}

/// Progress of one box.
pub struct BoxProgress {
    bar: ProgressBar,
    label: String,
    terminal_velocity: f64,
    duration: f64,
    begin: Instant,
    /// Simulated time when it was first looked at, and how long after the beginning.
    first: Option<(f64, Duration)>,
    /// When the last plain line was written, if plain lines are.
    last_line: Option<Instant>,
}

impl Progress {
    /// Shows nothing if `quiet`.
    pub fn new(quiet: bool, terminal_velocity: f64) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let target = if quiet || !terminal {
            ProgressDrawTarget::hidden()
        } else {
            ProgressDrawTarget::stderr_with_hz(5)
        };
        let bars = MultiProgress::with_draw_target(target);
        Self { bars, terminal_velocity, quiet, lines: !quiet && !terminal }
    }

    /// Starts the box of `solids_fraction`, which will simulate `duration` \[s\].
    pub fn start(&self, solids_fraction: f64, duration: f64) -> BoxProgress {
        let bar = self.bars.add(ProgressBar::new(1000));
        // A bad template is a mistake of ours that the first run shows.
        if let Ok(style) = ProgressStyle::with_template("{prefix} {bar:24} {msg} ({eta} left)") {
            bar.set_style(style.progress_chars("━╸ "));
        }
        let label = format!("⟨φ⟩ = {solids_fraction:<5}");
        bar.set_prefix(label.clone());
        let begin = Instant::now();
        BoxProgress {
            bar,
            label,
            terminal_velocity: self.terminal_velocity,
            duration,
            begin,
            first: None,
            last_line: self.lines.then_some(begin),
        }
    }

    /// Says one line of `message`, above the bars.
    pub fn say(&self, message: &str) {
        if self.lines {
            let _ = writeln!(std::io::stderr(), "favre: {message}");
        } else if !self.quiet {
            let _ = self.bars.println(format!("favre: {message}"));
        }
    }
}

impl BoxProgress {
    /// Shows where the box is.
    pub fn update(&mut self, signals: &Signals, pace: Pace) {
        let time = signals.time.last().copied().unwrap_or_default();
        let (from, after) = *self.first.get_or_insert((time, self.begin.elapsed()));
        self.bar.set_position((1000.0 * time / self.duration) as u64);
        let due = match self.last_line {
            None => !self.bar.is_hidden(),
            Some(last) => last.elapsed() >= LINE_INTERVAL,
        };
        if !due {
            return;
        }
        let rate = pace.steps as f64 / self.begin.elapsed().as_secs_f64().max(1e-9);
        let step = pace.last.map_or(String::new(), |step| {
            format!(" of {:.1e} s (limited by {})", step.dt, step.limit)
        });
        let text = format!(
            "t = {time:.3} of {:.3} s, {rate:.0} steps/s{step}, slip {}",
            self.duration,
            self.slip(signals, time, (self.begin.elapsed() - after).as_secs_f64() / (time - from))
        );
        if self.last_line.is_some() {
            let _ = writeln!(std::io::stderr(), "favre: {}: {text}", self.label.trim_end());
            self.last_line = Some(Instant::now());
        } else {
            self.bar.set_message(text);
        }
    }

    /// Slip over u_t with its present error, from the second half of what there is: a choice that
    /// needs no decision about the start until the run is over. With it when that error will be small,
    /// as things are at `time` \[s\] and at so many seconds per simulated one.
    fn slip(&self, signals: &Signals, time: f64, pace: f64) -> String {
        let half = &signals.slip[signals.slip.len() / 2..];
        match mean_with_error(half) {
            Some(slip) if slip.standard_error.is_finite() => {
                let known = known_at(time, slip.standard_error / slip.mean.abs());
                let left = pace * (known - time);
                let percent = 100.0 * TARGET;
                let when = if known <= time {
                    format!("; ± {percent} %")
                } else if left.is_finite() {
                    format!("; ± {percent} % at {known:.1} s, in {}", spoken(left))
                } else {
                    String::new()
                };
                format!(
                    "{:.3} ± {:.3} u_t{when}",
                    slip.mean / self.terminal_velocity,
                    slip.standard_error / self.terminal_velocity
                )
            }
            Some(slip) => format!("{:.3} u_t", slip.mean / self.terminal_velocity),
            None => String::from("-"),
        }
    }

    /// Takes the bar away; the summary says the rest.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twice_the_error_takes_four_times_as_long() {
        let known = 0.05 / 1.96;
        assert!((known_at(3.0, known) - 3.0).abs() < 1e-12);
        assert!((known_at(3.0, 2.0 * known) - 12.0).abs() < 1e-12);
        let said = [20.0, 600.0, 36_000.0, 864_000.0].map(spoken);
        assert_eq!(said, ["20 s", "10 min", "10.0 h", "10 days"]);
    }
}
