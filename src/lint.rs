//! [`check`]: what is wrong with a closure, found without knowing it.
//!
//! Each check looks at the formula's values and at its tree, from which it takes the points where a
//! piecewise formula switches and the divisors that may vanish. What a file lists under
//! `known_flaws` is found all the same, and said not to count, as long as it is no larger than listed.

use crate::closure::{Closure, KnownFlaw, Quantity};
use crate::expression::{Comparison, Expression, Node, Operator, Program};
use crate::forms::Marker;
use crate::laws::scales::Scales;
use crate::model::Outside;
use serde::Serialize;
use std::fmt;

/// What the checks of a closure found.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// Name of the closure.
    pub closure: String,
    /// One for each check of each quantity that has something to say.
    pub findings: Vec<Finding>,
}

/// What one check found.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Name of the check.
    pub check: &'static str,
    /// Quantity; `-` for the closure as a whole.
    pub quantity: String,
    /// How it went.
    pub verdict: Verdict,
    /// What was seen, or what was made sure of.
    pub what: String,
}

/// How a check went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Nothing is wrong.
    Fine,
    /// Worth knowing, nothing wrong.
    Note,
    /// A flaw of the publication, which the file lists.
    KnownFlaw,
    /// Wrong.
    Fault,
}

impl Report {
    /// How many faults there are.
    pub fn faults(&self) -> usize {
        self.findings.iter().filter(|finding| finding.verdict == Verdict::Fault).count()
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for finding in &self.findings {
            let verdict = match finding.verdict {
                Verdict::Fine => "ok",
                Verdict::Note => "note",
                Verdict::KnownFlaw => "known flaw",
                Verdict::Fault => "FAULT",
            };
            let Finding { check, quantity, what, .. } = finding;
            writeln!(f, "{verdict:10}  {quantity:28}  {check:13}  {what}")?;
        }
        match self.faults() {
            0 => write!(f, "{}: no faults", self.closure),
            1 => write!(f, "{}: 1 fault", self.closure),
            faults => write!(f, "{}: {faults} faults", self.closure),
        }
    }
}

/// Something seen, before it is known whether the file lists it.
struct Seen {
    check: &'static str,
    quantity: String,
    /// Value of the marker at which it was seen, if it has a place.
    at: Option<f64>,
    size: f64,
    what: String,
}

/// Largest jump, in shares of the value beside it, that counts as rounding of printed coefficients.
const ROUNDING: f64 = 0.02;

/// Values smaller than this share of the largest one are compared with it and not with themselves.
const SMALL: f64 = 0.01;

/// Largest deviation with which a test vector counts as given, in shares of values above 1.
const GIVEN: f64 = 1e-12;

/// Checks `closure`.
pub fn check(closure: &Closure) -> Report {
    let mut report = Report { closure: closure.file.name.clone(), findings: Vec::new() };
    let mut used = vec![false; closure.file.known_flaws.len()];
    let mut seen = Vec::new();
    for missing in &closure.file.missing {
        note(&mut report, "-", "complete", format!("partial: {missing}"));
    }
    system(closure, &mut seen);
    settle(closure, "-", &["system"], seen, &mut used, &mut report);
    for quantity in &closure.quantities {
        let view = View::new(closure, quantity);
        let mut seen = Vec::new();
        view.test_vectors(&mut seen);
        view.finite(&mut seen);
        view.bounds(&mut seen);
        view.limits(&mut seen);
        view.monotone(&mut seen);
        view.switches(&mut seen);
        view.exponents(&mut seen);
        view.effects(&mut seen);
        view.range(&mut seen);
        let name = &quantity.file.predicts;
        let checks: Vec<&str> =
            CHECKS.into_iter().filter(|check| view.is_drag() || *check != "limits").collect();
        settle(closure, name, &checks, seen, &mut used, &mut report);
        if quantity.file.ranges.iter().any(|range| range.low > 0.0) {
            let outside = match closure.file.outside {
                Outside::Clamp => "markers are moved to the nearest end of their ranges",
                Outside::Formula => "the formula is taken as it stands, an extrapolation",
            };
            note(&mut report, name, "range", format!("outside its ranges {outside}"));
        }
    }
    for (flaw, used) in closure.file.known_flaws.iter().zip(used) {
        if !used {
            report.findings.push(Finding {
                check: "known_flaws",
                quantity: flaw.quantity.clone(),
                verdict: Verdict::Fault,
                what: format!(
                    "the file lists a flaw of `{}` that is not there; remove it",
                    flaw.check
                ),
            });
        }
    }
    report
}

/// The checks of a quantity, in the order of the report.
const CHECKS: [&str; 10] = [
    "test_vectors",
    "finite",
    "bounds",
    "limits",
    "monotone",
    "continuity",
    "singularity",
    "exponents",
    "effects",
    "range",
];

fn note(report: &mut Report, quantity: &str, check: &'static str, what: String) {
    let quantity = quantity.to_owned();
    report.findings.push(Finding { check, quantity, verdict: Verdict::Note, what });
}

/// Turns what was seen into findings: known or not, and `checks` that saw nothing.
fn settle(
    closure: &Closure,
    name: &str,
    checks: &[&'static str],
    seen: Vec<Seen>,
    used: &mut [bool],
    report: &mut Report,
) {
    for check in checks {
        let mut silent = true;
        for seen in seen.iter().filter(|seen| seen.check == *check) {
            silent = false;
            let known = closure.file.known_flaws.iter().position(|flaw| covers(flaw, seen));
            let (verdict, what) = match known {
                Some(i) => {
                    used[i] = true;
                    let reason = &closure.file.known_flaws[i].reason;
                    (Verdict::KnownFlaw, format!("{}. {reason}", seen.what))
                }
                None => (Verdict::Fault, seen.what.clone()),
            };
            let quantity = seen.quantity.clone();
            report.findings.push(Finding { check, quantity, verdict, what });
        }
        if silent {
            report.findings.push(Finding {
                check,
                quantity: name.into(),
                verdict: Verdict::Fine,
                what: made_sure(check).into(),
            });
        }
    }
}

fn covers(flaw: &KnownFlaw, seen: &Seen) -> bool {
    let near = |at: f64| seen.at.is_some_and(|seen| (seen - at).abs() <= 0.01 * at.abs());
    flaw.check == seen.check
        && flaw.quantity == seen.quantity
        && seen.size <= flaw.largest
        && (flaw.at.is_empty() || flaw.at.iter().any(|at| near(*at)))
}

/// What a check that saw nothing has made sure of.
fn made_sure(check: &str) -> &'static str {
    match check {
        "system" => "u_t is the true terminal velocity, Fr_p and lengths follow from it",
        "test_vectors" => "all given to 1e-12",
        "finite" => "a number everywhere inside the ranges, and far outside",
        "bounds" => "nowhere negative, and a drag correction below 1",
        "limits" => "vanishes without particles, without a filter, at close packing and above",
        "monotone" => "does not fall with the filter width",
        "continuity" => "no jump above 2 % at any switch of a formula",
        "singularity" => "no divisor changes its sign",
        "exponents" => "powers of the markers are those stated, none is zero",
        "effects" => "every marker that has a range has an effect",
        _ => "inside 0 to 1 for the solids fraction, with test vectors inside and outside",
    }
}

/// Recomputes the scales of the system.
fn system(closure: &Closure, seen: &mut Vec<Seen>) {
    let Some(system) = &closure.file.system else { return };
    let (powder, gas) = (system.powder(), system.gas());
    let mut say = |size: f64, what: String| {
        seen.push(Seen { check: "system", quantity: "-".into(), at: None, size, what });
    };
    let positive = [
        system.diameter,
        system.particle_density,
        system.gas_density,
        system.gas_viscosity,
        system.gravity,
        system.particle_density - system.gas_density,
    ];
    if positive.iter().any(|x| !(*x > 0.0 && x.is_finite())) {
        return say(f64::INFINITY, "a property of powder or gas is not positive".into());
    }
    let scales = Scales::new(&powder, &gas, system.gravity);
    let u_t = scales.terminal_velocity;
    let off = |found: f64, right: f64| (found / right - 1.0).abs();
    if off(system.terminal_velocity, u_t).is_nan() || off(system.terminal_velocity, u_t) > 0.005 {
        // Stokes' drag: u = (ρ_s - ρ_g) g d²/(18 μ).
        let weight = (powder.density - gas.density) * system.gravity * powder.diameter.powi(2);
        let stokes = weight / (18.0 * gas.viscosity);
        let is_stokes = off(system.terminal_velocity, stokes) < 0.01;
        let which = if is_stokes { " (it is Stokes' value)" } else { "" };
        say(
            off(system.terminal_velocity, u_t),
            format!(
                "u_t = {} m/s{which}, and the true terminal velocity of this powder is {u_t:.5} m/s: \
                 scaled filter widths and velocities are off",
                system.terminal_velocity
            ),
        );
        return;
    }
    let u = system.terminal_velocity;
    let froude = u * u / (system.gravity * system.diameter);
    let length = u * u / system.gravity;
    for (key, found, right) in [
        ("froude", system.froude, froude),
        ("length_i", system.length_i, length),
        ("length_ii", system.length_ii, length * froude.powf(-2.0 / 3.0)),
    ] {
        if off(found, right).is_nan() || off(found, right) > 1e-3 {
            say(off(found, right), format!("{key} is {found}, and u_t makes it {right:.6e}"));
        }
    }
}

/// A quantity and the points at which it is looked at.
struct View<'a> {
    closure: &'a Closure,
    quantity: &'a Quantity,
    /// For each marker values inside its range.
    inside: Vec<Vec<f64>>,
    /// For each marker values inside and outside.
    everywhere: Vec<Vec<f64>>,
    /// Largest absolute value inside.
    largest: f64,
}

impl<'a> View<'a> {
    fn new(closure: &'a Closure, quantity: &'a Quantity) -> Self {
        let mut inside = Vec::new();
        let mut everywhere = Vec::new();
        for range in &quantity.file.ranges {
            let span = range.high - range.low;
            let mut values: Vec<f64> =
                (0..=24).map(|i| range.low + span * f64::from(i) / 24.0).collect();
            // Small values as well: much happens near zero.
            let small = [1e-4, 1e-3, 1e-2].map(|share| range.low + share * span);
            values.extend(small);
            values.sort_by(f64::total_cmp);
            inside.push(values.clone());
            match range.marker {
                Marker::SolidsFraction => {
                    values.extend([0.0, 1e-9, 0.6, 0.64, 0.66, 0.75, 0.9, 1.0])
                }
                Marker::PressureGradient => values.extend([2.0 * range.low, 2.0 * range.high]),
                _ => values.extend([0.0, 0.1 * range.low, 3.0 * range.high, 1e3 * range.high]),
            }
            values.sort_by(f64::total_cmp);
            values.dedup();
            everywhere.push(values);
        }
        let mut view = Self { closure, quantity, inside, everywhere, largest: 0.0 };
        let mut largest = 0.0f64;
        view.each(&view.inside, |_, value| {
            if value.is_finite() {
                largest = largest.max(value.abs());
            }
        });
        view.largest = largest;
        view
    }

    fn name(&self) -> &str {
        &self.quantity.file.predicts
    }

    fn is_drag(&self) -> bool {
        self.name().starts_with("drag_correction")
    }

    fn seen(&self, check: &'static str, at: Option<f64>, size: f64, what: String) -> Seen {
        Seen { check, quantity: self.name().into(), at, size, what }
    }

    fn place(&self, marker: Marker) -> Option<usize> {
        self.quantity.markers().position(|m| m == marker)
    }

    fn say(&self, point: &[f64]) -> String {
        let pairs = self.quantity.markers().zip(point);
        let pairs: Vec<String> =
            pairs.map(|(m, x)| format!("{} = {}", m.symbol(), round(*x))).collect();
        pairs.join(", ")
    }

    /// Calls `see` with every point of a grid and the value there.
    fn each(&self, axes: &[Vec<f64>], mut see: impl FnMut(&[f64], f64)) {
        let points = grid(axes);
        let columns: Vec<Vec<f64>> =
            (0..axes.len()).map(|m| points.iter().map(|point| point[m]).collect()).collect();
        let columns: Vec<&[f64]> = columns.iter().map(|column| &column[..]).collect();
        let mut values = vec![0.0; points.len()];
        self.quantity.evaluate(&columns, &mut values);
        points.iter().zip(values).for_each(|(point, value)| see(point, value));
    }

    fn test_vectors(&self, seen: &mut Vec<Seen>) {
        let vectors = &self.quantity.file.test_vectors;
        if vectors.is_empty() {
            let what = "there are no test vectors".into();
            seen.push(self.seen("test_vectors", None, f64::INFINITY, what));
        }
        let mut worst: Option<(f64, usize, f64)> = None;
        let mut missed = 0;
        for (i, vector) in vectors.iter().enumerate() {
            let found = self.quantity.at(&self.quantity.point(vector));
            let off = (found - vector.expected).abs() / vector.expected.abs().max(1.0);
            if off.is_nan() || off > GIVEN {
                missed += 1;
                if worst.is_none_or(|(other, ..)| off.is_nan() || off > other) {
                    worst = Some((off, i, found));
                }
            }
        }
        if let Some((off, i, found)) = worst {
            let vector = &vectors[i];
            let point = self.say(&self.quantity.point(vector));
            let count = vectors.len();
            let what = format!(
                "{missed} of {count} missed, worst {point}: {found}, not {}",
                vector.expected
            );
            seen.push(self.seen("test_vectors", None, off, what));
        }
    }

    fn finite(&self, seen: &mut Vec<Seen>) {
        let mut bad: Option<(Vec<f64>, f64)> = None;
        let mut count = 0;
        self.each(&self.everywhere, |point, value| {
            if !value.is_finite() {
                count += 1;
                let inside = self.quantity.is_inside(point);
                let replace =
                    bad.as_ref().is_none_or(|(b, _)| inside && !self.quantity.is_inside(b));
                if replace {
                    bad = Some((point.to_vec(), value));
                }
            }
        });
        if let Some((point, value)) = bad {
            let where_ = if self.quantity.is_inside(&point) { "inside" } else { "outside" };
            let what = format!(
                "{value} at {}, {where_} the ranges, and at {} more points",
                self.say(&point),
                count - 1
            );
            seen.push(self.seen("finite", None, f64::INFINITY, what));
        }
    }

    fn bounds(&self, seen: &mut Vec<Seen>) {
        // A correction leaves some drag, and a stress is not negative.
        let high = if self.is_drag() { 1.0 } else { f64::INFINITY };
        for (axes, where_) in [(&self.inside, "inside"), (&self.everywhere, "outside")] {
            let mut worst: Option<(f64, Vec<f64>, f64)> = None;
            self.each(axes, |point, value| {
                let over = if value >= high { value - high + f64::MIN_POSITIVE } else { 0.0 };
                let off = over.max(-value);
                if value.is_finite() && off > 0.0 && worst.as_ref().is_none_or(|w| off > w.0) {
                    worst = Some((off, point.to_vec(), value));
                }
            });
            if let Some((off, point, value)) = worst {
                let needed = if high == 1.0 { "0 <= H < 1" } else { "a value >= 0" };
                let what = format!(
                    "{} at {}, {where_} the ranges, where {needed} is needed",
                    round(value),
                    self.say(&point)
                );
                seen.push(self.seen("bounds", None, off, what));
                return;
            }
        }
    }

    fn limits(&self, seen: &mut Vec<Seen>) {
        if !self.is_drag() {
            return;
        }
        let mut ends = Vec::new();
        if self.place(Marker::SolidsFraction).is_some() {
            ends.push((Marker::SolidsFraction, 0.0, "without particles"));
            let packing = self.closure.file.system.map_or(0.65, |system| system.max_packing);
            ends.push((Marker::SolidsFraction, packing, "at close packing"));
            ends.push((Marker::SolidsFraction, 0.95, "above close packing"));
        }
        if self.place(Marker::FilterWidth).is_some() {
            ends.push((Marker::FilterWidth, 1e-6, "without a filter"));
        }
        for (marker, end, words) in ends {
            let place = self.place(marker).expect("only markers that are there");
            let mut axes = self.inside.clone();
            axes[place] = vec![end];
            let mut worst = (0.0, Vec::new());
            self.each(&axes, |point, value| {
                if value.abs() > worst.0 {
                    worst = (value.abs(), point.to_vec());
                }
            });
            if worst.0 > 0.02 {
                let what = format!(
                    "does not vanish {words}: {} at {}",
                    round(worst.0),
                    self.say(&worst.1)
                );
                seen.push(self.seen("limits", Some(end), worst.0, what));
            }
        }
    }

    fn monotone(&self, seen: &mut Vec<Seen>) {
        let Some(place) = self.place(Marker::FilterWidth) else { return };
        let mut axes = self.inside.clone();
        let (low, high) =
            (self.quantity.file.ranges[place].low, self.quantity.file.ranges[place].high);
        let low = low.max(1e-3 * high);
        let step = (high / low).ln() / 100.0;
        axes[place] = (0..=100).map(|i| low * (step * f64::from(i)).exp()).collect();
        // The filter width runs fastest, so that neighbours are neighbours.
        let last = axes.remove(place);
        let mut worst: Option<(f64, Vec<f64>, f64)> = None;
        for others in grid(&axes) {
            let mut highest = (f64::NEG_INFINITY, 0.0);
            for width in &last {
                let mut point = others.clone();
                point.insert(place, *width);
                let value = self.quantity.at(&point);
                if value > highest.0 {
                    highest = (value, *width);
                }
                let fall = highest.0 - value;
                let share = fall / self.largest;
                if share > 1e-9 && worst.as_ref().is_none_or(|w| share > w.0) {
                    worst = Some((share, point, highest.1));
                }
            }
        }
        if let Some((share, point, from)) = worst {
            let what = format!(
                "falls with the filter width, by {:.2} % of its largest value from D = {} to {}",
                100.0 * share,
                round(from),
                self.say(&point)
            );
            seen.push(self.seen("monotone", None, share, what));
        }
    }

    /// Jumps where a piecewise formula switches, and divisors that change sign.
    fn switches(&self, seen: &mut Vec<Seen>) {
        let mut trees: Vec<&Expression> = vec![&self.quantity.formula];
        let mut i = 0;
        while i < trees.len() {
            let formulae =
                trees[i].names().into_iter().filter_map(|name| self.closure.formula(name));
            let new: Vec<&Expression> =
                formulae.filter(|f| !trees.iter().any(|known| std::ptr::eq(*known, *f))).collect();
            for formula in new {
                if !trees.iter().any(|known| std::ptr::eq(*known, formula)) {
                    trees.push(formula);
                }
            }
            i += 1;
        }
        let mut differences = Vec::new();
        for tree in trees {
            tree.root().visit(&mut |node| match node {
                Node::Piecewise(arms, _) => {
                    for (condition, _) in arms {
                        let difference = Node::Binary(
                            Operator::Subtract,
                            Box::new(condition.left.clone()),
                            Box::new(condition.right.clone()),
                        );
                        differences.push((difference, Some(condition.comparison)));
                    }
                }
                Node::Binary(Operator::Divide, _, divisor) => {
                    differences.push((divisor.as_ref().clone(), None));
                }
                _ => {}
            });
        }
        let mut found: Vec<Crossing> = Vec::new();
        for (difference, comparison) in differences {
            let formula = Expression::of(difference);
            let Ok(program) = self.closure.program(&formula, self.quantity) else { continue };
            self.crossings(&program, comparison, &mut found);
        }
        // The worst of those at one place is enough.
        found.sort_by(|a, b| b.size.total_cmp(&a.size));
        let mut told: Vec<Crossing> = Vec::new();
        for crossing in found {
            let same = |other: &Crossing| {
                other.marker == crossing.marker
                    && other.singular == crossing.singular
                    && (other.at - crossing.at).abs() <= 1e-6 * crossing.at.abs()
            };
            let limit = if crossing.singular { SMALL } else { ROUNDING };
            if crossing.size <= limit || told.iter().any(same) || told.len() >= MOST_PLACES {
                continue;
            }
            told.push(crossing);
        }
        told.sort_by(|a, b| (a.marker, a.at).partial_cmp(&(b.marker, b.at)).expect("finite"));
        for crossing in told {
            let Crossing { marker, at, point, before, after, size, singular } = crossing;
            let classes = if marker == Marker::FilterWidth { " (filter-size classes)" } else { "" };
            let (check, words) = match singular {
                true => ("singularity", "a divisor vanishes at"),
                false => ("continuity", "jumps at"),
            };
            let what = format!(
                "{words} {} = {}{classes}: from {} to {} ({:.1} %), at {}",
                marker.symbol(),
                round(at),
                round(before),
                round(after),
                100.0 * size,
                self.say(&point)
            );
            seen.push(self.seen(check, Some(at), size, what));
        }
    }

    /// Adds where `difference` changes its sign along a marker, and what the quantity does there.
    fn crossings(
        &self,
        difference: &Program,
        comparison: Option<Comparison>,
        found: &mut Vec<Crossing>,
    ) {
        for (place, marker) in self.quantity.markers().enumerate() {
            // Sparse along the others, dense along this one.
            let mut axes: Vec<Vec<f64>> = self
                .inside
                .iter()
                .map(|values| [1, 2, 3, 5, 8, 12, 16, 21, 26].map(|i| values[i]).to_vec())
                .collect();
            axes[place] = vec![0.0];
            let line = self.dense(place);
            for base in grid(&axes) {
                let at = |x: f64| {
                    let mut point = base.clone();
                    point[place] = x;
                    point
                };
                let mut last: Option<(f64, f64)> = None;
                for x in &line {
                    let value = difference.at(&at(*x));
                    if value.is_nan() {
                        last = None;
                        continue;
                    }
                    let side = value > 0.0;
                    if let Some((before, other)) = last
                        && side != (other > 0.0)
                    {
                        let (a, b) = bisect(before, *x, |x| difference.at(&at(x)) > 0.0);
                        self.jump(place, marker, a, b, &at, comparison.is_none(), found);
                    }
                    last = Some((*x, value));
                }
            }
        }
    }

    /// What the quantity does between two neighbouring values of a marker.
    #[allow(clippy::too_many_arguments)]
    fn jump(
        &self,
        place: usize,
        marker: Marker,
        a: f64,
        b: f64,
        at: &dyn Fn(f64) -> Vec<f64>,
        singular: bool,
        found: &mut Vec<Crossing>,
    ) {
        let point = at(b);
        if !self.quantity.is_inside(&point) && self.quantity.file.ranges[place].high < b {
            return;
        }
        // A switch may leave its own point to a side; a divisor is looked at from further away.
        let step = if singular { 1e-6 } else { 1e-12 } * b.abs().max(1e-12);
        let (before, after) = (self.quantity.at(&at(a - step)), self.quantity.at(&at(b + step)));
        if !(before.is_finite() && after.is_finite()) {
            return;
        }
        let scale = before.abs().max(after.abs()).max(SMALL * self.largest);
        let size = (after - before).abs() / scale;
        // A root that starts at its switch is steep and no jump: it shrinks with the step.
        let wide = 1e-6 * b.abs().max(1e-12);
        let wider = (self.quantity.at(&at(b + wide)) - self.quantity.at(&at(a - wide))).abs();
        let shrinks = !singular && (after - before).abs() < 0.3 * wider;
        if size > 0.0 && !shrinks {
            found.push(Crossing { marker, at: b, point, before, after, size, singular });
        }
    }

    /// Many values of a marker inside its range, denser near zero.
    fn dense(&self, place: usize) -> Vec<f64> {
        let range = &self.quantity.file.ranges[place];
        let span = range.high - range.low;
        let mut line: Vec<f64> =
            (0..=160).map(|i| range.low + span * (f64::from(i) / 160.0).powi(2)).collect();
        line.push(range.high * (1.0 + 1e-9));
        line
    }

    fn exponents(&self, seen: &mut Vec<Seen>) {
        // x^0 is 1 whatever x is: what an integer division of exponents leaves.
        let mut zero = Vec::new();
        let mut look = |name: &str, formula: &Expression| {
            formula.root().visit(&mut |node| {
                if let Node::Binary(Operator::Power, _, exponent) = node {
                    let exponent = Expression::of(exponent.as_ref().clone());
                    let value = match exponent.names().is_empty() {
                        true => self.closure.program(&exponent, self.quantity),
                        false => return,
                    };
                    if value.is_ok_and(|value| value.at(&vec![1.0; self.inside.len()]) == 0.0) {
                        zero.push(name.to_owned());
                    }
                }
            });
        };
        look(self.name(), &self.quantity.formula);
        for name in self.quantity.formula.names() {
            if let Some(formula) = self.closure.formula(name) {
                look(name, formula);
            }
        }
        for name in zero {
            let what = format!(
                "`{name}` has a power with the exponent 0, which has no effect: an integer division?"
            );
            seen.push(self.seen("exponents", None, f64::INFINITY, what));
        }
        for (marker, text) in &self.quantity.file.exponents {
            let stated = Expression::parse(text)
                .and_then(|formula| self.closure.program(&formula, self.quantity))
                .map(|program| program.at(&vec![1.0; self.inside.len()]));
            let Some(place) = self.place(*marker) else {
                let what = format!("an exponent of {marker} is stated, which is no marker here");
                seen.push(self.seen("exponents", None, f64::INFINITY, what));
                continue;
            };
            let middle: Vec<f64> = self.inside.iter().map(|values| values[12]).collect();
            let mut more = middle.clone();
            more[place] *= 1.25;
            let found = (self.quantity.at(&more) / self.quantity.at(&middle)).ln() / 1.25f64.ln();
            match stated {
                Ok(stated) if (found - stated).abs() < 1e-9 => {}
                Ok(stated) => {
                    let what = format!(
                        "the exponent of {marker} is {}, and {text} = {} is stated",
                        round(found),
                        round(stated)
                    );
                    seen.push(self.seen("exponents", None, (found - stated).abs(), what));
                }
                Err(why) => {
                    let what = format!("stated exponent of {marker}: {why}");
                    seen.push(self.seen("exponents", None, f64::INFINITY, what));
                }
            }
        }
    }

    fn effects(&self, seen: &mut Vec<Seen>) {
        for (place, marker) in self.quantity.markers().enumerate() {
            let mut axes: Vec<Vec<f64>> =
                self.inside.iter().map(|v| vec![v[4], v[8], v[14], v[20]]).collect();
            axes[place] = vec![0.0];
            let effect = grid(&axes).iter().any(|base| {
                let mut values = self.inside[place].iter().map(|x| {
                    let mut point = base.clone();
                    point[place] = *x;
                    self.quantity.at(&point)
                });
                let first = values.next().expect("a range has values");
                values.any(|value| value != first)
            });
            if !effect {
                let what = format!("{marker} has no effect, and is listed as a marker");
                seen.push(self.seen("effects", None, f64::INFINITY, what));
            }
        }
    }

    fn range(&self, seen: &mut Vec<Seen>) {
        for range in &self.quantity.file.ranges {
            if range.marker == Marker::SolidsFraction && range.high > 0.75 {
                let what = format!(
                    "claims solids fractions up to {}, denser than any packing",
                    range.high
                );
                seen.push(self.seen("range", None, range.high, what));
            }
            let at = |vector: &crate::closure::Vector| vector.at[&range.marker];
            let within = |x: f64| (range.low..=range.high).contains(&x);
            let vectors = &self.quantity.file.test_vectors;
            let inside = vectors.iter().map(at).filter(|x| within(*x));
            let (low, high) =
                inside.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
            let share = (high - low) / (range.high - range.low);
            if !vectors.is_empty() && (share.is_nan() || share < 0.1) {
                let what = format!(
                    "claims {} from {} to {}, and the test vectors cover less than a tenth of it",
                    range.marker, range.low, range.high
                );
                seen.push(self.seen("range", None, 1.0, what));
            }
        }
    }
}

/// More places than this in one quantity are not told one by one.
const MOST_PLACES: usize = 12;

/// Where a formula switches or a divisor vanishes, and what the quantity does there.
struct Crossing {
    marker: Marker,
    at: f64,
    point: Vec<f64>,
    before: f64,
    after: f64,
    size: f64,
    singular: bool,
}

/// Neighbouring numbers between `a` and `b` at which `side` changes.
fn bisect(mut a: f64, mut b: f64, side: impl Fn(f64) -> bool) -> (f64, f64) {
    let first = side(a);
    for _ in 0..200 {
        let middle = 0.5 * (a + b);
        if middle <= a || middle >= b {
            break;
        }
        if side(middle) == first { a = middle } else { b = middle }
    }
    (a, b)
}

/// All points of a grid, the last axis fastest.
fn grid(axes: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let mut points = vec![Vec::new()];
    for axis in axes {
        points = points
            .iter()
            .flat_map(|point: &Vec<f64>| {
                axis.iter().map(move |x| point.iter().copied().chain([*x]).collect())
            })
            .collect();
    }
    points
}

/// Four digits, for the reader.
fn round(x: f64) -> String {
    let size = x.abs();
    if size == 0.0 || (1e-3..1e5).contains(&size) {
        let digits = if size >= 1.0 { 3 - size.log10().floor().min(3.0) as usize } else { 4 };
        let text = format!("{x:.digits$}");
        let trimmed = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.')
        } else {
            &text
        };
        return trimmed.to_owned();
    }
    format!("{x:.3e}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::closure::BUILT_IN;
    use std::path::Path;

    /// Bar 2, first half.
    #[test]
    fn what_is_shipped_is_clean_or_says_what_is_wrong() {
        for (name, _) in BUILT_IN {
            let report = check(&Closure::find(name).unwrap());
            assert_eq!(report.faults(), 0, "{report}");
        }
    }

    fn text(name: &str) -> &'static str {
        BUILT_IN.iter().find(|(known, _)| *known == name).unwrap().1
    }

    /// A shipped closure with one thing changed, and test vectors that agree with the change: whoever
    /// made the mistake made them with it.
    fn planted(name: &str, from: &str, to: &str) -> Report {
        let good = text(name);
        assert!(good.contains(from), "{name} has no {from}");
        let path = Path::new("planted.toml");
        let mut closure = Closure::parse(&good.replace(from, to), path).unwrap();
        for i in 0..closure.quantities.len() {
            let quantity = closure.quantities[i].clone();
            for vector in &mut closure.file.quantities[i].test_vectors {
                let found = quantity.at(&quantity.point(vector));
                vector.expected = if found.is_finite() { found } else { 0.0 };
            }
        }
        check(&Closure::parse(&toml::to_string(&closure.file).unwrap(), path).unwrap())
    }

    fn found(report: &Report, check: &str, words: &str) {
        let fault = |finding: &&Finding| finding.verdict == Verdict::Fault;
        let faults: Vec<&Finding> = report.findings.iter().filter(fault).collect();
        let hit = faults.iter().any(|f| f.check == check && f.what.contains(words));
        assert!(hit, "no fault `{check}` with \"{words}\" in\n{report}");
    }

    /// Bar 2, second half: faults known from public codes, none of them named to the linter.
    #[test]
    fn planted_faults_are_found() {
        let (flat, deep) = ("igci-sundaresan-2011-2d", "igci-sundaresan-2011-3d");
        // Wrong coefficients, as printed in a public code.
        for name in [flat, deep] {
            found(
                &planted(name, "phi^-0.455", "phi^-0.445"),
                "continuity",
                "jumps at phi = 0.0012",
            );
            found(&planted(name, "-1501", "-1051"), "continuity", "jumps at phi = 0.455");
        }
        found(&planted(deep, "0.00615", "0.00515"), "continuity", "jumps at phi = 0.29");
        let radl = "radl-sundaresan-2014";
        found(&planted(radl, "0.887 +", "0.787 +"), "continuity", "jumps at phi = 0.18");
        // Classes of the filter size.
        let classes = "piecewise(D < 2, 0.4, D < 4, 0.55, D < 8, 0.7, 0.8)";
        let report = planted(flat, "D^1.3/(D^1.3 + 1.5)", classes);
        for edge in ["2", "4", "8"] {
            let words = format!("jumps at D = {edge} (filter-size classes)");
            found(&report, "continuity", &words);
        }
        found(&report, "limits", "does not vanish without a filter");
        // No end near packing.
        let report = planted(
            flat,
            "  phi <= 0.59, (phi - 0.59)*(-1501*phi^3 + 2203*phi^2 - 1054*phi + 162),\n  0)",
            "  (phi - 0.59)*(-1501*phi^3 + 2203*phi^2 - 1054*phi + 162))",
        );
        found(&report, "bounds", "outside the ranges");
        found(&report, "limits", "above close packing");
        found(&planted(radl, "max(0, h/(a/D + 1))", "h/(a/D + 1)"), "bounds", "-");
        let sarkar = planted("sarkar-2016", "/(1 + exp(100*(phi - 0.55)))", "");
        found(&sarkar, "limits", "at close packing");
        // Exponents that an integer division leaves.
        let milioli = "milioli-2013";
        found(&planted(milioli, "D^(2/7)", "D^0"), "exponents", "exponent 0");
        found(&planted(milioli, "D^(2/7)", "D^(0/7)"), "exponents", "exponent 0");
        found(&planted(milioli, "D^(2/7)*", ""), "exponents", "16/7 = 2.286 is stated");
        let stress = "sarkar-2016-stress";
        found(&planted(stress, "*D^(12/7)", "*D^1"), "exponents", "12/7 = 1.714 is stated");
        found(&planted(flat, "f*h", "f*h*D^(1/2 - 0.5)"), "exponents", "exponent 0");
        found(
            &planted(flat, "0.0003013470253420511", "0.004864947967296991"),
            "system",
            "length_ii",
        );
        // Stokes' terminal velocity, with lengths that agree with it.
        let scales = "terminal_velocity = 0.21846084216441053\nfroude = 64.86597289729323\n\
                      length_i = 0.004864947967296991\nlength_ii = 0.0003013470253420511";
        let stokes = "terminal_velocity = 0.2552\nfroude = 88.52\n\
                      length_i = 0.006639\nlength_ii = 0.0003343";
        let report = planted(flat, scales, stokes);
        found(&report, "system", "0.2552 m/s (it is Stokes' value)");
    }

    #[test]
    fn other_faults_are_found_too() {
        let flat = "igci-sundaresan-2011-2d";
        let sign = planted("schneiderbauer-pirker-2014", "D^2.664 + 25.89", "D^2.664 - 25.89");
        found(&sign, "singularity", "a divisor vanishes at D = 3.39");
        found(&planted(flat, "D^1.3/(D^1.3 + 1.5)", "1/(D^1.3 + 1.5)"), "monotone", "falls");
        found(&planted(flat, "\"f*h\"", "\"h\""), "effects", "filter_width has no effect");
        found(&planted(flat, "\"f*h\"", "\"1.3*f*h\""), "bounds", "inside the ranges");
        found(&planted(flat, "high = 0.59", "high = 0.9"), "range", "denser than any packing");
        found(&planted(flat, "\"f*h\"", "\"f*h*sqrt(10 - D)\""), "finite", "inside the ranges");
        // A listed flaw that is gone, or has grown, is told.
        let gone = planted("radl-sundaresan-2014", "phi < 0.016, 21.51,\n", "");
        found(&gone, "known_flaws", "that is not there");
        let grown = planted("cloete-2018", "W^-0.005543", "W^-0.5");
        found(&grown, "monotone", "falls");
        // Test vectors that do not agree.
        let wrong = text(flat).replacen("f*h", "1.000000001*f*h", 1);
        let report = check(&Closure::parse(&wrong, Path::new("wrong.toml")).unwrap());
        found(&report, "test_vectors", "missed");
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.0, 1.028, 12.336, 0.0012, 3.389, 21.51].map(round).join(" "),
            "0 1.028 12.34 0.0012 3.389 21.51"
        );
        assert_eq!(
            [1.5e-5, 6740.0, -0.25, 1e9].map(round).join(" "),
            "1.500e-5 6740 -0.25 1.000e9"
        );
    }
}
