//! Every model, pressed in blocks of every size, against the reference.
//!
//! The block of 100 x 100 x 60 mm is meshed as any organ's surface is, and bonded at its base. It is touched near the middle of
//! its upper side, at places that mean nothing to the mesh.

use super::press::{Felt, Press, ReadyOrgan, Subject};
use super::reference::table::{BALLS_M, DEPTHS, Law, POISSON_RATIO, reference_force};
use super::selection::Selection;
use super::skin::Skin;
use anyhow::{Context, ensure};
use glisson::material::LinearElastic;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3};
use glisson::mesh::TetMesh;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::surface::TriMesh;
use glisson::world::spec::Region;

/// The block [m], its base at z = 0.
pub(in crate::validate) const SIZE_M: DVec3 = DVec3::new(0.1, 0.1, 0.06);
/// Where the block is touched, from the middle of its upper side along x and y [m]: near enough for the reference, whose ball
/// is on the axis, and at no node, edge or plane of symmetry. Choices.
pub(super) const PLACES_M: [[f64; 2]; 3] = [[1.37e-3, 2.11e-3], [-3.29e-3, 0.83e-3], [2.71e-3, -3.93e-3]];
/// The force depends on it in proportion: that of liver ([`Tissue`]).
const TISSUE: &str = "liver";
/// How near to the base nodes are bonded [m].
const BONDED_M: f64 = 1e-6;

/// One ball at one depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) model: &'static str,
    pub(super) n_tets: usize,
    /// Mean edge of the upper side [m].
    pub(super) edge_m: f64,
    pub(super) ball_m: f64,
    pub(super) place: usize,
    /// Wanted depth in radii.
    pub(super) depth: f64,
    pub(super) felt: Felt,
    pub(super) reference_n: f64,
    /// Of linear tissue: the force if it were pushed on its present shape, where there is one.
    pub(super) on_present_shape_n: Option<f64>,
}

impl Case {
    pub(super) fn ratio(&self) -> f64 {
        self.felt.force_n / self.reference_n
    }

    /// How far the force may be off: 10 %, 15 % at 1.5 radii, 5 % where edges are at most half a radius.
    pub(super) fn tolerance(&self) -> f64 {
        if self.edge_m <= 0.5 * self.ball_m {
            0.05
        } else if self.depth > 1.25 {
            0.15
        } else {
            0.10
        }
    }

    pub(super) fn holds(&self) -> bool {
        (self.ratio() - 1.0).abs() <= self.tolerance()
    }

    /// The head of a table of rows.
    pub(super) const HEAD: &str = "| model | tetrahedra | edge over radius | ball [mm] | place | depth [radii] | depth [mm] | unrest | force [N] | reference [N] | ratio | ratio to the present shape's | |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|\n";

    pub(super) fn row(&self) -> String {
        format!(
            "| {} | {} | {:.2} | {} | {} | {} | {:.3} | {:.1e} | {:.4} | {:.4} | {:.3} | {} | {} |\n",
            self.model,
            self.n_tets,
            self.edge_m / self.ball_m,
            self.ball_m * 1e3,
            self.place + 1,
            self.depth,
            self.felt.depth_m * 1e3,
            self.felt.unrest,
            self.felt.force_n,
            self.reference_n,
            self.ratio(),
            self.on_present_shape_n.map_or(String::from("-"), |n| format!("{:.3}", self.felt.force_n / n)),
            if self.holds() { "pass" } else { "FAIL" },
        )
    }
}

/// A box's surface, counter-clockwise from outside.
fn box_surface(size_m: DVec3) -> TriMesh {
    let corner = |c: usize| DVec3::new((c & 1) as f64, ((c >> 1) & 1) as f64, ((c >> 2) & 1) as f64) * size_m;
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    TriMesh {
        positions_m: (0..8).map(corner).collect(),
        triangles: sides.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect(),
    }
}

/// The block in about so many tetrahedra.
pub(in crate::validate) fn block(n_tets: usize) -> anyhow::Result<TetMesh> {
    let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: None };
    Ok(generate(&box_surface(SIZE_M), &params).context("meshing the block")?.0)
}

/// Mean edge of the skin's triangles in the middle half of the upper side [m].
fn upper_edge_m(skin: &Skin) -> anyhow::Result<f64> {
    let is_near = |p: &DVec3| {
        let way = (*p - 0.5 * SIZE_M) / SIZE_M;
        way.x.abs() < 0.25 && way.y.abs() < 0.25 && way.z > 0.4
    };
    let edges_m: Vec<f64> = skin
        .triangles_m()
        .iter()
        .filter(|corners_m| corners_m.iter().all(is_near))
        .flat_map(|corners_m| (0..3).map(|k| corners_m[k].distance(corners_m[(k + 1) % 3])))
        .collect();
    ensure!(!edges_m.is_empty(), "the upper side has no triangles");
    Ok(edges_m.iter().sum::<f64>() / edges_m.len() as f64)
}

/// The place of the skin that is touched.
fn touched_m(skin: &Skin, [x_m, y_m]: [f64; 2]) -> anyhow::Result<DVec3> {
    let above_m = SIZE_M * DVec3::new(0.5, 0.5, 2.0) + DVec3::new(x_m, y_m, 0.0);
    skin.first_m(above_m, DVec3::NEG_Z).context("nothing under the ball")
}

/// What is pressed, and how stiff it is.
struct ReadyBlock {
    organ: ReadyOrgan,
    skin: Skin,
    n_tets: usize,
    edge_m: f64,
    young_pa: f64,
}

impl ReadyBlock {
    /// The cases of one ball at one place.
    fn press(&self, subject: &Subject, ball_m: f64, place: usize) -> anyhow::Result<Vec<Case>> {
        let skin_m = touched_m(&self.skin, PLACES_M[place])?;
        let press = Press { skin_m, inwards: DVec3::NEG_Z, radius_m: ball_m };
        let felt = press.run(&self.organ, &DEPTHS.map(|depth| depth * ball_m))?;
        let unit_n = self.young_pa * ball_m * ball_m;
        let law = if subject.is_linear { Law::Linear } else { Law::StableNeoHooke };
        let case = |(depth, felt): (f64, Felt)| {
            let force = reference_force(law, ball_m, depth)
                .with_context(|| format!("no reference for a ball of {ball_m} m"))?;
            let on_present_shape = reference_force(Law::LinearOnPresentShape, ball_m, depth);
            Ok(Case {
                model: subject.kind.name(),
                n_tets: self.n_tets,
                edge_m: self.edge_m,
                ball_m,
                place,
                depth,
                felt,
                reference_n: force * unit_n,
                on_present_shape_n: on_present_shape.filter(|_| subject.is_linear).map(|f| f * unit_n),
            })
        };
        DEPTHS.into_iter().zip(felt).map(case).collect()
    }
}

/// Runs the cases of a selection; `tell` hears of each as it is done.
pub(super) fn run(selection: &Selection, tell: &mut dyn FnMut(&Case)) -> anyhow::Result<Vec<Case>> {
    let subjects = selection.subjects()?;
    let balls_m = if selection.balls_m.is_empty() { &BALLS_M[..] } else { &selection.balls_m };
    let tissue = Tissue::by_name(TISSUE)?.linear_elastic()?;
    let young_pa = tissue.young_modulus_pa();
    let material = LinearElastic::from_young_poisson(young_pa, POISSON_RATIO, tissue.density_kg_per_m3())?;
    let base = Region::Box(Aabb { min_m: DVec3::splat(-1.0), max_m: DVec3::new(1.0, 1.0, BONDED_M) });
    let mut cases = Vec::new();
    for &size in selection.sizes() {
        let mesh = block(size)?;
        for subject in subjects.iter().filter(|subject| selection.wants(subject, size)) {
            let skin = Skin::of(&mesh)?;
            let edge_m = upper_edge_m(&skin)?;
            let organ = ReadyOrgan::new(&mesh, material, base, subject)
                .with_context(|| format!("{} at {size}", subject.kind))?;
            let block = ReadyBlock { organ, skin, n_tets: mesh.tetrahedra.len(), edge_m, young_pa };
            for &ball_m in balls_m {
                for place in 0..selection.n_places.min(PLACES_M.len()) {
                    let of_ball = block.press(subject, ball_m, place)?;
                    of_ball.iter().for_each(&mut *tell);
                    cases.extend(of_ball);
                }
            }
        }
    }
    Ok(cases)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ball_comes_to_its_depths_and_stands_still() {
        let selection = Selection {
            models: vec!["precomputed".into()],
            sizes: vec![2_000],
            balls_m: vec![10e-3],
            ..Selection::default()
        };
        let mut n_told = 0;
        let cases = run(&selection, &mut |_| n_told += 1).unwrap();
        assert_eq!((cases.len(), n_told), (DEPTHS.len(), DEPTHS.len()));
        for case in &cases {
            let off_m = case.felt.depth_m - case.depth * case.ball_m;
            assert!(off_m.abs() < 2e-3 * case.ball_m && case.felt.unrest < 0.01, "{case:?}");
        }
        assert!(cases[0].felt.force_n > 0.0 && cases.is_sorted_by_key(|case| case.felt.force_n));
        let wrong = Selection { models: vec!["precomputedd".into()], ..Selection::default() };
        assert!(run(&wrong, &mut |_| {}).is_err());
    }

    #[test]
    fn a_large_ball_deep_in_explicit_tissue_comes_to_rest() {
        let selection = Selection {
            models: vec!["explicit".into()],
            sizes: vec![6_300],
            balls_m: vec![10e-3],
            ..Selection::default()
        };
        let cases = run(&selection, &mut |_| {}).unwrap();
        assert!(!cases.is_empty());
        for case in cases {
            assert!(case.holds() && case.felt.unrest < 0.01, "{case:?}");
        }
    }
}
