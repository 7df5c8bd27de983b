use super::*;
use crate::dem::lattice;
use crate::laws::scales::tests::{GAS, POWDER};
use crate::rows::on_threads;

/// The founding paper's powder, in cells of 3 1/3 d.
fn setup(solids_fraction: f64) -> Setup {
    Setup {
        powder: POWDER,
        gas: GAS,
        gravity: 9.81,
        drag: DragChoice::WenYu,
        gas_inertia: true,
        solids_fraction,
        contact: Contact {
            stiffness: 2.0,
            restitution: 0.9,
            tangential_stiffness: 2.0 / 7.0,
            tangential_damping: 0.5,
            friction: 0.3,
        },
        steps_per_contact: 20.0,
        mapping: MappingChoice::Trilinear,
        smoothing: 0.0,
        rhythm: 1e-3,
        seed: 1,
        parallel: false,
    }
}

fn grid(cells: [usize; 3]) -> Grid<3> {
    Grid::new(cells.map(|n| 0.25e-3 * n as f64), cells)
}

/// `number` spheres along each axis, at rest.
fn on_a_lattice(grid: Grid<3>, number: [usize; 3], setup: Setup) -> CfdDem {
    let spheres = lattice(grid.size(), number, POWDER.diameter, POWDER.density).unwrap();
    CfdDem::with_spheres(grid, setup, &spheres).unwrap()
}

#[test]
fn a_uniform_array_keeps_the_slip_of_its_drag_law() {
    // Two or three particles along the edge of a cell: φ is uniform, whatever the mapping.
    for (per_cell, mapping) in
        [(2, MappingChoice::Trilinear), (3, MappingChoice::Trilinear), (2, MappingChoice::Divided)]
    {
        let grid = grid([8, 8, 8]);
        let mut flow = on_a_lattice(grid, [8 * per_cell; 3], Setup { mapping, ..setup(0.1) });
        let phi = flow.setup.solids_fraction;
        while flow.time() < 2e-3 {
            flow.step(2e-3).unwrap();
        }
        let means = flow.means();
        let expected = flow.uniform_slip();
        assert!((means.slip / expected - 1.0).abs() < 1e-9, "{phi} {}", means.slip / expected);
        assert!((means.particle_slip / expected - 1.0).abs() < 1e-9);
        assert!(means.solids_fraction_variance < 1e-15, "{}", means.solids_fraction_variance);
        let weight = phi * (1.0 - phi) * (POWDER.density - GAS.density) * 9.81;
        let drag = flow.law.beta(phi, means.slip) * means.slip;
        assert!((drag / weight - 1.0).abs() < 1e-9);
    }
}

#[test]
fn momentum_volume_and_particles_are_kept() {
    for (mapping, smoothing, gas_inertia) in [
        (MappingChoice::Trilinear, 0.0, true),
        (MappingChoice::Divided, 2e-4, true),
        (MappingChoice::Trilinear, 1e-4, false),
    ] {
        let setup = Setup { mapping, smoothing, gas_inertia, ..setup(0.15) };
        let mut flow = CfdDem::new(grid([8, 10, 12]), setup).unwrap();
        let start = flow.means();
        while flow.time() < 0.01 {
            let report = flow.step(0.01).unwrap();
            assert!(report.volume_residual < 2.0 * TOLERANCE);
        }
        let end = flow.means();
        let scale = POWDER.density * 0.15 * flow.scales.terminal_velocity;
        for axis in 0..3 {
            let drift = (end.momentum[axis] - start.momentum[axis]) / scale;
            assert!(drift.abs() < 1e-12, "{mapping:?} {smoothing}: {drift:e} along {axis}");
        }
        assert!((end.solids_fraction / flow.setup.solids_fraction - 1.0).abs() < 1e-12);
        // They have moved against each other by now.
        assert!(flow.dem.temperature() > 1e-8);
    }
}

#[test]
fn one_particle_settles_at_its_terminal_velocity() {
    // Cells of 50 d: the gas that it drags along with it is little.
    let grid = Grid::new([0.03, 0.03, 0.03], [8, 8, 8]);
    let sphere = dem::Sphere {
        position: [0.0151, 0.0147, 0.015],
        velocity: [0.0; 3],
        spin: [0.0; 3],
        diameter: POWDER.diameter,
        density: POWDER.density,
    };
    let mut flow = CfdDem::with_spheres(grid, setup(0.0), &[sphere]).unwrap();
    // Let go from rest against the gas.
    let falling = flow.dem.velocities()[0].0[2];
    flow.gas[2].set(|_| falling);
    let (u_t, relaxation) = (flow.scales.terminal_velocity, flow.scales.time());
    for n in 1..=10 {
        let until = 0.02 * f64::from(n);
        while flow.time() < until {
            flow.step(until).unwrap();
        }
        let means = flow.means();
        // Slower than by Stokes's law, which the law's at rest is.
        let share = 1.0 - (-until / relaxation).exp();
        println!("{until} {} {share}", means.slip / u_t);
        if n < 4 {
            assert!(means.slip < u_t && means.slip > share * u_t * 0.98);
        }
    }
    let means = flow.means();
    assert!((means.particle_slip / u_t - 1.0).abs() < 1e-3, "{}", means.particle_slip / u_t);
    assert!((means.slip / u_t - 1.0).abs() < 2e-3, "{}", means.slip / u_t);
}

#[test]
fn a_box_goes_on_from_its_state_to_the_same_bits_whatever_the_threads() {
    let state = |flow: &CfdDem| {
        let mut bytes = Vec::new();
        flow.save_state(&mut bytes).unwrap();
        bytes
    };
    let advance = |flow: &mut CfdDem, until: f64| {
        while flow.time() < until {
            flow.step(until).unwrap();
        }
    };
    let new = |parallel| CfdDem::new(grid([8, 8, 16]), Setup { parallel, ..setup(0.2) }).unwrap();
    let mut whole = new(false);
    advance(&mut whole, 4e-3);
    let kept = state(&whole);
    advance(&mut whole, 8e-3);
    let expected = state(&whole);

    let mut other = new(false);
    other.restore_state(&mut kept.as_slice()).unwrap();
    assert_eq!(other.means(), {
        let mut again = new(false);
        advance(&mut again, 4e-3);
        again.means()
    });
    advance(&mut other, 8e-3);
    assert!(state(&other) == expected);
    let [mut a, mut b] = [FineFields::zeros(whole.grid), FineFields::zeros(whole.grid)];
    whole.fields(&mut a);
    other.fields(&mut b);
    assert_eq!(a.solids_stress, b.solids_stress);
    assert_eq!(a.drag_coefficient, b.drag_coefficient);

    on_threads(3, || {
        let mut shared = new(true);
        advance(&mut shared, 4e-3);
        advance(&mut shared, 8e-3);
        assert!(state(&shared) == expected);
    })
    .unwrap();

    for cut in [0, 10, kept.len() / 2, kept.len() - 1] {
        assert!(new(false).restore_state(&mut &kept[..cut]).is_err());
    }
    let mut turned = CfdDem::new(grid([8, 16, 8]), setup(0.2)).unwrap();
    let refused = turned.restore_state(&mut kept.as_slice());
    assert!(matches!(refused, Err(StateError::Cells { .. })));
}

#[test]
fn fields_are_sums_over_particles() {
    let mut flow = CfdDem::new(grid([8, 8, 16]), setup(0.3)).unwrap();
    while flow.time() < 5e-3 {
        flow.step(5e-3).unwrap();
    }
    let mut fine = FineFields::zeros(flow.grid);
    flow.fields(&mut fine);
    let cells = flow.grid.len() as f64;
    let mean =
        |values: &dyn Fn(usize) -> f64| (0..flow.grid.len()).map(values).sum::<f64>() / cells;
    let phi = flow.setup.solids_fraction;
    assert!((mean(&|c| fine.solids_fraction[c]) / phi - 1.0).abs() < 1e-12);
    let number = flow.dem.len() as f64;
    let mut energy = 0.0;
    for axis in 0..3 {
        let found = mean(&|c| fine.solids_fraction[c] * fine.solids_velocity[axis][c]);
        let expected = phi * flow.dem.velocities().iter().map(|v| v.0[axis]).sum::<f64>() / number;
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        energy += flow.dem.velocities().iter().map(|v| v.0[axis].powi(2)).sum::<f64>() / number;
    }
    // Particle-scale and mesoscale parts of the energy of the particles are the whole.
    let split = mean(&|c| {
        let square: f64 = (0..3).map(|a| fine.solids_velocity[a][c].powi(2)).sum();
        fine.solids_fraction[c] * (square + 3.0 * fine.granular_temperature[c])
    });
    assert!((split / (phi * energy) - 1.0).abs() < 1e-12, "{split} {energy}");
    // Pressure of contacts and of flight, and the virial of the particles' contacts.
    let virial: f64 = flow
        .touches
        .iter()
        .map(|touch| (0..3).map(|a| touch.force[a] * touch.arm[a]).sum::<f64>())
        .sum::<f64>()
        / (3.0 * cells * flow.grid.cell_volume());
    let flight = mean(&|c| POWDER.density * fine.solids_fraction[c] * fine.granular_temperature[c]);
    let found = mean(&|c| fine.solids_pressure[c]);
    assert!((found - virial - flight).abs() < 1e-9 * found.abs(), "{found} {virial} {flight}");
    // Drag as the filter finds it is that on the particles, nearly.
    let drag = mean(&|c| {
        fine.drag_coefficient[c] * (fine.gas_velocity[2][c] - fine.solids_velocity[2][c])
    });
    let mut whole = 0.0;
    for (place, position) in flow.dem.positions().iter().enumerate() {
        let [ux, uy, uz, ..] = flow.mapping.shares(*position).see(&flow.pulls);
        let [x, y, z] = flow.dem.velocities()[place].vector();
        let speed = ((ux - x).powi(2) + (uy - y).powi(2) + (uz - z).powi(2)).sqrt();
        let [_, _, _, seen] = flow.mapping.shares(*position).see(&flow.seen);
        whole += flow.law.beta_per_fraction(seen, speed) * (uz - z) * flow.volume;
    }
    let whole = whole / (cells * flow.grid.cell_volume());
    println!("drag {drag} of {whole}");
    assert!((drag / whole - 1.0).abs() < 0.05, "{drag} {whole}");
}

#[test]
fn hard_boxes_run_or_say_why_not_and_lose_no_particle() {
    let advance = |flow: &mut CfdDem| -> Result<(), StepError> {
        while flow.time() < 3e-3 {
            flow.step(3e-3)?;
        }
        Ok(())
    };
    let [smooth, elastic] = {
        let contact = setup(0.0).contact;
        [Contact { friction: 0.0, ..contact }, Contact { restitution: 1.0, ..contact }]
    };
    let small = |n: usize| {
        // Cells of 1.5 d: a particle alone fills a third of one.
        Grid::new([1.125e-4 * n as f64; 3], [n; 3])
    };
    for (name, grid, setup) in [
        ("densest", grid([8, 8, 8]), setup(0.6)),
        ("smooth", grid([8, 8, 8]), Setup { contact: smooth, ..setup(0.3) }),
        ("elastic", grid([8, 8, 8]), Setup { contact: elastic, ..setup(0.3) }),
        ("small cells", small(12), Setup { smoothing: 1.2e-4, ..setup(0.5) }),
        (
            "small cells, divided",
            small(12),
            Setup { mapping: MappingChoice::Divided, smoothing: 1.2e-4, ..setup(0.2) },
        ),
    ] {
        let mut flow = CfdDem::new(grid, setup).unwrap();
        let number = flow.dem.len();
        advance(&mut flow).unwrap_or_else(|why| panic!("{name}: {why}"));
        let size = flow.grid.size();
        let spheres = flow.dem.spheres();
        assert_eq!(spheres.len(), number, "{name}");
        let inside =
            |sphere: &dem::Sphere| (0..3).all(|a| (0.0..=size[a]).contains(&sphere.position[a]));
        assert!(spheres.iter().all(inside), "{name}");
        // Nothing is thrown about: speeds are those of a bed.
        let u_t = flow.scales.terminal_velocity;
        assert!(flow.dem.temperature().sqrt() < u_t, "{name}");
    }

    // Shot at a hundred times its terminal velocity: too fast for steps of so soft a contact.
    let grid = grid([8, 8, 8]);
    let mut spheres = lattice(grid.size(), [10; 3], POWDER.diameter, POWDER.density).unwrap();
    spheres[500].velocity = [22.0, 3.0, 0.0];
    let mut flow = CfdDem::with_spheres(grid, setup(0.0), &spheres).unwrap();
    let refused = advance(&mut flow).unwrap_err();
    let StepError::Particles(why) = &refused else { panic!("{refused}") };
    assert!(why.to_string().contains("raise"), "{why}");

    // More than spheres can fill of a cell.
    let mut flow = CfdDem::new(small(12), setup(0.5)).unwrap();
    flow.filled[12 * 12 + 12 * 2 + 3] = [0.97];
    let full = flow.check_filled().unwrap_err().to_string();
    assert!(full.contains("0.97 of the cell at (3, 2, 1)") && full.contains("smoothing"), "{full}");
    let none = CfdDem::new(small(8), setup(1e-6)).map(|_| ()).unwrap_err().to_string();
    assert!(none.contains("one at least"), "{none}");
}
