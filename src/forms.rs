//! Closure forms: what is fitted at the coarse scale.
//!
//! A form gives a filtered quantity as a function of markers (what a coarse solver knows in a
//! cell) and parameters (what the fit finds). It knows no data and no file. A second form is one
//! more implementor of [`ClosureForm`] and one more entry in [`FORMS`].

mod formula;

pub use formula::FormulaForm;

use serde::{Deserialize, Serialize};

/// What a coarse solver knows in a cell and a closure depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Marker {
    /// Filtered solids fraction φ [-].
    SolidsFraction,
    /// Filter width over the model's reference length, Δ_f/L [-].
    FilterWidth,
    /// Filtered slip speed over u_t [-].
    Slip,
    /// Shear rate of the filtered solids velocity, S u_t/g [-], S = √(2 Sd:Sd).
    ShearRate,
    /// The same of the filtered gas velocity [-].
    GasShearRate,
    /// Distance from the wall times g/u_t² [-].
    WallDistance,
    /// Vertical filtered pressure gradient over ρ_s g [-].
    PressureGradient,
}

/// All markers, each with its name in files and its symbol in formulae.
pub const MARKERS: [(Marker, &str, &str); 7] = [
    (Marker::SolidsFraction, "solids_fraction", "phi"),
    (Marker::FilterWidth, "filter_width", "D"),
    (Marker::Slip, "slip", "V"),
    (Marker::ShearRate, "shear_rate", "S"),
    (Marker::GasShearRate, "gas_shear_rate", "S_g"),
    (Marker::WallDistance, "wall_distance", "X"),
    (Marker::PressureGradient, "pressure_gradient", "G"),
];

impl Marker {
    /// Its symbol in formulae.
    pub fn symbol(self) -> &'static str {
        MARKERS[self as usize].2
    }

    /// The marker of a symbol.
    pub fn of_symbol(symbol: &str) -> Option<Self> {
        MARKERS.iter().find(|(_, _, known)| *known == symbol).map(|(marker, ..)| *marker)
    }
}

impl std::fmt::Display for Marker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(MARKERS[*self as usize].1)
    }
}

/// Open interval in which a parameter lies, by construction of the form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bounds {
    /// x > 0; fitted as its logarithm.
    Positive,
    /// Between two numbers; fitted as its logit.
    Between(f64, f64),
    /// Any number, of order one; fitted as it is.
    Any,
}

/// Largest absolute free coordinate: within, exp and the logistic function neither overflow nor
/// round to a bound (1 - 1/(1 + e^30) is 422 spacings of doubles below 1).
const FREE_LIMIT: f64 = 30.0;

impl Bounds {
    /// The free coordinate, any real number, of a value inside the bounds.
    pub fn free(self, value: f64) -> f64 {
        let free = match self {
            Bounds::Positive => value.ln(),
            Bounds::Between(low, high) => ((value - low) / (high - value)).ln(),
            Bounds::Any => return value,
        };
        free.clamp(-FREE_LIMIT, FREE_LIMIT)
    }

    /// The value inside the bounds at a free coordinate.
    pub fn value(self, free: f64) -> f64 {
        if self == Bounds::Any {
            return free;
        }
        let free = free.clamp(-FREE_LIMIT, FREE_LIMIT);
        match self {
            Bounds::Positive => free.exp(),
            Bounds::Between(low, high) => low + (high - low) / (1.0 + (-free).exp()),
            Bounds::Any => free,
        }
    }

    /// d value / d free, at a value.
    pub fn slope(self, value: f64) -> f64 {
        match self {
            Bounds::Positive => value,
            Bounds::Between(low, high) => (value - low) * (high - value) / (high - low),
            Bounds::Any => 1.0,
        }
    }

    /// Whether a value lies inside.
    pub fn contains(self, value: f64) -> bool {
        match self {
            Bounds::Positive => value > 0.0 && value.is_finite(),
            Bounds::Between(low, high) => value > low && value < high,
            Bounds::Any => value.is_finite(),
        }
    }
}

/// One parameter of a form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameter {
    /// Name in files.
    pub name: &'static str,
    /// Symbol in the form's formula.
    pub symbol: &'static str,
    /// Unit; `-` for a number.
    pub unit: &'static str,
    /// Value taken when the data do not fix it.
    pub default: f64,
    /// Where it lies.
    pub bounds: Bounds,
}

const fn parameter(
    name: &'static str,
    symbol: &'static str,
    default: f64,
    bounds: Bounds,
) -> Parameter {
    Parameter { name, symbol, unit: "-", default, bounds }
}

/// A closure form. Implementors hold no data of a fit.
pub trait ClosureForm: std::fmt::Debug + Sync {
    /// Name in model files.
    fn name(&self) -> &'static str;

    /// The formula, in the symbols of the parameters and markers.
    fn formula(&self) -> &'static str;

    /// The formula in the language of [`Expression`](crate::expression::Expression), the parameters by
    /// their symbols: what an export is made from.
    fn expression(&self) -> &'static str;

    /// Quantity that the form describes, as in the bin table.
    fn quantity(&self) -> &'static str;

    /// What a value is scaled by; `-` for a number.
    fn unit(&self) -> &'static str;

    /// Smallest and largest value that the quantity can have.
    fn image(&self) -> (f64, f64);

    /// The markers, in the order in which [`predict`](Self::predict) takes them.
    fn markers(&self) -> &'static [Marker];

    /// The parameters, in the order in which [`predict`](Self::predict) takes them: the most
    /// essential first. Where the data cannot fix them all, the fit holds the last ones.
    fn parameters(&self) -> &'static [Parameter];

    /// The quantity at `markers`, each ≥ 0, for `parameters` inside their bounds.
    fn predict(&self, parameters: &[f64], markers: &[f64]) -> f64;

    /// ∂ predict / ∂ parameter, into `gradient` (one number for each parameter).
    fn gradient(&self, parameters: &[f64], markers: &[f64], gradient: &mut [f64]);
}

/// All forms, by which a model file's form is looked up.
pub const FORMS: [&dyn ClosureForm; 7] = [
    &SaturatingDrag,
    &formula::SLIP_DRAG,
    &formula::DRIFT_VELOCITY,
    &formula::DRIFT_PRESSURE,
    &formula::SMAGORINSKY,
    &formula::VISCOSITY_POWER,
    &formula::PRESSURE_POWER,
];

/// The form named `name`, if there is one.
pub fn form(name: &str) -> Option<&'static dyn ClosureForm> {
    FORMS.into_iter().find(|form| form.name() == name)
}

/// Drag correction H(φ, D), D = Δ_f/L, as a product of three saturating factors:
///
/// H = H_∞ · D^p/(D^p + D_h^p) · [1 - exp(-φ/φ_r)] · [1 - (φ/φ_c)^m]
///
/// 0 ≤ H < 1 everywhere, continuous, zero at D = 0, at φ = 0 and from φ = φ_c on. The first factor
/// is that of the published closures (D^p/(D^p + a), a = D_h^p), with the half-width D_h in place
/// of a because a and p are strongly correlated and a has no unit of its own.
///
/// Against Igci & Sundaresan's piecewise table this one formula has a root mean square deviation
/// of 0.018 (2-D) and 0.026 (3-D) for 1 ≤ D ≤ 16, 0.005 ≤ φ ≤ 0.56, and 0.029 against Radl &
/// Sundaresan's. Falls (1 - φ/φ_c)^k leave 0.068, 0.149 and 0.036: they bend near φ = 0 instead of
/// staying flat up to φ_c. A rise φ/(φ + φ_r) leaves 0.019, 0.019 and 0.052: better in 3-D only.
#[derive(Clone, Copy, Debug)]
pub struct SaturatingDrag;

impl SaturatingDrag {
    /// The three factors without H_∞, and φ/φ_c below 1.
    fn factors(parameters: &[f64], markers: &[f64]) -> Option<[f64; 4]> {
        let [half_width, rise, _, fall_exponent, exponent, closing] = six(parameters);
        let (fraction, width) = (markers[0], markers[1]);
        let closeness = fraction / closing;
        if !(fraction > 0.0 && width > 0.0 && closeness < 1.0) {
            return None;
        }
        // As a logistic function of the logarithms, neither power can overflow.
        let width = 1.0 / (1.0 + (exponent * (half_width / width).ln()).exp());
        let rise = -(-fraction / rise).exp_m1();
        let fall = -(fall_exponent * closeness.ln()).exp_m1();
        Some([width, rise, fall, closeness])
    }
}

impl ClosureForm for SaturatingDrag {
    fn name(&self) -> &'static str {
        "saturating_drag"
    }

    fn formula(&self) -> &'static str {
        "H = H_inf * D^p/(D^p + D_h^p) * (1 - exp(-phi/phi_r)) * (1 - (phi/phi_c)^m); \
         H = 0 for phi >= phi_c; D = filter_width/L"
    }

    fn expression(&self) -> &'static str {
        "piecewise(phi <= 0, 0, D <= 0, 0, phi >= phi_c, 0, \
         H_inf/(1 + (D_h/D)^p) * (1 - exp(-phi/phi_r)) * (1 - (phi/phi_c)^m))"
    }

    fn quantity(&self) -> &'static str {
        "drag_correction"
    }

    fn unit(&self) -> &'static str {
        "-"
    }

    fn image(&self) -> (f64, f64) {
        (0.0, 1.0)
    }

    fn markers(&self) -> &'static [Marker] {
        &[Marker::SolidsFraction, Marker::FilterWidth]
    }

    fn parameters(&self) -> &'static [Parameter] {
        // Defaults: Igci & Sundaresan 2011, 2-D, as fitted by this form.
        const PARAMETERS: [Parameter; 6] = [
            parameter("half_width", "D_h", 1.363, Bounds::Positive),
            parameter("rise_fraction", "phi_r", 0.00215, Bounds::Positive),
            parameter("plateau", "H_inf", 0.829, Bounds::Between(0.0, 1.0)),
            parameter("fall_exponent", "m", 4.81, Bounds::Positive),
            parameter("exponent", "p", 1.297, Bounds::Positive),
            parameter("closing_fraction", "phi_c", 0.5275, Bounds::Between(0.4, 0.75)),
        ];
        &PARAMETERS
    }

    fn predict(&self, parameters: &[f64], markers: &[f64]) -> f64 {
        match Self::factors(parameters, markers) {
            Some([width, rise, fall, _]) => parameters[2] * width * rise * fall,
            None => 0.0,
        }
    }

    fn gradient(&self, parameters: &[f64], markers: &[f64], gradient: &mut [f64]) {
        let Some([width, rise, fall, closeness]) = Self::factors(parameters, markers) else {
            gradient.fill(0.0);
            return;
        };
        let [half_width, rise_fraction, plateau, fall_exponent, exponent, closing] =
            six(parameters);
        let power = 1.0 - fall;
        let width_slope = -plateau * width * (1.0 - width) * rise * fall;
        let fall_slope = plateau * width * rise * power;
        gradient[0] = width_slope * exponent / half_width;
        gradient[1] = -plateau * width * fall * (1.0 - rise) * markers[0] / rise_fraction.powi(2);
        gradient[2] = width * rise * fall;
        gradient[3] = -fall_slope * closeness.ln();
        gradient[4] = width_slope * (half_width / markers[1]).ln();
        gradient[5] = fall_slope * fall_exponent / closing;
    }
}

/// The parameters of [`SaturatingDrag`], by position.
fn six(parameters: &[f64]) -> [f64; 6] {
    std::array::from_fn(|i| parameters[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn defaults() -> Vec<f64> {
        SaturatingDrag.parameters().iter().map(|p| p.default).collect()
    }

    /// Any parameters that the fit can reach.
    fn any_parameters() -> impl Strategy<Value = Vec<f64>> {
        prop::collection::vec(-40.0..40.0, 6).prop_map(|free| {
            let bounds = SaturatingDrag.parameters().iter().map(|p| p.bounds);
            bounds.zip(free).map(|(bounds, free)| bounds.value(free)).collect()
        })
    }

    /// Igci & Sundaresan 2011, the two-dimensional drag correction.
    fn igci(phi: f64, width: f64) -> f64 {
        let shape = if phi < 0.0012 {
            2.7 * phi.powf(0.234)
        } else if phi < 0.014 {
            -0.019 * phi.powf(-0.455) + 0.963
        } else if phi < 0.25 {
            0.868 * (-0.38 * phi).exp() - 0.176 * (-119.2 * phi).exp()
        } else if phi < 0.455 {
            -4.59e-5 * (19.75 * phi).exp() + 0.852 * (-0.268 * phi).exp()
        } else {
            (phi - 0.59) * (-1501.0 * phi.powi(3) + 2203.0 * phi.powi(2) - 1054.0 * phi + 162.0)
        };
        width.powf(1.3) / (width.powf(1.3) + 1.5) * shape
    }

    #[test]
    fn defaults_follow_the_published_table() {
        let mut sum = 0.0;
        let mut count = 0.0;
        for width in [1.028, 2.056, 4.112, 8.224, 16.448] {
            for i in 1..=28 {
                let phi = 0.02 * f64::from(i);
                sum +=
                    (SaturatingDrag.predict(&defaults(), &[phi, width]) - igci(phi, width)).powi(2);
                count += 1.0;
            }
        }
        let rms = f64::sqrt(sum / count);
        assert!(rms < 0.02, "root mean square deviation {rms}");
    }

    #[test]
    fn free_coordinates_and_values_are_inverse() {
        for bounds in [Bounds::Positive, Bounds::Between(0.0, 1.0), Bounds::Between(0.4, 0.75)] {
            for i in -20..=20 {
                let free = f64::from(i) * 0.5;
                let value = bounds.value(free);
                assert!(bounds.contains(value));
                assert!((bounds.free(value) - free).abs() < 1e-9, "{bounds:?} {free}");
                let slope = (bounds.value(free + 1e-5) - bounds.value(free - 1e-5)) / 2e-5;
                assert!((bounds.slope(value) - slope).abs() < 1e-6 * slope, "{bounds:?} {free}");
            }
        }
    }

    #[test]
    fn forms_are_found_by_name_and_their_defaults_are_in_bounds() {
        for known in FORMS {
            assert_eq!(form(known.name()).unwrap().name(), known.name());
            assert!(known.parameters().iter().all(|p| p.bounds.contains(p.default)));
        }
        assert!(form("no_such_form").is_none());
    }

    #[test]
    fn gradient_is_that_of_the_formula() {
        let parameters = [1.9, 0.03, 0.8, 3.0, 1.4, 0.6];
        for markers in [[0.01, 0.5], [0.1, 1.0], [0.3, 4.0], [0.55, 16.0]] {
            let mut gradient = [0.0; 6];
            SaturatingDrag.gradient(&parameters, &markers, &mut gradient);
            for k in 0..6 {
                let step = 1e-6 * parameters[k];
                let at = |sign: f64| {
                    let mut moved = parameters;
                    moved[k] += sign * step;
                    SaturatingDrag.predict(&moved, &markers)
                };
                let slope = (at(1.0) - at(-1.0)) / (2.0 * step);
                assert!(
                    (gradient[k] - slope).abs() < 1e-8 * (1.0 + slope.abs()),
                    "parameter {k} at {markers:?}: {} against {slope}",
                    gradient[k]
                );
            }
        }
    }

    #[test]
    fn markers_stand_in_their_own_order() {
        for (i, (marker, name, symbol)) in MARKERS.into_iter().enumerate() {
            assert_eq!(marker as usize, i);
            assert_eq!((marker.to_string().as_str(), marker.symbol()), (name, symbol));
            assert_eq!(Marker::of_symbol(symbol), Some(marker));
            assert_eq!(serde_json::to_string(&marker).unwrap(), format!("\"{name}\""));
        }
    }

    proptest! {
        #[test]
        fn stays_in_zero_to_one(
            parameters in any_parameters(),
            phi in 0.0..1.0,
            width in 0.0..1e6,
        ) {
            let value = SaturatingDrag.predict(&parameters, &[phi, width]);
            prop_assert!((0.0..1.0).contains(&value), "{}", value);
            let mut gradient = [0.0; 6];
            SaturatingDrag.gradient(&parameters, &[phi, width], &mut gradient);
            prop_assert!(gradient.iter().all(|g| g.is_finite()), "{:?}", gradient);
        }

        #[test]
        fn vanishes_at_its_limits_and_grows_with_the_filter(
            phi in 0.001..0.52,
            width in 0.01..100.0,
        ) {
            let form = SaturatingDrag;
            let p = defaults();
            prop_assert_eq!(form.predict(&p, &[0.0, width]), 0.0);
            prop_assert_eq!(form.predict(&p, &[phi, 0.0]), 0.0);
            prop_assert_eq!(form.predict(&p, &[p[5], width]), 0.0);
            prop_assert!(form.predict(&p, &[1e-9, width]) < 1e-5);
            prop_assert!(form.predict(&p, &[phi, 1e-9]) < 1e-9);
            prop_assert!(form.predict(&p, &[p[5] - 1e-9, width]) < 1e-7);
            prop_assert!(form.predict(&p, &[phi, 1.01 * width]) > form.predict(&p, &[phi, width]));
        }
    }
}
