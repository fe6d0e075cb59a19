//! Tetrahedra that are inverted or not finite, so that one bad tetrahedron does not spoil a step.
//!
//! Where the law of a tissue does not bring it back from there (no number, a mirror image in which it rests, a force beyond
//! what a step can follow), the tetrahedron follows the stable neo-Hookean law with the same stiffness at rest instead (Smith,
//! De Goes and Kim 2018, doi 10.1145/3180491), which does from every shape. Which law counts depends on the deformation alone:
//! both have an energy, and a tetrahedron that comes back the way it went gains none. St Venant-Kirchhoff tissue is guarded against
//! being squeezed flat instead ([`squeeze_guard_pa`]): where the other law took over it was thrown back, from step to step.

use super::element::{At, ElementLaw, Matrix};
use super::lanes::Lanes;
use super::rows::{LaneNumbers, N_LANES};
use crate::material::{Material, StableNeoHooke, squeeze_guard_pa};
use glisson_mesh::math::DMat3;
use glisson_mesh::mesh::TetId;

/// Which tetrahedra a step does not trust their law with. Inverted ones (det F <= 0) are counted in either case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quarantine {
    /// None: a force that is not a number spreads. Nothing is counted.
    Off,
    /// Those whose deformation or stress is not finite: they add exact zeros, and count again once they are sound. For laws
    /// that bring tissue back from every shape.
    NotFinite,
    /// Those, and the inverted ones and those with a stress beyond [`MOST_STRESS`] times their stiffness: they follow the
    /// stable neo-Hookean law where their deformation is finite.
    #[default]
    Inverted,
}

/// Tetrahedra that the last step found inverted or not finite.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct QuarantineReport {
    /// Number of tetrahedra.
    pub n_tets: u32,
    /// The one with the lowest id.
    pub first: Option<TetId>,
}

impl QuarantineReport {
    pub(super) fn add(&mut self, other: Self) {
        self.n_tets += other.n_tets;
        self.first = self.first.into_iter().chain(other.first).min();
    }
}

/// The tetrahedron of each lane; [`NO_TET`] where there is none.
pub(super) type LaneTets = [TetId; N_LANES];
pub(super) const NO_TET: TetId = TetId(u32::MAX);

/// A law counts up to a stress of so many times lambda + 2 mu: beyond it, far beyond what tissue bears, it is stiffer than a step
/// of the rest shape can follow. A choice.
pub const MOST_STRESS: f64 = 10.0;

/// The checks of a part's tetrahedra.
pub(super) struct Guard<'a> {
    /// Whether inverted tetrahedra follow another law; else only those that are not finite do not count.
    pub(super) replaces_inverted: bool,
    /// Tetrahedra of each block.
    pub(super) tets: &'a [LaneTets],
    pub(super) found: &'a mut QuarantineReport,
    /// Becomes true where a tetrahedron is strained, see [`CALM_CENTRE`] and [`Guard::calm_squared_strain`].
    pub(super) is_strained: &'a mut bool,
    /// |2 E|^2 below which tissue is calm.
    pub(super) calm_squared_strain: f64,
}

/// Volume ratios det F within this of 1.15 (0.5 to 1.8) are calm: tissue is not near to inversion and not torn apart. A
/// choice: that of the stretch 1.3 along one axis and its inverse along two others lies well inside.
const CALM_REACH: f64 = 0.65;
/// The middle of the calm ratios.
const CALM_CENTRE: f64 = 1.15;

impl Guard<'_> {
    /// All lanes are sound.
    pub(super) fn all<V: Lanes>() -> u32 {
        (1 << V::COUNT) - 1
    }

    /// V P, and one bit per lane whose tetrahedron follows its own law; the others are recorded. `p` is V P of the law, with
    /// extras unless `is_law_alone`. Costs two comparisons where all is calm.
    #[inline(always)]
    pub(super) fn checked<L: ElementLaw, V: Lanes>(
        &mut self,
        law: &L,
        (g, numbers): (&Matrix<V>, [V; 2]),
        (p, is_law_alone): (Matrix<V>, bool),
        at: At,
    ) -> (Matrix<V>, u32) {
        let zero = g[0][0].constant(0.0);
        let one = g[0][0].constant(1.0);
        let f = |i: usize, j: usize| if i == j { g[i][j].plus(one) } else { g[i][j] };
        let cofactor = |j: usize, k: usize| f(1, j).fused(f(2, k), f(1, k).times(f(2, j)).negative());
        let cofactors = [cofactor(1, 2), cofactor(2, 0), cofactor(0, 1)];
        // det F and `more`.
        let ratio_and = |more: V| {
            f(0, 0).fused(cofactors[0], f(0, 1).fused(cofactors[1], f(0, 2).fused(cofactors[2], more)))
        };
        let squared_strain = L::squared_strain(g);
        let strain_tells = L::IS_FINITE_WITH_STRAIN && is_law_alone;
        // Zero, or not a number where the stress is not finite.
        let row = |i: usize| p[i][0].fused(zero, p[i][1].fused(zero, p[i][2].times(zero)));
        let nothing = if strain_tells { zero } else { row(0).plus(row(1)).plus(row(2)) };
        let from_centre = ratio_and(nothing.plus(zero.constant(-CALM_CENTRE)));
        let calm = zero.constant(CALM_REACH).above_bits(from_centre.magnitude())
            & zero.constant(self.calm_squared_strain).above_bits(squared_strain);
        if calm == Self::all::<V>() {
            return (p, calm);
        }
        *self.is_strained = true;
        if self.replaces_inverted {
            return self.replaced(law, (g, numbers), p, at);
        }
        let nothing = if strain_tells { squared_strain.times(zero) } else { nothing };
        let volume_ratio = ratio_and(nothing);
        let upright = volume_ratio.above_bits(zero);
        if upright == Self::all::<V>() {
            return (p, upright);
        }
        self.note(at, Self::all::<V>() & !upright);
        let sound = volume_ratio.above_bits(zero.constant(f64::NEG_INFINITY));
        if sound == Self::all::<V>() { (p, sound) } else { (Self::zeroed(&p, sound), sound) }
    }

    /// V P with that of the stand-in where the law does not count.
    #[cold]
    #[inline(never)]
    fn replaced<L: ElementLaw, V: Lanes>(
        &mut self,
        law: &L,
        (g, numbers): (&Matrix<V>, [V; 2]),
        p: Matrix<V>,
        at: At,
    ) -> (Matrix<V>, u32) {
        let (g_rows, mut p_rows) = (stored(g), stored(&p));
        let mut of_lane = [[0.0; N_LANES]; 2];
        numbers[0].store(&mut of_lane[0], 0);
        numbers[1].store(&mut of_lane[1], 0);
        let (mut sound, mut inverted, mut is_changed) = (Self::all::<V>(), 0, false);
        for lane in 0..V::COUNT {
            if self.tets[at.block][at.lane + lane] == NO_TET {
                continue;
            }
            let f = DMat3::IDENTITY + of_lane_matrix(&g_rows, lane);
            let mut p = of_lane_matrix(&p_rows, lane);
            let here = At { lane: at.lane + lane, ..at };
            let lame = || law.lame_of_volume([of_lane[0][lane], of_lane[1][lane]], here);
            let is_upright = f.determinant() > 0.0;
            let guard = if L::IS_GUARDED { squeeze_guard_pa(&f, lame()[0], lame()[1]) } else { None };
            if let Some(guard) = guard {
                p += guard;
                is_changed = true;
                set_lane(&mut p_rows, lane, &p);
            }
            let counts = is_upright || guard.is_some();
            if counts && p.is_finite() && greatest(&p) <= MOST_STRESS * modulus(lame()) {
                inverted |= u32::from(!is_upright) << lane;
                continue;
            }
            sound &= !(1 << lane);
            let [lambda, mu] = lame();
            let stand_in = StableNeoHooke::new(lambda, mu).map(|law| law.first_piola_pa(&f));
            let stress = stand_in.ok().filter(|p| f.is_finite() && p.is_finite()).unwrap_or(DMat3::ZERO);
            is_changed = true;
            set_lane(&mut p_rows, lane, &stress);
        }
        if !is_changed {
            return (p, sound);
        }
        self.note(at, Self::all::<V>() & !sound | inverted);
        let row = |i: usize| [0, 1, 2].map(|j| p[0][0].load(&p_rows[i][j], 0));
        ([row(0), row(1), row(2)], sound)
    }

    #[cold]
    #[inline(never)]
    fn note(&mut self, at: At, unsound: u32) {
        let lanes = self.tets[at.block].iter().skip(at.lane).enumerate();
        for (_, &tet) in lanes.filter(|(lane, tet)| unsound >> lane & 1 != 0 && **tet != NO_TET) {
            self.found.add(QuarantineReport { n_tets: 1, first: Some(tet) });
        }
    }

    /// `p`, and zeros in the lanes that are not sound.
    #[inline(always)]
    pub(super) fn zeroed<V: Lanes>(p: &Matrix<V>, sound: u32) -> Matrix<V> {
        let zero = p[0][0].constant(0.0);
        let row = |i: usize| {
            [
                Self::chosen(sound, p[i][0], zero),
                Self::chosen(sound, p[i][1], zero),
                Self::chosen(sound, p[i][2], zero),
            ]
        };
        [row(0), row(1), row(2)]
    }

    /// `then` in the lanes of `bits`, `otherwise` elsewhere.
    #[inline(always)]
    pub(super) fn chosen<V: Lanes>(bits: u32, then: V, otherwise: V) -> V {
        if bits == Self::all::<V>() { then } else { then.chosen(bits, otherwise) }
    }
}

fn stored<V: Lanes>(m: &Matrix<V>) -> [[LaneNumbers; 3]; 3] {
    let mut rows = [[[0.0; N_LANES]; 3]; 3];
    for (to, from) in rows.as_flattened_mut().iter_mut().zip(m.as_flattened()) {
        from.store(to, 0);
    }
    rows
}

fn set_lane(rows: &mut [[LaneNumbers; 3]; 3], lane: usize, m: &DMat3) {
    for (j, column) in m.to_cols_array_2d().into_iter().enumerate() {
        (0..3).for_each(|i| rows[i][j][lane] = column[i]);
    }
}

fn of_lane_matrix(rows: &[[LaneNumbers; 3]; 3], lane: usize) -> DMat3 {
    let column = |j: usize| [rows[0][j][lane], rows[1][j][lane], rows[2][j][lane]];
    DMat3::from_cols_array_2d(&[column(0), column(1), column(2)])
}

fn greatest(m: &DMat3) -> f64 {
    m.to_cols_array().into_iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

fn modulus([lambda, mu]: [f64; 2]) -> f64 {
    lambda + 2.0 * mu
}
