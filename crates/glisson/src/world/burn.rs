//! What hot tips take away: what they sweep, or whole tetrahedra.
//!
//! A tip that sweeps takes away the ball around it, a bit larger than the tip; closed jaws with tissue in them the capsule along
//! them. It does so once the heat that went into the tissue pays for it, or, for a rule without a power, once it has been at work
//! for long enough; then what the ball went through meanwhile goes too. It begins when it is pressed on tissue, and is at work for as
//! long as the current is on and there is tissue in the ball: an arc needs no contact. The heat of what goes is that of its mass
//! ([`HeatedTissue`]); what is over is kept while the tip is at work, up to what the ball takes.

use super::parts::ToolPart;
use super::refusal::EditRefusal;
use super::touch::{HeldContact, Seat};
use super::{ToolCuts, World};
use crate::contact::shapes::Capsule;
use crate::math::DVec3;
use crate::mesh::TetId;
use crate::tool::cautery::HeatedTissue;
use crate::tool::cut::subdivision::carving::{Carved, Carving, meets};
use crate::tool::{Burnt, CutRule};

/// A tip that has gone further than so many radii since it last took something away has left that behind. A choice.
const MOST_WAY: f64 = 2.0;
/// Layers that a hot tip looks at for what its heat pays: all of it, and what is left of it twice. A choice.
const LOOKS: usize = 3;
/// Least volume that goes at once, as a multiple of what the ball takes of a flat surface that the tip touches: at first, and later
/// for a rule without a power, whose tips carve for nothing. Choices.
const LEAST_AT_FIRST: f64 = 0.7;
const LEAST_BY_TIME: f64 = 2.5;
/// A tip stays in contact with what is left no further from it than so many radii. A choice.
const KEPT_WITHIN: f64 = 1.0;

/// The heat of a tip that takes away what it sweeps.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SweptHeat {
    /// Where the tip was when something last went, or when it began to be at work [m].
    from_m: Option<DVec3>,
    /// How long it has been at work since [s].
    active_s: f64,
    /// Heat that went into the tissue since, and what was over [J].
    heat_j: f64,
    /// Heat with which it is looked at what goes [J].
    look_j: f64,
    /// Heat that all in the ball takes [J], when it was last looked at.
    price_j: f64,
    /// Whether something went since it is at work.
    has_carved: bool,
    /// Whether the model follows nothing but removals.
    takes_tetrahedra: bool,
}

impl SweptHeat {
    /// All of it as numbers; none for a tip that is not at work.
    pub(super) fn numbers(&self) -> impl Iterator<Item = f64> + use<> {
        let Self { from_m, active_s, heat_j, look_j, price_j, has_carved, takes_tetrahedra } = *self;
        let [has_carved, takes_tetrahedra] =
            [has_carved, takes_tetrahedra].map(|flag| f64::from(u8::from(flag)));
        let known = from_m.map(|from_m| {
            let [x, y, z] = from_m.to_array();
            [x, y, z, active_s, heat_j, look_j, price_j, has_carved, takes_tetrahedra]
        });
        known.into_iter().flatten()
    }
}

/// What a tip that takes away what it sweeps keeps.
#[derive(Clone, Debug, Default)]
pub(super) struct Burn {
    pub(super) swept: SweptHeat,
    carving: Carving,
}

impl World {
    /// What a hot tip does in a step.
    pub(super) fn burn(&mut self, tool: usize, rule: &CutRule, cuts: &mut ToolCuts) {
        if !self.tool_states[tool].now.is_triggered() {
            // Released: the next time begins anew.
            self.active[tool].burn.swept = SweptHeat::default();
        }
        match rule.takes {
            Burnt::Swept { depth_m } if !self.active[tool].burn.swept.takes_tetrahedra => {
                self.burn_swept(tool, rule, depth_m, cuts);
            }
            _ => {
                let tets = self.burnt(tool, rule);
                self.take_away(tool, tets, cuts);
            }
        }
    }

    /// Takes tetrahedra out for a tool.
    pub(super) fn take_away(&mut self, tool: usize, tets: Vec<TetId>, cuts: &mut ToolCuts) {
        if tets.is_empty() {
            return;
        }
        let n_tets = tets.len();
        match self.remove_and_part(tets) {
            Ok(()) => cuts.n_removed += n_tets,
            Err(refusal) => cuts.refusals.push((tool, refusal)),
        }
    }

    fn burn_swept(&mut self, tool: usize, rule: &CutRule, depth_m: f64, cuts: &mut ToolCuts) {
        let (hand, dt_s) = (&self.tool_states[tool], self.spec.time_step_s);
        let (is_on, is_pressed) = (hand.now.is_triggered(), hand.active_s > 0.0);
        let before = self.active[tool].burn.swept;
        self.tool_states[tool].overload.strength_left = 1.0;
        if !(is_on && (is_pressed || before.from_m.is_some())) {
            self.active[tool].burn.swept = SweptHeat::default();
            return;
        }
        let tip_m = self.pose_on_mesh(tool).tip_in_world_m;
        let radius_m = self.spec.tools[tool].tip_radius_m + depth_m;
        let from_m = before.from_m.filter(|from_m| from_m.distance(tip_m) <= MOST_WAY * radius_m);
        let is_hot = rule.power_w > 0.0;
        let mut swept = SweptHeat {
            from_m: from_m.or(Some(tip_m)),
            active_s: before.active_s + dt_s,
            heat_j: before.heat_j + rule.power_w * dt_s,
            ..before
        };
        let is_due = if is_hot { swept.heat_j >= swept.look_j } else { swept.active_s >= rule.least_time_s };
        if is_due {
            let from_m = from_m.filter(|_| !is_hot).unwrap_or(tip_m);
            swept = self.carve_what_is_paid(tool, (depth_m, from_m, is_hot), swept, cuts);
        }
        if swept.price_j > 0.0 {
            let strength_left = (1.0 - swept.heat_j / swept.price_j).clamp(0.0, 1.0);
            self.tool_states[tool].overload.strength_left = strength_left;
        }
        self.active[tool].burn.swept = swept;
    }

    /// Carves the ball on its way from a place, or of a hot tip a thinner layer if the heat pays for no more.
    fn carve_what_is_paid(
        &mut self,
        tool: usize,
        (depth_m, from_m, is_hot): (f64, DVec3, bool),
        mut swept: SweptHeat,
        cuts: &mut ToolCuts,
    ) -> SweptHeat {
        let ball_m = self.spec.tools[tool].tip_radius_m + depth_m;
        let cap_m3 = std::f64::consts::PI * depth_m * depth_m * (ball_m - depth_m / 3.0);
        let least = if swept.has_carved && !is_hot { LEAST_BY_TIME } else { LEAST_AT_FIRST };
        let least_m3 = least * cap_m3;
        let per_m3_j = if is_hot { HeatedTissue::LIVER.heat_to_part_j_per_m3() } else { 0.0 };
        // What boils off in a cavity is not kept for later: no more than all of the ball takes.
        let ball_m3 = 4.0 / 3.0 * std::f64::consts::PI * ball_m.powi(3);
        swept.heat_j = swept.heat_j.min(swept.price_j.max(ball_m3 * per_m3_j));
        (swept.look_j, swept.active_s) = (swept.heat_j + 0.5 * least_m3 * per_m3_j, 0.0);
        // Another tool may have cut in this step.
        self.organ.refresh();
        let mut share = 1.0;
        for _ in 0..LOOKS {
            let Some(solid) = self.burnt_capsule(tool, share * depth_m, from_m) else { return swept };
            let near = self.tetrahedra_in(&solid);
            if near.is_empty() && share == 1.0 {
                return SweptHeat::default();
            }
            let mut carving = std::mem::take(&mut self.active[tool].burn.carving);
            let carved = carving.plan(self.organ.body(), self.organ.positions_m(), &near, &solid);
            self.active[tool].burn.carving = carving;
            // Slices would divide the wall ever finer.
            let Some(carved) = carved.filter(|carved| carved.present_m3 >= least_m3) else { return swept };
            let price_j = carved.rest_m3 * per_m3_j;
            if swept.heat_j >= price_j {
                return self.carve(tool, &carved, price_j, swept, cuts);
            }
            swept.price_j = swept.price_j.max(price_j);
            share *= swept.heat_j / price_j;
        }
        swept
    }

    /// What the tip takes away: the ball on its way from `from_m`, or the capsule along jaws that hold something.
    fn burnt_capsule(&self, tool: usize, depth_m: f64, from_m: DVec3) -> Option<Capsule> {
        let spec = self.spec.tools.get(tool)?;
        let pose = self.pose_on_mesh(tool);
        let tip_m = pose.tip_in_world_m;
        Some(match spec.kind.jaws().filter(|_| self.tool_states[tool].grasp.is_some()) {
            Some(jaws) => Capsule {
                from_m: tip_m,
                to_m: tip_m + pose.shaft_in_world * jaws.length_m,
                radius_m: 0.5 * jaws.width_m + depth_m,
            },
            None => Capsule { from_m, to_m: tip_m, radius_m: spec.tip_radius_m + depth_m },
        })
    }

    /// The live tetrahedra that a capsule meets, as far as they hang together with the surface that it meets.
    fn tetrahedra_in(&self, solid: &Capsule) -> Vec<TetId> {
        let positions_m = self.organ.positions_m();
        let topology = self.organ.body().topology();
        self.grown_from_surface(solid, |tet| {
            meets(solid, topology.tet_nodes(tet).map(|n| positions_m[n.index()]))
        })
    }

    /// Carves; what the tip keeps then.
    fn carve(
        &mut self,
        tool: usize,
        carved: &Carved,
        price_j: f64,
        mut swept: SweptHeat,
        cuts: &mut ToolCuts,
    ) -> SweptHeat {
        let held = self.tool_states[tool].contacts[ToolPart::Tip.index()].clone();
        let tip_m = self.pose_on_mesh(tool).tip_in_world_m;
        let change = match self.edit_all(&carved.edits) {
            Ok(change) => change,
            Err(refusal) => {
                if matches!(refusal, EditRefusal::Model(_)) {
                    swept.takes_tetrahedra = true;
                } else {
                    cuts.refusals.push((tool, refusal));
                }
                return swept;
            }
        };
        cuts.n_removed += carved.n_removed;
        cuts.burnt_m3 += carved.rest_m3;
        swept.heat_j -= price_j;
        (swept.look_j, swept.price_j) = (0.0, 0.0);
        swept.from_m = Some(tip_m);
        swept.has_carved = true;
        // Parting is an edit of its own: taken back, it leaves the tip as it is now.
        self.active[tool].burn.swept = swept;
        let near = self.organ.body().topology().nodes_near(&change);
        if let Err(refusal) = self.part_singular_places(&near) {
            cuts.refusals.push((tool, refusal));
        }
        if let Some(held) = held {
            self.keep_contact(tool, held, tip_m);
        }
        swept
    }

    /// The tip, which was at `tip_m` on the mesh, touches what is nearest to it now that what it touched is gone: it is as deep in the
    /// tissue as before for what the mesh is too coarse for.
    fn keep_contact(&mut self, tool: usize, mut held: HeldContact, tip_m: DVec3) {
        let tip = ToolPart::Tip.index();
        if self.tool_states[tool].contacts[tip].is_some() {
            return;
        }
        let ball = Capsule::ball(tip_m, self.spec.tools[tool].tip_radius_m);
        self.organ.refresh();
        let mut found = Vec::with_capacity(1);
        self.organ.skin().nearest_into(&ball, KEPT_WITHIN * ball.radius_m, &mut found);
        let Some(nearest) = found.first() else { return };
        let place = self.organ.skin().place_of(*nearest);
        let normal = self.organ.body().topology().triangle_normal(place.triangle, self.organ.positions_m());
        let (at, weights) = (held.at, nearest.weights);
        let force_n = DVec3::ZERO;
        held.sit_on(&Seat { triangle: place.triangle, nodes: place.nodes, weights, at, normal, force_n });
        self.tool_states[tool].contacts[tip] = Some(held);
    }

    /// What a hot tip takes away: all that it touches once it has been at work for long enough, or, for a rule with a
    /// power, what has taken up enough heat. The time is seed `000`'s rule (s. 4.4.2): it counts no energy.
    pub(super) fn burnt(&mut self, tool: usize, rule: &CutRule) -> Vec<TetId> {
        let (hand, dt_s) = (&self.tool_states[tool], self.spec.time_step_s);
        let tissue = HeatedTissue::LIVER;
        let is_hot = rule.power_w > 0.0;
        let is_at_work = hand.active_s > 0.0;
        if !is_at_work {
            self.active[tool].heat.cool_down(&tissue, dt_s);
        }
        // Without current only what was warmed before is weaker.
        let is_looked_at =
            if is_at_work { is_hot || hand.active_s >= rule.least_time_s } else { self.presses_warm(tool) };
        if !is_looked_at {
            self.tool_states[tool].overload.strength_left = 1.0;
            return Vec::new();
        }
        let touched = match self.tool_states[tool].grasp {
            Some(_) => self.tetrahedra_between_jaws(tool),
            None => self.touched_tetrahedra(tool),
        };
        if !is_hot {
            self.tool_states[tool].active_s = 0.0;
            return touched;
        }
        let mut parted = Vec::new();
        let heat = &mut self.active[tool].heat;
        if is_at_work {
            let mesh = self.organ.mesh();
            let with_volumes = touched.iter().map(|&tet| (tet, mesh.tet_volume_m3(tet)));
            heat.heat_up(&tissue, rule.power_w, with_volumes, dt_s, &mut parted);
        }
        let left = touched.iter().map(|&tet| tissue.strength_left(heat.of(tet)));
        self.tool_states[tool].overload.strength_left = left.fold(1.0, f64::min);
        parted
    }

    /// Whether a tip that is off loads tissue, and some is warm.
    fn presses_warm(&self, tool: usize) -> bool {
        let hand = &self.tool_states[tool];
        let touches = |part: ToolPart| hand.contacts[part.index()].is_some();
        let loads = hand.grasp.is_some() || touches(ToolPart::Tip) || touches(ToolPart::SecondJaw);
        loads && !self.active[tool].heat.warm().is_empty()
    }
}
