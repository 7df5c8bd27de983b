//! Particles to start from: how many of which diameters, and where.

use super::Setup;
use crate::case::{Diameters, ParticlesStart, Places};
use crate::dem::{Sphere, StartError, lattice, normals, packed};
use crate::grid::Grid;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::f64::consts::PI;

/// Particles that cannot be placed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SpheresError {
    /// There is none.
    #[error(
        "a solids fraction of {fraction} is {number:.2} particles of {diameter:.3e} m in this box: one at \
         least is needed"
    )]
    None {
        /// Solids fraction asked for.
        fraction: f64,
        /// Particles that this would be.
        number: f64,
        /// Their diameter \[m\].
        diameter: f64,
    },
    /// They cannot be placed.
    #[error("the particles cannot be placed")]
    Start(#[from] StartError),
    /// Places that are given elsewhere.
    #[error("the particles of a file are read, not placed")]
    File,
}

/// Standard deviations beyond which no diameter of a log-normal distribution is drawn.
const TAILS: f64 = 3.0;

/// The particles at rest that `start` and the solids fraction of `setup` ask for in the box of `grid`.
///
/// # Errors
/// There would be none; they cannot be placed.
pub fn spheres(
    grid: &Grid<3>,
    setup: &Setup,
    start: &ParticlesStart,
) -> Result<Vec<Sphere>, SpheresError> {
    let size = grid.size();
    let (reference, density) = (setup.powder.diameter, setup.powder.density);
    let solids = setup.solids_fraction * size.iter().product::<f64>();
    let number_of = |d: f64, volume: f64| volume * 6.0 / (PI * d.powi(3));
    // Of its own stream: places are drawn from the seed itself.
    let mut random = Pcg64Mcg::seed_from_u64(setup.seed ^ (1 << 63));
    let mut diameters = match &start.diameters {
        Diameters::Equal => vec![reference; number_of(reference, solids).round() as usize],
        Diameters::Shares(classes) => {
            let count = |(d, share): &(f64, f64)| number_of(*d, share * solids).round() as usize;
            classes.iter().flat_map(|class| vec![class.0; count(class)]).collect()
        }
        Diameters::LogNormal(deviation) => {
            log_normal(reference, *deviation, number_of(reference, solids), &mut random)
        }
    };
    if diameters.is_empty() {
        let (fraction, diameter) = (setup.solids_fraction, reference);
        let number = number_of(diameter, solids);
        return Err(SpheresError::None { fraction, number, diameter });
    }
    match &start.places {
        Places::Random => Ok(packed(size, &diameters, density, setup.seed, setup.parallel)?),
        Places::Lattice => {
            let number = lattice_of(size, diameters.len());
            let largest = diameters.iter().copied().fold(0.0, f64::max);
            let mut spheres = lattice(size, number, largest, density)?;
            // Any diameter at any place; the nearest whole number of places is not quite theirs.
            for last in (1..diameters.len()).rev() {
                diameters.swap(last, random.random_range(0..=last));
            }
            for (sphere, diameter) in spheres.iter_mut().zip(diameters.iter().cycle()) {
                sphere.diameter = *diameter;
            }
            Ok(spheres)
        }
        Places::File(_) => Err(SpheresError::File),
    }
}

/// Places along each axis of the nearly cubic lattice whose number is nearest to `count`.
fn lattice_of(size: [f64; 3], count: usize) -> [usize; 3] {
    let spacing = (size.iter().product::<f64>() / count as f64).cbrt();
    let along = |length: f64| (length / spacing).round().max(1.0);
    let [x, y] = [along(size[0]), along(size[1])];
    let z = (count as f64 / (x * y)).round().max(1.0);
    [x, y, z].map(|number| number as usize)
}

/// Diameters drawn from a log-normal distribution of this geometric standard deviation, scaled such that
/// their Sauter mean is `sauter`, as many as have the volume of `number` spheres of that diameter.
///
/// The deviation is the same by number and by volume; no diameter is drawn beyond [`TAILS`].
fn log_normal(sauter: f64, deviation: f64, number: f64, random: &mut Pcg64Mcg) -> Vec<f64> {
    let sigma = deviation.ln();
    let mut normal = normals(random);
    let mut diameters = Vec::new();
    let [mut squares, mut cubes] = [0.0f64; 2];
    // Their volume once scaled, in spheres of the Sauter mean: (Σ d²)³/(Σ d³)².
    let mut volume = 0.0;
    loop {
        let z = normal();
        if z.abs() > TAILS {
            continue;
        }
        let d = (sigma * z).exp();
        let [more_squares, more_cubes] = [squares + d * d, cubes + d * d * d];
        let more = more_squares.powi(3) / more_cubes.powi(2);
        // The last one only if it comes closer.
        if 0.5 * (volume + more) > number {
            break;
        }
        (squares, cubes, volume) = (more_squares, more_cubes, more);
        diameters.push(d);
    }
    let scale = sauter * squares / cubes;
    diameters.iter().map(|d| scale * d).collect()
}

/// The Sauter mean diameter Σ d³/Σ d² \[m\].
pub fn sauter_mean(diameters: impl Iterator<Item = f64>) -> f64 {
    let [squares, cubes] =
        diameters.fold([0.0; 2], |[squares, cubes], d| [squares + d * d, cubes + d * d * d]);
    cubes / squares
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cfd_dem::tests::{grid, setup};

    fn placed(fraction: f64, places: Places, diameters: Diameters) -> Vec<Sphere> {
        let start = ParticlesStart { places, diameters };
        spheres(&grid([8, 8, 16]), &setup(fraction), &start).unwrap()
    }

    fn fraction(spheres: &[Sphere]) -> f64 {
        let solids: f64 = spheres.iter().map(|s| PI / 6.0 * s.diameter.powi(3)).sum();
        solids / grid([8, 8, 16]).size().iter().product::<f64>()
    }

    #[test]
    fn shares_are_of_the_volume() {
        let classes = vec![(60e-6, 0.3), (100e-6, 0.7)];
        for places in [Places::Random, Places::Lattice] {
            let spheres = placed(0.1, places.clone(), Diameters::Shares(classes.clone()));
            assert!((fraction(&spheres) / 0.1 - 1.0).abs() < 0.04, "{places:?}");
            let volume = |d: f64| -> f64 {
                spheres.iter().filter(|s| s.diameter == d).map(|s| s.diameter.powi(3)).sum()
            };
            let small = volume(60e-6) / (volume(60e-6) + volume(100e-6));
            assert!((small - 0.3).abs() < 0.01, "{small}");
            // Not sorted by place.
            let half = spheres.len() / 2;
            let low = spheres.iter().filter(|s| s.position[2] < 2e-3 && s.diameter == 60e-6);
            let low =
                low.count() as f64 / spheres.iter().filter(|s| s.diameter == 60e-6).count() as f64;
            assert!((low - 0.5).abs() < 0.1 && half > 100, "{low}");
        }
    }

    #[test]
    fn a_log_normal_powder_has_the_moments_of_its_distribution() {
        for deviation in [1.05f64, 1.3] {
            let spheres = placed(0.3, Places::Random, Diameters::LogNormal(deviation));
            let d = |s: &Sphere| s.diameter;
            assert!((sauter_mean(spheres.iter().map(d)) / 75e-6 - 1.0).abs() < 1e-12);
            assert!((fraction(&spheres) / 0.3 - 1.0).abs() < 1e-3);
            let number = spheres.len() as f64;
            let mean = spheres.iter().map(|s| s.diameter.ln()).sum::<f64>() / number;
            let square =
                spheres.iter().map(|s| (s.diameter.ln() - mean).powi(2)).sum::<f64>() / number;
            // Cut at three standard deviations the variance is 0.9733 of the whole; its error is √(2/N).
            let sigma = deviation.ln();
            let expected = 0.9733 * sigma * sigma;
            assert!((square / expected - 1.0).abs() < 4.0 * (2.0 / number).sqrt(), "{number}");
            // d_32 = d_n exp(5/2 σ²), by the moments of a log-normal distribution.
            let found = 75e-6 / mean.exp();
            assert!((found.ln() / (2.5 * sigma * sigma) - 1.0).abs() < 0.12, "{found}");
        }
    }

    #[test]
    fn a_lattice_fills_the_box_as_asked_for_and_is_regular() {
        let spheres = placed(0.1, Places::Lattice, Diameters::Equal);
        assert!((fraction(&spheres) / 0.1 - 1.0).abs() < 0.02, "{}", fraction(&spheres));
        let start = ParticlesStart { places: Places::Lattice, diameters: Diameters::Equal };
        let full = spheres_error(0.6, &start);
        assert!(full.contains("does not fit"), "{full}");
        let none = spheres_error(1e-7, &ParticlesStart::default());
        assert!(none.contains("one at least"), "{none}");
    }

    /// What is wrong, and why.
    fn spheres_error(fraction: f64, start: &ParticlesStart) -> String {
        let error = super::spheres(&grid([8, 8, 16]), &setup(fraction), start).unwrap_err();
        let why = std::error::Error::source(&error).map(ToString::to_string).unwrap_or_default();
        format!("{error}: {why}")
    }
}
