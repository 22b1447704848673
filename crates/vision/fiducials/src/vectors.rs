//! Loops that are compiled for the vectors of the processor.
//!
//! Contract: a kernel computes the same bits with every instruction set: its operations are those
//! of single elements, multiplications and additions are never fused, and the order of every sum is
//! written in it. Kernels call no closures: these would be compiled without the instruction set.

/// A loop.
pub(crate) trait Kernel {
    type Output;

    /// Has to be `#[inline(always)]`, like all that it calls in its loop.
    fn run(self) -> Self::Output;
}

/// Runs a kernel with the vectors of this processor.
pub(crate) fn run<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports the target features of the function, as checked above.
        return unsafe { run_avx2(kernel) };
    }
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}
