//! Numbers of the scene that are turned while it runs. A model with other numbers is made elsewhere and takes over
//! ([`World::deliver_model`]); here the world's own copies of them follow.

use super::World;
use super::hand::Hand;
use crate::model::{BodyPart, BodySet};

impl World {
    /// Simulated time since the start [s].
    pub fn time_s(&self) -> f64 {
        let (steps, time_s) = self.clock_base;
        time_s + (self.step - steps) as f64 * self.spec.time_step_s
    }

    /// From the next step on the tissue at rest, which contacts ask for, and the time step are those of `bodies`, whose model takes
    /// over then.
    pub fn go_on_with_numbers_of(&mut self, bodies: &BodySet) {
        self.spec.tissue = Some(bodies.joint.material);
        for (spec, part) in self.spec.bodies.iter_mut().zip(&bodies.parts) {
            if let BodyPart::Organ { body, .. } = part {
                spec.tissue = Some(body.material);
            }
        }
        if let Some(tearing) = &mut self.spec.tearing {
            tearing.material = bodies.joint.material;
        }
        if self.spec.hand.is_some() {
            let spec = &self.spec;
            self.organ.learn_node_answers(|body| spec.tissue_of(body));
        }
        let time_step_s = bodies.joint.time_step_s;
        if time_step_s.to_bits() != self.spec.time_step_s.to_bits() {
            self.clock_base = (self.step, self.time_s());
            self.spec.time_step_s = time_step_s;
            self.loads.set_time_step(time_step_s);
        }
    }

    /// Whether something of the scene begins or ends at a time that is counted in steps.
    pub fn counts_time_in_steps(&self) -> bool {
        self.loads.are_timed()
    }

    /// Another hand from the next step on; a scene whose hands impose their motion keeps that.
    pub fn set_hand(&mut self, hand: Hand) {
        if let Some(own) = &mut self.spec.hand {
            *own = hand;
        }
    }
}
