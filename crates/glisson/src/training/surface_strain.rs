//! How far the surface of organs is stretched.
//!
//! A triangle of the skin with the edges E at rest, in its plane, and e now has F = e E^-1 (three by two); with L the larger eigenvalue of
//! F^T F its strain is sqrt(L) - 1, the greatest stretch in its plane less one. A vertex has the mean of the triangles around it, by their
//! areas at rest, and a third of these areas. So slivers beside cuts weigh nothing. Under tips that are smaller than the triangles the
//! strain is what the mesh shows of it.
//!
//! Faces of cuts are no skin, and triangles that touch one do not count: bits that hang beside a cut swing. The surface is where every model has its deformation, `precomputed` too.

use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::world::World;

/// Mean local strain at which samples of the capsule of livers, of humans and pigs, tore when they were pulled in its plane: 47 +- 29 %
/// (Brunon, Bruyere-Garnier and Coret 2010, doi 10.1016/j.jbiomech.2010.03.038).
pub const TEARS_LIVER_CAPSULE: f64 = 0.47;

/// The skin at a moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StrainReading {
    /// Greatest strain.
    pub greatest: f64,
    /// Area at rest that is strained beyond [`TEARS_LIVER_CAPSULE`] [m2].
    pub beyond_m2: f64,
}

#[derive(Clone, Debug)]
struct Triangle {
    vertices: [u32; 3],
    nodes: [NodeId; 3],
    /// At rest: length of the first edge [m], share of it at which the third corner is, and how far beside it [m].
    shape: [f64; 3],
    area_m2: f64,
}

/// The skin at rest.
#[derive(Clone, Debug)]
pub struct SurfaceStrain {
    triangles: Vec<Triangle>,
    /// Of each vertex three times its area [m2], and the sum of strain times area.
    weights_m2: Vec<f64>,
    sums: Vec<f64>,
}

impl SurfaceStrain {
    /// Of the mesh as it is; made anew after edits.
    pub fn of(world: &World) -> Self {
        let organ = world.organ();
        let topology = organ.body().topology();
        let mut is_at_cut = vec![false; organ.mesh().positions_m.len()];
        let cut = topology.surface_triangles().filter(|&triangle| organ.is_cut(triangle));
        for node in cut.flat_map(|triangle| topology.triangle_nodes(triangle)) {
            is_at_cut[node.index()] = true;
        }
        let all = topology.surface_triangles().map(|triangle| topology.triangle_nodes(triangle));
        let whole = all.filter(|nodes| nodes.iter().all(|node| !is_at_cut[node.index()]));
        Self::new(&organ.mesh().positions_m, whole)
    }

    fn new(rest_m: &[DVec3], skin: impl Iterator<Item = [NodeId; 3]>) -> Self {
        let mut vertex_of = vec![u32::MAX; rest_m.len()];
        let mut weights_m2: Vec<f64> = Vec::new();
        let mut triangles = Vec::new();
        for nodes in skin {
            let [a, b, c] = nodes.map(|node| rest_m[node.index()]);
            let (along, across) = (b - a, c - a);
            let share = along.dot(across) / along.length_squared();
            let shape = [along.length(), share, (across - along * share).length()];
            let area_m2 = 0.5 * shape[0] * shape[2];
            if !shape.iter().all(|number| number.is_finite()) || area_m2 <= 0.0 {
                continue;
            }
            let vertices = nodes.map(|node| {
                let vertex = &mut vertex_of[node.index()];
                if *vertex == u32::MAX {
                    *vertex = weights_m2.len() as u32;
                    weights_m2.push(0.0);
                }
                *vertex
            });
            vertices.iter().for_each(|vertex| weights_m2[*vertex as usize] += area_m2);
            triangles.push(Triangle { vertices, nodes, shape, area_m2 });
        }
        Self { triangles, sums: vec![0.0; weights_m2.len()], weights_m2 }
    }

    /// For the places of its nodes now [m].
    pub fn read(&mut self, place_m: impl Fn(NodeId) -> DVec3) -> StrainReading {
        self.sums.fill(0.0);
        for triangle in &self.triangles {
            let [a, b, c] = triangle.nodes.map(&place_m);
            let strain = greatest_strain([b - a, c - a], triangle.shape);
            for vertex in triangle.vertices {
                self.sums[vertex as usize] += triangle.area_m2 * strain;
            }
        }
        let mut reading = StrainReading::default();
        for (sum, weight_m2) in self.sums.iter().zip(&self.weights_m2) {
            let strain = sum / weight_m2;
            if strain.is_finite() {
                reading.greatest = reading.greatest.max(strain);
                reading.beyond_m2 += if strain > TEARS_LIVER_CAPSULE { weight_m2 / 3.0 } else { 0.0 };
            }
        }
        reading
    }
}

fn greatest_strain([along_m, across_m]: [DVec3; 2], [length_m, share, height_m]: [f64; 3]) -> f64 {
    let (p, q) = (along_m / length_m, (across_m - along_m * share) / height_m);
    let (pp, pq, qq) = (p.length_squared(), p.dot(q), q.length_squared());
    let half_difference = 0.5 * (pp - qq);
    (0.5 * (pp + qq) + (half_difference * half_difference + pq * pq).sqrt()).sqrt() - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::DMat3;

    /// A square of 0.1 m in the plane of x and y, in two triangles, with a sliver of no area beside it.
    fn square() -> (Vec<DVec3>, SurfaceStrain) {
        let corner = |x: f64, y: f64| DVec3::new(x, y, 0.0) * 0.1;
        let rest_m =
            vec![corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0), corner(0.5, 0.0)];
        let skin = [[0, 1, 2], [2, 3, 0], [0, 4, 1]].map(|nodes: [u32; 3]| nodes.map(NodeId));
        let strain = SurfaceStrain::new(&rest_m, skin.into_iter());
        (rest_m, strain)
    }

    #[test]
    fn a_square_has_the_greater_of_its_two_stretches_however_it_is_turned() {
        let (rest_m, mut strain) = square();
        let turn = DMat3::from_rotation_x(0.7) * DMat3::from_rotation_z(0.4);
        for (x, y, greatest) in [(1.0, 1.0, 0.0), (1.3, 0.8, 0.3), (0.9, 1.2, 0.2), (0.5, 0.6, -0.4)] {
            let moved: Vec<DVec3> = rest_m.iter().map(|p| turn * (*p * DVec3::new(x, y, 1.0))).collect();
            let reading = strain.read(|node| moved[node.index()]);
            assert!((reading.greatest - f64::max(greatest, 0.0)).abs() < 1e-12, "{reading:?}");
            assert_eq!(reading.beyond_m2, 0.0);
        }
    }

    #[test]
    fn sheared_it_has_the_strain_of_the_formula() {
        let (rest_m, mut strain) = square();
        let shear = 0.5_f64;
        let moved: Vec<DVec3> = rest_m.iter().map(|p| *p + DVec3::X * shear * p.y).collect();
        // Principal stretch of simple shear: (g + sqrt(4 + g^2))/2.
        let expected = 0.5 * (shear + (4.0 + shear * shear).sqrt()) - 1.0;
        assert!((strain.read(|node| moved[node.index()]).greatest - expected).abs() < 1e-12);
    }

    #[test]
    fn the_area_beyond_the_limit_is_that_at_rest() {
        let (rest_m, mut strain) = square();
        let mut stretched_by = |by: f64| strain.read(|node| rest_m[node.index()] * DVec3::new(by, 1.0, 1.0));
        assert_eq!(stretched_by(1.46).beyond_m2, 0.0);
        assert!((stretched_by(1.48).beyond_m2 - 0.01).abs() < 1e-15);
        assert_eq!(stretched_by(f64::NAN), StrainReading::default());
    }
}
