//! From tetrahedra to nodes on several threads: each stretch of the tetrahedra adds up its share of the forces by itself, then
//! each node adds the shares.
//!
//! The stretches, and the order in which a node adds them, follow from the tetrahedra alone: the bits do not depend on the
//! threads.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

use fearless_simd::{Simd, prelude::*};

use super::evaluation::Evaluation;
use super::lanes::{Group, LANES, Lanes, Matrix};
use crate::workers::{Chunks, Workers, in_stretches};
use glisson_mesh::math::DVec3;

/// Stretches of a body: enough for some threads, few enough that adding their shares is a small part of the work.
const MOST_STRETCHES: usize = 8;
/// Groups and nodes that are worth a task.
const LEAST_GROUPS: usize = 32;
const LEAST_NODES: usize = 512;

/// What a stretch of the tetrahedra comes to.
#[derive(Clone, Debug)]
pub(super) struct Share {
    groups: Range<usize>,
    /// The lowest of its nodes.
    first_node: u32,
    /// Forces [N] on the nodes from there to its highest.
    force_n: Vec<DVec3>,
    pub(super) energy_j: Lanes,
}

impl Share {
    /// What it adds to a node of its tetrahedra.
    #[inline(always)]
    pub(super) fn at(&mut self, node: u32) -> &mut DVec3 {
        &mut self.force_n[(node - self.first_node) as usize]
    }
}

/// Adds V P alpha_k to the nodes k = 1, 2, 3 and the opposite sum to node 0, lane after lane.
#[inline(always)]
pub(super) fn scatter<S: Simd>(
    group: &Group,
    alpha: &Matrix<S>,
    stress_times_volume: &Matrix<S>,
    share: &mut Share,
) {
    let p = stress_times_volume;
    let mut corner_n = [[[0.0; LANES]; 3]; 4];
    for i in 0..3 {
        let f1 = p[i][0] * alpha[0][0] + p[i][1] * alpha[0][1] + p[i][2] * alpha[0][2];
        let f2 = p[i][0] * alpha[1][0] + p[i][1] * alpha[1][1] + p[i][2] * alpha[1][2];
        let f3 = p[i][0] * alpha[2][0] + p[i][1] * alpha[2][1] + p[i][2] * alpha[2][2];
        (-(f1 + f2 + f3)).store_slice(&mut corner_n[0][i]);
        f1.store_slice(&mut corner_n[1][i]);
        f2.store_slice(&mut corner_n[2][i]);
        f3.store_slice(&mut corner_n[3][i]);
    }
    for lane in 0..LANES {
        for k in 0..4 {
            let f = share.at(group.nodes[k][lane]);
            f.x += corner_n[k][0][lane];
            f.y += corner_n[k][1][lane];
            f.z += corner_n[k][2][lane];
        }
    }
}

/// Whether the law allows the tetrahedra of a stretch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowed {
    pub(super) is_upright: bool,
    pub(super) has_inverted: bool,
}

/// The shares of all tetrahedra, and who adds them.
#[derive(Clone, Debug)]
pub(super) struct Shares {
    /// Groups of a stretch; the last one may have fewer.
    n_groups: usize,
    of_stretch: Vec<Share>,
    /// Where the shares of each node begin.
    start: Vec<u32>,
    /// Stretches with the node, ascending.
    stretches: Vec<u8>,
}

impl Shares {
    pub(super) fn new(groups: &[Group], n_nodes: usize) -> Self {
        let n_groups = groups.len().div_ceil(MOST_STRETCHES).max(LEAST_GROUPS);
        let mut of_stretch = Vec::new();
        let mut with_node = vec![0_u8; n_nodes];
        for (s, groups) in groups.chunks(n_groups).enumerate() {
            let nodes = || groups.iter().flat_map(|group| group.nodes.as_flattened()).copied();
            let first_node = nodes().min().unwrap_or(0);
            let end = nodes().max().map_or(first_node, |last| last + 1);
            let force_n = vec![DVec3::ZERO; (end - first_node) as usize];
            let first = s * n_groups;
            let range = first..first + groups.len();
            of_stretch.push(Share { groups: range, first_node, force_n, energy_j: [0.0; LANES] });
            nodes().for_each(|node| with_node[node as usize] |= 1 << s);
        }
        let (mut start, mut stretches) = (vec![0], Vec::new());
        for with_node in with_node {
            stretches.extend((0..MOST_STRETCHES as u8).filter(|s| with_node >> s & 1 == 1));
            start.push(stretches.len() as u32);
        }
        Self { n_groups, of_stretch, start, stretches }
    }

    /// Overwrites `force_n` with the sums of what `kernel` adds: it is called with the groups of each stretch, their tangents, and
    /// its share.
    pub(super) fn evaluate<T: Send>(
        &mut self,
        workers: &dyn Workers,
        tangents: &mut [T],
        force_n: &mut [DVec3],
        kernel: impl Fn(Range<usize>, &mut [T], &mut Share) -> Allowed + Sync,
    ) -> Evaluation {
        let (is_upright, has_inverted) = (AtomicBool::new(true), AtomicBool::new(false));
        let lists = (Chunks::of(tangents, self.n_groups), &mut self.of_stretch[..]);
        in_stretches(workers, 1, lists, |_, (tangents, shares)| {
            for (share, tangents) in shares.iter_mut().zip(tangents) {
                share.force_n.fill(DVec3::ZERO);
                let allowed = kernel(share.groups.clone(), tangents, share);
                is_upright.fetch_and(allowed.is_upright, Ordering::Relaxed);
                has_inverted.fetch_or(allowed.has_inverted, Ordering::Relaxed);
            }
        });
        self.add_into(workers, force_n);
        let mut energy_j = [0.0; LANES];
        for share in &self.of_stretch {
            for lane in 0..LANES {
                energy_j[lane] += share.energy_j[lane];
            }
        }
        Evaluation {
            energy_j: energy_j.iter().sum(),
            is_upright: is_upright.into_inner(),
            has_inverted: has_inverted.into_inner(),
        }
    }

    /// The same for products, which have neither tangents to write nor an energy.
    pub(super) fn sum(
        &mut self,
        workers: &dyn Workers,
        force_n: &mut [DVec3],
        kernel: impl Fn(Range<usize>, &mut Share) + Sync,
    ) {
        in_stretches(workers, 1, &mut self.of_stretch[..], |_, shares| {
            for share in shares {
                share.force_n.fill(DVec3::ZERO);
                kernel(share.groups.clone(), share);
            }
        });
        self.add_into(workers, force_n);
    }

    fn add_into(&self, workers: &dyn Workers, force_n: &mut [DVec3]) {
        in_stretches(workers, LEAST_NODES, force_n, |first, force_n| {
            for (n, force_n) in (first..).zip(force_n) {
                *force_n = DVec3::ZERO;
                for s in &self.stretches[self.start[n] as usize..self.start[n + 1] as usize] {
                    let share = &self.of_stretch[usize::from(*s)];
                    *force_n += share.force_n[n - share.first_node as usize];
                }
            }
        });
    }
}
