//! `favre models` as its users meet it.

use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use assert_cmd::cargo::cargo_bin;
use favre::closure::{BUILT_IN, Closure};

fn favre(dir: &Path, args: &[&str], input: &[u8]) -> Output {
    let mut child = Command::new(cargo_bin!("favre"))
        .current_dir(dir)
        .arg("models")
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Written beside reading, or both sides wait; a command that refuses its arguments does not read.
    let mut stdin = child.stdin.take().unwrap();
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let _ = stdin.write_all(input);
        });
        child.wait_with_output().unwrap()
    })
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

fn done(output: &Output) -> String {
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

fn refused(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(2));
    text(&output.stderr)
}

#[test]
fn closures_are_listed_shown_and_checked() {
    let dir = tempfile::tempdir().unwrap();
    let listed = done(&favre(dir.path(), &["list"], b""));
    assert_eq!(listed.lines().count(), BUILT_IN.len());
    assert!(listed.contains("milioli-2013 ") && listed.contains("partial"));
    let shown = done(&favre(dir.path(), &["show", "milioli-2013", "--all"], b""));
    // What is shown is a closure file.
    fs::write(dir.path().join("mine.toml"), &shown).unwrap();
    let checked = done(&favre(dir.path(), &["check", "mine.toml"], b""));
    assert!(checked.ends_with("milioli-2013: no faults\n") && checked.contains("known flaw"));
    let wrong = shown.replace("D^(2/7)", "D^0");
    fs::write(dir.path().join("mine.toml"), wrong).unwrap();
    let output = favre(dir.path(), &["check", "mine.toml", "--quiet"], b"");
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("an integer division?"));
    let unknown = refused(&favre(dir.path(), &["show", "igci"], b""));
    assert!(unknown.contains("there is no closure named igci"), "{unknown}");
}

#[test]
fn points_give_the_same_from_options_text_and_doubles() {
    let dir = tempfile::tempdir().unwrap();
    let closure = Closure::find("milioli-2013").unwrap();
    let quantity = &closure.quantities[0];
    let args = ["eval", "milioli-2013", "--phi", "0.1,0.3", "--filter", "4", "--slip", "0.5,1.5"];
    let table = done(&favre(dir.path(), &args, b""));
    let mut points = Vec::new();
    for line in table.lines().skip(1) {
        let parts: Vec<&str> = line.split(',').collect();
        let numbers: Vec<f64> = parts[..4].iter().map(|x| x.parse().unwrap()).collect();
        assert_eq!(numbers[3], quantity.at(&numbers[..3]));
        assert_eq!(parts[4], "true");
        points.push(numbers);
    }
    assert_eq!(points.len(), 4);
    // Enough points for several batches, the last without a line break.
    let many: Vec<&Vec<f64>> = points.iter().cycle().take(100_001).collect();
    let lines: Vec<String> = many.iter().map(|p| format!("{}, {}\t{}", p[0], p[1], p[2])).collect();
    let stdin = ["eval", "milioli-2013", "--stdin"];
    let values = done(&favre(dir.path(), &stdin, lines.join("\n").as_bytes()));
    let values: Vec<f64> = values.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(values.len(), many.len());
    assert!(values.iter().zip(&many).all(|(value, point)| *value == point[3]));
    let bytes: Vec<u8> = many.iter().flat_map(|p| &p[..3]).flat_map(|x| x.to_le_bytes()).collect();
    let output = favre(dir.path(), &["eval", "milioli-2013", "--stdin", "--binary"], &bytes);
    assert!(output.status.success());
    let doubles = output.stdout.chunks(8).map(|x| f64::from_le_bytes(x.try_into().unwrap()));
    assert!(doubles.eq(values));

    let bad = refused(&favre(dir.path(), &stdin, b"0.1 4 1\n\n0.1 4 x\n"));
    assert!(bad.contains("standard input, line 3: \"x\" is no finite number"), "{bad}");
    let few = refused(&favre(dir.path(), &stdin, b"0.1 4\n"));
    assert!(few.contains("line 1: 2 numbers, and the markers are solids_fraction"), "{few}");
    let cut = refused(&favre(dir.path(), &["eval", "default", "--stdin", "--binary"], b"123"));
    assert!(cut.contains("ends inside a point of 2 doubles"), "{cut}");
    let missing = refused(&favre(dir.path(), &["eval", "default", "--phi", "0.1"], b""));
    assert!(missing.contains("drag_correction of default needs --filter"), "{missing}");
    for (args, why) in [
        (["--phi", "1.4", "--filter", "2"], "--phi 1.4: a solids fraction is from 0 to 1"),
        (["--phi", "0.1", "--filter=-2", "--json"], "--filter -2: a filter width is not negative"),
    ] {
        let args: Vec<&str> = ["eval", "default"].into_iter().chain(args).collect();
        let impossible = refused(&favre(dir.path(), &args, b""));
        assert!(impossible.contains(why), "{impossible}");
    }
    let empty = refused(&favre(dir.path(), &["eval", "parmentier-2012", "--phi", "0.1"], b""));
    assert!(empty.contains("has no formula to evaluate"), "{empty}");
}

#[test]
fn closures_are_compared_in_tables_figures_and_scores() {
    let dir = tempfile::tempdir().unwrap();
    let names = ["default", "igci-sundaresan-2011-2d", "radl-sundaresan-2014"];
    let mut args = vec!["compare", "--filter", "2,8", "--out", "beside"];
    args.extend(names);
    let table = done(&favre(dir.path(), &args, b""));
    assert!(names.iter().all(|name| table.contains(name)));
    let figure = fs::read_to_string(dir.path().join("beside/comparison_2.svg")).unwrap();
    assert!(figure.contains("radl-sundaresan-2014") && figure.contains("filter width 8"));
    assert!(dir.path().join("beside/comparison_1.png").is_file());
    let csv = fs::read_to_string(dir.path().join("beside/comparison.csv")).unwrap();
    assert!(csv.starts_with("filter_width/L_I [-],solids_fraction [-],default,igci"));
    // A closure from a file goes by the name it was called by.
    fs::write(dir.path().join("mine.toml"), BUILT_IN[1].1).unwrap();
    let table =
        done(&favre(dir.path(), &["compare", "mine.toml", BUILT_IN[1].0, "--out", "both"], b""));
    assert!(
        table.contains("\nmine.toml") && table.contains("\nigci-sundaresan-2011-2d"),
        "{table}"
    );
    let odd = refused(&favre(dir.path(), &["compare", "default", "cloete-2018"], b""));
    assert!(odd.contains("cloete-2018 does not predict drag_correction"), "{odd}");
}
