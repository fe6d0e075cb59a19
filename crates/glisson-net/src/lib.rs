//! Other machines: two that share a session, 3D Slicer and other OpenIGTLink clients, ROS 2.
//!
//! ```text
//! haptics machine:    devices -> haptic loop -> bridge -> messages -> conversation -> link (UDP or zenoh)
//! simulation machine: link -> conversation -> bridge -> ToolLinks of glisson_runtime::live; Published -> igtl, ros2
//! ```
//!
//! The modules stand in data-flow order; a module uses only modules above it (`xtask/tests/layering.rs`).

pub(crate) mod crc64;
pub mod seal;
mod wire;
pub(crate) mod contact_messages;
pub mod messages;
pub(crate) mod surface;
pub(crate) mod detector;
pub(crate) mod inbox;
pub mod link;
#[cfg(feature = "net")]
mod zenoh_log;
#[cfg(feature = "net")]
mod zenoh_link;
pub mod link_address;
pub mod conversation;
pub mod bridge;
pub(crate) mod igtl;
pub(crate) mod player;
#[cfg(any(test, feature = "net"))]
#[cfg_attr(
    not(feature = "net"),
    allow(dead_code, unused_imports, reason = "without zenoh only the tests use it")
)]
pub(crate) mod ros2;
#[allow(clippy::print_stdout, reason = "the options of `glisson serve` tell the user what they do")]
pub mod options;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod detection_tests;
#[cfg(all(test, feature = "net"))]
mod zenoh_tests;
