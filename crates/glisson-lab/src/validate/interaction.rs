//! The two first models against each other, held points, local models, contact, and the same bits twice; on the cylinder of
//! the reference cases.

use anyhow::Context;

use super::elasticity::{cylinder_case, relative_difference};
use super::{Claim, Outcome, check_all};
use glisson::math::{Aabb, DMat3, DVec3, SeededRandom};
use glisson::mesh::NodeId;
use glisson::model::StateHash;
use glisson::model::kind::ModelKind;
use glisson::model::precomputed::{PointConstraint, Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, LocalModel, LocalWork, NodalForce, Rayleigh,
};
use glisson::solve::case::StaticCase;
use glisson::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, StaticProblem, StiffnessTensors, solve_static,
};
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
        self.stored(Precision::F64)
    }

    fn stored(&self, precision: Precision) -> anyhow::Result<Precomputed> {
        Ok(Precomputed::build(&PrecomputedParams {
            mesh: &self.case.mesh,
            material: &self.case.material,
            fixed_nodes: &self.fixed,
            stored: StoredNodes::All,
            precision,
            progress: None,
        })?)
    }

    fn tensor_mass(&self, damping: Rayleigh) -> anyhow::Result<TensorMass> {
        let fixed: Vec<FixedNode> = self.fixed.iter().map(|&node| FixedNode::all_axes(node)).collect();
        Ok(TensorMass::build(&TensorMassParams {
            body: DynamicBody {
                fixed: &fixed,
                damping,
                time_step_s: TIME_STEP_S,
                ..DynamicBody::new(&self.case.mesh, self.case.material.density_kg_per_m3())
            },
            material: &self.case.material,
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

/// What the experiments judge.
struct Measured {
    superposition: f64,
    asymmetry: f64,
    held_f64: Held,
    held_f32: Held,
    different_changes: f64,
    local_model: f64,
    tensor_mass: f64,
    following_m: f64,
    different_hashes: f64,
}

/// The claims; `name_of_changes` names that of the changes of contacts.
fn claims(name_of_changes: &str) -> [Claim<'_, Measured>; 11] {
    [
        Claim::at_most(
            "pre-computed: superposition of two forces, relative",
            "linearity; Checoury 2002 fig. 2.1",
            |m| m.superposition,
            1e-12,
        ),
        Claim::at_most(
            "pre-computed: compliance symmetric, relative",
            "Maxwell-Betti",
            |m| m.asymmetry,
            1e-12,
        ),
        Claim::at_most(
            "pre-computed: displacements imposed on 1 to 50 points of triangles, some sliding: miss, relative",
            "Cotin 1998 s. 4.2 and 5",
            |m| m.held_f64.miss,
            1e-12,
        ),
        Claim::at_most(
            "pre-computed, stored in f32: the same miss, relative",
            OWN,
            |m| m.held_f32.miss,
            1e-12,
        ),
        Claim::at_most(
            "pre-computed: shape under these reactions against a direct static solution, relative",
            "Checoury 2002 eq. 2.12 and 2.13",
            |m| m.held_f64.off_static,
            1e-10,
        ),
        Claim::at_most(
            "pre-computed, stored in f32: the same difference, relative",
            OWN,
            |m| m.held_f32.off_static,
            1e-5,
        ),
        Claim::at_most(name_of_changes, OWN, |m| m.different_changes, 0.0),
        Claim::at_most(
            "local model: compliance of 3 to 20 nodes over 1 ms on rings of tetrahedra against the whole body, relative",
            "Demko, Moss and Smith 1984: exponential decay",
            |m| m.local_model,
            1e-2,
        ),
        Claim::at_most(
            "tensor-mass run to rest against pre-computed, relative",
            OWN,
            |m| m.tensor_mass,
            1e-6,
        ),
        Claim::at_most("contact: the touched point follows the tool [m]", RR_3511, |m| m.following_m, 1e-12),
        Claim::at_most("the same session twice: different state hashes", OWN, |m| m.different_hashes, 0.0),
    ]
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let body = Body::new()?;
    let mut precomputed = body.precomputed()?;
    let both = body.loaded(&mut precomputed, [1.0, 1.0], 1);
    let (different_changes, n_kept) = change_contacts(&body)?;
    let (following_m, hash) = palpate(&body)?;
    let (_, hash_again) = palpate(&body)?;
    let measured = Measured {
        superposition: relative_difference(&sum_of_two(&body, &mut precomputed), &both),
        asymmetry: asymmetry(&precomputed),
        held_f64: hold(&body, body.stored(Precision::F64)?)?,
        held_f32: hold(&body, body.stored(Precision::F32)?)?,
        different_changes,
        local_model: local_model_error(&body)?,
        tensor_mass: relative_difference(&tensor_mass_at_rest(&body)?, &both),
        following_m,
        different_hashes: f64::from(u8::from(hash != hash_again)),
    };
    let name_of_changes = format!(
        "pre-computed: 10000 changes of the contacts ({n_kept} rows kept their factor), every 25th compared: \
         reactions with other bits than those of a model without a past"
    );
    Ok(Outcome::from(check_all(&claims(&name_of_changes), &measured)))
}

/// Displacements under each of the two forces alone, added [m].
fn sum_of_two(body: &Body, model: &mut Precomputed) -> Vec<DVec3> {
    let first = body.loaded(model, [1.0, 0.0], 1);
    let second = body.loaded(model, [0.0, 1.0], 1);
    first.iter().zip(&second).map(|(a, b)| *a + *b).collect()
}

/// Displacements of the tensor-mass under both forces, at rest [m].
fn tensor_mass_at_rest(body: &Body) -> anyhow::Result<Vec<DVec3>> {
    let mut model = body.tensor_mass(Rayleigh::of_mass(60.0))?;
    Ok(body.loaded(&mut model, [1.0, 1.0], 20_000))
}

/// Largest entry of T^lm - (T^ml)^T of all pairs of loadable nodes, over the largest entry.
fn asymmetry(model: &Precomputed) -> f64 {
    let size = |m: DMat3| m.to_cols_array().into_iter().map(f64::abs).fold(0.0, f64::max);
    let (mut worst, mut largest) = (0.0_f64, 0.0_f64);
    for (i, &a) in model.loadable_nodes().iter().enumerate() {
        for &b in &model.loadable_nodes()[..=i] {
            let (Some(there), Some(back)) = (model.compliance_m_per_n(a, b), model.compliance_m_per_n(b, a))
            else {
                return f64::INFINITY;
            };
            worst = worst.max(size(there - back.transpose()));
            largest = largest.max(size(there));
        }
    }
    worst / largest
}

/// How well held points are held.
struct Held {
    /// The farthest from a target along a held direction, over the largest target.
    miss: f64,
    /// Largest difference from the static solution under the reactions, over its largest displacement.
    off_static: f64,
}

/// Holds 1 to 50 points on triangles of surface nodes, every third along one direction alone, every fourth along two
/// axes.
fn hold(body: &Body, mut model: Precomputed) -> anyhow::Result<Held> {
    let mesh = &body.case.mesh;
    let mut random = SeededRandom::new(12);
    let triangles: Vec<[NodeId; 3]> =
        model.loadable_nodes().as_chunks::<3>().0.iter().step_by(2).copied().collect();
    let mut held = Held { miss: 0.0, off_static: 0.0 };
    let mut vector = |size: f64| DVec3::from_array([0.0; 3].map(|_: f64| random.uniform_in(-size, size)));
    for n_points in [1, 2, 5, 10, 20, 50] {
        let points: Vec<PointConstraint> = triangles
            .iter()
            .take(n_points)
            .enumerate()
            .map(|(i, &nodes)| {
                let point = PointConstraint::on_triangle(nodes, [0.5, 0.3, 0.2], vector(1e-3));
                match i % 12 {
                    0 | 3 | 6 | 9 => point.along(vector(1.0)),
                    4 | 8 => point.along_axes([true, false, true]),
                    _ => point,
                }
            })
            .collect();
        let force = NodalForce { node: body.top[0], force_n: DVec3::new(0.01, 0.0, -0.02) };
        model.impose_points(&points, &[force]);
        model.step(TIME_STEP_S);
        let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        nodal_force_n[force.node.index()] += force.force_n;
        for (point, reaction_n) in points.iter().zip(model.constraint_forces_n()) {
            let found_m = model
                .point_displacement_m(point.nodes, point.weights)
                .context("a point of surface nodes has a displacement")?;
            for direction in point.directions.iter().filter(|d| **d != DVec3::ZERO) {
                let miss_m = (found_m - point.displacement_m).dot(direction.normalize()).abs();
                held.miss = held.miss.max(miss_m / 1e-3);
            }
            for (node, weight) in point.nodes.iter().zip(point.weights) {
                nodal_force_n[node.index()] += *reaction_n * weight;
            }
        }
        let solution = solve_static(&StaticProblem {
            mesh,
            material: &body.case.material,
            conditions: &BoundaryConditions::fixed(&body.fixed),
            nodal_force_n: &nodal_force_n,
        })?;
        held.off_static =
            held.off_static.max(relative_difference(&body.displacements(&model), &solution.displacement_m));
    }
    Ok(held)
}

/// Adds, takes away and exchanges held nodes ten thousand times; after how many of every 25th change a model without a
/// past gives reactions with other bits, and how many rows kept their factor in all.
fn change_contacts(body: &Body) -> anyhow::Result<(f64, usize)> {
    let mut model = body.precomputed()?;
    let mut anew = model.clone();
    let mut random = SeededRandom::new(13);
    let loadable = model.loadable_nodes().to_vec();
    let mut points: Vec<PointConstraint> = Vec::new();
    let (mut n_different, mut n_kept) = (0_u32, 0);
    for change in 0..10_000 {
        let mut below = |n: usize| (random.next_u64() % n as u64) as usize;
        let displacement_m = DVec3::new(1e-4 * below(10) as f64, -1e-3, 2e-3);
        let point = PointConstraint::node(loadable[below(loadable.len())], displacement_m);
        let n = points.len();
        match below(4) {
            0 | 1 if n < 20 => points.push(point),
            2 if n > 0 => points[below(n)] = point,
            _ if n > 0 => drop(points.remove(below(n))),
            _ => points.push(point),
        }
        model.impose_points(&points, &[]);
        let bits = |forces: &[DVec3]| -> Vec<u64> {
            forces.iter().flat_map(|f| f.to_array()).map(f64::to_bits).collect()
        };
        let found = bits(model.update_reactions());
        n_kept += model.contact_report().n_kept;
        if change % 25 == 0 {
            anew.reset();
            anew.impose_points(&points, &[]);
            n_different += u32::from(bits(anew.update_reactions()) != found);
        }
    }
    Ok((f64::from(n_different), n_kept))
}

/// Largest error of the local models of patches of the top over 1 ms, relative to the largest entry.
fn local_model_error(body: &Body) -> anyhow::Result<f64> {
    const PERIOD_S: f64 = 1e-3;
    let mesh = &body.case.mesh;
    let mut model = body.tensor_mass(Rayleigh::default())?;
    let edges = MeshEdges::of_mesh(mesh)?;
    let mut tensors = StiffnessTensors::assemble(mesh, &edges, &body.case.material)?;
    for (n, tensor) in tensors.vertex.iter_mut().enumerate() {
        let of_mass = model.mass_kg(NodeId::from_index(n)) / (PERIOD_S * PERIOD_S);
        *tensor += DMat3::from_diagonal(DVec3::splat(of_mass));
    }
    let system = FreeSystem::new(&edges, &tensors, &BoundaryConditions::fixed(&body.fixed))?;
    let factor = system.factorize()?;
    let mut scratch = factor.scratch(1);
    let mut work = LocalWork::with_room_for(mesh.positions_m.len());
    let mut found = LocalModel::new();
    let mut worst = 0.0_f64;
    for n in [3, 8, 20] {
        let patch = &body.top[..n.min(body.top.len())];
        model.local_model_into(patch, PERIOD_S, &mut work, &mut found);
        let (mut off, mut largest) = (0.0_f64, 0.0_f64);
        for (j, by) in patch.iter().enumerate() {
            for axis in 0..3 {
                let mut column = vec![0.0; system.n_free()];
                column[system.row_of(*by, axis).context("the top is free")?] = 1.0;
                factor.solve_in_place(&mut column, 1, &mut scratch);
                for (i, of) in patch.iter().enumerate() {
                    for a in 0..3 {
                        let exact = column[system.row_of(*of, a).context("the top is free")?];
                        off = off.max((found.tensor_m_per_n(i, j).col(axis)[a] - exact).abs());
                        largest = largest.max(exact.abs());
                    }
                }
            }
        }
        worst = worst.max(off / largest);
    }
    Ok(worst)
}

/// Pushes the top 3 mm in with a ball; how far the touched point is from where the tool's motion puts it [m].
fn palpate(body: &Body) -> anyhow::Result<(f64, StateHash)> {
    let at = |z_m: f64| ToolInput::at(DVec3::new(2e-3, 1e-3, z_m), DVec3::Z);
    let tip_radius_m = 5e-3;
    let tool = Tool::probe("ball", tip_radius_m, at(HEIGHT_M + 2.0 * tip_radius_m));
    let (min_m, max_m) = (DVec3::new(-1.0, -1.0, -1e-9), DVec3::new(1.0, 1.0, 1e-9));
    let base = Region::Box(Aabb { min_m, max_m });
    let mut spec = WorldSpec::new("cylinder", 1e-3, tool);
    spec.supports = vec![Support::all_axes(base)];
    let model = Box::new(body.precomputed()?);
    let mut world = World::new(spec, body.case.mesh.clone(), model, ModelKind::Precomputed)?;
    let mut step = |z_m: f64| {
        world.step(&StepInput::of(&[at(z_m)]));
        world.snapshot().tools[0].contacts[0].map(|c| c.point_m)
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
