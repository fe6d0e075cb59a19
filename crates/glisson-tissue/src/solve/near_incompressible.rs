//! Linear tetrahedra that do not lock when nearly incompressible: node-averaged strain, linear and static.
//!
//! A tetrahedron has one volume change for each node's three displacements or so: when all must vanish, the
//! mesh can hardly move. Here strain is averaged over nodes (Bonet and Burton 1998,
//! doi 10.1002/(SICI)1099-0887(199805)14:5<437::AID-CNM162>3.0.CO;2-W): with V_a the sum of V/4 over the
//! tetrahedra around node a,
//!
//! e_a = 1/V_a sum over them of V/4 e,   theta_a = tr e_a,
//! W = sum over tetrahedra of V s mu |e|^2 + sum over nodes of V_a [ (1 - s) mu |e_a|^2 + lambda/2 theta_a^2 ].
//!
//! With s = 1 only the pressure is averaged: the linear limit of
//! [`crate::model::implicit::VolumeResistance::NodeAveraged`]. Tetrahedra in bending are too stiff in shear as
//! well; a smaller s averages that too, and what stays in the tetrahedra holds back the spurious modes of a
//! fully averaged strain (Puso and Solberg 2006, doi 10.1002/nme.1663). [`NodeAveraging::STRAIN`] has s = 0.2,
//! the round number for which a cantilever of four tetrahedra in height, Cook's membrane and a thick sphere
//! all come within 2 %. The pressure p_a = -lambda theta_a still oscillates a little from node to node. An
//! affine displacement has the same strain everywhere: the patch test is passed. The stiffness couples all
//! nodes around a common node, about six times as many as share an edge: for static cases of some 10,000 nodes.
//! [`super::solve_static_smoothed`] is closer to a beam on coarse meshes and has a finite-strain form.

use super::static_problem::solve_assembled;
use super::{
    LOCAL_EDGES, MeshEdges, P1Gradients, SolveError, StaticProblem, StaticSolution, StiffnessTensors,
};
use crate::material::LinearElastic;
use glisson_mesh::math::{DMat3, DVec3, outer};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// The gradients g_aj of every node's mean volume change.
#[derive(Clone, Debug)]
struct NodeDivergence {
    /// Sum of V/4 around each node [m3].
    volume_m3: Vec<f64>,
    /// Nodes j around each node a, itself included, ascending, with g_aj [1/m].
    gradient_per_m: Vec<Vec<(NodeId, DVec3)>>,
}

impl NodeDivergence {
    fn of_mesh(mesh: &TetMesh) -> Result<Self, SolveError> {
        let n_nodes = mesh.positions_m.len();
        let mut volume_m3 = vec![0.0; n_nodes];
        let mut gradient_per_m: Vec<Vec<(NodeId, DVec3)>> = vec![Vec::new(); n_nodes];
        for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
            let g = P1Gradients::of_tet(mesh, TetId::from_index(t))?;
            for a in nodes {
                volume_m3[a.index()] += 0.25 * g.volume_m3;
                let row = &mut gradient_per_m[a.index()];
                row.extend((0..4).map(|k| (nodes[k], g.alpha_per_m[k] * (0.25 * g.volume_m3))));
            }
        }
        for (row, v) in gradient_per_m.iter_mut().zip(&volume_m3) {
            // Stable: each sum runs over the tetrahedra in their order.
            row.sort_by_key(|(j, _)| *j);
            let mut merged: Vec<(NodeId, DVec3)> = Vec::with_capacity(row.len() / 3);
            for &(j, share) in row.iter() {
                match merged.last_mut() {
                    Some(last) if last.0 == j => last.1 += share,
                    _ => merged.push((j, share)),
                }
            }
            for (_, g) in &mut merged {
                *g /= *v;
            }
            *row = merged;
        }
        Ok(Self { volume_m3, gradient_per_m })
    }

    fn volume_change(&self, node: usize, displacement_m: &[DVec3]) -> f64 {
        self.gradient_per_m[node].iter().map(|(j, g)| g.dot(displacement_m[j.index()])).sum()
    }
}

/// The share of the shear that is averaged over the nodes besides the pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeAveraging {
    /// s, the share of the shear term that stays in each tetrahedron: above 0, at most 1.
    pub element_shear: f64,
}

impl NodeAveraging {
    /// Averages the pressure only.
    pub const PRESSURE: Self = Self { element_shear: 1.0 };
    /// Averages the pressure and most of the shear.
    pub const STRAIN: Self = Self { element_shear: 0.2 };
}

/// Stiffness with node-averaged strain: every pair of nodes around a common node counts as an edge.
///
/// # Errors
/// [`SolveError`]: an empty mesh, a missing node, a flat or inverted tetrahedron.
pub fn assemble_node_averaged(
    mesh: &TetMesh,
    material: &LinearElastic,
    averaging: NodeAveraging,
) -> Result<(MeshEdges, StiffnessTensors), SolveError> {
    let element_mu_pa = averaging.element_shear * material.mu_pa();
    let node_mu_pa = material.mu_pa() - element_mu_pa;
    let mut edges = MeshEdges::of_mesh(mesh)?;
    let divergence = NodeDivergence::of_mesh(mesh)?;
    let pairs = Pairs::around(&divergence);
    for (nodes, of_tet) in mesh.tetrahedra.iter().zip(&mut edges.of_tet) {
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let (p, q) = (nodes[j].min(nodes[k]), nodes[j].max(nodes[k]));
            of_tet[e] = u32::try_from(pairs.place(p, q)).expect("fewer than 2^32 pairs");
        }
    }
    let mut tensors = StiffnessTensors {
        vertex: vec![DMat3::ZERO; mesh.positions_m.len()],
        edge: vec![DMat3::ZERO; pairs.0.len()],
    };
    add_element_shear(mesh, element_mu_pa, &edges, &mut tensors)?;
    for (row, volume_m3) in divergence.gradient_per_m.iter().zip(&divergence.volume_m3) {
        let bulk = material.lambda_pa() * volume_m3;
        let shear = node_mu_pa * volume_m3;
        let tensor = |g: DVec3, h: DVec3| {
            outer(g, h) * bulk + (outer(h, g) + DMat3::from_diagonal(DVec3::splat(g.dot(h)))) * shear
        };
        for (i, &(p, g)) in row.iter().enumerate() {
            tensors.vertex[p.index()] += tensor(g, g);
            for &(q, h) in &row[i + 1..] {
                tensors.edge[pairs.place(p, q)] += tensor(g, h);
            }
        }
    }
    edges.nodes = pairs.0;
    Ok((edges, tensors))
}

/// The pairs of nodes around a common node, ascending.
struct Pairs(Vec<[NodeId; 2]>);

impl Pairs {
    fn around(divergence: &NodeDivergence) -> Self {
        let rows = &divergence.gradient_per_m;
        let mut pairs: Vec<[NodeId; 2]> = Vec::new();
        for p in 0..rows.len() {
            // Two nodes meet when one is around a neighbour of the other.
            let start = pairs.len();
            for (a, _) in &rows[p] {
                let later = rows[a.index()].iter().filter(|(q, _)| q.index() > p);
                pairs.extend(later.map(|(q, _)| [NodeId::from_index(p), *q]));
            }
            pairs[start..].sort_unstable();
            let mut kept = start;
            for i in start..pairs.len() {
                if kept == start || pairs[i] != pairs[kept - 1] {
                    pairs[kept] = pairs[i];
                    kept += 1;
                }
            }
            pairs.truncate(kept);
        }
        Self(pairs)
    }

    fn place(&self, p: NodeId, q: NodeId) -> usize {
        self.0.binary_search(&[p, q]).expect("nodes around a common node make a pair")
    }
}

/// Adds the shear that stays in each tetrahedron.
fn add_element_shear(
    mesh: &TetMesh,
    mu_pa: f64,
    edges: &MeshEdges,
    tensors: &mut StiffnessTensors,
) -> Result<(), SolveError> {
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let shear = P1Gradients::of_tet(mesh, TetId::from_index(t))?.stiffness(0.0, mu_pa);
        for j in 0..4 {
            tensors.vertex[nodes[j].index()] += shear.vertex[j];
        }
        for (e, [j, k]) in LOCAL_EDGES.into_iter().enumerate() {
            let along = if nodes[j] < nodes[k] { shear.edge[e] } else { shear.edge[e].transpose() };
            tensors.edge[edges.of_tet[t][e] as usize] += along;
        }
    }
    Ok(())
}

/// Displacements and reactions of a linear static case with node-averaged strain.
///
/// # Errors
/// [`SolveError`]: an unusable mesh, conditions on missing nodes, a piece that floats, a singular matrix.
///
/// # Panics
/// When there is not one force per node.
pub fn solve_static_node_averaged(
    problem: &StaticProblem<'_>,
    averaging: NodeAveraging,
) -> Result<StaticSolution, SolveError> {
    let (edges, tensors) = assemble_node_averaged(problem.mesh, problem.material, averaging)?;
    solve_assembled(problem, &edges, &tensors)
}

/// Mean pressure -lambda theta_a [Pa] of each node, zero for a node without a tetrahedron.
///
/// # Errors
/// [`SolveError::Volume`] for a flat or inverted tetrahedron.
///
/// # Panics
/// When there is not one displacement per node.
pub fn node_pressures_pa(
    mesh: &TetMesh,
    material: &LinearElastic,
    displacement_m: &[DVec3],
) -> Result<Vec<f64>, SolveError> {
    assert_eq!(displacement_m.len(), mesh.positions_m.len(), "one displacement a node");
    let divergence = NodeDivergence::of_mesh(mesh)?;
    Ok((0..displacement_m.len())
        .map(|a| -material.lambda_pa() * divergence.volume_change(a, displacement_m))
        .collect())
}
