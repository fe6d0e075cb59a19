//! The force of one tetrahedron, in any number of lanes.
//!
//! With the displacements d_k = u_k - u_0 and shape gradients alpha_k, k = 1, 2, 3, the displacement gradient
//! is G = sum_k d_k (x) alpha_k. A law gives the first Piola-Kirchhoff stress times the rest volume, V P(G);
//! the forces that balance the deformation are f_k = V P alpha_k and f_0 = -(f_1 + f_2 + f_3)
//! (seed `002`, eq. 5 to 9, before its expansion into tensors).
//!
//! The material comes as two numbers, V lambda / 2 and V mu. From displacements rather than positions: nothing
//! cancels at small strain, and a body at rest has forces that are exactly zero.

use super::lanes::Lanes;

/// Three by three numbers, `[row][column]`.
pub(super) type Matrix<V> = [[V; 3]; 3];

/// A stress-strain law, chosen outside the loop over the elements.
pub(super) trait ElementLaw {
    /// V P for the displacement gradient `g` and the material (V lambda / 2, V mu).
    fn scaled_stress<V: Lanes>(g: &Matrix<V>, material: [V; 2]) -> Matrix<V>;
}

/// Hooke's law with the small strain: P = lambda tr(e) Id + 2 mu e, e = (G + G^T) / 2.
pub(super) struct Linear;

impl ElementLaw for Linear {
    #[inline(always)]
    fn scaled_stress<V: Lanes>(g: &Matrix<V>, [half_lambda, mu]: [V; 2]) -> Matrix<V> {
        let twice = [g[0][0].plus(g[0][0]), g[1][1].plus(g[1][1]), g[2][2].plus(g[2][2])];
        let pressure = half_lambda.times(twice[0].plus(twice[1]).plus(twice[2]));
        let xy = mu.times(g[0][1].plus(g[1][0]));
        let xz = mu.times(g[0][2].plus(g[2][0]));
        let yz = mu.times(g[1][2].plus(g[2][1]));
        [
            [mu.fused(twice[0], pressure), xy, xz],
            [xy, mu.fused(twice[1], pressure), yz],
            [xz, yz, mu.fused(twice[2], pressure)],
        ]
    }
}

/// St Venant-Kirchhoff: P = F S, S = lambda tr(E) Id + 2 mu E, F = Id + G, 2 E = G + G^T + G^T G.
pub(super) struct StVenantKirchhoff;

impl ElementLaw for StVenantKirchhoff {
    #[inline(always)]
    fn scaled_stress<V: Lanes>(g: &Matrix<V>, [half_lambda, mu]: [V; 2]) -> Matrix<V> {
        let twice_strain = |i: usize, j: usize| {
            let linear = g[i][j].plus(g[j][i]);
            g[0][i].fused(g[0][j], g[1][i].fused(g[1][j], g[2][i].fused(g[2][j], linear)))
        };
        let [xx, yy, zz] = [twice_strain(0, 0), twice_strain(1, 1), twice_strain(2, 2)];
        let pressure = half_lambda.times(xx.plus(yy).plus(zz));
        let [xx, yy, zz] = [mu.fused(xx, pressure), mu.fused(yy, pressure), mu.fused(zz, pressure)];
        let xy = mu.times(twice_strain(0, 1));
        let xz = mu.times(twice_strain(0, 2));
        let yz = mu.times(twice_strain(1, 2));
        let s = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let row = |i: usize| {
            let column =
                |j: usize| g[i][0].fused(s[0][j], g[i][1].fused(s[1][j], g[i][2].fused(s[2][j], s[i][j])));
            [column(0), column(1), column(2)]
        };
        [row(0), row(1), row(2)]
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
