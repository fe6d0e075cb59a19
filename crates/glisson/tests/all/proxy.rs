//! The proxy on planes, spheres, ridges and valleys, against what geometry and Coulomb's law say.

use glisson::contact::proxy::{Proxy, ProxyForce, ProxyParams, ProxyState, ProxySurface};
use glisson::contact::proxy_surface::SurfaceAdjacency;
use glisson::contact::triangles::{at_weights, closest_weights};
use glisson::haptics::mapping::{MappedDevice, patient_from_desk};
use glisson::haptics::{DeviceMapping, DeviceState};
use glisson::math::{DVec3, SeededRandom};

struct Sheet {
    positions_m: Vec<DVec3>,
    adjacency: SurfaceAdjacency,
    triangles: Vec<[u32; 3]>,
}

impl Sheet {
    fn new(positions_m: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> Self {
        let adjacency = SurfaceAdjacency::new(positions_m.len(), &triangles, 8);
        assert!(adjacency.is_consistent());
        Self { positions_m, adjacency, triangles }
    }

    /// A grid of n by n cells over [-1, 1]^2 m, at the height that `height_m` gives; seen from above.
    fn grid(n: usize, height_m: impl Fn(f64, f64) -> f64) -> Self {
        let at = |i: usize| 2.0 * i as f64 / n as f64 - 1.0;
        let mut positions_m = Vec::new();
        let mut triangles = Vec::new();
        for j in 0..=n {
            for i in 0..=n {
                positions_m.push(DVec3::new(at(i), at(j), height_m(at(i), at(j))));
            }
        }
        let id = |i: usize, j: usize| (i + (n + 1) * j) as u32;
        for j in 0..n {
            for i in 0..n {
                triangles.push([id(i, j), id(i + 1, j), id(i + 1, j + 1)]);
                triangles.push([id(i, j), id(i + 1, j + 1), id(i, j + 1)]);
            }
        }
        Self::new(positions_m, triangles)
    }

    /// An octahedron divided n times, on the unit sphere.
    fn sphere(n: usize) -> Self {
        let mut positions_m = vec![DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
        let mut triangles =
            vec![[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]];
        for _ in 0..n {
            let mut middles = std::collections::BTreeMap::new();
            let mut middle = |a: u32, b: u32| {
                *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                    positions_m.push((positions_m[a as usize] + positions_m[b as usize]).normalize());
                    positions_m.len() as u32 - 1
                })
            };
            triangles = triangles
                .iter()
                .flat_map(|&[a, b, c]| {
                    let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        Self::new(positions_m, triangles)
    }

    fn surface(&self) -> ProxySurface<'_> {
        ProxySurface { positions_m: &self.positions_m, adjacency: &self.adjacency }
    }

    /// The proxy at the point of the surface nearest to `point_m`.
    fn proxy(&self, point_m: DVec3) -> Proxy {
        let nearest = |t: &[u32; 3]| {
            let corners_m = t.map(|v| self.positions_m[v as usize]);
            let weights = closest_weights(point_m, corners_m);
            (at_weights(corners_m, weights).distance(point_m), weights)
        };
        let (slot, weights) = self
            .triangles
            .iter()
            .enumerate()
            .map(|(slot, t)| (slot, nearest(t)))
            .min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0))
            .map(|(slot, (_, weights))| (slot, weights))
            .unwrap();
        Proxy::at(&self.surface(), slot as u32, weights).unwrap()
    }

    fn nearest_m(&self, point_m: DVec3) -> DVec3 {
        self.proxy(point_m).point_m(&self.positions_m)
    }
}

const K: f64 = 100.0;

fn rough(friction: f64) -> ProxyParams {
    ProxyParams { static_friction: friction, kinetic_friction: friction, ..ProxyParams::frictionless(K) }
}

#[test]
fn on_a_plane_the_proxy_lags_by_friction_times_depth() {
    let plane = Sheet::grid(7, |_, _| 0.0);
    let start_m = DVec3::new(-0.7, -0.31, 0.0);
    let way = DVec3::new(0.8, 0.6, 0.0);
    for (friction, depth_m) in [(0.0, 0.1), (0.3, 0.2), (0.8, 0.05)] {
        let mut proxy = plane.proxy(start_m);
        for step in 0..=100 {
            let moved_m = 0.01 * f64::from(step);
            let tool_m = start_m + way * moved_m - DVec3::Z * depth_m;
            let felt = proxy.advance(&plane.surface(), tool_m, &rough(friction));
            let slipped_m = (moved_m - friction * depth_m).max(0.0);
            assert!(felt.point_m.distance(start_m + way * slipped_m) < 1e-9, "{friction} {step} {felt:?}");
            let expected_n = K * (DVec3::Z * depth_m - way * moved_m.min(friction * depth_m));
            assert!(felt.on_tool_n.distance(expected_n) < 1e-7, "{felt:?} {expected_n}");
            let slides = moved_m > friction * depth_m + 1e-9;
            assert!((felt.state == ProxyState::Slides) == slides, "{friction} {step} {felt:?}");
            assert!((felt.depth_m - depth_m).abs() < 1e-12 && felt.normal == DVec3::Z);
        }
    }
}

/// Seed `001`, s. 5: F = -k dx, with dx in the frame of the device.
#[test]
fn a_hand_feels_its_way_from_the_proxy_in_the_devices_frame() {
    let plane = Sheet::grid(7, |_, _| 0.0);
    let (motion_scale, force_scale) = (0.5, 2.0);
    let mut mapped = MappedDevice::new(&DeviceMapping {
        world_from_device: patient_from_desk(),
        motion_scale,
        force_scale,
        device_origin_m: DVec3::new(0.1, 0.2, -0.1),
        ..DeviceMapping::default()
    });
    let mut device = DeviceState {
        position_m: DVec3::new(0.1, 0.2, -0.1),
        velocity_m_per_s: DVec3::ZERO,
        orientation: None,
        jaw_opening: 1.0,
        buttons: 0,
    };
    let touched = mapped.to_world(&device);
    let mut proxy = plane.proxy(touched.tip_m);
    let begun_m = device.position_m;
    // The device's +z, to its user, is the world's -z: into the plane.
    for dx_m in [DVec3::new(0.0, 0.0, 0.01), DVec3::new(0.004, -0.003, 0.02), DVec3::new(-0.01, 0.02, 0.03)] {
        device.position_m = begun_m + dx_m;
        let handle = mapped.to_world(&device);
        let felt = proxy.advance(&plane.surface(), handle.tip_m, &rough(f64::INFINITY));
        assert_eq!(felt.state, ProxyState::Sticks);
        let at_hand_n = mapped.to_device(felt.on_tool_n, handle.arm_m).force_n;
        let expected_n = -K * motion_scale * force_scale * dx_m;
        assert!(at_hand_n.distance(expected_n) < 1e-12, "{at_hand_n} {expected_n}");
    }
}

#[test]
fn static_friction_holds_longer_than_kinetic_friction_drags() {
    let plane = Sheet::grid(3, |_, _| 0.0);
    let params = ProxyParams { kinetic_friction: 0.2, ..rough(0.5) };
    let mut proxy = plane.proxy(DVec3::ZERO);
    let mut advance = |x_m: f64| proxy.advance(&plane.surface(), DVec3::new(x_m, 0.0, -0.1), &params);
    assert_eq!(advance(0.049).state, ProxyState::Sticks);
    let broken = advance(0.051);
    assert!(broken.state == ProxyState::Slides && (broken.point_m.x - 0.031).abs() < 1e-9, "{broken:?}");
    // Once it slides, it slides on the lower friction, and back to rest only when it stops.
    assert_eq!(advance(0.052).state, ProxyState::Slides);
    assert_eq!(advance(0.052).state, ProxyState::Sticks);
    assert_eq!(advance(0.075).state, ProxyState::Sticks);
}

#[test]
fn without_friction_it_follows_a_tool_inside_a_sphere_as_the_nearest_point_does() {
    let sphere = Sheet::sphere(4);
    let mut proxy = sphere.proxy(DVec3::new(0.1, 0.2, 1.0));
    for step in 0..400 {
        let t = 0.02 * f64::from(step);
        let direction = DVec3::new((0.9 * t).sin(), (1.3 * t).sin() * 0.7, (0.9 * t).cos()).normalize();
        let tool_m = direction * (0.88 - 0.1 * (3.0 * t).sin());
        let felt = proxy.advance(&sphere.surface(), tool_m, &ProxyParams::frictionless(K));
        assert!(felt.state != ProxyState::Left);
        let off_m = felt.point_m.distance(sphere.nearest_m(tool_m));
        // Triangles of 0.1: a nearest point on facets may be the neighbour's.
        assert!(off_m < 0.05, "step {step}: {off_m}");
        let expected_n = K * (1.0 - tool_m.length());
        assert!((felt.on_tool_n.length() - expected_n).abs() < 0.01 * K, "{felt:?} {expected_n}");
    }
}

#[test]
fn it_goes_round_a_sphere_with_friction_at_the_angle_of_friction() {
    let sphere = Sheet::sphere(5);
    let (radius_m, friction) = (0.8_f64, 0.4_f64);
    let mut proxy = sphere.proxy(DVec3::Z);
    let mut last = None;
    for step in 0..600 {
        let angle = 0.01 * f64::from(step);
        let tool_m = DVec3::new(0.6 * angle.sin(), 0.8 * angle.sin(), angle.cos()) * radius_m;
        last = Some((proxy.advance(&sphere.surface(), tool_m, &rough(friction)), tool_m));
    }
    // Lag angle l: the way to the tool makes the angle of friction with the normal: R sin l = tan(phi) (1 - R cos l).
    let (felt, tool_m) = last.unwrap();
    let lag = felt.point_m.normalize().dot(tool_m.normalize()).clamp(-1.0, 1.0).acos();
    let excess = radius_m * lag.sin() - friction * (1.0 - radius_m * lag.cos());
    assert!(excess.abs() < 0.1 * friction * (1.0 - radius_m), "{lag} {excess}");
}

#[test]
fn in_a_valley_it_rests_on_the_edge_without_jitter() {
    // Two slopes of 45 degrees.
    let valley = Sheet::grid(8, |x, _| x.abs());
    let mut proxy = valley.proxy(DVec3::new(-0.4, 0.05, 0.4));
    let mut random = SeededRandom::new(5);
    let mut edge = 0;
    for step in 0..200 {
        let trembling_m = 1e-3 * DVec3::new(random.normal(), 0.0, random.normal());
        let tool_m = DVec3::new(-0.4 + 0.002 * f64::from(step), 0.05, -0.3) + trembling_m;
        let felt = proxy.advance(&valley.surface(), tool_m, &ProxyParams::frictionless(K));
        // Below the edge the foot on either slope is beyond it: the edge is nearest as long as |x| < depth.
        if tool_m.x.abs() < -tool_m.z - 1e-9 {
            assert!(felt.point_m.x.abs() < 1e-9 && (felt.point_m.y - 0.05).abs() < 1e-6, "{step} {felt:?}");
            edge += 1;
        }
    }
    assert!(edge > 50);
    // A trembling tool that rests with friction: the proxy does not move at all.
    let mut still = valley.proxy(DVec3::new(0.0, 0.05, 0.0));
    let params = rough(0.3);
    let first = still.advance(&valley.surface(), DVec3::new(0.0, 0.05, -0.3), &params);
    for _ in 0..200 {
        let trembling_m = 1e-3 * DVec3::new(random.normal(), random.normal(), random.normal());
        let felt = still.advance(&valley.surface(), DVec3::new(0.0, 0.05, -0.3) + trembling_m, &params);
        assert!(felt.point_m == first.point_m && felt.state == ProxyState::Sticks, "{felt:?}");
    }
}

#[test]
fn it_crosses_a_ridge_once_the_foot_of_the_tool_is_beyond_it() {
    let slope = 0.3;
    let ridge = Sheet::grid(8, |x, _| -slope * x.abs());
    let mut proxy = ridge.proxy(DVec3::new(-0.5, 0.1, -slope * 0.5));
    let mut points_m = Vec::new();
    for step in 0..=100 {
        let tool_m = DVec3::new(-0.5 + 0.01 * f64::from(step) + 1e-4, 0.1, -0.4);
        let felt = proxy.advance(&ridge.surface(), tool_m, &ProxyParams::frictionless(K));
        let side = if tool_m.x > slope * 0.4 { 1.0 } else { -1.0 };
        let normal = DVec3::new(side * slope, 0.0, 1.0).normalize();
        let foot_m = tool_m - normal * normal.dot(tool_m);
        assert!(felt.point_m.distance(foot_m) < 1e-9, "{step} {felt:?} {foot_m}");
        points_m.push(felt.point_m.x);
    }
    assert!(points_m.is_sorted(), "it goes over once: {points_m:?}");
}

/// However the tool jumps, the proxy is on the surface and the tool below it.
#[test]
fn the_tool_never_comes_through() {
    let mut random = SeededRandom::new(11);
    let sheet = Sheet::grid(16, |x, y| 0.3 * (7.0 * x).sin() * (5.0 * y).cos());
    for friction in [0.0, 0.3, 1.5] {
        let mut proxy = sheet.proxy(DVec3::new(0.1, 0.1, 1.0));
        for _ in 0..500 {
            let tool_m = DVec3::new(
                random.uniform_in(-0.9, 0.9),
                random.uniform_in(-0.9, 0.9),
                random.uniform_in(-3.0, -0.4),
            );
            let felt = proxy.advance(&sheet.surface(), tool_m, &rough(friction));
            assert!(felt.state != ProxyState::Left && felt.depth_m > 0.0, "{felt:?}");
            assert!(felt.point_m.distance(sheet.nearest_m(felt.point_m)) < 1e-12);
            // Within the cone at the face it is on, when it is inside a face.
            let tangential_m = (tool_m - felt.point_m + felt.normal * felt.depth_m).length();
            let is_inside = proxy.weights().iter().all(|w| *w > 0.0);
            assert!(!is_inside || tangential_m <= friction * felt.depth_m + 1e-9, "{felt:?}");
        }
    }
}

#[test]
fn a_tool_that_comes_out_is_let_go_and_adhesion_holds_it_for_its_force() {
    let plane = Sheet::grid(2, |_, _| 0.0);
    let at = |z: f64| DVec3::new(0.1, 0.2, z);
    let mut proxy = plane.proxy(at(0.0));
    assert_eq!(proxy.advance(&plane.surface(), at(-0.01), &rough(0.3)).state, ProxyState::Sticks);
    let out = proxy.advance(&plane.surface(), at(1e-6), &rough(0.3));
    assert!(out.state == ProxyState::Left && out.on_tool_n == DVec3::ZERO);
    let sticky = ProxyParams { adhesion_n: 2.0, ..rough(0.3) };
    let mut proxy = plane.proxy(at(0.0));
    let held = proxy.advance(&plane.surface(), at(0.019), &sticky);
    assert!(held.state == ProxyState::Sticks && (held.on_tool_n.z + 1.9).abs() < 1e-9, "{held:?}");
    assert_eq!(proxy.advance(&plane.surface(), at(0.021), &sticky).state, ProxyState::Left);
}

#[test]
fn a_ball_is_felt_one_radius_above_the_surface() {
    let plane = Sheet::grid(5, |_, _| 0.0);
    let params = ProxyParams { radius_m: 0.05, ..ProxyParams::frictionless(K) };
    let mut proxy = plane.proxy(DVec3::new(0.3, 0.3, 0.0));
    let felt = proxy.advance(&plane.surface(), DVec3::new(0.4, 0.3, 0.03), &params);
    assert!((felt.on_tool_n - DVec3::Z * K * 0.02).length() < 1e-9, "{felt:?}");
    assert!(felt.point_m.distance(DVec3::new(0.4, 0.3, 0.0)) < 1e-12);
    assert_eq!(proxy.advance(&plane.surface(), DVec3::new(0.4, 0.3, 0.051), &params).state, ProxyState::Left);
}

/// A ball larger than the triangles, rolled over a rippled surface: its force has no jumps.
#[test]
fn a_ball_on_a_rippled_surface_is_felt_without_jumps() {
    let rippled = Sheet::grid(40, |x, y| 0.02 * (9.0 * x).sin() + 0.02 * (8.0 * y).cos());
    let params = ProxyParams { radius_m: 0.1, ..ProxyParams::frictionless(K) };
    let height_m = |x: f64| 0.02 * (9.0 * x).sin() + 0.02 * 1.6_f64.cos() + 0.09;
    let mut proxy = rippled.proxy(DVec3::new(-0.8, 0.2, 0.0));
    let mut last: Option<ProxyForce> = None;
    let mut largest_n = 0.0_f64;
    for step in 0..1600 {
        let x = -0.8 + 0.001 * f64::from(step);
        let felt = proxy.advance(&rippled.surface(), DVec3::new(x, 0.2, height_m(x)), &params);
        assert!(felt.state != ProxyState::Left, "{x} {felt:?}");
        if let (Some(last), true) = (last, step > 20) {
            largest_n = largest_n.max(felt.on_tool_n.distance(last.on_tool_n));
        }
        last = Some(felt);
    }
    // The force is about 1 N; a step is a fiftieth of a triangle.
    assert!(largest_n < 0.1, "{largest_n}");
}

#[test]
fn the_proxy_moves_with_the_tissue_under_it() {
    let mut sheet = Sheet::grid(4, |_, _| 0.0);
    let mut proxy = sheet.proxy(DVec3::new(0.1, 0.2, 0.0));
    proxy.advance(&sheet.surface(), DVec3::new(0.1, 0.2, -0.1), &rough(0.5));
    for p in &mut sheet.positions_m {
        *p += DVec3::new(0.03, 0.0, 0.05);
    }
    let felt = proxy.advance(&sheet.surface(), DVec3::new(0.1, 0.2, -0.1), &rough(0.5));
    assert!(felt.point_m.distance(DVec3::new(0.13, 0.2, 0.05)) < 1e-12);
    assert!(
        felt.on_tool_n.distance(K * DVec3::new(0.03, 0.0, 0.15)) < 1e-9 && felt.state == ProxyState::Sticks
    );
}

#[test]
fn after_a_cut_it_stays_moves_to_a_neighbour_or_lets_go() {
    let mut sheet = Sheet::grid(4, |_, _| 0.0);
    let mut proxy = sheet.proxy(DVec3::new(0.1, 0.2, 0.0));
    let before_m = proxy.point_m(&sheet.positions_m);
    let unchanged = proxy;
    assert!(proxy.follow_edit(&sheet.surface(), before_m, 0.1) && proxy == unchanged);
    // The same triangle, in another slot.
    let slot = proxy.slot();
    sheet.adjacency.set_triangle(slot, None);
    sheet.adjacency.set_triangle(33, Some(proxy.vertices()));
    assert!(!proxy.is_on(&sheet.adjacency) && proxy.follow_edit(&sheet.surface(), before_m, 1e-9));
    assert!(proxy.slot() == 33 && proxy.point_m(&sheet.positions_m).distance(before_m) < 1e-12);
    // Gone: to the edge of the hole, if it is near enough.
    sheet.adjacency.set_triangle(33, None);
    let mut far = proxy;
    assert!(!far.follow_edit(&sheet.surface(), before_m, 1e-3));
    assert_eq!(far.advance(&sheet.surface(), before_m - DVec3::Z, &rough(0.0)).state, ProxyState::Left);
    assert!(proxy.follow_edit(&sheet.surface(), before_m, 0.3) && proxy.is_on(&sheet.adjacency));
    assert!(sheet.adjacency.is_consistent());
}

#[test]
fn slots_and_rings_agree_after_any_edits() {
    let mut random = SeededRandom::new(2);
    let mut adjacency = SurfaceAdjacency::new(20, &[], 30);
    for _ in 0..3_000 {
        let slot = (random.uniform() * 30.0) as u32;
        let first = (random.uniform() * 18.0) as u32;
        let triangle = (random.uniform() < 0.6).then_some([first, first + 1, first + 2]);
        adjacency.set_triangle(slot, triangle);
        assert!(adjacency.triangle(slot) == triangle && adjacency.is_consistent());
    }
    adjacency.grow(25, 31);
    adjacency.set_triangle(30, Some([22, 23, 24]));
    assert!(adjacency.is_consistent() && adjacency.around(23).eq([(30, 1)]));
}
