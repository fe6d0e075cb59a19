//! What the page asks for.

use anyhow::Context;
use axum::extract::{Path as UrlPath, State};
use axum::http::StatusCode;
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Json, Router};
use serde::Deserialize;
use serde_json::json;
use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use super::listing::{self, TaskLine};
use super::making::{Choice, Chosen, Making, OpenChoice, begin};
use crate::server::access::{self, Access};
use crate::server::limits::{Asked, Places, guard_api};
use crate::server::viewer_file;
use glisson_runtime::recorder::set_aside;

/// Until questions that are being answered are broken off when something was started. A choice.
const LAST_ANSWERS: Duration = Duration::from_secs(2);

/// What the page offers.
pub struct StartPage {
    /// Folders with scene files.
    pub folders: Vec<PathBuf>,
    /// Folder with recorded sessions: those that were cut off can be gone on with.
    pub sessions: Option<PathBuf>,
    /// Makes the simulation of what was chosen.
    pub open: OpenChoice,
    /// What went wrong before, for the page to show.
    pub error: Option<String>,
}

struct Shared {
    tasks: Vec<TaskLine>,
    folders: Vec<PathBuf>,
    sessions: Option<PathBuf>,
    making: Arc<Making>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TaskChoice {
    name: String,
    #[serde(default)]
    demonstrate: bool,
    patient: Option<u32>,
    level: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneChoice {
    /// As it is listed.
    file: String,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SessionChoice {
    /// As it is listed.
    session: String,
}

/// So that what a page of another site can send without asking is no choice: forms have no JSON.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Nothing {}

async fn offers(State(shared): State<Arc<Shared>>) -> Response {
    let for_list = Arc::clone(&shared);
    let list = move || (listing::scenes(&for_list.folders), listing::cut_off(for_list.sessions.as_deref()));
    let listed = tokio::task::spawn_blocking(list).await;
    // A dot says nothing.
    let whole = |folder: &PathBuf| std::fs::canonicalize(folder).unwrap_or_else(|_| folder.clone());
    let folders: Vec<String> =
        shared.folders.iter().map(|folder| whole(folder).display().to_string()).collect();
    match listed {
        Ok((list, sessions)) => Json(json!({ "tasks": shared.tasks, "sessions": sessions, "scenes": list.scenes, "is_cut": list.is_cut, "folders": folders }))
            .into_response(),
        Err(_) => (StatusCode::INTERNAL_SERVER_ERROR, "the scenes could not be listed; see the program's output\n")
            .into_response(),
    }
}

async fn start_task(State(shared): State<Arc<Shared>>, Json(choice): Json<TaskChoice>) -> Response {
    let Some(task) = shared.tasks.iter().find(|task| task.name == choice.name) else {
        return (StatusCode::NOT_FOUND, format!("there is no task \"{}\"\n", choice.name)).into_response();
    };
    if choice.demonstrate && !task.has_demonstration {
        return (StatusCode::NOT_FOUND, "the task has no demonstration\n").into_response();
    }
    let TaskChoice { demonstrate, patient, level, .. } = choice;
    let chosen =
        Choice::Task { name: task.name, demonstrate, variant: glisson::scene::Choice { patient, level } };
    begin(&shared.making, task.title().to_owned(), move || Ok(chosen))
}

/// A scene by the name that it is listed with: what is not in the folders has none.
async fn start_scene(State(shared): State<Arc<Shared>>, Json(choice): Json<SceneChoice>) -> Response {
    let for_list = Arc::clone(&shared);
    let listed = tokio::task::spawn_blocking(move || listing::scenes(&for_list.folders).scenes).await;
    let line = listed.unwrap_or_default().into_iter().find(|line| line.file == choice.file);
    let Some(line) = line else {
        return (
            StatusCode::NOT_FOUND,
            format!("there is no scene \"{}\" in the listed folders\n", choice.file),
        )
            .into_response();
    };
    begin(&shared.making, line.file, move || Ok(Choice::Scene { path: line.path }))
}

/// A session that was cut off, by the name that it is listed with: gone on with, or set aside.
async fn cut_off(shared: Arc<Shared>, choice: SessionChoice, is_wanted: bool) -> Response {
    let for_list = Arc::clone(&shared);
    let listed = tokio::task::spawn_blocking(move || listing::cut_off(for_list.sessions.as_deref())).await;
    let line = listed.unwrap_or_default().into_iter().find(|line| line.session == choice.session);
    let Some(line) = line else {
        let words = format!("there is no session \"{}\" that was cut off\n", choice.session);
        return (StatusCode::NOT_FOUND, words).into_response();
    };
    if is_wanted {
        return begin(&shared.making, line.title, move || Ok(Choice::Resume { session: line.path }));
    }
    match set_aside(&line.path) {
        Ok(_) => StatusCode::ACCEPTED.into_response(),
        Err(error) => (StatusCode::CONFLICT, format!("{error:#}\n")).into_response(),
    }
}

fn router(shared: Arc<Shared>, access: Access) -> Router {
    let cancel = |State(shared): State<Arc<Shared>>, Json(Nothing {}): Json<Nothing>| async move {
        shared.making.cancel();
        StatusCode::ACCEPTED
    };
    let patient = |State(shared): State<Arc<Shared>>, Json(Nothing {}): Json<Nothing>| async move {
        shared.making.go_to_patient()
    };
    let go_on =
        |State(shared): State<Arc<Shared>>, Json(choice): Json<SessionChoice>| cut_off(shared, choice, true);
    let set_aside =
        |State(shared): State<Arc<Shared>>, Json(choice): Json<SessionChoice>| cut_off(shared, choice, false);
    let api = Router::new()
        .route("/api/page", get(|State(s): State<Arc<Shared>>| async move { Json(s.making.state()) }))
        .route("/api/start", get(offers))
        .route("/api/start/task", post(start_task))
        .route("/api/start/scene", post(start_scene))
        .route("/api/start/session", post(go_on))
        .route("/api/start/set_aside", post(set_aside))
        .route("/api/start/patient", post(patient))
        .route("/api/start/cancel", post(cancel))
        .route_layer(from_fn_with_state(Arc::<Asked>::default(), guard_api));
    api.route("/", get(|| async { viewer_file("start.html") }))
        .route("/{*path}", get(|UrlPath(path): UrlPath<String>| async move { viewer_file(&path) }))
        .layer(from_fn_with_state(Arc::new(access), access::guard))
        .with_state(shared)
}

/// Serves the page until something was started, which is the answer, or until `stop` comes: then there is none.
///
/// # Errors
/// A listener that cannot be used; a task of the program that cannot be read.
pub fn serve(
    listener: TcpListener,
    access: Access,
    page: StartPage,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<Option<Chosen>> {
    let StartPage { folders, sessions, open, error } = page;
    let making = Arc::new(Making::new(open, error));
    let shared =
        Arc::new(Shared { tasks: listing::tasks()?, folders, sessions, making: Arc::clone(&making) });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let for_pages = Arc::clone(&making);
    let stopped = runtime.block_on(async move {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let (ending, ended) = tokio::sync::oneshot::channel();
        let graceful = async move {
            for_pages.ready.notified().await;
            // Nobody listens where the server ended before.
            let _ = ending.send(());
        };
        let server =
            axum::serve(Places::new(listener), router(shared, access)).with_graceful_shutdown(graceful);
        let patience = async {
            if ended.await.is_err() {
                std::future::pending::<()>().await;
            }
            tokio::time::sleep(LAST_ANSWERS).await;
        };
        tokio::select! {
            result = server.into_future() => result.context("the server stopped").map(|()| false),
            () = patience => Ok(false),
            () = stop => Ok(true),
        }
    });
    // What is being made ends where it next tells how far it is, or with the program.
    making.cancel();
    runtime.shutdown_background();
    let was_stopped: bool = stopped?;
    Ok(making.take_chosen().filter(|_| !was_stopped))
}
