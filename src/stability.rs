//! [`stability`]: linear theory of the uniform fluidised state, and the grid and box that its
//! instability asks for.
//!
//! The state (φ, T, slip W, gas pressure balancing the weight) of the equations that
//! [`two_fluid`](crate::two_fluid) solves is perturbed by a wave exp(i k·x + s t), k in the plane
//! of the vertical and one horizontal axis; in three dimensions every wave is one of these, turned.
//! With D_s = s + i k·U_s, D_g = s + i k·U_g, K = β/φ, κ = β/(1-φ), w' the vertical slip's
//! perturbation and e the upward unit vector:
//!
//! - D_s φ' = -φ i k·u'
//! - i k·(φ u' + (1-φ) v') = W i k·e φ'
//! - ρ_s D_s u' = -i k p' + W (K_φ φ' + K_w w') e + K (v' - u') - \[i k P' + μ k² u' + (μ/3 + μ_b) k k·u'\]/φ
//! - ρ_g D_g v' = -i k p' - W (κ_φ φ' + κ_w w') e - κ (v' - u')
//! - 3/2 D_s T' = -λ k² T'/(ρ_s φ) - (1 + 4 η φ g0) T i k·u' + R_φ φ' + R_T T' + R_w w'
//!
//! These are the full equations, whatever [`Terms`](crate::case::Terms) the case leaves out. They
//! hold no stress of the gas, μ_g k² against the drag, and no frictional viscosity: at rest Coulomb's
//! stress has no derivative by the rate of strain, and below its onset it is nought.
//!
//! R are the sources of granular energy per solids mass; a subscript is a derivative of a law. The
//! constraint gives the gas velocity along k, the difference of the two momentum balances along k
//! removes p', and five unknowns are left: φ', T', u' along and across k, v' across k.
//!
//! The same equations on a staggered grid of spacing h have 2 sin(k h/2)/h in place of k,
//! cos(k h/2) where a value passes between centres and faces, and the upwind scheme's symbol in the
//! advection by U_s and U_g ([`Uniform::mode_on`]). Their growth rate says which cells carry the
//! instability, without a rule of thumb.

use crate::case::{Case, with_friction, with_radial_distribution};
use crate::laws::drag::DragLaw;
use crate::laws::friction::Friction;
use crate::laws::kinetic_theory::{KineticTheory, RadialDistribution};
use crate::laws::scales::homogeneous_slip;
use faer::{Mat, c64};
use serde::Serialize;
use std::f64::consts::TAU;
use std::fmt;
use std::io::Write;
use std::ops::{Add, Mul, Sub};

/// Angles between the wave vector and the vertical that are scanned \[degrees\].
pub const ANGLES: [f64; 7] = [0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0];

/// Shortest wavelength scanned \[d\], longest \[L_I\], and how many in a factor of ten.
const SHORTEST: f64 = 2.0;
const LONGEST: f64 = 200.0;
const PER_DECADE: f64 = 24.0;

/// A grid carries a wave when its growth rate there is wrong by no more than this share.
const TOLERANCE: f64 = 0.1;

/// Most cells per wavelength that are asked for.
const MOST_CELLS: u32 = 200;

/// A box must hold every wave that grows at least this share of the fastest rate.
const BAND: f64 = 0.5;

/// Rates below this share of 1/(u_t/g) are zero: the long waves' drift is slower than the round-off
/// of the drag's relaxation.
const NO_GROWTH: f64 = 1e-6;

/// Step of the laws' central differences, relative; their error is of its square.
const STEP: f64 = 1e-5;

/// A wave on the uniform state, its fastest-growing mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Mode {
    /// Wavelength \[m\].
    pub wavelength: f64,
    /// Growth rate of its amplitude \[1/s\]; negative if it decays.
    pub growth_rate: f64,
    /// Speed along its wave vector relative to the particles \[m/s\], upward positive.
    pub wave_speed: f64,
}

/// Growth against wavelength in one direction.
#[derive(Clone, Debug, Serialize)]
pub struct Direction {
    /// Angle between the wave vector and the vertical \[degrees\].
    pub angle: f64,
    /// Modes, by ascending wavelength.
    pub modes: Vec<Mode>,
    /// The fastest-growing one; none if all decay.
    pub fastest: Option<Mode>,
    /// Wavelength below which all waves decay \[m\]; none if all do, or none does.
    pub neutral: Option<f64>,
}

impl Direction {
    /// Its name: `vertical`, `horizontal`, or `oblique` with the angle.
    pub fn name(&self) -> String {
        match self.angle {
            0.0 => "vertical".into(),
            90.0 => "horizontal".into(),
            angle => format!("oblique {angle}"),
        }
    }
}

/// What the instability of one state asks of grid and box, and what the case gives it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Need {
    /// Fewest cells per fastest wavelength whose growth rate is right to a tenth.
    pub cells_per_wavelength: f64,
    /// Edge of such a cell \[m\].
    pub cell: f64,
    /// The case's coarsest cell \[m\].
    pub own_cell: f64,
    /// Growth rate of the fastest wave on the case's cells \[1/s\]; none where two cells are longer
    /// than the wave, which then is not on the grid at all.
    pub own_growth_rate: Option<f64>,
    /// Longest wave in the direction of the fastest that grows at half its rate \[m\]: the least
    /// edge of a box. The clusters that come of the waves are larger and ask for more.
    pub edge: f64,
    /// The case's shortest edge \[m\].
    pub own_edge: f64,
}

impl Need {
    /// Cells of the case per fastest wavelength.
    pub fn own_cells_per_wavelength(&self) -> f64 {
        self.cells_per_wavelength * self.cell / self.own_cell
    }
}

/// The linear theory of one mean solids fraction.
#[derive(Clone, Debug, Serialize)]
pub struct StateStability {
    /// φ.
    pub solids_fraction: f64,
    /// Slip velocity W \[m/s\].
    pub slip: f64,
    /// Granular temperature T \[m²/s²\].
    pub temperature: f64,
    /// One for each of [`ANGLES`].
    pub directions: Vec<Direction>,
    /// Index in `directions` of the direction of the fastest wave; none if the state is stable.
    pub fastest: Option<usize>,
    /// What it asks of grid and box; none if the state is stable.
    pub need: Option<Need>,
}

impl StateStability {
    /// The fastest wave of all directions, with its direction.
    pub fn fastest_mode(&self) -> Option<(&Direction, Mode)> {
        let direction = self.directions.get(self.fastest?)?;
        direction.fastest.map(|mode| (direction, mode))
    }
}

/// The linear theory of a case.
#[derive(Clone, Debug, Serialize)]
pub struct Stability {
    /// Version of the program.
    pub version: &'static str,
    /// The case's name.
    pub name: String,
    /// One state for each mean solids fraction.
    pub states: Vec<StateStability>,
}

/// Why there is no linear theory of a case.
#[derive(Debug, thiserror::Error)]
pub enum StabilityError {
    /// The eigenvalues of a wave are not found.
    #[error(
        "the growth rate of the wave of {wavelength:.3e} m on the uniform state of solids fraction \
         {solids_fraction} cannot be found: the laws give {entry} there"
    )]
    Eigenvalues {
        /// Its wavelength \[m\].
        wavelength: f64,
        /// φ of the state.
        solids_fraction: f64,
        /// The largest number among the equations' coefficients.
        entry: f64,
    },
}

/// The uniform fluidised state, with the derivatives of the laws at it.
///
/// Waves are taken in the frame of the simulator, in which the mixture has no momentum.
#[derive(Clone, Copy, Debug)]
pub struct Uniform {
    /// φ.
    pub solids_fraction: f64,
    /// Slip velocity W, upward \[m/s\].
    pub slip: f64,
    /// Granular temperature T \[m²/s²\].
    pub temperature: f64,
    /// Velocity of the solids in the frame of the simulator, upward \[m/s\].
    pub solids_velocity: f64,
    /// ρ_s, ρ_g \[kg/m³\].
    density: [f64; 2],
    /// K = β/φ, ∂K/∂φ, ∂K/∂W.
    drag: [f64; 3],
    /// ∂P/∂φ, ∂P/∂T.
    pressure: [f64; 2],
    /// μ_s, η μ_b \[Pa·s\].
    viscosity: [f64; 2],
    /// λ \[kg/m/s\].
    conductivity: f64,
    /// 1 + 4 η φ g0.
    compressibility: f64,
    /// ∂R/∂φ, ∂R/∂T, ∂R/∂W.
    heating: [f64; 3],
}

/// A linear form of the unknowns φ', T', u' along and across k, v' across k.
#[derive(Clone, Copy)]
struct Form([c64; 5]);

impl Form {
    fn unknown(n: usize) -> Self {
        Self(std::array::from_fn(|m| c64::new(if m == n { 1.0 } else { 0.0 }, 0.0)))
    }
}

impl Add for Form {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(std::array::from_fn(|n| self.0[n] + other.0[n]))
    }
}

impl Sub for Form {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(std::array::from_fn(|n| self.0[n] - other.0[n]))
    }
}

impl Mul<Form> for f64 {
    type Output = Form;
    fn mul(self, form: Form) -> Form {
        Form(form.0.map(|entry| entry * self))
    }
}

impl Mul<Form> for c64 {
    type Output = Form;
    fn mul(self, form: Form) -> Form {
        Form(form.0.map(|entry| entry * self))
    }
}

/// Central difference of `law` at `at`, with a step of `relative` times `at`.
fn derivative(law: impl Fn(f64) -> f64, at: f64, relative: f64) -> f64 {
    let step = relative * at;
    (law(at + step) - law(at - step)) / (2.0 * step)
}

/// Symbol of ∂/∂x \[1/m\] in the advection by `velocity` of a wave of wave number `k` on cells of
/// `spacing`: the limited scheme where it does not limit, with central slopes; i k on no grid.
fn advection_symbol(k: f64, spacing: f64, velocity: f64) -> c64 {
    if spacing == 0.0 {
        return c64::new(0.0, k);
    }
    let angle = k * spacing;
    let upward = (c64::new(1.0, 0.0) - c64::new(angle.cos(), -angle.sin()))
        * c64::new(1.0, 0.5 * angle.sin())
        * (1.0 / spacing);
    if velocity > 0.0 { upward } else { -upward.conj() }
}

impl Uniform {
    /// The uniform state of `case` at one mean solids fraction φ.
    pub fn new(case: &Case, phi: f64) -> Self {
        let Case { powder, gas, physics, .. } = case;
        let law = physics.drag.law(gas, powder);
        let u_t = case.scales().terminal_velocity;
        let theory = KineticTheory::<f64>::new(gas, powder);
        let contact = |phi| {
            with_radial_distribution!(physics.radial_distribution, f64, powder, |radial| {
                radial.contact(phi)
            })
        };
        let friction = |phi| {
            with_friction!(physics.friction, f64, powder, u_t, |friction| friction.pressure(phi).0)
        };
        let slip = homogeneous_slip(&law, powder, gas, physics.gravity, phi);
        let drag = law.beta_per_fraction(phi, slip);
        let temperature = theory.steady_temperature(phi, contact(phi), drag, slip);
        let pressure = |phi, t| theory.pressure(phi, contact(phi), t) + friction(phi);
        let sources = |phi, t: f64, slip: f64| {
            let g0 = contact(phi);
            theory.slip_production(g0, slip * slip) / t.sqrt()
                - theory.collisional_dissipation(phi, g0) * t * t.sqrt()
                - theory.viscous_dissipation(law.beta_per_fraction(phi, slip)) * t
        };
        let transport = theory.transport(phi, contact(phi), temperature, drag);
        let mixture = powder.density * phi + gas.density * (1.0 - phi);
        Self {
            solids_fraction: phi,
            slip,
            temperature,
            solids_velocity: -gas.density * (1.0 - phi) * slip / mixture,
            density: [powder.density, gas.density],
            drag: [
                drag,
                derivative(|phi| law.beta_per_fraction(phi, slip), phi, STEP),
                derivative(|slip| law.beta_per_fraction(phi, slip), slip, STEP),
            ],
            pressure: [
                derivative(|phi| pressure(phi, temperature), phi, STEP),
                derivative(|t| pressure(phi, t), temperature, STEP),
            ],
            viscosity: [transport.viscosity, transport.bulk_viscosity],
            conductivity: transport.conductivity,
            compressibility: theory.compressibility(phi, contact(phi)),
            heating: [
                derivative(|phi| sources(phi, temperature, slip), phi, STEP),
                derivative(|t| sources(phi, t, slip), temperature, STEP),
                derivative(|slip| sources(phi, temperature, slip), slip, STEP),
            ],
        }
    }

    /// The fastest-growing mode of `wavelength` \[m\] whose wave vector is at `angle` \[degrees\] to
    /// the vertical.
    ///
    /// # Errors
    /// The eigenvalues are not found.
    pub fn mode(&self, wavelength: f64, angle: f64) -> Result<Mode, StabilityError> {
        self.mode_on(wavelength, angle, [0.0; 2])
    }

    /// The same on a staggered grid of horizontal and vertical `spacing` \[m\], in the frame of the
    /// simulator and with time continuous; 0 is no grid.
    ///
    /// # Errors
    /// The eigenvalues are not found.
    pub fn mode_on(
        &self,
        wavelength: f64,
        angle: f64,
        spacing: [f64; 2],
    ) -> Result<Mode, StabilityError> {
        let rates = self.rates(wavelength, angle, spacing)?;
        let fastest = rates
            .into_iter()
            .fold(c64::new(f64::NEG_INFINITY, 0.0), |a, b| if b.re > a.re { b } else { a });
        let upward = angle.to_radians().cos();
        Ok(Mode {
            wavelength,
            growth_rate: fastest.re,
            wave_speed: -fastest.im * wavelength / TAU - upward * self.solids_velocity,
        })
    }

    /// All five s of a wave \[1/s\].
    fn rates(
        &self,
        wavelength: f64,
        angle: f64,
        spacing: [f64; 2],
    ) -> Result<Vec<c64>, StabilityError> {
        let matrix = self.matrix(wavelength, angle, spacing);
        let failed = || {
            let entry = matrix.iter().flatten().map(|s| s.re.hypot(s.im)).fold(0.0, f64::max);
            StabilityError::Eigenvalues { wavelength, solids_fraction: self.solids_fraction, entry }
        };
        if !matrix.iter().flatten().all(|s| s.re.is_finite() && s.im.is_finite()) {
            return Err(failed());
        }
        Mat::from_fn(5, 5, |row, column| matrix[row][column]).eigenvalues().map_err(|_| failed())
    }

    /// Rates of change of the unknowns over the unknowns, these scaled by φ, T and W.
    fn matrix(&self, wavelength: f64, angle: f64, spacing: [f64; 2]) -> [[c64; 5]; 5] {
        let Self { solids_fraction: phi, slip, temperature, density: [rho_s, rho_g], .. } = *self;
        let gas = 1.0 - phi;
        let [drag, drag_by_phi, drag_by_slip] = self.drag;
        // β/(1-φ) and its derivatives.
        let gas_drag = drag * phi / gas;
        let gas_drag_by_phi = drag_by_phi * phi / gas + drag / (gas * gas);
        let gas_drag_by_slip = drag_by_slip * phi / gas;

        // Exactly zero across the axis, so that directions that decouple do.
        let (sine, cosine) = match angle {
            90.0 => (1.0, 0.0),
            angle => angle.to_radians().sin_cos(),
        };
        let vertical = cosine * TAU / wavelength;
        let wave = [sine * TAU / wavelength, vertical];
        // Differences between neighbours of a staggered grid, and the mean of two in the vertical.
        let [across, up]: [f64; 2] = std::array::from_fn(|a| {
            let half = 0.5 * wave[a] * spacing[a];
            if half == 0.0 { wave[a] } else { wave[a] * half.sin() / half }
        });
        let k = across.hypot(up);
        let (sine, cosine) = (across / k, up / k);
        let mean = (0.5 * vertical * spacing[1]).cos();
        let ik = c64::new(0.0, k);
        let [solids_advection, gas_advection] = [0.0, slip].map(|relative| {
            let velocity = self.solids_velocity + relative;
            advection_symbol(vertical, spacing[1], velocity) * -velocity
        });

        let [fraction, heat, solids_along, solids_across, gas_across] =
            std::array::from_fn(Form::unknown);
        // From the volume constraint.
        let gas_along = (1.0 / gas) * (slip * cosine * mean * fraction - phi * solids_along);
        let slip_along = gas_along - solids_along;
        let slip_across = gas_across - solids_across;
        let vertical_slip = mean * (cosine * slip_along + sine * slip_across);

        let fraction_rate = solids_advection * fraction - phi * (ik * solids_along);
        let [heat_by_phi, heat_by_temperature, heat_by_slip] = self.heating;
        let conduction = self.conductivity * k * k / (rho_s * phi);
        let heat_rate = solids_advection * heat
            + (2.0 / 3.0)
                * (heat_by_phi * fraction
                    + (heat_by_temperature - conduction) * heat
                    + heat_by_slip * vertical_slip
                    - self.compressibility * temperature * (ik * solids_along));

        // Vertical forces per volume of the phase by the changes of the drag coefficient.
        let lift = slip * mean * (drag_by_phi * fraction + drag_by_slip * vertical_slip);
        let load = slip * mean * (gas_drag_by_phi * fraction + gas_drag_by_slip * vertical_slip);
        let [pressure_by_phi, pressure_by_temperature] = self.pressure;
        let [viscosity, bulk_viscosity] = self.viscosity;
        let stress_along = ik * (pressure_by_phi * fraction + pressure_by_temperature * heat)
            + (4.0 / 3.0 * viscosity + bulk_viscosity) * k * k * solids_along;
        let solids_force_along = cosine * lift + drag * slip_along - (1.0 / phi) * stress_along;
        let solids_force_across =
            sine * lift + drag * slip_across - (viscosity * k * k / phi) * solids_across;
        let gas_force_along = -cosine * load - gas_drag * slip_along;
        let gas_force_across = -sine * load - gas_drag * slip_across;

        let difference = solids_force_along - gas_force_along
            + rho_s * (solids_advection * solids_along)
            - rho_g * (gas_advection * gas_along)
            + (rho_g * slip * cosine * mean / gas) * fraction_rate;
        let solids_along_rate = (1.0 / (rho_s + rho_g * phi / gas)) * difference;
        let solids_across_rate =
            (1.0 / rho_s) * solids_force_across + solids_advection * solids_across;
        let gas_across_rate = (1.0 / rho_g) * gas_force_across + gas_advection * gas_across;

        let scale = [phi, temperature, slip, slip, slip];
        let rates =
            [fraction_rate, heat_rate, solids_along_rate, solids_across_rate, gas_across_rate];
        std::array::from_fn(|row| {
            std::array::from_fn(|column| rates[row].0[column] * (scale[column] / scale[row]))
        })
    }

    /// Growth in all directions for ascending `wavelengths` \[m\], and what it asks of grid and box;
    /// rates up to `zero` \[1/s\] are no growth.
    fn scan(
        &self,
        case: &Case,
        wavelengths: &[f64],
        zero: f64,
    ) -> Result<StateStability, StabilityError> {
        let directions = ANGLES
            .iter()
            .map(|&angle| self.direction(angle, wavelengths, zero))
            .collect::<Result<Vec<_>, _>>()?;
        let growing = directions.iter().enumerate();
        let growing = growing.filter_map(|(n, direction)| Some((n, direction.fastest?)));
        // Of equally fast directions the first, the most vertical.
        let fastest = growing.reduce(|a, b| if b.1.growth_rate > a.1.growth_rate { b } else { a });
        let need = match fastest {
            Some((n, mode)) => Some(self.need(case, mode, &directions[n])?),
            None => None,
        };
        Ok(StateStability {
            solids_fraction: self.solids_fraction,
            slip: self.slip,
            temperature: self.temperature,
            directions,
            fastest: fastest.map(|(n, _)| n),
            need,
        })
    }

    /// Growth against wavelength at `angle` \[degrees\], for ascending `wavelengths` \[m\]; rates
    /// up to `zero` \[1/s\] are no growth.
    fn direction(
        &self,
        angle: f64,
        wavelengths: &[f64],
        zero: f64,
    ) -> Result<Direction, StabilityError> {
        let modes = wavelengths
            .iter()
            .map(|&wavelength| self.mode(wavelength, angle))
            .collect::<Result<Vec<_>, _>>()?;
        let best = (0..modes.len())
            .max_by(|&a, &b| modes[a].growth_rate.total_cmp(&modes[b].growth_rate))
            .filter(|&best| modes[best].growth_rate > zero);
        let fastest = match best {
            Some(best) => {
                let low = modes[best.saturating_sub(1)].wavelength;
                let high = modes[(best + 1).min(modes.len() - 1)].wavelength;
                Some(self.peak(angle, low, high)?)
            }
            None => None,
        };
        let first = modes.iter().position(|mode| mode.growth_rate > zero);
        let neutral = match first {
            Some(first) if first > 0 => {
                let (low, high) = (modes[first - 1].wavelength, modes[first].wavelength);
                Some(self.crossing(angle, zero, low, high)?)
            }
            _ => None,
        };
        Ok(Direction { angle, modes, fastest, neutral })
    }

    /// The fastest mode between two wavelengths, by golden section in the logarithm.
    fn peak(&self, angle: f64, low: f64, high: f64) -> Result<Mode, StabilityError> {
        let ratio = 0.5 * (5f64.sqrt() - 1.0);
        let at = |x: f64| self.mode(x.exp(), angle);
        let (mut low, mut high) = (low.ln(), high.ln());
        let mut inner = [high - ratio * (high - low), low + ratio * (high - low)];
        let mut modes = [at(inner[0])?, at(inner[1])?];
        for _ in 0..16 {
            if modes[0].growth_rate > modes[1].growth_rate {
                high = inner[1];
                inner = [high - ratio * (high - low), inner[0]];
                modes = [at(inner[0])?, modes[0]];
            } else {
                low = inner[0];
                inner = [inner[1], low + ratio * (high - low)];
                modes = [modes[1], at(inner[1])?];
            }
        }
        Ok(if modes[0].growth_rate > modes[1].growth_rate { modes[0] } else { modes[1] })
    }

    /// The wavelength between `below` and `above` at which the growth rate passes `level`, above it
    /// at `above`, by bisection in the logarithm.
    fn crossing(
        &self,
        angle: f64,
        level: f64,
        mut below: f64,
        mut above: f64,
    ) -> Result<f64, StabilityError> {
        for _ in 0..20 {
            let middle = (below * above).sqrt();
            if self.mode(middle, angle)?.growth_rate > level {
                above = middle;
            } else {
                below = middle;
            }
        }
        Ok((below * above).sqrt())
    }

    /// What the `fastest` wave of `direction` asks of the case's grid and box.
    fn need(
        &self,
        case: &Case,
        fastest: Mode,
        direction: &Direction,
    ) -> Result<Need, StabilityError> {
        let Direction { angle, modes, .. } = direction;
        let angle = *angle;
        let wavelength = fastest.wavelength;
        // From fine to coarse: the coarsest grid of those that are right at every finer one.
        let mut cells = MOST_CELLS;
        for coarser in (2..MOST_CELLS).rev() {
            let spacing = wavelength / f64::from(coarser);
            let growth = self.mode_on(wavelength, angle, [spacing; 2])?.growth_rate;
            if (growth / fastest.growth_rate - 1.0).abs() > TOLERANCE {
                break;
            }
            cells = coarser;
        }
        let spacing = case.domain.spacing();
        let last = spacing.len() - 1;
        let across = spacing[..last].iter().copied().fold(0.0, f64::max);
        let own_cell = across.max(spacing[last]);
        let own_growth_rate = if 2.0 * own_cell > wavelength {
            None
        } else {
            Some(self.mode_on(wavelength, angle, [across, spacing[last]])?.growth_rate)
        };
        let level = BAND * fastest.growth_rate;
        let edge = match modes.iter().rposition(|mode| mode.growth_rate > level) {
            Some(place) if place + 1 < modes.len() => {
                self.crossing(angle, level, modes[place + 1].wavelength, modes[place].wavelength)?
            }
            Some(place) => modes[place].wavelength,
            None => wavelength,
        };
        Ok(Need {
            cells_per_wavelength: f64::from(cells),
            cell: wavelength / f64::from(cells),
            own_cell,
            own_growth_rate,
            edge,
            own_edge: case.domain.size.iter().copied().fold(f64::INFINITY, f64::min),
        })
    }
}

/// The linear theory of the uniform states of `case`, one for each of its mean solids fractions.
/// Takes milliseconds.
///
/// # Errors
/// The eigenvalues of a wave are not found.
pub fn stability(case: &Case) -> Result<Stability, StabilityError> {
    let scales = case.scales();
    let (shortest, longest) = (SHORTEST * case.powder.diameter, LONGEST * scales.length_i());
    let zero = NO_GROWTH / scales.time();
    // A powder heavy enough has a long way between the two; one in a liquid may have none.
    let decades = (longest.max(1e3 * shortest) / shortest).log10();
    let count = (PER_DECADE * decades).ceil();
    let wavelengths: Vec<f64> =
        (0..=count as usize).map(|n| shortest * 10f64.powf(decades * n as f64 / count)).collect();
    let states = case
        .domain
        .solids_fractions
        .iter()
        .map(|&phi| Uniform::new(case, phi).scan(case, &wavelengths, zero))
        .collect::<Result<Vec<_>, StabilityError>>()?;
    Ok(Stability { version: env!("CARGO_PKG_VERSION"), name: case.name.clone(), states })
}

impl Stability {
    /// Writes stability.csv: one row per mean solids fraction, direction and wavelength.
    ///
    /// # Errors
    /// The writer fails.
    pub fn write_csv(&self, writer: impl Write) -> csv::Result<()> {
        let mut table = csv::Writer::from_writer(writer);
        table.write_record([
            "solids_fraction [-]",
            "direction",
            "angle [degree]",
            "wavelength [m]",
            "growth_rate [1/s]",
            "wave_speed [m/s]",
        ])?;
        for state in &self.states {
            for direction in &state.directions {
                for mode in &direction.modes {
                    table.serialize((
                        state.solids_fraction,
                        direction.name(),
                        direction.angle,
                        mode.wavelength,
                        mode.growth_rate,
                        mode.wave_speed,
                    ))?;
                }
            }
        }
        table.flush()?;
        Ok(())
    }

    /// The sentence that a user of a grid too coarse for the instability of one of its mean solids
    /// fractions must read, of the one that asks for the finest cells.
    pub fn grid_warning(&self) -> Option<String> {
        let (state, need) = self
            .states
            .iter()
            .filter_map(|state| Some((state, state.need?)))
            .filter(|(_, need)| need.own_cell > need.cell * (1.0 + 1e-9))
            .min_by(|a, b| a.1.cell.total_cmp(&b.1.cell))?;
        let (direction, mode) = state.fastest_mode()?;
        Some(format!(
            "the cells ({:.3} mm) do not resolve the instability that makes the clusters: at ⟨φ⟩ = \
             {} its fastest wave ({}) is {:.3} mm long and has {:.1} cells; cells of {:.3} mm, {} \
             per wave, would do, and until then H is a lower bound",
            1e3 * need.own_cell,
            state.solids_fraction,
            direction.name(),
            1e3 * mode.wavelength,
            need.own_cells_per_wavelength(),
            1e3 * need.cell,
            need.cells_per_wavelength,
        ))
    }
}

impl fmt::Display for Stability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (n, state) in self.states.iter().enumerate() {
            if n > 0 {
                writeln!(f)?;
            }
            write!(f, "{}", StateText { name: &self.name, state })?;
        }
        Ok(())
    }
}

/// A state in three lines.
struct StateText<'a> {
    name: &'a str,
    state: &'a StateStability,
}

impl fmt::Display for StateText<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, state } = self;
        let head = format!("{name}, ⟨φ⟩ = {}", state.solids_fraction);
        let (Some((direction, mode)), Some(need)) = (state.fastest_mode(), state.need) else {
            return write!(f, "{head}: linearly stable: waves of every length and direction decay");
        };
        writeln!(
            f,
            "{head}: fastest wave {:.3} mm ({}), growth rate {:.2} 1/s, passing the particles \
             at {:.4} m/s",
            1e3 * mode.wavelength,
            direction.name(),
            mode.growth_rate,
            mode.wave_speed,
        )?;
        let neutral = state.directions.iter().map(|direction| {
            let length = match (direction.fastest, direction.neutral) {
                (None, _) => "none grows".into(),
                (Some(_), Some(neutral)) => format!("{:.3} mm", 1e3 * neutral),
                (Some(_), None) => format!("below {:.3} mm", 1e3 * direction.modes[0].wavelength),
            };
            match direction.angle {
                0.0 | 90.0 => format!("{length} {}", direction.name()),
                angle => format!("{length} at {angle}°"),
            }
        });
        let neutral: Vec<_> = neutral.collect();
        writeln!(f, "  neutral wavelength: {}", neutral.join(", "))?;
        let own = match need.own_growth_rate {
            Some(rate) => format!("on which it grows at {rate:.2} 1/s"),
            None => "too few to hold it".into(),
        };
        write!(
            f,
            "  needs: cells of {:.4} mm ({} per wave; growth within {:.0} %), and a box of at least \
             {:.1} mm (the longest wave of half that growth); the case has {:.4} mm ({:.1} per wave, \
             {own}) and {:.1} mm",
            1e3 * need.cell,
            need.cells_per_wavelength,
            100.0 * TOLERANCE,
            1e3 * need.edge,
            1e3 * need.own_cell,
            need.own_cells_per_wavelength(),
            1e3 * need.own_edge,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::DEFAULT;
    use crate::grid::Grid;
    use crate::laws::drag::WenYu;
    use crate::two_fluid::{Setup, TwoFluid};
    use std::sync::LazyLock;

    static CASE: LazyLock<Case> = LazyLock::new(|| Case::parse(DEFAULT, "default").unwrap());

    /// A wave in the simulator: how many fit each edge of the box, its edges and its cells.
    #[derive(Clone, Copy)]
    struct Wave {
        phi: f64,
        count: [usize; 2],
        size: [f64; 2],
        cells: [usize; 2],
    }

    impl Wave {
        fn vector(&self) -> [f64; 2] {
            std::array::from_fn(|a| TAU * self.count[a] as f64 / self.size[a])
        }

        fn spacing(&self) -> [f64; 2] {
            std::array::from_fn(|a| self.size[a] / self.cells[a] as f64)
        }

        /// The complex amplitude of φ at `times`, with time steps of at most `dt`.
        fn simulated(&self, dt: f64, times: [f64; 2]) -> [c64; 2] {
            let setup = Setup {
                powder: CASE.powder,
                gas: CASE.gas,
                gravity: CASE.physics.gravity,
                drag: CASE.physics.drag,
                radial_distribution: CASE.physics.radial_distribution,
                friction: CASE.physics.friction,
                terms: CASE.physics.terms,
                solids_fraction: self.phi,
                perturbation: 1e-4,
                seed: 0,
                parallel: false,
            };
            let (k, h) = (self.vector(), self.spacing());
            let phase = |cell: [usize; 2]| -> f64 {
                (0..2).map(|a| k[a] * h[a] * (cell[a] as f64 + 0.5)).sum()
            };
            let grid = Grid::new(self.size, self.cells);
            let mut flow = TwoFluid::<f64, 2>::perturbed(grid, setup, |cell| phase(cell).cos())
                .with_tolerance(1e-11);
            times.map(|time| {
                while flow.time() < time {
                    flow.step(time.min(flow.time() + dt)).unwrap();
                }
                let mut sum = c64::new(0.0, 0.0);
                for (j, row) in flow.solids_fraction().interior().enumerate() {
                    for (i, phi) in row.iter().enumerate() {
                        let phase = phase([i, j]);
                        sum += c64::new(phase.cos(), -phase.sin()) * *phi;
                    }
                }
                sum
            })
        }

        /// s of the wave in the simulator between two times, that of the linearised
        /// discretisation, and the exact one. The simulator's turns in between are taken from
        /// theory.
        fn rates(&self, dt: f64, times: [f64; 2]) -> [c64; 3] {
            let [kx, kz] = self.vector();
            let k = kx.hypot(kz);
            let theory = state(self.phi);
            let [grid, exact] = [self.spacing(), [0.0; 2]].map(|spacing| {
                let angle = kx.atan2(kz).to_degrees();
                let mode = theory.mode_on(TAU / k, angle, spacing).unwrap();
                c64::new(mode.growth_rate, -k * mode.wave_speed - kz * theory.solids_velocity)
            });
            let [first, last] = self.simulated(dt, times);
            let time = times[1] - times[0];
            let ratio = last / first;
            let turned = grid.im * time;
            let late = (ratio * c64::new(turned.cos(), -turned.sin())).arg();
            [c64::new(ratio.norm().ln() / time, grid.im + late / time), grid, exact]
        }
    }

    fn state(phi: f64) -> Uniform {
        Uniform::new(&CASE, phi)
    }

    fn with_fractions(fractions: &[f64]) -> Case {
        let mut case = CASE.clone();
        case.domain.solids_fractions = fractions.to_vec();
        case
    }

    /// Largest distance of a rate in `a` from the nearest in `b`, over the largest rate.
    fn distance(a: &[c64], b: &[c64]) -> f64 {
        let nearest = |s: &c64| b.iter().map(|t| (*s - *t).norm()).fold(f64::INFINITY, f64::min);
        let largest = a.iter().map(|s| s.norm()).fold(0.0, f64::max);
        a.iter().map(nearest).fold(0.0, f64::max) / largest
    }

    #[test]
    fn fastest_waves_of_the_base_powder_have_the_known_lengths() {
        let found = stability(&with_fractions(&[0.05, 0.15])).unwrap();
        for (state, length) in found.states.iter().zip([2.1e-3, 0.92e-3]) {
            let (direction, mode) = state.fastest_mode().unwrap();
            assert_eq!(direction.name(), "vertical");
            assert!((mode.wavelength / length - 1.0).abs() < 0.02, "{mode:?}");
            assert!(mode.wave_speed > 0.0);
            // Neutral and fastest are what they say.
            let uniform = Uniform::new(&CASE, state.solids_fraction);
            for direction in &state.directions {
                let rate = |length| uniform.mode(length, direction.angle).unwrap().growth_rate;
                let neutral = direction.neutral.unwrap();
                assert!(rate(0.999 * neutral) < 0.0 && rate(1.001 * neutral) > 0.0);
                let fastest = direction.fastest.unwrap();
                for factor in [0.97, 1.03] {
                    assert!(rate(factor * fastest.wavelength) < fastest.growth_rate);
                }
            }
        }
    }

    #[test]
    fn a_uniform_slip_relaxes_at_the_rate_of_the_drag() {
        // The waves across a very long horizontal one are a uniform vertical slip; its drag is
        // that of Wen & Yu differentiated by hand.
        for phi in [0.02, 0.15, 0.4] {
            let found = state(phi);
            let (powder, gas) = (CASE.powder, CASE.gas);
            let reynolds = (1.0 - phi) * gas.density * powder.diameter * found.slip / gas.viscosity;
            let inverse = 0.75 * gas.viscosity / powder.diameter.powi(2) * (1.0 - phi).powf(-2.65);
            let by_slip = inverse * (24.0 + 1.687 * 3.6 * reynolds.powf(0.687));
            let expected =
                phi * by_slip * (1.0 / (powder.density * phi) + 1.0 / (gas.density * (1.0 - phi)));
            let rates = found.rates(1e4, 90.0, [0.0; 2]).unwrap();
            let fastest = rates.iter().map(|s| s.re).fold(0.0, f64::min);
            assert!((fastest / -expected - 1.0).abs() < 1e-8, "{phi}: {fastest} {expected}");
        }
    }

    #[test]
    fn without_stress_vertical_waves_obey_the_quadratic_of_drag_and_inertia() {
        let phi = 0.15;
        let mut found = state(phi);
        found.pressure = [0.0; 2];
        found.viscosity = [0.0; 2];
        found.solids_velocity = 0.0;
        let [rho_s, rho_g] = found.density;
        let (gas, w, k) = (1.0 - phi, found.slip, TAU / 2e-3);
        let [drag, by_phi, by_slip] = found.drag;
        // With u = i s φ'/(φ k) and v = (W φ' - φ u)/(1-φ), the difference of the momentum
        // balances is a s² + b s + c = 0; K + κ = β/(φ (1-φ)).
        let total = (drag + w * by_slip) / gas;
        let total_by_phi = by_phi / gas + drag / (gas * gas);
        let i = c64::new(0.0, 1.0);
        let a = i * (rho_s / (phi * k) + rho_g / (gas * k));
        let b = c64::new(-2.0 * rho_g * w / gas, 0.0) + i * (total / (gas * phi * k));
        let c = -i * (k * w * w * rho_g / gas) - c64::new(w * total_by_phi + total * w / gas, 0.0);
        let root = (b * b - a * c * 4.0).sqrt();
        let expected = [(-b + root) / (a * 2.0), (-b - root) / (a * 2.0)];
        let rates = found.rates(2e-3, 0.0, [0.0; 2]).unwrap();
        assert!(expected.iter().any(|s| s.re > 1.0));
        assert!(distance(&expected, &rates) < 1e-9, "{expected:?} {rates:?}");
    }

    #[test]
    fn a_moving_frame_changes_wave_speeds_only() {
        let mut moving = state(0.15);
        let still = moving;
        moving.solids_velocity += 0.3;
        for angle in [0.0_f64, 30.0, 90.0] {
            let shift = c64::new(0.0, -0.3 * angle.to_radians().cos() * TAU / 1e-3);
            let expected: Vec<c64> =
                still.rates(1e-3, angle, [0.0; 2]).unwrap().iter().map(|s| *s + shift).collect();
            let found = moving.rates(1e-3, angle, [0.0; 2]).unwrap();
            assert!(distance(&found, &expected) < 1e-12);
            let [a, b] = [still, moving].map(|state| state.mode(1e-3, angle).unwrap());
            assert!((a.wave_speed - b.wave_speed).abs() < 1e-9, "relative to the particles");
        }
    }

    #[test]
    fn mirrored_directions_have_equal_modes() {
        let found = state(0.15);
        for spacing in [[0.0; 2], [1e-4, 5e-5]] {
            let at = |angle| found.rates(1e-3, angle, spacing).unwrap();
            let conjugate: Vec<c64> = at(150.0).iter().map(|s| s.conj()).collect();
            assert!(distance(&at(30.0), &at(-30.0)) < 1e-12);
            assert!(distance(&at(30.0), &conjugate) < 1e-12);
        }
        // A whole number of turns of the phase between neighbours is no wave on the grid.
        assert!(found.mode_on(1e-3, 90.0, [0.0, 1e-4]).unwrap() == found.mode(1e-3, 90.0).unwrap());
    }

    #[test]
    fn differences_of_the_laws_converge_at_second_order() {
        let law = WenYu::<f64>::new(&CASE.gas, &CASE.powder);
        let (phi, slip) = (0.15, state(0.15).slip);
        let reynolds =
            (1.0 - phi) * CASE.gas.density * CASE.powder.diameter * slip / CASE.gas.viscosity;
        let scale = 0.75 * CASE.gas.viscosity / CASE.powder.diameter.powi(2);
        let power = 3.6 * reynolds.powf(0.687);
        // ∂K/∂φ: Re and the voidage power both depend on 1-φ.
        let exact = scale * (1.0 - phi).powf(-3.65) * (2.65 * (24.0 + power) - 0.687 * power);
        let error = |step| {
            (derivative(|phi| law.beta_per_fraction(phi, slip), phi, step) / exact - 1.0).abs()
        };
        let order = (error(2e-2) / error(1e-2)).log2();
        assert!((order - 2.0).abs() < 0.01, "{order}");
        assert!(error(STEP) < 1e-9, "{}", error(STEP));
    }

    #[test]
    fn the_grid_that_is_asked_for_carries_the_fastest_wave() {
        let found = stability(&with_fractions(&[0.05, 0.15])).unwrap();
        for state in &found.states {
            let uniform = Uniform::new(&CASE, state.solids_fraction);
            let (direction, mode) = state.fastest_mode().unwrap();
            let error = |cells: f64| {
                let spacing = [mode.wavelength / cells; 2];
                let on = uniform.mode_on(mode.wavelength, direction.angle, spacing).unwrap();
                (on.growth_rate / mode.growth_rate - 1.0).abs()
            };
            let need = state.need.unwrap();
            let cells = need.cells_per_wavelength;
            assert!(error(cells) <= TOLERANCE && error(cells - 1.0) > TOLERANCE);
            assert!((error(64.0) / error(128.0)).log2() > 1.95, "second order");
            assert!(need.edge > mode.wavelength && need.own_growth_rate.is_none());
        }
        // The box of the finest cells decides.
        let warning = found.grid_warning().unwrap();
        assert!(warning.contains("⟨φ⟩ = 0.15") && warning.contains("0.923 mm long"), "{warning}");
        let mut fine = with_fractions(&[0.05, 0.15]);
        fine.domain.size = vec![0.01; 2];
        fine.domain.cells = vec![100; 2];
        let found = stability(&fine).unwrap();
        assert_eq!(found.grid_warning(), None);
        let need = found.states[1].need.unwrap();
        assert!((need.own_cells_per_wavelength() - 9.23).abs() < 0.01);
        let own = need.own_growth_rate.unwrap();
        assert!((own / found.states[1].fastest_mode().unwrap().1.growth_rate - 1.0).abs() < 0.1);
    }

    #[test]
    fn a_stable_state_is_said_to_be() {
        // Solids a thousand times as stiff carry sound faster than the drag's kinematic waves.
        let mut stiff = state(0.15);
        stiff.pressure[0] *= 1e3;
        let states = vec![stiff.scan(&CASE, &[1e-4, 1e-3, 1e-2, 1e-1], 1e-4).unwrap()];
        assert!(states[0].fastest_mode().is_none() && states[0].need.is_none());
        let found = Stability { version: "", name: "stiff".into(), states };
        assert_eq!(found.grid_warning(), None);
        assert!(found.to_string().starts_with("stiff, ⟨φ⟩ = 0.15: linearly stable"), "{found}");
    }

    #[test]
    fn the_simulator_approaches_theory_at_second_order() {
        // Measured after the other modes have decayed and while the wave is small. The time step
        // is a fourth on each finer grid, which makes one order of both errors.
        let mut errors = Vec::new();
        for (cells, dt) in [(8, 2e-4), (16, 5e-5), (32, 1.25e-5)] {
            let size = [8.0 * 2e-3 / cells as f64, 2e-3];
            let wave = Wave { phi: 0.05, count: [0, 1], size, cells: [8, cells] };
            let [found, grid, exact] = wave.rates(dt, [0.06, 0.10]);
            // The linearised discretisation leaves out the limiter's clipping of the crests.
            let bound = 0.025 * (8.0 / cells as f64).powi(2);
            assert!((found.re / grid.re - 1.0).abs() < bound, "{cells}: {found} {grid}");
            assert!((found.im / grid.im - 1.0).abs() < bound, "{cells}: {found} {grid}");
            errors.push((found.re / exact.re - 1.0).abs());
        }
        for pair in errors.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            assert!((order - 2.0).abs() < 0.25, "{errors:?}");
        }
        assert!(errors[2] < 0.01, "{errors:?}");
    }

    #[test]
    fn the_simulator_grows_waves_of_other_fractions_and_directions_as_theory_says() {
        let dense = Wave { phi: 0.15, count: [0, 1], size: [4.5e-4, 9e-4], cells: [8, 16] };
        let across = Wave { phi: 0.05, count: [1, 0], size: [1.8e-3, 9e-4], cells: [16, 8] };
        let oblique = Wave { phi: 0.15, count: [1, 1], size: [1.2e-3, 1.8e-3], cells: [24, 32] };
        for (wave, dt, times, bound) in [
            (dense, 5e-5, [0.02, 0.03], 0.01),
            (across, 1e-4, [0.3, 0.4], 0.01),
            (oblique, 5e-5, [0.03, 0.05], 0.01),
        ] {
            let [found, grid, exact] = wave.rates(dt, times);
            assert!((found - grid).norm() < bound * exact.norm(), "{found} {grid} {exact}");
            assert!((grid.re / exact.re - 1.0).abs() < 0.05, "{grid} {exact}");
        }
    }
}
