//! What is left out for speed changes nothing: the same strokes with everything tried.

use super::{SubdivisionCut, SubdivisionParams};
use crate::math::{DVec3, SeededRandom};
use crate::mesh::box_mesh::box_of_five;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::mesh::quality::MeshQuality;
use crate::mesh::remap::follow_in_tissue;

/// Strokes that cross each other.
const N_STROKES: usize = 7;

/// Steps of each.
const N_STEPS: usize = 4;

#[test]
fn ways_to_cut_that_are_dropped_early_would_not_have_won() {
    let mesh = box_of_five([5, 5, 4], DVec3::new(0.05, 0.05, 0.04));
    let edge_m = MeshQuality::of(&mesh).mean_edge_m;
    let params = SubdivisionParams::for_mean_edge(edge_m);
    let mut positions_m = mesh.positions_m.clone();
    for p in &mut positions_m {
        *p = DVec3::new(1.2 * p.x, p.y + 0.15 * p.x, p.z + 6.0 * p.x * p.y);
    }
    let mut body = EditableMesh::new(mesh).unwrap();
    let mut random = SeededRandom::new(5);
    let mut n_coarser = 0;
    for _ in 0..N_STROKES {
        let mut quick = SubdivisionCut::new(params.clone());
        let mut thorough = SubdivisionCut { leeway: f64::MAX, ..quick.clone() };
        let around = |random: &mut SeededRandom| random.uniform_in(-1.0, 1.0) * edge_m;
        let middle_m =
            DVec3::new(0.03, 0.03, 0.04) + DVec3::new(around(&mut random), around(&mut random), 0.0);
        let angle = random.uniform_in(0.0, std::f64::consts::TAU);
        let along = DVec3::new(libm::cos(angle), libm::sin(angle), 0.0);
        let down = DVec3::new(random.uniform_in(-0.4, 0.4), random.uniform_in(-0.4, 0.4), -1.0);
        for step in 0..=N_STEPS {
            let at_m = middle_m + along * (1.2 * edge_m) * (step as f64 - 0.5 * N_STEPS as f64);
            let blade_m = [at_m + 2.2 * edge_m * down, at_m - 2.0 * edge_m * down];
            let is_last = step == N_STEPS;
            let [edit, other] = [&mut quick, &mut thorough].map(|cut| {
                if is_last {
                    cut.finish(&body, &positions_m, blade_m)
                } else {
                    cut.advance(&body, &positions_m, blade_m)
                }
            });
            assert_eq!(edit, other);
            assert_eq!(quick.report(), thorough.report());
            if let Ok(Some(edit)) = edit {
                let change = body.apply(&MeshEdit::Replace(edit)).unwrap();
                follow_in_tissue(&mut positions_m, &change);
            }
        }
        n_coarser += quick.report().n_coarser;
    }
    assert!(n_coarser > 3, "{n_coarser}");
}
