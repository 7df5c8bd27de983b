use super::*;
use crate::laws::contact::{separation_energy, sticking_speed};
use crate::rows::on_threads;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const DIAMETER: f64 = 75e-6;
const DENSITY: f64 = 1500.0;

fn setup(size: [f64; 3], restitution: f64, friction: f64, parallel: bool) -> Setup {
    let contact = Contact {
        stiffness: 14.0,
        restitution,
        tangential_stiffness: 2.0 / 7.0,
        tangential_damping: 0.5,
        friction,
        cohesion: 0.0,
    };
    Setup { size, contact, steps_per_contact: 50.0, skin: SKIN, parallel }
}

fn sphere(position: [f64; 3], velocity: [f64; 3]) -> Sphere {
    Sphere { position, velocity, spin: [0.0; 3], diameter: DIAMETER, density: DENSITY }
}

/// A hot dense powder of unequal, rough spheres in a box that is not a cube.
fn powder(number: usize, fraction: f64, ratio: f64, parallel: bool) -> Dem {
    let mut random = Pcg64Mcg::seed_from_u64(8);
    let diameters: Vec<f64> =
        (0..number).map(|_| DIAMETER * (1.0 + (ratio - 1.0) * random.random::<f64>())).collect();
    let solids: f64 = diameters.iter().map(|d| PI / 6.0 * d.powi(3)).sum();
    let edge = (solids / fraction / 1.5).cbrt();
    let size = [edge, 1.5 * edge, edge];
    let mut spheres = packed(size, &diameters, DENSITY, 2, parallel).unwrap();
    thermal(&mut spheres, 0.01, 3);
    Dem::new(setup(size, 0.8, 0.3, parallel), &spheres).unwrap()
}

fn bytes(dem: &Dem) -> Vec<u8> {
    let mut bytes = Vec::new();
    dem.save_state(&mut bytes).unwrap();
    bytes
}

/// Σ m x × v + I ω about the middle of a box that nothing leaves.
fn angular_momentum(spheres: &[Sphere]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for s in spheres {
        let mass = PI / 6.0 * s.density * s.diameter.powi(3);
        let (x, v) = (s.position, s.velocity);
        for n in 0..3 {
            let (a, b) = ((n + 1) % 3, (n + 2) % 3);
            let spin = 0.1 * mass * s.diameter.powi(2) * s.spin[n];
            sum[n] += mass * (x[a] * v[b] - x[b] * v[a]) + spin;
        }
    }
    sum
}

#[test]
fn a_pair_keeps_momentum_and_angular_momentum() {
    let size = [6e-4; 3];
    let mut a = sphere([2.5e-4, 3.1e-4, 3.0e-4], [0.15, -0.02, 0.01]);
    a.spin = [100.0, -2000.0, 700.0];
    let b = Sphere { diameter: 2e-4, ..sphere([4.0e-4, 3.0e-4, 2.9e-4], [-0.05, 0.03, 0.02]) };
    let mut dem = Dem::new(setup(size, 0.7, 0.3, false), &[a, b]).unwrap();
    let before = angular_momentum(&dem.spheres());
    let momentum = dem.momentum();
    let mut most = 0;
    for _ in 0..1500 {
        dem.run(1).unwrap();
        most = most.max(dem.touching());
    }
    assert_eq!((most, dem.touching()), (1, 0), "they met and parted");
    assert!(dem.energy().lost > 0.0);
    let after = angular_momentum(&dem.spheres());
    let scale = before.iter().map(|l| l.abs()).sum::<f64>();
    let moved = momentum.iter().map(|p| p.abs()).sum::<f64>();
    for n in 0..3 {
        assert!((after[n] - before[n]).abs() < 1e-12 * scale, "{after:?} {before:?}");
        assert!((dem.momentum()[n] - momentum[n]).abs() < 1e-13 * moved);
    }
}

#[test]
fn contacts_are_all_pairs_that_overlap() {
    for (number, fraction, ratio) in [(12, 0.3, 1.0), (60, 0.5, 2.0), (700, 0.55, 4.0)] {
        let mut dem = powder(number, fraction, ratio, false);
        let size = dem.setup.size;
        let mut seen = 0;
        for _ in 0..40 {
            dem.run(40).unwrap();
            let spheres = dem.spheres();
            let mut overlapping = 0;
            for (n, a) in spheres.iter().enumerate() {
                for b in &spheres[..n] {
                    let square: f64 = (0..3)
                        .map(|axis| {
                            let d = a.position[axis] - b.position[axis];
                            (d - size[axis] * (d / size[axis]).round()).powi(2)
                        })
                        .sum();
                    overlapping += usize::from(square.sqrt() < 0.5 * (a.diameter + b.diameter));
                }
            }
            assert_eq!(dem.touching(), overlapping);
            seen += overlapping;
        }
        assert!(seen > 0 && dem.rebuilds() > 2, "{seen} {}", dem.rebuilds());
    }
}

#[test]
fn the_bits_are_the_same_on_any_number_of_threads_and_in_any_portions() {
    let run = |fraction: f64, least: usize, parallel: bool, portions: &[u64]| {
        let mut dem = powder(3000, fraction, 1.5, parallel);
        dem.drives_mut().fill(Quad([1.0, 0.0, -9.81, 0.0]));
        portions.iter().for_each(|&steps| dem.run(steps).unwrap());
        assert!(dem.rebuilds() > 2 && dem.touching() > least);
        assert_eq!(dem.groups.apart, fraction < 0.4);
        bytes(&dem)
    };
    for (fraction, least) in [(0.5, 10), (0.15, 3)] {
        let run = |parallel: bool, portions: &[u64]| run(fraction, least, parallel, portions);
        let serial = run(false, &[900]);
        assert!(serial == run(false, &[1, 17, 582, 300]), "in portions");
        for threads in [1, 2, 3, 5] {
            let parallel = on_threads(threads, || run(true, &[900])).unwrap();
            assert!(serial == parallel, "{threads} threads");
        }
    }
}

/// What there is of each particle, by its number.
fn bodies(dem: &Dem) -> Vec<[Quad; 4]> {
    let mut bodies = vec![[Quad::default(); 4]; dem.len()];
    for (place, &id) in dem.ids().iter().enumerate() {
        let (x, v) = (dem.particles.positions[place], dem.particles.velocities[place]);
        bodies[id as usize] = [x, v, dem.particles.spins[place], dem.particles.forces[place]];
    }
    bodies
}

/// Makes `steps` steps one by one, as where clusters join throughout the box.
fn one_by_one(dem: &mut Dem, steps: u64) -> Result<(), StepError> {
    for _ in 0..steps {
        dem.part();
        dem.run(1)?;
    }
    Ok(())
}

#[test]
fn rounds_leave_the_bits_of_steps_made_one_by_one() {
    let pulls = [[0.0, 0.0, -9.81, 0.0], [3.0, 0.0, -9.81, 45.0]];
    for (fraction, ratio, pull) in
        [(0.05, 1.0, None), (0.2, 1.5, Some(pulls[0])), (0.1, 3.0, Some(pulls[1]))]
    {
        let mut dem = powder(3000, fraction, ratio, false);
        if let Some(pull) = pull {
            dem.drives_mut().fill(Quad(pull));
        }
        let mut other = dem.clone();
        let mut most = 0;
        for _ in 0..20 {
            dem.run(40).unwrap();
            assert!(dem.groups.apart);
            one_by_one(&mut other, 40).unwrap();
            assert!(bodies(&dem) == bodies(&other), "{fraction}");
            assert_eq!((dem.rebuilds(), dem.touching()), (other.rebuilds(), other.touching()));
            most = most.max(dem.touching());
        }
        assert!(most > 3, "{most}");
        let (energy, same) = (dem.energy(), other.energy());
        assert!((energy.lost / same.lost - 1.0).abs() < 1e-12 && energy.lost > 0.0);
        assert!((energy.springs - same.springs).abs() < 1e-12 * energy.kept());
    }
}

#[test]
fn a_round_ends_where_a_step_would() {
    let size = [24.0 * DIAMETER; 3];
    let still = lattice(size, [8; 3], DIAMETER, DENSITY).unwrap();
    let dem = |speed: f64, density: f64| {
        let mut spheres = still.clone();
        let [x, y, z] = spheres[100].position;
        let position = [x, y, z + 1.5 * DIAMETER];
        let velocity = [0.0, 0.0, -speed];
        spheres.push(Sphere { velocity, density, ..sphere(position, [0.0; 3]) });
        Dem::new(setup(size, 0.9, 0.1, false), &spheres).unwrap()
    };
    // The light one is made faster than anything was.
    let mut hit = dem(0.5, 100.0 * DENSITY);
    let mut other = hit.clone();
    hit.run(900).unwrap();
    assert!(hit.groups.apart && hit.touching() == 0);
    one_by_one(&mut other, 900).unwrap();
    assert!(hit.spheres()[100].velocity[2] < -0.9 && bodies(&hit) == bodies(&other));
    assert_eq!(hit.travelled, other.travelled);
    // One that goes too deep, and one too fast.
    for speed in [15.0, 300.0] {
        let mut fails = dem(speed, DENSITY);
        let mut other = fails.clone();
        assert!(fails.groups.apart);
        let error = fails.run(900).unwrap_err();
        assert_eq!(error, one_by_one(&mut other, 900).unwrap_err());
        assert_eq!(matches!(error, StepError::Fast { .. }), speed > 100.0, "{error}");
        assert!(bodies(&fails) == bodies(&other));
    }
}

#[test]
fn a_state_goes_on_to_the_same_bits() {
    for fraction in [0.1, 0.5] {
        let mut dem = powder(800, fraction, 2.0, false);
        dem.drives_mut().fill(Quad([0.0, 0.0, -9.81, 40.0]));
        dem.run(333).unwrap();
        let state = bytes(&dem);
        dem.run(500).unwrap();
        let mut other = powder(800, fraction, 2.0, false);
        other.restore_state(&mut &state[..]).unwrap();
        assert!(bytes(&other) == state);
        other.run(500).unwrap();
        assert!(bytes(&other) == bytes(&dem));
        refuses(other, &state);
    }
}

/// Whether a simulator of 800 spheres refuses a state that is cut short, of other spheres, or damaged, and is as
/// it was then.
fn refuses(mut other: Dem, state: &[u8]) {
    let before = bytes(&other);
    assert!(matches!(other.restore_state(&mut &state[..999]), Err(StateError::Read(_))));
    let fewer = powder(799, 0.5, 2.0, false);
    let error = other.restore_state(&mut &bytes(&fewer)[..]).unwrap_err().to_string();
    assert!(error.contains("spheres: 799, the simulator of 800"), "{error}");
    let mut damaged = state.to_vec();
    damaged[15 * 8 + 3] = 1;
    assert!(matches!(other.restore_state(&mut &damaged[..]), Err(StateError::Damaged(_))));
    assert!(bytes(&other) == before);
}

#[test]
fn spheres_are_packed_without_overlap() {
    for (fraction, ratio) in [(0.6, 1.0), (0.6, 4.0), (0.05, 1.0)] {
        let dem = powder(1500, fraction, ratio, false);
        assert_eq!(dem.touching(), 0);
        assert!((dem.temperature() / 0.01 - 1.0).abs() < 1e-12);
    }
    let error = packed([1e-3; 3], &[DIAMETER; 3000], DENSITY, 1, false).unwrap_err();
    assert!(error.to_string().contains("0.663 of the box: at most 0.61"), "{error}");
}

#[test]
fn a_lattice_fits_or_is_refused() {
    let spheres = lattice([4.0 * DIAMETER; 3], [4; 3], DIAMETER, DENSITY).unwrap();
    assert_eq!(spheres.len(), 64);
    let dem = Dem::new(setup([4.0 * DIAMETER; 3], 0.9, 0.1, false), &spheres).unwrap();
    assert!(dem.energy().springs < 1e-30);
    let error = lattice([4.0 * DIAMETER; 3], [4, 5, 4], DIAMETER, DENSITY).unwrap_err();
    assert!(error.to_string().contains("along axis 1"), "{error}");
}

#[test]
fn one_sphere_flies_straight_and_falls_as_it_is_driven() {
    let size = [4e-4; 3];
    let mut dem =
        Dem::new(setup(size, 0.9, 0.1, false), &[sphere([1e-4; 3], [0.1, -0.2, 0.3])]).unwrap();
    dem.run(50_000).unwrap();
    let s = dem.spheres()[0];
    for (axis, v) in [0.1, -0.2, 0.3].into_iter().enumerate() {
        let exact = (1e-4 + v * dem.time()).rem_euclid(size[axis]);
        assert!((s.position[axis] - exact).abs() < 1e-10 * v.abs() * dem.time(), "{axis}");
    }
    // Towards a/λ with time constant 1/λ.
    let mut dem = Dem::new(setup(size, 0.9, 0.1, false), &[sphere([1e-4; 3], [0.0; 3])]).unwrap();
    dem.drives_mut()[0] = Quad([0.0, 0.0, -9.81, 45.0]);
    dem.run(100_000).unwrap();
    let exact = -9.81 / 45.0 * -(-45.0 * dem.time()).exp_m1();
    assert!((dem.spheres()[0].velocity[2] / exact - 1.0).abs() < 1e-5);
}

#[test]
fn what_cannot_be_stepped_is_refused_with_a_reason() {
    let size = [1e-3; 3];
    let pair = |speed: f64| {
        let a = sphere([4e-4, 5e-4, 5e-4], [speed, 0.0, 0.0]);
        Dem::new(setup(size, 0.9, 0.1, false), &[a, sphere([6e-4, 5e-4, 5e-4], [0.0; 3])]).unwrap()
    };
    // 100 terminal velocities: far beyond what 14 N/m holds apart.
    let error = pair(22.0).run(1000).unwrap_err();
    assert!(matches!(error, StepError::Overlap { .. }), "{error}");
    let error = pair(300.0).run(1000).unwrap_err();
    assert!(matches!(error, StepError::Fast { particle: 0, .. }), "{error}");
    let mut dem = pair(0.1);
    dem.drives_mut()[1].0[1] = f64::NAN;
    let error = dem.run(3).unwrap_err();
    assert!(matches!(error, StepError::NotFinite { .. }), "{error}");
    assert!(error.to_string().contains("particle 1"), "{error}");

    let bad = |setup: Setup, spheres: &[Sphere]| Dem::new(setup, spheres).unwrap_err().to_string();
    let one = [sphere([1e-4; 3], [0.0; 3])];
    let error = bad(setup([4e-4, 1.5e-4, 4e-4], 0.9, 0.1, false), &one);
    assert!(error.contains("along axis 1"), "{error}");
    let error = bad(setup(size, 0.0, 0.1, false), &one);
    assert!(error.contains("restitution = 0"), "{error}");
    let error = bad(setup(size, 0.9, -1.0, false), &one);
    assert!(error.contains("friction = -1"), "{error}");
    let error = bad(setup(size, 0.9, 0.1, false), &[sphere([2e-3, 0.0, 0.0], [0.0; 3])]);
    assert!(error.contains("sphere 0: position = 0.002"), "{error}");
}

#[test]
fn no_spheres_are_fine() {
    let mut dem = Dem::new(setup([1e-3; 3], 0.9, 0.1, false), &[]).unwrap();
    dem.run(10).unwrap();
    assert!(dem.is_empty() && dem.momentum() == [0.0; 3]);
}

/// Two spheres on one line that overlap by `overlap` and fly apart at `speed`, without a dashpot.
fn cohesive_pair(overlap: f64, speed: f64, restitution: f64, cohesion: f64) -> Dem {
    let gap = DIAMETER - overlap;
    let a = sphere([2e-4, 3e-4, 3e-4], [-0.5 * speed, 0.0, 0.0]);
    let b = sphere([2e-4 + gap, 3e-4, 3e-4], [0.5 * speed, 0.0, 0.0]);
    let mut setup = setup([6e-4; 3], restitution, 0.3, false);
    setup.contact.cohesion = cohesion;
    setup.steps_per_contact = 100.0;
    Dem::new(setup, &[a, b]).unwrap()
}

#[test]
fn parting_two_spheres_takes_the_energy_of_their_pull() {
    // F_c of 1 % of k_n d: C = 4 F_c/d.
    let stiffness = setup([6e-4; 3], 0.9, 0.3, false).contact.stiffness;
    let force = 0.01 * stiffness * DIAMETER;
    let cohesion = 4.0 * force / DIAMETER;
    let rest = force / stiffness;
    let effective = 0.5 * PI / 6.0 * DENSITY * DIAMETER.powi(3);
    let energy = separation_energy(stiffness, force);
    for (share, parts) in [(0.95, false), (1.05, true)] {
        let speed = (2.0 * share * energy / effective).sqrt();
        let mut dem = cohesive_pair(rest, speed, 1.0, cohesion);
        let before = dem.energy().kept();
        dem.run(400).unwrap();
        assert_eq!(dem.touching() == 0, parts, "{share}");
        let kept = dem.energy();
        // Springs and pull keep what they take, as far as a leapfrog of 100 steps in a contact does.
        let change = (kept.kept() - before) / energy;
        assert!(change.abs() < 2e-3 && (kept.lost / energy).abs() < 2e-3, "{change} {kept:?}");
        if parts {
            // What is left flies off.
            assert!(
                (kept.translation / energy - 0.05).abs() < 0.02,
                "{}",
                kept.translation / energy
            );
        }
    }
    // Damped, they come to rest as far in as the pull is of the spring.
    let mut dem = cohesive_pair(0.5 * rest, 0.0, 0.5, cohesion);
    dem.run(5000).unwrap();
    let spheres = dem.spheres();
    let distance = spheres[1].position[0] - spheres[0].position[0];
    assert!(((DIAMETER - distance) / rest - 1.0).abs() < 1e-6);
    // A pull harder than F_c on either parts them, one that is less does not.
    let lightness = 1.0 / (2.0 * effective);
    for (share, parts) in [(0.98, false), (1.02, true)] {
        let mut dem = dem.clone();
        for step in 1..=2000 {
            // Little by little, so that nothing swings.
            let pull = share * force * lightness * f64::from(step) / 2000.0;
            for place in 0..2 {
                let sign = if dem.ids()[place] == 0 { -1.0 } else { 1.0 };
                dem.drives_mut()[place] = Quad([sign * pull, 0.0, 0.0, 0.0]);
            }
            dem.run(20).unwrap();
            if dem.touching() == 0 {
                break;
            }
        }
        assert_eq!(dem.touching() == 0, parts, "{share} of the pull");
    }
}

#[test]
fn spheres_that_meet_slowly_stick() {
    let stiffness = setup([6e-4; 3], 0.9, 0.3, false).contact.stiffness;
    let force = 0.002 * stiffness * DIAMETER;
    let cohesion = 4.0 * force / DIAMETER;
    let effective = 0.5 * PI / 6.0 * DENSITY * DIAMETER.powi(3);
    for e in [0.6, 0.9] {
        let limit = sticking_speed(stiffness, e, effective, force);
        for (share, parts) in [(0.93, false), (1.07, true)] {
            let mut dem = cohesive_pair(-0.1 * force / stiffness, -share * limit, e, cohesion);
            let mut met = false;
            for _ in 0..40 {
                dem.run(10).unwrap();
                met |= dem.touching() > 0;
            }
            assert!(met);
            assert_eq!(dem.touching() == 0, parts, "{e}: {share}");
        }
    }
}
