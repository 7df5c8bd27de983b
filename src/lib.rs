#![doc = include_str!("ARCHITECTURE.md")]
#![deny(missing_docs)]
// A loop over the axes, or over the lanes of a vector, indexes several arrays at once.
#![allow(clippy::needless_range_loop)]

pub mod case;

pub mod field;
pub mod grid;
pub mod memory;
pub mod poisson;
pub mod real;
pub mod rows;
pub mod stencil;

pub mod cfd_dem;
pub mod dem;
pub mod drive;
pub mod laws;
pub mod simulation;
pub mod two_fluid;
pub mod viscous;

pub mod exponents;
pub mod expression;
pub mod fine;
pub mod lanes;

pub mod blocking;
pub mod extrapolation;
pub mod film;
pub mod filter;
pub mod filtered;
pub mod filtered_fields;
pub mod moments;
pub mod refit;
pub mod replicates;
pub mod resolved;
pub mod series;
pub mod simulate;
pub mod spectral;
pub mod spline;
pub mod stability;
pub mod statistics;
pub mod stored;
pub mod sums;

pub mod closure;
pub mod compare;
pub mod export;
pub mod fit;
pub mod forms;
pub mod lint;
pub mod model;
pub mod table;

pub mod bench;
pub mod binary;
pub mod checkpoint;
pub mod figure;
pub mod hard;
pub mod output;
pub mod pipeline;
pub mod pool;
pub mod progress;
pub mod report;
pub mod summary;
pub mod terms;
pub mod verify;
