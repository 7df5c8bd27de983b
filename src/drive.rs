//! What drives the flow: a mean gas pressure gradient that balances the weight, or one that keeps
//! the flux of the gas.
//!
//! The flow is seen from the frame in which the mixture has no momentum. A mean gradient G (upwards)
//! and the weight ρ g of the mixture accelerate that frame by (G - ρ g)/ρ, so that per volume a phase
//! of density ρ_k is left with G - ρ_k g - ρ_k (G - ρ g)/ρ = (G/ρ g) g (ρ - ρ_k): what it is left with
//! when G balances the weight, times G over the weight. The sum over both phases vanishes whatever
//! G is, and momentum is kept to round-off.

use crate::laws::drag::DragLaw;
use crate::laws::scales::{Gas, Powder};

/// The gas flux that is kept, and by what.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GasFlux {
    /// ⟨(1-φ) u_g⟩ - ⟨1-φ⟩ ⟨φ u_s⟩/⟨φ⟩, vertical \[m/s\].
    wanted: f64,
    /// Mean pressure gradient over the weight.
    pub(crate) gradient: f64,
}

impl GasFlux {
    /// The flux of a uniform state of mean solids fraction `mean` and this `slip` \[m/s\], and the gradient
    /// that its drag asks for under `gravity` \[m/s²\].
    pub(crate) fn uniform(
        slip: f64,
        mean: f64,
        law: &dyn DragLaw<f64>,
        powder: &Powder,
        gas: &Gas,
        gravity: f64,
    ) -> Self {
        let weight = (1.0 - mean) * (powder.density - gas.density) * gravity;
        let gradient = law.beta_per_fraction(mean, slip) * slip / weight;
        Self { wanted: (1.0 - mean) * slip, gradient }
    }

    /// What the flux lacks \[m/s\], where φ is `mean` in the mean and ⟨φ u_s⟩ and ⟨(1-φ) u_g⟩ are `flux`
    /// \[m/s\]. Makes the mean gradient one that would have left nothing lacking, for the next step: `answer`
    /// is what a gradient that balances the weight adds to `flux` in a step.
    pub(crate) fn lacking(&mut self, mean: f64, flux: [f64; 2], answer: [f64; 2]) -> f64 {
        let relative = |[solids, gas]: [f64; 2]| gas - (1.0 - mean) / mean * solids;
        let lacking = self.wanted - relative(flux);
        self.gradient += lacking / relative(answer);
        lacking
    }
}

/// Vertical velocities of solids and gas in the uniform state of mean solids fraction `mean` and this
/// `slip` \[m/s\], in the frame in which the mixture has no momentum \[m/s\].
pub(crate) fn uniform_velocities(powder: &Powder, gas: &Gas, mean: f64, slip: f64) -> [f64; 2] {
    let mixture = powder.density * mean + gas.density * (1.0 - mean);
    [-gas.density * (1.0 - mean) * slip / mixture, powder.density * mean * slip / mixture]
}
