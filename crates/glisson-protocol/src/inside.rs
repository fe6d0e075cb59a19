//! What a viewer looks at inside of the bodies, and what it is sent of it with every snapshot (`docs/protocol.md`).

use glisson::math::DVec3;
use glisson::record::inside::{Field, Plane};
use glisson_runtime::published::Published;
use glisson_runtime::watchers::Watcher;

/// What a viewer looks at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// What is painted on the surface.
    pub field: Field,
    /// Cuts the bodies open for the eye.
    pub plane: Option<Plane>,
    /// Energies of the whole.
    pub energies: bool,
}

impl Look {
    pub(crate) fn is_at_nothing(&self) -> bool {
        *self == Self::default()
    }
}

/// A look, and what keeps the inside gathered as long as it lasts.
pub(crate) struct Looker {
    pub(crate) look: Look,
    pub(crate) _watcher: Watcher,
}

/// What is sent of it.
#[derive(Clone, Debug, PartialEq)]
pub struct InsideView {
    /// 0 none, 1 strain, 2 stress, 3 quality.
    pub(crate) field: u32,
    /// Kinetic, elastic, and in the springs of hands [J].
    pub(crate) energies_j: [f64; 3],
    /// At the displayed vertices; none without a field.
    pub(crate) at_vertices: Vec<f32>,
    /// Corners of the triangles of the section, with the values there.
    pub(crate) section: Vec<(DVec3, f64)>,
}

impl InsideView {
    /// What `look` shows of a state; none where nobody gathered it.
    pub(crate) fn of(look: &Look, published: &Published) -> Option<Self> {
        let inside = published.inside.as_deref()?;
        let at_nodes = inside.interior.at_nodes(look.field, &inside.positions_m);
        let at = |node: &glisson::mesh::NodeId| at_nodes.get(node.index()).map_or(0.0, |value| *value as f32);
        let has_field = look.field != Field::None;
        let nodes = published.topology.nodes.iter().filter(|_| has_field);
        let section = |plane: Plane| inside.interior.section(&plane, &inside.positions_m, &at_nodes);
        let elastic_j =
            if look.energies { inside.interior.elastic_energy_j(&inside.positions_m) } else { 0.0 };
        Some(Self {
            field: look.field as u32,
            energies_j: [inside.kinetic_energy_j, elastic_j, inside.hand_energy_j],
            at_vertices: nodes.map(at).collect(),
            section: look.plane.map(section).unwrap_or_default(),
        })
    }
}
