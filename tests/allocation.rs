//! A step allocates nothing.

mod common;

use common::{GAS, POWDER};
use favre::case::{
    DragChoice, Drive, FrictionChoice, MappingChoice, MixtureChoice, RadialDistributionChoice,
    Terms,
};
use favre::cfd_dem::{self, CfdDem};
use favre::dem::{Dem, SKIN, Setup, lattice, packed, thermal};
use favre::grid::Grid;
use favre::laws::contact::Contact;
use favre::two_fluid::{self, TwoFluid};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    /// Allocations of this thread: the harness's own thread may allocate while a test runs.
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: forwards to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations_of_steps<const D: usize>(cells: [usize; D]) -> usize {
    let setup = two_fluid::Setup {
        powder: POWDER,
        gas: GAS,
        gravity: 9.81,
        drag: DragChoice::WenYu,
        radial_distribution: RadialDistributionChoice::Princeton,
        friction: FrictionChoice::Barrier,
        terms: Terms::default(),
        solids_fraction: 0.15,
        perturbation: 0.1,
        seed: 3,
        parallel: false,
    };
    let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
    let mut flow = TwoFluid::<f64, D>::new(grid, setup);
    flow.step(f64::INFINITY).unwrap();
    let before = ALLOCATIONS.get();
    for _ in 0..50 {
        flow.step(f64::INFINITY).unwrap();
    }
    ALLOCATIONS.get() - before
}

/// Steps of spheres in touch, with rebuilds of their pairs among them.
fn allocations_of_spheres() -> usize {
    let contact = Contact {
        stiffness: 14.0,
        restitution: 1.0,
        tangential_stiffness: 2.0 / 7.0,
        tangential_damping: 0.5,
        friction: 0.3,
        cohesion: 0.0,
    };
    let size = [1.2e-3; 3];
    let mut spheres = packed(size, &[75e-6; 2500], 1500.0, 1, false).unwrap();
    thermal(&mut spheres, 0.01, 1);
    let setup = Setup { size, contact, steps_per_contact: 50.0, skin: SKIN, parallel: false };
    let mut dem = Dem::new(setup, &spheres).unwrap();
    dem.run(5000).unwrap();
    let (before, rebuilds) = (ALLOCATIONS.get(), dem.rebuilds());
    dem.run(500).unwrap();
    assert!(dem.rebuilds() > rebuilds + 2);
    ALLOCATIONS.get() - before
}

/// Steps of spheres in gas, spread over cells as far as it goes.
fn allocations_of_spheres_in_gas() -> usize {
    let setup = cfd_dem::Setup {
        powder: POWDER,
        gas: GAS,
        gravity: 9.81,
        drag: DragChoice::WenYu,
        mixture: MixtureChoice::OwnDiameter,
        gas_inertia: true,
        gas_stress: true,
        drive: Drive::GasFlux(None),
        solids_fraction: 0.1,
        contact: Contact {
            stiffness: 3.0,
            restitution: 0.9,
            tangential_stiffness: 2.0 / 7.0,
            tangential_damping: 0.5,
            friction: 0.3,
            cohesion: 0.0,
        },
        steps_per_contact: 25.0,
        mapping: MappingChoice::Divided,
        smoothing: 1.5e-4,
        rhythm: 1e-3,
        seed: 1,
        parallel: false,
    };
    let grid = Grid::new([2e-3, 2e-3, 4e-3], [8, 8, 16]);
    // Falling side by side: lists of pairs, which grow as clusters do, stay as long as they are.
    let spheres = lattice(grid.size(), [16, 16, 32], POWDER.diameter, POWDER.density).unwrap();
    let mut flow = CfdDem::with_spheres(grid, setup, &spheres).unwrap();
    flow.step(f64::INFINITY).unwrap();
    let before = ALLOCATIONS.get();
    for _ in 0..20 {
        flow.step(f64::INFINITY).unwrap();
    }
    ALLOCATIONS.get() - before
}

#[test]
fn a_step_allocates_nothing() {
    assert_eq!(allocations_of_spheres_in_gas(), 0, "spheres in gas");
    assert_eq!(allocations_of_spheres(), 0, "spheres");
    assert_eq!(allocations_of_steps([32, 32]), 0, "2-D");
    assert_eq!(allocations_of_steps([8, 8, 16]), 0, "3-D");
    // The count works: building a solver allocates.
    let before = ALLOCATIONS.get();
    let _ = std::hint::black_box(vec![0u8; 100]);
    assert!(ALLOCATIONS.get() > before);
}
