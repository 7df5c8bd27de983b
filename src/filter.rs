//! [`BoxFilter`]: the box filter, q̄(x) = (1/V) ∫_V q dV, for any number of widths at once.
//!
//! The box is periodic and separable. A box whose width is a multiple of a narrower one's is the
//! mean of the narrower boxes that tile it, so each width starts from the widest width that
//! divides it and adds along each axis by doubling: m boxes in log₂ m passes, not m. The cost of a
//! width is therefore a few additions per cell, whatever the width. Sums are never updated by
//! subtraction: a positive field stays positive, and no round-off travels along a row.

use crate::grid::Grid;

/// A filter width that the grid cannot take.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FilterError {
    /// The width is not a whole number of cells.
    #[error(
        "filter.widths: {width} m is {cells} cells along axis {axis}, not a whole number; \
         the cell edge is {spacing} m, so {} m would do",
        spacing * cells.round().max(1.0)
    )]
    NotWhole {
        /// The width \[m\].
        width: f64,
        /// The axis that it does not fit.
        axis: usize,
        /// Cell edge along that axis \[m\].
        spacing: f64,
        /// Width over cell edge.
        cells: f64,
    },
    /// A kernel that reaches everywhere, in a box with walls.
    #[error(
        "filter.kernel: a {kernel} filter needs a box that is periodic along every axis, and this \
         one is not along axis {axis}; take the box kernel"
    )]
    Walls {
        /// The kernel.
        kernel: &'static str,
        /// The first axis with walls.
        axis: usize,
    },
    /// The box filter would overlap its own periodic image, or is empty.
    #[error(
        "filter.widths: a filter of {width} cells along axis {axis} does not fit the box of \
         {cells} cells; take 1 to {cells} cells"
    )]
    OutOfBox {
        /// The width in cells.
        width: usize,
        /// The axis along which it does not fit.
        axis: usize,
        /// Cells of the box along that axis.
        cells: usize,
    },
}

/// Cells along each axis in a box filter of edge `width` \[m\] on `grid`.
///
/// # Errors
/// [`FilterError::NotWhole`] if an edge is not a whole number of cells (to 1e-6 of a cell),
/// [`FilterError::OutOfBox`] if it is none or more than the box has.
pub fn width_in_cells<const D: usize>(
    grid: &Grid<D>,
    width: f64,
) -> Result<[usize; D], FilterError> {
    let mut widths = [0; D];
    for (axis, (&spacing, in_cells)) in grid.spacing.iter().zip(&mut widths).enumerate() {
        let cells = width / spacing;
        // Written so that NaN is refused too.
        if !((cells - cells.round()).abs() < 1e-6 && cells > -0.5) {
            return Err(FilterError::NotWhole { width, axis, spacing, cells });
        }
        *in_cells = cells.round() as usize;
    }
    fits(&grid.cells, &widths)?;
    Ok(widths)
}

/// Whether a filter of `width` cells is not empty and not wider than the box.
pub(crate) fn fits<const D: usize>(
    cells: &[usize; D],
    width: &[usize; D],
) -> Result<(), FilterError> {
    for axis in 0..D {
        if width[axis] == 0 || width[axis] > cells[axis] {
            let (width, cells) = (width[axis], cells[axis]);
            return Err(FilterError::OutOfBox { width, axis, cells });
        }
    }
    Ok(())
}

/// Box filters of several widths on one periodic grid.
///
/// The filter of width w at cell i covers the cells i - ⌊(w-1)/2⌋ ..= i + ⌊w/2⌋ along each axis:
/// centred on the cell for odd w, on its upper face for even w.
#[derive(Clone, Debug)]
pub struct BoxFilter<const D: usize> {
    cells: [usize; D],
    /// Widths in the order in which they are computed: a width follows the one it is made of.
    steps: Vec<Step<D>>,
    scratch: [Vec<f64>; 3],
}

/// How one width is made.
#[derive(Clone, Debug)]
struct Step<const D: usize> {
    /// Place of the result among the outputs.
    output: usize,
    /// Cells along each axis.
    width: [usize; D],
    /// Place among the outputs, and width, of the narrower boxes; none for the field itself.
    parent: Option<(usize, [usize; D])>,
}

impl<const D: usize> BoxFilter<D> {
    /// Filters of `widths` cells along each axis, in any order, on a grid of `cells` cells.
    ///
    /// # Errors
    /// [`FilterError::OutOfBox`] if a width is zero or exceeds the box.
    pub fn new(cells: [usize; D], widths: &[[usize; D]]) -> Result<Self, FilterError> {
        for width in widths {
            fits(&cells, width)?;
        }
        let mut order: Vec<usize> = (0..widths.len()).collect();
        order.sort_by_key(|&k| widths[k].iter().product::<usize>());
        let mut steps: Vec<Step<D>> = Vec::with_capacity(widths.len());
        for output in order {
            let width = widths[output];
            // Earlier steps are narrower and ascend: the last that divides this width is widest.
            let parent = steps
                .iter()
                .rev()
                .find(|step| (0..D).all(|axis| width[axis].is_multiple_of(step.width[axis])))
                .map(|step| (step.output, step.width));
            steps.push(Step { output, width, parent });
        }
        let len = cells.iter().product();
        Ok(Self { cells, steps, scratch: std::array::from_fn(|_| vec![0.0; len]) })
    }

    /// Zeroed outputs for [`filter`](Self::filter): one field per width.
    pub fn outputs(&self) -> Vec<Vec<f64>> {
        vec![vec![0.0; self.cells.iter().product()]; self.steps.len()]
    }

    /// Filters `field`: `outputs[k]` becomes its mean over the box of the k-th width. Allocates
    /// nothing. A width of one cell returns the field bit for bit.
    ///
    /// # Panics
    /// If `field` or an output has not one number per cell, or there is not one output per width.
    pub fn filter(&mut self, field: &[f64], outputs: &mut [Vec<f64>]) {
        assert_eq!(outputs.len(), self.steps.len(), "one output per filter width");
        for step in &self.steps {
            // The output leaves its place while it is written, so that its parent can be read.
            let mut output = std::mem::take(&mut outputs[step.output]);
            let (source, from) = match step.parent {
                Some((place, width)) => (outputs[place].as_slice(), width),
                None => (field, [1; D]),
            };
            widen(&self.cells, source, from, step.width, &mut self.scratch, &mut output);
            outputs[step.output] = output;
        }
    }
}

/// Means over boxes of `to` cells from `source`, the means over boxes of `from` cells, where `from`
/// divides `to` along each axis.
fn widen<const D: usize>(
    cells: &[usize; D],
    source: &[f64],
    from: [usize; D],
    to: [usize; D],
    scratch: &mut [Vec<f64>; 3],
    output: &mut [f64],
) {
    let taps: [usize; D] = std::array::from_fn(|axis| to[axis] / from[axis]);
    let mut passes_left: u32 = taps.iter().map(|m| m.ilog2() + m.count_ones() - 1).sum();
    if passes_left == 0 {
        output.copy_from_slice(source);
        return;
    }
    let mean = 1.0 / taps.iter().product::<usize>() as f64;
    let [base, current, next] = scratch;
    let mut untouched = true;
    let mut stride = 1;
    for axis in 0..D {
        let block = stride * cells[axis];
        // Narrow box number 0 of the wide box at i lies this far from i, counted upwards.
        let first = (block - ((to[axis] - 1) / 2 - (from[axis] - 1) / 2) * stride) % block;
        let mut count = 1;
        // From the second highest bit of the number of boxes to the lowest: double what has been
        // added so far, and add one more box where the bit is set.
        for bit in (0..taps[axis].ilog2()).rev() {
            for one_more in [false, true] {
                if one_more && taps[axis] >> bit & 1 == 0 {
                    continue;
                }
                let origin: &[f64] = if untouched { source } else { base.as_slice() };
                let (left, left_shift) = if count == 1 { (origin, first) } else { (&**current, 0) };
                let (right, right_shift) = if one_more {
                    (origin, (first + count * from[axis] * stride) % block)
                } else {
                    (left, (left_shift + count * from[axis] * stride) % block)
                };
                passes_left -= 1;
                if passes_left == 0 {
                    add_shifted(block, (left, left_shift), (right, right_shift), mean, output);
                } else {
                    add_shifted(block, (left, left_shift), (right, right_shift), 1.0, next);
                    std::mem::swap(current, next);
                }
                count += if one_more { 1 } else { count };
            }
        }
        if count > 1 {
            std::mem::swap(base, current);
            untouched = false;
        }
        stride = block;
    }
}

/// `out[k] = factor (left[k + l] + right[k + r])`, periodic within each run of `block` numbers,
/// with shifts l, r < `block`. Shifting whole rows is shifting by a multiple of the row's length,
/// so that this one loop serves every axis, on contiguous numbers.
fn add_shifted(
    block: usize,
    (left, left_shift): (&[f64], usize),
    (right, right_shift): (&[f64], usize),
    factor: f64,
    out: &mut [f64],
) {
    let runs = left.chunks_exact(block).zip(right.chunks_exact(block));
    for (out, (left, right)) in out.chunks_exact_mut(block).zip(runs) {
        let mut start = 0;
        while start < block {
            let l = (start + left_shift) % block;
            let r = (start + right_shift) % block;
            let len = block - start.max(l).max(r);
            let sides = left[l..l + len].iter().zip(&right[r..r + len]);
            for (out, (&left, &right)) in out[start..start + len].iter_mut().zip(sides) {
                *out = factor * (left + right);
            }
            start += len;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    fn random_field(len: usize, seed: u64) -> Vec<f64> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        (0..len).map(|_| random.random::<f64>() - 0.3).collect()
    }

    fn filtered<const D: usize>(
        cells: [usize; D],
        widths: &[[usize; D]],
        field: &[f64],
    ) -> Vec<Vec<f64>> {
        let mut filter = BoxFilter::new(cells, widths).unwrap();
        let mut outputs = filter.outputs();
        filter.filter(field, &mut outputs);
        outputs
    }

    fn index<const D: usize>(cells: [usize; D], place: [usize; D]) -> usize {
        (0..D).rev().fold(0, |sum, axis| sum * cells[axis] + place[axis] % cells[axis])
    }

    fn place<const D: usize>(cells: [usize; D], mut index: usize) -> [usize; D] {
        std::array::from_fn(|axis| {
            let here = index % cells[axis];
            index /= cells[axis];
            here
        })
    }

    /// The mean over the box of `width` around each cell, from the definition.
    fn brute<const D: usize>(cells: [usize; D], width: [usize; D], field: &[f64]) -> Vec<f64> {
        let volume: usize = width.iter().product();
        (0..field.len())
            .map(|i| {
                let here = place(cells, i);
                let sum: f64 = (0..volume)
                    .map(|k| {
                        let step = place(width, k);
                        field[index(
                            cells,
                            std::array::from_fn(|axis| {
                                here[axis] + cells[axis] - (width[axis] - 1) / 2 + step[axis]
                            }),
                        )]
                    })
                    .sum();
                sum / volume as f64
            })
            .collect()
    }

    fn check<const D: usize>(cells: [usize; D], widths: &[[usize; D]], shift: usize, seed: u64) {
        let field = random_field(cells.iter().product(), seed);
        let found = filtered(cells, widths, &field);
        let moved: Vec<f64> = (0..field.len())
            .map(|i| field[index(cells, place(cells, i).map(|p| p + shift))])
            .collect();
        let found_moved = filtered(cells, widths, &moved);
        let mean = field.iter().sum::<f64>() / field.len() as f64;
        for (k, &width) in widths.iter().enumerate() {
            for (i, (found, exact)) in found[k].iter().zip(brute(cells, width, &field)).enumerate()
            {
                assert!((found - exact).abs() < 1e-14, "{width:?} at {i}: {found} {exact}");
            }
            for (i, &here) in found_moved[k].iter().enumerate() {
                assert_eq!(here, found[k][index(cells, place(cells, i).map(|p| p + shift))]);
            }
            let filtered_mean = found[k].iter().sum::<f64>() / field.len() as f64;
            assert!((filtered_mean - mean).abs() < 1e-14);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn two_dimensions_agree_with_the_definition(
            nx in 1usize..20, ny in 1usize..20, a in 1usize..20, b in 1usize..20, c in 1usize..7,
            shift in 0usize..9, seed: u64,
        ) {
            let one = [a.min(nx), b.min(ny)];
            let two = [c.min(nx), c.min(ny)];
            let three = [nx / two[0] * two[0], ny / two[1] * two[1]];
            check([nx, ny], &[one, three, two], shift, seed);
        }

        #[test]
        fn three_dimensions_agree_with_the_definition(
            nx in 1usize..8, ny in 1usize..8, nz in 1usize..8, w in 1usize..5, v in 1usize..9,
            shift in 0usize..5, seed: u64,
        ) {
            let one = [w.min(nx), w.min(ny), w.min(nz)];
            let two = [v.min(nx), one[1], v.min(nz)];
            check([nx, ny, nz], &[one, two, [nx, ny, nz]], shift, seed);
        }
    }

    #[test]
    fn one_cell_returns_the_field_bit_for_bit() {
        let field = random_field(7 * 5 * 3, 1);
        assert_eq!(filtered([7, 5, 3], &[[1; 3]], &field)[0], field);
    }

    #[test]
    fn a_constant_and_a_sign_survive_every_width() {
        let widths: Vec<[usize; 2]> = (1..=24).map(|w| [w, w]).collect();
        for output in filtered([24, 30], &widths, &[0.15; 24 * 30]) {
            assert!(output.iter().all(|q| (q / 0.15 - 1.0).abs() < 1e-15));
        }
        // A subtractive running sum would leave round-off of 1e300 behind the peak.
        let mut peak = vec![1e-300; 24 * 30];
        peak[100] = 1e300;
        for output in filtered([24, 30], &widths, &peak) {
            assert!(output.iter().all(|&q| q > 0.0));
        }
    }

    #[test]
    fn a_linear_field_is_returned_at_the_middle_of_the_box() {
        let cells = [32, 20];
        let field: Vec<f64> = (0..640).map(|i| (i % 32) as f64 + 0.5 * (i / 32) as f64).collect();
        let widths = [[4, 4], [5, 3], [8, 12]];
        for (output, [w, v]) in filtered(cells, &widths, &field).iter().zip(widths) {
            let middle =
                |x: usize, w: usize| x as f64 + if w.is_multiple_of(2) { 0.5 } else { 0.0 };
            for y in (v - 1) / 2..20 - v / 2 {
                for x in (w - 1) / 2..32 - w / 2 {
                    let exact = middle(x, w) + 0.5 * middle(y, v);
                    assert!((output[x + 32 * y] - exact).abs() < 1e-13);
                }
            }
        }
    }

    #[test]
    fn widths_that_do_not_fit_are_refused() {
        let grid = Grid::new([0.16, 0.32], [128, 128]);
        assert_eq!(width_in_cells(&grid, 0.01), Ok([8, 4]));
        assert_eq!(width_in_cells(&grid, 0.16), Ok([128, 64]));
        let error = width_in_cells(&grid, 0.005 / 4.0).unwrap_err();
        assert!(matches!(error, FilterError::NotWhole { axis: 1, .. }), "{error}");
        assert!(error.to_string().contains("0.0025 m would do"), "{error}");
        for width in [0.0, 0.32] {
            let error = width_in_cells(&grid, width).unwrap_err();
            assert!(matches!(error, FilterError::OutOfBox { axis: 0, .. }), "{error}");
        }
        for width in [f64::NAN, -0.01] {
            assert!(matches!(width_in_cells(&grid, width), Err(FilterError::NotWhole { .. })));
        }
        assert!(BoxFilter::new([8, 8], &[[4, 4], [9, 4]]).is_err());
    }
}
