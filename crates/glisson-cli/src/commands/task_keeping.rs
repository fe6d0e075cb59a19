//! Storing the results of a task: of a run without a window at its end, of one in the browser at each end of the task.

use super::results::Database;
use crate::text_file::write_text;
use anyhow::{Context, bail};
use glisson::scene::Scene;
use glisson::text::did_you_mean;
use glisson::training::task::{TaskRecord, TaskResult, TaskRun};
use glisson_results::attempt::scene_hash;
use glisson_results::name::checked_name;
use glisson_results::utc::utc_text;
use glisson_results::{Attempt, Comparison, Kept, Store};
use glisson_runtime::Simulation;
use glisson_runtime::published::Published;
use glisson_view::server::{Compare, Show};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{SystemTime, UNIX_EPOCH};

/// Whose results are stored, where, and what they are compared with.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct KeepingArgs {
    /// Store the result as this person's: a name or a pseudonym. Without, nothing is stored
    #[arg(long, value_name = "NAME")]
    pub(super) person: Option<String>,
    #[command(flatten)]
    database: Database,
    /// The report compares with the quartiles of this group (`glisson results group`)
    #[arg(long, value_name = "NAME", requires = "person")]
    group: Option<String>,
}

/// The time now, as results have it.
pub(super) fn now_text() -> String {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    utc_text(i64::try_from(since.as_millis()).unwrap_or(0))
}

/// The same time for a file's name.
pub(super) fn time_in_names(text: &str) -> String {
    text.chars().filter(char::is_ascii_alphanumeric).collect()
}

impl KeepingArgs {
    /// Who did what; it is over now.
    pub(super) fn attempt(&self, task: &str, scene: &Scene, session: &Path) -> anyhow::Result<Attempt> {
        let session = std::path::absolute(session).unwrap_or_else(|_| session.into());
        Ok(Attempt {
            person: self.person.as_deref().map(checked_name).transpose().context("--person")?,
            task: task.to_owned(),
            scene_hash: scene_hash(&scene.text),
            finished_at: now_text(),
            seed: scene.patient(),
            level: scene.task.as_ref().and_then(|task| task.level.clone()),
            session: Some(session.display().to_string()),
        })
    }

    /// Whether results could be stored; says who is new.
    ///
    /// # Errors
    /// A name that is none, a database that cannot be written, a group that is not there.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        if let Some(person) = &self.person {
            let person = checked_name(person).context("--person")?;
            eprint!("{}", new_person_text(&person, &self.store()?)?);
        }
        Ok(())
    }

    fn store(&self) -> anyhow::Result<Store> {
        let mut store = Store::open(&self.database.path())?;
        store.check_writable()?;
        if let Some(group) = &self.group {
            store.members(group)?;
        }
        Ok(store)
    }

    /// Opens the database before the work: what is wrong with it is better known then. None without a person.
    pub(super) fn keeper(&self, attempt: &Attempt, folder: &Path) -> anyhow::Result<Option<Arc<Keeper>>> {
        if self.person.is_none() {
            return Ok(None);
        }
        let store = self.store()?;
        let (attempt, group, folder) = (attempt.clone(), self.group.clone(), folder.to_path_buf());
        let state = Mutex::new(State { store, kept: Vec::new(), over_before: Vec::new() });
        Ok(Some(Arc::new(Keeper { attempt, group, folder, state })))
    }
}

/// A line for who is not in the database yet: a mistyped name makes a new person. Nothing for others.
fn new_person_text(person: &str, store: &Store) -> anyhow::Result<String> {
    let people = store.people()?;
    let names: Vec<&str> = people.iter().map(|person| person.name.as_str()).collect();
    if names.contains(&person) {
        return Ok(String::new());
    }
    let (file, like) = (store.file().display(), did_you_mean(person, &names));
    Ok(format!("\"{person}\" is not in {file} yet: the first result makes a new person of this name{like}\n"))
}

/// Stores each attempt once, whoever comes with it first.
pub(super) struct Keeper {
    /// Of all attempts, but for when they ended.
    attempt: Attempt,
    group: Option<String>,
    /// Where results go that cannot be stored.
    folder: PathBuf,
    state: Mutex<State>,
}

struct State {
    store: Store,
    /// When the attempts began, by the bits of the simulated time [s], and their numbers, or why they have none.
    kept: Vec<(u64, Result<i64, String>)>,
    /// When those began that were over before, and are not stored here.
    over_before: Vec<u64>,
}

impl Keeper {
    fn state(&self) -> MutexGuard<'_, State> {
        // A panic in between leaves a store that wrote all or nothing.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Leaves out what was over before a session was cut off that `simulation` goes on with: it was stored then.
    pub(super) fn pass_over(&self, simulation: &Simulation) {
        let task = simulation.task().filter(|task| task.outcome().is_some()).map(TaskRun::record);
        let over = [task.as_ref(), simulation.task_before().map(AsRef::as_ref)];
        over.into_iter().flatten().for_each(|record| self.pass_over_attempt(record));
    }

    fn pass_over_attempt(&self, record: &TaskRecord) {
        self.state().over_before.extend(record.began_s().map(f64::to_bits));
    }

    /// Stores an attempt that ended now, or writes it to a file; its number, or where it is and why. None before an instrument
    /// moved, and of one that was over before.
    fn keep(&self, record: &TaskRecord) -> Option<Result<i64, String>> {
        self.keep_at(record, None)
    }

    /// The same for one that ended then.
    pub(super) fn keep_at(
        &self,
        record: &TaskRecord,
        finished_at: Option<&str>,
    ) -> Option<Result<i64, String>> {
        let began = record.began_s()?.to_bits();
        let mut state = self.state();
        if state.over_before.contains(&began) {
            return None;
        }
        if let Some((_, kept)) = state.kept.iter().find(|(known, _)| *known == began) {
            return Some(kept.clone());
        }
        let finished_at = finished_at.map_or_else(now_text, str::to_owned);
        let attempt = Attempt { finished_at, ..self.attempt.clone() };
        let kept = self.store(&mut state.store, attempt, &record.result());
        let person = self.attempt.person.as_deref().unwrap_or_default();
        match &kept {
            Ok(id) => eprintln!("stored as result {id} of {person} in {}", state.store.file().display()),
            Err(why) => eprintln!("error: {why}"),
        }
        state.kept.push((began, kept.clone()));
        Some(kept)
    }

    fn store(&self, store: &mut Store, attempt: Attempt, result: &TaskResult) -> Result<i64, String> {
        let result =
            serde_json::to_value(result).map_err(|error| format!("the result is no JSON: {error}"))?;
        let kept = Kept { attempt, result };
        let error = match store.add(&kept) {
            Ok(added) => return Ok(added.id()),
            Err(error) => error,
        };
        let name =
            format!("{}_{}_not_stored.json", kept.attempt.task, time_in_names(&kept.attempt.finished_at));
        let file = self.folder.join(name);
        let text = serde_json::to_string_pretty(&kept).unwrap_or_default();
        Err(match write_text(&file, &format!("{text}\n")) {
            Ok(()) => {
                let file = file.display();
                format!(
                    "the result is not stored: {error}. It is in {file}; later: glisson results import {file}"
                )
            }
            Err(other) => format!("the result is lost: {error}; and {other:#}"),
        })
    }

    /// The attempt beside others.
    pub(super) fn compare(&self, record: &TaskRecord) -> Result<Comparison, String> {
        let id = self.keep(record).ok_or(
            "there is nothing to store: no instrument has moved, or it was over before the session was cut off",
        )??;
        self.state()
            .store
            .compare(id, self.group.as_deref())
            .map_err(|error| format!("the result is not compared: {error}"))
    }

    /// What the server's report asks for.
    pub(super) fn comparing(self: &Arc<Self>) -> Compare {
        let keeper = Arc::clone(self);
        Box::new(move |record| keeper.compare(record))
    }

    /// Stores attempts as they end, beside the simulation: on a thread of its own, until the simulation is over.
    pub(super) fn watching(self: &Arc<Self>) -> Show {
        let keeper = Arc::clone(self);
        Box::new(move |mut published, _| {
            let watch = move || {
                let runtime = tokio::runtime::Builder::new_current_thread().build();
                let Ok(runtime) = runtime else {
                    return eprintln!("error: results cannot be stored: no runtime");
                };
                runtime.block_on(async {
                    // What was published last is there when the channel has closed, too.
                    while published.changed().await.is_ok() {
                        let state = Arc::clone(&published.borrow_and_update());
                        keeper.keep_ended(&state);
                    }
                    let state = Arc::clone(&published.borrow());
                    keeper.keep_ended(&state);
                });
            };
            Ok(std::thread::Builder::new().name("results".into()).spawn(watch)?)
        })
    }

    fn keep_ended(&self, state: &Published) {
        for record in state.task_before.iter().chain(&state.task_record) {
            self.keep(record);
        }
    }

    /// At the end.
    ///
    /// # Errors
    /// Where an attempt could not be stored, which was told then.
    pub(super) fn finish(&self) -> anyhow::Result<()> {
        let n_failed = self.state().kept.iter().filter(|(_, kept)| kept.is_err()).count();
        if n_failed > 0 {
            bail!("{n_failed} results are not in the database {}", self.state().store.file().display());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;
    use glisson::scene::Scene;
    use glisson::tool::ToolInput;
    use glisson_results::Filter;
    use glisson_runtime::OpenScene;
    use glisson_runtime::live::{self, Command};
    use glisson_runtime::shown::Shown;
    use glisson_runtime::steering::Steering;
    use std::time::{Duration, Instant};

    /// A block that a probe touches.
    const TASK: &str = "glisson_scene = 1\n[task]\ntitle = \"Touch\"\n[[task.stage]]\ntitle = \"Touch\"\nhold = \"50 ms\"\ntouch = {}\n\
        [simulation]\ntime_step = \"5 ms\"\n\
        [organ]\nbox = { min = [\"-5 cm\", \"0 cm\", \"-5 cm\"], max = [\"5 cm\", \"4 cm\", \"5 cm\"] }\nedge = \"15 mm\"\n\
        tissue = \"liver\"\nmodel = \"precomputed\"\n[[organ.fixed]]\nfurthest = { direction = [0, 1, 0], fraction = 0.2 }\n\
        [tool]\nname = \"probe\"\ntip_radius = \"5 mm\"\nhome_tip = [0, \"-20 mm\", 0]\nhome_shaft = [0, -1, 0]\n";

    #[test]
    fn each_attempt_that_is_begun_anew_is_stored_once_and_the_last_one_is_broken_off() {
        let folder = tempfile::tempdir().unwrap();
        let database = Database { database: Some(folder.path().join("r.sqlite")) };
        let args = KeepingArgs { person: Some("Ada".into()), database, group: None };
        let attempt = args.attempt("touch", &Scene::parse(TASK).unwrap(), Path::new("s.jsonl")).unwrap();
        let told = new_person_text("Ada", &args.store().unwrap()).unwrap();
        assert!(told.contains("\"Ada\" is not in ") && !told.contains("mean"), "{told}");
        let keeper = args.keeper(&attempt, folder.path()).unwrap().unwrap();
        let scene = Scene::parse(TASK).unwrap();
        let source =
            OpenScene { scene, folder: folder.path().into(), origin: "the test".into(), n_threads: 1 };
        let simulation = Simulation::open(source, None).unwrap();
        let (shown, published) = Shown::start(&simulation).unwrap();
        let (commands, taken) = std::sync::mpsc::channel();
        let steering = Steering::alone(commands.clone());
        let show = (keeper.watching())(published.clone(), &steering).unwrap();
        let running = std::thread::spawn(move || live::run(simulation, &taken, shown, Vec::new(), None));
        let move_to = |y_m: f64| {
            let pose = ToolInput::at(DVec3::new(0.0, y_m, 0.0), DVec3::NEG_Y);
            commands.send(Command::Tool { tool: 0, pose }).unwrap();
        };
        let wait_until = |what: &dyn Fn(&Published) -> bool| {
            let begin = Instant::now();
            while !what(&published.borrow()) {
                assert!(begin.elapsed() < Duration::from_secs(60), "{:?}", published.borrow().task);
                std::thread::sleep(Duration::from_millis(2));
            }
        };
        let is_over = |state: &Published| state.task.as_ref().is_some_and(|task| task.outcome.is_some());
        let has_begun = |state: &Published| state.task.as_ref().is_some_and(|task| task.began_s.is_some());
        for _ in 0..2 {
            move_to(-0.002);
            wait_until(&is_over);
            commands.send(Command::Reset).unwrap();
            wait_until(&|state| !has_begun(state));
        }
        // Goes somewhere else, and is not done.
        move_to(-0.015);
        wait_until(&has_begun);
        commands.send(Command::Stop).unwrap();
        running.join().unwrap().unwrap();
        show.join().unwrap();
        keeper.finish().unwrap();
        let stored = keeper.state().store.results(&Filter::default()).unwrap();
        let how: Vec<&str> = stored.iter().map(|stored| stored.result.outcome_text()).collect();
        assert_eq!(how, ["passed", "passed", "broken off"]);
        // Of who goes on with a session, what was over before is stored already.
        let resuming = args.keeper(&attempt, folder.path()).unwrap().unwrap();
        let state = Arc::clone(&published.borrow());
        let before = state.task_before.as_ref().unwrap();
        resuming.pass_over_attempt(before);
        assert_eq!(resuming.keep(before), None);
        assert!(resuming.keep(state.task_record.as_ref().unwrap()).unwrap().is_ok());
        assert_eq!(new_person_text("Ada", &args.store().unwrap()).unwrap(), "");
        let told = new_person_text("Adaa", &args.store().unwrap()).unwrap();
        assert!(told.contains("new person") && told.contains("did you mean \"Ada\"?"), "{told}");
    }
}
