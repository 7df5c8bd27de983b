//! What the filter sees of a simulation: its fields at cell centres, in double precision, a row at a
//! time.

use super::{Medium, TwoFluid};
use crate::fine::{FineFields, symmetric_components, symmetric_index};
use crate::real::Real;
use crate::rows::simd;

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// Leaves the resolved fields of this instant in `fine`, at cell centres.
    ///
    /// # Panics
    /// When `fine` is of another grid.
    pub fn fields(&self, fine: &mut FineFields<D>) {
        assert_eq!(fine.grid, self.grid, "fields of another grid");
        fine.time = self.time;
        let (h, n, layout) = (self.grid.spacing, self.grid.cells[0], self.rows.layout());
        let Medium { theory, contact, drag, .. } = &self.seen;
        let mut rates = vec![vec![0.0; n]; symmetric_components(D)];
        let [mut divergence, mut slip_squared, mut beta_per_fraction, mut viscosity, mut bulk] =
            std::array::from_fn(|_| vec![0.0; n]);
        for number in 0..layout.rows() {
            let (row, cells) = (layout.row(number), number * n..(number + 1) * n);
            let phi = &mut fine.solids_fraction[cells.clone()];
            let theta = &mut fine.granular_temperature[cells.clone()];
            widen_row(phi, self.phi.row(row));
            widen_row(theta, self.theta.row(row));
            divergence.fill(0.0);
            slip_squared.fill(0.0);
            for a in 0..D {
                let solids = &mut fine.solids_velocity[a][cells.clone()];
                let gas = &mut fine.gas_velocity[a][cells.clone()];
                let (us, ug) = (&self.solids[a], &self.gas[a]);
                let next = row.near(a, 1);
                centre_row(solids, us.row(row), us.row(next));
                centre_row(gas, ug.row(row), ug.row(next));
                slip_row(&mut slip_squared, solids, gas);
                let rate = &mut rates[symmetric_index(a, a)];
                difference_row(rate, us.row(next), us.row(row), h[a]);
                divergence_row(&mut divergence, rate);
                let push = &mut fine.pressure_gradient[a][cells.clone()];
                let pressure = &self.pressure;
                difference_row(push, pressure.row(next), pressure.row(row.near(a, -1)), 2.0 * h[a]);
                for b in 0..a {
                    // ∂u_a/∂b and ∂u_b/∂a, of velocities at centres.
                    let across = |u: usize, by: usize| {
                        let (above, below) = (row.near(by, 1), row.near(by, -1));
                        let u_at = |at: crate::field::Row<D>| self.solids[u].row(at);
                        [u_at(above), u_at(above.near(u, 1)), u_at(below), u_at(below.near(u, 1))]
                    };
                    let rate = &mut rates[symmetric_index(a, b)];
                    shear_row(rate, [across(b, a), across(a, b)], [2.0 * h[a], 2.0 * h[b]]);
                }
            }
            for a in 0..D {
                deviator_row(&mut rates[symmetric_index(a, a)], &divergence);
            }

            drag.fill(&mut beta_per_fraction, phi, &slip_squared);
            let beta = &beta_per_fraction[..];
            let pressure = &mut fine.solids_pressure[cells.clone()];
            let outputs = [&mut *pressure, &mut viscosity, &mut bulk];
            contact.seen(outputs, *theory, phi, theta, beta);
            dilate_row(pressure, &bulk, &divergence);
            let coefficient = &mut fine.drag_coefficient[cells.clone()];
            product_row(coefficient, phi, beta);
            for a in 0..D {
                let velocities = [&fine.solids_velocity[a], &fine.gas_velocity[a]];
                let [solids, gas] = velocities.map(|u| &u[cells.clone()]);
                drag_row(&mut fine.drag[a][cells.clone()], coefficient, solids, gas);
            }
            if contact.rubs() {
                for i in 0..n {
                    let square: f64 = (0..D)
                        .flat_map(|a| (0..D).map(move |b| symmetric_index(a, b)))
                        .map(|pair| rates[pair][i].powi(2))
                        .sum();
                    // In two dimensions S has a third diagonal element.
                    let third = if D == 2 { divergence[i] / 3.0 } else { 0.0 };
                    let invariant = 0.5 * (square + third * third);
                    viscosity[i] += contact.frictional_viscosity(phi[i], theta[i], invariant);
                }
            }
            for (stress, rate) in fine.solids_stress.iter_mut().zip(&rates) {
                stress_row(&mut stress[cells.clone()], &viscosity, rate);
            }
        }
    }
}

simd! {
    fn widen_row[R: Real](out: &mut [f64], values: &[R]) {
        for (out, value) in out.iter_mut().zip(values) {
            *out = value.f64();
        }
    }
}

simd! {
    /// The mean of both faces.
    fn centre_row[R: Real](out: &mut [f64], lower: &[R], upper: &[R]) {
        for (out, (lower, upper)) in out.iter_mut().zip(lower.iter().zip(upper)) {
            *out = 0.5 * (lower.f64() + upper.f64());
        }
    }
}

simd! {
    fn difference_row[R: Real](out: &mut [f64], above: &[R], below: &[R], distance: f64) {
        for (out, (above, below)) in out.iter_mut().zip(above.iter().zip(below)) {
            *out = (above.f64() - below.f64()) / distance;
        }
    }
}

simd! {
    /// Adds (u_g - u_s)² of one direction.
    fn slip_row[](squared: &mut [f64], solids: &[f64], gas: &[f64]) {
        for (squared, (solids, gas)) in squared.iter_mut().zip(solids.iter().zip(gas)) {
            *squared += (gas - solids) * (gas - solids);
        }
    }
}

simd! {
    /// f = β (u_g - u_s) of one direction.
    fn drag_row[](drag: &mut [f64], beta: &[f64], solids: &[f64], gas: &[f64]) {
        let n = drag.len();
        let (beta, solids, gas) = (&beta[..n], &solids[..n], &gas[..n]);
        for i in 0..n {
            drag[i] = beta[i] * (gas[i] - solids[i]);
        }
    }
}

simd! {
    fn divergence_row[](divergence: &mut [f64], rate: &[f64]) {
        for (divergence, rate) in divergence.iter_mut().zip(rate) {
            *divergence += rate;
        }
    }
}

simd! {
    /// ½ (∂u_a/∂b + ∂u_b/∂a) of velocities at centres, from their faces above and below.
    fn shear_row[R: Real](out: &mut [f64], faces: [[&[R]; 4]; 2], distance: [f64; 2]) {
        let n = out.len();
        let [a, b] = faces.map(|faces| faces.map(|face| &face[..n]));
        for i in 0..n {
            let across = |[above, above_next, below, below_next]: [&[R]; 4], distance: f64| {
                let above = 0.5 * (above[i].f64() + above_next[i].f64());
                (above - 0.5 * (below[i].f64() + below_next[i].f64())) / distance
            };
            out[i] = 0.5 * (across(a, distance[0]) + across(b, distance[1]));
        }
    }
}

simd! {
    /// The deviator is that of three directions.
    fn deviator_row[](rate: &mut [f64], divergence: &[f64]) {
        for (rate, divergence) in rate.iter_mut().zip(divergence) {
            *rate -= divergence / 3.0;
        }
    }
}

simd! {
    fn dilate_row[](pressure: &mut [f64], bulk_viscosity: &[f64], divergence: &[f64]) {
        for (pressure, (bulk, rate)) in pressure.iter_mut().zip(bulk_viscosity.iter().zip(divergence)) {
            *pressure -= bulk * rate;
        }
    }
}

simd! {
    fn product_row[](out: &mut [f64], a: &[f64], b: &[f64]) {
        for (out, (a, b)) in out.iter_mut().zip(a.iter().zip(b)) {
            *out = a * b;
        }
    }
}

simd! {
    /// -2 μ S.
    fn stress_row[](out: &mut [f64], viscosity: &[f64], rate: &[f64]) {
        for (out, (viscosity, rate)) in out.iter_mut().zip(viscosity.iter().zip(rate)) {
            *out = -2.0 * viscosity * rate;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::FrictionChoice;
    use crate::field::{Field, Row};
    use crate::grid::Grid;
    use crate::laws::drag::DragLaw;
    use crate::laws::scales::tests::{GAS, POWDER};

    /// A disturbed box, its fields cell by cell from their definitions.
    fn check<const D: usize>(cells: [usize; D], friction: FrictionChoice) {
        let grid = Grid::new(cells.map(|n| 0.002 * n as f64), cells);
        let mut setup = crate::two_fluid::tests::setup(0.3, 0.5);
        setup.friction = friction;
        let mut flow = TwoFluid::<f64, D>::new(grid, setup);
        for _ in 0..3 {
            flow.step(f64::INFINITY).unwrap();
        }
        let mut fine = FineFields::zeros(grid);
        flow.fields(&mut fine);
        let law = setup.drag.law(&GAS, &POWDER);
        let Medium { theory, contact, .. } = &flow.seen;
        let h = grid.spacing;
        let centre = |u: &Field<f64, D>, a: usize, row: Row<D>, i: usize| {
            0.5 * (u.row(row)[i] + u.row(row.near(a, 1))[i])
        };
        let layout = flow.rows.layout();
        let mut cell = 0;
        for row in (0..layout.rows()).map(|row| layout.row(row)) {
            for i in 0..cells[0] {
                let (phi, theta) = (flow.phi.row(row)[i], flow.theta.row(row)[i]);
                let strain = |a: usize| {
                    (flow.solids[a].row(row.near(a, 1))[i] - flow.solids[a].row(row)[i]) / h[a]
                };
                let slip = (0..D).map(|a| {
                    let us = centre(&flow.solids[a], a, row, i);
                    let ug = centre(&flow.gas[a], a, row, i);
                    assert_eq!(
                        (fine.solids_velocity[a][cell], fine.gas_velocity[a][cell]),
                        (us, ug)
                    );
                    (ug - us).powi(2)
                });
                let beta = law.beta_per_fraction(phi, slip.sum::<f64>().sqrt());
                let divergence: f64 = (0..D).map(strain).sum();
                let g0 = contact.radial_distribution(phi);
                let transport = theory.transport(phi, g0, theta, beta);
                let near = |found: f64, expected: f64, size: f64| {
                    let error = (found - expected).abs();
                    assert!(error <= 1e-13 * expected.abs().max(size), "{found} {expected}");
                };
                near(fine.drag_coefficient[cell], phi * beta, 0.0);
                let pressure = theory.pressure(phi, g0, theta) + contact.frictional_pressure(phi);
                let expected = pressure - transport.bulk_viscosity * divergence;
                near(fine.solids_pressure[cell], expected, pressure);
                let across = |u: usize, by: usize| {
                    let field = &flow.solids[u];
                    let above = centre(field, u, row.near(by, 1), i);
                    (above - centre(field, u, row.near(by, -1), i)) / (2.0 * h[by])
                };
                let deviator = |a: usize, b: usize| {
                    if a == b {
                        strain(a) - divergence / 3.0
                    } else {
                        0.5 * (across(a, b) + across(b, a))
                    }
                };
                let mut square = if D == 2 { (divergence / 3.0).powi(2) } else { 0.0 };
                for (a, b) in (0..D).flat_map(|a| (0..D).map(move |b| (a, b))) {
                    square += deviator(a, b).powi(2);
                }
                let rubbed = match contact.rubs() {
                    true => contact.frictional_viscosity(phi, theta, 0.5 * square),
                    false => 0.0,
                };
                let viscosity = transport.viscosity + rubbed;
                for b in 0..D {
                    for a in 0..=b {
                        let found = fine.solids_stress[symmetric_index(a, b)][cell];
                        near(found, -2.0 * viscosity * deviator(a, b), viscosity * square.sqrt());
                    }
                    let slope = flow.pressure.row(row.near(b, 1))[i]
                        - flow.pressure.row(row.near(b, -1))[i];
                    assert_eq!(fine.pressure_gradient[b][cell], slope / (2.0 * h[b]));
                }
                assert_eq!(
                    (fine.solids_fraction[cell], fine.granular_temperature[cell]),
                    (phi, theta)
                );
                cell += 1;
            }
        }
    }

    #[test]
    fn fields_are_what_they_are_defined_to_be() {
        check([16, 12], FrictionChoice::Barrier);
        check([8, 6, 10], FrictionChoice::Barrier);
        check([16, 12], FrictionChoice::Schaeffer);
        check([8, 6, 10], FrictionChoice::Schaeffer);
    }
}
