//! What a vector of eight `f32` does.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// Number of lanes.
pub(crate) const LANES: usize = 8;

/// Vectorized computation.
pub(crate) trait Kernel {
    /// Result of the kernel.
    type Output;
    /// Runs the kernel. Implementations are `#[inline(always)]`; otherwise the compiler does not
    /// vectorize them.
    fn run<V: Lanes>(self) -> Self::Output;
}

/// A vector of eight `f32`. Masks are vectors whose lanes have all bits set or none.
pub(crate) trait Lanes:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// All lanes equal to `value`.
    fn splat(value: f32) -> Self;
    /// From memory.
    fn load(from: &[f32; LANES]) -> Self;
    /// Into memory.
    fn store(self, to: &mut [f32; LANES]);
    /// `self * by + plus` with one rounding.
    fn mul_add(self, by: Self, plus: Self) -> Self;
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// The smaller one; `other` if one is NaN.
    fn min(self, other: Self) -> Self;
    /// The larger one; `other` if one is NaN.
    fn max(self, other: Self) -> Self;
    /// Mask: `self < other`; false if one is NaN.
    fn less(self, other: Self) -> Self;
    /// Bitwise and.
    fn and(self, other: Self) -> Self;
    /// Bitwise: `self` and not `mask`.
    fn and_not(self, mask: Self) -> Self;
    /// Bitwise or.
    fn or(self, other: Self) -> Self;
    /// `self` is a mask: `yes` where it is set, `no` elsewhere.
    fn select(self, yes: Self, no: Self) -> Self;
    /// The signs of the lanes as bits, the first lane in bit 0.
    fn bits(self) -> u32;
    /// Sum of all lanes: halves first, then quarters.
    fn sum(self) -> f32;
    /// `2^n` for each lane `1.5 * 2^23 + n`, n an integer in -126 to 127.
    fn power_of_two(self) -> Self;

    /// `exp(self)`, relative error below 3e-7 for arguments in -87 to 87; arguments beyond are
    /// taken as these.
    #[inline(always)]
    fn exp(self) -> Self {
        let s = Self::splat;
        let x = self.max(s(-87.0)).min(s(87.0));
        // exp(x) = 2^n exp(r), with n the nearest integer to x / ln 2; the added number leaves no
        // bits for the fraction. ln 2 in two parts, so that r is exact.
        let shifted = x.mul_add(s(std::f32::consts::LOG2_E), s(12_582_912.0));
        let n = shifted - s(12_582_912.0);
        let r = n.mul_add(s(-0.693_359_4), x);
        let r = n.mul_add(s(2.121_944_4e-4), r);
        // Minimax polynomial of (exp(r) - 1 - r) / r² on |r| <= ln 2 / 2 (Cephes, Moshier 1989).
        let p = s(1.987_569_1e-4)
            .mul_add(r, s(1.398_199_9e-3))
            .mul_add(r, s(8.333_452e-3))
            .mul_add(r, s(4.166_579_6e-2))
            .mul_add(r, s(1.666_666_5e-1))
            .mul_add(r, s(0.5));
        p.mul_add(r * r, r + s(1.0)) * shifted.power_of_two()
    }
}
