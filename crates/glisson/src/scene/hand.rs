//! `[hand]`: how a user's hand holds the instruments.

use super::reader::{SceneError, Section};
use crate::units::Dimension;
use crate::world::spec::Hand;

pub(super) fn read_hand(mut section: Section<'_>) -> Result<Hand, SceneError> {
    let default = Hand::default();
    let stiffness_n_per_m =
        section.positive("stiffness", Dimension::Stiffness)?.unwrap_or(default.stiffness_n_per_m);
    let return_time_s = section.positive("return_time", Dimension::Time)?.unwrap_or(default.return_time_s);
    let greatest_force_n =
        section.positive("greatest_force", Dimension::Force)?.unwrap_or(default.greatest_force_n);
    section.finish()?;
    Ok(Hand { stiffness_n_per_m, return_time_s, greatest_force_n })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    const SCENE: &str = r#"glisson_scene = 1

[hand]
stiffness = "2 N/mm"
greatest_force = "10 N"

[organ]
mesh = "liver.vtu"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1060 kg/m3"
model = "implicit"

[tool]
tip_radius = "6 mm"
home_tip = ["0 mm", "-200 mm", "0 mm"]
home_shaft = [0, -1, 0]
"#;

    #[test]
    fn a_hand_is_read_and_imposes_its_motion_where_there_is_none() {
        let hand = |text: &str| Scene::parse(text).unwrap().world.hand;
        let expected = Hand { stiffness_n_per_m: 2000.0, greatest_force_n: 10.0, ..Hand::default() };
        assert_eq!(hand(SCENE), Some(expected));
        let keys = "stiffness = \"2 N/mm\"\ngreatest_force = \"10 N\"\n";
        assert_eq!(hand(&SCENE.replace(keys, "")), Some(Hand::default()));
        assert_eq!(hand(&SCENE.replace("[hand]\n", "").replace(keys, "")), None);
    }

    #[test]
    fn mistakes_are_named_with_line_and_remedy() {
        for (from, to, expected) in [
            ("\"10 N\"", "\"0 N\"", "line 5: \"greatest_force\" is 0 N; allowed: more than zero"),
            ("\"2 N/mm\"", "\"2 N\"", "is not a unit of stiffness"),
            ("greatest_force", "greatest_fource", "did you mean \"greatest_force\"?"),
        ] {
            let found = Scene::parse(&SCENE.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(found.contains(expected), "{to}: {found}");
        }
    }
}
