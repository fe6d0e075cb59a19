//! Instruments in a world: what they touch, hold, cut and take back.

use crate::model_meshes::block;
use glisson::contact::shapes::MeshShape;
use glisson::material::LinearElastic;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::edit::{EdgeSplit, MeshEdit};
use glisson::mesh::{EdgeId, TetId};
use glisson::model::Rayleigh;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::cautery::HeatedTissue;
use glisson::tool::{
    Blade, BladeCuts, Burnt, CutRule, Grip, Jaws, Snip, Tool, ToolInput, ToolKind, ToolShape,
};
use glisson::world::spec::{Load, LoadTime, Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{EditRefusal, StepInput, World};

const SIZE_M: f64 = 0.1;
const TIME_STEP_S: f64 = 3e-4;
const JAWS: Jaws = Jaws { length_m: 0.02, width_m: 0.01, greatest_opening_rad: 1.2, closing_force_n: 10.0 };
const SWEPT_BY_TIME: CutRule =
    CutRule { least_force_n: 1e-3, least_time_s: 3e-3, power_w: 0.0, takes: Burnt::Swept { depth_m: 1e-3 } };

/// Where a tool that comes from above has its tip.
fn above(x_m: f64, y_m: f64, z_m: f64) -> ToolInput {
    ToolInput::at(DVec3::new(x_m, y_m, z_m), DVec3::Z)
}

fn tool(kind: ToolKind, friction: f64) -> Tool {
    let grip = Grip { friction_coefficient: friction, is_sticky: false };
    Tool { kind, grip, shaft_radius_m: 2e-3, ..Tool::probe(kind.name(), 3e-3, above(0.05, 0.05, 0.2)) }
}

/// A soft block on a table, heavily damped. Its cuts are embedded where an instrument's are.
fn world_of(kind: ModelKind, tools: Vec<Tool>) -> World {
    let embeds = |tool: &Tool| {
        let is_swept = |rule: &CutRule| matches!(rule.takes, Burnt::Swept { .. });
        tool.kind.edge_cuts() == Some(BladeCuts::Embedded) || tool.kind.burning().is_some_and(is_swept)
    };
    let embeds_cuts = tools.iter().any(embeds);
    let mesh = block([5, 5, 5], DVec3::splat(SIZE_M));
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 6.0 };
    let mut spec = WorldSpec::new("block", TIME_STEP_S, tools[0].clone());
    spec.tools = tools;
    spec.supports = vec![Support::all_axes(table)];
    let corner = Region::Ball { center_m: DVec3::splat(SIZE_M), radius_m: 0.3 * SIZE_M };
    spec.loads = vec![Load { region: corner, force_n: DVec3::X * 1e-3, time: LoadTime::Always }];
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
    let mut body = OrganBody::new(mesh, material, TIME_STEP_S);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 60.0, stiffness_s: 0.0 };
    body.embeds_cuts = embeds_cuts;
    let model = build_model(&body, kind).unwrap();
    World::new(spec, body.mesh, model, kind).unwrap()
}

fn world(tools: Vec<Tool>) -> World {
    world_of(ModelKind::Explicit, tools)
}

/// Steps in which every tool moves from `from` to `to`.
fn glide(world: &mut World, from: &[ToolInput], to: &[ToolInput], steps: u32) {
    for i in 1..=steps {
        let t = f64::from(i) / f64::from(steps);
        let between = |(a, b): (&ToolInput, &ToolInput)| ToolInput {
            tip_in_world_m: a.tip_in_world_m.lerp(b.tip_in_world_m, t),
            shaft_in_world: a.shaft_in_world.lerp(b.shaft_in_world, t).normalize(),
            roll_rad: a.roll_rad + (b.roll_rad - a.roll_rad) * t,
            jaw_opening: a.jaw_opening + (b.jaw_opening - a.jaw_opening) * t,
            trigger: b.trigger,
        };
        let tools: Vec<ToolInput> = from.iter().zip(to).map(between).collect();
        let report = world.step(&StepInput::of(&tools));
        assert_eq!(report.n_non_finite_nodes, 0);
    }
}

/// A grasper over an upper edge of the block, its jaws around it, then closed.
fn grasp_edge(world: &mut World) -> ToolInput {
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 2e-3) };
    world.step(&StepInput::of(&[open]).placed());
    let closed = ToolInput { jaw_opening: 0.0, ..open };
    glide(world, &[open], &[closed], 20);
    closed
}

#[test]
fn closed_jaws_hold_tissue_that_follows_the_tool_and_opening_lets_go() {
    let mut world = world(vec![tool(ToolKind::grasper(JAWS), 10.0)]);
    let closed = grasp_edge(&mut world);
    let held = world.held_nodes(0);
    assert!((1..=14).contains(&held.len()), "{held:?}");
    let before: Vec<DVec3> = held.iter().map(|n| world.state().positions_m[n.index()]).collect();
    let lifted = ToolInput { roll_rad: 0.5, ..above(SIZE_M, 0.04, SIZE_M + 8e-3) };
    glide(&mut world, &[closed], &[lifted], 200);
    let report = world.report().tools[0];
    assert_eq!(report.n_held_nodes as usize, held.len());
    assert!(report.force_on_tool_n.z < -0.01, "the tissue pulls the tool down: {}", report.force_on_tool_n);
    // The shaft is along z: half a radian of roll turns what is held about it.
    let (tip, turn) = (closed.tip_in_world_m, glisson::math::DMat3::from_rotation_z(0.5));
    for (node, before_m) in held.iter().zip(before) {
        let expected_m = turn * (before_m - tip) + lifted.tip_in_world_m;
        let now_m = world.state().positions_m[node.index()];
        assert!(now_m.distance(expected_m) < 1e-9, "{node}: {now_m} {expected_m}");
    }
    let open = ToolInput { jaw_opening: 1.0, ..lifted };
    glide(&mut world, &[lifted], &[open], 20);
    assert!(world.held_nodes(0).is_empty() && world.report().tools[0].n_held_nodes == 0);
    let away = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, 0.3) };
    glide(&mut world, &[open], &[away], 3000);
    let rest = &world.organ().mesh().positions_m;
    let off_m = world.state().positions_m.iter().zip(rest).map(|(p, r)| p.distance(*r)).fold(0.0, f64::max);
    assert!(off_m < 1e-3 && !world.report().in_contact(), "{off_m}");
}

#[test]
fn tissue_that_is_pulled_too_hard_slips_out_and_the_pull_never_grows_much_beyond_friction() {
    let weak = Jaws { closing_force_n: 1.0, ..JAWS };
    let mut world = world(vec![tool(ToolKind::grasper(weak), 0.2)]);
    let closed = grasp_edge(&mut world);
    assert!(!world.held_nodes(0).is_empty());
    let (mut greatest_n, mut slipped_m) = (0.0_f64, 0.0);
    let mut pose = closed;
    for _ in 0..3000 {
        pose.tip_in_world_m.z += 2e-5;
        let report = world.step(&StepInput::of(&[pose])).tools[0];
        if report.n_held_nodes > 0 {
            greatest_n = greatest_n.max(report.force_on_tool_n.length());
            slipped_m += report.slip_m;
        }
    }
    assert!(world.held_nodes(0).is_empty(), "it slipped out");
    assert!(slipped_m > 1e-3, "{slipped_m}");
    assert!(greatest_n > 0.1 && greatest_n < 0.5, "0.2 N are held by friction: {greatest_n}");
}

#[test]
fn two_hands_work_at_once_and_fixed_nodes_stay() {
    let tools = vec![tool(ToolKind::grasper(JAWS), 10.0), tool(ToolKind::PROBE, 0.3)];
    let mut world = world(tools);
    let fixed = world.organ().fixed_nodes();
    let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 2e-3) };
    let probe = above(0.03, 0.05, SIZE_M + 4e-3);
    world.step(&StepInput::of(&[open, probe]).placed());
    let closed = ToolInput { jaw_opening: 0.0, ..open };
    glide(&mut world, &[open, probe], &[closed, probe], 20);
    let (up, down) = (above(SIZE_M, 0.04, SIZE_M + 6e-3), above(0.03, 0.05, SIZE_M - 3e-3));
    glide(&mut world, &[closed, probe], &[up, down], 300);
    let [first, second, ..] = world.report().tools;
    assert!(first.force_on_tool_n.z < -0.01 && second.force_on_tool_n.z > 0.01, "{first:?} {second:?}");
    assert_eq!(world.snapshot().tools.len(), 2);
    // A grasper at the table holds nothing that is fixed, a probe does not move it.
    let low = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, 1e-3) };
    world.step(&StepInput::of(&[low, down]).placed());
    glide(&mut world, &[low, down], &[ToolInput { jaw_opening: 0.0, ..low }, down], 20);
    assert!(world.held_nodes(0).iter().all(|n| !fixed.contains(n)));
    glide(&mut world, &[ToolInput { jaw_opening: 0.0, ..low }, down], &[above(0.15, 0.0, 0.1), down], 100);
    for node in fixed {
        assert_eq!(world.state().positions_m[node.index()], world.organ().mesh().positions_m[node.index()]);
    }
}

#[test]
fn a_shaft_that_sweeps_sideways_touches_and_pushes() {
    let mut world = world(vec![tool(ToolKind::PROBE, 0.0)]);
    // The tip hangs beside the block, below its middle; the shaft stands beside it up to far above.
    let beside = ToolInput::at(DVec3::new(SIZE_M + 0.01, 0.05, 0.06), DVec3::new(-0.6, 0.0, 0.8));
    world.step(&StepInput::of(&[beside]).placed());
    assert!(!world.report().in_contact());
    let leaning =
        ToolInput::at(DVec3::new(SIZE_M + 0.02, 0.05, 0.08), DVec3::new(-0.05, 0.0, 1.0).normalize());
    world.step(&StepInput::of(&[leaning]).placed());
    let pushed = ToolInput { tip_in_world_m: leaning.tip_in_world_m - DVec3::X * 0.02, ..leaning };
    glide(&mut world, &[leaning], &[pushed], 200);
    let snapshot = world.snapshot().tools[0];
    assert!(snapshot.contacts[2].is_some(), "the shaft touches: {snapshot:?}");
    assert!(snapshot.force_n.x > 0.0, "{}", snapshot.force_n);
}

#[test]
fn a_fast_tip_never_comes_through_a_thin_wall() {
    let mut random = SeededRandom::new(11);
    for _ in 0..40 {
        let mut world = world(vec![tool(ToolKind::PROBE, 0.3)]);
        let target = DVec3::new(random.uniform_in(0.03, 0.07), random.uniform_in(0.03, 0.07), SIZE_M);
        let slope = DVec3::new(random.uniform_in(-2.0, 2.0), random.uniform_in(-2.0, 2.0), 1.0).normalize();
        // 30 mm in a step: a hundred metres a second.
        let start = ToolInput::at(target + slope * 0.045, slope);
        world.step(&StepInput::of(&[start]).placed());
        let end = ToolInput::at(target - slope * 0.005, slope);
        world.step(&StepInput::of(&[end]));
        assert!(world.report().in_contact(), "{slope}");
    }
}

#[test]
fn a_tool_with_friction_sticks_inside_the_cone_and_slides_outside() {
    let run = |friction: f64| {
        let mut world = world(vec![tool(ToolKind::PROBE, friction)]);
        let start = above(0.045, 0.05, SIZE_M + 4e-3);
        world.step(&StepInput::of(&[start]).placed());
        let deep = above(0.045, 0.05, SIZE_M - 2e-3);
        glide(&mut world, &[start], &[deep], 300);
        let touched = world.snapshot().tools[0].contacts[0].unwrap();
        let drawn = above(0.06, 0.05, SIZE_M - 2e-3);
        glide(&mut world, &[deep], &[drawn], 2000);
        let held = glide_at(&mut world, &drawn, 500);
        (world, touched, held)
    };
    // Tangential over normal force, against the contact's own normal: the tissue piles up before the tip.
    let slope = |world: &World, force_n: DVec3| {
        let normal = world.snapshot().tools[0].contacts[0].unwrap().normal;
        let pressed_n = force_n.dot(normal);
        (force_n - normal * pressed_n).length() / pressed_n
    };
    let (world, _, force_n) = run(0.2);
    assert!(force_n.z > 0.01, "it still presses: {force_n}");
    let ratio = slope(&world, force_n);
    assert!((0.1..0.25).contains(&ratio), "it slid until friction 0.2 held: {ratio}");
    let contact = world.snapshot().tools[0].contacts[0].unwrap();
    assert!(
        (contact.point_m.x - 0.06).abs() < 4e-3,
        "the touched point is under the tip: {}",
        contact.point_m
    );
    let (world, touched, force_n) = run(20.0);
    let contact = world.snapshot().tools[0].contacts[0].unwrap();
    assert_eq!(contact.nodes, touched.nodes, "it stuck");
    assert!(force_n.truncate().length() > 0.3 * force_n.z, "{force_n}");
    // Without friction nothing is felt along the surface.
    let (world, _, force_n) = run(0.0);
    assert!(slope(&world, force_n) < 0.05, "{force_n}");
}

/// Steps at one place; answers the last force on the tool [N].
fn glide_at(world: &mut World, pose: &ToolInput, steps: u32) -> DVec3 {
    for _ in 0..steps {
        world.step(&StepInput::of(&[*pose]));
    }
    world.report().tools[0].force_on_tool_n
}

#[test]
fn a_hook_burns_away_what_it_presses_on_and_only_when_it_is_on() {
    let rule = CutRule { least_force_n: 0.02, least_time_s: 0.01, power_w: 0.0, takes: Burnt::Tetrahedra };
    let mut world = world(vec![tool(ToolKind::hook(rule), 0.3)]);
    let start = above(0.05, 0.05, SIZE_M + 4e-3);
    world.step(&StepInput::of(&[start]).placed());
    let deep = above(0.05, 0.05, SIZE_M - 4e-3);
    glide(&mut world, &[start], &[deep], 300);
    let cut = |world: &mut World, trigger: f64| {
        let mut n_removed = 0;
        for _ in 0..100 {
            world.step(&StepInput::of(&[ToolInput { trigger, ..deep }]));
            let cuts = world.cut_with_tools();
            assert!(cuts.refusals.is_empty(), "{cuts:?}");
            n_removed += cuts.n_removed;
        }
        n_removed
    };
    assert_eq!(cut(&mut world, 0.0), 0);
    let n_removed = cut(&mut world, 1.0);
    assert!(n_removed > 0 && world.organ().removed_tetrahedra().len() == n_removed, "{n_removed}");
}

/// A hook that sweeps goes into the block, burns a groove and comes out, with `power_w` or by time; what burnt [m3].
fn burn_a_groove(world: &mut World) -> f64 {
    let path = [(0.05, SIZE_M + 4e-3), (0.05, SIZE_M - 2e-3), (0.06, SIZE_M - 2e-3), (0.06, SIZE_M + 0.03)];
    let [start, deep, end, out] = path.map(|(x_m, z_m)| above(x_m, 0.05, z_m));
    world.step(&StepInput::of(&[start]).placed());
    let mut burnt_m3 = 0.0;
    for (from, to, steps, trigger) in [(start, deep, 200, 1.0), (deep, end, 500, 1.0), (end, out, 200, 0.0)] {
        for k in 1..=steps {
            let tip_in_world_m = from.tip_in_world_m.lerp(to.tip_in_world_m, f64::from(k) / f64::from(steps));
            world.step(&StepInput::of(&[ToolInput { tip_in_world_m, trigger, ..to }]));
            let cuts = world.cut_with_tools();
            assert!(cuts.refusals.is_empty(), "{cuts:?}");
            burnt_m3 += cuts.burnt_m3;
        }
    }
    burnt_m3
}

#[test]
fn a_hook_that_sweeps_burns_a_groove_for_its_energy_and_is_taken_back() {
    let power_w = 500.0;
    for kind in [ModelKind::Explicit, ModelKind::Implicit, ModelKind::TensorMass] {
        for rule in [SWEPT_BY_TIME, CutRule { power_w, ..SWEPT_BY_TIME }] {
            let hook = || vec![tool(ToolKind::hook(rule), 0.1)];
            let mut world = world_of(kind, hook());
            let (mesh, hash) = (world.organ().mesh().clone(), world.state_hash());
            let burnt_m3 = burn_a_groove(&mut world);
            // More than the ball takes of a flat surface, and no whole tetrahedra, each of which has 1,600 mm3.
            assert!(burnt_m3 > 1.5e-8 && burnt_m3 < 1e-6, "{kind}: {burnt_m3}");
            assert!((world.removed_volume_m3() - burnt_m3).abs() < 1e-15, "{kind}: {burnt_m3}");
            if rule.power_w > 0.0 {
                let heat_j = burnt_m3 * HeatedTissue::LIVER.heat_to_part_j_per_m3();
                assert!(heat_j <= power_w * 700.0 * TIME_STEP_S, "{kind}: {heat_j} J");
            }
            let mut again = world_of(kind, hook());
            burn_a_groove(&mut again);
            assert_eq!(again.state_hash(), world.state_hash(), "{kind}: the same again");
            world.set_undo_depth(1000);
            let n_edits = world.n_edits_to_undo();
            assert!(n_edits > 0 && world.undo_edit(), "{kind}");
            assert!(world.removed_volume_m3() <= burnt_m3 && world.state_hash() != hash);
            assert_eq!(mesh.positions_m, world.organ().mesh().positions_m[..mesh.positions_m.len()]);
        }
    }
}

/// A model that follows nothing but removals loses whole tetrahedra.
#[test]
fn a_hook_that_sweeps_takes_tetrahedra_from_a_model_that_cannot_be_divided() {
    let mut world = world_of(ModelKind::Precomputed, vec![tool(ToolKind::hook(SWEPT_BY_TIME), 0.1)]);
    let burnt_m3 = burn_a_groove(&mut world);
    assert!(burnt_m3 == 0.0 && world.removed_volume_m3() > 1e-7, "{}", world.removed_volume_m3());
}

#[test]
fn scissors_part_what_they_close_on() {
    let whole = |kind, snip| (kind, snip, false);
    for (model, snip, parts) in [
        (ModelKind::Explicit, Snip::Embedded, true),
        (ModelKind::Implicit, Snip::Embedded, true),
        (ModelKind::TensorMass, Snip::Subdivision, true),
        whole(ModelKind::Explicit, Snip::Tetrahedra),
        // A model that follows nothing but removals.
        whole(ModelKind::Precomputed, Snip::Embedded),
    ] {
        let mut world = world_of(model, vec![tool(ToolKind::scissors(JAWS, snip), 0.3)]);
        world.set_undo_depth(1000);
        let whole_m3 = world.organ().body().volume_m3();
        // Half of what is between the jaws is tissue.
        let open = ToolInput { jaw_opening: 1.0, ..above(0.5 * SIZE_M, 0.043, SIZE_M - 0.5 * JAWS.length_m) };
        world.step(&StepInput::of(&[open]).placed());
        let before = world.state_hash();
        let mut found = glisson::world::ToolCuts::default();
        for i in 0..=20 {
            let pose = ToolInput { jaw_opening: 1.0 - f64::from(i) / 20.0, ..open };
            world.step(&StepInput::of(&[pose]));
            let cuts = world.cut_with_tools();
            found.n_removed += cuts.n_removed;
            found.n_edits += cuts.n_edits;
            found.strokes.extend(cuts.strokes);
            found.refusals.extend(cuts.refusals);
        }
        let what = format!("{model} {snip:?}: {found:?}");
        assert!(found.refusals.is_empty() && world.held_nodes(0).is_empty(), "{what}");
        assert_eq!((found.n_edits > 0, found.n_removed > 0), (parts, !parts), "{what}");
        let lost = 1.0 - world.organ().body().volume_m3() / whole_m3;
        assert_eq!(lost.abs() < 1e-12, parts, "{what}");
        if parts {
            let [(0, stroke)] = found.strokes[..] else { panic!("{what}") };
            assert_eq!(*world.blades(), stroke, "{what}");
            let off = stroke.cut_area_m2 / stroke.swept_area_m2 - 1.0;
            // The sector of a circle below the surface at rest, which jaws have dented: its hinge is half its length above.
            let half: f64 = 0.5;
            let sector_m2 = JAWS.length_m.powi(2) * (half - 0.25 * half.tan());
            let off_sector = stroke.swept_area_m2 / sector_m2 - 1.0;
            assert!(off.abs() < 0.02 && off_sector.abs() < 0.15, "{off} {off_sector} {what}");
        }
        assert!(world.state_hash() != before);
        while world.undo_edit() {}
        // Of models that are copied for it, two edits are taken back.
        if model == ModelKind::Explicit {
            assert_eq!(world.organ().body().volume_m3(), whole_m3, "{what}");
        }
    }
}

/// Some edits of many kinds in the middle of a push; answers how many were made.
fn edit_much(world: &mut World, n_rounds: usize) -> usize {
    let mut n_made = 0;
    let mut random = SeededRandom::new(3);
    for round in 0..n_rounds {
        let topology = world.organ().body().topology();
        let live: Vec<TetId> = topology.live_tets().collect();
        let tet = live[(random.uniform() * live.len() as f64) as usize];
        let edit = match round % 3 {
            0 => MeshEdit::Remove { tets: vec![tet] },
            1 => {
                let edge: EdgeId = topology.tet_edges(tet)[round % 6];
                MeshEdit::Split { edges: vec![EdgeSplit { edge, fraction: 0.4 }] }
            }
            _ => {
                let node = topology.tet_nodes(tet)[0];
                let moved_m = world.organ().mesh().positions_m[node.index()] + DVec3::splat(5e-4);
                MeshEdit::MoveVertex { node, position_m: moved_m }
            }
        };
        // A node at the border may not move; what is refused changes nothing.
        let hash = world.state_hash();
        match world.edit(&edit) {
            Ok(_) => n_made += 1,
            Err(_) => assert_eq!(world.state_hash(), hash),
        }
    }
    n_made
}

#[test]
fn edits_are_taken_back_bit_for_bit() {
    for kind in [ModelKind::Explicit, ModelKind::TensorMass, ModelKind::Implicit] {
        let tools = vec![tool(ToolKind::grasper(JAWS), 10.0), tool(ToolKind::PROBE, 0.3)];
        let (mut edited, mut whole) = (world_of(kind, tools.clone()), world_of(kind, tools));
        let open = ToolInput { jaw_opening: 1.0, ..above(SIZE_M, 0.04, SIZE_M - 2e-3) };
        let closed = ToolInput { jaw_opening: 0.0, ..open };
        let (near, deep) = (above(0.03, 0.05, SIZE_M + 4e-3), above(0.03, 0.05, SIZE_M - 1e-3));
        for world in [&mut edited, &mut whole] {
            world.step(&StepInput::of(&[open, near]).placed());
            glide(world, &[open, near], &[closed, deep], 30);
            assert!(world.report().tools.iter().take(2).all(|t| t.in_contact), "{kind}");
        }
        assert_eq!(edited.state_hash(), whole.state_hash(), "{kind}");
        // Models that have to be copied whole go back two edits.
        let n_rounds = if kind == ModelKind::Explicit { 12 } else { 2 };
        let n_edits = edit_much(&mut edited, n_rounds);
        assert!(
            3 * n_edits >= 2 * n_rounds && edited.state_hash() != whole.state_hash(),
            "{kind}: {n_edits}"
        );
        for _ in 0..n_edits {
            assert!(edited.undo_edit(), "{kind}");
        }
        assert!(!edited.undo_edit());
        assert_eq!(edited.state_hash(), whole.state_hash(), "{kind}");
        assert_eq!(edited.display_topology().triangles, whole.display_topology().triangles);
        for world in [&mut edited, &mut whole] {
            glide(world, &[closed, deep], &[closed, near], 40);
        }
        assert_eq!(edited.state_hash(), whole.state_hash(), "{kind}: after further steps");
    }
}

#[test]
fn the_journal_is_bounded_and_a_refused_edit_is_not_in_it() {
    let mut world = world(vec![tool(ToolKind::PROBE, 0.3)]);
    world.set_undo_depth(3);
    for t in 0..5 {
        world.edit(&MeshEdit::Remove { tets: vec![TetId::from_index(7 * t)] }).unwrap();
    }
    assert_eq!(world.n_edits_to_undo(), 3);
    let hash = world.state_hash();
    let again = MeshEdit::Remove { tets: vec![TetId(7)] };
    assert!(matches!(world.edit(&again), Err(EditRefusal::Mesh(_))));
    let list = [MeshEdit::Remove { tets: vec![TetId(50)] }, again];
    assert!(world.edit_all(&list).is_err());
    assert_eq!((world.state_hash(), world.n_edits_to_undo()), (hash, 3));
    // After steps the organ is back where it was at the edit, and the tool holds nothing.
    glide(&mut world, &[above(0.05, 0.05, 0.2)], &[above(0.05, 0.05, 0.2)], 5);
    assert!(world.undo_edit() && world.undo_edit() && world.undo_edit() && !world.undo_edit());
    assert_eq!(world.organ().removed_tetrahedra(), [TetId(0), TetId(7)]);
}

#[test]
fn a_contact_outlasts_an_edit_elsewhere_and_ends_when_its_triangle_goes() {
    let mut world = world(vec![tool(ToolKind::PROBE, 0.3)]);
    let start = above(0.05, 0.05, SIZE_M + 4e-3);
    world.step(&StepInput::of(&[start]).placed());
    let deep = above(0.05, 0.05, SIZE_M - 2e-3);
    glide(&mut world, &[start], &[deep], 100);
    let contact = world.snapshot().tools[0].contacts[0].unwrap();
    let near: Vec<TetId> = world.touched_tetrahedra(0);
    assert!(!near.is_empty());
    let topology = world.organ().body().topology();
    let far = topology.live_tets().find(|t| !near.contains(t)).unwrap();
    let under = topology
        .node_tets(contact.nodes[0])
        .iter()
        .copied()
        .filter(|&t| contact.nodes.iter().all(|n| topology.tet_nodes(t).contains(n)))
        .collect::<Vec<_>>();
    world.edit(&MeshEdit::Remove { tets: vec![far] }).unwrap();
    assert_eq!(world.snapshot().tools[0].contacts[0], Some(contact));
    world.edit(&MeshEdit::Remove { tets: under }).unwrap();
    assert_eq!(world.snapshot().tools[0].contacts[0], None);
    // It stands in the crater: it touches again, and the tissue is pushed out gently.
    glide(&mut world, &[deep], &[deep], 300);
    assert_eq!(world.report().n_non_finite_nodes, 0);
}

#[test]
fn a_tip_of_any_shape_touches() {
    // A cube of 8 mm about the tip.
    let corner = |i: usize| DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) * 8e-3 - 4e-3;
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
    let shape = MeshShape::new((0..8).map(corner).collect(), triangles);
    let cube = Tool { shape: ToolShape::Mesh(shape), ..tool(ToolKind::PROBE, 0.3) };
    let mut world = world(vec![cube]);
    let start = above(0.05, 0.05, SIZE_M + 6e-3);
    world.step(&StepInput::of(&[start]).placed());
    glide(&mut world, &[start], &[above(0.05, 0.05, SIZE_M + 1e-3)], 100);
    let snapshot = world.snapshot().tools[0];
    let contact = snapshot.contacts[0].expect("the cube's lower face touches");
    assert!(snapshot.force_n.z > 0.0 && (contact.point_m.z - (SIZE_M - 3e-3)).abs() < 3e-4, "{contact:?}");
}

#[test]
fn steps_with_four_tools_that_touch_hold_and_slide_allocate_nothing() {
    let tools = vec![
        tool(ToolKind::grasper(JAWS), 10.0),
        tool(ToolKind::PROBE, 0.2),
        tool(ToolKind::scissors(JAWS, Snip::Embedded), 0.2),
        tool(ToolKind::PROBE, 0.0),
    ];
    let mut world = world(tools);
    let mut snapshot = world.snapshot();
    let pose = |t: f64| {
        let swing = libm::sin(20.0 * t);
        [
            ToolInput { jaw_opening: 0.5 + 0.5 * libm::cos(20.0 * t), ..above(SIZE_M, 0.04, SIZE_M - 2e-3) },
            above(0.03 + 0.01 * swing, 0.05, SIZE_M + 1e-3),
            ToolInput { jaw_opening: 1.0, ..above(0.05, 0.08, SIZE_M + 4e-3 + 5e-3 * swing) },
            above(0.07 + 0.01 * swing, 0.03, SIZE_M),
        ]
    };
    // Its jaws are around the edge before they close.
    world.step(&StepInput::of(&pose(0.0)).placed());
    let mut n_held = 0;
    let count = allocation_counter::measure(|| {
        for step in 1..2000 {
            let report = world.step(&StepInput::of(&pose(f64::from(step) * TIME_STEP_S)));
            assert_eq!(report.n_non_finite_nodes, 0);
            n_held = n_held.max(report.tools[0].n_held_nodes);
            world.snapshot_into(&mut snapshot);
        }
    });
    assert!(n_held > 0);
    assert_eq!(count.count_total, 0);
}

#[test]
fn a_tool_in_a_trocar_points_to_it() {
    let trocar_m = DVec3::new(0.05, 0.05, 0.3);
    let mut world = world(vec![Tool { trocar_m: Some(trocar_m), ..tool(ToolKind::PROBE, 0.3) }]);
    let wrong = ToolInput::at(DVec3::new(0.08, 0.05, 0.15), DVec3::X);
    world.step(&StepInput::of(&[wrong]));
    let pose = world.snapshot().tools[0].pose;
    let to_trocar = (trocar_m - pose.tip_in_world_m).normalize();
    assert!(pose.shaft_in_world.distance(to_trocar) < 1e-15 && pose.tip_in_world_m == wrong.tip_in_world_m);
}

#[test]
fn a_scalpel_parts_the_block_along_its_sweep_and_every_step_can_be_taken_back() {
    for cuts in [BladeCuts::Subdivision, BladeCuts::Displacement] {
        let blade = Blade { length_m: 0.06, edge_radius_m: 0.0, cuts };
        let mut world = world(vec![tool(ToolKind::scalpel(blade), 0.3)]);
        world.set_undo_depth(1000);
        let whole_m3 = world.organ().body().volume_m3();
        // From outside the block through half of it, 30 mm deep.
        let pose = |t: f64| ToolInput { trigger: 1.0, ..above(-0.01 + 0.06 * t, 0.047, SIZE_M - 0.03) };
        world.step(&StepInput::of(&[pose(0.0)]).placed());
        let before = world.state_hash();
        let (mut n_edits, mut refusals) = (0, Vec::new());
        for i in 1..=40 {
            let report = world.step(&StepInput::of(&[pose(f64::from(i) / 40.0)]));
            assert_eq!(report.n_non_finite_nodes, 0);
            let cuts = world.cut_with_tools();
            n_edits += cuts.n_edits;
            refusals.extend(cuts.refusals);
        }
        world.step(&StepInput::of(&[ToolInput { trigger: 0.0, ..pose(1.0) }]));
        n_edits += world.cut_with_tools().n_edits;
        assert!(n_edits > 0, "{cuts:?}: {refusals:?}");
        let off = (world.organ().body().volume_m3() / whole_m3 - 1.0).abs();
        assert!(off < 1e-9, "{cuts:?}: {off}");
        assert_eq!(world.n_edits_to_undo(), n_edits);
        while world.undo_edit() {}
        assert_eq!(world.organ().body().mesh(), &block([5, 5, 5], DVec3::splat(SIZE_M)), "{cuts:?}");
        let _ = before;
    }
}

#[test]
fn a_model_that_takes_over_follows_edits_of_all_kinds() {
    let mut world = world(vec![tool(ToolKind::PROBE, 0.3)]);
    let far = above(0.05, 0.05, 0.2);
    let n_edits = edit_much(&mut world, 12);
    assert!(n_edits >= 8 && !world.has_only_removals());
    let material = LinearElastic::from_young_poisson(5e3, 0.4, 1000.0).unwrap();
    let mut body = OrganBody::new(block([5, 5, 5], DVec3::splat(SIZE_M)), material, TIME_STEP_S);
    body.fixed = fixed_nodes(&world.spec().supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 60.0, stiffness_s: 0.0 };
    world.queue_model_swap(10, ModelKind::TensorMass);
    let model = build_model(&body, ModelKind::TensorMass).unwrap();
    assert_eq!(world.deliver_model(model, ModelKind::TensorMass), Ok(true));
    for _ in 0..50 {
        assert_eq!(world.step(&StepInput::of(&[far])).n_non_finite_nodes, 0);
    }
    assert_eq!(world.model_kind(), ModelKind::TensorMass);
    assert!(!world.undo_edit(), "edits of the model before cannot be undone");
}

/// The end of a bar whose zones were pre-computed: the last stroke frees more than the zone that it goes through.
#[test]
fn a_piece_that_a_blade_cuts_loose_from_a_hybrid_falls() {
    let size_m = DVec3::new(0.12, 0.03, 0.03);
    let mesh = block([12, 3, 3], size_m);
    let blade = Blade { length_m: 0.06, edge_radius_m: 0.0, cuts: BladeCuts::Embedded };
    let mut spec = WorldSpec::new("bar", TIME_STEP_S, tool(ToolKind::scalpel(blade), 0.3));
    spec.supports =
        vec![Support::all_axes(Region::Furthest { direction: DVec3::NEG_X, fraction: 1.0 / 24.0 })];
    let material = LinearElastic::from_young_poisson(2e4, 0.4, 1000.0).unwrap();
    let mut body = OrganBody::new(mesh, material, TIME_STEP_S);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    body.damping = Rayleigh { mass_per_s: 0.1, stiffness_s: 0.0 };
    body.embeds_cuts = true;
    let model = build_model(&body, ModelKind::Hybrid).unwrap();
    let mut world = World::new(spec, body.mesh, model, ModelKind::Hybrid).unwrap();
    let at = |y_m: f64, trigger: f64| ToolInput { trigger, ..above(0.0751, y_m, -0.01) };
    let mut n_edits = 0;
    for [from_m, to_m] in [[-0.01, 0.0157], [0.04, 0.0143]] {
        world.step(&StepInput::of(&[at(from_m, 1.0)]).placed());
        for i in 1..=30 {
            let share = f64::from(i) / 30.0;
            world.step(&StepInput::of(&[at(from_m + (to_m - from_m) * share, 1.0)]));
            n_edits += world.cut_with_tools().n_edits;
        }
        world.step(&StepInput::of(&[at(to_m, 0.0)]));
        n_edits += world.cut_with_tools().n_edits;
    }
    assert!(n_edits > 1, "{n_edits}");
    let far = StepInput::of(&[above(0.0, 0.0, 0.5)]);
    world.step(&far.placed());
    world.set_gravity(DVec3::NEG_Z * 9.81);
    let before: Vec<DVec3> = world.state().positions_m.to_vec();
    let n_steps = (0.05 / TIME_STEP_S) as u32;
    for _ in 0..n_steps {
        world.step(&far);
    }
    let fallen_m = 0.5 * 9.81 * 0.05 * 0.05;
    let rest_m = world.organ().mesh().positions_m.clone();
    for n in (0..rest_m.len()).filter(|n| rest_m[*n].x > 0.095) {
        let way_m = world.state().positions_m[n] - before[n];
        assert!((way_m.z / -fallen_m - 1.0).abs() < 0.15, "{} of {fallen_m} m at {}", way_m.z, rest_m[n]);
    }
}

/// Planning an edit that is refused takes the time of many steps.
#[test]
fn an_edge_does_not_try_in_every_step_what_the_model_cannot_follow() {
    let blade = Blade { length_m: 0.06, edge_radius_m: 0.0, cuts: BladeCuts::Embedded };
    let mut world = world_of(ModelKind::Precomputed, vec![tool(ToolKind::scalpel(blade), 0.3)]);
    let pose = |x_m: f64, trigger: f64| ToolInput { trigger, ..above(x_m, 0.047, SIZE_M - 0.03) };
    world.step(&StepInput::of(&[pose(-0.01, 1.0)]).placed());
    let mut n_refused = 0;
    let n_steps = (0.6 / TIME_STEP_S) as u32;
    for i in 1..=n_steps {
        world.step(&StepInput::of(&[pose(-0.01 + 0.09 * f64::from(i) / f64::from(n_steps), 1.0)]));
        let cuts = world.cut_with_tools();
        assert_eq!((cuts.n_edits, cuts.n_removed), (0, 0));
        n_refused += cuts.refusals.len();
    }
    assert!((1..=4).contains(&n_refused), "{n_refused}");
}

#[test]
fn scissors_that_stand_half_open_push_tissue() {
    let greatest_n = |closes: bool| {
        let mut world = world(vec![tool(ToolKind::scissors(JAWS, Snip::Subdivision), 0.3)]);
        let pose = |z_m: f64, jaw_opening: f64| ToolInput { jaw_opening, ..above(0.05, 0.05, z_m) };
        world.step(&StepInput::of(&[pose(SIZE_M + 0.02, 1.0)]).placed());
        let opening = if closes { 0.5 } else { 1.0 };
        let mut force_n: f64 = 0.0;
        for i in 0..=400 {
            // Half closed in the air, then lowered.
            let jaw = if i < 20 { 1.0 + (opening - 1.0) * f64::from(i) / 20.0 } else { opening };
            let down_m = 0.03 * (f64::from(i - 200).max(0.0) / 200.0);
            world.step(&StepInput::of(&[pose(SIZE_M + 0.02 - down_m, jaw)]));
            force_n = force_n.max(world.report().tools[0].force_on_tool_n.length());
        }
        force_n
    };
    assert!(greatest_n(false) > 0.1 && greatest_n(true) > 0.1);
}
