//! What solvers take of a closure: drag factor, solids viscosity, solids pressure, base drag, scales.

use super::code::digits;
use super::{ExportError, Facts, Quantity, Target};
use crate::expression::Expression;
use crate::fit::ReferenceLength;
use crate::forms::Marker;
use crate::laws::scales::{Gas, Powder, Scales};
use crate::model::System;

/// The name of the particle Reynolds number in the formulae of [`base_drag`].
pub const REYNOLDS: &str = "Reynolds number";

/// β d²/(φ μ_g) \[-\] of a drag law as a formula of φ and Re = (1-φ) ρ_g d |u|/μ_g: the laws of
/// [`laws::drag`](crate::laws::drag), written so that they are finite at rest.
pub fn base_drag(name: &str) -> Option<Expression> {
    let sphere = "piecewise(R < 1000, 24 + 3.6*R^0.687, 0.44*R)";
    let wen_yu = format!("0.75*{sphere}*(1 - phi)^-2.65");
    let text = match name {
        "wen-yu" => wen_yu,
        "gidaspow" => {
            format!("piecewise(1 - phi < 0.8, (150*phi + 1.75*R)/(1 - phi), {wen_yu})")
        }
        "beetstra" => "18*(1 - phi)*(10*phi/(1 - phi)^2 + (1 - phi)^2*(1 + 1.5*sqrt(phi)) \
                       + 0.413/24/(1 - phi)^2*(R*(1/(1 - phi) + 3*phi*(1 - phi)) + 8.4*R^0.657)\
                       *R^(0.5 + 2*phi)/(R^(0.5 + 2*phi) + 10^(3*phi)))"
            .into(),
        "tenneti" => format!(
            "18*(({sphere}/24 + 5.81*phi)/(1 - phi) + 0.48*phi^(1/3)/(1 - phi)^2 \
             + phi^3*R*(0.95*(1 - phi)^2 + 0.61*phi^3))"
        ),
        _ => return None,
    };
    let text = text.replace('R', &format!("`{REYNOLDS}`"));
    Some(Expression::parse(&text).expect("the formulae here are read"))
}

/// A closure as a solver takes it.
pub struct Solver<'a> {
    /// The closure.
    pub facts: &'a Facts<'a>,
    /// H.
    pub drag: Option<&'a Quantity>,
    /// What the solids viscosity is the sum of \[ρ_s u_t³/g\].
    pub viscosity: Vec<&'a Quantity>,
    /// What the solids pressure is the sum of \[ρ_s u_t²\].
    pub pressure: Vec<&'a Quantity>,
    /// Powder and gas of the closure, or of the founding study where the source names none.
    pub system: System,
}

/// Markers that a target gives where it asks for the drag, and for the stress.
fn given(target: Target) -> (&'static [Marker], &'static [Marker]) {
    use Marker::{FilterWidth, GasShearRate, ShearRate, Slip, SolidsFraction};
    match target {
        Target::OpenFoam => (
            &[SolidsFraction, FilterWidth, Slip, ShearRate, GasShearRate],
            &[SolidsFraction, FilterWidth, ShearRate],
        ),
        _ => (&[SolidsFraction, FilterWidth, Slip], &[SolidsFraction, FilterWidth, ShearRate]),
    }
}

impl<'a> Solver<'a> {
    /// What `target` takes of the closure.
    ///
    /// # Errors
    /// [`ExportError`]: nothing that it takes, a marker that it does not give, an unknown drag law.
    pub fn new(facts: &'a Facts<'a>, target: Target) -> Result<Self, ExportError> {
        let closure = || facts.name.clone();
        let drag = facts.quantity("drag_correction").filter(|quantity| quantity.unit == "-");
        let sum = |whole: &str, unit: &str| -> Vec<&'a Quantity> {
            let parts = [format!("{whole}_kinetic"), format!("{whole}_residual")];
            let found: Vec<&Quantity> = match facts.quantity(whole) {
                Some(quantity) => vec![quantity],
                None => parts.iter().filter_map(|part| facts.quantity(part)).collect(),
            };
            found.into_iter().filter(|quantity| quantity.unit == unit).collect()
        };
        let viscosity = sum("solids_viscosity", "rho_s u_t^3/g");
        let pressure = sum("solids_pressure", "rho_s u_t^2");
        if drag.is_none() && viscosity.is_empty() && pressure.is_empty() {
            let has: Vec<String> =
                facts.quantities.iter().map(|q| format!("{} [{}]", q.predicts, q.unit)).collect();
            let has = has.join(", ");
            return Err(ExportError::NothingForSolver { closure: closure(), target, has });
        }
        let (for_drag, for_stress) = given(target);
        let drags = drag.iter().map(|quantity| (*quantity, for_drag));
        let stresses = viscosity.iter().chain(&pressure).map(|quantity| (*quantity, for_stress));
        for (quantity, given) in drags.chain(stresses) {
            if let Some(range) = quantity.ranges.iter().find(|r| !given.contains(&r.marker)) {
                return Err(ExportError::Marker {
                    closure: closure(),
                    quantity: quantity.predicts.clone(),
                    marker: range.marker,
                    target,
                });
            }
        }
        if drag.is_some() && facts.base.is_none() {
            let drag = facts.closure.file.definitions.drag.clone();
            return Err(ExportError::Drag { closure: closure(), drag, target });
        }
        let system = facts.closure.file.system.unwrap_or_else(founding);
        Ok(Self { facts, drag, viscosity, pressure, system })
    }

    /// Whether there is a solids viscosity or pressure.
    pub fn has_stress(&self) -> bool {
        !self.viscosity.is_empty() || !self.pressure.is_empty()
    }

    /// What is in the closure and is not given to the solver.
    pub fn left_out(&self) -> Vec<&str> {
        self.facts
            .quantities
            .iter()
            .filter(|q| {
                let used = self.drag.iter().chain(&self.viscosity).chain(&self.pressure);
                !used.into_iter().any(|used| used.predicts == q.predicts)
            })
            .map(|q| &*q.predicts)
            .collect()
    }

    /// A sum of quantities as an expression: `call` writes a call of one.
    pub fn sum(parts: &[&Quantity], call: impl Fn(&Quantity) -> String) -> String {
        let calls: Vec<String> = parts.iter().map(|quantity| call(quantity)).collect();
        if calls.is_empty() { "0.0".into() } else { calls.join(" + ") }
    }

    /// The reference length in C and in C++, of `u_t`, `g` and `d`.
    pub fn length_c(&self) -> &'static str {
        match self.facts.closure.file.reference_length {
            ReferenceLength::One => "u_t*u_t/g",
            ReferenceLength::Two => "d*pow(u_t*u_t/(g*d), 1.0/3.0)",
        }
    }

    /// The reference length of the closure's powder \[m\].
    pub fn length(&self) -> f64 {
        self.system.length(self.facts.closure.file.reference_length)
    }

    /// Powder and gas, with their keys, as text that templates take.
    pub fn numbers(&self) -> Vec<(&'static str, String)> {
        let system = &self.system;
        vec![
            ("diameter", digits(system.diameter)),
            ("particle_density", digits(system.particle_density)),
            ("gas_density", digits(system.gas_density)),
            ("gas_viscosity", digits(system.gas_viscosity)),
            ("gravity", digits(system.gravity)),
            ("max_packing", digits(system.max_packing)),
            ("terminal_velocity", digits(system.terminal_velocity)),
            ("length", digits(self.length())),
        ]
    }
}

/// The founding study's 75 µm catalyst in air.
fn founding() -> System {
    let powder = Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 };
    let gas = Gas { density: 1.3, viscosity: 1.8e-5 };
    System::new(&powder, &gas, &Scales::new(&powder, &gas, 9.81))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closure::{BUILT_IN, Closure};
    use crate::laws::drag::{Beetstra, DragLaw, Gidaspow, Tenneti, WenYu};
    use std::path::Path;

    #[test]
    fn base_drags_are_the_laws_of_the_simulator() {
        let system = founding();
        let powder = Powder {
            diameter: system.diameter,
            density: system.particle_density,
            restitution: 0.9,
            max_packing: 0.65,
        };
        let gas = Gas { density: system.gas_density, viscosity: system.gas_viscosity };
        let laws: [(&str, Box<dyn DragLaw<f64>>); 4] = [
            ("wen-yu", Box::new(WenYu::new(&gas, &powder))),
            ("gidaspow", Box::new(Gidaspow::new(&gas, &powder))),
            ("beetstra", Box::new(Beetstra::new(&gas, &powder))),
            ("tenneti", Box::new(Tenneti::new(&gas, &powder))),
        ];
        for (name, law) in laws {
            let formula = base_drag(name).unwrap();
            for phi in [1e-6, 0.05, 0.19, 0.21, 0.4, 0.64] {
                for speed in [1e-9, 0.01, 0.2184, 3.0, 500.0, 1e4] {
                    let reynolds =
                        (1.0 - phi) * gas.density * powder.diameter * speed / gas.viscosity;
                    let found = formula
                        .evaluate(1, &|name| {
                            Ok(vec![vec![if name == REYNOLDS { reynolds } else { phi }]])
                        })
                        .unwrap()[0][0];
                    let found = found * gas.viscosity / powder.diameter.powi(2);
                    let expected = law.beta_per_fraction(phi, speed);
                    assert!((found / expected - 1.0).abs() < 1e-12, "{name} {phi} {speed}");
                }
            }
        }
        assert!(base_drag("not stated").is_none());
    }

    #[test]
    fn what_a_solver_cannot_do_is_refused_with_what_is_nearest() {
        let good = BUILT_IN.iter().find(|(name, _)| *name == "milioli-2013-extended").unwrap().1;
        let of = |text: &str, target| {
            let closure = Closure::parse(text, Path::new("m.toml")).unwrap();
            super::super::export(&closure, target).unwrap_err().to_string()
        };
        let refused = |from: &str, to: &str, target| {
            assert!(good.contains(from), "{from}");
            of(&good.replace(from, to), target)
        };
        let gradient = good.replace("slip", "pressure_gradient").replace('V', "G");
        for target in [Target::OpenFoam, Target::Mfix, Target::Fluent] {
            let message = of(&gradient, target);
            let why = format!("depends on pressure_gradient, which {target} does not give");
            assert!(message.contains(&why), "{message}");
            assert!(message.contains("nearest: `--to c`"), "{message}");
        }
        let other = refused("\"drag_correction\"", "\"solids_dispersion\"", Target::Mfix);
        assert!(other.contains("predicts solids_dispersion [-], and mfix takes"), "{other}");
        assert!(other.contains("nearest: `--to c`"));
        let law = refused("drag = \"wen-yu\"", "drag = \"mine\"", Target::OpenFoam);
        assert!(law.contains("corrects the drag law \"mine\"") && law.contains("nearest"), "{law}");
    }
}
