//! `favre fit` and `favre exponents`.

use super::{Failure, cli, print, print_json, say, write};
use favre::exponents::{Collapse, PowerLaw, collapse, power_law};
use favre::forms::{FORMS, UserForm, form};
use favre::output::Output;
use favre::pipeline;
use favre::pool::Pool;
use favre::refit::{Candidate, Shape, refit};
use favre::table::BinRow;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Seed of the replicates: the same runs give the same intervals.
const SEED: u64 = 1;

/// Quantities whose growth with the filter is fitted.
const STRESSES: [&str; 2] = ["solids_viscosity", "solids_pressure"];

/// Quantities whose reference length is asked for.
const SCALED: [&str; 2] = ["slip", "drag_correction"];

/// The shape of a name, or of a user's file.
fn shape(name: &str) -> Result<Shape, Failure> {
    if name == "spline" {
        return Ok(Shape::Spline);
    }
    if let Some(form) = form(name) {
        return Ok(Shape::Form(form));
    }
    let path = Path::new(name);
    if !path.is_file() {
        let known = FORMS.map(|form| form.name()).join(", ");
        let message = format!("there is no form {name}, and no such file; known: spline, {known}");
        return Err(Failure::misuse(message));
    }
    let text = std::fs::read_to_string(path)
        .map_err(|error| Failure::misuse(format!("{name}: {error}")))?;
    let form =
        UserForm::parse(&text).map_err(|error| Failure::misuse(format!("{name}: {error}")))?;
    Ok(Shape::Form(form))
}

/// `favre fit`.
pub fn fit(args: &cli::Fit) -> Result<(), Failure> {
    let shapes: Vec<Shape> =
        args.form.iter().map(|name| shape(name)).collect::<Result<_, Failure>>()?;
    let pool = Pool::read(&args.paths, None).map_err(Failure::misuse)?;
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/fit"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    let scales = pool.file.system.scales();
    let count = usize::from(args.replicates);
    let found = refit(&pool.file.runs, &shapes, &scales, count, SEED).map_err(Failure::misuse)?;
    pipeline::fitted(&pool, &found, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: the closure is in {}", dir.display()));
    if args.json {
        return print_json(&found);
    }
    let mut text = format!("form             quantity{:17}bins       R² left out\n", "");
    for candidate in &found {
        text += &format!("{candidate}\n");
    }
    text += &preferences(&found);
    write(text)
}

/// Which shape was taken for each quantity.
fn preferences(found: &[Candidate]) -> String {
    let mut quantities: Vec<&str> = found.iter().map(|candidate| candidate.quantity).collect();
    quantities.dedup();
    let preferred = quantities.iter().filter_map(|quantity| {
        let taken = favre::refit::preferred(found, quantity)?;
        Some(format!("{quantity}: {} is the closure\n", taken.name))
    });
    preferred.collect()
}

/// What `favre exponents` finds.
#[derive(Serialize)]
struct Found {
    collapses: Vec<Collapse>,
    power_laws: Vec<(PathBuf, PowerLaw)>,
    unanswered: Vec<String>,
}

impl std::fmt::Display for Found {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let collapses = self.collapses.iter().map(ToString::to_string);
        let laws = self.power_laws.iter().map(|(path, law)| format!("{}: {law}", path.display()));
        let lines: Vec<String> = collapses.chain(laws).chain(self.unanswered.clone()).collect();
        f.write_str(&lines.join("\n"))
    }
}

/// `favre exponents`.
pub fn exponents(args: &cli::Exponents) -> Result<(), Failure> {
    let mut runs: Vec<(f64, Vec<BinRow>)> = Vec::new();
    let mut found = Found { collapses: Vec::new(), power_laws: Vec::new(), unanswered: Vec::new() };
    for path in &args.paths {
        let pool = Pool::read(std::slice::from_ref(path), None).map_err(Failure::misuse)?;
        for quantity in STRESSES {
            match power_law(&pool.bins, quantity) {
                Ok(law) => found.power_laws.push((path.clone(), law)),
                Err(error) => found.unanswered.push(format!("{}: {error}", path.display())),
            }
        }
        runs.push((pool.file.system.scales().froude, pool.bins));
    }
    let runs: Vec<(f64, &[BinRow])> =
        runs.iter().map(|(froude, rows)| (*froude, &rows[..])).collect();
    for quantity in SCALED {
        match collapse(&runs, quantity) {
            Ok(collapse) => found.collapses.push(collapse),
            Err(error) => found.unanswered.push(error.to_string()),
        }
    }
    if args.json { print_json(&found) } else { print(&found) }
}
