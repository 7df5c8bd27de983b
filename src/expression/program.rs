//! [`Program`]: a formula compiled for many points.
//!
//! Points go through in chunks, operation by operation, so that an operation's loop is tight and its
//! operands stay in cache. What several parts have in common is computed once. A piece of a
//! piecewise formula is computed only at the points that it holds for: what it needs of them is put side
//! by side, so that the piece, too, goes through operation by operation, without gaps.

use super::{Comparison, Expression, Function, Node, Operator};
use crate::real::Real;
use crate::rows::simd;
use std::collections::{BTreeSet, HashMap};
use wide::u8x16;

/// Points that go through together: registers of so many numbers stay in the second cache.
const CHUNK: usize = 256;

/// What a name in a formula stands for.
#[derive(Clone, Copy, Debug)]
pub enum Meaning<'a> {
    /// The input of this number, counted from 0.
    Input(usize),
    /// A number.
    Constant(f64),
    /// Another formula.
    Formula(&'a Expression),
}

/// A formula that has been compiled.
#[derive(Clone, Debug)]
pub struct Program {
    inputs: usize,
    registers: usize,
    constants: Vec<(usize, f64)>,
    blocks: Vec<Vec<Operation>>,
    result: usize,
}

/// Those that it is made of have been written before and have smaller numbers.
#[derive(Clone, Debug)]
struct Operation {
    kind: Kind,
    out: usize,
}

#[derive(Clone, Debug)]
enum Kind {
    Negative(usize),
    Binary(Operator, usize, usize),
    One(Function, usize),
    Two(Function, usize, usize),
    /// Square, cube, x^1.5: exact or faster than the general power.
    Square(usize),
    Cube(usize),
    /// log₂ a where that is computed for several at once, else NaN.
    Log2(usize),
    /// a^b from a, b and log₂ a.
    Power(usize, usize, usize),
    /// a + Σ c_k x_k, left to right, every product and sum rounded as if it were on its own.
    Sum(usize, Vec<(f64, usize)>),
    Select(Vec<Arm>, Block),
}

impl Kind {
    /// Shows `see` each register that it needs; of a piecewise formula those that its arms end in and not
    /// those that they are made of.
    fn reads(&mut self, mut see: impl FnMut(&mut usize)) {
        match self {
            Self::Negative(a)
            | Self::One(_, a)
            | Self::Square(a)
            | Self::Cube(a)
            | Self::Log2(a) => see(a),
            Self::Binary(_, a, b) | Self::Two(_, a, b) => {
                [a, b].into_iter().for_each(see);
            }
            Self::Power(a, b, c) => [a, b, c].into_iter().for_each(see),
            Self::Sum(first, terms) => {
                see(first);
                terms.iter_mut().for_each(|(_, x)| see(x));
            }
            Self::Select(arms, last) => {
                for Arm { left, right, value, .. } in arms {
                    [left, right, &mut value.result].into_iter().for_each(&mut see);
                }
                see(&mut last.result);
            }
        }
    }
}

/// Operations on some of the points, and the register of their result.
#[derive(Clone, Debug)]
struct Block {
    block: usize,
    result: usize,
    /// What it needs from outside and where that is inside.
    carried: Vec<(usize, usize)>,
}

#[derive(Clone, Debug)]
struct Arm {
    left: usize,
    comparison: Comparison,
    right: usize,
    value: Block,
}

/// Conditions that a piecewise formula may have: which one holds is a byte.
const MOST_ARMS: usize = 254;

/// Definitions that lead to each other deeper than this are a circle or a mistake.
const DEEPEST: usize = 50;

/// A value that has been computed already.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Key {
    Constant(u64),
    Formula(String),
    Negative(usize),
    Binary(Operator, usize, usize),
    One(Function, usize),
    Two(Function, usize, usize),
    Log2(usize),
}

/// What a program works on: so many numbers in each register.
struct Registers {
    numbers: Vec<f64>,
    width: usize,
}

/// All registers but one.
#[derive(Clone, Copy)]
struct Others<'a> {
    before: &'a [f64],
    after: &'a [f64],
    but: usize,
    width: usize,
}

impl Registers {
    #[inline(always)]
    fn get(&self, register: usize) -> &[f64] {
        &self.numbers[register * self.width..][..self.width]
    }

    /// A register to be written, and the others to be read.
    #[inline(always)]
    fn apart(&mut self, register: usize) -> (&mut [f64], Others<'_>) {
        let width = self.width;
        let (before, rest) = self.numbers.split_at_mut(register * width);
        let (written, after) = rest.split_at_mut(width);
        (written, Others { before, after, but: register, width })
    }
}

impl<'a> Others<'a> {
    #[inline(always)]
    fn get(&self, register: usize) -> &'a [f64] {
        let Self { before, after, but, width } = *self;
        if register < but {
            &before[register * width..][..width]
        } else {
            &after[(register - but - 1) * width..][..width]
        }
    }
}

struct Compiler<'a> {
    meaning: &'a dyn Fn(&str) -> Option<Meaning<'a>>,
    program: Program,
    values: HashMap<usize, f64>,
    /// What is known where, innermost last.
    known: Vec<HashMap<Key, usize>>,
    depth: usize,
}

impl Program {
    /// Compiles `formula` of `inputs` inputs; `meaning` says what a name stands for.
    ///
    /// # Errors
    /// A name without a meaning, formulae that lead back to themselves, a component of a vector.
    pub fn compile<'a>(
        formula: &Expression,
        inputs: usize,
        meaning: &'a dyn Fn(&str) -> Option<Meaning<'a>>,
    ) -> Result<Self, String> {
        let program = Self {
            inputs,
            registers: inputs,
            constants: Vec::new(),
            blocks: vec![Vec::new()],
            result: 0,
        };
        let values = HashMap::new();
        let mut compiler =
            Compiler { meaning, program, values, known: vec![HashMap::new()], depth: 0 };
        compiler.program.result = compiler.node(formula.root(), 0)?;
        Ok(compiler.program.with_sums().placed())
    }

    /// The same with `a + c1*x1 + c2*x2 ..` as one operation, where nothing else needs its parts: a
    /// polynomial or a spline is little else, and each operation on its own goes through memory.
    fn with_sums(mut self) -> Self {
        let mut uses = vec![0; self.registers];
        uses[self.result] += 1;
        for operation in self.blocks.iter_mut().flatten() {
            operation.kind.reads(|register| uses[*register] += 1);
        }
        let constants: HashMap<usize, f64> = self.constants.iter().copied().collect();
        // Products with a constant and sums that one operation needs, by their registers.
        let mut products = HashMap::new();
        let mut sums: HashMap<usize, (usize, Vec<(f64, usize)>)> = HashMap::new();
        let mut done = vec![false; self.registers];
        for Operation { kind, out } in self.blocks.iter_mut().flatten() {
            let Kind::Binary(operator, a, b) = *kind else { continue };
            let sign = match operator {
                Operator::Multiply => {
                    let product = match (constants.get(&a), constants.get(&b)) {
                        (Some(c), None) => (*c, b),
                        (None, Some(c)) => (*c, a),
                        _ => continue,
                    };
                    products.insert(*out, product);
                    continue;
                }
                Operator::Add => 1.0,
                Operator::Subtract => -1.0,
                _ => continue,
            };
            let Some((c, x)) = products.get(&b).filter(|_| uses[b] == 1) else { continue };
            let before = sums.get(&a).filter(|_| uses[a] == 1).cloned();
            done[b] = true;
            done[a] |= before.is_some();
            let (first, mut terms) = before.unwrap_or((a, Vec::new()));
            terms.push((sign * c, *x));
            *kind = Kind::Sum(first, terms.clone());
            sums.insert(*out, (first, terms));
        }
        for block in &mut self.blocks {
            block.retain(|operation| !done[operation.out]);
        }
        // Those that have gone into sums need no register.
        let mut needed = vec![false; self.registers];
        needed[self.result] = true;
        for operation in self.blocks.iter_mut().flatten() {
            operation.kind.reads(|register| needed[*register] = true);
        }
        self.constants.retain(|(register, _)| needed[*register]);
        self
    }

    /// The same with few registers, so that they stay in cache: one that is no longer needed is written
    /// again. Each piece of a piecewise formula has its own, since other points are side by side there; pieces
    /// that exclude each other use the same.
    fn placed(mut self) -> Self {
        let mut places: HashMap<usize, usize> = (0..self.inputs).map(|i| (i, i)).collect();
        let mut next = self.inputs;
        for (register, _) in &mut self.constants {
            places.insert(*register, next);
            *register = next;
            next += 1;
        }
        let everywhere: HashMap<usize, usize> = places
            .iter()
            .filter(|(_, place)| **place >= self.inputs)
            .map(|(register, place)| (*register, *place))
            .collect();
        self.registers = next;
        self.result = self.place(0, self.result, &mut places, &everywhere, next);
        self
    }

    /// Renames the registers of `block`, which ends in `result`, as `places` says; those that it writes are
    /// new, from `next` on. Gives the new name of the result.
    fn place(
        &mut self,
        block: usize,
        result: usize,
        places: &mut HashMap<usize, usize>,
        everywhere: &HashMap<usize, usize>,
        mut next: usize,
    ) -> usize {
        let mut operations = std::mem::take(&mut self.blocks[block]);
        // The last operation that needs a register.
        let mut last_use = HashMap::new();
        for (n, operation) in operations.iter_mut().enumerate() {
            for register in self.needs(operation, everywhere) {
                last_use.insert(register, n);
            }
        }
        last_use.remove(&result);
        let mut free = Vec::new();
        for (n, operation) in operations.iter_mut().enumerate() {
            // Never one of those that it reads, nor one that its pieces write.
            let new = free.pop().unwrap_or_else(|| {
                next += 1;
                next - 1
            });
            let done = self.needs(operation, everywhere);
            let Operation { kind, out } = operation;
            if let Kind::Select(arms, last) = kind {
                for arm in &mut *arms {
                    (arm.left, arm.right) = (places[&arm.left], places[&arm.right]);
                }
                let values = arms.iter_mut().map(|arm| &mut arm.value);
                for value in values.chain(std::iter::once(last)) {
                    let mut inner = everywhere.clone();
                    let mut first = next;
                    for outside in self.outside(value.block, value.result, everywhere) {
                        value.carried.push((places[&outside], first));
                        inner.insert(outside, first);
                        first += 1;
                    }
                    self.registers = self.registers.max(first);
                    value.result =
                        self.place(value.block, value.result, &mut inner, everywhere, first);
                }
            } else {
                kind.reads(|register| *register = places[register]);
            }
            places.insert(*out, new);
            *out = new;
            let done = done.into_iter().filter(|register| last_use.get(register) == Some(&n));
            free.extend(
                done.map(|register| places[&register]).filter(|place| *place >= self.inputs),
            );
        }
        self.blocks[block] = operations;
        self.registers = self.registers.max(next);
        places[&result]
    }

    /// The registers that an operation and the pieces in it need, of those that are not the same everywhere.
    fn needs(
        &self,
        operation: &mut Operation,
        everywhere: &HashMap<usize, usize>,
    ) -> BTreeSet<usize> {
        let mut needs = BTreeSet::new();
        if let Kind::Select(arms, last) = &operation.kind {
            for Arm { left, right, value, .. } in arms {
                needs.extend([*left, *right]);
                needs.extend(self.outside(value.block, value.result, everywhere));
            }
            needs.extend(self.outside(last.block, last.result, everywhere));
        } else {
            operation.kind.reads(|register| {
                needs.insert(*register);
            });
        }
        needs.retain(|register| !everywhere.contains_key(register));
        needs
    }

    /// The registers that `block` and `result` need of those that are written elsewhere, in order.
    fn outside(
        &self,
        block: usize,
        result: usize,
        everywhere: &HashMap<usize, usize>,
    ) -> BTreeSet<usize> {
        let mut needs = BTreeSet::from([result]);
        for operation in &self.blocks[block] {
            needs.extend(self.needs(&mut operation.clone(), everywhere));
        }
        for Operation { out, .. } in &self.blocks[block] {
            needs.remove(out);
        }
        needs.retain(|register| !everywhere.contains_key(register));
        needs
    }

    /// The value at one point.
    pub fn at(&self, inputs: &[f64]) -> f64 {
        let columns: Vec<[f64; 1]> = inputs.iter().map(|x| [*x]).collect();
        let columns: Vec<&[f64]> = columns.iter().map(|x| &x[..]).collect();
        let mut out = [0.0];
        self.evaluate(&columns, &mut out);
        out[0]
    }

    /// The value at each of `out.len()` points; `inputs` are columns of so many numbers.
    ///
    /// # Panics
    /// Another number of inputs, or columns of another length.
    pub fn evaluate(&self, inputs: &[&[f64]], out: &mut [f64]) {
        self.evaluate_moved(inputs, out, |_, _| {});
    }

    /// As [`evaluate`](Self::evaluate), after `shift` has changed a copy of some numbers of each input.
    ///
    /// # Panics
    /// As for [`evaluate`](Self::evaluate).
    pub fn evaluate_moved(
        &self,
        inputs: &[&[f64]],
        out: &mut [f64],
        shift: impl Fn(usize, &mut [f64]),
    ) {
        assert_eq!(inputs.len(), self.inputs, "number of inputs");
        assert!(inputs.iter().all(|column| column.len() == out.len()), "length of the inputs");
        let width = CHUNK.min(out.len()).max(1);
        let mut registers = Registers { numbers: vec![0.0; self.registers * width], width };
        for (register, value) in &self.constants {
            registers.apart(*register).0.fill(*value);
        }
        for (chunk, out) in out.chunks_mut(width).enumerate() {
            for (i, column) in inputs.iter().enumerate() {
                let part = &column[chunk * width..][..out.len()];
                let register = &mut registers.apart(i).0[..out.len()];
                register.copy_from_slice(part);
                shift(i, register);
            }
            self.run(0, out.len(), &mut registers);
            out.copy_from_slice(&registers.get(self.result)[..out.len()]);
        }
    }

    /// Runs `block` at the first `count` points of the registers.
    fn run(&self, block: usize, count: usize, registers: &mut Registers) {
        for Operation { kind, out } in &self.blocks[block] {
            if let Kind::Select(arms, last) = kind {
                self.select(arms, last, *out, count, registers);
                continue;
            }
            let (out, others) = registers.apart(*out);
            let out = &mut out[..count];
            let register = |register: &usize| &others.get(*register)[..count];
            match kind {
                Kind::Negative(a) => each_of_one(out, register(a), |a| -a),
                Kind::Binary(operator, a, b) => {
                    let (a, b) = (register(a), register(b));
                    match operator {
                        Operator::Add => each_of_two(out, a, b, |a, b| a + b),
                        Operator::Subtract => each_of_two(out, a, b, |a, b| a - b),
                        Operator::Multiply => each_of_two(out, a, b, |a, b| a * b),
                        Operator::Divide => each_of_two(out, a, b, |a, b| a / b),
                        Operator::Power => unreachable!("made of a logarithm"),
                    }
                }
                Kind::Square(a) => each_of_one(out, register(a), |a| a * a),
                Kind::Cube(a) => each_of_one(out, register(a), |a| a * a * a),
                Kind::Log2(a) => logarithms(register(a), out),
                Kind::Power(a, b, log) => powers(register(a), register(b), register(log), out),
                Kind::Sum(first, terms) => sum(out, register(first), terms, others),
                // By name: a choice outside the loop.
                Kind::One(function, a) => match function {
                    Function::Exp => exponentials(register(a), out),
                    Function::Sqrt => each_of_one(out, register(a), f64::sqrt),
                    Function::Abs => each_of_one(out, register(a), f64::abs),
                    // Logarithms are the library's, to the last digit: of a spline's terms in one little is left.
                    function => each_of_one(out, register(a), |a| function.of_one(a)),
                },
                Kind::Two(function, a, b) => {
                    let (a, b) = (register(a), register(b));
                    match function {
                        Function::Min => each_of_two(out, a, b, |a, b| Function::Min.of_two(a, b)),
                        _ => each_of_two(out, a, b, |a, b| Function::Max.of_two(a, b)),
                    }
                }
                Kind::Select(..) => unreachable!("done above"),
            }
        }
    }

    /// Sorts the points by the arm that holds for each and runs every arm at its own.
    fn select(
        &self,
        arms: &[Arm],
        last: &Block,
        out: usize,
        count: usize,
        registers: &mut Registers,
    ) {
        let mut which = [arms.len() as u64; CHUNK];
        let which = &mut which[..count];
        for (number, arm) in arms.iter().enumerate().rev() {
            let [left, right] = [arm.left, arm.right].map(|side| &registers.get(side)[..count]);
            // By name: a choice outside the loop.
            match arm.comparison {
                Comparison::Less => mark(which, left, right, number, |a, b| a < b),
                Comparison::LessOrEqual => mark(which, left, right, number, |a, b| a <= b),
                Comparison::Greater => mark(which, left, right, number, |a, b| a > b),
                Comparison::GreaterOrEqual => mark(which, left, right, number, |a, b| a >= b),
            }
        }
        // Beyond the points none holds.
        let mut choices = [u8::MAX; CHUNK];
        for (choice, which) in choices.iter_mut().zip(which) {
            *choice = *which as u8;
        }
        let mut list = [0; CHUNK];
        for (number, value) in arms.iter().map(|arm| &arm.value).chain([last]).enumerate() {
            let list = places(&choices, number as u8, &mut list);
            if list.is_empty() {
                continue;
            }
            for (from, to) in &value.carried {
                let (to, others) = registers.apart(*to);
                let from = &others.get(*from)[..count];
                for (to, i) in to.iter_mut().zip(list) {
                    *to = from[usize::from(*i)];
                }
            }
            self.run(value.block, list.len(), registers);
            let (out, others) = registers.apart(out);
            let out = &mut out[..count];
            for (found, i) in others.get(value.result).iter().zip(list) {
                out[usize::from(*i)] = *found;
            }
        }
    }
}

/// Where in `choices` a number is.
fn places<'a>(choices: &[u8; CHUNK], number: u8, list: &'a mut [u8; CHUNK]) -> &'a [u8] {
    let mut length = 0;
    for (k, choices) in choices.as_chunks().0.iter().enumerate() {
        let mut found = u8x16::from(*choices).simd_eq(u8x16::splat(number)).to_bitmask();
        while found != 0 {
            list[length] = (16 * k) as u8 + found.trailing_zeros() as u8;
            found &= found - 1;
            length += 1;
        }
    }
    &list[..length]
}

simd! {
    /// Writes `number` where `holds` does.
    fn mark[F: Fn(f64, f64) -> bool](which: &mut [u64], left: &[f64], right: &[f64], number: usize, holds: F) {
        for ((which, left), right) in which.iter_mut().zip(left).zip(right) {
            *which = if holds(*left, *right) { number as u64 } else { *which };
        }
    }
}

/// Powers that are 2 to no more than the last of these, or its inverse, are computed several at once, to
/// [`TOGETHER_ERROR`]; those beyond one by one. So are those that are 2 to less than the first: of 1 - x^y
/// near 1 nothing but the last digit may be left.
const TOGETHER: [f64; 2] = [0.0625, 64.0];

/// Likewise of exponentials, whose error does not grow: up to where results are no longer normal.
const EXPONENTIALS: [f64; 2] = [0.0625, 1000.0];

/// Relative error of powers and exponentials computed several at once.
#[cfg(test)]
const TOGETHER_ERROR: f64 = 2e-14;

simd! {
    /// `out` = log₂ a where a is positive and normal, else NaN.
    fn logarithms[](a: &[f64], out: &mut [f64]) {
        for (out, a) in out.iter_mut().zip(a) {
            let normal = (*a >= f64::MIN_POSITIVE) & (*a <= f64::MAX);
            *out = f64::select(normal, Real::log2(*a), f64::NAN);
        }
    }
}

simd! {
    /// `out` = 2^(b log) where that is among [`TOGETHER`], else NaN; whether all are.
    fn moderate_powers[](b: &[f64], log: &[f64], out: &mut [f64]) -> bool {
        let mut beyond = 0u64;
        for ((out, b), log) in out.iter_mut().zip(b).zip(log) {
            let exponent = *b * *log;
            let moderate = (exponent.abs() >= TOGETHER[0]) & (exponent.abs() <= TOGETHER[1]);
            beyond |= u64::from(!moderate);
            let power = Real::exp2(f64::select(moderate, exponent, 0.0));
            *out = f64::select(moderate, power, f64::NAN);
        }
        beyond == 0
    }
}

/// ln 2 in two parts, the first short enough that a multiple of it is exact.
const LN_2: [f64; 2] = [f64::from_bits(0x3fe6_2e42_fee0_0000), 1.908_214_929_270_587_7e-10];

/// 1.5 · 2⁵²: adding it rounds to an integer and leaves that in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;

simd! {
    /// `out` = e^a where that is 2 to one of [`EXPONENTIALS`], else NaN; whether all are.
    fn moderate_exponentials[](a: &[f64], out: &mut [f64]) -> bool {
        let mut beyond = 0u64;
        for (out, a) in out.iter_mut().zip(a) {
            let exponent = *a * std::f64::consts::LOG2_E;
            let moderate =
                (exponent.abs() >= EXPONENTIALS[0]) & (exponent.abs() <= EXPONENTIALS[1]);
            beyond |= u64::from(!moderate);
            // a = n ln 2 + r: r keeps its digits where a is large.
            let shifted = f64::select(moderate, exponent, 0.0) + ROUND;
            let n = shifted - ROUND;
            let r = (f64::select(moderate, *a, 0.0) - n * LN_2[0]) - n * LN_2[1];
            let power = Real::exp2(r * std::f64::consts::LOG2_E);
            let power = f64::from_bits(power.to_bits().wrapping_add(shifted.to_bits() << 52));
            *out = f64::select(moderate, power, f64::NAN);
        }
        beyond == 0
    }
}

/// a^b, where `log` is log₂ a. Which points go together changes no value: each is of one kind or of the
/// other by itself.
fn powers(a: &[f64], b: &[f64], log: &[f64], out: &mut [f64]) {
    if !moderate_powers(b, log, out) {
        for ((out, a), b) in out.iter_mut().zip(a).zip(b).filter(|((out, _), _)| out.is_nan()) {
            *out = a.powf(*b);
        }
    }
}

/// e^a.
fn exponentials(a: &[f64], out: &mut [f64]) {
    if !moderate_exponentials(a, out) {
        for (out, a) in out.iter_mut().zip(a).filter(|(out, _)| out.is_nan()) {
            *out = a.exp();
        }
    }
}

simd! {
    /// `out` = `operate`(a), element by element.
    fn each_of_one[F: Fn(f64) -> f64](out: &mut [f64], a: &[f64], operate: F) {
        for (out, a) in out.iter_mut().zip(a) {
            *out = operate(*a);
        }
    }
}

simd! {
    /// `out` = `operate`(a, b), element by element.
    fn each_of_two[F: Fn(f64, f64) -> f64](out: &mut [f64], a: &[f64], b: &[f64], operate: F) {
        for ((out, a), b) in out.iter_mut().zip(a).zip(b) {
            *out = operate(*a, *b);
        }
    }
}

/// Numbers that a sum is held for at once.
const LANES: usize = 32;

simd! {
    /// `out` = a + Σ c x, the x in `registers`.
    fn sum[](out: &mut [f64], a: &[f64], terms: &[(f64, usize)], registers: Others) {
        let (many, rest) = out.as_chunks_mut::<LANES>();
        let rest_at = many.len() * LANES;
        for (k, out) in many.iter_mut().enumerate() {
            let at = k * LANES;
            let mut sum = [0.0; LANES];
            for (sum, a) in sum.iter_mut().zip(&a[at..][..LANES]) {
                *sum = *a;
            }
            for (c, x) in terms {
                let x = &registers.get(*x)[at..][..LANES];
                for (sum, x) in sum.iter_mut().zip(x) {
                    *sum += *c * *x;
                }
            }
            *out = sum;
        }
        for (i, out) in rest.iter_mut().enumerate() {
            let add = |sum, (c, x): &(f64, usize)| sum + c * registers.get(*x)[rest_at + i];
            *out = terms.iter().fold(a[rest_at + i], add);
        }
    }
}

impl<'a> Compiler<'a> {
    fn node(&mut self, node: &Node, block: usize) -> Result<usize, String> {
        match node {
            Node::Number(number) => Ok(self.constant(*number)),
            Node::Name(name) => self.name(name, block),
            Node::Negative(inner) => {
                let a = self.node(inner, block)?;
                match self.values.get(&a) {
                    Some(value) => Ok(self.constant(-*value)),
                    None => Ok(self.operation(Key::Negative(a), Kind::Negative(a), block)),
                }
            }
            Node::Component(..) => {
                Err("a component [n] is taken, and there are no vectors here".into())
            }
            Node::Binary(operator, a, b) => {
                let (a, b) = (self.node(a, block)?, self.node(b, block)?);
                Ok(self.binary(*operator, a, b, block))
            }
            Node::Call(function, arguments) => {
                let (first, others) = arguments.split_first().expect("a call has an argument");
                let mut result = self.node(first, block)?;
                if others.is_empty() {
                    return Ok(match self.values.get(&result) {
                        Some(value) => self.constant(function.of_one(*value)),
                        None => {
                            let key = Key::One(*function, result);
                            self.operation(key, Kind::One(*function, result), block)
                        }
                    });
                }
                for other in others {
                    let other = self.node(other, block)?;
                    let key = Key::Two(*function, result, other);
                    result = self.operation(key, Kind::Two(*function, result, other), block);
                }
                Ok(result)
            }
            Node::Piecewise(arms, last) => {
                if arms.len() > MOST_ARMS {
                    return Err(format!(
                        "a piecewise formula of {} conditions is too long: {MOST_ARMS} at most; nest it",
                        arms.len()
                    ));
                }
                let mut compiled = Vec::new();
                for (condition, value) in arms {
                    let left = self.node(&condition.left, block)?;
                    let right = self.node(&condition.right, block)?;
                    let value = self.inner(value)?;
                    let comparison = condition.comparison;
                    compiled.push(Arm { left, comparison, right, value });
                }
                let last = self.inner(last)?;
                let out = self.register();
                self.program.blocks[block]
                    .push(Operation { kind: Kind::Select(compiled, last), out });
                Ok(out)
            }
        }
    }

    /// A block of its own, for some of the points.
    fn inner(&mut self, node: &Node) -> Result<Block, String> {
        self.known.push(HashMap::new());
        let block = self.block();
        let result = self.node(node, block)?;
        self.known.pop();
        Ok(Block { block, result, carried: Vec::new() })
    }

    fn name(&mut self, name: &str, block: usize) -> Result<usize, String> {
        let Some(meaning) = (self.meaning)(name) else {
            return Err(format!("`{name}` is not known here"));
        };
        let formula = match meaning {
            Meaning::Input(number) => return Ok(number),
            Meaning::Constant(value) => return Ok(self.constant(value)),
            Meaning::Formula(formula) => formula,
        };
        let key = Key::Formula(name.to_owned());
        if let Some(register) = self.find(&key) {
            return Ok(register);
        }
        if self.depth == DEEPEST {
            return Err(format!("`{name}` leads back to itself, or through too many formulae"));
        }
        self.depth += 1;
        let result = self.node(formula.root(), block)?;
        self.depth -= 1;
        self.innermost().insert(key, result);
        Ok(result)
    }

    fn binary(&mut self, operator: Operator, a: usize, b: usize, block: usize) -> usize {
        let (left, right) = (self.values.get(&a).copied(), self.values.get(&b).copied());
        if let (Some(left), Some(right)) = (left, right) {
            return self.constant(operator.apply(left, right));
        }
        let mut kind = Kind::Binary(operator, a, b);
        if operator == Operator::Power {
            match right {
                Some(1.0) => return a,
                Some(2.0) => kind = Kind::Square(a),
                Some(3.0) => kind = Kind::Cube(a),
                Some(0.5) => kind = Kind::One(Function::Sqrt, a),
                Some(1.5) => {
                    let root = self.operation(
                        Key::One(Function::Sqrt, a),
                        Kind::One(Function::Sqrt, a),
                        block,
                    );
                    kind = Kind::Binary(Operator::Multiply, a, root);
                }
                _ => kind = Kind::Power(a, b, self.log2(a, block)),
            }
        }
        self.operation(Key::Binary(operator, a, b), kind, block)
    }

    /// log₂ of a register: powers of the same number share it.
    fn log2(&mut self, a: usize, block: usize) -> usize {
        self.operation(Key::Log2(a), Kind::Log2(a), block)
    }

    fn operation(&mut self, key: Key, kind: Kind, block: usize) -> usize {
        if let Some(register) = self.find(&key) {
            return register;
        }
        let out = self.register();
        self.program.blocks[block].push(Operation { kind, out });
        self.innermost().insert(key, out);
        out
    }

    fn constant(&mut self, value: f64) -> usize {
        let key = Key::Constant(value.to_bits());
        if let Some(register) = self.find(&key) {
            return register;
        }
        let register = self.register();
        self.program.constants.push((register, value));
        self.values.insert(register, value);
        // A constant is filled in before anything runs, so all may use it.
        self.known[0].insert(key, register);
        register
    }

    fn register(&mut self) -> usize {
        self.program.registers += 1;
        self.program.registers - 1
    }

    fn block(&mut self) -> usize {
        self.program.blocks.push(Vec::new());
        self.program.blocks.len() - 1
    }

    fn find(&self, key: &Key) -> Option<usize> {
        self.known.iter().rev().find_map(|known| known.get(key).copied())
    }

    fn innermost(&mut self) -> &mut HashMap<Key, usize> {
        self.known.last_mut().expect("there is always an outermost")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn compiled(text: &str) -> Result<Program, String> {
        let formula = Expression::parse(text)?;
        let (double, circle) =
            (Expression::parse("2*x").unwrap(), Expression::parse("circle + 1").unwrap());
        Program::compile(&formula, 2, &|name| match name {
            "x" => Some(Meaning::Input(0)),
            "y" => Some(Meaning::Input(1)),
            "c" => Some(Meaning::Constant(3.0)),
            "double" => Some(Meaning::Formula(&double)),
            "circle" => Some(Meaning::Formula(&circle)),
            _ => None,
        })
    }

    #[test]
    fn numbers_follow_the_tree() {
        let at = |text: &str| compiled(text).unwrap().at(&[2.0, 5.0]);
        assert_eq!(at("x*y - c"), 7.0);
        assert_eq!(at("double^2 + x^3 + y^1"), 29.0);
        assert_eq!(at("x^1.5"), 2.0 * 2f64.sqrt());
        assert_eq!(at("-x^2"), -4.0);
        assert_eq!(at("piecewise(x < 1, 10, y >= 5, double, 0) + max(x, y, c)"), 9.0);
        assert_eq!(at("c"), 3.0);
        assert_eq!(at("x"), 2.0);
    }

    #[test]
    fn what_cannot_be_compiled_says_why() {
        assert_eq!(compiled("x + z").unwrap_err(), "`z` is not known here");
        assert!(compiled("circle").unwrap_err().contains("leads back to itself"));
        assert!(compiled("x[0]").unwrap_err().contains("no vectors"));
        let pieces = |count| format!("piecewise({} 7)", "x < 1, 2, ".repeat(count));
        assert_eq!(compiled(&pieces(MOST_ARMS)).unwrap().at(&[1.5, 0.0]), 7.0);
        assert!(compiled(&pieces(MOST_ARMS + 1)).unwrap_err().contains("too long: 254 at most"));
    }

    #[test]
    fn what_is_common_is_computed_once() {
        let program =
            compiled("exp(double) + exp(2*x) * piecewise(y < 1, exp(double), 1)").unwrap();
        let exponentials = program
            .blocks
            .iter()
            .flatten()
            .filter(|operation| matches!(operation.kind, Kind::One(Function::Exp, _)));
        assert_eq!(exponentials.count(), 1);
    }

    #[test]
    fn registers_are_written_again_and_constants_in_sums_have_none() {
        let steps: Vec<String> = (2..40).map(|k| format!("exp(x/{k}.5)*sqrt(y + {k})")).collect();
        let program = compiled(&steps.join(" - ")).unwrap();
        // Inputs, constants, and what one term and the sum so far need.
        assert!(program.registers <= 2 + program.constants.len() + 4, "{}", program.registers);
        let expected: f64 = (2..40)
            .map(f64::from)
            .map(|k| {
                let term = (0.7 / (k + 0.5)).exp() * (1.3 + k).sqrt();
                if k == 2.0 { term } else { -term }
            })
            .sum();
        assert!((program.at(&[0.7, 1.3]) / expected - 1.0).abs() < 1e-13);
        let sum = compiled("1 + 0.3*x - 1.7*y + 0.1*x^2").unwrap();
        assert_eq!(sum.constants.len(), 1);
    }

    #[test]
    fn sums_of_products_are_one_operation_and_change_no_bit() {
        let program = compiled("1 + 0.3*x - 1.7*y + 0.1*x^2 - c*exp(y) + y").unwrap();
        let sums = program.blocks.iter().flatten().filter_map(|operation| match &operation.kind {
            Kind::Sum(_, terms) => Some(terms.len()),
            _ => None,
        });
        assert_eq!(sums.collect::<Vec<_>>(), [4]);
        let x: Vec<f64> = (0..300).map(|i| (f64::from(i) * 0.618).fract()).collect();
        let y: Vec<f64> = (0..300).map(|i| (f64::from(i) * 0.755).fract()).collect();
        let mut found = vec![0.0; 300];
        program.evaluate(&[&x, &y], &mut found);
        // One in a piecewise formula, at some of the points.
        let pieces = compiled("piecewise(x < 0.5, 1 + 0.3*x - 1.7*y, 2*y - 0.1*x)").unwrap();
        let mut some = vec![0.0; 300];
        pieces.evaluate(&[&x, &y], &mut some);
        for i in 0..300 {
            let (x, y) = (x[i], y[i]);
            let expected = 1.0 + 0.3 * x - 1.7 * y + 0.1 * (x * x) - 3.0 * y.exp() + y;
            assert!((found[i] / expected - 1.0).abs() < 1e-12, "{} for {expected}", found[i]);
            let exact = if x < 0.5 { 1.0 + 0.3 * x - 1.7 * y } else { 2.0 * y - 0.1 * x };
            assert_eq!(some[i].to_bits(), exact.to_bits(), "at {x}, {y}");
        }
        // A product that something else needs stays.
        let twice = compiled("(1 + 0.3*x) * (2 + 0.3*x)").unwrap();
        assert_eq!(twice.at(&[0.7, 0.0]), (1.0 + 0.3 * 0.7) * (2.0 + 0.3 * 0.7));
    }

    #[test]
    fn powers_beyond_those_computed_together_are_the_library_s() {
        for (x, y) in
            [(0.0, 0.5), (-8.0, 3.0), (-8.0, 0.3), (5e-324, 0.5), (1e300, 2.0), (2.0, -70.5)]
                .into_iter()
                .chain([
                    (f64::INFINITY, 0.2),
                    (f64::NAN, 0.2),
                    (0.3, f64::NAN),
                    (1e-3, -30.0),
                    (0.0, 0.0),
                ])
        {
            let found = compiled("x^y").unwrap().at(&[x, y]);
            assert_eq!(found.to_bits(), f64::powf(x, y).to_bits(), "{x}^{y}");
        }
        for x in
            [-800.0, -700.0, 700.0, 710.0, 1e-9, -0.03, f64::INFINITY, f64::NEG_INFINITY, f64::NAN]
        {
            let found = compiled("exp(x)").unwrap().at(&[x, 0.0]);
            assert_eq!(found.to_bits(), x.exp().to_bits(), "e^{x}");
        }
        assert_eq!(compiled("exp(x)").unwrap().at(&[0.0, 0.0]), 1.0);
        assert_eq!(compiled("x^y").unwrap().at(&[1.0, 0.3]), 1.0);
    }

    proptest! {
        #[test]
        fn powers_computed_together_are_the_library_s(
            logarithm in -300.0..300.0f64, y in -3.0..3.0f64, e in -690.0..690.0f64
        ) {
            let x = (logarithm / y.abs().max(0.5)).exp2();
            let (found, expected) = (compiled("x^y").unwrap().at(&[x, y]), x.powf(y));
            prop_assert!((found / expected - 1.0).abs() <= TOGETHER_ERROR, "{x}^{y}: {found}");
            let found = compiled("exp(x)").unwrap().at(&[e, y]);
            prop_assert!((found / e.exp() - 1.0).abs() <= TOGETHER_ERROR, "e^{e}: {found}");
        }

        /// The compiled program at many points is the tree, whose every piece is computed everywhere.
        #[test]
        fn many_points_are_as_the_tree(
            points in prop::collection::vec((-2.0..2.0, -2.0..2.0), 1..700)
        ) {
            let text = "piecewise(x < -1, exp(y), x + y <= 0, piecewise(y > 1, x*x, x^2 - y), \
                        x > 1.5, tanh(x), abs(x)^0.3) * (1 + x^2) - piecewise(y < 0, 1, exp(y))";
            let (x, y): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
            let mut found = vec![0.0; x.len()];
            compiled(text).unwrap().evaluate(&[&x, &y], &mut found);
            let tree = Expression::parse(text).unwrap().evaluate(x.len(), &|name| {
                Ok(vec![if name == "x" { x.clone() } else { y.clone() }])
            });
            for (a, b) in found.iter().zip(&tree.unwrap()[0]) {
                // Pieces of order one that may cancel.
                prop_assert!((a - b).abs() <= 1e-13 * b.abs().max(1.0), "{} {}", a, b);
            }
        }
    }
}
