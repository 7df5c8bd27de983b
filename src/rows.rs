//! Walking a field row by row: the only home of threads, of the choice of SIMD, and of `unsafe`.
//!
//! A kernel is a function of slices, one row at a time. [`Rows`] calls it for every row, on as many
//! threads as the pool has, and leaves the outputs' halos periodic. The `simd!` macro compiles a
//! row function for AVX-512, for AVX2 and for the baseline, and picks one at run time, so that a
//! portable binary runs at the speed of a native one.
//!
//! Reductions follow one fixed tree over the rows, so results do not depend on the number of
//! threads.

use crate::field::{Field, HALO, Layout, Row};
use crate::real::Real;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU8, Ordering};

/// Rows that one thread does at a time; also the leaf of the reduction tree.
const LEAF: usize = 32;

/// Instruction sets that kernels are compiled for, best last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Simd {
    /// What every machine of the target has (SSE2 on x86-64).
    Baseline = 1,
    /// AVX2 with FMA.
    Avx2 = 2,
    /// AVX-512 F, VL, DQ, BW, CD.
    Avx512 = 3,
}

static SIMD: AtomicU8 = AtomicU8::new(0);

/// The instruction set that this machine's kernels use.
#[inline(always)]
pub fn simd_level() -> Simd {
    match SIMD.load(Ordering::Relaxed) {
        3 => Simd::Avx512,
        2 => Simd::Avx2,
        1 => Simd::Baseline,
        _ => detect(),
    }
}

#[cold]
fn detect() -> Simd {
    #[cfg(target_arch = "x86_64")]
    let found = if is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw")
        && is_x86_feature_detected!("avx512cd")
        && is_x86_feature_detected!("fma")
    {
        Simd::Avx512
    } else if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        Simd::Avx2
    } else {
        Simd::Baseline
    };
    #[cfg(not(target_arch = "x86_64"))]
    let found = Simd::Baseline;
    SIMD.store(found as u8, Ordering::Relaxed);
    found
}

/// Compiles a row function once per instruction set and picks at run time.
///
/// The generics stand in brackets: `simd! { fn axpy[R: Real](y: &mut \[R\], a: R, x: &\[R\]) { .. } }`.
/// Outputs must be arguments of their own (`&mut \[R\]`), so that the compiler knows that they do not
/// overlap with the inputs.
macro_rules! simd {
    ($(#[$meta:meta])* $vis:vis fn $name:ident[$($generics:tt)*]($($arg:ident: $ty:ty),* $(,)?) $(-> $ret:ty)? $body:block) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments)]
        #[inline(always)]
        $vis fn $name<$($generics)*>($($arg: $ty),*) $(-> $ret)? {
            #[inline(always)]
            #[allow(clippy::too_many_arguments)]
            fn body<$($generics)*>($($arg: $ty),*) $(-> $ret)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            #[allow(clippy::too_many_arguments)]
            fn avx2<$($generics)*>($($arg: $ty),*) $(-> $ret)? { body($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx512cd,avx2,fma")]
            #[allow(clippy::too_many_arguments)]
            fn avx512<$($generics)*>($($arg: $ty),*) $(-> $ret)? { body($($arg),*) }

            #[inline(never)]
            #[allow(clippy::too_many_arguments)]
            fn baseline<$($generics)*>($($arg: $ty),*) $(-> $ret)? { body($($arg),*) }

            #[cfg(target_arch = "x86_64")]
            match $crate::rows::simd_level() {
                // SAFETY: `simd_level` says so only where the processor has the instructions.
                $crate::rows::Simd::Avx512 => return unsafe { avx512($($arg),*) },
                // SAFETY: as above.
                $crate::rows::Simd::Avx2 => return unsafe { avx2($($arg),*) },
                $crate::rows::Simd::Baseline => {}
            }
            baseline($($arg),*)
        }
    };
}
pub(crate) use simd;

/// What `work` returns, done with `threads` threads for the rows of parallel fields.
///
/// # Errors
/// The threads cannot be started.
pub fn on_threads<T: Send>(
    threads: usize,
    work: impl FnOnce() -> T + Send,
) -> Result<T, rayon::ThreadPoolBuildError> {
    Ok(rayon::ThreadPoolBuilder::new().num_threads(threads).build()?.install(work))
}

/// The rows of a layout, and how they are shared out.
#[derive(Clone, Copy, Debug)]
pub struct Rows<const D: usize> {
    layout: Layout<D>,
    parallel: bool,
}

/// The outputs' memory, to be written by several threads in disjoint rows.
struct Outputs<R, const K: usize>([*mut R; K]);

// SAFETY: `Rows::reduce` hands each row to one thread only.
unsafe impl<R: Send, const K: usize> Sync for Outputs<R, K> {}

impl<const D: usize> Rows<D> {
    /// The rows of `layout`; on several threads of the current pool if `parallel`.
    pub fn new(layout: Layout<D>, parallel: bool) -> Self {
        Self { layout, parallel }
    }

    /// Their layout.
    pub fn layout(&self) -> Layout<D> {
        self.layout
    }

    /// Calls `kernel(row, lines)` for every row; `lines` are that row of each output. On return the
    /// outputs' halos are periodic.
    pub fn each<R: Real, const K: usize>(
        &self,
        outputs: [&mut Field<R, D>; K],
        kernel: impl Fn(Row<D>, [&mut [R]; K]) + Sync,
    ) {
        self.reduce(outputs, &kernel, &|(), ()| ());
    }

    /// [`Rows::each`] for a kernel that makes each element of its own neighbours, none further than one
    /// away: rows that lie in memory as their neighbours do are one long row, with what lies between them.
    pub fn map<R: Real, const K: usize>(
        &self,
        outputs: [&mut Field<R, D>; K],
        kernel: impl Fn(Row<D>, [&mut [R]; K]) + Sync,
    ) {
        self.map_reduce(outputs, &kernel, &|(), ()| ());
    }

    /// [`Rows::map`] whose kernel also returns a number (or several), combined as by [`Rows::reduce`]; of a
    /// long row [`Layout::each`] gives the cells.
    pub(crate) fn map_reduce<R: Real, S: Send, const K: usize>(
        &self,
        mut outputs: [&mut Field<R, D>; K],
        kernel: &(impl Fn(Row<D>, [&mut [R]; K]) -> S + Sync),
        combine: &(impl Fn(S, S) -> S + Sync),
    ) -> S {
        let shared = self.shared(&mut outputs);
        let leaf = |begin, end| {
            let mut runs = self.layout.runs(begin, end);
            let first = runs.next().expect("a leaf has rows");
            let first = self.one(first, &shared, kernel);
            runs.fold(first, |all, row| combine(all, self.one(row, &shared, kernel)))
        };
        self.tree(0, self.layout.rows(), &leaf, combine)
    }

    /// [`Rows::each`] whose kernel also returns a number (or several) per row, combined over the
    /// rows in an order that does not depend on the number of threads.
    pub fn reduce<R: Real, S: Send, const K: usize>(
        &self,
        mut outputs: [&mut Field<R, D>; K],
        kernel: &(impl Fn(Row<D>, [&mut [R]; K]) -> S + Sync),
        combine: &(impl Fn(S, S) -> S + Sync),
    ) -> S {
        let shared = self.shared(&mut outputs);
        let one = |row| self.one(self.layout.row(row), &shared, kernel);
        let leaf =
            |begin, end| (begin + 1..end).fold(one(begin), |all, row| combine(all, one(row)));
        self.tree(0, self.layout.rows(), &leaf, combine)
    }

    /// The outputs' memory.
    fn shared<R: Real, const K: usize>(
        &self,
        outputs: &mut [&mut Field<R, D>; K],
    ) -> Outputs<R, K> {
        for output in &*outputs {
            assert_eq!(output.layout, self.layout, "an output of another layout");
        }
        Outputs(outputs.each_mut().map(|field| field.memory()))
    }

    /// Combines a number per row, without outputs.
    pub fn fold<S: Send>(
        &self,
        kernel: &(impl Fn(Row<D>) -> S + Sync),
        combine: &(impl Fn(S, S) -> S + Sync),
    ) -> S {
        self.reduce::<f64, S, 0>([], &|row, []| kernel(row), combine)
    }

    /// What `leaf` makes of the rows from `begin` to before `end`, a few at a time.
    fn tree<S: Send>(
        &self,
        begin: usize,
        end: usize,
        leaf: &(impl Fn(usize, usize) -> S + Sync),
        combine: &(impl Fn(S, S) -> S + Sync),
    ) -> S {
        if end - begin <= LEAF {
            return leaf(begin, end);
        }
        let middle = begin + (end - begin).div_ceil(2).next_multiple_of(LEAF);
        let lower = || self.tree(begin, middle, leaf, combine);
        let upper = || self.tree(middle, end, leaf, combine);
        let (lower, upper) = join(self.parallel, lower, upper);
        combine(lower, upper)
    }

    #[inline(always)]
    fn one<R: Real, S, const K: usize>(
        &self,
        row: Row<D>,
        outputs: &Outputs<R, K>,
        kernel: &impl Fn(Row<D>, [&mut [R]; K]) -> S,
    ) -> S {
        let span = self.layout.span(row);
        // SAFETY: `reduce` holds the outputs mutably, each with memory for this layout from `memory`
        // on and a halo before it, and `tree` visits every row once; rows with their halos do not
        // overlap. The cells are done with when `kernel` returns.
        let lines = |memory: *mut R, halo: isize| unsafe {
            let len = span.len() - 2 * HALO + 2 * halo.unsigned_abs();
            let begin = span.start + HALO as isize - halo;
            std::slice::from_raw_parts_mut(memory.offset(begin), len)
        };
        let result = kernel(row, outputs.0.map(|memory| lines(memory, 0)));
        for memory in outputs.0 {
            self.layout.wrap(lines(memory, HALO as isize));
        }
        result
    }
}

/// Calls `kernel(scratch, place, chunk)` for every `length` items of `data`; on several threads of the
/// current pool if `parallel`, each with a scratch of its own.
pub(crate) fn each_chunk<T: Send, S>(
    parallel: bool,
    data: &mut [T],
    length: usize,
    scratch: impl Fn() -> S + Send + Sync,
    kernel: impl Fn(&mut S, usize, &mut [T]) + Send + Sync,
) {
    if parallel {
        data.par_chunks_mut(length)
            .enumerate()
            .for_each_init(scratch, |scratch, (place, chunk)| kernel(scratch, place, chunk));
    } else {
        let mut scratch = scratch();
        for (place, chunk) in data.chunks_mut(length).enumerate() {
            kernel(&mut scratch, place, chunk);
        }
    }
}

/// Both results; on two threads of the current pool if `parallel`.
pub(crate) fn join<A: Send, B: Send>(
    parallel: bool,
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    if parallel { rayon::join(a, b) } else { (a(), b()) }
}

/// Threads of the current pool.
pub(crate) fn threads() -> usize {
    rayon::current_num_threads()
}

/// One value for each of the `$d` axes. A macro, because `from_fn` with a closure that looks up rows
/// is not inlined, and a row is short.
macro_rules! per_axis {
    ($d:ident, |$axis:ident| $value:expr) => {{
        let mut all = [Default::default(); $d];
        let mut $axis = 0;
        while $axis < $d {
            all[$axis] = $value;
            $axis += 1;
        }
        all
    }};
}
pub(crate) use per_axis;

/// The slices, all cut to `n`.
#[inline(always)]
pub(crate) fn cut<R, const K: usize>(mut slices: [&[R]; K], n: usize) -> [&[R]; K] {
    for slice in &mut slices {
        *slice = &slice[..n];
    }
    slices
}

/// The slices of each axis, all cut to `n`, as three whose third is idle in two dimensions.
///
/// A kernel that indexes slices by a loop over axes keeps a bounds check per slice and loses its
/// vectorised tail; one that takes them apart into names, and asks `D == 3`, does not.
#[inline(always)]
pub(crate) fn by_axis<R, const D: usize, const K: usize>(
    slices: [[&[R]; K]; D],
    n: usize,
) -> [[&[R]; K]; 3] {
    let [mut x, mut y, mut z] = [[&[] as &[R]; K]; 3];
    for k in 0..K {
        x[k] = &slices[0][k][..n];
        y[k] = &slices[1][k][..n];
        z[k] = &slices[D - 1][k][..n];
    }
    [x, y, z]
}

/// Σ over the axes of an expression of an axis's slices, which [`by_axis`] has prepared:
/// `sum_axes!(D, slices, |\[lower, upper\], axis| upper\[i\] - lower\[i\])`. A macro, because a closure
/// used three times is not inlined, and a kernel that calls is not vectorised.
macro_rules! sum_axes {
    ($d:ident, $slices:expr, |$pattern:pat_param, $axis:pat_param| $term:expr) => {{
        let [x, y, z] = &$slices;
        let plane = {
            let ($pattern, $axis) = (x, 0);
            $term
        } + {
            let ($pattern, $axis) = (y, 1);
            $term
        };
        if $d == 3 {
            plane + {
                let ($pattern, $axis) = (z, 2);
                $term
            }
        } else {
            plane
        }
    }};
}
pub(crate) use sum_axes;

/// Elements that a kernel of several stages takes through all of them before the next: a formula of hundreds
/// of operations, each waiting for the one before, is slow as one loop, because a processor looks ahead by a
/// couple of hundred instructions and so finds little else to do meanwhile.
pub(crate) const BLOCK: usize = 128;

/// The elements of a row of `n`, [`BLOCK`] at a time: where each block begins, and how many are in it.
///
/// Slices of a block are to be made as `&q[begin..][..count]`, each by itself. Of slices from a range, or from
/// `map` of an array of them, the compiler does not see that they are as long as the loop; and a loop that
/// it thinks may end early leaves its last elements, a whole vector of them, to be done one by one.
#[inline(always)]
pub(crate) fn blocks(n: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..n).step_by(BLOCK).map(move |begin| (begin, BLOCK.min(n - begin)))
}

/// Lanes of a sum: as many partial sums as fill two of the widest vectors.
const LANES: usize = 16;

/// A function that combines all lanes of an array, half of them with the other half: one after the other,
/// each would wait for the one before. Not inlined, or the compiler lays out the lanes for this and not for
/// the loop that fills them.
macro_rules! by_halves {
    ($name:ident, |$a:ident, $b:ident| $combined:expr) => {
        #[inline(never)]
        fn $name<R: Real>(lanes: &mut [R; LANES]) -> R {
            let mut count = LANES;
            while count > 1 {
                count /= 2;
                for lane in 0..count {
                    let ($a, $b) = (lanes[lane], lanes[lane + count]);
                    lanes[lane] = $combined;
                }
            }
            lanes[0]
        }
    };
}
by_halves!(sum_of, |a, b| a + b);
by_halves!(largest_of, |a, b| a.max(b));

simd! {
    /// Σ a b over a row, in double precision.
    pub(crate) fn dot[A: Real, B: Real](a: &[A], b: &[B]) -> f64 {
        let b = &b[..a.len()];
        let mut lanes = [0.0; LANES];
        let whole = a.len() - a.len() % LANES;
        for (a, b) in a[..whole].chunks_exact(LANES).zip(b[..whole].chunks_exact(LANES)) {
            for lane in 0..LANES {
                lanes[lane] += a[lane].f64() * b[lane].f64();
            }
        }
        for (lane, i) in (whole..a.len()).enumerate() {
            lanes[lane] += a[i].f64() * b[i].f64();
        }
        sum_of(&mut lanes)
    }
}

simd! {
    /// Largest |a| of a row.
    pub(crate) fn max_abs[R: Real](a: &[R]) -> R {
        let mut lanes = [R::ZERO; LANES];
        let whole = a.len() - a.len() % LANES;
        for a in a[..whole].chunks_exact(LANES) {
            for lane in 0..LANES {
                lanes[lane] = lanes[lane].max(a[lane].abs());
            }
        }
        for (lane, a) in lanes.iter_mut().zip(&a[whole..]) {
            *lane = lane.max(a.abs());
        }
        largest_of(&mut lanes)
    }
}

impl<const D: usize> Layout<D> {
    /// The [`blocks`] of the cells of a [`Row`] of `elements`.
    pub(crate) fn blocks(&self, elements: usize) -> impl Iterator<Item = (usize, usize)> + use<D> {
        let (n, stride) = (self.cells[0], self.row_stride());
        let rows = (0..elements).step_by(stride);
        rows.flat_map(move |row| blocks(n).map(move |(begin, m)| (row + begin, m)))
    }

    /// Σ a b over the cells of a [`Row`].
    #[inline(always)]
    pub(crate) fn dot<A: Real, B: Real>(&self, a: &[A], b: &[B]) -> f64 {
        self.each(a).zip(self.each(b)).map(|(a, b)| dot(a, b)).sum()
    }

    /// Largest |a| of the cells of a [`Row`].
    #[inline(always)]
    pub(crate) fn largest<R: Real>(&self, a: &[R]) -> R {
        self.each(a).map(max_abs).fold(R::ZERO, R::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reductions_are_the_same_on_any_number_of_threads() {
        let layout = Layout::new([37, 21, 6]);
        let mut q = Field::<f64, 3>::zeros(layout);
        let mut state = 1u64;
        q.set(|_| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / 1e15
        });
        let sum = |rows: Rows<3>| rows.fold(&|o| dot(q.row(o), q.row(o)), &|a, b| a + b);
        let serial = sum(Rows::new(layout, false));
        for threads in [1, 2, 3, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let parallel = pool.install(|| sum(Rows::new(layout, true)));
            assert_eq!(serial.to_bits(), parallel.to_bits());
        }
        let plain: f64 = q.interior().flatten().map(|q| q * q).sum();
        assert!((serial / plain - 1.0).abs() < 1e-12);
    }

    #[test]
    fn long_rows_make_what_rows_make() {
        fn check<const D: usize>(cells: [usize; D]) {
            let layout = Layout::new(cells);
            let mut q = Field::<f64, D>::zeros(layout);
            let mut count = 0.0;
            q.set(|_| {
                count += 1.0;
                f64::sin(count)
            });
            let rows = Rows::new(layout, true);
            let kernel = |o: Row<D>, [out]: [&mut [f64]; 1]| {
                for axis in 0..D {
                    let (below, above) = (q.row(o.near(axis, -1)), q.row(o.near(axis, 1)));
                    for i in 0..out.len() {
                        out[i] += (1.0 + axis as f64) * above[i] - below[i];
                    }
                }
            };
            let mut outputs = [(); 2].map(|()| Field::<f64, D>::zeros(layout));
            let [by_row, by_piece] = &mut outputs;
            rows.each([by_row], kernel);
            rows.map([by_piece], kernel);
            let [by_row, by_piece] = &outputs;
            for n in 0..layout.rows() {
                for shift in [-2, 0, 2] {
                    let row = layout.row(n).near(0, shift);
                    assert_eq!(by_row.row(row), by_piece.row(row), "{cells:?}, row {n}");
                }
            }
        }
        check([8, 30]);
        check([6, 2]);
        check([1, 5]);
        check([16, 9, 5]);
        check([4, 1, 6]);
        check([5, 2, 3]);
    }

    #[test]
    fn every_row_is_written_once_and_wrapped() {
        let layout = Layout::new([10, 12]);
        let mut q = Field::<f32, 2>::zeros(layout);
        Rows::new(layout, true).each([&mut q], |_, [q]| q.iter_mut().for_each(|q| *q += 1.0));
        assert_eq!(q.sum(), 120.0);
        assert!(q.row(layout.row(0).near(1, -2)).iter().all(|&q| q == 1.0));
        assert!(q.row(layout.row(11).near(0, 2)).iter().all(|&q| q == 1.0));
    }
}
