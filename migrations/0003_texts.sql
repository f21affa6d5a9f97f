-- Texts that jobs share, by content; what is over for long can be found and deleted.

ALTER TABLE jobs ADD COLUMN experiment_text TEXT NOT NULL DEFAULT '';
ALTER TABLE jobs ADD COLUMN plan_text TEXT NOT NULL DEFAULT '';
UPDATE jobs SET experiment_text = 'experiment/' || id, plan_text = 'plan/' || id;
CREATE INDEX jobs_by_experiment ON jobs (experiment_text);
CREATE INDEX jobs_by_plan ON jobs (plan_text);
CREATE INDEX jobs_by_end ON jobs (finished_ms) WHERE finished_ms IS NOT NULL;
CREATE INDEX requests_by_job ON requests (job);
