//! What the haptic loop is told of a tool: publishing it after a step, and evaluating it at a tick.

use std::hint::black_box;

use glisson::haptics::{
    DeviceMapping, DeviceState, ForceCommand, HandPath, HandSettings, Handover, HapticDevice, HapticLaw,
    HapticModel, LawSettings, SimulatedDevice, SimulatedDeviceSettings,
};
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson::world::{StepInput, World};

use super::world::{prepared, world_of};
use super::{Case, Prepared, Settings};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "local_model_publish",
        about: "the haptic model of a touching probe: patch, its compliance over a step at 30 Hz, stiffness",
        per: "model",
        sizes: &[2_000, 6_300],
        parallel: false,
        prepare: publish,
    },
    Case {
        name: "local_model_evaluate",
        about: "one tick of the haptic loop: the newest model at the tip, handed over without a jump",
        per: "tick",
        sizes: &[2_000],
        parallel: false,
        prepare: evaluate,
    },
    Case {
        name: "haptic_law_tick",
        about: "one tick of the force law: handle, newest model at the tip with what a slide adds, coupling, gate, energy tank",
        per: "tick",
        sizes: &[2_000],
        parallel: false,
        prepare: law_tick,
    },
];

/// Time between two models [s]: what the stiffness is for.
const PERIOD_S: f64 = 1.0 / 30.0;
const TICK_S: f64 = 1e-3;

/// A probe pressed 3 mm into the top of the body.
fn pressed(size: usize) -> anyhow::Result<World> {
    let mut world = world_of(size, 1)?;
    let top_m = world.organ().mesh().positions_m.iter().fold(f64::MIN, |top, p| top.max(p.z));
    for step in 0..200 {
        let z_m = top_m + 5.5e-3 - 3.5e-3 * f64::from(step) / 200.0;
        let input = StepInput::of(&[ToolInput::at(DVec3::Z * z_m, DVec3::Z)]);
        world.step(&if step == 0 { input.placed() } else { input });
    }
    anyhow::ensure!(world.report().in_contact(), "the probe does not touch the body");
    Ok(world)
}

fn publish(settings: Settings) -> anyhow::Result<Prepared> {
    let mut world = pressed(settings.size)?;
    let size = world.organ().mesh().tetrahedra.len();
    let model = world.haptic_model_over(0, PERIOD_S);
    let note = format!(
        "stiffness along the normal {:.0} N/m",
        model.normal.dot(model.stiffness_n_per_m * model.normal)
    );
    let run = move || {
        black_box(world.haptic_model_over(black_box(0), PERIOD_S));
    };
    Ok(prepared(size, note, Box::new(run)))
}

fn evaluate(settings: Settings) -> anyhow::Result<Prepared> {
    let mut world = pressed(settings.size)?;
    let size = world.organ().mesh().tetrahedra.len();
    let first = world.haptic_model_over(0, PERIOD_S);
    let models = [first, HapticModel { step: first.step + 1, ..first }];
    let mut handover = Handover::default();
    let mut tick = 0_usize;
    let run = move || {
        tick += 1;
        let tip_m = first.tip_m + DVec3::new(1e-4, 2e-4, -1e-4) * (tick % 16) as f64;
        // Another model at every 33rd tick.
        black_box(handover.force(&models[tick / 33 % 2], tip_m, (tick % 33) as f64 * TICK_S, TICK_S));
    };
    Ok(prepared(size, "of 1 ms".into(), Box::new(run)))
}

/// A simulated device's handle goes to and fro along the tissue; its places are made before.
fn law_tick(settings: Settings) -> anyhow::Result<Prepared> {
    const N_TICKS: usize = 990;
    const TICKS_A_MODEL: usize = 33;
    let mut world = pressed(settings.size)?;
    let size = world.organ().mesh().tetrahedra.len();
    let first = world.haptic_model_over(0, PERIOD_S);
    anyhow::ensure!(first.touch == glisson::haptics::Touch::Contact, "the probe does not touch the body");
    let path = HandPath::Swing { center_m: DVec3::ZERO, amplitude_m: DVec3::X * 5e-3, frequency_hz: 1.0 };
    let mut device =
        SimulatedDevice::new(&SimulatedDeviceSettings::default(), &HandSettings::default(), path, 1);
    let limits = device.limits();
    let states = (0..N_TICKS)
        .map(|_| {
            let state = device.read().map_err(|fault| anyhow::anyhow!("the simulated device: {fault:?}"))?;
            device
                .write(&ForceCommand::default())
                .map_err(|fault| anyhow::anyhow!("the simulated device: {fault:?}"))?;
            Ok(state)
        })
        .collect::<anyhow::Result<Vec<DeviceState>>>()?;
    let from_m = states[0].position_m;
    // The tissue is as deep all along, and a tenth stiffer or softer from model to model.
    let mut models = Vec::new();
    for (n, states) in states.chunks(TICKS_A_MODEL).enumerate() {
        let count = n as f64;
        let way_m = DVec3::X * (states[0].position_m.x - from_m.x);
        models.push(HapticModel {
            step: first.step + n as u64,
            time_s: first.time_s + count * PERIOD_S,
            force_n: first.force_n * (1.0 + 0.1 * count.sin()),
            tip_m: first.tip_m + way_m,
            friction_coefficient: 0.05,
            ..first
        });
    }
    let mapping = DeviceMapping {
        device_origin_m: from_m,
        world_origin_m: first.tip_m,
        ..LawSettings::default().mapping
    };
    let mut law = HapticLaw::new(&LawSettings { mapping, ..LawSettings::default() }, &limits);
    let mut tick = 0_usize;
    let run = move || {
        let (at, state) = (tick % N_TICKS, &states[tick % N_TICKS]);
        tick += 1;
        let age_s = (at % TICKS_A_MODEL) as f64 * TICK_S;
        black_box(law.tick(black_box(state), &models[at / TICKS_A_MODEL], age_s, TICK_S));
    };
    Ok(prepared(size, "of 1 ms".into(), Box::new(run)))
}
