//! The layout of a body's memory.

use super::element::{ElementLaw, Linear, StVenantKirchhoff};
use super::extras::{ExtraKinds, Extras};
use super::general::{General, SharedMaterial};
use super::neo_hooke::{NeoHookeLog, StableNeoHooke};
use super::order::{PartPlan, Place, partition};
use super::part::{
    Elements, Exchange, ForceMode, Layout, Part, PartNodes, Parts, Progress, Relaxation, borrowed_row,
};
use super::quarantine::NO_TET;
use super::rows::{Block, N_LANES, offset_of};
use super::step::StepFactors;
use super::{FastKernel, KernelError, KernelLaw, KernelParams, TetPlace};
use crate::material::{LinearElastic, PronySeries};
use crate::model::RestStress;
use crate::model::bounded_vec::BoundedVec;
use crate::model::tet_law::{Fibre, TetLaw};
use crate::solve::{P1Gradients, SolveError};
use glisson_mesh::mesh::TetId;

/// Optional parts of the stress besides the law. Those that are not used cost nothing.
#[derive(Clone, Copy, Default)]
pub struct KernelExtras<'a> {
    /// Stress in the rest shape [Pa], none or one per tetrahedron. Adds V P = V F S_0, for [`KernelLaw::Linear`]
    /// V S_0: at rest it balances the weight that it was computed for.
    pub rest_stress_pa: &'a [RestStress],
    /// Stiffness along a direction, none or one per tetrahedron, beside lambda and mu of its
    /// [`KernelParams::materials`] (seed `002`, eq. 7).
    pub fibres: &'a [Fibre],
    /// gamma of the signed penalty of volume changes [Pa]; from 0, which is none (seed `004`, s. 3.2).
    pub volume_penalty_pa: f64,
    /// The laws of [`KernelLaw::General`], one or one per tetrahedron; none for other laws.
    pub laws: &'a [SharedMaterial],
    /// Relaxation of the stress of law and fibres.
    pub relaxation: Option<&'a PronySeries>,
}

impl std::fmt::Debug for KernelExtras<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("KernelExtras")
            .field("rest_stress_pa", &self.rest_stress_pa.len())
            .field("fibres", &self.fibres.len())
            .field("volume_penalty_pa", &self.volume_penalty_pa)
            .field("laws", &self.laws.len())
            .field("relaxation", &self.relaxation)
            .finish()
    }
}

fn check(params: &KernelParams<'_>, extras: &KernelExtras<'_>) -> Result<(), KernelError> {
    let KernelParams { mesh, materials, law, .. } = *params;
    let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
    if n_tets == 0 {
        return Err(SolveError::EmptyMesh.into());
    }
    if materials.len() != 1 && materials.len() != n_tets {
        return Err(KernelError::Materials { found: materials.len(), n_tets });
    }
    let n_laws = extras.laws.len();
    let n_laws_fit = if law == KernelLaw::General { n_laws == 1 || n_laws == n_tets } else { n_laws == 0 };
    if !n_laws_fit {
        return Err(KernelError::Laws { found: n_laws, law, n_tets });
    }
    for (what, found) in
        [("stresses in the rest shape", extras.rest_stress_pa.len()), ("fibres", extras.fibres.len())]
    {
        if found != 0 && found != n_tets {
            return Err(KernelError::ExtraCount { what, found, n_tets });
        }
    }
    if let Some(t) = extras.rest_stress_pa.iter().position(|s| !s.iter().all(|s| s.is_finite())) {
        return Err(KernelError::RestStress { tet: TetId::from_index(t) });
    }
    let found_pa = extras.volume_penalty_pa;
    if !(found_pa.is_finite() && found_pa >= 0.0) {
        return Err(KernelError::VolumePenalty { found_pa });
    }
    for (t, nodes) in mesh.tetrahedra.iter().enumerate() {
        let tet = TetId::from_index(t);
        if let Some(&node) = nodes.iter().find(|n| n.index() >= n_nodes) {
            return Err(SolveError::NodeOutOfRange { tet, node, n_nodes }.into());
        }
        if let Some(&node) = nodes.iter().find(|n| !mesh.positions_m[n.index()].is_finite()) {
            let position_m = mesh.positions_m[node.index()].to_array();
            return Err(SolveError::NonFinitePosition { node, position_m }.into());
        }
    }
    Ok(())
}

/// The two numbers of a tetrahedron, see [`ElementLaw::numbers`].
fn law_numbers(law: KernelLaw, volume_m3: f64, material: &LinearElastic) -> [f64; 2] {
    let (lambda_pa, mu_pa) = (material.lambda_pa(), material.mu_pa());
    match law {
        KernelLaw::Linear => Linear::numbers(volume_m3, lambda_pa, mu_pa),
        KernelLaw::StVenantKirchhoff => StVenantKirchhoff::numbers(volume_m3, lambda_pa, mu_pa),
        KernelLaw::NeoHookeLog => NeoHookeLog::numbers(volume_m3, lambda_pa, mu_pa),
        KernelLaw::StableNeoHooke => StableNeoHooke::numbers(volume_m3, lambda_pa, mu_pa),
        KernelLaw::General => General::numbers(volume_m3, lambda_pa, mu_pa),
    }
}

impl Elements {
    fn zero(n_blocks: usize, law: KernelLaw, kinds: ExtraKinds) -> Self {
        let n_laws = if law == KernelLaw::General { n_blocks } else { 0 };
        Self {
            spare: BoundedVec::with_capacity(N_LANES * n_blocks),
            blocks: vec![Block::EMPTY; n_blocks],
            extras: Extras::zero(n_blocks, kinds),
            law_of: vec![[0; N_LANES]; n_laws],
            tets: vec![[NO_TET; N_LANES]; n_blocks],
        }
    }

    /// Writes a tetrahedron of this shape to a lane that is empty or its own.
    pub(super) fn put(
        &mut self,
        [block, lane]: [usize; 2],
        tet: TetId,
        gradients: &P1Gradients,
        params: &KernelParams<'_>,
        extras: &KernelExtras<'_>,
    ) -> Result<(), KernelError> {
        let (t, volume_m3) = (tet.index(), gradients.volume_m3);
        let material = of_tet(params.materials, t);
        self.tets[block][lane] = tet;
        for k in 0..3 {
            for (axis, alpha) in gradients.alpha_per_m[k + 1].to_array().into_iter().enumerate() {
                self.blocks[block].alpha_per_m[k][axis][lane] = alpha;
            }
        }
        let numbers = law_numbers(params.law, volume_m3, material);
        for (lanes, number) in self.blocks[block].material.iter_mut().zip(numbers) {
            lanes[lane] = number;
        }
        if let Some(law_of) = self.law_of.get_mut(block) {
            let which = if extras.laws.len() == 1 { 0 } else { t };
            law_of[lane] = u32::try_from(which).expect("fewer than 2^32 tetrahedra");
        }
        if let Some(rest_stress) = self.extras.rest_stress.get_mut(block) {
            for (lanes, stress_pa) in rest_stress.iter_mut().zip(extras.rest_stress_pa[t]) {
                lanes[lane] = volume_m3 * stress_pa;
            }
        }
        if let Some(fibre) = self.extras.fibres.get_mut(block) {
            let law = TetLaw::with_fibre(material, &extras.fibres[t], tet)?;
            for (lanes, a) in fibre.direction.iter_mut().zip(law.direction.to_array()) {
                lanes[lane] = a;
            }
            fibre.stiffness[lane] = volume_m3 * law.kappa_pa;
        }
        if let Some(penalty) = self.extras.penalty.get_mut(block) {
            penalty[lane] = 3.0 * extras.volume_penalty_pa * volume_m3;
        }
        Ok(())
    }
}

/// The common value, or that of this tetrahedron.
pub(super) fn of_tet<T>(values: &[T], t: usize) -> &T {
    &values[if values.len() == 1 { 0 } else { t }]
}

impl FastKernel {
    /// Sorts the mesh in space and lays out its memory; the body is at rest, no node is held.
    ///
    /// # Errors
    /// [`KernelError`]: an empty mesh, missing nodes, flat or inverted tetrahedra, a wrong number of materials.
    pub fn new(params: &KernelParams<'_>) -> Result<Self, KernelError> {
        Self::with_extras(params, &KernelExtras::default())
    }

    /// [`FastKernel::new`] for a body with extras.
    ///
    /// # Errors
    /// [`KernelError`] as of [`FastKernel::new`], and for wrong numbers of extras or impossible ones.
    pub fn with_extras(params: &KernelParams<'_>, extras: &KernelExtras<'_>) -> Result<Self, KernelError> {
        Self::of_live(params, extras, &vec![true; params.mesh.tetrahedra.len()])
    }

    /// [`FastKernel::with_extras`] of the live tetrahedra alone.
    ///
    /// # Errors
    /// [`KernelError`] as of [`FastKernel::with_extras`].
    pub(in crate::model) fn of_live(
        params: &KernelParams<'_>,
        extras: &KernelExtras<'_>,
        is_live: &[bool],
    ) -> Result<Self, KernelError> {
        check(params, extras)?;
        let mesh = params.mesh;
        let (plans, node_places) = partition(mesh, is_live);
        let mut layout = BodyLayout::new(params, extras);
        let mut parts = Vec::with_capacity(plans.len());
        for (p, plan) in plans.iter().enumerate() {
            parts.push(layout.part(p, plan)?);
        }
        connect(&parts, &plans, &node_places);
        let parts = Parts {
            law: params.law,
            laws: extras.laws.to_vec().into(),
            relaxation: extras.relaxation.map(|series| Relaxation::new(series.clone()).into()),
            mode: ForceMode::default().into(),
            path: params.path.into(),
            all: parts,
            step: StepFactors::default().into(),
        };
        let n_laid_out = is_live.iter().filter(|live| **live).count();
        let BodyLayout { tet_places, mass_share_kg, .. } = layout;
        let kernel = Self { node_places, tet_places, mass_share_kg, n_laid_out, ..Self::of_parts(parts) };
        for (t, nodes) in mesh.tetrahedra.iter().enumerate().filter(|(t, _)| is_live[*t]) {
            for node in nodes {
                kernel.change_mass(*node, kernel.mass_share_kg[t], 1);
            }
        }
        Ok(kernel)
    }
}

/// Lays out the memory of a body part by part, and records the place of each tetrahedron.
struct BodyLayout<'a> {
    params: &'a KernelParams<'a>,
    extras: &'a KernelExtras<'a>,
    kinds: ExtraKinds,
    n_histories: usize,
    tet_places: Vec<TetPlace>,
    mass_share_kg: Vec<f64>,
    /// Row of each node in the part under construction.
    row_of: Vec<usize>,
}

impl<'a> BodyLayout<'a> {
    fn new(params: &'a KernelParams<'a>, extras: &'a KernelExtras<'a>) -> Self {
        let n_tets = params.mesh.tetrahedra.len();
        Self {
            params,
            extras,
            kinds: ExtraKinds {
                rest_stress: !extras.rest_stress_pa.is_empty(),
                fibres: !extras.fibres.is_empty(),
                penalty: extras.volume_penalty_pa > 0.0,
            },
            n_histories: extras.relaxation.map_or(0, |series| 1 + series.terms().len()),
            tet_places: vec![TetPlace { part: 0, block: 0, lane: 0, is_live: false }; n_tets],
            mass_share_kg: vec![0.0; n_tets],
            row_of: vec![0; params.mesh.positions_m.len()],
        }
    }

    /// Part `p` at rest.
    fn part(&mut self, p: usize, plan: &PartPlan) -> Result<Part, KernelError> {
        for (row, node) in plan.own.iter().enumerate() {
            self.row_of[node.index()] = row;
        }
        for (i, node) in plan.borrowed.iter().enumerate() {
            self.row_of[node.index()] = borrowed_row(i);
        }
        let elements = self.elements(p, plan)?;
        let history = vec![[0.0; N_LANES]; 6 * self.n_histories * elements.blocks.len()];
        let progress = Progress { history, ..Progress::default() };
        let nodes = PartNodes::at_rest(plan.own.len());
        let layout = Layout { own: plan.own.clone(), n_borrowed: plan.borrowed.len(), ..Layout::default() };
        Ok(Part::new(layout, elements, progress, nodes))
    }

    /// The tetrahedra of part `p`, whose nodes have their rows.
    fn elements(&mut self, p: usize, plan: &PartPlan) -> Result<Elements, KernelError> {
        let KernelParams { mesh, law, materials, .. } = *self.params;
        let n_blocks = plan.tets.len().div_ceil(N_LANES);
        let mut elements = Elements::zero(n_blocks, law, self.kinds);
        for (i, &tet) in plan.tets.iter().enumerate() {
            // Each lane has its own consecutive stretch of tetrahedra.
            let (lane, block) = (i / n_blocks, i % n_blocks);
            let gradients = P1Gradients::of_tet(mesh, tet)?;
            elements.blocks[block].offsets[lane] =
                mesh.tetrahedra[tet.index()].map(|n| offset_of(self.row_of[n.index()]));
            elements.put([block, lane], tet, &gradients, self.params, self.extras)?;
            let density_kg_per_m3 = of_tet(materials, tet.index()).density_kg_per_m3();
            self.mass_share_kg[tet.index()] = 0.25 * density_kg_per_m3 * gradients.volume_m3;
            let number = |i: usize| u32::try_from(i).expect("fewer than 2^32 tetrahedra");
            self.tet_places[tet.index()] =
                TetPlace { part: number(p), block: number(block), lane: lane as u8, is_live: true };
        }
        for empty in (plan.tets.len()..N_LANES * n_blocks).rev() {
            elements.spare.push([(empty % n_blocks) as u32, (empty / n_blocks) as u32]);
        }
        Ok(elements)
    }
}

/// Connects borrowed rows with their owners.
fn connect(parts: &[Part], plans: &[PartPlan], node_places: &[Option<Place>]) {
    for (p, plan) in plans.iter().enumerate() {
        for (i, node) in plan.borrowed.iter().enumerate() {
            let owner = node_places[node.index()].expect("a borrowed node has an owner");
            share_row(parts, [p, borrowed_row(i)], [owner.part as usize, owner.index as usize]);
        }
    }
}

/// Connects a borrowed row with its owner's row, each given as part and row.
pub(super) fn share_row(parts: &[Part], [p, here]: [usize; 2], [owner, there]: [usize; 2]) {
    let row = |i: usize| u16::try_from(i).expect("parts are small");
    let (here, there) = (row(here), row(there));
    add_rows(&mut parts[p].layout_mut().borrowed, owner, [here, there]);
    add_rows(&mut parts[owner].layout_mut().lent, p, [there, here]);
}

fn add_rows(exchanges: &mut Vec<Exchange>, part: usize, rows: [u16; 2]) {
    match exchanges.last_mut() {
        Some(last) if last.part == part => last.rows.push(rows),
        _ => exchanges.push(Exchange { part, rows: vec![rows] }),
    }
}
