//! From folders of runs, finished or interrupted, to a report.

use super::RunError;
use crate::case::Case;
use crate::checkpoint::Interrupted;
use crate::figure::film_figure;
use crate::laws::scales::Scales;
use crate::output::{Output, RUN_FILE};
use crate::report::{
    Drawing, Folder, RunFacts, SHOWN, ScalesFacts, Trace, drawings, drawings_together, page,
};
use crate::statistics::bin_table;
use crate::summary::SHOWN_FRAMES;
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
/// of several runs those of each with the run's number and name before its own, and those of all together.
/// Those that there are no numbers for are left out.
///
/// # Errors
/// As for [`report`], or a file cannot be written.
pub fn figures(paths: &[PathBuf], output: &Output) -> Result<(), RunError> {
    let folders = paths.iter().map(|path| read(path)).collect::<Result<Vec<_>, _>>()?;
    for (i, folder) in folders.iter().enumerate() {
        let before = match paths.len() {
            1 => String::new(),
            // Two runs may have one name.
            _ => format!("{}_{}_", i + 1, folder.name),
        };
        draw(&drawings(folder), &before, output)?;
    }
    if folders.len() > 1 {
        draw(&drawings_together(&folders), "", output)?;
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, paths)?))?;
    Ok(())
}

/// Writes drawings, with `before` before their names.
fn draw(drawings: &[Drawing], before: &str, output: &Output) -> Result<(), RunError> {
    for Drawing { name, chart, .. } in drawings.iter().filter(|d| !d.chart.is_empty()) {
        let figure = chart.figure();
        let pixels = figure.png()?;
        output.write(&format!("{before}{name}.svg"), |f| f.write_all(figure.svg().as_bytes()))?;
        output.write(&format!("{before}{name}.png"), |f| f.write_all(&pixels))?;
    }
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
    let (mut traces, mut films) = (Vec::new(), Vec::new());
    for (solids_fraction, kept) in run.boxes {
        let mut sums = kept.sums;
        let (start, _) = kept.signals.start();
        sums.discard_before(start);
        all.push(sums);
        let last = case.domain.size.len() - 1;
        let size = [case.domain.size[0], case.domain.size[last]];
        let frames = kept.film.strip(start, SHOWN_FRAMES);
        if !frames.is_empty() {
            let strip = film_figure(&kept.film, &frames, size).png()?;
            films.push((format!("film_{solids_fraction}.png"), strip));
        }
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
        films,
        missing,
        ..Folder::default()
    })
}
