//! Attachments between bodies that instruments part: what an edge sweeps, what a hot tip reaches, what jaws close on.
//!
//! An attachment is a bundle of strands ([`crate::contact::response::bond::Bond`]). Those that can be cut go one by one where an
//! instrument passes within its tip's radius of them; they cost no force and no heat, which is little beside that of tissue.

use super::World;
use super::bodies::SurfaceContact;
use crate::math::{DVec3, closest_point_barycentric, segment_distance};
use crate::surface::intersect::segment_meets_triangle;
use crate::tool::pose::ToolFrame;
use crate::tool::{Burnt, CutRule, ToolInput};

/// Scissors close over so many flat faces: a choice.
const FACES_OF_SCISSORS: u32 = 4;

/// What a part of an instrument went through in a step.
enum Swept {
    Line([DVec3; 2]),
    Face([DVec3; 3]),
}

impl Swept {
    /// Whether a strand comes within `reach_m` of it.
    fn meets(&self, strand_m: [DVec3; 2], reach_m: f64) -> bool {
        match *self {
            Self::Line(line_m) => segment_distance(strand_m, line_m) <= reach_m,
            Self::Face(corners_m) => {
                let [a, b, c] = corners_m;
                let sides_m = [[a, b], [b, c], [c, a]];
                let is_flat = (b - a).cross(c - a) == DVec3::ZERO;
                let is_near = |end_m: DVec3| {
                    let [u, v, w] = closest_point_barycentric(end_m, corners_m);
                    (a * u + b * v + c * w).distance(end_m) <= reach_m
                };
                sides_m.iter().any(|&side_m| segment_distance(strand_m, side_m) <= reach_m)
                    || strand_m.into_iter().any(is_near)
                    || !is_flat && segment_meets_triangle(strand_m[0], strand_m[1], corners_m)
            }
        }
    }
}

/// The faces over which an edge went from one place to another.
fn faces_between([b0, b1]: [DVec3; 2], [n0, n1]: [DVec3; 2]) -> [Swept; 2] {
    [Swept::Face([b0, b1, n1]), Swept::Face([b0, n1, n0])]
}

impl World {
    /// The strands of attachments that hold, with the number of each and its ends now [m].
    pub fn strands_m(&self) -> impl Iterator<Item = (usize, [DVec3; 2])> + '_ {
        let positions_m = self.model.state().positions_m;
        self.body_contact().into_iter().flat_map(move |contact| contact.bonds_m(positions_m))
    }

    /// Strands between two bodies: how many hold, and how many there were.
    pub fn n_strands_between(&self, bodies: [usize; 2]) -> [usize; 2] {
        let n_at_start = (0..self.spec.bonds.len()).filter(|bond| self.joins(*bond, bodies)).count();
        [self.strands_between(bodies).count(), n_at_start]
    }

    /// The strands between two bodies that hold.
    fn strands_between(&self, bodies: [usize; 2]) -> impl Iterator<Item = usize> + '_ {
        self.strands_m().map(|(bond, _)| bond).filter(move |bond| self.joins(*bond, bodies))
    }

    /// Whether a strand is between these two bodies.
    fn joins(&self, bond: usize, [one, other]: [usize; 2]) -> bool {
        let [node, corner, ..] = self.spec.bonds[bond].nodes.map(|node| node.0);
        let is_of = |body: usize, node: u32| self.spec.bodies[body].nodes.contains(&node);
        is_of(one, node) && is_of(other, corner) || is_of(other, node) && is_of(one, corner)
    }

    /// Whether anything between two bodies can be parted, by an instrument or a pull.
    pub fn can_be_detached(&self, bodies: [usize; 2]) -> bool {
        let can_part = |bond: usize| {
            let bond = &self.spec.bonds[bond];
            bond.can_be_cut || bond.strength_n.is_finite()
        };
        self.strands_between(bodies).all(can_part)
    }

    /// Parts the strands that an instrument went through in the step just made; answers how many.
    pub(super) fn part_attachments(&mut self, tool: usize) -> usize {
        if !self.spec.bonds.iter().any(|bond| bond.can_be_cut) {
            return 0;
        }
        let swept = self.swept_by(tool);
        let reach_m = |rule: Option<&CutRule>| match rule.map(|rule| rule.takes) {
            Some(Burnt::Swept { depth_m }) => depth_m,
            _ => 0.0,
        };
        let spec = &self.spec.tools[tool];
        let reach_m = spec.tip_radius_m + reach_m(spec.kind.burning());
        let positions_m = self.model.state().positions_m;
        match self.self_contact.as_deref_mut() {
            Some(SurfaceContact::Bodies(contact)) if !swept.is_empty() => contact
                .part_bonds(positions_m, |strand_m| swept.iter().any(|part| part.meets(strand_m, reach_m))),
            _ => 0,
        }
    }

    /// What the active part of an instrument went through in the step just made; nothing of one that is not at work.
    fn swept_by(&self, tool: usize) -> Vec<Swept> {
        let (hand, kind) = (&self.tool_states[tool], &self.spec.tools[tool].kind);
        let on_mesh = self.pose_on_mesh(tool);
        if kind.burning().is_some() {
            if !hand.now.is_triggered() {
                return Vec::new();
            }
            let tip_m = on_mesh.tip_in_world_m;
            return vec![match kind.jaws() {
                Some(jaws) => Swept::Line([tip_m, tip_m + on_mesh.shaft_in_world * jaws.length_m]),
                None => Swept::Line([tip_m - hand.now.tip_in_world_m + hand.before.tip_in_world_m, tip_m]),
            }];
        }
        if let Some(blade) = kind.blade() {
            let edge = |pose: &ToolInput| {
                let tip_m = pose.tip_in_world_m;
                [tip_m, tip_m + pose.shaft_in_world * blade.length_m]
            };
            // Loose strands cost no force: with tearing, too, an edge need not have broken into tissue.
            if hand.now.is_triggered() {
                return faces_between(edge(&hand.before), edge(&hand.now)).into();
            }
        } else if let Some((jaws, _)) = kind.parting_jaws().filter(|_| hand.just_closed) {
            let (frame, opening) = (ToolFrame::of(&on_mesh), hand.opened_to);
            let hinge_m = frame.to_world_m(jaws.hinge_in_tool_m());
            let end_m = |place: u32| {
                let share = f64::from(place) / f64::from(FACES_OF_SCISSORS);
                frame.to_world_m(jaws.between_ends_in_tool_m(opening, share))
            };
            let face = |place| Swept::Face([hinge_m, end_m(place), end_m(place + 1)]);
            return (0..FACES_OF_SCISSORS).map(face).collect();
        }
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRAND_M: [DVec3; 2] = [DVec3::ZERO, DVec3::Z];

    #[test]
    fn an_edge_parts_what_it_goes_through_and_what_is_within_reach() {
        let edge = |x: f64| [DVec3::new(x, -1.0, 0.5), DVec3::new(x, 1.0, 0.5)];
        let meets = |from: f64, to: f64, reach_m: f64| {
            faces_between(edge(from), edge(to)).iter().any(|face| face.meets(STRAND_M, reach_m))
        };
        assert!(meets(-1.0, 1.0, 0.0), "through");
        assert!(meets(0.1, 1.0, 0.11) && !meets(0.1, 1.0, 0.09), "beside");
        assert!(!meets(0.5, 0.5, 0.1), "it stands still beside it");
        assert!(meets(0.05, 0.05, 0.1), "it stands still at it");
        // Above the end of a strand, whose middle no side of the face is near.
        let above = [DVec3::new(-9.0, -9.0, 1.2), DVec3::new(-9.0, 9.0, 1.2)];
        let faces = faces_between(above, above.map(|at| at + DVec3::X * 18.0));
        let is_met = |reach_m| faces.iter().any(|face| face.meets(STRAND_M, reach_m));
        assert!(is_met(0.21) && !is_met(0.19));
    }

    #[test]
    fn a_tip_parts_what_is_near_its_way() {
        let way = Swept::Line([DVec3::new(-1.0, 0.2, 0.5), DVec3::new(1.0, 0.2, 0.5)]);
        assert!(way.meets(STRAND_M, 0.21) && !way.meets(STRAND_M, 0.19));
        let still = Swept::Line([DVec3::new(0.0, 0.0, 1.3); 2]);
        assert!(still.meets(STRAND_M, 0.31) && !still.meets(STRAND_M, 0.29));
    }
}
