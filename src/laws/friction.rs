//! Friction: what enduring contacts of the particles add to the stress of a dense bed.
//!
//! The solver adds the pressure of a law to the kinetic one, and its viscosity, if it has one, to
//! the kinetic viscosity. [`dilation`], the effect of a change of volume on friction, it leaves out.

use super::scales::Powder;
use crate::real::Real;

/// A frictional pressure.
pub trait Friction<R: Real>: Copy + Send + Sync {
    /// (P \[Pa\], (dP/dφ)/ρ_s \[m²/s²\]) at φ; both finite at any φ, P continuous.
    fn pressure(&self, solids_fraction: R) -> (R, R);

    /// Whether it has a viscosity.
    const VISCOUS: bool = false;

    /// Viscosity \[Pa·s\] at φ, granular temperature T \[m²/s²\] and I₂ = ½ S:S, S the deviatoric rate
    /// of strain \[1/s²\]; at most [`MOST_VISCOSITY`].
    #[inline(always)]
    fn viscosity(&self, _solids_fraction: R, _temperature: R, _second_invariant: R) -> R {
        R::ZERO
    }
}

/// sin Φ of the angle of internal friction Φ = 28.5° \[-\].
pub const SINE: f64 = 0.477_158_760_259_608_4;

/// Largest frictional viscosity \[Pa·s\], where nothing is sheared.
pub const MOST_VISCOSITY: f64 = 100.0;

/// No friction: only the kinetic pressure carries a dense bed.
#[derive(Clone, Copy, Debug)]
pub struct Frictionless;

impl<R: Real> Friction<R> for Frictionless {
    #[inline(always)]
    fn pressure(&self, _: R) -> (R, R) {
        (R::ZERO, R::ZERO)
    }
}

/// Pressure that keeps a packing from being overfilled, and does nothing else.
///
/// The kinetic pressure dies with the granular temperature, so nothing carries the weight of a
/// cold dense bed. P = B ρ_s x² / (φ_max + 0.012 - φ), x = max(0, φ - φ_max + 0.02), B = 105 u_t²: what
/// falls on a bed is some u_t fast, of whatever powder;
/// past φ_max + 0.009 it goes on with that denominator. Zero, and with zero slope, below
/// φ_max - 0.02.
#[derive(Clone, Copy, Debug)]
pub struct PackingBarrier<R> {
    density: R,
    max_packing: R,
    stiffness: R,
}

/// B of [`PackingBarrier`] over u_t².
const BARRIER: f64 = 105.0;

impl<R: Real> PackingBarrier<R> {
    /// The barrier of `powder`, whose single particle falls at `terminal_velocity` \[m/s\].
    pub fn new(powder: &Powder, terminal_velocity: f64) -> Self {
        Self {
            density: R::of(powder.density),
            max_packing: R::of(powder.max_packing),
            stiffness: R::of(BARRIER * terminal_velocity.powi(2)),
        }
    }
}

impl<R: Real> Friction<R> for PackingBarrier<R> {
    #[inline(always)]
    fn pressure(&self, phi: R) -> (R, R) {
        let stiffness = self.stiffness;
        let x = (phi - self.max_packing + R::of(0.02)).max(R::ZERO);
        let gap = self.max_packing + R::of(0.012) - phi;
        let inside = gap > R::of(0.003);
        let inverse = R::ONE / gap.max(R::of(0.003));
        let curved = R::select(inside, x * inverse, R::ZERO);
        let kinematic = stiffness * x * x * inverse;
        (self.density * kinematic, stiffness * x * inverse * (R::of(2.0) + curved))
    }
}

/// Schaeffer (1987, J. Differ. Equ. 66:19) with the pressure of Syamlal, Rogers & O'Brien (1993):
/// P = 10²⁴ Pa (φ - φ_max)¹⁰ above φ_max, zero below. Past φ_max + 0.01, where P is 10 kPa, it goes
/// on along its tangent.
#[derive(Clone, Copy, Debug)]
pub struct Schaeffer<R> {
    max_packing: R,
    inverse_density: R,
}

/// Excess of φ over packing at which Schaeffer's pressure, 10 kPa, becomes straight.
const SCHAEFFER_STRAIGHT: f64 = 0.01;

impl<R: Real> Schaeffer<R> {
    /// The friction of `powder`.
    pub fn new(powder: &Powder) -> Self {
        Self {
            max_packing: R::of(powder.max_packing),
            inverse_density: R::of(1.0 / powder.density),
        }
    }
}

impl<R: Real> Friction<R> for Schaeffer<R> {
    #[inline(always)]
    fn pressure(&self, phi: R) -> (R, R) {
        let excess = (phi - self.max_packing).max(R::ZERO);
        let curved = excess.min(R::of(SCHAEFFER_STRAIGHT));
        let x = curved * R::of(1.0 / SCHAEFFER_STRAIGHT);
        let x2 = x * x;
        let x4 = x2 * x2;
        let ninth = x4 * x4 * x;
        // 10²⁴ · 0.01¹⁰ = 10⁴.
        let slope = R::of(10.0 * 1e4 / SCHAEFFER_STRAIGHT) * ninth;
        let pressure = R::of(1e4) * ninth * x + slope * (excess - curved);
        (pressure, slope * self.inverse_density)
    }

    const VISCOUS: bool = true;

    #[inline(always)]
    fn viscosity(&self, phi: R, _: R, second_invariant: R) -> R {
        coulomb_viscosity(self.pressure(phi).0, R::of(SINE), second_invariant)
    }
}

/// P = Fr (φ - φ_min)² / (φ_max - φ)⁵ up to some φ, along its tangent from there on: the pressure
/// of [`JohnsonJackson`] and of [`SrivastavaSundaresan`].
#[derive(Clone, Copy, Debug)]
struct Yield<R> {
    onset: R,
    max_packing: R,
    /// φ from which on the pressure is straight.
    straight: R,
    inverse_density: R,
}

/// Fr \[Pa\] of Johnson, Nott & Jackson (1990).
const FR: f64 = 0.05;

/// φ_min \[-\], but no nearer to the packing than this.
const ONSET: (f64, f64) = (0.5, 0.1);

impl<R: Real> Yield<R> {
    fn new(powder: &Powder, straight: f64) -> Self {
        Self {
            onset: R::of(ONSET.0.min(powder.max_packing - ONSET.1)),
            max_packing: R::of(powder.max_packing),
            straight: R::of(powder.max_packing - straight),
            inverse_density: R::of(1.0 / powder.density),
        }
    }

    #[inline(always)]
    fn pressure(&self, phi: R) -> (R, R) {
        let curved = phi.min(self.straight);
        let excess = (curved - self.onset).max(R::ZERO);
        let inverse = R::ONE / (self.max_packing - curved);
        let inverse2 = inverse * inverse;
        let steep = R::of(FR) * excess * inverse2 * inverse2 * inverse;
        let slope = steep * (R::of(2.0) + R::of(5.0) * excess * inverse);
        let pressure = steep * excess + slope * (phi - curved);
        (pressure, slope * self.inverse_density)
    }
}

/// Johnson & Jackson (1987, J. Fluid Mech. 176:67) with the constants of Johnson, Nott & Jackson
/// (1990): P = Fr (φ - φ_min)² / (φ_max - φ)⁵, Fr = 0.05 Pa, φ_min = 0.5. Past φ_max - 0.05, where
/// common codes stop the denominator, it goes on along its tangent.
#[derive(Clone, Copy, Debug)]
pub struct JohnsonJackson<R>(Yield<R>);

impl<R: Real> JohnsonJackson<R> {
    /// The friction of `powder`. Where φ_max is below 0.6, φ_min is φ_max - 0.1.
    pub fn new(powder: &Powder) -> Self {
        Self(Yield::new(powder, 0.05))
    }
}

impl<R: Real> Friction<R> for JohnsonJackson<R> {
    #[inline(always)]
    fn pressure(&self, phi: R) -> (R, R) {
        self.0.pressure(phi)
    }

    const VISCOUS: bool = true;

    #[inline(always)]
    fn viscosity(&self, phi: R, _: R, second_invariant: R) -> R {
        coulomb_viscosity(self.pressure(phi).0, R::of(SINE), second_invariant)
    }
}

/// Srivastava & Sundaresan (2003, Powder Technol. 129:72) in the critical state, that is without
/// the effect of dilation ([`dilation`]): the pressure of [`JohnsonJackson`], followed on to
/// φ_max - 0.03. There it is 30 kPa, the weight of two metres of sand; nearer to the packing only
/// its speed of sound would grow. Its viscosity √2 P sin Φ / (2 ζ), ζ² = S:S + T/d², is Coulomb's
/// with the fluctuations of the particles added to the rate of strain.
#[derive(Clone, Copy, Debug)]
pub struct SrivastavaSundaresan<R> {
    state: Yield<R>,
    /// 1/(2 d²) \[1/m²\].
    fluctuation: R,
}

impl<R: Real> SrivastavaSundaresan<R> {
    /// The friction of `powder`. Where φ_max is below 0.6, φ_min is φ_max - 0.1.
    pub fn new(powder: &Powder) -> Self {
        Self { state: Yield::new(powder, 0.03), fluctuation: R::of(0.5 / powder.diameter.powi(2)) }
    }
}

impl<R: Real> Friction<R> for SrivastavaSundaresan<R> {
    #[inline(always)]
    fn pressure(&self, phi: R) -> (R, R) {
        self.state.pressure(phi)
    }

    const VISCOUS: bool = true;

    #[inline(always)]
    fn viscosity(&self, phi: R, temperature: R, second_invariant: R) -> R {
        let rate = second_invariant + self.fluctuation * temperature;
        coulomb_viscosity(self.pressure(phi).0, R::of(SINE), rate)
    }
}

/// Frictional viscosity \[Pa·s\] of a Coulomb material (Schaeffer 1987; also Johnson & Jackson's in
/// common codes): μ = P sin Φ / (2 √I₂), at most [`MOST_VISCOSITY`], with I₂ = ½ S:S, S the deviatoric rate
/// of strain \[1/s²\], and Φ the angle of internal friction, about 28.5°.
#[inline(always)]
pub fn coulomb_viscosity<R: Real>(pressure: R, sine: R, second_invariant: R) -> R {
    let most = R::of(MOST_VISCOSITY);
    // A denominator that cannot vanish, chosen so that the bound is met exactly.
    let shear = pressure * sine;
    let floor = shear / most + R::of(1e-30);
    shear / (R::of(2.0) * second_invariant.sqrt()).max(floor)
}

/// Frictional pressure over its critical-state value, and frictional viscosity \[Pa·s\], of
/// Srivastava & Sundaresan (2003):
///
/// - P/P_c = x^(n-1), x = max(0, 1 - ∇·u / (n √2 sin Φ ζ)),
/// - μ = √2 P sin Φ (n - (n-1) x) / (2 ζ),
///
/// with ζ = √(S:S + T/d²), S the deviatoric rate of strain, n = √3/(2 sin Φ) where the solids
/// expand and 1.03 where they contract. `critical_pressure` is P_c \[Pa\], `divergence` ∇·u \[1/s\],
/// `rate` ζ \[1/s\], above zero.
#[inline(always)]
pub fn dilation<R: Real>(critical_pressure: R, sine: R, divergence: R, rate: R) -> (R, R) {
    let expands = divergence >= R::ZERO;
    let n = R::select(expands, R::of(0.75f64.sqrt()) / sine, R::of(1.03));
    let root = R::of(std::f64::consts::SQRT_2) * sine;
    let x = (R::ONE - divergence / (n * root * rate)).max(R::ZERO);
    // The floor keeps the logarithm finite where the solids have come apart.
    let ratio = x.max(R::of(1e-30)).power(n - R::ONE);
    let ratio = R::select(x > R::ZERO, ratio, R::ZERO);
    let viscosity = root * critical_pressure * ratio * (n - (n - R::ONE) * x) / (R::of(2.0) * rate);
    (ratio, viscosity)
}

#[cfg(test)]
mod tests {
    use super::super::scales::tests::POWDER;
    use super::*;

    /// A terminal velocity \[m/s\].
    const U_T: f64 = 0.2;

    /// Slope over ρ_s is the derivative, the pressure has no jump, and both precisions agree.
    fn check(law: impl Friction<f64>, single: impl Friction<f32>) {
        let mut last = 0.0;
        for n in 0..=7000 {
            // Between the places where a law changes its form.
            let phi = 1e-4 * (f64::from(n) + 0.5);
            let (pressure, stiffness) = law.pressure(phi);
            assert!(pressure >= last && stiffness >= 0.0, "{phi}: {pressure} after {last}");
            assert!(pressure.is_finite() && stiffness.is_finite(), "{phi}");
            last = pressure;
            let h = 1e-8;
            let slope = (law.pressure(phi + h).0 - law.pressure(phi - h).0) / (2.0 * h) / 1500.0;
            let error = (stiffness - slope).abs();
            assert!(error <= 1e-4 * slope + 1e-6 * pressure + 1e-6, "{phi}: {stiffness} {slope}");
            let rounded = f64::from(single.pressure(phi as f32).0);
            // A bit of φ moves the pressure by its slope.
            let bit = 1.2e-7 * 1500.0 * law.pressure(phi + 1e-6).1;
            assert!((rounded - pressure).abs() <= 2.0 * bit + 1e-4 * pressure + 1e-12, "{phi}");
        }
        assert_eq!(law.pressure(0.45), (0.0, 0.0));
        assert!(last > 1e3, "{last}");
    }

    #[test]
    fn pressures_have_the_slopes_they_say_and_no_jump() {
        check(PackingBarrier::new(&POWDER, U_T), PackingBarrier::new(&POWDER, U_T));
        check(Schaeffer::new(&POWDER), Schaeffer::new(&POWDER));
        check(JohnsonJackson::new(&POWDER), JohnsonJackson::new(&POWDER));
        check(SrivastavaSundaresan::new(&POWDER), SrivastavaSundaresan::new(&POWDER));
        let (pressure, stiffness): (f64, f64) = Frictionless.pressure(0.65);
        assert_eq!((pressure, stiffness), (0.0, 0.0));
    }

    #[test]
    fn barrier_starts_at_two_per_cent_below_packing() {
        let barrier = PackingBarrier::<f64>::new(&POWDER, U_T);
        assert_eq!(barrier.pressure(0.63), (0.0, 0.0));
        // 105 · 0.2² · 1500 · 0.02² / 0.012.
        assert!((barrier.pressure(0.65).0 - 210.0).abs() < 1e-9);
    }

    #[test]
    fn pressures_agree_with_the_formulae_as_printed() {
        for excess in [0.002, 0.008, 0.01] {
            let found = Schaeffer::<f64>::new(&POWDER).pressure(0.65 + excess).0;
            assert!((found / (1e24 * f64::powi(excess, 10)) - 1.0).abs() < 1e-9, "{excess}");
        }
        for (phi, reaches) in [(0.52, true), (0.59, true), (0.62, false)] {
            let printed = 0.05 * f64::powi(phi - 0.5, 2) / f64::powi(0.65 - phi, 5);
            let near = JohnsonJackson::<f64>::new(&POWDER).pressure(phi).0;
            let far = SrivastavaSundaresan::<f64>::new(&POWDER).pressure(phi).0;
            assert!((far / printed - 1.0).abs() < 1e-9, "{phi}");
            assert_eq!((near / printed - 1.0).abs() < 1e-9, reaches, "{phi}");
        }
        // A packing looser than usual keeps the onset below it.
        let loose = Powder { max_packing: 0.45, ..POWDER };
        let law = JohnsonJackson::<f64>::new(&loose);
        assert_eq!(law.pressure(0.35).0, 0.0);
        assert!(law.pressure(0.4).0 > 0.0 && law.pressure(0.45).1.is_finite());
    }

    #[test]
    fn coulombs_stress_is_the_normal_stress_times_the_sine() {
        // Simple shear at rate γ: I₂ = γ²/4, and the shear stress is μ γ.
        for rate in [0.1, 3.0, 200.0] {
            let stress = coulomb_viscosity(10.0, SINE, 0.25 * rate * rate) * rate;
            assert!((stress - 10.0 * SINE).abs() < 1e-12);
        }
        assert!((coulomb_viscosity(500.0, SINE, 0.0) - 100.0).abs() < 1e-9);
        assert_eq!(coulomb_viscosity(0.0, SINE, 0.0), 0.0);
    }

    #[test]
    fn viscosities_are_those_of_the_formulae_as_printed() {
        assert!((SINE - 28.5f64.to_radians().sin()).abs() < 1e-15);
        // Simple shear at 50 /s: S:S = 1250 /s², I₂ = 625 /s².
        let (phi, t, square) = (0.58, 4e-7, 625.0);
        let printed = 0.05 * f64::powi(phi - 0.5, 2) / f64::powi(0.65 - phi, 5);
        let found = JohnsonJackson::<f64>::new(&POWDER).viscosity(phi, t, square);
        assert!((found / (printed * SINE / 50.0) - 1.0).abs() < 1e-9);
        let zeta = (1250.0 + t / f64::powi(75e-6, 2)).sqrt();
        let found = SrivastavaSundaresan::<f64>::new(&POWDER).viscosity(phi, t, square);
        assert!((found / (2f64.sqrt() * printed * SINE / (2.0 * zeta)) - 1.0).abs() < 1e-9);
        // And what `dilation` says of no dilation.
        assert!((found / dilation(printed, SINE, 0.0, zeta).1 - 1.0).abs() < 1e-9);
        let found = Schaeffer::<f64>::new(&POWDER).viscosity(0.656, t, square);
        assert!((found / (1e24 * f64::powi(0.006, 10) * SINE / 50.0) - 1.0).abs() < 1e-9);
        assert_eq!(Schaeffer::<f64>::new(&POWDER).viscosity(0.64, t, square), 0.0);
        assert_eq!(PackingBarrier::<f64>::new(&POWDER, U_T).viscosity(0.65, t, square), 0.0);
    }

    #[test]
    fn dilation_leaves_the_critical_state_alone_and_loosens_what_expands() {
        let (ratio, viscosity) = dilation(100.0, SINE, 0.0, 8.0);
        assert!((ratio - 1.0).abs() < 1e-15);
        // S:S = 2 I₂, so without temperature it is Coulomb's.
        assert!((viscosity / coulomb_viscosity(100.0, SINE, 32.0) - 1.0).abs() < 1e-12);

        let n = 3f64.sqrt() / (2.0 * SINE);
        let (ratio, viscosity) = dilation(100.0, SINE, 2.0, 8.0);
        let x = 1.0 - 2.0 / (n * 2f64.sqrt() * SINE * 8.0);
        assert!((ratio - x.powf(n - 1.0)).abs() < 1e-13);
        let chi =
            2f64.sqrt() * 100.0 * ratio * SINE * (n - (n - 1.0) * ratio.powf(1.0 / (n - 1.0)));
        assert!((viscosity / (chi / 16.0) - 1.0).abs() < 1e-12);

        let (ratio, _) = dilation(100.0, SINE, -2.0, 8.0);
        assert!(ratio > 1.0 && ratio < 1.05, "{ratio}");
        assert_eq!(dilation(100.0, SINE, 1e3, 8.0), (0.0, 0.0));
    }
}
