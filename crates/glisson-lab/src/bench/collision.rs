//! Cases of the three structures of contact detection: a tool against a deforming surface, a surface against itself,
//! bodies against each other.

use std::hint::black_box;

use glam::DVec3;
use glisson::contact::broad_phase::BroadPhaseKind::{self, Buckets, Hierarchy, SweepAndPrune};
use glisson::contact::self_collision::{PairSearch, PairSearchParams};
use glisson::contact::shapes::{Capsule, CapsuleMotion};
use glisson::contact::tool_contact::SurfaceSearch;
use glisson::math::SeededRandom;

use super::colliding::{Moving, N_FRAMES, folded_ring, rocking_cubes};
use super::{Case, Prepared, Settings};

const TOOL: &str = "boxes and structure follow a deforming surface, then first contact of tip and shaft";
const SELF: &str = "boxes and structure follow a deforming folded surface, then its triangles that meet";
const CUBES: &str = "boxes and structure follow rocking cubes of 300 triangles, then the triangles that meet";

pub(super) const CASES: &[Case] = &[
    case("tool_buckets", TOOL, &[3_000], |s| Ok(tool(s, Buckets))),
    case("tool_sweep", TOOL, &[3_000], |s| Ok(tool(s, SweepAndPrune))),
    case("tool_hierarchy", TOOL, &[3_000], |s| Ok(tool(s, Hierarchy))),
    case("self_buckets", SELF, &[3_000], |s| Ok(pairs(&folded_ring(s.size), Buckets))),
    case("self_sweep", SELF, &[3_000], |s| Ok(pairs(&folded_ring(s.size), SweepAndPrune))),
    case("self_hierarchy", SELF, &[3_000], |s| Ok(pairs(&folded_ring(s.size), Hierarchy))),
    case("cubes_buckets", CUBES, &[1, 2, 4], |s| Ok(pairs(&rocking_cubes(s.size), Buckets))),
    case("cubes_sweep", CUBES, &[1, 2, 4], |s| Ok(pairs(&rocking_cubes(s.size), SweepAndPrune))),
    case("cubes_hierarchy", CUBES, &[1, 2, 4], |s| Ok(pairs(&rocking_cubes(s.size), Hierarchy))),
];

const fn case(
    name: &'static str,
    about: &'static str,
    sizes: &'static [usize],
    prepare: fn(Settings) -> anyhow::Result<Prepared>,
) -> Case {
    Case { name, about, per: "step", sizes, parallel: false, prepare }
}

/// A tip of 2 mm and a shaft of 5 mm, 30 cm long, that move by 1 mm a step.
const TIP_RADIUS_M: f64 = 1e-3;
const SHAFT_RADIUS_M: f64 = 2.5e-3;
const SHAFT_M: f64 = 0.3;
const TOOL_MOVE_M: f64 = 1e-3;

/// Tip and shaft on their way, near the surface in every frame.
fn tools(surface: &Moving) -> Vec<[CapsuleMotion; 2]> {
    let mut random = SeededRandom::new(7);
    let mut unit = || DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X);
    (0..N_FRAMES)
        .map(|frame| {
            let place = frame * 7919 % surface.triangles.len();
            let [a, b, c] = surface.triangles[place].map(|v| surface.frames_m[frame][v as usize]);
            let normal = (b - a).cross(c - a).normalize_or(DVec3::Z);
            let tip_m = (a + b + c) / 3.0 + normal * 1.5 * SHAFT_RADIUS_M;
            let (behind_m, move_m) = ((normal + 0.5 * unit()).normalize() * SHAFT_M, unit() * TOOL_MOVE_M);
            let at = |m: DVec3, end_m: DVec3, radius_m: f64| Capsule {
                from_m: tip_m + m,
                to_m: tip_m + m + end_m,
                radius_m,
            };
            let part = |end_m: DVec3, radius_m: f64| {
                CapsuleMotion::straight(&at(DVec3::ZERO, end_m, radius_m), &at(move_m, end_m, radius_m))
            };
            [part(DVec3::ZERO, TIP_RADIUS_M), part(behind_m, SHAFT_RADIUS_M)]
        })
        .collect()
}

fn tool(settings: Settings, kind: BroadPhaseKind) -> Prepared {
    let surface = folded_ring(settings.size);
    let tools = tools(&surface);
    let mut search = SurfaceSearch::new(kind, &surface.frames_m[0], &surface.triangles, 0);
    let mut frame = 0;
    let n_triangles = surface.triangles.len();
    let mut step = move || {
        let next = (frame + 1) % N_FRAMES;
        let (start_m, end_m) = (&surface.frames_m[frame], &surface.frames_m[next]);
        search.update(black_box(start_m), end_m);
        let touched = tools[frame].each_ref().map(|part| search.first_contact(part, start_m, end_m));
        frame = next;
        black_box(touched).iter().flatten().count()
    };
    let n_touched: usize = (0..N_FRAMES).map(|_| step()).sum();
    Prepared {
        size: n_triangles,
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!("triangles; {n_touched} of {} parts of the tool touch", 2 * N_FRAMES),
        run: Box::new(move || {
            step();
        }),
    }
}

/// Room for pairs of boxes, for each triangle; the folded ring has about one.
const PAIRS_A_TRIANGLE: usize = 64;

fn pairs(surface: &Moving, kind: BroadPhaseKind) -> Prepared {
    let n_triangles = surface.triangles.len();
    let capacity = PAIRS_A_TRIANGLE * n_triangles;
    let params = PairSearchParams { kind, self_collision: true, margin_m: 0.0, pair_capacity: capacity };
    let frames_m = surface.frames_m.clone();
    let mut search = PairSearch::new(&params, &frames_m[0], &surface.triangles, &surface.body_of);
    let mut found = Vec::with_capacity(capacity);
    let mut frame = 0;
    let mut step = move || {
        frame = (frame + 1) % N_FRAMES;
        search.update(black_box(&frames_m[frame]));
        let count = search.meeting_into(&mut found);
        (count, black_box(&found).len())
    };
    let all: Vec<_> = (0..N_FRAMES).map(|_| step()).collect();
    let mean = |number: fn(&(glisson::contact::self_collision::PairCount, usize)) -> usize| {
        all.iter().map(number).sum::<usize>() / N_FRAMES
    };
    let n_dropped: usize = all.iter().map(|(count, _)| count.n_dropped).sum();
    Prepared {
        size: n_triangles,
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!(
            "triangles; {} pairs of boxes, {} of triangles meet ({} at least), {n_dropped} without room",
            mean(|(count, _)| count.n_candidates),
            mean(|(_, n)| *n),
            all.iter().map(|(_, n)| *n).min().unwrap_or(0),
        ),
        run: Box::new(move || {
            step();
        }),
    }
}
