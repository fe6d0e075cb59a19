//! Pre-stressed bodies that relax after tetrahedra are removed (seed `003`, s. 3.6, figs 3.1 and 3.2): a cylinder
//! held below with its top moved, and a plate held at its right edge with part of the left edge moved, which is cut
//! in two ways.
//!
//! The seed shows pictures only. What must hold: the body comes to rest in the equilibrium of the tetrahedra that
//! are left, with less energy than before.

use super::{Experiment, Figure, Outcome, series};
use crate::bodies::{
    TissuePoints, constraints, cylinder, displaced, displacements, isotropic, largest, linear_equilibrium,
    linear_model, material, most, nodes_where, nonlinear_equilibrium, nonlinear_model, relax,
};
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::nonlinear_tensor_mass::NonlinearTensorMass;
use glisson::model::tensor_mass::TensorMass;
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement};
use glisson::solve::BoundaryConditions;
use glisson_report::plot::{LinePlot, Series, SeriesStyle};
use std::collections::BTreeSet;

const SEED: &str = "Checoury 2002, s. 3.6";
const CYLINDER_RADIUS_M: f64 = 0.02;
const CYLINDER_HEIGHT_M: f64 = 0.06;
const CYLINDER_TETS: usize = 2_500;
/// How the top of the cylinder is moved [m].
const TOP_M: DVec3 = DVec3::new(0.006, 0.0, 0.015);
/// Half height of the notch, which reaches from the side to the axis [m].
const NOTCH_M: f64 = 0.003;
const PLATE_CELLS: [usize; 3] = [20, 15, 2];
const PLATE_M: DVec3 = DVec3::new(0.08, 0.06, 0.008);
/// How the upper part of the plate's left edge is moved [m].
const EDGE_M: DVec3 = DVec3::new(-0.012, 0.006, 0.0);
/// Damping [1/s]: about twice the lowest frequency of these bodies.
const DAMPING_PER_S: f64 = 60.0;
const AT_REST_M: f64 = 1e-11;
const MOST_STEPS: usize = 40_000;
/// Steps in which the body is stretched.
const MOVING_STEPS: usize = 400;
/// Steps that the figure shows.
const SHOWN_STEPS: usize = 250;

/// A body that is held, moved, and cut; places are those at rest.
struct Stretched {
    name: &'static str,
    mesh: TetMesh,
    is_fixed: fn(DVec3) -> bool,
    is_moved: fn(DVec3) -> bool,
    moved_m: DVec3,
    /// Whether a tetrahedron with this centroid is removed.
    is_removed: fn(DVec3) -> bool,
    /// Two points whose distance says how far the cut gapes.
    lips_m: [DVec3; 2],
}

/// How a body relaxed.
struct Relaxed {
    /// Its displacements before the cut [m].
    before_m: Vec<DVec3>,
    /// The mesh that is left and its displacements [m].
    mesh: TetMesh,
    after_m: Vec<DVec3>,
    /// Energies before the cut, right after it, and at rest [J].
    energies_j: [f64; 3],
    /// Distance of the lips before the cut and at rest [m].
    gape_m: [f64; 2],
    /// Time since the cut [ms] and distance of the lips [mm].
    course: Vec<[f64; 2]>,
    /// Difference from the equilibria before and after the cut, over the largest displacement.
    errors: [f64; 2],
    n_removed: usize,
}

/// A model that knows its energy and its step.
trait Tissue: DeformableModel {
    fn total_energy_j(&self) -> f64;
    fn longest_step_s(&self) -> f64;
}

impl Tissue for TensorMass {
    fn total_energy_j(&self) -> f64 {
        self.energy_j()
    }
    fn longest_step_s(&self) -> f64 {
        self.time_step_s().min(self.stable_step_s())
    }
}

impl Tissue for NonlinearTensorMass {
    fn total_energy_j(&self) -> f64 {
        self.energy_j()
    }
    fn longest_step_s(&self) -> f64 {
        self.time_step_s().min(self.stable_step_s())
    }
}

impl Stretched {
    fn fixed(&self, mesh: &TetMesh) -> Vec<NodeId> {
        nodes_where(mesh, self.is_fixed)
    }

    /// The moved nodes at a share of their way.
    fn held(&self, mesh: &TetMesh, share: f64) -> Constraints {
        let displacement_m = self.moved_m * share;
        let nodes = nodes_where(mesh, self.is_moved).into_iter();
        let held: Vec<_> = nodes.map(|node| ImposedDisplacement { node, displacement_m }).collect();
        constraints(&[], &held)
    }

    fn conditions(&self, mesh: &TetMesh) -> BoundaryConditions {
        let mut conditions = BoundaryConditions::fixed(&self.fixed(mesh));
        for held in self.held(mesh, 1.0).displacements {
            conditions.impose_node(held.node, held.displacement_m);
        }
        conditions
    }

    /// Moves, cuts and lets relax; `equilibrium` solves the same case at once.
    fn relax<M: Tissue>(
        &self,
        model: &mut M,
        equilibrium: impl Fn(&TetMesh, &BoundaryConditions) -> anyhow::Result<Vec<DVec3>>,
    ) -> anyhow::Result<Relaxed> {
        let difference = |mesh: &TetMesh, model: &M| -> anyhow::Result<f64> {
            let expected_m = equilibrium(mesh, &self.conditions(mesh))?;
            let found_m = displacements(mesh, model);
            let off: Vec<DVec3> = found_m.iter().zip(&expected_m).map(|(a, b)| *a - *b).collect();
            Ok(largest(&off) / largest(&expected_m))
        };
        let step_s = model.longest_step_s();
        for step in 1..=MOVING_STEPS {
            model.apply(&self.held(&self.mesh, step as f64 / MOVING_STEPS as f64));
            model.step(step_s);
        }
        relax(model, step_s, AT_REST_M, MOST_STEPS)?;
        let before = difference(&self.mesh, model)?;
        let before_m = displacements(&self.mesh, model);
        let mut energies_j = [model.total_energy_j(); 3];

        let mut editable = EditableMesh::new(self.mesh.clone())?;
        let centroid = |t: TetId| self.mesh.corners_m(t).into_iter().sum::<DVec3>() / 4.0;
        let tets: Vec<TetId> =
            editable.topology().live_tets().filter(|&t| (self.is_removed)(centroid(t))).collect();
        let n_removed = tets.len();
        let removal = editable.apply(&MeshEdit::Remove { tets })?;
        model.topology_changed(editable.mesh(), &removal)?;
        let renumbering = editable.compact();
        model.topology_changed(editable.mesh(), &renumbering)?;
        let mesh = editable.mesh().clone();
        model.apply(&self.held(&mesh, 1.0));
        energies_j[1] = model.total_energy_j();

        let lips = TissuePoints::new(&mesh, &self.lips_m);
        let gape_m = |model: &M| {
            let places_m = lips.at(&mesh, model.state().positions_m);
            places_m[0].distance(places_m[1])
        };
        let gape_before_m = gape_m(model);
        let step_s = model.longest_step_s();
        let mut course = vec![[0.0, 1e3 * gape_before_m]];
        for step in 1..=SHOWN_STEPS {
            model.step(step_s);
            course.push([1e3 * step_s * step as f64, 1e3 * gape_m(model)]);
        }
        relax(model, step_s, AT_REST_M, MOST_STEPS)?;
        energies_j[2] = model.total_energy_j();
        Ok(Relaxed {
            before_m,
            after_m: displacements(&mesh, model),
            energies_j,
            gape_m: [gape_before_m, gape_m(model)],
            course,
            errors: [before, difference(&mesh, model)?],
            n_removed,
            mesh,
        })
    }

    fn relax_linear(&self, material: &LinearElastic) -> anyhow::Result<Relaxed> {
        let mut model = linear_model(&self.mesh, material, &self.fixed(&self.mesh), DAMPING_PER_S)?;
        self.relax(&mut model, |mesh, conditions| {
            let free_n = vec![DVec3::ZERO; mesh.positions_m.len()];
            linear_equilibrium(mesh, material, conditions, &free_n)
        })
    }

    fn relax_nonlinear(&self, material: &LinearElastic) -> anyhow::Result<Relaxed> {
        let fixed = self.fixed(&self.mesh);
        let mut model = nonlinear_model(&self.mesh, isotropic(material), &fixed, DAMPING_PER_S)?;
        self.relax(&mut model, |mesh, conditions| {
            let free_n = vec![DVec3::ZERO; mesh.positions_m.len()];
            Ok(nonlinear_equilibrium(mesh, &isotropic(material), conditions, &free_n)?.displacement_m)
        })
    }
}

fn notched_cylinder() -> anyhow::Result<Stretched> {
    let lip = |z_m: f64| DVec3::new(0.95 * CYLINDER_RADIUS_M, 0.0, 0.5 * CYLINDER_HEIGHT_M + z_m);
    Ok(Stretched {
        name: "cylinder",
        mesh: cylinder(CYLINDER_RADIUS_M, CYLINDER_HEIGHT_M, CYLINDER_TETS)?,
        is_fixed: |p| p.z < 0.02 * CYLINDER_HEIGHT_M,
        is_moved: |p| p.z > 0.98 * CYLINDER_HEIGHT_M,
        moved_m: TOP_M,
        is_removed: |c| (c.z - 0.5 * CYLINDER_HEIGHT_M).abs() < NOTCH_M && c.x > 0.0,
        lips_m: [lip(-2.5 * NOTCH_M), lip(2.5 * NOTCH_M)],
    })
}

/// The plate, cut from its upper edge downwards, or along its middle without reaching an edge.
fn plate(from_edge: bool) -> Stretched {
    let at = |x: f64, y: f64| DVec3::new(x, y, 0.5) * PLATE_M;
    Stretched {
        name: if from_edge { "plate, cut from the edge" } else { "plate, cut inside" },
        mesh: box_of_five(PLATE_CELLS, PLATE_M),
        is_fixed: |p| p.x > PLATE_M.x - 1e-9,
        is_moved: |p| p.x < 1e-9 && p.y > 0.6 * PLATE_M.y,
        moved_m: EDGE_M,
        is_removed: if from_edge {
            |c| (c.x - 0.525 * PLATE_M.x).abs() < 0.02 * PLATE_M.x && c.y > 0.4 * PLATE_M.y
        } else {
            |c| {
                (c.x - 0.525 * PLATE_M.x).abs() < 0.02 * PLATE_M.x
                    && (c.y - 0.5 * PLATE_M.y).abs() < 0.3 * PLATE_M.y
            }
        },
        lips_m: if from_edge { [at(0.475, 0.95), at(0.575, 0.95)] } else { [at(0.475, 0.5), at(0.575, 0.5)] },
    }
}

/// Lines of the plate's lower face along x and y through nodes that hang together, in the deformed plate [mm].
fn grid_lines(relaxed: &Relaxed) -> Vec<[f64; 2]> {
    let mesh = &relaxed.mesh;
    let places_m = displaced(mesh, &relaxed.after_m);
    let edges: BTreeSet<[NodeId; 2]> = mesh
        .tetrahedra
        .iter()
        .flat_map(|tet| tet.iter().flat_map(|&a| tet.iter().map(move |&b| [a, b])))
        .collect();
    let mut lower = nodes_where(mesh, |p| p.z < 1e-9);
    let mut points = Vec::new();
    for axis in 0..2 {
        // Along `axis` within a line, lines one after the other.
        let key = |n: &NodeId| {
            let p = mesh.positions_m[n.index()];
            (p[1 - axis], p[axis])
        };
        lower.sort_by(|a, b| key(a).0.total_cmp(&key(b).0).then(key(a).1.total_cmp(&key(b).1)));
        for (i, &node) in lower.iter().enumerate() {
            let hangs_on =
                i > 0 && edges.contains(&[lower[i - 1], node]) && key(&lower[i - 1]).0 == key(&node).0;
            if !hangs_on {
                points.push([f64::NAN; 2]);
            }
            let p = places_m[node.index()];
            points.push([1e3 * p.x, 1e3 * p.y]);
        }
    }
    points
}

/// The plate's outline before the cut [mm].
fn outline(stretched: &Stretched, before_m: &[DVec3]) -> Vec<[f64; 2]> {
    let mesh = &stretched.mesh;
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]];
    let mut points_m = Vec::new();
    for pair in corners.windows(2) {
        for i in 0..=30 {
            let share = f64::from(i) / 30.0;
            let at = |axis: usize| pair[0][axis] + share * (pair[1][axis] - pair[0][axis]);
            points_m.push(DVec3::new(at(0), at(1), 0.0) * PLATE_M);
        }
    }
    let places_m = TissuePoints::new(mesh, &points_m).at(mesh, &displaced(mesh, before_m));
    places_m.iter().map(|p| [1e3 * p.x, 1e3 * p.y]).collect()
}

fn plate_figure(file: &'static str, trial: &Trial<'_>) -> Figure {
    let Trial { body, relaxed, .. } = trial;
    let plot = LinePlot {
        title: format!("The {}", body.name),
        x_label: "x [mm]".into(),
        y_label: "y [mm]".into(),
        series: vec![
            series("before the cut", outline(body, &relaxed.before_m), SeriesStyle::Dashed),
            series("at rest after it", grid_lines(relaxed), SeriesStyle::Line),
        ],
        size: [820, 620],
    };
    let caption =
        format!("The {}, pulled at the upper left and held at the right (linear tensor-mass).", body.name);
    Figure { file, caption, plot }
}

/// A body under one law, relaxed.
struct Trial<'a> {
    body: &'a Stretched,
    law: &'static str,
    relaxed: Relaxed,
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let material = material()?;
    let bodies = [notched_cylinder()?, plate(true), plate(false)];
    let mut trials = Vec::new();
    for body in &bodies {
        trials.push(Trial { body, law: "linear", relaxed: body.relax_linear(&material)? });
        trials.push(Trial { body, law: "non-linear", relaxed: body.relax_nonlinear(&material)? });
    }
    // The trials of a body stand in the order of the laws.
    let [cylinder, edge, inside] = [0, 2, 4].map(|first| &trials[first..first + 2]);
    Ok(Outcome {
        experiments: trials.iter().flat_map(Trial::check).collect(),
        figures: vec![
            gape_figure(cylinder),
            plate_figure("prestress_plate_edge.svg", &edge[0]),
            plate_figure("prestress_plate_inside.svg", &inside[0]),
        ],
        notes: notes(&trials),
    })
}

impl Trial<'_> {
    fn check(&self) -> [Experiment; 2] {
        let title = |what: &str| format!("{} {}: {what}", self.law, self.body.name);
        let [_, cut_j, after_j] = self.relaxed.energies_j;
        [
            Experiment::at_most(
                &title("at rest against the equilibrium of what is left, relative"),
                "requirement",
                most(self.relaxed.errors),
                1e-6,
            ),
            Experiment::within(
                &title("energy at rest over energy right after the cut"),
                SEED,
                after_j / cut_j,
                [0.0, 0.999],
            ),
        ]
    }

    /// Its line of the table.
    fn row(&self) -> String {
        let Relaxed { n_removed, energies_j: [before_j, cut_j, after_j], gape_m, .. } = &self.relaxed;
        format!(
            "| {} | {} | {n_removed} of {} | {:.3} / {:.3} / {:.3} | {:.2} / {:.2} |\n",
            self.body.name,
            self.law,
            self.body.mesh.tetrahedra.len(),
            1e3 * before_j,
            1e3 * cut_j,
            1e3 * after_j,
            1e3 * gape_m[0],
            1e3 * gape_m[1],
        )
    }

    /// How far the lips are apart in time, and at rest.
    fn gape_series(&self) -> [Series; 2] {
        let course = &self.relaxed.course;
        let last_ms = course.last().map_or(0.0, |p| p[0]);
        let rest_mm = 1e3 * self.relaxed.gape_m[1];
        [
            series(self.law, course.clone(), SeriesStyle::Line),
            series(
                &format!("{}, at rest", self.law),
                vec![[0.0, rest_mm], [last_ms, rest_mm]],
                SeriesStyle::Dashed,
            ),
        ]
    }
}

fn gape_figure(trials: &[Trial<'_>]) -> Figure {
    let plot = LinePlot {
        title: "The notch of the pre-stressed cylinder opens".into(),
        x_label: "time since the cut [ms]".into(),
        y_label: "distance of the lips [mm]".into(),
        series: trials.iter().flat_map(Trial::gape_series).collect(),
        size: [720, 440],
    };
    let caption =
        "Distance between two points above and below the notch of the stretched cylinder.".to_owned();
    Figure { file: "prestress_gape.svg", caption, plot }
}

fn notes(trials: &[Trial<'_>]) -> String {
    let rows: String = trials.iter().map(Trial::row).collect();
    format!(
        "The cylinder ({} mm radius, {} mm high) is held below, its top moved by {} mm upwards and {} mm aside; then a \
         notch is cut from the side to the axis. The plate ({} x {} x {} mm) is held at its right edge, the upper part of \
         the left one moved by {} mm to the left and {} mm upwards.\n\n\
         | body | law | removed tetrahedra | energy before / right after the cut / at rest [mJ] | distance of the lips \
         before / after [mm] |\n|---|---|---|---|---|\n{rows}\n\
         Agrees: the bodies leave their equilibrium when tetrahedra go and come to rest in a new one, which is that of a \
         model built from what is left. The seed shows pictures without numbers.",
        1e3 * CYLINDER_RADIUS_M,
        1e3 * CYLINDER_HEIGHT_M,
        1e3 * TOP_M.z,
        1e3 * TOP_M.x,
        1e3 * PLATE_M.x,
        1e3 * PLATE_M.y,
        1e3 * PLATE_M.z,
        -1e3 * EDGE_M.x,
        1e3 * EDGE_M.y,
    )
}
