//! Sessions that were cut off: found beside where they were recorded, gone on with.

use crate::Simulation;
use crate::recorder::{folder_of_partial, is_being_written, partial_of, set_aside};
use crate::replay::{read_session, resume};
use glisson::record::session::SessionHeader;
use glisson::scene::Scene;
use serde::Deserialize;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// The end of a file that is looked at for the last whole line: several times the longest.
const END_BYTES: u64 = 1 << 16;

/// A session of which only `FILE.partial` is there, and nobody writes to it.
#[derive(Clone, Debug, PartialEq)]
pub struct CutOff {
    /// What its file would have been called, without `.partial`.
    pub session: PathBuf,
    /// Of its task, or the scene's name.
    pub title: String,
    /// Simulated time up to its last moment [s].
    pub time_s: f64,
}

#[derive(Deserialize)]
struct AnyEvent {
    step: u64,
}

impl CutOff {
    /// That of a session that would be called `session`; none if there is none, or it has not even a beginning.
    pub fn of(session: &Path) -> Option<Self> {
        let partial = partial_of(session);
        if !partial.is_file() || is_being_written(&partial) {
            return None;
        }
        let mut file = BufReader::new(File::open(&partial).ok()?);
        let mut first = String::new();
        file.read_line(&mut first).ok()?;
        let header: SessionHeader = serde_json::from_str(&first).ok()?;
        let scene = Scene::parse_recorded(&header).ok()?;
        let title = scene.task.as_ref().map_or(&scene.world.name, |task| &task.title).clone();
        let time_s = last_step(file)? as f64 * scene.world.time_step_s;
        Some(Self { session: session.to_path_buf(), title, time_s })
    }

    /// Those in a folder, in the order of their names.
    pub fn all_in(folder: &Path) -> Vec<Self> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let session = |path: PathBuf| {
            let name = path.file_name()?.to_str()?.strip_suffix(".partial")?.to_owned();
            Some(path.with_file_name(name))
        };
        let mut all: Vec<Self> = entries.filter_map(|entry| Self::of(&session(entry.path())?)).collect();
        all.sort_by(|a, b| a.session.cmp(&b.session));
        all
    }

    /// Where it is.
    pub fn partial(&self) -> PathBuf {
        partial_of(&self.session)
    }

    /// A line for people.
    pub fn to_text(&self) -> String {
        format!("{}: a session of {:.1} s was cut off: {}", self.partial().display(), self.time_s, self.title)
    }
}

/// The step of the last whole line.
fn last_step(mut file: BufReader<File>) -> Option<u64> {
    let n_bytes = file.get_ref().metadata().ok()?.len();
    file.seek(SeekFrom::Start(n_bytes.saturating_sub(END_BYTES))).ok()?;
    let mut end = Vec::new();
    file.read_to_end(&mut end).ok()?;
    let text = String::from_utf8_lossy(&end);
    text.lines().rev().find_map(|line| serde_json::from_str::<AnyEvent>(line).ok()).map(|event| event.step)
}

/// Goes on with a session that was cut off, whatever its file is called now, and records it in `record` from its beginning. The old
/// file is kept. `folder`: that of the scene's files; the one that the recording noted where none is given.
///
/// # Errors
/// When somebody writes to it, and as [`resume`].
pub fn go_on_with(
    file: &Path,
    folder: Option<&Path>,
    record: &Path,
    n_threads: usize,
) -> anyhow::Result<Simulation> {
    anyhow::ensure!(!is_being_written(file), "{}: another program is recording it", file.display());
    let session = read_session(file)?;
    let noted = folder_of_partial(file);
    let own = file.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let folder = folder.or(noted.as_deref()).unwrap_or(own);
    let simulation = resume(&session, folder, record, n_threads)
        .map_err(|error| error.context(file.display().to_string()))?;
    // Where it was recorded under the same name, this was done already.
    let is_partial = file.extension().is_some_and(|ending| ending == "partial");
    if is_partial && partial_of(record) != file {
        set_aside(&file.with_extension(""))?;
    }
    Ok(simulation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::replay::replay;
    use crate::{OpenScene, Turn};
    use glisson::math::DVec3;
    use glisson::record::parameter::Parameter;
    use glisson::record::session::SessionEvent;
    use glisson::tool::ToolInput;
    use glisson::world::StepInput;

    const SCENE: &str = "glisson_scene = 1\nname = \"a block\"\n[organ]\n\
        box = { min = [0, 0, 0], max = [\"4 cm\", \"4 cm\", \"4 cm\"] }\nedge = \"15 mm\"\n\
        tissue = \"liver\"\nmodel = \"implicit\"\nlaw = \"stable_neo_hooke\"\n\
        [[organ.fixed]]\nfurthest = { direction = [0, 0, -1], fraction = 0.2 }\n\
        [simulation]\ntime_step = \"4 ms\"\n\
        [tool]\ntip_radius = \"5 mm\"\nhome_tip = [\"2 cm\", \"2 cm\", \"6 cm\"]\nhome_shaft = [0, 0, 1]\n";

    fn open(folder: &Path, record: Option<&Path>) -> anyhow::Result<Simulation> {
        std::fs::write(folder.join("scene.toml"), SCENE)?;
        Simulation::open(OpenScene::read(&folder.join("scene.toml"))?, record)
    }

    fn push(simulation: &mut Simulation, steps: std::ops::Range<u64>) {
        for step in steps {
            let z_m = 0.06 - 2e-4 * step as f64;
            let pose = ToolInput::at(DVec3::new(0.02, 0.02, z_m), DVec3::Z);
            simulation.advance(&StepInput::of(&[pose])).unwrap();
        }
    }

    #[test]
    fn a_session_that_was_cut_off_goes_on_to_the_bits_of_one_that_was_not() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let mut whole = open(folder, None).unwrap();
        push(&mut whole, 0..120);
        let session = folder.join("session.jsonl");
        let mut cut_off = open(folder, Some(&session)).unwrap();
        push(&mut cut_off, 0..70);
        cut_off.keep_session();
        assert_eq!(CutOff::of(&session), None, "it is being recorded");
        let again = open(folder, Some(&session)).err().unwrap();
        assert!(format!("{again:#}").contains("another program is recording"), "{again:#}");
        // As a program that is killed: nothing is ended.
        drop(cut_off);
        let mut torn = std::fs::read(partial_of(&session)).unwrap();
        torn.extend(b"{\"event\":\"inp");
        std::fs::write(partial_of(&session), &torn).unwrap();
        let found = CutOff::all_in(folder);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].title.as_str(), found[0].time_s), ("a block", 70.0 * 4e-3));

        let mut resumed = go_on_with(&found[0].partial(), None, &session, 1).unwrap();
        assert_eq!((resumed.world().steps_made(), resumed.is_resumed()), (70, true));
        push(&mut resumed, 70..120);
        assert_eq!(resumed.world().state_hash(), whole.world().state_hash());
        let hash = resumed.finish().unwrap();
        // The new file has all of it, the old one is as it was.
        assert_eq!(std::fs::read(folder.join("session-interrupted.jsonl")).unwrap(), torn);
        assert!(CutOff::all_in(folder).is_empty());
        let read = read_session(&session).unwrap();
        let report = replay(&read, folder, |_| Ok(())).unwrap();
        assert_eq!(
            (report.state_hash, report.first_difference, report.recorded_hash),
            (hash, None, Some(hash))
        );
        let ended = go_on_with(&session, None, &folder.join("other.jsonl"), 1).err().unwrap();
        assert!(format!("{ended:#}").contains("was not cut off"), "{ended:#}");
    }

    #[test]
    fn what_was_turned_and_does_not_hold_yet_holds_at_its_step_in_the_session_that_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let session = folder.join("session.jsonl");
        let turn = Turn { body: 0, parameter: Parameter::YoungModulus, value: 9_000.0 };
        let mut whole = open(folder, None).unwrap();
        let mut cut_off = open(folder, Some(&session)).unwrap();
        for simulation in [&mut whole, &mut cut_off] {
            push(simulation, 0..20);
            simulation.turn(turn, Some(50)).unwrap();
            push(simulation, 20..30);
        }
        cut_off.keep_session();
        drop(cut_off);
        push(&mut whole, 30..80);
        let mut resumed = go_on_with(&partial_of(&session), None, &session, 1).unwrap();
        let young = |simulation: &Simulation| {
            let state = simulation.parameters().list[0].clone();
            assert_eq!(state.parameter, Parameter::YoungModulus);
            (state.value, state.coming)
        };
        assert_eq!(young(&resumed).1, Some(9_000.0));
        push(&mut resumed, 30..80);
        assert_eq!(young(&resumed), (9_000.0, None));
        assert_eq!(resumed.world().state_hash(), whole.world().state_hash());
        let hash = resumed.finish().unwrap();
        let report = replay(&read_session(&session).unwrap(), folder, |_| Ok(())).unwrap();
        assert_eq!((report.state_hash, report.first_difference), (hash, None));
    }

    #[test]
    fn a_session_that_does_not_make_its_bits_is_not_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let session = folder.join("session.jsonl");
        let mut simulation = open(folder, Some(&session)).unwrap();
        push(&mut simulation, 0..20);
        simulation.keep_session();
        drop(simulation);
        let text = std::fs::read_to_string(partial_of(&session)).unwrap();
        let lines: Vec<String> = text
            .lines()
            .map(|line| match serde_json::from_str::<SessionEvent>(line) {
                Ok(SessionEvent::Checkpoint { step, .. }) => {
                    let hash = "ab".repeat(32);
                    format!("{{\"event\":\"checkpoint\",\"step\":{step},\"state_hash\":\"{hash}\"}}")
                }
                _ => line.to_owned(),
            })
            .collect();
        let changed = folder.join("changed.jsonl.partial");
        std::fs::write(&changed, lines.join("\n")).unwrap();
        let refused = go_on_with(&changed, None, &folder.join("new.jsonl"), 1).err().unwrap();
        assert!(format!("{refused:#}").contains("differs from the check-point of step 20"), "{refused:#}");
        assert!(changed.exists() && !partial_of(&folder.join("new.jsonl")).exists());
    }

    #[test]
    fn a_recording_that_cannot_begin_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let session = folder.join("session.jsonl");
        std::os::unix::fs::symlink("/dev/full", partial_of(&session)).unwrap();
        let refused = open(folder, Some(&session)).err().map(|error| format!("{error:#}")).unwrap();
        assert!(refused.contains("cannot write") && refused.contains("No space left"), "{refused}");
    }
}
