//! The one mechanism by which whatever is kept by node, edge, triangle or tetrahedron follows a change of
//! the mesh.
//!
//! For an array with one value an entity: a new entity takes the weighted blend of its parents' old values,
//! an entity that is gone is cleared, and after a compaction the values stand at their new places.

use std::ops::{Index, IndexMut};

use crate::math::{DMat3, DVec3};
use crate::mesh::NodeId;
pub use crate::mesh::change::MeshEntity;
use crate::mesh::change::{EntityChange, TopologyChange};

/// A value that a mesh entity can carry through an edit.
pub trait Carried: Clone {
    /// The value of what is gone, and of what has no parents.
    fn cleared() -> Self;

    /// The value of a new entity from its parents' values and weights.
    fn blend<'a>(parents: impl Iterator<Item = (&'a Self, f64)> + Clone) -> Self
    where
        Self: 'a;
}

macro_rules! carried_by_sum {
    ($($t:ty: $zero:expr),*) => {$(
        impl Carried for $t {
            fn cleared() -> Self {
                $zero
            }

            fn blend<'a>(parents: impl Iterator<Item = (&'a Self, f64)> + Clone) -> Self {
                parents.fold($zero, |sum, (&value, weight)| sum + value * weight)
            }
        }
    )*};
}

carried_by_sum!(f64: 0.0, DVec3: DVec3::ZERO, DMat3: DMat3::ZERO);

macro_rules! carried_by_heaviest_parent {
    ($($t:ty: $cleared:expr),*) => {$(
        /// Takes the value of the heaviest parent, of the first one among equals.
        impl Carried for $t {
            fn cleared() -> Self {
                $cleared
            }

            fn blend<'a>(parents: impl Iterator<Item = (&'a Self, f64)> + Clone) -> Self {
                let mut best: Option<(Self, f64)> = None;
                for (&value, weight) in parents {
                    if best.is_none_or(|(_, heaviest)| weight > heaviest) {
                        best = Some((value, weight));
                    }
                }
                best.map_or($cleared, |(value, _)| value)
            }
        }
    )*};
}

carried_by_heaviest_parent!(bool: false, u8: 0, u16: 0, u32: 0);

impl<T: Carried, const N: usize> Carried for [T; N] {
    fn cleared() -> Self {
        std::array::from_fn(|_| T::cleared())
    }

    fn blend<'a>(parents: impl Iterator<Item = (&'a Self, f64)> + Clone) -> Self
    where
        Self: 'a,
    {
        std::array::from_fn(|i| T::blend(parents.clone().map(move |(value, weight)| (&value[i], weight))))
    }
}

/// Lets `values`, one an entity of kind `I`, follow `change`. A removal allocates nothing.
///
/// # Panics
/// If `values` does not have the length from before the change: the array missed an earlier one.
pub fn follow<I: MeshEntity, T: Carried>(values: &mut Vec<T>, change: &TopologyChange) {
    let EntityChange { n_before, removed, added, new_ids, .. } = I::changed_in(change);
    assert_eq!(values.len(), *n_before, "an array by {} missed a change", std::any::type_name::<I>());
    for (id, parents) in added.iter() {
        assert_eq!(id.index(), values.len(), "additions continue the numbering");
        // A parent is older than its child, so its value is there; it may itself be of this change.
        let blend = T::blend(parents.iter().map(|&(parent, weight)| (&values[parent.index()], weight)));
        values.push(blend);
    }
    for id in removed {
        values[id.index()] = T::cleared();
    }
    if !new_ids.is_empty() {
        let mut at = 0;
        values.retain(|_| {
            at += 1;
            new_ids[at - 1].is_some()
        });
    }
}

/// [`follow`] for values by node that belong to a place in the tissue, as the place that it has now does: a node that moves
/// takes the blend of where it goes, if the edit says it ([`TopologyChange::moved_parents`]).
///
/// # Panics
/// As [`follow`].
pub fn follow_in_tissue<T: Carried>(values: &mut Vec<T>, change: &TopologyChange) {
    let of_parents =
        |parents: &[(NodeId, f64)]| T::blend(parents.iter().map(|&(p, weight)| (&values[p.index()], weight)));
    let moved: Vec<Option<T>> =
        change.moved_parents.iter().map(|p| (!p.is_empty()).then(|| of_parents(p))).collect();
    follow::<NodeId, T>(values, change);
    for (node, value) in change.moved_nodes.iter().zip(moved) {
        if let Some(value) = value {
            values[node.index()] = value;
        }
    }
}

/// One value for each entity of kind `I`, dead ones included.
#[derive(Clone, Debug, PartialEq)]
pub struct EntityArray<I, T> {
    values: Vec<T>,
    kind: std::marker::PhantomData<I>,
}

impl<I: MeshEntity, T: Carried> EntityArray<I, T> {
    /// From one value an entity.
    pub fn new(values: Vec<T>) -> Self {
        Self { values, kind: std::marker::PhantomData }
    }

    /// `n` cleared values.
    pub fn cleared(n: usize) -> Self {
        Self::new(vec![T::cleared(); n])
    }

    /// Follows `change`.
    ///
    /// # Panics
    /// If the array missed an earlier change.
    pub fn follow(&mut self, change: &TopologyChange) {
        follow::<I, T>(&mut self.values, change);
    }

    /// All values, by id.
    pub fn as_slice(&self) -> &[T] {
        &self.values
    }

    /// All values, by id.
    pub fn as_mut_slice(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// The values alone.
    pub fn into_vec(self) -> Vec<T> {
        self.values
    }
}

impl<I: MeshEntity, T> Index<I> for EntityArray<I, T> {
    type Output = T;

    fn index(&self, id: I) -> &T {
        &self.values[id.index()]
    }
}

impl<I: MeshEntity, T> IndexMut<I> for EntityArray<I, T> {
    fn index_mut(&mut self, id: I) -> &mut T {
        &mut self.values[id.index()]
    }
}

impl<I: MeshEntity> EntityChange<I> {
    /// The new ids of a list of entities after a compaction, those that are gone left out; the list itself
    /// without one.
    pub fn renumber_list(&self, ids: &mut Vec<I>) {
        if self.new_ids.is_empty() {
            return;
        }
        let mut kept = 0;
        for at in 0..ids.len() {
            if let Some(id) = self.new_ids[ids[at].index()] {
                ids[kept] = id;
                kept += 1;
            }
        }
        ids.truncate(kept);
    }
}
