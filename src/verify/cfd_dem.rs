//! Particles in gas: one that settles, arrays and a packing whose pressure drop the drag law knows, and
//! what must not change.

use super::{Checked, Effort, Expected, Row};
use crate::case::{DragChoice, Drive, MappingChoice, MixtureChoice, SPREAD};
use crate::cfd_dem::{CfdDem, Setup};
use crate::dem::{Sphere, lattice};
use crate::drive::uniform_velocities;
use crate::grid::Grid;
use crate::laws::contact::Contact;
use crate::laws::scales::{Scales, homogeneous_slip};
use faer::c64;
use std::error::Error;
use std::f64::consts::{PI, TAU};

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
    rows.extend(waves(effort)?);
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

/// Wavelength of [`waves`] \[m\]: 27 d, eight cells of the founding study.
const WAVELENGTH: f64 = 2e-3;

/// When its amplitude is taken \[s\].
const TAKEN: [f64; 2] = [0.01, 0.05];

/// Particles along each edge of their lattice: a number of which none of the cells' numbers is a neighbour, so that
/// no plane of them passes for a wave.
const NUMBER: [usize; 3] = [13; 3];

/// Vertical waves of particles, by what they are spread to in diameters and cells per wavelength.
fn waves(effort: Effort) -> Result<Vec<Row>, Box<dyn Error>> {
    let all = [(SPREAD, 8), (SPREAD, 16), (SPREAD, 24), (1.36, 24)];
    let wanted = if effort == Effort::Quick { &all[..1] } else { &all };
    let row = |&(width, cells): &(f64, usize)| {
        let (theory, found) = wave(width, cells)?;
        Ok(Row::new(
            format!("wave of 27 d on {cells} cells, particles spread to {width} d: growth [1/s]"),
            Expected::Near { value: theory, within: 0.01 },
            found,
        )
        .with("linear theory of points in gas"))
    };
    wanted.iter().map(row).collect()
}

/// Growth rate \[1/s\] by theory and in the simulator.
fn wave(width: f64, cells: usize) -> Result<(f64, f64), Box<dyn Error>> {
    let setup = setup(DragChoice::WenYu, MappingChoice::Trilinear, 0.0);
    let diameter = setup.powder.diameter;
    let number = NUMBER.iter().product::<usize>() as f64;
    let phi = number * PI / 6.0 * (diameter / WAVELENGTH).powi(3);
    let setup = Setup { smoothing: width * diameter, solids_fraction: phi, ..setup };
    let theory = growing_wave(&setup);
    Ok((theory.re, simulated_wave(setup, theory, cells)?))
}

/// Rate s of the growing one of the two waves exp(s t + i k z) of points that the kernel
/// G = exp(-k² σ²/2) spreads, in the frame in which the mixture has no momentum:
///
/// ```text
/// (s + i k v₀) φ' = -i k φ₀ v',   (s + i k u₀) G φ' = i k ε₀ u'
/// ρ_s (s + i k v₀) v' = f' - G i k p',   f = λ ρ_s (u - v)
/// ε₀ ρ_g (s + i k u₀) u' = -ε₀ i k p' - G φ' (ρ - ρ_g) g - G (φ f)'
/// ```
///
/// with λ of the fraction and the velocity that particles see, G² φ and G u.
fn growing_wave(setup: &Setup) -> c64 {
    let Setup { powder, gas, gravity, drag, smoothing, solids_fraction: phi, .. } = *setup;
    let law = drag.law(&gas, &powder);
    let slip = homogeneous_slip(&law, &powder, &gas, gravity, phi);
    let [v0, u0] = uniform_velocities(&powder, &gas, phi, slip);
    let open = 1.0 - phi;
    let mixture = powder.density * phi + gas.density * open;
    let k = TAU / WAVELENGTH;
    let kernel = (-0.5 * (k * smoothing).powi(2)).exp();
    let force = |phi: f64, slip: f64| law.beta_per_fraction(phi, slip) * slip;
    let step = 1e-5;
    let by_fraction = (force(phi + step, slip) - force(phi - step, slip)) / (2.0 * step);
    let by_slip =
        (force(phi, slip * (1.0 + step)) - force(phi, slip * (1.0 - step))) / (2.0 * step * slip);
    // What is left of the particles' momentum for φ' = 1: a quadratic in s.
    let left = |s: c64| {
        let ik = c64::new(0.0, k);
        let (rising, falling) = (s + ik * u0, s + ik * v0);
        let (u, v) = (rising * kernel / (ik * open), -falling / (ik * phi));
        let f = by_fraction * kernel * kernel + by_slip * (u * kernel - v);
        let given = force(phi, slip) + phi * f;
        let slope = -(gas.density * rising * u)
            - kernel * ((mixture - gas.density) * gravity + given) / open;
        powder.density * falling * v - f + kernel * slope
    };
    let [none, one, minus] = [0.0, 1.0, -1.0].map(|s| left(c64::new(s, 0.0)));
    let (square, linear) = (0.5 * (one + minus) - none, 0.5 * (one - minus));
    let root = (linear * linear - 4.0 * square * none).sqrt();
    let roots = [(root - linear) / (2.0 * square), -(root + linear) / (2.0 * square)];
    if roots[0].re > roots[1].re { roots[0] } else { roots[1] }
}

/// Growth rate \[1/s\] of that wave in the simulator.
fn simulated_wave(setup: Setup, theory: c64, cells: usize) -> Result<f64, Box<dyn Error>> {
    let Setup { powder, gas, gravity, solids_fraction: phi, .. } = setup;
    let size = [WAVELENGTH; 3];
    let k = TAU / WAVELENGTH;
    let slip = homogeneous_slip(&setup.drag.law(&gas, &powder), &powder, &gas, gravity, phi);
    let [falling, _] = uniform_velocities(&powder, &gas, phi, slip);
    let amplitude = 0.01 / k;
    let mut spheres = lattice(size, NUMBER, powder.diameter, powder.density)?;
    for sphere in &mut spheres {
        let (sine, cosine) = (k * sphere.position[2]).sin_cos();
        let z = sphere.position[2] + amplitude * sine;
        sphere.position[2] = z.rem_euclid(WAVELENGTH);
        // Of the growing wave alone.
        sphere.velocity[2] = amplitude * (theory.re * sine + (theory.im + k * falling) * cosine);
    }
    let mut flow = CfdDem::with_spheres(Grid::new(size, [cells; 3]), setup, &spheres)?;
    let mut logarithms = [0.0; 2];
    for (until, logarithm) in TAKEN.into_iter().zip(&mut logarithms) {
        advance(&mut flow, until)?;
        let sum: c64 = flow
            .particles()
            .positions()
            .iter()
            .map(|position| c64::from_polar(1.0, -k * position.0[2]))
            .sum();
        *logarithm = sum.norm().ln();
    }
    Ok((logarithms[1] - logarithms[0]) / (TAKEN[1] - TAKEN[0]))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn on_coarse_cells_waves_grow_as_they_should_only_if_particles_are_spread_over_them() {
        let error = |width, cells| {
            let (theory, found) = wave(width, cells).unwrap();
            found / theory - 1.0
        };
        assert!(error(SPREAD, 8).abs() < 0.01);
        // What cells of 10/3 d alone spread them to.
        let bare = error(1.36, 8);
        assert!((-0.2..-0.1).contains(&bare), "{bare}");
    }
}
