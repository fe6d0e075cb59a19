//! What a resection took: the tumour in the image, the piece that holds it, and how near the cut came to it.

use anyhow::ensure;
use glisson::contact::triangles::{at_weights, closest_weights};
use glisson::image::LabelMap;
use glisson::image::labels::Parts;
use glisson::math::{Aabb, DVec3, tetrahedron_volume_m3};
use glisson::mesh::topology::{Through, Topology};
use glisson::mesh::{TetId, TetMesh};
use glisson::world::World;

/// The tumour in the image.
#[derive(Clone, Debug)]
pub(super) struct Tumour {
    /// Middles of its voxels [m].
    voxels_m: Vec<DVec3>,
    /// Half the diagonal of a voxel [m].
    half_voxel_m: f64,
    pub(super) center_m: DVec3,
    /// Of the ball around the middle that holds every voxel whole [m].
    pub(super) radius_m: f64,
}

impl Tumour {
    /// Read off a label map.
    ///
    /// # Errors
    /// Where the map has none.
    pub(super) fn of(labels: &LabelMap) -> anyhow::Result<Self> {
        let grid = &labels.grid;
        let at = |index: usize| {
            let [i, j, k] = grid.voxel(index);
            grid.position_m(DVec3::new(i as f64, j as f64, k as f64))
        };
        let mask = labels.mask(&labels.select("liver_tumour", Parts::Included)?);
        let inside = mask.iter().enumerate().filter(|(_, inside)| **inside);
        let voxels_m: Vec<DVec3> = inside.map(|(index, _)| at(index)).collect();
        ensure!(!voxels_m.is_empty(), "the label map has no voxel of the tumour");
        let half_voxel_m = 0.5 * grid.position_m(DVec3::ONE).distance(grid.position_m(DVec3::ZERO));
        let center_m = voxels_m.iter().sum::<DVec3>() / voxels_m.len() as f64;
        let furthest_m = voxels_m.iter().map(|p| p.distance(center_m)).fold(0.0, f64::max);
        Ok(Self { voxels_m, half_voxel_m, center_m, radius_m: furthest_m + half_voxel_m })
    }

    /// One voxel of that size.
    #[cfg(test)]
    pub(super) fn ball(center_m: DVec3, radius_m: f64) -> Self {
        Self { voxels_m: vec![center_m], half_voxel_m: radius_m, center_m, radius_m }
    }
}

/// What is left where.
#[derive(Clone, Copy, Debug)]
pub(super) struct Specimen {
    pub(super) volume_m3: f64,
    /// Whether it hangs together with nothing that is held.
    pub(super) is_free: bool,
    /// Share of the tumour's voxels that are in it.
    pub(super) tumour_share: f64,
    /// Least distance of its cut surface from the tumour, at rest [m]; nothing where it was cut nowhere.
    pub(super) margin_m: f64,
    /// Pieces of the whole organ.
    pub(super) n_pieces: usize,
}

impl Specimen {
    /// The piece of the organ that holds most of the tumour.
    pub(super) fn of(world: &World, tumour: &Tumour) -> anyhow::Result<Self> {
        let body = world.organ().body();
        let (topology, mesh) = (body.topology(), body.mesh());
        let pieces = topology.pieces(Through::Faces);
        let piece_of = |tet: TetId| pieces.of_tet[tet.index()] as usize;
        // Tetrahedra that may hold a voxel.
        let near = Aabb::of_points(&tumour.voxels_m);
        let is_near = |tet: &TetId| {
            let own = Aabb::of_points(&mesh.corners_m(*tet));
            own.min_m.cmple(near.max_m).all() && near.min_m.cmple(own.max_m).all()
        };
        let candidates: Vec<TetId> = topology.live_tets().filter(is_near).collect();
        let mut counts = vec![0_usize; pieces.count()];
        for &voxel_m in &tumour.voxels_m {
            if let Some(&tet) = candidates.iter().find(|&&tet| holds(mesh.corners_m(tet), voxel_m)) {
                counts[piece_of(tet)] += 1;
            }
        }
        let piece = counts.iter().enumerate().max_by_key(|(_, n)| **n).map_or(0, |(piece, _)| piece);
        let own: Vec<TetId> = topology.live_tets().filter(|&tet| piece_of(tet) == piece).collect();
        // A piece that something holds is the organ itself.
        let is_held = |tet: &TetId| topology.tet_nodes(*tet).iter().any(|&n| world.organ().is_fixed(n));
        Ok(Self {
            volume_m3: own.iter().map(|&tet| mesh.tet_volume_m3(tet)).sum(),
            is_free: !own.iter().any(is_held),
            tumour_share: counts[piece] as f64 / tumour.voxels_m.len() as f64,
            margin_m: margin_m(topology, mesh, &own, &world.display_topology().is_cut, tumour),
            n_pieces: pieces.count(),
        })
    }

    /// In words.
    pub(super) fn text(&self) -> String {
        format!(
            "the piece with the tumour has {:.1} ml and is {}, {:.1} % of the tumour are in it, the cut comes to {:.1} mm from the tumour",
            1e6 * self.volume_m3,
            if self.is_free { "free" } else { "still held" },
            100.0 * self.tumour_share,
            1e3 * self.margin_m
        )
    }
}

/// Least distance of the piece's surface in cuts from the tumour's voxels, taken as balls around them. `is_cut` is in the order
/// of the surface's triangles.
fn margin_m(topology: &Topology, mesh: &TetMesh, piece: &[TetId], is_cut: &[bool], tumour: &Tumour) -> f64 {
    let mut least_m = f64::INFINITY;
    for (triangle, &is_cut) in topology.surface_triangles().zip(is_cut) {
        let is_own =
            topology.triangle_tets(triangle)[0].get().is_some_and(|t| piece.binary_search(&t).is_ok());
        if !is_own || !is_cut {
            continue;
        }
        let corners_m = topology.triangle_nodes(triangle).map(|n| mesh.positions_m[n.index()]);
        let distance_m = |p: DVec3| at_weights(corners_m, closest_weights(p, corners_m)).distance(p);
        // No voxel is nearer than the ball around all of them.
        if distance_m(tumour.center_m) - tumour.radius_m >= least_m {
            continue;
        }
        for &voxel_m in &tumour.voxels_m {
            least_m = least_m.min(distance_m(voxel_m) - tumour.half_voxel_m);
        }
    }
    least_m
}

/// Whether a tetrahedron holds a point, its faces included.
pub(super) fn holds(corners_m: [DVec3; 4], point_m: DVec3) -> bool {
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    (0..4).all(|i| {
        let mut part_m = corners_m;
        part_m[i] = point_m;
        tetrahedron_volume_m3(part_m) >= -1e-12 * volume_m3
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::box_mesh::box_of_five;
    use glisson::mesh::files::write_mesh;
    use glisson_runtime::{OpenScene, Simulation};

    /// A bar that is held at its far end and cut through, with a ball of voxels in the other piece.
    #[test]
    fn the_margin_is_that_of_the_cut_and_not_of_the_organs_own_surface() {
        let whole = box_of_five([20, 4, 4], DVec3::new(0.1, 0.02, 0.02));
        let folder = tempfile::tempdir().unwrap();
        write_mesh(&folder.path().join("bar.vtu"), &whole).unwrap();
        let scene = "glisson_scene = 1\n[organ]\nmesh = \"bar.vtu\"\nyoung_modulus = \"5 kPa\"\n\
            poisson_ratio = 0.4\ndensity = \"1000 kg/m3\"\nmodel = \"implicit\"\n\
            [[organ.fixed]]\nfurthest = { direction = [1, 0, 0], fraction = 0.05 }\n\
            [tool]\ntip_radius = \"3 mm\"\nhome_tip = [\"0 mm\", \"0 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let mut simulation = Simulation::open(source, None).unwrap();
        let (center_m, half_voxel_m) = (DVec3::new(0.03, 0.01, 0.01), 5e-4);
        let voxels_m = vec![center_m, center_m + DVec3::X * 4e-3, center_m - DVec3::Z * 4e-3];
        let tumour = Tumour { voxels_m, half_voxel_m, center_m, radius_m: 4.5e-3 };
        let uncut = Specimen::of(simulation.world(), &tumour).unwrap();
        assert!(!uncut.is_free && uncut.n_pieces == 1 && uncut.margin_m == f64::INFINITY, "{uncut:?}");
        let middle_x_m = |tet: TetId| whole.corners_m(tet).iter().sum::<DVec3>().x / 4.0;
        let tets = (0..whole.tetrahedra.len()).map(TetId::from_index);
        let slab: Vec<TetId> = tets.filter(|&tet| (0.045..0.05).contains(&middle_x_m(tet))).collect();
        simulation.remove_tetrahedra(slab).unwrap();
        let cut = Specimen::of(simulation.world(), &tumour).unwrap();
        // The cut lies at 45 mm, the nearest voxel's middle at 34 mm; the bar's own side is 5.5 mm away.
        assert!((cut.margin_m - (0.011 - half_voxel_m)).abs() < 1e-12, "{cut:?}");
        assert!(cut.is_free && cut.n_pieces == 2 && cut.tumour_share == 1.0, "{cut:?}");
        assert!((cut.volume_m3 - 0.045 * 0.02 * 0.02).abs() < 1e-12, "{cut:?}");
        let first = TetId::from_index(0);
        let inside_m = whole.corners_m(first).into_iter().sum::<DVec3>() / 4.0;
        assert!(holds(whole.corners_m(first), inside_m));
        assert!(!holds(whole.corners_m(first), inside_m + DVec3::X));
    }
}
