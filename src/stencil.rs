//! Interpolation and limiting: pure functions of values; no physics.

use crate::real::Real;

/// Half the limited slope times spacing, from the differences to both neighbours: monotonised central
/// (van Leer 1977), sharper than van Leer's harmonic mean and without its division.
///
/// Zero at an extremum, and never more than either difference: a face value stays between its neighbours,
/// and a positive quantity stays positive up to a Courant number of one half.
#[inline(always)]
pub fn half_limited_slope<R: Real>(behind: R, ahead: R) -> R {
    let central = R::of(0.25) * (behind + ahead);
    // Between 0 and the difference that is nearer to it; of differences of unlike signs no room is left.
    let most = behind.min(ahead).max(R::ZERO);
    let least = behind.max(ahead).min(R::ZERO);
    central.max(least).min(most)
}

/// Mean value, over a time step, of what crosses the face between `left` and `right`, upwind of
/// the flux `through` it (positive from left to right), from the two cells on either side:
/// second order in space and time (van Leer's MUSCL-Hancock). `courant` is the share of a cell that
/// crosses, |u| dt/h; 0 gives the value at the face itself.
#[inline(always)]
pub fn upwind<R: Real>(through: R, courant: R, left2: R, left: R, right: R, right2: R) -> R {
    // Choosing inputs first leaves one limiter.
    let from_left = through > R::ZERO;
    let [behind, base, ahead] = [
        R::select(from_left, left2, right2),
        R::select(from_left, left, right),
        R::select(from_left, right, left),
    ];
    let kept = (R::ONE - courant).max(R::ZERO);
    base + kept * half_limited_slope(base - behind, ahead - base)
}

/// Harmonic mean of two positive numbers.
#[inline(always)]
pub fn harmonic<R: Real>(a: R, b: R) -> R {
    R::of(2.0) * a * b / (a + b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_central_where_smooth_and_zero_at_extrema() {
        let slope = |behind, ahead| 2.0 * half_limited_slope::<f64>(behind, ahead);
        assert_eq!(slope(1.0, 1.0), 1.0);
        assert_eq!(slope(1.0, 2.0), 1.5);
        assert_eq!(slope(-1.0, -2.0), -1.5);
        assert_eq!(slope(1.0, 9.0), 2.0);
        assert_eq!(slope(1.0, -1.0), 0.0);
        assert_eq!(slope(0.0, 5.0), 0.0);
    }

    #[test]
    fn face_values_are_upwind_and_exact_on_lines() {
        assert_eq!(upwind(1.0, 0.0, 0.0, 1.0, 2.0, 3.0), 1.5);
        assert_eq!(upwind(-1.0, 0.0, 0.0, 1.0, 2.0, 3.0), 1.5);
        assert_eq!(upwind(1.0, 0.0, 1.0, 1.0, 5.0, 5.0), 1.0);
        assert_eq!(upwind(-1.0, 0.0, 1.0, 1.0, 5.0, 5.0), 5.0);
        // What crosses in a step that empties half, or all, of the upwind cell.
        assert_eq!(upwind(1.0, 0.5, 0.0, 1.0, 2.0, 3.0), 1.25);
        assert_eq!(upwind(-1.0, 1.0, 0.0, 1.0, 2.0, 3.0), 2.0);
    }

    /// Mean absolute error after a sine wave went once round `n` cells in `2 n` steps.
    fn error_after_one_round(n: usize) -> f64 {
        let exact: Vec<f64> =
            (0..n).map(|i| (std::f64::consts::TAU * i as f64 / n as f64).sin()).collect();
        let mut wave = exact.clone();
        for _ in 0..2 * n {
            let at = |i: usize| wave[i % n];
            let face: Vec<f64> = (0..n)
                .map(|i| upwind(1.0, 0.5, at(i + n - 2), at(i + n - 1), at(i), at(i + 1)))
                .collect();
            wave = (0..n).map(|i| wave[i] - 0.5 * (face[(i + 1) % n] - face[i])).collect();
        }
        wave.iter().zip(&exact).map(|(a, b)| (a - b).abs()).sum::<f64>() / n as f64
    }

    #[test]
    fn advection_is_second_order_in_space_and_time() {
        let [coarse, middle, fine] = [64, 128, 256].map(error_after_one_round);
        let orders = [(coarse / middle).log2(), (middle / fine).log2()];
        assert!(orders.iter().all(|&order| order > 1.9), "{orders:?}");
    }
}
