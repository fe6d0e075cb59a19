//! Cutting the pre-computed liver: the compliance after removals against fresh pre-computations, and hinges.
//!
//! Seeds `001` and `003` (s. 1) call cutting of the pre-computed model impossible in real time.

use super::{Claim, Experiment, Figure, Outcome, check_all, series};
use crate::bench::thread_cpu_ns;
use crate::bodies::{liver, material, nodes_where};
use glisson::math::{DMat3, DVec3};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::DeformableModel;
use glisson::model::precomputed::{CutReport, Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson_report::plot::{LinePlot, SeriesStyle};

const SEED: &str = "Checoury 2002, s. 1: the pre-computed model cannot be cut";
const OWN: &str = "requirement";
const LIVER_TETS: usize = 6_342;
/// Removals after which the compliance is compared.
const COMPARED_AFTER: [usize; 4] = [1, 10, 40, 100];
/// Share of the liver's width that is held, from the left.
const HELD_SHARE: f64 = 0.15;

fn built(mesh: &TetMesh, fixed_nodes: &[NodeId]) -> anyhow::Result<Precomputed> {
    Ok(Precomputed::build(&PrecomputedParams {
        mesh,
        material: &material()?,
        fixed_nodes,
        stored: StoredNodes::Surface,
        precision: Precision::F64,
        progress: None,
    })?)
}

/// Largest difference of the compliance from that of the live part of the mesh, over the largest entry.
fn difference(model: &Precomputed, body: &EditableMesh) -> anyhow::Result<f64> {
    let topology = body.topology();
    let part = TetMesh {
        positions_m: body.mesh().positions_m.clone(),
        tetrahedra: topology.live_tets().map(|t| topology.tet_nodes(t)).collect(),
        ..TetMesh::default()
    };
    let is_held = |n: &NodeId| model.fixed_nodes().contains(n) || !topology.is_live_node(*n);
    let held: Vec<NodeId> = (0..part.positions_m.len()).map(NodeId::from_index).filter(is_held).collect();
    let fresh = built(&part, &held)?;
    let size = |m: DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
    let (mut largest, mut off) = (0.0_f64, 0.0_f64);
    for &l in fresh.loadable_nodes() {
        for &m in fresh.loadable_nodes() {
            let expected = fresh.compliance_m_per_n(l, m).unwrap_or(DMat3::ZERO);
            // A tensor that is missing is as wrong as can be.
            let found = model.compliance_m_per_n(l, m).unwrap_or(expected + DMat3::IDENTITY);
            largest = largest.max(size(expected));
            off = off.max(size(found - expected));
        }
    }
    Ok(off / largest)
}

/// A plane cut from the surface inwards: tetrahedra in order, from the top of the middle of the liver.
fn incision(mesh: &TetMesh) -> Vec<TetId> {
    let n = mesh.positions_m.len() as f64;
    let middle_m = mesh.positions_m.iter().sum::<DVec3>() / n;
    let side = |p: &DVec3| p.x - middle_m.x;
    let height = |t: &TetId| mesh.corners_m(*t).iter().map(|p| p.z).sum::<f64>();
    let mut tets: Vec<TetId> = (0..mesh.tetrahedra.len())
        .map(TetId::from_index)
        .filter(|t| {
            let corners_m = mesh.corners_m(*t);
            corners_m.iter().any(|p| side(p) < 0.0) && corners_m.iter().any(|p| side(p) >= 0.0)
        })
        .collect();
    tets.sort_by(|a, b| height(b).total_cmp(&height(a)));
    tets
}

/// What came of the removals, one after the other.
struct Course {
    n_surface: usize,
    /// Over the number of removals: processor time [ms], running estimate of the error.
    times_ms: Vec<[f64; 2]>,
    estimates: Vec<[f64; 2]>,
    /// Over some of these numbers: difference from a fresh pre-computation.
    errors: Vec<[f64; 2]>,
    report: CutReport,
}

impl Course {
    fn new(mesh: &TetMesh) -> anyhow::Result<Self> {
        let (low, high) =
            mesh.positions_m.iter().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p.x), b.max(p.x)));
        let fixed = nodes_where(mesh, |p| p.x < low + HELD_SHARE * (high - low));
        let mut model = built(mesh, &fixed)?;
        model.prepare_cutting(mesh)?;
        let n_surface = model.loadable_nodes().len();
        let mut body = EditableMesh::new(mesh.clone())?;
        let (mut times_ms, mut errors, mut estimates) = (Vec::new(), Vec::new(), Vec::new());
        for (i, tet) in incision(mesh).into_iter().take(COMPARED_AFTER[3]).enumerate() {
            let change = body.apply(&MeshEdit::Remove { tets: vec![tet] })?;
            let before = thread_cpu_ns();
            model.topology_changed(body.mesh(), &change)?;
            times_ms.push([(i + 1) as f64, (thread_cpu_ns() - before) as f64 * 1e-6]);
            estimates.push([(i + 1) as f64, model.cut_report().error]);
            if COMPARED_AFTER.contains(&(i + 1)) {
                errors.push([(i + 1) as f64, difference(&model, &body)?]);
            }
        }
        Ok(Self { n_surface, times_ms, estimates, errors, report: model.cut_report() })
    }

    fn notes(&self, mesh: &TetMesh) -> String {
        let mut sorted: Vec<f64> = self.times_ms.iter().map(|t| t[1]).collect();
        sorted.sort_by(f64::total_cmp);
        format!(
            "Cutting the liver of {} tetrahedra and {} loadable surface nodes: median {:.1} ms of \
             processor time a removal, longest {:.1} ms; {} nodes were laid bare; least pivot of a capacitance matrix \
             {:.1e}.\n\n| removals | difference from fresh | estimate |\n|---|---|---|\n{}",
            mesh.tetrahedra.len(),
            self.n_surface,
            sorted[sorted.len() / 2],
            sorted[sorted.len() - 1],
            self.report.n_laid_bare,
            self.report.least_pivot,
            self.errors
                .iter()
                .map(|[n, e]| format!("| {n} | {e:.1e} | {:.1e} |\n", self.estimates[*n as usize - 1][1]))
                .collect::<String>(),
        )
    }

    fn error_figure(&self) -> Figure {
        let digits = |points: &[[f64; 2]]| points.iter().map(|[n, e]| [*n, e.max(1e-18).log10()]).collect();
        Figure {
            file: "precomputed_cutting_error.svg",
            caption: "Error of the compliance of a cut liver, relative to its largest entry, over removals."
                .into(),
            plot: LinePlot {
                title: "Cutting the pre-computed liver".into(),
                x_label: "removed tetrahedra".into(),
                y_label: "log10 of the error".into(),
                series: vec![
                    series("running estimate", digits(&self.estimates), SeriesStyle::Line),
                    series("against fresh pre-computations", digits(&self.errors), SeriesStyle::Points),
                ],
                size: [720, 400],
            },
        }
    }

    fn time_figure(&self) -> Figure {
        Figure {
            file: "precomputed_cutting_time.svg",
            caption: "Processor time of each removal.".into(),
            plot: LinePlot {
                title: "Time of a removal".into(),
                x_label: "removed tetrahedra".into(),
                y_label: "processor time [ms]".into(),
                series: vec![series("", self.times_ms.clone(), SeriesStyle::Line)],
                size: [720, 400],
            },
        }
    }
}

const CLAIMS: &[Claim<'_, Course>] = &[
    Claim::at_most(
        "liver, 100 removals in a row: compliance against fresh pre-computations, of the largest entry",
        SEED,
        |c| c.errors.iter().map(|e| e[1]).fold(0.0, f64::max),
        1e-8,
    ),
    Claim::at_most("the same: running estimate of the error", OWN, |c| c.report.error, 1e-8),
];

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mesh = liver(LIVER_TETS)?;
    let course = Course::new(&mesh)?;
    let mut experiments = check_all(CLAIMS, &course);
    experiments.extend(hinges()?);
    Ok(Outcome {
        experiments,
        figures: vec![course.error_figure(), course.time_figure()],
        notes: course.notes(&mesh),
    })
}

/// Two blocks that hang together by a vertex or by an edge: what counts as loose once the rest between them is gone.
fn hinges() -> anyhow::Result<Vec<Experiment>> {
    let cells = [1, 1, 3];
    let mesh = box_of_five(cells, DVec3::new(0.01, 0.01, 0.03));
    let fixed = nodes_where(&mesh, |p| p.z < 1e-9);
    let layer =
        |t: usize| (mesh.corners_m(TetId::from_index(t)).iter().map(|p| p.z).sum::<f64>() / 0.04) as usize;
    let n_tets = mesh.tetrahedra.len();
    let n_top = (0..n_tets).filter(|&t| layer(t) == 2).count();
    let at = |t: usize, z_m: f64| {
        mesh.corners_m(TetId::from_index(t)).iter().filter(|p| (p.z - z_m).abs() < 1e-6).count()
    };
    let mut experiments = Vec::new();
    // A tetrahedron of the middle that shares a face with the lower block and a vertex with the upper one; one that
    // shares an edge with each.
    for (name, below, above, n_loose) in [("one vertex", 3, 1, n_top), ("one edge", 2, 2, n_top + 1)] {
        let Some(kept) = (0..n_tets).find(|&t| layer(t) == 1 && at(t, 0.01) == below && at(t, 0.02) == above)
        else {
            // The middle one of five has an edge with each side only.
            anyhow::bail!("no tetrahedron of the middle has {below} nodes below and {above} above");
        };
        let mut model = built(&mesh, &fixed)?;
        let mut body = EditableMesh::new(mesh.clone())?;
        let tets = (0..n_tets).filter(|&t| layer(t) == 1 && t != kept).map(TetId::from_index).collect();
        let change = body.apply(&MeshEdit::Remove { tets })?;
        model.topology_changed(body.mesh(), &change)?;
        let found = model.cut_report().n_loose as f64;
        let name = format!("tetrahedra recognised as loose: a block held by {name}");
        experiments.push(Experiment::near(&name, OWN, found, n_loose as f64, 0.0));
    }
    Ok(experiments)
}
