//! One viewer's WebSocket.

use super::Shared;
use super::access::IsTeacher;
use super::allowance::Allowance;
use super::class::Present;
use super::flow::Flow;
use super::inside::{InsideView, Looker};
use super::messages::{self, Wish};
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, WebSocket, WebSocketUpgrade, close_code};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use glisson::model::kind::ModelKind;
use glisson::training::task::TaskStatus;
use glisson_runtime::Parameters;
use glisson_runtime::control::Viewer;
use glisson_runtime::live::Command;
use glisson_runtime::published::Published;
use glisson_runtime::watchers::Watcher;
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
/// Who only watches and sends all the same is told so once in this time.
const TOLD_AGAIN: Duration = Duration::from_secs(2);

/// How often a viewer hears what hands feel that a page holds: a choice, half a display's rate.
const FEEL: Duration = Duration::from_millis(33);

/// A viewer's place; freed however its connection ends.
struct Seat {
    shared: Arc<Shared>,
    viewer: Viewer,
    is_teacher: bool,
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.shared.class.leave(self.viewer);
        self.shared.control.leave(self.viewer);
    }
}

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
    let Some(viewer) = shared.control.enter() else {
        return (StatusCode::SERVICE_UNAVAILABLE, "all places for viewers are taken\n").into_response();
    };
    shared.class.enter(viewer, is_teacher);
    let seat = Seat { shared, viewer, is_teacher };
    upgrade.max_message_size(LONGEST_MESSAGE_BYTES).max_frame_size(LONGEST_MESSAGE_BYTES).on_upgrade(
        move |socket| async move {
            let now = Instant::now();
            let allowance = Allowance::new(now);
            let mut connection = Connection {
                socket,
                seat,
                allowance,
                flow: Flow::default(),
                last_heard: now,
                told: None,
                contacts: None,
                inside: None,
            };
            if let Err(End::Refused(reason)) = connection.talk().await {
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
    seat: Seat,
    allowance: Allowance,
    flow: Flow,
    last_heard: Instant,
    /// When it was told that it only watches.
    told: Option<Instant>,
    /// While it looks at contact points.
    contacts: Option<Watcher>,
    /// While it looks at the inside of bodies.
    inside: Option<Looker>,
}

/// What a viewer was last told.
struct Told {
    model: ModelKind,
    /// Of the topology.
    version: u32,
    /// Number of the key that it has.
    key: Option<u32>,
    n_notices: usize,
    task: Option<TaskStatus>,
    parameters: Option<Arc<Parameters>>,
}

impl Connection {
    async fn send(&mut self, message: Message) -> Result<(), End> {
        match timeout(LONGEST_SILENCE, self.socket.send(message)).await {
            Ok(Ok(())) => Ok(()),
            Ok(Err(_)) | Err(_) => Err(End::Gone),
        }
    }

    async fn say(&mut self, text: serde_json::Value) -> Result<(), End> {
        self.send(Message::Text(text.to_string().into())).await
    }

    /// What a viewer needs before the first snapshot, and again when another model took over.
    async fn greet(&mut self, published: &Published) -> Result<(), End> {
        self.say(messages::hello_with_model(&self.seat.shared.hello, published.model)).await?;
        self.send(Message::Binary(self.seat.shared.frames.topology(published))).await
    }

    /// Sends what is new since `told`: notices, another model or topology, and the snapshot.
    async fn show(&mut self, latest: &Arc<Published>, told: &mut Told) -> Result<(), End> {
        for notice in latest.notices_after(told.n_notices) {
            self.say(messages::notice(notice)).await?;
        }
        told.n_notices = latest.n_notices;
        if latest.task != told.task {
            told.task.clone_from(&latest.task);
            self.say(messages::task(latest.task.as_ref())).await?;
        }
        if told.parameters.as_ref().is_none_or(|told| !Arc::ptr_eq(told, &latest.parameters)) {
            told.parameters = Some(Arc::clone(&latest.parameters));
            self.say(messages::parameters(&latest.parameters)).await?;
        }
        if latest.model != told.model {
            told.model = latest.model;
            self.greet(latest).await?;
        } else if latest.topology.version != told.version {
            self.send(Message::Binary(self.seat.shared.frames.topology(latest))).await?;
        }
        told.version = latest.topology.version;
        let inside = self.inside.as_ref().and_then(|looker| InsideView::of(&looker.look, latest));
        let frames = self.seat.shared.frames.snapshot(latest, self.contacts.is_some(), inside.as_ref());
        if let Some(key) = frames.key.filter(|key| told.key != Some(key.number)) {
            told.key = Some(key.number);
            self.send(Message::Binary(key.frame)).await?;
        }
        let ping = self.flow.send(Instant::now());
        self.send(Message::Binary(frames.snapshot)).await?;
        self.send(Message::Ping(ping.to_vec().into())).await
    }

    async fn say_timing(&mut self, published: &watch::Receiver<Arc<Published>>) -> Result<(), End> {
        let shared = Arc::clone(&self.seat.shared);
        let own = shared.meters.as_ref().map(|meters| meters.report());
        let haptics = own.or_else(|| shared.remote_figures.as_ref()?.report());
        let latest = Arc::clone(&published.borrow());
        self.say(messages::timing(&latest, shared.haptics_at, haptics.as_ref())).await
    }

    async fn say_class(&mut self, present: &Present) -> Result<(), End> {
        let controls = self.seat.shared.control.watch().borrow().controller.map(|viewer| viewer.number);
        self.say(messages::class(present, self.seat.viewer.number, controls)).await
    }

    async fn talk(&mut self) -> Result<(), End> {
        let shared = Arc::clone(&self.seat.shared);
        let mut published = shared.published.clone();
        let mut steers = shared.control.watch();
        let mut class = shared.class.watch();
        // Whom it knows of; what is drawn only when there is something.
        let mut known = Present::default();
        let first = Arc::clone(&published.borrow());
        let mut told = Told {
            model: first.model,
            version: first.topology.version,
            key: None,
            // Who comes after the end is told what happened.
            n_notices: if first.is_broken { 0 } else { first.n_notices },
            task: None,
            parameters: None,
        };
        self.greet(&first).await?;
        // A simulation that ended is told by the closed channel.
        let _ = shared.commands.send(Command::Viewed);
        published.mark_changed();
        steers.mark_changed();
        class.mark_changed();
        let (mut beat, mut feel) = (unhurried(BEAT), unhurried(FEEL));
        let mut felt = Vec::new();
        loop {
            tokio::select! {
                changed = published.changed(), if self.flow.is_free(Instant::now()) => {
                    if changed.is_err() {
                        return self.say(messages::error("the simulation stopped; see the program's output")).await;
                    }
                    let latest = Arc::clone(&published.borrow_and_update());
                    self.show(&latest, &mut told).await?;
                }
                changed = steers.changed() => {
                    if changed.is_ok() {
                        let now = *steers.borrow_and_update();
                        self.say(messages::role(&now, self.seat.viewer)).await?;
                        self.say_class(&known).await?;
                    }
                }
                changed = class.changed() => {
                    if changed.is_ok() {
                        let present = class.borrow_and_update().clone();
                        if present.people != known.people {
                            self.say_class(&present).await?;
                        }
                        if present.marks != known.marks {
                            self.say(messages::marks(&present)).await?;
                        }
                        known = present;
                    }
                }
                _ = beat.tick() => {
                    if self.last_heard.elapsed() > LONGEST_SILENCE {
                        return Err(End::Gone);
                    }
                    self.say_timing(&published).await?;
                    self.send(Message::Ping(Vec::new().into())).await?;
                }
                _ = feel.tick(), if !shared.hands.is_empty() => {
                    let now = shared.hands.felt();
                    if now != felt {
                        self.say(messages::feel(&now)).await?;
                        felt = now;
                    }
                }
                message = self.socket.recv() => {
                    match message {
                        Some(Ok(message)) => {
                            let looks = |this: &Self| (this.contacts.is_some(), this.inside.as_ref().map(|looker| looker.look));
                            let looked = looks(self);
                            self.hear(message).await?;
                            // Also while nothing moves.
                            if looks(self) != looked {
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
        let (shared, viewer) = (Arc::clone(&self.seat.shared), self.seat.viewer);
        let control = &shared.control;
        match messages::wish(&text) {
            Ok(Wish::ReleaseControl) => control.release(viewer),
            Ok(Wish::Inside(look)) => {
                let watchers = Arc::clone(&shared.published.borrow().inside_watchers);
                self.inside = (!look.is_at_nothing()).then(|| Looker { look, _watcher: watchers.enter() });
            }
            Ok(Wish::Contacts(shown)) => {
                let watchers = Arc::clone(&self.seat.shared.published.borrow().contact_watchers);
                self.contacts = shown.then(|| watchers.enter());
            }
            // Who teaches has no instrument in the hand, and need not be in control.
            Ok(Wish::Command(command @ (Command::TaskEvent { .. } | Command::Note(_)))) => {
                self.obey(command).await;
            }
            Ok(Wish::Command(command @ Command::Pause(_))) if self.seat.is_teacher => {
                self.obey(command).await;
            }
            Ok(Wish::Class(wish)) => {
                let note = wish.note();
                match (shared.class.obey(wish, viewer, control), note) {
                    (Ok(()), Some(note)) => self.obey(Command::Note(note)).await,
                    (Ok(()), None) => {}
                    (Err(reason), _) => self.say(messages::error(reason)).await?,
                }
            }
            Ok(Wish::Leave) if self.seat.shared.leaving.is_none() => {
                self.say(messages::error("no page started this simulation: Ctrl-C ends the program")).await?;
            }
            Ok(Wish::Hold { tool, is_held: false }) => control.lay_down(viewer, tool),
            Ok(Wish::Hold { tool, .. }) if control.take(viewer, tool) => {}
            Ok(Wish::Hold { .. }) => self.say(messages::error("this instrument is not offered")).await?,
            Ok(Wish::Offer { tool, is_offered }) if control.offer(viewer, tool, is_offered) => {}
            Ok(Wish::Command(command)) if control.may_command(viewer, &command) => self.obey(command).await,
            Ok(Wish::Leave) if control.may_control(viewer) => {
                self.seat.shared.leaving.iter().for_each(|leaving| {
                    leaving.send_replace(true);
                });
            }
            Ok(Wish::Command(_) | Wish::Leave | Wish::Offer { .. }) => {
                if self.told.is_none_or(|told| told.elapsed() > TOLD_AGAIN) {
                    self.told = Some(Instant::now());
                    self.say(messages::error("another viewer has control; this one watches")).await?;
                }
            }
            Err(reason) => self.say(messages::error(&reason)).await?,
        }
        Ok(())
    }

    /// The viewer may.
    async fn obey(&mut self, command: Command) {
        let shared = Arc::clone(&self.seat.shared);
        if shared.hands.take(&command) {
            return;
        }
        if command == Command::Reset && !shared.hands.is_empty() {
            tokio::time::sleep(shared.homing).await;
        }
        // A simulation that ended is told by the closed channel.
        let _ = shared.commands.send(command);
    }
}
