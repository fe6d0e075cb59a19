use super::super::trocar_board::{
    BoardSettings, START_INSERTION_M, SimulatedBoard, SoftWall, simulated_line,
};
use super::*;

const TICK_S: f64 = 1e-3;
const WALL: SoftWall = SoftWall { from_m: START_INSERTION_M + 5e-3, stiffness_n_per_m: 300.0 };

fn trocar(wall: Option<SoftWall>) -> TrocarDevice<BoardLine> {
    let settings = BoardSettings::new(TrocarProfile::built());
    let line = simulated_line(&settings, START_INSERTION_M, 3);
    let line = if let Some(wall) = wall { line.before(wall) } else { line };
    TrocarDevice::new(BoardLine::Simulated(Box::new(line)), settings)
}

fn lead_of(leader: Leader, scale: f64) -> Lead {
    Lead::new(leader, trocar(Some(WALL)), TrocarProfile::built(), scale, TICK_S)
}

fn board(device: &mut TrocarDevice<BoardLine>) -> &mut SimulatedBoard {
    match device.line_mut() {
        BoardLine::Simulated(line) => &mut line.board,
        BoardLine::Tcp(_) => panic!("no simulated board"),
    }
}

/// The leader's hand goes 10 mm further in.
fn push(lead: &mut Lead) {
    let Leader::Trocar(leader) = &mut lead.leader else { panic!("no trocar leads") };
    let start = board(leader).mechanism.joints;
    board(leader).mechanism.hand_target =
        Some(TrocarJoints { insertion_m: START_INSERTION_M + 0.01, ..start });
}

fn run_for(lead: &mut Lead, n_ticks: usize) -> Vec<LeadTick> {
    (0..n_ticks).map(|_| lead.tick(TICK_S)).collect()
}

fn mean_n(ticks: &[LeadTick], i: usize) -> f64 {
    ticks.iter().map(|tick| tick.force_n[i]).sum::<f64>() / ticks.len() as f64
}

/// Hand (400 N/m), coupling (1500) and wall (300) in series, 10 mm less the 5 before the wall.
#[test]
fn a_trocar_leads_another_into_something_soft_and_feels_it() {
    for scale in [1.0, 0.8] {
        let mut lead = lead_of(Leader::Trocar(Box::new(trocar(None))), scale);
        run_for(&mut lead, 200);
        push(&mut lead);
        let moved = run_for(&mut lead, 2000);
        let last = &moved[1500..];
        // F/300 + 5 = s (10 - s F/400) - F/1500, in mm and N.
        let force_n = (10e-3 * scale - 5e-3) / (1.0 / 300.0 + 1.0 / 1500.0 + scale * scale / 400.0);
        let [on_hand_n, of_motors_n] = [mean_n(last, 0), mean_n(last, 1)];
        assert!((on_hand_n - scale * force_n).abs() < 0.05 * force_n, "{scale}: {on_hand_n} of {force_n}");
        assert!((of_motors_n - force_n).abs() < 0.05 * force_n, "{scale}: {of_motors_n} of {force_n}");
        let behind_m = last.iter().filter_map(|tick| tick.error_m).sum::<f64>() / last.len() as f64;
        assert!((behind_m - force_n / 1500.0).abs() < 1e-4, "{scale}: {behind_m}");
        // What the wall pushes with is what the board's surroundings do.
        let wall_n = -board(&mut lead.follower).outside.translation_n;
        assert!((wall_n - force_n).abs() < 0.1 * force_n, "{wall_n}");
        lead.let_go();
        let gone = run_for(&mut lead, 126);
        assert!(lead.has_let_go() && gone[125].force_n == [0.0; 2], "{:?}", gone[125]);
        assert!(gone[60].force_n[0] > 0.1 * force_n, "slowly: {:?}", gone[60]);
    }
}

#[test]
fn a_stop_lets_both_go_slowly_and_they_are_coupled_anew_where_they_are() {
    let mut lead = lead_of(Leader::Trocar(Box::new(trocar(None))), 1.0);
    push(&mut lead);
    let before = run_for(&mut lead, 2000)[1999].force_n[0];
    assert!(before > 0.4, "{before}");
    board(&mut lead.follower).press_stop(true);
    let stopped = run_for(&mut lead, 300);
    assert!(stopped.iter().all(|tick| tick.error_m.is_none()));
    // 5 N in 0.125 s at most.
    let falls = stopped.windows(2).map(|pair| pair[0].force_n[0] - pair[1].force_n[0]);
    assert!(falls.fold(0.0, f64::max) <= 0.04 + 1e-9 && stopped[299].force_n == [0.0; 2]);
    board(&mut lead.follower).press_stop(false);
    let again = run_for(&mut lead, 20);
    assert!(again[19].error_m.is_some_and(|error_m| error_m < 5e-4), "{:?}", again[19]);
    let steps = again.windows(2).map(|pair| (pair[1].force_n[0] - pair[0].force_n[0]).abs());
    assert!(again[0].force_n[0] < 0.01 && steps.fold(0.0, f64::max) < 0.05, "{again:?}");
    let (why, n) = &lead.faults[0];
    assert!(why == "follower: the emergency stop is pressed" && *n == 300, "{why} {n}");
}

#[test]
fn another_device_leads_the_tip_and_gets_what_it_can_render() {
    let home = ToolInput::at(DVec3::ZERO, DVec3::NEG_Y);
    let opened = open(&"simulated".parse().unwrap(), &home, 1.0 / TICK_S).unwrap();
    let limits = opened.device.limits();
    let mut lead = lead_of(Leader::Other(Handle::new(opened)), 1.0);
    // Its hand goes 10 mm down and up again, once a second: the wall is met and left.
    let ticks = run_for(&mut lead, 3000);
    let forces_n = ticks.iter().map(|tick| tick.force_n[0]);
    let greatest_n = forces_n.clone().fold(0.0, f64::max);
    assert!(greatest_n > 0.3 && greatest_n <= limits.force_n, "{greatest_n}");
    let of_motors_n = ticks.iter().map(|tick| tick.force_n[1]).fold(0.0, f64::max);
    assert!((greatest_n - of_motors_n).abs() < 0.05 * greatest_n, "{greatest_n} {of_motors_n}");
    let deepest_m = lead.at[1].insertion_m;
    assert!(deepest_m > START_INSERTION_M - 2e-3 && deepest_m < START_INSERTION_M + 0.012, "{deepest_m}");
    let springs = lead.link.as_ref().unwrap().springs();
    assert!((springs[2].stiffness - 0.6 * limits.stiffness_n_per_m).abs() < 1e-9, "{springs:?}");
    assert!(springs[0].stiffness < 0.6 * limits.stiffness_n_per_m * 0.011, "{springs:?}");
    // Down at the desk is into the body.
    let Leader::Other(handle) = &lead.leader else { panic!("a trocar leads") };
    assert!((handle.follower_from_device * DVec3::NEG_Z).abs_diff_eq(DVec3::Z, 1e-12));
}

#[test]
fn who_cannot_lead_or_follow_is_refused() {
    let lead = |leader: &str, follower: &str, scale: f64| {
        let (leader, follower) = (leader.parse().unwrap(), follower.parse().unwrap());
        let request =
            LeadRequest { leader: &leader, follower: &follower, seconds: Some(1.0), scale, rate_hz: 1_000.0 };
        Lead::open(&request).err().map(|e| format!("{e:#}")).unwrap_or_default()
    };
    assert!(lead("trocar", "simulated", 1.0).contains("only an active trocar can follow"));
    assert!(lead("trocar", "trocar", 0.0).contains("must be 0.1 to 3"));
    assert!(lead("trocar:127.0.0.1:1", "trocar:127.0.0.1:1", 1.0).contains("cannot lead itself"));
    assert!(lead("trocar", "trocar:127.0.0.1:1", 1.0).contains("cannot connect to the board"));
    assert_eq!(lead("trocar", "trocar", 1.0), "");
}
