//! All integration tests in one binary: it links once.

mod images;
mod implicit;
mod layering;
mod meshing;
mod model_meshes;
mod models_agree;
mod near_incompressible;
mod patch_test;
mod reference_cases;
mod surfaces;
mod mesh_edits;
mod surface_files;
mod mesh_files;
