//! Random cuts, removals, scalpel and blade strokes, grasps and tears on real bodies: nothing panics, every number stays
//! finite, every invariant holds after each edit, and a model that went through them equals one made afresh.
//! `cargo xtask test` runs a bounded share; `cargo xtask soak edits` sets GLISSON_SOAK_EDITS and GLISSON_SOAK_EDITS_REPORT.
//! With GLISSON_SOAK_EDITS_LOG the seeds that ended are kept in that file, and a run that was stopped goes on after them.

mod checks;
mod tally;

use self::checks::{AT_ONCE_S, check_adjacency, difference};
use self::tally::{Results, SeedResult, Tally};
use super::{glisson, real_ct};
use glisson::material::LinearElastic;
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit, TopologyChange};
use glisson::mesh::files::read_mesh;
use glisson::mesh::generate::{MeshParams, WantedSize, generate};
use glisson::mesh::refine::{FineRegion, refining};
use glisson::mesh::topology::{SingularEntities, Topology};
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::model::explicit_kernel::{ExplicitKernel, ExplicitKernelParams};
use glisson::model::kernel::KernelLaw;
use glisson::model::kind::ModelKind;
use glisson::model::{DeformableModel, DynamicBody, FixedNode};
use glisson::surface::TriMesh;
use glisson::tool::cut::scalpel::{ScalpelCut, ScalpelParams};
use glisson::tool::cut::subdivision::{SubdivisionCut, SubdivisionParams};
use glisson::tool::fracture::FractureEnergy;
use glisson::tool::{Grip, Jaws, Tool, ToolInput, ToolKind, ToolShape};
use glisson::world::spec::{Region, Support, WorldSpec, fixed_nodes};
use glisson::world::{StepInput, World};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

const DEFAULT_EDITS: u64 = 1_600;
/// Edits of one seed at most: a body that was cut more often is crumbs.
const EDITS_OF_SEED: u64 = 500;
const LAW: KernelLaw = KernelLaw::StableNeoHooke;
const TIME_STEP_S: f64 = 4e-4;
/// Steps after an edit.
const STEPS_AFTER: u64 = 3;
/// Edits between two comparisons with a fresh model.
const COMPARED_EVERY: u64 = 50;
/// Soft, so that pulling tears within reach of the jaws: a choice of the test, a tenth of liver's.
const BRITTLE: FractureEnergy = FractureEnergy { energy_j_per_m2: 16.0 };

/// A rod of 60 mm along z, 40 mm across.
fn cylinder() -> TetMesh {
    let (n_around, n_along, radius_m, height_m) = (48_u32, 12_u32, 0.02, 0.06);
    let mut surface = TriMesh { positions_m: Vec::new(), triangles: Vec::new() };
    for k in 0..=n_along {
        for i in 0..n_around {
            let (sine, cosine) = (f64::from(i) / f64::from(n_around) * std::f64::consts::TAU).sin_cos();
            let z_m = height_m * f64::from(k) / f64::from(n_along);
            surface.positions_m.push(DVec3::new(radius_m * cosine, radius_m * sine, z_m));
        }
    }
    let at = |i: u32, k: u32| k * n_around + i % n_around;
    for k in 0..n_along {
        for i in 0..n_around {
            surface.triangles.push([at(i, k), at(i + 1, k), at(i + 1, k + 1)]);
            surface.triangles.push([at(i, k), at(i + 1, k + 1), at(i, k + 1)]);
        }
    }
    let bottom = surface.positions_m.len() as u32;
    surface.positions_m.extend([DVec3::ZERO, DVec3::Z * height_m]);
    for i in 0..n_around {
        surface.triangles.push([bottom, at(i + 1, 0), at(i, 0)]);
        surface.triangles.push([bottom + 1, at(i, n_along), at(i + 1, n_along)]);
    }
    let params = MeshParams { size: WantedSize::Tetrahedra(6000), volume_m3: None };
    generate(&surface, &params).unwrap().0
}

fn grasper(home: ToolInput) -> Tool {
    Tool {
        kind: ToolKind::Grasper(Jaws {
            length_m: 0.02,
            width_m: 6e-3,
            greatest_opening_rad: 1.0,
            closing_force_n: 20.0,
        }),
        shape: ToolShape::Capsules,
        grip: Grip { friction_coefficient: 1.0, is_sticky: true },
        ..Tool::probe("grasper", 3e-3, home)
    }
}

struct Patient<'a> {
    name: &'a str,
    seed: u64,
    world: World,
    material: LinearElastic,
    mean_edge_m: f64,
    away: ToolInput,
    random: SeededRandom,
    tally: Tally,
}

/// How the volume may change in an edit.
#[derive(Clone, Copy, PartialEq)]
enum Volume {
    Removed(f64),
    Kept,
}

impl<'a> Patient<'a> {
    fn new(name: &'a str, mesh: &TetMesh, seed: u64) -> Self {
        let bounds = Aabb::of_points(&mesh.positions_m);
        let support = Support::all_axes(Region::Furthest { direction: DVec3::Y, fraction: 0.15 });
        let away = ToolInput::at(bounds.min_m - DVec3::splat(0.3), -DVec3::Y);
        let mut spec = WorldSpec::new(name, TIME_STEP_S, grasper(away));
        spec.supports.push(support);
        let material = LinearElastic::from_young_poisson(4100.0, 0.45, 1060.0).unwrap();
        let fixed = fixed_nodes(&spec.supports, &mesh.positions_m);
        let model = model_of(mesh, &fixed, &material);
        let mean_edge_m = {
            let topology = Topology::build(mesh).unwrap();
            let lengths = topology.live_edges().map(|e| {
                let [a, b] = topology.edge_nodes(e).map(|n| mesh.positions_m[n.index()]);
                a.distance(b)
            });
            lengths.sum::<f64>() / topology.live_counts().edges as f64
        };
        let world = World::new(spec, mesh.clone(), model, ModelKind::Explicit).unwrap();
        let random = SeededRandom::new(seed);
        Self { name, seed, world, material, mean_edge_m, away, random, tally: Tally::default() }
    }

    fn label(&self) -> String {
        format!("{}, seed {}, edit {}", self.name, self.seed, self.tally.edits())
    }

    fn step(&mut self, tool: ToolInput, placed: bool) {
        let input = StepInput::of(&[tool]);
        let report = self.world.step(&if placed { input.placed() } else { input });
        assert_eq!(report.n_non_finite_nodes, 0, "{}", self.label());
        assert!(report.tools[0].force_on_tool_n.is_finite(), "{}", self.label());
    }

    fn index(&mut self, n: usize) -> usize {
        ((self.random.uniform() * n as f64) as usize).min(n - 1)
    }

    /// A place on the surface now, with its outward normal; none when nothing is left.
    fn place(&mut self) -> Option<(DVec3, DVec3)> {
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

    fn volume_m3(&self) -> f64 {
        self.world.organ().body().volume_m3()
    }

    /// Checks everything that an edit must not break.
    fn check(&mut self, before_m3: f64, volume: Volume, change: &TopologyChange) {
        let label = self.label();
        let body = self.world.organ().body();
        let topology = body.topology();
        for tet in topology.live_tets() {
            assert!(body.mesh().tet_volume_m3(tet) > 0.0, "{label}: {tet} is turned inside out");
        }
        let now_m3 = self.volume_m3();
        let (expected_m3, tolerance) = match volume {
            Volume::Removed(removed_m3) => (before_m3 - removed_m3, 1e-9),
            Volume::Kept => (before_m3, 1e-9),
        };
        assert!(
            (now_m3 - expected_m3).abs() <= tolerance * before_m3,
            "{label}: {now_m3} for {expected_m3} m3"
        );
        let n_nodes = topology.n_nodes();
        assert_eq!(self.world.state().positions_m.len(), n_nodes, "{label}");
        assert_eq!(self.world.organ().live_tetrahedra().len(), topology.n_tets(), "{label}");
        assert_eq!((change.nodes.n_after, change.tets.n_after), (n_nodes, topology.n_tets()), "{label}");
        if topology.live_counts().tets == 0 {
            return;
        }
        check_adjacency(&self.world, &label);
        let new_dihedral = change
            .tets
            .added
            .ids()
            .iter()
            .filter(|t| topology.is_live_tet(**t))
            .map(|&t| {
                let [_, largest_cosine] =
                    glisson::mesh::quality::dihedral_cosine_range(body.mesh().corners_m(t));
                largest_cosine.clamp(-1.0, 1.0).acos().to_degrees()
            })
            .fold(180.0, f64::min);
        self.tally.worst_dihedral_deg = self.tally.worst_dihedral_deg.min(new_dihedral);
    }

    /// One edit or several as one, checked; answers whether it was done.
    fn edit(&mut self, edits: &[MeshEdit], volume: Volume) -> bool {
        let before_m3 = self.volume_m3();
        let hash = self.world.state_hash();
        let done = match edits {
            [edit] => self.world.edit(edit),
            edits => self.world.edit_all(edits),
        };
        match done {
            Ok(change) => {
                self.check(before_m3, volume, &change);
                // Now and then back again, bit for bit, and once more.
                if self.random.uniform() < 0.1 {
                    let after = self.world.state_hash();
                    assert!(self.world.undo_edit(), "{}: cannot be undone", self.label());
                    assert_eq!(self.world.state_hash(), hash, "{}: undone", self.label());
                    assert_eq!(self.volume_m3().to_bits(), before_m3.to_bits(), "{}", self.label());
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
                    self.step(self.away, true);
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
    fn stroke(&mut self) -> Option<Vec<[DVec3; 2]>> {
        let (place_m, normal) = self.place()?;
        let along = loop {
            let any = DVec3::new(self.random.normal(), self.random.normal(), self.random.normal());
            if let Some(along) = (any - normal * any.dot(normal)).try_normalize() {
                break along;
            }
        };
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
        let mut cut = SubdivisionCut::new(SubdivisionParams::for_mean_edge(self.mean_edge_m));
        let last = stroke.len() - 1;
        for (i, &blade_m) in stroke.iter().enumerate() {
            let body = self.world.organ().body();
            let positions_m = self.world.state().positions_m;
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
    }

    /// Cuts by vertex displacement.
    fn scalpel(&mut self) {
        let Some(stroke) = self.stroke() else { return };
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

    /// Grasps, pulls, tears what is stretched too far, lets go.
    fn grasp(&mut self) {
        let Some((place_m, normal)) = self.place() else { return };
        let at = |out_m: f64, jaw_opening: f64| ToolInput {
            jaw_opening,
            ..ToolInput::at(place_m + normal * out_m, normal)
        };
        self.step(at(0.02, 1.0), true);
        let mut held = 0;
        for k in 0..10 {
            let share = f64::from(k) / 9.0;
            self.step(at(0.02 * (1.0 - share) - 3e-3 * share, 1.0), false);
        }
        for k in 0..8 {
            self.step(at(-3e-3, 1.0 - f64::from(k) / 7.0), false);
        }
        let pull_m = 0.03 * self.random.uniform();
        for k in 0..20 {
            self.step(at(-3e-3 + pull_m * f64::from(k) / 19.0, 0.0), false);
            held = held.max(self.world.report().tools[0].n_held_nodes);
            if k % 5 == 4 {
                self.tear();
            }
        }
        self.step(at(pull_m, 1.0), false);
        self.tally.grasps += 1;
        self.tally.held += u64::from(held > 0);
        for _ in 0..3 {
            self.step(self.away, true);
        }
    }

    fn tear(&mut self) {
        let body = self.world.organ().body();
        let positions_m = self.world.state().positions_m;
        let topology = body.topology();
        let torn: Vec<TetId> = topology
            .live_tets()
            .filter(|&t| {
                let now_m = topology.tet_nodes(t).map(|n| positions_m[n.index()]);
                BRITTLE.tears(&self.material, body.mesh().corners_m(t), now_m)
            })
            .take(8)
            .collect();
        if torn.is_empty() {
            return;
        }
        if self.take_out(torn) {
            self.tally.tears += 1;
        }
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
        let fresh = fresh_model(&body.live_mesh(), &fixed, &self.material);
        let (now_m, label) = (self.world.state().positions_m, self.label());
        let found = difference(body, now_m, self.world.copy_of_model(), fresh, &label);
        assert!(found.forces < 1e-9 && found.weights < 1e-9, "{label}: {found:?}");
        self.tally.worst_forces = self.tally.worst_forces.max(found.forces);
        self.tally.worst_weights = self.tally.worst_weights.max(found.weights);
        self.tally.comparisons += 1;
    }

    fn run(mut self, most_edits: u64) -> Tally {
        let (mut n_tries, mut compared) = (0, 0);
        while self.tally.edits() < most_edits && n_tries < 10 * most_edits {
            n_tries += 1;
            match self.index(20) {
                0..=7 => self.remove(),
                8..=13 => self.blade(),
                14..=17 => self.scalpel(),
                18 => self.refine(),
                _ => self.grasp(),
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

fn singular_places(body: &EditableMesh) -> SingularEntities {
    let topology = body.topology();
    topology.singular_entities(&topology.live_nodes().collect::<Vec<_>>())
}

fn model_of(mesh: &TetMesh, fixed: &[FixedNode], material: &LinearElastic) -> Box<dyn DeformableModel> {
    let materials = &[*material];
    let body = DynamicBody { fixed, ..DynamicBody::new(mesh, material.density_kg_per_m3()) };
    let params = ExplicitKernelParams::new(body, LAW, materials);
    let step_s = ExplicitKernel::stable_step(&params).unwrap().step_s;
    let body = DynamicBody { time_step_s: TIME_STEP_S.min(step_s), ..body };
    Box::new(ExplicitKernel::build(&ExplicitKernelParams::new(body, LAW, materials)).unwrap())
}

/// A model for forces alone: its step may be as short as a sliver asks for.
fn fresh_model(mesh: &TetMesh, fixed: &[FixedNode], material: &LinearElastic) -> Box<dyn DeformableModel> {
    let body = DynamicBody::new(mesh, material.density_kg_per_m3());
    let body = DynamicBody { fixed, time_step_s: AT_ONCE_S, ..body };
    Box::new(ExplicitKernel::build(&ExplicitKernelParams::new(body, LAW, &[*material])).unwrap())
}

fn bodies(folder: &Path) -> Vec<(&'static str, TetMesh)> {
    glisson(&["demo", "--headless", "--out", folder.to_str().unwrap()]);
    let mut bodies = vec![
        ("phantom liver", read_mesh(&folder.join("liver.vtu")).unwrap().0),
        ("cube", box_of_five([10, 10, 10], DVec3::splat(0.05))),
        ("cylinder", cylinder()),
    ];
    if let Some(ct) = real_ct() {
        let (mask, mesh) = (ct.join("mask.nii.gz"), folder.join("real.vtu"));
        let path = |p: &Path| p.to_str().unwrap().to_string();
        let tetrahedra = ["--label", "5", "--tetrahedra", "6300", "-o"];
        let arguments: Vec<String> =
            [vec!["mesh".into(), path(&mask)], tetrahedra.map(String::from).to_vec(), vec![path(&mesh)]]
                .concat();
        glisson(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        bodies.push(("real CT liver", read_mesh(&mesh).unwrap().0));
    }
    bodies
}

/// All edits of a seed; what they broke, if they did.
fn run_seed(name: &str, mesh: &TetMesh, seed: u64, asked: u64) -> SeedResult {
    let run = || Patient::new(name, mesh, seed).run(asked);
    let (tally, broken) = match catch_unwind(AssertUnwindSafe(run)) {
        Ok(tally) => (tally, None),
        Err(told) => {
            let text = told.downcast_ref::<String>().cloned();
            let text = text.or_else(|| told.downcast_ref::<&str>().map(|s| (*s).to_string()));
            (Tally::default(), Some(text.unwrap_or_else(|| "a panic".to_string())))
        }
    };
    SeedResult { body: name.to_string(), tetrahedra: mesh.tetrahedra.len(), seed, asked, broken, tally }
}

#[test]
fn random_edits_break_nothing() {
    let edits: u64 = std::env::var("GLISSON_SOAK_EDITS").map_or(DEFAULT_EDITS, |s| s.parse().unwrap());
    let file = |variable: &str| std::env::var_os(variable).map(PathBuf::from);
    let (log, report) = (file("GLISSON_SOAK_EDITS_LOG"), file("GLISSON_SOAK_EDITS_REPORT"));
    let folder = tempfile::tempdir().unwrap();
    let bodies = bodies(folder.path());
    let n_seeds = edits.div_ceil(EDITS_OF_SEED).max(bodies.len() as u64);
    let asked = edits.div_ceil(n_seeds);
    let results = Mutex::new(Results::go_on(log, asked));
    let next = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= n_seeds {
                        break;
                    }
                    if results.lock().unwrap().has(seed) {
                        continue;
                    }
                    let (name, mesh) = &bodies[(seed % bodies.len() as u64) as usize];
                    let result = run_seed(name, mesh, seed, asked);
                    let mut results = results.lock().unwrap();
                    results.add(result);
                    if let Some(file) = &report {
                        std::fs::write(file, results.report(n_seeds, asked, COMPARED_EVERY)).unwrap();
                    }
                }
            });
        }
    });
    let results = results.into_inner().unwrap();
    eprint!("{}", results.report(n_seeds, asked, COMPARED_EVERY));
    let all = results.all();
    let broken: Vec<_> = results.broken().map(|r| (r.seed, r.broken.clone())).collect();
    assert!(broken.is_empty(), "{broken:?}");
    let happened = [all.removals, all.blade_edits, all.scalpel_edits, all.undone, all.held];
    assert!(happened.iter().all(|&n| n > 0), "{happened:?}");
}
