//! How far what particles give to cells is spread.

/// Explicit steps of diffusion that make a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// How many.
    pub steps: usize,
    /// Share that a neighbour along each axis gets in one \[-\].
    pub shares: [f64; 3],
}

/// Largest sum of the shares of the three axes: half of it keeps the sign of every wave, so that nothing
/// is spread to something negative.
const MOST: f64 = 0.25;

impl Smoothing {
    /// By the variances `variances` \[m²\] on cells of edges `spacing` \[m\]: a step of share s spreads a
    /// point by the variance 2 s h².
    pub fn new(spacing: [f64; 3], variances: [f64; 3]) -> Self {
        let whole: [f64; 3] =
            std::array::from_fn(|axis| 0.5 * variances[axis] / spacing[axis].powi(2));
        let steps = (whole.iter().sum::<f64>() / MOST).ceil() as usize;
        Self { steps, shares: whole.map(|share| share / steps.max(1) as f64) }
    }
}
