//! [`SumsFile`]: sums on disk, so that runs can be pooled, resampled and refitted later.
//!
//! Every run leaves its sums in `sums.favre`: for each box those of its steady part.
//!
//! # Format of [`SumsFile`], version 2
//!
//! Numbers are little-endian; a list is its length (u64) and its elements; a text is its length and
//! UTF-8.
//!
//! | what | type |
//! | --- | --- |
//! | `favresum` | 8 bytes |
//! | version of the format | u32 |
//! | powder: d \[m\], ρ_s \[kg/m³\], restitution, densest packing | four f64 |
//! | gas: ρ_g \[kg/m³\], μ_g \[Pa·s\] | two f64 |
//! | g \[m/s²\] | f64 |
//! | the fine grid's drag law, as in a case file | text |
//! | runs: name, mean solids fraction, [`Sums`] | list of text, f64 and sums |
//! | CRC-32 (IEEE 802.3) of all of the above | u32 |
//!
//! # Format of [`Sums`]
//!
//! | what | type |
//! | --- | --- |
//! | simulated dimensions | u64 |
//! | ρ_s, ρ_g \[kg/m³\] | f64, f64 |
//! | number of the [`Kernel`] | u64 |
//! | edge of a cell along each axis \[m\] | list of f64 |
//! | filter widths \[m\] | list of f64 |
//! | axes of the bins: number of the [`Marker`], quantiles or 0, edges | list of u64, u64 and list of f64 |
//! | duration of a block \[s\] | f64 |
//! | blocks of space along each axis | three u64 |
//! | number of terms in these dimensions, number of quantities | u64, u64 |
//! | blocks: place, instants, filter widths | list of u64, u64 and list of visits |
//! | visits: keys; sums of the terms; spreads | list of u64, list of f64, list of f64 |

use crate::binary::{
    Fault, Source, open, put, put_list, put_text, take, take_list, take_text, write_to,
};
use crate::filtered::{QUANTITY_COUNT, TERM_COUNT, own_terms};
use crate::laws::scales::{Gas, Powder, Scales};
use crate::spectral::Kernel;
use crate::statistics::{Axis, Bins, BlockSums, Layout, Marker, SPREAD, Sums, Visits};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// What a file of sums begins with.
const MAGIC: &[u8; 8] = b"favresum";

/// Version of the format.
const FORMAT: u32 = 2;

/// Name of the file of sums in the folder of a run.
pub const SUMS_FILE: &str = "sums.favre";

/// What sums are of: what must be equal in runs that are pooled.
#[derive(Clone, Debug, PartialEq)]
pub struct SumsSystem {
    /// The powder.
    pub powder: Powder,
    /// The gas.
    pub gas: Gas,
    /// g \[m/s²\].
    pub gravity: f64,
    /// Drag law of the fine grid, as in a case file.
    pub drag: String,
}

impl SumsSystem {
    /// The scales of the powder in the gas.
    pub fn scales(&self) -> Scales {
        Scales::new(&self.powder, &self.gas, self.gravity)
    }
}

/// The sums of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunSums {
    /// Name of the run.
    pub name: String,
    /// Mean solids fraction of its box.
    pub solids_fraction: f64,
    /// Its sums, the start taken off.
    pub sums: Sums,
}

/// Sums of the runs of one powder in one gas.
#[derive(Clone, Debug, PartialEq)]
pub struct SumsFile {
    /// What they are of.
    pub system: SumsSystem,
    /// The runs.
    pub runs: Vec<RunSums>,
}

/// A file of sums that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SumsError {
    /// The file cannot be read.
    #[error("cannot read the sums {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file is of another version of the format.
    #[error(
        "{path} is of version {found} of the format of sums and this program reads {FORMAT}: run \
         its case again",
        path = path.display()
    )]
    Format {
        /// The file.
        path: PathBuf,
        /// Its version.
        found: u32,
    },
    /// The file is not, or no longer, what was written.
    #[error("{path} cannot be used: {what}", path = path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
}

impl SumsFile {
    /// Writes the sums.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: &mut dyn Write) -> io::Result<()> {
        write_to(to, MAGIC, FORMAT, |to| {
            let SumsSystem { powder, gas, gravity, drag } = &self.system;
            let numbers = [
                powder.diameter,
                powder.density,
                powder.restitution,
                powder.max_packing,
                gas.density,
                gas.viscosity,
                *gravity,
            ];
            numbers.into_iter().try_for_each(|number| put(to, number))?;
            put_text(to, drag)?;
            put(to, self.runs.len() as u64)?;
            for RunSums { name, solids_fraction, sums } in &self.runs {
                put_text(to, name)?;
                put(to, *solids_fraction)?;
                put_sums(to, sums)?;
            }
            Ok(())
        })
    }

    /// Reads the file at `path`, or [`SUMS_FILE`] in the folder there.
    ///
    /// # Errors
    /// [`SumsError`] if the file cannot be read, or is not what was written.
    pub fn read(path: &Path) -> Result<Self, SumsError> {
        let path = if path.is_dir() { path.join(SUMS_FILE) } else { path.to_owned() };
        Self::take(&path).map_err(|fault| match fault {
            Fault::Read(source) => SumsError::Read { path, source },
            Fault::Format(found) => SumsError::Format { path, found },
            Fault::Damaged(what) => SumsError::Damaged { path, what },
        })
    }

    fn take(path: &Path) -> Result<Self, Fault> {
        let from = &mut open(path, MAGIC, FORMAT, "file of sums, such as a run leaves")?;
        let mut numbers = [0.0; 7];
        for number in &mut numbers {
            *number = take(from)?;
        }
        let [diameter, density, restitution, max_packing, gas_density, viscosity, gravity] =
            numbers;
        if numbers.iter().any(|number| !(number.is_finite() && *number > 0.0)) {
            return Err(Fault::damaged("its powder or its gas cannot be"));
        }
        let system = SumsSystem {
            powder: Powder { diameter, density, restitution, max_packing },
            gas: Gas { density: gas_density, viscosity },
            gravity,
            drag: take_text(from)?,
        };
        let runs = (0..from.len(24)?)
            .map(|_| {
                let (name, solids_fraction) = (take_text(from)?, take(from)?);
                Ok(RunSums { name, solids_fraction, sums: take_sums(from)? })
            })
            .collect::<Result<_, Fault>>()?;
        Ok(Self { system, runs })
    }
}

/// Writes sums.
pub(crate) fn put_sums(to: &mut dyn Write, sums: &Sums) -> io::Result<()> {
    let Layout { dimension, densities, kernel, spacing, widths, bins, block_duration, space } =
        &sums.layout;
    put(to, *dimension as u64)?;
    densities.iter().try_for_each(|density| put(to, *density))?;
    put(to, *kernel as u64)?;
    put_list(to, spacing)?;
    put_list(to, widths)?;
    put(to, bins.axes.len() as u64)?;
    for Axis { marker, edges, quantiles } in &bins.axes {
        put(to, *marker as u64)?;
        put(to, quantiles.unwrap_or(0) as u64)?;
        put_list(to, edges)?;
    }
    put(to, *block_duration)?;
    space.iter().try_for_each(|blocks| put(to, *blocks as u64))?;
    let terms = own_terms(*dimension);
    put(to, terms as u64)?;
    put(to, QUANTITY_COUNT as u64)?;
    put(to, sums.blocks.len() as u64)?;
    for BlockSums { place, instants, widths } in &sums.blocks {
        put(to, *place)?;
        put(to, *instants)?;
        put(to, widths.len() as u64)?;
        for Visits { keys, sums, spreads } in widths {
            put(to, keys.len() as u64)?;
            keys.iter().try_for_each(|key| put(to, u64::from(*key)))?;
            // Without what two dimensions lack and what fills up the last lanes: zeros.
            put(to, (keys.len() * terms) as u64)?;
            let mut own = sums.chunks(TERM_COUNT).flat_map(|sums| &sums[..terms]);
            own.try_for_each(|sum| put(to, *sum))?;
            put_list(to, spreads)?;
        }
    }
    Ok(())
}

/// Reads sums.
pub(crate) fn take_sums(from: &mut Source) -> Result<Sums, Fault> {
    let dimension = take::<u64>(from)? as usize;
    let densities = [take(from)?, take(from)?];
    let number = take::<u64>(from)?;
    let kernel = usize::try_from(number).ok().and_then(|n| Kernel::ALL.get(n)).copied();
    let kernel = kernel.ok_or_else(|| Fault::damaged("it has an unknown filter kernel"))?;
    let spacing = take_list(from)?;
    if spacing.len() != dimension || spacing.iter().any(|edge| !(edge.is_finite() && *edge > 0.0)) {
        return Err(Fault::damaged("its cells have no edges"));
    }
    let widths = take_list(from)?;
    let axes = (0..from.len(24)?)
        .map(|_| {
            let number = take::<u64>(from)?;
            let marker = usize::try_from(number).ok().and_then(|n| Marker::ALL.get(n)).copied();
            let marker = marker.ok_or_else(|| Fault::damaged("it has an unknown marker"))?;
            let quantiles = Some(take::<u64>(from)? as usize).filter(|quantiles| *quantiles > 0);
            let edges = take_list(from)?;
            let ascending = edges.len() > 1 && edges.is_sorted_by(|a, b| a < b);
            if !ascending {
                return Err(Fault::damaged("the edges of its bins do not ascend"));
            }
            Ok(Axis { marker, edges, quantiles })
        })
        .collect::<Result<Vec<_>, Fault>>()?;
    if axes.first().is_none_or(|axis| axis.marker != Marker::SolidsFraction) {
        return Err(Fault::damaged("its first marker is not the solids fraction"));
    }
    let bins = Bins { axes };
    let block_duration: f64 = take(from)?;
    let mut space = [1; 3];
    for blocks in &mut space {
        *blocks = take::<u64>(from)? as usize;
    }
    let places = space.iter().try_fold(bins.len(), |keys, blocks| keys.checked_mul(*blocks));
    let keys = places.filter(|keys| (1..u32::MAX as usize).contains(keys));
    let Some(keys) = keys.filter(|_| block_duration > 0.0 && (2..=3).contains(&dimension)) else {
        return Err(Fault::damaged("its sums are of no blocks"));
    };
    let terms = own_terms(dimension);
    for (what, ours) in [("terms", terms), ("quantities", QUANTITY_COUNT)] {
        let theirs: u64 = take(from)?;
        if theirs != ours as u64 {
            let what = format!("its sums are of {theirs} {what} instead of {ours}");
            return Err(Fault::Damaged(what));
        }
    }
    let blocks = (0..from.len(24)?)
        .map(|_| {
            let (place, instants) = (take(from)?, take(from)?);
            let of_widths = (0..from.len(24)?)
                .map(|_| take_visits(from, keys, terms))
                .collect::<Result<Vec<Visits>, Fault>>()?;
            if of_widths.len() != widths.len() {
                return Err(Fault::damaged("its sums have other widths than they say"));
            }
            Ok(BlockSums { place, instants, widths: of_widths })
        })
        .collect::<Result<_, Fault>>()?;
    Ok(Sums {
        layout: Layout {
            dimension,
            densities,
            kernel,
            spacing,
            widths,
            bins,
            block_duration,
            space,
        },
        blocks,
    })
}

fn take_visits(from: &mut Source, bins: usize, terms: usize) -> Result<Visits, Fault> {
    let keys = (0..from.len(8)?)
        .map(|_| match take::<u64>(from)? {
            key if key < bins as u64 => Ok(key as u32),
            _ => Err(Fault::damaged("its sums have other bins than they say")),
        })
        .collect::<Result<Vec<u32>, Fault>>()?;
    let (own, spreads) = (take_list(from)?, take_list(from)?);
    let whole = own.len() == keys.len() * terms
        && (spreads.is_empty() || spreads.len() == keys.len() * SPREAD);
    if !whole {
        return Err(Fault::damaged("its sums have other terms than they say"));
    }
    let mut sums = vec![0.0; keys.len() * TERM_COUNT];
    for (sums, own) in sums.chunks_mut(TERM_COUNT).zip(own.chunks(terms)) {
        sums[..terms].copy_from_slice(own);
    }
    Ok(Visits { keys, sums, spreads })
}
