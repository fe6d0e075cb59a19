//! All integration tests in one binary: it links once.

mod images;
mod laws;
mod kernel;
mod integrators;
mod implicit;
mod implicit_loads;
mod layering;
mod loads;
mod loads_faults;
mod mass_spring;
mod meshing;
mod model_meshes;
mod models_agree;
mod nonlinear_reference;
mod nonlinear_tensor_mass;
mod near_incompressible;
mod smoothed;
mod patch_test;
mod precomputed_weight;
mod reference_cases;
mod surfaces;
mod world_steps;
mod mesh_edits;
mod surface_files;
mod mesh_files;
