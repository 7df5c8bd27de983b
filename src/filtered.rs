//! Filtered quantities: what a coarse-grid solver needs, from filtered moments of the fine fields.
//!
//! An overbar or filt() is the filter, a tilde the Favre (phase-weighted) filter, φ the solids
//! fraction, u the velocities, s = ũ_g - ũ_s the filtered slip, f the drag on the solids per volume, the last
//! axis vertical. Every formula stands once: [`Moments`] are what is filtered, [`Term`] what follows
//! from them at one position and is summed, [`QUANTITIES`] what is reported, each the ratio or the
//! slope of such sums. Deviators and isotropic parts are those of the `D` simulated directions: the
//! part that is subtracted is tr/D, in two dimensions tr/2. Compression is positive. S = √(2 Sd:Sd).

use crate::lanes::{LANES, Number};
use crate::laws::scales::Scales;

/// Filtered moments of the fine fields at one filter position, or at several if `N` is
/// [`Lanes`](crate::lanes::Lanes).
#[derive(Clone, Copy, Debug)]
pub struct Moments<N, const D: usize> {
    /// φ̄ \[-\].
    pub solids_fraction: N,
    /// filt(φ²) \[-\].
    pub solids_fraction_squared: N,
    /// filt(β) \[kg/m³/s\].
    pub drag_coefficient: N,
    /// Filtered isotropic kinetic-theory stress \[Pa\].
    pub kinetic_pressure: N,
    /// filt(φ Θ) \[m²/s²\].
    pub fraction_temperature: N,
    /// filt(σ : ∇u_s), σ the solids' kinetic-theory stress \[W/m³\].
    pub stress_power: N,
    /// filt(f · u_s) \[W/m³\].
    pub drag_on_solids: N,
    /// filt(f · u_g) \[W/m³\].
    pub drag_on_gas: N,
    /// filt(φ u_s · ∇p) \[W/m³\].
    pub pressure_on_solids: N,
    /// filt((1-φ) u_g · ∇p) \[W/m³\].
    pub pressure_on_gas: N,
    /// filt(φ u_s) \[m/s\].
    pub solids_flux: [N; D],
    /// filt((1-φ) u_g) \[m/s\].
    pub gas_flux: [N; D],
    /// filt(φ u_g): the gas that the solids see \[m/s\].
    pub seen_gas_flux: [N; D],
    /// filt(f) \[Pa/m\].
    pub drag: [N; D],
    /// filt(∇p) \[Pa/m\].
    pub pressure_gradient: [N; D],
    /// filt(φ ∇p) \[Pa/m\].
    pub fraction_pressure_gradient: [N; D],
    /// ∇φ̄ \[1/m\].
    pub fraction_gradient: [N; D],
    /// filt(φ u_s u_s) \[m²/s²\].
    pub solids_flux_velocity: [[N; D]; D],
    /// filt((1-φ) u_g u_g) \[m²/s²\].
    pub gas_flux_velocity: [[N; D]; D],
    /// Filtered deviatoric kinetic-theory stress \[Pa\].
    pub kinetic_stress: [[N; D]; D],
    /// ∂/∂x_j filt(φ u_s,i) \[1/s\].
    pub solids_flux_gradient: [[N; D]; D],
    /// ∂/∂x_j filt((1-φ) u_g,i) \[1/s\].
    pub gas_flux_gradient: [[N; D]; D],
    /// Particles per volume, where they are counted; not in two dimensions \[1/m³\].
    pub number_density: N,
    /// Their contacts per volume, likewise \[1/m³\].
    pub contact_density: N,
}

/// Below this fraction a phase is absent, and has neither velocity nor gradient: what a transform's
/// round-off leaves of an empty place is smaller.
const ABSENT: f64 = 1e-12;

/// `amount / fraction`; 0 for a phase that is absent. Of a positive kernel, a filtered flux is at most
/// its filtered fraction times the greatest fine velocity, so that the quotient is bounded.
#[inline(always)]
pub fn favre<N: Number>(amount: N, fraction: N) -> N {
    (amount / fraction.at_least(f64::MIN_POSITIVE)).where_above(fraction, ABSENT)
}

/// tr a, the sum over the simulated directions.
#[inline(always)]
fn trace<N: Number, const D: usize>(a: &[[N; D]; D]) -> N {
    let plane = a[0][0] + a[1][1];
    if D == 3 { plane + a[D - 1][D - 1] } else { plane }
}

/// a · b.
#[inline(always)]
fn dot<N: Number, const D: usize>(a: &[N; D], b: &[N; D]) -> N {
    let plane = a[0] * b[0] + a[1] * b[1];
    if D == 3 { plane + a[D - 1] * b[D - 1] } else { plane }
}

/// The part of a · b that is not vertical.
#[inline(always)]
fn lateral<N: Number, const D: usize>(a: &[N; D], b: &[N; D]) -> N {
    let first = a[0] * b[0];
    if D == 3 { first + a[1] * b[1] } else { first }
}

/// a : b.
#[inline(always)]
fn contract<N: Number, const D: usize>(a: &[[N; D]; D], b: &[[N; D]; D]) -> N {
    let plane = dot(&a[0], &b[0]) + dot(&a[1], &b[1]);
    if D == 3 { plane + dot(&a[D - 1], &b[D - 1]) } else { plane }
}

/// `tensor!(D, |i, j| component)`: the tensor of these components. A macro, because closures are not
/// inlined, and a kernel that calls is not vectorised.
macro_rules! tensor {
    ($d:expr, |$i:ident, $j:ident| $component:expr) => {{
        let mut tensor = [[Number::of(0.0); $d]; $d];
        for $i in 0..$d {
            for $j in 0..$d {
                tensor[$i][$j] = $component;
            }
        }
        tensor
    }};
}

/// `vector!(D, |i| component)`: the vector of these components.
macro_rules! vector {
    ($d:expr, |$i:ident| $component:expr) => {{
        let mut vector = [Number::of(0.0); $d];
        for $i in 0..$d {
            vector[$i] = $component;
        }
        vector
    }};
}

/// Sd = ½ (∇u + ∇uᵀ) - (∇·u / D) I \[1/s\].
#[inline(always)]
fn deviatoric_rate<N: Number, const D: usize>(gradient: &[[N; D]; D]) -> [[N; D]; D] {
    let isotropic = trace(gradient) * N::of(1.0 / D as f64);
    tensor!(D, |i, j| {
        let symmetric = N::of(0.5) * (gradient[i][j] + gradient[j][i]);
        if i == j { symmetric - isotropic } else { symmetric }
    })
}

impl<N: Number, const D: usize> Moments<N, D> {
    /// Moments that are all zero.
    pub fn zeros() -> Self {
        let zero = N::of(0.0);
        let (vector, tensor) = ([zero; D], [[zero; D]; D]);
        Self {
            solids_fraction: zero,
            solids_fraction_squared: zero,
            drag_coefficient: zero,
            kinetic_pressure: zero,
            fraction_temperature: zero,
            stress_power: zero,
            drag_on_solids: zero,
            drag_on_gas: zero,
            pressure_on_solids: zero,
            pressure_on_gas: zero,
            solids_flux: vector,
            gas_flux: vector,
            seen_gas_flux: vector,
            drag: vector,
            pressure_gradient: vector,
            fraction_pressure_gradient: vector,
            fraction_gradient: vector,
            solids_flux_velocity: tensor,
            gas_flux_velocity: tensor,
            kinetic_stress: tensor,
            solids_flux_gradient: tensor,
            gas_flux_gradient: tensor,
            number_density: zero,
            contact_density: zero,
        }
    }

    /// 1 - φ̄.
    #[inline(always)]
    fn gas_fraction(&self) -> N {
        N::of(1.0) - self.solids_fraction
    }

    /// ũ_s = filt(φ u_s) / φ̄ \[m/s\]; 0 in an empty box.
    #[inline(always)]
    pub fn favre_solids_velocity(&self) -> [N; D] {
        vector!(D, |i| favre(self.solids_flux[i], self.solids_fraction))
    }

    /// ũ_g = filt((1-φ) u_g) / (1-φ̄) \[m/s\].
    #[inline(always)]
    pub fn favre_gas_velocity(&self) -> [N; D] {
        vector!(D, |i| favre(self.gas_flux[i], self.gas_fraction()))
    }

    /// Filtered slip s = ũ_g - ũ_s \[m/s\].
    #[inline(always)]
    pub fn slip(&self) -> [N; D] {
        let (gas, solids) = (self.favre_gas_velocity(), self.favre_solids_velocity());
        vector!(D, |axis| gas[axis] - solids[axis])
    }

    /// |ũ_g - ũ_s| \[m/s\].
    #[inline(always)]
    pub fn slip_speed(&self) -> N {
        let slip = self.slip();
        dot(&slip, &slip).sqrt()
    }

    /// Pressure-fluctuation term filt(φ' ∇p') = filt(φ ∇p) - φ̄ filt(∇p) \[Pa/m\].
    #[inline(always)]
    pub fn pressure_fluctuation(&self) -> [N; D] {
        vector!(D, |axis| self.fraction_pressure_gradient[axis]
            - self.solids_fraction * self.pressure_gradient[axis])
    }

    /// φ̄ v_d = filt(φ u_g) - φ̄ ũ_g \[m/s\], v_d the drift velocity.
    #[inline(always)]
    pub fn drift_flux(&self) -> [N; D] {
        let gas = self.favre_gas_velocity();
        vector!(D, |axis| self.seen_gas_flux[axis] - self.solids_fraction * gas[axis])
    }

    /// filt(φ²) - φ̄² \[-\].
    #[inline(always)]
    pub fn solids_fraction_variance(&self) -> N {
        self.solids_fraction_squared - self.solids_fraction * self.solids_fraction
    }

    /// Residual stress of the solids per density, filt(φ u_s u_s) - φ̄ ũ_s ũ_s \[m²/s²\].
    #[inline(always)]
    pub fn residual_stress(&self) -> [[N; D]; D] {
        // φ̄ ũ_i ũ_j with the flux itself: exact in an empty box too.
        let velocity = self.favre_solids_velocity();
        tensor!(D, |i, j| self.solids_flux_velocity[i][j] - self.solids_flux[i] * velocity[j])
    }

    /// Residual stress of the gas per density, filt((1-φ) u_g u_g) - (1-φ̄) ũ_g ũ_g \[m²/s²\].
    #[inline(always)]
    pub fn gas_residual_stress(&self) -> [[N; D]; D] {
        let velocity = self.favre_gas_velocity();
        tensor!(D, |i, j| self.gas_flux_velocity[i][j] - self.gas_flux[i] * velocity[j])
    }

    /// ∂ũ_s,i/∂x_j = (∂ filt(φ u_s,i)/∂x_j - ũ_s,i ∂φ̄/∂x_j) / φ̄ \[1/s\]; 0 where there are no solids.
    #[inline(always)]
    pub fn solids_velocity_gradient(&self) -> [[N; D]; D] {
        let velocity = self.favre_solids_velocity();
        tensor!(D, |i, j| {
            let change = self.solids_flux_gradient[i][j] - velocity[i] * self.fraction_gradient[j];
            favre(change, self.solids_fraction)
        })
    }

    /// ∂ũ_g,i/∂x_j \[1/s\], likewise.
    #[inline(always)]
    pub fn gas_velocity_gradient(&self) -> [[N; D]; D] {
        let velocity = self.favre_gas_velocity();
        tensor!(D, |i, j| {
            let change = self.gas_flux_gradient[i][j] + velocity[i] * self.fraction_gradient[j];
            favre(change, self.gas_fraction())
        })
    }
}

/// What is known beside the moments at a position.
#[derive(Clone, Copy, Debug)]
pub struct Densities {
    /// ρ_s \[kg/m³\].
    pub solids: f64,
    /// ρ_g \[kg/m³\].
    pub gas: f64,
}

macro_rules! terms {
    ($($(#[$doc:meta])* $name:ident),* $(,)?) => {
        /// What a filter position adds to the sums of its bin; an index into [`terms`]'s result.
        ///
        /// R is the residual stress of the solids, R_g that of the gas, τ the filtered deviatoric
        /// kinetic-theory stress; the rates Sd are of the Favre-filtered velocity of the phase.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(usize)]
        pub enum Term {
            $($(#[$doc])* $name),*
        }

        /// Number of terms, filled up to whole [`Lanes`](crate::lanes::Lanes).
        pub const TERM_COUNT: usize = [$(Term::$name),*].len().next_multiple_of(LANES);

        /// Number of terms that are something in `dimension` dimensions: the first ones.
        pub const fn own_terms(dimension: usize) -> usize {
            if dimension < 3 { Term::KineticStressXy as usize } else { [$(Term::$name),*].len() }
        }
    };
}

terms! {
    /// 1.
    Positions,
    /// φ̄ \[-\].
    SolidsFraction,
    /// 1 - φ̄ \[-\].
    GasFraction,
    /// s, vertical \[m/s\].
    Slip,
    /// s², vertical \[m²/s²\].
    SlipSquared,
    /// |s| \[m/s\].
    SlipSpeed,
    /// filt(∂p/∂z) \[Pa/m\].
    PressureGradient,
    /// filt(∂p/∂z)² \[Pa²/m²\].
    PressureGradientSquared,
    /// |∇φ̄| \[1/m\].
    FractionGradient,
    /// filt(φ²) - φ̄² \[-\].
    Variance,
    /// filt(φ u_s), vertical \[m/s\].
    SolidsFlux,
    /// filt((1-φ) u_g), vertical \[m/s\].
    GasFlux,
    /// filt(φ (u_g - u_s)), vertical \[m/s\].
    SeenSlipFlux,
    /// filt(f), vertical \[Pa/m\].
    Drag,
    /// filt(f) filt(∂p/∂z), vertical \[Pa²/m²\].
    DragPressureGradient,
    /// filt(φ' ∂p'/∂z) \[Pa/m\].
    PressureFluctuation,
    /// β_micro(φ̄, |s|) s, vertical \[Pa/m\].
    MicroscopicDrag,
    /// filt(f)·s of the lateral directions \[W/m³\].
    LateralDrag,
    /// filt(φ' ∇p')·s of the lateral directions \[W/m³\].
    LateralPressureFluctuation,
    /// β_micro(φ̄, |s|) s·s of the lateral directions \[W/m³\].
    LateralMicroscopicDrag,
    /// filt(β) \[kg/m³/s\].
    DragCoefficient,
    /// filt(f) - filt(β) filt(φ (u_g - u_s)) / φ̄, vertical: the covariance of the drag coefficient
    /// per particle with the slip that the particles see \[Pa/m\].
    DragCovariance,
    /// φ̄ v_d, vertical \[m/s\].
    DriftFlux,
    /// v_d, vertical \[m/s\].
    DriftVelocity,
    /// v_d s, vertical \[m²/s²\].
    DriftSlip,
    /// Filtered isotropic kinetic-theory stress, tr/D \[Pa\].
    KineticPressure,
    /// tr R / D \[Pa\].
    ResidualPressure,
    /// tr R_g / D \[Pa\].
    GasResidualPressure,
    /// Kinetic-theory stress, isotropic part included, xx \[Pa\].
    KineticStressXx,
    /// xz.
    KineticStressXz,
    /// zz.
    KineticStressZz,
    /// R, xx \[Pa\].
    ResidualStressXx,
    /// xz.
    ResidualStressXz,
    /// zz.
    ResidualStressZz,
    /// R_g, xx \[Pa\].
    GasResidualStressXx,
    /// xz.
    GasResidualStressXz,
    /// zz.
    GasResidualStressZz,
    /// S of the solids \[1/s\].
    ShearRate,
    /// S² \[1/s²\].
    ShearRateSquared,
    /// S³ \[1/s³\].
    ShearRateCubed,
    /// φ̄ S³ \[1/s³\].
    FractionShearRateCubed,
    /// S² of the gas \[1/s²\].
    GasShearRateSquared,
    /// S³ of the gas \[1/s³\].
    GasShearRateCubed,
    /// (1-φ̄) S³ of the gas \[1/s³\].
    GasFractionShearRateCubed,
    /// -τ:Sd \[W/m³\].
    KineticDissipation,
    /// -R:Sd \[W/m³\].
    ResidualDissipation,
    /// -R:Sd/S, the residual shear stress along the rate \[Pa\].
    ResidualShear,
    /// -R_g:Sd \[W/m³\].
    GasResidualDissipation,
    /// filt(φ Θ) \[m²/s²\].
    FractionTemperature,
    /// -R:∇ũ_s: what the filtered motion loses to the sub-filter motion of the solids \[W/m³\].
    SolidsProduction,
    /// filt(f·u_s) - filt(f)·ũ_s: what the drag gives to the sub-filter motion \[W/m³\].
    SolidsDragWork,
    /// -(filt(φ u_s·∇p) - ũ_s·filt(φ ∇p)) \[W/m³\].
    SolidsPressureWork,
    /// -(filt(σ:∇u_s) - filt(σ):∇ũ_s): what collisions take from the sub-filter motion \[W/m³\].
    SolidsDissipation,
    /// -R_g:∇ũ_g \[W/m³\].
    GasProduction,
    /// -(filt(f·u_g) - filt(f)·ũ_g) \[W/m³\].
    GasDragWork,
    /// -(filt((1-φ) u_g·∇p) - ũ_g·filt((1-φ) ∇p)) \[W/m³\].
    GasPressureWork,
    /// Kinetic-theory stress, xy, from here on what two dimensions lack \[Pa\].
    KineticStressXy,
    /// yz.
    KineticStressYz,
    /// yy.
    KineticStressYy,
    /// R, xy \[Pa\].
    ResidualStressXy,
    /// yz.
    ResidualStressYz,
    /// yy.
    ResidualStressYy,
    /// R_g, xy \[Pa\].
    GasResidualStressXy,
    /// yz.
    GasResidualStressYz,
    /// yy.
    GasResidualStressYy,
    /// Particles per volume, where they are counted \[1/m³\].
    NumberDensity,
    /// Their contacts per volume, a contact counted for either \[1/m³\].
    ContactDensity,
}

/// Number of terms in `dimension` dimensions, filled up to whole [`Lanes`](crate::lanes::Lanes).
#[inline(always)]
pub const fn term_count(dimension: usize) -> usize {
    own_terms(dimension).next_multiple_of(LANES)
}

/// Sets the `terms` at a position with these `moments`, by [`Term`]; what two dimensions lack is left
/// as it is. `microscopic_beta` is the fine-grid law's β(φ̄, |s|) \[kg/m³/s\].
#[inline(always)]
pub fn terms<N: Number, const D: usize>(
    moments: &Moments<N, D>,
    microscopic_beta: N,
    densities: Densities,
    terms: &mut [N; TERM_COUNT],
) {
    let z = D - 1;
    macro_rules! set {
        ($term:expr, $value:expr $(,)?) => {
            terms[$term as usize] = $value
        };
    }
    let one = N::of(1.0);
    let fraction = moments.solids_fraction;
    let slip = moments.slip();
    set!(Term::Positions, one);
    set!(Term::SolidsFraction, fraction);
    set!(Term::GasFraction, one - fraction);
    set!(Term::Slip, slip[z]);
    set!(Term::SlipSquared, slip[z] * slip[z]);
    set!(Term::SlipSpeed, dot(&slip, &slip).sqrt());
    let gradient = moments.fraction_gradient;
    set!(Term::FractionGradient, dot(&gradient, &gradient).sqrt());
    set!(Term::Variance, moments.solids_fraction_variance());
    set!(Term::SolidsFlux, moments.solids_flux[z]);
    set!(Term::GasFlux, moments.gas_flux[z]);

    let drag = moments.drag;
    let push = moments.pressure_gradient[z];
    let fluctuation = moments.pressure_fluctuation();
    set!(Term::PressureGradient, push);
    set!(Term::PressureGradientSquared, push * push);
    set!(Term::Drag, drag[z]);
    set!(Term::DragPressureGradient, drag[z] * push);
    set!(Term::PressureFluctuation, fluctuation[z]);
    set!(Term::MicroscopicDrag, microscopic_beta * slip[z]);
    set!(Term::LateralDrag, lateral(&drag, &slip));
    set!(Term::LateralPressureFluctuation, lateral(&fluctuation, &slip));
    set!(Term::LateralMicroscopicDrag, microscopic_beta * lateral(&slip, &slip));

    let seen = moments.seen_gas_flux[z] - moments.solids_flux[z];
    set!(Term::SeenSlipFlux, seen);
    set!(Term::DragCoefficient, moments.drag_coefficient);
    set!(Term::DragCovariance, drag[z] - moments.drag_coefficient * favre(seen, fraction));
    let drift_flux = moments.drift_flux()[z];
    let drift = favre(drift_flux, fraction);
    set!(Term::DriftFlux, drift_flux);
    set!(Term::DriftVelocity, drift);
    set!(Term::DriftSlip, drift * slip[z]);
    set!(Term::FractionTemperature, moments.fraction_temperature);

    let per_dimension = N::of(1.0 / D as f64);
    let kinetic = moments.kinetic_stress;
    let (solids_density, gas_density) = (N::of(densities.solids), N::of(densities.gas));
    let (residual, gas_residual) = (moments.residual_stress(), moments.gas_residual_stress());
    let residual: [[N; D]; D] = tensor!(D, |i, j| solids_density * residual[i][j]);
    let gas_residual: [[N; D]; D] = tensor!(D, |i, j| gas_density * gas_residual[i][j]);
    // The trace vanishes if the simulator's deviator is that of D directions, and belongs to the
    // pressure if it is that of three.
    let pressure = moments.kinetic_pressure;
    set!(Term::KineticPressure, pressure + trace(&kinetic) * per_dimension);
    set!(Term::ResidualPressure, trace(&residual) * per_dimension);
    set!(Term::GasResidualPressure, trace(&gas_residual) * per_dimension);

    let solids_gradient = moments.solids_velocity_gradient();
    let rate = deviatoric_rate(&solids_gradient);
    let squared = N::of(2.0) * contract(&rate, &rate);
    let shear_rate = squared.sqrt();
    let residual_dissipation = -contract(&residual, &rate);
    set!(Term::ShearRate, shear_rate);
    set!(Term::ShearRateSquared, squared);
    let cubed = squared * shear_rate;
    set!(Term::ShearRateCubed, cubed);
    set!(Term::FractionShearRateCubed, fraction * cubed);
    set!(Term::KineticDissipation, -contract(&kinetic, &rate));
    set!(Term::ResidualDissipation, residual_dissipation);
    set!(Term::ResidualShear, residual_dissipation / shear_rate.at_least(f64::MIN_POSITIVE));
    let gas_gradient = moments.gas_velocity_gradient();
    let gas_rate = deviatoric_rate(&gas_gradient);
    let gas_squared = N::of(2.0) * contract(&gas_rate, &gas_rate);
    set!(Term::GasShearRateSquared, gas_squared);
    let gas_cubed = gas_squared * gas_squared.sqrt();
    set!(Term::GasShearRateCubed, gas_cubed);
    set!(Term::GasFractionShearRateCubed, (one - fraction) * gas_cubed);
    set!(Term::GasResidualDissipation, -contract(&gas_residual, &gas_rate));

    let (solids, gas) = (moments.favre_solids_velocity(), moments.favre_gas_velocity());
    let filtered_power = contract(&kinetic, &solids_gradient) + pressure * trace(&solids_gradient);
    let gas_push: [N; D] = vector!(D, |axis| moments.pressure_gradient[axis]
        - moments.fraction_pressure_gradient[axis]);
    set!(Term::SolidsProduction, -contract(&residual, &solids_gradient));
    set!(Term::SolidsDragWork, moments.drag_on_solids - dot(&drag, &solids));
    set!(
        Term::SolidsPressureWork,
        dot(&moments.fraction_pressure_gradient, &solids) - moments.pressure_on_solids,
    );
    set!(Term::SolidsDissipation, filtered_power - moments.stress_power);
    set!(Term::GasProduction, -contract(&gas_residual, &gas_gradient));
    set!(Term::GasDragWork, dot(&drag, &gas) - moments.drag_on_gas);
    set!(Term::GasPressureWork, dot(&gas_push, &gas) - moments.pressure_on_gas);

    // The last direction is vertical, and called z in two dimensions too.
    set!(Term::KineticStressXx, kinetic[0][0] + pressure);
    set!(Term::KineticStressXz, kinetic[0][z]);
    set!(Term::KineticStressZz, kinetic[z][z] + pressure);
    set!(Term::ResidualStressXx, residual[0][0]);
    set!(Term::ResidualStressXz, residual[0][z]);
    set!(Term::ResidualStressZz, residual[z][z]);
    set!(Term::GasResidualStressXx, gas_residual[0][0]);
    set!(Term::GasResidualStressXz, gas_residual[0][z]);
    set!(Term::GasResidualStressZz, gas_residual[z][z]);
    if D == 3 {
        set!(Term::KineticStressXy, kinetic[0][1]);
        set!(Term::KineticStressYz, kinetic[1][z]);
        set!(Term::KineticStressYy, kinetic[1][1] + pressure);
        set!(Term::ResidualStressXy, residual[0][1]);
        set!(Term::ResidualStressYz, residual[1][z]);
        set!(Term::ResidualStressYy, residual[1][1]);
        set!(Term::GasResidualStressXy, gas_residual[0][1]);
        set!(Term::GasResidualStressYz, gas_residual[1][z]);
        set!(Term::GasResidualStressYy, gas_residual[1][1]);
        set!(Term::NumberDensity, moments.number_density);
        set!(Term::ContactDensity, moments.contact_density);
    }
}

/// Physical kind of a quantity: its SI unit and what it is scaled by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A number.
    Number,
    /// Scaled by u_t.
    Velocity,
    /// Scaled by u_t².
    SquaredVelocity,
    /// Scaled by ρ_s u_t².
    Stress,
    /// Scaled by ρ_s u_t³/g.
    Viscosity,
    /// Scaled by ρ_s g.
    Force,
    /// Scaled by ρ_s g/u_t.
    DragCoefficient,
    /// Scaled by ρ_s g u_t.
    Power,
    /// Scaled by g/u_t.
    Rate,
    /// Scaled by g/u_t².
    Gradient,
}

impl Kind {
    /// SI unit; `-` for a number.
    pub const fn unit(self) -> &'static str {
        match self {
            Kind::Number => "-",
            Kind::Velocity => "m/s",
            Kind::SquaredVelocity => "m²/s²",
            Kind::Stress => "Pa",
            Kind::Viscosity => "Pa·s",
            Kind::Force => "Pa/m",
            Kind::DragCoefficient => "kg/m³/s",
            Kind::Power => "W/m³",
            Kind::Rate => "1/s",
            Kind::Gradient => "1/m",
        }
    }

    /// What a value in SI is divided by to be scaled.
    pub fn scale(self, scales: &Scales) -> f64 {
        let weight = scales.density * scales.gravity;
        match self {
            Kind::Number => 1.0,
            Kind::Velocity => scales.terminal_velocity,
            Kind::SquaredVelocity => scales.terminal_velocity.powi(2),
            Kind::Stress => scales.stress(),
            Kind::Viscosity => scales.viscosity(),
            Kind::Force => weight,
            Kind::DragCoefficient => weight / scales.terminal_velocity,
            Kind::Power => weight * scales.terminal_velocity,
            Kind::Rate => 1.0 / scales.time(),
            Kind::Gradient => 1.0 / scales.length_i(),
        }
    }
}

/// How the value follows from the ratio Σ numerator / Σ denominator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Map {
    /// The ratio itself.
    Ratio,
    /// 1 - ratio.
    OneMinusRatio,
}

impl Map {
    /// The value for a ratio of sums. Its error is the ratio's, whichever the map.
    pub fn value(self, ratio: f64) -> f64 {
        match self {
            Map::Ratio => ratio,
            Map::OneMinusRatio => 1.0 - ratio,
        }
    }

    /// The interval of the value for one of the ratio, lower end first.
    pub fn interval(self, [low, high]: [f64; 2]) -> [f64; 2] {
        match self {
            Map::Ratio => [low, high],
            Map::OneMinusRatio => [1.0 - high, 1.0 - low],
        }
    }
}

/// What the denominator of a ratio is multiplied by, beside the sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Factor {
    /// 1.
    One,
    /// ρ_s Δ_f² \[kg/m\].
    SolidsSmagorinsky,
    /// ρ_g Δ_f² \[kg/m\].
    GasSmagorinsky,
    /// 2 ρ_s \[kg/m³\].
    TwiceSolidsDensity,
    /// 2 ρ_g \[kg/m³\].
    TwiceGasDensity,
}

impl Factor {
    /// Its value for a filter of width Δ_f \[m\].
    pub fn value(self, densities: Densities, filter_width: f64) -> f64 {
        match self {
            Factor::One => 1.0,
            Factor::SolidsSmagorinsky => densities.solids * filter_width * filter_width,
            Factor::GasSmagorinsky => densities.gas * filter_width * filter_width,
            Factor::TwiceSolidsDensity => 2.0 * densities.solids,
            Factor::TwiceGasDensity => 2.0 * densities.gas,
        }
    }
}

/// How a quantity follows from the sums of the terms over the positions of a bin.
#[derive(Clone, Copy, Debug)]
pub enum Formula {
    /// Σ (terms with their signs) / (factor Σ term).
    Ratio(&'static [(f64, Term)], Term, Factor),
    /// Slope of y against x, intercept free: Σ (x-x̄)(y-ȳ) / Σ (x-x̄)².
    Slope {
        /// x.
        x: Term,
        /// y.
        y: Term,
        /// x².
        xx: Term,
        /// x y.
        xy: Term,
    },
}

impl Formula {
    /// Numerator and denominator that sums of terms, of the whole bin or of one block of it, stand
    /// for; `mean` are the means of x and y over the bin, which only a slope asks for.
    #[inline(always)]
    pub fn pair(&self, sums: &[f64], mean: [f64; 2], factor: f64) -> [f64; 2] {
        let sum = |term: Term| sums[term as usize];
        match *self {
            Formula::Ratio(numerator, denominator, _) => [
                numerator.iter().map(|&(sign, term)| sign * sum(term)).sum(),
                factor * sum(denominator),
            ],
            Formula::Slope { x, y, xx, xy } => {
                let ([mean_x, mean_y], n) = (mean, sum(Term::Positions));
                [
                    sum(xy) - mean_x * sum(y) - mean_y * sum(x) + n * mean_x * mean_y,
                    sum(xx) - 2.0 * mean_x * sum(x) + n * mean_x * mean_x,
                ]
            }
        }
    }

    /// Means of x and y of a slope, for [`Formula::pair`].
    pub fn mean(&self, sums: &[f64]) -> [f64; 2] {
        match *self {
            Formula::Ratio(..) => [0.0; 2],
            Formula::Slope { x, y, .. } => {
                [x, y].map(|term| sums[term as usize] / sums[Term::Positions as usize])
            }
        }
    }

    /// The factor of the denominator.
    pub fn factor(&self, densities: Densities, filter_width: f64) -> f64 {
        match self {
            Formula::Ratio(.., factor) => factor.value(densities, filter_width),
            Formula::Slope { .. } => 1.0,
        }
    }
}

/// A reported quantity: a ratio of two sums over the filter positions of a bin, so that table,
/// errors and resampling treat all quantities alike.
#[derive(Clone, Copy, Debug)]
pub struct Quantity {
    /// Name in tables.
    pub name: &'static str,
    /// Unit and scale.
    pub kind: Kind,
    /// From ratio to value.
    pub map: Map,
    /// The ratio.
    pub formula: Formula,
    /// Whether it needs a third dimension.
    pub only_3d: bool,
}

macro_rules! quantities {
    ($($(#[$doc:meta])* $name:literal $kind:ident $map:ident $formula:expr;)*) => {
        /// All reported quantities, in the order of the tables. Sums are over the positions of a bin.
        ///
        /// | name | value |
        /// | --- | --- |
        $($(#[$doc])*)*
        pub const QUANTITIES: [Quantity; QUANTITY_COUNT] = [
            $(Quantity {
                name: $name,
                kind: Kind::$kind,
                map: Map::$map,
                formula: $formula,
                only_3d: is_third($name),
            }),*
        ];

        /// Number of quantities.
        pub const QUANTITY_COUNT: usize = [$($name),*].len();
    };
}

/// Whether a name ends with a component of the direction that two dimensions lack, or is of particles.
const fn is_third(name: &str) -> bool {
    let name = name.as_bytes();
    if name.len() > 12 && name[0] == b'c' && name[1] == b'o' && name[2] == b'o' {
        return true;
    }
    let (a, b) = (name[name.len() - 2], name[name.len() - 1]);
    name[name.len() - 3] == b'_' && (a == b'y' || b == b'y')
}

/// Σ numerator / Σ denominator.
const fn ratio(numerator: &'static [(f64, Term)], denominator: Term) -> Formula {
    Formula::Ratio(numerator, denominator, Factor::One)
}

/// Mean over the positions.
const fn mean(term: &'static [(f64, Term)]) -> Formula {
    ratio(term, Term::Positions)
}

use Term as T;
quantities! {
    /// | `drag_correction` | H = 1 - Σ(filt(f) - filt(φ' ∂p'/∂z)) / Σ β_micro s, vertical |
    "drag_correction" Number OneMinusRatio ratio(&[(1.0, T::Drag), (-1.0, T::PressureFluctuation)], T::MicroscopicDrag);
    /// | `drag_correction_no_pressure` | 1 - Σ filt(f) / Σ β_micro s, vertical |
    "drag_correction_no_pressure" Number OneMinusRatio ratio(&[(1.0, T::Drag)], T::MicroscopicDrag);
    /// | `drag_correction_lateral` | 1 - Σ(filt(f) - filt(φ' ∇p'))·s / Σ β_micro s·s, lateral |
    "drag_correction_lateral" Number OneMinusRatio ratio(&[(1.0, T::LateralDrag), (-1.0, T::LateralPressureFluctuation)], T::LateralMicroscopicDrag);
    /// | `drag_correction_lateral_no_pressure` | 1 - Σ filt(f)·s / Σ β_micro s·s, lateral |
    "drag_correction_lateral_no_pressure" Number OneMinusRatio ratio(&[(1.0, T::LateralDrag)], T::LateralMicroscopicDrag);
    /// | `drag_coefficient` | β_f = Σ(filt(f) - filt(φ' ∂p'/∂z)) / Σ s, vertical |
    "drag_coefficient" DragCoefficient Ratio ratio(&[(1.0, T::Drag), (-1.0, T::PressureFluctuation)], T::Slip);
    /// | `drag_coefficient_no_pressure` | Σ filt(f) / Σ s, vertical |
    "drag_coefficient_no_pressure" DragCoefficient Ratio ratio(&[(1.0, T::Drag)], T::Slip);
    /// | `drag` | mean of filt(f) - filt(φ' ∂p'/∂z), vertical |
    "drag" Force Ratio mean(&[(1.0, T::Drag), (-1.0, T::PressureFluctuation)]);
    /// | `drag_no_pressure` | mean of filt(f), vertical |
    "drag_no_pressure" Force Ratio mean(&[(1.0, T::Drag)]);
    /// | `drag_pressure_slope` | slope of filt(f) on filt(∂p/∂z) |
    "drag_pressure_slope" Number Ratio Formula::Slope { x: T::PressureGradient, y: T::Drag, xx: T::PressureGradientSquared, xy: T::DragPressureGradient };
    /// | `drag_covariance` | share of the drag that is the covariance of drag coefficient and slip, Σ(filt(f) - filt(β) filt(φ (u_g-u_s))/φ̄) / Σ filt(f) |
    "drag_covariance" Number Ratio ratio(&[(1.0, T::DragCovariance)], T::Drag);
    /// | `slip` | mean vertical filtered slip |
    "slip" Velocity Ratio mean(&[(1.0, T::Slip)]);
    /// | `slip_speed` | mean of \|s\| |
    "slip_speed" Velocity Ratio mean(&[(1.0, T::SlipSpeed)]);
    /// | `slip_seen` | slip that the particles see, Σ filt(φ (u_g-u_s)) / Σ φ̄, vertical |
    "slip_seen" Velocity Ratio ratio(&[(1.0, T::SeenSlipFlux)], T::SolidsFraction);
    /// | `solids_velocity` | Favre velocity Σ φ̄ ũ_s / Σ φ̄, vertical |
    "solids_velocity" Velocity Ratio ratio(&[(1.0, T::SolidsFlux)], T::SolidsFraction);
    /// | `gas_velocity` | Favre velocity Σ (1-φ̄) ũ_g / Σ (1-φ̄), vertical |
    "gas_velocity" Velocity Ratio ratio(&[(1.0, T::GasFlux)], T::GasFraction);
    /// | `drift_velocity` | Σ φ̄ v_d / Σ φ̄, vertical |
    "drift_velocity" Velocity Ratio ratio(&[(1.0, T::DriftFlux)], T::SolidsFraction);
    /// | `drift_velocity_slope` | slope of v_d on s, vertical |
    "drift_velocity_slope" Number Ratio Formula::Slope { x: T::Slip, y: T::DriftVelocity, xx: T::SlipSquared, xy: T::DriftSlip };
    /// | `solids_fraction_variance` | mean of filt(φ²) - φ̄² |
    "solids_fraction_variance" Number Ratio mean(&[(1.0, T::Variance)]);
    /// | `solids_fraction_gradient` | mean of \|∇φ̄\| |
    "solids_fraction_gradient" Gradient Ratio mean(&[(1.0, T::FractionGradient)]);
    /// | `pressure_gradient` | mean of filt(∂p/∂z), periodic part |
    "pressure_gradient" Force Ratio mean(&[(1.0, T::PressureGradient)]);
    /// | `shear_rate` | mean of S of the solids |
    "shear_rate" Rate Ratio mean(&[(1.0, T::ShearRate)]);
    /// | `solids_pressure_kinetic` | mean isotropic part of the filtered kinetic-theory stress |
    "solids_pressure_kinetic" Stress Ratio mean(&[(1.0, T::KineticPressure)]);
    /// | `solids_pressure_residual` | mean of tr R / D |
    "solids_pressure_residual" Stress Ratio mean(&[(1.0, T::ResidualPressure)]);
    /// | `solids_pressure` | their sum |
    "solids_pressure" Stress Ratio mean(&[(1.0, T::KineticPressure), (1.0, T::ResidualPressure)]);
    /// | `solids_viscosity_kinetic` | Σ(-τ:Sd) / Σ S²: slope of the stress on the rate, through the origin |
    "solids_viscosity_kinetic" Viscosity Ratio ratio(&[(1.0, T::KineticDissipation)], T::ShearRateSquared);
    /// | `solids_viscosity_residual` | Σ(-R:Sd) / Σ S² |
    "solids_viscosity_residual" Viscosity Ratio ratio(&[(1.0, T::ResidualDissipation)], T::ShearRateSquared);
    /// | `solids_viscosity` | their sum |
    "solids_viscosity" Viscosity Ratio ratio(&[(1.0, T::KineticDissipation), (1.0, T::ResidualDissipation)], T::ShearRateSquared);
    /// | `solids_viscosity_slope` | slope of -R:Sd/S on S, intercept free |
    "solids_viscosity_slope" Viscosity Ratio Formula::Slope { x: T::ShearRate, y: T::ResidualShear, xx: T::ShearRateSquared, xy: T::ResidualDissipation };
    /// | `smagorinsky_viscosity` | C_μ = Σ(-R:Sd) / Σ ρ_s Δ_f² S³ |
    "smagorinsky_viscosity" Number Ratio Formula::Ratio(&[(1.0, T::ResidualDissipation)], T::ShearRateCubed, Factor::SolidsSmagorinsky);
    /// | `smagorinsky_pressure` | C_p = Σ(tr R / D) / Σ ρ_s Δ_f² S² |
    "smagorinsky_pressure" Number Ratio Formula::Ratio(&[(1.0, T::ResidualPressure)], T::ShearRateSquared, Factor::SolidsSmagorinsky);
    /// | `solids_dispersion` | C = D/(Δ_f² S) of momentum, filt(φ u'u') deviatoric = -2 φ̄ D Sd: Σ(-R:Sd) / Σ ρ_s Δ_f² φ̄ S³ |
    "solids_dispersion" Number Ratio Formula::Ratio(&[(1.0, T::ResidualDissipation)], T::FractionShearRateCubed, Factor::SolidsSmagorinsky);
    /// | `gas_pressure_residual` | mean of tr R_g / D |
    "gas_pressure_residual" Stress Ratio mean(&[(1.0, T::GasResidualPressure)]);
    /// | `gas_viscosity` | eddy viscosity Σ(-R_g:Sd) / Σ S², rates of the gas |
    "gas_viscosity" Viscosity Ratio ratio(&[(1.0, T::GasResidualDissipation)], T::GasShearRateSquared);
    /// | `gas_smagorinsky_viscosity` | C_g = Σ(-R_g:Sd) / Σ ρ_g Δ_f² S³, rates of the gas |
    "gas_smagorinsky_viscosity" Number Ratio Formula::Ratio(&[(1.0, T::GasResidualDissipation)], T::GasShearRateCubed, Factor::GasSmagorinsky);
    /// | `gas_dispersion` | C = D/(Δ_f² S) of momentum: Σ(-R_g:Sd) / Σ ρ_g Δ_f² (1-φ̄) S³, rates of the gas |
    "gas_dispersion" Number Ratio Formula::Ratio(&[(1.0, T::GasResidualDissipation)], T::GasFractionShearRateCubed, Factor::GasSmagorinsky);
    /// | `solids_stress_kinetic_xx` ... | mean filtered kinetic-theory stress, its isotropic part included; components xx, xz, zz, in three dimensions xy, yz, yy too; z is vertical |
    "solids_stress_kinetic_xx" Stress Ratio mean(&[(1.0, T::KineticStressXx)]);
    "solids_stress_kinetic_xz" Stress Ratio mean(&[(1.0, T::KineticStressXz)]);
    "solids_stress_kinetic_zz" Stress Ratio mean(&[(1.0, T::KineticStressZz)]);
    "solids_stress_kinetic_xy" Stress Ratio mean(&[(1.0, T::KineticStressXy)]);
    "solids_stress_kinetic_yz" Stress Ratio mean(&[(1.0, T::KineticStressYz)]);
    "solids_stress_kinetic_yy" Stress Ratio mean(&[(1.0, T::KineticStressYy)]);
    /// | `solids_stress_residual_xx` ... | mean of R |
    "solids_stress_residual_xx" Stress Ratio mean(&[(1.0, T::ResidualStressXx)]);
    "solids_stress_residual_xz" Stress Ratio mean(&[(1.0, T::ResidualStressXz)]);
    "solids_stress_residual_zz" Stress Ratio mean(&[(1.0, T::ResidualStressZz)]);
    "solids_stress_residual_xy" Stress Ratio mean(&[(1.0, T::ResidualStressXy)]);
    "solids_stress_residual_yz" Stress Ratio mean(&[(1.0, T::ResidualStressYz)]);
    "solids_stress_residual_yy" Stress Ratio mean(&[(1.0, T::ResidualStressYy)]);
    /// | `gas_stress_residual_xx` ... | mean of R_g |
    "gas_stress_residual_xx" Stress Ratio mean(&[(1.0, T::GasResidualStressXx)]);
    "gas_stress_residual_xz" Stress Ratio mean(&[(1.0, T::GasResidualStressXz)]);
    "gas_stress_residual_zz" Stress Ratio mean(&[(1.0, T::GasResidualStressZz)]);
    "gas_stress_residual_xy" Stress Ratio mean(&[(1.0, T::GasResidualStressXy)]);
    "gas_stress_residual_yz" Stress Ratio mean(&[(1.0, T::GasResidualStressYz)]);
    "gas_stress_residual_yy" Stress Ratio mean(&[(1.0, T::GasResidualStressYy)]);
    /// | `solids_anisotropy` | Σ R_zz / Σ(tr R / D): 1 if isotropic |
    "solids_anisotropy" Number Ratio ratio(&[(1.0, T::ResidualStressZz)], T::ResidualPressure);
    /// | `gas_anisotropy` | Σ R_g,zz / Σ(tr R_g / D) |
    "gas_anisotropy" Number Ratio ratio(&[(1.0, T::GasResidualStressZz)], T::GasResidualPressure);
    /// | `coordination_number` | mean number of others that a particle touches, where particles are followed one by one |
    "coordination_number" Number Ratio ratio(&[(1.0, T::ContactDensity)], T::NumberDensity);
    /// | `granular_temperature` | Σ filt(φ Θ) / Σ φ̄ |
    "granular_temperature" SquaredVelocity Ratio ratio(&[(1.0, T::FractionTemperature)], T::SolidsFraction);
    /// | `solids_energy` | sub-filter kinetic energy Σ tr R / Σ 2 ρ_s φ̄ |
    "solids_energy" SquaredVelocity Ratio Formula::Ratio(&[(1.0, T::ResidualStressXx), (1.0, T::ResidualStressYy), (1.0, T::ResidualStressZz)], T::SolidsFraction, Factor::TwiceSolidsDensity);
    /// | `gas_energy` | sub-filter kinetic energy Σ tr R_g / Σ 2 ρ_g (1-φ̄) |
    "gas_energy" SquaredVelocity Ratio Formula::Ratio(&[(1.0, T::GasResidualStressXx), (1.0, T::GasResidualStressYy), (1.0, T::GasResidualStressZz)], T::GasFraction, Factor::TwiceGasDensity);
    /// | `solids_production` | budget of the sub-filter kinetic energy of the solids: mean of -R:∇ũ_s |
    "solids_production" Power Ratio mean(&[(1.0, T::SolidsProduction)]);
    /// | `solids_drag_work` | mean of filt(f·u_s) - filt(f)·ũ_s |
    "solids_drag_work" Power Ratio mean(&[(1.0, T::SolidsDragWork)]);
    /// | `solids_pressure_work` | mean of -(filt(φ u_s·∇p) - ũ_s·filt(φ ∇p)) |
    "solids_pressure_work" Power Ratio mean(&[(1.0, T::SolidsPressureWork)]);
    /// | `solids_dissipation` | mean of -(filt(σ:∇u_s) - filt(σ):∇ũ_s), σ the kinetic-theory stress |
    "solids_dissipation" Power Ratio mean(&[(1.0, T::SolidsDissipation)]);
    /// | `gas_production` | the same of the gas: mean of -R_g:∇ũ_g |
    "gas_production" Power Ratio mean(&[(1.0, T::GasProduction)]);
    /// | `gas_drag_work` | mean of -(filt(f·u_g) - filt(f)·ũ_g) |
    "gas_drag_work" Power Ratio mean(&[(1.0, T::GasDragWork)]);
    /// | `gas_pressure_work` | mean of -(filt((1-φ) u_g·∇p) - ũ_g·filt((1-φ) ∇p)) |
    "gas_pressure_work" Power Ratio mean(&[(1.0, T::GasPressureWork)]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::scales::tests::{GAS, POWDER};

    const DENSITIES: Densities = Densities { solids: 1500.0, gas: 1.3 };

    /// Moments of a box with φ̄ = 0.2 in which the phases move as told, both sheared at `rate`.
    fn moments<const D: usize>(solids: [f64; D], gas: [f64; D], rate: f64) -> Moments<f64, D> {
        let mut gradient = [[0.0; D]; D];
        gradient[D - 1][0] = rate;
        // Dilation must not enter the deviator.
        (0..D).for_each(|i| gradient[i][i] = 5.0);
        let scaled = |a: [f64; D], by: f64| a.map(|a| by * a);
        Moments {
            solids_fraction: 0.2,
            solids_fraction_squared: 0.05,
            drag_coefficient: 3000.0,
            kinetic_pressure: 3.0,
            fraction_temperature: 0.2 * 0.004,
            stress_power: 40.0,
            drag_on_solids: 7.0,
            drag_on_gas: 11.0,
            pressure_on_solids: 13.0,
            pressure_on_gas: 17.0,
            solids_flux: scaled(solids, 0.2),
            gas_flux: scaled(gas, 0.8),
            seen_gas_flux: std::array::from_fn(|a| {
                0.2 * gas[a] - if a == D - 1 { 0.01 } else { 0.0 }
            }),
            drag: std::array::from_fn(|a| if a == D - 1 { 900.0 } else { -300.0 }),
            pressure_gradient: [50.0; D],
            fraction_pressure_gradient: [-90.0; D],
            fraction_gradient: std::array::from_fn(|a| [3.0, 4.0, 12.0][a]),
            solids_flux_velocity: tensor!(D, |i, j| 0.2 * solids[i] * solids[j]),
            gas_flux_velocity: tensor!(D, |i, j| 0.8 * gas[i] * gas[j]),
            kinetic_stress: [[0.0; D]; D],
            // The gradient of the flux of a velocity with this gradient.
            solids_flux_gradient: tensor!(D, |i, j| {
                0.2 * gradient[i][j] + solids[i] * [3.0, 4.0, 12.0][j]
            }),
            gas_flux_gradient: tensor!(D, |i, j| 0.8 * gradient[i][j]
                - gas[i] * [3.0, 4.0, 12.0][j]),
            number_density: 4e11,
            contact_density: 1e12,
        }
    }

    fn found<const D: usize>(moments: &Moments<f64, D>, beta: f64) -> [f64; TERM_COUNT] {
        let mut found = [0.0; TERM_COUNT];
        terms(moments, beta, DENSITIES, &mut found);
        found
    }

    fn value(name: &str, terms: &[f64], width: f64) -> f64 {
        let quantity = QUANTITIES.iter().find(|quantity| quantity.name == name).unwrap();
        let factor = quantity.formula.factor(DENSITIES, width);
        let [numerator, denominator] = quantity.formula.pair(terms, [0.0; 2], factor);
        quantity.map.value(numerator / denominator)
    }

    #[track_caller]
    fn close(found: f64, expected: f64) {
        assert!((found - expected).abs() < 1e-10 * expected.abs().max(1e-3), "{found} {expected}");
    }

    fn check_stress<const D: usize>() {
        let (density, width, viscosity) = (1500.0, 0.01, 0.7);
        let mut moments = moments([0.3; D], [0.1; D], 40.0);
        let gradient = moments.solids_velocity_gradient();
        for i in 0..D {
            for j in 0..D {
                let rate = if i == j { 5.0 } else { 0.0 };
                let rate = if (i, j) == (D - 1, 0) { 40.0 } else { rate };
                close(gradient[i][j], rate);
                close(moments.gas_velocity_gradient()[i][j], rate);
            }
        }
        let rate = deviatoric_rate(&gradient);
        assert!(trace(&rate).abs() < 1e-13);
        // A kinetic stress of viscosity 0.7; a residual stress of viscosity 1.4 and pressure 6 Pa;
        // one of the gas of viscosity 0.02 and pressure 0.5 Pa.
        moments.kinetic_stress = rate.map(|row| row.map(|rate| -2.0 * viscosity * rate));
        for i in 0..D {
            for j in 0..D {
                let one = if i == j { 1.0 } else { 0.0 };
                moments.solids_flux_velocity[i][j] +=
                    (6.0 * one - 4.0 * viscosity * rate[i][j]) / density;
                moments.gas_flux_velocity[i][j] += (0.5 * one - 0.04 * rate[i][j]) / 1.3;
            }
        }
        let terms = found(&moments, 1.0);
        let check = |name: &str, expected: f64| close(value(name, &terms, width), expected);
        // Simple shear du_z/dx: S is the shear rate.
        check("shear_rate", 40.0);
        check("solids_viscosity_kinetic", 0.7);
        check("solids_viscosity_residual", 1.4);
        check("solids_viscosity", 2.1);
        check("solids_pressure_kinetic", 3.0);
        check("solids_pressure_residual", 6.0);
        check("solids_pressure", 9.0);
        check("smagorinsky_viscosity", 1.4 / (density * width * width * 40.0));
        check("smagorinsky_pressure", 6.0 / (density * width * width * 1600.0));
        check("gas_viscosity", 0.02);
        check("gas_pressure_residual", 0.5);
        check("gas_smagorinsky_viscosity", 0.02 / (1.3 * width * width * 40.0));
        check("solids_dispersion", 1.4 / (density * 0.2 * width * width * 40.0));
        check("gas_dispersion", 0.02 / (1.3 * 0.8 * width * width * 40.0));
        check("granular_temperature", 0.004);
        if D == 3 {
            check("coordination_number", 2.5);
        }
        // Off the diagonal of z and x: Sd = 20.
        check("solids_stress_kinetic_xz", -2.0 * 0.7 * 20.0);
        check("solids_stress_kinetic_zz", 3.0);
        check("solids_stress_residual_xz", -2.0 * 1.4 * 20.0);
        check("solids_stress_residual_xx", 6.0);
        check("gas_stress_residual_xz", -2.0 * 0.02 * 20.0);
        check("gas_stress_residual_zz", 0.5);
        check("solids_stress_residual_yy", if D == 3 { 6.0 } else { 0.0 });
        check("solids_stress_residual_xy", 0.0);
        check("solids_anisotropy", 1.0);
        let d = D as f64;
        check("solids_energy", 0.5 * d * 6.0 / 1500.0 / 0.2);
        check("gas_energy", 0.5 * d * 0.5 / 1.3 / 0.8);
        // -R:∇u = -p tr∇u + μ S².
        check("solids_production", -6.0 * 5.0 * d + 1.4 * 1600.0);
        check("gas_production", -0.5 * 5.0 * d + 0.02 * 1600.0);
        check("solids_dissipation", 3.0 * 5.0 * d - 0.7 * 1600.0 - 40.0);
        let total_drag = 900.0 - 300.0 * (d - 1.0);
        check("solids_drag_work", 7.0 - 0.3 * total_drag);
        check("gas_drag_work", 0.1 * total_drag - 11.0);
        check("solids_pressure_work", -90.0 * 0.3 * d - 13.0);
        check("gas_pressure_work", (50.0 + 90.0) * 0.1 * d - 17.0);
    }

    #[test]
    fn stresses_give_their_viscosities_and_pressures() {
        check_stress::<2>();
        check_stress::<3>();
    }

    #[test]
    fn drag_and_drift_follow_their_definitions() {
        let moments = moments([0.1, -0.2], [0.0, 0.3], 0.0);
        close(moments.slip_speed(), 0.26f64.sqrt());
        let terms = found(&moments, 4000.0);
        let check = |name: &str, expected: f64| close(value(name, &terms, 0.01), expected);
        check("slip", 0.5);
        check("slip_speed", 0.26f64.sqrt());
        check("solids_velocity", -0.2);
        check("gas_velocity", 0.3);
        // Microscopic drag 4000 x 0.5; pressure fluctuation -90 - 0.2 x 50 = -100.
        check("drag_correction", 1.0 - 1000.0 / 2000.0);
        check("drag_correction_no_pressure", 1.0 - 900.0 / 2000.0);
        check("drag_coefficient", 1000.0 / 0.5);
        check("drag_coefficient_no_pressure", 900.0 / 0.5);
        check("drag", 1000.0);
        check("drag_no_pressure", 900.0);
        // Lateral slip -0.1: drag -300, of it -200 without the pressure; microscopic drag -400.
        check("drag_correction_lateral", 1.0 - 200.0 / 400.0);
        check("drag_correction_lateral_no_pressure", 1.0 - 300.0 / 400.0);
        check("drift_velocity", -0.05);
        // The particles see a slip of 0.5 - 0.05.
        check("slip_seen", 0.45);
        check("drag_covariance", (900.0 - 3000.0 * 0.45) / 900.0);
        check("solids_fraction_variance", 0.01);
        check("solids_fraction_gradient", 5.0);
        check("pressure_gradient", 50.0);
    }

    #[test]
    fn slopes_are_those_of_least_squares() {
        let (x, y) = ([1.0, 2.0, 4.0, 5.0], [3.0, 4.5, 8.0, 10.5]);
        let mut blocks = [[0.0; TERM_COUNT]; 2];
        for (n, (x, y)) in x.iter().zip(y).enumerate() {
            let sums = &mut blocks[n / 2];
            sums[T::Positions as usize] += 1.0;
            sums[T::PressureGradient as usize] += x;
            sums[T::Drag as usize] += y;
            sums[T::PressureGradientSquared as usize] += x * x;
            sums[T::DragPressureGradient as usize] += x * y;
        }
        let total: Vec<f64> = blocks[0].iter().zip(&blocks[1]).map(|(a, b)| a + b).collect();
        let slope = QUANTITIES.iter().find(|q| q.name == "drag_pressure_slope").unwrap().formula;
        let mean = slope.mean(&total);
        assert_eq!(mean, [3.0, 6.5]);
        let pairs = blocks.map(|sums| slope.pair(&sums, mean, 1.0));
        let [numerator, denominator] = [0, 1].map(|part| pairs[0][part] + pairs[1][part]);
        // Σ (x-3)(y-6.5) = 7 + 2 + 1.5 + 8, Σ (x-3)² = 10.
        close(numerator / denominator, 1.85);
        // What each block adds is as if its positions had been centred one by one.
        close(pairs[0][0], 9.0);
        close(pairs[0][1], 5.0);
    }

    #[test]
    fn quantities_have_their_own_names_and_scales() {
        let names: std::collections::BTreeSet<_> = QUANTITIES.iter().map(|q| q.name).collect();
        assert_eq!(names.len(), QUANTITY_COUNT);
        assert_eq!(QUANTITIES.iter().filter(|quantity| quantity.only_3d).count(), 10);
        let scales = Scales::new(&POWDER, &GAS, 9.81);
        for (kind, unit, scale) in [
            (Kind::Number, "-", 1.0),
            (Kind::Velocity, "m/s", 0.218_46),
            (Kind::SquaredVelocity, "m²/s²", 0.047_725),
            (Kind::Stress, "Pa", 71.59),
            (Kind::Viscosity, "Pa·s", 1.5942),
            (Kind::Force, "Pa/m", 14715.0),
            (Kind::DragCoefficient, "kg/m³/s", 6.736e4),
            (Kind::Power, "W/m³", 3214.6),
            (Kind::Rate, "1/s", 44.906),
            (Kind::Gradient, "1/m", 205.55),
        ] {
            assert_eq!(kind.unit(), unit);
            assert!((kind.scale(&scales) / scale - 1.0).abs() < 1e-4, "{unit}");
        }
    }
}
