//! Particles as fields: tables of positions, velocities and diameters, deposited on a grid.
//!
//! A particle's volume V = π d³/6 is shared among cells with weights w ≥ 0 whose sum is 1, so that
//! solids volume and momentum are kept to round-off:
//!
//! φ = Σ w V / V_cell, u_s = Σ w V u / Σ w V, Θ = (Σ w V |u|² / Σ w V - |u_s|²) / D.
//!
//! The kernel `linear` shares it among the 2^D cells whose centres surround it, with weights
//! Π (1 - |x - x_c|/Δx); `nearest` gives it to the cell that it lies in. At a wall what would lie
//! outside goes to the cell inside; along a periodic axis a position is taken modulo the box. In two
//! dimensions the box is a slice of a given thickness. A particle should be smaller than a cell: φ may
//! exceed packing otherwise, which is refused later.

use super::{Array, Columns, Lattice, Piece, ResolvedError};
use std::f64::consts::PI;
use std::path::Path;

/// How a particle's volume is shared among cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepositKernel {
    /// Among the 2^D nearest cells, linearly.
    #[default]
    Linear,
    /// To the cell that it lies in.
    Nearest,
}

/// Particles of one instant; all lists have one entry per particle, vectors along x, y and z.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// Centres.
    pub position: Columns,
    /// Velocities.
    pub velocity: Columns,
    /// Diameters.
    pub diameter: Vec<f64>,
}

/// Reads the table of particles (.csv) at `path`, one row per particle below one row of names.
///
/// # Errors
/// It cannot be read, or a field is not a number.
pub fn read_csv(path: &Path, wanted: &dyn Fn(&str) -> bool) -> Result<Piece, ResolvedError> {
    let refuse = |error: csv::Error| ResolvedError::format(path, error.to_string());
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(path).map_err(refuse)?;
    let names: Vec<String> = reader.headers().map_err(refuse)?.iter().map(str::to_owned).collect();
    let used: Vec<usize> = (0..names.len()).filter(|n| wanted(&names[*n])).collect();
    let mut columns = vec![Vec::new(); used.len()];
    for record in reader.records() {
        let record = record.map_err(refuse)?;
        let line = record.position().map_or(0, csv::Position::line);
        for (column, n) in columns.iter_mut().zip(&used) {
            let text = &record[*n];
            column.push(text.parse().map_err(|_| {
                let why = format!("line {line}: \"{text}\" is not a number");
                ResolvedError::array(path, &names[*n], why)
            })?);
        }
    }
    let mut piece = Piece { path: path.to_owned(), particles: true, ..Piece::default() };
    for (column, n) in columns.into_iter().zip(&used) {
        let name = names[*n].clone();
        piece.arrays.push(Array { name, columns: vec![column], dimensions: None });
    }
    let unused = (0..names.len()).filter(|n| !used.contains(n));
    piece.others = unused.map(|n| (names[n].clone(), None)).collect();
    Ok(piece)
}

/// The fields of `particles` on `lattice`, all in one unit of length: solids fraction, velocity along
/// x, y and z, and granular temperature. `thickness` is that of the slice in two dimensions.
///
/// # Errors
/// A number is not finite, a diameter is not positive, or a particle lies outside along an axis that
/// is not periodic.
pub fn deposit(
    path: &Path,
    particles: &Particles,
    lattice: &Lattice,
    periodic: [bool; 3],
    thickness: Option<f64>,
    kernel: DepositKernel,
) -> Result<[Columns; 3], ResolvedError> {
    let Particles { position, velocity, diameter } = particles;
    let flat = lattice.cells.map(|cells| cells == 1);
    let dimension = flat.iter().filter(|flat| !**flat).count();
    let depth = if dimension == 3 { 1.0 } else { thickness.unwrap_or(1.0) };
    let volume: f64 =
        (0..3).filter(|a| !flat[*a]).map(|a| lattice.spacing[a]).product::<f64>() * depth;
    let len = lattice.len();
    let (mut solids, mut energy) = (vec![0.0; len], vec![0.0; len]);
    let mut momentum = vec![vec![0.0; len]; 3];
    for (n, &d) in diameter.iter().enumerate() {
        let refuse = |array: &str, why: String| {
            ResolvedError::array(path, array, format!("particle {n}, counted from 0: {why}"))
        };
        if d.is_nan() || d <= 0.0 || d.is_infinite() {
            return Err(refuse("diameter", format!("{d}: a diameter above 0 is needed")));
        }
        let u: [f64; 3] = std::array::from_fn(|axis| velocity[axis][n]);
        if let Some(bad) = u.iter().find(|u| !u.is_finite()) {
            return Err(refuse("velocity", format!("{bad}: a finite number is needed")));
        }
        // Along each axis two cells and their weights.
        let mut share = [[(0, 1.0), (0, 0.0)]; 3];
        for axis in 0..3 {
            let (count, h) = (lattice.cells[axis], lattice.spacing[axis]);
            let x = position[axis][n];
            if !x.is_finite() {
                return Err(refuse("position", format!("{x}: a finite number is needed")));
            }
            if flat[axis] {
                continue;
            }
            let mut at = (x - lattice.origin[axis]) / h;
            if periodic[axis] {
                at = at.rem_euclid(count as f64);
            } else if !(0.0..=count as f64).contains(&at) {
                return Err(refuse(
                    "position",
                    format!(
                        "{x} along {} lies outside the box, which ends at {} and {} and is not \
                         periodic",
                        super::AXES[axis],
                        lattice.origin[axis],
                        lattice.origin[axis] + count as f64 * h
                    ),
                ));
            }
            // A remainder may round up to the box's end.
            let inside = (at as usize).min(count - 1);
            share[axis] = match kernel {
                DepositKernel::Nearest => [(inside, 1.0), (inside, 0.0)],
                DepositKernel::Linear => {
                    let below = (at - 0.5).floor();
                    let weight = at - 0.5 - below;
                    let cell = |place: f64| match periodic[axis] {
                        true => place.rem_euclid(count as f64) as usize % count,
                        false => place.clamp(0.0, (count - 1) as f64) as usize,
                    };
                    [(cell(below), 1.0 - weight), (cell(below + 1.0), weight)]
                }
            };
        }
        let part = PI / 6.0 * d.powi(3);
        let square: f64 = (0..3).filter(|a| !flat[*a]).map(|a| u[a] * u[a]).sum();
        for (k, wz) in share[2] {
            for (j, wy) in share[1] {
                for (i, wx) in share[0] {
                    let amount = part * wx * wy * wz;
                    let cell = i + lattice.cells[0] * (j + lattice.cells[1] * k);
                    solids[cell] += amount;
                    energy[cell] += amount * square;
                    for axis in 0..3 {
                        momentum[axis][cell] += amount * u[axis];
                    }
                }
            }
        }
    }
    let mut temperature = vec![0.0; len];
    for cell in 0..len {
        let amount = solids[cell];
        if amount > 0.0 {
            let mut mean = 0.0;
            for axis in 0..3 {
                momentum[axis][cell] /= amount;
                if !flat[axis] {
                    mean += momentum[axis][cell].powi(2);
                }
            }
            // Round-off of the difference may leave a trace below zero.
            temperature[cell] = (energy[cell] / amount - mean).max(0.0) / dimension as f64;
        }
        solids[cell] /= volume;
    }
    Ok([vec![solids], momentum, vec![temperature]])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn particles(count: usize, axes: usize) -> Particles {
        // A low-discrepancy sequence, so that the test needs no generator.
        let at = |n: usize, k: f64| (0.5 + n as f64 * k).fract();
        let column = |k: f64, scale: f64| (0..count).map(|n| scale * at(n, k)).collect();
        let flat = vec![0.0; count];
        Particles {
            position: vec![
                column(0.754_877_666, 0.8),
                column(0.569_840_291, 0.6),
                if axes == 3 { column(0.4501, 0.4) } else { flat.clone() },
            ],
            velocity: vec![
                column(0.31, 1.0),
                column(0.71, -2.0),
                if axes == 3 { column(0.11, 0.5) } else { flat },
            ],
            diameter: (0..count).map(|n| 0.01 + 0.005 * at(n, 0.618)).collect(),
        }
    }

    #[test]
    fn volume_and_momentum_are_kept_by_every_kernel() {
        for (cells, thickness) in [([8, 6, 1], Some(0.02)), ([8, 6, 4], None)] {
            let spacing = [0.1; 3];
            let lattice = Lattice { cells, spacing, origin: [0.0; 3] };
            let particles = particles(500, if cells[2] == 1 { 2 } else { 3 });
            let volumes = particles.diameter.iter().map(|d| PI / 6.0 * d.powi(3));
            let total: f64 = volumes.clone().sum();
            for kernel in [DepositKernel::Linear, DepositKernel::Nearest] {
                for periodic in [[true; 3], [false; 3]] {
                    let [phi, u, _] =
                        deposit(Path::new("p"), &particles, &lattice, periodic, thickness, kernel)
                            .unwrap();
                    let cell = if cells[2] == 1 { 0.01 * 0.02 } else { 0.001 };
                    let kept: f64 = phi[0].iter().map(|phi| phi * cell).sum();
                    assert!((kept / total - 1.0).abs() < 1e-12);
                    for axis in 0..2 {
                        let given = volumes.clone().zip(&particles.velocity[axis]);
                        let given: f64 = given.map(|(volume, u)| volume * u).sum();
                        let kept: f64 =
                            phi[0].iter().zip(&u[axis]).map(|(p, u)| p * cell * u).sum();
                        assert!((kept / given - 1.0).abs() < 1e-12);
                    }
                }
            }
        }
    }

    #[test]
    fn weights_are_linear_in_the_distance_and_wrap_or_stay_at_a_wall() {
        let lattice = Lattice { cells: [4, 4, 1], spacing: [1.0; 3], origin: [10.0, 0.0, 0.0] };
        let one = |x: f64, periodic: bool| {
            let particles = Particles {
                position: vec![vec![x], vec![1.5], vec![0.0]],
                velocity: vec![vec![1.0]; 3],
                diameter: vec![(6.0 / PI).cbrt()],
            };
            let kernel = DepositKernel::Linear;
            let [phi, ..] =
                deposit(Path::new("p"), &particles, &lattice, [periodic; 3], Some(1.0), kernel)?;
            Ok::<_, ResolvedError>(phi[0][4..8].to_vec())
        };
        let near = |found: Vec<f64>, expected: [f64; 4]| {
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-14), "{found:?}");
        };
        near(one(11.75, false).unwrap(), [0.0, 0.75, 0.25, 0.0]);
        near(one(10.25, true).unwrap(), [0.75, 0.0, 0.0, 0.25]);
        near(one(10.25, false).unwrap(), [1.0, 0.0, 0.0, 0.0]);
        near(one(14.0, false).unwrap(), [0.0, 0.0, 0.0, 1.0]);
        near(one(14.25, true).unwrap(), [0.75, 0.0, 0.0, 0.25]);
        let error = one(14.25, false).unwrap_err().to_string();
        assert!(
            error.contains("14.25 along x lies outside the box, which ends at 10 and 14"),
            "{error}"
        );
    }

    #[test]
    fn temperature_is_the_variance_of_a_cells_velocities() {
        let lattice = Lattice { cells: [2, 2, 1], spacing: [1.0; 3], origin: [0.0; 3] };
        let particles = Particles {
            position: vec![vec![0.3, 0.4, 1.5], vec![0.5, 0.6, 1.5], vec![0.0; 3]],
            velocity: vec![vec![1.0, -1.0, 3.0], vec![5.0, 5.0, 0.0], vec![0.0; 3]],
            diameter: vec![0.1; 3],
        };
        let kernel = DepositKernel::Nearest;
        let [_, u, theta] =
            deposit(Path::new("p"), &particles, &lattice, [true; 3], Some(1.0), kernel).unwrap();
        assert!(u[0][0].abs() < 1e-15 && (u[1][0] - 5.0).abs() < 1e-14);
        assert!((theta[0][0] - 0.5).abs() < 1e-13, "{theta:?}");
        assert_eq!(theta[0][3], 0.0);
    }
}
