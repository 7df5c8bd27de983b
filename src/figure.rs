//! Figures: closure against data, a snapshot, a series. The only place that knows the plotter.
//!
//! Colours are those of Okabe & Ito (2008) for lines and viridis for fields, both told apart by
//! colour-blind readers.

use crate::bench::error::{Group, QUANTITIES, Report};
use crate::compare::{Comparison, Panel};
use crate::film::{Film, Frame};
use crate::stability::{Mode, Stability};
use crate::table::{BinRow, ClosureRow, Origin};
use kuva::plot::annotations::{ReferenceLine, ShadedRegion};
use kuva::plot::legend::{LegendEntry, LegendPosition, LegendShape};
use kuva::prelude::{ColorMap, Heatmap, LinePlot, Plot, ScatterPlot, SvgBackend};
use kuva::render::layout::{Layout, TickFormat};
use kuva::render::render::{Scene, render_multiple};
use kuva::{RasterBackend, TickAlign};
use std::io::Write;
use std::sync::Arc;
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

    /// The figure as SVG to stand in a page, as wide as its place: without a background, in the page's
    /// colour where it would be black, its identifiers beginning with `id`, and with `label` for who
    /// cannot see it.
    pub fn inline(&self, id: &str, label: &str) -> String {
        let svg = self.svg();
        let (_, drawing) = svg.split_once('>').expect("an SVG has a head");
        let ground = r#"<rect width="100%" height="100%" fill="white" />"#;
        let drawing = drawing
            .replacen(ground, "", 1)
            .replace("\"#000000\"", "\"currentColor\"")
            .replace("\"#cccccc\"", "\"#88888855\"");
        format!(
            "<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"{}\" fill=\"currentColor\">{}",
            self.scene.width,
            self.scene.height,
            escaped(label),
            renumbered(&drawing, &escaped(id)),
        )
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

/// A drawing whose clip paths are counted from 0 and named after `id`: the plotter counts those of all
/// figures that it ever drew.
fn renumbered(drawing: &str, id: &str) -> String {
    let mut pieces = drawing.split("kuva-clip-");
    let mut out = pieces.next().unwrap_or_default().to_owned();
    let mut known: Vec<&str> = Vec::new();
    for piece in pieces {
        let digits = piece.find(|c: char| !c.is_ascii_digit()).unwrap_or(piece.len());
        let (number, rest) = piece.split_at(digits);
        let place = known.iter().position(|other| *other == number).unwrap_or_else(|| {
            known.push(number);
            known.len() - 1
        });
        out += &format!("{id}-clip-{place}{rest}");
    }
    out
}

/// Text as it stands in an attribute.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
}

/// Okabe & Ito's palette without its yellow, which is too light on white.
const COLOURS: [&str; 7] =
    ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];

/// A point of a [`Series`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Along the first axis.
    pub x: f64,
    /// Along the second.
    pub y: f64,
    /// Ends of its 95 % interval along the second.
    pub interval: Option<[f64; 2]>,
}

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Points with their intervals; they say their numbers when pointed at.
    Points,
    /// A line, its intervals a band.
    Line,
    /// A dashed line.
    Dashed,
}

/// Most points of a line that say their numbers.
const MOST_SAID: usize = 150;

/// Points that belong together.
#[derive(Clone, Debug)]
pub struct Series {
    /// What they are.
    pub name: String,
    /// Which of the palette's colours, counted round.
    pub colour: usize,
    /// How they are drawn.
    pub look: Look,
    /// Whether the legend names them.
    pub named: bool,
    /// The points; those that are not finite are left out of the drawing.
    pub points: Vec<Point>,
}

/// An axis of a [`Chart`].
#[derive(Clone, Debug)]
pub struct Axis {
    /// What is along it, with its symbol and unit.
    pub label: String,
    /// Whether it is logarithmic.
    pub logarithmic: bool,
    /// Its ends; those of the points if none.
    pub ends: Option<[f64; 2]>,
}

impl Axis {
    /// A linear axis from the least to the largest point.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), logarithmic: false, ends: None }
    }

    /// A logarithmic axis.
    pub fn logarithmic(label: impl Into<String>) -> Self {
        Self { label: label.into(), logarithmic: true, ends: None }
    }

    /// With these ends.
    #[must_use]
    pub fn between(mut self, low: f64, high: f64) -> Self {
        self.ends = Some([low, high]);
        self
    }

    fn shows(&self, x: f64) -> bool {
        x.is_finite() && (!self.logarithmic || x > 0.0)
    }
}

/// Series over common axes: the data of a figure, from which its drawing and its table are made.
#[derive(Clone, Debug)]
pub struct Chart {
    /// What stands above it; may be empty.
    pub title: String,
    /// First and second axis.
    pub axes: [Axis; 2],
    /// What is drawn, the first undermost, points above lines.
    pub series: Vec<Series>,
    /// Lines across the chart: place along the first axis, and what it is.
    pub marks: Vec<(f64, String)>,
}

impl Chart {
    /// What can be drawn of a series.
    fn shown<'a>(&'a self, series: &'a Series) -> impl Iterator<Item = &'a Point> + Clone {
        let [across, up] = &self.axes;
        series.points.iter().filter(|p| across.shows(p.x) && up.shows(p.y))
    }

    /// Whether there is anything to draw.
    pub fn is_empty(&self) -> bool {
        self.series.iter().all(|series| self.shown(series).next().is_none())
    }

    /// The drawing, about 800 x 460.
    pub fn figure(&self) -> Figure {
        let [across, up] = &self.axes;
        let mut plots = Vec::new();
        let mut entries = Vec::new();
        // An end of an interval beyond the axis is drawn at the axis.
        let inside = |x: f64| match up.ends {
            Some([low, high]) => x.clamp(low, high),
            None => x,
        };
        // Points above lines: no band may hide them from who points at them.
        let (above, below): (Vec<&Series>, Vec<&Series>) =
            self.series.iter().partition(|series| series.look == Look::Points);
        let dotted = !above.is_empty();
        for series in below.into_iter().chain(above) {
            let colour = COLOURS[series.colour % COLOURS.len()];
            let points = self.shown(series);
            let data: Vec<(f64, f64)> = points.clone().map(|p| (p.x, p.y)).collect();
            if data.is_empty() {
                continue;
            }
            let ends = points.clone().map(|p| {
                let [low, high] = p.interval.unwrap_or([p.y; 2]).map(inside);
                // A logarithmic axis has no place for what is not positive.
                (if up.shows(low) { low } else { p.y }, high)
            });
            match series.look {
                Look::Points => {
                    let says = points.clone().map(|p| self.says(series, p));
                    let mut dots = ScatterPlot::new()
                        .with_data(data)
                        .with_tooltip_labels(says)
                        .with_color(colour)
                        .with_size(3.5);
                    if points.clone().any(|p| p.interval.is_some()) {
                        dots =
                            dots.with_y_err_asymmetric(points.zip(ends).map(|(p, (low, high))| {
                                ((p.y - low).max(0.0), (high - p.y).max(0.0))
                            }));
                    }
                    plots.push(Plot::Scatter(dots));
                }
                Look::Line | Look::Dashed => {
                    let mut line =
                        LinePlot::new().with_data(data).with_color(colour).with_stroke_width(2.0);
                    if points.clone().any(|p| p.interval.is_some()) {
                        let (low, high): (Vec<f64>, Vec<f64>) = ends.unzip();
                        line = line.with_band(low, high);
                    }
                    if series.look == Look::Dashed {
                        line = line.with_dashed();
                    }
                    plots.push(Plot::Line(line));
                    if !dotted {
                        // A line says its numbers too, by points that are not seen.
                        let every = points.clone().count().div_ceil(MOST_SAID);
                        let said = points.step_by(every);
                        plots.push(Plot::Scatter(
                            ScatterPlot::new()
                                .with_data(said.clone().map(|p| (p.x, p.y)))
                                .with_tooltip_labels(said.map(|p| self.says(series, p)))
                                .with_size(5.0)
                                .with_marker_opacity(0.0),
                        ));
                    }
                }
            }
            if series.named {
                entries.push(LegendEntry {
                    label: series.name.clone(),
                    color: colour.into(),
                    shape: if series.look == Look::Points {
                        LegendShape::Circle
                    } else {
                        LegendShape::Line
                    },
                    dasharray: (series.look == Look::Dashed).then(|| "8 4".into()),
                });
            }
        }
        let mut layout = frame(Layout::auto_from_plots(&plots), 800.0, 460.0)
            .with_x_label(across.label.clone())
            .with_y_label(up.label.clone())
            .with_legend_box(false);
        if !self.title.is_empty() {
            layout = layout.with_title(self.title.clone()).with_title_size(15);
        }
        if !entries.is_empty() {
            layout = layout
                .with_legend_entries(entries)
                .with_legend_position(LegendPosition::OutsideRightTop);
        }
        if across.logarithmic {
            layout = layout.with_log_x();
        }
        if up.logarithmic {
            layout = layout.with_log_y();
        }
        if let Some([low, high]) = across.ends {
            layout = layout.with_x_axis_min(low).with_x_axis_max(high);
        }
        if let Some([low, high]) = up.ends {
            layout = layout.with_y_axis_min(low).with_y_axis_max(high);
        }
        for (place, label) in &self.marks {
            layout = layout.with_reference_line(
                ReferenceLine::vertical(*place).with_color("#888888").with_label(label),
            );
        }
        Figure { scene: render_multiple(plots, layout) }
    }

    /// What a point says when pointed at: its series, both numbers, its interval.
    pub fn says(&self, series: &Series, point: &Point) -> String {
        let [across, up] = &self.axes;
        let mut text = format!(
            "{}: {} = {}, {} = {}",
            series.name,
            across.label,
            digits(point.x),
            up.label,
            digits(point.y)
        );
        if let Some([low, high]) = point.interval {
            text += &format!(", 95 % interval {} to {}", digits(low), digits(high));
        }
        text
    }

    /// The numbers behind it: a row a point, with as many digits as give the same number back.
    ///
    /// # Errors
    /// What the writer reports.
    pub fn write_csv(&self, writer: impl Write) -> csv::Result<()> {
        let mut table = csv::Writer::from_writer(writer);
        let [across, up] = &self.axes;
        table.write_record(["series", &across.label, &up.label, "low_95", "high_95"])?;
        for series in &self.series {
            for Point { x, y, interval } in &series.points {
                let end = |i: usize| interval.map_or(String::new(), |ends| ends[i].to_string());
                table.write_record([
                    series.name.clone(),
                    x.to_string(),
                    y.to_string(),
                    end(0),
                    end(1),
                ])?;
            }
        }
        table.flush()?;
        Ok(())
    }
}

/// A number in four significant digits, as a reader would write it.
pub fn digits(x: f64) -> String {
    if x == 0.0 || (1e-3..1e5).contains(&x.abs()) {
        let places =
            if x == 0.0 { 0 } else { (3 - x.abs().log10().floor() as i32).max(0) as usize };
        let text = format!("{x:.places$}");
        return match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.').into(),
            false => text,
        };
    }
    format!("{x:.3e}")
}

/// The closure and the bins that it was fitted to: H over filtered solids fraction, one colour for
/// each filter width, points with 95 % intervals, curves with bands. `curves` are rows of the closure
/// table; of those outside the range of the data nothing is drawn.
///
/// Bins without a finite interval are left out.
pub fn closure_chart(rows: &[BinRow], curves: &[ClosureRow], quantity: &str) -> Chart {
    let drawn: Vec<&BinRow> = rows
        .iter()
        .filter(|r| r.quantity == quantity && r.low_95.is_finite() && r.high_95.is_finite())
        .collect();
    let mut widths: Vec<(f64, f64)> =
        drawn.iter().map(|r| (r.filter_width, r.filter_width_l_i)).collect();
    widths.sort_by(|a, b| a.0.total_cmp(&b.0));
    widths.dedup();
    let mut series = Vec::new();
    for (colour, &(width, scaled)) in widths.iter().enumerate() {
        let name = format!("Δ_f = {} cm ({} L_I)", significant(100.0 * width), significant(scaled));
        let of_width = curves.iter().filter(|c| {
            c.quantity == quantity
                && c.origin == Origin::Fit
                && c.inside_range
                && (c.filter_width / width - 1.0).abs() < 1e-9
        });
        let curve: Vec<Point> = of_width
            .map(|c| Point {
                x: c.solids_fraction,
                y: c.value,
                interval: Some([c.low_95, c.high_95]),
            })
            .collect();
        let fitted = !curve.is_empty();
        series.push(Series {
            name: name.clone(),
            colour,
            look: Look::Line,
            named: fitted,
            points: curve,
        });
        let bins = drawn.iter().filter(|r| r.filter_width == width);
        series.push(Series {
            name,
            colour,
            look: Look::Points,
            named: !fitted,
            points: bins
                .map(|r| Point {
                    x: r.solids_fraction,
                    y: r.value,
                    interval: Some([r.low_95, r.high_95]),
                })
                .collect(),
        });
    }
    // A bin that hardly anything is known of must not squeeze the others: its interval is cut.
    let low = drawn.iter().map(|r| r.low_95).fold(0.0, f64::min).max(-0.2);
    let high = drawn.iter().map(|r| r.high_95).fold(0.0, f64::max).min(1.0);
    let top = series.iter().flat_map(|s| &s.points).map(|p| p.x).fold(0.05, f64::max);
    // Beyond a round end by less than a pixel, or its tick is lost to a rounding.
    let round = |x: f64, step: f64| (x / step - 1e-6).ceil() * step + 1e-6;
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("filtered solids fraction φ [-]").between(0.0, round(top, 0.05)),
            Axis::linear("drag correction H [-]")
                .between((low * 5.0).floor() / 5.0, round(high, 0.2).max(0.2)),
        ],
        series,
        marks: Vec::new(),
    }
}

/// Closures at one filter width over solids fraction, one colour each, and bins of that width with
/// their 95 % intervals.
pub fn comparison_chart(comparison: &Comparison, panel: &Panel) -> Chart {
    let mut series = Vec::new();
    for (colour, (name, curve)) in comparison.closures.iter().zip(&panel.curves).enumerate() {
        let points = panel.fractions.iter().zip(curve);
        series.push(Series {
            name: name.clone(),
            colour,
            // More closures than colours: the second round is dashed.
            look: if colour < COLOURS.len() { Look::Line } else { Look::Dashed },
            named: true,
            points: points.map(|(x, y)| Point { x: *x, y: *y, interval: None }).collect(),
        });
    }
    if !panel.bins.is_empty() {
        let bins = panel.bins.iter();
        series.push(Series {
            name: "bins".into(),
            colour: COLOURS.len() - 1,
            look: Look::Points,
            named: true,
            points: bins
                .map(|&[x, y, low, high]| Point { x, y, interval: Some([low, high]) })
                .collect(),
        });
    }
    let values = series.iter().flat_map(|s| &s.points).map(|p| p.y).filter(|y| y.is_finite());
    let (low, high) = values.fold((0.0f64, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
    let quantity = comparison.quantity.replace('_', " ");
    Chart {
        title: format!("filter width {} L_I", significant(panel.filter_width)),
        axes: [
            Axis::linear("filtered solids fraction φ [-]").between(0.0, 0.65),
            Axis::linear(format!("{quantity} [{}]", comparison.unit))
                .between(1.05 * low, if high > low { 1.05 * high } else { 1.0 }),
        ],
        series,
        marks: Vec::new(),
    }
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

/// A strip of a film: a column for each of its `frames`, the solids fraction above, and below what a
/// filter makes of it, in a box of `size` \[m\]; all in one scale. Made for PNG, as [`field_figure`].
pub fn film_figure(film: &Film, frames: &[&Frame], size: [f64; 2]) -> Figure {
    let [columns, rows] = film.shape;
    let gap = (columns.min(rows) / 10).max(1);
    let (across, up) = (columns + gap, rows + gap);
    let high = frames
        .iter()
        .flat_map(|frame| frame.fraction.iter().chain(&frame.filtered))
        .fold(f64::MIN_POSITIVE, |high, x| high.max(*x));
    let shaded = |x: f64| (x / high * SHADES).round() / SHADES * high;
    // Between the pictures there is no number, and no colour.
    let (wide, tall) = (frames.len() * across - gap, 2 * up - gap);
    let mut data = vec![vec![f64::NAN; wide]; tall];
    for (k, frame) in frames.iter().enumerate() {
        for (picture, bottom) in [(&frame.filtered, 0), (&frame.fraction, up)] {
            for (row, values) in picture.chunks(columns).enumerate() {
                for (to, value) in data[bottom + row][k * across..].iter_mut().zip(values) {
                    *to = shaded(*value);
                }
            }
        }
    }
    let times: Vec<String> = frames.iter().map(|f| format!("{} s", significant(f.time))).collect();
    let names = [format!("φ, Δ_f = {} cm", significant(100.0 * film.filter_width)), "φ".into()];
    let at = |labels: Vec<String>| {
        TickFormat::Custom(Arc::new(move |x: f64| {
            let near = (x - x.round()).abs() < 1e-6 && x.round() >= 0.0;
            labels.get(x.round() as usize).filter(|_| near).cloned().unwrap_or_default()
        }))
    };
    let half = |cells: usize, pitch: usize| 0.5 * cells as f64 / pitch as f64;
    let (beside, below) = (half(columns, across), half(rows, up));
    let last = frames.len().saturating_sub(1) as f64;
    let map = Heatmap::new()
        .with_data(data)
        .with_x_range(-beside, last + beside)
        .with_y_range(-below, 1.0 + below)
        .with_cell_size(1.0 - 1e-6)
        .with_color_map(ColorMap::Custom(Arc::new(|share: f64| match share.is_nan() {
            true => "#ffffff".into(),
            false => ColorMap::Viridis.map(share),
        })));
    let plots = vec![Plot::Heatmap(map)];
    let pixels = (FILM_PIXELS / columns.max(rows)).max(1);
    let width = (wide * pixels) as f64 / f64::from(PNG_SCALE);
    // Elements are as high as they are in the box.
    let aspect = size[1] / size[0] * columns as f64 / rows as f64;
    let height = (tall * pixels) as f64 / f64::from(PNG_SCALE) * aspect;
    let [left, right, top, bottom] = FILM_MARGINS;
    let right = right.max(NARROWEST - width - left);
    let layout =
        frame(Layout::auto_from_plots(&plots), width + left + right, height + top + bottom)
            .with_force_margins(left, right)
            .with_force_margins_y(top, bottom)
            .with_show_grid(false)
            .with_title("solids fraction, as it is and filtered [-]")
            .with_title_size(14)
            .with_x_label("time")
            .with_x_tick_step(1.0)
            .with_y_tick_step(1.0)
            .with_x_tick_format(at(times))
            .with_y_tick_format(at(names.into()))
            .with_tick_align(TickAlign::Outside)
            .with_x_axis_min(-beside)
            .with_x_axis_max(last + beside)
            .with_y_axis_min(-below)
            .with_y_axis_max(1.0 + below);
    Figure { scene: render_multiple(plots, layout) }
}

/// Largest edge of a picture of a film in a PNG \[pixels\].
const FILM_PIXELS: usize = 256;

/// Room beside a film \[units\], as [`FIELD_MARGINS`].
const FILM_MARGINS: [f64; 4] = [115.0, 85.0, 40.0, 55.0];

/// Shades of a field's colour map.
const SHADES: f64 = 64.0;

/// Largest edge of a field in a PNG \[pixels\].
const FIELD_PIXELS: usize = 768;

/// Room beside a field \[units\]: left, right (colour bar), top, bottom.
const FIELD_MARGINS: [f64; 4] = [65.0, 95.0, 40.0, 60.0];

/// Least width of a field's canvas \[units\].
const NARROWEST: f64 = 340.0;

/// The mean slip over time: `slip`/u_t against `times` \[s\], with the `start` \[s\] of the statistics
/// and the uniform suspension's slip `uniform`/u_t.
pub fn series_chart(
    times: &[f64],
    slip: &[f64],
    start: Option<f64>,
    uniform: Option<f64>,
) -> Chart {
    let last = times.last().copied().unwrap_or(1.0);
    let point = |x: f64, y: f64| Point { x, y, interval: None };
    let line = |name: &str, colour, look, points| Series {
        name: name.into(),
        colour,
        look,
        named: true,
        points,
    };
    let signal = times.iter().zip(slip).map(|(t, s)| point(*t, *s)).collect();
    let mut series = vec![line("mean slip", 0, Look::Line, signal)];
    if let Some(uniform) = uniform {
        let points = vec![point(0.0, uniform), point(last, uniform)];
        series.push(line("uniform suspension u₀/u_t", 1, Look::Dashed, points));
    }
    let top = series.iter().flat_map(|s| &s.points).map(|p| p.y).fold(0.0, f64::max);
    Chart {
        title: String::new(),
        axes: [
            Axis::linear("time t [s]").between(0.0, last.max(1e-9)),
            Axis::linear("mean slip / u_t [-]")
                .between(0.0, if top > 0.0 { 1.05 * top } else { 1.0 }),
        ],
        series,
        marks: start.map(|start| (start, "statistics start".into())).into_iter().collect(),
    }
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
    use crate::model::closure_rows;
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
        let widths: Vec<f64> = rows.iter().map(|row| row.filter_width).collect();
        let curves = closure_rows(&model(), &widths);
        let figure = closure_chart(&rows, &curves, "drag_correction").figure();
        let svg = figure.svg();
        for text in
            ["filtered solids fraction φ [-]", "drag correction H [-]", "Δ_f = 1.95 cm (4 L_I)"]
        {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<circle").count(), rows.len() - 1);
        assert_eq!(drawn(&figure).1, [1600, 920]);
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
        let svg = series_chart(&times, &slip, Some(1.1), Some(0.585)).figure().svg();
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
