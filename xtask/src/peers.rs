//! `cargo xtask peers`: the implicit step beside other simulators, which it installs from their registries.
//!
//! Their programs are in `xtask/peers`, outside the workspace; what is installed lies in target/peers.

use crate::{pip_install, root, run, setup, target};
use anyhow::Context;

/// Version of each; that of rapier is in its Cargo.toml.
const RAPIER: &str = "0.36.1";
pub(crate) const MUJOCO: &str = "4.0.0";

/// Installs the others, measures at `sizes` in tetrahedra, `seconds` for each figure, and writes docs/peers.md with its plot.
pub(crate) fn measure(sizes: &[usize], seconds: f64) -> anyhow::Result<()> {
    let folder = target().join("peers");
    let own = root().join("xtask/peers");
    let manifest = own.join("rapier/Cargo.toml");
    let [folder_name, manifest_name] = [&folder, &manifest].map(|path| path.to_string_lossy().into_owned());
    let rapier =
        ["build", "--release", "--locked", "--manifest-path", &manifest_name, "--target-dir", &folder_name];
    run("cargo", &rapier).context("rapier3d cannot be built")?;
    let python = setup::require(&["python3"], "python3", "MuJoCo")?;
    setup::require(&["pip3"], "python3-pip", "MuJoCo")?;
    let packages = folder.join("python").to_string_lossy().into_owned();
    let mujoco = format!("mujoco-core=={MUJOCO}");
    pip_install(&python, &packages, &[&mujoco])
        .context("MuJoCo cannot be installed; it needs Python 3.11 or later")?;

    let rapier_program = folder.join(format!("release/peer-rapier{}", std::env::consts::EXE_SUFFIX));
    let script = own.join("mujoco_flex.py").to_string_lossy().into_owned();
    let (rapier_name, mujoco_name) = (
        format!("rapier3d {RAPIER}, soft body, FEM solver, neo-Hooke, one substep, f32"),
        format!("MuJoCo {MUJOCO}, flex, `discrete` integrator, St Venant-Kirchhoff"),
    );
    let sizes = sizes.iter().map(usize::to_string).collect::<Vec<_>>().join(",");
    let seconds = seconds.to_string();
    let (rapier_program, path) =
        (rapier_program.to_string_lossy().into_owned(), format!("PYTHONPATH={packages}"));
    let arguments = ["run", "--release", "--locked", "--package", "glisson-lab", "--example", "peers", "--"];
    let asked = ["--sizes", &sizes, "--seconds", &seconds, "--folder", &folder_name];
    let rapier = ["--peer", &rapier_name, "--step-ms", "10", "--command", &rapier_program];
    let mujoco = ["--peer", &mujoco_name, "--step-ms", "2"];
    let mut command = [&arguments[..], &asked[..], &rapier[..], &mujoco[..]].concat();
    for part in ["env", &path, &python, &script, "discrete"] {
        command.extend(["--command", part]);
    }
    run("cargo", &command)
}
