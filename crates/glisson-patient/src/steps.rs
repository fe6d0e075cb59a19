//! How far the patient is, and the steps that lead on.
//!
//! A step is work on what is there now, which can be done on another thread, and a change that it leaves behind. What a page asks for in
//! words and numbers is read here, whoever carries it.

use anyhow::{Context, ensure};
use glisson::material::tissues::TISSUES;
use glisson::math::DVec3;
use glisson_picture::SlicePlane;
use serde::Deserialize;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::image::{Image, series_of};
use super::mesh_picture::{Colours, MeshView};
use super::organ::{Organ, OrganChoice, Organs, Outline};
use super::scene::{HELD, MODELS, SceneChoice};
use super::tetrahedra::{Meshed, QUALITY_STEPS, TETRAHEDRA};

/// How far a patient is.
#[derive(Default)]
pub struct Patient {
    image: Option<Arc<Image>>,
    /// Grows with each image.
    n_images: u64,
    /// Series to choose from, where there are several.
    series: Vec<String>,
    organs: Arc<Organs>,
    mesh: Option<Arc<Meshed>>,
    /// Grows whenever pictures change.
    version: u64,
}

/// What a step leaves behind.
pub struct Change(Box<dyn FnOnce(&mut Patient) + Send>);

impl Change {
    fn of(change: impl FnOnce(&mut Patient) + Send + 'static) -> Self {
        Self(Box::new(change))
    }
}

/// A step that is asked for.
pub struct Step {
    /// What a page says while it goes on.
    pub what: &'static str,
    work: Box<dyn FnOnce() -> anyhow::Result<Change> + Send>,
}

impl Step {
    fn new(what: &'static str, work: impl FnOnce() -> anyhow::Result<Change> + Send + 'static) -> Self {
        Self { what, work: Box::new(work) }
    }

    /// Does it; [`Patient::take`] is to take what comes of it.
    ///
    /// # Errors
    /// What is wrong with the choice, or missing before this step.
    pub fn run(self) -> anyhow::Result<Change> {
        (self.work)()
    }
}

/// What a file or folder holds.
pub struct Opened {
    image: anyhow::Result<Option<Arc<Image>>>,
    series: Vec<String>,
}

impl Opened {
    /// Reads a file or folder; of several DICOM series the one of this number, from 1. Where there are several and none is chosen, there
    /// is no image yet: somebody is to choose.
    pub fn read(path: &Path, series: Option<usize>) -> Self {
        let read = Image::read(path, series);
        let all = series_of(path);
        let image = match read {
            Ok(image) => Ok(Some(Arc::new(image))),
            Err(_) if !all.is_empty() && series.is_none() => Ok(None),
            Err(error) => Err(error),
        };
        Self { image, series: all }
    }

    /// Whether another series may be asked for.
    pub fn has_several(&self) -> bool {
        !self.series.is_empty()
    }

    /// The same, without the names of files in what is said of them: how the user's files are called is nobody else's business.
    pub fn without_names(mut self, path: &Path) -> Self {
        self.image = self.image.map_err(|error| {
            anyhow::anyhow!(format!("{error:#}").replace(&path.display().to_string(), "the image"))
        });
        self
    }

    /// What it changes.
    ///
    /// # Errors
    /// What was found instead of an image.
    pub fn change(self) -> anyhow::Result<Change> {
        let Self { image, series } = self;
        let image = image?;
        Ok(Change::of(move |patient| {
            patient.series = series;
            patient.take_image(image);
        }))
    }
}

/// A picture that is drawn where it is called.
pub type Drawing = Box<dyn FnOnce() -> anyhow::Result<Vec<u8>> + Send>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MeshChoice {
    tetrahedra: usize,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Named {
    name: String,
}

impl Patient {
    fn take_image(&mut self, image: Option<Arc<Image>>) {
        self.n_images += u64::from(image.is_some());
        self.image = image;
        (self.organs, self.mesh) = (Arc::default(), None);
    }

    /// Takes what came of a step.
    pub fn take(&mut self, change: Change) {
        (change.0)(self);
        self.version += 1;
    }

    /// The step of this name: "values" (numbers that were taken for labels are values), "organ" (finds one), "remove" (an organ), "mesh"
    /// (fills them with tetrahedra), with its choice in JSON. None for another name.
    ///
    /// # Errors
    /// A choice that cannot be read.
    pub fn step(&self, name: &str, choice: &str) -> Option<serde_json::Result<Step>> {
        Some(match name {
            "values" => Ok(self.take_as_values()),
            "organ" => serde_json::from_str(choice).map(|choice| self.find_organ(choice)),
            "remove" => serde_json::from_str(choice).map(|Named { name }| self.remove_organ(name)),
            "mesh" => serde_json::from_str(choice).map(|MeshChoice { tetrahedra }| self.fill(tetrahedra)),
            _ => return None,
        })
    }

    /// Takes the numbers of the image for values, where they were taken for labels.
    fn take_as_values(&self) -> Step {
        let image = self.image.clone();
        Step::new("reading the image", move || {
            let image = Arc::new(image.context(NO_IMAGE)?.as_values()?);
            Ok(Change::of(move |patient| patient.take_image(Some(image))))
        })
    }

    fn find_organ(&self, choice: OrganChoice) -> Step {
        let (image, organs) = (self.image.clone(), Arc::clone(&self.organs));
        Step::new("finding the organ", move || {
            let image = image.context(NO_IMAGE)?;
            Ok(Change::of_organs(organs.with(choice.find(&image)?, image.grid())?))
        })
    }

    fn remove_organ(&self, name: String) -> Step {
        let (image, organs) = (self.image.clone(), Arc::clone(&self.organs));
        Step::new("removing an organ", move || {
            Ok(Change::of_organs(organs.without(&name, image.context(NO_IMAGE)?.grid())))
        })
    }

    fn fill(&self, n_tets: usize) -> Step {
        let organs = Arc::clone(&self.organs);
        Step::new("filling with tetrahedra", move || {
            let mesh = Arc::new(Meshed::of(organs.map().context("there is no organ yet")?, n_tets)?);
            Ok(Change::of(move |patient| patient.mesh = Some(mesh)))
        })
    }

    /// Writes the scene and its meshes into a folder, where it is called; answers the scene's path.
    pub fn scene(
        &self,
        choice: SceneChoice,
        folder: PathBuf,
    ) -> impl FnOnce() -> anyhow::Result<PathBuf> + Send + 'static {
        let mesh = self.mesh.clone();
        move || {
            let mesh = mesh.context("there are no tetrahedra yet")?;
            std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            choice.write(&mesh.names, &mesh.bodies(), &folder)
        }
    }

    /// The picture of this name: `slice/PLANE/X/Y/Z/CENTRE/WIDTH` through a point [mm] with a window, or
    /// `mesh/AZIMUTH/ELEVATION/CUT/SHARE/COLOURS` of the tetrahedra: from where [degrees], cut by a plane or `none` at this share of
    /// their box, coloured by `organ` or `quality`.
    ///
    /// # Errors
    /// A name that is none of these.
    pub fn picture(&self, name: &str) -> anyhow::Result<Drawing> {
        let parts: Vec<&str> = name.split('/').collect();
        match parts[..] {
            ["slice", plane, x, y, z, centre, width] => {
                let plane = plane_named(plane)?;
                let [x, y, z] = [number(x)?, number(y)?, number(z)?];
                let window = [number(centre)?, number(width)?];
                let (image, organs) = (self.image.clone(), Arc::clone(&self.organs));
                Ok(Box::new(move || {
                    let image = image.context(NO_IMAGE)?;
                    image.slice_png(organs.map(), plane, 1e-3 * DVec3::new(x, y, z), window)
                }))
            }
            ["mesh", azimuth, elevation, cut, share, colours] => {
                let view = MeshView {
                    azimuth_deg: number(azimuth)?,
                    elevation_deg: number(elevation)?,
                    cut: if cut == "none" { None } else { Some((plane_named(cut)?, number(share)?)) },
                    colours: match colours {
                        "organ" => Colours::Organ,
                        "quality" => Colours::Quality,
                        _ => anyhow::bail!("found colours \"{colours}\", allowed: organ, quality"),
                    },
                };
                let mesh = self.mesh.clone();
                Ok(Box::new(move || mesh.context("there are no tetrahedra yet")?.picture_png(&view)))
            }
            _ => anyhow::bail!("found picture \"{name}\", allowed: slice/..., mesh/..."),
        }
    }

    /// The outlines that an organ was made from; none where there is no such organ.
    pub fn outlines(&self, organ: &str) -> Option<&[Outline]> {
        self.organs.list().iter().find(|known| known.name == organ).map(|organ| &organ.outlines[..])
    }

    /// What the page shows of it.
    pub fn state(&self) -> Value {
        let summaries = |organs: &[Arc<Organ>]| organs.iter().map(|o| o.summary.clone()).collect::<Vec<_>>();
        json!({
            "version": self.version,
            "image_number": self.n_images,
            "series": self.series,
            "image": self.image.as_ref().map(|image| &image.summary),
            "organs": summaries(self.organs.list()),
            "mesh": self.mesh.as_ref().map(|mesh| &mesh.summary),
            "offers": {
                "tissues": TISSUES.iter().map(|tissue| tissue.name).collect::<Vec<_>>(),
                "models": MODELS.iter().map(|model| json!({"name": model.name, "about": model.about})).collect::<Vec<_>>(),
                "held": HELD.iter().map(|held| held.name).collect::<Vec<_>>(),
                "tetrahedra": TETRAHEDRA,
                "quality": QUALITY_STEPS.map(|step| json!({"from_deg": step.from_deg, "colour": step.colour})),
            },
        })
    }
}

const NO_IMAGE: &str = "there is no image yet";

impl Change {
    fn of_organs(organs: Organs) -> Self {
        Self::of(move |patient| (patient.organs, patient.mesh) = (Arc::new(organs), None))
    }
}

fn plane_named(name: &str) -> anyhow::Result<SlicePlane> {
    match name {
        "axial" => Ok(SlicePlane::Axial),
        "coronal" => Ok(SlicePlane::Coronal),
        "sagittal" => Ok(SlicePlane::Sagittal),
        _ => anyhow::bail!("found plane \"{name}\", allowed: axial, coronal, sagittal"),
    }
}

fn number(text: &str) -> anyhow::Result<f64> {
    let number: f64 = text.parse().with_context(|| format!("found \"{text}\" for a number of a picture"))?;
    ensure!(number.is_finite(), "a number of a picture is not finite");
    Ok(number)
}
