//! Where fields are in memory: side by side in large chunks, on the system's large pages where it has them.
//!
//! A sweep in three dimensions reads some hundred streams at once, megabytes apart. On pages of 4 kB finding
//! where those are takes a sixth of its time.

use crate::real::Real;
use memmap2::{MmapMut, MmapRaw};
use std::alloc::{Layout, handle_alloc_error};
use std::ops::{Deref, DerefMut};
use std::ptr::NonNull;
use std::sync::{Arc, Mutex, PoisonError};

/// A large page of most processors.
const PAGE: usize = 2 << 20;

/// Bytes of a chunk. Pages of it that were never used take no memory.
const CHUNK: usize = 32 * PAGE;

/// A cache line, which every [`Memory`] begins with.
const LINE: usize = 64;

/// The chunk that is being filled, and how many bytes of it are taken.
static FILLING: Mutex<Option<(Arc<Chunk>, usize)>> = Mutex::new(None);

/// Some numbers, at first zero; their chunk is given back once nothing in it is in use.
pub struct Memory<R> {
    data: NonNull<R>,
    len: usize,
    /// Held, not looked at.
    #[allow(dead_code)]
    chunk: Arc<Chunk>,
}

/// Memory from the system, all zero.
struct Chunk {
    map: MmapRaw,
    /// Where its first page begins.
    begin: usize,
}

// SAFETY: a `Memory` is the only way to its numbers.
unsafe impl<R: Send> Send for Memory<R> {}
// SAFETY: as above.
unsafe impl<R: Sync> Sync for Memory<R> {}

impl Chunk {
    /// Room for `bytes` from the beginning of a large page on.
    fn new(bytes: usize) -> Self {
        let all = bytes.saturating_add(PAGE);
        let Ok(map) = MmapMut::map_anon(all).map(MmapRaw::from) else {
            handle_alloc_error(Layout::from_size_align(all, 1).unwrap_or(Layout::new::<u8>()));
        };
        // What the system does not do it leaves, and all is as before.
        #[cfg(target_os = "linux")]
        let _ = map.advise(memmap2::Advice::HugePage);
        let begin = map.as_ptr().align_offset(PAGE);
        Self { map, begin }
    }

    /// Address of a byte of it.
    fn at(&self, byte: usize) -> NonNull<u8> {
        let start = self.map.as_mut_ptr().wrapping_add(self.begin + byte);
        NonNull::new(start).expect("no memory is at address 0")
    }
}

impl<R: Real> Memory<R> {
    /// `len` zeros, whose bits are zero in any precision.
    pub fn zeros(len: usize) -> Self {
        let bytes = len.saturating_mul(size_of::<R>()).next_multiple_of(LINE);
        if bytes > CHUNK / 4 {
            let chunk = Arc::new(Chunk::new(bytes));
            return Self { data: chunk.at(0).cast(), len, chunk };
        }
        // Whoever panicked left the place as it was.
        let mut filling = FILLING.lock().unwrap_or_else(PoisonError::into_inner);
        let (chunk, taken) = match filling.take() {
            Some((chunk, taken)) if taken + bytes <= CHUNK => (chunk, taken),
            _ => (Arc::new(Chunk::new(CHUNK)), 0),
        };
        *filling = Some((Arc::clone(&chunk), taken + bytes));
        Self { data: chunk.at(taken).cast(), len, chunk }
    }
}

impl<R> Deref for Memory<R> {
    type Target = [R];

    #[inline(always)]
    fn deref(&self) -> &[R] {
        // SAFETY: `zeros` took these bytes, which are zeros or what was written since, for this alone.
        unsafe { std::slice::from_raw_parts(self.data.as_ptr(), self.len) }
    }
}

impl<R> DerefMut for Memory<R> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [R] {
        // SAFETY: as above, and nobody else has it.
        unsafe { std::slice::from_raw_parts_mut(self.data.as_ptr(), self.len) }
    }
}

impl<R> std::fmt::Debug for Memory<R> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} numbers", self.len)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everyone_has_zeros_of_their_own_on_a_cache_line() {
        let threads: Vec<_> = (1..=4)
            .map(|thread| {
                std::thread::spawn(move || {
                    let sizes = [0, 1, 15, 4096, CHUNK / 32 + 1, CHUNK / 16];
                    let mut held: Vec<Memory<f64>> = Vec::new();
                    for n in 0..30 {
                        let mut memory = Memory::<f64>::zeros(sizes[n % sizes.len()]);
                        assert_eq!(memory.as_ptr().align_offset(LINE), 0);
                        assert!(memory.iter().all(|x| *x == 0.0));
                        memory.fill(f64::from(thread));
                        // Some are given back while others are in use.
                        if n % 3 > 0 {
                            held.push(memory);
                        }
                    }
                    held.iter().flat_map(|memory| memory.iter()).all(|x| *x == f64::from(thread))
                })
            })
            .collect();
        assert!(threads.into_iter().all(|thread| thread.join().unwrap()));
    }

    #[test]
    fn a_chunk_is_given_back_with_the_last_in_it() {
        let large = Memory::<f32>::zeros(CHUNK / 8);
        let chunk = Arc::downgrade(&large.chunk);
        assert!(chunk.upgrade().is_some());
        drop(large);
        assert!(chunk.upgrade().is_none());
    }
}
