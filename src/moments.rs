//! [`MomentFilter`]: from fine fields to filtered [`Moments`] at the filter positions of each width.
//!
//! What is filtered are products of the fields. They are made row by row and summed at once over the
//! largest blocks of cells that tile the boxes of every width; from there on all work is on the
//! coarser grid of blocks. Blocks of a wider filter are sums of blocks of a narrower one, and a box
//! is two or three blocks along each axis, at positions half its width apart. The cost of a width
//! therefore falls with the width, and all widths together cost little more than the narrowest.
//! Nothing is ever subtracted: what is positive stays positive.

use crate::filter::{FilterError, fits};
use crate::filtered::{Moments, favre};
use crate::fine::{FineFields, symmetric_components, symmetric_index};
use crate::grid::Grid;
use crate::lanes::{LANES, Lanes, Number};
use crate::rows::{each_chunk, simd};
use crate::spectral::{Kernel, SpectralFilter};

/// Columns: the scalars of [`Moments`], its vectors, its symmetric tensors, its gradients.
const SCALARS: usize = 10;

#[inline(always)]
const fn vector(number: usize, dimension: usize) -> usize {
    SCALARS + number * dimension
}

#[inline(always)]
const fn symmetric(number: usize, dimension: usize) -> usize {
    vector(7, dimension) + number * symmetric_components(dimension)
}

#[inline(always)]
const fn gradient(number: usize, dimension: usize) -> usize {
    symmetric(3, dimension) + number * dimension * dimension
}

/// Number of filtered moments in `dimension` dimensions: 41 in two, 69 in three, where particles are counted.
pub const fn moment_count(dimension: usize) -> usize {
    gradient(2, dimension) + if dimension == 3 { 2 } else { 0 }
}

/// `fill!(moments, D, |column| value)`: sets the moments to the values of the columns. A macro, because
/// closures are not inlined, and a kernel that calls is not vectorised; in place, because what is
/// built is copied.
macro_rules! fill {
    ($moments:ident, $d:expr, |$column:ident| $value:expr) => {{
        macro_rules! set {
            ($place:expr, $at:expr) => {{
                let $column = $at;
                $place = $value;
            }};
        }
        set!($moments.solids_fraction, 0);
        set!($moments.solids_fraction_squared, 1);
        set!($moments.drag_coefficient, 2);
        set!($moments.kinetic_pressure, 3);
        set!($moments.fraction_temperature, 4);
        set!($moments.stress_power, 5);
        set!($moments.drag_on_solids, 6);
        set!($moments.drag_on_gas, 7);
        set!($moments.pressure_on_solids, 8);
        set!($moments.pressure_on_gas, 9);
        for i in 0..$d {
            set!($moments.solids_flux[i], vector(0, $d) + i);
            set!($moments.gas_flux[i], vector(1, $d) + i);
            set!($moments.seen_gas_flux[i], vector(2, $d) + i);
            set!($moments.drag[i], vector(3, $d) + i);
            set!($moments.pressure_gradient[i], vector(4, $d) + i);
            set!($moments.fraction_pressure_gradient[i], vector(5, $d) + i);
            set!($moments.fraction_gradient[i], vector(6, $d) + i);
            for j in 0..$d {
                let pair = symmetric_index(i, j);
                set!($moments.solids_flux_velocity[i][j], symmetric(0, $d) + pair);
                set!($moments.gas_flux_velocity[i][j], symmetric(1, $d) + pair);
                set!($moments.kinetic_stress[i][j], symmetric(2, $d) + pair);
                set!($moments.solids_flux_gradient[i][j], gradient(0, $d) + i * $d + j);
                set!($moments.gas_flux_gradient[i][j], gradient(1, $d) + i * $d + j);
            }
        }
        if $d == 3 {
            set!($moments.number_density, gradient(2, $d));
            set!($moments.contact_density, gradient(2, $d) + 1);
        }
    }};
}

/// Filtered moments of one width at its filter positions.
#[derive(Clone, Copy, Debug)]
pub struct MomentColumns<'a, const D: usize> {
    columns: &'a [f64],
    /// Distance between the same position of two columns.
    stride: usize,
    /// First position of this width in a column.
    first: usize,
    positions: usize,
}

impl<const D: usize> MomentColumns<'_, D> {
    /// Number of filter positions.
    pub fn len(&self) -> usize {
        self.positions
    }

    /// Whether there is no filter position.
    pub fn is_empty(&self) -> bool {
        self.positions == 0
    }

    /// The filtered solids fraction at filter position `n`.
    pub fn fraction(&self, n: usize) -> f64 {
        self.columns[self.first + n]
    }

    /// The moments at filter position `n`.
    pub fn at(&self, n: usize) -> Moments<f64, D> {
        let mut moments = Moments::zeros();
        fill!(moments, D, |column| self.columns[column * self.stride + self.first + n]);
        moments
    }

    /// Sets `moments` to those at the [`LANES`] positions from `n` on, a multiple of that number; zeros
    /// beyond the last.
    #[inline(always)]
    pub fn load(&self, n: usize, moments: &mut Moments<Lanes, D>) {
        fill!(moments, D, |column| {
            Lanes::load(&self.columns[column * self.stride + self.first + n..])
        });
    }

    /// Filtered solids fraction and slip speed \[m/s\] at the positions that [`load`](Self::load) takes.
    #[inline(always)]
    pub fn slip_speed_at(&self, n: usize) -> [Lanes; 2] {
        macro_rules! load {
            ($column:expr) => {
                Lanes::load(&self.columns[$column * self.stride + self.first + n..])
            };
        }
        let fraction = load!(0);
        let mut squared = Lanes::of(0.0);
        for axis in 0..D {
            let solids = favre(load!(vector(0, D) + axis), fraction);
            let gas = favre(load!(vector(1, D) + axis), Lanes::of(1.0) - fraction);
            squared = squared + (gas - solids) * (gas - solids);
        }
        [fraction, squared.sqrt()]
    }
}

/// The filter positions of one width, and the blocks that its box is made of.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Positions<const D: usize> {
    /// Cells of a block along each axis.
    block: [usize; D],
    /// Blocks in a box along each axis.
    count: [usize; D],
    /// Blocks from one position to the next along each axis.
    step: [usize; D],
    /// Positions along each axis.
    shape: [usize; D],
}

/// Largest divisor of `number` up to `bound`.
fn divisor(number: usize, bound: usize) -> usize {
    (1..=bound.min(number).max(1)).rev().find(|d| number.is_multiple_of(*d)).unwrap_or(1)
}

fn greatest_common_divisor(a: usize, b: usize) -> usize {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

impl<const D: usize> Positions<D> {
    /// Positions of filters of `width` cells in a box of `cells`: about half a width apart, because
    /// closer ones share most of their cells and tell little more, and no closer than `closest` cells,
    /// because narrow filters are many and the next instant tells more than the next cell. Filters of
    /// one cell are at every cell.
    pub fn new(cells: [usize; D], periodic: [bool; D], width: [usize; D], closest: usize) -> Self {
        let mut positions = Self { block: [1; D], count: [1; D], step: [1; D], shape: [1; D] };
        for axis in 0..D {
            let (n, w) = (cells[axis], width[axis]);
            let spacing = if w > 1 { (w / 2).max(closest) } else { 1 };
            let tiled = if periodic[axis] { greatest_common_divisor(w, n) } else { w };
            let block = divisor(tiled, spacing);
            let (blocks, count) = (n / block, w / block);
            positions.block[axis] = block;
            positions.count[axis] = count;
            if periodic[axis] {
                let step = divisor(blocks, spacing / block);
                (positions.step[axis], positions.shape[axis]) = (step, blocks / step);
            } else {
                let step = (spacing / block).max(1);
                (positions.step[axis], positions.shape[axis]) = (step, (blocks - count) / step + 1);
            }
        }
        positions
    }

    /// The same positions, of single cells.
    fn without_blocks(&mut self) {
        for axis in 0..D {
            self.step[axis] *= self.block[axis];
        }
        (self.block, self.count) = ([1; D], [1; D]);
    }

    /// Number of positions.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Positions along each axis.
    pub fn shape(&self) -> [usize; D] {
        self.shape
    }

    /// Distance between positions along each axis \[cells\].
    pub fn step(&self) -> [usize; D] {
        std::array::from_fn(|axis| self.step[axis] * self.block[axis])
    }

    /// The position whose box has its middle nearest to `place`, counted in cells from the middle of the
    /// first cell, in a box that repeats itself; of another kernel the position itself.
    pub fn nearest(&self, place: [f64; D]) -> usize {
        (0..D).rev().fold(0, |n, axis| {
            let middle = 0.5 * (self.block[axis] * self.count[axis] - 1) as f64;
            let step = (self.step[axis] * self.block[axis]) as f64;
            let along = ((place[axis] - middle) / step).round() as i64;
            n * self.shape[axis] + along.rem_euclid(self.shape[axis] as i64) as usize
        })
    }

    /// Place of the first cell of the box at position `n` in a field of `cells`.
    fn cell(&self, n: usize, cells: [usize; D]) -> usize {
        let first = self.first_cell(n);
        (0..D).rev().fold(0, |place, axis| place * cells[axis] + first[axis])
    }

    /// First cell of the box at position `n`, along each axis; of another kernel the cell itself.
    pub fn first_cell(&self, mut n: usize) -> [usize; D] {
        std::array::from_fn(|axis| {
            let place = n % self.shape[axis];
            n /= self.shape[axis];
            place * self.step[axis] * self.block[axis]
        })
    }
}

/// Sums over blocks of one size, and the smaller blocks that they are made of.
#[derive(Clone, Debug)]
struct Level<const D: usize> {
    /// Cells of a block.
    block: [usize; D],
    /// Blocks along each axis.
    blocks: [usize; D],
    /// Place of the level that it is made of; none for the first, made of cells.
    parent: Option<usize>,
}

/// Filters the moments of fine fields, at all widths.
#[derive(Clone, Debug)]
pub struct MomentFilter<const D: usize> {
    grid: Grid<D>,
    periodic: [bool; D],
    parallel: bool,
    levels: Vec<Level<D>>,
    positions: Vec<Positions<D>>,
    /// Place of each width's level.
    level_of: Vec<usize>,
    /// First position of each width in a column.
    first: Vec<usize>,
    /// Positions of all widths, those of each filled up to whole [`Lanes`].
    stride: usize,
    /// What filters instead of sums over blocks, for another kernel than the box.
    spectral: Option<SpectralFilter<D>>,
    /// Sums over the smallest blocks: row of blocks by row, all moments of a row together.
    base: Vec<f64>,
    /// Filtered moments: moment by moment, all widths of a moment together.
    columns: Vec<f64>,
}

impl<const D: usize> MomentFilter<D> {
    /// Filters of `widths` (cells along each axis) with `kernel` on `grid`, which repeats itself along the
    /// `periodic` axes, at positions no closer than `closest` cells; on several threads of the current
    /// pool if `parallel`.
    ///
    /// # Errors
    /// [`FilterError::OutOfBox`] if a width is zero or exceeds the box, [`FilterError::Walls`] for a
    /// kernel other than the box in a box that is not periodic along every axis.
    pub fn new(
        grid: Grid<D>,
        periodic: [bool; D],
        kernel: Kernel,
        widths: &[[usize; D]],
        closest: usize,
        parallel: bool,
    ) -> Result<Self, FilterError> {
        for width in widths {
            fits(&grid.cells, width)?;
        }
        let wall = periodic.iter().position(|periodic| !periodic);
        if let (true, Some(axis)) = (kernel != Kernel::Box, wall) {
            return Err(FilterError::Walls { kernel: kernel.name(), axis });
        }
        let mut positions: Vec<Positions<D>> =
            widths.iter().map(|&w| Positions::new(grid.cells, periodic, w, closest)).collect();
        let spectral = (kernel != Kernel::Box).then(|| {
            positions.iter_mut().for_each(Positions::without_blocks);
            let widths: Vec<[f64; D]> = widths.iter().map(|w| w.map(|w| w as f64)).collect();
            SpectralFilter::new(kernel, grid.cells, &widths)
        });
        let smallest: [usize; D] = std::array::from_fn(|axis| {
            positions.iter().fold(0, |a, p| greatest_common_divisor(p.block[axis], a)).max(1)
        });
        let mut blocks: Vec<[usize; D]> = positions.iter().map(|p| p.block).collect();
        blocks.push(smallest);
        blocks.sort_by_key(|block| (block.iter().product::<usize>(), *block));
        blocks.dedup();
        let mut levels: Vec<Level<D>> = Vec::with_capacity(blocks.len());
        for block in blocks {
            let divides =
                |level: &Level<D>| (0..D).all(|axis| block[axis].is_multiple_of(level.block[axis]));
            let parent = levels.iter().rposition(divides);
            let blocks = std::array::from_fn(|axis| grid.cells[axis] / block[axis]);
            levels.push(Level { block, blocks, parent });
        }
        let level_of = positions
            .iter()
            .map(|p| levels.iter().position(|level| level.block == p.block).unwrap_or(0))
            .collect();
        let mut stride = 0;
        let first = positions
            .iter()
            .map(|positions| {
                let first = stride;
                stride += positions.len().next_multiple_of(LANES);
                first
            })
            .collect();
        let base = moment_count(D) * levels[0].blocks.iter().product::<usize>();
        Ok(Self {
            grid,
            periodic,
            parallel,
            levels,
            positions,
            level_of,
            first,
            stride,
            spectral,
            base: vec![0.0; base],
            columns: vec![0.0; moment_count(D) * stride],
        })
    }

    /// The filter positions of each width.
    pub fn positions(&self) -> &[Positions<D>] {
        &self.positions
    }

    /// The filtered moments of width number `width` in the last fields.
    pub fn moments(&self, width: usize) -> MomentColumns<'_, D> {
        MomentColumns {
            columns: &self.columns,
            stride: self.stride,
            first: self.first[width],
            positions: self.positions[width].len(),
        }
    }

    /// Filters `fields`.
    ///
    /// # Panics
    /// If the fields are not on the grid of the filter, or not periodic along the same axes.
    pub fn filter(&mut self, fields: &FineFields<D>) {
        assert_eq!(fields.grid, self.grid, "fields on another grid than the filter's");
        assert_eq!(fields.periodic, self.periodic, "fields that are periodic along other axes");
        let Level { block, blocks, .. } = self.levels[0];
        let row = moment_count(D) * blocks[0];
        each_chunk(
            self.parallel,
            &mut self.base,
            row,
            || RowScratch::new(&self.grid, block),
            |scratch, place, sums| sum_products(fields, block, blocks, place, scratch, sums),
        );
        let (base, levels, spectral) = (&self.base, &self.levels, &self.spectral);
        let (positions, level_of, first) = (&self.positions, &self.level_of, &self.first);
        each_chunk(
            self.parallel,
            &mut self.columns,
            self.stride.max(1),
            || (LevelScratch::new(levels), spectral.as_ref().map(SpectralFilter::scratch)),
            |(scratch, transform), moment, column| {
                scratch.fill(levels, base, moment);
                if let (Some(filter), Some(transform)) = (spectral, transform) {
                    filter.filter(&scratch.levels[0], transform, |width, field| {
                        let column = &mut column[first[width]..][..positions[width].len()];
                        for (n, value) in column.iter_mut().enumerate() {
                            *value = field[positions[width].cell(n, blocks)];
                        }
                    });
                    return;
                }
                for ((positions, &level), &first) in positions.iter().zip(level_of).zip(first) {
                    let column = &mut column[first..][..positions.len()];
                    let blocks = levels[level].blocks;
                    scratch.gather(level, blocks, positions, column);
                }
            },
        );
    }
}

/// Memory for the sums of one moment over the blocks of each level.
struct LevelScratch {
    levels: Vec<Vec<f64>>,
    spare: [Vec<f64>; 2],
}

impl LevelScratch {
    fn new<const D: usize>(levels: &[Level<D>]) -> Self {
        let sizes = levels.iter().map(|level| level.blocks.iter().product());
        Self { levels: sizes.map(|size| vec![0.0; size]).collect(), spare: [vec![], vec![]] }
    }

    /// The sums of `moment` at all levels, from the first.
    fn fill<const D: usize>(&mut self, levels: &[Level<D>], base: &[f64], moment: usize) {
        let width = levels[0].blocks[0];
        let rows = base.chunks_exact(moment_count(D) * width);
        for (row, out) in rows.zip(self.levels[0].chunks_exact_mut(width)) {
            out.copy_from_slice(&row[moment * width..][..width]);
        }
        for (place, level) in levels.iter().enumerate() {
            let Some(parent) = level.parent else { continue };
            let (below, above) = self.levels.split_at_mut(place);
            let from = &levels[parent];
            let factor = std::array::from_fn(|axis| level.block[axis] / from.block[axis]);
            let steps = Steps { count: factor, step: factor, shape: level.blocks };
            sum_blocks(from.blocks, &below[parent], &steps, 1.0, &mut self.spare, &mut above[0]);
        }
    }

    /// The means over the boxes at `positions`, from blocks of their level.
    fn gather<const D: usize>(
        &mut self,
        level: usize,
        blocks: [usize; D],
        positions: &Positions<D>,
        column: &mut [f64],
    ) {
        let Positions { block, count, step, shape } = *positions;
        let steps = Steps { count, step, shape };
        let cells: usize = (0..D).map(|axis| block[axis] * count[axis]).product();
        let mean = 1.0 / cells as f64;
        sum_blocks(blocks, &self.levels[level], &steps, mean, &mut self.spare, column);
    }
}

/// Which sums of neighbours: `count` of them, beginning `step` apart, at `shape` places, along each
/// axis.
struct Steps<const D: usize> {
    count: [usize; D],
    step: [usize; D],
    shape: [usize; D],
}

/// Sums of neighbours, times `factor`, on a grid of `cells` that closes upon itself, axis by axis, the
/// last first: what is left to do shrinks, and on long rows.
fn sum_blocks<const D: usize>(
    cells: [usize; D],
    source: &[f64],
    steps: &Steps<D>,
    factor: f64,
    spare: &mut [Vec<f64>; 2],
    out: &mut [f64],
) {
    let [from, to] = spare;
    let mut shape = cells;
    let needed: Vec<usize> =
        (0..D).rev().filter(|&a| steps.count[a] > 1 || steps.shape[a] < cells[a]).collect();
    let Some((&last, others)) = needed.split_last() else {
        out.iter_mut().zip(source).for_each(|(out, source)| *out = factor * source);
        return;
    };
    let mut source = source;
    for &axis in others {
        let run = Run::new(shape, axis, steps);
        shape[axis] = steps.shape[axis];
        to.resize(shape.iter().product(), 0.0);
        sum_along(run, source, 1.0, to);
        std::mem::swap(from, to);
        source = from;
    }
    sum_along(Run::new(shape, last, steps), source, factor, out);
}

/// One axis of a grid: `outer` times `n` layers of `inner` numbers, and what is summed of them.
#[derive(Clone, Copy)]
struct Run {
    inner: usize,
    n: usize,
    count: usize,
    step: usize,
    places: usize,
}

impl Run {
    fn new<const D: usize>(shape: [usize; D], axis: usize, steps: &Steps<D>) -> Self {
        Self {
            inner: shape[..axis].iter().product(),
            n: shape[axis],
            count: steps.count[axis],
            step: steps.step[axis],
            places: steps.shape[axis],
        }
    }
}

/// Sums of more neighbours than this are made of sums of half as many.
const DIRECT: usize = 3;

/// out[j] = factor Σ source[(j step + t) mod n], t < count, for layers along one axis.
fn sum_along(run: Run, source: &[f64], factor: f64, out: &mut [f64]) {
    let Run { inner, n, count, step, places } = run;
    if inner == 1 && count == step && count <= DIRECT && n == count * places {
        sum_neighbours(count, source, factor, out);
    } else if count <= DIRECT {
        sum_layers(run, [0, 1, 2], source, source, factor, out);
    } else {
        let half = Run { count: count / 2, step: 1, places: n, ..run };
        let mut halves = vec![0.0; source.len()];
        sum_along(half, source, 1.0, &mut halves);
        // Two halves, and of an odd number one more.
        let run = Run { count: 2 + count % 2, ..run };
        sum_layers(run, [0, count / 2, count - 1], &halves, source, factor, out);
    }
}

simd! {
    /// out[j] = factor (source[j step + at[0]] + source[j step + at[1]] + last[j step + at[2]]), of
    /// these as many as `count`, for the layers along one axis, which closes upon itself. The last
    /// of three is of `last`.
    fn sum_layers[](
        run: Run,
        at: [usize; 3],
        source: &[f64],
        last: &[f64],
        factor: f64,
        out: &mut [f64],
    ) {
        let Run { inner, n, count, step, places } = run;
        let blocks = source.chunks_exact(n * inner).zip(last.chunks_exact(n * inner));
        for ((source, last), out) in blocks.zip(out.chunks_exact_mut(places * inner)) {
            // Along the first axis, places next to each other are one layer, up to the end.
            let (layers, len) = if inner == 1 {
                let whole = n.saturating_sub(at[count - 1]).div_ceil(step).min(places);
                if step == 1 {
                    sum_slices(count, [source, source, last], at, factor, &mut out[..whole]);
                } else {
                    for (j, out) in out[..whole].iter_mut().enumerate() {
                        let from = at.map(|at| at + j * step);
                        let out = std::slice::from_mut(out);
                        sum_slices(count, [source, source, last], from, factor, out);
                    }
                }
                (whole..places, 1)
            } else {
                (0..places, inner)
            };
            for j in layers {
                let from = [0, 1, 2].map(|t| (j * step + at[t]) % n * inner);
                let out = &mut out[j * len..(j + 1) * len];
                sum_slices(count, [source, source, last], from, factor, out);
            }
        }
    }
}

/// out = factor Σ source[from ..], of as many sources as `count`.
#[inline(always)]
fn sum_slices(count: usize, source: [&[f64]; 3], from: [usize; 3], factor: f64, out: &mut [f64]) {
    let len = out.len();
    let a = &source[0][from[0]..][..len];
    match count {
        1 => {
            for i in 0..len {
                out[i] = factor * a[i];
            }
        }
        2 => {
            let b = &source[1][from[1]..][..len];
            for i in 0..len {
                out[i] = factor * (a[i] + b[i]);
            }
        }
        _ => {
            let (b, c) = (&source[1][from[1]..][..len], &source[2][from[2]..][..len]);
            for i in 0..len {
                out[i] = factor * (a[i] + b[i] + c[i]);
            }
        }
    }
}

simd! {
    /// Sums of `count` consecutive numbers, times `factor`.
    fn sum_neighbours[](count: usize, source: &[f64], factor: f64, out: &mut [f64]) {
        if count == 2 {
            for (out, pair) in out.iter_mut().zip(source.chunks_exact(2)) {
                *out = factor * (pair[0] + pair[1]);
            }
        } else {
            for (out, several) in out.iter_mut().zip(source.chunks_exact(count)) {
                let mut sum = several[0];
                for number in &several[1..] {
                    sum += number;
                }
                *out = factor * sum;
            }
        }
    }
}

/// Cells of a row that are handled together, so that the sums of all moments stay in cache.
const STRIP: usize = 32;

/// Memory for the rows of cells in a row of blocks.
struct RowScratch {
    /// φ, the solids' and the gas's velocity of each row, with a cell before and after.
    padded: Vec<Vec<Vec<f64>>>,
    /// Sums of the products over the rows of a block, moment by moment.
    sums: Vec<f64>,
    /// Zeros of a strip.
    none: Vec<f64>,
    /// Cells of a strip, whole blocks.
    strip: usize,
}

impl RowScratch {
    fn new<const D: usize>(grid: &Grid<D>, block: [usize; D]) -> Self {
        let strip = block[0] * (STRIP / block[0]).max(1);
        let rows = block[1..].iter().product();
        Self {
            padded: vec![vec![vec![0.0; grid.cells[0] + 2]; 1 + 2 * D]; rows],
            sums: vec![0.0; moment_count(D) * strip],
            none: vec![0.0; strip],
            strip,
        }
    }
}

/// What the products of a strip of a row are made of: slices of the strip's length.
struct Strip<'a, const D: usize> {
    len: usize,
    /// φ, u_s, u_g of the neighbours below and above along each axis, and 1 / their distance \[1/m\].
    neighbours: [([Row<'a, D>; 2], f64); D],
    here: Row<'a, D>,
    pressure_gradient: [&'a [f64]; D],
    drag_coefficient: &'a [f64],
    drag: [&'a [f64]; D],
    granular_temperature: &'a [f64],
    solids_pressure: &'a [f64],
    /// The components of the solids' stress; as many as three dimensions have, the last ones unused
    /// in two.
    solids_stress: [&'a [f64]; 6],
    /// Particles, and contacts of each, per volume.
    counts: [&'a [f64]; 2],
}

/// Fractions and velocities of a strip.
#[derive(Clone, Copy)]
struct Row<'a, const D: usize> {
    fraction: &'a [f64],
    solids: [&'a [f64]; D],
    gas: [&'a [f64]; D],
}

/// The sums of all products over the blocks of row number `place` of blocks.
fn sum_products<const D: usize>(
    fields: &FineFields<D>,
    block: [usize; D],
    blocks: [usize; D],
    place: usize,
    scratch: &mut RowScratch,
    sums: &mut [f64],
) {
    // Rows of cells in the row of blocks: their place along the axes but the first.
    let row_of = |number: usize| {
        let (mut number, mut place) = (number, place);
        let mut at = [0; D];
        for axis in 1..D {
            at[axis] = place % blocks[axis] * block[axis] + number % block[axis];
            place /= blocks[axis];
            number /= block[axis];
        }
        at
    };
    for (number, padded) in scratch.padded.iter_mut().enumerate() {
        pad(fields, row_of(number), padded);
    }
    let mut start = 0;
    let end = blocks[0] * block[0];
    while start < end {
        let len = scratch.strip.min(end - start);
        for (number, padded) in scratch.padded.iter().enumerate() {
            let strip = strip(fields, row_of(number), start, len, padded, &scratch.none);
            products(&mut scratch.sums[..moment_count(D) * len], number == 0, &strip);
        }
        let first = start / block[0];
        for moment in 0..moment_count(D) {
            let out = &mut sums[moment * blocks[0] + first..][..len / block[0]];
            let source = &scratch.sums[moment * len..][..len];
            match block[0] {
                1 => out.copy_from_slice(source),
                count => sum_neighbours(count, source, 1.0, out),
            }
        }
        start += len;
    }
}

/// Offset of the first cell of the row at `at`.
fn offset<const D: usize>(cells: [usize; D], at: [usize; D]) -> usize {
    (1..D).rev().fold(0, |sum, axis| sum * cells[axis] + at[axis]) * cells[0]
}

/// Copies the row at `at` with a cell before and after: of the other end where the box is periodic,
/// extrapolated where it is not, so that a central difference becomes one-sided.
fn pad<const D: usize>(fields: &FineFields<D>, at: [usize; D], padded: &mut [Vec<f64>]) {
    let n = fields.grid.cells[0];
    let offset = offset(fields.grid.cells, at);
    let sources = std::iter::once(&fields.solids_fraction)
        .chain(&fields.solids_velocity)
        .chain(&fields.gas_velocity);
    for (padded, source) in padded.iter_mut().zip(sources) {
        let row = &source[offset..offset + n];
        padded[1..=n].copy_from_slice(row);
        if fields.periodic[0] {
            (padded[0], padded[n + 1]) = (row[n - 1], row[0]);
        } else {
            let (second, before_last) = (row[1.min(n - 1)], row[n.saturating_sub(2)]);
            (padded[0], padded[n + 1]) = (2.0 * row[0] - second, 2.0 * row[n - 1] - before_last);
        }
    }
}

/// The slices of `len` cells from `start` on of the row at `at`.
fn strip<'a, const D: usize>(
    fields: &'a FineFields<D>,
    at: [usize; D],
    start: usize,
    len: usize,
    padded: &'a [Vec<f64>],
    none: &'a [f64],
) -> Strip<'a, D> {
    let cells = fields.grid.cells;
    let row = |at: [usize; D]| {
        let begin = offset(cells, at) + start;
        let cut = |field: &'a Vec<f64>| &field[begin..begin + len];
        Row {
            fraction: cut(&fields.solids_fraction),
            solids: fields.solids_velocity.each_ref().map(cut),
            gas: fields.gas_velocity.each_ref().map(cut),
        }
    };
    let shifted = |by: usize| {
        let cut = |number: usize| &padded[number][start + by..start + by + len];
        Row {
            fraction: cut(0),
            solids: std::array::from_fn(|axis| cut(1 + axis)),
            gas: std::array::from_fn(|axis| cut(1 + D + axis)),
        }
    };
    let neighbours = std::array::from_fn(|axis| {
        let spacing = fields.grid.spacing[axis];
        if axis == 0 {
            return ([shifted(0), shifted(2)], 0.5 / spacing);
        }
        let n = cells[axis];
        let [mut below, mut above] = [at, at];
        let mut distance = 2.0;
        if fields.periodic[axis] {
            below[axis] = (at[axis] + n - 1) % n;
            above[axis] = (at[axis] + 1) % n;
        } else {
            below[axis] = at[axis].saturating_sub(1);
            above[axis] = (at[axis] + 1).min(n - 1);
            distance = (above[axis] - below[axis]).max(1) as f64;
        }
        ([row(below), row(above)], 1.0 / (distance * spacing))
    });
    let begin = offset(cells, at) + start;
    let cut = |field: &'a Vec<f64>| &field[begin..begin + len];
    Strip {
        len,
        neighbours,
        here: row(at),
        pressure_gradient: fields.pressure_gradient.each_ref().map(cut),
        drag_coefficient: cut(&fields.drag_coefficient),
        drag: fields.drag.each_ref().map(cut),
        granular_temperature: cut(&fields.granular_temperature),
        solids_pressure: cut(&fields.solids_pressure),
        solids_stress: std::array::from_fn(|k| {
            cut(&fields.solids_stress[k.min(symmetric_components(D) - 1)])
        }),
        counts: match &fields.counts {
            Some(counts) => [cut(&counts.number_density), cut(&counts.contact_density)],
            None => [&none[..len]; 2],
        },
    }
}

simd! {
    /// Adds the products of a strip to `out`, moment by moment; sets them if it is the `first`.
    fn products[const D: usize](out: &mut [f64], first: bool, strip: &Strip<'_, D>) {
        let whole = strip.len - strip.len % LANES;
        for i in (0..whole).step_by(LANES) {
            products_at::<D, true>(out, first, strip, i);
        }
        if whole < strip.len {
            products_at::<D, false>(out, first, strip, whole);
        }
    }
}

/// The products of the cells from `i` on: of [`LANES`] cells if `WHOLE`, else of those that are left.
#[inline(always)]
fn products_at<const D: usize, const WHOLE: bool>(
    out: &mut [f64],
    first: bool,
    strip: &Strip<'_, D>,
    i: usize,
) {
    let len = strip.len;
    macro_rules! load {
        ($row:expr) => {
            if WHOLE { Lanes::load(&$row[i..]) } else { Lanes::load_some(&$row[i..len]) }
        };
    }
    macro_rules! put {
        ($column:expr, $value:expr) => {{
            let column: usize = $column;
            let value: Lanes = $value;
            if WHOLE {
                let out = &mut out[column * len + i..][..LANES];
                let sum = if first { value } else { value + Lanes::load(out) };
                sum.store(out);
            } else {
                let out = &mut out[column * len + i..(column + 1) * len];
                let sum = if first { value } else { value + Lanes::load_some(out) };
                sum.store(out);
            }
        }};
    }
    macro_rules! load_vector {
        ($rows:expr) => {{
            let mut values = [Lanes::of(0.0); D];
            for axis in 0..D {
                values[axis] = load!($rows[axis]);
            }
            values
        }};
    }
    let one = Lanes::of(1.0);
    let fraction = load!(strip.here.fraction);
    let gas_fraction = one - fraction;
    let solids = load_vector!(strip.here.solids);
    let gas = load_vector!(strip.here.gas);
    let slope = load_vector!(strip.pressure_gradient);
    let drag = load_vector!(strip.drag);
    let pressure = load!(strip.solids_pressure);

    put!(0, fraction);
    put!(1, fraction * fraction);
    put!(2, load!(strip.drag_coefficient));
    put!(3, pressure);
    put!(4, fraction * load!(strip.granular_temperature));
    let zero = Lanes::of(0.0);
    let (mut drag_on_solids, mut drag_on_gas) = (zero, zero);
    let (mut pressure_on_solids, mut pressure_on_gas) = (zero, zero);
    for a in 0..D {
        let drag = drag[a];
        let solids_flux = fraction * solids[a];
        let gas_flux = gas_fraction * gas[a];
        put!(vector(0, D) + a, solids_flux);
        put!(vector(1, D) + a, gas_flux);
        put!(vector(2, D) + a, fraction * gas[a]);
        put!(vector(3, D) + a, drag);
        put!(vector(4, D) + a, slope[a]);
        put!(vector(5, D) + a, fraction * slope[a]);
        drag_on_solids = drag_on_solids + drag * solids[a];
        drag_on_gas = drag_on_gas + drag * gas[a];
        pressure_on_solids = pressure_on_solids + solids_flux * slope[a];
        pressure_on_gas = pressure_on_gas + gas_flux * slope[a];
        for b in 0..=a {
            let place = symmetric_index(a, b);
            put!(symmetric(0, D) + place, solids_flux * solids[b]);
            put!(symmetric(1, D) + place, gas_flux * gas[b]);
        }
    }
    put!(6, drag_on_solids);
    put!(7, drag_on_gas);
    put!(8, pressure_on_solids);
    put!(9, pressure_on_gas);

    let mut stress = [zero; 6];
    for place in 0..symmetric_components(D) {
        stress[place] = load!(strip.solids_stress[place]);
        put!(symmetric(2, D) + place, stress[place]);
    }
    let mut power = zero;
    for j in 0..D {
        let ([below, above], per_length) = &strip.neighbours[j];
        let per_length = Lanes::of(*per_length);
        let (low, high) = (load!(below.fraction), load!(above.fraction));
        put!(vector(6, D) + j, (high - low) * per_length);
        for i in 0..D {
            let (lower, upper) = (load!(below.solids[i]), load!(above.solids[i]));
            put!(gradient(0, D) + i * D + j, (high * upper - low * lower) * per_length);
            let strain = (upper - lower) * per_length;
            let normal = if i == j { pressure } else { zero };
            power = power + (stress[symmetric_index(i, j)] + normal) * strain;
            let (lower, upper) = (load!(below.gas[i]), load!(above.gas[i]));
            let flux = (one - high) * upper - (one - low) * lower;
            put!(gradient(1, D) + i * D + j, flux * per_length);
        }
    }
    put!(5, power);
    if D == 3 {
        put!(gradient(2, D), load!(strip.counts[0]));
        put!(gradient(2, D) + 1, load!(strip.counts[1]));
    }
}

/// Random fields for the tests of this module and of the statistics.
#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::filtered::{Densities, TERM_COUNT, Term as T, terms};
    use crate::fine::Counts;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use crate::laws::drag::{DragLaw, WenYu};
    use crate::laws::scales::tests::{GAS, POWDER};

    /// Fields of independent random cells, φ in \[0, 0.6), drag of Wen & Yu; some cells are empty.
    pub(crate) fn random_fields<const D: usize>(grid: Grid<D>, seed: u64) -> FineFields<D> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut fields = FineFields::zeros(grid);
        let law = WenYu::<f64>::new(&GAS, &POWDER);
        let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        for i in 0..grid.len() {
            fields.solids_fraction[i] = between(-0.05, 0.6).max(0.0);
            let mut squared = 0.0;
            for axis in 0..D {
                let lift = if axis == D - 1 { 0.3 } else { 0.0 };
                fields.solids_velocity[axis][i] = between(-0.4, 0.4);
                fields.gas_velocity[axis][i] = between(-0.5, 0.5) + lift;
                let slip = fields.gas_velocity[axis][i] - fields.solids_velocity[axis][i];
                squared += slip * slip;
            }
            let beta = law.beta(fields.solids_fraction[i], squared.sqrt());
            fields.drag_coefficient[i] = beta;
            for axis in 0..D {
                let slip = fields.gas_velocity[axis][i] - fields.solids_velocity[axis][i];
                fields.drag[axis][i] = beta * slip;
            }
            for slope in &mut fields.pressure_gradient {
                slope[i] = between(-3000.0, 3000.0);
            }
            fields.granular_temperature[i] = between(0.0, 0.01);
            fields.solids_pressure[i] = between(0.0, 2.0);
            for component in &mut fields.solids_stress {
                component[i] = between(-1.0, 1.0);
            }
        }
        fields
    }

    fn filtered<const D: usize>(fields: &FineFields<D>, widths: &[[usize; D]]) -> MomentFilter<D> {
        let mut filter =
            MomentFilter::new(fields.grid, fields.periodic, Kernel::Box, widths, 2, false).unwrap();
        filter.filter(fields);
        filter
    }

    fn found<const D: usize>(moments: &Moments<f64, D>, densities: Densities) -> [f64; TERM_COUNT] {
        let mut found = [0.0; TERM_COUNT];
        terms(moments, 1.0, densities, &mut found);
        found
    }

    fn place<const D: usize>(cells: [usize; D], mut cell: usize) -> [usize; D] {
        std::array::from_fn(|axis| {
            let here = cell % cells[axis];
            cell /= cells[axis];
            here
        })
    }

    fn index<const D: usize>(cells: [usize; D], at: [usize; D]) -> usize {
        (0..D).rev().fold(0, |sum, axis| sum * cells[axis] + at[axis] % cells[axis])
    }

    fn close(a: f64, b: f64, size: f64) {
        assert!((a - b).abs() < 1e-12 * size.max(b.abs()), "{a} {b}");
    }

    /// Every moment at every position against its definition.
    fn check<const D: usize>(cells: [usize; D], periodic: [bool; D], widths: &[[usize; D]]) {
        let grid = Grid::new(std::array::from_fn(|axis| 0.1 + 0.02 * axis as f64), cells);
        let mut fields = FineFields { periodic, ..random_fields(grid, 7) };
        // A drag that is not β times the slip: what is filtered is the force that is given. And particles.
        for drag in &mut fields.drag {
            drag.iter_mut().enumerate().for_each(|(k, drag)| *drag *= 0.9 + 0.1 * (k % 5) as f64);
        }
        let mut counts = Counts::zeros(grid.len());
        for (k, phi) in fields.solids_fraction.iter().enumerate() {
            counts.number_density[k] = 4e12 * phi;
            counts.contact_density[k] = (k % 3) as f64 * 4e12 * phi;
        }
        fields.counts = Some(counts);
        let filter = filtered(&fields, widths);
        for (number, &width) in widths.iter().enumerate() {
            let positions = &filter.positions()[number];
            let columns = filter.moments(number);
            assert_eq!(columns.len(), positions.len());
            assert!(!columns.is_empty());
            for n in 0..positions.len() {
                let first = positions.first_cell(n);
                let volume: usize = width.iter().product();
                let boxed: Vec<[usize; D]> = (0..volume)
                    .map(|k| {
                        let step = place(width, k);
                        std::array::from_fn(|axis| (first[axis] + step[axis]) % cells[axis])
                    })
                    .collect();
                for axis in 0..D {
                    let ends = first[axis] + width[axis];
                    assert!(periodic[axis] || ends <= cells[axis], "a filter across a wall");
                }
                check_position(&fields, &boxed, columns.at(n));
                let mut lanes = Moments::zeros();
                columns.load(n - n % LANES, &mut lanes);
                assert_eq!(lanes.gas_flux[1].0[n % LANES], columns.at(n).gas_flux[1]);
            }
        }
    }

    fn check_position<const D: usize>(
        fields: &FineFields<D>,
        boxed: &[[usize; D]],
        found: Moments<f64, D>,
    ) {
        let (cells, h) = (fields.grid.cells, fields.grid.spacing);
        let phi = &fields.solids_fraction;
        let [us, ug] = [&fields.solids_velocity, &fields.gas_velocity];
        let mean = |value: &dyn Fn(usize) -> f64| {
            let sum: f64 = boxed.iter().map(|at| value(index(cells, *at))).sum();
            sum / boxed.len() as f64
        };
        // Central difference; one-sided at a wall.
        let difference = |value: &dyn Fn(usize) -> f64, cell: usize, axis: usize| {
            let at = place(cells, cell);
            let n = cells[axis];
            let neighbour = |to: usize| {
                let mut at = at;
                at[axis] = to;
                value(index(cells, at))
            };
            let here = at[axis];
            if fields.periodic[axis] || (here > 0 && here < n - 1) {
                (neighbour((here + 1) % n) - neighbour((here + n - 1) % n)) / (2.0 * h[axis])
            } else if here == 0 {
                (neighbour(1) - neighbour(0)) / h[axis]
            } else {
                (neighbour(n - 1) - neighbour(n - 2)) / h[axis]
            }
        };
        let drag = |k: usize, a: usize| fields.drag[a][k];
        let slope = &fields.pressure_gradient;
        let dot = |f: &dyn Fn(usize) -> f64| (0..D).map(f).sum::<f64>();

        close(found.solids_fraction, mean(&|k| phi[k]), 1.0);
        close(found.solids_fraction_squared, mean(&|k| phi[k] * phi[k]), 1.0);
        close(found.drag_coefficient, mean(&|k| fields.drag_coefficient[k]), 1.0);
        close(found.kinetic_pressure, mean(&|k| fields.solids_pressure[k]), 1.0);
        if let (3, Some(counts)) = (D, &fields.counts) {
            close(found.number_density, mean(&|k| counts.number_density[k]), 1e12);
            close(found.contact_density, mean(&|k| counts.contact_density[k]), 1e12);
        }
        let theta = &fields.granular_temperature;
        close(found.fraction_temperature, mean(&|k| phi[k] * theta[k]), 1.0);
        close(found.drag_on_solids, mean(&|k| dot(&|a| drag(k, a) * us[a][k])), 1e4);
        close(found.drag_on_gas, mean(&|k| dot(&|a| drag(k, a) * ug[a][k])), 1e4);
        let on_solids = |k: usize| phi[k] * dot(&|a| us[a][k] * slope[a][k]);
        let on_gas = |k: usize| (1.0 - phi[k]) * dot(&|a| ug[a][k] * slope[a][k]);
        close(found.pressure_on_solids, mean(&on_solids), 1e4);
        close(found.pressure_on_gas, mean(&on_gas), 1e4);
        for a in 0..D {
            close(found.solids_flux[a], mean(&|k| phi[k] * us[a][k]), 1.0);
            close(found.gas_flux[a], mean(&|k| (1.0 - phi[k]) * ug[a][k]), 1.0);
            close(found.seen_gas_flux[a], mean(&|k| phi[k] * ug[a][k]), 1.0);
            close(found.drag[a], mean(&|k| drag(k, a)), 1e4);
            close(found.pressure_gradient[a], mean(&|k| slope[a][k]), 1e4);
            close(found.fraction_pressure_gradient[a], mean(&|k| phi[k] * slope[a][k]), 1e4);
            close(found.fraction_gradient[a], mean(&|k| difference(&|k| phi[k], k, a)), 1e4);
            for b in 0..D {
                let (pair, place) = (symmetric_index(a, b), boxed.len() as f64);
                let stress = &fields.solids_stress[pair];
                close(found.kinetic_stress[a][b], mean(&|k| stress[k]), place);
                let flux = |k: usize| phi[k] * us[a][k] * us[b][k];
                close(found.solids_flux_velocity[a][b], mean(&flux), 1.0);
                let flux = |k: usize| (1.0 - phi[k]) * ug[a][k] * ug[b][k];
                close(found.gas_flux_velocity[a][b], mean(&flux), 1.0);
                // Extrapolation along the first axis is of factors, not of products.
                let wall = !fields.periodic[0] && b == 0;
                if !wall {
                    let flux = |k: usize| phi[k] * us[a][k];
                    let slope = |k: usize| difference(&flux, k, b);
                    close(found.solids_flux_gradient[a][b], mean(&slope), 1e4);
                    let flux = |k: usize| (1.0 - phi[k]) * ug[a][k];
                    let slope = |k: usize| difference(&flux, k, b);
                    close(found.gas_flux_gradient[a][b], mean(&slope), 1e4);
                }
            }
        }
        let power = |k: usize| {
            dot(&|i| {
                dot(&|j| {
                    let normal = if i == j { fields.solids_pressure[k] } else { 0.0 };
                    let stress = fields.solids_stress[symmetric_index(i, j)][k] + normal;
                    stress * difference(&|k| us[i][k], k, j)
                })
            })
        };
        close(found.stress_power, mean(&power), 1e4);
        // Residual stress from all pairs of cells, without any mean velocity.
        if boxed.len() <= 40 {
            let places: Vec<usize> = boxed.iter().map(|at| index(cells, *at)).collect();
            let residual =
                |weight: &dyn Fn(usize) -> f64, u: &[Vec<f64>; D], i: usize, j: usize| {
                    let pair = |a: usize, b: usize| {
                        let [a, b] = [places[a], places[b]];
                        weight(a) * weight(b) * (u[i][a] - u[i][b]) * (u[j][a] - u[j][b])
                    };
                    let n = places.len();
                    let pairs: f64 = (0..n).map(|a| (0..n).map(|b| pair(a, b)).sum::<f64>()).sum();
                    let weight: f64 = places.iter().map(|&k| weight(k)).sum();
                    pairs / (2.0 * weight.max(1e-300) * n as f64)
                };
            let (solids, gas) = (found.residual_stress(), found.gas_residual_stress());
            for i in 0..D {
                for j in 0..D {
                    let direct = residual(&|k| phi[k], us, i, j);
                    assert!((solids[i][j] - direct).abs() < 1e-12, "{} {direct}", solids[i][j]);
                    let direct = residual(&|k| 1.0 - phi[k], ug, i, j);
                    assert!((gas[i][j] - direct).abs() < 1e-12, "{} {direct}", gas[i][j]);
                }
            }
        }
    }

    #[test]
    fn moments_are_what_they_are_defined_to_be() {
        check([12, 10], [true; 2], &[[1, 1], [2, 2], [6, 4], [12, 10], [5, 3], [7, 2]]);
        check([40, 16], [true; 2], &[[8, 8], [4, 4], [16, 16], [12, 12], [4, 16]]);
        check([12, 8, 16], [true; 3], &[[2, 2, 2], [4, 4, 8], [6, 2, 4], [3, 3, 5]]);
        check([8, 6, 10], [true; 3], &[[8, 6, 10]]);
    }

    #[test]
    fn no_filter_reaches_across_a_wall() {
        check([13, 11], [false; 2], &[[1, 1], [2, 2], [6, 4], [13, 11], [5, 3]]);
        check([12, 10], [true, false], &[[4, 4], [6, 6], [12, 3]]);
        check([9, 8, 11], [false, true, false], &[[4, 4, 4], [3, 2, 5]]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn any_widths_agree_with_their_definition(
            nx in 2usize..20, ny in 2usize..20, a in 1usize..20, b in 1usize..20, c in 1usize..9,
            x: bool, y: bool,
        ) {
            let widths = [[a.min(nx), b.min(ny)], [c.min(nx), c.min(ny)]];
            check([nx, ny], [x, y], &widths);
        }
    }

    #[test]
    fn other_kernels_filter_every_moment() {
        let grid = Grid::new([0.1, 0.12], [16, 12]);
        let fields = random_fields(grid, 11);
        for kernel in [Kernel::Gaussian, Kernel::Diffusion, Kernel::Sharp] {
            let widths = [[1, 1], [4, 6]];
            let mut filter = MomentFilter::new(grid, [true; 2], kernel, &widths, 2, false).unwrap();
            filter.filter(&fields);
            let fine = filtered(&fields, &[[1, 1]]);
            // One cell filters nothing; wider, each moment is the filtered field of that of one cell.
            let (same, coarse) = (filter.moments(0), filter.moments(1));
            let spectral = SpectralFilter::new(kernel, grid.cells, &[[4.0, 6.0]]);
            for column in 0..moment_count(2) {
                let field = &fine.columns[column * fine.stride..][..grid.len()];
                let size = field.iter().fold(1.0, |most: f64, q| most.max(q.abs()));
                for (n, value) in field.iter().enumerate() {
                    let found = same.columns[column * same.stride + n];
                    assert!((found - value).abs() < 1e-13 * size, "{kernel:?} {column}");
                }
                spectral.filter(field, &mut spectral.scratch(), |_, exact| {
                    for n in 0..coarse.len() {
                        let found = coarse.columns[column * coarse.stride + coarse.first + n];
                        let cell = filter.positions()[1].cell(n, grid.cells);
                        assert!((found - exact[cell]).abs() < 1e-13 * size, "{kernel:?} {column}");
                    }
                });
            }
            let refused =
                MomentFilter::new(grid, [true, false], kernel, &widths, 2, false).unwrap_err();
            assert_eq!(refused, FilterError::Walls { kernel: kernel.name(), axis: 1 });
        }
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let grid = Grid::new([0.1; 3], [16, 8, 12]);
        let fields = random_fields(grid, 3);
        let widths = [[2; 3], [4; 3], [8, 4, 6]];
        let serial = filtered(&fields, &widths);
        let mut parallel =
            MomentFilter::new(grid, [true; 3], Kernel::Box, &widths, 2, true).unwrap();
        parallel.filter(&fields);
        assert_eq!(serial.columns, parallel.columns);
    }

    #[test]
    fn positions_lie_half_a_width_apart_and_tile() {
        let spacing = |n: usize, w: usize, periodic: bool| {
            let p = Positions::new([n, n], [periodic; 2], [w, w], 2);
            (p.block[0] * p.step[0], p.shape[0])
        };
        let found = [1, 2, 4, 6, 8, 12, 32, 31].map(|w| spacing(128, w, true));
        let expected = [(1, 128), (2, 64), (2, 64), (2, 64), (4, 32), (4, 32), (16, 8), (8, 16)];
        assert_eq!(found, expected);
        assert_eq!([4, 6].map(|w| spacing(15, w, false)), [(2, 6), (3, 4)]);
        let sparse = [1, 2, 4, 6, 12, 32].map(|w| {
            let p = Positions::new([128, 128], [true; 2], [w, w], 4);
            (p.block[0], p.count[0], p.step[0])
        });
        let expected = [(1, 1, 1), (2, 1, 2), (4, 1, 1), (2, 3, 2), (4, 3, 1), (16, 2, 1)];
        assert_eq!(sparse, expected);
    }

    #[test]
    fn a_moving_observer_finds_the_same() {
        let grid = Grid::new([0.1, 0.12], [10, 12]);
        let rest = random_fields(grid, 5);
        let mut moving = rest.clone();
        for velocity in moving.solids_velocity.iter_mut().chain(&mut moving.gas_velocity) {
            velocity.iter_mut().for_each(|u| *u += 1.5);
        }
        let densities = Densities { solids: 1500.0, gas: 1.3 };
        let [rest, moving] = [rest, moving].map(|fields| filtered(&fields, &[[2, 4], [5, 6]]));
        // What is told in the frame of the observer.
        let of_frame = [T::SolidsFlux, T::GasFlux];
        for number in 0..2 {
            let (rest, moving) = (rest.moments(number), moving.moments(number));
            for (a, b) in (0..rest.len()).map(|n| (rest.at(n), moving.at(n))) {
                let [a, b] = [a, b].map(|moments| found(&moments, densities));
                for (place, (a, b)) in a.iter().zip(b).enumerate() {
                    let exempt = of_frame.iter().any(|term| *term as usize == place);
                    let size = a.abs().max(1e5);
                    assert!(exempt || (a - b).abs() < 1e-9 * size, "term {place}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn the_rate_of_a_shear_wave_is_its_central_difference() {
        let grid = Grid::new([0.16, 0.08], [64, 32]);
        let mut fields = FineFields::zeros(grid);
        let angle = |x: usize| std::f64::consts::TAU * x as f64 / 64.0;
        for i in 0..grid.len() {
            fields.solids_fraction[i] = 0.3;
            fields.solids_velocity[1][i] = angle(i % 64).sin();
            fields.solids_velocity[0][i] = 2.0;
        }
        let filter = filtered(&fields, &[[1, 1]]);
        for cell in 0..grid.len() {
            let gradient = filter.moments(0).at(cell).solids_velocity_gradient();
            let slope = angle(1).sin() * angle(cell % 64).cos() / grid.spacing[0];
            assert!((gradient[1][0] - slope).abs() < 1e-10);
            let others = [gradient[0][0], gradient[0][1], gradient[1][1]];
            assert!(others.iter().all(|gradient| gradient.abs() < 1e-10));
        }
    }

    #[test]
    fn an_empty_box_gives_finite_terms() {
        let grid = Grid::new([0.1, 0.1], [8, 8]);
        let mut fields = random_fields(grid, 3);
        fields.solids_fraction.fill(0.0);
        fields.solids_fraction[0] = 1e-300;
        fields.solids_fraction[8 * 4] = 0.6;
        let filter = filtered(&fields, &[[1, 1], [2, 2], [4, 4]]);
        let densities = Densities { solids: 1500.0, gas: 1.3 };
        for number in 0..3 {
            let columns = filter.moments(number);
            for n in 0..columns.len() {
                let at = columns.at(n);
                assert!(at.slip_speed() < 3.0, "{}", at.slip_speed());
                assert!(found(&at, densities).iter().all(|term| term.is_finite()));
            }
        }
    }
}
