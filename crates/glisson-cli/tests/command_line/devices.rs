//! Devices, the haptic loop and its benchmark, as the program shows them.

use super::{glisson, refuses, small_scene};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn devices_are_listed_tested_and_looked_for() {
    let folder = tempfile::tempdir().unwrap();
    let answer = |arguments: &[&str]| {
        let output = glisson(folder.path(), arguments);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let list = answer(&["devices", "list"]);
    for name in [
        "simulated",
        "replay:FILE",
        "haply",
        "force-dimension",
        "openhaptics",
        "trocar",
        "viewer",
        "mapping=thesis",
    ] {
        assert!(list.contains(name), "{name}: {list}");
    }
    let doctor = answer(&["devices", "doctor", "--haply", "127.0.0.1:1", "--trocar", "127.0.0.1:1"]);
    assert!(doctor.contains("Inverse Service") && doctor.contains("real-time scheduling"), "{doctor}");
    assert!(doctor.contains("viewer's page"), "{doctor}");
    assert!(doctor.contains("cannot connect to the board of an active trocar"), "{doctor}");
    let report: serde_json::Value =
        serde_json::from_str(&answer(&["devices", "test", "simulated", "--seconds", "0.5", "--json"]))
            .unwrap();
    assert!(
        report["good_ticks"].as_u64().unwrap() == 500 && report["changes"].as_u64().unwrap() > 50,
        "{report}"
    );

    refuses(
        folder.path(),
        &["devices", "test", "haply:127.0.0.1:1", "--seconds", "0.2"],
        &["never told where it is"],
    );
    refuses(folder.path(), &["devices", "test", "replay:gone.jsonl"], &["gone.jsonl"]);
    let mistyped = glisson(folder.path(), &["devices", "test", "haptly"]);
    assert_eq!(mistyped.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&mistyped.stderr).contains("did you mean \"haply\""));
}

#[test]
fn a_simulated_trocar_leads_another_one_without_hardware() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["devices", "lead", "trocar", "trocar,profile=specified", "--seconds", "1.2"];
    let output = glisson(folder.path(), &[&arguments[..], &["--json"]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(report["coupled_ticks"].as_u64().unwrap() > 100 && report["apart_ticks"] == 0, "{report}");
    assert!(report["follower"].as_str().unwrap().contains("specified"), "{report}");
    let error_mm = report["tracking_error_mm"]["p50"].as_f64().unwrap();
    assert!(error_mm > 0.0 && error_mm < 3.0, "{report}");
    for who in ["leader_force_n", "follower_force_n"] {
        let greatest = report[who]["greatest"].as_f64().unwrap();
        assert!(greatest > 0.1 && greatest < 6.0, "{who}: {report}");
    }
    let text = glisson(folder.path(), &["devices", "lead", "simulated", "trocar", "--seconds", "0.3"]);
    let text = String::from_utf8_lossy(&text.stdout).into_owned();
    for part in ["leads simulated active trocar", "coupled", "behind at the tip", "on the leader's hand"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    refuses(folder.path(), &["devices", "lead", "trocar", "haply"], &["only an active trocar can follow"]);
    refuses(folder.path(), &["devices", "lead", "trocar", "trocar", "--scale", "9"], &["0.1 to 3"]);
}

#[test]
fn a_served_device_moves_its_instrument_and_a_watching_program_sees_it() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    wrong_devices_are_refused(folder.path());
    let mut serve = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(["serve", "scene.toml", "--port", "0", "--no-open", "--device", "simulated"])
        .args(["--record", "s.jsonl", "--force-estimate", "hold", "--energy-control", "off"])
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(serve.stdout.take().unwrap()).lines().map(Result::unwrap);
    let told = lines.by_ref().find(|line| line.starts_with("forces 1000 times a second")).unwrap();
    assert!(told.contains("held between models, energy control off, coupling 60 %"), "{told}");
    let page = lines.by_ref().find(|line| line.contains("http://")).unwrap();
    let host = page.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    let watched =
        glisson(folder.path(), &["watch", &format!("ws://{host}/ws"), "--seconds", "2.5", "--json"]);
    #[cfg(target_os = "linux")]
    the_loop_has_its_core_for_itself(serve.id());
    let rest = stop(serve, lines);
    assert!(
        rest.iter().any(|line| line.contains("haptics") && line.contains("deadlines missed")),
        "{rest:?}"
    );
    // What it said at the start, the budget of a tick, and the histogram of the jitter.
    for part in [
        "held between models, energy control off",
        "% of 1000 us",
        "below ",
        "a hand never got more",
        "took longer",
        "to displays     every",
    ] {
        assert!(rest.iter().any(|line| line.contains(part)), "{part}: {rest:?}");
    }
    the_loop_kept_its_pace(&serde_json::from_slice(&watched.stdout).unwrap());
    // The session has what the hand did, and makes the same bits.
    let session = std::fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    assert!(session.lines().filter(|line| line.contains("\"input\"")).count() > 100);
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    assert!(String::from_utf8_lossy(&replay.stdout).contains("same bits"));
}

fn wrong_devices_are_refused(folder: &Path) {
    refuses(folder, &["serve", "scene.toml", "--port", "0", "--device", "simulated@1"], &["no instrument 1"]);
    refuses(folder, &["serve", "scene.toml", "--port", "0", "--token", "short"], &["allowed: 16 to 128"]);

    for (bad, part) in [
        (&["--coupling-stiffness", "0.9"][..], "a device renders at most 1"),
        (&["--haptic-rate", "9000"], "allowed: 100 to 4000 Hz"),
    ] {
        let arguments = [&["serve", "scene.toml", "--port", "0", "--device", "simulated"], bad].concat();
        refuses(folder, &arguments, &[part]);
    }
}

/// What a watching program was told of the times of simulation and haptic loop.
fn the_loop_kept_its_pace(watched: &serde_json::Value) {
    assert!(watched["frames"].as_u64().unwrap() > 5, "{watched}");
    let steps = &watched["timing"]["simulation"];
    assert!(
        steps["steps"].as_u64().unwrap() > 100 && steps["step_us"]["p50"].as_f64().unwrap() > 0.0,
        "{watched}"
    );
    assert!(steps["frame_ms"]["p50"].as_f64().unwrap() > 1.0, "{watched}");
    let haptics = &watched["timing"]["haptics"];
    assert!(haptics["deadlines"].as_u64().unwrap() > 100, "{watched}");
    assert_eq!(haptics["force_estimate"], "hold");
    assert_eq!((&haptics["period_us"], &watched["timing"]["haptics_at"]), (&1000.0.into(), &"here".into()));
}

/// Of all threads of a process only the haptic loop may use its core, where there are two.
#[cfg(target_os = "linux")]
fn the_loop_has_its_core_for_itself(process: u32) {
    let cores_of = |status: &str| -> Vec<usize> {
        let list = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:")).unwrap();
        let ranges = list.trim().split(',').map(|range| range.split_once('-').unwrap_or((range, range)));
        ranges.flat_map(|(from, to)| from.parse().unwrap()..=to.parse().unwrap()).collect()
    };
    if cores_of(&std::fs::read_to_string("/proc/self/status").unwrap()).len() < 2 {
        return;
    }
    let (mut of_loop, mut of_others) = (Vec::new(), Vec::new());
    for thread in std::fs::read_dir(format!("/proc/{process}/task")).unwrap() {
        // A thread may end while one looks.
        let Ok(status) = std::fs::read_to_string(thread.unwrap().path().join("status")) else { continue };
        let name = status.lines().next().unwrap().trim_start_matches("Name:").trim().to_owned();
        if name == "haptics" { &mut of_loop } else { &mut of_others }.push((name, cores_of(&status)));
    }
    let [(_, own)] = of_loop.as_slice() else { panic!("{of_loop:?}") };
    let [core] = own.as_slice() else { panic!("{own:?}") };
    assert!(of_others.iter().any(|(name, _)| name == "simulation"), "{of_others:?}");
    assert!(of_others.iter().all(|(_, cores)| !cores.contains(core)), "core {core}: {of_others:?}");
}

/// Stops a served process as Ctrl-C does; answers what it said to the end.
fn stop(mut serve: Child, lines: impl Iterator<Item = String>) -> Vec<String> {
    interrupt(&serve);
    let rest: Vec<String> = lines.collect();
    assert!(serve.wait().unwrap().success(), "{rest:?}");
    rest
}

/// As a user who presses Ctrl-C.
pub(crate) fn interrupt(process: &Child) {
    let stopped = Command::new("kill").args(["-INT", &process.id().to_string()]).status().unwrap();
    assert!(stopped.success());
}

#[test]
fn four_trocars_side_by_side_move_the_instruments_of_one_scene() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let scene = std::fs::read_to_string(folder.path().join("scene.toml")).unwrap();
    let (organ, _) = scene.split_once("[tool]").unwrap();
    // Where the places are, so that each begins at the same depth.
    let tool = |[x, y]: [i32; 2]| {
        format!(
            "[[tool]]\ntip_radius = \"5 mm\"\nhome_tip = [\"{x} mm\", \"{y} mm\", \"150 mm\"]\nhome_shaft = [0, 0, 1]\n"
        )
    };
    let tools = [[10, 10], [110, 10], [10, -90], [110, -90]].map(tool).concat();
    std::fs::write(folder.path().join("scene.toml"), format!("{organ}{tools}")).unwrap();
    let places: Vec<String> =
        (1..=4).flat_map(|place| ["--device".to_owned(), format!("trocar,place={place}")]).collect();
    let serve = ["serve", "scene.toml", "--port", "0", "--no-open", "--record", "s.jsonl"];
    let mut serve = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(serve)
        .args(&places)
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(serve.stdout.take().unwrap()).lines().map(Result::unwrap);
    let told: Vec<String> = lines.by_ref().take_while(|line| !line.contains("http://")).collect();
    for tool in 0..4 {
        assert!(told.iter().any(|line| line.starts_with(&format!("instrument {tool} "))), "{told:?}");
    }
    std::thread::sleep(Duration::from_millis(1_500));
    let rest = stop(serve, lines);
    assert!(rest.iter().any(|line| line.contains("deadlines missed")), "{rest:?}");

    let session = std::fs::read_to_string(folder.path().join("s.jsonl")).unwrap();
    let tips: Vec<Vec<[f64; 3]>> = session
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap())
        .filter_map(|line| line["tools"].as_array().cloned())
        .map(|tools| {
            let tip =
                |tool: &serde_json::Value| serde_json::from_value(tool["tip_in_world_m"].clone()).unwrap();
            tools.iter().map(tip).collect()
        })
        .collect();
    let last = tips.last().unwrap();
    let apart_m =
        |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    // 1 2 in a row, 3 4 below; each is pushed by a hand of its own by some millimetres.
    for (a, b, wanted_m) in [(0, 1, 0.1), (2, 3, 0.1), (0, 2, 0.1), (1, 3, 0.1), (0, 3, 0.02_f64.sqrt())] {
        let found_m = apart_m(last[a], last[b]);
        assert!((found_m - wanted_m).abs() < 0.03, "{a} and {b}: {found_m} m");
    }
    for tool in 0..4 {
        let moved_m = tips.iter().map(|tips| apart_m(tips[tool], last[tool])).fold(0.0, f64::max);
        assert!(moved_m > 2e-3, "instrument {tool}: {moved_m} m");
    }
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    assert!(String::from_utf8_lossy(&replay.stdout).contains("same bits"), "{replay:?}");
}

/// A page, without a browser.
struct Page(tungstenite::WebSocket<TcpStream>);

impl Page {
    fn open(host: &str) -> Self {
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        Self(tungstenite::client(format!("ws://{host}/ws"), stream).unwrap().0)
    }

    fn say(&mut self, text: &str) {
        self.0.send(tungstenite::Message::text(text)).unwrap();
    }

    fn put_tip(&mut self, z_mm: f64) {
        let z_m = 1e-3 * z_mm;
        self.say(&format!(r#"{{"type":"tool","tip_m":[0.002,0.002,{z_m}],"shaft":[0,0,1]}}"#));
    }

    /// To the top of the organ, and 6 mm into it as a hand goes.
    fn press(&mut self) {
        for i in 0..=60 {
            self.put_tip(66.0 - 0.2 * f64::from(i));
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// The next message of that type that is as wanted.
    fn hear(&mut self, kind: &str, is_wanted: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < Duration::from_secs(20), "no such {kind}");
            if let tungstenite::Message::Text(text) = self.0.read().unwrap() {
                let value: serde_json::Value = serde_json::from_str(&text).unwrap();
                assert!(value["type"] != "error", "{value}");
                if value["type"] == kind && is_wanted(&value) {
                    return value;
                }
            }
        }
    }

    /// Force of the only hand, along z [N].
    fn force_n(value: &serde_json::Value) -> f64 {
        value["hands"][0]["force_n"][2].as_f64().unwrap()
    }
}

#[test]
fn a_page_is_a_device_that_feels_the_organ_until_it_leaves() {
    let folder = tempfile::tempdir().unwrap();
    small_scene(folder.path());
    let serve =
        ["serve", "scene.toml", "--port", "0", "--no-open", "--device", "viewer", "--record", "s.jsonl"];
    let mut serve = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(serve)
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(serve.stdout.take().unwrap()).lines().map(Result::unwrap);
    let page = lines.by_ref().find(|line| line.contains("http://")).unwrap();
    let host = page.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();

    let mut page = Page::open(&host);
    page.hear("role", |role| role["role"] == "controller");
    let mut watching = Page::open(&host);
    page.hear("feel", |feel| feel["hands"][0]["is_held"] == true);
    page.press();
    let pressed = page.hear("feel", |feel| Page::force_n(feel) > 0.02);
    assert!(Page::force_n(&pressed) <= pressed["greatest_force_n"].as_f64().unwrap(), "{pressed}");
    let seen = watching.hear("feel", |feel| Page::force_n(feel) > 0.02);
    assert_eq!((&seen["hands"][0]["tool"], &seen["hands"][0]["is_held"]), (&0.into(), &true.into()));
    let timing = watching.hear("timing", |timing| timing["haptics"].is_object());
    assert_eq!(timing["haptics_at"], "here");
    // Home after a reset, where nothing is felt; and back.
    page.say(r#"{"type":"reset"}"#);
    page.hear("feel", |feel| Page::force_n(feel) == 0.0);
    page.press();
    page.hear("feel", |feel| Page::force_n(feel) > 0.02);
    drop(page);
    let left =
        watching.hear("feel", |feel| feel["hands"][0]["is_held"] == false && Page::force_n(feel) == 0.0);
    assert_eq!(left["hands"][0]["force_n"], serde_json::json!([0.0, 0.0, 0.0]));
    // Who takes control has the instrument, pressed as it was left.
    watching.put_tip(54.0);
    watching.hear("feel", |feel| Page::force_n(feel) > 0.02);

    let rest = stop(serve, lines);
    assert!(rest.iter().any(|line| line.contains("deadlines missed")), "{rest:?}");
    let replay = glisson(folder.path(), &["replay", "s.jsonl"]);
    assert!(String::from_utf8_lossy(&replay.stdout).contains("same bits"), "{replay:?}");
    let serve_there =
        ["serve", "scene.toml", "--role", "haptics", "--link", "udp://127.0.0.1:9", "--device", "viewer"];
    refuses(folder.path(), &serve_there, &["the page is at the machine with --role simulation"]);
    refuses(folder.path(), &["devices", "lead", "viewer", "trocar"], &["the viewer cannot lead"]);
}

#[test]
fn the_page_can_be_tried_as_a_device() {
    let folder = tempfile::tempdir().unwrap();
    let mut test = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(["devices", "test", "viewer", "--seconds", "1", "--json"])
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut told = String::new();
    BufReader::new(test.stderr.take().unwrap()).read_line(&mut told).unwrap();
    let host = told.split("http://").nth(1).unwrap().split('/').next().unwrap().to_owned();
    let mut page = Page::open(&host);
    page.hear("role", |role| role["role"] == "controller");
    for i in 0..100 {
        page.put_tip(60.0 - 0.1 * f64::from(i));
        std::thread::sleep(Duration::from_millis(5));
    }
    let output = test.wait_with_output().unwrap();
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(
        report["good_ticks"].as_u64().unwrap() > 500 && report["changes"].as_u64().unwrap() > 50,
        "{report}"
    );
    assert_eq!(report["device"], "viewer");
}

#[test]
fn the_benchmark_of_the_haptic_loop_makes_stalls_and_sees_them() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["bench", "haptics", "--seconds", "2.5", "--sizes", "600", "--json"];
    let output = glisson(folder.path(), &arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for run in [&report, &report["with_stalls"]] {
        for field in ["rate_hz", "missed_deadlines", "missed_percent"] {
            assert!(run[field].as_f64().unwrap() >= 0.0, "{field}: {run}");
        }
        for field in ["jitter_us", "motion_to_force_us", "local_model_age_ms"] {
            for which in ["p50", "p99", "p999"] {
                assert!(run[field][which].is_number(), "{field}.{which}: {run}");
            }
        }
        assert!(
            run["real_time_scheduling"].is_boolean() && run["deadlines"].as_u64().unwrap() > 1_000,
            "{run}"
        );
        assert!(run["simulation"]["steps_per_s"].as_f64().unwrap() > 0.0, "{run}");
        assert!(run["viewer"]["frames_per_s"].as_f64().unwrap() > 1.0, "{run}");
        // It is pushed, and the run says whether it had a core for itself.
        let contact = &run["contact"];
        assert!(contact["ticks_in_contact"].as_u64().unwrap() > 100, "{run}");
        assert!(contact["ticks"].as_u64() >= contact["ticks_in_contact"].as_u64(), "{run}");
        assert!(contact["greatest_force_n"].as_f64().unwrap() > 0.01, "{run}");
        assert!(run["core_was_free"].is_boolean(), "{run}");
        assert!(run["core_was_free"] == false || run["core"]["others_percent"].is_number(), "{run}");
    }
    assert!(report["empty_loop_jitter_us"]["p999"].is_number() && report["machine_is_punctual"].is_boolean());
    let stalled = &report["with_stalls"];
    assert_eq!(report["simulation"]["stalls"], 0);
    assert!(stalled["simulation"]["stalls"].as_u64().unwrap() >= 2, "{stalled}");
    // The loop went on with a model that had the age of a stall at least.
    assert!(stalled["local_model_age_ms"]["max"].as_f64().unwrap() >= 30.0, "{stalled}");
    assert!(report["missed_percent_rise"].is_number() && report["rise_is_small"].is_boolean());
    // How often it ticks then is for the full-size test, which runs alone.
    assert!(report["rate_in_stalls_hz"].is_number() && report["stalls_are_not_felt"].is_boolean());
    refuses(
        folder.path(),
        &["bench", "haptics", "--rate", "9000", "--sizes", "600"],
        &["allowed: 100 to 4000 Hz"],
    );
    refuses(folder.path(), &["bench", "haptics", "--seconds", "0"], &["must be 1 to 3600"]);
}
