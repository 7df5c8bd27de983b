//! [`Sampler`], [`Sums`], [`bin_table`]: conditional statistics of the filtered quantities.
//!
//! Filter positions are binned by their filtered solids fraction, and by up to two more markers.
//! Every quantity is a ratio or a slope of sums of [`Term`]s over a bin's positions; sums are kept
//! per block of time, and of space if asked, so that runs merge, a transient can be cut off
//! afterwards, and errors come from blocks and not from filter positions, which overlap. Nothing is
//! subtracted and no mean is removed while sampling: merging is adding.

use crate::blocking::{Estimate, Estimator, Run};
use crate::filter::{FilterError, width_in_cells};
use crate::filtered::{
    Densities, Kind, Moments, QUANTITIES, QUANTITY_COUNT, Quantity, TERM_COUNT, Term, term_count,
    terms,
};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::lanes::{LANES, Lanes, Number, transpose};
use crate::laws::drag::DragLaw;
use crate::laws::scales::Scales;
use crate::moments::{MomentColumns, MomentFilter};
use crate::rows::{each_chunk, simd};
use crate::spectral::Kernel;
use crate::table::BinRow;
use std::collections::BTreeMap;

/// What filter positions may be binned by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Marker {
    /// φ̄.
    SolidsFraction,
    /// Vertical filtered slip over u_t.
    Slip,
    /// Filtered slip speed over u_t.
    SlipSpeed,
    /// Vertical filtered pressure gradient (periodic part) over ρ_s g.
    PressureGradient,
    /// Shear rate S of the Favre-filtered solids velocity times u_t/g.
    ShearRate,
    /// |∇φ̄| times L_I.
    FractionGradient,
    /// Sub-filter variance of φ.
    Variance,
}

impl Marker {
    /// All markers, in the order of their numbers.
    pub const ALL: [Self; 7] = [
        Self::SolidsFraction,
        Self::Slip,
        Self::SlipSpeed,
        Self::PressureGradient,
        Self::ShearRate,
        Self::FractionGradient,
        Self::Variance,
    ];

    /// Name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SolidsFraction => "solids_fraction",
            Self::Slip => "slip",
            Self::SlipSpeed => "slip_speed",
            Self::PressureGradient => "pressure_gradient",
            Self::ShearRate => "shear_rate",
            Self::FractionGradient => "solids_fraction_gradient",
            Self::Variance => "solids_fraction_variance",
        }
    }

    /// The term that it is.
    pub const fn term(self) -> Term {
        match self {
            Self::SolidsFraction => Term::SolidsFraction,
            Self::Slip => Term::Slip,
            Self::SlipSpeed => Term::SlipSpeed,
            Self::PressureGradient => Term::PressureGradient,
            Self::ShearRate => Term::ShearRate,
            Self::FractionGradient => Term::FractionGradient,
            Self::Variance => Term::Variance,
        }
    }

    /// What it is scaled by.
    pub const fn kind(self) -> Kind {
        match self {
            Self::SolidsFraction | Self::Variance => Kind::Number,
            Self::Slip | Self::SlipSpeed => Kind::Velocity,
            Self::PressureGradient => Kind::Force,
            Self::ShearRate => Kind::Rate,
            Self::FractionGradient => Kind::Gradient,
        }
    }
}

/// A marker and the edges of its bins.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// The marker.
    pub marker: Marker,
    /// Edges of the bins, ascending, scaled as the marker says. The first and the last bin also take
    /// what lies beyond; outermost edges that are infinite say so in the tables.
    pub edges: Vec<f64>,
    /// Into how many bins of about equally many filter positions the bins are put together in a
    /// table, for each filter width; none if they stay as they are.
    pub quantiles: Option<usize>,
}

/// Slip bins of width w cover this range of slip / u_t; the first and the last are open.
const SLIP_RANGE: [f64; 2] = [-2.0, 6.0];

/// Bins from which quantiles are made.
const FINE_BINS: usize = 48;

impl Axis {
    /// Bins between `edges`.
    pub fn new(marker: Marker, edges: Vec<f64>) -> Self {
        Self { marker, edges, quantiles: None }
    }

    /// Bins of solids fraction of this `width`, from 0 to at least `max_packing`.
    ///
    /// # Panics
    /// If the width is not a positive number.
    pub fn of_fractions(width: f64, max_packing: f64) -> Self {
        assert!(width > 0.0, "bins of {width}");
        let edges = (0..=bins_of(max_packing, width)).map(|edge| edge as f64 * width);
        Self::new(Marker::SolidsFraction, edges.collect())
    }

    /// Bins of vertical slip / u_t of this `width`, from -2 to 6, open at both ends.
    ///
    /// # Panics
    /// If the width is not a positive number.
    pub fn of_slips(width: f64) -> Self {
        assert!(width > 0.0, "bins of {width}");
        let [low, high] = SLIP_RANGE;
        let inner = (0..=bins_of(high - low, width)).map(|edge| low + edge as f64 * width);
        Self::new(Marker::Slip, open(inner.collect()))
    }

    /// `quantiles` bins of about equally many filter positions. Positions are counted in finer bins,
    /// which sums of different runs have in common; tables put these together.
    pub fn in_quantiles(marker: Marker, quantiles: usize, max_packing: f64) -> Self {
        let linear = |[low, high]: [f64; 2]| -> Vec<f64> {
            let step = (high - low) / FINE_BINS as f64;
            (0..=FINE_BINS).map(|edge| low + step * edge as f64).collect()
        };
        let logarithmic = |range: [f64; 2]| -> Vec<f64> {
            linear(range.map(f64::log10)).into_iter().map(|edge| 10f64.powf(edge)).collect()
        };
        let edges = match marker {
            Marker::SolidsFraction => linear([0.0, max_packing]),
            Marker::Slip => open(linear(SLIP_RANGE)),
            Marker::SlipSpeed => open(linear([0.0, SLIP_RANGE[1]])),
            Marker::PressureGradient => open(linear([-1.0, 1.0])),
            Marker::ShearRate => open(logarithmic([0.02, 20.0])),
            Marker::FractionGradient => open(logarithmic([0.005, 5.0])),
            Marker::Variance => open(logarithmic([1e-6, 0.1])),
        };
        Self { marker, edges, quantiles: Some(quantiles) }
    }

    /// Number of bins.
    fn len(&self) -> usize {
        self.edges.len() - 1
    }

    /// The bin of a scaled value.
    #[inline(always)]
    fn bin(&self, value: f64) -> usize {
        let inner = &self.edges[1..self.edges.len() - 1];
        inner.partition_point(|edge| *edge <= value)
    }

    /// For each bin the first and the last of those that it is put together with, given how many
    /// positions are in each.
    fn groups(&self, positions: &[f64]) -> Vec<[usize; 2]> {
        let Some(quantiles) = self.quantiles else {
            return (0..self.len()).map(|bin| [bin; 2]).collect();
        };
        let total: f64 = positions.iter().sum();
        let mut groups: Vec<[usize; 2]> = Vec::with_capacity(self.len());
        let (mut first, mut before, mut group) = (0, 0.0, 0);
        for (bin, positions) in positions.iter().enumerate() {
            // A bin belongs to the quantile in which its middle position lies.
            let middle = (before + 0.5 * positions) / total * quantiles as f64;
            let here = (middle as usize).min(quantiles - 1);
            if here > group {
                (first, group) = (bin, here);
            }
            before += positions;
            groups.push([first, bin]);
        }
        // All bins of a group know its last.
        for bin in (0..self.len().saturating_sub(1)).rev() {
            if groups[bin][0] == groups[bin + 1][0] {
                groups[bin][1] = groups[bin + 1][1];
            }
        }
        groups
    }
}

/// Bins of `width` that cover `range`.
fn bins_of(range: f64, width: f64) -> usize {
    // Round-off in the quotient must not add an empty bin.
    ((range / width - 1e-9).ceil() as usize).max(1)
}

/// The edges, and bins beyond.
fn open(edges: Vec<f64>) -> Vec<f64> {
    std::iter::once(f64::NEG_INFINITY).chain(edges).chain([f64::INFINITY]).collect()
}

/// Bins of filtered solids fraction and of up to two more markers.
#[derive(Clone, Debug, PartialEq)]
pub struct Bins {
    /// One axis per marker; the first is the solids fraction.
    pub axes: Vec<Axis>,
}

impl Bins {
    /// Bins of solids fraction `fraction_width` wide from 0 to at least `max_packing`; with
    /// `slip_width` also bins of vertical slip / u_t, that wide from -2 to 6, open at both ends.
    ///
    /// # Panics
    /// If a width is not a positive number.
    pub fn new(fraction_width: f64, max_packing: f64, slip_width: Option<f64>) -> Self {
        let fractions = Axis::of_fractions(fraction_width, max_packing);
        Self { axes: std::iter::once(fractions).chain(slip_width.map(Axis::of_slips)).collect() }
    }

    /// Number of bins.
    pub fn len(&self) -> usize {
        self.axes.iter().map(Axis::len).product()
    }

    /// Whether there is no bin.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The bin of a position with these terms, where `per_unit` are the reciprocals of the markers'
    /// scales. Bins of the first axis run fastest.
    #[inline(always)]
    fn bin(&self, term: impl Fn(Term) -> f64, per_unit: &[f64]) -> usize {
        let axes = self.axes.iter().zip(per_unit).rev();
        axes.fold(0, |bin, (axis, per_unit)| {
            bin * axis.len() + axis.bin(term(axis.marker.term()) * per_unit)
        })
    }

    /// Place of `bin` along each axis.
    fn places(&self, mut bin: usize) -> Vec<usize> {
        let along = |axis: &Axis| {
            let place = bin % axis.len();
            bin /= axis.len();
            place
        };
        self.axes.iter().map(along).collect()
    }

    /// Lower and upper edge of `bin` along each axis.
    pub fn edges(&self, bin: usize) -> Vec<[f64; 2]> {
        let places = self.places(bin).into_iter().zip(&self.axes);
        places.map(|(place, axis)| [axis.edges[place], axis.edges[place + 1]]).collect()
    }

    /// Reciprocals of the markers' scales.
    fn per_unit(&self, scales: &Scales) -> Vec<f64> {
        self.axes.iter().map(|axis| 1.0 / axis.marker.kind().scale(scales)).collect()
    }
}

/// Numbers of a [`Spread`]: how many positions, and Σ num², Σ num den, Σ den² of each quantity.
pub(crate) const SPREAD: usize = 1 + 3 * QUANTITY_COUNT;

/// One block of time in so many, and of its positions one in so many, tells how far single positions lie
/// from the mean: it need not be known better, and spreads take three times the room of sums.
const SPREAD_BLOCKS: u64 = 8;
const SPREAD_POSITIONS: usize = 2;

/// Sums of the bins that were visited at one filter width during one block of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Visits {
    /// For each visit its bin, plus the number of bins times its block of space.
    pub keys: Vec<u32>,
    /// Sums of the [`Term`]s over the positions: [`TERM_COUNT`] for each visit.
    pub sums: Vec<f64>,
    /// For each visit of one block in eight the positions looked at, and Σ num², Σ num den and Σ den²
    /// of each quantity over them; empty in the others.
    pub spreads: Vec<f64>,
}

impl Visits {
    /// The sums of visit number `visit`.
    fn of(&self, visit: usize) -> &[f64] {
        &self.sums[visit * TERM_COUNT..][..TERM_COUNT]
    }

    /// The spread of visit number `visit`; empty if it was not looked at.
    fn spread(&self, visit: usize) -> &[f64] {
        self.spreads.get(visit * SPREAD..(visit + 1) * SPREAD).unwrap_or_default()
    }

    fn push(&mut self, key: u32, spread: bool) {
        self.keys.push(key);
        self.sums.resize(self.sums.len() + TERM_COUNT, 0.0);
        if spread {
            self.spreads.resize(self.spreads.len() + SPREAD, 0.0);
        }
    }

    /// Adds the visits of another piece of the same block.
    fn merge(&mut self, other: &Self) {
        for (theirs, &key) in other.keys.iter().enumerate() {
            let ours = self.keys.iter().position(|ours| *ours == key).unwrap_or_else(|| {
                self.push(key, !other.spreads.is_empty());
                self.keys.len() - 1
            });
            let add = |ours: &mut [f64], theirs: &[f64]| {
                ours.iter_mut().zip(theirs).for_each(|(ours, theirs)| *ours += theirs);
            };
            add(&mut self.sums[ours * TERM_COUNT..], other.of(theirs));
            if !self.spreads.is_empty() {
                add(&mut self.spreads[ours * SPREAD..], other.spread(theirs));
            }
        }
        self.sort();
    }

    /// Puts the visits in the order of their keys, whatever the order of the first visits was.
    fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.keys.len()).collect();
        order.sort_by_key(|&visit| self.keys[visit]);
        let sums = order.iter().flat_map(|&visit| self.of(visit)).copied().collect();
        let spreads = order.iter().flat_map(|&visit| self.spread(visit)).copied().collect();
        let keys = order.iter().map(|&visit| self.keys[visit]).collect();
        *self = Self { keys, sums, spreads };
    }
}

/// Sums of one block of time.
#[derive(Clone, Debug, PartialEq)]
pub struct BlockSums {
    /// The block spans the times `place` to `place + 1` block durations.
    pub place: u64,
    /// Instants sampled.
    pub instants: u64,
    /// For each filter width the bins that were visited.
    pub widths: Vec<Visits>,
}

impl BlockSums {
    fn sort(&mut self) {
        self.widths.iter_mut().for_each(Visits::sort);
    }
}

/// What the sums of a run are of: runs that agree in it can be pooled.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Simulated dimensions, 2 or 3.
    pub dimension: usize,
    /// ρ_s and ρ_g \[kg/m³\].
    pub densities: [f64; 2],
    /// The filter kernel.
    pub kernel: Kernel,
    /// Edge of a cell of the fine grid along each axis \[m\].
    pub spacing: Vec<f64>,
    /// Filter widths Δ_f \[m\].
    pub widths: Vec<f64>,
    /// The bins.
    pub bins: Bins,
    /// Duration of a block of time \[s\].
    pub block_duration: f64,
    /// Blocks of space along each axis; 1 if space is not divided.
    pub space: [usize; 3],
}

impl Layout {
    /// Blocks of space.
    pub(crate) fn places(&self) -> usize {
        self.space.iter().product()
    }

    /// Edge of a cube, in two dimensions of a square, of a fine cell's volume \[m\].
    pub fn cell(&self) -> f64 {
        self.spacing.iter().product::<f64>().powf(1.0 / self.spacing.len() as f64)
    }

    /// Whether other sums are of cells of the same edges, to round-off.
    pub fn same_grid(&self, other: &Self) -> bool {
        let alike = |(a, b): (&f64, &f64)| (a / b - 1.0).abs() < 1e-6;
        self.spacing.len() == other.spacing.len()
            && self.spacing.iter().zip(&other.spacing).all(alike)
    }

    pub(crate) fn densities(&self) -> Densities {
        Densities { solids: self.densities[0], gas: self.densities[1] }
    }
}

/// The mergeable sums of one run, from which every statistic follows.
#[derive(Clone, Debug, PartialEq)]
pub struct Sums {
    /// What they are sums of.
    pub layout: Layout,
    /// Blocks in the order of time; blocks without a sample are left out.
    pub blocks: Vec<BlockSums>,
}

/// Sums that cannot be put together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MergeError {
    /// The dimensions differ.
    #[error("a run in {ours} dimensions and one in {theirs} are not pooled")]
    Dimension {
        /// Dimensions of the first sums.
        ours: usize,
        /// Dimensions of the other sums.
        theirs: usize,
    },
    /// The densities differ.
    #[error(
        "densities differ: {ours:?} and {theirs:?} kg/m³ of solids and gas; pool runs of one \
         powder in one gas only"
    )]
    Densities {
        /// Densities of the first sums \[kg/m³\].
        ours: [f64; 2],
        /// Densities of the other sums \[kg/m³\].
        theirs: [f64; 2],
    },
    /// The kernels differ.
    #[error("filter kernels differ: {ours} and {theirs}; pool runs of one kernel only")]
    Kernel {
        /// Kernel of the first sums.
        ours: &'static str,
        /// Kernel of the other sums.
        theirs: &'static str,
    },
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
    /// The grids differ.
    #[error(
        "cells differ: edges of {ours:?} m and {theirs:?} m; a table is of one grid, `favre filter` \
         puts grids together"
    )]
    Grid {
        /// Edges of the first sums' cells \[m\].
        ours: Vec<f64>,
        /// Edges of the other sums' cells \[m\].
        theirs: Vec<f64>,
    },
    /// Pieces of a run that is divided differently.
    #[error("blocks of space differ: {ours:?} and {theirs:?}")]
    Space {
        /// Blocks of the first sums.
        ours: [usize; 3],
        /// Blocks of the other sums.
        theirs: [usize; 3],
    },
}

impl Sums {
    /// No sums yet.
    pub fn new(layout: Layout) -> Self {
        Self { layout, blocks: Vec::new() }
    }

    /// Whether other sums are of the same quantities in the same bins on the same grid.
    ///
    /// # Errors
    /// [`MergeError`] for the first difference.
    pub fn matches(&self, other: &Self) -> Result<(), MergeError> {
        self.matches_but_for_grid(other)?;
        if !self.layout.same_grid(&other.layout) {
            let (ours, theirs) = (self.layout.spacing.clone(), other.layout.spacing.clone());
            return Err(MergeError::Grid { ours, theirs });
        }
        Ok(())
    }

    /// Whether other sums are of the same quantities in the same bins, on whichever grid.
    ///
    /// # Errors
    /// [`MergeError`] for the first difference.
    pub fn matches_but_for_grid(&self, other: &Self) -> Result<(), MergeError> {
        let (ours, theirs) = (&self.layout, &other.layout);
        if ours.dimension != theirs.dimension {
            let (ours, theirs) = (ours.dimension, theirs.dimension);
            return Err(MergeError::Dimension { ours, theirs });
        }
        if ours.densities != theirs.densities {
            let (ours, theirs) = (ours.densities, theirs.densities);
            return Err(MergeError::Densities { ours, theirs });
        }
        if ours.kernel != theirs.kernel {
            let (ours, theirs) = (ours.kernel.name(), theirs.kernel.name());
            return Err(MergeError::Kernel { ours, theirs });
        }
        if ours.widths != theirs.widths {
            let (ours, theirs) = (ours.widths.clone(), theirs.widths.clone());
            return Err(MergeError::Widths { ours, theirs });
        }
        if ours.bins != theirs.bins {
            let (ours, theirs) = (ours.bins.clone(), theirs.bins.clone());
            return Err(MergeError::Bins { ours, theirs });
        }
        if ours.block_duration != theirs.block_duration {
            let (ours, theirs) = (ours.block_duration, theirs.block_duration);
            return Err(MergeError::BlockDuration { ours, theirs });
        }
        Ok(())
    }

    /// [`Sums::matches`], and in the same blocks.
    fn continues(&self, other: &Self) -> Result<(), MergeError> {
        self.matches(other)?;
        let (ours, theirs) = (&self.layout, &other.layout);
        if ours.space != theirs.space {
            return Err(MergeError::Space { ours: ours.space, theirs: theirs.space });
        }
        Ok(())
    }

    /// Adds another piece of the same run, as after an interruption: the sums become those of the
    /// uninterrupted run, bit for bit if the pieces share no block. Different runs are not merged
    /// but handed to [`bin_table`] side by side.
    ///
    /// # Errors
    /// [`MergeError`] if the widths, bins or blocks differ.
    pub fn merge(&mut self, other: &Self) -> Result<(), MergeError> {
        self.continues(other)?;
        for theirs in &other.blocks {
            match self.blocks.binary_search_by_key(&theirs.place, |block| block.place) {
                Ok(found) => {
                    let ours = &mut self.blocks[found];
                    ours.instants += theirs.instants;
                    for (ours, theirs) in ours.widths.iter_mut().zip(&theirs.widths) {
                        ours.merge(theirs);
                    }
                }
                Err(gap) => self.blocks.insert(gap, theirs.clone()),
            }
        }
        Ok(())
    }

    /// Whether two sums are of the same samples: of one run, read twice.
    pub fn same_samples(&self, other: &Self) -> bool {
        let bits = |sums: &[f64]| sums.iter().map(|sum| sum.to_bits()).collect::<Vec<_>>();
        let seen = self
            .blocks
            .iter()
            .filter(|block| block.widths.iter().any(|visits| !visits.keys.is_empty()));
        let shared = seen.into_iter().find_map(|ours| {
            let at = other.blocks.binary_search_by_key(&ours.place, |block| block.place).ok()?;
            Some((ours, &other.blocks[at]))
        });
        // Two realisations do not agree in a whole block to the last bit.
        shared.is_some_and(|(ours, theirs)| {
            let mut pairs = ours.widths.iter().zip(&theirs.widths);
            pairs.all(|(ours, theirs)| bits(&ours.sums) == bits(&theirs.sums))
        })
    }

    /// Forgets all blocks that began before `time` \[s\].
    pub fn discard_before(&mut self, time: f64) {
        let first = (time / self.layout.block_duration - BLOCK_TOLERANCE).ceil();
        self.blocks.retain(|block| block.place as f64 >= first);
    }
}

/// Times this close to the next block, in block durations, belong to it: a time that is a sum of
/// steps lies a little beside the multiple of the duration that is meant.
const BLOCK_TOLERANCE: f64 = 1e-6;

/// Filter positions handled together: their terms stay in cache.
const CHUNK: usize = 4 * LANES;

/// Row of a bin that has not been visited in the current block.
const UNVISITED: u32 = u32::MAX;

/// How fields are sampled, beside the grid and the drag law.
#[derive(Clone, Debug)]
pub struct Sampling<const D: usize> {
    /// The powder's scales.
    pub scales: Scales,
    /// ρ_g \[kg/m³\].
    pub gas_density: f64,
    /// The bins.
    pub bins: Bins,
    /// The filter kernel.
    pub kernel: Kernel,
    /// Filter widths Δ_f \[m\].
    pub widths: Vec<f64>,
    /// Duration of a block of time \[s\]: at least a few sampling intervals, and short enough for
    /// dozens of blocks in a run; it need not exceed the correlation time.
    pub block_duration: f64,
    /// Blocks of space along each axis: 1, or a few where instants are fewer than eight.
    pub space: [usize; D],
    /// Along which axes the box repeats itself.
    pub periodic: [bool; D],
    /// Least distance between filter positions \[cells\].
    pub closest: usize,
    /// Whether to use the threads of the current pool.
    pub parallel: bool,
}

/// Filters fine fields, in flight, and adds what it finds to [`Sums`].
#[derive(Clone, Debug)]
pub struct Sampler<const D: usize, L> {
    filter: MomentFilter<D>,
    law: L,
    scales: Scales,
    parallel: bool,
    sums: Sums,
    /// For each width and key its place in the current block.
    rows: Vec<Vec<u32>>,
    /// For each width and position its block of space, times the number of bins; empty if space is
    /// not divided.
    places: Vec<Vec<u32>>,
}

impl<const D: usize, L: DragLaw<f64>> Sampler<D, L> {
    /// A sampler of fields on `grid`. `law` is the fine-grid drag law.
    ///
    /// # Errors
    /// [`FilterError`] if a width is not a whole number of cells or exceeds the box.
    ///
    /// # Panics
    /// If the block duration is not positive.
    pub fn new(grid: Grid<D>, law: L, sampling: Sampling<D>) -> Result<Self, FilterError> {
        let Sampling { scales, bins, widths, block_duration, space, .. } = sampling;
        assert!(block_duration > 0.0, "block duration {block_duration} s");
        let cells: Vec<[usize; D]> =
            widths.iter().map(|&width| width_in_cells(&grid, width)).collect::<Result<_, _>>()?;
        let Sampling { kernel, periodic, closest, parallel, .. } = sampling;
        let filter = MomentFilter::new(grid, periodic, kernel, &cells, closest, parallel)?;
        let layout = Layout {
            dimension: D,
            densities: [scales.density, sampling.gas_density],
            kernel,
            spacing: grid.spacing.to_vec(),
            widths,
            bins,
            block_duration,
            space: std::array::from_fn(|axis| space.get(axis).copied().unwrap_or(1)),
        };
        let keys = layout.bins.len() * layout.places();
        let places = |number: usize| {
            let positions = &filter.positions()[number];
            let place = |n: usize| {
                let first = positions.first_cell(n);
                let place = (0..D).rev().fold(0, |place, axis| {
                    let n = grid.cells[axis];
                    let middle = (first[axis] + cells[number][axis] / 2) % n;
                    place * space[axis] + middle * space[axis] / n
                });
                (place * layout.bins.len()) as u32
            };
            if layout.places() == 1 { vec![] } else { (0..positions.len()).map(place).collect() }
        };
        Ok(Self {
            places: (0..cells.len()).map(places).collect(),
            rows: vec![vec![UNVISITED; keys]; cells.len()],
            filter,
            law,
            scales,
            parallel,
            sums: Sums::new(layout),
        })
    }

    /// The sums so far.
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// The filtered solids fraction of the last sample by the filter of width number `width` whose middle is
    /// nearest to `place`, counted in cells from the middle of the first.
    pub fn filtered_fraction(&self, width: usize, place: [f64; D]) -> f64 {
        self.filter.moments(width).fraction(self.filter.positions()[width].nearest(place))
    }

    /// Goes on from the sums of an interrupted run, in place of its own, as if never interrupted.
    ///
    /// # Errors
    /// [`MergeError`] if the widths, bins or blocks differ.
    pub fn resume(&mut self, sums: Sums) -> Result<(), MergeError> {
        self.sums.continues(&sums)?;
        self.sums = sums;
        self.rows.iter_mut().for_each(|rows| rows.fill(UNVISITED));
        if let Some(block) = self.sums.blocks.last() {
            for (rows, visits) in self.rows.iter_mut().zip(&block.widths) {
                for (place, &key) in visits.keys.iter().enumerate() {
                    rows[key as usize] = place as u32;
                }
            }
        }
        Ok(())
    }

    /// The sums, at the end.
    pub fn into_sums(mut self) -> Sums {
        if let Some(block) = self.sums.blocks.last_mut() {
            block.sort();
        }
        self.sums
    }

    /// Adds the fields of one instant. Instants come in the order of time.
    ///
    /// # Panics
    /// If the fields are not on the sampler's grid.
    pub fn sample(&mut self, fields: &FineFields<D>) {
        let layout = &self.sums.layout;
        let place = (fields.time / layout.block_duration + BLOCK_TOLERANCE).max(0.0) as u64;
        if self.sums.blocks.last().is_none_or(|block| block.place != place) {
            if let Some(block) = self.sums.blocks.last_mut() {
                block.sort();
            }
            let widths = vec![Visits::default(); layout.widths.len()];
            self.sums.blocks.push(BlockSums { place, instants: 0, widths });
            self.rows.iter_mut().for_each(|rows| rows.fill(UNVISITED));
        }
        self.filter.filter(fields);
        let Some(block) = self.sums.blocks.last_mut() else { return };
        block.instants += 1;
        let spread = block.place.is_multiple_of(SPREAD_BLOCKS);
        let per_unit = layout.bins.per_unit(&self.scales);
        let mut widths: Vec<_> =
            block.widths.iter_mut().zip(&mut self.rows).zip(&self.places).enumerate().collect();
        let (filter, law) = (&self.filter, &self.law);
        let scratch = || vec![[Lanes::of(0.0); TERM_COUNT]; CHUNK / LANES];
        each_chunk(self.parallel, &mut widths, 1, scratch, |terms, _, of_width| {
            for (number, ((visits, rows), places)) in of_width {
                let columns = filter.moments(*number);
                for start in (0..columns.len()).step_by(CHUNK) {
                    let len = CHUNK.min(columns.len() - start);
                    let (mut fraction, mut speed) = ([0.0; CHUNK], [0.0; CHUNK]);
                    slip_speeds(&mut fraction, &mut speed, &columns, start);
                    let mut beta = [0.0; CHUNK];
                    law.betas(&mut beta, &fraction, &speed);
                    evaluate(terms, &columns, start, &beta, layout.densities());
                    let mut visited = [0; CHUNK];
                    for (n, visited) in visited[..len].iter_mut().enumerate() {
                        let terms = &terms[n / LANES];
                        let marker = |term: Term| terms[term as usize].0[n % LANES];
                        let place = places.get(start + n).copied().unwrap_or(0);
                        let key = place + layout.bins.bin(marker, &per_unit) as u32;
                        let row = &mut rows[key as usize];
                        if *row == UNVISITED {
                            *row = visits.keys.len() as u32;
                            visits.push(key, spread);
                        }
                        *visited = *row;
                    }
                    add_terms(&mut visits.sums, &visited[..len], terms, term_count(D));
                    if spread {
                        let width = layout.widths[*number];
                        let factors: [f64; QUANTITY_COUNT] = std::array::from_fn(|quantity| {
                            QUANTITIES[quantity].formula.factor(layout.densities(), width)
                        });
                        for n in (0..len).step_by(SPREAD_POSITIONS) {
                            let terms: [f64; TERM_COUNT] =
                                std::array::from_fn(|term| terms[n / LANES][term].0[n % LANES]);
                            let spread = &mut visits.spreads[visited[n] as usize * SPREAD..];
                            add_spread(&mut spread[..SPREAD], &terms, &factors);
                        }
                    }
                }
            }
        });
    }
}

simd! {
    /// φ̄ and |s| at the positions from `start` on.
    fn slip_speeds[const D: usize](
        fraction: &mut [f64; CHUNK],
        speed: &mut [f64; CHUNK],
        columns: &MomentColumns<'_, D>,
        start: usize,
    ) {
        let len = CHUNK.min(columns.len() - start);
        for n in (0..len).step_by(LANES) {
            let [phi, slip] = columns.slip_speed_at(start + n);
            phi.store(&mut fraction[n..]);
            slip.store(&mut speed[n..]);
        }
    }
}

simd! {
    /// The terms at the positions from `start` on, eight positions at a time.
    fn evaluate[const D: usize](
        out: &mut [[Lanes; TERM_COUNT]],
        columns: &MomentColumns<'_, D>,
        start: usize,
        beta: &[f64; CHUNK],
        densities: Densities,
    ) {
        let len = CHUNK.min(columns.len() - start);
        let mut moments = Moments::zeros();
        for n in (0..len).step_by(LANES) {
            columns.load(start + n, &mut moments);
            terms(&moments, Lanes::load(&beta[n..]), densities, &mut out[n / LANES]);
        }
    }
}

simd! {
    /// Adds the terms of each position, `count` of them, to the sums of its visit.
    fn add_terms[](
        sums: &mut [f64],
        visits: &[u32],
        terms: &[[Lanes; TERM_COUNT]],
        count: usize,
    ) {
        for (visits, terms) in visits.chunks(LANES).zip(terms) {
            let terms = &terms[..count];
            for (number, terms) in terms.as_chunks::<LANES>().0.iter().enumerate() {
                let positions = transpose(terms);
                for (&visit, terms) in visits.iter().zip(&positions) {
                    let sums = &mut sums[visit as usize * TERM_COUNT + number * LANES..][..LANES];
                    (Lanes::load(sums) + *terms).store(sums);
                }
            }
        }
    }
}

/// Adds a position to the spread of its visit.
fn add_spread(spread: &mut [f64], terms: &[f64], factors: &[f64; QUANTITY_COUNT]) {
    spread[0] += 1.0;
    let quantities = QUANTITIES.iter().zip(factors);
    for ((quantity, &factor), spread) in quantities.zip(spread[1..].chunks_exact_mut(3)) {
        let [numerator, denominator] = quantity.formula.pair(terms, [0.0; 2], factor);
        spread[0] += numerator * numerator;
        spread[1] += numerator * denominator;
        spread[2] += denominator * denominator;
    }
}

/// The bin table of several runs' sums, pooled: one row per quantity, filter width and visited bin,
/// in this order, bins of the first marker fastest.
///
/// Errors are those of [`Estimator`]: a bin of which too few blocks tell keeps its row, with its
/// value, an infinite error and no effective samples. `effective_samples` is the variance of a
/// single filter position's residual over the squared standard error: the number of independent
/// positions that would give the same error; of a slope, and where no spread was seen, the number
/// of independent blocks that its error is from. A quantity whose denominator vanishes throughout a
/// bin, such as a viscosity without shear, has no row.
///
/// # Errors
/// [`MergeError`] if the runs' widths, bins, grids or block durations differ.
pub fn bin_table(runs: &[Sums], scales: &Scales) -> Result<Vec<BinRow>, MergeError> {
    let runs: Vec<&Sums> = runs.iter().collect();
    bin_table_among(&runs, &runs, scales)
}

/// [`bin_table`] of `runs`, in bins that tables of others `among` all share: quantiles are those of
/// all of them, on whichever grid.
///
/// # Errors
/// [`MergeError`] if the runs' widths, bins, grids or block durations differ.
pub fn bin_table_among(
    runs: &[&Sums],
    among: &[&Sums],
    scales: &Scales,
) -> Result<Vec<BinRow>, MergeError> {
    Ok(tabulate(runs, among, scales)?.rows)
}

/// A bin table and what it is of.
#[derive(Default)]
pub(crate) struct Tabulated<'a> {
    pub(crate) rows: Vec<BinRow>,
    /// For each row the numbers of its quantity, its width and its bin in `visited`.
    pub(crate) of_rows: Vec<[usize; 3]>,
    /// For each row its correlation time \[blocks of time\].
    pub(crate) times: Vec<f64>,
    /// For each width the bins that were visited.
    pub(crate) visited: Vec<Vec<BinVisits<'a>>>,
}

/// [`bin_table_among`], and what it is of.
pub(crate) fn tabulate<'a>(
    runs: &[&'a Sums],
    among: &[&Sums],
    scales: &Scales,
) -> Result<Tabulated<'a>, MergeError> {
    let mut found = Tabulated::default();
    let Some(first) = runs.first() else { return Ok(found) };
    runs.iter().try_for_each(|run| first.matches(run))?;
    among.iter().try_for_each(|run| first.matches_but_for_grid(run))?;
    let layout = &first.layout;
    let widths = 0..layout.widths.len();
    found.visited = widths.map(|width| visits(runs, width, &groups(among, width))).collect();
    let mut estimator = Estimator::default();
    for (number, quantity) in QUANTITIES.iter().enumerate() {
        if quantity.only_3d && layout.dimension < 3 {
            continue;
        }
        for (place, (&width, bins)) in layout.widths.iter().zip(&found.visited).enumerate() {
            let factor = quantity.formula.factor(layout.densities(), width);
            for (bin, visits) in bins.iter().enumerate() {
                let mean = quantity.formula.mean(&visits.total);
                let pair = |sums: &[f64]| quantity.formula.pair(sums, mean, factor);
                let estimate = estimator.estimate(&visits.blocks(runs, pair));
                if !estimate.ratio.is_finite() {
                    continue;
                }
                let spread = visits.spread(number, estimate.ratio);
                let spread = (spread, pair(&visits.total)[1]);
                found.rows.push(row(quantity, width, visits, &estimate, spread, layout, scales));
                found.of_rows.push([number, place, bin]);
                found.times.push(estimate.correlation_time);
            }
        }
    }
    Ok(found)
}

/// What was seen of a bin in one block.
struct Seen<'a> {
    run: usize,
    block: usize,
    /// The block of space.
    place: usize,
    sums: &'a [f64],
    spread: &'a [f64],
}

/// What all runs saw of one bin, or of some put together, at one width.
pub(crate) struct BinVisits<'a> {
    /// Its edges along each axis.
    edges: Vec<[f64; 2]>,
    /// In the order of runs, blocks and blocks of space.
    seen: Vec<Seen<'a>>,
    /// Sums of all of them.
    total: Vec<f64>,
}

impl BinVisits<'_> {
    /// Numerators and denominators of every block of the runs that visited the bin.
    fn blocks(&self, runs: &[&Sums], pair: impl Fn(&[f64]) -> [f64; 2]) -> Vec<Run> {
        let of_run = |seen: &[Seen]| {
            let run = &runs[seen[0].run];
            let places = run.layout.places();
            // A block that did not visit the bin saw nothing there.
            let mut sums = vec![[0.0; 2]; run.blocks.len() * places];
            for seen in seen {
                let [numerator, denominator] = pair(seen.sums);
                let sums = &mut sums[seen.block * places + seen.place];
                *sums = [sums[0] + numerator, sums[1] + denominator];
            }
            Run { space: run.layout.space, sums }
        };
        self.seen.chunk_by(|a, b| a.run == b.run).map(of_run).collect()
    }

    /// The sums over all blocks, each as often as `counts` says of its run.
    pub(crate) fn resampled(&self, runs: &[&Sums], counts: &[Vec<f64>]) -> [f64; TERM_COUNT] {
        let mut total = [0.0; TERM_COUNT];
        for seen in &self.seen {
            let places = runs[seen.run].layout.places();
            let count = counts[seen.run][seen.block * places + seen.place];
            if count > 0.0 {
                total.iter_mut().zip(seen.sums).for_each(|(total, sum)| *total += count * sum);
            }
        }
        total
    }

    /// Mean of (num - R den)² over the positions that were looked at; none if none was.
    fn spread(&self, quantity: usize, ratio: f64) -> Option<f64> {
        let (mut positions, mut squares) = (0.0, 0.0);
        for spread in self.seen.iter().map(|seen| seen.spread).filter(|spread| !spread.is_empty()) {
            let [numerator, product, denominator] =
                std::array::from_fn(|part| spread[1 + 3 * quantity + part]);
            positions += spread[0];
            squares += numerator - 2.0 * ratio * product + ratio * ratio * denominator;
        }
        // Round-off of the difference may leave a trace below zero.
        (positions > 0.0).then(|| squares.max(0.0) / positions)
    }
}

/// For each axis and bin the first and the last of those that it is put together with at filter width
/// number `width`.
fn groups(runs: &[&Sums], width: usize) -> Vec<Vec<[usize; 2]>> {
    let Some(first) = runs.first() else { return vec![] };
    let bins = &first.layout.bins;
    let mut positions = vec![0.0; bins.len()];
    for visits in runs.iter().flat_map(|run| &run.blocks).map(|block| &block.widths[width]) {
        for (visit, &key) in visits.keys.iter().enumerate() {
            positions[key as usize % bins.len()] += visits.of(visit)[Term::Positions as usize];
        }
    }
    let along = |(number, axis): (usize, &Axis)| {
        let mut of_axis = vec![0.0; axis.len()];
        for (bin, positions) in positions.iter().enumerate() {
            of_axis[bins.places(bin)[number]] += positions;
        }
        axis.groups(&of_axis)
    };
    bins.axes.iter().enumerate().map(along).collect()
}

/// The bins that were visited at filter width number `width`, put together as the `groups` of each
/// axis say, in their order.
fn visits<'a>(runs: &[&'a Sums], width: usize, groups: &[Vec<[usize; 2]>]) -> Vec<BinVisits<'a>> {
    let Some(first) = runs.first() else { return vec![] };
    let bins = &first.layout.bins;
    let mut found: BTreeMap<usize, BinVisits> = BTreeMap::new();
    for (number, run) in runs.iter().enumerate() {
        for (block, of_block) in run.blocks.iter().enumerate() {
            let visits = &of_block.widths[width];
            for (visit, &key) in visits.keys.iter().enumerate() {
                let (bin, place) = (key as usize % bins.len(), key as usize / bins.len());
                let spans: Vec<[usize; 2]> =
                    bins.places(bin).iter().zip(groups).map(|(&at, group)| group[at]).collect();
                let axes = bins.axes.iter().zip(&spans);
                let bin =
                    axes.clone().rev().fold(0, |bin, (axis, span)| bin * axis.len() + span[0]);
                let edges = axes.map(|(axis, span)| [axis.edges[span[0]], axis.edges[span[1] + 1]]);
                let of_bin = found.entry(bin).or_insert_with(|| BinVisits {
                    edges: edges.collect(),
                    seen: vec![],
                    total: vec![0.0; TERM_COUNT],
                });
                let (sums, spread) = (visits.of(visit), visits.spread(visit));
                of_bin.seen.push(Seen { run: number, block, place, sums, spread });
                of_bin.total.iter_mut().zip(sums).for_each(|(total, sum)| *total += sum);
            }
        }
    }
    found.into_values().collect()
}

/// The row of a quantity in a bin that was visited.
fn row(
    quantity: &Quantity,
    width: f64,
    visits: &BinVisits,
    found: &Estimate,
    (spread, denominator): (Option<f64>, f64),
    layout: &Layout,
    scales: &Scales,
) -> BinRow {
    let sum = |term: Term| visits.total[term as usize];
    let positions = sum(Term::Positions);
    let effective_samples = match spread {
        _ if found.standard_error.is_infinite() => 0.0,
        // No block deviates at all: nothing says that the positions are correlated.
        _ if found.standard_error == 0.0 => positions,
        Some(spread) if !matches!(quantity.formula, crate::filtered::Formula::Slope { .. }) => {
            spread * (positions / (denominator * found.standard_error)).powi(2)
        }
        _ => found.freedom + 1.0,
    };
    let value = quantity.map.value(found.ratio);
    let [low_95, high_95] = quantity.map.interval(found.interval_95);
    let edges = &visits.edges;
    let of = |marker: Marker| layout.bins.axes.iter().position(|axis| axis.marker == marker);
    let edges_of =
        |marker: Marker| of(marker).map_or([f64::NEG_INFINITY, f64::INFINITY], |axis| edges[axis]);
    let mean = |marker: Marker| sum(marker.term()) / positions / marker.kind().scale(scales);
    let [solids_fraction_low, solids_fraction_high] = edges_of(Marker::SolidsFraction);
    let [slip_low, slip_high] = edges_of(Marker::Slip);
    let [slip_speed_low, slip_speed_high] = edges_of(Marker::SlipSpeed);
    let [pressure_gradient_low, pressure_gradient_high] = edges_of(Marker::PressureGradient);
    let [shear_rate_low, shear_rate_high] = edges_of(Marker::ShearRate);
    let [fraction_gradient_low, fraction_gradient_high] = edges_of(Marker::FractionGradient);
    let [variance_low, variance_high] = edges_of(Marker::Variance);
    BinRow {
        quantity: quantity.name.to_owned(),
        unit: quantity.kind.unit().to_owned(),
        filter_width: width,
        filter_width_l_i: width / scales.length_i(),
        filter_width_l_ii: width / scales.length_ii(),
        solids_fraction: sum(Term::SolidsFraction) / positions,
        solids_fraction_low,
        solids_fraction_high,
        slip: mean(Marker::Slip),
        slip_low,
        slip_high,
        value,
        standard_error: found.standard_error,
        low_95,
        high_95,
        value_scaled: value / quantity.kind.scale(scales),
        samples: positions as u64,
        effective_samples,
        slip_speed: mean(Marker::SlipSpeed),
        slip_speed_low,
        slip_speed_high,
        pressure_gradient: mean(Marker::PressureGradient),
        pressure_gradient_low,
        pressure_gradient_high,
        shear_rate: mean(Marker::ShearRate),
        shear_rate_low,
        shear_rate_high,
        fraction_gradient: mean(Marker::FractionGradient),
        fraction_gradient_low,
        fraction_gradient_high,
        variance: mean(Marker::Variance),
        variance_low,
        variance_high,
        extrapolated: None,
        extrapolated_standard_error: None,
        grid_error: None,
        grid_standard_error: None,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::laws::drag::WenYu;
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::moments::tests::random_fields;

    pub(crate) fn scales() -> Scales {
        Scales::new(&POWDER, &GAS, 9.81)
    }

    fn sampling<const D: usize>(widths: &[f64], slip: Option<f64>) -> Sampling<D> {
        Sampling {
            scales: scales(),
            gas_density: GAS.density,
            bins: Bins::new(0.05, POWDER.max_packing, slip),
            kernel: Kernel::Box,
            widths: widths.to_vec(),
            block_duration: 0.01,
            space: [1; D],
            periodic: [true; D],
            closest: 2,
            parallel: false,
        }
    }

    fn sampler<const D: usize>(
        grid: Grid<D>,
        widths: &[f64],
        slip: Option<f64>,
    ) -> Sampler<D, WenYu<f64>> {
        Sampler::new(grid, WenYu::new(&GAS, &POWDER), sampling(widths, slip)).unwrap()
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

    /// Sums of random fields in a flat box whose gas rises faster by `lift` \[m/s\].
    pub(crate) fn sampled_runs(lift: f64, instants: std::ops::Range<u64>) -> Sums {
        sampled_on([16, 16], lift, instants)
    }

    /// The same on a grid of so many cells.
    pub(crate) fn sampled_on(cells: [usize; 2], lift: f64, instants: std::ops::Range<u64>) -> Sums {
        let grid = Grid::new([0.032, 0.032], cells);
        let mut sampler = sampler(grid, &[0.004, 0.008], None);
        for instant in instants {
            let mut fields = random_fields(grid, instant);
            fields.gas_velocity[1].iter_mut().for_each(|u| *u += lift);
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
        // Independent cells, at independent instants, are worth what they are.
        let share = |width: f64| {
            let rows = rows_of(&rows, "granular_temperature", width);
            let often = rows.iter().filter(|row| row.samples > 5_000);
            let shares: Vec<f64> =
                often.map(|row| row.effective_samples / row.samples as f64).collect();
            assert!(!shares.is_empty());
            shares.iter().sum::<f64>() / shares.len() as f64
        };
        let (single, overlapping) = (share(0.002), share(0.008));
        assert!((0.4..1.2).contains(&single), "{single}");
        // Filters of 4 x 4 cells at every second cell: 4 positions share a filter's volume.
        assert!((0.15 * single..0.6 * single).contains(&overlapping), "{overlapping} {single}");
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
        let mut duration = one.clone();
        duration.layout.block_duration = 0.02;
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
    fn quantiles_hold_about_equally_many_and_the_sums_of_their_bins() {
        let grid = Grid::new([0.032, 0.032], [16, 16]);
        let axes = |markers: &[Axis]| -> Vec<BinRow> {
            let mut sampling = sampling::<2>(&[0.004], None);
            sampling.bins = Bins { axes: markers.to_vec() };
            let mut sampler = Sampler::new(grid, WenYu::new(&GAS, &POWDER), sampling).unwrap();
            for instant in 0..40 {
                let mut fields = random_fields(grid, instant);
                fields.time = 0.005 * instant as f64;
                sampler.sample(&fields);
            }
            bin_table(&[sampler.into_sums()], &scales()).unwrap()
        };
        let all = Axis::new(Marker::SolidsFraction, vec![0.0, 0.65]);
        let whole = axes(std::slice::from_ref(&all));
        for marker in [Marker::ShearRate, Marker::Slip, Marker::Variance, Marker::FractionGradient]
        {
            let rows = axes(&[all.clone(), Axis::in_quantiles(marker, 4, 0.65)]);
            let slips = rows_of(&rows, "slip", 0.004);
            assert_eq!(slips.len(), 4, "{marker:?}");
            let total: u64 = slips.iter().map(|row| row.samples).sum();
            assert_eq!(total, rows_of(&whole, "slip", 0.004)[0].samples);
            for row in &slips {
                let share = row.samples as f64 / total as f64;
                assert!((0.12..0.38).contains(&share), "{marker:?} {share}");
                assert!(row.standard_error.is_finite());
            }
            // The mean of the bins' means is the mean, and bins are next to each other.
            let sum: f64 = slips.iter().map(|row| row.value * row.samples as f64).sum();
            let mean = rows_of(&whole, "slip", 0.004)[0].value;
            assert!((sum / total as f64 - mean).abs() < 1e-12);
            let edges = |row: &BinRow| match marker {
                Marker::ShearRate => [row.shear_rate_low, row.shear_rate, row.shear_rate_high],
                Marker::Slip => [row.slip_low, row.slip, row.slip_high],
                Marker::Variance => [row.variance_low, row.variance, row.variance_high],
                _ => [row.fraction_gradient_low, row.fraction_gradient, row.fraction_gradient_high],
            };
            for pair in slips.windows(2) {
                assert_eq!(edges(pair[0])[2], edges(pair[1])[0]);
            }
            for row in slips {
                let [low, mean, high] = edges(row);
                assert!(low < mean && mean < high, "{marker:?} {low} {mean} {high}");
            }
        }
        // Three at a time.
        let quantiles = |marker| Axis::in_quantiles(marker, 3, 0.65);
        let rows = axes(&[
            quantiles(Marker::SolidsFraction),
            quantiles(Marker::SlipSpeed),
            quantiles(Marker::PressureGradient),
        ]);
        let slips = rows_of(&rows, "slip_speed", 0.004);
        assert!((20..=27).contains(&slips.len()), "{}", slips.len());
    }

    #[test]
    fn bins_hold_what_falls_into_them() {
        let bins = Bins::new(0.05, 0.65, Some(0.5));
        // 16 slip bins and two open ones.
        assert_eq!((bins.axes[0].len(), bins.len()), (13, 13 * 18));
        let (mut terms, per_unit) = ([0.0; TERM_COUNT], [1.0, 2.0]);
        for fraction in [-1e-18f64, 0.0, 0.12, 0.649, 0.7] {
            for slip in [-9.0, -2.0, -0.3, 0.0, 0.7, 5.99, 6.5] {
                terms[Term::SolidsFraction as usize] = fraction;
                terms[Term::Slip as usize] = 0.5 * slip;
                let edges = bins.edges(bins.bin(|term| terms[term as usize], &per_unit));
                let [low, high] = edges[1];
                assert!(low <= slip && slip < high, "{low} {slip} {high}");
                let [low, high] = edges[0];
                let inside = fraction.clamp(0.0, 0.65 - 1e-12);
                assert!(low <= inside && inside < high, "{low} {fraction} {high}");
            }
        }
        assert_eq!(Bins::new(0.1, 0.65, None).len(), 7);
    }
}
