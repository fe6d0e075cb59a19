//! Instruments as solids, in the tool's frame: the tip is at the origin, the handle at the end of +z, jaws open along x.
//!
//! Lengths, widths and radii are those that the simulator touches tissue with; what lies between is made up, as on the page
//! (`web/src/instruments`).

use super::look::Look;
use super::piece::{Piece, arc, lathed};
use glam::DVec3;
use glisson::record::snapshot::ToolSnapshot;
use glisson::tool::Tool;
use glisson::tool::pose::ToolFrame;

/// What the current of a hook may reach stands so far out of the insulation [m].
const BARE_HOOK_M: f64 = 0.012;
/// A blade is no wider than that of one of this length [m].
const WIDEST_BLADE_M: f64 = 0.03;
/// Half the thickness of a blade's back [m].
const BLADE_BACK_M: f64 = 0.3e-3;
/// Length of the grip, and the part of a short instrument that it is at most [m].
const GRIP_M: f64 = 0.09;
const GRIP_SHARE: f64 = 0.4;

const POLISHED: Look = Look::Metal;
const INSULATION: Look = Look::Plastic { colour: [30, 33, 37] };
const CERAMIC: Look = Look::Plastic { colour: [232, 224, 210] };
const GLASS: Look = Look::Plastic { colour: [11, 22, 32] };
const GRIP: Look = Look::Plastic { colour: [44, 52, 60] };

/// What jaws are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JawShape {
    /// To hold: broad.
    Broad,
    /// To seal or to clip: narrow.
    Narrow,
    /// To cut: two blades beside each other.
    Blades,
}

/// What an instrument ends in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WorkingEnd {
    /// A ball.
    Ball,
    /// An L of wire out of a ceramic collar.
    Hook,
    /// An edge from the tip backwards, the blade's back beside it.
    Blade {
        /// Length of the edge [m].
        length_m: f64,
    },
    /// Two jaws, closed at the tip.
    Jaws {
        /// From the hinge to the ends [m].
        length_m: f64,
        /// Along the hinge [m].
        width_m: f64,
        /// Angle between them now [rad].
        opening_rad: f64,
        /// Their shape.
        shape: JawShape,
    },
    /// An endoscope's window.
    Lens,
    /// An open tube with holes beside its mouth.
    Tube,
}

/// An instrument with a straight shaft.
#[derive(Clone, Copy, Debug)]
pub struct Instrument {
    /// Where it is.
    pub frame: ToolFrame,
    /// From the tip to the end of the handle [m].
    pub length_m: f64,
    /// Radius of the tip [m].
    pub tip_radius_m: f64,
    /// Radius of the shaft [m].
    pub shaft_radius_m: f64,
    /// What it ends in.
    pub end: WorkingEnd,
}

/// A working end, where the shaft begins behind it, and what that is made of.
struct End {
    parts: Vec<(Look, Piece)>,
    shaft_from_m: f64,
    shaft: Look,
}

fn turned(profile: &[[f64; 4]]) -> Piece {
    Piece::turned(DVec3::ZERO, DVec3::Z, profile)
}

/// Points on a smooth curve through `points` (E. Catmull and R. Rom 1974), `n` from one to the next.
fn smoothed(points: &[DVec3], n: usize) -> Vec<DVec3> {
    let at = |i: isize| points[i.clamp(0, points.len() as isize - 1) as usize];
    let mut all = Vec::new();
    for i in 0..points.len() as isize - 1 {
        let [a, b, c, d] = [at(i - 1), at(i), at(i + 1), at(i + 2)];
        for k in 0..n {
            let t = k as f64 / n as f64;
            let bent = 2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t * t;
            all.push(0.5 * (bent + (3.0 * b - a - 3.0 * c + d) * t * t * t));
        }
    }
    all.extend(points.last());
    all
}

fn hook(wire_m: f64, shaft_m: f64) -> End {
    let heel_m = -(3.0 * wire_m).max(2.4e-3);
    let bare = BARE_HOOK_M;
    let way = [
        [0.0, bare],
        [0.35 * heel_m, 0.72 * bare],
        [heel_m, 0.35 * bare],
        [heel_m, 0.6 * wire_m],
        [0.5 * heel_m, 0.0],
        [0.0, 0.0],
    ]
    .map(|[x, z]| DVec3::new(x, 0.0, z));
    let collar =
        [[wire_m, bare - 1e-3], [0.7 * shaft_m, bare], [shaft_m, bare + 4e-3], [shaft_m, bare + 6e-3]];
    let parts = vec![
        (POLISHED, Piece::wire(&smoothed(&way, 6), 0.75 * wire_m)),
        (POLISHED, turned(&arc(-wire_m, wire_m, wire_m))),
        (CERAMIC, turned(&lathed(&collar))),
    ];
    End { parts, shaft_from_m: bare + 6e-3, shaft: INSULATION }
}

fn scalpel(length_m: f64, shaft_m: f64) -> End {
    // How far along the edge, and how deep the blade is there.
    const OUTLINE: [[f64; 2]; 6] =
        [[0.0, 0.004], [0.1, 0.05], [0.25, 0.1], [0.55, 0.19], [1.0, 0.2], [1.15, 0.14]];
    let width_m = length_m.min(WIDEST_BLADE_M);
    let ring = |[share, depth]: [f64; 2]| {
        let (z, back) = (share * length_m, -depth * width_m);
        let half = BLADE_BACK_M * (depth / 0.2).min(1.0);
        [[0.0, 0.0], [back, half], [back, -half]].map(|[x, y]| DVec3::new(x, y, z)).to_vec()
    };
    let (from, to) = (1.08 * length_m, 1.08 * length_m + 4.0 * shaft_m);
    let holder = [[0.0, from], [0.6 * shaft_m, from], [shaft_m, to]];
    let parts = vec![(POLISHED, Piece::lofted(&OUTLINE.map(ring))), (POLISHED, turned(&lathed(&holder)))];
    End { parts, shaft_from_m: to, shaft: Look::Shaft }
}

/// One of two jaws in the frame of their hinge: along -z, on the side of +x.
fn jaw(length_m: f64, half_m: f64, thick_m: f64, shape: JawShape) -> Piece {
    // From the end to the hinge: how far from the hinge, and how broad and how thick it is there.
    const TONGUE: [[f64; 3]; 7] = [
        [1.0, 0.22, 0.3],
        [0.98, 0.55, 0.5],
        [0.93, 0.8, 0.7],
        [0.84, 0.93, 0.85],
        [0.5, 1.0, 1.0],
        [0.16, 0.97, 1.0],
        [0.0, 0.55, 1.0],
    ];
    const EDGE: [[f64; 2]; 6] =
        [[1.0, 0.1], [0.95, 0.35], [0.8, 0.7], [0.55, 1.05], [0.25, 1.25], [0.0, 1.1]];
    if shape == JawShape::Blades {
        let ring = |[share, outer]: [f64; 2]| {
            let (z, inner, outer, beside) =
                (-share * length_m, -0.2 * thick_m, outer * thick_m, 0.6 * thick_m);
            [[inner, 0.0], [outer, 0.0], [outer, beside], [inner, beside]]
                .map(|[x, y]| DVec3::new(x, y, z))
                .to_vec()
        };
        return Piece::lofted(&EDGE.map(ring));
    }
    let narrower = if shape == JawShape::Narrow { 0.55 } else { 1.0 };
    let ring = |[share, broad, thick]: [f64; 3]| {
        // Half an ellipse; its chord is the face that meets the other jaw.
        (0..=10)
            .map(|i| {
                let (sin, cos) = (std::f64::consts::PI * (f64::from(i) / 10.0 - 0.5)).sin_cos();
                DVec3::new(thick * thick_m * cos, narrower * broad * half_m * sin, -share * length_m)
            })
            .collect::<Vec<_>>()
    };
    Piece::lofted(&TONGUE.map(ring))
}

fn jaws(tip_m: f64, shaft_m: f64, [length_m, width_m, opening_rad]: [f64; 3], shape: JawShape) -> End {
    let (half_m, thick_m) = ((0.5 * width_m).max(tip_m), tip_m.max(0.5e-3));
    let mut parts = Vec::new();
    for side in [1.0, -1.0] {
        let (sin, cos) = (0.5 * side * opening_rad).sin_cos();
        let mut piece = jaw(length_m, half_m, thick_m, shape);
        let to_tool = |p: DVec3| {
            let (x, y) = (side * p.x, side * p.y);
            DVec3::new(x * cos - p.z * sin, y, x * sin + p.z * cos)
        };
        for place in &mut piece.positions {
            *place = (to_tool(place.as_dvec3()) + length_m * DVec3::Z).as_vec3();
        }
        for normal in &mut piece.normals {
            *normal = to_tool(normal.as_dvec3()).as_vec3();
        }
        parts.push((POLISHED, piece));
    }
    let outer = half_m.min(shaft_m);
    let knuckle = arc(-0.8 * outer, 0.8 * outer, 0.8 * outer);
    let raised: Vec<[f64; 4]> =
        knuckle.into_iter().map(|[z, r, nr, nz]| [z + length_m + 0.35 * outer, r, nr, nz]).collect();
    let from = length_m + outer;
    let fork = [[0.0, from], [0.75 * outer, from], [shaft_m, from + 1.5 * outer], [shaft_m, from + 4e-3]];
    parts.push((POLISHED, turned(&raised)));
    parts.push((POLISHED, turned(&lathed(&fork))));
    End { parts, shaft_from_m: from + 1.5 * outer, shaft: INSULATION }
}

fn lens(tip_m: f64) -> End {
    let disc = |from: f64, to: f64| turned(&[[0.0, from * tip_m, 0.0, -1.0], [0.0, to * tip_m, 0.0, -1.0]]);
    let sleeve = lathed(&[[0.86 * tip_m, 0.0], [tip_m, 0.0], [tip_m, 4.0 * tip_m]]);
    let light = Look::Sign { colour: [255, 246, 230] };
    let parts = vec![
        (GLASS, disc(0.0, 0.5)),
        (POLISHED, disc(0.5, 0.56)),
        (light, disc(0.56, 0.86)),
        (POLISHED, turned(&sleeve)),
    ];
    End { parts, shaft_from_m: 4.0 * tip_m, shaft: Look::Shaft }
}

fn tube(tip_m: f64) -> End {
    let rim =
        [[0.62, 0.3], [0.66, -0.75], [0.85, -0.95], [1.0, -0.7], [1.0, 6.0]].map(|p| p.map(|x| x * tip_m));
    let bore = turned(&[[-0.3 * tip_m, 0.0, 0.0, -1.0], [-0.3 * tip_m, 0.64 * tip_m, 0.0, -1.0]]);
    let mut parts = vec![(POLISHED, turned(&lathed(&rim))), (GLASS, bore)];
    // Four holes in each of three rings, each ring's between those of the one before.
    for hole in 0..12 {
        let (ring, place) = (hole / 4, f64::from(2 * (hole % 4) + hole / 4 % 2));
        let (sin, cos) = (0.25 * std::f64::consts::PI * place).sin_cos();
        let out = DVec3::new(cos, sin, 0.0);
        let middle = out * (0.965 * tip_m) + DVec3::Z * ((1.0 + 1.6 * f64::from(ring)) * tip_m);
        let wide_m = 0.24 * tip_m;
        let cap = [[0.07 * tip_m, 0.0, 0.0, 1.0], [0.07 * tip_m, wide_m, 0.0, 1.0]];
        parts.push((GLASS, Piece::turned(middle, out, &cap)));
    }
    End { parts, shaft_from_m: 6.0 * tip_m, shaft: Look::Shaft }
}

impl Instrument {
    /// All instruments of a simulation as they are now.
    pub fn all(tools: &[Tool], now: &[ToolSnapshot]) -> Vec<Self> {
        tools.iter().zip(now).map(|(tool, now)| Self::of(tool, now)).collect()
    }

    /// An instrument of a simulation as it is now.
    pub fn of(tool: &Tool, now: &ToolSnapshot) -> Self {
        let jaws = |shape| {
            move |jaws: &glisson::tool::Jaws| WorkingEnd::Jaws {
                length_m: jaws.length_m,
                width_m: jaws.width_m,
                opening_rad: jaws.opening_rad(now.pose.jaw_opening),
                shape,
            }
        };
        let kind = &tool.kind;
        let shape = match (kind.parting_jaws(), kind.sets_clips() || kind.burning().is_some()) {
            (Some(_), _) => JawShape::Blades,
            (None, true) => JawShape::Narrow,
            (None, false) => JawShape::Broad,
        };
        let end = if kind.optics().is_some() {
            WorkingEnd::Lens
        } else if let Some(end) = kind.jaws().map(jaws(shape)) {
            end
        } else if let Some(blade) = kind.blade() {
            WorkingEnd::Blade { length_m: blade.length_m }
        } else if kind.burning().is_some() {
            WorkingEnd::Hook
        } else if kind.rinses() {
            WorkingEnd::Tube
        } else {
            WorkingEnd::Ball
        };
        let pose = now.pose.moved_by(now.shown_further_out_m);
        Self {
            frame: ToolFrame::of(&pose),
            length_m: tool.shaft_length_m,
            tip_radius_m: tool.tip_radius_m,
            shaft_radius_m: tool.shaft_radius_m,
            end,
        }
    }

    fn end(&self) -> End {
        let (tip_m, shaft_m) = (self.tip_radius_m, self.shaft_radius_m);
        match self.end {
            WorkingEnd::Ball => {
                let shaft_from_m = (tip_m * tip_m - shaft_m * shaft_m).max(0.0).sqrt();
                let ball = turned(&arc(-tip_m, tip_m, tip_m));
                End { parts: vec![(POLISHED, ball)], shaft_from_m, shaft: Look::Shaft }
            }
            WorkingEnd::Hook => hook(tip_m.min(0.9e-3), shaft_m),
            WorkingEnd::Blade { length_m } => scalpel(length_m, shaft_m),
            WorkingEnd::Jaws { length_m, width_m, opening_rad, shape } => {
                jaws(tip_m, shaft_m, [length_m, width_m, opening_rad], shape)
            }
            WorkingEnd::Lens => lens(tip_m),
            WorkingEnd::Tube => tube(tip_m),
        }
    }

    /// Its solids in its own frame.
    pub(super) fn parts(&self) -> Vec<(Look, Piece)> {
        let End { mut parts, shaft_from_m, shaft } = self.end();
        let radius = self.shaft_radius_m;
        let to = self.length_m.max(shaft_from_m);
        let grip_from = to - GRIP_M.min(GRIP_SHARE * (to - shaft_from_m));
        parts
            .push((shaft, turned(&lathed(&[[radius, shaft_from_m], [radius, grip_from], [0.0, grip_from]]))));
        let thick = 1.9 * radius;
        let grip = [
            [radius, grip_from],
            [thick, grip_from + 6e-3],
            [thick, to - 4e-3],
            [0.7 * thick, to],
            [0.0, to],
        ];
        if to > shaft_from_m {
            parts.push((GRIP, turned(&lathed(&grip))));
        }
        parts
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::tool::{Blade, BladeCuts, Burnt, CutRule, Jaws, Optics, Snip, ToolInput, ToolKind};

    const JAWS: Jaws =
        Jaws { length_m: 0.02, width_m: 4e-3, greatest_opening_rad: 0.8, closing_force_n: 5.0 };

    fn instrument(kind: ToolKind) -> Instrument {
        let pose = ToolInput { jaw_opening: 0.5, ..ToolInput::at(DVec3::X, DVec3::NEG_Y) };
        let tool = Tool { kind, ..Tool::probe("it", 2e-3, pose) };
        let now = ToolSnapshot {
            pose,
            shown_further_out_m: DVec3::Y * 0.001,
            force_n: DVec3::ZERO,
            contacts: [None; 3],
            n_held_nodes: 0,
        };
        Instrument::of(&tool, &now)
    }

    #[test]
    fn every_kind_has_its_end_and_reaches_from_the_tip_to_the_handle() {
        let blade = Blade { length_m: 0.03, edge_radius_m: 0.0, cuts: BladeCuts::Embedded };
        let burning =
            CutRule { least_force_n: 0.0, least_time_s: 0.0, power_w: 0.0, takes: Burnt::Tetrahedra };
        let optics = Optics { view_angle_rad: 0.5, field_of_view_rad: 1.2 };
        let jaws = |shape| WorkingEnd::Jaws { length_m: 0.02, width_m: 4e-3, opening_rad: 0.4, shape };
        for (kind, end) in [
            (ToolKind::PROBE, WorkingEnd::Ball),
            (ToolKind::grasper(JAWS), jaws(JawShape::Broad)),
            (ToolKind::scissors(JAWS, Snip::Embedded), jaws(JawShape::Blades)),
            (ToolKind::cautery(JAWS, burning), jaws(JawShape::Narrow)),
            (ToolKind::scalpel(blade), WorkingEnd::Blade { length_m: 0.03 }),
            (ToolKind::hook(burning), WorkingEnd::Hook),
            (ToolKind::endoscope(optics), WorkingEnd::Lens),
            (ToolKind::SUCTION, WorkingEnd::Tube),
        ] {
            let instrument = instrument(kind);
            assert_eq!(instrument.end, end);
            assert_eq!(instrument.frame.tip_in_world_m, DVec3::new(1.0, 0.001, 0.0));
            let pieces: Vec<Piece> = instrument.parts().into_iter().map(|(_, piece)| piece).collect();
            let places: Vec<_> = pieces.iter().flat_map(|piece| piece.positions.iter()).collect();
            let (low, high) = places.iter().fold((f32::MAX, f32::MIN), |(a, b), p| (a.min(p.z), b.max(p.z)));
            assert!(low > -2.1e-3 && low < 2.1e-3, "{end:?} begins at {low}");
            assert!((high - 0.3).abs() < 1e-6, "{end:?} ends at {high}");
            assert!(places.iter().all(|p| p.is_finite() && p.x.hypot(p.y) < 0.012), "{end:?}");
            for normal in pieces.iter().flat_map(|piece| &piece.normals) {
                assert!((normal.length() - 1.0).abs() < 1e-3, "{end:?} has the normal {normal}");
            }
        }
    }
}
