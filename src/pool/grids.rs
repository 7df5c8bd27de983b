//! [`Grids`]: tables of one box on several grids made one table, sampling error and grid error apart.
//!
//! An order that is read off the values is uncertain, and all the more so as bins of one run err
//! together. Replicates of all bins of each grid give as many orders: the order counts as observed if
//! nine replicates in ten show one, its standard error is their scatter, and the errors of limits and grid
//! errors grow by as much as their replicates scatter more with orders of their own than with one. Where
//! the values of a quantity miss the power law by more than their errors allow, χ² per degree of freedom
//! above 1, errors are widened by its root.

use crate::extrapolation::{ASSUMED_ORDER, OnGrid, PRECISE, limit, observed_order};
use crate::laws::scales::Scales;
use crate::replicates::{ReplicateError, replicate_among, standard_deviation};
use crate::statistics::{MergeError, Sums, bin_table_among};
use crate::sums::RunSums;
use crate::table::BinRow;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// Standard errors beyond which a grid error is taken for one, and not for chance.
const BEYOND: f64 = 2.0;

/// Quantities shown of each summary.
const LINES: usize = 10;

/// Replicates that an order's error is read off, and the share of them that must show one.
const REPLICATES: usize = 60;
const SHOWN: f64 = 0.9;

/// How well the order of a replicate is found.
const REPLICATE_ORDER: f64 = 0.01;

/// What runs on several grids say of each other.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Grids {
    /// Edges of the cells \[m\], the finest first, and how many runs are on them.
    pub cells: Vec<(f64, usize)>,
    /// Whether each grid has boxes of the same mean solids fractions; if not, a dependence on the box
    /// passes for a grid error.
    pub same_boxes: bool,
    /// Rows left out, because only coarser grids saw their bins.
    pub only_coarser: usize,
    /// The quantities.
    pub quantities: Vec<Convergence>,
}

/// How a quantity converges.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Convergence {
    /// The quantity.
    pub quantity: String,
    /// Order p of value(h) = value₀ + c h^p, shared by all its bins.
    pub order: f64,
    /// Whether the values show it; else it was given or assumed.
    pub observed: bool,
    /// Its standard error from sampling, if it was observed.
    pub order_standard_error: Option<f64>,
    /// Rows that were extrapolated.
    pub rows: usize,
    /// Those whose grid error is more than two standard errors.
    pub beyond: usize,
    /// Median of |grid error| over |extrapolated value|.
    pub relative: f64,
    /// χ² of the fits over its degrees of freedom; none of two grids. Errors are widened by its root if it
    /// is above 1.
    pub chi_squared: Option<f64>,
}

/// The runs on each grid, finest first, as places in `runs`.
pub(super) fn by_grid(runs: &[RunSums]) -> Vec<Vec<usize>> {
    let mut grids: Vec<Vec<usize>> = Vec::new();
    for (place, run) in runs.iter().enumerate() {
        let alike = |grid: &&mut Vec<usize>| runs[grid[0]].sums.layout.same_grid(&run.sums.layout);
        match grids.iter_mut().find(alike) {
            Some(grid) => grid.push(place),
            None => grids.push(vec![place]),
        }
    }
    grids.sort_by(|a, b| runs[a[0]].sums.layout.cell().total_cmp(&runs[b[0]].sums.layout.cell()));
    grids
}

/// The table of runs on several `grids`, finest first: that of the finest, and beside its values those
/// on infinitely fine cells. The order of convergence is `order`, or the one observed.
pub(super) fn table(
    runs: &[RunSums],
    grids: &[Vec<usize>],
    order: Option<f64>,
    scales: &Scales,
) -> Result<(Vec<BinRow>, Grids), MergeError> {
    let all: Vec<&Sums> = runs.iter().map(|run| &run.sums).collect();
    // Two grids show no order.
    let count = if order.is_none() && grids.len() > 2 { REPLICATES } else { 0 };
    let mut tables = Vec::with_capacity(grids.len());
    for (seed, grid) in grids.iter().enumerate() {
        let of_grid: Vec<&Sums> = grid.iter().map(|&run| &runs[run].sums).collect();
        let fractions: Vec<f64> = grid.iter().map(|&run| runs[run].solids_fraction).collect();
        let cell = of_grid[0].layout.cell();
        tables.push(
            match replicate_among(&of_grid, &fractions, &all, scales, count, seed as u64) {
                Ok(found) => OfGrid { cell, rows: found.rows, replicates: found.values },
                Err(ReplicateError::Merge(error)) => return Err(error),
                // Without replicates no order is observed.
                Err(ReplicateError::TooShort { .. }) => {
                    let rows = bin_table_among(&of_grid, &all, scales)?;
                    OfGrid { cell, rows, replicates: vec![] }
                }
            },
        );
    }
    let mut rows = tables[0].rows.clone();
    let (seen, only_coarser) = seen(&tables);
    let replicates = tables.iter().map(|of| of.replicates.len()).min().unwrap_or(0);
    let on_grids = |row: usize, value: &dyn Fn(&OfGrid, usize) -> f64| -> Vec<OnGrid> {
        let on = |&(grid, place): &(usize, usize)| OnGrid {
            cell: tables[grid].cell,
            value: value(&tables[grid], place),
            standard_error: tables[grid].rows[place].standard_error,
        };
        seen[row].iter().map(on).collect()
    };
    let mut quantities = Vec::new();
    let mut end = 0;
    while end < rows.len() {
        let begin = end;
        end += rows[begin..].chunk_by(|a, b| a.quantity == b.quantity).next().map_or(1, <[_]>::len);
        // Values on a grid each; of a replicate, rows that it did not see are left out.
        let values = |value: &dyn Fn(&OfGrid, usize) -> f64| -> Vec<Vec<OnGrid>> {
            (begin..end).map(|row| on_grids(row, value)).collect()
        };
        let found = values(&|of, place| of.rows[place].value);
        let of_replicates: Vec<Vec<Vec<OnGrid>>> =
            (0..replicates).map(|n| values(&|of, place| of.replicates[n][place])).collect();
        let shown = if order.is_none() { Shown::new(&found, of_replicates) } else { None };
        let taken = order.or(shown.as_ref().map(|shown| shown.order)).unwrap_or(ASSUMED_ORDER);
        let rows = &mut rows[begin..end];
        quantities.extend(extrapolate(rows, &found, taken, shown.as_ref()));
    }
    let boxes = |grid: &Vec<usize>| {
        let mut boxes: Vec<u64> =
            grid.iter().map(|&run| runs[run].solids_fraction.to_bits()).collect();
        boxes.sort_unstable();
        boxes.dedup();
        boxes
    };
    let cells = tables.iter().zip(grids).map(|(of, runs)| (of.cell, runs.len())).collect();
    let same_boxes = grids.iter().all(|grid| boxes(grid) == boxes(&grids[0]));
    Ok((rows, Grids { cells, same_boxes, only_coarser, quantities }))
}

/// The table of one grid.
struct OfGrid {
    cell: f64,
    rows: Vec<BinRow>,
    /// For each replicate the values of the rows.
    replicates: Vec<Vec<f64>>,
}

/// For each row of the first table the grids that know it with an error, and its place in their tables;
/// and how many rows only the others have. A row that the first does not know has none.
fn seen(tables: &[OfGrid]) -> (Vec<Vec<(usize, usize)>>, usize) {
    let first = &tables[0].rows;
    let places: BTreeMap<_, usize> =
        first.iter().enumerate().map(|(place, row)| (row.bin(), place)).collect();
    let mut seen = vec![Vec::new(); first.len()];
    let mut only_coarser = BTreeSet::new();
    for (grid, table) in tables.iter().enumerate() {
        for (place, row) in table.rows.iter().enumerate() {
            match places.get(&row.bin()) {
                // The finest grid must know its own error for the others to say something of it.
                Some(&of_first) if first[of_first].standard_error.is_finite() => {
                    if row.standard_error.is_finite() {
                        seen[of_first].push((grid, place));
                    }
                }
                Some(_) => {}
                None => {
                    only_coarser.insert(row.bin());
                }
            }
        }
    }
    (seen, only_coarser.len())
}

/// An order that the values show.
struct Shown {
    order: f64,
    standard_error: f64,
    /// The replicates that show one, and theirs.
    replicates: Vec<(f64, Vec<Vec<OnGrid>>)>,
}

impl Shown {
    /// None if the values, or too many replicates, show none.
    fn new(values: &[Vec<OnGrid>], replicates: Vec<Vec<Vec<OnGrid>>>) -> Option<Self> {
        let order = observed_order(values, PRECISE)?;
        let count = replicates.len() as f64;
        let mut shown = Vec::with_capacity(replicates.len());
        for mut values in replicates {
            for values in &mut values {
                if values.iter().any(|value| !value.value.is_finite()) {
                    values.clear();
                }
            }
            if let Some(order) = observed_order(&values, REPLICATE_ORDER) {
                shown.push((order, values));
            }
        }
        if shown.is_empty() || (shown.len() as f64) < SHOWN * count {
            return None;
        }
        let orders: Vec<f64> = shown.iter().map(|(order, _)| *order).collect();
        Some(Self { order, standard_error: standard_deviation(&orders), replicates: shown })
    }

    /// By how much limit and grid error of row number `row` scatter more than with a known order.
    fn growth(&self, row: usize) -> [f64; 2] {
        let scatter = |order: &dyn Fn(f64) -> f64| {
            let limits = self
                .replicates
                .iter()
                .filter(|(_, values)| !values[row].is_empty())
                .filter_map(|(own, values)| limit(&values[row], order(*own)));
            let (values, errors): (Vec<f64>, Vec<f64>) =
                limits.map(|limit| (limit.value, limit.grid_error)).unzip();
            [standard_deviation(&values), standard_deviation(&errors)]
        };
        let [own, known] = [scatter(&|own| own), scatter(&|_| self.order)];
        // Of few replicates, or values without scatter, there is nothing to go by.
        [0, 1].map(|part| {
            Some(own[part] / known[part]).filter(|by| by.is_finite()).map_or(1.0, |by| by.max(1.0))
        })
    }
}

/// Extrapolates the rows of a quantity, whose values on each grid are `values`; none if there is nothing
/// to go by.
fn extrapolate(
    rows: &mut [BinRow],
    values: &[Vec<OnGrid>],
    order: f64,
    shown: Option<&Shown>,
) -> Option<Convergence> {
    let mut found = Convergence {
        quantity: rows.first()?.quantity.clone(),
        order,
        observed: shown.is_some(),
        order_standard_error: shown.map(|shown| shown.standard_error),
        rows: 0,
        beyond: 0,
        relative: f64::NAN,
        chi_squared: None,
    };
    let (mut chi_squared, mut freedom, mut relative) = (0.0, 0, Vec::new());
    for (number, (row, values)) in rows.iter_mut().zip(values).enumerate() {
        let Some(limit) = limit(values, order) else { continue };
        let [of_limit, of_error] = shown.map_or([1.0; 2], |shown| shown.growth(number));
        row.extrapolated = Some(limit.value);
        row.extrapolated_standard_error = Some(of_limit * limit.standard_error);
        row.grid_error = Some(limit.grid_error);
        row.grid_standard_error = Some(of_error * limit.grid_standard_error);
        found.rows += 1;
        if values.len() > 2 {
            chi_squared += limit.chi_squared;
            freedom += values.len() - 2;
        }
        relative.push((limit.grid_error / limit.value).abs());
    }
    relative.sort_by(f64::total_cmp);
    found.relative = *relative.get(relative.len() / 2)?;
    // The shared order is fitted too.
    freedom = freedom.saturating_sub(usize::from(found.observed));
    found.chi_squared = (freedom > 0).then(|| chi_squared / freedom as f64);
    // Where values miss the power law by more than their errors, so does its limit.
    let wider = found.chi_squared.map_or(1.0, |chi_squared| chi_squared.sqrt().max(1.0));
    for row in rows.iter_mut() {
        for error in [&mut row.extrapolated_standard_error, &mut row.grid_standard_error] {
            *error = error.map(|error| wider * error);
        }
        let beyond = |(error, own): (f64, f64)| error.abs() > BEYOND * own;
        found.beyond +=
            usize::from(row.grid_error.zip(row.grid_standard_error).is_some_and(beyond));
    }
    Some(found)
}

impl fmt::Display for Grids {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cells: Vec<String> =
            self.cells.iter().map(|(cell, _)| format!("{:.4} mm", 1e3 * cell)).collect();
        write!(
            f,
            "{} grids, cells of {}: values in bins.csv are those on the finest, `extrapolated` those on \
             infinitely fine cells, `grid_error` the difference",
            cells.len(),
            cells.join(", ")
        )?;
        if !self.same_boxes {
            write!(
                f,
                "\n  warning: the grids have boxes of different mean solids fractions: grid errors hold \
                 what the box changes, too"
            )?;
        }
        if self.only_coarser > 0 {
            write!(
                f,
                "\n  {} rows of bins that only coarser grids saw are left out",
                self.only_coarser
            )?;
        }
        let rows: usize = self.quantities.iter().map(|found| found.rows).sum();
        let beyond: usize = self.quantities.iter().map(|found| found.beyond).sum();
        if rows == 0 {
            return write!(
                f,
                "\n  warning: nothing could be extrapolated: no bin is known on two grids whose cells \
                 differ by a tenth"
            );
        }
        write!(f, "\n  grid errors beyond {BEYOND} standard errors: {beyond} of {rows}")?;
        // The closure that a run fits, and what stands out most.
        let closure = |found: &Convergence| found.quantity == "drag_correction";
        let share = |found: &Convergence| found.beyond as f64 / found.rows as f64;
        let mut shown: Vec<&Convergence> = self.quantities.iter().collect();
        shown.sort_by(|a, b| closure(b).cmp(&closure(a)).then(share(b).total_cmp(&share(a))));
        for found in shown.into_iter().take(LINES) {
            write!(
                f,
                "\n  {:<36} {} of {}, median {:.1} % ({} order {:.2}{}{})",
                found.quantity,
                found.beyond,
                found.rows,
                100.0 * found.relative,
                if found.observed { "observed" } else { "stated" },
                found.order,
                found.order_standard_error.map_or(String::new(), |error| format!(" ± {error:.2}")),
                found.chi_squared.map_or(String::new(), |chi| format!(", χ² {chi:.2} a freedom"))
            )?;
        }
        if self.quantities.len() > LINES {
            write!(f, "\n  (the quantities with most; run.json has all)")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::pool::Pool;
    use crate::pool::tests::file_of;
    use crate::statistics::tests::sampled_on;
    use crate::sums::{RunSums, SumsFile};
    use crate::table::BinRow;

    /// The gas rises by 0.4 (h / 4 mm)^p faster than on infinitely fine cells.
    fn planted(cells: usize, order: f64, instants: std::ops::Range<u64>) -> RunSums {
        let lift = 0.4 * (8.0 / cells as f64).powf(order);
        file_of(0.1, sampled_on([cells; 2], lift, instants)).runs.remove(0)
    }

    fn pool(runs: Vec<RunSums>, order: Option<f64>) -> Pool {
        let system = file_of(0.1, sampled_on([8; 2], 0.0, 0..0)).system;
        Pool::new(SumsFile { system, runs }, order).unwrap()
    }

    /// Rows of the slip that were extrapolated, and what the slip is without a grid error: fields are
    /// random in each cell, so that it is the same in all bins but for what the filter itself does.
    fn slips(pool: &Pool) -> Vec<&BinRow> {
        let slip = |row: &&BinRow| row.quantity == "slip" && row.extrapolated.is_some();
        pool.bins.iter().filter(slip).collect()
    }

    #[test]
    fn a_planted_order_and_grid_error_are_found() {
        let order = 1.6;
        let runs = || {
            [8, 16, 32]
                .map(|cells| planted(cells, order, 1000 * cells as u64..1000 * cells as u64 + 80))
        };
        let found = pool(runs().to_vec(), None);
        let grids = found.grids.as_ref().unwrap();
        assert_eq!(grids.cells.iter().map(|cell| cell.1).collect::<Vec<_>>(), [1, 1, 1]);
        assert!((grids.cells[0].0 - 0.001).abs() < 1e-12 && grids.same_boxes);
        let slip = grids.quantities.iter().find(|q| q.quantity == "slip").unwrap();
        let error = slip.order_standard_error.unwrap();
        assert!(slip.observed && (0.01..0.15).contains(&error), "{slip:?}");
        assert!((slip.order - order).abs() < 3.0 * error, "{slip:?}");
        assert!((0.2..3.0).contains(&slip.chi_squared.unwrap()), "{slip:?}");
        let rows = slips(&found);
        assert!(rows.len() >= 6 && rows.len() == slip.rows);
        // An order that is found adds to the error of a limit.
        let stated = pool(runs().to_vec(), Some(slip.order));
        let errors = |rows: &[&BinRow]| -> Vec<f64> {
            rows.iter().map(|row| row.grid_standard_error.unwrap()).collect()
        };
        let growth =
            errors(&rows).iter().zip(errors(&slips(&stated))).map(|(a, b)| a / b).sum::<f64>();
        assert!(growth > 1.2 * rows.len() as f64, "{growth}");
        let planted_error = 0.4 * 0.25f64.powf(order);
        let within = |row: &&&BinRow| {
            let error = row.grid_error.unwrap() - planted_error;
            error.abs() < 3.0 * row.grid_standard_error.unwrap()
        };
        assert!(rows.iter().filter(within).count() * 10 >= rows.len() * 9, "{rows:?}");
        for row in &rows {
            let [limit, error] = [row.extrapolated, row.grid_error].map(Option::unwrap);
            assert!((limit + error - row.value).abs() < 1e-12);
        }
        // The table is that of the finest grid alone, whatever the order of the runs.
        let alone = pool(vec![runs()[2].clone()], None);
        assert!(alone.grids.is_none() && alone.bins.iter().all(|row| row.extrapolated.is_none()));
        let mut reversed = runs().to_vec();
        reversed.reverse();
        assert_eq!(pool(reversed, None).bins, found.bins);
        let values = |rows: &[BinRow]| rows.iter().map(|row| row.value).collect::<Vec<_>>();
        assert_eq!(values(&alone.bins), values(&found.bins));
        let said = found.summary().to_string();
        assert!(said.contains("3 grids, cells of 1.0000 mm, 2.0000 mm, 4.0000 mm"), "{said}");
        assert!(
            said.contains("\n  drag_correction ") && said.contains("run.json has all"),
            "{said}"
        );
    }

    #[test]
    fn two_grids_take_the_order_that_is_stated() {
        let runs = [planted(8, 2.0, 0..60), planted(16, 2.0, 100..160)];
        let [stated, first] = [Some(2.0), None].map(|order| pool(runs.to_vec(), order));
        let mean = |pool: &Pool| {
            let rows = slips(pool);
            rows.iter().map(|row| row.grid_error.unwrap()).sum::<f64>() / rows.len() as f64
        };
        // 0.1 m/s between infinitely fine cells and the finest; at first order the 0.3 m/s between
        // the grids are taken for it.
        assert!((mean(&stated) - 0.1).abs() < 0.02, "{}", mean(&stated));
        assert!((mean(&first) - 0.3).abs() < 0.04, "{}", mean(&first));
        let grids = first.grids.as_ref().unwrap();
        assert!(grids.quantities.iter().all(|q| !q.observed && q.order == 1.0));
        assert!(grids.quantities.iter().all(|q| q.chi_squared.is_none()));
    }

    #[test]
    fn grids_of_different_boxes_are_warned_of() {
        let mut other = planted(8, 1.0, 0..40);
        other.solids_fraction = 0.3;
        let found = pool(vec![planted(16, 1.0, 100..140), other], None);
        assert!(!found.grids.as_ref().unwrap().same_boxes);
        assert!(found.summary().to_string().contains("what the box changes"));
    }
}
