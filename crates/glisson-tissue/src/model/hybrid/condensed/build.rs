//! Set-up: the tables of the pre-computed zones, their interface, and the dynamic part.

use super::contact::ContactSystem;
use super::dynamic::{DynamicPart, DynamicSource};
use super::interface::{Composed, Interface};
use super::zone::{N_CONSTANT, PrecomputedZone, Whole};
use super::{
    Age, CondensedError, CondensedHybrid, CondensedParams, Loadable, Place, Updated, ZoneLaw, ZoneWork,
};
use crate::model::bounded_vec::BoundedVec;
use crate::model::explicit::{ExplicitError, check_body};
use crate::model::{Attachment, Constraints, DynamicBody, LocalModel};
use crate::solve::{FixedNode, MeshEdges, SolveError, boundary_nodes};
use glisson_mesh::math::DVec3;
use glisson_mesh::mesh::NodeId;
use glisson_mesh::mesh::zones::ZonesError;

/// Refuses parameters that do not fit together.
fn check(params: &CondensedParams<'_>) -> Result<(), CondensedError> {
    check_body(&params.body)?;
    let (zones, laws, mesh) = (params.zones, params.laws, params.body.mesh);
    let n_tets = mesh.tetrahedra.len();
    if zones.of_tets().len() != n_tets {
        return Err(ZonesError::Length { found: zones.of_tets().len(), expected: n_tets }.into());
    }
    if laws.len() != zones.n_zones() {
        return Err(CondensedError::Laws { found: laws.len(), n_zones: zones.n_zones() });
    }
    if !params.cut_law.is_dynamic() {
        return Err(CondensedError::CutLaw { found: params.cut_law });
    }
    let largest = params.largest_stretch;
    if !(largest.is_finite() && largest >= 1.0) {
        let (what, allowed) = ("largest stretch", "a finite number from 1");
        return Err(ExplicitError::Parameter { what, found: largest, allowed }.into());
    }
    MeshEdges::of_mesh(mesh)?;
    Ok(())
}

/// Axes along which each node is held by some support.
fn held_axes_of(fixed: &[FixedNode], n_nodes: usize) -> Vec<[bool; 3]> {
    let mut held_axes = vec![[false; 3]; n_nodes];
    for fixed in fixed {
        let axes = &mut held_axes[fixed.node.index()];
        axes.iter_mut().zip(fixed.axes).for_each(|(held, also)| *held |= also);
    }
    held_axes
}

/// One flag per node: whether it is in the list.
fn marked(nodes: &[NodeId], n_nodes: usize) -> Vec<bool> {
    let mut is_marked = vec![false; n_nodes];
    nodes.iter().for_each(|n| is_marked[n.index()] = true);
    is_marked
}

/// One flag per node: whether tools can hold it.
///
/// # Errors
/// [`SolveError::ConditionOutOfRange`] for a node that the mesh does not have.
fn loadable_nodes(
    loadable: Loadable<'_>,
    surface: &[NodeId],
    n_nodes: usize,
) -> Result<Vec<bool>, SolveError> {
    let nodes = match loadable {
        Loadable::All => return Ok(vec![true; n_nodes]),
        Loadable::Nodes(nodes) => nodes,
        Loadable::Surface => surface,
    };
    match nodes.iter().find(|n| n.index() >= n_nodes) {
        Some(&node) => Err(SolveError::ConditionOutOfRange { node, n_nodes }),
        None => Ok(marked(nodes, n_nodes)),
    }
}

/// The pre-computed zones and their numbers.
struct Tables {
    zones: Vec<PrecomputedZone>,
    zone_numbers: Vec<u32>,
}

impl Tables {
    /// Computes each pre-computed zone from its own tetrahedra.
    fn build(params: &CondensedParams<'_>, held: &[[bool; 3]]) -> Result<Self, SolveError> {
        let CondensedParams { body, material, zones, laws, stored, precision, .. } = *params;
        let n_nodes = body.mesh.positions_m.len();
        let surface = boundary_nodes(body.mesh);
        let whole = Whole {
            mesh: body.mesh,
            material,
            density_kg_per_m3: body.density_kg_per_m3,
            rest_stress_pa: body.rest_stress_pa,
            held,
            is_loadable: &loadable_nodes(params.loadable, &surface, n_nodes)?,
            is_surface: &marked(&surface, n_nodes),
            is_frontier: &marked(zones.frontier_nodes(), n_nodes),
            stored,
            precision,
        };
        let is_precomputed = |&z: &usize| laws[z] == ZoneLaw::Precomputed;
        let zone_numbers: Vec<u32> = (0..laws.len()).filter(is_precomputed).map(|z| z as u32).collect();
        let mut tables = Vec::with_capacity(zone_numbers.len());
        for &z in &zone_numbers {
            tables.push(PrecomputedZone::build(&whole, &zones.tets(z as usize).collect::<Vec<_>>())?);
        }
        Ok(Self { zones: tables, zone_numbers })
    }
}

impl CondensedHybrid {
    /// Pre-computes the zones, over the threads of the rayon pool.
    ///
    /// # Errors
    /// [`CondensedError`] naming the fault.
    pub fn build(params: &CondensedParams<'_>) -> Result<Self, CondensedError> {
        check(params)?;
        let mut model = Self::without_dynamic_part(params)?;
        model.make_room();
        model.find_dynamic_nodes();
        // One at a node that is held, or has no tissue, does nothing.
        let follows =
            |node: NodeId| model.zones.iter().any(|z| z.nodes.iter().chain(&z.frontier).any(|n| *n == node));
        let is_dynamic = |a: &Attachment| model.is_dynamic[a.node.index()];
        if let Some(a) = model.attachments.iter().find(|a| !is_dynamic(a) && follows(a.node)) {
            return Err(CondensedError::Ligament { node: a.node });
        }
        if let Some((_, error)) = model.unsupported_zones().into_iter().next() {
            return Err(error.into());
        }
        model.bring_together(None)?;
        Ok(model)
    }

    /// The body with its tables, at rest and without loads; the zones are not brought together yet.
    fn without_dynamic_part(params: &CondensedParams<'_>) -> Result<Self, CondensedError> {
        let CondensedParams { body, precision, .. } = *params;
        let mesh = body.mesh;
        let (n_nodes, n_tets) = (mesh.positions_m.len(), mesh.tetrahedra.len());
        let held_axes = held_axes_of(body.fixed, n_nodes);
        let Tables { zones, zone_numbers } = Tables::build(params, &held_axes)?;
        let is_dynamic = vec![false; n_nodes];
        Ok(Self {
            mesh: mesh.clone(),
            material: *params.material,
            density_kg_per_m3: body.density_kg_per_m3,
            rest_stress_pa: body.rest_stress_pa.to_vec(),
            attachments: body.attachments.to_vec(),
            gravity_m_per_s2: body.gravity_m_per_s2,
            damping: body.damping,
            time_step_s: body.time_step_s,
            most_parts: body.most_parts,
            stored: params.stored,
            precision,
            is_live: vec![true; n_tets],
            zone_of_tet: params.zones.of_tets().to_vec(),
            laws: params.laws.to_vec(),
            cut_law: params.cut_law,
            largest_stretch: params.largest_stretch,
            is_cut: false,
            ages: vec![[Age::GIVEN; 3]; zones.len()],
            zones,
            zone_numbers,
            interface: Interface::build(&mut [], &is_dynamic, &held_axes, None, precision)?,
            dynamic: None,
            place: vec![Place::Nowhere; n_nodes],
            is_dynamic,
            positions_m: mesh.positions_m.clone(),
            velocities_m_per_s: vec![DVec3::ZERO; n_nodes],
            condensed_age: Age::GIVEN,
            constraints: Constraints::default(),
            loads: BoundedVec::with_capacity(n_nodes),
            held: BoundedVec::with_capacity(Self::MAX_HELD),
            dynamic_constraints: Constraints::default(),
            dynamic_places: BoundedVec::with_capacity(n_nodes),
            constraint_forces_n: BoundedVec::with_capacity(n_nodes),
            n_ignored: 0,
            n_dropped: 0,
            n_rebuilt: 0,
            updated: Updated::default(),
            work: Vec::new(),
            constant: Vec::new(),
            reduced: Vec::new(),
            row: Vec::new(),
            system: ContactSystem::with_room_for(3 * Self::MAX_HELD),
            local: LocalModel::new(),
            held_axes,
        })
    }

    /// Makes the interface and the dynamic part for the laws as they are. `before`: how the zones' compliances are
    /// composed.
    pub(super) fn bring_together(&mut self, before: Option<&Composed>) -> Result<(), CondensedError> {
        self.interface =
            Interface::build(&mut self.zones, &self.is_dynamic, &self.held_axes, before, self.precision)?;
        self.dynamic = self.dynamic_part(None)?;
        self.find_places();
        self.make_scratch();
        self.combine_constant_loads();
        Ok(())
    }

    /// The dynamic zones at rest, or nothing when there are none. `before`: those of before an edit, under the same laws.
    pub(super) fn dynamic_part(
        &self,
        before: Option<&DynamicPart>,
    ) -> Result<Option<DynamicPart>, ExplicitError> {
        let law_of_tet: Vec<ZoneLaw> = (0..self.mesh.tetrahedra.len()).map(|t| self.law_of(t)).collect();
        let body = DynamicBody {
            mesh: &self.mesh,
            density_kg_per_m3: self.density_kg_per_m3,
            fixed: &[],
            attachments: &self.attachments,
            rest_stress_pa: &[],
            gravity_m_per_s2: self.gravity_m_per_s2,
            damping: self.damping,
            time_step_s: self.time_step_s,
            most_parts: self.most_parts,
        };
        let mut dynamic = DynamicPart::build(&DynamicSource {
            whole: &self.whole(),
            body: &body,
            law_of_tet: &law_of_tet,
            is_live_tet: &self.is_live,
            largest_stretch: self.largest_stretch,
            is_dynamic: &self.is_dynamic,
            is_cut: self.is_cut,
            before,
        })?;
        if let Some(dynamic) = &mut dynamic {
            let nodes = &self.interface.nodes[self.interface.n_condensed..];
            dynamic.set_frontier(nodes, self.interface.stiffness_tiles.padded_len());
        }
        Ok(dynamic)
    }

    /// Finds what each node belongs to.
    pub(super) fn find_places(&mut self) {
        self.place.clear();
        self.place.resize(self.mesh.positions_m.len(), Place::Nowhere);
        for (z, zone) in self.zones.iter().enumerate() {
            for (own, n) in zone.nodes.iter().enumerate() {
                self.place[n.index()] = Place::Own { zone: z as u32, own: own as u32 };
            }
        }
        for (p, n) in self.interface.nodes[..self.interface.n_condensed].iter().enumerate() {
            self.place[n.index()] = Place::Condensed(p as u32);
        }
        if let Some(dynamic) = &self.dynamic {
            for (local, n) in dynamic.moving().filter(|&(_, n)| self.is_dynamic[n]) {
                self.place[n] = Place::Dynamic(local as u32);
            }
        }
    }

    /// Makes the arrays that a step writes to.
    fn make_scratch(&mut self) {
        let n_p = 3 * self.interface.n_condensed;
        let work_of = |zone: &PrecomputedZone| ZoneWork {
            constant_m: vec![0.0; 3 * zone.nodes.len()],
            base_m: vec![0.0; 3 * zone.n_stored],
            rows_m: vec![0.0; 3 * zone.n_stored],
            own_m: vec![0.0; n_p],
            frontier: vec![0.0; 3 * zone.frontier.len()],
            ..ZoneWork::default()
        };
        self.work = self.zones.iter().map(work_of).collect();
        self.constant = vec![0.0; 3 * self.interface.nodes.len()];
        self.reduced = self.constant.clone();
        self.row = vec![0.0; n_p];
    }

    /// Brings together what weight and stress at rest do to the pre-computed zones.
    pub(super) fn combine_constant_loads(&mut self) {
        let [x, y, z] = self.gravity_m_per_s2.to_array();
        let factors: [f64; N_CONSTANT] = [x, y, z, 1.0];
        self.constant.fill(0.0);
        self.interface.constant.add_times(&factors, &mut self.constant);
        let n_p = 3 * self.interface.n_condensed;
        for (z, (zone, work)) in self.zones.iter().zip(&mut self.work).enumerate() {
            work.constant_m.fill(0.0);
            zone.constant_response.add_times(&factors, &mut work.constant_m);
            work.base_m.copy_from_slice(&work.constant_m[..3 * zone.n_stored]);
            let constant = &self.constant;
            let places = &self.interface.places[z];
            let of_condensed = (0..3 * zone.frontier.len())
                .map(|c| (c, 3 * places[c / 3] as usize + c % 3))
                .filter(|&(_, at)| at < n_p)
                .map(|(c, at)| (c, constant[at]));
            zone.extension.add_weighted(of_condensed, &mut work.base_m);
        }
    }
}
