//! Two ends and what lies between them: loss, doubled and overtaken messages, cuts, strangers.

use super::bridge::{HapticsScene, HapticsSide, start_haptics, start_simulation};
use super::conversation::{Conversation, Identity, LinkReport};
use super::detector::Detection;
use super::link::{Link, ReceiveHalf, Role, SendHalf, udp};
use super::messages::SceneHash;
use super::seal::Seal;
use glisson::haptics::{HapticModel, Touch};
use glisson::math::DVec3;
use glisson::tool::{Tool, ToolInput};
use glisson_runtime::exchange::{Latest, Publisher, exchange};
use glisson_runtime::haptic_loop::{DeviceStatus, Motion, PublishedModel, ToolLink};
use glisson_runtime::realtime::now_ns;
use glisson_runtime::remote_figures::RemoteFigures;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// Half of a link in memory that loses, doubles and delays one message in five each.
struct BadSender {
    out: Sender<Vec<u8>>,
    kept: Option<Vec<u8>>,
    random: u64,
}

impl SendHalf for BadSender {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        // Nobody may be there any more.
        let put = |bytes: Vec<u8>| drop(self.out.send(bytes));
        match self.random % 5 {
            0 => {}
            1 => (0..2).for_each(|_| put(message.to_vec())),
            2 if self.kept.is_none() => self.kept = Some(message.to_vec()),
            _ => {
                put(message.to_vec());
                // The one that was kept comes after a newer one.
                self.kept.take().into_iter().for_each(put);
            }
        }
        Ok(())
    }
}

struct MemoryReceiver(Receiver<Vec<u8>>);

impl ReceiveHalf for MemoryReceiver {
    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        match self.0.recv_timeout(wait) {
            Ok(message) => {
                buffer[..message.len()].copy_from_slice(&message);
                Ok(Some(message.len()))
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(io::ErrorKind::NotConnected.into()),
        }
    }

    fn trust_sender(&mut self) {}

    fn ask_sender(&mut self) {}
}

pub(super) fn bad_links() -> (Link, Link) {
    let (to_simulation, from_haptics) = channel();
    let (to_haptics, from_simulation) = channel();
    let link = |out, incoming, random| Link {
        sender: Box::new(BadSender { out, kept: None, random }),
        receiver: Box::new(MemoryReceiver(incoming)),
    };
    (link(to_simulation, from_simulation, 11), link(to_haptics, from_haptics, 23))
}

fn home() -> ToolInput {
    ToolInput::at(DVec3::ZERO, DVec3::Z)
}

pub(super) fn identity(role: Role, scene: u8) -> Identity {
    Identity { role, scene: SceneHash([scene; 32]), n_tools: 1, seal: Seal::Check }
}

/// The haptics machine: what its haptic loop would hold, and the conversation.
pub(super) struct HapticsEnd {
    motions: Publisher<Motion>,
    pub(super) models: Latest<PublishedModel>,
    conversation: Conversation,
    pub(super) detection: Detection,
}

impl HapticsEnd {
    pub(super) fn start(link: Link, identity: Identity) -> Self {
        let scene = HapticsScene::without_organ(vec![Tool::probe("hand", 5e-3, home())]);
        Self::with(link, identity, scene)
    }

    pub(super) fn with(link: Link, identity: Identity, scene: HapticsScene) -> Self {
        let (models_in, models) = exchange(PublishedModel::default());
        let (motions, motions_out) = exchange(Motion::of(home(), false));
        let (_, statuses) = exchange(DeviceStatus::Waiting);
        let held = ToolLink {
            tool: 0,
            device_name: "hand".into(),
            models: models_in,
            motions: motions_out,
            statuses,
            nearby: None,
        };
        let HapticsSide { conversation, detection, .. } =
            start_haptics(link, identity, scene, vec![held]).unwrap();
        Self { motions, models, conversation, detection }
    }

    pub(super) fn move_to(&mut self, x_m: f64) {
        self.hold(ToolInput { tip_in_world_m: DVec3::X * x_m, ..home() });
    }

    pub(super) fn hold(&mut self, pose: ToolInput) {
        self.motions.publish(Motion::of(pose, true));
    }
}

/// The simulating machine.
pub(super) struct SimulationEnd {
    pub(super) tool: ToolLink,
    pub(super) conversation: Conversation,
    pub(super) figures: RemoteFigures,
}

impl SimulationEnd {
    pub(super) fn start(link: Link, identity: Identity) -> Self {
        let figures = RemoteFigures::default();
        let (conversation, mut links) = start_simulation(link, identity, &[home()], figures.clone()).unwrap();
        Self { tool: links.pop().unwrap(), conversation, figures }
    }

    pub(super) fn publish(&mut self, step: u64) {
        let model = HapticModel { step, touch: Touch::Grasp, ..HapticModel::default() };
        self.tool.models.publish(PublishedModel { model, made_ns: now_ns() });
    }
}

/// Waits for what must come soon on a machine that may be busy.
pub(super) fn soon(what: &str, mut holds: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(20);
    while !holds() {
        assert!(Instant::now() < end, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn the_newest_state_arrives_over_a_bad_link_and_never_an_older_one() {
    let (at_haptics, at_simulation) = bad_links();
    let mut haptics = HapticsEnd::start(at_haptics, identity(Role::Haptics, 1));
    let mut simulation = SimulationEnd::start(at_simulation, identity(Role::Simulation, 1));
    let (mut last_x_m, mut last_step) = (0.0, 0);
    for step in 1..=400 {
        haptics.move_to(step as f64);
        simulation.publish(step);
        std::thread::sleep(Duration::from_millis(1));
        let x_m = simulation.tool.motions.get().pose.tip_in_world_m.x;
        let seen = haptics.models.get().model.step;
        assert!(x_m >= last_x_m && seen >= last_step, "{x_m} after {last_x_m}, {seen} after {last_step}");
        (last_x_m, last_step) = (x_m, seen);
    }
    soon("the last pose and model", || {
        simulation.tool.motions.get().pose.tip_in_world_m.x == 400.0 && haptics.models.get().model.step == 400
    });
    assert!(simulation.tool.motions.get().is_held);
    let age_ns = now_ns() - haptics.models.get().made_ns;
    assert!(age_ns < 10_000_000_000, "{age_ns}");
    let LinkReport { counts, n_refused, round_trip, .. } = simulation.conversation.report();
    assert!(counts.n_taken > 50 && counts.n_lost > 10 && counts.n_late > 10, "{counts:?}");
    assert!(n_refused == 0 && counts.n_sessions == 1 && round_trip.n > 50, "{n_refused}, {round_trip:?}");
}

#[test]
fn a_cut_lets_the_instrument_stay_and_both_sides_find_each_other_again() {
    let address: SocketAddr = free_address();
    let link = |role| udp(address, role).unwrap();
    // The haptics machine is there first.
    let mut haptics = HapticsEnd::start(link(Role::Haptics), identity(Role::Haptics, 1));
    haptics.move_to(0.1);
    let mut simulation = SimulationEnd::start(link(Role::Simulation), identity(Role::Simulation, 1));
    soon("the pose", || simulation.tool.motions.get().pose.tip_in_world_m.x == 0.1);
    assert_eq!(simulation.tool.statuses.get(), DeviceStatus::Works);
    simulation.publish(1);
    soon("the model", || haptics.models.get().model.step == 1);

    drop(haptics);
    soon("the cut", || !simulation.tool.motions.get().is_held);
    assert_eq!(simulation.tool.motions.get().pose.tip_in_world_m.x, 0.1);
    assert!(matches!(simulation.tool.statuses.get(), DeviceStatus::Lost(_)));

    // A newcomer from another port is current after one message.
    simulation.publish(2);
    let mut haptics = HapticsEnd::start(link(Role::Haptics), identity(Role::Haptics, 1));
    haptics.move_to(0.3);
    soon("the new pose", || simulation.tool.motions.get().pose.tip_in_world_m.x == 0.3);
    soon("the new model", || haptics.models.get().model.step == 2);
    let report = simulation.conversation.report();
    assert_eq!((report.counts.n_sessions, report.n_cuts, report.is_up), (2, 1, true));
}

fn free_address() -> SocketAddr {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

#[test]
fn another_scene_the_same_role_and_strangers_are_refused_with_a_reason() {
    let refusal = |other: Identity| {
        let address = free_address();
        let mut simulation =
            SimulationEnd::start(udp(address, Role::Simulation).unwrap(), identity(Role::Simulation, 1));
        let link = udp(address, Role::Haptics).unwrap();
        let conversation = match other.role {
            Role::Haptics => HapticsEnd::start(link, other).conversation,
            Role::Simulation => SimulationEnd::start(link, other).conversation,
        };
        soon("a refusal", || simulation.conversation.report().refused.is_some());
        assert!(!simulation.tool.motions.get().is_held);
        drop(conversation);
        let report = simulation.conversation.report();
        assert_eq!(report.counts.n_taken, 0);
        report.refused.unwrap()
    };
    let reason = refusal(identity(Role::Haptics, 2));
    assert!(reason.contains("another scene (0202020202020202, here 0101010101010101)"), "{reason}");
    let reason = refusal(identity(Role::Simulation, 1));
    assert!(reason.contains("--role haptics"), "{reason}");
    let reason = refusal(Identity { seal: Seal::Key(Box::new([1; 32])), ..identity(Role::Haptics, 1) });
    assert!(reason.contains("--link-key"), "{reason}");
}

/// Keeps a copy of all that is sent.
struct Overheard {
    sender: Box<dyn SendHalf>,
    copies: Arc<Mutex<Vec<Vec<u8>>>>,
}

impl SendHalf for Overheard {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.copies.lock().unwrap().push(message.to_vec());
        self.sender.send(message)
    }
}

#[test]
fn a_recorded_session_of_a_sealed_link_steers_nothing_and_the_real_machine_gets_through() {
    let sealed = |role| Identity { seal: Seal::Key(Box::new([7; 32])), ..identity(role, 1) };
    let address = free_address();
    let copies = Arc::new(Mutex::new(Vec::new()));
    {
        let mut simulation =
            SimulationEnd::start(udp(address, Role::Simulation).unwrap(), sealed(Role::Simulation));
        let Link { sender, receiver } = udp(address, Role::Haptics).unwrap();
        let sender = Box::new(Overheard { sender, copies: Arc::clone(&copies) });
        let mut haptics = HapticsEnd::start(Link { sender, receiver }, sealed(Role::Haptics));
        soon("some messages", || {
            haptics.move_to(0.1);
            copies.lock().unwrap().len() > 30
        });
        soon("the pose", || simulation.tool.motions.get().pose.tip_in_world_m.x == 0.1);
        simulation.publish(1);
        soon("the model", || haptics.models.get().model.step == 1);
    }
    let copies = std::mem::take(&mut *copies.lock().unwrap());
    assert!(copies.len() > 10, "{}", copies.len());

    let mut simulation =
        SimulationEnd::start(udp(address, Role::Simulation).unwrap(), sealed(Role::Simulation));
    let thief = UdpSocket::bind("127.0.0.1:0").unwrap();
    thief.connect(address).unwrap();
    thief.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let (mut n_sent, mut n_answers) = (0, 0);
    let mut replay = |simulation: &mut SimulationEnd, n: usize| {
        for copy in copies.iter().cycle().take(n) {
            thief.send(copy).unwrap();
            n_sent += 1;
            n_answers += u32::from(thief.recv(&mut [0; 1 << 14]).is_ok());
            let motion = simulation.tool.motions.get();
            assert!(motion.pose.tip_in_world_m.x != 0.1, "{motion:?}");
        }
        (n_sent, n_answers)
    };
    replay(&mut simulation, 100);
    // Longer than a silence after which an older session is believed.
    std::thread::sleep(Duration::from_millis(1_100));
    let (n_sent, n_answers) = replay(&mut simulation, 100);
    assert!(n_answers <= n_sent, "{n_answers} answers to {n_sent} recorded messages");
    let report = simulation.conversation.report();
    assert!(report.counts.n_taken == 0 && !report.is_up && report.n_refused == 0, "{report:?}");
    assert_eq!(simulation.tool.statuses.get(), DeviceStatus::Waiting);

    // The real one comes while the thief goes on.
    let mut haptics = HapticsEnd::start(udp(address, Role::Haptics).unwrap(), sealed(Role::Haptics));
    haptics.move_to(0.3);
    soon("the real pose", || {
        replay(&mut simulation, 2);
        simulation.tool.motions.get().pose.tip_in_world_m.x == 0.3
    });
    simulation.publish(2);
    soon("the model", || haptics.models.get().model.step == 2);
    replay(&mut simulation, 50);
    let report = simulation.conversation.report();
    assert!(report.is_up && report.counts.n_sessions == 1, "{report:?}");
}
