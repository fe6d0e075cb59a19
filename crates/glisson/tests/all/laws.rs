//! Every law by one check: stress = dW/dF and its differential by central differences, zero at rest, rotation
//! invariance, a symmetric tangent, a projected tangent without negative eigenvalue.

use glisson::material::{
    LinearElastic, Material, MaterialSpec, NeoHookeLog, StVenantKirchhoff, Tangent, projected,
};
use glisson::math::{DMat3, DVec3, SeededRandom, outer};

/// A law and where it is checked.
struct Case {
    spec: MaterialSpec,
    /// Scale of its stresses [Pa].
    modulus_pa: f64,
    rotation_invariant: bool,
    /// Whether F may be inverted.
    inverts: bool,
}

fn cases() -> Vec<Case> {
    let linear = LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap();
    let case = |spec| Case { spec, modulus_pa: 5000.0, rotation_invariant: true, inverts: false };
    vec![
        Case { rotation_invariant: false, inverts: true, ..case(MaterialSpec::Linear(linear)) },
        Case { inverts: true, ..case(MaterialSpec::StVenantKirchhoff(StVenantKirchhoff::from(&linear))) },
        case(MaterialSpec::NeoHookeLog(NeoHookeLog::from(&linear))),
    ]
}

/// Shears, stretches and swellings of up to about 50 %, in no special direction; equal and nearly equal
/// stretches; inverted ones where the law has them.
fn gradients(inverts: bool) -> Vec<DMat3> {
    let mut random = SeededRandom::new(7);
    let mut all = vec![
        DMat3::IDENTITY,
        DMat3::IDENTITY * 1.2,
        DMat3::from_diagonal(DVec3::new(1.3, 1.3, 0.8)),
        DMat3::from_diagonal(DVec3::new(1.3, 1.3 + 1e-9, 0.8)),
        DMat3::from_diagonal(DVec3::new(0.9, 1.1, 1.0 / 0.99)) + outer(DVec3::X, DVec3::Z) * 0.4,
    ];
    for _ in 0..12 {
        let noise = DMat3::from_cols_array(&std::array::from_fn(|_| random.uniform_in(-0.3, 0.3)));
        all.push(DMat3::IDENTITY + noise);
    }
    if inverts {
        all.push(DMat3::from_diagonal(DVec3::new(1.1, -0.6, 0.9)));
        all.push(DMat3::from_diagonal(DVec3::new(0.8, 1.0, 0.0)));
    }
    all
}

fn random_matrix(random: &mut SeededRandom) -> DMat3 {
    DMat3::from_cols_array(&std::array::from_fn(|_| random.normal()))
}

fn random_rotation(random: &mut SeededRandom) -> DMat3 {
    let axis = DVec3::new(random.normal(), random.normal(), random.normal()).normalize();
    DMat3::from_axis_angle(axis, random.uniform_in(0.5, 6.0))
}

fn dot(a: &DMat3, b: &DMat3) -> f64 {
    a.to_cols_array().iter().zip(b.to_cols_array()).map(|(x, y)| x * y).sum()
}

fn norm(a: &DMat3) -> f64 {
    dot(a, a).sqrt()
}

fn times(tangent: &Tangent, df: &DMat3) -> DMat3 {
    let entries = df.to_cols_array();
    DMat3::from_cols_array(&std::array::from_fn(|i| (0..9).map(|j| tangent[i][j] * entries[j]).sum()))
}

/// Step of the central differences: error about h^2 of truncation and 1e-16/h of rounding.
const STEP: f64 = 1e-5;
/// Allowed share of the stress scale.
const DIFFERENCE_TOLERANCE: f64 = 1e-7;

fn check(case: &Case) {
    let name = case.spec.name();
    let law = case.spec.material();
    let scale_pa = case.modulus_pa;
    let rest_pa = norm(&law.first_piola_pa(&DMat3::IDENTITY));
    assert!(rest_pa <= 1e-12 * scale_pa, "{name}: {rest_pa} Pa at rest");
    assert!(
        law.energy_density_j_per_m3(&DMat3::IDENTITY).abs() <= 1e-12 * scale_pa,
        "{name}: energy at rest"
    );
    let mut random = SeededRandom::new(8);
    for f in gradients(case.inverts) {
        let stress = law.first_piola_pa(&f);
        let tangent = law.tangent_pa(&f);
        let tangent_scale =
            tangent.iter().flatten().map(|x| x.abs()).fold(0.0, f64::max).max(norm(&stress)).max(scale_pa);
        for _ in 0..3 {
            let df = random_matrix(&mut random);
            let (ahead, behind) = (f + df * STEP, f - df * STEP);
            let slope =
                (law.energy_density_j_per_m3(&ahead) - law.energy_density_j_per_m3(&behind)) / (2.0 * STEP);
            let off = (slope - dot(&stress, &df)).abs();
            assert!(off <= DIFFERENCE_TOLERANCE * tangent_scale, "{name}: dW off by {off} at {f}");
            let change = (law.first_piola_pa(&ahead) - law.first_piola_pa(&behind)) * (0.5 / STEP);
            let differential = law.first_piola_differential_pa(&f, &df);
            let off = norm(&(change - differential));
            assert!(off <= DIFFERENCE_TOLERANCE * tangent_scale, "{name}: dP off by {off} at {f}");
            assert!(norm(&(times(&tangent, &df) - differential)) <= 1e-11 * tangent_scale, "{name}: tangent");
            if case.rotation_invariant {
                let q = random_rotation(&mut random);
                let w = law.energy_density_j_per_m3(&f);
                let turned = q * f;
                assert!(
                    (law.energy_density_j_per_m3(&turned) - w).abs() <= 1e-10 * scale_pa,
                    "{name}: W(QF)"
                );
                let off = norm(&(law.first_piola_pa(&turned) - q * stress));
                assert!(off <= 1e-10 * tangent_scale, "{name}: P(QF) off by {off}");
            }
        }
        check_projection(name, law, &f, &tangent, tangent_scale);
    }
}

fn check_projection(name: &str, law: &dyn Material, f: &DMat3, tangent: &Tangent, scale: f64) {
    let filtered = law.projected_tangent_pa(f);
    let nearest = projected(tangent);
    for i in 0..9 {
        for j in 0..9 {
            assert!((tangent[i][j] - tangent[j][i]).abs() <= 1e-11 * scale, "{name}: tangent not symmetric");
            let off = (filtered[i][j] - nearest[i][j]).abs();
            assert!(off <= 1e-9 * scale, "{name}: closed form and Jacobi differ by {off} at {i} {j} of {f}");
        }
    }
    // No negative eigenvalue: a Cholesky factorization of the shifted matrix goes through.
    let mut l = filtered;
    for k in 0..9 {
        l[k][k] += 1e-9 * scale;
    }
    for j in 0..9 {
        for k in 0..j {
            for i in j..9 {
                l[i][j] -= l[i][k] * l[j][k];
            }
        }
        assert!(l[j][j] > 0.0, "{name}: pivot {} at {f}", l[j][j]);
        let root = l[j][j].sqrt();
        for i in j..9 {
            l[i][j] /= root;
        }
    }
}

#[test]
fn every_law_passes_the_derivative_check() {
    for case in cases() {
        check(&case);
    }
}
