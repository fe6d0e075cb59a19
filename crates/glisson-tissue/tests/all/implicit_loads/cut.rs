//! A body with all features after a cut.

use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::edit::{EditableMesh, MeshEdit};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{PronySeries, PronyTerm};
use glisson_tissue::model::implicit::{ImplicitEuler, ImplicitLaw, ImplicitParams};
use glisson_tissue::model::{Attachment, DeformableModel, DynamicBody, FixedNode, Rayleigh, RestStress};

use super::{GRAVITY, equilibrating, linear, specs};
use crate::implicit::{bits, body, clamped, tight};
use crate::model_meshes::{nodes_below, shaken_block};

/// A body with all features: supports, stress at rest, a ligament, relaxation and damping.
struct LoadedBody {
    mesh: TetMesh,
    fixed: Vec<FixedNode>,
    stress: Vec<RestStress>,
    ligament: Attachment,
    series: PronySeries,
    law: ImplicitLaw,
}

impl LoadedBody {
    fn new(law: &ImplicitLaw) -> Self {
        let mesh = shaken_block([4, 3, 3], DVec3::new(0.12, 0.08, 0.06), 0.15, 9);
        let fixed = clamped(&nodes_below(&mesh, 0, 0.02));
        let stress = equilibrating(&mesh, &linear(0.4), &fixed, GRAVITY);
        let anchored = mesh.positions_m.iter().position(|p| (0.03..0.045).contains(&p.x)).unwrap();
        let ligament = Attachment {
            node: NodeId::from_index(anchored),
            anchor_m: mesh.positions_m[anchored] + DVec3::Z * 0.1,
            slack_length_m: 0.0999,
            stiffness_n_per_m: 50.0,
        };
        let series = PronySeries::new(&[PronyTerm { share: 0.3, time_s: 0.05 }]).unwrap();
        Self { mesh, fixed, stress, ligament, series, law: law.clone() }
    }

    /// Whether a tetrahedron lies between the support and the piece that is cut loose.
    fn is_between(&self, t: usize) -> bool {
        let corners_m = self.mesh.corners_m(TetId::from_index(t));
        corners_m.iter().any(|p| (0.055..0.07).contains(&p.x))
    }

    fn model(&self) -> ImplicitEuler {
        // The general ones as one law a tetrahedron.
        let law = match &self.law {
            ImplicitLaw::General(one) => {
                ImplicitLaw::General(vec![one[0].clone(); self.mesh.tetrahedra.len()])
            }
            fast => fast.clone(),
        };
        let loaded = DynamicBody {
            gravity_m_per_s2: GRAVITY,
            damping: Rayleigh { mass_per_s: 0.0, stiffness_s: 0.001 },
            rest_stress_pa: &self.stress,
            attachments: &[self.ligament],
            ..body(&self.mesh, &self.fixed)
        };
        ImplicitEuler::build(&ImplicitParams { relaxation: Some(&self.series), ..tight(loaded, &law) })
            .unwrap()
    }

    /// The model after the cut and a compaction, and the body of what remains.
    fn cut(self) -> (ImplicitEuler, Self) {
        let mut model = self.model();
        let mut editable = EditableMesh::new(self.mesh.clone()).unwrap();
        let (tets, kept): (Vec<usize>, Vec<usize>) =
            (0..self.mesh.tetrahedra.len()).partition(|&t| self.is_between(t));
        let tets = tets.into_iter().map(TetId::from_index).collect();
        let change = editable.apply(&MeshEdit::Remove { tets }).unwrap();
        model.topology_changed(editable.mesh(), &change).unwrap();
        let change = editable.compact();
        model.topology_changed(editable.mesh(), &change).unwrap();
        let mesh = editable.mesh().clone();
        let anchored_m = self.mesh.positions_m[self.ligament.node.index()];
        let node = NodeId::from_index(mesh.positions_m.iter().position(|p| *p == anchored_m).unwrap());
        let rest = Self {
            fixed: clamped(&nodes_below(&mesh, 0, 0.02)),
            stress: kept.into_iter().map(|t| self.stress[t]).collect(),
            ligament: Attachment { node, ..self.ligament },
            mesh,
            ..self
        };
        (model, rest)
    }
}

/// All features at once: a piece cut loose falls with its full weight, and the model is then the one of the
/// remaining mesh, to the bit.
#[test]
fn after_a_cut_a_loaded_body_is_the_one_of_the_remaining_mesh() {
    for law in [5, 3, 2].map(|k| ImplicitLaw::from(&specs()[k])) {
        let (mut cut, rest) = LoadedBody::new(&law).cut();
        let mut built = rest.model();
        let loose: Vec<NodeId> = (0..rest.mesh.positions_m.len())
            .map(NodeId::from_index)
            .filter(|n| rest.mesh.positions_m[n.index()].x > 0.07)
            .collect();
        for step in 1..=10 {
            cut.step(0.01);
            built.step(0.01);
            assert!(!cut.report().missed_tolerance, "{:?}", cut.step_report());
            assert_eq!(bits(&cut), bits(&built));
            // Free fall of the centre of mass, whatever the released stress does to the shape.
            let mass_kg: f64 = loose.iter().map(|&n| cut.mass_kg(n)).sum();
            let fallen_m: DVec3 =
                loose.iter().map(|&n| cut.displacements_m()[n.index()] * (cut.mass_kg(n) / mass_kg)).sum();
            let n = f64::from(step);
            let expected_m = GRAVITY * (0.01 * 0.01 * n * (n + 1.0) / 2.0);
            assert!((fallen_m - expected_m).length() < 1e-8 * expected_m.length(), "{fallen_m} {expected_m}");
        }
        assert_eq!(cut.report().n_reanalyses, 2);
    }
}
