//! Rounds: several steps of all particles, memory walked once for all of them.
//!
//! Until near pairs are listed anew, particles that no chain of near pairs joins do not meet. In a dilute
//! box most have no near pair: they fly, several at a time in registers, a whole round. The others make
//! small clusters. Those whose highest particle lies in one slab are a group: a group is gathered to where
//! it lies close together, stepped there without a look at the rest, and brought back.
//!
//! A round is no longer than pairs stay as they are listed. Before it, the speeds so far and what drives
//! may add to them say how many steps those are at least. Contacts may make clusters faster than that, so
//! groups go first, and if one was, they go again for fewer steps, before anything else has moved. The
//! steps at which pairs are listed or a run fails are those of steps made one by one, and so are the bits
//! of every particle.
//!
//! Where particles lie dense, clusters join throughout the box. Then steps are made one by one, slab by
//! slab (`forces.rs`), until near pairs are listed next.

use super::bodies::{Bodies, Particles, Still, fit};
use super::forces::{Scene, among};
use super::motion::{CHUNK, Damped, SIGN, advance, finish};
use super::pairs::{IMAGES, Near, Slab, Touch};
use super::{Dem, Quad, Setup, StepError};
use crate::rows::{join, simd};

/// Most steps in a round.
const LONGEST: usize = 64;

/// Most particles with a near pair, over all: where there are more, steps are made one by one \[-\].
const CHAINED: f64 = 0.5;

/// Most particles in one group, over [`CHAINED`] of all: threads share groups out \[-\].
const LARGEST: f64 = 0.125;

/// Slot of a particle without a near pair.
const FREE: u32 = u32::MAX;

/// Particles that fly together.
const LANES: usize = 8;

/// What a way may be longer than its bound, by round-off \[-\].
const ROUND_OFF: f64 = 1e-9;

/// Clusters that are stepped together.
#[derive(Clone, Debug, Default)]
struct Group {
    /// The slot of its first particle, its near pairs between slots counted from there, their contacts.
    share: Slab,
    /// Its contacts before the round.
    before: Vec<Touch>,
    record: Record,
}

/// What happened to a group in a round.
#[derive(Clone, Debug)]
struct Record {
    /// Largest square of a speed in each drift, as bits.
    squares: [u64; LONGEST],
    /// Deepest overlap and energy lost in the contacts after each drift; at place 0 in those before the first.
    deepest: [f64; LONGEST + 1],
    lost: [f64; LONGEST + 1],
}

impl Default for Record {
    fn default() -> Self {
        Self { squares: [0; LONGEST], deepest: [0.0; LONGEST + 1], lost: [0.0; LONGEST + 1] }
    }
}

impl Record {
    /// Notes the last contacts, those after drift `step`.
    fn note(&mut self, step: usize, share: &Slab) {
        (self.deepest[step], self.lost[step]) = (share.deepest, share.lost);
    }
}

/// The groups, and their particles gathered group by group: a particle's place there is its slot.
#[derive(Clone, Debug, Default)]
pub(super) struct Groups {
    /// Whether rounds are made.
    pub(super) apart: bool,
    /// Slot of each particle, or that it is free.
    slots: Vec<u32>,
    /// Place of the particle, and number of the group, of each slot.
    places: Vec<u32>,
    owners: Vec<u32>,
    /// One for each slab.
    all: Vec<Group>,
    /// Loads go on to the images of the last group.
    gathered: Particles,
    members: Members,
}

impl Groups {
    /// Bytes.
    pub(super) fn memory(&self) -> usize {
        let Members { places, parents, slabs } = &self.members;
        let numbers = [&self.slots, &self.places, &self.owners, places, parents, slabs];
        let touches = |group: &Group| group.before.capacity() * size_of::<Touch>();
        let group = |group: &Group| size_of::<Group>() + group.share.memory() + touches(group);
        numbers.map(|numbers| numbers.capacity() * size_of::<u32>()).iter().sum::<usize>()
            + self.gathered.memory()
            + self.all.iter().map(group).sum::<usize>()
    }
}

/// Particles that have a near pair, in the order in which pairs name them, and who is chained to whom.
#[derive(Clone, Debug, Default)]
struct Members {
    places: Vec<u32>,
    /// A member of the same cluster; the cluster's root names itself.
    parents: Vec<u32>,
    /// The slab that the member lies in; of a root, the highest that one of its cluster does.
    slabs: Vec<u32>,
}

impl Members {
    /// The member at a place, which `slot` knows once it is one.
    fn at(&mut self, place: usize, slab: usize, slot: &mut u32) -> u32 {
        if *slot == FREE {
            *slot = self.places.len() as u32;
            self.places.push(place as u32);
            self.parents.push(*slot);
            self.slabs.push(slab as u32);
        }
        *slot
    }

    /// The root of a member's cluster.
    fn root(&mut self, mut member: u32) -> u32 {
        loop {
            let parent = self.parents[member as usize];
            if parent == member {
                return member;
            }
            let above = self.parents[parent as usize];
            self.parents[member as usize] = above;
            member = above;
        }
    }

    fn chain(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        let (root, other) = (a.min(b), a.max(b));
        self.parents[other as usize] = root;
        let highest = self.slabs[root as usize].max(self.slabs[other as usize]);
        self.slabs[root as usize] = highest;
    }
}

/// What a round ends with.
#[derive(Clone, Copy, Debug, PartialEq)]
enum End {
    /// Its last drift: contacts come after a look at the way gone.
    Drift,
    /// The contacts after it, which fail.
    Contacts,
    /// Contacts, and the half kick that ends a run.
    Kick,
}

/// A round.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Round {
    /// Whether a run begins with it: with half a kick by the forces that there are. Another begins
    /// with the contacts after the last drift.
    opening: bool,
    drifts: usize,
    end: End,
}

/// What is the same for all in a round.
#[derive(Clone, Copy)]
struct Common<'a> {
    setup: &'a Setup,
    images: &'a [Quad; IMAGES],
    dt: f64,
    frame: [f64; 3],
    damped: bool,
    round: Round,
}

/// A stretch of the gathered particles, and the places that they come from.
struct Stretch<'a> {
    places: &'a [u32],
    bodies: Bodies<'a>,
}

impl Stretch<'_> {
    fn split_at(self, at: usize) -> (Self, Self) {
        let (places, places2) = self.places.split_at(at);
        let (bodies, bodies2) = self.bodies.split_at(at);
        (Self { places, bodies }, Self { places: places2, bodies: bodies2 })
    }

    /// Gathers the particles, with the loads that they have if a run begins.
    fn gather(&mut self, from: Still, opening: bool) {
        let Self { places, bodies } = self;
        for (slot, &place) in places.iter().enumerate() {
            let place = place as usize;
            bodies.positions[slot] = from.positions[place];
            bodies.velocities[slot] = from.velocities[place];
            bodies.spins[slot] = from.spins[place];
            if let Some(drive) = from.drives.get(place) {
                bodies.drives[slot] = *drive;
            }
            if opening {
                bodies.forces[slot] = from.forces[place];
                bodies.torques[slot] = from.torques[place];
                bodies.touched[slot] = from.touched[place];
            }
        }
        let bare = if opening { places.len() } else { 0 };
        bodies.forces[bare..].fill(Quad::default());
        bodies.torques[bare..].fill(Quad::default());
        bodies.touched[bare..].fill(false);
    }

    /// Contacts, left to be seen if they are the `last` of a run that asks for that.
    fn contacts<const SEEN: bool>(&mut self, share: &mut Slab, common: Common, last: bool) {
        let bodies = self.bodies.lend();
        let (scene, loads) = Scene::new(bodies, common.images, common.setup, common.dt);
        match (SEEN && last, common.setup.contact.cohesion > 0.0) {
            (false, false) => among::<false, false>(share, scene, loads),
            (false, true) => among::<false, true>(share, scene, loads),
            (true, false) => among::<true, false>(share, scene, loads),
            (true, true) => among::<true, true>(share, scene, loads),
        }
    }
}

/// A round of some groups; `again` if it has been made for too many steps.
fn tour<const SEEN: bool>(
    common: Common,
    from: Still,
    again: bool,
    groups: &mut [Group],
    mut stretch: Stretch,
) {
    if groups.len() > 1 {
        let (lower, upper) = groups.split_at_mut(groups.len() / 2);
        let (first, second) = stretch.split_at(upper[0].share.begin - lower[0].share.begin);
        join(
            common.setup.parallel,
            || tour::<SEEN>(common, from, again, lower, first),
            || tour::<SEEN>(common, from, again, upper, second),
        );
        return;
    }
    let [Group { share, before, record }] = groups else { return };
    if again {
        share.contacts.clone_from(before);
    } else {
        before.clone_from(&share.contacts);
    }
    let Round { opening, drifts, end } = common.round;
    let (dt, frame) = (common.dt, common.frame);
    let half = 0.5 * dt;
    stretch.gather(from, opening);
    (record.deepest[0], record.lost[0]) = (0.0, 0.0);
    let last = |step: usize| step == drifts && end == End::Kick;
    if !opening {
        stretch.contacts::<SEEN>(share, common, last(0));
        record.note(0, share);
    }
    for step in 1..=drifts {
        let bodies = stretch.bodies.lend();
        record.squares[step - 1] = match (opening && step == 1, common.damped) {
            (true, false) => advance(bodies, [half], dt, frame, Damped::<false>),
            (true, true) => advance(bodies, [half], dt, frame, Damped::<true>),
            (false, false) => advance(bodies, [half; 2], dt, frame, Damped::<false>),
            (false, true) => advance(bodies, [half; 2], dt, frame, Damped::<true>),
        };
        (record.deepest[step], record.lost[step]) = (0.0, 0.0);
        if step < drifts || end != End::Drift {
            stretch.contacts::<SEEN>(share, common, last(step));
            record.note(step, share);
        }
    }
    if end == End::Kick {
        finish(stretch.bodies, half);
    }
}

/// Whether there are drives, and whether one has a rate: a kernel for each answer.
#[derive(Clone, Copy)]
struct How<const DRIVEN: bool, const DAMPED: bool>;

/// A number of each of the particles that fly together.
type Lanes = [f64; LANES];

/// Half a kick of what flies, along an axis.
#[inline(always)]
fn kick<const DAMPED: bool>(v: &mut Lanes, by: &Lanes, damped: &Lanes) {
    for lane in 0..LANES {
        v[lane] += by[lane];
        if DAMPED {
            v[lane] *= damped[lane];
        }
    }
}

simd! {
    /// Flies free particles through a round, by the arithmetic of [`advance`] and [`finish`], and brings
    /// the others back from where they were gathered. Returns the largest square of a speed of what flew
    /// in each drift, as [`advance`] does.
    fn fly[const DRIVEN: bool, const DAMPED: bool](
        bodies: Bodies<'_>,
        slots: &[u32],
        gathered: Still<'_>,
        round: Round,
        dt: f64,
        frame: [f64; 3],
        _how: How<DRIVEN, DAMPED>,
    ) -> [u64; LONGEST] {
        let Bodies { positions, velocities, spins, forces, torques, touched, drives } = bodies;
        let Round { opening, drifts, end } = round;
        let half = 0.5 * dt;
        // Loads are on particles only between runs.
        let loaded = opening || end != End::Drift;
        let mut most = [[0u64; LANES]; LONGEST];
        let most = &mut most[..drifts];
        let n = positions.len();
        let (velocities, slots) = (&mut velocities[..n], &slots[..n]);
        for begin in (0..n).step_by(LANES) {
            let count = LANES.min(n - begin);
            // Lanes beyond the last particle do as it does; those of what does not fly stand still.
            let mut free = [false; LANES];
            let (mut x, mut v, mut by) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3], [[0.0; LANES]; 3]);
            let mut damped = [1.0; LANES];
            for lane in 0..LANES {
                let i = begin + lane.min(count - 1);
                free[lane] = slots[i] == FREE;
                let (position, velocity) = (positions[i].0, velocities[i].0);
                for axis in 0..3 {
                    x[axis][lane] = position[axis];
                    v[axis][lane] = if free[lane] { velocity[axis] } else { frame[axis] };
                }
                if DRIVEN {
                    let drive = drives[i].0;
                    let driven = free[lane] && velocity[3] > 0.0;
                    for axis in 0..3 {
                        by[axis][lane] = if DAMPED {
                            // Adding the negative zero changes nothing.
                            let by = half * (velocity[3] * 0.0 + drive[axis]);
                            if driven { by } else { -0.0 }
                        } else {
                            let by = (if driven { half } else { 0.0 }) * drive[axis];
                            if free[lane] { by } else { 0.0 }
                        };
                    }
                    if DAMPED && driven {
                        damped[lane] = 1.0 / (1.0 + half * drive[3]);
                    }
                }
            }
            if free == [false; LANES] {
                // All come back from elsewhere.
            } else if DRIVEN {
                for (drift, most) in most.iter_mut().enumerate() {
                    if drift > 0 || !opening {
                        for axis in 0..3 {
                            kick::<DAMPED>(&mut v[axis], &by[axis], &damped);
                        }
                    }
                    for axis in 0..3 {
                        kick::<DAMPED>(&mut v[axis], &by[axis], &damped);
                        for lane in 0..LANES {
                            x[axis][lane] += dt * v[axis][lane];
                        }
                    }
                    faster(most, &v, frame);
                }
                if end == End::Kick {
                    for axis in 0..3 {
                        kick::<DAMPED>(&mut v[axis], &by[axis], &damped);
                    }
                }
            } else if let Some(most) = most.first_mut() {
                let way: [Lanes; 3] =
                    std::array::from_fn(|axis| std::array::from_fn(|lane| dt * v[axis][lane]));
                for _ in 0..drifts {
                    for axis in 0..3 {
                        for lane in 0..LANES {
                            x[axis][lane] += way[axis][lane];
                        }
                    }
                }
                faster(most, &v, frame);
            }
            for lane in 0..count {
                let i = begin + lane;
                if free[lane] {
                    let Quad([.., radius]) = positions[i];
                    positions[i] = Quad([x[0][lane], x[1][lane], x[2][lane], radius]);
                    if DRIVEN {
                        let Quad([.., lighter]) = velocities[i];
                        velocities[i] = Quad([v[0][lane], v[1][lane], v[2][lane], lighter]);
                    }
                } else {
                    let slot = slots[i] as usize;
                    positions[i] = gathered.positions[slot];
                    velocities[i] = gathered.velocities[slot];
                    spins[i] = gathered.spins[slot];
                    if loaded {
                        forces[i] = gathered.forces[slot];
                        torques[i] = gathered.torques[slot];
                        touched[i] = gathered.touched[slot];
                    }
                }
            }
        }
        let mut squares = [0; LONGEST];
        for (square, most) in squares.iter_mut().zip(most) {
            *square = most.iter().copied().fold(0, u64::max);
        }
        if !DRIVEN {
            // What nothing pulls keeps its speed.
            squares = [squares[0]; LONGEST];
        }
        squares
    }
}

/// Notes the squares of speeds against the frame that are larger than any before, as bits.
#[inline(always)]
fn faster(most: &mut [u64; LANES], v: &[Lanes; 3], frame: [f64; 3]) {
    for lane in 0..LANES {
        let [x, y, z] = [v[0][lane] - frame[0], v[1][lane] - frame[1], v[2][lane] - frame[2]];
        let square = (x * x + z * z) + y * y;
        most[lane] = most[lane].max(square.to_bits() & !SIGN);
    }
}

/// [`fly`] for all, in parts.
fn fly_all(common: Common, bodies: Bodies, slots: &[u32], gathered: Still) -> [u64; LONGEST] {
    if bodies.positions.len() > CHUNK {
        let (first, second) = bodies.halves(CHUNK);
        let (slots, slots2) = slots.split_at(first.positions.len());
        let (mut squares, others) = join(
            common.setup.parallel,
            || fly_all(common, first, slots, gathered),
            || fly_all(common, second, slots2, gathered),
        );
        for (square, other) in squares.iter_mut().zip(others) {
            *square = other.max(*square);
        }
        return squares;
    }
    let Common { round, dt, frame, .. } = common;
    match (bodies.drives.is_empty(), common.damped) {
        (true, _) => fly(bodies, slots, gathered, round, dt, frame, How::<false, false>),
        (false, false) => fly(bodies, slots, gathered, round, dt, frame, How::<true, false>),
        (false, true) => fly(bodies, slots, gathered, round, dt, frame, How::<true, true>),
    }
}

/// The slab that pairs are numbered as the `n`-th of, of `len`: even ones before odd ones.
fn nth(n: usize, len: usize) -> usize {
    let even = len.div_ceil(2);
    if n < even { 2 * n } else { 2 * (n - even) + 1 }
}

impl Dem {
    /// Near pairs and contacts by slab, or by group where rounds are made.
    pub(super) fn shares(&self) -> impl Iterator<Item = &Slab> {
        let Self { groups, slabs, .. } = self;
        (0..slabs.len()).map(|n| if groups.apart { &groups.all[n].share } else { &slabs[n] })
    }

    /// All contacts by the numbers of their pairs, ascending.
    pub(super) fn all_contacts(&self) -> Vec<Touch> {
        let mut contacts = Vec::new();
        for (slab, share) in self.slabs.iter().zip(self.shares()) {
            let first = if self.groups.apart { 0 } else { slab.number };
            let number = |touch: &Touch| Touch { pair: first + touch.pair, ..*touch };
            contacts.extend(share.contacts.iter().map(number));
        }
        contacts.sort_unstable_by_key(|touch| touch.pair);
        contacts
    }

    /// Numbers the pairs.
    pub(super) fn number_pairs(&mut self) {
        let len = self.slabs.len();
        let slabs = &mut self.slabs;
        let mut number = 0u32;
        for n in 0..len {
            let slab = &mut slabs[nth(n, len)];
            slab.number = number;
            number = number.checked_add(slab.pairs.len() as u32).expect("more than 2^32 pairs");
        }
    }

    /// Dissolves the groups: contacts go back to their slabs.
    pub(super) fn part(&mut self) {
        let Self { slabs, groups, .. } = self;
        if !groups.apart {
            return;
        }
        groups.apart = false;
        let len = slabs.len();
        for (n, Group { share, .. }) in groups.all.iter_mut().enumerate() {
            (slabs[n].springs, slabs[n].deepest) = (share.springs, share.deepest);
            for touch in share.contacts.drain(..) {
                // The last slab whose first pair's number is no higher.
                let (mut low, mut high) = (0, len);
                while high - low > 1 {
                    let middle = (low + high) / 2;
                    if slabs[nth(middle, len)].number <= touch.pair {
                        low = middle;
                    } else {
                        high = middle;
                    }
                }
                let slab = &mut slabs[nth(low, len)];
                slab.contacts.push(Touch { pair: touch.pair - slab.number, ..touch });
            }
        }
        for slab in slabs {
            slab.contacts.sort_unstable_by_key(|touch| touch.pair);
        }
    }

    /// Groups particles by the near pairs as they are listed, and gives the groups their contacts, if
    /// clusters are small.
    pub(super) fn group(&mut self) {
        let len = self.len();
        let Self { slabs, groups, .. } = self;
        let Groups { slots, places, owners, all, members, .. } = groups;
        for &place in places.iter() {
            slots[place as usize] = FREE;
        }
        slots.resize(len, FREE);
        places.clear();
        all.resize_with(slabs.len(), Group::default);
        members.places.clear();
        members.parents.clear();
        members.slabs.clear();
        let most = (CHAINED * len as f64) as usize;
        if slabs.iter().map(|slab| slab.near.len()).sum::<usize>() > most {
            return;
        }
        for (n, slab) in slabs.iter().enumerate() {
            let above = slabs.get(n + 1).map_or(len, |slab| slab.begin);
            for Near { pair, .. } in &slab.near {
                let (a, b) = (pair.first(), pair.second(len));
                let higher = match pair.slot as usize {
                    slot if slot >= len => 0,
                    slot if slot >= above => n + 1,
                    _ => n,
                };
                let a = members.at(a, n, &mut slots[a]);
                let b = members.at(b, higher, &mut slots[b]);
                members.chain(a, b);
            }
        }
        // Particles of each group, then the slots at which groups begin.
        let count = members.places.len();
        fit(places, count);
        fit(owners, count);
        all.iter_mut().for_each(|group| group.share.begin = 0);
        for member in 0..count as u32 {
            let root = members.root(member);
            all[members.slabs[root as usize] as usize].share.begin += 1;
        }
        let largest = all.iter().map(|group| group.share.begin).max().unwrap_or(0);
        groups.apart = count <= most && largest as f64 <= LARGEST * most as f64;
        if !groups.apart {
            places.copy_from_slice(&members.places);
            return;
        }
        let mut sum = 0;
        for Group { share, .. } in all.iter_mut() {
            (share.begin, sum) = (sum, sum + share.begin);
            share.near.clear();
            share.contacts.clear();
        }
        for member in 0..count as u32 {
            let root = members.root(member);
            let owner = members.slabs[root as usize];
            let place = members.places[member as usize];
            let slot = &mut all[owner as usize].share.begin;
            (places[*slot], owners[*slot]) = (place, owner);
            slots[place as usize] = *slot as u32;
            *slot += 1;
        }
        // Each beginning has moved to its group's end, which is where the next begins.
        let mut begin = 0;
        for Group { share, .. } in all.iter_mut() {
            (begin, share.begin) = (share.begin, begin);
        }
        for n in 0..slabs.len() {
            let slab = &mut slabs[nth(n, all.len())];
            for Near { pair, place } in &slab.near {
                let (a, b) = (slots[pair.first()] as usize, slots[pair.second(len)] as usize);
                let owner = owners[a] as usize;
                let begin = all[owner].share.begin;
                // Only the last group has pairs with images above the last slab.
                let above = if pair.slot as usize >= len { count - begin } else { 0 };
                let pair = pair.moved(a - begin, b - begin + above);
                all[owner].share.near.push(Near { pair, place: slab.number + place });
            }
            for touch in slab.contacts.drain(..) {
                // Those that have parted may have no near pair.
                let owner = match slots[slab.pairs[touch.pair as usize].first()] {
                    FREE => nth(n, all.len()),
                    slot => owners[slot as usize] as usize,
                };
                let pair = slab.number + touch.pair;
                all[owner].share.contacts.push(Touch { pair, ..touch });
            }
        }
        for (Group { share, .. }, slab) in all.iter_mut().zip(&*slabs) {
            (share.springs, share.deepest) = (slab.springs, slab.deepest);
        }
        let images = all.last().map_or(0, |group| count - group.share.begin);
        groups.gathered.fit(count, images);
    }

    /// As much of a `round` as is certain: all its contacts are between near pairs as listed, and no drift
    /// but perhaps the last is too long. `made`, if groups have made it: if not, they are taken to be no
    /// faster than what flies.
    fn certain(&self, round: Round, made: bool) -> Round {
        let gain = self.gain();
        let all = &self.groups.all[..if made { self.groups.all.len() } else { 0 }];
        let (mut speed, mut travelled) = (self.speed, self.travelled);
        for step in 0..=round.drifts {
            if step > 0 {
                speed += gain;
                let fastest = (all.iter().map(|group| group.record.squares[step - 1]))
                    .fold((speed * speed).to_bits(), u64::max);
                let way = f64::from_bits(fastest).sqrt() * self.dt * (1.0 + ROUND_OFF);
                travelled = travelled.map(|travelled| travelled + way);
                let fine = way <= self.fastest * self.smallest
                    && 2.0 * travelled[0] <= self.cells.skin
                    && 2.0 * travelled[1] <= self.cells.near;
                if !fine {
                    return Round { drifts: step, end: End::Drift, ..round };
                }
            }
            if all.iter().any(|group| group.record.deepest[step] > self.deepest) {
                return Round { drifts: step, end: End::Contacts, ..round };
            }
        }
        round
    }

    /// Makes a round of at most `left` steps; `opening` if a run begins. Returns how many it made, and
    /// whether the run has ended.
    pub(super) fn round<const SEEN: bool>(
        &mut self,
        opening: bool,
        left: u64,
    ) -> Result<(u64, bool), StepError> {
        let drifts = left.min(LONGEST as u64) as usize;
        let end = if drifts as u64 == left { End::Kick } else { End::Drift };
        let hoped = self.certain(Round { opening, drifts, end }, false);
        self.tour::<SEEN>(hoped, false);
        let round = self.certain(hoped, true);
        if round != hoped {
            self.tour::<SEEN>(round, true);
        }
        let squares = self.fly(round);
        let Round { drifts, end, .. } = round;
        for step in 0..=drifts {
            if step > 0 {
                let groups = self.groups.all.iter();
                let square = groups
                    .map(|group| group.record.squares[step - 1])
                    .fold(squares[step - 1], u64::max);
                self.drifted(f64::from_bits(square).sqrt())?;
            }
            let mut deepest = 0.0f64;
            for Group { record, .. } in &self.groups.all {
                self.lost += record.lost[step];
                deepest = deepest.max(record.deepest[step]);
            }
            self.bear(deepest)?;
        }
        if end == End::Drift {
            self.list_if_due();
        }
        Ok((drifts as u64, end == End::Kick))
    }

    /// What is the same for all in a round.
    fn common<'a>(&self, setup: &'a Setup, images: &'a [Quad; IMAGES], round: Round) -> Common<'a> {
        Common { setup, images, dt: self.dt, frame: self.frame, damped: self.damped, round }
    }

    /// Gathers the groups and makes their part of a round.
    fn tour<const SEEN: bool>(&mut self, round: Round, again: bool) {
        let (setup, images) = (self.setup, self.cells.images());
        let common = self.common(&setup, &images, round);
        let groups = &mut self.groups;
        let driven = !self.particles.drives.is_empty();
        fit(&mut groups.gathered.drives, if driven { groups.places.len() } else { 0 });
        let stretch = Stretch { places: &groups.places, bodies: groups.gathered.bodies() };
        let from = self.particles.still();
        tour::<SEEN>(common, from, again, &mut groups.all, stretch);
    }

    /// Makes what flies do its part of a round, and brings the groups back.
    fn fly(&mut self, round: Round) -> [u64; LONGEST] {
        let (setup, images) = (self.setup, self.cells.images());
        let common = self.common(&setup, &images, round);
        let groups = std::mem::take(&mut self.groups);
        let bodies = self.particles.bodies();
        let squares = fly_all(common, bodies, &groups.slots, groups.gathered.still());
        self.groups = groups;
        squares
    }
}
