//! `favre models`.

use std::fmt::Write as _;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::Path;

use favre::closure::{BUILT_IN, Closure, Quantity, Status};
use favre::compare::{Settings, compare};
use favre::forms::Marker;
use favre::lint::{self, Verdict};
use favre::output::Output;
use favre::pipeline::models::write_comparison;
use favre::table::read_bins;
use serde::Serialize;

use crate::cli::{self, ModelsCommand};
use crate::{Failure, print, print_json, say, write};
use points::{Columns, Lines, PADDING};

mod points;

pub fn models(args: &cli::Models) -> Result<(), Failure> {
    match &args.command {
        ModelsCommand::List { json } => list(*json),
        ModelsCommand::Show { name, all } => show(name, *all),
        ModelsCommand::Eval(args) => eval(args),
        ModelsCommand::Compare(args) => comparison(args),
        ModelsCommand::Check { names, quiet, json } => check(names, *quiet, *json),
    }
}

fn find(name: &str) -> Result<Closure, Failure> {
    Closure::find(name).map_err(Failure::misuse)
}

/// A line of `favre models list`.
#[derive(Serialize)]
struct Listed {
    name: String,
    status: Status,
    title: String,
    quantities: Vec<String>,
}

fn list(json: bool) -> Result<(), Failure> {
    let mut all = Vec::new();
    for (name, _) in BUILT_IN {
        let closure = find(name)?;
        let quantities = closure.quantities.iter().map(|q| q.file.predicts.clone()).collect();
        let (name, status) = (closure.file.name, closure.file.status);
        all.push(Listed { name, status, title: closure.file.title, quantities });
    }
    if json {
        return print_json(&all);
    }
    let mut text = String::new();
    for Listed { name, status, title, .. } in all {
        let status = if status == Status::Full { "full" } else { "partial" };
        let _ = writeln!(text, "{name:27} {status:8} {title}");
    }
    write(text)
}

fn show(name: &str, all: bool) -> Result<(), Failure> {
    let closure = find(name)?;
    let mut file = closure.file.clone();
    if !all {
        file.quantities.iter_mut().for_each(|quantity| quantity.test_vectors.clear());
    }
    let mut text = toml::to_string_pretty(&file).map_err(Failure::failed)?;
    if !all {
        for quantity in &closure.quantities {
            let markers: Vec<String> =
                quantity.markers().map(|marker| marker.to_string()).collect();
            let (name, count) = (&quantity.file.predicts, quantity.file.test_vectors.len());
            let _ =
                write!(text, "\n# {name}: markers {}; {count} test vectors", markers.join(", "));
        }
        text += "\n";
    }
    write(text)
}

/// A row of `favre models eval`.
#[derive(Serialize)]
struct Row {
    markers: Vec<f64>,
    value: f64,
    inside: bool,
}

fn eval(args: &cli::Eval) -> Result<(), Failure> {
    let closure = find(&args.name)?;
    let Some(quantity) = closure.quantity(args.quantity.as_deref()) else {
        let has: Vec<&str> = closure.quantities.iter().map(|q| &*q.file.predicts).collect();
        let message = match (has.is_empty(), &args.quantity) {
            (true, _) => format!(
                "{} has no formula to evaluate: {}",
                closure.file.name,
                closure.file.missing.join(" ")
            ),
            (false, name) => format!(
                "{} does not predict {}; it predicts {}",
                closure.file.name,
                name.as_deref().unwrap_or("it"),
                has.join(", ")
            ),
        };
        return Err(Failure::misuse(message));
    };
    if args.stdin {
        let done = if args.binary { pass_doubles(quantity) } else { pass_text(quantity) };
        return done.map_err(|error| match error.kind() {
            io::ErrorKind::InvalidData => Failure::misuse(error),
            _ => Failure::failed(error),
        });
    }
    let mut points = vec![Vec::new()];
    let given = [
        ("--phi", &args.phi, &[Marker::SolidsFraction][..]),
        ("--filter", &args.filter, &[Marker::FilterWidth]),
        ("--slip", &args.slip, &[Marker::Slip]),
        ("--shear", &args.shear, &[Marker::ShearRate, Marker::GasShearRate]),
        ("--wall", &args.wall, &[Marker::WallDistance]),
        ("--gradient", &args.gradient, &[Marker::PressureGradient]),
    ];
    let of = |marker: Marker| given.iter().find(|(.., markers)| markers.contains(&marker));
    for (option, values, markers) in &given {
        let needed = quantity.markers().any(|marker| markers.contains(&marker));
        let predicts = &quantity.file.predicts;
        if needed == values.is_empty() {
            let verb = if needed { "needs" } else { "does not depend on" };
            let message = format!("{predicts} of {} {verb} {option}", closure.file.name);
            return Err(Failure::misuse(message));
        }
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            return Err(Failure::misuse(format!("{option} {value}: a finite number is needed")));
        }
        if let Some((possible, what)) = possible(markers[0])
            && let Some(value) = values.iter().find(|value| !possible.contains(value))
        {
            return Err(Failure::misuse(format!("{option} {value}: {what}")));
        }
    }
    for marker in quantity.markers() {
        let (_, values, _) = of(marker).expect("every marker has an option");
        points = points
            .iter()
            .flat_map(|point: &Vec<f64>| {
                values.iter().map(move |x| point.iter().copied().chain([*x]).collect())
            })
            .collect();
    }
    let rows: Vec<Row> = points
        .into_iter()
        .map(|markers| Row {
            value: quantity.at(&markers),
            inside: quantity.is_inside(&markers),
            markers,
        })
        .collect();
    if args.json {
        return print_json(&rows);
    }
    let mut text = String::new();
    for marker in quantity.markers() {
        let _ = write!(text, "{marker},");
    }
    let _ = writeln!(text, "{} [{}],inside_range", quantity.file.predicts, quantity.file.unit);
    for Row { markers, value, inside } in rows {
        for marker in markers {
            let _ = write!(text, "{marker},");
        }
        let _ = writeln!(text, "{value},{inside}");
    }
    write(text)
}

/// Bytes that are read together: they, the points in them and the values stay in cache.
const BLOCK: usize = 1 << 17;

/// Evaluates the points.
/// What a marker can be, and how to say so; none if it can be anything.
fn possible(marker: Marker) -> Option<(RangeInclusive<f64>, &'static str)> {
    match marker {
        Marker::SolidsFraction => Some((0.0..=1.0, "a solids fraction is from 0 to 1")),
        Marker::FilterWidth => Some((0.0..=f64::MAX, "a filter width is not negative")),
        Marker::ShearRate | Marker::GasShearRate => {
            Some((0.0..=f64::MAX, "a shear rate is not negative"))
        }
        Marker::WallDistance => Some((0.0..=f64::MAX, "a distance is not negative")),
        Marker::Slip | Marker::PressureGradient => None,
    }
}

fn evaluate(quantity: &Quantity, columns: &Columns, values: &mut Vec<f64>) {
    values.resize(columns.rows(), 0.0);
    quantity.evaluate(&columns.parts(), values);
}

fn pass_doubles(quantity: &Quantity) -> io::Result<()> {
    let count = quantity.markers().count();
    let mut stdin = io::stdin().lock();
    let mut stdout = io::stdout().lock();
    let mut columns = Columns::new(count);
    let (mut values, mut out) = (Vec::new(), Vec::new());
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        (&mut stdin).take((BLOCK / (8 * count) * 8 * count) as u64).read_to_end(&mut bytes)?;
        if bytes.is_empty() {
            return stdout.flush();
        }
        if bytes.len() % (8 * count) != 0 {
            let message = format!("the input ends inside a point of {count} doubles");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        columns.read_doubles(&bytes);
        evaluate(quantity, &columns, &mut values);
        out.clear();
        out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        stdout.write_all(&out)?;
    }
}

fn pass_text(quantity: &Quantity) -> io::Result<()> {
    let markers: Vec<String> = quantity.markers().map(|marker| marker.to_string()).collect();
    let mut stdin = io::stdin().lock();
    let mut stdout = io::stdout().lock();
    let mut columns = Columns::new(markers.len());
    let (mut values, mut lines) = (Vec::new(), Lines::default());
    let mut text = vec![0; BLOCK + PADDING];
    // How much of it is there, and how many lines were before.
    let (mut length, mut number) = (0, 0);
    loop {
        if length + PADDING == text.len() {
            text.resize(2 * text.len(), 0);
        }
        let space = length..text.len() - PADDING;
        let read = match stdin.read(&mut text[space]) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            read => read?,
        };
        let before = length;
        length += read;
        if read == 0 {
            if length == 0 {
                return stdout.flush();
            }
            // The last line may lack its line break.
            text[length] = b'\n';
            length += 1;
        }
        // What follows the last line break is the start of the next line.
        let Some(last) = text[before..length].iter().rposition(|byte| *byte == b'\n') else {
            continue;
        };
        let end = before + last + 1;
        text.resize(text.len().max(end + PADDING), 0);
        columns.read_lines(&text, end, &mut number, &markers)?;
        text.copy_within(end..length, 0);
        length -= end;
        evaluate(quantity, &columns, &mut values);
        stdout.write_all(lines.of(&values))?;
        if read == 0 {
            return stdout.flush();
        }
    }
}

fn comparison(args: &cli::Compare) -> Result<(), Failure> {
    let mut closures = args.names.iter().map(|name| find(name)).collect::<Result<Vec<_>, _>>()?;
    // As they were named: the models of two runs of one case have the same name.
    for (closure, name) in closures.iter_mut().zip(&args.names) {
        closure.file.name.clone_from(name);
    }
    let bins = args.bins.as_deref().map(read_bins).transpose().map_err(Failure::misuse)?;
    if let Some(width) = args.filter.iter().find(|width| !(**width > 0.0 && width.is_finite())) {
        return Err(Failure::misuse(format!("--filter {width}: a positive number is needed")));
    }
    let settings = Settings {
        quantity: args.quantity.clone(),
        filter_widths: args.filter.clone(),
        slip: args.slip,
        shear_rate: args.shear,
    };
    let found = compare(&closures, &settings, bins.as_deref()).map_err(Failure::misuse)?;
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/compare"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    write_comparison(&found, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: table and figures are in {}", dir.display()));
    if args.json { print_json(&found) } else { print(&found) }
}

fn check(names: &[String], quiet: bool, json: bool) -> Result<(), Failure> {
    let all: Vec<String> = BUILT_IN.iter().map(|(name, _)| (*name).to_owned()).collect();
    let names = if names.is_empty() { &all } else { names };
    let mut reports = Vec::new();
    for name in names {
        let mut report = lint::check(&find(name)?);
        if quiet {
            report.findings.retain(|finding| finding.verdict != Verdict::Fine);
        }
        reports.push(report);
    }
    if json {
        print_json(&reports)?;
    } else {
        reports.iter().try_for_each(print)?;
    }
    match reports.iter().map(lint::Report::faults).sum::<usize>() {
        0 => Ok(()),
        1 => Err(Failure::failed("1 fault")),
        faults => Err(Failure::failed(format!("{faults} faults"))),
    }
}
