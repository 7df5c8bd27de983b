//! Snapshots: what the filter is given in flight, to .vti or .npz in double precision.
//!
//! Everything of [`FineFields`] is written, at cell centres, to the last bit; with it the grid, the
//! time, the case as text (all of it but its duration), and the means of the box that say when it became
//! steady.

use super::map::vtk_index;
use super::numpy::NpzWriter;
use super::xml::{Image, Named, Points, field_data, write_points, write_vti, write_whole};
use crate::case::{Case, FieldsChoice};
use crate::dem::Sphere;
use crate::fine::{FineFields, symmetric_index};
use std::borrow::Cow;
use std::fs;
use std::io::{self, Seek, Write};
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

/// The fields in the order in which they are written; axes that are not simulated hold zeros.
pub fn named<const D: usize>(fine: &FineFields<D>) -> Vec<Named<'_>> {
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
    let array =
        |name: &'static str, unit, components| Named { name: name.into(), unit, components };
    let mut arrays = vec![
        array("solids_fraction", "-", scalar(&fine.solids_fraction)),
        array("solids_velocity", "m/s", vector(&fine.solids_velocity)),
        array("gas_velocity", "m/s", vector(&fine.gas_velocity)),
        array("pressure_gradient", "Pa/m", vector(&fine.pressure_gradient)),
        array("drag_coefficient", "kg/m³/s", scalar(&fine.drag_coefficient)),
        array("drag", "Pa/m", vector(&fine.drag)),
        array("granular_temperature", "m²/s²", scalar(&fine.granular_temperature)),
        array("solids_pressure", "Pa", scalar(&fine.solids_pressure)),
        array("solids_stress", "Pa", stress),
    ];
    if let Some(counts) = &fine.counts {
        arrays.push(array("number_density", "1/m³", scalar(&counts.number_density)));
        arrays.push(array("contact_density", "1/m³", scalar(&counts.contact_density)));
    }
    arrays
}

/// The fields as an image.
pub fn image<const D: usize>(fine: &FineFields<D>) -> Image<'_> {
    Image {
        cells: triple(fine.grid.cells, 0),
        spacing: triple(fine.grid.spacing, 1.0),
        origin: [0.0; 3],
        time: fine.time,
        periodic: triple(fine.periodic, false),
        vertical: D - 1,
        arrays: named(fine),
    }
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
    write_whole(path, |to| match format {
        Format::Vti => {
            let text: Vec<String> = companions.case.bytes().map(|byte| byte.to_string()).collect();
            let signals: Vec<String> =
                companions.signals.iter().flatten().map(|value| format!("{value:?}")).collect();
            let more = field_data("Float64", "signals", 8, &signals.join(" "))
                + &field_data("UInt8", "case", text.len(), &text.join(" "));
            write_vti(to, &image(fine), &more)
        }
        Format::Npz => write_npz(to, fine, companions),
    })
}

/// Folder of the particles in that of the fields.
const PARTICLES: &str = "particles";

fn particles_name(sample: u64) -> String {
    format!("{sample:06}.vtp")
}

/// Writes the `spheres` at `time` \[s\], in the order of their numbers, to the file (.vtp) `path`.
fn write_spheres(path: &Path, time: f64, spheres: &[Sphere]) -> io::Result<()> {
    let list = |of: &dyn Fn(&Sphere) -> f64| spheres.iter().map(of).collect::<Vec<f64>>();
    let lists =
        |of: fn(&Sphere) -> [f64; 3]| [0, 1, 2].map(|axis| list(&|sphere| of(sphere)[axis]));
    let position = lists(|sphere| sphere.position);
    let velocity = lists(|sphere| sphere.velocity);
    let spin = lists(|sphere| sphere.spin);
    let points = Points {
        time,
        position: position.each_ref().map(|list| &list[..]),
        velocity: velocity.each_ref().map(|list| &list[..]),
        spin: spin.each_ref().map(|list| &list[..]),
        diameter: &list(&|sphere| sphere.diameter),
        id: &(0..spheres.len()).map(|n| n as f64).collect::<Vec<f64>>(),
    };
    write_points(path, &points)
}

/// Two or three numbers as VTK's three.
fn triple<const D: usize, T: Copy>(values: [T; D], rest: T) -> [T; 3] {
    std::array::from_fn(|axis| if axis < D { values[axis] } else { rest })
}

/// Writes .npz: arrays of shape (z, y, x), of vectors (component, z, y, x).
fn write_npz<const D: usize, W: Write + Seek>(
    to: W,
    fine: &FineFields<D>,
    companions: &Companions,
) -> io::Result<W> {
    let mut zip = NpzWriter::new(to);
    let shape: Vec<usize> = fine.grid.cells.iter().rev().copied().collect();
    for Named { name, components, .. } in named(fine) {
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
        zip.numbers(&name, &whole, &parts)?;
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
    /// box by the number of a sample, `particles` the particles if they are followed, which a format
    /// for ParaView has in a folder of their own.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn record<const D: usize>(
        &self,
        sample: u64,
        fine: &FineFields<D>,
        signals: impl Fn(usize) -> [f64; 4],
        particles: &dyn Fn() -> Option<Vec<Sphere>>,
    ) -> Result<(), RecordError> {
        if !sample.is_multiple_of(self.every) {
            return Ok(());
        }
        let path = self.folder.join(self.name(sample));
        let companions =
            Companions { case: &self.case, signals: [signals(sample as usize), signals(0)] };
        write(&path, self.format, fine, &companions)
            .map_err(|source| RecordError::Write { path, source })?;
        if self.format == Format::Vti
            && let Some(spheres) = particles()
        {
            let path = self.folder.join(PARTICLES).join(particles_name(sample));
            fs::create_dir_all(self.folder.join(PARTICLES))
                .and_then(|()| write_spheres(&path, fine.time, &spheres))
                .map_err(|source| RecordError::Write { path, source })?;
        }
        Ok(())
    }

    /// Number of the sample, and name in the folder, of the particles of every snapshot up to sample number
    /// `last`; none if particles are not followed.
    pub fn particles(&self, last: u64) -> impl Iterator<Item = (u64, String)> {
        self.names(last)
            .map(|(sample, _)| (sample, format!("{PARTICLES}/{}", particles_name(sample))))
            .filter(|(_, name)| self.folder.join(name).is_file())
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
