//! What a step of particles in gas costs, stage by stage: `cargo bench --bench cfd_dem -- --help`.
//!
//! The founding paper's second box: 4 mm x 4 mm x 16 mm, 16 x 16 x 64 cells, 75 um particles in air, on one
//! thread, from where they have begun to cluster.

use clap::Parser;
use favre::case::Case;
use favre::cfd_dem::STAGES;
use favre::simulate::cfd_dem;
use std::error::Error;
use std::time::Instant;

#[derive(Parser)]
struct Args {
    /// Mean solids fraction.
    #[arg(long, default_value_t = 0.05)]
    fraction: f64,
    /// Simulated time before the clock counts [s].
    #[arg(long, default_value_t = 0.05)]
    warm: f64,
    /// Simulated time that is measured [s].
    #[arg(long, default_value_t = 0.02)]
    time: f64,
    /// What cargo adds.
    #[arg(long, hide = true)]
    bench: bool,
}

const CASE: &str = include_str!("../examples/cfd-dem.toml");

fn main() -> Result<(), Box<dyn Error>> {
    let args = Args::parse();
    let size = CASE.lines().find(|line| line.starts_with("size =")).ok_or("no size")?;
    let cells = CASE.lines().find(|line| line.starts_with("cells =")).ok_or("no cells")?;
    let text = CASE
        .replace(size, "size = [0.004, 0.004, 0.016]")
        .replace(cells, "cells = [16, 16, 64]")
        .replace("widths =", "# widths =");
    let case = Case::parse(&text, "cfd-dem")?;
    let mut flow = cfd_dem(&case, args.fraction, false)?;
    // Whole steps of contacts.
    let short = flow.particles().time_step();
    let whole = |time: f64| (time / short).round() * short;
    let begin = whole(args.warm);
    while flow.time() < begin {
        flow.step(begin)?;
    }
    let (before, steps, started) = (flow.stage_seconds(), flow.particles().steps(), Instant::now());
    let end = begin + whole(args.time);
    let mut gas_steps = 0;
    while flow.time() < end {
        flow.step(end)?;
        gas_steps += 1;
    }
    let seconds = started.elapsed().as_secs_f64();
    let (particles, steps) = (flow.particles().len(), flow.particles().steps() - steps);
    println!(
        "{particles} particles, {steps} steps of contacts in {gas_steps} of the gas: {seconds:.2} s, \
         {:.2} ns per particle and step, {:.0} s per simulated second",
        1e9 * seconds / (particles as f64 * steps as f64),
        seconds / args.time
    );
    for (stage, (after, before)) in STAGES.iter().zip(flow.stage_seconds().into_iter().zip(before))
    {
        println!("{stage:10} {:5.1} %", 100.0 * (after - before) / seconds);
    }
    let bytes = flow.particles().memory() as f64 / particles as f64;
    println!("{bytes:.0} bytes per particle");
    Ok(())
}
