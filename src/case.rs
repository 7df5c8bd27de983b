//! [`Case`]: what is to be computed, resolved to SI, and the case file it is read from.
//!
//! A case file is TOML. Plain numbers are SI. A length may also be text with a unit: `"8 L_I"`,
//! `"3 d"`, `"75 um"` (m, cm, mm, um, the particle diameter d, the reference lengths L_I to L_V of
//! [`Scales`]); a time may be `"200 u_t/g"`, `"3 s"` or `"5 ms"`; a velocity `"0.25 u_t"` or
//! `"0.1 m/s"`. Unknown keys are refused.
//!
//! | section | key | meaning | accepted | default |
//! | --- | --- | --- | --- | --- |
//! | `[powder]` | `diameter` | particle diameter d | 1e-7 m to 0.1 m | - |
//! | | `density` | of one particle, ρ_s [kg/m³] | 1 to 30000, above the gas | - |
//! | | `restitution` | restitution coefficient e | 0 < e ≤ 1 | - |
//! | | `max_packing` | densest random packing φ_max | 0 < φ_max ≤ 0.74 | - |
//! | `[gas]` | `density` | ρ_g [kg/m³] | 1e-6 to 2000 | - |
//! | | `viscosity` | μ_g [Pa·s] | 1e-8 to 1 | - |
//! | `[box]` | `size` | edges of the periodic box, the last one vertical | two or three lengths | - |
//! | | `cells` | cells along each edge | even numbers from 8 | - |
//! | | `cell` | instead of `cells`: the edge of one cell | a length that divides every edge | - |
//! | | `solids_fraction` | mean solids fraction, or a list: one box each, pooled | 0 < φ < φ_max | - |
//! | `[physics]` | `solver` | what resolves the clusters: the two-fluid model, or particles in gas, which ask for three dimensions | `"two-fluid"`, `"cfd-dem"` | `"two-fluid"` |
//! | | `drag` | fine-grid drag law | `"wen-yu"`, `"gidaspow"`, `"beetstra"`, `"tenneti"` | `"wen-yu"` |
//! | | `radial_distribution` | how much crowding makes particles collide | `"princeton"`, `"carnahan-starling"`, `"ma-ahmadi"` | `"princeton"` |
//! | | `friction` | pressure of enduring contacts, and their viscosity if the law has one | `"barrier"`, `"none"`, `"schaeffer"`, `"johnson-jackson"`, `"srivastava-sundaresan"` | `"barrier"` |
//! | | `granular_energy` | how the granular temperature is found | `"transport"`, `"algebraic"` | `"transport"` |
//! | | `gas_inertia` | whether the gas carries momentum along, as in [`Terms`] | `true`, `false` | `true` |
//! | | `gas_stress` | whether the gas's viscosity acts between cells, as in [`Terms`] | `true`, `false` | `false` |
//! | | `drive` | what carries the weight: a mean gas pressure gradient that balances it, or one that keeps the gas flux, as in [`Drive`] | `"pressure-gradient"`, `"gas-flux"` | `"pressure-gradient"` |
//! | | `gas_flux` | with `"gas-flux"`: superficial gas velocity relative to the solids | 0.001 u_t to 1000 u_t | that of the uniform state |
//! | | `gravity` | g [m/s²] | 1e-3 to 1e4 | 9.81 |
//! | `[particles]` | `overlap` | with `"cfd-dem"`: deepest overlap, in d, of two particles that meet at u_t; sets the stiffness | 1e-4 to 0.05 | 0.01 |
//! | | `stiffness` | instead: the spring's, k_n [N/m] | above 0 | - |
//! | | `tangential_stiffness` | k_t/k_n | 0 to 1 | 2/7 |
//! | | `tangential_damping` | γ_t/γ_n | 0 to 1 | 0.5 |
//! | | `friction_coefficient` | Coulomb's, of two particles | 0 to 10 | 0.3 |
//! | | `steps_per_contact` | time steps in a contact, at least | 20 to 1000 | 25 |
//! | | `mapping` | how a particle is shared among cells | `"trilinear"`, `"divided"` | `"trilinear"` |
//! | | `smoothing` | standard deviation of what it is spread to by its shares and a Gaussian; 0: by its shares alone, which narrow with the cells | 0, or a length from that of the shares to a quarter of the box | 2.7 d, or 0.81 of a cell if that is wider |
//! | | `start` | where the particles start: at random places, on a cubic lattice, or as a table lists them (.csv, beside the case file; see [`resolved::start`](crate::resolved::start)) | `"random"`, `"lattice"`, a file's name | `"random"` |
//! | | `diameters` | several diameters, each with its share of the solids' volume, or a log-normal distribution; their Sauter mean is the powder's `diameter` | `[{ diameter = "60 um", share = 0.3 }, ...]`, `{ geometric_deviation = 1.2 }` (1.001 to 1.5) | all equal |
//! | | `mixture_drag` | how the drag law serves other diameters than the powder's: the law of equal spheres of each diameter, or that of the Sauter mean times d_i/d (van der Hoef et al. 2005) | `"own-diameter"`, `"van-der-hoef"` | `"own-diameter"` |
//! | | `cohesion` | force that parts two particles of diameter d over the weight of one, Bo = F_c/(m g) | 0 to 1e6 | 0 |
//! | `[filter]` | `widths` | edges of the box filters | whole cells along every axis, from 2 cells to half the box | 4, 8, 16 and 32 cells as far as they fit |
//! | | `kernel` | the filter's kernel | `"box"`, `"gaussian"`, `"diffusion"`, `"sharp"` | `"box"` |
//! | | `markers` | what results are binned by | `"solids_fraction"`, and up to two of `"slip"`, `"slip_speed"`, `"pressure_gradient"`, `"shear_rate"`, `"solids_fraction_gradient"`, `"solids_fraction_variance"` | `["solids_fraction"]` |
//! | | `solids_fraction_bin` | width of a bin | 1e-4 to φ_max | 0.02 |
//! | | `slip_bin` | width of a bin | 0.001 u_t to 10 u_t | `"0.25 u_t"` |
//! | | `<marker>_edges` | edges of the bins of that marker, instead | ascending numbers, scaled by u_t, ρ_s g, g/u_t or 1/L_I; or `"5 quantiles"` | `"5 quantiles"` of markers without a width |
//! | `[run]` | `duration` | simulated time of each box | a time above 0 | `"200 u_t/g"` |
//! | | `sample_interval` | time between samples | above 0, to a twentieth of the duration | `"0.5 u_t/g"`, or less if the duration asks for it |
//! | | `seed` | of the initial perturbation | a whole number | 1 |
//! | | `perturbation` | relative amplitude of the initial perturbation | 0 to 0.5 | 0.05 |
//! | | `precision` | of the simulator | `"f32"`, `"f64"` | `"f64"` |
//! | | `time_order` | order of the simulator's steps in time; those of second order cost three | 1, 2 | 1 |
//! | `[output]` | `fields` | snapshots of the fields, as the filter sees them | `"none"`, `"vti"`, `"npz"` | `"none"` |
//! | | `fields_interval` | time between snapshots | a whole multiple of `sample_interval` | `sample_interval` |
//!
//! Two stages: what was typed (types, units, places), then [`Case`] (SI, checked). Everything wrong
//! with a file is reported at once, each [`Problem`] with key, value, line and what is accepted.

mod file;
mod resolve;

use std::f64::consts::PI;
use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use crate::laws::contact::Contact;
use crate::laws::drag::{DragLaw, OwnDiameter, SphereDrag, VanDerHoef};
use crate::laws::scales::{Gas, Powder, Scales};
pub use file::Problem;
use file::{Kind, Problems, Quantity};
use resolve::{FEWEST_SAMPLES, TIME_EXPECTED, WHOLE, is_time, resolve};

/// The case that `favre run` computes when none is given: the founding paper's powder in air.
pub const DEFAULT: &str = include_str!("../examples/default.toml");

/// Largest case file read [bytes]: anything longer is not a case file.
const LONGEST_FILE: u64 = 1 << 20;

/// A case: everything a run needs to know, checked, in SI.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name, from the file's name (`default` for the embedded case).
    pub name: String,
    /// `[powder]`.
    pub powder: Powder,
    /// `[gas]`.
    pub gas: Gas,
    /// `[box]`.
    pub domain: Domain,
    /// `[physics]`.
    pub physics: Physics,
    /// `[particles]`, of a case that follows them: `solver = "cfd-dem"`.
    pub particles: Option<ParticlesCase>,
    /// `[filter]`.
    pub filter: FilterCase,
    /// `[run]`.
    pub run: RunCase,
    /// `[output]`.
    pub output: OutputCase,
}

/// `[box]`: the periodic box.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    /// Edge lengths \[m\], two or three; the last is vertical.
    pub size: Vec<f64>,
    /// Cells along each edge.
    pub cells: Vec<usize>,
    /// Mean solids fractions; one box is simulated for each, and their samples are pooled.
    pub solids_fractions: Vec<f64>,
}

/// `[physics]`: what is modelled, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Physics {
    /// `drag`: the fine-grid drag law.
    pub drag: DragChoice,
    /// `radial_distribution`: how much crowding makes particles collide.
    pub radial_distribution: RadialDistributionChoice,
    /// `friction`: the pressure of enduring contacts.
    pub friction: FrictionChoice,
    /// What of the equations is modelled.
    pub terms: Terms,
    /// `drive` and `gas_flux`: what carries the weight.
    pub drive: Drive,
    /// `gravity` [m/s²], a positive number.
    pub gravity: f64,
}

/// What resolves the clusters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum SolverChoice {
    /// [`TwoFluid`](crate::two_fluid::TwoFluid).
    TwoFluid,
    /// [`CfdDem`](crate::cfd_dem::CfdDem).
    CfdDem,
}

/// `[particles]`: what two particles do that touch, how gas and particles see each other, and how they start.
#[derive(Clone, Debug, PartialEq)]
pub struct ParticlesCase {
    /// The contact law, its restitution the powder's.
    pub contact: Contact,
    /// Time steps in a contact, at least.
    pub steps_per_contact: f64,
    /// How a particle is shared among cells.
    pub mapping: MappingChoice,
    /// Standard deviation of what it is spread to \[m\]; 0 for that of its shares in cells alone.
    pub smoothing: f64,
    /// `start` and `diameters`.
    pub start: ParticlesStart,
    /// How the drag law serves other diameters than the powder's.
    pub mixture: MixtureChoice,
    /// `cohesion`: granular Bond number of two particles of the powder's diameter \[-\].
    pub bond_number: f64,
}

/// What particles a box starts from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParticlesStart {
    /// Where they are.
    pub places: Places,
    /// Their diameters.
    pub diameters: Diameters,
}

/// Where particles start.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Places {
    /// At random places, none overlapping.
    #[default]
    Random,
    /// On a lattice, as nearly cubic as the box allows.
    Lattice,
    /// As this file (.csv) lists them.
    File(PathBuf),
}

/// Diameters of the particles.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Diameters {
    /// All the powder's.
    #[default]
    Equal,
    /// These \[m\], each with its share of the solids' volume; the shares add up to one.
    Shares(Vec<(f64, f64)>),
    /// Log-normally distributed, of this geometric standard deviation.
    LogNormal(f64),
}

/// How a drag law of equal spheres serves a mixture of diameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MixtureChoice {
    /// [`OwnDiameter`].
    OwnDiameter,
    /// [`VanDerHoef`].
    VanDerHoef,
}

/// How a particle is shared among cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum MappingChoice {
    /// By the distance of its centre from those of the cells, among the eight nearest.
    Trilinear,
    /// By what of the cube of its volume lies in each.
    Divided,
}

/// Standard deviation of what a particle is spread to, at least, unless the case says otherwise, in
/// diameters \[-\]: a Gaussian 6.4 d wide at half its height.
///
/// Shares alone narrow with the cells. Cells of 1.7 d hold less than half a particle each at φ = 0.05, and what
/// they hold then is noise, which the drag follows and the filter counts as clusters.
pub const SPREAD: f64 = 2.7;

/// Likewise in edges of a cell \[-\]: [`SPREAD`] on the founding study's cells of 10/3 d.
///
/// Narrow against a cell, drag depends on where in it particles are: by shares alone, 0.41 of a cell, a wave of
/// eight cells grows a seventh too slowly; with this, as linear theory says within a hundredth
/// (`favre verify --only cfd-dem`).
pub const SPREAD_IN_CELLS: f64 = 0.81;

/// The wider of the two for particles of `diameter` in cells of such edges \[m\].
pub fn default_spread(diameter: f64, edges: impl Iterator<Item = f64>) -> f64 {
    edges.fold(SPREAD * diameter, |width, edge| width.max(SPREAD_IN_CELLS * edge))
}

impl MappingChoice {
    /// Variance along an axis of what a particle of `diameter` is spread to by its shares in cells of edge
    /// `spacing`, over all of its places \[m²\]: that of a hat over two cells, h²/6, or of a cube of the
    /// particle's volume seen by cells, (h² + e²)/12.
    pub fn variance(self, spacing: f64, diameter: f64) -> f64 {
        match self {
            Self::Trilinear => spacing.powi(2) / 6.0,
            Self::Divided => (spacing.powi(2) + ((PI / 6.0).cbrt() * diameter).powi(2)) / 12.0,
        }
    }
}

/// What carries the weight. The mixture as a whole is at rest: a gradient that does not balance its
/// weight accelerates the frame of reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// A mean gas pressure gradient that balances the weight.
    PressureGradient,
    /// The mean gas pressure gradient that keeps the superficial gas velocity relative to the mean
    /// solids velocity, ⟨(1-φ) u_g⟩ - ⟨1-φ⟩ ⟨φ u_s⟩/⟨φ⟩ \[m/s\]; none for that of the uniform state.
    GasFlux(Option<f64>),
}

/// The names of [`Drive`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
enum DriveChoice {
    PressureGradient,
    GasFlux,
}

/// Terms of the equations that a case may leave out. What is left out costs nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Terms {
    /// `granular_energy`: how the granular temperature is found.
    pub granular_energy: GranularEnergyChoice,
    /// `gas_inertia`: whether the gas carries its momentum along, ∇·(ρ_g (1-φ) u_g u_g), which limits
    /// the time step. Its local part, ∂(ρ_g (1-φ) u_g)/∂t, is always there: it is all that a cell
    /// without solids has against the pressure. Without the other the frame matters (it is that of
    /// zero mixture momentum), and momentum is kept all the same.
    pub gas_inertia: bool,
    /// `gas_stress`: whether the deviatoric stress of the gas is there, τ = 2 μ_g S, S of u_g, with the
    /// molecular μ_g. It pushes each phase by its fraction, as the pressure does.
    pub gas_stress: bool,
}

impl Default for Terms {
    /// What a case gets that chooses nothing.
    fn default() -> Self {
        Self {
            granular_energy: GranularEnergyChoice::Transport,
            gas_inertia: true,
            gas_stress: false,
        }
    }
}

/// Fine-grid drag laws.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum DragChoice {
    /// [`WenYu`](crate::laws::drag::WenYu).
    WenYu,
    /// [`Gidaspow`](crate::laws::drag::Gidaspow).
    Gidaspow,
    /// [`Beetstra`](crate::laws::drag::Beetstra).
    Beetstra,
    /// [`Tenneti`](crate::laws::drag::Tenneti).
    Tenneti,
}

/// `with_drag!(choice, R, gas, powder, |law| expression)`: the expression with the law that is
/// chosen, in precision `R`. The one place that tells the choices apart, and a macro because each
/// law is a type.
macro_rules! with_drag {
    ($choice:expr, $real:ty, $gas:expr, $powder:expr, |$law:ident| $then:expr) => {
        with_drag!(@ $choice, $real, $gas, $powder, $law, $then,
            WenYu, Gidaspow, Beetstra, Tenneti)
    };
    (@ $choice:expr, $real:ty, $gas:expr, $powder:expr, $law:ident, $then:expr, $($name:ident),+) => {
        match $choice {
            $($crate::case::DragChoice::$name => {
                let $law = $crate::laws::drag::$name::<$real>::new($gas, $powder);
                $then
            })+
        }
    };
}
pub(crate) use with_drag;

impl DragChoice {
    /// The law, for `powder` in `gas`.
    pub fn law(self, gas: &Gas, powder: &Powder) -> Box<dyn DragLaw<f64>> {
        with_drag!(self, f64, gas, powder, |law| Box::new(law))
    }

    /// The law on each of many spheres, `powder`'s diameter that of reference.
    pub fn of_spheres(
        self,
        mixture: MixtureChoice,
        gas: &Gas,
        powder: &Powder,
    ) -> Box<dyn SphereDrag> {
        with_drag!(self, f64, gas, powder, |law| match mixture {
            MixtureChoice::OwnDiameter => Box::new(OwnDiameter(law)),
            MixtureChoice::VanDerHoef => Box::new(VanDerHoef(law)),
        })
    }
}

impl fmt::Display for DragChoice {
    /// The name in a case file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(quoted(self).trim_matches('"'))
    }
}

/// Radial distributions of particles in contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RadialDistributionChoice {
    /// [`Princeton`](crate::laws::kinetic_theory::Princeton).
    Princeton,
    /// [`CarnahanStarling`](crate::laws::kinetic_theory::CarnahanStarling).
    CarnahanStarling,
    /// [`MaAhmadi`](crate::laws::kinetic_theory::MaAhmadi).
    MaAhmadi,
}

/// `with_radial_distribution!(choice, R, powder, |radial| expression)`, as [`with_drag`].
macro_rules! with_radial_distribution {
    ($choice:expr, $real:ty, $powder:expr, |$radial:ident| $then:expr) => {
        match $choice {
            $crate::case::RadialDistributionChoice::Princeton => {
                let $radial = $crate::laws::kinetic_theory::Princeton::<$real>::new($powder);
                $then
            }
            $crate::case::RadialDistributionChoice::CarnahanStarling => {
                let $radial = $crate::laws::kinetic_theory::CarnahanStarling;
                $then
            }
            $crate::case::RadialDistributionChoice::MaAhmadi => {
                let $radial = $crate::laws::kinetic_theory::MaAhmadi::<$real>::new($powder);
                $then
            }
        }
    };
}
pub(crate) use with_radial_distribution;

/// Frictional pressures; the last three come with a viscosity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FrictionChoice {
    /// [`PackingBarrier`](crate::laws::friction::PackingBarrier).
    Barrier,
    /// [`Frictionless`](crate::laws::friction::Frictionless).
    None,
    /// [`Schaeffer`](crate::laws::friction::Schaeffer).
    Schaeffer,
    /// [`JohnsonJackson`](crate::laws::friction::JohnsonJackson).
    JohnsonJackson,
    /// [`SrivastavaSundaresan`](crate::laws::friction::SrivastavaSundaresan).
    SrivastavaSundaresan,
}

/// `with_friction!(choice, R, powder, u_t, |friction| expression)`, as [`with_drag`].
macro_rules! with_friction {
    ($choice:expr, $real:ty, $powder:expr, $terminal_velocity:expr, |$friction:ident| $then:expr) => {
        match $choice {
            $crate::case::FrictionChoice::Barrier => {
                let $friction = $crate::laws::friction::PackingBarrier::<$real>::new(
                    $powder,
                    $terminal_velocity,
                );
                $then
            }
            $crate::case::FrictionChoice::None => {
                let $friction = $crate::laws::friction::Frictionless;
                $then
            }
            $crate::case::FrictionChoice::Schaeffer => {
                let $friction = $crate::laws::friction::Schaeffer::<$real>::new($powder);
                $then
            }
            $crate::case::FrictionChoice::JohnsonJackson => {
                let $friction = $crate::laws::friction::JohnsonJackson::<$real>::new($powder);
                $then
            }
            $crate::case::FrictionChoice::SrivastavaSundaresan => {
                let $friction = $crate::laws::friction::SrivastavaSundaresan::<$real>::new($powder);
                $then
            }
        }
    };
}
pub(crate) use with_friction;

/// Ways to find the granular temperature.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum GranularEnergyChoice {
    /// Its balance equation is solved.
    Transport,
    /// What makes it and what dissipates it balance in each cell, as of
    /// [`EnergyBalance::at_once`](crate::laws::kinetic_theory::EnergyBalance::at_once): neither the
    /// solids nor conduction carry it, and none is kept. Shear and compression heat by the
    /// temperature of the step before.
    Algebraic,
}

/// `[filter]`: which filters, and by what their results are binned.
#[derive(Clone, Debug, PartialEq)]
pub struct FilterCase {
    /// Filter widths \[m\], ascending, each a whole number of cells along every axis.
    pub widths: Vec<f64>,
    /// What the results are binned by; `solids_fraction` always.
    pub markers: Vec<MarkerChoice>,
    /// Width of a bin of filtered solids fraction.
    pub solids_fraction_bin: f64,
    /// Width of a bin of vertical filtered slip, in u_t (used with the marker `slip`).
    pub slip_bin: f64,
    /// The filters' kernel.
    pub kernel: KernelChoice,
    /// Bins of markers that are not of equal width.
    pub edges: Vec<(MarkerChoice, EdgesChoice)>,
}

/// Kernels of filters.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KernelChoice {
    /// The mean over a box.
    #[default]
    Box,
    /// A Gaussian.
    Gaussian,
    /// An implicit step of diffusion.
    Diffusion,
    /// A spectrally sharp cut-off.
    Sharp,
}

/// Bins of a marker.
#[derive(Clone, Debug, PartialEq)]
pub enum EdgesChoice {
    /// Between these edges, scaled as the marker is; what lies beyond belongs to the outermost bins.
    Given(Vec<f64>),
    /// As many bins, of about equally many filter positions each.
    Quantiles(usize),
}

/// What filtered results are binned by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MarkerChoice {
    /// The filtered solids fraction.
    SolidsFraction,
    /// The vertical filtered slip over u_t.
    Slip,
    /// The filtered slip speed over u_t.
    SlipSpeed,
    /// The vertical filtered pressure gradient over ρ_s g.
    PressureGradient,
    /// The shear rate of the filtered solids velocity times u_t/g.
    ShearRate,
    /// The gradient of the filtered solids fraction times L_I.
    SolidsFractionGradient,
    /// The sub-filter variance of the solids fraction.
    SolidsFractionVariance,
}

/// The keys that give the bins of a marker.
const EDGE_KEYS: [(&str, MarkerChoice); 7] = [
    ("solids_fraction_edges", MarkerChoice::SolidsFraction),
    ("slip_edges", MarkerChoice::Slip),
    ("slip_speed_edges", MarkerChoice::SlipSpeed),
    ("pressure_gradient_edges", MarkerChoice::PressureGradient),
    ("shear_rate_edges", MarkerChoice::ShearRate),
    ("solids_fraction_gradient_edges", MarkerChoice::SolidsFractionGradient),
    ("solids_fraction_variance_edges", MarkerChoice::SolidsFractionVariance),
];

/// The lines of a case file that give the bins of markers.
fn edge_lines(edges: &[(MarkerChoice, EdgesChoice)]) -> String {
    let mut lines = String::new();
    for (marker, edges) in edges {
        let key = EDGE_KEYS.iter().find(|(_, other)| other == marker).map_or("", |(key, _)| key);
        let _ = match edges {
            EdgesChoice::Given(edges) => writeln!(lines, "{key} = {edges:?}"),
            EdgesChoice::Quantiles(count) => writeln!(lines, "{key} = \"{count} quantiles\""),
        };
    }
    lines
}

/// `[run]`: how long, how precisely, from which seed.
#[derive(Clone, Debug, PartialEq)]
pub struct RunCase {
    /// Simulated time of each box \[s\].
    pub duration: f64,
    /// Time between samples \[s\].
    pub sample_interval: f64,
    /// Seed of the initial perturbation.
    pub seed: u64,
    /// Relative amplitude of the initial perturbation of the solids fraction.
    pub perturbation: f64,
    /// Precision of the simulator.
    pub precision: Precision,
    /// Order of the simulator's steps in time, 1 or 2.
    pub time_order: u64,
}

/// Floating-point precision of the simulator. Statistics are always double.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub enum Precision {
    /// `f32`.
    #[serde(rename = "f32")]
    Single,
    /// `f64`.
    #[serde(rename = "f64")]
    Double,
}

/// `[output]`: what is kept of the fields.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputCase {
    /// In which format, if at all.
    pub fields: FieldsChoice,
    /// Time between snapshots \[s\], a whole multiple of the time between samples.
    pub fields_interval: f64,
}

/// Formats of snapshots.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldsChoice {
    /// None are written.
    None,
    /// VTK image data.
    Vti,
    /// NumPy archives.
    Npz,
}

/// Why there is no case.
#[derive(Debug, thiserror::Error)]
pub enum CaseError {
    /// The file cannot be read.
    #[error("cannot read the case file {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The path is a folder.
    #[error("{path} is a folder and a case file is expected, such as {path}/case.toml", path = path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
    },
    /// The file is longer than a case file can be.
    #[error("{path} is longer than {LONGEST_FILE} bytes: it is not a case file", path = path.display())]
    TooLong {
        /// The file.
        path: PathBuf,
    },
    /// The file is not text.
    #[error("{path}:{line}: not UTF-8 text: a case file is TOML in UTF-8", path = path.display())]
    NotText {
        /// The file.
        path: PathBuf,
        /// The first line with a byte that is not UTF-8.
        line: usize,
    },
    /// The file holds nothing.
    #[error(
        "{place} is empty: a case needs [powder], [gas] and [box]; `favre run --print-case` prints \
         a complete one"
    )]
    Empty {
        /// The file.
        place: String,
    },
    /// The file holds something that is not acceptable.
    #[error("{}", list(place, problems))]
    Invalid {
        /// The file.
        place: String,
        /// All that is wrong, in the order of the lines.
        problems: Vec<Problem>,
    },
    /// The duration that is to replace the file's is not acceptable.
    #[error("duration {value}: {why}")]
    Duration {
        /// The duration given.
        value: String,
        /// What is wrong and what would be accepted.
        why: String,
    },
}

/// The problems, each with its place; their number first if there are several.
fn list(place: &str, problems: &[Problem]) -> String {
    let mut text = String::new();
    if problems.len() > 1 {
        let _ = writeln!(text, "{place} has {} problems", problems.len());
    }
    for (n, problem) in problems.iter().enumerate() {
        let newline = if n > 0 { "\n" } else { "" };
        let _ = write!(text, "{newline}{place}:{problem}");
    }
    text
}

impl Case {
    /// Reads the case file at `path`; the case is named after the file.
    ///
    /// # Errors
    /// The file cannot be read, is not text, or is refused by [`Case::parse`].
    pub fn load(path: &Path) -> Result<Self, CaseError> {
        let read = |source| CaseError::Read { path: path.to_owned(), source };
        if path.is_dir() {
            return Err(CaseError::Folder { path: path.to_owned() });
        }
        let mut bytes = Vec::new();
        File::open(path)
            .map_err(read)?
            .take(LONGEST_FILE + 1)
            .read_to_end(&mut bytes)
            .map_err(read)?;
        if bytes.len() as u64 > LONGEST_FILE {
            return Err(CaseError::TooLong { path: path.to_owned() });
        }
        let text = String::from_utf8(bytes).map_err(|error| {
            let valid = &error.as_bytes()[..error.utf8_error().valid_up_to()];
            let line = valid.iter().filter(|byte| **byte == b'\n').count() + 1;
            CaseError::NotText { path: path.to_owned(), line }
        })?;
        let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
        let folder = path.parent().unwrap_or(Path::new(""));
        Self::parse_at(&text, &name, &path.display().to_string(), folder)
    }

    /// Reads the text of a case file; `name` becomes the case's name and stands in messages for
    /// the file. Files that it names are sought in the current folder.
    ///
    /// # Errors
    /// The text is empty, not TOML, or holds something that is not acceptable; all problems are
    /// reported together.
    pub fn parse(text: &str, name: &str) -> Result<Self, CaseError> {
        Self::parse_at(text, name, name, Path::new(""))
    }

    /// The case of fields that were made elsewhere, in a box of edges `size` \[m\] with `cells` cells
    /// and the mean solids fraction `solids_fraction`: from `text`, a case file without `[box]`, and
    /// where it has no `[run]` with samples every `interval` \[s\]. The box need not be one that Favre
    /// would simulate. `place` stands for the file in messages.
    ///
    /// # Errors
    /// As [`Case::parse`].
    pub fn of_fields(
        text: &str,
        place: &str,
        size: Vec<f64>,
        cells: Vec<usize>,
        solids_fraction: f64,
        interval: f64,
    ) -> Result<Self, CaseError> {
        let mut whole = format!(
            "{text}\n[box]\nsize = {size:?}\ncells = {cells:?}\nsolids_fraction = {solids_fraction:?}\n"
        );
        if !text.lines().any(|line| line.trim_start().starts_with("[run]")) {
            let duration = FEWEST_SAMPLES * interval;
            let _ =
                write!(whole, "[run]\nsample_interval = {interval:?}\nduration = {duration:?}\n");
        }
        let mut domain = Some(Domain { size, cells, solids_fractions: vec![solids_fraction] });
        let mut problems = Problems::new(&whole);
        let case = file::read(&whole, &mut problems)
            .and_then(|file| resolve(&file, "fields", domain.take(), Path::new(""), &mut problems));
        match case {
            Some(case) if problems.is_empty() => Ok(case),
            _ => {
                Err(CaseError::Invalid { place: place.to_owned(), problems: problems.into_list() })
            }
        }
    }

    /// Files that the text names are sought in `folder`.
    fn parse_at(text: &str, name: &str, place: &str, folder: &Path) -> Result<Self, CaseError> {
        let mut problems = Problems::new(text);
        let case = match file::read(text, &mut problems) {
            Some(file) => resolve(&file, name, None, folder, &mut problems),
            None if problems.is_empty() => {
                return Err(CaseError::Empty { place: place.to_owned() });
            }
            None => None,
        };
        match case {
            Some(case) if problems.is_empty() => Ok(case),
            _ => {
                Err(CaseError::Invalid { place: place.to_owned(), problems: problems.into_list() })
            }
        }
    }

    /// Replaces the simulated time of each box by `text`, such as `20 u_t/g`, `3 s` or `3`.
    ///
    /// # Errors
    /// The text is not a time above 0, or the time has no room for twenty samples.
    pub fn set_duration(&mut self, text: &str) -> Result<(), CaseError> {
        let refuse = |why| CaseError::Duration { value: format!("\"{text}\""), why };
        let quantity = match text.trim().parse::<f64>() {
            Ok(seconds) if seconds.is_finite() => Quantity::from_si(seconds),
            _ => Quantity::parse(text, Kind::Time).map_err(refuse)?,
        };
        let scales = self.scales();
        let duration = quantity.si(Some(&scales)).filter(|duration| is_time(*duration));
        let duration = duration.ok_or_else(|| refuse(TIME_EXPECTED.to_owned()))?;
        let least = FEWEST_SAMPLES * self.run.sample_interval;
        if least > duration * (1.0 + WHOLE) {
            return Err(refuse(format!(
                "a run must be {FEWEST_SAMPLES} sample intervals long: give at least {:.4} u_t/g \
                 ({:.4} s), or a shorter sample_interval in [run]",
                least / scales.time(),
                least
            )));
        }
        self.run.duration = duration;
        Ok(())
    }

    /// Number of axes, 2 or 3.
    pub fn dimension(&self) -> usize {
        self.domain.size.len()
    }

    /// The scales of the powder in the gas.
    pub fn scales(&self) -> Scales {
        Scales::new(&self.powder, &self.gas, self.physics.gravity)
    }

    /// What is acceptable but probably not meant, one sentence each.
    pub fn warnings(&self) -> Vec<String> {
        let scales = self.scales();
        let (l_i, l_ii) = (scales.length_i(), scales.length_ii());
        let mut warnings = Vec::new();
        let longest = self.domain.size.iter().copied().fold(0.0, f64::max);
        let coarsest = self.domain.spacing().into_iter().fold(0.0, f64::max);
        if longest > 1e4 * l_i {
            warnings.push(format!(
                "the box is {longest} m long, {:.0} L_I: sizes are in metres, is this in mm?",
                longest / l_i
            ));
        } else if coarsest > 8.0 * l_ii {
            // Twice as coarse, in particle-scale lengths, as the founding study's grid.
            warnings.push(format!(
                "a cell is {coarsest:.3e} m long, {:.1} L_II: clusters are smeared on cells longer \
                 than about 4 L_II = {:.3e} m",
                coarsest / l_ii,
                4.0 * l_ii
            ));
        }
        warnings
    }

    /// The case as a case file with every key, in SI; [`Case::parse`] reads an equal case from it.
    pub fn to_toml(&self) -> String {
        let Self { name: _, powder, gas, domain, physics, particles, filter, run, output } = self;
        // No number stands for the flux of the uniform state, which is each box's own.
        let (drive, gas_flux) = match physics.drive {
            Drive::PressureGradient => (DriveChoice::PressureGradient, String::new()),
            Drive::GasFlux(None) => (DriveChoice::GasFlux, String::new()),
            Drive::GasFlux(Some(flux)) => (DriveChoice::GasFlux, format!("gas_flux = {flux:?}\n")),
        };
        // What belongs to one of the solvers alone.
        let (continuum, numerics, discrete) = match particles {
            None => (
                format!(
                    "radial_distribution = {}\n\
                     friction = {}\n\
                     granular_energy = {}\n",
                    quoted(&physics.radial_distribution),
                    quoted(&physics.friction),
                    quoted(&physics.terms.granular_energy),
                ),
                format!(
                    "perturbation = {:?}\n\
                     precision = {}\n\
                     time_order = {}\n",
                    run.perturbation,
                    quoted(&run.precision),
                    run.time_order,
                ),
                String::new(),
            ),
            Some(ParticlesCase {
                contact,
                steps_per_contact,
                mapping,
                smoothing,
                start,
                mixture,
                bond_number,
            }) => (
                String::new(),
                String::new(),
                format!(
                    "\n[particles]\n\
                     stiffness = {:?}\n\
                     tangential_stiffness = {:?}\n\
                     tangential_damping = {:?}\n\
                     friction_coefficient = {:?}\n\
                     steps_per_contact = {steps_per_contact:?}\n\
                     cohesion = {bond_number:?}\n\
                     mapping = {}\n\
                     smoothing = {smoothing:?}\n\
                     start = {}\n\
                     {}mixture_drag = {}\n",
                    contact.stiffness,
                    contact.tangential_stiffness,
                    contact.tangential_damping,
                    contact.friction,
                    quoted(mapping),
                    start.places,
                    start.diameters,
                    quoted(mixture),
                ),
            ),
        };
        format!(
            "[powder]\n\
             diameter = {:?}\n\
             density = {:?}\n\
             restitution = {:?}\n\
             max_packing = {:?}\n\
             \n[gas]\n\
             density = {:?}\n\
             viscosity = {:?}\n\
             \n[box]\n\
             size = {:?}\n\
             cells = {:?}\n\
             solids_fraction = {:?}\n\
             \n[physics]\n\
             solver = {}\n\
             drag = {}\n\
             {continuum}\
             gas_inertia = {}\n\
             gas_stress = {}\n\
             drive = {}\n\
             {}gravity = {:?}\n\
             {discrete}\
             \n[filter]\n\
             widths = {:?}\n\
             kernel = {}\n\
             markers = {}\n\
             solids_fraction_bin = {:?}\n\
             slip_bin = \"{:?} u_t\"\n\
             {}\
             \n[run]\n\
             duration = {:?}\n\
             sample_interval = {:?}\n\
             seed = {}\n\
             {numerics}\
             \n[output]\n\
             fields = {}\n\
             fields_interval = {:?}\n",
            powder.diameter,
            powder.density,
            powder.restitution,
            powder.max_packing,
            gas.density,
            gas.viscosity,
            domain.size,
            domain.cells,
            domain.solids_fractions,
            quoted(&if particles.is_some() {
                SolverChoice::CfdDem
            } else {
                SolverChoice::TwoFluid
            }),
            quoted(&physics.drag),
            physics.terms.gas_inertia,
            physics.terms.gas_stress,
            quoted(&drive),
            gas_flux,
            physics.gravity,
            filter.widths,
            quoted(&filter.kernel),
            quoted(&filter.markers),
            filter.solids_fraction_bin,
            filter.slip_bin,
            edge_lines(&filter.edges),
            run.duration,
            run.sample_interval,
            run.seed,
            quoted(&output.fields),
            output.fields_interval,
        )
    }
}

impl fmt::Display for Places {
    /// The value in a case file.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Random => f.write_str("\"random\""),
            Self::Lattice => f.write_str("\"lattice\""),
            Self::File(path) => f.write_str(&quoted(&path.to_string_lossy())),
        }
    }
}

impl fmt::Display for Diameters {
    /// The line of a case file, if one is needed.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Equal => Ok(()),
            Self::Shares(classes) => {
                let class = |(diameter, share): &(f64, f64)| {
                    format!("{{ diameter = {diameter:?}, share = {share:?} }}")
                };
                let classes: Vec<String> = classes.iter().map(class).collect();
                writeln!(f, "diameters = [{}]", classes.join(", "))
            }
            Self::LogNormal(deviation) => {
                writeln!(f, "diameters = {{ geometric_deviation = {deviation:?} }}")
            }
        }
    }
}

impl fmt::Display for Case {
    /// Writes [`Case::to_toml`].
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.to_toml())
    }
}

impl Domain {
    /// Edge of a cell along each axis \[m\].
    pub fn spacing(&self) -> Vec<f64> {
        edges(&self.size, &self.cells).collect()
    }

    /// Shortest edge of a cell \[m\].
    pub fn shortest_spacing(&self) -> f64 {
        least(edges(&self.size, &self.cells))
    }
}

/// Edge of a cell along each axis of a box of so many cells \[m\].
fn edges(size: &[f64], cells: &[usize]) -> impl Iterator<Item = f64> {
    size.iter().zip(cells).map(|(size, cells)| size / *cells as f64)
}

/// The least of some numbers.
fn least(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(f64::INFINITY, f64::min)
}

/// A choice, or a list of choices, as it is typed in a case file.
fn quoted<T: serde::Serialize>(choice: &T) -> String {
    // JSON's strings and lists of plain names are TOML's too.
    serde_json::to_string(choice).expect("a choice is a name").replace(',', ", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A case with every key but `cell` and `gas_flux`, at its default where it has one.
    const TEXT: &str = r#"[powder]
diameter = 75e-6
density = 1500.0
restitution = 0.9
max_packing = 0.65
[gas]
density = 1.3
viscosity = 1.8e-5
[box]
size = [0.16, 0.16]
cells = [128, 128]
solids_fraction = [0.05, 0.15, 0.25, 0.35]
[physics]
drag = "wen-yu"
radial_distribution = "princeton"
friction = "barrier"
granular_energy = "transport"
gas_inertia = true
gas_stress = false
drive = "pressure-gradient"
gravity = 9.81
[filter]
widths = [0.005, 0.01, 0.02, 0.04]
markers = ["solids_fraction"]
solids_fraction_bin = 0.02
slip_bin = "0.25 u_t"
[run]
duration = "200 u_t/g"
sample_interval = "0.5 u_t/g"
seed = 1
perturbation = 0.05
precision = "f64"
"#;

    fn text_with(from: &str, to: &str) -> Result<Case, CaseError> {
        assert!(TEXT.contains(from), "{from} is not in the text");
        Case::parse(&TEXT.replacen(from, to, 1), "test")
    }

    /// The one problem of the text with `from` replaced by `to`.
    fn problem(from: &str, to: &str) -> Problem {
        match text_with(from, to) {
            Err(CaseError::Invalid { mut problems, .. }) if problems.len() == 1 => {
                problems.remove(0)
            }
            other => panic!("{to}: {other:?}"),
        }
    }

    #[test]
    fn the_default_case_is_the_founding_papers_powder_and_needs_no_warning() {
        let case = Case::parse(DEFAULT, "default").unwrap();
        assert_eq!(case.powder, crate::laws::scales::tests::POWDER);
        assert_eq!(case.gas, crate::laws::scales::tests::GAS);
        assert_eq!(case.warnings(), [""; 0]);
    }

    #[test]
    fn lengths_and_times_are_resolved_to_si() {
        let case = Case::parse(TEXT, "x").unwrap();
        assert_eq!((case.name.as_str(), case.dimension()), ("x", 2));
        assert_eq!(case.filter.widths, [0.005, 0.01, 0.02, 0.04]);
        assert!((case.run.duration - 200.0 * 0.218_46 / 9.81).abs() < 1e-4);
        let text = TEXT
            .replace("[0.16, 0.16]", "[\"32 L_I\", \"64 L_I\"]")
            .replace("[128, 128]", "[128, 256]")
            .replace("[0.005, 0.01, 0.02, 0.04]", "[\"4 L_I\", \"2 L_I\"]");
        let case = Case::parse(&text, "x").unwrap();
        let l_i = case.scales().length_i();
        assert_eq!(case.domain.size, [32.0 * l_i, 64.0 * l_i]);
        assert_eq!(case.filter.widths, [2.0 * l_i, 4.0 * l_i]);
        let text = TEXT.replace("[0.16, 0.16]", "[\"2000 d\", \"15 cm\"]").replace("widths =", "#");
        assert_eq!(Case::parse(&text, "x").unwrap().domain.size, [0.15, 0.15]);
    }

    #[test]
    fn the_default_case_names_every_key_but_the_alternative_one() {
        let particles = include_str!("../examples/cfd-dem.toml");
        for (section, keys) in file::SECTIONS {
            // Particles are of a case that follows them.
            let default = if section == "particles" { particles } else { DEFAULT };
            assert!(default.contains(&format!("[{section}]")));
            // Of edges it shows how; the flux of the uniform state has no number, and a width that goes by the
            // cells neither.
            let named = |key: &&&str| {
                !["cell", "gas_flux", "stiffness", "diameters", "smoothing"].contains(*key)
                    && !key.ends_with("_edges")
            };
            for key in keys.iter().filter(named) {
                assert!(default.contains(&format!("\n{key} = ")), "{key}");
            }
        }
        let shown = DEFAULT.replace("# slip_edges", "slip_edges");
        let shown = shown.replace("# shear_rate_edges", "shear_rate_edges");
        let markers = "markers = [\"solids_fraction\", \"slip\", \"shear_rate\"]";
        let shown = shown.replace("markers = [\"solids_fraction\"]", markers);
        assert_eq!(Case::parse(&shown, "default").unwrap().filter.edges.len(), 2);
    }

    #[test]
    fn what_is_optional_has_the_documented_defaults() {
        let start = TEXT.find("[physics]").unwrap();
        let brief = Case::parse(&TEXT[..start], "default").unwrap();
        assert_eq!(brief, Case::parse(TEXT, "default").unwrap());
    }

    #[test]
    fn a_resolved_case_reads_back_as_itself() {
        for text in [
            DEFAULT,
            include_str!("../examples/base-case.toml"),
            include_str!("../examples/box-3d.toml"),
            include_str!("../examples/cfd-dem.toml"),
            include_str!("../examples/geldart-b.toml"),
        ] {
            let case = Case::parse(text, "x").unwrap();
            assert_eq!(Case::parse(&case.to_toml(), "x").unwrap(), case);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn any_resolved_case_reads_back_as_itself(
            // Below some 20 µm a particle is longer than L_II and such cells are refused.
            diameter in 30e-6..1e-3f64,
            half_cells in 8usize..100,
            cell in 1.0..9.0f64,
            width in 2usize..8,
            slip_bin in 0.01..5.0f64,
            duration in 10.0..1000.0f64,
        ) {
            let cells = 2 * half_cells;
            let (edge, width) = (cell * cells as f64, cell * width as f64);
            let text = TEXT
                .replace("75e-6", &format!("{diameter:?}"))
                .replace("[0.16, 0.16]", &format!("[\"{edge:?} L_II\", \"{edge:?} L_II\"]"))
                .replace("[128, 128]", &format!("[{cells}, {cells}]"))
                .replace("[0.005, 0.01, 0.02, 0.04]", &format!("[\"{width:?} L_II\"]"))
                .replace("0.25 u_t\"", &format!("{slip_bin:?} u_t\""))
                .replace("200 u_t/g", &format!("{duration:?} u_t/g"));
            let case = Case::parse(&text, "x").unwrap();
            prop_assert_eq!(Case::parse(&case.to_toml(), "x").unwrap(), case);
        }

        #[test]
        fn no_text_makes_the_reader_panic(at in 0usize..TEXT.len(), typed in "\\PC{0,8}") {
            let mut text = TEXT.to_owned();
            prop_assume!(text.is_char_boundary(at));
            text.insert_str(at, &typed);
            if let Err(error) = Case::parse(&text, "x") {
                prop_assert!(error.to_string().starts_with("x"), "{}", error);
            }
        }
    }

    #[test]
    fn a_cell_edge_counts_the_cells() {
        let case = text_with("cells = [128, 128]", "cell = \"1.25 mm\"").unwrap();
        assert_eq!(case.domain.cells, [128, 128]);
        let refused = problem("cells = [128, 128]", "cell = 1.25e-3\ncells = [128, 128]");
        assert_eq!(refused.key, "[box] cell");
        let case = text_with("cells = [128, 128]", "cell = 1.2e-3");
        let Err(CaseError::Invalid { problems, .. }) = case else { panic!("{case:?}") };
        // Both edges and no consequence of theirs.
        assert_eq!(problems.len(), 2);
        assert!(problems[0].why.contains("0.1584 m or 0.1608 m"), "{}", problems[0].why);
        assert_eq!(problems[0].line, Some(10));
    }

    #[test]
    fn widths_are_whole_along_every_axis_and_the_nearest_are_named() {
        let refused = problem("0.005, 0.01,", "0.005, 0.012,");
        assert!(refused.why.ends_with("accepted nearest: 0.01125 m, 0.0125 m"), "{}", refused.why);
        let refused = problem("0.02, 0.04]", "0.02, 0.1]");
        assert!(refused.why.ends_with("accepted nearest: 0.08 m"), "{}", refused.why);
        let refused = problem("[0.005, ", "[0.00125, ");
        assert!(refused.why.ends_with("accepted nearest: 0.0025 m"), "{}", refused.why);

        // Cells of 1.25 mm x 1.875 mm have 3.75 mm in common.
        let case = text_with("[0.16, 0.16]", "[0.16, 0.24]");
        let Err(CaseError::Invalid { problems, .. }) = case else { panic!("{case:?}") };
        assert_eq!(problems.len(), 4);
        assert!(problems[0].why.ends_with("accepted nearest: 0.00375 m, 0.0075 m"));
    }

    #[test]
    fn widths_by_default_are_those_that_fit() {
        let text = &TEXT[..TEXT.find("[physics]").unwrap()];
        let text = text.replace("[128, 128]", "[32, 24]").replace("[0.16, 0.16]", "[0.32, 0.24]");
        let case = Case::parse(&text, "x").unwrap();
        assert_eq!(case.filter.widths, [0.04, 0.08]);
        let text = text.replace("[0.32, 0.24]", "[0.32, 0.2411]");
        let error = Case::parse(&text, "x").unwrap_err().to_string();
        assert!(error.contains("[filter] widths: missing"), "{error}");
        assert!(error.contains("cells (0.01 x 0.0100458 m)"), "{error}");
    }

    #[test]
    fn sizes_in_millimetres_are_warned_of_and_cells_below_a_particle_refused() {
        let text = TEXT[..TEXT.find("[physics]").unwrap()].replace("[0.16, 0.16]", "[160, 160]");
        let warnings = Case::parse(&text, "x").unwrap().warnings();
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].contains("is this in mm?"), "{warnings:?}");

        let text = text.replace("[160, 160]", "[0.64, 0.64]");
        let warnings = Case::parse(&text, "x").unwrap().warnings();
        assert!(warnings[0].contains("16.6 L_II"), "{warnings:?}");

        let refused = problem("[0.16, 0.16]", "[\"0.16 mm\", 0.16]");
        assert!(refused.why.contains("less than one particle"), "{}", refused.why);
        assert_eq!(refused.value.as_deref(), Some("\"0.16 mm\""));
    }

    #[test]
    fn the_duration_can_be_replaced() {
        let mut case = Case::parse(TEXT, "x").unwrap();
        case.set_duration("20 u_t/g").unwrap();
        assert!((case.run.duration / case.scales().time() - 20.0).abs() < 1e-12);
        case.set_duration("3").unwrap();
        assert_eq!(case.run.duration, 3.0);
        case.set_duration("10 u_t/g").unwrap();
        let before = case.clone();
        for wrong in ["9 u_t/g", "-3", "0", "", "soon", "nan", "3 m"] {
            let error = case.set_duration(wrong).unwrap_err().to_string();
            assert!(error.starts_with(&format!("duration \"{wrong}\": ")), "{error}");
        }
        assert_eq!(case, before);
    }

    #[test]
    fn a_short_run_samples_often_enough_by_default() {
        let refused = problem("\"200 u_t/g\"", "0.1");
        assert_eq!(refused.key, "[run] sample_interval");
        assert!(refused.why.ends_with("at most 0.005 s is accepted"), "{}", refused.why);
        let line = "sample_interval = \"0.5 u_t/g\"";
        let text = TEXT.replace("\"200 u_t/g\"", "0.1").replace(line, "");
        assert_eq!(Case::parse(&text, "x").unwrap().run.sample_interval, 0.1 / 20.0);
    }

    #[test]
    fn every_law_is_chosen_by_its_name_and_others_are_refused_with_the_list() {
        for (key, default, names) in [
            ("drag", "wen-yu", &["wen-yu", "gidaspow", "beetstra", "tenneti"] as &[&str]),
            ("radial_distribution", "princeton", &["princeton", "carnahan-starling", "ma-ahmadi"]),
            (
                "friction",
                "barrier",
                &["barrier", "none", "schaeffer", "johnson-jackson", "srivastava-sundaresan"],
            ),
            ("granular_energy", "transport", &["transport", "algebraic"]),
        ] {
            let line = format!("{key} = \"{default}\"");
            for name in names {
                let case = text_with(&line, &format!("{key} = \"{name}\"")).unwrap();
                assert!(case.to_toml().contains(&format!("{key} = \"{name}\"\n")));
                assert_eq!(Case::parse(&case.to_toml(), "test").unwrap(), case);
            }
            let refused = problem(&line, &format!("{key} = \"newton\""));
            assert_eq!(refused.key, format!("[physics] {key}"));
            for name in names {
                assert!(refused.why.contains(&format!("\"{name}\"")), "{}", refused.why);
            }
        }
        assert_eq!(DragChoice::WenYu.to_string(), "wen-yu");
    }

    #[test]
    fn particles_are_followed_where_they_can_be() {
        let text = include_str!("../examples/cfd-dem.toml");
        let case = Case::parse(text, "x").unwrap();
        let particles = case.particles.unwrap();
        // Two that meet at u_t overlap by 2 % of d: m*/2 v² = k/2 δ² gives 3.5 N/m, less what the dashpot
        // takes on the way, a tenth for e = 0.9.
        assert!((particles.contact.stiffness - 3.17).abs() < 0.01, "{particles:?}");
        assert_eq!(particles.contact.restitution, 0.9);
        // Finer cells do not narrow what a particle is spread to, unless that is asked for.
        let finer = text.replace("cells = [8, 8, 32]", "cells = [12, 12, 48]");
        let smoothing = |text: &str| Case::parse(text, "x").unwrap().particles.unwrap().smoothing;
        let coarser = text.replace("cells = [8, 8, 32]", "cells = [8, 8, 16]");
        let coarser = coarser.replace("\"1.66 L_II\", ", "");
        for (text, wanted) in
            [(text, 2.025e-4), (&finer, 2.025e-4), (&coarser, 0.81 * 26.56 / 16.0 * 3.012_5e-4)]
        {
            assert!((smoothing(text) / wanted - 1.0).abs() < 1e-3, "{}", smoothing(text));
        }
        let bare =
            finer.replace("mapping = \"trilinear\"", "smoothing = 0\nmapping = \"trilinear\"");
        assert_eq!(smoothing(&bare), 0.0);
        // Nothing is perturbed: a bed may be as dense as its packing allows.
        let dense = text.replace("solids_fraction = 0.05 ", "solids_fraction = 0.62 ");
        assert_eq!(Case::parse(&dense, "x").unwrap().run.perturbation, 0.0);
        let problem = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            match Case::parse(&text.replacen(from, to, 1), "x") {
                Err(CaseError::Invalid { problems, .. }) => {
                    let [problem] = &problems[..] else { panic!("{problems:?}") };
                    (problem.key.clone(), problem.why.clone())
                }
                other => panic!("{to}: {other:?}"),
            }
        };
        for (from, to, key, part) in [
            ("solver = \"cfd-dem\"", "", "particles", "solver = \"cfd-dem\""),
            ("cells = [8, 8, 32]", "cells = [20, 20, 80]", "[physics] solver", "1.5 d"),
            ("overlap = 0.02 ", "overlap = 2", "[particles] overlap", "0.05"),
            (
                "overlap = 0.02 ",
                "overlap = 0.02\nstiffness = 3\n#",
                "[particles] stiffness",
                "keep one",
            ),
            (
                "gas_inertia",
                "friction = \"none\"\ngas_inertia",
                "[physics] friction",
                "leave it out",
            ),
            ("duration", "precision = \"f32\"\nduration", "[run] precision", "two-fluid"),
            (
                "mapping = \"trilinear\"",
                "smoothing = 1\nmapping = \"trilinear\"",
                "[particles] smoothing",
                "a quarter",
            ),
            (
                "mapping = \"trilinear\"",
                "smoothing = 1e-4\nmapping = \"trilinear\"",
                "[particles] smoothing",
                "no less than the 1.02e-4 m",
            ),
            (
                "steps_per_contact = 25",
                "steps_per_contact = 5",
                "[particles] steps_per_contact",
                "20",
            ),
            (
                "mapping = \"trilinear\"",
                "mapping = \"centre\"",
                "[particles] mapping",
                "\"divided\"",
            ),
        ] {
            let (found, why) = problem(from, to);
            assert_eq!(found, key, "{to}");
            assert!(why.contains(part), "{to}: {why}");
        }
        let flat = text
            .replace("[\"6.64 L_II\", \"6.64 L_II\"", "[\"6.64 L_II\"")
            .replace("[8, 8, 32]", "[8, 32]");
        let refused = Case::parse(&flat, "x").unwrap_err().to_string();
        assert!(refused.contains("three edges"), "{refused}");
    }

    #[test]
    fn particles_start_as_a_case_says() {
        let text = include_str!("../examples/cfd-dem.toml");
        let from = "start = \"random\"";
        let with = |to: &str| Case::parse(&text.replacen(from, to, 1), "x");
        assert!(text.contains(from));
        for (to, start) in [
            ("", ParticlesStart::default()),
            (
                "start = \"lattice\"",
                ParticlesStart { places: Places::Lattice, diameters: Diameters::Equal },
            ),
            (
                "diameters = [{ diameter = \"60 um\", share = 0.4 }, { share = 0.6, diameter = \"1.2 d\" }]",
                ParticlesStart {
                    places: Places::Random,
                    diameters: Diameters::Shares(vec![(60e-6, 0.4), (1.2 * 75e-6, 0.6)]),
                },
            ),
            (
                "diameters = { geometric_deviation = 1.2 }",
                ParticlesStart { places: Places::Random, diameters: Diameters::LogNormal(1.2) },
            ),
        ] {
            let case = with(to).unwrap();
            assert_eq!(case.particles.as_ref().unwrap().start, start, "{to}");
            assert_eq!(Case::parse(&case.to_toml(), "x").unwrap(), case);
        }
        // A table lies beside the case, and is the same wherever the case is read from next.
        let case = with("start = \"bed \\\"1\\\".csv\"").unwrap();
        let Places::File(path) = &case.particles.as_ref().unwrap().start.places else { panic!() };
        assert!(path.is_absolute() && path.ends_with("bed \"1\".csv"), "{path:?}");
        assert_eq!(Case::parse(&case.to_toml(), "x").unwrap(), case);
        for (to, key, parts) in [
            ("start = \"latice\"", "start", &["did you mean \"lattice\"", ".csv"] as &[&str]),
            ("start = 3", "start", &["text in quotes"]),
            ("diameters = 3", "diameters", &["a list is expected", "geometric_deviation"]),
            ("diameters = { geometric_deviation = 4 }", "diameters", &["1.001 to 1.5"]),
            (
                "diameters = { geometric_deviation = true }",
                "diameters",
                &["geometric_deviation: a number"],
            ),
            ("diameters = [{ diameter = 75e-6 }]", "diameters", &["entry 1", "share are needed"]),
            (
                "diameters = [{ diameter = \"75 s\", share = 1 }]",
                "diameters",
                &["entry 1", "unknown unit s"],
            ),
            (
                "diameters = [{ diameter = 75e-6, share = 0.5 }, { diameter = 75e-6, number = 1 }]",
                "diameters",
                &["entry 2", "nothing else"],
            ),
            ("diameters = [{ diameter = 75e-6, share = 0.9 }]", "diameters", &["add up to 0.9"]),
            (
                "diameters = [{ diameter = 60e-6, share = 1 }]",
                "diameters",
                &["Sauter", " is 6e-5 m"],
            ),
            (
                "diameters = [{ diameter = 20e-6, share = 0.1 }, { diameter = 290e-6, share = 0.9 }]",
                "diameters",
                &["14.5 times"],
            ),
            (
                "start = \"a.csv\"\ndiameters = { geometric_deviation = 1.2 }",
                "diameters",
                &["keep one"],
            ),
            ("cohesion = -1", "cohesion", &["0 to"]),
            ("mixture_drag = \"sauter\"", "mixture_drag", &["\"van-der-hoef\""]),
        ] {
            let base = text.replacen("cohesion = 0 ", "#", 1).replacen("mixture_drag = ", "#", 1);
            match Case::parse(&base.replacen(from, to, 1), "x") {
                Err(CaseError::Invalid { problems, .. }) => {
                    let [problem] = &problems[..] else { panic!("{to}: {problems:?}") };
                    assert_eq!(problem.key, format!("[particles] {key}"), "{to}");
                    for part in parts {
                        assert!(problem.why.contains(part), "{to}: {}", problem.why);
                    }
                }
                other => panic!("{to}: {other:?}"),
            }
        }
        // Two that rest on each other too deeply: the remedy is accepted.
        let sticky = text.replacen("cohesion = 0 ", "cohesion = 1000 #", 1);
        let why = Case::parse(&sticky, "x").unwrap().particles.unwrap();
        assert!(
            (why.contact.cohesion * 0.25 * 75e-6 / (1000.0 * 3.3134e-10 * 9.81) - 1.0).abs() < 1e-3
        );
        let sticky = text.replacen("cohesion = 0 ", "cohesion = 10000 #", 1);
        let why = Case::parse(&sticky, "x").unwrap_err().to_string();
        let remedy =
            why.split("stiffness = ").nth(1).unwrap().split(' ').next().unwrap().to_owned();
        let stiff = sticky.replacen(
            "overlap = 0.02 ",
            &format!("stiffness = {} #", 1.001 * remedy.parse::<f64>().unwrap()),
            1,
        );
        assert!(Case::parse(&stiff, "x").is_ok(), "{why}");
        let many = text.replacen("solids_fraction = 0.05 ", "solids_fraction = [0.05, 0.1] ", 1);
        let why = Case::parse(&many.replacen(from, "start = \"a.csv\"", 1), "x").unwrap_err();
        assert!(why.to_string().contains("one number"), "{why}");
    }

    #[test]
    fn terms_are_switched_by_true_and_false() {
        for (key, default) in [("gas_inertia", true), ("gas_stress", false)] {
            let line = format!("{key} = {default}");
            let case = text_with(&line, &format!("{key} = {}", !default)).unwrap();
            assert!(case.to_toml().contains(&format!("\n{key} = {}\n", !default)));
            assert_ne!(case.physics.terms, Terms::default());
            assert_eq!(Case::parse(&case.to_toml(), "test").unwrap(), case);
            let refused = problem(&line, &format!("{key} = \"off\""));
            assert_eq!(refused.key, format!("[physics] {key}"));
            assert_eq!(refused.why, "true or false is expected, not text: remove the quotes");
            assert!(problem(&line, &format!("{key} = 0")).why.ends_with("not a number"));
        }
    }

    #[test]
    fn a_gas_flux_is_kept_only_if_asked_for() {
        let line = "drive = \"pressure-gradient\"";
        let kept = |flux: &str| text_with(line, &format!("drive = \"gas-flux\"{flux}"));
        for (typed, flux) in [("", None), ("\ngas_flux = 0.3", Some(0.3))] {
            let case = kept(typed).unwrap();
            assert_eq!(case.physics.drive, Drive::GasFlux(flux));
            assert_eq!(Case::parse(&case.to_toml(), "test").unwrap(), case);
        }
        let case = kept("\ngas_flux = \"2 u_t\"").unwrap();
        assert_eq!(case.physics.drive, Drive::GasFlux(Some(2.0 * case.scales().terminal_velocity)));
        let alone = problem(line, "gas_flux = 0.3");
        assert_eq!((alone.line, alone.key.as_str()), (Some(20), "[physics] gas_flux"));
        assert!(alone.why.contains("drive = \"gas-flux\""), "{}", alone.why);
        for flux in ["0", "-0.3", "1e9", "\"2000 u_t\""] {
            let refused = problem(line, &format!("drive = \"gas-flux\"\ngas_flux = {flux}"));
            assert!(refused.why.contains("from 0.001 u_t to 1000 u_t"), "{}", refused.why);
        }
        let refused = problem(line, "drive = \"gas\"");
        assert!(refused.why.contains("\"pressure-gradient\""), "{}", refused.why);
    }

    #[test]
    fn a_misspelt_key_or_section_is_one_problem() {
        let key = problem("diameter = ", "diametre = ");
        assert_eq!((key.line, key.key.as_str()), (Some(2), "[powder] diametre"));
        assert!(key.why.contains("did you mean diameter?"));
        let section = problem("[powder]", "[powdr]");
        assert_eq!((section.line, section.key.as_str()), (Some(1), "[powdr]"));
        assert!(section.why.contains("did you mean [powder]?"));
    }

    #[test]
    fn markers_include_the_solids_fraction_first() {
        use MarkerChoice::{Slip, SolidsFraction};
        let case = text_with("[\"solids_fraction\"]", "[\"slip\", \"solids_fraction\"]").unwrap();
        assert_eq!(case.filter.markers, [SolidsFraction, Slip]);
        assert!(problem("[\"solids_fraction\"]", "[\"slip\"]").why.contains("always a marker"));
    }

    #[test]
    fn markers_have_edges_or_quantiles() {
        let markers = "markers = [\"solids_fraction\"]";
        let three =
            "markers = [\"solids_fraction\", \"slip\", \"shear_rate\"]\nkernel = \"gaussian\"";
        let text =
            format!("{three}\nslip_edges = [0, 0.5, 2]\nsolids_fraction_edges = \"7 quantiles\"");
        let case = text_with(markers, &text).unwrap();
        assert_eq!(case.filter.kernel, KernelChoice::Gaussian);
        assert_eq!(
            case.filter.edges,
            [
                (MarkerChoice::SolidsFraction, EdgesChoice::Quantiles(7)),
                (MarkerChoice::Slip, EdgesChoice::Given(vec![0.0, 0.5, 2.0])),
            ]
        );
        assert_eq!(Case::parse(&case.to_toml(), "test").unwrap(), case);
        let refused = |edges: &str| problem(markers, &format!("{three}\nslip_edges = {edges}")).why;
        for (edges, says) in [
            ("[1]", "two edges or more"),
            ("[1, 1]", "ascending"),
            ("[0, \"a\"]", "ascending"),
            ("\"1 quantiles\"", "from 2 to 20 quantiles"),
            ("\"some quantiles\"", "from 2 to 20 quantiles"),
            ("3", "a list of ascending numbers"),
        ] {
            assert!(refused(edges).contains(says), "{edges}: {}", refused(edges));
        }
        let stray = problem(markers, &format!("{markers}\nslip_edges = [0, 1]"));
        assert!(stray.why.contains("\"slip\" is no marker"), "{}", stray.why);
        let many = "markers = [\"solids_fraction\", \"slip\", \"shear_rate\"]\n\
                    solids_fraction_bin = 0.0005\nslip_bin = \"0.01 u_t\"";
        let from = format!("{markers}\nsolids_fraction_bin = 0.02\nslip_bin = \"0.25 u_t\"");
        let many = problem(&from, many);
        assert!(
            many.key.contains("markers") && many.why.contains("at most 1000000"),
            "{}",
            many.why
        );
        let four = "[\"solids_fraction\", \"slip\", \"shear_rate\", \"slip_speed\"]";
        assert!(problem("[\"solids_fraction\"]", four).why.contains("at most three"));
    }
}
