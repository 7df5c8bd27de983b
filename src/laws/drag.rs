//! Fine-grid gas-solids drag.

use super::scales::{Gas, Powder};
use crate::real::Real;

/// A fine-grid drag law: force on the solids per volume = β (u_g - u_s).
pub trait DragLaw<R: Real>: Copy + Send + Sync {
    /// β/φ \[kg/m³/s\] at solids fraction φ and slip speed |u_g - u_s| \[m/s\]; finite at φ → 0 and at
    /// zero slip.
    fn beta_per_fraction(&self, solids_fraction: R, slip_speed: R) -> R;

    /// β \[kg/m³/s\].
    #[inline(always)]
    fn beta(&self, solids_fraction: R, slip_speed: R) -> R {
        solids_fraction * self.beta_per_fraction(solids_fraction, slip_speed)
    }
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
    fn beta_per_fraction(&self, solids_fraction: R, slip_speed: R) -> R {
        let gas_fraction = R::ONE - solids_fraction;
        let reynolds = gas_fraction * self.reynolds_per_speed * slip_speed;
        // The floor keeps the logarithm finite; its term is 1e-21 there.
        let power = reynolds.max(R::of(1e-30)).power(R::of(0.687));
        let drag_times_reynolds = R::select(
            reynolds < R::of(1000.0),
            R::of(24.0) + R::of(3.6) * power,
            R::of(0.44) * reynolds,
        );
        self.stokes * drag_times_reynolds * gas_fraction.power(R::of(-2.65))
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

    #[test]
    fn wen_yu_tends_to_stokes_at_rest_and_is_finite_in_empty_cells() {
        let law = WenYu::<f64>::new(&GAS, &POWDER);
        let stokes = 18.0 * GAS.viscosity / POWDER.diameter.powi(2);
        assert!((law.beta_per_fraction(0.0, 0.0) / stokes - 1.0).abs() < 1e-14);
        let single = WenYu::<f32>::new(&GAS, &POWDER).beta_per_fraction(0.0, 0.0);
        assert!((f64::from(single) / stokes - 1.0).abs() < 1e-6);
    }
}
