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
use glisson::mesh::box_mesh::cube_of_five;
use glisson::mesh::topology::{Topology, surface_of};
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::{Constraints, DynamicBody, ImposedDisplacement, Rayleigh};
use glisson::record::snapshot::{BleedingSnapshot, Snapshot};

use super::colliding::{N_FRAMES, rocking_cubes};
use super::thesis_cube::{CELLS_288, CELLS_296, thesis_cube};
use super::{Case, Prepared, Settings};
use glisson_protocol::frames::{Pace, snapshot_frame};

const STEP: &str = "soft cubes of 625 tetrahedra and 300 triangles pressed together: contacts, geometric response, deformation";
const CONTACT: &str = "rocking cubes of 300 triangles: contacts and geometric response, without deformation";
const TWO: &str =
    "two soft cubes of 368 tetrahedra pressed together, 592 triangles: contacts, response and deformation";
const THESIS: &str = "soft cubes of 360 tetrahedra and 288 triangles pressed together: contacts, geometric response, deformation";
const DISPLAY: &str = "the same with the frame for the viewer in every step";

pub(super) const CASES: &[Case] = &[
    case("cubes_response", STEP, &[1, 2, 4], |s| steps(s, CubeMesh::Regular, GEOMETRIC)),
    case("cubes_353_response", THESIS, &[1, 2, 4], |s| steps(s, CubeMesh::Thesis, GEOMETRIC)),
    case("cubes_353_displayed", DISPLAY, &[1, 2, 4], displayed_steps),
    case("cubes_contact", CONTACT, &[4], |s| Ok(contact_alone(s))),
    case("response_596_penalty", TWO, &[2], |s| steps(s, CubeMesh::ThesisPair, PENALTY)),
    case("response_596_geometric", TWO, &[2], |s| steps(s, CubeMesh::ThesisPair, GEOMETRIC)),
    case("response_596_impulse", TWO, &[2], |s| steps(s, CubeMesh::ThesisPair, IMPULSE)),
];

/// Which cubes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CubeMesh {
    /// Of five tetrahedra a cell: 625 and 300 triangles.
    Regular,
    /// Of 360 tetrahedra and 288 triangles; the thesis: 353 and 288.
    Thesis,
    /// Of 368 tetrahedra and 296 triangles, so that two have 592; the thesis: 596.
    ThesisPair,
}

impl CubeMesh {
    fn mesh(self) -> TetMesh {
        match self {
            Self::Regular => cube_of_five(6, CUBE_M),
            Self::Thesis => thesis_cube(CELLS_288, CUBE_M),
            Self::ThesisPair => thesis_cube(CELLS_296, CUBE_M),
        }
    }

    /// Tetrahedra and surface triangles.
    fn counts(self) -> [usize; 2] {
        match self {
            Self::Regular => [625, 300],
            Self::Thesis => [360, 288],
            Self::ThesisPair => [368, 296],
        }
    }
}

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
    /// What a viewer would be shown.
    shown: Snapshot,
    /// Body and node of each vertex that is shown.
    shown_nodes: Vec<(usize, NodeId)>,
}

impl PressedCubes {
    /// `n` cubes in rows of two, askew, 0.2 mm apart. A single one is free.
    pub(crate) fn new(n: usize, cube: CubeMesh, kind: ResponseKind) -> anyhow::Result<Self> {
        let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?;
        let (mut bodies, mut far_sides, mut shown_nodes) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..n {
            let (column, row) = ((k % 2) as f64, (k / 2) as f64);
            let aside_m = DVec3::new(0.0, 0.003, 0.002) * column + DVec3::new(0.002, 0.0, 0.003) * row;
            let origin_m = DVec3::new(column, row, 0.0) * (CUBE_M + 2e-4) + aside_m;
            let mut mesh = cube.mesh();
            let (_, on_surface) = surface_of(&Topology::build(&mesh)?, &mesh);
            shown_nodes.extend(on_surface.into_iter().map(|node| (k, node)));
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
        let shown = Snapshot {
            step: 0,
            time_s: 0.0,
            topology_version: 0,
            positions_m: vec![DVec3::ZERO; shown_nodes.len()],
            tools: Vec::new(),
            bleeding: BleedingSnapshot::default(),
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
        };
        Ok(Self { bodies, far_sides, pressed_s: 0.0, shown, shown_nodes })
    }

    /// What the display costs this thread: the frame with the vertices of all surfaces, which a viewer draws elsewhere.
    pub(crate) fn frame(&mut self) -> Vec<u8> {
        for (place_m, &(body, node)) in self.shown.positions_m.iter_mut().zip(&self.shown_nodes) {
            *place_m = self.bodies.model(body).state().positions_m[node.index()];
        }
        snapshot_frame(&self.shown, &Pace::default(), None, None)
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

fn steps(settings: Settings, cube: CubeMesh, kind: ResponseKind) -> anyhow::Result<Prepared> {
    pressed(settings, cube, kind, |cubes| cubes.step(CUBES_STEP_S))
}

fn displayed_steps(settings: Settings) -> anyhow::Result<Prepared> {
    pressed(settings, CubeMesh::Thesis, GEOMETRIC, |cubes| {
        cubes.step(CUBES_STEP_S);
        black_box(cubes.frame());
    })
}

/// What is timed on cubes after 0.2 s.
fn pressed(
    settings: Settings,
    cube: CubeMesh,
    kind: ResponseKind,
    timed: impl Fn(&mut PressedCubes) + Send + 'static,
) -> anyhow::Result<Prepared> {
    let n_cubes = settings.size.clamp(1, 4);
    let mut cubes = PressedCubes::new(n_cubes, cube, kind)?;
    for _ in 0..400 {
        cubes.step(CUBES_STEP_S);
    }
    let n_contacts = cubes.bodies.report().n_contacts;
    let [n_tets, n_triangles] = cube.counts().map(|n| n * n_cubes);
    let note = format!("{n_triangles} triangles, {n_contacts} contacts after 0.2 s");
    let run = Box::new(move || timed(&mut cubes));
    Ok(Prepared { size: n_tets, isa: "portable", precision: "f64", work: None, note, run })
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
            let mut cubes = PressedCubes::new(2, CubeMesh::ThesisPair, kind).unwrap();
            for _ in 0..300 {
                cubes.step(CUBES_STEP_S);
            }
            assert!(cubes.frame().len() > 12 * 300);
            let bodies = &cubes.bodies;
            let report = bodies.report();
            assert!(report.n_contacts > 30 && report.n_dropped == 0, "{kind:?}: {report:?}");
            assert!(bodies.model(1).state().positions_m.iter().all(|p| p.is_finite()));
        }
        assert!(contact_and_response(4)() > 50);
    }
}
