//! Rows in memory, for tests: the same steps without a database.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

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
    documents: Arc<Mutex<BTreeMap<String, String>>>,
}

impl MemoryStore {
    /// A store that begins with a state.
    pub fn of(state: State) -> Self {
        Self { state, documents: Arc::default() }
    }
}

impl JobStore for MemoryStore {
    fn execute_all(
        &mut self,
        commands: Vec<Command>,
        now_ms: u64,
    ) -> BoxFuture<'_, Result<Vec<Reply>, StoreError>> {
        let mut replies = Vec::with_capacity(commands.len());
        for command in commands {
            let effects = step(&mut self.state, command, now_ms);
            self.documents.lock().unwrap_or_else(PoisonError::into_inner).extend(effects.documents);
            replies.push(effects.reply);
        }
        async move { Ok(replies) }.boxed()
    }

    fn recall_job<'a>(&'a mut self, _: &'a str) -> BoxFuture<'a, Result<(), StoreError>> {
        async { Ok(()) }.boxed()
    }

    fn state(&self) -> &State {
        &self.state
    }

    fn documents(&self) -> Documents {
        Documents::Memory(Arc::clone(&self.documents))
    }
}
