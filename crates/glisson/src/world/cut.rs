//! What the instruments cut, by their kind.
//!
//! Hook and cautery take away what they sweep, or the tetrahedra that they touch, once the force has reached a threshold (seed
//! `000`, s. 4.4.2) and the current has been on for long enough, or has heated it enough ([`super::burn`]); a scalpel parts
//! the mesh along its edge, scissors along the surface between their jaws when these close ([`super::active`]).

use super::parts::{ToolPart, capsule};
use super::tool_state::{ToolState, scissors_lack_n};
use super::{EditRefusal, World};
use crate::contact::tool_contact::ToolContact;
use crate::math::{DVec3, closest_point_barycentric, tetrahedron_volume_m3};
use crate::mesh::TetId;
use crate::mesh::topology::TET_TRIANGLES;
use crate::tool::Tool;
use crate::tool::pose::ToolFrame;
use std::collections::HashSet;

/// A tip that stands on the surface touches it but for rounding: this share of its radius is added to it.
const REACH: f64 = 1.01;

/// Surface triangles that a tip can touch at once and are looked at.
const MOST_TRIANGLES: usize = 256;

/// What the tools cut after a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ToolCuts {
    /// Tetrahedra that were taken out; parts of such, where hot tips take away what they sweep.
    pub n_removed: usize,
    /// Volume at rest that hot tips swept away [m3].
    pub burnt_m3: f64,
    /// Tetrahedra that tore under force ([`crate::world::spec::WorldSpec::tearing`]).
    pub n_torn: usize,
    /// Edits by which blades parted the mesh, and those that parted singular places and mended the mesh at a stroke's end.
    pub n_edits: usize,
    /// Strands of attachments that were parted.
    pub n_parted: usize,
    /// What the blades did.
    pub blades: BladeReport,
    /// Strokes of blades that ended and cut something, each whole, with the tool's number.
    pub strokes: Vec<(usize, BladeReport)>,
    /// Why something was not cut, with the tool's number.
    pub refusals: Vec<(usize, EditRefusal)>,
    /// Why stretched tissue did not tear.
    pub tear_refusal: Option<EditRefusal>,
}

/// What blades did: in a call, in a stroke, or since the start. An edit that is undone later still counts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BladeReport {
    /// Area that blades which divide tetrahedra swept inside the organ, in its deformed shape [m2].
    pub swept_area_m2: f64,
    /// Area of the faces that opened, one side [m2]: deformed for blades that divide tetrahedra, at rest for those that move
    /// nodes.
    pub cut_area_m2: f64,
    /// Strokes whose opened area is not the swept one, because faces merged with others by snapping
    /// ([`crate::tool::cut::subdivision::CutReport::n_merged`]).
    pub n_merged: usize,
    /// Smallest dihedral angle at rest of a tetrahedron that a cut made or moved [degrees]; none without any.
    pub worst_dihedral_deg: Option<f64>,
    /// Strokes after which something hung together by a node or an edge alone and was parted.
    pub n_partings: usize,
    /// Places that were mended at the end of strokes ([`crate::world::spec::WorldSpec::mends_cuts`]).
    pub n_mended: usize,
}

impl BladeReport {
    /// Adds another one.
    pub(super) fn add(&mut self, other: &Self) {
        self.swept_area_m2 += other.swept_area_m2;
        self.cut_area_m2 += other.cut_area_m2;
        self.n_merged += other.n_merged;
        self.n_partings += other.n_partings;
        self.n_mended += other.n_mended;
        self.worst_dihedral_deg =
            self.worst_dihedral_deg.into_iter().chain(other.worst_dihedral_deg).min_by(f64::total_cmp);
    }
}

impl ToolState {
    /// Counts how long the active tip has been at work under the force of the tissue; called in every step.
    pub(super) fn count_activity(&mut self, tool: &Tool, of_tissue_n: DVec3, dt_s: f64) {
        let works = tool.kind.burning().is_some_and(|rule| {
            // What closed jaws hold is pressed by the jaws themselves.
            let is_pressed =
                self.contacts[ToolPart::Tip.index()].is_some() && of_tissue_n.length() >= rule.least_force_n;
            self.now.is_triggered() && (self.grasp.is_some() || is_pressed)
        });
        self.active_s = if works { self.active_s + dt_s } else { 0.0 };
    }
}

impl World {
    /// Cuts what the tools cut in the step just made. Depends on the world alone, so that a replay that calls it after
    /// every step makes the same bits. Allocates when something is cut.
    pub fn cut_with_tools(&mut self) -> ToolCuts {
        let mut cuts = ToolCuts::default();
        for tool in 0..self.tool_states.len() {
            cuts.n_parted += self.part_attachments(tool);
            self.tie_off(tool);
            let hand = &self.tool_states[tool];
            let kind = self.spec.tools[tool].kind;
            if let Some(rule) = kind.burning() {
                self.burn(tool, rule, &mut cuts);
                self.tool_states[tool].just_closed = false;
            } else if let Some(blade) = kind.blade() {
                self.cut_with_blade(tool, blade, &mut cuts);
            } else if let Some((jaws, snip)) = kind.parting_jaws().filter(|_| hand.just_closed) {
                match scissors_lack_n(jaws, self.spec.tearing.as_ref()) {
                    None => self.snip(tool, (jaws, snip), &mut cuts),
                    Some(needed_n) => {
                        let found_n = jaws.closing_force_n;
                        cuts.refusals.push((tool, EditRefusal::TooWeak { found_n, needed_n }));
                    }
                }
                self.tool_states[tool].just_closed = false;
            }
        }
        self.tear(&mut cuts);
        self.blades.add(&cuts.blades);
        cuts
    }

    /// What blades did since the start.
    pub fn blades(&self) -> &BladeReport {
        &self.blades
    }

    /// The live tetrahedra that the tip of a tool touches in their present shape, ascending: those under the surface that
    /// it stands on, and those within its radius behind them.
    pub fn touched_tetrahedra(&self, tool: usize) -> Vec<TetId> {
        let Some(spec) = self.spec.tools.get(tool) else { return Vec::new() };
        self.tetrahedra_near(self.pose_on_mesh(tool).tip_in_world_m, spec.tip_radius_m)
    }

    /// The live tetrahedra that a ball touches in their present shape, ascending, as far as they hang together with the
    /// surface that it touches.
    pub(super) fn tetrahedra_near(&self, middle_m: DVec3, radius_m: f64) -> Vec<TetId> {
        let reach_m = REACH * radius_m;
        let ball = crate::contact::shapes::Capsule::ball(middle_m, reach_m);
        let positions_m = self.organ.positions_m();
        let topology = self.organ.body().topology();
        self.grown_from_surface(&ball, |tet| {
            is_within(middle_m, reach_m, topology.tet_nodes(tet).map(|n| positions_m[n.index()]))
        })
    }

    /// The live tetrahedra whose middle lies between the jaws of a tool, as far as these were open, ascending; if there is
    /// none, those that the tips of the jaws touch.
    pub fn tetrahedra_between_jaws(&self, tool: usize) -> Vec<TetId> {
        let Some((hand, spec)) = self.tool_states.get(tool).zip(self.spec.tools.get(tool)) else {
            return Vec::new();
        };
        let Some(jaws) = spec.kind.jaws() else { return Vec::new() };
        let pose = self.pose_on_mesh(tool);
        let (frame, opening) = (ToolFrame::of(&pose), hand.opened_to);
        let Some(mut around) = capsule(spec, ToolPart::Tip, &pose) else { return Vec::new() };
        around.radius_m += jaws.ends_in_tool_m(opening)[0].x + 0.5 * jaws.width_m;
        let positions_m = self.organ.positions_m();
        let topology = self.organ.body().topology();
        let between = self.grown_from_surface(&around, |tet| {
            let middle_m =
                topology.tet_nodes(tet).iter().map(|n| positions_m[n.index()]).sum::<DVec3>() / 4.0;
            jaws.are_around(frame.to_tool_m(middle_m), opening, spec.tip_radius_m)
        });
        if between.is_empty() { self.touched_tetrahedra(tool) } else { between }
    }

    /// Tetrahedra that `is_in` takes, ascending: those at surface triangles near a capsule, and on from neighbour to
    /// neighbour.
    pub(super) fn grown_from_surface(
        &self,
        around: &crate::contact::shapes::Capsule,
        is_in: impl Fn(TetId) -> bool,
    ) -> Vec<TetId> {
        let topology = self.organ.body().topology();
        let mut near: Vec<ToolContact> = Vec::with_capacity(MOST_TRIANGLES);
        self.organ.skin().near_into(around, 0.0, &mut near);
        let at_surface = near.iter().filter_map(|&contact| {
            topology.triangle_tets(self.organ.skin().place_of(contact).triangle)[0].get()
        });
        let mut tets: Vec<TetId> = Vec::new();
        let mut is_known = HashSet::new();
        for tet in at_surface {
            if is_known.insert(tet) && is_in(tet) {
                tets.push(tet);
            }
        }
        let mut at = 0;
        while at < tets.len() {
            for neighbour in topology.tet_neighbours(tets[at]).into_iter().filter_map(|n| n.get()) {
                if is_known.insert(neighbour) && is_in(neighbour) {
                    tets.push(neighbour);
                }
            }
            at += 1;
        }
        tets.sort_unstable();
        tets
    }
}

/// Whether a point lies in a tetrahedron or no further from it than `reach_m`.
fn is_within(point_m: DVec3, reach_m: f64, corners_m: [DVec3; 4]) -> bool {
    let low_m = corners_m.into_iter().fold(corners_m[0], DVec3::min) - reach_m;
    let high_m = corners_m.into_iter().fold(corners_m[0], DVec3::max) + reach_m;
    if !(point_m.cmpge(low_m).all() && point_m.cmple(high_m).all()) {
        return false;
    }
    let volume_m3 = tetrahedron_volume_m3(corners_m);
    let is_inside = (0..4).all(|i| {
        let mut part_m = corners_m;
        part_m[i] = point_m;
        tetrahedron_volume_m3(part_m) * volume_m3.signum() >= 0.0
    });
    is_inside
        || TET_TRIANGLES.into_iter().any(|triangle| {
            let [a, b, c] = triangle.map(|i| corners_m[i]);
            let [u, v, w] = closest_point_barycentric(point_m, [a, b, c]);
            (a * u + b * v + c * w).distance(point_m) <= reach_m
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_touches_what_it_lies_in_and_what_is_near() {
        let corners_m = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        assert!(is_within(DVec3::splat(0.2), 1e-9, corners_m));
        assert!(is_within(DVec3::new(0.2, 0.2, -0.1), 0.11, corners_m));
        assert!(!is_within(DVec3::new(0.2, 0.2, -0.1), 0.09, corners_m));
        assert!(is_within(DVec3::new(1.1, 0.0, 0.0), 0.11, corners_m));
        // In the box around it, but beyond the slanted face.
        assert!(!is_within(DVec3::splat(0.6), 0.2, corners_m));
        let [a, b, c, d] = corners_m;
        assert!(is_within(DVec3::splat(0.2), 1e-9, [b, a, c, d]), "an inverted one as well");
    }
}
