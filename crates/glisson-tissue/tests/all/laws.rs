//! Every law by one check: stress = dW/dF and its differential by central differences, zero at rest, rotation
//! invariance, a symmetric tangent, a projected tangent without negative eigenvalue.

use glisson_mesh::math::{DMat3, DVec3, SeededRandom, outer};
use glisson_tissue::material::{
    HolzapfelGasserOgden, HolzapfelGasserOgdenParameters, LAWS, LawChoice, LawKeyKind, LinearElastic,
    Material, MaterialSpec, MooneyRivlin, NeoHookeLog, Ogden, OgdenTerm, PronySeries, PronyTerm,
    StableNeoHooke, Tangent, Typical, every_law, law_names, projected,
};

/// A law and where it is checked.
struct Case {
    spec: MaterialSpec,
    /// Scale of its stresses [Pa].
    modulus_pa: f64,
    rotation_invariant: bool,
    /// Whether F may be inverted.
    inverts: bool,
    /// Whether the tangent jumps at rest (fibres that pull only): no differences are taken there.
    jumps_at_rest: bool,
    /// Whether the projected tangent is the nearest one (of all isotropic laws).
    nearest: bool,
    /// Whether its small strains are those of [`liver`].
    from_liver: bool,
}

fn liver() -> LinearElastic {
    LinearElastic::from_young_poisson(5000.0, 0.45, 1060.0).unwrap()
}

fn cases() -> Vec<Case> {
    let linear = liver();
    let case = |spec| Case {
        spec,
        modulus_pa: 5000.0,
        rotation_invariant: true,
        inverts: false,
        jumps_at_rest: false,
        nearest: true,
        from_liver: true,
    };
    let two_terms = [OgdenTerm { mu_pa: 842.0, exponent: -4.7 }, OgdenTerm { mu_pa: 300.0, exponent: 2.5 }];
    let fibres = HolzapfelGasserOgden::new(&HolzapfelGasserOgdenParameters {
        matrix_shear_pa: 1500.0,
        fibre_stiffness_pa: 3000.0,
        fibre_exponent: 1.5,
        dispersion: 0.1,
        fibre_directions: vec![DVec3::new(1.0, 2.0, -0.5), DVec3::new(1.0, -1.0, 0.3)],
        bulk_pa: 20_000.0,
    });
    let with_fibres = |spec| Case { jumps_at_rest: true, nearest: false, from_liver: false, ..case(spec) };
    // A law of the table that is not named here is taken to be isotropic, free to turn, and infinite when inverted.
    let of_table = every_law(&linear).unwrap().into_iter().map(|spec| match spec.name() {
        "linear" => Case { rotation_invariant: false, inverts: true, ..case(spec) },
        "st_venant_kirchhoff" | "stable_neo_hooke" => Case { inverts: true, ..case(spec) },
        "holzapfel_gasser_ogden" => with_fibres(spec),
        _ => case(spec),
    });
    let two_terms = MaterialSpec::from(Ogden::new(&two_terms, 20_000.0).unwrap());
    let others =
        [Case { from_liver: false, ..case(two_terms) }, with_fibres(MaterialSpec::from(fibres.unwrap()))];
    of_table.chain(others).collect()
}

/// Shears, stretches and swellings of up to about 50 %, in no special direction; equal and nearly equal
/// stretches; inverted ones where the law has them.
fn gradients(inverts: bool) -> Vec<DMat3> {
    let mut random = SeededRandom::new(7);
    let mut all = vec![
        // First, so that it can be left out.
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
    for f in gradients(case.inverts).into_iter().skip(usize::from(case.jumps_at_rest)) {
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
        check_projection(case, &f, &tangent, tangent_scale);
    }
}

fn check_projection(case: &Case, f: &DMat3, tangent: &Tangent, scale: f64) {
    let name = case.spec.name();
    let filtered = case.spec.material().projected_tangent_pa(f);
    let nearest = projected(tangent);
    for i in 0..9 {
        for j in 0..9 {
            assert!((tangent[i][j] - tangent[j][i]).abs() <= 1e-11 * scale, "{name}: tangent not symmetric");
            let off = (filtered[i][j] - nearest[i][j]).abs();
            assert!(
                !case.nearest || off <= 1e-9 * scale,
                "{name}: closed form and Jacobi differ by {off} at {i} {j} of {f}"
            );
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

#[test]
fn every_name_is_a_law_and_every_law_has_a_name() {
    let found: Vec<&str> = cases().iter().map(|c| c.spec.name()).collect();
    for name in law_names() {
        assert!(found.contains(&name), "{name} is not checked");
    }
    assert!(found.iter().all(|name| law_names().any(|known| known == *name)));
}

/// Names and keys are there once, every law has its source, and every default and example value is allowed.
#[test]
fn the_table_of_laws_is_sound() {
    let is_name = |text: &str| {
        let is_part = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_';
        !text.is_empty() && text.bytes().all(is_part)
    };
    for (place, law) in LAWS.iter().enumerate() {
        let name = law.name;
        assert!(is_name(name) && law_names().position(|other| other == name) == Some(place), "{name}");
        assert!(!law.about.is_empty() && law.source.bytes().any(|b| b.is_ascii_digit()), "{name}");
        assert_eq!(law.keys.is_empty(), law.example.is_empty(), "{name}");
        for (place, key) in law.keys.iter().enumerate() {
            let first = law.keys.iter().position(|other| other.name == key.name);
            assert!(is_name(key.name) && first == Some(place), "{name} {}", key.name);
            let is_directions = key.kind == LawKeyKind::Directions;
            assert_eq!(matches!(key.typical, Typical::Directions(_)), is_directions, "{name} {}", key.name);
            if let LawKeyKind::Number(Some(default)) = key.kind {
                assert!((key.range.holds)(default), "{name} {}", key.name);
            }
        }
        let typical = LawChoice::typical(law);
        assert!(typical.missing().is_none(), "{name}");
        assert_eq!(typical.with_moduli_of(&liver()).unwrap().name(), name);
    }
}

/// The table and the law itself allow the same numbers.
#[test]
fn the_ranges_of_the_table_are_those_of_the_laws() {
    let tried = [
        -1e9,
        -4.7,
        -1.0,
        -1e-9,
        0.0,
        1e-9,
        0.2,
        1.0 / 3.0,
        0.34,
        1.0,
        1.1,
        4.7,
        1e9,
        f64::NAN,
        f64::INFINITY,
    ];
    let mut n_refused = 0;
    for law in LAWS {
        for key in law.keys.iter().filter(|key| key.kind != LawKeyKind::Directions) {
            for number in tried {
                let made = LawChoice::typical(law).with_number(key.name, number).with_moduli_of(&liver());
                let is_allowed = (key.range.holds)(number);
                assert_eq!(made.is_ok(), is_allowed, "{} {} {number}: {:?}", law.name, key.name, made.err());
                n_refused += u32::from(!is_allowed);
            }
        }
    }
    assert!(n_refused > 20);
}

/// docs/models.md and docs/scene.md name every law, docs/scene.md every key.
#[test]
fn the_documentation_names_every_law_and_key() {
    let read = |name: &str| {
        std::fs::read_to_string(format!("{}/../../docs/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    };
    let (models, scene) = (read("models.md"), read("scene.md"));
    for law in LAWS {
        assert!(models.contains(&format!("| `{}` |", law.name)), "{} in docs/models.md", law.name);
        assert!(scene.contains(&format!("`{}`", law.name)), "{} in docs/scene.md", law.name);
        for key in law.keys {
            assert!(scene.contains(key.name), "{} of {} in docs/scene.md", key.name, law.name);
        }
    }
}

#[test]
fn at_small_strain_every_law_is_hookes() {
    let hooke = liver().tangent_pa(&DMat3::IDENTITY);
    for case in cases().iter().filter(|c| c.from_liver) {
        let tangent = case.spec.material().tangent_pa(&DMat3::IDENTITY);
        for i in 0..9 {
            for j in 0..9 {
                let off = (tangent[i][j] - hooke[i][j]).abs();
                assert!(off <= 1e-11 * hooke[0][0], "{}: {i} {j} off by {off} Pa", case.spec.name());
            }
        }
    }
}

#[test]
fn stable_neo_hooke_pushes_back_from_every_inverted_state() {
    let law = StableNeoHooke::from(&liver());
    let mut last = f64::INFINITY;
    for step in 0..=40 {
        // From inside out through flat to rest the energy falls.
        let s = -1.0 + 0.05 * f64::from(step);
        let energy = law.energy_density_j_per_m3(&DMat3::from_diagonal(DVec3::new(s, 1.0, 1.0)));
        assert!(energy.is_finite() && energy < last, "{s}: {energy} after {last}");
        last = energy;
    }
    assert_eq!(NeoHookeLog::from(&liver()).energy_density_j_per_m3(&DMat3::ZERO), f64::INFINITY);
}

/// Nominal stress [Pa] of a stretched bar with free sides: the lateral stretch that leaves them without stress
/// is found by bisection.
fn uniaxial_pa(law: &dyn Material, stretch: f64) -> f64 {
    let stress = |t: f64| law.first_piola_pa(&DMat3::from_diagonal(DVec3::new(stretch, t, t)));
    let (mut low, mut high) = (0.9 / stretch.sqrt(), 1.1 / stretch.sqrt());
    assert!(stress(low).y_axis.y < 0.0 && stress(high).y_axis.y > 0.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if stress(middle).y_axis.y < 0.0 { low = middle } else { high = middle }
    }
    stress(0.5 * (low + high)).x_axis.x
}

const STRETCHES: [f64; 7] = [0.5, 0.7, 0.8, 0.9, 1.1, 1.25, 1.5];

/// Uniaxial nominal stress of incompressible bodies, closed forms; ours have Poisson's ratio 0.4999.
#[test]
fn stretched_bars_carry_the_closed_form_stress() {
    let nearly_incompressible =
        |mu_pa: f64| LinearElastic::from_young_poisson(2.0 * 1.4999 * mu_pa, 0.4999, 1000.0).unwrap();
    let brain = nearly_incompressible(842.0);
    let gel = nearly_incompressible(1000.0);
    let rubber = nearly_incompressible(4.0 * 263.0);
    let ogden = Ogden::from_linear(&brain, -4.7).unwrap();
    let neo_hooke = NeoHookeLog::from(&gel);
    let neo_hooke_isochoric = MooneyRivlin::from_linear(&gel, 0.0).unwrap();
    let mooney_rivlin = MooneyRivlin::from_linear(&rubber, 0.5).unwrap();
    let of_neo_hooke = [-3500.0, -1340.8, -762.5, -334.6, 273.6, 610.0, 1055.6];
    let table: [(&str, &dyn Material, [f64; 7]); 4] = [
        ("ogden", &ogden, [-18485.0, -2515.1, -1013.2, -342.4, 199.4, 383.8, 583.9]),
        ("neo_hooke_log", &neo_hooke, of_neo_hooke),
        ("mooney_rivlin of C01 = 0", &neo_hooke_isochoric, of_neo_hooke),
        ("mooney_rivlin", &mooney_rivlin, [-5523.0, -1712.8, -902.4, -371.5, 274.7, 577.6, 925.4]),
    ];
    for (name, law, expected) in table {
        for (stretch, expected_pa) in STRETCHES.into_iter().zip(expected) {
            let found_pa = uniaxial_pa(law, stretch);
            assert!(
                (found_pa - expected_pa).abs() <= 0.005 * expected_pa.abs(),
                "{name} at {stretch}: {found_pa} Pa, expected {expected_pa}"
            );
        }
    }
}

/// Stretched in the plane of its two fibre families by (s_1, s_2), the third side free and the volume constant:
/// P_i = c (s_i - s_3^2/s_i) + 2 dW/dE (2 kappa (s_i - s_3^2/s_i) + 2 (1 - 3 kappa) s_i a_i^2), our closed form
/// (E with I1 and I4 of the incompressible stretches).
#[test]
fn fibres_of_an_artery_wall_carry_the_closed_form_stress() {
    let (c, k1, k2, kappa) = (7_640.0, 996_600.0, 524.6, 0.226);
    let angle = 49.98_f64.to_radians();
    let (a1, a2) = (angle.cos(), angle.sin());
    let law = HolzapfelGasserOgden::new(&HolzapfelGasserOgdenParameters {
        matrix_shear_pa: c,
        fibre_stiffness_pa: k1,
        fibre_exponent: k2,
        dispersion: kappa,
        fibre_directions: vec![DVec3::new(a1, a2, 0.0), DVec3::new(a1, -a2, 0.0)],
        bulk_pa: 1e11,
    })
    .unwrap();
    for [s1, s2] in [[1.02, 1.02], [1.05, 1.0], [1.0, 1.06], [1.04, 1.03], [0.95, 0.97]] {
        let s3 = 1.0 / (s1 * s2);
        let strain = kappa * (s1 * s1 + s2 * s2 + s3 * s3 - 3.0)
            + (1.0 - 3.0 * kappa) * (s1 * s1 * a1 * a1 + s2 * s2 * a2 * a2 - 1.0);
        let pull = if strain > 0.0 { k1 * strain * (k2 * strain * strain).exp() } else { 0.0 };
        let expected = [(s1, a1), (s2, a2)].map(|(s, a)| {
            (c + 4.0 * kappa * pull) * (s - s3 * s3 / s) + 4.0 * (1.0 - 3.0 * kappa) * pull * s * a * a
        });
        // The third stretch that leaves that side free, between 1 % less and 1 % more.
        let stress = |t: f64| law.first_piola_pa(&DMat3::from_diagonal(DVec3::new(s1, s2, t)));
        let (mut low, mut high) = (0.99 * s3, 1.01 * s3);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if stress(middle).z_axis.z < 0.0 { low = middle } else { high = middle }
        }
        let found = stress(0.5 * (low + high));
        for (found_pa, expected_pa) in [found.x_axis.x, found.y_axis.y].into_iter().zip(expected) {
            assert!(
                (found_pa - expected_pa).abs() <= 1e-4 * expected_pa.abs(),
                "{s1} {s2}: {found_pa} Pa, expected {expected_pa}"
            );
        }
    }
}

fn brain_series() -> PronySeries {
    PronySeries::new(&[PronyTerm { share: 0.450, time_s: 0.5 }, PronyTerm { share: 0.365, time_s: 50.0 }])
        .unwrap()
}

#[test]
fn a_step_of_strain_relaxes_as_the_series_says() {
    let series = brain_series();
    let elastic_pa =
        DMat3::from_diagonal(DVec3::new(1000.0, -200.0, 300.0)) + outer(DVec3::X, DVec3::Y) * 70.0;
    let table = [(0.1, 0.9177), (0.5, 0.7119), (1.0, 0.6037), (5.0, 0.5153), (50.0, 0.3193), (500.0, 0.1850)];
    for (time_s, expected) in table {
        assert!((series.relaxation(time_s) - expected).abs() < 5e-5);
        // The step of strain takes 1e-9 s, then the strain is held in steps of any length.
        for n_steps in [1, 7, 100] {
            let mut history = series.rest();
            series.step(1e-9).advance(&mut history, &elastic_pa);
            let step = series.step(time_s / f64::from(n_steps));
            let mut stress = DMat3::ZERO;
            for _ in 0..n_steps {
                stress = step.stress_pa(&history, &elastic_pa);
                step.advance(&mut history, &elastic_pa);
            }
            let off = norm(&(stress - elastic_pa * series.relaxation(time_s))) / norm(&elastic_pa);
            assert!(off < 1e-8, "{time_s} s in {n_steps} steps: off by {off}");
        }
    }
}

#[test]
fn a_ramp_of_stress_is_exact_in_one_step() {
    let series = brain_series();
    let elastic_pa = DMat3::from_diagonal(DVec3::new(1000.0, 0.0, 0.0));
    let (g, tau, t) = ([0.450, 0.365], [0.5, 50.0], 3.0_f64);
    // Integral of G(t - s)/G(0) times the constant rate.
    let share: f64 =
        1.0 - g[0] - g[1] + (0..2).map(|k| g[k] * tau[k] / t * (1.0 - (-t / tau[k]).exp())).sum::<f64>();
    for n_steps in [1, 10] {
        let step = series.step(t / f64::from(n_steps));
        let mut history = series.rest();
        let mut stress = DMat3::ZERO;
        for i in 1..=n_steps {
            let now = elastic_pa * (f64::from(i) / f64::from(n_steps));
            stress = step.stress_pa(&history, &now);
            step.advance(&mut history, &now);
        }
        assert!((stress.x_axis.x - 1000.0 * share).abs() < 1e-9, "{} {}", stress.x_axis.x, 1000.0 * share);
    }
    assert!((series.step(t).tangent_factor() - share).abs() < 1e-15);
}

/// Unconfined compression of brain at three rates (Ogden's law of 842 Pa and -4.7 with the series above):
/// nominal stress at stretches 0.9, 0.8 and 0.7.
#[test]
fn compressed_brain_is_stiffer_when_compressed_faster() {
    let brain = LinearElastic::from_young_poisson(2.0 * 1.4999 * 842.0, 0.4999, 1000.0).unwrap();
    let law = Ogden::from_linear(&brain, -4.7).unwrap();
    let series = brain_series();
    let table = [
        (0.64, [-322.6, -918.8, -2239.0]),
        (0.64e-2, [-178.9, -494.9, -1194.0]),
        (0.64e-5, [-63.9, -188.6, -468.0]),
    ];
    for (rate_per_s, expected) in table {
        let n_steps = 300;
        let step = series.step(0.3 / rate_per_s / f64::from(n_steps));
        let mut history = series.rest();
        let mut found = Vec::new();
        for i in 1..=n_steps {
            let stretch = 1.0 - 0.3 * f64::from(i) / f64::from(n_steps);
            // The sides are free at every moment, and all of the stress relaxes alike.
            let elastic_pa = DMat3::from_diagonal(DVec3::new(uniaxial_pa(&law, stretch), 0.0, 0.0));
            if i % 100 == 0 {
                found.push(step.stress_pa(&history, &elastic_pa).x_axis.x);
            }
            step.advance(&mut history, &elastic_pa);
        }
        for (found_pa, expected_pa) in found.into_iter().zip(expected) {
            let off = (found_pa - expected_pa) / expected_pa;
            assert!(off.abs() < 0.005, "rate {rate_per_s}: {found_pa} Pa, expected {expected_pa}");
        }
    }
}
