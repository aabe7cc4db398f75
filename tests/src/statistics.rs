//! Statistics that the studies share.

/// An error in units of its stated standard deviation; NaN where none is stated that it could be held against: null in JSON (infinite,
/// or undetermined), or 0.
pub(crate) fn z(error: f64, std: f64) -> f64 {
    if std.is_finite() && std > 0.0 { error / std } else { f64::NAN }
}

/// How many values of [`z`] have no deviation behind them; [`rms`] and [`beyond`] leave these out.
pub(crate) fn unknown(values: &[f64]) -> usize {
    values.iter().filter(|value| value.is_nan()).count()
}

/// Root mean square of the finite ones; NaN where there are none.
pub(crate) fn rms(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|value| value.is_finite());
    let (sum, count) = finite.fold((0.0, 0), |(sum, count), value| (sum + value * value, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// Percent of magnitudes beyond a limit.
pub(crate) fn beyond(values: &[f64], limit: f64) -> f64 {
    let known = values.len() - unknown(values);
    100.0 * values.iter().filter(|value| value.abs() > limit).count() as f64 / known.max(1) as f64
}

/// The value below which a share of the values lies; NaN where there are none.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = ((values.len() as f64 - 1.0) * share).round();
    values.get(at.max(0.0) as usize).copied().unwrap_or(f64::NAN)
}

/// Wilson's 95 % interval of a share, in percent (Wilson 1927, J. Am. Stat. Assoc. 22, 209).
pub(crate) fn wilson_percent(yes: usize, of: usize) -> [f64; 2] {
    const Z: f64 = 1.96;
    let (share, count) = (yes as f64 / of as f64, of as f64);
    let scale = 1.0 + Z * Z / count;
    let middle = (share + Z * Z / (2.0 * count)) / scale;
    let half = Z * (share * (1.0 - share) / count + Z * Z / (4.0 * count * count)).sqrt() / scale;
    [middle - half, middle + half].map(|end| 100.0 * end.clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_deviation_is_counted_and_weighs_nothing() {
        let values = [z(3.0, 1.0), z(2.0, 0.5), z(9.0, f64::NAN), z(9.0, f64::INFINITY), z(9.0, 0.0)];
        assert_eq!(unknown(&values), 3);
        // (3² + 4²) / 2 = 12.5.
        assert!((rms(&values) - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!((beyond(&values, 3.5), beyond(&values, 5.0)), (50.0, 0.0));
        assert!(rms(&values[2..]).is_nan());
    }

    #[test]
    fn quantiles_stand_between_values() {
        assert_eq!(quantile(&mut [3.0, 1.0, 2.0], 0.5), 2.0);
        assert!(quantile(&mut [], 0.5).is_nan());
    }

    #[test]
    fn shares_have_wilsons_interval() {
        // Newcombe (1998), Stat. Med. 17, 857, table I: 81 of 263, 15 of 148, 0 of 20, 1 of 29.
        let published =
            [(81, 263, [25.53, 36.62]), (15, 148, [6.24, 16.05]), (0, 20, [0.0, 16.11]), (1, 29, [0.61, 17.18])];
        for (yes, of, expected) in published {
            let found = wilson_percent(yes, of);
            let is_near = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 0.01);
            assert!(is_near, "{yes} of {of}: {found:?}");
        }
    }
}
