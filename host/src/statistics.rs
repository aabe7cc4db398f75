//! Figures and orders of numbers that several folders need.

use belfry_numerics::sets_apart;

/// The median of the magnitudes of normal numbers, in standard deviations.
pub(crate) const MEDIAN_OF_ABSOLUTE: f64 = 0.6745;

/// The median, of an even count the upper of the two in the middle; `None` of nothing. Leaves the values in another order.
pub(crate) fn median(values: &mut [f64]) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Decimal places that show each of these deviations with two significant figures at least, from `least` to `most` of them; deviations
/// that are 0 or not known say nothing.
pub(crate) fn places(deviations: &[f64], least: usize, most: usize) -> usize {
    let smallest = deviations.iter().copied().filter(|value| value.is_finite() && *value > 0.0).reduce(f64::min);
    smallest.map_or(least, |smallest| (1.0 - smallest.log10().floor()).clamp(least as f64, most as f64) as usize)
}

/// Indices of values, the largest value first.
pub(crate) fn largest_first(values: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[b].total_cmp(&values[a]));
    order
}

/// Probability that at least `count` of some things happen, each with a probability by itself.
pub(crate) fn at_least(count: usize, of: usize, probability: f64) -> f64 {
    let (mut of_fewer, mut exactly) = (0.0, (1.0 - probability).powi(of as i32));
    for fewer in 0..count.min(of) {
        of_fewer += exactly;
        exactly *= (of - fewer) as f64 / (fewer + 1) as f64 * probability / (1.0 - probability);
    }
    1.0 - of_fewer
}

/// Which of `count` belong together, for each of them: chains of what is near.
pub(crate) fn groups(count: usize, near: &dyn Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut groups = vec![Vec::new(); count];
    for set in sets_apart(count, near) {
        set.iter().for_each(|&member| groups[member].clone_from(&set));
    }
    groups
}

#[cfg(test)]
mod tests {
    #[test]
    fn indices_go_from_the_largest_value_to_the_least_and_equal_ones_stay_in_order() {
        assert_eq!(super::largest_first(&[1.0, 3.0, -2.0, 3.0]), [1, 3, 0, 2]);
        assert!(super::largest_first(&[]).is_empty());
    }

    #[test]
    fn two_figures_of_the_smallest_deviation_are_shown() {
        let shown = |deviations: &[f64]| super::places(deviations, 2, 6);
        assert_eq!([shown(&[0.25]), shown(&[0.25, 0.093]), shown(&[0.0031])], [2, 3, 4]);
        assert_eq!([shown(&[12.0]), shown(&[1e-9])], [2, 6], "within reason");
        assert_eq!([shown(&[f64::INFINITY, 0.02]), shown(&[f64::NAN, 0.0]), shown(&[])], [3, 2, 2]);
    }

    #[test]
    fn the_median_is_in_the_middle_whatever_the_order() {
        assert_eq!(super::median(&mut [3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(super::median(&mut [4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(super::median(&mut []), None);
    }
}
