//! [`Pool`]: runs put together, and where those of different mean solids fraction disagree.
//!
//! A closure in φ̄ and Δ_f alone says that nothing else matters. Whether the mean solids fraction of
//! the box matters too can be asked of the runs: each bin that boxes of different means have visited
//! is estimated from either alone, and two values disagree if they are further apart than their 95 %
//! intervals, added in squares, allow. One pair in twenty does by chance. A dependence on the mean
//! of the box is a known open question: it is reported, and pooled values hide it.
//!
//! Runs on different grids are never averaged: the table is that of the finest grid, and has beside each
//! value that on infinitely fine cells and the grid error (see [`Grids`]). Boxes are compared on the
//! finest grid.

pub mod grids;

use self::grids::Grids;
use crate::laws::scales::Scales;
use crate::statistics::{MergeError, Sums, bin_table_among};
use crate::sums::{RunSums, SumsError, SumsFile, SumsSystem};
use crate::table::BinRow;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::io::Write;
use std::path::PathBuf;

/// Share of pairs that disagree by chance.
const CHANCE: f64 = 0.05;

/// Runs that cannot be put together.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// A file cannot be read.
    #[error(transparent)]
    Sums(#[from] SumsError),
    /// A run is of another powder, gas or drag law than the first.
    #[error(
        "{path} is of another {what} than {first}: pool runs of one powder in one gas, with one \
         drag law",
        path = path.display(),
        first = first.display()
    )]
    System {
        /// What differs.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// The first file.
        first: PathBuf,
    },
    /// A run is of other filters or bins.
    #[error("{path} does not fit the others", path = path.display())]
    Merge {
        /// The file.
        path: PathBuf,
        /// What differs.
        source: MergeError,
    },
    /// The same run twice.
    #[error(
        "{path} holds a run that is already there, `{name}` of mean solids fraction \
         {solids_fraction}: a run counts once",
        path = path.display()
    )]
    Twice {
        /// The file.
        path: PathBuf,
        /// The run.
        name: String,
        /// Mean solids fraction of its box.
        solids_fraction: f64,
    },
    /// There is no run.
    #[error("no run is given")]
    Nothing,
}

/// Two values of a quantity in a bin, from boxes of different mean solids fraction, that are further
/// apart than their intervals allow.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Disagreement {
    /// The quantity.
    pub quantity: String,
    /// Its unit.
    pub unit: String,
    /// Δ_f \[m\].
    #[serde(rename = "filter_width [m]")]
    pub filter_width: f64,
    /// Edges of the bin of filtered solids fraction.
    #[serde(rename = "solids_fraction_low [-]")]
    pub solids_fraction_low: f64,
    /// Its upper edge.
    #[serde(rename = "solids_fraction_high [-]")]
    pub solids_fraction_high: f64,
    /// Mean solids fraction of the one box.
    #[serde(rename = "box_solids_fraction [-]")]
    pub one: f64,
    /// Value there.
    #[serde(rename = "value")]
    pub one_value: f64,
    /// Half its 95 % interval, on the side of the other.
    #[serde(rename = "half_95")]
    pub one_half: f64,
    /// Mean solids fraction of the other box.
    #[serde(rename = "other_box_solids_fraction [-]")]
    pub other: f64,
    /// Value there.
    #[serde(rename = "other_value")]
    pub other_value: f64,
    /// Half its 95 % interval, on the side of the one.
    #[serde(rename = "other_half_95")]
    pub other_half: f64,
    /// Difference over the joint half interval, above 1.
    pub times_interval: f64,
}

/// How often a quantity's values from boxes of different mean solids fraction disagree.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Agreement {
    /// The quantity.
    pub quantity: String,
    /// Pairs of values that could be compared.
    pub pairs: usize,
    /// Pairs that disagree.
    pub disagree: usize,
}

/// Runs put together.
#[derive(Clone, Debug)]
pub struct Pool {
    /// The runs.
    pub file: SumsFile,
    /// The bin table of all of them, on several grids that of the finest.
    pub bins: Vec<BinRow>,
    /// What the grids say of each other, if there are several.
    pub grids: Option<Grids>,
    /// How often each quantity depends on the box, in the order of the table.
    pub agreement: Vec<Agreement>,
    /// Where, the largest first within a quantity.
    pub disagreements: Vec<Disagreement>,
}

/// What a pool says of itself.
#[derive(Clone, Debug, Serialize)]
pub struct PoolSummary {
    /// Name and mean solids fraction of each run.
    pub runs: Vec<(String, f64)>,
    /// Rows of the bin table.
    pub rows: usize,
    /// What the grids say of each other, if there are several.
    pub grids: Option<Grids>,
    /// How often each quantity depends on the box.
    pub agreement: Vec<Agreement>,
}

impl Pool {
    /// Pools the sums at `paths`: files, or folders of runs. Of runs on several grids, `order` is the
    /// order of convergence; without it the one that the values show, or else the first.
    ///
    /// # Errors
    /// [`PoolError`] for a file that cannot be read or does not fit the others, or a run given twice.
    pub fn read(paths: &[PathBuf], order: Option<f64>) -> Result<Self, PoolError> {
        let mut pooled: Option<SumsFile> = None;
        for path in paths {
            let file = SumsFile::read(path)?;
            match &mut pooled {
                None => pooled = Some(file),
                Some(pooled) => {
                    if let Some(what) = difference(&pooled.system, &file.system) {
                        let (path, first) = (path.clone(), paths[0].clone());
                        return Err(PoolError::System { what, path, first });
                    }
                    for run in file.runs {
                        add(pooled, run, path)?;
                    }
                }
            }
        }
        let file = pooled.ok_or(PoolError::Nothing)?;
        let path = paths[0].clone();
        Self::new(file, order).map_err(|source| PoolError::Merge { path, source })
    }

    /// The tables of these runs; `order` as for [`Pool::read`].
    ///
    /// # Errors
    /// [`MergeError`] if the runs are of different filters or bins.
    pub fn new(file: SumsFile, order: Option<f64>) -> Result<Self, MergeError> {
        let scales = file.system.scales();
        let by_grid = grids::by_grid(&file.runs);
        let (bins, grids) = if by_grid.len() > 1 {
            let (bins, grids) = grids::table(&file.runs, &by_grid, order, &scales)?;
            (bins, Some(grids))
        } else {
            let all: Vec<&Sums> = file.runs.iter().map(|run| &run.sums).collect();
            (bin_table_among(&all, &all, &scales)?, None)
        };
        let finest: Vec<&RunSums> =
            by_grid.first().into_iter().flatten().map(|&run| &file.runs[run]).collect();
        let (agreement, disagreements) = compare(&finest, &scales)?;
        Ok(Self { file, bins, grids, agreement, disagreements })
    }

    /// What it says of itself.
    pub fn summary(&self) -> PoolSummary {
        let runs = self.file.runs.iter();
        PoolSummary {
            runs: runs.map(|run| (run.name.clone(), run.solids_fraction)).collect(),
            rows: self.bins.len(),
            grids: self.grids.clone(),
            agreement: self.agreement.clone(),
        }
    }

    /// Writes the disagreements as CSV.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write_disagreements(&self, to: impl Write) -> csv::Result<()> {
        crate::table::write_rows(&self.disagreements, to)
    }
}

/// What two systems differ in.
fn difference(ours: &SumsSystem, theirs: &SumsSystem) -> Option<&'static str> {
    [
        (ours.powder != theirs.powder, "powder"),
        (ours.gas != theirs.gas, "gas"),
        (ours.gravity != theirs.gravity, "gravity"),
        (ours.drag != theirs.drag, "drag law"),
    ]
    .into_iter()
    .find_map(|(differs, what)| differs.then_some(what))
}

/// Adds a run that is not there yet.
fn add(pooled: &mut SumsFile, run: RunSums, path: &std::path::Path) -> Result<(), PoolError> {
    for ours in &pooled.runs {
        ours.sums
            .matches_but_for_grid(&run.sums)
            .map_err(|source| PoolError::Merge { path: path.to_owned(), source })?;
        if ours.solids_fraction == run.solids_fraction && ours.sums.same_samples(&run.sums) {
            let RunSums { name, solids_fraction, .. } = run;
            return Err(PoolError::Twice { path: path.to_owned(), name, solids_fraction });
        }
    }
    pooled.runs.push(run);
    Ok(())
}

/// Where the values of boxes of different mean solids fraction disagree.
fn compare(
    runs: &[&RunSums],
    scales: &Scales,
) -> Result<(Vec<Agreement>, Vec<Disagreement>), MergeError> {
    let mut fractions: Vec<f64> = runs.iter().map(|run| run.solids_fraction).collect();
    fractions.sort_by(f64::total_cmp);
    fractions.dedup();
    let all: Vec<&Sums> = runs.iter().map(|run| &run.sums).collect();
    let mut tables = Vec::with_capacity(fractions.len());
    for fraction in fractions {
        let of_box = runs.iter().filter(|run| run.solids_fraction == fraction);
        let sums: Vec<&Sums> = of_box.map(|run| &run.sums).collect();
        tables.push((fraction, bin_table_among(&sums, &all, scales)?));
    }
    let found: Vec<BTreeMap<_, &BinRow>> =
        tables.iter().map(|(_, rows)| rows.iter().map(|row| (row.bin(), row)).collect()).collect();
    let (mut agreement, mut disagreements) = (Vec::<Agreement>::new(), Vec::new());
    for (place, (one, rows)) in tables.iter().enumerate() {
        for ((other, _), theirs) in tables.iter().zip(&found).skip(place + 1) {
            for row in rows {
                let Some(their) = theirs.get(&row.bin()) else { continue };
                let halves = halves(row, their);
                let joint = halves[0].hypot(halves[1]);
                if !joint.is_finite() {
                    continue;
                }
                let name = &row.quantity;
                let at = agreement.iter().position(|a| a.quantity == *name).unwrap_or_else(|| {
                    let quantity = name.clone();
                    agreement.push(Agreement { quantity, pairs: 0, disagree: 0 });
                    agreement.len() - 1
                });
                agreement[at].pairs += 1;
                let difference = (row.value - their.value).abs();
                // Equal values without scatter agree.
                if difference <= joint {
                    continue;
                }
                agreement[at].disagree += 1;
                disagreements.push(Disagreement {
                    quantity: row.quantity.clone(),
                    unit: row.unit.clone(),
                    filter_width: row.filter_width,
                    solids_fraction_low: row.solids_fraction_low,
                    solids_fraction_high: row.solids_fraction_high,
                    one: *one,
                    one_value: row.value,
                    one_half: halves[0],
                    other: *other,
                    other_value: their.value,
                    other_half: halves[1],
                    times_interval: difference / joint,
                });
            }
        }
    }
    let order = |d: &Disagreement| agreement.iter().position(|a| a.quantity == d.quantity);
    disagreements.sort_by(|a, b| {
        order(a).cmp(&order(b)).then(b.times_interval.total_cmp(&a.times_interval))
    });
    Ok((agreement, disagreements))
}

/// Halves of the intervals of two values, on the side of each other.
fn halves(a: &BinRow, b: &BinRow) -> [f64; 2] {
    let (below, above) = if a.value < b.value { (a, b) } else { (b, a) };
    let [of_below, of_above] = [below.high_95 - below.value, above.value - above.low_95];
    if a.value < b.value { [of_below, of_above] } else { [of_above, of_below] }
}

impl fmt::Display for PoolSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} runs pooled, {} rows:", self.runs.len(), self.rows)?;
        for (name, fraction) in &self.runs {
            writeln!(f, "  {name}, mean solids fraction {fraction}")?;
        }
        if let Some(grids) = &self.grids {
            writeln!(f, "{grids}")?;
        }
        let [pairs, disagree]: [usize; 2] = [
            self.agreement.iter().map(|a| a.pairs).sum(),
            self.agreement.iter().map(|a| a.disagree).sum(),
        ];
        if pairs == 0 {
            return write!(
                f,
                "no two boxes of different mean solids fraction saw the same bin: whether the mean \
                 of the box matters cannot be said"
            );
        }
        write!(
            f,
            "boxes of different mean solids fraction, compared bin by bin: {disagree} of {pairs} \
             pairs are further apart than their 95 % intervals allow ({:.0} by chance)",
            CHANCE * pairs as f64
        )?;
        let mut worst: Vec<&Agreement> = self.agreement.iter().filter(|a| a.notable()).collect();
        worst.sort_by(|a, b| b.excess().total_cmp(&a.excess()));
        for Agreement { quantity, pairs, disagree } in worst {
            write!(f, "\n  {quantity:<36} {disagree} of {pairs}")?;
        }
        Ok(())
    }
}

impl Agreement {
    /// Disagreements beyond those by chance, in their standard deviations.
    fn excess(&self) -> f64 {
        let pairs = self.pairs as f64;
        (self.disagree as f64 - CHANCE * pairs) / (CHANCE * (1.0 - CHANCE) * pairs).sqrt()
    }

    /// Whether chance alone would hardly do that: a quantity that depends on the mean of the box.
    pub fn notable(&self) -> bool {
        self.excess() > 3.0
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::laws::scales::tests::{GAS, POWDER};
    use crate::statistics::tests::{sampled_runs, scales};

    fn file(solids_fraction: f64, lift: f64, instants: std::ops::Range<u64>) -> SumsFile {
        file_of(solids_fraction, sampled_runs(lift, instants))
    }

    pub(crate) fn file_of(solids_fraction: f64, sums: Sums) -> SumsFile {
        let system =
            SumsSystem { powder: POWDER, gas: GAS, gravity: 9.81, drag: "wen-yu".to_owned() };
        let run = RunSums { name: format!("box {solids_fraction}"), solids_fraction, sums };
        SumsFile { system, runs: vec![run] }
    }

    fn saved(dir: &std::path::Path, name: &str, file: &SumsFile) -> PathBuf {
        let path = dir.join(name);
        file.write(&mut std::fs::File::create(&path).unwrap()).unwrap();
        path
    }

    #[test]
    fn pooled_files_are_the_runs_put_together() {
        let dir = tempfile::tempdir().unwrap();
        let files = [file(0.1, 0.0, 0..60), file(0.1, 0.0, 60..130), file(0.3, 0.0, 200..260)];
        let paths: Vec<PathBuf> =
            files.iter().enumerate().map(|(n, f)| saved(dir.path(), &n.to_string(), f)).collect();
        let pool = Pool::read(&paths, None).unwrap();
        let all: Vec<Sums> = files.iter().map(|file| file.runs[0].sums.clone()).collect();
        assert_eq!(pool.bins, crate::statistics::bin_table(&all, &scales()).unwrap());
        // A pool is a file of sums again.
        let whole = saved(dir.path(), "pool", &pool.file);
        assert_eq!(Pool::read(std::slice::from_ref(&whole), None).unwrap().bins, pool.bins);
        assert_eq!(SumsFile::read(&whole).unwrap(), pool.file);
        // The same fields, whatever the box: disagreements are those of chance.
        let summary = pool.summary();
        let total: usize = summary.agreement.iter().map(|a| a.pairs).sum();
        let disagree: usize = summary.agreement.iter().map(|a| a.disagree).sum();
        assert!(total > 300 && disagree * 10 < total, "{disagree} of {total}");
        assert!(summary.to_string().contains("3 runs pooled"), "{summary}");
    }

    #[test]
    fn boxes_that_disagree_are_reported() {
        let pool = |one: SumsFile, other: SumsFile| {
            let runs = one.runs.into_iter().chain(other.runs).collect();
            Pool::new(SumsFile { runs, ..one_system() }, None).unwrap()
        };
        fn one_system() -> SumsFile {
            SumsFile { runs: vec![], ..file(0.1, 0.0, 0..0) }
        }
        let found = pool(file(0.1, 0.0, 0..80), file(0.3, 0.25, 100..180));
        let of = |name: &str| found.agreement.iter().find(|a| a.quantity == name).unwrap();
        // The gas of the second box is 0.25 m/s faster: its slip differs in every bin, its fraction's
        // variance in none but by chance.
        let slip = of("slip");
        assert!(slip.pairs >= 8 && slip.disagree * 10 >= slip.pairs * 9, "{slip:?}");
        assert!(slip.notable() && !of("solids_fraction_variance").notable());
        let worst = found.disagreements.iter().find(|d| d.quantity == "slip").unwrap();
        assert_eq!((worst.one, worst.other), (0.1, 0.3));
        assert!((worst.other_value - worst.one_value - 0.25).abs() < 0.1, "{worst:?}");
        assert!(worst.times_interval > 1.0 && worst.one_half > 0.0 && worst.other_half > 0.0);
        let says = found.summary().to_string();
        assert!(says.contains("\n  slip "), "{says}");
        // Of one mean fraction there is nothing to compare.
        let alone = pool(file(0.1, 0.0, 0..80), file(0.1, 0.25, 100..180));
        assert!(alone.agreement.is_empty() && alone.disagreements.is_empty());
        assert!(alone.summary().to_string().contains("cannot be said"));
    }

    #[test]
    fn what_does_not_belong_together_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let good = file(0.1, 0.0, 0..20);
        let mut other = file(0.2, 0.0, 30..50);
        other.system.drag = "gidaspow".to_owned();
        let mut wide = file(0.2, 0.0, 30..50);
        wide.runs[0].sums.layout.widths[0] *= 2.0;
        let mut longer = file(0.1, 0.0, 0..30);
        longer.runs[0].sums.discard_before(0.03);
        let good = saved(dir.path(), "good", &good);
        let refused = |name: &str, file: &SumsFile, says: &str| {
            let path = saved(dir.path(), name, file);
            let mut error: &dyn std::error::Error =
                &Pool::read(&[good.clone(), path], None).unwrap_err();
            let mut text = error.to_string();
            while let Some(cause) = error.source() {
                error = cause;
                text += &format!(": {error}");
            }
            assert!(text.contains(says) && text.contains(name), "{text}");
        };
        refused("other", &other, "another drag law than");
        refused("wide", &wide, "filter.widths differ");
        refused("longer", &longer, "a run counts once");
        let mut bytes = std::fs::read(&good).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        let path = dir.path().join("damaged");
        std::fs::write(&path, bytes).unwrap();
        let error = Pool::read(&[path], None).unwrap_err().to_string();
        assert!(error.contains("damaged") && error.contains("checksum"), "{error}");
        assert!(matches!(Pool::read(&[], None), Err(PoolError::Nothing)));
        assert!(Pool::read(&[dir.path().join("none")], None).is_err());
    }
}
