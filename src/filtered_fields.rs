//! [`FieldFilter`]: the filtered quantities as fields, one value per filter position.
//!
//! What is summed into bins is kept apart here: the moments of the one
//! [`MomentFilter`], at the positions of [`Positions`], and of them the [`QUANTITIES`] of the tables,
//! each with the sums of its one position. A slope needs many positions and has no field. Where a
//! phase is absent, or a denominator is zero, a quantity is not a number.

use crate::filter::{FilterError, width_in_cells};
use crate::filtered::{Densities, Formula, Moments, QUANTITIES, TERM_COUNT, terms};
use crate::fine::FineFields;
use crate::grid::Grid;
use crate::laws::drag::DragLaw;
use crate::moments::{MomentFilter, Positions};
use crate::spectral::Kernel;
use crate::stored::{StoredError, StoredFields, StoredSampling};

/// A filtered field.
#[derive(Clone, Debug, PartialEq)]
pub struct FilteredArray {
    /// Its name.
    pub name: &'static str,
    /// Its unit; `-` of a number.
    pub unit: &'static str,
    /// Its components along the axes, or the one of a scalar.
    pub components: Vec<Vec<f64>>,
}

/// The filtered fields of one filter width at one instant, on the lattice of filter positions: a cell's
/// centre is a filter's.
#[derive(Clone, Debug, PartialEq)]
pub struct FilteredFields {
    /// Filter width \[m\].
    pub width: f64,
    /// Filter positions along each axis.
    pub positions: Vec<usize>,
    /// Distance between them \[m\].
    pub spacing: Vec<f64>,
    /// Lower corner of the cells around them \[m\].
    pub origin: Vec<f64>,
    /// Along which axes they repeat themselves.
    pub periodic: Vec<bool>,
    /// Time \[s\].
    pub time: f64,
    /// The fields.
    pub arrays: Vec<FilteredArray>,
}

/// Filters the fields of a box of `D` dimensions.
struct BoxFilter<const D: usize> {
    grid: Grid<D>,
    periodic: [bool; D],
    kernel: Kernel,
    cells: Vec<[usize; D]>,
    filter: MomentFilter<D>,
}

impl<const D: usize> BoxFilter<D> {
    fn new(first: &StoredFields, sampling: &StoredSampling) -> Result<Self, FilterError> {
        let grid = Grid {
            cells: std::array::from_fn(|axis| first.cells[axis]),
            spacing: std::array::from_fn(|axis| first.spacing[axis]),
        };
        let periodic = std::array::from_fn(|axis| first.periodic[axis]);
        let cells: Vec<[usize; D]> = sampling
            .widths
            .iter()
            .map(|&width| width_in_cells(&grid, width))
            .collect::<Result<_, _>>()?;
        let StoredSampling { kernel, closest, parallel, .. } = *sampling;
        let filter = MomentFilter::new(grid, periodic, kernel, &cells, closest, parallel)?;
        Ok(Self { grid, periodic, kernel, cells, filter })
    }

    fn filter(
        &mut self,
        fine: &FineFields<D>,
        law: &dyn DragLaw<f64>,
        sampling: &StoredSampling,
    ) -> Vec<FilteredFields> {
        self.filter.filter(fine);
        (0..self.cells.len()).map(|width| self.fields(width, fine.time, law, sampling)).collect()
    }

    fn fields(
        &self,
        number: usize,
        time: f64,
        law: &dyn DragLaw<f64>,
        sampling: &StoredSampling,
    ) -> FilteredFields {
        let width = sampling.widths[number];
        let densities = Densities { solids: sampling.scales.density, gas: sampling.gas_density };
        let columns = self.filter.moments(number);
        let moments: Vec<Moments<f64, D>> = (0..columns.len()).map(|n| columns.at(n)).collect();
        let fraction: Vec<f64> = moments.iter().map(|m| m.solids_fraction).collect();
        let speed: Vec<f64> = moments.iter().map(Moments::slip_speed).collect();
        let mut beta = vec![0.0; moments.len()];
        law.betas(&mut beta, &fraction, &speed);

        let mut arrays =
            vec![FilteredArray { name: "solids_fraction", unit: "-", components: vec![fraction] }];
        type Vector<const D: usize> = fn(&Moments<f64, D>) -> [f64; D];
        let vectors: [(&str, &str, Vector<D>); 7] = [
            ("solids_velocity", "m/s", |m| m.favre_solids_velocity()),
            ("gas_velocity", "m/s", |m| m.favre_gas_velocity()),
            ("filtered_slip", "m/s", |m| m.slip()),
            ("filtered_drag", "Pa/m", |m| m.drag),
            ("filtered_pressure_gradient", "Pa/m", |m| m.pressure_gradient),
            ("pressure_fluctuation", "Pa/m", |m| m.pressure_fluctuation()),
            ("fraction_gradient", "1/m", |m| m.fraction_gradient),
        ];
        for (name, unit, of) in vectors {
            let values: Vec<[f64; D]> = moments.iter().map(of).collect();
            let component = |axis: usize| values.iter().map(|value| value[axis]).collect();
            arrays.push(FilteredArray { name, unit, components: (0..D).map(component).collect() });
        }
        let mut all = vec![[0.0; TERM_COUNT]; moments.len()];
        for ((all, moments), beta) in all.iter_mut().zip(&moments).zip(&beta) {
            terms(moments, *beta, densities, all);
        }
        for quantity in &QUANTITIES {
            let taken = arrays.iter().any(|array| array.name == quantity.name);
            let slope = matches!(quantity.formula, Formula::Slope { .. });
            if taken || slope || quantity.only_3d && D < 3 {
                continue;
            }
            let factor = quantity.formula.factor(densities, width);
            let value = |sums: &[f64; TERM_COUNT]| {
                let [above, below] = quantity.formula.pair(sums, [0.0; 2], factor);
                if below == 0.0 { f64::NAN } else { quantity.map.value(above / below) }
            };
            arrays.push(FilteredArray {
                name: quantity.name,
                unit: quantity.kind.unit(),
                components: vec![all.iter().map(value).collect()],
            });
        }
        // What follows from fields that are missing is nowhere a number.
        arrays.retain(|array| array.components.iter().flatten().any(|value| !value.is_nan()));
        let positions: &Positions<D> = &self.filter.positions()[number];
        let (shape, step) = (positions.shape(), positions.step());
        let spacing: Vec<f64> =
            (0..D).map(|axis| step[axis] as f64 * self.grid.spacing[axis]).collect();
        let centre = |axis: usize| match self.kernel {
            Kernel::Box => 0.5 * self.cells[number][axis] as f64 * self.grid.spacing[axis],
            _ => 0.5 * self.grid.spacing[axis],
        };
        FilteredFields {
            width,
            positions: shape.to_vec(),
            origin: (0..D).map(|axis| centre(axis) - 0.5 * spacing[axis]).collect(),
            spacing,
            periodic: self.periodic.to_vec(),
            time,
            arrays,
        }
    }
}

/// A filter of either dimension.
enum AnyFilter {
    Flat(Box<BoxFilter<2>>),
    Solid(Box<BoxFilter<3>>),
}

/// Filters stored fields to fields, at all widths.
pub struct FieldFilter {
    filter: AnyFilter,
    law: Box<dyn DragLaw<f64>>,
    sampling: StoredSampling,
}

impl FieldFilter {
    /// A filter of fields on the grid of `first`; `law` is the drag law of the fine grid. Of `sampling`
    /// the kernel, the widths and the positions are meant.
    ///
    /// # Errors
    /// The grid is none, or a filter does not fit it.
    pub fn new(
        first: &StoredFields,
        law: Box<dyn DragLaw<f64>>,
        sampling: StoredSampling,
    ) -> Result<Self, StoredError> {
        first.check()?;
        let filter = match first.cells.len() {
            2 => AnyFilter::Flat(Box::new(BoxFilter::new(first, &sampling)?)),
            _ => AnyFilter::Solid(Box::new(BoxFilter::new(first, &sampling)?)),
        };
        Ok(Self { filter, law, sampling })
    }

    /// The drag law of the fine grid.
    pub fn law(&self) -> &dyn DragLaw<f64> {
        &*self.law
    }

    /// The filtered fields of `fields`, one per filter width.
    ///
    /// # Errors
    /// The fields are none.
    ///
    /// # Panics
    /// If they are on another grid.
    pub fn filter(&mut self, fields: &StoredFields) -> Result<Vec<FilteredFields>, StoredError> {
        let Self { filter, law, sampling } = self;
        Ok(match filter {
            AnyFilter::Flat(filter) => filter.filter(&fields.fine(&**law)?, &**law, sampling),
            AnyFilter::Solid(filter) => filter.filter(&fields.fine(&**law)?, &**law, sampling),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::drag::WenYu;
    use crate::laws::scales::Scales;
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::moments::tests::random_fields;
    use crate::statistics::{Bins, bin_table};
    use crate::stored::StoredSampler;

    fn sampling(kernel: Kernel) -> StoredSampling {
        StoredSampling {
            scales: Scales::new(&POWDER, &GAS, 9.81),
            gas_density: GAS.density,
            // One bin: its row is a mean over all positions.
            bins: Bins::new(1.0, POWDER.max_packing, None),
            kernel,
            widths: vec![0.004, 0.008],
            block_duration: 0.01,
            space: 1,
            closest: 2,
            parallel: false,
        }
    }

    fn check<const D: usize>(cells: [usize; D], periodic: [bool; D], kernel: Kernel) {
        let law = || -> Box<dyn DragLaw<f64>> { Box::new(WenYu::new(&GAS, &POWDER)) };
        let grid = Grid::new(cells.map(|n| 0.002 * n as f64), cells);
        let fine = |instant: u64| FineFields {
            periodic,
            time: 0.005 * instant as f64,
            ..random_fields(grid, instant)
        };
        let first = StoredFields::of(&fine(0));
        let mut filter = FieldFilter::new(&first, law(), sampling(kernel)).unwrap();
        let mut sampler = StoredSampler::new(&first, law, sampling(kernel)).unwrap();
        let mut sums = std::collections::BTreeMap::<(usize, &str), Vec<f64>>::new();
        for instant in 0..40 {
            let fields = StoredFields::of(&fine(instant));
            sampler.sample(&fields).unwrap();
            for (number, filtered) in filter.filter(&fields).unwrap().into_iter().enumerate() {
                assert_eq!(filtered.time, fields.time);
                for array in filtered.arrays {
                    let count: usize = filtered.positions.iter().product();
                    assert!(array.components.iter().all(|values| values.len() == count));
                    // A vector's vertical component is what the table has.
                    let values = &array.components[array.components.len() - 1];
                    sums.entry((number, array.name)).or_default().extend(values);
                }
            }
        }
        // Means of the fields are the rows of a table of one bin.
        let rows = bin_table(&[sampler.into_sums()], &sampling(kernel).scales).unwrap();
        let mut seen = 0;
        for row in &rows {
            let number = usize::from(row.filter_width > 0.006);
            let quantity = QUANTITIES.iter().find(|q| q.name == row.quantity).unwrap();
            let Formula::Ratio(_, crate::filtered::Term::Positions, _) = quantity.formula else {
                continue;
            };
            let values = &sums[&(number, quantity.name)];
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            let size = values.iter().map(|value| value.abs()).sum::<f64>() / values.len() as f64;
            assert!((mean - row.value).abs() <= 1e-12 * size, "{row:?}: {mean}");
            seen += 1;
        }
        assert!(seen > 20, "{seen}");
    }

    #[test]
    fn means_of_filtered_fields_are_the_values_of_the_table() {
        check([16, 12], [true; 2], Kernel::Box);
        check([12, 10], [true, false], Kernel::Box);
        check([8, 6, 10], [true; 3], Kernel::Box);
        check([16, 12], [true; 2], Kernel::Gaussian);
    }

    #[test]
    fn a_filtered_ramp_is_the_ramp_at_the_centre_of_its_cell() {
        let grid = Grid::new([0.048, 0.04], [24, 20]);
        let place = |n: usize| [(n % 24) as f64 + 0.5, (n / 24) as f64 + 0.5].map(|x| 0.002 * x);
        let mut fields = StoredFields::of(&FineFields::<2>::zeros(grid));
        fields.periodic = vec![false; 2];
        fields.solids_fraction = (0..480).map(|n| 0.1 + place(n)[0] + 3.0 * place(n)[1]).collect();
        let law = Box::new(WenYu::new(&GAS, &POWDER));
        let mut filter = FieldFilter::new(&fields, law, sampling(Kernel::Box)).unwrap();
        for found in filter.filter(&fields).unwrap() {
            for (n, value) in found.arrays[0].components[0].iter().enumerate() {
                let at = [n % found.positions[0], n / found.positions[0]];
                let [x, y] =
                    [0, 1].map(|a| found.origin[a] + (at[a] as f64 + 0.5) * found.spacing[a]);
                assert!((value - (0.1 + x + 3.0 * y)).abs() < 1e-14, "{found:?} {n}");
            }
        }
    }
}
