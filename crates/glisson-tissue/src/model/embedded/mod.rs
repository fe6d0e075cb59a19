//! A model whose cuts are embedded: it moves copies of the tetrahedra that the body had at first, and these carry the cut mesh.
//!
//! See [`glisson_mesh::mesh::embedding`] for what is copied, and which corners copies share. With W the barycentric weights of the
//! cut mesh's nodes among the copies' (x = W X), the forces f on nodes of the cut mesh are W^T f on those of the copies, and the
//! compliance C of the copies is W C W^T for the cut mesh. So any model of the copies is one of the cut mesh, and its time step does
//! not know how thin the pieces are that a blade left.
//!
//! Until the first edit the copies are the mesh itself, and the model has the bits that it has alone.

mod bearing;
mod constraints;
mod local;

use self::bearing::Bearing;
use self::constraints::Carried;
use super::{
    Answered, Constraints, Correction, DeformableModel, LevelOfDetail, LocalModel, LocalWork, ModelReport,
    ModelState, ModelUndo, NodalForce, NodalSpring, StepAnswer, TopologyRefusal, follow_edit,
};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::mesh::edit::TopologyChange;
use glisson_mesh::mesh::embedding::{Embedding, EmbeddingUndo};
use glisson_mesh::mesh::{NodeId, TetId, TetMesh};

/// How such models are called in messages.
const NAME: &str = "embedded";

/// A model of the copies, shown as one of the cut mesh.
pub struct Embedded {
    /// Of the copies.
    model: Box<dyn DeformableModel>,
    embedding: Embedding,
    /// Whether every tetrahedron is its own copy still.
    is_whole: bool,
    /// Whether the next edit makes the elements finer.
    gets_finer: bool,
    /// Tetrahedra that went as the mesh was made finer.
    gone: Vec<TetId>,
    /// How many edits there were; another answer to forces after each.
    n_edits: u64,
    last_dt_s: f64,
    carried: Carried,
    bearing: Bearing,
    positions_m: Vec<DVec3>,
    velocities_m_per_s: Vec<DVec3>,
    /// Nodes of the cut mesh that are not the copies' node of their number.
    carried_nodes: Vec<NodeId>,
    /// Velocities of the copies' nodes before the last step [m/s].
    before_m_per_s: Vec<DVec3>,
    /// Motion of the copies' nodes [m]: scratch.
    moves_m: Vec<DVec3>,
    patch: Vec<NodeId>,
    local: LocalModel,
    /// Compliance between the patch of the copies and nodes of the cut mesh: scratch.
    columns: Vec<DMat3>,
}

impl Embedded {
    /// `model` is one of `mesh`, which is not cut yet.
    pub fn new(model: Box<dyn DeformableModel>, mesh: &TetMesh) -> Self {
        Self::of_parts(model, Embedding::new(mesh))
    }

    fn of_parts(model: Box<dyn DeformableModel>, embedding: Embedding) -> Self {
        let mut embedded = Self {
            model,
            embedding,
            is_whole: true,
            gets_finer: false,
            gone: Vec::new(),
            n_edits: 0,
            last_dt_s: 0.0,
            carried: Carried::default(),
            bearing: Bearing::default(),
            positions_m: Vec::new(),
            velocities_m_per_s: Vec::new(),
            carried_nodes: Vec::new(),
            before_m_per_s: Vec::new(),
            moves_m: Vec::new(),
            patch: Vec::with_capacity(LocalModel::MOST_NODES),
            local: LocalModel::new(),
            columns: Vec::with_capacity(LocalModel::MOST_NODES * LocalModel::MOST_NODES),
        };
        embedded.make_room();
        embedded
    }

    /// Room for what steps write.
    fn make_room(&mut self) {
        self.is_whole = self.embedding.is_whole();
        if self.is_whole {
            return;
        }
        let n_copied = self.embedding.copies().positions_m.len();
        self.before_m_per_s.resize(n_copied, DVec3::ZERO);
        self.moves_m.resize(n_copied, DVec3::ZERO);
        self.carried.make_room(n_copied, self.embedding.n_nodes());
        let ties = (0..).map(NodeId::from_index).zip(self.embedding.ties());
        self.carried_nodes.clear();
        self.carried_nodes
            .extend(ties.filter(|(node, tie)| tie.single() != Some(*node)).map(|(node, _)| node));
        self.publish();
    }

    /// Where the cut mesh is.
    fn publish(&mut self) {
        if self.is_whole {
            return;
        }
        let Self { model, embedding, carried_nodes, positions_m, velocities_m_per_s, .. } = self;
        let state = model.state();
        let n_nodes = embedding.n_nodes();
        positions_m.resize(n_nodes, DVec3::ZERO);
        velocities_m_per_s.resize(if state.velocities_m_per_s.is_empty() { 0 } else { n_nodes }, DVec3::ZERO);
        spread(embedding, carried_nodes, state.positions_m, positions_m);
        spread(embedding, carried_nodes, state.velocities_m_per_s, velocities_m_per_s);
    }

    /// What the copies' nodes have where those of the cut mesh have `of_cut`, as near as can be, from what they have at `rest` on.
    fn fit(&self, of_cut: &[DVec3], rest: impl Fn(NodeId) -> DVec3) -> Vec<DVec3> {
        let n_copied = self.embedding.copies().positions_m.len();
        let mut found: Vec<DVec3> = (0..n_copied).map(|n| rest(NodeId::from_index(n))).collect();
        for _ in 0..FITS {
            for (tie, of_node) in self.embedding.ties().iter().zip(of_cut) {
                constraints::pull(tie, *of_node, &mut found);
            }
        }
        found
    }

    /// Follows an edit before any cut as the model alone does.
    fn make_finer(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        undo: &mut ModelUndo,
    ) -> Result<(), TopologyRefusal> {
        undo.keep_whole(self.duplicate());
        self.model.topology_changed(mesh, change)?;
        self.gone.extend_from_slice(&change.tets.removed);
        self.gone.sort_unstable();
        self.embedding = Embedding::without(mesh, &self.gone);
        self.make_room();
        self.n_edits += 1;
        Ok(())
    }

    /// Follows an edit, with what takes it back in `undo`.
    fn follow(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        undo: &mut ModelUndo,
    ) -> Result<(), TopologyRefusal> {
        if self.gets_finer && self.is_whole {
            return self.make_finer(mesh, change, undo);
        }
        let mut of_embedding = EmbeddingUndo::default();
        undo.velocities_m_per_s.extend_from_slice(&self.before_m_per_s);
        undo.numbers.extend_from_slice(self.bearing.of_nodes_m3());
        let followed = self.embedding.follow(mesh, change, &mut of_embedding);
        let of_copies =
            followed.map_err(|refusal| TopologyRefusal::Frozen { model: NAME, reason: refusal.reason() })?;
        let mut of_model = ModelUndo::default();
        if let Err(refusal) = follow_edit(&mut self.model, self.embedding.copies(), &of_copies, &mut of_model)
        {
            self.embedding.undo(&of_embedding);
            return Err(refusal);
        }
        // A copied node goes on as the one that it is a copy of.
        let n_before = of_copies.nodes.n_before;
        self.before_m_per_s.resize(n_before, DVec3::ZERO);
        for (_, parents) in of_copies.nodes.added.iter() {
            let of_parent = parents.first().map(|(parent, _)| self.before_m_per_s[parent.index()]);
            self.before_m_per_s.push(of_parent.unwrap_or(DVec3::ZERO));
        }
        undo.parts.push(of_model);
        undo.embedding = Some(of_embedding);
        self.bearing.of_mesh(mesh, change, &self.embedding);
        self.n_edits += 1;
        self.carried.release();
        self.make_room();
        Ok(())
    }
}

/// What the nodes of the cut mesh have of what the copies' nodes have; nothing where these have nothing. `carried` are the nodes that
/// are not the copies' node of their number.
fn spread(embedding: &Embedding, carried: &[NodeId], of_copies: &[DVec3], of_cut: &mut [DVec3]) {
    if of_copies.is_empty() {
        return;
    }
    let n_common = of_cut.len().min(of_copies.len());
    of_cut[..n_common].copy_from_slice(&of_copies[..n_common]);
    for node in carried {
        let tie = &embedding.ties()[node.index()];
        of_cut[node.index()] = tie.mean(|of| of_copies[of.index()]);
    }
}

/// Rounds of fitting copies to places of the cut mesh.
const FITS: usize = 30;

impl DeformableModel for Embedded {
    fn apply(&mut self, constraints: &Constraints) {
        if self.is_whole {
            self.model.apply(constraints);
            return;
        }
        let state = self.model.state();
        let rest_m = &self.embedding.copies().positions_m;
        let here_m = |node: NodeId| state.positions_m[node.index()] - rest_m[node.index()];
        let of_copies = self.carried.take_over(constraints, self.embedding.ties(), here_m);
        self.model.apply(of_copies);
    }

    fn steady(&mut self, spring: NodalSpring) {
        if self.is_whole {
            self.model.steady(spring);
            return;
        }
        // What carries the node goes as far as the node has to.
        let Some(tie) = self.embedding.ties().get(spring.node.index()).copied() else { return };
        let way_m = spring.place_m - self.positions_m[spring.node.index()];
        for (node, weight) in tie.iter() {
            let place_m = self.model.state().positions_m[node.index()] + way_m;
            let stiffness_n_per_m = spring.stiffness_n_per_m * weight;
            self.model.steady(NodalSpring { node, place_m, stiffness_n_per_m });
        }
    }

    fn step(&mut self, dt_s: f64) {
        self.last_dt_s = dt_s;
        if self.is_whole {
            self.model.step(dt_s);
            return;
        }
        let velocities_m_per_s = self.model.state().velocities_m_per_s;
        if !velocities_m_per_s.is_empty() {
            self.before_m_per_s.copy_from_slice(velocities_m_per_s);
        }
        self.model.step(dt_s);
        self.publish();
        self.carried.read_forces(self.model.constraint_forces_n());
    }

    fn state(&self) -> ModelState<'_> {
        if self.is_whole {
            return self.model.state();
        }
        ModelState { positions_m: &self.positions_m, velocities_m_per_s: &self.velocities_m_per_s }
    }

    fn history_into(&self, numbers: &mut Vec<f64>) {
        if !self.is_whole {
            let of_copies = self.model.state();
            for vectors in [of_copies.positions_m, of_copies.velocities_m_per_s] {
                numbers.extend(vectors.iter().flat_map(|v| v.to_array()));
            }
        }
        self.model.history_into(numbers);
    }

    fn constraint_forces_n(&self) -> &[DVec3] {
        if self.is_whole { self.model.constraint_forces_n() } else { self.carried.forces_n() }
    }

    fn take_over(&mut self, positions_m: &[DVec3]) {
        if self.is_whole {
            self.model.take_over(positions_m);
            return;
        }
        let of_copies = self.fit(positions_m, |node| self.embedding.copies().positions_m[node.index()]);
        self.model.take_over(&of_copies);
        self.before_m_per_s.fill(DVec3::ZERO);
        self.publish();
    }

    fn clocks_s(&self) -> &[f64] {
        self.model.clocks_s()
    }

    fn take_over_in_motion(&mut self, state: &ModelState<'_>, clocks_s: &[f64]) {
        if self.is_whole {
            self.model.take_over_in_motion(state, clocks_s);
            return;
        }
        let positions_m =
            self.fit(state.positions_m, |node| self.embedding.copies().positions_m[node.index()]);
        let velocities_m_per_s = match state.velocities_m_per_s {
            [] => Vec::new(),
            known => self.fit(known, |_| DVec3::ZERO),
        };
        let of_copies = ModelState { positions_m: &positions_m, velocities_m_per_s: &velocities_m_per_s };
        self.model.take_over_in_motion(&of_copies, clocks_s);
        self.before_m_per_s.fill(DVec3::ZERO);
        self.publish();
    }

    fn set_gravity(&mut self, gravity_m_per_s2: DVec3) {
        self.model.set_gravity(gravity_m_per_s2);
    }

    fn set_level_of_detail(&mut self, effort: LevelOfDetail) -> bool {
        self.model.set_level_of_detail(effort)
    }

    fn report(&self) -> ModelReport {
        let of_copies = self.model.report();
        let carried_by = |copy| {
            (0..self.embedding.n_tets())
                .map(TetId::from_index)
                .find(|tet| self.embedding.copy_of(*tet) == copy)
        };
        ModelReport { first_quarantined: of_copies.first_quarantined.and_then(carried_by), ..of_copies }
    }

    fn duplicate(&self) -> Box<dyn DeformableModel> {
        let mut copy = Self::of_parts(self.model.duplicate(), self.embedding.clone());
        copy.gets_finer = self.gets_finer;
        copy.gone.clone_from(&self.gone);
        copy.n_edits = self.n_edits;
        copy.last_dt_s = self.last_dt_s;
        copy.carried = self.carried.clone();
        copy.make_room();
        copy.bearing = self.bearing.clone();
        copy.before_m_per_s.clone_from(&self.before_m_per_s);
        Box::new(copy)
    }

    fn local_model_into(
        &mut self,
        patch: &[NodeId],
        period_s: f64,
        work: &mut LocalWork,
        out: &mut LocalModel,
    ) {
        if self.is_whole {
            self.model.local_model_into(patch, period_s, work, out);
        } else {
            self.carry_local_model(patch, period_s, work, out);
        }
    }

    fn step_answer(&self) -> StepAnswer {
        match self.model.step_answer() {
            StepAnswer::Coupled { version } => StepAnswer::Coupled { version: version + self.n_edits },
            other => other,
        }
    }

    /// Nodes that a copy carries answer together. As if each had its share of the copies' nodes ([`Bearing`]), they answer no less
    /// than they do: whoever takes them one by one never overshoots.
    fn node_answer_m_per_n(&self, node: NodeId, dt_s: f64) -> DVec3 {
        if self.is_whole {
            return self.model.node_answer_m_per_n(node, dt_s);
        }
        let Some(tie) = self.embedding.ties().get(node.index()) else { return DVec3::ZERO };
        let answer = |of: NodeId| self.model.node_answer_m_per_n(of, dt_s);
        self.bearing.answer(node, tie, answer)
    }

    fn carrier_m(&self, tet: TetId) -> Option<[[DVec3; 4]; 2]> {
        let copies = self.embedding.copies();
        let copy =
            (!self.is_whole && tet.index() < self.embedding.n_tets()).then(|| self.embedding.copy_of(tet))?;
        let positions_m = self.model.state().positions_m;
        Some([copies.corners_m(copy), copies.tetrahedra[copy.index()].map(|node| positions_m[node.index()])])
    }

    fn can_part(&self, sides: &mut dyn Iterator<Item = (NodeId, f64)>) -> bool {
        self.is_whole || bearing::can_part(sides, self.embedding.ties())
    }

    fn answer_into(&mut self, forces: &[NodalForce], moves_m: &mut [DVec3], at: Answered) {
        if self.is_whole {
            self.model.answer_into(forces, moves_m, at);
            return;
        }
        let of_copies = self.carried.gather(forces, self.embedding.ties());
        if self.model.step_answer() == StepAnswer::NodeByNode {
            self.moves_m.fill(DVec3::ZERO);
            for force in of_copies {
                let answer_m_per_n = self.model.node_answer_m_per_n(force.node, self.last_dt_s);
                self.moves_m[force.node.index()] = answer_m_per_n * force.force_n;
            }
        } else {
            self.model.answer_into(of_copies, &mut self.moves_m, at);
        }
        spread(&self.embedding, &self.carried_nodes, &self.moves_m, moves_m);
    }

    fn correct_step(&mut self, forces: &[NodalForce], dt_s: f64, correction: Correction) {
        if self.is_whole {
            self.model.correct_step(forces, dt_s, correction);
            return;
        }
        let of_copies = self.carried.gather(forces, self.embedding.ties());
        self.model.correct_step(of_copies, dt_s, correction);
        self.publish();
    }

    fn bring_up_to_date(&mut self) {
        self.model.bring_up_to_date();
        self.publish();
    }

    fn expect_finer_mesh(&mut self, is_finer: bool) {
        self.gets_finer = is_finer;
    }

    fn topology_refusal(&self) -> Option<TopologyRefusal> {
        self.model.topology_refusal()
    }

    fn topology_changed(&mut self, mesh: &TetMesh, change: &TopologyChange) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change, &mut ModelUndo::default())
    }

    fn follow_saving(
        &mut self,
        mesh: &TetMesh,
        change: &TopologyChange,
        undo: &mut ModelUndo,
    ) -> Result<(), TopologyRefusal> {
        self.follow(mesh, change, undo)
    }

    fn undo(&mut self, undo: &ModelUndo) {
        let (Some(of_embedding), [of_model]) = (&undo.embedding, undo.parts.as_slice()) else { return };
        self.embedding.undo(of_embedding);
        of_model.put_back_copy(&mut self.model);
        self.before_m_per_s.clone_from(&undo.velocities_m_per_s);
        self.bearing.put_back(&undo.numbers, &self.embedding);
        self.n_edits += 1;
        self.carried.release();
        self.make_room();
    }
}
