//! `favre fit` and `favre exponents`.

use super::{Failure, cli, print, print_json, say, write};
use favre::exponents::{Collapse, PowerLaw, collapse, power_law};
use favre::forms::{FORMS, FormulaForm, form};
use favre::output::Output;
use favre::pipeline;
use favre::pool::Pool;
use favre::refit::{Bins, Candidate, Shape, refit};
use favre::sums::SumsFile;
use favre::table::{BinRow, read_bins};
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
        FormulaForm::parse(&text).map_err(|error| Failure::misuse(format!("{name}: {error}")))?;
    Ok(Shape::Form(form))
}

/// Whether a path is of a bin table and not of a run.
fn is_table(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "csv")
}

/// `favre fit`.
pub fn fit(args: &cli::Fit) -> Result<(), Failure> {
    let shapes: Vec<Shape> =
        args.form.iter().map(|name| shape(name)).collect::<Result<_, Failure>>()?;
    let count = usize::from(args.replicates);
    let (bins, system, name) = if args.paths.iter().all(|path| is_table(path)) {
        let tables: Vec<Vec<BinRow>> = args
            .paths
            .iter()
            .map(|path| read_bins(path))
            .collect::<Result<_, _>>()
            .map_err(Failure::misuse)?;
        (Bins::of_tables(tables, count, SEED), None, "bins".to_owned())
    } else if let Some(table) = args.paths.iter().find(|path| is_table(path)) {
        let table = table.display();
        let message = format!("{table} is a bin table, and others are runs: give one or the other");
        return Err(Failure::misuse(message));
    } else {
        let file = Pool::read(&args.paths, None).map_err(Failure::misuse)?.file;
        let name = file.runs.first().map_or("fit", |run| run.name.as_str()).to_owned();
        let bins = Bins::of_runs(&file.runs, &file.system.scales(), count, SEED);
        let bins = bins.map_err(Failure::misuse)?.packed(file.system.powder.max_packing);
        (bins, Some(file.system), name)
    };
    let mut found: Vec<Candidate> = Vec::new();
    let mut refused: Vec<String> = Vec::new();
    for shape in shapes {
        match refit(&bins, shape) {
            Ok(candidate) => found.push(candidate),
            Err(why) => refused.push(why.to_string()),
        }
    }
    if found.is_empty() {
        return Err(Failure::misuse(refused.join("; ")));
    }
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/fit"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    pipeline::fitted(&name, system.as_ref(), &found, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: the closure is in {}", dir.display()));
    for why in refused {
        say(format_args!("favre: not fitted: {why}"));
    }
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

/// The bins of a path with replicates, and Fr_p.
fn powder(path: &Path, count: usize) -> Result<(f64, Bins), Failure> {
    if is_table(path) {
        let rows = read_bins(path).map_err(Failure::misuse)?;
        // L_I/L_II = Fr_p^(2/3).
        let froude = rows
            .first()
            .map_or(f64::NAN, |row| (row.filter_width_l_ii / row.filter_width_l_i).powf(1.5));
        return Ok((froude, Bins::of_tables(vec![rows], count, SEED)));
    }
    let file = SumsFile::read(path).map_err(Failure::misuse)?;
    let scales = file.system.scales();
    let bins = Bins::of_runs(&file.runs, &scales, count, SEED).map_err(Failure::misuse)?;
    Ok((scales.froude, bins))
}

/// `favre exponents`.
pub fn exponents(args: &cli::Exponents) -> Result<(), Failure> {
    let count = usize::from(args.replicates);
    let mut found = Found { collapses: Vec::new(), power_laws: Vec::new(), unanswered: Vec::new() };
    let mut powders: Vec<(f64, Bins)> = Vec::new();
    for path in &args.paths {
        let (froude, bins) = powder(path, count)?;
        for quantity in STRESSES {
            let again = (0..count).filter_map(|k| power_law(bins.replicate(k), quantity).ok());
            match power_law(&bins.rows, quantity) {
                Ok(law) => {
                    let law = law.widened(&again.collect::<Vec<PowerLaw>>());
                    found.power_laws.push((path.clone(), law));
                }
                Err(why) => found.unanswered.push(format!("{}: {why}", path.display())),
            }
        }
        powders.push((froude, bins));
    }
    let collapsed = |quantity: &str, rows: &dyn Fn(&'_ Bins) -> Vec<BinRow>| {
        let of = |(froude, bins): &(f64, Bins)| (*froude, rows(bins));
        let tables: Vec<(f64, Vec<BinRow>)> = powders.iter().map(of).collect();
        let tables: Vec<(f64, &[BinRow])> =
            tables.iter().map(|(froude, rows)| (*froude, &rows[..])).collect();
        collapse(&tables, quantity)
    };
    for quantity in SCALED {
        let only = |rows: &[BinRow]| -> Vec<BinRow> {
            rows.iter().filter(|row| row.quantity == quantity).cloned().collect()
        };
        match collapsed(quantity, &|bins| only(&bins.rows)) {
            Ok(one) => {
                let again =
                    (0..count).filter_map(|k| collapsed(quantity, &|b| only(b.replicate(k))).ok());
                found.collapses.push(one.widened(&again.collect::<Vec<Collapse>>()));
            }
            Err(why) => found.unanswered.push(why.to_string()),
        }
    }
    if args.json { print_json(&found) } else { print(&found) }
}
