//! How far the patient is, and the step that runs.

use crate::job::Job;
use anyhow::Context;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use glisson::material::tissues::TISSUES;
use glisson::progress::watched;
use glisson_runtime::Simulation;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;

use super::image::Image;
use super::organ::{Organ, Organs};
use super::scene::{HELD, MODELS};
use super::tetrahedra::{Meshed, QUALITY_STEPS, TETRAHEDRA};
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
    pub(super) image: Option<Arc<Image>>,
    /// Grows with each image.
    pub(super) n_images: u64,
    /// Series to choose from, where there are several, and where they are.
    pub(super) series: Vec<String>,
    pub(super) source: Option<Source>,
    pub(super) organs: Arc<Organs>,
    pub(super) mesh: Option<Arc<Meshed>>,
    pub(super) simulation: Option<Simulation>,
    job: Option<Arc<Job>>,
    error: Option<String>,
    /// Grows whenever pictures change.
    version: u64,
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

    /// The image, and the organs that were found in it.
    pub(super) fn image_and_organs(&self) -> (Option<Arc<Image>>, Arc<Organs>) {
        let steps = self.steps();
        (steps.image.clone(), Arc::clone(&steps.organs))
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
            Some(Ok(change)) => {
                change(&mut steps);
                // Where the simulation takes over, nobody is left to draw anew.
                steps.version += u64::from(steps.simulation.is_none());
            }
            Some(Err(error)) => steps.error = Some(format!("{error:#}")),
            None => {}
        }
        steps.simulation.is_some()
    }

    /// What the page shows.
    pub(super) fn state(&self) -> Value {
        let steps = self.steps();
        let summaries = |organs: &[Arc<Organ>]| organs.iter().map(|o| o.summary.clone()).collect::<Vec<_>>();
        json!({
            "version": steps.version,
            "image_number": steps.n_images,
            "job": steps.job.as_deref().map(Job::state),
            "error": steps.error,
            "series": steps.series,
            "image": steps.image.as_ref().map(|image| &image.summary),
            "organs": summaries(steps.organs.list()),
            "mesh": steps.mesh.as_ref().map(|mesh| &mesh.summary),
            "started": steps.simulation.is_some(),
            "can_leave": self.page.may_leave,
            "offers": {
                "tissues": TISSUES.iter().map(|tissue| tissue.name).collect::<Vec<_>>(),
                "models": MODELS.iter().map(|model| json!({"name": model.name, "about": model.about})).collect::<Vec<_>>(),
                "held": HELD.iter().map(|held| held.name).collect::<Vec<_>>(),
                "tetrahedra": TETRAHEDRA,
                "quality": QUALITY_STEPS.map(|step| json!({"from_deg": step.from_deg, "colour": step.colour})),
            },
        })
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
