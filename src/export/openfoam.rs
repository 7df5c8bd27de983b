//! OpenFOAM: a library with a drag model that is selected at run time, a filtered stress where the
//! closure has one, and two cases that use them with twoPhaseEulerFoam.

use super::code::{comment, digits};
use super::fluent::{base, call, factor, left_out};
use super::solver::Solver;
use super::{Piece, Quantity, c, fill};
use crate::forms::Marker;
use std::f64::consts::TAU;
use std::fmt::Write;

/// Cells along an edge of the periodic box.
const CELLS: usize = 16;

/// Filter width over cell width of the cases.
const RATIO: f64 = 2.0;

/// Filter width over reference length of the cases, where the closure's range holds it.
const WIDTH: f64 = 4.0;

/// Texts of a template, with their keys.
type Texts<'a> = Vec<(&'a str, String)>;

fn filled(template: &str, texts: &Texts) -> String {
    let texts: Vec<(&str, &str)> = texts.iter().map(|(key, text)| (*key, &**text)).collect();
    fill(template, &texts)
}

/// The sources of the library.
fn library(solver: &Solver) -> Vec<Piece> {
    let facts = solver.facts;
    let about: Vec<String> = facts.about.iter().map(|line| c::safe(line)).collect();
    let notice =
        fill(include_str!("openfoam/lib/notice.txt"), &[("about", &comment(" * ", &about))]);
    let drag_markers = [("phi", "phi"), ("D", "D"), ("V", "V"), ("S", "S"), ("S_g", "S_g")];
    let stress = [("phi", "phi"), ("D", "D"), ("S", "S")];
    let sum = |parts: &[&Quantity]| Solver::sum(parts, |quantity| call(quantity, &stress));
    // A gradient is computed only where a marker needs it.
    let needs = |marker| {
        solver.drag.is_some_and(|drag| drag.ranges.iter().any(|range| range.marker == marker))
    };
    let mut rates = String::new();
    let mut cell_rates = Vec::new();
    for (marker, phase, name) in
        [(Marker::ShearRate, "dispersed", "S"), (Marker::GasShearRate, "continuous", "S_g")]
    {
        if needs(marker) {
            rates +=
                &fill(include_str!("openfoam/lib/rate.C"), &[("phase", phase), ("name", name)]);
            cell_rates.push(format!("{name}[i]*rate"));
        } else {
            cell_rates.push("0".into());
        }
    }
    let texts: Texts = vec![
        ("notice", notice),
        ("law", facts.closure.file.definitions.drag.clone()),
        ("factor", factor(solver.drag, &drag_markers)),
        ("base", base(facts)),
        ("gravity", digits(solver.system.gravity)),
        ("length", solver.length_c().into()),
        ("rates", rates),
        ("cell_rates", cell_rates.join(", ")),
        ("viscosity", sum(&solver.viscosity)),
        ("pressure", sum(&solver.pressure)),
    ];
    let mut sources = vec![
        ("favreCellWidths.H", include_str!("openfoam/lib/favreCellWidths.H")),
        ("periodicWeight.H", include_str!("openfoam/lib/periodicWeight.H")),
        ("periodicWeight.C", include_str!("openfoam/lib/periodicWeight.C")),
    ];
    if solver.drag.is_some() {
        sources.push(("favreDrag.H", include_str!("openfoam/lib/favreDrag.H")));
        sources.push(("favreDrag.C", include_str!("openfoam/lib/favreDrag.C")));
    }
    if solver.has_stress() {
        sources.push(("favreStress.H", include_str!("openfoam/lib/favreStress.H")));
        sources.push(("favreStress.C", include_str!("openfoam/lib/favreStress.C")));
    }
    let compiled: Vec<&str> =
        sources.iter().map(|(name, _)| *name).filter(|name| name.ends_with(".C")).collect();
    let objects = compiled.join(" ").replace(".C", ".o");
    let mut pieces: Vec<Piece> = sources
        .iter()
        .map(|(name, template)| Piece::text(name, filled(template, &texts)))
        .collect();
    pieces.extend([
        Piece::text("favre_closure.h", c::header(facts)),
        Piece::text("favre_scales.h", include_str!("c/favre_scales.h")),
        Piece::text(
            "Makefile",
            fill(include_str!("openfoam/lib/Makefile"), &[("objects", &objects)]),
        ),
        Piece::text(
            "Make/files",
            fill(include_str!("openfoam/lib/files"), &[("sources", &compiled.join("\n"))]),
        ),
        Piece::text("Make/options", include_str!("openfoam/lib/options")),
        Piece::text("Make/options.esi", include_str!("openfoam/lib/options.esi")),
        Piece::text("Make/options.foundation", include_str!("openfoam/lib/options.foundation")),
    ]);
    pieces
}

/// The entries that select the models: of phaseProperties and of turbulenceProperties.particles.
fn entries(solver: &Solver) -> (String, String) {
    let numbers = solver.numbers();
    let drag = match solver.drag {
        Some(_) => filled(include_str!("openfoam/case/favreDrag"), &numbers),
        None => include_str!("openfoam/case/plainDrag").into(),
    };
    let stress = match solver.has_stress() {
        true => filled(include_str!("openfoam/case/favreStress"), &numbers),
        false => String::new(),
    };
    (drag, stress)
}

/// What both cases have in common.
fn common(solver: &Solver, folder: &str) -> Vec<Piece> {
    let (drag, stress) = entries(solver);
    let model = if solver.has_stress() { "favreStress" } else { "phasePressure" };
    let mut texts = solver.numbers();
    let temperature = digits(temperature(solver));
    texts.extend([
        ("drag", drag),
        ("stress", stress),
        ("model", model.into()),
        ("temperature", temperature),
    ]);
    [
        ("constant/phaseProperties", include_str!("openfoam/case/phaseProperties")),
        (
            "constant/thermophysicalProperties.particles",
            include_str!("openfoam/case/thermophysicalProperties.particles"),
        ),
        (
            "constant/thermophysicalProperties.air",
            include_str!("openfoam/case/thermophysicalProperties.air"),
        ),
        (
            "constant/turbulenceProperties.particles",
            include_str!("openfoam/case/turbulenceProperties.particles"),
        ),
        (
            "constant/turbulenceProperties.air",
            include_str!("openfoam/case/turbulenceProperties.air"),
        ),
        ("system/fvSchemes", include_str!("openfoam/case/fvSchemes")),
        ("system/fvSolution", include_str!("openfoam/case/fvSolution")),
        ("Allrun", include_str!("openfoam/case/Allrun")),
    ]
    .into_iter()
    .map(|(path, template)| Piece::text(&format!("{folder}/{path}"), filled(template, &texts)))
    .collect()
}

/// Time step, time between outputs, end \[s\].
fn control(folder: &str, step: f64, longest: f64, interval: f64, end: f64) -> Piece {
    let adjust = if longest > step { "yes" } else { "no" };
    let text = fill(
        include_str!("openfoam/case/controlDict"),
        &[
            ("step", &digits(step)),
            ("longest", &digits(longest)),
            ("interval", &digits(interval)),
            ("end", &digits(end)),
            ("adjust", adjust),
        ],
    );
    Piece::text(&format!("{folder}/system/controlDict"), text)
}

/// Temperature \[K\] at which air, an ideal gas, has the gas's density at 1e5 Pa.
fn temperature(solver: &Solver) -> f64 {
    (1e5 * 28.9 / (8314.47 * solver.system.gas_density) * 1e3).round() / 1e3
}

/// Cell width \[m\] at which the filter is as wide as the cases have it.
fn cell(solver: &Solver) -> f64 {
    let quantities = solver.drag.iter().chain(&solver.viscosity).chain(&solver.pressure);
    let range = quantities
        .flat_map(|quantity| &quantity.ranges)
        .find(|range| range.marker == Marker::FilterWidth);
    let width = range.map_or(WIDTH, |range| WIDTH.clamp(range.low, range.high));
    width * solver.length() / RATIO
}

/// Dimensions of a field.
fn dimensions(name: &str) -> &'static str {
    match name.split('.').next() {
        Some("U") => "[0 1 -1 0 0 0 0]",
        Some("p" | "p_rgh") => "[1 -1 -2 0 0 0 0]",
        Some("T") => "[0 0 0 1 0 0 0]",
        Some("nut") => "[0 2 -1 0 0 0 0]",
        Some("alphat") => "[1 -1 -1 0 0 0 0]",
        _ => "[0 0 0 0 0 0 0]",
    }
}

fn class(name: &str) -> &'static str {
    if name.starts_with("U.") { "volVectorField" } else { "volScalarField" }
}

/// The periodic box: waves of fraction and velocity, so that every cell is another point.
fn periodic_box(solver: &Solver) -> Vec<Piece> {
    let mut pieces = common(solver, "box");
    let cell = cell(solver);
    let u_t = solver.system.terminal_velocity;
    let mut texts = solver.numbers();
    texts.extend([
        ("edge", digits(cell * CELLS as f64)),
        ("cell", digits(cell)),
        ("cells", CELLS.to_string()),
    ]);
    for (path, template) in [
        ("constant/g", include_str!("openfoam/box/g")),
        ("constant/fvOptions", include_str!("openfoam/box/fvOptions")),
        ("system/blockMeshDict", include_str!("openfoam/box/blockMeshDict")),
    ] {
        pieces.push(Piece::text(&format!("box/{path}"), filled(template, &texts)));
    }
    let mut fractions = format!("nonuniform List<scalar>\n{}\n(\n", CELLS * CELLS);
    let mut velocities = format!("nonuniform List<vector>\n{}\n(\n", CELLS * CELLS);
    for j in 0..CELLS {
        for i in 0..CELLS {
            let [x, y] = [i, j].map(|i| TAU * (i as f64 + 0.5) / CELLS as f64);
            let _ = writeln!(
                fractions,
                "{}",
                digits(0.15 + 0.08 * x.sin() * y.cos() + 0.03 * (2.0 * y + x).sin())
            );
            let _ = writeln!(
                velocities,
                "({} {} 0)",
                digits(0.2 * u_t * y.sin()),
                digits(-0.6 * u_t + 0.5 * u_t * x.cos())
            );
        }
    }
    let temperature = format!("uniform {}", digits(temperature(solver)));
    let fields = [
        ("alpha.particles", fractions + ")"),
        ("U.particles", velocities + ")"),
        ("U.air", "uniform (0 0 0)".into()),
        ("p", "uniform 1e5".into()),
        ("p_rgh", "uniform 1e5".into()),
        ("T.particles", temperature.clone()),
        ("T.air", temperature),
        ("nut.particles", "uniform 0".into()),
        ("alphat.particles", "uniform 0".into()),
    ];
    for (name, internal) in fields {
        let text = fill(
            include_str!("openfoam/box/field"),
            &[
                ("class", class(name)),
                ("object", name),
                ("dimensions", dimensions(name)),
                ("internal", &internal),
            ],
        );
        pieces.push(Piece::text(&format!("box/0/{name}"), text));
    }
    // A hundredth of the time in which a particle crosses a cell at u_t.
    let step = rounded(0.01 * cell / u_t);
    pieces.push(control("box", step, step, 10.0 * step, 100.0 * step));
    pieces
}

/// One significant digit.
fn rounded(value: f64) -> f64 {
    format!("{value:.0e}").parse().unwrap_or(value)
}

/// A small riser: gas and particles in at the bottom.
fn riser(solver: &Solver) -> Vec<Piece> {
    let mut pieces = common(solver, "riser");
    let cell = cell(solver);
    let u_t = solver.system.terminal_velocity;
    let (across, along) = (16, 64);
    let mut texts = solver.numbers();
    texts.extend([
        ("width", digits(cell * f64::from(across))),
        ("height", digits(cell * f64::from(along))),
        ("cell", digits(cell)),
        ("across", across.to_string()),
        ("along", along.to_string()),
    ]);
    for (path, template) in [
        ("constant/g", include_str!("openfoam/riser/g")),
        ("system/blockMeshDict", include_str!("openfoam/riser/blockMeshDict")),
    ] {
        pieces.push(Piece::text(&format!("riser/{path}"), filled(template, &texts)));
    }
    let gas = digits(rounded(15.0 * u_t));
    let particles = digits(rounded(5.0 * u_t));
    let zero_gradient = "type zeroGradient;";
    let fixed = |value: &str| format!("type fixedValue; value uniform {value};");
    let out = |phase: &str, value: &str| {
        format!(
            "type inletOutlet; phi phi.{phase}; inletValue uniform {value}; value uniform {value};"
        )
    };
    let calculated = "type calculated; value $internalField;".to_owned();
    let pressure = "type fixedFluxPressure; value $internalField;".to_owned();
    let warm = digits(temperature(solver));
    // Name, inside, inlet, outlet, walls.
    let fields = [
        (
            "alpha.particles",
            "0.03".to_owned(),
            fixed("0.05"),
            out("particles", "0"),
            zero_gradient.into(),
        ),
        (
            "U.particles",
            format!("(0 {particles} 0)"),
            fixed(&format!("(0 {particles} 0)")),
            out("particles", "(0 0 0)"),
            "type slip;".into(),
        ),
        (
            "U.air",
            format!("(0 {gas} 0)"),
            format!(
                "type interstitialInletVelocity; inletVelocity uniform (0 {gas} 0); \
                 alpha alpha.air; value $internalField;"
            ),
            "type pressureInletOutletVelocity; phi phi.air; value $internalField;".into(),
            "type noSlip;".into(),
        ),
        ("p", "1e5".into(), calculated.clone(), calculated.clone(), calculated.clone()),
        (
            "p_rgh",
            "1e5".into(),
            pressure.clone(),
            "type prghPressure; p $internalField; value $internalField;".into(),
            pressure,
        ),
        ("T.particles", warm.clone(), fixed(&warm), out("particles", &warm), zero_gradient.into()),
        ("T.air", warm.clone(), fixed(&warm), out("air", &warm), zero_gradient.into()),
        ("nut.particles", "0".into(), calculated.clone(), calculated.clone(), calculated.clone()),
        ("alphat.particles", "0".into(), calculated.clone(), calculated.clone(), calculated),
    ];
    for (name, internal, inlet, outlet, walls) in fields {
        let text = fill(
            include_str!("openfoam/riser/field"),
            &[
                ("class", class(name)),
                ("object", name),
                ("dimensions", dimensions(name)),
                ("internal", &format!("uniform {internal}")),
                ("inlet", &inlet),
                ("outlet", &outlet),
                ("walls", &walls),
            ],
        );
        pieces.push(Piece::text(&format!("riser/0/{name}"), text));
    }
    let step = rounded(0.002 * cell / u_t);
    let interval = rounded(10.0 * cell / u_t);
    pieces.push(control("riser", step, 20.0 * step, interval, 2.5 * interval));
    pieces
}

/// The files of this target.
pub fn export(solver: &Solver) -> Vec<Piece> {
    let facts = solver.facts;
    let mut pieces = library(solver);
    pieces.extend(periodic_box(solver));
    pieces.extend(riser(solver));
    let mut entries = String::new();
    if solver.drag.is_some() {
        entries += include_str!("openfoam/drag.md");
    }
    if solver.has_stress() {
        entries += include_str!("openfoam/stress.md");
    }
    let readme = fill(
        include_str!("openfoam/README.md"),
        &[
            ("name", &facts.name),
            ("entries", &entries),
            ("facts", &(facts.readme.clone() + &left_out(solver))),
        ],
    );
    pieces.push(Piece::text("README.md", readme));
    pieces
}
