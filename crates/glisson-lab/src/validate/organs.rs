//! Several organs in one mesh: interfaces, volumes, angles, small organs, and how the time grows with the number of tetrahedra.

use super::{Experiment, Figure, Outcome, series};
use crate::bench::thread_cpu_ns;
use glisson::image::phantom::{PhantomParams, Tissue, generate};
use glisson::image::{LabelMap, phantom::Phantom};
use glisson::mesh::NodeId;
use glisson::mesh::organs::{
    Grading, MIN_ORGAN_DIHEDRAL_DEG, ORGAN_VOLUME_TOLERANCE, OrganMesh, OrganMeshParams, OrganSize,
    mesh_organs,
};
use glisson::mesh::quality::SurfaceShape;
use glisson_report::plot::{LinePlot, SeriesStyle};
use std::collections::BTreeSet;

const OWN: &str = "requirement: multi-organ phantom";

/// Organs that the border of the image does not cut off.
const ORGANS: [Tissue; 6] = [
    Tissue::Liver,
    Tissue::LiverTumour,
    Tissue::PortalVein,
    Tissue::HepaticVein,
    Tissue::GallBladder,
    Tissue::KidneyRight,
];

/// Sizes whose times are compared [tetrahedra].
const SIZES: [usize; 4] = [20_000, 63_000, 200_000, 1_000_000];

/// The size at which shapes are looked at.
const LOOKED_AT: usize = 200_000;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let Phantom { labels: map, .. } = generate(&PhantomParams::default());
    // One thread: its processor time is all there is.
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut times = Vec::new();
    let mut shown = None;
    for size in SIZES {
        let begun_ns = thread_cpu_of(&alone);
        let organs = alone.install(|| meshed(&map, size, Grading::default()))?;
        let seconds = 1e-9 * (thread_cpu_of(&alone) - begun_ns) as f64;
        times.push([organs.report.n_tets as f64, seconds]);
        if size == LOOKED_AT {
            shown = Some((organs, seconds));
        }
    }
    let (organs, seconds) = shown.expect("one of the sizes is looked at");
    let mut experiments = shape_experiments(&organs);
    experiments.push(
        Experiment::within("200,000 tetrahedra: processor time [s]", OWN, seconds, [0.0, 60.0]).of_times(),
    );
    let growth = (times[3][1] / times[2][1]).ln() / (times[3][0] / times[2][0]).ln();
    let name = "from 200,000 to 1,000,000 tetrahedra: the time grows with this power of their number";
    experiments.push(Experiment::within(name, OWN, growth, [0.0, 1.1]).of_times());
    experiments.extend(small_organ_experiments(&map)?);
    Ok(Outcome { experiments, figures: vec![growth_figure(&times)], ..Outcome::default() })
}

fn thread_cpu_of(pool: &rayon::ThreadPool) -> u64 {
    pool.install(thread_cpu_ns)
}

fn meshed(map: &LabelMap, n_tets: usize, grading: Grading) -> anyhow::Result<OrganMesh> {
    let labels = ORGANS.map(Tissue::label).to_vec();
    Ok(mesh_organs(map, &OrganMeshParams { labels, size: OrganSize::Tetrahedra(n_tets), grading })?)
}

/// Faces of an interface over the mesh's nodes, each from its lowest node on.
fn faces(organs: &OrganMesh, label: u16, other: u16) -> BTreeSet<[NodeId; 3]> {
    let interface = organs.interface(label, other);
    let turned = |triangle: &[u32; 3]| {
        let mut nodes = triangle.map(|vertex| interface.nodes[vertex as usize]);
        let lowest = (0..3).min_by_key(|&at| nodes[at]).unwrap_or(0);
        nodes.rotate_left(lowest);
        nodes
    };
    interface.surface.triangles.iter().map(turned).collect()
}

fn shape_experiments(organs: &OrganMesh) -> Vec<Experiment> {
    let pairs = organs.neighbours();
    let inner = pairs.iter().filter(|[low, _]| *low != 0);
    let n_one_sided: usize = inner
        .clone()
        .map(|&[low, high]| {
            let here = faces(organs, low, high);
            let there: BTreeSet<_> =
                faces(organs, high, low).into_iter().map(|[a, b, c]| [a, c, b]).collect();
            here.symmetric_difference(&there).count()
        })
        .sum();
    let n_open = organs
        .labels()
        .into_iter()
        .filter(|&label| {
            let surface = organs.surface_of(label).surface;
            !SurfaceShape::of(surface.positions_m.len(), &surface.triangles).is_closed_manifold()
        })
        .count();
    let worst = organs.report.labels.iter().map(|organ| organ.volume_error().abs()).fold(0.0, f64::max);
    vec![
        Experiment::within("interfaces of organs that touch", OWN, inner.count() as f64, [5.0, 15.0]),
        Experiment::at_most("faces of interfaces that one side alone has", OWN, n_one_sided as f64, 0.0),
        Experiment::at_most("organs whose surface is no closed manifold", OWN, n_open as f64, 0.0),
        Experiment::at_most(
            "largest error of an organ's volume, relative",
            OWN,
            worst,
            ORGAN_VOLUME_TOLERANCE,
        ),
        Experiment::within(
            "smallest dihedral angle [degrees]",
            OWN,
            organs.report.min_dihedral_deg,
            [MIN_ORGAN_DIHEDRAL_DEG, 70.6],
        ),
    ]
}

/// A tumour of 4 ml in a liver of 6,300 tetrahedra.
fn small_organ_experiments(map: &LabelMap) -> anyhow::Result<[Experiment; 3]> {
    let labels = [Tissue::Liver, Tissue::LiverTumour, Tissue::GallBladder].map(Tissue::label).to_vec();
    let of_tumour = |least_tetrahedra: usize| -> anyhow::Result<(f64, f64)> {
        let grading = Grading { least_tetrahedra, ..Grading::default() };
        let size = OrganSize::Tetrahedra(6_300);
        let organs = mesh_organs(map, &OrganMeshParams { labels: labels.clone(), size, grading })?;
        let tumour = organs.report.labels.iter().find(|organ| organ.label == Tissue::LiverTumour.label());
        let error = tumour.map_or(1.0, |organ| organ.volume_error().abs());
        Ok((error, organs.report.n_tets as f64))
    };
    let ((even, _), (graded, n_tets)) = (of_tumour(0)?, of_tumour(300)?);
    Ok([
        Experiment::within("tumour in 6,300 even tetrahedra: error of its volume", OWN, even, [0.1, 1.0]),
        Experiment::at_most(
            "the same with 300 tetrahedra for each organ at least",
            OWN,
            graded,
            ORGAN_VOLUME_TOLERANCE,
        ),
        Experiment::near("tetrahedra of that mesh", OWN, n_tets, 6_300.0, 0.05),
    ])
}

fn growth_figure(times: &[[f64; 2]]) -> Figure {
    let log = |[n, seconds]: [f64; 2]| [n.log10(), seconds.log10()];
    let [last_n, last_s] = times[times.len() - 1];
    let linear: Vec<[f64; 2]> = times.iter().map(|&[n, _]| log([n, last_s * n / last_n])).collect();
    let plot = LinePlot {
        title: "Filling six organs with tetrahedra".into(),
        x_label: "tetrahedra, log10".into(),
        y_label: "processor time [s], log10".into(),
        series: vec![
            series("measured", times.iter().copied().map(log).collect(), SeriesStyle::Points),
            series("proportional", linear, SeriesStyle::Dashed),
        ],
        size: [720, 440],
    };
    let caption =
        "Processor time of one mesh of six organs of the phantom against its tetrahedra.".to_owned();
    Figure { file: "organs_time.svg", caption, plot }
}
