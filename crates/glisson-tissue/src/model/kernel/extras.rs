//! Optional parts of the stress besides the law: stress at rest, a fibre, a penalty of volume changes, viscous memory. Each
//! has its own blocks, so that bodies without it do not read them.
//!
//! V P = V P_law + F (V S_0 + V S_fibre) + V P_penalty, where
//!
//! - S_0 is the stress in the rest shape ([`crate::model::RestStress`]);
//! - S_fibre = 2 kappa (a . E a) a (x) a, as in [`crate::model::nonlinear_tensor_mass`] (seed `002`, eq. 7);
//! - P_penalty = 3 gamma theta |theta| cof F, theta = J - 1: the derivative of gamma |theta|^3 (seed `004`, s. 3.2,
//!   with the sign and length that `nonlinear_tensor_mass` gives it).
//!
//! With a Prony series the stress S of law and fibre relaxes ([`crate::material::PronySeries`]); stress at rest and
//! penalty do not. [`super::KernelLaw::Linear`] takes the small strain throughout, without F, except in theta.

use super::element::{At, ElementLaw, Matrix, Symmetric, VolumeChange, carried, full};
use super::lanes::Lanes;
use super::quarantine::Guard;
use super::rows::{LaneNumbers, N_LANES};

/// A stress of the kernel's loops: a law, with or without extras.
pub(super) trait Stress {
    /// V P for the displacement gradient `g`.
    fn scaled_stress<V: Lanes>(&mut self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V>;
}

/// The law alone.
pub(super) struct Plain<L>(pub(super) L);

impl<L: ElementLaw> Stress for Plain<L> {
    #[inline(always)]
    fn scaled_stress<V: Lanes>(&mut self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V> {
        self.0.scaled_stress(g, numbers, at)
    }
}

/// The law, without tetrahedra that are inverted or not finite.
pub(super) struct Guarded<'a, L> {
    pub(super) law: L,
    pub(super) guard: Guard<'a>,
}

impl<L: ElementLaw> Stress for Guarded<'_, L> {
    #[inline(always)]
    fn scaled_stress<V: Lanes>(&mut self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V> {
        let p = self.law.scaled_stress(g, numbers, at);
        self.guard.checked(&self.law, (g, numbers), (p, true), at).0
    }
}

/// Stiffness along a fibre in eight tetrahedra.
#[derive(Clone, Debug)]
pub(super) struct FibreBlock {
    /// a, each x, y, z.
    pub(super) direction: [LaneNumbers; 3],
    /// V kappa [N m].
    pub(super) stiffness: LaneNumbers,
}

impl FibreBlock {
    const EMPTY: Self = Self { direction: [[0.0; N_LANES]; 3], stiffness: [0.0; N_LANES] };
}

/// The extras of the tetrahedra of a part; each list is empty or has one entry per block.
#[derive(Clone, Debug, Default)]
pub(super) struct Extras {
    /// V S_0 [N m]: xx, yy, zz, xy, xz, yz.
    pub(super) rest_stress: Vec<[LaneNumbers; 6]>,
    pub(super) fibres: Vec<FibreBlock>,
    /// 3 gamma V [N m].
    pub(super) penalty: Vec<LaneNumbers>,
}

/// Which extras a body has.
#[derive(Clone, Copy, Debug)]
pub(super) struct ExtraKinds {
    pub(super) rest_stress: bool,
    pub(super) fibres: bool,
    pub(super) penalty: bool,
}

impl Extras {
    pub(super) fn zero(n_blocks: usize, kinds: ExtraKinds) -> Self {
        let n = |has: bool| if has { n_blocks } else { 0 };
        Self {
            rest_stress: vec![[[0.0; N_LANES]; 6]; n(kinds.rest_stress)],
            fibres: vec![FibreBlock::EMPTY; n(kinds.fibres)],
            penalty: vec![[0.0; N_LANES]; n(kinds.penalty)],
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rest_stress.is_empty() && self.fibres.is_empty() && self.penalty.is_empty()
    }

    /// Bytes that a computation of the forces reads.
    pub(super) fn n_bytes(&self) -> usize {
        size_of_val(self.rest_stress.as_slice())
            + size_of_val(self.fibres.as_slice())
            + size_of_val(self.penalty.as_slice())
    }

    /// Adds an empty block.
    pub(super) fn append_block(&mut self) {
        if !self.rest_stress.is_empty() {
            self.rest_stress.push([[0.0; N_LANES]; 6]);
        }
        if !self.fibres.is_empty() {
            self.fibres.push(FibreBlock::EMPTY);
        }
        if !self.penalty.is_empty() {
            self.penalty.push([0.0; N_LANES]);
        }
    }

    /// Drops the blocks beyond the first `n_blocks`.
    pub(super) fn truncate(&mut self, n_blocks: usize) {
        self.rest_stress.truncate(n_blocks);
        self.fibres.truncate(n_blocks);
        self.penalty.truncate(n_blocks);
    }

    /// Empties a lane.
    pub(super) fn clear(&mut self, block: usize, lane: usize) {
        for number in self.rest_stress.get_mut(block).into_iter().flatten() {
            number[lane] = 0.0;
        }
        if let Some(fibre) = self.fibres.get_mut(block) {
            fibre.direction.iter_mut().for_each(|a| a[lane] = 0.0);
            fibre.stiffness[lane] = 0.0;
        }
        if let Some(penalty) = self.penalty.get_mut(block) {
            penalty[lane] = 0.0;
        }
    }
}

/// The relaxing stress and its memory in a part.
pub(super) struct Viscous<'a> {
    /// 1 - sum g_k.
    pub(super) lasting_share: f64,
    /// g_k, exp(-h/tau_k) and (tau_k/h)(1 - exp(-h/tau_k)).
    pub(super) terms: &'a [[f64; 3]],
    /// For each block V S_e of the end of the last step, then V h_k of each term [N m]: six numbers each.
    pub(super) history: &'a mut [LaneNumbers],
    /// Whether this computation ends a step.
    pub(super) advances: bool,
}

impl Viscous<'_> {
    #[inline(always)]
    fn of_block(&mut self, block: usize) -> &mut [LaneNumbers] {
        let n = 6 * (1 + self.terms.len());
        &mut self.history[block * n..(block + 1) * n]
    }

    /// V S at the end of the step that ends with V S_e = `elastic`.
    #[inline(always)]
    fn relaxed<V: Lanes>(&mut self, elastic: &Symmetric<V>, at: At) -> Symmetric<V> {
        let (lasting_share, terms) = (self.lasting_share, self.terms);
        let history = self.of_block(at.block);
        let mut relaxed = *elastic;
        for i in 0..6 {
            let now = elastic[i];
            let change = now.minus(now.load(&history[i], at.lane));
            let mut sum = now.times(now.constant(lasting_share));
            for (k, term) in terms.iter().enumerate() {
                let h = now.load(&history[6 * (k + 1) + i], at.lane);
                sum = advanced(h, change, term).fused(now.constant(term[0]), sum);
            }
            relaxed[i] = sum;
        }
        relaxed
    }

    /// Advances the memory of the lanes of `sound` to the end of that step.
    #[inline(always)]
    fn advance<V: Lanes>(&mut self, elastic: &Symmetric<V>, at: At, sound: u32) {
        let terms = self.terms;
        let history = self.of_block(at.block);
        for i in 0..6 {
            let now = elastic[i];
            let before = now.load(&history[i], at.lane);
            let change = now.minus(before);
            Guard::chosen(sound, now, before).store(&mut history[i], at.lane);
            for (k, term) in terms.iter().enumerate() {
                let memory = &mut history[6 * (k + 1) + i];
                let h = now.load(memory, at.lane);
                Guard::chosen(sound, advanced(h, change, term), h).store(memory, at.lane);
            }
        }
    }
}

/// h_k at the end of a step.
#[inline(always)]
fn advanced<V: Lanes>(h: V, change: V, &[_, kept, gained]: &[f64; 3]) -> V {
    h.fused(h.constant(kept), change.times(h.constant(gained)))
}

/// The law with all extras.
pub(super) struct Full<'a, L> {
    pub(super) law: L,
    pub(super) extras: &'a Extras,
    pub(super) viscous: Option<Viscous<'a>>,
    pub(super) guard: Option<Guard<'a>>,
}

impl<L: ElementLaw> Full<'_, L> {
    /// V S of the fibres.
    #[inline(always)]
    fn fibre_stress<V: Lanes>(block: &FibreBlock, g: &Matrix<V>, at: At) -> Symmetric<V> {
        let load = |numbers: &LaneNumbers| g[0][0].load(numbers, at.lane);
        let a = [load(&block.direction[0]), load(&block.direction[1]), load(&block.direction[2])];
        let moved = |i: usize| g[i][0].fused(a[0], g[i][1].fused(a[1], g[i][2].times(a[2])));
        let w = [moved(0), moved(1), moved(2)];
        let along = a[0].fused(w[0], a[1].fused(w[1], a[2].times(w[2])));
        // 2 a . E a.
        let twice = if L::IS_SMALL_STRAIN {
            along.plus(along)
        } else {
            w[0].fused(w[0], w[1].fused(w[1], w[2].fused(w[2], along.plus(along))))
        };
        let tension = load(&block.stiffness).times(twice);
        let pull = [tension.times(a[0]), tension.times(a[1]), tension.times(a[2])];
        [
            pull[0].times(a[0]),
            pull[1].times(a[1]),
            pull[2].times(a[2]),
            pull[0].times(a[1]),
            pull[0].times(a[2]),
            pull[1].times(a[2]),
        ]
    }

    /// V P of a second Piola-Kirchhoff stress.
    #[inline(always)]
    fn first_stress<V: Lanes>(g: &Matrix<V>, s: &Symmetric<V>) -> Matrix<V> {
        if L::IS_SMALL_STRAIN { full(s) } else { carried(g, s) }
    }
}

impl<L: ElementLaw> Stress for Full<'_, L> {
    #[inline(always)]
    fn scaled_stress<V: Lanes>(&mut self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V> {
        let zero = g[0][0].constant(0.0);
        let mut second = [zero; 6];
        let mut elastic = second;
        let mut p = [[zero; 3]; 3];
        if let Some(block) = self.extras.fibres.get(at.block) {
            second = Self::fibre_stress(block, g, at);
        }
        if let Some(viscous) = &mut self.viscous {
            elastic = sum_of(&self.law.scaled_second_stress(g, numbers, at), &second);
            second = viscous.relaxed(&elastic, at);
        } else {
            p = self.law.scaled_stress(g, numbers, at);
        }
        if let Some(rest) = self.extras.rest_stress.get(at.block) {
            let rest: Symmetric<V> = std::array::from_fn(|i| zero.load(&rest[i], at.lane));
            second = sum_of(&second, &rest);
        }
        add_to(&mut p, &Self::first_stress(g, &second));
        if let Some(penalty) = self.extras.penalty.get(at.block) {
            let VolumeChange { growth, cofactor_growth: h } = VolumeChange::of(g);
            let pressure = zero.load(penalty, at.lane).times(growth.times(growth.magnitude()));
            for i in 0..3 {
                for j in 0..3 {
                    let cofactor =
                        if i == j { pressure.fused(h[i][j], pressure) } else { pressure.times(h[i][j]) };
                    p[i][j] = p[i][j].plus(cofactor);
                }
            }
        }
        let (p, sound) = match &mut self.guard {
            Some(guard) => guard.checked(&self.law, (g, numbers), (p, false), at),
            None => (p, Guard::all::<V>()),
        };
        if let Some(viscous) = &mut self.viscous
            && viscous.advances
        {
            viscous.advance(&elastic, at, sound);
        }
        p
    }
}

#[inline(always)]
fn sum_of<V: Lanes>(a: &Symmetric<V>, b: &Symmetric<V>) -> Symmetric<V> {
    std::array::from_fn(|i| a[i].plus(b[i]))
}

#[inline(always)]
fn add_to<V: Lanes>(sum: &mut Matrix<V>, other: &Matrix<V>) {
    for (sum, other) in sum.as_flattened_mut().iter_mut().zip(other.as_flattened()) {
        *sum = sum.plus(*other);
    }
}
