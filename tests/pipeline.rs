//! The whole chain through the binary: every example, the same bytes again, what the tables say.

mod common;

use assert_cmd::Command;
use common::SYSTEM;
use favre::closure::Closure;
use favre::table::{BinRow, read_bins};
use std::fs;
use std::path::Path;

/// A box that clusters within seconds.
const SMALL: &str = r#"
[box]
size = [0.08, 0.08]
cells = [64, 64]
solids_fraction = [0.1, 0.2]
[filter]
widths = [0.005, 0.01, 0.02, 0.04]
[run]
duration = "80 u_t/g"
"#;

fn run(case: &Path, out: &Path, arguments: &[&str]) {
    let mut command = Command::cargo_bin("favre").unwrap();
    command.arg("run").arg(case).arg("--out").arg(out).arg("--quiet").args(arguments);
    command.assert().success();
}

#[test]
fn every_example_runs_shortened() {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let folder = tempfile::tempdir().unwrap();
    let mut seen = 0;
    for entry in fs::read_dir(examples).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let out = folder.path().join(&name);
        run(&path, &out, &["--duration", "12 u_t/g"]);
        let bins = read_bins(&out.join("bins.csv")).unwrap();
        assert!(!bins.is_empty(), "{name}");
        for file in ["run.json", "case.toml", "signals.csv"] {
            assert!(out.join(file).exists(), "{name} leaves no {file}");
        }
        // Momentum and mass were kept, whatever the dimension and the powder.
        let json: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(out.join("run.json")).unwrap()).unwrap();
        for found in json["boxes"].as_array().unwrap() {
            assert!(found["cost"]["mass_change"].as_f64().unwrap().abs() < 1e-12, "{name}");
            assert!(found["cost"]["momentum_change"].as_f64().unwrap() < 1e-9, "{name}");
        }
        seen += 1;
    }
    assert!(seen >= 4);
}

#[test]
fn a_clustered_box_gives_a_closure_and_the_same_bytes_again() {
    let folder = tempfile::tempdir().unwrap();
    let case = folder.path().join("small.toml");
    // Boxes this small tell as much as a closure needs only in this time, and if no gas channel
    // short-circuits one of them for much of it.
    let longer = SMALL.replace("80 u_t/g", "160 u_t/g").replace("[run]", "[run]\nseed = 2");
    fs::write(&case, [SYSTEM, &longer].concat()).unwrap();
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    run(&case, &first, &["--threads", "2"]);
    run(&case, &second, &["--threads", "1"]);
    for file in ["bins.csv", "closures.csv", "model.toml", "signals.csv", "closures.svg"] {
        let [a, b] = [&first, &second].map(|dir| fs::read(dir.join(file)).unwrap());
        assert!(a == b, "{file} differs between two runs of the same case");
    }

    let bins = read_bins(&first.join("bins.csv")).unwrap();
    drag_correction_rises_with_filter_width(&bins);
    let viscosity = bins.iter().filter(|row| row.quantity == "solids_viscosity");
    assert!(viscosity.filter(|row| row.value > 0.0).count() > 20);

    let path = first.join("model.toml");
    let model = Closure::find(path.to_str().unwrap()).unwrap();
    let drag = model.quantity(Some("drag_correction")).unwrap();
    for vector in &drag.file.test_vectors {
        assert!((drag.at(&drag.point(vector)) - vector.expected).abs() <= 1e-12, "{vector:?}");
    }
    let fit = model.file.fit.as_ref().unwrap();
    assert!(fit.goodness.r_squared > 0.8, "{:?}", fit.goodness);
    assert_eq!(drag.at(&[0.15, 0.0]), 0.0);
}

/// H of well-populated bins lies in [0, 1) and grows with the filter width at the same fraction.
fn drag_correction_rises_with_filter_width(bins: &[BinRow]) {
    let mut rows: Vec<&BinRow> = bins
        .iter()
        .filter(|row| row.quantity == "drag_correction" && row.standard_error < 0.05)
        .collect();
    rows.sort_by(|a, b| {
        let key = |row: &BinRow| (row.solids_fraction_low, row.filter_width);
        key(a).partial_cmp(&key(b)).unwrap()
    });
    assert!(rows.len() > 20, "{} well-populated bins", rows.len());
    let mut pairs = 0;
    for pair in rows.windows(2) {
        assert!((0.0..1.0).contains(&pair[0].value), "{:?}", pair[0]);
        if pair[0].solids_fraction_low == pair[1].solids_fraction_low {
            // The intervals, of Student's t, are what is claimed to cover; for normal errors this
            // is stricter than three standard errors of the difference.
            assert!(pair[1].high_95 > pair[0].low_95, "{:?} {:?}", pair[0], pair[1]);
            pairs += 1;
        }
    }
    assert!(pairs > 10, "{pairs} pairs of widths");
}

#[test]
fn runs_are_pooled_from_their_sums() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let markers =
        "markers = [\"solids_fraction\", \"shear_rate\"]\nshear_rate_edges = \"3 quantiles\"\n";
    for seed in [1, 2] {
        let case = at(&format!("seed-{seed}.toml"));
        let text =
            [SYSTEM, SMALL].concat().replace("[run]", &format!("{markers}[run]\nseed = {seed}"));
        fs::write(&case, text).unwrap();
        run(&case, &at(&seed.to_string()), &["--duration", "30 u_t/g"]);
    }
    let filter = |runs: &[&str], out: &str| {
        let mut command = Command::cargo_bin("favre").unwrap();
        command.arg("filter").args(runs.iter().map(|run| at(run))).arg("--out").arg(at(out));
        command.assert()
    };
    // A pool of one run is that run.
    filter(&["1"], "alone").success();
    let bytes = |name: &str| fs::read(at(name).join("bins.csv")).unwrap();
    assert!(bytes("alone") == bytes("1"));
    let said = filter(&["1", "2"], "both").success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    assert!(said.starts_with("4 runs pooled"), "{said}");
    assert!(said.contains("compared bin by bin"), "{said}");
    let samples = |name: &str| -> u64 {
        let rows = read_bins(&at(name).join("bins.csv")).unwrap();
        let one = rows.iter().filter(|row| row.quantity == "slip" && row.filter_width == 0.01);
        one.map(|row| row.samples).sum()
    };
    assert_eq!(samples("both"), samples("1") + samples("2"));
    // A pool is pooled as its runs are, whichever file is named; a run counts once.
    filter(&["both/sums.favre"], "again").success();
    assert!(bytes("again") == bytes("both"));
    let refused = filter(&["both", "2"], "twice").failure().code(2);
    let said = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    assert!(said.contains("a run counts once"), "{said}");
    assert!(!at("twice").exists());
    filter(&["none"], "nothing").failure().code(2);
}

#[test]
fn runs_on_two_grids_are_extrapolated_and_not_averaged() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for cells in ["32", "64"] {
        let case = at(&format!("{cells}.toml"));
        let text = [SYSTEM, SMALL]
            .concat()
            .replace("[64, 64]", &format!("[{cells}, {cells}]"))
            .replace("[0.005, 0.01, 0.02, 0.04]", "[0.01, 0.02]");
        fs::write(&case, text).unwrap();
        run(&case, &at(cells), &["--duration", "40 u_t/g"]);
    }
    let filter = |arguments: &[&str], out: &str| {
        let mut command = Command::cargo_bin("favre").unwrap();
        command.arg("filter").args([at("32"), at("64")]).args(arguments).arg("--out").arg(at(out));
        command.assert()
    };
    let said = filter(&[], "both").success();
    let said = String::from_utf8(said.get_output().stdout.clone()).unwrap();
    assert!(said.contains("2 grids, cells of 1.2500 mm, 2.5000 mm"), "{said}");
    assert!(said.contains("stated order 1.00"), "{said}");
    // Values are those on the finer grid, bit for bit.
    let [both, fine, coarse] =
        ["both", "64", "32"].map(|name| read_bins(&at(name).join("bins.csv")).unwrap());
    assert_eq!(both.len(), fine.len());
    let mut extrapolated = 0;
    for (row, fine) in both.iter().zip(&fine) {
        assert_eq!((row.value, row.standard_error), (fine.value, fine.standard_error));
        let Some(coarse) = coarse.iter().find(|coarse| coarse.bin() == row.bin()) else { continue };
        let Some(limit) = row.extrapolated else { continue };
        // At first order and twice the cells: 2 f(h) - f(2 h).
        let expected = 2.0 * row.value - coarse.value;
        let size = row.value.abs().max(coarse.value.abs());
        assert!((limit - expected).abs() < 1e-9 * size, "{row:?}");
        assert!((row.grid_error.unwrap() - (coarse.value - row.value)).abs() < 1e-9 * size);
        let error = (2.0 * row.standard_error).hypot(coarse.standard_error);
        assert!((row.extrapolated_standard_error.unwrap() - error).abs() <= 1e-9 * error);
        extrapolated += 1;
    }
    assert!(extrapolated > 200, "{extrapolated}");
    // Of second order the finer grid is a third of the difference off.
    filter(&["--grid-order", "2"], "second").success();
    let second = read_bins(&at("second").join("bins.csv")).unwrap();
    let error = |rows: &[BinRow]| rows.iter().find_map(|row| row.grid_error).unwrap();
    assert!((3.0 * error(&second) - error(&both)).abs() < 1e-9 * error(&both).abs());
    let refused = filter(&["--grid-order", "0"], "none").failure().code(2);
    let said = String::from_utf8(refused.get_output().stderr.clone()).unwrap();
    assert!(said.contains("0.1 to 10"), "{said}");
}
