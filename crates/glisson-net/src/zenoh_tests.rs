//! Two ends over zenoh (feature `net`): who comes late, a cut, TLS; and ROS 2's topics as a second session sees them.

use super::igtl::tests::published;
use super::link::{Role, ZenohAddress};
use super::link_address::LinkAddress;
use super::ros2::{Described, Over};
use super::tests::{HapticsEnd, SimulationEnd, identity, soon};
use super::zenoh_link::{config, open, open_session};
use glisson::math::{DMat3, DVec3};
use glisson::tool::ToolInput;
use glisson_runtime::live::Command;
use glisson_runtime::published::Published;
use glisson_runtime::steering::Steering;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair, KeyUsagePurpose};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use tokio::sync::watch;
use zenoh::Wait;
use zenoh::bytes::ZBytes;

fn free_address() -> SocketAddr {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap()
}

fn locator(address: SocketAddr) -> ZenohAddress {
    ZenohAddress::Locator(format!("tcp/{address}"))
}

fn haptics(address: &ZenohAddress) -> HapticsEnd {
    HapticsEnd::start(open(address, Role::Haptics).unwrap(), identity(Role::Haptics, 1))
}

fn simulation(address: &ZenohAddress) -> SimulationEnd {
    SimulationEnd::start(open(address, Role::Simulation).unwrap(), identity(Role::Simulation, 1))
}

fn x_m(simulation: &mut SimulationEnd) -> f64 {
    simulation.tool.motions.get().pose.tip_in_world_m.x
}

#[test]
fn zenoh_carries_poses_and_models_and_finds_a_simulation_that_comes_later() {
    let address = locator(free_address());
    let mut haptics = haptics(&address);
    haptics.move_to(0.5);
    let mut first = simulation(&address);
    soon("the pose", || x_m(&mut first) == 0.5);
    first.publish(7);
    soon("the model", || haptics.models.get().model.step == 7);
    assert_eq!(first.conversation.report().n_refused, 0);
    drop(first);
    let mut second = simulation(&address);
    haptics.move_to(0.6);
    soon("the pose again", || x_m(&mut second) == 0.6);
}

/// Passes bytes on between those who connect to it and `to`; while it is cut they wait, as in a broken network.
struct TcpProxy {
    address: SocketAddr,
    is_cut: Arc<AtomicBool>,
}

impl TcpProxy {
    fn to(to: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let is_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&is_cut);
        // It ends with the test's process, and its connections with their ends.
        std::thread::spawn(move || {
            for front in listener.incoming().map_while(Result::ok) {
                let Ok(back) = TcpStream::connect(to) else { continue };
                for (from, to) in [
                    (front.try_clone().unwrap(), back.try_clone().unwrap()),
                    (back.try_clone().unwrap(), front.try_clone().unwrap()),
                ] {
                    let cut = Arc::clone(&cut);
                    std::thread::spawn(move || pass_on(from, to, &cut));
                }
            }
        });
        Self { address, is_cut }
    }
}

fn pass_on(mut from: TcpStream, mut to: TcpStream, is_cut: &AtomicBool) {
    let _ = to.set_nodelay(true);
    let mut bytes = [0; 1 << 16];
    while let Ok(n) = from.read(&mut bytes) {
        while is_cut.load(Ordering::Relaxed) {
            std::thread::sleep(Duration::from_millis(5));
        }
        if n == 0 || to.write_all(&bytes[..n]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(std::net::Shutdown::Both);
}

#[test]
fn zenoh_goes_on_after_a_cut_with_the_newest_state() {
    let listens_at = free_address();
    let proxy = TcpProxy::to(listens_at);
    let mut simulation = simulation(&locator(listens_at));
    let mut haptics = haptics(&locator(proxy.address));
    haptics.move_to(0.1);
    soon("the pose", || x_m(&mut simulation) == 0.1);
    simulation.publish(1);
    soon("the model", || haptics.models.get().model.step == 1);

    proxy.is_cut.store(true, Ordering::Relaxed);
    soon("the cut", || !simulation.tool.motions.get().is_held);
    let cut = Instant::now();
    let mut moved = 0;
    while cut.elapsed() < Duration::from_secs(2) {
        moved += 1;
        haptics.move_to(0.1 + 1e-5 * f64::from(moved));
        std::thread::sleep(Duration::from_millis(1));
    }
    simulation.publish(2);
    assert_eq!((x_m(&mut simulation), haptics.models.get().model.step), (0.1, 1));
    proxy.is_cut.store(false, Ordering::Relaxed);
    haptics.move_to(0.7);
    let mut last_x_m = 0.1;
    soon("the newest pose", || {
        let x_m = x_m(&mut simulation);
        assert!(x_m >= last_x_m, "{x_m} after {last_x_m}");
        last_x_m = x_m;
        x_m == 0.7
    });
    soon("the newest model", || haptics.models.get().model.step == 2);
    let report = simulation.conversation.report();
    assert!(report.is_up && report.n_cuts >= 1 && report.n_refused == 0, "{report:?}");
}

/// Makes certificates.
struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pem: String,
}

impl Authority {
    fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::new()).unwrap();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::DigitalSignature];
        let key = KeyPair::generate().unwrap();
        let pem = params.self_signed(&key).unwrap().pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    /// Writes NAME.pem and NAME.key for the host 127.0.0.1.
    fn sign(&self, folder: &Path, name: &str) {
        let params = CertificateParams::new(vec!["127.0.0.1".to_owned()]).unwrap();
        let key = KeyPair::generate().unwrap();
        let certificate = params.signed_by(&key, &self.issuer).unwrap();
        std::fs::write(folder.join(format!("{name}.pem")), certificate.pem()).unwrap();
        std::fs::write(folder.join(format!("{name}.key")), key.serialize_pem()).unwrap();
    }
}

/// The two configuration files of `docs/network.md`, `whose` naming the certificate of the haptics machine.
fn tls_files(folder: &Path, at: SocketAddr, whose: &str) -> [ZenohAddress; 2] {
    let path = |name: &str| serde_json::to_string(&folder.join(name)).unwrap();
    let (ca, simulation) = (path("ca.pem"), [path("simulation.key"), path("simulation.pem")]);
    let haptics = [path(&format!("{whose}.key")), path(&format!("{whose}.pem"))];
    let listen = format!(
        "{{ mode: 'peer', listen: {{ endpoints: ['tls/{at}'] }}, transport: {{ link: {{ tls: {{ \
         root_ca_certificate: {ca}, enable_mtls: true, listen_private_key: {}, listen_certificate: {} }} }} }} }}",
        simulation[0], simulation[1]
    );
    let connect = format!(
        "{{ mode: 'peer', connect: {{ endpoints: ['tls/{at}'] }}, transport: {{ link: {{ tls: {{ \
         root_ca_certificate: {ca}, enable_mtls: true, connect_private_key: {}, connect_certificate: {} }} }} }} }}",
        haptics[0], haptics[1]
    );
    [("listen.json5", listen), ("connect.json5", connect)].map(|(name, text)| {
        std::fs::write(folder.join(name), text).unwrap();
        ZenohAddress::File(folder.join(name))
    })
}

#[test]
fn tls_lets_in_who_has_a_certificate_and_tells_who_has_not_why() {
    let folder = tempfile::tempdir().unwrap();
    let (ours, another) = (Authority::new("ours"), Authority::new("another"));
    std::fs::write(folder.path().join("ca.pem"), &ours.pem).unwrap();
    ours.sign(folder.path(), "simulation");
    ours.sign(folder.path(), "haptics");
    another.sign(folder.path(), "stranger");
    let at = free_address();
    let [listen, stranger] = tls_files(folder.path(), at, "stranger");
    let mut simulation = simulation(&listen);
    let mut refused = haptics(&stranger);
    refused.move_to(0.3);
    soon("a reason on both sides", || {
        let lines = super::zenoh_log::lines();
        let tells = |texts: [&str; 2]| lines.iter().any(|line| texts.iter().all(|text| line.contains(text)));
        // The one that connects, and the one that listens.
        tells([&at.to_string(), "the other machine refuses this one's certificate"])
            && tells(["a connection was refused", "invalid peer certificate: UnknownIssuer"])
    });
    assert_eq!(simulation.conversation.report().counts.n_taken, 0);
    drop(refused);

    let [_, known] = tls_files(folder.path(), at, "haptics");
    let mut haptics = haptics(&known);
    haptics.move_to(0.4);
    soon("the pose through TLS", || x_m(&mut simulation) == 0.4);
    simulation.publish(3);
    soon("the model through TLS", || haptics.models.get().model.step == 3);
    // Only through TLS: a session without it finds nobody.
    let mut plain = self::haptics(&locator(at));
    plain.move_to(0.9);
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(x_m(&mut simulation), 0.4);
}

#[test]
fn files_open_no_door_that_they_do_not_mention_and_wrong_ones_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = |text: &str| {
        let path = folder.path().join("zenoh.json5");
        std::fs::write(&path, text).unwrap();
        config(&ZenohAddress::File(path), Role::Haptics)
    };
    let silent = file("{ mode: 'peer', connect: { endpoints: ['tls/127.0.0.1:1'] } }").unwrap();
    assert_eq!(silent.get_json("listen/endpoints").unwrap(), "[]");
    assert_eq!(silent.get_json("scouting/multicast/enabled").unwrap(), "false");
    let open =
        file("{ scouting: { multicast: { enabled: true } }, listen: { endpoints: ['tcp/127.0.0.1:1'] } }");
    let open = open.unwrap();
    assert!(open.get_json("listen/endpoints").unwrap().contains("tcp/127.0.0.1:1"));
    assert_eq!(open.get_json("scouting/multicast/enabled").unwrap(), "true");
    let error = file("{ mode: 'captain' }").unwrap_err().to_string();
    assert!(error.contains("zenoh.json5: not a configuration of zenoh"), "{error}");
    let missing: LinkAddress = "zenoh:nowhere.json5".parse().unwrap();
    let error = missing.open(Role::Haptics, false).err().unwrap().to_string();
    assert!(error.starts_with("nowhere.json5: "), "{error}");
}

#[test]
fn files_that_let_strangers_in_need_a_key() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("zenoh.json5");
    let address = LinkAddress::Zenoh(ZenohAddress::File(path.clone()));
    let refusal = |text: &str| {
        std::fs::write(&path, text).unwrap();
        assert!(address.check(true).is_ok(), "{text}");
        address.check(false).err().map(|error| error.to_string()).unwrap_or_default()
    };
    for (open, door) in [
        ("{ listen: { endpoints: ['tcp/0.0.0.0:7447'] } }", "(tcp/0.0.0.0:7447)"),
        ("{ connect: { endpoints: ['tls/192.0.2.1:1', 'udp/192.0.2.1:2'] } }", "(tls/192.0.2.1:1)"),
        (
            "{ connect: { endpoints: { peer: ['tls/192.0.2.1:1'], router: ['udp/192.0.2.1:2'] } }, transport: { link: \
             { tls: { enable_mtls: true } } } }",
            "(udp/192.0.2.1:2)",
        ),
        ("{ listen: { endpoints: ['tls/0.0.0.0:7447'] } }", "(tls/0.0.0.0:7447)"),
        ("{ scouting: { multicast: { enabled: true } } }", "(multicast)"),
    ] {
        let error = refusal(open);
        assert!(error.contains(door) && error.contains("--link-key"), "{open}: {error}");
    }
    for closed in [
        "{ mode: 'peer' }",
        "{ listen: { endpoints: ['tcp/127.0.0.1:7447'] } }",
        "{ listen: { endpoints: ['quic/0.0.0.0:7447'] }, connect: { endpoints: ['tcp/localhost:1'] }, transport: { link: { \
         tls: { enable_mtls: true } } } }",
    ] {
        assert_eq!(refusal(closed), "", "{closed}");
    }
}

/// What a client of CRTK would have: a session of its own.
struct Client {
    session: zenoh::Session,
}

/// CDR as a client writes it, little endian: time 0, no frame.
fn header() -> Vec<u8> {
    [&[0, 1, 0, 0][..], &[0; 8], &[1, 0, 0, 0, 0]].concat()
}

fn padded(mut bytes: Vec<u8>, size: usize) -> Vec<u8> {
    bytes.resize(4 + (bytes.len() - 4).next_multiple_of(size), 0);
    bytes
}

fn pose_message(tip_m: DVec3, turn: DMat3) -> Vec<u8> {
    let mut bytes = padded(header(), 8);
    let quaternion = glam::DQuat::from_mat3(&turn);
    for x in tip_m.to_array().into_iter().chain(quaternion.to_array()) {
        bytes.extend(x.to_le_bytes());
    }
    bytes
}

fn string_message(text: &str) -> Vec<u8> {
    let mut bytes = padded(header(), 4);
    bytes.extend((text.len() as u32 + 1).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.push(0);
    bytes
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

impl Client {
    fn subscribe(
        &self,
        topic: &str,
    ) -> zenoh::pubsub::Subscriber<zenoh::handlers::FifoChannelHandler<zenoh::sample::Sample>> {
        self.session.declare_subscriber(format!("5{topic}/**")).wait().unwrap()
    }

    fn send(&self, topic: &str, type_and_hash: &str, message: Vec<u8>) {
        self.session.put(format!("5{topic}/{type_and_hash}"), ZBytes::from(message)).wait().unwrap();
    }

    fn command(&self, text: &str) {
        let message = "crtk_msgs::msg::dds_::StringStamped_/RIHS01_\
            83efb802e6596e03f69ac322e3231037329946f2bd13ed48874d97f5b8f5db1d";
        self.send("/hook/state_command", message, string_message(text));
    }

    fn pose(&self, topic: &str, tip_m: DVec3, turn: DMat3) {
        let message = "geometry_msgs::msg::dds_::PoseStamped_/RIHS01_\
            10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8";
        self.send(topic, message, pose_message(tip_m, turn));
    }
}

/// A router's place, the node, and what the node tells the simulation.
fn ros2_node(
    takes_orders: bool,
) -> (Client, watch::Sender<Arc<Published>>, Receiver<Command>, std::thread::JoinHandle<()>) {
    let address = locator(free_address());
    let session = zenoh::open(config(&address, Role::Simulation).unwrap()).wait().unwrap();
    let (commands, ordered) = channel();
    let (sender, receiver) = watch::channel(published(1));
    let home = ToolInput::at(DVec3::new(0.01, 0.02, 0.05), DVec3::Z);
    let described = Described::named("hook", home, takes_orders);
    let steering = Steering::alone(commands);
    let over = Over { session: open_session(&address, Role::Haptics).unwrap(), is_own: true };
    let thread = super::ros2::spawn(over, 5, described, receiver, &steering).unwrap();
    (Client { session }, sender, ordered, thread)
}

#[test]
fn ros2_topics_are_there_with_their_tokens_and_attachments() {
    let (client, sender, _, thread) = ros2_node(false);
    let poses = client.subscribe("/hook/measured_cp");
    let velocities = client.subscribe("/hook/measured_cv");
    let forces = client.subscribe("/hook/body/measured_cf");
    let states = client.subscribe("/hook/operating_state");
    let mut seen = [const { None }; 4];
    let mut step = 1;
    soon("a message of each topic", || {
        step += 1;
        sender.send_replace(published(step));
        for (seen, topic) in seen.iter_mut().zip([&poses, &velocities, &forces, &states]) {
            if let Ok(Some(sample)) = topic.try_recv() {
                *seen = Some(sample);
            }
        }
        seen.iter().all(Option::is_some)
    });
    let [pose, velocity, force, state] = seen.map(Option::unwrap);
    assert!(pose.key_expr().as_str().contains("/geometry_msgs::msg::dds_::PoseStamped_/RIHS01_10f3786d"));
    let bytes = pose.payload().to_bytes();
    assert_eq!(bytes[..4], [0, 1, 0, 0]);
    // Stamp, "patient_lps" and its zero: 24 bytes behind the encapsulation, aligned to 8 already.
    assert_eq!([28, 36, 44].map(|at| f64_at(&bytes, at)), [0.01, 0.02, 0.03]);
    assert_eq!(pose.attachment().unwrap().len(), 33);
    let sequence = pose.attachment().unwrap().to_bytes()[..8].try_into().map(i64::from_le_bytes).unwrap();
    assert!(sequence >= 1, "{sequence}");
    // The same simulated time again and again: no velocity, which CRTK marks by the time 0.
    assert_eq!(velocity.payload().to_bytes()[4..12], [0; 8]);
    assert!(force.key_expr().as_str().contains("WrenchStamped_/RIHS01_8dc3deaf"));
    let state = state.payload().to_bytes().into_owned();
    assert!(state.windows(6).any(|bytes| bytes == b"PAUSED"), "nobody may move it this way: {state:?}");
    // Node, state, pose, velocity, force, jaw, surface.
    let tokens = client.session.liveliness().get("@ros2_lv/5/**").wait().unwrap();
    assert_eq!(tokens.into_iter().count(), 7);
    drop(sender);
    thread.join().unwrap();
}

#[test]
fn a_client_of_crtk_enables_moves_and_disables_an_instrument() {
    let (client, sender, ordered, thread) = ros2_node(true);
    let states = client.subscribe("/hook/operating_state");
    let mut state = String::new();
    let mut await_state = |expected: &str| {
        soon(expected, || {
            while let Ok(Some(sample)) = states.try_recv() {
                let bytes = sample.payload().to_bytes();
                // Stamp, frame; then the state's length at 24 behind the encapsulation.
                let n = u32::from_le_bytes(bytes[28..32].try_into().unwrap()) as usize;
                let flags = &bytes[32 + n..];
                let busy = if flags[1] == 1 { " busy" } else { "" };
                state = String::from_utf8_lossy(&bytes[32..31 + n]).into_owned() + busy;
                if state == expected {
                    return true;
                }
            }
            false
        });
    };
    await_state("DISABLED");
    let measured = published(1).snapshot.tools[0].pose;
    let turn = glisson::tool::pose::ToolFrame::of(&measured).world_from_tool;
    let next = |x_m: f64| measured.tip_in_world_m + DVec3::X * x_m;
    // Refused: not enabled.
    client.pose("/hook/servo_cp", next(0.001), turn);
    client.command("enable");
    await_state("ENABLED");
    assert!(ordered.try_recv().is_err());
    client.pose("/hook/servo_cp", next(0.002), turn);
    let Ok(Command::Tool { tool: 0, pose }) = ordered.recv_timeout(Duration::from_secs(20)) else { panic!() };
    assert!(
        pose.tip_in_world_m.distance(next(0.002)) < 1e-12 && pose.shaft_in_world.distance(DVec3::Z) < 1e-12
    );
    // Refused: too far.
    client.pose("/hook/servo_cp", next(0.2), turn);
    client.pose("/hook/move_cp", next(0.01), turn);
    await_state("ENABLED busy");
    await_state("ENABLED");
    let way: Vec<DVec3> = ordered
        .try_iter()
        .map(|command| match command {
            Command::Tool { pose, .. } => pose.tip_in_world_m,
            other => panic!("{other:?}"),
        })
        .collect();
    assert!(way.len() > 3 && way.last().unwrap().distance(next(0.01)) < 1e-12, "{way:?}");
    assert!(way.windows(2).all(|pair| pair[1].x >= pair[0].x), "{way:?}");
    client.command("pause");
    await_state("PAUSED");
    client.command("resume");
    await_state("ENABLED");
    client.command("home");
    await_state("ENABLED busy");
    client.command("disable");
    await_state("DISABLED");
    drop(sender);
    thread.join().unwrap();
}
