//! Order statistics of one figure over the frames.

use serde::Serialize;

/// Percentiles by the nearest-rank rule, greatest and mean; all zero for no values.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Stats {
    /// Median.
    pub p50: f64,
    /// 90th percentile.
    pub p90: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Greatest.
    pub max: f64,
    /// Arithmetic mean.
    pub mean: f64,
}

impl Stats {
    /// Statistics of `values`.
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let Some(&max) = values.last() else { return Self::default() };
        let rank = |share: f64| {
            values[((share * values.len() as f64).ceil() as usize).clamp(1, values.len()) - 1]
        };
        Self {
            p50: rank(0.5),
            p90: rank(0.9),
            p99: rank(0.99),
            max,
            mean: mean(values.iter().copied()),
        }
    }
}

/// Arithmetic mean; 0 for no values.
pub fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0u64), |(sum, count), v| (sum + v, count + 1));
    if count == 0 { 0.0 } else { sum / count as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_one_and_a_hundred() {
        assert_eq!(Stats::of([]), Stats::default());
        let one = Stats::of([3.0]);
        assert_eq!((one.p50, one.p99, one.max, one.mean), (3.0, 3.0, 3.0, 3.0));
        let many = Stats::of((1..=100).rev().map(f64::from));
        assert_eq!(
            (many.p50, many.p90, many.p99, many.max, many.mean),
            (50.0, 90.0, 99.0, 100.0, 50.5)
        );
    }
}
