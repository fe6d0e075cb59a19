//! Random cuts, removals, scalpel and blade strokes, grasps and tears on real bodies: nothing panics, every number stays
//! finite, every invariant holds after each edit, and a model that went through them equals one made afresh.
//! `cargo xtask test` runs a bounded share; `cargo xtask soak edits` sets GLISSON_SOAK_EDITS and GLISSON_SOAK_EDITS_REPORT.
//! With GLISSON_SOAK_EDITS_LOG the seeds that ended are kept in that file, and a run that was stopped goes on after them.

mod attached;
mod checks;
mod patient;
mod skin;
mod tally;
mod tools;

use self::patient::{COMPARED_EVERY, Patient};
use self::tally::{Results, SeedResult, Tally};
use super::{glisson, real_ct};
use glisson::math::DVec3;
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::files::read_mesh;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::surface::TriMesh;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

const DEFAULT_EDITS: u64 = 1_600;
/// Edits of one seed at most: a body that was cut more often is crumbs.
const EDITS_OF_SEED: u64 = 500;

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

/// All edits of a seed; what they broke, if they did.
fn run_seed(name: &str, mesh: &TetMesh, seed: u64, asked: u64) -> SeedResult {
    let run = || Patient::new(name, mesh, seed).run(asked);
    let (tally, broken) = match catch_unwind(AssertUnwindSafe(run)) {
        Ok(tally) => (tally, None),
        Err(told) => {
            let text = told.downcast_ref::<String>().cloned();
            let text = text.or_else(|| told.downcast_ref::<&str>().map(|s| (*s).to_string()));
            (Tally::default(), Some(text.unwrap_or_else(|| "a panic".to_string())))
        }
    };
    SeedResult { body: name.to_string(), tetrahedra: mesh.tetrahedra.len(), seed, asked, broken, tally }
}

#[test]
fn random_edits_break_nothing() {
    let edits: u64 = std::env::var("GLISSON_SOAK_EDITS").map_or(DEFAULT_EDITS, |s| s.parse().unwrap());
    let file = |variable: &str| std::env::var_os(variable).map(PathBuf::from);
    let (log, report) = (file("GLISSON_SOAK_EDITS_LOG"), file("GLISSON_SOAK_EDITS_REPORT"));
    let folder = tempfile::tempdir().unwrap();
    let bodies = bodies(folder.path());
    let n_seeds = edits.div_ceil(EDITS_OF_SEED).max(bodies.len() as u64);
    let asked = edits.div_ceil(n_seeds);
    let results = Mutex::new(Results::go_on(log, n_seeds, asked));
    // One seed alone, to look at what it broke.
    let only: Option<u64> = std::env::var("GLISSON_SOAK_EDITS_SEED").ok().map(|s| s.parse().unwrap());
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
                    let (name, mesh) = &bodies[(seed % bodies.len() as u64) as usize];
                    let result = run_seed(name, mesh, seed, asked);
                    let mut results = results.lock().unwrap();
                    results.add(result);
                    if let Some(file) = &report {
                        std::fs::write(file, results.report(n_seeds, asked, COMPARED_EVERY)).unwrap();
                    }
                }
            });
        }
    });
    let results = results.into_inner().unwrap();
    eprint!("{}", results.report(n_seeds, asked, COMPARED_EVERY));
    let all = results.all();
    let broken: Vec<_> = results.broken().map(|r| (r.seed, r.broken.clone())).collect();
    assert!(broken.is_empty(), "{broken:?}");
    if only.is_some() {
        return;
    }
    // What was asked for was done, and the long run saw every body.
    assert!(all.edits() >= edits, "{} of {edits} edits", all.edits());
    assert!(edits <= DEFAULT_EDITS || bodies.len() == 4, "{} bodies", bodies.len());
    let by_tools = [all.burns, all.snips, all.tool_blade_edits, all.tears];
    let happened = [all.removals, all.blade_edits, all.scalpel_edits, all.undone, all.held];
    let all_happened = happened.iter().chain(&by_tools).all(|&n| n > 0);
    assert!(all_happened, "{happened:?} {by_tools:?}");
}
