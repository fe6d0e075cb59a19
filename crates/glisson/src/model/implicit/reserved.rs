//! A list whose copies keep its capacity, so that a duplicated model's steps do not allocate either.

use std::ops::{Deref, DerefMut};

#[derive(Debug)]
pub(super) struct Reserved<T>(Vec<T>);

impl<T> Reserved<T> {
    pub(super) fn with_capacity(n: usize) -> Self {
        Self(Vec::with_capacity(n))
    }
}

impl<T: Clone> Clone for Reserved<T> {
    fn clone(&self) -> Self {
        let mut copy = Vec::with_capacity(self.0.capacity());
        copy.extend_from_slice(&self.0);
        Self(copy)
    }
}

impl<T> Deref for Reserved<T> {
    type Target = Vec<T>;

    fn deref(&self) -> &Vec<T> {
        &self.0
    }
}

impl<T> DerefMut for Reserved<T> {
    fn deref_mut(&mut self) -> &mut Vec<T> {
        &mut self.0
    }
}
