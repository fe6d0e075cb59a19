//! How far the patient is, and the step that runs.

use crate::job::Job;
use anyhow::Context;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use glisson::progress::watched;
use glisson_patient::{Patient, Step};
use glisson_runtime::Simulation;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;

use super::upload::Upload;

/// Until a simulation that is ready takes over from the page, unless the page asks before. A choice.
const UNTIL_TOLD: Duration = Duration::from_secs(3);

/// Opens the simulation of a scene.
pub type OpenSimulation = Box<dyn Fn(&Path) -> anyhow::Result<Simulation> + Send + Sync>;

/// A page for one patient.
pub struct PatientPage {
    /// Where mesh and scene are written.
    pub folder: PathBuf,
    /// An image to begin with; else the page asks for one.
    pub image: Option<PathBuf>,
    /// Opens the simulation of the scene that was written.
    pub open: OpenSimulation,
    /// The page may be left without a simulation: another one comes after it.
    pub may_leave: bool,
}

/// How far the patient is.
#[derive(Default)]
pub(super) struct Steps {
    pub(super) patient: Patient,
    pub(super) source: Option<Source>,
    pub(super) simulation: Option<Simulation>,
    job: Option<Arc<Job>>,
    error: Option<String>,
}

/// Where an image is read from.
#[derive(Clone)]
pub(super) struct Source {
    pub(super) path: PathBuf,
    /// The number of the image that came by the page.
    pub(super) upload: Option<u64>,
}

pub(super) struct Shared {
    steps: Mutex<Steps>,
    pub(super) upload: Upload,
    pub(super) page: PatientPage,
    pub(super) started: Notify,
}

/// What a step changes when it is done.
pub(super) type Change = Box<dyn FnOnce(&mut Steps) + Send>;

/// What became of a step; none where it was cancelled.
type Outcome = Option<anyhow::Result<Change>>;

impl Shared {
    pub(super) fn new(upload: Upload, page: PatientPage) -> Self {
        Self { steps: Mutex::default(), upload, page, started: Notify::new() }
    }

    pub(super) fn steps(&self) -> MutexGuard<'_, Steps> {
        self.steps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What runs.
    pub(super) fn running(&self) -> Option<String> {
        self.steps().job.as_ref().map(|job| job.what.clone())
    }

    /// Breaks the step that runs off, where it next tells how far it is.
    pub(super) fn cancel(&self) {
        if let Some(job) = &self.steps().job {
            job.cancel();
        }
    }

    /// Keeps what became of a step; answers whether the simulation is ready.
    fn end_job(&self, outcome: Outcome) -> bool {
        let mut steps = self.steps();
        steps.job = None;
        match outcome {
            Some(Ok(change)) => change(&mut steps),
            Some(Err(error)) => steps.error = Some(format!("{error:#}")),
            None => {}
        }
        steps.simulation.is_some()
    }

    /// What the page shows.
    pub(super) fn state(&self) -> Value {
        let steps = self.steps();
        let mut state = steps.patient.state();
        state["job"] = steps.job.as_deref().map(Job::state).into();
        state["error"] = steps.error.clone().into();
        state["started"] = steps.simulation.is_some().into();
        state["can_leave"] = self.page.may_leave.into();
        state
    }
}

/// The answer while a step runs.
pub(super) fn still(what: &str) -> Response {
    (StatusCode::CONFLICT, format!("still {what}: wait, or cancel it\n")).into_response()
}

/// Begins a step, unless one runs. The answer comes at once, what became of it with the state.
pub(super) fn begin(
    shared: &Arc<Shared>,
    what: &'static str,
    work: impl FnOnce(&Shared) -> anyhow::Result<Change> + Send + 'static,
) -> Response {
    let job = Arc::new(Job::new(what));
    {
        let mut steps = shared.steps();
        if let Some(running) = &steps.job {
            return still(&running.what);
        }
        if steps.simulation.is_some() {
            return (StatusCode::CONFLICT, "the simulation starts\n").into_response();
        }
        (steps.job, steps.error) = (Some(Arc::clone(&job)), None);
    }
    let (for_work, shared) = (Arc::clone(shared), Arc::clone(shared));
    tokio::spawn(async move {
        let watched_work = move || watched(move |share| job.hears(share), || work(&for_work)).ok();
        let outcome = tokio::task::spawn_blocking(watched_work).await.unwrap_or_else(|fault| {
            let words = || format!("{what} failed by a fault of the program; its output says where");
            Some(Err(fault).with_context(words))
        });
        if shared.end_job(outcome) {
            // The page is to hear of it from this server; then it looks for the next one.
            tokio::time::sleep(UNTIL_TOLD).await;
            shared.started.notify_one();
        }
    });
    StatusCode::ACCEPTED.into_response()
}

/// Begins a step of the patient's.
pub(super) fn begin_step(shared: &Arc<Shared>, step: Step) -> Response {
    begin(shared, step.what, move |_| {
        let change = step.run()?;
        Ok(Box::new(move |steps: &mut Steps| steps.patient.take(change)))
    })
}
