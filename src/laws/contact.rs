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
        };
        assert!((sticking_restitution(&law) + 1.0).abs() < 1e-12);
        assert_eq!(normal_impulse(1.0), 2.0);
    }
}
