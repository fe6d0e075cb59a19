//! Cutting along a swept blade: what opens against what was swept, shapes, volumes, pieces.

use super::{Experiment, Figure, Outcome};
use crate::bodies::{liver, most};
use glisson::math::{Aabb, DVec3, SeededRandom};
use glisson::mesh::TetMesh;
use glisson::mesh::box_mesh::box_of_five;
use glisson::mesh::edit::{EditableMesh, MeshEdit};
use glisson::mesh::quality::{MeshQuality, dihedral_angles_deg};
use glisson::mesh::remap::follow_in_tissue;
use glisson::mesh::topology::Through;
use glisson::tool::cut::subdivision::{CutReport, SubdivisionCut, SubdivisionParams};
use glisson_report::plot::{LinePlot, Series, SeriesStyle};

const REQUIREMENT: &str = "requirement";
const LIVER_TETS: usize = 6_300;
const N_STROKES: usize = 12;
const N_STEPS: usize = 60;
const N_CROSSING: usize = 5;
const N_SHORT: usize = 12;
const N_OBLIQUE: usize = 12;
const N_RANDOM: usize = 200;
/// Smallest angle of a stroke with an earlier one that it crosses, and distance [mean edges] from the others.
const LEAST_ANGLE_DEG: f64 = 15.0;
const LEAST_DISTANCE: f64 = 0.3;

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
                follow_in_tissue(&mut self.positions_m, &change);
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

/// The worst of some strokes, and what is claimed of it.
struct Worst {
    /// Difference of the area opened from the area swept, relative.
    area: f64,
    angle_deg: f64,
    /// Difference of the volume, relative.
    volume: f64,
    smallest_m3: f64,
    n_refused: usize,
}

impl Worst {
    fn new() -> Self {
        Self { area: 0.0, angle_deg: 180.0, volume: 0.0, smallest_m3: f64::INFINITY, n_refused: 0 }
    }

    fn add_area(&mut self, report: &CutReport) {
        self.area = self.area.max((report.cut_area_m2 / report.swept_area_m2 - 1.0).abs());
    }

    fn add_shapes(&mut self, report: &CutReport) {
        self.angle_deg = self.angle_deg.min(report.min_dihedral_deg);
        self.n_refused += report.n_refused;
    }

    /// A body that had `volume_m3` before.
    fn add_body(&mut self, body: &Body, volume_m3: f64) {
        let (volume, smallest_m3) = body.volumes(volume_m3);
        self.volume = most([self.volume, volume]);
        self.smallest_m3 = self.smallest_m3.min(smallest_m3);
    }

    fn of_area(&self, what: &str) -> Experiment {
        let name = format!("{what}: area opened against area swept, worst difference");
        Experiment::at_most(&name, REQUIREMENT, self.area, 0.02)
    }

    fn of_new_angles(&self, what: &str) -> Experiment {
        of_angles(&format!("{what}: smallest dihedral angle of what is new [deg]"), self.angle_deg)
    }

    fn of_bodies(&self, what: &str) -> [Experiment; 2] {
        [
            Experiment::at_most(
                &format!("{what}: change of volume, relative"),
                REQUIREMENT,
                self.volume,
                1e-9,
            ),
            Experiment::at_most(
                &format!("{what}: tetrahedra inside out (0 or 1), steps refused"),
                REQUIREMENT,
                f64::from(u8::from(self.smallest_m3 <= 0.0)) + self.n_refused as f64,
                0.0,
            ),
        ]
    }

    /// All of them.
    fn experiments(&self, what: &str) -> [Experiment; 4] {
        let [volume, inside_out] = self.of_bodies(what);
        [self.of_area(what), self.of_new_angles(what), volume, inside_out]
    }
}

fn of_angles(name: &str, smallest_deg: f64) -> Experiment {
    Experiment::within(name, REQUIREMENT, smallest_deg, [3.0, 70.6])
}

pub(super) fn experiments() -> anyhow::Result<Outcome> {
    let mut outcome = Outcome::default();
    single_strokes("box", &box_of_five([16, 12, 8], DVec3::new(0.08, 0.06, 0.04)), &mut outcome)?;
    single_strokes("liver", &liver(LIVER_TETS)?, &mut outcome)?;
    short_strokes(&mut outcome)?;
    crossing_strokes(&mut outcome)?;
    let boxes = box_of_five([16, 12, 8], DVec3::new(0.08, 0.06, 0.04));
    oblique_strokes("box", boxes, &mut outcome)?;
    oblique_strokes("liver", liver(LIVER_TETS)?, &mut outcome)?;
    let liver = liver(LIVER_TETS)?;
    random_strokes(&liver, &mut outcome)?;
    through(&mut outcome)?;
    Ok(outcome)
}

/// Strokes, each in a whole body.
fn single_strokes(name: &str, mesh: &TetMesh, outcome: &mut Outcome) -> anyhow::Result<()> {
    let volume_m3 = mesh.volume_m3();
    let mut random = SeededRandom::new(7);
    let mut worst = Worst::new();
    for stroke in 0..N_STROKES {
        let mut body = Body::new(mesh.clone())?;
        let size_m = body.bounds.size_m();
        let y_m = body.bounds.min_m.y + random.uniform_in(0.35, 0.65) * size_m.y;
        let depth_m = random.uniform_in(0.4, 0.7) * size_m.z;
        let (lean, turn) = (random.uniform_in(-0.4, 0.4), random.uniform_in(-0.15, 0.15) * size_m.y);
        let from_m = body.blade(body.bounds.min_m.x - 0.005, y_m, depth_m, lean);
        let to_m = body.blade(body.bounds.min_m.x + 0.7 * size_m.x, y_m + turn, depth_m, lean);
        let (report, opened) = body.stroke(from_m, to_m)?;
        worst.add_area(&report);
        worst.add_shapes(&report);
        worst.add_body(&body, volume_m3);
        if stroke == 0 && name == "liver" {
            outcome.figures.push(figure(&opened, from_m, to_m, &report));
        }
    }
    outcome.experiments.extend(worst.experiments(&format!("{N_STROKES} strokes into a {name}")));
    Ok(())
}

/// Strokes that cross at right angles.
fn crossing_strokes(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = box_of_five([12, 12, 6], DVec3::new(0.06, 0.06, 0.03));
    let volume_m3 = mesh.volume_m3();
    let mut body = Body::new(mesh)?;
    outcome.notes.push_str(
        "Strokes that cross: area opened over area swept, smallest dihedral angle, steps with more snapping.\n\n\
         | stroke | area | angle [deg] | coarser |\n|---|---|---|---|\n",
    );
    let (mut swept_m2, mut cut_m2, mut worst) = (0.0, 0.0, Worst::new());
    for i in 0..N_CROSSING {
        let y_m = 0.0093 + 0.0101 * i as f64;
        let along_x = [body.blade(-0.004, y_m, 0.015, 0.1), body.blade(0.064, y_m, 0.015, 0.1)];
        let along_y = along_x.map(|blade| blade.map(|p| DVec3::new(p.y, p.x, p.z)));
        for (axis, [from_m, to_m]) in [("x", along_x), ("y", along_y)] {
            let (report, _) = body.stroke(from_m, to_m)?;
            swept_m2 += report.swept_area_m2;
            cut_m2 += report.cut_area_m2;
            worst.add_shapes(&report);
            outcome.notes.push_str(&format!(
                "| {i} along {axis} | {:.4} | {:.2} | {} of {} |\n",
                report.cut_area_m2 / report.swept_area_m2,
                report.min_dihedral_deg,
                report.n_coarser,
                report.n_edits
            ));
        }
    }
    worst.add_body(&body, volume_m3);
    let worst_live_deg = dihedral_angles_deg(&body.mesh.live_mesh()).into_iter().fold(180.0, f64::min);
    let what = format!("{} crossing strokes", 2 * N_CROSSING);
    outcome.experiments.extend([
        Experiment::near(
            &format!("{what}: area opened over area swept"),
            REQUIREMENT,
            cut_m2 / swept_m2,
            1.0,
            0.02,
        ),
        of_angles(
            &format!("{what}: smallest dihedral angle of the whole mesh [deg]"),
            worst.angle_deg.min(worst_live_deg),
        ),
    ]);
    outcome.experiments.extend(worst.of_bodies(&what));
    Ok(())
}

/// Strokes of a few edges, each in a whole box: corners and ends count for most.
fn short_strokes(outcome: &mut Outcome) -> anyhow::Result<()> {
    let mesh = box_of_five([16, 12, 8], DVec3::new(0.08, 0.06, 0.04));
    let edge_m = MeshQuality::of(&mesh).mean_edge_m;
    let mut random = SeededRandom::new(1);
    let mut worst = Worst::new();
    for _ in 0..N_SHORT {
        let mut body = Body::new(mesh.clone())?;
        let size_m = body.bounds.size_m();
        let [x_m, y_m] = [random.uniform_in(0.2, 0.5) * size_m.x, random.uniform_in(0.3, 0.7) * size_m.y];
        let depth_m = random.uniform_in(0.8, 3.0) * edge_m;
        let angle = random.uniform_in(0.0, std::f64::consts::TAU);
        let along = DVec3::new(angle.cos(), angle.sin(), 0.0);
        let from_m = body.blade(x_m, y_m, depth_m, random.uniform_in(-0.4, 0.4));
        let way_m = random.uniform_in(1.5, 5.0) * edge_m * along;
        let (report, _) = body.stroke(from_m, from_m.map(|p| p + way_m))?;
        // Along itself the blade sweeps little, which says nothing.
        if report.swept_area_m2 > edge_m * edge_m {
            worst.add_area(&report);
        }
        worst.add_shapes(&report);
    }
    let what = format!("{N_SHORT} strokes of 1.5 to 5 edges");
    outcome.experiments.extend([
        worst.of_area(&what),
        worst.of_new_angles(&what),
        Experiment::at_most(&format!("{what}: steps refused"), REQUIREMENT, worst.n_refused as f64, 0.0),
    ]);
    Ok(())
}

/// What came of many strokes, each in a whole body.
struct ManyStrokes {
    /// Difference of the area opened from the area swept, relative, and whether faces were told to be merged.
    shares: Vec<(f64, bool)>,
    /// Of shapes and bodies.
    worst: Worst,
    /// Strokes that were left out because they did not meet the body.
    n_missed: usize,
}

impl ManyStrokes {
    fn quantile(&self, share: f64) -> f64 {
        let mut off: Vec<f64> = self.shares.iter().map(|s| s.0).collect();
        off.sort_by(f64::total_cmp);
        off[((off.len() - 1) as f64 * share) as usize]
    }

    fn n_merged(&self) -> usize {
        self.shares.iter().filter(|s| s.1).count()
    }

    fn within(&self) -> impl Iterator<Item = f64> + '_ {
        self.shares.iter().filter(|s| !s.1).map(|s| s.0)
    }

    fn note(&self, what: &str) -> String {
        format!(
            "\n{what}: area opened against area swept, difference: median {:.4}, 90 % below {:.4}, 99 % below {:.4}, worst \
             {:.4}; {} within 2 %, {} reported as merged, {} neither; {} more did not meet the body.\n",
            self.quantile(0.5),
            self.quantile(0.9),
            self.quantile(0.99),
            self.quantile(1.0),
            self.shares.iter().filter(|s| s.0 <= 0.02).count(),
            self.n_merged(),
            self.within().filter(|off| *off > 0.02).count(),
            self.n_missed,
        )
    }
}

/// Strokes of 1.5 to 8 edges at random places of curved skin, 0.8 to 4 edges deep and leaning over by up to 45 degrees,
/// each in a whole body, at whatever angle to its skin.
fn many_strokes(mesh: &TetMesh) -> anyhow::Result<ManyStrokes> {
    let volume_m3 = mesh.volume_m3();
    let whole = Body::new(mesh.clone())?;
    let edge_m = MeshQuality::of(mesh).mean_edge_m;
    let skin: Vec<[DVec3; 3]> = {
        let topology = whole.mesh.topology();
        let places = |t| topology.outward_nodes(t).map(|n| whole.positions_m[n.index()]);
        topology.surface_triangles().map(places).collect()
    };
    let mut random = SeededRandom::new(11);
    let mut many = ManyStrokes { shares: Vec::with_capacity(N_RANDOM), worst: Worst::new(), n_missed: 0 };
    while many.shares.len() < N_RANDOM {
        let at = (random.uniform_in(0.0, skin.len() as f64) as usize).min(skin.len() - 1);
        let [a, b, c] = skin[at];
        let (middle_m, outward) = ((a + b + c) / 3.0, (b - a).cross(c - a).normalize());
        let (s, t) = outward.any_orthonormal_pair();
        let angle = random.uniform_in(0.0, std::f64::consts::TAU);
        let along = s * angle.cos() + t * angle.sin();
        let lean = random.uniform_in(-45.0f64, 45.0).to_radians();
        let up = outward * lean.cos() + outward.cross(along) * lean.sin();
        let half_m = 0.5 * random.uniform_in(1.5, 8.0) * edge_m * along;
        let depth_m = random.uniform_in(0.8, 4.0) * edge_m;
        let blade = |p: DVec3| [p - depth_m * up, p + 3.0 * edge_m * up];
        let (from_m, to_m) = (blade(middle_m - half_m), blade(middle_m + half_m));
        let mut body = Body::new(mesh.clone())?;
        let (report, _) = body.stroke(from_m, to_m)?;
        if report.swept_area_m2 == 0.0 {
            many.n_missed += 1;
            continue;
        }
        let off = (report.cut_area_m2 / report.swept_area_m2 - 1.0).abs();
        many.shares.push((off, report.n_merged > 0));
        many.worst.add_shapes(&report);
        many.worst.add_body(&body, volume_m3);
    }
    Ok(many)
}

/// No earlier cut is near: every stroke opens what it sweeps, but those that run along the skin and merge with it.
fn random_strokes(mesh: &TetMesh, outcome: &mut Outcome) -> anyhow::Result<()> {
    let what = format!("{N_RANDOM} random strokes into a liver, at every angle to its skin");
    let many = many_strokes(mesh)?;
    outcome.notes.push_str(&many.note(&what));
    outcome.experiments.extend([
        Experiment::at_most(
            &format!("{what}: neither within 2 % of the area swept nor reported as merged"),
            REQUIREMENT,
            many.within().filter(|off| *off > 0.02).count() as f64,
            0.0,
        ),
        Experiment::at_most(
            &format!("{what}: area opened against area swept, worst single stroke not reported as merged"),
            REQUIREMENT,
            many.within().fold(0.0, f64::max),
            0.02,
        ),
        Experiment::at_most(
            &format!("{what}: share of strokes reported as merged"),
            "choice: the requirement allows none at 15 degrees or more to earlier cuts",
            many.n_merged() as f64 / N_RANDOM as f64,
            0.01,
        ),
        many.worst.of_new_angles(&what),
    ]);
    outcome.experiments.extend(many.worst.of_bodies(&what));
    Ok(())
}

/// Where a stroke goes: corners of what it sweeps, in order.
struct Swept([DVec3; 4]);

impl Swept {
    fn normal(&self) -> DVec3 {
        (self.0[2] - self.0[0]).cross(self.0[3] - self.0[1]).normalize()
    }

    /// Points over it inside `bounds`.
    fn points_m(&self, bounds: &Aabb) -> Vec<DVec3> {
        const N: usize = 40;
        let [a, b, c, d] = self.0;
        let share = |i: usize| i as f64 / N as f64;
        let at = |i: usize, j: usize| a.lerp(d, share(i)).lerp(b.lerp(c, share(i)), share(j));
        let all = (0..=N).flat_map(|i| (0..=N).map(move |j| at(i, j)));
        all.filter(|&p| bounds.contains(p)).collect()
    }

    /// Whether it crosses another at the least angle or more, or keeps the least distance.
    fn is_apart(&self, other: &Self, bounds: &Aabb, edge_m: f64) -> bool {
        let (own, others) = (self.points_m(bounds), other.points_m(bounds));
        let distance2 =
            |p: &DVec3| others.iter().map(|q| p.distance_squared(*q)).fold(f64::INFINITY, f64::min);
        let distance_m = own.iter().map(distance2).fold(f64::INFINITY, f64::min).sqrt();
        // Between the points of both.
        let grid_m = [self, other].map(|s| s.0[0].distance(s.0[2]) / 40.0).into_iter().fold(0.0, f64::max);
        let beyond = |p: &DVec3| (*p - other.0[0]).dot(other.normal());
        let crosses = distance_m <= grid_m
            && own.iter().any(|p| beyond(p) > 0.0)
            && own.iter().any(|p| beyond(p) < 0.0);
        if crosses {
            let cosine = self.normal().dot(other.normal()).abs().min(1.0);
            return cosine.acos().to_degrees() >= LEAST_ANGLE_DEG;
        }
        distance_m >= LEAST_DISTANCE * edge_m + grid_m
    }
}

/// Blades of a stroke in some direction through the upper side of a body, at its begin and its end.
fn random_oblique(random: &mut SeededRandom, bounds: &Aabb) -> [[DVec3; 2]; 2] {
    let (low_m, size_m) = (bounds.min_m, bounds.size_m());
    let angle = random.uniform_in(0.0, std::f64::consts::TAU);
    let along = DVec3::new(angle.cos(), angle.sin(), 0.0);
    let lean = random.uniform_in(-0.5, 0.5);
    let down = DVec3::new(-along.y * lean, along.x * lean, 1.0).normalize();
    let [x_m, y_m] = [size_m.x, size_m.y].map(|s| random.uniform_in(0.2, 0.8) * s);
    let middle_m = DVec3::new(low_m.x + x_m, low_m.y + y_m, bounds.max_m.z);
    let depth_m = random.uniform_in(0.3, 0.7) * size_m.z;
    let half_m = 0.5 * random.uniform_in(0.3, 0.9) * size_m.x * along;
    [middle_m - half_m, middle_m + half_m].map(|p| [p - depth_m * down, p + 0.02 * down])
}

/// Strokes in all directions in one body, as near each other and at as small angles as the requirement has it.
fn oblique_strokes(name: &str, mesh: TetMesh, outcome: &mut Outcome) -> anyhow::Result<()> {
    let volume_m3 = mesh.volume_m3();
    let edge_m = MeshQuality::of(&mesh).mean_edge_m;
    let mut body = Body::new(mesh)?;
    let mut random = SeededRandom::new(2);
    let mut done: Vec<Swept> = Vec::new();
    outcome.notes.push_str(&format!(
        "\nStrokes in all directions in one {name}, each at {LEAST_ANGLE_DEG} degrees or more to those that it crosses \
         and {LEAST_DISTANCE} mean edges or more from the others.\n\n\
         | stroke | swept [mm2] | area | angle [deg] | coarser |\n|---|---|---|---|---|\n",
    ));
    let mut worst = Worst::new();
    while done.len() < N_OBLIQUE {
        let [from_m, to_m] = random_oblique(&mut random, &body.bounds);
        let swept = Swept([from_m[0], from_m[1], to_m[1], to_m[0]]);
        if !done.iter().all(|other| swept.is_apart(other, &body.bounds, edge_m)) {
            continue;
        }
        let (report, _) = body.stroke(from_m, to_m)?;
        // A stroke that only grazes an organ says nothing.
        if report.swept_area_m2 < edge_m * edge_m {
            continue;
        }
        done.push(swept);
        worst.add_area(&report);
        worst.add_shapes(&report);
        outcome.notes.push_str(&format!(
            "| {} | {:.1} | {:.4} | {:.2} | {} of {} |\n",
            done.len(),
            1e6 * report.swept_area_m2,
            report.cut_area_m2 / report.swept_area_m2,
            report.min_dihedral_deg,
            report.n_coarser,
            report.n_edits
        ));
    }
    worst.add_body(&body, volume_m3);
    let what = format!("{N_OBLIQUE} strokes in all directions in one {name}");
    outcome.experiments.extend(worst.experiments(&what));
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
