//! Favre.
#![deny(missing_docs)]
pub mod case;
pub mod field;
pub mod fine;
pub mod grid;
pub mod laws;
pub mod poisson;
pub mod real;
pub mod rows;
pub mod stencil;
pub mod table;
pub mod two_fluid;
