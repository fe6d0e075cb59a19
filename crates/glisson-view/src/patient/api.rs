//! What the page asks for, and the steps that run meanwhile.

use anyhow::Context;
use axum::Router;
use axum::body::Bytes;
use axum::extract::{DefaultBodyLimit, Path as UrlPath, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post, put};
use glisson::material::tissues::TISSUES;
use glisson::math::DVec3;
use glisson::mesh::files::write_mesh;
use glisson_runtime::Simulation;
use serde::Deserialize;
use serde_json::{Value, json};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::Notify;
use tokio::task::JoinError;

use super::image::{Image, Meshed, Organ, series_of};
use super::scene::{HELD, MODELS, SCENE_NAME, SceneChoice};
use super::upload::Upload;
use crate::picture::SlicePlane;
use crate::server::access::{self, Access};
use crate::server::limits::Places;
use crate::server::viewer_file;

/// One file at most [bytes].
const MOST_FILE: usize = 2 << 30;
/// Tetrahedra of an organ: least, what is offered, most.
const TETRAHEDRA: [usize; 3] = [500, 6_000, 200_000];
/// The organ's mesh beside its scene.
const MESH_NAME: &str = "organ.vtu";

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
}

/// How far the patient is.
#[derive(Default)]
struct Steps {
    image: Option<Arc<Image>>,
    /// Grows with each image.
    n_images: u64,
    /// Series to choose from, where there are several, and where they are.
    series: Vec<String>,
    source: Option<Source>,
    organ: Option<Arc<Organ>>,
    mesh: Option<Arc<Meshed>>,
    simulation: Option<Simulation>,
    /// What runs, and since when.
    job: Option<(&'static str, Instant)>,
    error: Option<String>,
    /// Grows whenever pictures change.
    version: u64,
}

/// Where an image is read from.
#[derive(Clone)]
struct Source {
    path: PathBuf,
    /// The number of the image that came by the page.
    upload: Option<u64>,
}

struct Shared {
    steps: Mutex<Steps>,
    upload: Upload,
    /// The image that the program was started with.
    image: Option<PathBuf>,
    folder: PathBuf,
    open: OpenSimulation,
    started: Notify,
}

impl Shared {
    fn steps(&self) -> MutexGuard<'_, Steps> {
        self.steps.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What became of a step; answers whether the simulation is ready.
    fn end_job(&self, what: &str, result: Result<anyhow::Result<Change>, JoinError>) -> bool {
        let mut steps = self.steps();
        steps.job = None;
        match result {
            Ok(Ok(change)) => {
                change(&mut steps);
                // Where the simulation takes over, nobody is left to draw anew.
                steps.version += u64::from(steps.simulation.is_none());
            }
            Ok(Err(error)) => steps.error = Some(format!("{error:#}")),
            Err(_) => {
                steps.error = Some(format!("{what} failed by a fault of the program; its output says where"));
            }
        }
        steps.simulation.is_some()
    }

    fn state(&self) -> Value {
        let steps = self.steps();
        let job =
            steps.job.map(|(what, since)| json!({"what": what, "seconds": since.elapsed().as_secs_f64()}));
        json!({
            "version": steps.version,
            "image_number": steps.n_images,
            "job": job,
            "error": steps.error,
            "series": steps.series,
            "image": steps.image.as_ref().map(|image| &image.summary),
            "organ": steps.organ.as_ref().map(|organ| &organ.summary),
            "mesh": steps.mesh.as_ref().map(|mesh| &mesh.summary),
            "started": steps.simulation.is_some(),
            "offers": {
                "tissues": TISSUES.iter().map(|tissue| tissue.name).collect::<Vec<_>>(),
                "models": MODELS.iter().map(|model| json!({"name": model.name, "about": model.about})).collect::<Vec<_>>(),
                "held": HELD.iter().map(|held| held.name).collect::<Vec<_>>(),
                "tetrahedra": TETRAHEDRA,
            },
        })
    }
}

/// What a step changes when it is done.
type Change = Box<dyn FnOnce(&mut Steps) + Send>;

/// Begins a step, unless one runs. The answer comes at once, what became of it with the state.
fn begin(
    shared: &Arc<Shared>,
    what: &'static str,
    work: impl FnOnce(&Shared) -> anyhow::Result<Change> + Send + 'static,
) -> Response {
    {
        let mut steps = shared.steps();
        if let Some((running, _)) = steps.job {
            return (StatusCode::CONFLICT, format!("still {running}\n")).into_response();
        }
        if steps.simulation.is_some() {
            return (StatusCode::CONFLICT, "the simulation starts\n").into_response();
        }
        steps.job = Some((what, Instant::now()));
        steps.error = None;
    }
    let (for_work, shared) = (Arc::clone(shared), Arc::clone(shared));
    tokio::spawn(async move {
        let result = tokio::task::spawn_blocking(move || work(&for_work)).await;
        if shared.end_job(what, result) {
            // The page is to hear of it from this server; then it looks for the next one.
            tokio::time::sleep(UNTIL_TOLD).await;
            shared.started.notify_one();
        }
    });
    StatusCode::ACCEPTED.into_response()
}

/// Reads what came as image number `upload`, a series of what was read before, or the image that the program was started with.
fn open(shared: &Arc<Shared>, choice: &OpenChoice) -> Response {
    let OpenChoice { upload, series: chosen } = *choice;
    let before = shared.steps().source.clone();
    begin(shared, "reading the image", move |shared| {
        let earlier = before.as_ref().and_then(|source| source.upload);
        let source = match (upload, before) {
            (Some(number), _) => Source { path: shared.upload.image(number)?, upload },
            (None, Some(before)) if chosen.is_some() => before,
            (None, _) => {
                Source { path: shared.image.clone().context("there is no image yet")?, upload: None }
            }
        };
        let read = Image::read(&source.path, chosen);
        let series = series_of(&source.path);
        let forget = |upload: Option<u64>| upload.iter().for_each(|number| shared.upload.forget(*number));
        let image = match read {
            Ok(image) => Some(Arc::new(image)),
            // The page asks which.
            Err(_) if !series.is_empty() && chosen.is_none() => None,
            Err(error) => {
                if series.is_empty() {
                    forget(source.upload);
                }
                // How the user's files are called is nobody else's business.
                let words = format!("{error:#}").replace(&source.path.display().to_string(), "the image");
                anyhow::bail!(if source.upload.is_some() { words } else { format!("{error:#}") });
            }
        };
        if earlier != source.upload {
            forget(earlier);
        }
        // Of several series another one may be asked for.
        if series.is_empty() {
            forget(source.upload);
        }
        Ok(Box::new(move |steps: &mut Steps| {
            steps.n_images += u64::from(image.is_some());
            (steps.image, steps.series, steps.source) = (image, series, Some(source));
            (steps.organ, steps.mesh) = (None, None);
        }))
    })
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OpenChoice {
    /// The number that its files came with.
    upload: Option<u64>,
    /// From 1.
    series: Option<usize>,
}

#[derive(Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct OrganChoice {
    inside_mm: Vec<[f64; 3]>,
    outside_mm: Vec<[f64; 3]>,
    label: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MeshChoice {
    tetrahedra: usize,
}

fn find_organ(shared: &Arc<Shared>, choice: OrganChoice) -> Response {
    let image = shared.steps().image.clone();
    begin(shared, "finding the organ", move |_| {
        let image = image.context("there is no image yet")?;
        let in_m = |points: Vec<[f64; 3]>| points.into_iter().map(|p| 1e-3 * DVec3::from_array(p)).collect();
        let organ = match &choice.label {
            Some(label) => image.choose_label(label),
            None => image.find_organ(in_m(choice.inside_mm), in_m(choice.outside_mm)),
        }?;
        Ok(Box::new(move |steps: &mut Steps| (steps.organ, steps.mesh) = (Some(Arc::new(organ)), None)))
    })
}

fn fill(shared: &Arc<Shared>, choice: &MeshChoice) -> Response {
    let organ = shared.steps().organ.clone();
    let [least, _, most] = TETRAHEDRA;
    let n_tets = choice.tetrahedra;
    begin(shared, "filling the organ with tetrahedra", move |_| {
        let organ = organ.context("there is no organ yet")?;
        anyhow::ensure!(
            (least..=most).contains(&n_tets),
            "found {n_tets} tetrahedra, allowed: {least} to {most}"
        );
        let mesh = organ.mesh(n_tets)?;
        Ok(Box::new(move |steps: &mut Steps| steps.mesh = Some(Arc::new(mesh))))
    })
}

fn start(shared: &Arc<Shared>, choice: SceneChoice) -> Response {
    let mesh = shared.steps().mesh.clone();
    begin(shared, "starting the simulation", move |shared| {
        let mesh = mesh.context("there are no tetrahedra yet")?;
        std::fs::create_dir_all(&shared.folder).with_context(|| shared.folder.display().to_string())?;
        write_mesh(&shared.folder.join(MESH_NAME), &mesh.mesh)?;
        let scene = choice.write(&mesh.mesh, MESH_NAME, &shared.folder)?;
        let simulation = (shared.open)(&scene)?;
        Ok(Box::new(move |steps: &mut Steps| steps.simulation = Some(simulation)))
    })
}

fn png(picture: anyhow::Result<Vec<u8>>) -> Response {
    match picture {
        Ok(bytes) => ([(header::CONTENT_TYPE, "image/png"), (header::CACHE_CONTROL, "no-store")], bytes)
            .into_response(),
        Err(error) => (StatusCode::BAD_REQUEST, format!("{error:#}\n")).into_response(),
    }
}

fn plane_named(name: &str) -> Option<SlicePlane> {
    match name {
        "axial" => Some(SlicePlane::Axial),
        "coronal" => Some(SlicePlane::Coronal),
        "sagittal" => Some(SlicePlane::Sagittal),
        _ => None,
    }
}

/// Plane, a point of it [mm], centre and width of the window.
type SliceAt = (String, f64, f64, f64, f64, f64);

async fn slice(State(shared): State<Arc<Shared>>, UrlPath(at): UrlPath<SliceAt>) -> Response {
    let (plane, x, y, z, centre, width) = at;
    let (image, organ) = {
        let steps = shared.steps();
        (steps.image.clone(), steps.organ.clone())
    };
    let drawn = tokio::task::spawn_blocking(move || {
        let image = image.context("there is no image yet")?;
        let plane = plane_named(&plane).context("allowed planes: axial, coronal, sagittal")?;
        let numbers = [x, y, z, centre, width];
        anyhow::ensure!(numbers.iter().all(|x| x.is_finite()), "a number of the slice is not finite");
        image.slice_png(organ.as_deref(), plane, 1e-3 * DVec3::new(x, y, z), [centre, width])
    });
    png(drawn.await.unwrap_or_else(|error| Err(error.into())))
}

async fn state(State(shared): State<Arc<Shared>>) -> Response {
    let state = shared.state();
    if state["started"] == true {
        shared.started.notify_one();
    }
    axum::Json(state).into_response()
}

async fn picture(State(shared): State<Arc<Shared>>) -> Response {
    let mesh = shared.steps().mesh.clone();
    png(mesh.map(|mesh| mesh.picture.clone()).context("there are no tetrahedra yet"))
}

async fn keep(
    State(shared): State<Arc<Shared>>,
    UrlPath((image, name)): UrlPath<(u64, String)>,
    bytes: Bytes,
) -> Response {
    let kept = tokio::task::spawn_blocking(move || shared.upload.keep(image, &name, &bytes));
    match kept.await.unwrap_or_else(|error| Err(error.into())) {
        Ok(()) => StatusCode::NO_CONTENT.into_response(),
        Err(error) => (StatusCode::INSUFFICIENT_STORAGE, format!("{error:#}\n")).into_response(),
    }
}

/// The number that the files of a new image are to come with.
async fn begin_upload(State(shared): State<Arc<Shared>>) -> Response {
    axum::Json(json!({"upload": shared.upload.begin()})).into_response()
}

type Asked<T> = (State<Arc<Shared>>, axum::Json<T>);

fn router(shared: Arc<Shared>, access: Access) -> Router {
    Router::new()
        .route("/api/patient/state", get(state))
        .route("/api/patient/files", post(begin_upload))
        .route("/api/patient/files/{image}/{name}", put(keep).layer(DefaultBodyLimit::max(MOST_FILE)))
        .route("/api/patient/slice/{plane}/{x}/{y}/{z}/{centre}/{width}", get(slice))
        .route("/api/patient/picture.png", get(picture))
        .route(
            "/api/patient/open",
            post(|(State(s), axum::Json(c)): Asked<OpenChoice>| async move { open(&s, &c) }),
        )
        .route(
            "/api/patient/organ",
            post(|(State(s), axum::Json(c)): Asked<OrganChoice>| async move { find_organ(&s, c) }),
        )
        .route(
            "/api/patient/mesh",
            post(|(State(s), axum::Json(c)): Asked<MeshChoice>| async move { fill(&s, &c) }),
        )
        .route(
            "/api/patient/start",
            post(|(State(s), axum::Json(c)): Asked<SceneChoice>| async move { start(&s, c) }),
        )
        .route("/", get(|| async { viewer_file("patient.html") }))
        .route("/{*path}", get(|UrlPath(path): UrlPath<String>| async move { viewer_file(&path) }))
        .layer(from_fn_with_state(Arc::new(access), access::guard))
        .with_state(shared)
}

/// Refuses a folder that holds what the page would write: it is of another patient, or somebody's own.
fn refuse_other_files(folder: &Path) -> anyhow::Result<()> {
    match [MESH_NAME, SCENE_NAME].into_iter().map(|name| folder.join(name)).find(|path| path.exists()) {
        Some(path) => anyhow::bail!("{} is there already; take another folder with --out", path.display()),
        None => Ok(()),
    }
}

/// Serves the page until its simulation is ready, which is the answer, or until `stop` comes: then there is none.
///
/// # Errors
/// A listener that cannot be used; a folder that holds a mesh or a scene.
pub fn serve(
    listener: TcpListener,
    access: Access,
    page: PatientPage,
    stop: impl Future<Output = ()>,
) -> anyhow::Result<Option<Simulation>> {
    let PatientPage { folder, image, open: open_scene } = page;
    refuse_other_files(&folder)?;
    let upload = Upload::new(folder.join(format!("incoming-{}.partial", std::process::id())));
    let has_image = image.is_some();
    let shared = Arc::new(Shared {
        steps: Mutex::default(),
        upload,
        image,
        folder,
        open: open_scene,
        started: Notify::new(),
    });
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
    // A step that runs ends with the program.
    runtime.shutdown_background();
    // The step that runs may hold on to it.
    shared.upload.forget_all();
    let was_stopped = stopped?;
    let simulation = shared.steps().simulation.take();
    Ok(simulation.filter(|_| !was_stopped))
}
