//! `study stability`: extreme and stiff cases. Each gives a right number or a clear refusal: no crash, no NaN, no silent nonsense.
//!
//! A case has a figure and a limit that it must stay below. A refusal counts as right only where it is the expected answer and names the
//! field. A panic is caught and counts as a failure.

mod lattice;
mod optics;
mod scenes;

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::Task;
use super::clock::Stopwatch;
use super::page::{Page, Table};
use crate::row;

/// What a case found.
pub struct Found {
    /// What the figure is.
    pub what: String,
    /// The figure.
    pub figure: f64,
    /// It must not be above this.
    pub limit: f64,
}

impl Found {
    /// A figure with its limit.
    pub fn new(what: impl Into<String>, figure: f64, limit: f64) -> Self {
        Self { what: what.into(), figure, limit }
    }

    fn passes(&self) -> bool {
        self.figure <= self.limit
    }
}

/// Collects cases.
pub struct Cases<'a> {
    task: &'a mut Task,
    table: Table,
    failed: usize,
}

impl Cases<'_> {
    /// Whether long cases are left out.
    pub fn is_quick(&self) -> bool {
        self.task.quick
    }

    /// Runs a case; an error is a failure.
    pub fn add(&mut self, group: &str, name: &str, work: impl FnOnce() -> Result<Found, String>) {
        self.task.say(&format!("{group}: {name}"));
        let watch = Stopwatch::start();
        let found = match catch_unwind(AssertUnwindSafe(work)) {
            Ok(Ok(found)) => found,
            Ok(Err(why)) => Found::new(format!("refused: {why}"), f64::NAN, 0.0),
            Err(_) => Found::new("panicked", f64::NAN, 0.0),
        };
        self.failed += usize::from(!found.passes());
        let verdict = if found.passes() { "pass" } else { "FAIL" };
        self.table.push(row![group, name, found.what, found.figure, found.limit, verdict, watch.seconds()]);
    }
}

/// Fills the page; gives how many of how many cases failed.
pub fn study(task: &mut Task, page: &mut Page) -> (usize, usize) {
    page.begin(
        "Extreme and stiff cases",
        "Each case gives a figure that must not be above its limit. Where a refusal is the right answer, the figure is 0 when the error \
         names the field.",
    );
    let table = Table::new(
        "stability",
        "Cases",
        &["group", "case", "what is measured", "figure", "limit", "verdict"],
    );
    let mut cases = Cases { task, table, failed: 0 };
    optics::cases(&mut cases);
    scenes::cases(&mut cases);
    lattice::cases(&mut cases);
    let (failed, all) = (cases.failed, cases.table.rows.len());
    page.text(&format!("{} of {all} cases pass.", all - failed));
    page.table(cases.table);
    lattice::figures(page);
    (failed, all)
}
