//! Two machines that are really apart for the system: two network name-spaces of Linux with a cable between them, the
//! simulation in one and the haptic loop with a simulated device in the other. The cable is taken down for two seconds.

use crate::{command, finished_within};
use anyhow::{Context, ensure};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// Until a process says what is waited for.
const PATIENCE: Duration = Duration::from_secs(60);
/// Both ends of the cable: addresses that are nobody's (RFC 5737).
const ADDRESSES: [&str; 2] = ["192.0.2.1", "192.0.2.2"];
const PORT: u16 = 7447;
/// With the cable there, gone, and there again.
const THERE: Duration = Duration::from_secs(3);
const GONE: Duration = Duration::from_secs(2);

fn ip(arguments: &[&str]) -> anyhow::Result<()> {
    let output = Command::new("ip").args(arguments).output().context("cannot start ip")?;
    let said = String::from_utf8_lossy(&output.stderr).trim().to_owned();
    ensure!(output.status.success(), "ip {}: {said}", arguments.join(" "));
    Ok(())
}

/// Two name-spaces with a cable; they go with it.
struct Apart {
    names: [String; 2],
}

impl Apart {
    /// # Errors
    /// Where the system does not allow it.
    fn new() -> anyhow::Result<Self> {
        let id = std::process::id();
        let apart = Self { names: [format!("glisson-s{id}"), format!("glisson-h{id}")] };
        for name in &apart.names {
            ip(&["netns", "add", name])?;
        }
        let [simulation, haptics] = &apart.names;
        ip(&[
            "link", "add", "end0", "netns", simulation, "type", "veth", "peer", "name", "end1", "netns",
            haptics,
        ])?;
        for (i, name) in apart.names.iter().enumerate() {
            let (end, address) = (format!("end{i}"), format!("{}/24", ADDRESSES[i]));
            ip(&["-n", name, "address", "add", &address, "dev", &end])?;
            ip(&["-n", name, "link", "set", &end, "up"])?;
        }
        Ok(apart)
    }

    fn cable(&self, state: &str) -> anyhow::Result<()> {
        ip(&["-n", &self.names[0], "link", "set", "end0", state])
    }
}

impl Drop for Apart {
    fn drop(&mut self) {
        for name in &self.names {
            // One that could not be made is not there.
            let _ = ip(&["netns", "delete", name]);
        }
    }
}

/// `glisson serve` in a name-space, and what it says.
struct There {
    process: Child,
    lines: Receiver<String>,
}

impl There {
    fn start(space: &str, program: &str, scene: &Path, options: &[&str]) -> anyhow::Result<Self> {
        let mut process = command("ip")
            .args(["netns", "exec", space, program, "serve"])
            .arg(scene)
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start ip")?;
        let out = process.stdout.take().context("its output is piped")?;
        let (send, lines) = channel();
        let space = space.to_owned();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                println!("  {space}: {line}");
                if send.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self { process, lines })
    }

    /// Waits for a line with `text`.
    fn says(&self, text: &str) -> anyhow::Result<String> {
        let end = Instant::now() + PATIENCE;
        while Instant::now() < end {
            match self.lines.recv_timeout(Duration::from_millis(100)) {
                Ok(line) if line.contains(text) => return Ok(line),
                _ => {}
            }
        }
        anyhow::bail!("nobody says {text:?}")
    }

    fn interrupt(&self) -> anyhow::Result<()> {
        let id = self.process.id().to_string();
        let status = Command::new("kill").args(["-INT", &id]).status().context("cannot start kill")?;
        ensure!(status.success(), "kill -INT {id} failed");
        Ok(())
    }
}

impl Drop for There {
    fn drop(&mut self) {
        // It may have ended by itself, and gets a moment for it.
        if !matches!(finished_within(Duration::from_secs(5), &mut self.process), Ok(Some(_))) {
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

/// Runs it; the answer is why it could not be, for none. The simulated device's hand pushes 10 mm from the instrument's home
/// in `scene` along it: what is felt has to be there.
pub(crate) fn two_machines(program: &str, scene: &Path) -> anyhow::Result<Option<String>> {
    let apart = match Apart::new() {
        Ok(apart) => apart,
        Err(reason) => {
            let what = "two machines in network name-spaces (they need Linux, root and iproute2)";
            return Ok(Some(format!("{what}: {reason:#}")));
        }
    };
    let folder = scene.parent().context("a scene lies in a folder")?;
    let key = folder.join("link.key");
    std::fs::write(&key, format!("{:?} {}", Instant::now(), std::process::id()))?;
    let key = key.to_string_lossy().into_owned();
    let link = format!("udp://{}:{PORT}", ADDRESSES[0]);
    let of_link = ["--link", &link, "--link-key", &key];
    let [simulation, haptics] = &apart.names;
    let simulating = [&["--role", "simulation", "--port", "0", "--no-open"], &of_link[..]].concat();
    let simulation = There::start(simulation, program, scene, &simulating)?;
    simulation.says("Glisson is at")?;
    let feeling = [&["--role", "haptics", "--device", "simulated"], &of_link[..]].concat();
    let haptics = There::start(haptics, program, scene, &feeling)?;
    haptics.says("the simulation is there")?;
    std::thread::sleep(THERE);
    apart.cable("down")?;
    haptics.says("nothing comes from the simulation")?;
    std::thread::sleep(GONE);
    apart.cable("up")?;
    haptics.says("the simulation is there")?;
    std::thread::sleep(THERE);
    haptics.interrupt()?;
    let felt = haptics.says("felt: ")?;
    simulation.interrupt()?;
    simulation.says("link: ")?;
    let number = |name: &str| -> anyhow::Result<f64> {
        let (_, rest) =
            felt.split_once(&format!("\"{name}\":")).with_context(|| format!("no {name}: {felt}"))?;
        let end = rest.find([',', '}']).unwrap_or(rest.len());
        rest[..end].parse().with_context(|| format!("{name}: {felt}"))
    };
    ensure!(number("greatest_force_n")? > 0.05, "nothing was felt: {felt}");
    ensure!(number("taken_back_ticks")? > 500.0, "the force was not taken back: {felt}");
    ensure!(number("greatest_force_taken_back_n")? < 1e-3, "a force without a simulation: {felt}");
    ensure!(number("greatest_force_given_again_n")? > 0.05, "nothing was felt after it: {felt}");
    ensure!(number("ramp_ticks")? > 150.0, "no ramps: {felt}");
    Ok(None)
}
