//! The driver against a mock of the service: both generations, a service that restarts, one that sends rubbish.

use super::*;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};

/// Answers `/version`; on a WebSocket says nothing before it is asked for a full state, then sends states, waits for a command
/// after each, and notes the forces.
struct MockService {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    forces: Receiver<(String, DVec3)>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl MockService {
    fn start(version: &'static str, frame: fn(u64) -> String) -> Self {
        Self::at("127.0.0.1:0".parse().unwrap(), version, frame)
    }

    fn at(address: SocketAddr, version: &'static str, frame: fn(u64) -> String) -> Self {
        let listener = TcpListener::bind(address).unwrap();
        let address = listener.local_addr().unwrap();
        listener.set_nonblocking(true).unwrap();
        let stop = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&stop);
        let (forces_in, forces) = channel();
        let thread = std::thread::spawn(move || {
            while !seen.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((stream, _)) => answer(stream, version, frame, &forces_in, &seen),
                    Err(_) => std::thread::sleep(Duration::from_millis(2)),
                }
            }
        });
        Self { address, stop, forces, thread: Some(thread) }
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

impl Drop for MockService {
    fn drop(&mut self) {
        self.end();
    }
}

fn answer(
    mut stream: TcpStream,
    version: &str,
    frame: fn(u64) -> String,
    forces: &Sender<(String, DVec3)>,
    stop: &AtomicBool,
) {
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(2))).unwrap();
    let mut head = [0; 16];
    while stream.peek(&mut head).is_ok_and(|n| n < 12) {}
    if head.starts_with(b"GET /version") {
        let mut request = [0; 1000];
        let _ = stream.read(&mut request);
        let _ = write!(stream, "HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n{version}", version.len());
        return;
    }
    let Ok(mut socket) = tungstenite::accept(stream) else { return };
    let is_request = |text: &str| text.contains("force_render_full_state");
    if !socket.read().is_ok_and(|message| message.to_text().is_ok_and(is_request)) {
        return;
    }
    for number in 0.. {
        if stop.load(Ordering::Relaxed) || socket.send(Message::text(frame(number))).is_err() {
            return;
        }
        // As the real one: who does not command hears nothing more; rubbish is not answered, so it is sent again.
        if parse(&frame(number), Wanted::default()).is_ok() {
            let text = loop {
                match socket.read() {
                    Ok(Message::Text(text)) if !is_request(&text) => break text,
                    Ok(_) => {}
                    Err(_) => return,
                }
            };
            let value: serde_json::Value = serde_json::from_str(&text).unwrap();
            let command = &value["inverse3"][0]["commands"]["set_cursor_force"];
            let (key, force) = command.as_object().unwrap().iter().find(|(_, v)| v.is_object()).unwrap();
            let axis = |name: &str| force[name].as_f64().unwrap();
            let _ = forces.send((key.clone(), DVec3::new(axis("x"), axis("y"), axis("z"))));
        }
        std::thread::sleep(Duration::from_micros(500));
    }
}

fn moving(number: u64) -> String {
    let x = 1e-4 * (number % 1000) as f64;
    format!(
        r#"{{"inverse3":[{{"device_id":"04C3","state":{{"cursor_position":{{"x":{x},"y":0.1,"z":0}}}},"status":{{"calibrated":true}}}}]}}"#
    )
}

/// With a grip that tells its orientation in most frames, as long as it does.
fn gripped(number: u64) -> String {
    let orientation =
        if number.is_multiple_of(2) { r#","orientation":{"x":0,"y":0.6,"z":0,"w":0.8}"# } else { "" };
    let says = match number {
        ..600 if !number.is_multiple_of(5) => {
            format!(r#""state":{{"buttons":{{"a":true,"b":false,"c":false}}{orientation}}}"#)
        }
        _ => r#""status":{"connected":false}"#.into(),
    };
    let other = r#"{"device_id":"1103","state":{"orientation":{"x":0,"y":0,"z":0,"w":1}}}"#;
    let grips = format!(r#""wireless_verse_grip":[{{"device_id":"1102",{says}}}],"verse_grip":[{other}]"#);
    // Where it says nothing in the very first frame nobody knows of it.
    moving(number + 1).replacen('{', &format!("{{{grips},"), 1)
}

fn wait_for(device: &mut dyn HapticDevice, mut what: impl FnMut(&Result<DeviceState, DeviceFault>) -> bool) {
    let start = Instant::now();
    loop {
        let answer = device.read();
        if what(&answer) {
            return;
        }
        assert!(start.elapsed() < Duration::from_secs(15), "{answer:?}");
        // While it is lost it takes nothing.
        let _ =
            device.write(&ForceCommand { force_n: DVec3::new(0.5, -1.0, 0.25), ..ForceCommand::default() });
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn both_generations_get_their_commands_and_give_their_states() {
    for (version, key) in [("{\"version\":\"3.5.2\"}", "vector"), ("3.1.0", "values")] {
        let mut service = MockService::start(version, moving);
        let mut device = open(&service.address.to_string()).unwrap();
        wait_for(&mut *device, |a| a.as_ref().is_ok_and(|s| s.position_m.x > 1e-3 && s.position_m.y == 0.1));
        let given = std::iter::from_fn(|| {
            device
                .write(&ForceCommand { force_n: DVec3::new(0.5, -1.0, 0.25), ..ForceCommand::default() })
                .unwrap();
            service.forces.recv_timeout(Duration::from_secs(5)).ok()
        });
        let first = given.take(5_000).find(|(_, force)| *force != DVec3::ZERO);
        assert_eq!(first, Some((key.to_owned(), DVec3::new(0.5, -1.0, 0.25))));
        drop(device);
        service.end();
        // The last word is no force.
        assert_eq!(service.forces.try_iter().last().map(|(_, force)| force), Some(DVec3::ZERO));
    }
}

#[test]
fn a_grip_that_leaves_frames_out_turns_nothing_and_one_that_falls_silent_is_told() {
    let service = MockService::start("3.5.0", |number| gripped(number + 1));
    let mut device = open(&service.address.to_string()).unwrap();
    let turn = glam::DQuat::from_xyzw(0.0, 0.6, 0.0, 0.8);
    let mut n_states = 0;
    wait_for(&mut *device, |answer| match answer {
        Ok(state) if state.orientation.is_some() || n_states > 0 => {
            n_states += 1;
            assert!(state.orientation.unwrap().abs_diff_eq(turn, 1e-12), "{state:?}");
            assert_eq!((state.buttons, state.jaw_opening), (1, 1.0));
            false
        }
        Err(DeviceFault::Lost(reason)) => reason.contains("grip says nothing"),
        _ => false,
    });
    assert!(n_states > 20, "{n_states}");
    // No force is given while nobody knows where the handle points.
    std::thread::sleep(Duration::from_millis(20));
    assert_eq!(service.forces.try_iter().last().map(|(_, force)| force), Some(DVec3::ZERO));
}

#[test]
fn a_service_that_restarts_is_found_again() {
    let mut service = MockService::start("3.5.0", moving);
    let address = service.address;
    let mut device = open(&address.to_string()).unwrap();
    wait_for(&mut *device, Result::is_ok);
    service.end();
    drop(service);
    wait_for(&mut *device, |a| matches!(a, Err(DeviceFault::Lost(reason)) if reason.contains("service")));
    let _again = MockService::at(address, "3.5.0", moving);
    wait_for(&mut *device, Result::is_ok);
}

#[test]
fn rubbish_is_dropped_and_a_device_that_is_not_calibrated_gets_no_force() {
    let service = MockService::start("3.5.0", |number| match number % 3 {
        0 => "{\"inverse3\":[{\"device_id\":7}]".into(),
        1 => "rubbish".into(),
        _ => moving(number),
    });
    let mut device = open(&service.address.to_string()).unwrap();
    wait_for(&mut *device, |a| a.as_ref().is_ok_and(|s| s.position_m.x > 0.0));

    let service = MockService::start("3.5.0", |number| moving(number).replace("true", "false"));
    let mut device = open(&service.address.to_string()).unwrap();
    wait_for(
        &mut *device,
        |a| matches!(a, Err(DeviceFault::Lost(reason)) if reason.contains("not calibrated")),
    );
    assert!(service.forces.try_iter().all(|(_, force)| force == DVec3::ZERO));
}

/// A service that answers `/version` and then says what `say` says, without end.
fn talks(say: fn(&mut WebSocket<TcpStream>) -> bool) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    // It ends with the test's process.
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            std::thread::spawn(move || {
                let mut head = [0; 16];
                while stream.peek(&mut head).is_ok_and(|n| n < 12) {}
                if head.starts_with(b"GET /version") {
                    let _ = stream.read(&mut [0; 1000]);
                    let _ = write!(stream, "HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\n3.5.0");
                    return;
                }
                let Ok(mut socket) = tungstenite::accept(stream) else { return };
                while say(&mut socket) {
                    std::thread::sleep(Duration::from_millis(1));
                }
            });
        }
    });
    address
}

#[test]
fn a_service_that_never_says_anything_of_use_is_lost_and_the_driver_ends_soon() {
    let binary = |socket: &mut WebSocket<TcpStream>| socket.send(Message::binary(vec![1; 20])).is_ok();
    let pings = |socket: &mut WebSocket<TcpStream>| socket.send(Message::Ping(vec![1].into())).is_ok();
    // The head of a text of 100 kB, and then a byte in a while, each before its reader's patience ends.
    let drips = |socket: &mut WebSocket<TcpStream>| {
        let stream = socket.get_mut();
        let mut begun = stream.write_all(&[0x81, 127, 0, 0, 0, 0, 0, 1, 0, 0]);
        while begun.is_ok() {
            std::thread::sleep(Duration::from_millis(100));
            begun = stream.write_all(b" ");
        }
        false
    };
    for (say, reason) in [
        (binary as fn(&mut WebSocket<TcpStream>) -> bool, "cannot be used"),
        (pings, "cannot be used"),
        (drips, "stopped answering"),
    ] {
        let mut device = open(&talks(say).to_string()).unwrap();
        wait_for(&mut *device, |a| matches!(a, Err(DeviceFault::Lost(said)) if said.contains(reason)));
        let start = Instant::now();
        drop(device);
        assert!(start.elapsed() < Duration::from_secs(4), "{reason}: {:?}", start.elapsed());
    }
}
