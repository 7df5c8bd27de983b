//! What the tests' cases have in common: the founding study's powder in air.

// Each test file uses some of it.
#![allow(dead_code)]

use favre::laws::scales::{Gas, Powder};

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
