//! Cutting along a swept blade: what opens against what was swept, shapes, volumes, pieces.

use super::bodies::liver;
use super::{Experiment, Figure, Outcome};
use crate::plot::{LinePlot, Series, SeriesStyle};
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::quality::{MeshQuality, dihedral_angles_deg};
use glisson::mesh::remap::follow;
use glisson::mesh::topology::Through;
use glisson::mesh::{NodeId, TetMesh};
use glisson::tool::cut::subdivision::{CutReport, SubdivisionCut, SubdivisionParams};

const REQUIREMENT: &str = "requirement";
const LIVER_TETS: usize = 6_300;
const N_STROKES: usize = 12;
const N_STEPS: usize = 60;
const N_CROSSING: usize = 5;

/// A body under the knife.
struct Body {
    mesh: EditableMesh,
    positions_m: Vec<DVec3>,
    params: SubdivisionParams,
    bounds: Aabb,
}

impl Body {
    fn new(mesh: TetMesh) -> anyhow::Result<Self> {
        Ok(Self {
            params: SubdivisionParams::for_mean_edge(MeshQuality::of(&mesh).mean_edge_m),
            bounds: Aabb::of_points(&mesh.positions_m),
            positions_m: mesh.positions_m.clone(),
            mesh: EditableMesh::new(mesh)?,
        })
    }

    /// A stroke; also the triangles that it opened, of both sides.
    fn stroke(
        &mut self,
        from_m: [DVec3; 2],
        to_m: [DVec3; 2],
    ) -> anyhow::Result<(CutReport, Vec<[DVec3; 3]>)> {
        let mut cut = SubdivisionCut::new(self.params.clone());
        let mut opened = Vec::new();
        for step in 0..=N_STEPS {
            let share = step as f64 / N_STEPS as f64;
            let blade_m = [0, 1].map(|i| from_m[i].lerp(to_m[i], share));
            let edit = if step == N_STEPS {
                cut.finish(&self.mesh, &self.positions_m, blade_m)
            } else {
                cut.advance(&self.mesh, &self.positions_m, blade_m)
            };
            // A refusal is counted in the report, and the stroke goes on.
            if let Ok(Some(edit)) = edit {
                let change = self.mesh.apply(&MeshEdit::Replace(edit))?;
                follow::<NodeId, DVec3>(&mut self.positions_m, &change);
                let topology = self.mesh.topology();
                let added = change.surface_triangles_added.iter();
                opened
                    .extend(added.map(|&t| topology.triangle_nodes(t).map(|n| self.positions_m[n.index()])));
            }
        }
        Ok((*cut.report(), opened))
    }

    /// Difference of the volume from `volume_m3`, relative, and the smallest volume of a tetrahedron [m3].
    fn volumes(&self, volume_m3: f64) -> (f64, f64) {
        let topology = self.mesh.topology();
        let smallest =
            topology.live_tets().map(|t| self.mesh.mesh().tet_volume_m3(t)).fold(f64::INFINITY, f64::min);
        ((self.mesh.volume_m3() / volume_m3 - 1.0).abs(), smallest)
    }

    /// A blade from the top down to `depth_m`, at (x, y), that leans over to y.
    fn blade(&self, x_m: f64, y_m: f64, depth_m: f64, lean: f64) -> [DVec3; 2] {
        let down = DVec3::new(0.0, lean, 1.0).normalize();
        let top = DVec3::new(x_m, y_m, self.bounds.max_m.z);
        [top - depth_m * down, top + 0.02 * down]
    }
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    single_strokes("box", &box_of_five([16, 12, 8], DVec3::new(0.08, 0.06, 0.04)), &mut outcome)?;
    single_strokes("liver", &liver(LIVER_TETS)?, &mut outcome)?;
    crossing_strokes(&mut outcome)?;
    through(&mut outcome)?;
    Ok(outcome)
}

/// Strokes, each in a whole body.
fn single_strokes(name: &str, mesh: &TetMesh, outcome: &mut Outcome) -> anyhow::Result<()> {
    let volume_m3 = mesh.volume_m3();
    let mut random = SeededRandom::new(7);
    let (mut worst_share, mut worst_deg, mut worst_volume, mut smallest_m3) =
        (0.0f64, 180.0f64, 0.0f64, f64::INFINITY);
    let mut n_refused = 0;
    for stroke in 0..N_STROKES {
        let mut body = Body::new(mesh.clone())?;
        let size_m = body.bounds.size_m();
        let y_m = body.bounds.min_m.y + random.uniform_in(0.35, 0.65) * size_m.y;
        let depth_m = random.uniform_in(0.4, 0.7) * size_m.z;
        let (lean, turn) = (random.uniform_in(-0.4, 0.4), random.uniform_in(-0.15, 0.15) * size_m.y);
        let from_m = body.blade(body.bounds.min_m.x - 0.005, y_m, depth_m, lean);
        let to_m = body.blade(body.bounds.min_m.x + 0.7 * size_m.x, y_m + turn, depth_m, lean);
        let (report, opened) = body.stroke(from_m, to_m)?;
        worst_share = worst_share.max((report.cut_area_m2 / report.swept_area_m2 - 1.0).abs());
        worst_deg = worst_deg.min(report.min_dihedral_deg);
        n_refused += report.n_refused;
        let (volume, smallest) = body.volumes(volume_m3);
        (worst_volume, smallest_m3) = (worst_volume.max(volume), smallest_m3.min(smallest));
        if stroke == 0 && name == "liver" {
            outcome.figures.push(figure(&opened, from_m, to_m, &report));
        }
    }
    outcome.experiments.extend([
        Experiment::at_most(
            &format!("{N_STROKES} strokes into a {name}: area opened against area swept, worst difference"),
            REQUIREMENT,
            worst_share,
            0.02,
        ),
        Experiment::within(
            &format!("{N_STROKES} strokes into a {name}: smallest dihedral angle of what is new [deg]"),
            REQUIREMENT,
            worst_deg,
            [3.0, 70.6],
        ),
        Experiment::at_most(
            &format!("{N_STROKES} strokes into a {name}: change of volume, relative"),
            REQUIREMENT,
            worst_volume,
            1e-9,
        ),
        Experiment::at_most(
            &format!("{N_STROKES} strokes into a {name}: tetrahedra inside out (0 or 1), steps refused"),
            REQUIREMENT,
            f64::from(u8::from(smallest_m3 <= 0.0)) + n_refused as f64,
            0.0,
        ),
    ]);
    Ok(())
}

/// Strokes that cross at right angles.
fn crossing_strokes(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = box_of_five([12, 12, 6], DVec3::new(0.06, 0.06, 0.03));
    let volume_m3 = mesh.volume_m3();
    let mut body = Body::new(mesh)?;
    let mut table = String::from(
        "Strokes that cross: area opened over area swept, smallest dihedral angle, steps with more snapping.\n\n\
         | stroke | area | angle [deg] | coarser |\n|---|---|---|---|\n",
    );
    let (mut swept_m2, mut cut_m2, mut worst_deg, mut n_refused) = (0.0, 0.0, 180.0f64, 0);
    for i in 0..N_CROSSING {
        let y_m = 0.0093 + 0.0101 * i as f64;
        let along_x = [body.blade(-0.004, y_m, 0.015, 0.1), body.blade(0.064, y_m, 0.015, 0.1)];
        let along_y = along_x.map(|blade| blade.map(|p| DVec3::new(p.y, p.x, p.z)));
        for (axis, [from_m, to_m]) in [("x", along_x), ("y", along_y)] {
            let (report, _) = body.stroke(from_m, to_m)?;
            swept_m2 += report.swept_area_m2;
            cut_m2 += report.cut_area_m2;
            worst_deg = worst_deg.min(report.min_dihedral_deg);
            n_refused += report.n_refused;
            table.push_str(&format!(
                "| {i} along {axis} | {:.4} | {:.2} | {} of {} |\n",
                report.cut_area_m2 / report.swept_area_m2,
                report.min_dihedral_deg,
                report.n_coarser,
                report.n_edits
            ));
        }
    }
    let (volume, smallest_m3) = body.volumes(volume_m3);
    let worst_live_deg = dihedral_angles_deg(&body.mesh.live_mesh()).into_iter().fold(180.0, f64::min);
    let n = 2 * N_CROSSING;
    outcome.experiments.extend([
        Experiment::near(
            &format!("{n} crossing strokes: area opened over area swept"),
            REQUIREMENT,
            cut_m2 / swept_m2,
            1.0,
            0.02,
        ),
        Experiment::within(
            &format!("{n} crossing strokes: smallest dihedral angle of the whole mesh [deg]"),
            REQUIREMENT,
            worst_deg.min(worst_live_deg),
            [3.0, 70.6],
        ),
        Experiment::at_most(
            &format!("{n} crossing strokes: change of volume, relative"),
            REQUIREMENT,
            volume,
            1e-9,
        ),
        Experiment::at_most(
            &format!("{n} crossing strokes: tetrahedra inside out (0 or 1), steps refused"),
            REQUIREMENT,
            f64::from(u8::from(smallest_m3 <= 0.0)) + n_refused as f64,
            0.0,
        ),
    ]);
    outcome.notes.push_str(&table);
    Ok(())
}

/// A stroke through a box.
fn through(outcome: &mut Outcome) -> anyhow::Result<()> {
    let size_m = DVec3::new(0.06, 0.05, 0.04);
    let mut body = Body::new(box_of_five([9, 8, 6], size_m))?;
    let y_m = 0.0212;
    let (from_m, to_m) = (body.blade(-0.005, y_m, 0.045, 0.0), body.blade(0.065, y_m, 0.045, 0.0));
    body.stroke(from_m, to_m)?;
    let pieces = body.mesh.topology().pieces(Through::Faces);
    let mesh = body.mesh.mesh();
    let mut volumes_m3 = [0.0; 2];
    for tet in body.mesh.topology().live_tets() {
        volumes_m3[pieces.of_tet[tet.index()].min(1) as usize] += mesh.tet_volume_m3(tet);
    }
    let below_m3 = size_m.x * size_m.z * y_m;
    let nearest = volumes_m3.into_iter().min_by(|a, b| (a - below_m3).abs().total_cmp(&(b - below_m3).abs()));
    outcome.experiments.extend([
        Experiment::near("a stroke through a box: pieces", REQUIREMENT, pieces.count() as f64, 2.0, 0.0),
        Experiment::near(
            "a stroke through a box: volume of the piece on one side [ml]",
            REQUIREMENT,
            nearest.unwrap_or(0.0) * 1e6,
            below_m3 * 1e6,
            0.01,
        ),
    ]);
    Ok(())
}

/// The faces of the first stroke into the liver, in the plane of the blade.
fn figure(opened: &[[DVec3; 3]], from_m: [DVec3; 2], to_m: [DVec3; 2], report: &CutReport) -> Figure {
    let along = (to_m[0] - from_m[0]).normalize();
    let up = (from_m[1] - from_m[0]).reject_from(along).normalize();
    let normal = along.cross(up);
    let flat = |p: DVec3| [1e3 * (p - from_m[0]).dot(along), 1e3 * (p - from_m[0]).dot(up)];
    let mut faces = Vec::new();
    for face in opened {
        // Parts of the organ's surface were divided, too, and are not of the cut.
        if face.iter().all(|p| (*p - from_m[0]).dot(normal).abs() < 2e-3) {
            faces.extend([face[0], face[1], face[2], face[0]].map(flat));
            faces.push([f64::NAN; 2]);
        }
    }
    let swept = [from_m[0], to_m[0], to_m[1], from_m[1], from_m[0]].map(flat).to_vec();
    Figure {
        file: "cut_subdivision_faces.svg",
        caption: format!(
            "Faces that a stroke opened in the phantom's liver, in the blade's plane; swept {:.1} cm2, opened {:.1} cm2.",
            1e4 * report.swept_area_m2,
            1e4 * report.cut_area_m2
        ),
        plot: LinePlot {
            title: "A cut along the swept blade".into(),
            x_label: "along the stroke [mm]".into(),
            y_label: "along the blade [mm]".into(),
            series: vec![
                Series { name: "opened faces".into(), points: faces, style: SeriesStyle::Line },
                Series { name: "swept by the blade".into(), points: swept, style: SeriesStyle::Dashed },
            ],
            size: [900, 480],
        },
    }
}
