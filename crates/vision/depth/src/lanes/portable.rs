//! Vectors as arrays, which the compiler maps to the baseline instruction set.

use super::{Lanes, Words};

const COUNT: usize = 32;

#[derive(Clone, Copy)]
pub(super) struct Bytes([u8; COUNT]);

#[derive(Clone, Copy)]
pub(crate) struct Shorts([u16; COUNT / 2]);

macro_rules! each {
    ($a:expr, $b:expr, $with:expr) => {{
        let mut out = $a;
        for (a, b) in out.iter_mut().zip($b) {
            *a = $with(*a, b);
        }
        out
    }};
}

impl Lanes for Bytes {
    const COUNT: usize = COUNT;
    type Words = Shorts;

    #[inline(always)]
    fn splat(value: u8) -> Self {
        Self([value; COUNT])
    }

    #[inline(always)]
    unsafe fn load(from: *const u8) -> Self {
        // SAFETY: the caller's promise; an array of bytes needs no alignment.
        Self(unsafe { from.cast::<[u8; COUNT]>().read() })
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut u8) {
        // SAFETY: the caller's promise; an array of bytes needs no alignment.
        unsafe { to.cast::<[u8; COUNT]>().write(self.0) };
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u8::min))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u8::saturating_add))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u8::saturating_sub))
    }

    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Self(each!(self.0, other.0, |a: u8, b: u8| a | b))
    }

    #[inline(always)]
    fn xor(self, other: Self) -> Self {
        Self(each!(self.0, other.0, |a: u8, b: u8| a ^ b))
    }

    #[inline(always)]
    fn count_ones(self) -> Self {
        // In steps that compilers vectorize.
        let count = |v: u8, _: u8| {
            let v = v - ((v >> 1) & 0x55);
            let v = (v & 0x33) + ((v >> 2) & 0x33);
            (v + (v >> 4)) & 0x0f
        };
        Self(each!(self.0, self.0, count))
    }

    #[inline(always)]
    fn first() -> Self {
        let mut out = [0; COUNT];
        out[0] = u8::MAX;
        Self(out)
    }

    #[inline(always)]
    fn last() -> Self {
        let mut out = [0; COUNT];
        out[COUNT - 1] = u8::MAX;
        Self(out)
    }

    #[inline(always)]
    fn up(self, before: Self) -> Self {
        let mut out = [0; COUNT];
        out[1..].copy_from_slice(&self.0[..COUNT - 1]);
        out[0] = before.0[COUNT - 1];
        Self(out)
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        let mut out = [0; COUNT];
        out[..COUNT - 1].copy_from_slice(&self.0[1..]);
        out[COUNT - 1] = after.0[0];
        Self(out)
    }

    #[inline(always)]
    fn least(self) -> Self {
        let mut v = self.0;
        let mut half = COUNT / 2;
        while half > 0 {
            for i in 0..half {
                v[i] = v[i].min(v[i + half]);
            }
            half /= 2;
        }
        Self::splat(v[0])
    }

    #[inline(always)]
    fn any(self) -> u8 {
        self.0[0]
    }

    #[inline(always)]
    fn widen(self) -> [Shorts; 2] {
        let half = |from: usize| {
            let mut out = [0; COUNT / 2];
            for (i, o) in out.iter_mut().enumerate() {
                *o = u16::from(self.0[from + i]);
            }
            Shorts(out)
        };
        [half(0), half(COUNT / 2)]
    }
}

impl Words for Shorts {
    const COUNT: usize = COUNT / 2;

    #[inline(always)]
    fn splat(value: u16) -> Self {
        Self([value; COUNT / 2])
    }

    #[inline(always)]
    fn counting(from: u16) -> Self {
        let mut out = [0; COUNT / 2];
        for (i, o) in out.iter_mut().enumerate() {
            *o = from.wrapping_add(i as u16);
        }
        Self(out)
    }

    #[inline(always)]
    unsafe fn store(self, to: *mut u16) {
        // SAFETY: the caller's promise.
        unsafe { to.cast::<[u16; COUNT / 2]>().write_unaligned(self.0) };
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u16::min))
    }

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u16::wrapping_add))
    }

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self(each!(self.0, other.0, u16::saturating_sub))
    }

    #[inline(always)]
    fn or(self, other: Self) -> Self {
        Self(each!(self.0, other.0, |a: u16, b: u16| a | b))
    }

    #[inline(always)]
    fn pick_equal(self, other: Self, yes: Self, no: Self) -> Self {
        let mut out = no.0;
        for i in 0..COUNT / 2 {
            if self.0[i] == other.0[i] {
                out[i] = yes.0[i];
            }
        }
        Self(out)
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        let mut out = [0; COUNT / 2];
        out[..COUNT / 2 - 1].copy_from_slice(&self.0[1..]);
        out[COUNT / 2 - 1] = after.0[0];
        Self(out)
    }

    #[inline(always)]
    fn least(self) -> u16 {
        let mut v = self.0;
        let mut half = COUNT / 4;
        while half > 0 {
            for i in 0..half {
                v[i] = v[i].min(v[i + half]);
            }
            half /= 2;
        }
        v[0]
    }
}
