//! Indentation by a sphere and a flat punch: a graded block of tetrahedra under the library's solver of contacts against the
//! layer's own axisymmetric solution, that against Hertz, Sneddon and the series of Dimitriadis.

pub(super) mod axisymmetric;
pub(super) mod block;
mod contact;

use super::{Experiment, Outcome};
use axisymmetric::Layer;
use block::{BlockTop, Elements, Grading};
use contact::{by_constraints, unilateral};
use glisson::material::LinearElastic;
use glisson::solve::NodeAveraging;
use std::f64::consts::PI;

const YOUNG_MODULUS_PA: f64 = 3000.0;
const POISSON_RATIOS: [f64; 2] = [0.45, 0.49];
/// Linear statics: the density does not count.
const DENSITY_KG_PER_M3: f64 = 1000.0;

/// C1 and C2 of the benchmarks: a sphere of 5 mm and a flat punch of 5 mm, pressed in by 1 mm.
const INDENTER_RADIUS_M: f64 = 5e-3;
const DEPTH_M: f64 = 1e-3;
/// Depth of the layer, and its radius or half the side of the block, in contact radii.
const LAYER_RADII: f64 = 10.0;
const WIDTH_RADII: f64 = 40.0;

/// Rectangles to a contact radius.
const FINE: f64 = 24.0;

const FINITE: &str = "own axisymmetric solution of the bonded layer (validate/indentation/axisymmetric.rs)";
const SERIES: &str = "Dimitriadis et al. 2002, Biophys. J. 82, series for a bonded layer";
const HERTZ: &str = "Hertz: F = 4/3 E/(1 - nu^2) R^(1/2) d^(3/2)";
const SNEDDON: &str = "Boussinesq, Sneddon: F = 2 a d E/(1 - nu^2)";

#[derive(Clone, Copy, Debug, PartialEq)]
enum Indenter {
    Sphere,
    FlatPunch,
}

impl Indenter {
    fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::FlatPunch => "flat punch",
        }
    }

    /// On a half-space.
    fn contact_radius_m(self) -> f64 {
        match self {
            Self::Sphere => (INDENTER_RADIUS_M * DEPTH_M).sqrt(),
            Self::FlatPunch => INDENTER_RADIUS_M,
        }
    }

    fn half_space_n(self, nu: f64) -> f64 {
        let reduced_pa = YOUNG_MODULUS_PA / (1.0 - nu * nu);
        match self {
            Self::Sphere => 4.0 / 3.0 * reduced_pa * INDENTER_RADIUS_M.sqrt() * DEPTH_M.powf(1.5),
            Self::FlatPunch => 2.0 * INDENTER_RADIUS_M * DEPTH_M * reduced_pa,
        }
    }

    /// How far its foot lies below the upper side [m].
    fn foot_m(self, radius_m: f64) -> f64 {
        match self {
            Self::Sphere => DEPTH_M - 0.5 * radius_m * radius_m / INDENTER_RADIUS_M,
            // A node on the edge is under the punch.
            Self::FlatPunch if radius_m <= INDENTER_RADIUS_M * (1.0 + 1e-9) => DEPTH_M,
            Self::FlatPunch => f64::NEG_INFINITY,
        }
    }

    /// On a round layer, with so many rectangles to a contact radius, so many contact radii deep and wide.
    fn on_layer_n(self, nu: f64, per_radius: f64, [deep, wide]: [f64; 2]) -> anyhow::Result<f64> {
        let a_m = self.contact_radius_m();
        let layer = Layer {
            radii_m: self.radii(per_radius, 1.25, wide),
            depths_m: graded(a_m / per_radius, 1.3, deep * a_m),
            young_modulus_pa: YOUNG_MODULUS_PA,
            poisson_ratio: nu,
            nodule: None,
        };
        let top = layer.upper_side(1.5 * a_m)?;
        match self {
            Self::Sphere => Ok(top.sphere(INDENTER_RADIUS_M, DEPTH_M)?.0),
            Self::FlatPunch => top.flat_punch_n(INDENTER_RADIUS_M, DEPTH_M),
        }
    }

    /// Radii of rings, `per_radius` within each contact radius (finer towards the edge of a punch), to 1.5 contact radii and
    /// growing from there.
    fn radii(self, per_radius: f64, growth: f64, radii_wide: f64) -> Vec<f64> {
        let a_m = self.contact_radius_m();
        let step_m = a_m / per_radius;
        let mut radii_m = vec![0.0];
        match self {
            Self::Sphere => {
                let n = (1.5 * per_radius).round() as usize;
                radii_m.extend((1..=n).map(|k| k as f64 * step_m));
            }
            Self::FlatPunch => {
                // The pressure has a singular edge: steps are divided by two towards it, from both sides.
                let n = (per_radius / 1.5).round() as usize;
                let coarse_m = a_m * (1.0 - 1.0 / per_radius);
                radii_m.extend((1..=n).map(|k| coarse_m * k as f64 / n as f64));
                let near = [0.5, 0.25, 0.1];
                radii_m.extend(near.map(|s| a_m - s * step_m));
                radii_m.push(a_m);
                radii_m.extend([0.1, 0.25, 0.5, 1.0, 2.0].map(|s| a_m + s * step_m));
            }
        }
        let start_m = radii_m[radii_m.len() - 1];
        let last_m = start_m - radii_m[radii_m.len() - 2];
        let rest_m = graded(last_m * growth, growth, radii_wide * a_m - start_m);
        radii_m.extend(rest_m[1..].iter().map(|r| start_m + r));
        radii_m
    }

    fn on_block(self, nu: f64, elements: Elements) -> anyhow::Result<OnBlock> {
        let a_m = self.contact_radius_m();
        let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, nu, DENSITY_KG_PER_M3)?;
        let grading = Grading {
            radii_m: self.radii(6.0, 1.5, WIDTH_RADII),
            depths_m: graded(a_m / 8.0, 1.45, LAYER_RADII * a_m),
            fine_m: a_m / 6.0,
            round_m: 1.5 * a_m,
        };
        let top = grading.top(&material, elements, 1.4 * a_m)?;
        let wanted_m: Vec<f64> = top.radii_m.iter().map(|r| self.foot_m(*r)).collect();
        let (forces_n, report) = by_constraints(&top.compliance_m_per_n, &wanted_m);
        let active_set_n = unilateral(&top.compliance_m_per_n, &wanted_m)?;
        let largest_n = active_set_n.iter().fold(0.0_f64, |most, f| most.max(*f));
        let off_n = forces_n.iter().zip(&active_set_n).map(|(f, g)| (f - g).abs()).fold(0.0, f64::max);
        Ok(OnBlock {
            // Four quarters.
            force_n: 4.0 * forces_n.iter().sum::<f64>(),
            off_share: off_n / largest_n,
            n_sweeps: report.n_sweeps,
            n_in_contact: forces_n.iter().filter(|f| **f > 0.0).count(),
            top,
        })
    }
}

/// An indenter on the block of tetrahedra.
struct OnBlock {
    /// By the library's solver of contacts [N].
    force_n: f64,
    /// Largest difference of a node's force from that of the active-set iteration, over the largest force.
    off_share: f64,
    n_sweeps: u32,
    /// Nodes of the quarter that carry.
    n_in_contact: usize,
    top: BlockTop,
}

/// Borders from 0 to exactly `end`, the first step about `first`, each longer by `growth`.
pub(super) fn graded(first: f64, growth: f64, end: f64) -> Vec<f64> {
    let n = ((1.0 + end / first * (growth - 1.0)).ln() / growth.ln()).ceil().max(1.0);
    let sum = (growth.powf(n) - 1.0) / (growth - 1.0);
    let (mut borders, mut step) = (vec![0.0], end / sum);
    for k in 1..n as usize {
        borders.push(borders[k - 1] + step);
        step *= growth;
    }
    borders.push(end);
    borders
}

/// How much stiffer a layer bonded to its base is under a sphere (a paraboloid), with x = sqrt(R d)/h. No source of the
/// coefficients was at hand to check them against; that our own solution agrees is what speaks for both.
fn dimitriadis(nu: f64, x: f64) -> f64 {
    let alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu * nu) / (1.0 - nu);
    let beta = (0.6387 - 1.0277 * nu + 1.5164 * nu * nu) / (1.0 - nu);
    let pi = PI;
    1.0 - 2.0 * alpha / pi * x + 4.0 * alpha.powi(2) / pi.powi(2) * x.powi(2)
        - 8.0 / pi.powi(3) * (alpha.powi(3) + 4.0 * pi.powi(2) / 15.0 * beta) * x.powi(3)
        + 16.0 * alpha / pi.powi(4) * (alpha.powi(3) + 3.0 * pi.powi(2) / 5.0 * beta) * x.powi(4)
}

/// An indenter on tissue of one Poisson's ratio: forces [N] by every solution.
struct Measured {
    indenter: Indenter,
    nu: f64,
    half_space_n: f64,
    /// Axisymmetric, on a layer 200 radii deep, and on the bonded one.
    deep_n: f64,
    layer_n: f64,
    block: OnBlock,
}

impl Measured {
    fn new(indenter: Indenter, nu: f64) -> anyhow::Result<Self> {
        Ok(Self {
            indenter,
            nu,
            half_space_n: indenter.half_space_n(nu),
            deep_n: indenter.on_layer_n(nu, FINE, [200.0, 200.0])?,
            layer_n: indenter.on_layer_n(nu, FINE, [LAYER_RADII, WIDTH_RADII])?,
            block: indenter.on_block(nu, Elements::Averaged(NodeAveraging::STRAIN))?,
        })
    }

    fn check(&self) -> Vec<Experiment> {
        let Self { indenter, nu, half_space_n, deep_n, layer_n, block } = self;
        let title = |what: &str| format!("{}, nu {nu}: {what}", indenter.name());
        let source = if *indenter == Indenter::Sphere { HERTZ } else { SNEDDON };
        let mut experiments = vec![Experiment::near(
            &title("axisymmetric solution on a layer 200 radii deep [mN]"),
            source,
            1e3 * deep_n,
            1e3 * half_space_n,
            0.015,
        )];
        if *indenter == Indenter::Sphere {
            experiments.push(Experiment::near(
                &title("axisymmetric bonded layer over half-space"),
                SERIES,
                layer_n / half_space_n,
                dimitriadis(*nu, 1.0 / LAYER_RADII),
                0.015,
            ));
        }
        experiments.extend([
            Experiment::near(
                &title("force on the block of tetrahedra [mN]"),
                FINITE,
                1e3 * block.force_n,
                1e3 * layer_n,
                0.05,
            ),
            Experiment::at_most(
                &title("contact::constraint::solve against an active-set iteration, worst node"),
                "own active-set iteration (validate/indentation/contact.rs)",
                block.off_share,
                1e-6,
            ),
        ]);
        experiments
    }

    /// Its line of the table; `plain_n` is the force on the block of plain tetrahedra [N].
    fn row(&self, plain_n: f64) -> String {
        format!(
            "| {} | {} | {:.3} | {:.3} | {:.3} | {} | {} | {} | {:.3} |\n",
            self.indenter.name(),
            self.nu,
            1e3 * self.half_space_n,
            1e3 * self.layer_n,
            1e3 * self.block.force_n,
            4 * self.block.top.n_tets,
            self.block.n_in_contact,
            self.block.n_sweeps,
            1e3 * plain_n,
        )
    }
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let notes = format!(
        "E = {YOUNG_MODULUS_PA} Pa, indenters of 5 mm radius pressed in by 1 mm without friction, linear. The layer is {LAYER_RADII} contact \
         radii deep and bonded to its base; the block is square and eight times as wide as deep, its sides free. The tetrahedra under the indenter \
         have edges of a sixth of the contact radius.\n\n\
         | indenter | nu | half-space [mN] | bonded layer [mN] | block [mN] | tetrahedra | nodes of a quarter in contact | sweeps | block of plain tetrahedra [mN] |\n\
         |---|---|---|---|---|---|---|---|---|\n"
    );
    let mut outcome = Outcome { notes, ..Outcome::default() };
    for indenter in [Indenter::Sphere, Indenter::FlatPunch] {
        for nu in POISSON_RATIOS {
            let measured = Measured::new(indenter, nu)?;
            outcome.experiments.extend(measured.check());
            let plain_n = indenter.on_block(nu, Elements::Plain)?.force_n;
            outcome.notes += &measured.row(plain_n);
        }
    }
    Ok(outcome)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_grow_and_end_where_they_should() {
        let borders = graded(0.1, 1.5, 4.0);
        assert!(borders[0] == 0.0 && borders[borders.len() - 1] == 4.0 && borders.is_sorted());
        assert!(borders[1] <= 0.1 && borders[1] > 0.05);
        for indenter in [Indenter::Sphere, Indenter::FlatPunch] {
            let radii_m = indenter.radii(6.0, 1.5, 10.0);
            assert!(radii_m.windows(2).all(|p| p[1] > p[0]), "{radii_m:?}");
            assert!(radii_m.contains(&indenter.contact_radius_m()) || indenter == Indenter::Sphere);
        }
    }

    #[test]
    fn a_deep_layer_answers_like_a_half_space() {
        for indenter in [Indenter::Sphere, Indenter::FlatPunch] {
            let found_n = indenter.on_layer_n(0.45, 8.0, [80.0, 80.0]).unwrap();
            let exact_n = indenter.half_space_n(0.45);
            assert!((found_n - exact_n).abs() < 0.025 * exact_n, "{indenter:?}: {found_n} {exact_n}");
        }
    }
}
