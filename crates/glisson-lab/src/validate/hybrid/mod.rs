//! The hybrid model of seed `003` ch. 5: convergence of zones that exchange forces, what it costs, and how it stands
//! to tensor-mass.
//!
//! The bar has the report's 192 nodes as a grid of 16 x 3 x 4 (the report's counts of edges and tetrahedra fit no
//! mesh, see Euler); one end is fixed, one node of the other is loaded or moved. Load, material and loaded node are
//! not given there: the solution's largest displacement is one edge here, and errors are over the edge.

mod convergence;
mod dynamic;
mod seconds;
mod tables;
mod variants;

use super::{Figure, Outcome};
use crate::bench::thread_cpu_ns;
use crate::bodies::{constraints, linear_equilibrium, liver, nodes_where};
use glisson::material::LinearElastic;
use glisson::math::DVec3;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::zones::Zones;
use glisson::mesh::{NodeId, TetMesh};
use glisson::model::hybrid::exchange::{ExchangeParams, HybridExchange, ZoneLaw};
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement};
use glisson::solve::{BoundaryConditions, MeshEdges};
use glisson_report::plot::{LinePlot, Series};

const SEED: &str = "Checoury 2002 (seed 003), s. 5.1";
const FORMULAS: &str = "Checoury 2002 (seed 003), s. 4.4";
const OWN: &str = "own direct solution";
const CELLS: [usize; 3] = [15, 2, 3];
const EDGE_M: f64 = 0.01;
/// A choice: relations between sweeps do not depend on Young's modulus.
const YOUNG_MODULUS_PA: f64 = 1e4;
const POISSON_RATIO: f64 = 0.45;
const DENSITY_KG_PER_M3: f64 = 1_000.0;
/// Cells along the bar of each zone, from the loaded end; the first zone has half of the nodes, as in table 5.1.
const ZONE_CELLS: [&[usize]; 4] = [&[7, 8], &[7, 4, 4], &[7, 3, 3, 2], &[7, 2, 2, 2, 2]];
const N_FORCE_SWEEPS: usize = 1_000;
const N_DISPLACEMENT_SWEEPS: usize = 200;
const STEP_S: f64 = 1e-3;

/// A held body with a load and its direct solution.
struct Case {
    mesh: TetMesh,
    material: LinearElastic,
    fixed: Vec<NodeId>,
    load: Constraints,
    solution_m: Vec<DVec3>,
    edge_m: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Load {
    Force,
    Displacement,
}

impl Load {
    fn name(self) -> &'static str {
        match self {
            Self::Force => "force",
            Self::Displacement => "displacement",
        }
    }

    fn n_sweeps(self) -> usize {
        match self {
            Self::Force => N_FORCE_SWEEPS,
            Self::Displacement => N_DISPLACEMENT_SWEEPS,
        }
    }
}

fn own_material() -> anyhow::Result<LinearElastic> {
    Ok(LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?)
}

impl Case {
    fn new(mesh: TetMesh, fixed: Vec<NodeId>, node: NodeId, load: Load, edge_m: f64) -> anyhow::Result<Self> {
        let material = own_material()?;
        let mut nodal_force_n = vec![DVec3::ZERO; mesh.positions_m.len()];
        nodal_force_n[node.index()] = DVec3::Z;
        let conditions = BoundaryConditions::fixed(&fixed);
        let per_newton_m = linear_equilibrium(&mesh, &material, &conditions, &nodal_force_n)?;
        let largest_m = per_newton_m.iter().map(|u| u.length()).fold(0.0, f64::max);
        match load {
            Load::Force => {
                let scale = edge_m / largest_m;
                nodal_force_n[node.index()] *= scale;
                let solution_m = per_newton_m.iter().map(|u| *u * scale).collect();
                let load = constraints(&nodal_force_n, &[]);
                Ok(Self { mesh, material, fixed, load, solution_m, edge_m })
            }
            Load::Displacement => {
                let displacement_m = DVec3::Z * edge_m;
                let mut conditions = conditions;
                conditions.impose_node(node, displacement_m);
                nodal_force_n.fill(DVec3::ZERO);
                let solution_m = linear_equilibrium(&mesh, &material, &conditions, &nodal_force_n)?;
                let load = constraints(&[], &[ImposedDisplacement { node, displacement_m }]);
                Ok(Self { mesh, material, fixed, load, solution_m, edge_m })
            }
        }
    }

    fn bar(load: Load) -> anyhow::Result<Self> {
        let size_m = DVec3::from_array(CELLS.map(|n| n as f64)) * EDGE_M;
        let mesh = box_of_five(CELLS, size_m);
        let fixed = nodes_where(&mesh, |p| p.x > size_m.x - 1e-9);
        // In the middle of an edge of the free end.
        let node = nodes_where(&mesh, |p| p.x < 1e-9 && (p.y - EDGE_M).abs() < 1e-9 && p.z < 1e-9)[0];
        Self::new(mesh, fixed, node, load, EDGE_M)
    }

    fn zones(&self, cells: &[usize]) -> anyhow::Result<Zones> {
        let ends_m: Vec<f64> = cells
            .iter()
            .scan(0, |sum, n| {
                *sum += n;
                Some(*sum as f64 * EDGE_M)
            })
            .collect();
        Ok(Zones::by_place(&self.mesh, |c| ends_m.iter().filter(|end| c.x > **end).count() as u32)?)
    }

    fn model(
        &self,
        zones: &Zones,
        laws: &[ZoneLaw],
        change: impl Fn(&mut ExchangeParams<'_>),
    ) -> anyhow::Result<HybridExchange> {
        let mut params = ExchangeParams::new(&self.mesh, &self.material, &self.fixed, zones, laws);
        change(&mut params);
        let mut model = HybridExchange::build(&params)?;
        model.apply(&self.load);
        Ok(model)
    }

    fn precomputed(
        &self,
        zones: &Zones,
        change: impl Fn(&mut ExchangeParams<'_>),
    ) -> anyhow::Result<HybridExchange> {
        self.model(zones, &vec![ZoneLaw::Precomputed; zones.n_zones()], change)
    }

    /// Mean error of the nodes over the edge.
    fn error(&self, displacement_m: &[DVec3]) -> f64 {
        let sum_m: f64 = displacement_m.iter().zip(&self.solution_m).map(|(a, b)| a.distance(*b)).sum();
        sum_m / displacement_m.len() as f64 / self.edge_m
    }

    /// Error after each sweep.
    fn errors(&self, model: &mut HybridExchange, n_sweeps: usize) -> Vec<f64> {
        (0..n_sweeps)
            .map(|_| {
                model.step(STEP_S);
                self.error(model.displacements_m())
            })
            .collect()
    }
}

fn figure(file: &'static str, caption: String, title: &str, x_label: &str, series: Vec<Series>) -> Figure {
    let (title, x_label) = (title.into(), x_label.into());
    let y_label = "log10 of mean error over edge".into();
    Figure { file, caption, plot: LinePlot { title, x_label, y_label, series, size: [720, 440] } }
}

/// Processor time of a piece of work on this thread [s]; nothing in it uses another one.
pub(super) fn timed_s(work: impl FnOnce()) -> f64 {
    let before = thread_cpu_ns();
    work();
    (thread_cpu_ns() - before) as f64 * 1e-9
}

/// Fixed nodes around one end of a liver, the loaded node at the other, and its mean edge [m].
fn liver_ends(mesh: &TetMesh) -> anyhow::Result<(Vec<NodeId>, NodeId, f64)> {
    let mut order: Vec<usize> = (0..mesh.positions_m.len()).collect();
    order.sort_by(|&a, &b| mesh.positions_m[a].x.total_cmp(&mesh.positions_m[b].x));
    let mut fixed: Vec<NodeId> = order[..order.len() / 20].iter().copied().map(NodeId::from_index).collect();
    fixed.sort_unstable();
    let surface = glisson::solve::boundary_nodes(mesh);
    let loaded =
        order.iter().rev().copied().map(NodeId::from_index).find(|n| surface.binary_search(n).is_ok());
    let edges = MeshEdges::of_mesh(mesh)?;
    let length_m = |[p, q]: &[NodeId; 2]| mesh.positions_m[p.index()].distance(mesh.positions_m[q.index()]);
    let mean_m = edges.nodes.iter().map(length_m).sum::<f64>() / edges.nodes.len() as f64;
    Ok((fixed, loaded.ok_or_else(|| anyhow::anyhow!("the liver has a surface"))?, mean_m))
}

/// A liver of about so many nodes.
fn liver_of_nodes(n_nodes: usize) -> anyhow::Result<TetMesh> {
    let mut n_tets = 4 * n_nodes;
    let mut best = liver(n_tets)?;
    for _ in 0..4 {
        let next_tets = n_tets * n_nodes / best.positions_m.len();
        let next = liver(next_tets)?;
        if next.positions_m.len().abs_diff(n_nodes) < best.positions_m.len().abs_diff(n_nodes) {
            best = next;
        }
        n_tets = next_tets;
    }
    Ok(best)
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    let parts = [
        convergence::experiments(&mut outcome)?,
        variants::experiments(&mut outcome)?,
        seconds::experiments(&mut outcome)?,
        dynamic::experiments(&mut outcome)?,
        tables::experiments(&mut outcome)?,
    ];
    outcome.notes = parts.join("\n\n");
    Ok(outcome)
}
