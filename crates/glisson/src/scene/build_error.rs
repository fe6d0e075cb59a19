//! Why a scene gives no world.

use crate::image::labels::LabelError;
use crate::image::vessels::VesselFileError;
use crate::material::MaterialError;
use crate::material::tissues::TissueError;
use crate::math::DVec3;
use crate::mesh::files::{LABEL_FIELD, MeshFileError};
use crate::mesh::generate::MeshingError;
use crate::mesh::organs::OrganMeshError;
use crate::model::ModelError;
use crate::surface::error::SurfaceError;
use crate::surface::files::SurfaceFileError;
use crate::world::organ::OrganError;

/// Why a scene gives no world.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The mesh file.
    #[error(transparent)]
    MeshFile(#[from] MeshFileError),
    /// The mesh is no body.
    #[error("{mesh}: {error}")]
    Organ {
        /// What the mesh is.
        mesh: String,
        /// What is wrong with it.
        error: OrganError,
    },
    /// Parts of other tissue in a mesh without labels.
    #[error(
        "{mesh}: found no labels of tetrahedra, [[organ.part]] needs them: the cell field `{LABEL_FIELD}` of a .vtu file, which \
         `glisson mesh-organs` writes, or phantom = {{ parts }}"
    )]
    NoLabels {
        /// What the mesh is.
        mesh: String,
    },
    /// A part that the mesh has not.
    #[error("{mesh}: no tetrahedron has the label {label} of [[organ.part]]; labels found: {found}")]
    NoSuchLabel {
        /// What the mesh is.
        mesh: String,
        /// The label.
        label: i64,
        /// Those that are there.
        found: String,
    },
    /// The surface of an instrument's tip.
    #[error(transparent)]
    ToolShape(#[from] SurfaceFileError),
    /// The organ's vessels.
    #[error(transparent)]
    Vessels(#[from] VesselFileError),
    /// The tissue's name or numbers.
    #[error(transparent)]
    Tissue(#[from] TissueError),
    /// The material's numbers.
    #[error(transparent)]
    Material(#[from] MaterialError),
    /// Nothing holds the organ.
    #[error(
        "no node of {mesh} lies in the scene's fixed regions ({n_regions} given): the organ would float; \
         add [[organ.fixed]] with a region that holds some of it (the mesh spans {min_mm} to {max_mm} mm), or, with a dynamic \
         model, a [[rigid]] body or another organ that carries it"
    )]
    NothingFixed {
        /// What the mesh is.
        mesh: String,
        /// Regions in the scene.
        n_regions: usize,
        /// Smallest corner of the mesh [mm].
        min_mm: DVec3,
        /// Largest corner of the mesh [mm].
        max_mm: DVec3,
    },
    /// A tube that its tetrahedra leave out.
    #[error(
        "a tube of {radius_mm:.3} mm radius at {place_mm:.1} mm is lost between tetrahedra with edges of {edge_mm:.1} mm; take a shorter edge"
    )]
    ThinTube {
        /// Where [mm].
        place_mm: DVec3,
        /// Its radius there [mm].
        radius_mm: f64,
        /// Mean edge of the tetrahedra [mm].
        edge_mm: f64,
    },
    /// The branches of a tube.
    #[error("a tube with branches: {0}")]
    Branches(String),
    /// A part of the scene that no node of the mesh belongs to.
    #[error(
        "no node of {mesh} lies in the region of {what}: it would do nothing (the mesh spans {min_mm:.1} to {max_mm:.1} mm)"
    )]
    EmptyRegion {
        /// What the mesh is.
        mesh: String,
        /// Which table, with its number from 1.
        what: String,
        /// Smallest corner of the mesh [mm].
        min_mm: DVec3,
        /// Largest corner of the mesh [mm].
        max_mm: DVec3,
    },
    /// A body among several.
    #[error("body \"{name}\": {error}")]
    Body {
        /// Its name.
        name: String,
        /// What is wrong with it.
        error: Box<BuildError>,
    },
    /// Bodies that are too far from each other for an attachment.
    #[error(
        "[[attachment]] number {number}: no node of \"{}\" in its region is within {reach_mm} mm of \"{}\"", names[0], names[1]
    )]
    NothingAttached {
        /// Its number from 1.
        number: usize,
        /// The bodies.
        names: [String; 2],
        /// Its reach [mm].
        reach_mm: f64,
    },
    /// A surface cannot be filled with tetrahedra.
    #[error("its surface cannot be meshed; another \"edge\", or number of \"tetrahedra\", may help")]
    Meshing(#[from] MeshingError),
    /// An organ that the synthetic patient has not.
    #[error("an organ of the phantom is not there")]
    PhantomLabel(#[from] LabelError),
    /// The surface of an organ of the synthetic patient.
    #[error("an organ of the phantom has no surface")]
    PhantomSurface(#[from] SurfaceError),
    /// An organ of the synthetic patient with parts.
    #[error("an organ of the phantom cannot be meshed with its parts")]
    PhantomOrgans(#[from] OrganMeshError),
    /// The model that the scene asks for.
    #[error(transparent)]
    Model(#[from] ModelError),
}
