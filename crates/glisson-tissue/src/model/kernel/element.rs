//! The force of one tetrahedron, in any number of lanes.
//!
//! With the displacements d_k = u_k - u_0 and shape gradients alpha_k, k = 1, 2, 3, the displacement gradient
//! is G = sum_k d_k (x) alpha_k. A law gives the first Piola-Kirchhoff stress times the rest volume, V P(G);
//! the forces that balance the deformation are f_k = V P alpha_k and f_0 = -(f_1 + f_2 + f_3)
//! (seed `002`, eq. 5 to 9, before its expansion into tensors).
//!
//! The material is given by two numbers, see [`ElementLaw::numbers`]. The input is displacements, not positions: nothing
//! cancels at small strain, and the forces of a body at rest are exactly zero.

use super::lanes::Lanes;

/// Three by three numbers, `[row][column]`.
pub(super) type Matrix<V> = [[V; 3]; 3];
/// A symmetric matrix: xx, yy, zz, xy, xz, yz.
pub(super) type Symmetric<V> = [V; 6];

/// The tetrahedra that are computed: the lanes of `block` from `lane` on.
#[derive(Clone, Copy, Debug)]
pub(super) struct At {
    pub(super) block: usize,
    pub(super) lane: usize,
}

/// A stress-strain law, chosen outside the loop over the elements.
pub(super) trait ElementLaw {
    /// Whether the stress is that of small strain, for which P and S are the same.
    const IS_SMALL_STRAIN: bool = false;

    /// The two numbers [N m] of a tetrahedron of this volume, lambda and mu.
    fn numbers(volume_m3: f64, lambda_pa: f64, mu_pa: f64) -> [f64; 2];

    /// V lambda and V mu [N m] at rest of a tetrahedron with these numbers.
    fn lame_of_volume(&self, numbers: [f64; 2], at: At) -> [f64; 2];

    /// V P for the displacement gradient `g`.
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V>;

    /// Whether P is finite wherever [`ElementLaw::squared_strain`] is; otherwise P is checked too.
    const IS_FINITE_WITH_STRAIN: bool = false;

    /// Whether squeezed tissue is kept from being flat by [`crate::material::squeeze_guard_pa`].
    const IS_GUARDED: bool = false;

    /// |2 E|^2, a measure of the strain with which the stiffness grows: no principal stretch s has |s^2 - 1| above its root.
    #[inline(always)]
    fn squared_strain<V: Lanes>(g: &Matrix<V>) -> V {
        let entry = |i: usize, j: usize| twice_strain(g, i, j);
        let (xx, yy, zz) = (entry(0, 0), entry(1, 1), entry(2, 2));
        let (xy, xz, yz) = (entry(0, 1), entry(0, 2), entry(1, 2));
        let shear = xy.fused(xy, xz.fused(xz, yz.times(yz)));
        xx.fused(xx, yy.fused(yy, zz.fused(zz, shear.plus(shear))))
    }

    /// V S, S = F^-1 P the second Piola-Kirchhoff stress.
    #[inline(always)]
    fn scaled_second_stress<V: Lanes>(&self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Symmetric<V> {
        let p = self.scaled_stress(g, numbers, at);
        let volume = VolumeChange::of(g);
        let one = g[0][0].constant(1.0);
        let inverse = one.over(volume.growth.plus(one));
        // F^-1 = (Id + H)^T / J.
        let entry = |i: usize, j: usize| {
            let h = &volume.cofactor_growth;
            let sum = h[0][i].fused(p[0][j], h[1][i].fused(p[1][j], h[2][i].fused(p[2][j], p[i][j])));
            inverse.times(sum)
        };
        [entry(0, 0), entry(1, 1), entry(2, 2), entry(0, 1), entry(0, 2), entry(1, 2)]
    }
}

/// Hooke's law with the small strain: P = lambda tr(e) Id + 2 mu e, e = (G + G^T) / 2.
pub(super) struct Linear;

impl ElementLaw for Linear {
    const IS_SMALL_STRAIN: bool = true;

    /// Zero: the stiffness is constant.
    #[inline(always)]
    fn squared_strain<V: Lanes>(g: &Matrix<V>) -> V {
        g[0][0].constant(0.0)
    }

    /// V lambda and V mu.
    fn numbers(volume_m3: f64, lambda_pa: f64, mu_pa: f64) -> [f64; 2] {
        [volume_m3 * lambda_pa, volume_m3 * mu_pa]
    }

    fn lame_of_volume(&self, numbers: [f64; 2], _: At) -> [f64; 2] {
        numbers
    }

    #[inline(always)]
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V> {
        full(&self.scaled_second_stress(g, numbers, at))
    }

    #[inline(always)]
    fn scaled_second_stress<V: Lanes>(&self, g: &Matrix<V>, [lambda, mu]: [V; 2], _: At) -> Symmetric<V> {
        let pressure = lambda.times(g[0][0].plus(g[1][1]).plus(g[2][2]));
        let twice_mu = mu.plus(mu);
        [
            twice_mu.fused(g[0][0], pressure),
            twice_mu.fused(g[1][1], pressure),
            twice_mu.fused(g[2][2], pressure),
            mu.times(g[0][1].plus(g[1][0])),
            mu.times(g[0][2].plus(g[2][0])),
            mu.times(g[1][2].plus(g[2][1])),
        ]
    }
}

/// St Venant-Kirchhoff: P = F S, S = lambda tr(E) Id + 2 mu E, F = Id + G, 2 E = G + G^T + G^T G.
pub(super) struct StVenantKirchhoff;

impl ElementLaw for StVenantKirchhoff {
    /// F is bounded by E, and P = F S is a polynomial in it: where |2 E|^2 is finite, entries are below 1e77.
    const IS_FINITE_WITH_STRAIN: bool = true;
    const IS_GUARDED: bool = true;

    /// V lambda / 2 and V mu.
    fn numbers(volume_m3: f64, lambda_pa: f64, mu_pa: f64) -> [f64; 2] {
        [0.5 * volume_m3 * lambda_pa, volume_m3 * mu_pa]
    }

    fn lame_of_volume(&self, [half_lambda, mu]: [f64; 2], _: At) -> [f64; 2] {
        [2.0 * half_lambda, mu]
    }

    #[inline(always)]
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, numbers: [V; 2], at: At) -> Matrix<V> {
        carried(g, &self.scaled_second_stress(g, numbers, at))
    }

    #[inline(always)]
    fn scaled_second_stress<V: Lanes>(
        &self,
        g: &Matrix<V>,
        [half_lambda, mu]: [V; 2],
        _: At,
    ) -> Symmetric<V> {
        let twice_strain = |i: usize, j: usize| twice_strain(g, i, j);
        let [xx, yy, zz] = [twice_strain(0, 0), twice_strain(1, 1), twice_strain(2, 2)];
        let pressure = half_lambda.times(xx.plus(yy).plus(zz));
        [
            mu.fused(xx, pressure),
            mu.fused(yy, pressure),
            mu.fused(zz, pressure),
            mu.times(twice_strain(0, 1)),
            mu.times(twice_strain(0, 2)),
            mu.times(twice_strain(1, 2)),
        ]
    }
}

/// An entry of 2 E = G + G^T + G^T G.
#[inline(always)]
fn twice_strain<V: Lanes>(g: &Matrix<V>, i: usize, j: usize) -> V {
    let linear = g[i][j].plus(g[j][i]);
    g[0][i].fused(g[0][j], g[1][i].fused(g[1][j], g[2][i].fused(g[2][j], linear)))
}

/// The symmetric matrix with all nine entries.
#[inline(always)]
pub(super) fn full<V: Lanes>(&[xx, yy, zz, xy, xz, yz]: &Symmetric<V>) -> Matrix<V> {
    [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
}

/// F S = S + G S.
#[inline(always)]
pub(super) fn carried<V: Lanes>(g: &Matrix<V>, s: &Symmetric<V>) -> Matrix<V> {
    let s = full(s);
    let row = |i: usize| {
        let column =
            |j: usize| g[i][0].fused(s[0][j], g[i][1].fused(s[1][j], g[i][2].fused(s[2][j], s[i][j])));
        [column(0), column(1), column(2)]
    };
    [row(0), row(1), row(2)]
}

/// How the volume changes with F = Id + G, without the cancellation of det F - 1 at small strain.
#[derive(Clone, Copy)]
pub(super) struct VolumeChange<V> {
    /// J - 1 = tr G + tr cof G + det G.
    pub(super) growth: V,
    /// H = cof F - Id = (tr G) Id - G^T + cof G; cof F = dJ/dF.
    pub(super) cofactor_growth: Matrix<V>,
}

impl<V: Lanes> VolumeChange<V> {
    #[inline(always)]
    pub(super) fn of(g: &Matrix<V>) -> Self {
        let cofactor = |i: usize, j: usize| {
            let (r, s) = ((i + 1) % 3, (i + 2) % 3);
            let (c, d) = ((j + 1) % 3, (j + 2) % 3);
            g[r][c].fused(g[s][d], g[r][d].times(g[s][c]).negative())
        };
        let row = |i: usize| [cofactor(i, 0), cofactor(i, 1), cofactor(i, 2)];
        let c = [row(0), row(1), row(2)];
        let trace = g[0][0].plus(g[1][1]).plus(g[2][2]);
        let determinant = g[0][0].fused(c[0][0], g[0][1].fused(c[0][1], g[0][2].times(c[0][2])));
        let growth = trace.plus(c[0][0].plus(c[1][1]).plus(c[2][2])).plus(determinant);
        let diagonal = |i: usize| trace.minus(g[i][i]).plus(c[i][i]);
        let off = |i: usize, j: usize| c[i][j].minus(g[j][i]);
        let cofactor_growth = [
            [diagonal(0), off(0, 1), off(0, 2)],
            [off(1, 0), diagonal(1), off(1, 2)],
            [off(2, 0), off(2, 1), diagonal(2)],
        ];
        Self { growth, cofactor_growth }
    }
}

/// G from d_1, d_2, d_3 and the gradients alpha_1, alpha_2, alpha_3 (each x, y, z).
#[inline(always)]
pub(super) fn displacement_gradient<V: Lanes>(d: &[[V; 3]; 3], alpha: &[[V; 3]; 3]) -> Matrix<V> {
    let entry = |i: usize, j: usize| {
        d[0][i].fused(alpha[0][j], d[1][i].fused(alpha[1][j], d[2][i].times(alpha[2][j])))
    };
    [
        [entry(0, 0), entry(0, 1), entry(0, 2)],
        [entry(1, 0), entry(1, 1), entry(1, 2)],
        [entry(2, 0), entry(2, 1), entry(2, 2)],
    ]
}

/// f_1, f_2, f_3 from V P and the gradients alpha_1, alpha_2, alpha_3 (each x, y, z).
#[inline(always)]
pub(super) fn corner_forces<V: Lanes>(p: &Matrix<V>, alpha: &[[V; 3]; 3]) -> [[V; 3]; 3] {
    let force = |k: usize, i: usize| {
        p[i][0].fused(alpha[k][0], p[i][1].fused(alpha[k][1], p[i][2].times(alpha[k][2])))
    };
    [
        [force(0, 0), force(0, 1), force(0, 2)],
        [force(1, 0), force(1, 1), force(1, 2)],
        [force(2, 0), force(2, 1), force(2, 2)],
    ]
}
