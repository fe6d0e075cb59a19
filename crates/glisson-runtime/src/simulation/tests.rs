//! The runtime on a small body: what is recorded replays to the same bits, also across a change of model.

use super::*;
use crate::account::Account;
use crate::replay::replay;
use crate::script::{Clip, Lead, Script};
use glisson::image::vessels::{Tube, write_vessels};
use glisson::math::DVec3;
use glisson::model::FollowedEdits;
use glisson::model::precomputed::{
    Precision, Precomputed, PrecomputedParams, RecomputationLimits, StoredNodes,
};
use glisson::record::note::Note;
use glisson::record::session::parse_session;
use glisson::tool::ToolInput;

const MESH: &str = "5 2\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n60 60 60\n0 1 2 3\n1 4 2 3\n";
const SCENE: &str = "glisson_scene = 1\n[organ]\nmesh = \"body.tet\"\nyoung_modulus = \"5 kPa\"\n\
    poisson_ratio = 0.45\ndensity = \"1000 kg/m3\"\nmodel = \"tensor_mass\"\ndamping = \"30 1/s\"\n\
    [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.6 }\n\
    [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\nhome_shaft = [0, 0, 1]\n";

fn scene_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("body.tet"), MESH).unwrap();
    std::fs::write(folder.path().join("scene.toml"), SCENE).unwrap();
    folder
}

fn input(step: u64) -> StepInput {
    let depth_m = 0.05 * (step as f64 * 0.01).sin().abs();
    let tip_in_world_m = DVec3::new(0.04, 0.04, 0.09 - depth_m);
    let input =
        StepInput::of(&[ToolInput::at(tip_in_world_m, DVec3::Z)]).divided(1 + (step / 100 % 2) as u32);
    if step == 250 { input.placed() } else { input }
}

/// 600 steps with a reset and a swap to the pre-computed model at step 300; answers the last hash.
fn record(folder: &Path) -> StateHash {
    let source = OpenScene::read(&folder.join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.join("session.jsonl"))).unwrap();
    let mut touched = false;
    for step in 0..600 {
        if step == 120 {
            simulation.reset().unwrap();
        }
        if step == 200 {
            simulation.order_model(ModelKind::Precomputed, 300).unwrap();
        }
        touched |= simulation.advance(&input(step)).unwrap().in_contact();
        let expected = if step < 300 { ModelKind::TensorMass } else { ModelKind::Precomputed };
        assert_eq!(simulation.world().model_kind(), expected, "step {step}");
    }
    assert!(touched);
    simulation.finish().unwrap()
}

#[test]
fn a_session_with_reset_substeps_and_a_change_of_model_replays_to_the_same_bits() {
    let folder = scene_folder();
    let hash = record(folder.path());
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let session = parse_session(&text).unwrap();
    assert!(!session.cut_off);
    let report = replay(&session, folder.path(), |_| Ok(())).unwrap();
    assert_eq!((report.steps, report.state_hash, report.recorded_hash), (600, hash, Some(hash)));
    assert_eq!((report.checkpoints, report.first_difference), (1, None));
}

#[test]
fn a_recording_that_was_cut_off_replays_as_far_as_it_goes() {
    let folder = scene_folder();
    record(folder.path());
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let without_end = &text[..text.trim_end().rfind('\n').unwrap() + 20];
    let session = parse_session(without_end).unwrap();
    assert!(session.cut_off);
    let report = replay(&session, folder.path(), |_| Ok(())).unwrap();
    assert_eq!(report.recorded_hash, None);
    assert!(report.steps < 600 && report.first_difference.is_none());
}

#[test]
fn another_mesh_under_the_same_name_is_refused() {
    let folder = scene_folder();
    record(folder.path());
    std::fs::write(folder.path().join("body.tet"), MESH.replace("0 0 60", "0 0 61")).unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let error = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).err().unwrap().to_string();
    assert!(error.contains("not the one of the recording") && error.contains("--folder"), "{error}");
}

#[test]
fn a_model_that_cannot_be_made_is_told_and_the_present_one_goes_on_also_in_the_replay() {
    let folder = scene_folder();
    let scene = SCENE.replace("\"tensor_mass\"", "\"precomputed\"");
    std::fs::write(folder.path().join("scene.toml"), scene + "[simulation]\ntime_step = \"1 s\"\n").unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
    simulation.order_model(ModelKind::TensorMass, 5).unwrap();
    for step in 0..20 {
        simulation.advance(&input(step)).unwrap();
    }
    assert_eq!(simulation.world().model_kind(), ModelKind::Precomputed);
    assert!(simulation.notices()[0].text.contains("stable"), "{:?}", simulation.notices());
    let hash = simulation.finish().unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_eq!(report.state_hash, hash);
}

#[test]
fn a_tilted_table_a_cut_and_a_change_of_model_replay_to_the_same_bits() {
    let folder = scene_folder();
    let scene = SCENE.replace("[organ]\n", "[simulation]\ngravity = [0, 0, \"-9.81 m/s2\"]\n[organ]\n");
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
    let away = StepInput::of(&[simulation.world().tools()[0].home]);
    simulation.advance(&away).unwrap();
    let rest = simulation.mesh().positions_m.clone();
    let moved_m = |simulation: &Simulation| {
        let now = simulation.world().state().positions_m.iter().zip(&rest);
        now.map(|(p, rest)| p.distance(*rest)).fold(0.0, f64::max)
    };
    assert!(moved_m(&simulation) < 1e-15, "imaged under gravity: {}", moved_m(&simulation));
    for step in 1..400 {
        match step {
            20 => simulation.set_gravity(DVec3::new(4.0, 0.0, -8.0)).unwrap(),
            100 => simulation.order_model(ModelKind::Explicit, 150).unwrap(),
            // Before and after the other model takes over.
            120 => simulation.remove_tetrahedra(vec![TetId(1)]).unwrap(),
            300 => simulation.remove_tetrahedra(vec![TetId(1)]).unwrap(),
            _ => {}
        }
        simulation.advance(&away).unwrap();
        assert!(step < 40 || moved_m(&simulation) > 1e-5, "step {step}");
    }
    assert_eq!(simulation.world().model_kind(), ModelKind::Explicit);
    // A tetrahedron goes once; the second time is told.
    assert_eq!(simulation.notices().len(), 1, "{:?}", simulation.notices());
    assert!(simulation.notices()[0].text.starts_with("nothing was cut"), "{:?}", simulation.notices());
    let hash = simulation.finish().unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let session = parse_session(&text).unwrap();
    let report = replay(&session, folder.path(), |_| Ok(())).unwrap();
    assert_eq!((report.state_hash, report.first_difference), (hash, None));

    // Without the tilt it is another run.
    let level = text.lines().filter(|line| !line.contains("\"gravity\"")).collect::<Vec<_>>().join("\n");
    let report = replay(&parse_session(&level).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_ne!(report.state_hash, hash);
}

#[test]
fn cuts_of_the_precomputed_model_and_its_fresh_precomputation_replay_to_the_same_bits() {
    let folder = scene_folder();
    let scene = SCENE.replace("\"tensor_mass\"", "\"precomputed\"");
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
    let mut touched_after = false;
    // Down to what is left without the outer tetrahedron.
    let input = |step| {
        let mut input = input(step);
        input.tools[0].tip_in_world_m += DVec3::new(-0.02, -0.02, -0.03);
        input
    };
    for step in 0..300 {
        match step {
            60 => simulation.remove_tetrahedra(vec![TetId(1)]).unwrap(),
            80 => simulation.order_model(ModelKind::Precomputed, 150).unwrap(),
            200 => simulation.remove_tetrahedra(vec![TetId(0)]).unwrap(),
            _ => {}
        }
        let report = simulation.advance(&input(step)).unwrap();
        touched_after |= step > 60 && report.in_contact();
        assert_eq!(report.model.n_reanalyses, u32::from((60..150).contains(&step) || step >= 200), "{step}");
    }
    assert!(simulation.notices().is_empty(), "{:?}", simulation.notices());
    let hash = simulation.finish().unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_eq!((report.state_hash, report.first_difference), (hash, None));
    assert!(touched_after);
}

#[test]
fn a_fresh_precomputation_is_ordered_where_the_cut_one_asks_for_it() {
    let folder = scene_folder();
    let scene = SCENE.replace("\"tensor_mass\"", "\"precomputed\"");
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, None).unwrap();
    // The scene's model, but with a limit that the first cut reaches.
    let body = simulation.body();
    let kind = ModelKind::Precomputed;
    let mut model = Precomputed::build(&PrecomputedParams {
        mesh: &body.mesh,
        material: &body.material,
        fixed_nodes: &kind.row().nodes_fixed_wholly(body).unwrap(),
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })
    .unwrap();
    model.set_recomputation_limits(RecomputationLimits { n_columns: 5, ..RecomputationLimits::default() });
    simulation.world.queue_model_swap(0, kind);
    simulation.world.deliver_model(Box::new(model), kind).unwrap();
    let mut ordered_at = None;
    let mut fresh_at = None;
    for step in 0..2_100 {
        if step == 20 {
            simulation.remove_tetrahedra(vec![TetId(1)]).unwrap();
        }
        let report = simulation.advance(&input(step)).unwrap();
        assert_eq!(
            report.model.wants_recomputation,
            step >= 20 && fresh_at.is_none() && report.model.n_reanalyses > 0
        );
        if simulation.builder.is_some() {
            ordered_at = ordered_at.or(Some(step));
        } else if ordered_at.is_some() && fresh_at.is_none() {
            fresh_at = Some(step);
            assert_eq!((report.model.n_reanalyses, report.model.wants_recomputation), (0, false));
        }
    }
    // Two seconds of the scene's time later.
    assert_eq!((ordered_at, fresh_at), (Some(20), Some(21 + 2_000)));
    assert!(simulation.notices().is_empty(), "{:?}", simulation.notices());
}

#[test]
fn a_session_of_two_hands_with_cuts_and_undo_replays_to_the_same_bits() {
    let folder = scene_folder();
    let tools = "[[tool]]\nkind = \"hook\"\ntip_radius = \"5 mm\"\nhome_tip = [\"40 mm\", \"40 mm\", \"90 mm\"]\n\
        home_shaft = [0, 0, 1]\ncut_force = \"1 mN\"\ncut_time = \"20 ms\"\n\
        [[tool]]\nkind = \"grasper\"\ntip_radius = \"2 mm\"\nhome_tip = [\"60 mm\", \"60 mm\", \"60 mm\"]\n\
        trocar = [\"100 mm\", \"100 mm\", \"200 mm\"]\nhome_jaw = 1\n";
    let scene = SCENE[..SCENE.find("[tool]").unwrap()].to_owned() + tools;
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
    let homes: Vec<ToolInput> = simulation.world().tools().iter().map(|tool| tool.home).collect();
    let (mut n_held, mut n_cut) = (0, 0);
    for step in 0..400_u32 {
        let mut tools = homes.clone();
        tools[0].tip_in_world_m.z -= 0.05 * (f64::from(step) * 0.01).sin().abs();
        tools[0].trigger = if step > 60 { 1.0 } else { 0.0 };
        // The body has one free node: the grasper lets it go before the hook comes.
        tools[1].jaw_opening = if (20..50).contains(&step) { 0.0 } else { 1.0 };
        tools[1].tip_in_world_m.z += 2e-5 * f64::from(step.min(100));
        let report = simulation.advance(&StepInput::of(&tools)).unwrap();
        n_held = n_held.max(report.tools[1].n_held_nodes);
        n_cut = n_cut.max(simulation.world().n_edits_to_undo());
        if step == 380 {
            simulation.undo_edit().unwrap();
        }
    }
    assert!(n_held > 0 && n_cut > 0, "{n_held} held, {n_cut} cut: {:?}", simulation.notices());
    let hash = simulation.finish().unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    assert!(text.contains("\"undo_edit\""));
    let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_eq!((report.state_hash, report.recorded_hash), (hash, Some(hash)));
}

/// A block of 40 mm with a vessel through its upper edge, as a scene that tears.
fn block_folder(tool: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mesh = glisson::mesh::box_mesh::box_of_five([4; 3], DVec3::splat(0.04));
    let mut text = format!("{} {}\n", mesh.positions_m.len(), mesh.tetrahedra.len());
    for p in &mesh.positions_m {
        text += &format!("{} {} {}\n", 1e3 * p.x, 1e3 * p.y, 1e3 * p.z);
    }
    for [a, b, c, d] in &mesh.tetrahedra {
        text += &format!("{} {} {} {}\n", a.0, b.0, c.0, d.0);
    }
    std::fs::write(folder.path().join("body.tet"), text).unwrap();
    let tube = Tube {
        parent: None,
        ends_m: [DVec3::new(0.037, 0.003, 0.036), DVec3::new(0.037, 0.037, 0.036)],
        radii_m: [1e-3; 2],
    };
    let mut vessels = Vec::new();
    write_vessels(&mut vessels, &[tube]).unwrap();
    std::fs::write(folder.path().join("vessels.csv"), vessels).unwrap();
    let scene = SCENE[..SCENE.find("[tool]").unwrap()]
        .replace("tensor_mass", "explicit")
        .replace("fraction = 0.6", "fraction = 0.2")
        .replace("[organ]\n", "[simulation]\ntime_step = \"0.2 ms\"\n[organ]\ntearing = true\nfracture_energy = \"20 J/m2\"\nvessels = \"vessels.csv\"\n");
    std::fs::write(folder.path().join("scene.toml"), scene + tool).unwrap();
    folder
}

#[test]
fn instruments_that_cut_tear_and_clip_replay_to_the_same_bits() {
    let home =
        "tip_radius = \"2 mm\"\nhome_tip = [\"40 mm\", \"17 mm\", \"80 mm\"]\nhome_shaft = [0, 0, 1]\n";
    // Closed on the edge; each with what it does between steps 50 and 400.
    for (kind, more) in [
        ("scissors", ""),
        ("cautery", "cut_time = \"5 ms\"\n"),
        ("scalpel", "blade_length = \"30 mm\"\n"),
        ("probe", ""),
    ] {
        let folder = block_folder(&format!("[tool]\nkind = \"{kind}\"\n{home}{more}"));
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
        let (mut bled, mut n_edits) = (false, 0);
        for step in 0..450_u32 {
            let t = f64::from(step) / 450.0;
            let tip_in_world_m = match kind {
                "scalpel" => DVec3::new(0.06 - 0.05 * t, 0.017, 0.03),
                "probe" => DVec3::new(0.033, 0.017, 0.045 - 0.04 * t),
                _ => DVec3::new(0.04, 0.017, 0.032),
            };
            let pose = ToolInput {
                jaw_opening: 1.0 - (f64::from(step) / 100.0).min(1.0),
                trigger: if step > 20 { 1.0 } else { 0.0 },
                ..ToolInput::at(tip_in_world_m, DVec3::Z)
            };
            simulation.advance(&StepInput::of(&[pose])).unwrap();
            n_edits = n_edits.max(simulation.world().n_edits_to_undo());
            bled |= simulation.world().vessels().unwrap().bleeding_m3_per_s() > 0.0;
            match step {
                410 => simulation.refine_around(0).unwrap(),
                420 => simulation.clip_vessel(0).unwrap(),
                440 | 442 => simulation.undo_edit().unwrap(),
                _ => {}
            }
        }
        assert!(n_edits > 0, "{kind}: {:?}", simulation.notices());
        assert!(bled || kind == "probe", "{kind}: {:?}", simulation.notices());
        let account = Account::of(simulation.world());
        assert!(account.to_text().contains("blood lost") && account.to_json()["clips"].is_u64(), "{kind}");
        let hash = simulation.finish().unwrap();
        let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
        for event in ["clip", "refine", "undo_edit"] {
            assert!(text.contains(&format!("\"{event}\"")), "{kind}: {event}");
        }
        let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
        assert_eq!((report.state_hash, report.first_difference), (hash, None), "{kind}");
        assert_eq!(report.account, account, "{kind}");
    }
}

/// The paths of a scene.
struct Paths {
    scene: Scene,
    end_s: f64,
    time_s: f64,
}

impl Paths {
    /// From their beginning.
    fn of(scene: Scene) -> Self {
        let end_s = scene.end_of_paths_s().unwrap_or(0.0);
        Self { scene, end_s, time_s: 0.0 }
    }
}

impl Script for Paths {
    fn lead(&mut self, world: &World) -> Option<Lead> {
        if self.time_s >= self.end_s {
            return None;
        }
        self.time_s = (world.steps_made() + 1) as f64 * world.spec().time_step_s;
        Some(Lead { tools: self.scene.input_at(self.time_s).tools, clips: Vec::new() })
    }

    fn see(&mut self, _: &Clip) {}

    fn progress(&self) -> f64 {
        (self.time_s / self.end_s).min(1.0)
    }

    fn result(&self, _: &World) -> anyhow::Result<String> {
        Ok("the instruments are at the ends of their paths".to_owned())
    }
}

#[test]
fn instruments_follow_a_script_until_somebody_takes_them() {
    let path = "[[tool.path]]\ntime = \"0.1 s\"\ntip = [\"40 mm\", \"40 mm\", \"70 mm\"]\n";
    let folder = scene_folder();
    std::fs::write(folder.path().join("scene.toml"), SCENE.to_owned() + path).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let script = source.scene.clone();
    let mut simulation = Simulation::open(source, None).unwrap();
    assert_eq!(simulation.scripted_pose(0), None);
    simulation.follow_script(Box::new(Paths::of(script)));
    for _ in 0..50 {
        let pose = simulation.scripted_pose(0).unwrap();
        simulation.advance(&StepInput::of(&[pose])).unwrap();
    }
    let tip_m = simulation.world().snapshot().tools[0].pose.tip_in_world_m;
    assert!((tip_m.z - 0.08).abs() < 1e-12, "half of the way: {tip_m}");
    simulation.take_from_script(0);
    assert_eq!(simulation.scripted_pose(0), None);
}

/// Burns the block's edge through, clips what bleeds, and is over.
struct BurnsAndClips {
    step: u32,
    holds: Option<bool>,
}

impl Script for BurnsAndClips {
    fn lead(&mut self, world: &World) -> Option<Lead> {
        if self.holds.is_some() {
            return None;
        }
        self.step += 1;
        let bleeds = crate::script::bleeding_ml_per_min(world) > 0.0;
        let pose = ToolInput {
            jaw_opening: 1.0 - (f64::from(self.step) / 100.0).min(1.0),
            trigger: if self.step > 20 && !bleeds { 1.0 } else { 0.0 },
            ..ToolInput::at(DVec3::new(0.04, 0.017, 0.036), DVec3::Z)
        };
        Some(Lead { tools: [pose; MAX_TOOLS], clips: bleeds.then_some(0).into_iter().collect() })
    }

    fn see(&mut self, clip: &Clip) {
        self.holds = Some(clip.holds());
    }

    fn progress(&self) -> f64 {
        f64::from(u8::from(self.holds.is_some()))
    }

    fn result(&self, world: &World) -> anyhow::Result<String> {
        Ok(format!("{} clips", world.vessels().map_or(0, |vessels| vessels.n_clips())))
    }
}

#[test]
fn a_script_clips_tells_its_end_and_replays_to_the_same_bits() {
    let home =
        "tip_radius = \"2 mm\"\nhome_tip = [\"40 mm\", \"17 mm\", \"80 mm\"]\nhome_shaft = [0, 0, 1]\n";
    // In somebody's hand an instrument sets no clip for the script, which goes on all the same.
    for is_taken in [false, true] {
        let folder = block_folder(&format!("[tool]\nkind = \"cautery\"\n{home}cut_time = \"5 ms\"\n"));
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
        simulation.follow_script(Box::new(BurnsAndClips { step: 0, holds: None }));
        for _ in 0..1000 {
            if is_taken && simulation.is_about_to_clip() {
                simulation.take_from_script(0);
            }
            let input = simulation.scripted_input().unwrap();
            simulation.advance(&input).unwrap();
        }
        let n_clips = usize::from(!is_taken);
        assert!(simulation.script_is_over(), "{:?}", simulation.notices());
        assert_eq!(simulation.scripted_clips().len(), n_clips);
        let end = format!("the script is over: {n_clips} clips; state ");
        let told: Vec<_> = simulation.notices().iter().filter(|told| told.text.starts_with(&end)).collect();
        let [end] = told[..] else { panic!("{:?}", simulation.notices()) };
        assert!(!end.is_problem);
        let state_at_the_end = end.text.rsplit(' ').next().unwrap().to_owned();
        let hash = simulation.finish().unwrap();
        let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
        assert_eq!(text.matches("\"clip\"").count(), n_clips, "{is_taken}");
        assert!(text.contains(&state_at_the_end), "the recording holds the state at the script's end");
        let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
        assert_eq!((report.state_hash, report.first_difference), (hash, None));
    }
}

#[test]
fn a_session_with_less_effort_and_a_change_of_model_replays_to_the_same_bits() {
    let folder = scene_folder();
    let scene = SCENE.replace("\"tensor_mass\"", "\"nonlinear_tensor_mass\"");
    std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, Some(&folder.path().join("session.jsonl"))).unwrap();
    // The instrument lets go of the body before step 270 and stays away: the body swings freely, less and less, until
    // what is not linear is small enough to be left out.
    for step in 0..800 {
        match step {
            10 => assert!(simulation.set_level_of_detail(LevelOfDetail::Least).unwrap()),
            770 => simulation.order_model(ModelKind::Implicit, 790).unwrap(),
            795 => simulation.set_level_of_detail(LevelOfDetail::Full).map(|_| ()).unwrap(),
            _ => {}
        }
        simulation.advance(&input(step.min(314))).unwrap();
    }
    assert_eq!(simulation.world().model_kind(), ModelKind::Implicit, "{:?}", simulation.notices());
    let hash = simulation.finish().unwrap();
    let text = std::fs::read_to_string(folder.path().join("session.jsonl")).unwrap();
    let report = replay(&parse_session(&text).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_eq!((report.state_hash, report.first_difference), (hash, None));

    // At full effort it is another run.
    let full = text.lines().filter(|line| !line.contains("\"effort\"")).collect::<Vec<_>>().join("\n");
    let report = replay(&parse_session(&full).unwrap(), folder.path(), |_| Ok(())).unwrap();
    assert_ne!(report.state_hash, hash);
}

#[test]
fn a_haptic_loop_that_asks_for_models_changes_no_bit() {
    // The others ask for curves, or for more nodes than this body has.
    for model in ModelKind::ALL.into_iter().filter(|kind| kind.row().edits != FollowedEdits::None) {
        let folder = scene_folder();
        let scene = SCENE.replace("\"tensor_mass\"", &format!("\"{model}\""));
        std::fs::write(folder.path().join("scene.toml"), scene).unwrap();
        let [mut asked, mut left_alone] = [(); 2].map(|()| {
            Simulation::open(OpenScene::read(&folder.path().join("scene.toml")).unwrap(), None).unwrap()
        });
        let mut felt = false;
        for step in 0..300 {
            asked.advance(&input(step)).unwrap();
            left_alone.advance(&input(step)).unwrap();
            felt |= asked.haptic_model(0).touch != glisson::haptics::Touch::Free;
        }
        assert!(felt, "{model}");
        assert_eq!(asked.world().state_hash(), left_alone.world().state_hash(), "{model}");
    }
}

#[test]
fn notes_are_kept_and_change_nothing() {
    let folder = scene_folder();
    let run = |name: &str, with_notes: bool| {
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        let mut simulation = Simulation::open(source, Some(&folder.path().join(name))).unwrap();
        for step in 0..60 {
            if step == 20 && with_notes {
                // Of now, and of a moment ago.
                simulation.note(Note::Bookmark { time_s: f64::MAX, text: String::new() });
                simulation.note(Note::Bookmark { time_s: 0.005, text: "here".into() });
                simulation.note(Note::Drawing { points_m: vec![DVec3::X] });
                simulation.note(Note::Erased {});
            }
            simulation.advance(&input(step)).unwrap();
        }
        let news: Vec<String> = simulation.notices().iter().map(|notice| notice.text.clone()).collect();
        (simulation.finish().unwrap(), news)
    };
    let ((with, news), (without, _)) = (run("with.jsonl", true), run("without.jsonl", false));
    assert_eq!(with, without);
    assert!(news.iter().any(|text| text == "a bookmark at 0.01 s: here"), "{news:?}");
    let text = std::fs::read_to_string(folder.path().join("with.jsonl")).unwrap();
    let session = parse_session(&text).unwrap();
    let notes: Vec<_> = session
        .events
        .iter()
        .filter_map(|event| match event {
            SessionEvent::Note { step, note } => Some((*step, note.clone())),
            _ => None,
        })
        .collect();
    assert_eq!(notes.len(), 4);
    assert_eq!(notes[0], (20, Note::Bookmark { time_s: 0.02, text: String::new() }));
    assert_eq!(notes[1].1, Note::Bookmark { time_s: 0.005, text: "here".into() });
    let again = replay(&session, folder.path(), |_| Ok(())).unwrap();
    assert_eq!((again.state_hash, again.first_difference), (with, None));
    // Where nothing is recorded, there is no bookmark, and that is said.
    let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let mut simulation = Simulation::open(source, None).unwrap();
    simulation.note(Note::Bookmark { time_s: 0.0, text: String::new() });
    assert!(simulation.notices().iter().any(|notice| notice.text.contains("--record")));
}

/// The same body, in which a place is to be touched.
fn scene_with_task() -> String {
    let task = "[task]\ntitle = \"Touch it\"\n[[task.stage]]\ntitle = \"Touch\"\nhold = \"0.1 s\"\ntouch = { tool = \"tool\" }\n";
    SCENE.replace("[tool]\n", "[tool]\nname = \"tool\"\n") + task
}

#[test]
fn a_saved_moment_comes_back_with_its_task_and_its_cuts() {
    let folder = scene_folder();
    std::fs::write(folder.path().join("scene.toml"), scene_with_task()).unwrap();
    let open = || {
        let source = OpenScene::read(&folder.path().join("scene.toml")).unwrap();
        Simulation::open(source, None).unwrap()
    };
    let status = |simulation: &Simulation| simulation.task().unwrap().status();
    let mut simulation = open();
    (0..120).for_each(|step| assert!(simulation.advance(&input(step)).is_ok()));
    let (saved, before) = (simulation.save().unwrap(), status(&simulation));
    let go_on = |simulation: &mut Simulation| {
        simulation.remove_tetrahedra(vec![TetId(1)]).unwrap();
        (120..240).for_each(|step| assert!(simulation.advance(&input(step)).is_ok()));
        (simulation.world().state_hash(), status(simulation), simulation.task().unwrap().record().result())
    };
    let end = go_on(&mut simulation);
    assert_ne!(end.1, before);
    for _ in 0..2 {
        simulation.restore(&saved).unwrap();
        assert_eq!(status(&simulation), before);
        assert_eq!(go_on(&mut simulation), end);
    }
    // Another world of the same scene comes to the same moment.
    let mut other = open();
    other.restore(&saved).unwrap();
    assert_eq!(go_on(&mut other), end);
    // So does one that is made at it.
    assert_eq!(go_on(&mut other.another_at(&saved)), end);
}

#[test]
fn what_cannot_go_back_says_why() {
    let folder = scene_folder();
    let source = || OpenScene::read(&folder.path().join("scene.toml")).unwrap();
    let saved = Simulation::open(source(), None).unwrap().save().unwrap();
    let mut recorded = Simulation::open(source(), Some(&folder.path().join("session.jsonl"))).unwrap();
    assert_eq!(recorded.save().err(), Some(CannotSave::Recorded));
    assert_eq!(recorded.restore(&saved).err(), Some(CannotSave::Recorded));
    let mut ordered = Simulation::open(source(), None).unwrap();
    ordered.order_model(ModelKind::Precomputed, 10).unwrap();
    assert_eq!(ordered.save().err(), Some(CannotSave::ModelOrdered));
    // What was ordered is forgotten with the moment that it was ordered in.
    ordered.restore(&saved).unwrap();
    (0..20).for_each(|step| assert!(ordered.advance(&input(step)).is_ok()));
    assert_eq!(ordered.world().model_kind(), ModelKind::TensorMass);
    // So is what broke.
    let broken = ordered.break_off("a test".to_owned());
    assert_eq!(ordered.save().err(), Some(CannotSave::Broken(broken)));
    assert!(ordered.advance(&input(0)).is_err());
    ordered.restore(&saved).unwrap();
    assert!(ordered.advance(&input(0)).is_ok());
}
