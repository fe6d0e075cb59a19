//! What is inside of the bodies at a moment, for who looks: places of all nodes, with the laws of their tetrahedra, and energies.

use crate::Simulation;
use glisson::material::{LawChoice, LinearElastic, law_named};
use glisson::math::DVec3;
use glisson::model::kind::ModelKind;
use glisson::record::inside::{Interior, SharedLaw};
use glisson::scene::{BodyPart, BodySet, OrganBody};
use std::fmt;
use std::sync::Arc;

/// The inside at a moment.
#[derive(Clone)]
pub struct Inside {
    /// The tetrahedra at rest.
    pub interior: Arc<Interior>,
    /// Where all nodes are [m].
    pub positions_m: Vec<DVec3>,
    /// Kinetic energy of all bodies [J].
    pub kinetic_energy_j: f64,
    /// Energy in the springs between hands and instruments [J]: F^2/2k of the forces on them.
    pub hand_energy_j: f64,
    /// What `interior` was made from.
    made_from: MadeFrom,
}

#[derive(Clone)]
struct MadeFrom {
    bodies: Arc<BodySet>,
    model: ModelKind,
    topology_version: u32,
    n_live: usize,
}

impl MadeFrom {
    fn is(&self, other: &Self) -> bool {
        let numbers = |from: &Self| (from.model, from.topology_version, from.n_live);
        Arc::ptr_eq(&self.bodies, &other.bodies) && numbers(self) == numbers(other)
    }
}

impl fmt::Debug for Inside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the inside of {} tetrahedra", self.interior.n_tetrahedra())
    }
}

impl Inside {
    /// That of a simulation now; what still holds of the one before is shared.
    pub fn of(simulation: &Simulation, before: Option<&Self>) -> Self {
        let (world, organ) = (simulation.world(), simulation.world().organ());
        let made_from = MadeFrom {
            bodies: Arc::clone(simulation.bodies()),
            model: world.model_kind(),
            topology_version: organ.topology_version(),
            n_live: organ.live_tetrahedra().iter().filter(|live| **live).count(),
        };
        let known = before.filter(|before| before.made_from.is(&made_from));
        let interior =
            known.map_or_else(|| Arc::new(interior(simulation)), |known| Arc::clone(&known.interior));
        let stiffness_n_per_m = world.spec().hand.map(|hand| hand.stiffness_n_per_m);
        let n_tools = world.tools().len();
        let forces_n =
            world.report().tools[..n_tools].iter().map(|tool| tool.force_on_tool_n.length_squared());
        let forces_n2: f64 = forces_n.sum();
        Self {
            interior,
            positions_m: world.state().positions_m.to_vec(),
            kinetic_energy_j: world.report().model.kinetic_energy_j,
            hand_energy_j: stiffness_n_per_m.map_or(0.0, |stiffness| forces_n2 / (2.0 * stiffness)),
            made_from,
        }
    }
}

/// The law of a tissue in a model: the one that is chosen where the model follows it, else the model's own.
fn law(body: &OrganBody, kind: ModelKind, tissue: &LinearElastic) -> Option<SharedLaw> {
    let chosen = body.law.clone().filter(|law| kind.follows(law.name()));
    let own = || law_named(kind.laws().first().copied().unwrap_or("linear"));
    let law: LawChoice = chosen.or_else(own)?;
    Some(law.with_moduli_of(tissue).ok()?.into_shared())
}

fn interior(simulation: &Simulation) -> Interior {
    let (world, bodies) = (simulation.world(), simulation.bodies());
    let mut laws = Vec::new();
    // Of each body the number of its first law; those of its other tissues follow.
    let mut first_of = Vec::new();
    let mut add = |body: &OrganBody, kind: ModelKind| {
        let first = laws.len() as u16;
        let parts = body.tissue_parts.iter().flat_map(|parts| &parts.materials);
        laws.extend(std::iter::once(&body.material).chain(parts).map_while(|tissue| law(body, kind, tissue)));
        Some(first)
    };
    if bodies.parts.is_empty() {
        first_of.push(add(&bodies.joint, world.model_kind()));
    }
    for (place, part) in bodies.parts.iter().enumerate() {
        first_of.push(match part {
            BodyPart::Organ { body, kind } => add(body, if place == 0 { world.model_kind() } else { *kind }),
            BodyPart::Rigid { .. } => None,
        });
    }
    let mesh = world.organ().mesh();
    let body_of = world.organ().body_of_nodes();
    // Tetrahedra that edits made are of their body's own tissue.
    let of_parts = |tet: usize| bodies.joint.tissue_parts.as_ref()?.of_tet.get(tet).copied().flatten();
    let law_of = |tet: usize| {
        let body = body_of.get(mesh.tetrahedra[tet][0].index()).copied().unwrap_or(0) as usize;
        let first: u16 = first_of.get(body).copied().flatten()?;
        Some(first + if body == 0 { of_parts(tet).map_or(0, |part| part + 1) } else { 0 })
    };
    Interior::new(mesh, world.organ().live_tetrahedra(), laws, law_of)
}
