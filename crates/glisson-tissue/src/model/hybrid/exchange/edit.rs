//! Edits: a pre-computed zone becomes tensor-mass, tetrahedra are removed, and the other zones stay.

use super::zone::{NONE, PrecomputedZone};
use super::{Body, ExchangeError, HybridExchange, Method, ZoneLaw};
use crate::solve::StiffnessTensors;
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::{NodeId, TetId};
use std::sync::Arc;

/// A correction of more than this share of a zone's frontier nodes costs more in each sweep than it saves; the table
/// is then recomputed. A choice.
const MOST_CORRECTED_SHARE: f64 = 0.25;
/// Below this smallest pivot of a correction, nothing holds the zone any more.
const LEAST_PIVOT: f64 = 1e-9;

/// What an edit did to the zones.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct EditReport {
    /// Pre-computed zones that became tensor-mass.
    pub turned: Vec<usize>,
    /// Pre-computed zones whose tensors were corrected.
    pub corrected: Vec<usize>,
    /// Pre-computed zones whose tensors were recomputed.
    pub recomputed: Vec<usize>,
}

impl HybridExchange {
    /// Makes a pre-computed zone tensor-mass, with its present shape and its velocity of the last step. The other zones
    /// stay as they are.
    ///
    /// # Errors
    /// [`ExchangeError::NoSuchZone`]; with an overlap of one node [`ExchangeError::WithoutSupport`].
    pub fn turn_dynamic(&mut self, zone: usize) -> Result<EditReport, ExchangeError> {
        let n_zones = self.laws.len();
        if zone >= n_zones {
            return Err(ExchangeError::NoSuchZone { zone, n_zones });
        }
        let mut report = EditReport::default();
        self.turn(zone, &mut report)?;
        self.follow(&mut report)?;
        Ok(report)
    }

    /// Removes tetrahedra and ignores those that were removed before. A pre-computed zone that loses one becomes
    /// tensor-mass first; zones next to it are corrected.
    ///
    /// # Errors
    /// [`ExchangeError::NoSuchTet`], before anything changes; another [`ExchangeError`] when a zone next to the cut cannot
    /// be computed.
    pub fn remove_tets(&mut self, tets: &[TetId]) -> Result<EditReport, ExchangeError> {
        let n_tets = self.is_live.len();
        if let Some(&tet) = tets.iter().find(|tet| tet.index() >= n_tets) {
            return Err(ExchangeError::NoSuchTet { tet, n_tets });
        }
        let mut report = EditReport::default();
        let live: Vec<TetId> = tets.iter().copied().filter(|tet| self.is_live[tet.index()]).collect();
        for tet in &live {
            self.turn(self.body.zones.zone_of(*tet), &mut report)?;
        }
        if live.is_empty() {
            return Ok(report);
        }
        live.iter().for_each(|tet| self.is_live[tet.index()] = false);
        self.is_cut = true;
        self.all = Arc::new(self.body.tensors(|tet| self.is_live[tet.index()])?);
        self.follow(&mut report)?;
        Ok(report)
    }

    fn turn(&mut self, zone: usize, report: &mut EditReport) -> Result<(), ExchangeError> {
        if self.laws[zone] != ZoneLaw::Precomputed {
            return Ok(());
        }
        let at =
            self.zones.iter().position(|z| z.zone == zone).expect("a zone that is pre-computed has a table");
        if self.settings.method == Method::Surface {
            self.show_inner_nodes(at)?;
        }
        let left = self.zones.remove(at);
        self.laws[zone] = self.settings.cut_law;
        for node in &left.nodes {
            let n = node.index();
            let displacement_m = self.shared.displacement_m[n];
            if self.last_dt_s > 0.0 {
                self.velocity_m_per_s[n] = (displacement_m - self.before_m[n]) / self.last_dt_s;
            }
            self.shared.dynamic_view_m[n] = displacement_m;
        }
        self.shared.outgoing_n[zone].clear();
        report.turned.push(zone);
        Ok(())
    }

    /// Method A: computes the displacements of a zone's inner nodes, now and before the last step, from those of surface
    /// and frontier: K_II u_I = weight - K_IG u_G.
    fn show_inner_nodes(&mut self, at: usize) -> Result<(), ExchangeError> {
        let (zone, body) = (&self.zones[at], &self.body);
        let is_inner = |node: NodeId| zone.row_of[node.index()] != NONE && zone.loadable_of(node).is_none();
        let inner: Vec<NodeId> = zone.nodes[zone.n_loadable..].to_vec();
        if inner.is_empty() {
            return Ok(());
        }
        let system = body.system_of(&self.compliant, is_inner)?;
        let factor = system.factorize()?;
        let mass_kg = body.masses_kg(&self.is_live);
        let mut balance_n = vec![DVec3::ZERO; body.mesh.positions_m.len()];
        let mut free = vec![0.0; system.n_free()];
        for displacement_m in [&mut self.shared.displacement_m, &mut self.before_m] {
            inner.iter().for_each(|node| displacement_m[node.index()] = DVec3::ZERO);
            self.compliant.force_into(&body.edges, displacement_m, &mut balance_n);
            for (n, balance_n) in balance_n.iter_mut().enumerate() {
                *balance_n = self.shared.pull_m_per_s2 * mass_kg[n] - *balance_n;
            }
            system.gather_into(&balance_n, &mut free);
            factor.solve_in_place(&mut free, 1, &mut factor.scratch(1));
            system.add_scattered(&free, displacement_m);
        }
        Ok(())
    }

    /// Updates the remaining pre-computed zones for the present K and their present neighbours.
    fn follow(&mut self, report: &mut EditReport) -> Result<(), ExchangeError> {
        let body = Arc::clone(&self.body);
        loop {
            let now = self.compliant_tensors()?;
            let before = std::mem::replace(&mut self.compliant, now);
            let mut unheld = None;
            for zone in &mut self.zones {
                let Some((nodes, lost)) = lost_stiffness(zone, &body, &before, &self.compliant) else {
                    continue;
                };
                report.corrected.retain(|&z| z != zone.zone);
                let most = (MOST_CORRECTED_SHARE * zone.n_frontier as f64).max(4.0) as usize;
                if nodes.len() <= most {
                    report.corrected.push(zone.zone);
                    if zone.correct(nodes, lost) < LEAST_PIVOT {
                        unheld = Some(zone.zone);
                    }
                } else {
                    report.recomputed.push(zone.zone);
                    self.n_rebuilt += 1;
                    match zone.compute(&body, &self.compliant, &body.masses_kg(&self.is_live)) {
                        Err(ExchangeError::WithoutSupport { zone }) => unheld = Some(zone),
                        other => other?,
                    }
                }
            }
            let Some(zone) = unheld else { break };
            // A zone that only tensor-mass zones hold becomes tensor-mass too.
            report.corrected.retain(|&z| z != zone);
            report.recomputed.retain(|&z| z != zone);
            self.turn(zone, report)?;
        }
        self.link()
    }
}

/// What a zone's part of K lost [N/m] in an edit: by edges between rows of the zone, and by rows.
struct Loss {
    of_edges: Vec<([u32; 2], DMat3)>,
    of_nodes: Vec<(u32, DMat3)>,
}

impl Loss {
    fn between(
        zone: &PrecomputedZone,
        body: &Body,
        before: &StiffnessTensors,
        now: &StiffnessTensors,
    ) -> Self {
        let edges = body.edges.nodes.iter().enumerate().filter(|(e, [p, q])| {
            let is_in = zone.row_of[p.index()] != NONE && zone.row_of[q.index()] != NONE;
            is_in && before.edge[*e] != now.edge[*e]
        });
        let nodes = zone.nodes.iter().enumerate();
        Self {
            of_edges: edges
                .map(|(e, nodes)| (nodes.map(|node| zone.row_of[node.index()]), before.edge[e] - now.edge[e]))
                .collect(),
            of_nodes: nodes
                .filter(|(_, node)| before.vertex[node.index()] != now.vertex[node.index()])
                .map(|(row, node)| (row as u32, before.vertex[node.index()] - now.vertex[node.index()]))
                .collect(),
        }
    }
}

/// Loadable nodes of a zone whose part of K changed, those corrected before among them, and what they lost [N/m]
/// since the table was made; `None` when nothing changed.
fn lost_stiffness(
    zone: &PrecomputedZone,
    body: &Body,
    before: &StiffnessTensors,
    now: &StiffnessTensors,
) -> Option<(Vec<u32>, Vec<f64>)> {
    let loss = Loss::between(zone, body, before, now);
    if loss.of_nodes.is_empty() {
        return None;
    }
    let earlier = zone.correction.as_ref();
    let mut nodes: Vec<u32> = loss.of_nodes.iter().map(|&(row, _)| row).collect();
    nodes.extend(earlier.iter().flat_map(|c| &c.nodes));
    nodes.sort_unstable();
    nodes.dedup();
    let n = 3 * nodes.len();
    let mut lost = vec![0.0; n * n];
    let place = |row: u32| nodes.binary_search(&row).expect("an edge that changes has ends that change");
    let mut add = |p: u32, q: u32, tensor: DMat3| {
        let (i, j) = (3 * place(p), 3 * place(q));
        for a in 0..3 {
            for b in 0..3 {
                lost[(i + a) * n + j + b] += tensor.col(b)[a];
            }
        }
    };
    for (row, tensor) in loss.of_nodes {
        add(row, row, tensor);
    }
    for ([p, q], tensor) in loss.of_edges {
        add(p, q, tensor);
        add(q, p, tensor.transpose());
    }
    if let Some(earlier) = earlier {
        for (i, &p) in earlier.nodes.iter().enumerate() {
            for (j, &q) in earlier.nodes.iter().enumerate() {
                add(p, q, earlier.lost_between(i, j));
            }
        }
    }
    Some((nodes, lost))
}
