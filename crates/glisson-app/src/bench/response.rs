//! Cases of the local responses to contact: the cubes of seed 000 pressed together, and three responses on two of them.

use std::hint::black_box;

use glam::DVec3;
use glisson::contact::broad_phase::BroadPhaseKind;
use glisson::contact::response::Answer;
use glisson::contact::response::bodies::{RespondingBodies, RespondingBody, ResponseKind};
use glisson::contact::response::find::{ContactSearch, ContactSearchParams};
use glisson::contact::response::geometric::{self, GeometricParams};
use glisson::contact::response::impulse::ImpulseParams;
use glisson::contact::response::penalty::PenaltyParams;
use glisson::material::LinearElastic;
use glisson::mesh::NodeId;
use glisson::mesh::box_mesh::cube_of_five;
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{Constraints, DynamicBody, ImposedDisplacement, Rayleigh};

use super::colliding::{N_FRAMES, rocking_cubes};
use super::{Case, Prepared, Settings};

const STEP: &str = "soft cubes of 625 tetrahedra and 300 triangles pressed together: contacts, geometric response, deformation";
const CONTACT: &str = "rocking cubes of 300 triangles: contacts and geometric response, without deformation";
const TWO: &str = "two soft cubes pressed together, 600 triangles: contacts, response and deformation";

pub(super) const CASES: &[Case] = &[
    case("cubes_response", STEP, &[1, 2, 4], |s| steps(s.size.clamp(1, 4), GEOMETRIC)),
    case("cubes_contact", CONTACT, &[4], |s| Ok(contact_alone(s))),
    case("response_596_penalty", TWO, &[2], |s| steps(s.size.clamp(1, 4), PENALTY)),
    case("response_596_geometric", TWO, &[2], |s| steps(s.size.clamp(1, 4), GEOMETRIC)),
    case("response_596_impulse", TWO, &[2], |s| steps(s.size.clamp(1, 4), IMPULSE)),
];

const fn case(
    name: &'static str,
    about: &'static str,
    sizes: &'static [usize],
    prepare: fn(Settings) -> anyhow::Result<Prepared>,
) -> Case {
    Case { name, about, per: "step", sizes, parallel: false, prepare }
}

/// A spring for each touching vertex: a cube rests on some sixty of them, a few tenths of a millimetre apart.
pub(crate) const PENALTY: ResponseKind = ResponseKind::Penalty(PenaltyParams {
    damping_n_s_per_m: 0.05,
    friction: 0.5,
    ..PenaltyParams::linear(100.0, 1e-3)
});
pub(crate) const GEOMETRIC: ResponseKind = ResponseKind::Geometric(GeometricParams::sticking(0.0));
pub(crate) const IMPULSE: ResponseKind =
    ResponseKind::Impulse(ImpulseParams { rest_gap_m: 0.0, restitution: 0.0, friction: 0.5, n_sweeps: 1 });

/// Longest step of the cubes [s].
pub(crate) const CUBES_STEP_S: f64 = 5e-4;
/// Edge of a cube [m]; seed 000, s. 2.3.4, also for modulus and density.
const CUBE_M: f64 = 0.05;
const YOUNG_MODULUS_PA: f64 = 20e3;
const POISSON_RATIO: f64 = 0.3;
const DENSITY_KG_PER_M3: f64 = 1000.0;
/// More than a vertex moves in a step, less than an edge.
const MARGIN_M: f64 = 1.5e-3;
/// How far the far side of each cube is pressed in, and for how long [m, s].
const PRESS_M: f64 = 7e-4;
const PRESS_S: f64 = 0.1;

fn search(n_cubes: usize) -> ContactSearchParams {
    ContactSearchParams {
        kind: BroadPhaseKind::Hierarchy,
        margin_m: MARGIN_M,
        self_collision: true,
        pair_capacity: 64 * 300 * n_cubes,
    }
}

/// Cubes whose far sides are pressed towards each other.
pub(crate) struct PressedCubes {
    pub(crate) bodies: RespondingBodies,
    /// The far side of each cube, and which way it goes.
    far_sides: Vec<(Vec<NodeId>, DVec3)>,
    pressed_s: f64,
}

impl PressedCubes {
    /// `n` cubes in rows of two, askew, 0.2 mm apart. A single one is free.
    pub(crate) fn new(n: usize, kind: ResponseKind) -> anyhow::Result<Self> {
        let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?;
        let (mut bodies, mut far_sides) = (Vec::new(), Vec::new());
        for k in 0..n {
            let (column, row) = ((k % 2) as f64, (k / 2) as f64);
            let aside_m = DVec3::new(0.0, 0.003, 0.002) * column + DVec3::new(0.002, 0.0, 0.003) * row;
            let origin_m = DVec3::new(column, row, 0.0) * (CUBE_M + 2e-4) + aside_m;
            let mut mesh = cube_of_five(6, CUBE_M);
            let far_x_m = CUBE_M * column;
            let far = |i: &usize| (mesh.positions_m[*i].x - far_x_m).abs() < 1e-9;
            let nodes = (0..mesh.positions_m.len()).filter(far).map(NodeId::from_index).collect();
            // Rows press on each other as well, if there is more than one.
            let across = if n > 2 { 1.0 - 2.0 * row } else { 0.0 };
            far_sides.push((nodes, DVec3::new(1.0 - 2.0 * column, across, 0.0) * PRESS_M));
            mesh.positions_m.iter_mut().for_each(|p| *p += origin_m);
            let body = DynamicBody {
                damping: Rayleigh::of_mass(20.0),
                time_step_s: CUBES_STEP_S,
                ..DynamicBody::new(&mesh, DENSITY_KG_PER_M3)
            };
            let materials = std::slice::from_ref(&material);
            let params = ExplicitKernelParams::new(body, KernelLaw::StVenantKirchhoff, materials);
            let model = Box::new(ExplicitKernel::build(&params)?);
            bodies.push(RespondingBody { mesh, model });
        }
        if n == 1 {
            far_sides.clear();
        }
        let bodies = RespondingBodies::new(bodies, kind, &search(n))?;
        Ok(Self { bodies, far_sides, pressed_s: 0.0 })
    }

    pub(crate) fn step(&mut self, step_s: f64) {
        if self.pressed_s < PRESS_S {
            self.pressed_s += step_s;
            let share = (self.pressed_s / PRESS_S).min(1.0);
            for (body, (nodes, way_m)) in self.far_sides.iter().enumerate() {
                let held =
                    |node: &NodeId| ImposedDisplacement { node: *node, displacement_m: *way_m * share };
                let displacements = nodes.iter().map(held).collect();
                self.bodies.set_constraints(body, &Constraints { displacements, forces: Vec::new() });
            }
        }
        self.bodies.step(step_s);
    }
}

fn steps(n_cubes: usize, kind: ResponseKind) -> anyhow::Result<Prepared> {
    let mut cubes = PressedCubes::new(n_cubes, kind)?;
    for _ in 0..400 {
        cubes.step(CUBES_STEP_S);
    }
    let n_contacts = cubes.bodies.report().n_contacts;
    Ok(Prepared {
        size: 625 * n_cubes,
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!("{} triangles, {n_contacts} contacts after 0.2 s", 300 * n_cubes),
        run: Box::new(move || cubes.step(CUBES_STEP_S)),
    })
}

/// Contacts and response on prescribed motions.
fn contact_alone(settings: Settings) -> Prepared {
    let n_cubes = settings.size.clamp(1, 4);
    let mut step = contact_and_response(n_cubes);
    let all: Vec<usize> = (0..N_FRAMES).map(|_| step()).collect();
    Prepared {
        size: 300 * n_cubes,
        isa: "portable",
        precision: "f64",
        work: None,
        note: format!("triangles; {} contacts a step", all.iter().sum::<usize>() / N_FRAMES),
        run: Box::new(move || {
            step();
        }),
    }
}

/// A step of it; how many contacts there were.
pub(crate) fn contact_and_response(n_cubes: usize) -> impl FnMut() -> usize + Send {
    let cubes = rocking_cubes(n_cubes);
    let n = cubes.frames_m[0].len();
    let mut search =
        ContactSearch::new(&search(n_cubes), &cubes.frames_m[0], &cubes.triangles, &cubes.body_of);
    let mut contacts = Vec::with_capacity(n);
    let (mut velocities, mut answer) = (vec![DVec3::ZERO; n], Answer::none(n));
    let inverse_mass_per_kg = vec![DVec3::splat(1e3); n];
    let params = GeometricParams::sticking(0.0);
    let mut frame = 0;
    move || {
        let next = (frame + 1) % N_FRAMES;
        let (from_m, to_m) = (&cubes.frames_m[frame], &cubes.frames_m[next]);
        for (v, (a, b)) in velocities.iter_mut().zip(from_m.iter().zip(to_m)) {
            *v = (*b - *a) / CUBES_STEP_S;
        }
        frame = next;
        search.find_into(black_box(to_m), &mut contacts);
        answer.clear();
        geometric::respond(&params, &contacts, &inverse_mass_per_kg, &mut velocities, &mut answer);
        black_box(&answer);
        contacts.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressed_cubes_stay_pressed_and_whole() {
        for kind in [PENALTY, GEOMETRIC, IMPULSE] {
            let mut cubes = PressedCubes::new(2, kind).unwrap();
            for _ in 0..300 {
                cubes.step(CUBES_STEP_S);
            }
            let bodies = &cubes.bodies;
            let report = bodies.report();
            assert!(report.n_contacts > 30 && report.n_dropped == 0, "{kind:?}: {report:?}");
            assert!(bodies.model(1).state().positions_m.iter().all(|p| p.is_finite()));
        }
        assert!(contact_and_response(4)() > 50);
    }
}
