//! Its row in the table of models.

use super::{
    Correction, CurvePolynomial, FitError, LinearSample, MeasuredCurve, NAME, QuasiNonlinear, ScaleError,
    fit_curve,
};
use crate::material::LawChoice;
use crate::model::precomputed::row::uncut;
use crate::model::{DeformableModel, MeasuredSample, ModelError, ModelRow, OrganBody};
use std::path::PathBuf;

pub(crate) const ROW: ModelRow = ModelRow {
    follows_curves: true,
    ..ModelRow::quasi_static(
        NAME,
        "the pre-computed model with forces and displacements that follow measured curves",
        &["linear"],
        make,
    )
};

/// Why it cannot follow curves.
#[derive(Debug, thiserror::Error)]
enum CurveRefusal {
    /// There are none.
    #[error(
        "the quasi_nonlinear model follows measured curves, but the scene has none: add [organ.measured] with curve = \"FILE.csv\", \
         height and radius of the cylinder (docs/scene.md)"
    )]
    None,
    /// No polynomial of the degree follows one.
    #[error("{}: fitting the {quantity}: {error}", file.display())]
    Fit {
        /// The curves.
        file: PathBuf,
        /// Which of them.
        quantity: &'static str,
        /// Why not.
        error: FitError,
    },
    /// The linear organ has nothing to which a curve could be put in proportion.
    #[error(
        "the quasi_nonlinear model cannot follow {}: with poisson_ratio = {poisson_ratio}, {error}; give the organ a \
         poisson_ratio above 0, or take the column of radial displacements out of the file",
        file.display()
    )]
    NoLinearAnswer {
        /// The curves.
        file: PathBuf,
        /// Of the organ.
        poisson_ratio: f64,
        /// What is wrong.
        error: ScaleError,
    },
}

fn make(body: &OrganBody, _: Option<&LawChoice>) -> Result<Box<dyn DeformableModel>, ModelError> {
    let measured = body.measured.as_ref().ok_or_else(|| ModelError::own(CurveRefusal::None))?;
    let correction = correction_of(measured, body)?;
    let linear = Box::new(uncut(body, &ROW)?);
    Ok(Box::new(QuasiNonlinear::new(linear, &body.mesh, correction).map_err(ModelError::own)?))
}

fn correction_of(measured: &MeasuredSample, body: &OrganBody) -> Result<Correction, ModelError> {
    let file = || measured.curve.clone();
    let curve = MeasuredCurve::read(&measured.curve).map_err(ModelError::own)?;
    let fit = |y: &[f64], quantity| -> Result<Option<CurvePolynomial>, ModelError> {
        if y.is_empty() {
            return Ok(None);
        }
        match fit_curve(&curve.axial_displacement_m, y, measured.degree) {
            Ok(fit) => Ok(Some(fit.polynomial)),
            Err(error) => Err(ModelError::own(CurveRefusal::Fit { file: file(), quantity, error })),
        }
    };
    let force_n = fit(&curve.force_n, "force")?;
    let radial_m = fit(&curve.radial_displacement_m, "radial displacement")?;
    let sample = LinearSample::cylinder(measured.height_m, measured.radius_m, &body.material);
    Correction::of_sample(force_n.as_ref(), radial_m.as_ref(), &sample).map_err(|error| {
        let poisson_ratio = body.material.poisson_ratio();
        ModelError::own(CurveRefusal::NoLinearAnswer { file: file(), poisson_ratio, error })
    })
}
