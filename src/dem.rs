//! [`Dem`]: spheres that touch, followed one by one in a periodic box; no gas.
//!
//! ```text
//! m dv/dt = Σ F + m (a - λ v)      dx/dt = v
//! I dω/dt = Σ r × F                I = 2/5 m r²
//! ```
//!
//! F is the law of [`crate::laws::contact`]; the acceleration a and the rate λ of each particle
//! ([`Dem::drives_mut`]) come from outside: gravity, and a gas that pulls with λ (u - v).
//!
//! Velocity Verlet. The velocities between two calls of [`Dem::run`] are those of whole steps; contact
//! forces see those of half steps. A pair's forces are equal and opposite to the last bit, and their
//! arms add up to the distance of the centres, so that momentum and angular momentum are kept.
//!
//! Particles lie in memory as they lie in the box, cell by cell, and are sorted anew with every
//! rebuild of the pairs (`pairs.rs`). The box is cut into an even number of slabs along the last axis,
//! each at least as thick as pairs are long; a slab owns the pairs that reach within it and up into
//! the next. Threads do every other slab, then the rest, so that no two of them add to one particle,
//! and the order of all sums is that of the slabs, whatever the number of threads. Where particles are
//! few, and for some steps meet none but a few neighbours, they make those steps without a look at the
//! others (`rounds.rs`).
//!
//! Left out: rolling resistance, walls. A sphere of infinite density is held: it stays at its
//! velocity.

mod bodies;
mod forces;
mod motion;
mod pairs;
mod rounds;
mod start;
mod state;

pub(crate) use start::normals;
pub use start::{StartError, lattice, packed, thermal};
pub use state::StateError;
pub(crate) use state::{take, take_f64};

use crate::laws::contact::{Contact, TANGENTIAL_MOBILITY};
use bodies::Particles;
use pairs::{Cells, Slab};
use std::f64::consts::PI;

/// Four numbers that travel together: a vector, and a number that belongs to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(32))]
pub struct Quad(pub [f64; 4]);

impl Quad {
    /// The vector.
    #[inline(always)]
    pub fn vector(&self) -> [f64; 3] {
        let [x, y, z, _] = self.0;
        [x, y, z]
    }
}

/// One sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Centre, 0 <= x < size of the box \[m\].
    pub position: [f64; 3],
    /// Velocity \[m/s\].
    pub velocity: [f64; 3],
    /// Angular velocity ω \[1/s\].
    pub spin: [f64; 3],
    /// Diameter d \[m\].
    pub diameter: f64,
    /// Density ρ_s; infinite if the sphere is held \[kg/m³\].
    pub density: f64,
}

/// What holds for all spheres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Edges of the periodic box \[m\].
    pub size: [f64; 3],
    /// What two spheres do that touch.
    pub contact: Contact,
    /// Steps in the shortest contact, π sqrt(m*/k_n) of the two lightest spheres; 50 is usual, 20 the least \[-\].
    pub steps_per_contact: f64,
    /// How much farther than touching pairs are looked for at least, in diameters of the largest sphere:
    /// more makes more pairs and fewer rebuilds, and does not change what is computed beyond the order
    /// of sums. In a dilute box it is more \[-\].
    pub skin: f64,
    /// Whether the threads of the current pool share a step.
    pub parallel: bool,
}

/// Skin that serves solids fractions up to 0.6, in diameters of the largest sphere \[-\].
pub const SKIN: f64 = 0.2;

/// A set-up that cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// A number of the set-up is out of its range.
    #[error("{name} = {value}: must be {range}")]
    Number {
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// A number of a sphere is out of its range.
    #[error("sphere {sphere}: {name} = {value}: must be {range}")]
    Sphere {
        /// Place in the list.
        sphere: usize,
        /// Which.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        range: &'static str,
    },
    /// A sphere might touch its own image.
    #[error(
        "the box is {size:.3e} m along axis {axis}: less than 2.1 diameters of the largest sphere \
         ({diameter:.3e} m), so that a sphere might touch another on two sides; make the box larger"
    )]
    Box {
        /// The axis.
        axis: usize,
        /// The box along it \[m\].
        size: f64,
        /// Largest diameter \[m\].
        diameter: f64,
    },
    /// More spheres than can be numbered.
    #[error("{0} spheres: at most {MOST}")]
    Many(usize),
}

/// Most spheres that a box may hold: their number takes 27 bits.
pub const MOST: usize = (1 << 27) - 1;

/// Why a step could not be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StepError {
    /// A velocity is not a number.
    #[error("particle {particle}: its velocity is no longer a number at t = {time:.6e} s")]
    NotFinite {
        /// Its number.
        particle: u32,
        /// Time \[s\].
        time: f64,
    },
    /// A particle passes through others between two steps.
    #[error(
        "particle {particle} moves {share:.2} of the smallest diameter in one step ({speed:.3e} m/s at \
         t = {time:.6e} s): it would pass through others unseen; raise the stiffness"
    )]
    Fast {
        /// Its number.
        particle: u32,
        /// Its speed against the mean velocity \[m/s\].
        speed: f64,
        /// Way in a step over the smallest diameter \[-\].
        share: f64,
        /// Time \[s\].
        time: f64,
    },
    /// The spheres are too soft for what they meet.
    #[error(
        "two particles overlap by {share:.2} of their mean diameter at t = {time:.6e} s (at most {most} \
         is meant for a contact): the stiffness is too low for the speed or load; raise it"
    )]
    Overlap {
        /// Overlap over mean diameter \[-\].
        share: f64,
        /// What is allowed \[-\].
        most: f64,
        /// Time \[s\].
        time: f64,
    },
}

/// Way in a step over the smallest diameter beyond which a step is refused \[-\].
const FASTEST: f64 = 0.25;

/// Overlap over the mean diameter beyond which a step is refused \[-\].
const DEEPEST: f64 = 0.2;

/// Energies of the spheres \[J\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Energy {
    /// Σ m v²/2.
    pub translation: f64,
    /// Σ I ω²/2.
    pub rotation: f64,
    /// Σ k_n δ²/2 + k_t ξ²/2 - F_c δ of the contacts.
    pub springs: f64,
    /// What dashpots, sliders and parting springs have taken since the start.
    pub lost: f64,
}

impl Energy {
    /// What the spheres still have \[J\].
    pub fn kept(&self) -> f64 {
        self.translation + self.rotation + self.springs
    }
}

/// A contact in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// The middle between the centres \[m\], and half their distance \[m\].
    pub place: Quad,
    /// Way from the centre of the second sphere to that of the first \[m\].
    pub arm: [f64; 3],
    /// Force on the first \[N\]; on the second acts its opposite.
    pub force: [f64; 3],
}

impl Seen {
    /// The centres of both spheres \[m\], each with half the distance between them \[m\].
    pub fn centres(&self) -> [Quad; 2] {
        let Quad([x, y, z, half]) = self.place;
        [0.5, -0.5].map(|part| {
            let [dx, dy, dz] = self.arm.map(|arm| part * arm);
            Quad([x + dx, y + dy, z + dz, half])
        })
    }
}

/// Spheres in a periodic box.
#[derive(Clone, Debug)]
pub struct Dem {
    setup: Setup,
    dt: f64,
    time: f64,
    steps: u64,
    smallest: f64,
    /// Number of each particle, by place in memory.
    ids: Vec<u32>,
    particles: Particles,
    /// Whether a drive has a rate.
    damped: bool,
    cells: Cells,
    slabs: Vec<Slab>,
    /// Way that the fastest particle may have gone since the pairs, and since the near ones, were listed.
    travelled: [f64; 2],
    /// Velocity against which that way counts: a mean motion shared by all brings no two together.
    frame: [f64; 3],
    /// Rebuilds of the pairs so far.
    rebuilds: u64,
    /// Energy that contacts have taken \[J\].
    lost: f64,
    /// Deepest overlap over the mean diameter, and longest way over the smallest diameter, of a step.
    deepest: f64,
    fastest: f64,
    scratch: pairs::Scratch,
    /// Particles that are stepped without a look at the others.
    groups: rounds::Groups,
    /// No particle is faster against the frame, but for what contacts have done since the last drift.
    speed: f64,
    /// The largest acceleration and the largest rate among the drives of the run.
    pulls: [f64; 2],
}

impl Dem {
    /// The `spheres`, numbered in their order.
    ///
    /// # Errors
    /// Numbers out of range; a box in which a sphere might touch another on two sides.
    pub fn new(setup: Setup, spheres: &[Sphere]) -> Result<Self, SetupError> {
        check(&setup, spheres)?;
        let mass = |sphere: &Sphere| PI / 6.0 * sphere.density * sphere.diameter.powi(3);
        let quad = |[x, y, z]: [f64; 3], w| Quad([x, y, z, w]);
        let largest = spheres.iter().fold(0.0f64, |most, sphere| most.max(sphere.diameter));
        let smallest = spheres.iter().fold(f64::INFINITY, |least, s| least.min(s.diameter));
        let lightest = spheres.iter().map(mass).fold(f64::INFINITY, f64::min);
        let held = spheres.iter().any(|sphere| sphere.density.is_infinite());
        let effective = if held { lightest } else { 0.5 * lightest };
        let Contact { stiffness, tangential_stiffness, .. } = setup.contact;
        let stiffest = stiffness * (TANGENTIAL_MOBILITY * tangential_stiffness).max(1.0);
        let cells = Cells::new(setup.size, largest, setup.skin, spheres.len());
        let none = || vec![Quad::default(); spheres.len()];
        let particles = Particles {
            positions: spheres.iter().map(|s| quad(s.position, 0.5 * s.diameter)).collect(),
            velocities: spheres.iter().map(|s| quad(s.velocity, 1.0 / mass(s))).collect(),
            spins: spheres
                .iter()
                .map(|s| quad(s.spin, 10.0 / (mass(s) * s.diameter.powi(2))))
                .collect(),
            drives: Vec::new(),
            forces: none(),
            torques: none(),
            touched: vec![false; spheres.len()],
        };
        let mut dem = Self {
            dt: if effective.is_finite() {
                PI * (effective / stiffest).sqrt() / setup.steps_per_contact
            } else {
                1.0
            },
            time: 0.0,
            steps: 0,
            smallest,
            ids: (0..spheres.len() as u32).collect(),
            particles,
            damped: false,
            slabs: vec![Slab::default(); cells.number[2]],
            cells,
            travelled: [0.0; 2],
            frame: [0.0; 3],
            rebuilds: 0,
            lost: 0.0,
            deepest: DEEPEST,
            fastest: FASTEST,
            scratch: pairs::Scratch::default(),
            groups: rounds::Groups::default(),
            speed: 0.0,
            pulls: [0.0; 2],
            setup,
        };
        dem.rebuild();
        dem.part();
        dem.contacts::<false>();
        dem.group();
        dem.speed = dem.fastest();
        Ok(dem)
    }

    /// Makes `steps` steps.
    ///
    /// # Errors
    /// Spheres that overlap too deeply or move too far in a step, named with the remedy. The state is
    /// then that of the failed step, for a look at it; it cannot be gone on from.
    pub fn run(&mut self, steps: u64) -> Result<(), StepError> {
        self.advance::<false>(steps)
    }

    /// Makes `steps` steps and leaves the contacts of the last to be seen, until the next.
    ///
    /// # Errors
    /// As [`Dem::run`].
    pub fn run_seen(&mut self, steps: u64) -> Result<(), StepError> {
        self.advance::<true>(steps)
    }

    fn advance<const SEEN: bool>(&mut self, steps: u64) -> Result<(), StepError> {
        if steps == 0 {
            return Ok(());
        }
        self.look_at_drives();
        let (mut opening, mut left) = (true, steps);
        loop {
            if self.groups.apart {
                let (steps, ended) = self.round::<SEEN>(opening, left)?;
                left -= steps;
                if ended {
                    break;
                }
            } else {
                if !opening {
                    let deepest = if SEEN && left == 0 {
                        self.contacts::<true>()
                    } else {
                        self.contacts::<false>()
                    };
                    self.bear(deepest)?;
                }
                if left == 0 {
                    self.kick();
                    break;
                }
                let fastest = self.kick_and_drift(if opening { 1 } else { 2 });
                self.drifted(fastest)?;
                self.list_if_due();
                left -= 1;
            }
            opening = false;
        }
        // The half kick that ends a run.
        self.speed += 0.5 * self.gain();
        Ok(())
    }

    /// Takes note of a drift whose fastest particle had this speed.
    fn drifted(&mut self, fastest: f64) -> Result<(), StepError> {
        self.steps += 1;
        self.time += self.dt;
        self.speed = fastest;
        let way = fastest * self.dt;
        if way.is_nan() || way > self.fastest * self.smallest {
            return Err(self.too_fast());
        }
        self.travelled = self.travelled.map(|travelled| travelled + way);
        Ok(())
    }

    /// Lists pairs or near pairs anew if a particle may have gone too far since they were listed.
    fn list_if_due(&mut self) {
        if 2.0 * self.travelled[0] > self.cells.skin {
            self.rebuild();
        } else if 2.0 * self.travelled[1] > self.cells.near {
            self.list_near();
        }
    }

    /// Fails if an overlap over the mean diameter is too deep.
    fn bear(&self, deepest: f64) -> Result<(), StepError> {
        if deepest > self.deepest {
            let (most, time) = (self.deepest, self.time);
            return Err(StepError::Overlap { share: deepest, most, time });
        }
        Ok(())
    }

    /// Finds out what drives may do in this run.
    fn look_at_drives(&mut self) {
        // Numbers above 0 are ordered as their bits are, and what is not a number is above all.
        let mut most = [0u64; 4];
        let (mut damped, mut negative) = (false, false);
        for Quad(drive) in &self.particles.drives {
            for n in 0..4 {
                most[n] = most[n].max(drive[n].to_bits() & (u64::MAX >> 1));
            }
            damped |= drive[3] != 0.0;
            negative |= drive[3] < 0.0;
        }
        let [x, y, z, rate] = most.map(f64::from_bits);
        // A rate below 0 drives on, and nothing is known of how far.
        let rate = if negative { f64::INFINITY } else { rate };
        self.damped = damped;
        self.pulls = [(x * x + y * y + z * z).sqrt(), rate];
    }

    /// By how much drives may make a particle faster in a step, against the frame \[m/s\].
    fn gain(&self) -> f64 {
        let [pull, rate] = self.pulls;
        let frame = self.frame.iter().map(|v| v * v).sum::<f64>().sqrt();
        self.dt * (pull + rate * frame)
    }

    /// The largest speed against the frame, not a number if one is not \[m/s\].
    fn fastest(&self) -> f64 {
        let square = |Quad([x, y, z, _]): &Quad| -> u64 {
            let [u, v, w] = self.frame;
            let square = (x - u).powi(2) + (y - v).powi(2) + (z - w).powi(2);
            square.to_bits() & (u64::MAX >> 1)
        };
        f64::from_bits(self.particles.velocities.iter().map(square).fold(0, u64::max)).sqrt()
    }

    /// Number of spheres.
    pub fn len(&self) -> usize {
        self.ids.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.ids.is_empty()
    }

    /// What holds for all spheres.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// Simulated time \[s\].
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Length of a step \[s\].
    pub fn time_step(&self) -> f64 {
        self.dt
    }

    /// Steps made.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// How often the pairs were listed.
    pub fn rebuilds(&self) -> u64 {
        self.rebuilds
    }

    /// Number of each particle, by its place in memory. Places change in [`Dem::run`], numbers never.
    pub fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Centre \[m\] and radius \[m\] of each particle, by place in memory. A centre may lie outside the box,
    /// by less than half the skin.
    pub fn positions(&self) -> &[Quad] {
        &self.particles.positions
    }

    /// Velocity \[m/s\] and one over mass \[1/kg\] of each particle, by place in memory.
    pub fn velocities(&self) -> &[Quad] {
        &self.particles.velocities
    }

    /// Angular velocity \[1/s\] and one over moment of inertia \[1/(kg m²)\] of each particle, by place in memory.
    pub fn spins(&self) -> &[Quad] {
        &self.particles.spins
    }

    /// Contact force on each particle \[N\], by place in memory; the fourth number is 0.
    pub fn forces(&self) -> &[Quad] {
        &self.particles.forces[..self.len()]
    }

    /// What pulls at each particle from outside, by place in memory: the acceleration a \[m/s²\] and the
    /// rate λ \[1/s\] in dv/dt = a - λ v. λ acts implicitly. They stay with the particles until they are
    /// given anew; a box without them does not pay for them.
    pub fn drives_mut(&mut self) -> &mut [Quad] {
        self.particles.drives.resize(self.ids.len(), Quad::default());
        &mut self.particles.drives
    }

    /// [`Dem::drives_mut`], to be looked at; empty if there never were any.
    pub fn drives(&self) -> &[Quad] {
        &self.particles.drives
    }

    /// The contacts of the last step, if [`Dem::run_seen`] made it.
    pub fn seen(&self) -> impl Iterator<Item = &Seen> {
        self.shares().flat_map(|share| &share.seen)
    }

    /// Deepest overlap of two spheres over their mean diameter \[-\].
    pub fn deepest_overlap(&self) -> f64 {
        self.shares().fold(0.0, |most, share| most.max(share.deepest))
    }

    /// Pairs of spheres that touch.
    pub fn touching(&self) -> usize {
        self.shares().map(|share| share.contacts.len()).sum()
    }

    /// The spheres in the order of their numbers, centres in the box.
    pub fn spheres(&self) -> Vec<Sphere> {
        let blank = Sphere {
            position: [0.0; 3],
            velocity: [0.0; 3],
            spin: [0.0; 3],
            diameter: 0.0,
            density: 0.0,
        };
        let mut spheres = vec![blank; self.len()];
        for (place, &id) in self.ids.iter().enumerate() {
            let Quad([.., radius]) = self.particles.positions[place];
            let Quad([.., inverse]) = self.particles.velocities[place];
            spheres[id as usize] = Sphere {
                position: pairs::wrapped(self.particles.positions[place].vector(), self.setup.size),
                velocity: self.particles.velocities[place].vector(),
                spin: self.particles.spins[place].vector(),
                diameter: 2.0 * radius,
                density: 0.75 / (PI * radius.powi(3) * inverse),
            };
        }
        spheres
    }

    /// Momentum of all spheres that are not held \[kg m/s\].
    pub fn momentum(&self) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for Quad([vx, vy, vz, inverse]) in &self.particles.velocities {
            if *inverse > 0.0 {
                sum = [sum[0] + vx / inverse, sum[1] + vy / inverse, sum[2] + vz / inverse];
            }
        }
        sum
    }

    /// Granular temperature T = ⟨m (v - u)²⟩/(3 ⟨m⟩), u the mean velocity by mass \[m²/s²\].
    pub fn temperature(&self) -> f64 {
        let moving = || self.particles.velocities.iter().filter(|velocity| velocity.0[3] > 0.0);
        let mass: f64 = moving().map(|velocity| 1.0 / velocity.0[3]).sum();
        let mean = self.momentum().map(|momentum| momentum / mass);
        let sum: f64 = moving()
            .map(|Quad([x, y, z, inverse])| {
                ((x - mean[0]).powi(2) + (y - mean[1]).powi(2) + (z - mean[2]).powi(2)) / inverse
            })
            .sum();
        sum / (3.0 * mass)
    }

    /// Energies of the spheres that are not held \[J\].
    pub fn energy(&self) -> Energy {
        let square = |quad: &Quad| quad.vector().iter().map(|v| v * v).sum::<f64>();
        let sum = |quads: &[Quad]| -> f64 {
            let moving = quads.iter().filter(|quad| quad.0[3] > 0.0);
            moving.map(|quad| 0.5 * square(quad) / quad.0[3]).sum()
        };
        Energy {
            translation: sum(&self.particles.velocities),
            rotation: sum(&self.particles.spins),
            springs: self.shares().map(|share| share.springs).sum(),
            lost: self.lost,
        }
    }

    /// Memory that the spheres take \[bytes\].
    pub fn memory(&self) -> usize {
        let slabs: usize = self.slabs.iter().map(Slab::memory).sum();
        self.particles.memory()
            + self.ids.capacity() * size_of::<u32>()
            + slabs
            + self.scratch.memory()
            + self.groups.memory()
    }

    /// Which particle is fastest, or not a number.
    #[cold]
    fn too_fast(&self) -> StepError {
        let speed = |velocity: &Quad| -> f64 {
            let parts = (0..3).map(|axis| (velocity.0[axis] - self.frame[axis]).powi(2));
            parts.sum::<f64>().sqrt()
        };
        let time = self.time;
        let (mut fastest, mut place) = (0.0, 0);
        for (at, velocity) in self.particles.velocities.iter().enumerate() {
            let speed = speed(velocity);
            if !speed.is_finite() {
                return StepError::NotFinite { particle: self.ids[at], time };
            }
            if speed > fastest {
                (fastest, place) = (speed, at);
            }
        }
        let share = fastest * self.dt / self.smallest;
        StepError::Fast { particle: self.ids[place], speed: fastest, share, time }
    }
}

/// Whether a set-up can be simulated.
fn check(setup: &Setup, spheres: &[Sphere]) -> Result<(), SetupError> {
    let Contact {
        stiffness,
        restitution,
        tangential_stiffness,
        tangential_damping,
        friction,
        cohesion,
    } = setup.contact;
    let positive = |x: f64| x > 0.0 && x.is_finite();
    let rules = [
        ("size of the box along axis 0", setup.size[0], positive(setup.size[0]), "positive"),
        ("size of the box along axis 1", setup.size[1], positive(setup.size[1]), "positive"),
        ("size of the box along axis 2", setup.size[2], positive(setup.size[2]), "positive"),
        ("stiffness", stiffness, positive(stiffness), "positive"),
        ("restitution", restitution, (0.01..=1.0).contains(&restitution), "from 0.01 to 1"),
        (
            "tangential stiffness",
            tangential_stiffness,
            (0.0..=10.0).contains(&tangential_stiffness),
            "from 0 to 10 times the normal one",
        ),
        (
            "tangential damping",
            tangential_damping,
            (0.0..=10.0).contains(&tangential_damping),
            "from 0 to 10 times the normal one",
        ),
        ("friction", friction, friction >= 0.0 && friction.is_finite(), "0 or more"),
        ("cohesion", cohesion, cohesion >= 0.0 && cohesion.is_finite(), "0 or more"),
        (
            "steps per contact",
            setup.steps_per_contact,
            (20.0..=1e6).contains(&setup.steps_per_contact),
            "from 20 to 1e6",
        ),
        ("skin", setup.skin, setup.skin > 0.0 && setup.skin <= 2.0, "above 0, at most 2 diameters"),
    ];
    for (name, value, fine, range) in rules {
        if !fine {
            return Err(SetupError::Number { name, value, range });
        }
    }
    if spheres.len() > MOST {
        return Err(SetupError::Many(spheres.len()));
    }
    let mut largest = 0.0f64;
    for (sphere, it) in spheres.iter().enumerate() {
        let bad = |name, value, range| Err(SetupError::Sphere { sphere, name, value, range });
        if !positive(it.diameter) {
            return bad("diameter", it.diameter, "positive");
        }
        if it.density.is_nan() || it.density <= 0.0 {
            return bad("density", it.density, "positive, infinite if held");
        }
        for axis in 0..3 {
            if !(it.position[axis] >= 0.0 && it.position[axis] <= setup.size[axis]) {
                return bad("position", it.position[axis], "in the box");
            }
            if !it.velocity[axis].is_finite() {
                return bad("velocity", it.velocity[axis], "a number");
            }
            if !it.spin[axis].is_finite() {
                return bad("spin", it.spin[axis], "a number");
            }
        }
        largest = largest.max(it.diameter);
    }
    for (axis, &size) in setup.size.iter().enumerate() {
        if size < 2.1 * largest {
            return Err(SetupError::Box { axis, size, diameter: largest });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
