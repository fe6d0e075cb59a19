//! The standard body of the benchmarks: an ellipsoid of 30 x 20 x 12 cm, as soft as a liver, held below.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use glam::DVec3;
use glisson::material::LinearElastic;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::{NodeId, TetMesh};
use glisson::surface::TriMesh;

/// Half axes [m].
const HALF_AXES_M: DVec3 = DVec3::new(0.15, 0.10, 0.06);
/// Young's modulus [Pa], Poisson's ratio, density [kg/m3].
const YOUNG_MODULUS_PA: f64 = 5_000.0;
const POISSON_RATIO: f64 = 0.45;
const DENSITY_KG_PER_M3: f64 = 1_000.0;
/// Share of the nodes, the lowest ones, that are held.
const HELD_SHARE: f64 = 0.05;
/// Triangles of the surface that is meshed, at least: finer than the tetrahedra at most sizes.
const LEAST_SURFACE_TRIANGLES: usize = 8_000;

/// The body as tetrahedra.
pub(crate) struct StandardBody {
    pub(crate) mesh: TetMesh,
    /// Held nodes, ascending.
    pub(crate) fixed_nodes: Vec<NodeId>,
    pub(crate) material: LinearElastic,
}

impl StandardBody {
    /// The body in about `n_tets` tetrahedra; made once for all cases that ask for the same number.
    pub(crate) fn shared(n_tets: usize) -> anyhow::Result<Arc<Self>> {
        static MADE: Mutex<BTreeMap<usize, Arc<StandardBody>>> = Mutex::new(BTreeMap::new());
        let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(body) = made.get(&n_tets) {
            return Ok(Arc::clone(body));
        }
        let body = Arc::new(Self::new(n_tets)?);
        made.insert(n_tets, Arc::clone(&body));
        Ok(body)
    }

    fn new(n_tets: usize) -> anyhow::Result<Self> {
        let (mesh, _) =
            generate(&surface_for(n_tets), &params_for(n_tets)).context("meshing the ellipsoid")?;
        let mut by_height: Vec<usize> = (0..mesh.positions_m.len()).collect();
        by_height.sort_by(|&a, &b| mesh.positions_m[a].z.total_cmp(&mesh.positions_m[b].z));
        by_height.truncate(((HELD_SHARE * by_height.len() as f64).round() as usize).max(3));
        by_height.sort_unstable();
        let fixed_nodes = by_height.into_iter().map(NodeId::from_index).collect();
        let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, POISSON_RATIO, DENSITY_KG_PER_M3)?;
        Ok(Self { mesh, fixed_nodes, material })
    }
}

/// The surface to mesh with `n_tets` tetrahedra.
pub(super) fn surface_for(n_tets: usize) -> TriMesh {
    ellipsoid_surface(LEAST_SURFACE_TRIANGLES.max(n_tets / 3))
}

/// The mesher's parameters for `n_tets` tetrahedra.
pub(super) fn params_for(n_tets: usize) -> MeshParams {
    MeshParams { size: WantedSize::Tetrahedra(n_tets), volume_m3: None }
}

/// The ellipsoid's surface in about `n_triangles` triangles: an octahedron, each face cut in n^2.
pub(super) fn ellipsoid_surface(n_triangles: usize) -> TriMesh {
    let n = ((n_triangles as f64 / 8.0).sqrt().round() as i32).max(2);
    // The octahedron |x| + |y| + |z| = n has its vertices at whole numbers.
    let mut places = BTreeMap::new();
    let mut mesh = TriMesh::default();
    let mut vertex = |place: [i32; 3], mesh: &mut TriMesh| {
        *places.entry(place).or_insert_with(|| {
            let direction = DVec3::from_array(place.map(f64::from)).normalize();
            mesh.positions_m.push(HALF_AXES_M * direction);
            u32::try_from(mesh.positions_m.len() - 1).expect("a benchmark's surface is small")
        })
    };
    for octant in 0..8 {
        let sign = [0, 1, 2].map(|axis| if octant >> axis & 1 == 0 { 1 } else { -1 });
        let outward = sign[0] * sign[1] * sign[2] > 0;
        for i in 0..n {
            for j in 0..n - i {
                let place = |di: i32, dj: i32| {
                    let (x, y) = (i + di, j + dj);
                    [sign[0] * x, sign[1] * y, sign[2] * (n - x - y)]
                };
                let mut add = |corners: [[i32; 3]; 3]| {
                    let [a, b, c] = corners.map(|place| vertex(place, &mut mesh));
                    mesh.triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                };
                add([place(0, 0), place(1, 0), place(0, 1)]);
                if i + j < n - 1 {
                    add([place(1, 0), place(1, 1), place(0, 1)]);
                }
            }
        }
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_body_is_held_below_and_has_the_wanted_size() {
        let body = StandardBody::new(2_000).unwrap();
        let n = body.mesh.tetrahedra.len();
        assert!(n.abs_diff(2_000) <= 100, "{n} tetrahedra");
        let height = |node: &NodeId| body.mesh.positions_m[node.index()].z;
        let highest_held = body.fixed_nodes.iter().map(height).fold(f64::NEG_INFINITY, f64::max);
        let below = body.mesh.positions_m.iter().filter(|p| p.z < highest_held).count();
        assert!(
            below < body.fixed_nodes.len() && body.fixed_nodes.len() * 20 <= body.mesh.positions_m.len() + 20
        );
    }

    #[test]
    fn the_surface_is_closed_and_holds_the_ellipsoids_volume() {
        let mesh = ellipsoid_surface(20_000);
        assert_eq!(mesh.triangles.len(), 8 * 50 * 50);
        // Euler: V - E + F = 2 with E = 3 F / 2.
        assert_eq!(mesh.positions_m.len(), mesh.triangles.len() / 2 + 2);
        let exact = 4.0 / 3.0 * std::f64::consts::PI * HALF_AXES_M.element_product();
        let ratio = mesh.volume_m3() / exact;
        assert!((0.998..1.0).contains(&ratio), "{ratio}");
    }
}
