//! Inner loops compiled for the vector instructions of the processor.
//!
//! Contract: a kernel gives the same bits with every instruction set: the compiler fuses no
//! multiplications and additions, and reorders none, on its own.

/// An inner loop. What it calls has to be inlined into it.
pub(crate) trait Kernel {
    /// Has the attribute `#[inline(always)]`.
    fn run(self);
}

/// Runs a kernel with AVX2 where the processor has it.
#[expect(unsafe_code, reason = "the instruction set is checked at run time")]
pub(crate) fn run<K: Kernel>(kernel: K) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports the target features of the function, as checked above.
        unsafe { on_avx2(kernel) };
        return;
    }
    kernel.run();
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn on_avx2<K: Kernel>(kernel: K) {
    kernel.run();
}

/// The integer part of a number, which is limited to 1e9; -1e9 for NaN. Unlike `as`, it becomes one
/// vector instruction.
#[inline(always)]
#[expect(unsafe_code, reason = "the number is limited before its conversion")]
pub(crate) fn truncated(x: f32) -> i32 {
    let x = larger(x, -1e9);
    let x = smaller(x, 1e9);
    // SAFETY: the number is not NaN, and within the range of integers of 32 bits.
    unsafe { x.to_int_unchecked() }
}

/// The larger number, or the second one for NaN. Unlike `max`, it becomes one instruction.
#[inline(always)]
pub(crate) fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller number, or the second one for NaN.
#[inline(always)]
pub(crate) fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conversions_truncate_and_are_limited() {
        for (x, expected) in [
            (2.9, 2),
            (-2.9, -2),
            (-0.5, 0),
            (f32::INFINITY, 1_000_000_000),
            (f32::NEG_INFINITY, -1_000_000_000),
            (f32::NAN, -1_000_000_000),
        ] {
            assert_eq!(truncated(x), expected, "{x}");
        }
        assert_eq!((larger(1.0, 2.0), smaller(1.0, 2.0)), (2.0, 1.0));
        assert_eq!((larger(f32::NAN, 2.0), smaller(f32::NAN, 2.0)), (2.0, 2.0));
    }
}
