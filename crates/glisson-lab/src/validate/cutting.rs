//! Removal equals rebuild on an organ of full size, and tearing (seeds `002` s. 3.2 and appendix A, `003` s. 3.5).

use super::{Experiment, Figure, Outcome};
use crate::bodies::{
    LAMBDA_PA, MU_PA, constraints, displacements, isotropic, largest, linear_model, liver, material, most,
    nodes_where, nonlinear_equilibrium, nonlinear_model, relax,
};
use glisson::material::LinearElastic;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::nonlinear_tensor_mass::{Fibre, NonlinearElasticity, NonlinearTensorMass};
use glisson::model::tensor_mass::TensorMass;
use glisson::model::{DeformableModel, ImposedDisplacement};
use glisson::solve::BoundaryConditions;
use glisson_view::plot::{LinePlot, Series, SeriesStyle};
use std::collections::BTreeMap;

const REBUILD: &str = "Picinbono, Delingette and Ayache 2000, RR-4028, s. 3.2: as if removed at rest";
const OWN: &str = "requirement";
const LIVER_TETS: usize = 6_342;
const N_REMOVED: usize = 600;
const N_EDITS: usize = 60;
const PENALTY_PA: f64 = 20.0 * MU_PA;
/// The bar that is torn, its waist in the middle [m].
const BAR_M: DVec3 = DVec3::new(0.08, 0.02, 0.02);
const BAR_CELLS: [usize; 3] = [24, 6, 6];
/// Share of the bar's width that the waist lacks, and the waist's half length [m].
const WAIST: f64 = 0.35;
const WAIST_M: f64 = 0.012;
/// Principal stretch beyond which tissue tears.
const TEARING_STRETCH: f64 = 1.3;
/// Elongation between two looks [m], steps between them, and the last elongation [m].
const PULL_M: f64 = 2e-4;
const STEPS_A_PULL: usize = 60;
const LAST_PULL_M: f64 = 0.02;
const DAMPING_PER_S: f64 = 60.0;
const AT_REST_M: f64 = 1e-10;
const MOST_STEPS: usize = 40_000;

/// Largest difference of numbers of the same entity, over the largest number of their kind.
#[derive(Default)]
struct Difference {
    /// Largest difference and largest number of each kind.
    kinds: [[f64; 2]; 3],
    /// Entities without a tetrahedron whose numbers are not exactly zero.
    n_not_zero: usize,
}

impl Difference {
    fn add(&mut self, kind: usize, found: &[f64], expected: Option<&[f64]>) {
        match expected {
            Some(expected) => {
                let [off, size] = &mut self.kinds[kind];
                for (a, b) in found.iter().zip(expected) {
                    *off = most([*off, (a - b).abs()]);
                    *size = most([*size, b.abs()]);
                }
            }
            None => self.n_not_zero += usize::from(found.iter().any(|x| *x != 0.0)),
        }
    }

    fn relative(&self) -> f64 {
        most(self.kinds.iter().filter(|[_, size]| *size != 0.0).map(|[off, size]| off / size))
    }
}

fn flat(c: &[DVec3]) -> Vec<f64> {
    c.iter().flat_map(|c| c.to_array()).collect()
}

/// Tensors B, vectors C and scalars D of vertices, edges and triangles.
fn nonlinear_difference(
    found: &NonlinearTensorMass,
    expected: &NonlinearTensorMass,
    n_nodes: usize,
) -> Difference {
    let mut difference = Difference::default();
    for n in (0..n_nodes).map(NodeId::from_index) {
        let ((b, x), (expected_b, y)) = (found.vertex_stiffness(n), expected.vertex_stiffness(n));
        difference.add(0, &b.to_cols_array(), Some(&expected_b.to_cols_array()));
        difference.add(1, &x.c.to_array(), Some(&y.c.to_array()));
        difference.add(2, &[x.d], Some(&[y.d]));
    }
    let edges: BTreeMap<_, _> = expected.edge_stiffness().map(|(nodes, b, x)| (nodes, (b, x))).collect();
    for (nodes, b, x) in found.edge_stiffness() {
        let other = edges.get(&nodes);
        difference.add(0, &b.to_cols_array(), other.map(|(b, _)| b.to_cols_array()).as_ref().map(|b| &b[..]));
        difference.add(1, &flat(&x.c), other.map(|(_, y)| flat(&y.c)).as_deref());
        difference.add(2, &x.d, other.map(|(_, y)| &y.d[..]));
    }
    let triangles: BTreeMap<_, _> = expected.triangle_stiffness().collect();
    for (nodes, x) in found.triangle_stiffness() {
        let other = triangles.get(&nodes);
        difference.add(1, &flat(&x.c), other.map(|y| flat(&y.c)).as_deref());
        difference.add(2, x.d.as_flattened(), other.map(|y| y.d.as_flattened()));
    }
    difference
}

/// Tensors B of vertices and edges.
fn linear_difference(found: &TensorMass, expected: &TensorMass, n_nodes: usize) -> Difference {
    let mut difference = Difference::default();
    for n in (0..n_nodes).map(NodeId::from_index) {
        let [b, expected_b] = [found, expected].map(|m| m.vertex_tensor_n_per_m(n).to_cols_array());
        difference.add(0, &b, Some(&expected_b));
    }
    let edges: BTreeMap<_, _> = expected.edge_tensors_n_per_m().collect();
    for (nodes, b) in found.edge_tensors_n_per_m() {
        let other = edges.get(&nodes).map(|b| b.to_cols_array());
        difference.add(0, &b.to_cols_array(), other.as_ref().map(|b| &b[..]));
    }
    difference
}

/// Removes tetrahedra from the liver at random, all around a node at times, while it moves.
fn removal(outcome: &mut Outcome, material: &LinearElastic) -> anyhow::Result<String> {
    let mesh = liver(LIVER_TETS)?;
    let mut random = SeededRandom::new(4);
    let fibres: Vec<Fibre> = (0..mesh.tetrahedra.len())
        .map(|_| Fibre {
            lambda_along_pa: 2.0 * LAMBDA_PA,
            mu_along_pa: 3.0 * MU_PA,
            direction: DVec3::new(random.normal(), random.normal(), random.normal()).normalize(),
        })
        .collect();
    let elasticity =
        NonlinearElasticity { fibres: &fibres, volume_penalty_pa: PENALTY_PA, ..isotropic(material) };
    let mut linear = linear_model(&mesh, material, &[], DAMPING_PER_S)?;
    let mut nonlinear = nonlinear_model(&mesh, elasticity, &[], DAMPING_PER_S)?;
    let mut editable = EditableMesh::new(mesh.clone())?;
    let mut n_removed = 0;
    for edit in 0..N_EDITS {
        let topology = editable.topology();
        let mut tets = if edit % 5 == 0 {
            let n_live = topology.live_counts().nodes as u64;
            let node = topology.live_nodes().nth((random.next_u64() % n_live) as usize);
            node.map_or_else(Vec::new, |node| topology.node_tets(node).to_vec())
        } else {
            let live: Vec<TetId> = topology.live_tets().collect();
            (0..N_REMOVED / N_EDITS).map(|_| live[(random.next_u64() % live.len() as u64) as usize]).collect()
        };
        tets.sort_unstable();
        tets.dedup();
        n_removed += tets.len();
        let change = editable.apply(&MeshEdit::Remove { tets })?;
        linear.topology_changed(editable.mesh(), &change)?;
        nonlinear.topology_changed(editable.mesh(), &change)?;
        linear.step(linear.time_step_s());
        nonlinear.step(nonlinear.time_step_s());
    }
    let remaining: Vec<TetId> = editable.topology().live_tets().collect();
    let rest = TetMesh {
        positions_m: mesh.positions_m.clone(),
        tetrahedra: remaining.iter().map(|t| mesh.tetrahedra[t.index()]).collect(),
    };
    let fibres: Vec<Fibre> = remaining.iter().map(|t| fibres[t.index()]).collect();
    let fresh_linear = linear_model(&rest, material, &[], DAMPING_PER_S)?;
    let mut fresh =
        nonlinear_model(&rest, NonlinearElasticity { fibres: &fibres, ..elasticity }, &[], DAMPING_PER_S)?;
    let n_nodes = mesh.positions_m.len();
    let of_linear = linear_difference(&linear, &fresh_linear, n_nodes);
    let of_nonlinear = nonlinear_difference(&nonlinear, &fresh, n_nodes);
    let u_m: Vec<DVec3> =
        (0..n_nodes).map(|_| DVec3::new(random.normal(), random.normal(), random.normal()) * 2e-3).collect();
    let [mut found_n, mut expected_n] =
        [const { Vec::new() }; 2].map(|_: Vec<DVec3>| vec![DVec3::ZERO; n_nodes]);
    nonlinear.elastic_forces_into(&u_m, &mut found_n);
    fresh.elastic_forces_into(&u_m, &mut expected_n);
    let off_n: Vec<DVec3> = found_n.iter().zip(&expected_n).map(|(a, b)| *a - *b).collect();
    let mass = |n: usize| (nonlinear.mass_kg(NodeId::from_index(n)), fresh.mass_kg(NodeId::from_index(n)));
    let mass_off = most((0..n_nodes).map(mass).map(|(a, b)| (a - b).abs()));
    let mass_most = most((0..n_nodes).map(mass).map(|(_, b)| b));
    let n_not_zero = (of_linear.n_not_zero + of_nonlinear.n_not_zero) as f64;
    outcome.experiments.extend([
        Experiment::at_most(
            "liver, linear: removal against rebuild, of the largest number",
            REBUILD,
            of_linear.relative(),
            1e-12,
        ),
        Experiment::at_most(
            "liver, non-linear with fibres: removal against rebuild, of the largest number",
            REBUILD,
            of_nonlinear.relative(),
            1e-12,
        ),
        Experiment::at_most(
            "liver: forces with penalty after removal against rebuild, relative",
            REBUILD,
            largest(&off_n) / largest(&expected_n),
            1e-12,
        ),
        Experiment::at_most(
            "liver: masses after removal against rebuild, relative",
            REBUILD,
            mass_off / mass_most,
            1e-12,
        ),
        Experiment::at_most(
            "liver: entities without a tetrahedron that are not exactly zero",
            OWN,
            n_not_zero,
            0.0,
        ),
    ]);
    Ok(format!(
        "Removal: {n_removed} of the liver's {} tetrahedra go in {N_EDITS} edits while it moves, among them all around \
         single nodes; every number of vertices, edges and triangles is compared with a model built from the rest.",
        mesh.tetrahedra.len(),
    ))
}

/// A bar with a waist, x along it.
fn waisted_bar() -> TetMesh {
    let mut mesh = box_of_five(BAR_CELLS, BAR_M);
    for p in &mut mesh.positions_m {
        let along = (p.x - 0.5 * BAR_M.x) / WAIST_M;
        let width = 1.0 - WAIST * (-along * along).exp();
        for axis in 1..3 {
            p[axis] = (p[axis] - 0.5 * BAR_M[axis]) * width;
        }
    }
    mesh
}

/// Elongation [m] at which the static bar's largest principal stretch is the tearing one: bisection.
fn static_tearing_m(
    mesh: &TetMesh,
    material: &LinearElastic,
    ends: &[Vec<NodeId>; 2],
) -> anyhow::Result<f64> {
    let mut model = nonlinear_model(mesh, isotropic(material), &ends[0], 0.0)?;
    let free_n = vec![DVec3::ZERO; mesh.positions_m.len()];
    let mut torn = Vec::new();
    let [mut low_m, mut high_m] = [0.0, LAST_PULL_M];
    for _ in 0..12 {
        let pull_m = 0.5 * (low_m + high_m);
        let mut conditions = BoundaryConditions::fixed(&ends[0]);
        ends[1].iter().for_each(|&n| conditions.impose_node(n, DVec3::X * pull_m));
        let solution = nonlinear_equilibrium(mesh, &isotropic(material), &conditions, &free_n)?;
        let places_m: Vec<DVec3> =
            mesh.positions_m.iter().zip(&solution.displacement_m).map(|(p, u)| *p + *u).collect();
        model.take_over(&places_m);
        model.tetrahedra_torn_into(TEARING_STRETCH, &mut torn);
        if torn.is_empty() { low_m = pull_m } else { high_m = pull_m }
    }
    Ok(high_m)
}

fn tearing(outcome: &mut Outcome, material: &LinearElastic) -> anyhow::Result<String> {
    let mesh = waisted_bar();
    let ends = [nodes_where(&mesh, |p| p.x < 1e-9), nodes_where(&mesh, |p| p.x > BAR_M.x - 1e-9)];
    let expected_m = static_tearing_m(&mesh, material, &ends)?;
    let mut model = nonlinear_model(&mesh, isotropic(material), &ends[0], DAMPING_PER_S)?;
    let mut editable = EditableMesh::new(mesh.clone())?;
    let mut torn = Vec::with_capacity(mesh.tetrahedra.len());
    let (mut first_m, mut parted_m) = (f64::INFINITY, f64::INFINITY);
    let (mut n_torn, mut farthest_m, mut most_n) = (0, 0.0_f64, 0.0_f64);
    let mut curve = Vec::new();
    for pull in 0..=(LAST_PULL_M / PULL_M).round() as usize {
        let pull_m = PULL_M * pull as f64;
        let displacement_m = DVec3::X * pull_m;
        let held: Vec<_> = ends[1].iter().map(|&node| ImposedDisplacement { node, displacement_m }).collect();
        model.apply(&constraints(&[], &held));
        let step_s = model.time_step_s().min(model.stable_step_s());
        for _ in 0..STEPS_A_PULL {
            model.step(step_s);
            model.tetrahedra_torn_into(TEARING_STRETCH, &mut torn);
            if torn.is_empty() {
                continue;
            }
            first_m = first_m.min(pull_m);
            n_torn += torn.len();
            for &tet in &torn {
                let centroid_m = mesh.corners_m(tet).into_iter().sum::<DVec3>() / 4.0;
                farthest_m = farthest_m.max((centroid_m.x - 0.5 * BAR_M.x).abs());
            }
            let change = editable.apply(&MeshEdit::Remove { tets: torn.clone() })?;
            model.topology_changed(editable.mesh(), &change)?;
        }
        if editable.topology().pieces(Through::Nodes).count() > 1 {
            parted_m = parted_m.min(pull_m);
        }
        let force_n: f64 = model.constraint_forces_n().iter().map(|f| f.x).sum();
        most_n = most([most_n, force_n]);
        curve.push([1e3 * pull_m, 1e3 * force_n]);
    }
    // Without the drag of the moving end.
    let step_s = model.time_step_s().min(model.stable_step_s());
    relax(&mut model, step_s, AT_REST_M, MOST_STEPS)?;
    let last_n: f64 = model.constraint_forces_n().iter().map(|f| f.x).sum();
    let is_finite = displacements(&mesh, &model).iter().all(|u| u.is_finite());
    let mass_kg: f64 = (0..mesh.positions_m.len()).map(|n| model.mass_kg(NodeId::from_index(n))).sum();
    let expected_kg = material.density_kg_per_m3() * editable.volume_m3();
    outcome.experiments.extend([
        Experiment::within(
            "bar with a waist: elongation at which it tears first, over the static one",
            "own static solution",
            first_m / expected_m,
            [0.95, 1.05],
        ),
        Experiment::at_most("bar: farthest torn tetrahedron from the waist [m]", OWN, farthest_m, WAIST_M),
        Experiment::within(
            "bar: elongation at which it has parted over the first tear's",
            OWN,
            parted_m / first_m,
            [1.0, 1.2],
        ),
        Experiment::at_most(
            "bar: force at rest after it parted, over the largest one",
            OWN,
            last_n.abs() / most_n,
            1e-4,
        ),
        Experiment::at_most("bar: tetrahedra still torn at the end", OWN, torn.len() as f64, 0.0),
        Experiment::at_most("bar: positions that are not finite", OWN, f64::from(u8::from(!is_finite)), 0.0),
        Experiment::at_most(
            "bar: mass that is left against the volume left, relative",
            OWN,
            (mass_kg / expected_kg - 1.0).abs(),
            1e-12,
        ),
    ]);
    outcome.figures.push(Figure {
        file: "cutting_tearing.svg",
        caption: format!(
            "Force that pulls a bar with a waist; tetrahedra stretched beyond {TEARING_STRETCH} are removed."
        ),
        plot: LinePlot {
            title: "A bar is torn".into(),
            x_label: "elongation [mm]".into(),
            y_label: "force [mN]".into(),
            series: vec![
                Series { name: "force".into(), points: curve, style: SeriesStyle::Line },
                Series {
                    name: "static solution tears".into(),
                    points: vec![[1e3 * expected_m, 0.0], [1e3 * expected_m, 1e3 * most_n]],
                    style: SeriesStyle::Dashed,
                },
            ],
            size: [720, 440],
        },
    });
    Ok(format!(
        "Tearing: a bar of {} mm with a waist in the middle ({} tetrahedra, St Venant-Kirchhoff) is pulled {} mm every {} \
         steps. {n_torn} tetrahedra tear, the first at {:.1} mm (static solution: {:.2} mm); the bar has parted at {:.1} mm. \
         The little force after that is the drag of the damping on the moving end; at rest none is left.",
        1e3 * BAR_M.x,
        mesh.tetrahedra.len(),
        1e3 * PULL_M,
        STEPS_A_PULL,
        1e3 * first_m,
        1e3 * expected_m,
        1e3 * parted_m,
    ))
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let material = material()?;
    let mut outcome = Outcome::default();
    let of_removal = removal(&mut outcome, &material)?;
    let of_tearing = tearing(&mut outcome, &material)?;
    outcome.notes = format!("{of_removal}\n\n{of_tearing}");
    Ok(outcome)
}
