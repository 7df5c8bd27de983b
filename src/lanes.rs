//! [`Lanes`]: eight numbers that go through a formula together, and [`Number`], what a formula needs
//! of a number, so that it stands once for one of them and for eight.
//!
//! A loop over dozens of input and output columns is not vectorised by the compiler, which cannot
//! tell that they do not overlap; eight numbers by name are, inside a `rows::simd!` function. There
//! everything must be inlined, or it is compiled for the baseline: plain loops and
//! `#[inline(always)]`, no closures.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// What the formulas of filtered quantities need of a number.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The number `x`.
    fn of(x: f64) -> Self;
    /// √x.
    fn sqrt(self) -> Self;
    /// The larger of this and `bound`.
    fn at_least(self, bound: f64) -> Self;
    /// This where `condition` is above `bound`, else 0.
    fn where_above(self, condition: Self, bound: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn at_least(self, bound: f64) -> Self {
        if self > bound { self } else { bound }
    }
    #[inline(always)]
    fn where_above(self, condition: Self, bound: f64) -> Self {
        if condition > bound { self } else { 0.0 }
    }
}

/// Numbers in [`Lanes`].
pub const LANES: usize = 8;

/// Eight numbers: a vector register of AVX-512, two of AVX2.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Lanes(pub [f64; LANES]);

impl Lanes {
    /// The first eight numbers of `values`.
    ///
    /// # Panics
    /// If there are fewer.
    #[inline(always)]
    pub fn load(values: &[f64]) -> Self {
        match values.first_chunk() {
            Some(lanes) => Self(*lanes),
            None => panic!("fewer numbers than lanes"),
        }
    }

    /// The numbers of `values`, at most eight, and zeros for those that are missing.
    #[inline(always)]
    pub fn load_some(values: &[f64]) -> Self {
        let mut lanes = [0.0; LANES];
        lanes[..values.len()].copy_from_slice(values);
        Self(lanes)
    }

    /// Writes the numbers to the beginning of `values`, as many as fit.
    #[inline(always)]
    pub fn store(self, values: &mut [f64]) {
        match values.first_chunk_mut() {
            Some(lanes) => *lanes = self.0,
            None => values.copy_from_slice(&self.0[..values.len()]),
        }
    }
}

macro_rules! operator {
    ($($name:ident $function:ident),*) => {
        $(impl $name for Lanes {
            type Output = Self;
            #[inline(always)]
            fn $function(mut self, other: Self) -> Self {
                for lane in 0..LANES {
                    self.0[lane] = self.0[lane].$function(other.0[lane]);
                }
                self
            }
        })*
    };
}
operator!(Add add, Sub sub, Mul mul, Div div);

impl Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        for lane in 0..LANES {
            self.0[lane] = -self.0[lane];
        }
        self
    }
}

impl Number for Lanes {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([x; LANES])
    }
    #[inline(always)]
    fn sqrt(mut self) -> Self {
        for lane in 0..LANES {
            self.0[lane] = self.0[lane].sqrt();
        }
        self
    }
    #[inline(always)]
    fn at_least(mut self, bound: f64) -> Self {
        for lane in 0..LANES {
            self.0[lane] = self.0[lane].at_least(bound);
        }
        self
    }
    #[inline(always)]
    fn where_above(mut self, condition: Self, bound: f64) -> Self {
        for lane in 0..LANES {
            self.0[lane] = self.0[lane].where_above(condition.0[lane], bound);
        }
        self
    }
}

/// The numbers of two rows in turns: of their first halves, of their second halves.
#[inline(always)]
fn interleave(one: Lanes, other: Lanes) -> (Lanes, Lanes) {
    let ([a, b, c, d, e, f, g, h], [k, l, m, n, o, p, q, r]) = (one.0, other.0);
    (Lanes([a, k, b, l, c, m, d, n]), Lanes([e, o, f, p, g, q, h, r]))
}

/// Rows become columns: the first lanes of all eight, the second of all, and so on.
#[inline(always)]
pub fn transpose(rows: &[Lanes; LANES]) -> [Lanes; LANES] {
    // Interleaving row i with row i + 4 rotates the bits of a number's place; three times do it.
    // By name, because an array that a loop permutes is copied in memory.
    let [a, b, c, d, e, f, g, h] = *rows;
    let ((a, b), (c, d), (e, f), (g, h)) =
        (interleave(a, e), interleave(b, f), interleave(c, g), interleave(d, h));
    let ((a, b), (c, d), (e, f), (g, h)) =
        (interleave(a, e), interleave(b, f), interleave(c, g), interleave(d, h));
    let ((a, b), (c, d), (e, f), (g, h)) =
        (interleave(a, e), interleave(b, f), interleave(c, g), interleave(d, h));
    [a, b, c, d, e, f, g, h]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formula<N: Number>(a: N, b: N) -> N {
        let c = (a * a + b).at_least(0.5).sqrt() - a / b;
        -c.where_above(a, 0.0) + N::of(2.0)
    }

    #[test]
    fn eight_numbers_are_eight_times_one_number() {
        let a = Lanes([1.0, -2.0, 3.0, 0.0, 0.1, -0.0, 1e9, -1e-9]);
        let b = Lanes([2.0, 5.0, -0.1, 1.0, 7.0, 0.3, 1e-3, 4.0]);
        let together = formula(a, b);
        for lane in 0..LANES {
            assert_eq!(together.0[lane].to_bits(), formula(a.0[lane], b.0[lane]).to_bits());
        }
    }

    #[test]
    fn a_transpose_exchanges_rows_and_columns() {
        let mut rows = [Lanes([0.0; LANES]); LANES];
        for (i, row) in rows.iter_mut().enumerate() {
            row.0 = std::array::from_fn(|j| (10 * i + j) as f64);
        }
        for (j, column) in transpose(&rows).iter().enumerate() {
            for i in 0..LANES {
                assert_eq!(column.0[i], (10 * i + j) as f64);
            }
        }
    }

    #[test]
    fn short_rows_are_filled_and_cut() {
        let values: Vec<f64> = (0..11).map(f64::from).collect();
        assert_eq!(Lanes::load(&values).0, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        assert_eq!(Lanes::load_some(&values[8..]).0, [8.0, 9.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut out = [0.0; 11];
        Lanes::load(&values).store(&mut out);
        Lanes::load_some(&values[8..]).store(&mut out[8..]);
        assert_eq!(out.as_slice(), values);
    }
}
