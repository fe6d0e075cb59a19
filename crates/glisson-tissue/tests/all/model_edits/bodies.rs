//! Bodies in which no two tetrahedra are alike, and all models that follow edits.

use std::sync::Arc;

use glisson_mesh::math::{DVec3, SeededRandom};
use glisson_mesh::mesh::edit::{EditableMesh, TopologyChange};
use glisson_mesh::mesh::zones::Zones;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use glisson_tissue::material::{
    LinearElastic, MooneyRivlin, NeoHookeLog, PronySeries, PronyTerm, StableNeoHooke,
};
use glisson_tissue::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson_tissue::model::extended_mass_spring::{EdgeLaw, ExtendedMassSpring, ExtendedMassSpringParams};
use glisson_tissue::model::hybrid::condensed::{CondensedHybrid, CondensedParams, ZoneLaw};
use glisson_tissue::model::implicit::{
    ImplicitEuler, ImplicitLaw, ImplicitParams, SharedLaw, VolumeResistance,
};
use glisson_tissue::model::kernel::{KernelLaw, KernelPath, SharedMaterial};
use glisson_tissue::model::kind::ModelKind;
use glisson_tissue::model::mass_spring::{MassSpring, MassSpringParams, NodalMasses};
use glisson_tissue::model::nonlinear_tensor_mass::{
    Fibre, NonlinearElasticity, NonlinearTensorMass, NonlinearTensorMassParams,
};
use glisson_tissue::model::{
    Attachment, DeformableModel, DynamicBody, FixedNode, FollowedEdits, Integration, ModelMotion, ModelRow,
    OrganBody, Rayleigh, RestStress,
};

pub(super) const DENSITY_KG_PER_M3: f64 = 1060.0;

/// What models are made from.
#[derive(Clone)]
pub(super) struct Body {
    pub(super) mesh: TetMesh,
    pub(super) fixed: Vec<FixedNode>,
    pub(super) attachments: Vec<Attachment>,
    pub(super) rest_stress_pa: Vec<RestStress>,
    pub(super) materials: Vec<LinearElastic>,
    /// Of models that have one material only.
    pub(super) uniform: LinearElastic,
    pub(super) fibres: Vec<Fibre>,
    pub(super) damping: Rayleigh,
    pub(super) time_step_s: f64,
    pub(super) most_parts: u32,
    pub(super) path: KernelPath,
}

impl Body {
    pub(super) fn of(mesh: TetMesh, random: &mut SeededRandom) -> Self {
        let n_tets = mesh.tetrahedra.len();
        let fixed = (0..mesh.positions_m.len()).filter(|&n| mesh.positions_m[n].x < 0.02).map(|n| {
            let axes = if n % 3 == 0 { [true, false, true] } else { [true; 3] };
            FixedNode { node: NodeId::from_index(n), axes }
        });
        let attachment = |n: usize| Attachment {
            node: NodeId::from_index(n),
            anchor_m: mesh.positions_m[n] + DVec3::new(0.02, 0.01, -0.01),
            slack_length_m: 0.01,
            stiffness_n_per_m: 3.0,
        };
        let mut unit = || DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
        let fibres: Vec<Fibre> = (0..n_tets)
            .map(|_| Fibre { lambda_along_pa: 15_000.0, mu_along_pa: 3000.0, direction: unit() })
            .collect();
        let mut young_pa = || random.uniform_in(3000.0, 6000.0);
        let materials = (0..n_tets)
            .map(|_| LinearElastic::from_young_poisson(young_pa(), 0.4, DENSITY_KG_PER_M3).unwrap())
            .collect();
        let mut stress_pa = || random.uniform_in(-50.0, 50.0);
        Self {
            fixed: fixed.collect(),
            attachments: (0..mesh.positions_m.len()).step_by(7).map(attachment).collect(),
            rest_stress_pa: (0..n_tets).map(|_| std::array::from_fn(|_| stress_pa())).collect(),
            materials,
            uniform: LinearElastic::from_young_poisson(5000.0, 0.4, DENSITY_KG_PER_M3).unwrap(),
            fibres,
            damping: Rayleigh { mass_per_s: 10.0, stiffness_s: 0.0 },
            time_step_s: 2e-4,
            most_parts: 8,
            path: KernelPath::fastest(),
            mesh,
        }
    }

    pub(super) fn dynamic(&self) -> DynamicBody<'_> {
        DynamicBody {
            fixed: &self.fixed,
            attachments: &self.attachments,
            rest_stress_pa: &self.rest_stress_pa,
            damping: self.damping,
            time_step_s: self.time_step_s,
            most_parts: self.most_parts,
            ..DynamicBody::new(&self.mesh, DENSITY_KG_PER_M3)
        }
    }

    /// The same for the table of models.
    fn organ(&self) -> OrganBody {
        let mut organ = OrganBody::new(self.mesh.clone(), self.uniform, self.time_step_s);
        organ.fixed.clone_from(&self.fixed);
        organ.attachments.clone_from(&self.attachments);
        organ.rest_stress_pa.clone_from(&self.rest_stress_pa);
        organ.damping = self.damping;
        organ.most_parts = self.most_parts;
        organ
    }

    /// What new entities take from their parents, by the rules of the documents: the material of the parent with the
    /// most, the mean of stresses, supports that all parents have.
    pub(super) fn follow(&mut self, mesh: &EditableMesh, change: &TopologyChange) {
        self.mesh = mesh.mesh().clone();
        for (tet, parents) in change.tets.added.iter() {
            assert_eq!(tet.index(), self.materials.len());
            let most = parents.iter().map(|p| p.1).fold(0.0, f64::max);
            let source = parents.iter().find(|p| p.1 == most).expect("a parent").0.index();
            self.materials.push(self.materials[source]);
            self.fibres.push(self.fibres[source]);
            let mean = |k: usize| {
                parents.iter().map(|(p, weight)| weight * self.rest_stress_pa[p.index()][k]).sum::<f64>()
            };
            self.rest_stress_pa.push(std::array::from_fn(mean));
        }
        for (node, parents) in change.nodes.added.iter() {
            let axes_of = |n: NodeId| {
                self.fixed.iter().find(|fixed| fixed.node == n).map_or([false; 3], |fixed| fixed.axes)
            };
            let axes = std::array::from_fn(|axis| parents.iter().all(|(parent, _)| axes_of(*parent)[axis]));
            if axes != [false; 3] {
                self.fixed.push(FixedNode { node, axes });
            }
        }
    }

    /// After a compaction.
    pub(super) fn compact(&mut self, change: &TopologyChange) {
        let mut mesh = TetMesh::default();
        let keep = |n: usize| change.nodes.new_ids.get(n).is_none_or(|id| id.is_some());
        let of_tet = |t: usize| change.tets.new_ids.get(t).is_none_or(|id| id.is_some());
        let new = |n: NodeId| change.nodes.new_ids.get(n.index()).map_or(Some(n), |id| *id);
        mesh.positions_m
            .extend(self.mesh.positions_m.iter().enumerate().filter(|(n, _)| keep(*n)).map(|(_, x)| *x));
        let mut kept = Self { mesh, ..self.clone() };
        kept.materials.clear();
        kept.fibres.clear();
        kept.rest_stress_pa.clear();
        for t in (0..self.mesh.tetrahedra.len()).filter(|&t| of_tet(t)) {
            kept.mesh.tetrahedra.push(self.mesh.tetrahedra[t].map(|n| new(n).unwrap()));
            kept.materials.push(self.materials[t]);
            kept.fibres.push(self.fibres[t]);
            kept.rest_stress_pa.push(self.rest_stress_pa[t]);
        }
        kept.fixed =
            self.fixed.iter().filter_map(|f| new(f.node).map(|node| FixedNode { node, ..*f })).collect();
        kept.attachments = self
            .attachments
            .iter()
            .filter_map(|a| new(a.node).map(|node| Attachment { node, ..*a }))
            .collect();
        *self = kept;
    }

    /// Of the live tetrahedra; the nodes keep their numbers.
    pub(super) fn live(&self, mesh: &EditableMesh) -> Self {
        let live: Vec<usize> = mesh.topology().live_tets().map(TetId::index).collect();
        Self {
            mesh: TetMesh {
                positions_m: self.mesh.positions_m.clone(),
                tetrahedra: live.iter().map(|&t| self.mesh.tetrahedra[t]).collect(),
                ..TetMesh::default()
            },
            materials: live.iter().map(|&t| self.materials[t]).collect(),
            fibres: live.iter().map(|&t| self.fibres[t]).collect(),
            rest_stress_pa: live.iter().map(|&t| self.rest_stress_pa[t]).collect(),
            // A fresh model of slivers may not be stable with the step of the whole.
            time_step_s: 1e-7,
            ..self.clone()
        }
    }

    /// A law a tetrahedron, by its material: every third one of another kind.
    fn laws(&self) -> Vec<SharedMaterial> {
        let law = |material: &LinearElastic| -> SharedMaterial {
            match (material.mu_pa() * 1e6) as u64 % 3 {
                0 => Arc::new(NeoHookeLog::from(material)),
                1 => Arc::new(StableNeoHooke::from(material)),
                _ => Arc::new(MooneyRivlin::new(300.0, 200.0, 10_000.0).unwrap()),
            }
        };
        self.materials.iter().map(law).collect()
    }
}

type Build = fn(&Body) -> Box<dyn DeformableModel>;

/// A model and how it is made.
#[derive(Clone, Copy)]
pub(super) struct Kind {
    pub(super) name: &'static str,
    /// Which row of the table of models it is.
    row: &'static ModelRow,
    /// With what the row does not make it of; the row makes it for none.
    own: Option<Build>,
    /// Whether removals are undone with few numbers, and whether all edits are.
    pub(super) has_short_undo: [bool; 2],
}

impl Kind {
    pub(super) fn build(&self, body: &Body) -> Box<dyn DeformableModel> {
        match self.own {
            Some(build) => build(body),
            None => (self.row.make)(&body.organ(), None).unwrap(),
        }
    }

    pub(super) fn is_explicit(&self) -> bool {
        self.row.motion == ModelMotion::Explicit
    }

    /// Springs know no tetrahedron that a step would have to be shorter for.
    pub(super) fn has_law(&self) -> bool {
        !self.row.laws.is_empty()
    }
}

const fn kind(name: &'static str, row: ModelKind, build: Build) -> Kind {
    Kind { name, row: row.row(), own: Some(build), has_short_undo: [false; 2] }
}

const fn kernel(name: &'static str, build: Build) -> Kind {
    Kind { has_short_undo: [true; 2], ..kind(name, ModelKind::Explicit, build) }
}

/// Models whose row alone makes them that do not copy themselves whole for an undo: of removals, of all edits.
const SHORT_UNDO: [(ModelKind, [bool; 2]); 1] = [(ModelKind::TensorMass, [true, false])];

/// Every model that follows all edits: those of [`OWN`], the others as their row makes them.
pub(super) fn kinds() -> Vec<Kind> {
    let follows = |kind: &ModelKind| kind.row().edits == FollowedEdits::All;
    let is_own = |kind: &ModelKind| OWN.iter().any(|own| own.row.name == kind.name());
    let by_row = |kind: ModelKind| Kind {
        name: kind.name(),
        row: kind.row(),
        own: None,
        has_short_undo: SHORT_UNDO.iter().find(|short| short.0 == kind).map_or([false; 2], |short| short.1),
    };
    let others = ModelKind::ALL.into_iter().filter(|kind| follows(kind) && !is_own(kind)).map(by_row);
    OWN.into_iter().chain(others).collect()
}

/// With all that a model can be made of, where that is more than the table of models makes it of.
const OWN: [Kind; 16] = [
    kernel("explicit linear with fibres", |body| explicit(body, KernelLaw::Linear, false)),
    kernel("explicit St Venant-Kirchhoff with everything", |body| {
        explicit(body, KernelLaw::StVenantKirchhoff, true)
    }),
    kernel("explicit neo-Hooke", |body| explicit(body, KernelLaw::NeoHookeLog, false)),
    kernel("explicit stable neo-Hooke", |body| explicit(body, KernelLaw::StableNeoHooke, true)),
    kernel("explicit general", |body| explicit(body, KernelLaw::General, false)),
    kind("non-linear tensor-mass", ModelKind::NonlinearTensorMass, |body| {
        let elasticity = NonlinearElasticity {
            material: &body.uniform,
            fibres: &body.fibres,
            volume_penalty_pa: 2000.0,
            largest_stretch: 1.2,
        };
        let params = NonlinearTensorMassParams { body: body.dynamic(), elasticity };
        Box::new(NonlinearTensorMass::build(&params).unwrap())
    }),
    kind("mass-spring by volume", ModelKind::MassSpring, |body| {
        mass_spring(body, NodalMasses::VolumeWeighted)
    }),
    kind("mass-spring of equal masses", ModelKind::MassSpring, |body| mass_spring(body, NodalMasses::Equal)),
    kind("extended St Venant-Kirchhoff", ModelKind::ExtendedMassSpring, |body| {
        extended(body, EdgeLaw::StVenantKirchhoff)
    }),
    kind("extended neo-Hooke", ModelKind::ExtendedMassSpring, |body| extended(body, EdgeLaw::NeoHooke)),
    kind("implicit", ModelKind::Implicit, |body| {
        implicit(body, &ImplicitLaw::neo_hooke(&body.uniform), VolumeResistance::Element)
    }),
    kind("implicit, volume of nodes", ModelKind::Implicit, |body| {
        implicit(body, &ImplicitLaw::neo_hooke(&body.uniform), VolumeResistance::NodeAveraged)
    }),
    kind("implicit, strain of nodes", ModelKind::Implicit, |body| {
        implicit(body, &ImplicitLaw::neo_hooke(&body.uniform), VolumeResistance::NodeAveragedStrain)
    }),
    kind("implicit general", ModelKind::Implicit, |body| {
        let laws: Vec<SharedLaw> = body.laws();
        implicit(body, &ImplicitLaw::General(laws), VolumeResistance::Element)
    }),
    kind("hybrid", ModelKind::Hybrid, |body| moving_hybrid(body, ZoneLaw::TensorMass)),
    kind("hybrid St Venant-Kirchhoff", ModelKind::Hybrid, |body| {
        moving_hybrid(body, ZoneLaw::NonlinearTensorMass)
    }),
];

/// A hybrid all of which moves: of pre-computed tissue only the surface can be held.
fn moving_hybrid(body: &Body, law: ZoneLaw) -> Box<dyn DeformableModel> {
    let zones = Zones::new(&body.mesh, vec![0; body.mesh.tetrahedra.len()]).unwrap();
    let laws = [law];
    let params = CondensedParams::new(body.dynamic(), &body.uniform, &zones, &laws);
    Box::new(CondensedHybrid::build(&params).unwrap())
}

pub(super) fn series() -> PronySeries {
    PronySeries::new(&[PronyTerm { share: 0.3, time_s: 0.05 }]).unwrap()
}

fn explicit(body: &Body, law: KernelLaw, relaxes: bool) -> Box<dyn DeformableModel> {
    let has_fibres = matches!(law, KernelLaw::Linear | KernelLaw::StVenantKirchhoff);
    let (series, laws) = (series(), body.laws());
    let mut params = ExplicitKernelParams::new(body.dynamic(), law, &body.materials);
    params.path = body.path;
    if has_fibres {
        params.fibres = &body.fibres;
        params.volume_penalty_pa = 2000.0;
    }
    if law == KernelLaw::General {
        params.laws = &laws;
    }
    params.relaxation = relaxes.then_some(&series);
    Box::new(ExplicitKernel::build(&params).unwrap())
}

fn mass_spring(body: &Body, masses: NodalMasses) -> Box<dyn DeformableModel> {
    let params = MassSpringParams {
        body: body.dynamic(),
        young_modulus_pa: 5000.0,
        masses,
        link_damping_n_s_per_m: 0.0,
        node_damping_n_s_per_m: 0.0,
        integration: Integration::default(),
    };
    Box::new(MassSpring::build(&params).unwrap())
}

fn extended(body: &Body, law: EdgeLaw) -> Box<dyn DeformableModel> {
    let params = ExtendedMassSpringParams {
        body: body.dynamic(),
        law,
        material: &body.uniform,
        viscosity_kg_per_m3_s: 100.0,
        integration: Integration::default(),
    };
    Box::new(ExtendedMassSpring::build(&params).unwrap())
}

fn implicit(body: &Body, law: &ImplicitLaw, volume: VolumeResistance) -> Box<dyn DeformableModel> {
    let params = ImplicitParams { volume, tolerance: 1e-10, ..ImplicitParams::new(body.dynamic(), law) };
    Box::new(ImplicitEuler::build(&params).unwrap())
}
