//! What the two-fluid model must keep to round-off, over ten thousand steps.

mod common;

use common::{GAS, POWDER};
use favre::case::{DragChoice, FrictionChoice, RadialDistributionChoice, Terms};
use favre::grid::Grid;
use favre::two_fluid::{Setup, TwoFluid};

fn setup(solids_fraction: f64) -> Setup {
    Setup {
        powder: POWDER,
        gas: GAS,
        gravity: 9.81,
        drag: DragChoice::WenYu,
        radial_distribution: RadialDistributionChoice::Princeton,
        friction: FrictionChoice::Barrier,
        terms: Terms::default(),
        solids_fraction,
        perturbation: 0.1,
        seed: 3,
        parallel: false,
    }
}

fn keeps_mass_and_momentum<const D: usize>(cells: [usize; D], steps: usize) {
    let grid = Grid::new(cells.map(|n| 1.25e-3 * n as f64), cells);
    let mut flow = TwoFluid::<f64, D>::new(grid, setup(0.15));
    let start = flow.means();
    // What the momentum of the mixture would be at the scale of its velocities.
    let scale = 1500.0 * 0.15 * 0.22;
    for step in 0..steps {
        let report = flow.step(f64::INFINITY).unwrap();
        assert!(report.volume_residual <= 1e-3, "step {step}: {}", report.volume_residual);
        assert!(flow.solids_fraction().min() >= 0.0, "step {step}: negative solids fraction");
        assert!(flow.granular_temperature().min() >= 0.0, "step {step}: negative temperature");
    }
    let end = flow.means();
    let mass = end.solids_fraction / start.solids_fraction - 1.0;
    assert!(mass.abs() < 1e-13, "solids mass changed by {mass:e}");
    for axis in 0..D {
        let drift = (end.momentum[axis] - start.momentum[axis]).abs() / scale;
        assert!(drift < 1e-11, "momentum along {axis} drifted by {drift:e} of its scale");
    }
    println!("mass {mass:e}, momentum {:?} of {scale}", end.momentum);
    // The bed has clustered, so the test was not of a state at rest.
    assert!(end.solids_fraction_variance > 1e-3);
}

#[test]
fn mass_and_momentum_are_kept_over_ten_thousand_steps_in_two_dimensions() {
    keeps_mass_and_momentum([32, 32], 10_000);
}

#[test]
fn mass_and_momentum_are_kept_over_ten_thousand_steps_in_three_dimensions() {
    keeps_mass_and_momentum([12, 12, 16], 10_000);
}

#[test]
fn single_precision_reaches_the_same_kind_of_state() {
    let grid = Grid::new([0.04, 0.04], [32, 32]);
    let mut flow = TwoFluid::<f32, 2>::new(grid, setup(0.15));
    while flow.time() < 1.0 {
        flow.step(f64::INFINITY).unwrap();
    }
    let means = flow.means();
    assert!((means.solids_fraction / 0.15 - 1.0).abs() < 1e-5, "{}", means.solids_fraction);
    assert!(means.solids_fraction_variance > 5e-3, "{}", means.solids_fraction_variance);
    assert!(means.momentum[1].abs() < 1e-2 * 1500.0 * 0.15 * 0.22, "{:?}", means.momentum);
}
