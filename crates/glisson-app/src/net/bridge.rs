//! The two ends of a link inside the program: where in one program the haptic loop and the simulation hand poses and
//! models to each other ([`crate::runtime::exchange`]), here each hands them to a [`Conversation`].

use super::conversation::{Conversation, Identity, Incoming, Outgoing};
use super::link::Link;
use super::messages::{Content, Hand, Tissue};
use crate::runtime::exchange::{Latest, Publisher, exchange};
use crate::runtime::haptic_loop::{DeviceStatus, Motion, PublishedModel, ToolLink};
use glisson::tool::ToolInput;
use std::thread::Thread;

/// What the simulation calls the other machine.
const DEVICE_NAME: &str = "at the other machine";

/// What the haptics machine's user should hear of a device.
pub(crate) struct DeviceNews {
    pub(crate) device_name: String,
    pub(crate) statuses: Latest<DeviceStatus>,
}

/// The haptics machine: sends where its devices are, gives their loop the models that come. `links` are the simulation's
/// ends of the instruments that devices hold; the others stay at their `homes`.
///
/// # Errors
/// When the system gives no thread.
pub(crate) fn start_haptics(
    link: Link,
    identity: Identity,
    homes: &[ToolInput],
    links: Vec<ToolLink>,
) -> std::io::Result<(Conversation, Vec<DeviceNews>)> {
    let mut hands = HandsOut { motions: Vec::new() };
    let mut tissues = TissuesIn { models: Vec::new() };
    for &home in homes {
        hands.motions.push(exchange(Motion { pose: home, is_held: false }).1);
        tissues.models.push(exchange(PublishedModel::default()).0);
    }
    let mut news = Vec::new();
    for ToolLink { tool, device_name, models, motions, statuses } in links {
        hands.motions[tool] = motions;
        tissues.models[tool] = models;
        news.push(DeviceNews { device_name, statuses });
    }
    Ok((Conversation::start(link, identity, hands, tissues)?, news))
}

/// The simulating machine: its instruments are in hands that are elsewhere. Answers their ends too, for the simulation.
///
/// # Errors
/// When the system gives no thread.
pub(crate) fn start_simulation(
    link: Link,
    identity: Identity,
    homes: &[ToolInput],
) -> std::io::Result<(Conversation, Vec<ToolLink>)> {
    let (mut hands, mut tissues, mut links) = (HandsIn::default(), TissuesOut::default(), Vec::new());
    for (tool, &home) in homes.iter().enumerate() {
        let (models, models_out) = exchange(PublishedModel::default());
        let (motions_in, motions) = exchange(Motion { pose: home, is_held: false });
        let (statuses_in, statuses) = exchange(DeviceStatus::Waiting);
        tissues.models.push(models_out);
        hands.tools.push(RemoteTool { motions: motions_in, statuses: statuses_in, last: home, works: false });
        links.push(ToolLink { tool, device_name: DEVICE_NAME.into(), models, motions, statuses });
    }
    Ok((Conversation::start(link, identity, tissues, hands)?, links))
}

struct HandsOut {
    motions: Vec<Latest<Motion>>,
}

impl Outgoing for HandsOut {
    fn wakes(&self, thread: Thread) {
        self.motions.iter().for_each(|motions| motions.wakes(thread.clone()));
    }

    fn unseen(&mut self, now_ns: u64) -> Option<Content> {
        // All of them must be asked: each remembers what it has shown.
        let n_new = self.motions.iter_mut().filter_map(Latest::get_new).count();
        (n_new > 0).then(|| self.latest(now_ns))
    }

    fn latest(&mut self, _: u64) -> Content {
        let hand = |motions: &mut Latest<Motion>| {
            let Motion { pose, is_held } = motions.get();
            Hand { pose, is_held }
        };
        Content::Hands(self.motions.iter_mut().map(hand).collect())
    }
}

struct TissuesIn {
    models: Vec<Publisher<PublishedModel>>,
}

impl Incoming for TissuesIn {
    fn take(&mut self, content: Content, now_ns: u64, on_the_way_ns: u64) {
        let Content::Tissues(tissues) = content else { return };
        for (models, tissue) in self.models.iter_mut().zip(tissues) {
            // On this machine's clock. Nothing was made in the other one's simulation yet: it says 0 as in one program.
            let age_ns = tissue.age_ns.saturating_add(on_the_way_ns);
            let made_ns = if tissue.age_ns == NEVER { 0 } else { now_ns.saturating_sub(age_ns).max(1) };
            models.publish(PublishedModel { model: tissue.model, made_ns });
        }
    }

    /// The models grow old: the law lets go by itself, as when the simulation stalls.
    fn cut(&mut self) {}
}

/// The age of a model that was not made.
const NEVER: u64 = u64::MAX;

#[derive(Default)]
struct TissuesOut {
    models: Vec<Latest<PublishedModel>>,
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
        let tissue = |models: &mut Latest<PublishedModel>| {
            let PublishedModel { model, made_ns } = models.get();
            let age_ns = if made_ns == 0 { NEVER } else { now_ns.saturating_sub(made_ns) };
            Tissue { model, age_ns }
        };
        Content::Tissues(self.models.iter_mut().map(tissue).collect())
    }
}

struct RemoteTool {
    motions: Publisher<Motion>,
    statuses: Publisher<DeviceStatus>,
    last: ToolInput,
    works: bool,
}

#[derive(Default)]
struct HandsIn {
    tools: Vec<RemoteTool>,
}

impl Incoming for HandsIn {
    fn take(&mut self, content: Content, _: u64, _: u64) {
        let Content::Hands(hands) = content else { return };
        for (tool, hand) in self.tools.iter_mut().zip(hands) {
            tool.last = hand.pose;
            tool.motions.publish(Motion { pose: hand.pose, is_held: hand.is_held });
            if !std::mem::replace(&mut tool.works, true) {
                tool.statuses.publish(DeviceStatus::Works);
            }
        }
    }

    /// The instruments stay where they were: nobody holds them.
    fn cut(&mut self) {
        for tool in &mut self.tools {
            tool.motions.publish(Motion { pose: tool.last, is_held: false });
            tool.works = false;
            tool.statuses.publish(DeviceStatus::Lost("nothing comes over the link".into()));
        }
    }
}
