//! [`Field`]: one number per cell; [`Faces`]: one per face of each axis; `Ring`: the last few
//! slabs of a field that a sweep leaves behind. All periodic.

use crate::grid::Grid;
use crate::memory::Memory;
use crate::real::Real;

/// Cells copied to either end of a row from its other end: what a limited slope needs beside a face.
pub(crate) const HALO: usize = 2;

/// Elements between two rows, which hold the end of the halo of one and the beginning of that of the
/// next: no more, because kernels go over them where several rows are one long row.
const PAD: usize = 4;

/// Where the cells of a grid lie in memory: rows along the first axis are contiguous.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout<const D: usize> {
    /// Cells along each axis.
    pub cells: [usize; D],
    /// Distance in memory between neighbours along each axis.
    stride: [usize; D],
}

/// A row of cells along the first axis: how far it is shifted along that axis, and its index along
/// each of the others, which the boundary may lie on the way to. Or several rows of a slab that
/// follow one another, with what lies between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row<const D: usize> {
    at: [isize; D],
    /// Elements from its first cell to its last.
    extent: usize,
}

impl<const D: usize> Row<D> {
    /// The row seen from `n` cells behind along `axis`: its neighbour, or itself shifted. A shift
    /// along the first axis is at most two.
    #[inline(always)]
    #[must_use]
    pub fn near(mut self, axis: usize, n: isize) -> Self {
        self.at[axis] += n;
        self
    }

    /// Index along the last axis, not wrapped.
    pub(crate) fn slab(self) -> isize {
        self.at[D - 1]
    }
}

impl<const D: usize> Layout<D> {
    /// The layout of `cells`.
    pub fn new(cells: [usize; D]) -> Self {
        let mut stride = [1; D];
        let mut len = cells[0].next_multiple_of(PAD) + PAD;
        for axis in 1..D {
            stride[axis] = len;
            len *= cells[axis];
        }
        Self { cells, stride }
    }

    /// Number of rows along the first axis.
    pub fn rows(&self) -> usize {
        self.cells[1..].iter().product()
    }

    /// Rows with one index along the last axis.
    pub(crate) fn rows_of_slab(&self) -> usize {
        self.cells[1..D - 1].iter().product()
    }

    /// Row number `row`, counted along the second axis first.
    #[inline]
    pub fn row(&self, mut row: usize) -> Row<D> {
        let mut at = [0; D];
        for axis in 1..D {
            at[axis] = (row % self.cells[axis]) as isize;
            row /= self.cells[axis];
        }
        Row { at, extent: self.extent(1) }
    }

    /// The number of a row that is not shifted.
    pub(crate) fn number(&self, row: Row<D>) -> usize {
        (1..D).rev().fold(0, |number, axis| number * self.cells[axis] + row.at[axis] as usize)
    }

    /// The rows of the slab `slab`, which may lie beyond the boundary, as few pieces as can be: rows
    /// whose neighbours lie as they do in memory are one. A kernel does well on long rows.
    #[inline(always)]
    pub(crate) fn pieces(&self, slab: isize) -> impl Iterator<Item = Row<D>> + use<D> {
        let layout = *self;
        // In two dimensions there is one, which the compiler is to see.
        let rows = if D == 2 { 1 } else { layout.rows_of_slab() };
        let near = HALO.min(rows);
        let inner = rows.saturating_sub(2 * near);
        let mut row = 0;
        std::iter::from_fn(move || {
            if row == rows {
                return None;
            }
            let mut at = [0; D];
            // The rows of a slab are counted along the second axis.
            at[1] = row as isize;
            at[D - 1] = slab;
            let count = if row == near && inner > 0 { inner } else { 1 };
            row += count;
            Some(Row { at, extent: layout.extent(count) })
        })
    }

    /// Elements from the first cell of `rows` rows to the last.
    #[inline(always)]
    fn extent(&self, rows: usize) -> usize {
        self.cells[0] + (rows - 1) * self.stride[1]
    }

    /// The rows that make up the cells of a [`Row`].
    pub(crate) fn each<'a, R>(
        &self,
        cells: &'a [R],
    ) -> impl Iterator<Item = &'a [R]> + use<'a, R, D> {
        let n = self.cells[0];
        cells.chunks(self.stride[1]).map(move |row| &row[..n])
    }

    /// Elements from the first cell of one row to that of the next.
    pub(crate) fn row_stride(&self) -> usize {
        self.stride[1]
    }

    /// Elements from the first cell of one slab to that of the next.
    fn slab(&self) -> usize {
        self.stride[D - 1]
    }

    /// Offset of the first cell of a row from that of the first.
    #[inline(always)]
    fn offset(&self, row: Row<D>) -> usize {
        let mut offset = 0;
        for axis in 1..D {
            offset += self.wrapped(row, axis) * self.stride[axis];
        }
        offset.wrapping_add_signed(row.at[0])
    }

    /// Offset of a row of a [`Ring`] whose slabs are a power of two.
    #[inline(always)]
    fn offset_in_ring(&self, row: Row<D>) -> usize {
        let place = row.at[D - 1] & (self.cells[D - 1] as isize - 1);
        let mut offset = place as usize * self.stride[D - 1];
        for axis in 1..D - 1 {
            offset += self.wrapped(row, axis) * self.stride[axis];
        }
        offset.wrapping_add_signed(row.at[0])
    }

    /// Index of a row along an axis, on this side of the boundary.
    #[inline(always)]
    fn wrapped(&self, row: Row<D>, axis: usize) -> usize {
        let (index, n) = (row.at[axis] as usize, self.cells[axis]);
        // Few rows lie beyond the boundary; a remainder for each would cost as much as a kernel.
        if index < n { index } else { row.at[axis].rem_euclid(n as isize) as usize }
    }

    /// Length of the memory of all rows with their halos.
    fn len(&self) -> usize {
        PAD + self.cells[D - 1] * self.slab()
    }

    /// Where a row with its halo lies from the first cell of all.
    #[inline]
    pub(crate) fn span(&self, row: Row<D>) -> std::ops::Range<isize> {
        let begin = self.offset(row) as isize;
        begin - HALO as isize..begin + (row.extent + HALO) as isize
    }

    /// The rows from number `begin` to before `end` in as few pieces as can be: rows whose neighbours, one
    /// away along any axis, lie as they do in memory are one.
    #[inline(always)]
    pub(crate) fn runs(&self, begin: usize, end: usize) -> impl Iterator<Item = Row<D>> + use<D> {
        let (layout, n) = (*self, self.cells[1]);
        let mut number = begin;
        std::iter::from_fn(move || {
            let mut row = (number < end).then(|| layout.row(number))?;
            let index = row.at[1] as usize;
            let inner = index > 0 && index + 1 < n;
            let count = if inner { (n - 1 - index).min(end - number) } else { 1 };
            row.extent = layout.extent(count);
            number += count;
            Some(row)
        })
    }

    /// Elements of the rows of a slab with their halos.
    pub(crate) fn most_elements(&self) -> usize {
        self.cells[0] + self.rows_of_slab() * self.stride[1] + 2 * HALO
    }

    /// Copies the last and first cells of rows, given with their halos, into the halos.
    #[inline(always)]
    pub(crate) fn wrap<R: Copy>(&self, lines: &mut [R]) {
        let n = self.cells[0];
        let wrap = |line: &mut [R]| {
            if n >= HALO {
                // Copies of a length that is known are two moves each.
                line.copy_within(n..n + HALO, 0);
                line.copy_within(HALO..2 * HALO, n + HALO);
            } else {
                for i in 0..HALO {
                    line[HALO - 1 - i] = line[HALO + n - 1 - i % n];
                    line[HALO + n + i] = line[HALO + i % n];
                }
            }
        };
        if lines.len() == n + 2 * HALO {
            // One row has no need of a division.
            wrap(lines);
        } else {
            lines.chunks_mut(self.stride[1]).for_each(wrap);
        }
    }

    /// The span of a row of `extent` elements with its halo, from the offset of its first cell.
    #[inline(always)]
    fn with_halo(offset: usize, extent: usize) -> std::ops::Range<usize> {
        offset - HALO..offset + extent + HALO
    }
}

/// One number per cell of a periodic grid.
#[derive(Debug)]
pub struct Field<R, const D: usize> {
    pub(crate) layout: Layout<D>,
    data: Memory<R>,
    /// Where the first cell is, on a multiple of 64 bytes: a vector that crosses two cache lines
    /// costs twice.
    origin: usize,
}

impl<R: Real, const D: usize> Clone for Field<R, D> {
    fn clone(&self) -> Self {
        // The copy has an origin of its own.
        let mut copy = Self::zeros(self.layout);
        copy.copy_from(self);
        copy
    }
}

/// One number per face: component `a` holds, for each cell, its lower face along axis `a`.
pub type Faces<R, const D: usize> = [Field<R, D>; D];

impl<R: Real, const D: usize> Field<R, D> {
    /// A field of zeros.
    pub fn zeros(layout: Layout<D>) -> Self {
        const LINE: usize = 64;
        let data = Memory::<R>::zeros(layout.len() + LINE / size_of::<R>());
        let origin = PAD + data[PAD..].as_ptr().align_offset(LINE).min(LINE / size_of::<R>());
        Self { layout, data, origin }
    }

    /// Faces of zeros.
    pub fn zero_faces(layout: Layout<D>) -> Faces<R, D> {
        std::array::from_fn(|_| Self::zeros(layout))
    }

    /// As many cells as a row has.
    #[inline(always)]
    pub fn row(&self, row: Row<D>) -> &[R] {
        let at = self.at(row);
        &self.data[at..at + row.extent]
    }

    /// Where a row begins.
    #[inline(always)]
    fn at(&self, row: Row<D>) -> usize {
        self.origin + self.layout.offset(row)
    }

    /// A row, to be written; [`Field::wrap`] must follow before its neighbours are read.
    pub fn row_mut(&mut self, row: Row<D>) -> &mut [R] {
        let at = self.origin + self.layout.offset(row);
        &mut self.data[at..at + self.layout.cells[0]]
    }

    /// Where the first cell is.
    pub(crate) fn memory(&mut self) -> *mut R {
        let origin = self.origin;
        self.data.as_mut_ptr().wrapping_add(origin)
    }

    /// The rows, in order.
    pub fn interior(&self) -> impl Iterator<Item = &[R]> {
        (0..self.layout.rows()).map(|row| self.row(self.layout.row(row)))
    }

    /// Sets every cell from its index.
    pub fn set(&mut self, mut value: impl FnMut([usize; D]) -> R) {
        for row in 0..self.layout.rows() {
            let row = self.layout.row(row);
            let mut index = row.at.map(|i| i as usize);
            for (i, q) in self.row_mut(row).iter_mut().enumerate() {
                index[0] = i;
                *q = value(index);
            }
        }
        self.wrap();
    }

    /// Takes the numbers of a field of the same layout, halos and all.
    pub fn copy_from(&mut self, from: &Self) {
        let len = self.layout.len();
        let own = &mut self.data[self.origin - PAD..][..len];
        own.copy_from_slice(&from.data[from.origin - PAD..][..len]);
    }

    /// Fills the halos of the rows.
    pub fn wrap(&mut self) {
        for row in 0..self.layout.rows() {
            let offset = self.origin + self.layout.offset(self.layout.row(row));
            let line = Layout::<D>::with_halo(offset, self.layout.cells[0]);
            self.layout.wrap(&mut self.data[line]);
        }
    }

    /// All slabs, to be written in parts.
    pub(crate) fn slabs(&mut self) -> Slabs<'_, R, D> {
        let Self { layout, origin, data } = self;
        let begin = *origin - PAD / 2;
        let data = &mut data[begin..begin + layout.cells[D - 1] * layout.slab()];
        Slabs { layout: *layout, first: 0, data }
    }

    /// Sum over the cells, in double precision and row order.
    pub fn sum(&self) -> f64 {
        self.interior().map(|row| row.iter().map(|q| q.f64()).sum::<f64>()).sum()
    }

    /// Mean over the cells.
    pub fn mean(&self) -> f64 {
        self.sum() / self.layout.cells.iter().product::<usize>() as f64
    }

    /// Smallest value of the cells.
    pub fn min(&self) -> R {
        let first = self.data[self.origin];
        self.interior().flatten().fold(first, |m, &q| m.min(q))
    }

    /// Largest value of the cells.
    pub fn max(&self) -> R {
        let first = self.data[self.origin];
        self.interior().flatten().fold(first, |m, &q| m.max(q))
    }
}

/// Some neighbouring slabs of a field, which one thread writes.
pub(crate) struct Slabs<'a, R, const D: usize> {
    layout: Layout<D>,
    first: usize,
    /// From half the padding before the first row on: halos of two slabs do not meet.
    data: &'a mut [R],
}

impl<R: Real, const D: usize> Slabs<'_, R, D> {
    /// Those before slab `slab` and those from it on.
    pub(crate) fn split_at(self, slab: usize) -> (Self, Self) {
        let Self { layout, first, data } = self;
        let (lower, upper) = data.split_at_mut((slab - first) * layout.slab());
        (Self { layout, first, data: lower }, Self { layout, first: slab, data: upper })
    }

    /// A row and its halo; `spare` if it is not of these slabs. Where these are all that there are, every
    /// row is of them, beyond the boundary or not.
    #[inline(always)]
    pub(crate) fn line<'b>(&'b mut self, row: Row<D>, spare: &'b mut [R]) -> &'b mut [R] {
        let slab = self.layout.slab();
        let slabs = self.first as isize..(self.first + self.data.len() / slab) as isize;
        if slabs.contains(&row.slab()) || slabs.len() == self.layout.cells[D - 1] {
            let at = self.layout.offset(row) - self.first * slab + PAD / 2;
            &mut self.data[Layout::<D>::with_halo(at, row.extent)]
        } else {
            &mut spare[..row.extent + 2 * HALO]
        }
    }
}

/// The last few slabs of a field that a sweep along the last axis leaves behind; slabs beyond the
/// boundary have a place of their own.
#[derive(Debug)]
pub(crate) struct Ring<R, const D: usize> {
    field: Field<R, D>,
    /// The first slabs that the sweep made, if it [keeps](Ring::keep) them.
    kept: Memory<R>,
    /// Which slab each place holds: tests see to it that no other is looked at.
    #[cfg(test)]
    held: Vec<Option<isize>>,
    /// The slab that was written last.
    #[cfg(test)]
    last: isize,
}

impl<R: Real, const D: usize> Ring<R, D> {
    /// A ring of `slabs` slabs, a power of two, of the rows of `layout`.
    pub(crate) fn new(layout: Layout<D>, slabs: usize) -> Self {
        assert!(slabs.is_power_of_two(), "a ring of {slabs} slabs");
        let mut cells = layout.cells;
        cells[D - 1] = slabs;
        Self {
            field: Field::zeros(Layout::new(cells)),
            kept: Memory::zeros(0),
            #[cfg(test)]
            held: vec![None; slabs],
            #[cfg(test)]
            last: isize::MIN,
        }
    }

    /// With room to [`keep`](Ring::keep) as many of the first slabs that a sweep makes.
    #[must_use]
    pub(crate) fn with_kept(mut self, slabs: usize) -> Self {
        self.kept = Memory::zeros(slabs * self.field.layout.slab());
        self
    }

    /// Keeps a slab, the sweep's `number`-th, if there is room for as many.
    pub(crate) fn keep(&mut self, slab: isize, number: usize) {
        let from = self.memory_of(slab);
        let len = from.len();
        if let Some(kept) = self.kept.chunks_exact_mut(len).nth(number) {
            kept.copy_from_slice(&self.field.data[from]);
        }
    }

    /// Makes the `number`-th slab that was kept the slab `slab`, if there was room to keep it.
    pub(crate) fn bring_back(&mut self, slab: isize, number: usize) {
        let to = self.memory_of(slab);
        let len = to.len();
        if let Some(kept) = self.kept.chunks_exact(len).nth(number) {
            self.field.data[to].copy_from_slice(kept);
            #[cfg(test)]
            self.holds(slab);
        }
    }

    /// Where the rows of a slab and their halos are.
    fn memory_of(&self, slab: isize) -> std::ops::Range<usize> {
        let Field { layout, origin, .. } = &self.field;
        let place = slab & (layout.cells[D - 1] as isize - 1);
        let begin = *origin - PAD / 2 + place as usize * layout.slab();
        begin..begin + layout.slab()
    }

    /// Notes that a slab is written.
    #[cfg(test)]
    fn holds(&mut self, slab: isize) {
        let place = slab as usize % self.held.len();
        if slab < self.last {
            // Another sweep begins.
            self.held.fill(None);
        }
        self.last = slab;
        self.held[place] = Some(slab);
    }

    /// A row and its halo, to be written.
    #[inline(always)]
    pub(crate) fn line(&mut self, row: Row<D>) -> &mut [R] {
        #[cfg(test)]
        self.holds(row.slab());
        let Field { layout, data, origin } = &mut self.field;
        let at = *origin + layout.offset_in_ring(row);
        &mut data[Layout::<D>::with_halo(at, row.extent)]
    }

    /// As [`Field::row`].
    #[inline(always)]
    pub(crate) fn row(&self, row: Row<D>) -> &[R] {
        let at = self.at(row);
        &self.field.data[at..at + row.extent]
    }

    /// A row and its halo.
    #[inline(always)]
    pub(crate) fn whole(&self, row: Row<D>) -> &[R] {
        let at = self.at(row);
        &self.field.data[Layout::<D>::with_halo(at, row.extent)]
    }

    /// Where a row begins.
    #[inline(always)]
    fn at(&self, row: Row<D>) -> usize {
        #[cfg(test)]
        assert!(
            self.held[row.slab() as usize % self.held.len()] == Some(row.slab()),
            "slab {} of a ring is not made yet, or written over: {:?}",
            row.slab(),
            self.held
        );
        self.field.origin + self.field.layout.offset_in_ring(row)
    }
}

/// What has rows: a [`Field`] or a [`Ring`].
pub(crate) trait Lines<R, const D: usize>: Sync {
    /// As many cells as a row has.
    fn row(&self, row: Row<D>) -> &[R];

    /// The rows from two behind to one ahead along `axis`.
    fn across(&self, row: Row<D>, axis: usize) -> [&[R]; 4];
}

/// [`Lines::across`] of something with `row` and `at`, where its elements are.
macro_rules! across {
    ($self:ident, $data:expr, $row:ident, $axis:ident) => {
        if $axis == 0 {
            // One place is all there is to find.
            let behind = &$data[$self.at($row) - 2..][..$row.extent + 3];
            let n = $row.extent;
            [&behind[..n], &behind[1..1 + n], &behind[2..2 + n], &behind[3..3 + n]]
        } else {
            // A closure would be called.
            [
                $self.row($row.near($axis, -2)),
                $self.row($row.near($axis, -1)),
                $self.row($row),
                $self.row($row.near($axis, 1)),
            ]
        }
    };
}

impl<R: Real, const D: usize> Lines<R, D> for Field<R, D> {
    #[inline(always)]
    fn row(&self, row: Row<D>) -> &[R] {
        self.row(row)
    }

    #[inline(always)]
    fn across(&self, row: Row<D>, axis: usize) -> [&[R]; 4] {
        across!(self, self.data, row, axis)
    }
}

impl<R: Real, const D: usize> Lines<R, D> for Ring<R, D> {
    #[inline(always)]
    fn row(&self, row: Row<D>) -> &[R] {
        self.row(row)
    }

    #[inline(always)]
    fn across(&self, row: Row<D>, axis: usize) -> [&[R]; 4] {
        across!(self, self.field.data, row, axis)
    }
}

/// Does `body` with the cells of rows given with their halos, and makes these periodic:
/// `fill!(layout, \[a = lines, b = others\], kernel(a, b))`. A macro, because closures over arrays of
/// rows are not inlined, and a kernel's row is short.
macro_rules! fill {
    ($layout:expr, [$($name:ident = $line:expr),+ $(,)?], $body:expr) => {{
        $(let $name = $line;)+
        let result = {
            $(let $name = $crate::field::cells_of($name);)+
            $body
        };
        $($layout.wrap($name);)+
        result
    }};
}
pub(crate) use fill;

/// The cells of rows given with their halos.
#[inline(always)]
pub(crate) fn cells_of<R>(line: &mut [R]) -> &mut [R] {
    let end = line.len() - HALO;
    &mut line[HALO..end]
}

impl<const D: usize> From<&Grid<D>> for Layout<D> {
    fn from(grid: &Grid<D>) -> Self {
        Self::new(grid.cells)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn halo_is_periodic<const D: usize>(cells: [usize; D]) {
        let layout = Layout::new(cells);
        let mut q = Field::<f64, D>::zeros(layout);
        let number = |index: [usize; D]| {
            index.iter().rev().zip(cells.iter().rev()).fold(0, |sum, (i, n)| sum * n + i) as f64
        };
        q.set(number);
        for row in 0..layout.rows() {
            for axis in 0..D {
                for shift in [-2, -1, 1, 2] {
                    let shifted = q.row(layout.row(row).near(axis, shift));
                    for (i, &found) in shifted.iter().enumerate() {
                        let mut index = [i; D];
                        let mut rest = row;
                        for a in 1..D {
                            index[a] = rest % cells[a];
                            rest /= cells[a];
                        }
                        index[axis] = (index[axis] as isize + shift)
                            .rem_euclid(cells[axis] as isize)
                            as usize;
                        assert_eq!(found, number(index), "{cells:?} axis {axis} shift {shift}");
                    }
                }
            }
        }
    }

    #[test]
    fn neighbours_across_the_boundary_are_the_periodic_ones() {
        halo_is_periodic([8, 6]);
        halo_is_periodic([2, 2]);
        halo_is_periodic([1, 5]);
        halo_is_periodic([6, 4, 10]);
        halo_is_periodic([3, 1, 2]);
    }
}
