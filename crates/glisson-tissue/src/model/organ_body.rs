//! An organ at rest, with all that its models are made from.

use super::hybrid::condensed::ZoneLaw;
use super::tet_law::Fibre;
use super::{
    Attachment, DEFAULT_MOST_PARTS, DynamicBody, FixedNode, Integration, ModelError, NodalForce, Rayleigh,
    RestStress,
};
use crate::material::{LawChoice, LinearElastic, PronySeries, PronyTerm};
use crate::workers::{Sequential, SharedWorkers};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::{NodeId, TetMesh};
use std::convert::Infallible;
use std::iter::repeat_n;
use std::path::PathBuf;
use std::sync::Arc;

/// St Venant-Kirchhoff tissue stiffens as it is stretched: its stable step is computed for principal stretches up
/// to this one. A choice, not a measurement: the law itself is meant for strains well below it.
pub(super) const LARGEST_STRETCH: f64 = 1.3;

/// How many times its value at rest the highest frequency of springs may become under deformation: the same
/// stretch, with the stiffness of a squared length in proportion to it.
const FREQUENCY_RESERVE: f64 = LARGEST_STRETCH;

/// A zone of the hybrid model.
#[derive(Clone, Debug, PartialEq)]
pub struct BodyZone {
    /// It has the tetrahedra with all corners among these nodes that are in no zone before it.
    pub nodes: Vec<NodeId>,
    /// What moves it at first.
    pub law: ZoneLaw,
}

/// Tissues of parts of a body that are not the body's own.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TissueParts {
    /// Elasticity of each. Their densities are not used: the body has one.
    pub materials: Vec<LinearElastic>,
    /// For each tetrahedron its part's number in `materials`; none where it is of the body's own tissue.
    pub of_tet: Vec<Option<u16>>,
}

/// Curves measured on a compressed cylinder of the tissue.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredSample {
    /// The file of the curves.
    pub curve: PathBuf,
    /// Height of the cylinder [m].
    pub height_m: f64,
    /// Its radius [m].
    pub radius_m: f64,
    /// Degree of the polynomials.
    pub degree: usize,
}

/// What the models of one organ are made from.
#[derive(Clone)]
pub struct OrganBody {
    /// The body at rest.
    pub mesh: TetMesh,
    /// Its elasticity at small strain, and its density.
    pub material: LinearElastic,
    /// Parts of other tissue, if any.
    pub tissue_parts: Option<TissueParts>,
    /// The material in words.
    pub material_text: String,
    /// The law of the models that have a choice; each its own when absent.
    pub law: Option<LawChoice>,
    /// Viscoelastic relaxation.
    pub relaxation: Vec<PronyTerm>,
    /// Stiffness along a direction.
    pub fibre: Option<Fibre>,
    /// Penalty on changes of volume [Pa].
    pub volume_penalty_pa: f64,
    /// Nodes held at rest along some axes, ascending.
    pub fixed: Vec<FixedNode>,
    /// Forces that other bodies exert on it in the shape of the mesh, ascending by node: loads of the stress at rest.
    pub carried: Vec<NodalForce>,
    /// Ligaments.
    pub attachments: Vec<Attachment>,
    /// Stress of the rest shape, one a tetrahedron or none.
    pub rest_stress_pa: Vec<RestStress>,
    /// Gravity of the start [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// Whether the rest shape is the one under this gravity; then `rest_stress_pa` balances it.
    pub is_imaged_under_gravity: bool,
    /// Damping.
    pub damping: Rayleigh,
    /// The world's time step [s].
    pub time_step_s: f64,
    /// Into how many internal steps it may be divided after an edit.
    pub most_parts: u32,
    /// Whether cuts are embedded ([`super::embedded`]), in models that follow all edits.
    pub embeds_cuts: bool,
    /// Whether positions inside may be some milliseconds old, in models that find those of the surface without them: not where tissue
    /// tears, which is looked for at all of them in every step. Cuts are planned with what is there.
    pub inside_may_lag: bool,
    /// A saved pre-computation.
    pub precomputed: Option<PathBuf>,
    /// Zones of the hybrid model.
    pub zones: Vec<BodyZone>,
    /// What the quasi non-linear model follows.
    pub measured: Option<MeasuredSample>,
    /// Who computes for models that can use several threads.
    pub workers: SharedWorkers,
}

/// A material's numbers in words, each to four figures.
fn numbers_text(material: &LinearElastic) -> String {
    format!(
        "(E {} kPa, nu {}, {} kg/m3)",
        figures(material.young_modulus_pa() / 1e3),
        figures(material.poisson_ratio()),
        material.density_kg_per_m3()
    )
}

fn figures(number: f64) -> f64 {
    format!("{number:.3e}").parse().unwrap_or(number)
}

impl OrganBody {
    /// A body without supports, loads and damping.
    pub fn new(mesh: TetMesh, material: LinearElastic, time_step_s: f64) -> Self {
        Self {
            material_text: numbers_text(&material),
            mesh,
            material,
            tissue_parts: None,
            law: None,
            relaxation: Vec::new(),
            fibre: None,
            volume_penalty_pa: 0.0,
            fixed: Vec::new(),
            carried: Vec::new(),
            attachments: Vec::new(),
            rest_stress_pa: Vec::new(),
            gravity_m_per_s2: DVec3::ZERO,
            is_imaged_under_gravity: true,
            damping: Rayleigh::default(),
            time_step_s,
            most_parts: DEFAULT_MOST_PARTS,
            embeds_cuts: false,
            inside_may_lag: false,
            precomputed: None,
            zones: Vec::new(),
            measured: None,
            workers: Arc::new(Sequential),
        }
    }

    /// Other elasticity, also in words.
    pub fn set_material(&mut self, material: LinearElastic) {
        self.material_text =
            self.material_text.replace(&numbers_text(&self.material), &numbers_text(&material));
        self.material = material;
    }

    /// What keeps the body in its place at rest: supports, and nodes at which others carry it; ascending.
    pub fn held_at_rest(&self) -> Vec<FixedNode> {
        let mut held = self.fixed.clone();
        held.extend(self.carried.iter().map(|force| FixedNode::all_axes(force.node)));
        held.sort_by_key(|held| held.node);
        held.dedup_by(|next, kept| {
            let is_same = next.node == kept.node;
            if is_same {
                kept.axes = std::array::from_fn(|axis| kept.axes[axis] || next.axes[axis]);
            }
            is_same
        });
        held
    }

    /// What every dynamic model takes.
    pub(super) fn dynamic(&self) -> DynamicBody<'_> {
        DynamicBody {
            mesh: &self.mesh,
            density_kg_per_m3: self.material.density_kg_per_m3(),
            fixed: &self.fixed,
            attachments: &self.attachments,
            rest_stress_pa: &self.rest_stress_pa,
            gravity_m_per_s2: self.gravity_m_per_s2,
            damping: self.damping,
            time_step_s: self.time_step_s,
            most_parts: self.most_parts,
        }
    }

    /// Time integration of springs.
    pub(super) fn integration(&self) -> Integration {
        Integration { frequency_reserve: FREQUENCY_RESERVE, ..Integration::default() }
    }

    /// The fibre of every tetrahedron, or none.
    pub(super) fn fibres(&self) -> Vec<Fibre> {
        self.fibre.iter().flat_map(|&fibre| repeat_n(fibre, self.mesh.tetrahedra.len())).collect()
    }

    /// What `of_tissue` makes of the elasticity: one value, or with parts of other tissue one for each tetrahedron. It is asked once
    /// a tissue.
    pub(super) fn of_tissues<T: Clone, E>(
        &self,
        of_tissue: impl Fn(&LinearElastic) -> Result<T, E>,
    ) -> Result<Vec<T>, E> {
        let own = of_tissue(&self.material)?;
        let Some(parts) = &self.tissue_parts else { return Ok(vec![own]) };
        let of_parts: Vec<T> = parts.materials.iter().map(of_tissue).collect::<Result<_, _>>()?;
        let of_tet = |part: &Option<u16>| part.map_or(&own, |part| &of_parts[usize::from(part)]).clone();
        Ok(parts.of_tet.iter().map(of_tet).collect())
    }

    /// The elasticity: of the whole, or of each tetrahedron.
    pub(super) fn materials(&self) -> Vec<LinearElastic> {
        let Ok(materials) = self.of_tissues(|material| Ok::<_, Infallible>(*material));
        materials
    }

    /// How the stress relaxes, if it does.
    pub(super) fn series(&self) -> Result<Option<PronySeries>, ModelError> {
        if self.relaxation.is_empty() {
            return Ok(None);
        }
        Ok(Some(PronySeries::new(&self.relaxation)?))
    }
}
