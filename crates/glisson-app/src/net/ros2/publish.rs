//! Publishes the topics over a zenoh session (feature `net`).

use super::keys::{attachment, node_token, publisher_token, topic_key};
use super::topics::{Described, Topic};
use crate::net::link::{Role, ZenohAddress};
use crate::net::zenoh_link::config;
use crate::runtime::live::Published;
use anyhow::anyhow;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tokio::sync::watch;
use zenoh::Wait;

const NODE: &str = "glisson";
/// Between two looks at what is displayed: about half a frame.
const LOOK: Duration = Duration::from_millis(8);
/// Between two surfaces.
const SURFACE_INTERVAL: Duration = Duration::from_millis(100);

struct TopicPublisher {
    topic: Topic,
    publisher: zenoh::pubsub::Publisher<'static>,
    id: [u8; 16],
    sequence: i64,
    last: Option<Instant>,
    /// Others see the publisher as long as this lives.
    _token: zenoh::liveliness::LivelinessToken,
}

/// Publishes in `domain` until the sender of `published` is gone.
///
/// # Errors
/// When no session can be had.
pub(crate) fn spawn(
    address: &ZenohAddress,
    domain: u32,
    described: Described,
    published: watch::Receiver<Arc<Published>>,
) -> anyhow::Result<JoinHandle<()>> {
    let failed = |e: zenoh::Error| anyhow!("zenoh: {e}");
    let session = zenoh::open(config(address, Role::Haptics)?).wait().map_err(failed)?;
    let session_id = session.zid().to_string();
    let node =
        session.liveliness().declare_token(node_token(domain, &session_id, NODE)).wait().map_err(failed)?;
    let mut publishers = Vec::new();
    for (number, topic) in Topic::all(&described).into_iter().enumerate() {
        let token = publisher_token(domain, &session_id, number + 1, NODE, &topic.name, topic.message);
        // Any id will do that no other publisher has.
        let mut id = [0; 16];
        id.copy_from_slice(&blake3::hash(token.as_bytes()).as_bytes()[..16]);
        let publisher = session
            .declare_publisher(topic_key(domain, &topic.name, topic.message))
            .wait()
            .map_err(failed)?;
        let token = session.liveliness().declare_token(token).wait().map_err(failed)?;
        publishers.push(TopicPublisher { topic, publisher, id, sequence: 0, last: None, _token: token });
    }
    let thread = std::thread::Builder::new().name("ros2".into()).spawn(move || {
        run(&described, publishers, published);
        drop(node);
        // It ends anyway.
        let _ = session.close().wait();
    })?;
    Ok(thread)
}

fn run(
    described: &Described,
    mut publishers: Vec<TopicPublisher>,
    mut published: watch::Receiver<Arc<Published>>,
) {
    let mut was_told = false;
    loop {
        match published.has_changed() {
            Ok(true) => {}
            Ok(false) => {
                std::thread::sleep(LOOK);
                continue;
            }
            Err(_) => return,
        }
        let latest = Arc::clone(&published.borrow_and_update());
        let time = SystemTime::now();
        let sent_ns = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i64);
        for publisher in &mut publishers {
            if publisher.topic.is_large()
                && publisher.last.is_some_and(|last| last.elapsed() < SURFACE_INTERVAL)
            {
                continue;
            }
            publisher.last = Some(Instant::now());
            let Some(message) = publisher.topic.message_of(described, &latest.snapshot, time) else {
                continue;
            };
            publisher.sequence += 1;
            let beside = attachment(publisher.sequence, sent_ns, &publisher.id);
            let put = publisher.publisher.put(message).attachment(beside.to_vec()).wait();
            if let (Err(error), false) = (put, was_told) {
                was_told = true;
                eprintln!("ROS 2: publishing failed: {error}");
            }
        }
    }
}
