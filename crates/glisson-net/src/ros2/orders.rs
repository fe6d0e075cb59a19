//! What CRTK's clients ask of an instrument, read from their messages.

use super::cdr::{CdrError, CdrReader};
use super::messages::{JOINT_STATE, MessageType, PATIENT_FRAME, POSE_STAMPED, STRING_STAMPED};
use glam::DQuat;
use glisson::math::{DMat3, DVec3};

/// Names in a JointState that are read over before its position.
const MOST_JOINTS: u32 = 64;
/// How far a quaternion's length may be from 1 and count as one that was rounded.
const QUATERNION_ROUNDING: f64 = 1e-3;

/// Why a message is no order.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum OrderError {
    #[error("the message cannot be read: {0}")]
    Cdr(#[from] CdrError),
    #[error("the frame {0:?} is not known; poses are in {PATIENT_FRAME} (or without a name)")]
    Frame(String),
    #[error("{0} is not finite")]
    NotFinite(&'static str),
    #[error("the quaternion's length is {0}, which should be 1")]
    Quaternion(f64),
    #[error("{0} joints; the jaw is one")]
    Joints(u32),
    #[error("the state command {0:?} is not known; there are: enable, disable, pause, resume, home, unhome")]
    State(String),
}

/// CRTK's commands of an instrument's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StateCommand {
    Enable,
    Disable,
    Pause,
    Resume,
    Home,
    Unhome,
}

/// One order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Order {
    State(StateCommand),
    /// The tip should be there now: `servo_cp`.
    Servo {
        tip_in_world_m: DVec3,
        world_from_tool: DMat3,
    },
    /// It should go there at its own pace: `move_cp`.
    Move {
        tip_in_world_m: DVec3,
        world_from_tool: DMat3,
    },
    /// Angle between the jaws: `jaw/servo_jp`.
    ServoJaw {
        opening_rad: f64,
    },
}

/// Kinds of orders, each with its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OrderKind {
    State,
    Servo,
    Move,
    ServoJaw,
}

impl OrderKind {
    /// Those of an instrument.
    pub(super) fn all(has_jaws: bool) -> &'static [Self] {
        const ALL: [OrderKind; 4] =
            [OrderKind::State, OrderKind::Servo, OrderKind::Move, OrderKind::ServoJaw];
        if has_jaws { &ALL } else { &ALL[..3] }
    }

    /// The topic's name in the instrument's namespace, and its type.
    pub(super) fn topic(self) -> (&'static str, MessageType) {
        match self {
            Self::State => ("state_command", STRING_STAMPED),
            Self::Servo => ("servo_cp", POSE_STAMPED),
            Self::Move => ("move_cp", POSE_STAMPED),
            Self::ServoJaw => ("jaw/servo_jp", JOINT_STATE),
        }
    }

    /// Reads a message of this kind. CRTK's clients leave the time 0 and the frame empty in what they send.
    pub(super) fn read(self, message: &[u8]) -> Result<Order, OrderError> {
        let mut reader = CdrReader::new(message)?;
        let (_seconds, _nanoseconds) = (reader.u32()?, reader.u32()?);
        let frame = reader.string()?;
        match self {
            Self::State => read_state(reader.string()?).map(Order::State),
            Self::Servo | Self::Move => {
                if !frame.is_empty() && frame != PATIENT_FRAME {
                    return Err(OrderError::Frame(frame.to_owned()));
                }
                let (tip_in_world_m, world_from_tool) = read_pose(&mut reader)?;
                Ok(if self == Self::Servo {
                    Order::Servo { tip_in_world_m, world_from_tool }
                } else {
                    Order::Move { tip_in_world_m, world_from_tool }
                })
            }
            Self::ServoJaw => read_joint(&mut reader),
        }
    }
}

fn read_state(text: &str) -> Result<StateCommand, OrderError> {
    Ok(match text {
        "enable" => StateCommand::Enable,
        "disable" => StateCommand::Disable,
        "pause" => StateCommand::Pause,
        // The older name is `unpause`.
        "resume" | "unpause" => StateCommand::Resume,
        "home" => StateCommand::Home,
        "unhome" => StateCommand::Unhome,
        other => return Err(OrderError::State(other.chars().take(40).collect())),
    })
}

fn read_pose(reader: &mut CdrReader<'_>) -> Result<(DVec3, DMat3), OrderError> {
    let position_m = DVec3::from_array(reader.f64s()?);
    let quaternion = DQuat::from_array(reader.f64s()?);
    if !position_m.is_finite() {
        return Err(OrderError::NotFinite("the position"));
    }
    let length = quaternion.length();
    // Not a number is not near 1 either.
    if (length - 1.0).abs() <= QUATERNION_ROUNDING {
        Ok((position_m, DMat3::from_quat(quaternion.normalize())))
    } else {
        Err(OrderError::Quaternion(length))
    }
}

fn read_joint(reader: &mut CdrReader<'_>) -> Result<Order, OrderError> {
    let n_names = reader.u32()?;
    if n_names > MOST_JOINTS {
        return Err(OrderError::Joints(n_names));
    }
    for _ in 0..n_names {
        reader.string()?;
    }
    let n_positions = reader.u32()?;
    if n_positions != 1 {
        return Err(OrderError::Joints(n_positions));
    }
    let opening_rad = reader.f64()?;
    if !opening_rad.is_finite() {
        return Err(OrderError::NotFinite("the jaw's angle"));
    }
    Ok(Order::ServoJaw { opening_rad })
}

#[cfg(test)]
mod tests {
    use super::super::messages::{Stamp, joint_state, pose_stamped, string_stamped};
    use super::*;
    use std::time::Duration;

    fn stamp(frame: &str) -> Stamp<'_> {
        Stamp { since_1970: Duration::ZERO, frame }
    }

    #[test]
    fn what_is_published_is_read_again() {
        let turn = DMat3::from_rotation_x(0.3) * DMat3::from_rotation_z(-2.0);
        let tip_m = DVec3::new(0.01, -0.02, 0.03);
        for frame in ["", PATIENT_FRAME] {
            let read = OrderKind::Servo.read(&pose_stamped(stamp(frame), tip_m, turn)).unwrap();
            let Order::Servo { tip_in_world_m, world_from_tool } = read else { panic!("{read:?}") };
            assert_eq!(tip_in_world_m, tip_m);
            assert!(world_from_tool.abs_diff_eq(turn, 1e-14));
        }
        let jaw = OrderKind::ServoJaw.read(&joint_state(stamp("left"), "jaw", 0.4));
        assert_eq!(jaw, Ok(Order::ServoJaw { opening_rad: 0.4 }));
        for (text, command) in [
            ("enable", StateCommand::Enable),
            ("disable", StateCommand::Disable),
            ("pause", StateCommand::Pause),
            ("resume", StateCommand::Resume),
            ("unpause", StateCommand::Resume),
            ("home", StateCommand::Home),
            ("unhome", StateCommand::Unhome),
        ] {
            assert_eq!(OrderKind::State.read(&string_stamped(stamp(""), text)), Ok(Order::State(command)));
        }
    }

    #[test]
    fn what_cannot_be_meant_is_refused_with_a_reason() {
        let servo = |frame, at: DVec3, turn| {
            OrderKind::Servo.read(&pose_stamped(stamp(frame), at, turn)).unwrap_err().to_string()
        };
        assert!(servo("camera", DVec3::ZERO, DMat3::IDENTITY).contains("patient_lps"));
        assert!(servo("", DVec3::NAN, DMat3::IDENTITY).contains("position is not finite"));
        // A quaternion that nobody filled in.
        let mut empty = pose_stamped(stamp(""), DVec3::ZERO, DMat3::IDENTITY);
        let n = empty.len();
        empty[n - 32..].fill(0);
        assert_eq!(OrderKind::Move.read(&empty), Err(OrderError::Quaternion(0.0)));
        let unknown = OrderKind::State.read(&string_stamped(stamp(""), "ENABLE")).unwrap_err();
        assert!(unknown.to_string().contains("enable, disable, pause, resume"), "{unknown}");
        let infinite = OrderKind::ServoJaw.read(&joint_state(stamp(""), "jaw", f64::INFINITY));
        assert_eq!(infinite, Err(OrderError::NotFinite("the jaw's angle")));
    }

    #[test]
    fn any_bytes_are_an_order_or_an_error_and_never_a_panic() {
        let good = [
            pose_stamped(stamp(""), DVec3::X, DMat3::IDENTITY),
            joint_state(stamp("frame"), "jaw", 0.1),
            string_stamped(stamp(""), "enable"),
        ];
        let mut random = 1234_u64;
        let mut next = || {
            random ^= random << 13;
            random ^= random >> 7;
            random ^= random << 17;
            random
        };
        let (mut n_read, mut n_refused) = (0, 0);
        for _ in 0..20_000 {
            let mut bytes = good[next() as usize % good.len()].clone();
            for _ in 0..next() % 4 {
                let at = next() as usize % bytes.len();
                bytes[at] = next() as u8;
            }
            bytes.truncate(bytes.len() - next() as usize % 3 * (next() as usize % bytes.len()) / 2);
            for kind in OrderKind::all(true) {
                match kind.read(&bytes) {
                    Ok(_) => n_read += 1,
                    Err(error) => {
                        n_refused += 1;
                        assert!(!error.to_string().is_empty());
                    }
                }
            }
        }
        assert!(n_read > 5_000 && n_refused > 5_000, "{n_read} read, {n_refused} refused");
    }
}
