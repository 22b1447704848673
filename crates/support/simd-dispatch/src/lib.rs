//! Inner loops compiled for the vector instructions of the processor, chosen at run time.
//!
//! Contract: a kernel gives the same bits with every instruction set. The compiler neither fuses
//! multiplications and additions nor reorders sums on its own, so the order that is written counts.
//!
//! ```
//! use simd_dispatch::{Kernel, run};
//!
//! struct Squares<'k>(&'k mut [f32]);
//!
//! impl Kernel for Squares<'_> {
//!     type Output = ();
//!
//!     #[inline(always)]
//!     fn run(self) {
//!         for v in self.0 {
//!             *v *= *v;
//!         }
//!     }
//! }
//!
//! let mut values = [1.0, 2.0, 3.0];
//! run(Squares(&mut values));
//! assert_eq!(values, [1.0, 4.0, 9.0]);
//! ```

/// An inner loop. What it calls has to be inlined into it, and it calls no closures: both would be
/// compiled without the instruction set.
pub trait Kernel {
    /// What it computes.
    type Output;

    /// Has the attribute `#[inline(always)]`.
    fn run(self) -> Self::Output;
}

/// Runs a kernel with AVX2 where the processor has it.
pub fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports the target features of the function, as checked above.
        return unsafe { on_avx2(kernel) };
    }
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn on_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
