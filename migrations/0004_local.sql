-- Jobs whose makers live in the server's process and die with it; who asks for the same again finds what was done.

ALTER TABLE jobs ADD COLUMN local INTEGER NOT NULL DEFAULT 0;
CREATE INDEX jobs_local ON jobs (experiment_digest, number) WHERE local = 1;
