//! The viewer's server: the page, a WebSocket, and the latest state as JSON (`docs/protocol.md`).

pub(crate) mod frames;
mod messages;

use crate::runtime::Simulation;
use crate::runtime::live::{self, Command, Published};
use anyhow::Context;
use axum::Router;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path as UrlPath, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use frames::{Pace, snapshot_frame, topology_frame};
use glisson::record::hash::StateHash;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::mpsc::Sender;
use tokio::sync::watch;

/// The viewer as built into `web/dist`.
#[derive(rust_embed::RustEmbed)]
#[folder = "../../web/dist"]
#[allow_missing = true]
struct ViewerFiles;

const NOT_BUILT: &str = "<!doctype html><meta charset=utf-8><title>Glisson</title><p>The viewer was not built \
into this program. Run <code>cargo xtask demo</code>, which builds it.";

struct Shared {
    hello: serde_json::Value,
    published: watch::Receiver<Arc<Published>>,
    commands: Sender<Command>,
}

/// A bound but not yet serving address, so that a taken port is known before a long set-up.
pub(crate) fn bind(host: &str, port: u16) -> anyhow::Result<TcpListener> {
    let listener = TcpListener::bind((host, port)).map_err(|e| match e.kind() {
        std::io::ErrorKind::AddrInUse => anyhow::anyhow!(
            "port {port} on {host} is in use; stop the other program or choose another one with --port (0: any free one)"
        ),
        _ => anyhow::anyhow!("cannot listen on {host} port {port}: {e}"),
    })?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves until Ctrl-C (or SIGTERM); answers the hash of the last state.
pub(crate) fn serve(simulation: Simulation, listener: TcpListener) -> anyhow::Result<StateHash> {
    let (published_in, published) =
        watch::channel(Arc::new(Published::of(&simulation, None, Pace::default())));
    let (commands, commands_out) = std::sync::mpsc::channel();
    let shared =
        Arc::new(Shared { hello: messages::hello(&simulation), published, commands: commands.clone() });
    let simulation_thread = std::thread::Builder::new()
        .name("simulation".into())
        .spawn(move || live::run(simulation, &commands_out, &published_in))?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let served = runtime.block_on(async {
        let mut alive = shared.published.clone();
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let server = axum::serve(listener, router(shared)).into_future();
        tokio::select! {
            result = server => result.context("the server stopped"),
            () = stop_signal() => Ok(()),
            // The channel closes when the simulation ends by itself: with an error.
            () = async { while alive.changed().await.is_ok() {} } => Ok(()),
        }
    });
    // The simulation may have ended already; then nobody listens.
    let _ = commands.send(Command::Stop);
    let state_hash = simulation_thread.join().map_err(|_| anyhow::anyhow!("the simulation panicked"))?;
    served.and(state_hash)
}

async fn stop_signal() {
    let interrupt = tokio::signal::ctrl_c();
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = interrupt => {}
                _ = terminate.recv() => {}
            }
            return;
        }
    }
    let _ = interrupt.await;
}

fn router(shared: Arc<Shared>) -> Router {
    Router::new()
        .route("/ws", get(open_socket))
        .route("/api/scene", get(scene))
        .route("/api/snapshot", get(latest_snapshot))
        .route("/", get(|| async { viewer_file("index.html") }))
        .route("/{*path}", get(|UrlPath(path): UrlPath<String>| async move { viewer_file(&path) }))
        .with_state(shared)
}

async fn scene(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    axum::Json(messages::hello_with_model(&shared.hello, shared.published.borrow().model))
}

async fn latest_snapshot(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let published = Arc::clone(&shared.published.borrow());
    axum::Json(messages::snapshot(&published))
}

fn viewer_file(path: &str) -> Response {
    let content_type = match path.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript",
        Some("css") => "text/css",
        Some("svg") => "image/svg+xml",
        Some("png") => "image/png",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    };
    match ViewerFiles::get(path) {
        Some(file) => ([(header::CONTENT_TYPE, content_type)], file.data.into_owned()).into_response(),
        None if path == "index.html" => ([(header::CONTENT_TYPE, content_type)], NOT_BUILT).into_response(),
        None => (StatusCode::NOT_FOUND, format!("no file {path}\n")).into_response(),
    }
}

/// A page of another site must not steer the simulation through the visitor's browser.
fn from_own_page(headers: &HeaderMap) -> bool {
    let text = |name| headers.get(name).and_then(|v: &axum::http::HeaderValue| v.to_str().ok());
    match (text(header::ORIGIN), text(header::HOST)) {
        (Some(origin), Some(host)) => origin.split_once("://").is_some_and(|(_, from)| from == host),
        (Some(_), None) => false,
        // Programs that are no browsers send no origin.
        (None, _) => true,
    }
}

async fn open_socket(
    headers: HeaderMap,
    State(shared): State<Arc<Shared>>,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !from_own_page(&headers) {
        return (StatusCode::FORBIDDEN, "only the viewer's own page may connect\n").into_response();
    }
    upgrade.max_message_size(1 << 16).on_upgrade(move |socket| async move {
        // An error here is a viewer that went away: nothing to do.
        let _ = talk(socket, &shared).await;
    })
}

/// What a viewer needs before the first snapshot, and again when another model took over.
async fn greet(socket: &mut WebSocket, shared: &Shared, published: &Published) -> Result<(), axum::Error> {
    let hello = messages::hello_with_model(&shared.hello, published.model);
    socket.send(Message::Text(hello.to_string().into())).await?;
    socket.send(Message::Binary(topology_frame(&published.topology).into())).await
}

async fn talk(mut socket: WebSocket, shared: &Shared) -> Result<(), axum::Error> {
    let mut published = shared.published.clone();
    let first = Arc::clone(&published.borrow());
    let (mut model, mut n_told, mut version) = (first.model, first.notices.len(), first.topology.version);
    greet(&mut socket, shared, &first).await?;
    published.mark_changed();
    loop {
        tokio::select! {
            changed = published.changed() => {
                if changed.is_err() {
                    let error = messages::error("the simulation stopped; see the program's output");
                    return socket.send(Message::Text(error.to_string().into())).await;
                }
                let latest = Arc::clone(&published.borrow_and_update());
                for notice in &latest.notices[n_told..] {
                    socket.send(Message::Text(messages::error(notice).to_string().into())).await?;
                }
                n_told = latest.notices.len();
                if latest.model != model {
                    model = latest.model;
                    greet(&mut socket, shared, &latest).await?;
                } else if latest.topology.version != version {
                    socket.send(Message::Binary(topology_frame(&latest.topology).into())).await?;
                }
                version = latest.topology.version;
                socket.send(Message::Binary(snapshot_frame(&latest.snapshot, &latest.pace).into())).await?;
            }
            message = socket.recv() => match message {
                Some(Ok(Message::Text(text))) => match messages::command(&text) {
                    // A simulation that ended is told by the closed channel above.
                    Ok(command) => drop(shared.commands.send(command)),
                    Err(reason) => {
                        socket.send(Message::Text(messages::error(&reason).to_string().into())).await?;
                    }
                },
                Some(Ok(Message::Close(_))) | None => return Ok(()),
                Some(Ok(_)) => {}
                Some(Err(error)) => return Err(error),
            },
        }
    }
}

/// The address to type into a browser.
pub(crate) fn page_address(address: SocketAddr) -> String {
    format!("http://{address}/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_of_other_sites_are_turned_away() {
        let headers = |origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "127.0.0.1:8077".parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            headers
        };
        assert!(from_own_page(&headers(None)));
        assert!(from_own_page(&headers(Some("http://127.0.0.1:8077"))));
        assert!(!from_own_page(&headers(Some("http://elsewhere.example"))));
        assert!(!from_own_page(&headers(Some("null"))));
    }

    #[test]
    fn a_taken_port_is_named() {
        let taken = bind("127.0.0.1", 0).unwrap();
        let port = taken.local_addr().unwrap().port();
        let message = bind("127.0.0.1", port).unwrap_err().to_string();
        assert!(message.contains(&format!("port {port}")) && message.contains("in use"), "{message}");
    }
}
