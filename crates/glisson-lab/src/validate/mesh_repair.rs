//! Shape of tetrahedra, repair by collapse and by remeshing, and cuts by vertex displacement (seed `000` s. 4.4.2).

use super::{Claim, Experiment, Figure, Outcome, check_all, series};
use crate::bodies::liver;
use anyhow::Context;
use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::{box_of_five, irregular_cube};
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::quality::{Criterion, TetMeasures, radius_ratio};
use glisson::mesh::repair::{
    CollapseParams, Freedom, MoveLimits, RemeshParams, collapse, freedom, remesh, short_surface_edges, slide,
    tets_below,
};
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetMesh};
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use glisson_report::plot::{LinePlot, SeriesStyle};

const SEED: &str = "Chendeb 2007, NNT 2007ENMP1614, s. 4.4.2";
const FIGURE: &str = "Chendeb 2007, NNT 2007ENMP1614, fig. 4.21: remeshing disperses less";
const OWN: &str = "requirement";
/// Cubes that are cut and mended; the seed has one (353 tetrahedra).
const N_CUBES: u64 = 10;
const SIDE_M: f64 = 0.05;
/// Share of the longest edge below which edges are pulled together, and ratio below which is remeshed: so that both
/// have about as much to do.
const SHORT_EDGE: f64 = 0.4;
const REMESH_BELOW: f64 = 0.4;
/// Straight cuts through a box and a liver.
const N_CUTS: u64 = 12;
const LIVER_TETS: usize = 3_000;

fn carry_out(body: &mut EditableMesh, edits: &[MeshEdit]) -> anyhow::Result<()> {
    edits.iter().try_for_each(|edit| body.apply(edit).map(drop).context("an edit was refused"))
}

/// A blade from one tip to the other, cutting what it meets of a body at rest.
fn cut(
    body: &mut EditableMesh,
    tips_m: [DVec3; 2],
    up_m: DVec3,
    limits: MoveLimits,
) -> anyhow::Result<ScalpelCut> {
    const N_STEPS: usize = 60;
    let mut cut = ScalpelCut::new(ScalpelParams { limits });
    for k in 0..=N_STEPS {
        let tip_m = tips_m[0].lerp(tips_m[1], k as f64 / N_STEPS as f64);
        while let Some(edits) = cut.advance(body, &body.mesh().positions_m, [tip_m, tip_m + up_m])? {
            carry_out(body, &edits)?;
        }
    }
    while let Some(edits) = cut.finish(body, &body.mesh().positions_m)? {
        carry_out(body, &edits)?;
    }
    Ok(cut)
}

/// Radius ratio and volume over the mean volume of each tetrahedron.
fn shapes(body: &EditableMesh) -> Vec<[f64; 2]> {
    let mean_m3 = body.volume_m3() / body.topology().live_counts().tets as f64;
    let shape = |t| [radius_ratio(body.mesh().corners_m(t)), body.mesh().tet_volume_m3(t) / mean_m3];
    body.topology().live_tets().map(shape).collect()
}

/// Standard deviation of one of the two numbers.
fn spread(shapes: &[[f64; 2]], which: usize) -> f64 {
    let n = shapes.len() as f64;
    let mean = shapes.iter().map(|s| s[which]).sum::<f64>() / n;
    (shapes.iter().map(|s| (s[which] - mean).powi(2)).sum::<f64>() / n).sqrt()
}

fn worst(shapes: &[[f64; 2]]) -> f64 {
    shapes.iter().fold(1.0, |least: f64, s| least.min(s[0]))
}

fn flattened(mut body: EditableMesh) -> anyhow::Result<(EditableMesh, usize)> {
    let params =
        CollapseParams { short_edge: SHORT_EDGE, min_radius_ratio: 0.01, ..CollapseParams::default() };
    let mut n_done = 0;
    loop {
        let edges = short_surface_edges(&body, &params);
        let Some(edit) = edges.into_iter().find_map(|edge| {
            let edit = collapse(&body, edge, &params).ok()?;
            body.clone().apply(&edit).is_ok().then_some(edit)
        }) else {
            return Ok((body, n_done));
        };
        carry_out(&mut body, &[edit])?;
        n_done += 1;
    }
}

/// Rounds of mending: what one place leaves may be mended when its neighbours are.
const N_ROUNDS: usize = 4;

/// Below this radius ratio a tetrahedron counts as left bad.
const LEFT_BAD: f64 = 0.05;

/// What mending did.
#[derive(Default)]
struct Mended {
    n_remeshed: usize,
    /// Corners that slid along the surface where remeshing did not help.
    n_slid: usize,
    /// Tetrahedra below [`LEFT_BAD`] before and after, and how many of the latter have all corners on the surface.
    n_bad_before: usize,
    n_bad_after: usize,
    n_between_surfaces: usize,
    /// Of these, how many have only corners that may not move: on corners and pinched edges of the surface.
    n_fixed: usize,
}

fn remeshed(mut body: EditableMesh, mended: &mut Mended) -> anyhow::Result<EditableMesh> {
    let params = RemeshParams { wanted_radius_ratio: REMESH_BELOW, ..RemeshParams::default() };
    let limits = MoveLimits { min_radius_ratio: 1e-3, ..MoveLimits::default() };
    mended.n_bad_before += tets_below(&body, LEFT_BAD).len();
    for _ in 0..N_ROUNDS {
        for tet in tets_below(&body, REMESH_BELOW) {
            if !body.topology().is_live_tet(tet) {
                continue;
            }
            if let Some(repair) = remesh(&body, &[tet], &params) {
                carry_out(&mut body, &repair.edits)?;
                mended.n_remeshed += 1;
            } else if let Some(edit) = slide(&body, tet, &limits)
                && body.apply(&edit).is_ok()
            {
                mended.n_slid += 1;
            }
        }
    }
    let left = tets_below(&body, LEFT_BAD);
    mended.n_bad_after += left.len();
    for tet in left {
        let corners = body.topology().tet_nodes(tet);
        let is_on_surface = |n: &NodeId| body.topology().is_surface_node(*n);
        mended.n_between_surfaces += usize::from(corners.iter().all(is_on_surface));
        let is_fixed = |n: &NodeId| freedom(&body, *n, limits.sharp_cosine) == Freedom::Fixed;
        mended.n_fixed += usize::from(corners.iter().all(is_fixed));
    }
    Ok(body)
}

/// The same cuts mended in both ways.
#[derive(Default)]
struct Mending {
    /// Of all tetrahedra of all cubes.
    as_cut: Vec<[f64; 2]>,
    flat: Vec<[f64; 2]>,
    anew: Vec<[f64; 2]>,
    n_flattened: usize,
    remeshing: Mended,
    /// Largest relative changes of a cube's volume.
    lost_flat: f64,
    lost_anew: f64,
}

impl Mending {
    /// A cube is cut and mended.
    fn add(&mut self, seed: u64) -> anyhow::Result<()> {
        let mut body = EditableMesh::new(irregular_cube(SIDE_M, seed))?;
        let mut random = SeededRandom::new(seed);
        let [from, to] = [-0.4, 1.4].map(|y| SIDE_M * DVec3::new(random.uniform_in(0.2, 0.8), y, 0.6));
        // Hardly watched, so that there is something to mend.
        let limits = MoveLimits { min_radius_ratio: 1e-3, ..MoveLimits::default() };
        cut(&mut body, [from, to], 0.1 * DVec3::Z, limits)?;
        self.as_cut.extend(shapes(&body));
        let volume_m3 = body.volume_m3();
        let (mended, n) = flattened(body.clone())?;
        self.n_flattened += n;
        self.lost_flat = self.lost_flat.max((mended.volume_m3() / volume_m3 - 1.0).abs());
        self.flat.extend(shapes(&mended));
        let mended = remeshed(body, &mut self.remeshing)?;
        self.lost_anew = self.lost_anew.max((mended.volume_m3() / volume_m3 - 1.0).abs());
        self.anew.extend(shapes(&mended));
        Ok(())
    }

    /// Of one of the two numbers.
    fn spread_share(&self, which: usize) -> f64 {
        spread(&self.anew, which) / spread(&self.flat, which)
    }

    fn notes(&self) -> String {
        let mut notes = format!(
            "Repair: {N_CUBES} irregular cubes of 400 tetrahedra are cut by vertex displacement; {} short surface edges \
             pulled together against {} places remeshed and {} corners slid along the surface where that did not help. Of {} \
             tetrahedra with an RRS below {LEFT_BAD} {} are left: {} have all corners on the surface, between outer triangles that \
             remeshing keeps, {} of them corners that may not move.\n\n| | worst RRS | spread of RRS | spread of volume over its mean \
             | tetrahedra |\n|---|---|---|---|---|\n",
            self.n_flattened,
            self.remeshing.n_remeshed,
            self.remeshing.n_slid,
            self.remeshing.n_bad_before,
            self.remeshing.n_bad_after,
            self.remeshing.n_between_surfaces,
            self.remeshing.n_fixed,
        );
        for (name, shapes) in [("cut", &self.as_cut), ("flattened", &self.flat), ("remeshed", &self.anew)] {
            notes += &format!(
                "| {name} | {:.3} | {:.3} | {:.3} | {} |\n",
                worst(shapes),
                spread(shapes, 0),
                spread(shapes, 1),
                shapes.len()
            );
        }
        notes
    }

    fn figure(&self) -> Figure {
        let points = |shapes: &[[f64; 2]]| shapes.iter().map(|&[ratio, volume]| [volume, ratio]).collect();
        Figure {
            file: "mesh_repair_scatter.svg",
            caption: "RRS against volume of each tetrahedron of the cut cubes, mended by collapse of short surface edges \
                      and by local remeshing (fig. 4.21 of seed 000)."
                .into(),
            plot: LinePlot {
                title: "Two ways of mending a cut mesh".into(),
                x_label: "volume over the mean volume".into(),
                y_label: "RRS".into(),
                series: vec![
                    series("flattened", points(&self.flat), SeriesStyle::Points),
                    series("remeshed", points(&self.anew), SeriesStyle::Points),
                ],
                size: [720, 480],
            },
        }
    }
}

const MENDED: &[Claim<'_, Mending>] = &[
    Claim::within("Spread of RRS, remeshed over flattened", FIGURE, |m| m.spread_share(0), [0.0, 1.0]),
    Claim::within("Spread of volumes, remeshed over flattened", FIGURE, |m| m.spread_share(1), [0.0, 1.0]),
    Claim::within(
        "Worst RRS, remeshed over cut",
        OWN,
        |m| worst(&m.anew) / worst(&m.as_cut),
        [1.0, f64::INFINITY],
    ),
    Claim::within(
        "Tetrahedra with an RRS below 0.05, remeshed over cut: no more than before (why they stay: below)",
        OWN,
        |m| m.remeshing.n_bad_after as f64 / m.remeshing.n_bad_before.max(1) as f64,
        [0.0, 1.0],
    ),
    Claim::at_most("Change of volume by remeshing, relative", OWN, |m| m.lost_anew, 1e-9),
    // One node's place cannot keep the volume under an uneven surface.
    Claim::at_most("Change of volume by collapse, relative", OWN, |m| m.lost_flat, 1e-3),
];

/// Fig. 4.21 anew.
fn repair(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mut mending = Mending::default();
    for seed in 0..N_CUBES {
        mending.add(seed)?;
    }
    outcome.experiments.extend(check_all(MENDED, &mending));
    outcome.notes += &mending.notes();
    outcome.figures.push(mending.figure());
    Ok(())
}

/// Straight cuts from outside to outside, with a blade longer than the body is thick: how many part it, the largest
/// relative change of volume, and the worst radius ratio.
fn straight_cuts(mesh: &TetMesh) -> anyhow::Result<(usize, f64, f64)> {
    let [low_m, high_m] =
        mesh.positions_m.iter().fold([DVec3::MAX, DVec3::MIN], |[low, high], &p| [low.min(p), high.max(p)]);
    let size_m = (high_m - low_m).length();
    let (mut n_parted, mut change, mut least) = (0, 0.0f64, 1.0f64);
    for seed in 0..N_CUTS {
        let mut random = SeededRandom::new(seed);
        let (y, x) = (std::f64::consts::TAU * random.uniform()).sin_cos();
        let shift = DVec3::new(random.uniform() - 0.5, random.uniform() - 0.5, 0.0);
        let mut middle_m = 0.5 * (low_m + high_m) + 0.1 * size_m * shift;
        middle_m.z = low_m.z - 0.1 * size_m;
        let way_m = size_m * DVec3::new(x, y, 0.0);
        let mut body = EditableMesh::new(mesh.clone())?;
        let before_m3 = body.volume_m3();
        cut(&mut body, [middle_m - way_m, middle_m + way_m], 2.0 * size_m * DVec3::Z, MoveLimits::default())?;
        n_parted += usize::from(body.topology().pieces(Through::Faces).count() > 1);
        change = change.max((body.volume_m3() / before_m3 - 1.0).abs());
        least = least.min(worst(&shapes(&body)));
    }
    Ok((n_parted, change, least))
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let regular = [(1., 1., 1.), (1., -1., -1.), (-1., -1., 1.), (-1., 1., -1.)];
    let measures = TetMeasures::of(regular.map(|(x, y, z)| DVec3::new(x, y, z)));
    let off = Criterion::ALL.map(|c| (c.of(&measures) - 1.0).abs()).into_iter().fold(0.0, f64::max);
    outcome.experiments.push(Experiment::at_most(
        "Five criteria of the regular tetrahedron, largest distance from 1",
        SEED,
        off,
        1e-12,
    ));
    repair(&mut outcome)?;
    let slab = box_of_five([8, 6, 3], DVec3::new(0.08, 0.06, 0.03));
    for (name, mesh, least) in [("box", slab, N_CUTS), ("liver", liver(LIVER_TETS)?, N_CUTS - 2)] {
        let (n_parted, change, worst) = straight_cuts(&mesh)?;
        outcome.experiments.extend([
            Experiment::within(
                &format!("Straight cuts by vertex displacement that part a {name}, of {N_CUTS}"),
                SEED,
                n_parted as f64,
                [least as f64, N_CUTS as f64],
            ),
            Experiment::at_most(
                &format!("Change of the {name}'s volume by a cut, relative"),
                OWN,
                change,
                1e-9,
            ),
            Experiment::within(
                &format!("Worst RRS of a cut {name}"),
                OWN,
                worst,
                [MoveLimits::default().min_radius_ratio, 1.0],
            ),
        ]);
    }
    Ok(outcome)
}
