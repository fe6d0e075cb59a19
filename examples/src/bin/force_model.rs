//! A force model of one's own: it implements [`DeformableModel`] from outside, a [`World`] is made with it, a tool pushes it.
//!
//! A thin layer of tissue bonded to bone, as an elastic foundation (K. L. Johnson, Contact Mechanics, 1985, after
//! Winkler 1867): a place of the surface answers to the load on itself alone, with `E (1 - nu)/((1 + nu)(1 - 2 nu) h)` per area
//! along the normal, the stiffness of a layer of thickness h that cannot widen, and `G/h` along the surface, that of its shear.
//! Each spring has a dashpot of `tau` times its stiffness beside it (Kelvin and Voigt; Y. C. Fung, Biomechanics: mechanical
//! properties of living tissues, 1993): a surface that is let go returns as exp(-t/tau). Nothing has mass, so with f the
//! force on a node
//!
//! `k u + tau k du/dt = f`, over a step dt with f constant: `u' = f/k + (u - f/k) exp(-dt/tau)`, the exact solution.
#![allow(clippy::print_stdout, reason = "an example shows its figures on standard output")]

use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::TopologyChange;
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::kind::ModelKind;
use glisson::model::{Constraints, DeformableModel, ModelReport, ModelState, NodalForce, TopologyRefusal};
use glisson::tool::{Tool, ToolInput};
use glisson::world::spec::{Region, Support, WorldSpec};
use glisson::world::{StepInput, World};
use std::error::Error;

/// A layer on bone.
#[derive(Clone)]
struct Foundation {
    rest_m: Vec<DVec3>,
    /// Of each node along each axis [N/m]; zero on the bone, which does not move.
    stiffness_n_per_m: Vec<DVec3>,
    relaxation_time_s: f64,
    constraints: Constraints,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    constraint_forces_n: Vec<DVec3>,
}

/// Area [m2] of the layer's upper face, at z = `thickness_m`, that belongs to each node.
fn upper_areas_m2(mesh: &TetMesh, thickness_m: f64) -> Vec<f64> {
    let mut areas_m2 = vec![0.0; mesh.positions_m.len()];
    for tet in &mesh.tetrahedra {
        let top: Vec<NodeId> =
            tet.iter().copied().filter(|n| mesh.positions_m[n.index()].z == thickness_m).collect();
        if let [a, b, c] = top[..] {
            let [a_m, b_m, c_m] = [a, b, c].map(|n| mesh.positions_m[n.index()]);
            let area_m2 = 0.5 * (b_m - a_m).cross(c_m - a_m).length();
            [a, b, c].iter().for_each(|n| areas_m2[n.index()] += area_m2 / 3.0);
        }
    }
    areas_m2
}

impl Foundation {
    fn new(mesh: &TetMesh, material: &LinearElastic, thickness_m: f64, relaxation_time_s: f64) -> Self {
        let n_nodes = mesh.positions_m.len();
        // E (1 - nu)/((1 + nu)(1 - 2 nu)) is lambda + 2 mu.
        let normal_pa = material.lambda_pa() + 2.0 * material.mu_pa();
        let per_area = DVec3::new(material.mu_pa(), material.mu_pa(), normal_pa) / thickness_m;
        Self {
            rest_m: mesh.positions_m.clone(),
            stiffness_n_per_m: upper_areas_m2(mesh, thickness_m)
                .iter()
                .map(|area| per_area * *area)
                .collect(),
            relaxation_time_s,
            constraints: Constraints::default(),
            positions_m: mesh.positions_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            constraint_forces_n: Vec::with_capacity(n_nodes),
        }
    }
}

impl DeformableModel for Foundation {
    fn apply(&mut self, constraints: &Constraints) {
        // `clone_from` reuses the lists: a step allocates nothing once they are long enough.
        self.constraints.displacements.clone_from(&constraints.displacements);
        self.constraints.forces.clone_from(&constraints.forces);
    }

    fn step(&mut self, dt_s: f64) {
        let kept = (-dt_s / self.relaxation_time_s).exp();
        let (mut forces, mut held) = (self.constraints.forces.iter(), self.constraints.displacements.iter());
        let (mut next_force, mut next_held) = (forces.next(), held.next());
        self.constraint_forces_n.clear();
        // Both lists ascend by node, so one pass over the nodes meets them in order.
        for n in 0..self.rest_m.len() {
            let id = NodeId::from_index(n);
            let stiffness = self.stiffness_n_per_m[n];
            let before_m = self.positions_m[n] - self.rest_m[n];
            let mut force_n = DVec3::ZERO;
            if let Some(NodalForce { force_n: given_n, .. }) = next_force.filter(|force| force.node == id) {
                force_n = *given_n;
                next_force = forces.next();
            }
            let mut after_m = DVec3::ZERO;
            if stiffness != DVec3::ZERO {
                let resting_m = force_n / stiffness;
                after_m = resting_m + (before_m - resting_m) * kept;
            }
            if let Some(imposed) = next_held.filter(|imposed| imposed.node == id) {
                after_m = imposed.displacement_m;
                let velocity = (after_m - before_m) / dt_s;
                let pull_n = stiffness * (after_m + velocity * self.relaxation_time_s);
                self.constraint_forces_n.push(pull_n - force_n);
                next_held = held.next();
            }
            self.positions_m[n] = self.rest_m[n] + after_m;
            self.velocities_m_per_s[n] = (after_m - before_m) / dt_s;
        }
    }

    fn state(&self) -> ModelState<'_> {
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    /// Positions and velocities are all that it has.
    fn history_into(&self, _numbers: &mut Vec<f64>) {}

    fn constraint_forces_n(&self) -> &[DVec3] {
        &self.constraint_forces_n
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.positions_m.copy_from_slice(positions_m);
        self.velocities_m_per_s.fill(DVec3::ZERO);
    }

    /// Nothing here has mass.
    fn set_gravity(&mut self, _gravity_m_per_s2: DVec3) {}

    fn report(&self) -> ModelReport {
        ModelReport { n_parts: 1, ..ModelReport::default() }
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        Box::new(self.clone())
    }

    /// A model that cannot be cut says so: the world then refuses the cut, and nothing has changed.
    fn topology_changed(&mut self, _mesh: &TetMesh, _change: &TopologyChange) -> Result<(), TopologyRefusal> {
        Err(TopologyRefusal::Frozen {
            model: "foundation",
            reason: "its springs are those of the whole layer",
        })
    }
}

const THICKNESS_M: f64 = 4e-3;
const TIME_STEP_S: f64 = 1e-3;
const RELAXATION_TIME_S: f64 = 0.1;
const TIP_RADIUS_M: f64 = 3e-3;

fn main() -> Result<(), Box<dyn Error>> {
    let material = LinearElastic::from_young_poisson(5e3, 0.45, 1_060.0)?;
    let mesh = box_of_five([8, 8, 1], DVec3::new(0.04, 0.04, THICKNESS_M));
    let model = Foundation::new(&mesh, &material, THICKNESS_M, RELAXATION_TIME_S);

    // A probe straight above the node in the middle of the surface, which it then presses alone.
    let above = |height_m: f64| {
        ToolInput::at(DVec3::new(0.02, 0.02, THICKNESS_M + TIP_RADIUS_M + height_m), DVec3::Z)
    };
    let middle = mesh.positions_m.iter().position(|p| p.distance(DVec3::new(0.02, 0.02, THICKNESS_M)) < 1e-9);
    let middle = middle.ok_or("the mesh has no node in the middle")?;
    let stiffness_n_per_m = model.stiffness_n_per_m[middle].z;
    let mut spec =
        WorldSpec::new("layer on bone", TIME_STEP_S, Tool::probe("probe", TIP_RADIUS_M, above(2e-3)));
    spec.supports = vec![Support::all_axes(Region::Furthest { direction: -DVec3::Z, fraction: 0.5 })];
    // A kind is what scenes and sessions call a model; one from outside takes that of the model it is most like.
    let mut world = World::new(spec, mesh, Box::new(model), ModelKind::MassSpring)?;

    let push = |world: &mut World, from_m: f64, to_m: f64, n_steps: u32| {
        for step in 1..=n_steps {
            let share = f64::from(step) / f64::from(n_steps);
            world.step(&StepInput::of(&[above(from_m + (to_m - from_m) * share)]));
        }
    };
    push(&mut world, 2e-3, 0.0, 100);
    let mut at_m = 0.0;
    for depth_m in [0.5e-3, 1e-3, 1.5e-3] {
        push(&mut world, at_m, -depth_m, 100);
        push(&mut world, -depth_m, -depth_m, 10);
        at_m = -depth_m;
        let force_n = world.report().tools[0].force_on_tool_n.z;
        let dent_m = THICKNESS_M - world.state().positions_m[middle].z;
        let expected_n = stiffness_n_per_m * dent_m;
        println!("dent {:.3} mm: force {force_n:.5} N, foundation {expected_n:.5} N", dent_m * 1e3);
    }
    world.step(&StepInput::of(&[above(0.1)]).placed());
    let dent_m = |world: &World| THICKNESS_M - world.state().positions_m[middle].z;
    let first_m = dent_m(&world);
    // The probe went away at once; the dent is left to itself.
    for _ in 0..100 {
        world.step(&StepInput::of(&[above(0.1)]));
    }
    let share = dent_m(&world) / first_m;
    println!("left of the dent after {RELAXATION_TIME_S} s: {share:.4}, exp(-1) is {:.4}", (-1.0_f64).exp());
    Ok(())
}
