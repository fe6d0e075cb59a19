//! `glisson serve --ros2 --ros2-control` against other people's code: zenoh's Python package as router and client, and
//! rosbags, which has CDR and the hashes of types of its own.

use crate::served::Served;
use crate::test::SERVER_START;
use crate::{finished_within, pip_install, setup, target};
use anyhow::{Context, ensure};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

const PACKAGES: [&str; 2] = ["eclipse-zenoh==1.10.2", "rosbags==0.11.9"];
/// How long the client may take, with the server's set-up.
const ANSWERING: Duration = Duration::from_secs(240);

/// A router with a client of CRTK in one: finds an instrument, enables it, moves it by 10 mm, sends it home, disables it.
const PYTHON_CLIENT: &str = r#"
import copy, sys, time
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
types = get_typestore(Stores.ROS2_JAZZY)
types.register(get_types_from_msg("std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy", "crtk_msgs/msg/OperatingState"))
types.register(get_types_from_msg("std_msgs/Header header\nstring string", "crtk_msgs/msg/StringStamped"))
POSE, TWIST, STATE, TEXT = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TwistStamped", "crtk_msgs/msg/OperatingState", "crtk_msgs/msg/StringStamped"
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:%s"]' % sys.argv[1])
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("router ready", flush=True)
def until(holds, what, seconds=150):
    end = time.time() + seconds
    while time.time() < end:
        if holds():
            return
        time.sleep(0.002)
    sys.exit("nothing came of: " + what)
def tools():
    tokens = [str(reply.ok.key_expr) for reply in session.liveliness().get("@ros2_lv/**") if reply.ok]
    return [token.split("/%")[-1].split("%")[0] for token in tokens if "%measured_cp/" in token]
until(tools, "an instrument")
tool = tools()[0]
def key(topic, kind):
    package, _, name = kind.split("/")
    return "0/%s/%s/%s::msg::dds_::%s_/%s" % (tool, topic, package, name, types.hash_rihs01(kind))
last = {}
def listen(topic, kind):
    def take(sample):
        last[topic] = types.deserialize_cdr(bytes(sample.payload), kind)
    return session.declare_subscriber(key(topic, kind), take)
heard = [listen("measured_cp", POSE), listen("measured_cv", TWIST), listen("operating_state", STATE),
    listen("body/measured_cf", "geometry_msgs/msg/WrenchStamped")]
def header():
    return types.types["std_msgs/msg/Header"](types.types["builtin_interfaces/msg/Time"](0, 0), "")
def command(text):
    session.put(key("state_command", TEXT), bytes(types.serialize_cdr(types.types[TEXT](header(), text), TEXT)))
def state():
    return last["operating_state"].state
until(lambda: len(last) == 4, "all topics of " + tool)
assert state() == "DISABLED", state()
command("enable")
until(lambda: state() == "ENABLED", "enable")
start = copy.deepcopy(last["measured_cp"].pose)
goal = copy.deepcopy(start)
goal.position.z += 0.01
session.put(key("move_cp", POSE), bytes(types.serialize_cdr(types.types[POSE](header(), goal), POSE)))
until(lambda: last["operating_state"].is_busy, "move_cp")
until(lambda: not last["operating_state"].is_busy, "the end of move_cp")
until(lambda: abs(last["measured_cp"].pose.position.z - goal.position.z) < 1e-4, "the goal")
command("home")
until(lambda: last["operating_state"].is_busy, "home")
until(lambda: not last["operating_state"].is_busy and last["operating_state"].is_homed, "the end of home")
command("disable")
until(lambda: state() == "DISABLED", "disable")
print("a client of CRTK moved", tool, "by 10 mm and home")
session.close()
"#;

/// Runs the client against a server of `scene`; the answer is why it could not be had, for none.
pub(crate) fn client(program: &Path, scene: &Path) -> anyhow::Result<Option<String>> {
    let folder = target().join("ros2-client");
    let packages = folder.to_string_lossy().into_owned();
    let installed = setup::require(&["python3", "python"], "python3", "a client of ROS 2's topics")
        .and_then(|python| pip_install(&python, &packages, &PACKAGES).map(|()| python));
    let python = match installed {
        Ok(python) => python,
        Err(error) => return Ok(Some(format!("{}: {error:#}", PACKAGES.join(" and ")))),
    };
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port().to_string();
    let mut process = Command::new(&python)
        .args(["-c", PYTHON_CLIENT, &port])
        .env("PYTHONPATH", &packages)
        .stdin(Stdio::null())
        .spawn()
        .context("cannot start the client of ROS 2's topics")?;
    let link = format!("zenoh:tcp/127.0.0.1:{port}");
    let server = Served::serve(program, scene, &["--ros2", "--ros2-control", "--ros2-link", &link])
        .and_then(|server| server.says("Glisson is at ", SERVER_START).map(|_| server));
    let status = finished_within(if server.is_ok() { ANSWERING } else { Duration::ZERO }, &mut process)?;
    server?;
    let status = status.context("the client of ROS 2's topics did not end")?;
    ensure!(status.success(), "the client of ROS 2's topics failed ({status})");
    Ok(None)
}
