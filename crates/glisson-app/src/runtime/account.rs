//! What a session did to the organ, for its summary: tissue taken out, blood, clips.

use glisson::world::World;
use serde_json::{Value, json};

/// Less is rounding [m3].
const LEAST_M3: f64 = 1e-12;

/// The account of a session so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Account {
    removed_m3: f64,
    has_vessels: bool,
    lost_m3: f64,
    n_open_ends: usize,
    n_clips: usize,
}

impl Account {
    pub(crate) fn of(world: &World) -> Self {
        let removed_m3 = world.removed_volume_m3();
        let Some(vessels) = world.vessels() else { return Self { removed_m3, ..Self::default() } };
        Self {
            removed_m3,
            has_vessels: true,
            lost_m3: vessels.lost_m3(),
            n_open_ends: vessels.open_ends().len(),
            n_clips: vessels.n_clips(),
        }
    }

    /// Lines for people, none for what the scene does not have.
    pub(crate) fn to_text(self) -> String {
        let mut text = String::new();
        if self.removed_m3 > LEAST_M3 {
            text += &format!("tissue removed   {:.2} ml\n", 1e6 * self.removed_m3);
        }
        if self.has_vessels {
            let (lost_ml, open, clips) = (1e6 * self.lost_m3, self.n_open_ends, self.n_clips);
            text += &format!("blood lost       {lost_ml:.1} ml; {open} open vessels, {clips} clips\n");
        }
        text
    }

    /// The same for programs; `null` for what the scene does not have.
    pub(crate) fn to_json(self) -> Value {
        let of_vessels = |value: Value| if self.has_vessels { value } else { Value::Null };
        json!({
            "tissue_removed_m3": self.removed_m3,
            "blood_lost_m3": of_vessels(json!(self.lost_m3)),
            "open_vessel_ends": of_vessels(json!(self.n_open_ends)),
            "clips": of_vessels(json!(self.n_clips)),
        })
    }
}
