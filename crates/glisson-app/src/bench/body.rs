//! The standard body of the benchmarks: an ellipsoid of 30 x 20 x 12 cm, as soft as a liver, held below.

use glam::DVec3;
use glisson::surface::TriMesh;

/// Half axes [m].
const HALF_AXES_M: DVec3 = DVec3::new(0.15, 0.10, 0.06);

/// The ellipsoid's surface in about `n_triangles` triangles: an octahedron, each face cut in n^2.
pub(super) fn ellipsoid_surface(n_triangles: usize) -> TriMesh {
    let n = ((n_triangles as f64 / 8.0).sqrt().round() as i32).max(2);
    // The octahedron |x| + |y| + |z| = n has its vertices at whole numbers.
    let mut places = std::collections::BTreeMap::new();
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
