//! A block of tissue under tip and shaft of a rod together.

use super::closed_loop::{Station, TICK_S};
use super::law_loop::{Loop, PRESS_S, TICKS_PER_STEP};
use super::{OWN, THESIS, tilted};
use crate::validate::{Experiment, Outcome};
use glam::DVec3;
use glisson::haptics::trocar::statics::efforts;
use glisson::haptics::trocar::{AxisEfforts, ContactForce, Mapping, N_AXES, Placement, TrocarJoints, Wrench};
use glisson::material::LinearElastic;
use glisson::mesh::box_mesh::box_of_five;
use glisson::model::kind::ModelKind;
use glisson::scene::{OrganBody, build_model};
use glisson::tool::{Grip, Tool};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};

const YOUNG_MODULUS_PA: f64 = 5e3;
/// A block of tissue, and a rod of that length that comes from a trocar beside it, as high as its top [m]: first this far above
/// it, then pressed in so deep, it meets the edge with its shaft and the top with its tip.
const BLOCK_M: f64 = 0.1;
const ROD_M: f64 = 0.12;
const BESIDE_M: f64 = 0.03;
const ROD_LEAD_M: f64 = 0.02;
const ROD_DEPTH_M: f64 = 5e-4;
const ROD_RADIUS_M: f64 = 3e-3;

/// The block under that rod, which slides without friction.
fn block(placement: &Placement, start: &TrocarJoints, step_s: f64) -> anyhow::Result<World> {
    let mesh = box_of_five([6; 3], DVec3::splat(BLOCK_M));
    let grip = Grip { friction_coefficient: 0.0, is_sticky: false };
    let rod = Tool {
        trocar_m: Some(placement.pivot_in_world_m),
        shaft_radius_m: 2e-3,
        grip,
        ..Tool::probe("rod", ROD_RADIUS_M, placement.tool_input(start))
    };
    let mut spec = WorldSpec::new("block", step_s, rod);
    let table = Region::Furthest { direction: -DVec3::Z, fraction: 1.0 / 7.0 };
    spec.supports = vec![Support::all_axes(table)];
    let material = LinearElastic::from_young_poisson(YOUNG_MODULUS_PA, 0.4, 1000.0)?;
    let mut body = OrganBody::new(mesh, material, step_s);
    body.fixed = fixed_nodes(&spec.supports, &body.mesh.positions_m);
    let model = build_model(&body, ModelKind::Precomputed)?;
    Ok(World::new(spec, body.mesh, model, ModelKind::Precomputed)?)
}

/// The rod's tip below the trocar by so much [m].
fn leaning(placement: &Placement, down_m: f64) -> TrocarJoints {
    let along_m = (ROD_M * ROD_M - down_m * down_m).sqrt();
    let d = placement.world_from_device.transpose() * DVec3::new(along_m, 0.0, -down_m);
    TrocarJoints { insertion_m: ROD_M, ..tilted([-(d.y / d.z).atan(), (d.x / d.z).atan()]) }
}

/// Motors' efforts over some steps, summed.
#[derive(Default)]
struct Efforts {
    /// Those of both contacts, those exerted, and those if both forces acted at the tip.
    wanted: [f64; N_AXES],
    got: [f64; N_AXES],
    at_tip: [f64; N_AXES],
    /// Of tip and shaft [N].
    forces_n: [f64; 2],
    /// Steps, and those in which both touch.
    n: u32,
    n_both: u32,
}

impl Efforts {
    /// The step that the world made last.
    fn add(&mut self, run: &mut Loop, world: &World) -> anyhow::Result<()> {
        self.n += 1;
        let contacts = world.snapshot().tools[0].contacts;
        let (Some(tip), Some(shaft)) = (contacts[0], contacts[2]) else { return Ok(()) };
        self.n_both += 1;
        let placement = run.station.placement;
        let parts = run.model.parts;
        let real = [(tip, parts[0]), (shaft, parts[1])]
            .map(|(contact, part)| placement.contact(contact.point_m, part.force_n));
        let joints = run.station.device.reading()?.joints;
        let tip_m = joints.pose().tip_m;
        let summed = real.map(|contact| ContactForce { point_m: tip_m, ..contact });
        let asked =
            |contacts: &[ContactForce]| efforts(Mapping::VirtualWork, &joints, &Wrench::of(contacts), 0.0);
        let add = |sum: &mut [f64; N_AXES], efforts: AxisEfforts| {
            sum.iter_mut().zip(efforts.to_array()).for_each(|(sum, x)| *sum += x);
        };
        add(&mut self.wanted, asked(&real));
        add(&mut self.at_tip, asked(&summed));
        add(&mut self.got, run.station.device.commanded());
        self.forces_n.iter_mut().zip(real).for_each(|(sum, contact)| *sum += contact.force_n.length());
        Ok(())
    }

    /// Torques of pitch and roll against those wanted, relative.
    fn tilt_off(&self, of: &[f64; N_AXES]) -> f64 {
        let wanted = &self.wanted;
        (of[0] - wanted[0]).hypot(of[1] - wanted[1]) / wanted[0].hypot(wanted[1])
    }

    fn experiments(&self) -> [Experiment; 4] {
        [
            Experiment::near(
                "a rod across a block: share of steps with tip and shaft in contact",
                OWN,
                f64::from(self.n_both) / f64::from(self.n),
                1.0,
                0.0,
            ),
            Experiment::at_most(
                "the same through World, law and board: torques of pitch and roll less those of the sum of both contacts, relative",
                THESIS,
                self.tilt_off(&self.got),
                0.03,
            ),
            Experiment::at_most(
                "the same: force along the instrument less that of both contacts, over the forces",
                THESIS,
                (self.got[2] - self.wanted[2]).abs() / (self.forces_n[0] + self.forces_n[1]),
                0.03,
            ),
            Experiment::within(
                "the same: torques if both forces acted at the tip, off, relative",
                "requirement: the test can fail",
                self.tilt_off(&self.at_tip),
                [0.05, 2.0],
            ),
        ]
    }
}

/// A rod that is pressed onto a block with tip and shaft: the motors exert what the sum of both contacts asks for.
pub(super) fn experiments(outcome: &mut Outcome) -> anyhow::Result<()> {
    let pivot_m = DVec3::new(-BESIDE_M, 0.47 * BLOCK_M, BLOCK_M);
    let placement = Placement::facing(pivot_m, DVec3::X);
    let start = leaning(&placement, -ROD_LEAD_M);
    let station = Station::new(placement, &start, Mapping::VirtualWork)?;
    let mut world = block(&placement, &start, TICK_S * f64::from(TICKS_PER_STEP))?;
    let mut run = Loop::new(station);
    let mut sums = Efforts::default();
    for k in 0..1200_u32 {
        let share = (f64::from(k) * TICK_S / PRESS_S).min(1.0);
        let target = leaning(&placement, (ROD_LEAD_M + ROD_DEPTH_M) * share - ROD_LEAD_M);
        run.tick(k, target, &mut |tool| {
            world.step(&StepInput::of(&[*tool]));
            world.haptic_model(0)
        })?;
        if k >= 900 && (k + 1).is_multiple_of(TICKS_PER_STEP) {
            sums.add(&mut run, &world)?;
        }
    }
    outcome.experiments.extend(sums.experiments());
    outcome.experiments.push(run.bound_row("the same"));
    let count = f64::from(sums.n);
    outcome.notes += &format!(
        "\nA rod across a block touches with its tip ({:.2} N) and its shaft ({:.2} N), {:.0} mm from the trocar: {:.1} mN m about it, \
         {:.1} mN m if both acted at the tip.\n",
        sums.forces_n[0] / count,
        sums.forces_n[1] / count,
        1e3 * ROD_M,
        1e3 * sums.wanted[0].hypot(sums.wanted[1]) / count,
        1e3 * sums.at_tip[0].hypot(sums.at_tip[1]) / count,
    );
    Ok(())
}
