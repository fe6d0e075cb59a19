//! A simulation and the one page before it.

use anyhow::Context;
use glisson_protocol::class::Present;
use glisson_protocol::conversation::{Asked, Conversation, Room, ToViewer};
use glisson_protocol::hands::Hands;
use glisson_protocol::messages::{self, HapticsAt};
use glisson_report::{ReportContext, task_report};
use glisson_runtime::control::Steers;
use glisson_runtime::live::{Command, Turns};
use glisson_runtime::published::Published;
use glisson_runtime::replay::{read_session, take_over};
use glisson_runtime::script::PathScript;
use glisson_runtime::{OpenScene, Simulation};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// How often the page hears how the simulation keeps its time.
const BEAT: Duration = Duration::from_secs(1);

/// A simulation and the one page before it.
pub struct LocalPage {
    turns: Turns,
    room: Arc<Room>,
    page: Conversation,
    says: VecDeque<ToViewer>,
    /// What the page was told last.
    told: Option<Arc<Published>>,
    /// Whether the page looks at something else than when it was told.
    looks_elsewhere: bool,
    steers: Steers,
    class: watch::Receiver<Present>,
    next_beat: Instant,
}

impl LocalPage {
    /// Opens a scene file, and records the session into `record`.
    ///
    /// # Errors
    /// Those of the scene.
    pub fn open(scene: &Path, record: &Path, demonstrates: bool) -> anyhow::Result<Self> {
        let source = OpenScene::read(scene)?;
        let script = demonstrates.then(|| PathScript::for_viewers(source.scene.clone())).flatten();
        let mut simulation = Simulation::open(source, Some(record))?;
        if let Some(script) = script {
            simulation.follow_script(Box::new(script));
        }
        Self::of(simulation)
    }

    /// Goes on with a session file from one of its steps on, with the scene's files in its folder, and records it anew into `record`.
    ///
    /// # Errors
    /// Those of the session and its scene ([`take_over`]).
    pub fn take_over(session: &Path, at_step: u64, record: &Path) -> anyhow::Result<Self> {
        let folder = session.parent().unwrap_or(Path::new("."));
        Self::of(take_over(&read_session(session)?, at_step, folder, record)?)
    }

    fn of(simulation: Simulation) -> anyhow::Result<Self> {
        let (hello, devices) = (messages::hello(&simulation), messages::devices(std::iter::empty()));
        let room = Arc::new(Room::new(hello, devices, Hands::new(Vec::new(), None), false));
        let mut turns = Turns::start(simulation);
        let page =
            Conversation::enter(&room, false, turns.shown()).context("there is no place for a page")?;
        turns.obey(Command::Viewed)?;
        let mut says: VecDeque<_> = page.greet(turns.shown()).into();
        let steers = *room.control.watch().borrow();
        says.extend(page.say_role(&steers));
        let mut class = room.class.watch();
        class.mark_changed();
        let next_beat = Instant::now();
        Ok(Self { turns, room, page, says, told: None, looks_elsewhere: false, steers, class, next_beat })
    }

    /// A message of the page.
    ///
    /// # Errors
    /// What stopped the simulation.
    pub fn hear(&mut self, text: &str) -> anyhow::Result<()> {
        let looked = self.page.looks();
        let (answer, asked) = self.page.hear(text, self.turns.shown());
        self.says.extend(answer);
        self.looks_elsewhere |= self.page.looks() != looked;
        match asked {
            Some(Asked::Command(command)) => self.turns.obey(command),
            // Nobody started it from another page.
            Some(Asked::Leave) | None => Ok(()),
        }
    }

    /// Goes on until the clock is reached or a frame is due. Answers how long there is nothing to do then.
    ///
    /// # Errors
    /// What stopped the simulation.
    pub fn turn(&mut self) -> anyhow::Result<Duration> {
        self.turns.turn()
    }

    /// Has what is new ready for [`LocalPage::take_message`]: asked for when the page has taken what came before, so that it is shown
    /// young states however slow it is.
    pub fn tell(&mut self) {
        let shown = self.turns.shown();
        let is_new = self.told.as_ref().is_none_or(|told| !Arc::ptr_eq(told, shown));
        let looks_elsewhere = std::mem::take(&mut self.looks_elsewhere);
        if is_new || looks_elsewhere {
            self.says.extend(self.page.show(shown));
            self.told = Some(Arc::clone(shown));
        }
        let steers = *self.room.control.watch().borrow();
        if steers != self.steers {
            self.says.extend(self.page.say_role(&steers));
            self.steers = steers;
        }
        if self.class.has_changed().unwrap_or(false) {
            let present = self.class.borrow_and_update().clone();
            self.says.extend(self.page.say_class(present));
        }
        let now = Instant::now();
        if now >= self.next_beat {
            self.next_beat = now + BEAT;
            self.says.push_back(messages::timing(shown, HapticsAt::Nowhere, None).into());
        }
    }

    /// The next message to the page.
    pub fn take_message(&mut self) -> Option<ToViewer> {
        self.says.pop_front()
    }

    /// The report of the task that is over, as a page.
    ///
    /// # Errors
    /// Where none is over.
    pub fn report(&self) -> anyhow::Result<String> {
        let record = self.turns.shown().task_record.as_ref().context("no task is over yet")?;
        Ok(task_report(record, &record.result(), &ReportContext::default()))
    }

    /// From here on the session's file has all that happened before.
    pub fn keep_session(&mut self) {
        self.turns.keep_session();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;
    use glisson::tool::ToolInput;
    use glisson::world::StepInput;
    use glisson_runtime::replay::replay;

    const SCENE: &str = "glisson_scene = 1\n[organ]\nmodel = \"precomputed\"\ntissue = \"liver\"\nedge = \"20 mm\"\n\
        box = { min = [\"-5 cm\", \"0 cm\", \"-5 cm\"], max = [\"5 cm\", \"4 cm\", \"5 cm\"] }\n\
        [[organ.fixed]]\nfurthest = { direction = [0, 1, 0], fraction = 0.2 }\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [0, \"-40 mm\", 0]\nhome_shaft = [0, -1, 0]\n";

    /// Types of the texts, and how many frames there are.
    fn told(page: &mut LocalPage) -> (Vec<String>, usize) {
        page.tell();
        let (mut types, mut n_frames) = (Vec::new(), 0);
        while let Some(message) = page.take_message() {
            match message {
                ToViewer::Frame(_) => n_frames += 1,
                ToViewer::Text(text) => {
                    let value: serde_json::Value = serde_json::from_str(&text).unwrap();
                    types.push(value["type"].as_str().unwrap().to_owned());
                }
            }
        }
        (types, n_frames)
    }

    #[test]
    fn one_page_hears_what_a_server_says_and_its_session_is_replayed() {
        let folder = tempfile::tempdir().unwrap();
        let (scene, session) = (folder.path().join("scene.toml"), folder.path().join("session.jsonl"));
        std::fs::write(&scene, SCENE).unwrap();
        let mut page = LocalPage::open(&scene, &session, false).unwrap();
        let (types, n_frames) = told(&mut page);
        assert_eq!(&types[..3], ["hello", "role", "class"], "{types:?}");
        assert!(types.contains(&"parameters".to_owned()) && n_frames >= 2, "{types:?}, {n_frames}");
        page.hear(r#"{"type":"tool","tip_m":[0,-0.004,0],"shaft":[0,-1,0]}"#).unwrap();
        for _ in 0..40 {
            let wait = page.turn().unwrap();
            std::thread::sleep(wait.min(Duration::from_millis(5)));
        }
        page.hear("no message").unwrap();
        page.hear(r#"{"type":"pause","paused":true}"#).unwrap();
        page.turn().unwrap();
        let (types, n_frames) = told(&mut page);
        assert!(types.contains(&"error".to_owned()) && n_frames >= 1, "{types:?}, {n_frames}");
        page.keep_session();
        let partial = glisson_runtime::recorder::partial_of(&session);
        let report = replay(&read_session(&partial).unwrap(), folder.path(), |_| Ok(())).unwrap();
        assert_eq!((report.first_difference, report.checkpoints >= 1), (None, true));
    }

    #[test]
    fn a_task_that_is_over_has_a_report_and_none_before() {
        const TASK: &str = "[task]\ntitle = \"Touch <it>\"\ntime_limit = \"60 s\"\n\
            [[task.stage]]\ntitle = \"Touch the block\"\ntouch = { tool = \"tool\" }\n";
        let folder = tempfile::tempdir().unwrap();
        let (scene, session) = (folder.path().join("scene.toml"), folder.path().join("session.jsonl"));
        let tool = SCENE.replace("[tool]", "[[tool]]\nname = \"tool\"");
        std::fs::write(&scene, format!("{tool}{TASK}")).unwrap();
        let mut page = LocalPage::open(&scene, &session, false).unwrap();
        assert_eq!(page.report().unwrap_err().to_string(), "no task is over yet");
        let begun = Instant::now();
        let mut depth_m = -0.03;
        while page.report().is_err() && begun.elapsed() < Duration::from_secs(60) {
            page.hear(&format!(r#"{{"type":"tool","tip_m":[0,{depth_m},0],"shaft":[0,-1,0]}}"#)).unwrap();
            depth_m = f64::min(depth_m + 0.001, 0.004);
            page.turn().unwrap();
            std::thread::sleep(Duration::from_millis(2));
        }
        let report = page.report().unwrap();
        assert!(
            report.contains("<h1>Touch &lt;it&gt;</h1>") && report.contains("all stages done"),
            "{report}"
        );
    }

    #[test]
    fn a_session_is_taken_over_where_it_is_wanted_and_goes_on_from_there() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("scene.toml"), SCENE).unwrap();
        let open = |record: &Path| {
            Simulation::open(OpenScene::read(&at("scene.toml")).unwrap(), Some(record)).unwrap()
        };
        let push = |simulation: &mut Simulation, steps: std::ops::Range<u64>, slope: f64| {
            for step in steps {
                let tip_m = DVec3::new(0.0, -0.04 + 5e-4 * step as f64, slope * step as f64);
                simulation.advance(&StepInput::of(&[ToolInput::at(tip_m, -DVec3::Y)])).unwrap();
            }
        };
        let mut whole = open(&at("whole.jsonl"));
        push(&mut whole, 0..60, 0.0);
        // What somebody did after the step does not count at it.
        whole.reset().unwrap();
        push(&mut whole, 60..90, 0.0);
        let half = {
            let mut half = open(&at("half.jsonl"));
            push(&mut half, 0..60, 0.0);
            half.world().state_hash()
        };
        whole.finish().unwrap();

        let session = read_session(&at("whole.jsonl")).unwrap();
        assert!(take_over(&session, 91, folder.path(), &at("late.jsonl")).is_err());
        let mut taken = take_over(&session, 60, folder.path(), &at("taken.jsonl")).unwrap();
        assert_eq!((taken.world().steps_made(), taken.world().state_hash()), (60, half));
        push(&mut taken, 60..80, 1e-4);
        let end = taken.finish().unwrap();
        let report = replay(&read_session(&at("taken.jsonl")).unwrap(), folder.path(), |_| Ok(())).unwrap();
        assert_eq!((report.steps, report.state_hash, report.first_difference), (80, end, None));

        // In the page it stands still until time is let pass.
        let mut page = LocalPage::take_over(&at("whole.jsonl"), 60, &at("page.jsonl")).unwrap();
        for _ in 0..5 {
            page.turn().unwrap();
        }
        assert_eq!(page.turns.shown().snapshot.step, 60);
    }
}
