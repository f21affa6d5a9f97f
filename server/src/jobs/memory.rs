//! Rows in memory, for tests: the same steps without a database.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use futures::FutureExt as _;
use futures::future::BoxFuture;

use super::command::Command;
use super::state::State;
use super::step::step;
use super::store::{Batch, Documents, JobStore, StoreError};

/// Keeps nothing beyond the process.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: State,
    documents: Arc<Mutex<BTreeMap<String, Arc<str>>>>,
}

impl MemoryStore {
    /// A store that begins with a state.
    pub fn of(state: State) -> Self {
        Self { state, documents: Arc::default() }
    }
}

impl JobStore for MemoryStore {
    fn execute_all<'a>(
        &'a mut self,
        commands: &'a [Command],
        now_ms: u64,
    ) -> BoxFuture<'a, Result<Batch, StoreError>> {
        let mut batch = Batch::default();
        for command in commands {
            let (reply, effects) = step(&mut self.state, command.clone(), now_ms);
            self.documents.lock().unwrap_or_else(PoisonError::into_inner).extend(effects.documents);
            batch.replies.push(reply);
        }
        async move { Ok(batch) }.boxed()
    }

    fn settle(&self, _: &mut State) {}

    fn state(&self) -> &State {
        &self.state
    }

    fn documents(&self) -> Documents {
        Documents::Memory(Arc::clone(&self.documents))
    }
}
