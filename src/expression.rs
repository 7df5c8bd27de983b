//! [`Expression`]: a formula as text, such as `1 - EP_g` or `0.7*phi*(0.59 - phi)^2`.
//!
//! One language for the whole crate: a quantity as a formula of a file's arrays, and a closure as a
//! formula of its markers.
//!
//! - Numbers, names, `+ - * / ^`, parentheses, and `U[1]` for one component, counted from 0. A name
//!   is made of letters, digits, `_`, `.` and `:`, or is anything between backticks.
//! - `exp ln log10 sqrt abs tanh atan` of one argument, `min max` of two or more.
//! - `piecewise(phi < 0.1, a, phi < 0.5, b, c)`: the value after the first condition that holds, else
//!   the last. Conditions are two formulae with `<`, `<=`, `>` or `>=` between them.
//!
//! `-x^2` is `-(x^2)`, `x^y^z` is `x^(y^z)`. There are no integers: `2/7` is 0.2857. A scalar and a
//! vector combine component by component.
//!
//! [`Expression::evaluate`] walks the tree, for arrays of a file; [`Program`] is compiled, for
//! closures at millions of points.

mod program;

pub use program::{Meaning, Program};

use std::fmt;

/// Components, each with a number for every cell.
type Columns = Vec<Vec<f64>>;

/// A formula that has been read.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    text: String,
    root: Node,
}

/// A part of a formula.
#[derive(Clone, Debug, PartialEq)]
pub enum Node {
    /// A number.
    Number(f64),
    /// A name.
    Name(String),
    /// Minus something.
    Negative(Box<Node>),
    /// One component of a vector, counted from 0.
    Component(Box<Node>, usize),
    /// Two operands.
    Binary(Operator, Box<Node>, Box<Node>),
    /// A function of its arguments.
    Call(Function, Vec<Node>),
    /// The value after the first condition that holds, else the last.
    Piecewise(Vec<(Condition, Node)>, Box<Node>),
}

/// What stands between two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Operator {
    /// `+`
    Add,
    /// `-`
    Subtract,
    /// `*`
    Multiply,
    /// `/`
    Divide,
    /// `^`
    Power,
}

/// A function that a formula may call.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Function {
    /// e^x.
    Exp,
    /// Natural logarithm.
    Ln,
    /// Decimal logarithm.
    Log10,
    /// Square root.
    Sqrt,
    /// Absolute value.
    Abs,
    /// Hyperbolic tangent.
    Tanh,
    /// Inverse tangent \[rad\].
    Atan,
    /// The smallest argument.
    Min,
    /// The largest argument.
    Max,
}

/// All functions with their names in formulae.
pub const FUNCTIONS: [(&str, Function); 9] = [
    ("exp", Function::Exp),
    ("ln", Function::Ln),
    ("log10", Function::Log10),
    ("sqrt", Function::Sqrt),
    ("abs", Function::Abs),
    ("tanh", Function::Tanh),
    ("atan", Function::Atan),
    ("min", Function::Min),
    ("max", Function::Max),
];

/// A comparison of two formulae.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// What stands on the left.
    pub left: Node,
    /// How they compare.
    pub comparison: Comparison,
    /// What stands on the right.
    pub right: Node,
}

/// How two numbers compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Comparison {
    /// `<`
    Less,
    /// `<=`
    LessOrEqual,
    /// `>`
    Greater,
    /// `>=`
    GreaterOrEqual,
}

impl Comparison {
    /// Whether it holds. Nothing holds of what is not a number.
    pub fn holds(self, a: f64, b: f64) -> bool {
        match self {
            Self::Less => a < b,
            Self::LessOrEqual => a <= b,
            Self::Greater => a > b,
            Self::GreaterOrEqual => a >= b,
        }
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Less => "<",
            Self::LessOrEqual => "<=",
            Self::Greater => ">",
            Self::GreaterOrEqual => ">=",
        })
    }
}

impl Expression {
    /// Reads `text`.
    ///
    /// # Errors
    /// What is wrong with it, and where.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser { rest: text, operations: 0 };
        let root = parser.sum(0)?;
        match parser.peek() {
            None => Ok(Self { text: text.trim().to_owned(), root }),
            Some(_) => Err(parser.expected("an operator or the end")),
        }
    }

    /// The formula that is `root`, a part of another; it has no text.
    pub fn of(root: Node) -> Self {
        Self { text: String::new(), root }
    }

    /// The formula as it was typed.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The formula as a tree.
    pub fn root(&self) -> &Node {
        &self.root
    }

    /// The array that it names, if it is nothing but a name.
    pub fn name(&self) -> Option<&str> {
        match &self.root {
            Node::Name(name) => Some(name),
            _ => None,
        }
    }

    /// The names in it.
    pub fn names(&self) -> Vec<&str> {
        let mut names = Vec::new();
        self.root.visit(&mut |node| {
            if let Node::Name(name) = node {
                names.push(name.as_str());
            }
        });
        names
    }

    /// The value in each of `len` cells, by component; `find` gives the array of a name.
    ///
    /// # Errors
    /// Those of `find`, or the components of two operands do not fit together.
    pub fn evaluate(
        &self,
        len: usize,
        find: &dyn Fn(&str) -> Result<Columns, String>,
    ) -> Result<Columns, String> {
        self.root.evaluate(len, find)
    }
}

impl Node {
    /// Calls `see` for this part and every part inside it, in the order of the text.
    pub fn visit<'a>(&'a self, see: &mut dyn FnMut(&'a Node)) {
        see(self);
        match self {
            Self::Number(_) | Self::Name(_) => {}
            Self::Negative(inner) | Self::Component(inner, _) => inner.visit(see),
            Self::Binary(_, a, b) => {
                a.visit(see);
                b.visit(see);
            }
            Self::Call(_, arguments) => arguments.iter().for_each(|a| a.visit(see)),
            Self::Piecewise(arms, last) => {
                for (condition, value) in arms {
                    condition.left.visit(see);
                    condition.right.visit(see);
                    value.visit(see);
                }
                last.visit(see);
            }
        }
    }

    fn evaluate(
        &self,
        len: usize,
        find: &dyn Fn(&str) -> Result<Columns, String>,
    ) -> Result<Columns, String> {
        match self {
            Self::Number(number) => Ok(vec![vec![*number; len]]),
            Self::Name(name) => find(name),
            Self::Negative(inner) => {
                let mut columns = inner.evaluate(len, find)?;
                columns.iter_mut().flatten().for_each(|value| *value = -*value);
                Ok(columns)
            }
            Self::Component(inner, number) => {
                let mut columns = inner.evaluate(len, find)?;
                if *number >= columns.len() {
                    return Err(format!(
                        "component [{number}] is asked for and there are {}, counted from 0",
                        columns.len()
                    ));
                }
                Ok(vec![columns.swap_remove(*number)])
            }
            Self::Binary(operator, a, b) => {
                combine(a.evaluate(len, find)?, b.evaluate(len, find)?, |a, b| operator.apply(a, b))
            }
            Self::Call(function, arguments) => {
                let (first, others) = arguments.split_first().expect("a call has an argument");
                let mut columns = first.evaluate(len, find)?;
                if others.is_empty() {
                    let values = columns.iter_mut().flatten();
                    values.for_each(|value| *value = function.of_one(*value));
                }
                for other in others {
                    let other = other.evaluate(len, find)?;
                    columns = combine(columns, other, |a, b| function.of_two(a, b))?;
                }
                Ok(columns)
            }
            Self::Piecewise(arms, last) => {
                let mut columns = last.evaluate(len, find)?;
                for (condition, value) in arms.iter().rev() {
                    let left = condition.left.evaluate(len, find)?;
                    let right = condition.right.evaluate(len, find)?;
                    let holds = |a, b| f64::from(u8::from(condition.comparison.holds(a, b)));
                    let holds = combine(left, right, holds)?;
                    columns = choose(&holds, &value.evaluate(len, find)?, &columns)?;
                }
                Ok(columns)
            }
        }
    }
}

/// `operate` on two quantities, component by component.
fn combine(a: Columns, b: Columns, operate: impl Fn(f64, f64) -> f64) -> Result<Columns, String> {
    let count = components(&[&a, &b])?;
    let column = |n: usize| {
        let (a, b) = (&a[n.min(a.len() - 1)], &b[n.min(b.len() - 1)]);
        a.iter().zip(b).map(|(a, b)| operate(*a, *b)).collect()
    };
    Ok((0..count).map(column).collect())
}

/// `yes` where `holds` is 1, else `no`, component by component.
fn choose(holds: &Columns, yes: &Columns, no: &Columns) -> Result<Columns, String> {
    let count = components(&[holds, yes, no])?;
    let column = |n: usize| {
        let [holds, yes, no] = [holds, yes, no].map(|columns| &columns[n.min(columns.len() - 1)]);
        let pick = |i: usize| if holds[i] == 1.0 { yes[i] } else { no[i] };
        (0..holds.len()).map(pick).collect()
    };
    Ok((0..count).map(column).collect())
}

/// How many components the combination has.
fn components(all: &[&Columns]) -> Result<usize, String> {
    let count = all.iter().map(|columns| columns.len()).max().unwrap_or(1);
    match all.iter().find(|columns| columns.len() != 1 && columns.len() != count) {
        None => Ok(count),
        Some(odd) => Err(format!("{count} components and {} components do not combine", odd.len())),
    }
}

impl Operator {
    /// The result for two numbers.
    pub fn apply(self, a: f64, b: f64) -> f64 {
        match self {
            Self::Add => a + b,
            Self::Subtract => a - b,
            Self::Multiply => a * b,
            Self::Divide => a / b,
            Self::Power => a.powf(b),
        }
    }
}

impl Function {
    /// Whether it takes two arguments or more.
    pub fn takes_many(self) -> bool {
        matches!(self, Self::Min | Self::Max)
    }

    /// Its value for one argument; the argument itself for `min` and `max`.
    pub fn of_one(self, x: f64) -> f64 {
        match self {
            Self::Exp => x.exp(),
            Self::Ln => x.ln(),
            Self::Log10 => x.log10(),
            Self::Sqrt => x.sqrt(),
            Self::Abs => x.abs(),
            Self::Tanh => x.tanh(),
            Self::Atan => x.atan(),
            Self::Min | Self::Max => x,
        }
    }

    /// The smaller or the larger of two numbers; NaN if either is NaN, so that nothing hides.
    pub fn of_two(self, a: f64, b: f64) -> f64 {
        let first = match self {
            Self::Min => a < b,
            _ => a > b,
        };
        if first || a.is_nan() { a } else { b }
    }
}

/// Parentheses deeper than this are a mistake, and would exhaust the stack.
const DEEPEST: usize = 64;

/// More operations than this are a mistake, and would exhaust the stack too.
const LONGEST: usize = 2000;

struct Parser<'a> {
    rest: &'a str,
    operations: usize,
}

impl Parser<'_> {
    fn peek(&mut self) -> Option<char> {
        self.rest = self.rest.trim_start();
        self.rest.chars().next()
    }

    fn take(&mut self, wanted: char) -> bool {
        let found = self.peek() == Some(wanted);
        if found {
            self.rest = &self.rest[wanted.len_utf8()..];
        }
        found
    }

    fn expected(&mut self, what: &str) -> String {
        match self.peek() {
            Some(_) => format!("{what} is expected before \"{}\"", self.rest),
            None => format!("{what} is expected at the end"),
        }
    }

    fn count(&mut self) -> Result<(), String> {
        self.operations += 1;
        match self.operations > LONGEST {
            true => Err(format!("more than {LONGEST} operations in one formula")),
            false => Ok(()),
        }
    }

    fn sum(&mut self, depth: usize) -> Result<Node, String> {
        let mut left = self.product(depth)?;
        loop {
            let operator = match self.peek() {
                Some('+') => Operator::Add,
                Some('-') => Operator::Subtract,
                _ => return Ok(left),
            };
            self.count()?;
            self.rest = &self.rest[1..];
            left = Node::Binary(operator, Box::new(left), Box::new(self.product(depth)?));
        }
    }

    fn product(&mut self, depth: usize) -> Result<Node, String> {
        let mut left = self.factor(depth)?;
        loop {
            let operator = match self.peek() {
                Some('*') => Operator::Multiply,
                Some('/') => Operator::Divide,
                _ => return Ok(left),
            };
            self.count()?;
            self.rest = &self.rest[1..];
            left = Node::Binary(operator, Box::new(left), Box::new(self.factor(depth)?));
        }
    }

    fn factor(&mut self, depth: usize) -> Result<Node, String> {
        if depth > DEEPEST {
            return Err(format!("more than {DEEPEST} parentheses or signs inside each other"));
        }
        if self.take('-') {
            return Ok(Node::Negative(Box::new(self.factor(depth + 1)?)));
        }
        let mut node = if self.take('(') {
            let inner = self.sum(depth + 1)?;
            self.close()?;
            inner
        } else {
            self.operand(depth)?
        };
        while self.take('[') {
            let end = self.rest.find(']').ok_or_else(|| self.expected("]"))?;
            let number = self.rest[..end].trim().parse();
            let number = number.map_err(|_| self.expected("the number of a component"))?;
            self.rest = &self.rest[end + 1..];
            node = Node::Component(Box::new(node), number);
        }
        if self.take('^') {
            self.count()?;
            let exponent = self.factor(depth + 1)?;
            node = Node::Binary(Operator::Power, Box::new(node), Box::new(exponent));
        }
        Ok(node)
    }

    fn close(&mut self) -> Result<(), String> {
        if self.take(')') { Ok(()) } else { Err(self.expected(")")) }
    }

    fn operand(&mut self, depth: usize) -> Result<Node, String> {
        match self.peek() {
            Some('`') => {
                let text = &self.rest[1..];
                let end = text.find('`').ok_or("a backtick is not closed")?;
                let name = text[..end].to_owned();
                self.rest = &text[end + 1..];
                Ok(Node::Name(name))
            }
            Some(c) if c.is_ascii_digit() || c == '.' => {
                // An exponent's sign belongs to the number.
                let bytes = self.rest.as_bytes();
                let belongs = |at: usize| match bytes[at] {
                    b'0'..=b'9' | b'.' | b'e' | b'E' => true,
                    b'+' | b'-' => matches!(bytes[at - 1], b'e' | b'E'),
                    _ => false,
                };
                let end = (1..bytes.len()).find(|at| !belongs(*at)).unwrap_or(bytes.len());
                let number = self.rest[..end].parse::<f64>().ok().filter(|n| n.is_finite());
                let number = number.ok_or_else(|| self.expected("a number"))?;
                self.rest = &self.rest[end..];
                Ok(Node::Number(number))
            }
            Some(c) if c.is_alphabetic() || c == '_' => {
                let part = |c: char| c.is_alphanumeric() || "_.:".contains(c);
                let end = self.rest.find(|c| !part(c)).unwrap_or(self.rest.len());
                let name = self.rest[..end].to_owned();
                self.rest = &self.rest[end..];
                if self.take('(') { self.call(&name, depth + 1) } else { Ok(Node::Name(name)) }
            }
            _ => Err(self.expected("a number, a name or (")),
        }
    }

    /// The arguments of `name`, whose parenthesis is open.
    fn call(&mut self, name: &str, depth: usize) -> Result<Node, String> {
        self.count()?;
        if name == "piecewise" {
            return self.piecewise(depth);
        }
        let Some(&(_, function)) = FUNCTIONS.iter().find(|(known, _)| *known == name) else {
            let known = FUNCTIONS.map(|(name, _)| name).join(", ");
            return Err(format!("there is no function {name}; known: {known}, piecewise"));
        };
        let mut arguments = vec![self.sum(depth)?];
        while self.take(',') {
            self.count()?;
            arguments.push(self.sum(depth)?);
        }
        self.close()?;
        match (function.takes_many(), arguments.len()) {
            (true, 1) => Err(format!("{name} takes two arguments or more, and has one")),
            (false, 2..) => Err(format!("{name} takes one argument, and has {}", arguments.len())),
            _ => Ok(Node::Call(function, arguments)),
        }
    }

    fn piecewise(&mut self, depth: usize) -> Result<Node, String> {
        let mut arms = Vec::new();
        loop {
            self.count()?;
            let left = self.sum(depth)?;
            let comparison = match (self.peek(), self.rest.as_bytes().get(1)) {
                (Some('<'), Some(b'=')) => Comparison::LessOrEqual,
                (Some('<'), _) => Comparison::Less,
                (Some('>'), Some(b'=')) => Comparison::GreaterOrEqual,
                (Some('>'), _) => Comparison::Greater,
                _ if arms.is_empty() => return Err(self.expected("a comparison")),
                _ => {
                    self.close()?;
                    return Ok(Node::Piecewise(arms, Box::new(left)));
                }
            };
            let signs = match comparison {
                Comparison::Less | Comparison::Greater => 1,
                Comparison::LessOrEqual | Comparison::GreaterOrEqual => 2,
            };
            self.rest = &self.rest[signs..];
            let right = self.sum(depth)?;
            if !self.take(',') {
                return Err(self.expected("a comma and the value where the condition holds"));
            }
            let value = self.sum(depth)?;
            if !self.take(',') {
                return Err(self.expected("a comma and what holds otherwise"));
            }
            arms.push((Condition { left, comparison, right }, value));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> Result<Columns, String> {
        Expression::parse(text)?.evaluate(2, &|name| match name {
            "EP_g" => Ok(vec![vec![0.75, 1.0]]),
            "U.air" => Ok(vec![vec![1.0, 2.0], vec![3.0, 4.0], vec![5.0, 6.0]]),
            "Void Fraction" => Ok(vec![vec![0.5, 0.25]]),
            _ => Err(format!("no {name}")),
        })
    }

    #[test]
    fn formulae_follow_the_usual_precedence() {
        assert_eq!(value("1 - EP_g").unwrap(), [[0.25, 0.0]]);
        assert_eq!(value("2 + 3*4 - 8/2/2 - -1").unwrap(), [[13.0, 13.0]]);
        assert_eq!(value("-(1.5e-1 + 2E+1)*2").unwrap(), [[-40.3, -40.3]]);
        assert_eq!(value("1-`Void Fraction`").unwrap(), [[0.5, 0.75]]);
        assert_eq!(value("1e-2 * U.air[2] - EP_g").unwrap(), [[0.05 - 0.75, 0.06 - 1.0]]);
        assert_eq!(value("U.air / 2").unwrap(), [[0.5, 1.0], [1.5, 2.0], [2.5, 3.0]]);
    }

    #[test]
    fn powers_functions_and_pieces_are_read() {
        assert_eq!(value("-2^2 + 2^3^0 + 2^-1").unwrap(), [[-1.5, -1.5]]);
        assert_eq!(value("EP_g^(2/7)").unwrap(), [[0.75f64.powf(2.0 / 7.0), 1.0]]);
        assert_eq!(value("max(EP_g, 0.8, 0.9) - min(1, 2)").unwrap(), [[0.9 - 1.0, 0.0]]);
        assert_eq!(value("sqrt(abs(-4)) * exp(ln(3))").unwrap()[0][0], 2.0 * 3f64.ln().exp());
        assert_eq!(value("log10(100) + tanh(0) + atan(0)").unwrap(), [[2.0, 2.0]]);
        let pieces = "piecewise(EP_g <= 0.75, 1, EP_g < 1, 2, 3)";
        assert_eq!(value(pieces).unwrap(), [[1.0, 3.0]]);
        let vector = "piecewise(EP_g >= 1, U.air, 0)";
        assert_eq!(value(vector).unwrap(), [[0.0, 2.0], [0.0, 4.0], [0.0, 6.0]]);
        // What is not a number is not hidden by min and max.
        assert!(value("min(0, sqrt(0 - 1))").unwrap()[0][0].is_nan());
        assert!(value("max(sqrt(0 - 1), 0)").unwrap()[0][0].is_nan());
    }

    #[test]
    fn what_is_no_formula_is_refused_with_its_place() {
        for (text, why) in [
            ("1 -", "is expected at the end"),
            ("(1 + 2", ") is expected at the end"),
            ("1 2", "an operator or the end is expected before \"2\""),
            ("U.air[x]", "the number of a component is expected"),
            ("U.air[3]", "component [3] is asked for and there are 3"),
            ("U.air + U.air[0] * (U.air - x)", "no x"),
            ("a $ b", "before \"$ b\""),
            ("`a", "not closed"),
            ("1e999", "a number"),
            ("sin(1)", "there is no function sin; known: exp, ln"),
            ("min(1)", "two arguments or more"),
            ("exp(1, 2)", "takes one argument, and has 2"),
            ("piecewise(1, 2, 3)", "a comparison is expected before \", 2"),
            ("piecewise(1 < 2, 3)", "a comma and what holds otherwise"),
            ("piecewise(1 < 2)", "a comma and the value"),
        ] {
            let found = value(text).unwrap_err();
            assert!(found.contains(why), "{text}: {found}");
        }
        assert!(Expression::parse(&"(".repeat(10_000)).unwrap_err().contains("more than 64"));
        assert!(Expression::parse(&"1^".repeat(10_000)).unwrap_err().contains("more than 64"));
        assert!(Expression::parse(&"1+".repeat(10_000)).unwrap_err().contains("2000 operations"));
    }
}
