//! [`Grids`]: tables of one box on several grids made one table, sampling error and grid error apart.

use crate::extrapolation::{ASSUMED_ORDER, OnGrid, limit, observed_order};
use crate::laws::scales::Scales;
use crate::statistics::{MergeError, Sums, bin_table_among};
use crate::sums::RunSums;
use crate::table::BinRow;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

/// Standard errors beyond which a grid error is taken for one, and not for chance.
const BEYOND: f64 = 2.0;

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
    /// Rows that were extrapolated.
    pub rows: usize,
    /// Those whose grid error is more than two standard errors.
    pub beyond: usize,
    /// Median of |grid error| over |extrapolated value|.
    pub relative: f64,
    /// χ² of the fits over its degrees of freedom; none of two grids.
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
    let mut tables = Vec::with_capacity(grids.len());
    for grid in grids {
        let of_grid: Vec<&Sums> = grid.iter().map(|&run| &runs[run].sums).collect();
        let cell = of_grid[0].layout.cell();
        tables.push((cell, bin_table_among(&of_grid, &all, scales)?));
    }
    let (_, mut rows) = tables.remove(0);
    let finest = runs[grids[0][0]].sums.layout.cell();
    let mut places = BTreeMap::new();
    for (place, row) in rows.iter().enumerate() {
        places.insert(row.bin(), place);
    }
    let on = |cell: f64, row: &BinRow| OnGrid {
        cell,
        value: row.value,
        standard_error: row.standard_error,
    };
    let mut values: Vec<Vec<OnGrid>> = rows.iter().map(|row| vec![on(finest, row)]).collect();
    let mut only_coarser = 0;
    for (cell, table) in &tables {
        for row in table {
            match places.get(&row.bin()) {
                Some(&place) if row.standard_error.is_finite() => {
                    values[place].push(on(*cell, row));
                }
                Some(_) => {}
                None => only_coarser += 1,
            }
        }
    }
    let mut quantities = Vec::new();
    let mut begin = 0;
    while begin < rows.len() {
        let name = rows[begin].quantity.clone();
        let count = rows[begin..].iter().take_while(|row| row.quantity == name).count();
        let of_quantity = begin..begin + count;
        begin += count;
        // The finest grid must know its own error for the others to say something about it.
        let known = |values: &&Vec<OnGrid>| values[0].standard_error.is_finite();
        let shared: Vec<Vec<OnGrid>> =
            values[of_quantity.clone()].iter().filter(known).cloned().collect();
        let observed = if order.is_none() { observed_order(&shared) } else { None };
        let taken = order.or(observed).unwrap_or(ASSUMED_ORDER);
        let mut found = Convergence {
            quantity: name,
            order: taken,
            observed: observed.is_some(),
            rows: 0,
            beyond: 0,
            relative: f64::NAN,
            chi_squared: None,
        };
        let (mut chi_squared, mut freedom, mut relative) = (0.0, 0, Vec::new());
        for (row, values) in rows[of_quantity.clone()].iter_mut().zip(&values[of_quantity]) {
            let Some(limit) = limit(values, taken).filter(|_| known(&values)) else { continue };
            row.extrapolated = Some(limit.value);
            row.extrapolated_standard_error = Some(limit.standard_error);
            row.grid_error = Some(limit.grid_error);
            row.grid_standard_error = Some(limit.grid_standard_error);
            found.rows += 1;
            found.beyond +=
                usize::from(limit.grid_error.abs() > BEYOND * limit.grid_standard_error);
            if values.len() > 2 {
                chi_squared += limit.chi_squared;
                freedom += values.len() - 2;
            }
            relative.push((limit.grid_error / limit.value).abs());
        }
        if found.rows == 0 {
            continue;
        }
        relative.sort_by(f64::total_cmp);
        found.relative = relative[relative.len() / 2];
        // The shared order is fitted too.
        freedom = freedom.saturating_sub(usize::from(found.observed));
        found.chi_squared = (freedom > 0).then(|| chi_squared / freedom as f64);
        quantities.push(found);
    }
    let boxes = |grid: &Vec<usize>| {
        let mut boxes: Vec<u64> =
            grid.iter().map(|&run| runs[run].solids_fraction.to_bits()).collect();
        boxes.sort_unstable();
        boxes.dedup();
        boxes
    };
    let grids_found = Grids {
        cells: grids.iter().map(|grid| (runs[grid[0]].sums.layout.cell(), grid.len())).collect(),
        same_boxes: grids.iter().all(|grid| boxes(grid) == boxes(&grids[0])),
        only_coarser,
        quantities,
    };
    Ok((rows, grids_found))
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
        for found in &self.quantities {
            // The closure that a run fits, and whatever stands out.
            let closure = found.quantity == "drag_correction";
            if !closure && 2 * found.beyond < found.rows {
                continue;
            }
            write!(
                f,
                "\n  {:<36} {} of {}, median {:.1} % ({} order {:.2}{})",
                found.quantity,
                found.beyond,
                found.rows,
                100.0 * found.relative,
                if found.observed { "observed" } else { "stated" },
                found.order,
                found.chi_squared.map_or(String::new(), |chi| format!(", χ² {chi:.2} a freedom"))
            )?;
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
        assert!(slip.observed && (slip.order - order).abs() < 0.15, "{slip:?}");
        assert!((0.2..3.0).contains(&slip.chi_squared.unwrap()), "{slip:?}");
        assert!(slips(&found).len() >= 6 && slips(&found).len() == slip.rows);
        let stated = pool(runs().to_vec(), Some(order));
        let rows = slips(&stated);
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
        assert!(said.contains("\n  slip ") && said.contains("observed order 1."), "{said}");
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
