//! Figures: closure against data, a snapshot, a series. The only place that knows the plotter.
//!
//! Colours are those of Okabe & Ito (2008) for lines and viridis for fields, both told apart by
//! colour-blind readers.

use crate::bench::error::{Group, QUANTITIES, Report};
use crate::compare::{Comparison, Panel};
use crate::fit::ReferenceLength;
use crate::forms::Marker;
use crate::model::Model;
use crate::stability::{Mode, Stability};
use crate::table::BinRow;
use kuva::plot::annotations::{ReferenceLine, ShadedRegion};
use kuva::plot::legend::{LegendEntry, LegendPosition, LegendShape};
use kuva::prelude::{ColorMap, Heatmap, LinePlot, Plot, ScatterPlot, SvgBackend};
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::render::{Scene, render_multiple};
use kuva::{RasterBackend, TickAlign};
use thiserror::Error;

/// A drawn figure, from which SVG and PNG are made.
pub struct Figure {
    scene: Scene,
}

/// A figure that cannot be made.
#[derive(Debug, Error)]
pub enum FigureError {
    /// The rasteriser fails.
    #[error("a figure cannot be drawn as pixels: {why}")]
    Raster {
        /// What it says.
        why: String,
    },
    /// A field does not have the cells it claims to have.
    #[error("a field of {values} values cannot be drawn as {columns} x {rows} cells")]
    WrongShape {
        /// Values given.
        values: usize,
        /// Cells along x.
        columns: usize,
        /// Cells along y.
        rows: usize,
    },
}

/// Pixels of a PNG per unit of the drawing: sharp on a high-resolution display.
const PNG_SCALE: f32 = 2.0;

impl Figure {
    /// The figure as SVG. Text stays text, in the reader's sans-serif font.
    pub fn svg(&self) -> String {
        SvgBackend::new().render_scene(&self.scene)
    }

    /// The figure as PNG.
    ///
    /// # Errors
    /// [`FigureError::Raster`] when rasterising fails.
    pub fn png(&self) -> Result<Vec<u8>, FigureError> {
        RasterBackend::new()
            .with_scale(PNG_SCALE)
            .render_scene(&self.scene)
            .map_err(|why| FigureError::Raster { why })
    }
}

/// Okabe & Ito's palette without its yellow, which is too light on white.
const COLOURS: [&str; 7] =
    ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];

/// The fitted closure against the bins: H over filtered solids fraction, one colour for each filter
/// width, points with 95 % intervals, curves of the model. About 800 x 500.
///
/// Bins without a finite interval are left out; curves end where the model's valid range ends.
pub fn closure_figure(rows: &[BinRow], model: &Model) -> Figure {
    let drawn: Vec<&BinRow> = rows
        .iter()
        .filter(|r| r.quantity == model.predicts && r.low_95.is_finite() && r.high_95.is_finite())
        .collect();
    let mut widths: Vec<f64> = drawn.iter().map(|r| r.filter_width).collect();
    widths.sort_by(f64::total_cmp);
    widths.dedup();
    let length = model.system.length(model.reference_length);
    let symbol = match model.reference_length {
        ReferenceLength::One => "L_I",
        ReferenceLength::Two => "L_II",
    };
    let (dilute, dense) = model.range(Marker::SolidsFraction);
    let mut plots = Vec::new();
    let mut entries = Vec::new();
    for (i, &width) in widths.iter().enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        let curve = (0..=200).map(|k| {
            let phi = dilute + (dense - dilute) * f64::from(k) / 200.0;
            (phi, model.evaluate(phi, width / length))
        });
        plots.push(Plot::Line(
            LinePlot::new().with_data(curve).with_color(colour).with_stroke_width(2.0),
        ));
        let points: Vec<&&BinRow> = drawn.iter().filter(|r| r.filter_width == width).collect();
        plots.push(Plot::Scatter(
            ScatterPlot::new()
                .with_data(points.iter().map(|r| (r.solids_fraction, r.value)))
                .with_y_err_asymmetric(
                    points.iter().map(|r| (r.value - r.low_95, r.high_95 - r.value)),
                )
                .with_color(colour)
                .with_size(3.5),
        ));
        entries.push(LegendEntry {
            label: format!(
                "Δ_f = {} cm ({} {symbol})",
                significant(100.0 * width),
                significant(width / length)
            ),
            color: colour.into(),
            shape: LegendShape::Line,
            dasharray: None,
        });
    }
    // A bin that hardly anything is known of must not squeeze the others: its interval is cut.
    let low = drawn.iter().map(|r| r.low_95).fold(0.0, f64::min).max(-0.2);
    let high = drawn.iter().map(|r| r.high_95).fold(0.0, f64::max).min(1.0);
    let top = drawn.iter().map(|r| r.solids_fraction).fold(dense, f64::max);
    let layout = frame(Layout::auto_from_plots(&plots), 800.0, 500.0)
        .with_x_label("filtered solids fraction φ [-]")
        .with_y_label("drag correction H [-]")
        .with_x_axis_min(0.0)
        // Beyond a round end by less than a pixel, or its tick is lost to a rounding.
        .with_x_axis_max((top * 20.0 - 1e-6).ceil() / 20.0 + 1e-6)
        .with_x_tick_step(0.1)
        .with_y_axis_min((low * 5.0).floor() / 5.0)
        .with_y_axis_max(((high * 5.0 - 1e-6).ceil() / 5.0).max(0.2) + 1e-6)
        .with_y_tick_step(0.2)
        .with_x_tick_format(TickFormat::Fixed(1))
        .with_y_tick_format(TickFormat::Fixed(1))
        .with_legend_entries(entries)
        .with_legend_position(LegendPosition::OutsideRightTop)
        .with_legend_box(false);
    Figure { scene: render_multiple(plots, layout) }
}

/// Closures at one filter width over solids fraction, one colour each, and bins of that width with
/// their 95 % intervals.
pub fn comparison_figure(comparison: &Comparison, panel: &Panel) -> Figure {
    let mut plots = Vec::new();
    let mut entries = Vec::new();
    for (i, (name, curve)) in comparison.closures.iter().zip(&panel.curves).enumerate() {
        let colour = COLOURS[i % COLOURS.len()];
        // More closures than colours: the second round is dashed.
        let dashed = i >= COLOURS.len();
        let points = panel.fractions.iter().copied().zip(curve.iter().copied());
        let points = points.filter(|(_, value)| value.is_finite());
        let line = LinePlot::new().with_data(points).with_color(colour).with_stroke_width(2.0);
        plots.push(Plot::Line(if dashed { line.with_dashed() } else { line }));
        entries.push(LegendEntry {
            label: name.clone(),
            color: colour.into(),
            shape: LegendShape::Line,
            dasharray: dashed.then(|| "8 4".into()),
        });
    }
    let bins: Vec<[f64; 4]> =
        panel.bins.iter().copied().filter(|bin| bin.iter().all(|x| x.is_finite())).collect();
    if !bins.is_empty() {
        plots.push(Plot::Scatter(
            ScatterPlot::new()
                .with_data(bins.iter().map(|[phi, value, ..]| (*phi, *value)))
                .with_y_err_asymmetric(bins.iter().map(|[_, v, low, high]| (v - low, high - v)))
                .with_color("#444444")
                .with_size(3.5),
        ));
        entries.push(LegendEntry {
            label: "bins".into(),
            color: "#444444".into(),
            shape: LegendShape::Circle,
            dasharray: None,
        });
    }
    let curves = panel.curves.iter().flatten().copied().filter(|value| value.is_finite());
    let values = curves.chain(bins.iter().map(|bin| bin[1]));
    let (low, high) = values.fold((0.0f64, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
    let unit = &comparison.unit;
    let layout = frame(Layout::auto_from_plots(&plots), 860.0, 500.0)
        .with_title(format!("filter width {} L_I", significant(panel.filter_width)))
        .with_title_size(15)
        .with_x_label("filtered solids fraction φ [-]")
        .with_y_label(format!("{} [{unit}]", comparison.quantity.replace('_', " ")))
        .with_x_axis_min(0.0)
        .with_x_axis_max(0.65)
        .with_y_axis_min(1.05 * low)
        .with_y_axis_max(if high > low { 1.05 * high } else { 1.0 })
        .with_legend_entries(entries)
        .with_legend_position(LegendPosition::OutsideRightTop)
        .with_legend_box(false);
    Figure { scene: render_multiple(plots, layout) }
}

/// A snapshot of the solids fraction: `field` of `columns` x `rows` cells, x fastest, the first row
/// at the bottom, in a box of `size` \[m\]. Made for PNG: an SVG has one element for each cell.
///
/// # Errors
/// [`FigureError::WrongShape`] when the field has another number of values.
pub fn field_figure(
    field: &[f64],
    columns: usize,
    rows: usize,
    size: [f64; 2],
) -> Result<Figure, FigureError> {
    if field.len() != columns * rows || field.is_empty() {
        return Err(FigureError::WrongShape { values: field.len(), columns, rows });
    }
    let [width, height] = size.map(|metres| 100.0 * metres);
    let (low, high) = field
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
    // More shades than the eye tells apart would only make the file larger.
    let shade = (high - low) / SHADES;
    let shaded = |x: f64| if shade > 0.0 { low + ((x - low) / shade).round() * shade } else { x };
    let map = Heatmap::new()
        .with_data(field.chunks(columns).map(|row| row.iter().map(|&x| shaded(x))))
        .with_x_range(0.0, width)
        .with_y_range(0.0, height)
        // At 1 the plotter lets cells overlap by half a unit, which shifts their edges.
        .with_cell_size(1.0 - 1e-6)
        .with_color_map(ColorMap::Viridis);
    let plots = vec![Plot::Heatmap(map)];
    // A whole number of pixels for each cell, so that edges are sharp.
    let pixels = (FIELD_PIXELS / columns.max(rows)).max(1);
    let across = (columns * pixels) as f64 / f64::from(PNG_SCALE);
    let up = across * height / width;
    let [left, least_right, top, bottom] = FIELD_MARGINS;
    // The plotter squeezes the colour bar's numbers on a narrower canvas.
    let right = least_right.max(NARROWEST - across - left);
    let layout = frame(Layout::auto_from_plots(&plots), across + left + right, up + top + bottom)
        .with_force_margins(left, right)
        .with_force_margins_y(top, bottom)
        .with_show_grid(false)
        .with_title("solids fraction φ [-]")
        .with_title_size(15)
        .with_x_label("x [cm]")
        .with_y_label("y [cm]")
        .with_tick_align(TickAlign::Outside)
        .with_x_axis_min(0.0)
        .with_x_axis_max(width)
        .with_y_axis_min(0.0)
        .with_y_axis_max(height);
    Ok(Figure { scene: render_multiple(plots, layout) })
}

/// Shades of a field's colour map.
const SHADES: f64 = 64.0;

/// Largest edge of a field in a PNG \[pixels\].
const FIELD_PIXELS: usize = 768;

/// Room beside a field \[units\]: left, right (colour bar), top, bottom.
const FIELD_MARGINS: [f64; 4] = [65.0, 95.0, 40.0, 60.0];

/// Least width of a field's canvas \[units\].
const NARROWEST: f64 = 340.0;

/// The mean slip over time: `slip`/u_t against `times` \[s\], what comes before `start` \[s\] of the
/// statistics shaded, and the uniform suspension's slip `uniform`/u_t dashed.
pub fn series_figure(times: &[f64], slip: &[f64], start: f64, uniform: f64) -> Figure {
    let series = times.iter().copied().zip(slip.iter().copied());
    let plots = vec![Plot::Line(
        LinePlot::new().with_data(series).with_color(COLOURS[0]).with_stroke_width(1.2),
    )];
    let first = times.first().copied().unwrap_or(0.0);
    let last = times.last().copied().unwrap_or(1.0);
    let layout = frame(Layout::auto_from_plots(&plots), 800.0, 360.0)
        .with_x_label("time t [s]")
        .with_y_label("mean slip / u_t [-]")
        .with_x_axis_min(first)
        .with_x_axis_max(last)
        .with_y_axis_min(0.0)
        .with_shaded_region(
            ShadedRegion::vertical(first, start).with_color("#888888").with_opacity(0.15),
        )
        .with_reference_line(
            ReferenceLine::vertical(start).with_color("#444444").with_label("statistics start"),
        )
        .with_reference_line(
            ReferenceLine::horizontal(uniform)
                .with_color(COLOURS[1])
                .with_label("uniform suspension u₀/u_t"),
        );
    Figure { scene: render_multiple(plots, layout) }
}

/// Growth rate against wavelength, one colour for each mean solids fraction, solid for vertical and
/// dashed for horizontal waves; what is too short for two cells of edge `cell` \[m\] shaded. Waves
/// that decay fast are left out.
pub fn stability_figure(found: &Stability, cell: f64) -> Figure {
    let ends = |angle: f64| angle == 0.0 || angle == 90.0;
    let drawn: Vec<_> = found
        .states
        .iter()
        .enumerate()
        .flat_map(|(i, state)| state.directions.iter().map(move |d| (i, state.solids_fraction, d)))
        .filter(|(_, _, direction)| ends(direction.angle))
        .collect();
    let rates = drawn.iter().flat_map(|(_, _, d)| d.fastest.map(|mode| mode.growth_rate));
    let top = rates.fold(0.0, f64::max);
    // Where nothing grows, what decays slowest is of interest.
    let slowest = |modes: &[Mode]| modes.iter().map(|m| -m.growth_rate).fold(0.0, f64::max);
    let bottom = match top > 0.0 {
        true => -DECAY_SHOWN * top,
        false => drawn.iter().map(|(_, _, d)| -slowest(&d.modes)).fold(0.0, f64::min),
    };
    let mut plots = Vec::new();
    let mut entries = Vec::new();
    let (mut low, mut high) = (2.0 * cell, 2.0 * cell);
    for (i, fraction, direction) in drawn {
        let colour = COLOURS[i % COLOURS.len()];
        let longest = direction.fastest.map_or(f64::INFINITY, |m| LONGEST_SHOWN * m.wavelength);
        let shown = |mode: &&Mode| mode.growth_rate >= bottom && mode.wavelength <= longest;
        let modes: Vec<&Mode> = direction.modes.iter().filter(shown).collect();
        low = modes.first().map_or(low, |mode| low.min(mode.wavelength));
        high = modes.last().map_or(high, |mode| high.max(mode.wavelength));
        let curve = modes.iter().map(|mode| (1e3 * mode.wavelength, mode.growth_rate));
        let line = LinePlot::new().with_data(curve).with_color(colour).with_stroke_width(2.0);
        let vertical = direction.angle == 0.0;
        plots.push(Plot::Line(if vertical { line } else { line.with_dashed() }));
        entries.push(LegendEntry {
            label: format!("⟨φ⟩ = {} {}", significant(fraction), direction.name()),
            color: colour.into(),
            shape: LegendShape::Line,
            dasharray: (!vertical).then(|| "8 4".into()),
        });
    }
    let layout = frame(Layout::auto_from_plots(&plots), 860.0, 500.0)
        .with_log_x()
        .with_x_label("wavelength [mm]")
        .with_y_label("growth rate [1/s]")
        .with_x_axis_min(1e3 * low)
        .with_x_axis_max(1e3 * high)
        .with_y_axis_min(bottom)
        .with_y_axis_max(1.1 * top)
        .with_shaded_region(
            ShadedRegion::vertical(1e3 * low, 2e3 * cell).with_color("#888888").with_opacity(0.15),
        )
        .with_reference_line(ReferenceLine::horizontal(0.0).with_color("#444444"))
        .with_reference_line(
            ReferenceLine::vertical(2e3 * cell).with_color("#444444").with_label("two cells"),
        )
        .with_legend_entries(entries)
        .with_legend_position(LegendPosition::OutsideRightTop)
        .with_legend_box(false);
    Figure { scene: render_multiple(plots, layout) }
}

/// Quantity `place` of [`QUANTITIES`] against what a simulated second costs: points with 95 %
/// intervals, one colour for each thing that is varied; the interval of the finest grid shaded.
pub fn error_figure(report: &Report, place: usize) -> Figure {
    use Group::{Grid, Physics, Precision, Step, Tolerance};
    let mut plots = Vec::new();
    let mut entries = Vec::new();
    for (i, group) in [Grid, Step, Precision, Tolerance, Physics].into_iter().enumerate() {
        let points: Vec<_> = report
            .points
            .iter()
            .filter(|p| p.group == group && p.found[place].half_width_95.is_finite())
            .collect();
        let colour = COLOURS[i % COLOURS.len()];
        plots.push(Plot::Scatter(
            ScatterPlot::new()
                .with_data(points.iter().map(|p| (p.per_simulated_second, p.found[place].value)))
                .with_y_err(points.iter().map(|p| p.found[place].half_width_95))
                .with_color(colour)
                .with_size(4.0),
        ));
        entries.push(LegendEntry {
            label: group.to_string(),
            color: colour.into(),
            shape: LegendShape::Circle,
            dasharray: None,
        });
    }
    let costs = report.points.iter().map(|p| p.per_simulated_second);
    let (low, high) = costs.fold((f64::INFINITY, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
    let finest = report.finest().found[place];
    let mut layout = frame(Layout::auto_from_plots(&plots), 800.0, 500.0)
        .with_log_x()
        .with_x_label("core seconds per simulated second")
        .with_y_label(QUANTITIES[place])
        .with_x_axis_min(low / 1.5)
        .with_x_axis_max(high * 1.5)
        .with_reference_line(
            ReferenceLine::horizontal(finest.value).with_color("#444444").with_label("finest grid"),
        )
        .with_legend_entries(entries)
        .with_legend_position(LegendPosition::OutsideRightTop)
        .with_legend_box(false);
    if finest.half_width_95.is_finite() {
        let [low, high] =
            [finest.value - finest.half_width_95, finest.value + finest.half_width_95];
        layout = layout.with_shaded_region(
            ShadedRegion::horizontal(low, high).with_color("#888888").with_opacity(0.15),
        );
    }
    Figure { scene: render_multiple(plots, layout) }
}

/// Decay shown beneath the axis of a stability figure, of the fastest growth.
const DECAY_SHOWN: f64 = 0.25;

/// Longest wave shown, in wavelengths of the fastest.
const LONGEST_SHOWN: f64 = 60.0;

/// The common look: size, fonts, box, ticks inwards.
fn frame(layout: Layout, width: f64, height: f64) -> Layout {
    layout
        .with_width(width)
        .with_height(height)
        .with_label_size(15)
        .with_tick_size(13)
        .with_body_size(13)
        .with_box_axes()
        .with_tick_align(TickAlign::Inside)
}

/// A number in three significant digits, without trailing zeros.
fn significant(x: f64) -> String {
    let digits = (2 - x.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{x:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').into() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::{Case, DEFAULT};
    use crate::fit::tests::{WIDTHS, synthetic};
    use crate::model::tests::model;
    use crate::stability::stability;
    use std::f64::consts::TAU;

    /// Noise of the cells' scale on clusters of `columns`/7: harder to compress than a snapshot.
    fn clusters(columns: usize, rows: usize) -> Vec<f64> {
        let wave = |k: f64, x: usize, n: usize| (k * TAU * x as f64 / n as f64).sin();
        (0..columns * rows)
            .map(|cell| {
                let (x, y) = (cell % columns, cell / columns);
                let sum = wave(3.0, x, columns) * wave(2.0, y, rows) + wave(7.0, x + y, columns);
                let noise = ((x * 7919 + y * 104_729) as f64).sin();
                0.3 + 0.29 * (4.0 * sum + 0.08 * noise).tanh()
            })
            .collect()
    }

    /// Bytes of the PNG of `figure`, and its width and height.
    fn drawn(figure: &Figure) -> (usize, [u32; 2]) {
        let bytes = figure.png().unwrap();
        let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
        (bytes.len(), [number(16), number(20)])
    }

    #[test]
    fn closure_figure_names_its_axes_and_filter_widths() {
        let mut rows = synthetic(&WIDTHS[..4], 0.56, 0.02, 1);
        rows[0].high_95 = f64::INFINITY;
        let figure = closure_figure(&rows, &model());
        let svg = figure.svg();
        for text in
            ["filtered solids fraction φ [-]", "drag correction H [-]", "Δ_f = 1.95 cm (4 L_I)"]
        {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<circle").count(), rows.len() - 1);
        assert_eq!(drawn(&figure).1, [1600, 1000]);
    }

    #[test]
    fn fields_are_drawn_with_whole_pixels_and_in_small_files() {
        let square = field_figure(&clusters(512, 512), 512, 512, [0.16, 0.16]).unwrap();
        let (bytes, size) = drawn(&square);
        assert_eq!(size, [512 + 2 * 160, 512 + 2 * 100]);
        assert!(bytes < 300_000, "{bytes} bytes");
        let tall = field_figure(&clusters(64, 256), 64, 256, [0.04, 0.16]).unwrap();
        assert_eq!(drawn(&tall).1, [680, 768 + 2 * 100]);
        let uniform = field_figure(&[0.15; 64], 8, 8, [0.1, 0.1]).unwrap();
        assert!(drawn(&uniform).0 > 0);
    }

    #[test]
    fn series_figure_marks_start_and_uniform_slip() {
        let times: Vec<f64> = (0..100).map(|i| 0.04 * f64::from(i)).collect();
        let slip: Vec<f64> = times.iter().map(|t| 0.585 + 0.8 * t.tanh()).collect();
        let svg = series_figure(&times, &slip, 1.1, 0.585).svg();
        for text in ["time t [s]", "mean slip / u_t [-]", "statistics start", "uniform suspension"]
        {
            assert!(svg.contains(text), "{text}");
        }
    }

    #[test]
    fn stability_figure_names_its_axes_and_waves() {
        let mut case = Case::parse(DEFAULT, "default").unwrap();
        case.domain.solids_fractions = vec![0.05, 0.15];
        let mut found = stability(&case).unwrap();
        let figure = stability_figure(&found, 1.25e-3);
        let svg = figure.svg();
        for text in ["wavelength [mm]", "growth rate [1/s]", "⟨φ⟩ = 0.15 horizontal", "two cells"]
        {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(drawn(&figure).1, [1720, 1000]);
        // Where nothing grows the figure still stands.
        for direction in found.states.iter_mut().flat_map(|state| &mut state.directions) {
            direction.modes.retain(|mode| mode.growth_rate < 0.0);
            direction.fastest = None;
        }
        assert!(drawn(&stability_figure(&found, 1e-3)).0 > 0);
    }

    #[test]
    fn bad_requests_are_refused() {
        let wrong = field_figure(&[0.1; 5], 2, 3, [1.0, 1.0]).err().unwrap().to_string();
        assert_eq!(wrong, "a field of 5 values cannot be drawn as 2 x 3 cells");
    }

    #[test]
    fn numbers_in_the_legend_are_short() {
        for (x, text) in
            [(1.0, "1"), (2.0556, "2.06"), (0.05, "0.05"), (16.449, "16.4"), (120.0, "120")]
        {
            assert_eq!(significant(x), text);
        }
    }
}
