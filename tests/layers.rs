//! The architecture as a test: who may use whom, and that the page about it is true.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// For each module the modules of the crate that it may name, besides itself.
const ALLOWED: &[(&str, &str)] = &[
    ("case", "laws"),
    ("real", ""),
    ("grid", ""),
    ("memory", "real"),
    ("field", "grid memory real"),
    ("rows", "field real"),
    ("stencil", "real"),
    ("poisson", "field grid real rows"),
    ("laws", "real"),
    ("simulation", "dem fine"),
    ("drive", "laws"),
    ("viscous", "field real rows"),
    ("two_fluid", "case drive field fine grid laws poisson real rows simulation stencil viscous"),
    ("dem", "laws rows"),
    ("cfd_dem", "case dem drive field fine grid laws poisson rows simulation stencil viscous"),
    ("fine", "grid"),
    ("film", "grid"),
    ("filter", "grid"),
    ("lanes", ""),
    ("spectral", ""),
    ("moments", "fine filter filtered grid lanes rows spectral"),
    ("filtered", "lanes laws"),
    ("blocking", ""),
    ("series", "blocking"),
    ("statistics", "blocking filter filtered fine grid lanes laws moments rows spectral table"),
    ("stored", "filter fine grid laws spectral statistics"),
    ("filtered_fields", "filter filtered fine grid laws moments spectral stored"),
    ("expression", "real rows"),
    ("resolved", "case cfd_dem dem expression fine laws stored"),
    ("binary", ""),
    ("sums", "binary filtered laws spectral statistics"),
    ("extrapolation", ""),
    ("replicates", "blocking filtered laws statistics table"),
    ("pool", "extrapolation laws replicates statistics sums table"),
    (
        "simulate",
        "case cfd_dem dem film filter fine grid laws real resolved series simulation spectral statistics stored two_fluid",
    ),
    ("stability", "case laws"),
    ("table", ""),
    ("forms", "expression"),
    ("fit", "forms table"),
    ("spline", "fit forms table"),
    ("refit", "fit forms laws replicates spline statistics sums table"),
    ("exponents", "fit replicates table"),
    ("model", "fit forms laws refit table"),
    ("closure", "expression fit forms model refit spline"),
    ("lint", "closure expression forms laws model"),
    ("compare", "closure fit forms table"),
    ("export", "closure expression fit forms laws model output resolved"),
    ("figure", "bench compare film stability table"),
    ("report", "closure compare figure fit forms output summary table"),
    ("output", ""),
    ("progress", "series simulate"),
    ("checkpoint", "binary case film output simulate stability sums"),
    ("summary", "case laws refit rows series simulate stability table terms"),
    ("terms", "case laws"),
    (
        "pipeline",
        "bench case checkpoint closure compare figure filtered_fields fine fit forms laws model output pool progress refit report resolved series simulate stability statistics stored summary sums table",
    ),
    (
        "bench",
        "blocking case extrapolation filter filtered fine grid laws real rows series simulate statistics two_fluid",
    ),
    ("hard", "case grid laws real two_fluid"),
    ("verify", "case cfd_dem dem drive field grid laws poisson real stability two_fluid"),
];

/// Outside dependencies that only some modules may name.
const RESERVED: &[(&str, &str)] = &[
    ("rayon", "rows pipeline"),
    ("unsafe", "rows memory"),
    ("memmap2", "memory"),
    ("kuva", "figure"),
    ("indicatif", "progress"),
    ("realfft", "spectral"),
    ("rustfft", "spectral"),
    ("cpu_time", "bench"),
    ("roxmltree", "resolved"),
    ("base64", "resolved report"),
    ("maud", "report"),
    ("flate2", "resolved"),
    ("hdf5_writer", "resolved"),
];

fn source() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("src")
}

/// The code of each module, its tests and comments left out.
fn modules() -> BTreeMap<String, String> {
    let mut modules = BTreeMap::<String, String>::new();
    let mut folders = vec![source()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                if path != source().join("bin") {
                    folders.push(path);
                }
                continue;
            }
            if path.extension().is_none_or(|extension| extension != "rs") {
                continue;
            }
            let below = path.strip_prefix(source()).unwrap().with_extension("");
            let name = below.iter().next().unwrap().to_str().unwrap().to_owned();
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\n").next().unwrap();
            let code: String = code
                .lines()
                .filter(|line| !line.trim_start().starts_with("//"))
                .flat_map(|line| [line, "\n"])
                .collect();
            modules.entry(name).or_default().push_str(&code);
        }
    }
    modules
}

/// Words that follow `crate::` in the code, names in braces included.
fn used(code: &str) -> Vec<String> {
    code.split("crate::")
        .skip(1)
        .flat_map(|rest| {
            let names = match rest.strip_prefix('{') {
                Some(list) => list.split('}').next().unwrap(),
                None => rest,
            };
            let many = rest.starts_with('{');
            names
                .split(',')
                .take(if many { usize::MAX } else { 1 })
                .map(|name| {
                    let name = name.trim();
                    let end = name.find(|c: char| !c.is_alphanumeric() && c != '_');
                    name[..end.unwrap_or(name.len())].to_owned()
                })
                .collect::<Vec<_>>()
        })
        .filter(|name| name.starts_with(char::is_lowercase))
        .collect()
}

#[test]
fn modules_use_only_what_they_may() {
    let modules = modules();
    let binary = ["main", "cli", "fits", "interrupt", "models", "lib"];
    for (name, code) in &modules {
        if binary.contains(&name.as_str()) {
            continue;
        }
        let (_, allowed) = ALLOWED
            .iter()
            .find(|(module, _)| module == name)
            .unwrap_or_else(|| panic!("{name} is not in the table of layers"));
        for used in used(code) {
            let fine = used == *name || allowed.split(' ').any(|module| module == used);
            assert!(fine, "{name} uses {used}, which its layer does not allow");
        }
    }
    for (module, _) in ALLOWED {
        assert!(modules.contains_key(*module), "{module} is gone");
    }
}

#[test]
fn what_is_reserved_stays_in_its_module() {
    for (name, code) in modules() {
        for (word, homes) in RESERVED {
            let named =
                code.split(|c: char| !c.is_alphanumeric() && c != '_').any(|token| token == *word);
            let home = homes.split(' ').any(|home| home == name);
            assert!(!named || home, "{name} names {word}, which belongs to {homes}");
        }
    }
}

#[test]
fn the_page_names_every_module_and_only_files_that_exist() {
    let page = fs::read_to_string(source().join("ARCHITECTURE.md")).unwrap();
    for (module, _) in ALLOWED {
        let named = [format!("| [`{module}`]"), format!("| [`{module}`](mod@")];
        assert!(named.iter().any(|name| page.contains(name)), "{module} is not on the page");
    }
    for quoted in page.split('`').skip(1).step_by(2) {
        let path = quoted.contains('/') && !quoted.contains("::") && !quoted.contains(' ');
        if path {
            let there = Path::new(env!("CARGO_MANIFEST_DIR")).join(quoted.trim_end_matches('/'));
            assert!(there.exists(), "the page names {quoted}, which does not exist");
        }
    }
}
