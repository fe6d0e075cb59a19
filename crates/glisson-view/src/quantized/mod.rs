//! Positions in few bytes: whole numbers of a step, and these in as few bytes as they need. On the wire ([`crate::server`]) and in
//! recordings ([`crate::recording`]).

pub(crate) mod numbers;
pub(crate) mod places;
