//! Vertices that a file repeats become one again.

use std::collections::HashMap;

use crate::math::DVec3;

/// Vertices in the order in which they were first seen, those of exactly the same coordinates once. The map is only
/// looked up, never walked through.
#[derive(Default)]
pub(super) struct Welded {
    number: HashMap<[u64; 3], u32>,
    pub(super) positions: Vec<DVec3>,
}

impl Welded {
    /// The number of the vertex at `p`.
    pub(super) fn add(&mut self, p: DVec3) -> u32 {
        // Adding zero turns -0 into 0.
        let p = p + DVec3::ZERO;
        let next =
            u32::try_from(self.positions.len()).expect("the formats that repeat vertices count by 32 bits");
        let number = *self.number.entry(p.to_array().map(f64::to_bits)).or_insert(next);
        if number == next {
            self.positions.push(p);
        }
        number
    }
}
