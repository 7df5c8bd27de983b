//! Contact of two spheres: linear spring and dashpot, with a frictional slider
//! (Cundall & Strack, Géotechnique 29:47, 1979).
//!
//! With the overlap δ, the speed of approach v_n, the effective mass 1/m* = 1/m_i + 1/m_j, the
//! velocity v_t of the surfaces past each other and the tangential spring ξ = ∫ v_t dt, held in the
//! plane of contact:
//!
//! ```text
//! F_n = k_n δ + γ_n v_n                 γ_n = c sqrt(m* k_n),  c = -2 ln e / sqrt(π² + ln² e)
//! F_t = -(k_t ξ + γ_t v_t),             |F_t| <= μ_c |F_n|, by slipping: ξ is cut, not the force alone
//! ```
//!
//! Spheres may cohere: what Derjaguin, Muller & Toporov (J. Colloid Interface Sci. 53:314, 1975) found for stiff
//! and small ones, a pull that is the same however they are pressed together, and proportional to their
//! reduced radius, 1/R* = 1/R_i + 1/R_j:
//!
//! ```text
//! F_n = k_n δ + γ_n v_n - F_c           F_c = C R*,  C = 2 π w, w the work of adhesion
//! |F_t| <= μ_c |F_n + F_c|
//! ```
//!
//! It acts between spheres that touch, so that F_c is the force that parts them, δ = F_c/k_n their overlap at
//! rest, and F_c²/(2 k_n) the energy that parting them takes.
//!
//! The step is a leapfrog: forces at whole steps, velocities at halves. Each dashpot acts with the
//! mean of the velocities before and after the kick that its pair alone would get, which makes the
//! damping of second order: F = (k δ + γ v)/(1 + γ Δt/(2 m)), with m = m* along the normal, and
//! m* 2/7 (solid spheres) across it.

use std::f64::consts::PI;

/// 1/m of the tangential motion of two solid spheres, in 1/m*: 1 + 5/2.
pub const TANGENTIAL_MOBILITY: f64 = 3.5;

/// The numbers of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Normal stiffness k_n \[N/m\].
    pub stiffness: f64,
    /// Restitution coefficient e of two spheres that meet head on, 0 < e <= 1 \[-\].
    pub restitution: f64,
    /// Tangential over normal stiffness k_t/k_n, 2/7 to 1 \[-\].
    pub tangential_stiffness: f64,
    /// Tangential over normal damping γ_t/γ_n \[-\].
    pub tangential_damping: f64,
    /// Friction coefficient μ_c \[-\].
    pub friction: f64,
    /// Force that parts two spheres over their reduced radius, C = F_c/R*; 0 of spheres that do not cohere,
    /// which then costs nothing \[N/m\].
    pub cohesion: f64,
}

/// F_c = C R* \[N\], the pull of two spheres that touch, of radii R_i and R_j \[m\]: R* = R_i R_j/(R_i + R_j).
#[inline(always)]
pub fn pull(cohesion: f64, radii: [f64; 2]) -> f64 {
    cohesion * (radii[0] * radii[1] / (radii[0] + radii[1]))
}

/// C of a powder of equal spheres of this `diameter` \[m\] and `mass` \[kg\]: two of them part at the granular
/// Bond number Bo = F_c/(m g) times the weight of one \[N/m\].
pub fn cohesion_of(bond_number: f64, diameter: f64, mass: f64, gravity: f64) -> f64 {
    bond_number * mass * gravity / (0.25 * diameter)
}

/// Energy that parts two spheres which rest on each other under a `pull` \[N\], F_c²/(2 k_n) \[J\].
pub fn separation_energy(stiffness: f64, pull: f64) -> f64 {
    0.5 * pull * pull / stiffness
}

/// Speed of approach up to which two spheres that meet head on stay together \[m/s\]: the dashpot leaves them
/// nothing to fly apart with.
///
/// Of the oscillation about x = δ - F_c/k_n that comes to rest where they would part, x = -F_c/k_n, the
/// speed half a swing and more before, back in time s from there:
/// x = -F_c/k_n exp(β s)(cos ω s - β/ω sin ω s), β = γ_n/(2 m*), ω² = k_n/m* - β².
pub fn sticking_speed(stiffness: f64, restitution: f64, effective_mass: f64, pull: f64) -> f64 {
    let beta = 0.5 * damping(restitution);
    let omega = (1.0 - beta * beta).sqrt();
    // In units of m*, k_n and F_c/k_n.
    let x = |s: f64| -(beta * s).exp() * ((omega * s).cos() - beta / omega * (omega * s).sin());
    let (mut inside, mut outside) = (PI / omega, 2.0 * PI / omega);
    for _ in 0..100 {
        let middle = 0.5 * (inside + outside);
        if x(middle) > -1.0 { inside = middle } else { outside = middle }
    }
    let s = inside;
    let speed = (beta * s).exp() * (omega * s).sin().abs() / omega;
    speed * pull / (stiffness * effective_mass).sqrt()
}

/// c = γ_n / sqrt(m* k_n) = -2 ln e / sqrt(π² + ln² e) \[-\]: the dashpot that leaves the share e of
/// the speed of approach.
pub fn damping(restitution: f64) -> f64 {
    let log = restitution.ln();
    -2.0 * log / (PI * PI + log * log).sqrt()
}

/// How long two spheres touch, t_c = π / sqrt(k_n/m* - (γ_n/(2 m*))²) \[s\].
pub fn contact_time(stiffness: f64, restitution: f64, effective_mass: f64) -> f64 {
    let half = 0.5 * damping(restitution);
    PI / (stiffness / effective_mass * (1.0 - half * half)).sqrt()
}

/// Deepest overlap of two spheres that meet head on at `speed`:
/// δ = v/ω0 exp(-β/ω atan(ω/β)), ω0 = sqrt(k_n/m*), β = γ_n/(2 m*), ω² = ω0² - β² \[m\].
pub fn deepest_overlap(stiffness: f64, restitution: f64, effective_mass: f64, speed: f64) -> f64 {
    let half = 0.5 * damping(restitution);
    let rest = (1.0 - half * half).sqrt();
    speed * (effective_mass / stiffness).sqrt() * (-half / rest * rest.atan2(half)).exp()
}

/// The stiffness at which spheres that meet at `speed` overlap by `overlap` \[m\] and no more \[N/m\].
pub fn stiffness_for(overlap: f64, restitution: f64, effective_mass: f64, speed: f64) -> f64 {
    (deepest_overlap(1.0, restitution, effective_mass, speed) / overlap).powi(2)
}

/// Share of the tangential surface velocity after a contact in which nothing slips, over that before:
/// the damped oscillation of the tangential spring at t_c \[-\].
///
/// v_t/v_t0 = exp(-β t)(cos ω t - β/ω sin ω t), ω0² = 7/2 k_t/m*, β = 7/4 γ_t/m*, ω² = ω0² - β² > 0.
pub fn sticking_restitution(law: &Contact) -> f64 {
    let c = damping(law.restitution);
    // In units of m* and k_n.
    let square = TANGENTIAL_MOBILITY * law.tangential_stiffness;
    let beta = 0.5 * TANGENTIAL_MOBILITY * law.tangential_damping * c;
    let omega = (square - beta * beta).sqrt();
    let time = contact_time(1.0, law.restitution, 1.0);
    (-beta * time).exp() * ((omega * time).cos() - beta / omega * (omega * time).sin())
}

/// ∫ |F_n| dt over a contact, in m* times the speed of approach \[-\]: 1 + e, and a little more where
/// the dashpot pulls at the end of a damped contact.
pub fn normal_impulse(restitution: f64) -> f64 {
    let half = 0.5 * damping(restitution);
    let omega = (1.0 - half * half).sqrt();
    // F = 0 and the spheres fly apart fastest at tan ω t = -2 β ω/(ω² - β²); from there on the dashpot
    // pulls, and slows them down to e.
    let zero = (2.0 * half * omega).atan2(half * half - omega * omega);
    let fastest = (-half / omega * zero).exp() * (zero.cos() - half / omega * zero.sin());
    1.0 - fastest + (-restitution - fastest).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Integrates m* x'' = -k x - γ x' with tiny steps: (time, deepest, speed after, ∫|F|).
    fn integrated(stiffness: f64, restitution: f64, mass: f64, speed: f64) -> [f64; 4] {
        let gamma = damping(restitution) * (mass * stiffness).sqrt();
        let dt = 1e-5 * (mass / stiffness).sqrt();
        let force = |x: f64, v: f64| stiffness * x + gamma * v;
        let (mut x, mut v, mut t, mut deepest, mut impulse) = (0.0, speed, 0.0, 0.0f64, 0.0);
        while x >= 0.0 {
            let (xm, vm) = (x + 0.5 * dt * v, v - 0.5 * dt * force(x, v) / mass);
            let f = force(xm, vm);
            (x, v, t) = (x + dt * vm, v - dt * f / mass, t + dt);
            deepest = deepest.max(x);
            impulse += f.abs() * dt;
        }
        [t, deepest, -v, impulse / (mass * speed)]
    }

    #[test]
    fn the_formulae_are_those_of_the_oscillator() {
        let (k, m, v) = (14.0, 1.65e-10, 0.218);
        for e in [0.3, 0.6, 0.9, 0.97] {
            let [time, deepest, after, impulse] = integrated(k, e, m, v);
            assert!((contact_time(k, e, m) / time - 1.0).abs() < 1e-4, "{e}");
            assert!((deepest_overlap(k, e, m, v) / deepest - 1.0).abs() < 1e-4, "{e}");
            assert!((after / v - e).abs() < 1e-4, "{e}");
            assert!((normal_impulse(e) - impulse).abs() < 1e-4, "{e}: {impulse}");
        }
    }

    #[test]
    fn a_stiffness_is_found_from_the_overlap_it_allows() {
        // The founding paper's powder: 1 % of 75 um at 0.218 m/s needs about 14 N/m if nothing is lost.
        let k = stiffness_for(0.75e-6, 1.0, 1.65e-10, 0.21846);
        assert!((k / 14.0 - 1.0).abs() < 0.01, "{k}");
        assert!((contact_time(k, 1.0, 1.65e-10) / 1.08e-5 - 1.0).abs() < 0.01);
        let k = stiffness_for(0.75e-6, 0.7, 1.65e-10, 0.21846);
        assert!((deepest_overlap(k, 0.7, 1.65e-10, 0.21846) / 0.75e-6 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn an_undamped_tangential_spring_of_two_sevenths_reverses_the_surfaces() {
        let law = Contact {
            stiffness: 1.0,
            restitution: 1.0,
            tangential_stiffness: 2.0 / 7.0,
            tangential_damping: 0.5,
            friction: 1e3,
            cohesion: 0.0,
        };
        assert!((sticking_restitution(&law) + 1.0).abs() < 1e-12);
        assert_eq!(normal_impulse(1.0), 2.0);
    }

    #[test]
    fn spheres_stick_below_the_speed_at_which_the_oscillator_comes_to_rest_where_it_would_part() {
        let (k, m, pull) = (14.0, 1.65e-10, 2e-7);
        for e in [0.5, 0.9] {
            let limit = sticking_speed(k, e, m, pull);
            let gamma = damping(e) * (m * k).sqrt();
            let parts = |speed: f64| {
                let dt = 1e-4 * (m / k).sqrt();
                let (mut x, mut v) = (0.0, speed);
                for _ in 0..200_000 {
                    let middle = x + 0.5 * dt * v;
                    v -= dt * (k * middle + gamma * v - pull) / m;
                    x += dt * v;
                    if x < 0.0 {
                        return true;
                    }
                }
                false
            };
            assert!(parts(1.001 * limit) && !parts(0.999 * limit), "{e}");
        }
        assert_eq!(sticking_speed(k, 0.9, m, 0.0), 0.0);
        // C of a powder of Bo = 10 and of the founding paper's spheres: 4 F_c/d.
        let c = cohesion_of(10.0, 75e-6, 3.3e-10, 9.81);
        assert!((pull_of_equals(c) / (10.0 * 3.3e-10 * 9.81) - 1.0).abs() < 1e-14);
        // A tenth of the radius on one side: R* from d/4 to 0.0909 d/2.
        let small = super::pull(c, [37.5e-6, 3.75e-6]) / pull_of_equals(c);
        assert!((small - 2.0 / 11.0).abs() < 1e-14, "{small}");
    }

    fn pull_of_equals(cohesion: f64) -> f64 {
        pull(cohesion, [37.5e-6; 2])
    }
}
