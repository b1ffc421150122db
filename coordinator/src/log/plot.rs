//! Line plots as inline SVG: no script, no foreign file.

use std::fmt::Write;

/// One curve; gaps where a value is missing.
pub(crate) struct Curve<'a> {
    /// What the legend calls it.
    pub(crate) name: &'a str,
    /// A value a frame.
    pub(crate) values: Vec<Option<f64>>,
}

const WIDTH: f64 = 860.0;
const HEIGHT: f64 = 220.0;
const LEFT: f64 = 64.0;
const BOTTOM: f64 = 22.0;
const TOP: f64 = 8.0;
const COLORS: [&str; 5] = ["#1f6feb", "#d1242f", "#1a7f37", "#9a6700", "#8250df"];

/// A plot of curves over the frame number, from 0 up to the greatest value (or the 99.5th percentile
/// where single outliers would flatten the rest; they are then cut off at the top).
pub(crate) fn plot(title: &str, unit: &str, curves: &[Curve<'_>]) -> String {
    let mut all: Vec<f64> =
        curves.iter().flat_map(|curve| curve.values.iter().flatten().copied()).collect();
    all.sort_by(f64::total_cmp);
    let Some(&greatest) = all.last() else { return String::new() };
    let typical = all[(all.len() - 1) * 199 / 200];
    let (ceiling, cut) = if greatest > 3.0 * typical && typical > 0.0 {
        (typical * 1.2, true)
    } else {
        (greatest, false)
    };
    let (step, top) = ticks(ceiling);
    let count = curves.iter().map(|curve| curve.values.len()).max().unwrap_or(0);

    let x = |frame: usize| LEFT + (WIDTH - LEFT - 8.0) * frame as f64 / (count.max(2) - 1) as f64;
    let y = |value: f64| TOP + (HEIGHT - TOP - BOTTOM) * (1.0 - value.min(top) / top);
    let mut svg = format!(
        "<figure><figcaption>{title}, {unit}{}</figcaption>",
        if cut { " (outliers cut off)" } else { "" }
    );
    let _ =
        write!(svg, "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{title}\">");
    let mut tick = 0.0;
    while tick <= top * 1.0001 {
        let at = y(tick);
        let _ = write!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{WIDTH}\" y1=\"{at:.1}\" y2=\"{at:.1}\" class=\"grid\"/>\
             <text x=\"{:.0}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
            LEFT - 6.0,
            at + 4.0,
            short_number(tick)
        );
        tick += step;
    }
    let _ = write!(
        svg,
        "<text x=\"{LEFT}\" y=\"{:.0}\">frame 0</text><text x=\"{WIDTH}\" y=\"{:.0}\" text-anchor=\"end\">{}</text>",
        HEIGHT - 5.0,
        HEIGHT - 5.0,
        count.saturating_sub(1)
    );
    for (curve, color) in curves.iter().zip(COLORS.iter().cycle()) {
        for run in runs(&curve.values) {
            let points: String = run
                .iter()
                .map(|&(frame, value)| format!("{:.1},{:.1} ", x(frame), y(value)))
                .collect();
            let _ = write!(svg, "<polyline points=\"{points}\" stroke=\"{color}\"/>");
        }
    }
    svg.push_str("</svg><div class=\"legend\">");
    for (curve, color) in curves.iter().zip(COLORS.iter().cycle()) {
        let _ = write!(svg, "<span><i style=\"background:{color}\"></i>{}</span>", curve.name);
    }
    svg.push_str("</div></figure>");
    svg
}

/// Stretches of a curve without gaps.
fn runs(values: &[Option<f64>]) -> Vec<Vec<(usize, f64)>> {
    let mut runs = vec![Vec::new()];
    for (frame, value) in values.iter().enumerate() {
        match (value, runs.last_mut()) {
            (Some(value), Some(run)) => run.push((frame, *value)),
            (None, Some(run)) if !run.is_empty() => runs.push(Vec::new()),
            _ => {}
        }
    }
    runs.retain(|run| !run.is_empty());
    runs
}

/// Distance of grid lines (1, 2 or 5 times a power of ten) and the top of the axis.
fn ticks(ceiling: f64) -> (f64, f64) {
    if ceiling <= 0.0 {
        return (1.0, 1.0);
    }
    let rough = ceiling / 4.0;
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0]
        .map(|m| m * power)
        .into_iter()
        .find(|&s| s >= rough)
        .unwrap_or(10.0 * power);
    (step, (ceiling / step).ceil() * step)
}

/// A number in at most five characters or so.
fn short_number(value: f64) -> String {
    match value {
        v if v >= 1e6 => format!("{}M", round(v / 1e6)),
        v if v >= 1e4 => format!("{}k", round(v / 1e3)),
        v => round(v),
    }
}

fn round(value: f64) -> String {
    format!("{}", (value * 1000.0).round() / 1000.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_end_on_a_tick_above_the_values() {
        for ceiling in [0.003, 0.9, 1.0, 7.0, 99.0, 101.0, 12_345.0] {
            let (step, top) = ticks(ceiling);
            assert!(
                top >= ceiling && top - step < ceiling && top / step <= 5.001,
                "{ceiling}: {step} {top}"
            );
        }
        assert_eq!(ticks(0.0), (1.0, 1.0));
    }

    #[test]
    fn gaps_split_a_curve() {
        let runs = runs(&[None, Some(1.0), Some(2.0), None, None, Some(3.0)]);
        assert_eq!(runs, [vec![(1, 1.0), (2, 2.0)], vec![(5, 3.0)]]);
        assert!(plot("t", "ms", &[Curve { name: "c", values: vec![None; 3] }]).is_empty());
    }
}
