//! What the Worker calls: numbers, and bytes in the program's memory. One simulation at a time.
//!
//! Texts go in through [`glisson_room`], which answers where to put them. What comes out lies at [`glisson_answer`], and is so long as the
//! call that made it said.

use crate::local_page::LocalPage;
use crate::new_patient::NewPatient;
use crate::progress::told;
use anyhow::{Context, anyhow};
use glisson::math::Arithmetic;
use glisson::scene::Scene;
use glisson_protocol::conversation::ToViewer;
use glisson_runtime::replay::{read_session, replay};
use glisson_runtime::{OpenScene, Simulation};
use std::cell::RefCell;
use std::path::Path;

/// What is kept from call to call.
#[derive(Default)]
struct Kept {
    page: Option<LocalPage>,
    run: Option<Run>,
    patient: NewPatient,
    /// A text that was put in.
    given: Vec<u8>,
    /// What the last call answers.
    answer: Vec<u8>,
}

/// A scene without a page, step by step along its paths.
struct Run {
    scene: Scene,
    simulation: Simulation,
    steps: u64,
}

impl Run {
    fn open(scene: &Path) -> anyhow::Result<Self> {
        let source = OpenScene::read(scene)?;
        Ok(Self { scene: source.scene.clone(), simulation: Simulation::open(source, None)?, steps: 0 })
    }

    /// Makes steps, and answers the hash of the state then.
    fn go_on(&mut self, n_steps: u32) -> anyhow::Result<String> {
        for _ in 0..n_steps {
            self.steps += 1;
            self.simulation.follow_paths(&self.scene, self.steps)?;
        }
        Ok(self.simulation.world().state_hash().to_string())
    }
}

thread_local! {
    static KEPT: RefCell<Kept> = RefCell::default();
}

fn with<T>(act: impl FnOnce(&mut Kept) -> T) -> T {
    KEPT.with_borrow_mut(act)
}

/// What an answer is: an error's words ...
const ERROR: i32 = -1;
/// ... nothing ...
const NOTHING: i32 = 0;
/// ... JSON, or other words ...
const TEXT: i32 = 1;
/// ... or a binary frame.
const FRAME: i32 = 2;

impl Kept {
    fn answers(&mut self, done: anyhow::Result<String>) -> i32 {
        let (kind, text) = match done {
            Ok(text) => (TEXT, text),
            Err(error) => (ERROR, format!("{error:#}")),
        };
        self.answer = text.into_bytes();
        kind
    }

    /// The texts that were put in, by their ends.
    fn given(&mut self) -> String {
        String::from_utf8_lossy(&std::mem::take(&mut self.given)).into_owned()
    }

    /// What a call that answers words, or none, came to.
    fn done(&mut self, done: anyhow::Result<()>) -> i32 {
        match done {
            Ok(()) => NOTHING,
            Err(error) => self.answers(Err(error)),
        }
    }

    /// Does something with the page's simulation.
    fn on_page(&mut self, act: impl FnOnce(&mut LocalPage) -> anyhow::Result<()>) -> i32 {
        let done = match &mut self.page {
            Some(page) => act(page),
            None => Err(anyhow!("no scene is open")),
        };
        self.done(done)
    }
}

macro_rules! calls {
    ($($(#[$about:meta])* fn $name:ident($($argument:ident: $type:ty),*) -> $answer:ty $body:block)*) => {
        $(
            $(#[$about])*
            #[allow(unsafe_code, reason = "the Worker finds it by its name, which no other function has")]
            // SAFETY: names that begin with `glisson_` are this crate's alone.
            #[unsafe(no_mangle)]
            pub extern "C" fn $name($($argument: $type),*) -> $answer $body
        )*
    };
}

calls! {
    /// Where to put so many bytes of text, for the next call.
    fn glisson_room(n_bytes: usize) -> *mut u8 {
        with(|kept| {
            kept.given = vec![0; n_bytes];
            kept.given.as_mut_ptr()
        })
    }

    /// Where the answer of the last call is.
    fn glisson_answer() -> *const u8 {
        with(|kept| kept.answer.as_ptr())
    }

    /// How long it is.
    fn glisson_answer_bytes() -> usize {
        with(|kept| kept.answer.len())
    }

    /// Opens the scene file of the given name and records its session; given are both names, a line each. `demonstrates`: instruments
    /// follow the scene's paths until somebody takes them.
    fn glisson_open(demonstrates: i32) -> i32 {
        with(|kept| {
            kept.page = None;
            let names = kept.given();
            let (scene, record) = two_names(&names);
            let opened = told(|| LocalPage::open(Path::new(scene), Path::new(record), demonstrates != 0));
            let opened = opened.map(|page| kept.page = Some(page));
            kept.done(opened)
        })
    }

    /// Goes on with the session file of the given name from a step on; given are its name and that of the new recording, a line each.
    fn glisson_take_over(at_step: u32) -> i32 {
        with(|kept| {
            kept.page = None;
            let names = kept.given();
            let (session, record) = two_names(&names);
            let taken = told(|| LocalPage::take_over(Path::new(session), at_step.into(), Path::new(record)));
            let taken = taken.map(|page| kept.page = Some(page));
            kept.done(taken)
        })
    }

    /// The given message of the page.
    fn glisson_hear() -> i32 {
        with(|kept| {
            let text = kept.given();
            kept.on_page(|page| page.hear(&text))
        })
    }

    /// Goes on until the clock is reached or a frame is due. Answers how long there is nothing to do then [ms]; below 0 for an error.
    fn glisson_turn() -> f64 {
        with(|kept| {
            let mut wait_ms = -1.0;
            kept.on_page(|page| {
                wait_ms = page.turn()?.as_secs_f64() * 1e3;
                Ok(())
            });
            wait_ms
        })
    }

    /// Has what is new ready for the page, which has taken what came before.
    fn glisson_tell() -> i32 {
        with(|kept| kept.on_page(|page| {
            page.tell();
            Ok(())
        }))
    }

    /// The next message to the page.
    fn glisson_next_message() -> i32 {
        with(|kept| match kept.page.as_mut().and_then(LocalPage::take_message) {
            None => NOTHING,
            Some(ToViewer::Text(text)) => kept.answers(Ok(text)),
            Some(ToViewer::Frame(frame)) => {
                kept.answer.clear();
                kept.answer.extend_from_slice(&frame);
                FRAME
            }
        })
    }

    /// From here on the session's file has all that happened before.
    fn glisson_keep() -> i32 {
        with(|kept| kept.on_page(|page| {
            page.keep_session();
            Ok(())
        }))
    }

    /// The report of the task that is over, as a page.
    fn glisson_report() -> i32 {
        with(|kept| {
            let report = kept.page.as_ref().context("no scene is open").and_then(LocalPage::report);
            kept.answers(report)
        })
    }

    /// Opens the scene file of the given name, without a page.
    fn glisson_open_run() -> i32 {
        with(|kept| {
            kept.run = None;
            let name = kept.given();
            let opened = Run::open(Path::new(&name)).map(|run| kept.run = Some(run));
            kept.done(opened)
        })
    }

    /// Makes so many steps of it along its paths; answers the hash of the state then.
    fn glisson_run(n_steps: u32) -> i32 {
        with(|kept| {
            let ran = kept.run.as_mut().context("no scene is open").and_then(|run| run.go_on(n_steps));
            kept.answers(ran)
        })
    }

    /// How it rounds (`glisson::math::Arithmetic`).
    fn glisson_arithmetic() -> i32 {
        with(|kept| kept.answers(Ok(Arithmetic::here().name().to_owned())))
    }

    /// How far the new patient is, in JSON.
    fn glisson_patient() -> i32 {
        with(|kept| {
            let state = kept.patient.state();
            kept.answers(Ok(state))
        })
    }

    /// Has a step of the new patient's ready; given are its name and its choice in JSON, a line each. Answers what the page says of it.
    fn glisson_patient_prepare() -> i32 {
        with(|kept| {
            let given = kept.given();
            let (name, choice) = given.split_once('\n').unwrap_or((&given, "{}"));
            let what = kept.patient.prepare(name, choice).map(str::to_owned);
            kept.answers(what)
        })
    }

    /// Does it.
    fn glisson_patient_run() -> i32 {
        with(|kept| {
            let done = told(|| kept.patient.run());
            kept.done(done)
        })
    }

    /// The picture of the given name.
    fn glisson_patient_picture() -> i32 {
        with(|kept| {
            let name = kept.given();
            match kept.patient.picture(&name) {
                Ok(bytes) => {
                    kept.answer = bytes;
                    FRAME
                }
                Err(error) => kept.answers(Err(error)),
            }
        })
    }

    /// The outlines of the organ of the given name, in JSON.
    fn glisson_patient_outlines() -> i32 {
        with(|kept| {
            let name = kept.given();
            let outlines = kept.patient.outlines(&name);
            kept.answers(outlines)
        })
    }

    /// Replays the session file of the given name, with the scene's files in its folder; answers `steps state_hash recorded_hash
    /// first_difference checkpoints`, `-` for what there is not.
    fn glisson_replay() -> i32 {
        with(|kept| {
            let name = kept.given();
            let replayed = replayed(Path::new(&name));
            kept.answers(replayed)
        })
    }
}

/// A file's name, and that of the session that is recorded, a line each.
fn two_names(names: &str) -> (&str, &str) {
    names.split_once('\n').unwrap_or((names, "session.jsonl"))
}

fn replayed(session: &Path) -> anyhow::Result<String> {
    let folder = session.parent().unwrap_or(Path::new("."));
    let report = replay(&read_session(session)?, folder, |_| Ok(()))?;
    let or_none = |text: Option<String>| text.unwrap_or_else(|| "-".into());
    let recorded_hash = or_none(report.recorded_hash.map(|hash| hash.to_string()));
    let first_difference = or_none(report.first_difference.map(|step| step.to_string()));
    let (steps, state_hash, checkpoints) = (report.steps, report.state_hash, report.checkpoints);
    Ok(format!("{steps} {state_hash} {recorded_hash} {first_difference} {checkpoints}"))
}
