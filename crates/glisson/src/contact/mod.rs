//! Contact between tools and organs.

pub mod buckets;
pub mod spread;
pub mod sphere;
pub mod boxes;
pub mod shapes;
pub mod box_grid;
pub mod sweep_and_prune;
mod four_boxes;
pub mod hierarchy;
pub mod broad_phase;
pub mod triangles;
mod lanes;
mod triangle_lanes;
mod vertex_lanes;
pub mod continuous;
pub mod tool_contact;
pub mod self_collision;
mod vertex_search;
pub mod crossing;
pub mod proxy_surface;
pub mod proxy;
pub mod response;
pub mod constraint;
pub mod delassus;
pub mod bodies;
