//! What who watches wants to be kept of a session: moments to come back to, and what was drawn. Nothing in the simulation
//! depends on it.

use crate::math::DVec3;
use serde::{Deserialize, Serialize};

/// Letters of a bookmark's text at most: a line. A choice.
pub const LONGEST_TEXT: usize = 120;
/// Points of a drawing at most: a choice.
pub const MOST_POINTS: usize = 200;

/// Something to be kept.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Note {
    /// A moment to come back to. A later one of the same moment takes its place.
    Bookmark {
        /// When [s]; no later than it is written down.
        time_s: f64,
        /// What it is about; may be empty.
        #[serde(default, skip_serializing_if = "String::is_empty")]
        text: String,
    },
    /// A place, or the points of a stroke, on the tissue at rest.
    Drawing {
        /// The points [m].
        points_m: Vec<DVec3>,
    },
    /// All that was drawn goes.
    Erased {},
}

impl Note {
    /// Why it cannot be.
    ///
    /// # Errors
    /// What is wrong, what was found and what is allowed.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Bookmark { time_s, text } => {
                if !(time_s.is_finite() && *time_s >= 0.0) {
                    return Err(format!("\"time_s\" is {time_s}; allowed: 0 or more"));
                }
                let n = text.chars().count();
                if n > LONGEST_TEXT || text.chars().any(char::is_control) {
                    return Err(format!(
                        "\"text\" has {n} signs; allowed: up to {LONGEST_TEXT} that can be seen"
                    ));
                }
            }
            Self::Drawing { points_m } => {
                let n = points_m.len();
                if !(1..=MOST_POINTS).contains(&n) {
                    return Err(format!("\"points_m\" has {n} points; allowed: 1 to {MOST_POINTS}"));
                }
                if let Some(at) = points_m.iter().position(|point_m| !point_m.is_finite()) {
                    return Err(format!("point {at} of \"points_m\" is not finite"));
                }
            }
            Self::Erased {} => {}
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn notes_are_checked_and_come_back_from_their_text() {
        let bookmark = |time_s: f64, text: &str| Note::Bookmark { time_s, text: text.into() };
        let drawing = |points_m: Vec<DVec3>| Note::Drawing { points_m };
        for good in [bookmark(0.0, ""), bookmark(2.5, "saignée"), drawing(vec![DVec3::X]), Note::Erased {}] {
            assert_eq!(good.check(), Ok(()));
            let text = serde_json::to_string(&good).unwrap();
            assert_eq!(serde_json::from_str::<Note>(&text).unwrap(), good, "{text}");
        }
        for (bad, why) in [
            (bookmark(-1.0, ""), "-1"),
            (bookmark(f64::INFINITY, ""), "inf"),
            (bookmark(1.0, &"a".repeat(121)), "121 signs"),
            (bookmark(1.0, "a\nb"), "can be seen"),
            (drawing(Vec::new()), "0 points"),
            (drawing(vec![DVec3::X; 201]), "201 points"),
            (drawing(vec![DVec3::X, DVec3::NAN]), "point 1"),
        ] {
            assert!(bad.check().unwrap_err().contains(why), "{bad:?}");
        }
    }
}
