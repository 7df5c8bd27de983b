//! The state of a [`TwoFluid`] between two steps, as bytes.
//!
//! Solids fraction, granular temperature, pressure and its last increment, both velocities, time, number of steps and the
//! next time step: a step reads nothing else that an earlier one wrote. Halos follow from the
//! cells; what depends on the set-up alone is made anew by [`TwoFluid::new`].
//!
//! Little-endian: bytes per number (u8), dimension (u8), cells along each axis (u64 each), time
//! (f64), steps (u64), next time step (f64) and what limits it (u8); then φ, T, p, δp, the components
//! of u_s and those of u_g, each row by row, first axis fastest, in the solver's precision; if a gas
//! flux is kept, the mean pressure gradient over the weight (f64).

use super::{Limit, Setup, TwoFluid};
use crate::field::Field;
use crate::grid::Grid;
use crate::real::Real;
use std::io::{self, Read, Write};

/// A state that cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// It ends too early or cannot be read.
    #[error("the state cannot be read")]
    Read(#[from] io::Error),
    /// It is of another precision.
    #[error("the state is of {found} bytes per number, the simulator of {expected}")]
    Precision {
        /// Bytes per number of the state.
        found: u8,
        /// Bytes per number of the simulator.
        expected: u8,
    },
    /// It is of another grid.
    #[error("the state is of {found:?} cells, the simulator of {expected:?}")]
    Cells {
        /// Cells of the state.
        found: Vec<u64>,
        /// Cells of the simulator.
        expected: Vec<u64>,
    },
    /// It names a limit of the time step that there is not.
    #[error("the state's time step is limited by number {0}, which means nothing")]
    Limit(u8),
}

impl<R: Real, const D: usize> TwoFluid<R, D> {
    /// Bytes per number: 4 or 8.
    const BYTES: usize = size_of::<R>();

    /// Writes all that the next step depends on. A model of the same set-up that takes it back with
    /// [`TwoFluid::restore_state`] goes on to the same bits.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn save_state(&self, to: &mut dyn Write) -> io::Result<()> {
        to.write_all(&[Self::BYTES as u8, D as u8])?;
        for cells in self.grid.cells {
            to.write_all(&(cells as u64).to_le_bytes())?;
        }
        let (next_dt, limit) = self.next_dt;
        to.write_all(&self.time.to_le_bytes())?;
        to.write_all(&self.steps.to_le_bytes())?;
        to.write_all(&next_dt.to_le_bytes())?;
        to.write_all(&[limit as u8])?;
        let mut bytes = Vec::with_capacity(self.grid.cells[0] * Self::BYTES);
        let scalars = [&self.phi, &self.theta, &self.pressure, &self.increment];
        for field in scalars.into_iter().chain(&self.solids).chain(&self.gas) {
            for row in field.interior() {
                bytes.clear();
                for q in row {
                    // Through f64 and back is exact for either precision.
                    match Self::BYTES {
                        4 => bytes.extend((q.f64() as f32).to_le_bytes()),
                        _ => bytes.extend(q.f64().to_le_bytes()),
                    }
                }
                to.write_all(&bytes)?;
            }
        }
        if let Some(flux) = self.gas_flux {
            to.write_all(&flux.gradient.to_le_bytes())?;
        }
        Ok(())
    }

    /// This flow in `S` and in a larger box, `times` its own along each axis and filled with copies
    /// of it: a developed flow of any size without its development.
    pub fn tiled<S: Real>(&self, times: [usize; D], parallel: bool) -> TwoFluid<S, D> {
        let cells = std::array::from_fn(|axis| self.grid.cells[axis] * times[axis]);
        let grid = Grid { cells, spacing: self.grid.spacing };
        let setup = Setup { perturbation: 0.0, parallel, ..self.setup };
        let mut tiled = TwoFluid::<S, D>::perturbed(grid, setup, |_| 0.0);
        (tiled.time, tiled.steps, tiled.next_dt) = (self.time, self.steps, self.next_dt);
        let copy = |(to, from): (&mut Field<S, D>, &Field<R, D>)| {
            to.set(|index| {
                let own: [usize; D] = std::array::from_fn(|a| index[a] % self.grid.cells[a]);
                let row = (1..D).rev().fold(0, |row, a| row * self.grid.cells[a] + own[a]);
                S::of(from.row(from.layout.row(row))[own[0]].f64())
            });
        };
        [&mut tiled.phi, &mut tiled.theta, &mut tiled.pressure, &mut tiled.increment]
            .into_iter()
            .zip([&self.phi, &self.theta, &self.pressure, &self.increment])
            .for_each(copy);
        tiled.solids.iter_mut().zip(&self.solids).for_each(copy);
        tiled.gas.iter_mut().zip(&self.gas).for_each(copy);
        tiled.gas_flux = self.gas_flux;
        tiled.find_speeds();
        tiled
    }

    /// Takes what [`TwoFluid::save_state`] wrote of a model of the same set-up, in place of its own
    /// state.
    ///
    /// # Errors
    /// The state is of another precision or grid (nothing is taken then), or ends too early (the
    /// model is of no use any more).
    pub fn restore_state(&mut self, from: &mut dyn Read) -> Result<(), StateError> {
        let [found, dimension] = bytes::<2>(from)?;
        let expected = Self::BYTES as u8;
        if found != expected {
            return Err(StateError::Precision { found, expected });
        }
        let found = (0..dimension)
            .map(|_| bytes(from).map(u64::from_le_bytes))
            .collect::<io::Result<Vec<_>>>()?;
        let expected = self.grid.cells.map(|cells| cells as u64);
        if found != expected {
            return Err(StateError::Cells { found, expected: expected.into() });
        }
        let time = f64::from_le_bytes(bytes(from)?);
        let steps = u64::from_le_bytes(bytes(from)?);
        let next_dt = f64::from_le_bytes(bytes(from)?);
        let [limit] = bytes(from)?;
        let limit = *Limit::ALL.get(usize::from(limit)).ok_or(StateError::Limit(limit))?;
        (self.time, self.steps, self.next_dt) = (time, steps, (next_dt, limit));
        let scalars = [&mut self.phi, &mut self.theta, &mut self.pressure, &mut self.increment];
        for field in scalars.into_iter().chain(&mut self.solids).chain(&mut self.gas) {
            read_field(field, from)?;
        }
        if let Some(flux) = &mut self.gas_flux {
            flux.gradient = f64::from_le_bytes(bytes(from)?);
        }
        self.find_speeds();
        Ok(())
    }
}

/// Reads the cells of a field, row by row, and fills its halo.
fn read_field<R: Real, const D: usize>(
    field: &mut Field<R, D>,
    from: &mut dyn Read,
) -> io::Result<()> {
    let mut bytes = vec![0; field.layout.cells[0] * size_of::<R>()];
    for row in 0..field.layout.rows() {
        from.read_exact(&mut bytes)?;
        let cells = field.row_mut(field.layout.row(row)).iter_mut();
        // `as_chunks` cuts into whole numbers: the buffer holds nothing else.
        if size_of::<R>() == 4 {
            let numbers = bytes.as_chunks().0.iter();
            cells.zip(numbers).for_each(|(q, n)| *q = R::of(f32::from_le_bytes(*n).into()));
        } else {
            let numbers = bytes.as_chunks().0.iter();
            cells.zip(numbers).for_each(|(q, n)| *q = R::of(f64::from_le_bytes(*n)));
        }
    }
    field.wrap();
    Ok(())
}

fn bytes<const N: usize>(from: &mut dyn Read) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    from.read_exact(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::super::tests::setup;
    use super::*;
    use crate::fine::FineFields;

    fn flow<R: Real, const D: usize>(cells: [usize; D]) -> TwoFluid<R, D> {
        TwoFluid::new(Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells), setup(0.15, 0.2))
    }

    fn state<R: Real, const D: usize>(flow: &TwoFluid<R, D>) -> Vec<u8> {
        let mut bytes = Vec::new();
        flow.save_state(&mut bytes).unwrap();
        bytes
    }

    fn advance<R: Real, const D: usize>(flow: &mut TwoFluid<R, D>, steps: usize) {
        for _ in 0..steps {
            flow.step(f64::INFINITY).unwrap();
        }
    }

    #[test]
    fn tiles_repeat_the_flow_and_go_on_like_it() {
        let mut flow = flow::<f64, 3>([8, 10, 12]);
        advance(&mut flow, 20);
        let mut tiled = flow.tiled::<f64>([2, 1, 3], true);
        assert_eq!(tiled.grid.cells, [16, 10, 36]);
        let (mut one, mut all) = (FineFields::zeros(flow.grid), FineFields::zeros(tiled.grid));
        for _ in 0..10 {
            flow.step(f64::INFINITY).unwrap();
            tiled.step(f64::INFINITY).unwrap();
        }
        flow.fields(&mut one);
        tiled.fields(&mut all);
        let mut most: f64 = 0.0;
        for cell in 0..tiled.grid.len() {
            let [i, j, k] = [cell % 16 % 8, cell / 16 % 10, cell / 160 % 12];
            let own = i + 8 * (j + 10 * k);
            most = most.max((all.solids_fraction[cell] - one.solids_fraction[own]).abs());
        }
        // The pressure iterations end elsewhere on the larger grid.
        assert!(most < 1e-5, "{most}");
        assert_eq!(tiled.time, flow.time);
    }

    /// Goes on from a state in a model whose scratch memory holds something else: new, and far
    /// ahead.
    fn goes_on_to_the_same_bits<R: Real, const D: usize>(cells: [usize; D]) {
        let mut straight = flow::<R, D>(cells);
        advance(&mut straight, 40);
        let kept = state(&straight);
        let header = 2 + 8 * D + 8 + 8 + 8 + 1;
        assert_eq!(kept.len(), header + (4 + 2 * D) * straight.grid.len() * size_of::<R>());
        advance(&mut straight, 40);
        for ahead in [0, 150] {
            let mut other = flow::<R, D>(cells);
            advance(&mut other, ahead);
            other.restore_state(&mut kept.as_slice()).unwrap();
            assert!(state(&other) == kept, "a state taken is not the state kept");
            advance(&mut other, 40);
            assert!(state(&other) == state(&straight), "{cells:?}, {ahead} steps ahead");
            assert_eq!(other.means(), straight.means());
        }
    }

    #[test]
    fn a_state_is_all_that_a_step_depends_on() {
        goes_on_to_the_same_bits::<f64, 2>([16, 24]);
        goes_on_to_the_same_bits::<f32, 2>([24, 16]);
        goes_on_to_the_same_bits::<f64, 3>([8, 10, 12]);
        goes_on_to_the_same_bits::<f32, 3>([12, 10, 8]);
    }

    #[test]
    fn every_limit_comes_back() {
        let mut flow = flow::<f64, 2>([8, 8]);
        for limit in Limit::ALL {
            flow.next_dt = (1.5, limit);
            let kept = state(&flow);
            flow.next_dt = (0.0, Limit::Growth);
            flow.restore_state(&mut kept.as_slice()).unwrap();
            assert_eq!(flow.next_dt, (1.5, limit));
        }
    }

    #[test]
    fn a_state_of_another_precision_or_grid_is_refused() {
        let kept = state(&flow::<f64, 2>([8, 10]));
        let mut single = flow::<f32, 2>([8, 10]);
        let refused = single.restore_state(&mut kept.as_slice());
        assert!(matches!(refused, Err(StateError::Precision { found: 8, expected: 4 })));
        let mut turned = flow::<f64, 2>([10, 8]);
        let refused = turned.restore_state(&mut kept.as_slice());
        assert!(matches!(refused, Err(StateError::Cells { .. })), "{refused:?}");
        let refused = flow::<f64, 3>([8, 10, 8]).restore_state(&mut kept.as_slice());
        assert!(matches!(refused, Err(StateError::Cells { .. })), "{refused:?}");
        let mut same = flow::<f64, 2>([8, 10]);
        for len in [0, 1, 17, 42, kept.len() - 1] {
            let refused = same.restore_state(&mut &kept[..len]);
            assert!(matches!(refused, Err(StateError::Read(_))), "{len}: {refused:?}");
        }
        let mut unknown = kept;
        let none = Limit::ALL.len() as u8;
        unknown[2 + 16 + 24] = none;
        let refused = same.restore_state(&mut unknown.as_slice());
        assert!(matches!(refused, Err(StateError::Limit(n)) if n == none), "{refused:?}");
    }
}
