//! Which topics there are, and what goes into each.

use super::keys::ros_name;
use super::messages::{
    JOINT_STATE, MessageType, POINT_CLOUD2, POSE_STAMPED, Stamp, WRENCH_STAMPED, joint_state, point_cloud2,
    pose_stamped, wrench_stamped,
};
use glisson::math::DVec3;
use glisson::record::snapshot::Snapshot;
use glisson::tool::Tool;
use glisson::tool::pose::ToolFrame;
use std::time::SystemTime;

/// The frame of poses and surface: the patient's, x to the left, y to the back, z to the head, in metres.
const PATIENT_FRAME: &str = "patient_lps";

/// What does not change while the simulation runs.
#[derive(Clone, Debug)]
pub(crate) struct Described {
    /// Names as ROS allows them, and how far the jaws open [rad], in the scene's order.
    tools: Vec<(String, Option<f64>)>,
}

impl Described {
    /// Of the scene's instruments.
    pub(crate) fn of(tools: &[Tool]) -> Self {
        let tool =
            |tool: &Tool| (ros_name(&tool.name), tool.kind.jaws().map(|jaws| jaws.greatest_opening_rad));
        Self { tools: tools.iter().map(tool).collect() }
    }

    /// Tools without jaws.
    #[cfg(all(test, feature = "net"))]
    pub(crate) fn named(names: &[&str]) -> Self {
        Self { tools: names.iter().map(|name| ((*name).to_owned(), None)).collect() }
    }
}

/// What a topic shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    Pose(usize),
    Force(usize),
    Jaw(usize),
    Surface,
}

/// One topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Topic {
    /// `/left/measured_cp`, ...
    pub(super) name: String,
    pub(super) message: MessageType,
    shown: Shown,
}

impl Topic {
    /// All of them: CRTK's names in a namespace for each tool, and the organ's surface.
    pub(super) fn all(described: &Described) -> Vec<Self> {
        let mut topics = Vec::new();
        for (number, (tool, jaws)) in described.tools.iter().enumerate() {
            let mut add = |name: &str, message, shown| {
                topics.push(Self { name: format!("/{tool}/{name}"), message, shown });
            };
            add("measured_cp", POSE_STAMPED, Shown::Pose(number));
            add("body/measured_cf", WRENCH_STAMPED, Shown::Force(number));
            // CRTK: what a device cannot do has no topic.
            if jaws.is_some() {
                add("jaw/measured_js", JOINT_STATE, Shown::Jaw(number));
            }
        }
        topics.push(Self { name: "/organ/surface".into(), message: POINT_CLOUD2, shown: Shown::Surface });
        topics
    }

    /// Whether it is large: shown less often.
    pub(super) fn is_large(&self) -> bool {
        self.shown == Shown::Surface
    }

    /// The message now; none when the tool is not in the snapshot.
    pub(super) fn message_of(
        &self,
        described: &Described,
        snapshot: &Snapshot,
        time: SystemTime,
    ) -> Option<Vec<u8>> {
        let stamp = |frame| Stamp::at(time, frame);
        match self.shown {
            Shown::Surface => Some(point_cloud2(stamp(PATIENT_FRAME), &snapshot.positions_m)),
            Shown::Pose(number) => {
                let pose = snapshot.tools.get(number)?.pose;
                let turn = ToolFrame::of(&pose).world_from_tool;
                Some(pose_stamped(stamp(PATIENT_FRAME), pose.tip_in_world_m, turn))
            }
            Shown::Force(number) => {
                let tool = snapshot.tools.get(number)?;
                let in_tool_n = ToolFrame::of(&tool.pose).world_from_tool.transpose() * tool.force_n;
                let (name, _) = described.tools.get(number)?;
                Some(wrench_stamped(stamp(name), in_tool_n, DVec3::ZERO))
            }
            Shown::Jaw(number) => {
                let (name, greatest_rad) = described.tools.get(number)?;
                let opening = snapshot.tools.get(number)?.pose.jaw_opening;
                Some(joint_state(stamp(name), "jaw", opening * (*greatest_rad)?))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::record::snapshot::ToolSnapshot;
    use glisson::tool::ToolInput;

    #[test]
    fn each_tool_has_its_topics_and_forces_are_in_its_own_axes() {
        let described = Described { tools: vec![("left".into(), Some(1.0)), ("hook".into(), None)] };
        let topics = Topic::all(&described);
        let names: Vec<&str> = topics.iter().map(|topic| topic.name.as_str()).collect();
        assert_eq!(
            names,
            [
                "/left/measured_cp",
                "/left/body/measured_cf",
                "/left/jaw/measured_js",
                "/hook/measured_cp",
                "/hook/body/measured_cf",
                "/organ/surface",
            ]
        );
        let shaft = DVec3::new(0.0, 0.6, 0.8);
        let tool = ToolSnapshot {
            pose: ToolInput { jaw_opening: 0.5, ..ToolInput::at(DVec3::X, shaft) },
            // Along the shaft: the tool's own z.
            force_n: shaft * 2.0,
            contacts: [None; 3],
            n_held_nodes: 0,
        };
        let snapshot = Snapshot {
            step: 1,
            time_s: 0.0,
            topology_version: 0,
            positions_m: vec![DVec3::ONE],
            bleeding: Default::default(),
            tools: vec![tool],
        };
        let message = |topic: &Topic| topic.message_of(&described, &snapshot, SystemTime::now());
        let wrench = message(&topics[1]).unwrap();
        // Encapsulation, stamp, "left" and its zero, padding to 8.
        let number = |at: usize| f64::from_le_bytes(wrench[at..at + 8].try_into().unwrap());
        assert!(number(28).abs() < 1e-15 && number(36).abs() < 1e-15 && (number(44) - 2.0).abs() < 1e-15);
        let jaw = message(&topics[2]).unwrap();
        assert!(jaw.windows(8).any(|bytes| bytes == 0.5_f64.to_le_bytes()));
        assert!(message(&topics[5]).is_some() && topics[5].is_large());
        // The snapshot has one tool only.
        assert!(message(&topics[3]).is_none());
    }
}
