//! [`FineFields`]: the seam between whatever resolves the clusters and the filter.
//!
//! A simulator fills it, in flight; the filter reads it and cannot tell which simulator that was.

use crate::grid::Grid;

/// Number of independent components of a symmetric tensor in `dimension` dimensions.
#[inline(always)]
pub const fn symmetric_components(dimension: usize) -> usize {
    dimension * (dimension + 1) / 2
}

/// Place of component (i, j) of a symmetric tensor in its list of components: (0,0), (0,1), (1,1),
/// (0,2), (1,2), (2,2).
#[inline(always)]
pub const fn symmetric_index(i: usize, j: usize) -> usize {
    let (low, high) = if i < j { (i, j) } else { (j, i) };
    high * (high + 1) / 2 + low
}

/// Resolved fields of one instant, all at cell centres, without halo, the first axis fastest; SI.
#[derive(Clone, Debug)]
pub struct FineFields<const D: usize> {
    /// The grid on which the fields are given.
    pub grid: Grid<D>,
    /// Along which axes the box repeats itself; where it does not, no filter reaches across its end.
    pub periodic: [bool; D],
    /// Simulated time \[s\].
    pub time: f64,
    /// φ \[-\].
    pub solids_fraction: Vec<f64>,
    /// u_s \[m/s\].
    pub solids_velocity: [Vec<f64>; D],
    /// u_g \[m/s\].
    pub gas_velocity: [Vec<f64>; D],
    /// Gradient of the gas pressure, of its periodic part in a periodic box, ∇p \[Pa/m\].
    pub pressure_gradient: [Vec<f64>; D],
    /// β of the fine-grid drag law in each cell \[kg/m³/s\].
    pub drag_coefficient: Vec<f64>,
    /// Drag on the solids per volume f \[Pa/m\]: β (u_g - u_s), or the sum over the particles of a cell.
    pub drag: [Vec<f64>; D],
    /// Granular temperature Θ \[m²/s²\].
    pub granular_temperature: Vec<f64>,
    /// Isotropic part of the solids' kinetic-theory stress, compression positive:
    /// P_s - η μ_b ∇·u_s \[Pa\].
    pub solids_pressure: Vec<f64>,
    /// Deviatoric kinetic-theory stress of the solids, compression positive: -2 μ_s S \[Pa\];
    /// one vector per component, in the order of [`symmetric_index`].
    pub solids_stress: Vec<Vec<f64>>,
    /// How many particles there are and touch, of a simulator that follows them one by one.
    pub counts: Option<Counts>,
}

/// Particles per volume, and of each the others that it touches.
#[derive(Clone, Debug, PartialEq)]
pub struct Counts {
    /// Particles per volume n \[1/m³\].
    pub number_density: Vec<f64>,
    /// Their contacts per volume, a contact counted for either particle, n Z \[1/m³\].
    pub contact_density: Vec<f64>,
}

impl Counts {
    /// None in any of `cells`.
    pub fn zeros(cells: usize) -> Self {
        Self { number_density: vec![0.0; cells], contact_density: vec![0.0; cells] }
    }
}

impl<const D: usize> FineFields<D> {
    /// Fields of `grid`, all zero.
    pub fn zeros(grid: Grid<D>) -> Self {
        let zero = || vec![0.0; grid.len()];
        Self {
            grid,
            periodic: [true; D],
            time: 0.0,
            solids_fraction: zero(),
            solids_velocity: std::array::from_fn(|_| zero()),
            gas_velocity: std::array::from_fn(|_| zero()),
            pressure_gradient: std::array::from_fn(|_| zero()),
            drag_coefficient: zero(),
            drag: std::array::from_fn(|_| zero()),
            granular_temperature: zero(),
            solids_pressure: zero(),
            solids_stress: vec![zero(); symmetric_components(D)],
            counts: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symmetric_components_are_listed_once_each() {
        let mut seen = [0; 6];
        for i in 0..3 {
            for j in 0..=i {
                seen[symmetric_index(i, j)] += 1;
                assert_eq!(symmetric_index(i, j), symmetric_index(j, i));
            }
        }
        assert_eq!(seen, [1; 6]);
        assert_eq!(symmetric_components(2), 3);
    }
}
