//! Cutting by vertex displacement (seed `000` s. 4.4.2).

use glisson::image::labels::Parts;
use glisson::image::phantom::{self, PhantomParams};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::{box_of_five, irregular_cube};
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::quality::radius_ratio;
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetMesh};
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams, ScalpelRefusal};

/// A body under the knife. `deform` takes rest places to present ones.
struct Operation {
    body: EditableMesh,
    cut: ScalpelCut,
    deform: fn(DVec3) -> DVec3,
    edits: Vec<MeshEdit>,
    volume_m3: f64,
    n_tets: usize,
}

impl Operation {
    fn on(mesh: TetMesh) -> Self {
        let body = EditableMesh::new(mesh).unwrap();
        let n_tets = body.topology().live_counts().tets;
        Self {
            volume_m3: body.volume_m3(),
            n_tets,
            body,
            cut: ScalpelCut::new(ScalpelParams::default()),
            deform: |p| p,
            edits: Vec::new(),
        }
    }

    fn positions_m(&self) -> Vec<DVec3> {
        self.body.mesh().positions_m.iter().map(|&p| (self.deform)(p)).collect()
    }

    /// Carries edits out; each must be accepted and keep what a cut keeps.
    fn carry_out(&mut self, edits: Vec<MeshEdit>) {
        for edit in edits {
            self.body.apply(&edit).unwrap();
            self.edits.push(edit);
        }
        assert!((self.body.volume_m3() / self.volume_m3 - 1.0).abs() < 1e-12, "volume");
        assert_eq!(self.body.topology().live_counts().tets, self.n_tets);
    }

    fn hold(&mut self, blade_m: [DVec3; 2]) {
        while let Some(edits) = self.cut.advance(&self.body, &self.positions_m(), blade_m).unwrap() {
            self.carry_out(edits);
        }
    }

    fn lift(&mut self) {
        while let Some(edits) = self.cut.finish(&self.body, &self.positions_m()).unwrap() {
            self.carry_out(edits);
        }
        self.check();
    }

    /// A blade that hangs down to `depth_m` below the tips' heights moves straight in `n_steps`.
    fn stroke(&mut self, tips_m: [DVec3; 2], up_m: DVec3, n_steps: usize) {
        for k in 0..=n_steps {
            let tip_m = tips_m[0].lerp(tips_m[1], k as f64 / n_steps as f64);
            self.hold([tip_m, tip_m + up_m]);
        }
        self.lift();
    }

    fn check(&self) {
        let topology = self.body.topology();
        for tet in topology.live_tets() {
            assert!(radius_ratio(self.body.mesh().corners_m(tet)) > 0.0);
        }
        // Nothing hangs by a node alone. (A cut that touches another part of the surface makes a place where the
        // surface is pinched, but the tissue goes on around it.)
        for node in topology.live_nodes() {
            let star = topology.node_tets(node);
            let mut reached = vec![star[0]];
            for at in 0.. {
                let Some(&tet) = reached.get(at) else { break };
                for (k, next) in topology.tet_neighbours(tet).into_iter().enumerate() {
                    let is_at_node = topology.tet_nodes(tet)[k] != node;
                    if let Some(next) = next.get().filter(|t| is_at_node && !reached.contains(t)) {
                        reached.push(next);
                    }
                }
            }
            assert_eq!(reached.len(), star.len(), "node {node} holds parts together");
        }
    }

    fn n_pieces(&self) -> usize {
        self.body.topology().pieces(Through::Faces).count()
    }

    fn euler(&self) -> [i64; 2] {
        let topology = self.body.topology();
        [topology.euler_characteristic(), topology.surface_euler_characteristic()]
    }
}

fn slab(cells: [usize; 3]) -> TetMesh {
    box_of_five(cells, DVec3::new(cells[0] as f64, cells[1] as f64, cells[2] as f64) * 0.01)
}

#[test]
fn an_incision_opens_the_surface_and_leaves_one_ball() {
    let mut operation = Operation::on(slab([8, 6, 4]));
    // From above into the middle of the top, along x, and out upwards.
    let up_m = 0.05 * DVec3::Z;
    let down = DVec3::new(0.0213, 0.0314, 0.034);
    operation.hold([down + 0.016 * DVec3::Z, down + 0.066 * DVec3::Z]);
    operation.stroke([down, down + DVec3::new(0.04, 0.002, 0.0)], up_m, 40);
    assert_eq!(operation.n_pieces(), 1);
    assert_eq!(operation.euler(), [1, 2]);
    let report = operation.cut.report();
    assert!(report.n_copies >= 2, "{report:?}");
}

#[test]
fn a_cut_across_a_plate_makes_two() {
    let mut operation = Operation::on(slab([8, 6, 1]));
    let from_m = DVec3::new(0.0413, -0.02, -0.01);
    operation.stroke([from_m, from_m + DVec3::new(0.003, 0.10, 0.0)], 0.05 * DVec3::Z, 60);
    assert_eq!(operation.n_pieces(), 2);
    assert_eq!(operation.euler(), [2, 4]);
}

#[test]
fn a_deep_cut_across_a_box_makes_two() {
    let mut operation = Operation::on(slab([8, 6, 3]));
    let from_m = DVec3::new(0.0413, -0.02, -0.01);
    operation.stroke([from_m, from_m + DVec3::new(0.003, 0.10, 0.0)], 0.05 * DVec3::Z, 60);
    assert_eq!(operation.n_pieces(), 2);
    assert_eq!(operation.euler(), [2, 4]);
}

fn bounds_m(mesh: &TetMesh) -> [DVec3; 2] {
    mesh.positions_m.iter().fold([DVec3::MAX, DVec3::MIN], |[low, high], &p| [low.min(p), high.max(p)])
}

/// Strokes from anywhere to anywhere with a leaning blade.
fn random_strokes(mesh: TetMesh, seed: u64, n: usize) -> Operation {
    let [low_m, high_m] = bounds_m(&mesh);
    let size_m = high_m - low_m;
    let mut operation = Operation::on(mesh);
    let mut random = SeededRandom::new(seed);
    let mut within = || DVec3::new(random.uniform(), random.uniform(), random.uniform());
    for _ in 0..n {
        let from_m = low_m + size_m * (1.6 * within() - 0.3);
        let to_m = low_m + size_m * (1.6 * within() - 0.3);
        let up_m = (DVec3::Z + 0.5 * (within() - 0.5)).normalize() * 2.0 * size_m.length();
        operation.stroke([from_m, to_m], up_m, 30);
    }
    operation
}

#[test]
fn random_strokes_keep_a_sound_mesh() {
    let mut n_copies = 0;
    for seed in 0..6 {
        n_copies += random_strokes(slab([8, 6, 3]), seed, 8).cut.report().n_copies;
        n_copies += random_strokes(irregular_cube(0.05, seed), 100 + seed, 8).cut.report().n_copies;
    }
    assert!(n_copies > 200, "{n_copies}");
}

/// A long blade goes straight through, somewhere near the middle, from outside to outside.
fn straight_through(mesh: &TetMesh, seed: u64) -> Operation {
    let [low_m, high_m] = bounds_m(mesh);
    let mut random = SeededRandom::new(seed);
    let turn = std::f64::consts::TAU * random.uniform();
    let way = DVec3::new(turn.cos(), turn.sin(), 0.0);
    let size_m = (high_m - low_m).length();
    let shift = DVec3::new(random.uniform() - 0.5, random.uniform() - 0.5, 0.0);
    let mut middle_m = 0.5 * (low_m + high_m) + 0.1 * size_m * shift;
    middle_m.z = low_m.z - 0.1 * size_m;
    let mut operation = Operation::on(mesh.clone());
    operation.stroke([middle_m - size_m * way, middle_m + size_m * way], 2.0 * size_m * DVec3::Z, 60);
    operation
}

#[test]
fn a_blade_straight_through_a_box_always_makes_two() {
    for seed in 0..12 {
        let operation = straight_through(&slab([8, 6, 3]), seed);
        assert_eq!(operation.n_pieces(), 2, "seed {seed}");
        assert_eq!(operation.euler()[0], 2, "seed {seed}");
    }
}

fn phantom_liver(n_tets: usize) -> TetMesh {
    let phantom = phantom::generate(&PhantomParams { seed: 4, voxel_m: 6e-3, ..PhantomParams::default() });
    let labels = &phantom.labels;
    let selection = labels.select("liver", Parts::Included).unwrap();
    let (surface, _) =
        surface_of_mask(&labels.grid, &labels.mask(&selection), &SurfaceParams::default()).unwrap();
    let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: None };
    generate(&surface, &params).unwrap().0
}

#[test]
fn the_phantom_liver_is_cut_through() {
    let mesh = phantom_liver(3_000);
    let mut n_cut = 0;
    for seed in 0..6 {
        let operation = straight_through(&mesh, seed);
        n_cut += usize::from(operation.n_pieces() > 1);
    }
    assert!(n_cut >= 5, "{n_cut} of 6");
    random_strokes(mesh, 7, 4);
}

/// Selected and moved nodes of a thin blade that goes over the top of a slab, and where the blade was when they moved.
fn watch(operation: &mut Operation, tips_m: [DVec3; 2], n_steps: usize) -> Vec<(NodeId, DVec3, DVec3)> {
    let mut moves = Vec::new();
    for k in 0..=n_steps {
        let tip_m = tips_m[0].lerp(tips_m[1], k as f64 / n_steps as f64);
        operation.hold([tip_m, tip_m + 0.05 * DVec3::Z]);
        for edit in operation.edits.drain(..) {
            if let MeshEdit::MoveVertex { node, position_m } = edit {
                moves.push((node, position_m, tip_m));
            }
        }
    }
    moves
}

#[test]
fn a_node_moves_onto_the_path_only_when_the_blade_moves_away_from_it() {
    let mut operation = Operation::on(slab([8, 6, 4]));
    let y_m = 0.0313;
    let tips_m = [DVec3::new(0.0213, y_m, 0.036), DVec3::new(0.0555, y_m, 0.036)];
    let moves = watch(&mut operation, tips_m, 342);
    let top = |x: u32| NodeId(x + 9 * (3 + 7 * 4));
    let of = |node: NodeId| moves.iter().find(|m| m.0 == node).copied().unwrap();
    // The first one at once, to the place where the blade went in.
    let (_, first_m, tip_m) = of(top(2));
    assert!(first_m.abs_diff_eq(DVec3::new(0.0213, y_m, 0.04), 1e-12) && tip_m == tips_m[0]);
    // The others when the blade is past them, to the place where it was nearest.
    for x in 3..=5 {
        let (_, place_m, tip_m) = of(top(x));
        let node_m = f64::from(x) * 0.01;
        assert!((place_m.x - node_m).abs() < 2e-4 && (place_m.y - y_m).abs() < 1e-12, "{place_m}");
        assert!(tip_m.x > node_m && tip_m.x < node_m + 1e-3, "{tip_m}");
    }
    // The last one was never passed, and a candidate is no selected node.
    assert!(moves.iter().all(|m| m.0 != top(6)));
    // Nodes between two selected ones are open; the first and the last are not.
    let selected = [2, 3, 4, 5].map(top);
    let n_at = |x_m: f64| {
        let is_there = |p: &&DVec3| p.abs_diff_eq(DVec3::new(x_m, y_m, 0.04), 3e-4);
        operation.body.mesh().positions_m.iter().filter(is_there).count()
    };
    let places = selected.map(|n| operation.body.mesh().positions_m[n.index()].x);
    assert_eq!(places.map(n_at), [1, 2, 2, 1]);
}

#[test]
fn a_trembling_blade_selects_nothing_twice() {
    let mut operation = Operation::on(slab([8, 6, 4]));
    let mut random = SeededRandom::new(3);
    let start_m = DVec3::new(0.0213, 0.0313, 0.036);
    for _ in 0..200 {
        let shake_m = 5e-4 * DVec3::new(random.normal(), random.normal(), random.normal());
        operation.hold([start_m + shake_m, start_m + shake_m + 0.05 * DVec3::Z]);
    }
    assert_eq!((operation.cut.report().n_selected, operation.cut.report().n_copies), (1, 0));
}

#[test]
fn a_deformed_slab_is_cut_where_the_blade_is_now() {
    let bend =
        |p: DVec3| DVec3::new(p.x + 2.0 * p.z * p.x, p.y, p.z - 4.0 * (p.x - 0.04) * (p.x - 0.04) + 0.3);
    let mut operation = Operation::on(slab([8, 6, 1]));
    operation.deform = bend;
    let from_m = DVec3::new(0.0413, -0.02, 0.28);
    operation.stroke([from_m, from_m + DVec3::new(0.003, 0.10, 0.0)], 0.05 * DVec3::Z, 60);
    assert_eq!(operation.n_pieces(), 2);
    // The wall stands in the blade's plane in the present shape.
    let normal = DVec3::new(0.10, -0.003, 0.0).normalize();
    let topology = operation.body.topology();
    let present_m = operation.positions_m();
    let pieces = topology.pieces(Through::Faces);
    let mut sides = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for tet in topology.live_tets() {
        for node in topology.tet_nodes(tet) {
            let height_m = (present_m[node.index()] - from_m).dot(normal);
            let side = &mut sides[pieces.of_tet[tet.index()] as usize];
            *side = [side[0].min(height_m), side[1].max(height_m)];
        }
    }
    sides.sort_by(|a, b| a[0].total_cmp(&b[0]));
    assert!(sides[0][1] < 1.5e-3 && sides[1][0] > -1.5e-3, "{sides:?}");
}

#[test]
fn volumes_of_the_two_parts_are_those_of_the_plane() {
    let mut operation = Operation::on(slab([8, 6, 3]));
    let from_m = DVec3::new(0.0413, -0.02, -0.01);
    operation.stroke([from_m, from_m + DVec3::new(0.003, 0.10, 0.0)], 0.05 * DVec3::Z, 60);
    let topology = operation.body.topology();
    let pieces = topology.pieces(Through::Faces);
    let mut volumes_m3 = [0.0; 2];
    for tet in topology.live_tets() {
        volumes_m3[pieces.of_tet[tet.index()] as usize] += operation.body.mesh().tet_volume_m3(tet);
    }
    // The plane is at x = 0.0413 + 0.03 (y + 0.02), in the middle of the width at 0.0428.
    let expected_m3 = 0.0428 * 0.06 * 0.03;
    let off = volumes_m3.map(|v| (v / expected_m3 - 1.0).abs()).into_iter().fold(1.0, f64::min);
    assert!(off < 5e-3, "{volumes_m3:?} {expected_m3}");
}

#[test]
fn what_is_no_blade_is_refused_and_a_lost_edit_ends_the_stroke() {
    let mut operation = Operation::on(slab([8, 6, 2]));
    let blade_m = [DVec3::NAN, DVec3::ZERO];
    let positions_m = operation.positions_m();
    let found = operation.cut.advance(&operation.body, &positions_m, blade_m);
    assert!(matches!(found, Err(ScalpelRefusal::NotFinite { .. })));
    let found = operation.cut.advance(&operation.body, &positions_m[1..], [DVec3::ZERO, DVec3::Z]);
    assert!(matches!(found, Err(ScalpelRefusal::BadPositions { .. })));
    // Copies that nobody makes.
    let mut lost = None;
    for k in 0..60 {
        let tip_m = DVec3::new(0.0413, -0.02 + 0.0015 * f64::from(k), 0.012);
        loop {
            let positions_m = operation.positions_m();
            let blade_m = [tip_m, tip_m + 0.05 * DVec3::Z];
            match operation.cut.advance(&operation.body, &positions_m, blade_m) {
                Ok(Some(edits)) if matches!(edits[0], MeshEdit::DuplicateVertex { .. }) => {}
                Ok(Some(edits)) => operation.carry_out(edits),
                Ok(None) => break,
                Err(refusal) => {
                    lost = lost.or(Some(refusal));
                    break;
                }
            }
        }
    }
    assert_eq!(lost, Some(ScalpelRefusal::EditRefused));
    operation.lift();
}
