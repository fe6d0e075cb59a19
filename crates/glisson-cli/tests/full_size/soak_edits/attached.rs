//! What is attached to a body's nodes and tetrahedra, kept beside the world by the rules that the library states, and a
//! plain computation of the forces that follow from it.

use super::skin::OwnSkin;
use super::substance::{DENSITY_KG_PER_M3, Substance};
use glisson::math::{DMat3, DVec3, tetrahedron_volume_m3};
use glisson::mesh::edit::{EditableMesh, TopologyChange};
use glisson::mesh::{NodeId, TetId};
use glisson::model::Attachment;
use glisson::world::World;
use glisson::world::spec::{Load, fixed_nodes, nodes_in};

/// Two cuts nearer than this on a tube are one for the library [m].
const SAME_PLACE_M: f64 = 1e-6;

/// Materials, supports, loads and vessels as they have to be now.
#[derive(Clone)]
pub(super) struct Attached {
    /// Number of the material of each tetrahedron.
    pub(super) material: Vec<u8>,
    pub(super) is_fixed: Vec<bool>,
    /// Never renumbered: a ligament stays at its node.
    pub(super) ligaments: Vec<Attachment>,
    is_loaded: Vec<Vec<bool>>,
    forces_n: Vec<DVec3>,
    loads: Vec<Load>,
    time_step_s: f64,
    skin: OwnSkin,
    severed_along: Vec<Option<f64>>,
    /// Whether the middle of each tube has tissue around it.
    has_middle: Vec<bool>,
}

/// The value of the heaviest parent, of the first among equals.
fn of_heaviest<I: Copy, T: Copy>(parents: &[(I, f64)], cleared: T, value: impl Fn(I) -> T) -> T {
    let mut best: Option<(I, f64)> = None;
    for &(parent, weight) in parents {
        if best.is_none_or(|(_, heaviest)| weight > heaviest) {
            best = Some((parent, weight));
        }
    }
    best.map_or(cleared, |(parent, _)| value(parent))
}

impl Attached {
    pub(super) fn new(world: &World, material: Vec<u8>, ligaments: Vec<Attachment>) -> Self {
        let (spec, organ) = (world.spec(), world.organ());
        let rest_m = &organ.mesh().positions_m;
        let mut is_fixed = vec![false; rest_m.len()];
        for fixed in fixed_nodes(&spec.supports, rest_m) {
            is_fixed[fixed.node.index()] = true;
        }
        let topology = organ.body().topology();
        let (mut is_loaded, mut forces_n) = (Vec::new(), Vec::new());
        for load in &spec.loads {
            let mut loaded = vec![false; rest_m.len()];
            for node in nodes_in(&[load.region], rest_m) {
                loaded[node.index()] = topology.is_surface_node(node) && !is_fixed[node.index()];
            }
            let n = loaded.iter().filter(|l| **l).count();
            assert!(n > 0, "the scene's loads have nodes");
            forces_n.push(load.force_n / n as f64);
            is_loaded.push(loaded);
        }
        let vessels = world.vessels().expect("the scene has vessels");
        let n_tubes = vessels.tubes().len();
        let has_middle = (0..n_tubes).map(|i| vessels.middle_m(i, organ.body(), rest_m).is_some()).collect();
        Self {
            material,
            is_fixed,
            ligaments,
            is_loaded,
            forces_n,
            loads: spec.loads.clone(),
            time_step_s: spec.time_step_s,
            skin: OwnSkin::new(world),
            severed_along: vec![None; n_tubes],
            has_middle,
        }
    }

    /// Whether something holds, loads or pulls a node at its own place at rest.
    pub(super) fn is_anchored(&self, node: NodeId) -> bool {
        let is_in = |list: &[bool]| list.get(node.index()).copied().unwrap_or(false);
        is_in(&self.is_fixed)
            || self.is_loaded.iter().any(|loaded| is_in(loaded))
            || self.ligaments.iter().any(|ligament| ligament.node == node)
    }

    /// After an edit, and whether it pulled edges together.
    pub(super) fn follow(&mut self, world: &World, change: &TopologyChange, is_mended: bool) {
        self.skin.follow(world, change, is_mended);
        assert_eq!(self.material.len(), change.tets.n_before);
        for (_, parents) in change.tets.added.iter() {
            let material = of_heaviest(parents, u8::MAX, |parent: TetId| self.material[parent.index()]);
            self.material.push(material);
        }
        assert_eq!(self.is_fixed.len(), change.nodes.n_before);
        for (_, parents) in change.nodes.added.iter() {
            let is_held =
                !parents.is_empty() && parents.iter().all(|(parent, _)| self.is_fixed[parent.index()]);
            self.is_fixed.push(is_held);
            for loaded in &mut self.is_loaded {
                let value = of_heaviest(parents, false, |parent: NodeId| loaded[parent.index()]);
                loaded.push(value);
            }
        }
        for node in &change.nodes.removed {
            self.is_fixed[node.index()] = false;
            self.is_loaded.iter_mut().for_each(|loaded| loaded[node.index()] = false);
        }
    }

    /// Whether the world tells skin from cuts in what came to the surface.
    pub(super) fn check_skin(&self, world: &World, change: &TopologyChange, label: &str) {
        self.skin.check(world, change, label);
    }

    /// Whether the world has the same: supports by node, vessels by place.
    pub(super) fn check(&mut self, world: &World, label: &str) {
        let (body, rest_m) = (world.organ().body(), &world.organ().mesh().positions_m);
        for node in body.topology().live_nodes() {
            assert_eq!(
                world.organ().is_fixed(node),
                self.is_fixed[node.index()],
                "{label}: support of {node}"
            );
        }
        self.check_vessels(world, body, rest_m, label);
    }

    fn check_vessels(&mut self, world: &World, body: &EditableMesh, rest_m: &[DVec3], label: &str) {
        let topology = body.topology();
        let vessels = world.vessels().expect("the scene has vessels");
        let triangles: Vec<[DVec3; 3]> = topology
            .surface_triangles()
            .filter(|&t| world.organ().is_cut(t))
            .map(|t| topology.triangle_nodes(t).map(|n| rest_m[n.index()]))
            .collect();
        for (i, tube) in vessels.tubes().iter().enumerate() {
            let crossings = triangles.iter().filter_map(|corners_m| crossing(tube.ends_m, *corners_m));
            let known = self.severed_along[i].into_iter();
            self.severed_along[i] = known.chain(crossings).min_by(f64::total_cmp);
            let length_m = tube.ends_m[0].distance(tube.ends_m[1]);
            match (vessels.severed_along(i), self.severed_along[i]) {
                (None, None) => {}
                (Some(found), Some(expected))
                    if (found - expected).abs() * length_m <= 1.01 * SAME_PLACE_M => {}
                other => panic!("{label}: tube {i} is severed at {other:?} (found, expected)"),
            }
            let middle_m = tube.point_m(0.5);
            match vessels.middle_m(i, body, rest_m) {
                Some(found_m) => {
                    assert!(found_m.distance(middle_m) < 1e-9, "{label}: middle of tube {i} at {found_m}");
                }
                None if self.has_middle[i] => {
                    let is_around = |t: TetId| weights_in(body.mesh().corners_m(t), middle_m) > 1e-9;
                    let around = topology.live_tets().find(|&t| is_around(t));
                    assert_eq!(around, None, "{label}: the middle of tube {i} is lost");
                    self.has_middle[i] = false;
                }
                None => {}
            }
        }
        for end in vessels.open_ends() {
            let tube = &vessels.tubes()[end.tube as usize];
            let found_m = vessels.end_position_m(end, body, rest_m);
            let expected_m = tube.point_m(end.along);
            assert!(found_m.distance(expected_m) < 1.1e-4, "{label}: end of tube {} at {found_m}", end.tube);
        }
    }

    /// Whether the loads of the last step, number `step`, were on the right nodes.
    pub(super) fn check_loads(&self, world: &World, step: u64, label: &str) {
        let acts: Vec<bool> =
            self.loads.iter().map(|load| load.time.acts_in_step(step, self.time_step_s)).collect();
        let mut found = world.load_forces().iter();
        for n in 0..self.is_fixed.len() {
            let on_node = (0..acts.len()).filter(|&i| acts[i] && self.is_loaded[i][n]);
            let (n_loads, force_n) =
                on_node.fold((0, DVec3::ZERO), |(k, sum), i| (k + 1, sum + self.forces_n[i]));
            if n_loads > 0 {
                let next = found.next().map(|f| (f.node, f.force_n));
                assert_eq!(next, Some((NodeId::from_index(n), force_n)), "{label}: loads");
            }
        }
        assert_eq!(found.next(), None, "{label}: loads");
    }

    /// The force that holds each live node against stress and ligaments [N], and its mass [kg]: a loop over the live
    /// tetrahedra. `now_m` is where nodes are; those that are fixed are where they rest.
    pub(super) fn plain_forces(
        &self,
        body: &EditableMesh,
        now_m: &[DVec3],
        substance: &Substance,
    ) -> (Vec<DVec3>, Vec<f64>) {
        let rest_m = &body.mesh().positions_m;
        let place_m = |n: NodeId| if self.is_fixed[n.index()] { rest_m[n.index()] } else { now_m[n.index()] };
        let (mut forces_n, mut masses_kg) = (vec![DVec3::ZERO; rest_m.len()], vec![0.0; rest_m.len()]);
        let edges = |c: [DVec3; 4]| DMat3::from_cols(c[1] - c[0], c[2] - c[0], c[3] - c[0]);
        for tet in body.topology().live_tets() {
            let nodes = body.mesh().tetrahedra[tet.index()];
            let rest = edges(nodes.map(|n| rest_m[n.index()]));
            let inverse = rest.inverse();
            let volume_m3 = rest.determinant() / 6.0;
            let number = usize::from(self.material[tet.index()]);
            let f = edges(nodes.map(place_m)) * inverse;
            let stress_pa = substance.stress_pa(number, &f);
            let of_corners = stress_pa * inverse.transpose() * volume_m3;
            let others = [of_corners.x_axis, of_corners.y_axis, of_corners.z_axis];
            forces_n[nodes[0].index()] -= others[0] + others[1] + others[2];
            for (node, force_n) in nodes[1..].iter().zip(others) {
                forces_n[node.index()] += force_n;
            }
            let share_kg = 0.25 * volume_m3 * DENSITY_KG_PER_M3;
            nodes.iter().for_each(|n| masses_kg[n.index()] += share_kg);
        }
        let places_m: Vec<DVec3> = (0..rest_m.len()).map(|n| place_m(NodeId::from_index(n))).collect();
        for (sum_n, force_n) in forces_n.iter_mut().zip(self.ligaments_n(&places_m)) {
            *sum_n += force_n;
        }
        (forces_n, masses_kg)
    }

    /// The force that holds each node against its ligaments [N].
    pub(super) fn ligaments_n(&self, places_m: &[DVec3]) -> Vec<DVec3> {
        let mut forces_n = vec![DVec3::ZERO; places_m.len()];
        for ligament in &self.ligaments {
            let n = ligament.node.index();
            forces_n[n] -= ligament.force_n(places_m[n]);
        }
        forces_n
    }
}

/// Least of the four weights of a point in a tetrahedron: above 0 inside.
pub(super) fn weights_in(corners_m: [DVec3; 4], point_m: DVec3) -> f64 {
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    let weight = |i: usize| {
        let mut part_m = corners_m;
        part_m[i] = point_m;
        tetrahedron_volume_m3(part_m) / volume_m3
    };
    (0..4).map(weight).fold(f64::INFINITY, f64::min)
}

/// Where a segment crosses a triangle, 0 to 1 along it: through the plane, then by areas.
fn crossing([from_m, to_m]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let normal = (b - a).cross(c - a);
    let [before, after] = [from_m, to_m].map(|p| (p - a).dot(normal));
    if before * after > 0.0 || before == after {
        return None;
    }
    let along = before / (before - after);
    let point_m = from_m.lerp(to_m, along);
    let is_left = |p: DVec3, q: DVec3| (q - p).cross(point_m - p).dot(normal) >= 0.0;
    (is_left(a, b) && is_left(b, c) && is_left(c, a)).then_some(along)
}

/// The stress memory of each tetrahedron: the last numbers of a model's history.
#[derive(Clone)]
pub(super) struct Memory {
    numbers: Vec<f64>,
    volumes_m3: Vec<f64>,
}

impl Memory {
    pub(super) fn of(world: &World) -> Self {
        let mesh = world.organ().mesh();
        let history = world.history();
        let numbers = history[3 * (2 * mesh.positions_m.len() + 1)..].to_vec();
        let of_tet = |t: usize| mesh.tet_volume_m3(TetId::from_index(t));
        Self { numbers, volumes_m3: (0..mesh.tetrahedra.len()).map(of_tet).collect() }
    }

    fn of_tet(&self, tet: TetId) -> &[f64] {
        let n = self.numbers.len() / self.volumes_m3.len();
        &self.numbers[tet.index() * n..][..n]
    }

    /// Whether what is there after `change` is what was there before: the same bits in tetrahedra that stayed, the parents'
    /// in new ones, all for their volumes.
    pub(super) fn check(&self, world: &World, change: &TopologyChange, label: &str) {
        let after = Self::of(world);
        let topology = world.organ().body().topology();
        let largest = self.numbers.iter().fold(1e-300, |most: f64, x| most.max(x.abs()));
        let is_moved = |n: &NodeId| change.moved_nodes.binary_search(n).is_ok();
        for tet in topology.live_tets().filter(|t| t.index() < change.tets.n_before) {
            let grown = after.volumes_m3[tet.index()] / self.volumes_m3[tet.index()];
            let is_reshaped = topology.tet_nodes(tet).iter().any(is_moved);
            for (found, before) in after.of_tet(tet).iter().zip(self.of_tet(tet)) {
                let is_same = if is_reshaped {
                    (found - before * grown).abs() <= 1e-12 * largest
                } else {
                    found.to_bits() == before.to_bits()
                };
                assert!(is_same, "{label}: memory of {tet}: {found} for {before}, grown {grown}");
            }
        }
        for (tet, parents) in change.tets.added.iter().filter(|(tet, _)| topology.is_live_tet(*tet)) {
            for (i, found) in after.of_tet(tet).iter().enumerate() {
                let of_parent = |&(p, weight): &(TetId, f64)| {
                    weight * self.of_tet(p)[i] / self.volumes_m3[p.index()] * after.volumes_m3[tet.index()]
                };
                let expected: f64 = parents.iter().map(of_parent).sum();
                assert!((found - expected).abs() <= 1e-12 * largest, "{label}: memory of new {tet}");
            }
        }
    }
}

/// Whether new and moved nodes are where their parents say and new tetrahedra where theirs were, unless nodes moved without
/// saying where from.
pub(super) fn check_parents(before_m: &[DVec3], body: &EditableMesh, change: &TopologyChange, label: &str) {
    for (tet, parents) in change.tets.added.iter() {
        let sum: f64 = parents.iter().map(|(_, weight)| weight).sum();
        assert!((sum - 1.0).abs() < 1e-9, "{label}: parents of {tet} have {sum}");
    }
    if change.moved_parents.iter().any(Vec::is_empty) {
        return;
    }
    let (mesh, topology) = (body.mesh(), body.topology());
    let moved =
        change.moved_nodes.iter().zip(&change.moved_parents).map(|(&n, parents)| (n, parents.as_slice()));
    for (node, parents) in change.nodes.added.iter().chain(moved) {
        let mean_m: DVec3 = parents.iter().map(|&(p, weight)| before_m[p.index()] * weight).sum();
        let off_m = mean_m.distance(mesh.positions_m[node.index()]);
        assert!(off_m < 1e-9, "{label}: {node} is {off_m} m from its parents' mean");
    }
    // Tetrahedra at nodes that move keep what they have, as those do that stay. A node that moved may have been pulled onto
    // another afterwards.
    let is_pulled_together = !(change.nodes.removed.is_empty() || change.nodes.added.ids().is_empty());
    if !change.moved_nodes.is_empty() || is_pulled_together {
        return;
    }
    for (tet, parents) in change.tets.added.iter().filter(|(tet, _)| topology.is_live_tet(*tet)) {
        let middle_m = mesh.corners_m(tet).into_iter().sum::<DVec3>() / 4.0;
        let least = parents.iter().map(|&(parent, _)| {
            weights_in(mesh.tetrahedra[parent.index()].map(|n| before_m[n.index()]), middle_m)
        });
        let inside = least.fold(f64::NEG_INFINITY, f64::max);
        assert!(inside > -1e-6, "{label}: {tet} is outside of its parents, {inside}");
    }
}
