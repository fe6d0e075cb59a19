//! What a session did to the organ, for its summary: tissue taken out, cuts of blades, blood, clips.

use glisson::world::{BladeReport, World};
use serde_json::{Value, json};

/// Less is rounding [m3].
const LEAST_M3: f64 = 1e-12;

/// The account of a session so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Account {
    removed_m3: f64,
    has_vessels: bool,
    lost_m3: f64,
    n_open_ends: usize,
    n_clips: usize,
    blades: BladeReport,
}

impl Account {
    /// That of a world as it is now.
    pub fn of(world: &World) -> Self {
        let (removed_m3, blades) = (world.removed_volume_m3(), *world.blades());
        let Some(vessels) = world.vessels() else { return Self { removed_m3, blades, ..Self::default() } };
        Self {
            removed_m3,
            blades,
            has_vessels: true,
            lost_m3: vessels.lost_m3(),
            n_open_ends: vessels.open_ends().len(),
            n_clips: vessels.n_clips(),
        }
    }

    /// Lines for people, none for what the scene does not have.
    pub fn to_text(self) -> String {
        let mut text = String::new();
        if self.removed_m3 > LEAST_M3 {
            text += &format!("tissue removed   {:.2} ml\n", 1e6 * self.removed_m3);
        }
        let blades = &self.blades;
        if blades.cut_area_m2 > 0.0 {
            text += &format!("cut by blades    {:.1} cm2", 1e4 * blades.cut_area_m2);
            if let Some(worst_deg) = blades.worst_dihedral_deg {
                text += &format!(", worst angle of a tetrahedron {worst_deg:.1} degrees");
            }
            text += &format!(
                "; {} strokes merged with faces that were there, {} left loose ends that were parted, {} places mended\n",
                blades.n_merged, blades.n_partings, blades.n_mended
            );
        }
        if self.has_vessels {
            let (lost_ml, open, clips) = (1e6 * self.lost_m3, self.n_open_ends, self.n_clips);
            text += &format!("blood lost       {lost_ml:.1} ml; {open} open vessels, {clips} clips\n");
        }
        text
    }

    /// The same for programs; `null` for what the scene does not have.
    pub fn to_json(self) -> Value {
        let of_vessels = |value: Value| if self.has_vessels { value } else { Value::Null };
        json!({
            "tissue_removed_m3": self.removed_m3,
            "blade_area_swept_m2": self.blades.swept_area_m2,
            "blade_area_cut_m2": self.blades.cut_area_m2,
            "blade_strokes_merged": self.blades.n_merged,
            "blade_strokes_parted": self.blades.n_partings,
            "blade_places_mended": self.blades.n_mended,
            "blade_worst_dihedral_deg": self.blades.worst_dihedral_deg,
            "blood_lost_m3": of_vessels(json!(self.lost_m3)),
            "open_vessel_ends": of_vessels(json!(self.n_open_ends)),
            "clips": of_vessels(json!(self.n_clips)),
        })
    }
}
