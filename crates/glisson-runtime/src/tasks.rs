//! The tasks that come with the program: one line each, and a file in `tasks/` (docs/tasks.md).

/// Name and scene of each, in the order in which one learns.
pub const TASKS: &[(&str, &str)] = &[
    ("camera_navigation", include_str!("../tasks/camera_navigation.toml")),
    ("palpation", include_str!("../tasks/palpation.toml")),
    ("breathing_liver", include_str!("../tasks/breathing_liver.toml")),
    ("grasp_and_lift", include_str!("../tasks/grasp_and_lift.toml")),
    ("line_cut", include_str!("../tasks/line_cut.toml")),
    ("pattern_cut", include_str!("../tasks/pattern_cut.toml")),
    ("clip_and_cut", include_str!("../tasks/clip_and_cut.toml")),
    ("ligating_loop", include_str!("../tasks/ligating_loop.toml")),
    ("cut_off", include_str!("../tasks/cut_off.toml")),
    ("metastasectomy", include_str!("../tasks/metastasectomy.toml")),
    ("cholecystectomy", include_str!("../tasks/cholecystectomy.toml")),
];

/// The scene of a task, by its name.
pub fn task_named(name: &str) -> Option<&'static str> {
    TASKS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}
