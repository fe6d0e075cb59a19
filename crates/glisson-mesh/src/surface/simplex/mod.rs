//! Simplex meshes: surfaces whose vertices all have three neighbours, fitted to organs.
//!
//! The dual of a triangulation: a vertex for each triangle, a cell (a closed contour of vertices) for each
//! vertex. With three neighbours a vertex, a surface's local shape is three numbers, two metric parameters and
//! the simplex angle, from which smoothing forces follow that neither shrink a sphere nor need a
//! parametrisation (H. Delingette, "General object reconstruction based on simplex meshes", 1999,
//! doi 10.1023/A:1008157432188).
//!
//! [`fit::fit_simplex`] takes a mask to a smooth surface with a sixth of the triangles of marching cubes.

pub mod error;
pub mod mesh;
pub mod geometry;
pub mod neighbourhood;
pub mod internal;
pub mod external;
pub mod evolve;
pub mod edit;
pub mod adapt;
pub mod dual;
pub mod untangle;
pub mod measure;
pub mod fit;
