//! The reduced non-linear model against the full non-linear solution of the same law, beside the linear model.

use super::{Experiment, Figure, Outcome, series};
use crate::bodies::{largest, linear_equilibrium, liver, nodes_where, spread_over};
use anyhow::Context;
use glisson::material::{LinearElastic, StVenantKirchhoff};
use glisson::math::{Aabb, DVec3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::precomputed::StoredNodes;
use glisson::model::reduced::{Reduced, ReducedParams};
use glisson::model::{Constraints, DeformableModel, FixedNode, ImposedDisplacement, NodalForce};
use glisson::solve::StaticProblem;
use glisson::solve::{
    BoundaryConditions, NonlinearProblem, NonlinearSettings, solve_nonlinear, solve_static,
};
use glisson_report::plot::{LinePlot, SeriesStyle};

const SOURCE: &str = "full Newton solution of St Venant and Kirchhoff's law (part B)";
const YOUNG_MODULUS_PA: f64 = 5_000.0;
const POISSON_RATIO: f64 = 0.4;
const DENSITY_KG_PER_M3: f64 = 1_000.0;
/// Vibrations and reduced coordinates that are compared; the experiments judge the second.
const SIZES: [[usize; 2]; 3] = [[6, 20], [10, 30], [10, 40]];
const JUDGED: usize = 1;
/// The same for a basis with the answers to forces on the place that is touched.
const SIZE_WITH_LOADS: [usize; 2] = [6, 40];
/// Share of a load that is added in each step of the reduced model: a tool does not jump.
const N_STEPS: usize = 10;

/// What is done to a body: forces of a size, or some nodes moved together.
enum Load {
    /// Force on each node for a total of 1 N.
    Force(Vec<DVec3>),
    /// Nodes and the direction in which they are moved.
    Moved(Vec<NodeId>, DVec3),
}

struct Case {
    name: &'static str,
    /// Of its figure.
    file: &'static str,
    about: String,
    mesh: TetMesh,
    fixed: Vec<NodeId>,
    load: Load,
    /// Forces whose answers one further model has in its basis; that one is judged then.
    known_loads: Vec<Vec<DVec3>>,
    /// Largest linear displacement of the three loads [m].
    linear_m: [f64; 3],
    /// By how much the judged model must be nearer than the linear one at the largest load.
    least_gain: f64,
}

/// Displacements [m] and, where nodes are moved, the force on them along the motion [N].
struct Answer {
    displacement_m: Vec<DVec3>,
    force_n: f64,
}

impl Case {
    fn is_moved(&self) -> bool {
        matches!(self.load, Load::Moved(..))
    }

    /// Largest displacement of the linear body under a unit of the load [m].
    fn unit_m(&self, material: &LinearElastic) -> anyhow::Result<f64> {
        let Load::Force(force_n) = &self.load else { return Ok(1.0) };
        let fixed = BoundaryConditions::fixed(&self.fixed);
        Ok(largest(&linear_equilibrium(&self.mesh, material, &fixed, force_n)?))
    }

    fn conditions(&self, moved_m: f64) -> BoundaryConditions {
        let mut conditions = BoundaryConditions::fixed(&self.fixed);
        if let Load::Moved(nodes, direction) = &self.load {
            nodes.iter().for_each(|&n| conditions.impose_node(n, *direction * moved_m));
        }
        conditions
    }

    /// The load of this size as forces on all nodes.
    fn forces(&self, size: f64) -> Vec<DVec3> {
        match &self.load {
            Load::Force(unit_n) => unit_n.iter().map(|f| *f * size).collect(),
            Load::Moved(..) => vec![DVec3::ZERO; self.mesh.positions_m.len()],
        }
    }

    fn constraints(&self, size: f64) -> Constraints {
        let forces = self.forces(size).into_iter().enumerate().filter(|(_, f)| *f != DVec3::ZERO);
        let forces = forces.map(|(n, force_n)| NodalForce { node: NodeId::from_index(n), force_n }).collect();
        let displacements = match &self.load {
            Load::Force(_) => Vec::new(),
            Load::Moved(nodes, direction) => nodes
                .iter()
                .map(|&node| ImposedDisplacement { node, displacement_m: *direction * size })
                .collect(),
        };
        Constraints { displacements, forces }
    }

    fn force_along(&self, on_node: impl Fn(usize, NodeId) -> DVec3) -> f64 {
        match &self.load {
            Load::Force(_) => 0.0,
            Load::Moved(nodes, d) => nodes.iter().enumerate().map(|(i, &n)| on_node(i, n).dot(*d)).sum(),
        }
    }

    fn linear(&self, material: &LinearElastic, size: f64) -> anyhow::Result<Answer> {
        let (conditions, force_n) = (self.conditions(size), self.forces(size));
        let (mesh, conditions, nodal_force_n) = (&self.mesh, &conditions, &force_n[..]);
        let solution = solve_static(&StaticProblem { mesh, material, conditions, nodal_force_n })?;
        let force_n = self.force_along(|_, n| solution.reaction_n[n.index()]);
        Ok(Answer { displacement_m: solution.displacement_m, force_n })
    }

    fn full(&self, material: &LinearElastic, size: f64) -> anyhow::Result<Answer> {
        let laws = [StVenantKirchhoff::from(material)];
        let (conditions, force_n) = (self.conditions(size), self.forces(size));
        let (mesh, conditions, nodal_force_n) = (&self.mesh, &conditions, &force_n[..]);
        let settings = NonlinearSettings::default();
        let problem = NonlinearProblem { mesh, laws: &laws, conditions, nodal_force_n, settings };
        let solution = solve_nonlinear(&problem).with_context(|| format!("{} at {size}", self.name))?;
        let force_n = self.force_along(|_, n| solution.reaction_n[n.index()]);
        Ok(Answer { displacement_m: solution.displacement_m, force_n })
    }

    /// The reduced model, its load growing in steps; with the most Newton iterations of a step.
    fn reduced(&self, model: &mut Reduced, size: f64) -> (Answer, u32) {
        model.take_over(&self.mesh.positions_m);
        let mut most_iterations = 0;
        for step in 1..=N_STEPS {
            model.apply(&self.constraints(size * step as f64 / N_STEPS as f64));
            model.step(1e-3);
            let solution = model.solution();
            most_iterations =
                most_iterations.max(if solution.converged { solution.n_iterations } else { u32::MAX });
        }
        let displacement_m = crate::bodies::displacements(&self.mesh, model);
        let force_n = self.force_along(|i, _| model.constraint_forces_n()[i]);
        (Answer { displacement_m, force_n }, most_iterations)
    }
}

/// A bar held at one end, its other end pulled aside.
fn bar() -> anyhow::Result<Case> {
    let size_m = DVec3::new(0.02, 0.02, 0.12);
    let mesh = box_of_five([4, 4, 24], size_m);
    let fixed = nodes_where(&mesh, |p| p.z < 1e-9);
    let end = nodes_where(&mesh, |p| p.z > size_m.z - 1e-9);
    let load = Load::Force(spread_over(&mesh, &end, DVec3::X)?);
    Ok(Case {
        name: "bar",
        file: "reduced_bar.svg",
        about: "A bar of 20 x 20 x 120 mm, held at one end, the other end pulled aside".into(),
        mesh,
        fixed,
        load,
        known_loads: Vec::new(),
        linear_m: [0.01, 0.04, 0.09],
        least_gain: 30.0,
    })
}

/// The synthetic liver, held behind; nodes of the front.
fn held_liver() -> anyhow::Result<(TetMesh, Vec<NodeId>, Aabb)> {
    let mesh = liver(2_000)?;
    let bounds = Aabb::of_points(&mesh.positions_m);
    let behind_m = bounds.max_m.y - 0.25 * bounds.size_m().y;
    let fixed = nodes_where(&mesh, |p| p.y > behind_m);
    Ok((mesh, fixed, bounds))
}

fn bent_liver() -> anyhow::Result<Case> {
    let (mesh, fixed, bounds) = held_liver()?;
    let front_m = bounds.min_m.y + 0.2 * bounds.size_m().y;
    let front = nodes_where(&mesh, |p| p.y < front_m);
    let load = Load::Force(spread_over(&mesh, &front, DVec3::new(0.3, 0.0, -1.0).normalize())?);
    Ok(Case {
        name: "liver",
        file: "reduced_liver.svg",
        about: format!(
            "The synthetic liver in {} tetrahedra, held behind, its front pulled down",
            mesh.tetrahedra.len()
        ),
        mesh,
        fixed,
        load,
        known_loads: Vec::new(),
        linear_m: [0.01, 0.03, 0.06],
        least_gain: 15.0,
    })
}

/// Radius of the spot of surface that a tool moves [m].
const SPOT_M: f64 = 0.025;

fn poked_liver() -> anyhow::Result<Case> {
    let (mesh, fixed, _) = held_liver()?;
    let front =
        mesh.positions_m.iter().copied().min_by(|a, b| a.y.total_cmp(&b.y)).context("an empty mesh")?;
    let surface = glisson::solve::boundary_nodes(&mesh);
    let is_near = |n: &NodeId| mesh.positions_m[n.index()].distance(front) < SPOT_M;
    let spot: Vec<NodeId> = surface.into_iter().filter(is_near).collect();
    let unit_n = |axis: DVec3| {
        let mut force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        spot.iter().for_each(|n| force_n[n.index()] = axis);
        force_n
    };
    let known_loads = DVec3::AXES.map(unit_n).to_vec();
    Ok(Case {
        name: "poke",
        file: "reduced_poke.svg",
        about: format!(
            "The same liver, {} nodes of its foremost edge moved up and back by a tool",
            spot.len()
        ),
        mesh,
        fixed,
        load: Load::Moved(spot, DVec3::new(0.0, 0.5, 1.0).normalize()),
        known_loads,
        linear_m: [0.004, 0.008, 0.016],
        least_gain: 1.5,
    })
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    for case in [bar()?, bent_liver()?, poked_liver()?] {
        compare(&mut outcome, &case)?;
    }
    outcome.notes += "\nErrors are the largest distance of a node from where the full solution has it, over the largest displacement.\n\n\
                      What bends or turns as a whole is followed by a few modes and their derivatives. A dent is not: without its place in the basis its \
                      non-linearity is missing, and the reduced model is no nearer than the linear one (its force is, a little). With the answers to forces at \
                      that place, and their derivatives, among the modes, about half of the error goes, and most of that of the force. A tool that \
                      goes anywhere needs the full models, or a basis for the places that matter.\n";
    Ok(outcome)
}

fn compare(outcome: &mut Outcome, case: &Case) -> anyhow::Result<()> {
    let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?;
    let mut models = Models::build(case, &material)?;
    let unit_m = case.unit_m(&material)?;
    outcome.notes += &table_head(case, &models);
    let mut compared = Vec::new();
    for linear_m in case.linear_m {
        let size = linear_m / unit_m;
        let found = Compared::new(case, &material, &mut models, size)?;
        anyhow::ensure!(
            found.most_iterations != u32::MAX,
            "{}: the reduced model did not converge at {size}",
            case.name
        );
        outcome.notes += &found.row();
        compared.push(found);
    }
    let last = compared.last().context("a case without loads")?;
    outcome.experiments.push(Experiment::at_most(
        &format!(
            "{}, largest load: error of the reduced model ({}) over the linear one's",
            case.name,
            models.judged_name()
        ),
        SOURCE,
        last.reduced[models.judged].shape / last.linear.shape,
        1.0 / case.least_gain,
    ));
    outcome.figures.push(figure(case, &models, &compared));
    Ok(())
}

/// The reduced models of a case with their names, and which of them is judged.
struct Models {
    models: Vec<(String, Reduced)>,
    judged: usize,
}

impl Models {
    fn build(case: &Case, material: &LinearElastic) -> anyhow::Result<Self> {
        let fixed: Vec<FixedNode> = case.fixed.iter().copied().map(FixedNode::all_axes).collect();
        let params = |[n_modes, n_reduced]: [usize; 2]| ReducedParams {
            n_modes,
            n_reduced,
            stored: StoredNodes::All,
            ..ReducedParams::new(&case.mesh, material, &fixed)
        };
        let mut models = Vec::new();
        for size in SIZES {
            let model = Reduced::build(&params(size))?;
            models.push((format!("r = {}", model.n_reduced()), model));
        }
        let mut judged = JUDGED;
        if !case.known_loads.is_empty() {
            let model =
                Reduced::build(&ReducedParams { loads: &case.known_loads, ..params(SIZE_WITH_LOADS) })?;
            judged = models.len();
            models.push((format!("r = {}, place in the basis", model.n_reduced()), model));
        }
        Ok(Self { models, judged })
    }

    fn judged_name(&self) -> &str {
        &self.models[self.judged].0
    }
}

/// How far a model is from the full solution: of shapes, and of the force on moved nodes where there are any.
#[derive(Clone, Copy)]
struct Off {
    shape: f64,
    force: Option<f64>,
}

impl Off {
    fn cell(&self) -> String {
        let force = self.force.map_or(String::new(), |off| format!(" ({:.2})", 100.0 * off));
        format!("{:.3}{force} |", 100.0 * self.shape)
    }
}

/// A load by all models.
struct Compared {
    /// Of the full solution.
    largest_m: f64,
    linear: Off,
    reduced: Vec<Off>,
    /// Of the judged model in one of its steps.
    most_iterations: u32,
}

impl Compared {
    fn new(case: &Case, material: &LinearElastic, models: &mut Models, size: f64) -> anyhow::Result<Self> {
        let full = case.full(material, size)?;
        let largest_m = largest(&full.displacement_m);
        let off = |answer: &Answer| {
            let apart = answer.displacement_m.iter().zip(&full.displacement_m).map(|(a, b)| *a - *b);
            let force = case.is_moved().then(|| (answer.force_n / full.force_n - 1.0).abs());
            Off { shape: largest(&apart.collect::<Vec<_>>()) / largest_m, force }
        };
        let linear = off(&case.linear(material, size)?);
        let (mut reduced, mut most_iterations) = (Vec::new(), 0);
        for (place, (_, model)) in models.models.iter_mut().enumerate() {
            let (answer, n_iterations) = case.reduced(model, size);
            reduced.push(off(&answer));
            if place == models.judged {
                most_iterations = n_iterations;
            }
        }
        Ok(Self { largest_m, linear, reduced, most_iterations })
    }

    fn row(&self) -> String {
        let reduced: String = self.reduced.iter().map(|off| format!(" {}", off.cell())).collect();
        format!(
            "| {:.1} | {}{reduced} {} |\n",
            1e3 * self.largest_m,
            self.linear.cell(),
            self.most_iterations
        )
    }
}

fn table_head(case: &Case, models: &Models) -> String {
    let mut head = format!(
        "\n### {}: {}\n\n| largest displacement, full [mm] | error of the linear model [%] |",
        case.name, case.about
    );
    let of_force = if case.is_moved() { " (of the force [%])" } else { "" };
    for (name, _) in &models.models {
        head += &format!(" {name}{of_force} |");
    }
    head += &format!(" Newton iterations a step, {}, at most |\n|---|---|", models.judged_name());
    head += &"---|".repeat(models.models.len() + 1);
    head += "\n";
    head
}

fn figure(case: &Case, models: &Models, compared: &[Compared]) -> Figure {
    let line = |off: &dyn Fn(&Compared) -> Off| -> Vec<[f64; 2]> {
        let points = compared.iter().map(|c| [1e3 * c.largest_m, 100.0 * off(c).shape]);
        std::iter::once([0.0; 2]).chain(points).collect()
    };
    let mut all = vec![series("linear", line(&|c| c.linear), SeriesStyle::Dashed)];
    all.extend(
        models
            .models
            .iter()
            .enumerate()
            .map(|(place, (name, _))| series(name, line(&|c| c.reduced[place]), SeriesStyle::Line)),
    );
    Figure {
        file: case.file,
        caption: format!(
            "{}: error of the linear and the reduced non-linear model against the full one.",
            case.about
        ),
        plot: LinePlot {
            title: format!("Error against the full non-linear solution: {}", case.name),
            x_label: "largest displacement [mm]".into(),
            y_label: "largest error [% of it]".into(),
            series: all,
            size: [720, 440],
        },
    }
}
