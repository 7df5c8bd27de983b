//! Closures of the solids' stress at cell centres, and the balance of granular energy.

use super::{GHOST, Medium};
use crate::laws::drag::DragLaw;
use crate::laws::friction::Friction;
use crate::laws::kinetic_theory::{
    KineticTheory, RadialDistribution, balance_temperature, balanced_temperature,
};
use crate::real::Real;
use crate::rows::{by_axis, cut, simd, sum_axes};

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
    /// Leaves g0, viscosity, bulk viscosity, conductivity, and the largest diffusivity of the cells
    /// that are not nearly empty \[m²/s\]. Of `bounds` the first is what bounds the diffusivities of a
    /// nearly empty cell \[m²/s\], the second the solids fraction from which on a cell is none. The
    /// conductivity is made, and counts as a diffusivity, only if it `conducts`.
    #[allow(clippy::too_many_arguments)]
    fn kinetic(
        &self,
        outputs: [&mut [R]; 5],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        bounds: [R; 2],
        conducts: bool,
    );

    /// Leaves what the filter sees of the laws: solids pressure, viscosity, bulk viscosity; nothing
    /// is bounded, and friction has no viscosity yet.
    fn seen(
        &self,
        outputs: [&mut [R]; 3],
        theory: KineticTheory<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
    );

    /// Whether friction has a viscosity.
    fn rubs(&self) -> bool;

    /// Adds the frictional viscosity, `strain` being I₂ of [`strain_row`] \[1/s²\]. The sum is bounded as
    /// the kinetic viscosity is, by `most_diffusivity` \[m²/s\], and does not limit the time step:
    /// what hardly shears creeps instead of standing still.
    fn rub(
        &self,
        viscosity: &mut [R],
        density: R,
        phi: &[R],
        theta: &[R],
        strain: &[R],
        most_diffusivity: R,
    );

    /// Leaves the solids pressure and the square of the speed of sound \[m²/s²\].
    #[allow(clippy::too_many_arguments)]
    fn pressure(
        &self,
        outputs: [&mut [R]; 2],
        theory: KineticTheory<R>,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    );

    /// g0 of one cell.
    fn radial_distribution(&self, phi: R) -> R;

    /// Frictional pressure of one cell \[Pa\].
    #[cfg(test)]
    fn frictional_pressure(&self, phi: R) -> R;

    /// Frictional viscosity of one cell \[Pa·s\]; arguments as of [`Friction::viscosity`].
    fn frictional_viscosity(&self, phi: R, theta: R, second_invariant: R) -> R;
}

/// A radial distribution and a friction.
#[derive(Clone, Copy)]
pub(super) struct Contact<G, F> {
    pub(super) radial: G,
    pub(super) friction: F,
}

impl<R: Real, G: RadialDistribution<R>, F: Friction<R>> ContactRow<R> for Contact<G, F> {
    fn kinetic(
        &self,
        [g0, viscosity, bulk, conductivity, diffusivity]: [&mut [R]; 5],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        bounds: [R; 2],
        conducts: bool,
    ) {
        // A kernel for each answer.
        macro_rules! made {
            ($conducts:literal) => {
                kinetic_row(
                    g0,
                    viscosity,
                    bulk,
                    conductivity,
                    diffusivity,
                    medium,
                    self.radial,
                    phi,
                    theta,
                    drag,
                    bounds,
                    Conducts::<$conducts>,
                )
            };
        }
        if conducts { made!(true) } else { made!(false) }
    }

    fn seen(
        &self,
        [pressure, viscosity, bulk]: [&mut [R]; 3],
        theory: KineticTheory<R>,
        phi: &[R],
        theta: &[R],
        drag: &[R],
    ) {
        let Self { radial, friction } = *self;
        seen_row(pressure, viscosity, bulk, theory, radial, friction, phi, theta, drag);
    }

    fn rubs(&self) -> bool {
        F::VISCOUS
    }

    fn rub(
        &self,
        viscosity: &mut [R],
        density: R,
        phi: &[R],
        theta: &[R],
        strain: &[R],
        most_diffusivity: R,
    ) {
        rub_row(viscosity, density, self.friction, phi, theta, strain, most_diffusivity);
    }

    fn pressure(
        &self,
        [pressure, sound]: [&mut [R]; 2],
        theory: KineticTheory<R>,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    ) {
        let Self { radial, friction } = *self;
        pressure_row(pressure, sound, theory, radial, friction, phi, g0, theta, drag, dt);
    }

    fn radial_distribution(&self, phi: R) -> R {
        self.radial.contact(phi)
    }

    #[cfg(test)]
    fn frictional_pressure(&self, phi: R) -> R {
        self.friction.pressure(phi).0
    }

    fn frictional_viscosity(&self, phi: R, theta: R, second_invariant: R) -> R {
        self.friction.viscosity(phi, theta, second_invariant)
    }
}

simd! {
    fn seen_row[R: Real, G: RadialDistribution<R>, F: Friction<R>](
        pressure: &mut [R],
        viscosity: &mut [R],
        bulk: &mut [R],
        theory: KineticTheory<R>,
        radial: G,
        friction: F,
        phi: &[R],
        theta: &[R],
        drag: &[R],
    ) {
        let n = pressure.len();
        let (viscosity, bulk) = (&mut viscosity[..n], &mut bulk[..n]);
        let (phi, theta, drag) = (&phi[..n], &theta[..n], &drag[..n]);
        for i in 0..n {
            let g0 = radial.contact(phi[i]);
            let transport = theory.transport(phi[i], g0, theta[i], drag[i]);
            pressure[i] = theory.pressure(phi[i], g0, theta[i]) + friction.pressure(phi[i]).0;
            viscosity[i] = transport.viscosity;
            bulk[i] = transport.bulk_viscosity;
        }
    }
}

simd! {
    fn rub_row[R: Real, F: Friction<R>](
        viscosity: &mut [R],
        density: R,
        friction: F,
        phi: &[R],
        theta: &[R],
        strain: &[R],
        most_diffusivity: R,
    ) {
        let n = viscosity.len();
        let (phi, theta, strain) = (&phi[..n], &theta[..n], &strain[..n]);
        for i in 0..n {
            let bound = most_diffusivity * density * (phi[i] + R::of(GHOST));
            let contacts = friction.viscosity(phi[i], theta[i], strain[i]);
            viscosity[i] = (viscosity[i] + contacts).min(bound);
        }
    }
}

simd! {
    /// ½ (Σ D_aa² - (∇·u)²/3), the part of I₂ = ½ S:S that the normal rates of strain make \[1/s²\].
    pub(super) fn strain_row[R: Real, const D: usize](
        strain: &mut [R],
        u: [[&[R]; 2]; D],
        inverse_spacing: [R; D],
    ) {
        let n = strain.len();
        let u = by_axis(u, n);
        for i in 0..n {
            let divergence = sum_axes!(D, u, |[lower, upper], a| {
                inverse_spacing[a] * (upper[i] - lower[i])
            });
            let square = sum_axes!(D, u, |[lower, upper], a| {
                let rate = inverse_spacing[a] * (upper[i] - lower[i]);
                rate * rate
            });
            // The sum of squares is never less, but for round-off.
            strain[i] = (R::of(0.5) * (square - R::of(1.0 / 3.0) * divergence * divergence))
                .max(R::ZERO);
        }
    }
}

simd! {
    /// Adds to I₂ what the shear rate γ of one pair of axes makes, γ²/4: the mean of γ of a cell's four
    /// edges. `u` is each component above and below along the other axis, on either face.
    pub(super) fn shear_strain_row[R: Real](
        strain: &mut [R],
        u: [[&[R]; 4]; 2],
        inverse_spacing: [R; 2],
    ) {
        let n = strain.len();
        let u = [cut(u[0], n), cut(u[1], n)];
        for i in 0..n {
            let across = |u: &[&[R]; 4]| (u[0][i] + u[1][i]) - (u[2][i] + u[3][i]);
            let rate = inverse_spacing[1] * across(&u[0]) + inverse_spacing[0] * across(&u[1]);
            // The mean of two faces, over two cells: a quarter; γ²/4 once more.
            strain[i] += R::of(1.0 / 64.0) * rate * rate;
        }
    }
}

simd! {
    fn pressure_row[R: Real, G: RadialDistribution<R>, F: Friction<R>](
        pressure: &mut [R],
        sound: &mut [R],
        theory: KineticTheory<R>,
        radial: G,
        friction: F,
        phi: &[R],
        g0: &[R],
        theta: &[R],
        drag: &[R],
        dt: R,
    ) {
        let n = pressure.len();
        let sound = &mut sound[..n];
        let (phi, g0, theta, drag) = (&phi[..n], &g0[..n], &theta[..n], &drag[..n]);
        for i in 0..n {
            let (contacts, stiffness) = friction.pressure(phi[i]);
            pressure[i] = theory.pressure(phi[i], g0[i], theta[i]) + contacts;
            let slope = radial.slope(phi[i], g0[i]);
            // Dissipation is implicit, so of the heat of compression a step keeps only this.
            let relaxation = theory.collisional_dissipation(phi[i], g0[i]) * theta[i].sqrt()
                + R::of(2.0 / 3.0) * theory.viscous_dissipation(drag[i]);
            let adiabatic = R::ONE / (R::ONE + dt * relaxation);
            sound[i] = theory.sound_speed_squared(phi[i], g0[i], slope, theta[i], adiabatic)
                + stiffness;
        }
    }
}

simd! {
    /// |u_g - u_s|² from the means of the faces' velocities.
    pub(super) fn slip_row[R: Real, const D: usize](slip_squared: &mut [R], velocities: [[&[R]; 4]; D]) {
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

/// Whether granular energy is conducted.
#[derive(Clone, Copy)]
struct Conducts<const YES: bool>;

simd! {
    fn kinetic_row[R: Real, G: RadialDistribution<R>, const CONDUCTS: bool](
        g0: &mut [R],
        viscosity: &mut [R],
        bulk: &mut [R],
        conductivity: &mut [R],
        diffusivity: &mut [R],
        medium: &Medium<R>,
        radial: G,
        phi: &[R],
        theta: &[R],
        drag: &[R],
        bounds: [R; 2],
        _conducts: Conducts<CONDUCTS>,
    ) {
        let n = g0.len();
        let (viscosity, bulk, conductivity) =
            (&mut viscosity[..n], &mut bulk[..n], &mut conductivity[..n]);
        let diffusivity = &mut diffusivity[..n];
        let (phi, theta, drag) = (&phi[..n], &theta[..n], &drag[..n]);
        let theory = medium.theory;
        let density = medium.solids_density;
        let [cap, nearly_empty] = bounds;
        for i in 0..n {
            let contact = radial.contact(phi[i]);
            let transport = theory.transport(phi[i], contact, theta[i], drag[i]);
            let mass = density * (phi[i] + R::of(GHOST));
            let bound = cap * mass;
            g0[i] = contact;
            viscosity[i] = transport.viscosity.min(bound);
            bulk[i] = transport.bulk_viscosity.min(R::of(0.25) * bound);
            let mut most = transport.viscosity.max(R::of(4.0) * transport.bulk_viscosity);
            if CONDUCTS {
                conductivity[i] = transport.conductivity.min(bound);
                most = most.max(transport.conductivity);
            }
            diffusivity[i] = R::select(phi[i] > nearly_empty, most / mass, R::ZERO);
        }
    }
}

simd! {
    /// Adds ∂(λ ∂T) + τ_aa ∂(u + u')/2 along one axis \[W/m³\].
    pub(super) fn heating_row[R: Real](
        heating: &mut [R],
        theta: [&[R]; 3],
        conductivity: [&[R]; 3],
        normal: &[R],
        u: [[&[R]; 2]; 2],
        inverse_spacing: R,
    ) {
        let n = heating.len();
        let (theta, conductivity) = (cut(theta, n), cut(conductivity, n));
        let (normal, u) = (&normal[..n], [cut(u[0], n), cut(u[1], n)]);
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
    /// Adds τ_aa ∂(u + u')/2 along one axis \[W/m³\].
    pub(super) fn normal_heating_row[R: Real](
        heating: &mut [R],
        normal: &[R],
        u: [[&[R]; 2]; 2],
        inverse_spacing: R,
    ) {
        let n = heating.len();
        let (normal, u) = (&normal[..n], [cut(u[0], n), cut(u[1], n)]);
        for i in 0..n {
            let strain = (u[0][1][i] - u[0][0][i]) + (u[1][1][i] - u[1][0][i]);
            heating[i] += R::of(0.5) * inverse_spacing * normal[i] * strain;
        }
    }
}

simd! {
    pub(super) fn per_mass_row[R: Real](heating: &mut [R], phi: &[R], density: R) {
        let phi = &phi[..heating.len()];
        for (heating, phi) in heating.iter_mut().zip(phi) {
            *heating /= density * (*phi + R::of(GHOST));
        }
    }
}

simd! {
    /// Adds the heating of the four edges of one pair of axes; each cell's part is its share of
    /// the solids around the edge, so that per mass no division is left.
    pub(super) fn edge_heating_row[R: Real](heating: &mut [R], edges: [&[R]; 4], inverse_density: R) {
        let n = heating.len();
        let edges = cut(edges, n);
        for i in 0..n {
            heating[i] += inverse_density * (edges[0][i] + edges[1][i] + edges[2][i] + edges[3][i]);
        }
    }
}

simd! {
    pub(super) fn balance_row[R: Real, const D: usize](
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

simd! {
    /// Temperature at which the sources of a cell balance; `theta_new` holds the viscous heating,
    /// `theta` is the temperature before, by which compression heats.
    ///
    /// What strain makes is bounded by 3 T ≤ (Δu)², the squared difference of velocities that the
    /// strain makes over a cell, h² of `cell_squared` times its rate. In a thin suspension, where
    /// strain is faster than drag damps, the balance alone has temperatures without bound, and a
    /// pressure that does more work in a step than was ever put in.
    pub(super) fn algebraic_row[R: Real, const D: usize](
        theta_new: &mut [R],
        medium: &Medium<R>,
        phi: &[R],
        theta: &[R],
        g0: &[R],
        drag: &[R],
        slip_squared: &[R],
        u: [[&[R]; 2]; D],
        inverse_spacing: [R; D],
        viscosity: &[R],
        cell_squared: R,
    ) {
        let n = theta_new.len();
        let (phi, theta, viscosity) = (&phi[..n], &theta[..n], &viscosity[..n]);
        let (g0, drag, slip_squared) = (&g0[..n], &drag[..n], &slip_squared[..n]);
        let u = by_axis(u, n);
        let theory = medium.theory;
        for i in 0..n {
            let divergence = sum_axes!(D, u, |[lower, upper], a| {
                inverse_spacing[a] * (upper[i] - lower[i])
            });
            let compressibility = theory.compressibility(phi[i], g0[i]);
            let collisional = theory.collisional_dissipation(phi[i], g0[i]);
            let damping = theory.viscous_dissipation(drag[i]);
            let work = compressibility * divergence;
            let third = R::of(1.0 / 3.0) * cell_squared;
            let most = divergence.abs() * third.sqrt();
            let compression = (-work).max(R::ZERO).min(damping + collisional * most);
            // Viscous heating is ν times the rate of strain squared.
            let shear = theta_new[i].max(R::ZERO);
            let mass = medium.solids_density * (phi[i] + R::of(GHOST));
            let most = third * shear * mass / (viscosity[i] + R::of(1e-30));
            let shear = shear.min((damping + collisional * most.sqrt()) * most);
            theta_new[i] = balanced_temperature(
                shear + theta[i] * compression,
                collisional,
                damping + work.max(R::ZERO),
                theory.slip_production(g0[i], slip_squared[i]),
            );
        }
    }
}
