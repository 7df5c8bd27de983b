//! [`Simulation`]: what the rest of Favre asks of whatever resolves the clusters of a periodic box.

use crate::dem::Sphere;
use crate::fine::FineFields;
use std::error::Error;
use std::fmt;
use std::io::{self, Read, Write};

/// Why a simulation cannot go on, or cannot take a state.
pub type Failure = Box<dyn Error + Send + Sync>;

/// A periodic box of `D` dimensions, simulated step by step.
pub trait Simulation<const D: usize> {
    /// Advances by one time step towards the time `until` \[s\], such that equal steps end there.
    ///
    /// # Errors
    /// The step failed; the state is of no use any more.
    fn step(&mut self, until: f64) -> Result<StepReport, Failure>;

    /// Simulated time \[s\].
    fn time(&self) -> f64;

    /// Means over the box.
    fn means(&self) -> Means<D>;

    /// Leaves the resolved fields of this instant in `fine`, at cell centres.
    fn fields(&self, fine: &mut FineFields<D>);

    /// The particles in the order of their numbers, if it follows them one by one.
    fn particles(&self) -> Option<Vec<Sphere>> {
        None
    }

    /// Slip of the uniform state at the box's mean solids fraction \[m/s\].
    fn uniform_slip(&self) -> f64;

    /// Writes all that the next step depends on.
    ///
    /// # Errors
    /// Those of `to`.
    fn save_state(&self, to: &mut dyn Write) -> io::Result<()>;

    /// Takes what [`Simulation::save_state`] wrote of a box of the same set-up, and goes on to the same
    /// bits.
    ///
    /// # Errors
    /// It is of another box, or damaged.
    fn restore_state(&mut self, from: &mut dyn Read) -> Result<(), Failure>;
}

/// Growth of the time step from one step to the next.
pub const GROWTH: f64 = 1.25;

/// First time step, and the longest ever, in u_t/g.
pub const FIRST_STEP: f64 = 1e-3;
/// See [`FIRST_STEP`].
pub const LONGEST_STEP: f64 = 0.05;

/// Largest viscosity and conductivity per mass, times dt and Σ 1/h², at which an explicit step is
/// stable and loses kinetic energy. Limits the step, and in nearly empty cells of the two-fluid model, whose
/// mean free path would stop every step, the diffusivities themselves.
pub const DIFFUSION: f64 = 0.36;

/// Remaining divergence of the volume flux, times dt, above which the pressure counts as not converged:
/// round-off stops single precision above the tolerance asked for, which is no failure.
pub const UNSOLVED: f64 = 0.1;

/// What limited a time step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// The growth from the step before.
    Growth,
    /// Advection by the solids.
    Solids,
    /// Advection by the gas.
    Gas,
    /// The solids' speed of sound.
    Sound,
    /// The longest step allowed.
    Longest,
    /// Viscosity or conductivity of the solids, or viscosity of the gas.
    Diffusion,
    /// The room left in cells that the solids fill.
    Packing,
    /// The rate at which drag changes a particle's velocity.
    Exchange,
}

impl Limit {
    /// All, in the order of their numbers (`limit as usize`).
    pub const ALL: [Self; 8] = [
        Self::Growth,
        Self::Solids,
        Self::Gas,
        Self::Sound,
        Self::Longest,
        Self::Diffusion,
        Self::Packing,
        Self::Exchange,
    ];
}

impl fmt::Display for Limit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Growth => "growth",
            Self::Solids => "solids advection",
            Self::Gas => "gas advection",
            Self::Sound => "granular sound",
            Self::Longest => "the longest step",
            Self::Diffusion => "viscosity and conductivity",
            Self::Packing => "packing",
            Self::Exchange => "drag on the particles",
        })
    }
}

/// How a step went.
#[derive(Clone, Copy, Debug)]
pub struct StepReport {
    /// Its length \[s\].
    pub dt: f64,
    /// What limited it.
    pub limit: Limit,
    /// Sub-steps of the gas's momentum transport; 0 if it is left out.
    pub gas_steps: usize,
    /// Pressure iterations.
    pub iterations: usize,
    /// Volume that the pressure left unaccounted for: largest |∇·(φ u_s + (1-φ) u_g)| dt \[-\].
    pub volume_residual: f64,
}

/// Means over the box at one instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Means<const D: usize> {
    /// ⟨(1-φ) u_g⟩/⟨1-φ⟩ - ⟨φ u_s⟩/⟨φ⟩, vertical \[m/s\].
    pub slip: f64,
    /// ⟨φ (u_g - u_s)⟩/⟨φ⟩, vertical: the slip that the particles see \[m/s\].
    pub particle_slip: f64,
    /// ⟨φ⟩ \[-\].
    pub solids_fraction: f64,
    /// ⟨φ²⟩ - ⟨φ⟩² \[-\].
    pub solids_fraction_variance: f64,
    /// Momentum of the mixture per volume, ghost mass included \[kg/m²/s\].
    pub momentum: [f64; D],
    /// Mean gas pressure gradient, upwards, over the weight of the mixture \[-\].
    pub pressure_gradient: f64,
}
