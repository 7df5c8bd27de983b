//! Snapshots: what the filter is given in flight, to .vti or .npz in double precision.
//!
//! Everything of [`FineFields`] is written, at cell centres, to the last bit; with it the grid, the
//! time, the case as text (all of it but its duration), and the means of the box that say when it became
//! steady. A file appears by a rename, complete and on disk, or not at all.

use super::map::vtk_index;
use super::numpy::NpzWriter;
use crate::case::{Case, FieldsChoice};
use crate::fine::{FineFields, symmetric_index};
use std::borrow::Cow;
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

/// Duration that the case in a snapshot gives, in sample intervals: the shortest that is accepted.
const SHORTEST: f64 = 20.0;

/// The formats of snapshots.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// VTK image data.
    Vti,
    /// A NumPy archive.
    Npz,
}

impl Format {
    /// How the names of its files end.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Vti => "vti",
            Self::Npz => "npz",
        }
    }
}

/// What goes with the fields of an instant.
#[derive(Clone, Copy, Debug)]
pub struct Companions<'a> {
    /// The case, as a case file.
    pub case: &'a str,
    /// Mean slip, slip seen by the particles and variance of φ, at the instant and at the start.
    pub signals: [[f64; 4]; 2],
}

/// A field by its name, with its components along x, y and z where it is a vector, and in VTK's order
/// where it is a symmetric tensor.
type Named<'a> = (&'static str, Vec<Cow<'a, [f64]>>);

/// The fields in the order in which they are written; axes that are not simulated hold zeros.
fn named<const D: usize>(fine: &FineFields<D>) -> Vec<Named<'_>> {
    fn scalar(field: &[f64]) -> Vec<Cow<'_, [f64]>> {
        vec![Cow::Borrowed(field)]
    }
    fn vector<const D: usize>(fields: &[Vec<f64>; D]) -> Vec<Cow<'_, [f64]>> {
        let zero = || Cow::Owned(vec![0.0; fields[0].len()]);
        (0..3).map(|a| fields.get(a).map_or_else(zero, |field| Cow::Borrowed(&field[..]))).collect()
    }
    let zero = || Cow::Owned(vec![0.0; fine.grid.len()]);
    let mut stress: Vec<Cow<[f64]>> = (0..6).map(|_| zero()).collect();
    for j in 0..D {
        for i in 0..=j {
            stress[vtk_index(i, j)] = Cow::Borrowed(&fine.solids_stress[symmetric_index(i, j)]);
        }
    }
    vec![
        ("solids_fraction", scalar(&fine.solids_fraction)),
        ("solids_velocity", vector(&fine.solids_velocity)),
        ("gas_velocity", vector(&fine.gas_velocity)),
        ("pressure_gradient", vector(&fine.pressure_gradient)),
        ("drag_coefficient", scalar(&fine.drag_coefficient)),
        ("granular_temperature", scalar(&fine.granular_temperature)),
        ("solids_pressure", scalar(&fine.solids_pressure)),
        ("solids_stress", stress),
    ]
}

/// Writes `fine` to the file `path`.
///
/// # Errors
/// It cannot be written; then nothing of it is left.
pub fn write<const D: usize>(
    path: &Path,
    format: Format,
    fine: &FineFields<D>,
    companions: &Companions,
) -> io::Result<()> {
    let mut partial = path.as_os_str().to_owned();
    partial.push(".partial");
    let partial = Path::new(&partial);
    let result = File::create(partial)
        .and_then(|file| {
            let to = BufWriter::with_capacity(1 << 18, file);
            match format {
                Format::Vti => write_vti(to, fine, companions),
                Format::Npz => write_npz(to, fine, companions),
            }
        })
        .and_then(|to| to.into_inner().map_err(|error| error.into_error()))
        .and_then(|file| file.sync_all())
        .and_then(|()| fs::rename(partial, path));
    if result.is_err() {
        let _ = fs::remove_file(partial);
    }
    result
}

/// Two or three numbers as VTK's three.
fn triple<const D: usize, T: Copy>(values: [T; D], rest: T) -> [T; 3] {
    std::array::from_fn(|axis| if axis < D { values[axis] } else { rest })
}

/// Writes .vti: cell data, appended raw, little-endian, headers of eight bytes.
fn write_vti<const D: usize, W: Write>(
    mut to: W,
    fine: &FineFields<D>,
    companions: &Companions,
) -> io::Result<W> {
    let fields = named(fine);
    let count = fine.grid.len();
    let cells = triple(fine.grid.cells, 0);
    let spacing = triple(fine.grid.spacing, 1.0);
    let extent = cells.map(|n| format!("0 {n}")).join(" ");
    let join = |values: &[f64]| {
        values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(" ")
    };
    let periodic = triple(fine.periodic, false).map(|axis| u8::from(axis).to_string()).join(" ");
    let text = companions.case.bytes().map(|byte| byte.to_string()).collect::<Vec<_>>().join(" ");
    let [now, start] = companions.signals.each_ref().map(|values| join(values));
    writeln!(
        to,
        "<?xml version=\"1.0\"?>\n\
         <VTKFile type=\"ImageData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n\
         <ImageData WholeExtent=\"{extent}\" Origin=\"0 0 0\" Spacing=\"{}\">\n\
         <FieldData>\n\
         <DataArray type=\"Float64\" Name=\"TimeValue\" NumberOfTuples=\"1\" format=\"ascii\">\
         {:?}</DataArray>\n\
         <DataArray type=\"UInt8\" Name=\"periodic\" NumberOfTuples=\"3\" format=\"ascii\">\
         {periodic}</DataArray>\n\
         <DataArray type=\"UInt8\" Name=\"vertical\" NumberOfTuples=\"1\" format=\"ascii\">\
         {}</DataArray>\n\
         <DataArray type=\"Float64\" Name=\"signals\" NumberOfTuples=\"8\" format=\"ascii\">\
         {now} {start}</DataArray>\n\
         <DataArray type=\"UInt8\" Name=\"case\" NumberOfTuples=\"{}\" format=\"ascii\">\
         {text}</DataArray>\n\
         </FieldData>\n\
         <Piece Extent=\"{extent}\">\n\
         <CellData Scalars=\"solids_fraction\" Vectors=\"solids_velocity\">",
        join(&spacing),
        fine.time,
        D - 1,
        companions.case.len(),
    )?;
    let mut offset = 0;
    for (name, components) in &fields {
        let number = components.len();
        writeln!(
            to,
            "<DataArray type=\"Float64\" Name=\"{name}\" NumberOfComponents=\"{number}\" \
             format=\"appended\" offset=\"{offset}\"/>"
        )?;
        offset += 8 + 8 * count * number;
    }
    write!(
        to,
        "</CellData>\n<PointData/>\n</Piece>\n</ImageData>\n<AppendedData encoding=\"raw\">\n_"
    )?;
    for (_, components) in &fields {
        to.write_all(&(8 * (count * components.len()) as u64).to_le_bytes())?;
        for cell in 0..count {
            for component in components {
                to.write_all(&component[cell].to_le_bytes())?;
            }
        }
    }
    write!(to, "\n</AppendedData>\n</VTKFile>\n")?;
    Ok(to)
}

/// Writes .npz: arrays of shape (z, y, x), of vectors (component, z, y, x).
fn write_npz<const D: usize, W: Write + Seek>(
    to: W,
    fine: &FineFields<D>,
    companions: &Companions,
) -> io::Result<W> {
    let mut zip = NpzWriter::new(to);
    let shape: Vec<usize> = fine.grid.cells.iter().rev().copied().collect();
    for (name, components) in named(fine) {
        // A vector has as many components as there are axes, a tensor all six.
        let components = match components.len() {
            3 => &components[..D],
            _ => &components[..],
        };
        let parts: Vec<&[f64]> = components.iter().map(AsRef::as_ref).collect();
        let mut whole = shape.clone();
        if parts.len() > 1 {
            whole.insert(0, parts.len());
        }
        zip.numbers(name, &whole, &parts)?;
    }
    let flags = fine.periodic.map(|axis| f64::from(u8::from(axis)));
    let [now, start] = companions.signals;
    zip.numbers("time", &[1], &[&[fine.time]])?;
    zip.numbers("spacing", &[D], &[&fine.grid.spacing])?;
    zip.numbers("periodic", &[D], &[&flags])?;
    zip.numbers("vertical", &[1], &[&[(D - 1) as f64]])?;
    zip.numbers("signals", &[2, 4], &[&now, &start])?;
    zip.text("axes", if D == 2 { "yx" } else { "zyx" })?;
    zip.text("case", companions.case)?;
    zip.finish()
}

/// Keeps the fields of a box in a folder of its own, one file per snapshot.
#[derive(Clone, Debug)]
pub struct Recorder {
    folder: PathBuf,
    format: Format,
    /// A snapshot is every so many samples.
    every: u64,
    case: String,
}

/// Why a box cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A snapshot cannot be written.
    #[error("cannot write {path}", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A snapshot of before an interruption is gone.
    #[error("{path} is gone, which was written before the interruption: start anew with --force", path = path.display())]
    Gone {
        /// The file.
        path: PathBuf,
    },
}

impl Recorder {
    /// What keeps the fields of `case` in `folder`; none if it asks for none.
    pub fn new(case: &Case, folder: PathBuf) -> Option<Self> {
        let format = match case.output.fields {
            FieldsChoice::None => return None,
            FieldsChoice::Vti => Format::Vti,
            FieldsChoice::Npz => Format::Npz,
        };
        let every =
            (case.output.fields_interval / case.run.sample_interval).round().max(1.0) as u64;
        // A run may be prolonged, and its snapshots are the same then.
        let mut case = case.clone();
        case.run.duration = SHORTEST * case.run.sample_interval;
        Some(Self { folder, format, every, case: case.to_toml() })
    }

    /// Makes the folder, and looks whether the snapshots up to sample number `done` are there.
    ///
    /// # Errors
    /// The folder cannot be made, or a snapshot is gone.
    pub fn begin(&self, done: u64) -> Result<(), RecordError> {
        fs::create_dir_all(&self.folder).map_err(|source| {
            let path = self.folder.clone();
            RecordError::Write { path, source }
        })?;
        match self.names(done).map(|(_, name)| self.folder.join(name)).find(|path| !path.is_file())
        {
            Some(path) => Err(RecordError::Gone { path }),
            None => Ok(()),
        }
    }

    /// Keeps `fine`, if a snapshot is due at sample number `sample`; `signals` gives the means of the
    /// box by the number of a sample.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn record<const D: usize>(
        &self,
        sample: u64,
        fine: &FineFields<D>,
        signals: impl Fn(usize) -> [f64; 4],
    ) -> Result<(), RecordError> {
        if !sample.is_multiple_of(self.every) {
            return Ok(());
        }
        let path = self.folder.join(self.name(sample));
        let companions =
            Companions { case: &self.case, signals: [signals(sample as usize), signals(0)] };
        write(&path, self.format, fine, &companions)
            .map_err(|source| RecordError::Write { path, source })
    }

    /// The format.
    pub fn format(&self) -> Format {
        self.format
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Number of the sample and name of every snapshot up to sample number `last`.
    pub fn names(&self, last: u64) -> impl Iterator<Item = (u64, String)> {
        (1..=last / self.every).map(|n| (n * self.every, self.name(n * self.every)))
    }

    fn name(&self, sample: u64) -> String {
        format!("{sample:06}.{}", self.format.extension())
    }
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
