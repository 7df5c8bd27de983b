//! Exports in the languages and programs that they are for: compiled, run, and compared with Favre.
//!
//! Without a compiler, OpenFOAM or its sources (`.ci/run` fetches them) a test says that it is skipped.

mod common;

use common::python;
use favre::closure::{BUILT_IN, Closure, Quantity};
use favre::export::{Target, export, write};
use favre::expression::Function;
use favre::fit::ReferenceLength;
use favre::laws::drag::{Beetstra, DragLaw, WenYu};
use favre::laws::scales::{Gas, Powder, Scales};
use favre::output::Output;
use favre::resolved::openfoam::{self, Mesh};
use favre::spline::Spline;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Random points of each quantity.
const POINTS: usize = 10_000;

/// What an implementation may differ by, relative.
const AGREE: f64 = 1e-12;

/// Models that every solver's export is tested with: one fitted by Favre, two published.
const MODELS: [&str; 3] = ["default", "igci-sundaresan-2011-3d", "sarkar-2016"];

/// Whether `program` is there; else why the test is skipped.
fn found(program: &str, package: &str) -> bool {
    let found = Command::new(program).arg("--version").stdout(Stdio::null()).status().is_ok();
    if !found {
        eprintln!("skipped: no {program}; `apt-get install {package}`");
    }
    found
}

fn exported(closure: &Closure, target: Target, dir: &Path) -> PathBuf {
    let dir = dir.join(target.to_string());
    let output = Output::create(&dir, false).unwrap();
    write(&export(closure, target).unwrap(), &output).unwrap();
    output.commit().unwrap()
}

fn run(dir: &Path, program: &str, args: &[&str]) -> String {
    let output = Command::new(program).current_dir(dir).args(args).output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {args:?} in {}: {text}{errors}", dir.display());
    text
}

fn write_numbers(path: &Path, numbers: &[f64]) {
    let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    fs::write(path, bytes).unwrap();
}

fn read_numbers(path: &Path) -> Vec<f64> {
    let bytes = fs::read(path).unwrap();
    bytes.chunks_exact(8).map(|bytes| f64::from_le_bytes(bytes.try_into().unwrap())).collect()
}

fn agrees(found: f64, expected: f64) -> bool {
    found == expected
        || found.is_nan() && expected.is_nan()
        || (found - expected).abs() <= AGREE * expected.abs()
}

/// Points inside the ranges and as far again outside them.
fn points(quantity: &Quantity, random: &mut impl Rng) -> Vec<Vec<f64>> {
    let vectors = quantity.file.test_vectors.iter().map(|vector| quantity.point(vector));
    let mut points: Vec<Vec<f64>> = vectors.collect();
    for _ in 0..POINTS {
        points.push(
            quantity
                .file
                .ranges
                .iter()
                .map(|range| {
                    let width = range.high - range.low;
                    (range.low - 0.5 * width) + 2.0 * width * random.random::<f64>()
                })
                .collect(),
        );
    }
    points
}

/// A program in C that evaluates every quantity at the points of its file.
fn driver_in_c(closure: &Closure) -> String {
    let mut text = String::from(
        "#include \"favre_closure.h\"\n#include <stdio.h>\nint main(void)\n{\n\
         double x[8], y; FILE *in, *out;\n",
    );
    for (i, quantity) in closure.quantities.iter().enumerate() {
        let count = quantity.file.ranges.len();
        let x: Vec<String> = (0..count).map(|k| format!("x[{k}]")).collect();
        let (name, x) = (&quantity.file.predicts, x.join(", "));
        text += &format!(
            "in = fopen(\"points_{i}.bin\", \"rb\"); out = fopen(\"values_{i}.bin\", \"wb\");\n\
             while (fread(x, 8, {count}, in) == {count}) {{\n\
             y = favre_{name}({x}); fwrite(&y, 8, 1, out);\n\
             y = favre_{name}_inside({x}); fwrite(&y, 8, 1, out); }}\n\
             fclose(in); fclose(out);\n"
        );
    }
    text + "return 0;\n}\n"
}

/// The same in Fortran.
fn driver_in_fortran(closure: &Closure) -> String {
    let mut text = String::from(
        "program driver\nuse favre_closure\nimplicit none\ndouble precision :: x(8)\n\
         integer :: status\n",
    );
    for (i, quantity) in closure.quantities.iter().enumerate() {
        let count = quantity.file.ranges.len();
        let x: Vec<String> = (1..=count).map(|k| format!("x({k})")).collect();
        let (name, x) = (&quantity.file.predicts, x.join(", "));
        text += &format!(
            "open(10, file='points_{i}.bin', access='stream', form='unformatted', status='old')\n\
             open(11, file='values_{i}.bin', access='stream', form='unformatted', status='replace')\n\
             do\nread(10, iostat=status) x(1:{count})\nif (status /= 0) exit\n\
             write(11) favre_{name}({x})\n\
             write(11) merge(1d0, 0d0, favre_{name}_inside({x}))\nend do\n\
             close(10)\nclose(11)\n"
        );
    }
    text + "end program driver\n"
}

/// A closure whose formula is a spline.
fn surface() -> Closure {
    let mut file = Closure::find("igci-sundaresan-2011-2d").unwrap().file;
    file.name = "surface".into();
    let spline = Spline {
        fraction_scale: 0.01,
        width_scale: 2.5,
        fraction_knots: vec![0.0, 1.1, 2.3, 3.2, 4.1],
        width_knots: vec![0.0, 0.4, 0.7, 0.85],
        coefficients: (0..6)
            .map(|i| (0..5).map(|j| 0.035 * f64::from(i * j) * f64::from(7 - i) / 4.0).collect())
            .collect(),
    };
    let quantity = &mut file.quantities[0];
    quantity.formula = "surface".into();
    for vector in &mut quantity.test_vectors {
        let markers: Vec<f64> = vector.at.values().copied().collect();
        vector.expected = spline.at(markers[0], markers[1]);
    }
    file.formulae.clear();
    file.splines.insert("surface".into(), spline);
    Closure::parse(&toml::to_string(&file).unwrap(), Path::new("surface.toml")).unwrap()
}

/// Every closure in a language: its own check of the test vectors, and 10,000 points of each quantity.
fn compare(target: Target, compile: impl Fn(&Path, &Closure)) {
    let mut quantities = 0;
    let shipped = BUILT_IN.iter().map(|(name, _)| Closure::find(name).unwrap());
    for closure in shipped.chain([surface()]).filter(|closure| !closure.quantities.is_empty()) {
        let name = &closure.file.name;
        let dir = tempfile::tempdir().unwrap();
        let dir = exported(&closure, target, dir.path());
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let all: Vec<_> = closure.quantities.iter().map(|q| points(q, &mut random)).collect();
        for (i, points) in all.iter().enumerate() {
            write_numbers(&dir.join(format!("points_{i}.bin")), &points.concat());
        }
        compile(&dir, &closure);
        let checked = run(&dir, "./check", &[]);
        assert!(checked.contains("test vectors, 0 differ"), "{name}: {checked}");
        run(&dir, "./driver", &[]);
        for (i, (quantity, points)) in closure.quantities.iter().zip(&all).enumerate() {
            let values = read_numbers(&dir.join(format!("values_{i}.bin")));
            assert_eq!(values.len(), 2 * points.len());
            let mut inside = 0;
            for (point, pair) in points.iter().zip(values.chunks_exact(2)) {
                let expected = quantity.at(point);
                let predicts = &quantity.file.predicts;
                assert!(
                    agrees(pair[0], expected),
                    "{name} {predicts} {point:?}: {pair:?}, not {expected}"
                );
                assert_eq!(pair[1] == 1.0, quantity.is_inside(point));
                inside += usize::from(quantity.is_inside(point));
            }
            // An eighth of the points lies inside three ranges, a half inside one.
            assert!(inside > POINTS / 10 && inside < points.len() - POINTS / 10);
            quantities += 1;
        }
    }
    assert!(quantities >= 20, "{quantities}");
}

#[test]
fn c_gives_what_favre_gives() {
    if !found("gcc", "gcc") {
        return;
    }
    compare(Target::C, |dir, closure| {
        fs::write(dir.join("driver.c"), driver_in_c(closure)).unwrap();
        for name in ["check", "driver"] {
            let source = format!("{name}.c");
            let args =
                ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", &source, "-o", name, "-lm"];
            run(dir, "gcc", &args);
        }
    });
}

#[test]
fn fortran_gives_what_favre_gives() {
    if !found("gfortran", "gfortran") {
        return;
    }
    compare(Target::Fortran, |dir, closure| {
        fs::write(dir.join("driver.f90"), driver_in_fortran(closure)).unwrap();
        for name in ["check", "driver"] {
            let source = format!("{name}.f90");
            let warnings = ["-std=f2008", "-O2", "-Wall", "-Werror", "-Wno-compare-reals"];
            let args = [&warnings[..], &["favre_closure.f90", &source, "-o", name]].concat();
            run(dir, "gfortran", &args);
        }
    });
}

/// The powder and the gas of a closure, and what it scales and corrects.
struct Material {
    powder: Powder,
    gas: Gas,
    scales: Scales,
    reference: ReferenceLength,
    law: String,
}

impl Material {
    /// Where the source of the closure names no powder, that of the default model.
    fn new(closure: &Closure) -> Self {
        let default = || Closure::find("default").unwrap().file.system.unwrap();
        let system = closure.file.system.unwrap_or_else(default);
        let (powder, gas) = (system.powder(), system.gas());
        let scales = Scales::new(&powder, &gas, system.gravity);
        let (reference, law) =
            (closure.file.reference_length, closure.file.definitions.drag.clone());
        Self { powder, gas, scales, reference, law }
    }

    /// The same of particles of another diameter.
    fn of(&self, diameter: f64) -> Self {
        let powder = Powder { diameter, ..self.powder };
        let scales = Scales::new(&powder, &self.gas, self.scales.gravity);
        let (reference, law) = (self.reference, self.law.clone());
        Self { powder, gas: self.gas, scales, reference, law }
    }

    fn length(&self) -> f64 {
        match self.reference {
            ReferenceLength::One => self.scales.length_i(),
            ReferenceLength::Two => self.scales.length_ii(),
        }
    }

    fn beta(&self, phi: f64, slip: f64) -> f64 {
        match &*self.law {
            "wen-yu" => WenYu::<f64>::new(&self.gas, &self.powder).beta(phi, slip),
            "beetstra" => Beetstra::<f64>::new(&self.gas, &self.powder).beta(phi, slip),
            other => panic!("{other}"),
        }
    }

    /// Numbers for the preprocessor of C and Fortran.
    fn defines(&self, closure: &Closure) -> Vec<String> {
        let has = |name: &str| closure.quantity(Some(name)).is_some();
        let mut defines = vec![
            format!("-DDENSITY_S={:?}", self.powder.density),
            format!("-DDENSITY_G={:?}d0", self.gas.density),
            format!("-DVISCOSITY_G={:?}", self.gas.viscosity).replace("e-", "d-"),
            format!("-DGRAVITY_SI={:?}d0", self.scales.gravity),
        ];
        if has("drag_correction") {
            defines.push("-DDRAG".into());
        }
        if has("solids_viscosity") {
            defines.push("-DSTRESS".into());
        }
        defines
    }
}

/// The drag, its factor, the solids viscosity and the solids pressure of a state of a cell, by Favre.
fn expected(closure: &Closure, material: &Material, state: &[f64]) -> [f64; 4] {
    let material = &material.of(state[14]);
    let scales = &material.scales;
    let (u_t, g) = (scales.terminal_velocity, scales.gravity);
    let slip = (state[2] * state[2] + state[3] * state[3] + state[4] * state[4]).sqrt();
    let gradient = &state[5..14];
    let rate = |i: usize, j: usize| 0.5 * (gradient[3 * i + j] + gradient[3 * j + i]);
    let third = (rate(0, 0) + rate(1, 1) + rate(2, 2)) / 3.0;
    let deviator = |i: usize, j: usize| rate(i, j) - if i == j { third } else { 0.0 };
    let squares: f64 = (0..9).map(|k| deviator(k / 3, k % 3).powi(2)).sum();
    let marker = |symbol: &str| match symbol {
        "phi" => state[0],
        "D" => 2.0 * state[1].powf(1.0 / 3.0) / material.length(),
        "V" => slip / u_t,
        "S" => (2.0 * squares).sqrt() * u_t / g,
        _ => panic!("{symbol}"),
    };
    let at = |name: &str| {
        let quantity = closure.quantity(Some(name))?;
        Some(quantity.at(&quantity.markers().map(|m| marker(m.symbol())).collect::<Vec<_>>()))
    };
    let positive = |x| Function::Max.of_two(0.0, x);
    let factor = at("drag_correction").map_or(0.0, |h| positive(1.0 - h));
    let stress = |name, scale: f64| at(name).map_or(0.0, |value| positive(value) * scale);
    [
        factor * material.beta(state[0], slip),
        factor,
        stress("solids_viscosity", scales.viscosity()),
        stress("solids_pressure", scales.stress()),
    ]
}

/// States of a cell: those of the test vectors, and random ones inside the ranges and outside, of
/// particles from 8 µm to 4 mm.
fn states(closure: &Closure, material: &Material) -> Vec<Vec<f64>> {
    let mut random = Pcg64Mcg::seed_from_u64(11);
    let volume = |material: &Material, width: f64| (0.5 * width * material.length()).powi(3);
    let mut states = Vec::new();
    for quantity in &closure.quantities {
        for vector in &quantity.file.test_vectors {
            let marker = |symbol: &str, other: f64| {
                let found = vector.at.iter().find(|(marker, _)| marker.symbol() == symbol);
                found.map_or(other, |(_, value)| *value)
            };
            let mut state = vec![0.0; 15];
            state[0] = marker("phi", 0.1);
            state[1] = volume(material, marker("D", 4.0));
            state[3] = marker("V", 1.0) * material.scales.terminal_velocity;
            // A shear du/dy alone has S = |du/dy|.
            state[6] = marker("S", 1.0) / material.scales.time();
            state[14] = material.powder.diameter;
            states.push(state);
        }
    }
    for _ in 0..POINTS {
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let diameter = 8e-6 * 500f64.powf(uniform(0.0, 1.0));
        let material = material.of(diameter);
        let u_t = material.scales.terminal_velocity;
        let mut state = vec![uniform(0.0, 0.8), volume(&material, uniform(0.3, 25.0))];
        state.extend((0..3).map(|_| uniform(-3.0, 3.0) * u_t));
        state.extend((0..9).map(|_| uniform(-8.0, 8.0) / material.scales.time()));
        state.push(diameter);
        states.push(state);
    }
    states
}

/// The values that a solver's routines gave for the states, against Favre's.
fn compare_states(
    name: &str,
    closure: &Closure,
    material: &Material,
    states: &[Vec<f64>],
    found: &[f64],
    has_factor: bool,
) {
    assert_eq!(found.len(), 4 * states.len(), "{name}");
    for (state, found) in states.iter().zip(found.chunks_exact(4)) {
        let expected = expected(closure, material, state);
        for i in (0..4).filter(|i| has_factor || *i != 1) {
            assert!(agrees(found[i], expected[i]), "{name} {state:?}: {found:?}, not {expected:?}");
        }
    }
}

#[test]
fn fluent_functions_give_what_favre_gives() {
    if !found("gcc", "gcc") {
        return;
    }
    for name in MODELS.into_iter().chain(["milioli-2013", "radl-sundaresan-2014"]) {
        let closure = Closure::find(name).unwrap();
        let material = Material::new(&closure);
        let dir = tempfile::tempdir().unwrap();
        let dir = exported(&closure, Target::Fluent, dir.path());
        fs::write(dir.join("udf.h"), include_str!("export/udf.h")).unwrap();
        fs::write(dir.join("fluent.c"), include_str!("export/fluent.c")).unwrap();
        let defines = material.defines(&closure);
        let defines: Vec<String> =
            defines.iter().map(|define| define.replace("d0", "").replace("d-", "e-")).collect();
        let mut args: Vec<&str> = defines.iter().map(|define| &**define).collect();
        args.extend([
            "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "fluent.c", "-o", "fluent", "-lm",
        ]);
        run(&dir, "gcc", &args);
        let states = states(&closure, &material);
        write_numbers(&dir.join("states.bin"), &states.concat());
        let done = Command::new("./fluent")
            .current_dir(&dir)
            .stdin(File::open(dir.join("states.bin")).unwrap())
            .stdout(File::create(dir.join("values.bin")).unwrap())
            .status();
        assert!(done.unwrap().success());
        let values = read_numbers(&dir.join("values.bin"));
        compare_states(name, &closure, &material, &states, &values, true);
    }
}

#[test]
fn mfix_routines_give_what_favre_gives() {
    if !found("gfortran", "gfortran") {
        return;
    }
    for name in MODELS.into_iter().chain(["milioli-2013", "radl-sundaresan-2014"]) {
        let closure = Closure::find(name).unwrap();
        let material = Material::new(&closure);
        let dir = tempfile::tempdir().unwrap();
        let dir = exported(&closure, Target::Mfix, dir.path());
        fs::write(dir.join("mfix.F90"), include_str!("export/mfix.f90")).unwrap();
        let defines = material.defines(&closure);
        let mut args: Vec<&str> = defines.iter().map(|define| &**define).collect();
        // As MFIX compiles: free form in .f files.
        args.extend(["-O2", "-ffree-form", "-ffree-line-length-0", "-cpp", "mfix.F90"]);
        let own = ["usr_drag.f", "usr_properties.f"];
        args.extend(own.into_iter().filter(|file| dir.join(file).is_file()));
        args.extend(["-o", "mfix"]);
        run(&dir, "gfortran", &args);
        let states = states(&closure, &material);
        write_numbers(&dir.join("states.bin"), &states.concat());
        run(&dir, "./mfix", &[]);
        let mut values = read_numbers(&dir.join("values.bin"));
        // MFIX multiplies by the fraction.
        for (values, state) in values.chunks_exact_mut(4).zip(&states) {
            values[0] *= state[0];
        }
        compare_states(name, &closure, &material, &states, &values, false);
        // The velocity by which it scales is the true one, not Stokes', which MFIX itself takes.
        let readme = fs::read_to_string(dir.join("README.md")).unwrap();
        assert!(readme.contains("(0.2185 m/s") && readme.contains("(0.2552 m/s"), "{readme}");
    }
}

/// The sources of OpenFOAM that the library is compiled against.
fn sources() -> Option<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/openfoam/src");
    let header =
        "applications/solvers/multiphase/twoPhaseEulerFoam/interfacialModels/lnInclude/dragModel.H";
    if !folder.join(header).is_file() {
        eprintln!(
            "skipped: no sources of OpenFOAM in target/openfoam; `.ci/openfoam-sources` fetches them"
        );
        return None;
    }
    ["twoPhaseEulerFoam", "blockMesh"]
        .iter()
        .all(|program| {
            let found = Command::new(program)
                .arg("-help")
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .is_ok();
            if !found {
                eprintln!("skipped: no {program}; `apt-get install openfoam`");
            }
            found
        })
        .then(|| folder.to_str().unwrap().to_owned())
}

fn replace(path: &Path, from: &str, to: &str) {
    let text = fs::read_to_string(path).unwrap();
    assert!(text.contains(from), "{}: {from}", path.display());
    fs::write(path, text.replace(from, to)).unwrap();
}

/// Runs a case of an export, and says where the last time is.
fn run_case(case: &Path) -> PathBuf {
    run(case, "sh", &["Allrun"]);
    let log = fs::read_to_string(case.join("log.twoPhaseEulerFoam")).unwrap();
    assert!(log.contains("\nEnd"), "{log}");
    openfoam::times(case).unwrap().unwrap().pop().unwrap()
}

/// The fields that the drag model wrote: fraction, slip, Reynolds number, drag coefficient.
fn drag_fields(time: &Path) -> [Vec<f64>; 4] {
    let names = ["favreDragFraction", "favreDragSlip", "favreDragRe", "favreDragCoefficient"];
    let mesh = Mesh::of(time).unwrap();
    let piece = openfoam::read(time, &mesh, &|name| names.contains(&name)).unwrap();
    names.map(|name| {
        let array = piece.arrays.iter().find(|array| array.name == name).unwrap();
        array.columns[0].clone()
    })
}

/// (1 - H) β of Favre at φ, Δ_f/L, slip and gas density.
fn filtered_drag(
    closure: &Closure,
    material: &Material,
    phi: f64,
    width: f64,
    slip: f64,
    density: f64,
) -> f64 {
    let gas = Gas { density, ..material.gas };
    assert_eq!(material.law, "wen-yu");
    let quantity = closure.quantity(Some("drag_correction")).unwrap();
    let markers = [phi, width, slip / material.scales.terminal_velocity];
    let h = quantity.at(&markers[..quantity.file.ranges.len()]);
    (1.0 - h) * WenYu::<f64>::new(&gas, &material.powder).beta(phi, slip)
}

#[test]
fn openfoam_applies_the_drag_that_favre_evaluates() {
    let Some(sources) = sources() else { return };
    for name in MODELS {
        let closure = Closure::find(name).unwrap();
        let material = Material::new(&closure);
        let dir = tempfile::tempdir().unwrap();
        let dir = exported(&closure, Target::OpenFoam, dir.path());
        run(&dir, "make", &[&format!("FOAM_SRC={sources}")]);
        let time = run_case(&dir.join("box"));
        let [fraction, slip, reynolds, coefficient] = drag_fields(&time);
        assert_eq!(fraction.len(), 256);
        let spread =
            fraction.iter().fold((1.0, 0.0), |(a, b): (f64, f64), x| (a.min(*x), b.max(*x)));
        assert!(spread.1 - spread.0 > 0.05, "{name}: {spread:?}");
        let (mut applied, mut evaluated, mut worst) = (0.0, 0.0, 0.0f64);
        for i in 0..fraction.len() {
            // The gas is compressible: its density is the one in the solver's Reynolds number.
            let density =
                reynolds[i] * material.gas.viscosity / (material.powder.diameter * slip[i]);
            assert!((density / material.gas.density - 1.0).abs() < 1e-3, "{name}: {density}");
            let drag = filtered_drag(&closure, &material, fraction[i], 4.0, slip[i], density);
            worst = worst.max((coefficient[i] / drag - 1.0).abs());
            applied += coefficient[i] * slip[i];
            evaluated += drag * slip[i];
        }
        eprintln!(
            "{name}: mean drag {:.1e} off, worst cell {worst:.1e}",
            applied / evaluated - 1.0
        );
        assert!((applied / evaluated - 1.0).abs() < 1e-6, "{name}: {applied} {evaluated}");
        assert!(worst < 1e-6, "{name}: {worst}");
        stresses(name, &closure, &material, &time);
        settles(name, &closure, &material, &dir);
        riser_starts(&dir);
    }
}

/// The first steps of the riser.
fn riser_starts(dir: &Path) {
    let case = dir.join("riser");
    let control = case.join("system/controlDict");
    let text = fs::read_to_string(&control).unwrap();
    let value = |key: &str| {
        let (_, rest) = text.split_once(&format!("\n{key} ")).unwrap();
        rest.split_once(';').unwrap().0.to_owned()
    };
    let end = format!("{:?}", 20.0 * value("deltaT").parse::<f64>().unwrap());
    for key in ["endTime", "writeInterval"] {
        replace(&control, &format!("\n{key} {};", value(key)), &format!("\n{key} {end};"));
    }
    let [fraction, ..] = drag_fields(&run_case(&case));
    // Particles come in at the bottom, where there are more of them than elsewhere.
    assert!(fraction.iter().all(|phi| (0.0..0.1).contains(phi)));
    assert!(fraction[0] > fraction[fraction.len() - 1]);
}

/// The solids viscosity that the solver has at the end is Favre's of the fraction there.
fn stresses(name: &str, closure: &Closure, material: &Material, time: &Path) {
    let Some(quantity) = closure.quantity(Some("solids_viscosity")) else { return };
    assert_eq!(quantity.file.ranges.len(), 2, "{name} depends on the shear rate too");
    let mesh = Mesh::of(time).unwrap();
    let names = ["alpha.particles", "nut.particles"];
    let piece = openfoam::read(time, &mesh, &|name| names.contains(&name)).unwrap();
    let [fraction, viscosity] = names.map(|name| {
        let array = piece.arrays.iter().find(|array| array.name == name).unwrap();
        array.columns[0].clone()
    });
    let scale = material.scales.viscosity() / material.powder.density;
    for (phi, found) in fraction.iter().zip(&viscosity) {
        let expected = quantity.at(&[*phi, 4.0]).max(0.0) * scale;
        assert!(expected > 0.0, "{name} {phi}");
        assert!((found / expected - 1.0).abs() < 1e-6, "{name} {phi}: {found}, not {expected}");
    }
}

/// A uniform box settles at the slip at which the drag of Favre's evaluation carries the weight: that
/// the solver applies what the model returns, seen from outside the model.
fn settles(name: &str, closure: &Closure, material: &Material, dir: &Path) {
    let case = dir.join("box");
    let mesh = case.join("system/blockMeshDict");
    let edge = |cells: f64| format!("{:?}", 2.0 * material.scales.length_i() * cells);
    replace(&mesh, &edge(16.0), &edge(4.0));
    replace(&mesh, "(16 16 1)", "(4 4 1)");
    for (field, value) in [("alpha.particles", "0.15"), ("U.particles", "(0 0 0)")] {
        let path = case.join("0").join(field);
        let text = fs::read_to_string(&path).unwrap();
        let (head, rest) = text.split_once("nonuniform").unwrap();
        let (_, tail) = rest.split_once("boundaryField").unwrap();
        fs::write(&path, format!("{head}uniform {value};\nboundaryField{tail}")).unwrap();
    }
    let control = case.join("system/controlDict");
    replace(&control, "endTime 0.04;", "endTime 0.6;");
    replace(&control, "writeInterval 0.004;", "writeInterval 0.6;");
    for entry in fs::read_dir(&case).unwrap() {
        let path = entry.unwrap().path();
        if openfoam::is_time_folder(&path) && !path.ends_with("0") {
            fs::remove_dir_all(path).unwrap();
        }
    }
    let [fraction, slip, reynolds, _] = drag_fields(&run_case(&case));
    let density = reynolds[0] * material.gas.viscosity / (material.powder.diameter * slip[0]);
    let weight = 0.15 * 0.85 * (material.powder.density - density) * material.scales.gravity;
    let excess = |u: f64| filtered_drag(closure, material, 0.15, 4.0, u, density) * u - weight;
    let (mut low, mut high) = (1e-3, 10.0);
    while high - low > 1e-13 {
        let middle = 0.5 * (low + high);
        *(if excess(middle) < 0.0 { &mut low } else { &mut high }) = middle;
    }
    eprintln!("{name}: slip {}, balance {low}", slip[0]);
    assert!((fraction[0] - 0.15).abs() < 1e-8, "{name}: {}", fraction[0]);
    assert!((slip[0] / low - 1.0).abs() < 1e-6, "{name}: {} {low}", slip[0]);
}

#[test]
fn tables_are_read_by_numpy_and_vtk() {
    let Some(python) = python("numpy, vtk") else { return };
    let closure = Closure::find("sarkar-2016").unwrap();
    let dir = tempfile::tempdir().unwrap();
    let dir = exported(&closure, Target::Table, dir.path());
    fs::write(dir.join("read.py"), include_str!("export/read.py")).unwrap();
    let text = run(&dir, python.to_str().unwrap(), &["read.py", "drag_correction"]);
    // A point by its markers, and the value there in the three files.
    let numbers: Vec<f64> = text.split_whitespace().map(|x| x.parse().unwrap()).collect();
    assert_eq!(numbers.len(), 9, "{text}");
    let expected = closure.quantities[0].at(&numbers[..3]);
    assert!(expected > 0.1, "{text}");
    for found in [numbers[3], numbers[4], numbers[8]] {
        assert!((found - expected).abs() < 1e-15, "{text}, not {expected}");
    }
    for (vtk, marker) in numbers[5..8].iter().zip(&numbers[..3]) {
        assert!((vtk - marker).abs() < 1e-12, "{text}");
    }
}
