//! What the filter sees of particles in a gas: fields at cell centres.

use super::{CfdDem, index};
use crate::fine::{Counts, FineFields, symmetric_index};

/// Pairs of axes in the order of [`symmetric_index`].
const PAIRS: [[usize; 2]; 6] = [[0, 0], [0, 1], [1, 1], [0, 2], [1, 2], [2, 2]];

impl CfdDem {
    /// Leaves the resolved fields of this instant in `fine`, at cell centres.
    ///
    /// φ, φ u_s, β and drag are the particles' volumes, volumes times velocities, volumes times λ ρ_s, and
    /// these times their slips, shared among cells as in a step; where there are no particles, u_s is the gas's
    /// velocity. Θ and the kinetic part of the stress are those of the velocities about u_s of their cell,
    /// by mass; the stress of contacts, Σ F ⊗ r/V of the last contact step, is shared from where
    /// particles touch. A contact counts at either particle's place.
    ///
    /// # Panics
    /// When `fine` is of another grid.
    pub fn fields(&self, fine: &mut FineFields<3>) {
        assert_eq!(fine.grid, self.grid, "fields of another grid");
        fine.time = self.time;
        let cells = self.grid.len();
        let density = self.setup.powder.density;
        let inverse_volume = 1.0 / self.grid.cell_volume();
        let share = self.volume * inverse_volume;
        let mut mapping = self.mapping.clone();

        let [nx, ny, nz] = self.grid.cells;
        let at = index(self.grid.cells);
        for (cell, pull) in self.pulls.iter().enumerate() {
            let [i, j, k] = [cell % nx, cell / nx % ny, cell / (nx * ny)];
            let above = [[(i + 1) % nx, j, k], [i, (j + 1) % ny, k], [i, j, (k + 1) % nz]];
            for axis in 0..3 {
                let upper = self.pulls[at(above[axis])][axis];
                fine.gas_velocity[axis][cell] = 0.5 * (pull[axis] + upper);
                fine.pressure_gradient[axis][cell] = pull[3 + axis];
            }
        }

        let mut moved = vec![[0.0; 8]; cells];
        let mut counted = vec![[0.0; 2]; cells];
        let mut squares = vec![[0.0; 6]; cells];
        let mut seen = vec![[0.0; 1]; cells];
        let inside = self.phi[0].interior().flatten();
        seen.iter_mut().zip(inside).for_each(|(seen, phi)| *seen = [*phi]);
        fine.solids_fraction.iter_mut().zip(&seen).for_each(|(phi, [seen])| *phi = *seen);
        mapping.smooth(&mut seen);
        let particles = self.dem.positions().iter().zip(self.dem.velocities());
        for (position, velocity) in particles {
            let (faces, shares) = mapping.face_shares(*position);
            let [ux, uy, uz] = faces.see(&self.pulls);
            let [phi] = shares.see(&seen);
            let [x, y, z] = velocity.vector();
            let speed = ((ux - x).powi(2) + (uy - y).powi(2) + (uz - z).powi(2)).sqrt();
            let ratio = self.ratio(position);
            let share = share * ratio.powi(3);
            let beta = share * self.drag_on.of_sphere(phi, speed, ratio);
            let drag = [ux - x, uy - y, uz - z].map(|slip| beta * slip);
            let [fx, fy, fz] = drag;
            shares.give(&mut moved, [share, share * x, share * y, share * z, beta, fx, fy, fz]);
            shares.give(&mut counted, [inverse_volume, 0.0]);
            let square = PAIRS.map(|[a, b]| share * velocity.0[a] * velocity.0[b]);
            shares.give(&mut squares, square);
        }
        mapping.smooth(&mut moved);
        mapping.smooth(&mut squares);

        let mut contacts = vec![[0.0; 6]; cells];
        for touch in &self.touches {
            let stress = PAIRS.map(|[a, b]| {
                0.5 * inverse_volume
                    * (touch.force[a] * touch.arm[b] + touch.force[b] * touch.arm[a])
            });
            mapping.shares(touch.place).give(&mut contacts, stress);
            for centre in touch.centres() {
                mapping.shares(centre).give(&mut counted, [0.0, inverse_volume]);
            }
        }
        mapping.smooth(&mut contacts);
        mapping.smooth(&mut counted);
        let counts = fine.counts.get_or_insert_with(|| Counts::zeros(cells));
        for (cell, [number, contacts]) in counted.into_iter().enumerate() {
            (counts.number_density[cell], counts.contact_density[cell]) = (number, contacts);
        }

        for cell in 0..cells {
            let [phi, x, y, z, beta, drag @ ..] = moved[cell];
            let filled = phi > 1e-9;
            let u: [f64; 3] = if filled {
                [x / phi, y / phi, z / phi]
            } else {
                std::array::from_fn(|axis| fine.gas_velocity[axis][cell])
            };
            for axis in 0..3 {
                fine.solids_velocity[axis][cell] = u[axis];
            }
            fine.drag_coefficient[cell] = beta;
            for axis in 0..3 {
                fine.drag[axis][cell] = drag[axis];
            }
            let kinetic: [f64; 6] = std::array::from_fn(|n| {
                let [a, b] = PAIRS[n];
                if filled { density * (squares[cell][n] - phi * u[a] * u[b]) } else { 0.0 }
            });
            let third =
                |of: &[f64; 6]| (0..3).map(|a| of[symmetric_index(a, a)]).sum::<f64>() / 3.0;
            let energy = third(&kinetic).max(0.0);
            fine.granular_temperature[cell] = if filled { energy / (density * phi) } else { 0.0 };
            let whole: [f64; 6] = std::array::from_fn(|n| kinetic[n] + contacts[cell][n]);
            let pressure = third(&whole);
            fine.solids_pressure[cell] = pressure;
            for (n, [a, b]) in PAIRS.into_iter().enumerate() {
                fine.solids_stress[n][cell] = whole[n] - if a == b { pressure } else { 0.0 };
            }
        }
    }
}
