//! Files for ParaView: the real VTK, PyVista and h5py find the values, axes, units and times in every
//! kind of file that is written.
//!
//! `.ci/run` installs them; where one is missing a test says so and does nothing.

mod common;

use assert_cmd::cargo::cargo_bin;
use common::{SYSTEM, python};
use favre::resolved::vtk;
use favre::resolved::xml::{Points, write_points, write_series};
use std::fs;
use std::path::Path;
use std::process::Command;

const FLAT: &str = r#"[box]
size = [0.04, 0.06]
cells = [16, 24]
solids_fraction = 0.15
[filter]
widths = [0.005, 0.01]
[run]
duration = "20 u_t/g"
[output]
fields = "vti"
"#;

const SOLID: &str = r#"[box]
size = [0.02, 0.025, 0.03]
cells = [8, 10, 12]
solids_fraction = 0.15
[filter]
widths = [0.005]
[run]
duration = "8 u_t/g"
[output]
fields = "vti"
"#;

/// What the tests read files with.
const MODULES: &str = "vtk, pyvista, h5py";

fn succeeds(command: &mut Command) {
    let output = command.output().unwrap();
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
}

fn favre(dir: &Path, arguments: &[&str]) {
    succeeds(Command::new(cargo_bin!("favre")).current_dir(dir).args(arguments));
}

fn check(python: &Path, dir: &Path, script: &str) {
    succeeds(Command::new(python).current_dir(dir).args(["tests.py", script]));
}

/// What the tests share, and one function per test.
const CHECKS: &str = include_str!("paraview.py");

fn fly(dir: &Path, case: &str) {
    fs::write(dir.join("tests.py"), CHECKS).unwrap();
    fs::write(dir.join("case.toml"), format!("{SYSTEM}{case}")).unwrap();
    favre(dir, &["simulate", "case.toml", "--out", "flight", "--quiet"]);
    for format in ["vti", "vtkhdf"] {
        favre(dir, &["filter", "flight/fields_0.15", "--fields", format, "--out", format]);
        // The bins are those that there would be without fields.
        let bins = |run: &str| fs::read_to_string(dir.join(run).join("bins.csv")).unwrap();
        assert!(bins(format) == bins("flight"), "{format}");
    }
}

#[test]
fn vtk_pyvista_and_h5py_read_resolved_and_filtered_fields_alike() {
    let Some(python) = python(MODULES) else { return };
    for case in [FLAT, SOLID] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        fly(dir, case);
        check(&python, dir, "fields");
    }
}

#[test]
fn vtk_and_pyvista_read_particles() {
    let Some(python) = python(MODULES) else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::write(dir.join("tests.py"), CHECKS).unwrap();
    // The script knows this rule: list k of particle n at time t is k + n/8 + t.
    let count = 40_000;
    for instant in 0..3 {
        let time = 0.25 * instant as f64;
        let list = |k: usize| -> Vec<f64> {
            (0..count).map(|n| k as f64 + n as f64 / 8.0 + time).collect()
        };
        let lists: Vec<Vec<f64>> = (0..10).map(list).collect();
        let id: Vec<f64> = (0..count).map(|n| (count - n) as f64).collect();
        let vector = |k: usize| [&lists[k][..], &lists[k + 1], &lists[k + 2]];
        let points = Points {
            time,
            position: vector(0),
            velocity: vector(3),
            spin: vector(6),
            diameter: &lists[9],
            id: &id,
        };
        let path = dir.join(format!("particles_{instant}.vtp"));
        write_points(&path, &points).unwrap();
        assert!(vtk::read(&path, &|_| true).unwrap().particles);
        assert!(fs::metadata(&path).unwrap().len() < 11 * 8 * count as u64, "not compressed");
    }
    let files = (0..3).map(|n| (0.25 * n as f64, format!("particles_{n}.vtp")));
    write_series(&mut fs::File::create(dir.join("particles.pvd")).unwrap(), files).unwrap();
    check(&python, dir, "particles");
}

#[test]
fn widths_are_those_asked_for_and_sums_have_no_fields() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::write(dir.join("case.toml"), format!("{SYSTEM}{FLAT}")).unwrap();
    favre(dir, &["simulate", "case.toml", "--out", "flight", "--quiet"]);
    let fields = "flight/fields_0.15";
    favre(dir, &["filter", fields, "--widths", "0.0075", "--fields", "vti", "--out", "wide"]);
    let series = fs::read_to_string(dir.join("wide/filtered_0.0075.pvd")).unwrap();
    let first = vtk::read(&dir.join("wide/filtered_0.0075/000001.vti"), &|_| true).unwrap();
    assert!(series.contains(&format!("timestep=\"{:?}\"", first.time.unwrap())), "{series}");
    assert!(!dir.join("wide/filtered_0.005.pvd").exists());
    let bins = fs::read_to_string(dir.join("wide/bins.csv")).unwrap();
    assert!(bins.contains("0.0075") && !bins.contains("drag_correction,0.005,"), "{bins:.500}");

    for (arguments, says) in [
        (&["filter", fields, "--widths", "0.003"][..], "0.003"),
        (&["filter", "flight", "--fields", "vti"], "give the run's snapshots"),
    ] {
        let mut command = Command::new(cargo_bin!("favre"));
        let output = command.current_dir(dir).args(arguments).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(says), "{message}");
    }
}
