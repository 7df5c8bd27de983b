//! The page itself.

use super::charts::{self, Drawing, drawings};
use super::dependence::{self, Group, costs, groups};
use super::folder::{Folder, Measured};
use crate::compare::Comparison;
use crate::figure::digits;
use crate::summary::interval;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Most boxes whose slip over time is drawn for each run when there are several runs.
const FEW: usize = 4;

/// Runs from which on each is folded away.
const MANY: usize = 3;

/// Most runs that are shown in full on one page.
const MOST_IN_FULL: usize = 8;

/// One page of one or several runs; `command` is what makes it again.
pub fn page(folders: &[Folder], command: &str) -> String {
    let names: Vec<&str> = folders.iter().map(|folder| &*folder.name).collect();
    let title = match names.as_slice() {
        [name] => format!("Favre: {name}"),
        names => format!("Favre: {} runs", names.len()),
    };
    let policy = include_str!("policy.txt");
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta http-equiv="Content-Security-Policy" content=(policy);
                title { (title) }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p.quiet {
                        "Closures for coarse-grid simulations of gas-particle flow, with 95 % intervals. \
                         Point at or touch a point for its numbers."
                    }
                }
                main {
                    @match folders {
                        [folder] => (run(folder, 0, false)),
                        folders => (several(folders)),
                    }
                }
                footer {
                    h2 { "This page" }
                    p { "Made by favre " (env!("CARGO_PKG_VERSION")) " with " code { (command) } "." }
                }
                div #tip hidden {}
                script { (PreEscaped(include_str!("script.js"))) }
            }
        }
    }
    .into_string()
}

/// The runs side by side, then each.
fn several(folders: &[Folder]) -> Markup {
    html! {
        h2 #runs { "The runs" }
        (table("The runs", &["run", "d [µm]", "ρ_s [kg/m³]", "Fr_p", "⟨φ⟩", "slip/u_t"], html! {
                    @for (i, folder) in folders.iter().enumerate() {
                        tr {
                            th scope="row" { a href=(format!("#run-{i}")) { (folder.name) } }
                            td { (number(folder.facts.number("powder", "diameter").map(|d| 1e6 * d))) }
                            td { (number(folder.facts.number("powder", "density"))) }
                            td { (number(folder.facts.scales.map(|scales| scales.froude))) }
                            td { (joined(folder, |b| Some(digits(b.solids_fraction)))) }
                            td { (joined(folder, |b| Some(measured(b.slip)))) }
                        }
                    }
                }))
        @for one in charts::side_by_side(folders) { (drawing(&one, 0)) }
        (dependence(&groups(folders)))
        @if folders.len() > MOST_IN_FULL {
            p {
                "Of so many runs this page has the numbers; the figures of one are on its own page, by "
                code { "favre report DIR" } "."
            }
        }
        @for (i, folder) in folders.iter().enumerate() {
            details.run #(format!("run-{i}")) open[folders.len() < MANY] {
                summary { (folder.name) }
                @if folders.len() > MOST_IN_FULL {
                    (warnings(folder))
                    (asked(folder))
                    (sure(folder))
                    (boxes(folder, &[], i + 1, true))
                } @else {
                    (run(folder, i + 1, true))
                }
            }
        }
    }
}

/// Runs of one suspension: what grid and box change, and what a number costs.
fn dependence(groups: &[Group]) -> Markup {
    let columns = [
        "run",
        "⟨φ⟩",
        "cell/L_II",
        "box/L_I",
        "slip/u_t",
        "Δ_f/L_I",
        "H at φ = ⟨φ⟩",
        "s per simulated s",
        "s for 1 % of slip",
    ];
    html! {
        @if !groups.is_empty() {
            h2 #dependence { "Grid, box and cost" }
            p {
                "Runs of one powder in one gas at one mean solids fraction. What a standard error of 1 % of the \
                 mean slip takes is told from a run's own error, which falls with the root of the time. ± is one \
                 standard error."
            }
            (table("Grid, box and cost", &columns, html! { @for row in groups.iter().flat_map(|group| &group.0) { tr {
                    th scope="row" { (row.folder.name) }
                    td { (digits(row.facts.solids_fraction)) }
                    td { (digits(row.cell / row.lengths[1])) }
                    td { (digits(row.width / row.lengths[0])) " × " (digits(row.height / row.lengths[0])) }
                    td { (measured(row.facts.slip)) }
                    @match row.correction {
                        Some([width, value, error]) => {
                            td { (digits(width / row.lengths[0])) }
                            td { (interval(value, error)) }
                        }
                        None => { td { "–" } td { "–" } }
                    }
                    td { (digits(row.rate)) }
                    td { (number(row.one_percent)) }
                } } }))
            ul { @for verdict in groups.iter().filter_map(Group::verdict) { li { (verdict) } } }
            @for one in dependence::drawings(groups) { (drawing(&one, 0)) }
        }
    }
}

/// A value of each box, side by side.
fn joined(folder: &Folder, value: impl Fn(&super::BoxFacts) -> Option<String>) -> String {
    let all: Vec<String> = folder.facts.boxes.iter().filter_map(value).collect();
    if all.is_empty() { "–".into() } else { all.join(", ") }
}

/// All of one run. Identifiers begin with `place`, so that those of several do not meet.
fn run(folder: &Folder, place: usize, among_several: bool) -> Markup {
    let id = |name: &str| format!("{name}-{place}");
    let sections = [
        ("asked", "What was asked"),
        ("answer", "The answer"),
        ("sure", "How sure"),
        ("stress", "Viscosity and pressure"),
        ("dispersion", "Dispersion"),
        ("boxes", "The boxes"),
        ("density", "Where the particles are"),
        ("fit", "Closure against bins"),
        ("cost", "What it cost"),
        ("source", "Where it comes from"),
    ];
    let all = drawings(folder);
    let show = |name: &str| {
        html! { @for one in all.iter().filter(|one| one.name == name) { (drawing(one, place)) } }
    };
    let heading = |name: &str| {
        let title = sections.iter().find(|(key, _)| *key == name).map_or("", |(_, title)| title);
        html! { h2 #(id(name)) { (title) } }
    };
    html! {
        @if !among_several {
            nav aria-label="Sections" { ul {
                @for (name, title) in sections { li { a href=(format!("#{}", id(name))) { (title) } } }
            } }
        }
        (warnings(folder))
        (heading("asked"))
        (asked(folder))
        (heading("answer"))
        (show("closure"))
        @if let Some(comparison) = charts::published(folder) {
            (published(&comparison, &all, place))
        }
        (heading("sure"))
        (sure(folder))
        (heading("stress"))
        (show("solids_viscosity"))
        (show("solids_pressure"))
        (heading("dispersion"))
        (show("solids_dispersion"))
        (show("gas_dispersion"))
        (heading("boxes"))
        (boxes(folder, &all, place, among_several))
        (heading("density"))
        (show("samples"))
        (heading("fit"))
        (show("parity"))
        (heading("cost"))
        (cost(folder))
        (heading("source"))
        (source(folder))
    }
}

/// A table that scrolls by itself where it is wider than the page.
fn table(label: &str, columns: &[&str], rows: Markup) -> Markup {
    html! {
        div.wide tabindex="0" role="region" aria-label=(label) {
            table {
                @if !columns.is_empty() {
                    thead { tr { @for column in columns { th scope="col" { (column) } } } }
                }
                tbody { (rows) }
            }
        }
    }
}

/// What a reader must know before the numbers.
fn warnings(folder: &Folder) -> Markup {
    html! {
        @if !folder.missing.is_empty() {
            p { strong { "This run is not complete. " } "What is here is drawn; missing is:" }
            ul.warnings { @for what in &folder.missing { li { (what) } } }
        }
        @if !folder.facts.warnings.is_empty() {
            h3 { "Warnings" }
            ul.warnings { @for warning in &folder.facts.warnings { li { (warning) } } }
        }
    }
}

/// A figure with its caption and its numbers, or what it lacks.
fn drawing(one: &Drawing, place: usize) -> Markup {
    let Drawing { name, caption, chart } = one;
    if chart.is_empty() {
        return html! { p.quiet { (caption) " There is nothing to draw: the run has no such numbers." } };
    }
    let id = format!("{name}-{place}");
    let mut table = Vec::new();
    // A vector takes all that is written to it.
    let csv = chart.write_csv(&mut table).map(|()| STANDARD.encode(&table)).unwrap_or_default();
    html! {
        figure #(id) {
            div.wide tabindex="0" role="group" aria-label=(format!("Figure {name}")) {
                (PreEscaped(chart.figure().inline(&id, caption)))
            }
            figcaption {
                (caption) " "
                a.data download=(format!("{name}.csv")) href=(format!("data:text/csv;base64,{csv}")) {
                    "Numbers (CSV)"
                }
            }
        }
    }
}

fn asked(folder: &Folder) -> Markup {
    let facts = &folder.facts;
    let list = |numbers: Vec<f64>, factor: f64| {
        let texts: Vec<String> = numbers.iter().map(|x| digits(factor * x)).collect();
        if texts.is_empty() { "–".into() } else { texts.join(" × ") }
    };
    let powder = |key, factor: f64| number(facts.number("powder", key).map(|x| factor * x));
    let widths = facts.numbers("filter", "widths");
    html! {
        (table("What was asked", &[], html! {
                tr { th scope="row" { "Powder" } td.text {
                    (powder("diameter", 1e6)) " µm, " (powder("density", 1.0)) " kg/m³, restitution "
                    (powder("restitution", 1.0)) ", packed at " (powder("max_packing", 1.0))
                } }
                tr { th scope="row" { "Gas" } td.text {
                    (number(facts.number("gas", "density"))) " kg/m³, "
                    (number(facts.number("gas", "viscosity"))) " Pa s"
                } }
                @if let Some(scales) = facts.scales {
                    tr { th scope="row" { "Scales" } td.text {
                        "u_t = " (digits(scales.terminal_velocity)) " m/s, Fr_p = " (digits(scales.froude))
                        ", L_I = " (digits(1e3 * scales.length_i)) " mm, L_II = "
                        (digits(1e3 * scales.length_ii)) " mm"
                    } }
                }
                tr { th scope="row" { "Box" } td.text {
                    (list(facts.numbers("box", "size"), 1e2)) " cm, "
                    (list(facts.numbers("box", "cells"), 1.0)) " cells, mean solids fractions "
                    (list(facts.numbers("box", "solids_fraction"), 1.0).replace(" × ", ", "))
                    ", " (number(facts.number("run", "duration"))) " s each"
                } }
                tr { th scope="row" { "Filter" } td.text {
                    "widths " (list(widths, 1e2).replace(" × ", ", ")) " cm"
                } }
            }))
        @if let Some(case) = &folder.case {
            details { summary { "The case in full (case.toml)" } pre tabindex="0" { (case) } }
        }
        @if !facts.terms.is_empty() {
            details {
                summary { "What of the equations was modelled, and why" }
                ul { @for term in &facts.terms {
                    li { (term.name) ": " strong { (if term.on { "on" } else { "off" }) } ", " (term.why) }
                } }
            }
        }
    }
}

/// Closures beside each other at every filter width; how well each meets the bins.
fn published(comparison: &Comparison, all: &[Drawing], place: usize) -> Markup {
    let panels: Vec<&Drawing> =
        all.iter().filter(|one| one.name.starts_with("published_")).collect();
    // One in the middle says most; the others are a click away.
    let middle = panels.len() / 2;
    html! {
        h3 { "Beside published closures" }
        @if let Some(one) = panels.get(middle) { (drawing(one, place)) }
        @if panels.len() > 1 {
            details {
                summary { "Other filter widths" }
                @for (i, one) in panels.iter().enumerate() {
                    @if i != middle { (drawing(one, place)) }
                }
            }
        }
        (table("Scores of closures", &["closure", "R²", "RMSE", "bias", "bins inside its range"], html! { @for score in &comparison.scores { tr {
                    th scope="row" { (score.closure) }
                    td { (digits(score.r_squared)) } td { (digits(score.rmse)) }
                    td { (digits(score.bias)) } td { (score.inside) " of " (score.bins) }
                } } }))
        p.quiet {
            "Against this run's bins, weighted by 1/variance. Published closures were made for other powders, \
             grids and definitions: see " code { "favre models show" } "."
        }
    }
}

fn sure(folder: &Folder) -> Markup {
    let rows: Vec<_> = folder.bins.iter().filter(|row| row.quantity == "drag_correction").collect();
    let known: Vec<_> = rows.iter().filter(|row| row.standard_error.is_finite()).collect();
    let widths = {
        let mut widths: Vec<f64> = known.iter().map(|row| row.filter_width_l_i).collect();
        widths.sort_by(f64::total_cmp);
        widths.dedup();
        widths
    };
    let grids = known.iter().any(|row| row.grid_error.is_some());
    let mut columns =
        vec!["Δ_f/L_I", "bins", "median error of H", "largest", "median effective samples"];
    if grids {
        columns.push("median grid error");
    }
    let median = |mut all: Vec<f64>| {
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    html! {
        p {
            "Errors of bins come from blocks of time longer than the flow's memory: overlapping filter \
             positions and alike instants do not count as independent."
        }
        @if known.is_empty() {
            p.quiet { "No bin of the drag correction has a standard error." }
        } @else {
            (table("Errors of the drag correction", &columns, html! { @for width in widths {
                        @let here: Vec<_> = known.iter().filter(|r| r.filter_width_l_i == width).collect();
                        @let errors: Vec<f64> = here.iter().map(|r| r.standard_error).collect();
                        tr {
                            th scope="row" { (digits(width)) }
                            td { (here.len()) }
                            td { (number(median(errors.clone()))) }
                            td { (number(errors.iter().copied().reduce(f64::max))) }
                            td { (number(median(here.iter().map(|r| r.effective_samples).collect()))) }
                            @if grids {
                                td { (number(median(here.iter().filter_map(|r| r.grid_error).collect()))) }
                            }
                        }
                    } }))
            @if known.len() < rows.len() {
                p.quiet {
                    (rows.len() - known.len()) " further bins have too few independent samples for an error."
                }
            }
            @if !grids {
                p.quiet {
                    "One grid and one box: what they change is not in these. Run the case again with other "
                    code { "cells" } " or another " code { "size" } " in " code { "[box]" } ", and "
                    code { "favre report RUN RUN" } " has them beside each other; "
                    code { "favre filter RUN RUN" } " of runs on several grids gives the bins' grid error."
                }
            }
        }
    }
}

fn boxes(folder: &Folder, all: &[Drawing], place: usize, among_several: bool) -> Markup {
    let few = if among_several { FEW } else { usize::MAX };
    html! {
        @if !folder.facts.boxes.is_empty() {
            p.quiet { "± is one standard error." }
            (table("The boxes", &["⟨φ⟩", "slip/u_t", "uniform", "variance of φ", "statistics from [s]"], html! { @for b in &folder.facts.boxes { tr {
                        th scope="row" { (digits(b.solids_fraction)) }
                        td { (measured(b.slip)) } td { (digits(b.uniform_slip)) }
                        td { (measured(b.solids_fraction_variance)) }
                        td { (digits(b.start)) @if !b.steady { " (not steady)" } }
                    } } }))
        }
        @for one in all.iter().filter(|one| one.name.starts_with("slip_")).take(few) {
            (drawing(one, place))
        }
        @if !folder.snapshots.is_empty() && !all.is_empty() {
            div.snapshots { @for (name, png) in &folder.snapshots {
                (picture(png, &format!("Solids fraction at the end ({name})")))
            } }
        }
        @if !all.is_empty() {
            @for (name, png) in folder.films.iter().take(few) { (picture(png, &film(folder, name))) }
        }
    }
}

/// A picture and what it shows.
fn picture(png: &[u8], caption: &str) -> Markup {
    html! {
        figure {
            img src=(format!("data:image/png;base64,{}", STANDARD.encode(png))) alt=(caption);
            figcaption { (caption) }
        }
    }
}

/// What the film strip of the file `name` shows.
fn film(folder: &Folder, name: &str) -> String {
    let of = |b: &&super::BoxFacts| name == format!("film_{}.png", b.solids_fraction);
    let strip = folder.facts.boxes.iter().find(of).and_then(|b| b.film.as_ref());
    let Some(strip) = strip else {
        return format!(
            "Solids fraction on the way, and below what a filter makes of it ({name})."
        );
    };
    let times: Vec<String> = strip.times.iter().map(|time| digits(*time)).collect();
    format!(
        "Solids fraction at t = {} s, and below what a filter of {} cm makes of it ({name}).",
        times.join(", "),
        digits(100.0 * strip.filter_width)
    )
}

fn cost(folder: &Folder) -> Markup {
    let cells: f64 = folder.facts.numbers("box", "cells").iter().product();
    if folder.facts.boxes.is_empty() {
        return html! { p.quiet { "The run does not say." } };
    }
    html! {
        (table("What it cost", &["⟨φ⟩", "steps", "pressure iterations a step", "seconds", "µs per cell and step", "s per simulated s", "error of slip [%]", "s for 1 %"], html! { @for row in costs(folder) {
                    @let b = row.facts;
                    @let steps = b.cost.steps as f64;
                    tr {
                        th scope="row" { (digits(b.solids_fraction)) } td { (b.cost.steps) }
                        td { (digits(b.cost.pressure_iterations as f64 / steps)) }
                        td { (digits(b.cost.seconds)) }
                        td { (digits(1e6 * b.cost.seconds / (steps * cells))) }
                        td { (digits(row.rate)) }
                        td { (number(b.slip.mean.zip(b.slip.standard_error).map(|(mean, e)| 100.0 * e / mean))) }
                        td { (number(row.one_percent)) }
                    }
                } }))
        @if let Some(machine) = &folder.facts.machine {
            p {
                (digits(machine.seconds)) " s on " (machine.threads) " threads, statistics included ("
                (machine.simd) ", " (machine.system) " " (machine.architecture) ")."
            }
        }
    }
}

fn source(folder: &Folder) -> Markup {
    let facts = &folder.facts;
    html! {
        p {
            "Folder " code { (folder.path.display()) }
            @if let Some(version) = &facts.version { ", favre " (version) }
            @if let Some(seed) = facts.number("run", "seed") { ", seed " (seed) }
            @if folder.case.is_some() {
                ". Again with " code { "favre run " (folder.path.join("case.toml").display()) }
                "; the same case and seed give the same bytes."
            }
        }
        @if let Some(model) = &folder.model {
            @let file = &model.file;
            h3 { "The closure" }
            p { (file.title) ", from " (file.source.reference) "." }
            @if let Some(fit) = &file.fit {
                p { code { (fit.formula) } }
                (table("Coefficients", &["coefficient", "value", "95 % interval"], html! { @for c in &fit.coefficients { tr {
                            th scope="row" { (c.symbol) } td { (digits(c.value)) }
                            td { (digits(c.low_95)) " to " (digits(c.high_95)) }
                        } } }))
            }
            @if !file.notes.is_empty() { ul { @for note in &file.notes { li { (note) } } } }
        }
    }
}

fn number(x: Option<f64>) -> String {
    x.map_or("–".into(), digits)
}

/// A mean with its standard error.
fn measured(value: Measured) -> String {
    match (value.mean, value.standard_error) {
        (Some(mean), error) => interval(mean, error.unwrap_or(f64::INFINITY)),
        _ => "–".into(),
    }
}
