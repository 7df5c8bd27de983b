//! Particles in gas: one that settles, arrays and a packing whose pressure drop the drag law knows, and
//! what must not change.

use super::{Checked, Effort, Expected, Row};
use crate::case::{DragChoice, Drive, MappingChoice, MixtureChoice};
use crate::cfd_dem::{CfdDem, Setup};
use crate::dem::{Sphere, lattice};
use crate::grid::Grid;
use crate::laws::contact::Contact;
use crate::laws::scales::Scales;
use std::error::Error;

/// The founding paper's powder in air.
fn setup(drag: DragChoice, mapping: MappingChoice, solids_fraction: f64) -> Setup {
    let super::Setup { powder, gas, gravity, .. } = super::setup(solids_fraction);
    Setup {
        powder,
        gas,
        gravity,
        drag,
        mixture: MixtureChoice::OwnDiameter,
        gas_inertia: true,
        gas_stress: false,
        drive: Drive::PressureGradient,
        solids_fraction,
        contact: Contact {
            stiffness: 3.5,
            restitution: powder.restitution,
            tangential_stiffness: 2.0 / 7.0,
            tangential_damping: 0.5,
            friction: 0.3,
            cohesion: 0.0,
        },
        steps_per_contact: 25.0,
        mapping,
        smoothing: 0.0,
        rhythm: 1e-3,
        seed: 1,
        parallel: false,
    }
}

/// Cells of 10/3 d, as the founding paper's.
fn grid(cells: [usize; 3]) -> Grid<3> {
    Grid::new(cells.map(|n| 0.25e-3 * n as f64), cells)
}

fn advance(flow: &mut CfdDem, until: f64) -> Result<(), Box<dyn Error>> {
    while flow.time() < until {
        flow.step(until)?;
    }
    Ok(())
}

pub(super) fn check(effort: Effort) -> Checked {
    let mut rows = vec![settling()?];
    rows.extend(arrays()?);
    rows.push(packing()?);
    rows.extend(budgets(effort)?);
    Ok(rows)
}

/// One particle, let go in gas at rest. Its cells are long, so that it drags little gas along.
fn settling() -> Result<Row, Box<dyn Error>> {
    let setup = setup(DragChoice::WenYu, MappingChoice::Trilinear, 0.0);
    let sphere = Sphere {
        position: [0.0151, 0.0147, 0.015],
        velocity: [0.0; 3],
        spin: [0.0; 3],
        diameter: setup.powder.diameter,
        density: setup.powder.density,
    };
    let mut flow = CfdDem::with_spheres(Grid::new([0.03; 3], [8; 3]), setup, &[sphere])?;
    advance(&mut flow, 0.2)?;
    let scales = Scales::new(&setup.powder, &setup.gas, setup.gravity);
    Ok(Row::new(
        "one particle: slip over u_t",
        Expected::Near { value: 1.0, within: 2e-3 },
        flow.means().slip / scales.terminal_velocity,
    )
    .with("the drag law's terminal velocity; cells of 50 d"))
}

/// Uniform arrays: the pressure gradient that carries them is the drag law's at the slip that they take.
fn arrays() -> Result<Vec<Row>, Box<dyn Error>> {
    let mut rows = Vec::new();
    for drag in [DragChoice::WenYu, DragChoice::Beetstra, DragChoice::Tenneti] {
        let mut worst = 0.0f64;
        for (per_cell, mapping) in [
            (2, MappingChoice::Trilinear),
            (2, MappingChoice::Divided),
            (3, MappingChoice::Trilinear),
        ] {
            let (grid, setup) = (grid([8; 3]), setup(drag, mapping, 0.0));
            let Setup { powder, gas, gravity, .. } = setup;
            let spheres = lattice(grid.size(), [8 * per_cell; 3], powder.diameter, powder.density)?;
            let mut flow = CfdDem::with_spheres(grid, setup, &spheres)?;
            advance(&mut flow, 3e-3)?;
            let means = flow.means();
            let phi = means.solids_fraction;
            let weight = phi * (1.0 - phi) * (powder.density - gas.density) * gravity;
            let law = drag.law(&gas, &powder);
            worst = worst.max((law.beta(phi, means.slip) * means.slip / weight - 1.0).abs());
        }
        rows.push(
            Row::new(
                format!("uniform arrays, {drag}: drag over weight, largest error"),
                Expected::AtMost(1e-9),
                worst,
            )
            .with("the drag law at φ = 0.065 and 0.22, both mappings"),
        );
    }
    Ok(rows)
}

/// Slip at which a packing of φ = 0.6 is carried by the gas, before it has moved.
fn packing() -> Result<Row, Box<dyn Error>> {
    let setup = setup(DragChoice::Gidaspow, MappingChoice::Trilinear, 0.6);
    let mut flow = CfdDem::new(grid([12; 3]), setup)?;
    advance(&mut flow, 1e-3)?;
    Ok(Row::new(
        "random packing, φ = 0.6: slip at which drag is the weight",
        Expected::Near { value: flow.uniform_slip(), within: 0.03 },
        flow.means().slip,
    )
    .with("the drag law (Ergun) at the mean fraction; the packing is not quite uniform"))
}

fn budgets(effort: Effort) -> Result<Vec<Row>, Box<dyn Error>> {
    let setup = setup(DragChoice::WenYu, MappingChoice::Divided, 0.15);
    let mut flow = CfdDem::new(grid([8, 8, 16]), Setup { smoothing: 1.5e-4, ..setup })?;
    let start = flow.means();
    advance(&mut flow, if effort == Effort::Quick { 0.02 } else { 0.1 })?;
    let end = flow.means();
    let scales = Scales::new(&setup.powder, &setup.gas, setup.gravity);
    let scale = setup.powder.density * end.solids_fraction * scales.terminal_velocity;
    let drift = (0..3).map(|axis| (end.momentum[axis] - start.momentum[axis]).abs() / scale);
    Ok(vec![
        Row::new(
            "momentum of particles and gas: drift over ρ_s φ u_t",
            Expected::AtMost(1e-11),
            drift.fold(0.0, f64::max),
        )
        .with("round-off"),
        Row::new(
            "volume of the particles in cells: relative error",
            Expected::AtMost(1e-11),
            (end.solids_fraction / start.solids_fraction - 1.0).abs(),
        )
        .with("round-off"),
    ])
}
