//! All integration tests of the crate in one binary: it links once.

#[path = "../../../glisson-mesh/tests/all/sample_edits.rs"]
mod sample_edits;
mod effort;
mod explicit_kernel;
mod hybrid_condensed;
mod hybrid_exchange;
mod hybrid_nonlinear;
mod implicit;
mod implicit_loads;
mod implicit_patches;
mod implicit_slices;
mod implicit_threads;
mod implicit_two_grid;
mod integrators;
mod kernel;
mod kernel_laws;
mod laws;
mod loads;
mod loads_faults;
mod local_model;
mod mass_spring;
mod model_edits;
mod model_meshes;
mod model_table;
mod models_agree;
mod near_incompressible;
mod nonlinear_reference;
mod nonlinear_tensor_mass;
mod patch_test;
mod precomputed;
mod precomputed_response;
mod precomputed_weight;
mod reduced;
mod reference_cases;
mod smoothed;
mod team;
