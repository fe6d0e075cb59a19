//! Topology, edits and remapping: against counts known by hand, a brute-force recount, and a fresh build.

use std::collections::{BTreeMap, BTreeSet};

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditError, EditableMesh, MeshEdit, PieceChange, TopologyChange};
use glisson_mesh::mesh::remap::{EntityArray, follow};
use glisson_mesh::mesh::topology::{TET_EDGES, TET_TRIANGLES, Through, Topology, TopologyError, surface_of};
use glisson_mesh::mesh::{EdgeId, NodeId, TetId, TetMesh, TriangleId};
use proptest::prelude::*;

/// The cells of an a x b x c grid that `keep` wants, six tetrahedra each (Kuhn's division); 1 m cells.
pub(crate) fn grid([a, b, c]: [usize; 3], keep: impl Fn([usize; 3]) -> bool) -> TetMesh {
    let node = |[i, j, k]: [usize; 3]| i + (a + 1) * (j + (b + 1) * k);
    let mut mesh = TetMesh::default();
    for k in 0..=c {
        for j in 0..=b {
            mesh.positions_m.extend((0..=a).map(|i| DVec3::new(i as f64, j as f64, k as f64)));
        }
    }
    for cell in 0..a * b * c {
        let low = [cell % a, cell / a % b, cell / (a * b)];
        if !keep(low) {
            continue;
        }
        for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
            let mut at = low;
            let mut nodes = [node(at); 4];
            for (step, axis) in order.into_iter().enumerate() {
                at[axis] += 1;
                nodes[step + 1] = node(at);
            }
            if order[1] != (order[0] + 1) % 3 {
                nodes.swap(2, 3);
            }
            mesh.tetrahedra.push(nodes.map(NodeId::from_index));
        }
    }
    mesh
}

fn cube_grid(n: usize) -> TetMesh {
    grid([n; 3], |_| true)
}

#[test]
fn one_tetrahedron_has_four_outer_faces() {
    let mesh = TetMesh {
        positions_m: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        tetrahedra: vec![[0, 1, 2, 3].map(NodeId)],
        ..TetMesh::default()
    };
    let t = Topology::build(&mesh).unwrap();
    assert_eq!([t.n_nodes(), t.n_edges(), t.n_triangles(), t.n_tets()], [4, 6, 4, 1]);
    assert_eq!(t.tet_neighbours(TetId(0)).map(|n| n.number_or_minus_one()), [-1; 4]);
    assert_eq!([t.euler_characteristic(), t.surface_euler_characteristic()], [1, 2]);
    // Each face's normal points away from the node opposite to it.
    for (i, &triangle) in t.tet_triangles(TetId(0)).iter().enumerate() {
        let normal = t.triangle_normal(triangle, &mesh.positions_m);
        let expected = [DVec3::splat(1.0 / 3f64.sqrt()), -DVec3::X, -DVec3::Y, -DVec3::Z][i];
        assert!((normal - expected).length() < 1e-15, "face {i}: {normal}");
    }
    let apex = t.node_normal(NodeId(0), &mesh.positions_m);
    assert!((apex + DVec3::splat(1.0 / 3f64.sqrt())).length() < 1e-15);
}

#[test]
fn box_has_the_counts_of_kuhns_division() {
    let (a, b, c) = (4, 3, 2);
    let mesh = grid([a, b, c], |_| true);
    let t = Topology::build(&mesh).unwrap();
    let cells = a * b * c;
    // Edges: along the axes, across the squares, through the cells.
    let axis = a * (b + 1) * (c + 1) + (a + 1) * b * (c + 1) + (a + 1) * (b + 1) * c;
    let squares = a * b * (c + 1) + a * (b + 1) * c + (a + 1) * b * c;
    let outer_squares = 2 * (a * b + b * c + c * a);
    assert_eq!(t.n_nodes(), (a + 1) * (b + 1) * (c + 1));
    assert_eq!(t.n_edges(), axis + squares + cells);
    assert_eq!(t.n_triangles(), 2 * squares + 6 * cells);
    assert_eq!(t.n_tets(), 6 * cells);
    assert_eq!(t.n_surface_triangles(), 2 * outer_squares);
    assert_eq!(t.n_surface_nodes(), outer_squares + 2);
    assert_eq!(t.n_surface_edges(), 3 * outer_squares);
    assert_eq!([t.euler_characteristic(), t.surface_euler_characteristic()], [1, 2]);
    assert!(t.pinches().is_empty());

    let (surface, nodes) = surface_of(&t, &mesh);
    assert!((surface.volume_m3() - cells as f64).abs() < 1e-12);
    assert_eq!(nodes.len(), t.n_surface_nodes());
    for (v, node) in nodes.iter().enumerate() {
        assert_eq!(surface.positions_m[v], mesh.positions_m[node.index()]);
    }
    let total =
        t.surface_triangles().fold(DVec3::ZERO, |sum, s| sum + t.area_vector_m2(s, &mesh.positions_m));
    assert!(total.length() < 1e-12, "the area vectors of a closed surface cancel: {total}");
}

#[test]
fn shapes_have_their_euler_characteristics() {
    let build = |mesh| Topology::build(&mesh).unwrap();
    let ring = build(grid([3, 3, 1], |c| c != [1, 1, 0]));
    assert_eq!([ring.euler_characteristic(), ring.surface_euler_characteristic()], [0, 0]);
    let hollow = build(grid([3, 3, 3], |c| c != [1, 1, 1]));
    assert_eq!([hollow.euler_characteristic(), hollow.surface_euler_characteristic()], [2, 4]);
    let two = build(grid([3, 1, 1], |c| c[0] != 1));
    assert_eq!([two.euler_characteristic(), two.surface_euler_characteristic()], [2, 4]);
    let pieces = two.pieces(Through::Nodes);
    assert_eq!(pieces.n_tets, [6, 6]);
    assert_eq!(pieces.of_tet[..6], [0; 6]);
    assert_eq!(pieces.of_tet[6..], [1; 6]);
}

#[test]
fn hinge_and_ball_joint_are_found() {
    let hinge = Topology::build(&grid([2, 2, 1], |c| c[0] == c[1])).unwrap();
    let pinches = hinge.pinches();
    assert_eq!(pinches.edges.len(), 1);
    assert_eq!(hinge.edge_nodes(pinches.edges[0]), [NodeId(4), NodeId(13)]);
    assert_eq!(pinches.nodes, [NodeId(4), NodeId(13)]);
    assert_eq!([hinge.pieces(Through::Faces).count(), hinge.pieces(Through::Nodes).count()], [2, 1]);

    let joint = Topology::build(&grid([2, 2, 2], |c| c == [0; 3] || c == [1; 3])).unwrap();
    let pinches = joint.pinches();
    assert_eq!((pinches.edges.len(), &pinches.nodes[..]), (0, &[NodeId(13)][..]));
    assert_eq!([joint.pieces(Through::Faces).count(), joint.pieces(Through::Nodes).count()], [2, 1]);
}

#[test]
fn what_is_no_mesh_is_refused_with_the_place() {
    let corner = cube_grid(1);
    let with = |tet: [u32; 4]| {
        let mut mesh = corner.clone();
        mesh.tetrahedra.push(tet.map(NodeId));
        Topology::build(&mesh).unwrap_err()
    };
    let [n0, n1, n2, n3] = corner.tetrahedra[0].map(|n| n.0);
    assert_eq!(
        with([0, 1, 2, 8]),
        TopologyError::NodeOutOfRange { tet: TetId(6), node: NodeId(8), n_nodes: 8 }
    );
    assert_eq!(with([0, 1, 5, 1]), TopologyError::RepeatedNode { tet: TetId(6), node: NodeId(1) });
    assert_eq!(with([n1, n0, n2, n3]), TopologyError::RepeatedTet { tets: [TetId(0), TetId(6)] });
    let inside = with([n0, n1, n2, if n3 == 6 { 4 } else { 6 }]);
    assert!(
        matches!(inside, TopologyError::CrowdedTriangle { .. } | TopologyError::Folded { .. }),
        "{inside}"
    );
    let mut folded = corner.clone();
    folded.tetrahedra[2].swap(0, 1);
    assert!(matches!(Topology::build(&folded), Err(TopologyError::Folded { .. })));
    let mut three =
        TetMesh { positions_m: vec![DVec3::ZERO; 6], tetrahedra: Vec::new(), ..TetMesh::default() };
    three.tetrahedra.extend([3, 4, 5].map(|n| [0, 1, 2, n].map(NodeId)));
    assert_eq!(
        Topology::build(&three).unwrap_err(),
        TopologyError::CrowdedTriangle {
            nodes: [0, 1, 2].map(NodeId),
            n_tets: 3,
            first: [0, 1, 2].map(TetId)
        }
    );
}

/// Everything that the live tetrahedra say by themselves, recounted without any of the library's tables.
struct Recount {
    edges: BTreeMap<[NodeId; 2], Vec<TetId>>,
    triangles: BTreeMap<[NodeId; 3], Vec<TetId>>,
    nodes: BTreeMap<NodeId, Vec<TetId>>,
}

impl Recount {
    fn of(topology: &Topology) -> Self {
        let mut r = Self { edges: BTreeMap::new(), triangles: BTreeMap::new(), nodes: BTreeMap::new() };
        for tet in topology.live_tets() {
            let nodes = topology.tet_nodes(tet);
            for n in nodes {
                r.nodes.entry(n).or_default().push(tet);
            }
            for [a, b] in TET_EDGES {
                let mut key = [nodes[a], nodes[b]];
                key.sort();
                r.edges.entry(key).or_default().push(tet);
            }
            for face in TET_TRIANGLES {
                let mut key = face.map(|k| nodes[k]);
                key.sort();
                r.triangles.entry(key).or_default().push(tet);
            }
        }
        r
    }

    fn surface(&self) -> impl Iterator<Item = &[NodeId; 3]> {
        self.triangles.iter().filter(|(_, tets)| tets.len() == 1).map(|(nodes, _)| nodes)
    }

    /// Number of pieces through faces or nodes, by merging labels until nothing changes.
    fn n_pieces(&self, through: Through) -> usize {
        let groups: Vec<&Vec<TetId>> = match through {
            Through::Faces => self.triangles.values().collect(),
            Through::Nodes => self.nodes.values().collect(),
        };
        let mut label: BTreeMap<TetId, TetId> = BTreeMap::new();
        for tets in &groups {
            label.extend(tets.iter().map(|&t| (t, t)));
        }
        loop {
            let mut changed = false;
            for tets in &groups {
                let lowest = tets.iter().map(|t| label[t]).min().unwrap();
                for t in *tets {
                    changed |= label.insert(*t, lowest) != Some(lowest);
                }
            }
            if !changed {
                return label.values().collect::<BTreeSet<_>>().len();
            }
        }
    }
}

pub(crate) fn check_against_recount(t: &Topology) {
    let r = Recount::of(t);
    let live = t.live_counts();
    assert_eq!(live.tets, t.live_tets().count());
    let nodes: Vec<NodeId> = t.live_nodes().collect();
    assert_eq!((live.nodes, &nodes), (r.nodes.len(), &r.nodes.keys().copied().collect()));
    check_nodes(t, &r);
    let edges: BTreeMap<_, _> = t.live_edges().map(|e| (t.edge_nodes(e), t.edge_tets(e).to_vec())).collect();
    assert_eq!((live.edges, &edges), (r.edges.len(), &r.edges));
    let triangles: BTreeMap<_, _> = t
        .live_triangles()
        .map(|f| {
            let tets: Vec<TetId> = t.triangle_tets(f).into_iter().filter_map(|t| t.get()).collect();
            (t.triangle_nodes(f), tets)
        })
        .collect();
    assert_eq!((live.triangles, &triangles), (r.triangles.len(), &r.triangles));
    check_local_numbering(t, &r);
    check_surface(t, &r);
    let euler = r.nodes.len() as i64 - r.edges.len() as i64 + r.triangles.len() as i64 - live.tets as i64;
    assert_eq!(t.euler_characteristic(), euler);
}

fn check_nodes(t: &Topology, r: &Recount) {
    for (&n, tets) in &r.nodes {
        assert_eq!(t.node_tets(n), &tets[..]);
        let at_node = r.edges.keys().filter(|e| e.contains(&n)).count();
        assert_eq!(t.node_edges(n).len(), at_node);
        assert!(t.node_edges(n).is_sorted());
        assert!(t.node_edges(n).iter().all(|&e| t.is_live_edge(e) && t.edge_nodes(e).contains(&n)));
    }
}

/// What tetrahedra and triangles say of their own faces, edges and neighbours.
fn check_local_numbering(t: &Topology, r: &Recount) {
    for tet in t.live_tets() {
        for i in 0..4 {
            let mut nodes = TET_TRIANGLES[i].map(|k| t.tet_nodes(tet)[k]);
            nodes.sort();
            assert_eq!(t.triangle_nodes(t.tet_triangles(tet)[i]), nodes);
            let others: Vec<TetId> = r.triangles[&nodes].iter().copied().filter(|&o| o != tet).collect();
            assert_eq!(t.tet_neighbours(tet)[i].get(), others.first().copied());
        }
        for (k, [a, b]) in TET_EDGES.into_iter().enumerate() {
            let mut nodes = [a, b].map(|i| t.tet_nodes(tet)[i]);
            nodes.sort();
            assert_eq!(t.edge_nodes(t.tet_edges(tet)[k]), nodes);
            assert_eq!(t.edge_between(nodes[1], nodes[0]), Some(t.tet_edges(tet)[k]));
        }
    }
    for f in t.live_triangles() {
        for k in 0..3 {
            let mut opposite: Vec<NodeId> = t.triangle_nodes(f).to_vec();
            opposite.remove(k);
            assert_eq!(t.edge_nodes(t.triangle_edges(f)[k])[..], opposite[..]);
        }
    }
}

fn check_surface(t: &Topology, r: &Recount) {
    let surface: Vec<[NodeId; 3]> = r.surface().copied().collect();
    let mut ours: Vec<[NodeId; 3]> = t.surface_triangles().map(|s| t.triangle_nodes(s)).collect();
    ours.sort();
    assert_eq!(ours, surface);
    let surface_nodes: BTreeSet<NodeId> = surface.iter().flatten().copied().collect();
    assert_eq!(t.surface_nodes().collect::<Vec<_>>(), surface_nodes.iter().copied().collect::<Vec<_>>());
    let mut at_edge: BTreeMap<[NodeId; 2], usize> = BTreeMap::new();
    for &[a, b, c] in &surface {
        for edge in [[a, b], [a, c], [b, c]] {
            *at_edge.entry(edge).or_default() += 1;
        }
    }
    assert_eq!(t.n_surface_edges(), at_edge.len());
    check_pinches(t, &surface, &at_edge);
    let surface_euler = surface_nodes.len() as i64 - at_edge.len() as i64 + surface.len() as i64;
    assert_eq!(t.surface_euler_characteristic(), surface_euler);
}

/// Pinched edges have more than two of the surface's triangles; `at_edge` counts them.
fn check_pinches(t: &Topology, surface: &[[NodeId; 3]], at_edge: &BTreeMap<[NodeId; 2], usize>) {
    let surface_nodes: BTreeSet<NodeId> = surface.iter().flatten().copied().collect();
    let pinched: Vec<[NodeId; 2]> = at_edge.iter().filter(|(_, n)| **n > 2).map(|(e, _)| *e).collect();
    let pinches = t.pinches();
    let mut found: Vec<[NodeId; 2]> = pinches.edges.iter().map(|&e| t.edge_nodes(e)).collect();
    found.sort();
    assert_eq!(found, pinched);
    for &n in &surface_nodes {
        // The links of the node's triangles form one cycle without a branch, or the node is pinched.
        let links: Vec<Vec<NodeId>> = surface
            .iter()
            .filter(|f| f.contains(&n))
            .map(|f| f.iter().copied().filter(|&m| m != n).collect())
            .collect();
        let mut reached: BTreeSet<NodeId> = [links[0][0]].into();
        while links.iter().any(|l| reached.contains(&l[0]) != reached.contains(&l[1])) {
            for l in &links {
                if reached.contains(&l[0]) || reached.contains(&l[1]) {
                    reached.extend(l);
                }
            }
        }
        let whole = links.iter().all(|l| reached.contains(&l[0]));
        let simple = !pinched.iter().any(|e| e.contains(&n));
        assert_eq!(pinches.nodes.contains(&n), !(whole && simple), "node {n}");
    }
}

/// Every query of two topologies with the same numbering.
pub(crate) fn assert_same(a: &Topology, b: &Topology) {
    assert_eq!(
        (a.n_nodes(), a.n_edges(), a.n_triangles(), a.n_tets()),
        (b.n_nodes(), b.n_edges(), b.n_triangles(), b.n_tets())
    );
    assert_eq!(a.live_counts(), b.live_counts());
    for t in (0..a.n_tets()).map(TetId::from_index) {
        assert_eq!(a.is_live_tet(t), b.is_live_tet(t));
        assert_eq!(a.tet_nodes(t), b.tet_nodes(t));
        assert_eq!(a.tet_edges(t), b.tet_edges(t));
        assert_eq!(a.tet_triangles(t), b.tet_triangles(t));
        assert_eq!(a.tet_neighbours(t), b.tet_neighbours(t));
    }
    for f in (0..a.n_triangles()).map(TriangleId::from_index) {
        assert_eq!(a.triangle_nodes(f), b.triangle_nodes(f));
        assert_eq!(a.triangle_edges(f), b.triangle_edges(f));
        assert_eq!(a.triangle_tets(f), b.triangle_tets(f));
        assert_eq!(a.outward_nodes(f), b.outward_nodes(f));
    }
    for e in (0..a.n_edges()).map(EdgeId::from_index) {
        assert_eq!(a.edge_nodes(e), b.edge_nodes(e));
        assert_eq!(a.edge_tets(e), b.edge_tets(e));
    }
    for n in (0..a.n_nodes()).map(NodeId::from_index) {
        assert_eq!(a.node_tets(n), b.node_tets(n));
        assert_eq!(a.node_edges(n), b.node_edges(n));
    }
    assert!(a.surface_triangles().eq(b.surface_triangles()));
    assert!(a.surface_nodes().eq(b.surface_nodes()));
    assert_eq!(a.euler_characteristic(), b.euler_characteristic());
    assert_eq!(a.surface_euler_characteristic(), b.surface_euler_characteristic());
    assert_eq!(a.pinches(), b.pinches());
    for through in [Through::Faces, Through::Nodes] {
        assert_eq!(a.pieces(through), b.pieces(through));
    }
}

fn to_set<I: Ord + Copy>(ids: impl IntoIterator<Item = I>) -> BTreeSet<I> {
    ids.into_iter().collect()
}

/// What `change` says against the sets from before and after.
pub(crate) fn check_change(before: &Topology, after: &Topology, change: &TopologyChange) {
    let gone = |a: &BTreeSet<TriangleId>, b: &BTreeSet<TriangleId>| a - b;
    let (faces_a, faces_b) = (to_set(before.live_triangles()), to_set(after.live_triangles()));
    assert_eq!(to_set(change.triangles.removed.iter().copied()), gone(&faces_a, &faces_b));
    assert_eq!(
        to_set(change.tets.removed.iter().copied()),
        &to_set(before.live_tets()) - &to_set(after.live_tets())
    );
    assert_eq!(
        change.edges.removed,
        (&to_set(before.live_edges()) - &to_set(after.live_edges())).into_iter().collect::<Vec<_>>()
    );
    assert_eq!(
        change.nodes.removed,
        (&to_set(before.live_nodes()) - &to_set(after.live_nodes())).into_iter().collect::<Vec<_>>()
    );
    let came =
        |a: usize, ids: &[u32]| assert_eq!(ids, (a as u32..a as u32 + ids.len() as u32).collect::<Vec<_>>());
    came(before.n_nodes(), &change.nodes.added.ids().iter().map(|i| i.0).collect::<Vec<_>>());
    came(before.n_edges(), &change.edges.added.ids().iter().map(|i| i.0).collect::<Vec<_>>());
    came(before.n_triangles(), &change.triangles.added.ids().iter().map(|i| i.0).collect::<Vec<_>>());
    came(before.n_tets(), &change.tets.added.ids().iter().map(|i| i.0).collect::<Vec<_>>());
    assert_eq!(after.n_nodes(), before.n_nodes() + change.nodes.added.ids().len());
    assert_eq!(after.n_edges(), before.n_edges() + change.edges.added.ids().len());
    assert_eq!(after.n_triangles(), before.n_triangles() + change.triangles.added.ids().len());
    assert_eq!(after.n_tets(), before.n_tets() + change.tets.added.ids().len());
    assert_eq!((change.nodes.n_after, change.tets.n_after), (after.n_nodes(), after.n_tets()));
    assert!(to_set(change.nodes.added.ids().iter().copied()).is_subset(&to_set(after.live_nodes())));
    assert!(to_set(change.edges.added.ids().iter().copied()).is_subset(&to_set(after.live_edges())));
    assert!(to_set(change.triangles.added.ids().iter().copied()).is_subset(&faces_b));
    assert!(to_set(change.tets.added.ids().iter().copied()).is_subset(&to_set(after.live_tets())));
    let (surface_a, surface_b) = (to_set(before.surface_triangles()), to_set(after.surface_triangles()));
    assert_eq!(to_set(change.surface_triangles_removed.iter().copied()), gone(&surface_a, &surface_b));
    assert_eq!(to_set(change.surface_triangles_added.iter().copied()), gone(&surface_b, &surface_a));
    let (nodes_a, nodes_b) = (to_set(before.surface_nodes()), to_set(after.surface_nodes()));
    assert_eq!(to_set(change.surface_nodes_removed.iter().copied()), &nodes_a - &nodes_b);
    assert_eq!(to_set(change.surface_nodes_added.iter().copied()), &nodes_b - &nodes_a);
    for (through, pieces) in
        [(Through::Faces, change.pieces.through_faces), (Through::Nodes, change.pieces.through_nodes)]
    {
        let counts = [before, after].map(|t| Recount::of(t).n_pieces(through));
        assert_eq!([before, after].map(|t| t.pieces(through).count()), counts);
        if pieces.is_settled() {
            assert_eq!(counts[1] + pieces.n_gone, counts[0], "{through:?} {pieces:?}");
        }
    }
}

/// Up to six live tetrahedra, ascending.
fn pick_some(topology: &Topology, random: &mut SeededRandom) -> Vec<TetId> {
    let live: Vec<TetId> = topology.live_tets().collect();
    let n = 1 + (random.next_u64() % 6) as usize;
    let first = (random.next_u64() % live.len() as u64) as usize;
    // Half the time neighbours in number, which share faces; else anywhere.
    let together = random.uniform() < 0.5;
    let picked: BTreeSet<TetId> = (0..n)
        .map(|i| {
            let at = if together { first + i } else { random.next_u64() as usize };
            live[at % live.len()]
        })
        .collect();
    picked.into_iter().collect()
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn random_removals_leave_what_a_fresh_build_finds(seed in any::<u64>(), dims in [1usize..4, 1..4, 1..3]) {
        let mut random = SeededRandom::new(seed);
        let mut editable = EditableMesh::new(grid(dims, |_| true)).unwrap();
        let n_tets = editable.topology().n_tets();
        let mut change = TopologyChange::default();
        // Values that say which entity they belong to follow every change.
        let mut by_node = EntityArray::<NodeId, DVec3>::new(editable.mesh().positions_m.clone());
        let edges = 0..editable.topology().n_edges();
        let mut by_edge: EntityArray<EdgeId, f64> = EntityArray::new(edges.map(|e| 1.0 + e as f64).collect());
        let mut by_tet = EntityArray::<TetId, u32>::new((1..).take(n_tets).collect());
        while editable.topology().live_counts().tets > 0 {
            let before = editable.clone();
            let edit = MeshEdit::Remove { tets: pick_some(editable.topology(), &mut random) };
            editable.apply_into(&edit, &mut change).unwrap();
            check_change(before.topology(), editable.topology(), &change);
            check_against_recount(editable.topology());
            by_node.follow(&change);
            by_edge.follow(&change);
            by_tet.follow(&change);
            let t = editable.topology();
            for n in (0..t.n_nodes()).map(NodeId::from_index) {
                let p = if t.is_live_node(n) { editable.mesh().positions_m[n.index()] } else { DVec3::ZERO };
                prop_assert_eq!(by_node[n], p);
            }
            for e in (0..t.n_edges()).map(EdgeId::from_index) {
                prop_assert_eq!(by_edge[e] > 0.0, t.is_live_edge(e));
            }

            let mut compacted = editable.clone();
            let renumbering = compacted.compact();
            assert_same(compacted.topology(), &Topology::build(compacted.mesh()).unwrap());
            prop_assert!(!compacted.topology().has_dead());
            prop_assert_eq!(compacted.volume_m3(), editable.volume_m3());
            let mut moved = (by_node.clone(), by_tet.clone());
            moved.0.follow(&renumbering);
            moved.1.follow(&renumbering);
            prop_assert_eq!(moved.0.as_slice(), &compacted.mesh().positions_m[..]);
            let numbers: Vec<u32> = editable.topology().live_tets().map(|t| t.0 + 1).collect();
            prop_assert_eq!(moved.1.as_slice(), &numbers[..]);
            if random.uniform() < 0.3 {
                // Go on with the compacted mesh.
                by_edge.follow(&renumbering);
                (by_node, by_tet) = moved;
                editable = compacted;
                for (t, value) in by_tet.as_mut_slice().iter_mut().enumerate() {
                    *value = t as u32 + 1;
                }
            }
        }
        prop_assert_eq!(editable.topology().euler_characteristic(), 0);
        prop_assert_eq!(editable.topology().n_surface_triangles(), 0);
    }
}

#[test]
fn removal_needs_no_more_room_than_was_reserved() {
    let mut editable = EditableMesh::new(cube_grid(4)).unwrap();
    let mut change = TopologyChange::with_room_for_removals(5);
    let capacities = |c: &TopologyChange| {
        [
            c.tets.removed.capacity(),
            c.triangles.removed.capacity(),
            c.edges.removed.capacity(),
            c.nodes.removed.capacity(),
            c.surface_triangles_added.capacity(),
            c.surface_triangles_removed.capacity(),
            c.surface_nodes_added.capacity(),
            c.surface_nodes_removed.capacity(),
        ]
    };
    let before = capacities(&change);
    let tets: Vec<TetId> = editable.topology().live_tets().collect();
    for batch in tets.chunks(5) {
        editable.remove_into(batch, &mut change).unwrap();
        assert_eq!(capacities(&change), before);
    }
}

#[test]
fn piece_that_comes_apart_is_announced() {
    let mut editable = EditableMesh::new(grid([3, 1, 1], |_| true)).unwrap();
    let middle: Vec<TetId> = (6..12).map(TetId).collect();
    let change = editable.apply(&MeshEdit::Remove { tets: middle }).unwrap();
    assert!(change.pieces.through_faces.may_have_split && change.pieces.through_nodes.may_have_split);
    assert_eq!(editable.topology().pieces(Through::Nodes).n_tets, [6, 6]);
    // A corner tetrahedron of a full block: certain, without a count.
    let mut block = EditableMesh::new(cube_grid(3)).unwrap();
    let change = block.apply(&MeshEdit::Remove { tets: vec![TetId(0)] }).unwrap();
    assert!(change.pieces.through_faces.is_settled() && change.pieces.through_nodes.is_settled());
    let mut last = EditableMesh::new(grid([3, 1, 1], |c| c[0] != 1)).unwrap();
    last.apply(&MeshEdit::Remove { tets: (1..6).map(TetId).collect() }).unwrap();
    let change = last.apply(&MeshEdit::Remove { tets: vec![TetId(0)] }).unwrap();
    assert_eq!(change.pieces.through_faces, PieceChange { n_gone: 1, may_have_split: false });
    assert_eq!(change.pieces.through_nodes, PieceChange { n_gone: 1, may_have_split: false });
    assert_eq!(change.nodes.removed.len(), 4);
}

#[test]
fn refused_edits_change_nothing() {
    let mut editable = EditableMesh::new(cube_grid(2)).unwrap();
    editable.apply(&MeshEdit::Remove { tets: vec![TetId(7)] }).unwrap();
    let before = format!("{editable:?}");
    let node = NodeId(13);
    let t = |tets: &[u32]| MeshEdit::Remove { tets: tets.iter().copied().map(TetId).collect() };
    let cases = [
        (t(&[1, 48]), EditError::NoSuchTet { tet: TetId(48), n_tets: 48 }),
        (t(&[1, 7]), EditError::DeadTet { tet: TetId(7) }),
        (t(&[1, 2, 1]), EditError::RepeatedTet { tet: TetId(1) }),
        (
            MeshEdit::MoveVertex { node: NodeId(27), position_m: DVec3::ZERO },
            EditError::NoSuchNode { node: NodeId(27), n_nodes: 27 },
        ),
        (
            MeshEdit::MoveVertex { node, position_m: DVec3::INFINITY },
            EditError::NotFinite { node, position_m: DVec3::INFINITY },
        ),
    ];
    for (edit, expected) in cases {
        assert_eq!(editable.apply(&edit), Err(expected));
        assert_eq!(format!("{editable:?}"), before, "{edit:?}");
    }
    let outside = MeshEdit::MoveVertex { node, position_m: DVec3::new(3.0, 1.0, 1.0) };
    assert!(
        matches!(editable.apply(&outside), Err(EditError::WouldInvert { volume_m3, .. }) if volume_m3 <= 0.0)
    );
    assert_eq!(format!("{editable:?}"), before);
}

#[test]
fn moved_vertex_is_moved_and_named() {
    let mut editable = EditableMesh::new(cube_grid(2)).unwrap();
    let volume = editable.volume_m3();
    let position_m = DVec3::new(1.1, 0.95, 1.05);
    let change = editable.apply(&MeshEdit::MoveVertex { node: NodeId(13), position_m }).unwrap();
    assert_eq!(change.moved_nodes, [NodeId(13)]);
    assert_eq!(editable.mesh().positions_m[13], position_m);
    assert!((editable.volume_m3() - volume).abs() < 1e-12, "an inner node moves no volume");
    assert!(!change.is_renumbering() && change.tets.removed.is_empty());
}

#[test]
fn compacting_a_whole_mesh_changes_nothing() {
    let mut editable = EditableMesh::new(cube_grid(2)).unwrap();
    let before = format!("{editable:?}");
    let change = editable.compact();
    assert!(!change.is_renumbering());
    assert_eq!(format!("{editable:?}"), before);
    // A loose node is dead from the start, and goes.
    let mut mesh = cube_grid(1);
    mesh.positions_m.insert(0, DVec3::splat(9.0));
    for nodes in &mut mesh.tetrahedra {
        *nodes = nodes.map(|n| NodeId(n.0 + 1));
    }
    let mut editable = EditableMesh::new(mesh).unwrap();
    assert!(!editable.topology().is_live_node(NodeId(0)));
    let change = editable.compact();
    assert_eq!(change.nodes.new_ids[..2], [None, Some(NodeId(0))]);
    assert_eq!(editable.mesh(), &cube_grid(1));
}

#[test]
fn additions_take_their_parents_blend() {
    // Splitting edge (0, 1) at 1/4: the new node lies between both, the new tetrahedron comes from the old.
    let mut change = TopologyChange::default();
    (change.nodes.n_before, change.nodes.n_after) = (3, 5);
    change.nodes.added.push(NodeId(3), &[(NodeId(0), 0.75), (NodeId(1), 0.25)]);
    change.nodes.added.push(NodeId(4), &[]);
    change.nodes.removed = vec![NodeId(1)];
    (change.tets.n_before, change.tets.n_after) = (1, 2);
    change.tets.added.push(TetId(1), &[(TetId(0), 1.0)]);

    let mut heights = EntityArray::<NodeId, f64>::new(vec![1.0, 2.0, 4.0]);
    heights.follow(&change);
    assert_eq!(heights.as_slice(), [1.0, 0.0, 4.0, 1.25, 0.0]);
    let mut places = vec![DVec3::X, DVec3::Y, DVec3::Z];
    follow::<NodeId, _>(&mut places, &change);
    assert_eq!(places[3], DVec3::new(0.75, 0.25, 0.0));
    let mut pairs = vec![[1.0, 10.0], [2.0, 20.0], [4.0, 40.0]];
    follow::<NodeId, _>(&mut pairs, &change);
    assert_eq!(pairs[3], [1.25, 12.5]);
    let mut labels = vec![7u16, 8, 9];
    follow::<NodeId, _>(&mut labels, &change);
    assert_eq!(labels, [7, 0, 9, 7, 0]);
    let mut zones = vec![3u32];
    follow::<TetId, _>(&mut zones, &change);
    assert_eq!(zones, [3, 3]);
    let mut edges: Vec<f64> = Vec::new();
    follow::<EdgeId, _>(&mut edges, &change);

    let mut compaction = TopologyChange::default();
    (compaction.nodes.n_before, compaction.nodes.n_after) = (5, 4);
    compaction.nodes.new_ids = [Some(0), None, Some(1), Some(2), Some(3)].map(|n| n.map(NodeId)).to_vec();
    heights.follow(&compaction);
    assert_eq!(heights.into_vec(), [1.0, 4.0, 1.25, 0.0]);
    let mut fixed = vec![NodeId(0), NodeId(1), NodeId(4)];
    compaction.nodes.renumber_list(&mut fixed);
    assert_eq!(fixed, [NodeId(0), NodeId(3)]);
}

#[test]
#[should_panic(expected = "missed a change")]
fn array_that_missed_a_change_is_a_bug() {
    let mut change = TopologyChange::default();
    (change.nodes.n_before, change.nodes.n_after) = (3, 3);
    follow::<NodeId, _>(&mut vec![0.0; 4], &change);
}
