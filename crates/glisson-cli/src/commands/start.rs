//! `glisson start`.

use super::held::DeviceArgs;
use super::patient::free_folder;
use super::serve::{Address, serve_until};
use super::task;
use super::task_keeping::{Keeper, KeepingArgs};
use anyhow::Context;
use glisson::progress::tell;
use glisson::scene::Scene;
use glisson_runtime::cut_off::go_on_with;
use glisson_runtime::realtime::{CoreKept, OwnCore};
use glisson_runtime::recorder::{partial_of, remove_partial};
use glisson_runtime::replay::read_session;
use glisson_runtime::script::PathScript;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::patient::{self, PatientPage};
use glisson_view::server::access::Access;
use glisson_view::server::{Service, stop_signal};
use glisson_view::start::{self, Choice, Chosen, StartPage};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::watch;

/// Where scenes are looked for when nothing else is said.
const USUAL_FOLDERS: [&str; 2] = [".", "out"];

/// Choose a task, a scene or a new patient in the browser, one after the other.
///
/// The page lists the tasks that come with the program and the scene files of some folders. What is chosen is served at the same
/// address; from there a button leads back to the page. Each simulation is recorded.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson start\n  glisson start --scenes my_scenes --out out/sessions\n  \
    glisson start --person Ada --group experts    results of tasks are stored and compared\n  \
    glisson start --device haply --device viewer@1\n  \
    glisson start --port 0 --host 0.0.0.0     for other machines, with a token that is printed\n\nStop with Ctrl-C; a recording is then completed."
)]
pub(crate) struct Args {
    /// Folder with scene files, which is looked through three levels deep; may be given several times [default: the working folder and
    /// out/]
    #[arg(long, value_name = "DIR")]
    scenes: Vec<PathBuf>,
    /// Folder for the sessions; none is overwritten
    #[arg(long, default_value = "out/sessions", value_name = "DIR")]
    out: PathBuf,
    /// Threads of models that can use several; the results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    threads: u8,
    #[command(flatten)]
    devices: DeviceArgs,
    #[command(flatten)]
    keeping: KeepingArgs,
    #[command(flatten)]
    address: Address,
}

/// Ctrl-C or SIGTERM, heard at any time: also between two servers.
struct Stop(watch::Receiver<bool>);

impl Stop {
    fn listen() -> anyhow::Result<Self> {
        let (came, comes) = watch::channel(false);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        std::thread::Builder::new().name("stop signal".into()).spawn(move || {
            runtime.block_on(stop_signal());
            came.send_replace(true);
        })?;
        Ok(Self(comes))
    }

    fn came(&self) -> bool {
        *self.0.borrow()
    }

    async fn comes(&self) {
        if self.0.clone().wait_for(|came| *came).await.is_err() {
            // Nobody can say it any more.
            std::future::pending::<()>().await;
        }
    }
}

/// Makes what was chosen, and records it.
struct Opener {
    out: PathBuf,
    n_threads: usize,
    keeping: KeepingArgs,
    /// Who stores the results of the task that was opened last, if they are stored.
    keeper: Arc<Mutex<Option<Arc<Keeper>>>>,
}

impl Opener {
    fn open(&self, choice: &Choice) -> anyhow::Result<Simulation> {
        match choice {
            Choice::Scene { path } => self.open_scene(path),
            Choice::Task { name, demonstrate, variant } => {
                let source = task::open(name, variant, self.n_threads)?;
                let script = if *demonstrate {
                    let paths = PathScript::for_viewers(source.scene.clone());
                    Some(paths.context("the task has no demonstration")?)
                } else {
                    None
                };
                let mut simulation = self.record(source, name)?;
                if let Some(script) = script {
                    simulation.follow_script(Box::new(script));
                }
                Ok(simulation)
            }
            Choice::Resume { session } => {
                let partial = partial_of(session);
                let scene = Scene::parse_recorded(&read_session(&partial)?.header)?;
                let keeper = self.keeper_of(&scene_of_session(session), &scene, session)?;
                let simulation = go_on_with(&partial, None, session, self.n_threads)?;
                keeper.iter().for_each(|keeper| keeper.pass_over(&simulation));
                self.set_keeper(keeper);
                println!("session: {}, gone on with where it was cut off", session.display());
                Ok(simulation)
            }
        }
    }

    fn open_scene(&self, path: &Path) -> anyhow::Result<Simulation> {
        let source = OpenScene { n_threads: self.n_threads, ..OpenScene::read(path)? };
        self.record(source, &session_name(path))
    }

    fn record(&self, source: OpenScene, name: &str) -> anyhow::Result<Simulation> {
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("{}: cannot make the folder for sessions", self.out.display()))?;
        let (session, folder) = (free_session(&self.out, name), source.folder.clone());
        let mut unwanted = Unwanted(Some(session.clone()));
        let keeper = self.keeper_of(name, &source.scene, &session)?;
        let simulation = Simulation::open(source, Some(&session))?;
        // Where it was cancelled meanwhile, this does not come back.
        tell(1.0);
        unwanted.0 = None;
        self.set_keeper(keeper);
        println!("session: glisson replay {} --folder {}", session.display(), folder.display());
        Ok(simulation)
    }

    /// Who stores the results of a scene's task, if it has one and they are stored.
    fn keeper_of(&self, name: &str, scene: &Scene, session: &Path) -> anyhow::Result<Option<Arc<Keeper>>> {
        if scene.task.is_none() {
            return Ok(None);
        }
        self.keeping.keeper(&self.keeping.attempt(name, scene, session)?, &self.out)
    }

    fn set_keeper(&self, keeper: Option<Arc<Keeper>>) {
        *self.keeper.lock().unwrap_or_else(PoisonError::into_inner) = keeper;
    }
}

/// A session that nobody wants any more when what it is of was cancelled.
struct Unwanted(Option<PathBuf>);

impl Drop for Unwanted {
    fn drop(&mut self) {
        self.0.iter().for_each(|session| remove_partial(session));
    }
}

/// What the session of a scene is called: after its file, or after its folder where the file is called as most are.
fn session_name(scene: &Path) -> String {
    let text = |part: Option<&std::ffi::OsStr>| part.map(|part| part.to_string_lossy().into_owned());
    let stem = text(scene.file_stem()).filter(|stem| stem != "scene");
    stem.or_else(|| text(scene.parent()?.file_name())).unwrap_or_else(|| "scene".into())
}

/// The name that a session was called after: without the number of those that were not the first.
fn scene_of_session(session: &Path) -> String {
    let stem = session.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    match stem.rsplit_once('-') {
        Some((name, number)) if number.parse::<u32>().is_ok() => name.to_owned(),
        _ => stem,
    }
}

/// The first of NAME.jsonl, NAME-2.jsonl, ... that is not there, whole or in part.
fn free_session(folder: &Path, name: &str) -> PathBuf {
    let numbered = (2..).map(|number| format!("{name}-{number}"));
    let mut names = std::iter::once(name.to_owned()).chain(numbered);
    let is_free = |path: &PathBuf| !path.exists() && !partial_of(path).exists();
    names
        .find_map(|name| Some(folder.join(format!("{name}.jsonl"))).filter(is_free))
        .expect("numbers do not end")
}

impl Args {
    fn folders(&self) -> anyhow::Result<Vec<PathBuf>> {
        for folder in &self.scenes {
            anyhow::ensure!(folder.is_dir(), "--scenes {}: no such folder", folder.display());
        }
        let usual =
            || USUAL_FOLDERS.map(PathBuf::from).into_iter().filter(|folder| folder.is_dir()).collect();
        Ok(if self.scenes.is_empty() { usual() } else { self.scenes.clone() })
    }

    fn opener(&self, turn: &Turn<'_>) -> Opener {
        let keeper = Arc::clone(&turn.keeper);
        Opener { out: self.out.clone(), n_threads: turn.n_threads, keeping: self.keeping.clone(), keeper }
    }

    /// The page, and what is started from it; none when the program is to end.
    fn choose(
        &self,
        turn: &Turn<'_>,
        folders: &[PathBuf],
        error: Option<String>,
    ) -> anyhow::Result<Option<Chosen>> {
        let opener = self.opener(turn);
        let page = StartPage {
            folders: folders.to_vec(),
            sessions: Some(self.out.clone()),
            open: Box::new(move |choice| opener.open(choice)),
            error,
        };
        start::serve(turn.listener.try_clone()?, turn.access.clone(), page, turn.stop.comes())
    }

    /// A new patient, and the simulation that comes of it.
    fn bring_in(&self, turn: &Turn<'_>) -> anyhow::Result<()> {
        let opener = self.opener(turn);
        let page = PatientPage {
            folder: free_folder(),
            image: None,
            open: Box::new(move |scene| opener.open_scene(scene)),
            may_leave: true,
        };
        let listener = turn.listener.try_clone()?;
        match patient::serve(listener, turn.access.clone(), page, turn.stop.comes())? {
            Some(simulation) => turn.simulate(simulation),
            None => Ok(()),
        }
    }
}

/// Where everything is served, one after the other.
struct Turn<'a> {
    listener: &'a TcpListener,
    access: &'a Access,
    stop: &'a Stop,
    devices: &'a DeviceArgs,
    core: OwnCore,
    n_threads: usize,
    /// Who stores the results of what was opened last.
    keeper: Arc<Mutex<Option<Arc<Keeper>>>>,
}

impl Turn<'_> {
    fn simulate(&self, simulation: Simulation) -> anyhow::Result<()> {
        let keeper = self.keeper.lock().unwrap_or_else(PoisonError::into_inner).take();
        let service = Service {
            may_leave: true,
            held: self.devices.held(simulation.world().tools(), self.core)?,
            haptics: self.devices.settings(self.core)?,
            shows: keeper.iter().map(Keeper::watching).collect(),
            compare: keeper.as_ref().map(Keeper::comparing),
            ..Service::to(self.access.clone())
        };
        serve_until(simulation, self.listener.try_clone()?, service, self.stop.comes())?;
        keeper.map_or(Ok(()), |keeper| keeper.finish())
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    // Before anything else is started.
    let kept = args.devices.keep_core();
    let core = kept.as_ref().map_or(OwnCore::Last, CoreKept::core);
    args.devices.settings(core)?;
    args.keeping.check()?;
    let folders = args.folders()?;
    let listener = args.address.bind()?;
    let stop = Stop::listen()?;
    let access = args.address.tell(&listener)?;
    let turn = Turn {
        listener: &listener,
        access: &access,
        stop: &stop,
        devices: &args.devices,
        core,
        n_threads: args.devices.n_threads(args.threads, core),
        keeper: Arc::default(),
    };
    let mut error = None;
    while let Some(chosen) = args.choose(&turn, &folders, error.take())? {
        let ended = match chosen {
            Chosen::Simulation(simulation) => turn.simulate(*simulation),
            Chosen::Patient => args.bring_in(&turn),
        };
        match ended {
            Err(fault) if stop.came() => return Err(fault),
            Err(fault) => {
                eprintln!("error: {fault:#}");
                error = Some(format!("{fault:#}"));
            }
            Ok(()) if stop.came() => return Ok(()),
            Ok(()) => {}
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_are_called_after_their_scenes_and_none_is_overwritten() {
        for (scene, expected) in [
            ("out/demo/scene.toml", "demo"),
            ("out/demo/bed.toml", "bed"),
            ("scene.toml", "scene"),
            ("./scene.toml", "scene"),
        ] {
            assert_eq!(session_name(Path::new(scene)), expected, "{scene}");
        }
        let folder = tempfile::tempdir().unwrap();
        let free = || free_session(folder.path(), "demo").file_name().unwrap().to_str().unwrap().to_owned();
        assert_eq!(free(), "demo.jsonl");
        std::fs::write(folder.path().join("demo.jsonl"), "").unwrap();
        std::fs::write(folder.path().join("demo-2.jsonl.partial"), "").unwrap();
        assert_eq!(free(), "demo-3.jsonl");
        assert_eq!(scene_of_session(&folder.path().join("demo-3.jsonl")), "demo");
        assert_eq!(scene_of_session(Path::new("grasp-well.jsonl")), "grasp-well");
    }
}
