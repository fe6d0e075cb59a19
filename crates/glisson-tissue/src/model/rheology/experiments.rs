//! The experiments of seed `000` ch. 2 and 3 on the bench, as functions that return numbers.

use super::{
    IndentationTest, PlateContact, PlateOutcome, PlateTest, indent, measured_modulus_pa, n_inverted,
    press_between_plates,
};
use crate::material::LinearElastic;
use crate::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use crate::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use crate::model::tensor_mass::TensorMass;
use crate::model::{
    Constraints, DeformableModel, DynamicBody, ExplicitError, Integration, NodalForce, Rayleigh,
};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::box_mesh::{cube_of_five, irregular_cube};
use glisson_mesh::mesh::edit::{EditError, EditableMesh};
use glisson_mesh::mesh::topology::{EntityCounts, TopologyError};
use glisson_mesh::mesh::{NodeId, TetMesh};

/// Side of the seed's cubes [m].
pub const SIDE_M: f64 = 0.05;

/// Young's modulus of the seed's cubes [Pa].
pub const YOUNG_MODULUS_PA: f64 = 20_000.0;

/// Density of the seed's cubes [kg/m3].
pub const DENSITY_KG_PER_M3: f64 = 1000.0;

/// Poisson's ratio; the thesis gives none.
pub const POISSON_RATIO: f64 = 0.3;

/// Viscosity of the thesis' fig. 3.8, "1e-3", read as g/(mm3 s) [kg/(m3 s)].
pub const VISCOSITY_KG_PER_M3_S: f64 = 1000.0;

/// Why an experiment could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// The body is impossible.
    #[error(transparent)]
    Body(#[from] ExplicitError),
    /// The material is impossible.
    #[error(transparent)]
    Material(#[from] crate::material::MaterialError),
    /// The mesh is not a valid body.
    #[error(transparent)]
    Topology(#[from] TopologyError),
    /// The mesh cannot be edited.
    #[error(transparent)]
    Edit(#[from] EditError),
    /// The mesh is unusable.
    #[error(transparent)]
    Solve(#[from] crate::solve::SolveError),
}

/// The seed's material.
///
/// # Errors
/// None for the constants above.
pub fn seed_material() -> Result<LinearElastic, ExperimentError> {
    Ok(LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?)
}

/// Force [N] that stretches the cube of St Venant-Kirchhoff material along one axis, the others free:
/// E/2 F (F^2 - 1) side^2 = 25 F (F^2 - 1) N, whatever Poisson's ratio (seed `000` eq. 3.75, 3.76, 3.79).
pub fn uniaxial_force_n(stretch: f64) -> f64 {
    0.5 * YOUNG_MODULUS_PA * stretch * (stretch * stretch - 1.0) * SIDE_M * SIDE_M
}

/// Uniaxial compression or traction of the cube between sliding plates (seed `000` s. 3.5.2 and 3.6.2).
#[derive(Clone, Copy, Debug)]
pub struct UniaxialParams {
    /// Nodes per side.
    pub n_nodes: usize,
    /// Viscosity c [kg/(m3 s)].
    pub viscosity_kg_per_m3_s: f64,
    /// Speed of the plate [m/s].
    pub speed_m_per_s: f64,
    /// Stretch at the end.
    pub last_stretch: f64,
    /// Evenly spaced readings between rest and the end.
    pub n_readings: usize,
}

/// Comparison with the exact curve.
#[derive(Clone, Debug)]
pub struct UniaxialOutcome {
    /// The readings of the bench.
    pub plates: PlateOutcome,
    /// Step [s].
    pub step_s: f64,
}

impl UniaxialOutcome {
    /// Largest distance [N] from the exact curve over the readings between rest and `stretch`.
    pub fn largest_error_to_n(&self, stretch: f64) -> f64 {
        let between = |s: f64| (s - 1.0).abs() <= (stretch - 1.0).abs() + 1e-9;
        let error_n = |r: &super::PlateReading| (r.force_n - uniaxial_force_n(r.stretch)).abs();
        self.plates.readings.iter().filter(|r| between(r.stretch)).map(error_n).fold(0.0, f64::max)
    }

    /// The stretch furthest from rest up to which every reading is within `tolerance_n`.
    pub fn agrees_to(&self, tolerance_n: f64) -> f64 {
        let readings = self.plates.readings.iter();
        let good = readings.take_while(|r| (r.force_n - uniaxial_force_n(r.stretch)).abs() <= tolerance_n);
        good.last().map_or(1.0, |r| r.stretch)
    }
}

/// Share of the stable step that the uniaxial tests take: traction to twice the length makes the material 5.5 times
/// as stiff and the stable step 2.3 times shorter.
const STEP_SHARE: f64 = 0.4;

/// Runs a uniaxial test of the extended mass-spring model, St Venant-Kirchhoff.
///
/// # Errors
/// [`ExperimentError`] when the parameters allow no model.
pub fn uniaxial(params: &UniaxialParams) -> Result<UniaxialOutcome, ExperimentError> {
    let mesh = cube_of_five(params.n_nodes, SIDE_M);
    let material = seed_material()?;
    let step_s = (STEP_SHARE * TensorMass::stable_step(&mesh, &material)?.step_s).min(1e-3);
    let mut model = ExtendedMassSpring::build(&ExtendedMassSpringParams {
        body: DynamicBody { time_step_s: step_s, ..DynamicBody::new(&mesh, material.density_kg_per_m3()) },
        law: EdgeLaw::StVenantKirchhoff,
        material: &material,
        viscosity_kg_per_m3_s: params.viscosity_kg_per_m3_s,
        integration: Integration::default(),
    })?;
    let n = params.n_readings;
    let stretches: Vec<f64> =
        (1..=n).map(|i| 1.0 + (params.last_stretch - 1.0) * i as f64 / n as f64).collect();
    let plates = press_between_plates(
        &mut model,
        &PlateTest {
            mesh: &mesh,
            axis: 2,
            contact: PlateContact::Sliding,
            density_kg_per_m3: DENSITY_KG_PER_M3,
            damping_per_s: 0.0,
            speed_m_per_s: params.speed_m_per_s,
            ramp_s: 1.0,
            step_s,
            stretches: &stretches,
            hold_s: 0.0,
        },
    );
    Ok(UniaxialOutcome { plates, step_s })
}

/// Measured moduli of a mass-spring cube.
#[derive(Clone, Copy, Debug)]
pub struct MassSpringCube {
    /// Name of the mesh.
    pub name: &'static str,
    /// Modulus that the thesis measured [Pa].
    pub published_pa: f64,
    /// Nodes, springs, tetrahedra.
    pub counts: [usize; 3],
    /// For plates that let nodes slide, then for plates that they stick to: modulus at 0.5 mm and at 12 mm [Pa].
    pub measured_pa: [[f64; 2]; 2],
    /// Tetrahedra inverted at 12 mm, for both.
    pub n_inverted: [usize; 2],
}

/// The four cubes of seed `000` s. 2.3.4, compressed by 12 mm until at rest. Weight is left out.
///
/// # Errors
/// [`ExperimentError`] when a cube allows no model.
pub fn mass_spring_cubes() -> Result<Vec<MassSpringCube>, ExperimentError> {
    let meshes = [
        ("irregular", 17_800.0, irregular_cube(SIDE_M, 1)),
        ("2 nodes a side", 22_100.0, cube_of_five(2, SIDE_M)),
        ("5 nodes a side", 22_400.0, cube_of_five(5, SIDE_M)),
        ("10 nodes a side", 18_900.0, cube_of_five(10, SIDE_M)),
    ];
    meshes.into_iter().map(|(name, published_pa, mesh)| mass_spring_cube(name, published_pa, &mesh)).collect()
}

/// One cube of [`mass_spring_cubes`].
///
/// # Errors
/// [`ExperimentError`] when the mesh allows no model.
pub fn mass_spring_cube(
    name: &'static str,
    published_pa: f64,
    mesh: &TetMesh,
) -> Result<MassSpringCube, ExperimentError> {
    let mut measured_pa = [[0.0; 2]; 2];
    let mut inverted = [0; 2];
    let mut n_springs = 0;
    for (i, contact) in [PlateContact::Sliding, PlateContact::Sticking].into_iter().enumerate() {
        let damping_per_s = 30.0;
        let build = |time_step_s: f64| {
            MassSpring::build(&MassSpringParams {
                body: DynamicBody {
                    damping: Rayleigh { mass_per_s: damping_per_s, stiffness_s: 0.0 },
                    time_step_s,
                    ..DynamicBody::new(mesh, DENSITY_KG_PER_M3)
                },
                young_modulus_pa: YOUNG_MODULUS_PA,
                masses: NodalMasses::VolumeWeighted,
                link_damping_n_s_per_m: 0.001,
                node_damping_n_s_per_m: 0.0,
                integration: Integration::default(),
            })
        };
        // The thesis' step is 0.1 ms, which is stable for these meshes; the model knows the longest stable one.
        let step_s = (0.5 * build(1e-4)?.stable_step_s()).min(1e-3);
        let mut model = build(step_s)?;
        n_springs = model.springs_n_per_m().count();
        let outcome = press_between_plates(
            &mut model,
            &PlateTest {
                mesh,
                axis: 2,
                contact,
                density_kg_per_m3: DENSITY_KG_PER_M3,
                damping_per_s,
                speed_m_per_s: 0.01,
                ramp_s: 0.1,
                step_s,
                stretches: &[1.0 - 0.5e-3 / SIDE_M, 1.0 - 12e-3 / SIDE_M],
                hold_s: 1.5,
            },
        );
        let area_m2 = SIDE_M * SIDE_M;
        let modulus_pa = |reading: usize| measured_modulus_pa(outcome.readings[reading], area_m2);
        measured_pa[i] = [modulus_pa(0), modulus_pa(2)];
        inverted[i] = outcome.readings[2].n_inverted;
    }
    let counts = [mesh.positions_m.len(), n_springs, mesh.tetrahedra.len()];
    Ok(MassSpringCube { name, published_pa, counts, measured_pa, n_inverted: inverted })
}

/// Report on a dropped cube.
#[derive(Clone, Copy, Debug)]
pub struct Drop {
    /// Largest slope of the cube's upper side against the ground after the impact [rad].
    pub largest_tilt_rad: f64,
    /// Slope at the end [rad].
    pub last_tilt_rad: f64,
    /// Tetrahedra inverted at the end.
    pub n_inverted: usize,
}

/// Steps of 0.1 ms: the fall, the impact and the rebound.
const DROP_STEPS: usize = 1000;

/// Drops the irregular cube from 2 mm on the ground (seed `000` s. 2.3.2, figs 2.5 and 2.6; the thesis gives no
/// height): a symmetric fall keeps the upper side level. The ground pushes each node of the lower side back with
/// a pressure in proportion to its depth and the node's share of the side.
///
/// # Errors
/// [`ExperimentError`] when the mesh allows no model.
pub fn drop_irregular_cube(masses: NodalMasses) -> Result<Drop, ExperimentError> {
    let mesh = irregular_cube(SIDE_M, 1);
    let step_s = 1e-4;
    let mut model = MassSpring::build(&MassSpringParams {
        body: DynamicBody {
            time_step_s: step_s,
            gravity_m_per_s2: DVec3::new(0.0, 0.0, -9.8),
            ..DynamicBody::new(&mesh, DENSITY_KG_PER_M3)
        },
        young_modulus_pa: YOUNG_MODULUS_PA,
        masses,
        link_damping_n_s_per_m: 0.005,
        node_damping_n_s_per_m: 0.0,
        integration: Integration::default(),
    })?;
    let height_m = 0.002;
    let raised_m: Vec<DVec3> = mesh.positions_m.iter().map(|p| *p + DVec3::Z * height_m).collect();
    model.take_over(&raised_m);
    let areas_m2 = lower_side_areas_m2(&mesh);
    // A layer of ground as thick as a fifth of the cube and of its stiffness.
    let stiffness_n_per_m3 = YOUNG_MODULUS_PA / (0.2 * SIDE_M);
    let upper: Vec<usize> =
        (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].z >= SIDE_M * (1.0 - 1e-9)).collect();
    let mut constraints = Constraints::default();
    let (mut largest_tilt_rad, mut last_tilt_rad) = (0.0_f64, 0.0);
    for _ in 0..DROP_STEPS {
        constraints.forces.clear();
        for &(n, area_m2) in &areas_m2 {
            let depth_m = -model.state().positions_m[n].z;
            if depth_m > 0.0 {
                let force_n = DVec3::Z * (stiffness_n_per_m3 * area_m2 * depth_m);
                constraints.forces.push(NodalForce { node: NodeId::from_index(n), force_n });
            }
        }
        model.apply(&constraints);
        model.step(step_s);
        last_tilt_rad = tilt_rad(model.state().positions_m, &upper);
        largest_tilt_rad = largest_tilt_rad.max(last_tilt_rad);
    }
    let n_inverted = n_inverted(&mesh, model.state().positions_m);
    Ok(Drop { largest_tilt_rad, last_tilt_rad, n_inverted })
}

/// Nodes of the side z = 0 with their share of its area.
fn lower_side_areas_m2(mesh: &TetMesh) -> Vec<(usize, f64)> {
    let mut areas_m2 = vec![0.0; mesh.positions_m.len()];
    for nodes in &mesh.tetrahedra {
        for opposite in 0..4 {
            let face = [1, 2, 3].map(|i| nodes[(opposite + i) % 4].index());
            let p = face.map(|n| mesh.positions_m[n]);
            if p.iter().all(|p| p.z.abs() < 1e-12) {
                let area_m2 = 0.5 * (p[1] - p[0]).cross(p[2] - p[0]).length();
                face.iter().for_each(|&n| areas_m2[n] += area_m2 / 3.0);
            }
        }
    }
    areas_m2.into_iter().enumerate().filter(|(_, area)| *area > 0.0).collect()
}

/// Angle between the ground and the plane through some points by least squares of their heights.
fn tilt_rad(positions_m: &[DVec3], nodes: &[usize]) -> f64 {
    let n = nodes.len() as f64;
    let middle = nodes.iter().map(|&i| positions_m[i]).sum::<DVec3>() / n;
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &i in nodes {
        let p = positions_m[i] - middle;
        xx += p.x * p.x;
        xy += p.x * p.y;
        yy += p.y * p.y;
        xz += p.x * p.z;
        yz += p.y * p.z;
    }
    let determinant = xx * yy - xy * xy;
    let (slope_x, slope_y) = ((yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant);
    libm::atan(libm::sqrt(slope_x * slope_x + slope_y * slope_y))
}

/// Force [N] and half-space modulus [Pa] of a punch of 14 mm radius, 1 mm deep, in the cube of 5 nodes per side; extended
/// mass-spring. (The thesis announces indentation and shows no result.)
///
/// # Errors
/// [`ExperimentError`] when the mesh allows no model.
pub fn indentation_of_cube() -> Result<[f64; 2], ExperimentError> {
    let mesh = cube_of_five(5, SIDE_M);
    let material = seed_material()?;
    let step_s = 1e-3_f64.min(STEP_SHARE * TensorMass::stable_step(&mesh, &material)?.step_s);
    let mut model = ExtendedMassSpring::build(&ExtendedMassSpringParams {
        body: DynamicBody {
            damping: Rayleigh { mass_per_s: 30.0, stiffness_s: 0.0 },
            time_step_s: step_s,
            ..DynamicBody::new(&mesh, material.density_kg_per_m3())
        },
        law: EdgeLaw::StVenantKirchhoff,
        material: &material,
        viscosity_kg_per_m3_s: 0.0,
        integration: Integration::default(),
    })?;
    let (radius_m, depth_m) = (0.014, 0.001);
    let test = IndentationTest { mesh: &mesh, axis: 2, radius_m, depth_m, press_s: 0.3, hold_s: 1.0, step_s };
    let outcome = indent(&mut model, &test);
    Ok([outcome.force_n, outcome.half_space_modulus_pa(&test, POISSON_RATIO)])
}

/// Floating-point operations of one evaluation of the forces on a mesh; an addition, a multiplication and each
/// half of a fused pair count one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ForceOperations {
    /// Sizes of the mesh.
    pub counts: EntityCounts,
    /// Linear tensor-mass: 3x3 products on vertices and edges.
    pub linear_tensor_mass: usize,
    /// St Venant-Kirchhoff tensor-mass: traversal of vertices, edges, triangles and tetrahedra (seed `002`,
    /// appendix B), with common factors of the nodes of an entity computed once.
    pub tensor_mass: usize,
    /// Extended mass-spring, St Venant-Kirchhoff, without viscosity.
    pub extended_mass_spring: usize,
}

/// Operations per entity, as [`ForceOperations`] counts them.
///
/// Linear tensor-mass: a vertex has one 3x3 product (15) added to a force (3), an edge two (36).
/// Non-linear part on a vertex: u.u and u.C (10), two factors (4), two scaled vectors and three sums (12): 26. Edge: three
/// dot products (15), three factors (20 + 11 + 11), twice four scaled vectors with their sums and the addition to
/// the force (2 x 25): 107. Triangle: six dot products (30), three factors (3 x 13 and 3 sums), three times four scaled
/// vectors (3 x 27): 153. Tetrahedron: six dot products (30), twelve factors (12), four times three scaled vectors with
/// sums (4 x 18): 114.
/// Extended mass-spring: an edge has its squared length less that of rest (9), and its force on two nodes (12); a
/// tetrahedron six rows of six (72).
const PER_ENTITY: OperationsPerEntity =
    OperationsPerEntity { linear: [18, 36, 0, 0], nonlinear: [26, 107, 153, 114], extended: [0, 21, 0, 72] };

struct OperationsPerEntity {
    linear: [usize; 4],
    nonlinear: [usize; 4],
    extended: [usize; 4],
}

/// Counts the operations of the three models on a mesh. The thesis (seed `000` s. 3.7) claims that extended
/// mass-spring is up to 100 times faster than tensor-mass.
///
/// # Errors
/// [`ExperimentError`] when the mesh is no mesh.
pub fn force_operations(mesh: &TetMesh) -> Result<ForceOperations, ExperimentError> {
    let counts = EditableMesh::new(mesh.clone())?.topology().live_counts();
    let entities = [counts.nodes, counts.edges, counts.triangles, counts.tets];
    let total = |per: [usize; 4]| entities.iter().zip(per).map(|(n, per)| n * per).sum::<usize>();
    let linear_tensor_mass = total(PER_ENTITY.linear);
    Ok(ForceOperations {
        counts,
        linear_tensor_mass,
        tensor_mass: linear_tensor_mass + total(PER_ENTITY.nonlinear),
        extended_mass_spring: total(PER_ENTITY.extended),
    })
}
