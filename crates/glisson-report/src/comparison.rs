//! A result beside a group and beside the same person's other attempts: boxes and learning curves.

use super::words::{escaped, number};
use crate::plot::{LinePlot, Series, SeriesStyle};
use glisson::units::for_people;
use glisson_results::comparison::{MetricComparison, NamedCurve};
use glisson_results::statistics::{FEWEST_FOR_QUARTILES, Place, Quartiles, Standing};
use std::fmt::Write as _;

const BOX_SIZE: [f64; 2] = [160.0, 20.0];
/// Between the outermost value and the edge of its picture [pixels].
const BOX_MARGIN: f64 = 8.0;
const CURVE_SIZE: [u32; 2] = [880, 260];

/// What a metric is beside the group, for two cells of a table: numbers with a box, and a word.
pub(super) fn cells(metric: Option<&MetricComparison>) -> String {
    let Some(metric) = metric else { return "<td><td>".into() };
    let Some(quartiles) = &metric.quartiles else {
        let few = "too few for quartiles";
        return format!("<td class=\"small\">{} of the group have it: {few}<td>", metric.n_people);
    };
    let shown = |value: f64| number(for_people(value, &metric.unit).0);
    let [first, median, third] = [quartiles.first, quartiles.median, quartiles.third].map(shown);
    let picture = metric.value.map(|value| box_svg(quartiles, value)).unwrap_or_default();
    let (class, word) = match (metric.standing, metric.value.and_then(|value| quartiles.place(value))) {
        (Some(Standing::Better), _) => ("good", "better"),
        (Some(Standing::Worse), _) => ("bad", "worse"),
        (Some(Standing::As), _) => ("", "as the group"),
        // Neither good nor bad, or of an attempt that was not done.
        (None, Some(Place::Below)) => ("small", "below"),
        (None, Some(Place::Above)) => ("small", "above"),
        (None, Some(Place::Within)) => ("small", "among them"),
        (None, None) => ("", ""),
    };
    format!(
        "<td class=\"box\">{picture}<br><span class=\"small\">{first} | {median} | {third}</span><td class=\"{class}\">{word}"
    )
}

/// A box from the first to the third quartile with the median in it, a line from the least to the greatest value, and a dot
/// for the value.
fn box_svg(quartiles: &Quartiles, value: f64) -> String {
    let Quartiles { least, first, median, third, greatest } = *quartiles;
    let (low, high) = (least.min(value), greatest.max(value));
    let [width, height] = BOX_SIZE;
    let span = if high > low { high - low } else { 1.0 };
    let x = |value: f64| BOX_MARGIN + (width - 2.0 * BOX_MARGIN) * (value - low) / span;
    let middle = 0.5 * height;
    let line = |[x1, y1]: [f64; 2], [x2, y2]: [f64; 2]| {
        format!("<path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\" stroke=\"#59636e\" stroke-width=\"1.5\"/>")
    };
    let whiskers = line([x(least), middle], [x(greatest), middle]);
    let across = line([x(median), 3.0], [x(median), height - 3.0]);
    let (left, wide) = (x(first), (x(third) - x(first)).max(1.0));
    let high = height - 6.0;
    format!(
        "<svg role=\"img\" aria-label=\"the value beside the group's quartiles\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\">{whiskers}<rect x=\"{left:.1}\" y=\"3\" width=\"{wide:.1}\" height=\"{high}\" \
         fill=\"#dfe8f0\" stroke=\"#59636e\"/>{across}<circle cx=\"{:.1}\" cy=\"{middle}\" r=\"5\" fill=\"#d55e00\"/></svg>",
        x(value)
    )
}

/// The plot of a learning curve, with the group's quartiles as broken lines.
pub fn curve_plot(named: &NamedCurve, size: [u32; 2]) -> LinePlot {
    let NamedCurve { of, title, unit, curve } = named;
    let shown = |value: f64| for_people(value, unit).0;
    let (_, unit) = for_people(0.0, unit);
    let label = title.to_lowercase();
    let y_label = if unit.is_empty() { label } else { format!("{label} [{unit}]") };
    let points: Vec<[f64; 2]> =
        curve.points.iter().map(|(attempt, value)| [*attempt as f64, shown(*value)]).collect();
    let line = |name: &str, points: Vec<[f64; 2]>, style| Series { name: name.into(), points, style };
    let mut series =
        vec![line("", points.clone(), SeriesStyle::Line), line("attempts", points, SeriesStyle::Points)];
    let end = curve.n_attempts.max(2) as f64;
    for (name, value) in curve.band.into_iter().flat_map(|band| {
        [("first quartile", band.first), ("median", band.median), ("third quartile", band.third)]
    }) {
        series.push(line(name, vec![[1.0, shown(value)], [end, shown(value)]], SeriesStyle::Dashed));
    }
    let title = of.tool.as_ref().map_or_else(|| title.clone(), |tool| format!("{title} ({tool})"));
    LinePlot { title, x_label: "attempt".into(), y_label, series, size }
}

/// The curves below each other; nothing where there is no attempt but one.
pub(super) fn write_curves(html: &mut String, curves: &[NamedCurve]) -> std::fmt::Result {
    if curves.iter().all(|named| named.curve.points.len() < 2) {
        return Ok(());
    }
    html.push_str(
        "<h2>Learning curves</h2><p class=\"small\">All attempts of this person at this task that were done. Broken lines are \
         the quartiles of the group.</p>",
    );
    for named in curves {
        let plot = curve_plot(named, CURVE_SIZE);
        // A plot without a point is none.
        if let Ok(svg) = plot.to_svg() {
            write!(html, "<figure role=\"img\" aria-label=\"{}\">{svg}</figure>", escaped(&plot.title))?;
        }
    }
    Ok(())
}

/// What is said above the table of metrics.
pub(super) fn group_text(comparison: &glisson_results::Comparison) -> Option<String> {
    let reference = comparison.reference.as_ref()?;
    let (group, n) = (escaped(&reference.group), reference.n_people);
    let enough = if n < FEWEST_FOR_QUARTILES {
        format!("Quartiles need {FEWEST_FOR_QUARTILES} people.")
    } else {
        "The box is from the first to the third quartile of the group, the line in it the median, the dot this result; numbers \
         are the quartiles."
            .to_owned()
    };
    Some(format!(
        "<p class=\"small\">Beside the group \"{group}\": {n} people other than this one have passed this task, each counted with \
         the last result that passed. {enough}</p>"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glisson::training::metrics::Better;
    use glisson_results::comparison::MetricName;
    use glisson_results::statistics::{learning_curve, quartiles};

    fn metric(value: f64) -> MetricComparison {
        let quartiles = quartiles(&[0.01, 0.02, 0.03, 0.04]);
        let standing = quartiles.unwrap().place(value).unwrap().standing(Better::Less);
        MetricComparison {
            of: MetricName { name: "path_length".into(), tool: None },
            title: "Path length".into(),
            unit: "m".into(),
            better: Better::Less,
            value: Some(value),
            n_people: 4,
            quartiles,
            standing,
        }
    }

    #[test]
    fn a_metric_stands_beside_its_box_in_the_units_of_people() {
        let text = cells(Some(&metric(0.05)));
        assert!(text.contains("17.5 | 25 | 32.5") && text.contains("class=\"bad\">worse"), "{text}");
        // From 8 to 152 pixels: 0.01 at the left, the value 0.05 at the right.
        assert!(text.contains("cx=\"152.0\"") && text.contains("M8.0 10.0L116.0 10.0"), "{text}");
        assert!(cells(Some(&metric(0.01))).contains("class=\"good\">better"));
        let few = MetricComparison { quartiles: None, standing: None, n_people: 3, ..metric(0.01) };
        assert!(cells(Some(&few)).contains("3 of the group have it: too few"));
    }

    #[test]
    fn equal_values_have_a_box_too() {
        let all = quartiles(&[2.0; 4]).unwrap();
        assert!(box_svg(&all, 2.0).contains("cx=\"8.0\""));
    }

    #[test]
    fn a_curve_has_its_attempts_and_the_band_of_the_group() {
        let named = NamedCurve {
            of: MetricName { name: "path_length".into(), tool: Some("probe".into()) },
            title: "Path length".into(),
            unit: "m".into(),
            curve: learning_curve(&[Some(0.5), None, Some(0.25)], quartiles(&[0.1, 0.2, 0.3, 0.4])),
        };
        let plot = curve_plot(&named, CURVE_SIZE);
        assert_eq!((plot.title.as_str(), plot.y_label.as_str()), ("Path length (probe)", "path length [mm]"));
        assert_eq!(plot.series[1].points, [[1.0, 500.0], [3.0, 250.0]]);
        assert_eq!(plot.series[3].points, [[1.0, 250.0], [3.0, 250.0]]);
        let svg = plot.to_svg().unwrap();
        assert!(svg.contains("third quartile") && svg.contains("attempt"));
    }
}
