//! [`run`]: from a case to the files of a run.

use std::fmt;
use std::io::Write;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::case::Case;
use crate::output::{Output, OutputError, RUN_FILE};

/// How to run, as opposed to what.
#[derive(Clone, Copy, Debug)]
pub struct RunOptions {
    /// Threads to use; 0 for one per core.
    pub threads: usize,
    /// Whether to be silent about progress.
    pub quiet: bool,
}

/// Why a run did not end.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// It was asked to stop.
    #[error("interrupted after {done:.4} s of {of:.4} s simulated: no tables were written")]
    Interrupted {
        /// Simulated time of all boxes until then \[s\].
        done: f64,
        /// Simulated time asked for, of all boxes \[s\].
        of: f64,
    },
    /// Its files cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

/// What a run found, in brief.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Summary {
    /// The case's name.
    pub case: String,
    /// Simulated time of all boxes \[s\].
    pub simulated: f64,
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {:.4} s simulated", self.case, self.simulated)
    }
}

/// Runs `case` and fills `output`, which the caller commits. Ends early once `stop` is set.
///
/// # Errors
/// `stop` was set, or a file cannot be written.
pub fn run(
    case: &Case,
    output: &mut Output,
    _options: &RunOptions,
    stop: &AtomicBool,
) -> Result<Summary, RunError> {
    let of = case.run.duration * case.domain.solids_fractions.len() as f64;
    let samples = (of / case.run.sample_interval).round() as usize;
    for sample in 0..samples {
        if stop.load(Ordering::Relaxed) {
            return Err(RunError::Interrupted {
                done: sample as f64 * case.run.sample_interval,
                of,
            });
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    let summary = Summary { case: case.name.clone(), simulated: of };
    output.write("case.toml", |file| file.write_all(case.to_toml().as_bytes()))?;
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, &summary)?))?;
    Ok(summary)
}
