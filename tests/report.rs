//! The report of runs: that it carries the numbers of the bins, says what is missing, and that a browser
//! is content with it.

mod common;

use assert_cmd::cargo::cargo_bin;
use common::{SYSTEM, python};
use favre::report::{Folder, page};
use favre::summary::interval;
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
    let out = run_of(temp.path(), "out", CASE);
    (temp, out)
}

/// A run of the common powder in the folder `name` of `dir`.
fn run_of(dir: &Path, name: &str, case: &str) -> PathBuf {
    fs::write(dir.join(format!("{name}.toml")), [SYSTEM, case].concat()).unwrap();
    let (status, said) = favre(dir, &["run", &format!("{name}.toml"), "--quiet", "--out", name]);
    assert_eq!(status, 0, "{said}");
    dir.join(name)
}

/// run.json of the folder of a run.
fn facts(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(out.join("run.json")).unwrap()).unwrap()
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

fn base64_of(bytes: &[u8]) -> String {
    use base64::Engine;
    base64::engine::general_purpose::STANDARD.encode(bytes)
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
    // The film strips are those of the folder, from where the statistics start on.
    for b in facts(&out)["boxes"].as_array().unwrap() {
        let name = format!("film_{}.png", b["solids_fraction"]);
        let png = fs::read(out.join(&name)).unwrap();
        assert!(html.contains(&base64_of(&png)), "{name}");
        let film = &b["film"];
        assert_eq!(film["filter_width"], 0.01);
        let times: Vec<f64> = serde_json::from_value(film["times"].clone()).unwrap();
        assert!(times.len() == 5 && times[0] >= b["start"].as_f64().unwrap(), "{times:?}");
        assert!(times.windows(2).all(|pair| pair[0] < pair[1]), "{times:?}");
        let caption = format!("what a filter of 1 cm makes of it ({name})");
        assert!(html.contains(&caption), "{caption}");
    }
    // The page made again from the folder is that of the run.
    let command = format!("favre report {}", "out");
    let folder = Folder { path: "out".into(), ..Folder::read(&out).unwrap() };
    assert!(page(&[folder], &command) == html);
}

#[test]
fn what_is_missing_is_said_and_the_rest_is_drawn() {
    let (temp, out) = run();
    for file in ["model.toml", "closures.csv"] {
        fs::remove_file(out.join(file)).unwrap();
    }
    for picture in ["field_0.1.png", "field_0.2.png", "film_0.1.png", "film_0.2.png"] {
        fs::remove_file(out.join(picture)).unwrap();
    }
    let html = reported(temp.path(), &["out"]);
    for file in ["model.toml is", "closures.csv is", "field_*.png are", "film_*.png are"] {
        assert!(html.contains(&format!("{file} not there")), "{file}");
    }
    // One run says nothing of its grid, and says so.
    assert!(html.contains("One grid and one box") && !html.contains("id=\"dependence\""));
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
fn grids_stand_beside_each_other() {
    let (temp, out) = run();
    let grids = ["[24, 24]", "[16, 16]"].map(|cells| {
        let name = format!("cells-{}", &cells[1..3]);
        run_of(temp.path(), &name, &CASE.replace("[32, 32]", cells).replace("0.005, ", ""))
    });
    let folders = [&out, &grids[0], &grids[1]];
    let html = reported(temp.path(), &["out", "cells-24", "cells-16"]);
    let rows = numbers(&html, "slip_against_cells-0");
    for folder in folders {
        let facts = facts(folder);
        let cell = 0.04 / facts["case"]["box"]["cells"][0].as_f64().unwrap();
        let scaled = cell / facts["scales"]["length_ii"].as_f64().unwrap();
        for b in facts["boxes"].as_array().unwrap() {
            let slip = b["slip"]["mean"].as_f64().unwrap();
            let half = 1.96 * b["slip"]["standard_error"].as_f64().unwrap();
            let row = rows.iter().find(|row| row["mean slip / u_t [-]"].parse() == Ok(slip));
            let row = row.unwrap_or_else(|| panic!("{slip} is not in {rows:?}"));
            let number = |key: &str| row[key].parse::<f64>().unwrap();
            assert!((number("cell/L_II [-]") / scaled - 1.0).abs() < 1e-12);
            assert!((number("low_95") - (slip - half)).abs() < 1e-12);
        }
    }
    assert!(!numbers(&html, "slip_against_cost-0").is_empty());
    assert!(!html.contains("id=\"slip_against_box-0\""));
    let section = html.split("id=\"dependence\"").nth(1).unwrap();
    let section = section.split("</section>").next().unwrap();
    // Two mean fractions, of three grids each, and H at a width that all have.
    assert_eq!(section.matches("different grids: the slips of").count(), 2);
    let bins = read_bins(&out.join("bins.csv")).unwrap();
    let bin = bins.iter().find(|b| {
        b.quantity == "drag_correction"
            && b.filter_width == 0.01
            && (b.solids_fraction_low..b.solids_fraction_high).contains(&0.1)
    });
    let bin = bin.unwrap();
    assert!(section.contains(&interval(bin.value, bin.standard_error)));
    let (status, said) =
        favre(temp.path(), &["report", "out", "cells-24", "cells-16", "--figures", "figures"]);
    assert_eq!(status, 0, "{said}");
    assert!(temp.path().join("figures/slip_against_cells.svg").exists());
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
    let Some(python) = python("playwright, axe_core_python") else { return };
    if !Path::new("/usr/bin/chromium").exists() {
        eprintln!("skipped: Chromium is not installed");
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
