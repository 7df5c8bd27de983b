//! VTKHDF, written: a series of images in one HDF5 file (.vtkhdf), for ParaView, VTK and h5py.
//!
//! The group `VTKHDF` holds the image by its attributes, `CellData/NAME` of shape (time, z, y, x), of
//! vectors (time, z, y, x, component), without z where there are no cells along it, and `Steps` with the times and the place of each instant in the arrays, as
//! version 2 of the format says. Double precision, shuffled and deflated; each array's attribute `units`
//! is its unit. The library that encodes HDF5 takes a file as a whole, so a series is kept in memory
//! until it is written.

use super::xml::{Image, Named, write_whole};
use hdf5_writer::{
    AttributeBuilder, DatasetBuilder, Datatype, FILTER_DEFLATE, FILTER_SHUFFLE, FilterDescription,
    Hdf5Builder, Hdf5WritePlan, StringEncoding, StringPadding, StringSize, WriteOptions,
};
use std::io::{self, Write};
use std::path::Path;

/// Most bytes of a series, before they are packed.
const MOST: usize = 4 << 30;

/// Numbers of an array, at all instants so far.
#[derive(Clone, Debug)]
struct Gathered {
    name: String,
    unit: &'static str,
    components: usize,
    bytes: Vec<u8>,
}

/// A series of images on one grid.
#[derive(Clone, Debug, Default)]
pub struct ImageSeries {
    /// The first image, without its arrays.
    head: Option<Image<'static>>,
    times: Vec<f64>,
    arrays: Vec<Gathered>,
}

fn invalid(why: impl Into<String>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, why.into())
}

/// What the encoder says, as an error of writing.
fn encoding(error: hdf5_writer::Error) -> io::Error {
    io::Error::other(error)
}

/// Text of a fixed length without an end mark, as VTK reads it.
fn text(name: &str, value: &str) -> AttributeBuilder {
    let kind = Datatype::String {
        size: StringSize::Fixed(value.len() as u32),
        encoding: if value.is_ascii() { StringEncoding::Ascii } else { StringEncoding::Utf8 },
        padding: StringPadding::NullPad,
    };
    AttributeBuilder::new(name, kind, Vec::new(), value.as_bytes())
}

impl ImageSeries {
    /// Adds the image of one instant, later than the ones before.
    ///
    /// # Errors
    /// It is on another grid or has other arrays than the first, or the series grows too long for
    /// memory.
    pub fn push(&mut self, image: &Image) -> io::Result<()> {
        let bare = |image: &Image| {
            let Image { cells, spacing, origin, periodic, vertical, .. } = *image;
            Image { cells, spacing, origin, periodic, vertical, time: 0.0, arrays: vec![] }
        };
        let head = self.head.get_or_insert_with(|| bare(image));
        let grid = |image: &Image| (image.cells, image.spacing, image.origin, image.vertical);
        if grid(head) != grid(image) {
            return Err(invalid("the cells of a series must be the same at all times"));
        }
        if self.times.is_empty() {
            let gathered = |array: &Named| Gathered {
                name: array.name.to_string(),
                unit: array.unit,
                components: array.components.len(),
                bytes: Vec::new(),
            };
            self.arrays = image.arrays.iter().map(gathered).collect();
        }
        let names = |array: &Named| (array.name.to_string(), array.components.len());
        if !self
            .arrays
            .iter()
            .map(|a| (a.name.clone(), a.components))
            .eq(image.arrays.iter().map(names))
        {
            return Err(invalid("the arrays of a series must be the same at all times"));
        }
        for (gathered, array) in self.arrays.iter_mut().zip(&image.arrays) {
            gathered.bytes.extend(array.interleaved());
        }
        self.times.push(image.time);
        let bytes: usize = self.arrays.iter().map(|array| array.bytes.len()).sum();
        if bytes > MOST {
            return Err(invalid(format!(
                "{} instants are {:.1} GiB, and up to {} are kept in memory for one HDF5 file: write \
                 vti files, or give fewer instants",
                self.times.len(),
                bytes as f64 / (1u64 << 30) as f64,
                MOST >> 30
            )));
        }
        Ok(())
    }

    /// Writes the series to the file `path`; nothing of a series without instants.
    ///
    /// # Errors
    /// It cannot be written; then nothing of it is left.
    pub fn write(self, path: &Path) -> io::Result<()> {
        let Some(plan) = self.plan().map_err(encoding)? else { return Ok(()) };
        let bytes = plan.encode(WriteOptions::default()).map_err(encoding)?;
        write_whole(path, |mut to| to.write_all(&bytes).map(|()| to))
    }

    fn plan(self) -> Result<Option<Hdf5WritePlan>, hdf5_writer::Error> {
        let Some(head) = self.head else { return Ok(None) };
        let steps = self.times.len();
        let extent: Vec<i64> = head.cells.iter().flat_map(|n| [0, *n as i64]).collect();
        let periodic = head.periodic.map(i64::from);
        let direction = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let mut file = Hdf5Builder::new();
        for attribute in [
            AttributeBuilder::vector("Version", &[2i64, 0])?,
            text("Type", "ImageData"),
            AttributeBuilder::vector("WholeExtent", &extent)?,
            AttributeBuilder::vector("Origin", &head.origin)?,
            AttributeBuilder::vector("Spacing", &head.spacing)?,
            AttributeBuilder::vector("Direction", &direction)?,
            AttributeBuilder::vector("periodic", &periodic)?,
            AttributeBuilder::scalar("vertical", head.vertical as i64)?,
        ] {
            file = file.group_attribute("VTKHDF", attribute);
        }
        file = file
            .group_attribute("VTKHDF/Steps", AttributeBuilder::scalar("NSteps", steps as i64)?)
            .dataset(
                DatasetBuilder::typed_data("VTKHDF/Steps/Values", [steps as u64], &self.times)?
                    .attribute(text("units", "s")),
            );
        let offsets: Vec<i64> = (0..steps as i64).collect();
        // VTK reads an image without cells along z from arrays without z.
        let cells: Vec<u64> =
            head.cells.iter().rev().filter(|n| **n > 0).map(|n| *n as u64).collect();
        for array in self.arrays {
            let of = |instants: usize| {
                let components = (array.components > 1).then_some(array.components as u64);
                let cells = cells.iter().copied();
                [instants as u64].into_iter().chain(cells).chain(components).collect::<Vec<_>>()
            };
            let filter = |id, value| FilterDescription { id, name: None, client_data: vec![value] };
            let name = format!("VTKHDF/CellData/{}", array.name);
            let set = DatasetBuilder::typed::<f64>(name, of(steps))
                .chunked(of(1))
                .filter(filter(FILTER_SHUFFLE, 8))
                .filter(filter(FILTER_DEFLATE, 4))
                .raw_data(array.bytes)
                .attribute(text("units", array.unit));
            let name = format!("VTKHDF/Steps/CellDataOffsets/{}", array.name);
            let places = DatasetBuilder::typed_data(name, [steps as u64], &offsets)?;
            file = file.dataset(set).dataset(places);
        }
        file.into_plan().map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_series_is_on_one_grid_with_one_set_of_arrays() {
        let values = [1.0; 6];
        let image = |time: f64, name: &'static str| Image {
            cells: [3, 2, 0],
            spacing: [0.5; 3],
            origin: [0.0; 3],
            time,
            periodic: [true, true, false],
            vertical: 1,
            arrays: vec![Named::scalar(name, "-", &values)],
        };
        let mut series = ImageSeries::default();
        series.push(&image(0.0, "a")).unwrap();
        assert!(series.push(&image(1.0, "b")).is_err());
        assert!(series.push(&Image { spacing: [0.4; 3], ..image(1.0, "a") }).is_err());
        series.push(&image(1.0, "a")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        series.write(&folder.path().join("a.vtkhdf")).unwrap();
        let names: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|f| f.unwrap().file_name()).collect();
        assert_eq!(names, ["a.vtkhdf"]);
        ImageSeries::default().write(&folder.path().join("b.vtkhdf")).unwrap();
        assert!(!folder.path().join("b.vtkhdf").exists());
    }
}
