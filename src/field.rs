//! [`Field`]: one number per cell, with a periodic halo; [`Faces`]: one per face of each axis.

use crate::grid::Grid;
use crate::real::Real;

/// Width of the halo in rows and planes: what a limited slope needs beside a face.
const HALO: usize = 2;

/// Elements before and after a row: a halo of two cells, padded so that rows start a multiple of
/// 64 bytes apart and neighbouring rows do not fall into the same cache set.
const PAD: usize = 8;

/// Where the cells of a grid lie in memory: rows along the first axis are contiguous.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout<const D: usize> {
    /// Cells along each axis.
    pub cells: [usize; D],
    /// Distance in memory between neighbours along each axis.
    pub stride: [usize; D],
    /// Offset of the first cell.
    origin: usize,
    /// Length of the memory, halo included.
    len: usize,
}

impl<const D: usize> Layout<D> {
    /// The layout of `cells`.
    pub fn new(cells: [usize; D]) -> Self {
        let mut stride = [1; D];
        let mut origin = PAD;
        let mut len = cells[0].next_multiple_of(PAD) + 2 * PAD;
        for axis in 1..D {
            stride[axis] = len;
            origin += HALO * len;
            len *= cells[axis] + 2 * HALO;
        }
        Self { cells, stride, origin, len }
    }

    /// Number of rows along the first axis.
    pub fn rows(&self) -> usize {
        self.cells[1..].iter().product()
    }

    /// Offset of the first cell of row `row`.
    #[inline]
    pub fn row(&self, mut row: usize) -> usize {
        let mut offset = self.origin;
        for axis in 1..D {
            offset += (row % self.cells[axis]) * self.stride[axis];
            row /= self.cells[axis];
        }
        offset
    }

    /// Copies the last and first cells of a row into its halo.
    #[inline]
    pub(crate) fn wrap_row<R: Copy>(row: &mut [R]) {
        // `row` begins and ends with the halo.
        let n = row.len() - 2 * HALO;
        for i in 0..HALO {
            row[HALO - 1 - i] = row[HALO + n - 1 - i % n];
            row[HALO + n + i] = row[HALO + i % n];
        }
    }

    /// The span of a row with its halo.
    #[inline]
    pub(crate) fn row_with_halo(&self, offset: usize) -> std::ops::Range<usize> {
        offset - HALO..offset + self.cells[0] + HALO
    }
}

/// One number per cell of a periodic grid.
#[derive(Clone, Debug)]
pub struct Field<R, const D: usize> {
    pub(crate) layout: Layout<D>,
    pub(crate) data: Vec<R>,
}

/// One number per face: component `a` holds, for each cell, its lower face along axis `a`.
pub type Faces<R, const D: usize> = [Field<R, D>; D];

impl<R: Real, const D: usize> Field<R, D> {
    /// A field of zeros.
    pub fn zeros(layout: Layout<D>) -> Self {
        Self { layout, data: vec![R::ZERO; layout.len] }
    }

    /// Faces of zeros.
    pub fn zero_faces(layout: Layout<D>) -> Faces<R, D> {
        std::array::from_fn(|_| Self::zeros(layout))
    }

    /// As many cells as a row has, from `offset` on: a row, or a row seen from its neighbours when
    /// `offset` is shifted by a stride.
    #[inline(always)]
    pub fn row(&self, offset: usize) -> &[R] {
        &self.data[offset..offset + self.layout.cells[0]]
    }

    /// A row, to be written; [`Field::wrap`] must follow before neighbours are read.
    pub fn row_mut(&mut self, offset: usize) -> &mut [R] {
        &mut self.data[offset..offset + self.layout.cells[0]]
    }

    /// The rows, in order.
    pub fn interior(&self) -> impl Iterator<Item = &[R]> {
        (0..self.layout.rows()).map(|row| self.row(self.layout.row(row)))
    }

    /// Sets every cell from its index.
    pub fn set(&mut self, mut value: impl FnMut([usize; D]) -> R) {
        let cells = self.layout.cells;
        for row in 0..self.layout.rows() {
            let mut index = [0; D];
            let mut rest = row;
            for axis in 1..D {
                index[axis] = rest % cells[axis];
                rest /= cells[axis];
            }
            let offset = self.layout.row(row);
            for i in 0..cells[0] {
                index[0] = i;
                self.data[offset + i] = value(index);
            }
        }
        self.wrap();
    }

    /// Fills the whole halo from the interior.
    pub fn wrap(&mut self) {
        for row in 0..self.layout.rows() {
            let span = self.layout.row_with_halo(self.layout.row(row));
            Layout::<D>::wrap_row(&mut self.data[span]);
        }
        self.wrap_rows();
    }

    /// Fills the halo rows (and planes) from rows whose own ends are already wrapped.
    pub(crate) fn wrap_rows(&mut self) {
        let Layout { cells, stride, .. } = self.layout;
        for axis in 1..D {
            // Each block holds the whole extent of the lower axes and `cells + 2 halo` layers.
            let layer = stride[axis];
            let block = layer * (cells[axis] + 2 * HALO);
            for data in self.data.chunks_exact_mut(block) {
                let n = cells[axis];
                for i in 0..HALO {
                    let from = HALO + n - 1 - i % n;
                    data.copy_within(from * layer..(from + 1) * layer, (HALO - 1 - i) * layer);
                    let from = HALO + i % n;
                    data.copy_within(from * layer..(from + 1) * layer, (HALO + n + i) * layer);
                }
            }
        }
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
        let first = self.data[self.layout.origin];
        self.interior().flatten().fold(first, |m, &q| m.min(q))
    }

    /// Largest value of the cells.
    pub fn max(&self) -> R {
        let first = self.data[self.layout.origin];
        self.interior().flatten().fold(first, |m, &q| m.max(q))
    }
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
                for shift in [-2i64, -1, 1, 2] {
                    let offset = layout.row(row) as i64 + shift * layout.stride[axis] as i64;
                    let shifted = q.row(offset as usize);
                    for (i, &found) in shifted.iter().enumerate() {
                        let mut index = [i; D];
                        let mut rest = row;
                        for a in 1..D {
                            index[a] = rest % cells[a];
                            rest /= cells[a];
                        }
                        index[axis] =
                            (index[axis] as i64 + shift).rem_euclid(cells[axis] as i64) as usize;
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
