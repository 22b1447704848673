//! Operations on single numbers that become one vector instruction each.

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
