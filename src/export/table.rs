//! Values at regular points: CSV, NumPy, VTK; and CSV with a column for each filter width, which
//! programs read that interpolate along one axis only.

use super::code::digits;
use super::{ExportError, Facts, Piece, Quantity, Range, fill, short};
use crate::closure;
use crate::resolved::numpy::NpzWriter;
use std::fmt::Write;
use std::io::{self, Cursor};

/// Points along each axis of a table of one, two, three axes.
const POINTS: [&[usize]; 3] = [&[401], &[131, 65], &[66, 33, 33]];

/// Points of the second axis that get a column of their own.
const COLUMNS: usize = 9;

struct Table<'a> {
    quantity: &'a Quantity,
    axes: Vec<Vec<f64>>,
    /// The last axis fastest.
    values: Vec<f64>,
    /// Largest difference between values interpolated midway between points and the formula.
    error: f64,
}

/// `count` points from one end of the range to the other.
fn axis(range: &Range, count: usize) -> Vec<f64> {
    let step = (range.high - range.low) / (count - 1) as f64;
    (0..count - 1).map(|i| range.low + i as f64 * step).chain([range.high]).collect()
}

/// All combinations of the points of the axes, as a column for each axis.
fn combinations(axes: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let count: usize = axes.iter().map(Vec::len).product();
    let mut columns = vec![Vec::with_capacity(count); axes.len()];
    for i in 0..count {
        let mut rest = i;
        for (column, axis) in columns.iter_mut().zip(axes).rev() {
            column.push(axis[rest % axis.len()]);
            rest /= axis.len();
        }
    }
    columns
}

fn values(compiled: &closure::Quantity, axes: &[Vec<f64>]) -> Vec<f64> {
    let columns = combinations(axes);
    let columns: Vec<&[f64]> = columns.iter().map(|column| &column[..]).collect();
    let mut out = vec![0.0; columns[0].len()];
    compiled.evaluate(&columns, &mut out);
    out
}

impl<'a> Table<'a> {
    fn new(
        facts: &Facts,
        quantity: &'a Quantity,
        compiled: &closure::Quantity,
    ) -> Result<Self, ExportError> {
        let count = quantity.ranges.len();
        let Some(points) = count.checked_sub(1).and_then(|at| POINTS.get(at)) else {
            let (closure, quantity) = (facts.name.clone(), quantity.predicts.clone());
            return Err(ExportError::TooManyAxes { closure, quantity, count });
        };
        let ranges = quantity.ranges.iter().zip(*points);
        let axes: Vec<Vec<f64>> = ranges.map(|(range, count)| axis(range, *count)).collect();
        let values_here = values(compiled, &axes);
        let middles: Vec<Vec<f64>> = axes
            .iter()
            .map(|axis| axis.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect())
            .collect();
        let exact = values(compiled, &middles);
        let mut table = Self { quantity, axes, values: values_here, error: 0.0 };
        table.error = table
            .interpolated(&middles)
            .zip(&exact)
            .fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs()));
        Ok(table)
    }

    /// Values midway between the points: the means of the corners.
    fn interpolated(&self, middles: &[Vec<f64>]) -> impl Iterator<Item = f64> + '_ {
        let cells: Vec<usize> = middles.iter().map(Vec::len).collect();
        let corners = 1usize << cells.len();
        (0..cells.iter().product()).map(move |cell| {
            let sum: f64 = (0..corners)
                .map(|corner| {
                    let (mut rest, mut at, mut stride) = (cell, 0, 1);
                    for (bit, (axis, cells)) in self.axes.iter().zip(&cells).enumerate().rev() {
                        at += stride * (rest % cells + (corner >> bit & 1));
                        rest /= cells;
                        stride *= axis.len();
                    }
                    self.values[at]
                })
                .sum();
            sum / corners as f64
        })
    }

    /// A row for each point.
    fn csv(&self) -> String {
        let mut out = String::new();
        for range in &self.quantity.ranges {
            let _ = write!(out, "{},", range.marker);
        }
        let _ = writeln!(out, "{}", self.quantity.predicts);
        let columns = combinations(&self.axes);
        for (i, value) in self.values.iter().enumerate() {
            for column in &columns {
                let _ = write!(out, "{},", short(column[i]));
            }
            let _ = writeln!(out, "{}", short(*value));
        }
        out
    }

    /// A row for each point of the first axis, a column for some points of the second.
    fn columns(&self) -> Option<String> {
        let [first, second] = &self.axes[..] else { return None };
        let each = (second.len() - 1) / (COLUMNS - 1);
        let chosen: Vec<usize> = (0..second.len()).step_by(each).collect();
        let ranges = &self.quantity.ranges;
        let mut out = format!("{}", ranges[0].marker);
        for &at in &chosen {
            let _ = write!(out, ",{}_{}", ranges[1].symbol(), short(second[at]));
        }
        out.push('\n');
        for (i, x) in first.iter().enumerate() {
            out += &short(*x);
            for &at in &chosen {
                let _ = write!(out, ",{}", short(self.values[i * second.len() + at]));
            }
            out.push('\n');
        }
        Some(out)
    }

    fn npz(&self, facts: &Facts) -> io::Result<Vec<u8>> {
        let mut npz = NpzWriter::new(Cursor::new(Vec::new()));
        for (range, axis) in self.quantity.ranges.iter().zip(&self.axes) {
            npz.numbers(&range.marker.to_string(), &[axis.len()], &[axis])?;
        }
        let shape: Vec<usize> = self.axes.iter().map(Vec::len).collect();
        npz.numbers(&self.quantity.predicts, &shape, &[&self.values])?;
        npz.text("about", &facts.about.join("\n"))?;
        Ok(npz.finish()?.into_inner())
    }

    /// VTK image data: the first axis along x, the second along y, the third along z.
    fn vti(&self, facts: &Facts) -> String {
        let mut axes: Vec<(usize, f64, f64)> = self
            .axes
            .iter()
            .map(|axis| {
                (axis.len(), axis[0], (axis[axis.len() - 1] - axis[0]) / (axis.len() - 1) as f64)
            })
            .collect();
        axes.resize(3, (1, 0.0, 1.0));
        let join = |f: &dyn Fn(&(usize, f64, f64)) -> String| {
            axes.iter().map(f).collect::<Vec<_>>().join(" ")
        };
        let extent = join(&|(count, ..)| format!("0 {}", count - 1));
        let mut numbers = String::new();
        // The first axis fastest.
        let strides = [axes[1].0 * axes[2].0, axes[2].0, 1];
        for k in 0..axes[2].0 {
            for j in 0..axes[1].0 {
                for i in 0..axes[0].0 {
                    let at = i * strides[0] + j * strides[1] + k * strides[2];
                    let _ = write!(numbers, "{} ", short(self.values[at]));
                }
                numbers.push('\n');
            }
        }
        let about = facts.about.join("\n").replace("--", "- -");
        let symbols: Vec<&str> = self.quantity.ranges.iter().map(Range::symbol).collect();
        fill(
            include_str!("table/table.vti"),
            &[
                ("about", &about),
                ("axes", &symbols.join(", ")),
                ("extent", &extent),
                ("origin", &join(&|(_, low, _)| digits(*low))),
                ("spacing", &join(&|(.., step)| digits(*step))),
                ("name", &self.quantity.predicts),
                ("values", numbers.trim_end()),
            ],
        )
    }
}

/// The files of this target.
///
/// # Errors
/// A quantity of more than three markers.
pub fn export(facts: &Facts) -> Result<Vec<Piece>, ExportError> {
    let mut pieces = Vec::new();
    let mut list = String::new();
    for (quantity, compiled) in facts.quantities.iter().zip(&facts.closure.quantities) {
        let table = Table::new(facts, quantity, compiled)?;
        let name = &quantity.name;
        pieces.push(Piece::text(&format!("{name}.csv"), table.csv()));
        let npz = table.npz(facts).expect("memory takes all that is written");
        pieces.push(Piece { path: format!("{name}.npz"), bytes: npz });
        pieces.push(Piece::text(&format!("{name}.vti"), table.vti(facts)));
        if let Some(columns) = table.columns() {
            pieces.push(Piece::text(&format!("{name}_columns.csv"), columns));
        }
        let shape: Vec<String> = table.axes.iter().map(|axis| axis.len().to_string()).collect();
        let largest = table.values.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
        let _ = writeln!(
            list,
            "- `{name}`: {} points; linear interpolation midway between them is off by up to {:.1e} \
             (largest value {largest:.3}).",
            shape.join(" x "),
            table.error
        );
    }
    let readme = fill(
        include_str!("table/README.md"),
        &[("name", &facts.name), ("list", &list), ("facts", &facts.readme)],
    );
    pieces.push(Piece::text("README.md", readme));
    Ok(pieces)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closure::Closure;
    use crate::resolved::numpy::Npy;

    #[test]
    fn a_table_holds_the_closure_at_its_points() {
        let closure = Closure::find("sarkar-2016").unwrap();
        let facts = Facts::new(&closure, false).unwrap();
        let (quantity, compiled) = (&facts.quantities[0], &closure.quantities[0]);
        let table = Table::new(&facts, quantity, compiled).unwrap();
        let [a, b, c] = [3, 7, 11];
        let point = [table.axes[0][a], table.axes[1][b], table.axes[2][c]];
        let at = (a * table.axes[1].len() + b) * table.axes[2].len() + c;
        assert_eq!(table.values[at], compiled.at(&point));
        let row: Vec<f64> = table
            .csv()
            .lines()
            .nth(at + 1)
            .unwrap()
            .split(',')
            .map(|x| x.parse().unwrap())
            .collect();
        assert_eq!(row, [&point[..], &[table.values[at]]].concat());
        // The third axis slowest.
        let vti = table.vti(&facts);
        let numbers = vti.split("format=\"ascii\">").nth(1).unwrap().split('<').next().unwrap();
        let numbers: Vec<f64> = numbers.split_whitespace().map(|x| x.parse().unwrap()).collect();
        let there = (c * table.axes[1].len() + b) * table.axes[0].len() + a;
        assert_eq!(numbers[there], table.values[at]);
        // The bytes of an array in the archive, which is not compressed.
        let npz = table.npz(&facts).unwrap();
        let start = npz.windows(6).position(|bytes| bytes == b"\x93NUMPY").unwrap();
        assert!(Npy::read(&npz[start..start + 128 + 8 * table.axes[0].len()]).is_ok());
    }

    #[test]
    fn the_error_of_interpolation_is_that_of_a_parabola() {
        let text = include_str!("../../models/igci-sundaresan-2011-2d.toml")
            .replace("formula = \"f*h\"", "formula = \"D^2\"");
        let closure = Closure::parse(&text, std::path::Path::new("m.toml")).unwrap();
        let facts = Facts::new(&closure, false).unwrap();
        let table = Table::new(&facts, &facts.quantities[0], &closure.quantities[0]).unwrap();
        // f'' step²/8.
        let step = (16.448 - 1.0) / 64.0;
        assert!((table.error / (step * step / 4.0) - 1.0).abs() < 1e-9, "{}", table.error);
    }
}
