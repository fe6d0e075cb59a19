//! What the instruments of `bench scene` do: scene text of a tool and its path, from the organ's own shape.

use glam::DVec3;
use glisson::math::SeededRandom;
use glisson::mesh::TetMesh;

use crate::scripted::Path;

/// Depths of push and drag, ways of drag and lift [m].
const PUSH_DEPTH_M: f64 = 0.015;
const DRAG_DEPTH_M: f64 = 0.020;
const DRAG_WAY_M: f64 = 0.040;
const LIFT_M: f64 = 0.030;
/// How far above the organ an instrument waits [m].
const ABOVE_M: f64 = 0.03;
/// Speed of an instrument [m/s]: that of a careful hand.
const SPEED_M_PER_S: f64 = 0.05;
/// A stroke of the scalpel goes as fast [m/s], so deep [m] and so far [m].
const STROKE_SPEED_M_PER_S: f64 = 0.1;
const STROKE_DEPTH_M: f64 = 0.012;
const STROKE_M: f64 = 0.05;
const N_STROKES: usize = 8;
/// Points of a stroke, which follows the organ's front; nodes so near [m] tell where that is.
const N_POINTS: usize = 6;
const COLUMN_M: f64 = 0.012;
/// From a tip towards its handle.
const HANDLE: DVec3 = DVec3::new(0.0, -1.0, 0.2);
/// Seed of the strokes' places.
const SEED: u64 = 26;

/// A motion: what the scene calls it, and how its tool and path are written.
#[derive(Clone, Copy)]
pub(super) struct Motion {
    /// Name on the command line and in the result.
    pub(super) name: &'static str,
    /// Whether it edits the mesh.
    pub(super) cuts: bool,
    /// Scene text of the instrument, and how long it takes [s].
    pub(super) write: fn(&Place) -> (String, f64),
}

/// Every motion, in the order in which they run.
pub(super) const MOTIONS: &[Motion] = &[
    // Nothing touches the organ for half a second.
    Motion { name: "rest", cuts: false, write: rest },
    // A ball of 6 mm goes 15 mm into the organ and out again.
    Motion { name: "push", cuts: false, write: push },
    // A tip of 3 mm with friction 0.05 goes 20 mm in, 40 mm along and out again.
    Motion { name: "drag", cuts: false, write: drag },
    // Eight strokes of a scalpel, 12 mm deep and 50 mm long.
    Motion { name: "cut", cuts: true, write: cut },
    // Jaws close on the organ, lift it by 30 mm and let go.
    Motion { name: "grasp", cuts: false, write: grasp },
];

/// Where the organ is touched: the patient lies on the back, the instruments come from the front (-y).
pub(super) struct Place {
    /// The organ's foremost node near its middle, at rest [m].
    top_m: DVec3,
    /// Half sizes of the organ [m].
    half_m: DVec3,
    positions_m: Vec<DVec3>,
}

impl Place {
    pub(super) fn of(mesh: &TetMesh) -> Self {
        let start = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let [min_m, max_m] =
            mesh.positions_m.iter().fold(start, |[low, high], p| [low.min(*p), high.max(*p)]);
        let (middle_m, half_m) = (0.5 * (min_m + max_m), 0.5 * (max_m - min_m));
        // Within a quarter of the organ around its middle.
        let is_near = |p: &&DVec3| {
            let way = (**p - middle_m) / half_m;
            way.x.abs() < 0.25 && way.z.abs() < 0.25
        };
        let foremost = mesh.positions_m.iter().filter(is_near).min_by(|a, b| a.y.total_cmp(&b.y));
        let top_m = foremost.copied().unwrap_or(middle_m);
        Self { top_m, half_m, positions_m: mesh.positions_m.clone() }
    }

    /// A place so far in from the touched one [m], and to the side along x and z.
    fn at(&self, depth_m: f64, x_m: f64, z_m: f64) -> DVec3 {
        self.top_m + DVec3::new(x_m, depth_m, z_m)
    }
}

impl Place {
    /// A place `depth_m` under the front of the organ, to the side along x and z [m].
    fn under(&self, depth_m: f64, x_m: f64, z_m: f64) -> DVec3 {
        let at = self.at(0.0, x_m, z_m);
        let aside_m = |p: &DVec3| (p.x - at.x).hypot(p.z - at.z);
        let near = self.positions_m.iter().filter(|p| aside_m(p) < COLUMN_M);
        let front_m = near.map(|p| p.y).min_by(f64::total_cmp).unwrap_or(at.y);
        DVec3::new(at.x, front_m + depth_m, at.z)
    }
}

fn rest(at: &Place) -> (String, f64) {
    let home_m = at.at(-0.1, 0.0, 0.0);
    let mut path = Path::new("kind = \"probe\"\ntip_radius = \"6 mm\"\n", home_m, HANDLE);
    path.point(0.5, home_m, "");
    path.done()
}

fn push(at: &Place) -> (String, f64) {
    let home_m = at.at(-ABOVE_M, 0.0, 0.0);
    let mut path = Path::new("kind = \"probe\"\ntip_radius = \"6 mm\"\n", home_m, HANDLE);
    path.go(at.at(PUSH_DEPTH_M - 6e-3, 0.0, 0.0), SPEED_M_PER_S, "");
    path.go(home_m, SPEED_M_PER_S, "");
    path.done()
}

fn drag(at: &Place) -> (String, f64) {
    let home_m = at.at(-ABOVE_M, 0.0, 0.0);
    let mut path = Path::new("kind = \"probe\"\ntip_radius = \"3 mm\"\nfriction = 0.05\n", home_m, HANDLE);
    path.go(at.at(DRAG_DEPTH_M - 3e-3, 0.0, 0.0), SPEED_M_PER_S, "");
    path.go(at.at(DRAG_DEPTH_M - 3e-3, DRAG_WAY_M, 0.0), SPEED_M_PER_S, "");
    path.go(at.at(-ABOVE_M, DRAG_WAY_M, 0.0), SPEED_M_PER_S, "");
    path.done()
}

fn cut(at: &Place) -> (String, f64) {
    let home_m = at.at(-ABOVE_M, 0.0, 0.0);
    let mut path =
        Path::new("kind = \"scalpel\"\ntip_radius = \"1 mm\"\nblade_length = \"20 mm\"\n", home_m, HANDLE);
    let mut random = SeededRandom::new(SEED);
    let (on, off) = ("trigger = 1\n", "trigger = 0\n");
    for _ in 0..N_STROKES {
        let x_m = random.uniform_in(-0.3, 0.3) * at.half_m.x;
        let z_m = random.uniform_in(-0.3, 0.3) * at.half_m.z;
        let angle_rad = random.uniform_in(0.0, std::f64::consts::PI);
        let (along_x_m, along_z_m) = (STROKE_M * angle_rad.cos(), STROKE_M * angle_rad.sin());
        path.go(at.at(-ABOVE_M, x_m, z_m), 1.0, off);
        for i in 0..N_POINTS {
            let share = i as f64 / (N_POINTS - 1) as f64;
            let (x_m, z_m) = (x_m + share * along_x_m, z_m + share * along_z_m);
            path.go(at.under(STROKE_DEPTH_M, x_m, z_m), STROKE_SPEED_M_PER_S, on);
        }
        path.go(at.at(-ABOVE_M, x_m + along_x_m, z_m + along_z_m), STROKE_SPEED_M_PER_S, off);
    }
    path.done()
}

fn grasp(at: &Place) -> (String, f64) {
    let home_m = at.at(-ABOVE_M, 0.0, 0.0);
    let tool = "kind = \"grasper\"\ntip_radius = \"3 mm\"\njaw_length = \"20 mm\"\nhome_jaw = 1\n";
    let mut path = Path::new(tool, home_m, HANDLE);
    let (open, closed) = ("jaw = 1\n", "jaw = 0\n");
    let held_m = at.at(6e-3, 0.0, 0.0);
    path.go(held_m, SPEED_M_PER_S, open);
    path.point(0.2, held_m, closed);
    path.go(held_m - DVec3::Y * LIFT_M, SPEED_M_PER_S, closed);
    path.point(0.1, held_m - DVec3::Y * LIFT_M, closed);
    path.point(0.1, held_m - DVec3::Y * LIFT_M, open);
    path.done()
}
