//! Publishes the topics over a zenoh session and takes the orders that come over it (feature `net`).

use super::device::{Device, Situation, State};
use super::keys::{Entity, Node, attachment, topic_key};
use super::orders::{Order, OrderError, OrderKind, StateCommand};
use super::topics::{Described, Pace, Scene, Topic};
use anyhow::{Context, anyhow};
use glisson_runtime::live::Command;
use glisson_runtime::published::Published;
use glisson_runtime::steering::{Seat, Steering};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::watch;
use zenoh::Wait;

const NODE: &str = "glisson";
/// Between two looks at what is displayed: about half a frame. Orders are followed at once.
const LOOK: Duration = Duration::from_millis(8);
/// Between two surfaces, and between two repetitions of a state that does not change.
const SLOW: Duration = Duration::from_millis(100);
/// Orders that wait; more are dropped, as of a queue in ROS.
const MOST_WAITING: usize = 64;
/// Longest order: a pose has some 100 bytes, and a frame's name.
const LONGEST_ORDER_BYTES: usize = 4_096;
/// Control that was not used for so long is given back, so that a client that is gone keeps no viewer out; a choice.
const LONGEST_SILENCE: Duration = Duration::from_secs(10);
/// The same complaint is not made more often.
const TOLD_AGAIN: Duration = Duration::from_secs(2);

struct TopicPublisher {
    topic: Topic,
    publisher: zenoh::pubsub::Publisher<'static>,
    id: [u8; 16],
    sequence: i64,
    last: Option<Instant>,
}

/// An order as it came, and for which instrument.
type Arrival = (usize, Result<Order, OrderError>);

/// Everything of the node that lives as long as it.
struct Session {
    publishers: Vec<TopicPublisher>,
    _subscribers: Vec<zenoh::pubsub::Subscriber<()>>,
    /// Others see node, publishers and subscribers as long as these live.
    _tokens: Vec<zenoh::liveliness::LivelinessToken>,
    over: Over,
}

/// The session that carries the topics.
pub(crate) struct Over {
    pub(crate) session: zenoh::Session,
    /// Whether it is closed with the topics; otherwise others use it, too.
    pub(crate) is_own: bool,
}

/// What is followed, and by whose leave.
struct Orders {
    arrivals: Receiver<Arrival>,
    /// What ended the last wait.
    first: Option<Arrival>,
    /// None: nobody gives orders this way.
    seat: Option<Seat>,
    devices: Vec<Device>,
    last_order: Option<Instant>,
    told: Option<Instant>,
}

/// Publishes in `domain`, and takes orders for the instruments that are `described` to follow any, until the sender of
/// `published` is gone.
///
/// # Errors
/// When no session or no place at the controls can be had.
pub(crate) fn spawn(
    over: Over,
    domain: u32,
    described: Described,
    published: watch::Receiver<Arc<Published>>,
    steering: &Steering,
) -> anyhow::Result<JoinHandle<()>> {
    let seat = if described.takes_orders() {
        Some(steering.sit_down().context("all places at the controls are taken")?)
    } else {
        None
    };
    let (tell, arrivals) = sync_channel(MOST_WAITING);
    let mut session = Session::open(over, domain, &described, &tell).map_err(|e| anyhow!("zenoh: {e}"))?;
    let mut orders =
        Orders { arrivals, first: None, seat, devices: described.devices(), last_order: None, told: None };
    let thread = std::thread::Builder::new().name("ros2".into()).spawn(move || {
        // As long as it lives the channel is open, and waiting on it waits.
        let _tell = tell;
        run(&described, &mut session, &mut orders, published);
        session.close();
    })?;
    Ok(thread)
}

impl Session {
    fn open(
        over: Over,
        domain: u32,
        described: &Described,
        tell: &SyncSender<Arrival>,
    ) -> Result<Self, zenoh::Error> {
        let session = &over.session;
        let id = session.zid().to_string();
        let node = Node { domain, session: &id, name: NODE };
        let mut tokens = vec![session.liveliness().declare_token(node.token()).wait()?];
        let (mut publishers, mut subscribers) = (Vec::new(), Vec::new());
        for topic in Topic::all(described) {
            let token = node.topic_token(tokens.len(), Entity::Publisher, &topic.name, topic.message);
            // Any id will do that no other publisher has.
            let mut id = [0; 16];
            id.copy_from_slice(&blake3::hash(token.as_bytes()).as_bytes()[..16]);
            let publisher =
                session.declare_publisher(topic_key(domain, &topic.name, topic.message)).wait()?;
            tokens.push(session.liveliness().declare_token(token).wait()?);
            publishers.push(TopicPublisher { topic, publisher, id, sequence: 0, last: None });
        }
        for (name, tool, kind) in described.orders() {
            let message = kind.topic().1;
            let token = node.topic_token(tokens.len(), Entity::Subscriber, &name, message);
            let tell = tell.clone();
            let subscriber = session
                .declare_subscriber(topic_key(domain, &name, message))
                .callback(move |sample| take(&tell, tool, kind, sample.payload()))
                .wait()?;
            tokens.push(session.liveliness().declare_token(token).wait()?);
            subscribers.push(subscriber);
        }
        Ok(Self { publishers, _subscribers: subscribers, _tokens: tokens, over })
    }

    fn close(self) {
        let Self { publishers, _subscribers, _tokens, over } = self;
        drop((publishers, _subscribers, _tokens));
        if over.is_own {
            // It ends anyway.
            let _ = over.session.close().wait();
        }
    }
}

fn take(tell: &SyncSender<Arrival>, tool: usize, kind: OrderKind, payload: &zenoh::bytes::ZBytes) {
    if payload.len() > LONGEST_ORDER_BYTES {
        return;
    }
    // A full queue loses the order, as a queue in ROS does; what is read is bounded in any case.
    let _ = tell.try_send((tool, kind.read(&payload.to_bytes())));
}

fn run(
    described: &Described,
    session: &mut Session,
    orders: &mut Orders,
    mut published: watch::Receiver<Arc<Published>>,
) {
    let mut latest = Arc::clone(&published.borrow_and_update());
    let mut before: Option<Arc<Published>> = None;
    let mut told_states: Vec<(State, bool, bool)> = Vec::new();
    let mut was_told = false;
    let mut is_new = true;
    let mut last_tick = Instant::now();
    loop {
        orders.follow(&latest, std::mem::replace(&mut last_tick, Instant::now()).elapsed());
        let states: Vec<_> = orders.devices.iter().map(|d| (d.state(), d.is_homed(), d.is_busy())).collect();
        let time = SystemTime::now();
        let sent_ns = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64);
        let scene = Scene {
            snapshot: &latest.snapshot,
            before: before.as_ref().map(|before| &before.snapshot),
            devices: &orders.devices,
            time,
        };
        for publisher in &mut session.publishers {
            let is_slow_due = publisher.last.is_none_or(|last| last.elapsed() >= SLOW);
            let changed =
                publisher.topic.tells_state_of().is_some_and(|n| states.get(n) != told_states.get(n));
            let is_due = match publisher.topic.pace() {
                Pace::EveryFrame => is_new,
                Pace::SomeFrames => is_new && is_slow_due,
                Pace::Steady => changed || is_slow_due,
            };
            if !is_due {
                continue;
            }
            publisher.last = Some(Instant::now());
            let Some(message) = publisher.topic.message_of(described, scene) else { continue };
            publisher.sequence += 1;
            let beside = attachment(publisher.sequence, sent_ns, &publisher.id);
            let put = publisher.publisher.put(message).attachment(beside.to_vec()).wait();
            if let (Err(error), false) = (put, was_told) {
                was_told = true;
                eprintln!("ROS 2: publishing failed: {error}");
            }
        }
        told_states = states;
        orders.wait();
        match published.has_changed() {
            Ok(changed) => is_new = changed,
            Err(_) => return,
        }
        if is_new {
            before = Some(std::mem::replace(&mut latest, Arc::clone(&published.borrow_and_update())));
        }
    }
}

impl Orders {
    /// Until an order comes, or it is time to look; follows nothing yet.
    fn wait(&mut self) {
        self.first = self.arrivals.recv_timeout(LOOK).ok();
    }

    /// Follows what came and moves what is under way.
    fn follow(&mut self, latest: &Published, passed: Duration) {
        let Some(seat) = &self.seat else { return };
        let send = |tool, pose| seat.send(Command::Tool { tool, pose });
        let simulation_is_paused = latest.pace.paused;
        let measured = |tool: usize| latest.snapshot.tools.get(tool).map(|tool| tool.pose);
        for (tool, order) in self.first.take().into_iter().chain(self.arrivals.try_iter()) {
            let (Some(device), Some(measured)) = (self.devices.get_mut(tool), measured(tool)) else {
                continue;
            };
            let followed = order.map_err(|error| error.to_string()).and_then(|order| {
                self.last_order = Some(Instant::now());
                let has_control =
                    if needs_control(&order) { seat.may_control() } else { !seat.is_preempted() };
                let now = Situation { measured, has_control, simulation_is_paused };
                device.obey(order, &now).map_err(|refusal| refusal.to_string())
            });
            match followed {
                Ok(Some(pose)) => send(tool, pose),
                Ok(None) => {}
                Err(reason) if self.told.is_none_or(|told| told.elapsed() > TOLD_AGAIN) => {
                    self.told = Some(Instant::now());
                    eprintln!("ROS 2: an order for instrument {tool} is not followed: {reason}");
                }
                Err(_) => {}
            }
        }
        let has_control = !seat.is_preempted();
        for (tool, device) in self.devices.iter_mut().enumerate() {
            let Some(measured) = measured(tool) else { continue };
            let now = Situation { measured, has_control, simulation_is_paused };
            if let Some(pose) = device.tick(passed.as_secs_f64(), &now) {
                send(tool, pose);
            }
        }
        let is_used = self.devices.iter().any(|device| device.state() == State::Enabled);
        let is_silent = self.last_order.is_none_or(|last| last.elapsed() > LONGEST_SILENCE);
        if !is_used || (is_silent && !self.devices.iter().any(Device::is_busy)) {
            seat.release();
        }
    }
}

/// Whether an order moves an instrument or lets it move.
fn needs_control(order: &Order) -> bool {
    use StateCommand::{Disable, Pause, Unhome};
    !matches!(order, Order::State(Disable | Pause | Unhome))
}
