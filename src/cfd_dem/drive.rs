//! A mean gas pressure gradient that keeps the flux of the gas, as of [`crate::drive`].

use super::CfdDem;

impl CfdDem {
    /// Mean pressure gradient over the weight of the mixture; 1 unless a gas flux is kept.
    pub fn pressure_gradient(&self) -> f64 {
        self.gas_flux.map_or(1.0, |flux| flux.gradient)
    }

    /// Weight less the mean pressure gradient's push in the frame of the mixture, for particles and
    /// gas \[N/m³\].
    pub(super) fn driven(&self) -> [f64; 2] {
        self.buoyancy.map(|buoyancy| self.pressure_gradient() * buoyancy)
    }

    /// Makes the gas flux what is wanted after a step of `dt` \[s\]: ε u of every vertical face changes by
    /// the same, so that its divergence does not, and all particles are owed what keeps the momentum.
    pub(super) fn keep_gas_flux(&mut self, dt: f64) {
        let Some(mut flux) = self.gas_flux else { return };
        let (rows, force) = (self.rows, self.buoyancy);
        let [now, before, _] = &self.phi;
        let (u, mobility) = (&self.gas[2], &self.mobility[2]);
        // Means over faces: ε u, what it answers to the gradient, and ρ_g times the change of velocity at
        // which ε u changes by one.
        let sums = rows.fold(
            &|row| {
                let below = row.near(2, -1);
                let mut sums = [0.0; 3];
                let (lower, upper) = (now.row(below), now.row(row));
                let (older, newer) = (before.row(below), before.row(row));
                for (i, u) in u.row(row).iter().enumerate() {
                    let open = 1.0 - 0.5 * (lower[i] + upper[i]);
                    sums[0] += open * u;
                    sums[1] += open * mobility.row(row)[i] * force[1];
                    sums[2] += (1.0 - 0.5 * (older[i] + newer[i])) / open;
                }
                sums
            },
            &|a: [f64; 3], b: [f64; 3]| std::array::from_fn(|n| a[n] + b[n]),
        );
        let [gas, answer, inertia] = sums.map(|sum| sum / self.grid.len() as f64);
        let mean = self.setup.solids_fraction;
        let density = self.setup.powder.density;
        let falling = self
            .dem
            .positions()
            .iter()
            .zip(self.dem.velocities())
            .map(|(position, velocity)| self.ratio(position).powi(3) * velocity.0[2])
            .sum::<f64>()
            / self.whole;
        let solids_answer = mean * dt * force[0] / density;
        let lacking = flux.lacking(mean, [mean * falling, gas], [solids_answer, answer]);
        self.gas_flux = Some(flux);
        rows.each([&mut self.gas[2]], |row, [u]| {
            let (lower, upper) = (now.row(row.near(2, -1)), now.row(row));
            for (i, u) in u.iter_mut().enumerate() {
                *u += lacking / (1.0 - 0.5 * (lower[i] + upper[i]));
            }
        });
        let owed = -self.setup.gas.density * inertia * lacking / (density * mean);
        for drive in self.dem.drives_mut() {
            drive.0[2] += owed;
        }
        self.see_pulls();
    }
}
