//! ANSYS Fluent: user-defined functions for the drag and the solids stress.

use super::c;
use super::solver::Solver;
use super::{Facts, Piece, Quantity, fill};

/// A call of a quantity in C with these texts for its markers.
pub fn call(quantity: &Quantity, markers: &[(&str, &str)]) -> String {
    let arguments: Vec<&str> = quantity
        .ranges
        .iter()
        .map(|range| {
            let given = markers.iter().find(|(symbol, _)| *symbol == range.symbol());
            given.expect("markers that are not given were refused").1
        })
        .collect();
    format!("favre_{}({})", quantity.name, arguments.join(", "))
}

/// The factor 1 - H in C, not below zero.
pub fn factor(drag: Option<&Quantity>, markers: &[(&str, &str)]) -> String {
    match drag {
        Some(drag) => format!("favre_max(0.0, 1.0 - {})", call(drag, markers)),
        None => "1.0".into(),
    }
}

/// What of the closure is there to be called and is not used.
pub fn left_out(solver: &Solver) -> String {
    let names = solver.left_out();
    if names.is_empty() {
        return String::new();
    }
    format!("- In the code, and not used by it: {}.\n", names.join(", "))
}

/// The base drag's routine, or that of creeping flow where there is no drag to correct.
pub fn base(facts: &Facts) -> String {
    facts.base.clone().unwrap_or_else(|| "favre_no_drag".into())
}

/// The files of this target.
pub fn export(solver: &Solver) -> Vec<Piece> {
    let facts = solver.facts;
    let stress = [("phi", "phi"), ("D", "D"), ("S", "S")];
    let sum = |parts: &[&Quantity]| Solver::sum(parts, |quantity| call(quantity, &stress));
    let about: Vec<String> = facts.about.iter().map(|line| c::safe(line)).collect();
    let gravity = super::code::digits(solver.system.gravity);
    let mut hooks = String::new();
    if solver.drag.is_some() {
        hooks += &fill(include_str!("fluent/drag.c"), &[("base", &base(facts))]);
    }
    if solver.has_stress() {
        hooks += &fill(
            include_str!("fluent/stress.c"),
            &[("viscosity", &sum(&solver.viscosity)), ("pressure", &sum(&solver.pressure))],
        );
    }
    let markers = [("phi", "phi"), ("D", "D"), ("V", "V")];
    let udf = fill(
        include_str!("fluent/favre_udf.c"),
        &[
            ("about", &super::code::comment(" * ", &about)),
            ("gravity", &gravity),
            ("length", solver.length_c()),
            ("factor", &factor(solver.drag, &markers)),
            ("hooks", &hooks),
        ],
    );
    let mut rows = String::new();
    if solver.drag.is_some() {
        rows += include_str!("fluent/drag.md");
    }
    if solver.has_stress() {
        rows += include_str!("fluent/stress.md");
    }
    let readme = fill(
        include_str!("fluent/README.md"),
        &[
            ("name", &facts.name),
            ("rows", &rows),
            ("facts", &(facts.readme.clone() + &left_out(solver))),
        ],
    );
    vec![
        Piece::text("favre_udf.c", udf),
        Piece::text("favre_closure.h", c::header(facts)),
        Piece::text("favre_scales.h", include_str!("c/favre_scales.h")),
        Piece::text("README.md", readme),
    ]
}
