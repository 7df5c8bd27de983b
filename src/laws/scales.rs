//! The powder, the gas, and the scales made of them: terminal velocity, reference lengths.

use super::drag::{DragLaw, WenYu};

/// The gas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gas {
    /// ρ_g \[kg/m³\].
    pub density: f64,
    /// μ_g \[Pa·s\].
    pub viscosity: f64,
}

/// The powder: equal spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Powder {
    /// d \[m\].
    pub diameter: f64,
    /// ρ_s, of one particle \[kg/m³\].
    pub density: f64,
    /// Restitution coefficient of a collision e \[-\].
    pub restitution: f64,
    /// Solids fraction of the densest random packing φ_max \[-\].
    pub max_packing: f64,
}

/// The scales that a powder, a gas and gravity set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scales {
    /// Terminal velocity u_t of one sphere, drag of Schiller & Naumann solved (not Stokes) \[m/s\].
    pub terminal_velocity: f64,
    /// Particle Reynolds number at u_t, ρ_g u_t d / μ_g \[-\].
    pub reynolds: f64,
    /// Particle Froude number Fr_p = u_t² / (g d) \[-\].
    pub froude: f64,
    /// Gravity g \[m/s²\].
    pub gravity: f64,
    /// Particle diameter d \[m\].
    pub diameter: f64,
    /// Particle density ρ_s \[kg/m³\].
    pub density: f64,
}

/// Names of the reference lengths and their exponents n in L = (u_t²/g) Fr_p^n.
pub const REFERENCE_LENGTHS: [(&str, f64); 5] =
    [("L_I", 0.0), ("L_II", -2.0 / 3.0), ("L_III", -0.5), ("L_IV", -1.0), ("L_V", -4.0 / 3.0)];

impl Scales {
    /// The scales of `powder` in `gas` under `gravity` \[m/s²\].
    pub fn new(powder: &Powder, gas: &Gas, gravity: f64) -> Self {
        let u_t = homogeneous_slip(&WenYu::new(gas, powder), powder, gas, gravity, 0.0);
        Self {
            terminal_velocity: u_t,
            reynolds: gas.density * u_t * powder.diameter / gas.viscosity,
            froude: u_t * u_t / (gravity * powder.diameter),
            gravity,
            diameter: powder.diameter,
            density: powder.density,
        }
    }

    /// L(n) = (u_t²/g) Fr_p^n \[m\].
    pub fn length(&self, exponent: f64) -> f64 {
        self.terminal_velocity.powi(2) / self.gravity * self.froude.powf(exponent)
    }

    /// L_I = u_t²/g \[m\].
    pub fn length_i(&self) -> f64 {
        self.length(0.0)
    }

    /// L_II = d Fr_p^(1/3) \[m\].
    pub fn length_ii(&self) -> f64 {
        self.length(-2.0 / 3.0)
    }

    /// u_t/g \[s\].
    pub fn time(&self) -> f64 {
        self.terminal_velocity / self.gravity
    }

    /// ρ_s u_t² \[Pa\].
    pub fn stress(&self) -> f64 {
        self.density * self.terminal_velocity.powi(2)
    }

    /// ρ_s u_t³/g \[Pa·s\].
    pub fn viscosity(&self) -> f64 {
        self.density * self.terminal_velocity.powi(3) / self.gravity
    }
}

/// Slip velocity u of the uniform suspension [m/s]: the root of
/// β(φ, u) u = φ (1-φ) (ρ_s - ρ_g) g. At φ = 0 (β/φ taken) it is the terminal velocity.
pub fn homogeneous_slip<L: DragLaw<f64>>(
    law: &L,
    powder: &Powder,
    gas: &Gas,
    gravity: f64,
    solids_fraction: f64,
) -> f64 {
    let weight = (1.0 - solids_fraction) * (powder.density - gas.density) * gravity;
    let excess = |u: f64| law.beta_per_fraction(solids_fraction, u) * u - weight;
    // The force grows monotonically with the slip: widen a bracket, then bisect to the last bit.
    let mut high = 1e-6;
    while excess(high) < 0.0 {
        high *= 2.0;
    }
    let mut low = 0.5 * high;
    while excess(low) > 0.0 {
        low *= 0.5;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if excess(middle) < 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// The founding paper's powder in air.
    pub(crate) const POWDER: Powder =
        Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 };
    /// The founding paper's air.
    pub(crate) const GAS: Gas = Gas { density: 1.3, viscosity: 1.8e-5 };

    #[test]
    fn base_powder_has_the_published_scales() {
        let scales = Scales::new(&POWDER, &GAS, 9.81);
        assert!((scales.terminal_velocity - 0.218_46).abs() < 5e-6);
        assert!((scales.reynolds - 1.183).abs() < 5e-4);
        assert!((scales.froude - 64.87).abs() < 5e-3);
        assert!((scales.length_i() - 4.865e-3).abs() < 5e-7);
        assert!((scales.length_ii() - 0.3013e-3).abs() < 5e-8);
        assert!((scales.length(-1.0) - 75e-6).abs() < 1e-18);
        assert!((scales.stress() - 71.59).abs() < 5e-3);
        assert!((scales.viscosity() - 1.5942).abs() < 5e-5);
        assert!((scales.time() - 22.27e-3).abs() < 5e-6);
    }

    #[test]
    fn uniform_slip_matches_the_published_table() {
        let law = WenYu::new(&GAS, &POWDER);
        let u_t = Scales::new(&POWDER, &GAS, 9.81).terminal_velocity;
        let table = include_str!("../../data/uniform-slip.csv");
        let mut reader =
            csv::ReaderBuilder::new().comment(Some(b'#')).from_reader(table.as_bytes());
        let rows: Vec<(f64, f64)> = reader.deserialize().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 10);
        for (phi, expected) in rows {
            let found = homogeneous_slip(&law, &POWDER, &GAS, 9.81, phi) / u_t;
            assert!((found - expected).abs() < 5.1e-5, "phi {phi}: {found}");
        }
    }
}
