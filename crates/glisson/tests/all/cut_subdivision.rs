//! Cutting along a swept blade: what opens, what keeps, and how good the tetrahedra stay.
//!
//! The area swept is known from the strokes' geometry, pieces and volumes from the planes.

use glisson::math::{DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit, MeshUndo, Replacement, TopologyChange};
use glisson::mesh::quality::{FACES, MeshQuality};
use glisson::mesh::remap::follow_in_tissue;
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetId, TetMesh};
use glisson::tool::cut::subdivision::{CutRefusal, CutReport, SubdivisionCut, SubdivisionParams};
use std::collections::BTreeMap;

/// A body that carries edits out the plain way: the reference for the mesh edit.
pub(crate) struct Body {
    pub(crate) mesh: EditableMesh,
    pub(crate) positions_m: Vec<DVec3>,
}

impl Body {
    pub(crate) fn new(mesh: TetMesh) -> Self {
        let positions_m = mesh.positions_m.clone();
        Self { mesh: EditableMesh::new(mesh).expect("a mesh"), positions_m }
    }

    pub(crate) fn deformed(mut self, by: impl Fn(DVec3) -> DVec3) -> Self {
        for p in &mut self.positions_m {
            *p = by(*p);
        }
        self
    }

    fn apply(&mut self, edit: Replacement) {
        let change = self.mesh.apply(&MeshEdit::Replace(edit)).expect("the edit is accepted");
        follow_in_tissue(&mut self.positions_m, &change);
    }

    pub(crate) fn stroke(
        &mut self,
        params: &SubdivisionParams,
        blades: impl IntoIterator<Item = [DVec3; 2]>,
    ) -> CutReport {
        let mut cut = SubdivisionCut::new(params.clone());
        let mut last = None;
        for blade_m in blades {
            if let Some(edit) = cut.advance(&self.mesh, &self.positions_m, blade_m).expect("accepted") {
                self.apply(edit);
            }
            last = Some(blade_m);
        }
        if let Some(edit) =
            cut.finish(&self.mesh, &self.positions_m, last.expect("a blade")).expect("accepted")
        {
            self.apply(edit);
        }
        *cut.report()
    }

    pub(crate) fn pieces(&self) -> usize {
        self.mesh.topology().pieces(Through::Faces).count()
    }

    pub(crate) fn check(&self, volume_m3: f64, what: &str) {
        let mesh = self.mesh.mesh();
        let now_m3 = self.mesh.volume_m3();
        assert!((now_m3 / volume_m3 - 1.0).abs() < 1e-9, "{what}: volume {now_m3} for {volume_m3}");
        for tet in self.mesh.topology().live_tets() {
            assert!(mesh.tet_volume_m3(tet) > 0.0, "{what}: inverted tetrahedron {tet}");
        }
        let mut faces: BTreeMap<[u32; 3], usize> = BTreeMap::new();
        for tet in self.mesh.topology().live_tets() {
            let tet = mesh.tetrahedra[tet.index()];
            for face in FACES {
                let mut face = face.map(|i| tet[i].0);
                face.sort_unstable();
                *faces.entry(face).or_default() += 1;
            }
        }
        assert!(faces.values().all(|&n| n <= 2), "{what}: a face with three tetrahedra");
    }
}

fn sweep(from: [DVec3; 2], to: [DVec3; 2], n: usize) -> Vec<[DVec3; 2]> {
    (0..=n)
        .map(|i| {
            let s = i as f64 / n as f64;
            [from[0].lerp(to[0], s), from[1].lerp(to[1], s)]
        })
        .collect()
}

pub(crate) fn mean_edge_m(mesh: &TetMesh) -> f64 {
    MeshQuality::of(mesh).mean_edge_m
}

/// A stroke along y = `y_m` (+ `turn_m` at its end) that leans by `lean` and goes `depth_m` deep into the top.
fn stroke_along_x(
    [x0_m, x1_m]: [f64; 2],
    [y_m, turn_m]: [f64; 2],
    [top_m, depth_m]: [f64; 2],
    lean: f64,
) -> Vec<[DVec3; 2]> {
    let down = DVec3::new(0.0, lean, 1.0).normalize();
    let at = |x: f64, y: f64| {
        let skin = DVec3::new(x, y, top_m);
        [skin - depth_m * down, skin + 0.02 * down]
    };
    sweep(at(x0_m, y_m), at(x1_m, y_m + turn_m), 60)
}

#[test]
fn strokes_open_the_area_they_sweep() {
    let size_m = DVec3::new(0.08, 0.06, 0.04);
    let mesh = box_of_five([16, 12, 8], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let mut random = SeededRandom::new(1);
    for trial in 0..12 {
        let mut body = Body::new(mesh.clone());
        let y_m = random.uniform_in(0.02, 0.04);
        let depth_m = random.uniform_in(0.012, 0.03);
        let lean = random.uniform_in(-0.5, 0.5);
        let turn_m = random.uniform_in(-0.01, 0.01);
        let blades = stroke_along_x([-0.005, 0.0553], [y_m, turn_m], [0.04, depth_m], lean);
        let report = body.stroke(&params, blades);
        let what = format!("trial {trial}: {report:?}");
        let share = report.cut_area_m2 / report.swept_area_m2;
        let length_m = DVec3::new(0.0603, turn_m, 0.0).length() * 0.0553 / 0.0603;
        let wanted_m2 = length_m * depth_m * DVec3::new(0.0, lean, 1.0).normalize().z.recip().min(1.0);
        assert!((report.swept_area_m2 / wanted_m2 - 1.0).abs() < 0.02, "{what}: swept, not {wanted_m2}");
        assert!((share - 1.0).abs() < 0.02, "{what}: share {share}");
        assert!(report.min_dihedral_deg >= 3.0, "{what}");
        assert_eq!(report.n_refused, 0, "{what}");
        body.check(size_m.element_product(), &what);
        assert_eq!(body.mesh.topology().surface_euler_characteristic(), 2, "{what}");
        assert!(body.mesh.topology().pinches().is_empty(), "{what}");
        assert_eq!(body.pieces(), 1, "{what}");
    }
}

#[test]
fn stroke_through_the_body_makes_two_pieces_of_the_right_volumes() {
    let size_m = DVec3::new(0.06, 0.05, 0.04);
    let mesh = box_of_five([9, 8, 6], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    for (y_m, turn_m) in [(0.021, 0.0), (0.025, 0.006), (0.0187, -0.004)] {
        let mut body = Body::new(mesh.clone());
        let blades = stroke_along_x([-0.005, 0.065], [y_m, turn_m], [0.04, 0.045], 0.0);
        let report = body.stroke(&params, blades);
        let what = format!("{y_m} {turn_m}: {report:?}");
        body.check(size_m.element_product(), &what);
        assert_eq!(body.pieces(), 2, "{what}");
        let mut below_m3 = 0.0;
        let near_origin = first_at_origin(&body);
        let pieces = body.mesh.topology().pieces(Through::Faces);
        for tet in body.mesh.topology().live_tets() {
            if pieces.of_tet[tet.index()] == pieces.of_tet[near_origin.index()] {
                below_m3 += body.mesh.mesh().tet_volume_m3(tet);
            }
        }
        // The plane's mean y over the box: the stroke runs from x = -5 to 65 mm.
        let mean_y_m = y_m + turn_m * 0.5;
        let wanted_m3 = size_m.x * size_m.z * mean_y_m;
        assert!((below_m3 / wanted_m3 - 1.0).abs() < 0.01, "{what}: {below_m3} m3, not {wanted_m3}");
        assert!((report.cut_area_m2 / report.swept_area_m2 - 1.0).abs() < 0.02, "{what}");
    }
}

/// The live tetrahedron next to the origin.
fn first_at_origin(body: &Body) -> TetId {
    let mesh = body.mesh.mesh();
    let center = |t: &TetId| mesh.corners_m(*t).into_iter().sum::<DVec3>().length();
    body.mesh.topology().live_tets().min_by(|a, b| center(a).total_cmp(&center(b))).expect("a tetrahedron")
}

#[test]
fn crossing_strokes_keep_the_body_whole_and_valid() {
    let size_m = DVec3::new(0.06, 0.06, 0.03);
    let mesh = box_of_five([8, 8, 4], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let mut body = Body::new(mesh);
    let mut worst_deg = 180.0f64;
    for i in 0..5 {
        let y_m = 0.0093 + 0.0101 * f64::from(i);
        let along_x = stroke_along_x([-0.004, 0.064], [y_m, 0.0], [0.03, 0.014], 0.1);
        let along_y: Vec<[DVec3; 2]> = along_x.iter().map(|b| b.map(|p| DVec3::new(p.y, p.x, p.z))).collect();
        for blades in [along_x, along_y] {
            let report = body.stroke(&params, blades);
            worst_deg = worst_deg.min(report.min_dihedral_deg);
            assert_eq!(report.n_refused, 0);
            let what = format!("{i}: {report:?}");
            let share = report.cut_area_m2 / report.swept_area_m2;
            assert!((share - 1.0).abs() < 0.02, "{what}: {share}");
            body.check(size_m.element_product(), &what);
            assert_eq!(body.pieces(), 1, "{what}");
        }
    }
    assert!(worst_deg >= 3.0, "{worst_deg}");
}

#[test]
fn short_strokes_open_their_corners_too() {
    let size_m = DVec3::new(0.05, 0.05, 0.03);
    let mesh = box_of_five([10, 10, 6], size_m);
    let edge_m = mean_edge_m(&mesh);
    let params = SubdivisionParams::for_mean_edge(edge_m);
    let mut random = SeededRandom::new(5);
    for trial in 0..8 {
        let mut body = Body::new(mesh.clone());
        let x_m = random.uniform_in(0.012, 0.02);
        let length_m = random.uniform_in(1.5, 4.0) * edge_m;
        let (y_m, turn_m) = (random.uniform_in(0.015, 0.035), random.uniform_in(-0.5, 0.5) * length_m);
        let (depth_m, lean) = (random.uniform_in(0.8, 3.0) * edge_m, random.uniform_in(-0.3, 0.3));
        let blades = stroke_along_x([x_m, x_m + length_m], [y_m, turn_m], [0.03, depth_m], lean);
        let report = body.stroke(&params, blades);
        let what = format!("trial {trial}: {report:?}");
        let share = report.cut_area_m2 / report.swept_area_m2;
        assert!((share - 1.0).abs() < 0.02, "{what}: share {share}");
        assert_eq!(report.n_merged, 0, "{what}");
        assert!(report.min_dihedral_deg >= 3.0, "{what}");
        body.check(size_m.element_product(), &what);
    }
}

#[test]
fn strokes_across_earlier_cuts_at_small_angles_open_the_area_they_sweep() {
    let size_m = DVec3::new(0.08, 0.06, 0.03);
    let mesh = box_of_five([12, 9, 5], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let mut body = Body::new(mesh);
    // Through one place, 20 degrees after each other: crossings, and tetrahedra between three cuts.
    for (i, angle_deg) in [0.0f64, 20.0, 40.0, 65.0, 90.0, 120.0].into_iter().enumerate() {
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        let along = DVec3::new(cos, sin, 0.0);
        let middle = DVec3::new(0.03 + 0.004 * i as f64, 0.031, 0.03);
        let blade = |s: f64| [middle + s * along - 0.016 * DVec3::Z, middle + s * along + 0.01 * DVec3::Z];
        let report = body.stroke(&params, sweep(blade(-0.022), blade(0.022), 40));
        let what = format!("{angle_deg} degrees: {report:?}");
        let share = report.cut_area_m2 / report.swept_area_m2;
        assert!((share - 1.0).abs() < 0.02, "{what}: share {share}");
        assert!(report.min_dihedral_deg >= 3.0, "{what}");
        assert_eq!(report.n_refused, 0, "{what}");
        body.check(size_m.element_product(), &what);
    }
}

#[test]
fn random_strokes_never_break_the_mesh() {
    let size_m = DVec3::new(0.05, 0.05, 0.05);
    let mesh = box_of_five([5, 5, 5], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    for seed in 0..4 {
        let mut random = SeededRandom::new(seed);
        let mut body = Body::new(mesh.clone());
        for stroke in 0..6 {
            let mut point = || {
                DVec3::new(
                    random.uniform_in(-0.02, 0.07),
                    random.uniform_in(-0.02, 0.07),
                    random.uniform_in(-0.02, 0.07),
                )
            };
            let blades = sweep([point(), point()], [point(), point()], 12);
            let report = body.stroke(&params, blades);
            let what = format!("seed {seed} stroke {stroke}: {report:?}");
            // A stroke that is off says so.
            let off = (report.cut_area_m2 - report.swept_area_m2).abs();
            assert!(off <= 0.0201 * report.swept_area_m2 || report.n_merged + report.n_refused > 0, "{what}");
            body.check(size_m.element_product(), &what);
        }
    }
}

#[test]
fn strokes_in_a_deformed_body_open_the_area_swept_there() {
    let size_m = DVec3::new(0.08, 0.06, 0.04);
    let mesh = box_of_five([12, 9, 6], size_m);
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let bend = |p: DVec3| {
        let angle = 8.0 * p.x;
        let radius = 0.125 + p.z - 0.02;
        DVec3::new(radius * angle.sin(), 1.1 * p.y, radius * angle.cos() - 0.105)
    };
    let mut body = Body::new(mesh).deformed(bend);
    let blades: Vec<[DVec3; 2]> = (0..=60)
        .map(|i| {
            let p = DVec3::new(-0.003 + 0.0008 * f64::from(i), 0.0262 + 0.00013 * f64::from(i), 0.04);
            [bend(p - DVec3::new(0.0, 0.002, 0.017)), bend(p + DVec3::new(0.0, 0.002, 0.02))]
        })
        .collect();
    let report = body.stroke(&params, blades);
    let share = report.cut_area_m2 / report.swept_area_m2;
    body.check(size_m.element_product(), "deformed");
    assert!((share - 1.0).abs() < 0.02, "{share}: {report:?}");
    assert!(report.min_dihedral_deg >= 3.0, "{report:?}");
    assert_eq!(body.mesh.topology().surface_euler_characteristic(), 2);
}

#[test]
fn undone_stroke_leaves_the_mesh_as_it_was() {
    let mesh = box_of_five([6, 6, 4], DVec3::new(0.06, 0.06, 0.04));
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let mut body = Body::new(mesh);
    let before = body.mesh.clone();
    let mut undos = Vec::new();
    let mut cut = SubdivisionCut::new(params);
    for blade_m in stroke_along_x([-0.005, 0.065], [0.031, 0.005], [0.04, 0.02], 0.2) {
        if let Some(edit) = cut.advance(&body.mesh, &body.positions_m, blade_m).expect("accepted") {
            let (mut change, mut undo) = (TopologyChange::default(), MeshUndo::default());
            body.mesh.apply_saving(&MeshEdit::Replace(edit), &mut change, &mut undo).expect("accepted");
            follow_in_tissue(&mut body.positions_m, &change);
            undos.push(undo);
        }
    }
    assert!(undos.len() > 3);
    for undo in undos.iter().rev() {
        body.mesh.undo(undo);
    }
    assert!(body.mesh == before);
}

#[test]
fn nodes_that_something_holds_stay_where_they_are() {
    let mesh = box_of_five([6, 6, 4], DVec3::new(0.06, 0.06, 0.04));
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let is_held = |n: NodeId| n.0.is_multiple_of(2);
    let [n_free, n_held] = [false, true].map(|holds| {
        let mut body = Body::new(mesh.clone());
        let mut cut = SubdivisionCut::new(params.clone());
        let mut n_moved = 0;
        for blade_m in stroke_along_x([-0.005, 0.065], [0.031, 0.005], [0.04, 0.02], 0.2) {
            let nodes = (0..body.positions_m.len()).map(NodeId::from_index);
            cut.hold_still(nodes.map(|n| holds && is_held(n)));
            if let Some(edit) = cut.advance(&body.mesh, &body.positions_m, blade_m).expect("accepted") {
                n_moved += edit.moved_nodes.iter().filter(|moved| is_held(moved.node)).count();
                body.apply(edit);
            }
        }
        body.check(0.06 * 0.06 * 0.04, "held");
        n_moved
    });
    assert!(n_free > 3 && n_held == 0, "{n_free} {n_held}");
}

#[test]
fn impossible_steps_are_refused_with_a_reason() {
    let mesh = box_of_five([2, 2, 2], DVec3::splat(0.02));
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let body = Body::new(mesh);
    let mut cut = SubdivisionCut::new(params);
    let place = |x: f64| [DVec3::new(x, 0.01, 0.01), DVec3::new(x, 0.01, 0.04)];
    let wrong = cut.advance(&body.mesh, &body.positions_m[1..], place(-0.01));
    assert_eq!(wrong, Err(CutRefusal::WrongNumberOfPositions { n_positions: 26, n_nodes: 27 }));
    assert_eq!(cut.advance(&body.mesh, &body.positions_m, place(-0.01)), Ok(None));
    let lost = cut.advance(&body.mesh, &body.positions_m, place(f64::NAN));
    assert!(matches!(lost, Err(CutRefusal::NotFinite { .. })));
    // Along itself, a blade sweeps nothing.
    let down = place(-0.01).map(|p| p - 0.02 * DVec3::Z);
    assert_eq!(cut.advance(&body.mesh, &body.positions_m, down), Ok(None));
    // What is not carried out is undone, and comes again.
    let first = cut.advance(&body.mesh, &body.positions_m, place(0.012));
    assert!(matches!(first, Ok(Some(_))));
    cut.take_back();
    assert_eq!(cut.report().n_edits, 0);
    assert_eq!(cut.advance(&body.mesh, &body.positions_m, place(0.012)), first);
}

/// Asked to leave no angle smaller than the smallest it finds, as hardly a cut of an irregular body does, a blade opens what
/// faces there are.
#[test]
fn a_cut_snaps_until_no_shape_is_worse_than_asked() {
    let mut random = SeededRandom::new(11);
    let mut n_cuts = 0;
    for _ in 0..40 {
        let mut mesh = box_of_five([3, 3, 3], DVec3::splat(0.06));
        for p in &mut mesh.positions_m {
            let is_inside = p.cmpgt(DVec3::splat(1e-3)).all() && p.cmplt(DVec3::splat(0.059)).all();
            let random = &mut random;
            *p +=
                DVec3::from_array([(); 3].map(|()| random.uniform_in(-0.003, 0.003))) * f64::from(is_inside);
        }
        let mean_m = mean_edge_m(&mesh);
        let params = SubdivisionParams { min_dihedral_deg: 90.0, ..SubdivisionParams::for_mean_edge(mean_m) };
        let mut body = Body::new(mesh);
        let mut cut = SubdivisionCut::new(params);
        let ways = [-0.01, random.uniform_in(0.02, 0.07)].map(|x| (x, random.uniform_in(0.01, 0.05)));
        let lowest_m = random.uniform_in(-0.01, 0.04);
        let [from, to] = ways.map(|(x, y)| [DVec3::new(x, y, lowest_m), DVec3::new(x, y, 0.07)]);
        assert_eq!(cut.advance(&body.mesh, &body.positions_m, from), Ok(None));
        let step = cut.advance(&body.mesh, &body.positions_m, to);
        let report = *cut.report();
        // What cannot be is refused with its angle; snapping has always found a way.
        let edit = step.unwrap_or_else(|refusal| panic!("{refusal}"));
        n_cuts += usize::from(edit.is_some());
        edit.into_iter().for_each(|edit| body.apply(edit));
        body.check(0.06f64.powi(3), "no worse shapes");
        assert!(report.min_dihedral_deg >= report.min_dihedral_before_deg, "{report:?}");
        assert_eq!(report.n_refused, 0);
    }
    assert!(n_cuts > 30, "{n_cuts}");
}
