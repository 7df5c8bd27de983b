//! Kicks and drifts: the motion of each particle between two looks at its contacts.

use super::{Dem, Quad};
use crate::rows::{join, simd};

/// Particles that a thread moves at a time.
const CHUNK: usize = 2048;

/// A stretch of the particles.
struct Bodies<'a> {
    positions: &'a mut [Quad],
    velocities: &'a mut [Quad],
    spins: &'a mut [Quad],
    forces: &'a mut [Quad],
    torques: &'a mut [Quad],
    touched: &'a mut [bool],
    /// As long as the others, or empty.
    drives: &'a [Quad],
}

impl Bodies<'_> {
    /// Two parts, the first whole chunks.
    fn halves(self) -> (Self, Self) {
        let at = (self.positions.len() / 2).next_multiple_of(CHUNK);
        let (positions, positions2) = self.positions.split_at_mut(at);
        let (velocities, velocities2) = self.velocities.split_at_mut(at);
        let (spins, spins2) = self.spins.split_at_mut(at);
        let (forces, forces2) = self.forces.split_at_mut(at);
        let (torques, torques2) = self.torques.split_at_mut(at);
        let (touched, touched2) = self.touched.split_at_mut(at);
        let (drives, drives2) = self.drives.split_at(at.min(self.drives.len()));
        let first = Self { positions, velocities, spins, forces, torques, touched, drives };
        let second = Self {
            positions: positions2,
            velocities: velocities2,
            spins: spins2,
            forces: forces2,
            torques: torques2,
            touched: touched2,
            drives: drives2,
        };
        (first, second)
    }
}

/// Kicks of the lengths `kicks` \[s\]: half a step after a drift, and half a step before the next. Both are
/// done where one would do, so that steps made one by one give the bits of those made together.
#[inline(always)]
fn kick<const K: usize>(
    kicks: [f64; K],
    velocity: &mut Quad,
    spin: &mut Quad,
    load: Option<(&Quad, &Quad)>,
    drive: Option<&Quad>,
) {
    let lighter = velocity.0[3];
    // What is held is not driven.
    let drive = drive.filter(|_| lighter > 0.0);
    if load.is_none() && drive.is_none() {
        return;
    }
    let Quad([px, py, pz, rate]) = drive.copied().unwrap_or_default();
    let Quad([fx, fy, fz, _]) = load.map(|(force, _)| *force).unwrap_or_default();
    let by = [lighter * fx + px, lighter * fy + py, lighter * fz + pz];
    for kick in kicks {
        for axis in 0..3 {
            velocity.0[axis] += kick * by[axis];
        }
        if drive.is_some() {
            let damped = 1.0 / (1.0 + kick * rate);
            for axis in 0..3 {
                velocity.0[axis] *= damped;
            }
        }
        if let Some((_, torque)) = load {
            let turning = spin.0[3];
            for axis in 0..3 {
                spin.0[axis] += kick * (turning * torque.0[axis]);
            }
        }
    }
}

simd! {
    /// Kicks and moves particles, takes their forces off, and returns the largest square of a speed against
    /// `frame`, as bits: those of what is not a number are larger than any other. Forces and torques
    /// are looked at only where something touched: most memory is left alone.
    fn advance[const K: usize](bodies: Bodies<'_>, kicks: [f64; K], dt: f64, frame: [f64; 3]) -> u64 {
        let Bodies { positions, velocities, spins, forces, torques, touched, drives } = bodies;
        let n = positions.len();
        let (velocities, spins) = (&mut velocities[..n], &mut spins[..n]);
        let (forces, torques) = (&mut forces[..n], &mut torques[..n]);
        let touched = &mut touched[..n];
        let mut most = 0;
        for i in 0..n {
            let velocity = &mut velocities[i];
            let drive = drives.get(i);
            if touched[i] {
                kick(kicks, velocity, &mut spins[i], Some((&forces[i], &torques[i])), drive);
                (forces[i], torques[i], touched[i]) = (Quad::default(), Quad::default(), false);
            } else if drive.is_some() {
                kick(kicks, velocity, &mut spins[i], None, drive);
            }
            let mut square = 0.0;
            for axis in 0..3 {
                positions[i].0[axis] += dt * velocity.0[axis];
                let speed = velocity.0[axis] - frame[axis];
                square += speed * speed;
            }
            most = most.max(square.to_bits() & !SIGN);
        }
        most
    }
}

/// The sign of a number's bits: what is not a number may have one.
const SIGN: u64 = 1 << 63;

simd! {
    /// Kicks particles by half a step.
    fn finish[](bodies: Bodies<'_>, half: f64) {
        let Bodies { velocities, spins, forces, torques, touched, drives, .. } = bodies;
        for i in 0..velocities.len() {
            let load = touched[i].then(|| (&forces[i], &torques[i]));
            kick([half], &mut velocities[i], &mut spins[i], load, drives.get(i));
        }
    }
}

/// [`advance`] for all, in parts.
fn advance_all(parallel: bool, bodies: Bodies, kicks: usize, dt: f64, frame: [f64; 3]) -> u64 {
    if bodies.positions.len() > CHUNK {
        let (first, second) = bodies.halves();
        let (first, second) = join(
            parallel,
            || advance_all(parallel, first, kicks, dt, frame),
            || advance_all(parallel, second, kicks, dt, frame),
        );
        return first.max(second);
    }
    let half = 0.5 * dt;
    if kicks == 1 {
        advance(bodies, [half], dt, frame)
    } else {
        advance(bodies, [half; 2], dt, frame)
    }
}

/// [`finish`] for all, in parts.
fn finish_all(parallel: bool, bodies: Bodies, dt: f64) {
    if bodies.positions.len() > CHUNK {
        let (first, second) = bodies.halves();
        join(parallel, || finish_all(parallel, first, dt), || finish_all(parallel, second, dt));
        return;
    }
    finish(bodies, 0.5 * dt);
}

impl Dem {
    fn bodies(&mut self) -> Bodies<'_> {
        let len = self.positions.len();
        Bodies {
            positions: &mut self.positions,
            velocities: &mut self.velocities,
            spins: &mut self.spins,
            forces: &mut self.forces[..len],
            torques: &mut self.torques[..len],
            touched: &mut self.touched[..len],
            drives: &self.drives,
        }
    }

    /// Kicks by as many half steps, moves all by a whole one and takes the forces off. Returns the
    /// largest speed against the frame, not a number if one is not \[m/s\].
    pub(super) fn kick_and_drift(&mut self, kicks: usize) -> f64 {
        let (parallel, dt, frame) = (self.setup.parallel, self.dt, self.frame);
        f64::from_bits(advance_all(parallel, self.bodies(), kicks, dt, frame)).sqrt()
    }

    /// Kicks by half a step: velocities are then those of the time that positions and forces are of.
    pub(super) fn kick(&mut self) {
        let (parallel, dt) = (self.setup.parallel, self.dt);
        finish_all(parallel, self.bodies(), dt);
    }
}
