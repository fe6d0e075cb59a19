//! Set-up of the zones: their matrices, their tensors, and their links to neighbours.

use super::dynamic::{DynamicZones, Rates};
use super::zone::{Incoming, Lists, NONE, PrecomputedZone, Shared};
use super::{
    Body, ExchangeAmount, ExchangeCount, ExchangeError, ExchangeParams, HybridExchange, Method, Overlap,
    Settings, ZoneLaw, edge_tensor, room_for_constraints,
};
use crate::model::hybrid::kirchhoff::KirchhoffTet;
use crate::model::tensor_mass::TensorMass;
use crate::model::tet_law::TetLaw;
use crate::solve::{
    BoundaryConditions, FreeSystem, MeshEdges, P1Gradients, SolveError, StiffnessTensors, TetStiffness,
    boundary_nodes, solve_columns_into,
};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use std::sync::Arc;

/// # Errors
/// [`ExchangeError::Parameter`] for zero sweeps.
pub(super) fn check_sweeps(sweeps_per_step: u32) -> Result<(), ExchangeError> {
    check("the number of sweeps in a step", f64::from(sweeps_per_step), sweeps_per_step > 0, "at least 1")
}

fn check(
    what: &'static str,
    found: f64,
    is_allowed: bool,
    allowed: &'static str,
) -> Result<(), ExchangeError> {
    if is_allowed { Ok(()) } else { Err(ExchangeError::Parameter { what, found, allowed }) }
}

fn check_params(params: &ExchangeParams<'_>) -> Result<(), ExchangeError> {
    let (found, n_zones) = (params.laws.len(), params.zones.n_zones());
    if found != n_zones {
        return Err(ExchangeError::LawCount { found, n_zones });
    }
    if params.cut_law == ZoneLaw::Precomputed {
        return Err(ExchangeError::CutLaw);
    }
    let (found, n_tets) = (params.zones.of_tets().len(), params.mesh.tetrahedra.len());
    check("the number of tetrahedra of the zones", found as f64, found == n_tets, "that of the mesh")?;
    check_sweeps(params.sweeps_per_step)?;
    let d = params.damping_per_s;
    check("the damping [1/s]", d, d >= 0.0 && d.is_finite(), "0 or more")?;
    match params.amount {
        ExchangeAmount::All => {}
        ExchangeAmount::InTurn { n_sets } => {
            check("the number of sets of frontier nodes", f64::from(n_sets), n_sets > 0, "at least 1")?;
        }
        ExchangeAmount::Largest { share } => {
            check("the share of the largest change", share, (0.0..=1.0).contains(&share), "0 to 1")?;
        }
    }
    match params.overlap {
        Overlap::OneNode { relaxation: r } => {
            check("the relaxation", r, r > 0.0 && r <= 1.0, "above 0, at most 1")
        }
        Overlap::Nodes(n) => {
            check(
                "the overlap in nodes",
                f64::from(n),
                n >= 2,
                "at least 2, or OneNode with its relaxation",
            )?;
            // A wider overlap reads inner nodes of the neighbour.
            let has_all = n == 2 || params.method == Method::AllNodes;
            check("the overlap in nodes", f64::from(n), has_all, "2 with method A, more with all nodes kept")
        }
    }
}

/// Non-linear zones stiffen as they stretch: their step is stable for principal stretches up to this one. A choice.
const LARGEST_STRETCH: f64 = 1.3;

const NOTHING: TetStiffness = TetStiffness { vertex: [DMat3::ZERO; 4], edge: [DMat3::ZERO; 6] };

impl Body {
    /// The body of these parameters.
    ///
    /// # Errors
    /// [`SolveError`] for a mesh or support without solution.
    fn of(params: &ExchangeParams<'_>) -> Result<Self, SolveError> {
        let mesh = params.mesh;
        let n_nodes = mesh.positions_m.len();
        let edges = MeshEdges::of_mesh(mesh)?;
        BoundaryConditions::fixed(params.fixed_nodes).check(mesh, &edges)?;
        let flags = |nodes: &[NodeId]| {
            let mut is_marked = vec![false; n_nodes];
            nodes.iter().for_each(|node| is_marked[node.index()] = true);
            is_marked
        };
        let mut around = vec![Vec::new(); n_nodes];
        for (e, &[p, q]) in edges.nodes.iter().enumerate() {
            around[p.index()].push((q, e as u32));
            around[q.index()].push((p, e as u32));
        }
        Ok(Self {
            mesh: mesh.clone(),
            material: *params.material,
            zones: params.zones.clone(),
            neighbours: Lists::of(around.into_iter()),
            is_fixed: flags(params.fixed_nodes),
            is_on_surface: flags(&boundary_nodes(mesh)),
            edges,
        })
    }

    /// K of the tetrahedra for which `counts` is true, summed in their order.
    pub(super) fn tensors(&self, counts: impl Fn(TetId) -> bool) -> Result<StiffnessTensors, SolveError> {
        let (lambda_pa, mu_pa) = (self.material.lambda_pa(), self.material.mu_pa());
        StiffnessTensors::assemble_with(&self.mesh, &self.edges, |tet, g| {
            if counts(tet) { g.stiffness(lambda_pa, mu_pa) } else { NOTHING }
        })
    }

    /// Lumped masses [kg]: each live tetrahedron gives a quarter to each corner.
    pub(super) fn masses_kg(&self, is_live: &[bool]) -> Vec<f64> {
        let mut mass_kg = vec![0.0; self.mesh.positions_m.len()];
        for (t, nodes) in self.mesh.tetrahedra.iter().enumerate().filter(|(t, _)| is_live[*t]) {
            let tet_kg = self.material.density_kg_per_m3() * self.mesh.tet_volume_m3(TetId::from_index(t));
            nodes.iter().for_each(|node| mass_kg[node.index()] += 0.25 * tet_kg);
        }
        mass_kg
    }

    fn is_shared(&self, node: NodeId) -> bool {
        self.zones.zones_of_node(node).len() > 1
    }

    /// The system of K on the nodes for which `is_in` is true.
    ///
    /// # Errors
    /// [`SolveError`] when the ordering fails.
    pub(super) fn system_of(
        &self,
        tensors: &StiffnessTensors,
        is_in: impl Fn(NodeId) -> bool,
    ) -> Result<FreeSystem, SolveError> {
        let mut conditions = BoundaryConditions::new();
        (0..self.mesh.positions_m.len())
            .map(NodeId::from_index)
            .filter(|&node| !is_in(node))
            .for_each(|node| conditions.fix_node(node));
        FreeSystem::new(&self.edges, tensors, &conditions)
    }
}

impl PrecomputedZone {
    /// Computes the table of the zone for the present K.
    ///
    /// # Errors
    /// [`ExchangeError`] when the zone's matrix is singular or memory is short.
    pub(super) fn compute(
        &mut self,
        body: &Body,
        tensors: &StiffnessTensors,
        mass_kg: &[f64],
    ) -> Result<(), ExchangeError> {
        let zone = self.zone;
        let mut table = self.empty_table()?;
        let row_of = &self.row_of;
        let system = body.system_of(tensors, |node| row_of[node.index()] != NONE)?;
        let factor = system.factorize().map_err(|error| match error {
            SolveError::Singular => ExchangeError::WithoutSupport { zone },
            other => other.into(),
        })?;
        let unknowns: Vec<[usize; 3]> = self
            .nodes
            .iter()
            .map(|&node| [0, 1, 2].map(|axis| system.row_of(node, axis).expect("the zone's nodes are free")))
            .collect();
        let inner = self.inner_neighbours(body, tensors);
        let (n_rows, n_loadable, n_free) = (self.n_rows, self.n_loadable, factor.n_rows());
        let (stride, third) = (self.stride(), self.stride() / 3);
        let nodes = &self.nodes;
        let fill = |column: usize, right: &mut [f64]| {
            let (m, axis) = (column / 3, column % 3);
            if m < n_loadable {
                right[unknowns[m][axis]] = 1.0;
            } else {
                for (node, unknown) in nodes.iter().zip(&unknowns) {
                    right[unknown[axis]] = mass_kg[node.index()];
                }
            }
        };
        let take = |_: usize, solutions: &[f64], out: &mut [f64]| {
            for (solution, out) in solutions.chunks_exact(n_free).zip(out.chunks_exact_mut(third)) {
                let at = |row: usize| DVec3::from_array(unknowns[row].map(|i| solution[i]));
                let (displacements, forces) = out.split_at_mut(3 * n_rows);
                for (row, u) in displacements.chunks_exact_mut(3).enumerate() {
                    u.copy_from_slice(&at(row).to_array());
                }
                for (p, force) in forces.chunks_exact_mut(3).enumerate() {
                    let sum: DVec3 = inner.get(p).iter().map(|&(row, b)| b * at(row as usize)).sum();
                    force.copy_from_slice(&sum.to_array());
                }
            }
        };
        solve_columns_into(&factor, 3, &mut table, stride, fill, take);
        self.table = table;
        self.correction = None;
        self.renew();
        Ok(())
    }

    /// A table of zeros of the zone's size.
    fn empty_table(&self) -> Result<Vec<f64>, ExchangeError> {
        let n_numbers = self.stride() * (self.n_loadable + 1);
        let mut table = Vec::new();
        table
            .try_reserve_exact(n_numbers)
            .map_err(|_| ExchangeError::Memory { zone: self.zone, bytes: 8 * n_numbers as u128 })?;
        table.resize(n_numbers, 0.0);
        Ok(table)
    }

    /// Method A: for each frontier node, the rows of the zone's own nodes that act on it, with their tensors.
    fn inner_neighbours(&self, body: &Body, tensors: &StiffnessTensors) -> Lists<(u32, DMat3)> {
        let row_of = &self.row_of;
        Lists::of(self.nodes[..self.n_force_rows].iter().map(|&p| {
            let own = |&&(j, _): &&(NodeId, u32)| row_of[j.index()] != NONE && !body.is_shared(j);
            let entry = |&(j, edge): &(NodeId, u32)| (row_of[j.index()], edge_tensor(tensors, p, j, edge));
            body.neighbours.get(p.index()).iter().filter(own).map(entry).collect()
        }))
    }
}

impl HybridExchange {
    /// Computes the zones on the threads of the current rayon pool; the bits do not depend on their number.
    ///
    /// # Errors
    /// [`ExchangeError`] for a mesh or support without solution, impossible settings, a zone that nothing holds.
    pub fn build(params: &ExchangeParams<'_>) -> Result<Self, ExchangeError> {
        check_params(params)?;
        let mut model = Self::without_zones(params)?;
        model.compliant = model.compliant_tensors()?;
        model.compute_zones()?;
        model.link()?;
        Ok(model)
    }

    /// The body at rest, without loads and without the zones' tables.
    fn without_zones(params: &ExchangeParams<'_>) -> Result<Self, ExchangeError> {
        let mesh = params.mesh;
        let n_nodes = mesh.positions_m.len();
        let body = Body::of(params)?;
        let all = Arc::new(body.tensors(|_| true)?);
        Ok(Self {
            body: Arc::new(body),
            settings: Settings {
                method: params.method,
                order: params.order,
                amount: params.amount,
                overlap: params.overlap,
                sweeps_per_step: params.sweeps_per_step,
                damping_per_s: params.damping_per_s,
                cut_law: params.cut_law,
            },
            laws: params.laws.to_vec(),
            is_live: vec![true; mesh.tetrahedra.len()],
            is_cut: false,
            compliant: Arc::clone(&all),
            all,
            zones: Vec::new(),
            dynamic: DynamicZones::default(),
            shared: Shared {
                displacement_m: vec![DVec3::ZERO; n_nodes],
                dynamic_view_m: vec![DVec3::ZERO; n_nodes],
                surplus_n: Vec::new(),
                outgoing_n: vec![Vec::new(); params.zones.n_zones()],
                pull_m_per_s2: DVec3::ZERO,
            },
            velocity_m_per_s: vec![DVec3::ZERO; n_nodes],
            positions_m: mesh.positions_m.clone(),
            before_m: vec![DVec3::ZERO; n_nodes],
            last_dt_s: 0.0,
            rest_gravity_m_per_s2: DVec3::ZERO,
            constraints: room_for_constraints(n_nodes),
            constraint_forces_n: Vec::with_capacity(n_nodes),
            n_without_room: 0,
            n_ignored: 0,
            n_sweeps: 0,
            n_parts: 0,
            count: ExchangeCount::default(),
            n_rebuilt: 0,
        })
    }

    /// Computes the table of each pre-computed zone.
    fn compute_zones(&mut self) -> Result<(), ExchangeError> {
        let mass_kg = self.body.masses_kg(&self.is_live);
        let n_nodes = self.positions_m.len();
        for zone in (0..self.laws.len()).filter(|&zone| self.laws[zone] == ZoneLaw::Precomputed) {
            let nodes = self.nodes_of_zone(zone);
            let mut made = PrecomputedZone::new(zone, nodes, n_nodes, self.settings.method);
            made.compute(&self.body, &self.compliant, &mass_kg)?;
            self.zones.push(made);
        }
        Ok(())
    }

    /// Free nodes of a zone: those on frontiers, other ones on the surface, inner ones.
    fn nodes_of_zone(&self, zone: usize) -> [Vec<NodeId>; 3] {
        let body = &self.body;
        let mut nodes = [const { Vec::new() }; 3];
        for &node in body.zones.nodes(zone).iter().filter(|node| !body.is_fixed[node.index()]) {
            let kind = match (body.is_shared(node), body.is_on_surface[node.index()]) {
                (true, _) => 0,
                (false, true) => 1,
                (false, false) => 2,
            };
            nodes[kind].push(node);
        }
        nodes
    }

    /// K in the matrices of the pre-computed zones: of all live tetrahedra, or with an overlap of one node of those of
    /// pre-computed zones alone.
    pub(super) fn compliant_tensors(&self) -> Result<Arc<StiffnessTensors>, ExchangeError> {
        match self.settings.overlap {
            Overlap::Nodes(_) => Ok(Arc::clone(&self.all)),
            Overlap::OneNode { .. } => Ok(Arc::new(self.body.tensors(|tet| {
                self.is_live[tet.index()] && self.laws[self.body.zones.zone_of(tet)] == ZoneLaw::Precomputed
            })?)),
        }
    }

    /// Updates everything except the tables that depends on K and on which zones are pre-computed.
    pub(super) fn link(&mut self) -> Result<(), ExchangeError> {
        let body = Arc::clone(&self.body);
        let n_nodes = body.mesh.positions_m.len();
        let mut owner = vec![NONE; n_nodes];
        for (i, zone) in self.zones.iter_mut().enumerate() {
            for (row, node) in zone.nodes.iter().enumerate() {
                let owner = &mut owner[node.index()];
                *owner = (*owner).min(i as u32);
                zone.is_owner[row] = *owner == i as u32;
            }
            let outgoing_n = &mut self.shared.outgoing_n[zone.zone];
            outgoing_n.resize(zone.n_force_rows, DVec3::ZERO);
        }
        let is_precomputed = |node: NodeId| owner[node.index()] != NONE;
        let incoming: Vec<Incoming> =
            self.zones.iter().map(|zone| self.incoming_of(zone, &is_precomputed)).collect();
        for (zone, incoming) in self.zones.iter_mut().zip(incoming) {
            zone.incoming = incoming;
        }
        self.dynamic = self.dynamic_zones(&is_precomputed)?;
        self.shared.surplus_n.clear();
        if !self.dynamic.kirchhoff.is_empty() {
            self.shared.surplus_n.resize(n_nodes, DVec3::ZERO);
        }
        for (n, velocity_m_per_s) in self.velocity_m_per_s.iter_mut().enumerate() {
            if self.dynamic.moving_of(NodeId::from_index(n)).is_none() {
                *velocity_m_per_s = DVec3::ZERO;
            }
        }
        self.distribute();
        Ok(())
    }

    fn incoming_of(&self, zone: &PrecomputedZone, is_precomputed: &dyn Fn(NodeId) -> bool) -> Incoming {
        let body = &self.body;
        let frontier = &zone.nodes[..zone.n_frontier];
        let outside = |p: NodeId, wants_dynamic: bool| -> Vec<(u32, DMat3)> {
            let is_wanted = |j: NodeId| {
                let is_known = self.settings.method == Method::AllNodes || body.is_shared(j);
                let is_right = if wants_dynamic { !is_precomputed(j) } else { is_precomputed(j) && is_known };
                !body.is_fixed[j.index()] && zone.row_of[j.index()] == NONE && is_right
            };
            let tensor = |&(j, edge): &(NodeId, u32)| (j.0, edge_tensor(&self.compliant, p, j, edge));
            let wanted = body.neighbours.get(p.index()).iter().filter(|(j, _)| is_wanted(*j));
            wanted.map(tensor).filter(|(_, b)| *b != DMat3::ZERO).collect()
        };
        let returned = |p: NodeId| -> Vec<(u32, DMat3)> {
            let difference = |(j, edge): (NodeId, u32)| {
                let of = |tensors| edge_tensor(tensors, p, j, edge);
                (j.0, of(&self.all) - of(&self.compliant))
            };
            let own = self.all.vertex[p.index()] - self.compliant.vertex[p.index()];
            let around = body.neighbours.get(p.index()).iter().filter(|(j, _)| !body.is_fixed[j.index()]);
            let around = around.map(|&entry| difference(entry));
            std::iter::once((p.0, own)).chain(around).filter(|(_, b)| *b != DMat3::ZERO).collect()
        };
        let has_one_node = matches!(self.settings.overlap, Overlap::OneNode { .. });
        let handed = |p: NodeId| -> Vec<(u32, u32)> {
            let others = self.zones.iter().filter(|other| other.zone != zone.zone && other.n_force_rows > 0);
            let row = |other: &PrecomputedZone| (other.zone as u32, other.row_of[p.index()]);
            others.map(row).filter(|(_, row)| *row != NONE).collect()
        };
        Incoming {
            nodes: Lists::of(frontier.iter().map(|&p| outside(p, false))),
            dynamic: Lists::of(
                frontier.iter().map(|&p| if has_one_node { returned(p) } else { outside(p, true) }),
            ),
            forces: Lists::of(frontier.iter().map(|&p| handed(p))),
        }
    }

    fn dynamic_zones(&self, is_precomputed: &dyn Fn(NodeId) -> bool) -> Result<DynamicZones, ExchangeError> {
        let body = &self.body;
        let n_nodes = body.mesh.positions_m.len();
        let mass_kg = body.masses_kg(&self.is_live);
        let is_free = |n: usize| !body.is_fixed[n] && mass_kg[n] > 0.0;
        let mut moves: Vec<bool> =
            (0..n_nodes).map(|n| is_free(n) && !is_precomputed(NodeId::from_index(n))).collect();
        let n_further = match self.settings.overlap {
            Overlap::OneNode { .. } => 0,
            Overlap::Nodes(n) => n - 2,
        };
        for _ in 0..n_further {
            let at_edge: Vec<usize> = (0..n_nodes)
                .filter(|&n| is_free(n) && body.neighbours.get(n).iter().any(|(j, _)| moves[j.index()]))
                .collect();
            at_edge.into_iter().for_each(|n| moves[n] = true);
        }
        let mut is_seen = vec![false; n_nodes];
        for n in (0..n_nodes).filter(|&n| moves[n]) {
            body.neighbours.get(n).iter().for_each(|(j, _)| is_seen[j.index()] = true);
        }
        for zone in (0..self.laws.len()).filter(|&z| self.laws[z] != ZoneLaw::Precomputed) {
            body.zones.nodes(zone).iter().for_each(|node| is_seen[node.index()] = true);
        }
        let of = |is: &dyn Fn(usize) -> bool| -> Vec<NodeId> {
            (0..n_nodes).filter(|&n| is(n)).map(NodeId::from_index).collect()
        };
        let nodes = of(&|n| moves[n]);
        let interface =
            of(&|n| is_seen[n] && !moves[n] && !body.is_fixed[n] && is_precomputed(NodeId::from_index(n)));
        let row = |&p: &NodeId| -> Vec<(u32, DMat3)> {
            let around = body.neighbours.get(p.index()).iter().filter(|(j, _)| !body.is_fixed[j.index()]);
            let around = around.map(|&(j, edge)| (j.0, edge_tensor(&self.all, p, j, edge)));
            let own = (p.0, self.all.vertex[p.index()]);
            std::iter::once(own).chain(around).filter(|(_, b)| *b != DMat3::ZERO).collect()
        };
        let relaxation = match self.settings.overlap {
            Overlap::OneNode { relaxation } => relaxation,
            Overlap::Nodes(_) => 1.0,
        };
        let mut dynamic = DynamicZones {
            is_owner: nodes.iter().map(|&node| !is_precomputed(node)).collect(),
            mass_kg: nodes.iter().map(|node| mass_kg[node.index()]).collect(),
            rows: Lists::of(nodes.iter().map(row)),
            stable_step_s: self.stable_step_of(&moves)?,
            rates: Rates { damping_per_s: self.settings.damping_per_s, relaxation },
            interface,
            nodes,
            kirchhoff: self.kirchhoff_tets(),
            ..DynamicZones::default()
        };
        if !dynamic.kirchhoff.is_empty() {
            let law = TetLaw::isotropic(&body.material);
            dynamic.stable_step_s /= law.stiffening(LARGEST_STRETCH, 0.0).sqrt();
            dynamic.law = Some(law);
        }
        dynamic.make_room();
        Ok(dynamic)
    }

    /// Live tetrahedra of non-linear zones.
    fn kirchhoff_tets(&self) -> Vec<(TetId, [NodeId; 4], KirchhoffTet)> {
        let (mesh, zones) = (&self.body.mesh, &self.body.zones);
        let is_wanted = |t: &TetId| {
            self.is_live[t.index()] && self.laws[zones.zone_of(*t)] == ZoneLaw::NonlinearTensorMass
        };
        let tets = (0..mesh.tetrahedra.len()).map(TetId::from_index).filter(is_wanted);
        tets.map(|t| (t, mesh.tetrahedra[t.index()], KirchhoffTet::new(P1Gradients::in_mesh(mesh, t), None)))
            .collect()
    }

    /// Stable step [s] of the tetrahedra around nodes that move, as a body of its own. It is a lower bound: with all
    /// other nodes held the frequencies are lower and the masses larger.
    fn stable_step_of(&self, moves: &[bool]) -> Result<f64, ExchangeError> {
        let body = &self.body;
        let mut mesh = TetMesh::default();
        let mut new_id = vec![NONE; moves.len()];
        for (t, nodes) in body.mesh.tetrahedra.iter().enumerate() {
            if !self.is_live[t] || !nodes.iter().any(|node| moves[node.index()]) {
                continue;
            }
            mesh.tetrahedra.push(nodes.map(|node| {
                let id = &mut new_id[node.index()];
                if *id == NONE {
                    *id = mesh.positions_m.len() as u32;
                    mesh.positions_m.push(body.mesh.positions_m[node.index()]);
                }
                NodeId(*id)
            }));
        }
        if mesh.tetrahedra.is_empty() {
            return Ok(f64::INFINITY);
        }
        let step = TensorMass::stable_step(&mesh, &body.material)?;
        Ok(if self.is_cut { step.after_cuts_s } else { step.step_s })
    }
}
