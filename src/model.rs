//! [`Model`]: a fitted shape over φ and Δ_f of a run's powder, and the closure table made of it.
//!
//! On disk it is a closure like any other, see `closure`.

use crate::fit::ReferenceLength;
use crate::forms::Marker;
use crate::laws::scales::{Gas, Powder, Scales};
use crate::refit::{Candidate, Estimate};
use crate::table::{BinRow, ClosureRow, Origin};
use serde::{Deserialize, Serialize};

/// A fitted closure of a run.
#[derive(Clone, Debug)]
pub struct Model {
    /// Quantity predicted, as in the bin table.
    pub predicts: String,
    /// Unit of that quantity; `-` for a number.
    pub unit: String,
    /// What Δ_f is scaled by.
    pub reference_length: ReferenceLength,
    /// What was fitted, with its replicates.
    pub candidate: Candidate,
    /// Powder, gas and their scales.
    pub system: System,
}

/// What happens outside the valid ranges.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Outside {
    /// Each marker is moved to the nearest end of its range.
    Clamp,
    /// The formula is taken as it stands, which says what it gives there.
    Formula,
}

/// The run that a model comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Name of the case.
    pub reference: String,
    /// Version of the program that fitted it.
    pub version: String,
    /// Seed of the run.
    pub seed: Option<u64>,
}

/// Powder, gas and their scales.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct System {
    /// Particle diameter d \[m\].
    pub diameter: f64,
    /// Particle density ρ_s [kg/m³].
    pub particle_density: f64,
    /// Restitution coefficient [-].
    pub restitution: f64,
    /// Solids fraction of the densest packing [-].
    pub max_packing: f64,
    /// Gas density ρ_g [kg/m³].
    pub gas_density: f64,
    /// Gas viscosity μ_g [Pa·s].
    pub gas_viscosity: f64,
    /// Gravity g [m/s²].
    pub gravity: f64,
    /// True terminal velocity u_t [m/s].
    pub terminal_velocity: f64,
    /// Fr_p = u_t²/(g d) [-].
    pub froude: f64,
    /// L_I = u_t²/g \[m\].
    pub length_i: f64,
    /// L_II = d Fr_p^(1/3) \[m\].
    pub length_ii: f64,
}

impl System {
    /// The powder.
    pub fn powder(&self) -> Powder {
        Powder {
            diameter: self.diameter,
            density: self.particle_density,
            restitution: self.restitution,
            max_packing: self.max_packing,
        }
    }

    /// The gas.
    pub fn gas(&self) -> Gas {
        Gas { density: self.gas_density, viscosity: self.gas_viscosity }
    }

    /// The system of `powder` and `gas` with their `scales`.
    pub fn new(powder: &Powder, gas: &Gas, scales: &Scales) -> Self {
        Self {
            diameter: powder.diameter,
            particle_density: powder.density,
            restitution: powder.restitution,
            max_packing: powder.max_packing,
            gas_density: gas.density,
            gas_viscosity: gas.viscosity,
            gravity: scales.gravity,
            terminal_velocity: scales.terminal_velocity,
            froude: scales.froude,
            length_i: scales.length_i(),
            length_ii: scales.length_ii(),
        }
    }

    /// The reference length L \[m\].
    pub fn length(&self, reference: ReferenceLength) -> f64 {
        match reference {
            ReferenceLength::One => self.length_i,
            ReferenceLength::Two => self.length_ii,
        }
    }
}

/// Definitions used, in words: the traps of this field are conventions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Definitions {
    /// u_t.
    pub terminal_velocity: String,
    /// Δ_f.
    pub filter_width: String,
    /// S.
    pub shear_rate: String,
    /// H.
    pub drag_correction: String,
    /// Fine-grid drag law whose drag is corrected.
    pub drag: String,
}

impl Definitions {
    /// Those of this crate, for the fine-grid drag law named `drag`.
    pub fn favre(drag: &str) -> Self {
        Self {
            terminal_velocity: "true terminal velocity of one sphere (Wen-Yu drag solved), not \
                                the Stokes value"
                .into(),
            filter_width: "edge of the box filter; scaled: divided by reference_length, \
                           L_I = u_t^2/g, L_II = d Fr_p^(1/3)"
                .into(),
            shear_rate: "S = sqrt(2 Sd:Sd), Sd the deviatoric symmetric gradient of the \
                         Favre-filtered solids velocity"
                .into(),
            drag_correction: "H = 1 - beta_filtered/beta_micro(filtered phi, filtered slip), \
                              vertical, with the pressure-fluctuation term; multiply the drag by \
                              (1 - H)"
                .into(),
            drag: drag.into(),
        }
    }
}

impl Model {
    /// The model that `candidate` is for `system`.
    pub fn new(candidate: Candidate, system: System) -> Self {
        let fitted = &candidate.fitted;
        Self {
            predicts: fitted.quantity().into(),
            unit: fitted.unit().into(),
            reference_length: fitted.reference_length(),
            candidate,
            system,
        }
    }

    /// The value at solids fraction `solids_fraction` and filter width `filter_width_scaled` =
    /// Δ_f/L, both clamped to the valid ranges; NaN if it depends on another marker.
    pub fn evaluate(&self, solids_fraction: f64, filter_width_scaled: f64) -> f64 {
        self.candidate.fitted.at(&self.markers(solids_fraction, filter_width_scaled))
    }

    /// The value as for [`evaluate`](Self::evaluate), with its error.
    pub fn evaluate_with_error(&self, solids_fraction: f64, filter_width_scaled: f64) -> Estimate {
        self.candidate.estimate(&self.markers(solids_fraction, filter_width_scaled))
    }

    /// Whether a point lies inside the valid ranges.
    pub fn is_inside(&self, solids_fraction: f64, filter_width_scaled: f64) -> bool {
        let markers = self.markers(solids_fraction, filter_width_scaled);
        let ranges = self.candidate.fitted.ranges().iter();
        ranges.zip(markers).all(|(range, x)| (range.low..=range.high).contains(&x))
    }

    /// Ends of the valid range of a marker; everything if the form does not have it.
    pub fn range(&self, marker: Marker) -> (f64, f64) {
        let mut ranges = self.candidate.fitted.ranges().iter();
        ranges
            .find(|range| range.marker == marker)
            .map_or((0.0, f64::INFINITY), |range| (range.low, range.high))
    }

    fn markers(&self, solids_fraction: f64, filter_width_scaled: f64) -> Vec<f64> {
        let of = |marker: Marker| match marker {
            Marker::SolidsFraction => solids_fraction,
            Marker::FilterWidth => filter_width_scaled,
            // A table of bins has no other marker.
            _ => f64::NAN,
        };
        self.candidate.fitted.ranges().iter().map(|range| of(range.marker)).collect()
    }
}

/// Scaled filter widths of a closure table, beside those of the run.
const TABLE_WIDTHS: [f64; 15] =
    [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0];

/// The closure table of a model, which a coarse solver interpolates: a full grid of solids
/// fractions 0, 0.01, ... up to the end of the valid range, for each of the run's filter widths
/// `widths` \[m\] and for round scaled widths inside the valid range.
pub fn closure_rows(model: &Model, widths: &[f64]) -> Vec<ClosureRow> {
    let length = model.system.length(model.reference_length);
    let (narrowest, widest) = model.range(Marker::FilterWidth);
    let mut widths = widths.to_vec();
    for width in TABLE_WIDTHS {
        // A round width next to one of the run's would only give a solver a tiny interval.
        let near = |other: &f64| (other / (width * length) - 1.0).abs() < 0.05;
        if (narrowest..=widest).contains(&width) && !widths.iter().any(near) {
            widths.push(width * length);
        }
    }
    widths.sort_by(f64::total_cmp);
    widths.dedup();
    let densest = model.range(Marker::SolidsFraction).1.min(1.0);
    let mut rows = Vec::new();
    for width in widths {
        // Metres over metres may miss the end of the range by a rounding.
        let mut scaled = width / length;
        for end in [narrowest, widest] {
            if (scaled / end - 1.0).abs() < 1e-12 {
                scaled = end;
            }
        }
        for i in 0..=(densest * 100.0 + 1e-9) as usize {
            let solids_fraction = i as f64 / 100.0;
            let estimate = model.evaluate_with_error(solids_fraction, scaled);
            rows.push(ClosureRow {
                quantity: model.predicts.clone(),
                unit: model.unit.clone(),
                origin: Origin::Fit,
                filter_width: width,
                filter_width_l_i: width / model.system.length_i,
                filter_width_l_ii: width / model.system.length_ii,
                solids_fraction,
                value: estimate.value,
                standard_error: estimate.standard_error,
                low_95: estimate.low_95,
                high_95: estimate.high_95,
                // The last round fraction may exceed the end by a rounding too.
                inside_range: model.is_inside(solids_fraction.min(densest), scaled),
            });
        }
    }
    rows
}

/// Closure rows of binned quantities that have no form, such as the filtered solids viscosity: the
/// bins as they are, at their mean solids fraction.
pub fn binned_closure_rows(bins: &[BinRow]) -> Vec<ClosureRow> {
    bins.iter()
        .map(|bin| ClosureRow {
            quantity: bin.quantity.clone(),
            unit: bin.unit.clone(),
            origin: Origin::Bins,
            filter_width: bin.filter_width,
            filter_width_l_i: bin.filter_width_l_i,
            filter_width_l_ii: bin.filter_width_l_ii,
            solids_fraction: bin.solids_fraction,
            value: bin.value,
            standard_error: bin.standard_error,
            low_95: bin.low_95,
            high_95: bin.high_95,
            inside_range: true,
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fit::Fit;
    use crate::fit::tests::{PLANTED, WIDTHS, fitted, synthetic};
    use crate::forms::{ClosureForm, SaturatingDrag};
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::refit::Fitted;

    /// Of a fit, without replicates.
    pub(crate) fn candidate(fit: Fit) -> Candidate {
        Candidate::new(Fitted::Form(fit), Vec::new(), None)
    }

    /// A model of the planted parameters with noise.
    pub(crate) fn model() -> Model {
        let scales = Scales::new(&POWDER, &GAS, 9.81);
        let fit = fitted(&synthetic(&WIDTHS, 0.58, 0.02, 1));
        Model::new(candidate(fit), System::new(&POWDER, &GAS, &scales))
    }

    #[test]
    fn markers_are_clamped_outside_the_ranges() {
        let model = model();
        assert_eq!(model.evaluate(0.2, 1e3), model.evaluate(0.2, 16.0));
        assert_eq!(model.evaluate(0.2, 0.0), 0.0);
        assert_eq!(model.evaluate(0.2, -1.0), 0.0);
        let densest = model.range(Marker::SolidsFraction).1;
        assert_eq!(model.evaluate(0.9, 4.0), model.evaluate(densest, 4.0));
        assert_eq!(model.evaluate(-1.0, 4.0), 0.0);
        assert!(model.is_inside(0.2, 4.0));
        assert!(!model.is_inside(0.2, 17.0) && !model.is_inside(0.6, 4.0));
    }

    #[test]
    fn intervals_of_the_curve_cover_the_planted_one() {
        let points = [[0.05, 1.0], [0.1, 4.0], [0.3, 2.0], [0.4, 16.0], [0.5, 8.0]];
        let mut covered = [0; 5];
        let scales = Scales::new(&POWDER, &GAS, 9.81);
        for seed in 0..100 {
            let fit = fitted(&synthetic(&WIDTHS, 0.58, 0.02, 1000 + seed));
            let model = Model::new(candidate(fit), System::new(&POWDER, &GAS, &scales));
            for (count, point) in covered.iter_mut().zip(&points) {
                let exact = SaturatingDrag.predict(&PLANTED, point);
                let found = model.evaluate_with_error(point[0], point[1]);
                assert!(0.0 <= found.low_95 && found.high_95 <= 1.0);
                *count += u32::from(found.low_95 <= exact && exact <= found.high_95);
            }
        }
        assert!(covered.iter().all(|c| (88..=99).contains(c)), "{covered:?}");
    }

    #[test]
    fn closure_rows_are_a_full_grid_of_run_and_round_widths() {
        let model = model();
        let length = model.system.length_i;
        let run: Vec<f64> = WIDTHS.iter().map(|w| w * length).collect();
        let rows = closure_rows(&model, &run);
        // 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 12, 16 times 0 to 0.58.
        assert_eq!(rows.len(), 12 * 59);
        assert!(rows.iter().all(|r| r.inside_range));
        assert!(rows.windows(2).all(|r| {
            (r[0].filter_width, r[0].solids_fraction) < (r[1].filter_width, r[1].solids_fraction)
        }));
        for row in &rows {
            let scaled = row.filter_width_l_i.clamp(0.0, 16.0);
            let deviation = row.value - model.evaluate(row.solids_fraction, scaled);
            assert!(deviation.abs() < 1e-13);
            assert!(row.low_95 <= row.value && row.value <= row.high_95);
        }
        let beyond = closure_rows(&model, &[40.0 * length]);
        assert!(!beyond.last().unwrap().inside_range);
        let mut bytes = Vec::new();
        crate::table::write_rows(&rows, &mut bytes).unwrap();
        let header = String::from_utf8(bytes).unwrap();
        assert!(header.starts_with(
            "quantity,unit,origin,filter_width [m],filter_width/L_I [-],filter_width/L_II [-],\
             solids_fraction [-],value,standard_error,low_95,high_95,inside_range\n\
             drag_correction,-,fit,"
        ));
    }

    #[test]
    fn binned_quantities_pass_through() {
        let bins = synthetic(&[2.0], 0.1, 0.01, 1);
        let rows = binned_closure_rows(&bins);
        assert_eq!(rows.len(), bins.len());
        assert_eq!((rows[3].origin, rows[3].value), (Origin::Bins, bins[3].value));
    }
}
