//! The `favre` command: parse, call one library function, print one error, exit.

mod cli;
mod fits;
mod interrupt;
mod models;

use std::error::Error;
use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use favre::bench;
use favre::case::{Case, DEFAULT, FieldsChoice};
use favre::checkpoint::Checkpoints;
use favre::closure::{Closure, ClosureError};
use favre::export;
use favre::hard;
use favre::output::{Output, beside, write_whole};
use favre::pipeline::fields::{FieldFormat, FilterOptions};
use favre::pipeline::{self, RunError, RunOptions};
use favre::pool::Pool;
use favre::report::REPORT_FILE;
use favre::resolved::map::Map;
use favre::sums::SUMS_FILE;
use favre::terms::terms;
use favre::verify::{self, Effort};

use cli::{Cli, Command};
use interrupt::{INTERRUPTED, Interrupt};

/// It ran and failed.
const FAILED: u8 = 1;
/// It was not asked properly.
const MISUSE: u8 = 2;

/// An exit status and what to say.
struct Failure {
    status: u8,
    error: Box<dyn Error>,
}

impl Failure {
    fn misuse(error: impl Into<Box<dyn Error>>) -> Self {
        Self { status: MISUSE, error: error.into() }
    }

    fn failed(error: impl Into<Box<dyn Error>>) -> Self {
        Self { status: FAILED, error: error.into() }
    }
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Some(Command::Run(args)) => run(&args, "run"),
        Some(Command::Simulate(args)) => run(&args, "simulate"),
        Some(Command::Filter(args)) => filter(&args),
        Some(Command::Fit(args)) => fits::fit(&args),
        Some(Command::Exponents(args)) => fits::exponents(&args),
        Some(Command::Models(args)) => models::models(&args),
        Some(Command::Export(args)) => export(&args),
        Some(Command::Report(args)) => report(&args),
        Some(Command::Stability(args)) => stability(&args),
        Some(Command::Bench(args)) => bench(&args),
        Some(Command::Verify(args)) => verify(&args),
        Some(Command::HardCases(args)) => hard_cases(&args),
        None => Err(Failure::misuse(cli::WELCOME)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure { status, error }) => {
            // The page for a call without arguments is not an error and has no prefix.
            let prefix = if error.to_string() == cli::WELCOME { "" } else { "favre: " };
            say(format_args!("{prefix}{}", chain(error.as_ref())));
            ExitCode::from(status)
        }
    }
}

/// `favre run`, and `favre simulate`, which is a run that keeps its fields.
fn run(args: &cli::Run, command: &str) -> Result<(), Failure> {
    let mut case = match &args.case {
        Some(path) => Case::load(path).map_err(Failure::misuse)?,
        None => Case::parse(DEFAULT, "default").map_err(Failure::misuse)?,
    };
    if let Some(duration) = &args.duration {
        case.set_duration(duration).map_err(Failure::misuse)?;
    }
    if command == "simulate" && case.output.fields == FieldsChoice::None {
        case.output.fields = FieldsChoice::Vti;
    }
    if args.print_case {
        let untouched = args.case.is_none() && args.duration.is_none() && command == "run";
        if untouched {
            return write(DEFAULT.to_owned());
        }
        let terms: String = terms(&case).iter().map(|term| format!("# {term}\n")).collect();
        return write(format!("{}\n{terms}", case.to_toml()));
    }
    if !args.quiet {
        for warning in case.warnings() {
            say(format_args!("favre: warning: {warning}"));
        }
    }
    let interrupt = Interrupt::install();
    let default = Path::new("favre-out").join(&case.name);
    let dir = args.out.as_deref().unwrap_or(&default);
    let (mut output, checkpoints) = prepare(args, &case, dir)?;
    interrupt.partial.get_or_init(|| output.partial().to_owned());
    let options = RunOptions { threads: args.threads.map_or(0, usize::from), quiet: args.quiet };
    let summary = pipeline::run(&case, &mut output, &checkpoints, &options, &interrupt.stop)
        .map_err(|error| failure(error, args, command, &checkpoints))?;
    let dir =
        output.commit().map_err(|error| failure(error.into(), args, command, &checkpoints))?;
    if let Err(error) = checkpoints.remove() {
        say(format_args!("favre: warning: {}", chain(&error)));
    }
    if !args.quiet {
        say(format_args!("favre: results are in {}", dir.display()));
    }
    match (args.json, args.quiet) {
        (true, _) => print_json(&summary),
        (false, true) => Ok(()),
        (false, false) => print(&summary),
    }
}

/// The output folder of a run, and what is kept of it until it is complete.
fn prepare(args: &cli::Run, case: &Case, dir: &Path) -> Result<(Output, Checkpoints), Failure> {
    let seconds = 60.0 * args.checkpoint_minutes;
    let interval = (seconds > 0.0).then(|| Duration::from_secs_f64(seconds));
    if args.resume && args.force {
        let message = "--resume goes on with an interrupted run and --force starts anew: give one \
                       of the two; a run begun with --force goes on with --resume alone";
        return Err(Failure::misuse(message));
    }
    if args.resume {
        let kept = Checkpoints::resume(dir, case, interval).map_err(Failure::misuse)?;
        let output = Output::create(dir, kept.replaces()).map_err(Failure::misuse)?;
        Ok((output, kept))
    } else {
        // The output folder first: it shuts out other runs.
        let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
        let kept = Checkpoints::start(dir, case, interval, args.force).map_err(Failure::misuse)?;
        Ok((output, kept))
    }
}

/// What to say of a run that did not end, and how to go on with it.
fn failure(error: RunError, args: &cli::Run, command: &str, checkpoints: &Checkpoints) -> Failure {
    let status = if matches!(error, RunError::Interrupted { .. }) { INTERRUPTED } else { FAILED };
    if checkpoints.is_empty() {
        // Snapshots without a state to go on from; an error here would hide the one that matters.
        let _ = checkpoints.remove();
    }
    // A box that failed would fail again.
    if checkpoints.is_empty() || matches!(error, RunError::Simulate(_)) {
        return Failure { status, error: error.into() };
    }
    let message = format!(
        "{}; what was simulated is kept in {}, go on with `{}`",
        chain(&error),
        checkpoints.dir().display(),
        command_to_go_on(args, command)
    );
    Failure { status, error: message.into() }
}

/// The command that goes on with the run of `args`, as it is typed into a shell.
fn command_to_go_on(args: &cli::Run, command: &str) -> String {
    let path = |path: &PathBuf| path.display().to_string();
    let options = [("", args.case.as_ref().map(path)), ("--out", args.out.as_ref().map(path))];
    let duration = ("--duration", args.duration.clone());
    let mut command = format!("favre {command}");
    for (option, value) in options.into_iter().chain([duration]) {
        let Some(value) = value else { continue };
        let plain = |c: char| c.is_alphanumeric() || "/._-+=,:".contains(c);
        let quoted = format!("'{}'", value.replace('\'', r"'\''"));
        let value = if !value.is_empty() && value.chars().all(plain) { value } else { quoted };
        let space = if option.is_empty() { "" } else { " " };
        command += &format!(" {option}{space}{value}");
    }
    command + " --resume"
}

fn filter(args: &cli::Filter) -> Result<(), Failure> {
    if args.paths.iter().any(|path| is_sums(path)) {
        if args.fields.is_some() || !args.widths.is_empty() {
            let message = "--fields and --widths filter fields, and sums of a run are what is left of \
                           them: give the run's snapshots, such as trial/fields_0.15";
            return Err(Failure::misuse(message));
        }
        return pool(args);
    }
    let map = match &args.map {
        Some(path) => Map::load(path).map_err(Failure::misuse)?,
        None => Map::none(),
    };
    let interrupt = Interrupt::install();
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/filter"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    interrupt.partial.get_or_init(|| output.partial().to_owned());
    let options = RunOptions { threads: args.threads.map_or(0, usize::from), quiet: args.quiet };
    let asked = FilterOptions {
        from: args.from,
        order: args.grid_order,
        widths: (!args.widths.is_empty()).then(|| args.widths.clone()),
        fields: args.fields.map(|fields| match fields {
            cli::FieldFiles::Vti => FieldFormat::Vti,
            cli::FieldFiles::Vtkhdf => FieldFormat::Vtkhdf,
        }),
    };
    let found =
        pipeline::fields::filter(&args.paths, &map, &asked, &output, &options, &interrupt.stop);
    let found = found.map_err(|error| match error {
        RunError::Stopped => Failure { status: INTERRUPTED, error: error.into() },
        // What was given cannot be filtered.
        RunError::Series(_) | RunError::Resolved(_) | RunError::Stored { .. } => {
            Failure::misuse(error)
        }
        error => Failure::failed(error),
    })?;
    let dir = output.commit().map_err(Failure::failed)?;
    if !args.quiet {
        say(format_args!("favre: results are in {}", dir.display()));
    }
    match (args.json, args.quiet) {
        (true, _) => print_json(&found),
        (false, true) => Ok(()),
        (false, false) => print(&found),
    }
}

/// Whether `path` holds the sums of a run: its folder or the file itself.
fn is_sums(path: &Path) -> bool {
    path.join(SUMS_FILE).is_file() || path.extension().is_some_and(|end| end == "favre")
}

/// `favre filter` of sums.
fn pool(args: &cli::Filter) -> Result<(), Failure> {
    if let Some(path) = args.paths.iter().find(|path| !is_sums(path)) {
        let message = format!(
            "{} holds no sums of a run, and others here do: filter fields on their own, then put the \
             results together",
            path.display()
        );
        return Err(Failure::misuse(message));
    }
    let pool = Pool::read(&args.paths, args.grid_order).map_err(Failure::misuse)?;
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/pool"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    let summary = pipeline::pooled(&pool, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: tables are in {}", dir.display()));
    if args.json { print_json(&summary) } else { print(&summary) }
}

fn export(args: &cli::Export) -> Result<(), Failure> {
    let closure = Closure::find(&args.model).map_err(|error| {
        if !matches!(error, ClosureError::Invalid { .. } | ClosureError::Wrong { .. }) {
            return Failure::misuse(error);
        }
        let advice = "nothing can be exported of it as it is; nearest: correct the file, `favre models \
                      check` looks at the whole of it, or write its formula and its ranges as those in \
                      `favre models show default` are";
        Failure::misuse(format!("{}: {advice}", chain(&error)))
    })?;
    let pieces = export::export(&closure, args.to).map_err(Failure::misuse)?;
    let default = Path::new("favre-out").join(format!("{}-{}", closure.file.name, args.to));
    let dir = args.out.as_deref().unwrap_or(&default);
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    export::write(&pieces, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: {} for {} is in {}", closure.file.name, args.to, dir.display()));
    Ok(())
}

fn report(args: &cli::Report) -> Result<(), Failure> {
    let default = match args.paths.as_slice() {
        [path] if path.is_dir() => path.join(REPORT_FILE),
        [path] => beside(path, "-report.html"),
        _ => Path::new("favre-out").join(REPORT_FILE),
    };
    let out = args.out.as_deref().unwrap_or(&default);
    let command: Vec<String> = std::env::args().skip(1).collect();
    let page = pipeline::report(&args.paths, &format!("favre {}", command.join(" ")))
        .map_err(Failure::misuse)?;
    write_whole(out, page.as_bytes()).map_err(|error| {
        Failure::failed(format!("cannot write {}: {error}; name another with --out", out.display()))
    })?;
    say(format_args!("favre: the page is {}", out.display()));
    if let Some(dir) = &args.figures {
        let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
        pipeline::figures(&args.paths, &output).map_err(Failure::failed)?;
        let dir = output.commit().map_err(Failure::failed)?;
        say(format_args!("favre: its figures are in {}", dir.display()));
    }
    Ok(())
}

fn stability(args: &cli::Stability) -> Result<(), Failure> {
    let case = Case::load(&args.case).map_err(Failure::misuse)?;
    for warning in case.warnings() {
        say(format_args!("favre: warning: {warning}"));
    }
    let default = Path::new("favre-out").join(format!("{}-stability", case.name));
    let dir = args.out.as_deref().unwrap_or(&default);
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    let found = pipeline::stability(&case, &output).map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: growth rates are in {}", dir.display()));
    if args.json { print_json(&found) } else { print(&found) }
}

fn bench(args: &cli::Bench) -> Result<(), Failure> {
    if !args.error {
        let report = bench::measure(args.quick).map_err(Failure::failed)?;
        return if args.json { print_json(&report) } else { print(&report) };
    }
    let dir = args.out.as_deref().unwrap_or(Path::new("favre-out/bench-error"));
    let output = Output::create(dir, args.force).map_err(Failure::misuse)?;
    say(bench::error::HEADER);
    let report = pipeline::bench_error(args.quick, &output, |point| say(point));
    let report = report.map_err(Failure::failed)?;
    let dir = output.commit().map_err(Failure::failed)?;
    say(format_args!("favre: table and figures are in {}", dir.display()));
    if args.json { print_json(&report) } else { print(&report) }
}

fn verify(args: &cli::Verify) -> Result<(), Failure> {
    let effort = if args.quick { Effort::Quick } else { Effort::Full };
    let progress = |name: &str| say(format_args!("favre: checking: {name}"));
    let report = verify::verify(&args.only, effort, progress).map_err(Failure::misuse)?;
    if args.json { print_json(&report) } else { print(&report) }?;
    let failed = report.failed();
    let message = || Failure::failed(format!("{failed} of {} do not pass", report.rows.len()));
    if failed == 0 { Ok(()) } else { Err(message()) }
}

fn hard_cases(args: &cli::HardCases) -> Result<(), Failure> {
    // The table takes minutes: its rows are shown as they come.
    if !args.json {
        write(format!("{}\n", hard::HEADER))?;
    }
    let mut written = Ok(());
    let table = hard::run(args.quick, |row| {
        if !args.json && written.is_ok() {
            written = write(format!("{row}\n"));
        }
    });
    written?;
    if args.json {
        print_json(&table)?;
    }
    match table.failed() {
        0 => Ok(()),
        failed => Err(Failure::failed(format!("{failed} of {} cases fail", table.rows.len()))),
    }
}

/// An error and its causes on one line; some errors say their cause themselves.
fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let why = error.to_string();
        if !text.ends_with(&why) {
            text = format!("{text}: {why}");
        }
        cause = error.source();
    }
    text
}

fn print(result: &impl Display) -> Result<(), Failure> {
    write(format!("{result}\n"))
}

fn print_json(result: &impl serde::Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(result).map_err(Failure::failed)?;
    write(text + "\n")
}

/// Writes a result to standard output; a reader that has had enough is no failure.
fn write(text: String) -> Result<(), Failure> {
    let mut stdout = io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            Err(Failure::failed(format!("cannot write to standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// Writes a message to standard error; where that is closed there is nobody to tell.
fn say(message: impl Display) {
    let _ = writeln!(io::stderr(), "{message}");
}
