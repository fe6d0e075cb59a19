//! A link over zenoh (feature `net`): two keys, one for each direction. Both sides publish without waiting; of what is
//! received only the newest messages are kept.

use super::link::{Link, ReceiveHalf, Role, SendHalf, ZenohAddress, is_open};
use anyhow::{Context, anyhow};
use std::collections::VecDeque;
use std::io;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex, OnceLock};
use std::time::Duration;
use zenoh::Wait;
use zenoh::qos::{CongestionControl, Priority};

/// What each role says goes under the role's name.
const KEY: &str = "glisson/link";
/// Messages that wait for the receiving thread; older ones are dropped.
const MOST_WAITING: usize = 16;
/// Between two attempts to reach the other machine after a cut [ms].
const RETRY_MS: &str = "200";

/// The configuration for an address.
pub(super) fn config(address: &ZenohAddress, role: Role) -> anyhow::Result<zenoh::Config> {
    if let ZenohAddress::File(path) = address {
        return closed_config(path);
    }
    let mut config = zenoh::Config::default();
    set(&mut config, "mode", "\"peer\"")?;
    if let ZenohAddress::Locator(locator) = address {
        let endpoints = serde_json::to_string(&[locator]).context("a locator is text")?;
        set(&mut config, "scouting/multicast/enabled", "false")?;
        match role {
            Role::Simulation => set(&mut config, "listen/endpoints", &endpoints)?,
            Role::Haptics => {
                set(&mut config, "connect/endpoints", &endpoints)?;
                set(&mut config, "listen/endpoints", "[]")?;
                try_again(&mut config)?;
            }
        }
    }
    Ok(config)
}

fn set(config: &mut zenoh::Config, key: &str, value: &str) -> anyhow::Result<()> {
    config.insert_json5(key, value).map_err(|e| anyhow!("zenoh does not take {key} = {value}: {e}"))
}

/// Who comes first waits for the other one, and after a cut tries again soon.
fn try_again(config: &mut zenoh::Config) -> anyhow::Result<()> {
    set(config, "connect/exit_on_failure", "false")?;
    set(config, "connect/timeout_ms", "-1")?;
    let retry = format!("{{ period_init_ms: {RETRY_MS}, period_max_ms: {RETRY_MS} }}");
    set(config, "connect/retry", &retry)
}

/// As a file says, but with no door open that it does not mention: by itself zenoh listens without TLS on every network and
/// looks for others by multicast.
fn closed_config(path: &Path) -> anyhow::Result<zenoh::Config> {
    let failed = |e: &dyn std::fmt::Display| anyhow!("{}: not a configuration of zenoh: {e}", path.display());
    let mut config = zenoh::Config::from_file(path).map_err(|e| failed(&e))?;
    let open = zenoh::Config::default();
    for (key, closed) in [("listen/endpoints", "[]"), ("scouting/multicast/enabled", "false")] {
        let value = |config: &zenoh::Config| config.get_json(key).map_err(|e| failed(&e));
        if value(&config)? == value(&open)? {
            set(&mut config, key, closed)?;
        }
    }
    if config.get_json("connect/timeout_ms").map_err(|e| failed(&e))?
        == open.get_json("connect/timeout_ms").map_err(|e| failed(&e))?
    {
        try_again(&mut config)?;
    }
    Ok(config)
}

/// Through what strangers get to a session that a file sets up; none: through nothing.
///
/// # Errors
/// When the file is no configuration.
pub(super) fn open_door(path: &Path) -> anyhow::Result<Option<String>> {
    let config = closed_config(path)?;
    let value = |key: &str| -> anyhow::Result<serde_json::Value> {
        let json = config.get_json(key).map_err(|e| anyhow!("{}: {key}: {e}", path.display()))?;
        serde_json::from_str(&json).with_context(|| format!("{}: {key}", path.display()))
    };
    // Each setting may be one for all modes, or one for each.
    let is_on = |value: serde_json::Value| match value {
        serde_json::Value::Object(modes) => modes.values().any(|mode| *mode == true),
        one => one == true,
    };
    if is_on(value("scouting/multicast/enabled")?) {
        return Ok(Some("multicast".to_owned()));
    }
    let is_mutual = value("transport/link/tls/enable_mtls")? == true;
    let mut endpoints = Vec::new();
    for key in ["listen/endpoints", "connect/endpoints"] {
        add_texts(&value(key)?, &mut endpoints);
    }
    Ok(endpoints.into_iter().find(|endpoint| is_open(endpoint, is_mutual)))
}

/// All texts of a list, or of lists in it.
fn add_texts(value: &serde_json::Value, texts: &mut Vec<String>) {
    match value {
        serde_json::Value::String(text) => texts.push(text.clone()),
        serde_json::Value::Array(items) => items.iter().for_each(|item| add_texts(item, texts)),
        serde_json::Value::Object(items) => items.values().for_each(|item| add_texts(item, texts)),
        _ => {}
    }
}

/// Opens a session: as the one of the two machines that has the role.
pub(super) fn open_session(address: &ZenohAddress, role: Role) -> anyhow::Result<zenoh::Session> {
    super::zenoh_log::tell();
    zenoh::open(config(address, role)?).wait().map_err(|e| anyhow!("zenoh: {e}"))
}

/// The session that link and topics share; opened when one of them asks first.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedSession(Arc<OnceLock<zenoh::Session>>);

impl SharedSession {
    /// The session; all ask with the same address and role.
    pub(super) fn get(&self, address: &ZenohAddress, role: Role) -> anyhow::Result<zenoh::Session> {
        if let Some(session) = self.0.get() {
            return Ok(session.clone());
        }
        let session = open_session(address, role)?;
        Ok(self.0.get_or_init(|| session).clone())
    }
}

/// A link over a session of its own.
pub(super) fn open(address: &ZenohAddress, role: Role) -> anyhow::Result<Link> {
    link_over(open_session(address, role)?, role)
}

/// A link over a session that others may use, too.
pub(super) fn link_over(session: zenoh::Session, role: Role) -> anyhow::Result<Link> {
    let publisher = session
        .declare_publisher(format!("{KEY}/{}", role.name()))
        .congestion_control(CongestionControl::Drop)
        .priority(Priority::RealTime)
        .express(true)
        .wait()
        .map_err(|e| anyhow!("zenoh: {e}"))?;
    let waiting = Arc::new(Waiting::default());
    let arrivals = Arc::clone(&waiting);
    let subscriber = session
        .declare_subscriber(format!("{KEY}/{}", role.other().name()))
        .callback(move |sample| arrivals.put(sample.payload().to_bytes().into_owned()))
        .wait()
        .map_err(|e| anyhow!("zenoh: {e}"))?;
    Ok(Link {
        sender: Box::new(ZenohSender { publisher }),
        receiver: Box::new(ZenohReceiver { waiting, _subscriber: subscriber, _session: session }),
    })
}

struct ZenohSender {
    publisher: zenoh::pubsub::Publisher<'static>,
}

impl SendHalf for ZenohSender {
    fn send(&mut self, message: &[u8]) -> io::Result<()> {
        self.publisher.put(message).wait().map_err(|e| io::Error::other(e.to_string()))
    }
}

#[derive(Default)]
struct Waiting {
    messages: Mutex<VecDeque<Vec<u8>>>,
    arrived: Condvar,
}

impl Waiting {
    fn put(&self, message: Vec<u8>) {
        let Ok(mut messages) = self.messages.lock() else { return };
        if messages.len() >= MOST_WAITING {
            messages.pop_front();
        }
        messages.push_back(message);
        drop(messages);
        self.arrived.notify_one();
    }
}

struct ZenohReceiver {
    waiting: Arc<Waiting>,
    _subscriber: zenoh::pubsub::Subscriber<()>,
    _session: zenoh::Session,
}

impl ReceiveHalf for ZenohReceiver {
    fn receive(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<Option<usize>> {
        let poisoned = || io::Error::other("the thread of zenoh panicked");
        let messages = self.waiting.messages.lock().map_err(|_| poisoned())?;
        let (mut messages, _) = self
            .waiting
            .arrived
            .wait_timeout_while(messages, wait, |messages| messages.is_empty())
            .map_err(|_| poisoned())?;
        let Some(message) = messages.pop_front() else { return Ok(None) };
        // A longer one is cut, and then refused for its length.
        let n = message.len().min(buffer.len());
        buffer[..n].copy_from_slice(&message[..n]);
        Ok(Some(n))
    }

    /// Zenoh sends to whoever listens.
    fn trust_sender(&mut self) {}

    fn ask_sender(&mut self) {}
}
