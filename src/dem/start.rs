//! Spheres to start from.

use super::{Dem, Quad, SKIN, Setup, SetupError, Sphere, StepError};
use crate::laws::contact::Contact;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::PI;

/// Spheres that cannot be placed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// Too many for the box.
    #[error("spheres fill {fraction:.3} of the box: at most {most} can be placed {how}")]
    Fraction {
        /// Solids fraction asked for \[-\].
        fraction: f64,
        /// Most \[-\].
        most: f64,
        /// How.
        how: &'static str,
    },
    /// Spheres of a lattice overlap.
    #[error(
        "a lattice of {number:?} spheres of {diameter:.3e} m does not fit: they are {spacing:.3e} m \
         apart along axis {axis}"
    )]
    Lattice {
        /// Spheres along each axis.
        number: [usize; 3],
        /// Their diameter \[m\].
        diameter: f64,
        /// The axis.
        axis: usize,
        /// Distance of neighbours along it \[m\].
        spacing: f64,
    },
    /// Overlaps did not vanish.
    #[error(
        "after {steps} steps spheres still overlap by {overlap:.1e} diameters: fewer are needed"
    )]
    Overlap {
        /// Steps.
        steps: u64,
        /// Deepest overlap over the mean diameter \[-\].
        overlap: f64,
    },
    /// The box or the spheres cannot be simulated.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// A step on the way failed.
    #[error("while spheres pushed each other apart")]
    Step(#[from] StepError),
}

/// Equal spheres at rest on a simple cubic lattice, `number` along each axis of a box of `size`, half a
/// spacing off its sides.
///
/// # Errors
/// They would overlap.
pub fn lattice(
    size: [f64; 3],
    number: [usize; 3],
    diameter: f64,
    density: f64,
) -> Result<Vec<Sphere>, StartError> {
    let spacing: [f64; 3] = std::array::from_fn(|axis| size[axis] / number[axis] as f64);
    for (axis, &spacing) in spacing.iter().enumerate() {
        if spacing < diameter {
            return Err(StartError::Lattice { number, diameter, axis, spacing });
        }
    }
    let at = |axis: usize, n: usize| (n as f64 + 0.5) * spacing[axis];
    let mut spheres = Vec::with_capacity(number.iter().product());
    for z in 0..number[2] {
        for y in 0..number[1] {
            for x in 0..number[0] {
                let position = [at(0, x), at(1, y), at(2, z)];
                spheres.push(at_rest(position, diameter, density));
            }
        }
    }
    Ok(spheres)
}

fn at_rest(position: [f64; 3], diameter: f64, density: f64) -> Sphere {
    Sphere { position, velocity: [0.0; 3], spin: [0.0; 3], diameter, density }
}

/// Most that [`packed`] fills of a box: beyond, random packings jam (0.64 for equal spheres) \[-\].
const DENSEST: f64 = 0.61;

/// By how much [`packed`] makes spheres larger while they push each other apart \[-\].
const MARGIN: f64 = 1e-3;

/// Drag on spheres that push each other apart, over the frequency of the shortest contact \[-\].
const DRAG: f64 = 0.1;

/// Steps between two looks at the overlaps, and most steps.
const LOOK: u64 = 20;
const MOST_STEPS: u64 = 200_000;

/// Spheres of these `diameters` at rest at random places of a box of `size`, none overlapping: thrown in
/// anywhere, then left to push each other apart, without friction and in a viscous fluid.
///
/// # Errors
/// They fill more than 0.61 of the box, or do not come apart; a box too small for them.
pub fn packed(
    size: [f64; 3],
    diameters: &[f64],
    density: f64,
    seed: u64,
    parallel: bool,
) -> Result<Vec<Sphere>, StartError> {
    let solids: f64 = diameters.iter().map(|d| PI / 6.0 * d.powi(3)).sum();
    let fraction = solids / size.iter().product::<f64>();
    if fraction.is_nan() || fraction > DENSEST {
        return Err(StartError::Fraction { fraction, most: DENSEST, how: "at random" });
    }
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut spheres: Vec<Sphere> = diameters
        .iter()
        .map(|&d| at_rest(size.map(|size| size * random.random::<f64>()), d, density))
        .collect();
    for sphere in &mut spheres {
        sphere.diameter *= 1.0 + MARGIN;
    }
    let contact = Contact {
        stiffness: 1.0,
        restitution: 0.5,
        tangential_stiffness: 0.0,
        tangential_damping: 0.0,
        friction: 0.0,
        cohesion: 0.0,
    };
    let setup = Setup { size, contact, steps_per_contact: 20.0, skin: SKIN, parallel };
    let mut dem = Dem::new(setup, &spheres)?;
    // They begin within each other.
    (dem.deepest, dem.fastest) = (f64::INFINITY, f64::INFINITY);
    let rate = DRAG * PI / (setup.steps_per_contact * dem.time_step());
    dem.drives_mut().fill(Quad([0.0, 0.0, 0.0, rate]));
    loop {
        let overlap = dem.deepest_overlap();
        if overlap < 0.5 * MARGIN {
            break;
        }
        if dem.steps() >= MOST_STEPS {
            return Err(StartError::Overlap { steps: dem.steps(), overlap });
        }
        dem.run(LOOK)?;
    }
    let places = dem.spheres();
    for ((sphere, place), &diameter) in spheres.iter_mut().zip(places).zip(diameters) {
        *sphere = at_rest(place.position, diameter, density);
    }
    Ok(spheres)
}

/// Normally distributed numbers, by Box and Muller's transform.
pub(crate) fn normals(random: &mut Pcg64Mcg) -> impl FnMut() -> f64 {
    || {
        let (u, v): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (2.0 * PI * v).cos()
    }
}

/// Gives the spheres normally distributed velocities of zero mean by mass and of exactly the granular
/// `temperature` T = ⟨m v²⟩/(3 ⟨m⟩) \[m²/s²\].
pub fn thermal(spheres: &mut [Sphere], temperature: f64, seed: u64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut normal = normals(&mut random);
    for sphere in spheres.iter_mut() {
        sphere.velocity = [normal(), normal(), normal()];
    }
    let mass = |sphere: &Sphere| sphere.density * sphere.diameter.powi(3);
    let total: f64 = spheres.iter().map(mass).sum();
    let mut mean = [0.0; 3];
    for sphere in spheres.iter() {
        for axis in 0..3 {
            mean[axis] += mass(sphere) * sphere.velocity[axis] / total;
        }
    }
    let mut square = 0.0;
    for sphere in spheres.iter_mut() {
        for axis in 0..3 {
            sphere.velocity[axis] -= mean[axis];
            square += mass(sphere) * sphere.velocity[axis].powi(2) / total;
        }
    }
    // One sphere has no velocity against the mean.
    let scale = if square > 0.0 { (3.0 * temperature / square).sqrt() } else { 0.0 };
    for sphere in spheres {
        sphere.velocity = sphere.velocity.map(|velocity| scale * velocity);
    }
}
