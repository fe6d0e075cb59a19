//! Which of the other machine's messages are taken: the newest only, whatever was lost, repeated or overtaken on the way;
//! and over a sealed link only of a session that answered this machine: datagrams that somebody recorded are sealed, too, but
//! nobody could record an answer to what was said just now.

use super::messages::Head;

/// A session that is older than the one that is heard is taken all the same when nothing else came for so long [ns]: the
/// other machine's clock was set back.
const FORGET_NS: u64 = 1_000_000_000;
/// A session begins with an answer to what this machine said no longer ago than this [ns]: a choice, many round trips.
const FRESH_NS: u64 = 1_000_000_000;

/// What came, in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages that were taken.
    pub(crate) n_taken: u64,
    /// Messages that never came, or came too late.
    pub n_lost: u64,
    /// Messages that came twice, or after a newer one.
    pub(crate) n_late: u64,
    /// How often the other machine began anew.
    pub(crate) n_sessions: u64,
    /// Sealed messages of sessions that had not answered this machine: a newcomer's first ones, or recorded ones.
    pub(crate) n_unproven: u64,
}

/// What becomes of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    Taken,
    /// Came twice, or after a newer one.
    Late,
    /// Its session has to answer first.
    Unproven,
}

/// What is known of the sender.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Inbox {
    /// Of this machine, which the other one answers.
    own_session: u64,
    is_sealed: bool,
    session: u64,
    last_sequence: u64,
    heard_ns: u64,
    pub(crate) counts: Counts,
}

impl Inbox {
    /// `own_session`: of this machine. `is_sealed`: whether the link has a key.
    pub(crate) fn new(own_session: u64, is_sealed: bool) -> Self {
        let counts = Counts::default();
        Self { own_session, is_sealed, session: 0, last_sequence: 0, heard_ns: 0, counts }
    }

    /// Takes the message if it is new. `now_ns`: the receiver's clock.
    pub(crate) fn take(&mut self, head: &Head, now_ns: u64) -> Arrival {
        let silent_ns = now_ns.saturating_sub(self.heard_ns);
        let is_first = self.counts.n_sessions == 0;
        let is_new_session = is_first
            || head.session > self.session
            || (head.session != self.session && silent_ns > FORGET_NS);
        if is_new_session {
            let is_answer = head.heard_session == self.own_session
                && now_ns.saturating_sub(head.heard_sent_ns) < FRESH_NS;
            if self.is_sealed && !is_answer {
                self.counts.n_unproven += 1;
                return Arrival::Unproven;
            }
            self.session = head.session;
            self.counts.n_sessions += 1;
            // A newcomer has missed nothing.
            self.last_sequence = head.sequence.saturating_sub(1);
        } else if head.session != self.session || head.sequence <= self.last_sequence {
            self.counts.n_late += 1;
            return Arrival::Late;
        }
        self.counts.n_lost += head.sequence.saturating_sub(self.last_sequence).saturating_sub(1);
        self.counts.n_taken += 1;
        self.last_sequence = head.sequence;
        self.heard_ns = now_ns;
        Arrival::Taken
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
        let mut inbox = Inbox::new(9, false);
        let taken = [3, 4, 4, 7, 5, 8].map(|sequence| inbox.take(&head(1, sequence), 10) == Arrival::Taken);
        assert_eq!(taken, [true, true, false, true, false, true]);
        // 5 and 6 did not come in time; what came before the first one was not missed.
        let expected = Counts { n_taken: 4, n_lost: 2, n_late: 2, n_sessions: 1, n_unproven: 0 };
        assert_eq!(inbox.counts, expected);
    }

    #[test]
    fn a_sender_that_starts_again_is_current_at_once_and_its_old_messages_are_not() {
        let mut inbox = Inbox::new(9, false);
        let mut takes =
            |session, sequence, now_ns| inbox.take(&head(session, sequence), now_ns) == Arrival::Taken;
        assert!(takes(100, 5_000, 0));
        assert!(takes(200, 1, 1));
        assert!(!takes(100, 5_001, 2));
        assert!(takes(200, 2, 3));
        // Its clock was set back: after a second of silence the session counts that talks.
        assert!(!takes(50, 1, 500_000_000));
        assert!(takes(50, 2, 1_500_000_000));
        assert!(takes(50, 3, 1_500_000_001));
        assert_eq!((inbox.counts.n_sessions, inbox.counts.n_lost), (3, 0));
    }

    #[test]
    fn a_recorded_session_is_never_taken_again_of_a_sealed_link() {
        const S: u64 = 1_000_000_000;
        let answer = |session, sequence, to, heard_sent_ns| Head {
            heard_session: to,
            heard_sent_ns,
            ..head(session, sequence)
        };
        let mut inbox = Inbox::new(9, true);
        // Recorded before this machine began: answers to somebody else, or to nobody.
        assert_eq!(inbox.take(&answer(5, 70, 8, 9 * S), 10 * S), Arrival::Unproven);
        assert_eq!(inbox.take(&head(5, 71), 10 * S), Arrival::Unproven);
        // The real one answers, and from then on its numbers count, whatever it hears.
        assert_eq!(inbox.take(&head(100, 1), 11 * S), Arrival::Unproven);
        assert_eq!(inbox.take(&answer(100, 2, 9, 11 * S), 11 * S + 1), Arrival::Taken);
        assert_eq!(inbox.take(&head(100, 3), 11 * S + 2), Arrival::Taken);
        assert_eq!(inbox.take(&answer(200, 2, 9, 12 * S), 12 * S), Arrival::Taken);
        // It is silent for long: what was recorded of the session before it answers this machine, but not now.
        assert_eq!(inbox.take(&answer(100, 4, 9, 11 * S + 3), 20 * S), Arrival::Unproven);
        assert_eq!(inbox.take(&answer(200, 2, 9, 12 * S), 20 * S), Arrival::Late);
        let expected = Counts { n_taken: 3, n_lost: 0, n_late: 1, n_sessions: 2, n_unproven: 4 };
        assert_eq!(inbox.counts, expected);
    }
}
