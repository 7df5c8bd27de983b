//! Forms that are a formula: those of the literature beside [`SaturatingDrag`](super::SaturatingDrag), and
//! a user's own.

use super::Bounds::{Any, Between, Positive};
use super::{ClosureForm, MARKERS, Marker, Parameter, parameter};
use crate::expression::{Expression, Meaning, Program};
use serde::Deserialize;

/// A form given by a function of parameters and markers, compiled or a user's; its gradient is taken by
/// differences.
#[derive(Debug)]
pub struct FormulaForm {
    name: &'static str,
    formula: &'static str,
    expression: &'static str,
    quantity: &'static str,
    unit: &'static str,
    image: (f64, f64),
    markers: &'static [Marker],
    parameters: &'static [Parameter],
    predict: Predict,
}

/// What a value is computed by.
#[derive(Debug)]
enum Predict {
    /// From the parameters and the markers.
    Function(fn(&[f64], &[f64]) -> f64),
    /// From the markers and then the parameters.
    Program(Program),
}

/// D^p/(D^p + D_h^p), 0 at D = 0.
fn saturating(width: f64, half_width: f64, exponent: f64) -> f64 {
    if width > 0.0 { 1.0 / (1.0 + (half_width / width).powf(exponent)) } else { 0.0 }
}

/// (φ/φ_c)^a (1 - φ/φ_c)^b, 0 outside 0 < φ < φ_c.
fn hump(fraction: f64, rise: f64, fall: f64, closing: f64) -> f64 {
    let share = fraction / closing;
    if share > 0.0 && share < 1.0 { share.powf(rise) * (1.0 - share).powf(fall) } else { 0.0 }
}

/// Drag correction that grows with the filtered slip, as Milioli et al. (2013) and Sarkar et al. (2016)
/// found: H = H_∞ D^p/(D^p + D_h^p) V/(V + V_h) (1 - e^(-φ/φ_r)) (1 - (φ/φ_c)^m), in [0, 1).
pub static SLIP_DRAG: FormulaForm = FormulaForm {
    name: "slip_drag",
    formula: "H = H_inf * D^p/(D^p + D_h^p) * V/(V + V_h) * (1 - exp(-phi/phi_r)) * \
              (1 - (phi/phi_c)^m); H = 0 for phi >= phi_c",
    expression: "piecewise(phi <= 0, 0, D <= 0, 0, phi >= phi_c, 0, \
                 H_inf/(1 + (D_h/D)^p) * V/(V + V_h) * (1 - exp(-phi/phi_r)) * (1 - (phi/phi_c)^m))",
    quantity: "drag_correction",
    unit: "-",
    image: (0.0, 1.0),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth, Marker::Slip],
    parameters: &[
        parameter("half_width", "D_h", 1.363, Positive),
        parameter("rise_fraction", "phi_r", 0.00215, Positive),
        parameter("plateau", "H_inf", 0.9, Between(0.0, 1.0)),
        parameter("half_slip", "V_h", 0.2, Positive),
        parameter("fall_exponent", "m", 4.81, Positive),
        parameter("exponent", "p", 1.297, Positive),
        parameter("closing_fraction", "phi_c", 0.5275, Between(0.4, 0.75)),
    ],
    predict: Predict::Function(|p, m| {
        let closeness = m[0] / p[6];
        if !(m[0] > 0.0 && closeness < 1.0) {
            return 0.0;
        }
        let slip = m[2].max(0.0);
        let shape = -(-m[0] / p[1]).exp_m1() * (1.0 - closeness.powf(p[4]));
        p[2] * saturating(m[1], p[0], p[5]) * slip / (slip + p[3]) * shape
    }),
};

/// Drift velocity per slip, v_d/s = -g(D) h(φ), as Parmentier et al. (2012) and Ozel et al. (2013) write
/// it, with g = D^p/(D^p + D_h^p) and h = K (φ/φ_c)^a (1 - φ/φ_c)^b.
pub static DRIFT_VELOCITY: FormulaForm = FormulaForm {
    name: "drift_velocity",
    formula: "v_d/s = -K * D^p/(D^p + D_h^p) * (phi/phi_c)^a * (1 - phi/phi_c)^b",
    expression: "piecewise(phi <= 0, 0, D <= 0, 0, phi >= phi_c, 0, \
                 0 - K/(1 + (D_h/D)^p) * (phi/phi_c)^a * (1 - phi/phi_c)^b)",
    quantity: "drift_velocity_slope",
    unit: "-",
    image: (f64::NEG_INFINITY, 0.0),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth],
    parameters: &[
        parameter("half_width", "D_h", 1.5, Positive),
        parameter("amplitude", "K", 1.5, Positive),
        parameter("fall", "b", 1.0, Positive),
        parameter("rise", "a", 0.3, Positive),
        parameter("exponent", "p", 1.3, Positive),
        parameter("closing_fraction", "phi_c", 0.63, Between(0.4, 0.75)),
    ],
    predict: Predict::Function(|p, m| {
        -p[1] * saturating(m[1], p[0], p[4]) * hump(m[0], p[3], p[2], p[5])
    }),
};

/// Drift velocity linear in the slip and in the filtered pressure gradient, the latter an apparent added
/// mass: v_d/u_t = -D^p/(D^p + D_h^p) (φ/φ_c)^a (1 - φ/φ_c)^b (K V + M G).
pub static DRIFT_PRESSURE: FormulaForm = FormulaForm {
    name: "drift_pressure",
    formula: "v_d/u_t = -D^p/(D^p + D_h^p) * (phi/phi_c)^a * (1 - phi/phi_c)^b * (K*V + M*G)",
    expression: "piecewise(phi <= 0, 0, D <= 0, 0, phi >= phi_c, 0, \
                 0 - 1/(1 + (D_h/D)^p) * (phi/phi_c)^a * (1 - phi/phi_c)^b * (K*V + M*G))",
    quantity: "drift_velocity",
    unit: "u_t",
    image: (f64::NEG_INFINITY, f64::INFINITY),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth, Marker::Slip, Marker::PressureGradient],
    parameters: &[
        parameter("slip_share", "K", 1.0, Any),
        parameter("added_mass", "M", 0.5, Any),
        parameter("half_width", "D_h", 1.5, Positive),
        parameter("fall", "b", 1.0, Positive),
        parameter("rise", "a", 0.3, Positive),
        parameter("exponent", "p", 1.3, Positive),
        parameter("closing_fraction", "phi_c", 0.63, Between(0.4, 0.75)),
    ],
    predict: Predict::Function(|p, m| {
        let shape = saturating(m[1], p[2], p[5]) * hump(m[0], p[4], p[3], p[6]);
        -shape * (p[0] * m[2] + p[1] * m[3])
    }),
};

/// Smagorinsky coefficient C_μ(φ) = C (φ/φ_c)^a (1 - φ/φ_c)^b of ρ_s Δ_f² S, as Milioli et al. and Sarkar et
/// al. have it with a power or polynomial of φ.
pub static SMAGORINSKY: FormulaForm = FormulaForm {
    name: "smagorinsky",
    formula: "C_mu = C * (phi/phi_c)^a * (1 - phi/phi_c)^b",
    expression: "piecewise(phi <= 0, 0, phi >= phi_c, 0, C*(phi/phi_c)^a*(1 - phi/phi_c)^b)",
    quantity: "smagorinsky_viscosity",
    unit: "-",
    image: (0.0, f64::INFINITY),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth],
    parameters: &[
        parameter("coefficient", "C", 0.1, Positive),
        parameter("rise", "a", 1.0, Positive),
        parameter("fall", "b", 1.0, Positive),
        parameter("closing_fraction", "phi_c", 0.63, Between(0.4, 0.75)),
    ],
    predict: Predict::Function(|p, m| p[0] * hump(m[0], p[1], p[2], p[3])),
};

const POWERS: &[Parameter] = &[
    parameter("amplitude", "A", 0.01, Positive),
    parameter("width_exponent", "n", 1.5, Positive),
    parameter("fraction_exponent", "a", 1.0, Positive),
    parameter("shear_exponent", "k", 1.0, Any),
];

/// A φ^a D^n S^k, 0 where φ, D or S is.
fn powers(p: &[f64], m: &[f64]) -> f64 {
    if m[0] > 0.0 && m[1] > 0.0 && m[2] > 0.0 {
        p[0] * m[0].powf(p[2]) * m[1].powf(p[1]) * m[2].powf(p[3])
    } else {
        0.0
    }
}

const POWERS_EXPRESSION: &str =
    "piecewise(phi <= 0, 0, D <= 0, 0, S <= 0, 0, A * phi^a * D^n * S^k)";

/// Filtered solids viscosity over ρ_s u_t³/g as a power law, A φ^a D^n S^k: Smagorinsky's has n = 2, k = 1,
/// Igci et al. (2011) n = 8/7 without S.
pub static VISCOSITY_POWER: FormulaForm = FormulaForm {
    name: "viscosity_power",
    formula: "mu = A * phi^a * D^n * S^k",
    expression: POWERS_EXPRESSION,
    quantity: "solids_viscosity",
    unit: "rho_s u_t^3/g",
    image: (0.0, f64::INFINITY),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth, Marker::ShearRate],
    parameters: POWERS,
    predict: Predict::Function(powers),
};

/// Filtered solids pressure over ρ_s u_t² as a power law, A φ^a D^n S^k: Smagorinsky's has n = k = 2.
pub static PRESSURE_POWER: FormulaForm = FormulaForm {
    name: "pressure_power",
    formula: "p = A * phi^a * D^n * S^k",
    expression: POWERS_EXPRESSION,
    quantity: "solids_pressure",
    unit: "rho_s u_t^2",
    image: (0.0, f64::INFINITY),
    markers: &[Marker::SolidsFraction, Marker::FilterWidth, Marker::ShearRate],
    parameters: POWERS,
    predict: Predict::Function(powers),
};

/// ∂ predict/∂ parameter by central differences, whose error is some 1e-9 of the value.
fn differences(form: &dyn ClosureForm, parameters: &[f64], markers: &[f64], gradient: &mut [f64]) {
    let mut moved = parameters.to_vec();
    for (k, gradient) in gradient.iter_mut().enumerate() {
        let bounds = form.parameters()[k].bounds;
        let free = bounds.free(parameters[k]);
        let step = 1e-5 * free.abs().max(1.0);
        let (low, high) = (bounds.value(free - step), bounds.value(free + step));
        moved[k] = high;
        let above = form.predict(&moved, markers);
        moved[k] = low;
        let below = form.predict(&moved, markers);
        moved[k] = parameters[k];
        *gradient = if high > low { (above - below) / (high - low) } else { 0.0 };
    }
}

impl ClosureForm for FormulaForm {
    fn name(&self) -> &'static str {
        self.name
    }

    fn formula(&self) -> &'static str {
        self.formula
    }

    fn expression(&self) -> &'static str {
        self.expression
    }

    fn quantity(&self) -> &'static str {
        self.quantity
    }

    fn unit(&self) -> &'static str {
        self.unit
    }

    fn image(&self) -> (f64, f64) {
        self.image
    }

    fn markers(&self) -> &'static [Marker] {
        self.markers
    }

    fn parameters(&self) -> &'static [Parameter] {
        self.parameters
    }

    fn predict(&self, parameters: &[f64], markers: &[f64]) -> f64 {
        match &self.predict {
            Predict::Function(function) => function(parameters, markers),
            Predict::Program(program) => program.at(&[markers, parameters].concat()),
        }
    }

    fn gradient(&self, parameters: &[f64], markers: &[f64], gradient: &mut [f64]) {
        differences(self, parameters, markers, gradient);
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UserFile {
    name: String,
    predicts: String,
    unit: String,
    markers: Vec<Marker>,
    formula: String,
    parameters: Vec<UserParameter>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UserParameter {
    name: String,
    start: f64,
    low: Option<f64>,
    high: Option<f64>,
}

impl FormulaForm {
    /// Reads a form of the user's own, which then lives as long as the program does. A TOML file:
    ///
    /// ```toml
    /// name = "mine"
    /// predicts = "drag_correction"
    /// unit = "-"
    /// markers = ["solids_fraction", "filter_width"]
    /// formula = "a*D/(D + b)*(1 - phi/0.65)"
    ///
    /// [[parameters]]
    /// name = "a"
    /// start = 0.8
    /// low = 0.0                  # with high: between them
    /// high = 1.0
    ///
    /// [[parameters]]
    /// name = "b"
    /// start = 1.0
    /// low = 0.0                  # alone, and 0: positive
    /// ```
    ///
    /// # Errors
    /// Key, what is wrong with it and what would be right.
    pub fn parse(text: &str) -> Result<&'static Self, String> {
        let file: UserFile = toml::from_str(text).map_err(|error| error.to_string())?;
        if file.parameters.is_empty() {
            return Err("parameters: there is none to be fitted".into());
        }
        let mut parameters: Vec<Parameter> = Vec::new();
        for UserParameter { name, start, low, high } in file.parameters {
            let taken = Marker::of_symbol(&name).is_some();
            if taken || parameters.iter().any(|other| other.symbol == name) {
                return Err(format!("parameter {name}: the name means something already"));
            }
            let bounds = match (low, high) {
                (None, None) => Any,
                (Some(0.0), None) => Positive,
                (Some(low), Some(high)) if low < high => Between(low, high),
                _ => {
                    let message = "low and high in order, low = 0 alone, or neither is needed";
                    return Err(format!("parameter {name}: {message}"));
                }
            };
            if !bounds.contains(start) {
                return Err(format!("parameter {name}: start = {start} is not inside its bounds"));
            }
            let name: &'static str = name.leak();
            parameters.push(Parameter { name, symbol: name, unit: "-", default: start, bounds });
        }
        for needed in [Marker::SolidsFraction, Marker::FilterWidth] {
            if !file.markers.contains(&needed) {
                return Err(format!("markers: {needed} is needed, every bin has it"));
            }
        }
        let formula = Expression::parse(&file.formula).map_err(|why| format!("formula: {why}"))?;
        let markers = file.markers;
        let inputs = markers.len() + parameters.len();
        let program = Program::compile(&formula, inputs, &|name| {
            let marker = markers.iter().position(|marker| marker.symbol() == name);
            let parameter = || parameters.iter().position(|parameter| parameter.symbol == name);
            marker.or_else(|| Some(markers.len() + parameter()?)).map(Meaning::Input)
        })
        .map_err(|why| {
            let symbols = MARKERS.map(|(_, name, symbol)| format!("{symbol} ({name})")).join(", ");
            format!("formula: {why}; markers are {symbols}")
        })?;
        let text: &'static str = file.formula.leak();
        Ok(Box::leak(Box::new(Self {
            name: file.name.leak(),
            formula: text,
            quantity: file.predicts.leak(),
            unit: file.unit.leak(),
            expression: text,
            image: (f64::NEG_INFINITY, f64::INFINITY),
            markers: markers.leak(),
            parameters: parameters.leak(),
            predict: Predict::Program(program),
        })))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::forms::FORMS;

    /// The Rust of each form and its expression, which exports are made from, are one.
    #[test]
    fn expressions_say_what_is_computed() {
        for form in FORMS {
            let expression = Expression::parse(form.expression()).unwrap();
            let markers = form.markers();
            let program = Program::compile(&expression, markers.len(), &|name| {
                let marker = markers.iter().position(|marker| marker.symbol() == name);
                let constant = form.parameters().iter().find(|p| p.symbol == name);
                let constant = constant.map(|p| Meaning::Constant(p.default));
                marker.map(Meaning::Input).or(constant)
            })
            .unwrap();
            let defaults: Vec<f64> = form.parameters().iter().map(|p| p.default).collect();
            for phi in [0.0, 0.001, 0.1, 0.35, 0.52, 0.7] {
                for width in [0.0, 0.5, 3.0, 20.0] {
                    for other in [0.2, 1.5] {
                        let point = &[phi, width, other, 0.7 * other][..markers.len()];
                        let (a, b) = (program.at(point), form.predict(&defaults, point));
                        let name = form.name();
                        assert!(
                            (a - b).abs() <= 1e-13 * (1.0 + a.abs()),
                            "{name} {point:?} {a} {b}"
                        );
                        let (low, high) = form.image();
                        assert!(low <= b && b <= high, "{name} {point:?}: {b}");
                        // Nothing below a filter of no width, and nothing of no solids.
                        if phi == 0.0 || (width == 0.0 && name != "smagorinsky") {
                            assert_eq!(b, 0.0, "{name}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn a_users_form_is_read_or_refused() {
        let good = "name = \"mine\"\npredicts = \"drag_correction\"\nunit = \"-\"\n\
                    markers = [\"solids_fraction\", \"filter_width\"]\n\
                    formula = \"a*D/(D + b)*(1 - phi)\"\n\
                    [[parameters]]\nname = \"a\"\nstart = 0.8\nlow = 0.0\nhigh = 1.0\n\
                    [[parameters]]\nname = \"b\"\nstart = 1.0\nlow = 0.0\n";
        let form = FormulaForm::parse(good).unwrap();
        assert_eq!(form.predict(&[0.5, 1.0], &[0.2, 3.0]), 0.5 * 0.75 * 0.8);
        let mut gradient = [0.0; 2];
        form.gradient(&[0.5, 1.0], &[0.2, 3.0], &mut gradient);
        assert!((gradient[0] - 0.6).abs() < 1e-9 && (gradient[1] + 0.075).abs() < 1e-9);
        for (from, to, why) in [
            ("a*D", "c*D", "formula: `c` is not known here; markers are phi (solids_fraction)"),
            ("start = 0.8", "start = 1.8", "parameter a: start = 1.8 is not inside its bounds"),
            ("low = 0.0\nhigh = 1.0", "high = 1.0", "parameter a: low and high in order"),
            ("name = \"a\"", "name = \"phi\"", "parameter phi: the name means something already"),
            ("\"solids_fraction\", ", "", "markers: solids_fraction is needed"),
            ("unit =", "unti =", "unknown field `unti`"),
        ] {
            assert!(good.contains(from), "{from}");
            let found = FormulaForm::parse(&good.replacen(from, to, 1)).unwrap_err();
            assert!(found.contains(why), "{found}");
        }
    }
}
