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
//! R are the sources of granular energy per solids mass; a subscript is a derivative of a law. The
//! constraint gives the gas velocity along k, the difference of the two momentum balances along k
//! removes p', and five unknowns are left: φ', T', u' along and across k, v' across k.
//!
//! The same equations on a staggered grid of spacing h have 2 sin(k h/2)/h in place of k,
//! cos(k h/2) where a value passes between centres and faces, and the upwind scheme's symbol in the
//! advection by U_s and U_g ([`Uniform::mode_on`]). Their growth rate says which cells carry the
//! instability, without a rule of thumb.

use crate::case::{Case, DragChoice};
use crate::laws::drag::{DragLaw, WenYu};
use crate::laws::kinetic_theory::{KineticTheory, PackingBarrier};
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
const PER_DECADE: f64 = 16.0;

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
    /// Longest vertical wave that grows at half the fastest rate \[m\]: the least height of a box.
    pub height: f64,
    /// The case's height \[m\].
    pub own_height: f64,
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
        let law = match physics.drag {
            DragChoice::WenYu => WenYu::<f64>::new(gas, powder),
        };
        let theory = KineticTheory::<f64>::new(gas, powder);
        let barrier = PackingBarrier::<f64>::new(powder);
        let contact = |phi| theory.radial_distribution(phi);
        let friction = |phi| barrier.pressure(phi).0;
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

    /// What the fastest wave at `angle` asks of the case's grid, and the vertical waves, those of
    /// `column`, of its box.
    fn need(
        &self,
        case: &Case,
        fastest: Mode,
        angle: f64,
        column: &Direction,
    ) -> Result<Need, StabilityError> {
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
        let modes = &column.modes;
        let height = match modes.iter().rposition(|mode| mode.growth_rate > level) {
            Some(place) if place + 1 < modes.len() => {
                self.crossing(0.0, level, modes[place + 1].wavelength, modes[place].wavelength)?
            }
            Some(place) => modes[place].wavelength,
            None => wavelength,
        };
        Ok(Need {
            cells_per_wavelength: f64::from(cells),
            cell: wavelength / f64::from(cells),
            own_cell,
            own_growth_rate,
            height,
            own_height: case.domain.size[last],
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
        .map(|&phi| {
            let state = Uniform::new(case, phi);
            let directions = ANGLES
                .iter()
                .map(|&angle| state.direction(angle, &wavelengths, zero))
                .collect::<Result<Vec<_>, _>>()?;
            let rate = |n: usize| directions[n].fastest.map_or(0.0, |mode| mode.growth_rate);
            // Of equally fast directions the first, the most vertical.
            let fastest = (0..directions.len())
                .filter(|&n| directions[n].fastest.is_some())
                .reduce(|a, b| if rate(b) > rate(a) { b } else { a });
            let need = match fastest.and_then(|n| Some((n, directions[n].fastest?))) {
                Some((n, mode)) => {
                    Some(state.need(case, mode, directions[n].angle, &directions[0])?)
                }
                None => None,
            };
            Ok(StateStability {
                solids_fraction: phi,
                slip: state.slip,
                temperature: state.temperature,
                directions,
                fastest,
                need,
            })
        })
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
             per wave, would do",
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
            "{head}: fastest wave {:.3} mm ({}), growth rate {:.2} 1/s, rising past the particles \
             at {:.4} m/s",
            1e3 * mode.wavelength,
            direction.name(),
            mode.growth_rate,
            mode.wave_speed,
        )?;
        write!(f, "  neutral: ")?;
        let named = state.directions.iter().map(|direction| {
            let text = match (direction.fastest, direction.neutral) {
                (None, _) => "none grows".into(),
                (Some(_), Some(neutral)) => format!("{:.3} mm", 1e3 * neutral),
                (Some(_), None) => "all grow".into(),
            };
            format!("{} {text}", direction.name())
        });
        writeln!(f, "{}", named.collect::<Vec<_>>().join(", "))?;
        let own = match need.own_growth_rate {
            Some(rate) => format!("on which it grows at {rate:.2} 1/s"),
            None => "too few to hold it".into(),
        };
        write!(
            f,
            "  needs: cells of {:.4} mm ({} per wave; growth within {:.0} %), and a box at least \
             {:.1} mm high (waves of half that growth); the case has {:.4} mm ({:.1} per wave, \
             {own}) and {:.1} mm",
            1e3 * need.cell,
            need.cells_per_wavelength,
            100.0 * TOLERANCE,
            1e3 * need.height,
            1e3 * need.own_cell,
            need.own_cells_per_wavelength(),
            1e3 * need.own_height,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::DEFAULT;
    use crate::grid::Grid;
    use crate::two_fluid::{Setup, TwoFluid};
    use std::sync::LazyLock;

    static CASE: LazyLock<Case> = LazyLock::new(|| Case::parse(DEFAULT, "default").unwrap());

    /// The complex amplitude of the wave (0, 1) of φ in a box one wavelength high, at `times`.
    fn simulated(phi: f64, wavelength: f64, cells: usize, dt: f64, times: &[f64]) -> Vec<c64> {
        let spacing = wavelength / cells as f64;
        let grid = Grid::new([8.0 * spacing, wavelength], [8, cells]);
        let setup = Setup {
            powder: CASE.powder,
            gas: CASE.gas,
            gravity: CASE.physics.gravity,
            drag: CASE.physics.drag,
            solids_fraction: phi,
            perturbation: 1e-4,
            seed: 0,
            parallel: false,
        };
        let phase = |j: usize| TAU * (j as f64 + 0.5) / cells as f64;
        let mut flow = TwoFluid::<f64, 2>::perturbed(grid, setup, |[_, j]| phase(j).cos())
            .with_tolerance(1e-11);
        times
            .iter()
            .map(|&time| {
                while flow.time() < time {
                    flow.step(time.min(flow.time() + dt)).unwrap();
                }
                let rows = flow.solids_fraction().interior().enumerate();
                rows.fold(c64::new(0.0, 0.0), |sum, (j, row)| {
                    sum + c64::new(phase(j).cos(), -phase(j).sin()) * row[0]
                })
            })
            .collect()
    }

    #[test]
    fn explore() {
        for phi in [0.02, 0.05, 0.15, 0.25, 0.4, 0.55] {
            let mut case = CASE.clone();
            case.domain.solids_fractions = vec![phi];
            let begin = std::time::Instant::now();
            let found = stability(&case).unwrap();
            println!("{found}\n  {:?}", begin.elapsed());
            println!("{:?}", Uniform::new(&case, phi));
            for d in &found.states[0].directions {
                println!("   {} {:?} {:?}", d.name(), d.fastest, d.neutral);
            }
            if let Some((d, m)) = found.states[0].fastest_mode() {
                let state = Uniform::new(&case, phi);
                println!("{:?}", state.rates(m.wavelength, d.angle, [0.0; 2]).unwrap());
                for n in [4, 8, 16, 32, 64] {
                    let h = m.wavelength / n as f64;
                    println!("  {n}: {:?}", state.mode_on(m.wavelength, d.angle, [h; 2]).unwrap());
                }
            }
        }
        for (phi, wavelength) in [(0.05, 2e-3), (0.15, 0.9e-3)] {
            let state = Uniform::new(&CASE, phi);
            let exact = state.mode(wavelength, 0.0).unwrap();
            println!("{phi} exact {exact:?}");
            for (cells, dts) in [
                (8, vec![1.0, 2e-4]),
                (16, vec![1.0, 5e-5]),
                (32, vec![1.0, 5e-5, 2.5e-5, 1.25e-5]),
                (64, vec![1.0, 5e-5]),
            ] {
                let h = wavelength / cells as f64;
                let on = state.mode_on(wavelength, 0.0, [h; 2]).unwrap();
                for dt in dts {
                    let begin = std::time::Instant::now();
                    let times = if phi == 0.05 { [0.06, 0.10, 0.14] } else { [0.03, 0.045, 0.06] };
                    let a = simulated(phi, wavelength, cells, dt, &times);
                    let rate =
                        |n: usize| (a[n + 1].norm() / a[n].norm()).ln() / (times[n + 1] - times[n]);
                    println!(
                        "  {cells} dt {dt}: {:.4} {:.4} grid {:.4}, {:?}, amp {:e}",
                        rate(0),
                        rate(1),
                        on.growth_rate,
                        begin.elapsed(),
                        a[2].norm()
                    );
                }
            }
        }
    }
}
