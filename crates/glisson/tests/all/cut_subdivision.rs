//! Cutting along a swept blade: what opens, what keeps, and how good the tetrahedra stay.

use glisson::math::{DMat3, DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit, Replacement};
use glisson::mesh::remap::follow;
use glisson::mesh::quality::{FACES, MeshQuality};
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetMesh};
use glisson::tool::cut::subdivision::{CutReport, SubdivisionCut, SubdivisionParams};
use std::collections::BTreeMap;

/// A body that carries edits out the plain way: the reference for the mesh edit.
struct Body {
    mesh: EditableMesh,
    positions_m: Vec<DVec3>,
}

impl Body {
    fn new(mesh: TetMesh) -> Self {
        let positions_m = mesh.positions_m.clone();
        Self { mesh: EditableMesh::new(mesh).expect("a mesh"), positions_m }
    }

    fn deformed(mut self, by: impl Fn(DVec3) -> DVec3) -> Self {
        for p in &mut self.positions_m {
            *p = by(*p);
        }
        self
    }

    fn apply(&mut self, edit: Replacement) {
        let change = self.mesh.apply(&MeshEdit::Replace(edit)).expect("the edit is accepted");
        follow::<NodeId, DVec3>(&mut self.positions_m, &change);
    }

    fn stroke(&mut self, params: &SubdivisionParams, blades: impl IntoIterator<Item = [DVec3; 2]>) -> CutReport {
        let mut cut = SubdivisionCut::new(params.clone());
        let mut last = None;
        for blade_m in blades {
            let before = *cut.report();
            if let Some(edit) = cut.advance(&self.mesh, &self.positions_m, blade_m).expect("accepted") {
                self.apply(edit);
            }
            let after = cut.report();
            if after.n_edits > before.n_edits && std::env::var("STEPS").is_ok() {
                let (s, c) = (after.swept_area_m2 - before.swept_area_m2, after.cut_area_m2 - before.cut_area_m2);
                println!("   step swept {s:.3e} cut {c:.3e} ratio {:.3} coarser {} euler {} snapped {}", c / s, after.n_coarser, self.mesh.topology().surface_euler_characteristic(), after.n_snapped-before.n_snapped);
            }
            last = Some(blade_m);
        }
        if let Some(edit) = cut.finish(&self.mesh, &self.positions_m, last.expect("a blade")).expect("accepted") {
            self.apply(edit);
        }
        *cut.report()
    }

    fn pieces(&self) -> usize {
        self.mesh.topology().pieces(Through::Faces).count()
    }

    fn check(&self, volume_m3: f64, what: &str) {
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

fn mean_edge_m(mesh: &TetMesh) -> f64 {
    MeshQuality::of(mesh).mean_edge_m
}

#[test]
fn strokes_open_the_area_they_sweep() {
    let k: usize = std::env::var("CELLS").map_or(1, |c| c.parse().unwrap()); let mesh = box_of_five([8*k, 6*k, 4*k], DVec3::new(0.08, 0.06, 0.04));
    let params = SubdivisionParams::for_mean_edge(mean_edge_m(&mesh));
    let mut random = SeededRandom::new(1);
    for trial in 0..20 {
        let mut body = Body::new(mesh.clone());
        let volume = mesh.volume_m3();
        let y = random.uniform_in(0.02, 0.04);
        let depth = random.uniform_in(0.012, 0.03);
        let lean = DVec3::new(0.0, random.uniform_in(-0.5, 0.5), 1.0).normalize();
        let turn = random.uniform_in(-0.01, 0.01);
        let tip = |x: f64, y: f64| DVec3::new(x, y, 0.04) - depth * lean;
        let heel = |x: f64, y: f64| DVec3::new(x, y, 0.04) + 0.02 * lean;
        let from = [tip(-0.005, y), heel(-0.005, y)];
        let to = [tip(0.0553, y + turn), heel(0.0553, y + turn)];
        let report = body.stroke(&params, sweep(from, to, 60));
        println!("{trial}: ratio {:.4} min {:.2} snapped {} coarser {} tets {}", report.cut_area_m2 / report.swept_area_m2, report.min_dihedral_deg, report.n_snapped, report.n_coarser, body.mesh.topology().live_counts().tets);
        body.check(volume, &format!("trial {trial}"));
        let euler = body.mesh.topology().surface_euler_characteristic();
        println!("   euler {euler} pieces {}", body.pieces());
        let pinches = body.mesh.topology().pinches();
        for n in &pinches.nodes { println!("   PINCH node {n} {:?}", body.positions_m[n.index()] * 1e3); }
        for e in &pinches.edges { println!("   PINCH edge {:?}", body.mesh.topology().edge_nodes(*e).map(|n| body.positions_m[n.index()] * 1e3)); }
        let mesh = body.mesh.live_mesh();
        let (surface, _) = glisson::mesh::quality::surface_triangles(&mesh);
        // components through edges
        let mut comp: Vec<usize> = (0..surface.len()).collect();
        fn root(c: &mut Vec<usize>, mut i: usize) -> usize { while c[i] != i { c[i] = c[c[i]]; i = c[i]; } i }
        let mut by_edge: BTreeMap<[u32; 2], Vec<usize>> = BTreeMap::new();
        for (t, f) in surface.iter().enumerate() { for k in 0..3 { let (a, b) = (f[k], f[(k + 1) % 3]); by_edge.entry([a.min(b), a.max(b)]).or_default().push(t); } }
        for ts in by_edge.values() { for w in ts.windows(2) { let (a, b) = (root(&mut comp, w[0]), root(&mut comp, w[1])); comp[a] = b; } }
        let mut count: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for t in 0..surface.len() { let r = root(&mut comp, t); count.entry(r).or_default().push(t); }
        if count.len() > 1 { for (r, ts) in &count { println!("   COMPONENT {} near {:?}", ts.len(), mesh.positions_m[surface[*r][0] as usize] * 1e3); } }

    }
}

#[test]
fn scratch_unused() {
    let _ = DMat3::IDENTITY;
}
