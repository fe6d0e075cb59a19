//! Cases of collision detection.

use std::hint::black_box;

use glam::DVec3;
use glisson::contact::buckets::BucketGrid;
use glisson::contact::sphere::{BallPath, SurfaceView};
use glisson::math::SeededRandom;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::surface::TriMesh;

use super::body::StandardBody;
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "collision",
        about: "contact of one step: the surface is sorted into buckets anew, then a ball's path is tested",
        per: "step",
        sizes: &[2_000, 6_300, 20_000, 100_000],
        parallel: false,
        prepare: |settings| collision(settings, true),
    },
    Case {
        name: "collision_query",
        about: "a ball's path tested against sorted buckets",
        per: "query",
        sizes: &[2_000, 6_300, 20_000, 100_000],
        parallel: false,
        prepare: |settings| collision(settings, false),
    },
];

/// Radius of the ball [m], and how far it moves in a step: 0.1 m/s at 100 steps a second.
const BALL_RADIUS_M: f64 = 0.005;
const MOVE_M: f64 = 0.001;
/// Different paths, used in turn.
const N_PATHS: usize = 256;

/// Moving: with the sorting into buckets.
pub(crate) fn collision(settings: Settings, moving: bool) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let topology = Topology::build(&body.mesh)?;
    let (surface, _) = surface_of(&topology, &body.mesh);
    let n_triangles = surface.triangles.len();
    let paths = paths_near(&surface);
    let TriMesh { positions_m, triangles } = surface;
    let mut buckets = BucketGrid::new(&positions_m, &triangles);
    let view = SurfaceView { positions_m: &positions_m, triangles: &triangles, buckets: &buckets };
    let touching = paths.iter().filter(|path| view.first_touch(path).is_some()).count();
    let mut next = 0;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!("{n_triangles} surface triangles, {touching} of {N_PATHS} paths touch"),
        run: Box::new(move || {
            if moving {
                buckets.update(black_box(&positions_m), &triangles);
            }
            next = (next + 1) % N_PATHS;
            let view = SurfaceView { positions_m: &positions_m, triangles: &triangles, buckets: &buckets };
            black_box(view.first_touch(black_box(&paths[next])));
        }),
    })
}

/// Short paths over the whole surface: towards it, along it and away from it.
fn paths_near(surface: &TriMesh) -> Vec<BallPath> {
    let mut random = SeededRandom::new(7);
    (0..N_PATHS)
        .map(|_| {
            let triangle = (random.uniform() * surface.triangles.len() as f64) as usize;
            let [a, b, c] = surface.corners_m(triangle);
            let normal = (b - a).cross(c - a).normalize_or(DVec3::Z);
            let height_m = BALL_RADIUS_M * random.uniform_in(0.9, 1.3);
            let from_m = (a + b + c) / 3.0 + height_m * normal;
            let direction = DVec3::new(random.normal(), random.normal(), random.normal());
            BallPath {
                from_m,
                to_m: from_m + MOVE_M * direction.normalize_or(DVec3::X),
                radius_m: BALL_RADIUS_M,
            }
        })
        .collect()
}
