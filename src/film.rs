//! [`Film`]: a few small pictures of a box on its way, the solids fraction as it is and as a filter sees
//! it.
//!
//! Taken at every so many samples; once there are many, every other one is dropped and every other one is
//! taken from then on. What is kept depends on the number of samples alone: a run of any length has a
//! film of the same size, and one that was interrupted or prolonged the same film as one that was not.

use crate::grid::Grid;

/// Most frames that are kept.
const MOST: usize = 16;

/// Most cells of a frame along either axis: larger boxes are shown by means over blocks of cells.
const FINEST: usize = 96;

/// Two pictures of one instant, in the plane of the first and the last axis, in the middle of the others;
/// first axis fastest, from the bottom.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Number of the sample.
    pub sample: u64,
    /// Time \[s\].
    pub time: f64,
    /// Solids fraction.
    pub fraction: Vec<f64>,
    /// Filtered solids fraction.
    pub filtered: Vec<f64>,
}

/// The film of a box.
#[derive(Clone, Debug, PartialEq)]
pub struct Film {
    /// Width of the filter \[m\].
    pub filter_width: f64,
    /// Picture elements of a frame along the first and the last axis.
    pub shape: [usize; 2],
    /// Samples from one frame to the next.
    pub stride: u64,
    /// The frames.
    pub frames: Vec<Frame>,
}

/// Cells that make one picture element along an axis.
fn coarseness<const D: usize>(grid: &Grid<D>) -> usize {
    grid.cells[0].max(grid.cells[D - 1]).div_ceil(FINEST)
}

impl Film {
    /// An empty film of a box on `grid`.
    pub fn new<const D: usize>(grid: &Grid<D>, filter_width: f64) -> Self {
        let block = coarseness(grid);
        let shape = [0, D - 1].map(|axis| grid.cells[axis].div_ceil(block));
        Self { filter_width, shape, stride: 1, frames: Vec::new() }
    }

    /// Whether sample number `sample` is taken.
    pub fn is_due(&self, sample: u64) -> bool {
        sample.is_multiple_of(self.stride)
    }

    /// Takes sample number `sample` at `time` \[s\]: the solids fraction `fraction` of the cells, and
    /// `filtered`, that of the filter whose middle is nearest to a place, given in cells.
    ///
    /// # Panics
    /// If the field is not on `grid`, or the grid not that of the film.
    pub fn take<const D: usize>(
        &mut self,
        sample: u64,
        time: f64,
        grid: &Grid<D>,
        fraction: &[f64],
        filtered: impl Fn([f64; D]) -> f64,
    ) {
        assert_eq!(fraction.len(), grid.cells.iter().product::<usize>(), "cells of the field");
        let block = coarseness(grid);
        let [columns, rows] = self.shape;
        let layer: usize = grid.cells[..D - 1].iter().product();
        let plane = layer / grid.cells[0] / 2 * grid.cells[0];
        // Cells of an element, the last one of a row perhaps fewer.
        let cells = |element: usize, axis: usize| {
            element * block..((element + 1) * block).min(grid.cells[axis])
        };
        let middle = |range: std::ops::Range<usize>| 0.5 * (range.start + range.end - 1) as f64;
        let mut frame = Frame { sample, time, fraction: Vec::new(), filtered: Vec::new() };
        for row in 0..rows {
            for column in 0..columns {
                let (across, up) = (cells(column, 0), cells(row, D - 1));
                let count = (across.len() * up.len()) as f64;
                let all = up.clone().flat_map(|k| {
                    let row = &fraction[k * layer + plane..][..grid.cells[0]];
                    &row[across.clone()]
                });
                frame.fraction.push(all.sum::<f64>() / count);
                let mut place = grid.cells.map(|n| (n / 2) as f64);
                (place[0], place[D - 1]) = (middle(across), middle(up));
                frame.filtered.push(filtered(place));
            }
        }
        self.frames.push(frame);
        if self.frames.len() > MOST {
            self.stride *= 2;
            self.frames.retain(|frame| frame.sample.is_multiple_of(self.stride));
        }
    }

    /// `count` frames or fewer from `start` \[s\] on, evenly spaced in their order; of a film that ends
    /// before, the last.
    pub fn strip(&self, start: f64, count: usize) -> Vec<&Frame> {
        let from = self.frames.partition_point(|frame| frame.time < start);
        let from = from.min(self.frames.len().saturating_sub(1));
        let frames = &self.frames[from..];
        let count = count.min(frames.len());
        let place = |k: usize| (k * (frames.len() - 1)).checked_div(count - 1).unwrap_or(0);
        (0..count).map(|k| &frames[place(k)]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(samples: u64) -> Film {
        let grid = Grid::new([1.0, 2.0], [2, 4]);
        let mut film = Film::new(&grid, 0.5);
        for sample in 1..=samples {
            if film.is_due(sample) {
                let field = [sample as f64; 8];
                film.take(sample, 0.1 * sample as f64, &grid, &field, |place| place[1]);
            }
        }
        film
    }

    #[test]
    fn a_film_of_any_length_is_short_and_evenly_spaced() {
        for samples in [1, 5, 16, 17, 100, 1000, 4321] {
            let film = taken(samples);
            let expected: Vec<u64> = (1..=samples / film.stride).map(|k| k * film.stride).collect();
            let found: Vec<u64> = film.frames.iter().map(|frame| frame.sample).collect();
            assert_eq!(found, expected);
            assert!(found.len() <= MOST && (samples < 8 || found.len() >= MOST / 2), "{found:?}");
        }
    }

    #[test]
    fn strips_begin_where_they_are_asked_to() {
        let film = taken(16);
        let samples = |start, count| -> Vec<u64> {
            film.strip(start, count).iter().map(|frame| frame.sample).collect()
        };
        assert_eq!(samples(0.0, 4), [1, 6, 11, 16]);
        assert_eq!(samples(0.75, 3), [8, 12, 16]);
        assert_eq!(samples(1.45, 5), [15, 16]);
        assert_eq!(samples(9.0, 5), [16]);
        assert_eq!(samples(0.0, 1), [1]);
        assert!(taken(0).strip(0.0, 3).is_empty());
    }

    #[test]
    fn frames_are_the_middle_plane_in_blocks() {
        let grid = Grid::new([1.0; 3], [2, 4, 3]);
        let field: Vec<f64> = (0..24).map(f64::from).collect();
        let mut film = Film::new(&grid, 0.5);
        film.take(1, 0.0, &grid, &field, |[x, y, z]| x + 10.0 * y + 100.0 * z);
        assert_eq!(film.shape, [2, 3]);
        assert_eq!(film.frames[0].fraction, [4.0, 5.0, 12.0, 13.0, 20.0, 21.0]);
        assert_eq!(film.frames[0].filtered, [20.0, 21.0, 120.0, 121.0, 220.0, 221.0]);
        // 97 cells are more than a frame has elements: two by two, and one at the end.
        let grid = Grid::new([1.0; 2], [2, 97]);
        let field: Vec<f64> = (0..194).map(f64::from).collect();
        let mut film = Film::new(&grid, 0.5);
        film.take(1, 0.0, &grid, &field, |[_, y]| y);
        assert_eq!(film.shape, [1, 49]);
        assert_eq!(film.frames[0].fraction[..2], [1.5, 5.5]);
        assert_eq!(film.frames[0].fraction[48], 192.5);
        assert_eq!(film.frames[0].filtered[47..], [94.5, 96.0]);
    }
}
