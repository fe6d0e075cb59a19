//! Bodies, models and equilibria that the experiments on tensor-mass models share.
//!
//! The seeds give Lame's constants only up to a factor (`002` s. 5: lambda = 4 mu, in units that fit no tissue), so
//! mu is 1 kPa here; equilibria depend on force over mu alone.

use anyhow::Context;
use glisson::image::labels::{Parts, mask_volume_m3};
use glisson::image::phantom::{PhantomParams, generate as generate_phantom};
use glisson::material::{LinearElastic, Material};
use glisson::math::{DMat3, DVec3, tetrahedron_volume_m3};
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::topology::Topology;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::nonlinear_tensor_mass::{
    NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams, TetLaw,
};
use glisson::model::tensor_mass::{TensorMass, TensorMassParams};
use glisson::model::{
    Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, NodalForce, Rayleigh,
};
use glisson::solve::{
    BoundaryConditions, NonlinearProblem, NonlinearSettings, NonlinearSolution, StaticProblem,
    solve_nonlinear, solve_static,
};
use glisson::surface::TriMesh;
use glisson::surface::extract::{SurfaceParams, surface_of_mask};
use std::sync::{Mutex, PoisonError};

/// Shear modulus [Pa].
pub(crate) const MU_PA: f64 = 1_000.0;
/// lambda = 4 mu (seed `002`, s. 5): a Poisson's ratio of 0.4.
pub(crate) const LAMBDA_PA: f64 = 4.0 * MU_PA;
/// Only the time that motions take depends on it [kg/m3].
const DENSITY_KG_PER_M3: f64 = 1_000.0;
/// Share of the stable step that the models take.
const STEP_SHARE: f64 = 0.9;
/// Principal stretches up to which the non-linear models' stable step holds.
const LARGEST_STRETCH: f64 = 1.5;
/// Sides of the polygons that stand for circles.
const N_AROUND: u32 = 96;

/// The seeds' material.
pub(crate) fn material() -> anyhow::Result<LinearElastic> {
    Ok(LinearElastic::from_lame(LAMBDA_PA, MU_PA, DENSITY_KG_PER_M3)?)
}

/// A standing cylinder's surface, its base at z = 0.
fn cylinder_surface(radius_m: f64, height_m: f64) -> TriMesh {
    let mut surface = TriMesh::default();
    for z_m in [0.0, height_m] {
        for i in 0..N_AROUND {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(N_AROUND);
            surface.positions_m.push(DVec3::new(radius_m * angle.cos(), radius_m * angle.sin(), z_m));
        }
    }
    let (base, top) = (2 * N_AROUND, 2 * N_AROUND + 1);
    surface.positions_m.extend([DVec3::ZERO, DVec3::Z * height_m]);
    for i in 0..N_AROUND {
        let (a, b) = (i, (i + 1) % N_AROUND);
        let (c, d) = (a + N_AROUND, b + N_AROUND);
        surface.triangles.extend([[a, b, d], [a, d, c], [base, b, a], [top, c, d]]);
    }
    surface
}

/// A standing cylinder in about `n_tets` tetrahedra.
pub(crate) fn cylinder(radius_m: f64, height_m: f64, n_tets: usize) -> anyhow::Result<TetMesh> {
    let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: None };
    let (mesh, _) = generate(&cylinder_surface(radius_m, height_m), &params).context("meshing a cylinder")?;
    Ok(mesh)
}

/// The surface of a synthetic patient's liver, and the volume that a mesh of it should hold [m3].
pub(crate) fn liver_surface(params: &PhantomParams) -> anyhow::Result<(TriMesh, f64)> {
    let phantom = generate_phantom(params);
    let mask = phantom.labels.mask(&phantom.labels.select("liver", Parts::Included)?);
    let grid = &phantom.labels.grid;
    let (surface, _) = surface_of_mask(grid, &mask, &SurfaceParams::default())?;
    Ok((surface, mask_volume_m3(grid, &mask)))
}

/// What such a surface encloses in about `n_tets` tetrahedra.
pub(crate) fn filled((surface, volume_m3): &(TriMesh, f64), n_tets: usize) -> anyhow::Result<TetMesh> {
    let params = MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: Some(*volume_m3) };
    Ok(generate(surface, &params)?.0)
}

/// The synthetic patient's liver in about `n_tets` tetrahedra.
pub(crate) fn liver(n_tets: usize) -> anyhow::Result<TetMesh> {
    /// Made once.
    static SURFACE: Mutex<Option<(TriMesh, f64)>> = Mutex::new(None);
    let mut made = SURFACE.lock().unwrap_or_else(PoisonError::into_inner);
    if made.is_none() {
        *made = Some(liver_surface(&PhantomParams::default())?);
    }
    filled(made.as_ref().context("the surface was made above")?, n_tets)
}

/// Nodes whose rest place `is_wanted`, ascending.
pub(crate) fn nodes_where(mesh: &TetMesh, is_wanted: impl Fn(DVec3) -> bool) -> Vec<NodeId> {
    let places = mesh.positions_m.iter().enumerate();
    places.filter(|(_, p)| is_wanted(**p)).map(|(n, _)| NodeId::from_index(n)).collect()
}

/// A force [N] on each node of the mesh: `total_n` over the surface triangles all of whose nodes are among `nodes`
/// (ascending), evenly by area.
pub(crate) fn spread_over(mesh: &TetMesh, nodes: &[NodeId], total_n: DVec3) -> anyhow::Result<Vec<DVec3>> {
    let topology = Topology::build(mesh)?;
    let mut area_m2 = vec![0.0; mesh.positions_m.len()];
    let mut whole_m2 = 0.0;
    for triangle in topology.surface_triangles() {
        let corners = topology.outward_nodes(triangle);
        if corners.iter().all(|n| nodes.binary_search(n).is_ok()) {
            let share_m2 = topology.area_vector_m2(triangle, &mesh.positions_m).length() / 3.0;
            corners.iter().for_each(|n| area_m2[n.index()] += share_m2);
            whole_m2 += 3.0 * share_m2;
        }
    }
    anyhow::ensure!(whole_m2 > 0.0, "no surface triangle among the {} loaded nodes", nodes.len());
    Ok(area_m2.iter().map(|a| total_n * (a / whole_m2)).collect())
}

/// Place of each node under displacements [m].
pub(crate) fn displaced(mesh: &TetMesh, displacement_m: &[DVec3]) -> Vec<DVec3> {
    mesh.positions_m.iter().zip(displacement_m).map(|(p, u)| *p + *u).collect()
}

/// Displacement of each node of a model [m].
pub(crate) fn displacements(mesh: &TetMesh, model: &dyn DeformableModel) -> Vec<DVec3> {
    model.state().positions_m.iter().zip(&mesh.positions_m).map(|(p, rest)| *p - *rest).collect()
}

/// Change of the volume over the volume, of the whole body.
pub(crate) fn volume_change(mesh: &TetMesh, displacement_m: &[DVec3]) -> f64 {
    let deformed = TetMesh {
        positions_m: displaced(mesh, displacement_m),
        tetrahedra: mesh.tetrahedra.clone(),
        ..TetMesh::default()
    };
    deformed.volume_m3() / mesh.volume_m3() - 1.0
}

/// Mean over the rest volume of the size of each tetrahedron's volume change, over its volume.
pub(crate) fn local_volume_change(mesh: &TetMesh, displacement_m: &[DVec3]) -> f64 {
    let places_m = displaced(mesh, displacement_m);
    let mut changed_m3 = 0.0;
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let deformed_m3 = tetrahedron_volume_m3(nodes.map(|n| places_m[n.index()]));
        changed_m3 += (deformed_m3 - mesh.tet_volume_m3(TetId::from_index(t))).abs();
    }
    changed_m3 / mesh.volume_m3()
}

/// Largest of some values from 0; one that is no number stays, which `f64::max` would lose.
pub(crate) fn most(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, |most, x| if x > most || x.is_nan() { x } else { most })
}

/// Largest length of a vector.
pub(crate) fn largest(vectors: &[DVec3]) -> f64 {
    most(vectors.iter().map(|v| v.length()))
}

/// The non-linear tensor-mass law as static solutions want it: St Venant-Kirchhoff with a fibre, and the penalty
/// gamma |J - 1|^3 of volume changes (seeds `002` and `004`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct PenalizedLaw {
    pub(crate) law: TetLaw,
    /// gamma [Pa].
    pub(crate) volume_penalty_pa: f64,
}

impl PenalizedLaw {
    /// The laws of a body's tetrahedra.
    pub(crate) fn of(elasticity: &NonlinearElasticity<'_>, n_tets: usize) -> anyhow::Result<Vec<Self>> {
        let volume_penalty_pa = elasticity.volume_penalty_pa;
        let laws = elasticity.laws(n_tets)?;
        Ok(laws.into_iter().map(|law| Self { law, volume_penalty_pa }).collect())
    }
}

fn green_strain(f: &DMat3) -> DMat3 {
    (f.transpose() * *f - DMat3::IDENTITY) * 0.5
}

/// dJ/dF.
fn cofactor(f: &DMat3) -> DMat3 {
    DMat3::from_cols(f.y_axis.cross(f.z_axis), f.z_axis.cross(f.x_axis), f.x_axis.cross(f.y_axis))
}

fn contraction(a: &DMat3, b: &DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

impl Material for PenalizedLaw {
    fn energy_density_j_per_m3(&self, f: &DMat3) -> f64 {
        let change = (f.determinant() - 1.0).abs();
        self.law.energy_density_j_per_m3(green_strain(f)) + self.volume_penalty_pa * change * change * change
    }

    fn first_piola_pa(&self, f: &DMat3) -> DMat3 {
        let change = f.determinant() - 1.0;
        let pressure_pa = 3.0 * self.volume_penalty_pa * change * change.abs();
        *f * self.law.stress_pa(green_strain(f)) + cofactor(f) * pressure_pa
    }

    fn first_piola_differential_pa(&self, f: &DMat3, df: &DMat3) -> DMat3 {
        let strain_change = (df.transpose() * *f + f.transpose() * *df) * 0.5;
        let change = f.determinant() - 1.0;
        let (of_f, pressure_pa) = (cofactor(f), 3.0 * self.volume_penalty_pa * change * change.abs());
        let pressure_change_pa = 6.0 * self.volume_penalty_pa * change.abs() * contraction(&of_f, df);
        // The cofactor is quadratic in F.
        let cofactor_change = cofactor(&(*f + *df)) - of_f - cofactor(df);
        *df * self.law.stress_pa(green_strain(f))
            + *f * self.law.stress_pa(strain_change)
            + of_f * pressure_change_pa
            + cofactor_change * pressure_pa
    }
}

/// Displacements [m] of linear elasticity in equilibrium.
pub(crate) fn linear_equilibrium(
    mesh: &TetMesh,
    material: &LinearElastic,
    conditions: &BoundaryConditions,
    nodal_force_n: &[DVec3],
) -> anyhow::Result<Vec<DVec3>> {
    Ok(solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?.displacement_m)
}

/// The non-linear law in equilibrium.
pub(crate) fn nonlinear_equilibrium(
    mesh: &TetMesh,
    elasticity: &NonlinearElasticity<'_>,
    conditions: &BoundaryConditions,
    nodal_force_n: &[DVec3],
) -> anyhow::Result<NonlinearSolution> {
    let laws = &PenalizedLaw::of(elasticity, mesh.tetrahedra.len())?[..];
    let settings = NonlinearSettings::default();
    let problem = NonlinearProblem { mesh, laws, conditions, nodal_force_n, settings };
    Ok(solve_nonlinear(&problem)?)
}

/// Isotropic elasticity without penalty.
pub(crate) fn isotropic(material: &LinearElastic) -> NonlinearElasticity<'_> {
    NonlinearElasticity { material, fibres: &[], volume_penalty_pa: 0.0, largest_stretch: LARGEST_STRETCH }
}

/// The linear tensor-mass model of a mesh.
pub(crate) fn linear_model(
    mesh: &TetMesh,
    material: &LinearElastic,
    fixed_nodes: &[NodeId],
    damping_per_s: f64,
) -> anyhow::Result<TensorMass> {
    let time_step_s = STEP_SHARE * TensorMass::stable_step(mesh, material)?.step_s;
    let fixed = &all_axes(fixed_nodes);
    let body = dynamic_body(mesh, material, fixed, damping_per_s, time_step_s);
    Ok(TensorMass::build(&TensorMassParams { body, material })?)
}

fn all_axes(nodes: &[NodeId]) -> Vec<FixedNode> {
    nodes.iter().copied().map(FixedNode::all_axes).collect()
}

fn dynamic_body<'a>(
    mesh: &'a TetMesh,
    material: &LinearElastic,
    fixed: &'a [FixedNode],
    damping_per_s: f64,
    time_step_s: f64,
) -> DynamicBody<'a> {
    let damping = Rayleigh::of_mass(damping_per_s);
    DynamicBody { fixed, damping, time_step_s, ..DynamicBody::new(mesh, material.density_kg_per_m3()) }
}

/// The non-linear tensor-mass model of a mesh.
pub(crate) fn nonlinear_model(
    mesh: &TetMesh,
    elasticity: NonlinearElasticity<'_>,
    fixed_nodes: &[NodeId],
    damping_per_s: f64,
) -> anyhow::Result<NonlinearTensorMass> {
    let time_step_s = STEP_SHARE * NonlinearTensorMass::stable_step(mesh, &elasticity)?.step_s;
    let fixed = &all_axes(fixed_nodes);
    let body = dynamic_body(mesh, elasticity.material, fixed, damping_per_s, time_step_s);
    Ok(NonlinearTensorMass::build(&NonlinearTensorMassParams { body, elasticity })?)
}

/// Constraints of these forces [N], one a node of the mesh, and displacements of held nodes (ascending).
pub(crate) fn constraints(nodal_force_n: &[DVec3], held: &[ImposedDisplacement]) -> Constraints {
    let forces = nodal_force_n.iter().enumerate().filter(|(_, f)| **f != DVec3::ZERO);
    Constraints {
        displacements: held.to_vec(),
        forces: forces.map(|(n, &force_n)| NodalForce { node: NodeId::from_index(n), force_n }).collect(),
    }
}

/// The lowest frequency [rad/s] by Rayleigh's quotient: of displacements [m] in equilibrium with forces [N].
pub(crate) fn slow_frequency_per_s(mesh: &TetMesh, force_n: &[DVec3], displacement_m: &[DVec3]) -> f64 {
    let work_j: f64 = force_n.iter().zip(displacement_m).map(|(f, u)| f.dot(*u)).sum();
    let mut inertia = 0.0;
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let corner_kg = DENSITY_KG_PER_M3 * mesh.tet_volume_m3(TetId::from_index(t)) / 4.0;
        inertia += nodes.iter().map(|n| corner_kg * displacement_m[n.index()].length_squared()).sum::<f64>();
    }
    (work_j / inertia).sqrt()
}

/// Steps between two looks at whether a model is at rest.
const LOOK_STEPS: usize = 100;

/// Brings a damped model to rest under its constraints: until no node moves by more than `tolerance_m` in
/// [`LOOK_STEPS`] steps. The damping that is fastest is twice the lowest frequency. Returns the number of steps.
pub(crate) fn relax(
    model: &mut dyn DeformableModel,
    step_s: f64,
    tolerance_m: f64,
    most_steps: usize,
) -> anyhow::Result<usize> {
    let mut before_m = model.state().positions_m.to_vec();
    for look in 1..=most_steps / LOOK_STEPS {
        for _ in 0..LOOK_STEPS {
            model.step(step_s);
        }
        let now_m = model.state().positions_m;
        let moved_m = most(now_m.iter().zip(&before_m).map(|(a, b)| a.distance(*b)));
        if moved_m <= tolerance_m {
            return Ok(look * LOOK_STEPS);
        }
        before_m.copy_from_slice(now_m);
    }
    anyhow::bail!("the model is not at rest after {most_steps} steps")
}

/// Points of the tissue, to follow through deformations.
pub(crate) struct TissuePoints {
    /// Tetrahedron and barycentric coordinates of each.
    places: Vec<(TetId, [f64; 4])>,
}

impl TissuePoints {
    /// The points that lie at `points_m` at rest; those outside go with the nearest tetrahedron.
    pub(crate) fn new(mesh: &TetMesh, points_m: &[DVec3]) -> Self {
        let place = |p: &DVec3| {
            let of_tet = |t: usize| {
                let [a, b, c, d] = mesh.corners_m(TetId::from_index(t));
                let local = DMat3::from_cols(b - a, c - a, d - a).inverse() * (*p - a);
                [1.0 - local.x - local.y - local.z, local.x, local.y, local.z]
            };
            let least = |w: &[f64; 4]| w.iter().copied().fold(f64::INFINITY, f64::min);
            let candidates = (0..mesh.tetrahedra.len()).map(|t| (TetId::from_index(t), of_tet(t)));
            let nearest = candidates.max_by(|(_, a), (_, b)| least(a).total_cmp(&least(b)));
            nearest.unwrap_or((TetId(0), [1.0, 0.0, 0.0, 0.0]))
        };
        Self { places: points_m.iter().map(place).collect() }
    }

    /// Where they are when the nodes are at `nodes_m`.
    pub(crate) fn at(&self, mesh: &TetMesh, nodes_m: &[DVec3]) -> Vec<DVec3> {
        let of = |(tet, weights): &(TetId, [f64; 4])| {
            let nodes = mesh.tetrahedra[tet.index()];
            nodes.iter().zip(weights).fold(DVec3::ZERO, |sum, (n, w)| sum + nodes_m[n.index()] * *w)
        };
        self.places.iter().map(of).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::SeededRandom;
    use glisson::mesh::box_mesh::irregular_cube;
    use glisson::model::nonlinear_tensor_mass::Fibre;
    use glisson::solve::{ElasticBody, MeshEdges};

    fn random_vector(random: &mut SeededRandom) -> DVec3 {
        DVec3::new(random.normal(), random.normal(), random.normal())
    }

    #[test]
    fn the_static_law_is_the_models_and_its_differential_the_stress_change() {
        let mesh = irregular_cube(0.05, 3);
        let material = material().unwrap();
        let fibre = Fibre {
            lambda_along_pa: 3.0 * LAMBDA_PA,
            mu_along_pa: 2.0 * MU_PA,
            direction: DVec3::new(2.0, 1.0, 2.0) / 3.0,
        };
        let fibres = vec![fibre; mesh.tetrahedra.len()];
        let elasticity =
            NonlinearElasticity { fibres: &fibres, volume_penalty_pa: 2e4, ..isotropic(&material) };
        let mut random = SeededRandom::new(8);
        let u_m: Vec<DVec3> = mesh.positions_m.iter().map(|_| random_vector(&mut random) * 0.5e-3).collect();
        let laws = PenalizedLaw::of(&elasticity, mesh.tetrahedra.len()).unwrap();
        let edges = MeshEdges::of_mesh(&mesh).unwrap();
        let body = ElasticBody::new(&mesh, &edges, &laws).unwrap();
        let mut model = nonlinear_model(&mesh, elasticity, &[], 0.0).unwrap();
        let mut found_n = vec![DVec3::ZERO; u_m.len()];
        let mut expected_n = found_n.clone();
        body.force_into(&u_m, &mut found_n);
        model.elastic_forces_into(&u_m, &mut expected_n);
        let off: Vec<DVec3> = found_n.iter().zip(&expected_n).map(|(a, b)| *a - *b).collect();
        assert!(largest(&off) <= 1e-11 * largest(&expected_n));
        let energy_j = model.elastic_energy_at_j(&u_m);
        assert!((body.energy_j(&u_m) - energy_j).abs() <= 1e-11 * energy_j);

        for _ in 0..20 {
            let mut matrix = |size: f64| {
                DMat3::from_cols(
                    random_vector(&mut random) * size,
                    random_vector(&mut random) * size,
                    random_vector(&mut random) * size,
                )
            };
            let (f, df, h) = (DMat3::IDENTITY + matrix(0.2), matrix(1.0), 1e-6);
            let expected =
                (laws[0].first_piola_pa(&(f + df * h)) - laws[0].first_piola_pa(&(f - df * h))) * (0.5 / h);
            let found = laws[0].first_piola_differential_pa(&f, &df);
            let off = (found - expected).to_cols_array().into_iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            let size = expected.to_cols_array().into_iter().fold(0.0_f64, |m, x| m.max(x.abs()));
            assert!(off <= 1e-7 * size, "{off:e} of {size:e}");
        }
    }

    #[test]
    fn what_is_no_number_is_not_lost() {
        assert_eq!(most([1.0, 3.0, 2.0]), 3.0);
        assert!(most([1.0, f64::NAN, 2.0]).is_nan());
    }

    #[test]
    fn tissue_points_follow_an_affine_motion() {
        let mesh = cylinder(0.02, 0.06, 500).unwrap();
        let points_m = [DVec3::new(0.01, -0.003, 0.02), DVec3::new(0.0, 0.0199, 0.059)];
        let points = TissuePoints::new(&mesh, &points_m);
        let moved = |p: DVec3| DMat3::from_rotation_x(0.7) * p * 1.3 + DVec3::ONE;
        let nodes_m: Vec<DVec3> = mesh.positions_m.iter().map(|&p| moved(p)).collect();
        for (found_m, rest_m) in points.at(&mesh, &nodes_m).into_iter().zip(points_m) {
            assert!(found_m.distance(moved(rest_m)) < 1e-12);
        }
    }
}
