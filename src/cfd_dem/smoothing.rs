//! How far what particles give to cells is spread.

use crate::case::MappingChoice;
use std::f64::consts::PI;

/// Explicit steps of diffusion that make a Gaussian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// How many.
    pub steps: usize,
    /// Share that a neighbour along each axis gets in one \[-\].
    pub shares: [f64; 3],
}

/// Standard deviation of what a particle is spread to, unless the cells' own is wider or the case says
/// otherwise, in diameters \[-\]: that of trilinear shares among cells of 10/3 d, the founding study's.
///
/// Shares alone narrow with the cells. Cells of 1.7 d hold less than half a particle each at φ = 0.05, and what
/// they hold then is noise, which the drag follows and the filter counts as clusters.
pub const WIDTH: f64 = 1.36;

/// Variance along an axis of what a particle of `diameter` is spread to by its shares in cells of edge
/// `spacing`, over all of its places \[m²\]: that of a hat over two cells, h²/6, or of a cube of the
/// particle's volume seen by cells, (h² + e²)/12.
pub fn variance_of_shares(choice: MappingChoice, spacing: f64, diameter: f64) -> f64 {
    match choice {
        MappingChoice::Trilinear => spacing.powi(2) / 6.0,
        MappingChoice::Divided => (spacing.powi(2) + ((PI / 6.0).cbrt() * diameter).powi(2)) / 12.0,
    }
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
