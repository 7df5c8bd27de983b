//! Fields on disk: snapshots give the bins of the flight; files of the real programs are read right;
//! what cannot be used is refused with file, array, cell and remedy.
//!
//! Files of other programs are made by running them. Where one is not installed its test says so and
//! does nothing: `.ci/run` installs them.

// A loop over the axes, or over cells, indexes several arrays at once.
#![allow(clippy::needless_range_loop)]

mod common;

use assert_cmd::cargo::cargo_bin;
use common::{SYSTEM, python};
use favre::resolved::map::Map;
use favre::resolved::openfoam::{self, Mesh};
use favre::resolved::series::{Reader, runs};
use favre::resolved::{Lattice, Piece, Resolved, vtk};
use favre::stored::Pressure;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn favre(dir: &Path, arguments: &[&str]) -> Output {
    Command::new(cargo_bin!("favre")).current_dir(dir).args(arguments).output().unwrap()
}

fn succeeds(dir: &Path, arguments: &[&str]) {
    let output = favre(dir, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// The message of a call that is refused as misuse, and leaves nothing.
fn refused(dir: &Path, arguments: &[&str]) -> String {
    let arguments: Vec<&str> =
        ["filter", "--out", "refused"].iter().chain(arguments).copied().collect();
    let output = favre(dir, &arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(!dir.join("refused").exists() && !dir.join("refused.partial").exists());
    message
}

fn run_python(python: &Path, dir: &Path, script: &str) {
    let output = Command::new(python).current_dir(dir).args(["-c", script]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn bins(dir: &Path, run: &str) -> String {
    fs::read_to_string(dir.join(run).join("bins.csv")).unwrap()
}

/// Simulates and keeps the fields in `format`, and gives the bins of the flight.
fn fly(dir: &Path, domain: &str, format: &str) -> String {
    let case = format!("{SYSTEM}{domain}[output]\nfields = \"{format}\"\n");
    fs::write(dir.join("case.toml"), case).unwrap();
    succeeds(dir, &["simulate", "case.toml", "--out", "flight", "--quiet"]);
    assert!(!dir.join("flight.checkpoint").exists());
    bins(dir, "flight")
}

const FLAT: &str = r#"[box]
size = [0.04, 0.06]
cells = [16, 24]
solids_fraction = [0.1, 0.2]
[filter]
widths = [0.005, 0.01]
markers = ["solids_fraction", "slip"]
[run]
duration = "60 u_t/g"
"#;

const SOLID: &str = r#"[box]
size = [0.02, 0.025, 0.03]
cells = [8, 10, 12]
solids_fraction = 0.15
[filter]
widths = [0.005]
[run]
duration = "12 u_t/g"
precision = "f32"
"#;

/// 907 particles, followed one by one.
const PARTICLES: &str = r#"[box]
size = ["6.64 L_II", "6.64 L_II", "6.64 L_II"]
cells = [8, 8, 8]
solids_fraction = 0.025
[physics]
solver = "cfd-dem"
[particles]
overlap = 0.02
[filter]
widths = ["1.66 L_II"]
[run]
duration = "5 u_t/g"
sample_interval = "0.25 u_t/g"
"#;

#[test]
fn particles_are_kept_beside_their_fields_and_those_give_the_bins_of_the_flight() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let flight = fly(dir, PARTICLES, "vti");
    succeeds(dir, &["filter", "flight/fields_0.025", "--out", "disk"]);
    assert!(bins(dir, "disk") == flight, "bins differ");
    let series = fs::read_to_string(dir.join("flight/particles_0.025.pvd")).unwrap();
    assert_eq!(series.matches("<DataSet ").count(), 20);
    let mut last: Option<Vec<f64>> = None;
    for sample in 1..=20 {
        let name = format!("fields_0.025/particles/{sample:06}.vtp");
        assert!(series.contains(&name));
        let piece = vtk::read(&dir.join("flight").join(&name), &|_| true).unwrap();
        assert!(piece.particles);
        let fall = &piece.arrays.iter().find(|array| array.name == "velocity").unwrap().columns[2];
        // 0.025 of 8.01 mm³ are 906.7 spheres of 75 um.
        assert_eq!(fall.len(), 907);
        assert!(last.as_ref() != Some(fall));
        last = Some(fall.clone());
    }
}

#[test]
fn snapshots_give_the_bins_of_the_flight() {
    for format in ["vti", "npz"] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        let flight = fly(dir, FLAT, format);
        let fields = ["flight/fields_0.1", "flight/fields_0.2"];
        succeeds(dir, &["filter", fields[0], fields[1], "--out", "disk"]);
        assert!(bins(dir, "disk") == flight, "{format}: bins differ");
        // Neither threads nor the order on the command line matter to one run.
        if format == "vti" {
            let series = ["flight/fields_0.1.pvd", "flight/fields_0.2.pvd"];
            succeeds(dir, &["filter", series[0], series[1], "--out", "pvd", "--threads", "1"]);
            assert!(bins(dir, "pvd") == flight, "bins of the series differ");
        }
        // The sums of the snapshots are those of the flight, and pool as they do.
        succeeds(dir, &["filter", "disk", "--out", "pool"]);
        assert!(bins(dir, "pool") == flight);
    }
    let folder = tempfile::tempdir().unwrap();
    let flight = fly(folder.path(), SOLID, "npz");
    succeeds(folder.path(), &["filter", "flight/fields_0.15", "--out", "disk"]);
    assert!(bins(folder.path(), "disk") == flight);
}

#[test]
fn a_run_that_goes_on_keeps_the_snapshots_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let flight = fly(dir, FLAT, "vti");
    let case = fs::read_to_string(dir.join("case.toml")).unwrap();
    // The same run in two pieces: the first is kept at its end by a longer duration asked for later.
    let brief = case.replace("60 u_t/g", "600 u_t/g");
    fs::write(dir.join("long.toml"), brief).unwrap();
    let mut child = Command::new(cargo_bin!("favre"))
        .current_dir(dir)
        .args(["simulate", "long.toml", "--out", "pieces", "--quiet"])
        .args(["--checkpoint-minutes", "1e-6"])
        .spawn()
        .unwrap();
    let snapshot = dir.join("pieces.checkpoint/fields_0.1/000010.vti");
    let begin = std::time::Instant::now();
    while !snapshot.exists() && begin.elapsed().as_secs() < 60 {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(snapshot.exists());
    succeeds(
        dir,
        &[
            "simulate",
            "long.toml",
            "--out",
            "pieces",
            "--quiet",
            "--resume",
            "--duration",
            "60 u_t/g",
        ],
    );
    assert!(bins(dir, "pieces") == flight, "bins differ");
    assert!(!dir.join("pieces.checkpoint").exists());
    for name in ["000001.vti", "000010.vti", "000120.vti"] {
        let read = |run: &str| fs::read(dir.join(run).join("fields_0.1").join(name)).unwrap();
        assert!(read("pieces") == read("flight"), "{name} differs");
    }
}

#[test]
fn snapshots_through_vtk_and_numpy_and_back_give_the_same_bins() {
    let (Some(python), Some(_)) = (python("vtk"), python("numpy")) else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let flight = fly(dir, SOLID, "vti");
    run_python(
        &python,
        dir,
        r#"
import glob, os, numpy as np, vtk
from vtk.util.numpy_support import vtk_to_numpy
for name in ('image', 'rectilinear', 'unstructured', 'numpy'): os.mkdir(name)
for file in glob.glob('flight/fields_0.15/*.vti'):
    stem = os.path.splitext(os.path.basename(file))[0]
    reader = vtk.vtkXMLImageDataReader(); reader.SetFileName(file); reader.Update()
    image = reader.GetOutput()
    writer = vtk.vtkXMLImageDataWriter(); writer.SetCompressorTypeToLZ4()
    writer.SetFileName('image/' + stem + '.vti'); writer.SetInputData(image); assert writer.Write()
    grid = vtk.vtkRectilinearGrid(); grid.SetDimensions(image.GetDimensions())
    for axis, put in enumerate((grid.SetXCoordinates, grid.SetYCoordinates, grid.SetZCoordinates)):
        at = vtk.vtkDoubleArray()
        for n in range(image.GetDimensions()[axis]): at.InsertNextValue(n * image.GetSpacing()[axis])
        put(at)
    grid.GetCellData().DeepCopy(image.GetCellData()); grid.SetFieldData(image.GetFieldData())
    writer = vtk.vtkXMLRectilinearGridWriter(); writer.SetDataModeToBinary()
    writer.SetFileName('rectilinear/' + stem + '.vtr'); writer.SetInputData(grid); assert writer.Write()
    append = vtk.vtkAppendFilter(); append.SetOutputPointsPrecision(0); append.AddInputData(image); append.Update()
    cells = append.GetOutput(); cells.SetFieldData(image.GetFieldData())
    writer = vtk.vtkXMLUnstructuredGridWriter(); writer.SetDataModeToAppended(); writer.EncodeAppendedDataOff()
    writer.SetFileName('unstructured/' + stem + '.vtu'); writer.SetInputData(cells); assert writer.Write()
    nx, ny, nz = (n - 1 for n in image.GetDimensions())
    arrays = {}
    for n in range(image.GetCellData().GetNumberOfArrays()):
        a = vtk_to_numpy(image.GetCellData().GetArray(n))
        arrays[image.GetCellData().GetArrayName(n)] = a.reshape((nz, ny, nx) + a.shape[1:])
    for n in range(image.GetFieldData().GetNumberOfArrays()):
        name = image.GetFieldData().GetArrayName(n)
        a = vtk_to_numpy(image.GetFieldData().GetArray(n))
        arrays['time' if name == 'TimeValue' else name] = a
    np.savez_compressed('numpy/' + stem, spacing=image.GetSpacing(), axes=np.frombuffer(b'zyx', 'u1'), **arrays)
"#,
    );
    for format in ["image", "rectilinear", "unstructured", "numpy"] {
        succeeds(dir, &["filter", format, "--out", &format!("{format}-bins")]);
        assert!(bins(dir, &format!("{format}-bins")) == flight, "{format}: bins differ");
    }
}

/// Centre of cell `n`.
fn centre(lattice: &Lattice, n: usize) -> [f64; 3] {
    let cell = lattice.cell(n);
    std::array::from_fn(|a| lattice.origin[a] + (cell[a] as f64 + 0.5) * lattice.spacing[a])
}

/// Checks that the arrays `s` and `v` are x + 10 y + 100 z and the centre.
fn check_centres(piece: &Piece, tolerance: f64, label: &str) {
    let lattice = piece.lattice.unwrap();
    let array = |name: &str| &piece.arrays.iter().find(|array| array.name == name).unwrap().columns;
    for n in 0..lattice.len() {
        let x = centre(&lattice, n);
        let s = array("s")[0][n];
        assert!((s - (x[0] + 10.0 * x[1] + 100.0 * x[2])).abs() < tolerance, "{label}: {n}: {s}");
        for axis in 0..3 {
            assert!((array("v")[axis][n] - x[axis]).abs() < tolerance, "{label}: {n}");
        }
    }
}

#[test]
fn files_of_the_real_vtk_are_read_in_all_their_encodings() {
    let Some(python) = python("vtk") else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    run_python(
        &python,
        dir,
        r#"
import vtk
image = vtk.vtkImageData()
image.SetExtent(2, 7, -1, 3, 0, 3); image.SetSpacing(0.5, 0.25, 0.125); image.SetOrigin(1, 2, 3)
def fill(data):
    s = vtk.vtkDoubleArray(); s.SetName('s')
    v = vtk.vtkDoubleArray(); v.SetName('v'); v.SetNumberOfComponents(3)
    i = vtk.vtkIntArray(); i.SetName('i')
    for n in range(data.GetNumberOfCells()):
        b = data.GetCell(n).GetBounds()
        x = [(b[0] + b[1]) / 2, (b[2] + b[3]) / 2, (b[4] + b[5]) / 2]
        s.InsertNextValue(x[0] + 10 * x[1] + 100 * x[2]); v.InsertNextTuple3(*x); i.InsertNextValue(n)
    for a in (s, v, i): data.GetCellData().AddArray(a)
    t = vtk.vtkDoubleArray(); t.SetName('TimeValue'); t.InsertNextValue(0.75)
    data.GetFieldData().AddArray(t)
fill(image)
grid = vtk.vtkRectilinearGrid(); grid.SetExtent(image.GetExtent())
for axis, put in enumerate((grid.SetXCoordinates, grid.SetYCoordinates, grid.SetZCoordinates)):
    at = vtk.vtkFloatArray()
    e = image.GetExtent()
    for n in range(e[2 * axis], e[2 * axis + 1] + 1):
        at.InsertNextValue(image.GetOrigin()[axis] + n * image.GetSpacing()[axis])
    put(at)
fill(grid)
append = vtk.vtkAppendFilter(); append.AddInputData(image); append.Update(); cells = append.GetOutput()
# Another order of the cells: odd ones first.
ids = vtk.vtkIdTypeArray(); n = cells.GetNumberOfCells()
extract = vtk.vtkUnstructuredGrid(); extract.SetPoints(cells.GetPoints()); extract.Allocate(n)
extract.GetCellData().CopyAllocate(cells.GetCellData(), n)
for k, c in enumerate([c for c in range(n) if c % 2] + [c for c in range(n) if c % 2 == 0]):
    p = cells.GetCell(c).GetPointIds(); extract.InsertNextCell(cells.GetCellType(c), p)
    extract.GetCellData().CopyData(cells.GetCellData(), c, k)
t = vtk.vtkDoubleArray(); t.SetName('TimeValue'); t.InsertNextValue(0.75); extract.GetFieldData().AddArray(t)
for kind, data, Writer in (('vti', image, vtk.vtkXMLImageDataWriter), ('vtr', grid, vtk.vtkXMLRectilinearGridWriter), ('vtu', extract, vtk.vtkXMLUnstructuredGridWriter)):
    for mode in ('ascii', 'binary', 'base64', 'raw'):
        for compressor in ('none', 'zlib', 'lz4', 'lzma'):
            for big in (0, 1):
                w = Writer(); w.SetInputData(data); w.SetFileName(f'{mode}-{compressor}-{big}.{kind}')
                {'ascii': w.SetDataModeToAscii, 'binary': w.SetDataModeToBinary}.get(mode, w.SetDataModeToAppended)()
                w.SetEncodeAppendedData(mode == 'base64')
                {'none': w.SetCompressorTypeToNone, 'zlib': w.SetCompressorTypeToZLib, 'lz4': w.SetCompressorTypeToLZ4, 'lzma': w.SetCompressorTypeToLZMA}[compressor]()
                w.SetBlockSize(256)
                w.SetHeaderTypeToUInt64() if big else w.SetHeaderTypeToUInt32()
                w.SetByteOrderToBigEndian() if big else w.SetByteOrderToLittleEndian()
                assert w.Write()
"#,
    );
    let mut seen = 0;
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        let label = path.file_name().unwrap().to_string_lossy().into_owned();
        let piece = vtk::read(&path, &|name| name != "i").unwrap_or_else(|error| panic!("{error}"));
        let lattice = piece.lattice.unwrap();
        assert_eq!(lattice.cells, [5, 4, 3], "{label}");
        for axis in 0..3 {
            let expected = ([0.5, 0.25, 0.125][axis], [2.0, 1.75, 3.0][axis]);
            assert!((lattice.spacing[axis] - expected.0).abs() < 1e-6, "{label}: {lattice:?}");
            assert!((lattice.origin[axis] - expected.1).abs() < 1e-6, "{label}: {lattice:?}");
        }
        assert_eq!(piece.time, Some(0.75), "{label}");
        assert_eq!(piece.others, [("i".to_owned(), None)]);
        // VTK writes six digits to ascii files; points are single precision.
        check_centres(&piece, if label.starts_with("ascii") { 2e-3 } else { 1e-5 }, &label);
        seen += 1;
    }
    assert_eq!(seen, 96);
}

/// An OpenFOAM case of one block: cyclic along x, walls along y and z.
fn foam_case(dir: &Path, format: &str) {
    let write = |name: &str, class: &str, body: &str| {
        let path = dir.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        let header = "FoamFile { version 2.0; format ascii; class";
        let object = path.file_name().unwrap().to_str().unwrap();
        fs::write(&path, format!("{header} {class}; object {object}; }}\n{body}")).unwrap();
    };
    write(
        "system/controlDict",
        "dictionary",
        &format!(
            "application none; startFrom startTime; startTime 0.5; stopAt endTime; endTime 1; deltaT \
             0.1; writeControl timeStep; writeInterval 1; writeFormat {format}; writePrecision 17; \
             timePrecision 6;"
        ),
    );
    write(
        "system/fvSchemes",
        "dictionary",
        "ddtSchemes {default none;} gradSchemes {default Gauss linear;} divSchemes {default none;}
         laplacianSchemes {default none;} interpolationSchemes {default linear;} snGradSchemes {}",
    );
    write("system/fvSolution", "dictionary", "");
    write(
        "system/blockMeshDict",
        "dictionary",
        "convertToMeters 0.001;
        vertices ((0 0 0) (12 0 0) (12 10 0) (0 10 0) (0 0 8) (12 0 8) (12 10 8) (0 10 8));
        blocks (hex (0 1 2 3 4 5 6 7) (12 10 8) simpleGrading (1 1 1));
        boundary (
          left {type cyclic; neighbourPatch right; faces ((0 4 7 3));}
          right {type cyclic; neighbourPatch left; faces ((1 2 6 5));}
          walls {type wall; faces ((0 1 5 4) (3 7 6 2) (0 3 2 1) (4 5 6 7));}
        );",
    );
    write(
        "constant/g",
        "uniformDimensionedVectorField",
        "dimensions [0 1 -2 0 0 0 0]; value (0 -9.81 0);",
    );
    let boundary = |rest: &str| {
        format!(
            "boundaryField {{ left {{type cyclic;}} right {{type cyclic;}} walls {{type {rest};}} }}"
        )
    };
    let list = |kind: &str, value: &dyn Fn([f64; 3]) -> String| {
        let mut text = format!("internalField nonuniform List<{kind}> 960\n(\n");
        for n in 0..960 {
            let cell = [n % 12, n / 12 % 10, n / 120];
            text += &value(cell.map(|i| 0.001 * (i as f64 + 0.5)));
            text.push('\n');
        }
        text + ");\n"
    };
    let scalar = |name: &str, dimensions: &str, internal: &str| {
        let text = format!("dimensions {dimensions};\n{internal}{}", boundary("zeroGradient"));
        write(&format!("0.5/{name}"), "volScalarField", &text);
    };
    let vector = |name: &str, internal: &str| {
        let text = format!("dimensions [0 1 -1 0 0 0 0];\n{internal}{}", boundary("zeroGradient"));
        write(&format!("0.5/{name}"), "volVectorField", &text);
    };
    let fraction = |x: [f64; 3]| format!("{:e}", foam_fraction(x));
    scalar("alpha.particles", "[0 0 0 0 0 0 0]", &list("scalar", &fraction));
    scalar("Theta.particles", "[0 2 -2 0 0 0 0]", "internalField uniform 1e-3;\n");
    scalar("p_rgh", "[1 -1 -2 0 0 0 0]", &list("scalar", &|x| format!("{:e}", 1e4 * x[1])));
    let solids = |x: [f64; 3]| format!("({:e} {:e} {:e})", x[0], -x[1], x[2]);
    vector("U.particles", &list("vector", &solids));
    vector("U.air", "internalField uniform (0 0.2 0);\n");
}

fn foam_fraction(x: [f64; 3]) -> f64 {
    0.1 + 5.0 * x[0] + 3.0 * x[1] + 2.0 * x[2]
}

/// Runs an OpenFOAM program; false where it is not installed.
fn foam(dir: &Path, program: &str, arguments: &[&str]) -> bool {
    let share = "/usr/share/openfoam";
    let directory = std::env::var("WM_PROJECT_DIR").unwrap_or_else(|_| share.into());
    let output = Command::new(program)
        .env("WM_PROJECT_DIR", directory)
        .current_dir(dir)
        .args(arguments)
        .output();
    let Ok(output) = output else {
        eprintln!("skipped: no {program} of OpenFOAM; `apt-get install openfoam`");
        return false;
    };
    assert!(
        output.status.success(),
        "{program}: {}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    true
}

#[test]
fn a_case_of_the_real_openfoam_is_read_in_ascii_and_binary_and_renumbered() {
    for format in ["ascii", "binary"] {
        let folder = tempfile::tempdir().unwrap();
        let dir = folder.path();
        foam_case(dir, format);
        if !foam(dir, "blockMesh", &[]) {
            return;
        }
        // Another order of the cells, and the fields in the format asked for.
        foam(dir, "renumberMesh", &["-overwrite"]);
        foam(dir, "postProcess", &["-func", "writeCellCentres", "-time", "0.5"]);
        let time = dir.join("0.5");
        let mesh = Mesh::of(&time).unwrap();
        let piece = openfoam::read(&time, &mesh, &|_| true).unwrap();
        let lattice = piece.lattice.unwrap();
        assert_eq!(lattice.cells, [12, 10, 8]);
        assert_eq!((piece.periodic, piece.vertical), (Some([true, false, false]), Some(1)));
        let array = |name: &str| &piece.arrays.iter().find(|a| a.name == name).unwrap().columns;
        for n in 0..lattice.len() {
            let x = centre(&lattice, n);
            for axis in 0..3 {
                assert!((array("C")[axis][n] - x[axis]).abs() < 1e-12, "{format}: cell {n}");
            }
            let phi = array("alpha.particles")[0][n];
            assert!((phi - foam_fraction(x)).abs() < 1e-12, "{format}: {n}");
            assert_eq!(array("Theta.particles")[0][n], 1e-3);
        }
        let file = fs::read(time.join("alpha.particles")).unwrap();
        assert_eq!(String::from_utf8_lossy(&file[..800]).contains("binary"), format == "binary");

        // By the map: axes turned so that the last is vertical, and p from p_rgh.
        fs::write(dir.join("map.toml"), format!("{SYSTEM}[filter]\nwidths = [0.002]\n")).unwrap();
        let map = Map::load(&dir.join("map.toml")).unwrap();
        let all = runs(&[dir.to_owned()], &map).unwrap();
        assert_eq!((all.len(), all[0].len(), all[0][0].time), (1, 1, 0.5));
        let Resolved { fields, .. } = Reader::new(&map).read(&all[0][0], 1.0).unwrap();
        assert_eq!(
            (&fields.cells[..], &fields.periodic[..]),
            (&[8, 12, 10][..], &[false, true, false][..])
        );
        let Some(Pressure::Field(pressure)) = &fields.pressure else { panic!("no pressure") };
        for n in 0..960 {
            let x = [n / 8 % 12, n / 96, n % 8].map(|i| 0.001 * (i as f64 + 0.5));
            let phi = foam_fraction(x);
            assert!((fields.solids_fraction[n] - phi).abs() < 1e-12);
            assert!((fields.solids_velocity[2][n] + x[1]).abs() < 1e-12);
            assert!((fields.solids_velocity[0][n] - x[2]).abs() < 1e-12);
            let p = 1e4 * x[1] - (phi * 1500.0 + (1.0 - phi) * 1.3) * 9.81 * x[1];
            assert!((pressure[n] - p).abs() < 1e-9 * 1e4, "{} {p}", pressure[n]);
        }
        succeeds(dir, &["filter", "0.5", "--map", "map.toml", "--out", "bins"]);
        assert!(bins(dir, "bins").contains("drag_correction"));
    }
}

#[test]
fn fields_that_openfoam_set_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    foam_case(dir, "binary");
    fs::write(
        dir.join("system/setFieldsDict"),
        "FoamFile { version 2.0; format ascii; class dictionary; object setFieldsDict; }
        defaultFieldValues (volScalarFieldValue alpha.particles 0.1);
        regions (boxToCell { box (0 0 0) (0.006 0.005 1);
          fieldValues (volScalarFieldValue alpha.particles 0.3); });",
    )
    .unwrap();
    if !foam(dir, "blockMesh", &[]) {
        return;
    }
    foam(dir, "setFields", &[]);
    let time = dir.join("0.5");
    let piece = openfoam::read(&time, &Mesh::of(&time).unwrap(), &|name| name == "alpha.particles")
        .unwrap();
    let lattice = piece.lattice.unwrap();
    for n in 0..lattice.len() {
        let x = centre(&lattice, n);
        let expected = if x[0] < 0.006 && x[1] < 0.005 { 0.3 } else { 0.1 };
        assert_eq!(piece.arrays[0].columns[0][n], expected);
    }
}

/// A .vti of 8 x 8 cells with sound fields, as text that a test can spoil.
fn vti() -> String {
    let repeat = |text: &str, count: usize| vec![text; count].join(" ");
    let fraction: Vec<String> = (0..64).map(|n| format!("0.{}", 100 + n)).collect();
    format!(
        "<VTKFile type=\"ImageData\" version=\"1.0\">
<ImageData WholeExtent=\"0 8 0 8 0 0\" Origin=\"0 0 0\" Spacing=\"0.001 0.001 1\">
<FieldData><DataArray type=\"Float64\" Name=\"TimeValue\" format=\"ascii\">0.5</DataArray></FieldData>
<Piece Extent=\"0 8 0 8 0 0\"><CellData>
<DataArray type=\"Float64\" Name=\"EP_g\" format=\"ascii\">{}</DataArray>
<DataArray type=\"Float64\" Name=\"phi\" format=\"ascii\">{}</DataArray>
<DataArray type=\"Float64\" Name=\"U_g\" format=\"ascii\">{}</DataArray>
<DataArray type=\"Float64\" Name=\"V_g\" format=\"ascii\">{}</DataArray>
<DataArray type=\"Float64\" Name=\"Us\" NumberOfComponents=\"3\" format=\"ascii\">{}</DataArray>
<DataArray type=\"Float64\" Name=\"p\" format=\"ascii\">{}</DataArray>
</CellData>
<PointData><DataArray type=\"Float64\" Name=\"corner\" format=\"ascii\">{}</DataArray></PointData>
</Piece></ImageData></VTKFile>",
        repeat("0.8", 64),
        fraction.join(" "),
        repeat("0.0", 64),
        repeat("0.3", 64),
        repeat("0 0.1 0", 64),
        repeat("5.0", 64),
        repeat("1", 81),
    )
}

const MAP: &str = r#"[fields]
solids_fraction = "phi"
solids_velocity = "Us"
gas_velocity = ["U_g", "V_g"]
[grid]
periodic = ["x", "y"]
[filter]
widths = [0.002]
"#;

/// The message when the file or the map are spoiled by replacing one text by another.
fn spoiled(file: (&str, &str), map: (&str, &str)) -> String {
    let folder = tempfile::tempdir().unwrap();
    let whole = format!("{MAP}{SYSTEM}");
    for (text, (from, _)) in [(vti(), file), (whole.clone(), map)] {
        assert!(text.contains(from), "{from}");
    }
    fs::write(folder.path().join("a.vti"), vti().replacen(file.0, file.1, 1)).unwrap();
    fs::write(folder.path().join("map.toml"), whole.replacen(map.0, map.1, 1)).unwrap();
    refused(folder.path(), &["a.vti", "--map", "map.toml"])
}

#[test]
fn sound_fields_are_filtered() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::write(dir.join("a.vti"), vti()).unwrap();
    fs::write(dir.join("map.toml"), format!("{MAP}{SYSTEM}")).unwrap();
    succeeds(dir, &["filter", "a.vti", "--map", "map.toml", "--out", "bins"]);
    let table = bins(dir, "bins");
    let slips: Vec<f64> = table
        .lines()
        .filter(|line| line.starts_with("slip,"))
        .map(|line| {
            let at = table.lines().next().unwrap().split(',').position(|name| name == "value");
            line.split(',').nth(at.unwrap()).unwrap().parse().unwrap()
        })
        .collect();
    assert!(!slips.is_empty() && slips.iter().all(|slip| (slip - 0.2).abs() < 1e-12), "{slips:?}");
}

#[test]
fn fields_that_cannot_be_used_are_refused_with_place_and_remedy() {
    let keep = ("0.5", "0.5");
    let same = ("[grid]", "[grid]");
    for (file, map, says) in [
        (("0.110", "nan"), same, &["a.vti: array phi: NaN in cell [2, 1, 0]", "finite"][..]),
        (("0.110", "-0.2"), same, &["array phi: -0.2 in cell [2, 1, 0]", "not negative"]),
        (("0.110", "1.7"), same, &["array phi: 1.7 in cell [2, 1, 0]", "percent"]),
        (("0.110", "17000"), same, &["17000", "a density"]),
        (("0.110", "abc"), same, &["array phi: abc is not a number"]),
        (("0.110 ", ""), same, &["array phi: it has 63 values for 64 cells"]),
        (keep, ("\"phi\"", "\"EP_g\""), &["array EP_g: 0.8 in cell", "gas's fraction", "1 - ..."]),
        (
            keep,
            ("\"phi\"", "\"corner\""),
            &["array corner", "point data", "Point Data to Cell Data"],
        ),
        (
            keep,
            ("\"phi\"", "\"fhi\""),
            &["no array fhi, which map.toml names for solids_fraction", "EP_g, ", "phi"],
        ),
        (keep, ("\"phi\"", "\"1 -\""), &["[fields] solids_fraction = \"1 -\"", "at the end"]),
        (keep, ("\"phi\"", "\"Us\""), &["array Us: it has 3 components", "Us[0]"]),
        (keep, ("\"Us\"", "\"p\""), &["array p: it has 1 component and 2 are needed"]),
        (keep, ("[\"U_g\", \"V_g\"]", "[\"Us\", \"V_g\"]"), &["array Us: it has 3 components"]),
        (keep, ("gas_velocity", "#"), &["no array for gas_velocity", "[fields] gas_velocity"]),
        (keep, ("\"V_g\"]", "\"100 * V_g\"]"), &["the gas passes the particles", "units", "trust"]),
        (keep, ("[\"U_g\", \"V_g\"]", "\"Us\""), &["the gas passes the particles at 0"]),
        (keep, ("[grid]", "[grid]\nvertical = \"z\""), &["z is to be vertical and has one cell"]),
        (keep, ("periodic = [\"x\", \"y\"]", ""), &["along which axes", "[grid] periodic"]),
        (keep, ("[grid]", "[grid]\nsize = [0.009, 0.008]"), &["[grid] size gives 0.009 along x"]),
        (
            keep,
            ("[filter]\nwidths = [0.002]", "[units]\nlength = \"um\""),
            &["its cells are", "a particle is"],
        ),
        (
            keep,
            ("[grid]", "[units]\nlength = \"ft\"\n[grid]"),
            &["[units] length = \"ft\": m, cm, mm, um"],
        ),
        (keep, ("[grid]", "[grids]"), &["map.toml: ", "unknown field `grids`"]),
        (keep, ("density = 1500.0", "density = -1.0"), &["map.toml:", "[powder] density = -1.0"]),
        (
            keep,
            ("widths = [0.002]", "widths = [0.0025]"),
            &["[filter] widths = 0.0025", "accepted nearest"],
        ),
        (("Spacing=\"0.001 0", "Spacing=\"0 0"), same, &["its Spacing along axis 0 is 0"]),
        (("Origin", "Direction=\"0 1 0 1 0 0 0 0 1\" Origin"), same, &["its axes are turned"]),
        (("</VTKFile>", ""), same, &["a.vti: XML"]),
        (("ImageData\" v", "PolyData\" v"), same, &["it holds no <PolyData>"]),
        (
            keep,
            ("[fields]", "[fields]\npressure = \"1e9 * y\""),
            &["array pressure: it falls by 1.000e9 Pa/m"],
        ),
        (
            keep,
            ("[fields]", "[fields]\ndrag_coefficient = \"1e-9\""),
            &["array drag_coefficient", "kg/m³/s"],
        ),
        (
            keep,
            ("[fields]", "[fields]\ngranular_temperature = \"-p\""),
            &["-5 in cell [0, 0, 0]", "cannot be negative"],
        ),
    ] {
        let message = spoiled(file, map);
        for part in says {
            assert!(message.contains(part), "{file:?} {map:?}: {part}: {message}");
        }
    }
    // What is only implausible is taken on trust.
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.vti"), vti()).unwrap();
    let map = format!("trust = true\n{MAP}{SYSTEM}").replace("\"V_g\"]", "\"100 * V_g\"]");
    fs::write(folder.path().join("map.toml"), map).unwrap();
    succeeds(folder.path(), &["filter", "a.vti", "--map", "map.toml", "--out", "bins"]);
}

#[test]
fn files_that_do_not_go_together_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    let write = |name: &str, text: &str| fs::write(dir.join(name), text).unwrap();
    write("a.vti", &vti());
    write("same.vti", &vti());
    write("map.toml", &format!("{MAP}{SYSTEM}"));
    let finer = vti().replace(">0.5<", ">0.6<").replace("0.001 0.001 1", "0.0005 0.0005 1");
    write("finer.vti", &finer);
    let timeless = vti().replace("TimeValue", "other");
    write("b.vti", &timeless);
    write("c.vti", &timeless);
    write("field.vtk", "# vtk DataFile Version 3.0\n");
    let twice = refused(dir, &["a.vti", "same.vti", "--map", "map.toml"]);
    assert!(
        twice.contains("a.vti and same.vti: both have") && twice.contains("a folder of its own"),
        "{twice}"
    );
    let grids = refused(dir, &["a.vti", "finer.vti", "--map", "map.toml"]);
    assert!(grids.contains("finer.vti") && grids.contains("another grid"), "{grids}");
    let times = refused(dir, &["b.vti", "c.vti", "--map", "map.toml"]);
    assert!(times.contains("b.vti") && times.contains("[grid] interval"), "{times}");
    let mixed = refused(dir, &["a.vti", "b.vti", "--map", "map.toml"]);
    assert!(mixed.contains("b.vti: it gives no time, and a.vti gives 0.5 s"), "{mixed}");
    let legacy = refused(dir, &["field.vtk", "--map", "map.toml"]);
    assert!(legacy.contains("field.vtk: its format is not known: .vti"), "{legacy}");
    let absent = refused(dir, &["none.vti", "--map", "map.toml"]);
    assert!(absent.contains("cannot read none.vti"), "{absent}");
    let bare = refused(dir, &["a.vti"]);
    assert!(bare.contains("no array for solids_fraction") || bare.contains("periodic"), "{bare}");
}

#[test]
fn numpy_files_need_axes_and_sizes_and_then_give_the_fields() {
    let Some(python) = python("numpy") else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    run_python(
        &python,
        dir,
        "import numpy as np, os
x, y = np.meshgrid(np.arange(8), np.arange(6), indexing='ij')
phi = 0.1 + 0.01 * x + 0.001 * y
u = np.stack([0 * phi, -0.1 + 0 * phi]).astype('f4')
v = np.stack([0 * phi, 0.1 + 0 * phi], axis=-1)
for t in range(3):
    np.savez(f'{t}.npz', phi=np.asfortranarray(phi), u=u, v=v, time=0.1 * t)
os.mkdir('arrays')
for name, a in (('phi', phi), ('u', u), ('v', v)): np.save('arrays/' + name, a)
np.savez('bad.npz', phi=phi + 1j, u=u, v=v)
np.savez('wrong.npz', phi=phi, u=u[:, :-1], v=v)
",
    );
    let map = format!(
        "{SYSTEM}[fields]\nsolids_fraction = \"phi\"\nsolids_velocity = \"u\"\ngas_velocity = \"v\"\n\
         [filter]\nwidths = [0.002]\n[grid]\nperiodic = [\"x\", \"y\"]\n"
    );
    let write = |rest: &str| fs::write(dir.join("map.toml"), format!("{map}{rest}")).unwrap();
    write("");
    let axes = refused(dir, &["0.npz", "--map", "map.toml"]);
    assert!(axes.contains("0.npz") && axes.contains("axes = \"zyx\""), "{axes}");
    write("axes = \"xy\"\n");
    let size = refused(dir, &["0.npz", "--map", "map.toml"]);
    assert!(size.contains("[grid] size"), "{size}");
    write("axes = \"xy\"\nsize = [0.008, 0.006]\n");
    let wrong = refused(dir, &["wrong.npz", "--map", "map.toml"]);
    assert!(
        wrong.contains("wrong.npz: array u") && wrong.contains("the grid's is [8, 6]"),
        "{wrong}"
    );
    let complex = refused(dir, &["bad.npz", "--map", "map.toml"]);
    assert!(complex.contains("bad.npz: array phi") && complex.contains(".astype"), "{complex}");
    succeeds(dir, &["filter", "0.npz", "1.npz", "2.npz", "--map", "map.toml", "--out", "npz"]);
    succeeds(dir, &["filter", "arrays", "--map", "map.toml", "--out", "npy"]);
    let map = Map::load(&dir.join("map.toml")).unwrap();
    for path in ["2.npz", "arrays"] {
        let all = runs(&[dir.join(path)], &map).unwrap();
        let read = Reader::new(&map).read(&all[0][0], 0.1).unwrap().fields;
        for n in 0..48 {
            let phi = 0.1 + 0.01 * (n % 8) as f64 + 0.001 * (n / 8) as f64;
            assert!((read.solids_fraction[n] - phi).abs() < 1e-15);
            assert_eq!(
                (read.solids_velocity[1][n], read.gas_velocity[1][n]),
                (-0.1f32 as f64, 0.1)
            );
        }
    }
}

#[test]
fn particles_of_the_real_vtk_and_numpy_are_deposited() {
    let (Some(python), Some(numpy)) = (python("vtk"), python("numpy")) else { return };
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    // The gas on a grid as NumPy writes it, packed and not; a particle of a fifth of a millimetre at the
    // centre of each cell of 1 mm, in a box of 4 x 5 x 6 cells.
    run_python(
        &numpy,
        dir,
        "import numpy as np
shape = (6, 5, 4)
fields = dict(p=np.zeros(shape), v=np.zeros(shape + (3,)), axes=np.frombuffer(b'zyx', 'u1'), time=0.5)
fields['v'][..., 2] = 0.3
np.savez('gas.npz', **fields)
np.savez_compressed('packed.npz', **fields)",
    );
    run_python(
        &python,
        dir,
        "import vtk
points = vtk.vtkPoints(); points.SetDataTypeToDouble()
velocity = vtk.vtkDoubleArray(); velocity.SetName('velocity'); velocity.SetNumberOfComponents(3)
diameter = vtk.vtkDoubleArray(); diameter.SetName('diameter')
kind = vtk.vtkIntArray(); kind.SetName('kind')
for n in range(120):
    i, j, k = n % 4, n // 4 % 5, n // 20
    points.InsertNextPoint(0.001 * (i + 0.5), 0.001 * (j + 0.5), 0.001 * (k + 0.5))
    velocity.InsertNextTuple3(0.01 * i, 0.02 * j, -0.1 * k); diameter.InsertNextValue(0.0002); kind.InsertNextValue(n)
time = vtk.vtkDoubleArray(); time.SetName('TimeValue'); time.InsertNextValue(0.5)
cloud = vtk.vtkPolyData(); cloud.SetPoints(points)
for a in (velocity, diameter, kind): cloud.GetPointData().AddArray(a)
cloud.GetFieldData().AddArray(time)
vertices = vtk.vtkVertexGlyphFilter(); vertices.SetInputData(cloud); vertices.Update()
for name, data in (('bare', cloud), ('vertices', vertices.GetOutput())):
    for kind in ('ascii', 'binary', 'appended', 'raw', 'lz4'):
        writer = vtk.vtkXMLPolyDataWriter(); writer.SetFileName(name + '_' + kind + '.vtp'); writer.SetInputData(data)
        if kind == 'ascii': writer.SetDataModeToAscii()
        if kind == 'binary': writer.SetDataModeToBinary()
        if kind == 'raw': writer.EncodeAppendedDataOff(); writer.SetCompressorTypeToNone()
        if kind == 'lz4': writer.SetCompressorTypeToLZ4()
        assert writer.Write() == 1",
    );
    let map = format!(
        "{SYSTEM}[fields]\ngas_velocity = \"v\"\n[grid]\nsize = [0.004, 0.005, 0.006]\n\
         vertical = \"z\"\nperiodic = []\n[filter]\nwidths = [0.002]\n"
    );
    fs::write(dir.join("map.toml"), &map).unwrap();
    let map = Map::load(&dir.join("map.toml")).unwrap();
    let volume = std::f64::consts::PI / 6.0 * 0.0002f64.powi(3);
    for name in ["bare", "vertices"] {
        for kind in ["ascii", "binary", "appended", "raw", "lz4"] {
            for gas in ["gas.npz", "packed.npz"] {
                let cloud = format!("{name}_{kind}.vtp");
                let all = runs(&[dir.join(gas), dir.join(&cloud)], &map).unwrap();
                let read = Reader::new(&map).read(&all[0][0], 1.0).unwrap().fields;
                assert_eq!((&read.cells[..], read.time), (&[4, 5, 6][..], 0.5), "{cloud}");
                for n in 0..120 {
                    let [i, j, k] = [n % 4, n / 4 % 5, n / 20].map(|at| at as f64);
                    assert!(
                        (read.solids_fraction[n] / (volume * 1e9) - 1.0).abs() < 1e-9,
                        "{cloud}"
                    );
                    for (axis, u) in [0.01 * i, 0.02 * j, -0.1 * k].into_iter().enumerate() {
                        assert!((read.solids_velocity[axis][n] - u).abs() < 1e-9, "{cloud} {n}");
                    }
                    assert_eq!(read.gas_velocity[2][n], 0.3);
                }
            }
        }
    }
    succeeds(dir, &["filter", "gas.npz", "bare_raw.vtp", "--map", "map.toml", "--out", "bins"]);
}

#[test]
fn particles_are_deposited_beside_the_gas_of_a_grid() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path();
    fs::write(dir.join("gas.vti"), vti()).unwrap();
    let mut table = String::from("x, y, vx, vy, radius, id\n");
    for n in 0..64 {
        // One particle at each cell's centre, of the volume of a fifth of a slice's cell.
        let (i, j) = (n % 8, n / 8);
        let at = |i: usize| 0.001 * (i as f64 + 0.5);
        table += &format!("{:e},{:e},0,-0.1,0.00025,{n}\n", at(i), at(j));
    }
    fs::write(dir.join("particles.csv"), &table).unwrap();
    let map = format!(
        "{}[particles]\nposition = [\"x\", \"y\"]\nvelocity = [\"vx\", \"vy\"]\n",
        format!("{MAP}{SYSTEM}")
            .replace("solids_fraction = \"phi\"", "")
            .replace("solids_velocity = \"Us\"", "solids_velocity = \"solids_velocity\"")
    );
    fs::write(dir.join("map.toml"), &map).unwrap();
    let flat = refused(dir, &["gas.vti", "particles.csv", "--map", "map.toml"]);
    assert!(flat.contains("[particles] thickness"), "{flat}");
    let map = format!("{map}thickness = 0.0005\n");
    fs::write(dir.join("map.toml"), &map).unwrap();
    let read = {
        let map = Map::load(&dir.join("map.toml")).unwrap();
        let all = runs(&[dir.join("gas.vti"), dir.join("particles.csv")], &map).unwrap();
        Reader::new(&map).read(&all[0][0], 1.0).unwrap().fields
    };
    let expected = std::f64::consts::PI / 6.0 * 0.0005f64.powi(3) / (1e-6 * 0.0005);
    for n in 0..64 {
        assert!((read.solids_fraction[n] / expected - 1.0).abs() < 1e-9);
        assert!((read.solids_velocity[1][n] + 0.1).abs() < 1e-12);
    }
    succeeds(dir, &["filter", "gas.vti", "particles.csv", "--map", "map.toml", "--out", "bins"]);

    fs::write(dir.join("particles.csv"), table.replacen("-0.1", "inf", 1)).unwrap();
    let bad = refused(dir, &["gas.vti", "particles.csv", "--map", "map.toml"]);
    assert!(bad.contains("particles.csv: array vy") && bad.contains("particle 0"), "{bad}");
    fs::write(dir.join("particles.csv"), table.replacen("-0.1", "?", 1)).unwrap();
    let bad = refused(dir, &["gas.vti", "particles.csv", "--map", "map.toml"]);
    assert!(bad.contains("particles.csv: array vy: line 2: \"?\" is not a number"), "{bad}");
}
