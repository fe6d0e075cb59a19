//! Repair by collapse and by local remeshing, and local refinement.
