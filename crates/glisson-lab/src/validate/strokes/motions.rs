//! Random strokes of scalpel, scissors and hook on a body: scene text of the three instruments and their paths.

use crate::scripted::Path;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::TetMesh;

/// Where an instrument that is not used waits: so far from the body's middle, over its largest half size.
const AWAY: f64 = 2.0;
/// How far above the body a stroke begins and ends [m].
const ABOVE_M: f64 = 0.015;
/// Points of a stroke of scalpel or hook, which follow the body's surface; nodes so near [m] tell where that is.
const N_POINTS: usize = 6;
const COLUMN_M: f64 = 0.012;
/// Of a surgeon's hand that does not dawdle [m/s].
const SPEEDS_M_PER_S: [f64; 2] = [0.02, 0.08];
/// Depths of scalpel, scissors and hook [m], and how far they go along the body [m].
const DEPTHS_M: [[f64; 2]; 3] = [[5e-3, 14e-3], [5e-3, 12e-3], [2e-3, 5e-3]];
const WAY_M: [f64; 2] = [0.015, 0.045];
/// How far a stroke swerves at its end, over its way.
const SWERVE: f64 = 0.3;
/// Tangent of the angle by which handles lean.
const LEAN: f64 = 0.3;
/// Snips of the scissors along their way.
const N_SNIPS: usize = 3;
/// How long jaws take to open or close [s].
const JAW_S: f64 = 0.1;

/// Scalpel, scissors, hook.
const TOOLS: [&str; 3] = [
    "kind = \"scalpel\"\ntip_radius = \"1 mm\"\nblade_length = \"20 mm\"\n",
    "kind = \"scissors\"\ntip_radius = \"1 mm\"\njaw_length = \"15 mm\"\nclosing_force = \"60 N\"\nhome_jaw = 1\n",
    "kind = \"hook\"\ntip_radius = \"1.5 mm\"\nburns = \"swept\"\ncut_force = \"0.01 N\"\ncut_time = \"10 ms\"\n",
];

/// A body that is held behind, as seen by a surgeon.
pub(super) struct Sight<'a> {
    mesh: &'a TetMesh,
    middle_m: DVec3,
    half_m: f64,
    /// Where it is held, from the middle.
    behind: DVec3,
}

impl<'a> Sight<'a> {
    pub(super) fn new(mesh: &'a TetMesh, behind: DVec3) -> Self {
        let start = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let [min_m, max_m] =
            mesh.positions_m.iter().fold(start, |[low, high], p| [low.min(*p), high.max(*p)]);
        let half_m = 0.5 * (max_m - min_m).max_element();
        Self { mesh, middle_m: 0.5 * (min_m + max_m), half_m, behind: behind.normalize() }
    }

    /// The place on the body's front, seen along `-out`, beside `near_m`.
    fn front_m(&self, near_m: DVec3, out: DVec3) -> DVec3 {
        let on_plane_m = near_m - out * near_m.dot(out);
        let aside_m = |p: DVec3| (p - out * p.dot(out)).distance(on_plane_m);
        let nodes = || self.mesh.positions_m.iter().copied();
        let height_m = nodes().filter(|p| aside_m(*p) < COLUMN_M).map(|p| p.dot(out));
        let height_m = height_m.max_by(f64::total_cmp).unwrap_or(self.middle_m.dot(out));
        on_plane_m + out * height_m
    }

    /// From the body outwards, not to where it is held.
    fn out(&self, random: &mut SeededRandom) -> DVec3 {
        loop {
            let way = DVec3::from_array([0; 3].map(|_| random.normal())).normalize_or(DVec3::Z);
            if way.dot(self.behind) < -0.3 {
                return way;
            }
        }
    }
}

/// What is done to a body.
pub(super) struct Strokes {
    /// Scene text of the three instruments.
    pub(super) tools: String,
    pub(super) end_s: f64,
    /// Whether the hook makes one of them.
    pub(super) burns: bool,
}

/// So many strokes, each with one of the instruments.
pub(super) fn strokes(sight: &Sight<'_>, n_strokes: usize, random: &mut SeededRandom) -> Strokes {
    let home_m = |i: usize| {
        let aside = sight.behind.any_orthonormal_vector() * (0.5 * (i as f64 - 1.0));
        sight.middle_m + (aside - sight.behind) * (AWAY * sight.half_m)
    };
    let mut paths: [Path; 3] = std::array::from_fn(|i| Path::new(TOOLS[i], home_m(i), -sight.behind));
    let (mut end_s, mut burns) = (0.0, false);
    for _ in 0..n_strokes {
        let i = (random.uniform_in(0.0, 3.0) as usize).min(2);
        burns |= i == 2;
        paths[i].wait_until(end_s);
        stroke(sight, i, &mut paths[i], random);
        paths[i].point(0.1, home_m(i), "");
        end_s = paths[i].time_s();
    }
    let tools = paths.into_iter().map(|path| path.done().0).collect();
    Strokes { tools, end_s, burns }
}

fn stroke(sight: &Sight<'_>, instrument: usize, path: &mut Path, random: &mut SeededRandom) {
    let out = sight.out(random);
    let node = random.uniform_in(0.0, sight.mesh.positions_m.len() as f64) as usize;
    let start_m = sight.mesh.positions_m[node.min(sight.mesh.positions_m.len() - 1)];
    let aside = [out.any_orthonormal_vector(), out.any_orthonormal_vector().cross(out)];
    let angle = random.uniform_in(0.0, std::f64::consts::TAU);
    let along = aside[0] * angle.cos() + aside[1] * angle.sin();
    let across = along.cross(out);
    let [depth_m, way_m, speed_m_per_s] =
        [DEPTHS_M[instrument], WAY_M, SPEEDS_M_PER_S].map(|[low, high]| random.uniform_in(low, high));
    let swerve_m = way_m * random.uniform_in(-SWERVE, SWERVE);
    let lean = aside.map(|aside| aside * random.uniform_in(-LEAN, LEAN));
    let handle = (out + lean[0] + lean[1]).normalize();
    let shaft = format!("shaft = [{}, {}, {}]\n", handle.x, handle.y, handle.z);
    let at_m = |share: f64, depth_m: f64| {
        let beside_m = start_m + along * (share * way_m) + across * (share * share * swerve_m);
        sight.front_m(beside_m, out) - out * depth_m
    };
    // Round the body, then down.
    path.point(0.1, sight.middle_m + out * (AWAY * sight.half_m), &format!("{shaft}trigger = 0\n"));
    path.point(0.1, at_m(0.0, -ABOVE_M), "");
    if instrument == 1 {
        for i in 0..N_SNIPS {
            let share = i as f64 / N_SNIPS as f64;
            path.go(at_m(share, -ABOVE_M), speed_m_per_s, "jaw = 1\n");
            let place_m = at_m(share, depth_m);
            path.go(place_m, speed_m_per_s, "jaw = 1\n");
            path.point(JAW_S, place_m, "jaw = 0\n");
            path.point(JAW_S, place_m, "jaw = 1\n");
        }
    } else {
        for i in 0..N_POINTS {
            let place_m = at_m(i as f64 / (N_POINTS - 1) as f64, depth_m);
            path.go(place_m, speed_m_per_s, "trigger = 1\n");
        }
    }
    path.go(at_m(1.0, -ABOVE_M), speed_m_per_s, "");
    path.point(0.1, sight.middle_m + out * (AWAY * sight.half_m), "trigger = 0\n");
}
