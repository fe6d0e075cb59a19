//! Names of ROS 2 as keys of zenoh. Source: `rmw_zenoh_cpp` (ros2/rmw_zenoh: docs/design.md, liveliness_utils.cpp,
//! attachment_helpers.cpp, as of Jazzy).

use super::messages::MessageType;

/// The queue of our publishers and subscribers: 10 messages; all else as `rmw_zenoh` has it by default (reliable, volatile, keep last).
const QOS: &str = "::,10:,:,:,,";

impl MessageType {
    /// As DDS names it.
    fn dds_name(&self) -> String {
        format!("{}::msg::dds_::{}_", self.package, self.name)
    }
}

/// The key under which messages of `topic` (`/left/measured_cp`) go.
pub(super) fn topic_key(domain: u32, topic: &str, message: MessageType) -> String {
    format!("{domain}/{}/{}/{}", topic.trim_matches('/'), message.dds_name(), message.hash)
}

fn mangled(name: &str) -> String {
    name.replace('/', "%")
}

/// What a node has at one end of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Entity {
    Publisher,
    Subscriber,
}

/// Our node as others see it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Node<'a> {
    pub(super) domain: u32,
    /// The id of the zenoh session.
    pub(super) session: &'a str,
    pub(super) name: &'a str,
}

impl Node<'_> {
    /// The token by which others see the node.
    pub(super) fn token(&self) -> String {
        let Self { domain, session, name } = self;
        format!("@ros2_lv/{domain}/{session}/0/0/NN/%/%/{name}")
    }

    /// The token by which others see end number `number` (from 1) of a topic.
    pub(super) fn topic_token(
        &self,
        number: usize,
        entity: Entity,
        topic: &str,
        message: MessageType,
    ) -> String {
        let Self { domain, session, name } = self;
        let kind = if entity == Entity::Publisher { "MP" } else { "MS" };
        let (topic, dds_name, hash) = (mangled(topic), message.dds_name(), message.hash);
        format!("@ros2_lv/{domain}/{session}/0/{number}/{kind}/%/%/{name}/{topic}/{dds_name}/{hash}/{QOS}")
    }
}

/// What `rmw_zenoh` wants beside each message: its number, when it was sent [ns since 1970], which publisher sent it
/// (preceded by the length of its id).
pub(super) fn attachment(sequence: i64, sent_ns: i64, publisher: &[u8; 16]) -> [u8; 33] {
    let mut bytes = [0; 33];
    bytes[..8].copy_from_slice(&sequence.to_le_bytes());
    bytes[8..16].copy_from_slice(&sent_ns.to_le_bytes());
    bytes[16] = publisher.len() as u8;
    bytes[17..].copy_from_slice(publisher);
    bytes
}

/// A name as ROS allows it: letters, digits and underscores, not beginning with a digit.
pub(super) fn ros_name(name: &str) -> String {
    let mut allowed: String =
        name.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' }).collect();
    if !allowed.starts_with(|c: char| c.is_ascii_alphabetic()) {
        allowed.insert_str(0, "tool_");
    }
    allowed
}

#[cfg(test)]
mod tests {
    use super::super::messages::POSE_STAMPED;
    use super::*;

    #[test]
    fn keys_are_those_of_rmw_zenoh() {
        let type_and_hash = "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_\
            10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8";
        assert_eq!(
            topic_key(3, "/left/measured_cp", POSE_STAMPED),
            format!("3/left/measured_cp/{type_and_hash}")
        );
        let node = Node { domain: 0, session: "a1b2", name: "glisson" };
        assert_eq!(node.token(), "@ros2_lv/0/a1b2/0/0/NN/%/%/glisson");
        let token = |entity| node.topic_token(4, entity, "/left/measured_cp", POSE_STAMPED);
        let expected = |kind| {
            format!("@ros2_lv/0/a1b2/0/4/{kind}/%/%/glisson/%left%measured_cp/{type_and_hash}/::,10:,:,:,,")
        };
        assert_eq!(token(Entity::Publisher), expected("MP"));
        assert_eq!(token(Entity::Subscriber), expected("MS"));
        let bytes = attachment(1, 2, &[9; 16]);
        assert_eq!(bytes[..17], [1, 0, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 16]);
        assert_eq!(bytes[17..], [9; 16]);
    }

    #[test]
    fn names_become_names_that_ros_allows() {
        assert_eq!(["Left hand", "2", "", "a-b"].map(ros_name), ["left_hand", "tool_2", "tool_", "a_b"]);
    }
}
