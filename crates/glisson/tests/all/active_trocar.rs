//! The active trocar of seed `000`: kinematics, statics, encoders, tags, places, teleoperation.

use glisson::haptics::trocar::encoders::{SensorFault, VelocityEstimate, counts_at};
use glisson::haptics::trocar::identification::{InstrumentTag, InstrumentType, TagError};
use glisson::haptics::trocar::kinematics::NO_DIRECTION_M;
use glisson::haptics::trocar::mechanism::Mechanism;
use glisson::haptics::trocar::motors::{analog_outputs, torques_of_outputs};
use glisson::haptics::trocar::placement::{ArrangementError, handle_orientation};
use glisson::haptics::trocar::statics::{LEAST_COS_TILT, MomentShares, efforts, felt};
use glisson::haptics::trocar::teleoperation::{End, Teleoperation};
use glisson::haptics::trocar::{
    Arrangement, Axis, AxisEfforts, ContactForce, EncoderSample, JointReader, Mapping, N_AXES, Placement,
    Saturation, TrocarJoints, TrocarProfile, Wrench,
};
use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;

fn random_vector(random: &mut SeededRandom, size: f64) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| random.uniform_in(-size, size)))
}

/// Corners, edges and inner places of a workspace, tips from 1 mm to the greatest depth.
fn places(profile: &TrocarProfile) -> Vec<TrocarJoints> {
    let mut random = SeededRandom::new(31);
    let mut found = Vec::new();
    for i in -4..=4 {
        for j in -4..=4 {
            for depth in [1e-3, 0.1, profile.insertion_limit_m] {
                found.push(TrocarJoints {
                    pitch_rad: profile.tilt_limit_rad * f64::from(i) / 4.0,
                    roll_rad: profile.tilt_limit_rad * f64::from(j) / 4.0,
                    insertion_m: depth,
                    self_rotation_rad: random.uniform_in(-7.0, 7.0),
                    jaw_opening: random.uniform(),
                });
            }
        }
    }
    found
}

fn both() -> [TrocarProfile; 2] {
    [TrocarProfile::built(), TrocarProfile::specified()]
}

#[test]
fn the_profiles_have_the_figures_of_the_thesis() {
    let [built, specified] = both();
    let degrees = |rad: f64| (rad.to_degrees() * 1e6).round() / 1e6;
    assert_eq!([degrees(built.tilt_limit_rad), degrees(specified.tilt_limit_rad)], [45.0, 70.0]);
    assert_eq!(built.resolution.map(degrees)[0], 0.01);
    assert_eq!(degrees(built.resolution[3]), 0.05);
    assert_eq!([built.resolution[2], specified.resolution[2]], [1e-4, 5e-5]);
    assert_eq!([built.insertion_limit_m, specified.insertion_limit_m], [0.3, 0.4]);
    assert_eq!([built.rate_hz, specified.rate_hz], [1000.0, 1500.0]);
    assert_eq!(built.limits.to_array()[..4], [6.0, 6.0, 5.0, 0.2]);
    assert_eq!(
        TrocarProfile::NAMES.map(|name| TrocarProfile::of_name(name).unwrap().name),
        ["built", "specified"]
    );
    assert!(TrocarProfile::of_name("Built").is_none());
    let corner = TrocarJoints {
        pitch_rad: specified.tilt_limit_rad,
        roll_rad: specified.tilt_limit_rad,
        ..TrocarJoints::default()
    };
    let tilt_deg = corner.spherical_rad()[0].to_degrees();
    assert!((tilt_deg - 75.6).abs() < 0.05, "both tilts at 70 degrees: {tilt_deg}");
    let limits = built.device_limits();
    assert_eq!([limits.force_n, limits.torque_n_m, limits.rate_hz], [5.0, 0.2, 1000.0]);
    assert!((limits.stiffness_n_per_m - 2000.0).abs() < 1e-9);
}

#[test]
fn each_sensor_tells_one_slope_of_the_instrument() {
    for profile in both() {
        for joints in places(&profile) {
            let direction = joints.direction();
            assert!((direction.length() - 1.0).abs() < 1e-14);
            let slopes = [direction.x / direction.z, -direction.y / direction.z];
            let wanted = [joints.roll_rad.tan(), joints.pitch_rad.tan()];
            for (found, wanted) in slopes.into_iter().zip(wanted) {
                assert!((found - wanted).abs() < 1e-12, "{joints:?}");
            }
            let [tilt, azimuth] = joints.spherical_rad();
            let spherical = DVec3::new(tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), tilt.cos());
            assert!(spherical.distance(direction) < 1e-14);
        }
    }
}

#[test]
fn a_pose_gives_its_motions_back() {
    for joints in places(&TrocarProfile::specified()) {
        let pose = joints.pose();
        let turn = pose.device_from_instrument;
        assert!((turn.determinant() - 1.0).abs() < 1e-12);
        let back = pose.joints().unwrap();
        let mut off = back.to_array();
        for (found, wanted) in off.iter_mut().zip(joints.to_array()) {
            *found -= wanted;
        }
        let turns = off[3] / std::f64::consts::TAU;
        assert!(off[..3].iter().all(|o| o.abs() < 1e-12), "{joints:?} {back:?}");
        assert!((turns - turns.round()).abs() < 1e-12, "{joints:?} {back:?}");
        let reached = joints.reaching(pose.tip_m).unwrap();
        assert!(reached.pose().tip_m.distance(pose.tip_m) < 1e-14);
    }
}

#[test]
fn a_tip_in_the_centre_keeps_its_direction() {
    let joints =
        TrocarJoints { pitch_rad: 0.3, roll_rad: -0.4, insertion_m: 0.02, ..TrocarJoints::default() };
    let found = joints.reaching(DVec3::new(0.5, -0.3, 0.4) * NO_DIRECTION_M).unwrap();
    assert_eq!([found.pitch_rad, found.roll_rad], [0.3, -0.4]);
    assert!(found.insertion_m.abs() < NO_DIRECTION_M);
    assert!(joints.reaching(DVec3::new(0.0, 0.1, -0.1)).is_none(), "behind the device");
    assert!(joints.reaching(DVec3::splat(f64::NAN)).is_none());
    let turned = TrocarJoints::default().pose();
    let upside_down = glisson::haptics::trocar::TrocarPose {
        device_from_instrument: DMat3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::NEG_Z),
        ..turned
    };
    assert!(upside_down.joints().is_none());
}

#[test]
fn motion_axes_are_the_derivatives_of_the_pose() {
    let step = 1e-6;
    for joints in places(&TrocarProfile::specified()) {
        for axis in 0..4 {
            let moved = |by: f64| {
                let mut values = joints.to_array();
                values[axis] += by;
                TrocarJoints::from_array(values).pose()
            };
            let (after, before) = (moved(step), moved(-step));
            let mut rates = [0.0; N_AXES];
            rates[axis] = 1.0;
            let [velocity, angular] = joints.velocity(&rates);
            let found = (after.tip_m - before.tip_m) / (2.0 * step);
            assert!(found.distance(velocity) < 2e-9, "axis {axis} of {joints:?}: {found} {velocity}");
            // dR/dq R^T is the cross-product matrix of the angular velocity.
            let difference = (after.device_from_instrument - before.device_from_instrument) * (0.5 / step);
            let spin = difference * joints.pose().device_from_instrument.transpose();
            let found = DVec3::new(spin.y_axis.z, spin.z_axis.x, spin.x_axis.y);
            assert!(found.distance(angular) < 2e-9, "axis {axis} of {joints:?}: {found} {angular}");
        }
    }
}

#[test]
fn the_three_couples_make_the_moment() {
    let mut random = SeededRandom::new(32);
    for profile in both() {
        for joints in places(&profile) {
            let direction = joints.direction();
            let [tilt, azimuth] = joints.spherical_rad();
            let force_n = random_vector(&mut random, 20.0);
            let point_m = direction * joints.insertion_m + random_vector(&mut random, 5e-3);
            let moment_n_m =
                Wrench::of(&[ContactForce { point_m, force_n, torque_n_m: DVec3::ZERO }]).moment_n_m;
            let shares = MomentShares::of(moment_n_m, direction);
            assert!(shares.sum_n_m(direction).distance(moment_n_m) < 1e-12, "{joints:?}");
            // As printed: (5.1) in components, (5.6) with the angles.
            let [x, y, z] = point_m.to_array();
            let [fx, fy, fz] = force_n.to_array();
            let printed = [
                (y * fz - z * fy) - (x * fy - y * fx) * azimuth.cos() * tilt.tan(),
                (z * fx - x * fz) - (x * fy - y * fx) * azimuth.sin() * tilt.tan(),
                (x * fy - y * fx) / tilt.cos(),
            ];
            let found = [shares.about_x_n_m, shares.about_y_n_m, shares.about_instrument_n_m];
            for (found, printed) in found.into_iter().zip(printed) {
                assert!((found - printed).abs() < 1e-12, "{joints:?}: {found} {printed}");
            }
            let axial_n =
                efforts(Mapping::Thesis, &joints, &Wrench { force_n, moment_n_m }, 0.0).translation_n;
            let printed_n =
                tilt.sin() * azimuth.cos() * fx + tilt.sin() * azimuth.sin() * fy + tilt.cos() * fz;
            assert!((axial_n - printed_n).abs() < 1e-12);
        }
    }
}

#[test]
fn shares_stay_finite_where_the_tilt_has_no_tangent() {
    let moment_n_m = DVec3::new(1.0, -2.0, 3.0);
    for direction in [DVec3::X, DVec3::new(0.6, -0.8, 0.0), DVec3::new(0.0, 0.6, -0.8)] {
        let shares = MomentShares::of(moment_n_m, direction);
        assert!(shares.about_instrument_n_m <= moment_n_m.z / LEAST_COS_TILT);
        assert!(shares.sum_n_m(direction).is_finite());
    }
}

#[test]
fn virtual_work_keeps_the_power() {
    let mut random = SeededRandom::new(33);
    for profile in both() {
        for joints in places(&profile) {
            let pose = joints.pose();
            let rates: [f64; N_AXES] =
                std::array::from_fn(|i| if i == 4 { 0.0 } else { random.uniform_in(-1.0, 1.0) });
            let [tip_velocity, angular] = joints.velocity(&rates);
            let contacts: [ContactForce; 3] = std::array::from_fn(|_| ContactForce {
                point_m: pose.tip_m + random_vector(&mut random, 0.02),
                force_n: random_vector(&mut random, 5.0),
                torque_n_m: random_vector(&mut random, 0.1),
            });
            let power_w: f64 = contacts
                .iter()
                .map(|c| {
                    let velocity = tip_velocity + angular.cross(c.point_m - pose.tip_m);
                    c.force_n.dot(velocity) + c.torque_n_m.dot(angular)
                })
                .sum();
            let found = efforts(Mapping::VirtualWork, &joints, &Wrench::of(&contacts), 0.0).to_array();
            let motors_w: f64 = found.iter().zip(rates).map(|(effort, rate)| effort * rate).sum();
            assert!(
                (power_w - motors_w).abs() < 1e-12 * (1.0 + power_w.abs()),
                "{joints:?}: {power_w} {motors_w}"
            );
        }
    }
}

#[test]
fn virtual_work_is_felt_as_it_was_and_the_thesis_only_upright() {
    let mut random = SeededRandom::new(34);
    for joints in places(&TrocarProfile::built()) {
        let tip_m = joints.pose().tip_m;
        let force_n = random_vector(&mut random, 5.0);
        let wrench = Wrench::of(&[ContactForce { point_m: tip_m, force_n, torque_n_m: DVec3::ZERO }]);
        let exact = efforts(Mapping::VirtualWork, &joints, &wrench, 0.0);
        assert!(felt(&joints, &exact).force_n.distance(force_n) < 1e-10, "{joints:?}");
        assert!(exact.self_rotation_n_m.abs() < 1e-12, "a force on the axis turns nothing about it");
        let published = efforts(Mapping::Thesis, &joints, &wrench, 0.0);
        let is_upright = joints.pitch_rad.abs() + joints.roll_rad.abs() < 1e-9;
        if is_upright {
            for (a, b) in exact.to_array().into_iter().zip(published.to_array()) {
                assert!((a - b).abs() < 1e-12);
            }
        }
        if joints.pitch_rad.abs() < 1e-9 {
            let over = 1.0 / joints.roll_rad.cos().powi(2);
            assert!((published.pitch_n_m - over * exact.pitch_n_m).abs() < 1e-12, "{joints:?}");
            assert!((published.roll_n_m - exact.roll_n_m).abs() < 1e-12, "{joints:?}");
        }
    }
    let in_centre = TrocarJoints { insertion_m: 0.0, ..TrocarJoints::default() };
    let told = felt(&in_centre, &AxisEfforts { pitch_n_m: 1.0, ..AxisEfforts::default() });
    assert!(told.force_n.is_finite() && told.moment_n_m.distance(DVec3::X) < 1e-12);
}

#[test]
fn several_contacts_are_the_sum_of_their_efforts() {
    let mut random = SeededRandom::new(35);
    let joints = TrocarJoints { pitch_rad: 0.5, roll_rad: -0.6, insertion_m: 0.2, ..TrocarJoints::default() };
    let contacts: [ContactForce; 4] = std::array::from_fn(|_| ContactForce {
        point_m: random_vector(&mut random, 0.2),
        force_n: random_vector(&mut random, 3.0),
        torque_n_m: DVec3::ZERO,
    });
    for mapping in [Mapping::Thesis, Mapping::VirtualWork] {
        let of = |contacts: &[ContactForce]| efforts(mapping, &joints, &Wrench::of(contacts), 0.0).to_array();
        let together = of(&contacts);
        let mut sum = [0.0; N_AXES];
        for contact in &contacts {
            for (s, e) in sum.iter_mut().zip(of(std::slice::from_ref(contact))) {
                *s += e;
            }
        }
        for (a, b) in together.into_iter().zip(sum) {
            assert!((a - b).abs() < 1e-13);
        }
    }
    assert_eq!(Wrench::of(&[]), Wrench::default());
}

#[test]
fn motors_exert_what_the_equations_say() {
    let TrocarProfile { transmission, limits, .. } = TrocarProfile::built();
    let wanted = AxisEfforts {
        pitch_n_m: 1.0,
        roll_n_m: -2.0,
        translation_n: 3.0,
        self_rotation_n_m: 0.1,
        jaw_n: 2.0,
    };
    let torques = transmission.motor_torques_n_m(&wanted);
    // (5.8) with 5 mm and 0.7; (5.9) with 4 and 0.965; (5.10) directly.
    let expected = [1.0, -2.0, 5e-3 * 3.0 / 0.7, 0.1 / (4.0 * 0.965), 0.02];
    for (found, expected) in torques.into_iter().zip(expected) {
        assert!((found - expected).abs() < 1e-15, "{found} {expected}");
    }
    let full_scale = transmission.full_scale_n_m(&limits);
    let outputs = analog_outputs(&torques, &full_scale);
    let back = transmission.efforts(&torques_of_outputs(&outputs, &full_scale)).to_array();
    for ((found, wanted), limit) in back.into_iter().zip(wanted.to_array()).zip(limits.to_array()) {
        assert!((found - wanted).abs() <= 0.5 * limit / 32767.0 + 1e-12);
    }
    let beyond = analog_outputs(&[7.0, -70.0, f64::NAN, 0.0, f64::INFINITY], &full_scale);
    assert_eq!(beyond, [32767, -32767, 0, 0, 32767]);
}

#[test]
fn saturation_bends_the_force_or_shortens_it() {
    let profile = TrocarProfile::built();
    let joints = TrocarJoints { pitch_rad: 0.2, roll_rad: 0.4, insertion_m: 0.2, ..TrocarJoints::default() };
    let wrench_of = |force_n: DVec3| {
        Wrench::of(&[ContactForce { point_m: joints.pose().tip_m, force_n, torque_n_m: DVec3::ZERO }])
    };
    let direction = joints.direction();
    let force_n = direction * 10.0 + direction.any_orthonormal_vector() * 10.0;
    let wanted = efforts(Mapping::VirtualWork, &joints, &wrench_of(force_n), 20.0);
    let clipped = profile.limits.limit(&wanted, Saturation::EachMotor);
    assert_eq!(clipped.is_limited, [false, false, true, false, true]);
    let felt_n = felt(&joints, &clipped.efforts).force_n;
    // 5 of 10 N along the instrument are left, all of the 10 N across: 18.4 degrees off.
    let angle = felt_n.angle_between(force_n).to_degrees();
    assert!((angle - (45.0 - 0.5_f64.atan().to_degrees())).abs() < 1e-9, "{angle}");
    let short = profile.limits.limit(&wanted, Saturation::KeepDirection);
    let felt_n = felt(&joints, &short.efforts).force_n;
    assert!(felt_n.angle_between(force_n) < 1e-7 && (felt_n.dot(direction) - 5.0).abs() < 1e-12);
    assert_eq!(short.efforts.jaw_n, 10.0, "the jaws have their own limit");
    let small = efforts(Mapping::VirtualWork, &joints, &wrench_of(force_n * 0.1), 1.0);
    for saturation in [Saturation::EachMotor, Saturation::KeepDirection] {
        assert_eq!(profile.limits.limit(&small, saturation).efforts, small);
    }
    let nonsense = AxisEfforts { pitch_n_m: f64::NAN, roll_n_m: 1.0, ..AxisEfforts::default() };
    for saturation in [Saturation::EachMotor, Saturation::KeepDirection] {
        let found = profile.limits.limit(&nonsense, saturation).efforts;
        assert_eq!([found.pitch_n_m, found.roll_n_m], [0.0, 1.0]);
    }
}

/// Encoders switched on at a random place, that have passed their marks.
fn sample(profile: &TrocarProfile, joints: &TrocarJoints, zero_steps: &[f64; N_AXES]) -> EncoderSample {
    let values = joints.to_array();
    EncoderSample {
        counts: std::array::from_fn(|i| counts_at(values[i], profile.resolution[i], zero_steps[i])),
        mark_counts: std::array::from_fn(|i| counts_at(0.0, profile.resolution[i], zero_steps[i])),
        is_marked: [true; N_AXES],
    }
}

#[test]
fn encoders_give_motions_back_within_a_step() {
    let mut random = SeededRandom::new(36);
    for profile in both() {
        let zero_steps: [f64; N_AXES] = std::array::from_fn(|_| random.uniform_in(-5000.0, 5000.0));
        for place in places(&profile) {
            // Places are whole numbers of steps; most others are not.
            let values = place.to_array();
            let moved: [f64; N_AXES] =
                std::array::from_fn(|i| values[i] + random.uniform_in(-1.0, 1.0) * profile.resolution[i]);
            let joints = profile.within(&TrocarJoints::from_array(moved));
            let mut reader = JointReader::new(profile);
            let reading = reader.read(&sample(&profile, &joints, &zero_steps), 1e-3).unwrap();
            for (axis, (found, wanted)) in
                reading.joints.to_array().into_iter().zip(joints.to_array()).enumerate()
            {
                assert!(
                    (found - wanted).abs() <= profile.resolution[axis] * (1.0 + 1e-9),
                    "{axis}: {found} {wanted}"
                );
            }
        }
    }
}

#[test]
fn motions_are_unknown_until_the_marks_are_passed() {
    let profile = TrocarProfile::built();
    let joints = TrocarJoints { pitch_rad: 0.1, insertion_m: 0.1, ..TrocarJoints::default() };
    let zero_steps = [12.5, -7.25, 3.0, 100.5, 0.5];
    let known = sample(&profile, &joints, &zero_steps);
    let mut unknown = known;
    unknown.is_marked[Axis::Roll as usize] = false;
    unknown.is_marked[Axis::Insertion as usize] = false;
    let mut reader = JointReader::new(profile);
    let fault = reader.read(&unknown, 1e-3).unwrap_err();
    assert_eq!(fault.to_string(), "the marks of roll, insertion have not been passed");
    assert!(reader.read(&known, 1e-3).is_ok());
    // A turn later the mark of the self-rotation has another count and stands for the same place.
    let mut turned = known;
    turned.counts[3] += 7200;
    turned.mark_counts[3] += 7200;
    let found = reader.read(&turned, 1e-3).unwrap().joints.self_rotation_rad;
    assert!((found - std::f64::consts::TAU).abs() < 1e-3);
    let mut lost = known;
    lost.counts[0] += 9000;
    let fault = reader.read(&lost, 1e-3).unwrap_err();
    assert!(matches!(fault, SensorFault::OutOfRange { axis: Axis::Pitch, .. }), "{fault}");
    assert!(fault.to_string().starts_with("pitch is at 1.6"), "{fault}");
    let far = EncoderSample { counts: [i32::MAX; 5], mark_counts: [i32::MIN; 5], is_marked: [true; 5] };
    assert!(JointReader::new(profile).read(&far, 1e-3).is_err(), "no overflow");
}

#[test]
fn velocity_is_smooth_slow_and_quick_when_it_must() {
    let step_s = 1e-3;
    // Slow and steady: 3 steps a second; fast: 4321; at rest: none.
    for wanted in [0.0, 3.0, 40.0, 4321.0] {
        let mut estimate = VelocityEstimate::default();
        let mut worst = 0.0_f64;
        for k in 0..400 {
            let steps = (0.3 + wanted * f64::from(k) * step_s).floor();
            let found = estimate.push(steps, step_s);
            if k > 100 {
                worst = worst.max((found - wanted).abs());
            }
        }
        let most = if wanted > 0.0 { 2.0 / (31.0 * step_s) } else { 0.0 };
        assert!(worst <= most, "{wanted}: off by {worst}");
    }
    // It turns round: followed within a few milliseconds.
    let mut estimate = VelocityEstimate::default();
    let mut at = 0.0;
    let mut late = 0;
    for k in 0..300 {
        let rate = if k < 150 { 2000.0 } else { -2000.0 };
        at += rate * step_s;
        let found = estimate.push((at + 0.3_f64).floor(), step_s);
        if k >= 150 && (found - rate).abs() > 500.0 {
            late += 1;
        }
    }
    assert!(late <= 4, "{late} ms late");
}

#[test]
fn instruments_are_told_apart_and_misread_tags_refused() {
    let mut codes: Vec<u8> = InstrumentType::ALL.iter().map(|t| t.code()).collect();
    codes.dedup();
    assert_eq!(codes.len(), 13);
    for (i, instrument) in InstrumentType::ALL.into_iter().enumerate() {
        let tag = InstrumentTag { instrument, serial: 0x1234 + i as u16 };
        let bytes = tag.to_bytes();
        assert_eq!(InstrumentTag::of_bytes(bytes), Ok(tag));
        // CRC-8 with this polynomial finds every one and two wrong bits of a tag.
        for a in 0..32 {
            for b in a..32 {
                let mut wrong = bytes;
                wrong[a / 8] ^= 1 << (a % 8);
                if b != a {
                    wrong[b / 8] ^= 1 << (b % 8);
                }
                assert!(matches!(InstrumentTag::of_bytes(wrong), Err(TagError::Check { .. })), "{a} {b}");
            }
        }
        let kind = instrument.tool_kind();
        assert!(glisson::tool::instrument_names().any(|name| name == kind), "{kind}");
    }
    assert!(InstrumentType::of_code(0).is_none() && InstrumentType::of_code(14).is_none());
}

#[test]
fn a_trocar_in_the_world_gives_tools_and_takes_forces() {
    let mut random = SeededRandom::new(37);
    for inward in [DVec3::Y, DVec3::NEG_Z, DVec3::new(0.3, 0.8, -0.2).normalize()] {
        let placement = Placement::facing(DVec3::new(0.05, -0.12, 0.3), inward);
        assert!(placement.world_from_device.z_axis.distance(inward) < 1e-12);
        for joints in places(&TrocarProfile::built()) {
            let tool = placement.tool_input(&joints);
            let tip_m = joints.pose().tip_m;
            assert!(placement.to_device_m(tool.tip_in_world_m).distance(tip_m) < 1e-12);
            let through = tool.through(Some(placement.pivot_in_world_m));
            assert!(through.shaft_in_world.distance(tool.shaft_in_world) < 1e-9, "it goes through the pivot");
            let frame = ToolFrame::of(&tool);
            let handle = handle_orientation(&joints.pose());
            for axis in [DVec3::X, DVec3::Y, DVec3::Z] {
                let by_quaternion = placement.world_from_device * (handle * axis);
                assert!(by_quaternion.distance(frame.world_from_tool * axis) < 1e-9);
            }
            let back = placement.joints(&tool).unwrap();
            let again = placement.tool_input(&back);
            assert!(again.tip_in_world_m.distance(tool.tip_in_world_m) < 1e-12);
            assert!((again.roll_rad - tool.roll_rad).sin().abs() < 1e-9);
            let force_n = random_vector(&mut random, 3.0);
            let contact = placement.contact(tool.tip_in_world_m, force_n);
            assert!(contact.point_m.distance(tip_m) < 1e-12);
            assert!((placement.world_from_device * contact.force_n).distance(force_n) < 1e-12);
        }
        let out = ToolInput::at(placement.pivot_in_world_m + inward * 0.1, inward);
        assert!(placement.joints(&out).is_none(), "the handle would be in the body");
    }
}

#[test]
fn four_trocars_stand_together_and_five_do_not() {
    let built = TrocarProfile::built();
    let first = Placement::facing(DVec3::new(0.1, 0.0, 0.2), DVec3::Y);
    let four = Arrangement::adjacent(built, first, 4).unwrap();
    let apart = |i: usize, j: usize| {
        four.placements()[i].pivot_in_world_m.distance(four.placements()[j].pivot_in_world_m)
    };
    for (i, j) in [(0, 1), (0, 2), (1, 3), (2, 3)] {
        assert!((apart(i, j) - 0.1).abs() < 1e-12, "{i} {j}");
    }
    assert_eq!(Arrangement::adjacent(built, first, 5), Err(ArrangementError::Count(5)));
    assert_eq!(Arrangement::adjacent(built, first, 0), Err(ArrangementError::Count(0)));
    let near = Placement { pivot_in_world_m: first.to_world_m(DVec3::new(0.06, 0.0, 0.0)), ..first };
    let refusal = Arrangement::new(built, vec![first, near]).unwrap_err();
    assert_eq!(
        refusal.to_string(),
        "active trocars 1 and 2 are 60.0 mm apart; their cradles need 100.0 mm: move one away"
    );
    // Side by side the shafts keep their distance; leant towards each other they meet.
    let straight = TrocarJoints { insertion_m: 0.15, ..TrocarJoints::default() };
    assert!((four.clearance_m([0, 1], [&straight, &straight], 0.1) - 0.1).abs() < 1e-12);
    let lean =
        |sign: f64| TrocarJoints { roll_rad: sign * (0.05_f64 / 0.1).atan(), insertion_m: 0.2, ..straight };
    let met = four.clearance_m([0, 1], [&lean(1.0), &lean(-1.0)], 0.1);
    assert!(met < 1e-12, "{met}");
}

#[test]
fn a_hand_yields_to_the_motors_by_its_stiffness() {
    let profile = TrocarProfile::built();
    let start =
        TrocarJoints { pitch_rad: 0.2, insertion_m: 0.15, jaw_opening: 0.5, ..TrocarJoints::default() };
    let mut mechanism = Mechanism::new(profile, start);
    let motors = AxisEfforts {
        pitch_n_m: 0.5,
        roll_n_m: -0.3,
        translation_n: -2.0,
        self_rotation_n_m: 0.05,
        jaw_n: 1.0,
    };
    for _ in 0..2000 {
        mechanism.advance(&motors, 1e-3);
    }
    for (hand, motor) in mechanism.hand_efforts().into_iter().zip(motors.to_array()) {
        assert!((hand + motor).abs() < 1e-6, "{hand} {motor}");
    }
    assert!(mechanism.kinetic_energy_j() < 1e-12);
    // At the end of its range it stops, whatever pushes.
    mechanism.hand_target = None;
    for _ in 0..3000 {
        mechanism.advance(&AxisEfforts { roll_n_m: 6.0, ..AxisEfforts::default() }, 1e-3);
    }
    assert_eq!(mechanism.joints.roll_rad, profile.tilt_limit_rad);
}

/// What came out of a teleoperation.
#[derive(Default)]
struct Teleoperated {
    /// Over the last half second, along the instrument: what the wall exerted, the leader's motor and its hand [N].
    wall_n: f64,
    leader_n: f64,
    hand_n: f64,
    /// Largest difference of the pitches then [rad].
    pitch_off_rad: f64,
    /// Largest energy that the two ends got out of the coupling [J].
    given_j: f64,
}

/// A leader in a hand and a follower that meets a wall.
fn teleoperate(through_encoders: bool) -> Teleoperated {
    const WALL_M: f64 = 0.12;
    const WALL_N_PER_M: f64 = 2000.0;
    let profile = TrocarProfile::built();
    let start = TrocarJoints { insertion_m: 0.1, ..TrocarJoints::default() };
    let mut ends = [Mechanism::new(profile, start), Mechanism::new(profile, start)];
    ends[1].hand_target = None;
    let link = Teleoperation::couple(profile, [&start, &start], 1.0);
    let mut readers = [JointReader::new(profile), JointReader::new(profile)];
    let zero_steps = [0.5; N_AXES];
    let mut found = Teleoperated::default();
    let mut given_j = 0.0;
    for k in 0..3000 {
        let t = f64::from(k) * 1e-3;
        let depth_m = 0.1 + 0.03 * (t / 1.5).min(1.0);
        let swing = 0.3 * (3.0 * t).sin() * (1.0 - t / 3.0);
        ends[0].hand_target = Some(TrocarJoints { insertion_m: depth_m, pitch_rad: swing, ..start });
        let read = |i: usize, reader: &mut JointReader| {
            if through_encoders {
                let reading = reader.read(&sample(&profile, &ends[i].joints, &zero_steps), 1e-3).unwrap();
                End { joints: reading.joints, rates: reading.rates }
            } else {
                End { joints: ends[i].joints, rates: ends[i].rates }
            }
        };
        let [leader, follower] = &mut readers;
        let exchange = link.tick(&read(0, leader), &read(1, follower));
        let wall_n = (-WALL_N_PER_M * (ends[1].joints.insertion_m - WALL_M)).min(0.0);
        let efforts = [exchange.leader.to_array(), exchange.follower.to_array()];
        for (i, end) in ends.iter_mut().enumerate() {
            let before = end.joints.to_array();
            let mut motors = AxisEfforts::from_array(efforts[i]);
            if i == 1 {
                motors.translation_n += wall_n;
            }
            end.advance(&motors, 1e-3);
            let after = end.joints.to_array();
            given_j += (0..4).map(|a| efforts[i][a] * (after[a] - before[a])).sum::<f64>();
        }
        found.given_j = given_j.max(found.given_j);
        if k >= 2500 {
            found.wall_n -= wall_n / 500.0;
            found.leader_n -= exchange.leader.translation_n / 500.0;
            found.hand_n += ends[0].hand_efforts()[2] / 500.0;
            let pitch_off_rad = (ends[0].joints.pitch_rad - ends[1].joints.pitch_rad).abs();
            found.pitch_off_rad = found.pitch_off_rad.max(pitch_off_rad);
        }
    }
    found
}

#[test]
fn a_leader_drives_a_second_trocar_and_feels_its_wall() {
    for (through_encoders, most_n) in [(false, 0.01), (true, 0.05)] {
        let Teleoperated { wall_n, leader_n, hand_n, pitch_off_rad, given_j } = teleoperate(through_encoders);
        assert!(wall_n > 1.0, "{wall_n}");
        assert!((leader_n - wall_n).abs() < most_n, "{through_encoders}: {leader_n} {wall_n}");
        assert!((hand_n - wall_n).abs() < most_n, "the hand holds what the wall exerts: {hand_n} {wall_n}");
        assert!(pitch_off_rad < 2e-3, "{pitch_off_rad}");
        // A sampled spring gives some energy back (Colgate and Schenkel 1997): here less than a hundredth of a joule.
        assert!(given_j < 0.01, "{given_j} J");
    }
}

#[test]
fn scaled_teleoperation_keeps_the_power_and_the_range() {
    let profile = TrocarProfile::built();
    let start = TrocarJoints { insertion_m: 0.1, ..TrocarJoints::default() };
    let link = Teleoperation::couple(profile, [&start, &start], 0.5);
    let mut random = SeededRandom::new(38);
    for _ in 0..100 {
        let mut end = |size: f64| End {
            joints: TrocarJoints {
                pitch_rad: random.uniform_in(-size, size),
                insertion_m: 0.1 + random.uniform_in(-1e-4, 1e-4),
                jaw_opening: random.uniform(),
                ..TrocarJoints::default()
            },
            rates: [0.0; N_AXES],
        };
        let (leader, follower) = (end(0.05), end(0.05));
        let exchange = link.tick(&leader, &follower);
        for i in 0..4 {
            let (there, back) = (exchange.follower.to_array()[i], exchange.leader.to_array()[i]);
            assert!((back + 0.5 * there).abs() < 1e-12);
        }
        assert_eq!(exchange.leader.jaw_n, -exchange.follower.jaw_n);
        assert!((exchange.target.jaw_opening - leader.joints.jaw_opening).abs() < 1e-15);
    }
    let far =
        End { joints: TrocarJoints { insertion_m: 0.3, pitch_rad: 0.7, ..start }, rates: [0.0; N_AXES] };
    let reach =
        Teleoperation::couple(profile, [&start, &start], 3.0).tick(&far, &End { joints: start, ..far });
    assert_eq!(reach.target.insertion_m, 0.3);
    assert!(reach.target.pitch_rad <= profile.tilt_limit_rad);
}

#[test]
fn a_tick_allocates_nothing() {
    let profile = TrocarProfile::built();
    let joints = TrocarJoints { pitch_rad: 0.3, insertion_m: 0.2, ..TrocarJoints::default() };
    let zero_steps = [0.5; N_AXES];
    let mut reader = JointReader::new(profile);
    let placement = Placement::facing(DVec3::ZERO, DVec3::Y);
    let full_scale = profile.transmission.full_scale_n_m(&profile.limits);
    let link = Teleoperation::couple(profile, [&joints, &joints], 1.0);
    let allocated = allocation_counter::measure(|| {
        for _ in 0..100 {
            let reading = reader.read(&sample(&profile, &joints, &zero_steps), 1e-3).expect("homed");
            let tool = placement.tool_input(&reading.joints);
            let contact = placement.contact(tool.tip_in_world_m, DVec3::ONE);
            let wanted = efforts(Mapping::Thesis, &reading.joints, &Wrench::of(&[contact]), 0.0);
            let limited = profile.limits.limit(&wanted, Saturation::EachMotor);
            let torques = profile.transmission.motor_torques_n_m(&limited.efforts);
            std::hint::black_box(analog_outputs(&torques, &full_scale));
            let end = End { joints: reading.joints, rates: reading.rates };
            std::hint::black_box(link.tick(&end, &end));
        }
    });
    assert_eq!(allocated.count_total, 0);
}
