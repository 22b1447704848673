// What is behind all Gaussians: one color, or an octahedral map of colors by direction.

// The direction of a pixel in the world, of any length; 0 where the lens has none.
fn ray_of(pixel: vec2<u32>) -> vec3<f32> {
    var ray = vec3<f32>((vec2<f32>(pixel) - view.focal.zw) / view.focal.xy, 1.0);
    if (view.kinds.x != 0u) {
        let at = 3u * (pixel.y * view.size.x + pixel.x);
        ray = vec3<f32>(rays[at], rays[at + 1u], rays[at + 2u]);
    }
    // Times the transpose of the rotation.
    return ray * to_camera();
}

struct Taps {
    // The first of four texels.
    column: u32,
    row: u32,
    // Weights of the second column and row.
    weight: vec2<f32>,
}

fn taps_of(d: vec3<f32>) -> Taps {
    let size = view.counts.w;
    let norm = max(abs(d.x) + abs(d.y) + abs(d.z), 1.17549435e-38);
    var at = d.xy / norm;
    if (d.z < 0.0) {
        let signs = select(vec2<f32>(1.0), vec2<f32>(-1.0), at < vec2<f32>(0.0));
        at = (vec2<f32>(1.0) - abs(at.yx)) * signs;
    }
    let last = f32(size - 1u);
    let texel = clamp((at * 0.5 + 0.5) * last, vec2<f32>(0.0), vec2<f32>(last));
    let low = min(vec2<u32>(texel), vec2<u32>(size - 2u));
    return Taps(low.x, low.y, texel - vec2<f32>(low));
}

fn texel_of(column: u32, row: u32) -> vec3<f32> {
    let at = 3u * (row * view.counts.w + column);
    return vec3<f32>(sky[at], sky[at + 1u], sky[at + 2u]);
}

// The color behind a pixel. A sky behind a complete pixel is not evaluated, but black.
fn background_of(pixel: vec2<u32>, transmittance: f32) -> vec3<f32> {
    if (view.counts.w == 0u) {
        return vec3<f32>(sky[0], sky[1], sky[2]);
    }
    let direction = ray_of(pixel);
    if (transmittance <= view.limits.x || all(direction == vec3<f32>(0.0))) {
        return vec3<f32>(0.0);
    }
    let t = taps_of(direction);
    let a = t.weight.x;
    let b = t.weight.y;
    return (1.0 - a) * (1.0 - b) * texel_of(t.column, t.row)
        + a * (1.0 - b) * texel_of(t.column + 1u, t.row)
        + (1.0 - a) * b * texel_of(t.column, t.row + 1u)
        + a * b * texel_of(t.column + 1u, t.row + 1u);
}
