//! A state and sources imposed from outside: what verification needs and a run does not.
//!
//! Without sources a step costs what it costs without this file.

use super::{Limit, StepError, StepReport, TwoFluid};
use crate::field::{Faces, Field, Layout, Row};
use crate::real::Real;
use crate::rows::simd;

/// A field of the state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// φ, at centres.
    SolidsFraction,
    /// T \[m²/s²\], at centres.
    Temperature,
    /// Gas pressure less the mean gradient's \[Pa\], at centres.
    Pressure,
    /// u_s along an axis \[m/s\], on the lower face along it.
    SolidsVelocity(usize),
    /// u_g along an axis \[m/s\], on the lower face along it.
    GasVelocity(usize),
}

impl Quantity {
    /// Where the value of cell `index` lies \[m\], from the lower corner of the box.
    pub fn position<const D: usize>(self, spacing: [f64; D], index: [usize; D]) -> [f64; D] {
        std::array::from_fn(|a| {
            let on_face = matches!(self, Self::SolidsVelocity(b) | Self::GasVelocity(b) if b == a);
            spacing[a] * (index[a] as f64 + if on_face { 0.0 } else { 0.5 })
        })
    }
}

/// Rates added to a step's own.
pub(super) struct Sources<R, const D: usize> {
    /// Of u_s and u_g \[m/s²\].
    velocities: [Faces<R, D>; 2],
    /// Of T \[m²/s³\].
    temperature: Field<R, D>,
}

impl<R: Real, const D: usize> Sources<R, D> {
    fn zeros(layout: Layout<D>) -> Self {
        Self {
            velocities: std::array::from_fn(|_| Field::zero_faces(layout)),
            temperature: Field::zeros(layout),
        }
    }

    fn set(
        &mut self,
        mut velocities: impl FnMut(usize, [usize; D]) -> [f64; 2],
        mut temperature: impl FnMut([usize; D]) -> f64,
    ) {
        for axis in 0..D {
            for phase in 0..2 {
                self.velocities[phase][axis].set(|index| R::of(velocities(axis, index)[phase]));
            }
        }
        self.temperature.set(|index| R::of(temperature(index)));
    }

    /// T += dt rate in a row.
    pub(super) fn heat(&self, theta: &mut [R], row: Row<D>, dt: R) {
        add_row(theta, self.temperature.row(row), dt);
    }

    /// Leaves the velocities of both phases along `axis` plus dt times their rates in `pushed`.
    pub(super) fn push(
        &self,
        pushed: &mut [Vec<R>; 2],
        velocities: [&[R]; 2],
        axis: usize,
        row: Row<D>,
        dt: R,
    ) {
        for phase in 0..2 {
            let pushed = &mut pushed[phase][..velocities[phase].len()];
            pushed.copy_from_slice(velocities[phase]);
            add_row(pushed, self.velocities[phase][axis].row(row), dt);
        }
    }
}

simd! {
    /// q += dt rate.
    fn add_row[R: Real](q: &mut [R], rate: &[R], dt: R) {
        let rate = &rate[..q.len()];
        for (q, rate) in q.iter_mut().zip(rate) {
            *q += dt * *rate;
        }
    }
}

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// A field of the state.
    pub fn field(&self, quantity: Quantity) -> &Field<R, D> {
        match quantity {
            Quantity::SolidsFraction => &self.phi,
            Quantity::Temperature => &self.theta,
            Quantity::Pressure => &self.pressure,
            Quantity::SolidsVelocity(axis) => &self.solids[axis],
            Quantity::GasVelocity(axis) => &self.gas[axis],
        }
    }

    /// Replaces a field of the state by `value` of a cell's index; the mean solids fraction must
    /// stay what the set-up says, because the mean pressure gradient balances that.
    pub fn set_field(&mut self, quantity: Quantity, mut value: impl FnMut([usize; D]) -> f64) {
        let field = match quantity {
            Quantity::SolidsFraction => &mut self.phi,
            Quantity::Temperature => &mut self.theta,
            Quantity::Pressure => &mut self.pressure,
            Quantity::SolidsVelocity(axis) => &mut self.solids[axis],
            Quantity::GasVelocity(axis) => &mut self.gas[axis],
        };
        field.set(|index| R::of(value(index)));
        self.find_speeds();
    }

    /// Rates added from the next step on to those of the velocities and the temperature, per time,
    /// by axis (of the faces) and cell: (u_s, u_g) \[m/s²\], T \[m²/s³\].
    pub fn set_sources(
        &mut self,
        velocities: impl FnMut(usize, [usize; D]) -> [f64; 2],
        temperature: impl FnMut([usize; D]) -> f64,
    ) {
        let layout = Layout::from(&self.grid);
        self.sources.get_or_insert_with(|| Sources::zeros(layout)).set(velocities, temperature);
    }

    /// Rates as those of [`TwoFluid::set_sources`], for the first or the second of the two halves that
    /// a step of second order in time is also made in.
    pub fn set_half_sources(
        &mut self,
        half: usize,
        velocities: impl FnMut(usize, [usize; D]) -> [f64; 2],
        temperature: impl FnMut([usize; D]) -> f64,
    ) {
        let layout = Layout::from(&self.grid);
        let sources = self.half_sources[half].get_or_insert_with(|| Sources::zeros(layout));
        sources.set(velocities, temperature);
    }

    /// The next time step that stability allows \[s\], and what limits it.
    pub fn next_step(&self) -> (f64, Limit) {
        self.next_dt
    }

    /// Advances by exactly `dt` \[s\], whatever stability allows.
    ///
    /// # Errors
    /// Those of [`TwoFluid::step`].
    pub fn step_by(&mut self, dt: f64) -> Result<StepReport, StepError> {
        self.next_dt = (dt, Limit::Longest);
        self.step(f64::INFINITY)
    }
}
