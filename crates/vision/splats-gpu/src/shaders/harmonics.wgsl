// Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS files.

const Y0: f32 = 0.2820948;
const Y1: f32 = 0.4886025;
const Y2: array<f32, 5> = array<f32, 5>(1.0925484, -1.0925484, 0.31539157, -1.0925484, 0.5462742);
const Y3: array<f32, 7> = array<f32, 7>(
    -0.5900436, 2.8906114, -0.4570458, 0.37317633, -0.4570458, 1.4453057, -0.5900436,
);

// Values in a unit direction; those above the degree are 0.
fn basis_of(d: vec3<f32>, degree: u32) -> array<f32, 16> {
    var out: array<f32, 16>;
    let x = d.x;
    let y = d.y;
    let z = d.z;
    out[0] = Y0;
    if (degree >= 1u) {
        out[1] = -Y1 * y;
        out[2] = Y1 * z;
        out[3] = -Y1 * x;
    }
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    if (degree >= 2u) {
        out[4] = x * y * Y2[0];
        out[5] = y * z * Y2[1];
        out[6] = (zz + zz - xx - yy) * Y2[2];
        out[7] = x * z * Y2[3];
        out[8] = (xx - yy) * Y2[4];
    }
    if (degree >= 3u) {
        let four = 4.0 * zz - xx - yy;
        out[9] = y * (3.0 * xx - yy) * Y3[0];
        out[10] = x * y * z * Y3[1];
        out[11] = y * four * Y3[2];
        out[12] = z * (zz + zz - 3.0 * (xx + yy)) * Y3[3];
        out[13] = x * four * Y3[4];
        out[14] = z * (xx - yy) * Y3[5];
        out[15] = x * (xx - 3.0 * yy) * Y3[6];
    }
    return out;
}

// Gradient of `Σ_k weight_k Y_k` with respect to the direction, x, y and z independent.
fn basis_gradient(d: vec3<f32>, weights: array<f32, 16>, degree: u32) -> vec3<f32> {
    var w = weights;
    let x = d.x;
    let y = d.y;
    let z = d.z;
    var out = vec3<f32>(0.0);
    if (degree >= 1u) {
        out = vec3<f32>(-Y1 * w[3], -Y1 * w[1], Y1 * w[2]);
    }
    if (degree >= 2u) {
        let a = w[4] * Y2[0];
        let b = w[5] * Y2[1];
        let c = w[6] * Y2[2];
        let e = w[7] * Y2[3];
        let f = w[8] * Y2[4];
        out += vec3<f32>(
            a * y - 2.0 * c * x + e * z + 2.0 * f * x,
            a * x + b * z - 2.0 * c * y - 2.0 * f * y,
            b * y + 4.0 * c * z + e * x,
        );
    }
    if (degree >= 3u) {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        let xy = x * y;
        let yz = y * z;
        let xz = x * z;
        let a = w[9] * Y3[0];
        let b = w[10] * Y3[1];
        let c = w[11] * Y3[2];
        let e = w[12] * Y3[3];
        let f = w[13] * Y3[4];
        let g = w[14] * Y3[5];
        let h = w[15] * Y3[6];
        out += vec3<f32>(
            a * 6.0 * xy + b * yz - c * 2.0 * xy - e * 6.0 * xz
                + f * (4.0 * zz - 3.0 * xx - yy) + g * 2.0 * xz + h * (3.0 * xx - 3.0 * yy),
            a * (3.0 * xx - 3.0 * yy) + b * xz + c * (4.0 * zz - xx - 3.0 * yy)
                - e * 6.0 * yz - f * 2.0 * xy - g * 2.0 * yz - h * 6.0 * xy,
            b * xy + c * 8.0 * yz + e * (6.0 * zz - 3.0 * (xx + yy)) + f * 8.0 * xz
                + g * (xx - yy),
        );
    }
    return out;
}
