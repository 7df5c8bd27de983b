//! Ctrl-C and its kin: the first asks the run to end, the second ends it.

use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// Exit status of an interrupted run.
pub const INTERRUPTED: u8 = 130;

/// Signals this close together are one: `timeout` and batch systems signal both the process and its
/// group.
const TOGETHER: Duration = Duration::from_millis(500);

/// What the signal handler and the run share.
#[derive(Clone, Default)]
pub struct Interrupt {
    /// Set by the first signal; the run polls it.
    pub stop: Arc<AtomicBool>,
    /// The run's partial folder, which the second signal removes.
    pub partial: Arc<OnceLock<PathBuf>>,
}

impl Interrupt {
    /// Installs the handler for SIGINT, SIGTERM and SIGHUP.
    ///
    /// A signal that the parent had set to be ignored, as `nohup` does with SIGHUP, stays ignored:
    /// then no handler is installed at all, and a signal that is not ignored ends the program at
    /// once. That leaves a partial folder, which the next run to the same folder clears.
    pub fn install() -> Self {
        let interrupt = Self::default();
        let shared = interrupt.clone();
        let mut first: Option<Instant> = None;
        let _ = ctrlc::try_set_handler(move || {
            shared.stop.store(true, Ordering::Relaxed);
            if first.is_some_and(|first| first.elapsed() < TOGETHER) {
                return;
            }
            if first.is_none() {
                first = Some(Instant::now());
                let message = "favre: ending the run; nothing will be left half-written (once more \
                               to end at once)";
                let _ = writeln!(io::stderr(), "{message}");
            } else {
                if let Some(partial) = shared.partial.get() {
                    let _ = fs::remove_dir_all(partial);
                }
                process::exit(INTERRUPTED.into());
            }
        });
        interrupt
    }
}
