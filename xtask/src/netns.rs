//! Two machines that are really apart for the system: two network name-spaces of Linux with a cable between them, the
//! simulation in one and the haptic loop with a simulated device in the other. The cable is taken down for two seconds, and what
//! was recorded is replayed. Over UDP, and over zenoh by an address and by multicast.

use crate::command;
use crate::served::Served;
use anyhow::{Context, ensure};
use std::path::Path;
use std::process::Command;
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

fn wait_until_up(space: &str, end: &str) -> anyhow::Result<()> {
    let start = Instant::now();
    loop {
        let output = Command::new("ip").args(["-n", space, "link", "show", end]).output()?;
        let said = String::from_utf8_lossy(&output.stdout);
        if said.contains("state UP") {
            return Ok(());
        }
        let error = String::from_utf8_lossy(&output.stderr);
        ensure!(start.elapsed() < PATIENCE, "{end} in {space} does not come up: {said}{error}");
        std::thread::sleep(Duration::from_millis(20));
    }
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
            for which in [&end, "lo"] {
                ip(&["-n", name, "link", "set", which, "up"])?;
            }
        }
        Ok(apart)
    }

    /// The system says that the cable is there up to a second after it is; zenoh looks for others where it is said when it starts.
    fn wait_for_cable(&self) -> anyhow::Result<()> {
        self.names.iter().enumerate().try_for_each(|(i, name)| wait_until_up(name, &format!("end{i}")))
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

/// `glisson serve` in a name-space.
fn serve(space: &str, program: &Path, scene: &Path, options: &[&str]) -> anyhow::Result<Served> {
    let mut command = command("ip");
    command.args(["netns", "exec", space]).arg(program).arg("serve").arg(scene).args(options);
    Served::start(&mut command, space)
}

/// How the two machines reach each other.
const LINKS: [&str; 3] = ["udp://", "zenoh:tcp/", "zenoh:"];

/// Runs it over each link; the answer is why it could not be, for none. The simulated device's hand pushes 10 mm from the
/// instrument's home in `scene` along it: what is felt has to be there.
pub(crate) fn two_machines(program: &Path, scene: &Path) -> anyhow::Result<Option<String>> {
    let folder = scene.parent().context("a scene lies in a folder")?;
    let key = folder.join("link.key");
    std::fs::write(&key, format!("{:?} {}", Instant::now(), std::process::id()))?;
    for link in LINKS {
        // Anew for each: zenoh's multicast finds no one else there.
        let apart = match Apart::new() {
            Ok(apart) => apart,
            Err(reason) => {
                let what = "two machines in network name-spaces (they need Linux, root and iproute2)";
                return Ok(Some(format!("{what}: {reason:#}")));
            }
        };
        apart.wait_for_cable()?;
        let link = if link == "zenoh:" { link.to_owned() } else { format!("{link}{}:{PORT}", ADDRESSES[0]) };
        session(&apart, program, scene, &link, &key).with_context(|| format!("over {link}"))?;
    }
    Ok(None)
}

/// One session with its cut, and its replay.
fn session(apart: &Apart, program: &Path, scene: &Path, link: &str, key: &Path) -> anyhow::Result<()> {
    let key = key.to_string_lossy().into_owned();
    let recording = scene.with_file_name("two-machines.jsonl");
    let record = recording.to_string_lossy().into_owned();
    let of_link = ["--link", link, "--link-key", &key];
    let [simulation, haptics] = &apart.names;
    let simulating =
        [&["--role", "simulation", "--port", "0", "--no-open", "--record", &record], &of_link[..]].concat();
    let simulation = serve(simulation, program, scene, &simulating)?;
    simulation.says("Glisson is at", PATIENCE)?;
    let feeling = [&["--role", "haptics", "--device", "simulated"], &of_link[..]].concat();
    let haptics = serve(haptics, program, scene, &feeling)?;
    haptics.says("the simulation is there", PATIENCE)?;
    std::thread::sleep(THERE);
    apart.cable("down")?;
    haptics.says("nothing comes from the simulation", PATIENCE)?;
    std::thread::sleep(GONE);
    apart.cable("up")?;
    haptics.says("the simulation is there", PATIENCE)?;
    std::thread::sleep(THERE);
    haptics.interrupt()?;
    let felt = haptics.says("felt: ", PATIENCE)?;
    simulation.interrupt()?;
    let hash = simulation.says_after("stopped; state hash ", PATIENCE)?;
    simulation.says("link: ", PATIENCE)?;
    let number = |name: &str| -> anyhow::Result<f64> {
        let (_, rest) =
            felt.split_once(&format!("\"{name}\":")).with_context(|| format!("no {name}: {felt}"))?;
        let end = rest.find([',', '}']).unwrap_or(rest.len());
        rest[..end].parse().with_context(|| format!("{name}: {felt}"))
    };
    ensure!(number("greatest_force_n")? > 0.05, "nothing was felt: {felt}");
    ensure!(number("taken_back_ticks")? > 500.0, "the force was not undone: {felt}");
    ensure!(number("greatest_force_taken_back_n")? < 1e-3, "a force without a simulation: {felt}");
    ensure!(number("greatest_force_given_again_n")? > 0.05, "nothing was felt after it: {felt}");
    ensure!(number("ramp_ticks")? > 150.0, "no ramps: {felt}");

    let replay = Command::new(program).arg("replay").arg(&recording).output().context("cannot replay")?;
    let said = String::from_utf8_lossy(&replay.stdout);
    let is_same = replay.status.success() && said.contains("same bits") && said.contains(&hash);
    ensure!(is_same, "the replay of {record}, which ended with {hash}: {said}");
    println!("the session over {link} went on, and its recording replays to the same bits");
    Ok(())
}
