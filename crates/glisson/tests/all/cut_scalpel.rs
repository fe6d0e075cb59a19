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
            apply(&mut self.body, &edit);
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
        assert!(topology.pinches().is_empty(), "{:?}", topology.pinches());
    }

    fn n_pieces(&self) -> usize {
        self.body.topology().pieces(Through::Faces).count()
    }

    fn euler(&self) -> [i64; 2] {
        let topology = self.body.topology();
        [topology.euler_characteristic(), topology.surface_euler_characteristic()]
    }
}

fn apply(body: &mut EditableMesh, edit: &MeshEdit) {
    match edit {
        MeshEdit::DuplicateVertex { node, tets_of_copy } => {
            let mut mesh = body.mesh().clone();
            let copy = NodeId::from_index(mesh.positions_m.len());
            mesh.positions_m.push(mesh.positions_m[node.index()]);
            for tet in tets_of_copy {
                for n in &mut mesh.tetrahedra[tet.index()] {
                    if n == node {
                        *n = copy;
                    }
                }
            }
            *body = EditableMesh::new(mesh).unwrap();
        }
        edit => {
            body.apply(edit).unwrap();
        }
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
    operation.stroke([DVec3::new(0.0213, 0.0314, 0.05), DVec3::new(0.0213, 0.0314, 0.034)], up_m, 4);
    let mut operation = Operation::on(slab([8, 6, 4]));
    let down = DVec3::new(0.0213, 0.0314, 0.034);
    operation.hold([down + 0.016 * DVec3::Z, down + 0.066 * DVec3::Z]);
    operation.stroke([down, down + DVec3::new(0.04, 0.002, 0.0)], up_m, 40);
    eprintln!("{:?}", operation.cut.report());
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
    eprintln!("{:?} {:?} {}", operation.cut.report(), operation.euler(), operation.n_pieces());
    assert_eq!(operation.n_pieces(), 2);
    assert_eq!(operation.euler(), [2, 4]);
}

#[test]
fn a_deep_cut_across_a_box_makes_two() {
    let mut operation = Operation::on(slab([8, 6, 3]));
    let from_m = DVec3::new(0.0413, -0.02, -0.01);
    operation.stroke([from_m, from_m + DVec3::new(0.003, 0.10, 0.0)], 0.05 * DVec3::Z, 60);
    eprintln!("{:?} {:?} {}", operation.cut.report(), operation.euler(), operation.n_pieces());
    assert_eq!(operation.n_pieces(), 2);
    assert_eq!(operation.euler(), [2, 4]);
}
