//! The program on a network: two machines that share a session, 3D Slicer and other OpenIGTLink clients, ROS 2.

pub(crate) mod crc64;
pub(crate) mod igtl;
pub(crate) mod messages;
pub(crate) mod seal;
