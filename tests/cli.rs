//! The binary as its users meet it: exit status, messages, and what is left on disk.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use assert_cmd::cargo::cargo_bin;

/// A complete case; each bad input below is this with one thing changed.
const CASE: &str = r#"[powder]
diameter = 75e-6
density = 1500.0
restitution = 0.9
max_packing = 0.65

[gas]
density = 1.3
viscosity = 1.8e-5

[box]
size = [0.02, 0.02]
cells = [16, 16]
solids_fraction = 0.15

[filter]
widths = [0.005]

[run]
duration = "10 u_t/g"
sample_interval = "0.5 u_t/g"
seed = 1
"#;

fn favre(dir: &Path, args: &[&str]) -> Output {
    Command::new(cargo_bin!("favre")).current_dir(dir).args(args).output().unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Runs the bytes as a case file and returns the message, having checked that it is one message
/// of misuse and that nothing was left.
fn refused(case: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("case.toml"), case).unwrap();
    let output = favre(dir.path(), &["run", "case.toml"]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert_eq!(message.matches("favre: ").count(), 1, "{message}");
    assert!(!message.contains("panicked"), "{message}");
    assert_eq!(stdout(&output), "");
    assert_eq!(names(dir.path()), ["case.toml"]);
    message
}

/// Checks that the case with `from` replaced by `to` is refused with a message that starts with
/// `start`, which is place, key and value, and holds every one of `parts`.
#[track_caller]
fn check(from: &str, to: &str, start: &str, parts: &[&str]) {
    assert!(CASE.contains(from), "{from} is not in the case");
    let message = refused(CASE.replacen(from, to, 1).as_bytes());
    let start = format!("favre: case.toml:{start}: ");
    assert!(message.starts_with(&start), "{message}\ndoes not start with {start}");
    for part in parts {
        assert!(message.contains(part), "{message}\ndoes not hold {part}");
    }
    // The excerpt: the line and one marker below it.
    assert_eq!(message.lines().count(), 4, "{message}");
    assert!(message.lines().last().unwrap().contains('^'), "{message}");
}

#[test]
fn keys_that_are_unknown_or_missing() {
    check("viscosity", "viscocity", "9: [gas] viscocity", &["did you mean viscosity?"]);
    check("seed = 1", "sed = 1", "22: [run] sed", &["did you mean seed?", "precision"]);
    check("seed = 1", "gravity = 1", "22: [run] gravity", &["belongs in [physics]"]);
    check("seed = 1", "zzz = 1", "22: [run] zzz", &["unknown key; [run] holds duration"]);
    check("[filter]", "[filters]", "16: [filters]", &["did you mean [filter]?"]);
    check("[filter]", "[quux]", "16: [quux]", &["unknown section", "[physics]"]);
    check("[powder]", "x = 1\n[powder]", "1: x", &["unknown section", "[powder]"]);
    check("[powder]", "drag = 1\n[powder]", "1: drag", &["below the line [physics]"]);
    check("restitution = 0.9\n", "", "1: [powder] restitution", &["missing"]);
    check("cells = [16, 16]\n", "", "11: [box] cells", &["missing", "as cell"]);
    check("size = [0.02, 0.02]\n", "", "11: [box] size", &["missing", "edges"]);
    check("solids_fraction = 0.15\n", "", "11: [box] solids_fraction", &["missing"]);
    check("[filter]", "[filter.x]\n[filter]", "16: [filter] x", &["unknown key", "widths"]);
    let message = refused(&CASE.as_bytes()[CASE.find("[gas]").unwrap()..]);
    assert!(message.starts_with("favre: case.toml: [powder]: missing"), "{message}");
    assert!(message.contains("diameter, density, restitution, max_packing"), "{message}");
}

#[test]
fn values_of_the_wrong_type() {
    check("1500.0", "\"1500\"", "3: [powder] density = \"1500\"", &["remove the quotes"]);
    check("1500.0", "true", "3: [powder] density = true", &["a number is expected"]);
    check("1500.0", "[1]", "3: [powder] density = [1]", &["a number is expected"]);
    check("75e-6", "\"75\"", "2: [powder] diameter = \"75\"", &["no unit", "in metres"]);
    check("75e-6", "\"75 nm\"", "2: [powder] diameter = \"75 nm\"", &["unknown unit", "um"]);
    check("75e-6", "\"1 L_I\"", "2: [powder] diameter = \"1 L_I\"", &["m, cm, mm, um"]);
    check("[0.005]", "0.005", "17: [filter] widths = 0.005", &["a list is expected"]);
    check("[0.005]", "[true]", "17: [filter] widths = true", &["a number in metres", "8 L_I"]);
    check("seed = 1", "seed = 1.5", "22: [run] seed = 1.5", &["a whole number"]);
    check("seed = 1", "seed = -1", "22: [run] seed = -1", &["between 0 and"]);
    let huge = "seed = 99999999999999999999";
    check("seed = 1", huge, &format!("22: [run] {huge}"), &["between 0 and"]);
    check("seed = 1", "precision = \"f16\"", "22: [run] precision = \"f16\"", &["f32", "f64"]);
    check("\"10 u_t/g\"", "\"10 u_t\"", "20: [run] duration = \"10 u_t\"", &["u_t/g", "seconds"]);
    check("[0.005]", "[0.005]\nmarkers = [\"slp\"]", "18: [filter] markers = \"slp\"", &["slip"]);
    check(
        "[filter]",
        "[physics]\ndrag = \"ergun\"\n[filter]",
        "17: [physics] drag = \"ergun\"",
        &["\"wen-yu\""],
    );
    let message = refused(CASE.replace("[powder]", "powder = 3\n[other]").as_bytes());
    assert!(message.contains("case.toml:1: powder = 3: a section is expected"), "{message}");
}

#[test]
fn numbers_out_of_range() {
    let positive = ["-1", "0", "-0.0", "nan", "inf", "-inf", "1e999", "1e300", "1e-300"];
    for value in positive {
        for (from, line, key) in [
            ("75e-6", 2, "[powder] diameter"),
            ("1500.0", 3, "[powder] density"),
            ("1.3", 8, "[gas] density"),
            ("1.8e-5", 9, "[gas] viscosity"),
        ] {
            check(from, value, &format!("{line}: {key} = {value}"), &[]);
        }
    }
    for value in ["-0.1", "0", "1.0001", "nan"] {
        check("0.9", value, &format!("4: [powder] restitution = {value}"), &[]);
    }
    check("0.9", "2", "4: [powder] restitution = 2", &["above 0 and at most 1 is accepted"]);
    for value in ["0", "-0.65", "0.75", "65"] {
        check("0.65", value, &format!("5: [powder] max_packing = {value}"), &["at most 0.74"]);
    }
    for value in ["0", "-0.1", "0.65", "0.9", "15"] {
        let accepted = "above 0 and below max_packing = 0.65 is accepted";
        check("0.15", value, &format!("14: [box] solids_fraction = {value}"), &[accepted]);
    }
    check("0.15", "0.64", "14: [box] solids_fraction = 0.64", &["perturbation", "0.619048"]);
    check("0.15", "[0.1, 0.2, 0.1]", "14: [box] solids_fraction = 0.1", &["twice"]);
    check("0.15", "[]", "14: [box] solids_fraction = []", &["empty"]);
    check("1.3", "1600", "8: [gas] density = 1600", &["below 1500 kg/m³"]);
    for (key, value) in
        [("gravity", "0"), ("gravity", "-9.81"), ("gravity", "1e9"), ("gravity", "nan")]
    {
        let to = format!("[physics]\n{key} = {value}\n[filter]");
        check("[filter]", &to, &format!("17: [physics] {key} = {value}"), &[]);
    }
    for (key, value, part) in [
        ("solids_fraction_bin", "0", "1e-4 to max_packing = 0.65"),
        ("solids_fraction_bin", "2", "1e-4 to max_packing = 0.65"),
        ("slip_bin", "0", "0.001 u_t to 10 u_t"),
        ("slip_bin", "\"-1 u_t\"", "u_t is 0.2185 m/s"),
        ("markers", "[\"slip\"]", "always a marker"),
        ("markers", "[\"solids_fraction\", \"slip\", \"slip\"]", "twice"),
    ] {
        let shown = if part == "twice" { "\"slip\"" } else { value };
        let to = format!("[filter]\n{key} = {value}");
        check("[filter]", &to, &format!("17: [filter] {key} = {shown}"), &[part]);
    }
    for value in ["-0.1", "0.6", "nan"] {
        let to = format!("perturbation = {value}");
        check("seed = 1", &to, &format!("22: [run] perturbation = {value}"), &[]);
    }
}

#[test]
fn boxes_and_filters_that_do_not_fit() {
    for size in ["[0.02]", "[0.02, 0.02, 0.02, 0.02]"] {
        check("[0.02, 0.02]", size, &format!("12: [box] size = {size}"), &["two edges (2-D)"]);
    }
    check("[0.02, 0.02]", "[0.02, -0.02]", "12: [box] size = -0.02", &["above 0"]);
    check("[0.02, 0.02]", "[0.02, 0]", "12: [box] size = 0", &["above 0"]);
    check("[0.02, 0.02]", "[0.02, inf]", "12: [box] size = inf", &["finite"]);
    check("[0.02, 0.02]", "[2e-5, 2e-5]", "12: [box] size = 2e-5", &["less than one particle"]);
    check("[16, 16]", "[16, 16, 16]", "13: [box] cells = [16, 16, 16]", &["size has 2 edges"]);
    check("[16, 16]", "16", "13: [box] cells = 16", &["a list is expected"]);
    check("[16, 16]", "[12.5, 16]", "13: [box] cells = 12.5", &["a whole number"]);
    check("[16, 16]", "[16, 17]", "13: [box] cells = 17", &["an even number from 8"]);
    check("[16, 16]", "[6, 16]", "13: [box] cells = 6", &["an even number from 8"]);
    check("[16, 16]", "[16, -16]", "13: [box] cells = -16", &["a whole number between 0"]);
    let many = "[4000000000, 4000000000]";
    check("[16, 16]", many, &format!("13: [box] cells = {many}"), &["at most"]);
    check(
        "cells = [16, 16]",
        "cells = [16, 16]\ncell = 1.25e-3",
        "14: [box] cell = 1.25e-3",
        &["keep one of the two"],
    );
    let (from, to) =
        ("size = [0.02, 0.02]\ncells = [16, 16]", "cell = 1e-3\nsize = [0.0205, 0.02]");
    check(from, to, "13: [box] size = 0.0205", &["0.02 m or 0.022 m"]);

    let start = |value| format!("17: [filter] widths = {value}");
    check("[0.005]", "[0.006]", &start("0.006"), &["nearest: 0.005 m, 0.00625 m"]);
    check("[0.005]", "[0.005, 0.02]", &start("0.02"), &["half the box", "nearest: 0.01 m"]);
    check("[0.005]", "[0.00125]", &start("0.00125"), &["two cells", "nearest: 0.0025 m"]);
    check("[0.005]", "[-0.005]", &start("-0.005"), &["nearest: 0.0025 m"]);
    check("[0.005]", "[0.005, \"5 mm\"]", &start("\"5 mm\""), &["twice"]);
    check("[0.005]", "[]", &start("[]"), &["empty"]);
}

#[test]
fn times_that_do_not_fit() {
    let ten = "\"10 u_t/g\"";
    check(ten, "0", "20: [run] duration = 0", &["a time above 0"]);
    check(ten, "-1.0", "20: [run] duration = -1.0", &["a time above 0"]);
    check(ten, "\"nan s\"", "20: [run] duration = \"nan s\"", &["200 u_t/g"]);
    let half = "\"0.5 u_t/g\"";
    check(half, "0", "21: [run] sample_interval = 0", &["a time above 0"]);
    check(half, "\"1 u_t/g\"", "21: [run] sample_interval = \"1 u_t/g\"", &["20 sample intervals"]);
}

#[test]
fn files_that_are_no_case() {
    for empty in ["", "\n\n", "# only a comment\n"] {
        let message = refused(empty.as_bytes());
        assert!(message.starts_with("favre: case.toml is empty"), "{message}");
        assert!(message.contains("--print-case"), "{message}");
    }
    let message = refused(b"[powder]\ndiameter = \"\xff\"\n");
    assert!(message.starts_with("favre: case.toml:2: not UTF-8"), "{message}");
    check("[powder]", "[powder", "1", &["not TOML"]);
    check("diameter = 75e-6", "diameter = ", "2", &["not TOML"]);
    check("diameter = 75e-6", "diameter = 75 um", "2", &["not TOML"]);
    check("density = 1500.0", "diameter = 1.0", "3", &["not TOML", "duplicate key"]);
    let long = refused("# long\n".repeat(200_000).as_bytes());
    assert!(long.contains("longer than 1048576 bytes"), "{long}");

    let dir = tempfile::tempdir().unwrap();
    let output = favre(dir.path(), &["run", "."]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).starts_with("favre: . is a folder"), "{}", stderr(&output));
    let output = favre(dir.path(), &["run", "absent.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let message = stderr(&output);
    assert!(
        message.starts_with("favre: cannot read the case file absent.toml: No such"),
        "{message}"
    );
    assert_eq!(names(dir.path()), [""; 0]);
}

#[test]
fn all_problems_of_a_file_are_reported_at_once_in_order() {
    let case = CASE.replace("75e-6", "-75e-6").replace("0.15", "0.9").replace("seed", "sed");
    let message = refused(case.as_bytes());
    assert!(message.starts_with("favre: case.toml has 3 problems\n"), "{message}");
    let places: Vec<_> = message.lines().filter(|line| line.starts_with("case.toml:")).collect();
    assert_eq!(places.len(), 3, "{message}");
    for (place, start) in places.iter().zip(["2: [powder]", "14: [box]", "22: [run]"]) {
        assert!(place.starts_with(&format!("case.toml:{start}")), "{message}");
    }
}

#[test]
fn without_arguments_there_is_a_page_of_help() {
    let dir = tempfile::tempdir().unwrap();
    let output = favre(dir.path(), &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).starts_with("favre turns a powder and a gas into closure tables"));
    assert!(stderr(&output).contains("favre run --print-case"));
    for args in [&["--help"][..], &["run", "--help"], &["bench", "--help"], &["--version"]] {
        let output = favre(dir.path(), args);
        assert_eq!(output.status.code(), Some(0), "{args:?}");
        assert!(stdout(&output).contains("avre"), "{args:?}");
    }
    for args in [&["fit"][..], &["run", "--nope"], &["run", "--threads", "0"], &["run", "a", "b"]] {
        let output = favre(dir.path(), args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        assert!(!stderr(&output).is_empty() && stdout(&output).is_empty(), "{args:?}");
    }
    assert_eq!(names(dir.path()), [""; 0]);
}

#[test]
fn a_case_can_be_printed_edited_and_resolved() {
    let dir = tempfile::tempdir().unwrap();
    let printed = favre(dir.path(), &["run", "--print-case"]);
    assert_eq!(printed.status.code(), Some(0));
    assert_eq!(stdout(&printed), favre::case::DEFAULT);
    fs::write(dir.path().join("mine.toml"), &printed.stdout).unwrap();
    let resolved = favre(dir.path(), &["run", "mine.toml", "--print-case"]);
    fs::write(dir.path().join("mine.toml"), &resolved.stdout).unwrap();
    let again = favre(dir.path(), &["run", "mine.toml", "--print-case"]);
    assert_eq!(stdout(&again), stdout(&resolved));
    let shorter = favre(dir.path(), &["run", "--duration", "4", "--print-case"]);
    assert!(stdout(&shorter).contains("duration = 4.0\n"));
    assert_eq!(names(dir.path()), ["mine.toml"]);
}

#[test]
fn every_example_is_a_case_without_warnings() {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let mut count = 0;
    for name in names(&examples).iter().filter(|name| name.ends_with(".toml")) {
        let case = favre::case::Case::load(&examples.join(name)).unwrap();
        assert_eq!(case.warnings(), [""; 0], "{name}");
        assert_eq!(format!("{}.toml", case.name), *name);
        count += 1;
    }
    assert!(count >= 4);
}

#[test]
fn a_wrong_duration_on_the_command_line_is_misuse() {
    let dir = tempfile::tempdir().unwrap();
    for (value, part) in [
        ("0", "a time above 0"),
        ("-5", "a time above 0"),
        ("soon", "accepted is a number in seconds"),
        ("1 u_t/g", "20 sample intervals"),
    ] {
        let output = favre(dir.path(), &["run", "--duration", value]);
        assert_eq!(output.status.code(), Some(2), "{value}");
        let message = stderr(&output);
        assert!(message.starts_with(&format!("favre: duration \"{value}\": ")), "{message}");
        assert!(message.contains(part), "{message}");
    }
    assert_eq!(names(dir.path()), [""; 0]);
}

#[test]
fn a_run_leaves_its_folder_and_does_not_overwrite_one() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("glass.toml"), CASE).unwrap();
    let output = favre(dir.path(), &["run", "glass.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("favre-out/glass"), "{}", stderr(&output));
    let folder = dir.path().join("favre-out/glass");
    assert!(folder.join("run.json").is_file());
    assert_eq!(names(&dir.path().join("favre-out")), ["glass"]);

    let output = favre(dir.path(), &["run", "glass.toml"]);
    assert_eq!(output.status.code(), Some(2));
    let message = stderr(&output);
    assert!(message.contains("favre-out/glass exists") && message.contains("--force"), "{message}");

    let output = favre(dir.path(), &["run", "glass.toml", "--force", "--quiet", "--json"]);
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(stderr(&output), "");
    serde_json::from_str::<serde_json::Value>(&stdout(&output)).unwrap();
    assert_eq!(names(&dir.path().join("favre-out")), ["glass"]);
}

#[test]
fn output_folders_that_cannot_be_made_are_misuse() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("case.toml"), CASE).unwrap();
    fs::create_dir(dir.path().join("notes")).unwrap();
    fs::write(dir.path().join("notes/a.txt"), "x").unwrap();
    for (args, part) in [
        (&["--out", "notes"][..], "notes exists: choose another with --out DIR"),
        (&["--out", "notes", "--force"], "--force does not replace it"),
        (&["--out", "case.toml", "--force"], "case.toml is a file"),
        (&["--out", "case.toml/sub"], "cannot make the output folder case.toml/sub"),
        (&["--out", "..", "--force"], "no name of its own"),
    ] {
        let output = favre(dir.path(), &[&["run", "case.toml"], args].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {message}");
        assert!(message.contains(part), "{args:?}: {message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
    assert_eq!(names(dir.path()), ["case.toml", "notes"]);
    assert_eq!(names(&dir.path().join("notes")), ["a.txt"]);
}

/// Signals that this process has been told to ignore, which its children then ignore too.
#[cfg(target_os = "linux")]
fn ignores_signals() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap().trim();
    // SIGHUP is 1, SIGINT 2, SIGTERM 15; the bit is one less.
    u64::from_str_radix(mask, 16).unwrap() & 0x4003 != 0
}

#[cfg(target_os = "linux")]
#[test]
fn an_interrupt_ends_the_run_and_leaves_nothing() {
    if ignores_signals() {
        eprintln!("skipped: this process was started with signals ignored, as by nohup");
        return;
    }
    for signal in ["-INT", "-TERM"] {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("case.toml"), CASE).unwrap();
        let child = Command::new(cargo_bin!("favre"))
            .current_dir(dir.path())
            .args(["run", "case.toml", "--duration", "1e6 u_t/g", "--checkpoint-minutes", "0"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let started = Instant::now();
        while !dir.path().join("favre-out/case.partial").exists() {
            assert!(started.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(50));
        let sent = Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap();
        assert!(sent.success());
        let output = child.wait_with_output().unwrap();
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(130), "{signal}: {message}");
        assert!(message.contains("ending the run"), "{message}");
        let last = message.lines().last().unwrap();
        assert!(last.starts_with("favre: interrupted after "), "{message}");
        assert!(last.contains("no tables were written"), "{message}");
        assert_eq!(names(dir.path()), ["case.toml"]);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_takes_no_more_is_a_failure_that_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("case.toml"), CASE).unwrap();
    // A limit on the size of files fails a write as a full disk does, and needs no rights.
    let command = "trap '' XFSZ; ulimit -f 0; exec \"$0\" run case.toml --quiet";
    let output = Command::new("sh")
        .current_dir(dir.path())
        .args(["-c", command])
        .arg(cargo_bin!("favre"))
        .output()
        .unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("favre: cannot write favre-out/case/"), "{message}");
    assert!(message.contains("this run left no results: File too large"), "{message}");
    assert_eq!(names(dir.path()), ["case.toml"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_reader_that_leaves_is_no_failure_and_a_full_disk_is() {
    let dir = tempfile::tempdir().unwrap();
    let shell = |command: &str| {
        let shell = Command::new("sh")
            .current_dir(dir.path())
            .args(["-c", command])
            .arg(cargo_bin!("favre"))
            .output()
            .unwrap();
        (shell.status.code(), stderr(&shell))
    };
    // The reader is gone before anything is written.
    let closed = "{ sleep 0.2; \"$0\" run --print-case; echo $? >&2; } | true";
    assert_eq!(shell(closed), (Some(0), "0\n".to_owned()));
    let (status, message) = shell("\"$0\" run --print-case > /dev/full");
    assert_eq!(status, Some(1));
    assert!(message.starts_with("favre: cannot write to standard output: No space"), "{message}");
    assert_eq!(shell("\"$0\" run absent.toml 2> /dev/full").0, Some(2));
}

#[test]
fn stability_leaves_table_and_figure_and_says_what_the_case_needs() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("glass.toml"), CASE).unwrap();
    let output = favre(dir.path(), &["stability", "glass.toml"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = stdout(&output);
    assert!(text.starts_with("glass, ⟨φ⟩ = 0.15: fastest wave 0.923 mm (vertical)"), "{text}");
    assert_eq!(text.lines().count(), 3);
    let folder = dir.path().join("favre-out/glass-stability");
    assert_eq!(names(&folder), ["run.json", "stability.csv", "stability.svg"]);
    let table = fs::read_to_string(folder.join("stability.csv")).unwrap();
    assert!(table.starts_with(
        "solids_fraction [-],direction,angle [degree],wavelength [m],growth_rate [1/s],wave_speed [m/s]\n0.15,vertical,0.0,"
    ));
    assert!(table.contains(",oblique 45,") && table.contains(",horizontal,"));

    let again = favre(dir.path(), &["stability", "glass.toml"]);
    assert_eq!(again.status.code(), Some(2));
    let json = favre(dir.path(), &["stability", "glass.toml", "--force", "--json"]);
    let found: serde_json::Value = serde_json::from_str(&stdout(&json)).unwrap();
    assert_eq!(found["states"][0]["directions"].as_array().unwrap().len(), 7);
    let kept = fs::read_to_string(folder.join("run.json")).unwrap();
    assert_eq!(serde_json::from_str::<serde_json::Value>(&kept).unwrap(), found);
}

#[test]
fn a_bench_prints_times() {
    let dir = tempfile::tempdir().unwrap();
    let output = favre(dir.path(), &["bench", "--quick", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(serde_json::from_str::<serde_json::Value>(&stdout(&output)).unwrap().is_object());
}

#[test]
fn exports_are_whole_or_refused_with_what_is_nearest() {
    let dir = tempfile::tempdir().unwrap();
    let output = favre(dir.path(), &["export", "default", "--to", "c"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let folder = dir.path().join("favre-out/default-c");
    let files = ["README.md", "check.c", "closure.toml", "favre_closure.h", "run.json"];
    assert_eq!(names(&folder), files);
    // The hash is that of the file beside it, and of what `models show` prints.
    let shown = favre(dir.path(), &["models", "show", "default", "--all"]);
    assert_eq!(fs::read_to_string(folder.join("closure.toml")).unwrap(), stdout(&shown));
    // An export of the export is the same.
    let again = ["export", "favre-out/default-c/closure.toml", "--to", "c", "--out", "again"];
    assert!(favre(dir.path(), &again).status.success());
    for file in files {
        let read = |folder: &Path| fs::read(folder.join(file)).unwrap();
        assert_eq!(read(&folder), read(&dir.path().join("again")), "{file}");
    }
    assert!(stderr(&favre(dir.path(), &again)).contains("exists: choose another with --out"));

    let original = stdout(&shown);
    let refused = |text: &str, target: &str| {
        fs::write(dir.path().join("mine.toml"), text).unwrap();
        let output = favre(dir.path(), &["export", "mine.toml", "--to", target, "--out", "no"]);
        assert_eq!(output.status.code(), Some(2));
        assert!(!dir.path().join("no").exists());
        stderr(&output)
    };
    let range = original.rfind("[[quantities.ranges]]").unwrap();
    let end = range + 1 + original[range + 1..].find("[[").unwrap();
    let without = format!("{}{}", &original[..range], &original[end..]);
    let message = refused(&without, "openfoam");
    assert!(message.contains("it is filter_width, which has no range here"), "{message}");
    assert!(message.contains("nearest"), "{message}");
    let message = refused(&original.replace("wen-yu", "mine"), "mfix");
    assert!(message.contains("drag law \"mine\"") && message.contains("nearest"), "{message}");
    let message = stderr(&favre(dir.path(), &["export", "defualt", "--to", "c"]));
    assert!(message.ends_with("did you mean default?\n"), "{message}");
    let message = stderr(&favre(dir.path(), &["export", "default", "--to", "barracuda"]));
    assert!(message.contains("the targets are openfoam, mfix, fluent, c, fortran"), "{message}");
}
