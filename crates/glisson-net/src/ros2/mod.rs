//! ROS 2 topics with CRTK's names, as `rmw_zenoh` carries them: the keys of zenoh and the CDR of the messages
//! (`docs/network.md`). No part of ROS is needed.

mod cdr;
mod keys;
mod messages;
mod orders;
mod device;
mod topics;
#[cfg(feature = "net")]
mod publish;

#[cfg(feature = "net")]
pub(crate) use publish::{Over, spawn};
pub(crate) use topics::Described;
