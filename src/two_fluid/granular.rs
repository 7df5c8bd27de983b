//! Closures of the solids' stress at cell centres, and the balance of granular energy.

use super::stress::{Stress, pairs};
use super::{GHOST, Medium};
use crate::field::{Faces, Field};
use crate::laws::drag::DragLaw;
use crate::laws::friction::Friction;
use crate::laws::kinetic_theory::{KineticTheory, RadialDistribution, balance_temperature};
use crate::real::Real;
use crate::rows::{Rows, by_axis, simd, sum_axes};

/// A drag law, a row at a time: the choice of law costs one call per row.
pub(super) trait DragRow<R>: Send + Sync {
    /// Turns the slip speed squared into β/φ, in place.
    fn fill(&self, drag_per_fraction: &mut [R], phi: &[R], slip_squared: &[R]);
}

impl<R: Real, L: DragLaw<R> + Copy> DragRow<R> for L {
    fn fill(&self, drag_per_fraction: &mut [R], phi: &[R], slip_squared: &[R]) {
        drag_row(drag_per_fraction, phi, slip_squared, *self);
    }
}

simd! {
    fn drag_row[R: Real, L: DragLaw<R>](out: &mut [R], phi: &[R], slip_squared: &[R], law: L) {
        let n = out.len();
        let (phi, slip_squared) = (&phi[..n], &slip_squared[..n]);
        for i in 0..n {
            out[i] = law.beta_per_fraction(phi[i], slip_squared[i].sqrt());
        }
    }
}

/// What the nearness of particles does, a row at a time: a radial distribution and a friction,
/// chosen at the cost of one call per row.
pub(super) trait ContactRow<R>: Send + Sync {
    /// Leaves g0, viscosity, bulk viscosity and conductivity, as [`Closures`] has them.
    fn kinetic(
        &self,
        outputs: [&mut [R]; 4],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        cap: R,
    );

    /// Leaves the solids pressure; returns the largest squared speed of sound \[m²/s²\].
    #[allow(clippy::too_many_arguments)]
    fn pressure(
        &self,
        pressure: &mut [R],
        theory: KineticTheory<R>,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    ) -> R;

    /// g0 of one cell.
    fn radial_distribution(&self, phi: R) -> R;

    /// Frictional pressure of one cell \[Pa\].
    fn frictional_pressure(&self, phi: R) -> R;
}

/// A radial distribution and a friction.
pub(super) struct Contact<G, F> {
    pub(super) radial: G,
    pub(super) friction: F,
}

impl<R: Real, G: RadialDistribution<R>, F: Friction<R>> ContactRow<R> for Contact<G, F> {
    fn kinetic(
        &self,
        [g0, viscosity, bulk, conductivity]: [&mut [R]; 4],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        cap: R,
    ) {
        let radial = self.radial;
        kinetic_row(g0, viscosity, bulk, conductivity, medium, radial, phi, theta, drag, cap);
    }

    fn pressure(
        &self,
        pressure: &mut [R],
        theory: KineticTheory<R>,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    ) -> R {
        pressure_row(pressure, theory, self.radial, self.friction, phi, g0, theta, drag, dt)
    }

    fn radial_distribution(&self, phi: R) -> R {
        self.radial.contact(phi)
    }

    fn frictional_pressure(&self, phi: R) -> R {
        self.friction.pressure(phi).0
    }
}

simd! {
    fn pressure_row[R: Real, G: RadialDistribution<R>, F: Friction<R>](
        pressure: &mut [R],
        theory: KineticTheory<R>,
        radial: G,
        friction: F,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    ) -> R {
        let n = pressure.len();
        let (phi, g0, theta, drag) = (&phi[..n], &g0[..n], &theta[..n], &drag[..n]);
        let mut fastest = [R::ZERO; 16];
        let mut i = 0;
        while i < n {
            let lanes = (n - i).min(16);
            for lane in 0..lanes {
                let at = i + lane;
                let (contacts, stiffness) = friction.pressure(phi[at]);
                pressure[at] = theory.pressure(phi[at], g0[at], theta[at]) + contacts;
                let slope = radial.slope(phi[at], g0[at]);
                // Dissipation is implicit, so of the heat of compression a step keeps only this.
                let relaxation = theory.collisional_dissipation(phi[at], g0[at])
                    * theta[at].sqrt()
                    + R::of(2.0 / 3.0) * theory.viscous_dissipation(drag[at]);
                let adiabatic = R::ONE / (R::ONE + dt * relaxation);
                let c2 =
                    theory.sound_speed_squared(phi[at], g0[at], slope, theta[at], adiabatic)
                        + stiffness;
                fastest[lane] = fastest[lane].max(c2);
            }
            i += lanes;
        }
        fastest.into_iter().fold(R::ZERO, R::max)
    }
}

/// What the solids fraction, temperature and slip of a cell make of it.
#[derive(Clone, Debug)]
pub(super) struct Closures<R, const D: usize> {
    /// |u_g - u_s|² at cell centres \[m²/s²\].
    pub(super) slip_squared: Field<R, D>,
    /// K = β/φ \[kg/m³/s\].
    pub(super) drag_per_fraction: Field<R, D>,
    /// g0 \[-\].
    pub(super) radial_distribution: Field<R, D>,
    /// μ_s \[Pa·s\].
    pub(super) viscosity: Field<R, D>,
    /// η μ_b \[Pa·s\].
    pub(super) bulk_viscosity: Field<R, D>,
    /// λ \[kg/m/s\].
    pub(super) conductivity: Field<R, D>,
}

impl<R: Real, const D: usize> Closures<R, D> {
    pub(super) fn zeros(layout: crate::field::Layout<D>) -> Self {
        let zeros = || Field::zeros(layout);
        Self {
            slip_squared: zeros(),
            drag_per_fraction: zeros(),
            radial_distribution: zeros(),
            viscosity: zeros(),
            bulk_viscosity: zeros(),
            conductivity: zeros(),
        }
    }

    /// Everything from φ, T and the velocities. `cap` bounds the diffusivities of the nearly empty
    /// cells whose particles would fly farther than a cell in a step \[m²/s\].
    pub(super) fn set(
        &mut self,
        rows: &Rows<D>,
        medium: &Medium<R>,
        phi: &Field<R, D>,
        theta: &Field<R, D>,
        [solids, gas]: [&Faces<R, D>; 2],
        cap: R,
    ) {
        rows.each(
            [
                &mut self.slip_squared,
                &mut self.drag_per_fraction,
                &mut self.radial_distribution,
                &mut self.viscosity,
                &mut self.bulk_viscosity,
                &mut self.conductivity,
            ],
            |o, [slip, drag, g0, viscosity, bulk, conductivity]| {
                let velocities: [[&[R]; 4]; D] = std::array::from_fn(|a| {
                    let s = rows.stride(a);
                    [solids[a].row(o), solids[a].row(o + s), gas[a].row(o), gas[a].row(o + s)]
                });
                slip_row(slip, velocities);
                medium.drag.fill(drag, phi.row(o), slip);
                let outputs = [g0, viscosity, bulk, conductivity];
                medium.contact.kinetic(outputs, medium, phi.row(o), theta.row(o), drag, cap);
            },
        );
    }
}

simd! {
    /// |u_g - u_s|² from the means of the faces' velocities.
    fn slip_row[R: Real, const D: usize](slip_squared: &mut [R], velocities: [[&[R]; 4]; D]) {
        let n = slip_squared.len();
        let velocities = by_axis(velocities, n);
        for i in 0..n {
            slip_squared[i] = sum_axes!(D, velocities, |[s0, s1, g0, g1], _| {
                let slip = R::of(0.5) * ((g0[i] + g1[i]) - (s0[i] + s1[i]));
                slip * slip
            });
        }
    }
}

simd! {
    fn kinetic_row[R: Real, G: RadialDistribution<R>](
        g0: &mut [R],
        viscosity: &mut [R],
        bulk: &mut [R],
        conductivity: &mut [R],
        medium: &Medium<R>,
        radial: G,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        cap: R,
    ) {
        let n = g0.len();
        let (viscosity, bulk, conductivity) =
            (&mut viscosity[..n], &mut bulk[..n], &mut conductivity[..n]);
        let (phi, theta, drag) = (&phi[..n], &theta[..n], &drag[..n]);
        let theory = medium.theory;
        let density = medium.solids_density;
        for i in 0..n {
            let contact = radial.contact(phi[i]);
            let transport = theory.transport(phi[i], contact, theta[i], drag[i]);
            let bound = cap * density * (phi[i] + R::of(GHOST));
            g0[i] = contact;
            viscosity[i] = transport.viscosity.min(bound);
            bulk[i] = transport.bulk_viscosity.min(R::of(0.25) * bound);
            conductivity[i] = transport.conductivity.min(bound);
        }
    }
}

/// Solves the balance of granular energy over `dt`: conduction and viscous heating explicit,
/// dissipation, compression and production by slip implicit in each cell. Leaves the temperature
/// and the solids pressure; returns the largest squared speed of sound \[m²/s²\].
#[allow(clippy::too_many_arguments)]
pub(super) fn balance<R: Real, const D: usize>(
    rows: &Rows<D>,
    [theta_new, pressure]: [&mut Field<R, D>; 2],
    medium: &Medium<R>,
    phi: &Field<R, D>,
    theta: &Field<R, D>,
    closures: &Closures<R, D>,
    stress: &Stress<R, D>,
    [before, after]: [&Faces<R, D>; 2],
    inverse_spacing: [R; D],
    dt: R,
) -> R {
    rows.reduce(
        [theta_new, pressure],
        &|o, [theta_new, pressure]| {
            // Conduction and viscous heating, per solids mass, gather in `theta_new` first.
            theta_new.fill(R::ZERO);
            for a in 0..D {
                let s = rows.stride(a);
                let theta = [o - s, o, o + s].map(|o| theta.row(o));
                let conductivity = [o - s, o, o + s].map(|o| closures.conductivity.row(o));
                let u = [before, after].map(|u| [u[a].row(o), u[a].row(o + s)]);
                let normal = stress.normal[a].row(o);
                heating_row(theta_new, theta, conductivity, normal, u, inverse_spacing[a]);
            }
            per_mass_row(theta_new, phi.row(o), medium.solids_density);
            for (at, (a, b)) in pairs::<D>() {
                let edges = stress.edges(rows, at, a, b, o);
                shear_row(theta_new, edges, R::ONE / medium.solids_density);
            }
            let u = std::array::from_fn(|a| [after[a].row(o), after[a].row(o + rows.stride(a))]);
            let g0 = closures.radial_distribution.row(o);
            balance_row(
                theta_new,
                medium,
                phi.row(o),
                theta.row(o),
                g0,
                closures.drag_per_fraction.row(o),
                closures.slip_squared.row(o),
                u,
                inverse_spacing,
                dt,
            );
            medium.contact.pressure(
                pressure,
                medium.theory,
                phi.row(o),
                g0,
                theta_new,
                closures.drag_per_fraction.row(o),
                dt,
            )
        },
        &R::max,
    )
}

simd! {
    /// Adds ∂(λ ∂T) + τ_aa ∂(u + u')/2 along one axis \[W/m³\].
    fn heating_row[R: Real](
        heating: &mut [R],
        theta: [&[R]; 3],
        conductivity: [&[R]; 3],
        normal: &[R],
        u: [[&[R]; 2]; 2],
        inverse_spacing: R,
    ) {
        let n = heating.len();
        let (theta, conductivity) = (theta.map(|t| &t[..n]), conductivity.map(|k| &k[..n]));
        let (normal, u) = (&normal[..n], u.map(|u| u.map(|u| &u[..n])));
        let tiny = R::of(1e-30);
        let two = R::of(2.0);
        for i in 0..n {
            // Harmonic means: a nearly empty cell does not conduct into a dense one.
            let [k0, k1, k2] = conductivity.map(|k| k[i]);
            let lower = two * k0 * k1 / (k0 + k1 + tiny) * (theta[1][i] - theta[0][i]);
            let upper = two * k1 * k2 / (k1 + k2 + tiny) * (theta[2][i] - theta[1][i]);
            let strain = (u[0][1][i] - u[0][0][i]) + (u[1][1][i] - u[1][0][i]);
            heating[i] += inverse_spacing * inverse_spacing * (upper - lower)
                + R::of(0.5) * inverse_spacing * normal[i] * strain;
        }
    }
}

simd! {
    fn per_mass_row[R: Real](heating: &mut [R], phi: &[R], density: R) {
        let phi = &phi[..heating.len()];
        for (heating, phi) in heating.iter_mut().zip(phi) {
            *heating /= density * (*phi + R::of(GHOST));
        }
    }
}

simd! {
    /// Adds the heating of the four edges of one pair of axes; each cell's part is its share of
    /// the solids around the edge, so that per mass no division is left.
    fn shear_row[R: Real](heating: &mut [R], edges: [&[R]; 4], inverse_density: R) {
        let n = heating.len();
        let edges = edges.map(|e| &e[..n]);
        for i in 0..n {
            heating[i] += inverse_density * (edges[0][i] + edges[1][i] + edges[2][i] + edges[3][i]);
        }
    }
}

simd! {
    fn balance_row[R: Real, const D: usize](
        theta_new: &mut [R],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        g0: &[R],
        drag: &[R],
        slip_squared: &[R],
        u: [[&[R]; 2]; D],
        inverse_spacing: [R; D],
        dt: R,
    ) {
        let n = theta_new.len();
        let (phi, theta) = (&phi[..n], &theta[..n]);
        let (g0, drag, slip_squared) = (&g0[..n], &drag[..n], &slip_squared[..n]);
        let u = by_axis(u, n);
        let theory = medium.theory;
        for i in 0..n {
            let divergence = sum_axes!(D, u, |[lower, upper], a| {
                inverse_spacing[a] * (upper[i] - lower[i])
            });
            // -P_s ∇·u: a sink where the solids expand, implicit; a source where they contract.
            let work = theory.compressibility(phi[i], g0[i]) * divergence;
            let heating = theta_new[i] + theta[i] * (-work).max(R::ZERO);
            let damping = theory.viscous_dissipation(drag[i]) + work.max(R::ZERO);
            theta_new[i] = balance_temperature(
                theta[i],
                heating,
                theory.collisional_dissipation(phi[i], g0[i]),
                damping,
                theory.slip_production(g0[i], slip_squared[i]),
                dt,
            );
        }
    }
}
