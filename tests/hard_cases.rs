//! Cases that break solvers, the table of `favre hard-cases --quick`: they run, stay positive, below
//! the densest packing and true to mass and momentum, and go on from any state to the same bits.

use favre::hard::{HEADER, run};

#[test]
fn hard_cases_run_and_stay_in_bounds() {
    println!("{HEADER}");
    let table = run(true, |row| println!("{row}"));
    for row in &table.rows {
        assert!(row.failures.is_empty(), "{}: {}", row.name, row.failures.join("; "));
    }
}
