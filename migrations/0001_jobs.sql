-- Jobs, their shards and results, artifacts shared by all jobs, request ids, texts.

CREATE TABLE jobs (
    id TEXT PRIMARY KEY,
    number INTEGER NOT NULL UNIQUE,
    state INTEGER NOT NULL CHECK (state BETWEEN 0 AND 4),
    experiment_digest TEXT NOT NULL,
    created_ms INTEGER NOT NULL,
    finished_ms INTEGER,
    frames INTEGER NOT NULL,
    artifacts TEXT NOT NULL,
    tiles TEXT NOT NULL,
    error TEXT,
    result_digest TEXT,
    version INTEGER NOT NULL,
    pass_us INTEGER NOT NULL,
    shard_us INTEGER NOT NULL
) STRICT;

CREATE TABLE shards (
    job TEXT NOT NULL REFERENCES jobs (id),
    number INTEGER NOT NULL,
    first_frame INTEGER NOT NULL,
    frame_count INTEGER NOT NULL,
    tile INTEGER NOT NULL,
    phase INTEGER NOT NULL CHECK (phase BETWEEN 0 AND 4),
    fence INTEGER NOT NULL,
    worker TEXT NOT NULL,
    local INTEGER NOT NULL,
    failures INTEGER NOT NULL,
    losses INTEGER NOT NULL,
    PRIMARY KEY (job, number)
) STRICT, WITHOUT ROWID;

CREATE TABLE artifacts (
    key TEXT PRIMARY KEY,
    kind TEXT NOT NULL,
    inputs TEXT NOT NULL,
    digest TEXT,
    cones INTEGER,
    predicted_us INTEGER NOT NULL,
    phase INTEGER NOT NULL CHECK (phase BETWEEN 0 AND 4),
    fence INTEGER NOT NULL,
    worker TEXT NOT NULL,
    local INTEGER NOT NULL,
    failures INTEGER NOT NULL,
    losses INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE chunks (
    job TEXT NOT NULL REFERENCES jobs (id),
    frame INTEGER NOT NULL,
    tile INTEGER NOT NULL,
    seq INTEGER NOT NULL,
    digest TEXT NOT NULL,
    first_cone INTEGER NOT NULL,
    cones INTEGER NOT NULL,
    summary TEXT NOT NULL,
    PRIMARY KEY (job, frame, tile),
    UNIQUE (job, seq)
) STRICT, WITHOUT ROWID;

CREATE TABLE requests (
    id TEXT PRIMARY KEY,
    job TEXT NOT NULL REFERENCES jobs (id),
    body TEXT NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TABLE documents (
    id TEXT PRIMARY KEY,
    text TEXT NOT NULL
) STRICT, WITHOUT ROWID;
