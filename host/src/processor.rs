//! Loops compiled for what this processor can do, beside what every processor of its kind can.

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
