//! Fortran: one module of pure functions.

use super::code::{self, Binds, Code, Language, Text, comment, digits, text};
use super::{Facts, Piece, Quantity, fill};
use crate::expression::Function;
use crate::model::Outside;
use std::fmt::Write;

/// The language: free form, 2003.
pub struct Fortran;

impl Language for Fortran {
    fn number(&self, value: f64) -> Text {
        let binds = if value.is_sign_negative() { Binds::Sum } else { Binds::Whole };
        Text { text: format!("{}_dp", digits(value)), binds }
    }

    fn power(&self, a: Text, b: Text, exponent: Option<f64>) -> Text {
        let square_root = format!("sqrt({})", a.text);
        if exponent == Some(0.5) {
            return Text::whole(square_root);
        }
        if exponent == Some(1.0) {
            return a;
        }
        let base = self.operand(a, Binds::Whole);
        let power = match exponent {
            Some(1.5) => {
                return Text { text: format!("{base}*{square_root}"), binds: Binds::Product };
            }
            // An integer exponent is a product.
            Some(2.0) => "2".to_owned(),
            Some(3.0) => "3".to_owned(),
            _ => self.operand(b, Binds::Whole),
        };
        Text { text: format!("{base}**{power}"), binds: Binds::Power }
    }

    fn function(&self, function: Function, arguments: Vec<Text>) -> Text {
        let name = match function {
            Function::Exp => "exp",
            Function::Ln => "log",
            Function::Log10 => "log10",
            Function::Sqrt => "sqrt",
            Function::Abs => "abs",
            Function::Tanh => "tanh",
            Function::Atan => "atan",
            Function::Min => "favre_min",
            Function::Max => "favre_max",
        };
        let arguments: Vec<String> = arguments.into_iter().map(|argument| argument.text).collect();
        Text::whole(format!("{name}({})", arguments.join(", ")))
    }

    fn cases(&self, arms: Vec<(String, Text)>, last: Text) -> Text {
        let cases = arms.iter().rev().fold(last.text, |last, (condition, value)| {
            format!("merge({}, {last}, {condition})", value.text)
        });
        Text::whole(cases)
    }
}

/// Longest line.
const WIDTH: usize = 100;

/// A statement on as many lines as it needs.
fn statement(indent: &str, text: &str) -> String {
    let mut out = String::new();
    let mut rest = text.to_owned();
    let mut indent = indent.to_owned();
    while indent.len() + rest.len() > WIDTH {
        let room = WIDTH - indent.len() - 2;
        // Between two tokens: after a blank, a comma, an opening parenthesis or a lone asterisk.
        let bytes = rest.as_bytes();
        let splits = |at: usize| match bytes[at - 1] {
            b' ' | b',' | b'(' => true,
            b'*' => bytes[at] != b'*' && bytes[at - 2] != b'*',
            _ => false,
        };
        let Some(at) = (2..=room.min(rest.len() - 1)).rev().find(|&at| splits(at)) else { break };
        let _ = writeln!(out, "{indent}{} &", rest[..at].trim_end());
        rest = rest[at..].trim_start().to_owned();
        if !indent.ends_with("    ") || out.lines().count() == 1 {
            indent += "    ";
        }
    }
    let _ = writeln!(out, "{indent}{rest}");
    out
}

/// The numbers, as declarations.
pub fn constants(code: &Code, indent: &str) -> String {
    code.constants
        .iter()
        .map(|constant| {
            let (name, value) = (&constant.name, digits(constant.value));
            statement(indent, &format!("real(dp), parameter :: {name} = {value}_dp"))
        })
        .collect()
}

/// Small functions that others call, those that `code` does.
pub fn helpers(code: &str) -> String {
    let helpers = include_str!("fortran/helpers.f90").split_inclusive("\n\n");
    let name = |helper: &str| {
        let start = helper.split("elemental function ").nth(1)?;
        Some(start.split_inclusive('(').next()?.to_owned())
    };
    helpers.filter(|helper| name(helper).is_some_and(|name| code.contains(&name))).collect()
}

/// The routines, as they stand after `contains`.
pub fn routines(code: &Code) -> String {
    let mut out = String::new();
    for routine in &code.routines {
        let (name, inputs) = (&routine.name, routine.inputs.join(", "));
        out.push('\n');
        out += &comment("  ! ", std::slice::from_ref(&routine.about));
        // An elemental function has an argument.
        let kind = if inputs.is_empty() { "pure" } else { "elemental" };
        out += &statement("  ", &format!("{kind} function {name}({inputs}) result(y)"));
        if !inputs.is_empty() {
            out += &statement("    ", &format!("real(dp), intent(in) :: {inputs}"));
        }
        out += "    real(dp) :: y\n";
        let value = |node| format!("y = {}", text(node, &Fortran).text);
        for (i, (condition, node)) in routine.arms.iter().enumerate() {
            let word = if i == 0 { "if" } else { "else if" };
            let condition = code::holds(condition, &Fortran);
            out += &statement("    ", &format!("{word} ({condition}) then"));
            out += &statement("      ", &value(node));
        }
        if routine.arms.is_empty() {
            out += &statement("    ", &value(&routine.last));
        } else {
            out += "    else\n";
            out += &statement("      ", &value(&routine.last));
            out += "    end if\n";
        }
        let _ = writeln!(out, "  end function {name}");
    }
    out
}

/// The function that a user calls.
pub fn quantity(quantity: &Quantity, outside: Outside) -> String {
    let name = format!("favre_{}", quantity.name);
    let inputs: Vec<&str> = quantity.ranges.iter().map(|range| range.symbol()).collect();
    let inputs = inputs.join(", ");
    let mut lines = vec![format!("{} [{}], of", quantity.predicts, quantity.unit)];
    lines.extend(quantity.range_lines().into_iter().map(|line| format!("  {line}")));
    lines.push(super::outside_line(outside).into());
    let mut out = String::from("\n") + &comment("  ! ", &lines);
    out += &statement("  ", &format!("elemental function {name}({inputs}) result(y)"));
    out += &statement("    ", &format!("real(dp), intent(in) :: {inputs}"));
    out += "    real(dp) :: y\n";
    let arguments: Vec<String> = quantity
        .inputs
        .iter()
        .map(|input| {
            let range = quantity.ranges.iter().find(|range| range.symbol() == input);
            let range = range.expect("a formula's markers have ranges");
            match outside {
                Outside::Clamp => {
                    let (low, high) = (digits(range.low), digits(range.high));
                    format!("favre_clamp({input}, {low}_dp, {high}_dp)")
                }
                Outside::Formula => input.clone(),
            }
        })
        .collect();
    out += &statement("    ", &format!("y = {}({})", quantity.routine, arguments.join(", ")));
    let _ = writeln!(out, "  end function {name}");
    out += "\n  ! Whether all of them are in their ranges.\n";
    out += &statement("  ", &format!("elemental function {name}_inside({inputs}) result(y)"));
    out += &statement("    ", &format!("real(dp), intent(in) :: {inputs}"));
    out += "    logical :: y\n";
    let inside: Vec<String> = quantity
        .ranges
        .iter()
        .map(|r| {
            let (low, high) = (digits(r.low), digits(r.high));
            format!("{0} >= {low}_dp .and. {0} <= {high}_dp", r.symbol())
        })
        .collect();
    out += &statement("    ", &format!("y = {}", inside.join(" .and. ")));
    let _ = writeln!(out, "  end function {name}_inside");
    out
}

/// The functions of all quantities.
pub fn quantities(facts: &Facts) -> String {
    facts.quantities.iter().map(|q| quantity(q, facts.outside)).collect()
}

/// All functions, as they stand after `contains`.
pub fn functions(facts: &Facts) -> String {
    let functions = routines(&facts.code) + &quantities(facts);
    helpers(&functions) + functions.trim_start_matches('\n')
}

/// `text` inside a Fortran string.
pub fn quoted(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
    let text: String = text.chars().map(plain).collect();
    format!("'{}'", text.replace('\'', "''"))
}

/// A parameter that is a text, on lines that are not too long.
fn parameter(name: &str, value: &str) -> String {
    let mut parts = Vec::new();
    let mut rest: Vec<char> = value.chars().collect();
    while !rest.is_empty() {
        let tail = rest.split_off(rest.len().min(80));
        parts.push(quoted(&rest.into_iter().collect::<String>()));
        rest = tail;
    }
    if parts.is_empty() {
        parts.push(quoted(""));
    }
    format!(
        "  character(len=*), parameter, public :: {name} = &\n    {}\n",
        parts.join(" // &\n    ")
    )
}

/// The module.
pub fn module(facts: &Facts) -> String {
    let public: String = facts
        .quantities
        .iter()
        .map(|q| format!("  public :: favre_{0}, favre_{0}_inside\n", q.name))
        .collect();
    fill(
        include_str!("fortran/favre_closure.f90"),
        &[
            ("about", &comment("! ", &facts.about)),
            ("name", &parameter("favre_closure_name", &facts.name)),
            ("hash", &parameter("favre_closure_sha256", &facts.hash)),
            ("reference", &parameter("favre_closure_reference", &facts.reference)),
            ("public", &public),
            ("constants", &constants(&facts.code, "  ")),
            ("functions", &functions(facts)),
        ],
    )
}

/// A program that compares the test vectors.
fn check(facts: &Facts) -> String {
    let mut tests = String::new();
    for quantity in &facts.quantities {
        for (i, (point, expected)) in quantity.vectors.iter().enumerate() {
            let point: Vec<String> = point.iter().map(|x| Fortran.number(*x).text).collect();
            let (name, point) = (&quantity.name, point.join(", "));
            let expected = Fortran.number(*expected).text;
            let call =
                format!("call compare('{name}', {}, favre_{name}({point}), {expected})", i + 1);
            tests += &statement("  ", &call);
        }
    }
    fill(include_str!("fortran/check.f90"), &[("tests", &tests)])
}

/// The files of this target.
pub fn export(facts: &Facts) -> Vec<Piece> {
    vec![
        Piece::text("favre_closure.f90", module(facts)),
        Piece::text("check.f90", check(facts)),
        facts.readme_of_routines(include_str!("fortran/README.md")),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_statements_break_between_tokens() {
        let factors: Vec<String> =
            (0..40).map(|i| format!("a{i}**b{i}*(c{i} - 1.0e-5_dp)")).collect();
        let long = format!("y = {}", factors.join("*"));
        let broken = statement("    ", &long);
        assert!(broken.lines().count() > 5);
        assert!(broken.lines().all(|line| line.len() <= WIDTH), "{broken}");
        let joined: String =
            broken.replace('&', "").split_whitespace().collect::<Vec<_>>().join("");
        assert_eq!(joined, long.replace(' ', ""));
        assert!(broken.lines().all(|line| !line.trim_end_matches(" &").ends_with("**")));
    }
}
