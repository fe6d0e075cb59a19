//! All integration tests in one binary: it links once.

mod layering;
mod mesh_edits;
mod mesh_files;
