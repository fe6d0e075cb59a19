//! `[hand]`: how a user's hand holds the instruments. A scene without it has the default hand.

use super::reader::{SceneError, Section};
use crate::units::Dimension;
use crate::world::spec::Hand;

/// How instruments touch: by the forces of a hand that gives way, or by the hand's motion, which tissue follows exactly.
const COMPLIANT: &str = "compliant";
const IMPOSED: &str = "imposed";

/// The hand; none where it imposes its motion.
pub(super) fn read_hand(mut section: Section<'_>) -> Result<Option<Hand>, SceneError> {
    if let Some((touch, at)) = section.string("touch")? {
        match touch.as_str() {
            COMPLIANT => {}
            // The keys of a hand that gives way mean nothing then.
            IMPOSED => return section.finish().map(|()| None),
            _ => {
                let allowed = format!("{COMPLIANT}, {IMPOSED}");
                return Err(section.wrong_value(at, "touch", format!("\"{touch}\""), &allowed));
            }
        }
    }
    let default = Hand::default();
    let stiffness_n_per_m =
        section.positive("stiffness", Dimension::Stiffness)?.unwrap_or(default.stiffness_n_per_m);
    let return_time_s = section.positive("return_time", Dimension::Time)?.unwrap_or(default.return_time_s);
    let greatest_force_n =
        section.positive("greatest_force", Dimension::Force)?.unwrap_or(default.greatest_force_n);
    let rotational_stiffness_n_m_per_rad = section
        .positive("rotational_stiffness", Dimension::RotationalStiffness)?
        .unwrap_or(default.rotational_stiffness_n_m_per_rad);
    let rotational_return_time_s = section
        .positive("rotational_return_time", Dimension::Time)?
        .unwrap_or(default.rotational_return_time_s);
    let greatest_torque_n_m =
        section.positive("greatest_torque", Dimension::Torque)?.unwrap_or(default.greatest_torque_n_m);
    section.finish()?;
    Ok(Some(Hand {
        stiffness_n_per_m,
        return_time_s,
        greatest_force_n,
        rotational_stiffness_n_m_per_rad,
        rotational_return_time_s,
        greatest_torque_n_m,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::session::{SESSION_VERSION, SessionHeader};
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
    fn a_hand_is_read_and_is_the_default_one_where_there_is_none() {
        let hand = |text: &str| Scene::parse(text).unwrap().world.hand;
        let expected = Hand { stiffness_n_per_m: 2000.0, greatest_force_n: 10.0, ..Hand::default() };
        assert_eq!(hand(SCENE), Some(expected));
        let keys = "stiffness = \"2 N/mm\"\ngreatest_force = \"10 N\"\n";
        assert_eq!(hand(&SCENE.replace(keys, "")), Some(Hand::default()));
        assert_eq!(hand(&SCENE.replace("[hand]\n", "").replace(keys, "")), Some(Hand::default()));
        assert_eq!(hand(&SCENE.replace(keys, "touch = \"imposed\"\n")), None);
        assert_eq!(hand(&SCENE.replace(keys, &format!("touch = \"compliant\"\n{keys}"))), Some(expected));
    }

    #[test]
    fn sessions_of_before_the_hand_was_the_default_impose_their_motion() {
        let hand = |text: &str, version| {
            let header = SessionHeader { version, ..SessionHeader::new(text.into(), String::new()) };
            Scene::parse_recorded(&header).unwrap().world.hand
        };
        let without =
            SCENE.replace("[hand]\n", "").replace("stiffness = \"2 N/mm\"\ngreatest_force = \"10 N\"\n", "");
        assert_eq!((hand(&without, 2), hand(&without, SESSION_VERSION)), (None, Some(Hand::default())));
        assert_eq!(hand(SCENE, 2), hand(SCENE, SESSION_VERSION));
    }

    #[test]
    fn what_a_hand_does_about_the_tip_is_read() {
        let keys = "rotational_stiffness = \"5 N m/rad\"\nrotational_return_time = \"4 ms\"\ngreatest_torque = \"300 N mm\"\n";
        let hand = Scene::parse(&SCENE.replace("[hand]\n", &format!("[hand]\n{keys}"))).unwrap().world.hand;
        let expected = Hand {
            stiffness_n_per_m: 2000.0,
            greatest_force_n: 10.0,
            rotational_stiffness_n_m_per_rad: 5.0,
            rotational_return_time_s: 4e-3,
            greatest_torque_n_m: 0.3,
            ..Hand::default()
        };
        assert_eq!(hand, Some(expected));
    }

    #[test]
    fn mistakes_are_named_with_line_and_remedy() {
        for (from, to, expected) in [
            ("\"10 N\"", "\"0 N\"", "line 5: \"greatest_force\" is 0 N; allowed: more than zero"),
            ("\"2 N/mm\"", "\"2 N\"", "is not a unit of stiffness"),
            ("greatest_force", "greatest_fource", "did you mean \"greatest_force\"?"),
            ("[hand]", "[hand]\ntouch = \"forced\"", "\"touch\" is \"forced\"; allowed: compliant, imposed"),
            (
                "[hand]",
                "[hand]\ntouch = \"imposed\"",
                "unknown key \"greatest_force\" in [hand] (allowed: touch)",
            ),
        ] {
            let found = Scene::parse(&SCENE.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(found.contains(expected), "{to}: {found}");
        }
    }
}
