//! API keys: `pe_<id>_<256 random bits>`, shown once, kept as SHA-256.

use std::fmt::Write as _;
use std::path::Path;
use std::time::SystemTime;

use ring::digest::{SHA256, digest};
use ring::rand::{SecureRandom as _, SystemRandom};
use sqlx::Row as _;
use sqlx::sqlite::SqliteRow;

use crate::jobs::sqlite::connect;
use crate::jobs::store::StoreError;

/// What a key's holder may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// Look at jobs and results of their tenant.
    Read,
    /// Submit and cancel jobs of their tenant, upload pictures.
    Submit,
    /// Everything, for every tenant.
    Admin,
    /// Lease, heartbeat, commit, move blobs; nothing else.
    Worker,
}

impl Role {
    /// All.
    pub const ALL: [Self; 4] = [Self::Read, Self::Submit, Self::Admin, Self::Worker];

    /// Its word.
    pub fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Submit => "submit",
            Self::Admin => "admin",
            Self::Worker => "worker",
        }
    }
}

impl std::str::FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|role| role.name() == text);
        found.ok_or_else(|| format!("role: `{text}` is not one of read, submit, admin, worker"))
    }
}

/// A key as it is kept.
#[derive(Clone, Debug)]
pub struct Stored {
    /// Its public part.
    pub id: String,
    /// Whose jobs its holder sees.
    pub tenant: String,
    /// What its holder may do.
    pub roles: Vec<Role>,
    /// What it is for, for people.
    pub name: String,
    /// SHA-256 of the whole key.
    pub hash: Vec<u8>,
    /// Made, ms since 1970.
    pub created_ms: u64,
    /// Revoked, ms since 1970.
    pub revoked_ms: Option<u64>,
}

/// Why keys cannot be made or changed.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// Wrong use.
    #[error("{0}")]
    Wrong(String),
    /// The database refuses.
    #[error(transparent)]
    Store(#[from] StoreError),
}

impl From<sqlx::Error> for KeyError {
    fn from(error: sqlx::Error) -> Self {
        Self::Store(error.into())
    }
}

/// Makes a key in a server's data folder; works while the server runs. The answer is the only time that the key is seen.
///
/// # Errors
/// When the tenant's name is wrong, no role is given, or the database cannot be written.
pub async fn create(
    data: &Path,
    tenant: &str,
    roles: &[Role],
    name: &str,
) -> Result<(String, String), KeyError> {
    let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    if tenant.is_empty() || tenant.len() > 40 || !tenant.chars().all(plain) {
        let message = format!("tenant: `{tenant}` is not 1 to 40 of a-z, 0-9 and -");
        return Err(KeyError::Wrong(message));
    }
    if roles.is_empty() {
        return Err(KeyError::Wrong("role: give at least one of read, submit, admin, worker".into()));
    }
    let mut secret = [0; 36];
    let random = SystemRandom::new().fill(&mut secret);
    random.map_err(|_| KeyError::Wrong("the system has no random numbers".into()))?;
    let (id, key) = (hex(&secret[..4]), format!("pe_{}_{}", hex(&secret[..4]), hex(&secret[4..])));
    let words: Vec<&str> = roles.iter().map(|role| role.name()).collect();
    let mut db = connect(&data.join("photoneye.db")).await?;
    sqlx::query("INSERT INTO api_keys (id, tenant, roles, name, hash, created_ms) VALUES (?, ?, ?, ?, ?, ?)")
        .bind(id.clone())
        .bind(tenant.to_owned())
        .bind(words.join(","))
        .bind(name.to_owned())
        .bind(digest(&SHA256, key.as_bytes()).as_ref().to_vec())
        .bind(now_ms())
        .execute(&mut db)
        .await?;
    audit(&mut db, tenant, "create key", &id).await?;
    Ok((id, key))
}

/// All keys of a data folder, oldest first.
///
/// # Errors
/// When the database cannot be read.
pub async fn list(data: &Path) -> Result<Vec<Stored>, KeyError> {
    let mut db = connect(&data.join("photoneye.db")).await?;
    let rows = sqlx::query("SELECT * FROM api_keys ORDER BY created_ms").fetch_all(&mut db).await?;
    Ok(rows.iter().map(stored).collect::<Result<_, _>>()?)
}

/// Revokes a key; a running server refuses it within a second.
///
/// # Errors
/// When there is no such key, or the database cannot be written.
pub async fn revoke(data: &Path, id: &str) -> Result<(), KeyError> {
    let mut db = connect(&data.join("photoneye.db")).await?;
    let found = sqlx::query("UPDATE api_keys SET revoked_ms = coalesce(revoked_ms, ?) WHERE id = ?")
        .bind(now_ms())
        .bind(id.to_owned())
        .execute(&mut db)
        .await?;
    if found.rows_affected() == 0 {
        return Err(KeyError::Wrong(format!("no key `{id}`; `photoneye keys list` shows them")));
    }
    Ok(audit(&mut db, "", "revoke key", id).await?)
}

async fn audit(
    db: &mut sqlx::SqliteConnection,
    tenant: &str,
    action: &str,
    id: &str,
) -> Result<(), sqlx::Error> {
    sqlx::query("INSERT INTO audit (at_ms, tenant, who, action, object) VALUES (?, ?, 'command line', ?, ?)")
        .bind(now_ms())
        .bind(tenant.to_owned())
        .bind(action.to_owned())
        .bind(id.to_owned())
        .execute(db)
        .await?;
    Ok(())
}

/// Reads a row.
pub(crate) fn stored(row: &SqliteRow) -> Result<Stored, StoreError> {
    let roles: &str = row.try_get("roles")?;
    Ok(Stored {
        id: row.try_get("id")?,
        tenant: row.try_get("tenant")?,
        roles: roles.split(',').map(str::parse).collect::<Result<_, _>>().map_err(StoreError::Row)?,
        name: row.try_get("name")?,
        hash: row.try_get("hash")?,
        created_ms: row.try_get::<i64, _>("created_ms")? as u64,
        revoked_ms: row.try_get::<Option<i64>, _>("revoked_ms")?.map(|ms| ms as u64),
    })
}

/// Id and hash of a key that somebody shows.
pub(crate) fn parse(key: &str) -> Option<(String, Vec<u8>)> {
    let (id, _) = key.strip_prefix("pe_")?.split_once('_')?;
    (key.len() < 200).then(|| (id.to_owned(), digest(&SHA256, key.as_bytes()).as_ref().to_vec()))
}

/// Whether two hashes are the same, in a time that does not depend on where they differ.
pub(crate) fn same(a: &[u8], b: &[u8]) -> bool {
    let differ = a.iter().zip(b).fold(0, |differ, (a, b)| differ | (a ^ b));
    a.len() == b.len() && std::hint::black_box(differ) == 0
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        // Writing into a string cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

fn now_ms() -> i64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_millis() as i64
}
