//! Two threads between a link and the loops of this machine: one sends the newest state again and again, one takes the
//! newest that comes. The loops never wait for them.

use super::inbox::{Arrival, Counts, Inbox};
use super::link::{Link, ReceiveHalf, Role, SendHalf};
use super::messages::{Content, Head, MOST_BYTES, SceneHash, decode, encode_into};
use super::seal::Seal;
use super::wire::MessageError;
use glisson_runtime::histogram::{Histogram, Percentiles};
use glisson_runtime::realtime::{make_prompt, now_ns};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// What has not changed is sent again after this time: the other side hears that this one is there.
const REPEAT: Duration = Duration::from_millis(10);
/// From one piece of something larger to the next: 1 Mbyte a second. A choice.
const PIECE_PAUSE: Duration = Duration::from_millis(1);
/// Longest wait for a message, after which the threads see whether they should end.
const PATIENCE: Duration = Duration::from_millis(50);
/// A link that is silent for so long counts as cut [ns]: five times the time between repetitions.
pub(crate) const CUT_NS: u64 = 50_000_000;

/// Who talks.
#[derive(Clone)]
pub struct Identity {
    /// Which of the two machines this one is.
    pub role: Role,
    /// Hash of the scene, which both must share.
    pub scene: SceneHash,
    /// Instruments of the scene.
    pub n_tools: usize,
    /// How messages are sealed.
    pub seal: Seal,
}

/// What is new to send, or the same again.
pub(crate) trait Outgoing: Send {
    /// From now on `thread` is unparked when there is something new.
    fn wakes(&self, thread: Thread);
    /// The newest state if it was not seen before.
    fn unseen(&mut self, now_ns: u64) -> Option<Content>;
    /// The newest state.
    fn latest(&mut self, now_ns: u64) -> Content;
    /// The next piece of something larger that the other side has not; to be said again until it has.
    fn piece(&mut self) -> Option<Content>;
}

/// Takes what came.
pub(crate) trait Incoming: Send {
    /// The other machine's newest state. `on_the_way_ns`: half the round trip.
    fn take(&mut self, content: Content, now_ns: u64, on_the_way_ns: u64);
    /// Nothing came for [`CUT_NS`].
    fn cut(&mut self);
}

/// The last message that was heard, which the next one that is sent acknowledges.
#[derive(Clone, Copy, Debug, Default)]
struct Heard {
    session: u64,
    sequence: u64,
    sent_ns: u64,
    at_ns: u64,
}

impl Heard {
    fn of(head: &Head, at_ns: u64) -> Self {
        let Head { session, sequence, sent_ns, .. } = *head;
        Self { session, sequence, sent_ns, at_ns }
    }

    /// Whether a message that proves nothing is acknowledged instead, so that its sender can answer: not while this session,
    /// or a newer one, talks. Recorded ones are older, and must not stand before the one that is there.
    fn gives_way_to(&self, other: &Self) -> bool {
        (other.session, other.sequence) > (self.session, self.sequence)
            || other.at_ns.saturating_sub(self.at_ns) > CUT_NS
    }
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    /// Own session: nanoseconds since 1970 at the start, which fit until the year 2554.
    session: u64,
    heard: Mutex<Heard>,
    counts: Mutex<Counts>,
    n_sent: AtomicU64,
    n_cuts: AtomicU64,
    n_refused: AtomicU64,
    refused: Mutex<Option<String>>,
    heard_ns: AtomicU64,
    round_trip: Histogram,
}

impl Shared {
    /// Answers how long the message was on the way: half the round trip, 0 if it acknowledges nothing of this session [ns].
    fn note_taken(&self, head: &Head, now_ns: u64, last_echo: &mut u64) -> u64 {
        self.heard_ns.store(now_ns, Ordering::Relaxed);
        if let Ok(mut heard) = self.heard.lock() {
            *heard = Heard::of(head, now_ns);
        }
        if head.heard_session != self.session {
            return 0;
        }
        let round_trip_ns = now_ns.saturating_sub(head.heard_sent_ns).saturating_sub(head.heard_ago_ns);
        // The same acknowledgement comes in several messages: the first one counts.
        if head.heard_sequence > *last_echo {
            self.round_trip.record(round_trip_ns);
            *last_echo = head.heard_sequence;
        }
        round_trip_ns / 2
    }

    /// A message that was not taken is acknowledged all the same, so that the next one can prove its session; answers
    /// whether it is.
    fn note_unproven(&self, head: &Head, now_ns: u64) -> bool {
        let Ok(mut heard) = self.heard.lock() else { return false };
        let other = Heard::of(head, now_ns);
        let is_noted = heard.gives_way_to(&other);
        if is_noted {
            *heard = other;
        }
        is_noted
    }
}

/// How the link does.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkReport {
    pub(crate) n_sent: u64,
    /// Messages that came, were lost or refused.
    pub counts: Counts,
    /// Messages that were not for us or damaged, and why the last one was.
    pub(crate) n_refused: u64,
    pub(crate) refused: Option<String>,
    /// How often nothing came for [`CUT_NS`] after something had come.
    pub(crate) n_cuts: u64,
    /// Whether something came in the last [`CUT_NS`].
    pub is_up: bool,
    /// From sending a message to hearing that it was heard, without the time that the other machine kept it.
    pub round_trip: Percentiles,
}

/// A running exchange of messages.
pub struct Conversation {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

impl Conversation {
    /// Starts both threads.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(crate) fn start(
        link: Link,
        identity: Identity,
        outgoing: impl Outgoing + 'static,
        incoming: impl Incoming + 'static,
    ) -> std::io::Result<Self> {
        let session = SystemTime::now().duration_since(UNIX_EPOCH).map_or(1, |since| since.as_nanos() as u64);
        let shared = Arc::new(Shared { session, ..Shared::default() });
        let Link { sender, receiver } = link;
        let sending = {
            let (shared, identity) = (Arc::clone(&shared), identity.clone());
            let run = move || send_all(&shared, &identity, sender, outgoing);
            std::thread::Builder::new().name("link-out".into()).spawn(run)?
        };
        let mut conversation = Self { shared: Arc::clone(&shared), threads: vec![sending] };
        let run = move || receive_all(&shared, &identity, receiver, incoming);
        conversation.threads.push(std::thread::Builder::new().name("link-in".into()).spawn(run)?);
        Ok(conversation)
    }

    /// How it goes.
    pub fn report(&self) -> LinkReport {
        let shared = &self.shared;
        let heard_ns = shared.heard_ns.load(Ordering::Relaxed);
        LinkReport {
            n_sent: shared.n_sent.load(Ordering::Relaxed),
            counts: shared.counts.lock().map_or_else(|_| Counts::default(), |counts| *counts),
            n_refused: shared.n_refused.load(Ordering::Relaxed),
            refused: shared.refused.lock().ok().and_then(|refused| refused.clone()),
            n_cuts: shared.n_cuts.load(Ordering::Relaxed),
            is_up: heard_ns > 0 && now_ns().saturating_sub(heard_ns) < CUT_NS,
            round_trip: shared.round_trip.percentiles(),
        }
    }
}

impl Drop for Conversation {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.threads.iter().for_each(|thread| thread.thread().unpark());
        for thread in self.threads.drain(..) {
            // A panic was already printed.
            let _ = thread.join();
        }
    }
}

fn send_all(
    shared: &Shared,
    identity: &Identity,
    mut sender: Box<dyn SendHalf>,
    mut outgoing: impl Outgoing,
) {
    make_prompt();
    let mut bytes = Vec::with_capacity(MOST_BYTES);
    let (mut sequence, mut last_sent) = (0, Instant::now());
    let (mut next_piece, mut has_pieces) = (Instant::now(), false);
    outgoing.wakes(std::thread::current());
    while !shared.ends.load(Ordering::Relaxed) {
        let is_pieces_turn = Instant::now() >= next_piece;
        let content = match outgoing.unseen(now_ns()) {
            Some(content) => {
                last_sent = Instant::now();
                content
            }
            None => match is_pieces_turn.then(|| outgoing.piece()) {
                Some(Some(piece)) => {
                    has_pieces = true;
                    next_piece = Instant::now() + PIECE_PAUSE;
                    piece
                }
                asked => {
                    has_pieces &= asked.is_none();
                    let wait = REPEAT.saturating_sub(last_sent.elapsed());
                    if !wait.is_zero() {
                        std::thread::park_timeout(if has_pieces { wait.min(PIECE_PAUSE) } else { wait });
                        continue;
                    }
                    last_sent = Instant::now();
                    outgoing.latest(now_ns())
                }
            },
        };
        sequence += 1;
        let head = next_head(shared, identity, sequence);
        encode_into(&head, &content, &identity.seal, &mut bytes);
        match sender.send(&bytes) {
            Ok(()) => {
                shared.n_sent.fetch_add(1, Ordering::Relaxed);
            }
            // The network may come back: not more often than it is looked at anyway.
            Err(error) => {
                refuse(shared, format!("sending: {error}"));
                std::thread::sleep(PATIENCE);
            }
        }
    }
}

/// The head of what is sent now.
fn next_head(shared: &Shared, identity: &Identity, sequence: u64) -> Head {
    let heard = shared.heard.lock().map_or_else(|_| Heard::default(), |heard| *heard);
    let sent_ns = now_ns();
    Head {
        scene: identity.scene.short(),
        session: shared.session,
        sequence,
        sent_ns,
        heard_session: heard.session,
        heard_sequence: heard.sequence,
        heard_sent_ns: heard.sent_ns,
        heard_ago_ns: sent_ns.saturating_sub(heard.at_ns),
    }
}

/// Counts it; tells a reason when it is another one than before.
fn refuse(shared: &Shared, reason: String) {
    shared.n_refused.fetch_add(1, Ordering::Relaxed);
    if let Ok(mut refused) = shared.refused.lock()
        && refused.as_ref() != Some(&reason)
    {
        eprintln!("link: a message was refused: {reason}");
        *refused = Some(reason);
    }
}

/// Why a message that could be read is not for this machine.
fn objection(identity: &Identity, head: &Head, content: &Content) -> Option<String> {
    let (from, n_tools) = match content {
        Content::Hands { hands, .. } => (Role::Haptics, hands.len()),
        Content::Tissues { tissues, .. } => (Role::Simulation, tissues.len()),
        Content::Piece(_) => (Role::Simulation, identity.n_tools),
    };
    if from == identity.role {
        return Some(format!(
            "the other machine has the role {} too: one needs --role {}",
            from.name(),
            from.other().name()
        ));
    }
    if head.scene != identity.scene.short() {
        return Some(format!(
            "the other machine has another scene ({:016x}, here {:?}): give both the same scene and mesh files",
            head.scene.swap_bytes(),
            identity.scene
        ));
    }
    (n_tools != identity.n_tools)
        .then(|| format!("the other machine has {n_tools} instruments, this one {}", identity.n_tools))
}

fn receive_all(
    shared: &Shared,
    identity: &Identity,
    mut receiver: Box<dyn ReceiveHalf>,
    mut incoming: impl Incoming,
) {
    make_prompt();
    // One byte more than the longest message, so that a longer one is seen to be one.
    let mut buffer = [0; MOST_BYTES + 1];
    let mut inbox = Inbox::new(shared.session, identity.seal.has_key());
    let (mut is_cut, mut last_echo) = (true, 0);
    while !shared.ends.load(Ordering::Relaxed) {
        let received = receiver.receive(&mut buffer, PATIENCE);
        let now = now_ns();
        match received {
            Ok(Some(n)) => match decode(&buffer[..n], &identity.seal) {
                Ok((head, content)) => {
                    match objection(identity, &head, &content) {
                        Some(objection) => refuse(shared, objection),
                        None => match inbox.take(&head, now) {
                            Arrival::Taken => {
                                receiver.trust_sender();
                                is_cut = false;
                                let on_the_way_ns = shared.note_taken(&head, now, &mut last_echo);
                                incoming.take(content, now, on_the_way_ns);
                            }
                            Arrival::Unproven => {
                                if shared.note_unproven(&head, now) {
                                    receiver.ask_sender();
                                }
                            }
                            Arrival::Late => {}
                        },
                    }
                    if let Ok(mut counts) = shared.counts.lock() {
                        *counts = inbox.counts;
                    }
                }
                // Ten thousand strangers' datagrams a second are no reason to write ten thousand lines.
                Err(MessageError::Magic) => {
                    shared.n_refused.fetch_add(1, Ordering::Relaxed);
                }
                Err(error) => refuse(shared, error.to_string()),
            },
            Ok(None) => {}
            Err(error) => {
                refuse(shared, format!("receiving: {error}"));
                std::thread::sleep(PATIENCE);
            }
        }
        if !is_cut && now.saturating_sub(inbox.heard_ns()) >= CUT_NS {
            is_cut = true;
            shared.n_cuts.fetch_add(1, Ordering::Relaxed);
            incoming.cut();
        }
    }
}
