//! Plots as SVG: lines with named series, and histograms.
//!
//! Drawn with `plotters`' SVG backend without its font support: no font file is opened, letters are left
//! to the viewer's sans-serif. The same input gives the same bytes.

use std::path::Path;

use anyhow::{Context, anyhow, ensure};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Series colours, told apart by colour-blind readers too (Okabe and Ito 2008, yellow left out).
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(60, 60, 60),
];
const INK: RGBColor = RGBColor(34, 40, 49);
const GRID: RGBColor = RGBColor(226, 230, 235);
const FONT: &str = "sans-serif";
/// The backend rounds to whole numbers: everything is drawn this much larger and shown smaller.
const SCALE: i32 = 8;
const TITLE_PIXELS: i32 = 22;
const LABEL_PIXELS: i32 = 17;
const TICK_PIXELS: i32 = 15;
/// Rows above the plot: title, and names of the series.
const TITLE_ROW_PIXELS: i32 = 38;
const LEGEND_ROW_PIXELS: i32 = 26;
/// Sign of a series in the legend: length, and gaps around the name.
const KEY_PIXELS: i32 = 24;
const KEY_GAP_PIXELS: i32 = 8;
/// Dash and gap.
const DASH_PIXELS: [i32; 2] = [8, 5];
/// About how wide a letter of the viewer's sans-serif is, relative to its height: generous.
const LETTER_WIDTH: f64 = 0.52;
/// Empty part of an axis' range beyond the data.
const AXIS_MARGIN: f64 = 0.04;

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeriesStyle {
    /// A line through the points.
    Line,
    /// A broken line: limits and references.
    Dashed,
    /// Dots.
    Points,
}

/// Points under one name.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name in the legend; empty for none.
    pub name: String,
    /// (x, y) in the order in which they are joined. A point that is not finite breaks the line.
    pub points: Vec<[f64; 2]>,
    /// How to draw it.
    pub style: SeriesStyle,
}

/// Named series over common axes.
#[derive(Clone, Debug, PartialEq)]
pub struct LinePlot {
    /// Above the plot.
    pub title: String,
    /// Quantity and unit, such as `time [s]`.
    pub x_label: String,
    /// Quantity and unit.
    pub y_label: String,
    /// What to draw, first at the bottom.
    pub series: Vec<Series>,
    /// Width and height [pixels].
    pub size: [u32; 2],
}

/// How often values fall into intervals of equal width.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// Above the plot.
    pub title: String,
    /// Quantity and unit.
    pub x_label: String,
    /// What is counted, such as `tetrahedra`.
    pub y_label: String,
    /// The values; those outside the range are counted in the outermost intervals.
    pub values: Vec<f64>,
    /// From where to where.
    pub range: [f64; 2],
    /// Number of intervals.
    pub n_bins: usize,
    /// Vertical marks with their names (limits).
    pub marks: Vec<(f64, String)>,
    /// Width and height [pixels].
    pub size: [u32; 2],
}

impl LinePlot {
    /// The plot as SVG text.
    ///
    /// # Errors
    /// When no point is finite or the size is zero.
    pub fn to_svg(&self) -> anyhow::Result<String> {
        let finite: Vec<[f64; 2]> =
            self.series.iter().flat_map(|s| &s.points).copied().filter(is_finite).collect();
        ensure!(!finite.is_empty(), "the plot {:?} has no finite point", self.title);
        let bounds = [0, 1].map(|axis| {
            let values = finite.iter().map(|p| p[axis]);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
        });
        let x_range = with_margin(bounds[0], false);
        let y_range = with_margin(bounds[1], true);
        let frame = Frame {
            title: &self.title,
            x_label: &self.x_label,
            y_label: &self.y_label,
            x_range,
            y_range,
            size: self.size,
        };
        let shapes: Vec<Shape> = self
            .series
            .iter()
            .enumerate()
            .flat_map(|(index, series)| {
                let runs = series.points.split(|p| !is_finite(p)).filter(|run| !run.is_empty());
                runs.enumerate().map(move |(run_index, run)| Shape {
                    // One entry in the legend, however often the line is broken.
                    name: if run_index == 0 { &series.name } else { "" },
                    colour: COLOURS[index % COLOURS.len()],
                    points: run.iter().map(|&[x, y]| (x, y)).collect(),
                    kind: match series.style {
                        SeriesStyle::Line => ShapeKind::Line,
                        SeriesStyle::Dashed => ShapeKind::Dashed,
                        SeriesStyle::Points => ShapeKind::Points,
                    },
                })
            })
            .collect();
        frame.draw(&shapes)
    }

    /// Writes the plot as an SVG file.
    ///
    /// # Errors
    /// See [`LinePlot::to_svg`]; or when the file cannot be written.
    pub fn write_svg(&self, path: &Path) -> anyhow::Result<()> {
        write_text(path, &self.to_svg()?)
    }
}

impl Histogram {
    /// Number of values in each interval.
    pub(crate) fn counts(&self) -> Vec<usize> {
        let [low, high] = self.range;
        let mut counts = vec![0; self.n_bins];
        for value in self.values.iter().filter(|v| v.is_finite()) {
            let place = (value - low) / (high - low) * self.n_bins as f64;
            counts[(place.max(0.0) as usize).min(self.n_bins - 1)] += 1;
        }
        counts
    }

    /// The plot as SVG text.
    ///
    /// # Errors
    /// When there is no interval, or the range is empty.
    pub fn to_svg(&self) -> anyhow::Result<String> {
        let [low, high] = self.range;
        ensure!(
            self.n_bins > 0 && low < high && low.is_finite() && high.is_finite(),
            "the histogram {:?} has {} intervals from {low} to {high}",
            self.title,
            self.n_bins
        );
        let counts = self.counts();
        let tallest = counts.iter().copied().max().unwrap_or(0).max(1) as f64;
        let width = (high - low) / self.n_bins as f64;
        let frame = Frame {
            title: &self.title,
            x_label: &self.x_label,
            y_label: &self.y_label,
            x_range: [low, high],
            y_range: [0.0, tallest * 1.08],
            size: self.size,
        };
        let bars = counts.iter().enumerate().filter(|(_, count)| **count > 0).map(|(bin, &count)| {
            let left = low + bin as f64 * width;
            Shape {
                name: "",
                colour: COLOURS[0],
                points: vec![(left + 0.04 * width, 0.0), (left + 0.96 * width, count as f64)],
                kind: ShapeKind::Bar,
            }
        });
        let marks = self.marks.iter().enumerate().map(|(index, (place, name))| Shape {
            name,
            colour: COLOURS[1 + index % (COLOURS.len() - 1)],
            points: vec![(*place, 0.0), (*place, tallest * 1.08)],
            kind: ShapeKind::Dashed,
        });
        frame.draw(&bars.chain(marks).collect::<Vec<_>>())
    }
}

/// Something to draw between the axes.
struct Shape<'a> {
    /// Name in the legend; empty for none.
    name: &'a str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
    kind: ShapeKind,
}

#[derive(Clone, Copy)]
enum ShapeKind {
    Line,
    Dashed,
    Points,
    /// A filled rectangle between two points.
    Bar,
}

type DrawError<'b> = DrawingAreaErrorKind<<SVGBackend<'b> as plotters::backend::DrawingBackend>::ErrorType>;

/// Title, axes and grid.
struct Frame<'a> {
    title: &'a str,
    x_label: &'a str,
    y_label: &'a str,
    x_range: [f64; 2],
    y_range: [f64; 2],
    size: [u32; 2],
}

impl Frame<'_> {
    /// SVG text of the frame with `shapes` in it.
    fn draw(&self, shapes: &[Shape]) -> anyhow::Result<String> {
        ensure!(
            self.size.iter().all(|edge| (100..=10_000).contains(edge)),
            "a plot of {} x {} pixels: each edge must be 100 to 10000",
            self.size[0],
            self.size[1]
        );
        let mut svg = String::new();
        self.draw_into(&mut svg, shapes).map_err(|e| anyhow!("drawing the plot {:?}: {e}", self.title))?;
        let [width, height] = self.size;
        let scale = SCALE.unsigned_abs();
        let large = format!("width=\"{}\" height=\"{}\"", width * scale, height * scale);
        Ok(svg.replacen(&large, &format!("width=\"{width}\" height=\"{height}\""), 1))
    }

    fn draw_into<'b>(&self, svg: &'b mut String, shapes: &[Shape]) -> Result<(), DrawError<'b>> {
        let scale = SCALE.unsigned_abs();
        let root =
            SVGBackend::with_string(svg, (self.size[0] * scale, self.size[1] * scale)).into_drawing_area();
        root.fill(&WHITE)?;
        let named: Vec<&Shape> = shapes.iter().filter(|shape| !shape.name.is_empty()).collect();
        let top = TITLE_ROW_PIXELS + if named.is_empty() { 0 } else { LEGEND_ROW_PIXELS };
        let (x_decimals, y_decimals) = (decimals(self.x_range), decimals(self.y_range));
        let widest_tick = self.y_range.iter().map(|v| text_pixels(&number(*v, y_decimals), TICK_PIXELS));
        let left = widest_tick.max().expect("a range has two ends") + 46;
        let middle = SCALE * (left + i32::try_from(self.size[0]).expect("checked") - 24) / 2;
        let centred = Pos::new(HPos::Center, VPos::Center);
        let title = font(TITLE_PIXELS).pos(centred);
        root.draw(&Text::new(self.title, (middle, SCALE * TITLE_ROW_PIXELS / 2 + SCALE), title))?;
        draw_legend(&root, &named, middle)?;
        let mut chart = ChartBuilder::on(&root)
            .margin_top(SCALE * top)
            .margin_right(SCALE * 24)
            .margin_bottom(SCALE * 10)
            .margin_left(SCALE * 10)
            .x_label_area_size(SCALE * 50)
            .y_label_area_size(SCALE * (left - 10))
            .build_cartesian_2d(self.x_range[0]..self.x_range[1], self.y_range[0]..self.y_range[1])?;
        chart
            .configure_mesh()
            .x_labels(9)
            .y_labels(7)
            .max_light_lines(0)
            .bold_line_style(GRID.stroke_width(scale))
            .axis_style(INK.mix(0.7).stroke_width(scale))
            .set_all_tick_mark_size(SCALE * 5)
            .x_desc(self.x_label)
            .y_desc(self.y_label)
            .x_label_formatter(&|v| number(*v, x_decimals))
            .y_label_formatter(&|v| number(*v, y_decimals))
            .label_style(font(TICK_PIXELS))
            .axis_desc_style(font(LABEL_PIXELS))
            .draw()?;
        draw_series(&mut chart, shapes)?;
        root.present()
    }
}

/// Draws the names of the series in a row around `middle`, each behind its sign.
fn draw_legend<'b>(
    root: &DrawingArea<SVGBackend<'b>, Shift>,
    named: &[&Shape],
    middle: i32,
) -> Result<(), DrawError<'b>> {
    let entry_pixels = |shape: &Shape| {
        KEY_PIXELS + KEY_GAP_PIXELS + text_pixels(shape.name, TICK_PIXELS) + 3 * KEY_GAP_PIXELS
    };
    let mut x = middle - SCALE * named.iter().map(|shape| entry_pixels(shape)).sum::<i32>() / 2;
    let y = SCALE * (TITLE_ROW_PIXELS + LEGEND_ROW_PIXELS / 2 - 4);
    for &shape in named {
        let end = x + SCALE * KEY_PIXELS;
        let stroke = shape.stroke();
        match shape.kind {
            ShapeKind::Line | ShapeKind::Bar => {
                root.draw(&PathElement::new(vec![(x, y), (end, y)], stroke))?;
            }
            ShapeKind::Dashed => {
                let [dash, gap] = DASH_PIXELS.map(|length| SCALE * length);
                root.draw(&DashedPathElement::new([(x, y), (end, y)], dash, gap, stroke))?;
            }
            ShapeKind::Points => {
                root.draw(&Circle::new(((x + end) / 2, y), 3 * SCALE, shape.colour.filled()))?;
            }
        }
        let label = font(TICK_PIXELS).pos(Pos::new(HPos::Left, VPos::Center));
        root.draw(&Text::new(shape.name, (end + SCALE * KEY_GAP_PIXELS, y), label))?;
        x += SCALE * entry_pixels(shape);
    }
    Ok(())
}

/// Draws the shapes between the axes.
fn draw_series<'b>(
    chart: &mut ChartContext<'_, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>,
    shapes: &[Shape],
) -> Result<(), DrawError<'b>> {
    for shape in shapes {
        let points = shape.points.iter().copied();
        match shape.kind {
            ShapeKind::Line => chart.draw_series(LineSeries::new(points, shape.stroke()))?,
            ShapeKind::Dashed => {
                let [dash, gap] = DASH_PIXELS.map(|length| SCALE * length);
                chart.draw_series(DashedLineSeries::new(points, dash, gap, shape.stroke()))?
            }
            ShapeKind::Points => {
                let filled = shape.colour.filled();
                chart.draw_series(points.map(|p| Circle::new(p, 3 * SCALE, filled)))?
            }
            ShapeKind::Bar => {
                let corners = [shape.points[0], shape.points[1]];
                chart.draw_series([Rectangle::new(corners, shape.colour.mix(0.82).filled())])?
            }
        };
    }
    Ok(())
}

impl Shape<'_> {
    fn stroke(&self) -> ShapeStyle {
        self.colour.stroke_width(2 * SCALE.unsigned_abs())
    }
}

fn font(pixels: i32) -> TextStyle<'static> {
    (FONT, SCALE * pixels).into_font().color(&INK)
}

/// About how wide `text` is at this height of letters [pixels].
fn text_pixels(text: &str, height: i32) -> i32 {
    (text.chars().count() as f64 * f64::from(height) * LETTER_WIDTH).ceil() as i32
}

fn is_finite(point: &[f64; 2]) -> bool {
    point.iter().all(|v| v.is_finite())
}

/// The range of an axis: some room around the data, and from or to zero where the data come near to it.
fn with_margin([low, high]: [f64; 2], towards_zero: bool) -> [f64; 2] {
    let span = if high > low { high - low } else { low.abs().max(1.0) * 0.1 };
    let room = if towards_zero { AXIS_MARGIN * span } else { 0.0 };
    let (mut start, mut end) = (low - room, high + room);
    if towards_zero && low >= 0.0 && low < 0.4 * high {
        start = 0.0;
    }
    if towards_zero && high <= 0.0 && high > 0.4 * low {
        end = 0.0;
    }
    if start >= end {
        (start, end) = (low - 0.5 * span, high + 0.5 * span);
    }
    [start, end]
}

/// Digits after the point that tell ticks of this range apart.
fn decimals([low, high]: [f64; 2]) -> usize {
    (0..9).find(|&d| (high - low) / 10.0 >= 0.95 * 10f64.powi(-d)).unwrap_or(9) as usize
}

/// `value` with `decimals` digits after the point; in powers of ten where that would be too long.
fn number(value: f64, decimals: usize) -> String {
    if decimals > 5 || value.abs() >= 1e7 {
        return if value == 0.0 { "0".to_owned() } else { format!("{value:.1e}") };
    }
    let text = format!("{value:.decimals$}");
    // No "-0".
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        text.trim_start_matches('-').to_owned()
    } else {
        text
    }
}

fn write_text(path: &Path, text: &str) -> anyhow::Result<()> {
    use std::io::Write;
    glisson::files::write_atomically(path, |writer| writer.write_all(text.as_bytes()))
        .with_context(|| format!("writing the plot {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn force_plot() -> LinePlot {
        let wave = |i: i32| {
            let t = f64::from(i) * 0.01;
            [t, 2.4 * (1.0 - (-3.0 * t).exp()) * (1.0 + 0.08 * (9.0 * t).sin())]
        };
        LinePlot {
            title: "Contact force during palpation".to_owned(),
            x_label: "time [s]".to_owned(),
            y_label: "force [N]".to_owned(),
            series: vec![
                Series {
                    name: "instrument".to_owned(),
                    points: (0..200).map(wave).collect(),
                    style: SeriesStyle::Line,
                },
                Series {
                    name: "limit of the device".to_owned(),
                    points: vec![[0.0, 2.8], [2.0, 2.8]],
                    style: SeriesStyle::Dashed,
                },
                Series {
                    name: "reference".to_owned(),
                    points: (0..200).step_by(20).map(wave).collect(),
                    style: SeriesStyle::Points,
                },
            ],
            size: [960, 540],
        }
    }

    fn angles() -> Histogram {
        let mut random = glisson::math::SeededRandom::new(3);
        Histogram {
            title: "Dihedral angles".to_owned(),
            x_label: "angle [degrees]".to_owned(),
            y_label: "angles".to_owned(),
            values: (0..20_000).map(|_| 68.0 + 21.0 * random.normal()).collect(),
            range: [0.0, 180.0],
            n_bins: 60,
            marks: vec![(10.7, "least allowed".to_owned()), (164.8, "largest allowed".to_owned())],
            size: [960, 540],
        }
    }

    #[test]
    fn a_plot_names_axes_and_series_and_is_the_same_twice() {
        let svg = force_plot().to_svg().unwrap();
        for part in ["time [s]", "force [N]", "instrument", "limit of the device", "palpation", "</svg>"] {
            assert!(svg.contains(part), "{part}");
        }
        assert_eq!(svg, force_plot().to_svg().unwrap());
    }

    #[test]
    fn a_point_that_is_not_finite_breaks_the_line_and_none_is_an_error() {
        let mut plot = force_plot();
        let lines = |plot: &LinePlot| plot.to_svg().unwrap().matches("<polyline").count();
        let before = lines(&plot);
        plot.series[0].points[50][1] = f64::NAN;
        assert_eq!(lines(&plot), before + 1);
        plot.series.iter_mut().flat_map(|s| &mut s.points).for_each(|p| p[0] = f64::NAN);
        assert!(plot.to_svg().unwrap_err().to_string().contains("no finite point"));
    }

    #[test]
    fn a_single_point_and_a_constant_can_be_plotted() {
        let mut plot = force_plot();
        plot.series.truncate(1);
        plot.series[0].points = vec![[1.0, 0.0]];
        plot.to_svg().unwrap();
        plot.series[0].points = vec![[0.0, 5.0], [1.0, 5.0]];
        plot.to_svg().unwrap();
    }

    #[test]
    fn a_histogram_counts_every_value_once() {
        let histogram = Histogram { values: vec![-1.0, 0.0, 2.9, 3.0, 180.0, 500.0, f64::NAN], ..angles() };
        let counts = histogram.counts();
        assert_eq!((counts[0], counts[1], counts[59]), (3, 1, 2));
        let svg = angles().to_svg().unwrap();
        assert!(svg.contains("angle [degrees]") && svg.contains("least allowed"));
        assert!(Histogram { n_bins: 0, ..angles() }.to_svg().is_err());
    }

    #[test]
    fn ticks_have_the_digits_they_need() {
        assert_eq!(number(0.5, decimals([0.0, 2.0])), "0.5");
        assert_eq!(number(50.0, decimals([0.0, 300.0])), "50");
        assert_eq!(number(-1e-17, 2), "0.00");
        assert_eq!(number(2e-7, decimals([0.0, 1e-6])), "2.0e-7");
    }
}
