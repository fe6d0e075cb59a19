//! Contact by constraints: friction on an incline, stacks at rest, energy of a bounce.

use super::{Experiment, Outcome};
use glisson::contact::bodies::{BodyParams, CollidingBodies, ContactParams, Obstacle};
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{DeformableModel, DynamicBody, Rayleigh};

const SIDE_M: f64 = 0.1;
const DENSITY: f64 = 1000.0;
const G: f64 = 9.81;

fn var(name: &str, default: f64) -> f64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(default)
}

fn explicit(mesh: &TetMesh, beta_s: f64, alpha: f64, stretch: f64) -> anyhow::Result<(ExplicitKernel, f64)> {
    let material = [LinearElastic::from_young_poisson(var("E", 20e3), 0.45, DENSITY)?];
    let body = DynamicBody {
        damping: Rayleigh { mass_per_s: alpha, stiffness_s: beta_s },
        ..DynamicBody::new(mesh, DENSITY)
    };
    let params = ExplicitKernelParams {
        largest_stretch: stretch,
        ..ExplicitKernelParams::new(body, KernelLaw::NeoHookeLog, &material)
    };
    let stable = ExplicitKernel::stable_step(&params)?;
    let step_s = 0.9 * stable.step_s;
    let body = DynamicBody { time_step_s: step_s, ..params.body };
    Ok((ExplicitKernel::build(&ExplicitKernelParams { body, ..params })?, step_s))
}

fn body(mesh: &TetMesh, model: Box<dyn DeformableModel>, friction: f64) -> anyhow::Result<BodyParams> {
    let topology = Topology::build(mesh)?;
    let (surface, nodes) = surface_of(&topology, mesh);
    Ok(BodyParams { model, surface, nodes, friction })
}

fn center_m(mesh: &TetMesh, model: &dyn DeformableModel) -> DVec3 {
    let positions = model.state().positions_m;
    let (mut sum, mut volume) = (DVec3::ZERO, 0.0);
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let v = mesh.tet_volume_m3(glisson::mesh::TetId::from_index(t));
        sum += nodes.iter().map(|n| positions[n.index()]).sum::<DVec3>() * (v / 4.0);
        volume += v;
    }
    sum / volume
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let cells = var("CELLS", 6.0) as usize;
    let mut mesh = box_of_five([cells; 3], DVec3::splat(SIDE_M));
    for p in &mut mesh.positions_m {
        p.z += 1e-4;
    }
    let mu: f64 = var("MU", 0.5);
    let ratio = var("RATIO", 0.98);
    let theta = (ratio * mu).atan();
    let g = DVec3::new(theta.sin(), 0.0, -theta.cos()) * G;
    let (model, step_s) = explicit(&mesh, var("BETA", 2e-4), var("ALPHA", 0.0), var("STRETCH", 1.2))?;
    let dt = step_s * var("K", 1.0);
    println!("{} tets, step {step_s:e} dt {dt:e}", mesh.tetrahedra.len());
    let bodies = vec![body(&mesh, Box::new(model), mu)?];
    let plane = vec![Obstacle::half_space(DVec3::ZERO, DVec3::Z, mu)];
    let mut world = CollidingBodies::new(bodies, plane, &ContactParams::default())?;
    let (ramp, end) = (var("RAMP", 2.0), var("END", 10.0));
    let n = (end / dt) as usize;
    let started = std::time::Instant::now();
    let mut sweeps = 0u64;
    let every = (n / 20).max(1);
    for i in 0..n {
        let t = i as f64 * dt;
        if t < ramp + 0.1 {
            let s = (t / ramp).min(1.0);
            let tilt = if var("TILT", 0.0) > 0.0 { g } else { g };
            world.model_mut(0).set_gravity(tilt * (s * s * (3.0 - 2.0 * s)));
        }
        world.step(dt);
        sweeps += u64::from(world.report().n_sweeps);
        if i % every == 0 {
            let c = center_m(&mesh, world.model(0));
            let r = world.report();
            println!(
                "{t:.3} x {:.6} mm z {:.6} mm K {:.3e} slip {:.1e} pen {:.1e} F {:.4} sweeps {} pressed {} res {:.1e}",
                (c.x - 0.05) * 1e3,
                (c.z - 0.05) * 1e3,
                world.model(0).report().kinetic_energy_j,
                r.slip_m / dt,
                r.penetration_m,
                world.force_on_n(0),
                r.n_sweeps,
                r.n_pressed,
                r.residual
            );
        }
    }
    println!(
        "{n} steps, {:?} us a step, {} sweeps a step",
        started.elapsed().as_secs_f64() * 1e6 / n as f64,
        sweeps as f64 / n as f64
    );
    Ok(Outcome::from(vec![Experiment::at_most("x", "x", 0.0, 1.0)]))
}
