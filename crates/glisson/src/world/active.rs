//! Edges and hot tips: what an instrument keeps of its cut from step to step, and how edges cut.

use super::burn::{Burn, SweptHeat};
use super::refusal::EditRefusal;
use super::{BladeReport, ToolCuts, World};
use crate::math::DVec3;
use crate::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use crate::mesh::quality::dihedral_cosine_range;
use crate::mesh::{NodeId, TetId};
use crate::model::TopologyRefusal;
use crate::tool::cautery::TissueHeat;
use crate::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use crate::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};
use crate::tool::pose::ToolFrame;
use crate::tool::{Blade, BladeCuts, Jaws, Snip, Tool};

/// Transactions of one blade in one step at most; what is left is done after the next one.
const MOST_EDITS: usize = 64;
/// An edge in tissue of a model that cannot follow it tries again after so many seconds [s]: a choice, because a try takes the time of
/// many steps.
const TRIES_AGAIN_S: f64 = 0.25;
/// Scissors that open further close in several pieces, each flat: a choice; their ends' way is then within 3 % of their length of the
/// circle.
const CLOSES_AT_ONCE_RAD: f64 = 0.5;
/// Tetrahedra that one tip warms at once.
const MOST_WARM: usize = 256;

/// How an edge cuts.
#[derive(Clone, Debug)]
enum Edge {
    Subdivision(Box<SubdivisionCut>),
    Displacement(Box<ScalpelCut>),
}

impl Edge {
    /// The stroke begins here, where the blade cuts nothing yet.
    fn begin(&mut self, body: &EditableMesh, positions_m: &[DVec3], blade_m: [DVec3; 2]) {
        // The first place of a stroke cuts nothing; one that is refused is refused again when it would cut.
        match self {
            Self::Subdivision(cut) => drop(cut.advance(body, positions_m, blade_m)),
            Self::Displacement(cut) => drop(cut.advance(body, positions_m, blade_m)),
        }
    }

    /// Areas swept and opened in the stroke so far [m2], and strokes that merged faces.
    fn figures(&self) -> ([f64; 2], usize) {
        match self {
            Self::Subdivision(cut) => {
                let report = cut.report();
                ([report.swept_area_m2, report.cut_area_m2], report.n_merged)
            }
            Self::Displacement(cut) => ([0.0, cut.report().wall_area_m2], 0),
        }
    }
}

/// The active part of one tool.
#[derive(Clone, Debug)]
pub(super) struct ActiveTip {
    edge: Option<Edge>,
    /// Whether a stroke is under way.
    is_in_stroke: bool,
    /// For how long nothing is tried, because the model could not follow [s].
    waits_s: f64,
    pub(super) heat: TissueHeat,
    pub(super) burn: Burn,
    /// Nodes of tetrahedra that the stroke changed.
    touched: Vec<NodeId>,
    /// What the stroke did so far.
    stroke: BladeReport,
}

/// What an edit found of an active tip.
pub(super) struct ActiveBefore {
    heat: TissueHeat,
    burn: SweptHeat,
    n_touched: usize,
}

impl ActiveTip {
    pub(super) fn new(tool: &Tool, body: &EditableMesh) -> Self {
        let edge = match tool.kind.edge_cuts() {
            Some(cuts @ (BladeCuts::Subdivision | BladeCuts::Embedded)) => {
                let of_edge = match cuts {
                    BladeCuts::Embedded => SubdivisionParams::embedded,
                    _ => SubdivisionParams::for_mean_edge,
                };
                let mut params = of_edge(mean_edge_m(body));
                if let Some((jaws, _)) = tool.kind.parting_jaws() {
                    // Each piece of the way is cut, also in a coarse mesh.
                    let piece_m = 0.5 * CLOSES_AT_ONCE_RAD * jaws.length_m;
                    params.min_advance_m = params.min_advance_m.min(0.5 * piece_m);
                }
                Some(Edge::Subdivision(Box::new(SubdivisionCut::new(params))))
            }
            Some(BladeCuts::Displacement) => {
                Some(Edge::Displacement(Box::new(ScalpelCut::new(ScalpelParams::default()))))
            }
            None => None,
        };
        let n_warm = if tool.kind.burning().is_some() { MOST_WARM } else { 0 };
        Self {
            edge,
            is_in_stroke: false,
            waits_s: 0.0,
            heat: TissueHeat::with_room_for(n_warm),
            burn: Burn::default(),
            touched: Vec::new(),
            stroke: BladeReport::default(),
        }
    }

    /// Everything that the next cuts depend on and is not told by the mesh: the heat, and for how long an edge waits.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        let of_tets = self.heat.warm().iter().flat_map(|&(tet, heat)| [f64::from(tet.0), heat]);
        let waits = (self.waits_s > 0.0).then_some(self.waits_s);
        of_tets.chain(self.burn.swept.numbers()).chain(waits)
    }

    /// Heat that a tetrahedron took up from it [J/m3].
    pub(super) fn heat_of(&self, tet: TetId) -> f64 {
        self.heat.of(tet)
    }

    /// What an edit that is undone puts back.
    pub(super) fn before_edit(&self) -> ActiveBefore {
        ActiveBefore { heat: self.heat.clone(), burn: self.burn.swept, n_touched: self.touched.len() }
    }

    /// An edit was undone: what was warm then is warm again, and the next stroke begins anew, because the front of
    /// the last one may be gone. What is left of its cut is still looked at when the edge is lifted.
    pub(super) fn go_back_to(&mut self, before: &ActiveBefore) {
        let mut touched = std::mem::take(&mut self.touched);
        touched.truncate(before.n_touched);
        self.lift();
        self.touched = touched;
        self.heat.clone_from(&before.heat);
        self.burn.swept = before.burn;
    }

    /// The stroke is over; the next one begins where the blade then is. What was warm has cooled.
    pub(super) fn lift(&mut self) {
        match &mut self.edge {
            Some(Edge::Subdivision(cut)) => cut.lift(),
            Some(Edge::Displacement(cut)) => **cut = ScalpelCut::new(ScalpelParams::default()),
            None => {}
        }
        self.is_in_stroke = false;
        self.touched.clear();
        self.stroke = BladeReport::default();
        self.heat.keep_live(|_| false);
        self.burn.swept = SweptHeat::default();
    }

    /// Follows an edit that is not its own.
    pub(super) fn follow(&mut self, body: &EditableMesh, change: &TopologyChange) {
        if let Some(Edge::Subdivision(cut)) = &mut self.edge {
            cut.topology_changed(change);
        }
        if change.is_renumbering() {
            self.touched.clear();
        }
        self.heat.keep_live(|tet| body.topology().is_live_tet(tet));
    }
}

/// Whether a model was found that cannot follow such edits.
fn has_frozen(refusals: &[(usize, EditRefusal)]) -> bool {
    let is_frozen =
        |refusal: &EditRefusal| matches!(refusal, EditRefusal::Model(TopologyRefusal::Frozen { .. }));
    refusals.iter().any(|(_, refusal)| is_frozen(refusal))
}

impl World {
    /// Cuts along an edge while the trigger is pressed, and ends the stroke when it is not.
    pub(super) fn cut_with_blade(&mut self, tool: usize, blade: &Blade, cuts: &mut ToolCuts) {
        let pose = self.tool_states[tool].now;
        let is_on = self.edge_is_on(tool);
        let waits_s = if is_on { self.active[tool].waits_s - self.spec.time_step_s } else { 0.0 };
        self.active[tool].waits_s = waits_s.max(0.0);
        if waits_s > 0.0 {
            return;
        }
        if !is_on && !self.active[tool].is_in_stroke {
            if self.tool_states[tool].now.is_triggered() {
                return;
            }
            // Of a stroke whose last edit was undone, the rest is still looked at.
            let mut step = BladeReport::default();
            self.finish_stroke(tool, &mut step, cuts);
            cuts.blades.add(&step);
            return;
        }
        let mut blade_m = [pose.tip_in_world_m, pose.tip_in_world_m + pose.shaft_in_world * blade.length_m];
        let Some(mut edge) = self.active[tool].edge.take() else { return };
        if let Some([outward_m, inward_m]) = self.tool_states[tool].overload.entry_m.take() {
            // The tissue that the edge pressed in will spring back over it: so deep is the first cut.
            let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
            edge.begin(body, positions_m, blade_m.map(|p| p + outward_m));
            blade_m = blade_m.map(|p| p + inward_m);
        }
        let (areas_before_m2, n_merged_before) = edge.figures();
        let (mut step, n_refused) = (BladeReport::default(), cuts.refusals.len());
        self.move_edge(tool, (&mut edge, is_on), blade_m, &mut step, cuts);
        let is_refused = has_frozen(&cuts.refusals[n_refused..]);
        if is_on && is_refused {
            self.active[tool].waits_s = TRIES_AGAIN_S;
        }
        let ends = !is_on || is_refused;
        let (areas_m2, n_merged) = edge.figures();
        // A stroke that was refused begins anew with nothing.
        let [swept_m2, cut_m2] = [0, 1].map(|i| (areas_m2[i] - areas_before_m2[i]).max(0.0));
        (step.swept_area_m2, step.cut_area_m2) = (swept_m2, cut_m2);
        step.n_merged = n_merged.saturating_sub(n_merged_before);
        self.active[tool].edge = Some(edge);
        self.active[tool].is_in_stroke = !ends;
        if ends {
            self.finish_stroke(tool, &mut step, cuts);
        }
        cuts.blades.add(&step);
        let active = &mut self.active[tool];
        active.stroke.add(&step);
        if ends {
            if active.stroke.cut_area_m2 > 0.0 {
                cuts.strokes.push((tool, active.stroke));
            }
            active.lift();
        }
    }

    /// The edges of scissors that have closed part what was between them: as a blade does that goes from the one jaw, where it was
    /// before, to the other. A model that follows nothing but removals loses the tetrahedra there.
    pub(super) fn snip(&mut self, tool: usize, (jaws, snip): (&Jaws, Snip), cuts: &mut ToolCuts) {
        let mut step = BladeReport::default();
        if snip != Snip::Tetrahedra {
            let (n_refused, n_edits) = (cuts.refusals.len(), cuts.n_edits);
            self.close_edges(tool, jaws, &mut step, cuts);
            if cuts.n_edits > n_edits || !has_frozen(&cuts.refusals[n_refused..]) {
                cuts.blades.add(&step);
                if step.cut_area_m2 > 0.0 {
                    cuts.strokes.push((tool, step));
                }
                return;
            }
            cuts.refusals.truncate(n_refused);
        }
        let tets = self.tetrahedra_between_jaws(tool);
        self.take_away(tool, tets, cuts);
    }

    fn close_edges(&mut self, tool: usize, jaws: &Jaws, step: &mut BladeReport, cuts: &mut ToolCuts) {
        let Some(mut edge) = self.active[tool].edge.take() else { return };
        let (frame, opening) = (ToolFrame::of(&self.pose_on_mesh(tool)), self.tool_states[tool].opened_to);
        let n_places = libm::ceil(jaws.opening_rad(opening) / CLOSES_AT_ONCE_RAD).max(1.0) as u32;
        let edge_m = |place: u32| {
            let end_m = jaws.between_ends_in_tool_m(opening, f64::from(place) / f64::from(n_places));
            [end_m, jaws.hinge_in_tool_m()].map(|at_m| frame.to_world_m(at_m))
        };
        edge.begin(self.organ.body(), self.model.state().positions_m, edge_m(0));
        for place in 1..=n_places {
            self.move_edge(tool, (&mut edge, place < n_places), edge_m(place), step, cuts);
        }
        let ([swept_m2, cut_m2], n_merged) = edge.figures();
        (step.swept_area_m2, step.cut_area_m2, step.n_merged) = (swept_m2, cut_m2, n_merged);
        self.active[tool].edge = Some(edge);
        self.finish_stroke(tool, step, cuts);
        self.active[tool].lift();
    }

    /// Moves an edge on in its stroke, or to the stroke's end when it is off.
    fn move_edge(
        &mut self,
        tool: usize,
        (edge, is_on): (&mut Edge, bool),
        blade_m: [DVec3; 2],
        step: &mut BladeReport,
        cuts: &mut ToolCuts,
    ) {
        match edge {
            Edge::Subdivision(cut) => self.subdivide(tool, (cut, is_on), blade_m, step, cuts),
            Edge::Displacement(cut) => self.displace(tool, (cut, is_on), blade_m, step, cuts),
        }
    }

    /// The edge is lifted: parts what the stroke left hanging together by a node or an edge alone, and mends what it spoilt.
    /// Either is an edit of its own, undone before the stroke's.
    fn finish_stroke(&mut self, tool: usize, step: &mut BladeReport, cuts: &mut ToolCuts) {
        let mut touched = std::mem::take(&mut self.active[tool].touched);
        touched.sort_unstable();
        touched.dedup();
        if touched.is_empty() {
            return;
        }
        let n_known = self.organ.body().topology().n_nodes();
        match self.part_singular_places(&touched) {
            Ok(is_parted) => {
                step.n_partings += usize::from(is_parted);
                cuts.n_edits += usize::from(is_parted);
            }
            Err(refusal) => cuts.refusals.push((tool, refusal)),
        }
        touched.extend((n_known..self.organ.body().topology().n_nodes()).map(NodeId::from_index));
        if !self.spec.mends_cuts {
            return;
        }
        match self.mend(&touched) {
            Ok(n_mended) => {
                step.n_mended += n_mended;
                cuts.n_edits += usize::from(n_mended > 0);
            }
            Err(refusal) => cuts.refusals.push((tool, refusal)),
        }
    }

    fn edge_is_on(&self, tool: usize) -> bool {
        self.tool_states[tool].edge_cuts(&self.spec.tools[tool], self.spec.tearing.as_ref())
    }

    /// An edit by an edge, which feels what it cost.
    fn edit_with_edge(
        &mut self,
        tool: usize,
        edits: &[MeshEdit],
        step: &mut BladeReport,
    ) -> Result<(), EditRefusal> {
        let change = self.edit_all(edits)?;
        // Scissors pay with the force that closes them.
        if self.spec.tearing.is_some() && self.spec.tools[tool].kind.blade().is_some() {
            let area_m2 = self.crack_area_m2(&change);
            self.owe_for_cut(tool, area_m2);
        }
        step.look_at(self.organ.body(), &change);
        let near = self.organ.body().topology().nodes_near(&change);
        self.active[tool].touched.extend(near);
        Ok(())
    }

    fn subdivide(
        &mut self,
        tool: usize,
        (cut, is_on): (&mut SubdivisionCut, bool),
        blade_m: [DVec3; 2],
        step: &mut BladeReport,
        cuts: &mut ToolCuts,
    ) {
        let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
        if !cut.params().is_nested {
            cut.hold_still(self.anchored_nodes());
        }
        let planned = if is_on {
            cut.advance(body, positions_m, blade_m)
        } else {
            cut.finish(body, positions_m, blade_m)
        };
        match planned {
            Ok(None) => {}
            Ok(Some(replacement)) => match self.edit_with_edge(tool, &[MeshEdit::Replace(replacement)], step)
            {
                Ok(()) => cuts.n_edits += 1,
                Err(refusal) => {
                    cut.take_back();
                    cuts.refusals.push((tool, refusal));
                }
            },
            Err(refusal) => cuts.refusals.push((tool, refusal.into())),
        }
    }

    fn displace(
        &mut self,
        tool: usize,
        (cut, is_on): (&mut ScalpelCut, bool),
        blade_m: [DVec3; 2],
        step: &mut BladeReport,
        cuts: &mut ToolCuts,
    ) {
        for _ in 0..MOST_EDITS {
            let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
            let planned =
                if is_on { cut.advance(body, positions_m, blade_m) } else { cut.finish(body, positions_m) };
            match planned {
                Ok(None) => return,
                Ok(Some(edits)) => match self.edit_with_edge(tool, &edits, step) {
                    Ok(()) => cuts.n_edits += 1,
                    Err(refusal) => {
                        *cut = ScalpelCut::new(ScalpelParams::default());
                        cuts.refusals.push((tool, refusal));
                        return;
                    }
                },
                Err(refusal) => {
                    cuts.refusals.push((tool, EditRefusal::Scalpel(refusal)));
                    return;
                }
            }
        }
    }
}

impl BladeReport {
    /// Notes the smallest dihedral angle that an edit left.
    fn look_at(&mut self, body: &EditableMesh, change: &TopologyChange) {
        let topology = body.topology();
        let new = change.tets.added.ids().iter().filter(|tet| topology.is_live_tet(**tet));
        for &tet in new.chain(&change.reshaped_tets) {
            let [_, largest_cosine] = dihedral_cosine_range(body.mesh().corners_m(tet));
            let angle_deg = libm::acos(largest_cosine.clamp(-1.0, 1.0)).to_degrees();
            self.worst_dihedral_deg = Some(self.worst_dihedral_deg.map_or(angle_deg, |w| w.min(angle_deg)));
        }
    }
}

fn mean_edge_m(body: &EditableMesh) -> f64 {
    let (topology, rest_m) = (body.topology(), &body.mesh().positions_m);
    let lengths = topology.live_edges().map(|edge| {
        let [a, b] = topology.edge_nodes(edge);
        rest_m[a.index()].distance(rest_m[b.index()])
    });
    let (n, sum) = lengths.fold((0, 0.0), |(n, sum), length_m| (n + 1, sum + length_m));
    sum / f64::from(n.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::box_mesh::box_of_five;
    use crate::tool::ToolKind;

    #[test]
    fn an_edit_that_is_taken_back_leaves_the_places_of_the_others_to_the_strokes_end() {
        let body = EditableMesh::new(box_of_five([1, 1, 1], DVec3::ONE)).unwrap();
        let home = crate::tool::ToolInput::at(DVec3::ZERO, DVec3::Z);
        let kind =
            ToolKind::scalpel(Blade { length_m: 0.1, edge_radius_m: 0.0, cuts: BladeCuts::Subdivision });
        let mut active = ActiveTip::new(&Tool { kind, ..Tool::probe("scalpel", 1e-3, home) }, &body);
        active.touched.push(NodeId(3));
        let before = active.before_edit();
        active.touched.push(NodeId(4));
        active.go_back_to(&before);
        assert_eq!(active.touched, [NodeId(3)]);
        active.lift();
        assert!(active.touched.is_empty());
    }
}
