//! The messages of ROS 2 that are published, and the hashes of their types (RIHS01, REP 2016), which subscribers compare.
//! Fields in the order of the .msg files of common_interfaces (Jazzy) and of crtk_msgs (collaborative-robotics/crtk_msgs).
//! Metres, newtons, radians.

use super::cdr::CdrWriter;
use glisson::math::{DMat3, DVec3};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The frame of poses and surface: the patient's, x to the left, y to the back, z to the head, in metres.
pub(super) const PATIENT_FRAME: &str = "patient_lps";

/// A type of message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct MessageType {
    pub(super) package: &'static str,
    pub(super) name: &'static str,
    /// SHA-256 of the type's description.
    pub(super) hash: &'static str,
}

pub(super) const POSE_STAMPED: MessageType = MessageType {
    package: "geometry_msgs",
    name: "PoseStamped",
    hash: "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
};

pub(super) const TWIST_STAMPED: MessageType = MessageType {
    package: "geometry_msgs",
    name: "TwistStamped",
    hash: "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
};

pub(super) const WRENCH_STAMPED: MessageType = MessageType {
    package: "geometry_msgs",
    name: "WrenchStamped",
    hash: "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77",
};

pub(super) const JOINT_STATE: MessageType = MessageType {
    package: "sensor_msgs",
    name: "JointState",
    hash: "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
};

pub(super) const POINT_CLOUD2: MessageType = MessageType {
    package: "sensor_msgs",
    name: "PointCloud2",
    hash: "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
};

pub(super) const OPERATING_STATE: MessageType = MessageType {
    package: "crtk_msgs",
    name: "OperatingState",
    hash: "RIHS01_5cc57eea589b217fe5194bf2735b91d4a7f2dd5ac1245ae657f7ea7590c2c80e",
};

pub(super) const STRING_STAMPED: MessageType = MessageType {
    package: "crtk_msgs",
    name: "StringStamped",
    hash: "RIHS01_83efb802e6596e03f69ac322e3231037329946f2bd13ed48874d97f5b8f5db1d",
};

/// When, and in which frame. CRTK marks what is not valid by the time 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stamp<'a> {
    pub(super) since_1970: Duration,
    pub(super) frame: &'a str,
}

impl<'a> Stamp<'a> {
    pub(super) fn at(time: SystemTime, frame: &'a str) -> Self {
        Self { since_1970: time.duration_since(UNIX_EPOCH).unwrap_or_default(), frame }
    }

    fn valid_if(self, is_valid: bool) -> Self {
        if is_valid { self } else { Self { since_1970: Duration::ZERO, ..self } }
    }

    /// std_msgs/Header. The seconds of a ROS time overflow in 2038, as theirs do.
    fn write(self, writer: &mut CdrWriter) {
        writer.i32(i32::try_from(self.since_1970.as_secs()).unwrap_or(i32::MAX));
        writer.u32(self.since_1970.subsec_nanos());
        writer.string(self.frame);
    }
}

/// geometry_msgs/PoseStamped: the tool's place and turn; the quaternion as x, y, z, w.
pub(super) fn pose_stamped(stamp: Stamp<'_>, position_m: DVec3, turn: DMat3) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(128);
    let quaternion = glam::DQuat::from_mat3(&turn);
    stamp.valid_if(position_m.is_finite() && quaternion.is_finite()).write(&mut writer);
    writer.f64s(&position_m.to_array());
    writer.f64s(&quaternion.to_array());
    writer.finish()
}

/// geometry_msgs/TwistStamped: the tip's velocity and the tool's turning, both in the stamp's frame; not valid for none.
pub(super) fn twist_stamped(stamp: Stamp<'_>, twist: Option<Twist>) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(128);
    let valid = twist.filter(|twist| twist.linear_m_per_s.is_finite() && twist.angular_rad_per_s.is_finite());
    stamp.valid_if(valid.is_some()).write(&mut writer);
    let Twist { linear_m_per_s, angular_rad_per_s } = valid.unwrap_or_default();
    writer.f64s(&linear_m_per_s.to_array());
    writer.f64s(&angular_rad_per_s.to_array());
    writer.finish()
}

/// How a tool moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Twist {
    pub(super) linear_m_per_s: DVec3,
    pub(super) angular_rad_per_s: DVec3,
}

/// crtk_msgs/OperatingState.
pub(super) fn operating_state(stamp: Stamp<'_>, state: &str, is_homed: bool, is_busy: bool) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(64);
    stamp.write(&mut writer);
    writer.string(state);
    writer.u8(u8::from(is_homed));
    writer.u8(u8::from(is_busy));
    writer.finish()
}

/// crtk_msgs/StringStamped: what clients send.
#[cfg(test)]
pub(super) fn string_stamped(stamp: Stamp<'_>, text: &str) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(64);
    stamp.write(&mut writer);
    writer.string(text);
    writer.finish()
}

/// geometry_msgs/WrenchStamped.
pub(super) fn wrench_stamped(stamp: Stamp<'_>, force_n: DVec3, torque_n_m: DVec3) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(128);
    stamp.valid_if(force_n.is_finite() && torque_n_m.is_finite()).write(&mut writer);
    writer.f64s(&force_n.to_array());
    writer.f64s(&torque_n_m.to_array());
    writer.finish()
}

/// sensor_msgs/JointState of one joint: its angle, neither speed nor effort.
pub(super) fn joint_state(stamp: Stamp<'_>, name: &str, position_rad: f64) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(128);
    stamp.valid_if(position_rad.is_finite()).write(&mut writer);
    writer.u32(1);
    writer.string(name);
    writer.f64_sequence(&[position_rad]);
    writer.f64_sequence(&[]);
    writer.f64_sequence(&[]);
    writer.finish()
}

/// `sensor_msgs/PointField`'s number for single precision.
const FLOAT32: u8 = 7;

/// sensor_msgs/PointCloud2 of x, y, z in single precision.
pub(super) fn point_cloud2(stamp: Stamp<'_>, points_m: &[DVec3]) -> Vec<u8> {
    let mut writer = CdrWriter::with_capacity(256 + 12 * points_m.len());
    let is_dense = points_m.iter().all(|point| point.is_finite());
    stamp.valid_if(is_dense).write(&mut writer);
    // One row.
    writer.u32(1);
    writer.u32(points_m.len() as u32);
    writer.u32(3);
    for (name, offset) in [("x", 0), ("y", 4), ("z", 8)] {
        writer.string(name);
        writer.u32(offset);
        writer.u8(FLOAT32);
        writer.u32(1);
    }
    // Little endian.
    writer.u8(0);
    writer.u32(12);
    writer.u32(12 * points_m.len() as u32);
    writer.byte_sequence(points_m.iter().map(|point| {
        let mut bytes = [0; 12];
        for (field, x) in bytes.chunks_exact_mut(4).zip(point.as_vec3().to_array()) {
            field.copy_from_slice(&x.to_le_bytes());
        }
        bytes
    }));
    writer.u8(u8::from(is_dense));
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use sha2::{Digest, Sha256};

    fn stamp(frame: &str) -> Stamp<'_> {
        Stamp { since_1970: Duration::new(0x0102_0304, 5), frame }
    }

    fn bytes_of(numbers: &[f64]) -> Vec<u8> {
        numbers.iter().flat_map(|x| x.to_le_bytes()).collect()
    }

    /// By hand, field by field, with the padding that CDR asks for.
    #[test]
    fn messages_have_the_bytes_that_one_writes_by_hand() {
        let header = [&[0, 1, 0, 0, 4, 3, 2, 1, 5, 0, 0, 0][..], &[4, 0, 0, 0], b"lps\0"].concat();
        // 16 bytes behind the encapsulation: doubles follow at once.
        let turn = DMat3::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let pose = pose_stamped(stamp("lps"), DVec3::new(1.0, 2.0, 3.0), turn);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert_eq!(pose[..40], [&header[..], &bytes_of(&[1.0, 2.0, 3.0])[..20]].concat());
        assert_eq!(pose.len(), 20 + 7 * 8);
        let last = |at: usize| f64::from_le_bytes(pose[at..at + 8].try_into().unwrap());
        assert!((last(pose.len() - 8) - half).abs() < 1e-15 && (last(pose.len() - 16) - half).abs() < 1e-15);

        let wrench = wrench_stamped(stamp("lps"), DVec3::X, DVec3::Z);
        assert_eq!(wrench, [&header[..], &bytes_of(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0])].concat());

        // A frame of two letters: 15 bytes, and one of padding before the next count.
        let joint = joint_state(stamp("ab"), "jaw", 0.5);
        let expected = [
            &[0, 1, 0, 0, 4, 3, 2, 1, 5, 0, 0, 0][..],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[1, 0, 0, 0, 4, 0, 0, 0, b'j', b'a', b'w', 0],
            // The count at 28; the number at 32 is aligned.
            &[1, 0, 0, 0],
            &bytes_of(&[0.5]),
            &[0; 8],
        ];
        assert_eq!(joint, expected.concat());

        let twist = Twist { linear_m_per_s: DVec3::X, angular_rad_per_s: DVec3::Z };
        assert_eq!(twist_stamped(stamp("lps"), Some(twist)), wrench);
        let state = operating_state(stamp("lps"), "ENABLED", true, false);
        assert_eq!(state, [&header[..], &[8, 0, 0, 0], b"ENABLED\0", &[1, 0]].concat());

        let cloud = point_cloud2(stamp("lps"), &[DVec3::new(1.0, 0.0, -2.0)]);
        let field = |name: u8, offset: u8| {
            [&[2, 0, 0, 0, name, 0, 0, 0][..], &[offset, 0, 0, 0], &[7, 0, 0, 0], &[1, 0, 0, 0]].concat()
        };
        let expected = [
            &header[..],
            &[1, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0],
            &field(b'x', 0),
            &field(b'y', 4),
            &field(b'z', 8),
            &[0, 0, 0, 0],
            &[12, 0, 0, 0, 12, 0, 0, 0, 12, 0, 0, 0],
            &[0, 0, 0x80, 0x3F, 0, 0, 0, 0, 0, 0, 0, 0xC0],
            &[1],
        ];
        assert_eq!(cloud, expected.concat());
    }

    #[test]
    fn what_is_not_finite_is_marked_not_valid_by_the_time_0() {
        let pose = pose_stamped(stamp("lps"), DVec3::new(f64::NAN, 0.0, 0.0), DMat3::IDENTITY);
        assert_eq!(pose[4..12], [0; 8]);
        let joint = joint_state(stamp("lps"), "jaw", f64::INFINITY);
        assert_eq!(joint[4..12], [0; 8]);
        assert_eq!(twist_stamped(stamp("lps"), None)[4..12], [0; 8]);
    }

    // Numbers of REP 2016's field types.
    const NESTED: u8 = 1;
    const UINT8: u8 = 3;
    const INT32: u8 = 6;
    const UINT32: u8 = 7;
    const FLOAT64: u8 = 11;
    const BOOLEAN: u8 = 15;
    const STRING: u8 = 17;
    /// Added to the type of the elements.
    const SEQUENCE: u8 = 144;

    const TIME: &str = "builtin_interfaces/msg/Time";
    const HEADER: &str = "std_msgs/msg/Header";
    const POINT: &str = "geometry_msgs/msg/Point";
    const VECTOR: &str = "geometry_msgs/msg/Vector3";
    const QUATERNION: &str = "geometry_msgs/msg/Quaternion";
    const POSE: &str = "geometry_msgs/msg/Pose";
    const WRENCH: &str = "geometry_msgs/msg/Wrench";
    const TWIST: &str = "geometry_msgs/msg/Twist";
    const POINT_FIELD: &str = "sensor_msgs/msg/PointField";

    /// A field's description.
    fn field(name: &str, type_id: u8, nested: &str) -> String {
        format!(
            "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {type_id}, \"capacity\": 0, \
             \"string_capacity\": 0, \"nested_type_name\": \"{nested}\"}}}}"
        )
    }

    fn described(name: &str, fields: &[String]) -> String {
        format!("{{\"type_name\": \"{name}\", \"fields\": [{}]}}", fields.join(", "))
    }

    fn rihs01(description: &str, referenced: &[String]) -> String {
        let text = format!(
            "{{\"type_description\": {description}, \"referenced_type_descriptions\": [{}]}}",
            referenced.join(", ")
        );
        let hash: String = Sha256::digest(text.as_bytes()).iter().map(|byte| format!("{byte:02x}")).collect();
        format!("RIHS01_{hash}")
    }

    /// The description of a type that messages refer to.
    fn described_part(name: &str) -> String {
        let numbers = |names: &[&str]| names.iter().map(|name| field(name, FLOAT64, "")).collect::<Vec<_>>();
        let fields = match name {
            TIME => vec![field("sec", INT32, ""), field("nanosec", UINT32, "")],
            HEADER => vec![field("stamp", NESTED, TIME), field("frame_id", STRING, "")],
            POINT | VECTOR => numbers(&["x", "y", "z"]),
            // The quaternion's fields have default values, which do not count.
            QUATERNION => numbers(&["x", "y", "z", "w"]),
            POSE => vec![field("position", NESTED, POINT), field("orientation", NESTED, QUATERNION)],
            WRENCH => vec![field("force", NESTED, VECTOR), field("torque", NESTED, VECTOR)],
            TWIST => vec![field("linear", NESTED, VECTOR), field("angular", NESTED, VECTOR)],
            POINT_FIELD => vec![
                field("name", STRING, ""),
                field("offset", UINT32, ""),
                field("datatype", UINT8, ""),
                field("count", UINT32, ""),
            ],
            _ => panic!("{name} is not described"),
        };
        described(name, &fields)
    }

    /// Checks a message's hash against its fields after the header and the types that it refers to.
    fn assert_hash(message: MessageType, fields: &[String], referenced: &[&str]) {
        let name = format!("{}/msg/{}", message.package, message.name);
        let fields = [&[field("header", NESTED, HEADER)], fields].concat();
        let referenced: Vec<String> = referenced.iter().map(|name| described_part(name)).collect();
        assert_eq!(rihs01(&described(&name, &fields), &referenced), message.hash, "{name}");
    }

    /// The hashes of the types again from their descriptions, by the rule of REP 2016.
    #[test]
    fn the_hashes_are_those_of_the_types_as_written_here() {
        assert_hash(POSE_STAMPED, &[field("pose", NESTED, POSE)], &[TIME, POINT, POSE, QUATERNION, HEADER]);
        assert_hash(TWIST_STAMPED, &[field("twist", NESTED, TWIST)], &[TIME, TWIST, VECTOR, HEADER]);
        assert_hash(
            OPERATING_STATE,
            &[field("state", STRING, ""), field("is_homed", BOOLEAN, ""), field("is_busy", BOOLEAN, "")],
            &[TIME, HEADER],
        );
        assert_hash(STRING_STAMPED, &[field("string", STRING, "")], &[TIME, HEADER]);
        assert_hash(WRENCH_STAMPED, &[field("wrench", NESTED, WRENCH)], &[TIME, VECTOR, WRENCH, HEADER]);
        assert_hash(
            JOINT_STATE,
            &[
                field("name", STRING + SEQUENCE, ""),
                field("position", FLOAT64 + SEQUENCE, ""),
                field("velocity", FLOAT64 + SEQUENCE, ""),
                field("effort", FLOAT64 + SEQUENCE, ""),
            ],
            &[TIME, HEADER],
        );
        assert_hash(
            POINT_CLOUD2,
            &[
                field("height", UINT32, ""),
                field("width", UINT32, ""),
                field("fields", NESTED + SEQUENCE, POINT_FIELD),
                field("is_bigendian", BOOLEAN, ""),
                field("point_step", UINT32, ""),
                field("row_step", UINT32, ""),
                field("data", UINT8 + SEQUENCE, ""),
                field("is_dense", BOOLEAN, ""),
            ],
            &[TIME, POINT_FIELD, HEADER],
        );
    }
}
