//! The stable neo-Hookean law of [`crate::material::StableNeoHooke`], eight tetrahedra at a time.
//!
//! With F = I + H, e = I1 - 3 = 2 tr H + |H|^2, q = J - 1, cof F = I + K, the law's own m and l [Pa], and
//! l (1 - a) = -3/4 m, the energy density is
//!
//! W = m/2 (e - ln(1 + e/4)) + q (l q/2 - 3/4 m),
//!
//! the first Piola-Kirchhoff stress P = s F + p cof F with s = m (1 - 1/(4 + e)) and p = l q - 3/4 m, here
//!
//! P = s H + p K + (s + p) I,   s + p = m e/(4 (4 + e)) + l q,
//!
//! so that rest has no stress to the bit and nothing cancels near it, and its differential
//!
//! dP = s dF + 2 m/(4 + e)^2 (F : dF) F + l (cof F : dF) cof F + p d(cof F).
//!
//! All of this holds for every F, also with J <= 0. F and three numbers are kept for the differential; the cofactor
//! matrix costs less to compute anew than to read.

use fearless_simd::{Simd, dispatch, f64x8, prelude::*};

use super::evaluation::{Evaluation, On};
use super::lanes::{
    Group, LANES, Lanes, Matrix, Moduli, SymmetricLanes, add_turned, added_density, cofactor, gradient, load,
    load_matrix, of_tet, scale, stretch,
};
use super::projected::{Modes, PAIRS};
use super::shares::{Allowed, Share, Shares, scatter};
use crate::material::{Material, SignedSingularValues, StableNeoHooke, signed_singular_values};
use crate::solve::TetStiffness;
use glisson_mesh::math::{DMat3, DVec3};

/// Data of the tangent of eight tetrahedra.
#[derive(Clone, Debug)]
struct GroupTangent {
    /// F by rows.
    f: [Lanes; 9],
    /// s, the factor of dF.
    shear_pa: Lanes,
    /// Factor of (F : dF) F.
    stretching_pa: Lanes,
    /// p, the factor of d(cof F).
    pressure_pa: Lanes,
}

const NO_TANGENT: GroupTangent = GroupTangent {
    f: [[0.0; LANES]; 9],
    shear_pa: [0.0; LANES],
    stretching_pa: [0.0; LANES],
    pressure_pa: [0.0; LANES],
};

/// Law and tangent of all tetrahedra.
#[derive(Clone, Debug)]
pub(super) struct Stable {
    /// One, or one per live tetrahedron.
    laws: Vec<StableNeoHooke>,
    /// The laws' own l and m.
    own: Moduli,
    tangents: Vec<GroupTangent>,
}

impl Stable {
    /// Of one law, or one for each live tetrahedron.
    pub(super) fn new(laws: Vec<StableNeoHooke>, n_groups: usize) -> Self {
        let own_pa: Vec<[f64; 2]> = laws.iter().map(StableNeoHooke::own_pa).collect();
        Self { laws, own: Moduli::new(&own_pa), tangents: vec![NO_TANGENT; n_groups] }
    }

    /// Law of live tetrahedron number `t`.
    pub(super) fn law(&self, t: usize) -> &StableNeoHooke {
        of_tet(&self.laws, t)
    }

    /// Overwrites `force_n` with the forces [N] of `factor` times the law; keeps the tangent.
    pub(super) fn evaluate(
        &mut self,
        on: &On<'_>,
        shares: &mut Shares,
        displacement_m: &[DVec3],
        force_n: &mut [DVec3],
    ) -> Evaluation {
        let Self { own, tangents, .. } = self;
        shares.evaluate(on.workers, tangents, force_n, |groups, tangents, share| {
            let own = (own.stretch(groups.clone()), on.factor);
            let groups = on.shape.stretch(groups);
            dispatch!(on.level, simd => evaluate(simd, tangents, groups, own, displacement_m, share))
        })
    }

    /// Overwrites `force_n` with K d, K being the tangent of the last evaluation with the same factor.
    pub(super) fn tangent_product(
        &mut self,
        on: &On<'_>,
        shares: &mut Shares,
        direction_m: &[DVec3],
        force_n: &mut [DVec3],
    ) {
        shares.sum(on.workers, force_n, |groups, share| {
            let tangents = &self.tangents[groups.clone()];
            let own = (self.own.stretch(groups.clone()), on.factor);
            let groups = on.shape.stretch(groups);
            dispatch!(on.level, simd => product(simd, tangents, groups, own, direction_m, share));
        });
    }

    /// Whether the law has an energy and a stress there: everywhere, until numbers overflow.
    pub(super) fn is_valid_at(&self, t: usize, f: &DMat3) -> bool {
        let law = self.law(t);
        law.energy_density_j_per_m3(f).is_finite() && law.first_piola_pa(f).is_finite()
    }

    /// Projected stiffness for the preconditioner, for any `f`.
    pub(super) fn projected_stiffness(
        &self,
        t: usize,
        f: DMat3,
        alpha_per_m: [DVec3; 3],
        volume_m3: f64,
    ) -> TetStiffness {
        let SignedSingularValues { u, stretches, v } = signed_singular_values(&f);
        let derivatives = self.law(t).principal(stretches);
        // They have a pair at the place of the third value.
        let of_pairs = |values: [f64; 3]| PAIRS.map(|[i, j]| values[3 - i - j]);
        let modes = Modes {
            u,
            v,
            hessian_pa: DMat3::from_cols_array_2d(&derivatives.second),
            twist_pa: of_pairs(derivatives.antisymmetric),
            flip_pa: of_pairs(derivatives.symmetric),
        };
        modes.projected_stiffness(alpha_per_m, volume_m3)
    }
}

/// K = cof F - I and q = J - 1 of F = I + H.
#[inline(always)]
fn volume_change<S: Simd>(h: &Matrix<S>, f: &Matrix<S>) -> (Matrix<S>, f64x8<S>) {
    let mut k = cofactor(f);
    for i in 0..3 {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        k[i][i] = h[a][a] + h[b][b] + (h[a][a] * h[b][b] - h[a][b] * h[b][a]);
    }
    let q = k[0][0] + h[0][0] + (h[0][0] * k[0][0] + h[0][1] * k[0][1] + h[0][2] * k[0][2]);
    (k, q)
}

#[inline(always)]
fn evaluate<'a, S: Simd>(
    simd: S,
    tangents: &mut [GroupTangent],
    groups: impl Iterator<Item = (&'a Group, Option<&'a SymmetricLanes>)>,
    (own_pa, factor): (impl Iterator<Item = &'a [Lanes; 2]>, f64),
    displacement_m: &[DVec3],
    share: &mut Share,
) -> Allowed {
    let mut least_q = f64x8::splat(simd, f64::INFINITY);
    // Zero until a stress is not finite.
    let mut overflow = f64x8::splat(simd, 0.0);
    let mut energy = f64x8::splat(simd, 0.0);
    for (((group, added_pa), tangent), own_pa) in groups.zip(tangents).zip(own_pa) {
        let [l, m] = own_pa.each_ref().map(|lanes| load(simd, lanes) * factor);
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, displacement_m);
        let mut f = h;
        for i in 0..3 {
            f[i][i] += 1.0;
        }
        let (k, q) = volume_change(&h, &f);
        least_q = least_q.min(q);
        let e = stretch(&h);
        let inverse = f64x8::splat(simd, 1.0) / (e + 4.0);
        // s - 3/4 m and p + 3/4 m.
        let (stiffening, bulk) = (e * inverse * (m * 0.25), q * l);
        let (shear, pressure) = (stiffening + m * 0.75, bulk - m * 0.75);
        let mut density = (e - log_of_one_plus(simd, e * 0.25)) * (m * 0.5) + q * (bulk * 0.5 - m * 0.75);
        let hydrostatic = stiffening + bulk;
        let mut stress = h;
        for r in 0..3 {
            for c in 0..3 {
                stress[r][c] = h[r][c] * shear + k[r][c] * pressure;
                f[r][c].store_slice(&mut tangent.f[3 * r + c]);
            }
            stress[r][r] += hydrostatic;
            overflow += (stress[r][0] + stress[r][1] + stress[r][2]) * 0.0;
        }
        shear.store_slice(&mut tangent.shear_pa);
        (inverse * inverse * (m * 2.0)).store_slice(&mut tangent.stretching_pa);
        pressure.store_slice(&mut tangent.pressure_pa);
        if let Some(added_pa) = added_pa {
            density += added_density(simd, &h, added_pa);
            add_turned(simd, group, &f, added_pa, &mut stress);
        }
        let volume = load(simd, &group.volume_m3);
        energy += density * volume;
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
    energy.store_slice(&mut share.energy_j);
    allowed(least_q, overflow)
}

/// ln(1 + x) of each lane.
#[inline(always)]
fn log_of_one_plus<S: Simd>(simd: S, x: f64x8<S>) -> f64x8<S> {
    let mut lanes = [0.0; LANES];
    x.store_slice(&mut lanes);
    load(simd, &lanes.map(libm::log1p))
}

/// From the lanes' smallest J - 1, and zeros where all stresses are finite. Lanes that are
/// left out have J = 1, those beyond the end repeat the last tetrahedron.
#[inline(always)]
fn allowed<S: Simd>(least_q: f64x8<S>, overflow: f64x8<S>) -> Allowed {
    let mut lanes = [[0.0; LANES]; 2];
    least_q.store_slice(&mut lanes[0]);
    overflow.store_slice(&mut lanes[1]);
    Allowed { is_upright: lanes[1] == [0.0; LANES], has_inverted: lanes[0].into_iter().any(|q| q <= -1.0) }
}

/// dP for dF = sum_k (d_k - d_0) (x) alpha_k.
#[inline(always)]
fn product<'a, S: Simd>(
    simd: S,
    tangents: &[GroupTangent],
    groups: impl Iterator<Item = (&'a Group, Option<&'a SymmetricLanes>)>,
    (own_pa, factor): (impl Iterator<Item = &'a [Lanes; 2]>, f64),
    direction_m: &[DVec3],
    share: &mut Share,
) {
    for (((group, added_pa), tangent), [l, _]) in groups.zip(tangents).zip(own_pa) {
        let l = load(simd, l) * factor;
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let df = gradient(simd, group, &alpha, direction_m);
        let f = load_matrix(simd, &tangent.f);
        let cofactor = cofactor(&f);
        let stretching = contraction(&f, &df) * load(simd, &tangent.stretching_pa);
        let swelling = contraction(&cofactor, &df) * l;
        let shear = load(simd, &tangent.shear_pa);
        let pressure = load(simd, &tangent.pressure_pa);
        let mut stress = cofactor_change(&f, &df);
        for r in 0..3 {
            for c in 0..3 {
                stress[r][c] = df[r][c] * shear
                    + f[r][c] * stretching
                    + cofactor[r][c] * swelling
                    + stress[r][c] * pressure;
            }
        }
        if let Some(added_pa) = added_pa {
            add_turned(simd, group, &df, added_pa, &mut stress);
        }
        let volume = load(simd, &group.volume_m3);
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
}

/// a : b
#[inline(always)]
fn contraction<S: Simd>(a: &Matrix<S>, b: &Matrix<S>) -> f64x8<S> {
    let row = |r: usize| a[r][0] * b[r][0] + a[r][1] * b[r][1] + a[r][2] * b[r][2];
    row(0) + row(1) + row(2)
}

/// d(cof F), linear in F and in dF.
#[inline(always)]
fn cofactor_change<S: Simd>(f: &Matrix<S>, df: &Matrix<S>) -> Matrix<S> {
    let mut change = *df;
    for i in 0..3 {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (c, d) = ((j + 1) % 3, (j + 2) % 3);
            change[i][j] =
                (f[a][c] * df[b][d] + df[a][c] * f[b][d]) - (f[a][d] * df[b][c] + df[a][d] * f[b][c]);
        }
    }
    change
}

#[cfg(test)]
mod tests {
    use super::super::general::stiffness_of;
    use super::*;
    use glisson_mesh::math::{SeededRandom, outer};

    const LAME_PA: [f64; 2] = [9000.0, 1000.0];

    /// The reference is the law's projected tangent, contracted with the gradients.
    #[test]
    fn projected_stiffness_is_that_of_the_projected_tangent_for_any_shape() {
        let mut random = SeededRandom::new(12);
        let law = StableNeoHooke::new(LAME_PA[0], LAME_PA[1]).unwrap();
        let stable = Stable::new(vec![law], 0);
        let turn = DMat3::from_rotation_y(0.7);
        let mut shapes = vec![
            DMat3::IDENTITY,
            turn,
            DMat3::ZERO,
            turn * 0.3,
            DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)),
            turn * DMat3::from_diagonal(DVec3::new(1.0, 0.0, 1.2)),
            turn * DMat3::from_diagonal(DVec3::new(0.2, 0.3, -0.25)) * DMat3::from_rotation_x(1.1),
            outer(DVec3::new(1.0, 2.0, 3.0), DVec3::new(-1.0, 0.5, 2.0)),
        ];
        for scale in [0.1, 0.7, 3.0] {
            for _ in 0..20 {
                shapes.push(DMat3::from_cols_array(&std::array::from_fn(|_| random.normal() * scale)));
            }
        }
        for f in shapes {
            let alpha: [DVec3; 3] =
                std::array::from_fn(|_| DVec3::new(random.normal(), random.normal(), random.normal()));
            let found = stable.projected_stiffness(0, f, alpha, 0.7);
            let expected = stiffness_of(&law.projected_tangent_pa(&f), alpha, 0.7);
            let blocks =
                |k: &TetStiffness| -> Vec<DMat3> { k.vertex.iter().chain(&k.edge).copied().collect() };
            let largest =
                expected.vertex.iter().flat_map(DMat3::to_cols_array).fold(0.0, |m: f64, x| m.max(x.abs()));
            for (a, b) in blocks(&found).into_iter().zip(blocks(&expected)) {
                assert!(a.abs_diff_eq(b, 1e-11 * largest), "{f}: {a} {b}");
            }
        }
    }
}
