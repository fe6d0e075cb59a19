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
use glisson_report::plot::{LinePlot, Series, SeriesStyle};
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

/// Both models of the liver with fibres, which lose tetrahedra while they move.
struct Losing<'a> {
    material: &'a LinearElastic,
    mesh: TetMesh,
    fibres: Vec<Fibre>,
    random: SeededRandom,
    editable: EditableMesh,
    linear: TensorMass,
    nonlinear: NonlinearTensorMass,
    n_removed: usize,
}

fn with_fibres<'a>(material: &'a LinearElastic, fibres: &'a [Fibre]) -> NonlinearElasticity<'a> {
    NonlinearElasticity { fibres, volume_penalty_pa: PENALTY_PA, ..isotropic(material) }
}

fn random_vector(random: &mut SeededRandom) -> DVec3 {
    DVec3::new(random.normal(), random.normal(), random.normal())
}

impl<'a> Losing<'a> {
    fn new(material: &'a LinearElastic) -> anyhow::Result<Self> {
        let mesh = liver(LIVER_TETS)?;
        let mut random = SeededRandom::new(4);
        let fibres: Vec<Fibre> = (0..mesh.tetrahedra.len())
            .map(|_| Fibre {
                lambda_along_pa: 2.0 * LAMBDA_PA,
                mu_along_pa: 3.0 * MU_PA,
                direction: random_vector(&mut random).normalize(),
            })
            .collect();
        let linear = linear_model(&mesh, material, &[], DAMPING_PER_S)?;
        let nonlinear = nonlinear_model(&mesh, with_fibres(material, &fibres), &[], DAMPING_PER_S)?;
        let editable = EditableMesh::new(mesh.clone())?;
        Ok(Self { material, mesh, fibres, random, editable, linear, nonlinear, n_removed: 0 })
    }

    /// All tetrahedra around a node, or some anywhere.
    fn random_tets(&mut self, is_around_node: bool) -> Vec<TetId> {
        let (topology, random) = (self.editable.topology(), &mut self.random);
        let mut tets = if is_around_node {
            let n_live = topology.live_counts().nodes as u64;
            let node = topology.live_nodes().nth((random.next_u64() % n_live) as usize);
            node.map_or_else(Vec::new, |node| topology.node_tets(node).to_vec())
        } else {
            let live: Vec<TetId> = topology.live_tets().collect();
            (0..N_REMOVED / N_EDITS).map(|_| live[(random.next_u64() % live.len() as u64) as usize]).collect()
        };
        tets.sort_unstable();
        tets.dedup();
        tets
    }

    fn lose(&mut self, tets: Vec<TetId>) -> anyhow::Result<()> {
        self.n_removed += tets.len();
        let change = self.editable.apply(&MeshEdit::Remove { tets })?;
        self.linear.topology_changed(self.editable.mesh(), &change)?;
        self.nonlinear.topology_changed(self.editable.mesh(), &change)?;
        self.linear.step(self.linear.time_step_s());
        self.nonlinear.step(self.nonlinear.time_step_s());
        Ok(())
    }

    /// The same models built from what remains.
    fn rebuilt(&self) -> anyhow::Result<(TensorMass, NonlinearTensorMass)> {
        let remaining: Vec<TetId> = self.editable.topology().live_tets().collect();
        let rest = TetMesh {
            positions_m: self.mesh.positions_m.clone(),
            tetrahedra: remaining.iter().map(|t| self.mesh.tetrahedra[t.index()]).collect(),
            ..TetMesh::default()
        };
        let fibres: Vec<Fibre> = remaining.iter().map(|t| self.fibres[t.index()]).collect();
        let elasticity = with_fibres(self.material, &fibres);
        Ok((
            linear_model(&rest, self.material, &[], DAMPING_PER_S)?,
            nonlinear_model(&rest, elasticity, &[], DAMPING_PER_S)?,
        ))
    }

    /// Largest difference of forces under random displacements, over the largest force.
    fn force_difference(&mut self, fresh: &mut NonlinearTensorMass) -> f64 {
        let n_nodes = self.mesh.positions_m.len();
        let u_m: Vec<DVec3> = (0..n_nodes).map(|_| random_vector(&mut self.random) * 2e-3).collect();
        let [mut found_n, mut expected_n] =
            [const { Vec::new() }; 2].map(|_: Vec<DVec3>| vec![DVec3::ZERO; n_nodes]);
        self.nonlinear.elastic_forces_into(&u_m, &mut found_n);
        fresh.elastic_forces_into(&u_m, &mut expected_n);
        let off_n: Vec<DVec3> = found_n.iter().zip(&expected_n).map(|(a, b)| *a - *b).collect();
        largest(&off_n) / largest(&expected_n)
    }

    /// Largest difference of masses, over the largest mass.
    fn mass_difference(&self, fresh: &NonlinearTensorMass) -> f64 {
        let nodes = || (0..self.mesh.positions_m.len()).map(NodeId::from_index);
        let off = nodes().map(|n| (self.nonlinear.mass_kg(n) - fresh.mass_kg(n)).abs());
        most(off) / most(nodes().map(|n| fresh.mass_kg(n)))
    }
}

/// Removes tetrahedra from the liver at random, all around a node at times, while it moves.
fn removal(outcome: &mut Outcome, material: &LinearElastic) -> anyhow::Result<String> {
    let mut liver = Losing::new(material)?;
    for edit in 0..N_EDITS {
        let tets = liver.random_tets(edit % 5 == 0);
        liver.lose(tets)?;
    }
    let (fresh_linear, mut fresh) = liver.rebuilt()?;
    let n_nodes = liver.mesh.positions_m.len();
    let of_linear = linear_difference(&liver.linear, &fresh_linear, n_nodes);
    let of_nonlinear = nonlinear_difference(&liver.nonlinear, &fresh, n_nodes);
    let n_not_zero = (of_linear.n_not_zero + of_nonlinear.n_not_zero) as f64;
    let against_rebuild = [
        ("liver, linear: removal against rebuild, of the largest number", of_linear.relative()),
        (
            "liver, non-linear with fibres: removal against rebuild, of the largest number",
            of_nonlinear.relative(),
        ),
        (
            "liver: forces with penalty after removal against rebuild, relative",
            liver.force_difference(&mut fresh),
        ),
        ("liver: masses after removal against rebuild, relative", liver.mass_difference(&fresh)),
    ];
    let against_rebuild = against_rebuild.map(|(name, off)| Experiment::at_most(name, REBUILD, off, 1e-12));
    outcome.experiments.extend(against_rebuild);
    outcome.experiments.push(Experiment::at_most(
        "liver: entities without a tetrahedron that are not exactly zero",
        OWN,
        n_not_zero,
        0.0,
    ));
    Ok(format!(
        "Removal: {} of the liver's {} tetrahedra go in {N_EDITS} edits while it moves, among them all around \
         single nodes; every number of vertices, edges and triangles is compared with a model built from the rest.",
        liver.n_removed,
        liver.mesh.tetrahedra.len(),
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

/// A bar that is pulled until it parts.
struct Bar {
    mesh: TetMesh,
    editable: EditableMesh,
    model: NonlinearTensorMass,
    /// Nodes that are pulled.
    end: Vec<NodeId>,
    torn: Vec<TetId>,
    n_torn: usize,
    /// Elongations at the first tear and when it had parted [m].
    first_m: f64,
    parted_m: f64,
    /// Distance of a torn tetrahedron from the waist [m].
    farthest_m: f64,
    most_n: f64,
    /// Elongation [mm] and force [mN].
    curve: Vec<[f64; 2]>,
}

impl Bar {
    fn new(mesh: TetMesh, material: &LinearElastic, [held, end]: [Vec<NodeId>; 2]) -> anyhow::Result<Self> {
        Ok(Self {
            editable: EditableMesh::new(mesh.clone())?,
            model: nonlinear_model(&mesh, isotropic(material), &held, DAMPING_PER_S)?,
            end,
            torn: Vec::with_capacity(mesh.tetrahedra.len()),
            n_torn: 0,
            first_m: f64::INFINITY,
            parted_m: f64::INFINITY,
            farthest_m: 0.0,
            most_n: 0.0,
            curve: Vec::new(),
            mesh,
        })
    }

    /// Holds the end there, and lets tissue tear.
    fn pull(&mut self, pull_m: f64) -> anyhow::Result<()> {
        let displacement_m = DVec3::X * pull_m;
        let held: Vec<_> =
            self.end.iter().map(|&node| ImposedDisplacement { node, displacement_m }).collect();
        self.model.apply(&constraints(&[], &held));
        let step_s = self.step_s();
        for _ in 0..STEPS_A_PULL {
            self.model.step(step_s);
            self.model.tetrahedra_torn_into(TEARING_STRETCH, &mut self.torn);
            if !self.torn.is_empty() {
                self.first_m = self.first_m.min(pull_m);
                self.tear()?;
            }
        }
        if self.editable.topology().pieces(Through::Nodes).count() > 1 {
            self.parted_m = self.parted_m.min(pull_m);
        }
        let force_n = self.force_n();
        self.most_n = most([self.most_n, force_n]);
        self.curve.push([1e3 * pull_m, 1e3 * force_n]);
        Ok(())
    }

    fn tear(&mut self) -> anyhow::Result<()> {
        self.n_torn += self.torn.len();
        for &tet in &self.torn {
            let centroid_m = self.mesh.corners_m(tet).into_iter().sum::<DVec3>() / 4.0;
            self.farthest_m = self.farthest_m.max((centroid_m.x - 0.5 * BAR_M.x).abs());
        }
        let change = self.editable.apply(&MeshEdit::Remove { tets: self.torn.clone() })?;
        self.model.topology_changed(self.editable.mesh(), &change)?;
        Ok(())
    }

    fn step_s(&self) -> f64 {
        self.model.time_step_s().min(self.model.stable_step_s())
    }

    fn force_n(&self) -> f64 {
        self.model.constraint_forces_n().iter().map(|f| f.x).sum()
    }

    /// Mass that is left against the volume left, relative.
    fn mass_off(&self, material: &LinearElastic) -> f64 {
        let nodes = (0..self.mesh.positions_m.len()).map(NodeId::from_index);
        let mass_kg: f64 = nodes.map(|n| self.model.mass_kg(n)).sum();
        (mass_kg / (material.density_kg_per_m3() * self.editable.volume_m3()) - 1.0).abs()
    }

    /// The static bar tears first at `expected_m`.
    fn experiments(&self, material: &LinearElastic, expected_m: f64) -> [Experiment; 7] {
        let is_finite = displacements(&self.mesh, &self.model).iter().all(|u| u.is_finite());
        let not_finite = f64::from(u8::from(!is_finite));
        [
            Experiment::within(
                "bar with a waist: elongation at which it tears first, over the static one",
                "own static solution",
                self.first_m / expected_m,
                [0.95, 1.05],
            ),
            Experiment::at_most(
                "bar: farthest torn tetrahedron from the waist [m]",
                OWN,
                self.farthest_m,
                WAIST_M,
            ),
            Experiment::within(
                "bar: elongation at which it has parted over the first tear's",
                OWN,
                self.parted_m / self.first_m,
                [1.0, 1.2],
            ),
            Experiment::at_most(
                "bar: force at rest after it parted, over the largest one",
                OWN,
                self.force_n().abs() / self.most_n,
                1e-4,
            ),
            Experiment::at_most("bar: tetrahedra still torn at the end", OWN, self.torn.len() as f64, 0.0),
            Experiment::at_most("bar: positions that are not finite", OWN, not_finite, 0.0),
            Experiment::at_most(
                "bar: mass that is left against the volume left, relative",
                OWN,
                self.mass_off(material),
                1e-12,
            ),
        ]
    }

    fn figure(&self, expected_m: f64) -> Figure {
        Figure {
            file: "cutting_tearing.svg",
            caption: format!(
                "Force that pulls a bar with a waist; tetrahedra stretched beyond {TEARING_STRETCH} are removed."
            ),
            plot: LinePlot {
                title: "A bar is torn".into(),
                x_label: "elongation [mm]".into(),
                y_label: "force [mN]".into(),
                series: vec![
                    Series { name: "force".into(), points: self.curve.clone(), style: SeriesStyle::Line },
                    Series {
                        name: "static solution tears".into(),
                        points: vec![[1e3 * expected_m, 0.0], [1e3 * expected_m, 1e3 * self.most_n]],
                        style: SeriesStyle::Dashed,
                    },
                ],
                size: [720, 440],
            },
        }
    }
}

fn tearing(outcome: &mut Outcome, material: &LinearElastic) -> anyhow::Result<String> {
    let mesh = waisted_bar();
    let ends = [nodes_where(&mesh, |p| p.x < 1e-9), nodes_where(&mesh, |p| p.x > BAR_M.x - 1e-9)];
    let expected_m = static_tearing_m(&mesh, material, &ends)?;
    let mut bar = Bar::new(mesh, material, ends)?;
    for pull in 0..=(LAST_PULL_M / PULL_M).round() as usize {
        bar.pull(PULL_M * pull as f64)?;
    }
    // Without the drag of the moving end.
    let step_s = bar.step_s();
    relax(&mut bar.model, step_s, AT_REST_M, MOST_STEPS)?;
    outcome.experiments.extend(bar.experiments(material, expected_m));
    outcome.figures.push(bar.figure(expected_m));
    Ok(format!(
        "Tearing: a bar of {} mm with a waist in the middle ({} tetrahedra, St Venant-Kirchhoff) is pulled {} mm every {} \
         steps. {} tetrahedra tear, the first at {:.1} mm (static solution: {:.2} mm); the bar has parted at {:.1} mm. \
         The little force after that is the drag of the damping on the moving end; at rest none is left.",
        1e3 * BAR_M.x,
        bar.mesh.tetrahedra.len(),
        1e3 * PULL_M,
        STEPS_A_PULL,
        bar.n_torn,
        1e3 * bar.first_m,
        1e3 * expected_m,
        1e3 * bar.parted_m,
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
