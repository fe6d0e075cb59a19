//! What a world is made from, in SI.

use crate::contact::response::bond::Bond;
use crate::contact::response::persistent::BodyContactParams;
use crate::contact::response::self_contact::SelfContactParams;
use crate::image::vessels::Tube;
use crate::material::LinearElastic;
use crate::math::{Aabb, DVec3};
use crate::mesh::NodeId;
use crate::model::kind::ModelKind;
use crate::model::{Attachment, FixedNode};
use crate::tool::Tool;
use crate::tool::fracture::Tearing;
use std::ops::Range;

pub use super::hand::Hand;
pub use super::suture_spec::{MOST_SUTURES, Needle, SutureSpec};

/// Description of a world; files are read in `scene`.
#[derive(Clone, Debug, PartialEq)]
pub struct WorldSpec {
    /// What the user calls it.
    pub name: String,
    /// Time that one step advances [s].
    pub time_step_s: f64,
    /// Gravity [m/s2].
    pub gravity_m_per_s2: DVec3,
    /// What holds the organ at rest.
    pub supports: Vec<Support>,
    /// What ties it to its surroundings.
    pub ligaments: Vec<Ligament>,
    /// Forces on parts of it.
    pub loads: Vec<Load>,
    /// Accelerations of the whole, beside gravity.
    pub fields: Vec<ForceField>,
    /// How it comes apart under force; it never does when absent, and then imposed motions have no limit.
    pub tearing: Option<Tearing>,
    /// Whether the worst tetrahedra at a cut are mended when the blade is lifted.
    pub mends_cuts: bool,
    /// How a user's hand holds the instruments; when absent, tissue follows every motion of the hand exactly, whatever force
    /// that takes.
    pub hand: Option<Hand>,
    /// The tissue at rest, of one organ alone: with a hand that gives way, contacts yield as in it where the mesh is too coarse for
    /// them. None: they yield as the mesh does.
    pub tissue: Option<LinearElastic>,
    /// How the organ touches itself, and pieces cut loose each other; they pass through when absent.
    pub self_contact: Option<SelfContactParams>,
    /// Several bodies, in the order of the joint mesh; none for one organ, whose supports, ligaments and loads stand above.
    pub bodies: Vec<BodySpec>,
    /// How several bodies touch each other; they pass through when absent, or have springs by `self_contact`.
    pub body_contact: Option<BodyContactParams>,
    /// What ties bodies to each other.
    pub bonds: Vec<Bond>,
    /// Blood vessels inside the organ, in its rest shape.
    pub vessels: Vec<Tube>,
    /// Threads: at most [`MOST_SUTURES`].
    pub sutures: Vec<SutureSpec>,
    /// The instruments: one to [`crate::tool::MAX_TOOLS`].
    pub tools: Vec<Tool>,
}

/// One of several bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct BodySpec {
    /// What the user calls it.
    pub name: String,
    /// sRGB colour; the look of tissue, or of a rigid body, when absent.
    pub color: Option<[u8; 3]>,
    /// Whether it is rigid: its nodes go where its motion puts them.
    pub is_rigid: bool,
    /// The tissue at rest, as [`WorldSpec::tissue`]; none of a rigid body.
    pub tissue: Option<LinearElastic>,
    /// The model that it has at the start; none of a rigid body.
    pub model: Option<ModelKind>,
    /// Its nodes in the joint mesh at the start.
    pub nodes: Range<u32>,
    /// Its tetrahedra in the joint mesh at the start.
    pub tetrahedra: Range<u32>,
    /// What holds it at rest.
    pub supports: Vec<Support>,
    /// What ties it to its surroundings.
    pub ligaments: Vec<Ligament>,
    /// Forces on parts of it.
    pub loads: Vec<Load>,
}

impl WorldSpec {
    /// A world with one tool, without gravity, supports and loads.
    pub fn new(name: &str, time_step_s: f64, tool: Tool) -> Self {
        Self {
            name: name.into(),
            time_step_s,
            gravity_m_per_s2: DVec3::ZERO,
            supports: Vec::new(),
            ligaments: Vec::new(),
            loads: Vec::new(),
            fields: Vec::new(),
            tearing: None,
            mends_cuts: false,
            hand: None,
            tissue: None,
            self_contact: None,
            bodies: Vec::new(),
            body_contact: None,
            bonds: Vec::new(),
            vessels: Vec::new(),
            sutures: Vec::new(),
            tools: vec![tool],
        }
    }

    /// The tissue at rest of a body; of the one organ whatever the number.
    pub(super) fn tissue_of(&self, body: usize) -> Option<&LinearElastic> {
        if self.bodies.is_empty() { self.tissue.as_ref() } else { self.bodies.get(body)?.tissue.as_ref() }
    }

    /// Whether a body's displacements are linear in the forces, where the first one has the model `first`, which may have changed.
    pub(super) fn is_linear(&self, body: usize, first: ModelKind) -> bool {
        let model = if body == 0 { Some(first) } else { self.bodies.get(body).and_then(|body| body.model) };
        model.is_some_and(|kind| kind.row().laws.first() == Some(&"linear"))
    }

    /// Whether each node, at rest at these places [m], is supported, along one axis at least, or at a ligament.
    pub(super) fn anchored_nodes(&self, positions_m: &[DVec3]) -> Vec<bool> {
        let mut is_anchored = vec![false; positions_m.len()];
        self.ligament_nodes(positions_m).into_iter().for_each(|n| is_anchored[n.index()] = true);
        self.fixed_nodes(positions_m).into_iter().for_each(|f| is_anchored[f.node.index()] = true);
        let bonded = self.bonds.iter().flat_map(|bond| bond.nodes);
        bonded.for_each(|n| is_anchored[n.index()] = true);
        is_anchored
    }
}

/// Some of an organ's nodes, by where they are in the rest shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Region {
    /// All nodes inside a box.
    Box(Aabb),
    /// All nodes inside a ball.
    Ball {
        /// Centre [m].
        center_m: DVec3,
        /// Radius [m].
        radius_m: f64,
    },
    /// The share of all nodes that lies furthest along a direction, such as the lowest 5 %.
    Furthest {
        /// Direction, any length but zero.
        direction: DVec3,
        /// Between 0 and 1.
        fraction: f64,
    },
}

/// A region whose nodes are held at rest along some axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Support {
    /// Where.
    pub region: Region,
    /// Which of x, y, z do not move.
    pub axes: [bool; 3],
}

impl Support {
    /// A region whose nodes do not move at all.
    pub fn all_axes(region: Region) -> Self {
        Self { region, axes: [true; 3] }
    }
}

/// A band from the nodes of a region, taut in the rest shape without pulling yet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ligament {
    /// Where it is attached to the organ.
    pub region: Region,
    /// Unit vector from the organ to where it begins.
    pub direction: DVec3,
    /// Length in the rest shape, up to which it is slack [m].
    pub length_m: f64,
    /// Stiffness of the whole band [N/m], shared evenly by the nodes of the region.
    pub stiffness_n_per_m: f64,
}

/// When a load acts; times count from the start, or from the last reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LoadTime {
    /// In every step ("permanent" in seed `003`, s. 3.2).
    Always,
    /// From `from_s` until before `to_s`.
    During {
        /// First moment [s].
        from_s: f64,
        /// End [s].
        to_s: f64,
    },
    /// In one step: the first that begins at this moment [s] or after it ("instantaneous" in the seed).
    Once(f64),
}

impl LoadTime {
    /// Whether the load acts in the step from `step` to `step + 1` steps of `time_step_s`.
    pub fn acts_in_step(self, step: u64, time_step_s: f64) -> bool {
        // Steps are compared, not sums of rounded times.
        let first_after = |time_s: f64| (time_s / time_step_s - 1e-9).ceil().max(0.0);
        let step = step as f64;
        match self {
            Self::Always => true,
            Self::During { from_s, to_s } => step >= first_after(from_s) && step < first_after(to_s),
            Self::Once(at_s) => step == first_after(at_s),
        }
    }
}

/// A force on the surface of a region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Where.
    pub region: Region,
    /// The whole force [N], shared evenly by the nodes of the surface that are not held along every axis.
    pub force_n: DVec3,
    /// When.
    pub time: LoadTime,
}

/// A force field over the whole organ: every bit of mass is pushed alike, as by gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceField {
    /// Force over mass [m/s2].
    pub acceleration_m_per_s2: DVec3,
    /// When.
    pub time: LoadTime,
}

/// Marks the nodes of `region`.
fn mark(region: &Region, positions_m: &[DVec3], is_inside: &mut [bool]) {
    match *region {
        Region::Box(bounds) => {
            for (inside, &p) in is_inside.iter_mut().zip(positions_m) {
                *inside |= bounds.contains(p);
            }
        }
        Region::Ball { center_m, radius_m } => {
            for (inside, &p) in is_inside.iter_mut().zip(positions_m) {
                *inside |= p.distance(center_m) <= radius_m;
            }
        }
        Region::Furthest { direction, fraction } => {
            let mut order: Vec<usize> = (0..positions_m.len()).collect();
            let along = |i: &usize| positions_m[*i].dot(direction);
            order.sort_by(|a, b| along(b).total_cmp(&along(a)).then(a.cmp(b)));
            let n = (fraction * positions_m.len() as f64).ceil() as usize;
            for &i in order.iter().take(n) {
                is_inside[i] = true;
            }
        }
    }
}

/// The nodes in any of `regions`, ascending.
pub fn nodes_in(regions: &[Region], positions_m: &[DVec3]) -> Vec<NodeId> {
    let mut is_inside = vec![false; positions_m.len()];
    for region in regions {
        mark(region, positions_m, &mut is_inside);
    }
    (0..is_inside.len()).filter(|&i| is_inside[i]).map(NodeId::from_index).collect()
}

/// The nodes that `supports` hold, ascending; what several hold moves along no axis of any of them.
pub fn fixed_nodes(supports: &[Support], positions_m: &[DVec3]) -> Vec<FixedNode> {
    let mut axes = vec![[false; 3]; positions_m.len()];
    for support in supports {
        for node in nodes_in(&[support.region], positions_m) {
            for (axis, held) in axes[node.index()].iter_mut().zip(support.axes) {
                *axis |= held;
            }
        }
    }
    let held = |(n, axes): (usize, [bool; 3])| {
        axes.contains(&true).then_some(FixedNode { node: NodeId::from_index(n), axes })
    };
    axes.into_iter().enumerate().filter_map(held).collect()
}

/// The springs of `ligaments`, in their order and ascending by node in each.
pub fn attachments(ligaments: &[Ligament], positions_m: &[DVec3]) -> Vec<Attachment> {
    let mut all = Vec::new();
    for ligament in ligaments {
        let nodes = nodes_in(&[ligament.region], positions_m);
        let share = 1.0 / nodes.len() as f64;
        all.extend(nodes.into_iter().map(|node| Attachment {
            node,
            anchor_m: positions_m[node.index()] + ligament.direction * ligament.length_m,
            slack_length_m: ligament.length_m,
            stiffness_n_per_m: ligament.stiffness_n_per_m * share,
        }));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row() -> Vec<DVec3> {
        (0..10).map(|i| DVec3::new(0.0, 0.0, f64::from(i))).collect()
    }

    #[test]
    fn regions_hold_the_nodes_inside_them() {
        let positions = row();
        let ids = |regions: &[Region]| nodes_in(regions, &positions).iter().map(|n| n.0).collect::<Vec<_>>();
        let lowest = Region::Furthest { direction: -DVec3::Z, fraction: 0.2 };
        let ball = Region::Ball { center_m: DVec3::new(0.0, 0.0, 8.0), radius_m: 0.5 };
        let bounds = Aabb { min_m: DVec3::new(-1.0, -1.0, 3.5), max_m: DVec3::new(1.0, 1.0, 5.0) };
        assert_eq!(ids(&[lowest]), [0, 1]);
        assert_eq!(ids(&[ball, Region::Box(bounds)]), [4, 5, 8]);
        assert!(ids(&[]).is_empty());
    }

    #[test]
    fn supports_that_overlap_hold_the_axes_of_both() {
        let lowest = Region::Furthest { direction: -DVec3::Z, fraction: 0.2 };
        let first = Region::Ball { center_m: DVec3::ZERO, radius_m: 0.5 };
        let supports = [
            Support { region: lowest, axes: [false, false, true] },
            Support { region: first, axes: [true, false, false] },
        ];
        let expected = [
            FixedNode { node: NodeId(0), axes: [true, false, true] },
            FixedNode { node: NodeId(1), axes: [false, false, true] },
        ];
        assert_eq!(fixed_nodes(&supports, &row()), expected);
    }

    #[test]
    fn a_ligament_is_taut_at_rest_and_its_springs_add_up() {
        let region = Region::Furthest { direction: DVec3::Z, fraction: 0.3 };
        let ligament = Ligament { region, direction: DVec3::Z, length_m: 2.0, stiffness_n_per_m: 60.0 };
        let springs = attachments(&[ligament], &row());
        assert_eq!(springs.iter().map(|s| s.node.0).collect::<Vec<_>>(), [7, 8, 9]);
        assert!(springs.iter().all(|s| s.force_n(row()[s.node.index()]) == DVec3::ZERO));
        let pull_n: f64 = springs.iter().map(|s| s.force_n(row()[s.node.index()] - DVec3::Z).z).sum();
        assert!((pull_n - 60.0).abs() < 1e-12, "{pull_n}");
    }

    #[test]
    fn loads_act_in_their_steps() {
        let steps = |time: LoadTime| (0..8).filter(|&s| time.acts_in_step(s, 0.1)).collect::<Vec<u64>>();
        assert_eq!(steps(LoadTime::Always).len(), 8);
        assert_eq!(steps(LoadTime::During { from_s: 0.3, to_s: 0.6 }), [3, 4, 5]);
        assert_eq!(steps(LoadTime::Once(0.3)), [3]);
        assert_eq!(steps(LoadTime::Once(0.0)), [0]);
    }
}
