//! Who may touch whom: particles sorted into cells, pairs within a skin of touching, and of those the
//! near ones, which a step looks at.
//!
//! Pairs are listed when the fastest particle may have gone half the skin since they last were; near
//! pairs, out of the pairs, when it may have gone half of theirs. A pair found far apart is not looked at
//! until the fastest could have closed the gap. A contact is known by its pair, and is carried over when
//! the pairs are listed anew.

use super::bodies::Particles;
use super::{Dem, Quad, Seen};
use crate::rows::each_chunk;
use std::f64::consts::PI;
use std::ops::Range;

/// Gap up to which near pairs are in a box of [`ROOMY`] or denser, in diameters of the largest sphere \[-\].
const NEAR: f64 = 0.012;

/// Solids fraction below which near pairs reach farther: they are few, and listed less often \[-\].
const ROOMY: f64 = 0.2;

/// Share of what cells are larger than a sphere, because spheres are few, that the skin takes at least \[-\].
const TAKEN: f64 = 0.7;

/// What [`Slab::due`] is less than it might be, for round-off \[-\].
const ROUND_OFF: f64 = 1e-6;

/// Bits of a particle's place in [`Pair::first`]; above them lies the image.
const PLACE: u32 = 27;

/// Ways for the second of a pair to be an image: -1, 0, 1 boxes along the first two axes, 0 or 1 along
/// the last.
pub(super) const IMAGES: usize = 18;

/// No image: the particle itself.
const HOME: usize = 4;

/// Two particles that are, or soon may be, in touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pair {
    /// Place of the first, and above bit [`PLACE`] the image of the second.
    first: u32,
    /// Slot of the second's force: its place, or, if it is an image above the last slab, that plus the
    /// number of particles.
    pub(super) slot: u32,
}

impl Pair {
    /// Place of the first particle.
    #[inline(always)]
    pub(super) fn first(self) -> usize {
        (self.first & ((1 << PLACE) - 1)) as usize
    }

    /// Which image the second is.
    #[inline(always)]
    pub(super) fn image(self) -> usize {
        (self.first >> PLACE) as usize
    }

    /// Place of the second particle, of `len`.
    #[inline(always)]
    pub(super) fn second(self, len: usize) -> usize {
        let slot = self.slot as usize;
        if slot >= len { slot - len } else { slot }
    }

    /// The same way from one to the other between other places: those that the two are gathered to.
    #[inline(always)]
    pub(super) fn moved(self, first: usize, slot: usize) -> Self {
        Self { first: self.first >> PLACE << PLACE | first as u32, slot: slot as u32 }
    }

    /// As one number, for a file.
    pub(super) fn bits(self) -> u64 {
        u64::from(self.first) << 32 | u64::from(self.slot)
    }

    /// The pair of such a number.
    pub(super) fn of(bits: u64) -> Self {
        Self { first: (bits >> 32) as u32, slot: bits as u32 }
    }
}

/// A pair, and its place in its slab's list, or in a group its number.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Near {
    pub(super) pair: Pair,
    pub(super) place: u32,
}

/// A pair in touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Touch {
    /// Tangential spring ξ of the first against the second \[m\].
    pub(super) spring: [f64; 3],
    /// Place of the pair in its slab's list, or in a group its number.
    pub(super) pair: u32,
    /// Whether it had its last kick.
    pub(super) ended: bool,
}

/// A contact on its way to new pairs: places of its particles, the lower above the higher, and the
/// spring of the lower against the higher.
#[derive(Clone, Copy, Debug)]
struct Carried {
    key: u64,
    spring: [f64; 3],
    ended: bool,
}

/// A layer of cells, and the pairs within it and up into the next. Also what a group of particles that are
/// stepped apart has of them (`rounds.rs`): its near pairs and their contacts.
#[derive(Clone, Debug, Default)]
pub(super) struct Slab {
    /// Place of its first particle.
    pub(super) begin: usize,
    pub(super) pairs: Vec<Pair>,
    /// For each pair the way that the fastest particle has gone since pairs were listed when it may be near.
    pub(super) due: Vec<f32>,
    /// Number of its first pair: pairs are numbered in the order in which a step adds up their forces,
    /// those of even slabs before those of odd ones.
    pub(super) number: u32,
    /// Pairs that may touch before near pairs are listed next, ascending.
    pub(super) near: Vec<Near>,
    /// Pairs in touch, ascending.
    pub(super) contacts: Vec<Touch>,
    /// Contacts of the step before.
    pub(super) before: Vec<Touch>,
    /// Pairs found in touch in this step.
    pub(super) found: Vec<Near>,
    /// Energy of its contacts' springs \[J\].
    pub(super) springs: f64,
    /// Energy lost in its contacts in the last step \[J\].
    pub(super) lost: f64,
    /// Its deepest overlap over the mean diameter \[-\].
    pub(super) deepest: f64,
    /// Its contacts, after a step that leaves them to be seen.
    pub(super) seen: Vec<Seen>,
}

impl Slab {
    /// Bytes.
    pub(super) fn memory(&self) -> usize {
        self.pairs.capacity() * size_of::<Pair>()
            + self.due.capacity() * size_of::<f32>()
            + (self.near.capacity() + self.found.capacity()) * size_of::<Near>()
            + (self.contacts.capacity() + self.before.capacity()) * size_of::<Touch>()
            + self.seen.capacity() * size_of::<Seen>()
    }
}

/// The box cut into cells.
#[derive(Clone, Debug)]
pub(super) struct Cells {
    size: [f64; 3],
    pub(super) number: [usize; 3],
    /// Gap up to which pairs are listed \[m\].
    pub(super) skin: f64,
    /// Gap up to which near pairs are \[m\].
    pub(super) near: f64,
    /// Place of the first particle of each cell, the first axis fastest, and the number of particles.
    starts: Vec<u32>,
}

/// What listing pairs needs besides, kept between one time and the next.
#[derive(Clone, Debug, Default)]
pub(super) struct Scratch {
    cell: Vec<u32>,
    order: Vec<u32>,
    carried: Vec<Carried>,
}

impl Scratch {
    /// Bytes.
    pub(super) fn memory(&self) -> usize {
        (self.cell.capacity() + self.order.capacity()) * size_of::<u32>()
            + self.carried.capacity() * size_of::<Carried>()
    }
}

/// A point brought into the box.
pub(super) fn wrapped(point: [f64; 3], size: [f64; 3]) -> [f64; 3] {
    let mut wrapped = point;
    for axis in 0..3 {
        // As most are; the rounding down of others is a call in portable code.
        if (0.0..size[axis]).contains(&point[axis]) {
            continue;
        }
        let inside = point[axis] - size[axis] * (point[axis] / size[axis]).floor();
        // A tiny negative number rounds to the upper end.
        wrapped[axis] = if inside < size[axis] { inside } else { 0.0 };
    }
    wrapped
}

impl Cells {
    /// Cells for `count` spheres no larger than `largest`; `skin` is in largest diameters, and a least one.
    pub(super) fn new(size: [f64; 3], largest: f64, skin: f64, count: usize) -> Self {
        let narrow = size.into_iter().fold(f64::INFINITY, f64::min);
        // Where spheres are few, larger cells: an empty one costs as much as one with a sphere.
        let volume: f64 = size.iter().product();
        let roomy = (0.5 * volume / count.max(1) as f64).cbrt();
        let skin = (skin * largest).max(TAKEN * (roomy - largest));
        let skin = skin.min(0.5 * narrow - largest).max(0.0);
        let edge = (largest + skin).max(roomy);
        let fraction = count as f64 * PI / 6.0 * largest.powi(3) / volume;
        let near = (NEAR * largest * (ROOMY / fraction).sqrt().max(1.0)).min(skin);
        let mut number = size.map(|size| ((size / edge) as usize).max(1));
        // Every other slab is done at a time.
        if number[2] > 1 {
            number[2] -= number[2] % 2;
        }
        let starts = vec![0; number.iter().product::<usize>() + 1];
        Self { size, number, skin, near, starts }
    }

    /// What is added to the second's centre for each image.
    pub(super) fn images(&self) -> [Quad; IMAGES] {
        std::array::from_fn(|image| {
            let [x, y, z] = [image % 3, image / 3 % 3, image / 9 + 1];
            let shift = |n: usize, axis: usize| (n as f64 - 1.0) * self.size[axis];
            Quad([shift(x, 0), shift(y, 1), shift(z, 2), 0.0])
        })
    }

    /// Number of the cell of a point in the box.
    #[inline(always)]
    fn of(&self, point: &Quad) -> u32 {
        let mut cell = [0; 3];
        for axis in 0..3 {
            let scaled = point.0[axis] * (self.number[axis] as f64 / self.size[axis]);
            cell[axis] = (scaled as usize).min(self.number[axis] - 1);
        }
        let [nx, ny, _] = self.number;
        ((cell[2] * ny + cell[1]) * nx + cell[0]) as u32
    }

    /// Particles of the cells `from` to `to` of a row of cells.
    #[inline(always)]
    fn row(&self, row: usize, from: usize, to: usize) -> Range<usize> {
        let begin = row * self.number[0];
        self.starts[begin + from] as usize..self.starts[begin + to] as usize
    }
}

/// What the search for a slab's pairs looks at.
struct Search<'a> {
    cells: &'a Cells,
    images: [Quad; IMAGES],
    positions: &'a [Quad],
    velocities: &'a [Quad],
}

impl Search<'_> {
    /// Lists the pairs of the slab at height `cz`.
    fn pairs(&self, cz: usize, pairs: &mut Vec<Pair>) {
        let cells = self.cells;
        let [nx, ny, nz] = cells.number;
        pairs.clear();
        for cy in 0..ny {
            let own = cz * ny + cy;
            let rows = [(1, 0), (-1, 1), (0, 1), (1, 1)].map(|(dy, dz)| {
                let (y, by) = turn(cy as isize + dy, ny);
                let (z, bz) = turn(cz as isize + dz, nz);
                (z * ny + y, 1 + 3 * (by + 1) as usize + 9 * bz as usize)
            });
            for cx in 0..nx {
                let (below, above) = (cx.saturating_sub(1), (cx + 2).min(nx));
                for i in cells.row(own, cx, cx + 1) {
                    self.among(i, i + 1..cells.row(own, cx, above).end, HOME, pairs);
                    if cx + 1 == nx {
                        self.among(i, cells.row(own, 0, 1), HOME + 1, pairs);
                    }
                    for (row, image) in rows {
                        self.among(i, cells.row(row, below, above), image, pairs);
                        if cx == 0 {
                            self.among(i, cells.row(row, nx - 1, nx), image - 1, pairs);
                        }
                        if cx + 1 == nx {
                            self.among(i, cells.row(row, 0, 1), image + 1, pairs);
                        }
                    }
                }
            }
        }
    }

    /// Pairs of particle `i` with an image of those in `range`.
    #[inline(always)]
    fn among(&self, i: usize, range: Range<usize>, image: usize, pairs: &mut Vec<Pair>) {
        let Quad([sx, sy, sz, _]) = self.images[image];
        let Quad([x, y, z, radius]) = self.positions[i];
        let (x, y, z, radius) = (x - sx, y - sy, z - sz, radius + self.cells.skin);
        let first = i as u32 | (image as u32) << PLACE;
        let above = if image < IMAGES / 2 { 0 } else { self.positions.len() };
        let begin = range.start;
        for (n, Quad([ox, oy, oz, other])) in self.positions[range].iter().enumerate() {
            let (dx, dy, dz, reach) = (x - ox, y - oy, z - oz, radius + other);
            if dx * dx + dy * dy + dz * dz < reach * reach {
                let second = begin + n;
                // Two that are held do not meet.
                if self.velocities[i].0[3] + self.velocities[second].0[3] > 0.0 {
                    pairs.push(Pair { first, slot: (second + above) as u32 });
                }
            }
        }
    }
}

/// A place along an axis of `n` cells brought into the box, and the boxes that it was away.
fn turn(cell: isize, n: usize) -> (usize, isize) {
    let n = n as isize;
    (cell.rem_euclid(n) as usize, cell.div_euclid(n))
}

/// The items in a new order: first that at `order[0]`. Leaves anything in `scratch`, which has as many at least.
fn permute<T: Copy + Send + Sync>(
    parallel: bool,
    order: &[u32],
    items: &mut [T],
    scratch: &mut [T],
) {
    let scratch = &mut scratch[..items.len()];
    let from = &*items;
    each_chunk(
        parallel,
        scratch,
        CHUNK,
        || (),
        |(), chunk, items| {
            items.copy_from_slice(&from[chunk * CHUNK..][..items.len()]);
        },
    );
    let from = &*scratch;
    each_chunk(
        parallel,
        items,
        CHUNK,
        || (),
        |(), chunk, items| {
            for (item, &place) in items.iter_mut().zip(&order[chunk * CHUNK..]) {
                *item = from[place as usize];
            }
        },
    );
}

/// Particles that a thread sorts at a time.
const CHUNK: usize = 4096;

impl Dem {
    /// Sorts the particles, lists the pairs and the near pairs, and carries the contacts over. Forces
    /// are zero before and after.
    pub(super) fn rebuild(&mut self) {
        let parallel = self.setup.parallel;
        self.part();
        self.sort();
        let Self { cells, particles, slabs, .. } = self;
        let Particles { positions, velocities, forces, torques, touched, .. } = particles;
        let layer = cells.number[0] * cells.number[1];
        let search = Search { images: cells.images(), cells, positions, velocities };
        each_chunk(
            parallel,
            slabs,
            1,
            || (),
            |(), cz, slab| {
                let slab = &mut slab[0];
                slab.begin = search.cells.starts[cz * layer] as usize;
                search.pairs(cz, &mut slab.pairs);
                slab.due.clear();
                slab.contacts.clear();
            },
        );
        // The first slab's images above the last.
        let images = cells.starts[layer] as usize;
        for quads in [forces, torques] {
            quads.resize(positions.len() + images, Quad::default());
            each_chunk(parallel, quads, CHUNK, || (), |(), _, quads| quads.fill(Quad::default()));
        }
        touched.resize(positions.len() + images, false);
        self.number_pairs();
        self.travelled[0] = 0.0;
        self.rebuilds += 1;
        self.find_near();
        self.put_contacts();
        self.group();
        let mean = self.mean_velocity();
        // What is known of speeds is known against the frame as it was.
        let square: f64 = (0..3).map(|axis| (mean[axis] - self.frame[axis]).powi(2)).sum();
        self.speed += square.sqrt();
        self.frame = mean;
    }

    /// Lists the near pairs.
    pub(super) fn list_near(&mut self) {
        self.part();
        self.find_near();
        self.group();
    }

    fn find_near(&mut self) {
        let Self { cells, particles, slabs, .. } = self;
        let (images, positions, near) = (cells.images(), &particles.positions[..], cells.near);
        let gone = self.travelled[0];
        each_chunk(
            self.setup.parallel,
            slabs,
            1,
            || (),
            |(), _, slab| {
                let Slab { pairs, due, near: list, .. } = &mut slab[0];
                list.clear();
                due.resize(pairs.len(), 0.0);
                for (n, (pair, due)) in pairs.iter().zip(due).enumerate() {
                    if gone < f64::from(*due) {
                        continue;
                    }
                    let (d, touching) = between(*pair, positions, &images);
                    let reach = touching + near;
                    let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                    if square < reach * reach {
                        list.push(Near { pair: *pair, place: n as u32 });
                    } else {
                        // Neither comes closer than by the way of the fastest.
                        let left = 0.5 * (square.sqrt() - reach).max(0.0);
                        *due = ((gone + left) * (1.0 - ROUND_OFF)) as f32;
                    }
                }
            },
        );
        self.travelled[1] = 0.0;
    }

    /// Brings the particles into the box and into the order of the cells; takes the contacts away with
    /// their particles' new places.
    fn sort(&mut self) {
        let parallel = self.setup.parallel;
        let len = self.len();
        let Self { cells, scratch, particles, ids, .. } = self;
        let Particles { positions, velocities, spins, drives, forces, .. } = particles;
        let size = self.setup.size;
        each_chunk(
            parallel,
            positions,
            CHUNK,
            || (),
            |(), _, positions| {
                for position in positions {
                    let [x, y, z] = wrapped(position.vector(), size);
                    *position = Quad([x, y, z, position.0[3]]);
                }
            },
        );
        scratch.cell.resize(len, 0);
        let (at, of) = (&positions[..], &*cells);
        each_chunk(
            parallel,
            &mut scratch.cell,
            CHUNK,
            || (),
            |(), chunk, numbers| {
                for (number, position) in numbers.iter_mut().zip(&at[chunk * CHUNK..]) {
                    *number = of.of(position);
                }
            },
        );
        // A counting sort, which keeps the order of particles within a cell.
        cells.starts.fill(0);
        for &cell in &scratch.cell {
            cells.starts[cell as usize + 1] += 1;
        }
        let mut sum = 0;
        for start in &mut cells.starts {
            sum += *start;
            *start = sum;
        }
        scratch.order.resize(len, 0);
        for (place, &cell) in scratch.cell.iter().enumerate() {
            let next = &mut cells.starts[cell as usize];
            scratch.order[*next as usize] = place as u32;
            *next += 1;
        }
        // Each start has moved to its cell's end, which is the next cell's start.
        cells.starts.rotate_right(1);
        cells.starts[0] = 0;
        let order = &scratch.order[..];
        // The forces, which are zero, make room for what is moved.
        for quads in [positions, velocities, spins, drives] {
            permute(parallel, order, quads, forces);
        }
        // The cells are no longer needed, and make room for the new place of each old one.
        let new = &mut scratch.cell;
        for (place, &old) in order.iter().enumerate() {
            new[old as usize] = place as u32;
        }
        scratch.carried.clear();
        for slab in &self.slabs {
            for touch in &slab.contacts {
                let pair = slab.pairs[touch.pair as usize];
                let (a, b) = (new[pair.first()], new[pair.second(len)]);
                scratch.carried.push(Carried::new(a, b, *touch));
            }
        }
        scratch.carried.sort_unstable_by_key(|carried| carried.key);
        permute(parallel, order, ids, new);
    }

    /// Gives the contacts that [`Dem::sort`] took away to their new pairs.
    fn put_contacts(&mut self) {
        let len = self.len();
        let carried = &self.scratch.carried[..];
        if carried.is_empty() {
            return;
        }
        each_chunk(
            self.setup.parallel,
            &mut self.slabs,
            1,
            || (),
            |(), _, slab| {
                let Slab { near, contacts, .. } = &mut slab[0];
                for &Near { pair, place } in near.iter() {
                    let (a, b) = (pair.first() as u32, pair.second(len) as u32);
                    let wanted = key(a, b);
                    if let Ok(at) = carried.binary_search_by_key(&wanted, |carried| carried.key) {
                        contacts.push(carried[at].seen_from(a, b, place));
                    }
                }
            },
        );
    }

    /// Mean of the velocities.
    fn mean_velocity(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for Quad([x, y, z, _]) in &self.particles.velocities {
            sum = [sum[0] + x, sum[1] + y, sum[2] + z];
        }
        sum.map(|sum| sum / self.len().max(1) as f64)
    }
}

/// The lower of two places above the higher.
fn key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

impl Carried {
    /// The contact of `a` with `b`.
    fn new(a: u32, b: u32, Touch { spring, ended, .. }: Touch) -> Self {
        Self { key: key(a, b), spring: if a < b { spring } else { spring.map(|s| -s) }, ended }
    }

    /// The contact of `a` with `b`, which are a `pair`.
    fn seen_from(&self, a: u32, b: u32, pair: u32) -> Touch {
        let spring = if a < b { self.spring } else { self.spring.map(|s| -s) };
        Touch { spring, pair, ended: self.ended }
    }
}

/// The way from the second of a pair to the first, and the distance at which they touch \[m\].
#[inline(always)]
pub(super) fn between(pair: Pair, positions: &[Quad], images: &[Quad; IMAGES]) -> ([f64; 3], f64) {
    let Quad([ax, ay, az, a]) = positions[pair.first()];
    let Quad([bx, by, bz, b]) = positions[pair.second(positions.len())];
    let Quad([sx, sy, sz, _]) = images[pair.image()];
    ([ax - sx - bx, ay - sy - by, az - sz - bz], a + b)
}
