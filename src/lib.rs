//! Favre.
#![deny(missing_docs)]
pub mod bench;
pub mod case;
pub mod fine;
pub mod grid;
pub mod laws;
pub mod output;
pub mod pipeline;
pub mod real;
pub mod table;
