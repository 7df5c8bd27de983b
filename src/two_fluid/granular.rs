//! Closures of the solids' stress at cell centres, and the balance of granular energy.

use super::{GHOST, Medium};
use crate::laws::drag::DragLaw;
use crate::laws::friction::Friction;
use crate::laws::kinetic_theory::{EnergyBalance, KineticTheory, RadialDistribution};
use crate::real::Real;
use crate::rows::{BLOCK, blocks, by_axis, cut, simd, sum_axes};

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
        let [mut first, mut second] = [[R::ZERO; BLOCK]; 2];
        for (begin, m) in blocks(n) {
            let (phi, slip_squared) = (&phi[begin..][..m], &slip_squared[begin..][..m]);
            let (out, first, second) =
                (&mut out[begin..][..m], &mut first[..m], &mut second[..m]);
            for i in 0..m {
                out[i] = slip_squared[i].sqrt();
                [first[i], second[i]] = law.begin(phi[i], out[i]);
            }
            for i in 0..m {
                out[i] = law.finish(phi[i], out[i], [first[i], second[i]]);
            }
        }
    }
}

/// What the nearness of particles does, a row at a time: a radial distribution and a friction,
/// chosen at the cost of one call per row.
pub(super) trait ContactRow<R>: Send + Sync {
    /// Turns the slip speed squared into the production of granular energy by slip, of
    /// [`KineticTheory::slip_production`]; leaves g0, viscosity, bulk viscosity, conductivity, and the
    /// largest diffusivity of the cells that are not nearly empty \[m²/s\]. Of `bounds` the first is what bounds the diffusivities of a
    /// nearly empty cell \[m²/s\], the second the solids fraction from which on a cell is none. The
    /// conductivity is made, and counts as a diffusivity, only if it `conducts`.
    #[allow(clippy::too_many_arguments)]
    fn kinetic(
        &self,
        outputs: [&mut [R]; 6],
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

    /// Balances the granular energy of a cell, `theta` of `outputs` holding what conduction and
    /// viscous stress heat it by per solids mass \[m²/s³\]; leaves the new temperature, the solids
    /// pressure and the square of the speed of sound \[m²/s²\].
    fn balance(&self, outputs: [&mut [R]; 3], theory: KineticTheory<R>, cells: &Balanced<'_, R>);

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
        [slip, g0, viscosity, bulk, conductivity, diffusivity]: [&mut [R]; 6],
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
                    slip,
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

    fn balance(
        &self,
        [theta, pressure, sound]: [&mut [R]; 3],
        theory: KineticTheory<R>,
        cells: &Balanced<'_, R>,
    ) {
        let Self { radial, friction } = *self;
        // A kernel for each answer.
        if cells.algebraic {
            balance_row(theta, pressure, sound, theory, radial, friction, cells, Algebraic::<true>);
        } else {
            balance_row(
                theta,
                pressure,
                sound,
                theory,
                radial,
                friction,
                cells,
                Algebraic::<false>,
            );
        }
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
pub(super) struct Conducts<const YES: bool>;

simd! {
    fn kinetic_row[R: Real, G: RadialDistribution<R>, const CONDUCTS: bool](
        slip: &mut [R],
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
        let slip = &mut slip[..n];
        let (viscosity, bulk, conductivity) =
            (&mut viscosity[..n], &mut bulk[..n], &mut conductivity[..n]);
        let diffusivity = &mut diffusivity[..n];
        let (phi, theta, drag) = (&phi[..n], &theta[..n], &drag[..n]);
        let theory = medium.theory;
        let density = medium.solids_density;
        let [cap, nearly_empty] = bounds;
        let [mut inverse, mut lightness] = [[R::ZERO; BLOCK]; 2];
        for (begin, m) in blocks(n) {
            let (inverse, lightness) = (&mut inverse[..m], &mut lightness[..m]);
            let (phi, theta) = (&phi[begin..][..m], &theta[begin..][..m]);
            let drag = &drag[begin..][..m];
            let (slip, g0) = (&mut slip[begin..][..m], &mut g0[begin..][..m]);
            let (viscosity, bulk) = (&mut viscosity[begin..][..m], &mut bulk[begin..][..m]);
            let (conductivity, diffusivity) =
                (&mut conductivity[begin..][..m], &mut diffusivity[begin..][..m]);
            for i in 0..m {
                [g0[i], inverse[i]] = radial.contact_and_inverse(phi[i]);
                // Here, because the divider is busy below.
                lightness[i] = R::ONE / (density * (phi[i] + R::of(GHOST)));
            }
            for i in 0..m {
                let contact = [g0[i], inverse[i]];
                let transport = theory.transport_of_contact(phi[i], contact, theta[i], drag[i]);
                let mass = density * (phi[i] + R::of(GHOST));
                let bound = cap * mass;
                slip[i] = theory.slip_production_of_contact(inverse[i], slip[i]);
                viscosity[i] = transport.viscosity.min(bound);
                bulk[i] = transport.bulk_viscosity.min(R::of(0.25) * bound);
                let mut most = transport.most_viscous();
                if CONDUCTS {
                    conductivity[i] = transport.conductivity.min(bound);
                    most = transport.most_diffusive();
                }
                diffusivity[i] = R::select(phi[i] > nearly_empty, most * lightness[i], R::ZERO);
            }
        }
    }
}

simd! {
    /// Conduction and viscous heating of the cells of a row per solids mass \[m²/s³\], and the
    /// divergence of the velocities after the stress \[1/s\].
    ///
    /// Along each axis `work` is τ_aa, and u at the lower and upper face before the stress and after;
    /// `heat` is conductivity and temperature below, here and above. `edges` is the heating of the four edges of each pair of
    /// axes, of [`shear_heating_row`](super::stress::shear_heating_row): each cell's part is its share of
    /// the solids around the edge, so that per mass no division is left. Of two axes there is one
    /// pair, the first.
    pub(super) fn heating_row[R: Real, const D: usize, const CONDUCTS: bool](
        heating: &mut [R],
        divergence: &mut [R],
        work: [[&[R]; 5]; D],
        heat: [[&[R]; 6]; D],
        edges: [[&[R]; 4]; 3],
        phi: &[R],
        inverse_density: R,
        inverse_spacing: [R; D],
        _conducts: Conducts<CONDUCTS>,
    ) {
        let n = heating.len();
        let (divergence, phi) = (&mut divergence[..n], &phi[..n]);
        let (work, heat) = (by_axis(work, n), by_axis(heat, n));
        let [ab, ac, bc] = [cut(edges[0], n), cut(edges[1], n), cut(edges[2], n)];
        // Of conductivities below it nothing is left; its square is still a normal number.
        let (half, two, tiny) = (R::of(0.5), R::of(2.0), R::of(1e-18));
        for i in 0..n {
            divergence[i] = sum_axes!(D, work, |[_, _, _, lower, upper], a| {
                inverse_spacing[a] * (upper[i] - lower[i])
            });
            let mut volume = sum_axes!(D, work, |[stress, u0, u1, v0, v1], a| {
                let strain = (u1[i] - u0[i]) + (v1[i] - v0[i]);
                half * inverse_spacing[a] * stress[i] * strain
            });
            if CONDUCTS {
                volume += sum_axes!(D, heat, |[k0, k1, k2, t0, t1, t2], a| {
                    // Harmonic means, both with one division: a nearly empty cell does not conduct
                    // into a dense one.
                    let (k0, k1, k2) = (k0[i], k1[i], k2[i]);
                    let (below, above) = (k0 + k1 + tiny, k1 + k2 + tiny);
                    let lower = k0 * above * (t1[i] - t0[i]);
                    let upper = k2 * below * (t2[i] - t1[i]);
                    two * inverse_spacing[a] * inverse_spacing[a] * k1 * (upper - lower) / (below * above)
                });
            }
            let mut shear = ab[0][i] + ab[1][i] + ab[2][i] + ab[3][i];
            if D == 3 {
                shear += (ac[0][i] + ac[1][i] + ac[2][i] + ac[3][i])
                    + (bc[0][i] + bc[1][i] + bc[2][i] + bc[3][i]);
            }
            heating[i] = inverse_density * (volume / (phi[i] + R::of(GHOST)) + shear);
        }
    }
}

/// What the balance of granular energy of a row of cells hangs on.
pub(super) struct Balanced<'a, R> {
    /// Whether sources and sinks balance at once, instead of over the step.
    pub(super) algebraic: bool,
    pub(super) phi: &'a [R],
    /// Temperature before.
    pub(super) theta: &'a [R],
    pub(super) g0: &'a [R],
    pub(super) drag: &'a [R],
    /// Production by slip, as [`ContactRow::kinetic`] leaves it.
    pub(super) slip: &'a [R],
    /// ∇·u_s \[1/s\].
    pub(super) divergence: &'a [R],
    pub(super) viscosity: &'a [R],
    pub(super) solids_density: R,
    /// 1/Σ 1/h² \[m²\].
    pub(super) cell_squared: R,
    pub(super) dt: R,
}

/// Whether sources and sinks of granular energy balance at once.
#[derive(Clone, Copy)]
struct Algebraic<const YES: bool>;

simd! {
    /// If the balance is algebraic, what strain makes is bounded by 3 T ≤ (Δu)², the squared difference
    /// of velocities that the strain makes over a cell, h² of `cell_squared` times its rate. In a thin
    /// suspension, where strain is faster than drag damps, the balance alone has temperatures without
    /// bound, and a pressure that does more work in a step than was ever put in.
    fn balance_row[R: Real, G: RadialDistribution<R>, F: Friction<R>, const ALGEBRAIC: bool](
        theta_new: &mut [R],
        pressure: &mut [R],
        sound: &mut [R],
        theory: KineticTheory<R>,
        radial: G,
        friction: F,
        cells: &Balanced<'_, R>,
        _algebraic: Algebraic<ALGEBRAIC>,
    ) {
        let n = theta_new.len();
        let (pressure, sound) = (&mut pressure[..n], &mut sound[..n]);
        let Balanced { phi, theta, g0, drag, slip, divergence, viscosity, dt, .. } = *cells;
        let (phi, theta, g0) = (&phi[..n], &theta[..n], &g0[..n]);
        let (drag, slip, divergence) = (&drag[..n], &slip[..n], &divergence[..n]);
        let viscosity = &viscosity[..n];
        let third = R::of(1.0 / 3.0) * cells.cell_squared;
        let side = third.sqrt();
        let stiffest = cells.cell_squared / (dt * dt);
        let (density, two_thirds) = (cells.solids_density, R::of(2.0 / 3.0));
        let [mut collisional, mut cubic, mut linear, mut speed] = [[R::ZERO; BLOCK]; 4];
        for (begin, m) in blocks(n) {
            let (phi, theta) = (&phi[begin..][..m], &theta[begin..][..m]);
            let (g0, drag) = (&g0[begin..][..m], &drag[begin..][..m]);
            let (slip, divergence) = (&slip[begin..][..m], &divergence[begin..][..m]);
            let viscosity = &viscosity[begin..][..m];
            let (theta_new, pressure) = (&mut theta_new[begin..][..m], &mut pressure[begin..][..m]);
            let sound = &mut sound[begin..][..m];
            let collisional = &mut collisional[..m];
            let (cubic, linear, speed) = (&mut cubic[..m], &mut linear[..m], &mut speed[..m]);
            for i in 0..m {
                collisional[i] = theory.collisional_dissipation(phi[i], g0[i]);
                let damping = theory.viscous_dissipation(drag[i]);
                // -P_s ∇·u: a sink where the solids expand, implicit; a source where they contract.
                let work = theory.compressibility(phi[i], g0[i]) * divergence[i];
                let sinks = damping + work.max(R::ZERO);
                let balance = if ALGEBRAIC {
                    let most = divergence[i].abs() * side;
                    let compression = (-work).max(R::ZERO).min(damping + collisional[i] * most);
                    // Viscous heating is ν times the rate of strain squared.
                    let shear = theta_new[i].max(R::ZERO);
                    let mass = density * (phi[i] + R::of(GHOST));
                    let most = third * shear * mass / (viscosity[i] + R::of(1e-30));
                    let shear = shear.min((damping + collisional[i] * most.sqrt()) * most);
                    let heating = shear + theta[i] * compression;
                    EnergyBalance::at_once(heating, collisional[i], sinks, slip[i])
                } else {
                    let heating = theta_new[i] + theta[i] * (-work).max(R::ZERO);
                    EnergyBalance::after(theta[i], heating, collisional[i], sinks, slip[i], dt)
                };
                (cubic[i], linear[i]) = (balance.cubic, balance.linear);
                speed[i] = balance.bound();
            }
            for _ in 0..EnergyBalance::<R>::STEPS {
                for i in 0..m {
                    let balance = EnergyBalance {
                        collisional: collisional[i],
                        cubic: cubic[i],
                        linear: linear[i],
                        slip: slip[i],
                    };
                    speed[i] = balance.nearer(speed[i]);
                }
            }
            for i in 0..m {
                let warm = speed[i] * speed[i];
                theta_new[i] = warm;
                let (contacts, stiffness) = friction.pressure(phi[i]);
                // What has become too stiff for a step of this length pushes as if it were not: more would
                // fling back what hits a packed bed. The next step is as short as the sound asks for.
                let stiff = stiffness.max(stiffest);
                // Dissipation is implicit, so of the heat of compression a step keeps only one part in this.
                let damping = theory.viscous_dissipation(drag[i]);
                let kept = R::ONE + dt * (collisional[i] * speed[i] + two_thirds * damping);
                // Both quotients with one division.
                let inverse = R::ONE / (stiff * kept);
                let contacts = contacts * stiffest * (kept * inverse);
                pressure[i] = theory.pressure(phi[i], g0[i], warm) + contacts;
                let slope = radial.slope(phi[i], g0[i]);
                let adiabatic = stiff * inverse;
                sound[i] =
                    theory.sound_speed_squared(phi[i], g0[i], slope, warm, adiabatic) + stiffness;
            }
        }
    }
}
