//! Surface files.
