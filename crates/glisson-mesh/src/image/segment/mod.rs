//! Finding an organ in an image.
//!
//! [`segment`] grows a region around one point and needs none for a liver; [`segment_with_seeds`] takes
//! points inside and outside the organ and ends with a geodesic active contour.

pub(super) mod error;
mod geodesic;
mod guess;
mod params;
mod parting;
mod region;
mod seeded;
pub(super) mod statistics;
pub(super) mod steps;

pub use error::SegmentError;
pub use guess::guess_seed;
pub use params::{SegmentParams, Segmentation};
pub use region::{bare_band, segment};
pub use seeded::{SeededParams, Seeds, segment_with_seeds};
