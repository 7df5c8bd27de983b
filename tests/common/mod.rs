//! What the tests' cases have in common: the founding study's powder in air.

// Each test file uses some of it.
#![allow(dead_code)]

use favre::laws::scales::{Gas, Powder};
use std::path::{Path, PathBuf};
use std::process::Command;

/// As in a case file or a map.
pub const SYSTEM: &str = r#"[powder]
diameter = 75e-6
density = 1500.0
restitution = 0.9
max_packing = 0.65
[gas]
density = 1.3
viscosity = 1.8e-5
"#;

pub const POWDER: Powder =
    Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 };

pub const GAS: Gas = Gas { density: 1.3, viscosity: 1.8e-5 };

/// A Python that can import `modules`: that of `.ci/run`, or the one on the path.
pub fn python(modules: &str) -> Option<PathBuf> {
    let venv = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/venv/bin/python");
    let import = format!("import {modules}");
    let can = |python: &PathBuf| {
        let output = Command::new(python).args(["-c", &import]).output();
        output.is_ok_and(|output| output.status.success())
    };
    let found = [venv, PathBuf::from("python3")].into_iter().find(can);
    if found.is_none() {
        eprintln!("skipped: no Python with {modules}; `pip install` them in target/venv");
    }
    found
}
