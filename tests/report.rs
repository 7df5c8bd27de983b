//! The report of runs: that it carries the numbers of the bins, says what is missing, and that a browser
//! is content with it.

mod common;

use assert_cmd::cargo::cargo_bin;
use common::SYSTEM;
use favre::report::{Folder, page};
use favre::table::read_bins;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// What a small run asks for beside the common powder and gas.
const CASE: &str = r#"
[box]
size = [0.04, 0.04]
cells = [32, 32]
solids_fraction = [0.1, 0.2]
[filter]
widths = [0.005, 0.01, 0.02]
[run]
duration = "60 u_t/g"
"#;

/// Exit status and standard error of a call.
fn favre(dir: &Path, arguments: &[&str]) -> (i32, String) {
    let Output { status, stderr, .. } =
        Command::new(cargo_bin!("favre")).current_dir(dir).args(arguments).output().unwrap();
    (status.code().unwrap(), String::from_utf8(stderr).unwrap())
}

/// The page of `folders` in `dir`.
fn reported(dir: &Path, folders: &[&str]) -> String {
    let arguments = [&["report", "--out", "page.html"], folders].concat();
    let (status, said) = favre(dir, &arguments);
    assert_eq!(status, 0, "{said}");
    fs::read_to_string(dir.join("page.html")).unwrap()
}

/// A run of [`CASE`] in a folder of its own.
fn run() -> (TempDir, PathBuf) {
    let temp = TempDir::new().unwrap();
    fs::write(temp.path().join("small.toml"), [SYSTEM, CASE].concat()).unwrap();
    let (status, said) = favre(temp.path(), &["run", "small.toml", "--quiet", "--out", "out"]);
    assert_eq!(status, 0, "{said}");
    let out = temp.path().join("out");
    (temp, out)
}

/// The attribute `name` wherever it stands in `text`.
fn attributes<'a>(text: &'a str, name: &str) -> Vec<&'a str> {
    let start = format!("{name}=\"");
    text.split(&start).skip(1).map(|rest| rest.split('"').next().unwrap()).collect()
}

/// The table behind the figure `id`.
fn numbers(html: &str, id: &str) -> Vec<BTreeMap<String, String>> {
    let figure = html.split(&format!("<figure id=\"{id}\">")).nth(1).expect("the figure is there");
    let link = attributes(figure, "href")[0];
    let bytes = favre_base64(link.strip_prefix("data:text/csv;base64,").unwrap());
    let mut table = csv::Reader::from_reader(bytes.as_slice());
    table.deserialize().map(Result::unwrap).collect()
}

fn favre_base64(text: &str) -> Vec<u8> {
    use base64::Engine;
    base64::engine::general_purpose::STANDARD.decode(text).unwrap()
}

#[test]
fn a_page_carries_the_numbers_of_the_bins() {
    let (_temp, out) = run();
    let html = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(html.len() < 3_000_000, "{} bytes", html.len());
    let bins = read_bins(&out.join("bins.csv")).unwrap();
    let wanted: Vec<_> = bins
        .iter()
        .filter(|b| {
            b.quantity == "drag_correction" && b.high_95.is_finite() && b.low_95.is_finite()
        })
        .collect();
    assert!(wanted.len() > 10);
    let rows = numbers(&html, "closure-0");
    let (x, y) = ("filtered solids fraction φ [-]", "drag correction H [-]");
    for bin in &wanted {
        let row = rows
            .iter()
            .find(|row| {
                row[x].parse() == Ok(bin.solids_fraction) && row[y].parse() == Ok(bin.value)
            })
            .unwrap_or_else(|| panic!("{bin:?} is not in the page"));
        assert_eq!(row["low_95"].parse(), Ok(bin.low_95));
        assert_eq!(row["high_95"].parse(), Ok(bin.high_95));
    }
    // Each is drawn once and says its numbers.
    let figure = html.split("<figure id=\"closure-0\">").nth(1).unwrap();
    let figure = figure.split("</figure>").next().unwrap();
    assert_eq!(figure.matches("<circle").count(), wanted.len());
    let said = figure.split("<title>").skip(1).map(|rest| rest.split('<').next().unwrap());
    assert_eq!(said.filter(|text| text.contains("95 % interval")).count(), wanted.len());
    // The page made again from the folder is that of the run.
    let command = format!("favre report {}", "out");
    let folder = Folder { path: "out".into(), ..Folder::read(&out).unwrap() };
    assert!(page(&[folder], &command) == html);
}

#[test]
fn what_is_missing_is_said_and_the_rest_is_drawn() {
    let (temp, out) = run();
    for file in ["model.toml", "closures.csv", "field_0.1.png", "field_0.2.png"] {
        fs::remove_file(out.join(file)).unwrap();
    }
    let html = reported(temp.path(), &["out"]);
    for text in
        ["model.toml is not there", "closures.csv is not there", "field_*.png are not there"]
    {
        assert!(html.contains(text), "{text}");
    }
    assert!(!numbers(&html, "closure-0").is_empty());

    // One filter width: no slope, and points all the same.
    let bins = fs::read_to_string(out.join("bins.csv")).unwrap();
    let mut lines = bins.lines();
    let head = lines.next().unwrap();
    let width = lines.clone().next().unwrap().split(',').nth(2).unwrap().to_owned();
    let one = lines.filter(|line| line.split(',').nth(2) == Some(&*width));
    let text: Vec<&str> = std::iter::once(head).chain(one).collect();
    fs::write(out.join("bins.csv"), text.join("\n")).unwrap();
    let html = reported(temp.path(), &["out"]);
    assert!(!numbers(&html, "closure-0").is_empty() && !html.contains("slope "));

    // No bins at all.
    fs::write(out.join("bins.csv"), format!("{head}\n")).unwrap();
    let html = reported(temp.path(), &["out"]);
    assert!(html.contains("bins.csv has no row of a quantity that is shown here"));
    assert!(html.contains("Mean slip over time"));

    // No run.
    let (status, error) = favre(temp.path(), &["report", "."]);
    assert!(status == 2 && error.contains("neither run.json nor bins.csv is in it"), "{error}");
    let (status, error) = favre(temp.path(), &["report", "nowhere"]);
    assert!(status == 2 && error.contains("there is no such folder"), "{error}");
}

#[test]
fn many_runs_make_one_page() {
    let (temp, out) = run();
    let names: Vec<String> = (0..12).map(|i| format!("run-{i}")).collect();
    for name in &names {
        let to = temp.path().join(name);
        fs::create_dir(&to).unwrap();
        for entry in fs::read_dir(&out).unwrap() {
            let entry = entry.unwrap();
            fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
        }
    }
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let html = reported(temp.path(), &names);
    assert_eq!(html.matches("<details class=\"run\"").count(), 12);
    assert!(html.len() < 3_000_000, "{} bytes", html.len());
    let ids = attributes(&html, " id");
    let mut different = ids.clone();
    different.sort_unstable();
    different.dedup();
    assert_eq!(ids.len(), different.len(), "an identifier stands twice");
}

#[test]
fn a_browser_is_content() {
    let python = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/venv/bin/python");
    let ready = Command::new(&python)
        .args(["-c", "import playwright, axe_core_python"])
        .output()
        .is_ok_and(|output| output.status.success());
    if !ready || !Path::new("/usr/bin/chromium").exists() {
        eprintln!(
            "skipped: Chromium, or Playwright and axe-core in target/venv, are not installed"
        );
        return;
    }
    let (temp, out) = run();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/report.py");
    let output = Command::new(python)
        .arg(script)
        .arg(out.join("report.html"))
        .arg(temp.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for key in ["console", "requests", "violations"] {
        assert_eq!(found[key], serde_json::json!([]), "{key}");
    }
    for window in ["desktop", "phone"] {
        let said = found["hover"][window].as_str().unwrap();
        assert!(said.contains("drag correction H [-] = "), "{said}");
        assert_eq!(found["overflow"][window], 0, "{window}");
    }
}
