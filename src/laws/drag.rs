//! Fine-grid gas-solids drag.
//!
//! Every law here is the β of model A: the mean pressure gradient pushes each phase by its volume
//! fraction, apart from the drag. Of a published force the normalisation (by 3π μ_g d times which
//! velocity), the Reynolds number and whether it includes that push are stated with the law.

use super::scales::{Gas, Powder};
use crate::real::Real;

/// A fine-grid drag law: force on the solids per volume = β (u_g - u_s).
pub trait DragLaw<R: Real>: Send + Sync {
    /// β/φ \[kg/m³/s\] at solids fraction φ and slip speed |u_g - u_s| \[m/s\]; finite at φ → 0 and at
    /// zero slip.
    #[inline(always)]
    fn beta_per_fraction(&self, solids_fraction: R, slip_speed: R) -> R {
        let begun = self.begin(solids_fraction, slip_speed);
        self.finish(solids_fraction, slip_speed, begun)
    }

    /// The first half of the work on [`DragLaw::beta_per_fraction`], such as logarithms: who has many places
    /// to find β at does well to begin them all before finishing the first, because each half is long.
    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2];

    /// The other half: β/φ from what [`DragLaw::begin`] gave for the same fraction and speed.
    fn finish(&self, solids_fraction: R, slip_speed: R, begun: [R; 2]) -> R;

    /// β \[kg/m³/s\].
    #[inline(always)]
    fn beta(&self, solids_fraction: R, slip_speed: R) -> R {
        solids_fraction * self.beta_per_fraction(solids_fraction, slip_speed)
    }

    /// β \[kg/m³/s\] at many places: a law chosen at run time costs one call for all of them.
    fn betas(&self, betas: &mut [R], solids_fractions: &[R], slip_speeds: &[R]) {
        for ((beta, &phi), &speed) in betas.iter_mut().zip(solids_fractions).zip(slip_speeds) {
            *beta = self.beta(phi, speed);
        }
    }
}

impl<R: Real, L: DragLaw<R> + ?Sized> DragLaw<R> for Box<L> {
    fn beta_per_fraction(&self, solids_fraction: R, slip_speed: R) -> R {
        (**self).beta_per_fraction(solids_fraction, slip_speed)
    }

    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2] {
        (**self).begin(solids_fraction, slip_speed)
    }

    fn finish(&self, solids_fraction: R, slip_speed: R, begun: [R; 2]) -> R {
        (**self).finish(solids_fraction, slip_speed, begun)
    }

    fn betas(&self, betas: &mut [R], solids_fractions: &[R], slip_speeds: &[R]) {
        (**self).betas(betas, solids_fractions, slip_speeds);
    }
}

/// Drag on one sphere of a mixture of diameters, from a law of equal spheres of a reference diameter.
pub trait SphereDrag: Send + Sync {
    /// β/φ of a sphere whose diameter is `ratio` times that of reference \[kg/m³/s\]: the force on it over its
    /// volume and its slip.
    fn of_sphere(&self, solids_fraction: f64, slip_speed: f64, ratio: f64) -> f64;
}

/// The law of equal spheres of the sphere's own diameter.
///
/// Every law here is μ_g/d² times a function of φ and ρ_g d |u|/μ_g, so that with y = d_i/d
/// β_i(φ, |u|) = β(φ, y |u|)/y².
#[derive(Clone, Copy, Debug)]
pub struct OwnDiameter<L>(pub L);

impl<L: DragLaw<f64>> SphereDrag for OwnDiameter<L> {
    #[inline(always)]
    fn of_sphere(&self, solids_fraction: f64, slip_speed: f64, ratio: f64) -> f64 {
        self.0.beta_per_fraction(solids_fraction, ratio * slip_speed) / (ratio * ratio)
    }
}

/// Van der Hoef, Beetstra & Kuipers (2005, J. Fluid Mech. 528:233) and Beetstra et al. (2007), of
/// lattice-Boltzmann simulations of mixtures of two diameters with ratios up to 4: the drag on a sphere,
/// over 3π μ_g d_i (1-φ) |u|, is y_i = d_i/⟨d⟩ times that on equal spheres of the Sauter mean diameter ⟨d⟩,
/// which is that of reference; so that β_i(φ, |u|) = β(φ, |u|)/y_i. All spheres of one velocity then take the
/// drag of equal ones.
///
/// As in MFIX for model A, by the erratum of 2007: of the published (1-φ) y + φ y² (+ 0.064 (1-φ) y³, which is
/// not 1 at y = 1), the force with the push of the mean pressure gradient, the second is that push.
#[derive(Clone, Copy, Debug)]
pub struct VanDerHoef<L>(pub L);

impl<L: DragLaw<f64>> SphereDrag for VanDerHoef<L> {
    #[inline(always)]
    fn of_sphere(&self, solids_fraction: f64, slip_speed: f64, ratio: f64) -> f64 {
        self.0.beta_per_fraction(solids_fraction, slip_speed) / ratio
    }
}

/// Smallest Reynolds number that a logarithm is taken of; a term in it is below 1e-19 there.
const SMALLEST_REYNOLDS: f64 = 1e-30;

/// log₂ Re, finite at rest.
#[inline(always)]
fn log_reynolds<R: Real>(reynolds: R) -> R {
    reynolds.max(R::of(SMALLEST_REYNOLDS)).log2()
}

/// C_D Re of one sphere after Schiller & Naumann (1933): 24 + 3.6 Re^0.687 below Re = 1000,
/// 0.44 Re above; of Re and [`log_reynolds`]. Finite at rest.
#[inline(always)]
fn sphere_drag<R: Real>(reynolds: R, logarithm: R) -> R {
    let power = (R::of(0.687) * logarithm).exp2();
    R::select(reynolds < R::of(1000.0), R::of(24.0) + R::of(3.6) * power, R::of(0.44) * reynolds)
}

/// Wen & Yu (1966): β = ¾ C_D ρ_g φ (1-φ) |u| / d · (1-φ)^-2.65, with Re = (1-φ) ρ_g d |u| / μ_g
/// and C_D = 24/Re (1 + 0.15 Re^0.687) below Re = 1000, 0.44 above.
///
/// Written with C_D Re, which has no 0/0 at rest: β/φ = ¾ (C_D Re) μ_g / d² · (1-φ)^-2.65.
#[derive(Clone, Copy, Debug)]
pub struct WenYu<R> {
    /// ρ_g d / μ_g \[s/m\].
    reynolds_per_speed: R,
    /// ¾ μ_g / d² \[kg/m³/s\].
    stokes: R,
}

impl<R: Real> WenYu<R> {
    /// Re at (1-φ) and |u|.
    #[inline(always)]
    fn reynolds(&self, gas_fraction: R, slip_speed: R) -> R {
        gas_fraction * self.reynolds_per_speed * slip_speed
    }

    /// The law for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        Self {
            reynolds_per_speed: R::of(gas.density * powder.diameter / gas.viscosity),
            stokes: R::of(0.75 * gas.viscosity / powder.diameter.powi(2)),
        }
    }
}

impl<R: Real> DragLaw<R> for WenYu<R> {
    #[inline(always)]
    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2] {
        let gas_fraction = R::ONE - solids_fraction;
        [log_reynolds(self.reynolds(gas_fraction, slip_speed)), gas_fraction.log2()]
    }

    #[inline(always)]
    fn finish(&self, solids_fraction: R, slip_speed: R, [reynolds, gas]: [R; 2]) -> R {
        let number = self.reynolds(R::ONE - solids_fraction, slip_speed);
        self.stokes * sphere_drag(number, reynolds) * (R::of(-2.65) * gas).exp2()
    }
}

/// Gidaspow (1994): Ergun (1952), β = 150 φ² μ_g / ((1-φ) d²) + 1.75 ρ_g φ |u| / d, where the gas
/// fraction is below 0.8, and [`WenYu`] elsewhere.
///
/// β jumps at φ = 0.2, as published: upwards by 15 % in creeping flow, by a factor of 3.67 far above
/// Re = 1000.
#[derive(Clone, Copy, Debug)]
pub struct Gidaspow<R> {
    dilute: WenYu<R>,
    /// 150 μ_g / d² \[kg/m³/s\].
    viscous: R,
    /// 1.75 ρ_g / d \[kg/m⁴\].
    inertial: R,
}

impl<R: Real> Gidaspow<R> {
    /// The law for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        Self {
            dilute: WenYu::new(gas, powder),
            viscous: R::of(150.0 * gas.viscosity / powder.diameter.powi(2)),
            inertial: R::of(1.75 * gas.density / powder.diameter),
        }
    }
}

impl<R: Real> DragLaw<R> for Gidaspow<R> {
    #[inline(always)]
    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2] {
        self.dilute.begin(solids_fraction, slip_speed)
    }

    #[inline(always)]
    fn finish(&self, solids_fraction: R, slip_speed: R, begun: [R; 2]) -> R {
        let gas_fraction = R::ONE - solids_fraction;
        R::select(
            gas_fraction < R::of(0.8),
            self.viscous * solids_fraction / gas_fraction + self.inertial * slip_speed,
            self.dilute.finish(solids_fraction, slip_speed, begun),
        )
    }
}

/// Beetstra, van der Hoef & Kuipers (2007, AIChE J. 53:489), monodisperse, from lattice-Boltzmann
/// simulations of fixed beds with 0.1 ≤ φ ≤ 0.6 and Re ≤ 1000, Re = (1-φ) ρ_g d |u| / μ_g.
///
/// The force on a sphere without the push of the mean pressure gradient, over 3π μ_g d (1-φ) |u|:
///
/// F = 10 φ/(1-φ)² + (1-φ)² (1 + 1.5 √φ)
///   + 0.413 Re / (24 (1-φ)²) · \[1/(1-φ) + 3 φ (1-φ) + 8.4 Re^-0.343\]
///     / \[1 + 10^(3φ) Re^(-(1+4φ)/2)\]
///
/// so that β = 18 μ_g φ (1-φ) F / d².
#[derive(Clone, Copy, Debug)]
pub struct Beetstra<R> {
    /// ρ_g d / μ_g \[s/m\].
    reynolds_per_speed: R,
    /// 18 μ_g / d² \[kg/m³/s\].
    stokes: R,
}

impl<R: Real> Beetstra<R> {
    /// The law for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        Self {
            reynolds_per_speed: R::of(gas.density * powder.diameter / gas.viscosity),
            stokes: R::of(18.0 * gas.viscosity / powder.diameter.powi(2)),
        }
    }
}

impl<R: Real> DragLaw<R> for Beetstra<R> {
    #[inline(always)]
    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2] {
        let reynolds = (R::ONE - solids_fraction) * self.reynolds_per_speed * slip_speed;
        let onset = (R::of(3.0 * std::f64::consts::LOG2_10) * solids_fraction).exp2();
        [log_reynolds(reynolds), onset]
    }

    #[inline(always)]
    fn finish(&self, solids_fraction: R, slip_speed: R, [logarithm, onset]: [R; 2]) -> R {
        let phi = solids_fraction;
        let gas_fraction = R::ONE - phi;
        let inverse = R::ONE / gas_fraction;
        let reynolds = gas_fraction * self.reynolds_per_speed * slip_speed;
        // The bracket times Re, and the fraction expanded by Re^((1+4φ)/2): finite at rest.
        let bracket = reynolds * (inverse + R::of(3.0) * phi * gas_fraction)
            + R::of(8.4) * (R::of(1.0 - 0.343) * logarithm).exp2();
        let power = ((R::of(0.5) + R::of(2.0) * phi) * logarithm).exp2();
        let inertial = R::of(0.413 / 24.0) * inverse * inverse * bracket * power / (power + onset);
        let viscous = R::of(10.0) * phi * inverse * inverse
            + gas_fraction * gas_fraction * (R::ONE + R::of(1.5) * phi.sqrt());
        self.stokes * gas_fraction * (viscous + inertial)
    }
}

/// Tenneti, Garg & Subramaniam (2011, Int. J. Multiphase Flow 37:1072), from immersed-boundary
/// simulations of fixed beds with 0.1 ≤ φ ≤ 0.5 and Re ≤ 300, Re = (1-φ) ρ_g d |u| / μ_g.
///
/// The force on a sphere including the push of the mean pressure gradient, over
/// 3π μ_g d (1-φ) |u|:
///
/// F = F_0(Re)/(1-φ)³ + 5.81 φ/(1-φ)³ + 0.48 φ^(1/3)/(1-φ)⁴
///   + φ³ Re \[0.95 + 0.61 φ³/(1-φ)²\]
///
/// with F_0 = C_D Re / 24 of one sphere (Schiller & Naumann). Without that push it is (1-φ) F, so
/// that β = 18 μ_g φ (1-φ)² F / d².
#[derive(Clone, Copy, Debug)]
pub struct Tenneti<R> {
    /// ρ_g d / μ_g \[s/m\].
    reynolds_per_speed: R,
    /// 18 μ_g / d² \[kg/m³/s\].
    stokes: R,
}

impl<R: Real> Tenneti<R> {
    /// The law for `powder` in `gas`.
    pub fn new(gas: &Gas, powder: &Powder) -> Self {
        let Beetstra { reynolds_per_speed, stokes } = Beetstra::new(gas, powder);
        Self { reynolds_per_speed, stokes }
    }
}

impl<R: Real> DragLaw<R> for Tenneti<R> {
    #[inline(always)]
    fn begin(&self, solids_fraction: R, slip_speed: R) -> [R; 2] {
        let reynolds = (R::ONE - solids_fraction) * self.reynolds_per_speed * slip_speed;
        // The floor keeps the root finite in empty cells; its term is 5e-11 there.
        [log_reynolds(reynolds), solids_fraction.max(R::of(1e-30)).cbrt()]
    }

    #[inline(always)]
    fn finish(&self, solids_fraction: R, slip_speed: R, [logarithm, root]: [R; 2]) -> R {
        let phi = solids_fraction;
        let gas_fraction = R::ONE - phi;
        let inverse = R::ONE / gas_fraction;
        let reynolds = gas_fraction * self.reynolds_per_speed * slip_speed;
        let isolated = R::of(1.0 / 24.0) * sphere_drag(reynolds, logarithm);
        let cube = phi * phi * phi;
        // (1-φ)² F.
        let force = inverse * (isolated + R::of(5.81) * phi)
            + R::of(0.48) * root * inverse * inverse
            + cube * reynolds * (R::of(0.95) * gas_fraction * gas_fraction + R::of(0.61) * cube);
        self.stokes * force
    }
}

#[cfg(test)]
mod tests {
    use super::super::scales::tests::{GAS, POWDER};
    use super::*;

    #[test]
    fn wen_yu_agrees_with_its_formula_as_printed() {
        let law = WenYu::<f64>::new(&GAS, &POWDER);
        for (phi, u) in [(0.05, 0.2), (0.3, 1.0), (0.55, 0.01), (0.01, 500.0)] {
            let eg: f64 = 1.0 - phi;
            let re = eg * GAS.density * POWDER.diameter * u / GAS.viscosity;
            let cd = if re < 1000.0 { 24.0 / re * (1.0 + 0.15 * re.powf(0.687)) } else { 0.44 };
            let printed = 0.75 * cd * GAS.density * phi * eg * u / POWDER.diameter * eg.powf(-2.65);
            assert!((law.beta(phi, u) / printed - 1.0).abs() < 1e-13, "phi {phi}, u {u}");
        }
    }

    /// Every law in `R`, its name first.
    fn laws<R: Real>() -> [(&'static str, Box<dyn DragLaw<R>>); 4] {
        laws_of(&POWDER)
    }

    fn laws_of<R: Real>(powder: &Powder) -> [(&'static str, Box<dyn DragLaw<R>>); 4] {
        [
            ("Wen-Yu", Box::new(WenYu::new(&GAS, powder))),
            ("Gidaspow", Box::new(Gidaspow::new(&GAS, powder))),
            ("Beetstra", Box::new(Beetstra::new(&GAS, powder))),
            ("Tenneti", Box::new(Tenneti::new(&GAS, powder))),
        ]
    }

    /// 18 μ_g / d².
    const STOKES: f64 = 18.0 * 1.8e-5 / (75e-6 * 75e-6);

    /// |u| at a Reynolds number (1-φ) ρ_g d |u| / μ_g.
    fn speed(phi: f64, reynolds: f64) -> f64 {
        reynolds * GAS.viscosity / ((1.0 - phi) * GAS.density * POWDER.diameter)
    }

    #[test]
    fn every_law_tends_to_stokes_and_is_finite_where_cells_are_empty_or_at_rest() {
        for ((name, law), (_, single)) in laws::<f64>().into_iter().zip(laws::<f32>()) {
            let alone = law.beta_per_fraction(0.0, 0.0) / STOKES;
            assert!((alone - 1.0).abs() < 1e-9, "{name}: {alone}");
            assert!((f64::from(single.beta_per_fraction(0.0, 0.0)) / STOKES - 1.0).abs() < 1e-6);
            for phi in [0.0, 1e-30, 1e-9, 0.1, 0.3, 0.65, 0.7] {
                for u in [0.0, 1e-30, 1e-9, 1e-3, 1.0, 1e4] {
                    let beta = law.beta_per_fraction(phi, u);
                    assert!(beta.is_finite() && beta > 0.99 * STOKES, "{name} {phi} {u}: {beta}");
                    let rounded = single.beta_per_fraction(phi as f32, u as f32);
                    let error = f64::from(rounded) / beta - 1.0;
                    assert!(error.abs() < 2e-5, "{name} {phi} {u}: {error}");
                }
            }
        }
    }

    #[test]
    fn every_law_is_continuous_where_it_says_so() {
        for (name, law) in laws::<f64>() {
            for phi in [0.05, 0.2, 0.4, 0.6] {
                let at = |phi, reynolds| law.beta_per_fraction(phi, speed(phi, reynolds));
                for reynolds in [1e-3, 1.0, 100.0] {
                    let jump = at(phi + 1e-9, reynolds) / at(phi - 1e-9, reynolds) - 1.0;
                    let documented = name == "Gidaspow" && phi == 0.2;
                    assert!(documented || jump.abs() < 1e-6, "{name} {phi} {reynolds}: {jump}");
                }
                // Schiller and Naumann's branches differ by 0.4 % at Re = 1000.
                let jump = at(phi, 1000.0 + 1e-6) / at(phi, 1000.0 - 1e-6) - 1.0;
                assert!(jump.abs() < 5e-3, "{name} {phi}: {jump}");
            }
        }
    }

    #[test]
    fn gidaspow_is_ergun_above_one_fifth_and_jumps_there_as_documented() {
        let law = Gidaspow::<f64>::new(&GAS, &POWDER);
        let (mu, rho, d) = (GAS.viscosity, GAS.density, POWDER.diameter);
        for (phi, u) in [(0.21, 0.1), (0.4, 2.0), (0.6, 0.01)] {
            let ergun: f64 =
                150.0 * phi * phi * mu / ((1.0 - phi) * d * d) + 1.75 * rho * phi * u / d;
            assert!((law.beta(phi, u) / ergun - 1.0).abs() < 1e-14);
        }
        let dilute = WenYu::<f64>::new(&GAS, &POWDER);
        assert_eq!(law.beta(0.19, 0.3), dilute.beta(0.19, 0.3));
        // 150 · 0.2/0.8 over 18 · 0.8^-2.65; with 1.75 Re/0.8 over 0.33 Re 0.8^-2.65 besides.
        let jump = |u| law.beta(0.2 + 1e-12, u) / law.beta(0.2 - 1e-12, u);
        assert!((jump(0.0) - 1.1533).abs() < 1e-4, "{}", jump(0.0));
        assert!((jump(speed(0.2, 1e6)) - 3.6697).abs() < 1e-4, "{}", jump(speed(0.2, 1e6)));
    }

    #[test]
    fn beetstra_gives_the_published_slip_of_uniform_suspensions() {
        use super::super::scales::{Scales, homogeneous_slip};
        let gas = Gas { density: 1.224, ..GAS };
        let law = Beetstra::<f64>::new(&gas, &POWDER);
        let u_t = Scales::new(&POWDER, &gas, 9.81).terminal_velocity;
        assert!((u_t - 0.2197).abs() < 1e-4);
        for (phi, expected) in [(0.05, 0.642), (0.10, 0.473), (0.15, 0.358), (0.25, 0.214)] {
            let found = homogeneous_slip(&law, &POWDER, &gas, 9.81, phi) / u_t;
            assert!((found / expected - 1.0).abs() < 5e-3, "phi {phi}: {found}");
        }
    }

    #[test]
    fn beetstra_agrees_with_its_formula_as_printed() {
        let law = Beetstra::<f64>::new(&GAS, &POWDER);
        for (phi, re) in [(0.1, 0.2), (0.3, 30.0), (0.55, 800.0)] {
            let eg: f64 = 1.0 - phi;
            let re: f64 = re;
            let f = 10.0 * phi / eg.powi(2)
                + eg.powi(2) * (1.0 + 1.5 * phi.sqrt())
                + 0.413 * re / (24.0 * eg.powi(2))
                    * (1.0 / eg + 3.0 * eg * phi + 8.4 * re.powf(-0.343))
                    / (1.0 + 10f64.powf(3.0 * phi) * re.powf(-(1.0 + 4.0 * phi) / 2.0));
            let found = law.beta_per_fraction(phi, speed(phi, re)) / (STOKES * eg);
            assert!((found / f - 1.0).abs() < 1e-13, "{phi} {re}: {found} {f}");
        }
    }

    #[test]
    fn tenneti_agrees_with_its_formula_as_printed() {
        let law = Tenneti::<f64>::new(&GAS, &POWDER);
        for (phi, re) in [(0.1, 0.2), (0.3, 30.0), (0.5, 300.0), (0.2, 2000.0)] {
            let eg: f64 = 1.0 - phi;
            let re: f64 = re;
            let alone = if re < 1000.0 { 1.0 + 0.15 * re.powf(0.687) } else { 0.44 * re / 24.0 };
            let f = alone / eg.powi(3)
                + 5.81 * phi / eg.powi(3)
                + 0.48 * phi.cbrt() / eg.powi(4)
                + phi.powi(3) * re * (0.95 + 0.61 * phi.powi(3) / eg.powi(2));
            // Of the total force the fraction 1-φ is drag.
            let found = law.beta_per_fraction(phi, speed(phi, re)) / (STOKES * eg * eg);
            assert!((found / f - 1.0).abs() < 1e-13, "{phi} {re}: {found} {f}");
        }
    }

    #[test]
    fn two_simulations_of_fixed_beds_agree_once_defined_alike() {
        // In creeping flow the published fits agree within some per cent; a factor of 1-φ between
        // total force and drag would show as 10 to 50 %.
        let beetstra = Beetstra::<f64>::new(&GAS, &POWDER);
        let tenneti = Tenneti::<f64>::new(&GAS, &POWDER);
        for phi in [0.1, 0.2, 0.3, 0.4, 0.5] {
            let ratio = tenneti.beta(phi, 0.0) / beetstra.beta(phi, 0.0);
            assert!((0.9..1.0).contains(&ratio), "{phi}: {ratio}");
        }
    }

    #[test]
    fn a_boxed_law_is_that_law() {
        for (name, law) in laws::<f64>() {
            let (phi, speed) = ([0.1, 0.3], [0.2, 0.05]);
            let mut betas = [0.0; 2];
            law.betas(&mut betas, &phi, &speed);
            for n in 0..2 {
                assert_eq!(betas[n], law.as_ref().beta(phi[n], speed[n]), "{name}");
            }
        }
    }

    #[test]
    fn a_sphere_of_a_mixture_has_the_law_of_its_own_diameter() {
        let ratio = 1.7;
        let other = Powder { diameter: ratio * POWDER.diameter, ..POWDER };
        for ((_, law), (_, own)) in laws::<f64>().into_iter().zip(laws_of::<f64>(&other)) {
            let mixture = OwnDiameter(law);
            for (phi, u) in [(0.0, 0.3), (0.1, 0.05), (0.45, 2.0)] {
                let (found, expected) =
                    (mixture.of_sphere(phi, u, ratio), own.beta_per_fraction(phi, u));
                assert!((found / expected - 1.0).abs() < 1e-13, "{phi} {u}: {found} {expected}");
                assert_eq!(mixture.of_sphere(phi, u, 1.0), mixture.0.beta_per_fraction(phi, u));
            }
        }
    }

    #[test]
    fn a_mixture_takes_the_drag_of_equal_spheres_of_its_sauter_mean() {
        let law = Beetstra::<f64>::new(&GAS, &POWDER);
        let mixture = VanDerHoef(law);
        // By volume 0.3 of 0.6 and 0.7 of y such that Σ share/y = 1: the Sauter mean is that of reference.
        let (phi, u) = (0.3, 0.4);
        let classes = [(0.3, 0.6), (0.7, 0.7 / (1.0 - 0.3 / 0.6))];
        let found: f64 =
            classes.iter().map(|(share, y)| share * mixture.of_sphere(phi, u, *y)).sum();
        assert!((found / law.beta_per_fraction(phi, u) - 1.0).abs() < 1e-14);
        // In creeping flow the force on a sphere goes with the square of its diameter, not with the diameter.
        let force = |y: f64| y.powi(3) * mixture.of_sphere(phi, 0.0, y);
        assert!((force(2.0) / force(1.0) - 4.0).abs() < 1e-14);
    }
}
