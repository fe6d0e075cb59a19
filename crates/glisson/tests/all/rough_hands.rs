//! Hands that do what no surgeon does: whatever the model and its law, no force beyond the hand's, no number that is not
//! finite, and tissue that comes back to rest when the tools have left.

use crate::model_meshes::shaken_block;
use glisson::material::{LawChoice, LinearElastic, law_named};
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::topology::Topology;
use glisson::mesh::{TetId, TetMesh};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind};
use glisson::world::spec::{Hand, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const CELLS: [usize; 3] = [6, 6, 4];
const CELL_M: f64 = 13e-3;
/// Half sizes of the block across, and its height [m].
const HALF_M: f64 = 0.5 * CELLS[0] as f64 * CELL_M;
const HEIGHT_M: f64 = CELLS[2] as f64 * CELL_M;
const AWAY_M: DVec3 = DVec3::new(0.0, 0.0, 0.25);
/// Where the second instrument waits: beside the first.
const ASIDE_M: DVec3 = DVec3::new(0.1, 0.0, 0.25);
const FAST_M_PER_S: f64 = 5.0;
/// Tissue is at rest again when no node is further from its place [m].
const MOST_OFF_M: f64 = 1e-3;

/// A model and the law it follows.
#[derive(Clone, Copy, Debug)]
struct Subject {
    kind: ModelKind,
    law: Option<&'static str>,
    step_s: f64,
}

fn subjects() -> Vec<Subject> {
    let mut all: Vec<Subject> = [
        (ModelKind::Precomputed, 1e-3),
        (ModelKind::TensorMass, 1e-3),
        (ModelKind::MassSpring, 1e-3),
        (ModelKind::NonlinearTensorMass, 1e-3),
        (ModelKind::Hybrid, 1e-3),
        (ModelKind::Reduced, 1e-3),
    ]
    .map(|(kind, step_s)| Subject { kind, law: None, step_s })
    .into();
    let of_laws =
        [(ModelKind::ExtendedMassSpring, 1e-3), (ModelKind::Explicit, 1e-3), (ModelKind::Implicit, 2e-3)];
    for (kind, step_s) in of_laws {
        all.extend(kind.laws().into_iter().map(|law| Subject { kind, law: Some(law), step_s }));
    }
    all
}

/// A block on a table, its top at z = 0, with a probe and a grasper, whose jaws hold what they have.
fn world(subject: &Subject, friction: f64, hand: Option<Hand>) -> Result<(World, TetMesh), String> {
    world_of(subject, [friction, 1.0], hand)
}

/// With these coefficients of friction of the probe and the jaws.
fn world_of(
    subject: &Subject,
    [friction, of_jaws]: [f64; 2],
    hand: Option<Hand>,
) -> Result<(World, TetMesh), String> {
    let size_m = DVec3::from(CELLS.map(|n| n as f64)) * CELL_M;
    let mut mesh = shaken_block(CELLS, size_m, 0.15, 7);
    mesh.positions_m.iter_mut().for_each(|p| *p -= DVec3::new(0.5, 0.5, 1.0) * size_m);
    let supports = vec![Support::all_axes(Region::Furthest { direction: -DVec3::Z, fraction: 0.15 })];
    let home = ToolInput::at(AWAY_M, DVec3::Z);
    let grip = Grip { friction_coefficient: friction, is_sticky: false };
    let probe = Tool { grip, ..Tool::probe("probe", 3e-3, home) };
    let jaws = Jaws { length_m: 0.02, width_m: 5e-3, greatest_opening_rad: 1.0, closing_force_n: 50.0 };
    let kind = ToolKind::grasper(jaws);
    let grip = Grip { friction_coefficient: of_jaws, is_sticky: false };
    let home = ToolInput::at(ASIDE_M, DVec3::Z);
    let grasper = Tool { kind, grip, ..Tool::probe("grasper", 2e-3, home) };
    let mut step_s = subject.step_s;
    loop {
        let mut spec = WorldSpec::new("block", step_s, probe.clone());
        spec.tools.push(grasper.clone());
        spec.supports.clone_from(&supports);
        spec.hand = hand;
        let material = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
        let mut body = OrganBody::new(mesh.clone(), material, step_s);
        body.law = subject.law.map(|law| LawChoice::typical(law_named(law).unwrap().entry()));
        body.fixed = fixed_nodes(&supports, &mesh.positions_m);
        body.damping = Rayleigh::of_mass(60.0);
        match build_model(&body, subject.kind) {
            Ok(model) => {
                let world = World::new(spec, mesh.clone(), model, subject.kind).unwrap();
                return Ok((world, mesh));
            }
            Err(error) if step_s < 2e-5 => return Err(error.to_string()),
            Err(_) => step_s *= 0.5,
        }
    }
}

/// A motion of both tools: where each goes next, and how its jaws are.
type Motion = fn(&mut Hands<'_>);

struct Hands<'a> {
    world: &'a mut World,
    tools: [ToolInput; 2],
    random: SeededRandom,
    outcome: Outcome,
}

#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    greatest_force_n: f64,
    non_finite: u32,
}

/// Both tools where they touch nothing.
fn waiting() -> [ToolInput; 2] {
    [AWAY_M, ASIDE_M].map(|tip_m| ToolInput::at(tip_m, DVec3::Z))
}

impl<'a> Hands<'a> {
    fn new(world: &'a mut World, seed: u64) -> Self {
        let random = SeededRandom::new(seed);
        Self { world, tools: waiting(), random, outcome: Outcome::default() }
    }

    fn step(&mut self) {
        let report = self.world.step(&StepInput::of(&self.tools));
        for tool in &report.tools {
            let force_n = tool.force_on_tool_n.length();
            // A force that is no number is the greatest.
            let most_n = self.outcome.greatest_force_n;
            self.outcome.greatest_force_n = if force_n <= most_n { most_n } else { force_n };
        }
        self.outcome.non_finite += report.n_non_finite_nodes;
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

    /// The jaws take tissue; answers where their tip is then [m].
    fn take(&mut self) -> DVec3 {
        let at_m = DVec3::new(-5e-3, 3e-3, -5e-3);
        self.tools[1].jaw_opening = 1.0;
        self.tools[1].tip_in_world_m = at_m + DVec3::Z * 0.03;
        self.step();
        self.go(1, at_m, 0.2);
        self.tools[1].jaw_opening = 0.0;
        self.rest(20e-3);
        at_m
    }

    fn rest(&mut self, time_s: f64) {
        for _ in 0..(time_s / self.world.spec().time_step_s).ceil() as u32 {
            self.step();
        }
    }

    /// A place over the block's top.
    fn over(&mut self, height_m: f64) -> DVec3 {
        let across = |random: &mut SeededRandom| random.uniform_in(-0.7, 0.7) * HALF_M;
        DVec3::new(across(&mut self.random), across(&mut self.random), height_m)
    }
}

/// From the top through the whole block and out at the bottom, and back.
fn through(hands: &mut Hands<'_>) {
    let (from_m, to_m) = (hands.over(0.05), hands.over(-HEIGHT_M - 0.05));
    hands.tools[0].tip_in_world_m = from_m;
    hands.step();
    hands.go(0, to_m, FAST_M_PER_S);
    hands.go(0, from_m, FAST_M_PER_S);
}

/// Across from side to side.
fn across(hands: &mut Hands<'_>) {
    let height_m = hands.random.uniform_in(-0.7, -0.1) * HEIGHT_M;
    let side_m = hands.random.uniform_in(-0.5, 0.5) * HALF_M;
    let ends_m = [-2.0, 2.0].map(|way| DVec3::new(way * HALF_M, side_m, height_m));
    hands.tools[0].tip_in_world_m = ends_m[0] + DVec3::Z * 0.2;
    hands.step();
    hands.go(0, ends_m[0], FAST_M_PER_S);
    hands.go(0, ends_m[1], FAST_M_PER_S);
    hands.go(0, ends_m[0], FAST_M_PER_S);
}

/// Jaws close on tissue and pull it half a metre away.
fn pull(hands: &mut Hands<'_>) {
    let at_m = hands.over(0.0);
    hands.tools[1].jaw_opening = 1.0;
    hands.tools[1].tip_in_world_m = at_m + DVec3::Z * 0.05;
    hands.step();
    hands.go(1, at_m - DVec3::Z * 4e-3, 0.2);
    for opening in [0.7, 0.4, 0.2, 0.0] {
        hands.tools[1].jaw_opening = opening;
        hands.rest(20e-3);
    }
    hands.go(1, at_m + DVec3::Z * 0.5, FAST_M_PER_S);
    hands.rest(0.1);
    hands.tools[1].jaw_opening = 1.0;
    hands.step();
}

/// Deep and along, as a careful hand would not.
fn drag(hands: &mut Hands<'_>) {
    let at_m = hands.over(0.0);
    hands.tools[0].tip_in_world_m = at_m + DVec3::Z * 0.05;
    hands.step();
    hands.go(0, at_m - DVec3::Z * 0.04, 0.3);
    let along_m = DVec3::new(-at_m.x.signum() * 0.04, 0.0, -0.04);
    hands.go(0, at_m + along_m, 0.3);
}

/// Two tools that push against each other through the tissue.
fn jam(hands: &mut Hands<'_>) {
    let height_m = hands.random.uniform_in(-0.6, -0.1) * HEIGHT_M;
    let side = |way: f64| DVec3::new(way, 0.0, height_m);
    for (tool, way) in [(0, -2.0), (1, 2.0)] {
        hands.tools[tool].tip_in_world_m = side(way * HALF_M) + DVec3::Z * 0.2;
        hands.step();
        hands.go(tool, side(way * HALF_M), FAST_M_PER_S);
    }
    hands.go_both([(0, side(0.5 * HALF_M)), (1, side(-0.5 * HALF_M))], 1.0);
    hands.rest(0.05);
}

/// Ten metres at once, through the block and back.
fn jump(hands: &mut Hands<'_>) {
    for _ in 0..6 {
        let mut to_m = hands.over(-10.0);
        for _ in 0..3 {
            hands.tools[0].tip_in_world_m = to_m;
            hands.step();
            to_m = DVec3::new(0.0, 0.0, -to_m.z);
        }
    }
}

const MOTIONS: [(&str, Motion); 6] =
    [("through", through), ("across", across), ("pull", pull), ("drag", drag), ("jam", jam), ("jump", jump)];

fn n_inverted(world: &World, mesh: &TetMesh) -> usize {
    let positions_m = world.state().positions_m;
    (0..mesh.tetrahedra.len())
        .filter(|&t| {
            let corners_m = mesh.tetrahedra[TetId::from_index(t).index()].map(|n| positions_m[n.index()]);
            let [a, b, c] = [1, 2, 3].map(|k| corners_m[k] - corners_m[0]);
            a.cross(b).dot(c) <= 0.0
        })
        .count()
}

fn most_off_rest_m(world: &World, mesh: &TetMesh) -> f64 {
    let pairs = world.state().positions_m.iter().zip(&mesh.positions_m);
    pairs.map(|(now_m, rest_m)| now_m.distance(*rest_m)).fold(0.0, f64::max)
}

/// What a motion does to a subject, and what is wrong with it.
fn abuse(subject: &Subject, (name, motion): (&str, Motion), seed: u64) -> Result<(), String> {
    let (mut world, mesh) = world(subject, 0.05, Some(Hand::default()))?;
    let mut hands = Hands::new(&mut world, seed);
    motion(&mut hands);
    // Open: jaws that close on their way out may catch tissue that still flies.
    hands.tools = waiting().map(|tool| ToolInput { jaw_opening: 1.0, ..tool });
    hands.rest(0.5);
    let inverted = n_inverted(hands.world, &mesh);
    hands.rest(1.5);
    let off_m = most_off_rest_m(hands.world, &mesh);
    let Outcome { greatest_force_n, non_finite } = hands.outcome;
    let limit_n = Hand::default().greatest_force_n * (1.0 + 1e-9);
    let is_bounded = greatest_force_n <= limit_n && non_finite == 0;
    let is_back = inverted == 0 && off_m <= MOST_OFF_M;
    if is_bounded && is_back {
        return Ok(());
    }
    let off_mm = off_m * 1e3;
    Err(format!(
        "{subject:?} {name}: {greatest_force_n} N, {non_finite} not finite, {inverted} inverted, {off_mm} mm off"
    ))
}

/// Each model and law meets two of the motions; together they meet all.
#[test]
fn no_motion_of_a_hand_makes_more_force_than_the_hand_and_tissue_comes_back() {
    let mut wrong = Vec::new();
    for (i, subject) in subjects().iter().enumerate() {
        for motion in [MOTIONS[i % MOTIONS.len()], MOTIONS[(i + 3) % MOTIONS.len()]] {
            wrong.extend(abuse(subject, motion, i as u64).err());
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Presses a probe straight into the middle of the block, and holds it there; the force and where the tip is then.
fn press(world: &mut World, depth_m: f64) -> (DVec3, DVec3) {
    let aside = ToolInput::at(ASIDE_M, DVec3::Z);
    let at = |z_m: f64| [ToolInput::at(DVec3::new(2e-3, 1e-3, z_m), DVec3::Z), aside];
    world.step(&StepInput::of(&at(0.03)));
    let n = (0.1 / world.spec().time_step_s) as u32;
    for i in 1..=2 * n {
        let share = (f64::from(i) / f64::from(n)).min(1.0);
        world.step(&StepInput::of(&at(0.03 - (0.03 + depth_m - 3e-3) * share)));
    }
    let tip_m = world.snapshot().tools[0].pose.tip_in_world_m;
    (world.report().tools[0].force_on_tool_n, tip_m)
}

/// A calm hand feels the same in every model of the same law: what they differ in is how they move.
#[test]
fn a_calm_hand_feels_the_same_in_every_model_of_a_law() {
    let linear = [ModelKind::Precomputed, ModelKind::Hybrid, ModelKind::TensorMass].map(|kind| (kind, None));
    let stable = [ModelKind::Implicit, ModelKind::Explicit].map(|kind| (kind, Some("stable_neo_hooke")));
    for of_law in [&linear[..], &stable[..]] {
        let felt_n: Vec<DVec3> = of_law
            .iter()
            .map(|&(kind, law)| {
                let subject = Subject { kind, law, step_s: 1e-3 };
                let (mut world, _) = world(&subject, 0.3, Some(Hand::default())).unwrap();
                press(&mut world, 8e-3).0
            })
            .collect();
        for (&(kind, _), force_n) in of_law.iter().zip(&felt_n) {
            let off = (*force_n - felt_n[0]).length() / felt_n[0].length();
            assert!(felt_n[0].length() > 0.3 && off < 0.05, "{kind}: {force_n}, else {}", felt_n[0]);
        }
    }
}

/// Where a tip rests on tissue, no place of the surface is left inside it, between vertices neither.
#[test]
fn nothing_of_the_surface_is_left_inside_a_tip() {
    let subject = Subject { kind: ModelKind::Precomputed, law: None, step_s: 1e-3 };
    let (mut world, mesh) = world(&subject, 0.0, Some(Hand::default())).unwrap();
    let (_, tip_m) = press(&mut world, 4e-3);
    let topology = Topology::build(&mesh).unwrap();
    let positions_m = world.state().positions_m;
    let mut least_m = f64::INFINITY;
    for triangle in topology.surface_triangles() {
        let [a, b, c] = topology.outward_nodes(triangle).map(|n| positions_m[n.index()]);
        for i in 0..=20 {
            for j in 0..=20 - i {
                let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                least_m = least_m.min((a * (1.0 - u - v) + b * u + c * v).distance(tip_m));
            }
        }
    }
    assert!((least_m - 3e-3).abs() < 3e-5, "{least_m}");
}

/// Tissue that is held fixed stops an instrument, at the hand's greatest force.
#[test]
fn held_tissue_stops_an_instrument() {
    let subject = Subject { kind: ModelKind::Precomputed, law: None, step_s: 1e-3 };
    let (mut world, _) = world(&subject, 0.3, Some(Hand::default())).unwrap();
    // Up from under the table, whose nodes do not move.
    let at = |z_m: f64| {
        [ToolInput::at(DVec3::new(2e-3, 1e-3, z_m), DVec3::NEG_Z), ToolInput::at(ASIDE_M, DVec3::Z)]
    };
    world.step(&StepInput::of(&at(-HEIGHT_M - 0.03)).placed());
    for i in 0..200 {
        world.step(&StepInput::of(&at(-HEIGHT_M - 0.03 + 3e-4 * f64::from(i))));
    }
    let force_n = world.report().tools[0].force_on_tool_n;
    let tip_m = world.snapshot().tools[0].pose.tip_in_world_m;
    assert!((force_n.length() - 30.0).abs() < 0.5 && force_n.z < -29.0, "{force_n}");
    // The block is uneven by some millimetres.
    assert!(tip_m.z < -HEIGHT_M, "{tip_m}");
}

/// A moment in contact that is saved goes on with the same bits.
#[test]
fn a_saved_touch_goes_on_with_the_same_bits() {
    for (kind, law) in [(ModelKind::Precomputed, None), (ModelKind::Implicit, Some("stable_neo_hooke"))] {
        let subject = Subject { kind, law, step_s: 1e-3 };
        let (mut world, _) = world(&subject, 0.05, Some(Hand::default())).unwrap();
        press(&mut world, 10e-3);
        let saved = world.save();
        let go_on = |world: &mut World| {
            let mut hashes = Vec::new();
            for i in 0..40 {
                let tip_m = DVec3::new(2e-3 + 1e-3 * f64::from(i), 1e-3, -12e-3);
                world.step(&StepInput::of(&[
                    ToolInput::at(tip_m, DVec3::Z),
                    ToolInput::at(ASIDE_M, DVec3::Z),
                ]));
                hashes.push(world.state_hash());
            }
            hashes
        };
        let first = go_on(&mut world);
        world.restore(&saved);
        let second = go_on(&mut world);
        assert_eq!(first, second, "{subject:?}");
        assert!(first.windows(2).all(|pair| pair[0] != pair[1]));
    }
}

/// What jaws hold still lies still, in every model and at the longest step that each takes: forces between held nodes, which the hand
/// does not feel, do not grow.
#[test]
fn what_jaws_hold_still_lies_still() {
    for subject in subjects() {
        let (mut world, _) = world(&subject, 0.3, Some(Hand::default())).unwrap();
        let mut hands = Hands::new(&mut world, 0);
        let at_m = hands.take();
        hands.go(1, at_m + DVec3::Z * 10e-3, 0.1);
        hands.rest(0.5);
        let fastest_m_per_s = |world: &World| {
            let velocities = world.state().velocities_m_per_s;
            velocities.iter().map(|v| v.length()).fold(0.0, f64::max)
        };
        let mut worst_m_per_s = 0.0_f64;
        for _ in 0..20 {
            hands.step();
            worst_m_per_s = worst_m_per_s.max(fastest_m_per_s(hands.world));
        }
        let report = &hands.world.report().tools[1];
        assert!(report.n_held_nodes > 3 && report.force_on_tool_n.z < -2.0, "{subject:?}: {report:?}");
        assert!(worst_m_per_s < 2e-3, "{subject:?}: {worst_m_per_s} m/s");
    }
}

/// Tissue that slides out of jaws is felt with their friction: no jolt when a node comes out, in any model.
#[test]
fn what_slides_out_of_jaws_is_felt_with_their_friction() {
    // Of a closing force of 50 N.
    let (friction, limit_n) = (0.03, 1.5);
    for subject in subjects() {
        let (mut world, _) = world_of(&subject, [0.3, friction], Some(Hand::default())).unwrap();
        let mut hands = Hands::new(&mut world, 0);
        let at_m = hands.take();
        hands.outcome = Outcome::default();
        hands.go(1, at_m + DVec3::Z * 40e-3, 0.1);
        let most_n = hands.outcome.greatest_force_n;
        assert!((most_n - limit_n).abs() < 1e-9, "{subject:?}: {most_n} N");
        let report = &hands.world.report().tools[1];
        assert!(report.n_held_nodes < 5, "{subject:?}: {report:?}");
    }
}

/// St Venant-Kirchhoff tissue bears no more once it is squeezed to 0.58: a tip pressed deeper rests on it all the same, in every explicit
/// model that follows the law, with the same force.
#[test]
fn a_tip_rests_deep_in_st_venant_kirchhoff_tissue() {
    let law = Some("st_venant_kirchhoff");
    let kinds = [
        (ModelKind::NonlinearTensorMass, None),
        (ModelKind::ExtendedMassSpring, law),
        (ModelKind::Explicit, law),
    ];
    let felt_n = kinds.map(|(kind, law)| {
        let subject = Subject { kind, law, step_s: 1e-3 };
        let (mut world, _) = world(&subject, 0.3, Some(Hand::default())).unwrap();
        let depth_m = 14e-3;
        press(&mut world, depth_m);
        let hand = ToolInput::at(DVec3::new(2e-3, 1e-3, 3e-3 - depth_m), DVec3::Z);
        let input = StepInput::of(&[hand, ToolInput::at(ASIDE_M, DVec3::Z)]);
        let n_to_rest = (0.5 / world.spec().time_step_s) as u32;
        (0..n_to_rest).for_each(|_| {
            world.step(&input);
        });
        let (mut least_n, mut most_n) = (f64::INFINITY, 0.0_f64);
        for _ in 0..100 {
            let force_n = world.step(&input).tools[0].force_on_tool_n.length();
            (least_n, most_n) = (least_n.min(force_n), most_n.max(force_n));
        }
        assert!(most_n - least_n < 0.02 * most_n, "{subject:?}: {least_n} to {most_n} N");
        most_n
    });
    assert!(felt_n.iter().all(|n| (n - felt_n[0]).abs() < 0.05 * felt_n[0]), "{felt_n:?}");
}
