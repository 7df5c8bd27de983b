//! From the formulae of a closure to the text of a language.
//!
//! [`Code`] is a closure cut into routines, each of what it depends on alone: one for a named formula,
//! one for a part that is piecewise, so that a language needs no conditional inside an expression and
//! computes a piece only where it holds, as [`Program`](crate::expression::Program) does. [`text`]
//! writes an expression in a [`Language`].

use crate::expression::{Comparison, Condition, Expression, Function, Meaning, Node, Operator};
use std::collections::{BTreeMap, BTreeSet};

/// An expression as text, and how tightly its outermost operation binds.
#[derive(Clone, Debug, PartialEq)]
pub struct Text {
    /// The expression.
    pub text: String,
    /// Its outermost operation.
    pub binds: Binds,
}

/// How tightly an operation binds its operands, loosest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Binds {
    /// `a + b`, `a - b`, `-a`.
    Sum,
    /// `a*b`, `a/b`.
    Product,
    /// `a**b`.
    Power,
    /// A name, a number, a call: no parentheses anywhere.
    Whole,
}

impl Text {
    /// What needs no parentheses.
    pub fn whole(text: impl Into<String>) -> Self {
        Self { text: text.into(), binds: Binds::Whole }
    }
}

/// What differs between languages. The operands come as text already.
pub trait Language {
    /// A number.
    fn number(&self, value: f64) -> Text;

    /// A name, as the formula has it.
    fn name(&self, name: &str) -> Text {
        Text::whole(name)
    }

    /// Parentheses.
    fn parentheses(&self, inner: &str) -> String {
        format!("({inner})")
    }

    /// a b.
    fn product(&self, a: Text, b: Text) -> Text {
        let (a, b) = (self.operand(a, Binds::Product), self.operand(b, Binds::Power));
        Text { text: format!("{a}*{b}"), binds: Binds::Product }
    }

    /// a/b.
    fn quotient(&self, a: Text, b: Text) -> Text {
        let (a, b) = (self.operand(a, Binds::Product), self.operand(b, Binds::Power));
        Text { text: format!("{a}/{b}"), binds: Binds::Product }
    }

    /// a to the power of b, which is the number `exponent` if it is a number. A square, a cube, a root
    /// and x^1.5 are computed as `Program` does.
    fn power(&self, a: Text, b: Text, exponent: Option<f64>) -> Text;

    /// A function of one argument, or of two.
    fn function(&self, function: Function, arguments: Vec<Text>) -> Text;

    /// A value by cases: conditions as text, values, and the value where none holds.
    fn cases(&self, arms: Vec<(String, Text)>, last: Text) -> Text;

    /// The sign of a comparison.
    fn comparison(&self, comparison: Comparison) -> String {
        comparison.to_string()
    }

    /// `text` as an operand of what binds at `least` so tightly.
    fn operand(&self, text: Text, least: Binds) -> String {
        if text.binds < least { self.parentheses(&text.text) } else { text.text }
    }
}

/// `node` in `language`.
pub fn text(node: &Node, language: &dyn Language) -> Text {
    match node {
        Node::Number(value) => language.number(*value),
        Node::Name(name) => language.name(name),
        Node::Negative(inner) => {
            let inner = language.operand(text(inner, language), Binds::Product);
            Text { text: format!("-{inner}"), binds: Binds::Sum }
        }
        // A closure has no vectors; compiling it has refused them.
        Node::Component(inner, _) => text(inner, language),
        Node::Binary(operator, a, b) => {
            // (-a)*b is -(a*b) to the last bit, and reads better.
            if let (Node::Negative(inner), Operator::Multiply | Operator::Divide) = (&**a, operator)
            {
                let product = Node::Binary(*operator, inner.clone(), b.clone());
                return text(&Node::Negative(Box::new(product)), language);
            }
            let (left, right) = (text(a, language), text(b, language));
            let sign = match operator {
                Operator::Multiply => return language.product(left, right),
                Operator::Divide => return language.quotient(left, right),
                Operator::Power => return language.power(left, right, number(b)),
                Operator::Add => '+',
                Operator::Subtract => '-',
            };
            let right = language.operand(right, Binds::Product);
            Text { text: format!("{} {sign} {right}", left.text), binds: Binds::Sum }
        }
        Node::Call(function, arguments) => {
            let mut arguments = arguments.iter().map(|argument| text(argument, language));
            let first = arguments.next().expect("a call has an argument");
            if !function.takes_many() {
                return language.function(*function, vec![first]);
            }
            arguments.fold(first, |a, b| language.function(*function, vec![a, b]))
        }
        Node::Piecewise(arms, last) => {
            let arms = arms
                .iter()
                .map(|(condition, value)| (holds(condition, language), text(value, language)))
                .collect();
            language.cases(arms, text(last, language))
        }
    }
}

/// A condition in `language`.
pub fn holds(condition: &Condition, language: &dyn Language) -> String {
    let sign = language.comparison(condition.comparison);
    let (left, right) = (text(&condition.left, language), text(&condition.right, language));
    format!("{} {sign} {}", left.text, right.text)
}

fn number(node: &Node) -> Option<f64> {
    match node {
        Node::Number(value) => Some(*value),
        _ => None,
    }
}

/// A function of some of the inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Routine {
    /// Its name in code.
    pub name: String,
    /// What it computes, in the words of the formula.
    pub about: String,
    /// The inputs that it takes.
    pub inputs: Vec<String>,
    /// The value after the first condition that holds.
    pub arms: Vec<(Condition, Node)>,
    /// The value where none holds.
    pub last: Node,
}

/// A number with a name.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Its name in code.
    pub name: String,
    /// Its name in the formula.
    pub original: String,
    /// Its value.
    pub value: f64,
}

/// Routines that call each other: each after those that it calls.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Code {
    /// The numbers in them.
    pub constants: Vec<Constant>,
    /// The routines.
    pub routines: Vec<Routine>,
}

/// Cuts formulae into routines.
pub struct Lowering<'a> {
    inputs: Vec<String>,
    meaning: &'a dyn Fn(&str) -> Option<Meaning<'a>>,
    taken: BTreeSet<String>,
    constants: BTreeMap<String, String>,
    formulae: BTreeMap<String, usize>,
    code: Code,
}

/// A part and the inputs that it depends on.
type Part = (Node, BTreeSet<usize>);

impl<'a> Lowering<'a> {
    /// Formulae of the `inputs` with these names in code; `meaning` says what a name in a formula is.
    pub fn new(inputs: &[&str], meaning: &'a dyn Fn(&str) -> Option<Meaning<'a>>) -> Self {
        Self {
            inputs: inputs.iter().map(|&input| input.to_owned()).collect(),
            meaning,
            taken: inputs.iter().map(|input| input.to_lowercase()).collect(),
            constants: BTreeMap::new(),
            formulae: BTreeMap::new(),
            code: Code::default(),
        }
    }

    /// Adds a routine for `formula`, which is called `name`, and says which it is.
    ///
    /// # Errors
    /// A name without a meaning, which compiling refuses too.
    pub fn add(&mut self, name: &str, formula: &Expression) -> Result<usize, String> {
        self.routine(name, name, formula.text(), formula.root())
    }

    /// What was added.
    pub fn finish(self) -> Code {
        self.code
    }

    fn routine(
        &mut self,
        name: &str,
        context: &str,
        about: &str,
        root: &Node,
    ) -> Result<usize, String> {
        let mut used = BTreeSet::new();
        let mut lowered = Vec::new();
        let mut last = root;
        if let Node::Piecewise(arms, otherwise) = root {
            for (condition, value) in arms {
                let left = self.part(&condition.left, context, &mut used)?;
                let right = self.part(&condition.right, context, &mut used)?;
                let value = self.part(value, context, &mut used)?;
                let comparison = condition.comparison;
                lowered.push((Condition { left, comparison, right }, value));
            }
            last = otherwise;
        }
        let last = self.part(last, context, &mut used)?;
        let name = self.fresh(&format!("f_{name}"));
        let inputs = used.into_iter().map(|input| self.inputs[input].clone()).collect();
        let about = about.to_owned();
        self.code.routines.push(Routine { name, about, inputs, arms: lowered, last });
        Ok(self.code.routines.len() - 1)
    }

    fn part(
        &mut self,
        node: &Node,
        context: &str,
        used: &mut BTreeSet<usize>,
    ) -> Result<Node, String> {
        let (node, inputs) = self.lower(node, context)?;
        used.extend(inputs);
        Ok(node)
    }

    fn lower(&mut self, node: &Node, context: &str) -> Result<Part, String> {
        let mut used = BTreeSet::new();
        let node = match node {
            Node::Number(value) => Node::Number(*value),
            Node::Name(name) => return self.name(name),
            Node::Negative(inner) => {
                Node::Negative(Box::new(self.part(inner, context, &mut used)?))
            }
            Node::Component(..) => return Err("there are no vectors here".into()),
            Node::Binary(operator, a, b) => {
                let a = self.part(a, context, &mut used)?;
                // Of an exponent the value decides how it is computed.
                let b = match (operator, self.value(b)) {
                    (Operator::Power, Some(value)) if SPECIAL.contains(&value) => {
                        Node::Number(value)
                    }
                    _ => self.part(b, context, &mut used)?,
                };
                Node::Binary(*operator, Box::new(a), Box::new(b))
            }
            Node::Call(function, arguments) => {
                let arguments = arguments
                    .iter()
                    .map(|argument| self.part(argument, context, &mut used))
                    .collect::<Result<_, _>>()?;
                Node::Call(*function, arguments)
            }
            Node::Piecewise(..) => {
                let about = format!("a part of {context}");
                let at = self.routine(&format!("{context}_part"), context, &about, node)?;
                return Ok(self.call(at));
            }
        };
        Ok((node, used))
    }

    fn name(&mut self, name: &str) -> Result<Part, String> {
        match (self.meaning)(name).ok_or_else(|| format!("`{name}` is not known here"))? {
            Meaning::Input(at) => Ok((Node::Name(self.inputs[at].clone()), BTreeSet::from([at]))),
            Meaning::Constant(value) => {
                if let Some(known) = self.constants.get(name) {
                    return Ok((Node::Name(known.clone()), BTreeSet::new()));
                }
                let fresh = self.fresh(&format!("k_{name}"));
                self.constants.insert(name.to_owned(), fresh.clone());
                let original = name.to_owned();
                self.code.constants.push(Constant { name: fresh.clone(), original, value });
                Ok((Node::Name(fresh), BTreeSet::new()))
            }
            Meaning::Formula(formula) => {
                let at = match self.formulae.get(name) {
                    Some(&at) => at,
                    None => {
                        let about = format!("{name} = {}", formula.text());
                        let at = self.routine(name, name, &about, formula.root())?;
                        self.formulae.insert(name.to_owned(), at);
                        at
                    }
                };
                Ok(self.call(at))
            }
        }
    }

    /// A call of a routine: all languages here write it the same.
    fn call(&self, at: usize) -> Part {
        let routine = &self.code.routines[at];
        let position = |name: &String| self.inputs.iter().position(|input| input == name);
        let used = routine.inputs.iter().filter_map(position).collect();
        (Node::Name(format!("{}({})", routine.name, routine.inputs.join(", "))), used)
    }

    /// The value of a part that depends on nothing.
    fn value(&self, node: &Node) -> Option<f64> {
        match node {
            Node::Number(value) => Some(*value),
            Node::Name(name) => match (self.meaning)(name)? {
                Meaning::Constant(value) => Some(value),
                Meaning::Formula(formula) => self.value(formula.root()),
                Meaning::Input(_) => None,
            },
            Node::Negative(inner) => Some(-self.value(inner)?),
            Node::Binary(operator, a, b) => Some(operator.apply(self.value(a)?, self.value(b)?)),
            _ => None,
        }
    }

    /// A name that no other is equal to, in capitals or not.
    fn fresh(&mut self, wanted: &str) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        // Fortran has 63 characters; four are left for a number.
        let base: String = wanted.chars().map(plain).take(59).collect();
        let names = (2..).map(|n| format!("{base}_{n}"));
        let name = std::iter::once(base.clone())
            .chain(names)
            .find(|name| !self.taken.contains(&name.to_lowercase()))
            .expect("there are numbers enough");
        self.taken.insert(name.to_lowercase());
        name
    }
}

/// Exponents that are not computed by the general power.
const SPECIAL: [f64; 5] = [0.5, 1.0, 1.5, 2.0, 3.0];

/// A number with the digits that give the same double back, and a point or an exponent.
pub fn digits(value: f64) -> String {
    format!("{value:?}")
}

/// `lines` as a comment: each after `prefix`, none longer than 100 characters where words allow.
pub fn comment(prefix: &str, lines: &[String]) -> String {
    let mut text = String::new();
    for line in lines {
        let mut at = String::new();
        for word in line.split_whitespace() {
            if !at.is_empty() && prefix.len() + at.chars().count() + 1 + word.chars().count() > 100
            {
                text += format!("{prefix}{at}").trim_end();
                text.push('\n');
                at = "  ".to_owned();
            }
            if !at.trim().is_empty() {
                at.push(' ');
            }
            at += word;
        }
        text += format!("{prefix}{at}").trim_end();
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::c::C;
    use super::super::fortran::Fortran;
    use super::*;

    fn written(formula: &str, language: &dyn Language) -> String {
        text(Expression::parse(formula).unwrap().root(), language).text
    }

    #[test]
    fn parentheses_stand_where_the_order_of_operations_needs_them() {
        for formula in [
            "a - (b - c) + d",
            "a*(b*c)/(d/e)",
            "-a*b - -c",
            "(-a)^2 - a^b^c",
            "(a + b)*(c - d)",
            "a - (-b)",
            "2*-a",
        ] {
            let again = written(formula, &C).replace("favre_square(", "sq(");
            // What C writes is read back as the same tree, where it has no powers.
            if !formula.contains('^') {
                let again = again.replace("2.0", "2");
                let (a, b) = (Expression::parse(formula), Expression::parse(&again));
                assert_eq!(a.unwrap().root(), b.unwrap().root(), "{formula}: {again}");
            }
        }
        assert_eq!(written("(-a)^2 - a^b^c", &C), "favre_square(-a) - pow(a, pow(b, c))");
        assert_eq!(written("(-a)^2 - a^(b^c)", &Fortran), "(-a)**2 - a**(b**c)");
        assert_eq!(written("a*-b - -2*c", &Fortran), "a*(-b) - (-2.0_dp*c)");
        assert_eq!(written("1e-300 + 1e21", &Fortran), "1e-300_dp + 1e21_dp");
        assert_eq!(written("(a + b)^1.5 + a^0.5", &Fortran), "(a + b)*sqrt(a + b) + sqrt(a)");
        assert_eq!(
            written("min(a, b, max(c, 1))", &C),
            "favre_min(favre_min(a, b), favre_max(c, 1.0))"
        );
        let pieces = "1 + piecewise(a < b, c, a >= 2, d, 0)";
        assert_eq!(written(pieces, &C), "1.0 + (a < b ? c : (a >= 2.0 ? d : 0.0))");
        let merged = "1.0_dp + merge(c, merge(d, 0.0_dp, a >= 2.0_dp), a < b)";
        assert_eq!(written(pieces, &Fortran), merged);
    }

    #[test]
    fn names_stay_apart_and_pieces_become_routines() {
        let texts = BTreeMap::from([
            ("h", "piecewise(x < 1, H, 2)*y + H"),
            ("H-inf", "1 + x"),
            ("h_inf", "H^p + `H-inf`"),
        ]);
        let formulae: BTreeMap<&str, Expression> =
            texts.iter().map(|(name, text)| (*name, Expression::parse(text).unwrap())).collect();
        let meaning = |name: &str| match name {
            "x" => Some(Meaning::Input(0)),
            "y" => Some(Meaning::Input(1)),
            "H" => Some(Meaning::Constant(0.25)),
            "p" => Some(Meaning::Constant(2.0)),
            name => formulae.get(name).map(Meaning::Formula),
        };
        let mut lowering = Lowering::new(&["x", "y"], &meaning);
        let formula = Expression::parse("h + h_inf + h").unwrap();
        let at = lowering.add("drag", &formula).unwrap();
        let code = lowering.finish();
        let names: Vec<&str> = code.routines.iter().map(|r| &*r.name).collect();
        assert_eq!(names, ["f_h_part", "f_h", "f_H_inf", "f_h_inf_2", "f_drag"]);
        assert_eq!(code.routines[at].inputs, ["x", "y"]);
        assert_eq!(code.routines[0].inputs, ["x"]);
        assert_eq!(code.constants.len(), 1);
        // The exponent p is 2 and therefore a square.
        assert_eq!(text(&code.routines[3].last, &C).text, "favre_square(k_H) + f_H_inf(x)");
        assert_eq!(text(&code.routines[4].last, &C).text, "f_h(x, y) + f_h_inf_2(x) + f_h(x, y)");
        let unknown = Expression::parse("z").unwrap();
        assert!(Lowering::new(&[], &meaning).add("z", &unknown).unwrap_err().contains("`z`"));
    }
}
