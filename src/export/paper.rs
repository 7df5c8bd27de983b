//! For a paper: equations, coefficients with intervals, ranges; as LaTeX, and the same as Markdown.

use super::code::{Binds, Language, Text, digits, text};
use super::{Facts, Piece, Quantity, fill, outside_line, short};
use crate::expression::{Comparison, Expression, Function};
use crate::fit::ReferenceLength;
use crate::forms::Marker;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Mathematics as LaTeX writes it.
struct Latex;

impl Language for Latex {
    fn number(&self, value: f64) -> Text {
        let plain = short(value);
        match plain.split_once('e') {
            Some((mantissa, exponent)) => {
                Text { text: format!("{mantissa}\\times 10^{{{exponent}}}"), binds: Binds::Product }
            }
            None if value < 0.0 => Text { text: plain, binds: Binds::Sum },
            None => Text::whole(plain),
        }
    }

    fn name(&self, name: &str) -> Text {
        Text::whole(symbol(name))
    }

    fn parentheses(&self, inner: &str) -> String {
        format!("\\left({inner}\\right)")
    }

    fn product(&self, a: Text, b: Text) -> Text {
        let (a, b) = (self.operand(a, Binds::Product), self.operand(b, Binds::Product));
        // Between numbers a space alone would be read as one number.
        let digit = b.starts_with(|c: char| c.is_ascii_digit());
        let sign = if digit { " \\cdot " } else { "\\," };
        Text { text: format!("{a}{sign}{b}"), binds: Binds::Product }
    }

    fn quotient(&self, a: Text, b: Text) -> Text {
        Text { text: format!("\\frac{{{}}}{{{}}}", a.text, b.text), binds: Binds::Product }
    }

    fn power(&self, a: Text, b: Text, _: Option<f64>) -> Text {
        let base = self.operand(a, Binds::Whole);
        // A symbol with a superscript of its own takes no second one.
        let base = if base.contains('^') && !base.starts_with('\\') || base.contains("^*") {
            format!("{{{base}}}")
        } else {
            base
        };
        Text { text: format!("{base}^{{{}}}", b.text), binds: Binds::Power }
    }

    fn function(&self, function: Function, arguments: Vec<Text>) -> Text {
        let arguments: Vec<String> = arguments.into_iter().map(|argument| argument.text).collect();
        let inner = arguments.join(", ");
        let text = match function {
            Function::Sqrt => format!("\\sqrt{{{inner}}}"),
            Function::Abs => format!("\\left|{inner}\\right|"),
            Function::Exp => format!("\\exp\\left({inner}\\right)"),
            Function::Ln => format!("\\ln\\left({inner}\\right)"),
            Function::Log10 => format!("\\log_{{10}}\\left({inner}\\right)"),
            Function::Tanh => format!("\\tanh\\left({inner}\\right)"),
            Function::Atan => format!("\\arctan\\left({inner}\\right)"),
            Function::Min => format!("\\min\\left({inner}\\right)"),
            Function::Max => format!("\\max\\left({inner}\\right)"),
        };
        Text::whole(text)
    }

    fn cases(&self, arms: Vec<(String, Text)>, last: Text) -> Text {
        let mut text = String::from("\\begin{cases}\n");
        for (condition, value) in arms {
            let _ = writeln!(text, "  {} & {condition} \\\\", value.text);
        }
        let _ = write!(text, "  {} & \\text{{else}}\n\\end{{cases}}", last.text);
        Text::whole(text)
    }

    fn comparison(&self, comparison: Comparison) -> String {
        match comparison {
            Comparison::Less => "<",
            Comparison::LessOrEqual => "\\le",
            Comparison::Greater => ">",
            Comparison::GreaterOrEqual => "\\ge",
        }
        .into()
    }
}

/// Greek letters that a name may begin with.
const GREEK: [&str; 12] = [
    "alpha", "beta", "gamma", "delta", "epsilon", "kappa", "lambda", "mu", "phi", "rho", "sigma",
    "tau",
];

/// A name of a formula as a symbol.
fn symbol(name: &str) -> String {
    let marker = match Marker::of_symbol(name) {
        Some(Marker::SolidsFraction) => Some("\\phi"),
        Some(Marker::FilterWidth) => Some("\\Delta^*"),
        Some(Marker::Slip) => Some("V^*"),
        Some(Marker::ShearRate) => Some("S^*"),
        Some(Marker::GasShearRate) => Some("S^*_g"),
        Some(Marker::WallDistance) => Some("x^*"),
        Some(Marker::PressureGradient) => Some("G^*"),
        None => None,
    };
    if let Some(marker) = marker {
        return marker.into();
    }
    let (base, index) = name.split_once('_').unwrap_or((name, ""));
    let base = match (GREEK.contains(&base), base.chars().count()) {
        (true, _) => format!("\\{base}"),
        (false, 1) => base.to_owned(),
        _ => format!("\\mathrm{{{}}}", escaped(base)),
    };
    match index {
        "" => base,
        "inf" => format!("{base}_\\infty"),
        index => format!("{base}_\\mathrm{{{}}}", escaped(&index.replace('_', ","))),
    }
}

/// What a quantity is called in an equation.
fn quantity_symbol(predicts: &str) -> String {
    match predicts {
        "drag_correction" => "H".into(),
        "solids_viscosity" => "\\mu_s^*".into(),
        "solids_pressure" => "p_s^*".into(),
        other => format!("\\text{{{}}}", escaped(&other.replace('_', " "))),
    }
}

/// A text for LaTeX.
fn escaped(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out += "\\textbackslash{}",
            '^' => out += "\\^{}",
            '~' => out += "\\~{}",
            '<' => out += "\\textless{}",
            '>' => out += "\\textgreater{}",
            c => out.push(c),
        }
    }
    out
}

/// The formulae of a quantity: itself, then what it is made of, each once.
fn equations(
    facts: &Facts,
    quantity: &Quantity,
    done: &mut BTreeSet<String>,
) -> Vec<(String, String)> {
    let compiled = facts.closure.quantity(Some(&quantity.predicts));
    let formula = &compiled.expect("the facts are the closure's").formula;
    let mut out = Vec::new();
    let mut waiting: Vec<(String, &Expression)> =
        vec![(quantity_symbol(&quantity.predicts), formula)];
    while let Some((left, formula)) = waiting.pop() {
        out.push((left, text(formula.root(), &Latex).text));
        let names = formula.names();
        for name in names.into_iter().rev() {
            if let Some(formula) = facts.closure.formula(name)
                && done.insert(name.to_owned())
            {
                waiting.push((symbol(name), formula));
            }
        }
    }
    out
}

/// A constant, its value and its 95 % interval where a fit gives one.
fn coefficients(facts: &Facts) -> Vec<[String; 3]> {
    facts
        .code
        .constants
        .iter()
        .map(|constant| {
            let fit = facts.closure.file.fit.iter().flat_map(|fit| &fit.coefficients);
            let fitted = fit.into_iter().find(|c| c.symbol == constant.original);
            let interval = match fitted {
                Some(fit) if fit.held => "held".to_owned(),
                Some(fit) => format!("{} to {}", rounded(fit.low_95), rounded(fit.high_95)),
                None => String::new(),
            };
            [constant.original.clone(), short(constant.value), interval]
        })
        .collect()
}

/// Four significant digits.
fn rounded(value: f64) -> String {
    let text = format!("{value:.3e}");
    short(text.parse().unwrap_or(value))
}

fn length(length: ReferenceLength) -> &'static str {
    match length {
        ReferenceLength::One => "L = u_t^2/g",
        ReferenceLength::Two => "L = d\\,(u_t^2/(g d))^{1/3}",
    }
}

/// A unit as a symbol.
fn unit(unit: &str) -> String {
    match unit {
        "-" => "-".into(),
        "rho_s u_t^2" => "$\\rho_s u_t^2$".into(),
        "rho_s u_t^3/g" => "$\\rho_s u_t^3/g$".into(),
        "u_t^3/g" => "$u_t^3/g$".into(),
        other => escaped(other),
    }
}

/// The files of LaTeX.
pub fn latex(facts: &Facts) -> Vec<Piece> {
    let mut equations_text = String::new();
    let mut done = BTreeSet::new();
    for quantity in &facts.quantities {
        for (left, right) in equations(facts, quantity, &mut done) {
            let _ = write!(
                equations_text,
                "\\begin{{equation}}\n{left} = {right}\n\\end{{equation}}\n"
            );
        }
    }
    let mut rows = String::new();
    for [name, value, interval] in coefficients(facts) {
        let value = value.parse().map_or(value, |value| Latex.number(value).text);
        let interval = interval.replace(" to ", " -- ");
        let _ = writeln!(rows, "${}$ & ${value}$ & {interval} \\\\", symbol(&name));
    }
    let mut ranges = String::new();
    for quantity in &facts.quantities {
        let (name, unit) = (quantity_symbol(&quantity.predicts), unit(&quantity.unit));
        for range in &quantity.ranges {
            let (symbol, low, high) = (symbol(range.symbol()), short(range.low), short(range.high));
            let _ = writeln!(ranges, "${name}$ & {unit} & ${symbol}$ & {low} -- {high} \\\\");
        }
    }
    let comment: String = facts.about.iter().map(|line| format!("% {line}\n")).collect();
    let file = fill(
        include_str!("paper/closure.tex"),
        &[
            ("comment", &comment),
            ("equations", &equations_text),
            ("coefficients", &if rows.is_empty() { String::new() } else { table(&rows) }),
            ("ranges", &ranges),
            ("length", length(facts.closure.file.reference_length)),
            ("outside", outside_line(facts.outside)),
            ("name", &escaped(&facts.name)),
            ("reference", &escaped(&facts.reference)),
            ("hash", &facts.hash),
        ],
    );
    let readme =
        fill(include_str!("paper/README.md"), &[("name", &facts.name), ("facts", &facts.readme)]);
    vec![Piece::text("closure.tex", file), Piece::text("README.md", readme)]
}

/// The table of coefficients.
fn table(rows: &str) -> String {
    fill(include_str!("paper/coefficients.tex"), &[("rows", rows)])
}

/// The file of Markdown, which is its own README.
pub fn markdown(facts: &Facts) -> Vec<Piece> {
    let mut page = format!("# {}\n\n{}\n", facts.name, facts.readme);
    let mut done = BTreeSet::new();
    for quantity in &facts.quantities {
        let _ = writeln!(page, "## {} [{}]\n", quantity.predicts, quantity.unit);
        for (left, right) in equations(facts, quantity, &mut done) {
            let _ = writeln!(page, "$$\n{left} = {right}\n$$\n");
        }
        page += "| marker | symbol | from | to |\n| --- | --- | --- | --- |\n";
        for range in &quantity.ranges {
            let (marker, symbol) = (range.marker, symbol(range.symbol()));
            let (low, high) = (short(range.low), short(range.high));
            let _ = writeln!(page, "| {} | ${symbol}$ | {low} | {high} |", super::meaning(marker));
        }
        page.push('\n');
    }
    let rows = coefficients(facts);
    if !rows.is_empty() {
        page += "| coefficient | value | 95 % interval |\n| --- | --- | --- |\n";
        for [name, value, interval] in rows {
            let value = value.parse::<f64>().map_or(value, digits);
            let _ = writeln!(page, "| ${}$ | {value} | {interval} |", symbol(&name));
        }
    }
    vec![Piece::text("README.md", page)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closure::tests::file;
    use crate::closure::{BUILT_IN, Closure};
    use std::path::Path;

    fn of(piece: &Piece) -> String {
        String::from_utf8(piece.bytes.clone()).unwrap()
    }

    #[test]
    fn the_fitted_model_reads_as_in_a_paper() {
        let text = file().to_toml().unwrap();
        let closure = Closure::parse(&text, Path::new("model.toml")).unwrap();
        let facts = Facts::new(&closure, false).unwrap();
        let tex = of(&latex(&facts)[0]);
        assert!(tex.contains("H = "), "{tex}");
        assert!(tex.contains("\\begin{cases}") || tex.contains("\\frac"), "{tex}");
        let fit = closure.file.fit.as_ref().unwrap();
        let plateau = fit.coefficients.iter().find(|c| c.symbol == "H_inf").unwrap();
        let (value, low, high) =
            (short(plateau.value), rounded(plateau.low_95), rounded(plateau.high_95));
        assert!(tex.contains(&format!("$H_\\infty$ & ${value}$ & {low} -- {high}")), "{tex}");
        let page = of(&markdown(&facts)[0]);
        assert!(page.contains(&format!("| $H_\\infty$ | {value} | {low} to {high} |")), "{page}");
        let range = &closure.file.quantities[0].ranges[0];
        let row = format!("| filtered solids fraction | $\\phi$ | 0 | {} |", short(range.high));
        assert!(page.contains(&row), "{page}");
    }

    #[test]
    fn every_equation_is_balanced_and_no_superscript_stands_on_another() {
        for (name, _) in BUILT_IN {
            let closure = Closure::find(name).unwrap();
            let facts = Facts::new(&closure, false).unwrap();
            let mut done = BTreeSet::new();
            for quantity in &facts.quantities {
                for (left, right) in equations(&facts, quantity, &mut done) {
                    let count = |what: &str| right.matches(what).count();
                    assert_eq!(count("{"), count("}"), "{name} {left}: {right}");
                    assert_eq!(count("\\left"), count("\\right"), "{name} {left}: {right}");
                    assert!(!right.contains("^*^"), "{name} {left}: {right}");
                    // What each name stands for is said.
                    assert!(!right.contains('`'), "{name} {left}: {right}");
                }
            }
        }
    }

    #[test]
    fn symbols_are_those_of_papers() {
        assert_eq!(symbol("D"), "\\Delta^*");
        assert_eq!(symbol("phi_c"), "\\phi_\\mathrm{c}");
        assert_eq!(symbol("C_mu"), "C_\\mathrm{mu}");
        assert_eq!(symbol("env_2"), "\\mathrm{env}_\\mathrm{2}");
        let squared = Expression::parse("D^2 - 2*3 + 1e-5*phi").unwrap();
        let found = text(squared.root(), &Latex).text;
        assert_eq!(found, "{\\Delta^*}^{2} - 2 \\cdot 3 + 1\\times 10^{-5}\\,\\phi");
    }
}
