use super::super::{SimulatedBoard, SimulatedLine, connect, serve_board};
use super::*;
use glam::DVec3;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::{InstrumentType, TrocarJoints};
use glisson::math::SeededRandom;
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const TAG: InstrumentTag = InstrumentTag { instrument: InstrumentType::PalpationProbe, serial: 7 };

fn start() -> TrocarJoints {
    TrocarJoints { pitch_rad: 0.3, roll_rad: -0.5, insertion_m: 0.15, ..TrocarJoints::default() }
}

fn board(profile: TrocarProfile) -> SimulatedBoard {
    SimulatedBoard::new(Mechanism::new(profile, start()), TAG, 5).homed()
}

fn device(board: SimulatedBoard, settings: BoardSettings) -> TrocarDevice<SimulatedLine> {
    let mut device = TrocarDevice::new(SimulatedLine::new(board), settings);
    assert!(device.greet().unwrap());
    device
}

fn reason(found: Result<DeviceState, DeviceFault>) -> String {
    match found {
        Err(DeviceFault::Lost(why)) => why.to_string(),
        other => panic!("not lost: {other:?}"),
    }
}

#[test]
fn a_force_goes_through_the_bytes_to_the_hand() {
    for mut profile in [TrocarProfile::built(), TrocarProfile::specified()] {
        // So that quantised outputs alone remain.
        profile.limits.tilt_n_m = 6.0;
        let settings = BoardSettings { mapping: Mapping::VirtualWork, ..BoardSettings::new(profile) };
        let mut device = device(board(profile), settings);
        let force_n = DVec3::new(1.0, -0.7, -1.5);
        for _ in 0..1500 {
            let state = device.read().unwrap();
            let true_m = device.line_mut().board.mechanism.joints.pose().tip_m;
            assert!(state.position_m.distance(true_m) < 2.0 * profile.tip_resolution_m(0.15));
            device.write(&ForceCommand { force_n, ..ForceCommand::default() }).unwrap();
        }
        let mechanism = &device.line_mut().board.mechanism;
        let on_hand = AxisEfforts::from_array(mechanism.hand_efforts().map(|effort| -effort));
        let felt_n = glisson::haptics::trocar::statics::felt(&mechanism.joints, &on_hand).force_n;
        assert!(felt_n.distance(force_n) < 2e-3, "{felt_n}");
        assert_eq!(device.report().n_lost, 0);
    }
}

#[test]
fn nothing_is_rendered_before_the_marks_are_passed() {
    let mechanism = Mechanism::new(TrocarProfile::built(), start());
    let board = SimulatedBoard::new(mechanism, TAG, 6);
    let mut device = device(board, BoardSettings::new(TrocarProfile::built()));
    assert!(reason(device.read()).starts_with("positions are not known"));
    device.write(&ForceCommand { force_n: DVec3::X, ..ForceCommand::default() }).unwrap();
    assert_eq!(device.line_mut().board.motor_efforts(), AxisEfforts::default());
    // The hand takes it through upright, turns it, pulls it out, opens and closes the jaws.
    let sweep = TrocarJoints { pitch_rad: -0.2, roll_rad: 0.2, ..TrocarJoints::default() };
    for target in [sweep, TrocarJoints { self_rotation_rad: -1.0, insertion_m: 0.1, ..sweep }, start()] {
        device.line_mut().board.mechanism.hand_target = Some(target);
        for _ in 0..1500 {
            let _ = device.read();
        }
    }
    let state = device.read().unwrap();
    let true_m = device.line_mut().board.mechanism.joints.pose().tip_m;
    assert!(state.position_m.distance(true_m) < 2e-4);
}

#[test]
fn instruments_are_identified_and_missed() {
    let mut device = device(board(TrocarProfile::built()), BoardSettings::new(TrocarProfile::built()));
    for instrument in InstrumentType::ALL {
        let tag = InstrumentTag { instrument, serial: 300 };
        device.line_mut().board.change_instrument(None);
        assert_eq!(reason(device.read()), "no instrument is in the trocar");
        assert_eq!(device.instrument(), None);
        device.line_mut().board.change_instrument(Some(tag));
        let _ = device.read();
        assert_eq!(device.instrument(), Some(tag));
    }
    // Its tip passes O on its way in: the insertion is known at once.
    for _ in 0..3000 {
        let _ = device.read();
    }
    let state = device.read().unwrap();
    assert!((state.position_m.length() - 0.15).abs() < 3e-4, "{}", state.position_m.length());
}

/// A real board would push a hand that holds scissors as if it held a probe.
#[test]
fn an_instrument_that_the_scene_does_not_have_or_whose_tag_cannot_be_read_gets_no_force() {
    let profile = TrocarProfile::built();
    let settings = BoardSettings { tool_kind: Some("probe"), ..BoardSettings::new(profile) };
    let mut device = device(board(profile), settings);
    assert!(device.hear().unwrap() && device.check_instrument().is_ok());
    assert!(device.read().is_ok());
    assert_eq!(device.inserted(), Some(InsertedInstrument { name: "palpation probe", serial: 7 }));
    device.line_mut().board.smear_tag(true);
    assert_eq!(
        reason(device.read()),
        "the tag of the instrument in the trocar cannot be read: put it in again"
    );
    assert_eq!((device.inserted(), device.tag().map(|tag| tag.is_err())), (None, Some(true)));
    device.line_mut().board.smear_tag(false);
    assert!(device.read().is_ok());
    for instrument in InstrumentType::ALL {
        device.line_mut().board.change_instrument(Some(InstrumentTag { instrument, serial: 9 }));
        // Its marks have to be passed first where it is right.
        let found = (0..3000).map(|_| device.read()).last().unwrap();
        if instrument == InstrumentType::PalpationProbe {
            assert!(found.is_ok() && device.check_instrument().is_ok());
            continue;
        }
        let why = reason(found);
        let kind = format!("\"{}\"", instrument.tool_kind());
        assert!(why.contains(&kind) && why.ends_with("put another one in"), "{why}");
        assert!(why.contains(instrument.name()), "{why}");
        let error = device.check_instrument().unwrap_err().to_string();
        assert!(
            error.contains(instrument.name()) && error.contains("put in one of: palpation probe;"),
            "{error}"
        );
        assert_eq!(device.inserted().unwrap().serial, 9);
    }
}

#[test]
fn an_emergency_stop_and_a_silent_host_leave_the_hand_alone() {
    let profile = TrocarProfile::built();
    let mut device = device(board(profile), BoardSettings::new(profile));
    let push = ForceCommand { force_n: DVec3::new(0.0, 0.0, -2.0), ..ForceCommand::default() };
    let tick = |device: &mut TrocarDevice<SimulatedLine>| {
        let _ = device.read();
        device.write(&push).unwrap();
        device.line_mut().board.motor_efforts().translation_n
    };
    device.read().unwrap();
    assert!((tick(&mut device) + 2.0 * start().direction().z).abs() < 1e-3);
    device.line_mut().board.press_stop(true);
    assert_eq!(tick(&mut device), 0.0);
    assert_eq!(reason(device.read()), "the emergency stop is pressed");
    device.line_mut().board.press_stop(false);
    tick(&mut device);
    assert!(device.line_mut().board.motor_efforts().translation_n < -1.0);
    // A host that says nothing more: after 10 ms the motors rest.
    for k in 1..=12 {
        device.read().unwrap();
        let runs = device.line_mut().board.motor_efforts().translation_n < 0.0;
        assert_eq!(runs, k <= 10, "{k} ms");
    }
}

#[test]
fn another_profile_is_refused() {
    let line = SimulatedLine::new(board(TrocarProfile::specified()));
    let mut device = TrocarDevice::new(line, BoardSettings::new(TrocarProfile::built()));
    let error = device.greet().unwrap_err().to_string();
    assert_eq!(
        error,
        "board 00000001 has the profile \"specified\", not \"built\"; there are: built, specified"
    );
    assert!(matches!(device.read(), Err(DeviceFault::Failed(_))));
}

/// A line that says what it is given.
struct Said(Vec<u8>);

impl ByteLine for Said {
    fn receive(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let n = self.0.len().min(into.len());
        into[..n].copy_from_slice(&self.0[..n]);
        self.0.drain(..n);
        Ok(n)
    }

    fn delay_ticks(&self) -> usize {
        0
    }

    fn send(&mut self, _: &[u8]) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn random_and_mutated_states_never_panic_and_end_in_a_reason() {
    let mut random = SeededRandom::new(43);
    for round in 0..60 {
        let mut device = TrocarDevice::new(Said(Vec::new()), BoardSettings::new(TrocarProfile::specified()));
        let mut line = SimulatedLine::new(board(TrocarProfile::specified()));
        let mut n_known = 0;
        for _ in 0..200 {
            let mut bytes = [0; 256];
            let n = line.receive(&mut bytes).unwrap();
            let mut said = bytes[..n].to_vec();
            let rate = f64::from(round) / 60.0;
            for byte in &mut said {
                if random.uniform() < 0.1 * rate * rate {
                    *byte = random.next_u64() as u8;
                }
            }
            if random.uniform() < 0.2 * rate {
                // Whole frames with any content: the check is right, the numbers are nonsense.
                let state = State {
                    time_us: random.next_u64() as u32,
                    flags: (random.next_u64() % 32) as u16,
                    encoders: glisson::haptics::trocar::EncoderSample {
                        counts: std::array::from_fn(|_| random.next_u64() as i32),
                        mark_counts: std::array::from_fn(|_| random.next_u64() as i32),
                        is_marked: [true; 5],
                    },
                    tag: std::array::from_fn(|_| random.next_u64() as u8),
                    buttons: random.next_u64() as u8,
                };
                let frame = Frame { trocar: 0, sequence: 0, message: Message::State(state) };
                said.extend_from_slice(frame.to_bytes().as_slice());
            }
            device.line_mut().0.extend(said);
            match device.read() {
                Ok(state) => {
                    n_known += 1;
                    assert!(state.position_m.is_finite() && state.velocity_m_per_s.is_finite());
                }
                Err(DeviceFault::Lost(why) | DeviceFault::Failed(why)) => assert!(!why.is_empty()),
            }
            device.write(&ForceCommand { force_n: DVec3::ONE, ..ForceCommand::default() }).unwrap();
        }
        assert!(round > 0 || n_known == 200);
    }
    // No board at all.
    let mut device = TrocarDevice::new(Said(vec![0x5A; 100_000]), BoardSettings::new(TrocarProfile::built()));
    let fault = (0..100).find_map(|_| match device.read() {
        Err(DeviceFault::Failed(why)) => Some(why),
        _ => None,
    });
    assert_eq!(
        fault.unwrap(),
        "64 times in a row no frame of an active trocar came; the last bytes: 256 bytes before A5 5A, where a frame begins"
    );
}

#[test]
fn a_board_behind_a_socket_is_the_same() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let stop = Arc::new(AtomicBool::new(false));
    let served = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            let mut board = board(TrocarProfile::built());
            let line = TcpLine::new(listener.accept().unwrap().0).unwrap();
            let ended = serve_board(line, &mut board, &stop);
            (board.mechanism.joints, ended)
        }
    });
    let settings =
        BoardSettings { mapping: Mapping::VirtualWork, ..BoardSettings::new(TrocarProfile::built()) };
    let mut device = connect(&address, settings).unwrap();
    assert_eq!(device.identity().unwrap().rate_hz, 1000);
    let push = ForceCommand { force_n: start().direction() * -2.0, ..ForceCommand::default() };
    let until = Instant::now() + Duration::from_secs(10);
    // 2 N against 400 N/m: the hand gives way by 5 mm.
    let mut yielded_m = 0.0;
    while (yielded_m - 5e-3_f64).abs() > 3e-4 && Instant::now() < until {
        if let Ok(state) = device.read() {
            yielded_m = 0.15 - state.position_m.length();
            device.write(&push).unwrap();
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!((yielded_m - 5e-3).abs() <= 3e-4, "{yielded_m}");
    // The board drops a host that speaks nonsense, with a reason.
    for _ in 0..200 {
        let _ = device.line_mut().send(&[0x11; 40]);
        std::thread::sleep(Duration::from_millis(2));
        if served.is_finished() {
            break;
        }
    }
    stop.store(true, Ordering::Relaxed);
    let (_, ended) = served.join().unwrap();
    let why = ended.unwrap_err().to_string();
    assert!(why.contains("before A5 5A"), "{why}");
    let until = Instant::now() + Duration::from_secs(10);
    while device.read().is_ok() && Instant::now() < until {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(reason(device.read()), "the line to the board is down");
    let refusal = connect("127.0.0.1:1", settings).err().unwrap();
    assert!(format!("{refusal:#}").starts_with("127.0.0.1:1: cannot connect to the board"), "{refusal:#}");
}

#[test]
fn a_tick_of_the_driver_allocates_nothing() {
    let profile = TrocarProfile::built();
    let mut device = device(board(profile), BoardSettings::new(profile));
    let push = ForceCommand { force_n: DVec3::NEG_Z, ..ForceCommand::default() };
    let mut tick = || {
        let _ = std::hint::black_box(device.read());
        let _ = std::hint::black_box(device.write(&push));
    };
    let allocated = allocation_counter::measure(|| (0..100).for_each(|_| tick()));
    assert_eq!(allocated.count_total, 0);
    device.line_mut().board.press_stop(true);
    let allocated = allocation_counter::measure(|| {
        for _ in 0..100 {
            assert!(device.read().is_err());
            let _ = device.write(&push);
        }
    });
    assert_eq!(allocated.count_total, 0, "nor while there is a fault");
}

#[test]
fn frames_that_did_not_come_are_counted() {
    let profile = TrocarProfile::built();
    let mut device = device(board(profile), BoardSettings::new(profile));
    device.read().unwrap();
    let mut bytes = [0; 256];
    // Three ticks that nobody reads.
    for _ in 0..3 {
        while device.line_mut().receive(&mut bytes).unwrap() > 0 {}
    }
    device.read().unwrap();
    assert_eq!(device.report().n_lost, 3);
    assert_eq!(device.report().n_refused, 0);
}
