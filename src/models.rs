//! `favre models`.

use std::fmt::Write as _;
use std::io::{self, Read, Write};
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

/// Points that are read, evaluated and written together.
const BATCH: usize = 1 << 16;

/// Evaluates the columns and empties them.
fn batch(quantity: &Quantity, columns: &mut [Vec<f64>], values: &mut Vec<f64>) {
    values.resize(columns[0].len(), 0.0);
    let parts: Vec<&[f64]> = columns.iter().map(|column| &column[..]).collect();
    quantity.evaluate(&parts, values);
    columns.iter_mut().for_each(Vec::clear);
}

fn pass_doubles(quantity: &Quantity) -> io::Result<()> {
    let count = quantity.markers().count();
    let mut stdin = io::stdin().lock();
    let mut stdout = io::stdout().lock();
    let mut bytes = Vec::new();
    let mut columns = vec![Vec::new(); count];
    let (mut values, mut out) = (Vec::new(), Vec::new());
    loop {
        bytes.clear();
        (&mut stdin).take((BATCH * count * 8) as u64).read_to_end(&mut bytes)?;
        if bytes.is_empty() {
            return stdout.flush();
        }
        if bytes.len() % (8 * count) != 0 {
            let message = format!("the input ends inside a point of {count} doubles");
            return Err(io::Error::new(io::ErrorKind::InvalidData, message));
        }
        for point in bytes.chunks_exact(8 * count) {
            for (column, double) in columns.iter_mut().zip(point.chunks_exact(8)) {
                column.push(f64::from_le_bytes(double.try_into().expect("eight bytes")));
            }
        }
        batch(quantity, &mut columns, &mut values);
        out.clear();
        out.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        stdout.write_all(&out)?;
    }
}

fn pass_text(quantity: &Quantity) -> io::Result<()> {
    let count = quantity.markers().count();
    let mut stdin = io::stdin().lock();
    let mut stdout = io::stdout().lock();
    let mut columns = vec![Vec::new(); count];
    let (mut values, mut out) = (Vec::new(), Vec::<u8>::new());
    let mut text: Vec<u8> = Vec::new();
    let mut shortest = zmij::Buffer::new();
    let mut line_number = 0;
    let mut ended = false;
    while !ended {
        let before = text.len();
        (&mut stdin).take(1 << 20).read_to_end(&mut text)?;
        ended = text.len() == before;
        // What follows the last line break is the start of the next line.
        let end = match (ended, text.iter().rposition(|byte| *byte == b'\n')) {
            (true, _) => text.len(),
            (false, Some(at)) => at + 1,
            (false, None) => continue,
        };
        read_points(&text[..end], &mut line_number, quantity, &mut columns)?;
        text.drain(..end);
        if !columns[0].is_empty() {
            batch(quantity, &mut columns, &mut values);
            out.clear();
            for value in &values {
                out.extend_from_slice(shortest.format(*value).as_bytes());
                out.push(b'\n');
            }
            stdout.write_all(&out)?;
        }
    }
    stdout.flush()
}

/// Adds the points of whole lines; a blank line has none. `number` counts the lines before.
fn read_points(
    text: &[u8],
    number: &mut usize,
    quantity: &Quantity,
    columns: &mut [Vec<f64>],
) -> io::Result<()> {
    let bad = |number: usize, why: String| {
        io::Error::new(io::ErrorKind::InvalidData, format!("standard input, line {number}: {why}"))
    };
    let (mut at, mut found) = (0, 0);
    loop {
        let byte = text.get(at).copied();
        match byte {
            Some(b' ' | b',' | b'\t' | b'\r') => at += 1,
            None | Some(b'\n') => {
                *number += usize::from(byte.is_some() || found > 0);
                if found != 0 && found != columns.len() {
                    let markers: Vec<String> = quantity.markers().map(|m| m.to_string()).collect();
                    let markers = markers.join(", ");
                    let why = format!("{found} numbers, and the markers are {markers}");
                    return Err(bad(*number, why));
                }
                if byte.is_none() {
                    return Ok(());
                }
                found = 0;
                at += 1;
            }
            Some(_) => {
                let (value, len) = number_of(&text[at..]);
                let Some(value) = value else {
                    let part = String::from_utf8_lossy(&text[at..at + len]).into_owned();
                    return Err(bad(*number + 1, format!("\"{part}\" is no finite number")));
                };
                if let Some(column) = columns.get_mut(found) {
                    column.push(value);
                }
                found += 1;
                at += len;
            }
        }
    }
}

/// Powers of ten that are doubles exactly.
const TENS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16,
    1e17, 1e18, 1e19, 1e20, 1e21, 1e22,
];

/// The double nearest to the decimal number that `text` begins with, none if that is no finite number,
/// and how long it is.
fn number_of(text: &[u8]) -> (Option<f64>, usize) {
    let ends = |byte: &u8| matches!(byte, b' ' | b',' | b'\t' | b'\r' | b'\n');
    // Up to 15 digits, and a power of ten that is exact: one division rounds once.
    let (mut digits, mut count, mut behind, mut len) = (0u64, 0, 0, 0);
    let mut point = false;
    while let Some(byte) = text.get(len) {
        match byte {
            b'0'..=b'9' if count < 15 => {
                digits = 10 * digits + u64::from(byte - b'0');
                count += 1;
                behind += usize::from(point);
            }
            b'.' if !point => point = true,
            _ => break,
        }
        len += 1;
    }
    if count > 0 && text.get(len).is_none_or(ends) {
        return (Some(digits as f64 / TENS[behind]), len);
    }
    let len = text.iter().position(ends).unwrap_or(text.len());
    let number = std::str::from_utf8(&text[..len]).ok().and_then(|text| text.parse::<f64>().ok());
    (number.filter(|number| number.is_finite()), len)
}

fn comparison(args: &cli::Compare) -> Result<(), Failure> {
    let closures = args.names.iter().map(|name| find(name)).collect::<Result<Vec<_>, _>>()?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_read_to_the_last_bit() {
        for text in ["0.15", "16.448", "1", ".5", "3.", "0.000123456789012", "123456789012345"] {
            assert_eq!(number_of(text.as_bytes()), (text.parse().ok(), text.len()), "{text}");
        }
        for text in ["-0.25", "1e-3", "2.5E+2", "0.1234567890123456789", "00000000000000000.5"] {
            assert_eq!(number_of(text.as_bytes()), (text.parse().ok(), text.len()), "{text}");
        }
        assert_eq!(number_of(b"0.25,1"), (Some(0.25), 4));
        for text in ["", ".", "1.2.3", "nan", "inf", "abc", "1e999", "--1"] {
            assert_eq!(number_of(text.as_bytes()), (None, text.len()), "{text}");
        }
    }
}
