//! How much a viewer may send.

use std::time::Instant;

/// Messages a second that a viewer may send in the long run: five instruments at 144 Hz. Bursts may have as many more.
const MESSAGES_PER_S: f64 = 720.0;
/// Characters a second in the long run, and the most in a burst.
const BYTES_PER_S: f64 = 262_144.0;

/// What a viewer may still send: fills up with time, at most to one second's worth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    messages: f64,
    bytes: f64,
    since: Instant,
}

impl Allowance {
    pub(super) fn new(now: Instant) -> Self {
        Self { messages: MESSAGES_PER_S, bytes: BYTES_PER_S, since: now }
    }

    /// Whether a message of so many bytes may come now.
    pub(super) fn spend(&mut self, n_bytes: usize, now: Instant) -> bool {
        let passed_s = now.saturating_duration_since(self.since).as_secs_f64();
        self.since = now;
        self.messages = (self.messages + passed_s * MESSAGES_PER_S).min(MESSAGES_PER_S) - 1.0;
        self.bytes = (self.bytes + passed_s * BYTES_PER_S).min(BYTES_PER_S) - n_bytes as f64;
        self.messages >= 0.0 && self.bytes >= 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn what_is_sent_is_bounded_in_the_long_run_and_in_bursts() {
        let start = Instant::now();
        let n_passed = |interval: Duration, n_bytes, n: u32| {
            let mut allowance = Allowance::new(start);
            (1..=n).filter(|&i| allowance.spend(n_bytes, start + interval * i)).count()
        };
        assert_eq!(n_passed(Duration::ZERO, 10, 10_000), 720);
        assert_eq!(n_passed(Duration::from_millis(2), 300, 10_000), 10_000);
        assert_eq!(n_passed(Duration::ZERO, 65_536, 100), 4);
    }
}
