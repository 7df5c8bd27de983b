//! [`Dual`]: a number and its derivatives, so that a formula written once is also its gradient.
//!
//! The laws take it for a [`Real`]; nested, `Dual<Dual<f64, D>, D>`, it holds second derivatives.

use crate::real::Real;
use std::cmp::Ordering;
use std::f64::consts::LN_2;
use std::fmt;
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A [`Real`] with the circular functions.
pub trait Smooth: Real {
    /// sin x.
    fn sin(self) -> Self;
    /// cos x.
    fn cos(self) -> Self;
}

impl Smooth for f64 {
    fn sin(self) -> Self {
        f64::sin(self)
    }
    fn cos(self) -> Self {
        f64::cos(self)
    }
}

/// A value and its `N` partial derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Dual<T, const N: usize> {
    /// The value.
    pub value: T,
    /// Its partial derivatives.
    pub gradient: [T; N],
}

impl<T: Real, const N: usize> Dual<T, N> {
    /// The independent variable number `n`.
    pub fn variable(value: T, n: usize) -> Self {
        let gradient = std::array::from_fn(|m| if m == n { T::ONE } else { T::ZERO });
        Self { value, gradient }
    }

    /// f(self), from f and its derivative there.
    fn chain(self, value: T, slope: T) -> Self {
        Self { value, gradient: self.gradient.map(|d| slope * d) }
    }
}

impl<const N: usize> Dual<Dual<f64, N>, N> {
    /// The coordinates of the point `x` as independent variables, to second derivatives.
    pub fn point(x: [f64; N]) -> [Self; N] {
        std::array::from_fn(|n| Self::variable(Dual::variable(x[n], n), n))
    }
}

impl<T: Real, const N: usize> Add for Dual<T, N> {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let gradient = std::array::from_fn(|n| self.gradient[n] + other.gradient[n]);
        Self { value: self.value + other.value, gradient }
    }
}

impl<T: Real, const N: usize> Sub for Dual<T, N> {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl<T: Real, const N: usize> Mul for Dual<T, N> {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let by_self = other.chain(self.value * other.value, self.value);
        let by_other = self.chain(T::ZERO, other.value);
        by_self + by_other
    }
}

impl<T: Real, const N: usize> Div for Dual<T, N> {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let inverse = T::ONE / other.value;
        let value = self.value * inverse;
        let gradient =
            std::array::from_fn(|n| (self.gradient[n] - value * other.gradient[n]) * inverse);
        Self { value, gradient }
    }
}

impl<T: Real, const N: usize> Neg for Dual<T, N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.chain(-self.value, -T::ONE)
    }
}

macro_rules! assign {
    ($($name:ident $function:ident $operator:tt),+) => {$(
        impl<T: Real, const N: usize> $name for Dual<T, N> {
            fn $function(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }
    )+};
}
assign!(AddAssign add_assign +, SubAssign sub_assign -, MulAssign mul_assign *, DivAssign div_assign /);

impl<T: Real, const N: usize> Sum for Dual<T, N> {
    fn sum<I: Iterator<Item = Self>>(numbers: I) -> Self {
        numbers.fold(Self::ZERO, |a, b| a + b)
    }
}

impl<T: Real, const N: usize> Default for Dual<T, N> {
    fn default() -> Self {
        Self::ZERO
    }
}

impl<T: Real, const N: usize> fmt::Display for Dual<T, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(&self.value, f)
    }
}

/// Dual numbers compare by their values.
impl<T: Real, const N: usize> PartialEq for Dual<T, N> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<T: Real, const N: usize> PartialOrd for Dual<T, N> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.value.partial_cmp(&other.value)
    }
}

impl<T: Real, const N: usize> Real for Dual<T, N> {
    const ZERO: Self = Self { value: T::ZERO, gradient: [T::ZERO; N] };
    const ONE: Self = Self { value: T::ONE, gradient: [T::ZERO; N] };
    const EPSILON: Self = Self { value: T::EPSILON, gradient: [T::ZERO; N] };

    fn of(x: f64) -> Self {
        Self { value: T::of(x), ..Self::ZERO }
    }
    fn f64(self) -> f64 {
        self.value.f64()
    }
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, T::of(0.5) / root)
    }
    fn cbrt(self) -> Self {
        let root = self.value.cbrt();
        self.chain(root, T::of(1.0 / 3.0) * root / self.value)
    }
    fn rough_roots(self) -> [Self; 3] {
        [self.sqrt(), self.cbrt(), self.sqrt().sqrt()]
    }
    fn abs(self) -> Self {
        if self.value < T::ZERO { -self } else { self }
    }
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    fn exp2(self) -> Self {
        let power = self.value.exp2();
        self.chain(power, T::of(LN_2) * power)
    }
    fn log2(self) -> Self {
        self.chain(self.value.log2(), T::of(1.0 / LN_2) / self.value)
    }
}

impl<T: Smooth, const N: usize> Smooth for Dual<T, N> {
    fn sin(self) -> Self {
        self.chain(self.value.sin(), self.value.cos())
    }
    fn cos(self) -> Self {
        self.chain(self.value.cos(), -self.value.sin())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything that the laws may ask of a number, of two.
    fn formula<S: Smooth>([x, y]: [S; 2]) -> S {
        let q = x.power(S::of(0.687)) / (S::ONE + x * y.sqrt() * y.cbrt()) - (S::of(0.3) * y).exp();
        q.abs().max(S::of(1e-3)).min(S::of(1e3)) * (x * y).sin() + (x - y).cos() * y.log2()
    }

    #[test]
    fn derivatives_are_those_of_differences() {
        let (x, y) = (0.7, 1.9);
        let found = formula(Dual::point([x, y]));
        let plain = |x, y| formula([x, y]);
        assert!((found.f64() / plain(x, y) - 1.0).abs() < 1e-15);
        // Central differences of fourth order; their error is some 1e-12 for the first and
        // 1e-8 for the second derivative.
        let first = |f: &dyn Fn(f64) -> f64| {
            let h = 1e-3;
            (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h)
        };
        let by_x = |x, y| first(&|h| plain(x + h, y));
        let by_y = |x, y| first(&|h| plain(x, y + h));
        let gradient = [by_x(x, y), by_y(x, y)];
        let second = [
            [first(&|h| by_x(x + h, y)), first(&|h| by_x(x, y + h))],
            [first(&|h| by_y(x + h, y)), first(&|h| by_y(x, y + h))],
        ];
        for a in 0..2 {
            for value in [found.gradient[a].value, found.value.gradient[a]] {
                assert!((value - gradient[a]).abs() < 1e-10, "{a}: {value} {gradient:?}");
            }
            for b in 0..2 {
                let value = found.gradient[a].gradient[b];
                assert!((value - second[a][b]).abs() < 1e-8, "{a} {b}: {value} {second:?}");
            }
        }
    }
}
