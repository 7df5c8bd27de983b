//! Sums on disk: what was summed, so that runs can be pooled, resampled and refitted later.
//!
//! # Format of [`Sums`]
//!
//! Numbers are little-endian; a list is its length (u64) and its elements.
//!
//! | what | type |
//! | --- | --- |
//! | simulated dimensions | u64 |
//! | ρ_s, ρ_g \[kg/m³\] | f64, f64 |
//! | number of the [`Kernel`] | u64 |
//! | filter widths \[m\] | list of f64 |
//! | axes of the bins: number of the [`Marker`], edges | list of u64 and list of f64 |
//! | duration of a block \[s\] | f64 |
//! | blocks of space along each axis | three u64 |
//! | number of terms, number of quantities | u64, u64 |
//! | blocks: place, instants, filter widths | list of u64, u64 and list of visits |
//! | visits: keys; sums of the terms; spreads | list of u64, list of f64, list of f64 |

use crate::binary::{Fault, Source, put, put_list, take, take_list};
use crate::filtered::{QUANTITY_COUNT, TERM_COUNT};
use crate::spectral::Kernel;
use crate::statistics::{Axis, Bins, BlockSums, Layout, Marker, SPREAD, Sums, Visits};
use std::io::{self, Write};

/// Writes sums.
pub(crate) fn put_sums(to: &mut dyn Write, sums: &Sums) -> io::Result<()> {
    let Layout { dimension, densities, kernel, widths, bins, block_duration, space } = &sums.layout;
    put(to, *dimension as u64)?;
    densities.iter().try_for_each(|density| put(to, *density))?;
    put(to, *kernel as u64)?;
    put_list(to, widths)?;
    put(to, bins.axes.len() as u64)?;
    for Axis { marker, edges } in &bins.axes {
        put(to, *marker as u64)?;
        put_list(to, edges)?;
    }
    put(to, *block_duration)?;
    space.iter().try_for_each(|blocks| put(to, *blocks as u64))?;
    put(to, TERM_COUNT as u64)?;
    put(to, QUANTITY_COUNT as u64)?;
    put(to, sums.blocks.len() as u64)?;
    for BlockSums { place, instants, widths } in &sums.blocks {
        put(to, *place)?;
        put(to, *instants)?;
        put(to, widths.len() as u64)?;
        for Visits { keys, sums, spreads } in widths {
            put(to, keys.len() as u64)?;
            keys.iter().try_for_each(|key| put(to, u64::from(*key)))?;
            put_list(to, sums)?;
            put_list(to, spreads)?;
        }
    }
    Ok(())
}

/// Reads sums.
pub(crate) fn take_sums(from: &mut Source) -> Result<Sums, Fault> {
    let dimension = take::<u64>(from)? as usize;
    let densities = [take(from)?, take(from)?];
    let number = take::<u64>(from)?;
    let kernel = usize::try_from(number).ok().and_then(|n| Kernel::ALL.get(n)).copied();
    let kernel = kernel.ok_or_else(|| Fault::damaged("it has an unknown filter kernel"))?;
    let widths = take_list(from)?;
    let axes = (0..from.len(16)?)
        .map(|_| {
            let number = take::<u64>(from)?;
            let marker = usize::try_from(number).ok().and_then(|n| Marker::ALL.get(n)).copied();
            let marker = marker.ok_or_else(|| Fault::damaged("it has an unknown marker"))?;
            let edges = take_list(from)?;
            let ascending = edges.len() > 1 && edges.is_sorted_by(|a, b| a < b);
            if !ascending {
                return Err(Fault::damaged("the edges of its bins do not ascend"));
            }
            Ok(Axis { marker, edges })
        })
        .collect::<Result<Vec<_>, Fault>>()?;
    if axes.first().is_none_or(|axis| axis.marker != Marker::SolidsFraction) {
        return Err(Fault::damaged("its first marker is not the solids fraction"));
    }
    let bins = Bins { axes };
    let block_duration: f64 = take(from)?;
    let mut space = [1; 3];
    for blocks in &mut space {
        *blocks = take::<u64>(from)? as usize;
    }
    let places = space.iter().try_fold(bins.len(), |keys, blocks| keys.checked_mul(*blocks));
    let keys = places.filter(|keys| (1..u32::MAX as usize).contains(keys));
    let Some(keys) = keys.filter(|_| block_duration > 0.0 && (2..=3).contains(&dimension)) else {
        return Err(Fault::damaged("its sums are of no blocks"));
    };
    for (what, ours) in [("terms", TERM_COUNT), ("quantities", QUANTITY_COUNT)] {
        let theirs: u64 = take(from)?;
        if theirs != ours as u64 {
            let what = format!("its sums are of {theirs} {what} instead of {ours}");
            return Err(Fault::Damaged(what));
        }
    }
    let blocks = (0..from.len(24)?)
        .map(|_| {
            let (place, instants) = (take(from)?, take(from)?);
            let of_widths = (0..from.len(24)?)
                .map(|_| take_visits(from, keys))
                .collect::<Result<Vec<Visits>, Fault>>()?;
            if of_widths.len() != widths.len() {
                return Err(Fault::damaged("its sums have other widths than they say"));
            }
            Ok(BlockSums { place, instants, widths: of_widths })
        })
        .collect::<Result<_, Fault>>()?;
    Ok(Sums {
        layout: Layout { dimension, densities, kernel, widths, bins, block_duration, space },
        blocks,
    })
}

fn take_visits(from: &mut Source, bins: usize) -> Result<Visits, Fault> {
    let keys = (0..from.len(8)?)
        .map(|_| match take::<u64>(from)? {
            key if key < bins as u64 => Ok(key as u32),
            _ => Err(Fault::damaged("its sums have other bins than they say")),
        })
        .collect::<Result<Vec<u32>, Fault>>()?;
    let (sums, spreads) = (take_list(from)?, take_list(from)?);
    let whole = sums.len() == keys.len() * TERM_COUNT
        && (spreads.is_empty() || spreads.len() == keys.len() * SPREAD);
    if !whole {
        return Err(Fault::damaged("its sums have other terms than they say"));
    }
    Ok(Visits { keys, sums, spreads })
}
