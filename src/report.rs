//! [`page`]: what runs found, as one page to look at: HTML that needs nothing else, neither files
//! beside it nor a network.
//!
//! All of its numbers are those of the files that a run leaves; what is not there is said, and the rest
//! is drawn. Figures are the drawings of [`figure`](crate::figure), each with the numbers behind it.

mod charts;
mod dependence;
mod folder;
mod page;

pub use charts::{Drawing, drawings, drawings_together};
pub use folder::{
    BoxFacts, Folder, Measured, ReportError, RunFacts, SHOWN, ScalesFacts, StripFacts, Trace,
};
pub use page::page;

/// The file that a run leaves.
pub const REPORT_FILE: &str = "report.html";
