//! All bodies of a scene, with what their models are made from: one organ, or several bodies joined in one mesh.

use super::composite::{Composite, CompositePart};
use super::kind::{ModelKind, build_model, build_model_as_cut};
use super::rigid::{RigidBody, RigidMotion};
use super::{DeformableModel, ModelError, OrganBody};
use crate::workers::{Sequential, SharedWorkers};
use glisson_mesh::mesh::TetMesh;
use std::sync::Arc;

/// A body among several.
#[derive(Clone)]
pub enum BodyPart {
    /// It deforms.
    Organ {
        /// What its models are made from.
        body: Box<OrganBody>,
        /// The model that it has.
        kind: ModelKind,
    },
    /// It does not.
    Rigid {
        /// Its shape at rest.
        mesh: TetMesh,
        /// How it moves.
        motion: RigidMotion,
    },
}

impl BodyPart {
    /// Its mesh at rest.
    pub fn mesh(&self) -> &TetMesh {
        match self {
            Self::Organ { body, .. } => &body.mesh,
            Self::Rigid { mesh, .. } => mesh,
        }
    }

    /// Whether it is rigid.
    pub fn is_rigid(&self) -> bool {
        matches!(self, Self::Rigid { .. })
    }
}

/// The bodies of a scene.
#[derive(Clone)]
pub struct BodySet {
    /// The organ. Of several bodies: the first organ's material with the joint mesh of all.
    pub joint: OrganBody,
    /// Each of several bodies, in the order of the joint mesh; none when there is one organ alone.
    pub parts: Vec<BodyPart>,
}

impl BodySet {
    /// One organ alone.
    pub fn single(body: OrganBody) -> Self {
        Self { joint: body, parts: Vec::new() }
    }

    /// Several bodies; the first one has to be an organ.
    ///
    /// # Panics
    /// When the first body is rigid, or there is none.
    pub fn of_parts(parts: Vec<BodyPart>, workers: SharedWorkers) -> Self {
        let Some(BodyPart::Organ { body: first, .. }) = parts.first() else {
            panic!("the first of several bodies is an organ");
        };
        let joint = OrganBody { workers, mesh: joint_mesh(&parts), ..OrganBody::clone(first) };
        Self { joint, parts }
    }

    /// The model of all bodies: of one organ the one of this kind, of several the one of this kind for the first organ and each
    /// its own for the others.
    ///
    /// # Errors
    /// [`ModelError`] of a body's model.
    pub fn build_model(&self, kind: ModelKind) -> Result<Box<dyn DeformableModel>, ModelError> {
        self.build_as_cut(kind, &[])
    }

    /// The same of bodies from which tetrahedra are already gone; `live` of the joint mesh, or empty for all.
    ///
    /// # Errors
    /// [`ModelError`] of a body's model.
    pub fn build_as_cut(
        &self,
        kind: ModelKind,
        live: &[bool],
    ) -> Result<Box<dyn DeformableModel>, ModelError> {
        if self.parts.is_empty() {
            return if live.is_empty() {
                build_model(&self.joint, kind)
            } else {
                build_model_as_cut(&self.joint, kind, live)
            };
        }
        // Threads go to where they are of use: to all bodies at once, or to the one that deforms.
        let n_organs = self.parts.iter().filter(|part| !part.is_rigid()).count();
        let in_parallel = n_organs > 1;
        let mut first = 0;
        let mut models = Vec::with_capacity(self.parts.len());
        for (place, part) in self.parts.iter().enumerate() {
            let n_tets = part.mesh().tetrahedra.len();
            let live = live.get(first..first + n_tets).unwrap_or(&[]);
            first += n_tets;
            models.push(match part {
                BodyPart::Rigid { mesh, motion } => {
                    let body = RigidBody::new(mesh.positions_m.clone(), motion.clone());
                    CompositePart { has_clock: body.moves(), model: Box::new(body), n_tets }
                }
                BodyPart::Organ { body, kind: own } => {
                    let kind = if place == 0 { kind } else { *own };
                    let workers: SharedWorkers =
                        if in_parallel { Arc::new(Sequential) } else { Arc::clone(&self.joint.workers) };
                    let body = OrganBody { workers, ..OrganBody::clone(body) };
                    let model = if live.is_empty() {
                        build_model(&body, kind)?
                    } else {
                        build_model_as_cut(&body, kind, live)?
                    };
                    CompositePart { model, n_tets, has_clock: false }
                }
            });
        }
        Ok(Box::new(Composite::new(models, Arc::clone(&self.joint.workers), in_parallel)))
    }
}

/// The meshes one after the other.
fn joint_mesh(parts: &[BodyPart]) -> TetMesh {
    let mut joint = TetMesh::default();
    for part in parts {
        let (mesh, first) = (part.mesh(), joint.positions_m.len());
        joint.positions_m.extend_from_slice(&mesh.positions_m);
        let moved = mesh
            .tetrahedra
            .iter()
            .map(|corners| corners.map(|node| glisson_mesh::mesh::NodeId::from_index(node.index() + first)));
        joint.tetrahedra.extend(moved);
    }
    joint
}
