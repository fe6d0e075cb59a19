//! Pictures of shapes whose picture is known, and of an organ to look at.

use glam::DVec3;
use glisson::math::{Aabb, DMat3};
use glisson::tool::ToolInput;
use glisson::tool::endoscope::Eye;
use glisson::tool::pose::ToolFrame;

use super::*;

/// Unit sphere: an icosahedron, each triangle split in four `splits` times.
fn unit_sphere(splits: usize) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut points: Vec<DVec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(|p| DVec3::from_array(p).normalize())
    .to_vec();
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    for _ in 0..splits {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32, points: &mut Vec<DVec3>| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                points.push((points[a as usize] + points[b as usize]).normalize());
                (points.len() - 1) as u32
            })
        };
        triangles = triangles
            .iter()
            .flat_map(|&[a, b, c]| {
                let ab = middle(a, b, &mut points);
                let bc = middle(b, c, &mut points);
                let ca = middle(c, a, &mut points);
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    (points, triangles)
}

fn sphere(center_m: DVec3, radius_m: f64, look: Look) -> ShadedSurface {
    let (points, triangles) = unit_sphere(3);
    let positions_m: Vec<DVec3> = points.iter().map(|&p| center_m + radius_m * p).collect();
    ShadedSurface { rest_positions_m: positions_m.clone(), positions_m, triangles, look }
}

fn scene(surfaces: Vec<ShadedSurface>, size: [usize; 2]) -> PictureScene {
    let points_m: Vec<DVec3> = surfaces.iter().flat_map(|s| s.positions_m.iter().copied()).collect();
    let camera = Camera::framing_points(&points_m, size, View::default());
    PictureScene { surfaces, instruments: Vec::new(), arrows: Vec::new(), captions: Vec::new(), camera, size }
}

/// Something like a liver: a thick right lobe, a thin left one, a fissure between; 28 x 16 x 9 cm.
fn two_lobed_blob(splits: usize) -> ShadedSurface {
    let (points, triangles) = unit_sphere(splits);
    let smooth = |low: f64, high: f64, x: f64| {
        let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let positions_m: Vec<DVec3> = points
        .iter()
        .map(|p| {
            let thin = 1.0 - 0.58 * smooth(-0.35, 0.95, p.x);
            let below = (-p.z).max(0.0);
            let fissure = 0.030 * (-((p.x - 0.22) / 0.085).powi(2)).exp() * (0.25 + below);
            let hollow = 0.022 * below * below;
            DVec3::new(
                0.142 * p.x,
                0.082 * thin * p.y + fissure * p.y.signum() * p.y.abs().min(0.5) * -1.2,
                0.080 * thin * p.z + fissure + hollow + 0.012 * p.x,
            )
        })
        .collect();
    ShadedSurface { rest_positions_m: positions_m.clone(), positions_m, triangles, look: Look::Liver }
}

/// The blob pushed in by the ball of an instrument.
fn pushed_blob(splits: usize) -> (ShadedSurface, Instrument) {
    let mut blob = two_lobed_blob(splits);
    let place = DVec3::new(-0.045, -0.074, 0.018);
    let inward = DVec3::new(0.1, 0.97, -0.22).normalize();
    let tip_radius_m = 0.006;
    let nearest = *blob
        .rest_positions_m
        .iter()
        .min_by(|a, b| a.distance_squared(place).total_cmp(&b.distance_squared(place)))
        .unwrap();
    let depth_m = 0.016;
    for p in &mut blob.positions_m {
        let r = p.distance(nearest);
        *p += depth_m * inward / (1.0 + (r / 0.016).powi(2)).powf(1.2);
    }
    let tip_m = nearest + inward * (depth_m - tip_radius_m);
    let shaft = DVec3::new(-0.42, -0.78, 0.46).normalize();
    let instrument = Instrument {
        frame: ToolFrame::of(&ToolInput::at(tip_m, shaft)),
        length_m: 0.3,
        tip_radius_m,
        shaft_radius_m: 0.0035,
        end: WorkingEnd::Ball,
    };
    (blob, instrument)
}

#[test]
fn a_sphere_covers_what_geometry_says() {
    // Outline of a sphere of radius R at distance D: a disc of radius focal * R / sqrt(D^2 - R^2).
    let mut scene = scene(vec![sphere(DVec3::new(0.3, -0.2, 1.1), 0.1, Look::Kidney)], [300, 200]);
    scene.camera.eye_m = scene.camera.target_m + DVec3::new(0.0, -0.6, 0.0);
    let facets = geometry::Facets::of_scene(&scene).unwrap();
    let samples = raster::Samples::of_view(&facets, &scene.camera, scene.size);
    let area: f32 =
        (0..300 * 200).flat_map(|pixel| samples.of_pixel(pixel)).map(|fragment| fragment.coverage).sum();
    let focal = 100.0 / (0.5 * scene.camera.vertical_field_of_view_rad).tan();
    let radius = focal * 0.1 / (0.36f64 - 0.01).sqrt();
    let expected = std::f64::consts::PI * radius * radius;
    assert!((f64::from(area) / expected - 1.0).abs() < 0.003, "{area} instead of {expected} pixels");
}

#[test]
fn the_nearer_sphere_hides_the_farther() {
    // Blue vein before yellow fat seen from the front, hidden from the back.
    let near = sphere(DVec3::new(0.0, -0.3, 0.0), 0.05, Look::Vein);
    let far = sphere(DVec3::new(0.0, 0.3, 0.0), 0.1, Look::Fat);
    for surfaces in [[near.clone(), far.clone()], [far, near]] {
        let mut scene = scene(surfaces.to_vec(), [120, 120]);
        scene.camera.target_m = DVec3::ZERO;
        for (eye_y, blue_wins) in [(-1.5, true), (1.5, false)] {
            scene.camera.eye_m = DVec3::new(0.0, eye_y, 0.0);
            let [red, _, blue] = Picture::render(&scene).unwrap().pixel(60, 60);
            assert_eq!(blue > red, blue_wins, "seen from y = {eye_y}");
        }
    }
}

#[test]
fn the_default_view_has_the_patients_left_on_the_right_and_the_head_on_top() {
    let left = sphere(DVec3::new(0.1, 0.0, 0.0), 0.04, Look::Vein);
    let head = sphere(DVec3::new(0.0, 0.0, 0.2), 0.04, Look::Fat);
    let scene = scene(vec![left, head], [200, 200]);
    let projection = camera::Projection::new(&scene.camera, scene.size);
    let place = |p: DVec3| projection.to_pixels(projection.to_camera((p - scene.camera.target_m).as_vec3()));
    let (left, head) = (place(DVec3::new(0.1, 0.0, 0.0)), place(DVec3::new(0.0, 0.0, 0.2)));
    assert!(left[0] > head[0] + 20.0 && left[1] > head[1] + 50.0);
    // Everything is in the frame, and fills it in one direction.
    for surface in &scene.surfaces {
        for &p in &surface.positions_m {
            let [x, y] = place(p);
            assert!((0.0..200.0).contains(&x) && (0.0..200.0).contains(&y), "{p} falls on {x}, {y}");
        }
    }
}

#[test]
fn the_same_scene_gives_the_same_bytes_at_any_thread_count() {
    let (blob, instrument) = pushed_blob(3);
    let mut scene = scene(vec![blob], [160, 100]);
    scene.arrows.push(Arrow {
        from_m: instrument.frame.tip_in_world_m,
        to_m: instrument.frame.tip_in_world_m + DVec3::new(0.06, 0.0, 0.04),
        radius_m: 0.002,
        colour: [250, 200, 60],
    });
    scene.instruments.push(instrument);
    scene.captions.push(Caption { text: "2.41 N".to_owned(), place: CaptionPlace::BottomLeft });
    let pictures = [1, 1, 3].map(|n| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
        pool.install(|| Picture::render(&scene).unwrap())
    });
    assert!(pictures[0] == pictures[1] && pictures[0] == pictures[2]);
    // And it is not blank: the arrow is seen before everything.
    let arrow = pictures[0].rgb.chunks_exact(3).filter(|p| p[0] > 180 && p[1] > 120 && p[2] < 110).count();
    assert!(arrow > 40, "{arrow} pixels of the arrow");
}

#[test]
fn a_png_holds_the_pixels() {
    let scene = scene(vec![sphere(DVec3::ZERO, 0.1, Look::Spleen)], [40, 30]);
    let picture = Picture::render(&scene).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.png");
    picture.write_png(&path).unwrap();
    let file = std::io::BufReader::new(std::fs::File::open(&path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!(([info.width, info.height], bytes), ([40, 30], picture.rgb));
}

#[test]
fn bad_scenes_are_errors_that_say_where() {
    let good = scene(vec![sphere(DVec3::ZERO, 0.1, Look::Liver)], [40, 30]);
    let message = |change: &dyn Fn(&mut PictureScene)| {
        let mut bad = good.clone();
        change(&mut bad);
        Picture::render(&bad).unwrap_err().to_string()
    };
    assert!(message(&|s| s.size = [0, 30]).contains("0 x 30"));
    assert!(message(&|s| s.surfaces[0].triangles[5] = [0, 1, 9999]).contains("triangle 5: vertex 9999"));
    assert!(message(&|s| s.surfaces[0].positions_m[7].x = f64::NAN).contains("vertex 7"));
    assert!(message(&|s| s.surfaces[0].rest_positions_m.truncate(3)).contains("3 rest positions"));
}

#[test]
fn an_empty_scene_and_a_point_sized_organ_do_not_panic() {
    let empty = PictureScene {
        camera: Camera::framing(Aabb { min_m: DVec3::ZERO, max_m: DVec3::ONE }, [10, 10], View::default()),
        ..scene(vec![sphere(DVec3::ZERO, 0.1, Look::Liver)], [10, 10])
    };
    Picture::render(&PictureScene { surfaces: Vec::new(), ..empty }).unwrap();
    Picture::render(&scene(vec![sphere(DVec3::ZERO, 0.0, Look::Liver)], [10, 10])).unwrap();
}

/// A look that nothing else in these scenes has.
const SIGN: Look = Look::Sign { colour: [20, 240, 60] };

/// How many pixels are of [`SIGN`]'s colour, and the middle of these.
fn signs(picture: &Picture) -> (usize, [f64; 2]) {
    let (mut n, mut sum) = (0, [0.0; 2]);
    for (place, pixel) in picture.rgb.chunks_exact(3).enumerate() {
        if pixel[1] > 90 && pixel[0] < 90 && pixel[2] < 110 {
            n += 1;
            let [x, y] = [place % picture.size[0], place / picture.size[0]];
            sum = [sum[0] + x as f64, sum[1] + y as f64];
        }
    }
    (n, sum.map(|s| s / n.max(1) as f64))
}

#[test]
fn an_endoscope_sees_a_circle_with_what_is_before_it() {
    // From the front along +y, upright.
    let eye = Eye {
        position_in_world_m: DVec3::new(0.0, -0.1, 0.0),
        forward_in_world: DVec3::Y,
        up_in_world: DVec3::Z,
        field_of_view_rad: 1.2,
    };
    // To the patient's left and headwards: right and up in the picture.
    let before = sphere(DVec3::new(0.02, 0.0, 0.03), 0.008, SIGN);
    let behind = sphere(DVec3::new(-0.02, -0.2, 0.0), 0.008, SIGN);
    let mut scene = scene(vec![before, behind], [240, 160]);
    scene.camera = Camera::through(&eye);
    let picture = Picture::render(&scene).unwrap();
    let (n, [x, y]) = signs(&picture);
    let focal = 80.0 / 0.6f64.tan();
    assert!(
        (x - (120.0 + 0.2 * focal)).abs() < 3.0 && (y - (80.0 - 0.3 * focal)).abs() < 3.0,
        "{n} at {x}, {y}"
    );
    // Black outside of the circle, which touches the upper and the lower edge.
    for [column, row] in [[0, 0], [239, 0], [0, 159], [39, 80], [201, 80]] {
        assert_eq!(picture.pixel(column, row), [0; 3], "{column}, {row}");
    }
    assert_ne!(picture.pixel(120, 2), [0; 3]);
    // Twice as near and half as large, a thing is lit as brightly: the lamp is turned down.
    let mut grey = |scale: f64| {
        let plate =
            sphere(DVec3::new(0.0, -0.1 + 0.1 * scale, 0.0), 0.04 * scale, Look::Plastic { colour: [64; 3] });
        scene.surfaces = vec![plate];
        // Beside the lamp's own image.
        Picture::render(&scene).unwrap().pixel(150, 80)[1]
    };
    let [far, near] = [grey(1.0), grey(0.5)];
    assert!(far.abs_diff(near) <= 2 && (40..200).contains(&far), "{far} far away, {near} near");
}

#[test]
fn jaws_open_to_both_sides_of_the_tip_and_close_on_it() {
    let picture = |opening_rad: f64| {
        let instrument = Instrument {
            // Along -z of the picture: the handle is up, jaws open to left and right.
            frame: ToolFrame { world_from_tool: DMat3::IDENTITY, tip_in_world_m: DVec3::ZERO },
            length_m: 0.1,
            tip_radius_m: 1e-3,
            shaft_radius_m: 2.5e-3,
            end: WorkingEnd::Jaws { length_m: 0.02, width_m: 4e-3, opening_rad, shape: JawShape::Broad },
        };
        let mut scene = scene(vec![sphere(DVec3::ZERO, 0.02, Look::Liver)], [200, 200]);
        scene.surfaces.clear();
        scene.instruments.push(instrument);
        scene.camera = Camera { eye_m: DVec3::new(0.0, -0.3, 0.0), target_m: DVec3::ZERO, ..scene.camera };
        Picture::render(&scene).unwrap()
    };
    let empty = Picture::render(&scene(Vec::new(), [200, 200])).unwrap();
    let focal = 100.0 / 14f64.to_radians().tan();
    let is_metal = |picture: &Picture, x_m: f64, z_m: f64| {
        let at = [x_m, -z_m].map(|d| (100.0 + focal * d / 0.3).floor() as usize);
        picture.pixel(at[0], at[1]) != empty.pixel(at[0], at[1])
    };
    let (closed, open) = (picture(0.0), picture(1.0));
    // The ends lie 20 mm from the hinge, half a radian to each side; a jaw is outside of that.
    let (sin, cos) = 0.515f64.sin_cos();
    let end = [0.0185 * sin, 0.02 - 0.0185 * cos];
    for side in [1.0, -1.0] {
        assert!(
            is_metal(&open, side * end[0], end[1]) && !is_metal(&closed, side * end[0], end[1]),
            "{side}"
        );
    }
    assert!(is_metal(&closed, 0.0004, 0.002) && !is_metal(&open, 0.0004, 0.002));
    assert!(is_metal(&closed, 0.0, 0.05) && is_metal(&open, 0.0, 0.05));
}

#[test]
fn depth_and_surface_of_each_pixel_are_those_of_what_is_seen() {
    let (positions_m, triangles) = unit_sphere(3);
    let surface = |x_m: f64| ShadedSurface {
        positions_m: positions_m.iter().map(|p| *p + DVec3::X * x_m).collect(),
        rest_positions_m: positions_m.clone(),
        triangles: triangles.clone(),
        look: Look::Liver,
    };
    let camera = Camera {
        eye_m: DVec3::new(0.0, 0.0, 10.0),
        target_m: DVec3::ZERO,
        up: DVec3::Y,
        ..Camera::framing(
            Aabb::of_points(&positions_m),
            [65, 65],
            View { azimuth_rad: 0.0, elevation_rad: 0.0 },
        )
    };
    let scene = PictureScene {
        surfaces: vec![surface(0.0), surface(2.5)],
        instruments: Vec::new(),
        arrows: Vec::new(),
        captions: Vec::new(),
        camera: Camera { vertical_field_of_view_rad: 0.7, ..camera },
        size: [65, 65],
    };
    let seen = scene.depths_and_surfaces().unwrap();
    let at = |x: usize, y: usize| seen[y * 65 + x];
    let middle = at(32, 32).unwrap();
    assert_eq!(middle.surface, Some(0));
    assert!((middle.depth_m - 9.0).abs() < 0.02, "{middle:?}");
    // Rays that pass the first ball meet nothing, or the second.
    assert_eq!(at(0, 0), None);
    // 2.5 to the right and 10 away: 32.5 / tan(0.35) * 0.25 pixels from the middle.
    let right = at(32 + 22, 32).unwrap();
    assert_eq!(right.surface, Some(1));
    assert!(right.depth_m > 9.0 && right.depth_m < 10.0, "{right:?}");
    // The same pixels show something as in the picture.
    let picture = Picture::render(&scene).unwrap();
    assert_ne!(picture.pixel(32, 32), picture.pixel(0, 0));
}
