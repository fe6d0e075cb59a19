//! What an edit must not break: adjacency, surface and what is shown against a recount; the model against a fresh one.

use glisson::math::DVec3;
use glisson::mesh::edit::EditableMesh;
use glisson::mesh::topology::Topology;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement};
use glisson::world::World;

/// All that the organ keeps of adjacency and surface equals what is counted anew from its live tetrahedra alone.
pub(super) fn check_adjacency(world: &World, label: &str) {
    let body = world.organ().body();
    let topology = body.topology();
    let live: Vec<TetId> = topology.live_tets().collect();
    let tetrahedra = live.iter().map(|&t| body.mesh().tetrahedra[t.index()]).collect();
    let recount = Topology::build(&TetMesh { positions_m: body.mesh().positions_m.clone(), tetrahedra })
        .unwrap_or_else(|e| panic!("{label}: {e}"));
    assert_eq!(topology.live_counts(), recount.live_counts(), "{label}");
    assert_eq!(topology.euler_characteristic(), recount.euler_characteristic(), "{label}");
    assert_eq!(topology.surface_euler_characteristic(), recount.surface_euler_characteristic(), "{label}");
    assert_eq!(topology.n_surface_triangles(), recount.n_surface_triangles(), "{label}");

    let same = |row: &[TetId], counted: &[TetId]| {
        row.len() == counted.len() && row.iter().zip(counted).all(|(t, c)| *t == live[c.index()])
    };
    for (c, &tet) in live.iter().enumerate() {
        let counted = TetId::from_index(c);
        assert_eq!(topology.tet_nodes(tet), recount.tet_nodes(counted), "{label}: {tet}");
        let neighbours = topology.tet_neighbours(tet).map(|n| n.get());
        let expected = recount.tet_neighbours(counted).map(|n| n.get().map(|c| live[c.index()]));
        assert_eq!(neighbours, expected, "{label}: neighbours of {tet}");
    }
    for node in recount.live_nodes() {
        assert!(topology.is_live_node(node), "{label}: {node}");
        assert!(same(topology.node_tets(node), recount.node_tets(node)), "{label}: tetrahedra at {node}");
        assert_eq!(
            topology.node_edges(node).len(),
            recount.node_edges(node).len(),
            "{label}: edges at {node}"
        );
    }
    for edge in recount.live_edges() {
        let [a, b] = recount.edge_nodes(edge);
        let Some(own) = topology.edge_between(a, b) else { panic!("{label}: no edge {a} {b}") };
        assert!(same(topology.edge_tets(own), recount.edge_tets(edge)), "{label}: tetrahedra at {own}");
    }

    let nodes: Vec<NodeId> = recount.surface_nodes().collect();
    assert_eq!(world.organ().surface_nodes(), nodes, "{label}: what touches");
    let shown = world.display_topology();
    assert_eq!(shown.nodes, nodes, "{label}: what is shown");
    let outward = recount.surface_triangles().map(|t| recount.outward_nodes(t));
    let shown = shown.triangles.iter().map(|t| t.map(|v| shown.nodes[v as usize]));
    assert_eq!(ordered(shown), ordered(outward), "{label}: what is shown");
}

/// Triangles in an order of their own, each from its lowest node on: their sense stays.
fn ordered(triangles: impl Iterator<Item = [NodeId; 3]>) -> Vec<[NodeId; 3]> {
    let turned = |[a, b, c]: [NodeId; 3]| {
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().expect("there are three")
    };
    let mut all: Vec<_> = triangles.map(turned).collect();
    all.sort_unstable();
    all
}

/// How far a model that went through edits is from a fresh one, in shares of the largest of its kind.
#[derive(Clone, Copy, Debug)]
pub(super) struct Difference {
    /// Of the elastic forces of all free nodes.
    pub(super) forces: f64,
    /// Of the weights of all free nodes, which heavier nodes do not change.
    pub(super) weights: f64,
}

/// Strain by which nodes are moved before forces are compared, so that all tetrahedra have some: a choice.
const STRAIN: f64 = 0.1;
/// Weight is told apart from elastic forces by a gravity [m/s2] that makes it as large.
const HEAVY_M_PER_S2: f64 = 1e3;
/// A step that no model divides.
pub(super) const AT_ONCE_S: f64 = 1e-12;

/// Compares `edited`, the model of `body`, with `fresh`, that of its live nodes and tetrahedra alone: the forces that hold
/// all nodes where they are now, moved a little and smoothly. Inertia plays no part in them.
pub(super) fn difference(
    body: &EditableMesh,
    now_m: &[DVec3],
    mut edited: Box<dyn DeformableModel>,
    mut fresh: Box<dyn DeformableModel>,
    label: &str,
) -> Difference {
    let live: Vec<NodeId> = body.topology().live_nodes().collect();
    let per_m = 2.0 * std::f64::consts::PI / 0.1;
    let bent = |p: DVec3| {
        let way = DVec3::new((per_m * p.y).sin(), (per_m * p.z).sin(), (per_m * p.x).sin());
        p + way * (STRAIN / per_m)
    };
    let all_m: Vec<DVec3> = now_m.iter().map(|p| bent(*p)).collect();
    let live_m: Vec<DVec3> = live.iter().map(|n| all_m[n.index()]).collect();
    let rest_m: Vec<DVec3> = live.iter().map(|n| body.mesh().positions_m[n.index()]).collect();
    let held = |model: &mut dyn DeformableModel, all_m: &[DVec3], number: &dyn Fn(usize) -> NodeId| {
        model.take_over(all_m);
        let of_node = |(i, rest_m): (usize, &DVec3)| {
            let node = number(i);
            ImposedDisplacement { node, displacement_m: all_m[node.index()] - *rest_m }
        };
        let displacements = rest_m.iter().enumerate().map(of_node).collect();
        model.apply(&Constraints { displacements, forces: Vec::new() });
        let n_ignored = model.report().n_ignored_constraints;
        let mut under = |gravity_m_per_s2: DVec3| {
            model.set_gravity(gravity_m_per_s2);
            model.step(AT_ONCE_S);
            model.constraint_forces_n().to_vec()
        };
        let elastic_n = under(DVec3::ZERO);
        let heavy_n = under(DVec3::Z * HEAVY_M_PER_S2);
        let weights_n: Vec<DVec3> = heavy_n.iter().zip(&elastic_n).map(|(a, b)| *a - *b).collect();
        (n_ignored, elastic_n, weights_n)
    };
    let (n_fixed, edited_n, edited_weight_n) = held(edited.as_mut(), &all_m, &|i| live[i]);
    let (n_expected, fresh_n, fresh_weight_n) = held(fresh.as_mut(), &live_m, &NodeId::from_index);
    assert_eq!(n_fixed, n_expected, "{label}: nodes that are supported");
    Difference { forces: apart(&edited_n, &fresh_n), weights: apart(&edited_weight_n, &fresh_weight_n) }
}

/// Largest difference over the largest length.
fn apart(found: &[DVec3], expected: &[DVec3]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().map(|f| f.length()).fold(1e-300, f64::max);
    let most = found.iter().zip(expected).map(|(a, b)| (*a - *b).length());
    most.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most }) / largest
}
