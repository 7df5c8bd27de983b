use super::*;
use crate::case::{Diameters, Places};
use crate::dem::lattice;
use crate::laws::drag::WenYu;
use crate::laws::scales::tests::{GAS, POWDER};
use crate::rows::on_threads;

/// The founding paper's powder, in cells of 3 1/3 d.
pub(super) fn setup(solids_fraction: f64) -> Setup {
    Setup {
        powder: POWDER,
        gas: GAS,
        gravity: 9.81,
        drag: DragChoice::WenYu,
        mixture: MixtureChoice::OwnDiameter,
        gas_inertia: true,
        gas_stress: false,
        drive: Drive::PressureGradient,
        solids_fraction,
        contact: Contact {
            stiffness: 2.0,
            restitution: 0.9,
            tangential_stiffness: 2.0 / 7.0,
            tangential_damping: 0.5,
            friction: 0.3,
            cohesion: 0.0,
        },
        steps_per_contact: 20.0,
        mapping: MappingChoice::Trilinear,
        smoothing: 0.0,
        rhythm: 1e-3,
        seed: 1,
        parallel: false,
    }
}

pub(super) fn grid(cells: [usize; 3]) -> Grid<3> {
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

/// Particles at random places, of several diameters.
fn mixed(grid: Grid<3>, setup: Setup, deviation: f64) -> CfdDem {
    let diameters = Diameters::LogNormal(deviation);
    let start = ParticlesStart { places: Places::Random, diameters };
    let spheres = spheres(&grid, &setup, &start).unwrap();
    CfdDem::with_spheres(grid, setup, &spheres).unwrap()
}

/// A set-up that differs from the usual one in all that a case may choose.
fn other(solids_fraction: f64) -> Setup {
    let setup = setup(solids_fraction);
    Setup {
        mixture: MixtureChoice::VanDerHoef,
        gas_stress: true,
        drive: Drive::GasFlux(None),
        contact: Contact { cohesion: 0.02, ..setup.contact },
        smoothing: 1.5e-4,
        ..setup
    }
}

#[test]
fn momentum_volume_and_particles_are_kept() {
    for setup in [
        setup(0.15),
        Setup { mapping: MappingChoice::Divided, smoothing: 2e-4, ..setup(0.15) },
        Setup { gas_inertia: false, ..other(0.15) },
        other(0.15),
    ] {
        let Setup { mapping, smoothing, .. } = setup;
        let mut flow = if setup.gas_stress {
            mixed(grid([8, 10, 12]), setup, 1.25)
        } else {
            CfdDem::new(grid([8, 10, 12]), setup).unwrap()
        };
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
fn a_gas_flux_is_kept_by_a_gradient_that_finds_its_value() {
    // Of an array: the gradient is that of its drag. At half of its slip it falls.
    for part in [0.5, 1.0, 1.5] {
        let grid = grid([8, 8, 8]);
        let phi = 4096.0 * PI / 6.0 * POWDER.diameter.powi(3) / 8e-9;
        let slip = part * homogeneous_slip(&WenYu::new(&GAS, &POWDER), &POWDER, &GAS, 9.81, phi);
        let drive = Drive::GasFlux(Some((1.0 - phi) * slip));
        let mut flow = on_a_lattice(grid, [16; 3], Setup { drive, ..setup(0.1) });
        while flow.time() < 5e-3 {
            flow.step(5e-3).unwrap();
        }
        let means = flow.means();
        assert!((means.slip / slip - 1.0).abs() < 1e-12, "{part}: {}", means.slip / slip);
        let weight = (1.0 - phi) * (POWDER.density - GAS.density) * 9.81;
        let expected = flow.law.beta_per_fraction(phi, slip) * slip / weight;
        assert!((means.pressure_gradient / expected - 1.0).abs() < 1e-3, "{part}: {means:?}");
    }
    // Of a clustering bed: the flux stays, the gradient moves.
    let mut flow =
        CfdDem::new(grid([8, 8, 16]), Setup { drive: Drive::GasFlux(None), ..setup(0.15) })
            .unwrap();
    let wanted = flow.uniform_slip();
    let (mut least, mut most) = (f64::INFINITY, 0.0f64);
    for n in 1..=20 {
        let until = 2e-3 * f64::from(n);
        while flow.time() < until {
            flow.step(until).unwrap();
            let means = flow.means();
            assert!((means.slip / wanted - 1.0).abs() < 1e-11, "{}", means.slip / wanted);
            least = least.min(means.pressure_gradient);
            most = most.max(means.pressure_gradient);
        }
    }
    println!("{least} {most}");
    assert!(least > 0.2 && most < 1.5 && most - least > 1e-3, "{least} {most}");
}

#[test]
fn a_shear_wave_of_the_gas_decays_by_its_viscosity() {
    // Waves of x and y along z, and what a box without a molecular stress leaves of them.
    let grid = grid([8, 8, 16]);
    let sphere = dem::Sphere {
        position: [1e-3; 3],
        velocity: [0.0; 3],
        spin: [0.0; 3],
        diameter: POWDER.diameter,
        density: POWDER.density,
    };
    let time = 0.01;
    let amplitudes = |gas_stress| {
        let setup = Setup { gas_stress, gravity: 1e-3, ..setup(0.0) };
        let mut flow = CfdDem::with_spheres(grid, setup, &[sphere]).unwrap();
        let wave = |k: usize| (2.0 * PI * (k as f64 + 0.5) / 16.0).sin();
        flow.gas[0].set(|[_, _, k]| 1e-3 * wave(k));
        flow.gas[1].set(|[_, _, k]| -2e-3 * wave(k));
        while flow.time() < time {
            flow.step(time).unwrap();
        }
        [0, 1].map(|axis| {
            let (mut sum, mut place) = (0.0, 0);
            for row in flow.gas[axis].interior() {
                sum += wave(place / 8) * row.iter().sum::<f64>();
                place += 1;
            }
            sum
        })
    };
    let (with, without) = (amplitudes(true), amplitudes(false));
    // The difference operator's square of the wave number.
    let square = 2.0 * (1.0 - (2.0 * PI / 16.0).cos()) / (0.25e-3 * 0.25e-3);
    let expected = (-GAS.viscosity / GAS.density * square * time).exp();
    for axis in 0..2 {
        let found = with[axis] / without[axis];
        assert!((found.ln() / expected.ln() - 1.0).abs() < 0.02, "{found} {expected}");
    }
}

/// A regular array of two diameters whose Sauter mean is the powder's.
fn of_two_sizes(grid: Grid<3>, setup: Setup) -> (CfdDem, [f64; 2]) {
    let small = POWDER.diameter * 3.25 / 4.375;
    let sizes = [small, 1.5 * small];
    let mut spheres = lattice(grid.size(), [16; 3], sizes[1], POWDER.density).unwrap();
    for (n, sphere) in spheres.iter_mut().enumerate() {
        sphere.diameter = sizes[(n % 16 + n / 16 % 16 + n / 256) % 2];
    }
    (CfdDem::with_spheres(grid, setup, &spheres).unwrap(), sizes)
}

#[test]
fn drag_on_a_mixture_is_that_of_each_diameter() {
    for mixture in [MixtureChoice::OwnDiameter, MixtureChoice::VanDerHoef] {
        let (flow, sizes) = of_two_sizes(grid([8; 3]), Setup { mixture, ..setup(0.0) });
        let mut fine = FineFields::zeros(flow.grid);
        flow.fields(&mut fine);
        let (phi, slip) = (flow.setup.solids_fraction, flow.uniform_slip());
        assert!((sauter_mean(sizes.into_iter()) / POWDER.diameter - 1.0).abs() < 1e-14);
        let cubes = sizes.map(|d| d.powi(3));
        let whole: f64 = cubes.iter().sum();
        // By the law of each diameter, or of the mean one.
        let expected: f64 = match mixture {
            MixtureChoice::OwnDiameter => (0..2)
                .map(|n| {
                    let powder = Powder { diameter: sizes[n], ..POWDER };
                    let law = WenYu::<f64>::new(&GAS, &powder);
                    law.beta_per_fraction(phi, slip) * phi * cubes[n] / whole * slip
                })
                .sum(),
            MixtureChoice::VanDerHoef => WenYu::<f64>::new(&GAS, &POWDER).beta(phi, slip) * slip,
        };
        for cell in 0..flow.grid.len() {
            assert!((fine.drag[2][cell] / expected - 1.0).abs() < 1e-11, "{mixture:?} {cell}");
            let temperature = fine.granular_temperature[cell];
            assert!(temperature.abs() < 1e-18, "{temperature}");
        }
    }
}

#[test]
fn granular_temperature_weighs_by_mass() {
    let (mut flow, sizes) = of_two_sizes(grid([8; 3]), setup(0.0));
    // Each size of one velocity: by mass m_1 v_1 = -m_2 v_2.
    let cubes = sizes.map(|d| d.powi(3));
    let mut spheres = flow.dem.spheres();
    for sphere in &mut spheres {
        let small = sphere.diameter < 1.1 * sizes[0];
        sphere.velocity = [if small { 0.01 } else { -0.01 * cubes[0] / cubes[1] }, 0.0, 0.0];
    }
    flow = CfdDem::with_spheres(flow.grid, flow.setup, &spheres).unwrap();
    let mut fine = FineFields::zeros(flow.grid);
    flow.fields(&mut fine);
    // ⟨m v²⟩/(3 ⟨m⟩) with ⟨m v⟩ = 0.
    let expected = 1e-4 * cubes[0] / cubes[1] / 3.0;
    for cell in 0..flow.grid.len() {
        assert!((fine.granular_temperature[cell] / expected - 1.0).abs() < 1e-9);
        let pressure = POWDER.density * flow.setup.solids_fraction * expected;
        assert!((fine.solids_pressure[cell] / pressure - 1.0).abs() < 1e-9);
    }
}

#[test]
fn spheres_of_a_cubic_packing_touch_six_others() {
    // Cells of 1.5 d, 12 spheres along each edge, a little closer than they touch.
    let edge = 12.0 * 0.999 * POWDER.diameter;
    let grid = Grid::new([edge; 3], [8; 3]);
    let mut spheres =
        lattice(grid.size(), [12; 3], 0.999 * POWDER.diameter, POWDER.density).unwrap();
    spheres.iter_mut().for_each(|sphere| sphere.diameter = POWDER.diameter);
    let mut flow = CfdDem::with_spheres(grid, setup(0.0), &spheres).unwrap();
    flow.step(f64::INFINITY).unwrap();
    let mut fine = FineFields::zeros(flow.grid);
    flow.fields(&mut fine);
    let counts = fine.counts.unwrap();
    for (number, contacts) in counts.number_density.iter().zip(&counts.contact_density) {
        assert!((contacts / number - 6.0).abs() < 1e-9, "{}", contacts / number);
    }
}

#[test]
fn cohesion_holds_a_bed_together() {
    // Two beds that shear in gas: with a pull particles touch more others.
    let coordination = |cohesion| {
        let setup = setup(0.3);
        let contact = Contact { cohesion, ..setup.contact };
        let mut flow = CfdDem::new(grid([8, 8, 16]), Setup { contact, ..setup }).unwrap();
        while flow.time() < 0.02 {
            flow.step(0.02).unwrap();
        }
        2.0 * flow.touches.len() as f64 / flow.dem.len() as f64
    };
    // Bo = F_c/(m g) of about 0 and 300.
    let [loose, sticky] = [0.0, 0.05].map(coordination);
    assert!(sticky > 1.5 * loose && sticky > 1.0, "{loose} {sticky}");
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
    for all in [false, true] {
        goes_on(all);
    }
}

/// A box of the usual set-up, or of one that has all that a case may choose.
fn goes_on(all: bool) {
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
    let new = |parallel| {
        if all {
            mixed(grid([8, 8, 16]), Setup { parallel, ..other(0.2) }, 1.2)
        } else {
            CfdDem::new(grid([8, 8, 16]), Setup { parallel, ..setup(0.2) }).unwrap()
        }
    };
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
    assert_eq!(a.drag, b.drag);
    assert_eq!(a.counts, b.counts);

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
    // All particles, and either of each contact.
    let counts = fine.counts.as_ref().unwrap();
    let volume = cells * flow.grid.cell_volume();
    assert!((mean(&|c| counts.number_density[c]) * volume / number - 1.0).abs() < 1e-12);
    let ends = 2.0 * flow.touches.len() as f64;
    assert!((mean(&|c| counts.contact_density[c]) * volume / ends - 1.0).abs() < 1e-12);
    // The drag that is filtered is that on the particles.
    let drag = mean(&|c| fine.drag[2][c]);
    let mut whole = 0.0;
    for (place, position) in flow.dem.positions().iter().enumerate() {
        let [ux, uy, uz] = flow.mapping.face_shares(*position).0.see(&flow.pulls);
        let [x, y, z] = flow.dem.velocities()[place].vector();
        let speed = ((ux - x).powi(2) + (uy - y).powi(2) + (uz - z).powi(2)).sqrt();
        let [_, _, _, seen] = flow.mapping.shares(*position).see(&flow.seen);
        whole += flow.law.beta_per_fraction(seen, speed) * (uz - z) * flow.volume;
    }
    let whole = whole / (cells * flow.grid.cell_volume());
    assert!((drag / whole - 1.0).abs() < 1e-12, "{drag} {whole}");
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
