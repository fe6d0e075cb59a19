//! Embedded cuts: how slits open, what strokes open and keep, and the stable step after them.

use super::{Experiment, Outcome};
use crate::bodies::{liver, most};
use glisson::material::{LinearElastic, law_named};
use glisson::math::{Aabb, DVec3, SeededRandom, tetrahedron_volume_m3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::embedding::{Embedding, EmbeddingUndo};
use glisson::mesh::quality::MeshQuality;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::kind::{ModelKind, build_model};
use glisson::model::tensor_mass::TensorMass;
use glisson::model::{
    Constraints, DeformableModel, FixedNode, ImposedDisplacement, ModelUndo, OrganBody, Rayleigh, follow_edit,
};
use glisson::tool::cut::subdivision::{CutReport, SubdivisionCut, SubdivisionParams};

const REQUIREMENT: &str = "requirement";
const LIVER_TETS: usize = 6_300;
const N_LIVERS: usize = 12;
const N_STROKES: usize = 4;
const N_STEPS: usize = 40;

/// The block of the slit [m], and into how many bricks of five tetrahedra it is divided.
const BLOCK_M: DVec3 = DVec3::new(0.06, 0.05, 0.04);
const BRICKS: [usize; 3] = [14, 11, 9];
/// Angles of the slit to the mesh [rad] and its depths [m].
const ANGLES: [f64; 3] = [0.0, 0.3, 0.6];
const DEPTHS_M: [f64; 2] = [0.017, 0.0187];
/// By how much the block is pulled [m], in steps of so long [s].
const PULL_M: f64 = 0.01;
const STEP_S: f64 = 2e-2;
const STEPS: usize = 150;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut experiments = slits()?;
    experiments.extend(strokes()?);
    Ok(experiments.into())
}

fn tissue() -> LinearElastic {
    LinearElastic::from_young_poisson(5e3, 0.4, 1060.0).expect("sound numbers")
}

/// A block that is held at one end and pulled at the other, with a slit across its top.
struct Slit {
    mesh: EditableMesh,
    model: Box<dyn DeformableModel>,
}

impl Slit {
    /// Cut as `params` say, all across the middle, turned by `angle` about the vertical.
    fn new(params: &SubdivisionParams, depth_m: f64, angle: f64) -> anyhow::Result<Self> {
        let mesh = box_of_five(BRICKS, BLOCK_M);
        let held = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].x < 1e-9);
        let organ = OrganBody {
            fixed: held.map(|n| FixedNode::all_axes(NodeId::from_index(n))).collect(),
            embeds_cuts: params.is_nested,
            damping: Rayleigh::of_mass(40.0),
            law: law_named("stable_neo_hooke"),
            ..OrganBody::new(mesh.clone(), tissue(), STEP_S)
        };
        let kind = ModelKind::by_name("implicit").expect("it is in the table");
        let mut model = build_model(&organ, kind)?;
        let mut body = EditableMesh::new(mesh)?;
        let along = DVec3::new(angle.sin(), angle.cos(), 0.0);
        let middle_m = DVec3::new(0.5 * BLOCK_M.x, 0.5 * BLOCK_M.y, BLOCK_M.z);
        let blade_m = |share: f64| {
            let skin_m = middle_m + along * (0.08 * share - 0.04);
            [skin_m - DVec3::Z * depth_m, skin_m + DVec3::Z * 0.02]
        };
        stroke(&mut body, params, blade_m, |body, change| {
            let mut undo = ModelUndo::default();
            Ok(follow_edit(&mut model, body.mesh(), change, &mut undo)?)
        })?;
        let mut slit = Self { mesh: body, model };
        slit.pull();
        Ok(slit)
    }

    fn pull(&mut self) {
        let (rest_m, topology) = (&self.mesh.mesh().positions_m, self.mesh.topology());
        let nodes = (0..rest_m.len()).map(NodeId::from_index);
        let pulled = nodes.filter(|n| topology.is_live_node(*n) && rest_m[n.index()].x > BLOCK_M.x - 1e-9);
        let displacements =
            pulled.map(|node| ImposedDisplacement { node, displacement_m: DVec3::X * PULL_M });
        self.model.apply(&Constraints { displacements: displacements.collect(), forces: Vec::new() });
        (0..STEPS).for_each(|_| self.model.step(STEP_S));
    }

    /// Where tissue is that is at `place_m` at rest [m].
    fn at_m(&self, place_m: DVec3) -> DVec3 {
        let mesh = self.mesh.mesh();
        let weights_in = |tet: TetId| -> [f64; 4] {
            let corners_m = mesh.corners_m(tet);
            std::array::from_fn(|i| {
                let mut part_m = corners_m;
                part_m[i] = place_m;
                tetrahedron_volume_m3(part_m) / tetrahedron_volume_m3(corners_m)
            })
        };
        let least = |weights: &[f64; 4]| weights.iter().copied().fold(f64::INFINITY, f64::min);
        let inside = self.mesh.topology().live_tets().map(|tet| (tet, weights_in(tet)));
        let best = inside.max_by(|a, b| least(&a.1).total_cmp(&least(&b.1)));
        let (tet, weights) = best.expect("a block has tetrahedra");
        let positions_m = self.model.state().positions_m;
        mesh.tetrahedra[tet.index()].iter().zip(weights).map(|(n, w)| positions_m[n.index()] * w).sum()
    }

    /// How far the lips are apart in the middle of the mouth [m].
    fn opening_m(&self, angle: f64) -> f64 {
        let across = DVec3::new(angle.cos(), -angle.sin(), 0.0);
        let middle_m = DVec3::new(0.5 * BLOCK_M.x, 0.5 * BLOCK_M.y, BLOCK_M.z - 1e-4);
        let [a, b] = [1e-4, -1e-4].map(|beside_m| self.at_m(middle_m + across * beside_m));
        a.distance(b) - 2e-4
    }
}

/// A stroke through a body at rest; `follow` hears of each edit.
fn stroke(
    body: &mut EditableMesh,
    params: &SubdivisionParams,
    blade_m: impl Fn(f64) -> [DVec3; 2],
    mut follow: impl FnMut(&EditableMesh, &glisson::mesh::edit::TopologyChange) -> anyhow::Result<()>,
) -> anyhow::Result<CutReport> {
    let mut cut = SubdivisionCut::new(params.clone());
    for step in 0..=N_STEPS {
        let positions_m = body.mesh().positions_m.clone();
        let blade_m = blade_m(step as f64 / N_STEPS as f64);
        let planned = match step {
            N_STEPS => cut.finish(body, &positions_m, blade_m),
            _ => cut.advance(body, &positions_m, blade_m),
        };
        // A refusal is counted in the report, and the stroke goes on.
        if let Ok(Some(edit)) = planned {
            let change = body.apply(&MeshEdit::Replace(edit))?;
            follow(body, &change)?;
        }
    }
    Ok(*cut.report())
}

fn slits() -> anyhow::Result<Vec<Experiment>> {
    let edge_m = MeshQuality::of(&box_of_five(BRICKS, BLOCK_M)).mean_edge_m;
    let ways = [SubdivisionParams::for_mean_edge(edge_m), SubdivisionParams::embedded(edge_m)];
    let mut experiments = Vec::new();
    for angle in ANGLES {
        let mut off = [0.0; 2];
        for (off, depth_m) in off.iter_mut().zip(DEPTHS_M) {
            let [conforming_m, embedded_m] = [&ways[0], &ways[1]].map(|params| -> anyhow::Result<f64> {
                Ok(Slit::new(params, depth_m, angle)?.opening_m(angle))
            });
            *off = embedded_m? / conforming_m? - 1.0;
        }
        let name = format!(
            "block of {} tetrahedra, slits of two depths at {angle} rad to the mesh: opening against a conforming mesh's, worse of both",
            5 * BRICKS.iter().product::<usize>()
        );
        experiments.push(Experiment::at_most(&name, REQUIREMENT, most(off.map(f64::abs)), 0.05));
    }
    Ok(experiments)
}

/// The worst of some livers.
#[derive(Default)]
struct Worst {
    swept_m2: f64,
    off_m2: f64,
    n_refused: usize,
    mass: f64,
    /// Stable step of the worst uncut tetrahedron alone over that after all strokes.
    over_alone: f64,
    /// Stable step after all strokes over the uncut one; the least.
    left: f64,
}

fn strokes() -> anyhow::Result<Vec<Experiment>> {
    let mesh = liver(LIVER_TETS)?;
    let bounds = Aabb::of_points(&mesh.positions_m);
    let params = SubdivisionParams::embedded(MeshQuality::of(&mesh).mean_edge_m);
    let uncut = TensorMass::stable_step(&mesh, &tissue())?;
    let mut random = SeededRandom::new(2);
    let mut worst = Worst { left: 1.0, ..Worst::default() };
    for _ in 0..N_LIVERS {
        let (mut body, mut embedding) = (EditableMesh::new(mesh.clone())?, Embedding::new(&mesh));
        for _ in 0..N_STROKES {
            let blade_m = random_blade(&mut random, &bounds);
            let report = stroke(&mut body, &params, blade_m, |body, change| {
                embedding.follow(body.mesh(), change, &mut EmbeddingUndo::default())?;
                Ok(())
            })?;
            worst.swept_m2 += report.swept_area_m2;
            worst.off_m2 += (report.cut_area_m2 - report.swept_area_m2).abs();
            worst.n_refused += report.n_refused;
        }
        let copies = live_copies(&body, &embedding);
        worst.mass = most([worst.mass, (copies.volume_m3() / mesh.volume_m3() - 1.0).abs()]);
        let cut_s = TensorMass::stable_step(&copies, &tissue())?.step_s;
        worst.over_alone = most([worst.over_alone, uncut.after_cuts_s / cut_s]);
        worst.left = worst.left.min(cut_s / uncut.step_s);
    }
    let n = N_LIVERS * N_STROKES;
    Ok(vec![
        Experiment::at_most(
            &format!(
                "{n} random strokes in livers of {LIVER_TETS} tetrahedra: area opened against area swept"
            ),
            REQUIREMENT,
            worst.off_m2 / worst.swept_m2,
            0.02,
        ),
        Experiment::at_most("the same: steps refused", REQUIREMENT, worst.n_refused as f64, 0.0),
        Experiment::at_most("the same: change of mass, relative, worst", REQUIREMENT, worst.mass, 1e-12),
        Experiment::at_most(
            &format!(
                "the same: stable step of the worst uncut tetrahedron alone over that after four strokes ({:.2} of the uncut mesh's)",
                worst.left
            ),
            "copies keep their shape",
            worst.over_alone,
            1.0 + 1e-9,
        ),
    ])
}

/// A blade that goes across the front of the body at some place, angle, depth and lean.
fn random_blade(random: &mut SeededRandom, bounds: &Aabb) -> impl Fn(f64) -> [DVec3; 2] + use<> {
    let (middle_m, half_m) = (0.5 * (bounds.min_m + bounds.max_m), 0.5 * (bounds.max_m - bounds.min_m));
    let angle = random.uniform_in(0.0, std::f64::consts::TAU);
    let along = DVec3::new(angle.cos(), 0.0, angle.sin());
    let beside = random.uniform_in(-0.4, 0.4) * DVec3::new(-along.z, 0.0, along.x);
    let at_m =
        middle_m + DVec3::new(random.uniform_in(-0.4, 0.4), 0.0, random.uniform_in(-0.4, 0.4)) * half_m;
    let depth_m = random.uniform_in(-0.3, 0.5) * half_m.y;
    let (from_m, to_m) = (random.uniform_in(-0.05, -0.02), random.uniform_in(0.02, 0.05));
    let back = (beside - DVec3::Y).normalize();
    move |share| {
        let tip_m = at_m + along * (from_m + share * (to_m - from_m)) + DVec3::Y * depth_m;
        [tip_m, tip_m + 0.15 * back]
    }
}

/// The copies that carry something, alone.
fn live_copies(body: &EditableMesh, embedding: &Embedding) -> TetMesh {
    let copies = embedding.copies();
    let mut live: Vec<TetId> = body.topology().live_tets().map(|tet| embedding.copy_of(tet)).collect();
    live.sort_unstable();
    live.dedup();
    TetMesh {
        positions_m: copies.positions_m.clone(),
        tetrahedra: live.iter().map(|tet| copies.tetrahedra[tet.index()]).collect(),
        shares: live.iter().map(|tet| copies.share(*tet)).collect(),
    }
}
