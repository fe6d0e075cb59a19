//! Nodes of the tissue that something flexible pulls on in a step, and how they answer.
//!
//! Under forces F they go to x(t) + d + C (F - f), with the forces f of the last step, the way d that their motion takes them and the
//! compliance C that the model tells of their neighbourhood. What C gets wrong is learned from one step to the next ([`PatchMemory`]).

use super::organ::Organ;
use super::press::softer;
use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
use crate::model::bounded_vec::BoundedVec;
use crate::model::{LocalModel, NodalForce};

/// What is kept of a node that was touched, from one step to the next.
#[derive(Clone, Copy, Debug)]
struct TouchedNode {
    node: NodeId,
    velocity_m_per_s: DVec3,
    /// Where it was expected to go [m], and how far the change of the forces and the whole step to take it there.
    expected_m: DVec3,
    answer_m: DVec3,
    way_m: DVec3,
}

/// What lasts from step to step.
#[derive(Clone, Debug)]
pub(super) struct PatchMemory {
    /// The nodes that were touched in the last step.
    touched: BoundedVec<TouchedNode>,
    /// How many times as soft as the model says the tissue is taken to be.
    softness: f64,
}

impl PatchMemory {
    pub(super) fn new() -> Self {
        Self { touched: BoundedVec::with_capacity(LocalModel::MOST_NODES), softness: 1.0 }
    }

    /// After a step: whether the touched nodes, now at `positions_m`, are softer than they were taken to be, as in
    /// [`super::press`]: the model tells the answer of a small region, which is stiffer than the tissue.
    pub(super) fn learn_softness(&mut self, positions_m: &[DVec3]) {
        let (mut further_m2, mut answered_m2) = (0.0, 0.0);
        for touched in self.touched.iter() {
            let Some(now_m) = positions_m.get(touched.node.index()) else { continue };
            further_m2 += (*now_m - touched.expected_m).dot(touched.answer_m);
            answered_m2 += touched.answer_m.length_squared() + touched.way_m.length_squared();
        }
        self.softness = if answered_m2 > 0.0 { softer(self.softness, further_m2 / answered_m2) } else { 1.0 };
    }

    /// Nothing was touched.
    pub(super) fn forget(&mut self) {
        self.touched.clear();
        self.softness = 1.0;
    }

    /// Keeps the nodes that are still there.
    pub(super) fn retain(&mut self, is_there: impl Fn(NodeId) -> bool) {
        self.touched.retain(|touched| is_there(touched.node));
    }

    /// Everything that the next steps depend on.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let of_node = |touched: &TouchedNode| {
            let vectors = [touched.velocity_m_per_s, touched.expected_m, touched.answer_m, touched.way_m];
            std::iter::once(f64::from(touched.node.0)).chain(vectors.into_iter().flat_map(|v| v.to_array()))
        };
        self.touched.iter().flat_map(of_node).chain([self.touched.len() as f64, self.softness])
    }

    /// By how much a node that was touched before is faster now [m/s].
    fn gained_m_per_s(&self, node: NodeId, now_m_per_s: &[DVec3]) -> DVec3 {
        let before = self.touched.iter().find(|touched| touched.node == node);
        before.map_or(DVec3::ZERO, |before| velocity_of(node, now_m_per_s) - before.velocity_m_per_s)
    }
}

fn velocity_of(node: NodeId, velocities_m_per_s: &[DVec3]) -> DVec3 {
    velocities_m_per_s.get(node.index()).copied().unwrap_or(DVec3::ZERO)
}

/// The tissue as a patch is told of it.
pub(super) struct PatchTissue<'a> {
    pub(super) organ: &'a Organ,
    /// What the model says of the patch's nodes.
    pub(super) local: &'a LocalModel,
    pub(super) velocities_m_per_s: &'a [DVec3],
    /// Whether the last change of the velocities goes on in a step: in a single explicit one.
    pub(super) goes_on: bool,
    pub(super) dt_s: f64,
}

/// Room for a step; nothing in it lasts.
#[derive(Debug)]
pub(super) struct TissuePatch {
    /// The nodes that the model is asked for.
    pub(super) nodes: BoundedVec<NodeId>,
    /// Where they go freely [m].
    pub(super) free_m: Vec<DVec3>,
    /// By how much their forces change [N], and where that takes them [m].
    pub(super) change_n: Vec<DVec3>,
    pub(super) moves_m: Vec<DVec3>,
    /// Forces on them in the last step [N].
    pub(super) before_n: Vec<DVec3>,
    tensors: Vec<DMat3>,
}

impl TissuePatch {
    pub(super) const MOST_NODES: usize = LocalModel::MOST_NODES;

    pub(super) fn new() -> Self {
        let zeros = || vec![DVec3::ZERO; Self::MOST_NODES];
        Self {
            nodes: BoundedVec::with_capacity(Self::MOST_NODES),
            free_m: zeros(),
            change_n: zeros(),
            moves_m: zeros(),
            before_n: Vec::with_capacity(Self::MOST_NODES),
            tensors: Vec::with_capacity(Self::MOST_NODES * Self::MOST_NODES),
        }
    }

    /// Puts nodes in; answers whether there is room for all.
    pub(super) fn ask_for(&mut self, nodes: &[NodeId]) -> bool {
        let n_new = nodes.iter().filter(|node| !self.nodes.contains(node)).count();
        if self.nodes.len() + n_new > self.nodes.capacity() {
            return false;
        }
        for &node in nodes {
            if !self.nodes.contains(&node) {
                self.nodes.try_push(node);
            }
        }
        true
    }

    /// Tells the forces of the last step, which ascend by node.
    pub(super) fn set_before(&mut self, forces: &[NodalForce]) {
        self.before_n.clear();
        for node in self.nodes.iter() {
            let before = forces.binary_search_by_key(node, |force| force.node);
            self.before_n.push(before.map_or(DVec3::ZERO, |place| forces[place].force_n));
        }
    }

    /// Which place a node has.
    pub(super) fn place_of(&self, node: NodeId) -> Option<usize> {
        self.nodes.iter().position(|known| *known == node)
    }

    /// How the nodes answer, and where they go if nothing about their forces changes.
    pub(super) fn learn(&mut self, tissue: &PatchTissue<'_>, memory: &PatchMemory) {
        let (organ, local, n) = (tissue.organ, tissue.local, self.nodes.len());
        self.tensors.clear();
        for i in 0..n {
            for j in 0..n {
                let told = i < local.nodes.len() && j < local.nodes.len();
                let is_free = !organ.is_fixed(self.nodes[i]) && !organ.is_fixed(self.nodes[j]);
                let tensor =
                    if told && is_free { local.tensor_m_per_n(i, j) * memory.softness } else { DMat3::ZERO };
                self.tensors.push(tensor);
            }
        }
        for (j, &node) in self.nodes.iter().enumerate() {
            let kg_per_s = local.mass_kg.get(j).map_or(0.0, |mass_kg| mass_kg / tissue.dt_s);
            let gained = || memory.gained_m_per_s(node, tissue.velocities_m_per_s) * kg_per_s;
            self.change_n[j] = if tissue.goes_on { gained() } else { DVec3::ZERO };
        }
        self.answer();
        for i in 0..n {
            let drift_m = local.drift_m.get(i).copied().unwrap_or(DVec3::ZERO);
            self.free_m[i] = organ.positions_m()[self.nodes[i].index()] + drift_m + self.moves_m[i];
        }
    }

    /// Where the change of the forces takes the nodes.
    pub(super) fn answer(&mut self) {
        let n = self.nodes.len();
        for i in 0..n {
            let row = self.tensors[n * i..n * (i + 1)].iter();
            self.moves_m[i] = row.zip(&self.change_n[..n]).map(|(tensor, force_n)| *tensor * *force_n).sum();
        }
    }

    /// How far node i goes for a force on node j [m/N].
    pub(super) fn tensor_m_per_n(&self, i: usize, j: usize) -> DMat3 {
        self.tensors[self.nodes.len() * i + j]
    }

    /// Where a node is expected to go [m].
    pub(super) fn expected_m(&self, place: usize) -> DVec3 {
        self.free_m[place] + self.moves_m[place]
    }

    /// After a step's forces are known: what lasts until the next one.
    pub(super) fn keep(&self, velocities_m_per_s: &[DVec3], positions_m: &[DVec3], memory: &mut PatchMemory) {
        memory.touched.clear();
        for (i, &node) in self.nodes.iter().enumerate() {
            let expected_m = self.expected_m(i);
            memory.touched.try_push(TouchedNode {
                node,
                velocity_m_per_s: velocity_of(node, velocities_m_per_s),
                expected_m,
                answer_m: self.moves_m[i],
                way_m: expected_m - positions_m[node.index()],
            });
        }
    }
}

/// Adds a force on a node to a list that ascends by node, as far as there is room.
pub(super) fn add_force(forces: &mut BoundedVec<NodalForce>, share: NodalForce) {
    if share.force_n == DVec3::ZERO {
        return;
    }
    match forces.binary_search_by_key(&share.node, |force| force.node) {
        Ok(place) => forces[place].force_n += share.force_n,
        Err(place) if forces.len() < forces.capacity() => forces.insert(place, share),
        Err(_) => {}
    }
}
