//! What a step of spheres in touch costs: `cargo bench --bench dem -- --help`.
//!
//! Equal spheres, the founding paper's, at random in a periodic cube, hot; a warm-up, then timed steps.
//! Prints one line of JSON; CPU seconds, so that what else runs on the machine counts little.

use clap::Parser;
use favre::dem::{Dem, SKIN, Setup, packed, thermal};
use favre::laws::contact::{Contact, contact_time, damping};
use std::error::Error;
use std::f64::consts::PI;
use std::fmt::Write;
use std::path::PathBuf;

const DIAMETER: f64 = 75e-6;
const DENSITY: f64 = 1500.0;

#[derive(Parser)]
struct Args {
    /// Solids fraction.
    #[arg(long, default_value_t = 0.3)]
    fraction: f64,
    /// Spheres.
    #[arg(long, default_value_t = 59_000)]
    number: usize,
    /// Root mean square velocity along each axis at the start [m/s].
    #[arg(long, default_value_t = 0.05)]
    speed: f64,
    /// Steps before the clock counts.
    #[arg(long, default_value_t = 1000)]
    warm: u64,
    /// Steps that are timed.
    #[arg(long, default_value_t = 2000)]
    steps: u64,
    /// Threads.
    #[arg(long, default_value_t = 1)]
    threads: usize,
    /// How much farther than touching pairs are looked for [diameters].
    #[arg(long, default_value_t = SKIN)]
    skin: f64,
    /// Writes the start as a data file of LAMMPS, and times nothing.
    #[arg(long)]
    data: Option<PathBuf>,
    /// Given by cargo.
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let size = DIAMETER * (args.number as f64 * PI / (6.0 * args.fraction)).cbrt();
    let contact = Contact {
        stiffness: 14.0,
        restitution: 0.9,
        tangential_stiffness: 2.0 / 7.0,
        tangential_damping: 0.5,
        friction: 0.3,
        cohesion: 0.0,
    };
    let parallel = args.threads > 1;
    let timed = || -> Result<(), Box<dyn Error + Send + Sync>> {
        let mut spheres = packed([size; 3], &vec![DIAMETER; args.number], DENSITY, 1, parallel)?;
        thermal(&mut spheres, args.speed * args.speed, 1);
        if let Some(path) = &args.data {
            let mut text = format!(
                "favre\n\n{} atoms\n1 atom types\n0 {size:e} xlo xhi\n0 {size:e} ylo yhi\n0 {size:e} zlo zhi\n\nAtoms # sphere\n\n",
                spheres.len()
            );
            for (n, s) in spheres.iter().enumerate() {
                let [x, y, z] = s.position;
                writeln!(text, "{} 1 {DIAMETER:e} {DENSITY:e} {x:e} {y:e} {z:e}", n + 1)?;
            }
            text.push_str("\nVelocities\n\n");
            for (n, s) in spheres.iter().enumerate() {
                let [u, v, w] = s.velocity;
                writeln!(text, "{} {u:e} {v:e} {w:e} 0 0 0", n + 1)?;
            }
            std::fs::write(path, text)?;
        }
        let skin = args.skin;
        let setup = Setup { size: [size; 3], contact, steps_per_contact: 50.0, skin, parallel };
        let mut dem = Dem::new(setup, &spheres)?;
        let mass = PI / 6.0 * DENSITY * DIAMETER.powi(3);
        let (mut wall, mut cpu) = (0.0, 0.0);
        if args.data.is_none() {
            dem.run(args.warm)?;
            let (started, used) = (std::time::Instant::now(), cpu_time::ProcessTime::now());
            dem.run(args.steps)?;
            (wall, cpu) = (started.elapsed().as_secs_f64(), used.elapsed().as_secs_f64());
        }
        let work = args.number as f64 * args.steps as f64;
        let report = serde_json::json!({
            "fraction": args.fraction,
            "number": args.number,
            "threads": args.threads,
            "time_step": dem.time_step(),
            "contact_time": contact_time(contact.stiffness, contact.restitution, 0.5 * mass),
            "stiffness": contact.stiffness,
            "tangential_stiffness": contact.tangential_stiffness * contact.stiffness,
            "damping": damping(contact.restitution) * (contact.stiffness / (0.5 * mass)).sqrt(),
            "friction": contact.friction,
            "seconds": wall,
            "cpu_seconds": cpu,
            "particle_steps_per_second": work / wall,
            "particle_steps_per_cpu_second": work / cpu,
            "touching_per_particle": dem.touching() as f64 / args.number as f64,
            "temperature": dem.temperature(),
            "steps_per_rebuild": dem.steps() as f64 / dem.rebuilds() as f64,
            "bytes_per_particle": dem.memory() as f64 / args.number as f64,
        });
        println!("{report}");
        Ok(())
    };
    favre::rows::on_threads(args.threads, timed)?.map_err(|error| error as Box<dyn Error>)
}
