//! Edges and hot tips: what an instrument keeps of its cut from step to step.

use super::edits::EditRefusal;
use super::tear::edge_cuts;
use super::{ToolCuts, World};
use crate::math::DVec3;
use crate::mesh::TetId;
use crate::mesh::edit::{EditableMesh, MeshEdit};
use crate::tool::cautery::{HeatedTissue, TissueHeat};
use crate::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use crate::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};
use crate::tool::{Blade, BladeCuts, CutRule, Tool, ToolKind};

/// Transactions of one blade in one step at most; what is left is done after the next one.
const MOST_EDITS: usize = 64;
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
}

/// The active part of one tool.
#[derive(Clone, Debug)]
pub(super) struct ActiveTip {
    edge: Option<Edge>,
    /// Whether a stroke is under way.
    is_in_stroke: bool,
    heat: TissueHeat,
}

impl ActiveTip {
    pub(super) fn new(tool: &Tool, body: &EditableMesh) -> Self {
        let edge = match &tool.kind {
            ToolKind::Scalpel(Blade { cuts: BladeCuts::Subdivision, .. }) => {
                let params = SubdivisionParams::for_mean_edge(mean_edge_m(body));
                Some(Edge::Subdivision(Box::new(SubdivisionCut::new(params))))
            }
            ToolKind::Scalpel(Blade { cuts: BladeCuts::Displacement, .. }) => {
                Some(Edge::Displacement(Box::new(ScalpelCut::new(ScalpelParams::default()))))
            }
            _ => None,
        };
        let n_warm =
            if matches!(tool.kind, ToolKind::Hook(_) | ToolKind::Cautery(..)) { MOST_WARM } else { 0 };
        Self { edge, is_in_stroke: false, heat: TissueHeat::with_room_for(n_warm) }
    }

    /// Everything that the next cuts depend on and is not told by the mesh: the heat.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.heat.warm().iter().flat_map(|&(tet, heat)| [f64::from(tet.0), heat])
    }

    /// What is warm.
    pub(super) fn heat(&self) -> TissueHeat {
        self.heat.clone()
    }

    /// An edit was taken back: what was warm then is warm again, and the next stroke begins anew, because the front of
    /// the last one may be gone.
    pub(super) fn go_back_to(&mut self, heat: &TissueHeat) {
        self.lift();
        self.heat.clone_from(heat);
    }

    /// The stroke is over; the next one begins where the blade then is. What was warm has cooled.
    pub(super) fn lift(&mut self) {
        match &mut self.edge {
            Some(Edge::Subdivision(cut)) => cut.lift(),
            Some(Edge::Displacement(cut)) => **cut = ScalpelCut::new(ScalpelParams::default()),
            None => {}
        }
        self.is_in_stroke = false;
        self.heat.keep_live(|_| false);
    }

    /// Follows an edit that is not its own.
    pub(super) fn follow(&mut self, body: &EditableMesh, change: &crate::mesh::edit::TopologyChange) {
        if let Some(Edge::Subdivision(cut)) = &mut self.edge {
            cut.topology_changed(change);
        }
        self.heat.keep_live(|tet| body.topology().is_live_tet(tet));
    }
}

impl World {
    /// Cuts along an edge while the trigger is pressed, and ends the stroke when it is not.
    pub(super) fn cut_with_blade(&mut self, tool: usize, blade: &Blade, cuts: &mut ToolCuts) {
        let pose = self.hands[tool].now;
        let is_on = self.edge_is_on(tool);
        if !is_on && !self.active[tool].is_in_stroke {
            return;
        }
        let mut blade_m = [pose.tip_in_world_m, pose.tip_in_world_m + pose.shaft_in_world * blade.length_m];
        let Some(mut edge) = self.active[tool].edge.take() else { return };
        if let Some([outward_m, inward_m]) = self.hands[tool].overload.entry_m.take() {
            // The tissue that the edge pressed in will spring back over it: so deep is the first cut.
            let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
            edge.begin(body, positions_m, blade_m.map(|p| p + outward_m));
            blade_m = blade_m.map(|p| p + inward_m);
        }
        match &mut edge {
            Edge::Subdivision(cut) => self.subdivide(tool, cut, blade_m, cuts),
            Edge::Displacement(cut) => self.displace(tool, cut, blade_m, cuts),
        }
        let active = &mut self.active[tool];
        active.edge = Some(edge);
        active.is_in_stroke = is_on;
        if !is_on {
            active.lift();
        }
    }

    fn edge_is_on(&self, tool: usize) -> bool {
        edge_cuts(&self.spec.tools[tool], &self.hands[tool], self.spec.tearing.as_ref())
    }

    /// An edit by an edge, which feels what it cost.
    fn edit_with_edge(&mut self, tool: usize, edits: &[MeshEdit]) -> Result<(), EditRefusal> {
        let change = self.edit_all(edits)?;
        if self.spec.tearing.is_some() {
            let area_m2 = self.crack_area_m2(&change);
            self.owe_for_cut(tool, area_m2);
        }
        Ok(())
    }

    fn subdivide(&mut self, tool: usize, cut: &mut SubdivisionCut, blade_m: [DVec3; 2], cuts: &mut ToolCuts) {
        let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
        let is_on = self.edge_is_on(tool);
        let planned = if is_on {
            cut.advance(body, positions_m, blade_m)
        } else {
            cut.finish(body, positions_m, blade_m)
        };
        match planned {
            Ok(None) => {}
            Ok(Some(replacement)) => match self.edit_with_edge(tool, &[MeshEdit::Replace(replacement)]) {
                Ok(()) => cuts.n_edits += 1,
                Err(refusal) => {
                    cut.take_back();
                    cuts.refusals.push((tool, refusal));
                }
            },
            Err(refusal) => cuts.refusals.push((tool, refusal.into())),
        }
    }

    fn displace(&mut self, tool: usize, cut: &mut ScalpelCut, blade_m: [DVec3; 2], cuts: &mut ToolCuts) {
        let is_on = self.edge_is_on(tool);
        for _ in 0..MOST_EDITS {
            let (body, positions_m) = (self.organ.body(), self.model.state().positions_m);
            let planned =
                if is_on { cut.advance(body, positions_m, blade_m) } else { cut.finish(body, positions_m) };
            match planned {
                Ok(None) => return,
                Ok(Some(edits)) => match self.edit_with_edge(tool, &edits) {
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

    /// What a hot tip takes away: all that it touches once it has been at work for long enough, or, for a rule with a
    /// power, what has taken up enough heat.
    pub(super) fn burnt(&mut self, tool: usize, rule: &CutRule) -> Vec<TetId> {
        let (hand, dt_s) = (&self.hands[tool], self.spec.time_step_s);
        let tissue = HeatedTissue::LIVER;
        if hand.active_s == 0.0 {
            self.active[tool].heat.cool_down(&tissue, dt_s);
            self.hands[tool].overload.strength_left = 1.0;
            return Vec::new();
        }
        let is_hot = rule.power_w > 0.0;
        if !is_hot && hand.active_s < rule.least_time_s {
            return Vec::new();
        }
        let touched = match hand.grasp {
            Some(_) => self.tetrahedra_between_jaws(tool),
            None => self.touched_tetrahedra(tool),
        };
        if !is_hot {
            self.hands[tool].active_s = 0.0;
            return touched;
        }
        let mesh = self.organ.mesh();
        let with_volumes = touched.iter().map(|&tet| (tet, mesh.tet_volume_m3(tet)));
        let mut parted = Vec::new();
        let heat = &mut self.active[tool].heat;
        heat.heat_up(&tissue, rule.power_w, with_volumes, dt_s, &mut parted);
        let left = touched.iter().map(|&tet| tissue.strength_left(heat.of(tet)));
        self.hands[tool].overload.strength_left = left.fold(1.0, f64::min);
        parted
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
