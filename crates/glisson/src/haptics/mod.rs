//! The force law between a simulation that steps when it can and a hand that must feel it a thousand times a second.
//!
//! The simulation publishes a [`HapticModel`] of each instrument: what its force would be nearby, soon. The haptic loop
//! reads the device, evaluates the latest model and writes a [`ForceCommand`]; it never waits. All of it is pure: time
//! comes in as the period of a tick and the age of the model.

pub mod device;
pub mod axes;
pub mod tissue;
pub mod extrapolation;
pub mod slide;
pub mod spread;
pub mod handover;
pub mod patch;
pub mod coupling;
pub mod limits;
pub mod passivity;
pub mod mapping;
pub mod law;
pub mod simulated;
pub mod trocar;

pub use axes::{AxesHandover, AxesModel, AxesPlace};
pub use coupling::{CouplingGains, GainShares};
pub use device::{DeviceFault, DeviceLimits, DeviceState, ForceCommand, HapticDevice, InsertedInstrument};
pub use extrapolation::ForceEstimate;
pub use handover::Handover;
pub use law::{HapticLaw, LawSettings, LawTick, TickReport};
pub use mapping::DeviceMapping;
pub use passivity::{EnergyControl, TankSettings};
pub use patch::PatchStiffness;
pub use simulated::{HandPath, HandSettings, SimulatedDevice, SimulatedDeviceSettings};
pub use slide::Slide;
pub use tissue::{HapticModel, Touch, TouchedPart};
