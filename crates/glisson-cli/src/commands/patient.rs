//! `glisson patient`.

use super::output::{check_extension, make_folder_of};
use super::serve::Address;
use crate::text_file::write_text;
use glisson_runtime::{OpenScene, Simulation};
use glisson_view::local_page::patient_page;
use glisson_view::patient::PatientPage;
use std::path::{Path, PathBuf};

/// Bring a new patient in, in the browser: from an image to a simulation.
///
/// The page takes a folder or file that is dropped on it, shows three planes of it, finds the organ from points inside and outside
/// it, fills it with tetrahedra and starts the simulation. Mesh and scene are written into a folder; the patient's name is not. With
/// --html the page is one file that does all this by itself, without a server or a network.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  glisson patient\n  glisson patient ct_folder/ --out out/patient\n  \
    glisson patient labels.nii.gz --port 0\n  glisson patient --html new_patient.html\n\nThe steps as commands: glisson import, segment, mesh, serve.")]
pub(crate) struct Args {
    /// Image to begin with, a file or a DICOM folder; else the page asks for one
    image: Option<PathBuf>,
    /// Folder for the mesh and the scene; one that holds a scene is refused [default: out/patient, or out/patient-2, ...]
    #[arg(long, short, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Write the page to this file, with all that it needs, and start nothing: no image leaves it
    #[arg(long, value_name = "FILE", conflicts_with_all = ["image", "out", "threads", "host", "port", "token", "no_open"])]
    html: Option<PathBuf>,
    /// Threads of models that can use several; the results do not depend on it
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    threads: u8,
    #[command(flatten)]
    address: Address,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(html) = &args.html {
        return write_page(html);
    }
    if let Some(image) = &args.image {
        anyhow::ensure!(image.exists(), "{}: no such file or folder", image.display());
    }
    let listener = args.address.bind()?;
    let n_threads = usize::from(args.threads);
    let open = move |scene: &Path| Simulation::open(OpenScene { n_threads, ..OpenScene::read(scene)? }, None);
    let page = PatientPage {
        folder: args.out.clone().unwrap_or_else(free_folder),
        image: args.image.clone(),
        open: Box::new(open),
        may_leave: false,
    };
    args.address.serve_patient(page, listener)
}

fn write_page(html: &Path) -> anyhow::Result<()> {
    check_extension(html, &["html", "htm"])?;
    let page = patient_page()?;
    make_folder_of(html)?;
    write_text(html, &page)?;
    println!("size             {:.2} MB", page.len() as f64 / 1e6);
    println!("written          {}; a browser opens it, without a server or a network", html.display());
    Ok(())
}

/// The first of out/patient, out/patient-2, ... that is not there.
pub(super) fn free_folder() -> PathBuf {
    let numbered = (2..).map(|number| PathBuf::from(format!("out/patient-{number}")));
    let mut folders = std::iter::once(PathBuf::from("out/patient")).chain(numbered);
    folders.find(|folder| !folder.exists()).expect("numbers do not end")
}
