//! What `favre models compare` leaves.

use super::RunError;
use crate::compare::Comparison;
use crate::figure;
use crate::output::{Output, RUN_FILE};
use std::io::{self, Write};

/// A comparison in `output`, which the caller commits: comparison.csv, a figure for each filter
/// width, numbered from 1, and run.json.
///
/// # Errors
/// A file cannot be written.
pub fn write_comparison(comparison: &Comparison, output: &Output) -> Result<(), RunError> {
    output.write("comparison.csv", |file| comparison.write_csv(file).map_err(io::Error::other))?;
    for (i, panel) in comparison.panels.iter().enumerate() {
        let drawing = figure::comparison_chart(comparison, panel).figure();
        let name = format!("comparison_{}.svg", i + 1);
        output.write(&name, |file| file.write_all(drawing.svg().as_bytes()))?;
        let pixels = drawing.png()?;
        output.write(&name.replace(".svg", ".png"), |file| file.write_all(&pixels))?;
    }
    output.write(RUN_FILE, |file| Ok(serde_json::to_writer_pretty(file, comparison)?))?;
    Ok(())
}
