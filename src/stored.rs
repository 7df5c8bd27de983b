//! [`StoredFields`]: resolved fields from anywhere, and [`StoredSampler`], which samples them as the
//! fields of a running simulation are sampled.
//!
//! Readers of files fill [`StoredFields`], whose dimension is known only at run time and of which
//! some may be missing; [`StoredFields::fine`] makes them [`FineFields`], and from there on there is
//! one path. What is missing is "not a number" there, and so is all that follows from it: such
//! quantities have no rows, the others are what they are.

use crate::filter::FilterError;
use crate::fine::{Counts, FineFields, symmetric_components};
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::laws::scales::Scales;
use crate::spectral::Kernel;
use crate::statistics::{Bins, Marker, Sampler, Sampling, Sums};

/// Resolved fields of one instant: numbers at cell centres, the first axis fastest; SI. The last axis
/// is vertical, up is positive.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredFields {
    /// Cells along each axis, two or three.
    pub cells: Vec<usize>,
    /// Edge of a cell along each axis \[m\].
    pub spacing: Vec<f64>,
    /// Along which axes the fields repeat themselves; where they do not, there are walls, and no
    /// filter reaches across.
    pub periodic: Vec<bool>,
    /// Time \[s\].
    pub time: f64,
    /// φ \[-\].
    pub solids_fraction: Vec<f64>,
    /// u_s \[m/s\], one array per axis.
    pub solids_velocity: Vec<Vec<f64>>,
    /// u_g \[m/s\].
    pub gas_velocity: Vec<Vec<f64>>,
    /// The gas pressure, if it is known.
    pub pressure: Option<Pressure>,
    /// β of the fine-grid drag law: force on the solids = β (u_g - u_s) \[kg/m³/s\]; if it is not
    /// known, that of the law that the sampler is given.
    pub drag_coefficient: Option<Vec<f64>>,
    /// Drag on the solids per volume \[Pa/m\], one array per axis; if it is not known, β times the slip.
    pub drag: Option<Vec<Vec<f64>>>,
    /// Particles per volume \[1/m³\].
    pub number_density: Option<Vec<f64>>,
    /// Contacts of particles per volume \[1/m³\].
    pub contact_density: Option<Vec<f64>>,
    /// Granular temperature Θ \[m²/s²\].
    pub granular_temperature: Option<Vec<f64>>,
    /// Isotropic kinetic-theory stress of the solids \[Pa\], compression positive.
    pub solids_pressure: Option<Vec<f64>>,
    /// Deviatoric kinetic-theory stress of the solids \[Pa\], compression positive; one array per
    /// component, in the order of [`symmetric_index`](crate::fine::symmetric_index).
    pub solids_stress: Option<Vec<Vec<f64>>>,
}

/// How the gas pressure is given; in a box that is periodic its periodic part.
#[derive(Clone, Debug, PartialEq)]
pub enum Pressure {
    /// p \[Pa\].
    Field(Vec<f64>),
    /// ∇p \[Pa/m\], one array per axis.
    Gradient(Vec<Vec<f64>>),
}

/// Stored fields that cannot be sampled.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StoredError {
    /// The grid is none.
    #[error(
        "a grid of {cells:?} cells of {spacing:?} m, periodic {periodic:?}: two or three axes are \
         accepted, each with one cell or more of a positive edge, and one answer per axis"
    )]
    Grid {
        /// Cells along each axis.
        cells: Vec<usize>,
        /// Edges of a cell \[m\].
        spacing: Vec<f64>,
        /// Along which axes it is periodic.
        periodic: Vec<bool>,
    },
    /// An array has not one number per cell, or a vector not one array per component.
    #[error("{array} has {found} {what}s and {expected} are needed, one per {per}")]
    Shape {
        /// The array.
        array: &'static str,
        /// What it has too few or too many of.
        what: &'static str,
        /// How many it has.
        found: usize,
        /// How many it should have.
        expected: usize,
        /// One for each of what.
        per: &'static str,
    },
    /// A number that is none, or that cannot be.
    #[error("{array} is {value} in cell {index:?}: {accepted}")]
    Value {
        /// The array.
        array: &'static str,
        /// Place of the cell along each axis.
        index: Vec<usize>,
        /// What stands there.
        value: f64,
        /// What is accepted.
        accepted: &'static str,
    },
    /// The fields are on another grid than the first ones.
    #[error("the fields at t = {time} s are on another grid than the first ones")]
    OtherGrid {
        /// Their time \[s\].
        time: f64,
    },
    /// The fields do not follow upon the ones before.
    #[error("the fields at t = {time} s follow those at {after} s: give them in the order of time")]
    Order {
        /// Their time \[s\].
        time: f64,
        /// The time of the ones before \[s\].
        after: f64,
    },
    /// A marker follows from what is not known.
    #[error("the marker {marker} needs the pressure, which the fields do not have")]
    Marker {
        /// The marker.
        marker: &'static str,
    },
    /// A filter does not fit the grid.
    #[error(transparent)]
    Filter(#[from] FilterError),
}

/// Solids fractions below zero or above one by more than this are no round-off.
const OVERSHOOT: f64 = 1e-6;

impl StoredFields {
    /// Fields of a grid without values, all that is optional missing.
    pub fn new(cells: Vec<usize>, spacing: Vec<f64>, periodic: Vec<bool>) -> Self {
        let zero = vec![0.0; cells.iter().product()];
        let vector = vec![zero.clone(); cells.len()];
        Self {
            cells,
            spacing,
            periodic,
            time: 0.0,
            solids_fraction: zero,
            solids_velocity: vector.clone(),
            gas_velocity: vector,
            pressure: None,
            drag_coefficient: None,
            drag: None,
            number_density: None,
            contact_density: None,
            granular_temperature: None,
            solids_pressure: None,
            solids_stress: None,
        }
    }

    /// The fields that a simulator left in `fine`, all of them: what is sampled from these is what is
    /// sampled from `fine`, bit for bit.
    pub fn of<const D: usize>(fine: &FineFields<D>) -> Self {
        Self {
            cells: fine.grid.cells.to_vec(),
            spacing: fine.grid.spacing.to_vec(),
            periodic: fine.periodic.to_vec(),
            time: fine.time,
            solids_fraction: fine.solids_fraction.clone(),
            solids_velocity: fine.solids_velocity.to_vec(),
            gas_velocity: fine.gas_velocity.to_vec(),
            pressure: Some(Pressure::Gradient(fine.pressure_gradient.to_vec())),
            drag_coefficient: Some(fine.drag_coefficient.clone()),
            drag: Some(fine.drag.to_vec()),
            number_density: fine.counts.as_ref().map(|counts| counts.number_density.clone()),
            contact_density: fine.counts.as_ref().map(|counts| counts.contact_density.clone()),
            granular_temperature: Some(fine.granular_temperature.clone()),
            solids_pressure: Some(fine.solids_pressure.clone()),
            solids_stress: Some(fine.solids_stress.clone()),
        }
    }

    /// Whether these are fields at all: every array has one finite number per cell.
    ///
    /// # Errors
    /// [`StoredError`] for the first thing that is wrong.
    pub fn check(&self) -> Result<(), StoredError> {
        let Self { cells, spacing, periodic, .. } = self;
        let axes = cells.len();
        let sound = (2..=3).contains(&axes)
            && [spacing.len(), periodic.len()] == [axes; 2]
            && cells.iter().all(|n| *n > 0)
            && spacing.iter().all(|h| *h > 0.0 && h.is_finite());
        if !sound {
            let (cells, spacing, periodic) = (cells.clone(), spacing.clone(), periodic.clone());
            return Err(StoredError::Grid { cells, spacing, periodic });
        }
        self.check_array("solids_fraction", &self.solids_fraction)?;
        let beyond = |phi: &f64| !(-OVERSHOOT..=1.0 + OVERSHOOT).contains(phi);
        if let Some(cell) = self.solids_fraction.iter().position(beyond) {
            return Err(StoredError::Value {
                array: "solids_fraction",
                index: self.index(cell),
                value: self.solids_fraction[cell],
                accepted: "a number from 0 to 1 is accepted",
            });
        }
        self.check_arrays("solids_velocity", &self.solids_velocity, axes)?;
        self.check_arrays("gas_velocity", &self.gas_velocity, axes)?;
        match &self.pressure {
            Some(Pressure::Field(pressure)) => self.check_array("pressure", pressure)?,
            Some(Pressure::Gradient(slope)) => {
                self.check_arrays("pressure_gradient", slope, axes)?;
            }
            None => {}
        }
        for (array, values) in [
            ("drag_coefficient", &self.drag_coefficient),
            ("granular_temperature", &self.granular_temperature),
            ("solids_pressure", &self.solids_pressure),
            ("number_density", &self.number_density),
            ("contact_density", &self.contact_density),
        ] {
            values.as_ref().map_or(Ok(()), |values| self.check_array(array, values))?;
        }
        if let Some(drag) = &self.drag {
            self.check_arrays("drag", drag, axes)?;
        }
        let stress = self.solids_stress.as_ref();
        stress.map_or(Ok(()), |stress| {
            self.check_arrays("solids_stress", stress, symmetric_components(axes))
        })
    }

    fn check_arrays(
        &self,
        array: &'static str,
        arrays: &[Vec<f64>],
        expected: usize,
    ) -> Result<(), StoredError> {
        if arrays.len() != expected {
            let (what, per, found) = ("component", "direction or pair of them", arrays.len());
            return Err(StoredError::Shape { array, what, found, expected, per });
        }
        arrays.iter().try_for_each(|values| self.check_array(array, values))
    }

    fn check_array(&self, array: &'static str, values: &[f64]) -> Result<(), StoredError> {
        let (expected, found) = (self.cells.iter().product(), values.len());
        if found != expected {
            return Err(StoredError::Shape { array, what: "number", found, expected, per: "cell" });
        }
        match values.iter().position(|value| !value.is_finite()) {
            None => Ok(()),
            Some(cell) => Err(StoredError::Value {
                array,
                index: self.index(cell),
                value: values[cell],
                accepted: "a finite number is needed in every cell",
            }),
        }
    }

    /// Place along each axis of a cell.
    fn index(&self, mut cell: usize) -> Vec<usize> {
        let along = |n: &usize| {
            let place = cell % n;
            cell /= n;
            place
        };
        self.cells.iter().map(along).collect()
    }

    /// The fields for the filter; β of `law` where it is not given.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    ///
    /// # Panics
    /// If the fields have not `D` axes.
    pub fn fine<const D: usize>(
        &self,
        law: &dyn DragLaw<f64>,
    ) -> Result<FineFields<D>, StoredError> {
        self.check()?;
        assert_eq!(self.cells.len(), D, "fields of another dimension");
        let grid = Grid {
            cells: std::array::from_fn(|axis| self.cells[axis]),
            spacing: std::array::from_fn(|axis| self.spacing[axis]),
        };
        let missing = || vec![f64::NAN; grid.len()];
        let vector = |arrays: &[Vec<f64>]| std::array::from_fn(|axis| arrays[axis].clone());
        let (solids, gas): ([_; D], [_; D]) =
            (vector(&self.solids_velocity), vector(&self.gas_velocity));
        let given = |array: &Option<Vec<f64>>| array.clone().unwrap_or_else(missing);
        let periodic = std::array::from_fn(|axis| self.periodic[axis]);
        let beta = match &self.drag_coefficient {
            Some(given) => given.clone(),
            None => coefficients(law, &self.solids_fraction, &solids, &gas),
        };
        let by_slip = |axis: usize| {
            let slips = solids[axis].iter().zip(&gas[axis]);
            beta.iter().zip(slips).map(|(beta, (us, ug))| beta * (ug - us)).collect()
        };
        Ok(FineFields {
            grid,
            periodic,
            time: self.time,
            pressure_gradient: match &self.pressure {
                Some(Pressure::Gradient(slope)) => vector(slope),
                Some(Pressure::Field(pressure)) => {
                    std::array::from_fn(|axis| gradient(&grid, periodic[axis], axis, pressure))
                }
                None => std::array::from_fn(|_| missing()),
            },
            drag: match &self.drag {
                Some(given) => vector(given),
                None => std::array::from_fn(by_slip),
            },
            drag_coefficient: beta,
            counts: match (&self.number_density, &self.contact_density) {
                (Some(number), Some(contacts)) => Some(Counts {
                    number_density: number.clone(),
                    contact_density: contacts.clone(),
                }),
                _ => None,
            },
            solids_fraction: self.solids_fraction.clone(),
            solids_velocity: solids,
            gas_velocity: gas,
            granular_temperature: given(&self.granular_temperature),
            solids_pressure: given(&self.solids_pressure),
            solids_stress: self
                .solids_stress
                .clone()
                .unwrap_or_else(|| vec![missing(); symmetric_components(D)]),
        })
    }
}

/// β of `law` in each cell \[kg/m³/s\].
fn coefficients<const D: usize>(
    law: &dyn DragLaw<f64>,
    fraction: &[f64],
    solids: &[Vec<f64>; D],
    gas: &[Vec<f64>; D],
) -> Vec<f64> {
    let mut speed = vec![0.0; fraction.len()];
    for (solids, gas) in solids.iter().zip(gas) {
        for ((speed, solids), gas) in speed.iter_mut().zip(solids).zip(gas) {
            *speed += (gas - solids) * (gas - solids);
        }
    }
    speed.iter_mut().for_each(|speed| *speed = speed.sqrt());
    let mut beta = vec![0.0; fraction.len()];
    law.betas(&mut beta, fraction, &speed);
    beta
}

/// Central differences of a field along `axis`; one-sided at a wall.
fn gradient<const D: usize>(
    grid: &Grid<D>,
    periodic: bool,
    axis: usize,
    field: &[f64],
) -> Vec<f64> {
    let (n, h) = (grid.cells[axis], grid.spacing[axis]);
    let stride: usize = grid.cells[..axis].iter().product();
    let slope = |cell: usize| {
        let here = cell / stride % n;
        let (below, above, distance) = if periodic {
            ((here + n - 1) % n, (here + 1) % n, 2)
        } else {
            let (below, above) = (here.saturating_sub(1), (here + 1).min(n - 1));
            (below, above, (above - below).max(1))
        };
        let at = |place: usize| field[cell - here * stride + place * stride];
        (at(above) - at(below)) / (distance as f64 * h)
    };
    (0..field.len()).map(slope).collect()
}

/// How stored fields are sampled.
#[derive(Clone, Debug)]
pub struct StoredSampling {
    /// The powder's scales.
    pub scales: Scales,
    /// ρ_g \[kg/m³\].
    pub gas_density: f64,
    /// The bins.
    pub bins: Bins,
    /// The filter kernel.
    pub kernel: Kernel,
    /// Filter widths \[m\].
    pub widths: Vec<f64>,
    /// Duration of a block of time \[s\]; of a run's own snapshots that of the run, else the time from
    /// one instant to the next.
    pub block_duration: f64,
    /// Blocks of space along each axis: 1, or a few where the instants are fewer than
    /// [`FEWEST_TIMES`](crate::blocking::FEWEST_TIMES).
    pub space: usize,
    /// Least distance between filter positions \[cells\].
    pub closest: usize,
    /// Whether to use the threads of the current pool.
    pub parallel: bool,
}

impl StoredSampling {
    fn of_dimension<const D: usize>(self, periodic: [bool; D]) -> Sampling<D> {
        let Self { scales, gas_density, bins, kernel, widths, block_duration, .. } = self;
        let (space, closest, parallel) = ([self.space; D], self.closest, self.parallel);
        Sampling {
            scales,
            gas_density,
            bins,
            kernel,
            widths,
            block_duration,
            space,
            periodic,
            closest,
            parallel,
        }
    }
}

/// A sampler of either dimension.
enum AnySampler {
    Flat(Box<Sampler<2, Box<dyn DragLaw<f64>>>>),
    Solid(Box<Sampler<3, Box<dyn DragLaw<f64>>>>),
}

/// Samples stored fields, one instant after the other.
pub struct StoredSampler {
    sampler: AnySampler,
    law: Box<dyn DragLaw<f64>>,
    cells: Vec<usize>,
    spacing: Vec<f64>,
    periodic: Vec<bool>,
    bins: Bins,
    time: Option<f64>,
}

impl StoredSampler {
    /// A sampler of fields on the grid of `first`. `law` makes the drag law of the fine grid, from
    /// which the filtered drag is corrected.
    ///
    /// # Errors
    /// The grid is none, or a filter does not fit it.
    pub fn new(
        first: &StoredFields,
        law: impl Fn() -> Box<dyn DragLaw<f64>>,
        sampling: StoredSampling,
    ) -> Result<Self, StoredError> {
        first.check()?;
        let StoredFields { cells, spacing, periodic, .. } = first.clone();
        let bins = sampling.bins.clone();
        let sampler = if cells.len() == 2 {
            let (grid, periodic) = (grid(first), [periodic[0], periodic[1]]);
            let sampler = Sampler::new(grid, law(), sampling.of_dimension(periodic))?;
            AnySampler::Flat(Box::new(sampler))
        } else {
            let (grid, periodic) = (grid(first), [periodic[0], periodic[1], periodic[2]]);
            let sampler = Sampler::new(grid, law(), sampling.of_dimension(periodic))?;
            AnySampler::Solid(Box::new(sampler))
        };
        Ok(Self { sampler, law: law(), cells, spacing, periodic, bins, time: None })
    }

    /// Adds the fields of one instant, later than the ones before.
    ///
    /// # Errors
    /// The fields are none, are on another grid, are not later, or have no pressure and it is a
    /// marker.
    pub fn sample(&mut self, fields: &StoredFields) -> Result<(), StoredError> {
        let same = (&fields.cells, &fields.spacing, &fields.periodic);
        if same != (&self.cells, &self.spacing, &self.periodic) {
            return Err(StoredError::OtherGrid { time: fields.time });
        }
        if let Some(after) = self.time.filter(|after| fields.time <= *after) {
            return Err(StoredError::Order { time: fields.time, after });
        }
        let pressed = |axis: &&crate::statistics::Axis| axis.marker == Marker::PressureGradient;
        if let (None, Some(axis)) = (&fields.pressure, self.bins.axes.iter().find(pressed)) {
            return Err(StoredError::Marker { marker: axis.marker.name() });
        }
        match &mut self.sampler {
            AnySampler::Flat(sampler) => sampler.sample(&fields.fine(&*self.law)?),
            AnySampler::Solid(sampler) => sampler.sample(&fields.fine(&*self.law)?),
        }
        self.time = Some(fields.time);
        Ok(())
    }

    /// The sums, at the end.
    pub fn into_sums(self) -> Sums {
        match self.sampler {
            AnySampler::Flat(sampler) => sampler.into_sums(),
            AnySampler::Solid(sampler) => sampler.into_sums(),
        }
    }
}

fn grid<const D: usize>(fields: &StoredFields) -> Grid<D> {
    Grid {
        cells: std::array::from_fn(|axis| fields.cells[axis]),
        spacing: std::array::from_fn(|axis| fields.spacing[axis]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::drag::WenYu;
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::moments::tests::random_fields;
    use crate::statistics::bin_table;

    fn law() -> Box<dyn DragLaw<f64>> {
        Box::new(WenYu::new(&GAS, &POWDER))
    }

    fn sampling() -> StoredSampling {
        StoredSampling {
            scales: Scales::new(&POWDER, &GAS, 9.81),
            gas_density: GAS.density,
            bins: Bins::new(0.05, POWDER.max_packing, None),
            kernel: Kernel::Box,
            widths: vec![0.004, 0.008],
            block_duration: 0.01,
            space: 1,
            closest: 2,
            parallel: false,
        }
    }

    fn check<const D: usize>(cells: [usize; D], periodic: [bool; D]) {
        let grid = Grid::new(cells.map(|n| 0.002 * n as f64), cells);
        let first = FineFields { periodic, ..random_fields(grid, 0) };
        let in_flight = Sampling { periodic, ..sampling().of_dimension(periodic) };
        let mut flying = Sampler::new(grid, law(), in_flight).unwrap();
        let mut stored = StoredSampler::new(&StoredFields::of(&first), law, sampling()).unwrap();
        let mut bare = StoredSampler::new(&StoredFields::of(&first), law, sampling()).unwrap();
        for instant in 0..40 {
            let time = 0.005 * instant as f64;
            let fine = FineFields { periodic, time, ..random_fields(grid, instant) };
            flying.sample(&fine);
            let fields = StoredFields::of(&fine);
            stored.sample(&fields).unwrap();
            // The law gives what the simulator had from it.
            let fields = StoredFields {
                pressure: None,
                drag_coefficient: None,
                drag: None,
                granular_temperature: None,
                solids_pressure: None,
                solids_stress: None,
                number_density: None,
                ..fields
            };
            bare.sample(&fields).unwrap();
        }
        let (flying, stored) = (flying.into_sums(), stored.into_sums());
        assert_eq!(flying, stored);
        let scales = sampling().scales;
        let all = bin_table(&[flying], &scales).unwrap();
        let some = bin_table(&[bare.into_sums()], &scales).unwrap();
        let names = |rows: &[crate::table::BinRow]| -> std::collections::BTreeSet<String> {
            rows.iter().map(|row| row.quantity.clone()).collect()
        };
        let missing: Vec<String> = names(&all).difference(&names(&some)).cloned().collect();
        for name in ["drag_correction", "granular_temperature", "solids_viscosity_kinetic"] {
            assert!(missing.iter().any(|missing| missing == name), "{name}");
        }
        // What is there is what it was.
        assert!(names(&some).contains("drag_correction_no_pressure"));
        for row in &some {
            let other = all.iter().find(|other| {
                (&other.quantity, other.filter_width, other.solids_fraction_low)
                    == (&row.quantity, row.filter_width, row.solids_fraction_low)
            });
            let other = other.unwrap();
            assert_eq!(other.samples, row.samples);
            let size = 1e-12 * other.value.abs().max(1e-6);
            assert!((other.value - row.value).abs() < size, "{row:?}");
        }
    }

    #[test]
    fn stored_fields_are_sampled_as_those_in_flight() {
        check([16, 12], [true; 2]);
        check([12, 10], [true, false]);
        check([8, 6, 10], [true; 3]);
    }

    #[test]
    fn the_gradient_of_a_linear_pressure_is_its_slope() {
        let grid = Grid::new([0.8, 1.0, 0.6], [8, 5, 3]);
        let place = |cell: usize| [cell % 8, cell / 8 % 5, cell / 40].map(|i| i as f64);
        let field: Vec<f64> = (0..120)
            .map(|cell| {
                let [x, y, z] = place(cell);
                0.1 * x + 2.0 * 0.2 * y - 3.0 * 0.2 * z
            })
            .collect();
        for (axis, slope) in [1.0, 2.0, -3.0].into_iter().enumerate() {
            let found = gradient(&grid, false, axis, &field);
            assert!(found.iter().all(|found| (found - slope).abs() < 1e-13), "{axis}: {found:?}");
        }
        // Periodic: the sine's central difference.
        let wave: Vec<f64> =
            (0..120).map(|cell| (std::f64::consts::TAU * place(cell)[0] / 8.0).sin()).collect();
        for (cell, found) in gradient(&grid, true, 0, &wave).iter().enumerate() {
            let angle = std::f64::consts::TAU * place(cell)[0] / 8.0;
            let exact = angle.cos() * (std::f64::consts::TAU / 8.0).sin() / 0.1;
            assert!((found - exact).abs() < 1e-13);
        }
    }

    #[test]
    fn what_cannot_be_sampled_is_refused() {
        let sound = StoredFields::new(vec![8, 6], vec![0.002; 2], vec![true; 2]);
        assert_eq!(sound.check(), Ok(()));
        let refused = |change: &dyn Fn(&mut StoredFields), says: &str| {
            let mut fields = sound.clone();
            change(&mut fields);
            let error = fields.check().unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        };
        refused(&|f| f.cells = vec![48], "two or three axes");
        refused(&|f| f.spacing[1] = 0.0, "[0.002, 0.0] m");
        refused(&|f| f.gas_velocity[1][10] = f64::NAN, "gas_velocity is NaN in cell [2, 1]");
        refused(&|f| f.solids_fraction[0] = 1.2, "solids_fraction is 1.2 in cell [0, 0]");
        refused(&|f| f.solids_fraction.truncate(40), "has 40 numbers and 48 are needed");
        refused(&|f| f.solids_velocity.truncate(1), "has 1 components and 2 are needed");
        refused(&|f| f.pressure = Some(Pressure::Field(vec![])), "pressure has 0 numbers");
        refused(&|f| f.solids_stress = Some(vec![]), "solids_stress has 0 components and 3");

        let mut by_pressure = sampling();
        by_pressure.bins.axes[0].marker = Marker::PressureGradient;
        let mut sampler = StoredSampler::new(&sound, law, by_pressure).unwrap();
        let refused = sampler.sample(&sound).unwrap_err();
        assert_eq!(refused, StoredError::Marker { marker: "pressure_gradient" });
        let mut sampler = StoredSampler::new(&sound, law, sampling()).unwrap();
        sampler.sample(&sound).unwrap();
        assert!(matches!(sampler.sample(&sound), Err(StoredError::Order { .. })));
        let other = StoredFields::new(vec![8, 8], vec![0.002; 2], vec![true; 2]);
        assert!(matches!(sampler.sample(&other), Err(StoredError::OtherGrid { .. })));
        let narrow = StoredFields::new(vec![8, 2], vec![0.002; 2], vec![true; 2]);
        assert!(matches!(
            StoredSampler::new(&narrow, law, sampling()),
            Err(StoredError::Filter(FilterError::OutOfBox { .. }))
        ));
    }
}
