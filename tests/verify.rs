//! The quick selection of `favre verify` passes.

use favre::verify::{Effort, verify};

#[test]
fn the_simulator_solves_its_equations() {
    let report = verify(&[], Effort::Quick, |_| {}).unwrap();
    println!("{report}");
    assert!(report.pass, "\n{report}");
}

#[test]
fn a_check_that_there_is_not_is_named() {
    let error = verify(&["haff".into()], Effort::Quick, |_| {}).unwrap_err();
    assert!(error.to_string().contains("\"haff\""), "{error}");
}
