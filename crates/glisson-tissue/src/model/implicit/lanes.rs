//! Eight tetrahedra at a time: gathering, deformation, and the stress that is there at rest.
//!
//! With F = I + H, H = sum_k (u_k - u_0) (x) alpha_k (k = 1, 2, 3). Displacements enter, not positions: at rest
//! F = I and elastic forces are zero to the bit. Lanes only add and multiply, without fused operations, so that
//! every instruction set gives the same bits.

use std::ops::Range;

use fearless_simd::{Simd, f64x8, prelude::*};

use glisson_mesh::math::DVec3;

pub(super) const LANES: usize = 8;
pub(super) type Lanes = [f64; LANES];
pub(super) type Matrix<S> = [[f64x8<S>; 3]; 3];
/// Symmetric: xx, yy, zz, xy, xz, yz.
pub(super) type SymmetricLanes = [Lanes; 6];

/// Places of [`SymmetricLanes`] by row and column.
pub(super) const SYMMETRIC: [[usize; 3]; 3] = [[0, 3, 4], [3, 1, 5], [4, 5, 2]];

/// The tetrahedra at rest, and stress added to the elastic one.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    pub(super) groups: Vec<Group>,
    /// Second Piola-Kirchhoff stress [Pa] beside the elastic one; empty when there is none.
    pub(super) added_pa: Vec<SymmetricLanes>,
}

impl Shape {
    /// Each of these groups with its added stress.
    #[inline(always)]
    pub(super) fn stretch(
        &self,
        groups: Range<usize>,
    ) -> impl Iterator<Item = (&Group, Option<&SymmetricLanes>)> {
        let added_pa = self.added_pa.get(groups.clone()).unwrap_or(&[]);
        let added_pa = added_pa.iter().map(Some).chain(std::iter::repeat(None));
        self.groups[groups].iter().zip(added_pa)
    }
}

/// Eight tetrahedra: nodes, gradients alpha_1..alpha_3 (component i of alpha_k in row 3 (k-1) + i), volumes.
#[derive(Clone, Debug)]
pub(super) struct Group {
    pub(super) nodes: [[u32; LANES]; 4],
    pub(super) gradient_per_m: [Lanes; 9],
    pub(super) volume_m3: Lanes,
    /// Bit l: lane l is left out, it counts as undeformed and without stress.
    pub(super) left_out: u8,
}

/// Two moduli [Pa] of each group: the same of all, or of each its own.
#[derive(Clone, Debug)]
pub(super) struct Moduli {
    of_groups_pa: Vec<[Lanes; 2]>,
}

impl Moduli {
    /// Of one pair for all live tetrahedra, or one for each.
    pub(super) fn new(of_tets_pa: &[[f64; 2]]) -> Self {
        // Lanes beyond the end repeat the last tetrahedron; of one pair for all every lane has it.
        let lane = |group: &[[f64; 2]], lane: usize, which: usize| group[lane.min(group.len() - 1)][which];
        let of_group =
            |group: &[[f64; 2]]| [0, 1].map(|which| std::array::from_fn(|l| lane(group, l, which)));
        Self { of_groups_pa: of_tets_pa.chunks(LANES).map(of_group).collect() }
    }

    /// The moduli of each of these groups.
    #[inline(always)]
    pub(super) fn stretch(&self, groups: Range<usize>) -> impl Iterator<Item = &[Lanes; 2]> {
        groups.map(|group| &self.of_groups_pa[if self.of_groups_pa.len() == 1 { 0 } else { group }])
    }
}

/// The value of live tetrahedron number `t` in a list with one value, or one per live tetrahedron.
pub(super) fn of_tet<T>(values: &[T], t: usize) -> &T {
    &values[if values.len() == 1 { 0 } else { t }]
}

#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, lanes: &Lanes) -> f64x8<S> {
    f64x8::from_slice(simd, lanes)
}

#[inline(always)]
pub(super) fn load_matrix<S: Simd>(simd: S, rows: &[Lanes; 9]) -> Matrix<S> {
    let mut matrix = [[f64x8::splat(simd, 0.0); 3]; 3];
    for r in 0..3 {
        for c in 0..3 {
            matrix[r][c] = load(simd, &rows[3 * r + c]);
        }
    }
    matrix
}

/// Gradient sum_k (x_k - x_0) (x) alpha_k of a vector at the nodes, by rows.
#[inline(always)]
pub(super) fn gradient<S: Simd>(simd: S, group: &Group, alpha: &Matrix<S>, x: &[DVec3]) -> Matrix<S> {
    let mut corner = [[[0.0; LANES]; 3]; 4];
    for k in 0..4 {
        for lane in 0..LANES {
            let v = &x[group.nodes[k][lane] as usize];
            corner[k][0][lane] = v.x;
            corner[k][1][lane] = v.y;
            corner[k][2][lane] = v.z;
        }
    }
    let mut result = [[f64x8::splat(simd, 0.0); 3]; 3];
    for i in 0..3 {
        let origin = load(simd, &corner[0][i]);
        let d0 = load(simd, &corner[1][i]) - origin;
        let d1 = load(simd, &corner[2][i]) - origin;
        let d2 = load(simd, &corner[3][i]) - origin;
        for j in 0..3 {
            result[i][j] = d0 * alpha[0][j] + d1 * alpha[1][j] + d2 * alpha[2][j];
        }
    }
    if group.left_out != 0 {
        for x in result.iter_mut().flatten() {
            *x = without_left_out(simd, group, *x);
        }
    }
    result
}

#[inline(always)]
fn without_left_out<S: Simd>(simd: S, group: &Group, x: f64x8<S>) -> f64x8<S> {
    let mut lanes = [0.0; LANES];
    x.store_slice(&mut lanes);
    for (lane, value) in lanes.iter_mut().enumerate() {
        if group.left_out >> lane & 1 == 1 {
            *value = 0.0;
        }
    }
    load(simd, &lanes)
}

/// Adds F S to the stress (or dF S to its differential).
#[inline(always)]
pub(super) fn add_turned<S: Simd>(
    simd: S,
    group: &Group,
    f: &Matrix<S>,
    added_pa: &SymmetricLanes,
    stress: &mut Matrix<S>,
) {
    let s = added_pa.each_ref().map(|x| load(simd, x));
    let s = if group.left_out == 0 { s } else { s.map(|x| without_left_out(simd, group, x)) };
    for r in 0..3 {
        for c in 0..3 {
            stress[r][c] +=
                f[r][0] * s[SYMMETRIC[0][c]] + f[r][1] * s[SYMMETRIC[1][c]] + f[r][2] * s[SYMMETRIC[2][c]];
        }
    }
}

/// Energy density of the added stress: (F S : F - tr S)/2 = S : H + (H S : H)/2.
#[inline(always)]
pub(super) fn added_density<S: Simd>(simd: S, h: &Matrix<S>, added_pa: &SymmetricLanes) -> f64x8<S> {
    let s = added_pa.each_ref().map(|x| load(simd, x));
    let mut linear = f64x8::splat(simd, 0.0);
    let mut square = f64x8::splat(simd, 0.0);
    for r in 0..3 {
        for c in 0..3 {
            let turned =
                h[r][0] * s[SYMMETRIC[0][c]] + h[r][1] * s[SYMMETRIC[1][c]] + h[r][2] * s[SYMMETRIC[2][c]];
            square += turned * h[r][c];
            linear += s[SYMMETRIC[r][c]] * h[r][c];
        }
    }
    linear + square * 0.5
}

/// F = I + H, its cofactor matrix, and J.
#[inline(always)]
pub(super) fn deformation<S: Simd>(h: &Matrix<S>) -> (Matrix<S>, Matrix<S>, f64x8<S>) {
    let mut f = *h;
    for i in 0..3 {
        f[i][i] += 1.0;
    }
    let cofactor = cofactor(&f);
    let j = f[0][0] * cofactor[0][0] + f[0][1] * cofactor[0][1] + f[0][2] * cofactor[0][2];
    (f, cofactor, j)
}

/// dJ/dF: the cofactor matrix J F^-T, defined for any F.
#[inline(always)]
pub(super) fn cofactor<S: Simd>(f: &Matrix<S>) -> Matrix<S> {
    let mut cofactor = *f;
    for i in 0..3 {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        for j in 0..3 {
            let (c, d) = ((j + 1) % 3, (j + 2) % 3);
            cofactor[i][j] = f[a][c] * f[b][d] - f[a][d] * f[b][c];
        }
    }
    cofactor
}

/// |F|^2 - 3 as 2 tr H + |H|^2, which keeps its digits near rest.
#[inline(always)]
pub(super) fn stretch<S: Simd>(h: &Matrix<S>) -> f64x8<S> {
    let mut stretch = (h[0][0] + h[1][1] + h[2][2]) * 2.0;
    for row in h {
        for x in row {
            stretch += *x * *x;
        }
    }
    stretch
}

/// Multiplies every entry.
#[inline(always)]
pub(super) fn scale<S: Simd>(matrix: &mut Matrix<S>, factor: f64x8<S>) {
    for x in matrix.iter_mut().flatten() {
        *x *= factor;
    }
}

/// Mean of a node value over the four corners of each lane; zero in lanes that are left out.
#[inline(always)]
pub(super) fn corner_mean<S: Simd>(simd: S, group: &Group, of_node: &[f64]) -> f64x8<S> {
    let mut sum = [0.0; LANES];
    for k in 0..4 {
        for lane in 0..LANES {
            sum[lane] += of_node[group.nodes[k][lane] as usize];
        }
    }
    let mean = load(simd, &sum) * 0.25;
    if group.left_out == 0 { mean } else { without_left_out(simd, group, mean) }
}

/// The same of a matrix, given and returned by rows.
#[inline(always)]
pub(super) fn corner_mean_matrix<'a, S: Simd>(
    simd: S,
    group: &Group,
    of_node: impl Fn(usize) -> &'a [f64; 9],
) -> Matrix<S> {
    let mut sum = [[0.0; LANES]; 9];
    for k in 0..4 {
        for lane in 0..LANES {
            let rows = of_node(group.nodes[k][lane] as usize);
            for (sum, x) in sum.iter_mut().zip(rows) {
                sum[lane] += 0.25 * x;
            }
        }
    }
    let mut mean = load_matrix(simd, &sum);
    if group.left_out != 0 {
        for x in mean.iter_mut().flatten() {
            *x = without_left_out(simd, group, *x);
        }
    }
    mean
}

#[inline(always)]
pub(super) fn add_to_corners<S: Simd>(group: &Group, value: f64x8<S>, of_node: &mut [f64]) {
    let mut lanes = [0.0; LANES];
    value.store_slice(&mut lanes);
    for lane in 0..LANES {
        for k in 0..4 {
            of_node[group.nodes[k][lane] as usize] += lanes[lane];
        }
    }
}
