//! The plan of the scripted resection: a cone about the line from the nearest point of the surface to the tumour's middle, with
//! its tip beneath it. The hook goes around it on ever deeper circles and leans, so that its straight shaft lies in what it
//! has burnt already: under a flat bottom it would have to go through the piece.

use super::scenery::Files;
use super::specimen::{Tumour, holds};
use anyhow::Context;
use glisson::image::files::read_label_map;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::edit::EditableMesh;
use glisson::mesh::refine::refine_where;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::mesh::{TetId, TetMesh};
use glisson::surface::normals::{NormalWeight, vertex_normals};
use glisson::tool::ToolInput;
use glisson::world::spec::{Region, Support, fixed_nodes};

/// Of the hook.
pub(super) const TIP_RADIUS_M: f64 = 3e-3;
/// Healthy tissue between the tumour and the hook's way [m]: a choice. Less is left of it, by the hook's tip, by the size of the
/// tetrahedra that it burns whole, and by how far the piece, soft and nearly free, gives way before the tools.
const MARGIN_M: f64 = 17e-3;
/// Half the angle of the cone [rad]: a choice; a narrower one is deeper, a wider one takes more of the surface.
const LEAN_RAD: f64 = 30.0 * std::f64::consts::PI / 180.0;
/// Distance between two circles [m], below the width of what the hook burns.
const LEVEL_M: f64 = 6e-3;
/// How fast the hook is led [m/s].
const SPEED_M_PER_S: f64 = 0.2;
/// Points on a circle.
const CORNERS: usize = 24;
/// Circles that may lie above the surface at the entry, where the organ rises beside it.
const CIRCLES_ABOVE: usize = 4;
/// After so many circles the hook rests: a choice. A vessel that is closed earlier is often cut again nearer to its root.
const CIRCLES_TO_LOOK: usize = 5;
/// Longest edge of the tetrahedra on the hook's way [m], and how far beside it: choices.
const FINE_EDGE_M: f64 = 14e-3;
const FINE_BESIDE_M: f64 = 6e-3;
/// Edges that one edit divides.
const MOST_SPLITS: usize = 1_000;
/// How far the piece is lifted in the end [m].
const LIFT_M: f64 = 0.06;

/// Where the diaphragm and the great vessels hold a liver: behind and above.
const BEHIND: DVec3 = DVec3::new(0.0, 1.0, 0.4);
/// What is held is so far from the hook's way [m], and is looked for in turns of so much [rad]: choices.
const HELD_CLEAR_M: f64 = 0.02;
const HELD_TURN_RAD: f64 = 10.0 * std::f64::consts::PI / 180.0;
const MOST_TURNS: u32 = 9;
/// The clip applier comes from so far above the surface to each vessel [m].
const CLIPS_ABOVE_M: f64 = 0.02;

/// Where the hands go.
pub(super) struct Plan {
    pub(super) tumour: Tumour,
    pub(super) entry_m: DVec3,
    /// From the tumour out of the liver.
    pub(super) out: DVec3,
    depth_m: f64,
    /// How far the circles lie below the surface [m], the first ones first: those that meet the organ.
    circles_m: Vec<f64>,
}

impl Plan {
    pub(super) fn new(files: &Files, mesh: &TetMesh) -> anyhow::Result<Self> {
        Self::around(Tumour::of(&read_label_map(&files.labels)?)?, mesh)
    }

    fn around(tumour: Tumour, mesh: &TetMesh) -> anyhow::Result<Self> {
        let (surface, _) = surface_of(&Topology::build(mesh)?, mesh);
        let normals = vertex_normals(&surface, NormalWeight::Area);
        let nearest = surface
            .positions_m
            .iter()
            .zip(&normals)
            // From behind no instrument comes.
            .filter(|(_, normal)| normal.y < 0.3)
            .min_by(|a, b| a.0.distance(tumour.center_m).total_cmp(&b.0.distance(tumour.center_m)))
            .context("the liver has no surface")?;
        let entry_m = *nearest.0;
        let out = (entry_m - tumour.center_m).try_normalize().unwrap_or(*nearest.1);
        let depth_m = entry_m.distance(tumour.center_m);
        let mut plan = Self { tumour, entry_m, out, depth_m, circles_m: Vec::new() };
        plan.circles_m = plan.circles_in(mesh);
        Ok(plan)
    }

    pub(super) fn across(&self) -> [DVec3; 2] {
        let first = self.out.any_orthonormal_vector();
        [first, self.out.cross(first)]
    }

    /// How deep the tip of the cone lies: it touches a ball around the tumour, with the margin.
    fn tip_of_cone_m(&self) -> f64 {
        self.depth_m + (self.tumour.radius_m + MARGIN_M) / LEAN_RAD.sin()
    }

    /// The circles that meet the organ, and one more above and below.
    fn circles_in(&self, mesh: &TetMesh) -> Vec<f64> {
        let bottom_m = self.tip_of_cone_m();
        let n = (bottom_m / LEVEL_M).ceil() as usize + CIRCLES_ABOVE;
        let below_m = |circle: usize| (LEVEL_M * (circle as f64 - CIRCLES_ABOVE as f64)).min(bottom_m);
        let meets = |circle: usize| {
            let mut places_m = (0..CORNERS).map(|corner| {
                let angle = std::f64::consts::TAU * corner as f64 / CORNERS as f64;
                self.on_cone(below_m(circle), angle, 0.0).tip_in_world_m
            });
            places_m
                .any(|p| (0..mesh.tetrahedra.len()).any(|t| holds(mesh.corners_m(TetId::from_index(t)), p)))
        };
        let first = (0..=n).find(|&circle| meets(circle)).unwrap_or(0);
        let last = (0..=n).rev().find(|&circle| meets(circle)).unwrap_or(n);
        (first.saturating_sub(1)..=(last + 1).min(n)).map(below_m).collect()
    }

    /// The hook on the cone, `below_m` under the surface, drawn back along its shaft by `back_m`.
    fn on_cone(&self, below_m: f64, angle: f64, back_m: f64) -> ToolInput {
        let [u, v] = self.across();
        let aside = u * angle.cos() + v * angle.sin();
        let radius_m = (self.tip_of_cone_m() - below_m) * LEAN_RAD.tan();
        let shaft = self.out * LEAN_RAD.cos() + aside * LEAN_RAD.sin();
        ToolInput::at(self.entry_m - self.out * below_m + aside * radius_m + shaft * back_m, shaft)
    }

    /// How far outside of the cone a place lies [m]; inside it is negative.
    fn outside_m(&self, point_m: DVec3) -> f64 {
        let from_tip_m = point_m - (self.entry_m - self.out * self.tip_of_cone_m());
        let height_m = from_tip_m.dot(self.out);
        let aside_m = (from_tip_m - self.out * height_m).length();
        aside_m * LEAN_RAD.cos() - height_m * LEAN_RAD.sin()
    }

    /// Finer tetrahedra around the hook's way.
    pub(super) fn finer(&self, mesh: TetMesh) -> anyhow::Result<TetMesh> {
        let mut body = EditableMesh::new(mesh)?;
        let is_on_way = |body: &EditableMesh, tet: TetId| {
            let outside_m = body.mesh().corners_m(tet).map(|p| self.outside_m(p));
            outside_m.iter().any(|d| *d <= FINE_BESIDE_M) && outside_m.iter().any(|d| *d >= -FINE_BESIDE_M)
        };
        while let Some(edit) = refine_where(&body, FINE_EDGE_M, |tet| is_on_way(&body, tet), MOST_SPLITS) {
            body.apply(&edit)?;
        }
        Ok(body.live_mesh())
    }

    /// Along which direction the organ is held, and which share of the nodes of `mesh` so that `n_held` are: behind, turned away
    /// from the cone until nothing that is held lies in it or near it. What a surgeon takes out is mobilised first; a piece
    /// with held nodes in it would be torn off them.
    pub(super) fn held(&self, mesh: &TetMesh, n_held: f64) -> (DVec3, f64) {
        let fraction = n_held / mesh.positions_m.len() as f64;
        let middle_m = Aabb::of_points(&mesh.positions_m).center_m();
        let aside = DVec3::X * (middle_m.x - self.entry_m.x).signum();
        let turned = |turn: u32| {
            let angle = f64::from(turn) * HELD_TURN_RAD;
            BEHIND.normalize() * angle.cos() + aside * angle.sin()
        };
        let is_clear = |direction: &DVec3| self.nearest_held_m(mesh, *direction, fraction) > HELD_CLEAR_M;
        ((0..MOST_TURNS).map(turned).find(is_clear).unwrap_or_else(|| turned(MOST_TURNS)), fraction)
    }

    /// How far outside of the cone what is held lies at least [m].
    fn nearest_held_m(&self, mesh: &TetMesh, direction: DVec3, fraction: f64) -> f64 {
        let held =
            fixed_nodes(&[Support::all_axes(Region::Furthest { direction, fraction })], &mesh.positions_m);
        let outside_m = held.iter().map(|f| self.outside_m(mesh.positions_m[f.node.index()]));
        outside_m.fold(f64::INFINITY, f64::min)
    }

    /// Where the clip applier sets a clip on a vessel that bleeds at `end_m`, and whence it comes: along the cone, in what is
    /// burnt already.
    pub(super) fn to_clip(&self, end_m: DVec3) -> [ToolInput; 2] {
        let [u, v] = self.across();
        let from_entry_m = end_m - self.entry_m;
        let below_m = (-from_entry_m.dot(self.out)).clamp(0.0, self.tip_of_cone_m());
        let angle = from_entry_m.dot(v).atan2(from_entry_m.dot(u));
        let back_m = (below_m + CLIPS_ABOVE_M) / LEAN_RAD.cos();
        [self.on_cone(below_m, angle, back_m), self.on_cone(below_m, angle, 0.0)]
    }

    /// The hook's way: time [s], pose; and when it rests so that vessels can be clipped [s].
    pub(super) fn hook(&self) -> (Vec<(f64, ToolInput)>, Vec<f64>) {
        let bottom_m = self.circles_m.last().copied().unwrap_or(0.0);
        let above_m = self.circles_m.first().copied().unwrap_or(0.0) - LEVEL_M;
        let mut way: Vec<(f64, ToolInput)> = vec![(1.0, self.on_cone(above_m, 0.0, 0.03))];
        let mut to = |pose: ToolInput, trigger: f64| {
            let (time_s, last) = way[way.len() - 1];
            let way_m = pose.tip_in_world_m.distance(last.tip_in_world_m);
            let there_s = time_s + (way_m / SPEED_M_PER_S).max(1e-3);
            way.push((there_s, ToolInput { trigger, ..pose }));
            there_s
        };
        let mut looks_s = Vec::new();
        for (circle, &below_m) in self.circles_m.iter().enumerate() {
            for corner in 0..=CORNERS {
                let angle = std::f64::consts::TAU * corner as f64 / CORNERS as f64;
                let there_s = to(self.on_cone(below_m, angle, 0.0), 1.0);
                if corner == CORNERS && (circle + 1).is_multiple_of(CIRCLES_TO_LOOK) {
                    looks_s.push(there_s);
                }
            }
        }
        // Out along its shaft, burning what is in the way.
        let out_m = bottom_m / LEAN_RAD.cos();
        to(self.on_cone(bottom_m, 0.0, out_m + 0.03), 1.0);
        looks_s.push(to(self.on_cone(bottom_m, 0.0, out_m + 0.06), 0.0));
        (way, looks_s)
    }

    /// The grasper's way: time [s], tip [m], opening of the jaws.
    pub(super) fn grasper(&self, end_s: f64) -> Vec<(f64, DVec3, f64)> {
        let above = |out_m: f64| self.entry_m + self.out * out_m;
        vec![
            (0.3, above(0.03), 1.0),
            (0.6, above(-4e-3), 1.0),
            (0.8, above(-4e-3), 0.0),
            (1.0, above(0.0), 0.0),
            (0.7 * end_s, above(4e-3), 0.0),
            (end_s, above(4e-3), 0.0),
            (end_s + 1.0, above(LIFT_M), 0.0),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::box_mesh::box_of_five;

    #[test]
    fn the_way_is_fine_and_nothing_on_it_is_held() {
        let mesh = box_of_five([12, 4, 4], DVec3::new(0.24, 0.08, 0.08));
        let tumour = Tumour::ball(DVec3::new(0.06, 0.03, 0.04), 0.012);
        let plan = Plan::around(tumour, &mesh).unwrap();
        assert!((plan.depth_m - 0.03).abs() < 0.01 && plan.out.y < -0.9, "{:?}", plan.out);
        let n_held = 0.1 * mesh.positions_m.len() as f64;
        let fine = plan.finer(mesh.clone()).unwrap();
        assert!(fine.tetrahedra.len() > mesh.tetrahedra.len());
        for t in (0..fine.tetrahedra.len()).map(TetId::from_index) {
            let corners_m = fine.corners_m(t);
            let longest_m = corners_m
                .iter()
                .flat_map(|a| corners_m.iter().map(move |b| a.distance(*b)))
                .fold(0.0, f64::max);
            let outside_m = corners_m.map(|p| plan.outside_m(p));
            let is_cut_through = outside_m.iter().any(|d| *d < 0.0) && outside_m.iter().any(|d| *d > 0.0);
            assert!(!is_cut_through || longest_m <= FINE_EDGE_M, "{longest_m}");
        }
        // On the cone itself the distance is none, at every pose of the hook.
        for below_m in [0.0, 0.02, 0.05] {
            assert!(plan.outside_m(plan.on_cone(below_m, 1.0, 0.0).tip_in_world_m).abs() < 1e-12);
        }
        // Straight behind lies the tip of the cone: the organ is held further aside.
        let (direction, fraction) = plan.held(&fine, n_held);
        assert!(plan.nearest_held_m(&fine, BEHIND, fraction) < HELD_CLEAR_M);
        assert!(plan.nearest_held_m(&fine, direction, fraction) > HELD_CLEAR_M, "{direction}");
        assert!(direction.x > 0.0 && direction.y > 0.0, "{direction}");
    }
}
