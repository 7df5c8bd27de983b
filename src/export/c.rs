//! C: one header of pure functions that needs math.h alone.

use super::code::{self, Binds, Code, Language, Text, comment, digits, text};
use super::{Facts, Piece, Quantity, fill};
use crate::expression::Function;
use crate::model::Outside;
use std::fmt::Write;

/// The language.
pub struct C;

impl Language for C {
    fn number(&self, value: f64) -> Text {
        let binds = if value.is_sign_negative() { Binds::Sum } else { Binds::Whole };
        Text { text: digits(value), binds }
    }

    fn power(&self, a: Text, b: Text, exponent: Option<f64>) -> Text {
        let name = match exponent {
            Some(1.0) => return a,
            Some(2.0) => "favre_square",
            Some(3.0) => "favre_cube",
            Some(1.5) => "favre_three_halves",
            Some(0.5) => "sqrt",
            _ => return Text::whole(format!("pow({}, {})", a.text, b.text)),
        };
        Text::whole(format!("{name}({})", a.text))
    }

    fn function(&self, function: Function, arguments: Vec<Text>) -> Text {
        let name = match function {
            Function::Exp => "exp",
            Function::Ln => "log",
            Function::Log10 => "log10",
            Function::Sqrt => "sqrt",
            Function::Abs => "fabs",
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
            format!("({condition} ? {} : {last})", value.text)
        });
        Text::whole(cases)
    }
}

/// `text` inside a C comment.
pub fn safe(text: &str) -> String {
    text.replace("*/", "* /").replace("/*", "/ *")
}

/// `text` inside a C string.
pub fn quoted(text: &str) -> String {
    let plain = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
    let text: String = text.chars().map(plain).collect();
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

/// Constants and routines.
pub fn routines(code: &Code) -> String {
    let mut out = String::new();
    for constant in &code.constants {
        let (name, value) = (&constant.name, digits(constant.value));
        let _ = writeln!(out, "static const double {name} = {value};");
    }
    for routine in &code.routines {
        let about = comment(" * ", &[safe(&routine.about)]);
        let arguments = arguments(&routine.inputs);
        let _ = write!(out, "\n/*{}", &about[2..]);
        let _ = writeln!(out, " */\nstatic inline double {}({arguments})\n{{", routine.name);
        for (condition, value) in &routine.arms {
            let condition = code::holds(condition, &C);
            let _ = writeln!(out, "    if ({condition}) return {};", text(value, &C).text);
        }
        let _ = writeln!(out, "    return {};\n}}", text(&routine.last, &C).text);
    }
    out
}

fn arguments(inputs: &[String]) -> String {
    let typed: Vec<String> = inputs.iter().map(|input| format!("double {input}")).collect();
    if typed.is_empty() { "void".into() } else { typed.join(", ") }
}

/// The functions that a user calls.
fn quantity(quantity: &Quantity, outside: Outside) -> String {
    let (name, unit) = (&quantity.name, &quantity.unit);
    let inputs: Vec<String> = quantity.ranges.iter().map(|r| r.symbol().to_owned()).collect();
    let mut lines = vec![format!("{} [{unit}], of", quantity.predicts)];
    lines.extend(quantity.range_lines().into_iter().map(|line| format!("  {line}")));
    lines.push(super::outside_line(outside).into());
    let about: Vec<String> = lines.iter().map(|line| safe(line)).collect();
    let mut out = format!("\n/*{} */\n", &comment(" * ", &about)[2..]);
    let arguments = arguments(&inputs);
    let _ = writeln!(out, "static inline double favre_{name}({arguments})\n{{");
    if outside == Outside::Clamp {
        for range in &quantity.ranges {
            let (symbol, low, high) = (range.symbol(), digits(range.low), digits(range.high));
            let _ = writeln!(out, "    {symbol} = favre_clamp({symbol}, {low}, {high});");
        }
    } else {
        for unused in inputs.iter().filter(|input| !quantity.inputs.contains(input)) {
            let _ = writeln!(out, "    (void){unused};");
        }
    }
    let _ = writeln!(out, "    return {}({});\n}}", quantity.routine, quantity.inputs.join(", "));
    let inside: Vec<String> = quantity
        .ranges
        .iter()
        .map(|r| format!("{0} >= {1} && {0} <= {2}", r.symbol(), digits(r.low), digits(r.high)))
        .collect();
    let _ = writeln!(
        out,
        "\n/* 1 where all of them are in their ranges, else 0. */\n\
         static inline int favre_{name}_inside({arguments})\n{{\n    return {};\n}}",
        inside.join("\n        && ")
    );
    out
}

/// The header.
pub fn header(facts: &Facts) -> String {
    let about: Vec<String> = facts.about.iter().map(|line| safe(line)).collect();
    let quantities: String = facts.quantities.iter().map(|q| quantity(q, facts.outside)).collect();
    fill(
        include_str!("c/favre_closure.h"),
        &[
            ("about", &comment(" * ", &about)),
            ("name", &quoted(&facts.name)),
            ("hash", &facts.hash),
            ("reference", &quoted(&facts.reference)),
            ("routines", &routines(&facts.code)),
            ("quantities", &quantities),
        ],
    )
}

/// A program that compares the test vectors.
fn check(facts: &Facts) -> String {
    let mut tests = String::new();
    for quantity in &facts.quantities {
        let (name, count) = (&quantity.name, quantity.vectors.len());
        let width = quantity.ranges.len() + 1;
        let _ = writeln!(tests, "    {{\n        static const double at[{count}][{width}] = {{");
        for (point, expected) in &quantity.vectors {
            let numbers: Vec<String> = point.iter().chain([expected]).map(|x| digits(*x)).collect();
            let _ = writeln!(tests, "            {{{}}},", numbers.join(", "));
        }
        let arguments: Vec<String> = (0..width - 1).map(|i| format!("at[i][{i}]")).collect();
        let _ = writeln!(
            tests,
            "        }};\n        for (i = 0; i < {count}; i++)\n            \
             compare(\"{name}\", i, favre_{name}({}), at[i][{}]);\n    }}",
            arguments.join(", "),
            width - 1
        );
    }
    fill(include_str!("c/check.c"), &[("tests", &tests)])
}

/// The files of this target.
pub fn export(facts: &Facts) -> Vec<Piece> {
    vec![
        Piece::text("favre_closure.h", header(facts)),
        Piece::text("check.c", check(facts)),
        facts.readme_of_routines(include_str!("c/README.md")),
    ]
}
