//! What one viewer is told, and what it asks for.

use crate::class::{Class, Present};
use crate::hands::{FeltBy, Hands};
use crate::inside::{InsideView, Look, Looker};
use crate::messages::{self, Wish};
use crate::shared_frames::SharedFrames;
use bytes::Bytes;
use glisson::model::kind::ModelKind;
use glisson::training::task::TaskStatus;
use glisson_runtime::Parameters;
use glisson_runtime::control::{Control, Steers, Viewer};
use glisson_runtime::live::Command;
use glisson_runtime::published::Published;
use glisson_runtime::watchers::Watcher;
use serde_json::Value;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Who only watches and sends all the same is told so once in this time.
const TOLD_AGAIN: Duration = Duration::from_secs(2);

/// What all viewers of a simulation share.
pub struct Room {
    hello: Value,
    frames: SharedFrames,
    /// Who controls.
    pub control: Arc<Control>,
    /// Who watches.
    pub class: Class,
    /// Instruments that the page in control holds as devices.
    pub hands: Hands,
    /// Whether the page in control may end the simulation: another page comes after it.
    may_leave: bool,
}

impl Room {
    /// Nobody is in it. `hello` as of [`messages::hello`]; `devices` as of [`messages::devices`].
    pub fn new(mut hello: Value, devices: Value, hands: Hands, may_leave: bool) -> Self {
        hello["can_leave"] = may_leave.into();
        hello["devices"] = devices;
        Self {
            hello,
            frames: SharedFrames::default(),
            control: Arc::default(),
            class: Class::default(),
            hands,
            may_leave,
        }
    }

    /// The first message, while this model moves the organ.
    pub fn hello(&self, model: ModelKind) -> Value {
        messages::hello_with_model(&self.hello, model)
    }
}

/// A message to a viewer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ToViewer {
    /// JSON.
    Text(String),
    /// A frame.
    Frame(Bytes),
}

impl From<Value> for ToViewer {
    fn from(message: Value) -> Self {
        Self::Text(message.to_string())
    }
}

/// What a viewer asks for and may.
#[derive(Clone, Debug, PartialEq)]
pub enum Asked {
    /// Something of the simulation.
    Command(Command),
    /// Its end.
    Leave,
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

/// One viewer's place; freed when it is dropped.
pub struct Conversation {
    room: Arc<Room>,
    viewer: Viewer,
    is_teacher: bool,
    told: Told,
    /// Whom it knows of, and what is drawn.
    known: Present,
    felt: Vec<FeltBy>,
    /// When it was told that it only watches.
    told_to_watch: Option<Instant>,
    /// While it looks at contact points.
    contacts: Option<Watcher>,
    /// While it looks at the inside of bodies.
    inside: Option<Looker>,
}

impl Drop for Conversation {
    fn drop(&mut self) {
        self.room.class.leave(self.viewer);
        self.room.control.leave(self.viewer);
    }
}

impl Conversation {
    /// A viewer comes while this is shown; none when all places are taken.
    pub fn enter(room: &Arc<Room>, is_teacher: bool, first: &Published) -> Option<Self> {
        let viewer = room.control.enter()?;
        room.class.enter(viewer, is_teacher);
        let told = Told {
            model: first.model,
            version: first.topology.version,
            key: None,
            // Who comes after the end is told what happened.
            n_notices: if first.is_broken { 0 } else { first.n_notices },
            task: None,
            parameters: None,
        };
        Some(Self {
            room: Arc::clone(room),
            viewer,
            is_teacher,
            told,
            known: Present::default(),
            felt: Vec::new(),
            told_to_watch: None,
            contacts: None,
            inside: None,
        })
    }

    /// What it needs before the first snapshot, and again when another model took over.
    pub fn greet(&self, published: &Published) -> [ToViewer; 2] {
        [self.room.hello(published.model).into(), ToViewer::Frame(self.room.frames.topology(published))]
    }

    /// What is new in a state: notices, another model or topology, and the snapshot, which comes last.
    pub fn show(&mut self, latest: &Arc<Published>) -> Vec<ToViewer> {
        let mut says: Vec<ToViewer> = Vec::new();
        let new_notices = latest.notices_after(self.told.n_notices);
        says.extend(new_notices.iter().map(|notice| messages::notice(notice).into()));
        self.told.n_notices = latest.n_notices;
        if latest.task != self.told.task {
            self.told.task.clone_from(&latest.task);
            says.push(messages::task(latest.task.as_ref()).into());
        }
        if self.told.parameters.as_ref().is_none_or(|told| !Arc::ptr_eq(told, &latest.parameters)) {
            self.told.parameters = Some(Arc::clone(&latest.parameters));
            says.push(messages::parameters(&latest.parameters).into());
        }
        if latest.model != self.told.model {
            self.told.model = latest.model;
            says.extend(self.greet(latest));
        } else if latest.topology.version != self.told.version {
            says.push(ToViewer::Frame(self.room.frames.topology(latest)));
        }
        self.told.version = latest.topology.version;
        let inside = self.inside.as_ref().and_then(|looker| InsideView::of(&looker.look, latest));
        let frames = self.room.frames.snapshot(latest, self.contacts.is_some(), inside.as_ref());
        if let Some(key) = frames.key.filter(|key| self.told.key != Some(key.number)) {
            self.told.key = Some(key.number);
            says.push(ToViewer::Frame(key.frame));
        }
        says.push(ToViewer::Frame(frames.snapshot));
        says
    }

    /// Who steers now.
    pub fn say_role(&self, now: &Steers) -> [ToViewer; 2] {
        [messages::role(now, self.viewer).into(), self.class()]
    }

    fn class(&self) -> ToViewer {
        let controls = self.room.control.watch().borrow().controller.map(|viewer| viewer.number);
        messages::class(&self.known, self.viewer.number, controls).into()
    }

    /// What is new of who is there and what is drawn.
    pub fn say_class(&mut self, present: Present) -> Vec<ToViewer> {
        let before = std::mem::replace(&mut self.known, present);
        let mut says = Vec::new();
        if before.people != self.known.people {
            says.push(self.class());
        }
        if before.marks != self.known.marks {
            says.push(messages::marks(&self.known).into());
        }
        says
    }

    /// What hands feel that a page holds, where that is new.
    pub fn say_felt(&mut self) -> Option<ToViewer> {
        let now = self.room.hands.felt();
        let is_new = now != self.felt;
        self.felt = now;
        is_new.then(|| messages::feel(&self.felt).into())
    }

    /// What it looks at beside the surface.
    pub fn looks(&self) -> (bool, Option<Look>) {
        (self.contacts.is_some(), self.inside.as_ref().map(|looker| looker.look))
    }

    /// A message came: what is answered, and what is to be done. `shown`: any state of the simulation.
    pub fn hear(&mut self, text: &str, shown: &Published) -> (Option<ToViewer>, Option<Asked>) {
        let error = |reason: &str| (Some(messages::error(reason).into()), None);
        let (room, viewer) = (Arc::clone(&self.room), self.viewer);
        let control = &room.control;
        match messages::wish(text) {
            Err(reason) => return error(&reason),
            Ok(Wish::ReleaseControl) => control.release(viewer),
            Ok(Wish::Inside(look)) => {
                self.inside =
                    (!look.is_at_nothing()).then(|| Looker { look, _watcher: shown.inside_watchers.enter() });
            }
            Ok(Wish::Contacts(are_shown)) => {
                self.contacts = are_shown.then(|| shown.contact_watchers.enter());
            }
            // Who teaches has no instrument in the hand, and need not be in control.
            Ok(Wish::Command(command @ (Command::TaskEvent { .. } | Command::Note(_)))) => {
                return (None, Some(Asked::Command(command)));
            }
            Ok(Wish::Command(command @ Command::Pause(_))) if self.is_teacher => {
                return (None, Some(Asked::Command(command)));
            }
            Ok(Wish::Class(wish)) => {
                let note = wish.note();
                return match room.class.obey(wish, viewer, control) {
                    Ok(()) => (None, note.map(|note| Asked::Command(Command::Note(note)))),
                    Err(reason) => error(reason),
                };
            }
            Ok(Wish::Leave) if !room.may_leave => {
                return error("no page started this simulation: Ctrl-C ends the program");
            }
            Ok(Wish::Hold { tool, is_held: false }) => control.lay_down(viewer, tool),
            Ok(Wish::Hold { tool, .. }) if control.take(viewer, tool) => {}
            Ok(Wish::Hold { .. }) => return error("this instrument is not offered"),
            Ok(Wish::Offer { tool, is_offered }) if control.offer(viewer, tool, is_offered) => {}
            Ok(Wish::Command(command)) if control.may_command(viewer, &command) => {
                return (None, Some(Asked::Command(command)));
            }
            Ok(Wish::Leave) if control.may_control(viewer) => return (None, Some(Asked::Leave)),
            Ok(Wish::Command(_) | Wish::Leave | Wish::Offer { .. }) => {
                if self.told_to_watch.is_none_or(|told| told.elapsed() > TOLD_AGAIN) {
                    self.told_to_watch = Some(Instant::now());
                    return error("another viewer has control; this one watches");
                }
            }
        }
        (None, None)
    }
}
