//! `cargo xtask network`: everything about the network, in bounded time.

use crate::test::Stages;
use crate::{igtl, root, ros2, run_within, target};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long the stages may take: a build from nothing on two busy cores, and runs of a minute or two.
const BUILD_LIMIT: Duration = Duration::from_secs(60 * 60);
const TESTS_LIMIT: Duration = Duration::from_secs(10 * 60);
const SCENE_LIMIT: Duration = Duration::from_secs(10 * 60);
const LATENCY_LIMIT: Duration = Duration::from_secs(2 * 60);

/// The tests of the network: of both ends of a link, OpenIGTLink and ROS 2 within one process, and of two processes whose
/// link is cut for two seconds and whose recording replays to the same bits.
pub(crate) const TESTS: [&str; 2] = ["net::", "link::"];

/// The program of the development profile with the feature `net`.
fn program() -> PathBuf {
    target().join("debug").join(format!("glisson{}", std::env::consts::EXE_SUFFIX))
}

/// Runs everything; `scene` is shown to the OpenIGTLink clients, a phantom of its own for none.
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
    let made = root().join("out/network");
    let scene = scene.map_or_else(|| made.join("scene.toml"), Path::to_path_buf);
    stages.run("a scene to show", || {
        if scene.exists() {
            return Ok(());
        }
        std::fs::create_dir_all(&made).with_context(|| format!("{}: cannot make", made.display()))?;
        run_within(SCENE_LIMIT, &program, &["demo", "--headless", "--out", &made.to_string_lossy()])
    })?;
    stages.run("OpenIGTLink clients of other people", || {
        skipped = igtl::clients(&program, &scene)?;
        Ok(())
    })?;
    stages.run("a client of CRTK with other people's zenoh and CDR", || {
        skipped.extend(ros2::client(&program, &scene)?);
        Ok(())
    })?;
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
