//! Spheres in touch: collisions of two against the oscillator that they are, friction against what it
//! takes, a cooling gas of many against kinetic theory, and what must not change.

use super::{Checked, Effort, Expected, Row};
use crate::dem::{Dem, Quad, SKIN, Setup, Sphere, packed, thermal};
use crate::laws::contact::{
    Contact, contact_time, normal_impulse, separation_energy, sticking_restitution, sticking_speed,
};
use std::error::Error;
use std::f64::consts::PI;

/// The founding paper's spheres \[m\], \[kg/m³\].
const DIAMETER: f64 = 75e-6;
const DENSITY: f64 = 1500.0;

/// A stiffness at which they overlap by 1 % at 0.22 m/s \[N/m\].
const STIFFNESS: f64 = 14.0;

fn law(restitution: f64, friction: f64) -> Contact {
    Contact {
        stiffness: STIFFNESS,
        restitution,
        tangential_stiffness: 2.0 / 7.0,
        tangential_damping: 0.5,
        friction,
        cohesion: 0.0,
    }
}

fn setup(size: f64, contact: Contact) -> Setup {
    Setup { size: [size; 3], contact, steps_per_contact: 50.0, skin: SKIN, parallel: false }
}

fn mass() -> f64 {
    PI / 6.0 * DENSITY * DIAMETER.powi(3)
}

fn sphere(position: [f64; 3], velocity: [f64; 3]) -> Sphere {
    Sphere { position, velocity, spin: [0.0; 3], diameter: DIAMETER, density: DENSITY }
}

pub(super) fn check(effort: Effort) -> Checked {
    let mut rows = impacts()?;
    rows.extend(cohesion()?);
    rows.push(slid_to_rest()?);
    rows.push(rolling()?);
    rows.extend(budgets(effort)?);
    rows.extend(cooling(effort)?);
    Ok(rows)
}

/// Two spheres that meet at 0.2 m/s along the first axis, across the box's side, and pass each other at
/// `past` along the second; at `phase` of a step. What their relative velocity and the sum of their
/// spins about the third axis were changed to.
fn impact(law: Contact, approach: f64, past: f64, phase: f64) -> Result<[f64; 3], Box<dyn Error>> {
    let size = 8.0 * DIAMETER;
    let gap = 1.05 * DIAMETER;
    let mut a = sphere([0.4 * gap, 0.5 * size, 0.5 * size], [-0.5 * approach, 0.5 * past, 0.0]);
    let mut b =
        sphere([size - 0.6 * gap, 0.5 * size, 0.5 * size], [0.5 * approach, -0.5 * past, 0.0]);
    // They touch when their centres are on one line along the first axis.
    let time = 0.05 * DIAMETER / approach;
    a.position[1] -= 0.5 * past * time;
    b.position[1] += 0.5 * past * time;
    let setup = setup(size, law);
    let step = Dem::new(setup, &[a, b])?.time_step();
    a.position[0] += phase * step * approach;
    let mut dem = Dem::new(setup, &[a, b])?;
    let mut touched = false;
    let most = 4.0 * (time + contact_time(law.stiffness, law.restitution, 0.5 * mass())) / step;
    for _ in 0..most as u64 {
        dem.run(1)?;
        touched |= dem.touching() > 0;
        if touched && dem.touching() == 0 {
            let spheres = dem.spheres();
            let (a, b) = (&spheres[0], &spheres[1]);
            let [x, y] = [0, 1].map(|axis| a.velocity[axis] - b.velocity[axis]);
            return Ok([x, y, a.spin[2] + b.spin[2]]);
        }
    }
    Err("two spheres did not part".into())
}

/// Whether two spheres that cohere part, which overlap by `overlap` and fly apart at `speed`.
fn part(law: Contact, overlap: f64, speed: f64) -> Result<bool, Box<dyn Error>> {
    let (size, gap) = (8.0 * DIAMETER, DIAMETER - overlap);
    let half = [0.5 * size; 3];
    let [mut a, mut b] =
        [sphere(half, [-0.5 * speed, 0.0, 0.0]), sphere(half, [0.5 * speed, 0.0, 0.0])];
    (a.position[0], b.position[0]) = (half[0] - 0.5 * gap, half[0] + 0.5 * gap);
    let mut dem = Dem::new(setup(size, law), &[a, b])?;
    let time = contact_time(law.stiffness, law.restitution, 0.5 * mass());
    let mut touched = false;
    for _ in 0..(4.0 * time / dem.time_step()) as u64 {
        dem.run(1)?;
        touched |= dem.touching() > 0;
        if touched && dem.touching() == 0 {
            return Ok(true);
        }
    }
    Ok(false)
}

/// What parts two spheres that cohere, from rest and on impact.
fn cohesion() -> Result<Vec<Row>, Box<dyn Error>> {
    let force = 0.002 * STIFFNESS * DIAMETER;
    let rest = force / STIFFNESS;
    let law = |e| Contact { cohesion: 4.0 * force / DIAMETER, ..law(e, 0.3) };
    // Least share of `speed` at which they part, to a thousandth.
    let least = |law: Contact, overlap: f64, speed: f64| -> Result<f64, Box<dyn Error>> {
        let (mut held, mut free) = (0.5, 1.5);
        for _ in 0..10 {
            let middle = 0.5 * (held + free);
            let parts = part(law, overlap, middle * speed)?;
            *(if parts { &mut free } else { &mut held }) = middle;
        }
        Ok(0.5 * (held + free))
    };
    let energy = separation_energy(STIFFNESS, force);
    let mut rows = vec![
        Row::new(
            "spheres that cohere: energy that parts two from rest, over F_c²/(2 k_n)",
            Expected::Near { value: 1.0, within: 0.02 },
            least(law(1.0), rest, (4.0 * energy / mass()).sqrt())?.powi(2),
        )
        .with("work of spring and pull"),
    ];
    for e in [0.6, 0.9] {
        let speed = sticking_speed(STIFFNESS, e, 0.5 * mass(), force);
        rows.push(
            Row::new(
                format!("spheres that cohere, e = {e}: speed up to which they stick, over theory"),
                Expected::Near { value: 1.0, within: 0.03 },
                least(law(e), -0.1 * rest, -speed)?,
            )
            .with("the damped oscillator that comes to rest where they would part"),
        );
    }
    Ok(rows)
}

fn impacts() -> Result<Vec<Row>, Box<dyn Error>> {
    let mut rows = Vec::new();
    for e in [0.3, 0.6, 0.9, 1.0] {
        let mut worst = 0.0f64;
        for phase in 0..40 {
            let [x, ..] = impact(law(e, 0.3), 0.2, 0.0, f64::from(phase) / 40.0)?;
            worst = worst.max((x / 0.2 - e).abs());
        }
        rows.push(
            Row::new(
                format!("restitution of two spheres, e = {e}: largest error"),
                Expected::AtMost(1e-3),
                worst,
            )
            .with("asked for; over 40 places of the first contact in a step"),
        );
    }
    // Slow, so that the line of centres does not turn and arms are radii.
    let (approach, past) = (0.01, 0.004);
    for (e, damped) in [(1.0, 0.5), (0.9, 0.5), (0.6, 1.0)] {
        let law = Contact { tangential_damping: damped, ..law(e, 1e3) };
        let [_, y, spin] = impact(law, approach, past, 0.3)?;
        let found = (y - 0.5 * DIAMETER * spin) / past;
        rows.push(
            Row::new(
                format!("surfaces that stick, e = {e}: tangential restitution"),
                Expected::Near { value: sticking_restitution(&law), within: 0.005 },
                found,
            )
            .with("damped oscillation of the tangential spring over the contact time"),
        );
    }
    for e in [1.0, 0.9] {
        let law = law(e, 0.1);
        // Slower still: a line of centres that turns by an angle passes that share of the push on.
        let (approach, past) = (0.001, 0.002);
        let [_, y, _] = impact(law, approach, past, 0.3)?;
        rows.push(
            Row::new(
                format!("surfaces that slide, e = {e}: tangential over normal impulse"),
                Expected::Near { value: law.friction * normal_impulse(e), within: 0.005 },
                (past - y) / approach,
            )
            .with("Coulomb's law on the normal impulse, μ (1 + e) and what the dashpot pulls"),
        );
    }
    Ok(rows)
}

/// A spinning sphere squeezed between two that are held: its spin falls by 2 μ P r/I a second, evenly.
fn slid_to_rest() -> Result<Row, Box<dyn Error>> {
    let size = 8.0 * DIAMETER;
    let squeeze = 0.002 * DIAMETER;
    let friction = 0.2;
    let at = |offset: f64| [0.5 * size, 0.5 * size, 0.5 * size + offset];
    let mut spinning = sphere(at(0.0), [0.0; 3]);
    let start = 2e5;
    spinning.spin[0] = start;
    let held = |side: f64| Sphere {
        density: f64::INFINITY,
        ..sphere(at(side * (DIAMETER - squeeze)), [0.0; 3])
    };
    let mut dem = Dem::new(setup(size, law(0.9, friction)), &[spinning, held(-1.0), held(1.0)])?;
    let (load, arm) = (STIFFNESS * squeeze, 0.5 * (DIAMETER - squeeze));
    let inertia = 0.1 * mass() * DIAMETER * DIAMETER;
    let time = start * inertia / (2.0 * friction * load * arm);
    let steps = (time / dem.time_step()).round() as u64;
    dem.run(steps / 2)?;
    let lost = (start - dem.spheres()[0].spin[0]) / start;
    let rate = lost * start / dem.time();
    dem.run(2 * steps)?;
    let rest = dem.spheres()[0].spin[0] / start;
    Ok(Row::new(
        "a squeezed sphere's spin slid away by friction [1/s²]",
        Expected::Near { value: start / time, within: 0.01 },
        if rest.abs() < 0.01 { rate } else { f64::NAN },
    )
    .with(format!("2 μ P r/I; a spin of {rest:.1e} of the first is left after twice the time")))
}

/// A sphere pressed on a held one of four times its diameter, and pushed along it without spin: it slides,
/// then rolls at 5/7 of its speed, however strong the friction.
fn rolling() -> Result<Row, Box<dyn Error>> {
    let big = 4.0 * DIAMETER;
    let size = 4.0 * big;
    let centre = 0.5 * size;
    let (start, friction) = (0.05, 0.2);
    let distance = 0.5 * (big + DIAMETER);
    let held = Sphere { density: f64::INFINITY, diameter: big, ..sphere([centre; 3], [0.0; 3]) };
    let moving = sphere([centre, centre, centre + distance], [start, 0.0, 0.0]);
    let mut dem = Dem::new(setup(size, law(0.5, friction)), &[held, moving])?;
    // Pressed by forty times what flies off.
    let press = 40.0 * start * start / distance;
    let speed = |dem: &Dem| {
        let place = dem.ids().iter().position(|&id| id == 1).unwrap_or_default();
        (place, dem.velocities()[place].vector().iter().map(|v| v * v).sum::<f64>().sqrt())
    };
    // Sliding ends when the speed has lost 2/7 at μ (P/m).
    let time = 2.0 / 7.0 * start / (friction * press);
    let steps = (3.0 * time / dem.time_step()) as u64;
    for _ in 0..steps {
        let (place, _) = speed(&dem);
        let at = dem.positions()[place].vector();
        let pull: [f64; 3] = std::array::from_fn(|axis| (centre - at[axis]) / distance * press);
        dem.drives_mut()[place] = Quad([pull[0], pull[1], pull[2], 0.0]);
        dem.run(1)?;
    }
    Ok(Row::new(
        "speed of a sphere that slid until it rolls, over that at the start",
        Expected::Near { value: 5.0 / 7.0, within: 0.01 },
        speed(&dem).1 / start,
    )
    .with("angular momentum about the point of contact: 5/7"))
}

/// What many spheres that collide keep: energy where nothing takes it, the budget of it where something
/// does, momentum.
fn budgets(effort: Effort) -> Result<Vec<Row>, Box<dyn Error>> {
    let number = if effort == Effort::Full { 20_000 } else { 2000 };
    let mut rows = Vec::new();
    for fraction in [0.3, 0.55] {
        let mut dem = gas(number, fraction, law(1.0, 0.0), 0.05, 3)?;
        let before = dem.energy().kept();
        dem.run(5000)?;
        rows.push(
            Row::new(
                format!("energy of elastic spheres at φ = {fraction}: change over 5000 steps"),
                Expected::AtMost(1e-3),
                (dem.energy().kept() / before - 1.0).abs(),
            )
            .with("0: nothing takes it"),
        );
    }
    let mut dem = gas(number, 0.4, law(0.8, 0.3), 0.05, 4)?;
    let before = dem.energy();
    let scale = number as f64 * mass() * 0.05;
    dem.run(5000)?;
    let after = dem.energy();
    let budget = (after.kept() + after.lost) / before.kept() - 1.0;
    rows.push(
        Row::new(
            "energy kept and lost of rough inelastic spheres, over that at the start: error",
            Expected::AtMost(0.01),
            budget.abs(),
        )
        .with(format!("0; {:.0} % are lost", 100.0 * after.lost / before.kept())),
    );
    let momentum = dem.momentum().iter().fold(0.0f64, |most, p| most.max(p.abs()));
    rows.push(
        Row::new(
            "momentum after 5000 steps, over Σ m v",
            Expected::AtMost(1e-12),
            momentum / scale,
        )
        .with("0: forces of a pair are opposite to the last bit"),
    );
    Ok(rows)
}

/// Equal spheres at random, of root mean square velocity `speed` along each axis.
fn gas(
    number: usize,
    fraction: f64,
    contact: Contact,
    speed: f64,
    seed: u64,
) -> Result<Dem, Box<dyn Error>> {
    let size = DIAMETER * (number as f64 * PI / (6.0 * fraction)).cbrt();
    let mut spheres = packed([size; 3], &vec![DIAMETER; number], DENSITY, seed, false)?;
    thermal(&mut spheres, speed * speed, seed);
    // Of restitution, 25 steps in a contact lose 2e-4.
    let setup = Setup { steps_per_contact: 25.0, ..setup(size, contact) };
    Ok(Dem::new(setup, &spheres)?)
}

/// Homogeneous cooling of smooth spheres: 1/sqrt(T) grows by ζ*/2 a time (Haff, J. Fluid Mech. 134:401,
/// 1983), with the cooling rate of van Noije & Ernst, Granular Matter 1:57, 1998:
/// dT/dt = -(8/√π) (1 - e²) φ g0 T^(3/2)/d (1 + 3/16 a2),
/// a2 = 16 (1 - e)(1 - 2 e²)/(81 - 17 e + 30 e² (1 - e)), g0 = (1 - φ/2)/(1 - φ)³.
fn cooling(effort: Effort) -> Result<Vec<Row>, Box<dyn Error>> {
    // Small boxes, several of them: in large ones vortices form, which cool more slowly.
    let (boxes, within) = if effort == Effort::Full { (24, 0.02) } else { (4, 0.03) };
    let number = 2000;
    let mut rows = Vec::new();
    for (e, fraction) in [(0.9f64, 0.05f64), (0.9, 0.1)] {
        // Slow against the stiffness: overlaps of 0.1 %, as if spheres were hard.
        let speed = 0.02;
        let g0 = (1.0 - 0.5 * fraction) / (1.0 - fraction).powi(3);
        let a2 =
            16.0 * (1.0 - e) * (1.0 - 2.0 * e * e) / (81.0 - 17.0 * e + 30.0 * e * e * (1.0 - e));
        let rate =
            8.0 / PI.sqrt() * (1.0 - e * e) * fraction * g0 / DIAMETER * (1.0 + 3.0 / 16.0 * a2);
        // The first collisions make the velocities those of a cooling gas; then until T is a half.
        let until = |dem: &mut Dem, temperature: f64| -> Result<[f64; 2], Box<dyn Error>> {
            while dem.temperature() > temperature {
                dem.run(100)?;
            }
            Ok([dem.time(), dem.temperature().sqrt().recip()])
        };
        let mut mean = 0.0;
        for seed in 0..boxes {
            let mut dem = gas(number, fraction, law(e, 0.0), speed, seed)?;
            let [t0, s0] = until(&mut dem, 0.9 * speed * speed)?;
            let [t1, s1] = until(&mut dem, 0.5 * speed * speed)?;
            mean += 2.0 * (s1 - s0) / (t1 - t0) / boxes as f64;
        }
        rows.push(
            Row::new(
                format!("rate of homogeneous cooling, e = {e}, φ = {fraction} [1/m]"),
                Expected::Near { value: rate, within },
                mean,
            )
            .with(format!("Haff's law, van Noije & Ernst 1998; {boxes} boxes of {number} spheres")),
        );
    }
    Ok(rows)
}
