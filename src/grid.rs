//! [`Grid`]: a periodic box cut into equal cells.

/// A periodic box of `D` dimensions cut into equal cells. The last axis is vertical, up is
/// positive; gravity points down it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid<const D: usize> {
    /// Number of cells along each axis.
    pub cells: [usize; D],
    /// Cell edge along each axis \[m\].
    pub spacing: [f64; D],
}

impl<const D: usize> Grid<D> {
    /// A box of edge lengths `size` \[m\] with `cells` cells along each axis.
    pub fn new(size: [f64; D], cells: [usize; D]) -> Self {
        Self { cells, spacing: std::array::from_fn(|axis| size[axis] / cells[axis] as f64) }
    }

    /// Number of cells in the box.
    pub fn len(&self) -> usize {
        self.cells.iter().product()
    }

    /// Whether the box has no cell.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Edge lengths of the box \[m\].
    pub fn size(&self) -> [f64; D] {
        std::array::from_fn(|axis| self.cells[axis] as f64 * self.spacing[axis])
    }

    /// Area (2-D: length, of a slice one metre deep) or volume of one cell \[m^D\].
    pub fn cell_volume(&self) -> f64 {
        self.spacing.iter().product()
    }
}
