-- A batch of steps is one row put into this view: one statement, so that SQLite itself keeps it or nothing of it, and one call
-- to the database's thread instead of one for each row. Each table's rows come as a JSON array.
CREATE TEMP VIEW batch AS
SELECT NULL AS new_jobs, NULL AS jobs, NULL AS artifacts, NULL AS shards, NULL AS chunks, NULL AS requests, NULL AS documents,
       NULL AS audit, NULL AS uploads, NULL AS alarms;

CREATE TEMP TRIGGER save INSTEAD OF INSERT ON batch BEGIN

INSERT INTO jobs (id, number, state, experiment_digest, experiment_text, plan_text, created_ms, finished_ms, frames, artifacts,
                  tiles, error, warnings, goal, result_digest, version, pass_us, shard_us, tenant, priority, shard_count, local)
SELECT value ->> 'id', value ->> 'number', value ->> 'state', value ->> 'experiment_digest', value ->> 'experiment_text',
       value ->> 'plan_text', value ->> 'created_ms', value ->> 'finished_ms', value ->> 'frames', value -> 'artifacts',
       value -> 'tiles', value ->> 'error', value -> 'warnings', value ->> 'goal', value ->> 'result_digest', value ->> 'version', value ->> 'pass_us',
       value ->> 'shard_us', value ->> 'tenant', value ->> 'priority', value ->> 'shard_count',
       value ->> 'local'
FROM json_each(new.new_jobs);

UPDATE jobs
SET state = row.value ->> 'state', created_ms = row.value ->> 'created_ms', finished_ms = row.value ->> 'finished_ms', error = row.value ->> 'error',
    result_digest = row.value ->> 'result_digest', version = row.value ->> 'version', pass_us = row.value ->> 'pass_us',
    cones = row.value ->> 'cones', warnings = row.value -> 'warnings'
FROM json_each(new.jobs) AS row WHERE jobs.id = row.value ->> 'id';

INSERT INTO artifacts (key, kind, inputs, digest, cones, predicted_us, phase, fence, worker, local, failures, losses, previous)
SELECT value ->> 'key', value ->> 'kind', value -> 'inputs', value ->> 'digest', value ->> 'cones', value ->> 'predicted_us',
       value ->> 'phase', value ->> 'fence', value ->> 'worker', value ->> 'local', value ->> 'failures', value ->> 'losses',
       value ->> 'previous'
FROM json_each(new.artifacts) WHERE true
ON CONFLICT (key) DO UPDATE SET digest = excluded.digest, previous = excluded.previous, cones = excluded.cones,
    phase = excluded.phase, fence = excluded.fence, worker = excluded.worker, local = excluded.local,
    failures = excluded.failures, losses = excluded.losses;

INSERT INTO shards (job, number, first_frame, frame_count, tile, phase, fence, worker, local, failures, losses, audit)
SELECT value ->> 'job', value ->> 'number', value ->> 'first_frame', value ->> 'frame_count', value ->> 'tile',
       value ->> 'phase', value ->> 'fence', value ->> 'worker', value ->> 'local', value ->> 'failures', value ->> 'losses',
       value ->> 'audit'
FROM json_each(new.shards) WHERE true
ON CONFLICT (job, number) DO UPDATE SET phase = excluded.phase, fence = excluded.fence, worker = excluded.worker,
    local = excluded.local, failures = excluded.failures, losses = excluded.losses, audit = excluded.audit;

INSERT INTO chunks (job, frame, tile, seq, digest, first_cone, cones, summary)
SELECT value ->> 'job', value ->> 'frame', value ->> 'tile', value ->> 'seq', value ->> 'digest', value ->> 'first_cone',
       value ->> 'cones', value ->> 'summary'
FROM json_each(new.chunks) WHERE true
ON CONFLICT (job, frame, tile) DO UPDATE SET digest = excluded.digest, summary = excluded.summary;

INSERT INTO requests (id, job, body)
SELECT value ->> 'id', value ->> 'job', value ->> 'body' FROM json_each(new.requests);

INSERT OR REPLACE INTO documents (id, text)
SELECT value ->> 'id', value ->> 'text' FROM json_each(new.documents);

INSERT INTO audit (at_ms, tenant, who, action, object)
SELECT value ->> 'at_ms', value ->> 'tenant', value ->> 'who', value ->> 'action', value ->> 'object' FROM json_each(new.audit);

INSERT OR IGNORE INTO uploads (at_ms, tenant, digest)
SELECT value ->> 'at_ms', value ->> 'tenant', value ->> 'digest' FROM json_each(new.uploads);

INSERT INTO alarms (at_ms, work, first, second)
SELECT value ->> 'at_ms', value ->> 'work', value ->> 'first', value ->> 'second' FROM json_each(new.alarms);

END;
