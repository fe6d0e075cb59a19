//! Copies that carry a cut mesh: they follow any strokes and removals, and their connections are those of the tissue.
//!
//! The oracle looks at the whole cut mesh at once: two tetrahedra share a corner of the uncut mesh exactly if they hang together
//! through faces in the uncut tetrahedra around it, where slits go all through what they go into.

use glisson::material::{LAWS, LawChoice, LinearElastic};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, TopologyChange};
use glisson::mesh::embedding::{Embedding, EmbeddingUndo};
use glisson::mesh::quality::{FACES, MeshQuality};
use glisson::mesh::refine::{FineRegion, refining};
use glisson::mesh::remap::follow_in_tissue;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::hybrid::condensed::ZoneLaw;
use glisson::model::kind::{MODELS, ModelKind, build_model};
use glisson::model::{
    Answered, BodyZone, Constraints, Correction, DeformableModel, FixedNode, FollowedEdits,
    ImposedDisplacement, LocalModel, LocalWork, ModelUndo, NodalForce, OrganBody, Rayleigh, follow_edit,
};
use glisson::tool::cut::subdivision::{CutReport, SubdivisionCut, SubdivisionParams};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};

const SIZE_M: DVec3 = DVec3::new(0.06, 0.05, 0.04);

/// Sets that grow together.
struct Sets {
    parent: RefCell<Vec<usize>>,
}

impl Sets {
    fn new(n: usize) -> Self {
        Self { parent: RefCell::new((0..n).collect()) }
    }

    fn root(&self, mut at: usize) -> usize {
        let mut parent = self.parent.borrow_mut();
        while parent[at] != at {
            parent[at] = parent[parent[at]];
            at = parent[at];
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent.borrow_mut()[a.max(b)] = a.min(b);
    }
}

/// A face and the place of its tetrahedron.
type Side = ([NodeId; 3], usize);

struct Body {
    first: TetMesh,
    mesh: EditableMesh,
    positions_m: Vec<DVec3>,
    /// The uncut tetrahedron of each tetrahedron.
    origin: Vec<TetId>,
    embedding: Embedding,
    n_edits: usize,
    /// The mesh after each edit, and what it did.
    changes: Vec<(TetMesh, TopologyChange)>,
}

impl Body {
    fn new(mesh: TetMesh) -> Self {
        Self {
            embedding: Embedding::new(&mesh),
            positions_m: mesh.positions_m.clone(),
            origin: (0..mesh.tetrahedra.len()).map(TetId::from_index).collect(),
            mesh: EditableMesh::new(mesh.clone()).expect("a mesh"),
            first: mesh,
            n_edits: 0,
            changes: Vec::new(),
        }
    }

    /// Carries an edit out, and takes it back and does it again every other time.
    fn apply(&mut self, edits: &[MeshEdit]) {
        let (mut change, mut kept) = (TopologyChange::default(), MeshUndo::default());
        self.mesh.apply_all_saving(edits, &mut change, &mut kept).expect("the edits are accepted");
        let mut undo = EmbeddingUndo::default();
        let before = self.embedding.clone();
        let told = self.embedding.follow(self.mesh.mesh(), &change, &mut undo).expect("it lies within");
        if self.n_edits.is_multiple_of(2) {
            let after = self.embedding.clone();
            self.embedding.undo(&undo);
            assert_eq!(format!("{:?}", self.embedding), format!("{before:?}"), "taken back");
            let again = self.embedding.follow(self.mesh.mesh(), &change, &mut undo).expect("as before");
            assert_eq!(again, told);
            assert_eq!(format!("{:?}", self.embedding), format!("{after:?}"), "done again");
        }
        self.check_told(&told, &before);
        self.changes.push((self.mesh.mesh().clone(), change.clone()));
        follow_in_tissue(&mut self.positions_m, &change);
        for (_, parents) in change.tets.added.iter() {
            self.origin.push(self.origin[parents[0].0.index()]);
        }
        self.n_edits += 1;
        self.check();
    }

    /// What is told of the copies leads from those before to those after.
    fn check_told(&self, told: &TopologyChange, before: &Embedding) {
        let (old, new) = (before.copies(), self.embedding.copies());
        assert_eq!((told.tets.n_before, told.tets.n_after), (old.tetrahedra.len(), new.tetrahedra.len()));
        assert_eq!((told.nodes.n_before, told.nodes.n_after), (old.positions_m.len(), new.positions_m.len()));
        assert_eq!(old.tetrahedra[..], new.tetrahedra[..old.tetrahedra.len()], "records stay");
        for (tet, parents) in told.tets.added.iter() {
            let [(parent, weight)] = parents else { panic!("one parent") };
            assert_eq!((*weight, old.corners_m(*parent)), (1.0, new.corners_m(tet)), "the same shape");
        }
    }

    fn live(&self) -> Vec<TetId> {
        self.mesh.topology().live_tets().collect()
    }

    fn check(&self) {
        let (mesh, copies) = (self.mesh.mesh(), self.embedding.copies());
        let live = self.live();
        // Nodes of the cut mesh are where the copies take them.
        let mut n_beside = 0;
        for &tet in &live {
            let copy = copies.tetrahedra[self.embedding.copy_of(tet).index()];
            for node in mesh.tetrahedra[tet.index()] {
                let tie = self.embedding.ties()[node.index()];
                // Ahead of a slit the copy of either side carries it.
                n_beside += usize::from(!tie.iter().all(|(of, _)| copy.contains(&of)));
                assert!((tie.iter().map(|(_, weight)| weight).sum::<f64>() - 1.0).abs() < 1e-12);
                let place_m = tie.mean(|of| copies.positions_m[of.index()]);
                assert!(place_m.distance(mesh.positions_m[node.index()]) < 1e-12, "at rest");
            }
        }
        assert!(10 * n_beside <= 4 * live.len(), "{n_beside} corners of {} tetrahedra", live.len());
        // Each copy has the material that it carries.
        let mut volumes_m3 = vec![0.0; copies.tetrahedra.len()];
        for &tet in &live {
            volumes_m3[self.embedding.copy_of(tet).index()] += mesh.tet_volume_m3(tet);
        }
        for (c, volume_m3) in volumes_m3.iter().enumerate().filter(|(_, volume_m3)| **volume_m3 > 0.0) {
            let copy = TetId::from_index(c);
            let whole_m3 = copies.tet_volume_m3(copy) / copies.share(copy);
            assert!((copies.tet_volume_m3(copy) - volume_m3).abs() <= 1e-12 * whole_m3, "share of {copy}");
        }
        self.check_connections(&live);
    }

    /// Faces with the tetrahedra at them, places in `live`.
    fn faces(&self, live: &[TetId]) -> BTreeMap<[NodeId; 3], Vec<usize>> {
        let mut faces: BTreeMap<[NodeId; 3], Vec<usize>> = BTreeMap::new();
        for (at, tet) in live.iter().enumerate() {
            let nodes = self.mesh.mesh().tetrahedra[tet.index()];
            for face in FACES {
                let mut face = face.map(|i| nodes[i]);
                face.sort_unstable();
                faces.entry(face).or_default().push(at);
            }
        }
        faces
    }

    fn corners_m(&self, face: [NodeId; 3]) -> [DVec3; 3] {
        face.map(|node| self.mesh.mesh().positions_m[node.index()])
    }

    /// Faces that hold though a slit parts them further on: in the plane of a slit in the same piece of an uncut tetrahedron, and on a
    /// face between two uncut ones that is open for the most part.
    fn parted_ahead(
        &self,
        live: &[TetId],
        faces: &BTreeMap<[NodeId; 3], Vec<usize>>,
    ) -> BTreeSet<[NodeId; 3]> {
        let origin = |at: usize| self.origin[live[at].index()];
        let mut pieces = Sets::new(live.len());
        for pair in faces.values().filter(|pair| pair.len() == 2 && origin(pair[0]) == origin(pair[1])) {
            pieces.join(pair[0], pair[1]);
        }
        let mut sides: BTreeMap<[[u64; 3]; 3], Vec<Side>> = BTreeMap::new();
        for (face, tets) in faces.iter().filter(|(_, tets)| tets.len() == 1) {
            let mut places = self.corners_m(*face).map(|p| p.to_array().map(f64::to_bits));
            places.sort_unstable();
            sides.entry(places).or_default().push((*face, tets[0]));
        }
        let area_m2 = |face: [NodeId; 3]| {
            let [a, b, c] = self.corners_m(face);
            (b - a).cross(c - a)
        };
        let slits: Vec<_> =
            sides.values().filter(|slit| slit.len() == 2).map(|slit| [slit[0], slit[1]]).collect();
        let in_piece = slits.iter().filter(|[(_, a), (_, b)]| pieces.root(*a) == pieces.root(*b));
        let planes: Vec<(usize, DVec3, DVec3)> = in_piece
            .map(|[(face, a), _]| (pieces.root(*a), area_m2(*face).normalize(), self.corners_m(*face)[0]))
            .collect();
        let is_in_plane = |face: [NodeId; 3], piece: usize| {
            planes.iter().any(|(of, normal, at_m)| {
                let is_on = |p: DVec3| (p - *at_m).dot(*normal).abs() < 1e-9;
                *of == piece && self.corners_m(face).into_iter().all(is_on)
            })
        };
        let shared = || faces.iter().filter(|(_, pair)| pair.len() == 2);
        let within = |pair: &[usize]| origin(pair[0]) == origin(pair[1]);
        let mut parted: BTreeSet<[NodeId; 3]> = shared()
            .filter(|(face, pair)| within(pair) && is_in_plane(**face, pieces.root(pair[0])))
            .map(|(face, _)| *face)
            .collect();
        // What is left of each piece, and what of the faces between two of them is open.
        let mut left = Sets::new(live.len());
        for (_, pair) in shared().filter(|(face, pair)| within(pair) && !parted.contains(*face)) {
            left.join(pair[0], pair[1]);
        }
        let both = |a: usize, b: usize| [left.root(a).min(left.root(b)), left.root(a).max(left.root(b))];
        let mut open_m2: BTreeMap<[usize; 2], f64> = BTreeMap::new();
        for [(face, a), (_, b)] in slits.into_iter().filter(|[a, b]| origin(a.1) != origin(b.1)) {
            *open_m2.entry(both(a, b)).or_default() += area_m2(face).length();
        }
        for (face, pair) in shared().filter(|(_, pair)| !within(pair)) {
            if let Some(open_m2) = open_m2.get_mut(&both(pair[0], pair[1])) {
                *open_m2 -= area_m2(*face).length();
            }
        }
        let is_open = |pair: &[usize]| open_m2.get(&both(pair[0], pair[1])).is_some_and(|m2| *m2 > 0.0);
        parted.extend(shared().filter(|(_, pair)| !within(pair) && is_open(pair)).map(|(face, _)| *face));
        parted
    }

    fn check_connections(&self, live: &[TetId]) {
        let faces = self.faces(live);
        let parted = self.parted_ahead(live, &faces);
        // Corner k of the uncut tetrahedron of live tetrahedron t has the number 4 t + k.
        let corners = |at: usize| self.first.tetrahedra[self.origin[live[at].index()].index()];
        let mut sets = Sets::new(4 * live.len());
        for (_, pair) in faces.iter().filter(|(face, tets)| tets.len() == 2 && !parted.contains(*face)) {
            for (k, node) in corners(pair[0]).into_iter().enumerate() {
                if let Some(l) = corners(pair[1]).into_iter().position(|other| other == node) {
                    sets.join(4 * pair[0] + k, 4 * pair[1] + l);
                }
            }
        }
        let mut by_set: BTreeMap<usize, NodeId> = BTreeMap::new();
        let mut by_node: BTreeMap<NodeId, usize> = BTreeMap::new();
        for at in 0..live.len() {
            let copy = self.embedding.copies().tetrahedra[self.embedding.copy_of(live[at]).index()];
            for (k, node) in copy.into_iter().enumerate() {
                let set = sets.root(4 * at + k);
                assert_eq!(*by_set.entry(set).or_insert(node), node, "what hangs together has one corner");
                assert_eq!(*by_node.entry(node).or_insert(set), set, "what does not has two");
            }
        }
    }

    fn stroke(&mut self, blades: &[[DVec3; 2]]) -> CutReport {
        let params = SubdivisionParams::embedded(MeshQuality::of(&self.first).mean_edge_m);
        let mut cut = SubdivisionCut::new(params);
        for (at, &blade_m) in blades.iter().enumerate() {
            let is_last = at + 1 == blades.len();
            let planned = if is_last {
                cut.finish(&self.mesh, &self.positions_m, blade_m)
            } else {
                cut.advance(&self.mesh, &self.positions_m, blade_m)
            };
            if let Some(edit) = planned.expect("accepted") {
                self.apply(&[MeshEdit::Replace(edit)]);
            }
        }
        *cut.report()
    }
}

/// A blade that goes across the top in a straight line, at some place, depth and lean.
fn random_stroke(random: &mut SeededRandom) -> Vec<[DVec3; 2]> {
    let angle = random.uniform_in(0.0, std::f64::consts::TAU);
    let along = DVec3::new(angle.cos(), angle.sin(), 0.0);
    let middle = DVec3::new(random.uniform_in(0.015, 0.045), random.uniform_in(0.012, 0.038), SIZE_M.z);
    let lean = random.uniform_in(-0.4, 0.4) * DVec3::new(-along.y, along.x, 0.0);
    let depth_m = random.uniform_in(0.01, 0.05);
    let (from, to) = (random.uniform_in(-0.05, -0.01), random.uniform_in(0.01, 0.05));
    (0..=40)
        .map(|i| {
            let skin_m = middle + along * (from + (to - from) * f64::from(i) / 40.0);
            let down = (lean - DVec3::Z).normalize();
            [skin_m + depth_m * down, skin_m - 0.02 * down]
        })
        .collect()
}

#[test]
fn copies_follow_any_strokes() {
    let mesh = box_of_five([6, 5, 4], SIZE_M);
    let volume_m3 = SIZE_M.element_product();
    let mut random = SeededRandom::new(11);
    let (mut swept_m2, mut off_m2, mut n_copied) = (0.0, 0.0, 0);
    for trial in 0..8 {
        let mut body = Body::new(mesh.clone());
        for _ in 0..3 {
            let report = body.stroke(&random_stroke(&mut random));
            swept_m2 += report.swept_area_m2;
            off_m2 += (report.cut_area_m2 - report.swept_area_m2).abs();
            assert_eq!(report.n_refused, 0, "trial {trial}: {report:?}");
        }
        let now_m3 = body.mesh.volume_m3();
        assert!((now_m3 / volume_m3 - 1.0).abs() < 1e-12, "trial {trial}: {now_m3}");
        n_copied += body.embedding.copies().positions_m.len() - mesh.positions_m.len();
        // A burn takes some of the pieces away.
        let live = body.live();
        let first = live[(random.uniform() * live.len() as f64) as usize];
        let middle = |t: &TetId| body.mesh.mesh().corners_m(*t).into_iter().sum::<DVec3>() / 4.0;
        let burnt = live.iter().copied().filter(|t| middle(t).distance(middle(&first)) < 0.006).collect();
        let edits = body.mesh.parting_removal(burnt).expect("live tetrahedra");
        body.apply(&edits);
    }
    assert!(n_copied > 100, "{n_copied}");
    assert!(off_m2 < 0.02 * swept_m2, "{off_m2} of {swept_m2}");
}

const GRAVITY_M_PER_S2: DVec3 = DVec3::new(0.0, -2.0, -6.0);
const STEP_S: f64 = 1e-4;

/// The block held at one side, which sags.
fn organ_of(mesh: TetMesh) -> OrganBody {
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1060.0).unwrap();
    let held = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].x < 1e-9);
    let fixed = held.map(|n| FixedNode::all_axes(NodeId::from_index(n))).collect();
    OrganBody {
        fixed,
        gravity_m_per_s2: GRAVITY_M_PER_S2,
        damping: Rayleigh::of_mass(20.0),
        ..OrganBody::new(mesh, material, STEP_S)
    }
}

/// Forces and displacements of nodes of a cut mesh.
fn constraints_on(body: &Body) -> Constraints {
    let rest_m = &body.mesh.mesh().positions_m;
    let far = (0..rest_m.len()).filter(|&n| rest_m[n].x > 0.7 * SIZE_M.x).map(NodeId::from_index);
    let (mut constraints, mut is_held) = (Constraints::default(), false);
    for node in far.filter(|node| body.mesh.topology().is_live_node(*node)) {
        is_held = !is_held;
        if is_held && constraints.displacements.len() < 20 {
            constraints.displacements.push(ImposedDisplacement { node, displacement_m: DVec3::X * 1e-3 });
        } else {
            constraints.forces.push(NodalForce { node, force_n: DVec3::Z * 1e-3 });
        }
    }
    constraints
}

/// Steps, local models and answers of a model with embedded cuts allocate nothing, and neither do those of its copy; `implicit`
/// makes the factor of the cut mesh before.
#[test]
fn a_step_with_embedded_cuts_allocates_nothing() {
    let first = box_of_five([5, 4, 3], SIZE_M);
    let mut body = Body::new(first.clone());
    body.stroke(&random_stroke(&mut SeededRandom::new(7)));
    let constraints = constraints_on(&body);
    assert!(constraints.displacements.len() == 20 && constraints.forces.len() > 20);
    let none = Constraints::default();
    let patch: Vec<NodeId> = constraints.forces.iter().map(|force| force.node).take(30).collect();
    for name in ["explicit", "tensor_mass", "implicit"] {
        let kind = ModelKind::by_name(name).unwrap();
        let whole = OrganBody { embeds_cuts: true, ..organ_of(first.clone()) };
        let mut model = build_model(&whole, kind).unwrap();
        for (mesh, change) in &body.changes {
            follow_edit(&mut model, mesh, change, &mut ModelUndo::default()).unwrap();
        }
        let n_nodes = model.state().positions_m.len();
        let mut moves_m = vec![DVec3::ZERO; n_nodes];
        let (mut work, mut local) =
            (LocalWork::with_room_for(2 * n_nodes).telling_drift(), LocalModel::new());
        let mut steps = |model: &mut Box<dyn DeformableModel>| {
            for constraints in [&none, &constraints, &constraints, &none] {
                model.apply(constraints);
                model.step(STEP_S);
                model.local_model_into(&patch, STEP_S, &mut work, &mut local);
                model.answer_into(&constraints.forces, &mut moves_m, Answered::Everywhere);
                model.correct_step(&constraints.forces, STEP_S, Correction::Motion);
            }
        };
        (0..5).for_each(|_| steps(&mut model));
        let mut copy = model.duplicate();
        let mut count = 0;
        for model in [&mut model, &mut copy] {
            count += allocation_counter::measure(|| steps(model)).count_total;
        }
        assert_eq!(count, 0, "{name}");
        assert_eq!(model.state().positions_m, copy.state().positions_m, "{name}");
    }
}

/// Before any cut a finer mesh is finer elements.
#[test]
fn a_mesh_that_is_made_finer_has_finer_elements() {
    let first = box_of_five([5, 4, 3], SIZE_M);
    let mut mesh = EditableMesh::new(first.clone()).unwrap();
    let kind = ModelKind::by_name("explicit").unwrap();
    let plain = organ_of(first);
    let embedded = OrganBody { embeds_cuts: true, ..plain.clone() };
    let mut models = [plain, embedded].map(|organ| build_model(&organ, kind).unwrap());
    let state = |model: &dyn DeformableModel| (model.state().positions_m.to_vec(), model.history());
    let region = FineRegion { center_m: 0.5 * SIZE_M, radius_m: 0.02, edge_m: 0.01 };
    let edits = refining(&mut mesh, &region).unwrap();
    let (mut change, mut kept) = (TopologyChange::default(), MeshUndo::default());
    mesh.apply_all_saving(&edits, &mut change, &mut kept).unwrap();
    let mut undos = [ModelUndo::default(), ModelUndo::default()];
    let before = models.each_ref().map(|model| state(model.as_ref()));
    for (model, undo) in models.iter_mut().zip(&mut undos) {
        model.expect_finer_mesh(true);
        follow_edit(model, mesh.mesh(), &change, undo).unwrap();
        (0..20).for_each(|_| model.step(STEP_S));
    }
    assert!(state(models[0].as_ref()) == state(models[1].as_ref()), "as the model alone");
    for (model, undo) in models.iter_mut().zip(&mut undos) {
        undo.put_back(model);
    }
    assert!(models.each_ref().map(|model| state(model.as_ref())) == before, "taken back");
}

fn typical_law(name: &str) -> LawChoice {
    LawChoice::typical(LAWS.into_iter().find(|entry| entry.name == name).expect("it is in the table"))
}

/// Every model and law that blades cut, after an edit, goes on as one that is made of the copies.
#[test]
fn models_of_copies_go_on_as_those_made_afresh() {
    let first = box_of_five([5, 4, 3], SIZE_M);
    let mut random = SeededRandom::new(5);
    let mut body = Body::new(first.clone());
    body.stroke(&random_stroke(&mut random));
    body.stroke(&random_stroke(&mut random));
    let copies = body.embedding.copies().clone();
    // What is live of the copies, alone.
    let mut is_live = vec![false; copies.tetrahedra.len()];
    body.live().iter().for_each(|tet| is_live[body.embedding.copy_of(*tet).index()] = true);
    let live: Vec<TetId> = (0..is_live.len()).filter(|&t| is_live[t]).map(TetId::from_index).collect();
    let mut nodes: Vec<NodeId> = live.iter().flat_map(|tet| copies.tetrahedra[tet.index()]).collect();
    nodes.sort_unstable();
    nodes.dedup();
    let number = |node: NodeId| NodeId::from_index(nodes.binary_search(&node).expect("it is live"));
    let alone = TetMesh {
        positions_m: nodes.iter().map(|n| copies.positions_m[n.index()]).collect(),
        tetrahedra: live.iter().map(|tet| copies.tetrahedra[tet.index()].map(number)).collect(),
        shares: live.iter().map(|tet| copies.share(*tet)).collect(),
    };
    assert!(live.len() > first.tetrahedra.len() + 50);
    for row in MODELS.iter().filter(|row| row.edits == FollowedEdits::All) {
        let kind = ModelKind::by_name(row.name).unwrap();
        let laws = row.all_laws();
        let laws: Vec<Option<&str>> =
            if laws.is_empty() { vec![None] } else { laws.into_iter().map(Some).collect() };
        for law in laws {
            let what = format!("{kind} {law:?}");
            // All of a hybrid is one zone, which moves from the first cut on.
            let zone = |n_nodes: usize, law: ZoneLaw| {
                let nodes = (0..n_nodes).map(NodeId::from_index).collect();
                if kind == ModelKind::Hybrid { vec![BodyZone { nodes, law }] } else { Vec::new() }
            };
            let cut_law = match law {
                Some("st_venant_kirchhoff") => ZoneLaw::NonlinearTensorMass,
                _ => ZoneLaw::TensorMass,
            };
            let with_law = |organ: OrganBody, zone_law: ZoneLaw| OrganBody {
                law: law.map(typical_law),
                zones: zone(organ.mesh.positions_m.len(), zone_law),
                ..organ
            };
            let organ = OrganBody { embeds_cuts: true, ..organ_of(first.clone()) };
            let whole = with_law(organ, ZoneLaw::Precomputed);
            let mut model = build_model(&whole, kind).unwrap();
            for (mesh, change) in &body.changes {
                follow_edit(&mut model, mesh, change, &mut ModelUndo::default()).unwrap();
            }
            let mut afresh = build_model(&with_law(organ_of(alone.clone()), cut_law), kind).unwrap();
            for model in [&mut model, &mut afresh] {
                // At rest at first, until `implicit` has the factor of the cut mesh: its tolerance is above what is asked here.
                model.set_gravity(DVec3::ZERO);
                (0..30).for_each(|_| model.step(STEP_S));
                model.set_gravity(GRAVITY_M_PER_S2);
                (0..300).for_each(|_| model.step(STEP_S));
            }
            let (of_cut, of_copies) = (model.state().positions_m, afresh.state().positions_m);
            let (mut off_m, mut sag_m): (f64, f64) = (0.0, 0.0);
            for tet in body.live() {
                for node in body.mesh.mesh().tetrahedra[tet.index()] {
                    let carried_m =
                        body.embedding.ties()[node.index()].mean(|of| of_copies[number(of).index()]);
                    off_m = off_m.max(carried_m.distance(of_cut[node.index()]));
                    sag_m = sag_m.max(carried_m.distance(body.mesh.mesh().positions_m[node.index()]));
                }
            }
            assert!(sag_m > 1e-3, "{what}: {sag_m}");
            assert!(off_m < 1e-9 * sag_m, "{what}: {off_m} m of {sag_m} m");
        }
    }
}
