//! How the sides of a part yield for what the mesh is too coarse for ([`super::sub_grid`]), in the system of contacts.

use super::SIDES;
use super::sub_grid::Indentation;
use super::system::{Bearer, LEAST_FURTHER_OUT_M, Press, PressedPoint};
use super::vertices::{side_of, vertex_of};
use crate::math::{DVec3, outer};
use crate::world::organ::Organ;
use crate::world::parts::ToolPart;

impl Press {
    /// How a part yields along a direction for what the mesh is too coarse for [m/N].
    pub(in crate::world) fn sub_grid_m_per_n(&self, place: usize, part: ToolPart, along: DVec3) -> f64 {
        let sides = (0..SIDES).map(|side| side_of(part, side));
        let yields = sides.map(|side| {
            let cosine = self.outward[place][side].dot(along);
            self.sub_grid_m_per_n[place][side] * cosine.max(0.0).powi(2)
        });
        yields.sum()
    }

    /// How far a side of a part is in the surface of the mesh for what that is too coarse for, as the way out [m]. One that just
    /// begins to touch yields most.
    pub(super) fn further_out_m(
        &mut self,
        (place, side): (usize, usize),
        radius_m: f64,
        contact: Option<&Indentation>,
        (pressed, dt_s): (&[PressedPoint], f64),
    ) -> DVec3 {
        let vertex = vertex_of(place, side);
        let yields = &mut self.sub_grid_m_per_n[place][side];
        let own = pressed.iter().filter(|point| point.vertex == vertex);
        if own.clone().next().is_none() && self.further_out_m[place][side] <= LEAST_FURTHER_OUT_M {
            *yields = contact.map_or(0.0, |contact| contact.at_first_m_per_n(radius_m));
        }
        let out = self.outward[place][side];
        let wanted_m = own.map(|point| -point.force_n.dot(out)).sum::<f64>() * *yields;
        let further_out_m = &mut self.further_out_m[place][side];
        let followed = contact.map_or(1.0, |contact| contact.followed(radius_m, dt_s));
        let now_m = *further_out_m + (wanted_m - *further_out_m) * followed;
        *further_out_m = now_m.max(0.0);
        out * *further_out_m
    }

    /// After contacts were solved: what the mesh is too coarse for goes this share of the way to what it is with the forces that
    /// were found.
    pub(super) fn set_sub_grid(
        &mut self,
        (place, side): (usize, usize),
        (radius_m, dt_s): (f64, f64),
        contact: &Indentation,
        organ: &Organ,
    ) {
        let vertex = vertex_of(place, side);
        let outward = self.outward[place][side];
        self.on_nodes_n.clear();
        let mut on_tool_n = DVec3::ZERO;
        let mut is_at_end = true;
        let (mut further_out_j, mut push_n) = (0.0, 0.0);
        for (contact, (_, bearer)) in self.contacts.iter().zip(&self.of) {
            let Bearer::Point(point) = bearer else { continue };
            if contact.vertices[3] != vertex || contact.force_n == DVec3::ZERO {
                continue;
            }
            is_at_end &= point.along == 0.0 || point.along == 1.0;
            on_tool_n += contact.force_n * contact.weights[3];
            let along_n = -contact.force_n.dot(outward);
            push_n += along_n;
            further_out_j += along_n * (radius_m + point.arm_m.dot(outward));
            for (node, weight) in point.nodes.into_iter().zip(point.weights).filter(|(_, w)| *w > 0.0) {
                match self.on_nodes_n.iter_mut().find(|(n, _)| *n == node) {
                    Some((_, force_n)) => *force_n += along_n * weight,
                    None => self.on_nodes_n.push((node, along_n * weight)),
                }
            }
        }
        if self.on_nodes_n.is_empty() {
            return;
        }
        // What is held does not yield, and a rigid body neither.
        let on_free = self.on_nodes_n.iter().filter(|(node, _)| !organ.is_fixed(*node));
        let yields = on_free.map(|(_, force_n)| force_n).sum::<f64>() / push_n;
        let missing = if is_at_end && yields > 0.0 {
            let of_all = contact.missing_m_per_n(organ, (radius_m, further_out_j / push_n), &self.on_nodes_n);
            of_all * yields.min(1.0)
        } else {
            0.0
        };
        let known = &mut self.sub_grid_m_per_n[place][side];
        let further = (missing - *known) * contact.learned(radius_m, dt_s);
        *known += further;
        let in_step = further * contact.followed(radius_m, dt_s);
        let group = self.response.group_mut(1 + place);
        let n = group.vertices.len();
        group.compliance_m_per_n[side * n + side] += outer(outward, outward) * in_step;
        self.moves_m[vertex as usize] += outward * (on_tool_n.dot(outward) * in_step);
    }
}
