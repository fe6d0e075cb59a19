//! What was chosen, and the simulation that is made of it: one at a time, watched and cancelled.

use crate::job::Job;
use anyhow::Context;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use glisson::progress::watched;
use glisson_runtime::Simulation;
use serde_json::{Value, json};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Something that is listed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Choice {
    /// A task of the program.
    Task {
        /// Its name in `glisson_runtime::tasks`.
        name: &'static str,
        /// Its demonstration leads the instruments.
        demonstrate: bool,
        /// With which patient and at which level.
        variant: glisson::scene::Choice,
    },
    /// A scene file.
    Scene {
        /// Where it is.
        path: PathBuf,
    },
    /// A session that was cut off.
    Resume {
        /// What its file would have been called.
        session: PathBuf,
    },
}

/// Makes the simulation of what was chosen.
pub type OpenChoice = Box<dyn Fn(&Choice) -> anyhow::Result<Simulation> + Send + Sync>;

/// What comes after the page.
pub enum Chosen {
    /// A simulation.
    Simulation(Box<Simulation>),
    /// The page for a new patient.
    Patient,
}

#[derive(Default)]
struct Stage {
    job: Option<Arc<Job>>,
    error: Option<String>,
    chosen: Option<Chosen>,
}

pub(super) struct Making {
    stage: Mutex<Stage>,
    open: OpenChoice,
    /// Something was chosen, and is there.
    pub(super) ready: Notify,
}

impl Making {
    /// `error`: what went wrong before.
    pub(super) fn new(open: OpenChoice, error: Option<String>) -> Self {
        let stage = Stage { error, ..Stage::default() };
        Self { stage: Mutex::new(stage), open, ready: Notify::new() }
    }

    fn stage(&self) -> MutexGuard<'_, Stage> {
        // What it says holds also after a panic.
        self.stage.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What the page shows of it.
    pub(super) fn state(&self) -> Value {
        let stage = self.stage();
        json!({
            "page": "start",
            "job": stage.job.as_deref().map(Job::state),
            "error": stage.error,
            "is_ready": stage.chosen.is_some(),
        })
    }

    /// Breaks off what is being made, where it next tells how far it is.
    pub(super) fn cancel(&self) {
        if let Some(job) = &self.stage().job {
            job.cancel();
        }
    }

    pub(super) fn take_chosen(&self) -> Option<Chosen> {
        self.stage().chosen.take()
    }

    /// Why nothing can be begun now.
    fn refusal(stage: &Stage) -> Option<Response> {
        let words = match stage {
            Stage { chosen: Some(_), .. } => "something was started already\n".to_owned(),
            Stage { job: Some(job), .. } => format!("{} is being started: wait, or cancel it\n", job.what),
            _ => return None,
        };
        Some((StatusCode::CONFLICT, words).into_response())
    }

    /// The page for a new patient is next.
    pub(super) fn go_to_patient(&self) -> Response {
        let mut stage = self.stage();
        if let Some(refusal) = Self::refusal(&stage) {
            return refusal;
        }
        stage.chosen = Some(Chosen::Patient);
        self.ready.notify_one();
        StatusCode::ACCEPTED.into_response()
    }
}

/// Begins to make the simulation of `choice`, which is called `what`. The answer comes at once, what became of it with the state.
pub(super) fn begin(
    making: &Arc<Making>,
    what: String,
    choice: impl FnOnce() -> anyhow::Result<Choice> + Send + 'static,
) -> Response {
    let job = Arc::new(Job::new(what));
    {
        let mut stage = making.stage();
        if let Some(refusal) = Making::refusal(&stage) {
            return refusal;
        }
        (stage.job, stage.error) = (Some(Arc::clone(&job)), None);
    }
    let (for_work, making) = (Arc::clone(making), Arc::clone(making));
    tokio::spawn(async move {
        let work = move || choice().and_then(|choice| (for_work.open)(&choice));
        let heard = Arc::clone(&job);
        let watched_work = move || watched(move |share| heard.hears(share), work).ok();
        let made = tokio::task::spawn_blocking(watched_work).await.unwrap_or_else(|fault| {
            Some(Err(fault).context("a fault of the program; its output says where"))
        });
        let mut stage = making.stage();
        stage.job = None;
        match made {
            // It may have been cancelled after it last told how far it was.
            Some(Ok(_)) if job.is_cancelled() => {}
            Some(Ok(simulation)) => {
                stage.chosen = Some(Chosen::Simulation(Box::new(simulation)));
                making.ready.notify_one();
            }
            Some(Err(error)) => stage.error = Some(format!("{}: {error:#}", job.what)),
            None => {}
        }
    });
    StatusCode::ACCEPTED.into_response()
}
