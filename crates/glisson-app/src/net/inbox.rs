//! Which of the other machine's messages are taken: the newest only, whatever was lost, repeated or overtaken on the way.

use super::messages::Head;

/// A session that is older than the one that is heard is taken all the same when nothing else came for so long [ns]: the
/// other machine's clock was set back.
const FORGET_NS: u64 = 1_000_000_000;

/// What came, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Messages that were taken.
    pub(crate) n_taken: u64,
    /// Messages that never came, or came too late.
    pub(crate) n_lost: u64,
    /// Messages that came twice, or after a newer one.
    pub(crate) n_late: u64,
    /// How often the other machine began anew.
    pub(crate) n_sessions: u64,
}

/// What is known of the sender.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Inbox {
    session: u64,
    last_sequence: u64,
    heard_ns: u64,
    pub(crate) counts: Counts,
}

impl Inbox {
    /// Whether the message is new. `now_ns`: the receiver's clock.
    pub(crate) fn takes(&mut self, head: &Head, now_ns: u64) -> bool {
        let silent_ns = now_ns.saturating_sub(self.heard_ns);
        let is_first = self.counts.n_sessions == 0;
        let is_new_session = is_first
            || head.session > self.session
            || (head.session != self.session && silent_ns > FORGET_NS);
        if is_new_session {
            self.session = head.session;
            self.counts.n_sessions += 1;
            // A newcomer has missed nothing.
            self.last_sequence = head.sequence.saturating_sub(1);
        } else if head.session != self.session || head.sequence <= self.last_sequence {
            self.counts.n_late += 1;
            return false;
        }
        self.counts.n_lost += head.sequence.saturating_sub(self.last_sequence).saturating_sub(1);
        self.counts.n_taken += 1;
        self.last_sequence = head.sequence;
        self.heard_ns = now_ns;
        true
    }

    /// When the last message was taken; 0: never.
    pub(crate) fn heard_ns(&self) -> u64 {
        self.heard_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn head(session: u64, sequence: u64) -> Head {
        Head { session, sequence, ..Head::default() }
    }

    #[test]
    fn old_and_repeated_messages_are_left_out_and_gaps_are_counted() {
        let mut inbox = Inbox::default();
        let taken = [3, 4, 4, 7, 5, 8].map(|sequence| inbox.takes(&head(1, sequence), 10));
        assert_eq!(taken, [true, true, false, true, false, true]);
        // 5 and 6 did not come in time; what came before the first one was not missed.
        assert_eq!(inbox.counts, Counts { n_taken: 4, n_lost: 2, n_late: 2, n_sessions: 1 });
    }

    #[test]
    fn a_sender_that_starts_again_is_current_at_once_and_its_old_messages_are_not() {
        let mut inbox = Inbox::default();
        assert!(inbox.takes(&head(100, 5_000), 0));
        assert!(inbox.takes(&head(200, 1), 1));
        assert!(!inbox.takes(&head(100, 5_001), 2));
        assert!(inbox.takes(&head(200, 2), 3));
        assert_eq!((inbox.counts.n_sessions, inbox.counts.n_lost), (2, 0));
        // Its clock was set back: after a second of silence the session counts that talks.
        assert!(!inbox.takes(&head(50, 1), 500_000_000));
        assert!(inbox.takes(&head(50, 2), 1_500_000_000));
        assert!(inbox.takes(&head(50, 3), 1_500_000_001));
    }
}
