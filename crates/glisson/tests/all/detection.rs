//! Contact detection: the three structures against every pair, triangle tests against distances, and first contacts
//! of fast tools, which must never be missed.

use glisson::contact::boxes::{PairRules, RoundedBox, ThickSegment};
use glisson::contact::broad_phase::{BroadPhase, BroadPhaseKind, Wanted};
use glisson::contact::continuous::{CONTACT_TOLERANCE_M, capsule_and_triangle, corners_at, two_triangles};
use glisson::contact::self_collision::{PairSearch, PairSearchParams};
use glisson::contact::shapes::{Capsule, CapsuleMotion, MeshShape, RigidPose, TrocarPose};
use glisson::contact::tool_contact::SurfaceSearch;
use glisson::contact::triangles::{
    at_weights, closest_on_segment_and_triangle, closest_on_segments, closest_on_triangles, closest_weights,
    triangles_meet,
};
use glisson::math::{DMat3, DVec3, SeededRandom};
use proptest::prelude::*;
use std::f64::consts::TAU;

fn random_vector(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

fn unit(random: &mut SeededRandom) -> DVec3 {
    random_vector(random).normalize_or(DVec3::X)
}

/// A ring of `n` by `m` quads, cut in two: a closed surface that is convex, flat and hollow somewhere.
fn ring(n: usize, m: usize, ring_m: f64, tube_m: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for i in 0..n {
        for j in 0..m {
            let (u, v) = (TAU * i as f64 / n as f64, TAU * j as f64 / m as f64);
            let out = ring_m + tube_m * v.cos();
            positions.push(DVec3::new(out * u.cos(), out * u.sin(), tube_m * v.sin()));
            let at = |di: usize, dj: usize| (((i + di) % n) * m + (j + dj) % m) as u32;
            triangles.push([at(0, 0), at(1, 0), at(1, 1)]);
            triangles.push([at(0, 0), at(1, 1), at(0, 1)]);
        }
    }
    (positions, triangles)
}

fn brute_pairs(boxes: &[RoundedBox], rules: &PairRules) -> Vec<[u32; 2]> {
    let n = boxes.len() as u32;
    let overlap = |s: u32, t: u32| boxes[s as usize].overlaps(&boxes[t as usize]) && rules.allows(s, t);
    (0..n).flat_map(|s| (s + 1..n).filter(move |&t| overlap(s, t)).map(move |t| [s, t])).collect()
}

/// What a query finds: never less than what is in its box and may be touched, never more than what may be touched. Between
/// the two lie boxes that miss it by rounding, a millionth of their size, which a structure may look at or not.
fn assert_near(found: &[u32], boxes: &[RoundedBox], query: &ThickSegment, what: &str) {
    let around = query.bounds();
    for (t, bounds) in boxes.iter().enumerate() {
        let is_found = found.binary_search(&(t as u32)).is_ok();
        let may = query.may_touch(bounds);
        assert!(!is_found || may, "{what}: {t} is far");
        assert!(is_found || !(may && around.overlaps(bounds)), "{what}: {t} is missing");
    }
    assert!(found.windows(2).all(|pair| pair[0] < pair[1]), "{what}: one twice");
}

fn boxes_of(positions: &[DVec3], triangles: &[[u32; 3]], margin_m: f64) -> Vec<RoundedBox> {
    let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
    triangles.iter().map(|t| RoundedBox::of_triangle(corners(t), margin_m)).collect()
}

/// Triangles of very different sizes, thrown about; some share vertices.
fn heap(random: &mut SeededRandom, n: usize, spread: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for t in 0..n as u32 {
        let center = random_vector(random);
        let size = 0.05 * libm::exp(spread * random.normal());
        positions.extend((0..3).map(|_| center + random_vector(random) * size));
        let [a, b, c] = [3 * t, 3 * t + 1, 3 * t + 2];
        triangles.push(if t % 3 == 2 { [a - 1, b, c] } else { [a, b, c] });
    }
    (positions, triangles)
}

fn compare_with_brute_force(seed: u64, n: usize, spread: f64, move_size: f64, self_collision: bool) {
    let mut random = SeededRandom::new(seed);
    let (mut positions, triangles) = heap(&mut random, n, spread);
    let body_of: Vec<u32> = (0..n as u32).map(|t| t % 3).collect();
    let rules = PairRules::new(&triangles, &body_of, self_collision);
    let boxes = boxes_of(&positions, &triangles, 0.01);
    let wanted = Wanted::Pairs { capacity: n * n };
    let mut structures = BroadPhaseKind::ALL.map(|kind| BroadPhase::new(kind, &boxes, &rules, wanted));
    let mut queries = BroadPhaseKind::ALL.map(|kind| BroadPhase::new(kind, &boxes, &rules, Wanted::Queries));
    for step in 0..6 {
        for p in &mut positions {
            *p += random_vector(&mut random) * move_size;
        }
        if step == 3 {
            // A jump of a third of the surface, and a broken vertex that recovers.
            positions.iter_mut().step_by(3).for_each(|p| *p += DVec3::splat(3.0));
        }
        let kept = positions[n];
        if step == 2 || step == 3 {
            positions[n] = DVec3::splat(if step == 2 { f64::NAN } else { f64::NEG_INFINITY });
        }
        let boxes = boxes_of(&positions, &triangles, 0.01);
        let expected = brute_pairs(&boxes, &rules);
        for structure in &mut structures {
            structure.update(&boxes, &rules);
            let mut found = Vec::new();
            structure.for_each_pair(&boxes, &rules, |s, t| found.push([s, t]));
            found.sort_unstable();
            assert_eq!(found, expected, "{:?} in step {step}", structure.kind());
        }
        for _ in 0..4 {
            let (from_m, to_m) = (random_vector(&mut random), random_vector(&mut random) * 2.0);
            let to_m = if step == 0 { from_m } else { to_m };
            let query = ThickSegment { from_m, to_m, radius_m: 0.1 * random.uniform() };
            for structure in structures.iter().chain(&queries) {
                let mut found = Vec::new();
                structure.for_each_near(&boxes, &query, |t| found.push(t));
                found.sort_unstable();
                if structures.iter().any(|s| std::ptr::eq(s, structure)) {
                    assert_near(&found, &boxes, &query, &format!("{:?} in step {step}", structure.kind()));
                }
            }
        }
        for structure in &mut queries {
            structure.update(&boxes, &rules);
            let query = ThickSegment { from_m: positions[0], to_m: DVec3::ONE, radius_m: 0.1 };
            let mut found = Vec::new();
            structure.for_each_near(&boxes, &query, |t| found.push(t));
            found.sort_unstable();
            let what = format!("{:?} for queries in step {step}", structure.kind());
            assert_near(&found, &boxes, &query, &what);
        }
        positions[n] = kept;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn every_structure_finds_the_pairs_of_brute_force_while_the_surface_deforms(
        seed in 0u64..1_000_000, n in 1usize..120, spread in 0.0f64..1.5, move_size in 0.0f64..0.5,
        self_collision in any::<bool>(),
    ) {
        compare_with_brute_force(seed, n, spread, move_size, self_collision);
    }
}

/// A box that a query misses by a millionth.
#[test]
fn queries_that_miss_a_box_by_rounding_are_no_fault() {
    compare_with_brute_force(516_558, 77, 0.580_946_287_685_912_6, 0.166_136_134_442_246_96, false);
}

#[test]
fn structures_of_nothing_answer_nothing() {
    let rules = PairRules::new(&[], &[], true);
    for kind in BroadPhaseKind::ALL {
        let mut structure = BroadPhase::new(kind, &[], &rules, Wanted::Pairs { capacity: 10 });
        structure.update(&[], &rules);
        structure.for_each_pair(&[], &rules, |_, _| panic!("a pair of nothing"));
        let query = ThickSegment { from_m: DVec3::ZERO, to_m: DVec3::X, radius_m: 1.0 };
        structure.for_each_near(&[], &query, |_| panic!("near nothing"));
    }
}

#[test]
fn pairs_without_room_are_told_and_come_back_when_the_crowd_parts() {
    let mut random = SeededRandom::new(1);
    let (positions, triangles) = heap(&mut random, 60, 0.0);
    let body_of = vec![0; 60];
    let params = PairSearchParams {
        kind: BroadPhaseKind::SweepAndPrune,
        self_collision: true,
        margin_m: 0.0,
        pair_capacity: 20,
    };
    let together = positions;
    let apart = |(i, p): (usize, &DVec3)| *p + DVec3::X * 20.0 * (i / 9) as f64;
    let positions: Vec<DVec3> = together.iter().enumerate().map(apart).collect();
    let mut search = PairSearch::new(&params, &positions, &triangles, &body_of);
    let mut found = Vec::with_capacity(5);
    search.update(&together);
    assert!(search.meeting_into(&mut found).n_dropped > 0 && found.len() <= 5);
    search.update(&positions);
    let mut few = Vec::with_capacity(100);
    assert_eq!(search.meeting_into(&mut few).n_dropped, 0);
    let rules = search.rules().clone();
    let overlapping = brute_pairs(search.boxes(), &rules);
    assert_eq!(search.meeting_into(&mut few).n_candidates, overlapping.len());
}

#[test]
fn triangles_on_a_coarse_lattice_meet_exactly_when_their_distance_is_zero() {
    // Corners with whole coordinates from 0 to 3: flat, coplanar, touching and identical triangles are common, and two
    // that do not meet are at least 1e-4 apart.
    let mut random = SeededRandom::new(2);
    let (mut n_meet, mut n_flat) = (0, 0);
    for _ in 0..40_000 {
        let mut corner = || {
            let mut next = || (random.uniform() * 4.0).floor();
            DVec3::new(next(), next(), next())
        };
        let (p, q) = ([corner(), corner(), corner()], [corner(), corner(), corner()]);
        let distance = closest_on_triangles(p, q).distance_m;
        let meet = triangles_meet(p, q);
        assert_eq!(meet, distance < 1e-6, "{p:?} {q:?} {distance}");
        assert_eq!(meet, triangles_meet(q, p));
        n_meet += usize::from(meet);
        n_flat += usize::from((p[1] - p[0]).cross(p[2] - p[0]) == DVec3::ZERO);
    }
    assert!(n_meet > 4_000 && n_flat > 500, "{n_meet} {n_flat}");
}

#[test]
fn distances_are_the_smallest_of_all_pairs_of_points() {
    let mut random = SeededRandom::new(6);
    for case in 0..400 {
        // Every third a sliver, every seventh a segment.
        let thin = if case % 7 == 0 {
            0.0
        } else if case % 3 == 0 {
            1e-11
        } else {
            1.0
        };
        let mut triangle = || {
            let (a, b) = (random_vector(&mut random), random_vector(&mut random));
            [a, b, a.lerp(b, random.uniform_in(-0.5, 1.5)) + random_vector(&mut random) * thin]
        };
        let (p, q) = (triangle(), triangle());
        let segment = [p[0], p[1]];
        let found = closest_on_triangles(p, q);
        let of_segment = closest_on_segment_and_triangle(segment, q);
        let of_segments = closest_on_segments(segment, [q[0], q[1]]);
        for closest in [found, of_segment, of_segments] {
            let weights = closest_weights(closest.second_m, q);
            assert!(at_weights(q, weights).distance(closest.second_m) < 1e-7);
            assert!((closest.first_m.distance(closest.second_m) - closest.distance_m).abs() < 1e-12);
        }
        for i in 0..=12 {
            for j in 0..=12 {
                let (u, v) = (f64::from(i) / 12.0, f64::from(j) / 12.0);
                let on = |t: [DVec3; 3], u: f64, v: f64| {
                    if u + v <= 1.0 { at_weights(t, [1.0 - u - v, u, v]) } else { t[1].lerp(t[2], v) }
                };
                let x = on(q, u, v);
                assert!(
                    of_segments.distance_m
                        <= segment[0].lerp(segment[1], u).distance(q[0].lerp(q[1], v)) + 1e-9
                );
                for k in 0..=12 {
                    let s = segment[0].lerp(segment[1], f64::from(k) / 12.0);
                    assert!(of_segment.distance_m <= s.distance(x) + 1e-9);
                    let y = on(p, f64::from(k) / 12.0, random.uniform());
                    assert!(found.distance_m <= y.distance(x) + 1e-9);
                }
            }
        }
    }
}

/// A surface that moves during a step, and a place on it that a tool is sent to.
struct Target {
    start_m: Vec<DVec3>,
    end_m: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Speed of the surface over a step of 1 ms [m]: 0.5 m/s.
const SURFACE_MOVE_M: f64 = 0.5e-3;
/// Speed of the tool over a step of 1 ms [m]: 5 m/s.
const TOOL_MOVE_M: f64 = 5e-3;
/// Radius of a tip of 2 mm [m].
const TIP_RADIUS_M: f64 = 1e-3;

impl Target {
    fn new(random: &mut SeededRandom, (start_m, triangles): (Vec<DVec3>, Vec<[u32; 3]>)) -> Self {
        // Every place at that speed, on ways of its own.
        let (push, turn) = (unit(random), unit(random));
        let move_of = |p: &DVec3| (push + turn.cross(*p) / 0.08).normalize_or(push) * SURFACE_MOVE_M;
        let end_m = start_m.iter().map(|p| *p + move_of(p)).collect();
        Self { start_m, end_m, triangles }
    }

    fn corners(&self, t: usize, time: f64) -> [DVec3; 3] {
        let of = |list: &[DVec3]| self.triangles[t].map(|v| list[v as usize]);
        corners_at(of(&self.start_m), of(&self.end_m), time)
    }

    /// A place, at a time of the step, and the outward normal there.
    fn place(&self, random: &mut SeededRandom) -> (f64, DVec3, DVec3) {
        let t = (random.uniform() * self.triangles.len() as f64) as usize;
        let time = random.uniform();
        let corners = self.corners(t, time);
        let (u, v) = (random.uniform(), random.uniform());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        (time, at_weights(corners, [1.0 - u - v, u, v]), normal)
    }

    fn distance_m(&self, segment: [DVec3; 2], time: f64) -> f64 {
        let of = |t: usize| closest_on_segment_and_triangle(segment, self.corners(t, time)).distance_m;
        (0..self.triangles.len()).map(of).fold(f64::INFINITY, f64::min)
    }
}

/// A unit vector at the angle of incidence `angle_rad` onto a face with this normal.
fn incident(normal: DVec3, angle_rad: f64, random: &mut SeededRandom) -> DVec3 {
    let aside = normal.cross(unit(random)).normalize_or(normal.any_orthonormal_vector());
    aside * libm::sin(angle_rad) - normal * libm::cos(angle_rad)
}

/// Sends `n` tools that touch the surface at some time; answers how many of them are free at the start and at the end of
/// the step, which is all that a test at single places sees.
fn send(
    n: usize,
    seed: u64,
    surface: (Vec<DVec3>, Vec<[u32; 3]>),
    mut tool: impl FnMut(&mut SeededRandom, f64, DVec3, DVec3) -> CapsuleMotion,
) -> usize {
    let mut random = SeededRandom::new(seed);
    let target = Target::new(&mut random, surface);
    let mut searches =
        BroadPhaseKind::ALL.map(|kind| SurfaceSearch::new(kind, &target.start_m, &target.triangles, 0));
    for search in &mut searches {
        search.update(&target.start_m, &target.end_m);
    }
    let mut unseen = 0;
    for case in 0..n {
        let (time, place, normal) = target.place(&mut random);
        let motion = tool(&mut random, time, place, normal);
        let found = searches[case % 3].first_contact(&motion, &target.start_m, &target.end_m);
        let found = found.unwrap_or_else(|| panic!("case {case}: missed at {time}: {motion:?}"));
        let contact = found.contact;
        assert!(contact.time <= time + 1e-9, "case {case}: at {} instead of {time}", contact.time);
        assert!(contact.time == 0.0 || (-1e-9..=CONTACT_TOLERANCE_M).contains(&contact.gap_m), "{contact:?}");
        let point = at_weights(target.corners(found.triangle as usize, contact.time), found.weights);
        assert!(point.distance(contact.points_m[1]) < 1e-9);
        // The slow comparisons for a part of the cases.
        if case % 20 == 0 {
            for other in &searches {
                assert_eq!(other.first_contact(&motion, &target.start_m, &target.end_m), Some(found));
            }
            let reach = motion.radius_m + motion.path_error_m;
            let ends = [0.0, 1.0].map(|t| {
                let now = motion.at(t);
                target.distance_m([now.from_m, now.to_m], t) > motion.radius_m
            });
            unseen += usize::from(ends == [true; 2]);
            for i in 0..4 {
                let t = contact.time * (f64::from(i) + 0.5) / 4.0;
                let now = motion.at(t);
                let distance = target.distance_m([now.from_m, now.to_m], t);
                assert!(distance > reach || contact.time == 0.0, "case {case}: closer before the contact");
            }
        }
    }
    unseen * 20
}

#[test]
fn a_fast_tip_never_passes_through_a_moving_surface() {
    let unseen = send(6_000, 11, ring(30, 16, 0.06, 0.02), |random, time, place, normal| {
        let direction = incident(normal, random.uniform_in(0.0, 85f64.to_radians()), random);
        let at = |t: f64| {
            Capsule::ball(place + normal * TIP_RADIUS_M + direction * TOOL_MOVE_M * (t - time), TIP_RADIUS_M)
        };
        CapsuleMotion::straight(&at(0.0), &at(1.0))
    });
    assert!(unseen > 600, "a test at single places should miss many: {unseen} of 6000");
}

/// The surface is a vessel of 2 mm, which a shaft can pass as a whole within a step.
#[test]
fn a_swept_shaft_never_passes_through_a_moving_surface() {
    let radius_m = 0.5e-3;
    let unseen = send(4_000, 12, ring(60, 8, 0.06, 1e-3), |random, time, place, normal| {
        let angle = random.uniform_in(0.0, 85f64.to_radians());
        let along = incident(normal, 90f64.to_radians(), random);
        let share = random.uniform();
        let touch = [share, share - 1.0].map(|s| place + normal * radius_m + along * 0.2 * s);
        // The ends move differently: the shaft turns while it sweeps.
        let moves = [0, 1].map(|_| incident(normal, angle, random) * TOOL_MOVE_M);
        let at = |t: f64| {
            let [from_m, to_m] = [0, 1].map(|e| touch[e] + moves[e] * (t - time));
            Capsule { from_m, to_m, radius_m }
        };
        CapsuleMotion::straight(&at(0.0), &at(1.0))
    });
    assert!(unseen > 40, "a test at single places should miss some: {unseen} of 4000");
}

#[test]
fn a_shaft_turned_in_a_trocar_touches_no_later_than_on_its_true_path() {
    let mut random = SeededRandom::new(13);
    let mut touching = 0;
    for _ in 0..1_000 {
        let pivot = DVec3::Z * 0.15;
        let axis = unit(&mut random);
        let first = (DVec3::NEG_Z + 0.4 * random_vector(&mut random)).normalize();
        let direction = (first - axis * axis.dot(first)).normalize();
        let (angle, insertion) = (random.uniform_in(0.0, 0.3), random.uniform_in(0.1, 0.18));
        let slide = random.uniform_in(-0.01, 0.01);
        let pose = |t: f64| TrocarPose {
            direction: DMat3::from_axis_angle(axis, angle * t) * direction,
            insertion_m: insertion + slide * t,
        };
        let motion = CapsuleMotion::through_trocar(pivot, &pose(0.0), &pose(1.0), 0.3, 2e-3);
        let on_the_way = pose(random.uniform());
        let depth_m = on_the_way.insertion_m - 0.1 * random.uniform();
        let center = pivot + on_the_way.direction * depth_m + random_vector(&mut random) * 3e-3;
        let corners = [0, 1, 2].map(|_| center + random_vector(&mut random) * 2e-3);
        let found = capsule_and_triangle(&motion, corners, corners, 1.0);
        let touches = |t: f64| {
            let pose = pose(t);
            let ends = [0.0, 0.3].map(|behind| pivot + pose.direction * (pose.insertion_m - behind));
            closest_on_segment_and_triangle(ends, corners).distance_m <= motion.radius_m
        };
        let first = (0..=200).map(|i| f64::from(i) / 200.0).find(|&t| touches(t));
        if let Some(first) = first.filter(|&first| first > 0.0) {
            touching += 1;
            assert!(found.is_some_and(|f| f.time <= first + 1e-12), "{found:?} against {first}");
        }
    }
    assert!(touching > 100, "{touching}");
}

#[test]
fn moving_triangles_meet_no_later_than_they_do_and_not_before() {
    let mut random = SeededRandom::new(14);
    let mut crossing = 0;
    for _ in 0..3_000 {
        let mut triangle = || {
            let center = random_vector(&mut random) * 0.5;
            let start = [0, 1, 2].map(|_| center + random_vector(&mut random) * 0.3);
            let push = random_vector(&mut random);
            [start, start.map(|p| p + push + random_vector(&mut random) * 0.2)]
        };
        let (p, q) = (triangle(), triangle());
        let found = two_triangles(p, q, 0.0, 1.0);
        let distance =
            |t: f64| closest_on_triangles(corners_at(p[0], p[1], t), corners_at(q[0], q[1], t)).distance_m;
        let first = (0..=60).map(|i| f64::from(i) / 60.0).find(|&t| distance(t) < 1e-12);
        match (first, found) {
            (Some(first), Some(found)) => assert!(found.time <= first),
            (Some(first), None) => panic!("missed at {first}"),
            (None, _) => {}
        }
        if let Some(found) = found {
            assert!(distance(found.time) <= CONTACT_TOLERANCE_M);
            let before = (0..8).all(|i| distance(found.time * f64::from(i) / 8.0) > 0.0);
            assert!(before || found.time == 0.0);
            crossing += usize::from(found.time > 0.0);
        }
    }
    assert!(crossing > 100, "{crossing}");
}

#[test]
fn a_tool_mesh_is_found_where_a_capsule_of_no_radius_is() {
    // A needle-thin prism against the same needle as a capsule.
    let (start_m, triangles) = ring(20, 12, 0.06, 0.02);
    let mut search = SurfaceSearch::new(BroadPhaseKind::Hierarchy, &start_m, &triangles, 0);
    search.update(&start_m, &start_m);
    let needle = MeshShape::new(vec![DVec3::ZERO, DVec3::Z * 0.05, DVec3::Z * 0.025], vec![[0, 1, 2]]);
    let mut random = SeededRandom::new(15);
    let mut n_found = 0;
    for _ in 0..300 {
        let pose = |random: &mut SeededRandom| RigidPose {
            rotation: DMat3::IDENTITY,
            origin_m: random_vector(random) * 0.06,
        };
        let (start, end) = (pose(&mut random), pose(&mut random));
        let mut corners = [[DVec3::ZERO; 3]; 2];
        start.place_into(&needle.positions_m, &mut corners[0]);
        end.place_into(&needle.positions_m, &mut corners[1]);
        let capsule = |c: [DVec3; 3]| Capsule { from_m: c[0], to_m: c[1], radius_m: 0.0 };
        let motion = CapsuleMotion::straight(&capsule(corners[0]), &capsule(corners[1]));
        let expected = search.first_contact(&motion, &start_m, &start_m);
        let error = needle.path_error_m(&start, &end);
        let found = search.first_contact_of_triangle(corners, error, &start_m, &start_m);
        let times = [expected, found].map(|c| c.map(|c| c.contact.time));
        assert_eq!(times[0].is_some(), times[1].is_some());
        if let [Some(a), Some(b)] = times {
            n_found += 1;
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
    }
    assert!(n_found > 50);
}

#[test]
fn a_broken_vertex_hides_only_its_own_triangles() {
    let (mut positions, triangles) = ring(20, 12, 0.06, 0.02);
    let outside = DVec3::new(0.0, 0.06, 0.03);
    let motion = CapsuleMotion::straight(
        &Capsule::ball(outside, 1e-3),
        &Capsule::ball(outside - DVec3::Z * 0.02, 1e-3),
    );
    positions[0] = DVec3::NAN;
    for kind in BroadPhaseKind::ALL {
        let mut search = SurfaceSearch::new(kind, &positions, &triangles, 2);
        search.update(&positions, &positions);
        assert!(search.first_contact(&motion, &positions, &positions).is_some());
        let broken = CapsuleMotion { end_m: [DVec3::NAN; 2], ..motion };
        assert_eq!(search.first_contact(&broken, &positions, &positions), None);
    }
}

#[test]
fn a_triangle_put_into_a_spare_slot_is_found_and_one_taken_out_is_not() {
    let (positions, triangles) = ring(20, 12, 0.06, 0.02);
    let ball = Capsule::ball(positions[5], 1e-4);
    for kind in BroadPhaseKind::ALL {
        let mut search = SurfaceSearch::new(kind, &positions, &triangles[1..], 1);
        let slot = search.n_slots() as u32 - 1;
        let near = |search: &SurfaceSearch| {
            let mut found = Vec::with_capacity(32);
            assert_eq!(search.near_into(&ball, 0.0, &positions, &mut found), 0);
            found.iter().map(|c| c.triangle).collect::<Vec<_>>()
        };
        let before = near(&search);
        assert_eq!(before.len(), 6, "six triangles meet in a vertex of the ring");
        search.set_triangle(slot, Some([5, 6, 7]));
        search.update(&positions, &positions);
        assert_eq!(near(&search), [before.as_slice(), &[slot]].concat());
        search.set_triangle(slot, None);
        search.set_triangle(before[0], None);
        search.update(&positions, &positions);
        assert_eq!(near(&search), before[1..]);
    }
}

/// Two rings that cross, with waves that travel.
fn crossing_rings(time: f64) -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<u32>) {
    let (positions, triangles) = ring(40, 18, 0.06, 0.012);
    let n = positions.len() as u32;
    let waved = |p: &DVec3| *p + DVec3::Z * 2e-3 * libm::sin(60.0 * p.x + time) * (1.0 + p.y / 0.06);
    let first = positions.iter().map(waved);
    let second = positions.iter().map(|p| DVec3::new(0.3 * p.x, p.z, p.y) + DVec3::X * 0.04);
    let both: Vec<DVec3> = first.chain(second).collect();
    let more = triangles.iter().map(|t| t.map(|v| v + n));
    let body_of = (0..2 * triangles.len() as u32).map(|t| t / triangles.len() as u32).collect();
    (both, triangles.iter().copied().chain(more).collect(), body_of)
}

#[test]
fn meeting_close_and_moving_pairs_equal_brute_force() {
    let (positions, triangles, body_of) = crossing_rings(0.0);
    let corners = |list: &[DVec3], t: u32| triangles[t as usize].map(|v| list[v as usize]);
    for self_collision in [false, true] {
        let searches = BroadPhaseKind::ALL.map(|kind| {
            let params = PairSearchParams { kind, self_collision, margin_m: 1e-3, pair_capacity: 40_000 };
            PairSearch::new(&params, &positions, &triangles, &body_of)
        });
        let rules = searches[0].rules().clone();
        let n = triangles.len() as u32;
        let all: Vec<[u32; 2]> = (0..n).flat_map(|s| (s + 1..n).map(move |t| [s, t])).collect();
        let start = crossing_rings(0.2).0;
        let end = crossing_rings(0.4).0;
        let allowed = all.iter().copied().filter(|&[s, t]| rules.allows(s, t));
        let meeting: Vec<[u32; 2]> =
            allowed.filter(|&[s, t]| triangles_meet(corners(&end, s), corners(&end, t))).collect();
        assert!(meeting.len() >= 100, "{} pairs meet", meeting.len());
        let mut answers = Vec::new();
        for mut search in searches {
            search.update(&start);
            search.update_moving(&start, &end);
            let (mut found, mut close, mut moving) =
                (Vec::with_capacity(9_000), Vec::with_capacity(90_000), Vec::with_capacity(90_000));
            assert_eq!(search.meeting_into(&mut found).n_dropped, 0);
            assert_eq!(found, meeting);
            assert_eq!(search.close_into(&mut close).n_dropped, 0);
            assert_eq!(search.first_contacts_into(&start, &end, &mut moving).n_dropped, 0);
            for pair in &meeting {
                assert!(
                    close.iter().any(|c| c.triangles == *pair && c.closest.distance_m == 0.0)
                        || close.iter().any(|c| c.triangles == *pair && c.closest.distance_m < 1e-12)
                );
                assert!(moving.iter().any(|m| m.triangles == *pair));
            }
            for pair in &close {
                assert!(
                    moving.iter().any(|m| m.triangles == pair.triangles),
                    "close at the end, never found"
                );
            }
            answers.push((close, moving));
        }
        assert!(answers[0] == answers[1] && answers[1] == answers[2], "one answer for all structures");
    }
}

#[test]
fn the_nearest_are_those_of_a_sorted_list_however_many_are_in_reach() {
    let mut random = SeededRandom::new(61);
    for _ in 0..20 {
        let (positions, triangles) = heap(&mut random, 300, 0.5);
        let search = SurfaceSearch::new(BroadPhaseKind::Hierarchy, &positions, &triangles, 0);
        let middle_m = random_vector(&mut random);
        let shape = Capsule { from_m: middle_m, to_m: middle_m + 0.1 * unit(&mut random), radius_m: 5e-3 };
        let mut all = Vec::with_capacity(triangles.len());
        assert_eq!(search.near_into(&shape, 0.5, &positions, &mut all), 0);
        all.sort_by(|a, b| a.contact.gap_m.total_cmp(&b.contact.gap_m).then(a.triangle.cmp(&b.triangle)));
        for room in [1, 2, 7, 100, 400] {
            let mut nearest = Vec::with_capacity(room);
            search.nearest_into(&shape, 0.5, &positions, &mut nearest);
            assert_eq!(nearest, all[..all.len().min(room)], "room for {room} of {}", all.len());
        }
    }
}

#[test]
fn boxes_that_hold_for_many_steps_find_what_fresh_ones_find() {
    // A wave that goes on by some hundredths of a millimetre a step, and jumps once.
    let at = |step: usize| crossing_rings(0.02 * step as f64 + if step > 150 { 1.0 } else { 0.0 }).0;
    let (positions, triangles, _) = crossing_rings(0.0);
    for kind in BroadPhaseKind::ALL {
        let mut search = SurfaceSearch::new(kind, &positions, &triangles, 0);
        let mut start = positions.clone();
        let mut n_found = 0;
        for step in 1..300 {
            let mut end = at(step);
            if (200..203).contains(&step) {
                end[5] = DVec3::NAN;
            }
            let mut fresh = SurfaceSearch::new(kind, &start, &triangles, 0);
            for search in [&mut search, &mut fresh] {
                search.update(&start, &end);
            }
            let ball = Capsule::ball(end[7919 * step % end.len()], 0.5e-3);
            let motion =
                CapsuleMotion::straight(&Capsule::ball(ball.from_m + DVec3::Z * 3e-3, 0.5e-3), &ball);
            let corners_m = [DVec3::ZERO, DVec3::X * 2e-3, DVec3::Z * 3e-3].map(|m| ball.from_m + m);
            let answers = [&search, &fresh].map(|search| {
                let mut near = Vec::with_capacity(100);
                search.nearest_into(&ball, 1e-4, &end, &mut near);
                let of_triangle = search.first_contact_of_triangle([corners_m; 2], 1e-4, &start, &end);
                (near, search.first_contact(&motion, &start, &end), of_triangle)
            });
            assert!(answers[0] == answers[1], "{kind:?}, step {step}");
            n_found += answers[0].0.len();
            start = end;
        }
        assert!(n_found > 1500, "{n_found}");
    }
}

#[test]
fn following_a_surface_and_asking_allocates_nothing() {
    let (positions, triangles, body_of) = crossing_rings(0.0);
    let later: Vec<Vec<DVec3>> = (1..6).map(|i| crossing_rings(0.3 * f64::from(i)).0).collect();
    let motion = CapsuleMotion::straight(
        &Capsule { from_m: DVec3::ZERO, to_m: DVec3::Z, radius_m: 2e-3 },
        &Capsule { from_m: DVec3::X * 0.06, to_m: DVec3::Z, radius_m: 2e-3 },
    );
    for kind in BroadPhaseKind::ALL {
        let params = PairSearchParams { kind, self_collision: true, margin_m: 1e-3, pair_capacity: 40_000 };
        let mut pairs = PairSearch::new(&params, &positions, &triangles, &body_of);
        let mut search = SurfaceSearch::new(kind, &positions, &triangles, 8);
        let (mut meeting, mut close, mut moving, mut near) = (
            Vec::with_capacity(9_000),
            Vec::with_capacity(90_000),
            Vec::with_capacity(90_000),
            Vec::with_capacity(500),
        );
        let mut nearest = Vec::with_capacity(3);
        let mut start = &positions;
        let info = allocation_counter::measure(|| {
            for end in &later {
                pairs.update_moving(start, end);
                pairs.meeting_into(&mut meeting);
                pairs.close_into(&mut close);
                pairs.first_contacts_into(start, end, &mut moving);
                search.update(start, end);
                assert!(search.first_contact(&motion, start, end).is_some());
                search.near_into(&motion.at(1.0), 1e-3, end, &mut near);
                search.nearest_into(&motion.at(1.0), 0.1, end, &mut nearest);
                start = end;
            }
        });
        assert_eq!(info.count_total, 0, "{kind:?}");
        assert!(!meeting.is_empty() && !close.is_empty() && !moving.is_empty() && !near.is_empty());
        assert_eq!(nearest.len(), 3);
    }
}
