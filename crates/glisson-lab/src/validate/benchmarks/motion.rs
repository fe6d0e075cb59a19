//! The dynamic benchmarks: the twisting column, and the step at which explicit dynamics becomes unstable.

use super::bodies::mapped_box;
use super::cases::Tetrahedra;
use glisson::material::{LinearElastic, NeoHookeLog};
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::model::tensor_mass::TensorMass;
use glisson::solve::integrators::{EquationsOfMotion, FixedPoint, Integrator, Motion, Scheme};
use glisson::solve::{ElasticBody, MeshEdges, SmoothedBody, StiffnessTensors, add_gravity_forces};

/// dW/du of a body at displacements, into the last argument.
type Forces<'a> = Box<dyn Fn(&[DVec3], &mut [DVec3]) + 'a>;

/// Lumped masses on elastic forces.
struct Free<'a> {
    rest_m: &'a [DVec3],
    mass_kg: Vec<f64>,
    forces: Forces<'a>,
    displacement_m: Vec<DVec3>,
}

impl<'a> Free<'a> {
    fn new(mesh: &'a TetMesh, material: &LinearElastic, forces: Forces<'a>) -> Self {
        let displacement_m = vec![DVec3::ZERO; mesh.positions_m.len()];
        Self { rest_m: &mesh.positions_m, mass_kg: lumped_kg(mesh, material), forces, displacement_m }
    }
}

impl EquationsOfMotion for Free<'_> {
    fn accelerations_into(&mut self, positions_m: &[DVec3], _: &[DVec3], accelerations: &mut [DVec3]) {
        for (u, (x, rest)) in self.displacement_m.iter_mut().zip(positions_m.iter().zip(self.rest_m)) {
            *u = *x - *rest;
        }
        (self.forces)(&self.displacement_m, accelerations);
        for (a, m) in accelerations.iter_mut().zip(&self.mass_kg) {
            *a /= -m;
        }
    }
}

/// A body in motion by central differences, undamped.
struct Moving<'a> {
    equations: Free<'a>,
    integrator: Integrator,
    /// Whether each node is free.
    moves: Vec<bool>,
    damping_per_s: Vec<f64>,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
}

impl<'a> Moving<'a> {
    /// At rest and free.
    fn new(equations: Free<'a>) -> Self {
        let n_nodes = equations.rest_m.len();
        Self {
            integrator: Integrator::new(Scheme::CentralDifferences, FixedPoint::default(), n_nodes),
            moves: vec![true; n_nodes],
            damping_per_s: vec![0.0; n_nodes],
            positions_m: equations.rest_m.to_vec(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            equations,
        }
    }

    fn step(&mut self, step_s: f64) {
        let mut motion = Motion {
            positions_m: &mut self.positions_m,
            velocities_m_per_s: &mut self.velocities_m_per_s,
            moves: &self.moves,
            damping_per_s: &self.damping_per_s,
        };
        self.integrator.step(&mut self.equations, &mut motion, step_s);
    }

    /// Kinetic energy at such velocities [J].
    fn kinetic_j(&self, velocities_m_per_s: &[DVec3]) -> f64 {
        let nodes = self.equations.mass_kg.iter().zip(velocities_m_per_s);
        nodes.map(|(m, v)| 0.5 * m * v.length_squared()).sum::<f64>()
    }

    /// Angular momentum about the origin at such positions and velocities [kg m2/s].
    fn angular_momentum(&self, positions_m: &[DVec3], velocities_m_per_s: &[DVec3]) -> DVec3 {
        let nodes = self.equations.mass_kg.iter().zip(positions_m.iter().zip(velocities_m_per_s));
        nodes.map(|(m, (x, v))| x.cross(*v) * *m).sum()
    }
}

/// A quarter of each tetrahedron's mass at its corners.
fn lumped_kg(mesh: &TetMesh, material: &LinearElastic) -> Vec<f64> {
    let mut weight = vec![DVec3::ZERO; mesh.positions_m.len()];
    add_gravity_forces(mesh, material, DVec3::X, &mut weight);
    weight.into_iter().map(|w| w.x).collect()
}

/// What became of the twisting column.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Twist {
    pub(super) n_nodes: usize,
    pub(super) n_steps: usize,
    /// Largest change of the total energy over the initial one.
    pub(super) energy_drift: f64,
    /// Largest change of the angular momentum over the initial one; of a held column that of no interest.
    pub(super) momentum_drift: f64,
    /// Largest rotation of the top about the axis [rad].
    pub(super) largest_rad: f64,
    pub(super) any_inverted: bool,
}

/// How far a corner of the column's top has turned about the axis.
struct Turn {
    corner: usize,
    /// Of the corner at the last look, between -pi and pi, and in all [rad].
    last_rad: f64,
    angle_rad: f64,
}

impl Turn {
    fn of(rest_m: &[DVec3]) -> Self {
        let corner = rest_m.iter().position(|p| p.y > 5.999 && p.x > 0.499 && p.z > 0.499);
        let corner = corner.expect("a corner on top");
        Self { corner, last_rad: std::f64::consts::FRAC_PI_4, angle_rad: 0.0 }
    }

    /// The whole angle now [rad].
    fn follow(&mut self, positions_m: &[DVec3]) -> f64 {
        let at_rad = positions_m[self.corner].z.atan2(positions_m[self.corner].x);
        let turn = at_rad - self.last_rad;
        self.angle_rad += turn - std::f64::consts::TAU * (turn / std::f64::consts::TAU).round();
        self.last_rad = at_rad;
        self.angle_rad
    }
}

/// Velocity of the twisting column where it begins [m/s].
fn twisting_m_per_s(p: &DVec3) -> DVec3 {
    let rate_per_s = 105.0 * (std::f64::consts::PI * p.y / 12.0).sin();
    DVec3::new(p.z, 0.0, -p.x) * rate_per_s
}

/// B9: the column of 1 x 6 x 1 m with `n` cells across, its foot held or free, twisting for `end_s`.
pub(super) fn twisting_column(
    n: usize,
    is_held: bool,
    kind: Tetrahedra,
    end_s: f64,
) -> anyhow::Result<Twist> {
    let mesh = mapped_box([n, 6 * n, n], |p| DVec3::new(p.x - 0.5, 6.0 * p.y, p.z - 0.5));
    let material = LinearElastic::from_young_poisson(17e6, 0.495, 1100.0)?;
    let laws = [NeoHookeLog::from(&material)];
    let edges = MeshEdges::of_mesh(&mesh)?;
    let plain = ElasticBody::new(&mesh, &edges, &laws)?;
    let smoothed = match kind {
        Tetrahedra::Smoothed(smoothing) => Some(SmoothedBody::new(&mesh, &laws, smoothing)?),
        Tetrahedra::Plain => None,
    };
    let forces: Forces<'_> = match &smoothed {
        Some(body) => Box::new(|u, f| body.force_into(u, f)),
        None => Box::new(|u, f| plain.force_into(u, f)),
    };
    let energy_j = |u: &[DVec3]| smoothed.as_ref().map_or_else(|| plain.energy_j(u), |body| body.energy_j(u));
    // Averaging only lowers frequencies at rest; half of the step leaves room for stiffening.
    let h_s = 0.5 * TensorMass::stable_step(&mesh, &material)?.step_s;
    let n_steps = (end_s / h_s).ceil() as usize;
    let mut column = Moving::new(Free::new(&mesh, &material, forces));
    column.moves = mesh.positions_m.iter().map(|p| !(is_held && p.y == 0.0)).collect();
    column.velocities_m_per_s = mesh.positions_m.iter().map(twisting_m_per_s).collect();
    let initial_j = column.kinetic_j(&column.velocities_m_per_s);
    let initial_momentum = column.angular_momentum(&column.positions_m, &column.velocities_m_per_s);
    let mut turn = Turn::of(&mesh.positions_m);
    let mut twist = Twist { n_nodes: mesh.positions_m.len(), n_steps, ..Twist::default() };
    for step in 0..n_steps {
        let (before_m, before) = (column.positions_m.clone(), column.velocities_m_per_s.clone());
        column.step(h_s);
        twist.largest_rad = twist.largest_rad.max(turn.follow(&column.positions_m).abs());
        if step > 0 && step % SAMPLE == 0 {
            // Velocities stand between the steps: their mean belongs to the positions before this one.
            let pairs = before.iter().zip(&column.velocities_m_per_s);
            let mean: Vec<DVec3> = pairs.map(|(a, b)| (*a + *b) * 0.5).collect();
            let u_m: Vec<DVec3> = before_m.iter().zip(&mesh.positions_m).map(|(x, r)| *x - *r).collect();
            let now_j = column.kinetic_j(&mean) + energy_j(&u_m);
            twist.energy_drift = twist.energy_drift.max((now_j / initial_j - 1.0).abs());
            let change = column.angular_momentum(&before_m, &before) - initial_momentum;
            twist.momentum_drift = twist.momentum_drift.max(change.length() / initial_momentum.length());
            twist.any_inverted |= plain.first_inverted(&u_m).is_some();
        }
    }
    Ok(twist)
}

/// Steps between two looks at the energy.
const SAMPLE: usize = 10;

/// What the critical step of a block of 2 mm cells is.
#[derive(Clone, Copy, Debug)]
pub(super) struct CriticalStep {
    /// The step proven stable [s].
    pub(super) stable_s: f64,
    /// The estimate edge over wave speed [s].
    pub(super) edge_over_speed_s: f64,
    /// Growth of a random motion in [`GROWTH_STEPS`] steps at 0.9 and 1.2 times the stable step.
    pub(super) growth: [f64; 2],
}

/// Far beyond what a motion that grows by a thousandth a step needs to show.
const GROWTH_STEPS: usize = 4000;

/// B11: central differences of a linear free block of 2 mm cells; E 3 kPa, nu 0.49, 1000 kg/m3.
pub(super) fn critical_step() -> anyhow::Result<CriticalStep> {
    let mesh = box_of_five([6; 3], DVec3::splat(0.012));
    let material = LinearElastic::from_young_poisson(3000.0, 0.49, 1000.0)?;
    let edges = MeshEdges::of_mesh(&mesh)?;
    let tensors = StiffnessTensors::assemble(&mesh, &edges, &material)?;
    let stable_s = TensorMass::stable_step(&mesh, &material)?.step_s;
    let modulus_pa = material.lambda_pa() + 2.0 * material.mu_pa();
    let speed_m_per_s = (modulus_pa / material.density_kg_per_m3()).sqrt();
    let growth = [0.9, 1.2].map(|factor| {
        let forces: Forces<'_> = Box::new(|u, f| tensors.force_into(&edges, u, f));
        let mut block = Moving::new(Free::new(&mesh, &material, forces));
        let mut random = glisson::math::SeededRandom::new(1);
        for p in &mut block.positions_m {
            *p += DVec3::new(random.normal(), random.normal(), random.normal()) * 1e-6;
        }
        let largest_m =
            |x: &[DVec3]| x.iter().zip(&mesh.positions_m).map(|(x, r)| x.distance(*r)).fold(0.0, f64::max);
        let initial_m = largest_m(&block.positions_m);
        let mut growth: f64 = 1.0;
        for _ in 0..GROWTH_STEPS {
            block.step(factor * stable_s);
            growth = growth.max(largest_m(&block.positions_m) / initial_m);
            if growth > BLOWN_UP {
                break;
            }
        }
        growth
    });
    Ok(CriticalStep { stable_s, edge_over_speed_s: 2e-3 / speed_m_per_s, growth })
}

/// A motion that has grown so much will not come back.
pub(super) const BLOWN_UP: f64 = 1e6;
