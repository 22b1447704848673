use super::*;

struct Exponential<'a>(&'a [f32; LANES]);

impl Kernel for Exponential<'_> {
    type Output = [f32; LANES];

    #[inline(always)]
    fn run<V: Lanes>(self) -> [f32; LANES] {
        let mut out = [0.0; LANES];
        V::load(self.0).exp().store(&mut out);
        out
    }
}

/// All operations of a vector, so that levels can be compared.
struct Everything([[f32; LANES]; 3]);

impl Kernel for Everything {
    type Output = Vec<u32>;

    #[inline(always)]
    fn run<V: Lanes>(self) -> Vec<u32> {
        let [a, b, c] = self.0.map(|from| V::load(&from));
        let vectors = [
            a + b,
            a - b,
            a * b,
            a / b,
            -a,
            a.mul_add(b, c),
            a.abs().sqrt(),
            a.min(b),
            a.max(b),
            a.less(b),
            a.and(b),
            a.and_not(b),
            a.or(b),
            a.less(b).select(b, c),
            a.exp(),
        ];
        let mut all = vec![a.bits(), a.sum().to_bits()];
        for vector in vectors {
            let mut out = [0.0; LANES];
            vector.store(&mut out);
            // The payload of a NaN is not part of the contract.
            all.extend(out.map(|v| if v.is_nan() { 1 } else { v.to_bits() }));
        }
        all
    }
}

#[test]
fn exponential_agrees_with_f64() {
    let mut worst = 0.0_f64;
    for i in 0..20_000 {
        let x: [f32; LANES] = std::array::from_fn(|k| -87.0 + (i * LANES + k) as f32 * 0.001_087);
        for (x, found) in x.into_iter().zip(Level::best().run(Exponential(&x))) {
            let expected = f64::from(x).exp();
            worst = worst.max((f64::from(found) / expected - 1.0).abs());
        }
    }
    assert!(worst < 3e-7, "{worst}");
    let x = [0.0, -200.0, 200.0, f32::NEG_INFINITY, 1.0, -1.0, 0.5, -0.5];
    let out = Level::best().run(Exponential(&x));
    assert_eq!((out[0], out[3]), (1.0, out[1]));
    assert!(out[2].is_finite() && out[1] > 0.0, "{out:?}");
}

#[test]
fn all_levels_compute_the_same_bits() {
    let random = |stream: u64, i: u64| {
        let value = counter_random::bell(1, stream, i) as f32;
        match i % 37 {
            0 => 0.0,
            1 => f32::NAN,
            2 => 1e30 * value,
            3 => f32::INFINITY,
            _ => value * 10.0,
        }
    };
    for i in 0..500 {
        let at = |stream: u64| std::array::from_fn(|k| random(stream, i * 8 + k as u64));
        let run = |level: Level| level.run(Everything([at(0), at(1), at(2)]));
        for level in Level::all() {
            assert_eq!(run(level), run(Level::Portable), "{level:?}");
        }
    }
}
