//! Cases that break solvers: very dilute, dense, elastic, dissipative, fine, coarse, odd boxes,
//! a slab in vacuum. They must run, stay positive and keep below the densest packing.

use favre::case::{DragChoice, FrictionChoice, RadialDistributionChoice, Terms};
use favre::grid::Grid;
use favre::laws::scales::{Gas, Powder};
use favre::two_fluid::{Setup, TwoFluid};

/// One hard case: what differs from the founding paper's powder at mean fraction 0.15.
#[derive(Clone, Copy)]
struct Hard {
    name: &'static str,
    solids_fraction: f64,
    diameter: f64,
    restitution: f64,
    cells: [usize; 2],
    /// Cell edges \[m\].
    spacing: [f64; 2],
    perturbation: f64,
}

const BASE: Hard = Hard {
    name: "base",
    solids_fraction: 0.15,
    diameter: 75e-6,
    restitution: 0.9,
    cells: [32, 32],
    spacing: [1.25e-3, 1.25e-3],
    perturbation: 0.1,
};

const CASES: [Hard; 12] = [
    BASE,
    Hard { name: "very dilute", solids_fraction: 0.005, ..BASE },
    Hard { name: "dense", solids_fraction: 0.55, ..BASE },
    Hard { name: "near packing", solids_fraction: 0.6, perturbation: 0.05, ..BASE },
    Hard { name: "dissipative", restitution: 0.6, ..BASE },
    Hard { name: "nearly elastic", restitution: 0.99, ..BASE },
    Hard { name: "elastic", restitution: 1.0, ..BASE },
    Hard { name: "fine powder", diameter: 30e-6, spacing: [0.3e-3, 0.3e-3], ..BASE },
    Hard { name: "coarse powder", diameter: 300e-6, spacing: [5e-3, 5e-3], ..BASE },
    Hard { name: "flat cells", spacing: [2.5e-3, 0.8e-3], ..BASE },
    Hard { name: "odd box", cells: [26, 50], ..BASE },
    Hard { name: "strong start", perturbation: 0.5, ..BASE },
];

fn flow(hard: &Hard) -> TwoFluid<f64, 2> {
    let setup = Setup {
        powder: Powder {
            diameter: hard.diameter,
            density: 1500.0,
            restitution: hard.restitution,
            max_packing: 0.65,
        },
        gas: Gas { density: 1.3, viscosity: 1.8e-5 },
        gravity: 9.81,
        drag: DragChoice::WenYu,
        radial_distribution: RadialDistributionChoice::Princeton,
        friction: FrictionChoice::Barrier,
        terms: Terms::default(),
        solids_fraction: hard.solids_fraction,
        perturbation: hard.perturbation,
        seed: 5,
        parallel: false,
    };
    let size = std::array::from_fn(|axis| hard.spacing[axis] * hard.cells[axis] as f64);
    TwoFluid::new(Grid::new(size, hard.cells), setup)
}

#[test]
fn hard_cases_run_and_stay_in_bounds() {
    for hard in &CASES {
        let mut flow = flow(hard);
        let start = flow.means();
        for step in 0..2000 {
            flow.step(f64::INFINITY).unwrap_or_else(|error| panic!("{}: {error}", hard.name));
            let (low, high) = (flow.solids_fraction().min(), flow.solids_fraction().max());
            assert!(low >= 0.0, "{}: φ = {low} at step {step}", hard.name);
            assert!(high < 0.665, "{}: φ = {high} at step {step}", hard.name);
        }
        let end = flow.means();
        assert!((end.solids_fraction / start.solids_fraction - 1.0).abs() < 1e-12, "{}", hard.name);
        println!(
            "{}: t = {:.3} s, slip {:.3} m/s, variance of φ {:.4}",
            hard.name,
            flow.time(),
            end.slip,
            end.solids_fraction_variance
        );
    }
}
