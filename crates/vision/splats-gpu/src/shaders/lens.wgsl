// Lenses at a point: pixel and its Jacobian. Models and domains as `camera_models::Lens` has them.

struct Linear {
    mean: vec2<f32>,
    // Rows of the Jacobian, px/m.
    first: vec3<f32>,
    second: vec3<f32>,
    valid: bool,
}

// The distorted point at a focal length of 1, with its Jacobian.
fn radial_lens(p: vec3<f32>) -> Linear {
    var out: Linear;
    let inverse = 1.0 / p.z;
    let a = p.x * inverse;
    let b = p.y * inverse;
    let s = a * a + b * b;
    out.valid = p.z > 0.0 && s <= view.lens[2].z;
    let o = view.lens[0].xyz;
    let u = view.lens[1].xyz;
    let tangential = view.lens[2].xy;
    let over = 1.0 + s * (o.x + s * (o.y + s * o.z));
    let under = 1.0 + s * (u.x + s * (u.y + s * u.z));
    let over_slope = o.x + s * (2.0 * o.y + s * 3.0 * o.z);
    let under_slope = u.x + s * (2.0 * u.y + s * 3.0 * u.z);
    let factor = over / under;
    let slope = 2.0 * (over_slope * under - over * under_slope) / (under * under);
    let p1 = tangential.x;
    let p2 = tangential.y;
    out.mean = vec2<f32>(
        a * factor + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a),
        b * factor + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b,
    );
    let mixed = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b;
    let xx = factor + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a;
    let yy = factor + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a;
    out.first = vec3<f32>(xx, mixed, -(xx * a + mixed * b)) * inverse;
    out.second = vec3<f32>(mixed, yy, -(mixed * a + yy * b)) * inverse;
    return out;
}

fn fisheye_lens(p: vec3<f32>) -> Linear {
    var out: Linear;
    let r = sqrt(p.x * p.x + p.y * p.y);
    let k = view.lens[0];
    if (r < 1e-6 * p.z) {
        let inverse = 1.0 / p.z;
        out.valid = true;
        out.mean = p.xy * inverse;
        out.first = vec3<f32>(1.0, 0.0, -p.x * inverse) * inverse;
        out.second = vec3<f32>(0.0, 1.0, -p.y * inverse) * inverse;
        return out;
    }
    let angle = angle_of(r, p.z);
    out.valid = angle <= view.lens[2].z && r > 0.0;
    let s = angle * angle;
    let distorted = angle * (1.0 + s * (k.x + s * (k.y + s * (k.z + s * k.w))));
    let slope = 1.0 + s * (3.0 * k.x + s * (5.0 * k.y + s * (7.0 * k.z + s * 9.0 * k.w)));
    let scale = distorted / r;
    let cosine = p.x / r;
    let sine = p.y / r;
    let square = r * r + p.z * p.z;
    let along = slope * p.z / square;
    let by_depth = -slope * r / square;
    let mixed = (along - scale) * cosine * sine;
    out.mean = p.xy * scale;
    out.first = vec3<f32>(
        along * cosine * cosine + scale * sine * sine, mixed, by_depth * cosine,
    );
    out.second = vec3<f32>(
        mixed, along * sine * sine + scale * cosine * cosine, by_depth * sine,
    );
    return out;
}

// `atan2(r, z)` for r >= 0 to some 1e-7: the built-in one may err by 4096 units in the last place.
// The argument is reduced to at most tan(π/8) (Cephes, Moshier 1989).
fn angle_of(r: f32, z: f32) -> f32 {
    let depth = abs(z);
    let low = min(r, depth);
    let high = max(r, depth);
    let turned = low > 0.41421356 * high;
    let t = select(low / high, (low - high) / (low + high), turned);
    let s = t * t;
    var p = fma(8.05374449538e-2, s, -1.38776856032e-1);
    p = fma(p, s, 1.99777106478e-1);
    p = fma(p, s, -3.33329491539e-1);
    var angle = fma(p * s, t, t) + select(0.0, 0.78539816339, turned);
    angle = select(angle, 1.57079632679 - angle, r > depth);
    return select(angle, 3.14159265359 - angle, z < 0.0);
}

// `(x, y) / n` with the derivatives of n.
fn quotient(p: vec3<f32>, n: f32, by: vec3<f32>) -> Linear {
    var out: Linear;
    out.mean = p.xy / n;
    let slope = by / n;
    out.first = vec3<f32>(1.0 / n, 0.0, 0.0) - out.mean.x * slope;
    out.second = vec3<f32>(0.0, 1.0 / n, 0.0) - out.mean.y * slope;
    return out;
}

fn double_sphere_lens(p: vec3<f32>) -> Linear {
    let xi = view.lens[0].x;
    let alpha = view.lens[0].y;
    let side = dot(p.xy, p.xy);
    let d1 = sqrt(side + p.z * p.z);
    let depth = xi * d1 + p.z;
    let d2 = sqrt(side + depth * depth);
    let n = alpha * d2 + (1.0 - alpha) * depth;
    let depth_by = vec3<f32>(xi * p.x / d1, xi * p.y / d1, xi * p.z / d1 + 1.0);
    let along = alpha * depth / d2 + 1.0 - alpha;
    let by = vec3<f32>(alpha * p.xy / d2, 0.0) + along * depth_by;
    var out = quotient(p, n, by);
    out.valid = d1 > 0.0 && p.z > -view.lens[2].z * d1 && n > 0.0;
    return out;
}

fn eucm_lens(p: vec3<f32>) -> Linear {
    let alpha = view.lens[0].x;
    let beta = view.lens[0].y;
    let d = sqrt(beta * dot(p.xy, p.xy) + p.z * p.z);
    let n = alpha * d + (1.0 - alpha) * p.z;
    let by = vec3<f32>(alpha * beta / d * p.xy, alpha * p.z / d + 1.0 - alpha);
    var out = quotient(p, n, by);
    out.valid = d > 0.0 && p.z > -view.lens[2].z * d && n > 0.0;
    return out;
}

fn distorted_lens(p: vec3<f32>) -> Linear {
    var out: Linear;
    switch view.kinds.x {
        case 1u: { out = radial_lens(p); }
        case 2u: { out = fisheye_lens(p); }
        case 3u: { out = double_sphere_lens(p); }
        default: { out = eucm_lens(p); }
    }
    out.mean = out.mean * view.focal.xy + view.focal.zw;
    out.first *= view.focal.x;
    out.second *= view.focal.y;
    return out;
}

// A pinhole camera is linearized at the bound of its slopes where the point is beyond it; a lens
// with distortion is not valid there.
fn linearize(p: vec3<f32>) -> Linear {
    var out: Linear;
    if (view.kinds.x != 0u) {
        out = distorted_lens(p);
        let inside = all(out.mean >= view.bounds.xy) && all(out.mean <= view.bounds.zw);
        out.valid = out.valid && inside;
        return out;
    }
    let inverse = 1.0 / p.z;
    let slope = p.xy * inverse;
    let bounded = min(max(slope, view.slopes.xy), view.slopes.zw);
    let scale = view.focal.xy * inverse;
    out.mean = fma(view.focal.xy, slope, view.focal.zw);
    out.first = vec3<f32>(scale.x, 0.0, -scale.x * bounded.x);
    out.second = vec3<f32>(0.0, scale.y, -scale.y * bounded.y);
    out.valid = true;
    return out;
}
