-- What users have to know of a result; what the audit found, with the shard that found it, and by what it is judged.

ALTER TABLE jobs ADD COLUMN warnings TEXT NOT NULL DEFAULT '[]';
ALTER TABLE jobs ADD COLUMN goal TEXT;
ALTER TABLE shards ADD COLUMN audit TEXT NOT NULL DEFAULT '[]';

-- Jobs that are at work, or whose lost results are computed again, are judged too.
UPDATE jobs SET goal = (
    SELECT json_object('target', experiment.text -> 'accuracy_target',
                       'drawn', json(iif(plan.text ->> 'engine' = 'EXPECTED', 'false', 'true')))
    FROM documents AS experiment JOIN documents AS plan ON plan.id = jobs.plan_text
    WHERE experiment.id = jobs.experiment_text AND json_valid(experiment.text) AND json_valid(plan.text)
      AND json_type(experiment.text, '$.accuracy_target') IN ('integer', 'real')
);
UPDATE shards SET audit = coalesce((
    SELECT text -> 'audit' FROM documents
    WHERE id = 'report/s/' || shards.job || '/' || shards.number AND json_valid(text)
      AND json_type(text, '$.audit') = 'array'
), '[]')
WHERE phase = 2;
