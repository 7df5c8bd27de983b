//! Kinetic theory of the solids: pressure, viscosities, conductivity, sources of granular energy.
//!
//! The closure of Lun et al. (1984) with the gas damping of Koch & Sangani and of Ma & Ahmadi as
//! Agrawal, Loezos, Syamlal & Sundaresan (2001, J. Fluid Mech. 445:151) and Igci et al. (2008,
//! AIChE J. 54:1431) use it. Notation: T granular temperature ⟨C·C⟩/3 \[m²/s²\], η = (1+e)/2,
//! g0 radial distribution at contact, K = β/φ \[kg/m³/s\].
//!
//! Everything is written so that it stays finite as φ → 0: what the equations of motion divide by
//! φ is given per unit of solids mass, and K replaces β.

use super::scales::{Gas, Powder};
use crate::real::Real;
use std::f64::consts::PI;

/// α of the shear viscosity \[-\].
const ALPHA: f64 = 1.6;

/// Smallest distance from packing in a g0 that diverges there, 1 - (φ/φ_max)^(1/3) or
/// 1 - (φ/φ_max)³: caps g0 at 1000 in cells at or past packing, where friction carries the load.
const CLOSEST: f64 = 1e-3;

/// The radial distribution at contact g0: how much more often particles collide than if they had
/// no volume.
pub trait RadialDistribution<R: Real>: Copy + Send + Sync {
    /// g0 \[-\].
    fn contact(&self, solids_fraction: R) -> R;

    /// g0 and 1/g0 \[-\].
    #[inline(always)]
    fn contact_and_inverse(&self, solids_fraction: R) -> [R; 2] {
        let contact = self.contact(solids_fraction);
        [contact, R::ONE / contact]
    }

    /// φ² dg0/dφ \[-\] where g0 is `contact`.
    fn slope(&self, solids_fraction: R, contact: R) -> R;
}

/// g0 = 1 / (1 - (φ/φ_max)^(1/3)), the one of Agrawal et al. (2001) and Igci et al. (2008); for
/// all φ. Its slope at φ = 0 is infinite, φ² dg0/dφ is not.
#[derive(Clone, Copy, Debug)]
pub struct Princeton<R> {
    max_packing_inverse: R,
}

impl<R: Real> Princeton<R> {
    /// Of `powder`.
    pub fn new(powder: &Powder) -> Self {
        Self { max_packing_inverse: R::of(1.0 / powder.max_packing) }
    }
}

impl<R: Real> RadialDistribution<R> for Princeton<R> {
    #[inline(always)]
    fn contact(&self, solids_fraction: R) -> R {
        self.contact_and_inverse(solids_fraction)[0]
    }

    #[inline(always)]
    fn contact_and_inverse(&self, solids_fraction: R) -> [R; 2] {
        // The floor is what a cube root is taken of.
        let crowding = (solids_fraction * self.max_packing_inverse).max(R::of(1e-30)).cbrt();
        let free = (R::ONE - crowding).max(R::of(CLOSEST));
        [R::ONE / free, free]
    }

    #[inline(always)]
    fn slope(&self, solids_fraction: R, contact: R) -> R {
        // dg0/dφ = g0² (φ/φ_max)^(1/3) / (3 φ), and (φ/φ_max)^(1/3) = 1 - 1/g0.
        solids_fraction * contact * (contact - R::ONE) * R::of(1.0 / 3.0)
    }
}

/// Carnahan & Starling (1969, J. Chem. Phys. 51:635): g0 = (1 - φ/2) / (1-φ)³, that of a fluid of
/// hard spheres, exact to some per cent up to its freezing at φ = 0.49; knows no packing.
#[derive(Clone, Copy, Debug)]
pub struct CarnahanStarling;

impl<R: Real> RadialDistribution<R> for CarnahanStarling {
    #[inline(always)]
    fn contact(&self, solids_fraction: R) -> R {
        let free = R::ONE - solids_fraction;
        (R::ONE - R::of(0.5) * solids_fraction) / (free * free * free)
    }

    #[inline(always)]
    fn slope(&self, solids_fraction: R, _: R) -> R {
        let crowding = solids_fraction / (R::ONE - solids_fraction);
        let crowding2 = crowding * crowding;
        let free = R::ONE - solids_fraction;
        crowding2 * (R::of(2.5) - solids_fraction) / (free * free)
    }
}

/// Ma & Ahmadi (1986, J. Chem. Phys. 84:3449):
/// g0 = (1 + 2.5 φ + 4.5904 φ² + 4.515439 φ³) / (1 - (φ/φ_max)³)^0.678021, published with
/// φ_max = 0.64356; here φ_max is the powder's. For all φ.
#[derive(Clone, Copy, Debug)]
pub struct MaAhmadi<R> {
    max_packing_inverse: R,
}

/// Exponent of [`MaAhmadi`].
const MA_AHMADI: f64 = 0.678021;

impl<R: Real> MaAhmadi<R> {
    /// Of `powder`.
    pub fn new(powder: &Powder) -> Self {
        Self { max_packing_inverse: R::of(1.0 / powder.max_packing) }
    }

    /// (φ/φ_max)³ and 1 less it.
    #[inline(always)]
    fn cube(&self, solids_fraction: R) -> (R, R) {
        let ratio = solids_fraction * self.max_packing_inverse;
        let cube = ratio * ratio * ratio;
        (cube, (R::ONE - cube).max(R::of(CLOSEST)))
    }

    /// The numerator.
    #[inline(always)]
    fn series(phi: R) -> R {
        R::ONE + phi * (R::of(2.5) + phi * (R::of(4.5904) + phi * R::of(4.515439)))
    }
}

impl<R: Real> RadialDistribution<R> for MaAhmadi<R> {
    #[inline(always)]
    fn contact(&self, solids_fraction: R) -> R {
        let (_, free) = self.cube(solids_fraction);
        Self::series(solids_fraction) * free.power(R::of(-MA_AHMADI))
    }

    #[inline(always)]
    fn slope(&self, phi: R, contact: R) -> R {
        let (cube, free) = self.cube(phi);
        let growth = R::of(2.5) + phi * (R::of(2.0 * 4.5904) + phi * R::of(3.0 * 4.515439));
        // dg0/dφ = g0 (series'/series + 3 · 0.678021 (φ/φ_max)³ / (φ free)).
        contact * phi * (phi * growth / Self::series(phi) + R::of(3.0 * MA_AHMADI) * cube / free)
    }
}

/// The kinetic theory of one powder in one gas; holds constants only.
#[derive(Clone, Copy, Debug)]
pub struct KineticTheory<R> {
    density: R,
    eta: R,
    /// (5/96) ρ_s d √π: dilute viscosity per √T.
    dilute_viscosity: R,
    /// 75 ρ_s d √π / (48 η (41 - 33 η)): dilute conductivity per √T.
    dilute_conductivity: R,
    /// 1 / (η (2-η)) \[-\].
    elastic: R,
    /// 3 / ρ_s.
    damping: R,
    /// (48/√π) η (1-η) / d.
    collisional: R,
    /// 81 μ_g² / (d³ ρ_s² √π).
    slip: R,
}

/// What the granular temperature and fraction of a cell make of the stress and heat flux.
#[derive(Clone, Copy, Debug)]
pub struct Transport<R> {
    /// Shear viscosity μ_s \[Pa·s\].
    pub viscosity: R,
    /// Bulk viscosity as it enters the stress, η μ_b \[Pa·s\].
    pub bulk_viscosity: R,
    /// Conductivity of granular energy λ \[kg/m/s\].
    pub conductivity: R,
}

impl<R: Real> Transport<R> {
    /// What limits an explicit step of the stress: μ_s or 4 η μ_b, which is the larger \[Pa·s\].
    #[inline(always)]
    pub fn most_viscous(&self) -> R {
        self.viscosity.max(R::of(4.0) * self.bulk_viscosity)
    }

    /// What limits one of stress and heat flux: that, or λ if it is larger \[Pa·s\].
    #[inline(always)]
    pub fn most_diffusive(&self) -> R {
        self.most_viscous().max(self.conductivity)
    }
}

impl<R: Real> KineticTheory<R> {
    /// The theory for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        let eta = 0.5 * (1.0 + powder.restitution);
        let sqrt_pi = PI.sqrt();
        let d = powder.diameter;
        Self {
            density: R::of(powder.density),
            eta: R::of(eta),
            dilute_viscosity: R::of(5.0 / 96.0 * powder.density * d * sqrt_pi),
            dilute_conductivity: R::of(
                75.0 * powder.density * d * sqrt_pi / (48.0 * eta * (41.0 - 33.0 * eta)),
            ),
            elastic: R::of(1.0 / (eta * (2.0 - eta))),
            damping: R::of(3.0 / powder.density),
            collisional: R::of(48.0 / sqrt_pi * eta * (1.0 - eta) / d),
            slip: R::of(
                81.0 * gas.viscosity.powi(2) / (d.powi(3) * powder.density.powi(2) * sqrt_pi),
            ),
        }
    }

    /// P_s = ρ_s φ (1 + 4 η φ g0) T \[Pa\].
    #[inline(always)]
    pub fn pressure(&self, phi: R, g0: R, temperature: R) -> R {
        self.density * phi * self.compressibility(phi, g0) * temperature
    }

    /// 1 + 4 η φ g0 \[-\].
    #[inline(always)]
    pub fn compressibility(&self, phi: R, g0: R) -> R {
        R::ONE + R::of(4.0) * self.eta * phi * g0
    }

    /// Square of the speed of sound of the granular gas \[m²/s²\]:
    /// T {1 + 8 η φ g0 + 4 η φ² g0' + ⅔ a (1 + 4 η φ g0)²}; `slope` is φ² g0', of
    /// [`RadialDistribution::slope`].
    ///
    /// `adiabatic` a is the share of the heat of compression that dissipation leaves: 1 for the
    /// isentropic speed, 0 for the isothermal.
    #[inline(always)]
    pub fn sound_speed_squared(&self, phi: R, g0: R, slope: R, temperature: R, adiabatic: R) -> R {
        let compressibility = self.compressibility(phi, g0);
        temperature
            * (R::ONE
                + R::of(8.0) * self.eta * phi * g0
                + R::of(4.0) * self.eta * slope
                + R::of(2.0 / 3.0) * adiabatic * compressibility * compressibility)
    }

    /// Viscosities and conductivity at the drag coefficient per fraction K = β/φ:
    ///
    /// - μ = (5/96) ρ_s d √(π T), μ_b = 256 μ φ² g0 / (5 π),
    ///   μ* = μ / [1 + 2 β μ / ((ρ_s φ)² g0 T)],
    /// - μ_s = (2+α)/3 {μ* / (g0 η (2-η)) (1 + 8/5 η φ g0)(1 + 8/5 η (3η-2) φ g0) + 3/5 η μ_b},
    /// - λ_i = 75 ρ_s d √(π T) / (48 η (41-33η)), λ* = λ_i / [1 + 6/5 β λ_i / ((ρ_s φ)² g0 T)],
    /// - λ = λ*/g0 {(1 + 12/5 η φ g0)(1 + 12/5 η² (4η-3) φ g0) + 64/(25π) (41-33η) (η φ g0)²}.
    #[inline(always)]
    pub fn transport(&self, phi: R, g0: R, temperature: R, drag_per_fraction: R) -> Transport<R> {
        self.transport_of_contact(phi, [g0, R::ONE / g0], temperature, drag_per_fraction)
    }

    /// [`KineticTheory::transport`] of what [`RadialDistribution::contact_and_inverse`] gives.
    #[inline(always)]
    pub fn transport_of_contact(
        &self,
        phi: R,
        [g0, g0_inverse]: [R; 2],
        temperature: R,
        drag_per_fraction: R,
    ) -> Transport<R> {
        let Self { eta, density, .. } = *self;
        let speed = temperature.sqrt();
        let crowd = eta * phi * g0;
        // ρ_s² φ g0 T: μ* = μ X / (X + 2 K μ) has no 0/0 in empty or cold cells.
        let inertia = density * density * phi * g0 * temperature + R::of(1e-15);
        let viscous = self.dilute_viscosity * speed;
        let conductive = self.dilute_conductivity * speed;
        // Both quotients with one division.
        let viscous_whole = inertia + R::of(2.0) * drag_per_fraction * viscous;
        let conductive_whole = inertia + R::of(1.2) * drag_per_fraction * conductive;
        let share = inertia * g0_inverse / (viscous_whole * conductive_whole);

        let dilute = viscous;
        let damped = dilute * share * conductive_whole;
        let bulk_viscosity = R::of(256.0 / (5.0 * PI)) * dilute * phi * crowd;
        let factor = R::of((2.0 + ALPHA) / 3.0);
        let viscosity = factor
            * (damped
                * self.elastic
                * (R::ONE + R::of(1.6) * crowd)
                * (R::ONE + R::of(1.6) * (R::of(3.0) * eta - R::of(2.0)) * crowd)
                + R::of(0.6) * bulk_viscosity);

        let damped = conductive * share * viscous_whole;
        let conductivity = damped
            * ((R::ONE + R::of(2.4) * crowd)
                * (R::ONE + R::of(2.4) * eta * (R::of(4.0) * eta - R::of(3.0)) * crowd)
                + R::of(64.0 / (25.0 * PI)) * (R::of(41.0) - R::of(33.0) * eta) * crowd * crowd);
        Transport { viscosity, bulk_viscosity, conductivity }
    }

    /// Collisional dissipation per solids mass and T^(3/2): J_coll / (ρ_s φ T^(3/2)), where
    /// J_coll = (48/√π) η (1-η) ρ_s φ² g0 T^(3/2) / d \[1/m\].
    #[inline(always)]
    pub fn collisional_dissipation(&self, phi: R, g0: R) -> R {
        self.collisional * phi * g0
    }

    /// Viscous dissipation per solids mass and T: J_vis / (ρ_s φ T) = 3 K / ρ_s \[1/s\].
    #[inline(always)]
    pub fn viscous_dissipation(&self, drag_per_fraction: R) -> R {
        self.damping * drag_per_fraction
    }

    /// Production by slip per solids mass, times √T: Γ_slip √T / (ρ_s φ), where
    /// Γ_slip = 81 φ μ_g² |u_g - u_s|² / (g0 d³ ρ_s √(π T)) (Koch & Sangani 1999) \[m³/s⁴\].
    #[inline(always)]
    pub fn slip_production(&self, g0: R, slip_squared: R) -> R {
        self.slip_production_of_contact(R::ONE / g0, slip_squared)
    }

    /// [`KineticTheory::slip_production`] of 1/g0.
    #[inline(always)]
    pub fn slip_production_of_contact(&self, g0_inverse: R, slip_squared: R) -> R {
        self.slip * slip_squared * g0_inverse
    }

    /// Granular temperature of a uniform suspension at rest \[m²/s²\]: production by the `slip`
    /// velocity balances both dissipations, a T² + b T^(3/2) = c with the coefficients of the three
    /// above, at the drag coefficient per fraction K = β/φ.
    pub fn steady_temperature(&self, phi: R, g0: R, drag_per_fraction: R, slip: R) -> R {
        let a = self.collisional_dissipation(phi, g0);
        let b = self.viscous_dissipation(drag_per_fraction);
        let c = self.slip_production(g0, slip * slip);
        // With s = √T convex and growing: Newton's method from above, where b s³ = c, falls
        // monotonically, by a quarter a step until it is near.
        let mut s = (c / b).cbrt();
        for _ in 0..60 {
            let s2 = s * s;
            s -= ((a * s + b) * s2 * s - c) / ((R::of(4.0) * a * s + R::of(3.0) * b) * s2);
        }
        s * s
    }
}

/// The local balance of granular energy of a cell in terms of the root mean square s = √T of one component of
/// the particles' fluctuations \[m/s\]: a s⁴ + b s³ = l s + c, with b above zero, the others not below. The
/// coefficients of the difference change sign once, so there is one root.
#[derive(Clone, Copy, Debug)]
pub struct EnergyBalance<R> {
    /// a, of [`KineticTheory::collisional_dissipation`] \[1/m\].
    pub collisional: R,
    /// b \[1/s\].
    pub cubic: R,
    /// l \[m²/s³\].
    pub linear: R,
    /// c, of [`KineticTheory::slip_production`] \[m³/s⁴\].
    pub slip: R,
}

impl<R: Real> EnergyBalance<R> {
    /// After `dt` from temperature `before`, all sinks implicit:
    ///
    /// 3/2 (T - `before`)/dt = `heating` - a T^(3/2) - b T + c T^(-1/2)
    ///
    /// with a `collisional`, b `damping`, c `slip`.
    #[inline(always)]
    pub fn after(before: R, heating: R, collisional: R, damping: R, slip: R, dt: R) -> Self {
        let rate = R::of(1.5) / dt;
        let linear = (rate * before + heating).max(R::ZERO);
        Self { collisional, cubic: rate + damping, linear, slip }
    }

    /// Where sources and sinks balance at once: `heating` + c T^(-1/2) = a T^(3/2) + b T with a
    /// `collisional`, b `damping` (above zero), c `slip`. Without sources next to nothing, yet above zero.
    #[inline(always)]
    pub fn at_once(heating: R, collisional: R, damping: R, slip: R) -> Self {
        Self { collisional, cubic: damping, linear: heating, slip }
    }

    /// A bound of √T from above, near it; at least 1e-9.
    #[inline(always)]
    pub fn bound(&self) -> R {
        let Self { collisional, cubic, linear, slip } = *self;
        // Without collisions s³ = x² s + y³, whose root is at most 1.055 (x³ + y³)^(1/3); and a s⁴ is less
        // than what feeds it at any bound, of which the third is near. The floors keep products of single
        // precision normal.
        let floor = R::of(1e-24);
        let inverse = R::ONE / cubic;
        let x2 = linear * inverse;
        let x3 = x2 * x2.max(floor).rough_roots()[0];
        let mut s = R::of(1.055) * (x3 + slip * inverse).max(floor).rough_roots()[1];
        let inverse = R::ONE / (collisional + R::of(1e-15));
        for _ in 0..3 {
            s = s.min(((linear * s + slip) * inverse).max(R::of(1e-32)).rough_roots()[2]);
        }
        s
    }

    /// A step of Halley's method: bounds from above fall to √T, to 1e-9 of it after
    /// [`STEPS`](Self::STEPS) from [`bound`](Self::bound) for any coefficients.
    #[inline(always)]
    pub fn nearer(&self, s: R) -> R {
        let Self { collisional, cubic, linear, slip } = *self;
        let s2 = s * s;
        let value = (collisional * s + cubic) * s2 * s - linear * s - slip;
        let slope = (R::of(4.0) * collisional * s + R::of(3.0) * cubic) * s2 - linear;
        // Half the second derivative.
        let bend = (R::of(6.0) * collisional * s + R::of(3.0) * cubic) * s;
        s - value * slope / (slope * slope - value * bend)
    }

    /// Steps that are enough.
    pub const STEPS: usize = 3;

    /// √T \[m/s\].
    pub fn speed(&self) -> R {
        (0..Self::STEPS).fold(self.bound(), |s, _| self.nearer(s))
    }
}

#[cfg(test)]
mod tests {
    use super::super::scales::tests::{GAS, POWDER};
    use super::*;

    const PHI: f64 = 0.3;
    const T: f64 = 2e-3;
    const K: f64 = 1e5;

    fn princeton() -> Princeton<f64> {
        Princeton::new(&POWDER)
    }

    #[test]
    fn radial_distributions_have_their_published_values() {
        assert!((princeton().contact(0.6) - 38.0).abs() < 0.5);
        assert!(princeton().contact(0.7) <= 1000.0);
        let fluid: f64 = CarnahanStarling.contact(0.6);
        assert!((fluid - 10.9).abs() < 0.05, "{fluid}");
        // The virial series of hard spheres begins 1 + 5/2 φ + 4.5904 φ².
        let ma_ahmadi = MaAhmadi::<f64>::new(&POWDER);
        for phi in [1e-3, 1e-2] {
            let series = 1.0 + 2.5 * phi + 4.5904 * phi * phi;
            assert!((ma_ahmadi.contact(phi) - series).abs() < 12.0 * phi.powi(3));
            let fluid: f64 = CarnahanStarling.contact(phi);
            assert!((fluid - series).abs() < 0.1 * phi * phi + 12.0 * phi.powi(3));
        }
        // Two fits of the same fluid, with the published φ_max, where it freezes.
        let published = MaAhmadi::<f64>::new(&Powder { max_packing: 0.64356, ..POWDER });
        let fluid: f64 = CarnahanStarling.contact(0.49);
        assert!((fluid - 5.6916).abs() < 5e-5, "{fluid}");
        assert!((published.contact(0.49) / fluid - 1.0).abs() < 0.01);
        assert!(ma_ahmadi.contact(0.7) <= 1000.0);
    }

    fn check_slope(radial: impl RadialDistribution<f64>, single: impl RadialDistribution<f32>) {
        assert!((radial.contact(0.0) - 1.0).abs() < 1e-9);
        assert!(radial.slope(0.0, radial.contact(0.0)).abs() < 1e-9);
        for phi in [0.01, 0.2, 0.4, 0.55, 0.63] {
            let h = 1e-6;
            let slope = (radial.contact(phi + h) - radial.contact(phi - h)) / (2.0 * h);
            let found = radial.slope(phi, radial.contact(phi)) / (phi * phi);
            assert!((found / slope - 1.0).abs() < 1e-6, "{phi}: {found} {slope}");
            let rounded = f64::from(single.contact(phi as f32));
            assert!((rounded / radial.contact(phi) - 1.0).abs() < 1e-4, "{phi}: {rounded}");
        }
        for phi in [0.65, 0.66, 0.7] {
            let slope = radial.slope(phi, radial.contact(phi));
            assert!(slope.is_finite() && slope > 0.0, "{phi}: {slope}");
        }
    }

    #[test]
    fn slopes_of_the_radial_distributions_are_their_derivatives() {
        check_slope(princeton(), Princeton::<f32>::new(&POWDER));
        check_slope(CarnahanStarling, CarnahanStarling);
        check_slope(MaAhmadi::<f64>::new(&POWDER), MaAhmadi::<f32>::new(&POWDER));
    }

    #[test]
    fn stress_and_conductivity_agree_with_the_formulae_as_printed() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        let g0 = princeton().contact(PHI);
        let (rho, d, e): (f64, f64, f64) = (1500.0, 75e-6, 0.9);
        let eta = (1.0 + e) / 2.0;
        let beta = K * PHI;
        let mu = 5.0 / 96.0 * rho * d * (PI * T).sqrt();
        let mu_b = 256.0 * mu * PHI * PHI * g0 / (5.0 * PI);
        let mu_star = mu / (1.0 + 2.0 * beta * mu / ((rho * PHI).powi(2) * g0 * T));
        let mu_s = (2.0 + 1.6) / 3.0
            * (mu_star / (g0 * eta * (2.0 - eta))
                * (1.0 + 8.0 / 5.0 * eta * PHI * g0)
                * (1.0 + 8.0 / 5.0 * eta * (3.0 * eta - 2.0) * PHI * g0)
                + 3.0 / 5.0 * eta * mu_b);
        let found = theory.transport(PHI, g0, T, K);
        assert!((found.viscosity / mu_s - 1.0).abs() < 1e-13);
        assert!((found.bulk_viscosity / (eta * mu_b) - 1.0).abs() < 1e-13);

        let lambda_i = 75.0 * rho * d * (PI * T).sqrt() / (48.0 * eta * (41.0 - 33.0 * eta));
        let star = lambda_i / (1.0 + 6.0 / 5.0 * beta * lambda_i / ((rho * PHI).powi(2) * g0 * T));
        let crowd = eta * PHI * g0;
        let lambda = star / g0
            * ((1.0 + 2.4 * crowd) * (1.0 + 2.4 * eta * (4.0 * eta - 3.0) * crowd)
                + 64.0 / (25.0 * PI) * (41.0 - 33.0 * eta) * crowd * crowd);
        assert!((found.conductivity / lambda - 1.0).abs() < 1e-13);
        let pressure = rho * PHI * (1.0 + 4.0 * eta * PHI * g0) * T;
        assert!((theory.pressure(PHI, g0, T) / pressure - 1.0).abs() < 1e-14);
    }

    #[test]
    fn sources_agree_with_the_formulae_as_printed() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        let g0 = princeton().contact(PHI);
        let (rho, d, eta): (f64, f64, f64) = (1500.0, 75e-6, 0.95);
        let mass = rho * PHI;
        let collisional =
            48.0 / PI.sqrt() * eta * (1.0 - eta) * rho * PHI * PHI * g0 / d * T.powf(1.5);
        assert!(
            (theory.collisional_dissipation(PHI, g0) * T.powf(1.5) * mass / collisional - 1.0)
                .abs()
                < 1e-14
        );
        assert!(
            (theory.viscous_dissipation(K) * T * mass / (3.0 * K * PHI * T) - 1.0).abs() < 1e-14
        );
        let slip = 81.0 * PHI * 1.8e-5f64.powi(2) * 0.04 / (g0 * d.powi(3) * rho * (PI * T).sqrt());
        assert!((theory.slip_production(g0, 0.04) / T.sqrt() * mass / slip - 1.0).abs() < 1e-13);
    }

    #[test]
    fn steady_temperature_balances_the_sources() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        for (phi, slip) in [(1e-4, 0.2), (0.05, 0.18), (0.3, 0.06), (0.6, 0.005)] {
            let g0 = princeton().contact(phi);
            let t = theory.steady_temperature(phi, g0, K, slip);
            let production = theory.slip_production(g0, slip * slip) / t.sqrt();
            let loss = theory.collisional_dissipation(phi, g0) * t.powf(1.5)
                + theory.viscous_dissipation(K) * t;
            assert!((production / loss - 1.0).abs() < 1e-13, "{phi}: {t}");
        }
    }

    #[test]
    fn sound_speed_is_the_isentropic_derivative_of_the_pressure() {
        // c² = ∂P/∂(ρφ) + (P/(ρφ))² ∂P/∂T / (1.5 ρφ ...) at constant entropy.
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        let p = |phi: f64, t: f64| theory.pressure(phi, princeton().contact(phi), t);
        let h = 1e-6;
        let by_fraction = (p(PHI + h, T) - p(PHI - h, T)) / (2.0 * h) / 1500.0;
        let g0 = princeton().contact(PHI);
        let by_heat = 2.0 / 3.0 * theory.compressibility(PHI, g0).powi(2) * T;
        let slope = princeton().slope(PHI, g0);
        let found = theory.sound_speed_squared(PHI, g0, slope, T, 1.0);
        assert!((found / (by_fraction + by_heat) - 1.0).abs() < 1e-7);
        let isothermal = theory.sound_speed_squared(PHI, g0, slope, T, 0.0);
        assert!((isothermal / by_fraction - 1.0).abs() < 1e-7);
    }

    #[test]
    fn everything_stays_finite_in_empty_and_cold_cells() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        for phi in [0.0, 1e-12] {
            for t in [0.0, 1e-12, 1.0] {
                let g0 = princeton().contact(phi);
                let found = theory.transport(phi, g0, t, K);
                assert!(found.viscosity.is_finite() && found.viscosity >= 0.0);
                assert!(found.conductivity.is_finite() && found.conductivity >= 0.0);
            }
        }
    }

    #[test]
    fn balanced_temperature_balances_the_sources() {
        for (heating, collisional, damping, slip) in [
            (0.1, 500.0, 200.0, 1e-4),
            (0.0, 5e3, 500.0, 1e-3),
            (100.0, 1e5, 1e3, 1e-6),
            (1e-6, 1e7, 1.0, 1e-9),
            (1e3, 0.0, 1.0, 0.0),
            (0.0, 0.0, 100.0, 1e-7),
        ] {
            let balance = EnergyBalance::<f64>::at_once(heating, collisional, damping, slip);
            let t = balance.speed().powi(2);
            let made = heating + slip / t.sqrt();
            let lost = collisional * t.powf(1.5) + damping * t;
            assert!((made / lost - 1.0).abs() < 1e-6, "{t}: {made} {lost}");
            let [heating, collisional, damping, slip] =
                [heating, collisional, damping, slip].map(|x| x as f32);
            let balance = EnergyBalance::at_once(heating, collisional, damping, slip);
            let single = balance.speed().powi(2);
            assert!((f64::from(single) / t - 1.0).abs() < 1e-4, "{single} {t}");
        }
        let nothing: f64 = EnergyBalance::at_once(0.0, 1e4, 100.0, 0.0).speed();
        assert!(nothing > 0.0 && nothing < 1e-8, "{nothing}");
        let single: f32 = EnergyBalance::at_once(0.0, 1e4, 100.0, 0.0).speed();
        assert!(single > 0.0 && single < 1e-8, "{single}");
    }

    #[test]
    fn local_balance_is_solved_for_any_step() {
        for (before, heating, collisional, damping, slip) in [
            (1e-3, 0.1, 500.0, 200.0, 1e-4),
            (1e-9, 0.0, 5000.0, 500.0, 1e-3),
            (10.0, 0.0, 10.0, 100.0, 1e-6),
            (1e-3, 1e3, 1.0, 1.0, 0.0),
        ] {
            for dt in [1e-7, 1e-4, 1e-2] {
                let t =
                    EnergyBalance::<f64>::after(before, heating, collisional, damping, slip, dt)
                        .speed()
                        .powi(2);
                let rate = 1.5 * (t - before) / dt;
                let right = heating - collisional * t.powf(1.5) - damping * t + slip / t.sqrt();
                let scale = 1.5 * (t + before) / dt + heating + damping * t + slip / t.sqrt();
                assert!((rate - right).abs() < 1e-6 * scale, "{t}: {rate} {right}");
            }
        }
    }

    #[test]
    fn a_dense_cell_that_collapses_is_not_left_too_warm() {
        // Only collisions: a s⁴ + c s³ = c T s, by bisection, at a √T / c of `stiffness`.
        for stiffness in [1.0, 10.0, 100.0, 1000.0, 1e5] {
            let (before, dt): (f64, f64) = (0.04, 1e-4);
            let collisional = stiffness * 1.5 / dt / before.sqrt();
            let (mut low, mut high) = (0.0, before.sqrt());
            for _ in 0..200 {
                let s: f64 = 0.5 * (low + high);
                let over = collisional * s.powi(3) + 1.5 / dt * (s * s - before) > 0.0;
                if over { high = s } else { low = s }
            }
            let balance = EnergyBalance::<f64>::after(before, 0.0, collisional, 0.0, 0.0, dt);
            let found = balance.speed();
            let error = found / low - 1.0;
            assert!(error.abs() < 1e-9, "{stiffness}: {error:e}");
        }
    }
}
