//! CPU seconds of each piece of work in a process that does several at a time.
//!
//! Threads are shared, so a thread's clock says nothing. At every begin and end of a stage the CPU time of the whole process since the
//! last one is shared evenly among the stages that ran: they sum to what the process used while any ran.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::memory::cpu_seconds;

/// The stages that run.
#[derive(Debug, Default)]
pub(crate) struct Ledger(Mutex<Book>);

#[derive(Debug, Default)]
struct Book {
    last: f64,
    next: u64,
    running: BTreeMap<u64, f64>,
}

impl Book {
    fn turn(&mut self, now: f64) {
        let share = (now - self.last).max(0.0) / self.running.len().max(1) as f64;
        self.running.values_mut().for_each(|seconds| *seconds += share);
        self.last = now;
    }
}

/// A stage that runs until it is asked for its seconds, or dropped.
#[derive(Debug)]
pub(crate) struct Stage {
    ledger: Arc<Ledger>,
    number: u64,
}

impl Ledger {
    /// Begins a stage.
    pub(crate) fn begin(self: &Arc<Self>) -> Stage {
        let mut book = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        book.turn(cpu_seconds());
        let number = book.next;
        book.next += 1;
        book.running.insert(number, 0.0);
        Stage { ledger: Arc::clone(self), number }
    }
}

impl Stage {
    /// Ends it: its CPU seconds.
    pub(crate) fn end(self) -> f64 {
        self.take()
    }

    fn take(&self) -> f64 {
        let mut book = self.ledger.0.lock().unwrap_or_else(PoisonError::into_inner);
        book.turn(cpu_seconds());
        book.running.remove(&self.number).unwrap_or(0.0)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        self.take();
    }
}

#[cfg(test)]
mod tests {
    use super::Book;

    #[test]
    fn time_is_shared_by_those_that_run() {
        let mut book = Book::default();
        book.turn(1.0);
        book.running.insert(0, 0.0);
        book.turn(3.0);
        book.running.insert(1, 0.0);
        book.turn(7.0);
        assert_eq!((book.running[&0], book.running[&1]), (4.0, 2.0));
    }
}
