//! The soak of the explicit model on the fast kernel: through the library, so that its reports are counted, a copy
//! takes over and the drift is measured.

use glisson::math::{DVec3, is_inverted, tetrahedron_volume_m3};
use glisson::mesh::TetMesh;
use glisson::mesh::edit::TopologyChange;
use glisson::model::StateHash;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{Constraints, DeformableModel, DynamicBody, ModelReport, ModelState, TopologyRefusal};
use glisson::scene::{Scene, read_organ};
use glisson::world::World;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Steps to come to rest in.
const REST_STEPS: u64 = 25_000;

/// What a model said of all its steps.
#[derive(Default)]
struct Counts {
    limited: AtomicU64,
    recovered: AtomicU64,
}

/// A model whose reports are counted, and which is replaced by its copy after some steps.
struct Watched {
    model: Box<dyn DeformableModel>,
    counts: Arc<Counts>,
    steps_to_copy: Option<u64>,
}

impl DeformableModel for Watched {
    fn apply(&mut self, constraints: &Constraints) {
        self.model.apply(constraints);
    }

    fn step(&mut self, dt_s: f64) {
        if let Some(steps) = &mut self.steps_to_copy {
            *steps -= 1;
            if *steps == 0 {
                self.model = self.model.duplicate();
                self.steps_to_copy = None;
            }
        }
        self.model.step(dt_s);
        let report = self.model.report();
        self.counts.limited.fetch_add(u64::from(report.energy_was_limited), Ordering::Relaxed);
        self.counts.recovered.fetch_add(u64::from(report.n_recovered_nodes), Ordering::Relaxed);
    }

    fn state(&self) -> ModelState<'_> {
        self.model.state()
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        self.model.history_into(numbers);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        self.model.constraint_forces_n()
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        self.model.take_over(positions_m);
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.model.set_gravity(gravity_m_per_s2);
    }

    fn report(&self) -> ModelReport {
        self.model.report()
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        self.model.duplicate()
    }

    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.model.topology_changed(mesh, change)
    }
}

/// How a run went.
struct Run {
    contact_steps: u64,
    greatest_force_n: f64,
    drift_m: f64,
    n_inverted: usize,
    counts: Arc<Counts>,
    hash: StateHash,
}

fn run(scene_file: &Path, law: KernelLaw, steps: u64, steps_to_copy: Option<u64>) -> Run {
    let scene = Scene::parse(&std::fs::read_to_string(scene_file).unwrap()).unwrap();
    let organ = read_organ(&scene, scene_file.parent().unwrap()).unwrap();
    let body = DynamicBody {
        fixed: &organ.fixed,
        damping: organ.damping,
        ..DynamicBody::new(&organ.mesh, organ.material.density_kg_per_m3())
    };
    let materials = &[organ.material];
    let params = ExplicitKernelParams::new(body, law, materials);
    // A law that stiffens may need several internal steps for one of the scene.
    let time_step_s = scene.world.time_step_s.min(ExplicitKernel::stable_step(&params).unwrap().step_s);
    let params = ExplicitKernelParams { body: DynamicBody { time_step_s, ..body }, ..params };
    let counts = Arc::new(Counts::default());
    let model = Box::new(ExplicitKernel::build(&params).unwrap());
    let model = Box::new(Watched { model, counts: Arc::clone(&counts), steps_to_copy });
    let mut world = World::new(scene.world.clone(), organ.mesh.clone(), model, scene.organ.model).unwrap();
    let (mut contact_steps, mut greatest_force_n) = (0, 0.0_f64);
    for step in 1..=steps {
        let report = world.step(&scene.input_at(step as f64 * scene.world.time_step_s));
        assert_eq!(report.n_non_finite_nodes, 0, "step {step}");
        contact_steps += u64::from(report.in_contact());
        greatest_force_n = greatest_force_n.max(report.tools[0].force_on_tool_n.length());
    }
    let hash = world.state_hash();
    for _ in 0..REST_STEPS {
        world.step(&scene.input_at(0.0).placed());
    }
    let distances_m = world.state().positions_m.iter().zip(&organ.mesh.positions_m);
    let drift_m = distances_m.map(|(p, rest)| p.distance(*rest)).fold(0.0, f64::max);
    let n_inverted = (0..organ.mesh.tetrahedra.len())
        .map(|t| organ.mesh.tetrahedra[t].map(|n| world.state().positions_m[n.index()]))
        .filter(|corners_m| is_inverted(tetrahedron_volume_m3(*corners_m)))
        .count();
    Run { contact_steps, greatest_force_n, drift_m, n_inverted, counts, hash }
}

/// Runs twice, the second time in part on a copy; answers the report's row.
pub(super) fn row(scene_file: &Path, law: KernelLaw, steps: u64) -> String {
    let first = run(scene_file, law, steps, None);
    let second = run(scene_file, law, steps, Some(steps / 2));
    assert_eq!(first.hash, second.hash, "{law:?}");
    assert_eq!(first.counts.recovered.load(Ordering::Relaxed), 0, "{law:?}");
    assert!(first.contact_steps > steps / 50, "{law:?}: {}", first.contact_steps);
    assert!(first.greatest_force_n < 1e3, "{law:?}: {}", first.greatest_force_n);
    let limited = first.counts.limited.load(Ordering::Relaxed);
    if law == KernelLaw::Linear {
        assert_eq!(limited, 0);
        assert!(first.drift_m < 1e-9, "{}", first.drift_m);
    } else {
        // St Venant-Kirchhoff has further states of rest, with tetrahedra inside out.
        assert!(first.drift_m < 1e-9 || first.n_inverted > 0, "{}", first.drift_m);
    }
    format!(
        "| {law:?} | {steps} | {} | {:.2} | {:.2e} | {} | {limited} | `{}` |\n",
        first.contact_steps,
        first.greatest_force_n,
        1e3 * first.drift_m,
        first.n_inverted,
        first.hash
    )
}
