//! [`Real`]: the two precisions that every kernel compiles for.
//!
//! Only what the kernels need, so that a kernel written once is an `f32` and an `f64` kernel.
//! Transcendentals are polynomial (see [`Real::exp2`], [`Real::log2`]) because calls into the
//! system's mathematics library keep a loop from being vectorised and differ between systems.

use std::fmt::{Debug, Display};
use std::iter::Sum;
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

/// A floating-point number: `f32` or `f64`.
pub trait Real:
    Copy
    + Debug
    + Default
    + Display
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + Sum
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Distance from 1 to the next larger number.
    const EPSILON: Self;

    /// The nearest number to `x` in this precision.
    fn of(x: f64) -> Self;
    /// This number in double precision.
    fn f64(self) -> f64;
    /// √x, correctly rounded.
    fn sqrt(self) -> Self;
    /// |x|.
    fn abs(self) -> Self;
    /// The larger of two numbers, neither of them NaN.
    fn max(self, other: Self) -> Self;
    /// The smaller of two numbers, neither of them NaN.
    fn min(self, other: Self) -> Self;
    /// 2^x for normal results; branch-free.
    fn exp2(self) -> Self;
    /// log₂ x of a positive normal number; branch-free.
    fn log2(self) -> Self;
    /// ∛x of a positive normal number, to a few units in the last place; branch-free, and a third of
    /// the cost of a power.
    fn cbrt(self) -> Self;

    /// √x, ∛x, ⁴√x of a positive normal number, up to 6.1 % too large and never too small: where to
    /// start from. Integer arithmetic only, so that the divider, which `sqrt` shares, stays free.
    fn rough_roots(self) -> [Self; 3];

    /// `x` to a power, for x > 0: 2^(y log₂ x).
    #[inline(always)]
    fn power(self, y: Self) -> Self {
        (y * self.log2()).exp2()
    }

    /// e^x.
    #[inline(always)]
    fn exp(self) -> Self {
        (self * Self::of(std::f64::consts::LOG2_E)).exp2()
    }

    /// `yes` where `condition` holds, else `no`: both sides are evaluated, so it vectorises.
    #[inline(always)]
    fn select(condition: bool, yes: Self, no: Self) -> Self {
        if condition { yes } else { no }
    }
}

/// Coefficients of 2^f on |f| ≤ 1/2: (ln 2)^n / n!.
const EXP2: [f64; 14] = {
    let mut c = [1.0; 14];
    let mut n = 1;
    while n < 14 {
        c[n] = c[n - 1] * std::f64::consts::LN_2 / n as f64;
        n += 1;
    }
    c
};
const EXP2_F32: [f64; 7] = economised(EXP2, 1, 0.5);
const EXP2_F64: [f64; 12] = economised(EXP2, 1, 0.5);

/// Bits of the first guess of x^(-1/3), less a third of those of x, that make its largest relative
/// error smallest (0.034).
const CBRT_F32: u32 = 0x54a2_0800;
const CBRT_F64: u64 = 0x553e_dbaf_3ded_d796;

/// Two thirds of the bits of 1, and what a third of bits made of shifts falls short by.
const THIRD_F32: u32 = 0x2a55_555b;
const THIRD_F64: u64 = 0x2aa0_0000_2aaa_aaab;

/// log₂ m = (2 / ln 2) artanh s, s = (m-1)/(m+1): the series' coefficients of s^(2n+1).
const LOG2: [f64; 12] = {
    let mut c = [0.0; 12];
    let mut n = 0;
    while n < 12 {
        c[n] = 2.0 * std::f64::consts::LOG2_E / (2 * n + 1) as f64;
        n += 1;
    }
    c
};
/// (√2 - 1)/(√2 + 1), the largest s.
const LARGEST_S: f64 = 3.0 - 2.0 * std::f64::consts::SQRT_2;
const LOG2_F32: [f64; 4] = economised(LOG2, 2, LARGEST_S);
const LOG2_F64: [f64; 8] = economised(LOG2, 2, LARGEST_S);

/// A polynomial of fewer terms that is as near as can be on |x| ≤ `radius`, all but for some per cent: its
/// highest powers one after the other give way to lower ones by multiples of Chebyshev's polynomials
/// (Lanczos 1938). Term n is of x^(`step` n); `step` is 1, or 2 for an even polynomial.
const fn economised<const FROM: usize, const TO: usize>(
    mut c: [f64; FROM],
    step: usize,
    radius: f64,
) -> [f64; TO] {
    let mut kept = [0.0; TO];
    let mut n = FROM;
    while n > 0 {
        n -= 1;
        if n < TO {
            kept[n] = c[n];
            continue;
        }
        // T_k, of the powers of x / radius.
        let (mut before, mut t) = ([0.0; 32], [0.0; 32]);
        (before[0], t[1]) = (1.0, 1.0);
        let mut k = 1;
        while k < step * n {
            let mut next = [0.0; 32];
            let mut power = 0;
            while power <= k + 1 {
                let raised = if power > 0 { 2.0 * t[power - 1] } else { 0.0 };
                next[power] = raised - before[power];
                power += 1;
            }
            (before, t) = (t, next);
            k += 1;
        }
        // Down from the highest term, so that its power of the radius is divided out.
        let (mut m, mut scale) = (n, c[n] / t[step * n]);
        loop {
            c[m] -= scale * t[step * m];
            if m == 0 {
                break;
            }
            m -= 1;
            let mut times = 0;
            while times < step {
                scale *= radius;
                times += 1;
            }
        }
    }
    kept
}

/// A polynomial, odd and even powers apart: two short chains of dependent
/// operations take half the time of one.
macro_rules! polynomial {
    ($t:ident, $coefficients:ident, $x:expr) => {{
        const TERMS: usize = $coefficients.len();
        let (x, x2) = ($x, $x * $x);
        let mut sums = [$coefficients[TERMS - 2] as $t, $coefficients[TERMS - 1] as $t];
        let mut n = TERMS - 2;
        while n >= 2 {
            n -= 2;
            sums[0] = sums[0] * x2 + $coefficients[n] as $t;
            sums[1] = sums[1] * x2 + $coefficients[n + 1] as $t;
        }
        if n == 1 {
            // An odd number of terms: what was even is odd now.
            sums = [sums[1] * x2 + $coefficients[0] as $t, sums[0]];
        }
        sums[0] + x * sums[1]
    }};
}

macro_rules! real {
    ($t:ident, $bits:ident, $signed:ident, $mantissa:expr, $bias:expr, $round:expr, $exp:ident, $log:ident, $cbrt:expr, $third_term:expr, $third:expr) => {
        impl Real for $t {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const EPSILON: Self = $t::EPSILON;

            #[inline(always)]
            fn of(x: f64) -> Self {
                x as $t
            }
            #[inline(always)]
            fn f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $t::sqrt(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $t::abs(self)
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                if self > other { self } else { other }
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                if self < other { self } else { other }
            }

            #[inline(always)]
            fn exp2(self) -> Self {
                // Keeps the exponent normal; beyond, the result saturates instead of wrapping.
                let limit = ($bias - 1) as $t;
                let x = Real::min(Real::max(self, -limit), limit);
                // Adding 1.5 · 2^mantissa rounds to an integer and leaves it in the low bits, so
                // no float-to-integer conversion (scalar before AVX-512) is needed.
                let shifted = x + $round;
                let fraction = x - (shifted - $round);
                let exponent = shifted.to_bits() << $mantissa;
                let sum = polynomial!($t, $exp, fraction);
                $t::from_bits(sum.to_bits().wrapping_add(exponent))
            }

            #[inline(always)]
            fn log2(self) -> Self {
                // x = 2^e m with m in [√½, √2).
                let sqrt_half = std::f64::consts::FRAC_1_SQRT_2 as $t;
                let offset = self.to_bits().wrapping_sub(sqrt_half.to_bits());
                let exponent = ((offset as $signed) >> $mantissa) as $bits;
                let m = $t::from_bits(self.to_bits().wrapping_sub(exponent << $mantissa));
                // The exponent as a float, again without an integer conversion.
                let e = $t::from_bits($round.to_bits().wrapping_add(exponent)) - $round;
                let s = (m - 1.0) / (m + 1.0);
                let s2 = s * s;
                let sum = polynomial!($t, $log, s2);
                sum * s + e
            }

            #[inline(always)]
            fn cbrt(self) -> Self {
                // A third of the bits, by shifts: 1/3 = (1/4 + 1/16) (1 + 1/16) (1 + 1/256) ...
                let bits = self.to_bits();
                let mut third = (bits >> 2) + (bits >> 4);
                third += third >> 4;
                third += third >> 8;
                let mut root = $t::from_bits($cbrt - third);
                // r = x^(-1/3) is a guess times (1 - off)^(-1/3), without a division: two steps of as many
                // terms of that series as it takes.
                let mut n = 0;
                while n < 2 {
                    let off = 1.0 - self * root * root * root;
                    let rest = if $third_term { (14.0 / 81.0) as $t * off } else { 0.0 };
                    root += root * off * ((1.0 / 3.0) as $t + off * ((2.0 / 9.0) as $t + rest));
                    n += 1;
                }
                self * root * root
            }

            #[inline(always)]
            fn rough_roots(self) -> [Self; 3] {
                // The bits are 2^mantissa (log₂ x + bias) where x is a power of two, and linear in x
                // between, where the root's are: log₂ is above its chords.
                let (bits, one) = (self.to_bits(), (1.0 as $t).to_bits());
                let mut third = (bits >> 2) + (bits >> 4);
                third += third >> 4;
                third += third >> 8;
                third += third >> 16;
                [
                    $t::from_bits((bits >> 1) + (one - (one >> 1))),
                    // What the shifts drop is less than these units.
                    $t::from_bits(third + $third),
                    $t::from_bits((bits >> 2) + (one - (one >> 2))),
                ]
            }
        }
    };
}

real!(f32, u32, i32, 23, 127, 12_582_912.0f32, EXP2_F32, LOG2_F32, CBRT_F32, false, THIRD_F32);
real!(
    f64,
    u64,
    i64,
    52,
    1023,
    6_755_399_441_055_744.0f64,
    EXP2_F64,
    LOG2_F64,
    CBRT_F64,
    true,
    THIRD_F64
);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_and_log2_agree_with_the_system_library() {
        for i in -4000..=4000 {
            let x = f64::from(i) * 0.013_7;
            let found = Real::exp2(x);
            assert!((found / f64::exp2(x) - 1.0).abs() < 4e-16, "2^{x}: {found}");
            let found32 = Real::exp2(x as f32).f64();
            assert!((found32 / f64::from(x as f32).exp2() - 1.0).abs() < 2.5e-7, "2^{x}");

            let y = f64::exp2(x);
            assert!((Real::log2(y) - x).abs() < 4e-16 * x.abs().max(1.0), "log2 {y}");
            let y32 = y as f32;
            let exact = f64::from(y32).log2();
            assert!((Real::log2(y32).f64() - exact).abs() < 2.5e-7 * exact.abs().max(1.0));
        }
    }

    #[test]
    fn powers_are_exact_enough_for_the_drag_law() {
        for i in 1..2000 {
            let x = f64::from(i) * 0.01;
            assert!((x.power(0.687) / x.powf(0.687) - 1.0).abs() < 4e-15);
            assert!((x.power(-2.65) / x.powf(-2.65) - 1.0).abs() < 8e-15);
        }
    }

    #[test]
    fn cube_roots_agree_with_the_system_library() {
        for i in -8000..=800 {
            let x = f64::exp2(f64::from(i) * 0.01373);
            assert!((Real::cbrt(x) / f64::cbrt(x) - 1.0).abs() < 1e-15, "{x}");
            let x = x as f32;
            assert!((Real::cbrt(x).f64() / f64::from(x).cbrt() - 1.0).abs() < 4e-7, "{x}");
        }
    }

    #[test]
    fn rough_roots_are_above_the_roots_and_near() {
        for i in -40_000..=40_000 {
            let x = f64::exp2(f64::from(i) * 0.002_37);
            let exact = [x.sqrt(), x.cbrt(), x.sqrt().sqrt()];
            for (rough, exact) in x.rough_roots().into_iter().zip(exact) {
                assert!((1.0 - 1e-15..1.0607).contains(&(rough / exact)), "{x}: {rough} {exact}");
            }
            let x = x as f32;
            let exact = [f64::from(x).sqrt(), f64::from(x).cbrt(), f64::from(x).sqrt().sqrt()];
            for (rough, exact) in x.rough_roots().into_iter().zip(exact) {
                let ratio = f64::from(rough) / exact;
                assert!((1.0 - 2e-7..1.0607).contains(&ratio), "{x}: {rough} {exact}");
            }
        }
    }

    #[test]
    fn exponents_out_of_range_saturate() {
        assert!(Real::exp2(-5000.0f64) > 0.0 && Real::exp2(-5000.0f64) < 1e-300);
        assert!(Real::exp2(5000.0f64).is_finite());
    }
}
