//! All integration tests in one binary: it links once.

mod layering;
mod surfaces;
mod surface_files;
