//! The newest state as frames, each made once for all viewers that want it.

use crate::frames::{coded_snapshot_frame, key_frame, snapshot_frame, topology_frame};
use crate::inside::InsideView;
use crate::positions::{CodedPositions, Key, PositionCoder};
use bytes::Bytes;
use glisson_runtime::published::Published;
use std::sync::{Arc, Mutex, PoisonError};

/// What a viewer is sent of a state.
pub(crate) struct Frames {
    /// Where the snapshot's positions are differences from; none where they are whole.
    pub(crate) key: Option<Key>,
    pub(crate) snapshot: Bytes,
}

/// Makes frames when the first viewer asks for them.
#[derive(Default)]
pub(crate) struct SharedFrames(Mutex<Maker>);

#[derive(Default)]
struct Maker {
    coder: PositionCoder,
    topology: Option<(u32, Bytes)>,
    latest: Option<Made>,
}

struct Made {
    of: Arc<Published>,
    positions: Option<CodedPositions>,
    plain: Option<Bytes>,
    with_contacts: Option<Bytes>,
}

impl SharedFrames {
    fn with<T>(&self, make: impl FnOnce(&mut Maker) -> T) -> T {
        // After a panic it holds what it held before.
        make(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The TOPOLOGY frame.
    pub(crate) fn topology(&self, state: &Published) -> Bytes {
        let version = state.topology.version;
        self.with(|maker| match &maker.topology {
            Some((of, frame)) if *of == version => frame.clone(),
            _ => {
                let frame = Bytes::from(topology_frame(&state.topology));
                maker.topology = Some((version, frame.clone()));
                frame
            }
        })
    }

    /// The SNAPSHOT frame, with contact points for who looks at them. With `inside` it is for one viewer alone, and made each time.
    pub(crate) fn snapshot(
        &self,
        state: &Arc<Published>,
        with_contacts: bool,
        inside: Option<&InsideView>,
    ) -> Frames {
        self.with(|maker| maker.snapshot(state, with_contacts, inside))
    }
}

impl Maker {
    fn snapshot(
        &mut self,
        state: &Arc<Published>,
        with_contacts: bool,
        inside: Option<&InsideView>,
    ) -> Frames {
        let version = state.snapshot.topology_version;
        let made = match self.latest.take().filter(|made| Arc::ptr_eq(&made.of, state)) {
            Some(made) => made,
            None => Made {
                of: Arc::clone(state),
                positions: self.coder.code(&state.snapshot, |number, places| {
                    key_frame(version, number, &state.snapshot, places)
                }),
                plain: None,
                with_contacts: None,
            },
        };
        let made = self.latest.insert(made);
        let contacts = state.contact_points.as_ref().filter(|_| with_contacts);
        let positions = &made.positions;
        let encode = || -> Bytes {
            let frame = match positions {
                Some(positions) => {
                    coded_snapshot_frame(&state.snapshot, &state.pace, contacts, inside, positions)
                }
                None => snapshot_frame(&state.snapshot, &state.pace, contacts, inside),
            };
            frame.into()
        };
        let place = if contacts.is_some() { &mut made.with_contacts } else { &mut made.plain };
        let snapshot = if inside.is_some() { encode() } else { place.get_or_insert_with(encode).clone() };
        Frames { key: positions.as_ref().map(|positions| positions.key.clone()), snapshot }
    }
}
