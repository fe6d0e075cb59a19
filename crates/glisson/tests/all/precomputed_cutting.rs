//! Cutting the pre-computed body: its compliance after removals against fresh pre-computations and static solutions.

use crate::model_meshes::{block, shaken_block};
use glisson::material::LinearElastic;
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::precomputed::{Precision, Precomputed, PrecomputedParams, StoredNodes};
use glisson::model::{Constraints, DeformableModel, ImposedDisplacement, NodalForce};
use glisson::solve::{BoundaryConditions, StaticProblem, add_gravity_forces, solve_static};

fn material() -> LinearElastic {
    LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap()
}

/// A model and the mesh that it follows.
struct Cut {
    body: EditableMesh,
    fixed: Vec<NodeId>,
    model: Precomputed,
}

impl Cut {
    fn new(mesh: TetMesh, stored: StoredNodes, precision: Precision) -> Self {
        let lowest = mesh.positions_m.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
        let fixed: Vec<NodeId> = (0..mesh.positions_m.len())
            .filter(|&n| mesh.positions_m[n].z < lowest + 0.011)
            .map(NodeId::from_index)
            .collect();
        Self::held_at(mesh, fixed, stored, precision)
    }

    fn held_at(mesh: TetMesh, fixed: Vec<NodeId>, stored: StoredNodes, precision: Precision) -> Self {
        let model = Precomputed::build(&params(&mesh, &material(), &fixed, stored, precision)).unwrap();
        Self { body: EditableMesh::new(mesh).unwrap(), fixed, model }
    }

    fn shaken(seed: u64) -> Self {
        let mesh = shaken_block([6, 5, 5], DVec3::new(0.12, 0.1, 0.1), 0.15, seed);
        Self::new(mesh, StoredNodes::Surface, Precision::F64)
    }

    fn remove(&mut self, tets: &[TetId]) {
        let change = self.body.apply(&MeshEdit::Remove { tets: tets.to_vec() }).unwrap();
        assert_eq!(self.model.topology_refusal(), None);
        self.model.topology_changed(self.body.mesh(), &change).unwrap();
    }

    /// The live part of the mesh with the same node numbers, and the nodes to be held: the fixed ones and those that
    /// are left alone.
    fn rest(&self) -> (TetMesh, Vec<NodeId>) {
        let topology = self.body.topology();
        let tetrahedra = topology.live_tets().map(|t| topology.tet_nodes(t)).collect();
        let mesh = TetMesh { positions_m: self.body.mesh().positions_m.clone(), tetrahedra };
        let held = (0..mesh.positions_m.len())
            .map(NodeId::from_index)
            .filter(|n| self.fixed.contains(n) || !topology.is_live_node(*n))
            .collect();
        (mesh, held)
    }

    /// Largest difference of the compliance from that of a fresh pre-computation, over the largest entry.
    fn difference(&self) -> f64 {
        let (mesh, held) = self.rest();
        let (stored, precision) = (StoredNodes::Surface, Precision::F64);
        let fresh = Precomputed::build(&params(&mesh, &material(), &held, stored, precision)).unwrap();
        let mut nodes = self.model.loadable_nodes().to_vec();
        nodes.sort_unstable();
        assert_eq!(nodes, fresh.loadable_nodes());
        let (mut largest, mut difference) = (0.0_f64, 0.0_f64);
        let size = |m: DMat3| m.to_cols_array().map(f64::abs).into_iter().fold(0.0, f64::max);
        for &l in &nodes {
            for &m in &nodes {
                let expected = fresh.compliance_m_per_n(l, m).unwrap();
                let found = self.model.compliance_m_per_n(l, m).unwrap();
                largest = largest.max(size(expected));
                difference = difference.max(size(found - expected));
            }
        }
        difference / largest
    }

    /// A live tetrahedron on the surface whose removal leaves one piece held by faces.
    fn next(&self, random: &mut SeededRandom) -> TetId {
        let topology = self.body.topology();
        let live: Vec<TetId> = topology.live_tets().collect();
        loop {
            let tet = live[(random.next_u64() % live.len() as u64) as usize];
            if topology.tet_neighbours(tet).iter().all(|n| !n.is_none()) {
                continue;
            }
            let mut after = self.body.clone();
            after.apply(&MeshEdit::Remove { tets: vec![tet] }).unwrap();
            if after.topology().pieces(Through::Faces).count() == 1 {
                return tet;
            }
        }
    }
}

fn params<'a>(
    mesh: &'a TetMesh,
    material: &'a LinearElastic,
    fixed_nodes: &'a [NodeId],
    stored: StoredNodes,
    precision: Precision,
) -> PrecomputedParams<'a> {
    PrecomputedParams { mesh, material, fixed_nodes, stored, precision, progress: None }
}

#[test]
fn one_removal_gives_the_compliance_of_the_remaining_mesh() {
    for (stored, precision, limit) in [
        (StoredNodes::Surface, Precision::F64, 1e-12),
        (StoredNodes::All, Precision::F64, 1e-12),
        (StoredNodes::Surface, Precision::F32, 2e-7),
    ] {
        let mesh = shaken_block([4, 3, 4], DVec3::new(0.08, 0.06, 0.08), 0.15, 7);
        let mut cut = Cut::new(mesh, stored, precision);
        let tet = cut.next(&mut SeededRandom::new(1));
        cut.remove(&[tet]);
        let difference = cut.difference();
        assert!(difference < limit, "{stored:?} {precision:?}: {difference:e}");
        let report = cut.model.cut_report();
        assert_eq!((report.n_edits, report.n_taken_out, report.n_loose), (1, 1, 0));
        assert!(report.least_pivot > 1e-3 && report.error < limit, "{report:?}");
    }
}

#[test]
fn a_hundred_removals_in_a_row_agree_with_a_fresh_precomputation() {
    let mut cut = Cut::shaken(11);
    let mut random = SeededRandom::new(2);
    for _ in 0..100 {
        let tet = cut.next(&mut random);
        cut.remove(&[tet]);
    }
    let (difference, report) = (cut.difference(), cut.model.cut_report());
    assert!(difference < 1e-8, "{difference:e} {report:?}");
    assert!(report.n_laid_bare > 20 && report.n_taken_out == 100, "{report:?}");
    assert!(!report.wants_recomputation && report.error < 1e-8, "{report:?}");
}
