//! What the parts of a step cost, for those who ask.

use std::time::Instant;

/// The parts of a step, in its order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stage {
    Sweep,
    Pressure,
    Correction,
}

/// Names of the parts of a step, in its order: the sweep from fluxes to forces; the pressure equation;
/// the correction by it and the choice of the next step.
pub const STAGES: [&str; 3] = ["sweep", "pressure", "correction"];

/// A stop-watch that is passed from one part of a step to the next.
pub(super) struct Clock {
    last: Instant,
    /// For each of [`STAGES`] \[s\].
    pub(super) seconds: [f64; STAGES.len()],
}

impl Clock {
    pub(super) fn new() -> Self {
        Self { last: Instant::now(), seconds: [0.0; STAGES.len()] }
    }

    /// A step begins.
    pub(super) fn start(clock: &mut Option<Self>) {
        if let Some(clock) = clock {
            clock.last = Instant::now();
        }
    }

    /// `stage` is done.
    pub(super) fn lap(clock: &mut Option<Self>, stage: Stage) {
        if let Some(clock) = clock {
            let now = Instant::now();
            clock.seconds[stage as usize] += (now - clock.last).as_secs_f64();
            clock.last = now;
        }
    }
}
