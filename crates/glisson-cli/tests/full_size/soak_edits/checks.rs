//! What an edit must not break: adjacency, surface and what is shown against a recount; the model against a fresh one.

use super::draw::Limit;
use super::substance::AT_ONCE_S;
use glisson::math::{DMat3, DVec3};
use glisson::mesh::edit::EditableMesh;
use glisson::mesh::topology::{EntityCounts, TET_EDGES, TET_TRIANGLES};
use glisson::mesh::{NodeId, TetId};
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement};
use glisson::world::World;

/// What a list of tetrahedra has, counted without any of the library's adjacency.
struct Recount {
    live: Vec<TetId>,
    /// Tetrahedra at each node, ascending.
    node_tets: Vec<Vec<TetId>>,
    /// The edges with their tetrahedra, ascending.
    edges: Vec<([NodeId; 2], Vec<TetId>)>,
    n_triangles: usize,
    /// Across the triangle opposite to each corner, by place in `live`.
    neighbours: Vec<[Option<TetId>; 4]>,
    /// Triangles of one tetrahedron, outward.
    surface: Vec<[NodeId; 3]>,
    surface_nodes: Vec<NodeId>,
    n_surface_edges: usize,
}

impl Recount {
    fn of(body: &EditableMesh, label: &str) -> Self {
        let tetrahedra = &body.mesh().tetrahedra;
        let live: Vec<TetId> = body.topology().live_tets().collect();
        let n_nodes = body.mesh().positions_m.len();
        // By their lowest node: what follows are short lists.
        let mut node_tets = vec![Vec::new(); n_nodes];
        let mut faces = vec![Vec::new(); n_nodes];
        let mut ends = vec![Vec::new(); n_nodes];
        for (place, &tet) in live.iter().enumerate() {
            let nodes = tetrahedra[tet.index()];
            nodes.iter().for_each(|n| node_tets[n.index()].push(tet));
            for (corner, face) in TET_TRIANGLES.iter().enumerate() {
                let mut sorted = face.map(|i| nodes[i]);
                sorted.sort_unstable();
                faces[sorted[0].index()].push((sorted[1], sorted[2], place, corner));
            }
            for [a, b] in TET_EDGES.map(|edge| edge.map(|i| nodes[i])) {
                ends[a.min(b).index()].push((a.max(b), tet));
            }
        }
        let mut edges: Vec<([NodeId; 2], Vec<TetId>)> = Vec::new();
        for (low, list) in ends.iter_mut().enumerate() {
            list.sort_unstable();
            for of_edge in list.chunk_by(|x, y| x.0 == y.0) {
                let tets = of_edge.iter().map(|(_, tet)| *tet).collect();
                edges.push(([NodeId::from_index(low), of_edge[0].0], tets));
            }
        }
        let (mut n_triangles, mut surface) = (0, Vec::new());
        let mut neighbours = vec![[None; 4]; live.len()];
        for list in &mut faces {
            list.sort_unstable();
            for of_triangle in list.chunk_by(|x, y| (x.0, x.1) == (y.0, y.1)) {
                n_triangles += 1;
                match *of_triangle {
                    [(_, _, place, corner)] => {
                        let nodes = tetrahedra[live[place].index()];
                        surface.push(TET_TRIANGLES[corner].map(|i| nodes[i]));
                    }
                    [(_, _, s, i), (_, _, t, j)] => {
                        neighbours[s][i] = Some(live[t]);
                        neighbours[t][j] = Some(live[s]);
                    }
                    _ => panic!("{label}: {} tetrahedra at one triangle", of_triangle.len()),
                }
            }
        }
        let mut surface_nodes: Vec<NodeId> = surface.iter().flatten().copied().collect();
        surface_nodes.sort_unstable();
        surface_nodes.dedup();
        let sides =
            |[a, b, c]: [NodeId; 3]| [(a.min(b), a.max(b)), (b.min(c), b.max(c)), (a.min(c), a.max(c))];
        let mut surface_edges: Vec<_> = surface.iter().flat_map(|t| sides(*t)).collect();
        surface_edges.sort_unstable();
        surface_edges.dedup();
        let n_surface_edges = surface_edges.len();
        Self { live, node_tets, edges, n_triangles, neighbours, surface, surface_nodes, n_surface_edges }
    }
}

/// All that the organ keeps of adjacency and surface equals what is counted anew from its live tetrahedra alone.
pub(super) fn check_adjacency(world: &World, label: &str) {
    let topology = world.organ().body().topology();
    let recount = Recount::of(world.organ().body(), label);
    let Recount { live, node_tets, edges, n_triangles, surface, .. } = &recount;
    let n_nodes = node_tets.iter().filter(|tets| !tets.is_empty()).count();
    let counted =
        EntityCounts { nodes: n_nodes, edges: edges.len(), triangles: *n_triangles, tets: live.len() };
    assert_eq!(topology.live_counts(), counted, "{label}");
    let euler = |numbers: &[usize]| numbers.iter().rev().fold(0, |sum, n| *n as i64 - sum);
    let of_solid = euler(&[n_nodes, edges.len(), *n_triangles, live.len()]);
    assert_eq!(topology.euler_characteristic(), of_solid, "{label}");
    let of_surface = euler(&[recount.surface_nodes.len(), recount.n_surface_edges, surface.len()]);
    assert_eq!(topology.surface_euler_characteristic(), of_surface, "{label}");
    assert_eq!(topology.n_surface_triangles(), surface.len(), "{label}");

    for (&tet, expected) in live.iter().zip(&recount.neighbours) {
        assert_eq!(topology.tet_nodes(tet), world.organ().mesh().tetrahedra[tet.index()], "{label}: {tet}");
        let neighbours = topology.tet_neighbours(tet).map(|n| n.get());
        assert_eq!(neighbours, *expected, "{label}: neighbours of {tet}");
    }
    for (n, tets) in node_tets.iter().enumerate() {
        let node = NodeId::from_index(n);
        assert_eq!(topology.is_live_node(node), !tets.is_empty(), "{label}: {node}");
        assert_eq!(topology.node_tets(node), tets, "{label}: tetrahedra at {node}");
    }
    for ([a, b], tets) in edges {
        let Some(own) = topology.edge_between(*a, *b) else { panic!("{label}: no edge {a} {b}") };
        assert_eq!(topology.edge_tets(own), tets, "{label}: tetrahedra at {own}");
    }

    assert_eq!(world.organ().surface_nodes(), recount.surface_nodes, "{label}: what touches");
    let shown = world.display_topology();
    assert_eq!(shown.nodes, recount.surface_nodes, "{label}: what is shown");
    let shown = shown.triangles.iter().map(|t| t.map(|v| shown.nodes[v as usize]));
    assert_eq!(ordered(shown), ordered(surface.iter().copied()), "{label}: what is shown");
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
/// Weights are measured under a gravity [m/s2] beside which rounding of other forces counts for nothing.
const HEAVY_M_PER_S2: f64 = 1e3;

/// What holds all nodes of a model where they are told to be, elastic forces and weights, and how many of the nodes it holds
/// itself.
struct HeldForces {
    n_fixed: u32,
    elastic_n: Vec<DVec3>,
    weights_n: Vec<DVec3>,
}

impl HeldForces {
    /// Of `model`, with its nodes at rest at `rest_m` and now at `now_m`: those named by `nodes` are held. Inertia plays no part.
    fn of(model: &mut dyn DeformableModel, rest_m: &[DVec3], now_m: &[DVec3], nodes: &[NodeId]) -> Self {
        let mut under = |at_m: &[DVec3], gravity_m_per_s2: DVec3| {
            let of_node = |&node: &NodeId| {
                let n = node.index();
                ImposedDisplacement { node, displacement_m: at_m[n] - rest_m[n] }
            };
            let displacements = nodes.iter().map(of_node).collect();
            // Without memory of stress, which relaxes even in so short a step.
            model.take_over(at_m);
            model.apply(&Constraints { displacements, forces: Vec::new() });
            model.set_gravity(gravity_m_per_s2);
            model.step(AT_ONCE_S);
            (model.constraint_forces_n().to_vec(), model.report().n_ignored_constraints)
        };
        let (elastic_n, n_fixed) = under(now_m, DVec3::ZERO);
        // At rest, where nothing else is felt.
        let (weights_n, _) = under(rest_m, DVec3::Z * HEAVY_M_PER_S2);
        Self { n_fixed, elastic_n, weights_n }
    }
}

/// Places now, moved a little and smoothly, so that all tetrahedra have some strain.
fn bent(now_m: &[DVec3]) -> Vec<DVec3> {
    let per_m = 2.0 * std::f64::consts::PI / 0.1;
    let bent = |p: &DVec3| {
        let way = DVec3::new((per_m * p.y).sin(), (per_m * p.z).sin(), (per_m * p.x).sin());
        *p + way * (STRAIN / per_m)
    };
    now_m.iter().map(bent).collect()
}

/// Tissue that is longer than this many times its length is stretched beyond measure: of the sixteen digits of a force, which
/// goes with the cube of the stretch in laws that keep volume, less than ten are left.
pub(super) const GREATEST_STRETCH: f64 = 100.0;

/// Places now, with the nodes of tetrahedra that are stretched beyond measure at rest, and how many these are.
pub(super) fn within_measure(body: &EditableMesh, now_m: &[DVec3]) -> (Vec<DVec3>, usize) {
    let (rest_m, topology) = (&body.mesh().positions_m, body.topology());
    let (mut places_m, mut is_put_back) = (now_m.to_vec(), vec![false; now_m.len()]);
    loop {
        let length_m =
            |places_m: &[DVec3], [a, b]: [NodeId; 2]| places_m[a.index()].distance(places_m[b.index()]);
        let stretched: Vec<[NodeId; 2]> = topology
            .live_edges()
            .map(|edge| topology.edge_nodes(edge))
            .filter(|&ends| length_m(&places_m, ends) > GREATEST_STRETCH * length_m(rest_m, ends))
            .collect();
        if stretched.is_empty() {
            return (places_m, is_put_back.iter().filter(|b| **b).count());
        }
        // One end can be back already: then the other goes as well, so that it ends.
        for node in stretched.into_iter().flatten() {
            places_m[node.index()] = rest_m[node.index()];
            is_put_back[node.index()] = true;
        }
    }
}

/// Places with the nodes of tetrahedra beyond a limit at rest, and how many these are.
fn within_limit(body: &EditableMesh, places_m: &[DVec3], limit: Limit) -> (Vec<DVec3>, usize) {
    let (rest_m, topology) = (&body.mesh().positions_m, body.topology());
    let edges = |c: [DVec3; 4]| DMat3::from_cols(c[1] - c[0], c[2] - c[0], c[3] - c[0]);
    let (mut places_m, mut is_put_back) = (places_m.to_vec(), vec![false; places_m.len()]);
    loop {
        let is_beyond = |places_m: &[DVec3], t: TetId| {
            let of_tet = |all_m: &[DVec3]| edges(topology.tet_nodes(t).map(|n| all_m[n.index()]));
            let f = of_tet(places_m) * of_tet(rest_m).inverse();
            let squares: f64 = f.to_cols_array().iter().map(|x| x * x).sum();
            f.determinant() < limit.least_ratio || squares > limit.most_squares
        };
        let beyond: Vec<TetId> = topology.live_tets().filter(|&t| is_beyond(&places_m, t)).collect();
        let nodes = beyond.into_iter().flat_map(|t| topology.tet_nodes(t)).map(NodeId::index);
        let away: Vec<usize> = nodes.filter(|&n| !is_put_back[n]).collect();
        // With all its nodes at rest a tetrahedron is within any limit, so that it ends.
        if away.is_empty() {
            return (places_m, is_put_back.iter().filter(|b| **b).count());
        }
        for n in away {
            (places_m[n], is_put_back[n]) = (rest_m[n], true);
        }
    }
}

/// Places now, moved a little, and how many nodes were put back at rest: those of tetrahedra beyond a limit. Then supports are
/// at rest as well, as they are in models.
pub(super) fn measured(world: &World, now_m: &[DVec3], limit: Option<Limit>) -> (Vec<DVec3>, usize) {
    let (organ, mut all_m) = (world.organ(), bent(now_m));
    let Some(limit) = limit else { return (all_m, 0) };
    for n in (0..all_m.len()).filter(|&n| organ.is_fixed(NodeId::from_index(n))) {
        all_m[n] = organ.mesh().positions_m[n];
    }
    within_limit(organ.body(), &all_m, limit)
}

/// Compares `edited`, the model of `body`, with `fresh`, that of its live nodes and tetrahedra alone: the forces that hold
/// all nodes at `all_m`.
pub(super) fn difference(
    body: &EditableMesh,
    all_m: &[DVec3],
    mut edited: Box<dyn DeformableModel>,
    mut fresh: Box<dyn DeformableModel>,
    label: &str,
) -> Difference {
    let live: Vec<NodeId> = body.topology().live_nodes().collect();
    let rest_m = &body.mesh().positions_m;
    let of_live = |all: &[DVec3]| live.iter().map(|n| all[n.index()]).collect::<Vec<_>>();
    let new: Vec<NodeId> = (0..live.len()).map(NodeId::from_index).collect();
    let found = HeldForces::of(edited.as_mut(), rest_m, all_m, &live);
    let expected = HeldForces::of(fresh.as_mut(), &of_live(rest_m), &of_live(all_m), &new);
    assert_eq!(found.n_fixed, expected.n_fixed, "{label}: nodes that are supported");
    Difference {
        forces: apart(&found.elastic_n, &expected.elastic_n),
        weights: apart(&found.weights_n, &expected.weights_n),
    }
}

/// How far the forces that hold some nodes out of a body at rest are apart, in shares of the largest.
pub(super) fn compliance_difference(
    rest_m: &[DVec3],
    held: &[ImposedDisplacement],
    mut edited: Box<dyn DeformableModel>,
    mut fresh: Box<dyn DeformableModel>,
) -> f64 {
    let forces_n = |model: &mut dyn DeformableModel| {
        model.take_over(rest_m);
        model.apply(&Constraints { displacements: held.to_vec(), forces: Vec::new() });
        model.step(AT_ONCE_S);
        model.constraint_forces_n().to_vec()
    };
    apart(&forces_n(edited.as_mut()), &forces_n(fresh.as_mut()))
}

/// What a plain computation says of each live node.
pub(super) struct Plain {
    /// Force that holds it, none of a fixed one [N].
    pub(super) forces_n: Vec<DVec3>,
    /// The same where all nodes rest: that of ligaments at nodes that were moved at rest.
    pub(super) at_rest_n: Vec<DVec3>,
    pub(super) masses_kg: Vec<f64>,
    pub(super) is_fixed: Vec<bool>,
}

/// Compares `edited`, the model of `body`, with a plain computation where all nodes are at `all_m`: rest places moved a
/// little, where every tetrahedron counts and none hides behind crumbs that fly. Answers also the sum of the model's
/// masses [kg], in which fixed nodes, whose weight nobody feels, stand with their plain ones.
pub(super) fn against_plain(
    body: &EditableMesh,
    mut edited: Box<dyn DeformableModel>,
    all_m: &[DVec3],
    plain: impl Fn(&[DVec3]) -> Plain,
    label: &str,
) -> (Difference, f64) {
    let live: Vec<NodeId> = body.topology().live_nodes().collect();
    let rest_m = &body.mesh().positions_m;
    let found = HeldForces::of(edited.as_mut(), rest_m, all_m, &live);
    let plain = plain(all_m);
    let n_fixed = plain.is_fixed.iter().filter(|f| **f).count();
    assert_eq!(found.n_fixed as usize, n_fixed, "{label}: nodes that are supported");
    let n = live.len();
    let masses_n = (0..n).map(|i| DVec3::Z * (-HEAVY_M_PER_S2 * plain.masses_kg[i]));
    let weights_n: Vec<DVec3> = masses_n
        .enumerate()
        .map(|(i, weight_n)| if plain.is_fixed[i] { DVec3::ZERO } else { weight_n + plain.at_rest_n[i] })
        .collect();
    let mass_kg = (0..n).map(|i| {
        let found_kg = (plain.at_rest_n[i].z - found.weights_n[i].z) / HEAVY_M_PER_S2;
        if plain.is_fixed[i] { plain.masses_kg[i] } else { found_kg }
    });
    let difference = Difference {
        forces: apart(&found.elastic_n, &plain.forces_n),
        weights: apart(&found.weights_n, &weights_n),
    };
    (difference, mass_kg.sum())
}

/// Largest difference over the largest length.
fn apart(found: &[DVec3], expected: &[DVec3]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().map(|f| f.length()).fold(1e-300, f64::max);
    let most = found.iter().zip(expected).map(|(a, b)| (*a - *b).length());
    most.fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most }) / largest
}
