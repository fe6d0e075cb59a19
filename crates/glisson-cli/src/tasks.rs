//! The tasks that come with the program: one line each, and a file in `tasks/`.

/// Name and scene of each, in the order in which one learns.
pub(crate) const TASKS: &[(&str, &str)] = &[
    ("palpation", include_str!("../../../tasks/palpation.toml")),
    ("grasp_and_lift", include_str!("../../../tasks/grasp_and_lift.toml")),
    ("line_cut", include_str!("../../../tasks/line_cut.toml")),
];

/// The scene of a task, by its name.
pub(crate) fn task_named(name: &str) -> Option<&'static str> {
    TASKS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}
