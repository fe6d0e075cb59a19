//! A list that keeps its room when it is copied: a copied model allocates as little as the first one.

use std::ops::{Deref, DerefMut};

/// A vector whose copies have its capacity.
#[derive(Debug)]
pub struct BoundedVec<T>(Vec<T>);

impl<T> BoundedVec<T> {
    /// Empty, with room for `n`.
    pub fn with_capacity(n: usize) -> Self {
        Self(Vec::with_capacity(n))
    }

    /// Has room for `n` from now on, and for half as many again if there was none.
    pub(crate) fn make_room(&mut self, n: usize) {
        if n > self.0.capacity() {
            self.0.reserve_exact(n + n / 2 - self.0.len());
        }
    }

    /// Adds a value if there is room; answers whether there was.
    pub fn try_push(&mut self, value: T) -> bool {
        let has_room = self.0.len() < self.0.capacity();
        if has_room {
            self.0.push(value);
        }
        has_room
    }
}

impl<T: Clone> Clone for BoundedVec<T> {
    fn clone(&self) -> Self {
        let mut copy = Self::with_capacity(self.0.capacity());
        copy.0.extend_from_slice(&self.0);
        copy
    }
}

impl<T> Deref for BoundedVec<T> {
    type Target = Vec<T>;

    fn deref(&self) -> &Vec<T> {
        &self.0
    }
}

impl<T> DerefMut for BoundedVec<T> {
    fn deref_mut(&mut self) -> &mut Vec<T> {
        &mut self.0
    }
}
