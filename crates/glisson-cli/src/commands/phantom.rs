//! `glisson phantom`.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use glisson::files::write_atomically;
use glisson::image::files::{write_label_map, write_volume};
use glisson::image::labels::Parts;
use glisson::image::phantom::{PhantomParams, generate};
use glisson::image::vessels::write_vessels;

/// Write a synthetic patient: a portal-phase CT of an upper abdomen and its true label map.
///
/// The seed chooses the patient and the noise; the same seed gives the same files. Three files are written:
/// ct.nii.gz (Hounsfield units), labels.nii.gz (the organ at the centre of each voxel, names included) and
/// vessels.csv (the liver's vessels as tubes, which a scene can make bleed).
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson phantom
  glisson phantom --seed 7 --out out/patient-7
  glisson phantom --voxel-mm 3 --out out/coarse")]
pub(crate) struct Args {
    /// Chooses the patient
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder to write into, made if need be
    #[arg(long, default_value = "out/phantom")]
    out: PathBuf,
    /// Edge of the cubic voxels [mm]
    #[arg(long, default_value_t = 1.5)]
    voxel_mm: f64,
    /// Standard deviation of the noise [HU]
    #[arg(long, default_value_t = 20.0)]
    noise_hu: f64,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    ensure!(
        (0.5..=10.0).contains(&args.voxel_mm),
        "--voxel-mm {} is outside the allowed 0.5 to 10 mm",
        args.voxel_mm
    );
    ensure!(
        (0.0..=1000.0).contains(&args.noise_hu),
        "--noise-hu {} is outside the allowed 0 to 1000 HU",
        args.noise_hu
    );
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("cannot make folder {}", args.out.display()))?;
    let params = PhantomParams {
        seed: args.seed,
        voxel_m: args.voxel_mm * 1e-3,
        noise_hu: args.noise_hu,
        ..PhantomParams::default()
    };
    let patient = generate(&params);
    let (ct_file, label_file) = (args.out.join("ct.nii.gz"), args.out.join("labels.nii.gz"));
    write_volume(&ct_file, &patient.ct)?;
    write_label_map(&label_file, &patient.labels)?;
    let vessel_file = args.out.join("vessels.csv");
    write_atomically(&vessel_file, |out| write_vessels(out, &patient.vessels))
        .with_context(|| format!("{}: cannot write", vessel_file.display()))?;

    let grid = &patient.ct.grid;
    let [n_i, n_j, n_k] = grid.dims;
    println!("CT     {}  {n_i} x {n_j} x {n_k} voxels of {} mm", ct_file.display(), args.voxel_mm);
    println!("labels {}", label_file.display());
    println!("vessels {}  {} tubes", vessel_file.display(), patient.vessels.len());
    for (_, name) in &patient.labels.names {
        // At coarse voxels thin structures can fall between the centres.
        if let Ok(organ) = patient.labels.select(name, Parts::Excluded) {
            println!(
                "  {:>2} {name:<14} {:>8.1} ml",
                organ.labels[0],
                patient.labels.volume_m3(&organ) * 1e6
            );
        }
    }
    let liver = patient.labels.select("liver", Parts::Included)?;
    println!("liver with vessels and tumour: {:.0} ml", patient.labels.volume_m3(&liver) * 1e6);
    Ok(())
}
