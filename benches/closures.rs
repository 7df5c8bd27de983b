//! Ten million points through closures, on one thread: `cargo bench --bench closures`.
//!
//! The library call evaluates columns in memory; the command reads from a file and writes to another,
//! doubles or lines of text of six digits. Medians of five and the least, wall time and what of it a core worked. The
//! files are in memory where the system has a place for such, so that no disk is waited for.

use assert_cmd::cargo::cargo_bin;
use cpu_time::ProcessTime;
use favre::closure::Closure;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

const POINTS: usize = 10_000_000;

/// Names of closures, and files from the command line.
const CLOSURES: [&str; 4] = ["default", "igci-sundaresan-2011-2d", "milioli-2013", "sarkar-2016"];

/// The median and the least.
fn middle(mut times: Vec<Duration>) -> String {
    times.sort();
    let [median, least] = [times[times.len() / 2], times[0]].map(|time| time.as_secs_f64());
    format!("{median:.2} ({least:.2})")
}

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let all = CLOSURES.iter().map(|name| (*name).to_owned()).chain(given);
    let memory = Path::new("/dev/shm");
    let place = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let dir = tempfile::tempdir_in(place).expect("a folder for the points");
    println!("10 million points, one thread, seconds:");
    println!(
        "{:26} {:>12} {:>12} {:>22} {:>13}",
        "closure", "library", "of one core", "eval --stdin --binary", "eval --stdin"
    );
    for name in all {
        let closure = Closure::find(&name).expect("a closure");
        let quantity = &closure.quantities[0];
        // Points spread evenly over the ranges, no two alike.
        let columns: Vec<Vec<f64>> = quantity
            .file
            .ranges
            .iter()
            .enumerate()
            .map(|(k, range)| {
                let step =
                    [0.618_033_988_749_894_9, 0.754_877_666_246_692_8, 0.549_700_477_901_967]
                        [k % 3];
                let at = |i: usize| (0.5 + step * i as f64).fract();
                (0..POINTS).map(|i| range.low + at(i) * (range.high - range.low)).collect()
            })
            .collect();
        let parts: Vec<&[f64]> = columns.iter().map(|column| &column[..]).collect();
        let mut values = vec![0.0; POINTS];
        let (mut wall, mut core) = (Vec::new(), Vec::new());
        for _ in 0..5 {
            let (start, worked) = (Instant::now(), ProcessTime::now());
            quantity.evaluate(&parts, &mut values);
            wall.push(start.elapsed());
            core.push(worked.elapsed());
        }
        let path = dir.path().join("points");
        let piped = |options: &[&str]| {
            let passes = (0..5).map(|_| {
                let (from, to) = (File::open(&path), File::create(dir.path().join("values")));
                let start = Instant::now();
                let done = Command::new(cargo_bin!("favre"))
                    .args(["models", "eval", &name, "--stdin"])
                    .args(options)
                    .stdin(from.expect("points"))
                    .stdout(to.expect("values"))
                    .stderr(Stdio::inherit())
                    .status();
                assert!(done.expect("favre").success());
                start.elapsed()
            });
            middle(passes.collect())
        };
        let write = |text: bool| {
            let mut file = BufWriter::new(File::create(&path).expect("a file"));
            for i in 0..POINTS {
                for (k, column) in columns.iter().enumerate() {
                    let end = if k + 1 < columns.len() { ' ' } else { '\n' };
                    let done = match text {
                        true => write!(file, "{:.6}{end}", column[i]),
                        false => file.write_all(&column[i].to_le_bytes()),
                    };
                    done.expect("points written");
                }
            }
            file.flush().expect("points written");
        };
        write(false);
        let binary = piped(&["--binary"]);
        write(true);
        let text = piped(&[]);
        println!("{name:26} {:>12} {:>12} {binary:>22} {text:>13}", middle(wall), middle(core));
    }
}
