//! Where a straight way meets an organ's skin.

use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::topology::Topology;

/// A skin at rest: outward triangles.
pub(super) struct Skin {
    triangles_m: Vec<[DVec3; 3]>,
}

impl Skin {
    pub(super) fn of(mesh: &TetMesh) -> anyhow::Result<Self> {
        let topology = Topology::build(mesh)?;
        let corners_m = |t| topology.outward_nodes(t).map(|node| mesh.positions_m[node.index()]);
        Ok(Self { triangles_m: topology.surface_triangles().map(corners_m).collect() })
    }

    pub(super) fn triangles_m(&self) -> &[[DVec3; 3]] {
        &self.triangles_m
    }

    /// The first place that a way from outside meets.
    pub(super) fn first_m(&self, from_m: DVec3, direction: DVec3) -> Option<DVec3> {
        let ways_m = self.triangles_m.iter().filter_map(|corners_m| way_to_m(*corners_m, from_m, direction));
        ways_m.min_by(f64::total_cmp).map(|way_m| from_m + direction * way_m)
    }
}

/// How far a triangle is along a unit direction that enters through it (Moeller and Trumbore 1997,
/// doi 10.1080/10867651.1997.10487468).
pub(super) fn way_to_m([a, b, c]: [DVec3; 3], from_m: DVec3, direction: DVec3) -> Option<f64> {
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(ac);
    let volume = -normal.dot(direction);
    if volume <= 0.0 {
        return None;
    }
    let away = from_m - a;
    let across = away.cross(-direction);
    let (u, v) = (-ac.dot(across) / volume, ab.dot(across) / volume);
    let way_m = away.dot(normal) / volume;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && way_m >= 0.0).then_some(way_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::box_mesh::box_of_five;

    #[test]
    fn a_way_meets_the_near_side_first() {
        let skin = Skin::of(&box_of_five([3, 2, 2], DVec3::new(3.0, 2.0, 1.0))).unwrap();
        let direction = DVec3::new(0.3, 0.2, -1.0).normalize();
        let hit_m = skin.first_m(DVec3::new(1.1, 0.7, 2.0) - direction * 0.5, direction).unwrap();
        let expected_m = DVec3::new(1.1 + 0.3, 0.7 + 0.2, 1.0);
        assert!(hit_m.distance(expected_m) < 1e-12, "{hit_m}");
        assert!(skin.first_m(DVec3::new(9.0, 0.7, 2.0), DVec3::NEG_Z).is_none());
    }
}
