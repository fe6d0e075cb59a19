//! All integration tests of the crate in one binary: it links once.

#[path = "../../../glisson-tissue/tests/all/model_meshes.rs"]
#[allow(dead_code, reason = "the tests of models use more of it")]
mod model_meshes;
mod active_trocar;
mod attachments;
mod bodies;
mod capsule;
mod carving;
mod contact_constraint;
mod contact_points;
mod contact_response;
mod cut_crossing;
mod cut_curved;
mod cut_scalpel;
mod cut_subdivision;
mod detection;
mod edit_faults;
mod embedding;
mod hand_torque;
mod haptic_energy;
mod haptic_law;
mod haptic_models;
mod hybrid_scene;
mod precomputed_cutting;
mod proxy;
mod quasi_nonlinear;
mod rough_hands;
mod surface_copy;
mod ligatures;
mod sutures;
mod task_runs;
mod tissue_parts;
mod tool_contacts;
mod tools_touch;
mod training;
mod touch;
mod world_bodies;
mod world_self_contact;
mod world_slide;
mod world_steps;
mod world_stroke_end;
mod world_tear;
mod world_tools;
