//! [`measure`]: how fast the kernels are on this machine.

use std::fmt;
use std::hint::black_box;
use std::time::Instant;

use crate::laws::drag::{DragLaw, WenYu};
use crate::laws::scales::{Gas, Powder};

/// Times measured.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Report {
    /// One evaluation of the drag law in double precision \[ns\], best of several rounds.
    pub drag_law_ns: f64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "drag law, f64: {:.2} ns per evaluation", self.drag_law_ns)
    }
}

/// Measures; `quick` with a tenth of the rounds.
pub fn measure(quick: bool) -> Report {
    let gas = Gas { density: 1.3, viscosity: 1.8e-5 };
    let powder = Powder { diameter: 75e-6, density: 1500.0, restitution: 0.9, max_packing: 0.65 };
    let law = WenYu::<f64>::new(&gas, &powder);
    let fractions: Vec<f64> = (0..4096).map(|n| 0.6 * f64::from(n) / 4096.0).collect();
    let mut beta = vec![0.0; fractions.len()];
    let mut best = f64::INFINITY;
    for _ in 0..if quick { 20 } else { 200 } {
        let start = Instant::now();
        for (beta, phi) in beta.iter_mut().zip(&fractions) {
            *beta = law.beta(*phi, 0.2);
        }
        black_box(&mut beta);
        best = best.min(start.elapsed().as_secs_f64());
    }
    Report { drag_law_ns: 1e9 * best / fractions.len() as f64 }
}
