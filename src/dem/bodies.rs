//! What there is of each particle, array by array: owned, or a stretch of it lent.

use super::Quad;

/// The arrays, in one order of the particles.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Each<Q, T> {
    /// Centre and radius.
    pub(super) positions: Q,
    /// Velocity and 1/m.
    pub(super) velocities: Q,
    /// Angular velocity and 1/I.
    pub(super) spins: Q,
    /// Acceleration and rate from outside; empty if there is none.
    pub(super) drives: Q,
    /// Contact forces; owned, those on the images above the last slab come after the particles'.
    pub(super) forces: Q,
    /// Contact torques, likewise.
    pub(super) torques: Q,
    /// Whether a contact has added to a force and torque, likewise; where none has, they are zero.
    pub(super) touched: T,
}

/// All that there is.
pub(super) type Particles = Each<Vec<Quad>, Vec<bool>>;

/// A stretch of the particles, to be moved.
pub(super) type Bodies<'a> = Each<&'a mut [Quad], &'a mut [bool]>;

/// A stretch of the particles, to be looked at.
pub(super) type Still<'a> = Each<&'a [Quad], &'a [bool]>;

impl Particles {
    /// Bytes.
    pub(super) fn memory(&self) -> usize {
        let Self { positions, velocities, spins, drives, forces, torques, touched } = self;
        let quads = [positions, velocities, spins, drives, forces, torques];
        quads.map(Vec::capacity).iter().sum::<usize>() * size_of::<Quad>() + touched.capacity()
    }

    /// Makes room for `len` particles without drives, and for the loads of so many `images`.
    pub(super) fn fit(&mut self, len: usize, images: usize) {
        let Self { positions, velocities, spins, forces, torques, touched, .. } = self;
        [positions, velocities, spins].into_iter().for_each(|quads| fit(quads, len));
        [forces, torques].into_iter().for_each(|quads| fit(quads, len + images));
        fit(touched, len + images);
    }

    pub(super) fn bodies(&mut self) -> Bodies<'_> {
        let Self { positions, velocities, spins, drives, forces, torques, touched } = self;
        Each { positions, velocities, spins, drives, forces, torques, touched }
    }

    pub(super) fn still(&self) -> Still<'_> {
        let Self { positions, velocities, spins, drives, forces, torques, touched } = self;
        Each { positions, velocities, spins, drives, forces, torques, touched }
    }
}

impl Bodies<'_> {
    /// The same, for a while.
    pub(super) fn lend(&mut self) -> Bodies<'_> {
        let Self { positions, velocities, spins, drives, forces, torques, touched } = self;
        Each { positions, velocities, spins, drives, forces, torques, touched }
    }

    /// The particles before place `at`, and those from it on, which the images go with.
    pub(super) fn split_at(self, at: usize) -> (Self, Self) {
        let (positions, positions2) = self.positions.split_at_mut(at);
        let (velocities, velocities2) = self.velocities.split_at_mut(at);
        let (spins, spins2) = self.spins.split_at_mut(at);
        let (drives, drives2) = self.drives.split_at_mut(at.min(self.drives.len()));
        let (forces, forces2) = self.forces.split_at_mut(at);
        let (torques, torques2) = self.torques.split_at_mut(at);
        let (touched, touched2) = self.touched.split_at_mut(at);
        let first = Self { positions, velocities, spins, drives, forces, torques, touched };
        let second = Self {
            positions: positions2,
            velocities: velocities2,
            spins: spins2,
            drives: drives2,
            forces: forces2,
            torques: torques2,
            touched: touched2,
        };
        (first, second)
    }

    /// Two parts, the first as many particles as whole `chunks` of so many have.
    pub(super) fn halves(self, chunk: usize) -> (Self, Self) {
        let at = (self.positions.len() / 2).next_multiple_of(chunk);
        self.split_at(at)
    }
}

/// Makes room for `len` items, with little to spare.
pub(super) fn fit<T: Clone + Default>(items: &mut Vec<T>, len: usize) {
    if len > items.capacity() {
        items.reserve_exact(len + len / 16 - items.len());
    }
    items.resize(len, T::default());
}
