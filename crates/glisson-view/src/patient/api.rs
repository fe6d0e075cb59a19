//! What the page asks for.

use anyhow::Context;
use axum::Router;
use axum::body::{Body, HttpBody};
use axum::extract::{Path as UrlPath, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use glisson::progress::{part, tell};
use glisson_patient::{Opened, SCENE_NAME, SceneChoice, meshes_in};
use glisson_runtime::Simulation;
use serde::Deserialize;
use serde_json::json;
use std::future::poll_fn;
use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::pin::Pin;
use std::sync::Arc;

use super::steps::{PatientPage, Shared, Source, Steps, begin, begin_step, still};
use super::upload::Upload;
use crate::server::access::{self, Access};
use crate::server::limits::Places;
use crate::server::viewer_file;

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OpenChoice {
    /// The number that its files came with.
    upload: Option<u64>,
    /// From 1.
    series: Option<usize>,
}

/// Reads what came as image number `upload`, a series of what was read before, or the image that the program was started with.
fn open(shared: &Arc<Shared>, choice: &OpenChoice) -> Response {
    let OpenChoice { upload, series: chosen } = *choice;
    let before = shared.steps().source.clone();
    let answer = begin(shared, "reading the image", move |shared| {
        let earlier = before.as_ref().and_then(|source| source.upload);
        let source = match (upload, before) {
            (Some(number), _) => Source { path: shared.upload.image(number)?, upload },
            (None, Some(before)) if chosen.is_some() => before,
            (None, _) => {
                Source { path: shared.page.image.clone().context("there is no image yet")?, upload: None }
            }
        };
        let forget = |upload: Option<u64>| upload.iter().for_each(|number| shared.upload.forget(*number));
        // Where the step is cancelled, files that came for it go too.
        let incoming =
            Forgotten { upload: &shared.upload, number: source.upload.filter(|_| earlier != source.upload) };
        let opened = part(0.0, 0.9, || Opened::read(&source.path, chosen));
        incoming.keep();
        // Of several series another one may be asked for.
        let has_several = opened.has_several();
        if !has_several {
            forget(source.upload);
        }
        let is_upload = source.upload.is_some();
        let opened = if is_upload { opened.without_names(&source.path) } else { opened };
        let change = opened.change()?;
        if earlier != source.upload {
            forget(earlier);
        }
        Ok(Box::new(move |steps: &mut Steps| {
            steps.patient.take(change);
            steps.source = Some(source);
        }))
    });
    // Files that nobody reads are not kept.
    if answer.status() == StatusCode::CONFLICT {
        upload.iter().for_each(|number| shared.upload.forget(*number));
    }
    answer
}

/// Forgets what came of an image, unless it is kept.
struct Forgotten<'a> {
    upload: &'a Upload,
    number: Option<u64>,
}

impl Forgotten<'_> {
    fn keep(mut self) {
        self.number = None;
    }
}

impl Drop for Forgotten<'_> {
    fn drop(&mut self) {
        self.number.iter().for_each(|number| self.upload.forget(*number));
    }
}

/// Begins the step of this name.
fn step(shared: &Arc<Shared>, name: &str, choice: &str) -> Response {
    let step = shared.steps().patient.step(name, choice);
    match step {
        None => (StatusCode::NOT_FOUND, "there is no such step\n").into_response(),
        Some(Err(error)) => (StatusCode::UNPROCESSABLE_ENTITY, format!("{error}\n")).into_response(),
        Some(Ok(step)) => begin_step(shared, step),
    }
}

fn start(shared: &Arc<Shared>, choice: SceneChoice) -> Response {
    let write = shared.steps().patient.scene(choice, shared.page.folder.clone());
    begin(shared, "starting the simulation", move |shared| {
        let scene = write()?;
        tell(0.05);
        let simulation = part(0.05, 1.0, || (shared.page.open)(&scene))?;
        Ok(Box::new(move |steps: &mut Steps| steps.simulation = Some(simulation)))
    })
}

/// Ends the page without a simulation.
fn leave(shared: &Shared) -> Response {
    if !shared.page.may_leave {
        return (StatusCode::NOT_FOUND, "nothing comes after this page\n").into_response();
    }
    shared.cancel();
    shared.started.notify_one();
    StatusCode::ACCEPTED.into_response()
}

/// A picture, drawn elsewhere.
async fn picture(State(shared): State<Arc<Shared>>, UrlPath(name): UrlPath<String>) -> Response {
    let drawing = shared.steps().patient.picture(&name);
    let drawn = match drawing {
        Ok(draw) => tokio::task::spawn_blocking(draw).await.unwrap_or_else(|error| Err(error.into())),
        Err(error) => Err(error),
    };
    match drawn {
        Ok(bytes) => ([(header::CONTENT_TYPE, "image/png"), (header::CACHE_CONTROL, "no-store")], bytes)
            .into_response(),
        Err(error) => (StatusCode::BAD_REQUEST, format!("{error:#}\n")).into_response(),
    }
}

/// The outlines that an organ was made from.
async fn outlines(State(shared): State<Arc<Shared>>, UrlPath(name): UrlPath<String>) -> Response {
    match shared.steps().patient.outlines(&name) {
        Some(outlines) => axum::Json(outlines).into_response(),
        None => (StatusCode::NOT_FOUND, "there is no such organ\n").into_response(),
    }
}

async fn state(State(shared): State<Arc<Shared>>) -> Response {
    let state = shared.state();
    if state["started"] == true {
        shared.started.notify_one();
    }
    axum::Json(state).into_response()
}

/// Takes a file of an image in, as it comes: a long scan need not fit into memory twice.
async fn keep(
    State(shared): State<Arc<Shared>>,
    UrlPath((image, name)): UrlPath<(u64, String)>,
    mut body: Body,
) -> Response {
    let kept = async {
        let mut file = shared.upload.create(image, &name)?;
        while let Some(frame) = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await {
            if let Ok(bytes) = frame?.into_data() {
                file.write_all(&bytes)?;
            }
        }
        file.keep();
        anyhow::Ok(())
    };
    match kept.await {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(error) => (StatusCode::INSUFFICIENT_STORAGE, format!("{error:#}\n")).into_response(),
    }
}

/// The number that the files of a new image are to come with.
async fn begin_upload(State(shared): State<Arc<Shared>>) -> Response {
    // What is being read must not go.
    if let Some(what) = shared.running() {
        return still(&what);
    }
    let in_use = shared.steps().source.as_ref().and_then(|source| source.upload);
    axum::Json(json!({"upload": shared.upload.begin(in_use)})).into_response()
}

type Asked<T> = (State<Arc<Shared>>, axum::Json<T>);

fn router(shared: Arc<Shared>, access: Access) -> Router {
    let steps = Router::new()
        .route("/open", post(|(State(s), axum::Json(c)): Asked<OpenChoice>| async move { open(&s, &c) }))
        .route("/start", post(|(State(s), axum::Json(c)): Asked<SceneChoice>| async move { start(&s, c) }))
        .route("/leave", post(|State(s): State<Arc<Shared>>| async move { leave(&s) }))
        .route(
            "/{step}",
            post(|State(s): State<Arc<Shared>>, UrlPath(name): UrlPath<String>, choice: String| async move {
                step(&s, &name, &choice)
            }),
        )
        .route(
            "/cancel",
            post(|State(s): State<Arc<Shared>>| async move {
                s.cancel();
                StatusCode::ACCEPTED
            }),
        );
    Router::new()
        .nest("/api/patient", steps)
        .route("/api/page", get(|| async { axum::Json(json!({"page": "patient"})) }))
        .route("/api/patient/state", get(state))
        .route("/api/patient/files", post(begin_upload))
        .route("/api/patient/files/{image}/{name}", put(keep))
        .route("/api/patient/pictures/{*name}", get(picture))
        .route("/api/patient/outlines/{organ}", get(outlines))
        .route("/", get(|| async { viewer_file("patient.html") }))
        .route("/{*path}", get(|UrlPath(path): UrlPath<String>| async move { viewer_file(&path) }))
        .layer(from_fn_with_state(Arc::new(access), access::guard))
        .with_state(shared)
}

/// Refuses a folder that holds what the page would write: it is of another patient, or somebody's own.
fn refuse_other_files(folder: &Path) -> anyhow::Result<()> {
    let scene = Some(folder.join(SCENE_NAME)).filter(|path| path.exists());
    match meshes_in(folder).into_iter().chain(scene).next() {
        Some(path) => anyhow::bail!("{} is there already; take another folder with --out", path.display()),
        None => Ok(()),
    }
}

/// Serves the page until its simulation is ready, which is the answer, or until `stop` comes or the page is left: then there is none.
///
/// # Errors
/// A listener that cannot be used; a folder that holds a mesh or a scene.
pub fn serve(
    listener: TcpListener,
    access: Access,
    page: PatientPage,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<Option<Simulation>> {
    refuse_other_files(&page.folder)?;
    let upload = Upload::new(page.folder.join(format!("incoming-{}.partial", std::process::id())));
    let has_image = page.image.is_some();
    let shared = Arc::new(Shared::new(upload, page));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let for_pages = Arc::clone(&shared);
    let stopped = runtime.block_on(async move {
        if has_image {
            open(&for_pages, &OpenChoice::default());
        }
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let ready = Arc::clone(&for_pages);
        let server = axum::serve(Places::new(listener), router(for_pages, access))
            .with_graceful_shutdown(async move { ready.started.notified().await });
        tokio::select! {
            result = server.into_future() => result.context("the server stopped").map(|()| false),
            () = stop => Ok(true),
        }
    });
    // A step that runs ends where it next tells how far it is, or with the program.
    shared.cancel();
    runtime.shutdown_background();
    // The step that runs may hold on to it.
    shared.upload.forget_all();
    let was_stopped = stopped?;
    let simulation = shared.steps().simulation.take();
    Ok(simulation.filter(|_| !was_stopped))
}
