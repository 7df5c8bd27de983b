//! The command line: what may be typed.

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use favre::export::{TARGETS, Target};

/// Shown when `favre` is called with nothing.
pub const WELCOME: &str = "\
favre turns a powder and a gas into closure tables for coarse-grid simulations of gas-particle flow:
it simulates a small periodic box finely, filters, bins and fits.

Try first:
  favre run --duration '20 u_t/g'           the default powder in air, briefly, to favre-out/default
  favre run --print-case > my-powder.toml   a commented case file, to be edited
  favre run my-powder.toml                  tables for your powder, to favre-out/my-powder

`favre --help` lists the commands, `favre run --help` the options of a run.";

const EXAMPLES: &str = "\
Examples:
  favre run --print-case > my-powder.toml   write a commented case file, to be edited
  favre run my-powder.toml                  run it; tables go to favre-out/my-powder
  favre run my-powder.toml --duration '50 u_t/g' --out trial
  favre export favre-out/my-powder/model.toml --to openfoam
  favre stability my-powder.toml            what grid and box its instability asks for
  favre bench --quick                       how fast this machine is
  favre verify --quick                      whether the simulator solves its equations

Exit status: 0 done, 1 failed while running, 2 misuse, 130 interrupted.";

const RUN_EXAMPLES: &str = "\
Examples:
  favre run                                 the default powder in air, to favre-out/default
  favre run --print-case > my-powder.toml   a commented case file, to be edited
  favre run my-powder.toml --print-case     the same case resolved: every key, in SI
  favre run my-powder.toml --threads 4 --out tables --force
  favre run my-powder.toml --json | jq .    the summary for a script
  favre run my-powder.toml --resume         go on with a run that was interrupted

Ctrl-C ends a run, leaves nothing half-written and keeps its state beside the output folder, in
DIR.checkpoint. Exit status: 0 done, 1 failed while running, 2 misuse, 130 interrupted.";

const FILTER_EXAMPLES: &str = "\
Examples:
  favre filter favre-out/one favre-out/two          one bin table of two runs, from their sums
  favre filter favre-out/seed-* --out all           of several seeds; a pool can be pooled again
  favre simulate my-powder.toml --out trial         a run that keeps its fields, as .vti
  favre filter trial/fields_0.15                    the same bins again, from the snapshots
  favre filter trial/fields_0.15 --fields vti       and filtered fields beside them, for ParaView
  favre filter case --map map.toml                  all times of an OpenFOAM case
  favre filter out_*.vtu --map map.toml             as the map names the arrays
  favre filter gas_*.vti parts_*.csv --map map.toml particles, deposited on the gas's grid

The table is of all runs, as if they had been boxes of one. disagreements.csv lists the bins in which
boxes of different mean solids fraction are further apart than their 95 % intervals allow. Runs on
several grids are not averaged: values are those on the finest cells, and columns beside them give
those on infinitely fine cells and the grid error.

A map names arrays, or formulae of them, and the powder and the gas:

  [fields]
  solids_fraction = \"1 - EP_g\"
  solids_velocity = [\"U_s1\", \"V_s1\", \"W_s1\"]
  gas_velocity = [\"U_g\", \"V_g\", \"W_g\"]
  pressure = \"P_g\"
  [grid]
  vertical = \"y\"
  periodic = [\"x\", \"z\"]
  [powder]
  diameter = 75e-6
  density = 1500.0
  restitution = 0.9
  max_packing = 0.65
  [gas]
  density = 1.3
  viscosity = 1.8e-5
  [filter]
  widths = [0.005, 0.01]

Read are .vti .vtr .vtu .vtp (.pvd), .npy .npz, .csv, OpenFOAM cases and time folders. A folder, a
.pvd or a case is a run of its own; single files are one run.

Exit status: 0 done, 1 failed, 2 misuse, 130 interrupted.";

const FIT_EXAMPLES: &str = "\
Examples:
  favre fit favre-out/my-powder                     the surface and the default form of H
  favre fit favre-out/seed-* --form slip_drag,saturating_drag,spline --out fit
  favre fit favre-out/my-powder --form drift_velocity,smagorinsky
  favre fit favre-out/my-powder --form my-form.toml a form of one's own
  favre fit bins.csv                                a bin table alone, with narrower intervals

Forms: spline (no form: a smooth surface over solids fraction and filter width), saturating_drag,
slip_drag, drift_velocity, drift_pressure, smagorinsky, viscosity_power, pressure_power. A file is

  name = \"mine\"
  predicts = \"drag_correction\"                      a quantity of bins.csv
  unit = \"-\"                                        or what value_scaled is scaled by
  markers = [\"solids_fraction\", \"filter_width\"]   phi, D; slip: V, shear_rate: S, pressure_gradient: G
  formula = \"a*D/(D + b)*(1 - phi/0.65)\"
  [[parameters]]
  name = \"a\"
  start = 0.8
  low = 0.0                                         with high: between; 0 alone: positive; none: any
  high = 1.0

Each run (a box of one mean solids fraction) is left out once; the form that predicts it best from the
others is the closure. Intervals are of refits to bootstrap replicates of all bins together. What the
data do not fix is named and has no interval.

Exit status: 0 done, 1 failed, 2 misuse, or nothing could be fitted.";

const EXPONENTS_EXAMPLES: &str = "\
Examples:
  favre exponents favre-out/fine favre-out/coarse   runs of two powders
  favre exponents favre-out/my-powder               powers of the filter width alone

Runs of several powders, of the same widths in L_I and the same bins, collapse in Δ_f/L(n),
L(n) = L_I Fr_p^n: n = 0 is L_I = u_t²/g, n = -2/3 is L_II = d Fr_p^(1/3). Powers of the shear rate need
it among the markers of [filter].

Exit status: 0 done, 2 misuse.";

const MODELS_EXAMPLES: &str = "\
Examples:
  favre models list
  favre models show milioli-2013                    its file: formulae, ranges, source, choices
  favre models eval igci-sundaresan-2011-3d --phi 0.05,0.1,0.2 --filter 2,4
  favre models eval milioli-2013 --phi 0.1 --filter 4 --slip 1.5
  favre models eval milioli-2013 --stdin < points   a row of markers a line, a value a line
  favre models compare default sarkar-2016 --bins favre-out/default/bins.csv
  favre models check my-closure.toml                a linter, for any closure

NAME is one that `list` shows or the path of a file: a closure, or the model.toml of a run.

Exit status: 0 done, 1 a check found a fault, 2 misuse.";

const EXPORT_EXAMPLES: &str = "\
Examples:
  favre export default --to openfoam                to favre-out/default-openfoam
  favre export favre-out/my-powder/model.toml --to mfix --out mfix
  favre export igci-sundaresan-2011-3d --to c --out igci
  favre export sarkar-2016 --to latex --out paper

Each folder has a README that says how to use it, the closure's file, and where there is code its test
vectors. A closure that a target cannot take is refused with the reason and the nearest that it can.

Exit status: 0 done, 1 failed, 2 misuse or refused.";

const REPORT_EXAMPLES: &str = "\
Examples:
  favre report favre-out/default                    favre-out/default/report.html, as a run leaves it
  favre report favre-out/* --out all.html           several runs, side by side and each
  favre report favre-out/default --figures paper    and its figures, as SVG and PNG
  favre report favre-out/interrupted                a run as far as it went, from its checkpoints

The page needs no other file and no network. Numbers behind a figure are a click away.

Exit status: 0 done, 1 failed, 2 misuse.";

const STABILITY_EXAMPLES: &str = "\
Examples:
  favre stability my-powder.toml            table and figure go to favre-out/my-powder-stability
  favre stability my-powder.toml --json | jq '.states[].need'

Exit status: 0 done, 1 failed, 2 misuse.";

/// Closures on demand for coarse-grid gas-particle flow: simulate, filter, bin, fit, export.
#[derive(Debug, Parser)]
#[command(name = "favre", version, after_help = EXAMPLES)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Simulate, filter, bin and fit one case
    Run(Run),
    /// As `run`, and keep snapshots of the fields (.vti, or what the case says)
    Simulate(Run),
    /// Bin fields on disk, one's own or anyone's, or put runs together from their sums
    Filter(Filter),
    /// Fit forms to runs: coefficients with intervals, scores on runs left out, a closure
    Fit(Fit),
    /// With which length runs of different powders collapse, and how stresses grow with the filter
    Exponents(Exponents),
    /// Closures, published and one's own: list, show, evaluate, compare, check
    Models(Models),
    /// A closure for OpenFOAM, MFIX, Fluent, C, Fortran, as tables, or for a paper
    Export(Export),
    /// What runs found, as one page to look at
    Report(Report),
    /// Growth of waves on a case's uniform state, and the grid and box they ask for
    Stability(Stability),
    /// Measure how fast this machine runs the kernels
    Bench(Bench),
    /// Check that the simulator solves its equations
    Verify(Verify),
    /// Run cases that break solvers and print how each went
    HardCases(HardCases),
}

/// `favre run`.
#[derive(Args, Debug)]
#[command(after_help = RUN_EXAMPLES)]
pub struct Run {
    /// The case file; without one, the default case: the founding study's powder in air
    #[arg(value_name = "CASE.toml")]
    pub case: Option<PathBuf>,
    /// Folder for the results [default: favre-out/ and the case's name]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace the results of an earlier run, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// Go on with the interrupted run of this case and folder, as if it had not been interrupted
    #[arg(long)]
    pub resume: bool,
    /// Keep the state of an unfinished run this often, to go on from after a crash; 0: never
    #[arg(long, value_name = "N", default_value = "5", value_parser = minutes)]
    #[arg(allow_hyphen_values = true)]
    pub checkpoint_minutes: f64,
    /// Threads to use [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Say nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    /// Print the summary as JSON
    #[arg(long)]
    pub json: bool,
    /// Print the case and stop: the default case with its comments, a given one resolved to SI
    #[arg(long)]
    pub print_case: bool,
    /// Simulated time of each box, instead of the case's: seconds, or text such as '20 u_t/g'
    #[arg(long, value_name = "T", allow_hyphen_values = true)]
    pub duration: Option<String>,
}

/// The formats of filtered fields.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum FieldFiles {
    /// VTK image data, one file per instant and width, and a series
    Vti,
    /// VTKHDF, one file per width with all times
    Vtkhdf,
}

/// `favre filter`.
#[derive(Args, Debug)]
#[command(after_help = FILTER_EXAMPLES)]
pub struct Filter {
    /// Files or folders with resolved fields; or folders of runs, or their sums.favre
    #[arg(value_name = "FIELDS|RUN", required = true)]
    pub paths: Vec<PathBuf>,
    /// What the arrays are, and what the powder and the gas; Favre's own snapshots need none
    #[arg(long, value_name = "MAP.toml")]
    pub map: Option<PathBuf>,
    /// Take statistics of fields from this time on [s]
    #[arg(long, value_name = "T", allow_hyphen_values = true)]
    pub from: Option<f64>,
    /// Filter widths of fields, instead of those of the case or the map [m]
    #[arg(long, value_name = "W,W", value_delimiter = ',')]
    pub widths: Vec<f64>,
    /// Write the filtered fields too: vti files with a pvd series per width, or a vtkhdf file per width
    /// and one of the resolved fields
    #[arg(long, value_name = "FORMAT")]
    pub fields: Option<FieldFiles>,
    /// Of runs on several grids, the order of convergence [default: the one that shows, else 1]
    #[arg(long, value_name = "P", allow_hyphen_values = true, value_parser = order)]
    pub grid_order: Option<f64>,
    /// Folder for the results [default: favre-out/filter, of runs favre-out/pool]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace earlier results, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// Threads to use [default: one per core]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
    /// Say nothing but errors
    #[arg(long, short)]
    pub quiet: bool,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre fit`.
#[derive(Args, Debug)]
#[command(after_help = FIT_EXAMPLES)]
pub struct Fit {
    /// Folders of runs of one powder, their sums.favre or bins.csv
    #[arg(value_name = "RUN", required = true)]
    pub paths: Vec<PathBuf>,
    /// Forms by name, or a file with one's own
    #[arg(
        long,
        value_name = "NAME|FORM.toml",
        value_delimiter = ',',
        default_value = "saturating_drag,spline"
    )]
    pub form: Vec<String>,
    /// Bootstrap replicates
    #[arg(long, value_name = "N", default_value = "200",
        value_parser = clap::value_parser!(u16).range(40..=10000))]
    pub replicates: u16,
    /// Folder for model.toml and run.json [default: favre-out/fit]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace earlier results, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre exponents`.
#[derive(Args, Debug)]
#[command(after_help = EXPONENTS_EXAMPLES)]
pub struct Exponents {
    /// Folders of runs, each of one powder, their sums.favre or bins.csv
    #[arg(value_name = "RUN", required = true)]
    pub paths: Vec<PathBuf>,
    /// Bootstrap replicates; 0 for errors of one fit
    #[arg(long, value_name = "N", default_value = "100",
        value_parser = clap::value_parser!(u16).range(0..=10000))]
    pub replicates: u16,
    /// Print what was found as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre models`.
#[derive(Args, Debug)]
#[command(after_help = MODELS_EXAMPLES)]
pub struct Models {
    /// What to do.
    #[command(subcommand)]
    pub command: ModelsCommand,
}

/// The commands of `favre models`.
#[derive(Debug, Subcommand)]
pub enum ModelsCommand {
    /// The closures that come with favre
    List {
        /// Print them as JSON
        #[arg(long)]
        json: bool,
    },
    /// The file of a closure, with its source, choices and formulae; its test vectors counted
    Show {
        /// Name or file
        #[arg(value_name = "NAME")]
        name: String,
        /// Print the whole file, test vectors and all
        #[arg(long)]
        all: bool,
    },
    /// The value at points: all combinations of what is given, or a row a line from stdin
    Eval(Eval),
    /// Closures beside each other, and beside bins: a table, figures and scores
    Compare(Compare),
    /// Look for faults: jumps, limits, bounds, exponents, scales, ranges, test vectors
    Check {
        /// Names or files; none: all that come with favre
        #[arg(value_name = "NAME")]
        names: Vec<String>,
        /// Only what is not fine
        #[arg(long, short)]
        quiet: bool,
        /// Print the findings as JSON
        #[arg(long)]
        json: bool,
    },
}

/// `favre models eval`.
#[derive(Args, Debug)]
pub struct Eval {
    /// Name or file
    #[arg(value_name = "NAME")]
    pub name: String,
    /// What to evaluate, if the closure has several quantities [default: its first]
    #[arg(long, value_name = "QUANTITY")]
    pub quantity: Option<String>,
    /// Filtered solids fractions
    #[arg(long, value_name = "PHI", value_delimiter = ',', allow_hyphen_values = true)]
    pub phi: Vec<f64>,
    /// Filter widths over the closure's reference length
    #[arg(long, value_name = "D", value_delimiter = ',', allow_hyphen_values = true)]
    pub filter: Vec<f64>,
    /// Filtered slip speeds over u_t
    #[arg(long, value_name = "V", value_delimiter = ',', allow_hyphen_values = true)]
    pub slip: Vec<f64>,
    /// Shear rates times u_t/g, of the phase that the quantity needs
    #[arg(long, value_name = "S", value_delimiter = ',', allow_hyphen_values = true)]
    pub shear: Vec<f64>,
    /// Distances from the wall times g/u_t^2
    #[arg(long, value_name = "X", value_delimiter = ',', allow_hyphen_values = true)]
    pub wall: Vec<f64>,
    /// Filtered pressure gradients over rho_s g
    #[arg(long, value_name = "G", value_delimiter = ',', allow_hyphen_values = true)]
    pub gradient: Vec<f64>,
    /// Read points from stdin: a line each, markers in the order of `show`, commas or blanks between
    #[arg(long, conflicts_with_all = ["phi", "filter", "slip", "shear", "wall", "gradient", "json"])]
    pub stdin: bool,
    /// With --stdin: doubles instead of text, in and out, little-endian
    #[arg(long, requires = "stdin")]
    pub binary: bool,
    /// Print the rows as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre models compare`.
#[derive(Args, Debug)]
pub struct Compare {
    /// Names or files
    #[arg(value_name = "NAME", required = true)]
    pub names: Vec<String>,
    /// What to compare
    #[arg(long, value_name = "QUANTITY", default_value = "drag_correction")]
    pub quantity: String,
    /// A bin table to draw with its intervals and to score against
    #[arg(long, value_name = "BINS.csv")]
    pub bins: Option<PathBuf>,
    /// Filter widths over L_I [default: those of the bins, else 2, 4, 8]
    #[arg(long, value_name = "D", value_delimiter = ',')]
    pub filter: Vec<f64>,
    /// Slip over u_t of the curves; against bins each bin's own is taken
    #[arg(long, value_name = "V", default_value = "1")]
    pub slip: f64,
    /// Shear rate times u_t/g of the curves; likewise
    #[arg(long, value_name = "S", default_value = "1")]
    pub shear: f64,
    /// Folder for the table and the figures [default: favre-out/compare]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace earlier results, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// Print the comparison as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre export`.
#[derive(Args, Debug)]
#[command(after_help = EXPORT_EXAMPLES)]
pub struct Export {
    /// Name or file of a closure, or a run's model.toml
    #[arg(value_name = "MODEL")]
    pub model: String,
    /// openfoam, mfix, fluent, c, fortran, table, latex or markdown
    #[arg(long, value_name = "TARGET", value_parser = target)]
    pub to: Target,
    /// Folder for the files [default: favre-out/ and the closure's name with the target]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace an earlier export, once the new one is complete
    #[arg(long)]
    pub force: bool,
}

fn target(text: &str) -> Result<Target, String> {
    let known = TARGETS.iter().find(|(name, _)| *name == text);
    known.map(|(_, target)| *target).ok_or_else(|| {
        let names = TARGETS.map(|(name, _)| name).join(", ");
        format!("the targets are {names}")
    })
}

/// `favre report`.
#[derive(Args, Debug)]
#[command(after_help = REPORT_EXAMPLES)]
pub struct Report {
    /// Folders of runs; of a run that was interrupted, the folder that it was to fill
    #[arg(value_name = "DIR", required = true)]
    pub paths: Vec<PathBuf>,
    /// The page [default: report.html in DIR, of several runs favre-out/report.html]
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Write its figures too, as SVG and PNG, to this folder
    #[arg(long, value_name = "DIR")]
    pub figures: Option<PathBuf>,
    /// Replace earlier figures, once the new ones are complete
    #[arg(long)]
    pub force: bool,
}

/// `favre stability`.
#[derive(Args, Debug)]
#[command(after_help = STABILITY_EXAMPLES)]
pub struct Stability {
    /// The case file
    #[arg(value_name = "CASE.toml")]
    pub case: PathBuf,
    /// Folder for the results [default: favre-out/ and the case's name with -stability]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace earlier results, once the new ones are complete
    #[arg(long)]
    pub force: bool,
    /// Print growth rates and needs as JSON
    #[arg(long)]
    pub json: bool,
}

fn order(text: &str) -> Result<f64, String> {
    let order = text.parse().ok().filter(|order| (0.1..=10.0).contains(order));
    order.ok_or_else(|| "a number from 0.1 to 10 is accepted".to_owned())
}

/// Longest time between checkpoints [minutes]: a year.
const LONGEST: f64 = 525_600.0;

fn minutes(text: &str) -> Result<f64, String> {
    let minutes = text.parse().ok().filter(|minutes| (0.0..=LONGEST).contains(minutes));
    minutes.ok_or_else(|| format!("a number of minutes from 0 to {LONGEST} is accepted"))
}

/// `favre bench`.
#[derive(Args, Debug)]
pub struct Bench {
    /// One size and fewer rounds; with --error a small box and a short time, only to see it work
    #[arg(long)]
    pub quick: bool,
    /// Speed against error instead: grids, steps, precisions, tolerances, physics; ten minutes
    #[arg(long)]
    pub error: bool,
    /// Folder for the table and the figures of --error [default: favre-out/bench-error]
    #[arg(long, value_name = "DIR", requires = "error")]
    pub out: Option<PathBuf>,
    /// Replace earlier results of --error, once the new ones are complete
    #[arg(long, requires = "error")]
    pub force: bool,
    /// Print the results as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre hard-cases`.
#[derive(Args, Debug)]
pub struct HardCases {
    /// Fewer cells and 20 u_t/g instead of 60
    #[arg(long)]
    pub quick: bool,
    /// Print the table as JSON
    #[arg(long)]
    pub json: bool,
}

/// `favre verify`.
#[derive(Args, Debug)]
pub struct Verify {
    /// Only these checks
    #[arg(long, value_name = "NAME", num_args = 1..)]
    pub only: Vec<String>,
    /// What takes less than a minute: fewer and coarser grids
    #[arg(long)]
    pub quick: bool,
    /// Print the table as JSON
    #[arg(long)]
    pub json: bool,
}
