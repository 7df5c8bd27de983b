//! Runs that are interrupted and resumed, through the binary: the bytes of a run that was not.

#![cfg(target_os = "linux")]

mod common;

use assert_cmd::cargo::cargo_bin;
use common::SYSTEM;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Three boxes, so that on two threads one is done, one under way and one not begun, now and then.
const FLAT: &str = r#"[box]
size = [0.04, 0.06]
cells = [32, 48]
solids_fraction = [0.05, 0.15, 0.25]
[filter]
widths = [0.005, 0.01, 0.02]
markers = ["solids_fraction", "slip"]
[run]
duration = "60 u_t/g"
"#;

const SOLID: &str = r#"[box]
size = [0.02, 0.02, 0.03]
cells = [16, 16, 24]
solids_fraction = [0.15]
[filter]
widths = [0.0025, 0.005, 0.01]
[run]
duration = "20 u_t/g"
precision = "f32"
"#;

/// How often the runs here keep their boxes: at nearly every step.
const OFTEN: &[&str] = &["--checkpoint-minutes", "1e-6"];

fn favre(dir: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(cargo_bin!("favre"));
    command.current_dir(dir).arg("run").arg("case.toml").args(arguments);
    command
}

/// Runs to the end and returns exit status and messages.
fn run(dir: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = favre(dir, arguments).output().unwrap();
    (status.code(), String::from_utf8(stderr).unwrap())
}

fn start(dir: &Path, arguments: &[&str]) -> Child {
    favre(dir, arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until a box is kept, and then some more.
fn wait_for_a_box(dir: &Path, out: &str, more: u64) {
    let started = Instant::now();
    let checkpoint = dir.join(format!("{out}.checkpoint"));
    let kept = || {
        let mut entries = fs::read_dir(&checkpoint).ok().into_iter().flatten().flatten();
        entries.any(|entry| entry.file_name().to_string_lossy().ends_with(".state"))
    };
    while !kept() {
        assert!(started.elapsed() < Duration::from_secs(60));
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(Duration::from_millis(more));
}

fn end(child: Child, signal: &str) -> (Option<i32>, String) {
    // Two at once, as `timeout` and batch systems send them.
    let id = child.id().to_string();
    let sent = Command::new("kill").args([signal, &id, &id]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// Signals that this process has been told to ignore, which its children then ignore too.
fn ignores_signals() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap().trim();
    u64::from_str_radix(mask, 16).unwrap() & 0x4003 != 0
}

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

/// Every file of two runs is the same but run.json, which is but for where and how long it ran, and the
/// page that shows it.
fn assert_same(found: &Path, expected: &Path) {
    assert_eq!(names(found), names(expected));
    for name in names(expected) {
        if name == "run.json" || name == "report.html" {
            continue;
        }
        let [a, b] = [found, expected].map(|dir| fs::read(dir.join(&name)).unwrap());
        assert!(a == b, "{name} differs");
    }
    let [a, b] = [found, expected].map(|dir| {
        let text = fs::read_to_string(dir.join("run.json")).unwrap();
        let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
        json["machine"] = serde_json::Value::Null;
        for found in json["boxes"].as_array_mut().unwrap() {
            assert!(found["cost"]["seconds"].as_f64().unwrap() > 0.0);
            found["cost"]["seconds"] = serde_json::Value::Null;
        }
        json
    });
    assert_eq!(a, b);
}

fn resumed_equals_uninterrupted(case: &str, signals: &[(&str, [&str; 2], u64)]) {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path();
    fs::write(dir.join("case.toml"), [SYSTEM, case].concat()).unwrap();
    let (status, message) = run(dir, &["--out", "whole", "--quiet"]);
    assert_eq!((status, message.as_str()), (Some(0), ""));
    for (n, (signal, threads, more)) in signals.iter().enumerate() {
        if *signal != "-KILL" && ignores_signals() {
            eprintln!("skipped: this process was started with signals ignored, as by nohup");
            continue;
        }
        let out = format!("out{n}");
        let arguments = ["--out", &out, "--quiet", "--threads"];
        let child = start(dir, &[&arguments[..], &[threads[0]], OFTEN].concat());
        wait_for_a_box(dir, &out, *more);
        let (status, message) = end(child, signal);
        assert!(!dir.join(&out).exists());
        if *signal != "-KILL" {
            assert_eq!(status, Some(130), "{message}");
            let last = message.lines().last().unwrap();
            assert!(last.starts_with("favre: interrupted after "), "{message}");
            let hint = format!(
                "; what was simulated is kept in {out}.checkpoint, go on with `favre run case.toml \
                 --out {out} --resume`"
            );
            assert!(last.ends_with(&hint), "{message}");
        }
        let (status, message) = run(dir, &[&arguments[..], &[threads[1], "--resume"]].concat());
        assert_eq!((status, message.as_str()), (Some(0), ""));
        assert_same(&dir.join(&out), &dir.join("whole"));
        // Neither checkpoint nor partial folder is left.
        assert!(names(dir).iter().all(|name| !name.starts_with(&format!("{out}."))));
    }
}

#[test]
fn a_resumed_run_has_the_bytes_of_one_that_was_not_interrupted() {
    let signals =
        [("-INT", ["1", "2"], 60), ("-TERM", ["2", "1"], 200), ("-KILL", ["2", "3"], 150)];
    resumed_equals_uninterrupted(FLAT, &signals);
    resumed_equals_uninterrupted(SOLID, &[("-INT", ["2", "1"], 100), ("-KILL", ["1", "2"], 50)]);
}

#[test]
fn what_cannot_be_resumed_is_one_clear_message() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path();
    let text = [SYSTEM, SOLID].concat();
    fs::write(dir.join("case.toml"), &text).unwrap();
    let refused = |arguments: &[&str], parts: &[&str]| {
        let (status, message) = run(dir, &[&["--out", "out"], arguments].concat());
        assert_eq!(status, Some(2), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
        for part in parts {
            assert!(message.contains(part), "{message}\ndoes not hold {part}");
        }
    };
    refused(&["--resume"], &["nothing to go on from in out.checkpoint", "without --resume"]);
    refused(&["--resume", "--force"], &["give one of the two"]);
    assert_eq!(names(dir), ["case.toml"]);

    // Killed at once, it leaves what it kept last.
    let child = start(dir, &[&["--out", "out"], OFTEN].concat());
    wait_for_a_box(dir, "out", 0);
    end(child, "-KILL");
    refused(&[], &["out.checkpoint holds an interrupted run", "--resume", "--force"]);
    refused(&["--resume", "--duration", "10 u_t/g", "--force"], &["give one of the two"]);
    fs::write(dir.join("case.toml"), text.replace("1.8e-5", "1.7e-5")).unwrap();
    let parts = ["box_0.15.state is of another case", "[gas] viscosity = 1.8e-5 and not 1.7e-5"];
    refused(&["--resume"], &parts);
    fs::write(dir.join("case.toml"), text.replace("\"f32\"", "\"f64\"")).unwrap();
    refused(&["--resume"], &["[run] precision = \"f32\" and not \"f64\""]);
    fs::write(dir.join("case.toml"), text.replace("16, 16, 24", "32, 32, 48")).unwrap();
    refused(&["--resume"], &["[box] cells = [16, 16, 24] and not [32, 32, 48]"]);

    fs::write(dir.join("case.toml"), &text).unwrap();
    let file = dir.join("out.checkpoint/box_0.15.state");
    let kept = fs::read(&file).unwrap();
    fs::write(&file, &kept[..kept.len() / 2]).unwrap();
    refused(&["--resume"], &["box_0.15.state is damaged (its checksum", "remove it to simulate"]);
    // None of these took anything away.
    fs::write(&file, &kept).unwrap();
    let (status, message) = run(dir, &["--out", "out", "--resume", "--quiet"]);
    assert_eq!((status, message.as_str()), (Some(0), ""));

    let (status, message) = run(dir, &["--checkpoint-minutes", "-1"]);
    assert_eq!(status, Some(2));
    assert!(message.contains("'-1' for '--checkpoint-minutes <N>'"), "{message}");
    assert!(message.contains("a number of minutes from 0 to 525600 is accepted"), "{message}");
}

#[test]
fn a_run_whose_files_could_not_be_written_goes_on_from_its_end() {
    let base = tempfile::tempdir().unwrap();
    let dir = base.path();
    fs::write(dir.join("case.toml"), [SYSTEM, SOLID].concat()).unwrap();
    let child = start(dir, &[&["--out", "out", "--quiet"], OFTEN].concat());
    wait_for_a_box(dir, "out", 0);
    // A folder has the name that a table is to have.
    fs::create_dir(dir.join("out.partial/bins.csv")).unwrap();
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("favre: cannot write out/bins.csv"), "{message}");
    assert!(message.trim_end().ends_with("`favre run case.toml --out out --resume`"), "{message}");
    assert_eq!(names(dir), ["case.toml", "out.checkpoint"]);

    let (status, message) = run(dir, &["--out", "out", "--resume", "--quiet"]);
    assert_eq!((status, message.as_str()), (Some(0), ""));
    assert_eq!(names(dir), ["case.toml", "out"]);
}
