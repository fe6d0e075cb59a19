//! Whether what a ball feels is the tissue's force and not the mesh's.
//!
//! ```text
//! reference (axisymmetric, any law) -> table of forces -+
//! press (a ball in a World with [hand]) -> blocks ------+-> judgement (groups of experiments)
//!                                       -> livers ------+
//! ```

mod reference;
mod skin;
mod press;
mod selection;
mod blocks;
pub(super) use blocks::{SIZE_M as BLOCK_SIZE_M, block};
mod livers;
mod sliding;
mod judgement;

pub(super) use judgement::{block_experiments, liver_experiments, reference_experiments};
pub use selection::Selection;
pub(super) use sliding::sliding_experiments;

/// Runs the block's cases and writes a line a case as soon as it is done.
///
/// # Errors
/// For an unknown model, a ball without reference, and what cannot be set up.
pub fn write_blocks(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    write(blocks::Case::HEAD);
    blocks::run(selection, &mut |case| write(&case.row()))?;
    Ok(())
}

/// The same for the livers' pushes.
///
/// # Errors
/// For an unknown model, and what cannot be set up.
pub fn write_livers(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    write(livers::Push::HEAD);
    livers::run(selection, &mut |push| write(&push.row()))?;
    Ok(())
}

/// The same for balls that slide.
///
/// # Errors
/// For an unknown model, and what cannot be set up.
pub fn write_slides(selection: &Selection, write: &mut dyn FnMut(&str)) -> anyhow::Result<()> {
    sliding::write(selection, write)
}
