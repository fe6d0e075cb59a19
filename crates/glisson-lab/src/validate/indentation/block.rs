//! A square block of tetrahedra, bonded below, graded by hand towards the axis of an indenter: a quarter of it, held along the
//! two planes of symmetry.

use super::contact::{Dense, unilateral};
use glisson::material::LinearElastic;
use glisson::math::{DVec3, tetrahedron_volume_m3};
use glisson::mesh::{NodeId, TetMesh};
use glisson::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, NodeAveraging, StiffnessTensors, assemble_node_averaged,
    solve_columns_into,
};

/// Rings around the axis and layers below the upper side.
pub(in crate::validate) struct Grading {
    /// Radii from 0; the last is half the side of the block [m].
    pub(in crate::validate) radii_m: Vec<f64>,
    /// Depths from 0 to the base [m].
    pub(in crate::validate) depths_m: Vec<f64>,
    /// Edge length wanted around the axis within the fine part [m].
    pub(in crate::validate) fine_m: f64,
    /// From here on the rings become squares [m].
    pub(in crate::validate) round_m: f64,
}

/// The upper side of a quarter of the block.
pub(super) struct BlockTop {
    /// Distance of each candidate from the axis [m].
    pub(super) radii_m: Vec<f64>,
    /// Downward displacement of candidate i for a downward force on candidate j of the quarter [m/N].
    pub(super) compliance_m_per_n: Dense,
    pub(super) n_tets: usize,
}

/// Which tetrahedra.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::validate) enum Elements {
    /// Constant strain in each.
    Plain,
    /// Strain averaged over nodes.
    Averaged(NodeAveraging),
}

/// Rings of the plane: vertices and triangles.
fn plane(grading: &Grading) -> (Vec<[f64; 2]>, Vec<[usize; 3]>) {
    let quarter = std::f64::consts::FRAC_PI_2;
    let outer_m = grading.radii_m[grading.radii_m.len() - 1];
    let (mut points, mut triangles) = (vec![[0.0, 0.0]], Vec::new());
    // First vertex and number of segments of the ring before.
    let mut last = (0, 0);
    for &radius_m in &grading.radii_m[1..] {
        let wanted = (quarter * radius_m / grading.fine_m).ceil() as usize;
        // Even, so that a square has its corner.
        let n = if radius_m <= grading.round_m { wanted.max(last.1).next_multiple_of(2) } else { last.1 };
        let first = points.len();
        let squared = ((radius_m - grading.round_m) / (outer_m - grading.round_m)).max(0.0);
        for j in 0..=n {
            let angle = quarter * j as f64 / n as f64;
            let (sine, cosine) = if j == n { (1.0, 0.0) } else { angle.sin_cos() };
            let reach_m = radius_m * (1.0 + squared * (1.0 / sine.max(cosine) - 1.0));
            points.push([reach_m * cosine, reach_m * sine]);
        }
        // Along both rings at once: always on to the side whose next vertex comes first.
        let (mut inner, mut outer) = (0, 0);
        while inner < last.1 || outer < n {
            let share = |k: usize, n: usize| if n == 0 { f64::INFINITY } else { (k + 1) as f64 / n as f64 };
            let (i, o) = (last.0 + inner, first + outer);
            if outer < n && (inner == last.1 || share(outer, n) <= share(inner, last.1)) {
                triangles.push([i, o, o + 1]);
                outer += 1;
            } else {
                triangles.push([i, o, i + 1]);
                inner += 1;
            }
        }
        last = (first, n);
    }
    (points, triangles)
}

/// The quarter as tetrahedra: prisms below the triangles, each divided so that neighbours agree (the diagonal of a side goes
/// up from its lower column).
pub(in crate::validate) fn quarter_block(grading: &Grading) -> TetMesh {
    let (points, triangles) = plane(grading);
    let mut mesh = TetMesh::default();
    for depth_m in &grading.depths_m {
        mesh.positions_m.extend(points.iter().map(|[x, y]| DVec3::new(*x, *y, -depth_m)));
    }
    for level in 1..grading.depths_m.len() {
        let node = |column: usize, up: usize| NodeId::from_index(points.len() * (level - up) + column);
        for triangle in &triangles {
            let [a, b, c] = sorted(*triangle);
            for tet in [
                [node(a, 0), node(b, 0), node(c, 0), node(c, 1)],
                [node(a, 0), node(b, 0), node(b, 1), node(c, 1)],
                [node(a, 0), node(a, 1), node(b, 1), node(c, 1)],
            ] {
                let volume_m3 = tetrahedron_volume_m3(tet.map(|n| mesh.positions_m[n.index()]));
                let [p, q, r, s] = tet;
                mesh.tetrahedra.push(if volume_m3 > 0.0 { tet } else { [p, r, q, s] });
            }
        }
    }
    mesh
}

fn sorted(mut three: [usize; 3]) -> [usize; 3] {
    three.sort_unstable();
    three
}

impl Grading {
    /// Compliance of the nodes of the upper side within `reach_m` of the axis.
    pub(super) fn top(
        &self,
        material: &LinearElastic,
        elements: Elements,
        reach_m: f64,
    ) -> anyhow::Result<BlockTop> {
        let mesh = quarter_block(self);
        let (edges, tensors) = match elements {
            Elements::Plain => {
                let edges = MeshEdges::of_mesh(&mesh)?;
                let tensors = StiffnessTensors::assemble(&mesh, &edges, material)?;
                (edges, tensors)
            }
            Elements::Averaged(averaging) => assemble_node_averaged(&mesh, material, averaging)?,
        };
        let conditions = self.conditions(&mesh);
        conditions.check(&mesh, &edges)?;
        let system = FreeSystem::for_many_solutions(&mesh.positions_m, &edges, &tensors, &conditions)?;
        let radius_m = |p: &DVec3| p.x.hypot(p.y);
        let candidates: Vec<usize> = (0..mesh.positions_m.len())
            .filter(|n| {
                let p = &mesh.positions_m[*n];
                p.z == 0.0 && radius_m(p) <= reach_m * (1.0 + 1e-9)
            })
            .collect();
        let rows: Vec<usize> =
            candidates.iter().filter_map(|n| system.row_of(NodeId::from_index(*n), 2)).collect();
        Ok(BlockTop {
            radii_m: candidates.iter().map(|n| radius_m(&mesh.positions_m[*n])).collect(),
            compliance_m_per_n: compliance(&system, &rows)?,
            n_tets: mesh.tetrahedra.len(),
        })
    }

    /// Force [N] of a rigid frictionless ball, pushed along the axis on the shape at rest.
    pub(in crate::validate) fn ball_n(
        &self,
        material: &LinearElastic,
        elements: Elements,
        [radius_m, depth_m]: [f64; 2],
    ) -> anyhow::Result<f64> {
        let top = self.top(material, elements, 0.999 * radius_m)?;
        let foot_m = |r: &f64| depth_m - radius_m + (radius_m * radius_m - r * r).sqrt();
        let wanted_m: Vec<f64> = top.radii_m.iter().map(foot_m).collect();
        // Four quarters.
        Ok(4.0 * unilateral(&top.compliance_m_per_n, &wanted_m)?.iter().sum::<f64>())
    }

    /// Bonded to the base, held along the planes of symmetry.
    fn conditions(&self, mesh: &TetMesh) -> BoundaryConditions {
        let base_m = -self.depths_m[self.depths_m.len() - 1];
        let mut conditions = BoundaryConditions::new();
        for (n, p) in mesh.positions_m.iter().enumerate() {
            let node = NodeId::from_index(n);
            if p.z == base_m {
                conditions.fix_node(node);
                continue;
            }
            for axis in 0..2 {
                if p[axis] == 0.0 {
                    conditions.impose(node, axis, 0.0);
                }
            }
        }
        conditions
    }
}

/// Displacements of these rows under unit forces on them [m/N], made symmetric.
fn compliance(system: &FreeSystem, rows: &[usize]) -> anyhow::Result<Dense> {
    let factor = system.factorize()?;
    let n = rows.len();
    let mut columns = vec![0.0; n * n];
    solve_columns_into(
        &factor,
        1,
        &mut columns,
        n,
        |column, right| right[rows[column]] = 1.0,
        |_, solution, out| rows.iter().zip(out).for_each(|(row, c)| *c = solution[*row]),
    );
    let mut compliance_m_per_n = Dense::zero(n);
    for j in 0..n {
        for i in 0..n {
            compliance_m_per_n.set(i, j, 0.5 * (columns[n * j + i] + columns[n * i + j]));
        }
    }
    Ok(compliance_m_per_n)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::mesh::faults::find_faults;

    #[test]
    fn the_quarter_block_is_a_mesh_of_the_right_volume() {
        let grading = Grading {
            radii_m: vec![0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.3],
            depths_m: vec![0.0, 0.1, 0.3, 0.6],
            fine_m: 0.1,
            round_m: 0.35,
        };
        let mesh = quarter_block(&grading);
        assert!((mesh.volume_m3() - 1.3 * 1.3 * 0.6).abs() < 1e-12, "{}", mesh.volume_m3());
        assert!(find_faults(&mesh).is_empty());
    }
}
