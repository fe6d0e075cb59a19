//! The active trocar of seed `000`: statics over its workspace, saturation, encoders, and its board in a closed loop.

mod closed_loop;
mod encoders;
mod jaws;
mod law_loop;
mod liver;
mod mappings;
mod rod;

use super::{Experiment, Figure, Outcome};
use glam::DVec3;
use glisson::haptics::trocar::statics::{MomentShares, efforts, felt};
use glisson::haptics::trocar::{
    ContactForce, Mapping, N_AXES, Saturation, TrocarJoints, TrocarProfile, Wrench,
};
use glisson::math::SeededRandom;
use glisson_report::plot::{LinePlot, Series, SeriesStyle};

const THESIS: &str = "Chendeb 2007 (seed 000), s. 5.4.4";
const PROTOTYPE: &str = "Chendeb 2007 (seed 000), s. 5.4.5";
const EXACT: &str = "exact";
const OWN: &str = "requirement";
const SIZE: [u32; 2] = [960, 540];
/// Tilts of a workspace on each axis, the limits among them.
const N_TILTS: i32 = 40;
/// Depth of the tip in the figures [m]: half-way.
const DEPTH_M: f64 = 0.15;

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    workspace(&mut outcome);
    mappings::experiments(&mut outcome);
    saturation(&mut outcome);
    encoders::experiments(&mut outcome);
    liver::experiments(&mut outcome)?;
    rod::experiments(&mut outcome)?;
    jaws::experiments(&mut outcome)?;
    closed_loop::experiments(&mut outcome)?;
    Ok(outcome)
}

fn line(name: &str, points: Vec<[f64; 2]>) -> Series {
    Series { name: name.into(), points, style: SeriesStyle::Line }
}

fn dashed(name: &str, points: Vec<[f64; 2]>) -> Series {
    Series { style: SeriesStyle::Dashed, ..line(name, points) }
}

fn figure(file: &'static str, caption: &str, labels: [&str; 3], series: Vec<Series>) -> Figure {
    let [title, x_label, y_label] = labels.map(String::from);
    Figure { file, caption: caption.into(), plot: LinePlot { title, x_label, y_label, series, size: SIZE } }
}

/// Places over a whole workspace.
fn places(profile: &TrocarProfile) -> impl Iterator<Item = TrocarJoints> + use<> {
    let (limit_rad, depth_m) = (profile.tilt_limit_rad, profile.insertion_limit_m);
    let tilts =
        move || (0..=N_TILTS).map(move |i| limit_rad * (2.0 * f64::from(i) / f64::from(N_TILTS) - 1.0));
    tilts().flat_map(move |pitch_rad| {
        tilts().flat_map(move |roll_rad| {
            [0.01, 0.5, 1.0].map(|share| TrocarJoints {
                pitch_rad,
                roll_rad,
                insertion_m: share * depth_m,
                ..TrocarJoints::default()
            })
        })
    })
}

fn tilted([pitch_rad, roll_rad]: [f64; 2]) -> TrocarJoints {
    TrocarJoints { pitch_rad, roll_rad, ..TrocarJoints::default() }
}

fn random_vector(random: &mut SeededRandom, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-size, size)))
}

fn tip_wrench(joints: &TrocarJoints, force_n: DVec3) -> Wrench {
    Wrench::of(&[ContactForce { point_m: joints.pose().tip_m, force_n, torque_n_m: DVec3::ZERO }])
}

/// The largest differences from (5.6) and from virtual work over a workspace.
#[derive(Default)]
struct WorkspaceOff {
    /// Of the shares' sum from the moment, and of the shares from those printed [N m].
    sum_n_m: f64,
    printed_n_m: f64,
    /// Of the motors' power from that of the force [W].
    power_w: f64,
}

impl WorkspaceOff {
    /// With a random force near the tip.
    fn add(&mut self, joints: &TrocarJoints, random: &mut SeededRandom) {
        let direction = joints.direction();
        let [tilt, azimuth] = joints.spherical_rad();
        let contact = ContactForce {
            point_m: direction * joints.insertion_m + random_vector(random, 5e-3),
            force_n: random_vector(random, 20.0),
            torque_n_m: DVec3::ZERO,
        };
        let wrench = Wrench::of(&[contact]);
        let moment = wrench.moment_n_m;
        let shares = MomentShares::of(moment, direction);
        self.sum_n_m = self.sum_n_m.max(shares.sum_n_m(direction).distance(moment));
        let printed = DVec3::new(
            moment.x - moment.z * azimuth.cos() * tilt.tan(),
            moment.y - moment.z * azimuth.sin() * tilt.tan(),
            moment.z / tilt.cos(),
        );
        let found = DVec3::new(shares.about_x_n_m, shares.about_y_n_m, shares.about_instrument_n_m);
        self.printed_n_m = self.printed_n_m.max(found.distance(printed));
        let rates: [f64; N_AXES] =
            std::array::from_fn(|i| if i < 4 { random.uniform_in(-1.0, 1.0) } else { 0.0 });
        let [tip, angular] = joints.velocity(&rates);
        let at_contact = tip + angular.cross(contact.point_m - direction * joints.insertion_m);
        let by_motors = efforts(Mapping::VirtualWork, joints, &wrench, 0.0).to_array();
        let power_w: f64 = by_motors.iter().zip(rates).map(|(effort, rate)| effort * rate).sum();
        self.power_w = self.power_w.max((power_w - contact.force_n.dot(at_contact)).abs());
    }
}

/// (5.6) and virtual work everywhere.
fn workspace(outcome: &mut Outcome) {
    let mut random = SeededRandom::new(51);
    for profile in [TrocarProfile::built(), TrocarProfile::specified()] {
        let mut off = WorkspaceOff::default();
        places(&profile).for_each(|joints| off.add(&joints, &mut random));
        let n = places(&profile).count();
        let name = profile.name;
        outcome.experiments.extend([
            Experiment::at_most(
                &format!("{name}: C_r e_r + C_X e_X + C_Y e_Y - M_O, {n} places to both tilts at the limit, up to 35 N [N m]"),
                &format!("{THESIS}, eq. 5.6"),
                off.sum_n_m,
                1e-12,
            ),
            Experiment::at_most(
                &format!("{name}: the same shares against eq. 5.6 with the angles theta and phi [N m]"),
                THESIS,
                off.printed_n_m,
                1e-12,
            ),
            Experiment::at_most(
                &format!("{name}: virtual work: power of the motors less that of the force, up to 1 rad/s and 1 m/s [W]"),
                EXACT,
                off.power_w,
                1e-12,
            ),
        ]);
    }
    let limit_rad = TrocarProfile::specified().tilt_limit_rad;
    let corner = tilted([limit_rad, limit_rad]);
    outcome.experiments.push(Experiment::near(
        "specified: tilt theta with pitch and roll at 70 degrees [degrees]",
        "theta = atan(sqrt(2) tan 70)",
        corner.spherical_rad()[0].to_degrees(),
        75.6,
        1e-3,
    ));
}

/// What limits do to a force that grows.
fn saturation(outcome: &mut Outcome) {
    let profile = TrocarProfile::built();
    let joints = TrocarJoints { insertion_m: DEPTH_M, ..tilted([0.3, -0.3]) };
    let direction = joints.direction();
    // Half along, half across: the rollers are the first to give way.
    let oblique = (direction + direction.any_orthonormal_vector()).normalize();
    let rendered = |mapping: Mapping, saturation: Saturation, force_n: f64| {
        let told = efforts(mapping, &joints, &tip_wrench(&joints, oblique * force_n), 0.0);
        felt(&joints, &profile.limits.limit(&told, saturation).efforts).force_n
    };
    let off_deg = |n: DVec3| n.angle_between(oblique).to_degrees();
    let ten = 10.0 * 2.0_f64.sqrt();
    let clipped = rendered(Mapping::VirtualWork, Saturation::EachMotor, ten);
    let kept = rendered(Mapping::VirtualWork, Saturation::KeepDirection, ten);
    outcome.experiments.extend([
        Experiment::near(
            "built: 10 N along and 10 N across the instrument, each motor at its own limit: direction off [degrees]",
            "45 degrees less atan(5 / 10)",
            off_deg(clipped),
            45.0 - 0.5_f64.atan().to_degrees(),
            1e-9,
        ),
        Experiment::near(
            "built: the same: force along the instrument [N]",
            PROTOTYPE,
            clipped.dot(direction),
            5.0,
            1e-9,
        ),
        Experiment::at_most(
            "built: the same, all motors giving way together: direction off [degrees]",
            EXACT,
            off_deg(kept),
            1e-5,
        ),
        Experiment::near("built: the same: what is left of 14.14 N [N]", EXACT, kept.length(), 0.5 * ten, 1e-9),
    ]);
    let curve = |mapping: Mapping, saturation: Saturation| -> Vec<[f64; 2]> {
        (1..=80)
            .map(|k| 0.25 * f64::from(k))
            .map(|n| [n, off_deg(rendered(mapping, saturation, n))])
            .collect()
    };
    outcome.figures.push(figure(
        "active_trocar_saturation.svg",
        "A force at the tip, 45 degrees off the instrument (pitch 17, roll -17 degrees, 0.15 m in), grows: how far the \
         direction that the hand feels is off, when each motor stops at its own limit and when all give way together.",
        ["Direction under saturation", "force [N]", "direction off [degrees]"],
        vec![
            line("virtual work, each", curve(Mapping::VirtualWork, Saturation::EachMotor)),
            line("virtual work, together", curve(Mapping::VirtualWork, Saturation::KeepDirection)),
            line("eq. 5.6, each", curve(Mapping::Thesis, Saturation::EachMotor)),
            line("eq. 5.6, together", curve(Mapping::Thesis, Saturation::KeepDirection)),
        ],
    ));
}
