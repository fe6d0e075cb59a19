//! A block of tissue, two instruments, and what a hand should not do with them: random violent motions, each of a seed.

use super::work::{Work, WorkMeter};
use anyhow::ensure;
use glisson::contact::response::self_contact::SelfContactParams;
use glisson::material::{LawChoice, LinearElastic, law_named};
use glisson::math::{DVec3, SeededRandom, is_inverted, tetrahedron_volume_m3};
use glisson::mesh::TetMesh;
use glisson::model::kind::ModelKind;
use glisson::model::{MeasuredSample, ModelMotion, OrganBody, Rayleigh};
use glisson::record::snapshot::Snapshot;
use glisson::scene::build_model;
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind};
use glisson::world::spec::{Hand, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

/// Liver's order of magnitude [Pa]; forces are in proportion to it.
const YOUNG_PA: f64 = 5e3;
/// Nearly incompressible, as soft tissue is: a choice.
const POISSON_RATIO: f64 = 0.45;
const DENSITY_KG_PER_M3: f64 = 1060.0;
/// Near the critical damping of the slowest motions of the block [1/s]. A choice.
const DAMPING_PER_S: f64 = 60.0;
/// Friction that tissue wet with blood has on steel is about that: asked for by the requirement.
const SLIPPERY: f64 = 0.05;
/// Where instruments that are not used are.
const AWAY_M: DVec3 = DVec3::new(0.0, 0.0, 0.25);
/// Where the second instrument waits: beside the first.
const ASIDE_M: DVec3 = DVec3::new(0.1, 0.0, 0.25);
const FAST_M_PER_S: f64 = 5.0;
/// After the tools left: when no tetrahedron may be inverted, and when all is at rest [s].
const UPRIGHT_AFTER_S: f64 = 0.5;
const AT_REST_AFTER_S: f64 = 2.0;
/// Steps shorter than this [s] are not tried.
const SHORTEST_STEP_S: f64 = 1e-5;

/// A model and the law it follows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject {
    pub(crate) kind: ModelKind,
    /// None: springs without a law.
    pub(crate) law: Option<&'static str>,
    /// The longest step that is tried [s]; halved until the model takes it.
    pub(crate) step_s: f64,
}

impl Subject {
    /// Every model with every law that it follows.
    pub(crate) fn all() -> Vec<Self> {
        let of_kind = |kind: ModelKind| {
            let step_s = if kind.row().motion == ModelMotion::Implicit { 2e-3 } else { 1e-3 };
            let laws = kind.laws();
            let laws = if laws.is_empty() { vec![None] } else { laws.into_iter().map(Some).collect() };
            laws.into_iter().map(move |law| Self { kind, law, step_s })
        };
        ModelKind::ALL.into_iter().flat_map(of_kind).collect()
    }

    /// The same of these models; of all for none.
    ///
    /// # Errors
    /// For a model that there is not.
    pub(crate) fn of_models(models: &[String]) -> anyhow::Result<Vec<Self>> {
        let known = ModelKind::ALL.map(ModelKind::name);
        for name in models {
            ensure!(known.contains(&name.as_str()), "no model {name:?}; there are: {}", known.join(", "));
        }
        let is_named = |subject: &Self| models.is_empty() || models.iter().any(|m| m == subject.kind.name());
        Ok(Self::all().into_iter().filter(is_named).collect())
    }
}

/// A block of tissue that stands on a table: its top at z = 0, its middle at x = y = 0.
#[derive(Clone)]
pub(crate) struct Block {
    pub(crate) mesh: TetMesh,
    pub(crate) size_m: DVec3,
    /// For the models that follow measured curves.
    pub(crate) measured: Option<MeasuredSample>,
}

impl Block {
    /// A block of a mesh whose lowest corner is the origin.
    pub(crate) fn new(mut mesh: TetMesh, size_m: DVec3) -> Self {
        mesh.positions_m.iter_mut().for_each(|p| *p -= DVec3::new(0.5, 0.5, 1.0) * size_m);
        Self { mesh, size_m, measured: None }
    }

    /// With a probe and a grasper.
    ///
    /// # Errors
    /// What the model says when it takes no step.
    pub(crate) fn world(
        &self,
        subject: &Subject,
        friction: f64,
        hand: Option<Hand>,
    ) -> Result<World, String> {
        let supports = vec![Support::all_axes(Region::Furthest { direction: -DVec3::Z, fraction: 0.15 })];
        let home = ToolInput::at(AWAY_M, DVec3::Z);
        let grip = Grip { friction_coefficient: friction, is_sticky: false };
        let probe = Tool { grip, ..Tool::probe("probe", 3e-3, home) };
        let jaws = Jaws { length_m: 0.02, width_m: 5e-3, greatest_opening_rad: 1.0, closing_force_n: 50.0 };
        let kind = ToolKind::grasper(jaws);
        let grip = Grip { friction_coefficient: 1.0, is_sticky: false };
        let home = ToolInput::at(ASIDE_M, DVec3::Z);
        let grasper = Tool { kind, grip, ..Tool::probe("grasper", 2e-3, home) };
        let material = LinearElastic::from_young_poisson(YOUNG_PA, POISSON_RATIO, DENSITY_KG_PER_M3)
            .map_err(|error| error.to_string())?;
        let mut step_s = subject.step_s;
        loop {
            let mut body = OrganBody::new(self.mesh.clone(), material, step_s);
            body.law = subject.law.and_then(law_named).map(|law| LawChoice::typical(law.entry()));
            body.fixed = fixed_nodes(&supports, &self.mesh.positions_m);
            body.damping = Rayleigh::of_mass(DAMPING_PER_S);
            body.measured.clone_from(&self.measured);
            match build_model(&body, subject.kind) {
                Ok(model) => {
                    let mut spec = WorldSpec::new("block", step_s, probe);
                    spec.tools.push(grasper);
                    spec.supports = supports;
                    spec.hand = hand;
                    spec.tissue = Some(material);
                    spec.self_contact = Self::touches_itself(subject.kind, step_s);
                    return World::new(spec, self.mesh.clone(), model, subject.kind)
                        .map_err(|error| error.to_string());
                }
                Err(error) if step_s < 2.0 * SHORTEST_STEP_S => return Err(error.to_string()),
                Err(_) => step_s *= 0.5,
            }
        }
    }

    /// The block touches itself where the model can answer that: pressed between two tools it would fold into itself, and such a fold
    /// is at rest with every tetrahedron upright.
    fn touches_itself(kind: ModelKind, step_s: f64) -> Option<SelfContactParams> {
        let response = SelfContactParams::geometric(SelfContactParams::DEFAULT_FRICTION);
        let margin_m = SelfContactParams::default_margin_m(step_s);
        kind.row().corrects_steps.then_some(SelfContactParams { margin_m, response })
    }

    /// Numbers of the tetrahedra that are inverted or flat.
    pub(crate) fn inverted(&self, world: &World) -> Vec<usize> {
        let positions_m = world.state().positions_m;
        let volume_m3 = |nodes: &[_; 4]| {
            tetrahedron_volume_m3(nodes.map(|n: glisson::mesh::NodeId| positions_m[n.index()]))
        };
        let tets = self.mesh.tetrahedra.iter().enumerate();
        tets.filter(|(_, nodes)| is_inverted(volume_m3(nodes))).map(|(t, _)| t).collect()
    }

    /// How far the node that is furthest from its place at rest is from there [m].
    pub(crate) fn most_off_m(&self, world: &World) -> f64 {
        let pairs = world.state().positions_m.iter().zip(&self.mesh.positions_m);
        pairs.map(|(now_m, rest_m)| now_m.distance(*rest_m)).fold(0.0, greater)
    }
}

/// The greater of two numbers; what is no number is the greatest.
fn greater(a: f64, b: f64) -> f64 {
    if b <= a { a } else { b }
}

/// What a motion did.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outcome {
    /// On the hand [N].
    pub(crate) greatest_force_n: f64,
    /// How much further an instrument was from its hand after a step than the hand's way in the step tells [m]; without jaws that
    /// hold: tissue that is flung carries them along.
    pub(crate) most_astray_m: f64,
    /// Places, velocities and forces that were not finite, in all steps.
    pub(crate) n_non_finite: usize,
    /// Half a second after the tools left.
    pub(crate) n_inverted: usize,
    /// Two seconds after they left [m].
    pub(crate) most_off_m: f64,
    /// Steps in which a tetrahedron followed a substitute law, in the whole.
    pub(crate) n_quarantined_steps: usize,
    /// Steps in which the energy was limited.
    pub(crate) n_limited_steps: usize,
    /// Of hands and instruments, until the tissue is at rest.
    pub(crate) work: Work,
}

/// Two instruments in a world, and whose hand leads them.
pub(crate) struct Hands<'a> {
    world: &'a mut World,
    half_m: DVec3,
    tools: [ToolInput; 2],
    /// How far the instruments were from their hands, and where the hands were, after the last step [m].
    behind_m: [f64; 2],
    hands_m: [DVec3; 2],
    snapshot: Snapshot,
    meter: WorkMeter,
    random: SeededRandom,
    pub(crate) outcome: Outcome,
}

/// Both tools where they touch nothing.
fn waiting() -> [ToolInput; 2] {
    [AWAY_M, ASIDE_M].map(|tip_m| ToolInput::at(tip_m, DVec3::Z))
}

impl<'a> Hands<'a> {
    fn new(world: &'a mut World, block: &Block, seed: u64) -> Self {
        let (snapshot, meter) = (world.snapshot(), WorkMeter::new(world));
        Self {
            world,
            half_m: 0.5 * block.size_m,
            tools: waiting(),
            behind_m: [0.0; 2],
            hands_m: [AWAY_M, ASIDE_M],
            snapshot,
            meter,
            random: SeededRandom::new(seed),
            outcome: Outcome::default(),
        }
    }

    fn step(&mut self) {
        self.step_with(&StepInput::of(&self.tools));
    }

    fn step_with(&mut self, input: &StepInput) {
        self.meter.look(self.world);
        let report = self.world.step(input);
        let outcome = &mut self.outcome;
        for tool in &report.tools {
            let force_n = tool.force_on_tool_n.length();
            outcome.greatest_force_n = greater(outcome.greatest_force_n, force_n);
            outcome.n_non_finite += usize::from(!force_n.is_finite());
        }
        self.world.snapshot_into(&mut self.snapshot);
        for (tool, now) in self.snapshot.tools.iter().enumerate() {
            let hand_m = input.tools[tool].tip_in_world_m;
            let behind_m = now.pose.tip_in_world_m.distance(hand_m);
            let astray_m = behind_m - self.behind_m[tool] - hand_m.distance(self.hands_m[tool]);
            if now.n_held_nodes == 0 {
                outcome.most_astray_m = greater(outcome.most_astray_m, astray_m);
            }
            (self.behind_m[tool], self.hands_m[tool]) = (behind_m, hand_m);
        }
        self.meter.add(self.world, input, &self.snapshot, &mut outcome.work);
        outcome.n_quarantined_steps += usize::from(report.model.n_quarantined_tets > 0);
        outcome.n_limited_steps += usize::from(report.model.energy_was_limited);
        let state = self.world.state();
        let all = state.positions_m.iter().chain(state.velocities_m_per_s);
        outcome.n_non_finite += all.filter(|v| !v.is_finite()).count();
    }

    /// A tool is there at once.
    fn put(&mut self, tool: usize, at_m: DVec3) {
        self.tools[tool].tip_in_world_m = at_m;
        self.step();
    }

    /// One tool goes to a place at a speed.
    fn go(&mut self, tool: usize, to_m: DVec3, speed_m_per_s: f64) {
        self.go_both([(tool, to_m), (tool, to_m)], speed_m_per_s);
    }

    fn go_both(&mut self, to_m: [(usize, DVec3); 2], speed_m_per_s: f64) {
        let step_m = speed_m_per_s * self.world.spec().time_step_s;
        let from_m = to_m.map(|(tool, _)| self.tools[tool].tip_in_world_m);
        let way_m = (0..2).map(|i| from_m[i].distance(to_m[i].1)).fold(0.0, f64::max);
        let n = (way_m / step_m).ceil().max(1.0) as u32;
        for i in 1..=n {
            for (end, (tool, to_m)) in to_m.into_iter().enumerate() {
                self.tools[tool].tip_in_world_m = from_m[end].lerp(to_m, f64::from(i) / f64::from(n));
            }
            self.step();
        }
    }

    /// Both tools are taken out: a hand cannot pull one out that lies under the block. Open: jaws that close on their way out may
    /// catch tissue that still flies.
    fn leave(&mut self) {
        self.tools = waiting().map(|tool| ToolInput { jaw_opening: 1.0, ..tool });
        let mut input = StepInput::of(&self.tools);
        input.placed[..self.tools.len()].fill(true);
        self.step_with(&input);
    }

    fn rest(&mut self, time_s: f64) {
        for _ in 0..(time_s / self.world.spec().time_step_s).ceil() as u32 {
            self.step();
        }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        self.random.uniform_in(low, high)
    }

    /// A place over the block's top, or in it.
    fn over(&mut self, height_m: f64) -> DVec3 {
        let (x, y) = (self.uniform(-0.7, 0.7), self.uniform(-0.7, 0.7));
        DVec3::new(x * self.half_m.x, y * self.half_m.y, height_m)
    }

    /// A level direction.
    fn level(&mut self) -> DVec3 {
        let (x, y) = (self.random.normal(), self.random.normal());
        DVec3::new(x, y, 0.0).normalize_or(DVec3::X)
    }
}

/// From above through the whole block and out at the bottom, askew, and back.
fn through(hands: &mut Hands<'_>) {
    let (from_m, to_m) = (hands.over(0.05), hands.over(-2.0 * hands.half_m.z - 0.05));
    hands.put(0, from_m);
    hands.go(0, to_m, FAST_M_PER_S);
    hands.go(0, from_m, FAST_M_PER_S);
}

/// Level through the block, there and back and there.
fn across(hands: &mut Hands<'_>) {
    let mut middle_m = hands.over(0.0);
    middle_m.z = hands.uniform(-1.4, -0.2) * hands.half_m.z;
    let way_m = hands.level() * 2.5 * hands.half_m.x;
    hands.put(0, middle_m - way_m + DVec3::Z * 0.2);
    for end_m in [-way_m, way_m, -way_m] {
        hands.go(0, middle_m + end_m, FAST_M_PER_S);
    }
}

/// Jaws close on tissue and pull it half a metre away.
fn pull(hands: &mut Hands<'_>) {
    let (at_m, depth_m) = (hands.over(0.0), hands.uniform(3e-3, 8e-3));
    hands.tools[1].jaw_opening = 1.0;
    hands.put(1, at_m + DVec3::Z * 0.05);
    hands.go(1, at_m - DVec3::Z * depth_m, 0.2);
    for opening in [0.7, 0.4, 0.2, 0.0] {
        hands.tools[1].jaw_opening = opening;
        hands.rest(20e-3);
    }
    let aside = hands.level() * hands.uniform(0.0, 1.0);
    hands.go(1, at_m + (DVec3::Z + aside).normalize() * 0.5, FAST_M_PER_S);
    hands.rest(0.1);
    hands.tools[1].jaw_opening = 1.0;
    hands.step();
}

/// 40 mm deep, and 40 mm along.
fn drag(hands: &mut Hands<'_>) {
    let at_m = hands.over(0.0);
    let speed_m_per_s = hands.uniform(0.1, 1.0);
    hands.put(0, at_m + DVec3::Z * 0.05);
    hands.go(0, at_m - DVec3::Z * 0.04, speed_m_per_s);
    let inwards = if at_m == DVec3::ZERO { DVec3::X } else { -at_m.normalize() };
    let along_m = (inwards + 0.5 * hands.level()).normalize() * 0.04;
    hands.go(0, at_m + along_m - DVec3::Z * 0.04, speed_m_per_s);
}

/// Two tools that push against each other through the tissue.
fn jam(hands: &mut Hands<'_>) {
    let height_m = hands.uniform(-1.4, -0.2) * hands.half_m.z;
    let (way, aside) = (hands.level(), hands.uniform(-0.3, 0.3));
    let middle_m = way.cross(DVec3::Z) * aside * hands.half_m.x + DVec3::Z * height_m;
    let at_m = |share: f64| middle_m + way * share * hands.half_m.x;
    let [out_m, in_m] = [[-2.0, 2.0], [0.5, -0.5]].map(|ends| ends.map(at_m));
    for (tool, out_m) in out_m.into_iter().enumerate() {
        hands.put(tool, out_m + DVec3::Z * 0.2);
        hands.go(tool, out_m, FAST_M_PER_S);
    }
    hands.go_both([(0, in_m[0]), (1, in_m[1])], 1.0);
    hands.rest(0.05);
}

/// Ten metres at once, through the block and back.
fn jump(hands: &mut Hands<'_>) {
    for _ in 0..6 {
        let mut to_m = hands.over(-10.0);
        for _ in 0..3 {
            hands.put(0, to_m);
            to_m = DVec3::new(0.0, 0.0, -to_m.z);
        }
    }
}

/// A motion of both tools.
type Motion = fn(&mut Hands<'_>);

/// What hands do, in the order of the seeds.
pub(crate) const MOTIONS: [(&str, Motion); 6] =
    [("through", through), ("across", across), ("pull", pull), ("drag", drag), ("jam", jam), ("jump", jump)];

/// The name of the motion of a seed.
pub(crate) fn motion_name(seed: u64) -> &'static str {
    MOTIONS[(seed % MOTIONS.len() as u64) as usize].0
}

/// Does the motion of a seed to a block at rest, and watches it come back.
///
/// # Errors
/// When the model cannot be made.
pub(crate) fn abuse(block: &Block, subject: &Subject, hand: Hand, seed: u64) -> Result<Outcome, String> {
    let mut world = block.world(subject, SLIPPERY, Some(hand))?;
    let mut hands = Hands::new(&mut world, block, seed);
    MOTIONS[(seed % MOTIONS.len() as u64) as usize].1(&mut hands);
    hands.leave();
    hands.rest(UPRIGHT_AFTER_S);
    hands.outcome.n_inverted = block.inverted(hands.world).len();
    hands.rest(AT_REST_AFTER_S - UPRIGHT_AFTER_S);
    hands.outcome.most_off_m = block.most_off_m(hands.world);
    Ok(hands.outcome)
}
