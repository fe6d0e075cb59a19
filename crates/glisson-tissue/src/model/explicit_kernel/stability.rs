//! The largest stable step with ligaments and stiffness damping, and the masses that keep it long enough after
//! cuts.
//!
//! Without damping a step h is stable while theta h^2 <= 4 for the largest squared frequency theta
//! ([`StableStep`]). A ligament of stiffness k adds at most k to its node's diagonal block: k/m_i to theta, and
//! after cuts k over the smallest share of mass that a tetrahedron can leave the node.
//!
//! Other laws stiffen by the largest eigenvalue of their tangent within the stretches allowed for, over
//! lambda + 2 mu; a stress at rest adds its largest principal value over that.
//!
//! Forces at u + beta v with the velocity v of the last half step give a mode of squared frequency theta, with
//! damping d over mass, the characteristic polynomial
//! (1 + d h/2) z^2 - (2 - theta h^2 - theta beta h) z + (1 - d h/2 - theta beta h): its roots stay in the unit
//! circle while theta (h^2 + 2 beta h) <= 4 (its value at z = -1), so h <= sqrt(beta^2 + 4/theta) - beta.
//!
//! From the first edit on a bound for the body as it is counts ([`MassShares`]), found anew after each edit. Where the step of
//! the single tetrahedra is shorter than the shortest one allowed, the limiting ones get the inertia that makes up for it; their
//! weight stays. Since that bound is that of every tetrahedron by itself, this holds after any further cuts, too.

use super::params::Substance;
use super::{ExplicitKernelParams, StableStep};
use crate::material::{LinearElastic, NeoHookeLog, StableNeoHooke, largest_tangent_eigenvalue_pa};
use crate::model::explicit::{MassShares, Stability as ElasticStability, StiffTet, keep, masses_kg};
use crate::model::kernel::{FastKernel, KernelLaw, SharedMaterial};
use crate::model::tet_law::{TetLaw, linear_stiffness};
use crate::model::{DynamicBody, ModelUndo, UndoReader};
use crate::solve::{P1Gradients, SolveError, TetStiffness};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};
use std::collections::BTreeMap;
use std::sync::Arc;

/// theta h^2 of the longest step: a little below 4, as far as [`StableStep`] keeps below it.
const SQUARED_LIMIT: f64 = 3.99;

/// A tetrahedron that gets more inertia once the body is cut.
#[derive(Clone, Copy, Debug)]
struct ScaledTet {
    tet: TetId,
    /// Added to each of its corners [kg].
    corner_kg: f64,
}

/// Added inertia, and where it is.
#[derive(Clone, Debug)]
pub(super) struct MassScaling {
    /// Ascending; a tetrahedron that was removed stays, with nothing to add.
    tets: Vec<ScaledTet>,
    added_kg: Vec<f64>,
    /// Scaled tetrahedra at each node.
    n_scaled: Vec<u32>,
    pub(super) n_nodes: u32,
}

/// How long a step may be, and what makes it so.
#[derive(Clone, Debug)]
pub(super) struct Stability {
    /// Without added inertia, before the first edit.
    pub(super) step: StableStep,
    /// From then on, with it, for the body as it is [s].
    pub(super) cut_s: f64,
    /// What inertia from elsewhere assures after any cuts [s]; 0 without.
    pub(super) assured_s: f64,
    pub(super) scaling: MassScaling,
    shares: MassShares,
    /// Of each tetrahedron by itself, ligaments at its nodes included [1/s2].
    tet_per_s2: Vec<f64>,
    /// How much stiffer than at rest each may become.
    stiffening: Vec<f64>,
    /// Of the ligaments at each node, together.
    ligaments_n_per_m: Vec<f64>,
    density_kg_per_m3: f64,
    /// Speed of the fastest wave at the largest stretch that the step is made for [m/s].
    pub(super) fastest_wave_m_per_s: f64,
    stiffness_damping_s: f64,
    /// Shortest step allowed [s].
    shortest_s: f64,
}

/// What tells materials apart in a search for the same.
fn bits_of(material: &LinearElastic) -> [u64; 2] {
    [material.lambda_pa(), material.mu_pa()].map(f64::to_bits)
}

/// Modulus of the fastest wave at rest [Pa]; of both, because lambda may be negative.
fn wave_pa(material: &LinearElastic) -> f64 {
    (material.lambda_pa() + 2.0 * material.mu_pa()).max(material.mu_pa())
}

/// The largest stiffness of a node's ligaments over its mass [1/s2].
fn largest_per_mass(body: &DynamicBody<'_>, ligaments_n_per_m: &[f64]) -> f64 {
    let masses_kg = masses_kg(body.mesh, body.density_kg_per_m3);
    let per_mass = ligaments_n_per_m.iter().zip(&masses_kg).filter(|(_, m)| **m > 0.0).map(|(k, m)| k / m);
    per_mass.fold(0.0, f64::max)
}

/// The largest eigenvalues of the laws' tangents up to the largest stretch [Pa].
struct Tangents {
    /// Of the general laws, in their order.
    general_pa: Vec<f64>,
    /// Of the laws with code of their own, by material: the search over stretches costs more than everything else about a
    /// tetrahedron.
    by_material_pa: BTreeMap<[u64; 2], f64>,
}

impl Tangents {
    fn of(params: &ExplicitKernelParams<'_>) -> Self {
        let stretch = params.largest_stretch;
        // Tetrahedra of one tissue share their law.
        let mut of_shared_pa = BTreeMap::new();
        let mut of_law_pa = |law: &SharedMaterial| {
            let searched = || largest_tangent_eigenvalue_pa(law.as_ref(), stretch);
            *of_shared_pa.entry(Arc::as_ptr(law).cast::<()>()).or_insert_with(searched)
        };
        let general = params.laws.iter().map(&mut of_law_pa).collect();
        let mut by_material_pa = BTreeMap::new();
        for material in params.materials {
            let searched = || match params.law {
                KernelLaw::NeoHookeLog => {
                    largest_tangent_eigenvalue_pa(&NeoHookeLog::from(material), stretch)
                }
                KernelLaw::StableNeoHooke => {
                    largest_tangent_eigenvalue_pa(&StableNeoHooke::from(material), stretch)
                }
                // Known without a search.
                KernelLaw::Linear | KernelLaw::StVenantKirchhoff | KernelLaw::General => 0.0,
            };
            by_material_pa.entry(bits_of(material)).or_insert_with(searched);
        }
        Self { general_pa: general, by_material_pa }
    }

    /// A tetrahedron at rest, and how many times stiffer it may become.
    fn stiffness(&self, params: &ExplicitKernelParams<'_>, tet: TetId, gradients: &P1Gradients) -> StiffTet {
        let (stretch, general_pa) = (params.largest_stretch, &self.general_pa);
        let material = params.material(tet);
        let law = match params.fibres.get(tet.index()) {
            Some(fibre) => TetLaw::with_fibre(material, fibre, tet).expect("the kernel was made of it"),
            None => TetLaw::isotropic(material),
        };
        // K(F) is at most the largest tangent times the scalar Laplacian, and that at most K at rest over
        // lambda + 2 mu.
        let wave_pa = wave_pa(material);
        let of_tangent = |tangent_pa: f64| (tangent_pa / wave_pa).max(1.0);
        let stiffening = match params.law {
            KernelLaw::Linear if params.volume_penalty_pa == 0.0 => 1.0,
            KernelLaw::Linear | KernelLaw::StVenantKirchhoff => {
                law.stiffening(stretch, params.volume_penalty_pa)
            }
            KernelLaw::NeoHookeLog | KernelLaw::StableNeoHooke => {
                of_tangent(self.by_material_pa[&bits_of(material)])
            }
            KernelLaw::General => of_tangent(general_pa[if general_pa.len() == 1 { 0 } else { tet.index() }]),
        };
        let rest_pa = params.body.rest_stress_pa.get(tet.index()).map_or(0.0, |s| {
            // Largest row sum: at least the largest principal stress.
            let [xx, yy, zz, xy, xz, yz] = s.map(f64::abs);
            (xx + xy + xz).max(xy + yy + yz).max(xz + yz + zz)
        });
        StiffTet { at_rest: linear_stiffness(&law, gradients), stiffening: stiffening + rest_pa / wave_pa }
    }
}

impl Stability {
    /// Of a mesh whose tetrahedra are sound.
    pub(super) fn of(params: &ExplicitKernelParams<'_>) -> Result<Self, SolveError> {
        let body = &params.body;
        let mesh = body.mesh;
        let tangents = Tangents::of(params);
        let stiff = |tet: TetId, gradients: &P1Gradients| tangents.stiffness(params, tet, gradients);
        let mut elastic = ElasticStability::of_stiffness(mesh, body.density_kg_per_m3, stiff)?;
        let mut ligaments_n_per_m = vec![0.0; mesh.positions_m.len()];
        for ligament in body.attachments {
            ligaments_n_per_m[ligament.node.index()] += ligament.stiffness_n_per_m;
        }
        let corner_kg = |tet: TetId| 0.25 * body.density_kg_per_m3 * mesh.tet_volume_m3(tet);
        let tets = || (0..mesh.tetrahedra.len()).map(TetId::from_index);
        let of_ligaments = |tet: TetId| {
            let stiffest = mesh.tetrahedra[tet.index()].map(|n| ligaments_n_per_m[n.index()]);
            stiffest.into_iter().fold(0.0, f64::max) / corner_kg(tet)
        };
        let with_ligaments =
            |tet: TetId| elastic.tet_squared_frequency_per_s2[tet.index()] + of_ligaments(tet);
        let tet_per_s2: Vec<f64> = tets().map(with_ligaments).collect();
        let shares = elastic.take_mass_shares(mesh, body.density_kg_per_m3);
        let stiffening = elastic.tet_stiffening;
        let elastic = elastic.step;
        let tangent_pa = |(tet, stiffening): (TetId, &f64)| stiffening * wave_pa(params.material(tet));
        let stiffest_pa = tets().zip(&stiffening).map(tangent_pa).fold(0.0, f64::max);

        let of_nodes = largest_per_mass(body, &ligaments_n_per_m);
        let uncut = SQUARED_LIMIT / (elastic.step_s * elastic.step_s) + of_nodes;
        let mut after_cuts = SQUARED_LIMIT / (elastic.after_cuts_s * elastic.after_cuts_s);
        let mut limiting = elastic.tet;
        for tet in tets().filter(|tet| of_ligaments(*tet) > 0.0) {
            if tet_per_s2[tet.index()] > after_cuts {
                (after_cuts, limiting) = (tet_per_s2[tet.index()], tet);
            }
        }
        let beta = body.damping.stiffness_s;
        let step_s = longest_s(uncut, beta).max(longest_s(after_cuts, beta));
        let step = StableStep { step_s, after_cuts_s: longest_s(after_cuts, beta), tet: limiting };
        let mut stability = Self {
            step,
            cut_s: step.after_cuts_s,
            assured_s: 0.0,
            shares,
            scaling: MassScaling::of_tets(Vec::new(), mesh.positions_m.len()),
            tet_per_s2,
            stiffening,
            ligaments_n_per_m,
            density_kg_per_m3: body.density_kg_per_m3,
            fastest_wave_m_per_s: (stiffest_pa / body.density_kg_per_m3).sqrt(),
            stiffness_damping_s: beta,
            shortest_s: body.time_step_s / f64::from(body.most_parts),
        };
        if step.after_cuts_s < stability.shortest_s && stability.shortest_s <= step_s {
            let scaled = tets().filter_map(|tet| stability.scaled(tet, corner_kg(tet)));
            stability.scaling.tets = scaled.collect();
        }
        Ok(stability)
    }

    /// A tetrahedron with the inertia that it needs for the shortest step, if it needs any.
    fn scaled(&self, tet: TetId, own_kg: f64) -> Option<ScaledTet> {
        let (h_s, beta) = (self.shortest_s, self.stiffness_damping_s);
        let allowed = SQUARED_LIMIT / (h_s * h_s + 2.0 * beta * h_s);
        let excess = self.tet_per_s2[tet.index()] / allowed - 1.0;
        (excess > 0.0).then_some(ScaledTet { tet, corner_kg: own_kg * excess })
    }

    /// Room for what an edit brings in. A new tetrahedron becomes no stiffer than the stiffest of its parents.
    pub(super) fn grow(&mut self, change: &TopologyChange) {
        self.tet_per_s2.resize(change.tets.n_after, 0.0);
        self.stiffening.resize(change.tets.n_after, 1.0);
        self.shares.resize(change.tets.n_after, change.nodes.n_after);
        for (tet, parents) in change.tets.added.iter() {
            let of_parents = parents.iter().map(|(parent, _)| self.stiffening[parent.index()]);
            self.stiffening[tet.index()] = of_parents.fold(1.0, f64::max);
            self.shares.take_after(tet, parents.iter().map(|(parent, _)| *parent));
        }
        self.ligaments_n_per_m.resize(change.nodes.n_after, 0.0);
        self.scaling.added_kg.resize(change.nodes.n_after, 0.0);
        self.scaling.n_scaled.resize(change.nodes.n_after, 0);
    }

    /// A tetrahedron came in or has another shape; scaling is applied. `at_rest`: its tensors.
    pub(super) fn add_tet(
        &mut self,
        mesh: &TetMesh,
        tet: TetId,
        at_rest: &TetStiffness,
        kernel: &mut FastKernel,
    ) {
        let nodes = mesh.tetrahedra[tet.index()];
        let corner_kg = 0.25 * self.density_kg_per_m3 * mesh.tet_volume_m3(tet);
        let ligaments = nodes.map(|n| self.ligaments_n_per_m[n.index()]).into_iter().fold(0.0, f64::max);
        let stiff = StiffTet { at_rest: *at_rest, stiffening: self.stiffening[tet.index()] };
        let elastic_per_s2 = stiff.squared_frequency_per_s2([corner_kg; 4]);
        self.tet_per_s2[tet.index()] = elastic_per_s2 + ligaments / corner_kg;
        self.shares.set_tet(tet, elastic_per_s2 * corner_kg);
        if let Some(scaled) = self.scaled(tet, corner_kg) {
            self.scaling.add_tet(mesh, scaled, kernel);
        }
    }

    /// Finds the step of the body as it is, with the added inertia that the kernel has.
    pub(super) fn measure(&mut self, mesh: &TetMesh, substance: &Substance, kernel: &FastKernel) {
        let Self { shares, stiffening, ligaments_n_per_m, .. } = self;
        let masses_kg = shares.masses_mut();
        kernel.for_each_node(|node, motion| masses_kg[node.index()] = motion.inertia_kg);
        let stiffness = |tet: TetId| {
            let gradients = P1Gradients::in_mesh(mesh, tet);
            let at_rest = substance.stiffness_at_rest(tet, &gradients);
            StiffTet { at_rest, stiffening: stiffening[tet.index()] }
        };
        let is_live = |tet| kernel.is_live(tet);
        shares.find_demands(&mesh.tetrahedra, is_live, ligaments_n_per_m, stiffness);
        let shared_per_s2 =
            shares.squared_frequency_per_s2(&mesh.tetrahedra, is_live, ligaments_n_per_m, stiffness);
        // Demands are those of the whole body: what is left of it may have none that fit.
        let alone = self.tet_per_s2.iter().enumerate().filter(|(t, _)| kernel.is_live(TetId::from_index(*t)));
        let per_s2 = alone.map(|(_, per_s2)| *per_s2).fold(0.0, f64::max).min(shared_per_s2);
        if per_s2 > 0.0 {
            let scaled_s = if self.scaling.n_nodes > 0 { self.shortest_s } else { 0.0 };
            self.cut_s = longest_s(per_s2, self.stiffness_damping_s).max(scaled_s).max(self.assured_s);
        }
    }

    /// Keeps what an edit changes beside the tetrahedra.
    pub(super) fn save(&self, undo: &mut ModelUndo) {
        undo.numbers.push(self.cut_s);
        undo.places.push(self.scaling.n_nodes);
    }

    /// Comes back to [`Stability::save`]; how many nodes were heavier.
    pub(super) fn put_back(&mut self, from: &mut UndoReader<'_>, n_nodes: usize, n_tets: usize) -> u32 {
        self.cut_s = from.number();
        self.shares.resize(n_tets, n_nodes);
        self.tet_per_s2.truncate(n_tets);
        self.stiffening.truncate(n_tets);
        self.ligaments_n_per_m.truncate(n_nodes);
        self.scaling.added_kg.truncate(n_nodes);
        self.scaling.n_scaled.truncate(n_nodes);
        self.scaling.tets.retain(|scaled| scaled.tet.index() < n_tets);
        from.place() as u32
    }

    /// Keeps a tetrahedron's frequency and stiffness, its inertia (less than zero: never heavier) and how many heavier tetrahedra
    /// its nodes have.
    pub(super) fn save_tet(&self, tet: TetId, nodes: [NodeId; 4], undo: &mut ModelUndo) {
        let scaled = self.scaling.place(tet).map_or(-1.0, |at| self.scaling.tets[at].corner_kg);
        undo.numbers.extend_from_slice(&[
            self.tet_per_s2[tet.index()],
            self.shares.kappa_n_per_m(tet),
            scaled,
        ]);
        undo.places.extend(nodes.map(|n| self.scaling.n_scaled[n.index()]));
    }

    /// Comes back to [`Stability::save_tet`].
    pub(super) fn put_tet_back(
        &mut self,
        tet: TetId,
        nodes: [NodeId; 4],
        n_scaled: [u32; 4],
        from: &mut UndoReader<'_>,
    ) {
        self.tet_per_s2[tet.index()] = from.number();
        self.shares.set_tet(tet, from.number());
        let corner_kg = from.number();
        match self.scaling.place(tet) {
            Some(at) if corner_kg < 0.0 => {
                self.scaling.tets.remove(at);
            }
            Some(at) => self.scaling.tets[at].corner_kg = corner_kg,
            None => {}
        }
        for (node, n) in nodes.into_iter().zip(n_scaled) {
            self.scaling.n_scaled[node.index()] = n;
        }
    }

    /// Drops what has no new id.
    pub(super) fn compact(&mut self, new_nodes: &[Option<NodeId>], new_tets: &[Option<TetId>]) {
        let stays: Vec<bool> = new_nodes.iter().map(Option::is_some).collect();
        let tet_stays: Vec<bool> = new_tets.iter().map(Option::is_some).collect();
        keep(&mut self.tet_per_s2, &tet_stays);
        keep(&mut self.stiffening, &tet_stays);
        keep(&mut self.ligaments_n_per_m, &stays);
        self.shares.keep(&stays, &tet_stays);
        self.scaling = self.scaling.renumbered(new_tets, self.ligaments_n_per_m.len());
    }
}

/// Longest step [s] for a squared frequency [1/s2] with stiffness damping [s].
fn longest_s(squared_per_s2: f64, beta_s: f64) -> f64 {
    let square = SQUARED_LIMIT / squared_per_s2;
    square / ((beta_s * beta_s + square).sqrt() + beta_s)
}

impl MassScaling {
    fn of_tets(tets: Vec<ScaledTet>, n_nodes: usize) -> Self {
        Self { tets, added_kg: vec![0.0; n_nodes], n_scaled: vec![0; n_nodes], n_nodes: 0 }
    }

    /// The body is cut from now on: the limiting tetrahedra among the live ones become heavier.
    pub(super) fn apply(&mut self, mesh: &TetMesh, kernel: &mut FastKernel) {
        for i in 0..self.tets.len() {
            let ScaledTet { tet, corner_kg } = self.tets[i];
            for node in mesh.tetrahedra[tet.index()] {
                self.change(kernel, node, corner_kg, 1);
            }
        }
    }

    /// A tetrahedron was removed: what it added goes.
    pub(super) fn remove_tet(&mut self, mesh: &TetMesh, tet: TetId, kernel: &mut FastKernel) {
        let Some(at) = self.place(tet) else { return };
        let corner_kg = std::mem::replace(&mut self.tets[at].corner_kg, 0.0);
        if corner_kg == 0.0 {
            return;
        }
        for node in mesh.tetrahedra[tet.index()] {
            self.change(kernel, node, -corner_kg, -1);
        }
    }

    /// A live tetrahedron becomes heavier that was not, or not now.
    fn add_tet(&mut self, mesh: &TetMesh, scaled: ScaledTet, kernel: &mut FastKernel) {
        match self.tets.binary_search_by_key(&scaled.tet, |other| other.tet) {
            Ok(at) => self.tets[at] = scaled,
            Err(at) => self.tets.insert(at, scaled),
        }
        for node in mesh.tetrahedra[scaled.tet.index()] {
            self.change(kernel, node, scaled.corner_kg, 1);
        }
    }

    fn place(&self, tet: TetId) -> Option<usize> {
        self.tets.binary_search_by_key(&tet, |scaled| scaled.tet).ok()
    }

    /// Nothing is heavier, as before the first cut; the tetrahedra stay.
    pub(super) fn reset(&mut self, kernel: &mut FastKernel) {
        for (n, n_scaled) in self.n_scaled.iter_mut().enumerate().filter(|(_, n)| **n > 0) {
            *n_scaled = 0;
            self.added_kg[n] = 0.0;
            kernel.set_added_mass(NodeId::from_index(n), 0.0);
        }
    }

    /// Notes the inertia that a node has in the kernel.
    pub(super) fn set_added_kg(&mut self, node: NodeId, added_kg: f64) {
        self.added_kg[node.index()] = added_kg;
    }

    /// Inertia that a node has beyond its mass [kg].
    pub(super) fn added_kg(&self, node: NodeId) -> f64 {
        self.added_kg[node.index()]
    }

    fn change(&mut self, kernel: &mut FastKernel, node: NodeId, added_kg: f64, tets: i32) {
        let n = node.index();
        let before = self.n_scaled[n];
        self.n_scaled[n] = before.saturating_add_signed(tets);
        self.added_kg[n] = if self.n_scaled[n] > 0 { self.added_kg[n] + added_kg } else { 0.0 };
        self.n_nodes = self.n_nodes + u32::from(before == 0) - u32::from(self.n_scaled[n] == 0);
        kernel.set_added_mass(node, self.added_kg[n]);
    }

    /// The same tetrahedra under new ids, not yet applied.
    fn renumbered(&self, new_tets: &[Option<TetId>], n_nodes: usize) -> Self {
        let moved = |scaled: &ScaledTet| new_tets[scaled.tet.index()].map(|tet| ScaledTet { tet, ..*scaled });
        Self::of_tets(self.tets.iter().filter_map(moved).collect(), n_nodes)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DeformableModel, ExplicitKernel};
    use super::*;
    use crate::model::explicit::estimate_from_below;
    use crate::solve::{MeshEdges, StiffnessTensors};
    use glisson_mesh::math::SeededRandom;
    use glisson_mesh::mesh::box_mesh::irregular_cube;
    use glisson_mesh::mesh::edit::{EdgeSplit, EditableMesh, MeshEdit};

    #[test]
    fn after_edits_the_step_is_between_that_of_single_tetrahedra_and_the_longest() {
        let tissue = LinearElastic::from_young_poisson(5e3, 0.45, 1060.0).unwrap();
        for seed in 0..4 {
            let mut random = SeededRandom::new(seed);
            let mut mesh = EditableMesh::new(irregular_cube(0.05, seed)).unwrap();
            let body = DynamicBody { time_step_s: 1e-5, ..DynamicBody::new(mesh.mesh(), 1060.0) };
            let materials = [tissue];
            let params = ExplicitKernelParams::new(body, KernelLaw::Linear, &materials);
            let mut model = ExplicitKernel::build(&params).unwrap();
            let unprepared = ExplicitKernelParams { expects_edits: false, ..params };
            let mut unprepared = ExplicitKernel::build(&unprepared).unwrap();
            for i in 0..16 {
                let edges: Vec<_> = mesh.topology().live_edges().collect();
                let tets: Vec<_> = mesh.topology().live_tets().collect();
                let mut pick = |n: usize| random.uniform_in(0.0, n as f64) as usize;
                let edit = if i % 2 == 0 {
                    MeshEdit::Split {
                        edges: vec![EdgeSplit { edge: edges[pick(edges.len())], fraction: 0.2 }],
                    }
                } else {
                    MeshEdit::Remove { tets: vec![tets[pick(tets.len())]] }
                };
                let change = mesh.apply(&edit).unwrap();
                model.topology_changed(mesh.mesh(), &change).unwrap();
                unprepared.topology_changed(mesh.mesh(), &change).unwrap();
                let topology = mesh.topology();
                let live = TetMesh {
                    positions_m: mesh.mesh().positions_m.clone(),
                    tetrahedra: topology.live_tets().map(|tet| topology.tet_nodes(tet)).collect(),
                    ..TetMesh::default()
                };
                let edges = MeshEdges::of_mesh(&live).unwrap();
                let at_rest =
                    |_, gradients: &P1Gradients| gradients.stiffness(tissue.lambda_pa(), tissue.mu_pa());
                let tensors = StiffnessTensors::assemble_with(&live, &edges, at_rest).unwrap();
                let below_per_s2 = estimate_from_below(&edges, &tensors, &masses_kg(&live, 1060.0));
                let step_s = model.stable_step_s();
                // Both keep a little below their bounds.
                let alone_s = 0.999 * StableStep::of(&live, &tissue).unwrap().after_cuts_s;
                let longest_s = 2.0 / below_per_s2.sqrt();
                let later_s = unprepared.stable_step_s();
                assert!(alone_s <= later_s && later_s < longest_s, "{alone_s} {later_s} {longest_s}");
                assert!(alone_s <= step_s && step_s < longest_s, "{alone_s} {step_s} {longest_s}");
            }
        }
    }

    /// What steps shorter than the stable one are taken to bear.
    #[test]
    fn the_stable_neo_hookean_tangent_grows_no_faster_than_the_sixth_power_of_the_stretch() {
        for poisson_ratio in [0.0, 0.3, 0.45, 0.49, 0.499] {
            let material = LinearElastic::from_young_poisson(5e3, poisson_ratio, 1060.0).unwrap();
            let law = StableNeoHooke::from(&material);
            for from in [1.1, 1.3] {
                let at_from_pa = largest_tangent_eigenvalue_pa(&law, from);
                for more in [1.1_f64, 1.3, 1.6, 2.0] {
                    let grown = largest_tangent_eigenvalue_pa(&law, from * more) / at_from_pa;
                    assert!(grown <= more.powi(6), "nu {poisson_ratio}, {from} times {more}: {grown}");
                }
            }
        }
    }
}
