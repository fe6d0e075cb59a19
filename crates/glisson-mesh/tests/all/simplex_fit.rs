//! Simplex meshes fitted to masks and surfaces.

use std::ops::ControlFlow;

use glisson_mesh::image::VoxelGrid;
use glisson_mesh::image::phantom::{PhantomParams, Tissue, generate};
use glisson_mesh::math::{DMat3, DVec3};
use glisson_mesh::surface::check::check_closed;
use glisson_mesh::surface::error::SurfaceError;
use glisson_mesh::surface::extract::{SurfaceParams, surface_of_mask};
use glisson_mesh::surface::simplex::error::SimplexError;
use glisson_mesh::surface::simplex::fit::{
    SimplexFit, SimplexFitParams, SimplexFitProgress, fit_simplex, fit_simplex_to_surface,
};
use glisson_mesh::surface::simplex::measure::surface_distances;

fn go_on(_: SimplexFitProgress) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn fitted(grid: &VoxelGrid, mask: &[bool], params: &SimplexFitParams) -> SimplexFit {
    let fit = fit_simplex(grid, mask, params, &mut go_on).unwrap();
    let topology = check_closed(&fit.mesh).unwrap();
    assert_eq!((topology.euler_characteristic, topology.n_pieces, topology.n_unused_vertices), (2, 1, 0));
    assert_eq!(fit.simplex.check().unwrap().euler_characteristic, 2);
    assert_eq!(fit.mesh.triangles, fit.simplex.cells());
    assert_eq!(fit.report.n_triangles, fit.mesh.triangles.len());
    fit
}

/// Thick slices, turned axes, and a ball that is off the voxels' centres.
fn ball_on_thick_slices(mirrored: bool) -> (VoxelGrid, Vec<bool>, DVec3) {
    let mut axes = DMat3::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    if mirrored {
        axes.z_axis = -axes.z_axis;
    }
    let spacing_m = DVec3::new(0.7e-3, 0.7e-3, 2.5e-3);
    let grid = VoxelGrid { dims: [72, 72, 24], spacing_m, origin_m: DVec3::new(0.1, -0.2, 0.3), axes };
    let centre_m = grid.position_m(DVec3::new(35.6, 35.7, 11.6));
    let at_m = |v: usize| grid.position_m(DVec3::from_array(grid.voxel(v).map(|x| x as f64)));
    let mask = (0..grid.n_voxels()).map(|v| at_m(v).distance(centre_m) < 22e-3).collect();
    (grid, mask, centre_m)
}

#[test]
fn simplex_fit_of_the_phantom_liver_is_near_smooth_and_adaptive() {
    let voxel_m = 3e-3;
    let phantom = generate(&PhantomParams { voxel_m, ..Default::default() });
    let inside =
        [Tissue::Liver, Tissue::LiverTumour, Tissue::PortalVein, Tissue::HepaticVein].map(Tissue::label);
    let mask: Vec<bool> = phantom.labels.labels.iter().map(|l| inside.contains(l)).collect();
    let grid = &phantom.labels.grid;
    let fit = fitted(grid, &mask, &SimplexFitParams::default());
    let report = &fit.report;
    let sixth = report.n_triangles_extracted / 6;
    assert!(
        report.n_triangles <= sixth && report.n_triangles + 2 > sixth,
        "{} triangles",
        report.n_triangles
    );
    // The oracle measures by itself, against the surface with the voxels' stairs.
    let stairs = SurfaceParams { smoothing_wavelength_m: Some(0.0), ..Default::default() };
    let (border, _) = surface_of_mask(grid, &mask, &stairs).unwrap();
    let to_border = surface_distances(&fit.mesh, &border);
    assert_eq!(to_border, report.to_data);
    for (name, d) in [("to", to_border), ("from", surface_distances(&border, &fit.mesh))] {
        assert!(d.mean_m <= 0.2 * voxel_m && d.p95_m <= 0.5 * voxel_m, "{name} the border: {d:?}");
    }
    let width = |[low, high]: [f64; 2]| high - low;
    let (rough, smooth) = (width(report.data_curvatures_per_m), width(report.curvatures_per_m));
    assert!(smooth < 0.4 * rough, "curvatures spread over {smooth} of {rough} 1/m");
    assert!(report.density_correlation > 0.5, "correlation {}", report.density_correlation);
    assert!((report.volume_m3 / report.data_volume_m3 - 1.0).abs() < 1e-6);
    assert_eq!(report.n_without_data, 0);
}

#[test]
fn simplex_fit_of_a_ball_has_its_radius_and_its_curvature() {
    for mirrored in [false, true] {
        let (grid, mask, centre_m) = ball_on_thick_slices(mirrored);
        let fit = fitted(&grid, &mask, &SimplexFitParams::default());
        let off = |p: &DVec3| (p.distance(centre_m) - 22e-3).abs();
        let worst_m = fit.mesh.positions_m.iter().map(off).fold(0.0, f64::max);
        assert!(worst_m < 1e-3, "{worst_m} m off the ball, slices of 2.5 mm");
        let ([low, high], [rough_low, rough_high]) =
            (fit.report.curvatures_per_m, fit.report.data_curvatures_per_m);
        assert!(low > 15.0 && high < 80.0, "curvatures {low} to {high} 1/m, 45 are right");
        assert!(high - low < 0.1 * (rough_high - rough_low), "voxels: {rough_low} to {rough_high} 1/m");
    }
}

#[test]
fn simplex_fit_is_the_same_at_any_number_of_threads() {
    let (grid, mask, _) = ball_on_thick_slices(false);
    let params = SimplexFitParams { n_steps: 8, ..Default::default() };
    let on = |n_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n_threads).build().unwrap();
        pool.install(|| fitted(&grid, &mask, &params))
    };
    let one = on(1);
    assert_eq!(on(3), one);
    assert_eq!(on(1), one);
}

#[test]
fn simplex_fit_keeps_thin_and_rough_parts() {
    // A sheet of one voxel with a slot and a rod: smoothing must not push one side through the other.
    let grid = VoxelGrid {
        dims: [44, 40, 24],
        spacing_m: DVec3::splat(1e-3),
        origin_m: DVec3::ZERO,
        axes: DMat3::IDENTITY,
    };
    let inside = |v: usize| {
        let [i, j, k] = grid.voxel(v);
        let block =
            (5..18).contains(&i) && (5..30).contains(&j) && (4..20).contains(&k) && !(i == 10 && j > 12);
        let sheet = (18..38).contains(&i) && (8..30).contains(&j) && k == 12;
        block || sheet
    };
    let mask: Vec<bool> = (0..grid.n_voxels()).map(inside).collect();
    let fit = fitted(&grid, &mask, &SimplexFitParams::default());
    let report = fit.report;
    assert!(report.to_data.mean_m < 0.5e-3 && report.from_data.mean_m < 0.5e-3, "{report:?}");
    assert!(report.from_data.p95_m < 1.5e-3, "{report:?}");
}

#[test]
fn simplex_fit_follows_a_surface() {
    let (grid, mask, _) = ball_on_thick_slices(false);
    let (surface, _) = surface_of_mask(&grid, &mask, &SurfaceParams::default()).unwrap();
    let params = SimplexFitParams { target_triangles: Some(1200), ..Default::default() };
    let fit = fit_simplex_to_surface(&surface, 1e-3, &params, &mut go_on).unwrap();
    assert_eq!(fit.mesh.triangles.len(), 1200);
    check_closed(&fit.mesh).unwrap();
    assert!(fit.report.to_data.mean_m < 0.1e-3, "{:?}", fit.report.to_data);
    assert!((fit.report.volume_m3 / surface.volume_m3() - 1.0).abs() < 1e-6);
    let wrong = fit_simplex_to_surface(&surface, 0.0, &params, &mut go_on);
    assert!(matches!(wrong, Err(SimplexError::Parameter { name: "resolution [m]", .. })));
}

#[test]
fn simplex_fit_tells_how_far_it_is_and_stops_when_asked() {
    let (grid, mask, _) = ball_on_thick_slices(false);
    let params = SimplexFitParams { n_steps: 3, ..Default::default() };
    let mut shares = Vec::new();
    let mut stages = Vec::new();
    fit_simplex(&grid, &mask, &params, &mut |p| {
        shares.push(p.share);
        stages.push(p.stage);
        assert_eq!(p.stage == "deformation", p.mean_offset_m.is_some());
        ControlFlow::Continue(())
    })
    .unwrap();
    assert!(shares.is_sorted() && shares[0] == 0.0 && shares.last().is_some_and(|&s| s <= 1.0));
    assert_eq!(stages.len(), 2 + 3 * 4 + 1);
    stages.dedup();
    assert_eq!(stages, ["extraction", "decimation", "deformation", "dual"]);
    let mut calls = 0;
    let stopped = fit_simplex(&grid, &mask, &params, &mut |p| {
        calls += 1;
        if p.stage == "deformation" { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert_eq!((stopped, calls), (Err(SimplexError::Stopped { stage: "deformation" }), 3));
}

#[test]
fn simplex_fit_refuses_parameters_out_of_range_and_cut_off_organs() {
    let (grid, mask, _) = ball_on_thick_slices(false);
    let refused = |params: SimplexFitParams| fit_simplex(&grid, &mask, &params, &mut go_on).unwrap_err();
    let base = SimplexFitParams::default;
    let cases = [
        SimplexFitParams { internal: 0.6, ..base() },
        SimplexFitParams { external: f64::NAN, ..base() },
        SimplexFitParams { damping: -0.1, ..base() },
        SimplexFitParams { mask_smoothing_spacings: -1.0, ..base() },
        SimplexFitParams { contrast: 0.5, ..base() },
        SimplexFitParams { gathering: 0.5, ..base() },
        SimplexFitParams { rigidity: 51, ..base() },
        SimplexFitParams { target_triangles: Some(6), ..base() },
    ];
    for params in cases {
        assert!(matches!(refused(params), SimplexError::Parameter { .. }));
    }
    let at_border: Vec<bool> = (0..grid.n_voxels()).map(|v| grid.voxel(v)[2] < 9).collect();
    let cut_off = fit_simplex(&grid, &at_border, &base(), &mut go_on);
    assert!(matches!(cut_off, Err(SimplexError::Surface(SurfaceError::TouchesBorder { .. }))));
}
