//! Particles to start a box from: a table (.csv), one row per particle below one row of names.
//!
//! | column | what it holds | |
//! | --- | --- | --- |
//! | `x [m]`, `y [m]`, `z [m]` | centre, from 0 to the edge of the box; z is vertical | needed |
//! | `diameter [m]` | diameter | the powder's where absent |
//! | `u_x [m/s]`, `u_y [m/s]`, `u_z [m/s]` | velocity, the mean by mass of which is taken off | 0 where all are absent |
//!
//! The density is the powder's. The particles fill what the case says the box holds, and the Sauter mean of their
//! diameters is the powder's diameter, both within 1 %.

use crate::cfd_dem::sauter_mean;
use crate::dem::Sphere;
use crate::laws::scales::Powder;
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

/// What the case says of the particles.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Edges of the box \[m\].
    pub size: [f64; 3],
    /// The powder.
    pub powder: Powder,
    /// Mean solids fraction.
    pub solids_fraction: f64,
}

/// A table that is no start.
#[derive(Debug, thiserror::Error)]
pub enum StartFileError {
    /// It cannot be read, or is no table.
    #[error("cannot read the particles of {path}", path = path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: csv::Error,
    },
    /// Its columns are not those of particles.
    #[error("{path}: column \"{column}\" {why}", path = path.display())]
    Column {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What is wrong and what would be accepted.
        why: String,
    },
    /// A number is not acceptable.
    #[error("{path}: line {line}, column \"{column}\": {value}: {accepted}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What stands there.
        value: String,
        /// What would be accepted.
        accepted: String,
    },
    /// The particles are not those of the case.
    #[error("{path}: {why}", path = path.display())]
    Case {
        /// The file.
        path: PathBuf,
        /// Why not, and what would be accepted.
        why: String,
    },
}

const COLUMNS: [&str; 7] =
    ["x [m]", "y [m]", "z [m]", "diameter [m]", "u_x [m/s]", "u_y [m/s]", "u_z [m/s]"];

/// How far what the particles fill, and their Sauter mean, may be from the case's, relatively.
const TOLERANCE: f64 = 0.01;

/// Deepest overlap over the mean diameter.
const DEEPEST: f64 = 0.1;

/// Reads the particles of the table at `path`.
///
/// # Errors
/// It cannot be read; a column is missing or unknown; a number is none, or out of its range; the particles are
/// not those of the case.
pub fn read(path: &Path, expected: &Expected) -> Result<Vec<Sphere>, StartFileError> {
    let unreadable = |source| StartFileError::Read { path: path.to_owned(), source };
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(path).map_err(unreadable)?;
    let names = reader.headers().map_err(unreadable)?.clone();
    let refuse = |column: &str, why: &str| StartFileError::Column {
        path: path.to_owned(),
        column: column.to_owned(),
        why: why.to_owned(),
    };
    if let Some(unknown) = names.iter().find(|name| !COLUMNS.contains(name)) {
        let accepted = format!("is unknown: accepted are {}", COLUMNS.join(", "));
        return Err(refuse(unknown, &accepted));
    }
    let place = COLUMNS.map(|column| names.iter().position(|name| name == column));
    if let Some(missing) = (0..3).find(|n| place[*n].is_none()) {
        return Err(refuse(COLUMNS[missing], "is missing"));
    }
    if let Some(missing) = (4..7).find(|n| place[*n].is_none())
        && (4..7).any(|n| place[n].is_some())
    {
        return Err(refuse(COLUMNS[missing], "is missing: give all three velocities or none"));
    }
    let powder = &expected.powder;
    let mut spheres = Vec::new();
    for record in reader.records() {
        let record = record.map_err(unreadable)?;
        let line = record.position().map_or(0, csv::Position::line);
        let number = |n: usize, default: f64, fine: &dyn Fn(f64) -> bool, accepted: &str| {
            let Some(place) = place[n] else { return Ok(default) };
            let text = &record[place];
            let found = text.parse().ok().filter(|x: &f64| x.is_finite() && fine(*x));
            found.ok_or_else(|| StartFileError::Value {
                path: path.to_owned(),
                line,
                column: COLUMNS[n],
                value: text.to_owned(),
                accepted: accepted.to_owned(),
            })
        };
        let mut position = [0.0; 3];
        for (axis, x) in position.iter_mut().enumerate() {
            let size = expected.size[axis];
            let accepted = format!("a number from 0 to {size} m is accepted, the edge of the box");
            *x = number(axis, 0.0, &|x| (0.0..=size).contains(&x), &accepted)?;
        }
        let diameter = number(
            3,
            powder.diameter,
            &|d| (1e-7..=0.1).contains(&d),
            "a diameter from 1e-7 m to 0.1 m is accepted",
        )?;
        let mut velocity = [0.0; 3];
        for (axis, u) in velocity.iter_mut().enumerate() {
            *u = number(4 + axis, 0.0, &|_| true, "a finite number is accepted")?;
        }
        spheres.push(Sphere {
            position,
            velocity,
            spin: [0.0; 3],
            diameter,
            density: powder.density,
        });
    }
    check(path, expected, &spheres)?;
    let volume = |sphere: &Sphere| sphere.diameter.powi(3);
    let whole: f64 = spheres.iter().map(volume).sum();
    for axis in 0..3 {
        let mean = spheres.iter().map(|s| volume(s) * s.velocity[axis]).sum::<f64>() / whole;
        spheres.iter_mut().for_each(|sphere| sphere.velocity[axis] -= mean);
    }
    Ok(spheres)
}

/// Whether the deepest overlap of particles of the table at `path`, over their mean diameter, is one of spheres
/// that press on each other.
///
/// # Errors
/// It is not.
pub fn check_overlap(path: &Path, overlap: f64) -> Result<(), StartFileError> {
    if overlap <= DEEPEST {
        return Ok(());
    }
    let why = format!(
        "two of its particles overlap by {overlap:.2} of their mean diameter, and up to {DEEPEST} is accepted"
    );
    Err(StartFileError::Case { path: path.to_owned(), why })
}

/// Whether the particles as a whole are those of the case.
fn check(path: &Path, expected: &Expected, spheres: &[Sphere]) -> Result<(), StartFileError> {
    let refuse = |why: String| Err(StartFileError::Case { path: path.to_owned(), why });
    if spheres.is_empty() {
        return refuse("it has no rows: one particle at least is needed".to_owned());
    }
    let solids: f64 = spheres.iter().map(|s| PI / 6.0 * s.diameter.powi(3)).sum();
    let fraction = solids / expected.size.iter().product::<f64>();
    let asked = expected.solids_fraction;
    if (fraction / asked - 1.0).abs() > TOLERANCE {
        return refuse(format!(
            "its {} particles fill {fraction:.5} of the box and solids_fraction in [box] is {asked}: give \
             {fraction:.5} there",
            spheres.len()
        ));
    }
    let sauter = sauter_mean(spheres.iter().map(|sphere| sphere.diameter));
    let diameter = expected.powder.diameter;
    if (sauter / diameter - 1.0).abs() > TOLERANCE {
        return refuse(format!(
            "the Sauter mean of its diameters is {sauter:.4e} m and diameter in [powder], by which scales and \
             closures go, is {diameter:.4e} m: give {sauter:.4e} there"
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::laws::scales::tests::POWDER;
    use std::fs;

    fn found(name: &str, text: &str, solids_fraction: f64) -> Result<Vec<Sphere>, String> {
        let path =
            std::env::temp_dir().join(format!("favre-start-{}-{name}.csv", std::process::id()));
        fs::write(&path, text).unwrap();
        let expected = Expected { size: [1e-3, 1e-3, 2e-3], powder: POWDER, solids_fraction };
        let found = read(&path, &expected).map_err(|why| why.to_string());
        fs::remove_file(&path).unwrap();
        found
    }

    /// Of one sphere of 75 um in that box.
    const ONE: f64 = 1.1045e-4;

    #[test]
    fn a_table_gives_its_spheres_at_a_mean_velocity_of_zero() {
        let text = "z [m], x [m], y [m], u_x [m/s], u_y [m/s], u_z [m/s]\n\
                    1.5e-3, 1e-4, 2e-4, 0.1, 0, 0.5\n\
                    0, 0, 0, 0.3, 0, -0.5\n";
        let spheres = found("sound", text, 2.0 * ONE).unwrap();
        assert_eq!(spheres[0].position, [1e-4, 2e-4, 1.5e-3]);
        assert_eq!(spheres[0].diameter, POWDER.diameter);
        let close = |a: [f64; 3], b: [f64; 3]| (0..3).all(|n| (a[n] - b[n]).abs() < 1e-15);
        assert!(close(spheres[0].velocity, [-0.1, 0.0, 0.5]), "{:?}", spheres[0]);
        assert!(close(spheres[1].velocity, [0.1, 0.0, -0.5]), "{:?}", spheres[1]);
        // Masses of 1 and 8: the heavier one moves less.
        let text = "x [m],y [m],z [m],diameter [m],u_x [m/s],u_y [m/s],u_z [m/s]\n\
                    1e-4,2e-4,1e-4,4.1666666666666665e-5,0,0,0.9\n\
                    5e-4,5e-4,5e-4,8.333333333333333e-5,0,0,0\n";
        let spheres = found("two", text, 9.0 * ONE / 5.832).unwrap();
        assert!((spheres[0].velocity[2] - 0.8).abs() < 1e-15);
        assert!((spheres[1].velocity[2] + 0.1).abs() < 1e-15);
    }

    #[test]
    fn what_is_no_start_is_refused_with_file_line_column_and_value() {
        for (name, text, parts) in [
            (
                "value",
                "x [m],y [m],z [m]\n\n0,0,0\n0,soon,0\n",
                &["line 4", "\"y [m]\"", "soon"] as &[&str],
            ),
            (
                "outside",
                "x [m],y [m],z [m]\n0,0,0.0021\n",
                &["line 2", "\"z [m]\"", "0.0021", "0.002 m"],
            ),
            ("nan", "x [m],y [m],z [m]\nnan,0,0\n", &["line 2", "\"x [m]\"", "nan"]),
            (
                "size",
                "x [m],y [m],z [m],diameter [m]\n0,0,0,-1\n",
                &["line 2", "\"diameter [m]\"", "-1", "1e-7"],
            ),
            (
                "unknown",
                "x [m],y [m],z [m],d [m]\n0,0,0,1\n",
                &["\"d [m]\" is unknown", "diameter [m]"],
            ),
            ("missing", "x [m],y [m]\n0,0\n", &["\"z [m]\" is missing"]),
            ("two", "x [m],y [m],z [m],u_x [m/s]\n0,0,0,1\n", &["\"u_y [m/s]\" is missing"]),
            ("none", "x [m],y [m],z [m]\n", &["no rows"]),
            ("full", "x [m],y [m],z [m]\n0,0,0\n5e-4,0,0\n", &["solids_fraction", "0.00022"]),
            (
                "sauter",
                "x [m],y [m],z [m],diameter [m]\n0,0,0,9e-5\n",
                &["solids_fraction", "0.00019"],
            ),
        ] {
            let why = found(name, text, ONE).unwrap_err();
            let path = format!("favre-start-{}-{name}.csv", std::process::id());
            assert!(why.contains(&path), "{why}");
            for part in parts {
                assert!(why.contains(part), "{name}: {why}");
            }
        }
        let text = "x [m],y [m],z [m],diameter [m]\n0,0,0,9e-5\n";
        let deep = check_overlap(Path::new("bed.csv"), 0.3).unwrap_err().to_string();
        assert!(deep.contains("bed.csv: two of its particles overlap by 0.30"), "{deep}");
        let why = found("mean", text, 1.728 * ONE).unwrap_err();
        assert!(why.contains("Sauter") && why.contains("9.0000e-5"), "{why}");
    }
}
