//! Detection on the haptics machine: a thread beside the haptic loop looks at every move where the instruments touch the
//! organ's surface. What it finds is felt at once and goes to the simulation with the pose; what the simulation answers goes
//! on to the loop. The loop never waits for it.
//!
//! Cotin, Delingette and Ayache 1998 (RR-3511), s. 6.2, fig. 14: collision detection and force on the machine with the device.

use super::contact_messages::SurfaceName;
use super::messages::Hand;
use glisson::haptics::{HapticModel, Touch};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::NodeId;
use glisson::tool::external_detection::ExternalDetection;
use glisson::tool::{MAX_TOOLS, Tool, ToolInput};
use glisson::world::detection::{SurfaceCopy, ToolDetector};
use glisson_runtime::elsewhere::{MOST_NODES, NodePlace};
use glisson_runtime::exchange::{Latest, Publisher};
use glisson_runtime::haptic_loop::{Motion, PublishedModel};
use glisson_runtime::histogram::Histogram;
use glisson_runtime::realtime::{make_prompt, now_ns};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;
use std::time::Duration;

/// Longest wait, after which the thread sees whether it should end.
const PATIENCE: Duration = Duration::from_millis(20);
/// A touch that the simulation does not know though its models are younger than the touch by so much [ns], and by two of
/// their periods, was refused: held tissue, a blade at work. A choice.
const REFUSED_NS: u64 = 100_000_000;
/// Until the surface is brought up to date again passes so many times what that took: a large organ leaves time for looking.
const REFRESH_PAUSE: u64 = 3;

/// What the link brought for an instrument.
#[derive(Clone, Copy)]
pub(crate) struct Told {
    pub(crate) published: PublishedModel,
    /// The simulation's surface.
    pub(crate) surface: SurfaceName,
    nodes: [NodePlace; MOST_NODES],
    n_nodes: usize,
}

impl Default for Told {
    fn default() -> Self {
        Self {
            published: PublishedModel::default(),
            surface: SurfaceName::default(),
            nodes: [NodePlace::default(); MOST_NODES],
            n_nodes: 0,
        }
    }
}

impl Told {
    pub(crate) fn new(published: PublishedModel, surface: SurfaceName, nodes: &[NodePlace]) -> Self {
        let mut told = Self { published, surface, ..Self::default() };
        for (place, node) in told.nodes.iter_mut().zip(nodes) {
            *place = *node;
            told.n_nodes += 1;
        }
        told
    }
}

/// A surface and the hash by which it is known.
pub(crate) struct NamedSurface {
    pub(crate) hash: u64,
    pub(crate) copy: Box<SurfaceCopy>,
}

/// One instrument of the thread.
pub(crate) struct Watched {
    detector: ToolDetector,
    /// Stiffness of tissue against the tip until a simulation tells a better one [N/m].
    stiffness_n_per_m: f64,
    has_blade: bool,
    told: Told,
    pose: ToolInput,
    is_held: bool,
    /// When what touches began to [ns]; none while nothing does.
    touches_since_ns: Option<u64>,
    /// Whether that was felt before the simulation knew of it.
    is_felt_alone: bool,
    /// Whether the simulation had it touching.
    was_known: bool,
    motions: Latest<Motion>,
    tissues: Latest<Told>,
    models: Publisher<PublishedModel>,
    hands: Publisher<Hand>,
}

/// Ends of an instrument.
pub(crate) struct WatchedEnds {
    pub(crate) motions: Latest<Motion>,
    pub(crate) tissues: Latest<Told>,
    pub(crate) models: Publisher<PublishedModel>,
    pub(crate) hands: Publisher<Hand>,
}

impl Watched {
    /// `stiffness_n_per_m`: of the scene's tissue against the tip, roughly.
    pub(crate) fn new(tool: &Tool, stiffness_n_per_m: f64, ends: WatchedEnds) -> Self {
        let WatchedEnds { motions, tissues, models, hands } = ends;
        Self {
            detector: ToolDetector::new(tool),
            stiffness_n_per_m,
            has_blade: tool.kind.blade().is_some(),
            told: Told::default(),
            pose: tool.home,
            is_held: false,
            touches_since_ns: None,
            is_felt_alone: false,
            was_known: false,
            motions,
            tissues,
            models,
            hands,
        }
    }

    /// Takes what is new; answers whether the hand moved and whether the link brought something.
    fn take(&mut self, surface: Option<&mut NamedSurface>) -> [bool; 2] {
        let told = self.tissues.get_new();
        if let Some(told) = told {
            self.told = told;
            let model = &told.published.model;
            let along = model.normal.dot(model.stiffness_n_per_m * model.normal);
            if along > 0.0 {
                self.stiffness_n_per_m = along;
            }
            if let Some(surface) = surface.filter(|surface| surface.hash == told.surface.hash) {
                for place in &told.nodes[..told.n_nodes] {
                    surface.copy.place(NodeId(place.node), place.position_m());
                }
            }
        }
        let motion = self.motions.get_new();
        if let Some(motion) = motion {
            (self.pose, self.is_held) = (motion.pose, motion.is_held);
        }
        [motion.is_some(), told.is_some()]
    }

    /// Looks, and hands the result on. `surface`: the one that the simulation has, if this machine holds it.
    fn look(&mut self, surface: Option<&SurfaceCopy>, counts: &Counts) {
        let mut hand = Hand { pose: self.pose, is_held: self.is_held, detected: None };
        match surface.filter(|_| self.is_held) {
            Some(surface) => {
                let begun_ns = now_ns();
                let detected = self.detector.look(surface, &self.pose);
                counts.look.record(now_ns() - begun_ns);
                if detected.is_free() {
                    self.touches_since_ns = None;
                } else if self.touches_since_ns.is_none() {
                    (self.touches_since_ns, self.is_felt_alone) = (Some(begun_ns), false);
                    Counts::add(&counts.n_touches);
                }
                // A cut that was undone has a new number, and the surface of before.
                hand.detected =
                    Some(ExternalDetection { surface_version: self.told.surface.version, ..detected });
            }
            None => {
                self.detector.lift();
                self.touches_since_ns = None;
            }
        }
        self.hands.publish(hand);
    }

    /// What the haptic loop is to feel: what the simulation says, and what was found before it knows.
    fn feel(&mut self, counts: &Counts) -> PublishedModel {
        let told = self.told.published;
        if told.model.touch != Touch::Free {
            self.was_known = true;
            self.is_felt_alone = false;
            return told;
        }
        if std::mem::take(&mut self.was_known) {
            // It let go: what is still in the way of the copy is not in the way of the organ.
            self.end_touches();
        }
        let Some(since_ns) = self.touches_since_ns else { return told };
        let periods_ns = (2e9 * told.model.period_s) as u64;
        if told.made_ns > since_ns.saturating_add(REFUSED_NS + periods_ns) {
            self.end_touches();
            return told;
        }
        // Without a simulation there is no force; an edge that is on does not push.
        if told.made_ns == 0 || self.has_blade && self.pose.is_triggered() {
            return told;
        }
        let Some((_, touch)) = self.detector.touches().next() else { return told };
        let normal = touch.found.normal;
        let told_n_per_m = normal.dot(told.model.stiffness_n_per_m * normal);
        let stiffness_n_per_m = if told_n_per_m > 0.0 { told_n_per_m } else { self.stiffness_n_per_m };
        if !std::mem::replace(&mut self.is_felt_alone, true) {
            Counts::add(&counts.n_felt_first);
        }
        // A plane at the touched place that is met from where the tip was when the part touched.
        let model = HapticModel {
            tip_m: touch.tip_m,
            stiffness_n_per_m: DMat3::IDENTITY * stiffness_n_per_m,
            surface_m: touch.surface_m,
            normal,
            gap_m: 0.0,
            surface_velocity_m_per_s: DVec3::ZERO,
            n_parts: 0,
            ..told.model
        };
        let alone_ns = now_ns().saturating_sub(told.made_ns.max(since_ns));
        counts.longest_alone_ns.fetch_max(alone_ns, Ordering::Relaxed);
        let force_n = model.force_at(self.pose.tip_in_world_m, 0.0).length();
        counts.greatest_force_un.fetch_max((force_n * 1e6) as u64, Ordering::Relaxed);
        PublishedModel { model, ..told }
    }

    fn end_touches(&mut self) {
        self.detector.end_touches();
        self.touches_since_ns = None;
    }
}

/// What the thread did.
#[derive(Default)]
struct Counts {
    look: Histogram,
    n_touches: AtomicU64,
    n_felt_first: AtomicU64,
    longest_alone_ns: AtomicU64,
    greatest_force_un: AtomicU64,
    n_surfaces: AtomicU64,
}

impl Counts {
    fn add(counter: &AtomicU64) {
        counter.fetch_add(1, Ordering::Relaxed);
    }
}

/// What the thread did, for people and tests.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub(crate) struct DetectionReport {
    /// Looks, and how long one takes [us].
    pub(crate) n_looks: u64,
    pub(crate) look_us_p50: f64,
    pub(crate) look_us_p99: f64,
    /// Touches that began, and those of them that were felt before the simulation knew.
    pub(crate) n_touches: u64,
    pub(crate) n_felt_first: u64,
    /// Longest time that one was felt without word from the simulation [ms], and the largest force then [N].
    pub(crate) longest_alone_ms: f64,
    pub(crate) greatest_force_alone_n: f64,
    /// Surfaces that came over the link.
    pub(crate) n_surfaces: u64,
}

/// The running thread; ends when dropped.
pub struct Detection {
    ends: Arc<AtomicBool>,
    counts: Arc<Counts>,
    thread: Option<JoinHandle<()>>,
}

impl Detection {
    /// Starts it. New surfaces come through `surfaces`.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub(crate) fn start(
        tools: Vec<Watched>,
        surface: Option<NamedSurface>,
        surfaces: Receiver<NamedSurface>,
    ) -> std::io::Result<Self> {
        let (ends, counts) = (Arc::new(AtomicBool::new(false)), Arc::new(Counts::default()));
        let (stop, counted) = (Arc::clone(&ends), Arc::clone(&counts));
        let run = move || watch(tools, surface, surfaces, &counted, &stop);
        let thread = std::thread::Builder::new().name("detection".into()).spawn(run)?;
        Ok(Self { ends, counts, thread: Some(thread) })
    }

    /// How it goes.
    pub(crate) fn report(&self) -> DetectionReport {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let look = self.counts.look.percentiles();
        DetectionReport {
            n_looks: look.n,
            look_us_p50: look.p50_ns as f64 * 1e-3,
            look_us_p99: look.p99_ns as f64 * 1e-3,
            n_touches: of(&self.counts.n_touches),
            n_felt_first: of(&self.counts.n_felt_first),
            longest_alone_ms: of(&self.counts.longest_alone_ns) as f64 * 1e-6,
            greatest_force_alone_n: of(&self.counts.greatest_force_un) as f64 * 1e-6,
            n_surfaces: of(&self.counts.n_surfaces),
        }
    }
}

impl Drop for Detection {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // A panic was printed when it happened.
            let _ = thread.join();
        }
    }
}

#[expect(clippy::needless_pass_by_value, reason = "a receiver belongs to the thread that reads it")]
fn watch(
    mut tools: Vec<Watched>,
    mut surface: Option<NamedSurface>,
    surfaces: Receiver<NamedSurface>,
    counts: &Counts,
    stop: &AtomicBool,
) {
    make_prompt();
    for tool in &tools {
        tool.motions.wakes(std::thread::current());
        tool.tissues.wakes(std::thread::current());
    }
    let (mut refreshed_ns, mut refresh_took_ns) = (0, 0);
    while !stop.load(Ordering::Relaxed) {
        if let Ok(new) = surfaces.try_recv() {
            surface = Some(new);
            Counts::add(&counts.n_surfaces);
        }
        let mut news = [false; 2];
        let mut moved = [false; MAX_TOOLS];
        for (tool, moved) in tools.iter_mut().zip(&mut moved) {
            let [has_moved, is_told] = tool.take(surface.as_mut());
            *moved = has_moved;
            news = [news[0] || has_moved, news[1] || is_told];
        }
        if news == [false; 2] {
            std::thread::park_timeout(PATIENCE);
            continue;
        }
        let mut has_changed = false;
        if let Some(surface) = &mut surface {
            let begun_ns = now_ns();
            if begun_ns.saturating_sub(refreshed_ns) >= REFRESH_PAUSE * refresh_took_ns {
                has_changed = surface.copy.refresh();
                refreshed_ns = now_ns();
                refresh_took_ns = refreshed_ns - begun_ns;
            }
        }
        for (tool, moved) in tools.iter_mut().zip(moved) {
            let held = surface.as_ref().filter(|surface| surface.hash == tool.told.surface.hash);
            // What the surface moves onto is found as well.
            if moved || has_changed && tool.is_held {
                tool.look(held.map(|surface| &*surface.copy), counts);
            }
            let felt = tool.feel(counts);
            tool.models.publish(felt);
        }
    }
}
