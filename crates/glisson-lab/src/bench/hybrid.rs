//! Cases of the hybrid model by exact condensation, on a body like a liver.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::Context;
use glam::DVec3;
use glisson::material::LinearElastic;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::zones::Zones;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::hybrid::condensed::{
    CondensedHybrid, CondensedParams, Precision, StoredNodes, Updated, ZoneLaw,
};
use glisson::model::{Constraints, DeformableModel, DynamicBody, FixedNode, ImposedDisplacement, Rayleigh};
use glisson::solve::boundary_nodes;

use super::body::StandardBody;
use super::{Case, Prepared, Settings, isa_name, thread_cpu_ns};

pub(super) const CASES: &[Case] = &[
    Case {
        name: "hybrid_refresh",
        about: "two pre-computed zones: 20 nodes held elsewhere in each call, exact interface, forces, all nodes of the zone",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| refresh(settings, &TWO_ZONES, Updated::LoadedZones),
    },
    Case {
        name: "hybrid_refresh_f32",
        about: "the same with tables in f32",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| {
            refresh(settings, &Setup { precision: Precision::F32, ..TWO_ZONES }, Updated::LoadedZones)
        },
    },
    Case {
        name: "hybrid_refresh_cut",
        about: "a tensor-mass zone of 5 % around a cut, the rest pre-computed: 1 ms of motion with 20 nodes held in it",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| refresh(settings, &AROUND_CUT, Updated::LoadedZones),
    },
    Case {
        name: "hybrid_refresh_beside_cut",
        about: "the same with the 20 nodes in the pre-computed zone, whose surface follows",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| {
            refresh(settings, &Setup { touched: Touched::Precomputed, ..AROUND_CUT }, Updated::LoadedZones)
        },
    },
    Case {
        name: "hybrid_surface",
        about: "two pre-computed zones: 20 nodes held, the whole surface",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| refresh(settings, &TWO_ZONES, Updated::Surface),
    },
    Case {
        name: "hybrid_surface_cut",
        about: "the body with the cut: 1 ms of motion, the whole surface",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| refresh(settings, &AROUND_CUT, Updated::Surface),
    },
    Case {
        name: "hybrid_all_cut",
        about: "the same with every node, inner ones by the factor",
        per: "refresh",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| refresh(settings, &AROUND_CUT, Updated::All),
    },
    Case {
        name: "hybrid_cut",
        about: "a tetrahedron is cut out of a pre-computed zone of 5 %, which turns dynamic; a copy of the model included",
        per: "cut",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| turn_dynamic(settings, ZoneLaw::TensorMass),
    },
    Case {
        name: "hybrid_cut_nonlinear",
        about: "the same with a zone that becomes St Venant-Kirchhoff tissue",
        per: "cut",
        sizes: &[SIZE],
        parallel: false,
        prepare: |settings| turn_dynamic(settings, ZoneLaw::NonlinearTensorMass),
    },
    Case {
        name: "hybrid_build",
        about: "two pre-computed zones of the body: factors, tables, interface",
        per: "build",
        sizes: &[SIZE],
        parallel: true,
        prepare: build,
    },
];

/// Tetrahedra of a body of about 4,900 nodes.
const SIZE: usize = 25_000;

/// Nodes that are held.
const N_HELD: usize = 20;

/// Time that a refresh advances [s]: the haptic loop's.
const REFRESH_S: f64 = 1e-3;

/// Share of the tetrahedra that are dynamic around the cut.
const DYNAMIC_SHARE: f64 = 0.05;

/// Length and depth of the cut, as shares of the dynamic zone's radius.
const CUT_SHARES: [f64; 2] = [0.6, 0.3];

/// Where the tools are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Touched {
    Precomputed,
    Dynamic,
}

struct Setup {
    zones: fn(&StandardBody) -> anyhow::Result<ZonedBody>,
    touched: Touched,
    stored: StoredNodes,
    precision: Precision,
}

const TWO_ZONES: Setup = Setup {
    zones: ZonedBody::two_precomputed,
    touched: Touched::Precomputed,
    stored: StoredNodes::All,
    precision: Precision::F64,
};

const AROUND_CUT: Setup = Setup {
    zones: |body| ZonedBody::around_cut(body, DVec3::Z),
    touched: Touched::Dynamic,
    stored: StoredNodes::Surface,
    precision: Precision::F64,
};

/// A body in zones.
pub(crate) struct ZonedBody {
    pub(crate) mesh: TetMesh,
    pub(crate) material: LinearElastic,
    pub(crate) fixed: Vec<FixedNode>,
    pub(crate) zones: Zones,
    pub(crate) laws: Vec<ZoneLaw>,
}

impl ZonedBody {
    /// The standard body cut in the middle of its long axis, both halves pre-computed.
    fn two_precomputed(body: &StandardBody) -> anyhow::Result<Self> {
        let of_tet = centres_m(&body.mesh).iter().map(|c| u32::from(c.x > 0.0)).collect();
        Self::new(body.mesh.clone(), body, of_tet, vec![ZoneLaw::Precomputed; 2])
    }

    /// The standard body with a slit where it reaches furthest along `outward`, 5 % of the tetrahedra around it dynamic,
    /// the rest pre-computed.
    fn around_cut(body: &StandardBody, outward: DVec3) -> anyhow::Result<Self> {
        let further = |a: DVec3, b: &DVec3| if b.dot(outward) > a.dot(outward) { *b } else { a };
        let top_m = body.mesh.positions_m.iter().fold(DVec3::ZERO, further);
        let across = if outward.x == 0.0 { DVec3::X } else { DVec3::Z };
        let nearest = |mesh: &TetMesh| {
            let far: Vec<f64> = centres_m(mesh).iter().map(|c| c.distance(top_m)).collect();
            let mut order: Vec<usize> = (0..far.len()).collect();
            order.sort_by(|&a, &b| far[a].total_cmp(&far[b]));
            order.truncate((DYNAMIC_SHARE * far.len() as f64).round() as usize);
            let radius_m = order.last().map_or(0.0, |&t| far[t]);
            (order, radius_m)
        };
        let (_, radius_m) = nearest(&body.mesh);
        // The tetrahedra that the plane through the top meets, so far along and so deep.
        let [length_m, depth_m] = CUT_SHARES.map(|share| share * radius_m);
        let is_cut = |t: &TetId| {
            let corners_m = body.mesh.corners_m(*t).map(|p| p - top_m);
            let centre_m = corners_m.iter().sum::<DVec3>() / 4.0;
            let sides = corners_m.map(|p| p.dot(across) > 1e-9);
            sides.contains(&true)
                && sides.contains(&false)
                && centre_m.y.abs() < length_m
                && centre_m.dot(outward) > -depth_m
        };
        let tets: Vec<TetId> =
            (0..body.mesh.tetrahedra.len()).map(TetId::from_index).filter(is_cut).collect();
        let mut cut = EditableMesh::new(body.mesh.clone())?;
        cut.apply(&MeshEdit::Remove { tets })?;
        let change = cut.compact();
        let fixed = body.fixed_nodes.iter().filter_map(|n| change.nodes.new_ids[n.index()]).collect();
        let mesh = cut.mesh().clone();
        let mut of_tet = vec![0; mesh.tetrahedra.len()];
        nearest(&mesh).0.into_iter().for_each(|t| of_tet[t] = 1);
        let body = StandardBody { mesh: TetMesh::default(), fixed_nodes: fixed, material: body.material };
        Self::new(mesh, &body, of_tet, vec![ZoneLaw::Precomputed, ZoneLaw::TensorMass])
    }

    fn new(mesh: TetMesh, body: &StandardBody, of_tet: Vec<u32>, laws: Vec<ZoneLaw>) -> anyhow::Result<Self> {
        let fixed = body.fixed_nodes.iter().map(|&node| FixedNode::all_axes(node)).collect();
        let zones = Zones::new(&mesh, of_tet)?;
        Ok(Self { zones, mesh, material: body.material, fixed, laws })
    }

    /// Bodies in about `n_tets` tetrahedra: two pre-computed zones, a dynamic one around a cut in the top, and one
    /// around a cut in the tip.
    pub(crate) fn all(n_tets: usize) -> anyhow::Result<[Self; 3]> {
        let body = StandardBody::shared(n_tets)?;
        let [top, tip] = [DVec3::Z, DVec3::X].map(|outward| Self::around_cut(&body, outward));
        Ok([Self::two_precomputed(&body)?, top?, tip?])
    }

    pub(crate) fn dynamic_body(&self, mass_per_s: f64, time_step_s: f64) -> DynamicBody<'_> {
        DynamicBody {
            fixed: &self.fixed,
            damping: Rayleigh::of_mass(mass_per_s),
            time_step_s,
            ..DynamicBody::new(&self.mesh, self.material.density_kg_per_m3())
        }
    }

    /// Surface nodes nearest to the surface node at `share` of those of a zone that are its alone and free.
    pub(crate) fn patch(&self, zone: usize, share: f64, n: usize) -> Vec<NodeId> {
        let is_fixed = |node: &NodeId| self.fixed.iter().any(|f| f.node == *node);
        let mut nodes: Vec<NodeId> = boundary_nodes(&self.mesh)
            .into_iter()
            .filter(|node| self.zones.zones_of_node(*node) == [zone as u32] && !is_fixed(node))
            .collect();
        let at = |node: NodeId| self.mesh.positions_m[node.index()];
        let centre_m = at(nodes[((share * nodes.len() as f64) as usize).min(nodes.len() - 1)]);
        nodes.sort_by(|&a, &b| at(a).distance(centre_m).total_cmp(&at(b).distance(centre_m)));
        nodes.truncate(n);
        nodes.sort_unstable();
        nodes
    }
}

fn centres_m(mesh: &TetMesh) -> Vec<DVec3> {
    let centre = |t: usize| mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
    (0..mesh.tetrahedra.len()).map(centre).collect()
}

/// A built model is a second or so of work: cases that differ in how they use it share it.
type Made = (ZonedBody, CondensedHybrid);

fn shared(setup: &Setup, size: usize) -> anyhow::Result<Arc<Made>> {
    static MADE: Mutex<BTreeMap<(usize, String), Arc<Made>>> = Mutex::new(BTreeMap::new());
    let body = StandardBody::shared(size)?;
    let zoned = (setup.zones)(&body)?;
    let key = (size, format!("{:?} {:?} {:?}", zoned.laws, setup.stored, setup.precision));
    let mut made = MADE.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(model) = made.get(&key) {
        return Ok(Arc::clone(model));
    }
    let model = CondensedHybrid::build(&CondensedParams {
        stored: setup.stored,
        precision: setup.precision,
        ..CondensedParams::new(
            zoned.dynamic_body(20.0, REFRESH_S),
            &zoned.material,
            &zoned.zones,
            &zoned.laws,
        )
    })?;
    // One at a time: the tables of one are hundreds of megabytes.
    made.clear();
    let model = Arc::new((zoned, model));
    made.insert(key, Arc::clone(&model));
    Ok(model)
}

fn refresh(settings: Settings, setup: &Setup, updated: Updated) -> anyhow::Result<Prepared> {
    let made = shared(setup, settings.size)?;
    let (body, mut model) = (&made.0, made.1.clone());
    model.set_updated(updated);
    let zones: Vec<usize> = (0..body.laws.len())
        .filter(|&z| (body.laws[z] == ZoneLaw::TensorMass) == (setup.touched == Touched::Dynamic))
        .collect();
    // LaneBlock places, in turn in each of the zones.
    let constraints: Vec<Constraints> = (0..8)
        .map(|i| {
            let nodes = body.patch(zones[i % zones.len()], (i as f64 + 0.5) / 8.0, N_HELD);
            let depth_m = DVec3::new(0.0, 1e-3, -2e-3 - 1e-4 * i as f64);
            let displacements =
                nodes.into_iter().map(|node| ImposedDisplacement { node, displacement_m: depth_m }).collect();
            Constraints { displacements, forces: Vec::new() }
        })
        .collect();
    let n_held = constraints.iter().map(|c| c.displacements.len()).min().context("no constraints")?;
    let n_dynamic_tets: usize = (0..body.laws.len())
        .filter(|&z| body.laws[z] == ZoneLaw::TensorMass)
        .map(|z| body.zones.tets(z).count())
        .sum();
    let size = model.size();
    let mut note = format!(
        "{} nodes, {} of the frontier solved, {n_held} held, tables {:.0} MB",
        body.mesh.positions_m.len(),
        size.n_condensed_nodes,
        size.bytes as f64 * 1e-6
    );
    if n_dynamic_tets > 0 {
        note += &format!(
            ", {n_dynamic_tets} dynamic tetrahedra with {} nodes ({} on the frontier), {} parts a step",
            size.n_dynamic_nodes,
            size.n_dynamic_frontier_nodes,
            model.parts_of_step(REFRESH_S)
        );
    }
    let mut turn = 0;
    Ok(Prepared {
        size: body.mesh.tetrahedra.len(),
        isa: isa_name(fearless_simd::Level::new()),
        precision: if setup.precision == Precision::F32 { "f32" } else { "f64" },
        work: None,
        note,
        run: Box::new(move || {
            turn = (turn + 1) % constraints.len();
            model.apply(black_box(&constraints[turn]));
            model.step(REFRESH_S);
            black_box(model.constraint_forces_n());
        }),
    })
}

/// A pre-computed zone turns dynamic by a cut in it.
fn turn_dynamic(settings: Settings, cut_law: ZoneLaw) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let mut zoned = ZonedBody::around_cut(&body, DVec3::Z)?;
    zoned.laws.fill(ZoneLaw::Precomputed);
    let params =
        CondensedParams::new(zoned.dynamic_body(20.0, REFRESH_S), &zoned.material, &zoned.zones, &zoned.laws);
    let whole = CondensedHybrid::build(&CondensedParams { cut_law, stored: StoredNodes::Surface, ..params })?;
    let tet = zoned.zones.tets(1).next().context("the zone is empty")?;
    let mut mesh = EditableMesh::new(zoned.mesh.clone())?;
    let change = mesh.apply(&MeshEdit::Remove { tets: vec![tet] })?;
    let before = thread_cpu_ns();
    let mut model = whole.clone();
    let copy_ms = (thread_cpu_ns() - before) as f64 * 1e-6;
    model.topology_changed(mesh.mesh(), &change)?;
    let (size, n_tets) = (model.size(), zoned.zones.tets(1).count());
    Ok(Prepared {
        size: zoned.mesh.tetrahedra.len(),
        isa: isa_name(fearless_simd::Level::new()),
        precision: "f64",
        work: None,
        note: format!(
            "{} nodes, {n_tets} tetrahedra turn, {} nodes on the frontier, {} parts a step of 1 ms; the copy takes \
             {copy_ms:.0} ms",
            zoned.mesh.positions_m.len(),
            size.n_dynamic_frontier_nodes,
            model.parts_of_step(REFRESH_S)
        ),
        run: Box::new(move || {
            let mut model = whole.clone();
            model.topology_changed(mesh.mesh(), black_box(&change)).expect("hybrids follow removals");
            black_box(model.size());
        }),
    })
}

fn build(settings: Settings) -> anyhow::Result<Prepared> {
    let body = StandardBody::shared(settings.size)?;
    let zoned = ZonedBody::two_precomputed(&body)?;
    Ok(Prepared {
        size: zoned.mesh.tetrahedra.len(),
        isa: isa_name(fearless_simd::Level::new()),
        precision: "f64",
        work: None,
        note: format!("{} nodes", zoned.mesh.positions_m.len()),
        run: Box::new(move || {
            let body = zoned.dynamic_body(0.0, REFRESH_S);
            let params = CondensedParams::new(body, &zoned.material, &zoned.zones, &zoned.laws);
            black_box(CondensedHybrid::build(&params).expect("the standard body is held"));
        }),
    })
}
