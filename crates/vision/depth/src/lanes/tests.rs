//! Vectors of every instruction set against arrays, lane by lane.

use super::{Kernel, Lanes, Level, Words};

/// All operations on given bytes; one result per operation.
struct Everything<'a> {
    a: &'a [u8],
    b: &'a [u8],
}

impl Kernel for Everything<'_> {
    type Output = Vec<Vec<u16>>;

    #[inline(always)]
    fn run<V: Lanes>(self) -> Self::Output {
        assert!(self.a.len() >= V::COUNT && self.b.len() >= V::COUNT);
        let bytes = |v: V| -> Vec<u16> {
            let mut out = vec![0u8; V::COUNT];
            // SAFETY: the buffer has the length of the vector.
            unsafe { v.store(out.as_mut_ptr()) };
            out.into_iter().map(u16::from).collect()
        };
        let words = |v: V::Words| -> Vec<u16> {
            let mut out = vec![0u16; V::Words::COUNT];
            // SAFETY: the buffer has the length of the vector.
            unsafe { v.store(out.as_mut_ptr()) };
            out
        };
        // SAFETY: asserted above.
        let (a, b) = unsafe { (V::load(self.a.as_ptr()), V::load(self.b.as_ptr())) };
        let ([c, d], [e, _]) = (a.widen(), b.widen());
        vec![
            bytes(a.min(b)),
            bytes(a.add(b)),
            bytes(a.sub(b)),
            bytes(a.or(b)),
            bytes(a.xor(b)),
            bytes(a.count_ones()),
            bytes(V::first()),
            bytes(V::last()),
            bytes(a.up(b)),
            bytes(a.down(b)),
            bytes(a.least()),
            vec![u16::from(a.any())],
            bytes(V::splat(7)),
            words(c),
            words(d),
            words(c.min(e)),
            words(c.add(e)),
            words(c.sub(e)),
            words(c.or(e)),
            words(c.pick_equal(e, V::Words::splat(1000), d)),
            words(c.down(e)),
            words(V::Words::counting(65_530)),
            vec![c.least(), d.least()],
        ]
    }
}

fn expected(a: &[u8], b: &[u8]) -> Vec<Vec<u16>> {
    let n = a.len();
    let wide = |v: &[u8]| -> Vec<u16> { v.iter().map(|v| u16::from(*v)).collect() };
    let both = |f: &dyn Fn(u8, u8) -> u8| -> Vec<u16> {
        a.iter().zip(b).map(|(a, b)| u16::from(f(*a, *b))).collect()
    };
    let only = |at: usize| (0..n).map(|i| 255 * u16::from(i == at)).collect();
    let (c, d, e) = (wide(&a[..n / 2]), wide(&a[n / 2..]), wide(&b[..n / 2]));
    let words = |f: &dyn Fn(u16, u16) -> u16| -> Vec<u16> {
        c.iter().zip(&e).map(|(a, b)| f(*a, *b)).collect()
    };
    let least = |v: &[u16]| *v.iter().min().unwrap();
    vec![
        both(&u8::min),
        both(&u8::saturating_add),
        both(&u8::saturating_sub),
        both(&|a, b| a | b),
        both(&|a, b| a ^ b),
        both(&|a, _| a.count_ones() as u8),
        only(0),
        only(n - 1),
        wide(&[&b[n - 1..], &a[..n - 1]].concat()),
        wide(&[&a[1..], &b[..1]].concat()),
        vec![least(&wide(a)); n],
        vec![u16::from(a[0])],
        vec![7; n],
        c.clone(),
        d.clone(),
        words(&u16::min),
        words(&u16::wrapping_add),
        words(&u16::saturating_sub),
        words(&|a, b| a | b),
        (0..n / 2)
            .map(|i| if c[i] == e[i] { 1000 } else { d[i] })
            .collect(),
        [&c[1..], &e[..1]].concat(),
        (0..n / 2)
            .map(|i| 65_530u16.wrapping_add(i as u16))
            .collect(),
        vec![least(&c), least(&d)],
    ]
}

#[test]
fn every_level_computes_the_same() {
    let mut random = crate::reference::Random(1);
    for level in Level::all() {
        let n = level.lanes();
        for round in 0..200 {
            // A small value range makes equal lanes likely.
            let most = if round % 2 == 0 { 256 } else { 8 };
            let mut bytes = || -> Vec<u8> { (0..n).map(|_| random.below(most) as u8).collect() };
            let (a, b) = (bytes(), bytes());
            let found = level.run(Everything { a: &a, b: &b });
            assert_eq!(found, expected(&a, &b), "{level:?}");
        }
    }
}
