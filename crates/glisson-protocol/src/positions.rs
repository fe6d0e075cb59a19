//! Positions in SNAPSHOT frames: whole steps, as differences from a key that every viewer keeps.
//!
//! A difference is from the key and not from the frame before, so that a viewer may miss any frame: what is made once serves all.

use crate::quantized::numbers::{TakeError, Taker, put, put_signed};
use crate::quantized::places::{Place, place_of};
use bytes::Bytes;
use glisson::record::snapshot::Snapshot;

/// Positions are whole numbers of it [m]; each coordinate is off by half of it at most. A choice: a fortieth of what a pixel
/// shows of 20 cm on 1,000 pixels.
pub const STEP_M: f64 = 5e-6;

/// Positions that differences are from.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    /// No two keys of a server have the same.
    pub(crate) number: u32,
    /// Its KEY frame.
    pub(crate) frame: Bytes,
}

/// The positions of a snapshot, by one key.
#[derive(Clone, Debug)]
pub(crate) struct CodedPositions {
    pub(crate) key: Key,
    /// What [`put_differences`] writes.
    pub(crate) bytes: Vec<u8>,
}

/// Makes them, snapshot by snapshot.
#[derive(Debug, Default)]
pub(crate) struct PositionCoder {
    last_number: u32,
    current: Option<Current>,
}

#[derive(Debug)]
struct Current {
    key: Key,
    topology_version: u32,
    places: Vec<Place>,
    /// Bytes of the first snapshot after the key.
    least: Option<usize>,
    /// What later ones had beyond that.
    wasted: usize,
}

impl PositionCoder {
    /// None if a place is no number or too far away for whole steps.
    pub(crate) fn code(
        &mut self,
        snapshot: &Snapshot,
        frame_of_key: impl FnOnce(u32, &[u8]) -> Vec<u8>,
    ) -> Option<CodedPositions> {
        let places =
            snapshot.positions_m.iter().map(|&p| place_of(p, STEP_M)).collect::<Option<Vec<Place>>>()?;
        let is_old = |current: &Current| {
            current.topology_version != snapshot.topology_version
                || current.places.len() != places.len()
                // A new key costs its bytes once: it comes when staying with the old one has cost as much.
                || current.wasted > current.key.frame.len()
        };
        if self.current.as_ref().is_none_or(is_old) {
            self.last_number = self.last_number.wrapping_add(1);
            let frame = frame_of_key(self.last_number, &differences_along(&places)).into();
            self.current = Some(Current {
                key: Key { number: self.last_number, frame },
                topology_version: snapshot.topology_version,
                places: places.clone(),
                least: None,
                wasted: 0,
            });
        }
        let current = self.current.as_mut()?;
        let mut bytes = Vec::with_capacity(2 * places.len());
        put_differences(&mut bytes, &current.places, &places);
        // The key itself has none, and says nothing of how much moves.
        if places != current.places {
            let least = *current.least.get_or_insert(bytes.len());
            current.wasted += bytes.len().saturating_sub(least);
        }
        Some(CodedPositions { key: current.key.clone(), bytes })
    }
}

/// Each place from the one before it, the first one from 0.
fn differences_along(places: &[Place]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(6 * places.len());
    let mut before = [0; 3];
    for place in places {
        (0..3).for_each(|k| put_signed(&mut bytes, place[k] - before[k]));
        before = *place;
    }
    bytes
}

/// Runs until all places are there: how many are those of the key, how many then are not, and of each of these its way from the
/// key's place, less the way of the one before it in the run.
fn put_differences(out: &mut Vec<u8>, key: &[Place], places: &[Place]) {
    let stays = |i: &usize| places[*i] == key[*i];
    let mut at = 0;
    while at < places.len() {
        let n_kept = (at..places.len()).take_while(stays).count();
        at += n_kept;
        let n_moved = (at..places.len()).take_while(|i| !stays(i)).count();
        put(out, n_kept as u32);
        put(out, n_moved as u32);
        let mut before = [0; 3];
        for i in at..at + n_moved {
            let way = [0, 1, 2].map(|k| places[i][k] - key[i][k]);
            (0..3).for_each(|k| put_signed(out, way[k] - before[k]));
            before = way;
        }
        at += n_moved;
    }
}

/// The places of a KEY frame of `n` vertices, for who reads frames.
///
/// # Errors
/// When the bytes end, or hold no such numbers.
pub fn take_key(from: &mut Taker, n: usize) -> Result<Vec<Place>, TakeError> {
    let mut place = [0; 3];
    (0..n)
        .map(|_| {
            for x in &mut place {
                *x += from.signed()?;
            }
            Ok(place)
        })
        .collect()
}

/// The places of a SNAPSHOT frame whose positions are differences from those of `key`.
///
/// # Errors
/// When the bytes end, or hold no such numbers.
pub fn take_places(from: &mut Taker, key: &[Place]) -> Result<Vec<Place>, TakeError> {
    let mut places = key.to_vec();
    let mut at = 0;
    while at < places.len() {
        at += from.number()? as usize;
        let n_moved = from.number()? as usize;
        let mut way = [0; 3];
        for place in places.iter_mut().skip(at).take(n_moved) {
            for k in 0..3 {
                way[k] += from.signed()?;
                place[k] += way[k];
            }
        }
        at += n_moved;
    }
    Ok(places)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::math::DVec3;
    use proptest::prelude::*;

    fn snapshot(topology_version: u32, positions_m: Vec<DVec3>) -> Snapshot {
        Snapshot {
            step: 0,
            time_s: 0.0,
            topology_version,
            positions_m,
            tools: Vec::new(),
            bleeding: Default::default(),
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
        }
    }

    /// The key's differences alone.
    fn bare(_: u32, differences: &[u8]) -> Vec<u8> {
        differences.to_vec()
    }

    proptest! {
        #[test]
        fn positions_come_back_to_half_a_step_whichever_frames_are_missed(
            frames in prop::collection::vec(prop::collection::vec((any::<bool>(), prop::array::uniform3(-0.5_f64..0.5)), 20), 1..12)
        ) {
            let mut coder = PositionCoder::default();
            let mut now = vec![DVec3::ZERO; 20];
            for frame in frames {
                for (p, (moves, to)) in now.iter_mut().zip(frame) {
                    if moves {
                        *p = DVec3::from_array(to);
                    }
                }
                let coded = coder.code(&snapshot(0, now.clone()), bare).unwrap();
                let key = take_key(&mut Taker(&coded.key.frame), now.len()).unwrap();
                let mut from = Taker(&coded.bytes);
                let places = take_places(&mut from, &key).unwrap();
                prop_assert!(from.0.is_empty());
                for (p, place) in now.iter().zip(places) {
                    let found = DVec3::from_array(place.map(|x| f64::from(x) * STEP_M));
                    prop_assert!((found - *p).abs().max_element() <= 0.5 * STEP_M * (1.0 + 1e-9));
                }
            }
        }
    }

    #[test]
    fn what_stays_costs_two_numbers_and_what_is_no_place_is_not_coded() {
        let mut coder = PositionCoder::default();
        let mut at: Vec<DVec3> = (0..1_000).map(|i| DVec3::splat(1e-3 * f64::from(i))).collect();
        let first = coder.code(&snapshot(0, at.clone()), bare).unwrap();
        assert_eq!(first.bytes, [0xe8, 7, 0], "1,000 kept, none moved");
        at[500] += DVec3::X * 3.0 * STEP_M;
        let second = coder.code(&snapshot(0, at.clone()), bare).unwrap();
        assert_eq!(second.bytes, [0xf4, 3, 1, 6, 0, 0, 0xf3, 3, 0]);
        assert_eq!(first.key.number, second.key.number);
        for bad in [f64::NAN, f64::INFINITY, 1e6] {
            at[0].y = bad;
            assert!(coder.code(&snapshot(0, at.clone()), bare).is_none(), "{bad}");
        }
    }

    #[test]
    fn a_new_key_comes_with_a_new_surface_and_when_the_old_one_has_cost_as_much() {
        let mut coder = PositionCoder::default();
        let at = |i: u32| (0..100).map(|k| DVec3::new(f64::from(k * i), 0.0, 0.0) * 2e-6).collect::<Vec<_>>();
        let mut number = |version: u32, i: u32| {
            let coded = coder.code(&snapshot(version, at(i)), bare).unwrap();
            (coded.key.number, coded.key.frame.len())
        };
        let (first, n_bytes) = number(0, 0);
        // Nothing moves: it holds for ever.
        assert!((0..10_000).all(|_| number(0, 0).0 == first));
        // All moves on: a key for some frames, but neither for one nor for all.
        let numbers: Vec<u32> = (0..600).map(|i| number(0, i).0).collect();
        let n_keys = numbers.iter().max().unwrap() - first;
        assert!((2..200).contains(&n_keys), "{n_keys} keys of {n_bytes} bytes for 600 frames");
        let before = *numbers.last().unwrap();
        assert_eq!(number(1, 599).0, before + 1);
    }
}
