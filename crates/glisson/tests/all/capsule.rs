//! Which triangles of an organ that was cut and refined are still its own surface.

use crate::model_meshes::{block, on_a_table};
use glisson::math::DVec3;
use glisson::mesh::refine::FineRegion;
use glisson::record::snapshot::DisplayTopology;
use glisson::tool::{Blade, BladeCuts, Tool, ToolInput, ToolKind};
use glisson::world::spec::WorldSpec;
use glisson::world::{StepInput, World};

const SIZE_M: f64 = 0.1;
const TIME_STEP_S: f64 = 3e-4;

fn scalpel_at(x_m: f64, trigger: f64) -> ToolInput {
    ToolInput { trigger, ..ToolInput::at(DVec3::new(x_m, 0.047, SIZE_M - 0.03), DVec3::Z) }
}

fn world(cuts: BladeCuts) -> World {
    let kind = ToolKind::Scalpel(Blade { length_m: 0.06, cuts });
    let tool = Tool { kind, shaft_radius_m: 2e-3, ..Tool::probe("scalpel", 3e-3, scalpel_at(-0.02, 0.0)) };
    let spec = WorldSpec::new("block", TIME_STEP_S, tool);
    on_a_table(block([4, 4, 4], DVec3::splat(SIZE_M)), spec)
}

/// The block's own surface is its six faces at rest: whether a triangle lies in one is known exactly. Answers how many lie in
/// them and how many in cuts.
fn check(shown: &DisplayTopology) -> [usize; 2] {
    assert_eq!(shown.is_cut.len(), shown.triangles.len());
    let mut n = [0; 2];
    for (triangle, &is_cut) in shown.triangles.iter().zip(&shown.is_cut) {
        let corners_m = triangle.map(|v| shown.rest_positions_m[v as usize]);
        let lies_at = |axis: usize, at_m: f64| corners_m.iter().all(|p| (p[axis] - at_m).abs() < 1e-9);
        let is_own = (0..3).any(|axis| lies_at(axis, 0.0) || lies_at(axis, SIZE_M));
        assert_eq!(is_cut, !is_own, "{corners_m:?}");
        n[usize::from(is_cut)] += 1;
    }
    n
}

#[test]
fn skin_that_is_divided_stays_skin_and_what_a_cut_uncovers_is_none() {
    for cuts in [BladeCuts::Subdivision, BladeCuts::Displacement] {
        let mut world = world(cuts);
        world.set_undo_depth(1000);
        let whole = world.display_topology();
        assert_eq!(check(&whole), [whole.triangles.len(), 0]);
        // Finer at a corner of the block: more skin, no cut.
        let region = FineRegion { center_m: DVec3::new(0.0, 0.0, SIZE_M), radius_m: 0.03, edge_m: 0.015 };
        assert!(world.refine(&region).unwrap() > 0);
        let [n_fine, n_cut] = check(&world.display_topology());
        assert!(n_fine > whole.triangles.len() && n_cut == 0, "{cuts:?}: {n_fine}");
        // A stroke from outside through half of the block; then a piece is taken out.
        world.step(&StepInput::of(&[scalpel_at(-0.01, 1.0)]).placed());
        for i in 1..=20 {
            world.step(&StepInput::of(&[scalpel_at(-0.01 + 0.003 * f64::from(i), 1.0)]));
            world.cut_with_tools();
        }
        world.step(&StepInput::of(&[scalpel_at(0.05, 0.0)]));
        world.cut_with_tools();
        let [_, n_stroke] = check(&world.display_topology());
        assert!(n_stroke > 4, "{cuts:?}: {n_stroke}");
        let last = world.organ().body().topology().live_tets().last().unwrap();
        world.remove_and_part(vec![last]).unwrap();
        check(&world.display_topology());
        // Taken back step by step, what is skin is known all the time.
        let mut n_undone = 0;
        while world.undo_edit() {
            check(&world.display_topology());
            n_undone += 1;
        }
        assert!(n_undone > 2, "{cuts:?}");
        assert_eq!(world.display_topology().is_cut, whole.is_cut);
        world.refine(&region).unwrap();
        assert_eq!(check(&world.display_topology()), [n_fine, 0]);
    }
}
