//! From folders of runs, finished or interrupted, to a report.

use super::RunError;
use crate::case::Case;
use crate::checkpoint::Interrupted;
use crate::laws::scales::Scales;
use crate::output::{Output, RUN_FILE};
use crate::report::{Drawing, Folder, RunFacts, SHOWN, ScalesFacts, Trace, drawings, page};
use crate::statistics::bin_table;
use rayon::prelude::*;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The page of the runs in `paths`, in their order; `command` is what makes it again. A folder that
/// is not there but was to be filled by a run that was interrupted is one too, as far as it went.
///
/// # Errors
/// A path is no folder of a run, or a file in it is damaged.
pub fn report(paths: &[PathBuf], command: &str) -> Result<String, RunError> {
    let folders: Result<Vec<Folder>, RunError> = paths.par_iter().map(|path| read(path)).collect();
    Ok(page(&folders?, command))
}

/// Every figure of the page of one run in `paths`, as SVG and PNG, in `output`, which the caller commits;
/// of several runs with the run's number and name before its own. Those that there are no numbers for are left out.
///
/// # Errors
/// As for [`report`], or a file cannot be written.
pub fn figures(paths: &[PathBuf], output: &Output) -> Result<(), RunError> {
    for (i, path) in paths.iter().enumerate() {
        let folder = read(path)?;
        let before = match paths.len() {
            1 => String::new(),
            // Two runs may have one name.
            _ => format!("{}_{}_", i + 1, folder.name),
        };
        for Drawing { name, chart, .. } in drawings(&folder).iter().filter(|d| !d.chart.is_empty())
        {
            let figure = chart.figure();
            let pixels = figure.png()?;
            output
                .write(&format!("{before}{name}.svg"), |f| f.write_all(figure.svg().as_bytes()))?;
            output.write(&format!("{before}{name}.png"), |f| f.write_all(&pixels))?;
        }
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, paths)?))?;
    Ok(())
}

fn read(path: &Path) -> Result<Folder, RunError> {
    if !path.exists()
        && let Some(run) = Interrupted::read(path)?
    {
        return interrupted(path, run);
    }
    Ok(Folder::read(path)?)
}

/// What an interrupted run knew: its boxes' signals, and the bins of their sums.
fn interrupted(path: &Path, run: Interrupted) -> Result<Folder, RunError> {
    let name = path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let case = Case::parse(&run.case, &name)?;
    let scales = Scales::new(&case.powder, &case.gas, case.physics.gravity);
    let mut missing = vec![
        "the run was interrupted; `favre run` with --resume goes on with it, and what is here is of what \
         it had simulated"
            .into(),
    ];
    for fraction in &case.domain.solids_fractions {
        let kept = run.boxes.iter().find(|(kept, _)| kept == fraction);
        let time = kept.map_or(0.0, |(_, kept)| kept.time);
        if time < case.run.duration {
            let of = case.run.duration;
            missing.push(format!("the box of ⟨φ⟩ = {fraction} reached {time:.3} s of {of:.3} s"));
        }
    }
    let mut all = Vec::new();
    let mut traces = Vec::new();
    for (solids_fraction, kept) in run.boxes {
        let mut sums = kept.sums;
        sums.discard_before(kept.signals.start().0);
        all.push(sums);
        let (times, slip) = (kept.signals.time, kept.signals.slip);
        traces.push(Trace { solids_fraction, times, slip });
    }
    let mut bins = bin_table(&all, &scales)?;
    bins.retain(|row| SHOWN.contains(&&*row.quantity));
    if bins.is_empty() {
        missing.push("there are no bins yet".into());
    }
    Ok(Folder {
        path: path.into(),
        name,
        facts: RunFacts {
            version: Some(env!("CARGO_PKG_VERSION").into()),
            case: toml::from_str(&run.case).ok(),
            scales: Some(ScalesFacts {
                terminal_velocity: scales.terminal_velocity,
                froude: scales.froude,
                length_i: scales.length_i(),
                length_ii: scales.length_ii(),
            }),
            ..RunFacts::default()
        },
        case: Some(run.case),
        bins,
        traces,
        missing,
        ..Folder::default()
    })
}
