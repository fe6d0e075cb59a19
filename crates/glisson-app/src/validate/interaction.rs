//! The two first models against each other, contact, and the same bits twice; on the cylinder of the reference cases.

use super::elasticity::{cylinder_case, relative_difference};
use super::{Experiment, Outcome};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::NodeId;
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{Constraints, DeformableModel, DynamicBody, FixedNode, NodalForce, Rayleigh};
use glisson::record::hash::StateHash;
use glisson::solve::case::StaticCase;
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Region, Support, WorldSpec};
use glisson::world::{StepInput, World};

const RR_3511: &str = "Cotin, Delingette and Ayache 1998, RR-3511";
const OWN: &str = "requirement";
const TIME_STEP_S: f64 = 1e-4;
const HEIGHT_M: f64 = 0.05;

struct Body {
    case: StaticCase,
    fixed: Vec<NodeId>,
    top: Vec<NodeId>,
}

impl Body {
    fn new() -> anyhow::Result<Self> {
        let case = cylinder_case()?;
        let at = |z_m: f64| {
            let nodes = case.mesh.positions_m.iter().enumerate();
            nodes.filter(|(_, p)| (p.z - z_m).abs() < 1e-9).map(|(i, _)| NodeId::from_index(i)).collect()
        };
        let (fixed, top) = (at(0.0), at(HEIGHT_M));
        Ok(Self { case, fixed, top })
    }

    fn precomputed(&self) -> anyhow::Result<Precomputed> {
        Ok(Precomputed::build(&PrecomputedParams {
            mesh: &self.case.mesh,
            material: &self.case.material,
            fixed_nodes: &self.fixed,
            stored: StoredNodes::All,
            precision: Precision::F64,
            progress: None,
        })?)
    }

    /// Positions at rest under a force on two nodes of the top, scaled.
    fn loaded(&self, model: &mut dyn DeformableModel, scale: [f64; 2], steps: usize) -> Vec<DVec3> {
        let (first, last) = (self.top[0], self.top[self.top.len() - 1]);
        let mut forces = vec![
            NodalForce { node: first, force_n: DVec3::new(0.01, 0.0, -0.02) * scale[0] },
            NodalForce { node: last, force_n: DVec3::new(0.0, 0.01, 0.01) * scale[1] },
        ];
        forces.sort_by_key(|f| f.node);
        model.apply(&Constraints { displacements: vec![], forces });
        for _ in 0..steps {
            model.step(TIME_STEP_S);
        }
        self.displacements(model)
    }

    fn displacements(&self, model: &dyn DeformableModel) -> Vec<DVec3> {
        let rest = &self.case.mesh.positions_m;
        model.state().positions_m.iter().zip(rest).map(|(p, r)| *p - *r).collect()
    }
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let body = Body::new()?;
    let mut precomputed = body.precomputed()?;
    let both = body.loaded(&mut precomputed, [1.0, 1.0], 1);
    let first = body.loaded(&mut precomputed, [1.0, 0.0], 1);
    let second = body.loaded(&mut precomputed, [0.0, 1.0], 1);
    let sum: Vec<DVec3> = first.iter().zip(&second).map(|(a, b)| *a + *b).collect();

    let fixed: Vec<FixedNode> = body.fixed.iter().map(|&node| FixedNode::all_axes(node)).collect();
    let mut tensor_mass = TensorMass::build(&TensorMassParams {
        body: DynamicBody {
            fixed: &fixed,
            damping: Rayleigh::of_mass(60.0),
            time_step_s: TIME_STEP_S,
            ..DynamicBody::new(&body.case.mesh, body.case.material.density_kg_per_m3())
        },
        material: &body.case.material,
    })?;
    let at_rest = body.loaded(&mut tensor_mass, [1.0, 1.0], 20_000);

    let loadable = precomputed.loadable_nodes();
    let (a, b) = (loadable[0], loadable[loadable.len() / 2]);
    let there = precomputed.compliance_m_per_n(a, b);
    let back = precomputed.compliance_m_per_n(b, a);
    let asymmetry = match (there, back) {
        (Some(there), Some(back)) => {
            let difference = (there - back.transpose()).to_cols_array().map(f64::abs);
            let size = there.to_cols_array().map(f64::abs);
            difference.into_iter().fold(0.0, f64::max) / size.into_iter().fold(0.0, f64::max)
        }
        _ => f64::INFINITY,
    };

    let (following, hash) = palpate(&body)?;
    let (_, hash_again) = palpate(&body)?;
    let different = f64::from(u8::from(hash != hash_again));
    Ok(Outcome::from(vec![
        Experiment::at_most(
            "pre-computed: superposition of two forces, relative",
            "linearity; Checoury 2002 fig. 2.1",
            relative_difference(&sum, &both),
            1e-12,
        ),
        Experiment::at_most(
            "pre-computed: compliance symmetric, relative",
            "Maxwell-Betti",
            asymmetry,
            1e-10,
        ),
        Experiment::at_most(
            "tensor-mass run to rest against pre-computed, relative",
            OWN,
            relative_difference(&at_rest, &both),
            1e-6,
        ),
        Experiment::at_most("contact: the touched point follows the tool [m]", RR_3511, following, 1e-12),
        Experiment::at_most("the same session twice: different state hashes", OWN, different, 0.0),
    ]))
}

/// Pushes the top 3 mm in with a ball; how far the touched point is from where the tool's motion puts it [m].
fn palpate(body: &Body) -> anyhow::Result<(f64, StateHash)> {
    let at = |z_m: f64| ToolInput { tip_in_world_m: DVec3::new(2e-3, 1e-3, z_m), shaft_in_world: DVec3::Z };
    let tip_radius_m = 5e-3;
    let tool = Tool {
        name: "ball".into(),
        tip_radius_m,
        shaft_radius_m: 1e-3,
        shaft_length_m: 0.1,
        home: at(HEIGHT_M + 2.0 * tip_radius_m),
    };
    let (min_m, max_m) = (DVec3::new(-1.0, -1.0, -1e-9), DVec3::new(1.0, 1.0, 1e-9));
    let base = Region::Box(Aabb { min_m, max_m });
    let mut spec = WorldSpec::new("cylinder", 1e-3, tool);
    spec.supports = vec![Support::all_axes(base)];
    let model = Box::new(body.precomputed()?);
    let mut world = World::new(spec, body.case.mesh.clone(), model, ModelKind::Precomputed)?;
    let mut step = |z_m: f64| {
        world.step(&StepInput { tool: at(z_m), n_substeps: 1, placed: false });
        world.snapshot().contact.map(|c| c.point_m)
    };
    let touched_z_m = HEIGHT_M + tip_radius_m - 1e-4;
    let start = step(touched_z_m);
    let mut worst = 0.0_f64;
    for i in 1..=100 {
        let depth_m = 3e-3 * f64::from(i) / 100.0;
        let expected = start.map(|p| p - DVec3::Z * depth_m);
        let found = step(touched_z_m - depth_m);
        worst = worst.max(match (found, expected) {
            (Some(found), Some(expected)) => found.distance(expected),
            _ => f64::INFINITY,
        });
    }
    Ok((worst, world.state_hash()))
}
