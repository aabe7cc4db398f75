//! Division of 128-bit integers, in one place. The compiler writes out a whole division of this width wherever a program for a small
//! processor has one, some 600 bytes each; a node has a dozen of them, and they were a tenth of its program.

/// `numerator / denominator`, rounded down; 0 where the denominator is 0.
#[inline(never)]
pub fn quotient(numerator: u128, denominator: u128) -> u128 {
    numerator.checked_div(denominator).unwrap_or(0)
}

/// `numerator / denominator`, rounded towards 0; 0 where the denominator is 0.
#[inline(never)]
pub fn quotient_towards_zero(numerator: i128, denominator: u64) -> i128 {
    // No more than the magnitude of the numerator, which a negative one bears in full.
    let magnitude = quotient(numerator.unsigned_abs(), u128::from(denominator)) as i128;
    if numerator < 0 { magnitude.wrapping_neg() } else { magnitude }
}

/// `numerator / denominator`, rounded down; 0 where the denominator is 0.
#[inline(never)]
pub fn quotient_rounded_down(numerator: i128, denominator: u64) -> i128 {
    let towards_zero = quotient_towards_zero(numerator, denominator);
    let is_rounded_up = numerator < 0 && towards_zero.wrapping_mul(i128::from(denominator)) != numerator;
    if is_rounded_up && denominator > 0 { towards_zero - 1 } else { towards_zero }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quotients_are_those_of_the_language(numerator: i128, shift in 0_u32..127, denominator in 1_u64..) {
            let (numerator, wide) = (numerator >> shift, i128::from(denominator));
            prop_assert_eq!(quotient_towards_zero(numerator, denominator), numerator / wide);
            prop_assert_eq!(quotient_rounded_down(numerator, denominator), numerator.div_euclid(wide));
            prop_assert_eq!(quotient(numerator.unsigned_abs(), wide as u128), numerator.unsigned_abs() / wide as u128);
        }
    }

    #[test]
    fn the_ends_of_the_range_and_a_denominator_of_zero_are_borne() {
        assert_eq!(quotient_towards_zero(i128::MIN, 1), i128::MIN);
        assert_eq!(quotient_rounded_down(i128::MIN, 1), i128::MIN);
        assert_eq!((quotient(5, 0), quotient_towards_zero(-5, 0), quotient_rounded_down(-5, 0)), (0, 0, 0));
        assert_eq!(quotient_rounded_down(-7, 2), -4);
    }
}
