//! Token buckets: how much predicted work a tenant may ask for in a time.
//!
//! A bucket holds CPU seconds and fills at a rate; a job is taken while there is something in it, and may leave it in debt.

use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

/// One tenant's CPU seconds.
struct Bucket {
    seconds: f64,
    filled: Instant,
}

/// The buckets of all tenants.
pub struct Quota {
    /// Most that a bucket holds, CPU seconds.
    burst_seconds: f64,
    /// CPU seconds that run into it each second.
    rate: f64,
    buckets: Mutex<BTreeMap<String, Bucket>>,
}

impl Quota {
    /// Full buckets.
    pub fn new(burst_seconds: f64, rate: f64) -> Self {
        Self { burst_seconds, rate, buckets: Mutex::default() }
    }

    /// Takes a job's cost, or says in how many seconds there will be something again.
    pub fn take(&self, tenant: &str, cost_seconds: f64, now: Instant) -> Result<(), u32> {
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        // Who has a full bucket need not be remembered.
        if buckets.len() > 1000 {
            buckets.retain(|_, bucket| self.level(bucket, now) < self.burst_seconds);
        }
        let full = Bucket { seconds: self.burst_seconds, filled: now };
        let bucket = buckets.entry(tenant.to_owned()).or_insert(full);
        bucket.seconds = self.level(bucket, now);
        bucket.filled = now;
        if bucket.seconds <= 0.0 {
            return Err(((1e-3 - bucket.seconds) / self.rate.max(1e-9)).ceil().clamp(1.0, 86400.0) as u32);
        }
        bucket.seconds -= cost_seconds;
        Ok(())
    }

    fn level(&self, bucket: &Bucket, now: Instant) -> f64 {
        let time = now.saturating_duration_since(bucket.filled).as_secs_f64();
        (bucket.seconds + time * self.rate).min(self.burst_seconds)
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn an_empty_bucket_says_when_to_come_back() {
        let quota = Quota::new(100.0, 2.0);
        let start = Instant::now();
        assert_eq!(quota.take("a", 60.0, start), Ok(()));
        // 40 left; the next leaves a debt of 20, gone after 10 s.
        assert_eq!(quota.take("a", 60.0, start), Ok(()));
        assert_eq!(quota.take("a", 1.0, start), Err(11));
        assert_eq!(quota.take("b", 1.0, start), Ok(()), "others have their own");
        assert!(quota.take("a", 1.0, start + Duration::from_secs(5)).is_err());
        assert_eq!(quota.take("a", 1.0, start + Duration::from_secs(11)), Ok(()));
    }
}
