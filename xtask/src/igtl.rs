//! `glisson serve --igtl` against clients of other people: Debian's examples of the OpenIGTLink library, and pyigtl.

use crate::served::Served;
use crate::test::SERVER_START;
use crate::{INSTALLING, finished_within, pip_install, run_within, setup, target};
use anyhow::{Context, bail, ensure};
use std::fs::File;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

const EXAMPLES: &str = "/usr/share/doc/openigtlink-examples/examples";
const HEADER: &str = "/usr/include/openigtlink/igtlClientSocket.h";
/// How long the clients listen: several poses and surfaces.
const LISTENING: Duration = Duration::from_secs(4);
/// How long a client that ends by itself may take.
const ANSWERING: Duration = Duration::from_secs(60);
/// Until nothing moves any more: the clients' numbers are compared with those of a state.
const SETTLING: Duration = Duration::from_secs(3);
/// How far a place may lie from the server's own [mm], and a direction's part: clients print six digits.
const TOLERANCE: f64 = 2e-3;

/// Reads poses and a surface, compares checksums with those of pyigtl, packs the surface again with it, and compares all
/// numbers with `/api/snapshot`: RAS in mm is LPS in m with x and y turned over. The axes of an instrument are made here once
/// more: those of a shaft to the front (x left, y head), turned the shortest way.
const PYTHON_CLIENT: &str = r#"
import json, math, socket, struct, sys, urllib.request
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
kinds, transforms = [], {}
while "POLYDATA" not in kinds or not transforms:
    header = exact(58)
    fields = MessageBase.parse_header(header)
    body = exact(fields["body_size"])
    assert CRC64(body) == struct.unpack(">Q", header[50:58])[0], fields
    kinds.append(fields["message_type"])
    if kinds[-1] == "TRANSFORM":
        transforms[fields["device_name"]] = np.array(struct.unpack(">12f", body)).reshape(4, 3)
    if kinds[-1] == "POLYDATA":
        surface = body
state = json.load(urllib.request.urlopen("http://" + sys.argv[2] + "/api/snapshot", timeout=20))
scene = json.load(urllib.request.urlopen("http://" + sys.argv[2] + "/api/scene", timeout=20))
def ras(v):
    return np.asarray(v) * [-1, -1, 1]
def axes(shaft, roll):
    front, shaft = np.array([0.0, -1.0, 0.0]), np.asarray(shaft)
    v, c = np.cross(front, shaft), front @ shaft
    k = np.cross(np.eye(3), v)
    turn = np.eye(3) + k + k @ k / (1 + c)
    left, head = turn @ [1, 0, 0], turn @ [0, 0, 1]
    return [left * math.cos(roll) + head * math.sin(roll), head * math.cos(roll) - left * math.sin(roll), shaft]
def near(what, found, expected, tolerance):
    far = np.abs(np.asarray(found) - expected).max()
    assert far <= tolerance, (what, far, found, expected)
for described, tool in zip(scene["tools"], state["tools"]):
    if described["name"] not in transforms:
        continue
    numbers = transforms[described["name"]]
    near("tip", numbers[3], ras(tool["tip_m"]) * 1e3, 2e-3)
    for column, axis in zip(numbers, axes(tool["shaft"], tool["roll_rad"])):
        near("axis", column, ras(axis), 1e-5)
counts = struct.unpack(">10I", surface[:40])
end = 40 + 12 * counts[0]
points = np.frombuffer(surface[40:end], ">f4").reshape(-1, 3)
near("surface", points, ras(state["positions_m"]) * 1e3, 2e-3)
pressed = np.abs(np.asarray(state["positions_m"]) - state["rest_positions_m"]).max() * 1e3
assert pressed > 0.5 or sys.argv[3] == "any", ("nothing is pressed in", pressed)
polygons = np.frombuffer(surface[end:end + counts[6]], ">u4").astype(int)
assert PolyDataMessage(points=points, polygons=polygons)._pack_content() == surface, "packed otherwise"
print("pyigtl:", kinds, counts[0], "points (up to %.1f mm from rest)" % pressed, counts[5], "polygons; all where the viewer has them")
"#;

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

/// What a client says in [`LISTENING`], on both of its outputs; it is stopped then.
fn heard(client: &Path, port: &str) -> anyhow::Result<String> {
    let said = client.with_extension("txt");
    let file = File::create(&said).with_context(|| format!("{}: cannot write", said.display()))?;
    let mut process = Command::new(client)
        .args(["127.0.0.1", port])
        .stdout(file.try_clone()?)
        .stderr(file)
        .spawn()
        .with_context(|| format!("cannot start {}", client.display()))?;
    // It may end by itself.
    finished_within(LISTENING, &mut process)?;
    let text = std::fs::read(&said).with_context(|| format!("{}: cannot read", said.display()))?;
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// The server's latest state, as text.
fn snapshot(address: &str) -> anyhow::Result<String> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(ANSWERING))?;
    write!(stream, "GET /api/snapshot HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer)
}

/// The numbers that follow `name` up to the next bracket.
fn numbers_after(text: &str, name: &str) -> anyhow::Result<Vec<f64>> {
    let (_, rest) = text.split_once(name).with_context(|| format!("no {name}: {text}"))?;
    let list = rest.trim_start_matches('[').split([']', ')']).next().unwrap_or_default();
    list.split(',').map(|x| x.trim().parse().with_context(|| format!("{name}: {list}"))).collect()
}

/// What Debian's clients print of a pose and of the surface's last point, compared with the server's own.
fn compare(matrices: &str, points: &str, snapshot: &str) -> anyhow::Result<()> {
    let (_, matrix) = matrices.rsplit_once("Receiving TRANSFORM").context("no pose")?;
    let rows: Vec<Vec<f64>> = matrix
        .lines()
        .filter_map(|line| line.split(", ").map(|x| x.trim().parse().ok()).collect::<Option<Vec<f64>>>())
        .filter(|row| row.len() == 4)
        .collect();
    ensure!(rows.len() >= 3, "no matrix of three rows: {matrix}");
    let column = |i: usize| [rows[0][i], rows[1][i], rows[2][i]];
    let (_, surface) = points.split_once("PolyData Contents").context("no surface")?;
    let surface = surface.split("PolyData Contents").next().unwrap_or_default();
    let (_, point) = surface.rsplit_once("point[").context("no point")?;
    let point = numbers_after(point, "] = (")?;
    let (_, positions) = snapshot.split_once("\"positions_m\":").context("no positions")?;
    let (_, position) =
        positions.split("]]").next().and_then(|all| all.rsplit_once('[')).context("no position")?;
    let position = numbers_after(position, "")?;
    let in_lps = |name: &str| numbers_after(snapshot, name);
    for (what, found, expected, scale) in [
        ("the tip", &column(3)[..], in_lps("\"tip_m\":")?, 1e3),
        ("the shaft", &column(2), in_lps("\"shaft\":")?, 1.0),
        ("the last point", &point, position, 1e3),
    ] {
        let turned = [-1.0, -1.0, 1.0];
        let is_same = found.len() == 3
            && expected.len() == 3
            && (0..3).all(|i| (found[i] - turned[i] * scale * expected[i]).abs() <= TOLERANCE);
        ensure!(is_same, "{what} is {found:?} in RAS and mm, but the viewer has {expected:?} in LPS and m");
    }
    Ok(())
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

/// Runs all clients against a server of `scene`; the answer is which of them could not be had, and why. `is_pressed`: its
/// instrument lies in the tissue at home.
pub(crate) fn clients(program: &Path, scene: &Path, is_pressed: bool) -> anyhow::Result<Vec<String>> {
    let folder = target().join("openigtlink");
    std::fs::create_dir_all(&folder)?;
    let Clients { examples, python, skipped } = Clients::get(&folder);
    if examples.is_none() && python.is_none() {
        return Ok(skipped);
    }
    let server = Served::serve(program, scene, &["--igtl", "127.0.0.1:0"])?;
    let port = server.says_after("OpenIGTLink is at 127.0.0.1:", SERVER_START)?;
    let viewer = server.says_after("Glisson is at http://", SERVER_START)?;
    let viewer = viewer.trim_end_matches('/');
    std::thread::sleep(SETTLING);
    if let Some([receiver, asker]) = examples {
        let poses = heard(&receiver, &port)?;
        for expected in ["Receiving STATUS", " Code      : 1", "Receiving TRANSFORM", "Receiving : POLYDATA"]
        {
            ensure!(poses.contains(expected), "ReceiveClient did not say {expected:?}: {poses}");
        }
        println!("ReceiveClient: {} transforms", poses.matches("Receiving TRANSFORM").count());
        let surfaces = heard(&asker, &port)?;
        let n_surfaces = surfaces.matches("PolyData Contents").count();
        if n_surfaces < 3 || surfaces.contains("Invalid response") {
            bail!("PolyDataClient got {n_surfaces} surfaces: {surfaces}");
        }
        println!("PolyDataClient: {n_surfaces} surfaces");
        compare(&poses, &surfaces, &snapshot(viewer)?)?;
        println!("their pose and last point are where the viewer has them");
    }
    if let Some((python, packages)) = python {
        let mut process = Command::new(&python)
            .args(["-c", PYTHON_CLIENT, &port, viewer, if is_pressed { "pressed" } else { "any" }])
            .env("PYTHONPATH", &packages)
            .stdin(Stdio::null())
            .spawn()
            .context("cannot start pyigtl's client")?;
        let status = finished_within(ANSWERING, &mut process)?.context("pyigtl's client did not end")?;
        ensure!(status.success(), "pyigtl does not agree ({status})");
    }
    Ok(skipped)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SNAPSHOT: &str = r#"{"tools":[{"tip_m":[0.02,0.03,0.062],"shaft":[0.6,0.0,0.8]}],"positions_m":[[0.0,0.0,0.0],[0.0,0.01,-0.02]],"rest_positions_m":[[1.0,0.01,-0.02]]}"#;
    const POINT: &str =
        "= PolyData Contents =\n  point[0] = (0, 0, 0)\n  point[1] = (0, -10, -20)\n= PolyData Contents =\n";
    const MATRIX: &str = "Receiving TRANSFORM data type.\n=============\n1, 0, -0.6, -20\n0, 1, 0, -30\n0, 0, 0.8, 62\n0, 0, 0, 1\n";

    #[test]
    fn a_pose_or_point_that_is_not_turned_over_is_found() {
        compare(MATRIX, POINT, SNAPSHOT).unwrap();
        for (matrix, point, what) in [
            (MATRIX.replace("-0.6", "0.6"), POINT, "the shaft"),
            (MATRIX.replace("-30", "30"), POINT, "the tip"),
            (MATRIX.replace("62", "0.062"), POINT, "the tip"),
            (MATRIX.to_owned(), &POINT.replace("-10", "10"), "the last point"),
            (MATRIX.replace("0, 0, 0.8, 62\n0, 0, 0, 1", ""), POINT, "no matrix"),
        ] {
            let error = compare(&matrix, point, SNAPSHOT).unwrap_err().to_string();
            assert!(error.starts_with(what), "{error}");
        }
    }
}
