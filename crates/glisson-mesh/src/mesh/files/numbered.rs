//! Nodes that a file calls by numbers of its own, and their places in the mesh.

use crate::scan::FormatError;

/// Number in the file and place of each node.
#[derive(Default)]
pub(super) struct NumberedNodes {
    /// Ascending once [`NumberedNodes::sort`] was called.
    places: Vec<(i64, usize)>,
}

impl NumberedNodes {
    /// Notes that the next node has `number`.
    pub(super) fn push(&mut self, number: i64) {
        self.places.push((number, self.places.len()));
    }

    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    /// Makes the nodes ready for [`NumberedNodes::place`]; answers with a number that two of them have, if one is so.
    pub(super) fn sort(&mut self) -> Option<i64> {
        self.places.sort_unstable();
        self.places.windows(2).find(|pair| pair[0].0 == pair[1].0).map(|pair| pair[0].0)
    }

    /// The places of nodes by their numbers. `element` and `list` name who asks and where nodes stand in the file.
    pub(super) fn places<const N: usize>(
        &self,
        numbers: [i64; N],
        element: impl Fn() -> String,
        list: &str,
    ) -> Result<[i64; N], FormatError> {
        let mut places = [0; N];
        for (place, number) in places.iter_mut().zip(numbers) {
            let at = self.places.binary_search_by_key(&number, |p| p.0).map_err(|_| {
                FormatError::named(
                    element(),
                    format!("node {number}"),
                    format!("one of the nodes under {list}"),
                )
            })?;
            *place = self.places[at].1 as i64;
        }
        Ok(places)
    }
}
