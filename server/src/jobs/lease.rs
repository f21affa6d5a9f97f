//! One lease logic for builds and shards: lease, heartbeat, commit, each write of a worker predicated on the fence.
//!
//! A fence is minted whenever the right to write changes hands, so whoever holds an old one can write nothing.

use serde::{Deserialize, Serialize};

/// How long a lease lasts without a heartbeat, ms.
pub const TTL_MS: u64 = 30_000;

/// Failed computations after which the work fails.
pub const MAX_FAILURES: u32 = 3;

/// Vanished workers after which the work fails.
pub const MAX_LOSSES: u32 = 20;

/// Where a piece of work stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// To be done.
    #[default]
    Open,
    /// A worker is at it.
    Leased,
    /// Done.
    Done,
    /// Given up.
    Failed,
    /// Not wanted any more.
    Cancelled,
}

impl Phase {
    /// All, in the order of their numbers in the database.
    pub const ALL: [Self; 5] = [Self::Open, Self::Leased, Self::Done, Self::Failed, Self::Cancelled];
}

/// The lease of one piece of work.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lease {
    /// Where the work stands.
    pub phase: Phase,
    /// Minted with every lease; only its holder may write.
    pub fence: u64,
    /// Who holds it.
    pub worker: String,
    /// Whether the worker lives in this process and dies with it.
    pub local: bool,
    /// When it ends without a heartbeat. Not stored: a restarted server gives every worker a whole term.
    pub expires_ms: u64,
    /// Computations that failed.
    pub failures: u32,
    /// Workers that vanished.
    pub losses: u32,
}

/// What became of work that was not finished.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It is open again.
    Again,
    /// It is given up.
    GivenUp,
}

impl Lease {
    /// Whether the holder of this fence may write.
    pub fn held(&self, fence: u64) -> bool {
        self.phase == Phase::Leased && self.fence == fence
    }

    /// Hands open work out and mints the fence. `None` when it is not open.
    pub fn take(&mut self, worker: &str, local: bool, now_ms: u64) -> Option<u64> {
        if self.phase != Phase::Open {
            return None;
        }
        self.phase = Phase::Leased;
        self.fence += 1;
        worker.clone_into(&mut self.worker);
        self.local = local;
        self.expires_ms = now_ms + TTL_MS;
        Some(self.fence)
    }

    /// Keeps the lease alive. False: it is gone.
    pub fn beat(&mut self, fence: u64, now_ms: u64) -> bool {
        let held = self.held(fence);
        if held {
            self.expires_ms = now_ms + TTL_MS;
        }
        held
    }

    /// Finishes the work. False: the lease is gone.
    pub fn commit(&mut self, fence: u64) -> bool {
        let held = self.held(fence);
        if held {
            self.phase = Phase::Done;
        }
        held
    }

    /// The computation failed. `None`: the lease is gone.
    pub fn fail(&mut self, fence: u64, deterministic: bool) -> Option<Verdict> {
        if !self.held(fence) {
            return None;
        }
        self.failures += 1;
        Some(self.open_or_give_up(deterministic || self.failures >= MAX_FAILURES))
    }

    /// The worker vanished: its time is over. `None`: it is not.
    pub fn expire(&mut self, now_ms: u64) -> Option<Verdict> {
        if self.phase != Phase::Leased || now_ms < self.expires_ms {
            return None;
        }
        self.losses += 1;
        Some(self.open_or_give_up(self.losses >= MAX_LOSSES))
    }

    /// Takes the work away from whoever has it and opens it; counts nothing.
    pub fn reopen(&mut self) {
        self.phase = Phase::Open;
        self.fence += 1;
    }

    /// Takes the work away for good, unless it is over.
    pub fn cancel(&mut self) {
        if matches!(self.phase, Phase::Open | Phase::Leased) {
            self.phase = Phase::Cancelled;
            self.fence += 1;
        }
    }

    /// Opens the work as if it were new.
    pub fn renew(&mut self) {
        self.reopen();
        self.failures = 0;
        self.losses = 0;
    }

    fn open_or_give_up(&mut self, give_up: bool) -> Verdict {
        self.fence += 1;
        if give_up {
            self.phase = Phase::Failed;
            Verdict::GivenUp
        } else {
            self.phase = Phase::Open;
            Verdict::Again
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_superseded_lease_cannot_write() {
        let mut lease = Lease::default();
        let old = lease.take("a", false, 0).unwrap();
        assert_eq!(lease.take("b", false, 0), None);
        assert_eq!(lease.expire(TTL_MS - 1), None);
        assert_eq!(lease.expire(TTL_MS), Some(Verdict::Again));
        // Between two holders nobody may write, not even the one whose name is still there.
        assert!(!lease.commit(old) && !lease.beat(old, TTL_MS));
        let new = lease.take("a", false, TTL_MS).unwrap();
        assert!(!lease.commit(old) && lease.fail(old, true).is_none());
        assert!(lease.beat(new, TTL_MS) && lease.commit(new));
        assert!(!lease.commit(new), "a commit is accepted once");
    }

    #[test]
    fn failures_and_losses_are_capped() {
        let mut lease = Lease::default();
        for attempt in 1..=MAX_FAILURES {
            let fence = lease.take("a", false, 0).unwrap();
            let given_up = attempt == MAX_FAILURES;
            assert_eq!(lease.fail(fence, false) == Some(Verdict::GivenUp), given_up);
        }
        let mut lease = Lease::default();
        let fence = lease.take("a", false, 0).unwrap();
        assert_eq!(lease.fail(fence, true), Some(Verdict::GivenUp));
        let mut lease = Lease::default();
        for loss in 1..=MAX_LOSSES {
            lease.take("a", false, 0).unwrap();
            assert_eq!(lease.expire(TTL_MS) == Some(Verdict::GivenUp), loss == MAX_LOSSES);
        }
        assert_eq!(lease.take("a", false, 0), None);
    }

    #[test]
    fn cancel_takes_the_work_away() {
        let mut lease = Lease::default();
        let fence = lease.take("a", false, 0).unwrap();
        lease.cancel();
        assert!(!lease.commit(fence));
        assert_eq!(lease.take("b", false, 0), None);
    }
}
