//! [`Resolved`]: resolved fields of one instant, from anyone's files, checked; and the same to disk.
//!
//! Files ([`numpy`], [`vtk`], [`openfoam`], [`particles`]) give named arrays on a [`Lattice`] of equal
//! cells along x, y and z; a [`map`] says which of them are what; the [`StoredFields`] of a
//! [`Resolved`] have the axes of the crate, the vertical one last, and SI units. [`series`] does this
//! for many files in the order of time. [`write`](mod@write) writes what the filter was given in flight, in double precision, so
//! that bins from disk are those of the flight.

pub mod hdf;
pub mod map;
pub mod numpy;
pub mod openfoam;
pub mod particles;
pub mod series;
pub mod start;
pub mod vtk;
pub mod write;
pub mod xml;

use crate::stored::StoredFields;
use std::io;
use std::path::{Path, PathBuf};

/// Numbers per cell, one list for each component.
pub type Columns = Vec<Vec<f64>>;

/// Why fields cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum ResolvedError {
    /// A file or folder cannot be read.
    #[error("cannot read {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file is not what its name says, or holds what is not read.
    #[error("{path}: {why}", path = path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong and what would be accepted.
        why: String,
    },
    /// An array as a whole is not acceptable.
    #[error("{path}: array {array}: {why}", path = path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// The array, or the formula of arrays.
        array: String,
        /// What is wrong and what would be accepted.
        why: String,
    },
    /// One value of an array is not acceptable.
    #[error("{path}: array {array}: {value} in cell {cell:?}, counted from 0 along x, y, z: {why}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The array, or the formula of arrays.
        array: String,
        /// The cell along x, y and z.
        cell: [usize; 3],
        /// The value.
        value: f64,
        /// What is wrong and what would be accepted.
        why: String,
    },
    /// The map cannot be used.
    #[error("{place}: {why}")]
    Map {
        /// The map, and what in it.
        place: String,
        /// What is wrong and what would be accepted.
        why: String,
    },
    /// Files do not belong together.
    #[error("{path} and {other}: {why}", path = path.display(), other = other.display())]
    Pair {
        /// One file.
        path: PathBuf,
        /// The other.
        other: PathBuf,
        /// Why not, and what would be accepted.
        why: String,
    },
}

impl ResolvedError {
    pub(crate) fn read(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        |source| Self::Read { path: path.to_owned(), source }
    }

    pub(crate) fn format(path: &Path, why: impl Into<String>) -> Self {
        Self::Format { path: path.to_owned(), why: why.into() }
    }

    pub(crate) fn array(path: &Path, array: &str, why: impl Into<String>) -> Self {
        Self::Array { path: path.to_owned(), array: array.to_owned(), why: why.into() }
    }
}

/// A box of equal cells along x, y and z; a box of one cell along an axis is flat there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Cells along each axis.
    pub cells: [usize; 3],
    /// Edges of a cell, in the file's unit.
    pub spacing: [f64; 3],
    /// Lower corner of the box, in the file's unit.
    pub origin: [f64; 3],
}

impl Lattice {
    /// Cells in all.
    pub fn len(&self) -> usize {
        self.cells.iter().product()
    }

    /// Whether it has no cell.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The cell number `n`, x fastest, along each axis.
    pub fn cell(&self, n: usize) -> [usize; 3] {
        let [x, y, _] = self.cells;
        [n % x, n / x % y, n / (x * y)]
    }

    /// The lattice of cells given by their lower and upper corners, and each one's number on it, x
    /// fastest.
    ///
    /// # Errors
    /// The cells are not equal boxes that fill a box, each place once; the message says which cell.
    pub fn of_boxes(boxes: &[[[f64; 3]; 2]]) -> Result<(Self, Vec<usize>), String> {
        let Some([low, high]) = boxes.first() else { return Err("there is no cell".into()) };
        let size: [f64; 3] = std::array::from_fn(|axis| high[axis] - low[axis]);
        let mut bounds = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        for (n, [low, high]) in boxes.iter().enumerate() {
            for axis in 0..3 {
                let edge = high[axis] - low[axis];
                let longest = size.into_iter().fold(0.0, f64::max);
                // Corners may be single precision.
                if (edge - size[axis]).abs() > 1e-3 * longest || !edge.is_finite() {
                    return Err(format!(
                        "cell {n} has an edge of {edge} and cell 0 of {} along {}: fields on \
                         cells of equal size are accepted; resample to a uniform grid first",
                        size[axis], AXES[axis]
                    ));
                }
                bounds[0][axis] = bounds[0][axis].min(low[axis]);
                bounds[1][axis] = bounds[1][axis].max(high[axis]);
            }
        }
        let mut cells = [1; 3];
        for axis in 0..3 {
            let span = bounds[1][axis] - bounds[0][axis];
            if span > 0.0 {
                let count = (span / size[axis]).round();
                if !(count >= 1.0 && count <= boxes.len() as f64) {
                    return Err(format!(
                        "{} cells do not fill a box of {count} layers along {}",
                        boxes.len(),
                        AXES[axis]
                    ));
                }
                cells[axis] = count as usize;
            }
        }
        let lattice = Self {
            cells,
            spacing: std::array::from_fn(|axis| {
                let span = bounds[1][axis] - bounds[0][axis];
                if span > 0.0 { span / cells[axis] as f64 } else { 1.0 }
            }),
            origin: bounds[0],
        };
        if cells.iter().try_fold(1usize, |n, count| n.checked_mul(*count)) != Some(boxes.len()) {
            return Err(format!(
                "{} cells do not fill their box of {} x {} x {}: fields of a whole box are \
                 accepted",
                boxes.len(),
                cells[0],
                cells[1],
                cells[2]
            ));
        }
        let mut taken = vec![false; boxes.len()];
        let mut numbers = Vec::with_capacity(boxes.len());
        for (n, [low, _]) in boxes.iter().enumerate() {
            let mut place = [0; 3];
            for axis in 0..3 {
                let at = (low[axis] - lattice.origin[axis]) / lattice.spacing[axis];
                if (at - at.round()).abs() > 0.05 {
                    return Err(format!(
                        "cell {n} begins at {} along {}, between two layers of cells of {}: \
                         fields on a uniform grid are accepted",
                        low[axis], AXES[axis], lattice.spacing[axis]
                    ));
                }
                place[axis] = (at.round() as usize).min(cells[axis] - 1);
            }
            let number = place[0] + cells[0] * (place[1] + cells[1] * place[2]);
            if std::mem::replace(&mut taken[number], true) {
                return Err(format!("cell {n} lies where another cell lies, at {place:?}"));
            }
            numbers.push(number);
        }
        Ok((lattice, numbers))
    }
}

/// Names of the axes.
pub const AXES: [&str; 3] = ["x", "y", "z"];

/// An array of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Its name.
    pub name: String,
    /// Its components, in each cell of the lattice, x fastest.
    pub columns: Columns,
    /// Exponents of kg, m, s, K, mol, A and cd, where the file gives them.
    pub dimensions: Option<[f64; 7]>,
}

/// What one file, or one folder of an instant, holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Piece {
    /// The file or folder.
    pub path: PathBuf,
    /// Its time, in the file's unit.
    pub time: Option<f64>,
    /// Its cells; none where the file does not tell sizes.
    pub lattice: Option<Lattice>,
    /// Whether `lattice` has sizes, or only the number of cells.
    pub sized: bool,
    /// Along which axes the box repeats itself, where the file tells.
    pub periodic: Option<[bool; 3]>,
    /// The vertical axis, 0 to 2, where the file tells.
    pub vertical: Option<usize>,
    /// Gravity along x, y, z, where the file tells.
    pub gravity: Option<[f64; 3]>,
    /// Its arrays that were asked for.
    pub arrays: Vec<Array>,
    /// What else it holds, each with what hinders its use, if anything does.
    pub others: Vec<(String, Option<&'static str>)>,
    /// The text of the case that made it, if Favre did.
    pub case: Option<String>,
    /// Means of the box at this instant and at its start, if Favre wrote them.
    pub signals: Option<[[f64; 4]; 2]>,
    /// Particles instead of cells: each column of `arrays` has one entry per particle.
    pub particles: bool,
}

/// Why an array at corners is refused.
pub(crate) const POINT_DATA: &str = "it is point data, given at the corners of cells, and cell \
    data are needed: write cell data, or convert with a filter such as ParaView's Point Data to \
    Cell Data";

/// The numbers in `bytes` of the type `code`, f, i or u and a number's bytes; none of another type.
pub(crate) fn decode(
    code: &str,
    big_endian: bool,
    bytes: &[u8],
) -> Option<Result<Vec<f64>, String>> {
    macro_rules! read {
        ($type:ty) => {{
            let value = |number: &[u8]| {
                let mut array = [0; size_of::<$type>()];
                array.copy_from_slice(number);
                match big_endian {
                    true => <$type>::from_be_bytes(array) as f64,
                    false => <$type>::from_le_bytes(array) as f64,
                }
            };
            let numbers = bytes.chunks_exact(size_of::<$type>());
            match numbers.remainder() {
                [] => Ok(numbers.map(value).collect()),
                _ => Err(format!("{} bytes are no whole number of {code}", bytes.len())),
            }
        }};
    }
    Some(match code {
        "f8" => read!(f64),
        "f4" => read!(f32),
        "i1" => read!(i8),
        "i2" => read!(i16),
        "i4" => read!(i32),
        "i8" => read!(i64),
        "u1" => read!(u8),
        "u2" => read!(u16),
        "u4" => read!(u32),
        "u8" => read!(u64),
        _ => return None,
    })
}

/// Resolved fields of one instant, and what their files say besides.
#[derive(Clone, Debug, PartialEq)]
pub struct Resolved {
    /// Where they come from.
    pub path: PathBuf,
    /// The fields.
    pub fields: StoredFields,
    /// The text of the case that made them, if Favre did.
    pub case: Option<String>,
    /// Mean slip, slip seen by the particles and variance of φ at this instant and at the start of
    /// the simulation, if Favre wrote them.
    pub signals: Option<[[f64; 4]; 2]>,
}

impl Resolved {
    /// The volume mean of φ.
    pub fn mean_solids_fraction(&self) -> f64 {
        let fraction = &self.fields.solids_fraction;
        fraction.iter().sum::<f64>() / fraction.len() as f64
    }
}
