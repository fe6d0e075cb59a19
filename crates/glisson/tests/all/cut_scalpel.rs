//! Cutting by vertex displacement (seed `000` s. 4.4.2).

use glisson::image::labels::Parts;
use glisson::image::phantom::{self, PhantomParams};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::{box_of_five, irregular_cube};
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::quality::radius_ratio;
use glisson::mesh::remap::follow;
use glisson::mesh::repair::MoveLimits;
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
