//! The charts of a report, from the tables of a run.

use super::dependence;
use super::folder::{Folder, Trace};
use crate::closure::{BUILT_IN, Closure};
use crate::compare::{Comparison, Settings, compare};
use crate::figure::{self, Axis, Chart, Look, Point, Series};
use crate::fit::ReferenceLength;
use crate::forms::Marker;
use crate::table::{BinRow, ClosureRow, Origin};

/// A chart of a run, and what it shows.
pub struct Drawing {
    /// Name, also of its files.
    pub name: String,
    /// What it shows, in a sentence or two.
    pub caption: String,
    /// It.
    pub chart: Chart,
}

/// Everything that can be drawn of a run, in the order of the page; some may be empty.
pub fn drawings(folder: &Folder) -> Vec<Drawing> {
    let mut all = Vec::new();
    let mut add = |name: &str, caption: String, chart| {
        all.push(Drawing { name: name.into(), caption, chart });
    };
    add(
        "closure",
        "Drag correction H against filtered solids fraction: points are bins with 95 % intervals, curves \
         the fitted closure with its band. Solvers multiply their drag by 1 - H."
            .into(),
        figure::closure_chart(&folder.bins, &folder.curves, "drag_correction"),
    );
    for panel in published(folder).iter().flat_map(|c| c.panels.iter().map(move |p| (c, p))) {
        let (comparison, panel) = panel;
        let width = figure::digits(panel.filter_width);
        add(
            &format!("published_{width}"),
            format!("The closure beside published ones at Δ_f = {width} L_I, with the bins."),
            figure::comparison_chart(comparison, panel),
        );
    }
    for (quantity, label, what) in [
        ("solids_viscosity", "μ_s,f/(ρ_s u_t³/g) [-]", "Filtered solids viscosity"),
        ("solids_pressure", "P_s,f/(ρ_s u_t²) [-]", "Filtered solids pressure"),
    ] {
        let caption =
            format!("{what}, scaled, against filter width; dashed lines are least-squares slopes.");
        add(quantity, caption, against_width(folder, quantity, label));
    }
    for (quantity, label, what) in [
        ("solids_dispersion", "C = D_s/(Δ_f² S) [-]", "Dispersion coefficient of the solids"),
        ("gas_dispersion", "C = D_g/(Δ_f² S) [-]", "Dispersion coefficient of the gas"),
    ] {
        let caption = format!("{what} against filtered solids fraction.");
        add(quantity, caption, against_fraction(folder, quantity, label));
    }
    for trace in &folder.traces {
        let phi = trace.solids_fraction;
        if let Some(chart) = slip(folder, trace) {
            add(&format!("slip_{phi}"), format!("Mean slip over time at ⟨φ⟩ = {phi}."), chart);
        }
    }
    add(
        "samples",
        "Probability density of the filtered solids fraction, from the samples of the bins.".into(),
        density(folder),
    );
    add(
        "parity",
        "The closure table against the bins that it was fitted to, at their solids fraction and width."
            .into(),
        parity(folder),
    );
    all
}

/// Fewest filter widths that a slope is told from.
const SLOPE_WIDTHS: usize = 3;

/// Most solids fractions that a chart against filter width shows.
const MOST_FRACTIONS: usize = 6;

/// Rows of a quantity that have a finite interval.
fn rows<'a>(folder: &'a Folder, quantity: &str) -> Vec<&'a BinRow> {
    let finite = |r: &&BinRow| r.low_95.is_finite() && r.high_95.is_finite();
    folder.bins.iter().filter(|r| r.quantity == quantity).filter(finite).collect()
}

/// Different numbers, from the least.
fn different(numbers: impl Iterator<Item = f64>) -> Vec<f64> {
    let mut all: Vec<f64> = numbers.collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

/// A row's value and interval in scaled units.
fn scaled(row: &BinRow, x: f64) -> Point {
    let unit = if row.value == 0.0 { 1.0 } else { row.value_scaled / row.value };
    Point { x, y: row.value_scaled, interval: Some([row.low_95 * unit, row.high_95 * unit]) }
}

/// The closure of a run beside published ones, at each filter width, with scores against the bins;
/// what cannot be compared is left out.
pub(super) fn published(folder: &Folder) -> Option<Comparison> {
    let fits = |closure: &Closure| {
        closure.quantity(Some("drag_correction")).is_some_and(|quantity| {
            quantity.file.unit == "-"
                && quantity
                    .markers()
                    .all(|m| matches!(m, Marker::SolidsFraction | Marker::FilterWidth))
        })
    };
    let own = folder.model.clone().filter(|closure| fits(closure));
    let shipped = BUILT_IN.iter().filter_map(|(name, _)| {
        // The shipped default is a run of Favre's own.
        Closure::find(name).ok().filter(|closure| *name != "default" && fits(closure))
    });
    let closures: Vec<Closure> = own.into_iter().chain(shipped).collect();
    let settings = Settings {
        quantity: "drag_correction".into(),
        filter_widths: Vec::new(),
        slip: 1.0,
        shear_rate: 1.0,
    };
    compare(&closures, &settings, Some(&folder.bins)).ok()
}

/// A scaled coefficient against scaled filter width, double logarithmic, a line for each solids fraction
/// with its slope by least squares.
fn against_width(folder: &Folder, quantity: &str, label: &str) -> Chart {
    let rows = rows(folder, quantity);
    let usable = |row: &&&BinRow| row.value_scaled > 0.0;
    let middle = |row: &BinRow| 0.5 * (row.solids_fraction_low + row.solids_fraction_high);
    let fractions = different(rows.iter().filter(usable).map(|row| middle(row)));
    let step = fractions.len().div_ceil(MOST_FRACTIONS).max(1);
    let mut series = Vec::new();
    for (colour, fraction) in fractions.into_iter().step_by(step).enumerate() {
        let points: Vec<Point> = rows
            .iter()
            .filter(usable)
            .filter(|row| middle(row) == fraction)
            .map(|row| scaled(row, row.filter_width_l_i))
            .collect();
        let mut name = format!("φ = {}", figure::digits(fraction));
        if let Some((slope, line)) = slope(&points) {
            name += &format!(", slope {slope:.2}");
            series.push(Series {
                name: name.clone(),
                colour,
                look: Look::Dashed,
                named: false,
                points: line,
            });
        }
        series.push(Series { name, colour, look: Look::Points, named: true, points });
    }
    Chart {
        title: String::new(),
        axes: [Axis::logarithmic("filter width Δ_f/L_I [-]"), Axis::logarithmic(label)],
        series,
        marks: Vec::new(),
    }
}

/// Slope of log y against log x, and its line.
fn slope(points: &[Point]) -> Option<(f64, Vec<Point>)> {
    if different(points.iter().map(|p| p.x)).len() < SLOPE_WIDTHS {
        return None;
    }
    let n = points.len() as f64;
    let mean = |of: &dyn Fn(&Point) -> f64| points.iter().map(of).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p.x.ln()), mean(&|p| p.y.ln()));
    let square = mean(&|p| (p.x.ln() - x).powi(2));
    let slope = mean(&|p| (p.x.ln() - x) * (p.y.ln() - y)) / square;
    let at = |p: &Point| Point { x: p.x, y: (y + slope * (p.x.ln() - x)).exp(), interval: None };
    let mut line = vec![at(points.first()?), at(points.last()?)];
    line.sort_by(|a, b| a.x.total_cmp(&b.x));
    Some((slope, line))
}

/// A quantity against filtered solids fraction, a colour for each filter width.
fn against_fraction(folder: &Folder, quantity: &str, label: &str) -> Chart {
    let rows = rows(folder, quantity);
    let widths = different(rows.iter().map(|row| row.filter_width_l_i));
    let series = widths.into_iter().enumerate().map(|(colour, width)| Series {
        name: format!("Δ_f = {} L_I", figure::digits(width)),
        colour,
        look: Look::Points,
        named: true,
        points: rows
            .iter()
            .filter(|row| row.filter_width_l_i == width)
            .map(|row| scaled(row, row.solids_fraction))
            .collect(),
    });
    let series: Vec<Series> = series.collect();
    let points = || series.iter().flat_map(|s| &s.points).map(|p| p.y);
    let (low, high) = points().fold((0.0f64, 0.0f64), |(a, b), y| (a.min(y), b.max(y)));
    let up = Axis::linear(label);
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("filtered solids fraction φ [-]"),
            if high > low { up.between(1.1 * low, 1.1 * high) } else { up },
        ],
        series,
        marks: Vec::new(),
    }
}

/// How often filter positions have a solids fraction: their number over bin width and total.
fn density(folder: &Folder) -> Chart {
    let all: Vec<&BinRow> =
        folder.bins.iter().filter(|row| row.quantity == "drag_correction").collect();
    let widths = different(all.iter().map(|row| row.filter_width_l_i));
    let series = widths.into_iter().enumerate().map(|(colour, width)| {
        let rows: Vec<&&BinRow> = all.iter().filter(|row| row.filter_width_l_i == width).collect();
        let total: f64 = rows.iter().map(|row| row.samples as f64).sum();
        let mut bins: Vec<(f64, f64, f64)> = Vec::new();
        for row in rows {
            let edges = (row.solids_fraction_low, row.solids_fraction_high);
            // With further markers a bin of solids fraction is several rows.
            match bins.iter_mut().find(|bin| (bin.0, bin.1) == edges) {
                Some(bin) => bin.2 += row.samples as f64,
                None => bins.push((edges.0, edges.1, row.samples as f64)),
            }
        }
        bins.sort_by(|a, b| a.0.total_cmp(&b.0));
        let point = |&(low, high, samples): &(f64, f64, f64)| Point {
            x: 0.5 * (low + high),
            y: samples / (total * (high - low)),
            interval: None,
        };
        Series {
            name: format!("Δ_f = {} L_I", figure::digits(width)),
            colour,
            look: Look::Points,
            named: true,
            points: bins.iter().map(point).collect(),
        }
    });
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("filtered solids fraction φ [-]"),
            Axis::logarithmic("probability density of φ [-]"),
        ],
        series: series.collect(),
        marks: Vec::new(),
    }
}

/// The fitted closure against the bins that it was fitted to, at the bins' solids fraction and width.
fn parity(folder: &Folder) -> Chart {
    let mut series: Vec<Series> = Vec::new();
    let rows = rows(folder, "drag_correction");
    let widths = different(rows.iter().map(|row| row.filter_width));
    for (colour, width) in widths.into_iter().enumerate() {
        let points = rows.iter().filter(|row| row.filter_width == width).filter_map(|row| {
            let y = interpolated(&folder.curves, row)?;
            Some(Point { x: row.value, y, interval: None })
        });
        series.push(Series {
            name: format!("Δ_f = {} cm", figure::digits(100.0 * width)),
            colour,
            look: Look::Points,
            named: true,
            points: points.collect(),
        });
    }
    series.retain(|s| !s.points.is_empty());
    if !series.is_empty() {
        let ends = [0.0, 1.0].map(|x| Point { x, y: x, interval: None });
        series.push(Series {
            name: "equal".into(),
            colour: 6,
            look: Look::Dashed,
            named: true,
            points: ends.into(),
        });
    }
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("H of a bin [-]").between(0.0, 1.0),
            Axis::linear("H of the closure [-]").between(0.0, 1.0),
        ],
        series,
        marks: Vec::new(),
    }
}

/// The closure table at a bin, linear between its solids fractions, as a solver reads it.
fn interpolated(curves: &[ClosureRow], row: &BinRow) -> Option<f64> {
    let of_width: Vec<&ClosureRow> = curves
        .iter()
        .filter(|c| {
            c.origin == Origin::Fit
                && c.quantity == row.quantity
                && (c.filter_width / row.filter_width - 1.0).abs() < 1e-9
        })
        .collect();
    of_width.windows(2).find_map(|pair| {
        let [a, b] = [pair[0].solids_fraction, pair[1].solids_fraction];
        let share = (row.solids_fraction - a) / (b - a);
        (0.0..=1.0)
            .contains(&share)
            .then(|| pair[0].value + share * (pair[1].value - pair[0].value))
    })
}

/// Slip over time.
fn slip(folder: &Folder, trace: &Trace) -> Option<Chart> {
    let u_t = folder.terminal_velocity()?;
    let facts = folder.facts.boxes.iter().find(|b| b.solids_fraction == trace.solids_fraction);
    let slip: Vec<f64> = trace.slip.iter().map(|slip| slip / u_t).collect();
    let (start, uniform) = (facts.map(|b| b.start), facts.map(|b| b.uniform_slip));
    Some(figure::series_chart(&trace.times, &slip, start, uniform))
}

/// What several runs are compared in: name of the figure, quantity, its axis, and the filter width, in
/// either reference length.
const COMMON: [(&str, &str, &str, ReferenceLength, f64); 4] = [
    ("runs_L_I", "drag_correction", "drag correction H [-]", ReferenceLength::One, 2.0),
    ("runs_L_II", "drag_correction", "drag correction H [-]", ReferenceLength::Two, 30.0),
    ("runs_solids_pressure", "solids_pressure", "P_s,f/(ρ_s u_t²) [-]", ReferenceLength::Two, 30.0),
    (
        "runs_solids_viscosity",
        "solids_viscosity",
        "μ_s,f/(ρ_s u_t³/g) [-]",
        ReferenceLength::Two,
        30.0,
    ),
];

/// Closures of several runs beside each other, bin by bin.
pub(super) fn side_by_side(folders: &[Folder]) -> Vec<Drawing> {
    let one = |(name, quantity, label, reference, width): (&str, &str, &str, _, _)| Drawing {
        name: name.into(),
        caption: format!(
            "{} of every run, at its filter width nearest to {width} {reference}.",
            match quantity {
                "drag_correction" => "Drag correction",
                "solids_pressure" => "Filtered solids pressure",
                _ => "Filtered solids viscosity",
            }
        ),
        chart: together(folders, quantity, label, reference, width),
    };
    COMMON.into_iter().map(one).collect()
}

/// Everything that is drawn of several runs together, in the order of the page.
pub fn drawings_together(folders: &[Folder]) -> Vec<Drawing> {
    let mut all = side_by_side(folders);
    all.extend(dependence::drawings(&dependence::groups(folders)));
    all
}

/// A quantity of several runs, scaled, at the width nearest to `width` reference lengths, a colour for
/// each run.
fn together(
    folders: &[Folder],
    quantity: &str,
    label: &str,
    reference: ReferenceLength,
    width: f64,
) -> Chart {
    let series = folders.iter().enumerate().filter_map(|(colour, folder)| {
        let rows = rows(folder, quantity);
        let nearest = rows
            .iter()
            .map(|row| reference.scaled_width(row))
            .min_by(|a, b| (a / width).ln().abs().total_cmp(&(b / width).ln().abs()))?;
        let points = rows
            .iter()
            .filter(|row| reference.scaled_width(row) == nearest)
            .map(|row| scaled(row, row.solids_fraction));
        Some(Series {
            name: format!("{}, Δ_f = {} {reference}", folder.name, figure::digits(nearest)),
            colour,
            look: Look::Points,
            named: folders.len() <= 12,
            points: points.collect(),
        })
    });
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("filtered solids fraction φ [-]"),
            match quantity {
                "drag_correction" => Axis::linear(label).between(0.0, 1.0),
                _ => Axis::linear(label),
            },
        ],
        series: series.collect(),
        marks: Vec::new(),
    }
}
