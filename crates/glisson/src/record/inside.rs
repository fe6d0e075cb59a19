//! What is inside of bodies, for who looks: stress, strain and quality of their tetrahedra, a section by a plane, elastic energy.
//!
//! Of a tetrahedron with the deformation gradient F, J = det F:
//! - strain: the equivalent one of Green's strain E = (F^T F - 1)/2, sqrt(2/3 dev E : dev E);
//! - stress: von Mises' one of the Cauchy stress s = P(F) F^T/J [Pa] of the body's law, sqrt(3/2 dev s : dev s). The stress that carries the
//!   weight in the imaged shape is not in it, nor what relaxes;
//! - quality: the radius ratio of the shape at rest (3 inscribed over circumscribed, 1 for a regular one).
//!
//! A node has the mean of the tetrahedra around it, by their volumes at rest.

use crate::material::Material;
use crate::math::{DMat3, DVec3};
use crate::mesh::quality::radius_ratio;
use crate::mesh::{NodeId, TetMesh};
use std::sync::Arc;

/// A law that several tetrahedra share.
pub type SharedLaw = Arc<dyn Material + Send + Sync>;

/// What of tetrahedra is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Field {
    /// Nothing.
    #[default]
    None,
    /// Equivalent strain.
    Strain,
    /// Von Mises stress [Pa].
    Stress,
    /// Radius ratio at rest.
    Quality,
}

/// A plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// A point on it [m].
    pub point_m: DVec3,
    /// Its unit normal.
    pub normal: DVec3,
}

struct Element {
    nodes: [NodeId; 4],
    inverse_edges_per_m: DMat3,
    volume_m3: f64,
    quality: f64,
    /// None of what is rigid.
    law: Option<u16>,
}

/// The live tetrahedra of all bodies at rest.
pub struct Interior {
    elements: Vec<Element>,
    laws: Vec<SharedLaw>,
}

fn edges_m(nodes: [NodeId; 4], positions_m: &[DVec3]) -> DMat3 {
    let [a, b, c, d] = nodes.map(|node| positions_m[node.index()]);
    DMat3::from_cols(b - a, c - a, d - a)
}

fn deviator(m: DMat3) -> DMat3 {
    m - DMat3::IDENTITY * ((m.x_axis.x + m.y_axis.y + m.z_axis.z) / 3.0)
}

fn norm_squared(m: DMat3) -> f64 {
    m.x_axis.length_squared() + m.y_axis.length_squared() + m.z_axis.length_squared()
}

impl Interior {
    /// Those that are `live`; `law_of` tells the number of each one's law among `laws`, none of what is rigid.
    pub fn new(
        mesh: &TetMesh,
        live: &[bool],
        laws: Vec<SharedLaw>,
        law_of: impl Fn(usize) -> Option<u16>,
    ) -> Self {
        let element = |(tet, &nodes): (usize, &[NodeId; 4])| {
            let edges_m = edges_m(nodes, &mesh.positions_m);
            let volume_m3 = edges_m.determinant() / 6.0;
            (live[tet] && volume_m3 > 0.0).then(|| Element {
                nodes,
                inverse_edges_per_m: edges_m.inverse(),
                volume_m3,
                quality: radius_ratio(nodes.map(|node| mesh.positions_m[node.index()])),
                law: law_of(tet).filter(|law| usize::from(*law) < laws.len()),
            })
        };
        Self { elements: mesh.tetrahedra.iter().enumerate().filter_map(element).collect(), laws }
    }

    /// How many there are.
    pub fn n_tetrahedra(&self) -> usize {
        self.elements.len()
    }

    fn law(&self, element: &Element) -> Option<&SharedLaw> {
        self.laws.get(usize::from(element.law?))
    }

    fn value(&self, element: &Element, field: Field, positions_m: &[DVec3]) -> f64 {
        let f = || edges_m(element.nodes, positions_m) * element.inverse_edges_per_m;
        match field {
            Field::None => 0.0,
            Field::Quality => element.quality,
            Field::Strain => {
                let f = f();
                let green = (f.transpose() * f - DMat3::IDENTITY) * 0.5;
                (2.0 / 3.0 * norm_squared(deviator(green))).sqrt()
            }
            Field::Stress => {
                let Some(law) = self.law(element) else { return 0.0 };
                let f = f();
                let cauchy_pa = law.first_piola_pa(&f) * f.transpose() * (1.0 / f.determinant());
                (1.5 * norm_squared(deviator(cauchy_pa))).sqrt()
            }
        }
    }

    /// Of every node; 0 where there is no tetrahedron, and where a number has no end.
    pub fn at_nodes(&self, field: Field, positions_m: &[DVec3]) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); positions_m.len()];
        for element in &self.elements {
            let value = self.value(element, field, positions_m);
            for node in element.nodes.into_iter().filter(|_| value.is_finite()) {
                let (sum, volume_m3) = &mut sums[node.index()];
                *sum += element.volume_m3 * value;
                *volume_m3 += element.volume_m3;
            }
        }
        sums.into_iter().map(|(sum, volume_m3)| if volume_m3 > 0.0 { sum / volume_m3 } else { 0.0 }).collect()
    }

    /// Where a plane cuts the tetrahedra as they lie now: corners of triangles, three each, with the value there; counter-clockwise seen
    /// from where the normal points.
    pub fn section(&self, plane: &Plane, positions_m: &[DVec3], at_nodes: &[f64]) -> Vec<(DVec3, f64)> {
        let mut corners = Vec::new();
        for element in &self.elements {
            let height_m =
                element.nodes.map(|node| plane.normal.dot(positions_m[node.index()] - plane.point_m));
            let [above, below] =
                [true, false].map(|is_above| (0..4).filter(move |&k| (height_m[k] > 0.0) == is_above));
            let (above, below): (Vec<usize>, Vec<usize>) = (above.collect(), below.collect());
            let crossing = |i: usize, k: usize| {
                let share = height_m[i] / (height_m[i] - height_m[k]);
                let [a, b] = [i, k].map(|corner| element.nodes[corner].index());
                let value = at_nodes[a] + share * (at_nodes[b] - at_nodes[a]);
                (positions_m[a].lerp(positions_m[b], share), value)
            };
            let triangles: Vec<[(DVec3, f64); 3]> = match (above.as_slice(), below.as_slice()) {
                ([one], [a, b, c]) | ([a, b, c], [one]) => {
                    vec![[crossing(*one, *a), crossing(*one, *b), crossing(*one, *c)]]
                }
                ([a, b], [c, d]) => {
                    let [ac, ad, bd, bc] =
                        [crossing(*a, *c), crossing(*a, *d), crossing(*b, *d), crossing(*b, *c)];
                    vec![[ac, ad, bd], [ac, bd, bc]]
                }
                _ => continue,
            };
            for [p, q, r] in triangles {
                let is_seen = (q.0 - p.0).cross(r.0 - p.0).dot(plane.normal) >= 0.0;
                corners.extend(if is_seen { [p, q, r] } else { [p, r, q] });
            }
        }
        corners
    }

    /// Elastic energy of all that deforms [J]; what has no finite one is left out.
    pub fn elastic_energy_j(&self, positions_m: &[DVec3]) -> f64 {
        let of = |element: &Element| {
            let f = edges_m(element.nodes, positions_m) * element.inverse_edges_per_m;
            self.law(element).map_or(0.0, |law| element.volume_m3 * law.energy_density_j_per_m3(&f))
        };
        self.elements.iter().map(of).filter(|energy_j| energy_j.is_finite()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{LinearElastic, law_named};

    const E_PA: f64 = 6_000.0;
    const NU: f64 = 0.3;

    /// A cube of 0.1 m in five tetrahedra.
    fn cube() -> TetMesh {
        let corner =
            |i: u32| 0.1 * DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1));
        let tets = [[0, 1, 2, 4], [3, 2, 1, 7], [5, 4, 7, 1], [6, 7, 4, 2], [1, 2, 4, 7]];
        let mut mesh = TetMesh { positions_m: (0..8).map(corner).collect(), ..TetMesh::default() };
        for tet in tets {
            let nodes = tet.map(NodeId);
            let is_right = edges_m(nodes, &mesh.positions_m).determinant() > 0.0;
            mesh.tetrahedra.push(if is_right { nodes } else { [nodes[0], nodes[2], nodes[1], nodes[3]] });
        }
        mesh
    }

    fn interior(mesh: &TetMesh, live: &[bool]) -> Interior {
        let tissue = LinearElastic::from_young_poisson(E_PA, NU, 1000.0).unwrap();
        let law = law_named("st_venant_kirchhoff").unwrap().with_moduli_of(&tissue).unwrap().into_shared();
        Interior::new(mesh, live, vec![law], |_| Some(0))
    }

    #[test]
    fn a_bar_that_is_stretched_has_the_stress_strain_and_energy_of_the_formulas_however_it_is_turned() {
        let mesh = cube();
        let interior = interior(&mesh, &[true; 5]);
        let (long, across) = (1.001, 1.0 - NU * 0.001);
        let turn = DMat3::from_rotation_y(0.7);
        let moved: Vec<DVec3> =
            mesh.positions_m.iter().map(|p| turn * (*p * DVec3::new(long, across, across))).collect();
        let [strain, stress_pa, quality] =
            [Field::Strain, Field::Stress, Field::Quality].map(|field| interior.at_nodes(field, &moved));
        for node in 0..8 {
            // Uniaxial: von Mises stress E e, equivalent strain 2/3 (1 + nu) e, to first order in e.
            assert!((stress_pa[node] / (E_PA * 0.001) - 1.0).abs() < 5e-3, "{stress_pa:?}");
            assert!((strain[node] / (2.0 / 3.0 * (1.0 + NU) * 0.001) - 1.0).abs() < 5e-3, "{strain:?}");
            assert!(quality[node] > 0.5 && quality[node] <= 1.0 + 1e-12);
        }
        let expected_j = 0.5 * E_PA * 1e-6 * 1e-3;
        assert!((interior.elastic_energy_j(&moved) / expected_j - 1.0).abs() < 5e-3);
        assert!(interior.elastic_energy_j(&mesh.positions_m).abs() < 1e-15);
    }

    #[test]
    fn a_section_has_the_area_of_what_it_cuts_and_looks_where_its_normal_points() {
        let mesh = cube();
        for normal in [DVec3::X, DVec3::NEG_Z, DVec3::new(1.0, 1.0, 0.0).normalize()] {
            let plane = Plane { point_m: DVec3::splat(0.05), normal };
            let values: Vec<f64> = mesh.positions_m.iter().map(|p| p.x).collect();
            let area_m2 = |live: &[bool]| {
                let corners = interior(&mesh, live).section(&plane, &mesh.positions_m, &values);
                assert!(corners.iter().all(|(p, value)| (p.x - value).abs() < 1e-12), "linear in between");
                let of = |t: &[(DVec3, f64)]| 0.5 * (t[1].0 - t[0].0).cross(t[2].0 - t[0].0).dot(normal);
                corners.chunks(3).map(of).sum::<f64>()
            };
            let expected_m2 =
                if normal.x.abs() == 1.0 || normal.z.abs() == 1.0 { 0.01 } else { 0.01 * 2_f64.sqrt() };
            assert!((area_m2(&[true; 5]) / expected_m2 - 1.0).abs() < 1e-12, "{normal}");
            assert!(
                area_m2(&[true, true, true, true, false]) < 0.99 * expected_m2,
                "what is cut out is not there"
            );
        }
    }
}
