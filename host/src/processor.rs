//! Loops over rows, compiled for what this processor can do, beside what every processor of its kind can.

use pulp::{Arch, Simd, WithSimd};

/// Runs `work`, compiled once more for wide registers where the processor has them. Its closure, and the functions it calls that
/// are worth it, must be `#[inline(always)]`: what is not inlined is compiled for every processor. The compiler does not inline all
/// of the iterators' own functions there, so that the innermost loops go by an index.
#[inline(always)]
pub(crate) fn on_this_processor<R>(work: impl FnMut() -> R) -> R {
    /// pulp's own way for closures goes by `FnOnce`, whose shim is not inlined.
    struct Work<F>(F);
    impl<R, F: FnMut() -> R> WithSimd for Work<F> {
        type Output = R;

        #[inline(always)]
        fn with_simd<S: Simd>(mut self, _: S) -> R {
            (self.0)()
        }
    }
    Arch::new().dispatch(Work(work))
}

/// Hands out rows of `channels` values one by one, as [`on_this_processor`] does work: `take` must be `#[inline(always)]`.
#[inline(always)]
pub(crate) fn for_each_row(rows: &[f64], channels: usize, mut take: impl FnMut(&[f64])) {
    on_this_processor(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(channels.max(1)) {
                take(row);
            }
        },
    );
}

/// The weighted sum of rows, of as many as there are weights and of as many channels as `sums` has.
#[inline(always)]
pub(crate) fn weighted_sum(weights: &[f64], rows: &[f64], sums: &mut [f64]) {
    let mut first = 0;
    while first < sums.len() {
        // As many channels at a time as there are registers for.
        first += match sums.len() - first {
            16.. => of_channels::<16>(weights, rows, sums, first),
            4.. => of_channels::<4>(weights, rows, sums, first),
            _ => of_channels::<1>(weights, rows, sums, first),
        };
    }
}

/// [`weighted_sum`] of `WIDTH` channels from `first` on; how many channels that are.
#[inline(always)]
fn of_channels<const WIDTH: usize>(weights: &[f64], rows: &[f64], sums: &mut [f64], first: usize) -> usize {
    // Of every other row, so that one addition need not wait for the other.
    let (mut even, mut odd) = ([0.0; WIDTH], [0.0; WIDTH]);
    let mut from = first;
    let pairs = weights.chunks_exact(2);
    let last = pairs.remainder();
    for weights in pairs {
        let (row, next) = (&rows[from..from + WIDTH], &rows[from + sums.len()..from + sums.len() + WIDTH]);
        for channel in 0..WIDTH {
            even[channel] += weights[0] * row[channel];
            odd[channel] += weights[1] * next[channel];
        }
        from += 2 * sums.len();
    }
    for weight in last {
        let row = &rows[from..from + WIDTH];
        for channel in 0..WIDTH {
            even[channel] += weight * row[channel];
        }
    }
    for channel in 0..WIDTH {
        sums[first + channel] = even[channel] + odd[channel];
    }
    WIDTH
}
