//! Tetrahedral meshes.

mod change;
pub mod topology;
pub mod edit;
pub mod embedding;
pub mod quality;
pub mod repair;
pub mod refine;
pub mod stuffing;
pub mod organs;
pub mod thin;
pub mod generate;
pub mod remap;
pub mod zones;
pub mod faults;
pub mod checked;
pub mod box_mesh;
pub mod files;

use crate::math::{DVec3, tetrahedron_volume_m3};

macro_rules! id_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
        #[derive(serde::Serialize, serde::Deserialize, bytemuck::Pod, bytemuck::Zeroable)]
        #[repr(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// As a place in an array.
            pub fn index(self) -> usize {
                self.0 as usize
            }

            /// From a place in an array.
            ///
            /// # Panics
            /// Above `u32::MAX`, which no mesh that fits in memory reaches.
            pub fn from_index(index: usize) -> Self {
                Self(u32::try_from(index).expect("meshes have fewer than 2^32 entities"))
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

id_type! {
    /// A node (vertex) of a tetrahedral mesh.
    NodeId
}
id_type! {
    /// An edge of a tetrahedral mesh.
    EdgeId
}
id_type! {
    /// A triangle (face of one or two tetrahedra) of a tetrahedral mesh.
    TriangleId
}
id_type! {
    /// A tetrahedron.
    TetId
}

/// Tetrahedra over shared nodes: nodes 1, 2, 3 run counter-clockwise seen from outside the face opposite
/// to node 0, so that [`tetrahedron_volume_m3`] is positive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetMesh {
    /// Nodes [m], LPS.
    pub positions_m: Vec<DVec3>,
    /// Nodes of each tetrahedron.
    pub tetrahedra: Vec<[NodeId; 4]>,
    /// How much of each tetrahedron is material, of its volume (0 to 1); empty where every one is full. Other shares than 1 have
    /// only the copies of an [`embedding`].
    pub shares: Vec<f64>,
}

impl TetMesh {
    /// Corners of tetrahedron `tet` [m].
    pub fn corners_m(&self, tet: TetId) -> [DVec3; 4] {
        self.tetrahedra[tet.index()].map(|n| self.positions_m[n.index()])
    }

    /// How much of tetrahedron `tet` is material.
    pub fn share(&self, tet: TetId) -> f64 {
        self.shares.get(tet.index()).copied().unwrap_or(1.0)
    }

    /// Volume of the material of tetrahedron `tet` [m3].
    pub fn tet_volume_m3(&self, tet: TetId) -> f64 {
        tetrahedron_volume_m3(self.corners_m(tet)) * self.share(tet)
    }

    /// Adds the nodes and tetrahedra that `longer`, which begins with this one, has more.
    pub fn grow_to(&mut self, longer: &Self) {
        if !longer.shares.is_empty() {
            self.shares.resize(self.tetrahedra.len(), 1.0);
            self.shares.extend_from_slice(&longer.shares[self.tetrahedra.len()..]);
        }
        self.positions_m.extend_from_slice(&longer.positions_m[self.positions_m.len()..]);
        self.tetrahedra.extend_from_slice(&longer.tetrahedra[self.tetrahedra.len()..]);
    }

    /// Drops all but the first so many nodes and tetrahedra.
    pub fn truncate(&mut self, n_nodes: usize, n_tets: usize) {
        self.positions_m.truncate(n_nodes);
        self.tetrahedra.truncate(n_tets);
        self.shares.truncate(n_tets);
    }

    /// Sum of the tetrahedra's volumes [m3].
    pub fn volume_m3(&self) -> f64 {
        (0..self.tetrahedra.len()).map(|t| self.tet_volume_m3(TetId::from_index(t))).sum()
    }
}
