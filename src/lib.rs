//! Favre.
#![deny(missing_docs)]
pub mod case;
pub mod figure;
pub mod fine;
pub mod fit;
pub mod forms;
pub mod grid;
pub mod laws;
pub mod model;
pub mod real;
pub mod table;
