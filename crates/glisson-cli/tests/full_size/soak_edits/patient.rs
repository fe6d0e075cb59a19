//! One body with its tools, vessels, loads and ligaments that random edits are made on.

use super::attached::Attached;
use super::before::LastEdit;
use super::draw::Draw;
use super::instruments::{N_TOOLS, tools};
use super::substance::{DENSITY_KG_PER_M3, Held, Substance, torn_material};
use super::tally::Tally;
use glisson::image::vessels::Tube;
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::mesh::topology::Topology;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::{Attachment, DeformableModel};
use glisson::tool::ToolInput;
use glisson::tool::fracture::{FractureEnergy, Tearing};
use glisson::world::spec::{Ligament, Load, LoadTime, Region, Support, WorldSpec, attachments, fixed_nodes};
use glisson::world::{StepInput, StepReport, World};

/// Soft, so that pulling tears within reach of the jaws: a choice of the test, a quarter of liver's.
const BRITTLE: FractureEnergy = FractureEnergy { energy_j_per_m2: 41.0 };
/// Edits that can be undone: more than one call of the tools can make.
const UNDO_DEPTH: usize = 512;
/// A force that pieces which come loose do not fly away under.
const LOAD_N: f64 = 1e-5;
/// A force on a tool above this is wild [N]: no tissue of these bodies bears it.
pub(super) const WILD_N: f64 = 100.0;

/// Three branches from the middle, and a root.
fn tubes(mesh: &TetMesh, middle_m: DVec3, random: &mut SeededRandom) -> Vec<Tube> {
    let n = mesh.tetrahedra.len();
    let centroid = |t: usize| mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
    let nearest =
        (0..n).min_by(|&a, &b| centroid(a).distance(middle_m).total_cmp(&centroid(b).distance(middle_m)));
    let hub_m = centroid(nearest.expect("a body has tetrahedra"));
    // Anywhere in a tetrahedron: from centroid to centroid a tube runs through nodes and edges of a regular mesh, where it
    // is a matter of rounding whether a triangle severs it.
    let mut places = SeededRandom::new(n as u64);
    let mut ends = std::iter::repeat_with(|| {
        let tet = TetId::from_index(((random.uniform() * n as f64) as usize).min(n - 1));
        let weights = [0; 4].map(|_| places.uniform_in(0.1, 1.0));
        let sum_m: DVec3 = mesh.corners_m(tet).into_iter().zip(weights).map(|(p, w)| p * w).sum();
        sum_m / weights.iter().sum::<f64>()
    })
    .filter(|end_m| end_m.distance(hub_m) > 5e-3);
    let mut end_m = || ends.next().expect("they do not run out");
    let root = Tube { parent: None, ends_m: [end_m(), hub_m], radii_m: [1e-3; 2] };
    let branch = |end_m| Tube { parent: Some(0), ends_m: [hub_m, end_m], radii_m: [8e-4, 5e-4] };
    vec![root, branch(end_m()), branch(end_m()), branch(end_m())]
}

pub(super) struct Patient<'a> {
    name: &'a str,
    pub(super) draw: Draw,
    pub(super) substance: Substance,
    pub(super) world: World,
    pub(super) attached: Attached,
    /// Of everything live, as the model has it on its free nodes [kg].
    pub(super) mass_kg: f64,
    pub(super) mean_edge_m: f64,
    pub(super) away: [ToolInput; N_TOOLS],
    pub(super) random: SeededRandom,
    /// Nodes of tetrahedra that edits changed since a stroke began.
    pub(super) touched: Vec<NodeId>,
    /// Ends of the edges that were too short to be divided when strokes ended.
    pub(super) left: Vec<[NodeId; 2]>,
    /// Whether an edge of a tool was lifted since its stroke began, for want of tissue, and what that parted was undone.
    pub(super) is_parting_taken_back: bool,
    /// What it takes to take the last edit back in the oracle.
    pub(super) last_edit: Option<LastEdit>,
    pub(super) tally: Tally,
}

/// What a seed's body is before it has a model.
struct Shape {
    middle_m: DVec3,
    mean_edge_m: f64,
    /// Tools that nobody uses are here.
    away: ToolInput,
}

impl Shape {
    fn of(mesh: &TetMesh) -> Self {
        let bounds = Aabb::of_points(&mesh.positions_m);
        let topology = Topology::build(mesh).unwrap();
        let lengths = topology.live_edges().map(|e| {
            let [a, b] = topology.edge_nodes(e).map(|n| mesh.positions_m[n.index()]);
            a.distance(b)
        });
        Self {
            middle_m: 0.5 * (bounds.min_m + bounds.max_m),
            mean_edge_m: lengths.sum::<f64>() / topology.live_counts().edges as f64,
            away: ToolInput::at(bounds.min_m - DVec3::splat(0.3), -DVec3::Y),
        }
    }
}

/// The scene of a seed, but for the time step, and what depends on it.
fn scene(name: &str, mesh: &TetMesh, draw: &Draw, random: &mut SeededRandom, shape: &Shape) -> WorldSpec {
    let first_step_s = draw.time_steps_s[0];
    let [grasper, ..] = tools(draw, shape.mean_edge_m, first_step_s, shape.away);
    let mut spec = WorldSpec::new(name, first_step_s, grasper);
    let furthest = |direction: DVec3, fraction: f64| Region::Furthest { direction, fraction };
    spec.supports.push(Support::all_axes(furthest(DVec3::Y, 0.15)));
    let load = |direction: DVec3, time: LoadTime| Load {
        region: furthest(direction, 0.2),
        force_n: LOAD_N * DVec3::new(0.3, -0.5, 0.8),
        time,
    };
    spec.loads.push(load(DVec3::X, LoadTime::Always));
    spec.loads.push(load(-DVec3::Z, LoadTime::During { from_s: 0.05, to_s: 0.3 }));
    if draw.knows_ligaments() {
        spec.ligaments.push(Ligament {
            region: furthest(-DVec3::Y, 0.05),
            direction: -DVec3::Y,
            length_m: 0.05,
            stiffness_n_per_m: 20.0,
        });
    }
    spec.vessels = tubes(mesh, shape.middle_m, random);
    spec.tearing = draw.tears.then_some(Tearing { energy: BRITTLE, material: torn_material() });
    spec.mends_cuts = draw.mends_cuts;
    spec
}

/// A model in the first of the drawn time steps that it takes, and that step [s].
fn model_in_step(draw: &Draw, substance: &Substance, on: &Held<'_>) -> (Box<dyn DeformableModel>, f64) {
    let mut refusals = Vec::new();
    for &time_step_s in &draw.time_steps_s {
        match substance.model(on, time_step_s) {
            Ok(model) => return (model, time_step_s),
            Err(refusal) => refusals.push(refusal),
        }
    }
    panic!("no model in any step: {refusals:?}");
}

impl<'a> Patient<'a> {
    pub(super) fn new(name: &'a str, mesh: &TetMesh, draw: Draw) -> Self {
        let mut random = SeededRandom::new(draw.seed);
        let shape = Shape::of(mesh);
        let mut spec = scene(name, mesh, &draw, &mut random, &shape);
        let middle_m = shape.middle_m;
        let number_of = |t: usize| {
            let place_m = mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
            u8::from(place_m.x > middle_m.x) + u8::from(place_m.z > middle_m.z)
        };
        let material: Vec<u8> = (0..mesh.tetrahedra.len()).map(number_of).collect();
        let substance = Substance::of(&draw);
        let fixed = fixed_nodes(&spec.supports, &mesh.positions_m);
        let ligaments: Vec<Attachment> = attachments(&spec.ligaments, &mesh.positions_m);
        let on = Held { mesh, material: &material, fixed: &fixed, ligaments: &ligaments };
        let (model, time_step_s) = model_in_step(&draw, &substance, &on);
        spec.time_step_s = time_step_s;
        spec.self_contact = draw.self_contact(time_step_s);
        spec.tools = tools(&draw, shape.mean_edge_m, time_step_s, shape.away).into();
        let mut world = World::new(spec, mesh.clone(), model, draw.kind).unwrap();
        world.set_undo_depth(UNDO_DEPTH);
        world.keep_changes();
        Self {
            name,
            attached: Attached::new(&world, material, ligaments),
            draw,
            substance,
            world,
            mass_kg: mesh.volume_m3() * DENSITY_KG_PER_M3,
            mean_edge_m: shape.mean_edge_m,
            away: [shape.away; N_TOOLS],
            random,
            touched: Vec::new(),
            left: Vec::new(),
            is_parting_taken_back: false,
            last_edit: None,
            tally: Tally::default(),
        }
    }

    pub(super) fn label(&self) -> String {
        self.label_at(&self.tally)
    }

    /// Where the seed is when so much has happened.
    pub(super) fn label_at(&self, tally: &Tally) -> String {
        let (draw, edits, step) = (&self.draw, tally.edits(), self.world.steps_made());
        let (seed, kind, law) = (draw.seed, draw.kind, draw.law_name());
        format!("{}, seed {seed}, {kind}, {law}, edit {edits}, step {step}", self.name)
    }

    pub(super) fn step(&mut self, tools: &[ToolInput; N_TOOLS], placed: bool) {
        let input = StepInput::of(tools);
        let number = self.world.steps_made();
        let report = self.world.step(&if placed { input.placed() } else { input });
        self.tally.simulated_s += self.world.spec().time_step_s;
        self.note_forces(&report);
        self.check_finite(&report);
        self.attached.check_loads(&self.world, number, &self.label());
    }

    fn note_forces(&mut self, report: &StepReport) {
        let forces_n = report.tools.iter().map(|tool| tool.force_on_tool_n.length());
        let greatest_n = forces_n.fold(0.0, f64::max);
        self.tally.wild_steps += u64::from(greatest_n > WILD_N);
        self.tally.greatest_force_n = self.tally.greatest_force_n.max(greatest_n);
        self.tally.recovered_nodes += u64::from(report.model.n_recovered_nodes);
        self.tally.limited_steps += u64::from(report.model.energy_was_limited);
    }

    /// Counts numbers of the step that are not finite.
    fn check_finite(&mut self, report: &StepReport) {
        let state = self.world.state();
        let not_finite = |list: &[DVec3]| list.iter().filter(|v| !v.is_finite()).count();
        let forces_n = report.tools.map(|tool| tool.force_on_tool_n);
        let found = [
            ("positions", report.n_non_finite_nodes as usize + not_finite(state.positions_m)),
            ("velocities", not_finite(state.velocities_m_per_s)),
            ("history", self.world.history().iter().filter(|x| !x.is_finite()).count()),
            ("forces", not_finite(&forces_n)),
            ("energies", usize::from(!report.model.kinetic_energy_j.is_finite())),
        ];
        let n: usize = found.iter().map(|(_, n)| n).sum();
        self.tally.non_finite += n as u64;
        assert!(n == 0, "{}: not finite: {found:?}, {:?}", self.label(), report.model);
    }

    pub(super) fn index(&mut self, n: usize) -> usize {
        ((self.random.uniform() * n as f64) as usize).min(n - 1)
    }

    /// A place on the surface now, with its outward normal; none when nothing is left.
    pub(super) fn place(&mut self) -> Option<(DVec3, DVec3)> {
        let n = self.world.organ().surface_nodes().len();
        if n == 0 {
            return None;
        }
        let at = self.index(n);
        let organ = self.world.organ();
        let node = organ.surface_nodes()[at];
        let positions_m = self.world.state().positions_m;
        let normal = organ.body().topology().node_normal(node, positions_m);
        Some((positions_m[node.index()], normal.try_normalize()?))
    }

    /// A way along a surface with this normal.
    pub(super) fn way_along(&mut self, normal: DVec3) -> DVec3 {
        loop {
            let any = DVec3::new(self.random.normal(), self.random.normal(), self.random.normal());
            if let Some(along) = (any - normal * any.dot(normal)).try_normalize() {
                return along;
            }
        }
    }
}
