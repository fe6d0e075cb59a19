//! What a swept ball takes out.

use glisson::contact::shapes::Capsule;
use glisson::math::{DVec3, SeededRandom, tetrahedron_volume_m3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshUndo, TopologyChange};
use glisson::mesh::embedding::{Embedding, EmbeddingUndo};
use glisson::mesh::{NodeId, TetId};
use glisson::tool::cut::subdivision::carving::{Carving, meets};

/// 6,000 tetrahedra with edges of 10 to 14 mm.
const CELLS: [usize; 3] = [12, 10, 10];
const SIZE_M: DVec3 = DVec3::new(0.12, 0.1, 0.1);
const PI: f64 = std::f64::consts::PI;

/// A block whose nodes are in other places than at rest, and what was carved out of it.
struct Carver {
    mesh: EditableMesh,
    embedding: Embedding,
    carving: Carving,
    present_m: fn(DVec3) -> DVec3,
    rest_m3: f64,
    present_m3: f64,
}

impl Carver {
    fn new(present_m: fn(DVec3) -> DVec3) -> Self {
        let mesh = box_of_five(CELLS, SIZE_M);
        let embedding = Embedding::new(&mesh);
        let mesh = EditableMesh::new(mesh).unwrap();
        Self { mesh, embedding, carving: Carving::default(), present_m, rest_m3: 0.0, present_m3: 0.0 }
    }

    fn positions_m(&self) -> Vec<DVec3> {
        self.mesh.mesh().positions_m.iter().map(|p| (self.present_m)(*p)).collect()
    }

    /// Carves, checks what it tells, and answers whether something went.
    fn carve(&mut self, from_m: DVec3, to_m: DVec3, radius_m: f64) -> bool {
        let solid = Capsule { from_m, to_m, radius_m };
        let positions_m = self.positions_m();
        let corners = |tet: TetId| self.mesh.topology().tet_nodes(tet).map(|n| positions_m[n.index()]);
        let near: Vec<TetId> =
            self.mesh.topology().live_tets().filter(|tet| meets(&solid, corners(*tet))).collect();
        let Some(carved) = self.carving.plan(&self.mesh, &positions_m, &near, &solid) else { return false };
        let before_m3 = self.volume_m3();
        let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
        self.mesh.apply_all_saving(&carved.edits, &mut change, &mut undo).unwrap();
        let gone_m3 = before_m3 - self.volume_m3();
        assert!((gone_m3 - carved.rest_m3).abs() < 1e-12 * before_m3, "{gone_m3} {}", carved.rest_m3);
        let told = self.embedding.follow(self.mesh.mesh(), &change, &mut EmbeddingUndo::default());
        assert!(told.is_ok(), "copies carry what is left");
        self.rest_m3 += carved.rest_m3;
        self.present_m3 += carved.present_m3;
        true
    }

    fn volume_m3(&self) -> f64 {
        let topology = self.mesh.topology();
        topology.live_tets().map(|tet| tetrahedron_volume_m3(self.mesh.mesh().corners_m(tet))).sum()
    }

    /// How far the wall is from the surface of a capsule along a line [m]: outwards and inwards. `is_wall` tells places of the wall.
    fn off_m(&self, [a, b]: [DVec3; 2], radius_m: f64, is_wall: impl Fn(DVec3) -> bool) -> [f64; 2] {
        let positions_m = self.positions_m();
        let away_m = |p: DVec3| {
            let way_m = b - a;
            let share = ((p - a).dot(way_m) / way_m.length_squared().max(1e-30)).clamp(0.0, 1.0);
            p.distance(a.lerp(b, share)) - radius_m
        };
        let mut off_m: [f64; 2] = [0.0; 2];
        for triangle in self.mesh.topology().surface_triangles() {
            let corners_m =
                self.mesh.topology().triangle_nodes(triangle).map(|n: NodeId| positions_m[n.index()]);
            let center_m = corners_m.into_iter().sum::<DVec3>() / 3.0;
            if is_wall(center_m) {
                for p in corners_m.into_iter().chain([center_m]) {
                    off_m = [off_m[0].max(away_m(p)), off_m[1].max(-away_m(p))];
                }
            }
        }
        off_m
    }

    /// The copies have the volume of what is left.
    fn check_shares(&self) {
        let mut copies: Vec<TetId> =
            self.mesh.topology().live_tets().map(|tet| self.embedding.copy_of(tet)).collect();
        copies.sort_unstable();
        copies.dedup();
        let carried_m3: f64 = copies.iter().map(|copy| self.embedding.copies().tet_volume_m3(*copy)).sum();
        let left_m3 = self.volume_m3();
        assert!((carried_m3 - left_m3).abs() < 1e-12 * left_m3, "{carried_m3} {left_m3}");
    }
}

/// The requirement: a ball of 3 mm along 30 mm, in a mesh with edges four times its radius, takes out the swept volume within 2 %,
/// and the wall is nowhere further than 0.3 mm from the tube; in the deformed shape, in one go or bit by bit.
#[test]
fn a_ball_along_a_line_takes_out_its_tube() {
    let squeezed = |p: DVec3| DVec3::new(1.15 * p.x + 0.1 * p.z, 0.9 * p.y, p.z + 0.05 * p.x);
    for (present_m, pieces) in [(squeezed as fn(DVec3) -> DVec3, 1), (squeezed, 12), (|p| p, 7), (|p| p, 20)]
    {
        let mut carver = Carver::new(present_m);
        let (a, b) = (present_m(SIZE_M * 0.5) - DVec3::X * 0.0157, present_m(SIZE_M * 0.5));
        let b = a + (b - a + DVec3::new(0.0, 0.0021, -0.0013)).normalize() * 0.03;
        let radius_m = 0.003;
        for k in 0..pieces {
            let at = |k: usize| a.lerp(b, k as f64 / pieces as f64);
            assert!(carver.carve(at(k), at(k + 1), radius_m));
        }
        let swept_m3 = PI * radius_m * radius_m * (0.03 + 4.0 / 3.0 * radius_m);
        let share = carver.present_m3 / swept_m3;
        assert!((share - 1.0).abs() < 0.02, "{pieces} pieces: {share}");
        let off_m = carver.off_m([a, b], radius_m, |p| p.distance(0.5 * (a + b)) < 0.02);
        assert!(off_m.iter().all(|off_m| *off_m < 3e-4), "{pieces} pieces: {off_m:?}");
        carver.check_shares();
        // All of it is gone.
        assert!(!carver.carve(a, b, 0.9 * radius_m), "{pieces} pieces");
    }
}

/// Balls at the skin and at edges of the block, over each other, of all sizes beside its tetrahedra.
#[test]
fn balls_anywhere_leave_a_sound_mesh() {
    let mut random = SeededRandom::new(11);
    let mut carver = Carver::new(|p| p);
    let mut n_carved = 0;
    for k in 0..40 {
        let place = DVec3::new(random.uniform(), random.uniform(), random.uniform()) * SIZE_M * 1.1;
        let from_m = if k % 3 == 0 { DVec3::new(place.x, place.y, SIZE_M.z) } else { place };
        let way_m = DVec3::new(random.normal(), random.normal(), random.normal()) * 4e-3;
        let radius_m = [1e-3, 2e-3, 5e-3, 12e-3][k % 4];
        n_carved += usize::from(carver.carve(from_m, from_m + way_m, radius_m));
    }
    assert!(n_carved > 25, "{n_carved}");
    carver.mesh.topology().live_tets().for_each(|tet| {
        assert!(tetrahedron_volume_m3(carver.mesh.mesh().corners_m(tet)) > 0.0);
    });
    carver.check_shares();
    let whole_m3 = SIZE_M.x * SIZE_M.y * SIZE_M.z;
    assert!((whole_m3 - carver.volume_m3() - carver.rest_m3).abs() < 1e-12 * whole_m3);
}
