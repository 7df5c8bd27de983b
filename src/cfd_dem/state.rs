//! The state of a [`CfdDem`] between two steps, as bytes.
//!
//! Little-endian: cells along each axis (u64 each); time, next step (f64) and what limits it (u64), the step
//! before (f64), the mean pressure gradient over the weight (f64); φ now and of the two steps before, p and its last increment, the components of u, each
//! row by row, first axis fastest (f64); the number of contacts (u64), and the place, arm and force of each
//! (10 f64); then the particles, with what they are owed
//! ([`Dem::save_state`](crate::dem::Dem::save_state)).

use super::CfdDem;
use crate::dem::{self, Quad, Seen, take, take_f64};
use crate::field::Field;
use crate::simulation::Limit;
use std::io::{self, Read, Write};

/// A state that cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// It ends too early or cannot be read.
    #[error("the state cannot be read")]
    Read(#[from] io::Error),
    /// It is of another grid.
    #[error("the state is of {found:?} cells, the simulator of {expected:?}")]
    Cells {
        /// Cells of the state.
        found: [u64; 3],
        /// Cells of the simulator.
        expected: [u64; 3],
    },
    /// It names a limit of the time step that there is not.
    #[error("the state's time step is limited by number {0}, which means nothing")]
    Limit(u64),
    /// It has more contacts than its particles can have.
    #[error("the state has {0} contacts, more than its particles can have")]
    Touches(u64),
    /// Of its particles.
    #[error("the state of the particles")]
    Particles(#[from] dem::StateError),
}

fn put_f64(to: &mut dyn Write, number: f64) -> io::Result<()> {
    to.write_all(&number.to_le_bytes())
}

fn put_field(to: &mut dyn Write, field: &Field<f64, 3>) -> io::Result<()> {
    field.interior().flatten().try_for_each(|number| put_f64(to, *number))
}

fn take_field(from: &mut dyn Read, field: &mut Field<f64, 3>) -> io::Result<()> {
    let mut failed = Ok(());
    field.set(|_| {
        take_f64(from).unwrap_or_else(|error| {
            if failed.is_ok() {
                failed = Err(error);
            }
            0.0
        })
    });
    failed
}

impl CfdDem {
    /// Writes all that the next step depends on. A box of the same set-up that takes it back with
    /// [`CfdDem::restore_state`] goes on to the same bits.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn save_state(&self, to: &mut dyn Write) -> io::Result<()> {
        for cells in self.grid.cells {
            to.write_all(&(cells as u64).to_le_bytes())?;
        }
        let (next_dt, limit) = self.next_dt;
        put_f64(to, self.time)?;
        put_f64(to, next_dt)?;
        to.write_all(&(limit as u64).to_le_bytes())?;
        put_f64(to, self.last_dt)?;
        put_f64(to, self.pressure_gradient())?;
        for field in self.phi.iter().chain([&self.pressure, &self.increment]).chain(&self.gas) {
            put_field(to, field)?;
        }
        to.write_all(&(self.touches.len() as u64).to_le_bytes())?;
        for Seen { place, arm, force } in &self.touches {
            let numbers = place.0.iter().chain(arm).chain(force);
            numbers.into_iter().try_for_each(|number| put_f64(to, *number))?;
        }
        self.dem.save_state(to)
    }

    /// Takes what [`CfdDem::save_state`] wrote.
    ///
    /// # Errors
    /// It is of another grid, of other particles, or damaged.
    pub fn restore_state(&mut self, from: &mut dyn Read) -> Result<(), StateError> {
        let expected = self.grid.cells.map(|cells| cells as u64);
        let found = [take(from)?, take(from)?, take(from)?];
        if found != expected {
            return Err(StateError::Cells { found, expected });
        }
        self.time = take_f64(from)?;
        let next_dt = take_f64(from)?;
        let limit = take(from)?;
        let known = usize::try_from(limit).ok().and_then(|limit| Limit::ALL.get(limit));
        self.next_dt = (next_dt, *known.ok_or(StateError::Limit(limit))?);
        self.last_dt = take_f64(from)?;
        let gradient = take_f64(from)?;
        if let Some(flux) = &mut self.gas_flux {
            flux.gradient = gradient;
        }
        let Self { phi, pressure, increment, gas, .. } = self;
        for field in phi.iter_mut().chain([pressure, increment]).chain(gas) {
            take_field(from, field)?;
        }
        let touches = take(from)?;
        if touches > 12 * self.dem.len() as u64 {
            return Err(StateError::Touches(touches));
        }
        self.touches.clear();
        for _ in 0..touches {
            let mut numbers = [0.0; 10];
            for number in &mut numbers {
                *number = take_f64(from)?;
            }
            let [x, y, z, half, ax, ay, az, fx, fy, fz] = numbers;
            let (place, arm, force) = (Quad([x, y, z, half]), [ax, ay, az], [fx, fy, fz]);
            self.touches.push(Seen { place, arm, force });
        }
        self.dem.restore_state(from)?;
        self.see_pulls();
        Ok(())
    }
}
