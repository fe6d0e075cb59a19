//! Contact detection: fast tools that must not pass through, and pairs of triangles against brute force.

use super::{Experiment, Outcome};
use crate::bench::colliding::{Moving, folded_ring, rocking_cubes};
use glisson::contact::broad_phase::BroadPhaseKind;
use glisson::contact::continuous::{CONTACT_TOLERANCE_M, corners_at};
use glisson::contact::self_collision::{PairSearch, PairSearchParams};
use glisson::contact::shapes::{Capsule, CapsuleMotion};
use glisson::contact::tool_contact::SurfaceSearch;
use glisson::contact::triangles::{at_weights, triangles_meet};
use glisson::math::{DVec3, SeededRandom};
use std::fmt::Write as _;

const OWN: &str = "requirement";

/// Steps of 1 ms: a tool at 5 m/s, a surface at 0.5 m/s.
const TOOL_MOVE_M: f64 = 5e-3;
const SURFACE_MOVE_M: f64 = 0.5e-3;
/// A tip of 2 mm; a shaft of 1 mm, 20 cm long.
const TIP_RADIUS_M: f64 = 1e-3;
const SHAFT_RADIUS_M: f64 = 0.5e-3;
const SHAFT_M: f64 = 0.2;
const LARGEST_INCIDENCE_DEG: f64 = 85.0;
/// Motions of each kind.
const N_MOTIONS: usize = 10_000;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let mut notes = String::from(
        "Each motion touches a random place of the surface at a random time of a step of 1 ms. \"Unseen\" are those that a test of \
         the start and the end of the step alone does not find.\n\n\
         | what moves | motions | touching at the start | missed | unseen without continuous detection |\n|---|---|---|---|---|\n",
    );
    // A lobe, and the same ring as a vessel of 2 mm, which a shaft can pass as a whole.
    let lobe = folded_ring(3_000);
    let vessel = flattened(&lobe);
    let tip = send(&lobe, 21, tip_motion);
    let shaft = send(&vessel, 22, shaft_motion);
    for (name, sent) in [("tip of 2 mm", &tip), ("shaft of 1 mm", &shaft)] {
        let Sent { touching, missed, unseen, .. } = sent;
        writeln!(notes, "| {name} | {N_MOTIONS} | {touching} | {missed} | {unseen} |")?;
        outcome.experiments.push(Experiment::at_most(
            &format!("{name} at 5 m/s, up to 85 degrees, surface at 0.5 m/s: missed of {N_MOTIONS}"),
            OWN,
            *missed as f64,
            0.0,
        ));
        outcome.experiments.push(Experiment::within(
            &format!("{name}: unseen at the start and the end of the step, of {N_MOTIONS}"),
            OWN,
            *unseen as f64,
            [1.0, N_MOTIONS as f64],
        ));
        outcome.experiments.push(Experiment::at_most(
            &format!("{name}: gap at the contact after a clean approach [m]"),
            "continuous.rs, the tolerance",
            sent.largest_gap_m,
            CONTACT_TOLERANCE_M,
        ));
    }
    for (name, moving) in [("folded surface", &lobe), ("four cubes", &rocking_cubes(4))] {
        let (different, n_pairs) = against_brute_force(moving);
        outcome.experiments.push(Experiment::at_most(
            &format!("{name}: pairs of triangles that differ from brute force, three structures"),
            OWN,
            different as f64,
            0.0,
        ));
        outcome.experiments.push(Experiment::within(
            &format!("{name}: fewest pairs of triangles that meet in a step"),
            OWN,
            n_pairs as f64,
            [100.0, 1e6],
        ));
    }
    outcome.notes = notes;
    Ok(outcome)
}

/// The ring pressed to a twentieth of its height, 2 mm: thinner than the way of a tool in a step.
fn flattened(ring: &Moving) -> Moving {
    let flat = |p: &DVec3| DVec3::new(p.x, p.y, 0.05 * p.z);
    Moving {
        frames_m: ring.frames_m.iter().map(|frame| frame.iter().map(flat).collect()).collect(),
        triangles: ring.triangles.clone(),
        body_of: ring.body_of.clone(),
    }
}

/// What became of the motions.
struct Sent {
    touching: usize,
    missed: usize,
    unseen: usize,
    largest_gap_m: f64,
}

/// A place of the surface at a time of the step.
struct Place {
    time: f64,
    point_m: DVec3,
    normal: DVec3,
}

fn unit(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X)
}

/// A direction at an angle of incidence onto a face.
fn incident(normal: DVec3, angle_rad: f64, random: &mut SeededRandom) -> DVec3 {
    let aside = normal.cross(unit(random)).normalize_or(normal.any_orthonormal_vector());
    aside * angle_rad.sin() - normal * angle_rad.cos()
}

fn tip_motion(place: &Place, random: &mut SeededRandom) -> CapsuleMotion {
    let angle_rad = random.uniform_in(0.0, LARGEST_INCIDENCE_DEG.to_radians());
    let direction = incident(place.normal, angle_rad, random);
    let touch_m = place.point_m + place.normal * TIP_RADIUS_M;
    let at = |time: f64| Capsule::ball(touch_m + direction * TOOL_MOVE_M * (time - place.time), TIP_RADIUS_M);
    CapsuleMotion::straight(&at(0.0), &at(1.0))
}

/// The ends move differently: the shaft turns while it sweeps.
fn shaft_motion(place: &Place, random: &mut SeededRandom) -> CapsuleMotion {
    let angle_rad = random.uniform_in(0.0, LARGEST_INCIDENCE_DEG.to_radians());
    let along = incident(place.normal, 90f64.to_radians(), random);
    let share = random.uniform();
    let moves_m = [0, 1].map(|_| incident(place.normal, angle_rad, random) * TOOL_MOVE_M);
    let touch_m = place.point_m + place.normal * SHAFT_RADIUS_M;
    let at = |time: f64| {
        let end_m =
            |e: usize| touch_m + along * SHAFT_M * (share - e as f64) + moves_m[e] * (time - place.time);
        Capsule { from_m: end_m(0), to_m: end_m(1), radius_m: SHAFT_RADIUS_M }
    };
    CapsuleMotion::straight(&at(0.0), &at(1.0))
}

fn send(surface: &Moving, seed: u64, motion: fn(&Place, &mut SeededRandom) -> CapsuleMotion) -> Sent {
    let mut random = SeededRandom::new(seed);
    let start_m = &surface.frames_m[0];
    let (push, turn) = (unit(&mut random), unit(&mut random));
    // Every place at that speed, on ways of its own.
    let moved = |p: &DVec3| *p + (push + turn.cross(*p) / 0.1).normalize_or(push) * SURFACE_MOVE_M;
    let end_m: Vec<DVec3> = start_m.iter().map(moved).collect();
    let triangles = &surface.triangles;
    let mut search = SurfaceSearch::new(BroadPhaseKind::Hierarchy, start_m, triangles, 0);
    search.update(start_m, &end_m);
    let mut at_ends = [start_m, &end_m].map(|positions_m| {
        let mut search = SurfaceSearch::new(BroadPhaseKind::Hierarchy, positions_m, triangles, 0);
        search.update(positions_m, positions_m);
        (search, positions_m)
    });
    let mut near = Vec::with_capacity(1);
    let mut sent = Sent { touching: 0, missed: 0, unseen: 0, largest_gap_m: 0.0 };
    for _ in 0..N_MOTIONS {
        let triangle = triangles[(random.uniform() * triangles.len() as f64) as usize];
        let time = random.uniform();
        let [start, end] = [start_m, &end_m].map(|list| triangle.map(|v| list[v as usize]));
        let corners_m = corners_at(start, end, time);
        let (u, v) = (random.uniform(), random.uniform());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let normal = (corners_m[1] - corners_m[0]).cross(corners_m[2] - corners_m[0]).normalize_or(DVec3::Z);
        let place = Place { time, point_m: at_weights(corners_m, [1.0 - u - v, u, v]), normal };
        let motion = motion(&place, &mut random);
        match search.first_contact(&motion, start_m, &end_m) {
            Some(found) if found.contact.time <= time + 1e-9 => {
                if found.contact.time > 0.0 {
                    sent.largest_gap_m = sent.largest_gap_m.max(found.contact.gap_m);
                } else {
                    sent.touching += 1;
                }
            }
            _ => sent.missed += 1,
        }
        let seen = at_ends.iter_mut().zip([0.0, 1.0]).any(|((search, positions_m), time)| {
            near.clear();
            search.near_into(&motion.at(time), 0.0, positions_m, &mut near);
            !near.is_empty()
        });
        sent.unseen += usize::from(!seen);
    }
    sent
}

/// Pairs in which a structure and the comparison of all triangles with all differ, over some steps, and the fewest pairs of
/// a step.
fn against_brute_force(moving: &Moving) -> (usize, usize) {
    let mut searches = BroadPhaseKind::ALL.map(|kind| {
        let params = PairSearchParams { kind, self_collision: true, margin_m: 0.0, pair_capacity: 1_000_000 };
        PairSearch::new(&params, &moving.frames_m[0], &moving.triangles, &moving.body_of)
    });
    let (mut different, mut fewest) = (0, usize::MAX);
    for frame_m in moving.frames_m.iter().step_by(4) {
        let corners_m = |t: u32| moving.triangles[t as usize].map(|v| frame_m[v as usize]);
        let mut expected = Vec::new();
        for (search, n) in searches.iter_mut().zip(0..) {
            search.update(frame_m);
            if n == 0 {
                let (boxes, rules) = (search.boxes(), search.rules());
                for s in 0..moving.triangles.len() as u32 {
                    for t in s + 1..moving.triangles.len() as u32 {
                        let may = boxes[s as usize].overlaps(&boxes[t as usize]) && rules.allows(s, t);
                        if may && triangles_meet(corners_m(s), corners_m(t)) {
                            expected.push([s, t]);
                        }
                    }
                }
            }
            let mut found = Vec::with_capacity(1_000_000);
            search.meeting_into(&mut found);
            different += found.iter().filter(|pair| expected.binary_search(pair).is_err()).count();
            different += expected.iter().filter(|pair| found.binary_search(pair).is_err()).count();
        }
        fewest = fewest.min(expected.len());
    }
    (different, fewest)
}
