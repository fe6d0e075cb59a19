//! How a world of contact is made.

use super::near::{Near, Reach};
use super::obstacle::MovingObstacle;
use super::surfaces::Surfaces;
use super::{Body, CollidingBodies, ContactReport, Obstacle, ObstacleShape};
use crate::contact::constraint::Response;
use crate::math::DVec3;
use crate::mesh::NodeId;
use crate::model::{Constraints, DeformableModel, LocalModel, LocalWork, StepAnswer};
use crate::surface::TriMesh;

/// A body to put into the world.
pub struct BodyParams {
    /// Its mechanics.
    pub model: Box<dyn DeformableModel>,
    /// The triangles of its surface, outward.
    pub surface: TriMesh,
    /// The node of each vertex of the surface, ascending.
    pub nodes: Vec<NodeId>,
    /// Coefficient of friction of its surface.
    pub friction: f64,
}

/// Distances and effort.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactParams {
    /// Distance that surfaces keep [m].
    pub skin_m: f64,
    /// Gap up to which a contact is looked after [m]: at least what surfaces approach each other in a step.
    pub margin_m: f64,
    /// Way of a vertex for which one search for pairs serves, twice [m].
    pub slack_m: f64,
    /// Whether a body may touch itself.
    pub self_collision: bool,
    /// Room for contacts.
    pub room: usize,
    /// Vertices of one implicit or static body that may be pressed at a time.
    pub most_coupled: usize,
    /// Sweeps of the solver in a step at most.
    pub most_sweeps: u32,
    /// Change of a force in a sweep at which it ends, as a share of the largest force.
    pub tolerance: f64,
}

impl Default for ContactParams {
    /// Choices for organs of some centimetres and steps of a millisecond or less.
    fn default() -> Self {
        Self {
            skin_m: 1e-4,
            margin_m: 1e-3,
            slack_m: 2e-3,
            self_collision: false,
            room: 4096,
            most_coupled: 256,
            most_sweeps: 50,
            tolerance: 1e-5,
        }
    }
}

/// The coefficient for two surfaces: the geometric mean of theirs, a choice that leaves equal ones as they are and is
/// zero if one is.
pub fn pair_friction([one, other]: [f64; 2]) -> f64 {
    (one * other).sqrt()
}

/// Why there is no world of contact.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ContactSetUpError {
    /// A number that cannot be.
    #[error("{what} is {found}; allowed: {allowed}")]
    Parameter {
        /// Which, with its unit.
        what: &'static str,
        /// What was given.
        found: f64,
        /// What may be given.
        allowed: &'static str,
    },
    /// The vertices of a surface and their nodes do not fit.
    #[error(
        "the surface of body {body} has {n_vertices} vertices with {n_nodes} nodes, which have to be as many, ascend and be below \
         the model's {n_model}: take both from mesh::topology::surface_of"
    )]
    Nodes {
        /// The body.
        body: usize,
        /// Vertices of its surface.
        n_vertices: usize,
        /// Nodes given for them.
        n_nodes: usize,
        /// Nodes of its model.
        n_model: usize,
    },
    /// A triangle with a vertex that does not exist.
    #[error("triangle {triangle} of {what} {number} has vertex {vertex} of {n_vertices}")]
    Vertex {
        /// Body or obstacle.
        what: &'static str,
        /// Which.
        number: usize,
        /// The triangle.
        triangle: usize,
        /// Its vertex.
        vertex: u32,
        /// How many there are.
        n_vertices: usize,
    },
}

impl CollidingBodies {
    /// Bodies where their models are now, and obstacles at rest.
    ///
    /// # Errors
    /// [`ContactSetUpError`]: impossible distances, friction or efforts, a surface that does not fit its model.
    pub fn new(
        bodies: Vec<BodyParams>,
        obstacles: Vec<Obstacle>,
        params: &ContactParams,
    ) -> Result<Self, ContactSetUpError> {
        check(params, &bodies, &obstacles)?;
        let mut surfaces = Surfaces::default();
        for body in &bodies {
            let positions_m = body.model.state().positions_m;
            let now = TriMesh {
                positions_m: body.nodes.iter().map(|n| positions_m[n.index()]).collect(),
                triangles: body.surface.triangles.clone(),
            };
            surfaces.add(&now, body.nodes.iter().copied());
        }
        for obstacle in &obstacles {
            let mut now = TriMesh::default();
            if let ObstacleShape::Mesh(shape) = &obstacle.shape {
                now.triangles.clone_from(&shape.triangles);
                now.positions_m = vec![DVec3::ZERO; shape.positions_m.len()];
                obstacle.pose.place_into(&shape.positions_m, &mut now.positions_m);
            }
            surfaces.add(&now, (0..now.positions_m.len()).map(NodeId::from_index));
        }
        surfaces.finish();
        let n_vertices = surfaces.owner.len();
        let reach = Reach { skin_m: params.skin_m, margin_m: params.margin_m, slack_m: params.slack_m };
        let near = Near::new(&surfaces, bodies.len(), reach, params.self_collision, params.room);
        let mut response = Response::new(n_vertices, bodies.len());
        let most_nodes = bodies.iter().map(|b| b.model.state().positions_m.len()).max().unwrap_or(0);
        for (b, body) in bodies.iter().enumerate() {
            if matches!(body.model.step_answer(), StepAnswer::Coupled { .. } | StepAnswer::Static) {
                let group = response.group_mut(b);
                group.vertices.reserve_exact(params.most_coupled);
                group.compliance_m_per_n.reserve_exact(params.most_coupled * params.most_coupled);
            }
        }
        let zero = vec![DVec3::ZERO; n_vertices];
        Ok(Self {
            params: *params,
            bodies: bodies.into_iter().map(Body::new).collect(),
            obstacles: obstacles
                .into_iter()
                .map(|obstacle| MovingObstacle { end: obstacle.pose, obstacle })
                .collect(),
            near,
            response,
            contacts: Vec::with_capacity(params.room),
            before: Vec::with_capacity(params.room),
            pushes: Vec::with_capacity(params.room),
            shifts_m: zero.clone(),
            applied_n: zero.clone(),
            wanted_n: zero,
            near_vertices: Vec::with_capacity(8 * params.room + n_vertices),
            local: LocalModel::new(),
            work: LocalWork::with_room_for(most_nodes),
            report: ContactReport::default(),
            surfaces,
        })
    }
}

impl Body {
    fn new(params: BodyParams) -> Self {
        let n_nodes = params.model.state().positions_m.len();
        let room = || Constraints {
            displacements: Vec::with_capacity(n_nodes),
            forces: Vec::with_capacity(n_nodes),
        };
        Self {
            model: params.model,
            friction: params.friction,
            outside: room(),
            all: room(),
            corrections: Vec::with_capacity(n_nodes),
            coupled_for: None,
            answer_m: vec![DVec3::ZERO; n_nodes],
        }
    }
}

fn check(
    params: &ContactParams,
    bodies: &[BodyParams],
    obstacles: &[Obstacle],
) -> Result<(), ContactSetUpError> {
    let parameter = |what, found: f64, is_fine: bool, allowed| {
        if is_fine && found.is_finite() {
            return Ok(());
        }
        Err(ContactSetUpError::Parameter { what, found, allowed })
    };
    let above = "a finite number above 0";
    parameter("skin [m]", params.skin_m, params.skin_m > 0.0, above)?;
    parameter("margin [m]", params.margin_m, params.margin_m > 0.0, above)?;
    parameter("slack of the search [m]", params.slack_m, params.slack_m > 0.0, above)?;
    parameter("tolerance of the forces", params.tolerance, params.tolerance > 0.0, above)?;
    parameter("room for contacts", params.room as f64, params.room > 0, "a whole number from 1")?;
    let sweeps = params.most_sweeps;
    parameter("most sweeps", f64::from(sweeps), sweeps > 0, "a whole number from 1")?;
    let frictions = bodies.iter().map(|b| b.friction).chain(obstacles.iter().map(|o| o.friction));
    for friction in frictions {
        parameter("coefficient of friction", friction, friction >= 0.0, "a finite number from 0")?;
    }
    for (b, body) in bodies.iter().enumerate() {
        let (n_vertices, n_nodes) = (body.surface.positions_m.len(), body.nodes.len());
        let n_model = body.model.state().positions_m.len();
        let ascends = body.nodes.is_sorted_by(|a, b| a < b);
        let is_known = body.nodes.last().is_none_or(|n| n.index() < n_model);
        if n_vertices != n_nodes || !ascends || !is_known {
            return Err(ContactSetUpError::Nodes { body: b, n_vertices, n_nodes, n_model });
        }
        check_triangles("body", b, &body.surface.triangles, n_vertices)?;
    }
    for (o, obstacle) in obstacles.iter().enumerate() {
        let number = |what, found: f64| parameter(what, found, found > 0.0, above);
        match &obstacle.shape {
            ObstacleShape::HalfSpace => {}
            ObstacleShape::Ball { radius_m } => number("radius of a ball [m]", *radius_m)?,
            ObstacleShape::FlatPunch { radius_m, length_m } => {
                number("radius of a punch [m]", *radius_m)?;
                number("length of a punch [m]", *length_m)?;
            }
            ObstacleShape::Mesh(mesh) => {
                check_triangles("obstacle", o, &mesh.triangles, mesh.positions_m.len())?;
            }
        }
    }
    Ok(())
}

fn check_triangles(
    what: &'static str,
    number: usize,
    triangles: &[[u32; 3]],
    n_vertices: usize,
) -> Result<(), ContactSetUpError> {
    for (triangle, corners) in triangles.iter().enumerate() {
        if let Some(&vertex) = corners.iter().find(|v| **v as usize >= n_vertices) {
            return Err(ContactSetUpError::Vertex { what, number, triangle, vertex, n_vertices });
        }
    }
    Ok(())
}
