//! [`terms`]: which terms of the equations a case models, and why.

use crate::case::{Case, Diameters, FrictionChoice, GranularEnergyChoice, Places, with_friction};
use crate::laws::friction::Friction;
use serde::Serialize;
use std::f64::consts::PI;
use std::fmt;

/// A term of the equations.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Term {
    /// Its name.
    pub name: &'static str,
    /// Whether it is modelled; what is not costs nothing.
    pub on: bool,
    /// What speaks for it or against it, with the number that it hangs on.
    pub why: String,
}

impl fmt::Display for Term {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}: {}", self.name, if self.on { "on" } else { "off" }, self.why)
    }
}

/// The terms that are a matter of choice, in the order of the case file's keys.
pub fn terms(case: &Case) -> Vec<Term> {
    let Case { powder, gas, physics, domain, .. } = case;
    let scales = case.scales();
    let chosen = physics.terms;
    let fractions = &domain.solids_fractions;
    let least = fractions.iter().copied().fold(1.0, f64::min);
    let most = fractions.iter().copied().fold(0.0, f64::max);

    let onset = friction_onset(case);
    let reached = match onset {
        None => "no fraction is too dense for it".to_owned(),
        Some(onset) if most < onset => {
            format!("acts above φ = {onset:.3}, which clusters of ⟨φ⟩ = {most} may reach")
        }
        Some(onset) => format!("acts above φ = {onset:.3}, and ⟨φ⟩ = {most} does"),
    };
    let viscous =
        with_friction!(physics.friction, f64, powder, scales.terminal_velocity, |friction| {
            is_viscous(&friction)
        });
    // Stokes's drag on a sphere: its fluctuations lose their energy at 3 K/ρ_s, K = 18 μ_g/d².
    let memory = powder.density * powder.diameter.powi(2) / (54.0 * gas.viscosity);
    let transported = chosen.granular_energy == GranularEnergyChoice::Transport;
    let inertia = gas.density * (1.0 - least) / (powder.density * least);
    let diffusion = gas.viscosity / (gas.density * scales.terminal_velocity * scales.length_i());
    let of_the_gas = [
        Term {
            name: "gas inertia",
            on: chosen.gas_inertia,
            why: format!("ρ_g (1-φ)/(ρ_s φ) = {inertia:.1e} at ⟨φ⟩ = {least}"),
        },
        Term {
            name: "gas stress",
            on: chosen.gas_stress,
            why: format!("μ_g/(ρ_g u_t L_I) = {diffusion:.1e}"),
        },
    ];
    if let Some(particles) = &case.particles {
        let friction = particles.contact.friction;
        let contacts = Term {
            name: "friction of particles",
            on: friction > 0.0,
            why: format!("the coefficient is {friction}"),
        };
        let bond = particles.bond_number;
        let pull = Term {
            name: "cohesion of particles",
            on: bond > 0.0,
            why: format!("the force that parts two is {bond} times the weight of one"),
        };
        let sizes = Term {
            name: "several diameters",
            on: particles.start.diameters != Diameters::Equal,
            why: match &particles.start.diameters {
                Diameters::Equal => match &particles.start.places {
                    Places::File(path) => format!("they are those of {}", path.display()),
                    _ => "all are the powder's".to_owned(),
                },
                Diameters::Shares(classes) => {
                    format!("{} with shares of the volume, Sauter mean d", classes.len())
                }
                Diameters::LogNormal(deviation) => {
                    format!("log-normal, geometric standard deviation {deviation}, Sauter mean d")
                }
            },
        };
        let cell = domain.shortest_spacing();
        let own = particles.mapping.variance(cell, powder.diameter).sqrt();
        let width = particles.smoothing.max(own) / powder.diameter;
        let spread = Term {
            name: "smoothing",
            on: particles.smoothing > own,
            why: format!(
                "cells of {:.2} d alone spread a particle by {:.2} d{}",
                cell / powder.diameter,
                own / powder.diameter,
                if particles.smoothing > own {
                    // A box filter of width w spreads by w/√12.
                    let filter = 1e3 * 12f64.sqrt() * particles.smoothing;
                    format!(
                        ", and a Gaussian makes it {width:.2} d, as a filter of {filter:.2} mm does"
                    )
                } else {
                    let few = least * (cell / powder.diameter).powi(3) * 6.0 / PI;
                    format!(
                        ": with {few:.1} particles in a cell at ⟨φ⟩ = {least}, drag follows their noise and \
                         their places in it, and H counts both as clusters"
                    )
                }
            ),
        };
        return [contacts, pull, sizes, spread].into_iter().chain(of_the_gas).collect();
    }
    let of_the_solids = [
        Term {
            name: "frictional pressure",
            on: physics.friction != FrictionChoice::None,
            why: reached.clone(),
        },
        Term {
            name: "frictional viscosity",
            on: viscous,
            why: if viscous { reached } else { "the friction chosen has none".to_owned() },
        },
        Term {
            name: "transport of granular energy",
            on: transported,
            why: format!("drag takes {:.2} u_t/g to damp fluctuations", memory / scales.time()),
        },
    ];
    of_the_solids.into_iter().chain(of_the_gas).collect()
}

fn is_viscous<F: Friction<f64>>(_: &F) -> bool {
    F::VISCOUS
}

/// The solids fraction above which the frictional pressure of `case` acts; none if nowhere.
fn friction_onset(case: &Case) -> Option<f64> {
    let (powder, u_t) = (&case.powder, case.scales().terminal_velocity);
    let acts = |phi: f64| {
        with_friction!(case.physics.friction, f64, powder, u_t, |friction| {
            friction.pressure(phi).0 > 0.0
        })
    };
    let (mut low, mut high) = (0.0, 1.0);
    if !acts(high) {
        return None;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if acts(middle) { high = middle } else { low = middle }
    }
    Some(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::case::DEFAULT;

    fn of(changes: &[(&str, &str)]) -> Vec<Term> {
        let text = changes.iter().fold(DEFAULT.to_owned(), |text, (from, to)| {
            assert!(text.contains(from), "{from}");
            text.replacen(from, to, 1)
        });
        terms(&Case::parse(&text, "test").unwrap())
    }

    fn line(terms: &[Term], name: &str) -> String {
        terms.iter().find(|term| term.name == name).unwrap().to_string()
    }

    #[test]
    fn particles_are_spread_as_far_on_any_cells_and_a_case_that_does_not_want_it_is_told() {
        let text = include_str!("../examples/cfd-dem.toml");
        let of = |cells: &str, smoothing: &str| {
            let text = text.replace("cells = [8, 8, 32]", cells).replace("\"1.66 L_II\", ", "");
            let text = text.replace("mapping =", &format!("{smoothing}\nmapping ="));
            line(&terms(&Case::parse(&text, "test").unwrap()), "smoothing")
        };
        for (cells, spread) in [
            (
                "cells = [8, 8, 32]",
                "3.33 d alone spread a particle by 1.36 d, and a Gaussian makes it 2.70 d, as a filter of 0.70 mm does",
            ),
            (
                "cells = [16, 16, 64]",
                "1.67 d alone spread a particle by 0.68 d, and a Gaussian makes it 2.70 d, as a filter of 0.70 mm does",
            ),
            (
                "cells = [8, 8, 16]",
                "3.33 d alone spread a particle by 1.36 d, and a Gaussian makes it 5.40 d, as a filter of 1.40 mm does",
            ),
        ] {
            assert_eq!(of(cells, ""), format!("smoothing on: cells of {spread}"));
        }
        let own = "cells of 1.67 d alone spread a particle by 0.68 d";
        // 0.05 · 1.67³ · 6/π.
        assert_eq!(
            of("cells = [16, 16, 64]", "smoothing = 0"),
            format!(
                "smoothing off: {own}: with 0.4 particles in a cell at ⟨φ⟩ = 0.05, drag follows their noise \
                 and their places in it, and H counts both as clusters"
            )
        );
    }

    #[test]
    fn each_term_is_on_or_off_with_its_number() {
        let default = of(&[]);
        assert_eq!(
            line(&default, "frictional pressure"),
            "frictional pressure on: acts above φ = 0.630, which clusters of ⟨φ⟩ = 0.25 may reach"
        );
        assert!(line(&default, "frictional viscosity").starts_with("frictional viscosity off"));
        // 1.3 · 0.98 / (1500 · 0.02), 1.8e-5 / (1.3 · 0.2185 · 4.865e-3), 8.68 ms / 22.27 ms.
        assert!(line(&default, "gas inertia").contains("on: ρ_g (1-φ)/(ρ_s φ) = 4.2e-2 at"));
        assert!(line(&default, "gas stress").contains("off: μ_g/(ρ_g u_t L_I) = 1.3e-2"));
        assert!(line(&default, "transport of granular energy").contains("on: drag takes 0.39 "));

        let other = of(&[
            ("friction = \"barrier\"", "friction = \"johnson-jackson\""),
            ("granular_energy = \"transport\"", "granular_energy = \"algebraic\""),
            ("gas_inertia = true", "gas_inertia = false"),
            ("gas_stress = false", "gas_stress = true"),
            ("[0.02, 0.05, 0.15, 0.25]", "[0.02, 0.55]"),
        ]);
        let on: Vec<bool> = other.iter().map(|term| term.on).collect();
        assert_eq!(on, [true, true, false, false, true]);
        assert!(line(&other, "frictional viscosity").ends_with("φ = 0.500, and ⟨φ⟩ = 0.55 does"));
        let none = of(&[("friction = \"barrier\"", "friction = \"none\"")]);
        assert!(line(&none, "frictional pressure").starts_with("frictional pressure off: no "));
    }

    #[test]
    fn particles_have_terms_of_their_own() {
        let text = include_str!("../examples/cfd-dem.toml");
        let of = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            terms(&Case::parse(&text.replacen(from, to, 1), "test").unwrap())
        };
        let usual = of("cohesion = 0 ", "cohesion = 0 ");
        assert!(line(&usual, "cohesion of particles").contains("off: "));
        assert!(line(&usual, "several diameters").contains("off: all are the powder's"));
        let sticky = of("cohesion = 0 ", "cohesion = 20 ");
        assert!(
            line(&sticky, "cohesion of particles").contains("on: the force that parts two is 20 ")
        );
        let mixed = of("cohesion = 0 ", "diameters = { geometric_deviation = 1.2 }\ncohesion = 0 ");
        assert!(
            line(&mixed, "several diameters")
                .contains("on: log-normal, geometric standard deviation 1.2")
        );
        let stressed = of("gas_stress = false", "gas_stress = true");
        assert!(line(&stressed, "gas stress").contains("on: "));
    }
}
