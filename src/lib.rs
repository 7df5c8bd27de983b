//! Favre.
#![deny(missing_docs)]
pub mod case;
pub mod fine;
pub mod fit;
pub mod forms;
pub mod grid;
pub mod laws;
pub mod real;
pub mod table;
