//! Any law: stress and tangent one tetrahedron at a time, gathering and products eight at a time.
//!
//! The tangent d2W/dF2 is symmetric, with 45 numbers per tetrahedron. It is computed at the first product after an
//! evaluation, so that a rejected line search step does not pay for it.

use std::ops::Range;

use fearless_simd::{Simd, dispatch, f64x8, prelude::*};

use super::evaluation::{Evaluation, On};
use super::lanes::{
    Group, LANES, Lanes, SymmetricLanes, add_turned, added_density, gradient, load, load_matrix, of_tet,
    scale,
};
use super::law::SharedLaw;
use super::shares::{Allowed, Share, Shares, scatter};
use crate::material::{Material, Tangent};
use crate::solve::{LOCAL_EDGES, TetStiffness, contracted_columns, contracted_rows};
use crate::workers::in_stretches;
use glisson_mesh::math::{DMat3, DVec3};

/// Entries of a symmetric 9x9 matrix.
const N_ENTRIES: usize = 45;

/// Law, deformation and tangent of all tetrahedra.
#[derive(Clone)]
pub(super) struct General {
    /// One, or one per live tetrahedron.
    laws: Vec<SharedLaw>,
    /// F by rows at the last evaluation.
    f: Vec<[Lanes; 9]>,
    /// Upper triangle of the tangent by rows, entries of F by rows.
    tangent_pa: Vec<[Lanes; N_ENTRIES]>,
    tangent_is_current: bool,
}

impl General {
    pub(super) fn new(laws: Vec<SharedLaw>, n_groups: usize) -> Self {
        Self {
            laws,
            f: vec![[[0.0; LANES]; 9]; n_groups],
            tangent_pa: vec![[[0.0; LANES]; N_ENTRIES]; n_groups],
            tangent_is_current: false,
        }
    }

    /// Law of live tetrahedron number `t`.
    pub(super) fn law(&self, t: usize) -> &dyn Material {
        law(&self.laws, t)
    }

    /// Overwrites `force_n` with the forces [N] of `factor` times the law; keeps F for the tangent.
    pub(super) fn evaluate(
        &mut self,
        on: &On<'_>,
        shares: &mut Shares,
        displacement_m: &[DVec3],
        force_n: &mut [DVec3],
    ) -> Evaluation {
        self.tangent_is_current = false;
        let laws = &self.laws;
        shares.evaluate(on.workers, &mut self.f, force_n, |groups, f, share| {
            dispatch!(on.level, simd => evaluate(simd, laws, f, (on, groups), displacement_m, share))
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
        if !self.tangent_is_current {
            self.update_tangents(on);
            self.tangent_is_current = true;
        }
        shares.sum(on.workers, force_n, |groups, share| {
            let tangents_pa = &self.tangent_pa[groups.clone()];
            let groups = on.shape.stretch(groups);
            dispatch!(on.level, simd => product(simd, tangents_pa, groups, direction_m, share));
        });
    }

    /// Whether the law of tetrahedron `t` has an energy and a stress there, and one that brings it back if it is inside out.
    pub(super) fn is_valid_at(&self, t: usize, f: &DMat3) -> bool {
        let law = self.law(t);
        let returns = f.determinant() > 0.0 || law.returns_from_inversion();
        returns && law.energy_density_j_per_m3(f).is_finite() && law.first_piola_pa(f).is_finite()
    }

    fn update_tangents(&mut self, on: &On<'_>) {
        let Self { laws, f, tangent_pa, .. } = self;
        in_stretches(on.workers, 1, &mut tangent_pa[..], |first, tangent_pa| {
            for (g, tangent_pa) in (first..).zip(tangent_pa) {
                for lane in 0..LANES {
                    let tangent = if on.shape.groups[g].has_stress(lane) {
                        law(laws, LANES * g + lane).tangent_pa(&lane_matrix(&f[g], lane))
                    } else {
                        [[0.0; 9]; 9]
                    };
                    let mut entry = 0;
                    for i in 0..9 {
                        for j in i..9 {
                            tangent_pa[entry][lane] = on.factor * tangent[by_columns(i)][by_columns(j)];
                            entry += 1;
                        }
                    }
                }
            }
        });
    }
}

fn law(laws: &[SharedLaw], t: usize) -> &dyn Material {
    &**of_tet(laws, t)
}

/// Place in glam's order by columns of the place `k` by rows.
const fn by_columns(k: usize) -> usize {
    3 * (k % 3) + k / 3
}

fn lane_matrix(rows: &[Lanes; 9], lane: usize) -> DMat3 {
    DMat3::from_cols_array(&std::array::from_fn(|k| rows[by_columns(k)][lane]))
}

/// Stiffness tensors of a tetrahedron with gradients alpha_1..alpha_3 for a tangent [Pa] times `scale_m3`.
pub(super) fn stiffness_of(tangent: &Tangent, alpha_per_m: [DVec3; 3], scale_m3: f64) -> TetStiffness {
    let [a, b, c] = alpha_per_m;
    let alpha = [-(a + b + c), a, b, c];
    let half: [[[f64; 9]; 3]; 4] = std::array::from_fn(|j| contracted_rows(tangent, alpha[j] * scale_m3));
    TetStiffness {
        vertex: std::array::from_fn(|j| contracted_columns(&half[j], alpha[j])),
        edge: LOCAL_EDGES.map(|[j, k]| contracted_columns(&half[j], alpha[k])),
    }
}

#[inline(always)]
fn evaluate<S: Simd>(
    simd: S,
    laws: &[SharedLaw],
    f_of_group: &mut [[Lanes; 9]],
    (on, groups): (&On<'_>, Range<usize>),
    displacement_m: &[DVec3],
    share: &mut Share,
) -> Allowed {
    share.energy_j = [0.0; LANES];
    let (mut is_upright, mut has_inverted) = (true, false);
    let of_groups = on.shape.stretch(groups.clone()).zip(f_of_group);
    for (g, ((group, added_pa), kept)) in groups.zip(of_groups) {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let h = gradient(simd, group, &alpha, displacement_m);
        let mut f = h;
        for i in 0..3 {
            f[i][i] += 1.0;
        }
        for r in 0..3 {
            for c in 0..3 {
                f[r][c].store_slice(&mut kept[3 * r + c]);
            }
        }
        let mut piola = [[0.0; LANES]; 9];
        for lane in (0..LANES).filter(|&lane| group.has_stress(lane)) {
            let law = law(laws, LANES * g + lane);
            let f = lane_matrix(kept, lane);
            let p = law.first_piola_pa(&f);
            is_upright &= p.is_finite();
            has_inverted |= f.determinant() <= 0.0;
            share.energy_j[lane] += group.volume_m3[lane] * on.factor * law.energy_density_j_per_m3(&f);
            for (k, x) in p.to_cols_array().into_iter().enumerate() {
                piola[by_columns(k)][lane] = on.factor * x;
            }
        }
        let mut stress = load_matrix(simd, &piola);
        let volume = load(simd, &group.volume_m3);
        if let Some(added_pa) = added_pa {
            let energy_j = load(simd, &share.energy_j) + added_density(simd, &h, added_pa) * volume;
            energy_j.store_slice(&mut share.energy_j);
            add_turned(simd, group, &f, added_pa, &mut stress);
        }
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
    Allowed { is_upright, has_inverted }
}

#[inline(always)]
fn product<'a, S: Simd>(
    simd: S,
    tangents_pa: &[[Lanes; N_ENTRIES]],
    groups: impl Iterator<Item = (&'a Group, Option<&'a SymmetricLanes>)>,
    direction_m: &[DVec3],
    share: &mut Share,
) {
    for ((group, added_pa), tangent) in groups.zip(tangents_pa) {
        let alpha = load_matrix(simd, &group.gradient_per_m);
        let df = gradient(simd, group, &alpha, direction_m);
        let mut dp = [f64x8::splat(simd, 0.0); 9];
        let mut entry = 0;
        for i in 0..9 {
            for j in i..9 {
                let t = load(simd, &tangent[entry]);
                entry += 1;
                dp[i] += t * df[j / 3][j % 3];
                if i != j {
                    dp[j] += t * df[i / 3][i % 3];
                }
            }
        }
        let mut stress = [[dp[0], dp[1], dp[2]], [dp[3], dp[4], dp[5]], [dp[6], dp[7], dp[8]]];
        if let Some(added_pa) = added_pa {
            add_turned(simd, group, &df, added_pa, &mut stress);
        }
        let volume = load(simd, &group.volume_m3);
        scale(&mut stress, volume);
        scatter(group, &alpha, &stress, share);
    }
}

impl Group {
    /// Whether the lane is a tetrahedron that is not left out.
    pub(super) fn has_stress(&self, lane: usize) -> bool {
        self.volume_m3[lane] > 0.0 && self.left_out >> lane & 1 == 0
    }
}
