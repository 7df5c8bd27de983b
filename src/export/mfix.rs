//! MFIX (two-fluid model): the user routines for drag and for the solids stress.

use super::code::{comment, digits};
use super::fluent::{base, left_out};
use super::fortran;
use super::solver::Solver;
use super::{Piece, Quantity, fill};
use crate::fit::ReferenceLength;

/// The files of this target.
pub fn export(solver: &Solver) -> Vec<Piece> {
    let facts = solver.facts;
    let about = comment("! ", &facts.about);
    let constants = fortran::constants(&facts.code, "      ");
    let functions = fortran::functions(facts);
    let length = match facts.closure.file.reference_length {
        ReferenceLength::One => "u_t**2/g",
        ReferenceLength::Two => "d*(u_t**2/(g*d))**(1.0_dp/3.0_dp)",
    };
    let scales = fill(include_str!("mfix/scales.f"), &[("length", length)]);
    let common = [
        ("about", &*about),
        ("constants", &constants),
        ("functions", &functions),
        ("scales", &scales),
    ];
    let mut pieces = Vec::new();
    let mut keywords = String::new();
    if let Some(drag) = solver.drag {
        let mut texts = common.to_vec();
        let (base, call) = (base(facts), drag.call());
        texts.extend([("base", &*base), ("drag", &*call)]);
        pieces.push(Piece::text("usr_drag.f", fill(include_str!("mfix/usr_drag.f"), &texts)));
        keywords += "    DRAG_TYPE = 'USR_DRAG'\n";
    }
    if solver.has_stress() {
        let mut texts = common.to_vec();
        let sum = |parts: &[&Quantity]| Solver::sum(parts, Quantity::call);
        let (viscosity, pressure) = (sum(&solver.viscosity), sum(&solver.pressure));
        texts.extend([("viscosity", &*viscosity), ("pressure", &*pressure)]);
        let text = fill(include_str!("mfix/usr_properties.f"), &texts);
        pieces.push(Piece::text("usr_properties.f", text));
        keywords += "    USR_MUS(1) = .TRUE.\n    GRANULAR_ENERGY = .FALSE.\n";
    }
    let system = &solver.system;
    let stokes =
        system.gravity * system.diameter.powi(2) * (system.particle_density - system.gas_density)
            / (18.0 * system.gas_viscosity);
    let readme = fill(
        include_str!("mfix/README.md"),
        &[
            ("name", &facts.name),
            ("keywords", &keywords),
            ("true", &digits((system.terminal_velocity * 1e4).round() / 1e4)),
            ("stokes", &digits((stokes * 1e4).round() / 1e4)),
            ("facts", &(facts.readme.clone() + &left_out(solver))),
        ],
    );
    pieces.push(Piece::text("README.md", readme));
    pieces
}
