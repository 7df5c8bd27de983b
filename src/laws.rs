//! Microscopic laws: given physics at the fine scale, scalars in and scalars out.
//!
//! A law knows no grid, field or case, cannot fail, and is branch-free so that a loop over cells
//! vectorises.

pub mod contact;
pub mod drag;
pub mod friction;
pub mod kinetic_theory;
pub mod scales;
