//! Manufactured solutions of the whole coupled system: chosen fields, and the sources that make
//! them solve the equations.
//!
//! Everything travels with one velocity c: q(x, t) = Q(x - c t), so that ∂/∂t is -c·∇. With
//! φ u_s = φ c + F and (1-φ) u_g = -φ c + G, F and G free of divergence, both balances of mass and
//! the volume constraint hold exactly; momentum and granular energy get sources, made of the
//! equations as [`two_fluid`](crate::two_fluid) states them by automatic differentiation. All terms
//! are there: drag, kinetic-theory stress, solids pressure, conduction, and every source and sink
//! of granular energy.

use super::dual::{Dual, Smooth};
use super::{Checked, Effort, Expected, Row};
use crate::case::{DragChoice, FrictionChoice, RadialDistributionChoice, Terms};
use crate::case::{with_drag, with_radial_distribution};
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::laws::kinetic_theory::{KineticTheory, RadialDistribution};
use crate::laws::scales::{Gas, Powder};
use crate::real::Real;
use crate::two_fluid::{Quantity, Setup, StepError, TwoFluid};
use std::f64::consts::TAU;

/// Powder, gas and box in which all terms are of like size: over a wave, advection, drag,
/// pressure and dissipation act within a factor of ten of each other, viscosity and conduction a
/// little less.
fn setup() -> Setup {
    Setup {
        powder: Powder { diameter: 5e-4, density: 1500.0, restitution: 0.98, max_packing: 0.65 },
        gas: Gas { density: 100.0, viscosity: 1e-3 },
        gravity: 9.81,
        drag: DragChoice::WenYu,
        radial_distribution: RadialDistributionChoice::Princeton,
        friction: FrictionChoice::Barrier,
        terms: Terms::default(),
        solids_fraction: 0.25,
        perturbation: 0.0,
        seed: 0,
        parallel: false,
    }
}

/// A solution in a box of `D` dimensions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Solution<const D: usize> {
    setup: Setup,
    /// Edges of the box \[m\].
    size: [f64; D],
    /// Whether steps are of second order in time.
    second_order: bool,
    /// Boxes travelled per time, along every axis \[1/s\].
    travel: f64,
}

/// The fields at a point.
#[derive(Clone, Copy, Debug)]
struct Fields<S, const D: usize> {
    phi: S,
    theta: S,
    pressure: S,
    solids: [S; D],
    gas: [S; D],
}

/// The rates that must be added in a cell.
#[derive(Clone, Copy, Debug)]
struct Rates<const D: usize> {
    /// Of u_s and u_g along each axis \[m/s²\].
    velocities: [[f64; 2]; D],
    /// Of T \[m²/s³\].
    temperature: f64,
}

impl<const D: usize> Solution<D> {
    fn new(travel: f64) -> Self {
        let size = std::array::from_fn(|a| 0.02 * [1.0, 1.2, 0.9][a]);
        Self { setup: setup(), size, second_order: false, travel }
    }

    /// At t = 0. The fraction and the temperature vary by a third, the velocities by 0.1 m/s about
    /// a mean slip.
    fn fields<S: Smooth>(&self, x: [S; D]) -> Fields<S, D> {
        let k = self.size.map(|length| TAU / length);
        let angle: [S; D] = std::array::from_fn(|a| S::of(k[a]) * x[a]);
        let wave = |phase: f64, amplitude: f64| {
            // A product over the axes, so that every derivative of it is there.
            (0..D).fold(S::of(amplitude), |product, a| {
                product * (angle[a] + S::of(phase * (a as f64 + 1.0))).sin()
            })
        };
        let phi = S::of(self.setup.solids_fraction)
            + wave(0.3, 0.06)
            + S::of(0.02) * (angle[D - 1] + S::of(0.9)).sin();
        let theta = S::of(0.02) + wave(1.1, 0.004) + S::of(0.002) * (angle[0] + S::of(0.4)).cos();
        let pressure = wave(0.7, 20.0) + S::of(10.0) * (angle[0] - S::of(0.2)).sin();
        // Divergence-free: a component varies across itself, and stream functions
        // sin(angle_a) sin(angle_b) of each pair of axes.
        let flux = |mean: [f64; 2], size: f64, phase: f64| -> [S; D] {
            std::array::from_fn(|a| {
                let across = (a + 1) % D;
                let mean = if a + 1 == D { mean[1] } else { mean[0] };
                let mut flux = S::of(mean) + S::of(size) * (angle[across] + S::of(phase)).sin();
                for b in (0..D).filter(|&b| b != a) {
                    let turn = if a < b { 1.0 } else { -1.0 };
                    let scale = S::of(turn * size * k[b] / k[0]);
                    flux += scale
                        * (angle[a] + S::of(phase * (a + 1) as f64)).sin()
                        * (angle[b] + S::of(phase * (b + 1) as f64)).cos();
                }
                flux
            })
        };
        let solids_flux = flux([0.03, -0.02], 0.02, 0.5);
        let gas_flux = flux([0.05, 0.35], 0.06, 0.8);
        let c = self.speed();
        Fields {
            phi,
            theta,
            pressure,
            solids: std::array::from_fn(|a| S::of(c[a]) + solids_flux[a] / phi),
            gas: std::array::from_fn(|a| (gas_flux[a] - S::of(c[a]) * phi) / (S::ONE - phi)),
        }
    }

    /// c \[m/s\].
    fn speed(&self) -> [f64; D] {
        self.size.map(|length| self.travel * length)
    }

    /// What the balances lack at `x` and t = 0.
    fn rates(&self, x: [f64; D]) -> Rates<D> {
        let Setup { powder, gas, gravity, solids_fraction, .. } = self.setup;
        let c = self.speed();
        let at = self.fields(Dual::<Dual<f64, D>, D>::point(x));
        // First derivatives of every field, as fields with derivatives of their own.
        let (phi, theta, pressure) = (at.phi.value, at.theta.value, at.pressure.value);
        let us: [Dual<f64, D>; D] = at.solids.map(|u| u.value);
        let ug: [Dual<f64, D>; D] = at.gas.map(|u| u.value);
        let strain = |a: usize, b: usize| at.solids[a].gradient[b];

        let slip_squared = (0..D).map(|a| (ug[a] - us[a]) * (ug[a] - us[a])).sum::<Dual<f64, D>>();
        let drag = with_drag!(self.setup.drag, Dual<f64, D>, &gas, &powder, |law| {
            law.beta_per_fraction(phi, slip_squared.sqrt())
        });
        let choice = self.setup.radial_distribution;
        let g0 = with_radial_distribution!(choice, Dual<f64, D>, &powder, |radial| {
            radial.contact(phi)
        });
        let theory = KineticTheory::<Dual<f64, D>>::new(&gas, &powder);
        let transport = theory.transport(phi, g0, theta, drag);
        let solids_pressure = theory.pressure(phi, g0, theta);
        let divergence = (0..D).map(|a| strain(a, a)).sum::<Dual<f64, D>>();
        // τ = μ (∇u + ∇uᵀ) + (μ_b - 2/3 μ) ∇·u I.
        let stress = |a: usize, b: usize| {
            let shear = transport.viscosity * (strain(a, b) + strain(b, a));
            let dilation = transport.bulk_viscosity - Dual::of(2.0 / 3.0) * transport.viscosity;
            if a == b { shear + dilation * divergence } else { shear }
        };

        let mixture = powder.density * solids_fraction + gas.density * (1.0 - solids_fraction);
        let beta = phi.value * drag.value;
        let [solids_inertia, gas_inertia] =
            [powder.density * phi.value, gas.density * (1.0 - phi.value)];
        // D/Dt of a field that travels with c.
        let advected = |gradient: [f64; D], velocity: [Dual<f64, D>; D]| -> f64 {
            (0..D).map(|b| (velocity[b].value - c[b]) * gradient[b]).sum()
        };
        let velocities = std::array::from_fn(|a| {
            let g = if a + 1 == D { gravity } else { 0.0 };
            let exchange = beta * (ug[a].value - us[a].value);
            let push = pressure.gradient[a];
            let viscous = (0..D).map(|b| stress(a, b).gradient[b]).sum::<f64>();
            let solids = viscous - solids_pressure.gradient[a]
                + phi.value * (g * (mixture - powder.density) - push)
                + exchange;
            let carrier = (1.0 - phi.value) * (g * (mixture - gas.density) - push) - exchange;
            [
                advected(us[a].gradient, us) - solids / solids_inertia,
                advected(ug[a].gradient, ug) - carrier / gas_inertia,
            ]
        });

        let conduction: f64 =
            (0..D).map(|a| (transport.conductivity * at.theta.gradient[a]).gradient[a]).sum();
        let heating: f64 = (0..D)
            .flat_map(|a| (0..D).map(move |b| (a, b)))
            .map(|(a, b)| stress(a, b).value * strain(a, b).value)
            .sum();
        let work = solids_pressure.value * divergence.value;
        let (t, g0) = (theta.value, g0.value);
        let law = KineticTheory::<f64>::new(&gas, &powder);
        let local = law.slip_production(g0, slip_squared.value) / t.sqrt()
            - law.collisional_dissipation(phi.value, g0) * t * t.sqrt()
            - law.viscous_dissipation(drag.value) * t;
        let temperature = advected(theta.gradient, us)
            - 2.0 / 3.0 * ((conduction + heating - work) / solids_inertia + local);
        Rates { velocities, temperature }
    }

    /// The exact value of a quantity at `x` after `travelled` boxes.
    fn exact(&self, quantity: Quantity, x: [f64; D], travelled: f64) -> f64 {
        let at = self.fields(std::array::from_fn(|a| x[a] - travelled * self.size[a]));
        match quantity {
            Quantity::SolidsFraction => at.phi,
            Quantity::Temperature => at.theta,
            Quantity::Pressure => at.pressure,
            Quantity::SolidsVelocity(a) => at.solids[a],
            Quantity::GasVelocity(a) => at.gas[a],
        }
    }

    /// A flow that starts from the solution.
    fn start(&self, cells: usize) -> TwoFluid<f64, D> {
        let grid = Grid::new(self.size, [cells; D]);
        let mut flow = TwoFluid::<f64, D>::new(grid, self.setup);
        // What the iteration leaves is an error of the pressure that grows as steps are halved.
        flow = match self.second_order {
            true => flow.with_second_order().with_tolerance(1e-12),
            false => flow.with_tolerance(1e-9),
        };
        for quantity in quantities::<D>() {
            flow.set_field(quantity, |index| {
                self.exact(quantity, quantity.position(grid.spacing, index), 0.0)
            });
        }
        flow
    }

    /// The sources on a grid, `parts` of a cell's travel through from the start.
    fn sources(&self, grid: &Grid<D>, parts: f64) -> Vec<Rates<D>> {
        let shift: [f64; D] = std::array::from_fn(|a| parts * grid.spacing[a]);
        let mut index = [0; D];
        (0..grid.len())
            .map(|_| {
                let at = |quantity: Quantity| -> Rates<D> {
                    let x = quantity.position(grid.spacing, index);
                    self.rates(std::array::from_fn(|a| x[a] - shift[a]))
                };
                let rates = Rates {
                    velocities: std::array::from_fn(|a| {
                        at(Quantity::SolidsVelocity(a)).velocities[a]
                    }),
                    temperature: at(Quantity::SolidsFraction).temperature,
                };
                for a in 0..D {
                    index[a] += 1;
                    if index[a] < grid.cells[a] {
                        break;
                    }
                    index[a] = 0;
                }
                rates
            })
            .collect()
    }

    /// The flow after travelling `travelled` boxes in steps of 1/`parts` of a cell's travel, the
    /// sources taken at the middle of a step.
    fn flow(
        &self,
        cells: usize,
        parts: usize,
        travelled: f64,
    ) -> Result<TwoFluid<f64, D>, StepError> {
        let mut flow = self.start(cells);
        self.go_on(&mut flow, parts, travelled, |_| true)?;
        Ok(flow)
    }

    /// Takes the steps of [`Solution::flow`] as long as `wanted`; says whether to the end.
    fn go_on(
        &self,
        flow: &mut TwoFluid<f64, D>,
        parts: usize,
        travelled: f64,
        wanted: impl Fn(&TwoFluid<f64, D>) -> bool,
    ) -> Result<bool, StepError> {
        let grid = flow.grid();
        let cells = grid.cells[0];
        // A cell's travel later everything is one cell further: one period of sources will do. Of each
        // step those of its middle, and for second order of the middles of its halves.
        let middles: &[f64] = if self.second_order { &[0.5, 0.25, 0.75] } else { &[0.5] };
        let sources: Vec<Vec<_>> = (0..parts)
            .map(|n| {
                let at = |middle| self.sources(&grid, (n as f64 + middle) / parts as f64);
                middles.iter().copied().map(at).collect()
            })
            .collect();
        let dt = self.step(cells, parts);
        let steps = (travelled * (cells * parts) as f64).round() as usize;
        for step in 0..steps {
            let shift = step / parts % cells;
            let number = |index: [usize; D]| {
                let place = |a: usize| (index[a] + cells - shift) % cells;
                (0..D).rev().fold(0, |sum, a| sum * cells + place(a))
            };
            for (n, rates) in sources[step % parts].iter().enumerate() {
                let velocities = |axis: usize, index| rates[number(index)].velocities[axis];
                let temperature = |index| rates[number(index)].temperature;
                match n {
                    0 => flow.set_sources(velocities, temperature),
                    _ => flow.set_half_sources(n - 1, velocities, temperature),
                }
            }
            flow.step_by(dt)?;
            if !wanted(flow) {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// 1/`parts` of a cell's travel \[s\].
    fn step(&self, cells: usize, parts: usize) -> f64 {
        1.0 / (self.travel * (cells * parts) as f64)
    }

    /// Fewest steps in a cell's travel, `least` at least, that the simulator would take.
    fn own_parts(&self, cells: usize, least: usize) -> usize {
        let taken = |&parts: &usize| {
            let dt = self.step(cells, parts);
            let mut flow = self.start(cells);
            // A step that is much too long may also fail.
            self.go_on(&mut flow, parts, TRAVELLED, |flow| dt <= flow.next_step().0)
                .unwrap_or(false)
        };
        (least..MOST_PARTS).find(taken).unwrap_or(MOST_PARTS)
    }

    /// Errors of every quantity of [`Solution::flow`].
    fn errors(&self, cells: usize, parts: usize, travelled: f64) -> Result<Vec<Error>, StepError> {
        let flow = self.flow(cells, parts, travelled)?;
        let error = |quantity| Error::of(&flow, quantity, |x| self.exact(quantity, x, travelled));
        Ok(quantities::<D>().map(error).collect())
    }
}

/// Boxes that the solutions travel per time \[1/s\]: at 0.4 m/s, twice the slip.
const TRAVEL: f64 = 20.0;

/// Boxes travelled when errors are taken.
const TRAVELLED: f64 = 0.25;

/// Most steps in a cell's travel that are tried for the simulator's own.
const MOST_PARTS: usize = 64;

/// Order in space, in time, and of both together at the simulator's own step.
pub(super) fn check(effort: Effort) -> Checked {
    let mut rows = Vec::new();
    let last = match effort {
        Effort::Quick => 1,
        Effort::Full => 2,
    };
    // The step falls with the square of the spacing, which makes the orders of both errors two.
    let fine = |n: usize| 16 << n;
    let errors = refine(|n| Solution::<2>::new(TRAVEL).errors(16 << n, fine(n), TRAVELLED), last)?;
    rows.extend(orders("2-D, in space", &errors, 1.9));
    let errors = refine(|n| Solution::<3>::new(TRAVEL).errors(12 << n, fine(n), TRAVELLED), 1)?;
    rows.extend(orders("3-D, in space", &errors, 1.9));
    rows.extend(in_time(fine(0), false)?);
    rows.extend(in_time(fine(0), true)?);
    if effort == Effort::Full {
        let solution = Solution::<2>::new(TRAVEL);
        let mut parts = vec![1];
        for n in 0..=last {
            parts.push(solution.own_parts(16 << n, parts[n]));
        }
        let errors = refine(|n| solution.errors(16 << n, parts[n + 1], TRAVELLED), last)?;
        let counts: Vec<String> = parts[1..].iter().map(ToString::to_string).collect();
        let name = format!("2-D, own steps ({} a cell)", counts.join(", "));
        rows.extend(orders(&name, &errors, 1.9));
        // Where viscosity limits the own steps they fall faster than the spacing, and hide the
        // error in time; a step that falls as the spacing does not.
        let parts = parts[last + 1];
        let errors = refine(|n| solution.errors(16 << n, parts, TRAVELLED), last)?;
        let name = format!("2-D, step as spacing ({parts} a cell)");
        rows.extend(orders(&name, &errors, 1.0).into_iter().map(|row| {
            let errors = row.detail.clone();
            row.with(format!(
                "first order in time, second in space: the error in time dominates; {errors}"
            ))
        }));
    }
    Ok(rows)
}

/// Errors at refinements 0 to `last`.
fn refine(
    errors: impl Fn(usize) -> Result<Vec<Error>, StepError>,
    last: usize,
) -> Result<Vec<Vec<Error>>, StepError> {
    (0..=last).map(errors).collect()
}

/// Order in time on one grid, from the distances of solutions whose steps are halved.
fn in_time(parts: usize, second_order: bool) -> Result<Vec<Row>, StepError> {
    let solution = Solution::<2> { second_order, ..Solution::new(TRAVEL) };
    let flows = (0..4)
        .map(|n| solution.flow(16, parts << n, TRAVELLED))
        .collect::<Result<Vec<_>, StepError>>()?;
    let h = flows[0].grid().spacing;
    let errors: Vec<Vec<Error>> = flows
        .windows(2)
        .map(|pair| {
            let distance = |quantity| {
                let finer: Vec<&[f64]> = pair[1].field(quantity).interior().collect();
                Error::of(&pair[0], quantity, |x| {
                    // A face lies at the start of its cell, up to rounding.
                    let [i, j] = [0, 1].map(|a| (x[a] / h[a] + 0.25).floor() as usize);
                    finer[j][i]
                })
            };
            quantities::<2>().map(distance).collect()
        })
        .collect();
    if second_order {
        return Ok(orders("2-D, in time, run.time_order 2", &errors, 1.9));
    }
    let rows = orders("2-D, in time", &errors, 0.9).into_iter().map(|row| {
        let errors = row.detail.clone();
        row.with(format!("the coupling of the phases is first order in time; {errors}"))
    });
    Ok(rows.collect())
}

/// A row for each of φ, T, p, u_s and u_g: the order between the last two of `errors`, each twice
/// as fine as the one before.
fn orders(name: &str, errors: &[Vec<Error>], least: f64) -> Vec<Row> {
    type Member = fn(Quantity) -> bool;
    let groups: [(&str, Member); 5] = [
        ("φ", |q| q == Quantity::SolidsFraction),
        ("T", |q| q == Quantity::Temperature),
        ("p", |q| q == Quantity::Pressure),
        ("u_s", |q| matches!(q, Quantity::SolidsVelocity(_))),
        ("u_g", |q| matches!(q, Quantity::GasVelocity(_))),
    ];
    groups
        .into_iter()
        .map(|(symbol, member)| {
            let group = |errors: &[Error]| -> (f64, f64) {
                let mut found = (0.0, 0.0f64);
                let mut count = 0.0;
                for error in errors.iter().filter(|error| member(error.quantity)) {
                    found.0 += error.square.powi(2);
                    found.1 = found.1.max(error.largest);
                    count += 1.0;
                }
                ((found.0 / count).sqrt(), found.1)
            };
            let all: Vec<(f64, f64)> = errors.iter().map(|errors| group(errors)).collect();
            let [.., coarse, fine] = all[..] else { unreachable!("errors of two grids") };
            let squares: Vec<String> = all.iter().map(|e| format!("{:.1e}", e.0)).collect();
            let largest = (coarse.1 / fine.1).log2();
            Row::new(
                format!("order of {symbol}, {name}"),
                Expected::AtLeast(least),
                (coarse.0 / fine.0).log2(),
            )
            .with(format!("L2 errors {}; in the max norm {largest:.2}", squares.join(", ")))
        })
        .collect()
}

/// All fields of the state.
pub(super) fn quantities<const D: usize>() -> impl Iterator<Item = Quantity> {
    [Quantity::SolidsFraction, Quantity::Temperature, Quantity::Pressure]
        .into_iter()
        .chain((0..D).map(Quantity::SolidsVelocity))
        .chain((0..D).map(Quantity::GasVelocity))
}

/// How far a field is from the exact one, over the latter's standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Error {
    pub(super) quantity: Quantity,
    /// Root of the mean square.
    pub(super) square: f64,
    /// Largest.
    pub(super) largest: f64,
}

impl Error {
    pub(super) fn of<const D: usize>(
        flow: &TwoFluid<f64, D>,
        quantity: Quantity,
        exact: impl Fn([f64; D]) -> f64,
    ) -> Self {
        let grid = flow.grid();
        let mut pairs = Vec::with_capacity(grid.len());
        let mut index = [0; D];
        for value in flow.field(quantity).interior().flatten() {
            pairs.push((*value, exact(quantity.position(grid.spacing, index))));
            for a in 0..D {
                index[a] += 1;
                if index[a] < grid.cells[a] {
                    break;
                }
                index[a] = 0;
            }
        }
        // Only the pressure's gradient has a meaning.
        let n = pairs.len() as f64;
        let mean = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
        let centre = mean(&|p| p.1);
        let offset = match quantity {
            Quantity::Pressure => mean(&|p| p.0 - p.1),
            _ => 0.0,
        };
        let scale = mean(&|p| (p.1 - centre).powi(2)).sqrt();
        let error = |p: &(f64, f64)| (p.0 - p.1 - offset).abs() / scale;
        Self {
            quantity,
            square: mean(&|p| error(p).powi(2)).sqrt(),
            largest: pairs.iter().map(error).fold(0.0, f64::max),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keeps_both_masses<const D: usize>() {
        let solution = Solution::<D>::new(3.0);
        let c = solution.speed();
        for point in 0..20 {
            let x = std::array::from_fn(|a| 0.00137 * (point * (a + 2)) as f64);
            let at = solution.fields(Dual::<Dual<f64, D>, D>::point(x));
            for (share, velocity) in [(at.phi, at.solids), (Dual::ONE - at.phi, at.gas)] {
                let change: f64 = (0..D)
                    .map(|a| {
                        (share * velocity[a]).value.gradient[a] - c[a] * share.value.gradient[a]
                    })
                    .sum();
                let size = (share * velocity[0]).value.gradient[1].abs() + 1.0;
                assert!(change.abs() < 1e-12 * size, "{change} of {size}");
            }
        }
    }

    #[test]
    fn manufactured_fields_keep_both_masses() {
        keeps_both_masses::<2>();
        keeps_both_masses::<3>();
    }
}
