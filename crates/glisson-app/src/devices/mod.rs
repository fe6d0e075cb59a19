//! Force-feedback devices: drivers behind [`glisson::haptics::HapticDevice`].

pub(crate) mod trocar_board;
