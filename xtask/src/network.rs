//! `cargo xtask network`: everything about the network, in bounded time.

use crate::test::Stages;
use crate::{igtl, netns, root, ros2, run_within, target};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long the stages may take: a build from nothing on two busy cores, and runs of a minute or two.
const BUILD_LIMIT: Duration = Duration::from_secs(60 * 60);
const TESTS_LIMIT: Duration = Duration::from_secs(10 * 60);
const LATENCY_LIMIT: Duration = Duration::from_secs(2 * 60);

/// The tests of the network: of both ends of a link, OpenIGTLink and ROS 2 within one process, and of two processes whose
/// link is cut for two seconds and whose recording replays to the same bits.
pub(crate) const TESTS: [&str; 2] = ["net::", "link::"];

/// The program of the development profile with the feature `net`.
fn program() -> PathBuf {
    target().join("debug").join(format!("glisson{}", std::env::consts::EXE_SUFFIX))
}

/// Runs everything; `scene` is shown to the clients, a block of tissue for none.
pub(crate) fn all(scene: Option<&Path>) -> anyhow::Result<()> {
    let mut stages = Stages::default();
    let mut skipped = Vec::new();
    stages.run("build with the feature net", || {
        run_within(BUILD_LIMIT, "cargo", &[&["build"], &FEATURE[..]].concat())?;
        run_within(BUILD_LIMIT, "cargo", &[&["test", "--no-run"], &FEATURE[..], &TARGETS[..]].concat())
    })?;
    stages.run("tests: UDP, zenoh, TLS, ROS 2, OpenIGTLink, two processes", tests)?;
    let program = program().to_string_lossy().into_owned();
    stages.run("latency of a link (a busy machine makes it longer)", || {
        for link in [&["--link", "zenoh:tcp/127.0.0.1:17447"][..], &[]] {
            run_within(LATENCY_LIMIT, &program, &[&["bench", "link", "--seconds", "5"], link].concat())?;
        }
        Ok(())
    })?;
    let scene = match scene {
        Some(scene) => scene.to_path_buf(),
        None => block(&root().join("out/network"))?,
    };
    stages.run("OpenIGTLink clients of other people", || {
        skipped = igtl::clients(&program, &scene)?;
        Ok(())
    })?;
    stages.run("a client of CRTK with other people's zenoh and CDR", || {
        skipped.extend(ros2::client(&program, &scene)?);
        Ok(())
    })?;
    stages.run(
        "two machines in name-spaces of their own, whose cable is taken out for two seconds",
        || {
            // The simulated device pushes from the home, which has to be at the tissue.
            let near = touching(&root().join("out/network"))?;
            skipped.extend(netns::two_machines(&program, &near)?);
            Ok(())
        },
    )?;
    stages.tell();
    for what in &skipped {
        println!("SKIPPED: {what}");
    }
    Ok(())
}

const FEATURE: [&str; 5] = ["--locked", "--package", "glisson-app", "--features", "net"];
const TARGETS: [&str; 4] = ["--bin", "glisson", "--test", "command_line"];

fn tests() -> anyhow::Result<()> {
    for name in TESTS {
        run_within(TESTS_LIMIT, "cargo", &[&["test"], &FEATURE[..], &TARGETS[..], &[name]].concat())?;
    }
    Ok(())
}

/// A block that a probe pushes.
const SCENE: &str = r#"glisson_scene = 1
name = "block"
[organ]
mesh = "block.tet"
young_modulus = "5 kPa"
poisson_ratio = 0.45
density = "1000 kg/m3"
model = "precomputed"
[[organ.fixed]]
furthest = { direction = [0, 0, -1], fraction = 0.1 }
[tool]
name = "probe"
tip_radius = "5 mm"
home_tip = ["20 mm", "20 mm", "80 mm"]
home_shaft = [0, 0, 1]
[[tool.path]]
time = "1 s"
tip = ["20 mm", "20 mm", "62 mm"]
"#;
/// The scene of a block whose probe is at home 2 mm above it and has no path.
fn touching(folder: &Path) -> anyhow::Result<PathBuf> {
    block(folder)?;
    let near = SCENE.replace("\"80 mm\"]\nhome_shaft", "\"67 mm\"]\nhome_shaft");
    let without_path = near.split("[[tool.path]]").next().unwrap_or_default();
    let scene = folder.join("near.toml");
    std::fs::write(&scene, without_path)?;
    Ok(scene)
}

/// Cells along each edge of the block, and the length of one [mm].
const CELLS: usize = 6;
const CELL_MM: usize = 10;

/// Writes the scene of a block: cubes of six tetrahedra each, around the diagonal that all of them share.
fn block(folder: &Path) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
    let nodes = CELLS + 1;
    let node = |[x, y, z]: [usize; 3]| (x * nodes + y) * nodes + z;
    let every = |n: usize| (0..n).flat_map(move |x| (0..n).flat_map(move |y| (0..n).map(move |z| [x, y, z])));
    let mut mesh = format!("{} {}\n", nodes.pow(3), 6 * CELLS.pow(3));
    for place in every(nodes) {
        let [x, y, z] = place.map(|i| i * CELL_MM);
        mesh += &format!("{x} {y} {z}\n");
    }
    for corner in every(CELLS) {
        // Along the axes in each order, from this corner to the opposite one; every other order turns the other way round.
        for (order, is_even) in [
            ([0, 1, 2], true),
            ([1, 2, 0], true),
            ([2, 0, 1], true),
            ([0, 2, 1], false),
            ([2, 1, 0], false),
            ([1, 0, 2], false),
        ] {
            let mut at = corner;
            let mut ids = vec![node(at)];
            for axis in order {
                at[axis] += 1;
                ids.push(node(at));
            }
            if !is_even {
                ids.swap(1, 2);
            }
            mesh += &format!("{} {} {} {}\n", ids[0], ids[1], ids[2], ids[3]);
        }
    }
    std::fs::write(folder.join("block.tet"), mesh)?;
    let scene = folder.join("scene.toml");
    std::fs::write(&scene, SCENE)?;
    Ok(scene)
}
