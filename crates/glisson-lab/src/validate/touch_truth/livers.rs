//! Every model, pressed on synthetic livers of every size: the meshes of one organ have to agree.
//!
//! A ball of 6 mm goes from the patient's front straight to the back, at places drawn at random where the front is no steeper than
//! 35 degrees and the organ is at least 40 mm thick. Depths count from each mesh's own skin. The back half of the organ is held.

use super::press::{Felt, Press, ReadyOrgan};
use super::selection::Selection;
use super::skin::{Skin, way_to_m};
use crate::bodies::{filled, liver_surface};
use anyhow::{Context, ensure};
use glisson::image::phantom::PhantomParams;
use glisson::material::tissues::Tissue;
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::surface::TriMesh;
use glisson::world::spec::Region;

/// Patients.
pub(super) const SEEDS: [u64; 3] = [51, 52, 53];
pub(super) const DEPTHS_M: [f64; 3] = [5e-3, 10e-3, 15e-3];
const BALL_M: f64 = 6e-3;
const N_PLACES: usize = 3;
/// From the patient's front to the back.
const INWARDS: DVec3 = DVec3::Y;
/// Places are drawn so far from the organ's middle, as a share of its half sizes. A choice.
const SPREAD: f64 = 0.45;
/// Cosine of the steepest slope of a touched place, and the least thickness behind it [m]. Choices.
const LEAST_COSINE: f64 = 0.82;
const LEAST_THICKNESS_M: f64 = 0.04;
/// Share of the organ's extent from front to back that is held, at the back. A choice: the tissue in front of it is 35 to 40 mm
/// thick. Held at a small patch (0.15) a liver rocks, and a border that is 4 mm elsewhere, as nodes of 2,000 tetrahedra have it, makes it
/// up to 1.4 times as stiff under a pressure over 25 mm: what meshes of one organ then show is their supports.
const HELD: f64 = 0.5;
const MOST_DRAWN: usize = 10_000;

/// One push.
#[derive(Clone, Copy, Debug)]
pub(super) struct Push {
    pub(super) model: &'static str,
    pub(super) seed: u64,
    pub(super) place: usize,
    /// As wanted: one of the sizes.
    pub(super) size: usize,
    pub(super) n_tets: usize,
    pub(super) depth_m: f64,
    pub(super) felt: Felt,
}

impl Push {
    pub(super) const HEAD: &str = "| model | patient | place | tetrahedra | depth [mm] | unrest | force [N] |\n|---|---|---|---|---|---|---|\n";

    pub(super) fn row(&self) -> String {
        format!(
            "| {} | {} | {} | {} | {:.3} | {:.1e} | {:.4} |\n",
            self.model,
            self.seed,
            self.place + 1,
            self.n_tets,
            self.felt.depth_m * 1e3,
            self.felt.unrest,
            self.felt.force_n
        )
    }
}

/// The first triangle that a way along [`INWARDS`] meets: where, and the cosine of its slope; and how far behind it the organ
/// ends.
fn entry(surface: &TriMesh, from_m: DVec3) -> Option<(DVec3, f64, f64)> {
    let mut entries: Vec<(f64, f64)> = Vec::new();
    let mut exits: Vec<f64> = Vec::new();
    for triangle in &surface.triangles {
        let [a, b, c] = triangle.map(|v| surface.positions_m[v as usize]);
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if let Some(way_m) = way_to_m([a, b, c], from_m, INWARDS) {
            entries.push((way_m, -normal.dot(INWARDS)));
        } else if let Some(way_m) = way_to_m([a, c, b], from_m, INWARDS) {
            exits.push(way_m);
        }
    }
    let &(way_m, cosine) = entries.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let end_m = exits.into_iter().filter(|end_m| *end_m > way_m).min_by(f64::total_cmp)?;
    Some((from_m + INWARDS * way_m, cosine, end_m - way_m))
}

/// Starts of the ways to the touched places, in front of the organ [m].
fn places_m(surface: &TriMesh, bounds_m: &Aabb, seed: u64) -> anyhow::Result<Vec<DVec3>> {
    let (middle_m, half_m) =
        (0.5 * (bounds_m.min_m + bounds_m.max_m), 0.5 * (bounds_m.max_m - bounds_m.min_m));
    let mut random = SeededRandom::new(seed);
    let mut found: Vec<DVec3> = Vec::new();
    for _ in 0..MOST_DRAWN {
        let [x, z] = [0, 1].map(|_| random.uniform_in(-SPREAD, SPREAD));
        let from_m = DVec3::new(middle_m.x + x * half_m.x, bounds_m.min_m.y - 0.1, middle_m.z + z * half_m.z);
        let fits = entry(surface, from_m)
            .is_some_and(|(_, cosine, thick_m)| cosine >= LEAST_COSINE && thick_m >= LEAST_THICKNESS_M);
        let is_apart = found.iter().all(|other| other.distance(from_m) > 4.0 * BALL_M);
        if fits && is_apart {
            found.push(from_m);
        }
        if found.len() == N_PLACES {
            return Ok(found);
        }
    }
    anyhow::bail!("patient {seed} has no {N_PLACES} places to press")
}

/// Presses on the livers of a selection; `tell` hears of each push as it is done.
pub(super) fn run(selection: &Selection, tell: &mut dyn FnMut(&Push)) -> anyhow::Result<Vec<Push>> {
    let subjects = selection.subjects()?;
    let material = Tissue::by_name("liver")?.linear_elastic()?;
    let mut pushes = Vec::new();
    for seed in SEEDS {
        let surface = liver_surface(&PhantomParams { seed, ..PhantomParams::default() })?;
        let bounds_m = Aabb::of_points(&surface.0.positions_m);
        let starts_m = places_m(&surface.0, &bounds_m, seed)?;
        let mut held_m = bounds_m;
        held_m.min_m.y = bounds_m.max_m.y - HELD * (bounds_m.max_m.y - bounds_m.min_m.y);
        let beyond_m = DVec3::splat(0.05);
        held_m.min_m -= DVec3::new(beyond_m.x, 0.0, beyond_m.z);
        held_m.max_m += beyond_m;
        for &size in selection.sizes() {
            let mesh = filled(&surface, size).with_context(|| format!("patient {seed} at {size}"))?;
            let skin = Skin::of(&mesh)?;
            for subject in subjects.iter().filter(|subject| selection.wants(subject, size)) {
                let organ = ReadyOrgan::new(&mesh, material, Region::Box(held_m), subject)
                    .with_context(|| format!("{} at {size}", subject.kind))?;
                for (place, start_m) in starts_m.iter().take(selection.n_places).enumerate() {
                    let skin_m = skin.first_m(*start_m, INWARDS).context("the mesh has no skin there")?;
                    let press = Press { skin_m, inwards: INWARDS, radius_m: BALL_M };
                    for (depth_m, felt) in DEPTHS_M.into_iter().zip(press.run(&organ, &DEPTHS_M)?) {
                        let n_tets = mesh.tetrahedra.len();
                        let model = subject.kind.name();
                        let push = Push { model, seed, place, size, n_tets, depth_m, felt };
                        tell(&push);
                        pushes.push(push);
                    }
                }
            }
        }
    }
    ensure!(!pushes.is_empty(), "nothing was pressed");
    Ok(pushes)
}

/// Of a model at a size: the push whose force is furthest from that on the finest mesh pressed by the model, and that ratio.
pub(super) fn worst_ratio(pushes: &[Push], model: &str, size: usize) -> Option<(Push, f64)> {
    let of_model = || pushes.iter().filter(|push| push.model == model);
    let finest = of_model().map(|push| push.size).max()?;
    let ratio = |push: &Push| {
        let same = |other: &&Push| {
            other.size == finest
                && (other.seed, other.place) == (push.seed, push.place)
                && other.depth_m.to_bits() == push.depth_m.to_bits()
        };
        of_model().find(same).map(|other| push.felt.force_n / other.felt.force_n)
    };
    let ratios = of_model().filter(|push| push.size == size).filter_map(|push| Some((*push, ratio(push)?)));
    ratios.max_by(|a, b| (a.1 - 1.0).abs().total_cmp(&(b.1 - 1.0).abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_push_is_found_against_the_finest_mesh() {
        let push = |size: usize, place: usize, force_n: f64| Push {
            model: "implicit",
            seed: 51,
            place,
            size,
            n_tets: size,
            depth_m: DEPTHS_M[0],
            felt: Felt { depth_m: DEPTHS_M[0], force_n, unrest: 0.0 },
        };
        let pushes = [push(100, 0, 1.1), push(100, 1, 1.6), push(900, 0, 1.0), push(900, 1, 2.0)];
        let (worst, ratio) = worst_ratio(&pushes, "implicit", 100).unwrap();
        assert!(worst.place == 1 && (ratio - 0.8).abs() < 1e-15);
        assert!(worst_ratio(&pushes, "explicit", 100).is_none());
    }
}
