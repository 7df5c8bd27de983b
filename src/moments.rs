//! [`MomentFilter`]: from fine fields to filtered [`Moments`] at the filter positions of each width.

use crate::filter::{BoxFilter, FilterError};
use crate::filtered::{Moments, favre};
use crate::fine::{FineFields, symmetric_components, symmetric_index};
use crate::grid::Grid;

/// Columns of [`MomentColumns`]: scalars first, then vectors, then symmetric tensors, then the
/// velocity gradient.
const FRACTION: usize = 0;
const FRACTION_SQUARED: usize = 1;
const SEEN_GAS_FLUX: usize = 2;
const DRAG: usize = 3;
const PRESSURE_GRADIENT: usize = 4;
const FRACTION_PRESSURE_GRADIENT: usize = 5;
const KINETIC_PRESSURE: usize = 6;
const FRACTION_TEMPERATURE: usize = 7;
const SOLIDS_FLUX: usize = 8;

const fn gas_flux(dimension: usize) -> usize {
    SOLIDS_FLUX + dimension
}

const fn flux_velocity(dimension: usize) -> usize {
    gas_flux(dimension) + dimension
}

const fn kinetic_stress(dimension: usize) -> usize {
    flux_velocity(dimension) + symmetric_components(dimension)
}

const fn velocity_gradient(dimension: usize) -> usize {
    kinetic_stress(dimension) + symmetric_components(dimension)
}

/// Number of filtered moments in `dimension` dimensions: 18 in two, 26 in three.
pub const fn moment_count(dimension: usize) -> usize {
    velocity_gradient(dimension)
}

/// Filtered moments of one width at its filter positions, one column per component.
#[derive(Clone, Debug)]
pub struct MomentColumns<const D: usize> {
    positions: usize,
    /// Column c, position n at c `positions` + n.
    columns: Vec<f64>,
}

impl<const D: usize> MomentColumns<D> {
    fn zeros(positions: usize) -> Self {
        Self { positions, columns: vec![0.0; (velocity_gradient(D) + D * D) * positions] }
    }

    /// Number of filter positions.
    pub fn len(&self) -> usize {
        self.positions
    }

    /// Whether there is no filter position.
    pub fn is_empty(&self) -> bool {
        self.positions == 0
    }

    fn column(&mut self, column: usize) -> &mut [f64] {
        &mut self.columns[column * self.positions..][..self.positions]
    }

    /// The moments at filter position `n`.
    #[inline(always)]
    pub fn at(&self, n: usize) -> Moments<D> {
        let value = |column: usize| self.columns[column * self.positions + n];
        let vector = |first: usize| std::array::from_fn(|axis| value(first + axis));
        let symmetric = |first: usize| {
            std::array::from_fn(|i| std::array::from_fn(|j| value(first + symmetric_index(i, j))))
        };
        Moments {
            solids_fraction: value(FRACTION),
            solids_fraction_squared: value(FRACTION_SQUARED),
            solids_flux: vector(SOLIDS_FLUX),
            gas_flux: vector(gas_flux(D)),
            seen_gas_flux: value(SEEN_GAS_FLUX),
            solids_flux_velocity: symmetric(flux_velocity(D)),
            drag: value(DRAG),
            pressure_gradient: value(PRESSURE_GRADIENT),
            fraction_pressure_gradient: value(FRACTION_PRESSURE_GRADIENT),
            kinetic_pressure: value(KINETIC_PRESSURE),
            kinetic_stress: symmetric(kinetic_stress(D)),
            fraction_temperature: value(FRACTION_TEMPERATURE),
            solids_velocity_gradient: std::array::from_fn(|i| {
                std::array::from_fn(|j| value(velocity_gradient(D) + i * D + j))
            }),
        }
    }
}

/// The filter positions of one width.
#[derive(Clone, Debug)]
struct Positions<const D: usize> {
    /// Cells of the positions.
    cells: Vec<u32>,
    /// The next cell below and above each position along each axis.
    neighbours: [Vec<[u32; 2]>; D],
}

/// Distance between filter positions in cells along an axis, for a filter `width` cells wide.
///
/// A quarter of the width in two dimensions, half in three: 16 or 8 positions in a filter's own
/// volume. Closer positions share nearly all their cells and would cost more than they tell; a
/// spacing that divides the width weighs every fine cell equally.
pub const fn position_spacing(dimension: usize, width: usize) -> usize {
    let spacing = if dimension < 3 { width / 4 } else { width / 2 };
    if spacing == 0 { 1 } else { spacing }
}

impl<const D: usize> Positions<D> {
    fn new(grid: &Grid<D>, width: [usize; D]) -> Self {
        let mut strides = [1; D];
        for axis in 1..D {
            strides[axis] = strides[axis - 1] * grid.cells[axis - 1];
        }
        let place = |cell: usize, axis: usize| cell / strides[axis] % grid.cells[axis];
        let on_lattice = |&cell: &usize| {
            (0..D).all(|a| place(cell, a).is_multiple_of(position_spacing(D, width[a])))
        };
        let cells: Vec<usize> = (0..grid.len()).filter(on_lattice).collect();
        let neighbours = std::array::from_fn(|axis| {
            let (n, stride) = (grid.cells[axis], strides[axis]);
            let neighbour = |&cell: &usize| {
                let here = place(cell, axis);
                [(here + n - 1) % n, (here + 1) % n]
                    .map(|there| (cell - here * stride + there * stride) as u32)
            };
            cells.iter().map(neighbour).collect()
        });
        Self { cells: cells.iter().map(|&cell| cell as u32).collect(), neighbours }
    }
}

/// Filters the moments of fine fields, at all widths.
///
/// One moment after the other goes through all widths, so that only one moment's filtered fields
/// exist at a time and stay in cache; what is kept of them is their values at the filter positions.
#[derive(Clone, Debug)]
pub struct MomentFilter<const D: usize> {
    grid: Grid<D>,
    filter: BoxFilter<D>,
    positions: Vec<Positions<D>>,
    columns: Vec<MomentColumns<D>>,
    /// φ̄ of every width, in all cells: the velocity gradient needs it beside each flux.
    fraction: Vec<Vec<f64>>,
    moment: Vec<Vec<f64>>,
    product: Vec<f64>,
}

impl<const D: usize> MomentFilter<D> {
    /// Filters of `widths` (cells along each axis) on `grid`.
    ///
    /// # Errors
    /// [`FilterError::OutOfBox`] if a width is zero or exceeds the box.
    pub fn new(grid: Grid<D>, widths: &[[usize; D]]) -> Result<Self, FilterError> {
        let filter = BoxFilter::new(grid.cells, widths)?;
        let positions: Vec<_> = widths.iter().map(|&width| Positions::new(&grid, width)).collect();
        Ok(Self {
            grid,
            columns: positions.iter().map(|at| MomentColumns::zeros(at.cells.len())).collect(),
            positions,
            fraction: filter.outputs(),
            moment: filter.outputs(),
            product: vec![0.0; grid.len()],
            filter,
        })
    }

    /// The filtered moments of the last filtered fields, one entry per width.
    pub fn moments(&self) -> &[MomentColumns<D>] {
        &self.columns
    }

    /// Filters `fields`. Allocates nothing.
    ///
    /// # Panics
    /// If the fields are not on the grid of the filter.
    pub fn filter(&mut self, fields: &FineFields<D>) {
        assert_eq!(fields.grid, self.grid, "fields on another grid than the filter's");
        self.filter.filter(&fields.solids_fraction, &mut self.fraction);
        for (width, columns) in self.columns.iter_mut().enumerate() {
            gather(&self.positions[width], &self.fraction[width], columns.column(FRACTION));
        }
        for column in FRACTION + 1..moment_count(D) {
            let moment = product(fields, column, &mut self.product);
            self.filter.filter(moment, &mut self.moment);
            for (width, columns) in self.columns.iter_mut().enumerate() {
                gather(&self.positions[width], &self.moment[width], columns.column(column));
            }
            if (SOLIDS_FLUX..gas_flux(D)).contains(&column) {
                self.differentiate(column - SOLIDS_FLUX);
            }
        }
    }

    /// Gradient of component `component` of ũ_s, whose flux has just been filtered: the central
    /// difference over the two fine cells beside each position.
    fn differentiate(&mut self, component: usize) {
        for (width, columns) in self.columns.iter_mut().enumerate() {
            let (fraction, flux) = (&self.fraction[width], &self.moment[width]);
            let velocity = |cell: u32| favre(flux[cell as usize], fraction[cell as usize]);
            for axis in 0..D {
                let per_length = 0.5 / self.grid.spacing[axis];
                let column = columns.column(velocity_gradient(D) + component * D + axis);
                let neighbours = &self.positions[width].neighbours[axis];
                for (value, &[below, above]) in column.iter_mut().zip(neighbours) {
                    *value = per_length * (velocity(above) - velocity(below));
                }
            }
        }
    }
}

/// The values of `field` at the filter positions.
fn gather<const D: usize>(positions: &Positions<D>, field: &[f64], values: &mut [f64]) {
    for (value, &cell) in values.iter_mut().zip(&positions.cells) {
        *value = field[cell as usize];
    }
}

/// The fine field whose filtered value is column `column`; made in `scratch` unless it is there.
fn product<'a, const D: usize>(
    fields: &'a FineFields<D>,
    column: usize,
    scratch: &'a mut [f64],
) -> &'a [f64] {
    let vertical = D - 1;
    let (fraction, solids, gas) =
        (&fields.solids_fraction, &fields.solids_velocity, &fields.gas_velocity);
    let slopes = &fields.vertical_pressure_gradient;
    match column {
        FRACTION => return fraction,
        FRACTION_SQUARED => multiply(scratch, fraction, fraction),
        SEEN_GAS_FLUX => multiply(scratch, fraction, &gas[vertical]),
        DRAG => {
            let slip =
                gas[vertical].iter().zip(&solids[vertical]).map(|(gas, solids)| gas - solids);
            for ((out, beta), slip) in scratch.iter_mut().zip(&fields.drag_coefficient).zip(slip) {
                *out = beta * slip;
            }
        }
        PRESSURE_GRADIENT => return slopes,
        FRACTION_PRESSURE_GRADIENT => multiply(scratch, fraction, slopes),
        KINETIC_PRESSURE => return &fields.solids_pressure,
        FRACTION_TEMPERATURE => multiply(scratch, fraction, &fields.granular_temperature),
        column if column < gas_flux(D) => {
            multiply(scratch, fraction, &solids[column - SOLIDS_FLUX]);
        }
        column if column < flux_velocity(D) => {
            let velocity = &gas[column - gas_flux(D)];
            for ((out, fraction), velocity) in scratch.iter_mut().zip(fraction).zip(velocity) {
                *out = (1.0 - fraction) * velocity;
            }
        }
        column if column < kinetic_stress(D) => {
            let (i, j) = symmetric_axes(column - flux_velocity(D));
            multiply(scratch, fraction, &solids[i]);
            for (out, velocity) in scratch.iter_mut().zip(&solids[j]) {
                *out *= velocity;
            }
        }
        column => return &fields.solids_stress[column - kinetic_stress(D)],
    }
    scratch
}

/// Component `index` of a symmetric tensor: the inverse of [`symmetric_index`].
fn symmetric_axes(index: usize) -> (usize, usize) {
    let high = (0..).find(|&high| index < symmetric_components(high + 1)).unwrap_or(0);
    (index - symmetric_components(high), high)
}

/// out = a b.
fn multiply(out: &mut [f64], a: &[f64], b: &[f64]) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
        *out = a * b;
    }
}

/// Random fields for the tests of this module and of the statistics.
#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use crate::laws::drag::{DragLaw, WenYu};
    use crate::laws::scales::tests::{GAS, POWDER};

    /// Fields of independent random cells, φ in \[0, 0.6), drag of Wen & Yu; some cells are empty.
    pub(crate) fn random_fields<const D: usize>(grid: Grid<D>, seed: u64) -> FineFields<D> {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut fields = FineFields::zeros(grid);
        let law = WenYu::<f64>::new(&GAS, &POWDER);
        let mut between = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        for i in 0..grid.len() {
            fields.solids_fraction[i] = between(-0.05, 0.6).max(0.0);
            let mut squared = 0.0;
            for axis in 0..D {
                let lift = if axis == D - 1 { 0.3 } else { 0.0 };
                fields.solids_velocity[axis][i] = between(-0.4, 0.4);
                fields.gas_velocity[axis][i] = between(-0.5, 0.5) + lift;
                let slip = fields.gas_velocity[axis][i] - fields.solids_velocity[axis][i];
                squared += slip * slip;
            }
            fields.drag_coefficient[i] = law.beta(fields.solids_fraction[i], squared.sqrt());
            fields.vertical_pressure_gradient[i] = between(-3000.0, 3000.0);
            fields.granular_temperature[i] = between(0.0, 0.01);
            fields.solids_pressure[i] = between(0.0, 2.0);
            for component in &mut fields.solids_stress {
                component[i] = between(-1.0, 1.0);
            }
        }
        fields
    }

    #[test]
    fn symmetric_axes_invert_the_symmetric_index() {
        for index in 0..6 {
            let (i, j) = symmetric_axes(index);
            assert_eq!(symmetric_index(i, j), index);
        }
    }

    /// Filters over the whole box see every cell, so that plain sums are the reference.
    fn check_whole_box<const D: usize>(cells: [usize; D]) {
        let grid = Grid::new([0.1; D], cells);
        let fields = random_fields(grid, 7);
        let mut filter = MomentFilter::new(grid, &[[1; D], cells]).unwrap();
        filter.filter(&fields);
        let [fine, whole] = filter.moments() else { panic!("two widths") };
        assert_eq!(fine.len(), grid.len());
        let at = whole.at(0);
        let n = grid.len();
        let phi = &fields.solids_fraction;
        let mean = |value: &dyn Fn(usize) -> f64| (0..n).map(value).sum::<f64>() / n as f64;
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12 * b.abs().max(1.0), "{a} {b}");

        let mean_phi = mean(&|k| phi[k]);
        close(at.solids_fraction, mean_phi);
        close(at.solids_fraction_variance(), mean(&|k| (phi[k] - mean_phi).powi(2)));
        close(at.fraction_temperature, mean(&|k| phi[k] * fields.granular_temperature[k]));
        let slopes = &fields.vertical_pressure_gradient;
        let mean_slope = mean(&|k| slopes[k]);
        close(at.pressure_fluctuation(), mean(&|k| (phi[k] - mean_phi) * (slopes[k] - mean_slope)));
        // Drift from fluctuations: filt(φ' u_g') / (1-φ̄), u_g' about the Favre velocity.
        let favre_gas = at.favre_gas_velocity()[D - 1];
        let gas = &fields.gas_velocity[D - 1];
        close(at.drift_flux(), mean(&|k| phi[k] * (gas[k] - favre_gas)));
        // Residual stress from all pairs of cells, without any mean velocity.
        for (i, row) in at.residual_stress().iter().enumerate() {
            for (j, residual) in row.iter().enumerate() {
                let (ui, uj) = (&fields.solids_velocity[i], &fields.solids_velocity[j]);
                let pairs: f64 = (0..n)
                    .map(|a| {
                        (0..n)
                            .map(|b| phi[a] * phi[b] * (ui[a] - ui[b]) * (uj[a] - uj[b]))
                            .sum::<f64>()
                    })
                    .sum();
                let direct = pairs / (2.0 * mean_phi * (n * n) as f64);
                assert!((residual - direct).abs() < 1e-12, "{i}{j}");
                close(
                    at.kinetic_stress[i][j],
                    mean(&|k| fields.solids_stress[symmetric_index(i, j)][k]),
                );
            }
        }
        // A whole-box mean has no gradient.
        assert!(at.solids_velocity_gradient.iter().flatten().all(|g| g.abs() < 1e-12));
        assert!(
            (0..n).all(|k| fine.at(k).residual_stress().iter().flatten().all(|r| r.abs() < 1e-15))
        );
    }

    #[test]
    fn moments_equal_direct_sums() {
        check_whole_box([12, 10]);
        check_whole_box([5, 6, 4]);
    }

    #[test]
    fn a_moving_observer_finds_the_same() {
        let grid = Grid::new([0.1, 0.12], [10, 12]);
        let rest = random_fields(grid, 5);
        let mut moving = rest.clone();
        for velocity in moving.solids_velocity.iter_mut().chain(&mut moving.gas_velocity) {
            velocity.iter_mut().for_each(|u| *u += 1.5);
        }
        let filters = [rest, moving].map(|fields| {
            let mut filter = MomentFilter::new(grid, &[[4, 4], [2, 6]]).unwrap();
            filter.filter(&fields);
            filter
        });
        let [rest, moving] = &filters;
        for (rest, moving) in rest.moments().iter().zip(moving.moments()) {
            for (a, b) in (0..rest.len()).map(|n| (rest.at(n), moving.at(n))) {
                let differ = |a: f64, b: f64| (a - b).abs() > 1e-13;
                assert!((0..2).all(|i| !differ(a.slip()[i], b.slip()[i])));
                assert!(!differ(a.drift_flux(), b.drift_flux()));
                let residuals = a.residual_stress().into_iter().zip(b.residual_stress());
                for (a, b) in residuals {
                    assert!((0..2).all(|j| !differ(a[j], b[j])));
                }
                assert!((a.deviatoric_rate()[0][1] - b.deviatoric_rate()[0][1]).abs() < 1e-11);
            }
        }
    }

    #[test]
    fn the_rate_of_a_shear_wave_is_its_central_difference() {
        let grid = Grid::new([0.16, 0.08], [64, 32]);
        let mut fields = FineFields::zeros(grid);
        let angle = |x: usize| std::f64::consts::TAU * x as f64 / 64.0;
        for i in 0..grid.len() {
            fields.solids_fraction[i] = 0.3;
            fields.solids_velocity[1][i] = angle(i % 64).sin();
            fields.solids_velocity[0][i] = 2.0;
        }
        let mut filter = MomentFilter::new(grid, &[[1, 1], [4, 4]]).unwrap();
        filter.filter(&fields);
        let h = grid.spacing[0];
        for (n, cell) in (0..grid.len()).enumerate() {
            let at = filter.moments()[0].at(n);
            let slope = angle(1).sin() * angle(cell % 64).cos() / h;
            let rate = at.deviatoric_rate();
            assert!((at.solids_velocity_gradient[1][0] - slope).abs() < 1e-10);
            assert!((rate[0][1] - 0.5 * slope).abs() < 1e-10 && rate[0][1] == rate[1][0]);
            assert!(rate[0][0].abs() < 1e-10 && rate[1][1].abs() < 1e-10);
        }
        assert_eq!(filter.moments()[1].len(), grid.len());
        assert_eq!([1, 4, 8, 15].map(|w| position_spacing(2, w)), [1, 1, 2, 3]);
        assert_eq!([1, 4, 8, 15].map(|w| position_spacing(3, w)), [1, 2, 4, 7]);
    }

    #[test]
    fn an_empty_box_gives_finite_moments() {
        let grid = Grid::new([0.1, 0.1], [8, 8]);
        let mut fields = random_fields(grid, 3);
        fields.solids_fraction.fill(0.0);
        fields.solids_fraction[0] = 1e-300;
        let mut filter = MomentFilter::new(grid, &[[1, 1], [4, 4]]).unwrap();
        filter.filter(&fields);
        for columns in filter.moments() {
            for n in 0..columns.len() {
                let at = columns.at(n);
                let speed = at.slip_speed();
                assert!(speed.is_finite() && speed < 3.0, "{speed}");
                assert!(at.residual_stress().iter().flatten().all(|r| r.is_finite()));
                assert!(at.solids_velocity_gradient.iter().flatten().all(|g| g.is_finite()));
            }
        }
    }
}
