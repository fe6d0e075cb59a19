//! The active trocar: a trocar whose motors make the instrument in it felt (Chendeb 2007, NNT 2007ENMP1614, seed `000`, ch. 5).
//!
//! A real instrument of 5 mm slides in it. Five motions are measured and driven: pitch (a slotted bail), roll (a ring),
//! insertion, self-rotation, and the jaws at the handle.
//!
//! Frame of the device: the origin is the centre O about which the instrument turns; e_Z points into the body along an
//! instrument at rest, e_X is the axis of the pitch bail, e_Y that of the roll ring. The instrument's direction e_r runs
//! from O to its tip, so that tip = r e_r with the insertion r. Forces are those on the instrument, SI throughout.
//!
//! What the seed does not give is a named choice in [`profiles`].

pub mod kinematics;
pub mod statics;
pub mod motors;
pub mod profiles;
pub mod encoders;
pub mod identification;
pub mod placement;
pub mod mechanism;
pub mod teleoperation;

pub use encoders::{EncoderSample, JointReader, NotHomed};
pub use identification::{InstrumentTag, InstrumentType};
pub use kinematics::{Axis, JointRates, N_AXES, TrocarJoints, TrocarPose};
pub use motors::{AxisLimits, MotorTorques, Saturation, Transmission};
pub use placement::{Arrangement, MOST_TROCARS, Placement};
pub use profiles::TrocarProfile;
pub use statics::{AxisEfforts, ContactForce, Mapping, Wrench};
