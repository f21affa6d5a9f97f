-- Tenants, keys, records; what lists need without loading shards.

ALTER TABLE jobs ADD COLUMN tenant TEXT NOT NULL DEFAULT 'local';
ALTER TABLE jobs ADD COLUMN priority INTEGER NOT NULL DEFAULT 5 CHECK (priority BETWEEN 0 AND 9);
ALTER TABLE jobs ADD COLUMN shard_count INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN cones INTEGER;
UPDATE jobs SET shard_count = (SELECT count(*) FROM shards WHERE shards.job = jobs.id);
CREATE INDEX jobs_by_state ON jobs (state);
CREATE INDEX jobs_by_tenant ON jobs (tenant, number);

ALTER TABLE artifacts ADD COLUMN previous TEXT;
CREATE INDEX artifacts_by_digest ON artifacts (digest);
CREATE INDEX chunks_by_digest ON chunks (digest);

UPDATE requests SET id = 'local/' || id;

-- The secret itself is nowhere: its SHA-256 is.
CREATE TABLE api_keys (
    id TEXT PRIMARY KEY,
    tenant TEXT NOT NULL,
    roles TEXT NOT NULL,
    name TEXT NOT NULL,
    hash BLOB NOT NULL,
    created_ms INTEGER NOT NULL,
    revoked_ms INTEGER
) STRICT;

-- Who may read an uploaded blob: a digest is not a capability.
CREATE TABLE uploads (
    tenant TEXT NOT NULL,
    digest TEXT NOT NULL,
    at_ms INTEGER NOT NULL,
    PRIMARY KEY (tenant, digest)
) STRICT, WITHOUT ROWID;

CREATE INDEX uploads_by_digest ON uploads (digest);

CREATE TABLE audit (
    id INTEGER PRIMARY KEY,
    at_ms INTEGER NOT NULL,
    tenant TEXT NOT NULL,
    who TEXT NOT NULL,
    action TEXT NOT NULL,
    object TEXT NOT NULL
) STRICT;

-- The same work gave other bytes.
CREATE TABLE alarms (
    id INTEGER PRIMARY KEY,
    at_ms INTEGER NOT NULL,
    work TEXT NOT NULL,
    first TEXT NOT NULL,
    second TEXT NOT NULL
) STRICT;
