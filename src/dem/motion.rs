//! Kicks and drifts: the motion of each particle between two looks at its contacts.

use super::bodies::Bodies;
use super::{Dem, Quad};
use crate::rows::{join, simd};

/// Particles that a thread moves at a time.
pub(super) const CHUNK: usize = 2048;

/// Whether a drive has a rate: a kernel for each answer.
#[derive(Clone, Copy)]
pub(super) struct Damped<const DAMPED: bool>;

/// Kicks of the lengths `kicks` \[s\]: half a step after a drift, and half a step before the next. Both are
/// done where one would do, so that steps made one by one give the bits of those made together.
#[inline(always)]
fn kick<const K: usize, const DAMPED: bool>(
    kicks: [f64; K],
    velocity: &mut Quad,
    spin: &mut Quad,
    load: Option<(&Quad, &Quad)>,
    drive: Option<&Quad>,
    _damped: Damped<DAMPED>,
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
        if DAMPED && drive.is_some() {
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
    pub(super) fn advance[const K: usize, const DAMPED: bool](
        bodies: Bodies<'_>,
        kicks: [f64; K],
        dt: f64,
        frame: [f64; 3],
        damped: Damped<DAMPED>,
    ) -> u64 {
        let Bodies { positions, velocities, spins, forces, torques, touched, drives } = bodies;
        let n = positions.len();
        let (velocities, spins) = (&mut velocities[..n], &mut spins[..n]);
        let (forces, torques) = (&mut forces[..n], &mut torques[..n]);
        let touched = &mut touched[..n];
        let mut most = 0;
        // All four numbers of a quad at once: the fourth stays what it is.
        let step = [dt, dt, dt, 0.0];
        let (frame, counts) = ([frame[0], frame[1], frame[2], 0.0], [1.0, 1.0, 1.0, 0.0]);
        for i in 0..n {
            let velocity = &mut velocities[i];
            let drive = drives.get(i);
            let was = touched[i];
            if was {
                let load = Some((&forces[i], &torques[i]));
                kick(kicks, velocity, &mut spins[i], load, drive, damped);
                (forces[i], torques[i], touched[i]) = (Quad::default(), Quad::default(), false);
            } else if DAMPED {
                kick(kicks, velocity, &mut spins[i], None, drive, damped);
            }
            // Whole quads, read before any is written, or it would be done number by number.
            let (mut v, mut x) = (velocity.0, positions[i].0);
            if let (Some(drive), false, false) = (drive, DAMPED, was) {
                let by = drive.0;
                let driven = if v[3] > 0.0 { 1.0 } else { 0.0 };
                for kick in kicks {
                    let kick = driven * kick;
                    v = std::array::from_fn(|n| v[n] + kick * by[n]);
                }
            }
            x = std::array::from_fn(|n| x[n] + step[n] * v[n]);
            (velocity.0, positions[i].0) = (v, x);
            let speed: [f64; 4] = std::array::from_fn(|n| counts[n] * (v[n] - frame[n]));
            let squares: [f64; 4] = std::array::from_fn(|n| speed[n] * speed[n]);
            let square = (squares[0] + squares[2]) + (squares[1] + squares[3]);
            most = most.max(square.to_bits() & !SIGN);
        }
        most
    }
}

/// The sign of a number's bits: what is not a number may have one.
pub(super) const SIGN: u64 = 1 << 63;

simd! {
    /// Kicks particles by half a step.
    pub(super) fn finish[](bodies: Bodies<'_>, half: f64) {
        let Bodies { velocities, spins, forces, torques, touched, drives, .. } = bodies;
        for i in 0..velocities.len() {
            let load = touched[i].then(|| (&forces[i], &torques[i]));
            kick([half], &mut velocities[i], &mut spins[i], load, drives.get(i), Damped::<true>);
        }
    }
}

/// [`advance`] for all, in parts.
fn advance_all<const DAMPED: bool>(
    parallel: bool,
    bodies: Bodies,
    kicks: usize,
    dt: f64,
    frame: [f64; 3],
    damped: Damped<DAMPED>,
) -> u64 {
    if bodies.positions.len() > CHUNK {
        let (first, second) = bodies.halves(CHUNK);
        let (first, second) = join(
            parallel,
            || advance_all(parallel, first, kicks, dt, frame, damped),
            || advance_all(parallel, second, kicks, dt, frame, damped),
        );
        return first.max(second);
    }
    let half = 0.5 * dt;
    if kicks == 1 {
        advance(bodies, [half], dt, frame, damped)
    } else {
        advance(bodies, [half; 2], dt, frame, damped)
    }
}

/// [`finish`] for all, in parts.
fn finish_all(parallel: bool, bodies: Bodies, dt: f64) {
    if bodies.positions.len() > CHUNK {
        let (first, second) = bodies.halves(CHUNK);
        join(parallel, || finish_all(parallel, first, dt), || finish_all(parallel, second, dt));
        return;
    }
    finish(bodies, 0.5 * dt);
}

impl Dem {
    /// Kicks by as many half steps, moves all by a whole one and takes the forces off. Returns the
    /// largest speed against the frame, not a number if one is not \[m/s\].
    pub(super) fn kick_and_drift(&mut self, kicks: usize) -> f64 {
        let (parallel, dt, frame) = (self.setup.parallel, self.dt, self.frame);
        let square = if self.damped {
            advance_all(parallel, self.particles.bodies(), kicks, dt, frame, Damped::<true>)
        } else {
            advance_all(parallel, self.particles.bodies(), kicks, dt, frame, Damped::<false>)
        };
        f64::from_bits(square).sqrt()
    }

    /// Kicks by half a step: velocities are then those of the time that positions and forces are of.
    pub(super) fn kick(&mut self) {
        let (parallel, dt) = (self.setup.parallel, self.dt);
        finish_all(parallel, self.particles.bodies(), dt);
    }
}
