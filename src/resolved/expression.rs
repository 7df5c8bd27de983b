//! [`Expression`]: a quantity as a formula of a file's arrays, such as `1 - EP_g`.
//!
//! Numbers, names, `+ - * /`, parentheses and `U[1]` for one component, counted from 0. A name is
//! made of letters, digits, `_`, `.` and `:`, or is anything between backticks. A scalar and a vector
//! combine component by component.

use super::Columns;

/// A formula that has been read.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    text: String,
    root: Node,
}

#[derive(Clone, Debug, PartialEq)]
enum Node {
    Number(f64),
    Name(String),
    Negative(Box<Node>),
    Component(Box<Node>, usize),
    Binary(Operator, Box<Node>, Box<Node>),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Operator {
    Add,
    Subtract,
    Multiply,
    Divide,
}

impl Expression {
    /// Reads `text`.
    ///
    /// # Errors
    /// What is wrong with it, and where.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser { rest: text };
        let root = parser.sum(0)?;
        match parser.peek() {
            None => Ok(Self { text: text.trim().to_owned(), root }),
            Some(_) => Err(parser.expected("an operator or the end")),
        }
    }

    /// The formula as it was typed.
    pub fn text(&self) -> &str {
        &self.text
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
        fn visit<'a>(node: &'a Node, names: &mut Vec<&'a str>) {
            match node {
                Node::Number(_) => {}
                Node::Name(name) => names.push(name),
                Node::Negative(inner) | Node::Component(inner, _) => visit(inner, names),
                Node::Binary(_, a, b) => {
                    visit(a, names);
                    visit(b, names);
                }
            }
        }
        let mut names = Vec::new();
        visit(&self.root, &mut names);
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
                operator.apply(a.evaluate(len, find)?, b.evaluate(len, find)?)
            }
        }
    }
}

impl Operator {
    fn apply(self, a: Columns, b: Columns) -> Result<Columns, String> {
        let count = a.len().max(b.len());
        if [a.len(), b.len()].iter().any(|n| *n != 1 && *n != count) {
            let (a, b) = (a.len(), b.len());
            return Err(format!("{a} components and {b} components do not combine"));
        }
        let operate = match self {
            Self::Add => |a: f64, b: f64| a + b,
            Self::Subtract => |a: f64, b: f64| a - b,
            Self::Multiply => |a: f64, b: f64| a * b,
            Self::Divide => |a: f64, b: f64| a / b,
        };
        let column = |n: usize| {
            let (a, b) = (&a[n.min(a.len() - 1)], &b[n.min(b.len() - 1)]);
            a.iter().zip(b).map(|(a, b)| operate(*a, *b)).collect()
        };
        Ok((0..count).map(column).collect())
    }
}

/// Parentheses deeper than this are a mistake, and would exhaust the stack.
const DEEPEST: usize = 64;

struct Parser<'a> {
    rest: &'a str,
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

    fn sum(&mut self, depth: usize) -> Result<Node, String> {
        let mut left = self.product(depth)?;
        loop {
            let operator = match self.peek() {
                Some('+') => Operator::Add,
                Some('-') => Operator::Subtract,
                _ => return Ok(left),
            };
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
            if !self.take(')') {
                return Err(self.expected(")"));
            }
            inner
        } else {
            self.operand()?
        };
        while self.take('[') {
            let end = self.rest.find(']').ok_or_else(|| self.expected("]"))?;
            let number = self.rest[..end].trim().parse();
            let number = number.map_err(|_| self.expected("the number of a component"))?;
            self.rest = &self.rest[end + 1..];
            node = Node::Component(Box::new(node), number);
        }
        Ok(node)
    }

    fn operand(&mut self) -> Result<Node, String> {
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
                Ok(Node::Name(name))
            }
            _ => Err(self.expected("a number, a name or (")),
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
        ] {
            let found = value(text).unwrap_err();
            assert!(found.contains(why), "{text}: {found}");
        }
        assert!(Expression::parse(&"(".repeat(10_000)).unwrap_err().contains("more than 64"));
    }
}
