//! Which topics there are, and what goes into each.

use super::device::Device;
use super::keys::ros_name;
use super::messages::{
    JOINT_STATE, MessageType, OPERATING_STATE, PATIENT_FRAME, POINT_CLOUD2, POSE_STAMPED, Stamp,
    TWIST_STAMPED, Twist, WRENCH_STAMPED, joint_state, operating_state, point_cloud2, pose_stamped,
    twist_stamped, wrench_stamped,
};
use super::orders::OrderKind;
use glam::DQuat;
use glisson::math::DVec3;
use glisson::record::snapshot::Snapshot;
use glisson::tool::pose::ToolFrame;
use glisson::tool::{Tool, ToolInput};
use std::time::SystemTime;

/// Two displayed states further apart than this tell nothing about a velocity [s].
const LONGEST_INTERVAL_S: f64 = 0.25;

/// What does not change of an instrument while the simulation runs.
#[derive(Clone, Debug)]
pub(super) struct DescribedTool {
    /// As ROS allows it.
    name: String,
    /// How far the jaws open.
    greatest_opening_rad: Option<f64>,
    home: ToolInput,
    /// Whether CRTK's clients may move it.
    is_ordered: bool,
}

/// What does not change while the simulation runs.
#[derive(Clone, Debug)]
pub(crate) struct Described {
    /// In the scene's order.
    tools: Vec<DescribedTool>,
}

impl Described {
    /// Of the scene's instruments; `is_ordered` tells of each by its number whether CRTK's clients may move it.
    pub(crate) fn of(tools: &[Tool], is_ordered: impl Fn(usize) -> bool) -> Self {
        let tool = |(number, tool): (usize, &Tool)| DescribedTool {
            name: ros_name(&tool.name),
            greatest_opening_rad: tool.kind.jaws().map(|jaws| jaws.greatest_opening_rad),
            home: tool.home,
            is_ordered: is_ordered(number),
        };
        Self { tools: tools.iter().enumerate().map(tool).collect() }
    }

    /// Whether CRTK's clients may move anything.
    pub(crate) fn takes_orders(&self) -> bool {
        self.tools.iter().any(|tool| tool.is_ordered)
    }

    /// One tool whose jaws open by 1 rad.
    #[cfg(test)]
    pub(crate) fn named(name: &str, home: ToolInput, is_ordered: bool) -> Self {
        let (name, greatest_opening_rad) = (name.to_owned(), Some(1.0));
        Self { tools: vec![DescribedTool { name, greatest_opening_rad, home, is_ordered }] }
    }

    /// The instruments as CRTK's devices.
    pub(super) fn devices(&self) -> Vec<Device> {
        let device = |tool: &DescribedTool| {
            let device = Device::new(tool.home, tool.greatest_opening_rad.unwrap_or(0.0));
            if tool.is_ordered { device } else { device.held_elsewhere() }
        };
        self.tools.iter().map(device).collect()
    }

    /// Topics on which orders come: their names, of which instrument and kind.
    pub(super) fn orders(&self) -> Vec<(String, usize, OrderKind)> {
        let mut orders = Vec::new();
        for (number, tool) in self.tools.iter().enumerate().filter(|(_, tool)| tool.is_ordered) {
            for &kind in OrderKind::all(tool.greatest_opening_rad.is_some()) {
                orders.push((format!("/{}/{}", tool.name, kind.topic().0), number, kind));
            }
        }
        orders
    }
}

/// What a topic shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    Pose(usize),
    Setpoint(usize),
    Velocity(usize),
    Force(usize),
    Jaw(usize),
    State(usize),
    Surface,
}

/// How often a topic is published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pace {
    /// With each state that is displayed.
    EveryFrame,
    /// The same, but at most ten times a second: it is large.
    SomeFrames,
    /// When it changes, and ten times a second: who comes later must hear it too.
    Steady,
}

/// One topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Topic {
    /// `/left/measured_cp`, ...
    pub(super) name: String,
    pub(super) message: MessageType,
    shown: Shown,
}

/// What there is to show.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub(super) snapshot: &'a Snapshot,
    /// The state that was displayed before.
    pub(super) before: Option<&'a Snapshot>,
    pub(super) devices: &'a [Device],
    pub(super) time: SystemTime,
}

impl Topic {
    /// All of them: CRTK's names in a namespace for each tool, and the organ's surface.
    pub(super) fn all(described: &Described) -> Vec<Self> {
        let mut topics = Vec::new();
        for (number, tool) in described.tools.iter().enumerate() {
            let mut add = |name: &str, message, shown| {
                topics.push(Self { name: format!("/{}/{name}", tool.name), message, shown });
            };
            add("operating_state", OPERATING_STATE, Shown::State(number));
            add("measured_cp", POSE_STAMPED, Shown::Pose(number));
            add("measured_cv", TWIST_STAMPED, Shown::Velocity(number));
            add("body/measured_cf", WRENCH_STAMPED, Shown::Force(number));
            // CRTK: what a device cannot do has no topic.
            if tool.greatest_opening_rad.is_some() {
                add("jaw/measured_js", JOINT_STATE, Shown::Jaw(number));
            }
            if tool.is_ordered {
                add("setpoint_cp", POSE_STAMPED, Shown::Setpoint(number));
            }
        }
        topics.push(Self { name: "/organ/surface".into(), message: POINT_CLOUD2, shown: Shown::Surface });
        topics
    }

    pub(super) fn pace(&self) -> Pace {
        match self.shown {
            Shown::Surface => Pace::SomeFrames,
            Shown::State(_) => Pace::Steady,
            _ => Pace::EveryFrame,
        }
    }

    /// The instrument whose state it tells.
    pub(super) fn tells_state_of(&self) -> Option<usize> {
        if let Shown::State(number) = self.shown { Some(number) } else { None }
    }

    /// The message now; none when the tool is not in the snapshot.
    pub(super) fn message_of(&self, described: &Described, scene: Scene<'_>) -> Option<Vec<u8>> {
        let stamp = |frame| Stamp::at(scene.time, frame);
        let tools = &scene.snapshot.tools;
        let pose_message = |pose: ToolInput| {
            let turn = ToolFrame::of(&pose).world_from_tool;
            pose_stamped(stamp(PATIENT_FRAME), pose.tip_in_world_m, turn)
        };
        match self.shown {
            Shown::Surface => Some(point_cloud2(stamp(PATIENT_FRAME), &scene.snapshot.positions_m)),
            Shown::Pose(number) => Some(pose_message(tools.get(number)?.pose)),
            Shown::Setpoint(number) => {
                Some(pose_message(scene.devices.get(number)?.setpoint(tools.get(number)?.pose)))
            }
            Shown::Velocity(number) => {
                tools.get(number)?;
                let twist = scene.before.and_then(|before| twist_between(before, scene.snapshot, number));
                Some(twist_stamped(stamp(PATIENT_FRAME), twist))
            }
            Shown::Force(number) => {
                let tool = tools.get(number)?;
                let in_tool_n = ToolFrame::of(&tool.pose).world_from_tool.transpose() * tool.force_n;
                let DescribedTool { name, .. } = described.tools.get(number)?;
                Some(wrench_stamped(stamp(name), in_tool_n, DVec3::ZERO))
            }
            Shown::Jaw(number) => {
                let DescribedTool { name, greatest_opening_rad, .. } = described.tools.get(number)?;
                let opening = tools.get(number)?.pose.jaw_opening;
                Some(joint_state(stamp(name), "jaw", opening * (*greatest_opening_rad)?))
            }
            Shown::State(number) => {
                let device = scene.devices.get(number)?;
                let state = device.state().name();
                Some(operating_state(stamp(PATIENT_FRAME), state, device.is_homed(), device.is_busy()))
            }
        }
    }
}

/// The mean velocity of a tool between two displayed states, in simulated time.
fn twist_between(before: &Snapshot, now: &Snapshot, tool: usize) -> Option<Twist> {
    let (from, to) = (before.tools.get(tool)?.pose, now.tools.get(tool)?.pose);
    let passed_s = now.time_s - before.time_s;
    if !(passed_s > 0.0 && passed_s <= LONGEST_INTERVAL_S) {
        return None;
    }
    let turn = ToolFrame::of(&to).world_from_tool * ToolFrame::of(&from).world_from_tool.transpose();
    Some(Twist {
        linear_m_per_s: (to.tip_in_world_m - from.tip_in_world_m) / passed_s,
        angular_rad_per_s: DQuat::from_mat3(&turn).to_scaled_axis() / passed_s,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::record::snapshot::ToolSnapshot;

    fn tool(pose: ToolInput, force_n: DVec3) -> ToolSnapshot {
        ToolSnapshot { pose, shown_further_out_m: DVec3::ZERO, force_n, contacts: [None; 3], n_held_nodes: 0 }
    }

    fn snapshot(time_s: f64, tools: Vec<ToolSnapshot>) -> Snapshot {
        Snapshot {
            step: 1,
            time_s,
            topology_version: 0,
            positions_m: vec![DVec3::ONE],
            bleeding: Default::default(),
            threads: Vec::new(),
            strands_m: Vec::new(),
            n_resets: 0,
            tools,
        }
    }

    #[test]
    fn each_tool_has_its_topics_and_forces_are_in_its_own_axes() {
        let home = ToolInput::at(DVec3::ZERO, DVec3::Z);
        let mut described = Described::named("left", home, true);
        let name = "hook".to_owned();
        described.tools.push(DescribedTool { name, greatest_opening_rad: None, home, is_ordered: false });
        let topics = Topic::all(&described);
        let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "/left/operating_state",
                "/left/measured_cp",
                "/left/measured_cv",
                "/left/body/measured_cf",
                "/left/jaw/measured_js",
                "/left/setpoint_cp",
                "/hook/operating_state",
                "/hook/measured_cp",
                "/hook/measured_cv",
                "/hook/body/measured_cf",
                "/organ/surface",
            ]
        );
        let orders: Vec<String> = described.orders().into_iter().map(|(name, ..)| name).collect();
        assert_eq!(orders, ["/left/state_command", "/left/servo_cp", "/left/move_cp", "/left/jaw/servo_jp"]);
        let shaft = DVec3::new(0.0, 0.6, 0.8);
        let pose = ToolInput { jaw_opening: 0.5, ..ToolInput::at(DVec3::X, shaft) };
        // Along the shaft: the tool's own z.
        let snapshot = snapshot(0.0, vec![tool(pose, shaft * 2.0)]);
        let devices = described.devices();
        let message = |topic: &Topic| {
            let time = SystemTime::now();
            topic.message_of(&described, Scene { snapshot: &snapshot, before: None, devices: &devices, time })
        };
        let wrench = message(&topics[3]).unwrap();
        // Encapsulation, stamp, "left" and its zero, padding to 8.
        let number = |at: usize| f64::from_le_bytes(wrench[at..at + 8].try_into().unwrap());
        assert!(number(28).abs() < 1e-15 && number(36).abs() < 1e-15 && (number(44) - 2.0).abs() < 1e-15);
        let jaw = message(&topics[4]).unwrap();
        assert!(jaw.windows(8).any(|bytes| bytes == 0.5_f64.to_le_bytes()));
        // Nobody ordered anything: it is to be where it is.
        let (measured, setpoint) = (message(&topics[1]).unwrap(), message(&topics[5]).unwrap());
        assert_eq!(measured[12..], setpoint[12..]);
        let says =
            |topic: &Topic, text: &[u8]| message(topic).unwrap().windows(text.len()).any(|b| b == text);
        assert!(says(&topics[0], b"DISABLED") && says(&topics[6], b"PAUSED"));
        assert!(message(&topics[10]).is_some() && topics[10].pace() == Pace::SomeFrames);
        // The snapshot has one tool only.
        assert!(message(&topics[7]).is_none());
    }

    #[test]
    fn velocities_are_those_between_two_displayed_states() {
        let pose = |roll_rad, z_m| ToolInput { roll_rad, ..ToolInput::at(DVec3::Z * z_m, DVec3::Z) };
        let at = |time_s, pose| snapshot(time_s, vec![tool(pose, DVec3::ZERO)]);
        let (before, now) = (at(1.0, pose(0.1, 0.2)), at(1.02, pose(0.2, 0.201)));
        let twist = twist_between(&before, &now, 0).unwrap();
        assert!(twist.linear_m_per_s.distance(DVec3::Z * 0.05) < 1e-12, "{twist:?}");
        // About its shaft.
        assert!(twist.angular_rad_per_s.distance(DVec3::Z * 5.0) < 1e-9, "{twist:?}");
        // Started anew, the same state again, or another one much later.
        assert_eq!(twist_between(&now, &before, 0), None);
        assert_eq!(twist_between(&now, &now, 0), None);
        assert_eq!(twist_between(&before, &at(3.0, pose(0.0, 0.0)), 0), None);
        assert_eq!(twist_between(&before, &now, 1), None);
    }
}
