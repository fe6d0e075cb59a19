//! Penalty, impulse and geometric responses against closed forms of two bodies, and against what is conserved.

use glisson::contact::broad_phase::BroadPhaseKind;
use glisson::contact::response::bodies::{RespondingBodies, RespondingBody, ResponseKind};
use glisson::contact::response::find::{ContactSearch, ContactSearchParams, RigidPlace};
use glisson::contact::response::geometric::{self, GeometricParams};
use glisson::contact::response::impulse::{self, ImpulseParams};
use glisson::contact::response::penalty::{self, PenaltyLaw, PenaltyParams};
use glisson::contact::response::{Answer, NodeContact};
use glisson::contact::triangles::{at_weights, closest_weights};
use glisson::material::LinearElastic;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::cube_of_five;
use glisson::mesh::{NodeId, TetId};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{Correction, DeformableModel, DynamicBody, FixedNode, NodalForce};

/// Vertices with masses, and contacts between them at random.
struct Heap {
    masses_kg: Vec<f64>,
    inverse_mass_per_kg: Vec<DVec3>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    contacts: Vec<NodeContact>,
}

fn vector(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

impl Heap {
    /// Each contact's vertex lies over its place on the triangle, at the gap along the normal.
    fn random(seed: u64, n_contacts: usize) -> Self {
        let mut random = SeededRandom::new(seed);
        let n = 4 * n_contacts;
        let masses_kg: Vec<f64> = (0..n).map(|_| random.uniform_in(0.1, 3.0)).collect();
        let mut positions_m: Vec<DVec3> = (0..n).map(|_| vector(&mut random)).collect();
        let mut contacts = Vec::new();
        for c in 0..n_contacts as u32 {
            let (a, b) = (random.uniform(), random.uniform());
            let (u, v) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let triangle = [4 * c + 1, 4 * c + 2, 4 * c + 3];
            let at = [1.0 - u - v, u, v];
            let normal = vector(&mut random).normalize();
            let gap_m = random.uniform_in(-0.02, 0.01);
            let place_m = at_weights(triangle.map(|v| positions_m[v as usize]), at);
            positions_m[4 * c as usize] = place_m + normal * gap_m;
            contacts.push(NodeContact::with_triangle(4 * c, triangle, at, normal, gap_m));
            // Further contacts share vertices, so that they meet each other's impulses.
            if c > 0 {
                let mut shared = contacts[c as usize];
                shared.vertices[0] = 4 * (c - 1);
                contacts.push(shared);
            }
        }
        Self {
            inverse_mass_per_kg: masses_kg.iter().map(|m| DVec3::splat(1.0 / m)).collect(),
            velocities_m_per_s: (0..n).map(|_| vector(&mut random)).collect(),
            masses_kg,
            positions_m,
            contacts,
        }
    }

    fn energy_j(&self, velocities_m_per_s: &[DVec3]) -> f64 {
        self.masses_kg.iter().zip(velocities_m_per_s).map(|(m, v)| 0.5 * m * v.length_squared()).sum()
    }

    fn momentum_n_s(&self, velocities_m_per_s: &[DVec3]) -> DVec3 {
        self.masses_kg.iter().zip(velocities_m_per_s).map(|(m, v)| *v * *m).sum()
    }
}

#[test]
fn impulses_conserve_momentum_and_never_add_energy() {
    for seed in 0..50 {
        let heap = Heap::random(seed, 12);
        for (restitution, friction, n_sweeps) in [(1.0, 0.0, 1), (1.0, 0.5, 3), (0.0, 2.0, 5), (0.4, 0.3, 2)]
        {
            let params = ImpulseParams { rest_gap_m: 0.01, restitution, friction, n_sweeps };
            let mut velocities = heap.velocities_m_per_s.clone();
            let mut answer = Answer::none(velocities.len());
            impulse::respond(
                &params,
                &heap.contacts,
                &heap.inverse_mass_per_kg,
                &mut velocities,
                &mut answer,
            );
            let (before_j, after_j) = (heap.energy_j(&heap.velocities_m_per_s), heap.energy_j(&velocities));
            assert!(after_j <= before_j * (1.0 + 1e-14), "{seed} {before_j} {after_j}");
            if restitution == 1.0 && friction == 0.0 {
                assert!((after_j - before_j).abs() < 1e-12 * before_j, "elastic keeps energy");
            }
            let momentum = heap.momentum_n_s(&velocities) - heap.momentum_n_s(&heap.velocities_m_per_s);
            assert!(momentum.length() < 1e-12 * before_j, "{momentum}");
            for (v, j) in velocities.iter().zip(&answer.impulses_n_s).enumerate() {
                let (v, j) = (*j.0, (v, *j.1));
                let expected = heap.velocities_m_per_s[j.0] + heap.inverse_mass_per_kg[j.0] * j.1;
                assert!(v.distance(expected) < 1e-12, "the answer tells what was done");
            }
        }
    }
}

/// One contact: moment about the origin too, for the impulse along the normal.
#[test]
fn a_single_blow_conserves_angular_momentum() {
    let heap = Heap::random(3, 1);
    let mut velocities = heap.velocities_m_per_s.clone();
    let mut answer = Answer::none(4);
    velocities[0] = heap.contacts[0].normal * -20.0;
    let params = ImpulseParams { rest_gap_m: 0.01, ..ImpulseParams::ELASTIC };
    impulse::respond(&params, &heap.contacts, &heap.inverse_mass_per_kg, &mut velocities, &mut answer);
    let moment: DVec3 = heap.positions_m.iter().zip(&answer.impulses_n_s).map(|(x, j)| x.cross(*j)).sum();
    let size: f64 = answer.impulses_n_s.iter().map(|j| j.length()).sum();
    assert!(size > 1.0 && moment.length() < 1e-12 * size, "{moment} of {size}");
}

/// Two masses on a line: v1' = (m1 - e m2)/(m1 + m2) v1 + ..., with the triangle's corners as one mass of 3 m2 hit at its middle.
#[test]
fn two_bodies_part_as_the_closed_form_says() {
    let third = 1.0 / 3.0;
    let contact = NodeContact::with_triangle(0, [1, 2, 3], [third; 3], DVec3::Z, -1e-4);
    let (m1, m2) = (0.2, 0.1);
    let inverse: Vec<DVec3> = [m1, m2, m2, m2].iter().map(|m| DVec3::splat(1.0 / m)).collect();
    let body = 3.0 * m2;
    for e in [0.0, 0.5, 1.0] {
        let (v1, v2) = (-2.0, 0.5);
        let mut velocities =
            vec![DVec3::Z * v1 + DVec3::X * 0.3, DVec3::Z * v2, DVec3::Z * v2, DVec3::Z * v2];
        let mut answer = Answer::none(4);
        let params = ImpulseParams { restitution: e, ..ImpulseParams::ELASTIC };
        impulse::respond(&params, &[contact], &inverse, &mut velocities, &mut answer);
        let common = (m1 * v1 + body * v2) / (m1 + body);
        let after1 = common - e * body * (v1 - v2) / (m1 + body);
        let after2 = common + e * m1 * (v1 - v2) / (m1 + body);
        assert!(velocities[0].distance(DVec3::new(0.3, 0.0, after1)) < 1e-14, "{velocities:?}");
        assert!(velocities[1..].iter().all(|v| v.distance(DVec3::Z * after2) < 1e-14));
        // A second blow finds nothing to do.
        let once = velocities.clone();
        impulse::respond(&params, &[contact], &inverse, &mut velocities, &mut answer);
        assert!(e == 0.0 || velocities == once);
    }
}

#[test]
fn friction_stops_sliding_or_takes_its_share() {
    let contact = NodeContact::with_rigid(0, DVec3::Z, -1e-4, DVec3::new(0.1, 0.0, 0.0));
    let inverse = [DVec3::splat(5.0)];
    let params = ImpulseParams { restitution: 0.0, friction: 0.5, ..ImpulseParams::ELASTIC };
    for (slide, left) in [(0.5, 0.0), (2.0, 1.5), (-3.0, -2.5)] {
        let mut velocities = [DVec3::new(0.1 + slide, 0.0, -1.0)];
        impulse::respond(&params, &[contact], &inverse, &mut velocities, &mut Answer::none(1));
        assert!(velocities[0].distance(DVec3::new(0.1 + left, 0.0, 0.0)) < 1e-14, "{velocities:?}");
    }
}

#[test]
fn what_is_fixed_stays_and_what_is_no_number_does_nothing() {
    let contact = NodeContact::with_triangle(0, [1, 2, 3], [0.2, 0.3, 0.5], DVec3::Z, -0.01);
    let slides_in_x = DVec3::new(2.0, 0.0, 0.0);
    let inverse = [DVec3::splat(2.0), DVec3::ZERO, DVec3::ZERO, slides_in_x];
    let geometric = GeometricParams::sticking(0.0);
    let mut velocities = vec![DVec3::new(1.0, 0.0, -1.0), DVec3::ZERO, DVec3::ZERO, DVec3::ZERO];
    let mut answer = Answer::none(4);
    geometric::respond(&geometric, &[contact], &inverse, &mut velocities, &mut answer);
    assert!(velocities[1] == DVec3::ZERO && velocities[2] == DVec3::ZERO);
    assert!(velocities[3].x != 0.0 && velocities[3].y == 0.0 && velocities[3].z == 0.0);
    assert!((velocities[0].z).abs() < 1e-15);
    let all_fixed = [DVec3::ZERO; 4];
    let before = velocities.clone();
    let mut answer = Answer::none(4);
    geometric::respond(&geometric, &[contact], &all_fixed, &mut velocities, &mut answer);
    assert!(velocities == before && answer == Answer::none(4));
    let lost = NodeContact { gap_m: f64::NAN, ..contact };
    geometric::respond(&geometric, &[lost], &inverse, &mut velocities, &mut answer);
    impulse::respond(&ImpulseParams::ELASTIC, &[lost], &inverse, &mut velocities, &mut answer);
    assert!(answer == Answer::none(4));
    assert_eq!(PenaltyParams::linear(10.0, 0.1).force_n(&lost, &velocities), DVec3::ZERO);
}

/// One geometric step takes back the share of the depth; the centre of mass stays; the rest follows a geometric series.
#[test]
fn geometric_alteration_takes_the_depth_back_by_its_share() {
    let heap = Heap::random(9, 1);
    let mut positions_m = heap.positions_m.clone();
    let start = NodeContact { gap_m: -0.02, ..heap.contacts[0] };
    positions_m[0] -= start.normal * (heap.contacts[0].gap_m + 0.02);
    let center = |x: &[DVec3]| -> DVec3 { x.iter().zip(&heap.masses_kg).map(|(x, m)| *x * *m).sum() };
    let before = center(&positions_m);
    for step in 1..=10 {
        let place_m = at_weights(
            [positions_m[1], positions_m[2], positions_m[3]],
            [-start.weights[1], -start.weights[2], -start.weights[3]],
        );
        let gap_m = (positions_m[0] - place_m).dot(start.normal);
        let mut answer = Answer::none(4);
        let mut velocities = heap.velocities_m_per_s.clone();
        let params = GeometricParams { share: 0.3, ..GeometricParams::sticking(0.0) };
        let contact = NodeContact { gap_m, ..start };
        geometric::respond(&params, &[contact], &heap.inverse_mass_per_kg, &mut velocities, &mut answer);
        for (x, (w, s)) in
            positions_m.iter_mut().zip(heap.inverse_mass_per_kg.iter().zip(&answer.shifts_kg_m))
        {
            *x += *w * *s;
        }
        assert!(gap_m.abs() - 0.02 * 0.7_f64.powi(step - 1) < 1e-12, "{step} {gap_m}");
        assert!(center(&positions_m).distance(before) < 1e-14);
        assert!(heap.energy_j(&velocities) <= heap.energy_j(&heap.velocities_m_per_s));
        assert!(contact.relative_m_per_s(&velocities).dot(contact.normal) > -1e-12);
    }
}

/// Several contacts of one vertex with the same plane are no several times as strong.
#[test]
fn repeated_contacts_do_not_push_twice() {
    let contact = NodeContact::with_rigid(0, DVec3::Z, -0.01, DVec3::ZERO);
    let inverse = [DVec3::splat(2.0)];
    let shift = |n: usize| {
        let mut answer = Answer::none(1);
        let mut velocities = [DVec3::ZERO];
        let params = GeometricParams::sticking(0.0);
        geometric::respond(&params, &vec![contact; n], &inverse, &mut velocities, &mut answer);
        answer.shifts_kg_m[0].z * 2.0
    };
    assert!((shift(1) - 0.005).abs() < 1e-15 && (shift(4) - shift(1)).abs() < 1e-15);
}

/// A mass m that flies against a spring k over the rest gap: back after half a period pi sqrt(m/k), at -e v.
#[test]
fn a_penalty_spring_throws_a_mass_back() {
    let (mass_kg, stiffness, gap_m, speed) = (0.05, 200.0, 2e-3, 0.3);
    for share in [1.0, 0.25] {
        let params = PenaltyParams { receding_share: share, ..PenaltyParams::linear(stiffness, gap_m) };
        let (mut x, mut v, h) = (gap_m, -speed, 1e-6);
        let mut time_s = 0.0;
        while x <= gap_m {
            let contact = NodeContact::with_rigid(0, DVec3::Z, x, DVec3::ZERO);
            v += h * params.force_n(&contact, &[DVec3::Z * v]).z / mass_kg;
            x += h * v;
            time_s += h;
        }
        // Receding on a softer spring takes longer by 1/e.
        let e = share.sqrt();
        assert!((v - e * speed).abs() < 1e-3 * speed, "{share}: {v}");
        let half_s = 0.5 * std::f64::consts::PI * (mass_kg / stiffness).sqrt() * (1.0 + 1.0 / e);
        assert!((time_s - half_s).abs() < 1e-3 * half_s, "{time_s} {half_s}");
    }
}

#[test]
fn penalty_forces_follow_their_laws_and_add_up_to_zero() {
    let heap = Heap::random(4, 20);
    let linear =
        PenaltyParams { damping_n_s_per_m: 3.0, friction: 0.4, ..PenaltyParams::linear(500.0, 0.01) };
    let law = PenaltyLaw::Inverse { strength_n_m: 1e-3, least_gap_m: 1e-3 };
    for params in [linear, PenaltyParams { law, ..linear }] {
        let mut forces = vec![DVec3::ZERO; heap.masses_kg.len()];
        penalty::add_forces(&params, &heap.contacts, &heap.velocities_m_per_s, &mut forces);
        let size: f64 = forces.iter().map(|f| f.length()).sum();
        assert!(size > 1.0 && forces.iter().sum::<DVec3>().length() < 1e-12 * size);
        for contact in &heap.contacts {
            let force = params.force_n(contact, &heap.velocities_m_per_s);
            let normal_n = force.dot(contact.normal);
            assert!(normal_n >= -1e-12, "contacts do not pull");
            assert!((force - contact.normal * normal_n).length() <= 0.4 * normal_n + 1e-9);
        }
    }
    let at = |gap_m: f64, approach: f64, params: &PenaltyParams| {
        let contact = NodeContact::with_rigid(0, DVec3::Z, gap_m, DVec3::ZERO);
        params.force_n(&contact, &[DVec3::Z * -approach]).z
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
    near(at(0.004, 0.0, &linear), 3.0);
    near(at(0.004, 0.5, &linear), 4.5);
    near(at(0.004, -2.0, &linear), 0.0);
    near(at(0.011, 9.0, &linear), 0.0);
    let inverse = PenaltyParams { law, ..linear };
    near(at(0.004, 0.0, &inverse), 0.25);
    near(at(-0.004, 0.0, &inverse), 1.0);
}

/// Two plates of n by n cells, the upper one turned, shifted and seen from below, at the height `height_m`.
fn plates(n: usize, height_m: f64) -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<u32>) {
    let (mut positions_m, mut triangles, mut body_of) = (Vec::new(), Vec::new(), Vec::new());
    for body in 0..2u32 {
        let first = positions_m.len() as u32;
        for j in 0..=n {
            for i in 0..=n {
                let (x, y) = (i as f64 / n as f64 - 0.5, j as f64 / n as f64 - 0.5);
                let wave = 0.01 * (9.0 * x + f64::from(body)).sin();
                positions_m.push(if body == 0 {
                    DVec3::new(x, y, wave)
                } else {
                    DVec3::new(0.9 * x - 0.2 * y + 0.03, 0.9 * y + 0.2 * x, height_m + wave)
                });
            }
        }
        let id = |i: usize, j: usize| first + (i + (n + 1) * j) as u32;
        for j in 0..n {
            for i in 0..n {
                let cell = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
                for [a, b, c] in [[cell[0], cell[1], cell[2]], [cell[0], cell[2], cell[3]]] {
                    triangles.push(if body == 0 { [a, b, c] } else { [a, c, b] });
                    body_of.push(body);
                }
            }
        }
    }
    (positions_m, triangles, body_of)
}

#[test]
fn every_vertex_within_the_margin_is_found_once_at_its_nearest_place() {
    let margin_m = 0.03;
    for height_m in [0.02, -0.015] {
        let (positions_m, triangles, body_of) = plates(9, height_m);
        let n_first = positions_m.len() as u32 / 2;
        let mut answers = Vec::new();
        for kind in BroadPhaseKind::ALL {
            let params =
                ContactSearchParams { kind, margin_m, self_collision: false, pair_capacity: 100_000 };
            let mut search = ContactSearch::new(&params, &positions_m, &triangles, &body_of);
            let mut found = Vec::with_capacity(1000);
            assert_eq!(search.find_into(&positions_m, &mut found), 0);
            answers.push(found);
        }
        assert!(answers[0] == answers[1] && answers[0] == answers[2], "the structure does not show");
        let mut expected = 0;
        for v in 0..positions_m.len() as u32 {
            let of_other = |t: &&[u32; 3]| (t[0] < n_first) != (v < n_first);
            let distance = |t: &[u32; 3]| {
                let corners_m = t.map(|v| positions_m[v as usize]);
                let p = positions_m[v as usize];
                at_weights(corners_m, closest_weights(p, corners_m)).distance(p)
            };
            let nearest_m = triangles.iter().filter(of_other).map(distance).fold(f64::INFINITY, f64::min);
            if nearest_m <= margin_m {
                expected += 1;
                let contact = answers[0].iter().find(|c| c.vertices[0] == v).expect("a contact");
                assert!((contact.gap_m.abs() - nearest_m).abs() < 1e-14);
                assert!((contact.gap_m > 0.0) == (height_m > 0.0), "{contact:?}");
                let up = if v < n_first { -1.0 } else { 1.0 };
                // Beside the other plate's border the way to it is aslant.
                let is_within = contact.weights[1..].iter().all(|w| *w < 0.0);
                assert!(!is_within || contact.normal.z * up > 0.9, "{contact:?}");
            }
        }
        assert!(expected > 100 && answers[0].len() == expected);
        assert!(answers[0].is_sorted_by_key(|c| c.vertices[0]));
    }
}

/// Every vertex with the nearest triangle within the margin, of those that are not attached to the vertex's triangles.
fn nearest_by_all(positions_m: &[DVec3], triangles: &[[u32; 3]], margin_m: f64) -> Vec<(u32, f64)> {
    let mut found = Vec::new();
    for v in 0..positions_m.len() as u32 {
        let own: Vec<u32> = triangles.iter().filter(|t| t.contains(&v)).flatten().copied().collect();
        let distance = |t: &[u32; 3]| {
            let corners_m = t.map(|v| positions_m[v as usize]);
            let p = positions_m[v as usize];
            at_weights(corners_m, closest_weights(p, corners_m)).distance(p)
        };
        let is_whole =
            |t: &&[u32; 3]| t.iter().all(|v| positions_m[*v as usize].abs().cmplt(DVec3::splat(1e30)).all());
        let others = triangles.iter().filter(|t| !t.iter().any(|v| own.contains(v))).filter(is_whole);
        let nearest_m = others.map(distance).fold(f64::INFINITY, f64::min);
        if nearest_m <= margin_m {
            found.push((v, nearest_m));
        }
    }
    found
}

#[test]
fn lone_triangles_that_move_touch_alike_with_every_structure_and_a_broken_one_touches_nothing() {
    let margin_m = 0.05;
    let mut random = SeededRandom::new(9);
    // A triangle owns all of its vertices: the tree of vertices is higher than that of triangles.
    for n in [2_u32, 3, 40, 300] {
        let triangles: Vec<[u32; 3]> = (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let body_of: Vec<u32> = (0..n).collect();
        let side_m = 0.12 * libm::cbrt(f64::from(n));
        let mut place =
            |scale_m: f64| DVec3::new(random.uniform(), random.uniform(), random.uniform()) * scale_m;
        let mut positions_m = Vec::new();
        for _ in 0..n {
            let at = place(side_m);
            positions_m.extend((0..3).map(|_| at + place(0.1)));
        }
        let mut searches = BroadPhaseKind::ALL.map(|kind| {
            let params =
                ContactSearchParams { kind, margin_m, self_collision: false, pair_capacity: 100_000 };
            ContactSearch::new(&params, &positions_m, &triangles, &body_of)
        });
        let mut n_found = 0;
        for step in 0..40 {
            let jump_m = if step % 10 == 9 { 0.3 } else { 0.01 };
            for p in &mut positions_m {
                *p += place(jump_m) - 0.5 * jump_m;
            }
            let whole_m = positions_m[4];
            if step % 3 == 1 {
                positions_m[4] = [DVec3::NAN, DVec3::INFINITY, DVec3::splat(1e200)][step / 3 % 3];
            }
            let mut answers = Vec::new();
            for search in &mut searches {
                let mut found = Vec::with_capacity(3 * n as usize);
                let allocated = allocation_counter::measure(|| {
                    assert_eq!(search.find_into(&positions_m, &mut found), 0);
                });
                assert_eq!(allocated.count_total, 0);
                answers.push(found);
            }
            assert!(answers[0] == answers[1] && answers[0] == answers[2], "{n}, {step}");
            let mut expected = nearest_by_all(&positions_m, &triangles, margin_m);
            // All of the broken triangle's vertices touch nothing.
            expected.retain(|(v, _)| positions_m[4] == whole_m || !(3..6).contains(v));
            let found = answers[2].iter().map(|c| (c.vertices[0], c.gap_m.abs()));
            assert!(found.clone().map(|c| c.0).eq(expected.iter().map(|c| c.0)), "{n}, {step}");
            assert!(found.zip(&expected).all(|(a, b)| (a.1 - b.1).abs() < 1e-12));
            n_found += expected.len();
            positions_m[4] = whole_m;
        }
        assert!(n < 40 || n_found > 400, "{n}: {n_found}");
    }
}

#[test]
fn lists_without_room_are_counted_and_rigid_places_are_appended() {
    let (positions_m, triangles, body_of) = plates(4, 0.01);
    let params = ContactSearchParams {
        kind: BroadPhaseKind::Hierarchy,
        margin_m: 0.05,
        self_collision: false,
        pair_capacity: 1000,
    };
    let mut search = ContactSearch::new(&params, &positions_m, &triangles, &body_of);
    let mut all = Vec::with_capacity(1000);
    assert_eq!(search.find_into(&positions_m, &mut all), 0);
    let mut few = Vec::with_capacity(3);
    assert_eq!(search.find_into(&positions_m, &mut few), all.len() - 3);
    assert!(few.len() == 3 && few[..] == all[..3]);
    let floor =
        |p: DVec3| RigidPlace { distance_m: p.z + 0.02, normal: DVec3::Z, velocity_m_per_s: DVec3::X };
    let n_before = all.len();
    assert_eq!(search.add_rigid(0..25, &positions_m, floor, &mut all), 0);
    assert_eq!(all.len(), n_before + 25);
    assert!(all[n_before..].iter().all(|c| c.gap_m > 0.0 && c.rigid_m_per_s == DVec3::X));
}

// Models.

/// A cube of 4 cm in 5 n^3 tetrahedra at `origin_m` that moves with a velocity, without gravity.
fn cube(n: usize, origin_m: DVec3, velocity_m_per_s: DVec3, fixed: bool) -> RespondingBody {
    let mut mesh = cube_of_five(n + 1, 0.04);
    mesh.positions_m.iter_mut().for_each(|p| *p += origin_m);
    let lowest_m = origin_m.z;
    let held: Vec<FixedNode> = (0..mesh.positions_m.len())
        .filter(|i| fixed && mesh.positions_m[*i].z == lowest_m)
        .map(|i| FixedNode { node: NodeId::from_index(i), axes: [true; 3] })
        .collect();
    let material = LinearElastic::from_young_poisson(20e3, 0.3, 1000.0).unwrap();
    let body = DynamicBody { time_step_s: 2e-4, fixed: &held, ..DynamicBody::new(&mesh, 1000.0) };
    let mut model =
        ExplicitKernel::build(&ExplicitKernelParams::new(body, KernelLaw::StVenantKirchhoff, &[material]))
            .unwrap();
    // A push of one step gives the velocity.
    if velocity_m_per_s != DVec3::ZERO {
        let forces: Vec<NodalForce> = (0..mesh.positions_m.len())
            .map(|i| {
                let node = NodeId::from_index(i);
                NodalForce { node, force_n: velocity_m_per_s * (model.kernel().inertia_kg(node) / 2e-4) }
            })
            .collect();
        model.correct_step(&forces, 2e-4, Correction::Motion);
    }
    RespondingBody { mesh, model: Box::new(model) }
}

fn momentum_n_s(bodies: &RespondingBodies, masses_kg: &[f64], n_bodies: usize) -> DVec3 {
    (0..n_bodies)
        .map(|b| {
            let v = bodies.model(b).state().velocities_m_per_s;
            v.iter().zip(masses_kg).map(|(v, m)| *v * *m).sum::<DVec3>()
        })
        .sum()
}

fn search() -> ContactSearchParams {
    ContactSearchParams {
        kind: BroadPhaseKind::Hierarchy,
        margin_m: 5e-3,
        self_collision: false,
        pair_capacity: 100_000,
    }
}

fn masses_kg(n: usize) -> Vec<f64> {
    let mesh = cube_of_five(n + 1, 0.04);
    let mut masses = vec![0.0; mesh.positions_m.len()];
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let share = 250.0 * mesh.tet_volume_m3(TetId::from_index(t));
        nodes.iter().for_each(|node| masses[node.index()] += share);
    }
    masses
}

fn kinds() -> [ResponseKind; 3] {
    let penalty =
        PenaltyParams { damping_n_s_per_m: 0.05, friction: 0.2, ..PenaltyParams::linear(150.0, 1e-3) };
    [
        ResponseKind::Penalty(penalty),
        ResponseKind::Impulse(ImpulseParams {
            rest_gap_m: 0.0,
            restitution: 0.5,
            friction: 0.2,
            n_sweeps: 2,
        }),
        ResponseKind::Geometric(GeometricParams::sticking(0.0)),
    ]
}

/// Two cubes fly into each other, askew: they do not pass, part again, and momentum stays.
#[test]
fn colliding_cubes_keep_their_momentum_and_do_not_pass() {
    let masses = masses_kg(3);
    let mass_kg: f64 = masses.iter().sum();
    for kind in kinds() {
        let speed = DVec3::new(0.0, 0.02, -0.4);
        let bodies = vec![
            cube(3, DVec3::ZERO, DVec3::ZERO, false),
            cube(3, DVec3::new(0.007, 0.005, 0.043), speed, false),
        ];
        let mut bodies = RespondingBodies::new(bodies, kind, &search()).unwrap();
        let before = momentum_n_s(&bodies, &masses, 2);
        assert!(before.distance(speed * mass_kg) < 1e-9, "{before}");
        let (mut deepest_m, mut most) = (0.0_f64, 0);
        for _ in 0..600 {
            bodies.step(2e-4);
            deepest_m = deepest_m.max(bodies.report().penetration_m);
            most = most.max(bodies.report().n_contacts);
            assert_eq!(bodies.report().n_dropped, 0);
        }
        let after = momentum_n_s(&bodies, &masses, 2);
        assert!(after.distance(before) < 1e-9, "{kind:?}: {before} {after}");
        assert!(most > 8 && deepest_m < 2e-3, "{kind:?}: {most} contacts, {deepest_m} m deep");
        // The one below has been pushed down, the other does not fall faster.
        let mean = |b: usize| {
            let v = bodies.model(b).state().velocities_m_per_s;
            v.iter().zip(&masses).map(|(v, m)| v.z * m).sum::<f64>() / mass_kg
        };
        assert!(mean(0) < -0.1 && mean(1) > mean(0), "{kind:?}: {} {}", mean(0), mean(1));
        let energy_j: f64 = (0..2).map(|b| bodies.model(b).report().kinetic_energy_j).sum();
        assert!(energy_j <= 0.5 * mass_kg * speed.length_squared() * 1.001, "{kind:?}: {energy_j} J");
    }
}

/// A cube that is held below is pressed by another one against a rigid plate from above: the held nodes do not move.
#[test]
fn held_nodes_stay_and_rigid_plates_are_not_passed() {
    for kind in kinds() {
        let bodies = vec![
            cube(2, DVec3::ZERO, DVec3::ZERO, true),
            cube(2, DVec3::new(0.004, 0.003, 0.0405), DVec3::ZERO, false),
        ];
        let held_m: Vec<DVec3> = bodies[0].mesh.positions_m.clone();
        let mut bodies = RespondingBodies::new(bodies, kind, &search()).unwrap();
        let mut deepest_m = 0.0_f64;
        for step in 0..1000 {
            let height_m = 0.0805 - 1e-5 * f64::from(step.min(600));
            let speed = if step < 600 { -0.05 } else { 0.0 };
            let plate = |p: DVec3| RigidPlace {
                distance_m: height_m - p.z,
                normal: -DVec3::Z,
                velocity_m_per_s: DVec3::Z * speed,
            };
            bodies.step_against(2e-4, Some(&plate));
            deepest_m = deepest_m.max(bodies.report().penetration_m);
        }
        let now_m = bodies.model(0).state().positions_m;
        assert!(held_m.iter().zip(now_m).all(|(a, b)| a.z > 0.0 || a == b), "{kind:?}: held nodes moved");
        let highest_m = bodies.model(1).state().positions_m.iter().fold(0.0_f64, |h, p| h.max(p.z));
        // Impulses stop an approach and leave the depth: under a lasting load it grows.
        let allowed_m = if matches!(kind, ResponseKind::Impulse(_)) { 4e-3 } else { 2.5e-3 };
        assert!(deepest_m < allowed_m && highest_m < 0.0765, "{kind:?}: {deepest_m} {highest_m}");
        assert!(now_m.iter().all(|p| p.is_finite()));
    }
}

#[test]
fn the_same_steps_give_the_same_bits_and_wrong_bodies_are_refused() {
    let run = || {
        let bodies = vec![
            cube(2, DVec3::ZERO, DVec3::ZERO, false),
            cube(2, DVec3::new(0.004, 0.003, 0.0405), DVec3::Z * -0.2, false),
        ];
        let mut bodies = RespondingBodies::new(bodies, kinds()[2], &search()).unwrap();
        (0..200).for_each(|_| bodies.step(2e-4));
        bodies.model(1).state().positions_m.to_vec()
    };
    assert_eq!(run(), run());
    let other =
        RespondingBody { mesh: cube_of_five(2, 0.04), model: cube(2, DVec3::ZERO, DVec3::ZERO, false).model };
    let refused = RespondingBodies::new(vec![other], kinds()[0], &search()).err().unwrap();
    assert!(refused.to_string().contains("8 nodes"), "{refused}");
}
