//! The state hash: equal hashes mean equal bits.

use super::{DeformableModel, ModelState};
use serde::{Deserialize, Serialize};
use std::fmt;

/// BLAKE3 of a state, written as 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct StateHash([u8; 32]);

impl StateHash {
    /// The hash of a model now.
    pub fn of_model(model: &dyn DeformableModel, live: &[bool], surroundings: &[f64]) -> Self {
        Self::of(&model.state(), &model.history(), live, surroundings)
    }

    /// BLAKE3 of the little-endian bits of positions, velocities, history variables, the numbers of what surrounds
    /// the body, and live flags, each list preceded by its length.
    pub fn of(state: &ModelState<'_>, history: &[f64], live: &[bool], surroundings: &[f64]) -> Self {
        let mut hasher = blake3::Hasher::new();
        for vectors in [state.positions_m, state.velocities_m_per_s] {
            hasher.update(&(vectors.len() as u64).to_le_bytes());
            for v in vectors {
                for x in v.to_array() {
                    hasher.update(&x.to_le_bytes());
                }
            }
        }
        for numbers in [history, surroundings] {
            hasher.update(&(numbers.len() as u64).to_le_bytes());
            for x in numbers {
                hasher.update(&x.to_le_bytes());
            }
        }
        hasher.update(&(live.len() as u64).to_le_bytes());
        for &flag in live {
            hasher.update(&[u8::from(flag)]);
        }
        Self(*hasher.finalize().as_bytes())
    }
}

impl fmt::Display for StateHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for StateHash {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl From<StateHash> for String {
    fn from(hash: StateHash) -> Self {
        hash.to_string()
    }
}

impl TryFrom<String> for StateHash {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let wrong = || format!("\"{text}\" is not a hash of 64 hexadecimal digits");
        if text.len() != 64 || !text.is_ascii() {
            return Err(wrong());
        }
        let mut bytes = [0; 32];
        for (i, byte) in bytes.iter_mut().enumerate() {
            *byte = u8::from_str_radix(&text[2 * i..2 * i + 2], 16).map_err(|_| wrong())?;
        }
        Ok(Self(bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson_mesh::math::DVec3;

    #[test]
    fn one_bit_of_anything_changes_the_hash_and_text_brings_it_back() {
        let positions = [DVec3::new(1.0, 2.0, 3.0)];
        let velocities = [DVec3::ZERO];
        let state = ModelState { positions_m: &positions, velocities_m_per_s: &velocities };
        let hash = StateHash::of(&state, &[0.5], &[true], &[]);
        let negative_zero = [DVec3::new(0.0, -0.0, 0.0)];
        assert_ne!(
            hash,
            StateHash::of(&ModelState { velocities_m_per_s: &negative_zero, ..state }, &[0.5], &[true], &[])
        );
        assert_ne!(hash, StateHash::of(&state, &[0.5], &[true], &[0.0]));
        assert_ne!(hash, StateHash::of(&state, &[0.5, 0.0], &[true], &[]));
        assert_ne!(hash, StateHash::of(&state, &[0.5], &[false], &[]));
        assert_eq!(StateHash::try_from(hash.to_string()), Ok(hash));
        assert!(StateHash::try_from("zz".repeat(32)).is_err());
    }
}
