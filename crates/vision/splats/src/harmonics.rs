//! Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS files.
//!
//! A color is `max(0, 1/2 + Σ_k Y_k(d) f_k)`, with `d` the unit direction from the camera to the
//! Gaussian, in the world. Constants: the real harmonics of a unit sphere (e.g. Sloan, Stupid
//! Spherical Harmonics Tricks, 2008), with the Condon-Shortley phase.

use gaussians::harmonics::CONSTANT;

use crate::lanes::Lanes;

const Y1: f32 = 0.488_602_5;
const Y2: [f32; 5] = [
    1.092_548_4,
    -1.092_548_4,
    0.315_391_57,
    -1.092_548_4,
    0.546_274_2,
];
const Y3: [f32; 7] = [
    -0.590_043_6,
    2.890_611_4,
    -0.457_045_8,
    0.373_176_33,
    -0.457_045_8,
    1.445_305_7,
    -0.590_043_6,
];

/// Values of the harmonics in eight unit directions; those above the degree are 0.
#[inline(always)]
pub(crate) fn basis<V: Lanes>([x, y, z]: [V; 3], degree: usize) -> [V; 16] {
    let s = V::splat;
    let mut out = [s(0.0); 16];
    out[0] = s(CONSTANT);
    if degree == 0 {
        return out;
    }
    out[1] = y * s(-Y1);
    out[2] = z * s(Y1);
    out[3] = x * s(-Y1);
    if degree == 1 {
        return out;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    out[4] = xy * s(Y2[0]);
    out[5] = yz * s(Y2[1]);
    out[6] = (zz + zz - xx - yy) * s(Y2[2]);
    out[7] = xz * s(Y2[3]);
    out[8] = (xx - yy) * s(Y2[4]);
    if degree == 2 {
        return out;
    }
    let four = s(4.0) * zz - xx - yy;
    out[9] = y * (s(3.0) * xx - yy) * s(Y3[0]);
    out[10] = xy * z * s(Y3[1]);
    out[11] = y * four * s(Y3[2]);
    out[12] = z * (zz + zz - s(3.0) * (xx + yy)) * s(Y3[3]);
    out[13] = x * four * s(Y3[4]);
    out[14] = z * (xx - yy) * s(Y3[5]);
    out[15] = x * (xx - s(3.0) * yy) * s(Y3[6]);
    out
}

/// Gradient of `Σ_k weight_k Y_k` with respect to the direction, as if x, y and z were
/// independent: [`Y_k`](basis) as the polynomials that they are written as.
#[inline(always)]
pub(crate) fn gradient<V: Lanes>([x, y, z]: [V; 3], weight: &[V; 16], degree: usize) -> [V; 3] {
    let s = V::splat;
    let w = weight;
    if degree == 0 {
        return [s(0.0); 3];
    }
    let mut out = [w[3] * s(-Y1), w[1] * s(-Y1), w[2] * s(Y1)];
    if degree == 1 {
        return out;
    }
    let two = s(2.0);
    let mut scaled = [s(0.0); 5];
    for k in 0..5 {
        scaled[k] = w[4 + k] * s(Y2[k]);
    }
    let [a, b, c, d, e] = scaled;
    out[0] = out[0] + a * y - two * c * x + d * z + two * e * x;
    out[1] = out[1] + a * x + b * z - two * c * y - two * e * y;
    out[2] = out[2] + b * y + s(4.0) * c * z + d * x;
    if degree == 2 {
        return out;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    let (three, six, eight) = (s(3.0), s(6.0), s(8.0));
    let mut h = [s(0.0); 7];
    for k in 0..7 {
        h[k] = w[9 + k] * s(Y3[k]);
    }
    out[0] = out[0] + h[0] * six * xy + h[1] * yz - h[2] * two * xy - h[3] * six * xz
        + h[4] * (s(4.0) * zz - three * xx - yy)
        + h[5] * two * xz
        + h[6] * (three * xx - three * yy);
    out[1] = out[1]
        + h[0] * (three * xx - three * yy)
        + h[1] * xz
        + h[2] * (s(4.0) * zz - xx - three * yy)
        - h[3] * six * yz
        - h[4] * two * xy
        - h[5] * two * yz
        - h[6] * six * xy;
    out[2] = out[2]
        + h[1] * xy
        + h[2] * eight * yz
        + h[3] * (six * zz - three * (xx + yy))
        + h[4] * eight * xz
        + h[5] * (xx - yy);
    out
}
