//! The state of a [`Dem`] between two calls of [`Dem::run`], as bytes.
//!
//! Little-endian: number of spheres, cells along each axis, whether there are drives (u64 each); length
//! of a step, time, way travelled since pairs and near pairs were listed, frame, energy lost (f64);
//! steps and rebuilds (u64); numbers of the particles (u64 each), centres and radii, velocities and 1/m,
//! spins and 1/I, drives if any, forces, torques, by place in memory (4 f64 each); for each slab the place
//! of its first particle, and its pairs, near pairs, and contacts with whether they had their
//! last kick and their springs, each list after its length (u64), and the energy of the springs (f64). The pairs are there because the order of sums follows them.

use super::pairs::{Near, Pair, Touch};
use super::{Dem, Quad};
use std::io::{self, Read, Write};

/// A state that cannot be taken.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// It ends too early or cannot be read.
    #[error("the state cannot be read")]
    Read(#[from] io::Error),
    /// It is of other spheres, another box or another stiffness.
    #[error("the state is of {what} {found}, the simulator of {expected}")]
    Other {
        /// What differs.
        what: &'static str,
        /// That of the state.
        found: String,
        /// That of the simulator.
        expected: String,
    },
    /// It contradicts itself.
    #[error("the state is damaged: {0}")]
    Damaged(&'static str),
}

fn put(to: &mut dyn Write, number: u64) -> io::Result<()> {
    to.write_all(&number.to_le_bytes())
}

fn put_quads(to: &mut dyn Write, quads: &[Quad]) -> io::Result<()> {
    quads.iter().flat_map(|quad| quad.0).try_for_each(|number| put(to, number.to_bits()))
}

/// The next number of a state.
pub(crate) fn take(from: &mut dyn Read) -> io::Result<u64> {
    let mut bytes = [0; 8];
    from.read_exact(&mut bytes)?;
    Ok(u64::from_le_bytes(bytes))
}

/// The same as an f64.
pub(crate) fn take_f64(from: &mut dyn Read) -> io::Result<f64> {
    take(from).map(f64::from_bits)
}

fn take_quads(from: &mut dyn Read, quads: &mut [Quad]) -> io::Result<()> {
    quads.iter_mut().flat_map(|quad| &mut quad.0).try_for_each(|number| {
        *number = take_f64(from)?;
        Ok(())
    })
}

/// A list's length, which is none beyond `most`.
fn take_len(from: &mut dyn Read, most: usize) -> Result<usize, StateError> {
    match take(from)? {
        len if len <= most as u64 => Ok(len as usize),
        _ => Err(StateError::Damaged("a list is longer than it can be")),
    }
}

/// Next place in an ascending list of places below `end`.
fn take_place(from: &mut dyn Read, last: Option<u32>, end: usize) -> Result<u32, StateError> {
    match take(from)? {
        place if place < end as u64 && last.is_none_or(|last| u64::from(last) < place) => {
            Ok(place as u32)
        }
        _ => Err(StateError::Damaged("a list names a pair that there is not")),
    }
}

impl Dem {
    /// Writes all that the next step depends on. A [`Dem`] of the same set-up and as many spheres that
    /// takes it back with [`Dem::restore_state`] goes on to the same bits.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn save_state(&self, to: &mut dyn Write) -> io::Result<()> {
        let len = self.len();
        put(to, len as u64)?;
        self.cells.number.into_iter().try_for_each(|number| put(to, number as u64))?;
        put(to, u64::from(!self.particles.drives.is_empty()))?;
        let [fx, fy, fz] = self.frame;
        let [far, near] = self.travelled;
        for number in [self.dt, self.time, far, near, fx, fy, fz, self.lost] {
            put(to, number.to_bits())?;
        }
        put(to, self.steps)?;
        put(to, self.rebuilds)?;
        self.ids.iter().try_for_each(|&id| put(to, id.into()))?;
        let (forces, torques) = (&self.particles.forces[..len], &self.particles.torques[..len]);
        for quads in [
            &self.particles.positions,
            &self.particles.velocities,
            &self.particles.spins,
            &self.particles.drives,
            forces,
            torques,
        ] {
            put_quads(to, quads)?;
        }
        let contacts = self.all_contacts();
        for (slab, share) in self.slabs.iter().zip(self.shares()) {
            put(to, slab.begin as u64)?;
            put(to, slab.pairs.len() as u64)?;
            slab.pairs.iter().try_for_each(|pair| put(to, pair.bits()))?;
            put(to, slab.near.len() as u64)?;
            slab.near.iter().try_for_each(|near| put(to, near.place.into()))?;
            let (first, pairs) = (slab.number, slab.pairs.len() as u32);
            let begin = contacts.partition_point(|touch| touch.pair < first);
            let len = contacts[begin..].partition_point(|touch| touch.pair - first < pairs);
            put(to, len as u64)?;
            for touch in &contacts[begin..][..len] {
                put(to, (touch.pair - first).into())?;
                put(to, touch.ended.into())?;
                touch.spring.into_iter().try_for_each(|spring| put(to, spring.to_bits()))?;
            }
            put(to, share.springs.to_bits())?;
        }
        Ok(())
    }

    /// Takes a state that [`Dem::save_state`] wrote. If it cannot, the simulator is as it was.
    ///
    /// # Errors
    /// What cannot be read, is of other spheres or another box, or contradicts itself.
    pub fn restore_state(&mut self, from: &mut dyn Read) -> Result<(), StateError> {
        let mut taken = self.clone();
        taken.take_state(from)?;
        *self = taken;
        Ok(())
    }

    fn take_state(&mut self, from: &mut dyn Read) -> Result<(), StateError> {
        let other = |what, found: String, expected: String| {
            Err(StateError::Other { what, found, expected })
        };
        let len = self.len();
        let found = take(from)?;
        if found != len as u64 {
            return other("spheres:", found.to_string(), len.to_string());
        }
        let found = [take(from)?, take(from)?, take(from)?];
        if found != self.cells.number.map(|number| number as u64) {
            let expected = format!("{:?}", self.cells.number);
            return other("cells", format!("{found:?}"), expected);
        }
        let drives = if take(from)? == 1 { len } else { 0 };
        let found = take_f64(from)?;
        if found != self.dt {
            return other("steps of", format!("{found:e} s"), format!("{:e} s", self.dt));
        }
        self.time = take_f64(from)?;
        for number in self.travelled.iter_mut().chain(&mut self.frame) {
            *number = take_f64(from)?;
        }
        self.lost = take_f64(from)?;
        self.steps = take(from)?;
        self.rebuilds = take(from)?;
        for id in &mut self.ids {
            *id = take_place(from, None, len)?;
        }
        self.particles.drives.clear();
        self.particles.drives.resize(drives, Quad::default());
        for quads in [
            &mut self.particles.positions[..],
            &mut self.particles.velocities,
            &mut self.particles.spins,
            &mut self.particles.drives,
            &mut self.particles.forces[..len],
            &mut self.particles.torques[..len],
        ] {
            take_quads(from, quads)?;
        }
        self.part();
        let mut begin = 0;
        for slab in &mut self.slabs {
            slab.begin = take_len(from, len)?;
            if slab.begin < begin {
                return Err(StateError::Damaged("its slabs overlap"));
            }
            begin = slab.begin;
            // No more than any box has room for.
            let most = 1000 * len;
            slab.pairs.clear();
            slab.due.clear();
            for _ in 0..take_len(from, most)? {
                slab.pairs.push(Pair::of(take(from)?));
            }
            slab.near.clear();
            for _ in 0..take_len(from, slab.pairs.len())? {
                let last = slab.near.last().map(|near| near.place);
                let place = take_place(from, last, slab.pairs.len())?;
                slab.near.push(Near { pair: slab.pairs[place as usize], place });
            }
            slab.contacts.clear();
            for _ in 0..take_len(from, slab.pairs.len())? {
                let last = slab.contacts.last().map(|touch| touch.pair);
                let pair = take_place(from, last, slab.pairs.len())?;
                if slab.near.binary_search_by_key(&pair, |near| near.place).is_err() {
                    return Err(StateError::Damaged("a pair touches and is not near"));
                }
                let ended = take(from)? == 1;
                let spring = [take_f64(from)?, take_f64(from)?, take_f64(from)?];
                slab.contacts.push(Touch { spring, pair, ended });
            }
            slab.springs = take_f64(from)?;
        }
        // Pairs reach from their slab up into the next, or to its images above the last.
        let begins: Vec<usize> = self.slabs.iter().map(|slab| slab.begin).collect();
        let images = begins.get(1).copied().unwrap_or(len);
        let end = |slab: usize| match begins.get(slab) {
            Some(&begin) => begin,
            None if slab == begins.len() => len,
            None => len + images,
        };
        for (n, slab) in self.slabs.iter().enumerate() {
            let fine = slab.pairs.iter().all(|pair| {
                (end(n)..end(n + 1)).contains(&pair.first())
                    && (end(n)..end(n + 2)).contains(&(pair.slot as usize))
                    && pair.image() < super::pairs::IMAGES
            });
            if !fine || begins[0] != 0 {
                return Err(StateError::Damaged("a pair is of particles that there are not"));
            }
        }
        for quads in [&mut self.particles.forces, &mut self.particles.torques] {
            quads.truncate(len);
            quads.resize(len + images, Quad::default());
        }
        self.particles.touched.clear();
        self.particles.touched.resize(len + images, false);
        for slab in &self.slabs {
            for touch in &slab.contacts {
                let pair = slab.pairs[touch.pair as usize];
                self.particles.touched[pair.first()] = true;
                self.particles.touched[pair.second(len)] = true;
            }
        }
        self.number_pairs();
        self.group();
        self.speed = self.fastest();
        Ok(())
    }
}
