//! All integration tests in one binary: it links once.

mod images;
mod layering;
mod surfaces;
