//! Cases of collision detection.

use std::hint::black_box;

use glam::DVec3;
use glisson::contact::{BallPath, BucketGrid, SurfaceView};

use super::body::ellipsoid_surface;
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[Case {
    name: "collision",
    about: "one step of contact: buckets sorted anew and a ball's path tested, most of it near the surface",
    per: "step",
    sizes: &[2_000, 6_300, 20_000, 100_000],
    parallel: false,
    prepare: collision,
}];
