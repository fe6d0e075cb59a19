//! The program on a network: two machines that share a session, 3D Slicer and other OpenIGTLink clients, ROS 2.

pub(crate) mod crc64;
pub(crate) mod seal;
pub(crate) mod messages;
pub(crate) mod contact_messages;
pub(crate) mod surface;
pub(crate) mod figures;
pub(crate) mod detector;
pub(crate) mod inbox;
pub(crate) mod link;
pub(crate) mod conversation;
pub(crate) mod bridge;
pub(crate) mod igtl;
pub(crate) mod player;
#[cfg(any(test, feature = "net"))]
#[cfg_attr(
    not(feature = "net"),
    allow(dead_code, unused_imports, reason = "without zenoh only the tests use it")
)]
pub(crate) mod ros2;
pub(crate) mod options;
#[cfg(feature = "net")]
mod zenoh_log;
#[cfg(feature = "net")]
mod zenoh_link;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod detection_tests;
#[cfg(all(test, feature = "net"))]
mod zenoh_tests;
