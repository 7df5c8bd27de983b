//! Forces of the contacts.

use super::bodies::Bodies;
use super::pairs::{IMAGES, Near, Slab, Touch, between};
use super::{Dem, Quad, Seen, Setup};
use crate::laws::contact::{Contact, TANGENTIAL_MOBILITY, damping, pull};
use crate::rows::{join, simd};

/// Whether contacts are left to be seen, and whether spheres cohere: a kernel for each answer.
#[derive(Clone, Copy)]
struct Kernel<const SEEN: bool, const COHESIVE: bool>;

/// What contacts look at.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    positions: &'a [Quad],
    velocities: &'a [Quad],
    spins: &'a [Quad],
    images: &'a [Quad; IMAGES],
    law: Contact,
    dt: f64,
}

impl<'a> Scene<'a> {
    /// Particles of a box of this `setup`, stepped by `dt`, and what their contacts add to.
    pub(super) fn new(
        bodies: Bodies<'a>,
        images: &'a [Quad; IMAGES],
        setup: &Setup,
        dt: f64,
    ) -> (Self, Loads<'a>) {
        let Bodies { positions, velocities, spins, forces, torques, touched, .. } = bodies;
        let law = setup.contact;
        (Self { positions, velocities, spins, images, law, dt }, Loads { forces, torques, touched })
    }
}

/// What contacts add to, of a stretch of the particles.
pub(super) struct Loads<'a> {
    forces: &'a mut [Quad],
    torques: &'a mut [Quad],
    touched: &'a mut [bool],
}

impl<'a> Loads<'a> {
    fn split_at(self, at: usize) -> (Self, Self) {
        let (forces, forces2) = self.forces.split_at_mut(at);
        let (torques, torques2) = self.torques.split_at_mut(at);
        let (touched, touched2) = self.touched.split_at_mut(at);
        let second = Self { forces: forces2, torques: torques2, touched: touched2 };
        (Self { forces, torques, touched }, second)
    }

    /// Those from place `from` on, for a while.
    fn from(&mut self, from: usize) -> Loads<'_> {
        Loads {
            forces: &mut self.forces[from..],
            torques: &mut self.torques[from..],
            touched: &mut self.touched[from..],
        }
    }

    /// Gives the first `len`, which are particles, what the rest, their images, took on.
    fn gather(self, len: usize) {
        let (particles, images) = self.split_at(len);
        for (n, touched) in images.touched.iter_mut().enumerate() {
            if std::mem::take(touched) {
                add(&mut particles.forces[n], std::mem::take(&mut images.forces[n]).vector());
                add(&mut particles.torques[n], std::mem::take(&mut images.torques[n]).vector());
                particles.touched[n] = true;
            }
        }
    }
}

/// Forces of a group of particles that meets no other; beyond them, `loads` have their images.
pub(super) fn among<const SEEN: bool, const COHESIVE: bool>(
    group: &mut Slab,
    scene: Scene,
    mut loads: Loads,
) {
    touching(group, scene.positions, scene.images);
    contacts(group, scene, 0, loads.from(0), Kernel::<SEEN, COHESIVE>);
    loads.gather(scene.positions.len());
}

/// Forces of every other of the `slabs`, the first among them. `loads` begin at place `base`, that of the first slab's first particle, and reach to the end of the slab above the last.
fn every_other<const SEEN: bool, const COHESIVE: bool>(
    parallel: bool,
    scene: Scene,
    slabs: &mut [Slab],
    base: usize,
    loads: Loads,
) {
    if slabs.len() > 2 {
        let half = (slabs.len() / 2).next_multiple_of(2);
        let (lower, upper) = slabs.split_at_mut(half);
        let middle = upper[0].begin;
        let (below, above) = loads.split_at(middle - base);
        join(
            parallel,
            || every_other::<SEEN, COHESIVE>(parallel, scene, lower, base, below),
            || every_other::<SEEN, COHESIVE>(parallel, scene, upper, middle, above),
        );
    } else if let Some(slab) = slabs.first_mut() {
        let Scene { positions, images, .. } = scene;
        touching(slab, positions, images);
        contacts(slab, scene, base, loads, Kernel::<SEEN, COHESIVE>);
    }
}

simd! {
    /// Finds the near pairs in touch.
    fn touching[](slab: &mut Slab, positions: &[Quad], images: &[Quad; IMAGES]) {
        let Slab { near, found, .. } = slab;
        found.resize(near.len(), Near::default());
        let mut count = 0;
        // Without a branch: whether a near pair touches is anyone's guess.
        for &candidate in near.iter() {
            let (d, touching) = between(candidate.pair, positions, images);
            found[count] = candidate;
            let square = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
            count += usize::from(square < touching * touching);
        }
        found.truncate(count);
    }
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
fn add(to: &mut Quad, what: [f64; 3]) {
    for axis in 0..3 {
        to.0[axis] += what[axis];
    }
}

simd! {
    /// Adds the forces and torques of a slab's pairs that [`touching`] found, and leaves their springs in
    /// its contacts.
    fn contacts[const SEEN: bool, const COHESIVE: bool](
        slab: &mut Slab,
        scene: Scene<'_>,
        base: usize,
        loads: Loads<'_>,
        _kernel: Kernel<SEEN, COHESIVE>,
    ) {
        let Loads { forces, torques, touched } = loads;
        let Scene { positions, velocities, spins, images, law, dt } = scene;
        let Slab { found, contacts, before, springs, lost, deepest, seen, .. } = slab;
        seen.clear();
        std::mem::swap(contacts, before);
        contacts.clear();
        (*springs, *lost, *deepest) = (0.0, 0.0, 0.0);
        let c = damping(law.restitution);
        let tangential = law.tangential_stiffness * law.stiffness;
        let mut old = before.iter().peekable();
        for &Near { pair, place } in found.iter() {
            let (a, b) = (pair.first(), pair.second(positions.len()));
            let (d, touching) = between(pair, positions, images);
            let distance = dot(d, d).sqrt();
            // Centres on one point push each other apart along the first axis.
            let normal =
                if distance > 0.0 { d.map(|d| d / distance) } else { [1.0, 0.0, 0.0] };
            let overlap = touching - distance;
            *deepest = deepest.max(overlap / touching);

            let (Quad([ax, ay, az, a_lighter]), Quad([bx, by, bz, b_lighter])) =
                (velocities[a], velocities[b]);
            let relative = [ax - bx, ay - by, az - bz];
            let approach = -dot(relative, normal);
            let lighter = a_lighter + b_lighter;
            let frequency = (law.stiffness * lighter).sqrt();
            let dashpot = c * law.stiffness / frequency;
            // Δt/2 γ/m*: the dashpot acts with the mean velocity of the kick.
            let centred = 0.5 * dt * c * frequency;
            let spring = law.stiffness * overlap;
            let pull = if COHESIVE {
                pull(law.cohesion, [positions[a].0[3], positions[b].0[3]])
            } else {
                0.0
            };
            let less_pull = |spring: f64| if COHESIVE { spring - pull } else { spring };
            while let Some(parted) = old.next_if(|touch| touch.pair < place) {
                *lost += 0.5 * tangential * dot(parted.spring, parted.spring);
            }
            let kept = old.next_if(|touch| touch.pair == place);
            // The first and the last kick of a contact are those of the part of the step around them in
            // which the spheres touch: half a step, and the steps since they met, or until they part,
            // which are less than one.
            let whole = (less_pull(spring) + dashpot * approach) / (1.0 + centred);
            let parting = dt * whole * lighter - approach;
            let speed = if kept.is_none() { approach } else { parting };
            let ends = overlap < speed * dt;
            let part = overlap / (speed * dt);
            let (share, squeezed) = if ends {
                // A last kick may slow them down so much that they still touch: that part has been done.
                let over = kept.is_some_and(|touch| touch.ended);
                let share = if over { 0.0 } else { part + 0.5 };
                (share, 0.5 * share * speed * dt)
            } else {
                (1.0, overlap)
            };
            let push = share * (less_pull(law.stiffness * squeezed) + dashpot * approach)
                / (1.0 + share * centred);
            *springs += less_pull(0.5 * spring) * overlap;
            // The pull does work over the part of the step in which they touch.
            let stored = if COHESIVE { spring - share * pull } else { spring };
            *lost += (push - stored) * (approach - 0.5 * dt * push * lighter) * dt;

            let mut force = normal.map(|n| push * n);
            let mut stretched = [0.0; 3];
            if law.friction > 0.0 {
                let a_arm = distance * (positions[a].0[3] / touching);
                let b_arm = distance - a_arm;
                let (w, u) = (spins[a].0, spins[b].0);
                let turn: [f64; 3] = std::array::from_fn(|n| a_arm * w[n] + b_arm * u[n]);
                let turned = cross(turn, normal);
                let slip: [f64; 3] =
                    std::array::from_fn(|n| relative[n] + approach * normal[n] - turned[n]);

                let (sprung, time, acting) = match kept {
                    Some(touch) => (touch.spring, dt, dt),
                    // In touch since a part of the step only, and pulled by the mean of the kick.
                    None if ends => ([0.0; 3], part * dt, 0.5 * share * dt),
                    None => ([0.0; 3], dt, dt),
                };
                let energy = dot(sprung, sprung);
                let out = dot(sprung, normal);
                let sprung: [f64; 3] = std::array::from_fn(|n| sprung[n] - out * normal[n]);
                stretched = std::array::from_fn(|n| sprung[n] + time * slip[n]);
                let dashpot = law.tangential_damping * dashpot;
                let pull = tangential * acting + dashpot;
                let held = 1.0 + TANGENTIAL_MOBILITY * law.tangential_damping * share * centred;
                let mut drag: [f64; 3] = std::array::from_fn(|n| {
                    -share * (tangential * sprung[n] + pull * slip[n]) / held
                });
                // What presses the surfaces together, the pull of cohesion too.
                let pressed = if COHESIVE { push + share * pull } else { push };
                let (size, most) = (dot(drag, drag).sqrt(), law.friction * pressed.abs());
                if size > most {
                    drag = drag.map(|drag| drag * (most / size));
                    stretched = if tangential > 0.0 {
                        std::array::from_fn(|n| {
                            -(held / share * drag[n] + dashpot * slip[n]) / tangential
                        })
                    } else {
                        [0.0; 3]
                    };
                }
                let mobility = 0.5 * dt * TANGENTIAL_MOBILITY * lighter;
                let mean: [f64; 3] = std::array::from_fn(|n| slip[n] + mobility * drag[n]);
                let energy = 0.5 * tangential * (dot(stretched, stretched) - energy);
                *springs += 0.5 * tangential * dot(stretched, stretched);
                *lost -= time * dot(drag, mean) + energy;
                force = std::array::from_fn(|n| force[n] + drag[n]);
                let twist = cross(drag, normal);
                add(&mut torques[a - base], twist.map(|twist| a_arm * twist));
                add(&mut torques[pair.slot as usize - base], twist.map(|twist| b_arm * twist));
            }
            if SEEN {
                let Quad([x, y, z, _]) = positions[a];
                let place = [x - 0.5 * d[0], y - 0.5 * d[1], z - 0.5 * d[2], 0.5 * distance];
                seen.push(Seen { place: Quad(place), arm: d, force });
            }
            contacts.push(Touch { spring: stretched, pair: place, ended: ends && kept.is_some() });
            let (a, b) = (a - base, pair.slot as usize - base);
            add(&mut forces[a], force);
            add(&mut forces[b], force.map(|force| -force));
            (touched[a], touched[b]) = (true, true);
        }
        for parted in old {
            *lost += 0.5 * tangential * dot(parted.spring, parted.spring);
        }
    }
}

impl Dem {
    /// Adds up the forces of all contacts, which were zero before; returns the deepest overlap over the
    /// mean diameter.
    pub(super) fn contacts<const SEEN: bool>(&mut self) -> f64 {
        if self.setup.contact.cohesion > 0.0 {
            self.contacts_of::<SEEN, true>()
        } else {
            self.contacts_of::<SEEN, false>()
        }
    }

    fn contacts_of<const SEEN: bool, const COHESIVE: bool>(&mut self) -> f64 {
        let images = self.cells.images();
        let bodies = self.particles.bodies();
        let len = bodies.positions.len();
        let (setup, dt) = (&self.setup, self.dt);
        let parallel = setup.parallel;
        let (scene, mut loads) = Scene::new(bodies, &images, setup, dt);
        every_other::<SEEN, COHESIVE>(parallel, scene, &mut self.slabs, 0, loads.from(0));
        if let [_, slabs @ ..] = &mut self.slabs[..]
            && let Some(Slab { begin, .. }) = slabs.first()
        {
            let begin = *begin;
            every_other::<SEEN, COHESIVE>(parallel, scene, slabs, begin, loads.from(begin));
        }
        loads.gather(len);
        let mut deepest = 0.0f64;
        for slab in &self.slabs {
            self.lost += slab.lost;
            deepest = deepest.max(slab.deepest);
        }
        deepest
    }
}
