//! How many frames a viewer gets: as many as it takes.
//!
//! After each frame it is pinged, which every WebSocket answers by itself and in order. While an answer is late it gets no
//! further frame: what it is shown stays young, and neither the simulation nor the others wait for it.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// An answer that takes longer is late. A choice: more than the way there and back, less than what makes a hand uncertain.
const LATE: Duration = Duration::from_millis(100);
/// Frames without an answer at most, on however long a way.
const MOST_UNANSWERED: usize = 32;

/// Frames that went to one viewer and were not answered yet.
#[derive(Debug, Default)]
pub(super) struct Flow {
    last_number: u32,
    unanswered: VecDeque<(u32, Instant)>,
}

impl Flow {
    /// Whether another frame may go.
    pub(super) fn is_free(&self, now: Instant) -> bool {
        let is_late = |(_, sent): &(u32, Instant)| now.saturating_duration_since(*sent) > LATE;
        self.unanswered.len() < MOST_UNANSWERED && !self.unanswered.front().is_some_and(is_late)
    }

    /// A frame goes; answers what to ping with after it.
    pub(super) fn send(&mut self, now: Instant) -> [u8; 4] {
        self.last_number = self.last_number.wrapping_add(1);
        self.unanswered.push_back((self.last_number, now));
        self.last_number.to_le_bytes()
    }

    /// An answer came. It holds for all before it, too: only the newest ping has to be answered.
    pub(super) fn hear(&mut self, answer: &[u8]) {
        let Ok(bytes) = answer.try_into() else { return };
        let number = u32::from_le_bytes(bytes);
        if let Some(at) = self.unanswered.iter().position(|(of, _)| *of == number) {
            self.unanswered.drain(..=at);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_viewer_that_answers_late_gets_the_next_frame_when_it_has_answered() {
        let begin = Instant::now();
        let at = |ms: u64| begin + Duration::from_millis(ms);
        let mut flow = Flow::default();
        let first = flow.send(at(0));
        assert!(flow.is_free(at(16)));
        let second = flow.send(at(16));
        assert!(flow.is_free(at(100)) && !flow.is_free(at(101)));
        flow.hear(&first);
        assert!(flow.is_free(at(101)) && !flow.is_free(at(117)));
        // What nobody asked, and what was answered before.
        flow.hear(b"");
        flow.hear(&[9; 4]);
        flow.hear(&first);
        assert!(!flow.is_free(at(117)));
        flow.hear(&second);
        assert!(flow.is_free(at(10_000)));
    }

    #[test]
    fn the_newest_answer_holds_for_all_before_and_so_many_may_be_under_way() {
        let now = Instant::now();
        let mut flow = Flow::default();
        let mut newest = [0; 4];
        for _ in 0..MOST_UNANSWERED {
            assert!(flow.is_free(now));
            newest = flow.send(now);
        }
        assert!(!flow.is_free(now));
        flow.hear(&newest);
        assert!(flow.is_free(now + Duration::from_secs(1)));
    }
}
