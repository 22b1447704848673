//! AVX2 and AVX-512 vectors.
//!
//! These types are created only inside kernels that [`super::Level::run`] started after it checked
//! that the processor supports the instructions. This makes every `unsafe` block here sound,
//! together with the contracts on pointers.

use std::arch::x86_64::*;

use super::{Kernel, Lanes, Words};

#[derive(Clone, Copy)]
pub(super) struct Bytes32(__m256i);
#[derive(Clone, Copy)]
pub(crate) struct Words16(__m256i);
#[derive(Clone, Copy)]
pub(super) struct Bytes64(__m512i);
#[derive(Clone, Copy)]
pub(crate) struct Words32(__m512i);

#[target_feature(enable = "avx2")]
pub(super) fn on_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Bytes32>()
}

#[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512vbmi,avx512bitalg")]
pub(super) fn on_avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Bytes64>()
}

/// Methods of one instruction.
macro_rules! two {
    ($($name:ident: $instruction:ident),* $(,)?) => {
        $(
            #[inline(always)]
            fn $name(self, other: Self) -> Self {
                // SAFETY: see the module.
                Self(unsafe { $instruction(self.0, other.0) })
            }
        )*
    };
}

/// Store and broadcast.
macro_rules! moves {
    ($of:ty, $signed:ty, $splat:ident, $store:ident) => {
        #[inline(always)]
        fn splat(value: $of) -> Self {
            // SAFETY: see the module.
            Self(unsafe { $splat(value as $signed) })
        }

        #[inline(always)]
        unsafe fn store(self, to: *mut $of) {
            // SAFETY: the caller's promise.
            unsafe { $store(to.cast(), self.0) }
        }
    };
}

/// Minimum of 16 bytes, in the low byte; the next byte is 0.
#[inline(always)]
unsafe fn least_of_16(v: __m128i) -> __m128i {
    // SAFETY: see the module; SSE4.1 comes with AVX2.
    unsafe {
        // Minimum of the two bytes of each word; the upper byte of the result is 0.
        let both = _mm_min_epu8(v, _mm_srli_epi16::<8>(v));
        _mm_minpos_epu16(both)
    }
}

impl Lanes for Bytes32 {
    const COUNT: usize = 32;
    type Words = Words16;

    moves!(u8, i8, _mm256_set1_epi8, _mm256_storeu_si256);

    #[inline(always)]
    unsafe fn load(from: *const u8) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { _mm256_loadu_si256(from.cast()) })
    }

    two! {
        min: _mm256_min_epu8,
        add: _mm256_adds_epu8,
        sub: _mm256_subs_epu8,
        or: _mm256_or_si256,
        xor: _mm256_xor_si256,
    }

    #[inline(always)]
    fn count_ones(self) -> Self {
        // SAFETY: see the module.
        unsafe {
            // Table lookup per nibble.
            let table = _mm256_broadcastsi128_si256(_mm_setr_epi8(
                0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4,
            ));
            let nibble = _mm256_set1_epi8(15);
            let low = _mm256_and_si256(self.0, nibble);
            let high = _mm256_and_si256(_mm256_srli_epi16::<4>(self.0), nibble);
            Self(_mm256_add_epi8(
                _mm256_shuffle_epi8(table, low),
                _mm256_shuffle_epi8(table, high),
            ))
        }
    }

    #[inline(always)]
    fn first() -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm256_setr_epi64x(0xff, 0, 0, 0) })
    }

    #[inline(always)]
    fn last() -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm256_setr_epi64x(0, 0, 0, 0xff << 56) })
    }

    #[inline(always)]
    fn up(self, before: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let across = _mm256_permute2x128_si256::<0x21>(before.0, self.0);
            Self(_mm256_alignr_epi8::<15>(self.0, across))
        }
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let across = _mm256_permute2x128_si256::<0x21>(self.0, after.0);
            Self(_mm256_alignr_epi8::<1>(across, self.0))
        }
    }

    #[inline(always)]
    fn least(self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let high = _mm256_extracti128_si256::<1>(self.0);
            let least = least_of_16(_mm_min_epu8(_mm256_castsi256_si128(self.0), high));
            Self(_mm256_broadcastb_epi8(least))
        }
    }

    #[inline(always)]
    fn any(self) -> u8 {
        // SAFETY: see the module.
        unsafe { _mm_cvtsi128_si32(_mm256_castsi256_si128(self.0)) as u8 }
    }

    #[inline(always)]
    fn widen(self) -> [Words16; 2] {
        // SAFETY: see the module.
        unsafe {
            let low = _mm256_cvtepu8_epi16(_mm256_castsi256_si128(self.0));
            let high = _mm256_cvtepu8_epi16(_mm256_extracti128_si256::<1>(self.0));
            [Words16(low), Words16(high)]
        }
    }
}

impl Words for Words16 {
    const COUNT: usize = 16;

    moves!(u16, i16, _mm256_set1_epi16, _mm256_storeu_si256);
    two! {
        min: _mm256_min_epu16,
        add: _mm256_add_epi16,
        sub: _mm256_subs_epu16,
        or: _mm256_or_si256,
    }

    #[inline(always)]
    fn counting(from: u16) -> Self {
        // SAFETY: see the module.
        unsafe {
            let steps = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            Self(_mm256_add_epi16(steps, _mm256_set1_epi16(from as i16)))
        }
    }

    #[inline(always)]
    fn pick_equal(self, other: Self, yes: Self, no: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let equal = _mm256_cmpeq_epi16(self.0, other.0);
            Self(_mm256_blendv_epi8(no.0, yes.0, equal))
        }
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let across = _mm256_permute2x128_si256::<0x21>(self.0, after.0);
            Self(_mm256_alignr_epi8::<2>(across, self.0))
        }
    }

    #[inline(always)]
    fn least(self) -> u16 {
        // SAFETY: see the module.
        unsafe {
            let high = _mm256_extracti128_si256::<1>(self.0);
            let least = _mm_minpos_epu16(_mm_min_epu16(_mm256_castsi256_si128(self.0), high));
            _mm_cvtsi128_si32(least) as u16
        }
    }
}

impl Lanes for Bytes64 {
    const COUNT: usize = 64;
    type Words = Words32;

    moves!(u8, i8, _mm512_set1_epi8, _mm512_storeu_si512);

    #[inline(always)]
    unsafe fn load(from: *const u8) -> Self {
        // SAFETY: the caller's promise.
        Self(unsafe { _mm512_loadu_si512(from.cast()) })
    }

    two! {
        min: _mm512_min_epu8,
        add: _mm512_adds_epu8,
        sub: _mm512_subs_epu8,
        or: _mm512_or_si512,
        xor: _mm512_xor_si512,
    }

    #[inline(always)]
    fn count_ones(self) -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_popcnt_epi8(self.0) })
    }

    #[inline(always)]
    fn first() -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_maskz_set1_epi8(1, -1) })
    }

    #[inline(always)]
    fn last() -> Self {
        // SAFETY: see the module.
        Self(unsafe { _mm512_maskz_set1_epi8(1 << 63, -1) })
    }

    #[inline(always)]
    fn up(self, before: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            // Indices 0 to 63 minus 1; the first byte comes from the other vector.
            let from = _mm512_sub_epi8(counting(), _mm512_set1_epi8(1));
            let from = _mm512_or_si512(from, _mm512_maskz_set1_epi8(1, 127));
            Self(_mm512_permutex2var_epi8(self.0, from, before.0))
        }
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            // Index 64 is the first byte of the other vector.
            let from = _mm512_add_epi8(counting(), _mm512_set1_epi8(1));
            Self(_mm512_permutex2var_epi8(self.0, from, after.0))
        }
    }

    #[inline(always)]
    fn least(self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let half = _mm256_min_epu8(
                _mm512_castsi512_si256(self.0),
                _mm512_extracti64x4_epi64::<1>(self.0),
            );
            let quarter = _mm_min_epu8(
                _mm256_castsi256_si128(half),
                _mm256_extracti128_si256::<1>(half),
            );
            Self(_mm512_broadcastb_epi8(least_of_16(quarter)))
        }
    }

    #[inline(always)]
    fn any(self) -> u8 {
        // SAFETY: see the module.
        unsafe { _mm_cvtsi128_si32(_mm512_castsi512_si128(self.0)) as u8 }
    }

    #[inline(always)]
    fn widen(self) -> [Words32; 2] {
        // SAFETY: see the module.
        unsafe {
            let low = _mm512_cvtepu8_epi16(_mm512_castsi512_si256(self.0));
            let high = _mm512_cvtepu8_epi16(_mm512_extracti64x4_epi64::<1>(self.0));
            [Words32(low), Words32(high)]
        }
    }
}

/// 0 to 63.
#[inline(always)]
unsafe fn counting() -> __m512i {
    const BYTES: [u8; 64] = {
        let mut bytes = [0; 64];
        let mut i = 0;
        while i < 64 {
            bytes[i] = i as u8;
            i += 1;
        }
        bytes
    };
    // SAFETY: see the module; there are 64 bytes.
    unsafe { _mm512_loadu_si512(BYTES.as_ptr().cast()) }
}

impl Words for Words32 {
    const COUNT: usize = 32;

    moves!(u16, i16, _mm512_set1_epi16, _mm512_storeu_si512);
    two! {
        min: _mm512_min_epu16,
        add: _mm512_add_epi16,
        sub: _mm512_subs_epu16,
        or: _mm512_or_si512,
    }

    #[inline(always)]
    fn counting(from: u16) -> Self {
        // SAFETY: see the module.
        unsafe {
            let steps = _mm512_cvtepu8_epi16(_mm512_castsi512_si256(counting()));
            Self(_mm512_add_epi16(steps, _mm512_set1_epi16(from as i16)))
        }
    }

    #[inline(always)]
    fn pick_equal(self, other: Self, yes: Self, no: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            let equal = _mm512_cmpeq_epi16_mask(self.0, other.0);
            Self(_mm512_mask_blend_epi16(equal, no.0, yes.0))
        }
    }

    #[inline(always)]
    fn down(self, after: Self) -> Self {
        // SAFETY: see the module.
        unsafe {
            // Index 32 is the first word of the other vector.
            let from = _mm512_add_epi16(Self::counting(0).0, _mm512_set1_epi16(1));
            Self(_mm512_permutex2var_epi16(self.0, from, after.0))
        }
    }

    #[inline(always)]
    fn least(self) -> u16 {
        // SAFETY: see the module.
        unsafe {
            let half = _mm256_min_epu16(
                _mm512_castsi512_si256(self.0),
                _mm512_extracti64x4_epi64::<1>(self.0),
            );
            let quarter = _mm_min_epu16(
                _mm256_castsi256_si128(half),
                _mm256_extracti128_si256::<1>(half),
            );
            _mm_cvtsi128_si32(_mm_minpos_epu16(quarter)) as u16
        }
    }
}
