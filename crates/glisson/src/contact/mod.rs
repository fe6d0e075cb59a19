//! Contact between tools and organs.

pub mod buckets;
pub mod spread;
pub mod sphere;
