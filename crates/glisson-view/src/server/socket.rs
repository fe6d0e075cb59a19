//! One viewer's WebSocket.

use super::Shared;
use super::access::IsTeacher;
use super::allowance::Allowance;
use super::flow::Flow;
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use glisson_protocol::conversation::{Asked, Conversation, ToViewer};
use glisson_protocol::messages;
use glisson_runtime::live::Command;
use glisson_runtime::published::Published;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{Interval, MissedTickBehavior, interval, timeout};

/// Longest message of a viewer: a pose has some 200 bytes.
pub(super) const LONGEST_MESSAGE_BYTES: usize = 1 << 14;
/// How often a viewer hears how the loops keep their time, and is asked whether it is still there.
const BEAT: Duration = Duration::from_secs(1);
/// A viewer that was silent for so long (browsers answer a ping by themselves) or does not take what it is sent is gone:
/// it must not keep control.
const LONGEST_SILENCE: Duration = Duration::from_secs(15);
/// How often a viewer hears what hands feel that a page holds: a choice, half a display's rate.
const FEEL: Duration = Duration::from_millis(33);

/// A beat that leaves out what it is late for.
fn unhurried(period: Duration) -> Interval {
    let mut beat = interval(period);
    beat.set_missed_tick_behavior(MissedTickBehavior::Delay);
    beat
}

pub(super) async fn open(
    State(shared): State<Arc<Shared>>,
    Extension(IsTeacher(is_teacher)): Extension<IsTeacher>,
    upgrade: WebSocketUpgrade,
) -> Response {
    let first = Arc::clone(&shared.published.borrow());
    let Some(conversation) = Conversation::enter(&shared.room, is_teacher, &first) else {
        return (StatusCode::SERVICE_UNAVAILABLE, "all places for viewers are taken\n").into_response();
    };
    upgrade.max_message_size(LONGEST_MESSAGE_BYTES).max_frame_size(LONGEST_MESSAGE_BYTES).on_upgrade(
        move |socket| async move {
            let now = Instant::now();
            let allowance = Allowance::new(now);
            let flow = Flow::default();
            let mut connection =
                Connection { socket, shared, conversation, allowance, flow, last_heard: now };
            if let Err(End::Refused(reason)) = connection.talk(&first).await {
                let close = CloseFrame { code: close_code::POLICY, reason: reason.into() };
                // Who does not take the reason goes without it.
                let _ = connection.send(Message::Close(Some(close))).await;
            }
        },
    )
}

/// Why a connection ends.
enum End {
    /// The viewer went away, or does not take what it is sent.
    Gone,
    /// The server ends it, and says why.
    Refused(&'static str),
}

struct Connection {
    socket: WebSocket,
    shared: Arc<Shared>,
    conversation: Conversation,
    allowance: Allowance,
    flow: Flow,
    last_heard: Instant,
}

impl Connection {
    async fn send(&mut self, message: Message) -> Result<(), End> {
        match timeout(LONGEST_SILENCE, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(End::Gone),
        }
    }

    async fn say(&mut self, says: impl IntoIterator<Item = ToViewer>) -> Result<(), End> {
        for message in says {
            self.send(match message {
                ToViewer::Text(text) => Message::Text(text.into()),
                ToViewer::Frame(frame) => Message::Binary(frame),
            })
            .await?;
        }
        Ok(())
    }

    /// Sends what is new, and asks whether it arrived.
    async fn show(&mut self, latest: &Arc<Published>) -> Result<(), End> {
        let says = self.conversation.show(latest);
        // From before the frame goes: what takes long counts.
        let ping = self.flow.send(Instant::now());
        self.say(says).await?;
        self.send(Message::Ping(ping.to_vec().into())).await
    }

    async fn say_timing(&mut self, published: &watch::Receiver<Arc<Published>>) -> Result<(), End> {
        let shared = Arc::clone(&self.shared);
        let own = shared.meters.as_ref().map(|meters| meters.report());
        let haptics = own.or_else(|| shared.remote_figures.as_ref()?.report());
        let latest = Arc::clone(&published.borrow());
        self.say([messages::timing(&latest, shared.haptics_at, haptics.as_ref()).into()]).await
    }

    async fn talk(&mut self, first: &Published) -> Result<(), End> {
        let shared = Arc::clone(&self.shared);
        let mut published = shared.published.clone();
        let mut steers = shared.room.control.watch();
        let mut class = shared.room.class.watch();
        self.say(self.conversation.greet(first)).await?;
        // A simulation that ended is told by the closed channel.
        let _ = shared.commands.send(Command::Viewed);
        published.mark_changed();
        steers.mark_changed();
        class.mark_changed();
        let (mut beat, mut feel) = (unhurried(BEAT), unhurried(FEEL));
        loop {
            tokio::select! {
                changed = published.changed(), if self.flow.is_free(Instant::now()) => {
                    if changed.is_err() {
                        return self.say([messages::error("the simulation stopped; see the program's output").into()]).await;
                    }
                    let latest = Arc::clone(&published.borrow_and_update());
                    self.show(&latest).await?;
                }
                changed = steers.changed() => {
                    if changed.is_ok() {
                        let now = *steers.borrow_and_update();
                        self.say(self.conversation.say_role(&now)).await?;
                    }
                }
                changed = class.changed() => {
                    if changed.is_ok() {
                        let present = class.borrow_and_update().clone();
                        let says = self.conversation.say_class(present);
                        self.say(says).await?;
                    }
                }
                _ = beat.tick() => {
                    if self.last_heard.elapsed() > LONGEST_SILENCE {
                        return Err(End::Gone);
                    }
                    self.say_timing(&published).await?;
                    self.send(Message::Ping(Vec::new().into())).await?;
                }
                _ = feel.tick(), if !shared.room.hands.is_empty() => {
                    let felt = self.conversation.say_felt();
                    self.say(felt).await?;
                }
                message = self.socket.recv() => {
                    match message {
                        Some(Ok(message)) => {
                            let looked = self.conversation.looks();
                            self.hear(message).await?;
                            // Also while nothing moves.
                            if self.conversation.looks() != looked {
                                published.mark_changed();
                            }
                        }
                        // Of who is gone, too: then nobody takes the reason.
                        Some(Err(_)) => return Err(End::Refused("a broken or too long message")),
                        None => return Err(End::Gone),
                    }
                }
            }
        }
    }

    async fn hear(&mut self, message: Message) -> Result<(), End> {
        self.last_heard = Instant::now();
        let n_bytes = match &message {
            Message::Text(text) => text.len(),
            Message::Binary(bytes) | Message::Ping(bytes) | Message::Pong(bytes) => bytes.len(),
            Message::Close(_) => return Err(End::Gone),
        };
        if !self.allowance.spend(n_bytes, self.last_heard) {
            return Err(End::Refused("too many messages"));
        }
        if let Message::Pong(answer) = &message {
            self.flow.hear(answer);
        }
        let Message::Text(text) = message else {
            return match message {
                Message::Binary(_) => Err(End::Refused("viewers send text")),
                _ => Ok(()),
            };
        };
        let shared = Arc::clone(&self.shared);
        let shown = Arc::clone(&shared.published.borrow());
        let (answer, asked) = self.conversation.hear(&text, &shown);
        match asked {
            Some(Asked::Command(command)) => self.obey(command).await,
            Some(Asked::Leave) => shared.leaving.iter().for_each(|leaving| _ = leaving.send_replace(true)),
            None => {}
        }
        self.say(answer).await
    }

    /// The viewer may.
    async fn obey(&mut self, command: Command) {
        let shared = Arc::clone(&self.shared);
        let hands = &shared.room.hands;
        if hands.take(&command) {
            return;
        }
        if command == Command::Reset && !hands.is_empty() {
            tokio::time::sleep(shared.homing).await;
        }
        // A simulation that ended is told by the closed channel.
        let _ = shared.commands.send(command);
    }
}
