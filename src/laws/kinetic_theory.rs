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

/// Smallest 1 - (φ/φ_max)^(1/3): caps g0 at 1000 in cells at or past packing, where the packing
/// barrier carries the load.
const CLOSEST: f64 = 1e-3;

/// The kinetic theory of one powder in one gas; holds constants only.
#[derive(Clone, Copy, Debug)]
pub struct KineticTheory<R> {
    density: R,
    max_packing_inverse: R,
    eta: R,
    /// (5/96) ρ_s d √π: dilute viscosity per √T.
    dilute_viscosity: R,
    /// 75 ρ_s d √π / (48 η (41 - 33 η)): dilute conductivity per √T.
    dilute_conductivity: R,
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

impl<R: Real> KineticTheory<R> {
    /// The theory for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        let eta = 0.5 * (1.0 + powder.restitution);
        let sqrt_pi = PI.sqrt();
        let d = powder.diameter;
        Self {
            density: R::of(powder.density),
            max_packing_inverse: R::of(1.0 / powder.max_packing),
            eta: R::of(eta),
            dilute_viscosity: R::of(5.0 / 96.0 * powder.density * d * sqrt_pi),
            dilute_conductivity: R::of(
                75.0 * powder.density * d * sqrt_pi / (48.0 * eta * (41.0 - 33.0 * eta)),
            ),
            collisional: R::of(48.0 / sqrt_pi * eta * (1.0 - eta) / d),
            slip: R::of(
                81.0 * gas.viscosity.powi(2) / (d.powi(3) * powder.density.powi(2) * sqrt_pi),
            ),
        }
    }

    /// (φ/φ_max)^(1/3).
    #[inline(always)]
    fn crowding(&self, solids_fraction: R) -> R {
        // The floor keeps the logarithm finite in empty cells.
        (solids_fraction * self.max_packing_inverse).max(R::of(1e-30)).power(R::of(1.0 / 3.0))
    }

    /// g0 = 1 / (1 - (φ/φ_max)^(1/3)).
    #[inline(always)]
    pub fn radial_distribution(&self, solids_fraction: R) -> R {
        R::ONE / (R::ONE - self.crowding(solids_fraction)).max(R::of(CLOSEST))
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
    /// T {1 + 8 η φ g0 + 4 η φ² g0' + ⅔ a (1 + 4 η φ g0)²}, with g0' = g0² (φ/φ_max)^(1/3) / (3 φ).
    ///
    /// `adiabatic` a is the share of the heat of compression that dissipation leaves: 1 for the
    /// isentropic speed, 0 for the isothermal.
    #[inline(always)]
    pub fn sound_speed_squared(&self, phi: R, g0: R, temperature: R, adiabatic: R) -> R {
        // (φ/φ_max)^(1/3) = 1 - 1/g0.
        let slope = phi * g0 * (g0 - R::ONE) * R::of(1.0 / 3.0);
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
        let Self { eta, density, .. } = *self;
        let speed = temperature.sqrt();
        let g0_inverse = R::ONE / g0;
        let crowd = eta * phi * g0;
        // ρ_s² φ g0 T: μ* = μ X / (X + 2 K μ) has no 0/0 in empty or cold cells.
        let inertia = density * density * phi * g0 * temperature + R::of(1e-30);

        let dilute = self.dilute_viscosity * speed;
        let damped = dilute * inertia / (inertia + R::of(2.0) * drag_per_fraction * dilute);
        let bulk_viscosity = R::of(256.0 / (5.0 * PI)) * dilute * phi * crowd;
        let factor = R::of((2.0 + ALPHA) / 3.0);
        let viscosity = factor
            * (damped * g0_inverse / (eta * (R::of(2.0) - eta))
                * (R::ONE + R::of(1.6) * crowd)
                * (R::ONE + R::of(1.6) * (R::of(3.0) * eta - R::of(2.0)) * crowd)
                + R::of(0.6) * bulk_viscosity);

        let dilute = self.dilute_conductivity * speed;
        let damped = dilute * inertia / (inertia + R::of(1.2) * drag_per_fraction * dilute);
        let conductivity = damped
            * g0_inverse
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
        R::of(3.0) * drag_per_fraction / self.density
    }

    /// Production by slip per solids mass, times √T: Γ_slip √T / (ρ_s φ), where
    /// Γ_slip = 81 φ μ_g² |u_g - u_s|² / (g0 d³ ρ_s √(π T)) (Koch & Sangani 1999) \[m³/s⁴\].
    #[inline(always)]
    pub fn slip_production(&self, g0: R, slip_squared: R) -> R {
        self.slip * slip_squared / g0
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
        let mut s = (c / b).power(R::of(1.0 / 3.0));
        for _ in 0..60 {
            let s2 = s * s;
            s -= ((a * s + b) * s2 * s - c) / ((R::of(4.0) * a * s + R::of(3.0) * b) * s2);
        }
        s * s
    }
}

/// Granular temperature after `dt` from its local balance, all sinks implicit:
///
/// 3/2 (T - `before`)/dt = `heating` - a T^(3/2) - b T + c T^(-1/2)
///
/// with a `collisional`, b `damping`, c `slip`. With s = √T a quartic whose coefficients change
/// sign once, so one positive root; Newton's method from above converges to it monotonically, for
/// any step.
#[inline(always)]
pub fn balance_temperature<R: Real>(
    before: R,
    heating: R,
    collisional: R,
    damping: R,
    slip: R,
    dt: R,
) -> R {
    let rate = R::of(1.5) / dt;
    let cubic = rate + damping;
    let linear = (rate * before + heating).max(R::ZERO);
    // (x + y)³ ≥ x² (x + y) + y³ makes x + y an upper bound of the root; the floor keeps the
    // logarithm finite.
    let y = (slip / cubic).max(R::of(1e-36)).power(R::of(1.0 / 3.0));
    let mut s = (linear / cubic).sqrt() + y;
    for _ in 0..5 {
        let s2 = s * s;
        let value = (collisional * s + cubic) * s2 * s - linear * s - slip;
        let slope = (R::of(4.0) * collisional * s + R::of(3.0) * cubic) * s2 - linear;
        s -= value / slope;
    }
    s * s
}

/// Pressure \[Pa\] that keeps a packing from being overfilled, and its derivative by φ over ρ_s.
///
/// The kinetic pressure dies with the granular temperature, so nothing carries the weight of a
/// cold dense bed. P = B ρ_s x² / (φ_max + 0.012 - φ), x = max(0, φ - φ_max + 0.02), B = 5 m²/s²;
/// past φ_max + 0.009 it goes on with that denominator. Zero, and with zero slope, below
/// φ_max - 0.02.
#[derive(Clone, Copy, Debug)]
pub struct PackingBarrier<R> {
    density: R,
    max_packing: R,
}

impl<R: Real> PackingBarrier<R> {
    /// The barrier of `powder`.
    pub fn new(powder: &Powder) -> Self {
        Self { density: R::of(powder.density), max_packing: R::of(powder.max_packing) }
    }

    /// (P \[Pa\], (dP/dφ)/ρ_s \[m²/s²\]) at φ.
    #[inline(always)]
    pub fn pressure(&self, phi: R) -> (R, R) {
        let stiffness = R::of(5.0);
        let x = (phi - self.max_packing + R::of(0.02)).max(R::ZERO);
        let gap = self.max_packing + R::of(0.012) - phi;
        let inside = gap > R::of(0.003);
        let inverse = R::ONE / gap.max(R::of(0.003));
        let curved = R::select(inside, x * inverse, R::ZERO);
        let kinematic = stiffness * x * x * inverse;
        (self.density * kinematic, stiffness * x * inverse * (R::of(2.0) + curved))
    }
}

#[cfg(test)]
mod tests {
    use super::super::scales::tests::{GAS, POWDER};
    use super::*;

    const PHI: f64 = 0.3;
    const T: f64 = 2e-3;
    const K: f64 = 1e5;

    #[test]
    fn radial_distribution_matches_the_princeton_value() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        assert!((theory.radial_distribution(0.6) - 38.0).abs() < 0.5);
        assert!((theory.radial_distribution(0.0) - 1.0).abs() < 1e-9);
        assert!(theory.radial_distribution(0.7) <= 1000.0);
    }

    #[test]
    fn stress_and_conductivity_agree_with_the_formulae_as_printed() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        let g0 = theory.radial_distribution(PHI);
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
        let g0 = theory.radial_distribution(PHI);
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
            let g0 = theory.radial_distribution(phi);
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
        let p = |phi: f64, t: f64| theory.pressure(phi, theory.radial_distribution(phi), t);
        let h = 1e-6;
        let by_fraction = (p(PHI + h, T) - p(PHI - h, T)) / (2.0 * h) / 1500.0;
        let g0 = theory.radial_distribution(PHI);
        let by_heat = 2.0 / 3.0 * theory.compressibility(PHI, g0).powi(2) * T;
        let found = theory.sound_speed_squared(PHI, g0, T, 1.0);
        assert!((found / (by_fraction + by_heat) - 1.0).abs() < 1e-7);
        let isothermal = theory.sound_speed_squared(PHI, g0, T, 0.0);
        assert!((isothermal / by_fraction - 1.0).abs() < 1e-7);
    }

    #[test]
    fn everything_stays_finite_in_empty_and_cold_cells() {
        let theory = KineticTheory::<f64>::new(&GAS, &POWDER);
        for phi in [0.0, 1e-12] {
            for t in [0.0, 1e-12, 1.0] {
                let g0 = theory.radial_distribution(phi);
                let found = theory.transport(phi, g0, t, K);
                assert!(found.viscosity.is_finite() && found.viscosity >= 0.0);
                assert!(found.conductivity.is_finite() && found.conductivity >= 0.0);
            }
        }
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
                let t: f64 = balance_temperature(before, heating, collisional, damping, slip, dt);
                let rate = 1.5 * (t - before) / dt;
                let right = heating - collisional * t.powf(1.5) - damping * t + slip / t.sqrt();
                let scale = 1.5 * (t + before) / dt + heating + damping * t + slip / t.sqrt();
                assert!((rate - right).abs() < 1e-6 * scale, "{t}: {rate} {right}");
            }
        }
    }

    #[test]
    fn barrier_starts_smoothly_and_its_derivative_is_right() {
        let barrier = PackingBarrier::<f64>::new(&POWDER);
        assert_eq!(barrier.pressure(0.63), (0.0, 0.0));
        let h = 1e-7;
        for phi in [0.64, 0.655, 0.665] {
            let slope = (barrier.pressure(phi + h).0 - barrier.pressure(phi - h).0) / (2.0 * h);
            assert!((barrier.pressure(phi).1 * 1500.0 / slope - 1.0).abs() < 1e-5, "{phi}");
        }
    }
}
