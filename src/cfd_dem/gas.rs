//! The gas: transport of its momentum, molecular stress, forces, projection.

use super::mapping::Mapping;
use super::{CfdDem, MOST_ITERATIONS, TOLERANCE};
use crate::field::{Faces, Field, Layout};
use crate::grid::Grid;
use crate::poisson::Fast;
use crate::rows::Rows;
use crate::stencil::upwind;
use crate::viscous::{divergence_row, normal_row, pair, pairs, shear_lines, shear_row};

/// Half the sum of two rows, number by number.
#[inline(always)]
fn mean(a: &[f64], b: &[f64], i: usize) -> f64 {
    0.5 * (a[i] + b[i])
}

/// The gas's molecular stress, 2 μ_g S with S deviatoric.
pub(super) struct Viscous {
    cells: usize,
    inverse: [f64; 3],
    /// At centres, along each axis.
    normal: Faces<f64, 3>,
    /// On edges, by the place of their pair of axes.
    shear: [Field<f64, 3>; 3],
    /// ∇·τ on faces \[Pa/m\].
    push: Faces<f64, 3>,
    /// A row of μ_g \[Pa·s\] and one of zeros.
    viscosities: [Vec<f64>; 2],
    /// ∇·τ at centres, as particles see it.
    pub(super) seen: Vec<[f64; 3]>,
}

impl Viscous {
    pub(super) fn new(grid: &Grid<3>, viscosity: f64) -> Self {
        let layout = Layout::from(grid);
        Self {
            cells: grid.cells[0],
            inverse: grid.spacing.map(|h| 1.0 / h),
            normal: Field::zero_faces(layout),
            shear: Field::zero_faces(layout),
            push: Field::zero_faces(layout),
            viscosities: [viscosity, 0.0].map(|value| vec![value; grid.cells[0]]),
            seen: vec![[0.0; 3]; grid.len()],
        }
    }

    /// Leaves ∇·τ of `gas` on faces.
    fn find(&mut self, rows: Rows<3>, gas: &Faces<f64, 3>) {
        let h = self.inverse;
        let [mu, none] = self.viscosities.each_ref().map(Vec::as_slice);
        for axis in 0..3 {
            rows.each([&mut self.normal[axis]], |row, [normal]| {
                let u = std::array::from_fn(|a| [row, row.near(a, 1)].map(|at| gas[a].row(at)));
                normal_row::<f64, 3>(normal, axis, u, mu, none, h);
            });
        }
        for (at, (a, b)) in pairs::<3>() {
            rows.each([&mut self.shear[at]], |row, [shear]| {
                shear_row(shear, shear_lines(gas, (a, b), row), [mu; 4], [h[a], h[b]]);
            });
        }
        let (normal, shear) = (&self.normal, &self.shear);
        for axis in 0..3 {
            rows.each([&mut self.push[axis]], |row, [push]| {
                let stress = std::array::from_fn(|b| {
                    if b == axis {
                        [row.near(axis, -1), row].map(|at| normal[axis].row(at))
                    } else {
                        [row, row.near(b, 1)].map(|at| shear[pair(axis, b)].row(at))
                    }
                });
                divergence_row::<f64, 3>(push, stress, h);
            });
        }
    }

    /// ∇·τ at centres, as particles see it: half of what each face of a cell has, so that all that particles
    /// and gas are pushed by is ∇·τ.
    pub(super) fn see(&mut self, layout: Layout<3>, mapping: &mut Mapping) {
        for (number, seen) in self.seen.chunks_mut(self.cells).enumerate() {
            let row = layout.row(number);
            for axis in 0..3 {
                let push = &self.push[axis];
                let (lower, upper) = (push.row(row), push.row(row.near(axis, 1)));
                for (i, seen) in seen.iter_mut().enumerate() {
                    seen[axis] = 0.5 * (lower[i] + upper[i]);
                }
            }
        }
        mapping.smooth(&mut self.seen);
    }
}

impl CfdDem {
    /// Largest Σ |u_a|/h_a of the gas in a cell \[1/s\].
    pub(super) fn gas_speed(&self) -> f64 {
        let inverse = self.grid.spacing.map(|h| 1.0 / h);
        self.rows.fold(
            &|row| {
                let faces: [[&[f64]; 2]; 3] =
                    std::array::from_fn(|a| [row, row.near(a, 1)].map(|at| self.gas[a].row(at)));
                (0..faces[0][0].len()).fold(0.0, |most: f64, i| {
                    let speed = |a: usize| faces[a][0][i].abs().max(faces[a][1][i].abs());
                    most.max((0..3).map(|a| inverse[a] * speed(a)).sum())
                })
            },
            &f64::max,
        )
    }

    /// A step of the gas of `dt` \[s\], to where the particles are; returns the pressure's iterations and what
    /// they left of the divergence \[1/s\].
    pub(super) fn advance_gas(&mut self, dt: f64) -> (usize, f64) {
        self.carry();
        let rows = self.rows;
        let density = self.setup.gas.density;
        let inverse = self.grid.spacing.map(|h| 1.0 / h);
        let weight = self.driven()[1];
        if let Some(viscous) = &mut self.viscous {
            viscous.find(rows, &self.gas);
            for axis in 0..3 {
                let (push, phi) = (&viscous.push[axis], &self.phi[0]);
                rows.each([&mut self.carried[axis]], |row, [carried]| {
                    let (lower, upper) = (phi.row(row.near(axis, -1)), phi.row(row));
                    for (i, carried) in carried.iter_mut().enumerate() {
                        let open = 1.0 - mean(lower, upper, i);
                        *carried += dt / density * open * push.row(row)[i];
                    }
                });
            }
        }

        // Under the old pressure.
        for axis in 0..3 {
            let push = if axis == 2 { weight } else { 0.0 };
            let Self { phi: [now, before, _], drag, given, carried, pressure, .. } = self;
            let (drag, given) = (&drag[axis], &given[axis]);
            let outputs = [&mut self.gas[axis], &mut self.flux[axis], &mut self.mobility[axis]];
            rows.each(outputs, |row, [u, flux, mobility]| {
                let below = row.near(axis, -1);
                let near =
                    |field: &Field<f64, 3>, i: usize| mean(field.row(below), field.row(row), i);
                for i in 0..u.len() {
                    let (drag, given) = (drag.row(row)[i], given.row(row)[i]);
                    let open = 1.0 - near(now, i);
                    let inertia = density * (1.0 - near(before, i)) / dt;
                    let slope = inverse[axis] * (pressure.row(row)[i] - pressure.row(below)[i]);
                    let force = density * carried[axis].row(row)[i] / dt + open * (push - slope);
                    mobility[i] = open / (inertia + drag);
                    u[i] = (force + given) / (inertia + drag);
                    flux[i] = open * u[i];
                }
            });
        }
        for axis in 0..3 {
            let (phi, mobility) = (&self.phi[0], &self.mobility[axis]);
            let scale = inverse[axis] * inverse[axis];
            rows.each([&mut self.poisson.weights_mut()[axis]], |row, [weights]| {
                let (lower, upper) = (phi.row(row.near(axis, -1)), phi.row(row));
                for (i, weight) in weights.iter_mut().enumerate() {
                    let open = 1.0 - mean(lower, upper, i);
                    *weight = (scale * open * mobility.row(row)[i]) as Fast;
                }
            });
        }
        self.poisson.prepare();
        let (flux, [now, before, _]) = (&self.flux, &self.phi);
        rows.each([&mut self.right], |row, [right]| {
            for (i, right) in right.iter_mut().enumerate() {
                let filling = (now.row(row)[i] - before.row(row)[i]) / dt;
                *right = filling
                    - (0..3)
                        .map(|a| {
                            let at = |row| flux[a].row(row)[i];
                            inverse[a] * (at(row.near(a, 1)) - at(row))
                        })
                        .sum::<f64>();
            }
        });
        let solve =
            self.poisson.solve(&mut self.increment, &self.right, TOLERANCE / dt, MOST_ITERATIONS);
        let increment = &self.increment;
        for axis in 0..3 {
            let mobility = &self.mobility[axis];
            rows.each([&mut self.gas[axis]], |row, [u]| {
                let (lower, upper) = (increment.row(row.near(axis, -1)), increment.row(row));
                for (i, u) in u.iter_mut().enumerate() {
                    *u -= mobility.row(row)[i] * inverse[axis] * (upper[i] - lower[i]);
                }
            });
        }
        rows.each([&mut self.pressure], |row, [p]| {
            p.iter_mut().zip(increment.row(row)).for_each(|(p, more)| *p += more);
        });
        (solve.iterations, solve.residual)
    }

    /// Leaves ε u of each face after transport: what was there with the fractions before the last step, and
    /// what the flux of that step, ε u with those after it, carried. The fractions go with the flux,
    /// so that a uniform velocity stays so.
    fn carry(&mut self) {
        let rows = self.rows;
        let courant = self.grid.spacing.map(|h| self.last_dt / h);
        let [_, now, before] = &self.phi;
        let gas = &self.gas;
        for axis in 0..3 {
            let flux = &gas[axis];
            rows.each([&mut self.flux[axis]], |row, [out]| {
                let (lower, upper) = (now.row(row.near(axis, -1)), now.row(row));
                for (i, out) in out.iter_mut().enumerate() {
                    *out = (1.0 - mean(lower, upper, i)) * flux.row(row)[i];
                }
            });
        }
        let carries = self.setup.gas_inertia && self.last_dt > 0.0;
        for axis in 0..3 {
            let u = &gas[axis];
            if carries {
                for by in 0..3 {
                    let flux = &self.flux[by];
                    rows.each([&mut self.sides[by]], |row, [side]| {
                        // Across the lower side along `by` of the cell around the face.
                        let through = [flux.row(row.near(axis, -1)), flux.row(row)];
                        let line = [-2, -1, 0, 1].map(|n| u.row(row.near(by, n)));
                        for (i, side) in side.iter_mut().enumerate() {
                            let through = mean(through[0], through[1], i);
                            let crossing = courant[by] * through.abs();
                            let [a, b, c, d] = line.map(|u| u[i]);
                            *side = courant[by] * through * upwind(through, crossing, a, b, c, d);
                        }
                    });
                }
            }
            let sides: &[Field<f64, 3>; 3] = &self.sides;
            rows.each([&mut self.carried[axis]], |row, [out]| {
                let (lower, upper) = (before.row(row.near(axis, -1)), before.row(row));
                for (i, out) in out.iter_mut().enumerate() {
                    let stays = (1.0 - mean(lower, upper, i)) * u.row(row)[i];
                    let goes: f64 = (0..3)
                        .map(|by| sides[by].row(row.near(by, 1))[i] - sides[by].row(row)[i])
                        .sum();
                    *out = if carries { stays - goes } else { stays };
                }
            });
        }
    }
}
