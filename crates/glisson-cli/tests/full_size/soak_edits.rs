//! Random cuts, removals, scalpel and blade strokes, grasps and tears on real bodies with every model that can be cut:
//! nothing panics, every number stays finite, every invariant holds after each edit, and a model that went through them
//! equals one made afresh. A seed draws its model and scene ([`draw`]); models take turns.
//! `cargo xtask test` runs a bounded share; `cargo xtask soak edits` sets GLISSON_SOAK_EDITS and GLISSON_SOAK_EDITS_REPORT.
//! GLISSON_SOAK_EDITS_SEEDS spreads the edits over so many seeds, GLISSON_SOAK_EDITS_SEED runs one alone.
//! With GLISSON_SOAK_EDITS_LOG the seeds that ended are kept in that file, and a run that was stopped goes on after them.

mod draw;
mod substance;
mod instruments;
mod skin;
mod attached;
mod checks;
mod before;
mod tally;
mod patient;
mod edits;
mod compare;
mod strokes;
mod tools;
mod operations;
mod report;

use self::draw::{Draw, MODELS};
use self::patient::Patient;
use self::report::Run;
use self::tally::{Results, SeedResult, Tally};
use super::{glisson, real_ct};
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::files::read_mesh;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::surface::TriMesh;
use std::any::Any;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, Once};
use std::time::Instant;

/// Two seeds of each model.
const DEFAULT_EDITS: u64 = 1_600;
/// Edits of one seed at most: a body that was cut more often is crumbs.
const EDITS_OF_SEED: u64 = 100;
/// A panic in a file whose path has this is a check that failed.
const OWN_FILES: &str = "soak_edits";

/// A rod of 60 mm along z, 40 mm across.
fn cylinder() -> TetMesh {
    let (n_around, n_along, radius_m, height_m) = (48_u32, 12_u32, 0.02, 0.06);
    let mut surface = TriMesh { positions_m: Vec::new(), triangles: Vec::new() };
    for k in 0..=n_along {
        for i in 0..n_around {
            let (sine, cosine) = (f64::from(i) / f64::from(n_around) * std::f64::consts::TAU).sin_cos();
            let z_m = height_m * f64::from(k) / f64::from(n_along);
            surface.positions_m.push(DVec3::new(radius_m * cosine, radius_m * sine, z_m));
        }
    }
    let at = |i: u32, k: u32| k * n_around + i % n_around;
    for k in 0..n_along {
        for i in 0..n_around {
            surface.triangles.push([at(i, k), at(i + 1, k), at(i + 1, k + 1)]);
            surface.triangles.push([at(i, k), at(i + 1, k + 1), at(i, k + 1)]);
        }
    }
    let bottom = surface.positions_m.len() as u32;
    surface.positions_m.extend([DVec3::ZERO, DVec3::Z * height_m]);
    for i in 0..n_around {
        surface.triangles.push([bottom, at(i + 1, 0), at(i, 0)]);
        surface.triangles.push([bottom + 1, at(i, n_along), at(i + 1, n_along)]);
    }
    let params = MeshParams { size: WantedSize::Tetrahedra(6000), volume_m3: None };
    generate(&surface, &params).unwrap().0
}

fn bodies(folder: &Path) -> Vec<(&'static str, TetMesh)> {
    glisson(&["demo", "--headless", "--out", folder.to_str().unwrap()]);
    let mut bodies = vec![
        ("phantom liver", read_mesh(&folder.join("liver.vtu")).unwrap().0),
        ("cube", box_of_five([10, 10, 10], DVec3::splat(0.05))),
        ("cylinder", cylinder()),
    ];
    if let Some(ct) = real_ct() {
        let (mask, mesh) = (ct.join("mask.nii.gz"), folder.join("real.vtu"));
        let path = |p: &Path| p.to_str().unwrap().to_string();
        let tetrahedra = ["--label", "5", "--tetrahedra", "6300", "-o"];
        let arguments: Vec<String> =
            [vec!["mesh".into(), path(&mask)], tetrahedra.map(String::from).to_vec(), vec![path(&mesh)]]
                .concat();
        glisson(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        bodies.push(("real CT liver", read_mesh(&mesh).unwrap().0));
    }
    bodies
}

thread_local! {
    /// File and line of the last panic of this thread.
    static LAST_PANIC: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Notes from now on where a thread panics.
fn watch_panics() {
    static WATCHED: Once = Once::new();
    WATCHED.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            let at = info.location().map(|at| format!("{}:{}", at.file(), at.line())).unwrap_or_default();
            LAST_PANIC.with_borrow_mut(|last| *last = at);
            before(info);
        }));
    });
}

fn text_of(told: &(dyn Any + Send)) -> String {
    let text = told.downcast_ref::<String>().cloned();
    text.or_else(|| told.downcast_ref::<&str>().map(|s| (*s).to_string())).unwrap_or_else(|| "a panic".into())
}

/// What broke when `work` panicked: whether it was no check that did, where, and what it said.
fn caught<T>(work: impl FnOnce() -> T) -> Result<T, (bool, String)> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|told| {
        let at = LAST_PANIC.with_borrow(Clone::clone);
        (!at.contains(OWN_FILES), format!("{at}: {}", text_of(told.as_ref())))
    })
}

/// All edits of a seed; what they broke, if they did.
fn run_seed(name: &str, mesh: &TetMesh, draw: &Draw, asked: u64) -> SeedResult {
    let start = Instant::now();
    let mut tally = Tally::default();
    let done = match caught(|| Patient::new(name, mesh, draw.clone())) {
        Ok(mut patient) => {
            let done = caught(|| patient.run(asked));
            tally = std::mem::take(&mut patient.tally);
            done.map_err(|(is_panic, told)| (is_panic, format!("{}: {told}", patient.label_at(&tally))))
        }
        Err(broken) => Err(broken),
    };
    tally.computed_s = start.elapsed().as_secs_f64();
    tally.panics = u64::from(done.as_ref().is_err_and(|(is_panic, _)| *is_panic));
    SeedResult {
        body: name.to_string(),
        tetrahedra: mesh.tetrahedra.len(),
        model: draw.kind.name().to_string(),
        law: draw.law_name().to_string(),
        touches_itself: draw.touches_itself,
        tears_tissue: draw.tears,
        seed: draw.seed,
        asked,
        broken: done.err().map(|(_, told)| told),
        tally,
    }
}

/// A variable of the run.
fn file_of(variable: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from)
}

/// Runs all seeds that are not known yet, on all threads; the results are in the order of the seeds.
fn run_seeds(bodies: &[(&str, TetMesh)], only: Option<u64>, [n_seeds, asked]: [u64; 2]) -> Results {
    let report = file_of("GLISSON_SOAK_EDITS_REPORT");
    let results = Mutex::new(Results::go_on(file_of("GLISSON_SOAK_EDITS_LOG"), n_seeds, asked));
    let next = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= n_seeds {
                        break;
                    }
                    if results.lock().unwrap().has(seed) || only.is_some_and(|only| only != seed) {
                        continue;
                    }
                    let draw = Draw::of(seed, bodies.len());
                    let (name, mesh) = &bodies[draw.body];
                    let result = run_seed(name, mesh, &draw, asked);
                    let mut results = results.lock().unwrap();
                    results.add(result);
                    if let Some(file) = &report {
                        std::fs::write(file, report_of(&results, n_seeds, asked)).unwrap();
                    }
                }
            });
        }
    });
    results.into_inner().unwrap()
}

fn report_of(results: &Results, n_seeds: u64, asked: u64) -> String {
    Run { of_seeds: &results.of_seeds, n_seeds, asked }.report()
}

#[test]
fn random_edits_break_nothing() {
    watch_panics();
    let edits: u64 = std::env::var("GLISSON_SOAK_EDITS").map_or(DEFAULT_EDITS, |s| s.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let bodies = bodies(folder.path());
    // As many seeds as that takes, unless told otherwise.
    let n_told: Option<u64> = std::env::var("GLISSON_SOAK_EDITS_SEEDS").ok().map(|s| s.parse().unwrap());
    let n_seeds = n_told.unwrap_or(edits.div_ceil(EDITS_OF_SEED)).max(MODELS.len() as u64);
    let asked = edits.div_ceil(n_seeds);
    // One seed alone, to look at what it broke.
    let only: Option<u64> = std::env::var("GLISSON_SOAK_EDITS_SEED").ok().map(|s| s.parse().unwrap());
    let results = run_seeds(&bodies, only, [n_seeds, asked]);
    eprint!("{}", report_of(&results, n_seeds, asked));
    let all = results.all();
    let broken: Vec<_> = results.broken().map(|r| (r.seed, r.broken.clone())).collect();
    assert!(broken.is_empty(), "{broken:?}");
    assert_eq!((all.panics, all.non_finite), (0, 0));
    if only.is_some() {
        return;
    }
    // What was asked for was done with every model, and the long run saw every body.
    assert!(all.edits() >= edits, "{} of {edits} edits", all.edits());
    assert!(edits <= DEFAULT_EDITS || bodies.len() == 4, "{} bodies", bodies.len());
    for kind in MODELS {
        assert!(results.of_seeds.iter().any(|r| r.model == kind.name()), "{kind}");
    }
    let by_tools = [all.burns, all.snips, all.tool_blade_edits, all.tears];
    let happened = [
        all.removals,
        all.blade_edits,
        all.scalpel_edits,
        all.undone,
        all.undone_late,
        all.held,
        all.comparisons,
    ];
    let all_happened = happened.iter().chain(&by_tools).all(|&n| n > 0);
    assert!(all_happened, "{happened:?} {by_tools:?}");
}
