//! Any law of [`crate::material`], one lane after the other: the layout, exchange and threads of the kernel with the stress
//! of the law itself.

use std::sync::Arc;

use super::element::{At, ElementLaw, Matrix};
use super::lanes::Lanes;
use super::rows::N_LANES;
use crate::material::Material;
use glisson_mesh::math::DMat3;

/// A law that the kernel's tasks share.
pub type SharedMaterial = Arc<dyn Material + Send + Sync>;

/// [`super::KernelLaw::General`].
pub(super) struct General<'a> {
    pub(super) laws: &'a [SharedMaterial],
    /// Which law, for each lane of each block.
    pub(super) law_of: &'a [[u32; N_LANES]],
}

impl ElementLaw for General<'_> {
    /// V and zero.
    fn numbers(volume_m3: f64, _: f64, _: f64) -> [f64; 2] {
        [volume_m3, 0.0]
    }

    fn lame_of_volume(&self, [volume_m3, _]: [f64; 2], at: At) -> [f64; 2] {
        let law = &self.laws[self.law_of[at.block][at.lane] as usize];
        law.lame_at_rest_pa().map(|modulus_pa| volume_m3 * modulus_pa)
    }

    #[inline(always)]
    fn scaled_stress<V: Lanes>(&self, g: &Matrix<V>, [volume, _]: [V; 2], at: At) -> Matrix<V> {
        let mut numbers = [[[0.0; N_LANES]; 3]; 3];
        let mut volumes_m3 = [0.0; N_LANES];
        for i in 0..3 {
            for j in 0..3 {
                g[i][j].store(&mut numbers[i][j], 0);
            }
        }
        volume.store(&mut volumes_m3, 0);
        self.stresses(&mut numbers, &volumes_m3[..V::COUNT], at);
        let row = |i: usize| {
            let load = |j: usize| volume.load(&numbers[i][j], 0);
            [load(0), load(1), load(2)]
        };
        [row(0), row(1), row(2)]
    }
}

impl General<'_> {
    /// Replaces G by V P. A lane without a tetrahedron has no stress.
    #[inline(never)]
    fn stresses(&self, numbers: &mut [[[f64; N_LANES]; 3]; 3], volumes_m3: &[f64], at: At) {
        for (lane, &volume_m3) in volumes_m3.iter().enumerate() {
            let mut stress = DMat3::ZERO;
            if volume_m3 > 0.0 {
                let law = self.law_of[at.block][at.lane + lane];
                let column = |j: usize| [numbers[0][j][lane], numbers[1][j][lane], numbers[2][j][lane]];
                let gradient = DMat3::from_cols_array_2d(&[column(0), column(1), column(2)]);
                stress = self.laws[law as usize].first_piola_pa(&(DMat3::IDENTITY + gradient)) * volume_m3;
            }
            for (j, column) in stress.to_cols_array_2d().into_iter().enumerate() {
                for (i, entry) in column.into_iter().enumerate() {
                    numbers[i][j][lane] = entry;
                }
            }
        }
    }
}
