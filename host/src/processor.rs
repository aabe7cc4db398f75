//! Loops over rows, compiled for what this processor can do, beside what every processor of its kind can.

use pulp::{Arch, Simd, WithSimd};

/// What a processor does with numbers.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Arithmetic {
    /// Whether it multiplies and adds in one instruction; where it does not, rounding once is a slow function.
    is_fused: bool,
}

impl Arithmetic {
    /// `a b + c`.
    #[inline(always)]
    pub(crate) fn multiply_add(self, a: f64, b: f64, c: f64) -> f64 {
        if self.is_fused { a.mul_add(b, c) } else { a * b + c }
    }
}

/// Runs `work`, compiled once more for wide registers where the processor has them. Its closure, and the functions it calls that
/// are worth it, must be `#[inline(always)]`: what is not inlined is compiled for every processor. The compiler does not inline all
/// of the iterators' own functions there, so that the innermost loops go by an index, and are written for a fixed number of values:
/// of any number, those that do not fill a register are done one by one.
#[inline(always)]
pub(crate) fn on_this_processor<R>(work: impl FnMut(Arithmetic) -> R) -> R {
    /// pulp's own way for closures goes by `FnOnce`, whose shim is not inlined.
    struct Work<F>(F);
    impl<R, F: FnMut(Arithmetic) -> R> WithSimd for Work<F> {
        type Output = R;

        #[inline(always)]
        fn with_simd<S: Simd>(mut self, _: S) -> R {
            // Every processor whose wide registers pulp knows has the instruction for them.
            (self.0)(Arithmetic { is_fused: size_of::<S::f64s>() > size_of::<f64>() })
        }
    }
    Arch::new().dispatch(Work(work))
}

/// The whole rows among `values`: what is left of one at the end is no row, and without channels there is none.
#[inline(always)]
pub(crate) fn whole_rows(values: &[f64], channels: usize) -> &[f64] {
    &values[..values.len().checked_div(channels).unwrap_or(0) * channels]
}

/// What is done with each channel of a row, for `WIDTH` channels from `first` on. All that is read is to be [`loaded`] before
/// anything is stored, so that the compiler need not ask whether one overlaps the other.
pub(crate) trait OnChannels {
    /// Does it; `#[inline(always)]`.
    fn take<const WIDTH: usize>(&mut self, first: usize);
}

/// Does `work` with `count` channels: as many at a time as there are registers for.
#[inline(always)]
pub(crate) fn by_channels(count: usize, work: &mut impl OnChannels) {
    let mut first = 0;
    while first + 16 <= count {
        work.take::<16>(first);
        first += 16;
    }
    while first + 4 <= count {
        work.take::<4>(first);
        first += 4;
    }
    while first < count {
        work.take::<1>(first);
        first += 1;
    }
}

/// `WIDTH` values from `first` on.
#[expect(clippy::manual_memcpy, reason = "the library's own function is not inlined there")]
#[inline(always)]
pub(crate) fn loaded<T: Copy + Default, const WIDTH: usize>(values: &[T], first: usize) -> [T; WIDTH] {
    let values = &values[first..first + WIDTH];
    let mut copy = [T::default(); WIDTH];
    for lane in 0..WIDTH {
        copy[lane] = values[lane];
    }
    copy
}

/// Puts values back.
#[expect(clippy::manual_memcpy, reason = "the library's own function is not inlined there")]
#[inline(always)]
pub(crate) fn store<T: Copy, const WIDTH: usize>(values: &mut [T], first: usize, new: &[T; WIDTH]) {
    let values = &mut values[first..first + WIDTH];
    for lane in 0..WIDTH {
        values[lane] = new[lane];
    }
}

/// The weighted sum of rows, of as many as there are weights and of as many channels as `sums` has.
#[inline(always)]
pub(crate) fn weighted_sum(arithmetic: Arithmetic, weights: &[f64], rows: &[f64], sums: &mut [f64]) {
    by_channels(sums.len(), &mut WeightedSum { arithmetic, weights, rows, sums });
}

struct WeightedSum<'a> {
    arithmetic: Arithmetic,
    weights: &'a [f64],
    rows: &'a [f64],
    sums: &'a mut [f64],
}

impl OnChannels for WeightedSum<'_> {
    #[inline(always)]
    fn take<const WIDTH: usize>(&mut self, first: usize) {
        // Rows that are added up each on their own, so that one addition need not wait for the other: as many as there are registers for.
        let at_once = if WIDTH < 16 { 4 } else { 2 };
        let (arithmetic, weights, rows, channels) = (self.arithmetic, self.weights, self.rows, self.sums.len());
        let mut parts = [[0.0; WIDTH]; 4];
        let (mut tap, mut from) = (0, first);
        while tap + at_once <= weights.len() {
            for at in 0..at_once {
                add_weighted(arithmetic, weights[tap + at], &rows[from..from + WIDTH], &mut parts[at]);
                from += channels;
            }
            tap += at_once;
        }
        while tap < weights.len() {
            add_weighted(arithmetic, weights[tap], &rows[from..from + WIDTH], &mut parts[0]);
            tap += 1;
            from += channels;
        }
        let mut sums = parts[0];
        for part in &parts[1..] {
            for channel in 0..WIDTH {
                sums[channel] += part[channel];
            }
        }
        store(self.sums, first, &sums);
    }
}

#[inline(always)]
fn add_weighted<const WIDTH: usize>(arithmetic: Arithmetic, weight: f64, row: &[f64], sums: &mut [f64; WIDTH]) {
    for channel in 0..WIDTH {
        sums[channel] = arithmetic.multiply_add(weight, row[channel], sums[channel]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_channel_is_taken_once_as_many_at_a_time_as_fit() {
        struct Taken(Vec<[usize; 2]>);
        impl OnChannels for Taken {
            fn take<const WIDTH: usize>(&mut self, first: usize) {
                self.0.push([first, WIDTH]);
            }
        }
        let taken = |count: usize| {
            let mut taken = Taken(Vec::new());
            by_channels(count, &mut taken);
            taken.0
        };
        assert!(taken(0).is_empty());
        assert_eq!(taken(16), [[0, 16]]);
        assert_eq!(taken(23), [[0, 16], [16, 4], [20, 1], [21, 1], [22, 1]]);
        assert_eq!(taken(37), [[0, 16], [16, 16], [32, 4], [36, 1]]);
    }

    #[test]
    fn weighted_sums_are_the_plain_ones_whatever_the_number_of_channels_and_taps() {
        for channels in [1, 3, 4, 5, 16, 23] {
            for taps in [1, 2, 3, 64] {
                // Whole numbers: no order of additions rounds.
                let weights: Vec<f64> = (0..taps).map(|tap| (tap * 37 % 19) as f64 - 9.0).collect();
                let mut rows: Vec<f64> = (0..taps * channels).map(|at| (at * at * 13 % 101) as f64 - 50.0).collect();
                let plain: Vec<f64> = (0..channels)
                    .map(|channel| (0..taps).map(|tap| weights[tap] * rows[tap * channels + channel]).sum())
                    .collect();
                // Rows behind the last tap do not count, nor what the sums were before.
                rows.extend(vec![f64::NAN; channels]);
                let mut here = vec![f64::NAN; channels];
                on_this_processor(
                    #[inline(always)]
                    |arithmetic| weighted_sum(arithmetic, &weights, &rows, &mut here),
                );
                assert_eq!(here, plain, "{channels} channels, {taps} taps");
                for is_fused in [false, true] {
                    let mut sums = vec![f64::NAN; channels];
                    weighted_sum(Arithmetic { is_fused }, &weights, &rows, &mut sums);
                    assert_eq!(sums, plain, "{channels} channels, {taps} taps");
                }
            }
        }
    }

    #[test]
    fn a_part_of_a_row_is_no_row_and_without_channels_there_is_none() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0];
        assert_eq!(whole_rows(&values, 1), values);
        assert_eq!(whole_rows(&values, 2), [1.0, 2.0, 3.0, 4.0]);
        assert_eq!(whole_rows(&values, 5), values);
        assert!(whole_rows(&values, 6).is_empty() && whole_rows(&values, 0).is_empty());
    }
}
