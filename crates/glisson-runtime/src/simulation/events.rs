//! Events of a task: what they do becomes inputs of the world, which the session holds. A replay gets them from there.

use super::Simulation;
use glisson::math::DVec3;
use glisson::record::session::SessionEvent;
use glisson::training::task::Effects;
use glisson::world::StepInput;

impl Simulation {
    /// What becomes of an input where an event says that an instrument does not work.
    pub(super) fn impaired(&self, input: &StepInput) -> Option<StepInput> {
        let effects = self.task.as_ref().filter(|_| self.is_live)?.effects(&self.world);
        if effects.fails == Effects::default().fails {
            return None;
        }
        let mut impaired = *input;
        for (tool, pose) in impaired.tools.iter_mut().enumerate() {
            *pose = effects.on(tool, *pose);
        }
        Some(impaired)
    }

    /// After a step: vessels tear, tissue jerks. In a replay the session brings that about; here it is followed, for who goes on.
    pub(super) fn bring_events_about(&mut self) -> anyhow::Result<()> {
        if !self.is_live {
            while self.task.as_mut().and_then(|task| task.take_tear()).is_some() {}
            let acceleration = self.task.as_ref().map(|task| task.effects(&self.world).acceleration_m_per_s2);
            if acceleration.is_some_and(|jerk_m_per_s2| jerk_m_per_s2 != DVec3::ZERO) {
                self.steady_gravity_m_per_s2.get_or_insert(self.world.gravity_m_per_s2());
            } else {
                self.steady_gravity_m_per_s2 = None;
            }
            return Ok(());
        }
        while let Some(near_m) = self.task.as_mut().and_then(|task| task.take_tear()) {
            self.tear_vessel(near_m)?;
        }
        let Some(task) = &self.task else { return Ok(()) };
        let jerk_m_per_s2 = task.effects(&self.world).acceleration_m_per_s2;
        if jerk_m_per_s2 != DVec3::ZERO {
            let gravity_m_per_s2 = self.world.gravity_m_per_s2();
            let steady_m_per_s2 = *self.steady_gravity_m_per_s2.get_or_insert(gravity_m_per_s2);
            self.set_gravity_now(steady_m_per_s2 + jerk_m_per_s2)?;
        } else if let Some(steady_m_per_s2) = self.steady_gravity_m_per_s2.take() {
            self.set_gravity_now(steady_m_per_s2)?;
        }
        Ok(())
    }

    /// Tears the vessel nearest to a place at rest.
    pub(crate) fn tear_vessel(&mut self, near_m: DVec3) -> anyhow::Result<()> {
        self.record(&SessionEvent::TearVessel { step: self.world.steps_made(), near_m });
        self.world.tear_vessel(near_m);
        Ok(())
    }

    /// Lets an event of the task come now, because who teaches says so. One that cannot come is passed over: anybody who watches may ask.
    pub(crate) fn let_event_come(&mut self, number: u32) -> anyhow::Result<()> {
        self.guarded(|simulation| {
            let Self { task, world, .. } = &mut *simulation;
            if task.as_mut().is_some_and(|task| task.let_come(number as usize, world)) {
                let step = simulation.world.steps_made();
                simulation.record(&SessionEvent::TaskEvent { step, number });
            }
            Ok(())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::OpenScene;
    use crate::replay::replay;
    use glisson::record::session::parse_session;
    use glisson::scene::Scene;
    use glisson::tool::ToolInput;
    use glisson::training::task::TaskRun;

    /// A duct with a vessel, held at its ends; an instrument that goes to and fro beside it with closed jaws.
    const SCENE: &str = "glisson_scene = 1\n[simulation]\ntime_step = \"2 ms\"\n[organ]\n\
        cylinder = { from = [\"-30 mm\", 0, 0], to = [\"30 mm\", 0, 0], radius = \"4 mm\" }\nedge = \"4 mm\"\n\
        tissue = \"liver\"\nmodel = \"implicit\"\nlaw = \"stable_neo_hooke\"\ndamping = \"40 1/s\"\n\
        [[organ.fixed]]\nbox = { min = [\"-31 mm\", \"-5 mm\", \"-5 mm\"], max = [\"-25 mm\", \"5 mm\", \"5 mm\"] }\n\
        [[organ.vessel]]\npath = [[\"-30 mm\", 0, 0], [\"30 mm\", 0, 0]]\nradius = \"1.5 mm\"\n\
        [tool]\nname = \"hand\"\nkind = \"grasper\"\ntip_radius = \"1 mm\"\nhome_tip = [0, \"-30 mm\", 0]\nhome_shaft = [0, -1, 0]\n\
        [task]\ntitle = \"T\"\n[[task.stage]]\ntitle = \"t\"\ntouch = {}\n\
        [[task.event]]\ntitle = \"stuck\"\nat = \"0.1 s\"\nfail = { for = \"0.2 s\" }\n\
        [[task.event]]\ntitle = \"cough\"\nat = \"0.2 s\"\njerk = { acceleration = [0, 0, \"5 m/s2\"], for = \"0.2 s\" }\n\
        [[task.event]]\ntitle = \"blood\"\nbleed = { near = [\"10 mm\", 0, 0] }\n";

    fn hand(step: u64) -> StepInput {
        let x_m = 0.01 * (step as f64 * 0.02).sin();
        let hand = ToolInput::at(DVec3::new(x_m, -0.03, 0.0), DVec3::NEG_Y);
        StepInput::of(&[ToolInput { jaw_opening: 0.0, trigger: 1.0, ..hand }])
    }

    #[test]
    fn events_act_on_the_world_and_their_session_replays_to_the_same_bits() {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session.jsonl");
        let scene = Scene::parse(SCENE).unwrap();
        let source =
            OpenScene { scene, folder: folder.path().to_path_buf(), origin: "test".into(), n_threads: 1 };
        let mut simulation = Simulation::open(source, Some(&session)).unwrap();
        let (mut opened, mut moved_m) = (0, 0.0_f64);
        for step in 0..400 {
            if step == 300 {
                simulation.let_event_come(2).unwrap();
                simulation.let_event_come(2).unwrap();
                simulation.let_event_come(u32::MAX).unwrap();
            }
            simulation.advance(&hand(step)).unwrap();
            let world = simulation.world();
            opened += u32::from(world.tool_pose(0).jaw_opening == 1.0 && !world.tool_pose(0).is_triggered());
            let rest_m = &world.organ().mesh().positions_m;
            let free = world.state().positions_m.iter().zip(rest_m);
            moved_m = free.map(|(now_m, rest_m)| (now_m.z - rest_m.z).abs()).fold(moved_m, f64::max);
        }
        assert!((95..=105).contains(&opened), "0.2 s of 2 ms: {opened}");
        assert!(moved_m > 1e-3, "the free end sways: {moved_m}");
        assert_eq!(simulation.world().gravity_m_per_s2(), DVec3::ZERO, "gravity is as before");
        let lost_m3 = simulation.world().vessels().unwrap().lost_m3();
        assert!(lost_m3 > 0.0);
        let result = simulation.task().map(TaskRun::record).unwrap().result();
        assert!(result.events.iter().all(|event| event.came_s.is_some()), "{:?}", result.events);
        let hash = simulation.finish().unwrap();
        let parsed = parse_session(&std::fs::read_to_string(&session).unwrap()).unwrap();
        let again = replay(&parsed, folder.path(), |_| Ok(())).unwrap();
        assert_eq!((again.state_hash, again.first_difference), (hash, None));
        assert_eq!(again.task.unwrap().result(), result);
    }

    #[test]
    fn a_reset_in_the_middle_of_a_jerk_on_a_tilted_table_replays_to_the_same_bits() {
        let folder = tempfile::tempdir().unwrap();
        let session = folder.path().join("session.jsonl");
        let scene = Scene::parse(SCENE).unwrap();
        let source =
            OpenScene { scene, folder: folder.path().to_path_buf(), origin: "test".into(), n_threads: 1 };
        let mut simulation = Simulation::open(source, Some(&session)).unwrap();
        simulation.set_gravity(DVec3::new(0.0, 0.0, 5.0)).unwrap();
        for step in 0..300 {
            if step == 150 {
                assert!(simulation.steady_gravity_m_per_s2.is_some(), "the jerk is on");
                simulation.reset().unwrap();
            }
            simulation.advance(&hand(step)).unwrap();
        }
        let hash = simulation.finish().unwrap();
        let parsed = parse_session(&std::fs::read_to_string(&session).unwrap()).unwrap();
        let again = replay(&parsed, folder.path(), |_| Ok(())).unwrap();
        assert_eq!((again.state_hash, again.first_difference), (hash, None));
    }
}
