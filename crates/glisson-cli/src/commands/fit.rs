//! `glisson fit`.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Context, bail, ensure};
use glisson::files::write_atomically;
use glisson::material::LinearElastic;
use glisson::model::quasi_nonlinear::{CurvePolynomial, Fit, LinearSample, MeasuredCurve, fit_curve};
use serde::Serialize;

use glisson_report::plot::{LinePlot, Series, SeriesStyle};

/// Fit polynomials to the measured curves of a compressed sample.
///
/// CURVE.csv has a line of column names (axial_displacement_mm or _m; force_n or _mn; radial_displacement_mm or _m), one
/// row a measurement, compression and its effects positive, and `#` before comments. Each curve becomes a polynomial
/// through the origin in the axial displacement: least squares, see the quasi non-linear model in docs/models.md. With
/// the sample's size and an elastic material, the polynomials over the linear force and radial displacement are written too.
///
/// Writes fit.json (degree, coefficients, r, residuals, range) and force.svg, radial.svg into the folder.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  glisson fit brain.csv --degree 6 --out out/brain
  glisson fit brain.csv --degree 8 --height-mm 13 --radius-mm 15 --young-kpa 2.5 --poisson 0.45 --out out/brain")]
pub(crate) struct Args {
    /// Measured curves.
    #[arg(value_name = "CURVE.csv")]
    curve: PathBuf,
    /// Degree of the polynomials, 4 to 10.
    #[arg(long, default_value_t = 6)]
    degree: usize,
    /// Height of the cylindrical sample [mm].
    #[arg(long, value_name = "MM", requires_all = ["radius_mm", "young_kpa", "poisson"])]
    height_mm: Option<f64>,
    /// Its radius [mm].
    #[arg(long, value_name = "MM", requires = "height_mm")]
    radius_mm: Option<f64>,
    /// Young's modulus of the linear model [kPa].
    #[arg(long, value_name = "KPA", requires = "height_mm")]
    young_kpa: Option<f64>,
    /// Poisson's ratio of the linear model.
    #[arg(long, value_name = "RATIO", requires = "height_mm")]
    poisson: Option<f64>,
    /// Folder to write into; made when missing.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// A polynomial as numbers.
#[derive(Serialize)]
struct Numbers {
    degree: usize,
    /// From where to where, SI.
    range: [f64; 2],
    /// Points on one side of zero only: p(-x) = -p(x).
    is_odd: bool,
    /// p(x) = x sum_k c_k T_k((2 x - low - high)/(high - low)).
    chebyshev_coefficients: Vec<f64>,
    /// p(x) = sum_k a_k (x/high)^k, k from 1.
    power_coefficients: Vec<f64>,
    is_rising: bool,
}

impl From<&CurvePolynomial> for Numbers {
    fn from(p: &CurvePolynomial) -> Self {
        Self {
            degree: p.degree(),
            range: p.range(),
            is_odd: p.is_odd(),
            chebyshev_coefficients: p.coefficients().to_vec(),
            power_coefficients: p.powers(),
            is_rising: p.is_rising(),
        }
    }
}

/// One fitted curve.
#[derive(Serialize)]
struct CurveReport {
    quantity: &'static str,
    unit: &'static str,
    r: f64,
    rms_residual: f64,
    largest_residual: f64,
    n_points: usize,
    over_axial_displacement_m: Numbers,
    #[serde(skip_serializing_if = "Option::is_none")]
    over_linear_magnitude: Option<Numbers>,
}

#[derive(Serialize)]
struct FitReport {
    source: String,
    curves: Vec<CurveReport>,
}

/// What a curve is called where.
struct Quantity {
    name: &'static str,
    unit: &'static str,
    file: &'static str,
    label: &'static str,
    /// Unit of the label per SI unit.
    scale: f64,
}

const FORCE: Quantity =
    Quantity { name: "force", unit: "N", file: "force.svg", label: "force [N]", scale: 1.0 };
const RADIAL: Quantity = Quantity {
    name: "radial displacement",
    unit: "m",
    file: "radial.svg",
    label: "radial displacement [mm]",
    scale: 1e3,
};

fn sample(args: &Args) -> anyhow::Result<Option<LinearSample>> {
    let (Some(height_mm), Some(radius_mm), Some(young_kpa), Some(poisson)) =
        (args.height_mm, args.radius_mm, args.young_kpa, args.poisson)
    else {
        return Ok(None);
    };
    for (name, found) in [("--height-mm", height_mm), ("--radius-mm", radius_mm)] {
        ensure!(found > 0.0 && found.is_finite(), "{name} {found}; allowed: a finite number above 0");
    }
    ensure!(poisson > 0.0, "--poisson {poisson}; allowed: above 0 and below 0.5 (the sample must bulge)");
    // A static sample: its density does not matter.
    let material = LinearElastic::from_young_poisson(1e3 * young_kpa, poisson, 1000.0)?;
    Ok(Some(LinearSample::cylinder(1e-3 * height_mm, 1e-3 * radius_mm, &material)))
}

/// Places at which a fitted curve is drawn.
const N_DRAWN: usize = 200;

fn plot(quantity: &Quantity, x_m: &[f64], y: &[f64], fit: &Fit, linear_slope: Option<f64>) -> LinePlot {
    let [low, high] = fit.polynomial.range();
    let drawn = |value: &dyn Fn(f64) -> f64| {
        let places = (0..=N_DRAWN).map(|i| low + (high - low) * i as f64 / N_DRAWN as f64);
        places.map(|x| [1e3 * x, quantity.scale * value(x)]).collect()
    };
    let measured = x_m.iter().zip(y).map(|(x, y)| [1e3 * x, quantity.scale * y]).collect();
    let mut series = vec![Series { name: "measured".into(), points: measured, style: SeriesStyle::Points }];
    if let Some(slope) = linear_slope {
        series.push(Series {
            name: "linear".into(),
            points: drawn(&|x| slope * x),
            style: SeriesStyle::Dashed,
        });
    }
    series.push(Series {
        name: format!("degree {}, r = {:.6}", fit.polynomial.degree(), fit.correlation),
        points: drawn(&|x| fit.polynomial.value(x)),
        style: SeriesStyle::Line,
    });
    LinePlot {
        title: format!("Measured {}", quantity.name),
        x_label: "axial displacement [mm]".into(),
        y_label: quantity.label.into(),
        series,
        size: [720, 440],
    }
}

/// Tells how well a curve is fitted.
fn print_fit(quantity: &Quantity, fit: &Fit) {
    let p = &fit.polynomial;
    println!("{} over axial displacement, {} points", quantity.name, fit.n_points);
    println!("  degree           {}", p.degree());
    println!("  r                {:.8}", fit.correlation);
    println!(
        "  residual         rms {:.3e} {}, largest {:.3e} {}",
        fit.rms_residual, quantity.unit, fit.largest_residual, quantity.unit
    );
    println!(
        "  range            {:.4} to {:.4} mm{}",
        1e3 * p.range()[0],
        1e3 * p.range()[1],
        if p.is_odd() { ", mirrored through 0" } else { "" }
    );
    let powers: Vec<String> = p.powers().iter().map(|a| format!("{a:.6e}")).collect();
    println!("  powers of x/high {}", powers.join(" "));
    if !p.is_rising() {
        println!("  warning          the polynomial falls somewhere in its range: try another degree");
    }
}

fn curve_report(quantity: &Quantity, fit: &Fit, over: Option<&CurvePolynomial>) -> CurveReport {
    CurveReport {
        quantity: quantity.name,
        unit: quantity.unit,
        r: fit.correlation,
        rms_residual: fit.rms_residual,
        largest_residual: fit.largest_residual,
        n_points: fit.n_points,
        over_axial_displacement_m: Numbers::from(&fit.polynomial),
        over_linear_magnitude: over.map(Numbers::from),
    }
}

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let curve = MeasuredCurve::read(&args.curve)?;
    let sample = sample(args)?;
    let file = args.curve.display();
    if curve.axial_displacement_m.is_empty() {
        bail!("{file}: no row of numbers under the column names");
    }
    let x_m = &curve.axial_displacement_m;
    let slopes = sample.map(|s| [s.force_n_per_m, s.radial_m_per_m]);
    let measured = [
        (&FORCE, &curve.force_n, slopes.map(|s| s[0])),
        (&RADIAL, &curve.radial_displacement_m, slopes.map(|s| s[1])),
    ];
    let mut done = Vec::new();
    for (quantity, y, slope) in measured.into_iter().filter(|(_, y, _)| !y.is_empty()) {
        let fit = fit_curve(x_m, y, args.degree)
            .with_context(|| format!("{file}: fitting the {}", quantity.name))?;
        let over = slope.map(|slope| fit.polynomial.over(slope)).transpose().with_context(|| {
            format!("{file}: the {} cannot be expressed by that of the linear sample", quantity.name)
        })?;
        let picture = plot(quantity, x_m, y, &fit, slope).to_svg()?;
        done.push((quantity, fit, over, picture));
    }

    std::fs::create_dir_all(&args.out).with_context(|| format!("making {}", args.out.display()))?;
    let mut report = FitReport { source: file.to_string(), curves: Vec::new() };
    for (quantity, fit, over, picture) in done {
        let path = args.out.join(quantity.file);
        write_atomically(&path, |w| w.write_all(picture.as_bytes()))
            .with_context(|| format!("writing {}", path.display()))?;
        print_fit(quantity, &fit);
        println!("  plot             {}", path.display());
        report.curves.push(curve_report(quantity, &fit, over.as_ref()));
    }
    let path = args.out.join("fit.json");
    write_atomically(&path, |w| {
        serde_json::to_writer_pretty(&mut *w, &report)?;
        writeln!(w)
    })
    .with_context(|| format!("writing {}", path.display()))?;
    println!("written {}", path.display());
    Ok(())
}
