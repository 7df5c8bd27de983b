//! From what was typed to a [`Case`]: units to SI, defaults, and the checks of every value's meaning.
//!
//! Each function resolves one part and returns none where something in it is missing or wrong,
//! which is then among the problems; the others go on, so that all problems are found at once.

use std::ops::RangeInclusive;
use std::path::{Path, absolute};

use super::file::{
    CaseFile, DiametersTyped, DomainFile, FilterFile, OutputFile, ParticlesFile, Problems,
    Quantity, RunFile, Typed, Unit, nearest,
};
use super::{
    Case, Diameters, Domain, DragChoice, Drive, DriveChoice, EdgesChoice, FieldsChoice, FilterCase,
    FrictionChoice, KernelChoice, MappingChoice, MarkerChoice, MixtureChoice, OutputCase,
    ParticlesCase, ParticlesStart, Physics, Places, Precision, RadialDistributionChoice, RunCase,
    SolverChoice, Terms, default_spread, edges, least, quoted,
};
use crate::laws::contact::{Contact, cohesion_of, pull, stiffness_for};
use crate::laws::scales::{Gas, Powder, Scales};
use std::f64::consts::PI;

/// Fewest cells along an edge: the smallest grid on which a filter of four cells is at most half
/// the box.
const FEWEST_CELLS: u64 = 8;

/// Densities of one particle that are accepted [kg/m³].
const POWDER_DENSITY: RangeInclusive<f64> = 1.0..=3e4;

/// Most cells of a box: a run of this size takes hundreds of gigabytes, so more is a slip of the
/// pen, better refused here than by the memory allocator.
const MOST_CELLS: u64 = 1 << 30;

/// How far a ratio of lengths may be from a whole number and still count as one, relatively.
pub(super) const WHOLE: f64 = 1e-6;

/// Samples that a run must have room for: statistics by blocks of time need some.
pub(super) const FEWEST_SAMPLES: f64 = 20.0;

/// What is accepted as a time.
pub(super) const TIME_EXPECTED: &str = "a time above 0 and at most 1e9 s is accepted";

/// Whether a time is acceptable \[s\].
pub(super) fn is_time(seconds: f64) -> bool {
    seconds > 0.0 && seconds <= 1e9
}

/// The value where it is acceptable; else notes what would be.
fn accept(
    typed: Option<&Typed<f64>>,
    accepted: impl Fn(f64) -> bool,
    expected: &str,
    problems: &mut Problems<'_>,
) -> Option<f64> {
    let typed = typed?;
    if accepted(typed.value) {
        Some(typed.value)
    } else {
        problems.refuse(typed, format!("{expected} is accepted"));
        None
    }
}

/// Turns what was typed into a case; none if anything is missing or wrong, which is then among the
/// problems. A domain that is `given` takes the place of the one that was typed, unchecked. Files are
/// sought in `folder`.
pub(super) fn resolve(
    file: &CaseFile,
    name: &str,
    given: Option<Domain>,
    folder: &Path,
    problems: &mut Problems<'_>,
) -> Option<Case> {
    let powder = resolve_powder(file, problems);
    let gas = resolve_gas(file, problems);
    let gravity = match &file.physics.gravity {
        None => Some(9.81),
        typed => accept(
            typed.as_ref(),
            |g| (1e-3..=1e4).contains(&g),
            "a number from 1e-3 to 1e4 m/s², positive: it points down the last axis,",
            problems,
        ),
    };
    // A gas as heavy as the powder has no terminal velocity, so no scales either.
    let scales = match (&powder, &gas, gravity) {
        (Some(powder), Some(gas), Some(gravity)) => Some(Scales::new(powder, gas, gravity)),
        _ => None,
    };
    let max_packing = powder.as_ref().map(|powder| powder.max_packing);
    let solver = file.physics.solver.as_ref().map_or(SolverChoice::TwoFluid, |typed| typed.value);
    let perturbation = match &file.run.perturbation {
        // Particles are at random places.
        _ if solver == SolverChoice::CfdDem => Some(0.0),
        None => Some(0.05),
        typed => {
            accept(typed.as_ref(), |p| (0.0..=0.5).contains(&p), "a number from 0 to 0.5", problems)
        }
    };
    let diameter = powder.as_ref().map(|powder| powder.diameter);
    let (domain, fractions) = match given {
        Some(Domain { size, cells, solids_fractions }) => {
            (Some((size, cells)), Some(solids_fractions))
        }
        None => (
            resolve_domain(&file.domain, scales.as_ref(), diameter, problems),
            resolve_fractions(&file.domain, max_packing, perturbation, problems),
        ),
    };
    let filter =
        resolve_filter(&file.filter, domain.as_ref(), scales.as_ref(), max_packing, problems);
    let run = resolve_run(&file.run, scales.as_ref(), perturbation, problems);
    let particles = match (solver, &powder) {
        (SolverChoice::TwoFluid, _) => {
            if let Some(header) = &file.particles.header {
                problems.refuse(
                    header,
                    "particles are followed with [physics] solver = \"cfd-dem\" only: give that too, or \
                     leave the section out",
                );
            }
            None
        }
        (SolverChoice::CfdDem, Some(powder)) => {
            refuse_continuum(file, problems);
            let (domain, scales) = (domain.as_ref(), scales.as_ref());
            Some(resolve_particles(file, powder, domain, scales, folder, problems)?)
        }
        (SolverChoice::CfdDem, None) => None,
    };
    let output = resolve_output(&file.output, scales.as_ref(), run.as_ref(), problems);
    let drive = resolve_drive(file, scales.as_ref(), problems);
    let (size, cells) = domain?;
    Some(Case {
        name: name.to_owned(),
        powder: powder?,
        gas: gas?,
        domain: Domain { size, cells, solids_fractions: fractions? },
        physics: Physics {
            drag: file.physics.drag.as_ref().map_or(DragChoice::WenYu, |typed| typed.value),
            radial_distribution: file
                .physics
                .radial_distribution
                .as_ref()
                .map_or(RadialDistributionChoice::Princeton, |typed| typed.value),
            friction: file
                .physics
                .friction
                .as_ref()
                .map_or(FrictionChoice::Barrier, |typed| typed.value),
            terms: resolve_terms(file),
            drive: drive?,
            gravity: gravity?,
        },
        particles,
        filter: filter?,
        run: run?,
        output: output?,
    })
}

/// Refuses what a case says of the two-fluid model only.
fn refuse_continuum(file: &CaseFile, problems: &mut Problems<'_>) {
    const WHY: &str = "this is of the two-fluid model: with solver = \"cfd-dem\" leave it out";
    macro_rules! refuse {
        ($($typed:expr),*) => {
            $(if let Some(typed) = &$typed {
                problems.refuse(typed, WHY);
            })*
        };
    }
    let (physics, run) = (&file.physics, &file.run);
    refuse!(
        physics.radial_distribution,
        physics.friction,
        physics.granular_energy,
        run.perturbation,
        run.precision,
        run.time_order
    );
}

/// Overlap of two particles that meet at u_t, in d, that sets the stiffness of a case that says none.
const OVERLAP: f64 = 0.01;

/// Shortest edge of a cell that particles are shared among, in diameters of the largest.
const SHORTEST_CELL: f64 = 1.5;

/// How far the Sauter mean of the diameters may be from the powder's diameter, relatively.
pub(super) const SAUTER: f64 = 0.01;

/// Deepest overlap, in d, at which particles that cohere may rest on each other.
const DEEPEST_REST: f64 = 0.02;

/// Where the particles start.
fn resolve_places(
    typed: &Typed<String>,
    folder: &Path,
    problems: &mut Problems<'_>,
) -> Option<Places> {
    let name = typed.value.as_str();
    match name {
        "random" => Some(Places::Random),
        "lattice" => Some(Places::Lattice),
        _ if name.ends_with(".csv") => {
            // Wherever the case is read from next, it is the same file.
            let path = folder.join(name);
            Some(Places::File(absolute(&path).unwrap_or(path)))
        }
        _ => {
            let hint = nearest(name, ["random", "lattice"])
                .map_or(String::new(), |near| format!("did you mean \"{near}\"? "));
            problems.refuse(
                typed,
                format!("{hint}\"random\", \"lattice\" or the name of a table (.csv) is accepted"),
            );
            None
        }
    }
}

/// The diameters, of which the powder's is the Sauter mean.
fn resolve_diameters(
    typed: &Typed<DiametersTyped>,
    powder: &Powder,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Diameters> {
    match &typed.value {
        DiametersTyped::LogNormal(deviation) => {
            if !(1.001..=1.5).contains(deviation) {
                problems.refuse(typed, "a geometric_deviation from 1.001 to 1.5 is accepted");
                return None;
            }
            Some(Diameters::LogNormal(*deviation))
        }
        DiametersTyped::Shares(typed_classes) => {
            let classes: Option<Vec<(f64, f64)>> = typed_classes
                .iter()
                .map(|(diameter, share)| Some((diameter.si(scales)?, *share)))
                .collect();
            let classes = classes?;
            let whole: f64 = classes.iter().map(|(_, share)| share).sum();
            let sauter = 1.0 / classes.iter().map(|(d, share)| share / d).sum::<f64>();
            let extreme = |of: fn(f64, f64) -> f64, from: f64| {
                classes.iter().fold(from, |extreme, (d, _)| of(extreme, *d))
            };
            let ratio = extreme(f64::max, 0.0) / extreme(f64::min, f64::INFINITY);
            let why = if classes.iter().any(|(d, share)| !(1e-7..=0.1).contains(d) || *share <= 0.0)
            {
                "diameters from 1e-7 m to 0.1 m and shares above 0 are accepted".to_owned()
            } else if (whole - 1.0).abs() > WHOLE {
                format!("the shares add up to {}, and 1 is accepted", significant(whole))
            } else if ratio > 10.0 {
                format!("the largest is {ratio:.1} times the smallest, and up to 10 is accepted")
            } else if (sauter / powder.diameter - 1.0).abs() > SAUTER {
                format!(
                    "their Sauter mean diameter is {} m: that is accepted as diameter in [powder], by which \
                     scales and closures go, within 1 %",
                    significant(sauter)
                )
            } else {
                return Some(Diameters::Shares(classes));
            };
            problems.refuse(typed, why);
            None
        }
    }
}

/// Places and diameters.
fn resolve_start(
    typed: &ParticlesFile,
    powder: &Powder,
    scales: Option<&Scales>,
    folder: &Path,
    problems: &mut Problems<'_>,
) -> Option<ParticlesStart> {
    let places = match &typed.start {
        None => Some(Places::Random),
        Some(typed) => resolve_places(typed, folder, problems),
    };
    let diameters = match &typed.diameters {
        None => Some(Diameters::Equal),
        Some(typed) => resolve_diameters(typed, powder, scales, problems),
    };
    if let (Some(Places::File(_)), Some(typed)) = (&places, &typed.diameters) {
        problems.refuse(typed, "the file of start lists the diameters: keep one of the two");
        return None;
    }
    Some(ParticlesStart { places: places?, diameters: diameters? })
}

fn resolve_particles(
    file: &CaseFile,
    powder: &Powder,
    domain: Option<&(Vec<f64>, Vec<usize>)>,
    scales: Option<&Scales>,
    folder: &Path,
    problems: &mut Problems<'_>,
) -> Option<ParticlesCase> {
    let typed = &file.particles;
    let start = resolve_start(typed, powder, scales, folder, problems);
    if let (Some(Places::File(_)), Some(fractions)) =
        (start.as_ref().map(|start| &start.places), &file.domain.solids_fraction)
        && fractions.value.len() > 1
    {
        problems
            .refuse(fractions, "one number is accepted where a file lists the particles of a box");
    }
    let largest = match start.as_ref().map(|start| &start.diameters) {
        Some(Diameters::Shares(classes)) => classes.iter().fold(0.0, |most, (d, _)| d.max(most)),
        _ => powder.diameter,
    };
    if let (Some((size, cells)), Some(solver)) = (domain, &file.physics.solver) {
        if size.len() != 3 {
            problems.refuse(solver, "particles are spheres: a box of three edges is needed");
        }
        let shortest = least(edges(size, cells));
        if shortest < SHORTEST_CELL * largest {
            problems.refuse(
                solver,
                format!(
                    "a cell has an edge of {shortest:.3e} m: the gas around particles of {:.3e} m is \
                     resolved by cells of {SHORTEST_CELL} d at least",
                    largest
                ),
            );
        }
    }
    let mut within = |typed: &Option<Typed<f64>>, [low, high]: [f64; 2], default: f64| match typed {
        None => Some(default),
        typed => accept(
            typed.as_ref(),
            |x| (low..=high).contains(&x),
            &format!("a number from {low} to {high}"),
            problems,
        ),
    };
    let overlap = within(&typed.overlap, [1e-4, 0.05], OVERLAP);
    let tangential_stiffness = within(&typed.tangential_stiffness, [0.0, 1.0], 2.0 / 7.0);
    let tangential_damping = within(&typed.tangential_damping, [0.0, 1.0], 0.5);
    let friction = within(&typed.friction_coefficient, [0.0, 10.0], 0.3);
    let steps_per_contact = within(&typed.steps_per_contact, [20.0, 1000.0], 25.0);
    let bond_number = within(&typed.cohesion, [0.0, 1e6], 0.0);
    let mass = PI / 6.0 * powder.density * powder.diameter.powi(3);
    let stiffness = match (&typed.stiffness, &typed.overlap) {
        (Some(stiffness), Some(_)) => {
            problems.refuse(stiffness, "overlap is given as well: keep one of the two");
            None
        }
        (Some(_), None) => accept(
            typed.stiffness.as_ref(),
            |k| k > 0.0 && k <= 1e9,
            "a number above 0 and at most 1e9 N/m",
            problems,
        ),
        (None, _) => scales.zip(overlap).map(|(scales, overlap)| {
            stiffness_for(
                overlap * powder.diameter,
                powder.restitution,
                0.5 * mass,
                scales.terminal_velocity,
            )
        }),
    };
    let cohesion = match (bond_number, scales) {
        (Some(bond), Some(scales)) => {
            Some(cohesion_of(bond, powder.diameter, mass, scales.gravity))
        }
        _ => None,
    };
    if let (Some(cohesion), Some(stiffness), Some(typed)) = (cohesion, stiffness, &typed.cohesion) {
        let force = pull(cohesion, [0.5 * powder.diameter; 2]);
        if force > DEEPEST_REST * stiffness * powder.diameter {
            problems.refuse(
                typed,
                format!(
                    "two particles would rest on each other {:.3} d deep, and up to {DEEPEST_REST} d is \
                     accepted: give stiffness = {} or more",
                    force / (stiffness * powder.diameter),
                    significant(force / (DEEPEST_REST * powder.diameter))
                ),
            );
        }
    }
    let mapping = typed.mapping.as_ref().map_or(MappingChoice::Trilinear, |typed| typed.value);
    // Standard deviation of the narrowest shares and that by default, and the shortest edge.
    let [bare, spread, shortest] = domain.map_or([0.0, 0.0, f64::INFINITY], |(size, cells)| {
        let bare = mapping.variance(least(edges(size, cells)), powder.diameter).sqrt();
        let spread = default_spread(powder.diameter, edges(size, cells));
        [bare, spread, least(size.iter().copied())]
    });
    let smoothing = match &typed.smoothing {
        None => {
            let width = spread.min(0.25 * shortest);
            Some(if width > bare { width } else { 0.0 })
        }
        Some(typed) => {
            let width = typed.value.si(scales)?;
            if width == 0.0 || (bare..=0.25 * shortest).contains(&width) {
                Some(width)
            } else {
                problems.refuse(
                    typed,
                    format!(
                        "0 or a length up to a quarter of the shortest edge is accepted, no less than the \
                         {bare:.2e} m to which the cells alone spread a particle"
                    ),
                );
                None
            }
        }
    };
    Some(ParticlesCase {
        contact: Contact {
            stiffness: stiffness?,
            restitution: powder.restitution,
            tangential_stiffness: tangential_stiffness?,
            tangential_damping: tangential_damping?,
            friction: friction?,
            cohesion: cohesion?,
        },
        steps_per_contact: steps_per_contact?,
        mapping,
        smoothing: smoothing?,
        start: start?,
        mixture: typed
            .mixture_drag
            .as_ref()
            .map_or(MixtureChoice::OwnDiameter, |typed| typed.value),
        bond_number: bond_number?,
    })
}

fn resolve_drive(
    file: &CaseFile,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Drive> {
    let choice = file.physics.drive.as_ref().map(|typed| typed.value);
    let Some(typed) = &file.physics.gas_flux else {
        return Some(match choice {
            Some(DriveChoice::GasFlux) => Drive::GasFlux(None),
            _ => Drive::PressureGradient,
        });
    };
    if choice != Some(DriveChoice::GasFlux) {
        problems.refuse(
            typed,
            "it is kept only with drive = \"gas-flux\": give that too, or leave this out",
        );
        return None;
    }
    let scales = scales?;
    let u_t = scales.terminal_velocity;
    let flux = typed.value.si(Some(scales))?;
    if !(1e-3 * u_t..=1e3 * u_t).contains(&flux) {
        problems.refuse(
            typed,
            format!("from 0.001 u_t to 1000 u_t is accepted, upwards (u_t is {u_t:.4} m/s)"),
        );
        return None;
    }
    Some(Drive::GasFlux(Some(flux)))
}

fn resolve_terms(file: &CaseFile) -> Terms {
    let (typed, default) = (&file.physics, Terms::default());
    let value = |typed: &Option<Typed<bool>>, default| typed.as_ref().map_or(default, |t| t.value);
    Terms {
        granular_energy: typed
            .granular_energy
            .as_ref()
            .map_or(default.granular_energy, |typed| typed.value),
        gas_inertia: value(&typed.gas_inertia, default.gas_inertia),
        gas_stress: value(&typed.gas_stress, default.gas_stress),
    }
}

fn resolve_powder(file: &CaseFile, problems: &mut Problems<'_>) -> Option<Powder> {
    let typed = &file.powder;
    let diameter = typed.diameter.as_ref().and_then(|typed| {
        let metres = typed.value.si(None).filter(|d| (1e-7..=0.1).contains(d));
        if metres.is_none() {
            problems.refuse(
                typed,
                "a diameter from 1e-7 to 0.1 is accepted, in metres, or text such as \"75 um\"",
            );
        }
        metres
    });
    let density = accept(
        typed.density.as_ref(),
        |rho| POWDER_DENSITY.contains(&rho),
        "the density of one particle, from 1 to 30000 kg/m³,",
        problems,
    );
    let restitution = accept(
        typed.restitution.as_ref(),
        |e| e > 0.0 && e <= 1.0,
        "a number above 0 and at most 1",
        problems,
    );
    let max_packing = accept(
        typed.max_packing.as_ref(),
        |phi| phi > 0.0 && phi <= 0.74,
        "a number above 0 and at most 0.74, the densest packing of equal spheres,",
        problems,
    );
    Some(Powder {
        diameter: diameter?,
        density: density?,
        restitution: restitution?,
        max_packing: max_packing?,
    })
}

fn resolve_gas(file: &CaseFile, problems: &mut Problems<'_>) -> Option<Gas> {
    let density = accept(
        file.gas.density.as_ref(),
        |rho| (1e-6..=2e3).contains(&rho),
        "a number from 1e-6 to 2000 kg/m³",
        problems,
    );
    let viscosity = accept(
        file.gas.viscosity.as_ref(),
        |mu| (1e-8..=1.0).contains(&mu),
        "a number from 1e-8 to 1 Pa·s (air: 1.8e-5)",
        problems,
    );
    if let (Some(gas), Some(powder)) = (&file.gas.density, &file.powder.density)
        && density.is_some()
        && POWDER_DENSITY.contains(&powder.value)
        && gas.value >= powder.value
    {
        problems.refuse(
            gas,
            format!("a gas lighter than the powder, below {} kg/m³, is accepted", powder.value),
        );
        return None;
    }
    Some(Gas { density: density?, viscosity: viscosity? })
}

/// Edge lengths and cells along each.
fn resolve_domain(
    file: &DomainFile,
    scales: Option<&Scales>,
    diameter: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<(Vec<f64>, Vec<usize>)> {
    let size = file.size.as_ref().and_then(|typed| resolve_size(typed, scales, problems));
    let axes = size.as_ref().map(Vec::len);
    let cells = match (&file.cells, &file.cell) {
        (Some(_), Some(cell)) => {
            problems.refuse(cell, "cells is given as well: keep one of the two");
            None
        }
        (Some(cells), None) => resolve_cells(cells, axes, problems),
        (None, Some(cell)) => resolve_cell(cell, file, size.as_deref(), scales, problems),
        (None, None) => None,
    };
    let (size, cells) = (size?, cells?);
    if let Some(diameter) = diameter {
        for (axis, (size, cells)) in size.iter().zip(&cells).enumerate() {
            let spacing = size / *cells as f64;
            if spacing < diameter * (1.0 - WHOLE) {
                let typed = file.size.as_ref()?.value.get(axis)?;
                problems.refuse(
                    typed,
                    format!(
                        "a cell would be {spacing:.3e} m long, less than one particle of \
                         {diameter:.3e} m, and a continuum of particles has no meaning there: \
                         sizes are in metres; with {cells} cells accepted is from {:.3e} m",
                        diameter * *cells as f64
                    ),
                );
                return None;
            }
        }
    }
    Some((size, cells))
}

fn resolve_size(
    typed: &Typed<Vec<Typed<Quantity>>>,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    if !(2..=3).contains(&typed.value.len()) {
        problems.refuse(
            typed,
            format!(
                "{} given; two edges (2-D) or three (3-D) are accepted, the last one vertical",
                plural(typed.value.len(), "edge")
            ),
        );
        return None;
    }
    let mut size = Vec::with_capacity(3);
    let mut complete = true;
    for edge in &typed.value {
        match edge.value.si(scales) {
            Some(metres) if metres > 0.0 && metres <= 1e9 => size.push(metres),
            Some(_) => {
                problems.refuse(edge, "a length above 0 and at most 1e9 m is accepted");
                complete = false;
            }
            None => complete = false,
        }
    }
    complete.then_some(size)
}

fn resolve_cells(
    typed: &Typed<Vec<Typed<u64>>>,
    axes: Option<usize>,
    problems: &mut Problems<'_>,
) -> Option<Vec<usize>> {
    if let Some(axes) = axes
        && typed.value.len() != axes
    {
        problems.refuse(
            typed,
            format!(
                "{} given and size has {}: one number for each edge is accepted",
                plural(typed.value.len(), "number"),
                plural(axes, "edge")
            ),
        );
        return None;
    }
    let mut sound = true;
    for count in &typed.value {
        if count.value < FEWEST_CELLS || count.value % 2 == 1 {
            problems.refuse(count, format!("an even number from {FEWEST_CELLS} is accepted"));
            sound = false;
        }
    }
    let product = typed.value.iter().try_fold(1u64, |product, n| product.checked_mul(n.value));
    if sound && product.is_none_or(|product| product > MOST_CELLS) {
        problems.refuse(typed, format!("at most {MOST_CELLS} cells in all are accepted"));
        sound = false;
    }
    sound.then(|| typed.value.iter().map(|count| count.value as usize).collect())
}

/// Cells along each edge from the edge of one cell.
fn resolve_cell(
    typed: &Typed<Quantity>,
    file: &DomainFile,
    size: Option<&[f64]>,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<usize>> {
    let edge = typed.value.si(scales)?;
    if edge <= 0.0 {
        problems.refuse(typed, "a length above 0 is accepted");
        return None;
    }
    let (size, typed_size) = (size?, file.size.as_ref()?);
    let mut cells = Vec::with_capacity(3);
    let mut sound = true;
    let fewest = FEWEST_CELLS as f64;
    for (length, typed) in size.iter().zip(&typed_size.value) {
        let ratio = length / edge;
        let whole = ratio.round();
        if (ratio - whole).abs() > WHOLE * whole || whole % 2.0 != 0.0 || whole < fewest {
            let below = (2.0 * (0.5 * ratio).floor()).max(fewest);
            let above = if below > ratio { below } else { below + 2.0 };
            let choice = if above > below {
                format!("{} m or {} m", significant(below * edge), significant(above * edge))
            } else {
                format!("{} m", significant(above * edge))
            };
            problems.refuse(
                typed,
                format!(
                    "this edge has {} cells of {} m and an even whole number of at least \
                     {FEWEST_CELLS} is needed: accepted nearest are {choice}, or another cell",
                    significant(ratio),
                    significant(edge)
                ),
            );
            sound = false;
        }
        cells.push(whole);
    }
    if sound && cells.iter().product::<f64>() > MOST_CELLS as f64 {
        problems.refuse(typed, format!("at most {MOST_CELLS} cells in all are accepted"));
        sound = false;
    }
    sound.then(|| cells.into_iter().map(|count| count as usize).collect())
}

fn resolve_fractions(
    file: &DomainFile,
    max_packing: Option<f64>,
    perturbation: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    let typed = &file.solids_fraction.as_ref()?.value;
    let highest = max_packing.unwrap_or(0.74);
    let mut sound = true;
    for (n, fraction) in typed.iter().enumerate() {
        let phi = fraction.value;
        let why = if phi <= 0.0 || phi >= highest {
            format!("a number above 0 and below max_packing = {highest} is accepted")
        } else if typed[..n].iter().any(|earlier| earlier.value == phi) {
            "given twice: each solids fraction is accepted once, one box is simulated for it"
                .to_owned()
        } else if perturbation.is_some_and(|p| phi * (1.0 + p) >= highest) {
            let p = perturbation.unwrap_or_default();
            format!(
                "with the perturbation of {p} it passes max_packing = {highest}: below {} is \
                 accepted, or a smaller perturbation in [run]",
                significant(highest / (1.0 + p))
            )
        } else {
            continue;
        };
        problems.refuse(fraction, why);
        sound = false;
    }
    sound.then(|| typed.iter().map(|fraction| fraction.value).collect())
}

fn resolve_filter(
    file: &FilterFile,
    domain: Option<&(Vec<f64>, Vec<usize>)>,
    scales: Option<&Scales>,
    max_packing: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<FilterCase> {
    let widths = domain.and_then(|(size, cells)| {
        let possible = PossibleWidths::new(size, cells);
        match &file.widths {
            Some(typed) => resolve_widths(typed, &possible, scales, problems),
            None => default_widths(&possible, problems),
        }
    });
    let markers = match &file.markers {
        None => Some(vec![MarkerChoice::SolidsFraction]),
        Some(typed) => resolve_markers(typed, problems),
    };
    let solids_fraction_bin = match &file.solids_fraction_bin {
        None => Some(0.02),
        typed => {
            let highest = max_packing.unwrap_or(0.74);
            accept(
                typed.as_ref(),
                |bin| (1e-4..=highest).contains(&bin),
                &format!("a number from 1e-4 to max_packing = {highest}"),
                problems,
            )
        }
    };
    let slip_bin = match &file.slip_bin {
        None => Some(0.25),
        Some(typed) => {
            let scaled = match typed.value {
                Quantity { number, unit: Unit::TerminalVelocity } => Some(number),
                other => scales.and_then(|scales| {
                    other.si(None).map(|velocity| velocity / scales.terminal_velocity)
                }),
            };
            if scaled.is_some_and(|scaled| !(1e-3..=10.0).contains(&scaled)) {
                let u_t = scales.map_or(String::new(), |scales| {
                    format!(" (u_t is {:.4} m/s)", scales.terminal_velocity)
                });
                problems.refuse(typed, format!("from 0.001 u_t to 10 u_t is accepted{u_t}"));
                None
            } else {
                scaled
            }
        }
    };
    let markers = markers?;
    for (marker, edges) in &file.edges {
        if !markers.contains(marker) {
            let name = quoted(marker);
            problems.refuse(
                edges,
                format!("{name} is no marker: add it to markers, or leave this out"),
            );
        }
    }
    let (solids_fraction_bin, slip_bin) = (solids_fraction_bin?, slip_bin?);
    let bins = |marker: &MarkerChoice| {
        let given =
            file.edges.iter().find(|(other, _)| other == marker).map(|(_, typed)| &typed.value);
        match (given, marker) {
            (Some(EdgesChoice::Given(edges)), _) => edges.len() as f64 - 1.0,
            (None, MarkerChoice::SolidsFraction) => {
                max_packing.unwrap_or(1.0) / solids_fraction_bin
            }
            (None, MarkerChoice::Slip) => SLIP_BINS_SPAN / slip_bin + 2.0,
            _ => FINEST_QUANTILE_BINS,
        }
    };
    let all: f64 = markers.iter().map(bins).product();
    if let (true, Some(typed)) = (all > MOST_BINS, &file.markers) {
        let of_each: Vec<String> = markers
            .iter()
            .map(|marker| format!("{:.0} of {}", bins(marker).ceil(), quoted(marker)))
            .collect();
        problems.refuse(
            typed,
            format!(
                "they make {} bins together, {all:.0}: at most {MOST_BINS:.0} are accepted; give fewer \
                 edges, wider bins or fewer markers",
                of_each.join(" times ")
            ),
        );
    }
    Some(FilterCase {
        widths: widths?,
        kernel: file.kernel.as_ref().map_or(KernelChoice::Box, |typed| typed.value),
        edges: file.edges.iter().map(|(marker, edges)| (*marker, edges.value.clone())).collect(),
        markers,
        solids_fraction_bin,
        slip_bin,
    })
}

/// Most bins: more would take memory for each of them, and hold next to nothing.
const MOST_BINS: f64 = 1e6;

/// Slips that bins of equal width cover \[u_t\].
const SLIP_BINS_SPAN: f64 = 8.0;

/// Bins that quantiles are made of.
const FINEST_QUANTILE_BINS: f64 = 50.0;

/// Most markers at a time: bins of more would hold next to nothing.
const MOST_MARKERS: usize = 3;

fn resolve_markers(
    typed: &Typed<Vec<Typed<MarkerChoice>>>,
    problems: &mut Problems<'_>,
) -> Option<Vec<MarkerChoice>> {
    let mut markers: Vec<_> = typed.value.iter().map(|marker| marker.value).collect();
    for (n, marker) in typed.value.iter().enumerate() {
        if markers[..n].contains(&marker.value) {
            problems.refuse(marker, "given twice: each marker is accepted once");
            return None;
        }
    }
    if markers.len() > MOST_MARKERS {
        problems.refuse(typed, "at most three markers are accepted at a time");
        return None;
    }
    let Some(place) = markers.iter().position(|marker| *marker == MarkerChoice::SolidsFraction)
    else {
        problems.refuse(
            typed,
            "\"solids_fraction\" is always a marker: [\"solids_fraction\", \"slip\"] is accepted",
        );
        return None;
    };
    markers.swap(0, place);
    Some(markers)
}

/// The widths that are a whole number of cells along every axis, from two cells to half the box.
struct PossibleWidths {
    /// Edge of a cell along each axis \[m\].
    spacing: Vec<f64>,
    /// The widths \[m\], ascending.
    widths: Vec<f64>,
}

impl PossibleWidths {
    fn new(size: &[f64], cells: &[usize]) -> Self {
        let spacing: Vec<f64> = edges(size, cells).collect();
        // Candidates are multiples of the cell along the axis with the fewest cells: any axis
        // would do, and this one keeps the list short in long boxes.
        let axis = (0..cells.len()).min_by_key(|axis| cells[*axis]).unwrap_or(0);
        let (first, half) = (spacing[axis], cells[axis] / 2);
        let whole = |width: f64| {
            spacing.iter().zip(cells).all(|(spacing, cells)| {
                let count = (width / spacing).round();
                (width / spacing - count).abs() <= WHOLE * count
                    && count >= 2.0
                    && count <= (cells / 2) as f64
            })
        };
        let widths = (2..=half).map(|n| n as f64 * first).filter(|width| whole(*width)).collect();
        Self { spacing, widths }
    }

    /// The possible width that equals `width` within round-off.
    fn find(&self, width: f64) -> Option<f64> {
        self.widths.iter().copied().find(|possible| (width / possible - 1.0).abs() <= WHOLE)
    }

    /// What is accepted near `width`, in words.
    fn near(&self, width: f64) -> String {
        let place = self.widths.partition_point(|possible| *possible < width);
        let mut near = Vec::new();
        near.extend(place.checked_sub(1).map(|below| self.widths[below]));
        near.extend(self.widths.get(place));
        let near: Vec<_> =
            near.into_iter().map(|width| format!("{} m", significant(width))).collect();
        if near.is_empty() {
            format!(
                "no width is a whole number of cells ({} m) along every axis, from two cells to \
                 half the box: choose size and cells so that cells are equal along all axes",
                self.cell()
            )
        } else {
            format!("accepted nearest: {}", near.join(", "))
        }
    }

    /// Edges of a cell, in words.
    fn cell(&self) -> String {
        let edges: Vec<_> = self.spacing.iter().map(|edge| significant(*edge)).collect();
        edges.join(" x ")
    }
}

fn resolve_widths(
    typed: &Typed<Vec<Typed<Quantity>>>,
    possible: &PossibleWidths,
    scales: Option<&Scales>,
    problems: &mut Problems<'_>,
) -> Option<Vec<f64>> {
    if possible.widths.is_empty() {
        problems.refuse(typed, possible.near(0.0));
        return None;
    }
    let mut widths: Vec<f64> = Vec::with_capacity(typed.value.len());
    let mut sound = true;
    for quantity in &typed.value {
        let width = quantity.value.si(scales)?;
        match possible.find(width) {
            Some(found) if widths.contains(&found) => {
                problems.refuse(quantity, "given twice: each filter width is accepted once");
                sound = false;
            }
            Some(found) => widths.push(found),
            None => {
                problems.refuse(
                    quantity,
                    format!(
                        "a width is a whole number of cells ({} m) along every axis, from two \
                         cells to half the box; {}",
                        possible.cell(),
                        possible.near(width)
                    ),
                );
                sound = false;
            }
        }
    }
    widths.sort_by(f64::total_cmp);
    sound.then_some(widths)
}

/// 4, 8, 16 and 32 of the longest cell edge, as far as they are possible.
fn default_widths(possible: &PossibleWidths, problems: &mut Problems<'_>) -> Option<Vec<f64>> {
    let edge = possible.spacing.iter().copied().fold(0.0, f64::max);
    let widths: Vec<_> =
        [4.0, 8.0, 16.0, 32.0].into_iter().filter_map(|n| possible.find(n * edge)).collect();
    if widths.is_empty() {
        let why = format!(
            "missing, and none of the defaults (4, 8, 16, 32 cells of {} m) fits along every axis; {}",
            possible.cell(),
            possible.near(4.0 * edge)
        );
        problems.missing("[filter] widths".to_owned(), None, why);
        return None;
    }
    Some(widths)
}

fn resolve_run(
    file: &RunFile,
    scales: Option<&Scales>,
    perturbation: Option<f64>,
    problems: &mut Problems<'_>,
) -> Option<RunCase> {
    let mut time = |typed: &Option<Typed<Quantity>>, default: f64| match typed {
        None => scales.map(|scales| default * scales.time()),
        Some(typed) => {
            let seconds = typed.value.si(scales)?;
            if !is_time(seconds) {
                problems.refuse(typed, TIME_EXPECTED);
                return None;
            }
            Some(seconds)
        }
    };
    let duration = time(&file.duration, 200.0);
    let longest = duration.map(|duration| duration / FEWEST_SAMPLES);
    let sample_interval = time(&file.sample_interval, 0.5);
    let sample_interval = match (&file.sample_interval, sample_interval, longest) {
        (Some(typed), Some(interval), Some(longest)) if interval > longest * (1.0 + WHOLE) => {
            problems.refuse(
                typed,
                format!(
                    "a run must be {FEWEST_SAMPLES} sample intervals long: with this duration at \
                     most {} s is accepted",
                    significant(longest)
                ),
            );
            None
        }
        (None, Some(interval), Some(longest)) => Some(interval.min(longest)),
        (_, interval, _) => interval,
    };
    let time_order = match &file.time_order {
        Some(typed) if !(1..=2).contains(&typed.value) => {
            problems.refuse(typed, "expected 1 or 2");
            None
        }
        typed => Some(typed.as_ref().map_or(1, |typed| typed.value)),
    };
    Some(RunCase {
        duration: duration?,
        sample_interval: sample_interval?,
        seed: file.seed.as_ref().map_or(1, |typed| typed.value),
        perturbation: perturbation?,
        precision: file.precision.as_ref().map_or(Precision::Double, |typed| typed.value),
        time_order: time_order?,
    })
}

/// Which fields are kept, and how often: at every sample or every so many.
fn resolve_output(
    file: &OutputFile,
    scales: Option<&Scales>,
    run: Option<&RunCase>,
    problems: &mut Problems<'_>,
) -> Option<OutputCase> {
    let fields = file.fields.as_ref().map_or(FieldsChoice::None, |typed| typed.value);
    let sample = run?.sample_interval;
    let Some(typed) = &file.fields_interval else {
        return Some(OutputCase { fields, fields_interval: sample });
    };
    let interval = typed.value.si(scales)?;
    let count = (interval / sample).round();
    if !is_time(interval) || count < 1.0 || (interval / sample - count).abs() > WHOLE * count {
        problems.refuse(
            typed,
            format!(
                "fields are kept when they are sampled: a whole multiple of sample_interval = {} s \
                 is accepted",
                significant(sample)
            ),
        );
        return None;
    }
    Some(OutputCase { fields, fields_interval: count * sample })
}

/// A number in a message: six significant digits, without trailing zeros.
fn significant(x: f64) -> String {
    let rounded: f64 = format!("{x:.5e}").parse().unwrap_or(x);
    if (1e-4..1e6).contains(&rounded.abs()) { format!("{rounded}") } else { format!("{rounded:e}") }
}

/// `1 edge`, `2 edges`.
fn plural(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}
