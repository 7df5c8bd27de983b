//! Favre.
#![deny(missing_docs)]
pub mod blocking;
pub mod case;
pub mod filter;
pub mod filtered;
pub mod fine;
pub mod grid;
pub mod laws;
pub mod moments;
pub mod real;
pub mod series;
pub mod statistics;
pub mod table;
