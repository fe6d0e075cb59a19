//! `glisson serve --igtl` against clients of other people: Debian's examples of the OpenIGTLink library, and pyigtl.

use crate::{INSTALLING, finished_within, pip_install, root, run_within, setup, target};
use anyhow::{Context, bail, ensure};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const EXAMPLES: &str = "/usr/share/doc/openigtlink-examples/examples";
const HEADER: &str = "/usr/include/openigtlink/igtlClientSocket.h";
/// How long the clients listen: several poses and surfaces.
const LISTENING: Duration = Duration::from_secs(4);
/// How long a client that ends by itself may take.
const ANSWERING: Duration = Duration::from_secs(60);
/// How long the server may take to say where it is: set-up pre-computes a liver.
const PATIENCE: Duration = Duration::from_secs(120);

/// Reads one surface and all before it, compares checksums with those of pyigtl, packs the surface again with it.
const PYTHON_CLIENT: &str = r#"
import socket, struct, sys
import numpy as np
from pyigtl.messages import CRC64, MessageBase, PolyDataMessage
stream = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
stream.settimeout(20)
def exact(n):
    data = b""
    while len(data) < n:
        more = stream.recv(n - len(data))
        assert more, "the server closed the connection"
        data += more
    return data
kinds = []
while "POLYDATA" not in kinds:
    header = exact(58)
    fields = MessageBase.parse_header(header)
    body = exact(fields["body_size"])
    assert CRC64(body) == struct.unpack(">Q", header[50:58])[0], fields
    kinds.append(fields["message_type"])
counts = struct.unpack(">10I", body[:40])
end = 40 + 12 * counts[0]
points = np.frombuffer(body[40:end], ">f4").reshape(-1, 3)
polygons = np.frombuffer(body[end:end + counts[6]], ">u4").astype(int)
assert PolyDataMessage(points=points, polygons=polygons)._pack_content() == body, "packed otherwise"
print("pyigtl:", kinds, counts[0], "points", counts[5], "polygons")
"#;

/// A running `glisson serve`; stopped when dropped.
pub(crate) struct Server {
    process: Child,
    /// What it said behind the words that were waited for, up to the next space.
    told: String,
}

impl Server {
    /// Starts it with these options and waits until it has said `words`.
    pub(crate) fn start(
        program: &str,
        scene: &Path,
        options: &[&str],
        words: &'static str,
    ) -> anyhow::Result<Self> {
        let mut process = Command::new(program)
            .args(["serve", "--port", "0", "--no-open"])
            .arg(scene)
            .args(options)
            .current_dir(root())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start glisson serve")?;
        let out = process.stdout.take().expect("its output is piped");
        let (tell, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                println!("  serve: {line}");
                if let Some(rest) = line.strip_prefix(words) {
                    // Nobody listens any more once the port was taken or waiting for it ended.
                    let _ = tell.send(rest.split(' ').next().unwrap_or("").to_owned());
                }
            }
        });
        let mut server = Self { process, told: String::new() };
        server.told =
            told.recv_timeout(PATIENCE).with_context(|| format!("glisson serve did not say {words:?}"))?;
        Ok(server)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn compiled(example: &str, folder: &Path) -> anyhow::Result<PathBuf> {
    let out = folder.join(example.rsplit('/').next().unwrap_or(example));
    let include =
        Path::new(HEADER).parent().context("a header lies in a folder")?.to_string_lossy().into_owned();
    let utilities = format!("-I{include}/igtlutil");
    let source = format!("{EXAMPLES}/{example}.cxx");
    let output = out.to_string_lossy().into_owned();
    run_within(
        INSTALLING,
        "g++",
        &["-w", &format!("-I{include}"), &utilities, &source, "-o", &output, "-lOpenIGTLink", "-lpthread"],
    )?;
    Ok(out)
}

/// What a client says in [`LISTENING`]; it is stopped then.
fn heard(client: &Path, port: &str) -> anyhow::Result<String> {
    let mut process = Command::new(client)
        .args(["127.0.0.1", port])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", client.display()))?;
    let end = Instant::now() + LISTENING;
    while Instant::now() < end && process.try_wait()?.is_none() {
        std::thread::sleep(Duration::from_millis(50));
    }
    // It may have ended by itself.
    let _ = process.kill();
    let output = process.wait_with_output()?;
    Ok(String::from_utf8_lossy(&output.stderr).into_owned())
}

/// The clients that could be had.
struct Clients {
    /// Debian's `ReceiveClient` and `PolyDataClient`.
    examples: Option<[PathBuf; 2]>,
    /// Python, and where pyigtl lies.
    python: Option<(String, String)>,
    /// What could not be had, and why.
    skipped: Vec<String>,
}

impl Clients {
    /// Installs what it may.
    fn get(folder: &Path) -> Self {
        let mut skipped = Vec::new();
        let mut or_skip = |what: &str, error: anyhow::Error| {
            println!("SKIPPED {what}: {error:#}");
            skipped.push(format!("{what}: {error:#}"));
        };
        let examples = examples(folder).map_err(|error| or_skip("openigtlink-examples", error)).ok();
        let python = pyigtl(folder).map_err(|error| or_skip("pyigtl", error)).ok();
        Self { examples, python, skipped }
    }
}

fn examples(folder: &Path) -> anyhow::Result<[PathBuf; 2]> {
    setup::require(&["g++"], "g++", "compiling OpenIGTLink's examples")?;
    setup::require_file(&format!("{EXAMPLES}/Receiver/ReceiveClient.cxx"), "openigtlink-examples")?;
    setup::require_file(HEADER, "libopenigtlink-dev")?;
    Ok([compiled("Receiver/ReceiveClient", folder)?, compiled("PolyData/PolyDataClient", folder)?])
}

fn pyigtl(folder: &Path) -> anyhow::Result<(String, String)> {
    let python = setup::require(&["python3", "python"], "python3", "running pyigtl")?;
    let packages = folder.join("python").to_string_lossy().into_owned();
    pip_install(&python, &packages, &["pyigtl==0.3.4"])?;
    Ok((python, packages))
}

/// Runs all clients against a server of `scene`; the answer is which of them could not be had, and why.
pub(crate) fn clients(program: &str, scene: &Path) -> anyhow::Result<Vec<String>> {
    let folder = target().join("openigtlink");
    std::fs::create_dir_all(&folder)?;
    let Clients { examples, python, skipped } = Clients::get(&folder);
    if examples.is_none() && python.is_none() {
        return Ok(skipped);
    }
    let server = Server::start(program, scene, &["--igtl", "127.0.0.1:0"], "OpenIGTLink is at 127.0.0.1:")?;
    if let Some([receiver, asker]) = examples {
        let text = heard(&receiver, &server.told)?;
        for expected in ["Receiving STATUS", " Code      : 1", "Receiving TRANSFORM", "Receiving : POLYDATA"]
        {
            ensure!(text.contains(expected), "ReceiveClient did not say {expected:?}: {text}");
        }
        println!("ReceiveClient: {} transforms", text.matches("Receiving TRANSFORM").count());
        let text = heard(&asker, &server.told)?;
        let n_surfaces = text.matches("PolyData Contents").count();
        if n_surfaces < 3 || text.contains("Invalid response") {
            bail!("PolyDataClient got {n_surfaces} surfaces: {text}");
        }
        println!("PolyDataClient: {n_surfaces} surfaces");
    }
    if let Some((python, packages)) = python {
        let mut process = Command::new(&python)
            .args(["-c", PYTHON_CLIENT, &server.told])
            .env("PYTHONPATH", &packages)
            .spawn()
            .context("cannot start pyigtl's client")?;
        let status = finished_within(ANSWERING, &mut process)?.context("pyigtl's client did not end")?;
        ensure!(status.success(), "pyigtl does not agree ({status})");
    }
    Ok(skipped)
}
