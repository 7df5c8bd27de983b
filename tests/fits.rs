//! `favre fit` and `favre exponents` as their users meet them.

use assert_cmd::cargo::cargo_bin;
use favre::closure::Closure;
use favre::table::{BinRow, parse_bins, write_rows};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Bins of the default run.
const BINS: &str = include_str!("../data/default/drag_correction.csv");

fn favre(dir: &Path, args: &[&str]) -> Output {
    Command::new(cargo_bin!("favre")).current_dir(dir).args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn done(output: &Output) -> String {
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

fn rows() -> Vec<BinRow> {
    parse_bins(BINS.as_bytes(), Path::new("bins.csv")).unwrap()
}

fn written(rows: &[BinRow], path: &Path) {
    let mut bytes = Vec::new();
    write_rows(rows, &mut bytes).unwrap();
    fs::write(path, bytes).unwrap();
}

/// A table with one number of its third row replaced.
fn spoilt(column: &str, value: &str) -> String {
    let mut lines: Vec<String> = BINS.lines().map(str::to_owned).collect();
    let at = lines[0].split(',').position(|name| name == column).unwrap();
    let mut fields: Vec<&str> = lines[3].split(',').collect();
    fields[at] = value;
    lines[3] = fields.join(",");
    lines.join("\n")
}

#[test]
fn bins_are_fitted_and_the_closure_is_one_like_any_other() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("bins.csv"), BINS).unwrap();
    let fitted = favre(dir.path(), &["fit", "bins.csv", "--out", "fit", "--replicates", "60"]);
    let out = done(&fitted);
    assert!(out.contains("saturating_drag") && out.contains("H_inf = 0."), "{out}");
    assert!(out.contains("spline is the closure"), "{out}");
    assert!(out.contains("intervals take each bin's standard error as its own"), "{out}");
    let path = dir.path().join("fit/model.toml");
    let closure = Closure::find(path.to_str().unwrap()).unwrap();
    let quantity = &closure.quantities[0];
    for vector in &quantity.file.test_vectors {
        let found = quantity.at(&quantity.point(vector));
        assert!((found - vector.expected).abs() <= 1e-12, "{vector:?} {found}");
    }
    // The curve lies within the intervals of the bins that it was fitted to, 95 % of which it may.
    let known: Vec<BinRow> =
        rows().into_iter().filter(|row| row.standard_error.is_finite()).collect();
    let held = known.iter().filter(|row| {
        let found = quantity.at(&[row.solids_fraction, row.filter_width_l_i]);
        row.low_95 <= found && found <= row.high_95
    });
    let held = held.count();
    assert!(held as f64 >= 0.95 * known.len() as f64, "{held} of {}", known.len());
    let curve = closure.file.fit.as_ref().unwrap().curve.as_ref().unwrap();
    assert!(curve.low_95.iter().zip(&curve.high_95).any(|(low, high)| low < high));
    let checked = favre(dir.path(), &["models", "check", "fit/model.toml"]);
    assert!(checked.status.success(), "{}", text(&checked.stdout));
    // Again gives the same.
    done(&favre(dir.path(), &["fit", "bins.csv", "--out", "again", "--replicates", "60"]));
    let read = |folder: &str| fs::read(dir.path().join(folder).join("model.toml")).unwrap();
    assert!(read("fit") == read("again"));
}

#[test]
fn a_users_own_form_is_fitted() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("bins.csv"), BINS).unwrap();
    let form = "name = \"mine\"\npredicts = \"drag_correction\"\nunit = \"-\"\n\
                markers = [\"solids_fraction\", \"filter_width\"]\n\
                formula = \"a*D/(D + b)*phi/(phi + c)*(1 - phi)\"\n\
                [[parameters]]\nname = \"a\"\nstart = 0.8\nlow = 0.0\nhigh = 1.0\n\
                [[parameters]]\nname = \"b\"\nstart = 1.0\nlow = 0.0\n\
                [[parameters]]\nname = \"c\"\nstart = 0.01\nlow = 0.0\n";
    fs::write(dir.path().join("form.toml"), form).unwrap();
    let args = ["fit", "bins.csv", "--form", "form.toml", "--out", "fit", "--replicates", "60"];
    let out = done(&favre(dir.path(), &args));
    assert!(out.contains("mine") && out.contains("b = 1."), "{out}");
    let exported = ["export", "fit/model.toml", "--to", "c", "--out", "c"];
    done(&favre(dir.path(), &exported));
    let args = ["fit", "bins.csv", "--form", "no_such", "--out", "none"];
    let output = favre(dir.path(), &args);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("there is no form no_such"), "{message}");
    assert!(message.contains("known: spline, saturating_drag"), "{message}");
}

#[test]
fn bad_bins_are_refused_in_one_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |table: &str, form: &str| {
        fs::write(dir.path().join("bad.csv"), table).unwrap();
        let args = ["fit", "bad.csv", "--form", form, "--out", "none", "--replicates", "40"];
        let output = favre(dir.path(), &args);
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{message}");
        assert!(!dir.path().join("none").exists());
        message
    };
    let head: Vec<&str> = BINS.lines().take(7).collect();
    let few = refused(&head.join("\n"), "saturating_drag");
    assert!(few.contains("saturating_drag: 6 rows with a finite standard error, 8"), "{few}");
    let few = refused(&head.join("\n"), "spline");
    assert!(few.contains("spline: 6 rows with a finite standard error, 12"), "{few}");
    let negative = refused(&spoilt("standard_error", "-0.01"), "spline");
    for part in ["bad.csv", "line 4", "standard_error", "-0.01"] {
        assert!(negative.contains(part), "{negative}");
    }
    for (column, value) in [("value", "NaN"), ("solids_fraction [-]", "NaN")] {
        let nan = refused(&spoilt(column, value), "spline");
        assert!(nan.contains("line 4") && nan.contains(column) && nan.contains("NaN"), "{nan}");
    }
    let millimetres = BINS.replacen("filter_width [m]", "filter_width [mm]", 1);
    let unit = refused(&millimetres, "spline");
    assert!(unit.contains("filter_width [mm]") || unit.contains("filter_width [m]"), "{unit}");
    let mixed = refused(&spoilt("filter_width [m]", "5"), "saturating_drag");
    assert!(mixed.contains("row 3: filter_width over filter_width/L_I"), "{mixed}");
    let percent = refused(&spoilt("solids_fraction [-]", "2.9"), "spline");
    assert!(percent.contains("solids_fraction [-]") && percent.contains("2.9"), "{percent}");
    // A table of an earlier version, without the slip speed.
    let cut: Vec<String> =
        BINS.lines().map(|line| line.split(',').take(18).collect::<Vec<_>>().join(",")).collect();
    let missing = refused(&cut.join("\n"), "slip_drag");
    assert!(missing.contains("the form slip_drag needs slip, which row 1"), "{missing}");
    let other = refused(BINS, "smagorinsky");
    assert!(other.contains("smagorinsky: 0 rows with a finite standard error"), "{other}");
}

#[test]
fn poor_bins_are_fitted_with_less_and_it_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("poor.csv");
    let fitted = |rows: &[BinRow], form: &str| {
        written(rows, &path);
        let args = ["fit", "poor.csv", "--form", form, "--force", "--replicates", "60"];
        done(&favre(dir.path(), &args))
    };
    let narrow: Vec<BinRow> =
        rows().into_iter().filter(|row| (row.filter_width - 0.01).abs() < 1e-6).collect();
    assert!(narrow.len() > 12);
    let one = fitted(&narrow, "saturating_drag");
    assert!(one.contains("All rows have one filter width, 2.05"), "{one}");
    assert!(one.contains("The data do not fix exponent (p)"), "{one}");
    assert!(one.contains("p = 1.2970, not fixed by the data"), "{one}");
    let one = fitted(&narrow, "spline");
    assert!(one.contains("All rows have one filter width, 2.05"), "{one}");
    // Nothing above says where H closes.
    let dilute: Vec<BinRow> =
        rows().into_iter().filter(|row| row.solids_fraction_high < 0.2).collect();
    let open = fitted(&dilute, "saturating_drag");
    assert!(open.contains("The data do not fix closing_fraction (phi_c)"), "{open}");
    let unseen = fitted(&rows(), "slip_drag");
    assert!(unseen.contains("The rows are not binned by slip"), "{unseen}");
}

#[test]
fn exponents_of_powders_are_told_or_why_not() {
    let dir = tempfile::tempdir().unwrap();
    // The same curve in Δ_f/L(n), n = -0.4, of three powders.
    let exact = |froude: f64| {
        let mut rows = rows();
        rows.retain(|row| row.standard_error.is_finite());
        for (i, row) in rows.iter_mut().enumerate() {
            let z = row.filter_width_l_i.ln() + 0.4 * froude.ln();
            let wiggle = 1e-3 * (1.7 * i as f64).sin();
            row.value = (1.0 - row.solids_fraction) * (0.3 + 0.1 * z) + wiggle;
            (row.value_scaled, row.standard_error) = (row.value, 2e-3);
            row.filter_width_l_ii = row.filter_width_l_i * froude.powf(2.0 / 3.0);
        }
        rows
    };
    for (name, froude) in [("a.csv", 10.0), ("b.csv", 60.0), ("c.csv", 300.0)] {
        written(&exact(froude), &dir.path().join(name));
    }
    let out = done(&favre(dir.path(), &["exponents", "a.csv", "b.csv", "c.csv"]));
    assert!(
        out.contains("drag_correction: L(n) = L_I Fr_p^n collapses best with n = -0.4"),
        "{out}"
    );
    assert!(out.contains("a constant n is not doubted"), "{out}");
    assert!(out.contains("slip: 0 rows"), "{out}");
    let one = done(&favre(dir.path(), &["exponents", "a.csv", "a.csv"]));
    assert!(one.contains("all runs have Fr_p = 10.0000"), "{one}");
}
