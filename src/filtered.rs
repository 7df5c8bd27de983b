//! Filtered quantities: what a coarse-grid solver needs, from filtered moments of the fine fields.
//!
//! An overbar is the box filter, a tilde the Favre (phase-weighted) filter, φ the solids fraction,
//! u the velocities, the last axis (y) vertical. Every formula stands once: [`Moments`] are what is
//! filtered, [`Filtered`] what follows from them at one position, [`QUANTITIES`] what is reported.
//! Deviators and isotropic parts are those of the `D` simulated directions: the part that is
//! subtracted is tr/D, in two dimensions tr/2. Compression is positive.

use crate::laws::scales::Scales;

/// Filtered moments of the fine fields at one filter position.
#[derive(Clone, Copy, Debug)]
pub struct Moments<const D: usize> {
    /// φ̄ \[-\].
    pub solids_fraction: f64,
    /// Filtered φ² \[-\].
    pub solids_fraction_squared: f64,
    /// Filtered φ u_s \[m/s\].
    pub solids_flux: [f64; D],
    /// Filtered (1-φ) u_g \[m/s\].
    pub gas_flux: [f64; D],
    /// Filtered φ u_g, vertical: the gas that the solids see \[m/s\].
    pub seen_gas_flux: f64,
    /// Filtered φ u_s u_s \[m²/s²\].
    pub solids_flux_velocity: [[f64; D]; D],
    /// Filtered β (u_g - u_s), vertical \[Pa/m\].
    pub drag: f64,
    /// Filtered ∂p/∂y \[Pa/m\].
    pub pressure_gradient: f64,
    /// Filtered φ ∂p/∂y \[Pa/m\].
    pub fraction_pressure_gradient: f64,
    /// Filtered isotropic kinetic-theory stress \[Pa\].
    pub kinetic_pressure: f64,
    /// Filtered deviatoric kinetic-theory stress \[Pa\].
    pub kinetic_stress: [[f64; D]; D],
    /// Filtered φ Θ \[m²/s²\].
    pub fraction_temperature: f64,
    /// ∂ũ_s,i/∂x_j of the Favre-filtered solids velocity \[1/s\].
    pub solids_velocity_gradient: [[f64; D]; D],
}

/// `amount / fraction`; 0 for a phase that is absent. A filtered flux is at most its filtered
/// fraction times the greatest fine velocity, so the quotient is bounded down to the smallest
/// fraction and only 0/0 needs care.
#[inline(always)]
pub fn favre(amount: f64, fraction: f64) -> f64 {
    amount / fraction.max(f64::MIN_POSITIVE)
}

/// tr a, the sum over the simulated directions.
#[inline(always)]
fn trace<const D: usize>(a: &[[f64; D]; D]) -> f64 {
    (0..D).map(|i| a[i][i]).sum()
}

/// a : b.
#[inline(always)]
fn contract<const D: usize>(a: &[[f64; D]; D], b: &[[f64; D]; D]) -> f64 {
    (0..D).map(|i| (0..D).map(|j| a[i][j] * b[i][j]).sum::<f64>()).sum()
}

impl<const D: usize> Moments<D> {
    /// ũ_s = filt(φ u_s) / φ̄ \[m/s\]; 0 in an empty box.
    #[inline(always)]
    pub fn favre_solids_velocity(&self) -> [f64; D] {
        self.solids_flux.map(|flux| favre(flux, self.solids_fraction))
    }

    /// ũ_g = filt((1-φ) u_g) / (1-φ̄) \[m/s\].
    #[inline(always)]
    pub fn favre_gas_velocity(&self) -> [f64; D] {
        self.gas_flux.map(|flux| favre(flux, 1.0 - self.solids_fraction))
    }

    /// Filtered slip ũ_g - ũ_s \[m/s\].
    #[inline(always)]
    pub fn slip(&self) -> [f64; D] {
        let (gas, solids) = (self.favre_gas_velocity(), self.favre_solids_velocity());
        std::array::from_fn(|axis| gas[axis] - solids[axis])
    }

    /// |ũ_g - ũ_s| \[m/s\].
    #[inline(always)]
    pub fn slip_speed(&self) -> f64 {
        self.slip().iter().map(|u| u * u).sum::<f64>().sqrt()
    }

    /// Pressure-fluctuation term filt(φ' ∂p'/∂y) = filt(φ ∂p/∂y) - φ̄ filt(∂p/∂y) \[Pa/m\].
    #[inline(always)]
    pub fn pressure_fluctuation(&self) -> f64 {
        self.fraction_pressure_gradient - self.solids_fraction * self.pressure_gradient
    }

    /// φ̄ v_d, vertical: filt(φ u_g) - φ̄ ũ_g \[m/s\], v_d the drift velocity.
    #[inline(always)]
    pub fn drift_flux(&self) -> f64 {
        self.seen_gas_flux - self.solids_fraction * self.favre_gas_velocity()[D - 1]
    }

    /// filt(φ²) - φ̄² \[-\].
    #[inline(always)]
    pub fn solids_fraction_variance(&self) -> f64 {
        self.solids_fraction_squared - self.solids_fraction * self.solids_fraction
    }

    /// Residual stress per density, filt(φ u_s u_s) - φ̄ ũ_s ũ_s \[m²/s²\].
    #[inline(always)]
    pub fn residual_stress(&self) -> [[f64; D]; D] {
        // φ̄ ũ_i ũ_j with the flux itself: exact in an empty box too.
        let velocity = self.favre_solids_velocity();
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                self.solids_flux_velocity[i][j] - self.solids_flux[i] * velocity[j]
            })
        })
    }

    /// Sd = ½ (∇ũ_s + ∇ũ_sᵀ) - (∇·ũ_s / D) I \[1/s\].
    #[inline(always)]
    pub fn deviatoric_rate(&self) -> [[f64; D]; D] {
        let gradient = &self.solids_velocity_gradient;
        let isotropic = trace(gradient) / D as f64;
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                0.5 * (gradient[i][j] + gradient[j][i]) - if i == j { isotropic } else { 0.0 }
            })
        })
    }
}

/// What follows from the [`Moments`] at one position, in scalars: the dimension is behind us.
#[derive(Clone, Copy, Debug)]
pub struct Filtered {
    /// φ̄ \[-\].
    pub solids_fraction: f64,
    /// Vertical filtered slip ũ_g - ũ_s \[m/s\].
    pub slip: f64,
    /// Filtered drag, vertical: filt(β (u_g - u_s)) \[Pa/m\].
    pub drag: f64,
    /// [`Moments::pressure_fluctuation`] \[Pa/m\].
    pub pressure_fluctuation: f64,
    /// Drag of the fine-grid law at filtered values: β_micro(φ̄, |ũ_g - ũ_s|) (ũ_g - ũ_s),
    /// vertical \[Pa/m\].
    pub microscopic_drag: f64,
    /// [`Moments::drift_flux`] \[m/s\].
    pub drift_flux: f64,
    /// [`Moments::solids_fraction_variance`] \[-\].
    pub solids_fraction_variance: f64,
    /// Isotropic part of the filtered kinetic-theory stress, tr/D \[Pa\].
    pub kinetic_pressure: f64,
    /// Isotropic part of the residual stress R = ρ_s (filt(φ u_s u_s) - φ̄ ũ_s ũ_s), tr R / D \[Pa\].
    pub residual_pressure: f64,
    /// -τ : Sd, τ the filtered kinetic-theory stress \[Pa/s\].
    pub kinetic_dissipation: f64,
    /// -R : Sd \[Pa/s\].
    pub residual_dissipation: f64,
    /// S = √(2 Sd:Sd) \[1/s\].
    pub shear_rate: f64,
    /// Filtered φ Θ \[m²/s²\].
    pub fraction_temperature: f64,
    /// ρ_s Δ_f², the scale of Smagorinsky's closures \[kg/m\].
    pub smagorinsky_scale: f64,
}

impl Filtered {
    /// The quantities at a position with these `moments`. `microscopic_beta` is the fine-grid law's
    /// β(φ̄, |ũ_g - ũ_s|) \[kg/m³/s\], `solids_density` ρ_s \[kg/m³\], `filter_width` Δ_f \[m\].
    #[inline(always)]
    pub fn new<const D: usize>(
        moments: &Moments<D>,
        microscopic_beta: f64,
        solids_density: f64,
        filter_width: f64,
    ) -> Self {
        let slip = moments.slip()[D - 1];
        let residual = moments.residual_stress();
        let rate = moments.deviatoric_rate();
        Self {
            solids_fraction: moments.solids_fraction,
            slip,
            drag: moments.drag,
            pressure_fluctuation: moments.pressure_fluctuation(),
            microscopic_drag: microscopic_beta * slip,
            drift_flux: moments.drift_flux(),
            solids_fraction_variance: moments.solids_fraction_variance(),
            // The trace vanishes if the simulator's deviator is that of D directions, and belongs
            // here if it is that of three.
            kinetic_pressure: moments.kinetic_pressure + trace(&moments.kinetic_stress) / D as f64,
            residual_pressure: solids_density * trace(&residual) / D as f64,
            kinetic_dissipation: -contract(&moments.kinetic_stress, &rate),
            residual_dissipation: -solids_density * contract(&residual, &rate),
            shear_rate: (2.0 * contract(&rate, &rate)).sqrt(),
            fraction_temperature: moments.fraction_temperature,
            smagorinsky_scale: solids_density * filter_width * filter_width,
        }
    }
}

/// Physical kind of a quantity: its SI unit and what it is scaled by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Number,
    /// Scaled by u_t.
    Velocity,
    /// Scaled by u_t².
    SquaredVelocity,
    /// Scaled by ρ_s u_t².
    Stress,
    /// Scaled by ρ_s u_t³/g.
    Viscosity,
}

impl Kind {
    /// SI unit; `-` for a number.
    pub const fn unit(self) -> &'static str {
        match self {
            Kind::Number => "-",
            Kind::Velocity => "m/s",
            Kind::SquaredVelocity => "m²/s²",
            Kind::Stress => "Pa",
            Kind::Viscosity => "Pa·s",
        }
    }

    /// What a value in SI is divided by to be scaled.
    pub fn scale(self, scales: &Scales) -> f64 {
        match self {
            Kind::Number => 1.0,
            Kind::Velocity => scales.terminal_velocity,
            Kind::SquaredVelocity => scales.terminal_velocity.powi(2),
            Kind::Stress => scales.stress(),
            Kind::Viscosity => scales.viscosity(),
        }
    }
}

/// How the value follows from the ratio Σ numerator / Σ denominator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Map {
    /// The ratio itself.
    Ratio,
    /// 1 - ratio.
    OneMinusRatio,
}

impl Map {
    /// The value for a ratio of sums. Its error is the ratio's, whichever the map.
    pub fn value(self, ratio: f64) -> f64 {
        match self {
            Map::Ratio => ratio,
            Map::OneMinusRatio => 1.0 - ratio,
        }
    }

    /// The interval of the value for one of the ratio, lower end first.
    pub fn interval(self, [low, high]: [f64; 2]) -> [f64; 2] {
        match self {
            Map::Ratio => [low, high],
            Map::OneMinusRatio => [1.0 - high, 1.0 - low],
        }
    }
}

/// A reported quantity: a ratio of two sums over the filter positions of a bin, so that table,
/// errors and resampling treat all quantities alike.
#[derive(Clone, Copy, Debug)]
pub struct Quantity {
    /// Name in tables.
    pub name: &'static str,
    /// Unit and scale.
    pub kind: Kind,
    /// From ratio to value.
    pub map: Map,
    /// What a position adds to the numerator.
    pub numerator: fn(&Filtered) -> f64,
    /// What a position adds to the denominator.
    pub denominator: fn(&Filtered) -> f64,
}

/// Number of quantities.
pub const QUANTITY_COUNT: usize = 14;

/// All reported quantities, in the order of the tables.
///
/// | name | value |
/// | --- | --- |
/// | `drag_correction` | H = 1 - Σ(drag - pressure fluctuation) / Σ microscopic drag |
/// | `drag_correction_no_pressure` | 1 - Σ drag / Σ microscopic drag |
/// | `slip` | mean vertical filtered slip |
/// | `drift_velocity` | Σ φ̄ v_d / Σ φ̄, vertical |
/// | `solids_fraction_variance` | mean of filt(φ²) - φ̄² |
/// | `solids_pressure_kinetic` | mean isotropic part of the filtered kinetic-theory stress |
/// | `solids_pressure_residual` | mean of tr R / D |
/// | `solids_pressure` | their sum |
/// | `solids_viscosity_kinetic` | Σ(-τ:Sd) / Σ S²: slope of the stress on the rate |
/// | `solids_viscosity_residual` | Σ(-R:Sd) / Σ S² |
/// | `solids_viscosity` | their sum |
/// | `smagorinsky_viscosity` | C_μ = Σ(-R:Sd) / Σ ρ_s Δ_f² S³ |
/// | `smagorinsky_pressure` | C_p = Σ(tr R / D) / Σ ρ_s Δ_f² S² |
/// | `granular_temperature` | Σ filt(φ Θ) / Σ φ̄ |
pub const QUANTITIES: [Quantity; QUANTITY_COUNT] = [
    Quantity {
        name: "drag_correction",
        kind: Kind::Number,
        map: Map::OneMinusRatio,
        numerator: |at| at.drag - at.pressure_fluctuation,
        denominator: |at| at.microscopic_drag,
    },
    Quantity {
        name: "drag_correction_no_pressure",
        kind: Kind::Number,
        map: Map::OneMinusRatio,
        numerator: |at| at.drag,
        denominator: |at| at.microscopic_drag,
    },
    Quantity {
        name: "slip",
        kind: Kind::Velocity,
        map: Map::Ratio,
        numerator: |at| at.slip,
        denominator: |_| 1.0,
    },
    Quantity {
        name: "drift_velocity",
        kind: Kind::Velocity,
        map: Map::Ratio,
        numerator: |at| at.drift_flux,
        denominator: |at| at.solids_fraction,
    },
    Quantity {
        name: "solids_fraction_variance",
        kind: Kind::Number,
        map: Map::Ratio,
        numerator: |at| at.solids_fraction_variance,
        denominator: |_| 1.0,
    },
    Quantity {
        name: "solids_pressure_kinetic",
        kind: Kind::Stress,
        map: Map::Ratio,
        numerator: |at| at.kinetic_pressure,
        denominator: |_| 1.0,
    },
    Quantity {
        name: "solids_pressure_residual",
        kind: Kind::Stress,
        map: Map::Ratio,
        numerator: |at| at.residual_pressure,
        denominator: |_| 1.0,
    },
    Quantity {
        name: "solids_pressure",
        kind: Kind::Stress,
        map: Map::Ratio,
        numerator: |at| at.kinetic_pressure + at.residual_pressure,
        denominator: |_| 1.0,
    },
    Quantity {
        name: "solids_viscosity_kinetic",
        kind: Kind::Viscosity,
        map: Map::Ratio,
        numerator: |at| at.kinetic_dissipation,
        denominator: |at| at.shear_rate * at.shear_rate,
    },
    Quantity {
        name: "solids_viscosity_residual",
        kind: Kind::Viscosity,
        map: Map::Ratio,
        numerator: |at| at.residual_dissipation,
        denominator: |at| at.shear_rate * at.shear_rate,
    },
    Quantity {
        name: "solids_viscosity",
        kind: Kind::Viscosity,
        map: Map::Ratio,
        numerator: |at| at.kinetic_dissipation + at.residual_dissipation,
        denominator: |at| at.shear_rate * at.shear_rate,
    },
    Quantity {
        name: "smagorinsky_viscosity",
        kind: Kind::Number,
        map: Map::Ratio,
        numerator: |at| at.residual_dissipation,
        denominator: |at| at.smagorinsky_scale * at.shear_rate.powi(3),
    },
    Quantity {
        name: "smagorinsky_pressure",
        kind: Kind::Number,
        map: Map::Ratio,
        numerator: |at| at.residual_pressure,
        denominator: |at| at.smagorinsky_scale * at.shear_rate.powi(2),
    },
    Quantity {
        name: "granular_temperature",
        kind: Kind::SquaredVelocity,
        map: Map::Ratio,
        numerator: |at| at.fraction_temperature,
        denominator: |at| at.solids_fraction,
    },
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::scales::tests::{GAS, POWDER};

    /// Moments of a box with φ̄ = 0.2 in which the phases move as told, sheared at `rate`.
    fn moments<const D: usize>(solids: [f64; D], gas: [f64; D], rate: f64) -> Moments<D> {
        let mut gradient = [[0.0; D]; D];
        gradient[D - 1][0] = rate;
        // Dilation must not enter the deviator.
        (0..D).for_each(|i| gradient[i][i] = 5.0);
        Moments {
            solids_fraction: 0.2,
            solids_fraction_squared: 0.05,
            solids_flux: solids.map(|u| 0.2 * u),
            gas_flux: gas.map(|u| 0.8 * u),
            seen_gas_flux: 0.2 * gas[D - 1] - 0.01,
            solids_flux_velocity: std::array::from_fn(|i| {
                std::array::from_fn(|j| 0.2 * solids[i] * solids[j])
            }),
            drag: 900.0,
            pressure_gradient: 50.0,
            fraction_pressure_gradient: -90.0,
            kinetic_pressure: 3.0,
            kinetic_stress: [[0.0; D]; D],
            fraction_temperature: 0.2 * 0.004,
            solids_velocity_gradient: gradient,
        }
    }

    fn value(name: &str, at: &Filtered) -> f64 {
        let quantity = QUANTITIES.iter().find(|quantity| quantity.name == name).unwrap();
        quantity.map.value((quantity.numerator)(at) / (quantity.denominator)(at))
    }

    fn check_stress<const D: usize>() {
        let (density, width, viscosity) = (1500.0, 0.01, 0.7);
        let mut moments = moments([0.3; D], [0.1; D], 40.0);
        let rate = moments.deviatoric_rate();
        assert!(trace(&rate).abs() < 1e-14);
        // A kinetic stress of viscosity 0.7; a residual stress of viscosity 1.4 and pressure 6 Pa.
        moments.kinetic_stress = rate.map(|row| row.map(|rate| -2.0 * viscosity * rate));
        for (i, (flux, rate)) in moments.solids_flux_velocity.iter_mut().zip(&rate).enumerate() {
            for (flux, rate) in flux.iter_mut().zip(rate) {
                *flux -= 4.0 * viscosity * rate / density;
            }
            flux[i] += 6.0 / density;
        }
        let at = Filtered::new(&moments, 1.0, density, width);
        let close = |name: &str, expected: f64| {
            let found = value(name, &at);
            assert!((found / expected - 1.0).abs() < 1e-10, "{name}: {found} {expected}");
        };
        // Simple shear du_y/dx: S is the shear rate.
        assert!((at.shear_rate - 40.0).abs() < 1e-12);
        close("solids_viscosity_kinetic", 0.7);
        close("solids_viscosity_residual", 1.4);
        close("solids_viscosity", 2.1);
        close("solids_pressure_kinetic", 3.0);
        close("solids_pressure_residual", 6.0);
        close("solids_pressure", 9.0);
        close("smagorinsky_viscosity", 1.4 / (density * width * width * 40.0));
        close("smagorinsky_pressure", 6.0 / (density * width * width * 1600.0));
        close("granular_temperature", 0.004);
    }

    #[test]
    fn stresses_give_their_viscosities_and_pressures() {
        check_stress::<2>();
        check_stress::<3>();
    }

    #[test]
    fn drag_and_drift_follow_their_definitions() {
        let moments = moments([0.1, -0.2], [0.0, 0.3], 0.0);
        assert!((moments.slip_speed() - 0.26f64.sqrt()).abs() < 1e-15);
        let at = Filtered::new(&moments, 4000.0, 1500.0, 0.01);
        let close = |name: &str, expected: f64| {
            let found = value(name, &at);
            assert!((found - expected).abs() < 1e-13, "{name}: {found} {expected}");
        };
        close("slip", 0.5);
        // Microscopic drag 4000 x 0.5; pressure fluctuation -90 - 0.2 x 50 = -100.
        close("drag_correction", 1.0 - 1000.0 / 2000.0);
        close("drag_correction_no_pressure", 1.0 - 900.0 / 2000.0);
        close("drift_velocity", -0.05);
        close("solids_fraction_variance", 0.01);
    }

    #[test]
    fn quantities_have_their_own_names_and_scales() {
        let names: std::collections::BTreeSet<_> = QUANTITIES.iter().map(|q| q.name).collect();
        assert_eq!(names.len(), QUANTITY_COUNT);
        let scales = Scales::new(&POWDER, &GAS, 9.81);
        for (kind, unit, scale) in [
            (Kind::Number, "-", 1.0),
            (Kind::Velocity, "m/s", 0.218_46),
            (Kind::SquaredVelocity, "m²/s²", 0.047_725),
            (Kind::Stress, "Pa", 71.59),
            (Kind::Viscosity, "Pa·s", 1.5942),
        ] {
            assert_eq!(kind.unit(), unit);
            assert!((kind.scale(&scales) / scale - 1.0).abs() < 1e-4, "{unit}");
        }
    }
}
