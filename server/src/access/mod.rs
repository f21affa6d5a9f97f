//! Who asks, and what they may do: API keys with roles and tenants.
//!
//! As long as no key was ever made, everybody who reaches the port may do everything (it is then open to this machine only).
//! A worker in this process, over the in-memory connection, always may.

mod door;
pub mod keys;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

pub use door::{guard, is_grpc};
pub use keys::Role;

use crate::error::{Error, Kind};
use crate::jobs::store::{Documents, StoreError};
use keys::Stored;

/// The tenant of everybody when there are no keys.
pub const LOCAL_TENANT: &str = "local";

/// A key that was made or revoked counts after so long.
const REFRESH: Duration = Duration::from_secs(1);

/// Who asks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Caller {
    /// Whose jobs and uploads they are.
    pub tenant: String,
    /// Id of the key, for the audit.
    pub who: String,
    /// What they may do.
    pub roles: Vec<Role>,
}

impl Caller {
    /// Somebody on this machine while there are no keys, or a worker of this process.
    pub fn trusted() -> Self {
        Self { tenant: LOCAL_TENANT.into(), who: LOCAL_TENANT.into(), roles: Role::ALL.to_vec() }
    }

    /// Whether they may do what a role may. An administrator may do everything.
    pub fn may(&self, role: Role) -> bool {
        self.roles.contains(&role) || self.roles.contains(&Role::Admin)
    }

    /// Whether the jobs and uploads of all tenants are theirs to see.
    pub fn sees_all(&self) -> bool {
        self.roles.contains(&Role::Admin)
    }
}

/// Keys by id.
type Keys = Arc<HashMap<String, Stored>>;

/// Knows the keys.
pub struct Access {
    documents: Documents,
    known: Mutex<Option<(Instant, Keys)>>,
}

impl Access {
    /// Reads keys from the job database.
    pub fn new(documents: Documents) -> Self {
        Self { documents, known: Mutex::default() }
    }

    /// All keys, revoked ones too.
    async fn keys(&self) -> Result<Keys, StoreError> {
        {
            let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((_, keys)) = known.as_ref().filter(|(read, _)| read.elapsed() < REFRESH) {
                return Ok(Arc::clone(keys));
            }
        }
        let list = self.documents.keys().await?;
        let keys = Arc::new(list.into_iter().map(|key| (key.id.clone(), key)).collect::<HashMap<_, _>>());
        *self.known.lock().unwrap_or_else(PoisonError::into_inner) =
            Some((Instant::now(), Arc::clone(&keys)));
        Ok(keys)
    }

    /// Whether callers are asked for a key.
    ///
    /// # Errors
    /// When the keys cannot be read.
    pub async fn asks(&self) -> Result<bool, StoreError> {
        Ok(!self.keys().await?.is_empty())
    }

    /// Who shows a key, or none.
    ///
    /// # Errors
    /// When a key is needed and this is none that holds.
    pub async fn caller(&self, shown: Option<&str>) -> Result<Caller, Error> {
        let keys = self.keys().await?;
        if keys.is_empty() {
            return Ok(Caller::trusted());
        }
        let refused = |message: &str| Error::new(Kind::Unauthenticated, message);
        let shown = shown.ok_or_else(|| refused("an API key is needed: Authorization: Bearer KEY"))?;
        let wrong = || refused("this API key is not known, or was revoked");
        let (id, hash) = keys::parse(shown).ok_or_else(wrong)?;
        // Compared in the same time whether or not it is right.
        let key = keys.get(&id).filter(|key| keys::same(&key.hash, &hash) && key.revoked_ms.is_none());
        let key = key.ok_or_else(wrong)?;
        Ok(Caller { tenant: key.tenant.clone(), who: key.id.clone(), roles: key.roles.clone() })
    }
}
