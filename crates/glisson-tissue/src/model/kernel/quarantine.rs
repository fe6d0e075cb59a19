//! Leaves out tetrahedra that are inverted or not finite, so that one bad tetrahedron does not spoil a step.

use super::element::{At, ElementLaw, Matrix};
use super::lanes::Lanes;
use super::rows::N_LANES;
use glisson_mesh::mesh::TetId;

/// Which tetrahedra a step leaves out: they add exact zeros, and count again once they are sound. Inverted ones
/// (det F <= 0) are counted in either case.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quarantine {
    /// None: a force that is not a number spreads. Nothing is counted.
    Off,
    /// Those whose deformation or stress is not finite. For laws that are finite in every shape: an inverted tetrahedron gives
    /// back its energy, whereas leaving it out would create energy.
    NotFinite,
    /// Those, and the inverted ones: for laws that are not finite there.
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

/// The checks of a part's tetrahedra.
pub(super) struct Guard<'a> {
    /// Whether inverted tetrahedra are left out, or only those that are not finite.
    pub(super) leaves_out_inverted: bool,
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

    /// One bit per lane whose tetrahedron counts; the others are recorded. `p` is V P of law `L`, with extras unless
    /// `is_law_alone`. Costs two comparisons where all is calm.
    #[inline(always)]
    pub(super) fn sound_bits<L: ElementLaw, V: Lanes>(
        &mut self,
        g: &Matrix<V>,
        p: &Matrix<V>,
        is_law_alone: bool,
        at: At,
    ) -> u32 {
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
            return calm;
        }
        let nothing = if strain_tells { squared_strain.times(zero) } else { nothing };
        let volume_ratio = ratio_and(nothing);
        *self.is_strained = true;
        let upright = volume_ratio.above_bits(zero);
        if upright == Self::all::<V>() {
            return upright;
        }
        self.note(at, Self::all::<V>() & !upright);
        if self.leaves_out_inverted {
            upright
        } else {
            volume_ratio.above_bits(zero.constant(f64::NEG_INFINITY))
        }
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
