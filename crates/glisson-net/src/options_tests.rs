//! One zenoh session for link and topics.

use super::*;
use clap::Parser;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    net: NetArgs,
}

fn line(rest: &[&str]) -> NetArgs {
    Line::try_parse_from([&["glisson"], rest].concat()).map_err(|e| e.to_string()).unwrap().net
}

#[test]
fn topics_go_over_the_links_session_where_that_is_zenohs() {
    let over = |rest: &[&str]| line(rest).ros2_over();
    let at = |locator: &str| ZenohAddress::Locator(locator.to_owned());
    let simulation = ["--role", "simulation", "--ros2", "--link"];
    let linked = |link, more: &[&str]| over(&[&simulation[..], &[link], more].concat());
    assert_eq!(over(&["--ros2"]).unwrap(), Ros2Over::Own(at(ROS2_ROUTER)));
    let elsewhere = ["--ros2", "--ros2-link", "zenoh:tcp/10.0.0.1:7447"];
    assert_eq!(over(&elsewhere).unwrap(), Ros2Over::Own(at("tcp/10.0.0.1:7447")));
    assert_eq!(linked("udp://127.0.0.1:1", &[]).unwrap(), Ros2Over::Own(at(ROS2_ROUTER)));
    let zenoh = "zenoh:tcp/127.0.0.1:7000";
    for more in [&[][..], &["--ros2-link", zenoh]] {
        assert_eq!(linked(zenoh, more).unwrap(), Ros2Over::Link(at("tcp/127.0.0.1:7000")));
    }
    let error = linked(zenoh, &["--ros2-link", "zenoh:tcp/127.0.0.1:7447"]).unwrap_err().to_string();
    assert!(error.contains("contradicts --link zenoh:tcp/127.0.0.1:7000"), "{error}");
    let error = over(&["--ros2", "--ros2-link", "udp://127.0.0.1:1"]).unwrap_err().to_string();
    assert!(error.contains("over zenoh: only"), "{error}");
}

#[cfg(feature = "net")]
mod over_zenoh {
    use super::*;
    use crate::igtl::tests::published;
    use crate::ros2::Described;
    use crate::tests::{HapticsEnd, SimulationEnd, identity, soon};
    use crate::zenoh_link::link_over;
    use glisson::math::DVec3;
    use glisson_runtime::steering::Steering;
    use zenoh::Wait;

    #[test]
    fn link_and_topics_share_one_session_and_end_apart() {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let address = format!("zenoh:tcp/127.0.0.1:{port}");
        let net = line(&["--role", "simulation", "--link", &address, "--ros2", "5"]);
        let over = net.ros2_session(&net.ros2_over().unwrap()).unwrap();
        let link = net.link().unwrap().unwrap();
        let id = link.zenoh_session().unwrap().zid();
        assert_eq!((over.session.zid(), over.is_own), (id, false));
        let (sender, receiver) = tokio::sync::watch::channel(published(1));
        let home = ToolInput::at(DVec3::Z, DVec3::Z);
        let steering = Steering::alone(std::sync::mpsc::channel().0);
        let node = crate::ros2::spawn(over, 5, Described::named("hook", home, false), receiver, &steering);
        let (opened, _) = link.open(SceneHash([0; 32]), 1).unwrap();
        let mut simulation = SimulationEnd::start(opened, identity(Role::Simulation, 1));

        // Another program has one session, too, and sees one.
        let there = ZenohAddress::Locator(format!("tcp/127.0.0.1:{port}"));
        let session = open_session(&there, Role::Haptics).unwrap();
        let mut haptics =
            HapticsEnd::start(link_over(session.clone(), Role::Haptics).unwrap(), identity(Role::Haptics, 1));
        let tokens = || session.liveliness().get("@ros2_lv/5/**").wait().unwrap().into_iter().count();
        soon("the node", || tokens() > 3);
        let mut x_m = || simulation.tool.motions.get().pose.tip_in_world_m.x;
        haptics.move_to(0.5);
        soon("a pose over the link", || x_m() == 0.5);
        let peers: Vec<_> = session.info().peers_zid().wait().collect();
        assert_eq!(peers, [id]);
        // The topics end; the link goes on.
        drop(sender);
        node.unwrap().join().unwrap();
        soon("the node's end", || tokens() == 0);
        haptics.move_to(0.6);
        soon("another pose", || x_m() == 0.6);
    }

    #[test]
    fn topics_that_others_could_reach_are_opened_only_when_told_so() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("key");
        std::fs::write(&key, "0123456789abcdef").unwrap();
        let file = folder.path().join("open.json5");
        std::fs::write(&file, "{ connect: { endpoints: ['tcp/192.0.2.1:7447'] } }").unwrap();
        let (key, file) = (key.to_string_lossy(), format!("zenoh:{}", file.display()));
        let sealed = ["--role", "simulation", "--link", "zenoh:", "--link-key", &key];
        for (rest, words) in [
            (&["--ros2-link", "zenoh:", "--ros2-control"][..], "moves the instruments"),
            (&["--ros2-link", "zenoh:"], "sees organ"),
            (&["--ros2-link", "zenoh:tcp/192.0.2.1:7447"], "(tcp/192.0.2.1:7447)"),
            (&["--ros2-link", &file], "(tcp/192.0.2.1:7447)"),
            // The key seals the link, not the topics.
            (&sealed, "(multicast)"),
        ] {
            let net = line(&[&["--ros2"], rest].concat());
            let over = net.ros2_over().unwrap();
            let error = net.ros2_session(&over).err().unwrap().to_string();
            assert!(error.contains(words) && error.contains("--ros2-open"), "{rest:?}: {error}");
            let net = line(&[&["--ros2", "--ros2-open"], rest].concat());
            let (Ros2Over::Own(address) | Ros2Over::Link(address)) = &over;
            assert!(net.check_ros2(address).is_ok());
        }
    }

    #[test]
    fn a_link_that_others_could_reach_needs_a_key_also_when_topics_ask_first() {
        let net = line(&["--role", "simulation", "--link", "zenoh:tcp/0.0.0.0:7000", "--ros2"]);
        let error = net.ros2_session(&net.ros2_over().unwrap()).err().unwrap().to_string();
        assert!(error.contains("--link-key"), "{error}");
    }
}
