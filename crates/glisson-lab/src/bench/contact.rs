//! Cases of collision detection and of the contacts of instruments.

use std::hint::black_box;

use glam::{DMat3, DVec3};
use glisson::contact::buckets::BucketGrid;
use glisson::contact::constraint::{Contact, ContactKey, Response, Sweeps, solve};
use glisson::contact::delassus::Delassus;
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
    Case {
        name: "tool_contact_solve",
        about: "an instrument's contacts on a half-space of 96 nodes, solved anew from no force (size in contacts)",
        per: "solution",
        sizes: &[16, 64],
        parallel: false,
        prepare: |settings| tool_contacts(settings, Solver::Delassus),
    },
    Case {
        name: "tool_contact_solve_by_vertices",
        about: "the same by sweeps over the vertices, the reference",
        per: "solution",
        sizes: &[16, 64],
        parallel: false,
        prepare: |settings| tool_contacts(settings, Solver::Vertices),
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

/// By what an instrument's contacts are solved.
#[derive(Clone, Copy)]
enum Solver {
    /// As worlds do.
    Delassus,
    Vertices,
}

/// Nodes that a tip bears on at most in a world.
const N_TOUCHED: u32 = 96;
/// 1/(pi E*) of 5 kPa [m2/N], how far the nodes are spread, and what of it the mesh shows at a node's own place: about a node's
/// third of the triangles around it.
const COMPLIANCE_M2_PER_N: f64 = 1.0 / (std::f64::consts::PI * 6.27e3);
const SPREAD_M: f64 = 8e-3;
const OWN_M: f64 = 1e-3;
/// Of a hand of 10 N/mm with its damper in a step of 2 ms.
const HAND_M_PER_N: f64 = 5e-5;
/// As worlds sweep.
const SWEEPS: Sweeps = Sweeps { most: 30, tolerance: 1e-4 };

/// A ball that is pressed 1 mm into a half-space at so many places of its surface.
fn tool_contacts(settings: Settings, solver: Solver) -> anyhow::Result<Prepared> {
    let mut random = SeededRandom::new(11);
    let places_m: Vec<DVec3> = (0..N_TOUCHED)
        .map(|_| DVec3::new(random.uniform_in(-1.0, 1.0), random.uniform_in(-1.0, 1.0), 0.0) * SPREAD_M)
        .collect();
    let n = places_m.len();
    let mut response = Response::new(n + 1, 1);
    response.set_group(0, 0..N_TOUCHED);
    response.group_mut(0).compliance_m_per_n = (0..n * n)
        .map(|at| {
            let apart_m = places_m[at / n].distance(places_m[at % n]);
            DMat3::from_diagonal(DVec3::splat(COMPLIANCE_M2_PER_N / (apart_m + OWN_M)))
        })
        .collect();
    response.set_alone(N_TOUCHED, DVec3::splat(HAND_M_PER_N));
    let contacts: Vec<Contact> = (0..settings.size as u32)
        .map(|i| {
            let slope = DVec3::new(random.uniform_in(-0.4, 0.4), random.uniform_in(-0.4, 0.4), -1.0);
            let mut contact = Contact::new(ContactKey::VertexObstacle(i, 0), slope.normalize(), 0.0);
            let nodes = [0, 31, 67].map(|step| (i * 7 + step) % N_TOUCHED);
            contact.vertices = [nodes[0], nodes[1], nodes[2], N_TOUCHED];
            contact.weights = [0.5, 0.3, 0.2, -1.0];
            contact.moved_m = DVec3::new(2e-4, 0.0, -1e-3);
            contact.friction = 0.3;
            contact
        })
        .collect();
    let mut delassus = Delassus::with_room_for(contacts.len());
    let (mut solved, mut moves_m) = (contacts.clone(), vec![DVec3::ZERO; n + 1]);
    let mut solve_anew = move || {
        solved.copy_from_slice(black_box(&contacts));
        moves_m.fill(DVec3::ZERO);
        match solver {
            Solver::Delassus => delassus.solve(&mut solved, &response, SWEEPS, &mut moves_m),
            Solver::Vertices => solve(&mut solved, &response, SWEEPS, &mut moves_m),
        }
    };
    let report = solve_anew();
    Ok(Prepared {
        size: settings.size,
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!("{} sweeps, residual {:.0e}", report.n_sweeps, report.residual),
        run: Box::new(move || {
            black_box(solve_anew());
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
