//! The viewer's server: the page, a WebSocket, and the latest state as JSON (`docs/protocol.md`).

pub mod access;
mod allowance;
pub(crate) mod limits;
mod flow;
mod socket;
pub mod passive;

use access::Access;
use anyhow::Context;
use axum::Router;
use axum::extract::{Path as UrlPath, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use glisson::training::task::TaskRecord;
use glisson_protocol::conversation::Room;
use glisson_protocol::hands::{self, Hands};
use glisson_protocol::messages::{self, HapticsAt};
use glisson_report::{ReportContext, task_report};
use glisson_results::Comparison;
use glisson_runtime::Simulation;
use glisson_runtime::haptic_loop::{HapticLoop, HapticReport, HapticSettings, HeldTool, Meters, ToolLink};
use glisson_runtime::live::{self, Command, Ended, Stalls};
use glisson_runtime::page_hand::PageHand;
use glisson_runtime::published::Published;
use glisson_runtime::remote_figures::RemoteFigures;
use glisson_runtime::shown::Shown;
pub use glisson_runtime::steering::{Show, Steering};
use limits::Places;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;
use tokio::sync::watch;

/// The viewer as built into `web/dist`, to which `pages` leads: what cargo packages lies in a crate's own folder.
#[derive(rust_embed::RustEmbed)]
#[folder = "pages"]
#[allow_missing = true]
pub(crate) struct ViewerFiles;

const NOT_BUILT: &str = "<!doctype html><meta charset=utf-8><title>Glisson</title><p>The viewer was not built \
into this program. Run <code>cargo xtask demo</code>, which builds it.";

struct Shared {
    room: Arc<Room>,
    published: watch::Receiver<Arc<Published>>,
    commands: Sender<Command>,
    /// Of the haptic loop, if one runs.
    meters: Option<Arc<Meters>>,
    haptics_at: HapticsAt,
    /// Of the haptic loop on the other machine, if there is one.
    remote_figures: Option<RemoteFigures>,
    /// What the haptic loop needs to see that they are home.
    homing: Duration,
    /// Told when the simulation is to end; none where nothing comes after it.
    leaving: Option<watch::Sender<bool>>,
    compare: Option<Compare>,
}

/// Answers the place of a task's result beside others, or why there is none.
pub type Compare = Box<dyn Fn(&TaskRecord) -> Result<Comparison, String> + Send + Sync>;

/// What is served beside the simulation.
pub struct Service {
    /// Who may connect.
    pub access: Access,
    /// The haptic loop's and the simulation's ends of the instruments that devices hold.
    pub held: Vec<(HeldTool, ToolLink)>,
    /// How the haptic loop runs.
    pub haptics: HapticSettings,
    /// Instruments that are held elsewhere.
    pub remote: Vec<ToolLink>,
    /// What the machine that holds them says of its haptic loop.
    pub remote_figures: Option<RemoteFigures>,
    /// What else shows the simulation; each ends with it.
    pub shows: Vec<Show>,
    /// Where the haptic loop notes its times.
    pub meters: Arc<Meters>,
    /// For benchmarks: the simulation stands still now and then.
    pub stalls: Option<Stalls>,
    /// For tests of the page as a device: also told what it says about instrument 0.
    pub beside: Option<PageHand>,
    /// The page in control may end the simulation: another page comes after it.
    pub may_leave: bool,
    /// What the report of a task compares its result with.
    pub compare: Option<Compare>,
}

impl Service {
    /// No devices.
    pub fn to(access: Access) -> Self {
        Self {
            access,
            held: Vec::new(),
            haptics: HapticSettings::default(),
            remote: Vec::new(),
            remote_figures: None,
            shows: Vec::new(),
            meters: Arc::default(),
            stalls: None,
            beside: None,
            may_leave: false,
            compare: None,
        }
    }
}

/// How a service ended.
pub struct Served {
    /// How the simulation ended.
    pub ended: Ended,
    /// Without a device there is no haptic loop.
    pub haptics: Option<HapticReport>,
    /// A page ended it.
    pub was_left: bool,
}

/// A bound but not yet serving address, so that a taken port is known before a long set-up.
pub fn bind(host: &str, port: u16) -> anyhow::Result<TcpListener> {
    let listener = TcpListener::bind((host, port)).map_err(|e| match e.kind() {
        std::io::ErrorKind::AddrInUse => anyhow::anyhow!(
            "port {port} on {host} is in use; stop the other program or choose another one with --port (0: any free one)"
        ),
        _ => anyhow::anyhow!("cannot listen on {host} port {port}: {e}"),
    })?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves until `stop` comes; answers how the simulation and the haptic loop did.
pub fn serve(
    simulation: Simulation,
    listener: TcpListener,
    service: Service,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<Served> {
    let Service {
        access,
        held,
        haptics,
        remote,
        remote_figures,
        shows,
        meters,
        stalls,
        beside,
        may_leave,
        compare,
    } = service;
    let (shown, published) = Shown::start(&simulation)?;
    let (commands, commands_out) = std::sync::mpsc::channel();
    let hello = messages::hello(&simulation);
    let devices = messages::devices(held.iter().map(|(_, link)| link).chain(&remote));
    let leaving = may_leave.then(|| watch::Sender::new(false));
    let (mut held, mut links): (Vec<_>, Vec<_>) = held.into_iter().unzip();
    let hands = held.iter_mut().zip(&links).filter_map(|(held, link): (&mut HeldTool, &ToolLink)| {
        held.take_page().map(|page| (link.tool, page))
    });
    let hands = Hands::new(hands.collect(), beside);
    let haptics_at = match (held.is_empty(), remote.is_empty()) {
        (false, _) => HapticsAt::Here,
        (true, false) => HapticsAt::OtherMachine,
        (true, true) => HapticsAt::Nowhere,
    };
    links.extend(remote);
    let room = Arc::new(Room::new(hello, devices, hands, may_leave));
    let steering = Steering::new(Arc::clone(&room.control), commands.clone());
    let shows: Vec<_> =
        shows.into_iter().map(|show| show(published.clone(), &steering)).collect::<Result<_, _>>()?;
    let homing = hands::homing(haptics.rate_hz);
    let haptics = if held.is_empty() { None } else { Some(HapticLoop::start(held, haptics, meters)?) };
    let simulation_thread = std::thread::Builder::new()
        .name("simulation".into())
        .spawn(move || live::run(simulation, &commands_out, shown, links, stalls.as_ref()))?;
    let shared = Arc::new(Shared {
        room,
        published,
        commands: commands.clone(),
        meters: haptics.as_ref().map(|haptics| Arc::clone(haptics.meters())),
        haptics_at,
        remote_figures,
        homing,
        leaving: leaving.clone(),
        compare,
    });
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let served = runtime.block_on(serve_pages(listener, shared, access, stop));
    // The hand is let go before the tissue.
    let haptics = haptics.map(|haptics| haptics.meters().report());
    // The simulation may have ended already; then nobody listens.
    let _ = commands.send(Command::Stop);
    let ended = simulation_thread.join().map_err(|_| anyhow::anyhow!("the simulation panicked"))?;
    for show in shows {
        // A panic was printed when it happened.
        let _ = show.join();
    }
    let was_left = leaving.is_some_and(|leaving| *leaving.borrow());
    served.and(ended).map(|ended| Served { ended, haptics, was_left })
}

/// Answers requests until `stop` comes, a page leaves, or the simulation ends.
async fn serve_pages(
    listener: TcpListener,
    shared: Arc<Shared>,
    access: Access,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<()> {
    let mut alive = shared.published.clone();
    let mut left = shared.leaving.as_ref().map(watch::Sender::subscribe);
    tokio::spawn(tell_hands(Arc::clone(&shared)));
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let server = axum::serve(Places::new(listener), router(shared, access)).into_future();
    tokio::select! {
        result = server => result.context("the server stopped"),
        () = stop => Ok(()),
        Some(()) = async { left.as_mut()?.wait_for(|left| *left).await.ok().map(|_| ()) } => Ok(()),
        // The channel closes when the simulation ends by itself: with an error.
        () = async { while alive.changed().await.is_ok() {} } => Ok(()),
    }
}

/// Tells the hands who controls, until the program ends.
async fn tell_hands(shared: Arc<Shared>) {
    let Room { control, hands, .. } = &*shared.room;
    let mut steers = control.watch();
    loop {
        let now = *steers.borrow_and_update();
        hands.are_of(&now);
        if hands.is_empty() || steers.changed().await.is_err() {
            return;
        }
    }
}

/// Comes with Ctrl-C or SIGTERM.
pub async fn stop_signal() {
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

fn router(shared: Arc<Shared>, access: Access) -> Router {
    let api = Router::new()
        .route("/api/scene", get(scene))
        .route("/api/snapshot", get(latest_snapshot))
        .route("/api/task", get(task_result))
        .route("/api/page", get(|| async { axum::Json(serde_json::json!({ "page": "viewer" })) }))
        .route("/report", get(report))
        .route_layer(from_fn_with_state(Arc::<limits::Asked>::default(), limits::guard_api));
    api.route("/ws", get(socket::open))
        .route("/", get(|| async { viewer_file("index.html") }))
        .route("/{*path}", get(|UrlPath(path): UrlPath<String>| async move { viewer_file(&path) }))
        .layer(from_fn_with_state(Arc::new(access), access::guard))
        .with_state(shared)
}

async fn scene(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    // Not under the lock, for which a writer waits: the answer is long.
    let model = shared.published.borrow().model;
    axum::Json(shared.room.hello(model))
}

async fn latest_snapshot(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let published = Arc::clone(&shared.published.borrow());
    axum::Json(messages::snapshot(&published))
}

/// What was written down of the task, or why there is nothing yet.
fn finished_task(shared: &Shared) -> Result<Arc<TaskRecord>, (StatusCode, &'static str)> {
    let latest = Arc::clone(&shared.published.borrow());
    match (&latest.task, &latest.task_record) {
        (_, Some(record)) => Ok(Arc::clone(record)),
        (Some(_), None) => Err((StatusCode::CONFLICT, "the task is not over yet\n")),
        (None, None) => Err((StatusCode::NOT_FOUND, "the scene has no task\n")),
    }
}

/// The assessment of long movements takes a while: not where all viewers are served.
async fn assessed<T: Send + 'static>(
    shared: Arc<Shared>,
    assess: impl FnOnce(&TaskRecord) -> T + Send + 'static,
) -> Result<T, (StatusCode, &'static str)> {
    let record = finished_task(&shared)?;
    let assessed = tokio::task::spawn_blocking(move || assess(&record)).await;
    assessed
        .map_err(|_| (StatusCode::INTERNAL_SERVER_ERROR, "the assessment failed; see the program's output\n"))
}

async fn task_result(State(shared): State<Arc<Shared>>) -> Response {
    assessed(shared, TaskRecord::result).await.map(axum::Json).into_response()
}

async fn report(State(shared): State<Arc<Shared>>) -> Response {
    let with = Arc::clone(&shared);
    let html = assessed(shared, move |record| {
        let compared = with.compare.as_ref().map(|compare| compare(record));
        let comparison = compared.as_ref().and_then(|compared| compared.as_ref().ok());
        let note = compared.as_ref().and_then(|compared| compared.as_ref().err()).map(String::as_str);
        task_report(
            record,
            &record.result(),
            &ReportContext { back: Some("/"), comparison, note, replay: None },
        )
    });
    let html = html.await;
    html.map(axum::response::Html).into_response()
}

/// A file of the page.
pub(crate) fn viewer_file(path: &str) -> Response {
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
        None if ["index.html", "patient.html", "start.html"].contains(&path) => {
            ([(header::CONTENT_TYPE, content_type)], NOT_BUILT).into_response()
        }
        None => (StatusCode::NOT_FOUND, format!("no file {path}\n")).into_response(),
    }
}

/// Whether the page was built into the program.
pub fn has_page() -> bool {
    ViewerFiles::get("index.html").is_some()
}

/// The address to type into a browser.
pub fn page_address(address: SocketAddr) -> String {
    format!("http://{address}/")
}

#[cfg(test)]
mod tests;
