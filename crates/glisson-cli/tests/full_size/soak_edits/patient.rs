//! One body with its tools, vessels, loads and ligaments that random edits are made on, and what is checked after each.

use super::attached::{Attached, Memory, check_parents};
use super::checks::{AT_ONCE_S, Plain, against_plain, check_adjacency, difference, within_measure};
use super::tally::Tally;
use glisson::image::vessels::Tube;
use glisson::material::{LinearElastic, PronySeries, PronyTerm};
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson::mesh::refine::{FineRegion, refining};
use glisson::mesh::repair::{MendParams, mending};
use glisson::mesh::topology::{SingularEntities, Topology};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::kind::ModelKind;
use glisson::model::{Attachment, DeformableModel, DynamicBody, FixedNode};
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use glisson::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};
use glisson::tool::fracture::{FractureEnergy, Tearing};
use glisson::tool::{MAX_TOOLS, ToolInput};
use glisson::world::spec::{Ligament, Load, LoadTime, Region, Support, WorldSpec, attachments, fixed_nodes};
use glisson::world::{StepInput, World};

const LAW: KernelLaw = KernelLaw::StableNeoHooke;
pub(super) const TIME_STEP_S: f64 = 4e-4;
/// Steps after an edit.
const STEPS_AFTER: u64 = 3;
/// Edits between two comparisons with a fresh model.
pub(super) const COMPARED_EVERY: u64 = 50;
/// Soft, so that pulling tears within reach of the jaws: a choice of the test, a quarter of liver's.
const BRITTLE: FractureEnergy = FractureEnergy { energy_j_per_m2: 41.0 };
const DENSITY_KG_PER_M3: f64 = 1060.0;
/// Edits that can be taken back: more than one call of the tools can make.
const UNDO_DEPTH: usize = 512;
/// A force that pieces which come loose do not fly away under.
const LOAD_N: f64 = 1e-5;

/// Three materials, by place.
fn materials() -> [LinearElastic; 3] {
    [4100.0, 6150.0, 2050.0].map(|young_pa| {
        LinearElastic::from_young_poisson(young_pa, 0.45, DENSITY_KG_PER_M3).expect("they are sound")
    })
}

fn relaxation() -> PronySeries {
    let terms = [PronyTerm { share: 0.3, time_s: 0.05 }, PronyTerm { share: 0.2, time_s: 2.0 }];
    PronySeries::new(&terms).expect("it is sound")
}

/// Three branches from the middle, and a root.
fn tubes(mesh: &TetMesh, middle_m: DVec3, random: &mut SeededRandom) -> Vec<Tube> {
    let n = mesh.tetrahedra.len();
    let centroid = |t: usize| mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
    let nearest =
        (0..n).min_by(|&a, &b| centroid(a).distance(middle_m).total_cmp(&centroid(b).distance(middle_m)));
    let hub_m = centroid(nearest.expect("a body has tetrahedra"));
    // Anywhere in a tetrahedron: from centroid to centroid a tube runs through nodes and edges of a regular mesh, where it
    // is a matter of rounding whether a triangle severs it.
    let mut places = SeededRandom::new(n as u64);
    let mut ends = std::iter::repeat_with(|| {
        let tet = TetId::from_index(((random.uniform() * n as f64) as usize).min(n - 1));
        let weights = [0; 4].map(|_| places.uniform_in(0.1, 1.0));
        let sum_m: DVec3 = mesh.corners_m(tet).into_iter().zip(weights).map(|(p, w)| p * w).sum();
        sum_m / weights.iter().sum::<f64>()
    })
    .filter(|end_m| end_m.distance(hub_m) > 5e-3);
    let mut end_m = || ends.next().expect("they do not run out");
    let root = Tube { parent: None, ends_m: [end_m(), hub_m], radii_m: [1e-3; 2] };
    let branch = |end_m| Tube { parent: Some(0), ends_m: [hub_m, end_m], radii_m: [8e-4, 5e-4] };
    vec![root, branch(end_m()), branch(end_m()), branch(end_m())]
}

pub(super) struct Patient<'a> {
    pub(super) name: &'a str,
    pub(super) seed: u64,
    pub(super) world: World,
    attached: Attached,
    materials: [LinearElastic; 3],
    relaxation: PronySeries,
    /// Of everything live, as the model has it on its free nodes [kg].
    mass_kg: f64,
    pub(super) mean_edge_m: f64,
    pub(super) away: [ToolInput; MAX_TOOLS],
    pub(super) random: SeededRandom,
    /// Nodes of tetrahedra that edits changed since a stroke began.
    touched: Vec<NodeId>,
    /// Ends of the edges that were too short to be divided when strokes ended.
    left: Vec<[NodeId; 2]>,
    /// Whether an edge of a tool was lifted since its stroke began, for want of tissue, and what that parted was taken back.
    pub(super) is_parting_taken_back: bool,
    pub(super) tally: Tally,
}

/// What a check needs from before an edit.
pub(super) struct Before {
    volume_m3: f64,
    rest_m: Vec<DVec3>,
    memory: Memory,
    attached: Attached,
    mass_kg: f64,
}

/// How the volume may change.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Volume {
    /// Less by this [m3].
    Removed(f64),
    Kept,
    /// Less by what so many tetrahedra without descendants had; so many changes before took none.
    Taken {
        n_tets: usize,
        n_changes_before: usize,
    },
}

impl<'a> Patient<'a> {
    pub(super) fn new(name: &'a str, mesh: &TetMesh, seed: u64) -> Self {
        let mut random = SeededRandom::new(seed);
        let bounds = Aabb::of_points(&mesh.positions_m);
        let middle_m = 0.5 * (bounds.min_m + bounds.max_m);
        let away = ToolInput::at(bounds.min_m - DVec3::splat(0.3), -DVec3::Y);
        let mean_edge_m = {
            let topology = Topology::build(mesh).unwrap();
            let lengths = topology.live_edges().map(|e| {
                let [a, b] = topology.edge_nodes(e).map(|n| mesh.positions_m[n.index()]);
                a.distance(b)
            });
            lengths.sum::<f64>() / topology.live_counts().edges as f64
        };
        let [grasper, others @ ..] = super::tools::tools(seed, mean_edge_m, away);
        let mut spec = WorldSpec::new(name, TIME_STEP_S, grasper);
        spec.tools.extend(others);
        let furthest = |direction: DVec3, fraction: f64| Region::Furthest { direction, fraction };
        spec.supports.push(Support::all_axes(furthest(DVec3::Y, 0.15)));
        let load = |direction: DVec3, time: LoadTime| Load {
            region: furthest(direction, 0.2),
            force_n: LOAD_N * DVec3::new(0.3, -0.5, 0.8),
            time,
        };
        spec.loads.push(load(DVec3::X, LoadTime::Always));
        spec.loads.push(load(-DVec3::Z, LoadTime::During { from_s: 0.05, to_s: 0.3 }));
        spec.ligaments.push(Ligament {
            region: furthest(-DVec3::Y, 0.05),
            direction: -DVec3::Y,
            length_m: 0.05,
            stiffness_n_per_m: 20.0,
        });
        spec.vessels = tubes(mesh, middle_m, &mut random);
        spec.tearing = Some(Tearing { energy: BRITTLE, material: materials()[0] });
        spec.mends_cuts = seed.is_multiple_of(2);

        let number_of = |t: usize| {
            let place_m = mesh.corners_m(TetId::from_index(t)).into_iter().sum::<DVec3>() / 4.0;
            u8::from(place_m.x > middle_m.x) + u8::from(place_m.z > middle_m.z)
        };
        let material: Vec<u8> = (0..mesh.tetrahedra.len()).map(number_of).collect();
        let (materials, relaxation) = (materials(), relaxation());
        let fixed = fixed_nodes(&spec.supports, &mesh.positions_m);
        let ligaments = attachments(&spec.ligaments, &mesh.positions_m);
        let of_tets: Vec<LinearElastic> = material.iter().map(|&m| materials[usize::from(m)]).collect();
        let substance = Substance { of_tets: &of_tets, relaxation: &relaxation };
        let model = substance.model(mesh, &fixed, &ligaments);
        let mut world = World::new(spec, mesh.clone(), model, ModelKind::Explicit).unwrap();
        world.set_undo_depth(UNDO_DEPTH);
        world.keep_changes();
        let attached = Attached::new(&world, material, ligaments);
        let mass_kg = mesh.volume_m3() * DENSITY_KG_PER_M3;
        Self {
            name,
            seed,
            world,
            attached,
            materials,
            relaxation,
            mass_kg,
            mean_edge_m,
            away: [away; MAX_TOOLS],
            random,
            touched: Vec::new(),
            left: Vec::new(),
            is_parting_taken_back: false,
            tally: Tally::default(),
        }
    }

    pub(super) fn label(&self) -> String {
        format!("{}, seed {}, edit {}", self.name, self.seed, self.tally.edits())
    }

    pub(super) fn step(&mut self, tools: &[ToolInput; MAX_TOOLS], placed: bool) {
        let input = StepInput::of(tools);
        let number = self.world.steps_made();
        let report = self.world.step(&if placed { input.placed() } else { input });
        assert_eq!(report.n_non_finite_nodes, 0, "{}", self.label());
        let is_finite = report.tools.iter().all(|tool| tool.force_on_tool_n.is_finite());
        assert!(is_finite, "{}", self.label());
        self.attached.check_loads(&self.world, number, &self.label());
    }

    pub(super) fn index(&mut self, n: usize) -> usize {
        ((self.random.uniform() * n as f64) as usize).min(n - 1)
    }

    /// A place on the surface now, with its outward normal; none when nothing is left.
    pub(super) fn place(&mut self) -> Option<(DVec3, DVec3)> {
        let n = self.world.organ().surface_nodes().len();
        if n == 0 {
            return None;
        }
        let at = self.index(n);
        let organ = self.world.organ();
        let node = organ.surface_nodes()[at];
        let positions_m = self.world.state().positions_m;
        let normal = organ.body().topology().node_normal(node, positions_m);
        Some((positions_m[node.index()], normal.try_normalize()?))
    }

    /// A way along a surface with this normal.
    pub(super) fn way_along(&mut self, normal: DVec3) -> DVec3 {
        loop {
            let any = DVec3::new(self.random.normal(), self.random.normal(), self.random.normal());
            if let Some(along) = (any - normal * any.dot(normal)).try_normalize() {
                return along;
            }
        }
    }

    pub(super) fn volume_m3(&self) -> f64 {
        self.world.organ().body().volume_m3()
    }

    pub(super) fn before(&self) -> Before {
        Before {
            volume_m3: self.volume_m3(),
            rest_m: self.world.organ().mesh().positions_m.clone(),
            memory: Memory::of(&self.world),
            attached: self.attached.clone(),
            mass_kg: self.mass_kg,
        }
    }

    /// As if what came since had not been: it was taken back.
    pub(super) fn go_back_to(&mut self, before: Before) {
        self.attached = before.attached;
        self.mass_kg = before.mass_kg;
    }

    /// Whether everything attached is as it has to be.
    pub(super) fn check_attached(&mut self, label: &str) {
        self.attached.check(&self.world, label);
        self.check_forces_and_masses(self.mass_kg);
    }

    /// Checks everything that an edit, or the few of one call of the tools, must not break.
    pub(super) fn check(
        &mut self,
        before: &Before,
        volume: Volume,
        changes: &[TopologyChange],
        is_mended: bool,
    ) {
        let label = self.label();
        let body = self.world.organ().body();
        let topology = body.topology();
        for tet in topology.live_tets() {
            assert!(body.mesh().tet_volume_m3(tet) > 0.0, "{label}: {tet} is turned inside out");
        }
        let now_m3 = self.volume_m3();
        let removed_m3 = match volume {
            Volume::Removed(removed_m3) => removed_m3,
            Volume::Kept => 0.0,
            Volume::Taken { n_tets, n_changes_before } => {
                let taken: Vec<TetId> =
                    changes[n_changes_before..].iter().flat_map(without_descendants).collect();
                assert_eq!(taken.len(), n_tets, "{label}: tetrahedra that were taken out");
                taken.into_iter().map(|t| body.mesh().tet_volume_m3(t)).sum()
            }
        };
        let expected_m3 = before.volume_m3 - removed_m3;
        assert!(
            (now_m3 - expected_m3).abs() <= 1e-9 * before.volume_m3,
            "{label}: {now_m3} for {expected_m3} m3"
        );
        for change in changes {
            self.attached.follow(&self.world, change, is_mended);
        }
        for change in changes {
            self.attached.check_skin(&self.world, change, &label);
        }
        self.attached.check(&self.world, &label);
        if let [change] = changes {
            // What an edge that is pulled together leaves lies where others were.
            if !is_mended {
                check_parents(&before.rest_m, body, change, &label);
            }
            before.memory.check(&self.world, change, &label);
        }
        self.touched.extend(changes.iter().flat_map(|change| topology.nodes_near(change)));
        let last = changes.last().expect("something changed");
        let n_nodes = topology.n_nodes();
        assert_eq!(self.world.state().positions_m.len(), n_nodes, "{label}");
        assert_eq!(self.world.organ().live_tetrahedra().len(), topology.n_tets(), "{label}");
        assert_eq!((last.nodes.n_after, last.tets.n_after), (n_nodes, topology.n_tets()), "{label}");
        if topology.live_counts().tets == 0 {
            self.mass_kg = 0.0;
            return;
        }
        check_adjacency(&self.world, &label);
        let new =
            changes.iter().flat_map(|change| change.tets.added.ids().iter().chain(&change.reshaped_tets));
        let new_dihedral = new
            .filter(|t| topology.is_live_tet(**t))
            .map(|&t| {
                let [_, largest_cosine] =
                    glisson::mesh::quality::dihedral_cosine_range(body.mesh().corners_m(t));
                largest_cosine.clamp(-1.0, 1.0).acos().to_degrees()
            })
            .fold(180.0, f64::min);
        self.tally.worst_dihedral_deg = self.tally.worst_dihedral_deg.min(new_dihedral);
        self.check_forces_and_masses(before.mass_kg - removed_m3 * DENSITY_KG_PER_M3);
    }

    /// The model's forces and masses at all free nodes against a plain loop over the tetrahedra, and the sum of the masses.
    fn check_forces_and_masses(&mut self, expected_kg: f64) {
        let label = self.label();
        let body = self.world.organ().body();
        let plain = |now_m: &[DVec3]| {
            let (forces_n, masses_kg) = self.attached.plain_forces(body, now_m, &self.materials);
            let at_rest_n = self.attached.ligaments_n(&body.mesh().positions_m);
            let live = || body.topology().live_nodes().map(NodeId::index);
            let is_fixed: Vec<bool> = live().map(|n| self.attached.is_fixed[n]).collect();
            let of_free = |all_n: &[DVec3]| {
                let of_node = |(n, is_fixed): (usize, &bool)| if *is_fixed { DVec3::ZERO } else { all_n[n] };
                live().zip(&is_fixed).map(of_node).collect::<Vec<_>>()
            };
            let (forces_n, at_rest_n) = (of_free(&forces_n), of_free(&at_rest_n));
            Plain { forces_n, at_rest_n, masses_kg: live().map(|n| masses_kg[n]).collect(), is_fixed }
        };
        let model = self.world.copy_of_model();
        let (found, mass_kg) = against_plain(body, model, plain, &label);
        assert!(found.forces < 1e-9 && found.weights < 1e-9, "{label}: {found:?}");
        assert!(
            (mass_kg - expected_kg).abs() <= 1e-9 * expected_kg,
            "{label}: {mass_kg} for {expected_kg} kg"
        );
        self.mass_kg = mass_kg;
        self.tally.worst_forces = self.tally.worst_forces.max(found.forces);
        self.tally.worst_weights = self.tally.worst_weights.max(found.weights);
    }

    /// One edit or several as one, checked; answers whether it was done.
    pub(super) fn edit(&mut self, edits: &[MeshEdit], volume: Volume) -> bool {
        let before = self.before();
        let hash = self.world.state_hash();
        let done = match edits {
            [edit] => self.world.edit(edit),
            edits => self.world.edit_all(edits),
        };
        match done {
            Ok(change) => {
                let is_mended = edits.iter().any(|edit| matches!(edit, MeshEdit::Collapse { .. }));
                self.check(&before, volume, std::slice::from_ref(&change), is_mended);
                // Now and then back again, bit for bit, and once more.
                if self.random.uniform() < 0.1 {
                    let after = self.world.state_hash();
                    assert!(self.world.undo_edit(), "{}: cannot be undone", self.label());
                    assert_eq!(self.world.state_hash(), hash, "{}: undone", self.label());
                    assert_eq!(self.volume_m3().to_bits(), before.volume_m3.to_bits(), "{}", self.label());
                    let again = match edits {
                        [edit] => self.world.edit(edit),
                        edits => self.world.edit_all(edits),
                    };
                    let again = again.unwrap_or_else(|e| panic!("{}: once more: {e}", self.label()));
                    assert_eq!(again, change, "{}", self.label());
                    assert_eq!(self.world.state_hash(), after, "{}: once more", self.label());
                    self.tally.undone += 1;
                }
                for _ in 0..STEPS_AFTER {
                    self.step(&self.away.clone(), true);
                }
                true
            }
            Err(_) => {
                assert_eq!(self.world.state_hash(), hash, "{}: refused, so unchanged", self.label());
                self.tally.refused += 1;
                false
            }
        }
    }

    /// Takes out tetrahedra and parts what then hangs together by a node or an edge alone; answers whether it was done.
    fn take_out(&mut self, tets: Vec<TetId>) -> bool {
        let mut copy = self.world.organ().body().clone();
        let removed_m3 = tets.iter().map(|&t| copy.mesh().tet_volume_m3(t)).sum();
        let edits = copy.parting_removal(tets).unwrap_or_else(|e| panic!("{}: {e}", self.label()));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        let before = singular_places(&copy);
        let done = self.edit(&edits, Volume::Removed(removed_m3));
        if done {
            self.tally.partings += u64::from(edits.len() > 1);
            let after = singular_places(self.world.organ().body());
            // Where two cuts meet there may be an edge of this kind from before.
            assert!(
                after.nodes.len() <= before.nodes.len() && after.edges.len() <= before.edges.len(),
                "{}: singular places left: {after:?}",
                self.label()
            );
        }
        done
    }

    /// Takes out some tetrahedra around a place.
    fn remove(&mut self) {
        let Some((place_m, _)) = self.place() else { return };
        let reach_m = self.mean_edge_m * self.random.uniform_in(0.3, 1.2);
        let body = self.world.organ().body();
        let positions_m = self.world.state().positions_m;
        let tets: Vec<TetId> = body
            .topology()
            .live_tets()
            .filter(|&t| {
                let corners = body.topology().tet_nodes(t).map(|n| positions_m[n.index()]);
                (corners.into_iter().sum::<DVec3>() / 4.0).distance(place_m) < reach_m
            })
            .collect();
        if tets.is_empty() {
            return;
        }
        if self.take_out(tets) {
            self.tally.removals += 1;
        }
    }

    /// Makes the mesh finer around a place.
    fn refine(&mut self) {
        let n = self.world.organ().surface_nodes().len();
        if n == 0 {
            return;
        }
        let at = self.index(n);
        let mut copy = self.world.organ().body().clone();
        let center_m = copy.mesh().positions_m[self.world.organ().surface_nodes()[at].index()];
        let (radius_m, edge_m) =
            (1.5 * self.mean_edge_m, self.mean_edge_m * self.random.uniform_in(0.6, 1.0));
        let region = FineRegion { center_m, radius_m, edge_m };
        let edits = refining(&mut copy, &region).unwrap_or_else(|e| panic!("{}: {e}", self.label()));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        if !edits.is_empty() && self.edit(&edits, Volume::Kept) {
            self.tally.refinements += 1;
        }
    }

    /// A blade's ends along a random stroke through the surface.
    pub(super) fn stroke(&mut self) -> Option<Vec<[DVec3; 2]>> {
        let (place_m, normal) = self.place()?;
        let along = self.way_along(normal);
        let depth_m = self.mean_edge_m * self.random.uniform_in(0.5, 3.0);
        let length_m = self.mean_edge_m * self.random.uniform_in(1.0, 6.0);
        let n = (length_m / (0.8 * self.mean_edge_m)).ceil() as u32;
        let lean = normal + along * self.random.uniform_in(-0.5, 0.5);
        Some(
            (0..=n)
                .map(|i| {
                    let at_m = place_m + along * (length_m * (f64::from(i) / f64::from(n) - 0.5));
                    [at_m - lean * depth_m, at_m + lean * 2.0 * self.mean_edge_m]
                })
                .collect(),
        )
    }

    /// Cuts by subdivision.
    fn blade(&mut self) {
        let Some(stroke) = self.stroke() else { return };
        self.tally.blade_strokes += 1;
        self.touched.clear();
        let mut cut = SubdivisionCut::new(SubdivisionParams::for_mean_edge(self.mean_edge_m));
        let last = stroke.len() - 1;
        for (i, &blade_m) in stroke.iter().enumerate() {
            let body = self.world.organ().body();
            let positions_m = self.world.state().positions_m;
            let nodes = (0..positions_m.len()).map(NodeId::from_index);
            cut.hold_still(nodes.map(|n| self.attached.is_anchored(n)));
            let step = if i == last {
                cut.finish(body, positions_m, blade_m)
            } else {
                cut.advance(body, positions_m, blade_m)
            };
            match step {
                Ok(Some(replacement)) => {
                    if self.edit(&[MeshEdit::Replace(replacement)], Volume::Kept) {
                        self.tally.blade_edits += 1;
                    } else {
                        cut.take_back();
                    }
                }
                Ok(None) => {}
                Err(_) => self.tally.refused += 1,
            }
        }
        self.finish_stroke();
    }

    /// Cuts by vertex displacement.
    fn scalpel(&mut self) {
        let Some(stroke) = self.stroke() else { return };
        self.tally.scalpel_strokes += 1;
        self.touched.clear();
        self.displace_along(&stroke);
        self.finish_stroke();
    }

    fn displace_along(&mut self, stroke: &[[DVec3; 2]]) {
        let mut cut = ScalpelCut::new(ScalpelParams::default());
        for i in 0..=stroke.len() {
            loop {
                let body = self.world.organ().body();
                let positions_m = self.world.state().positions_m;
                let step = match stroke.get(i) {
                    Some(&blade_m) => cut.advance(body, positions_m, blade_m),
                    None => cut.finish(body, positions_m),
                };
                match step {
                    Ok(Some(edits)) if edits.is_empty() => {}
                    Ok(Some(edits)) => {
                        if !self.edit(&edits, Volume::Kept) {
                            return;
                        }
                        self.tally.scalpel_edits += 1;
                    }
                    Ok(None) => break,
                    Err(_) => {
                        self.tally.refused += 1;
                        return;
                    }
                }
            }
        }
    }

    /// What the world does when an edge is lifted: parts what hangs together by a node or an edge alone, and mends the worst
    /// tetrahedra near the cut.
    fn finish_stroke(&mut self) {
        let mut copy = self.world.organ().body().clone();
        let touched: Vec<NodeId> = std::mem::take(&mut self.touched);
        let live = |body: &EditableMesh, nodes: &[NodeId]| {
            let mut nodes: Vec<NodeId> =
                nodes.iter().copied().filter(|&n| body.topology().is_live_node(n)).collect();
            nodes.sort_unstable();
            nodes.dedup();
            nodes
        };
        let edits = copy.parting_edits(live(&copy, &touched));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        if !edits.is_empty() && self.edit(&edits, Volume::Kept) {
            self.tally.stroke_partings += 1;
        }
        self.check_singular();
        let mut copy = self.world.organ().body().clone();
        let topology = copy.topology();
        let near = live(&copy, &touched);
        let tets: Vec<TetId> = near.iter().flat_map(|&n| topology.node_tets(n)).copied().collect();
        let mending = mending(&mut copy, &tets, &MendParams::default(), &|n| self.attached.is_anchored(n));
        assert!(copy == *self.world.organ().body(), "{}: a plan changed the mesh", self.label());
        self.tally.bad_tets += mending.n_bad as u64;
        if !mending.edits.is_empty() && self.edit(&mending.edits, Volume::Kept) {
            self.tally.mendings += 1;
            self.tally.mended_places += (mending.n_remeshed + mending.n_collapsed) as u64;
        }
        self.check_singular();
    }

    /// The same at all places that hang together by a node or an edge alone.
    pub(super) fn finish_stroke_at_singular_places(&mut self) {
        let body = self.world.organ().body();
        let places = singular_places(body);
        let ends = places.edges.iter().flat_map(|&edge| body.topology().edge_nodes(edge));
        self.touched = places.nodes.iter().copied().chain(ends).collect();
        self.finish_stroke();
    }

    /// At the end of a stroke nothing hangs together by a node or an edge alone, but for edges too short to be divided, which
    /// are counted.
    pub(super) fn check_singular(&mut self) {
        let left = singular_places(self.world.organ().body());
        if left.is_empty() {
            self.left.clear();
            return;
        }
        let mut copy = self.world.organ().body().clone();
        let edge_nodes = |edge| copy.topology().edge_nodes(edge);
        let (known, new): (Vec<_>, Vec<_>) =
            left.edges.iter().map(|&edge| edge_nodes(edge)).partition(|nodes| self.left.contains(nodes));
        self.tally.singular_left += new.len() as u64;
        // Not the known ones: what was too short at an earlier stroke may have been mended since, and no stroke came by it.
        let places: Vec<NodeId> = left.nodes.iter().copied().chain(new.iter().flatten().copied()).collect();
        let edits = copy.parting_edits(places);
        assert!(edits.is_empty(), "{}: singular places left: {left:?}", self.label());
        self.left = [known, new].concat();
    }

    /// The model that went through all edits against one made afresh from the edited mesh.
    fn compare(&mut self) {
        let body = self.world.organ().body();
        let topology = body.topology();
        if topology.live_counts().tets == 0 {
            return;
        }
        let live: Vec<NodeId> = topology.live_nodes().collect();
        let fixed: Vec<FixedNode> = live
            .iter()
            .enumerate()
            .filter(|(_, node)| self.world.organ().is_fixed(**node))
            .map(|(new, _)| FixedNode::all_axes(NodeId::from_index(new)))
            .collect();
        let renumbered = |a: &Attachment| {
            let new = live.binary_search(&a.node).ok()?;
            Some(Attachment { node: NodeId::from_index(new), ..*a })
        };
        let ligaments: Vec<Attachment> = self.attached.ligaments.iter().filter_map(renumbered).collect();
        let of_tets: Vec<LinearElastic> = topology
            .live_tets()
            .map(|t| self.materials[usize::from(self.attached.material[t.index()])])
            .collect();
        let substance = Substance { of_tets: &of_tets, relaxation: &self.relaxation };
        let fresh = substance.model_for_forces(&body.live_mesh(), &fixed, &ligaments);
        let label = self.label();
        let (now_m, n_put_back) = within_measure(body, self.world.state().positions_m);
        let found = difference(body, &now_m, self.world.copy_of_model(), fresh, &label);
        assert!(found.forces < 1e-9 && found.weights < 1e-9, "{label}: {found:?}");
        self.tally.worst_forces = self.tally.worst_forces.max(found.forces);
        self.tally.worst_weights = self.tally.worst_weights.max(found.weights);
        self.tally.comparisons += 1;
        self.tally.put_back += n_put_back as u64;
    }

    pub(super) fn run(mut self, most_edits: u64) -> Tally {
        let (mut n_tries, mut compared) = (0, 0);
        while self.tally.edits() < most_edits && n_tries < 10 * most_edits {
            n_tries += 1;
            match self.index(24) {
                0..=7 => self.remove(),
                8..=12 => self.blade(),
                13..=16 => self.scalpel(),
                17 => self.refine(),
                18 => self.grasp(),
                19..=20 => self.burn(),
                21..=22 => self.snip(),
                _ => self.incise(),
            }
            if self.tally.edits() >= compared + COMPARED_EVERY {
                compared = self.tally.edits();
                self.compare();
            }
        }
        self.compare();
        self.tally
    }
}

/// Tetrahedra that a change took out without anything in their place.
fn without_descendants(change: &TopologyChange) -> impl Iterator<Item = TetId> + '_ {
    let parents: std::collections::BTreeSet<TetId> =
        change.tets.added.iter().flat_map(|(_, parents)| parents.iter().map(|p| p.0)).collect();
    change.tets.removed.iter().copied().filter(move |t| !parents.contains(t))
}

fn singular_places(body: &EditableMesh) -> SingularEntities {
    let topology = body.topology();
    topology.singular_entities(&topology.live_nodes().collect::<Vec<_>>())
}

/// What models are made from.
struct Substance<'a> {
    of_tets: &'a [LinearElastic],
    relaxation: &'a PronySeries,
}

impl Substance<'_> {
    fn params<'b>(&'b self, body: DynamicBody<'b>) -> ExplicitKernelParams<'b> {
        let relaxation = Some(self.relaxation);
        ExplicitKernelParams { relaxation, ..ExplicitKernelParams::new(body, LAW, self.of_tets) }
    }

    fn model(
        &self,
        mesh: &TetMesh,
        fixed: &[FixedNode],
        ligaments: &[Attachment],
    ) -> Box<dyn DeformableModel> {
        let body = DynamicBody { fixed, attachments: ligaments, ..DynamicBody::new(mesh, DENSITY_KG_PER_M3) };
        let step_s = ExplicitKernel::stable_step(&self.params(body)).unwrap().step_s;
        let body = DynamicBody { time_step_s: TIME_STEP_S.min(step_s), ..body };
        Box::new(ExplicitKernel::build(&self.params(body)).unwrap())
    }

    /// A model for forces alone: its step may be as short as a sliver asks for.
    fn model_for_forces(
        &self,
        mesh: &TetMesh,
        fixed: &[FixedNode],
        ligaments: &[Attachment],
    ) -> Box<dyn DeformableModel> {
        let body = DynamicBody::new(mesh, DENSITY_KG_PER_M3);
        let body = DynamicBody { fixed, attachments: ligaments, time_step_s: AT_ONCE_S, ..body };
        Box::new(ExplicitKernel::build(&self.params(body)).unwrap())
    }
}
