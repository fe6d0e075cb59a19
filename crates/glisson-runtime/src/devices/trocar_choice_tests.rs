use super::super::trocar_board::{SimulatedLine, TcpLine, examine, serve_board};
use super::*;
use glam::DVec3;
use glisson::haptics::HapticDevice;
use glisson::tool::ToolInput;
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

fn named(text: &str) -> DeviceName {
    text.parse().unwrap()
}

fn trocar(text: &str) -> TrocarChoice {
    named(text).as_choice::<TrocarChoice>().expect("a trocar").clone()
}

fn refusal(text: &str) -> String {
    text.parse::<DeviceName>().unwrap_err()
}

#[test]
fn a_trocar_takes_options_after_its_address() {
    let plain = TrocarChoice::default();
    assert_eq!(trocar("trocar"), plain);
    let text = "trocar:10.0.0.7:4000,profile=specified,mapping=virtual-work,saturation=keep-direction,number=3,place=2";
    let choice = trocar(text);
    assert_eq!(choice.address.as_deref(), Some("10.0.0.7:4000"));
    let settings = choice.settings(1000.0, None);
    assert_eq!((settings.profile.name, settings.trocar, choice.place), ("specified", 3, Some(2)));
    assert_eq!((settings.mapping, settings.saturation), (Mapping::VirtualWork, Saturation::KeepDirection));
    assert_eq!(
        choice.description(),
        "active trocar at 10.0.0.7:4000 (specified, number 3, mapping virtual-work, saturation keep-direction)"
    );
    let choice = trocar("trocar,place=4");
    assert_eq!((choice.address, choice.place), (None, Some(4)));
}

#[test]
fn mistakes_in_options_are_told_with_what_is_allowed() {
    for (bad, part) in [
        ("trocar,profil=built", "did you mean \"profile\""),
        ("trocar,profile=bilt", "profile=bilt; did you mean \"built\"?; allowed: built, specified"),
        ("trocar,mapping=", "allowed: thesis, virtual-work"),
        ("trocar,number=4", "number=4; allowed: 0 to 3"),
        ("trocar,place=0", "place=0; allowed: 1 to 4"),
        ("trocar,place=2,place=3", "\"place\" is given twice"),
        ("trocar,instrument=scisors", "did you mean \"scissors\""),
        ("trocar:10.0.0.7:4000,instrument=none", "is for a simulated trocar"),
        ("trocar,", "is not KEY=VALUE"),
        ("trocar:there,place=2", "HOST:PORT"),
        ("trocars", "did you mean \"trocar\""),
    ] {
        let error = refusal(bad);
        assert!(error.contains(part), "{bad}: {error}");
    }
}

fn instruments(trocars_m: &[Option<DVec3>]) -> Vec<Tool> {
    let tool = |(i, trocar_m): (usize, &Option<DVec3>)| {
        let tip_m = trocar_m.unwrap_or(DVec3::X * 0.03 * i as f64) - DVec3::Z * 0.1;
        Tool {
            trocar_m: *trocar_m,
            ..Tool::probe(&format!("probe {i}"), 5e-3, ToolInput::at(tip_m, DVec3::Z))
        }
    };
    trocars_m.iter().enumerate().map(tool).collect()
}

fn stands(names: &[&str], instruments: &[Tool]) -> Result<Vec<Option<Placement>>, String> {
    let names: Vec<DeviceName> = names.iter().map(|name| named(name)).collect();
    let devices: Vec<_> = names.iter().zip(0..).collect();
    stand(&devices, instruments).map_err(|e| format!("{e:#}"))
}

#[test]
fn trocars_stand_in_the_points_of_the_scene_if_these_are_far_enough_apart() {
    let far = [Some(DVec3::ZERO), None, Some(DVec3::X * 0.12)];
    let found = stands(&["trocar", "simulated", "trocar"], &instruments(&far)).unwrap();
    assert_eq!(found[1], None);
    for (stand, expected_m) in [(found[0], DVec3::ZERO), (found[2], DVec3::X * 0.12)] {
        let stand = stand.unwrap();
        assert_eq!(stand.pivot_in_world_m, expected_m);
        assert!((stand.world_from_device.z_axis + DVec3::Z).length() < 1e-12, "into the body");
    }
    let near = stands(&["trocar", "trocar"], &instruments(&[Some(DVec3::ZERO), Some(DVec3::X * 0.08)]));
    let near = near.unwrap_err();
    assert!(
        near.contains("instruments 0 (probe 0) and 1 (probe 1)") && near.contains("80.0 mm apart"),
        "{near}"
    );
    assert!(near.contains("place=1 to place=4"), "{near}");
    let unknown = stands(&["trocar", "trocar"], &instruments(&[None, None])).unwrap_err();
    assert!(unknown.contains("30.0 mm apart"), "{unknown}");
    assert_eq!(stands(&["trocar"], &instruments(&[None])).unwrap(), [None]);
}

#[test]
fn places_are_100_mm_beside_each_other_and_the_first_is_the_instruments_own() {
    let four = instruments(&[None; 4]);
    let names = ["trocar,place=2", "trocar,place=1", "trocar,place=3", "trocar,place=4"];
    let found: Vec<DVec3> =
        stands(&names, &four).unwrap().into_iter().map(|stand| stand.unwrap().pivot_in_world_m).collect();
    assert!(found[0].length() < 1e-12, "{found:?}");
    let apart = |i: usize, j: usize| found[i].distance(found[j]);
    let side = [apart(0, 1), apart(1, 2), apart(2, 3), apart(3, 0)];
    assert!(side.iter().all(|mm| (mm - 0.1).abs() < 1e-12), "{side:?}");
    let twice = stands(&["trocar,place=2", "trocar,place=2"], &four).unwrap_err();
    assert!(twice.contains("0.0 mm apart"), "{twice}");
    let points = instruments(&[Some(DVec3::ZERO), Some(DVec3::X * 0.15)]);
    let off = stands(&["trocar,place=1", "trocar,place=2"], &points).unwrap_err();
    assert!(off.contains("from its `trocar` in the scene"), "{off}");
}

#[test]
fn more_than_four_and_one_of_a_line_twice_are_refused() {
    let apart: Vec<_> = (0..5).map(|i| Some(DVec3::X * 0.2 * f64::from(i))).collect();
    let five = stands(&["trocar"; 5], &instruments(&apart)).unwrap_err();
    assert!(five.contains("5 active trocars; 1 to 4"), "{five}");
    let same = stands(&["trocar:a:1", "trocar:a:1"], &instruments(&apart)).unwrap_err();
    assert!(same.contains("given twice"), "{same}");
    assert!(stands(&["trocar:a:1", "trocar:a:1,number=1"], &instruments(&apart)).is_ok());
}

/// 1,500 states a second for a loop of 1,000 ticks: its hand takes a second for a push all the same.
#[test]
fn a_simulated_one_answers_by_its_number_and_keeps_the_time_of_its_loop() {
    let choice = trocar("trocar,profile=specified,number=2");
    let mut device = choice.open_device(1000.0, 0.08, Some("probe")).unwrap();
    assert!((device.limits().stiffness_n_per_m - 2000.0).abs() < 1e-9, "what 1000 Hz can render");
    let insertion_m = |device: &mut TrocarDevice<BoardLine>, n_ticks| {
        (0..n_ticks).map(|_| device.read().unwrap().position_m.length()).last().unwrap()
    };
    assert!((insertion_m(&mut device, 1) - 0.08).abs() < 1e-3);
    assert!((insertion_m(&mut device, 520) - 0.09).abs() < 5e-4);
    assert!((insertion_m(&mut device, 500) - 0.08).abs() < 5e-4);
}

#[test]
fn a_doctor_tells_what_a_board_is_whatever_its_profile() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let stop = Arc::new(AtomicBool::new(false));
    let served = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            let settings = BoardSettings::new(TrocarProfile::specified());
            let SimulatedLine { mut board, .. } = simulated_line(&settings, 0.1, 9);
            // It ends with the line.
            let _ = serve_board(TcpLine::new(listener.accept().unwrap().0).unwrap(), &mut board, &stop);
        }
    });
    let text = examine(&address).unwrap();
    stop.store(true, Ordering::Relaxed);
    served.join().unwrap();
    let board = "board 00000001, profile specified, firmware 1, 1500 states a second";
    assert!(text.ends_with(&format!("{board}; in it: palpation probe, number 1")), "{text}");
}

#[test]
fn a_scene_refuses_a_device_with_another_instrument_in_it() {
    let open = |text: &str, kind: Option<&'static str>| {
        let choice = trocar(text);
        choice.open_device(1000.0, 0.1, kind).map_err(|error| format!("{error:#}"))
    };
    for kind in glisson::tool::instrument_names() {
        let mut device = open("trocar", Some(kind)).unwrap();
        assert!(device.read().is_ok(), "{kind}");
        assert_eq!(device.instrument().unwrap().instrument.tool_kind(), kind);
    }
    let error = open("trocar,instrument=scissors", Some("grasper")).err().unwrap();
    for part in
        ["simulated active trocar", "(scissors, number 1)", "acts as a \"scissors\"", "biopsy forceps"]
    {
        assert!(error.contains(part), "{part}: {error}");
    }
    let mut any = open("trocar,instrument=scissors", None).unwrap();
    assert!(any.read().is_ok() && any.inserted().is_some());
    let mut without = open("trocar,instrument=none", Some("probe")).unwrap();
    assert!(without.read().is_err() && without.inserted().is_none());
}
