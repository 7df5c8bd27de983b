//! What grid and box change, and what a number costs: runs of one suspension beside each other.

use super::charts::Drawing;
use super::folder::{BoxFacts, Folder};
use crate::figure::{Axis, Chart, Look, Point, Series, digits};
use crate::fit::ReferenceLength;

/// Half of a 95 % interval in standard errors.
const HALF: f64 = 1.96;

/// Fewest runs that a figure is drawn of.
const FEWEST: usize = 3;

/// One box of a run.
pub(super) struct Row<'a> {
    /// The run.
    pub folder: &'a Folder,
    /// The box.
    pub facts: &'a BoxFacts,
    /// Edge of a cell, the longest \[m\].
    pub cell: f64,
    /// Height of the box \[m\].
    pub height: f64,
    /// Width of the box \[m\].
    pub width: f64,
    /// L_I and L_II \[m\].
    pub lengths: [f64; 2],
    /// Filter width \[m\], H and its standard error in the bin of the mean solids fraction.
    pub correction: Option<[f64; 3]>,
    /// Seconds of the wall clock per simulated second.
    pub rate: f64,
    /// Seconds that a standard error of the mean slip of 1 % takes.
    pub one_percent: Option<f64>,
    /// The gas, the powder and the mean solids fraction, as text: what must be the same.
    suspension: String,
}

impl<'a> Row<'a> {
    /// Of each box of a run; `widths` are filter widths \[m\] of which one is taken.
    fn of(folder: &'a Folder, widths: &[f64]) -> Vec<Self> {
        let facts = &folder.facts;
        let (size, cells) = (facts.numbers("box", "size"), facts.numbers("box", "cells"));
        let (Some(scales), Some(duration)) = (facts.scales, facts.number("run", "duration")) else {
            return Vec::new();
        };
        let (Some(height), Some(width)) = (size.last(), size.first()) else { return Vec::new() };
        let cell = size.iter().zip(&cells).map(|(size, cells)| size / cells).fold(0.0, f64::max);
        let name = |section: &str| facts.case.as_ref().and_then(|case| case.get(section)).cloned();
        let row = |b: &'a BoxFacts| {
            let phi = b.solids_fraction;
            let suspension = format!("{:?} {:?} {phi}", name("powder"), name("gas"));
            let here = |filter: f64| {
                folder.bins.iter().find(|row| {
                    row.quantity == "drag_correction"
                        && (row.filter_width / filter - 1.0).abs() < 1e-6
                        && (row.solids_fraction_low..row.solids_fraction_high).contains(&phi)
                        && row.standard_error.is_finite()
                })
            };
            let correction = widths
                .get(widths.len().saturating_sub(1) / 2)
                .and_then(|width| here(*width).map(|row| [*width, row.value, row.standard_error]));
            let one_percent = b.slip.mean.zip(b.slip.standard_error).map(|(mean, error)| {
                // The error falls with the root of the time.
                b.cost.seconds * (1.0 - b.start / duration) * (error / (0.01 * mean)).powi(2)
            });
            Self {
                folder,
                facts: b,
                cell,
                height: *height,
                width: *width,
                lengths: [scales.length_i, scales.length_ii],
                correction,
                rate: b.cost.seconds / duration,
                one_percent,
                suspension,
            }
        };
        facts.boxes.iter().map(row).collect()
    }

    /// Mean slip over u_t and half of its 95 % interval.
    fn slip(&self) -> Option<[f64; 2]> {
        Some([self.facts.slip.mean?, HALF * self.facts.slip.standard_error?])
    }
}

/// Boxes of one suspension in several runs.
pub(super) struct Group<'a>(pub Vec<Row<'a>>);

/// What the boxes of a run cost.
pub(super) fn costs(folder: &Folder) -> Vec<Row<'_>> {
    Row::of(folder, &[])
}

/// The boxes that several of the runs have in common, apart from grid and size.
pub(super) fn groups(folders: &[Folder]) -> Vec<Group<'_>> {
    let widths = |folder: &Folder| folder.facts.numbers("filter", "widths");
    let mut groups: Vec<Group> = Vec::new();
    for row in folders.iter().flat_map(|folder| Row::of(folder, &widths(folder))) {
        match groups.iter_mut().find(|group| group.0[0].suspension == row.suspension) {
            Some(group) => group.0.push(row),
            None => groups.push(Group(vec![row])),
        }
    }
    groups.retain(|group| group.0.len() > 1);
    // A correction is compared at a filter width that all runs of a group have.
    for group in &mut groups {
        let of_group =
            |folder: &&Folder| group.0.iter().any(|row| std::ptr::eq(row.folder, *folder));
        let runs: Vec<&Folder> = folders.iter().filter(of_group).collect();
        let common: Vec<f64> = widths(runs[0])
            .into_iter()
            .filter(|width| {
                let has = |w: &f64| (w / width - 1.0).abs() < 1e-6;
                runs.iter().all(|run| widths(run).iter().any(has))
            })
            .collect();
        let all = runs.into_iter().flat_map(|run| Row::of(run, &common));
        let rows: Vec<Row> = all.filter(|row| row.suspension == group.0[0].suspension).collect();
        group.0 = rows;
    }
    groups
}

impl Group<'_> {
    /// Mean solids fraction.
    pub fn solids_fraction(&self) -> f64 {
        self.0[0].facts.solids_fraction
    }

    /// Whether its runs differ in what `of` gives, as numbers do that are no roundings of each other.
    fn differ(&self, of: impl Fn(&Row) -> f64) -> bool {
        self.0.iter().any(|row| (of(row) / of(&self.0[0]) - 1.0).abs() > 1e-6)
    }

    /// What the slips of its runs say of each other; nothing where grid and box are the same.
    pub fn verdict(&self) -> Option<String> {
        let differing = match (
            self.differ(|row| row.cell),
            self.differ(|row| row.height) || self.differ(|row| row.width),
        ) {
            (true, true) => "grids and boxes",
            (true, false) => "grids",
            (false, true) => "boxes",
            (false, false) => return None,
        };
        let slips: Vec<(&str, [f64; 2])> =
            self.0.iter().filter_map(|row| Some((&*row.folder.name, row.slip()?))).collect();
        let pairs = slips.iter().enumerate().flat_map(|(i, a)| {
            slips[i + 1..].iter().map(move |b| {
                let (difference, both) = ((a.1[0] - b.1[0]).abs(), a.1[1].hypot(b.1[1]));
                (difference / both, difference, both, a.0, b.0)
            })
        });
        let (share, difference, both, a, b) = pairs.max_by(|a, b| a.0.total_cmp(&b.0))?;
        let verdict = if share <= 1.0 {
            "no more than chance explains: what they change is not told from these runs, and is below it"
        } else {
            "more than chance explains: take the finer grid, or the larger box"
        };
        Some(format!(
            "⟨φ⟩ = {}, different {differing}: the slips of {a} and {b} are furthest apart for their 95 % \
             intervals, by {} where the intervals allow {}; {verdict}.",
            digits(self.solids_fraction()),
            digits(difference),
            digits(both),
        ))
    }
}

/// The slips of groups of at least [`FEWEST`] runs against cell size, against box height and against
/// cost, where these differ.
pub(super) fn drawings(groups: &[Group]) -> Vec<Drawing> {
    type Of = fn(&Row) -> f64;
    let kinds: [(&str, &str, String, Of); 3] = [
        (
            "slip_against_cells",
            "Mean slip against the size of the cells: what the grid leaves unresolved.",
            format!("cell/{} [-]", ReferenceLength::Two),
            |row| row.cell / row.lengths[1],
        ),
        (
            "slip_against_box",
            "Mean slip against the height of the box.",
            format!("box height/{} [-]", ReferenceLength::One),
            |row| row.height / row.lengths[0],
        ),
        (
            "slip_against_cost",
            "Speed against error: mean slip with its interval against what a simulated second costs.",
            "seconds per simulated second".into(),
            |row| row.rate,
        ),
    ];
    let drawn = kinds.into_iter().filter_map(|(name, caption, label, of)| {
        let series: Vec<Series> = groups
            .iter()
            .enumerate()
            .filter(|(_, group)| group.0.len() >= FEWEST && group.differ(of))
            .map(|(colour, group)| Series {
                name: format!("⟨φ⟩ = {}", digits(group.solids_fraction())),
                colour,
                look: Look::Points,
                named: true,
                points: group
                    .0
                    .iter()
                    .filter_map(|row| {
                        let [y, half] = row.slip()?;
                        Some(Point { x: of(row), y, interval: Some([y - half, y + half]) })
                    })
                    .collect(),
            })
            .collect();
        let chart = Chart {
            title: String::new(),
            axes: [Axis::logarithmic(label), Axis::linear("mean slip / u_t [-]")],
            series,
            marks: Vec::new(),
        };
        let there = !chart.is_empty();
        there.then(|| Drawing { name: name.into(), caption: caption.into(), chart })
    });
    drawn.collect()
}
