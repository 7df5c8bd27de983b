//! [`compare`]: closures beside each other, and beside one's own bins.

use crate::closure::{Closure, Quantity};
use crate::fit::{ReferenceLength, marker_of};
use crate::forms::Marker;
use crate::table::BinRow;
use serde::Serialize;
use std::fmt;
use std::io::Write;

/// Where closures are compared.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Quantity, as in the bin table.
    pub quantity: String,
    /// Δ_f/L_I; empty: those of the bins, or a few round ones.
    pub filter_widths: Vec<f64>,
    /// Slip / u_t of the curves [-].
    pub slip: f64,
    /// Shear rates × u_t/g of the curves [-].
    pub shear_rate: f64,
}

/// Closures at the same points.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// Quantity.
    pub quantity: String,
    /// What values are scaled by.
    pub unit: String,
    /// L_I/L_II, by which closures of either reference length are put at one filter width.
    pub length_ratio: f64,
    /// Names of the closures.
    pub closures: Vec<String>,
    /// One for each filter width.
    pub panels: Vec<Panel>,
    /// How well each closure meets the bins; empty without bins.
    pub scores: Vec<Score>,
}

/// Closures at one filter width.
#[derive(Clone, Debug, Serialize)]
pub struct Panel {
    /// Δ_f/L_I [-].
    pub filter_width: f64,
    /// Solids fractions of the curves.
    pub fractions: Vec<f64>,
    /// Values of each closure at them.
    pub curves: Vec<Vec<f64>>,
    /// Bins of that width: solids fraction, scaled value, ends of its 95 % interval.
    pub bins: Vec<[f64; 4]>,
}

/// How well a closure meets bins that it was not fitted to, weighted by 1/variance.
#[derive(Clone, Debug, Serialize)]
pub struct Score {
    /// Name of the closure.
    pub closure: String,
    /// Bins compared with.
    pub bins: usize,
    /// Those inside the closure's ranges.
    pub inside: usize,
    /// 1 - Σ w (bin - closure)²/Σ w (bin - mean)² [-].
    pub r_squared: f64,
    /// Root of the weighted mean square of the difference, scaled.
    pub rmse: f64,
    /// Weighted mean of closure - bin, scaled.
    pub bias: f64,
}

/// L_I/L_II = Fr_p^(2/3) of the founding paper's powder, where neither bins nor closures say.
const BASE_RATIO: f64 = 16.143_94;

/// Filter widths without bins, Δ_f/L_I [-].
const ROUND_WIDTHS: [f64; 3] = [2.0, 4.0, 8.0];

/// Compares `closures`, and scores them against `bins` if there are any.
///
/// # Errors
/// A closure without the quantity, closures in other units, bins without usable rows of it.
pub fn compare(
    closures: &[Closure],
    settings: &Settings,
    bins: Option<&[BinRow]>,
) -> Result<Comparison, String> {
    let name = &settings.quantity;
    let mut sought: Vec<(&Closure, &Quantity)> = Vec::new();
    for closure in closures {
        let quantity = closure.quantity(Some(name)).ok_or_else(|| {
            let has: Vec<&str> = closure.quantities.iter().map(|q| &*q.file.predicts).collect();
            let has = if has.is_empty() { "nothing".into() } else { has.join(", ") };
            format!("{} does not predict {name}; it predicts {has}", closure.file.name)
        })?;
        sought.push((closure, quantity));
    }
    let Some((_, first)) = sought.first() else { return Err("no closure is named".into()) };
    let unit = first.file.unit.clone();
    if let Some((other, quantity)) = sought.iter().find(|(_, q)| q.file.unit != unit) {
        let (name, other_unit) = (&other.file.name, &quantity.file.unit);
        return Err(format!("{name} is in {other_unit}, the first closure in {unit}"));
    }
    let rows: Vec<(&BinRow, [f64; 4])> = match bins {
        None => Vec::new(),
        Some(bins) => usable(bins, name)?,
    };
    let length_ratio = match (rows.first(), closures.iter().find_map(|c| c.file.system)) {
        (Some((row, _)), _) => row.filter_width_l_ii / row.filter_width_l_i,
        (None, Some(system)) => system.length_i / system.length_ii,
        (None, None) => BASE_RATIO,
    };
    let mut widths = settings.filter_widths.clone();
    if widths.is_empty() {
        widths = rows.iter().map(|(row, _)| row.filter_width_l_i).collect();
        widths.sort_by(f64::total_cmp);
        widths.dedup_by(|a, b| (*a / *b - 1.0).abs() < 1e-9);
    }
    if widths.is_empty() {
        widths = ROUND_WIDTHS.to_vec();
    }
    let fractions: Vec<f64> = (0..=130).map(|i| f64::from(i) * 0.005).collect();
    let mut panels = Vec::new();
    for width in widths {
        let curve = |(closure, quantity): &(&Closure, &Quantity)| {
            let value = |phi: &f64| {
                let marker = |marker| match marker {
                    Marker::SolidsFraction => *phi,
                    Marker::FilterWidth => match closure.file.reference_length {
                        ReferenceLength::One => width,
                        ReferenceLength::Two => width * length_ratio,
                    },
                    Marker::Slip => settings.slip,
                    Marker::ShearRate | Marker::GasShearRate => settings.shear_rate,
                    Marker::WallDistance | Marker::PressureGradient => f64::NAN,
                };
                quantity.at(&quantity.markers().map(marker).collect::<Vec<_>>())
            };
            fractions.iter().map(value).collect()
        };
        let here = rows.iter().filter(|(row, _)| (row.filter_width_l_i / width - 1.0).abs() < 0.05);
        panels.push(Panel {
            filter_width: width,
            fractions: fractions.clone(),
            curves: sought.iter().map(curve).collect(),
            bins: here.map(|(_, point)| *point).collect(),
        });
    }
    let scores = match rows.is_empty() {
        true => Vec::new(),
        false => sought.iter().map(|(c, q)| score(c, q, &rows)).collect::<Result<_, _>>()?,
    };
    Ok(Comparison {
        quantity: name.clone(),
        unit,
        length_ratio,
        closures: closures.iter().map(|closure| closure.file.name.clone()).collect(),
        panels,
        scores,
    })
}

/// The rows of a quantity with a usable error, and their points in scaled units.
fn usable<'a>(bins: &'a [BinRow], quantity: &str) -> Result<Vec<(&'a BinRow, [f64; 4])>, String> {
    let rows: Vec<&BinRow> = bins.iter().filter(|row| row.quantity == quantity).collect();
    if rows.is_empty() {
        return Err(format!("the bins have no rows of {quantity}"));
    }
    let points: Vec<(&BinRow, [f64; 4])> = rows
        .iter()
        .filter(|row| {
            row.standard_error > 0.0 && row.standard_error.is_finite() && row.value != 0.0
        })
        .map(|row| {
            let scale = row.value_scaled / row.value;
            let point =
                [row.solids_fraction, row.value_scaled, scale * row.low_95, scale * row.high_95];
            (*row, point)
        })
        .collect();
    match points.is_empty() {
        true => {
            Err(format!("no row of {quantity} in the bins has a positive finite standard error"))
        }
        false => Ok(points),
    }
}

fn score(
    closure: &Closure,
    quantity: &Quantity,
    rows: &[(&BinRow, [f64; 4])],
) -> Result<Score, String> {
    let mut inside = 0;
    let mut points = Vec::new();
    for (row, point) in rows {
        let markers: Vec<f64> =
            quantity.markers().map(|m| marker_of(row, m, closure.file.reference_length)).collect();
        let found = quantity.at(&markers);
        if found.is_finite() {
            inside += usize::from(quantity.is_inside(&markers));
            let error = row.standard_error * (row.value_scaled / row.value).abs();
            points.push((point[1], found, error.powi(-2)));
        }
    }
    if points.is_empty() {
        let markers: Vec<String> = quantity.markers().map(|marker| marker.to_string()).collect();
        let name = &closure.file.name;
        return Err(format!("{name} needs {}, which the bins do not give", markers.join(", ")));
    }
    let weight: f64 = points.iter().map(|(.., w)| w).sum();
    let mean = points.iter().map(|(value, _, w)| w * value).sum::<f64>() / weight;
    let spread: f64 = points.iter().map(|(value, _, w)| w * (value - mean).powi(2)).sum();
    let off: f64 = points.iter().map(|(value, found, w)| w * (value - found).powi(2)).sum();
    let bias = points.iter().map(|(value, found, w)| w * (found - value)).sum::<f64>() / weight;
    Ok(Score {
        closure: closure.file.name.clone(),
        bins: points.len(),
        inside,
        r_squared: 1.0 - off / spread,
        rmse: (off / weight).sqrt(),
        bias,
    })
}

impl Comparison {
    /// Every curve and bin as one table.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn write_csv(&self, writer: impl Write) -> Result<(), csv::Error> {
        let mut csv = csv::Writer::from_writer(writer);
        let fixed = ["filter_width/L_I [-]", "solids_fraction [-]"].map(String::from);
        csv.write_record(fixed.iter().chain(&self.closures))?;
        for panel in &self.panels {
            for (i, phi) in panel.fractions.iter().enumerate() {
                let values = panel.curves.iter().map(|curve| curve[i].to_string());
                let fixed = [panel.filter_width.to_string(), phi.to_string()];
                csv.write_record(fixed.into_iter().chain(values))?;
            }
        }
        csv.flush()?;
        Ok(())
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let wide = self.closures.iter().map(String::len).max().unwrap_or(0).max(10);
        writeln!(f, "{} [{}]", self.quantity, self.unit)?;
        for panel in &self.panels {
            write!(f, "\nfilter width {:.3} L_I\n{:wide$}", panel.filter_width, "phi")?;
            let shown: Vec<usize> = [0.01, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.55]
                .map(|phi: f64| (phi / 0.005).round() as usize)
                .to_vec();
            for i in &shown {
                write!(f, " {:>8.2}", panel.fractions[*i])?;
            }
            for (name, curve) in self.closures.iter().zip(&panel.curves) {
                write!(f, "\n{name:wide$}")?;
                for i in &shown {
                    write!(f, " {:>8.4}", curve[*i])?;
                }
            }
            writeln!(f)?;
        }
        if !self.scores.is_empty() {
            writeln!(
                f,
                "\n{:wide$} {:>8} {:>8} {:>10} {:>10} {:>10}",
                "against the bins", "bins", "inside", "R²", "RMSE", "bias"
            )?;
        }
        for score in &self.scores {
            let Score { closure, bins, inside, r_squared, rmse, bias } = score;
            writeln!(
                f,
                "{closure:wide$} {bins:>8} {inside:>8} {r_squared:>10.4} {rmse:>10.4e} {bias:>10.2e}"
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::row;

    fn settings() -> Settings {
        Settings {
            quantity: "drag_correction".into(),
            filter_widths: Vec::new(),
            slip: 1.0,
            shear_rate: 1.0,
        }
    }

    /// Bins that a closure itself made, off by a known amount.
    fn bins(closure: &Closure, off: f64) -> Vec<BinRow> {
        let at = |width: f64, phi: f64| closure.quantities[0].at(&[phi, width]) + off;
        [1.0, 4.0]
            .iter()
            .flat_map(|w| {
                [0.05, 0.1, 0.2, 0.4].map(|phi| row(*w, phi, at(*w, phi), 0.01 * (1.0 + phi)))
            })
            .collect()
    }

    #[test]
    fn scores_are_those_of_a_known_difference() {
        let closures =
            ["igci-sundaresan-2011-3d", "radl-sundaresan-2014"].map(|n| Closure::find(n).unwrap());
        let rows = bins(&closures[0], 0.03);
        let found = compare(&closures, &settings(), Some(&rows)).unwrap();
        assert_eq!(found.panels.len(), 2);
        assert!(found.panels.iter().all(|panel| panel.bins.len() == 4));
        let score = &found.scores[0];
        assert_eq!((score.bins, score.inside), (8, 8));
        assert!((score.rmse - 0.03).abs() < 1e-12 && (score.bias + 0.03).abs() < 1e-12);
        assert!(score.r_squared < 1.0 && score.r_squared > found.scores[1].r_squared);
        let exact = compare(&closures[..1], &settings(), Some(&bins(&closures[0], 0.0))).unwrap();
        assert!((exact.scores[0].r_squared - 1.0).abs() < 1e-12);
        // The same physical width whatever it is scaled by: 4 L_I are 64.6 L_II.
        let panel = &found.panels[1];
        let direct = closures[1].quantities[0].at(&[panel.fractions[40], 4.0 * found.length_ratio]);
        assert_eq!(panel.curves[1][40], direct);
        let mut bytes = Vec::new();
        found.write_csv(&mut bytes).unwrap();
        assert_eq!(String::from_utf8(bytes).unwrap().lines().count(), 1 + 2 * 131);
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        let closures = ["default", "cloete-2018"].map(|n| Closure::find(n).unwrap());
        let refused = compare(&closures, &settings(), None).unwrap_err();
        assert_eq!(
            refused,
            "cloete-2018 does not predict drag_correction; it predicts solids_pressure"
        );
        let mut rows = bins(&closures[0], 0.0);
        rows.iter_mut().for_each(|row| row.standard_error = 0.0);
        let refused = compare(&closures[..1], &settings(), Some(&rows)).unwrap_err();
        assert!(refused.contains("positive finite standard error"), "{refused}");
        rows.iter_mut().for_each(|row| row.quantity = "slip".into());
        let refused = compare(&closures[..1], &settings(), Some(&rows)).unwrap_err();
        assert!(refused.contains("no rows of drag_correction"), "{refused}");
    }
}
