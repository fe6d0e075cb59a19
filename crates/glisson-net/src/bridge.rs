//! The two ends of a link inside the program: where in one program the haptic loop and the simulation hand poses and
//! models to each other ([`glisson_runtime::exchange`]), here each hands them to a [`Conversation`]. On the haptics machine
//! detection stands between the loop and the link ([`super::detector`]).

use super::contact_messages::{HeldSurface, SurfaceName};
use super::conversation::{Conversation, Identity, Incoming, Outgoing};
use super::detector::{Detection, NamedSurface, Told, Watched, WatchedEnds};
use super::link::Link;
use super::messages::{Content, Hand, Tissue};
use super::surface::{SurfaceIn, SurfaceOut, name_of};
use glisson::tool::{Tool, ToolInput};
use glisson::world::detection::{SurfaceCopy, SurfaceList};
use glisson_runtime::elsewhere::Nearby;
use glisson_runtime::exchange::{Latest, Publisher, exchange};
use glisson_runtime::haptic_loop::{DeviceStatus, Meters, Motion, PublishedModel, ToolLink};
use glisson_runtime::remote_figures::RemoteFigures;
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex};
use std::thread::Thread;

/// What the simulation calls the other machine.
const DEVICE_NAME: &str = "at the other machine";
/// From one report of the haptic loop to the next [ns].
const FIGURES_PAUSE_NS: u64 = 500_000_000;

/// What the haptics machine's user should hear of a device.
pub(crate) struct DeviceNews {
    pub(crate) device_name: String,
    pub(crate) statuses: Latest<DeviceStatus>,
}

/// What the haptics machine holds of the scene.
pub struct HapticsScene {
    pub(crate) tools: Vec<Tool>,
    /// The organ's surface at the start; none to leave all detection to the simulation.
    pub(crate) surface: Option<SurfaceList>,
    /// Stiffness of the tissue against each tip, roughly [N/m].
    pub(crate) stiffness_n_per_m: Vec<f64>,
    /// Of the haptic loop, if one runs.
    pub(crate) meters: Option<Arc<Meters>>,
}

impl HapticsScene {
    /// Instruments alone.
    pub fn without_organ(tools: Vec<Tool>) -> Self {
        let stiffness_n_per_m = vec![0.0; tools.len()];
        Self { tools, surface: None, stiffness_n_per_m, meters: None }
    }
}

/// The haptics machine's end.
pub struct HapticsSide {
    /// The exchange of messages.
    pub conversation: Conversation,
    /// Where touches are looked for.
    pub detection: Detection,
    pub(crate) news: Vec<DeviceNews>,
}

/// The haptics machine: sends where its devices are and what they touch, gives their loop the models that come. `links` are
/// the simulation's ends of the instruments that devices hold; the others stay at their homes.
///
/// # Errors
/// When the system gives no thread, or the surface is none.
pub fn start_haptics(
    link: Link,
    identity: Identity,
    scene: HapticsScene,
    links: Vec<ToolLink>,
) -> anyhow::Result<HapticsSide> {
    let HapticsScene { tools, surface, stiffness_n_per_m, meters } = scene;
    let status = Arc::new(Mutex::new(HeldSurface::default()));
    let mut hands = HandsOut { hands: Vec::new(), status: Arc::clone(&status), meters, last_figures_ns: 0 };
    let mut tissues = Vec::new();
    let (mut motions, mut models) = (Vec::new(), Vec::new());
    for tool in &tools {
        motions.push(exchange(Motion::of(tool.home, false)).1);
        models.push(exchange(PublishedModel::default()).0);
    }
    let mut news = Vec::new();
    for ToolLink { tool, device_name, models: of_tool, motions: moved, statuses, .. } in links {
        motions[tool] = moved;
        models[tool] = of_tool;
        news.push(DeviceNews { device_name, statuses });
    }
    let mut watched = Vec::new();
    for (((tool, stiffness_n_per_m), motions), models) in
        tools.iter().zip(stiffness_n_per_m).zip(motions).zip(models)
    {
        let (hands_in, hands_out) = exchange(Hand { pose: tool.home, is_held: false, detected: None });
        let (told_in, told) = exchange(Told::default());
        hands.hands.push(hands_out);
        tissues.push(told_in);
        let ends = WatchedEnds { motions, tissues: told, models, hands: hands_in };
        watched.push(Watched::new(tool, stiffness_n_per_m, ends));
    }
    let (surfaces_in, surfaces) = sync_channel(1);
    let (mut held, mut collected) = (None, SurfaceIn::default());
    if let Some(list) = surface {
        let name = name_of(&list);
        held = Some(NamedSurface { hash: name.hash, copy: Box::new(SurfaceCopy::new(&list)?) });
        collected = SurfaceIn::holding(&name);
    }
    let lists = build_surfaces(surfaces_in)?;
    let tissues = TissuesIn { tissues, holds: held.is_some(), collected, status, lists };
    let detection = Detection::start(watched, held, surfaces)?;
    let conversation = Conversation::start(link, identity, hands, tissues)?;
    Ok(HapticsSide { conversation, detection, news })
}

/// The simulating machine: its instruments are in hands that are elsewhere. Answers their ends too, for the simulation.
///
/// # Errors
/// When the system gives no thread.
pub fn start_simulation(
    link: Link,
    identity: Identity,
    homes: &[ToolInput],
    figures: RemoteFigures,
) -> std::io::Result<(Conversation, Vec<ToolLink>)> {
    let status = Arc::new(Mutex::new(HeldSurface::default()));
    let mut hands = HandsIn { tools: Vec::new(), status: Arc::clone(&status), figures };
    let mut tissues =
        TissuesOut { models: Vec::new(), nearby: Vec::new(), surface: SurfaceOut::default(), status };
    let mut links = Vec::new();
    for (tool, &home) in homes.iter().enumerate() {
        let (models, models_out) = exchange(PublishedModel::default());
        let (nearby, nearby_out) = exchange(Nearby::default());
        let (motions_in, motions) = exchange(Motion::of(home, false));
        let (statuses_in, statuses) = exchange(DeviceStatus::Waiting);
        tissues.models.push(models_out);
        tissues.nearby.push(nearby_out);
        hands.tools.push(RemoteTool { motions: motions_in, statuses: statuses_in, last: home, works: false });
        let (device_name, nearby) = (DEVICE_NAME.into(), Some(nearby));
        links.push(ToolLink { tool, device_name, models, motions, statuses, nearby });
    }
    Ok((Conversation::start(link, identity, tissues, hands)?, links))
}

/// What the other thread of the link wrote; the lock is held for a copy only.
fn read(status: &Mutex<HeldSurface>) -> HeldSurface {
    status.lock().map_or_else(|_| HeldSurface::default(), |status| *status)
}

fn write(status: &Mutex<HeldSurface>, value: HeldSurface) {
    if let Ok(mut status) = status.lock() {
        *status = value;
    }
}

struct HandsOut {
    hands: Vec<Latest<Hand>>,
    status: Arc<Mutex<HeldSurface>>,
    meters: Option<Arc<Meters>>,
    last_figures_ns: u64,
}

impl Outgoing for HandsOut {
    fn wakes(&self, thread: Thread) {
        self.hands.iter().for_each(|hands| hands.wakes(thread.clone()));
    }

    fn unseen(&mut self, now_ns: u64) -> Option<Content> {
        // All of them must be asked: each remembers what it has shown.
        let n_new = self.hands.iter_mut().filter_map(Latest::get_new).count();
        (n_new > 0).then(|| self.latest(now_ns))
    }

    fn latest(&mut self, now_ns: u64) -> Content {
        let mut figures = None;
        if let Some(meters) = &self.meters
            && now_ns - self.last_figures_ns >= FIGURES_PAUSE_NS
        {
            self.last_figures_ns = now_ns;
            figures = Some(Box::new(meters.report()));
        }
        let hands = self.hands.iter_mut().map(Latest::get).collect();
        Content::Hands { hands, held: read(&self.status), figures }
    }

    fn piece(&mut self) -> Option<Content> {
        None
    }
}

struct TissuesIn {
    tissues: Vec<Publisher<Told>>,
    /// Whether this machine detects at all.
    holds: bool,
    collected: SurfaceIn,
    status: Arc<Mutex<HeldSurface>>,
    lists: Sender<(u64, SurfaceList)>,
}

/// Makes the search of each surface that came with its hash, in a thread of its own: messages and detection go on beside it. It ends with
/// the link.
fn build_surfaces(surfaces: SyncSender<NamedSurface>) -> std::io::Result<Sender<(u64, SurfaceList)>> {
    let (lists_in, lists) = channel::<(u64, SurfaceList)>();
    let build = move || {
        for (hash, list) in lists {
            match SurfaceCopy::new(&list) {
                Ok(copy) => {
                    let named = NamedSurface { hash, copy: Box::new(copy) };
                    if surfaces.send(named).is_err() {
                        return;
                    }
                }
                Err(error) => eprintln!("link: the simulation's surface cannot be used: {error}"),
            }
        }
    };
    std::thread::Builder::new().name("surfaces".into()).spawn(build)?;
    Ok(lists_in)
}

impl Incoming for TissuesIn {
    fn take(&mut self, content: Content, now_ns: u64, on_the_way_ns: u64) {
        let (tissues, surface) = match content {
            Content::Tissues { tissues, surface } => (tissues, surface),
            Content::Piece(piece) => {
                if let Some(surface) = self.collected.take(piece) {
                    // The thread ends with this side.
                    let _ = self.lists.send(surface);
                }
                return write(&self.status, self.collected.status());
            }
            Content::Hands { .. } => return,
        };
        if self.holds {
            self.collected.want(&surface);
            write(&self.status, self.collected.status());
        }
        for (told, tissue) in self.tissues.iter_mut().zip(tissues) {
            // On this machine's clock. Nothing was made in the other one's simulation yet: it says 0 as in one program.
            let age_ns = tissue.age_ns.saturating_add(on_the_way_ns);
            let made_ns = if tissue.age_ns == NEVER { 0 } else { now_ns.saturating_sub(age_ns).max(1) };
            let published = PublishedModel { model: tissue.model, made_ns };
            told.publish(Told::new(published, surface, &tissue.nodes));
        }
    }

    /// The models grow old: the law lets go by itself, as when the simulation stalls.
    fn cut(&mut self) {}
}

/// The age of a model that was not made.
const NEVER: u64 = u64::MAX;

struct TissuesOut {
    models: Vec<Latest<PublishedModel>>,
    nearby: Vec<Latest<Nearby>>,
    surface: SurfaceOut,
    /// What the other machine holds.
    status: Arc<Mutex<HeldSurface>>,
}

impl Outgoing for TissuesOut {
    fn wakes(&self, thread: Thread) {
        self.models.iter().for_each(|models| models.wakes(thread.clone()));
    }

    fn unseen(&mut self, now_ns: u64) -> Option<Content> {
        let n_new = self.models.iter_mut().filter_map(Latest::get_new).count();
        (n_new > 0).then(|| self.latest(now_ns))
    }

    fn latest(&mut self, now_ns: u64) -> Content {
        let mut surface = SurfaceName::default();
        let mut tissues = Vec::with_capacity(self.models.len());
        for (models, nearby) in self.models.iter_mut().zip(&mut self.nearby) {
            let PublishedModel { model, made_ns } = models.get();
            let age_ns = if made_ns == 0 { NEVER } else { now_ns.saturating_sub(made_ns) };
            let nearby = nearby.get();
            if nearby.version != 0 {
                self.surface.offer(&nearby.whole);
                // One that is being cut has no name yet.
                let name = self.surface.name();
                let unnamed = SurfaceName { version: nearby.version, ..SurfaceName::default() };
                surface = if name.version == nearby.version { name } else { unnamed };
            }
            tissues.push(Tissue { model, age_ns, nodes: nearby.nodes().to_vec() });
        }
        Content::Tissues { tissues, surface }
    }

    fn piece(&mut self) -> Option<Content> {
        self.surface.piece(&read(&self.status)).map(Content::Piece)
    }
}

struct RemoteTool {
    motions: Publisher<Motion>,
    statuses: Publisher<DeviceStatus>,
    last: ToolInput,
    works: bool,
}

struct HandsIn {
    tools: Vec<RemoteTool>,
    status: Arc<Mutex<HeldSurface>>,
    figures: RemoteFigures,
}

impl Incoming for HandsIn {
    fn take(&mut self, content: Content, _: u64, _: u64) {
        let Content::Hands { hands, held, figures } = content else { return };
        write(&self.status, held);
        if let Some(figures) = figures {
            self.figures.put(Some(*figures));
        }
        for (tool, Hand { pose, is_held, detected }) in self.tools.iter_mut().zip(hands) {
            tool.last = pose;
            tool.motions.publish(Motion { pose, is_held, detected });
            if !std::mem::replace(&mut tool.works, true) {
                tool.statuses.publish(DeviceStatus::Works);
            }
        }
    }

    /// The instruments stay where they were: nobody holds them.
    fn cut(&mut self) {
        self.figures.put(None);
        for tool in &mut self.tools {
            tool.motions.publish(Motion::of(tool.last, false));
            tool.works = false;
            tool.statuses.publish(DeviceStatus::Lost("nothing comes over the link".into()));
        }
    }
}
