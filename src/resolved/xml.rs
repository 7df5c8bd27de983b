//! VTK's XML files, written: images (.vti), points (.vtp) and series of them (.pvd).
//!
//! Arrays are appended raw, little-endian, in double precision to the last bit, in blocks packed by
//! zlib; each carries its unit where VTK looks for it (`vtkDataArray::UNITS_LABEL`). A file appears by a
//! rename, complete and on disk, or not at all.

use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Bytes of a block that is packed on its own: VTK unpacks block by block.
const BLOCK: usize = 1 << 18;

/// An array to be written.
#[derive(Clone, Debug)]
pub struct Named<'a> {
    /// Its name.
    pub name: Cow<'a, str>,
    /// Its unit; `-` of a number.
    pub unit: &'static str,
    /// Its components, each with one number per cell or point; of a vector along x, y and z, of a
    /// symmetric tensor in VTK's order.
    pub components: Vec<Cow<'a, [f64]>>,
}

impl<'a> Named<'a> {
    /// A scalar.
    pub fn scalar(name: &'a str, unit: &'static str, values: &'a [f64]) -> Self {
        Self { name: name.into(), unit, components: vec![values.into()] }
    }

    /// A vector along x, y and z.
    pub fn vector(name: &'a str, unit: &'static str, values: [&'a [f64]; 3]) -> Self {
        Self { name: name.into(), unit, components: values.map(Cow::Borrowed).to_vec() }
    }

    /// Its numbers as they are written: those of a cell or point together.
    pub(super) fn interleaved(&self) -> Vec<u8> {
        let count = self.components.first().map_or(0, |component| component.len());
        let mut bytes = Vec::with_capacity(8 * count * self.components.len());
        for n in 0..count {
            for component in &self.components {
                bytes.extend_from_slice(&component[n].to_le_bytes());
            }
        }
        bytes
    }
}

/// Fields on equal cells at an instant.
#[derive(Clone, Debug)]
pub struct Image<'a> {
    /// Cells along x, y and z; none along an axis that is not there.
    pub cells: [usize; 3],
    /// Edges of a cell \[m\].
    pub spacing: [f64; 3],
    /// Lower corner \[m\].
    pub origin: [f64; 3],
    /// Time \[s\].
    pub time: f64,
    /// Along which axes the fields repeat themselves.
    pub periodic: [bool; 3],
    /// The vertical axis.
    pub vertical: usize,
    /// The fields.
    pub arrays: Vec<Named<'a>>,
}

/// Particles at an instant; every list has one entry per particle.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a> {
    /// Time \[s\].
    pub time: f64,
    /// Centres along x, y and z \[m\].
    pub position: [&'a [f64]; 3],
    /// Velocities along x, y and z \[m/s\].
    pub velocity: [&'a [f64]; 3],
    /// Angular velocities about x, y and z \[rad/s\].
    pub spin: [&'a [f64]; 3],
    /// Diameters \[m\].
    pub diameter: &'a [f64],
    /// What a particle is known by from one instant to the next.
    pub id: &'a [f64],
}

/// Writes a file by `write`; it appears complete, or not at all.
///
/// # Errors
/// It cannot be written; then nothing of it is left.
pub fn write_whole(
    path: &Path,
    write: impl FnOnce(BufWriter<File>) -> io::Result<BufWriter<File>>,
) -> io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = Path::new(&partial);
    let result = File::create(partial)
        .and_then(|file| write(BufWriter::with_capacity(1 << 18, file)))
        .and_then(|to| to.into_inner().map_err(|error| error.into_error()))
        .and_then(|file| file.sync_all())
        .and_then(|()| fs::rename(partial, path));
    if result.is_err() {
        let _ = fs::remove_file(partial);
    }
    result
}

/// Numbers about a whole file, as text.
pub(super) fn field_data(kind: &str, name: &str, count: usize, text: &str) -> String {
    format!(
        "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfTuples=\"{count}\" \
         format=\"ascii\">{text}</DataArray>\n"
    )
}

fn join<T>(values: &[T], text: impl Fn(&T) -> String) -> String {
    values.iter().map(text).collect::<Vec<_>>().join(" ")
}

/// The arrays of a file: what the head says of each, and their packed bytes.
#[derive(Default)]
struct Appended(Vec<u8>);

impl Appended {
    /// Adds an array of the type `kind`, and gives what the head says of it.
    fn add(
        &mut self,
        kind: &str,
        array: &str,
        components: usize,
        unit: &str,
        bytes: &[u8],
    ) -> String {
        let offset = self.0.len();
        let packed: Vec<Vec<u8>> = bytes.chunks(BLOCK).map(pack).collect();
        let mut head = vec![packed.len(), BLOCK, bytes.len() % BLOCK];
        head.extend(packed.iter().map(Vec::len));
        for word in head {
            self.0.extend_from_slice(&(word as u64).to_le_bytes());
        }
        packed.iter().for_each(|block| self.0.extend_from_slice(block));
        format!(
            "<DataArray type=\"{kind}\" Name=\"{array}\" NumberOfComponents=\"{components}\" \
             format=\"appended\" offset=\"{offset}\">\n<InformationKey name=\"UNITS_LABEL\" \
             location=\"vtkDataArray\">{unit}</InformationKey>\n</DataArray>\n"
        )
    }

    fn add_named(&mut self, array: &Named) -> String {
        let components = array.components.len();
        self.add("Float64", &array.name, components, array.unit, &array.interleaved())
    }

    /// Writes the file: `body` between the tags of the data set of the type `kind`.
    fn write<W: Write>(self, mut to: W, kind: &str, body: &str) -> io::Result<W> {
        write!(
            to,
            "<?xml version=\"1.0\"?>\n<VTKFile type=\"{kind}\" version=\"1.0\" \
             byte_order=\"LittleEndian\" header_type=\"UInt64\" \
             compressor=\"vtkZLibDataCompressor\">\n{body}<AppendedData encoding=\"raw\">\n_"
        )?;
        to.write_all(&self.0)?;
        write!(to, "\n</AppendedData>\n</VTKFile>\n")?;
        Ok(to)
    }
}

/// `bytes`, packed: fast, because digits of a flow hold little that is alike.
fn pack(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::with_capacity(bytes.len()), Compression::fast());
    // A list of bytes takes whatever is written to it.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// Writes .vti of `image` as cell data; `more` is further field data.
pub(super) fn write_vti<W: Write>(to: W, image: &Image, more: &str) -> io::Result<W> {
    let mut appended = Appended::default();
    let arrays: String = image.arrays.iter().map(|array| appended.add_named(array)).collect();
    let extent = join(&image.cells, |n| format!("0 {n}"));
    let number = |value: &f64| format!("{value:?}");
    let body = format!(
        "<ImageData WholeExtent=\"{extent}\" Origin=\"{}\" Spacing=\"{}\">\n<FieldData>\n{}{}{}{more}\
         </FieldData>\n<Piece Extent=\"{extent}\">\n\
         <CellData Scalars=\"solids_fraction\" Vectors=\"solids_velocity\">\n{arrays}</CellData>\n\
         <PointData/>\n</Piece>\n</ImageData>\n",
        join(&image.origin, number),
        join(&image.spacing, number),
        field_data("Float64", "TimeValue", 1, &number(&image.time)),
        field_data("UInt8", "periodic", 3, &join(&image.periodic, |p| u8::from(*p).to_string())),
        field_data("UInt8", "vertical", 1, &image.vertical.to_string()),
    );
    appended.write(to, "ImageData", &body)
}

/// Writes `image` to the file (.vti) `path`.
///
/// # Errors
/// It cannot be written; then nothing of it is left.
pub fn write_image(path: &Path, image: &Image) -> io::Result<()> {
    write_whole(path, |to| write_vti(to, image, ""))
}

/// Writes `points` to the file (.vtp) `path`.
///
/// # Errors
/// It cannot be written; then nothing of it is left.
///
/// # Panics
/// If the lists are not all of one length.
pub fn write_points(path: &Path, points: &Points) -> io::Result<()> {
    let count = points.diameter.len();
    let vectors = [points.position, points.velocity, points.spin];
    let lists = vectors.iter().flatten().chain([&points.id]);
    assert!(lists.into_iter().all(|list| list.len() == count), "lists of {count} particles");
    write_whole(path, |to| {
        let mut appended = Appended::default();
        let place = appended.add_named(&Named::vector("Points", "m", points.position));
        let arrays: String = [
            Named::vector("velocity", "m/s", points.velocity),
            Named::vector("spin", "rad/s", points.spin),
            Named::scalar("diameter", "m", points.diameter),
            Named::scalar("id", "-", points.id),
        ]
        .iter()
        .map(|array| appended.add_named(array))
        .collect();
        let mut whole = |name: &str, first: i64| {
            let bytes: Vec<u8> = (first..count as i64 + first).flat_map(i64::to_le_bytes).collect();
            appended.add("Int64", name, 1, "-", &bytes)
        };
        let (connectivity, offsets) = (whole("connectivity", 0), whole("offsets", 1));
        let body = format!(
            "<PolyData>\n<FieldData>\n{}</FieldData>\n<Piece NumberOfPoints=\"{count}\" \
             NumberOfVerts=\"{count}\" NumberOfLines=\"0\" NumberOfStrips=\"0\" \
             NumberOfPolys=\"0\">\n<PointData Scalars=\"diameter\" Vectors=\"velocity\">\n{arrays}\
             </PointData>\n<CellData/>\n<Points>\n{place}</Points>\n<Verts>\n{connectivity}{offsets}\
             </Verts>\n</Piece>\n</PolyData>\n",
            field_data("Float64", "TimeValue", 1, &format!("{:?}", points.time)),
        );
        appended.write(to, "PolyData", &body)
    })
}

/// Writes the series (.pvd) of `files`, each with its time \[s\].
///
/// # Errors
/// Those of `to`.
pub fn write_series(
    to: &mut dyn Write,
    files: impl Iterator<Item = (f64, String)>,
) -> io::Result<()> {
    writeln!(
        to,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\">\n<Collection>"
    )?;
    for (time, file) in files {
        writeln!(to, "<DataSet timestep=\"{time:?}\" part=\"0\" file=\"{file}\"/>")?;
    }
    writeln!(to, "</Collection>\n</VTKFile>")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::resolved::vtk;

    #[test]
    fn particles_come_back_as_they_were() {
        for count in [0usize, 1, 70_000] {
            let list = |factor: f64| -> Vec<f64> {
                (0..count).map(|n| (factor * n as f64).sin()).collect()
            };
            let lists: Vec<Vec<f64>> = (1..=11).map(|factor| list(factor as f64)).collect();
            let vector = |n: usize| [&lists[n][..], &lists[n + 1], &lists[n + 2]];
            let points = Points {
                time: 0.1 + 0.2,
                position: vector(0),
                velocity: vector(3),
                spin: vector(6),
                diameter: &lists[9],
                id: &lists[10],
            };
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("particles.vtp");
            write_points(&path, &points).unwrap();
            let piece = vtk::read(&path, &|_| true).unwrap();
            assert_eq!((piece.time, piece.particles), (Some(0.1 + 0.2), true));
            for (name, first, components) in
                [("velocity", 3, 3), ("spin", 6, 3), ("diameter", 9, 1), ("id", 10, 1)]
            {
                let found = piece.arrays.iter().find(|array| array.name == name).unwrap();
                assert_eq!(found.columns, lists[first..first + components], "{name}");
            }
        }
    }
}
