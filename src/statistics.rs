//! [`Sampler`], [`Sums`], [`bin_table`]: conditional statistics of the filtered quantities.
//!
//! Filter positions are binned by their filtered solids fraction, and by their vertical slip if
//! asked. Every quantity is a ratio of two sums over a bin's positions; sums are kept per block of
//! time, so that runs merge, a transient can be cut off afterwards, and errors come from blocks of
//! time and not from filter positions, which overlap. Nothing is subtracted and no mean is removed
//! while sampling: merging is adding.

use serde::{Deserialize, Serialize};

use crate::blocking::{Estimate, Estimator, Run};
use crate::filter::{FilterError, width_in_cells};
use crate::filtered::{Filtered, QUANTITIES, QUANTITY_COUNT, Quantity};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::laws::scales::Scales;
use crate::moments::MomentFilter;
use crate::table::BinRow;

/// Slip bins of width w cover this range of slip / u_t; the first and the last are open.
const SLIP_RANGE: [f64; 2] = [-2.0, 6.0];

/// Bins of filtered solids fraction and, if asked, of vertical filtered slip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bins {
    /// Width of a bin of filtered solids fraction.
    pub fraction_width: f64,
    /// Number of bins of filtered solids fraction, from 0 up. The last one also takes what a
    /// simulator has packed denser than its upper edge.
    pub fraction_count: usize,
    /// Width of a bin of slip / u_t; `None` leaves the slip unbinned.
    pub slip_width: Option<f64>,
}

impl Bins {
    /// Bins of solids fraction `fraction_width` wide from 0 to at least `max_packing`; with
    /// `slip_width` also bins of vertical slip / u_t, that wide from -2 to 6, open at both ends.
    ///
    /// # Panics
    /// If a width is not a positive number.
    pub fn new(fraction_width: f64, max_packing: f64, slip_width: Option<f64>) -> Self {
        assert!(fraction_width > 0.0 && slip_width.is_none_or(|width| width > 0.0));
        // Round-off in the quotient must not add an empty bin.
        let fraction_count = ((max_packing / fraction_width - 1e-9).ceil() as usize).max(1);
        Self { fraction_width, fraction_count, slip_width }
    }

    /// Number of slip bins; 1 without.
    fn slip_count(&self) -> usize {
        match self.slip_width {
            Some(width) => ((SLIP_RANGE[1] - SLIP_RANGE[0]) / width - 1e-9).ceil() as usize + 2,
            None => 1,
        }
    }

    /// Number of bins.
    pub fn len(&self) -> usize {
        self.fraction_count * self.slip_count()
    }

    /// Whether there is no bin.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The bin of a filtered solids fraction and a slip / u_t. Fraction bins run fastest.
    #[inline(always)]
    pub fn bin(&self, solids_fraction: f64, slip: f64) -> usize {
        // The conversion saturates: negative round-off falls into the first bin.
        let fraction = (solids_fraction / self.fraction_width) as usize;
        let fraction = fraction.min(self.fraction_count - 1);
        match self.slip_width {
            Some(width) => {
                let slip = ((slip - SLIP_RANGE[0]) / width + 1.0) as usize;
                slip.min(self.slip_count() - 1) * self.fraction_count + fraction
            }
            None => fraction,
        }
    }

    /// Lower and upper edge of solids fraction of `bin`.
    pub fn fraction_edges(&self, bin: usize) -> [f64; 2] {
        let fraction = bin % self.fraction_count;
        [fraction, fraction + 1].map(|edge| edge as f64 * self.fraction_width)
    }

    /// Lower and upper edge of slip / u_t of `bin`; infinite where open.
    pub fn slip_edges(&self, bin: usize) -> [f64; 2] {
        let Some(width) = self.slip_width else { return [f64::NEG_INFINITY, f64::INFINITY] };
        let slip = bin / self.fraction_count;
        let edge = |number: usize| SLIP_RANGE[0] + (number as f64 - 1.0) * width;
        [
            if slip == 0 { f64::NEG_INFINITY } else { edge(slip) },
            if slip + 1 == self.slip_count() { f64::INFINITY } else { edge(slip + 1) },
        ]
    }
}

/// Sums over filter positions of one quantity's numerator and denominator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PairSums {
    /// Σ num.
    pub numerator: f64,
    /// Σ den.
    pub denominator: f64,
    /// Σ num².
    pub numerator_squared: f64,
    /// Σ num den.
    pub product: f64,
    /// Σ den².
    pub denominator_squared: f64,
}

impl PairSums {
    #[inline(always)]
    fn add(&mut self, numerator: f64, denominator: f64) {
        self.numerator += numerator;
        self.denominator += denominator;
        self.numerator_squared += numerator * numerator;
        self.product += numerator * denominator;
        self.denominator_squared += denominator * denominator;
    }

    fn merge(&mut self, other: &Self) {
        self.numerator += other.numerator;
        self.denominator += other.denominator;
        self.numerator_squared += other.numerator_squared;
        self.product += other.product;
        self.denominator_squared += other.denominator_squared;
    }

    /// Σ (num - R den)² over the positions: how far single positions lie from the ratio R.
    fn residual(&self, ratio: f64) -> f64 {
        let sum = self.numerator_squared - 2.0 * ratio * self.product
            + ratio * ratio * self.denominator_squared;
        // Round-off of the difference may leave a trace below zero.
        sum.max(0.0)
    }
}

/// Sums over the filter positions that fell into one bin during one block of time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BinSums {
    /// The bin, see [`Bins::bin`].
    pub bin: usize,
    /// Filter positions.
    pub positions: u64,
    /// Σ φ̄.
    pub solids_fraction: f64,
    /// Σ slip / u_t.
    pub slip: f64,
    /// Sums of the quantities, in the order of [`QUANTITIES`].
    pub pairs: [PairSums; QUANTITY_COUNT],
}

impl BinSums {
    fn new(bin: usize) -> Self {
        let pairs = [PairSums::default(); QUANTITY_COUNT];
        Self { bin, positions: 0, solids_fraction: 0.0, slip: 0.0, pairs }
    }

    #[inline(always)]
    fn add(&mut self, at: &Filtered, slip: f64) {
        self.positions += 1;
        self.solids_fraction += at.solids_fraction;
        self.slip += slip;
        for (pair, quantity) in self.pairs.iter_mut().zip(&QUANTITIES) {
            pair.add((quantity.numerator)(at), (quantity.denominator)(at));
        }
    }

    fn merge(&mut self, other: &Self) {
        self.positions += other.positions;
        self.solids_fraction += other.solids_fraction;
        self.slip += other.slip;
        for (pair, other) in self.pairs.iter_mut().zip(&other.pairs) {
            pair.merge(other);
        }
    }
}

/// Sums of one block of time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BlockSums {
    /// The block spans the times `place` to `place + 1` block durations.
    pub place: u64,
    /// Instants sampled.
    pub instants: u64,
    /// For each filter width the bins that were visited, in the order of their first visit.
    pub widths: Vec<Vec<BinSums>>,
}

/// The mergeable sums of one run, from which every statistic follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sums {
    /// Filter widths Δ_f \[m\].
    pub widths: Vec<f64>,
    /// The bins.
    pub bins: Bins,
    /// Duration of a block of time \[s\].
    pub block_duration: f64,
    /// Blocks in the order of time; blocks without a sample are left out.
    pub blocks: Vec<BlockSums>,
}

/// Sums that cannot be put together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MergeError {
    /// The filter widths differ.
    #[error("filter.widths differ: {ours:?} m and {theirs:?} m; pool runs of equal widths only")]
    Widths {
        /// Widths of the first sums \[m\].
        ours: Vec<f64>,
        /// Widths of the other sums \[m\].
        theirs: Vec<f64>,
    },
    /// The bins differ.
    #[error("bins differ: {ours:?} and {theirs:?}; sample the runs again with equal bins")]
    Bins {
        /// Bins of the first sums.
        ours: Bins,
        /// Bins of the other sums.
        theirs: Bins,
    },
    /// The blocks of time differ in duration.
    #[error("block durations differ: {ours} s and {theirs} s; sample the runs with one duration")]
    BlockDuration {
        /// Duration of the first sums' blocks \[s\].
        ours: f64,
        /// Duration of the other sums' blocks \[s\].
        theirs: f64,
    },
}

impl Sums {
    fn new(widths: Vec<f64>, bins: Bins, block_duration: f64) -> Self {
        Self { widths, bins, block_duration, blocks: Vec::new() }
    }

    /// Whether other sums are of the same widths, bins and blocks.
    fn matches(&self, other: &Self) -> Result<(), MergeError> {
        if self.widths != other.widths {
            let (ours, theirs) = (self.widths.clone(), other.widths.clone());
            return Err(MergeError::Widths { ours, theirs });
        }
        if self.bins != other.bins {
            return Err(MergeError::Bins { ours: self.bins.clone(), theirs: other.bins.clone() });
        }
        if self.block_duration != other.block_duration {
            let (ours, theirs) = (self.block_duration, other.block_duration);
            return Err(MergeError::BlockDuration { ours, theirs });
        }
        Ok(())
    }

    /// Adds another piece of the same run, as after an interruption: the sums become those of the
    /// uninterrupted run, bit for bit if the pieces share no block. Different runs are not merged
    /// but handed to [`bin_table`] side by side.
    ///
    /// # Errors
    /// [`MergeError`] if the widths, bins or block durations differ.
    pub fn merge(&mut self, other: &Self) -> Result<(), MergeError> {
        self.matches(other)?;
        for theirs in &other.blocks {
            match self.blocks.binary_search_by_key(&theirs.place, |block| block.place) {
                Ok(found) => {
                    let ours = &mut self.blocks[found];
                    ours.instants += theirs.instants;
                    for (ours, theirs) in ours.widths.iter_mut().zip(&theirs.widths) {
                        for sums in theirs {
                            match ours.iter_mut().find(|bin| bin.bin == sums.bin) {
                                Some(bin) => bin.merge(sums),
                                None => ours.push(sums.clone()),
                            }
                        }
                    }
                }
                Err(gap) => self.blocks.insert(gap, theirs.clone()),
            }
        }
        Ok(())
    }

    /// Forgets all blocks that began before `time` \[s\].
    pub fn discard_before(&mut self, time: f64) {
        let first = (time / self.block_duration - BLOCK_TOLERANCE).ceil();
        self.blocks.retain(|block| block.place as f64 >= first);
    }
}

/// Times this close to the next block, in block durations, belong to it: a time that is a sum of
/// steps lies a little beside the multiple of the duration that is meant.
const BLOCK_TOLERANCE: f64 = 1e-6;

/// Filter positions handled together, so that the drag law's loop vectorises.
const CHUNK: usize = 64;

/// Row of a bin that has not been visited in the current block.
const UNVISITED: u32 = u32::MAX;

/// Filters fine fields, in flight, and adds what it finds to [`Sums`].
#[derive(Clone, Debug)]
pub struct Sampler<const D: usize, L> {
    filter: MomentFilter<D>,
    law: L,
    scales: Scales,
    sums: Sums,
    /// For each width and bin its place in the current block.
    rows: Vec<Vec<u32>>,
}

impl<const D: usize, L: DragLaw<f64>> Sampler<D, L> {
    /// A sampler of fields on `grid` for filters of `widths` \[m\]. `law` is the fine-grid drag law,
    /// `block_duration` \[s\] the duration of a block of time: at least a few sampling intervals, and
    /// short enough for dozens of blocks in a run; it need not exceed the correlation time.
    ///
    /// # Errors
    /// [`FilterError`] if a width is not a whole number of cells or exceeds the box.
    ///
    /// # Panics
    /// If the block duration is not positive.
    pub fn new(
        grid: Grid<D>,
        law: L,
        scales: Scales,
        bins: Bins,
        widths: &[f64],
        block_duration: f64,
    ) -> Result<Self, FilterError> {
        assert!(block_duration > 0.0, "block duration {block_duration} s");
        let cells: Vec<[usize; D]> =
            widths.iter().map(|&width| width_in_cells(&grid, width)).collect::<Result<_, _>>()?;
        Ok(Self {
            filter: MomentFilter::new(grid, &cells)?,
            law,
            scales,
            rows: vec![vec![UNVISITED; bins.len()]; widths.len()],
            sums: Sums::new(widths.to_vec(), bins, block_duration),
        })
    }

    /// The sums so far.
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Goes on from the sums of an interrupted run, in place of its own, as if never interrupted.
    ///
    /// # Errors
    /// [`MergeError`] if the widths, bins or block durations differ.
    pub fn resume(&mut self, sums: Sums) -> Result<(), MergeError> {
        self.sums.matches(&sums)?;
        self.sums = sums;
        self.rows.iter_mut().for_each(|rows| rows.fill(UNVISITED));
        if let Some(block) = self.sums.blocks.last() {
            for (rows, visited) in self.rows.iter_mut().zip(&block.widths) {
                for (place, sums) in visited.iter().enumerate() {
                    rows[sums.bin] = place as u32;
                }
            }
        }
        Ok(())
    }

    /// The sums, at the end.
    pub fn into_sums(self) -> Sums {
        self.sums
    }

    /// Adds the fields of one instant. Instants come in the order of time.
    ///
    /// # Panics
    /// If the fields are not on the sampler's grid.
    pub fn sample(&mut self, fields: &FineFields<D>) {
        let place = (fields.time / self.sums.block_duration + BLOCK_TOLERANCE).max(0.0) as u64;
        if self.sums.blocks.last().is_none_or(|block| block.place != place) {
            let widths = vec![Vec::new(); self.sums.widths.len()];
            self.sums.blocks.push(BlockSums { place, instants: 0, widths });
            self.rows.iter_mut().for_each(|rows| rows.fill(UNVISITED));
        }
        self.filter.filter(fields);
        let Some(block) = self.sums.blocks.last_mut() else { return };
        block.instants += 1;

        let bins = &self.sums.bins;
        let per_velocity = 1.0 / self.scales.terminal_velocity;
        for (number, columns) in self.filter.moments().iter().enumerate() {
            let (width, sums) = (self.sums.widths[number], &mut block.widths[number]);
            let rows = &mut self.rows[number];
            for start in (0..columns.len()).step_by(CHUNK) {
                let len = CHUNK.min(columns.len() - start);
                let mut fraction = [0.0; CHUNK];
                let mut speed = [0.0; CHUNK];
                for n in 0..len {
                    let moments = columns.at(start + n);
                    fraction[n] = moments.solids_fraction;
                    speed[n] = moments.slip_speed();
                }
                let mut beta = [0.0; CHUNK];
                self.law.betas(&mut beta, &fraction, &speed);
                for (n, &beta) in beta[..len].iter().enumerate() {
                    let moments = columns.at(start + n);
                    let at = Filtered::new(&moments, beta, self.scales.density, width);
                    let slip = at.slip * per_velocity;
                    let bin = bins.bin(at.solids_fraction, slip);
                    if rows[bin] == UNVISITED {
                        rows[bin] = sums.len() as u32;
                        sums.push(BinSums::new(bin));
                    }
                    sums[rows[bin] as usize].add(&at, slip);
                }
            }
        }
    }
}

/// The bin table of several runs' sums, pooled: one row per quantity, filter width and visited bin,
/// in this order, slip bins before fraction bins.
///
/// Errors are those of [`Estimator`]: a bin of which too few blocks tell keeps its row, with its
/// value, an infinite error and no effective samples. `effective_samples` is the variance of a single filter
/// position's residual over the squared standard error: the number of independent positions that
/// would give the same error. A quantity whose denominator vanishes throughout a bin, such as a
/// viscosity without shear, has no row.
///
/// # Errors
/// [`MergeError`] if the runs' widths, bins or block durations differ.
pub fn bin_table(runs: &[Sums], scales: &Scales) -> Result<Vec<BinRow>, MergeError> {
    let Some(first) = runs.first() else { return Ok(Vec::new()) };
    for run in runs {
        first.matches(run)?;
    }
    let visits: Vec<Vec<Vec<Visit>>> =
        (0..first.widths.len()).map(|width| visits(runs, width)).collect();
    let mut estimator = Estimator::default();
    let mut rows = Vec::new();
    for quantity in 0..QUANTITY_COUNT {
        for (&width, visits) in first.widths.iter().zip(&visits) {
            for visits in visits.iter().filter(|visits| !visits.is_empty()) {
                let found = estimator.estimate(&blocks(runs, visits, quantity));
                if found.ratio.is_finite() {
                    rows.push(row(quantity, width, visits, &found, &first.bins, scales));
                }
            }
        }
    }
    Ok(rows)
}

/// A bin's sums in one block of one run.
struct Visit<'a> {
    run: usize,
    block: usize,
    sums: &'a BinSums,
}

/// The sums of `quantity` in every block of the runs that visited a bin.
fn blocks(runs: &[Sums], visits: &[Visit], quantity: usize) -> Vec<Run> {
    let of_run = |visits: &[Visit]| {
        // A block that did not visit the bin saw nothing there.
        let mut sums = vec![[0.0; 2]; runs[visits[0].run].blocks.len()];
        for visit in visits {
            let pair = &visit.sums.pairs[quantity];
            sums[visit.block] = [pair.numerator, pair.denominator];
        }
        Run::in_time(sums)
    };
    visits.chunk_by(|a, b| a.run == b.run).map(of_run).collect()
}

/// For each bin its visits at filter width number `width`, ordered by run and time.
fn visits(runs: &[Sums], width: usize) -> Vec<Vec<Visit<'_>>> {
    let bins = runs.first().map_or(0, |run| run.bins.len());
    let mut visits: Vec<Vec<Visit>> = (0..bins).map(|_| Vec::new()).collect();
    for (number, run) in runs.iter().enumerate() {
        for (place, block) in run.blocks.iter().enumerate() {
            for sums in &block.widths[width] {
                visits[sums.bin].push(Visit { run: number, block: place, sums });
            }
        }
    }
    visits
}

/// The row of a quantity in a bin that was visited.
fn row(
    quantity: usize,
    width: f64,
    visits: &[Visit],
    found: &Estimate,
    bins: &Bins,
    scales: &Scales,
) -> BinRow {
    let mut total = visits[0].sums.clone();
    visits[1..].iter().for_each(|visit| total.merge(visit.sums));
    let pair = &total.pairs[quantity];
    let positions = total.positions as f64;
    let deviation = pair.residual(found.ratio) * positions / (pair.denominator * pair.denominator);
    let effective_samples = if found.standard_error > 0.0 {
        deviation / found.standard_error.powi(2)
    } else {
        // No block deviates at all: nothing says that the positions are correlated.
        positions
    };
    let Quantity { name, kind, map, .. } = QUANTITIES[quantity];
    let value = map.value(found.ratio);
    let [low_95, high_95] = map.interval(found.interval_95);
    let [solids_fraction_low, solids_fraction_high] = bins.fraction_edges(total.bin);
    let [slip_low, slip_high] = bins.slip_edges(total.bin);
    BinRow {
        quantity: name.to_owned(),
        unit: kind.unit().to_owned(),
        filter_width: width,
        filter_width_l_i: width / scales.length_i(),
        filter_width_l_ii: width / scales.length_ii(),
        solids_fraction: total.solids_fraction / positions,
        solids_fraction_low,
        solids_fraction_high,
        slip: total.slip / positions,
        slip_low,
        slip_high,
        value,
        standard_error: found.standard_error,
        low_95,
        high_95,
        value_scaled: value / kind.scale(scales),
        samples: total.positions,
        effective_samples,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::drag::WenYu;
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::moments::tests::random_fields;

    fn scales() -> Scales {
        Scales::new(&POWDER, &GAS, 9.81)
    }

    fn sampler<const D: usize>(
        grid: Grid<D>,
        widths: &[f64],
        slip: Option<f64>,
    ) -> Sampler<D, WenYu<f64>> {
        let bins = Bins::new(0.05, POWDER.max_packing, slip);
        Sampler::new(grid, WenYu::new(&GAS, &POWDER), scales(), bins, widths, 0.01).unwrap()
    }

    fn sampled<const D: usize>(
        grid: Grid<D>,
        widths: &[f64],
        slip: Option<f64>,
        instants: std::ops::Range<u64>,
    ) -> Sums {
        let mut sampler = sampler(grid, widths, slip);
        for instant in instants {
            let mut fields = random_fields(grid, instant);
            fields.time = 0.005 * instant as f64;
            sampler.sample(&fields);
        }
        sampler.into_sums()
    }

    fn rows_of<'a>(rows: &'a [BinRow], name: &str, width: f64) -> Vec<&'a BinRow> {
        rows.iter().filter(|row| row.quantity == name && row.filter_width == width).collect()
    }

    /// A filter of one cell filters nothing: no drag correction, no drift, no residual stress.
    fn check_one_cell<const D: usize>(cells: [usize; D], slip: Option<f64>) {
        let grid = Grid::new(cells.map(|n| 0.002 * n as f64), cells);
        let sums = sampled(grid, &[0.002], slip, 0..20);
        let rows = bin_table(&[sums], &scales()).unwrap();
        for name in ["drag_correction", "drag_correction_no_pressure"] {
            let rows = rows_of(&rows, name, 0.002);
            assert!(rows.len() >= 12);
            for row in rows {
                assert!(row.value.abs() < 1e-12, "{name} {}", row.value);
                assert!(row.standard_error < 1e-12);
            }
        }
        for (name, bound) in [
            ("drift_velocity", 1e-14),
            ("solids_fraction_variance", 1e-16),
            ("solids_pressure_residual", 1e-11),
        ] {
            for row in rows_of(&rows, name, 0.002) {
                assert!(row.value.abs() < bound, "{name} {}", row.value);
            }
        }
        // What is not a filter's doing stays: the mean of the fine slip.
        let rows = rows_of(&rows, "slip", 0.002);
        let (mut total, mut count) = (0.0, 0);
        for fields in (0..20).map(|instant| random_fields(grid, instant)) {
            let phases = fields.solids_fraction.iter().zip(&fields.solids_velocity[D - 1]);
            for ((&fraction, solids), gas) in phases.zip(&fields.gas_velocity[D - 1]) {
                total += if fraction > 0.0 { gas - solids } else { *gas };
                count += 1;
            }
        }
        assert_eq!(rows.iter().map(|row| row.samples).sum::<u64>(), count);
        let sum: f64 = rows.iter().map(|row| row.value * row.samples as f64).sum();
        assert!((sum - total).abs() < 1e-9 * total, "{sum} {total}");
        for row in rows {
            assert!((row.value_scaled * scales().terminal_velocity - row.value).abs() < 1e-15);
            assert!((row.value_scaled - row.slip).abs() < 1e-13, "the marker is the slip too");
        }
    }

    #[test]
    fn one_cell_needs_no_correction() {
        check_one_cell([24, 20], None);
        check_one_cell([8, 10, 6], None);
    }

    #[test]
    fn wider_filters_of_random_fields_need_a_correction() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let rows = bin_table(&[sampled(grid, &[0.008], None, 0..40)], &scales()).unwrap();
        let corrections = rows_of(&rows, "drag_correction_no_pressure", 0.008);
        let row = corrections.iter().max_by_key(|row| row.samples).unwrap();
        // Independent φ and velocities: the filtered slip is far smaller than the fine one, which
        // raises the filtered drag through β alone, so that H is negative.
        assert!(row.value < -5.0 * row.standard_error, "{row:?}");
    }

    #[test]
    fn overlapping_positions_are_not_counted_as_independent() {
        let grid = Grid::new([0.064, 0.064], [32, 32]);
        let rows = bin_table(&[sampled(grid, &[0.002, 0.008], None, 0..128)], &scales()).unwrap();
        // Independent cells, at independent instants, are worth what they are: the error is the
        // largest of several estimates, so that somewhat less is found.
        let share = |width: f64| {
            let rows = rows_of(&rows, "granular_temperature", width);
            let often = rows.iter().filter(|row| row.samples > 20_000);
            let shares: Vec<f64> =
                often.map(|row| row.effective_samples / row.samples as f64).collect();
            assert!(!shares.is_empty());
            shares.iter().sum::<f64>() / shares.len() as f64
        };
        let (single, overlapping) = (share(0.002), share(0.008));
        assert!((0.4..1.2).contains(&single), "{single}");
        // Filters of 4 x 4 cells at every cell: 16 positions share a filter's volume.
        assert!((0.05 * single..0.35 * single).contains(&overlapping), "{overlapping} {single}");
    }

    #[test]
    fn pieces_of_a_run_merge_to_the_run() {
        let grid = Grid::new([0.032, 0.016], [16, 8]);
        let widths = [0.004, 0.008];
        let whole = sampled(grid, &widths, Some(0.2), 0..20);
        assert_eq!(whole.blocks.len(), 10);
        // Instants 0 to 7 end with a block: bit for bit the same.
        let mut pieces = sampled(grid, &widths, Some(0.2), 0..8);
        pieces.merge(&sampled(grid, &widths, Some(0.2), 8..20)).unwrap();
        assert_eq!(pieces, whole);
        // Cut within a block, and merged in the wrong order.
        let mut pieces = sampled(grid, &widths, Some(0.2), 9..20);
        pieces.merge(&sampled(grid, &widths, Some(0.2), 0..9)).unwrap();
        let instants = |sums: &Sums| -> Vec<(u64, u64)> {
            sums.blocks.iter().map(|block| (block.place, block.instants)).collect()
        };
        assert_eq!(instants(&pieces), instants(&whole));
        let table = bin_table(&[pieces], &scales()).unwrap();
        let expected = bin_table(&[whole], &scales()).unwrap();
        assert_eq!(table.len(), expected.len());
        for (found, expected) in table.iter().zip(&expected) {
            assert_eq!((&found.quantity, found.samples), (&expected.quantity, expected.samples));
            let size = expected.value.abs().max(1.0);
            assert!((found.value - expected.value).abs() < 1e-12 * size, "{found:?}");
        }
    }

    #[test]
    fn a_sampler_goes_on_within_a_block_to_the_same_bits() {
        let grid = Grid::new([0.032, 0.016], [16, 8]);
        let whole = sampled(grid, &[0.004, 0.008], Some(0.2), 0..12);
        for cut in [0, 1, 6, 7] {
            // What the sampler saw before it was handed the sums is forgotten.
            let mut sampler = sampler(grid, &[0.004, 0.008], Some(0.2));
            sampler.sample(&random_fields(grid, 99));
            sampler.resume(sampled(grid, &[0.004, 0.008], Some(0.2), 0..cut)).unwrap();
            for instant in cut..12 {
                let mut fields = random_fields(grid, instant);
                fields.time = 0.005 * instant as f64;
                sampler.sample(&fields);
            }
            assert_eq!(sampler.into_sums(), whole, "cut at instant {cut}");
        }
        let other = sampled(grid, &[0.004], Some(0.2), 0..1);
        let refused = sampler(grid, &[0.008], Some(0.2)).resume(other);
        assert!(matches!(refused, Err(MergeError::Widths { .. })));
    }

    #[test]
    fn pooled_runs_give_one_value_from_all_blocks() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let runs = [sampled(grid, &[0.004], None, 0..20), sampled(grid, &[0.004], None, 20..60)];
        let pooled = bin_table(&runs, &scales()).unwrap();
        let long = bin_table(&[sampled(grid, &[0.004], None, 0..60)], &scales()).unwrap();
        for (pooled, long) in pooled.iter().zip(&long) {
            assert_eq!(pooled.samples, long.samples);
            assert_eq!(pooled.value, long.value);
        }
        let order: Vec<_> = pooled
            .iter()
            .map(|row| {
                let quantity = QUANTITIES.iter().position(|q| q.name == row.quantity).unwrap();
                (quantity, row.filter_width, row.slip_low, row.solids_fraction_low)
            })
            .collect();
        assert!(order.is_sorted());
    }

    #[test]
    fn runs_that_differ_are_not_pooled() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let one = sampled(grid, &[0.004], None, 0..1);
        let widths = sampled(grid, &[0.008], None, 0..1);
        let bins = sampled(grid, &[0.004], Some(0.1), 0..1);
        let duration = Sums { block_duration: 0.02, ..one.clone() };
        let error = |other: Sums| bin_table(&[one.clone(), other], &scales()).unwrap_err();
        assert!(matches!(error(widths), MergeError::Widths { .. }));
        assert!(matches!(error(bins), MergeError::Bins { .. }));
        assert!(matches!(error(duration), MergeError::BlockDuration { .. }));
        assert_eq!(bin_table(&[], &scales()), Ok(Vec::new()));
    }

    #[test]
    fn a_transient_is_cut_at_whole_blocks() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let all = sampled(grid, &[0.004], None, 0..20);
        let places = |time: f64| {
            let mut sums = all.clone();
            sums.discard_before(time);
            sums.blocks.iter().map(|block| block.place).collect::<Vec<_>>()
        };
        assert_eq!(places(0.0), (0..10).collect::<Vec<_>>());
        assert_eq!(places(3.0 * 0.01), (3..10).collect::<Vec<_>>());
        assert_eq!(places(0.031), (4..10).collect::<Vec<_>>());
        assert!(places(1.0).is_empty());
    }

    #[test]
    fn rare_bins_have_infinite_errors() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let rows = bin_table(&[sampled(grid, &[0.002], None, 0..8)], &scales()).unwrap();
        assert!(!rows.is_empty());
        for row in rows {
            assert_eq!(row.standard_error, f64::INFINITY);
            assert_eq!((row.low_95, row.high_95), (f64::NEG_INFINITY, f64::INFINITY));
            assert_eq!(row.effective_samples, 0.0);
            assert!(row.value.is_finite());
        }
    }

    #[test]
    fn bins_hold_what_falls_into_them() {
        let bins = Bins::new(0.05, 0.65, Some(0.5));
        assert_eq!((bins.fraction_count, bins.len()), (13, 13 * 18));
        for fraction in [-1e-18, 0.0, 0.12, 0.649, 0.7] {
            for slip in [-9.0, -2.0, -0.3, 0.0, 0.7, 5.99, 6.5] {
                let bin = bins.bin(fraction, slip);
                let [low, high] = bins.slip_edges(bin);
                assert!(low <= slip && slip < high, "{low} {slip} {high}");
                let [low, high] = bins.fraction_edges(bin);
                let inside = fraction.clamp(0.0, 0.65 - 1e-12);
                assert!(low <= inside && inside < high, "{low} {fraction} {high}");
            }
        }
        assert_eq!(Bins::new(0.1, 0.65, None).len(), 7);
    }
}
