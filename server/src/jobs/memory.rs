//! Rows in memory, for tests: the same steps without a database.

use std::collections::BTreeMap;

use futures::FutureExt as _;
use futures::future::BoxFuture;

use super::command::{Command, Reply};
use super::state::State;
use super::step::step;
use super::store::{Documents, JobStore, StoreError};

/// Keeps nothing beyond the process.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: State,
    documents: BTreeMap<String, String>,
}

impl MemoryStore {
    /// A store that begins with a state.
    pub fn of(state: State) -> Self {
        Self { state, documents: BTreeMap::new() }
    }
}

impl JobStore for MemoryStore {
    fn execute(&mut self, command: Command, now_ms: u64) -> BoxFuture<'_, Result<Reply, StoreError>> {
        let effects = step(&mut self.state, command, now_ms);
        self.documents.extend(effects.documents);
        async move { Ok(effects.reply) }.boxed()
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn documents(&self) -> Documents {
        Documents::Memory(self.documents.clone())
    }
}
