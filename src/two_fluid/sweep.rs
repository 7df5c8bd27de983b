//! The part of a step before the pressure, as one sweep along the last axis.
//!
//! Every stage of a step looks a slab or two to either side. Done one after the other over the whole
//! box they would stream some hundreds of numbers per cell through memory; done in one sweep, each
//! stage as soon as the slabs that it looks at are there, what passes between stages stays in cache
//! and needs memory for a few slabs only ([`Ring`]).
//!
//! A [`Sweep`] makes the slabs of one part of the box. Near its ends it makes again what its
//! neighbours make too, so parts need nothing of each other, and how many there are changes no bit
//! of a result. A part that is the whole box has itself as its neighbour: it keeps the first slabs that each
//! stage makes until the sweep has come around to them, and makes nothing twice.

use super::exchange::{self, Inertia};
use super::granular::{self, Balanced, Conducts};
use super::imposed::Sources;
use super::stress::{self, around, pair, pairs, shear_lines};
use super::transport::{self, Crossing, Line, Share, Wanted};
use super::{MOST_GAS_STEPS, Medium, Setup};
use crate::case::GranularEnergyChoice;
use crate::field::{Faces, Field, Layout, Lines, Ring, Row, Slabs, cells_of, fill};
use crate::poisson::Fast;
use crate::real::Real;
use crate::rows::per_axis;

/// What a sweep reads.
pub(super) struct Before<'a, R, const D: usize> {
    pub(super) layout: Layout<D>,
    pub(super) medium: &'a Medium<R>,
    pub(super) phi: &'a Field<R, D>,
    pub(super) theta: &'a Field<R, D>,
    pub(super) pressure: &'a Field<R, D>,
    pub(super) solids: &'a Faces<R, D>,
    pub(super) gas: &'a Faces<R, D>,
    /// g (ρ_mean - ρ_k) along the last axis, for solids and gas \[N/m³\].
    pub(super) buoyancy: [R; 2],
    pub(super) dt: R,
    /// Sub-steps of the gas's momentum transport, up to [`MOST_GAS_STEPS`]; 0 if it carries none.
    pub(super) gas_steps: usize,
    /// Whether granular temperature is carried by the solids and conducted.
    pub(super) transports_heat: bool,
    /// Whether the gas has a viscous stress.
    pub(super) gas_stress: bool,
    /// dt/h along each axis \[s/m\].
    pub(super) courant: [R; D],
    /// 1/h along each axis \[1/m\].
    pub(super) inverse_spacing: [R; D],
    /// Bound on the diffusivities of nearly empty cells \[m²/s\].
    pub(super) most_diffusivity: R,
    /// Solids fraction from which on a cell is not nearly empty \[-\].
    pub(super) nearly_empty: R,
    /// What verification adds.
    pub(super) sources: Option<&'a Sources<R, D>>,
}

/// What a sweep leaves, of its own slabs.
pub(super) struct After<'a, R, const D: usize> {
    pub(super) phi: Slabs<'a, R, D>,
    pub(super) theta: Slabs<'a, R, D>,
    /// Velocities that the pressure increment is still missing in.
    pub(super) solids: [Slabs<'a, R, D>; D],
    pub(super) gas: [Slabs<'a, R, D>; D],
    /// β/φ \[kg/m³/s\].
    pub(super) drag: Slabs<'a, R, D>,
    /// Response of the total volume flux to the pressure, over h².
    pub(super) weights: [Slabs<'a, Fast, D>; D],
    /// -∇· of the total volume flux \[1/s\].
    pub(super) right: Slabs<'a, R, D>,
}

impl<R: Real, const D: usize> After<'_, R, D> {
    /// What belongs to the slabs before `slab`, and to those from it on.
    pub(super) fn split_at(self, slab: usize) -> (Self, Self) {
        let Self { phi, theta, solids, gas, drag, weights, right } = self;
        let (phi, theta) = (phi.split_at(slab), theta.split_at(slab));
        let (drag, right) = (drag.split_at(slab), right.split_at(slab));
        let (solids, gas) = (split_faces(solids, slab), split_faces(gas, slab));
        let weights = split_faces(weights, slab);
        (
            Self {
                phi: phi.0,
                theta: theta.0,
                solids: solids.0,
                gas: gas.0,
                drag: drag.0,
                weights: weights.0,
                right: right.0,
            },
            Self {
                phi: phi.1,
                theta: theta.1,
                solids: solids.1,
                gas: gas.1,
                drag: drag.1,
                weights: weights.1,
                right: right.1,
            },
        )
    }
}

/// What of each axis belongs to the slabs before `slab`, and to those from it on.
fn split_faces<R: Real, const D: usize>(
    faces: [Slabs<'_, R, D>; D],
    slab: usize,
) -> ([Slabs<'_, R, D>; D], [Slabs<'_, R, D>; D]) {
    let mut parts = faces.map(|face| {
        let (below, above) = face.split_at(slab);
        (Some(below), Some(above))
    });
    let lower = parts.each_mut().map(|part| part.0.take().expect("taken once"));
    (lower, parts.map(|part| part.1.expect("taken once")))
}

/// The largest of a part of the box: what the next time step must respect.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fastest<R> {
    /// Square of the speed of granular sound \[m²/s²\].
    pub(super) sound_squared: R,
    /// Diffusivity of a cell that is not nearly empty \[m²/s\].
    pub(super) diffusivity: R,
}

impl<R: Real> Fastest<R> {
    const NONE: Self = Self { sound_squared: R::ZERO, diffusivity: R::ZERO };

    pub(super) fn or(self, other: Self) -> Self {
        Self {
            sound_squared: self.sound_squared.max(other.sound_squared),
            diffusivity: self.diffusivity.max(other.diffusivity),
        }
    }

    pub(super) fn f64(self) -> Fastest<f64> {
        Fastest { sound_squared: self.sound_squared.f64(), diffusivity: self.diffusivity.f64() }
    }

    pub(super) fn is_finite(&self) -> bool {
        self.sound_squared.f64().is_finite() && self.diffusivity.f64().is_finite()
    }
}

/// Makes some neighbouring slabs of a step.
#[derive(Debug)]
pub(super) struct Sweep<R, const D: usize> {
    /// The first slab and the one after the last.
    slabs: [usize; 2],
    /// Whether they are all that there are, so that after the last comes the first.
    closed: bool,
    /// As [`transport::most_row`] has it.
    most: Ring<R, D>,
    solids_flux: [Ring<R, D>; D],
    gas_flux: [Ring<R, D>; D],
    heat_flux: [Ring<R, D>; D],
    phi: Ring<R, D>,
    theta: Ring<R, D>,
    /// Momentum carried along the first axis, of a row.
    carried_within: Vec<R>,
    /// Momentum carried along the second axis, if it is not the last.
    carried_along: Ring<R, D>,
    /// Momentum carried into even and odd slabs from below: of the solids, then of each sub-step of the gas.
    carried_on: Vec<[[Ring<R, D>; 2]; D]>,
    /// Velocity of the solids after their momentum was carried, and of the gas after each sub-step,
    /// or where its momentum stayed.
    solids: [Ring<R, D>; D],
    gas: Vec<[Ring<R, D>; D]>,
    /// Slip speed squared, then the granular energy that it makes.
    slip_production: Ring<R, D>,
    drag: Ring<R, D>,
    radial_distribution: Ring<R, D>,
    viscosity: Ring<R, D>,
    bulk_viscosity: Ring<R, D>,
    /// I₂ of the solids' rate of strain, where friction asks for it \[1/s²\].
    strain: Ring<R, D>,
    conductivity: Ring<R, D>,
    /// τ_aa at cell centres, τ_ab on edges, tension positive \[Pa\].
    normal: [Ring<R, D>; D],
    shear: Vec<Ring<R, D>>,
    shear_heating: Vec<Ring<R, D>>,
    /// Velocity of the solids after the viscous stress.
    sheared: [Ring<R, D>; D],
    solids_pressure: Ring<R, D>,
    /// Total volume flux, without the pressure increment.
    total: [Ring<R, D>; D],
    /// What limits the next time step, cell by cell.
    limit: Ring<R, D>,
    /// Where rows of other parts go.
    spare: Vec<Vec<R>>,
    spare_weights: Vec<Fast>,
    /// τ_aa and τ_ab of the gas, as those of the solids, where its stress is asked for \[Pa\].
    gas_normal: [Ring<R, D>; D],
    gas_shear: Vec<Ring<R, D>>,
    /// Its viscosity and bulk viscosity (none), the same everywhere: a row of each \[Pa·s\].
    gas_viscosities: [Vec<R>; 2],
    /// Velocities of a row, pushed by the stress of the gas.
    stressed: [Vec<R>; 2],
    /// Velocities of a row, with what verification adds.
    pushed: [Vec<R>; 2],
    /// ∇·u_s of the cells of a row \[1/s\].
    divergence: Vec<R>,
}

impl<R: Real, const D: usize> Sweep<R, D> {
    /// For the slabs from `begin` to before `end` of a box; terms and viscosity of the gas are those
    /// of the steps' `setup`.
    pub(super) fn new(layout: Layout<D>, setup: &Setup, begin: usize, end: usize) -> Self {
        let terms = setup.terms;
        let pairs = D * (D - 1) / 2;
        let transports_heat = terms.granular_energy == GranularEnergyChoice::Transport;
        let most_gas_steps = if terms.gas_inertia { MOST_GAS_STEPS } else { 0 };
        let closed = end - begin == layout.cells[D - 1];
        // The slabs of a ring follow from how far apart in the sweep one is made and last looked at; how many
        // it keeps, from how much further below the part it is first made than last looked at, and how
        // far above that look is; see `run`. With friction all before the closures is first made one
        // further below.
        let most = 2 * most_gas_steps.max(1);
        let ring = |slabs, kept: usize| {
            let kept = if closed { kept.min(layout.cells[D - 1]) } else { 0 };
            Ring::new(layout, slabs).with_kept(kept)
        };
        let rings = |slabs, kept| std::array::from_fn(|_| ring(slabs, kept));
        let several = |n, slabs, kept| (0..n).map(|_| ring(slabs, kept)).collect();
        // What is used only if asked for is no longer than it must be.
        let if_any =
            |any: bool, slabs, kept| rings(if any { slabs } else { 1 }, if any { kept } else { 0 });
        let inertia = terms.gas_inertia;
        Self {
            slabs: [begin, end],
            closed,
            most: ring(2, 2),
            solids_flux: rings(16, most + 1),
            gas_flux: if_any(inertia, 16, most + 1),
            heat_flux: if_any(transports_heat, 2, 2),
            phi: ring(16, most + 4),
            theta: if transports_heat { ring(16, most + 4) } else { ring(1, 0) },
            carried_within: vec![R::ZERO; layout.most_elements() + 1],
            carried_along: ring(1, 0),
            carried_on: (0..=most_gas_steps)
                .map(|_| std::array::from_fn(|_| std::array::from_fn(|_| ring(1, 0))))
                .collect(),
            solids: rings(4, 5),
            gas: (0..most_gas_steps.max(1)).map(|_| rings(4, 4)).collect(),
            slip_production: ring(4, 3),
            drag: ring(4, 4),
            radial_distribution: ring(4, 3),
            viscosity: ring(4, 4),
            bulk_viscosity: ring(4, 0),
            strain: ring(1, 0),
            conductivity: if transports_heat { ring(4, 4) } else { ring(1, 0) },
            normal: rings(4, 3),
            shear: several(pairs, 2, 2),
            shear_heating: several(pairs, 2, 2),
            sheared: rings(2, 3),
            solids_pressure: ring(2, 2),
            total: rings(2, 2),
            limit: ring(1, 0),
            spare: vec![vec![R::ZERO; layout.most_elements()]; 2],
            spare_weights: vec![0.0; layout.most_elements()],
            gas_normal: if_any(terms.gas_stress, 4, 3),
            gas_shear: if terms.gas_stress { several(pairs, 2, 3) } else { several(pairs, 1, 0) },
            gas_viscosities: [setup.gas.viscosity, 0.0].map(|viscosity| {
                vec![R::of(viscosity); if terms.gas_stress { layout.most_elements() } else { 0 }]
            }),
            stressed: std::array::from_fn(|_| {
                vec![R::ZERO; if terms.gas_stress { layout.most_elements() } else { 0 }]
            }),
            pushed: std::array::from_fn(|_| vec![R::ZERO; layout.most_elements()]),
            divergence: vec![R::ZERO; layout.most_elements()],
        }
    }

    /// The first of its slabs.
    pub(super) fn first_slab(&self) -> usize {
        self.slabs[0]
    }

    /// Does the step up to the pressure.
    pub(super) fn run(
        &mut self,
        before: &Before<'_, R, D>,
        after: &mut After<'_, R, D>,
    ) -> Fastest<R> {
        let [begin, end] = self.slabs.map(|slab| slab as isize);
        let closed = self.closed;
        let m = before.last_gas_step() as isize + 1;
        // Friction looks at the velocity of the solids a slab further below.
        let reach = isize::from(before.medium.contact.rubs());
        let mut fastest = Fastest::<R>::NONE;
        // At time `now` each stage makes the slab that lies as far behind as its inputs ask for, if
        // that slab is within what the later stages look at: `below` slabs before the part and
        // `above` after it. If after the part comes its beginning, the stage makes as many as there are and
        // for those above them brings back the first ones that it made.
        for now in begin - 2 * m - 3 - reach..end + 2 * m + 3 {
            // How far behind, `below`, `above`, what to do with the slab that is due, and what that makes.
            macro_rules! stage {
                ($behind:expr, $below:expr, $above:expr, |$slab:ident| $make:expr $(, $made:expr)*) => {{
                    let ($slab, below, above) = (now - $behind, $below, $above);
                    let (first, last) = (begin - below, if closed { end - below } else { end + above });
                    // What looks furthest at what is made below the part is made from the part's first
                    // slab on, and looks no further than one slab above: that many are kept, and one.
                    if $slab >= first && $slab < last {
                        $make;
                        $(if closed && $slab - first <= below {
                            for ring in $made {
                                ring.keep($slab, ($slab - first) as usize);
                            }
                        })*
                    }
                    $(if closed && $slab >= last && $slab - last <= below {
                        for ring in $made {
                            ring.bring_back($slab, (($slab - last) % (end - begin)) as usize);
                        }
                    })*
                }};
            }
            // What is carried into the first slab is made with the one before it.
            macro_rules! first_carried {
                ($behind:expr, $below:expr, |$slab:ident| $make:expr) => {
                    let $slab = now - $behind;
                    if $slab == begin - $below - 1 {
                        $make;
                    }
                };
            }
            stage!(
                0,
                2 * m + 3 + reach,
                2 * m + 3,
                |slab| self.most(before, slab),
                [&mut self.most]
            );
            stage!(
                0,
                2 * m + 2 + reach,
                2 * m + 3,
                |slab| self.fluxes(before, slab),
                &mut self.solids_flux,
                &mut self.gas_flux,
                &mut self.heat_flux
            );
            stage!(
                1,
                2 * m + 2 + reach,
                2 * m + 2,
                |slab| self.advect(before, after, slab),
                [&mut self.phi, &mut self.theta]
            );
            if before.gas_steps == 0 {
                stage!(1, 3, 4, |slab| self.gas_stays(before, slab), &mut self.gas[0]);
            }
            for n in 0..before.gas_steps {
                let left = 2 * (m - 1 - n as isize);
                let behind = 2 * n as isize + 1;
                first_carried!(behind, 3 + left, |slab| self.gas_momentum(before, n, slab, true));
                stage!(
                    behind,
                    3 + left,
                    4 + left,
                    |slab| self.gas_momentum(before, n, slab, false),
                    &mut self.gas[n]
                );
            }
            first_carried!(2 * m - 1, 3 + reach, |slab| self.solids_momentum(before, slab, true));
            stage!(
                2 * m - 1,
                3 + reach,
                4,
                |slab| self.solids_momentum(before, slab, false),
                &mut self.solids
            );
            stage!(
                2 * m,
                3,
                3,
                |slab| {
                    let diffusivity = self.closures(before, after, slab);
                    fastest.diffusivity = fastest.diffusivity.max(diffusivity);
                    self.normal_stress(before, slab);
                },
                [&mut self.slip_production, &mut self.drag, &mut self.radial_distribution],
                [&mut self.viscosity, &mut self.conductivity],
                &mut self.normal
            );
            stage!(2 * m, 2, 3, |slab| self.shear_stress(before, slab), &mut self.shear);
            stage!(2 * m + 1, 2, 2, |slab| self.shear(before, slab), &mut self.sheared);
            // The edges above the lowest slab's lower faces are the first with both sides made.
            stage!(
                2 * m + 1,
                1,
                2,
                |slab| self.shear_heating(before, slab),
                &mut self.shear_heating
            );
            if before.gas_stress {
                stage!(
                    2 * m + 1,
                    1,
                    2,
                    |slab| self.gas_stress(before, slab),
                    &mut self.gas_normal,
                    &mut self.gas_shear
                );
            }
            stage!(
                2 * m + 2,
                1,
                1,
                |slab| {
                    let sound_squared = self.granular_energy(before, after, slab);
                    fastest.sound_squared = fastest.sound_squared.max(sound_squared);
                },
                [&mut self.solids_pressure]
            );
            stage!(2 * m + 2, 0, 1, |slab| self.forces(before, after, slab), &mut self.total);
            stage!(2 * m + 3, 0, 0, |slab| self.convergence(before, after, slab));
        }
        fastest
    }

    /// How much each cell can give.
    fn most(&mut self, before: &Before<'_, R, D>, slab: isize) {
        for row in before.rows(slab) {
            let velocity = both_faces(before.solids, row);
            fill!(
                before.layout,
                [most = self.most.line(row)],
                transport::most_row(most, velocity, before.courant)
            );
        }
    }

    /// Volume fluxes through the lower faces, and solids times temperature with them.
    fn fluxes(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let Before { phi, theta, solids, gas, courant, .. } = before;
        for row in before.rows(slab) {
            for axis in 0..D {
                let most = [self.most.row(row.near(axis, -1)), self.most.row(row)];
                let (phi, theta) = (Line::at(*phi, row, axis), Line::at(*theta, row, axis));
                let (us, ug, c) = (solids[axis].row(row), gas[axis].row(row), courant[axis]);
                fill!(
                    before.layout,
                    [
                        fs = self.solids_flux[axis].line(row),
                        fg = self.gas_flux[axis].line(row),
                        ft = self.heat_flux[axis].line(row),
                    ],
                    {
                        // A kernel for each choice of terms.
                        macro_rules! made {
                            ($gas:literal, $heat:literal) => {{
                                let wanted = Wanted::<$gas, $heat>;
                                transport::flux_row(fs, fg, ft, phi, theta, us, ug, most, c, wanted)
                            }};
                        }
                        match (before.gas_steps > 0, before.transports_heat) {
                            (true, true) => made!(true, true),
                            (true, false) => made!(true, false),
                            (false, true) => made!(false, true),
                            (false, false) => made!(false, false),
                        }
                    }
                );
            }
        }
    }

    /// Solids fraction and temperature by the fluxes.
    fn advect(&mut self, before: &Before<'_, R, D>, after: &mut After<'_, R, D>, slab: isize) {
        for row in before.rows(slab) {
            let fs = both_faces(&self.solids_flux, row);
            let (phi_old, theta_old) = (before.phi.row(row), before.theta.row(row));
            if before.transports_heat {
                let ft = both_faces(&self.heat_flux, row);
                fill!(
                    before.layout,
                    [phi = self.phi.line(row), theta = self.theta.line(row)],
                    transport::advect_row(phi, theta, phi_old, theta_old, fs, ft, before.courant)
                );
            } else {
                fill!(
                    before.layout,
                    [phi = self.phi.line(row)],
                    transport::advect_solids_row(phi, phi_old, fs, before.courant)
                );
            }
            // A temperature that is not carried has no rate to which a source could be added.
            if let (Some(sources), true) = (before.sources, before.transports_heat) {
                fill!(
                    before.layout,
                    [theta = self.theta.line(row)],
                    sources.heat(theta, row, before.dt)
                );
            }
            after.phi.line(row, &mut self.spare[0]).copy_from_slice(self.phi.whole(row));
        }
    }

    /// Momentum of the solids by their fluxes.
    fn solids_momentum(&mut self, before: &Before<'_, R, D>, slab: isize, before_first: bool) {
        let Self { carried_within, carried_along, carried_on, solids_flux, solids, phi, .. } = self;
        let momentum = Momentum {
            velocity: before.solids,
            flux: solids_flux,
            fractions: (before.phi, phi),
            shares: Share::solids(),
            courant: before.courant,
        };
        let on = &mut carried_on[0];
        let carried = Carried { within: carried_within, along: carried_along, on };
        momentum.carry(before, carried, solids, slab, before_first);
    }

    /// Momentum of a gas that carries none along.
    fn gas_stays(&mut self, before: &Before<'_, R, D>, slab: isize) {
        for row in before.rows(slab) {
            for axis in 0..D {
                let below = row.near(axis, -1);
                let (old, new) = (before.phi, &self.phi);
                let fractions = [old.row(below), old.row(row), new.row(below), new.row(row)];
                let u = before.gas[axis].row(row);
                fill!(
                    before.layout,
                    [gas = self.gas[0][axis].line(row)],
                    transport::stay_row(gas, u, fractions)
                );
            }
        }
    }

    /// Momentum of the gas by its fluxes, in sub-step `n`.
    fn gas_momentum(
        &mut self,
        before: &Before<'_, R, D>,
        n: usize,
        slab: isize,
        before_first: bool,
    ) {
        let Self { carried_within, carried_along, carried_on, gas_flux, gas, phi, .. } = self;
        let part = 1.0 / before.gas_steps as f64;
        let fractions = (before.phi, &*phi);
        let shares = [Share::gas(n as f64 * part), Share::gas((n + 1) as f64 * part)];
        let courant = before.courant.map(|c| c * R::of(part));
        let on = &mut carried_on[1 + n];
        let carried = Carried { within: carried_within, along: carried_along, on };
        let (done, to_do) = gas.split_at_mut(n);
        let new = &mut to_do[0];
        match done.last() {
            None => Momentum { velocity: before.gas, flux: gas_flux, fractions, shares, courant }
                .carry(before, carried, new, slab, before_first),
            Some(velocity) => Momentum { velocity, flux: gas_flux, fractions, shares, courant }
                .carry(before, carried, new, slab, before_first),
        }
    }

    /// Drag coefficient and kinetic theory; the largest diffusivity.
    fn closures(
        &mut self,
        before: &Before<'_, R, D>,
        after: &mut After<'_, R, D>,
        slab: isize,
    ) -> R {
        let gas = &self.gas[before.last_gas_step()];
        let mut fastest = R::ZERO;
        for row in before.rows(slab) {
            let velocities: [[&[R]; 4]; D] = per_axis!(D, |a| {
                let above = row.near(a, 1);
                let (us, ug) = (&self.solids[a], &gas[a]);
                [us.row(row), us.row(above), ug.row(row), ug.row(above)]
            });
            let (phi, theta) = (self.phi.row(row), before.temperature(&self.theta, row));
            let medium = before.medium;
            let bounds = [before.most_diffusivity, before.nearly_empty];
            let most = fill!(
                before.layout,
                [
                    slip = self.slip_production.line(row),
                    drag = self.drag.line(row),
                    g0 = self.radial_distribution.line(row),
                    viscosity = self.viscosity.line(row),
                    bulk = self.bulk_viscosity.line(row),
                    conductivity = self.conductivity.line(row),
                    diffusivity = self.limit.line(row),
                ],
                {
                    granular::slip_row(slip, velocities);
                    medium.drag.fill(drag, phi, slip);
                    let outputs = [slip, g0, viscosity, bulk, conductivity, &mut *diffusivity];
                    let conducts = before.transports_heat;
                    medium.contact.kinetic(outputs, medium, phi, theta, drag, bounds, conducts);
                    before.layout.largest(diffusivity)
                }
            );
            fastest = fastest.max(most);
            after.drag.line(row, &mut self.spare[0]).copy_from_slice(self.drag.whole(row));
        }
        if before.medium.contact.rubs() {
            self.friction(before, slab);
        }
        fastest
    }

    /// Frictional viscosity, on top of the kinetic one.
    fn friction(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let Before { medium, inverse_spacing: h, most_diffusivity, .. } = *before;
        for row in before.rows(slab) {
            let (phi, theta) = (self.phi.row(row), before.temperature(&self.theta, row));
            let u = &self.solids;
            fill!(
                before.layout,
                [strain = self.strain.line(row), viscosity = self.viscosity.line(row)],
                {
                    granular::strain_row(strain, both_faces(u, row), h);
                    for (_, (a, b)) in pairs::<D>() {
                        let across = |u: usize, by: usize| {
                            let (above, below) = (row.near(by, 1), row.near(by, -1));
                            let q = &self.solids[u];
                            [
                                q.row(above),
                                q.row(above.near(u, 1)),
                                q.row(below),
                                q.row(below.near(u, 1)),
                            ]
                        };
                        let u = [across(a, b), across(b, a)];
                        granular::shear_strain_row(strain, u, [h[a], h[b]]);
                    }
                    let (rho, most) = (medium.solids_density, most_diffusivity);
                    medium.contact.rub(viscosity, rho, phi, theta, strain, most);
                }
            );
        }
    }

    /// Viscous stress of the solids at the centres of the cells.
    fn normal_stress(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let h = before.inverse_spacing;
        for row in before.rows(slab) {
            for axis in 0..D {
                let u = both_faces(&self.solids, row);
                let (mu, bulk) = (self.viscosity.row(row), self.bulk_viscosity.row(row));
                fill!(
                    before.layout,
                    [normal = self.normal[axis].line(row)],
                    stress::normal_row(normal, axis, u, mu, bulk, h)
                );
            }
        }
    }

    /// Viscous stress of the solids at the edges.
    fn shear_stress(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let h = before.inverse_spacing;
        for row in before.rows(slab) {
            for (at, (a, b)) in pairs::<D>() {
                let u = shear_lines(&self.solids, (a, b), row);
                let mu = around(&self.viscosity, (a, b), row);
                fill!(
                    before.layout,
                    [shear = self.shear[at].line(row)],
                    stress::shear_row(shear, u, mu, [h[a], h[b]])
                );
            }
        }
    }

    /// Velocity of the solids by the viscous stress.
    fn shear(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let impulse = before.dt / before.medium.solids_density;
        for row in before.rows(slab) {
            for axis in 0..D {
                let stress: [[&[R]; 2]; D] = per_axis!(D, |b| {
                    if b == axis {
                        [self.normal[axis].row(row.near(axis, -1)), self.normal[axis].row(row)]
                    } else {
                        let shear = &self.shear[pair(axis, b)];
                        [shear.row(row), shear.row(row.near(b, 1))]
                    }
                });
                let phi = [self.phi.row(row.near(axis, -1)), self.phi.row(row)];
                let u = self.solids[axis].row(row);
                fill!(
                    before.layout,
                    [new = self.sheared[axis].line(row)],
                    stress::apply_row(new, u, stress, phi, impulse, before.inverse_spacing)
                );
            }
        }
    }

    /// Shear heating of the edges, from the velocities before and after the stress.
    fn shear_heating(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let h = before.inverse_spacing;
        for row in before.rows(slab) {
            for (at, (a, b)) in pairs::<D>() {
                let axes = (a, b);
                let u =
                    [shear_lines(&self.solids, axes, row), shear_lines(&self.sheared, axes, row)];
                let phi = around(&self.phi, (a, b), row);
                let shear = self.shear[at].row(row);
                fill!(
                    before.layout,
                    [heating = self.shear_heating[at].line(row)],
                    stress::shear_heating_row(heating, shear, u, phi, [h[a], h[b]])
                );
            }
        }
    }

    /// Viscous stress of the gas.
    fn gas_stress(&mut self, before: &Before<'_, R, D>, slab: isize) {
        let h = before.inverse_spacing;
        let gas = &self.gas[before.last_gas_step()];
        let [mu, bulk] = self.gas_viscosities.each_ref().map(Vec::as_slice);
        for row in before.rows(slab) {
            for axis in 0..D {
                let u = both_faces(gas, row);
                fill!(
                    before.layout,
                    [normal = self.gas_normal[axis].line(row)],
                    stress::normal_row(normal, axis, u, mu, bulk, h)
                );
            }
            for (at, (a, b)) in pairs::<D>() {
                let u = shear_lines(gas, (a, b), row);
                fill!(
                    before.layout,
                    [shear = self.gas_shear[at].line(row)],
                    stress::shear_row(shear, u, [mu; 4], [h[a], h[b]])
                );
            }
        }
    }

    /// Balance of granular energy over the step: conduction and viscous heating explicit,
    /// dissipation, compression and production by slip implicit in each cell; or the temperature
    /// at which the sources balance. Leaves the temperature
    /// and the solids pressure; returns the largest squared speed of sound.
    fn granular_energy(
        &mut self,
        before: &Before<'_, R, D>,
        after: &mut After<'_, R, D>,
        slab: isize,
    ) -> R {
        let Before { medium, inverse_spacing: h, dt, .. } = *before;
        let density = medium.solids_density;
        let mut fastest = R::ZERO;
        for row in before.rows(slab) {
            let (phi, g0) = (self.phi.row(row), self.radial_distribution.row(row));
            let old = before.temperature(&self.theta, row);
            let work: [[&[R]; 5]; D] = per_axis!(D, |a| {
                let (above, normal) = (row.near(a, 1), self.normal[a].row(row));
                let (u, v) = (&self.solids[a], &self.sheared[a]);
                [normal, u.row(row), u.row(above), v.row(row), v.row(above)]
            });
            let edges: [[&[R]; 4]; 3] = {
                let mut edges = [[&[] as &[R]; 4]; 3];
                for (at, (a, b)) in pairs::<D>() {
                    let (right, up) = (row.near(a, 1), row.near(b, 1));
                    let q = &self.shear_heating[at];
                    edges[at] = [q.row(row), q.row(right), q.row(up), q.row(right.near(b, 1))];
                }
                if D == 2 { [edges[0]; 3] } else { edges }
            };
            let n = phi.len();
            let divergence = &mut self.divergence[..n];
            let most = fill!(
                before.layout,
                [
                    theta = after.theta.line(row, &mut self.spare[0]),
                    pressure = self.solids_pressure.line(row),
                    sound = self.limit.line(row),
                ],
                {
                    let inverse = R::ONE / density;
                    if before.transports_heat {
                        let heat: [[&[R]; 6]; D] = per_axis!(D, |a| {
                            let (below, above) = (row.near(a, -1), row.near(a, 1));
                            let (k, t) = (&self.conductivity, &self.theta);
                            let k = [k.row(below), k.row(row), k.row(above)];
                            [k[0], k[1], k[2], t.row(below), t.row(row), t.row(above)]
                        });
                        let conducts = Conducts::<true>;
                        granular::heating_row(
                            theta, divergence, work, heat, edges, phi, inverse, h, conducts,
                        );
                    } else {
                        let (heat, conducts) = ([[phi; 6]; D], Conducts::<false>);
                        granular::heating_row(
                            theta, divergence, work, heat, edges, phi, inverse, h, conducts,
                        );
                    }
                    let cells = Balanced {
                        algebraic: !before.transports_heat,
                        phi,
                        theta: old,
                        g0,
                        drag: self.drag.row(row),
                        slip: self.slip_production.row(row),
                        divergence,
                        viscosity: self.viscosity.row(row),
                        solids_density: density,
                        cell_squared: R::ONE / h.iter().fold(R::ZERO, |sum, h| sum + *h * *h),
                        dt,
                    };
                    let outputs = [theta, pressure, &mut *sound];
                    medium.contact.balance(outputs, medium.theory, &cells);
                    before.layout.largest(sound)
                }
            );
            fastest = fastest.max(most);
        }
        fastest
    }

    /// All forces but the pressure increment, and the exchange of momentum by drag.
    fn forces(&mut self, before: &Before<'_, R, D>, after: &mut After<'_, R, D>, slab: isize) {
        let inertia = Inertia::new(before.medium, before.dt);
        let gas = &self.gas[before.last_gas_step()];
        for row in before.rows(slab) {
            for axis in 0..D {
                let below = row.near(axis, -1);
                let spacing = before.inverse_spacing[axis];
                let buoyancy = if axis + 1 == D { before.buoyancy } else { [R::ZERO; 2] };
                let mut velocities = [self.sheared[axis].row(row), gas[axis].row(row)];
                if before.gas_stress {
                    let stress: [[&[R]; 2]; D] = per_axis!(D, |b| {
                        if b == axis {
                            [self.gas_normal[axis].row(below), self.gas_normal[axis].row(row)]
                        } else {
                            let shear = &self.gas_shear[pair(axis, b)];
                            [shear.row(row), shear.row(row.near(b, 1))]
                        }
                    });
                    let [us, ug] = &mut self.stressed;
                    let n = velocities[0].len();
                    let (us, ug) = (&mut us[..n], &mut ug[..n]);
                    let phi = [self.phi.row(below), self.phi.row(row)];
                    let Medium { solids_density, gas_density, .. } = *before.medium;
                    let impulses = [before.dt / solids_density, before.dt / gas_density];
                    let h = before.inverse_spacing;
                    stress::push_row(us, ug, velocities, stress, phi, impulses, h);
                    velocities = [us, ug];
                }
                if let Some(sources) = before.sources {
                    sources.push(&mut self.pushed, velocities, axis, row, before.dt);
                    velocities = self.pushed.each_ref().map(Vec::as_slice);
                }
                let [us, ug] = self.spare.first_chunk_mut().expect("two spare rows");
                let weights = &mut self.spare_weights;
                fill!(
                    before.layout,
                    [
                        us = after.solids[axis].line(row, us),
                        ug = after.gas[axis].line(row, ug),
                        total = self.total[axis].line(row),
                        weights = after.weights[axis].line(row, weights),
                    ],
                    exchange::predict_row(
                        us,
                        ug,
                        total,
                        weights,
                        velocities,
                        [self.phi.row(below), self.phi.row(row)],
                        [self.drag.row(below), self.drag.row(row)],
                        [self.solids_pressure.row(below), self.solids_pressure.row(row)],
                        [before.pressure.row(below), before.pressure.row(row)],
                        inertia,
                        buoyancy,
                        spacing,
                        spacing * spacing,
                    )
                );
            }
        }
    }

    /// What the pressure increment must make up for.
    fn convergence(&mut self, before: &Before<'_, R, D>, after: &mut After<'_, R, D>, slab: isize) {
        for row in before.rows(slab) {
            let total = both_faces(&self.total, row);
            fill!(
                before.layout,
                [right = after.right.line(row, &mut self.spare[0])],
                exchange::convergence_row(right, total, before.inverse_spacing)
            );
        }
    }
}

impl<R: Real, const D: usize> Before<'_, R, D> {
    /// Granular temperature that the closures are of: as the solids `carried` it, or of the step
    /// before.
    #[inline(always)]
    fn temperature<'b>(&'b self, carried: &'b Ring<R, D>, row: Row<D>) -> &'b [R] {
        if self.transports_heat { carried.row(row) } else { self.theta.row(row) }
    }

    /// The last sub-step of the gas, or 0 for where its momentum stays.
    fn last_gas_step(&self) -> usize {
        self.gas_steps.saturating_sub(1)
    }

    /// The rows of a slab.
    fn rows(&self, slab: isize) -> impl Iterator<Item = Row<D>> + use<R, D> {
        self.layout.pieces(slab)
    }
}

/// The lower and upper faces of a row of cells along each axis.
#[inline(always)]
pub(super) fn both_faces<R: Real, const D: usize>(
    faces: &[impl Lines<R, D>; D],
    row: Row<D>,
) -> [[&[R]; 2]; D] {
    per_axis!(D, |a| [faces[a].row(row), faces[a].row(row.near(a, 1))])
}

/// Room for what is carried along the first axis of a row, along the second of a slab, and into even and
/// odd slabs from below.
struct Carried<'a, R, const D: usize> {
    within: &'a mut [R],
    along: &'a mut Ring<R, D>,
    on: &'a mut [[Ring<R, D>; 2]; D],
}

/// Momentum of one phase and what carries it.
struct Momentum<'a, R, L, const D: usize> {
    velocity: &'a [L; D],
    flux: &'a [Ring<R, D>; D],
    /// φ before and after.
    fractions: (&'a Field<R, D>, &'a Ring<R, D>),
    shares: [Share<R>; 2],
    courant: [R; D],
}

impl<R: Real, L: Lines<R, D>, const D: usize> Momentum<'_, R, L, D> {
    /// The new velocity of a slab, and what crosses its upper side, which the next slab asks for; of
    /// the slab before the first only that.
    fn carry(
        &self,
        before: &Before<'_, R, D>,
        Carried { within, along, on }: Carried<'_, R, D>,
        new: &mut [Ring<R, D>; D],
        slab: isize,
        before_first: bool,
    ) {
        for component in 0..D {
            let [even, odd] = &mut on[component];
            let (below, above) = if slab % 2 == 0 { (even, odd) } else { (odd, even) };
            if before_first {
                for row in before.rows(slab) {
                    let upper = row.near(D - 1, 1);
                    let out = cells_of(above.line(upper));
                    transport::carry_row(out, &self.crossing(component, D - 1, upper));
                }
                continue;
            }
            if D == 3 {
                for row in before.rows(slab) {
                    let out = cells_of(along.line(row));
                    transport::carry_row(out, &self.crossing(component, 1, row));
                }
            }
            for row in before.rows(slab) {
                let upper = row.near(D - 1, 1);
                let u = self.velocity[component].row(row);
                let middle: [[&[R]; 2]; D] = if D == 3 {
                    [[along.row(row), along.row(row.near(1, 1))]; D]
                } else {
                    [[u; 2]; D]
                };
                let (old, after) = self.fractions;
                let lower = row.near(component, -1);
                let fractions = [old.row(lower), old.row(row), after.row(lower), after.row(row)];
                fill!(
                    before.layout,
                    [new = new[component].line(row)],
                    transport::momentum_row(
                        new,
                        cells_of(above.line(upper)),
                        within,
                        before.layout.cells[0],
                        u,
                        &self.crossing(component, 0, row),
                        &self.crossing(component, D - 1, upper),
                        below.row(row),
                        middle,
                        fractions,
                        self.shares,
                    )
                );
            }
        }
    }

    /// What carries a `component` across the lower sides of a row of its cells along `axis`.
    #[inline(always)]
    fn crossing(&self, component: usize, axis: usize, row: Row<D>) -> Crossing<'_, R> {
        let lower = row.near(component, -1);
        let (flux, velocity) = (&self.flux[axis], &self.velocity[axis]);
        Crossing {
            component: Line::at(&self.velocity[component], row, axis),
            flux: [flux.row(lower), flux.row(row)],
            velocity: [velocity.row(lower), velocity.row(row)],
            courant: self.courant[axis],
        }
    }
}
