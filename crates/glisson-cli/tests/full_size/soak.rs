//! A long random palpation of the synthetic patient's liver: no step fails, nothing drifts, and the replay makes
//! the same bits. `cargo xtask test` runs a bounded share; `cargo xtask soak` sets GLISSON_SOAK_STEPS and
//! GLISSON_SOAK_REPORT.

mod kernel;

use super::glisson;
use glisson::math::{DVec3, SeededRandom};
use glisson::model::kernel::KernelLaw;
use serde_json::Value;
use std::fmt::Write as _;
use std::path::Path;

const DEFAULT_STEPS: u64 = 20_000;
/// The time step of the demo's scene [s].
const TIME_STEP_S: f64 = 4e-4;
/// One push takes so long [s].
const PUSH_S: f64 = 0.4;

fn bounds_mm(mesh: &Path) -> (DVec3, DVec3) {
    let quality: Value =
        serde_json::from_str(&glisson(&["check", mesh.to_str().unwrap(), "--json"])).unwrap();
    let corner = |key: &str| {
        let list = quality[key].as_array().unwrap();
        DVec3::from_array([0, 1, 2].map(|i| list[i].as_f64().unwrap() * 1e3))
    };
    (corner("bounds_min_m"), corner("bounds_max_m"))
}

/// One kind of palpation.
struct Palpation {
    /// What the scene says of the model.
    model: &'static str,
    /// What the report calls it.
    name: &'static str,
    /// How far pushes go towards the middle: 0 to the surface, 1 to the middle.
    deepest: f64,
}

/// Linear elasticity bears any push. St Venant-Kirchhoff tissue gets those that leave its stretches within the 1.3 that
/// its step is made for.
const PALPATIONS: [Palpation; 4] = [
    Palpation { model: "model = \"precomputed\"", name: "precomputed", deepest: 0.5 },
    Palpation { model: "model = \"tensor_mass\"", name: "tensor_mass", deepest: 0.5 },
    Palpation { model: "model = \"explicit\"\nlaw = \"linear\"", name: "explicit, linear", deepest: 0.5 },
    Palpation { model: "model = \"explicit\"", name: "explicit, st_venant_kirchhoff", deepest: GENTLE },
];
const GENTLE: f64 = 0.15;

/// The demo's scene under another model, its path replaced by random pushes from random directions.
fn random_scene(folder: &Path, palpation: &Palpation, seconds: f64) -> String {
    let text = std::fs::read_to_string(folder.join("scene.toml")).unwrap();
    let head =
        text.split("\n[[tool.path]]").next().unwrap().replace("model = \"precomputed\"", palpation.model);
    let (min_mm, max_mm) = bounds_mm(&folder.join("liver.vtu"));
    let (center, half) = (0.5 * (min_mm + max_mm), 0.5 * (max_mm - min_mm));
    let mut random = SeededRandom::new(7);
    let mut scene = head;
    let mut time_s = 0.0;
    let mut point = |time_s: &mut f64, lasts_s: f64, at: DVec3| {
        *time_s += lasts_s;
        write!(
            scene,
            "\n[[tool.path]]\ntime = \"{} s\"\ntip = [\"{} mm\", \"{} mm\", \"{} mm\"]\n",
            *time_s, at.x, at.y, at.z
        )
        .unwrap();
    };
    let mut last = -DVec3::Y;
    while time_s < seconds {
        let direction = DVec3::new(random.normal(), -random.normal().abs(), random.normal()).normalize();
        let away = |direction: DVec3| center + direction * 1.6 * half.max_element();
        // Around the organ: straight from one side to the other, the tool would sweep through it.
        if last.dot(direction) < 0.0 {
            point(&mut time_s, 0.25 * PUSH_S, away(-DVec3::Y));
        }
        last = direction;
        let outside = away(direction);
        let inside = center + direction * half * random.uniform_in(1.0 - palpation.deepest, 1.0);
        point(&mut time_s, 0.25 * PUSH_S, outside);
        point(&mut time_s, 0.35 * PUSH_S, inside);
        point(&mut time_s, 0.4 * PUSH_S, outside);
    }
    scene
}

/// Runs and replays a palpation with the program; answers the report's row.
fn program_row(folder: &Path, palpation: &Palpation, steps: u64, number: usize) -> String {
    let at = |name: &str| folder.join(name).to_str().unwrap().to_string();
    let (scene, recording) = (at(&format!("soak_{number}.toml")), at(&format!("soak_{number}.jsonl")));
    let model = palpation.name;
    std::fs::write(&scene, random_scene(folder, palpation, steps as f64 * TIME_STEP_S)).unwrap();
    let printed = glisson(&["run", &scene, "--steps", &steps.to_string(), "--record", &recording, "--json"]);
    let run: Value = serde_json::from_str(&printed).unwrap();
    let number = |key: &str| run[key].as_f64().unwrap();
    assert!(number("contact_steps") > 0.02 * steps as f64, "{model}: {printed}");
    assert!(number("greatest_force_n") < 1e3, "{model}: {printed}");
    let hash = run["state_hash"].as_str().unwrap();
    assert!(glisson(&["replay", &recording]).contains(hash), "{model}");
    let (contact_steps, force_n) = (number("contact_steps"), number("greatest_force_n"));
    format!("| {model} | {steps} | {contact_steps} | {force_n:.2} | `{hash}` |\n")
}

/// The same for the kernel's model in a world of the library.
fn kernel_row(folder: &Path, law: KernelLaw, palpation: &Palpation, steps: u64) -> String {
    let scene = folder.join(format!("soak_{law:?}.toml"));
    std::fs::write(&scene, random_scene(folder, palpation, steps as f64 * TIME_STEP_S)).unwrap();
    kernel::row(&scene, law, steps)
}

/// All rows at the same time: they take long.
#[test]
fn a_long_random_palpation_stays_finite_and_replays() {
    let steps: u64 = std::env::var("GLISSON_SOAK_STEPS").map_or(DEFAULT_STEPS, |s| s.parse().unwrap());
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    glisson(&["demo", "--headless", "--out", folder.to_str().unwrap()]);
    let of_kernel = [
        (KernelLaw::Linear, &PALPATIONS[1]),
        (KernelLaw::StVenantKirchhoff, &PALPATIONS[3]),
        (KernelLaw::StableNeoHooke, &PALPATIONS[3]),
    ];
    let (rows, kernel_rows) = std::thread::scope(|scope| {
        let told = |row: String| {
            eprint!("{row}");
            row
        };
        let rows: Vec<_> = PALPATIONS
            .iter()
            .enumerate()
            .map(|(i, palpation)| scope.spawn(move || told(program_row(folder, palpation, steps, i))))
            .collect();
        let kernel_rows: Vec<_> = of_kernel
            .iter()
            .map(|&(law, palpation)| scope.spawn(move || told(kernel_row(folder, law, palpation, steps))))
            .collect();
        let all = |rows: Vec<std::thread::ScopedJoinHandle<'_, String>>| -> String {
            rows.into_iter().map(|row| row.join().unwrap()).collect()
        };
        (all(rows), all(kernel_rows))
    });
    let report = format!(
        "# Soak\nA random palpation of the synthetic patient's liver (6,300 tetrahedra), then its replay: pushes up to half way to \
         the middle, of St Venant-Kirchhoff tissue up to 15 %, which leaves its stretches within those that its step is \
         made for.\n\
         Made by `cargo xtask soak`.\n\n\
         | model | steps | steps in contact | greatest force [N] | state hash, also of the replay |\n\
         |---|---|---|---|---|\n{rows}\n\
         The explicit model on the fast kernel, in a world without a window; the second run goes on with a copy of the \
         model from its middle on. Drift: the largest distance of a node from its rest position when \
         the organ has come to rest afterwards. St Venant-Kirchhoff tissue that was pushed inside out \
         may rest so.\n\n\
         | law | steps | steps in contact | greatest force [N] | drift [mm] | tetrahedra inside out at rest | energy limited [steps] | state hash, of both runs |\n\
         |---|---|---|---|---|---|---|---|\n{kernel_rows}"
    );
    if let Some(file) = std::env::var_os("GLISSON_SOAK_REPORT") {
        std::fs::write(file, report).unwrap();
    }
}
