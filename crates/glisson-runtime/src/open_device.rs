//! An open device, and how its motion becomes an instrument's: what the haptic loop knows of a device.

use crate::page_hand::PageHand;
use glam::DQuat;
use glisson::haptics::trocar::Placement;
use glisson::haptics::{DeviceMapping, HapticDevice};
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson::tool::pose::ToolFrame;

/// An open device, and how its motion becomes an instrument's.
pub struct OpenDevice {
    /// The driver.
    pub device: Box<dyn HapticDevice>,
    /// What the user calls it.
    pub name: String,
    /// From its axes to the patient's.
    pub(crate) world_from_device: DQuat,
    /// Whether it has a button to move the handle aside.
    pub(crate) has_clutch: bool,
    /// Where it stands in the world; none where its place at the start is to hold the instrument at its home.
    pub(crate) stands: Option<Placement>,
    /// The server's end of a device that a page is.
    pub page: Option<PageHand>,
}

impl OpenDevice {
    /// A device whose axes are the patient's and whose handle, where it is at the start, holds the instrument at its home.
    pub fn new(device: Box<dyn HapticDevice>, name: &str) -> Self {
        Self {
            device,
            name: name.to_owned(),
            world_from_device: DQuat::IDENTITY,
            has_clutch: false,
            stands: None,
            page: None,
        }
    }

    /// The mapping that has the handle where it is now, `start_m` in its own frame, hold the instrument at its home; of a
    /// device that stands somewhere the one that has its place there. A device that does not tell its orientation has the
    /// home's.
    pub(crate) fn mapping(&self, start_m: DVec3, home: &ToolInput) -> DeviceMapping {
        let (device_origin_m, world_origin_m) = self
            .stands
            .map_or((start_m, home.tip_in_world_m), |stands| (DVec3::ZERO, stands.pivot_in_world_m));
        DeviceMapping {
            world_from_device: self.world_from_device,
            device_origin_m,
            world_origin_m,
            world_from_handle: DQuat::from_mat3(&ToolFrame::of(home).world_from_tool),
            clutch_button: self.has_clutch.then_some(1),
            ..DeviceMapping::default()
        }
    }
}
