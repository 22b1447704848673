// Gradient of a texel of the sky: the sum over the pixels of the tiles that show it, tile by tile.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> blended: array<f32>;
@group(0) @binding(2) var<storage, read> start: array<f32>;
@group(0) @binding(3) var<storage, read> sky: array<f32>;
@group(0) @binding(4) var<storage, read> rays: array<f32>;
@group(0) @binding(5) var<storage, read> boxes: array<vec4<u32>>;
@group(0) @binding(6) var<storage, read_write> by_texel: array<f32>;

@compute @workgroup_size(64)
fn sum_texels(@builtin(global_invocation_id) id: vec3<u32>) {
    let size = view.counts.w;
    if (id.x >= size * size) {
        return;
    }
    let texel = vec2<u32>(id.x % size, id.x / size);
    var sum = vec3<f32>(0.0);
    for (var tile = 0u; tile < view.size.z * view.size.w; tile++) {
        let b = boxes[tile];
        if (texel.x >= b.x && texel.x <= b.y && texel.y >= b.z && texel.y <= b.w) {
            sum += of_pixels(tile, texel);
        }
    }
    by_texel[3u * id.x] = sum.x;
    by_texel[3u * id.x + 1u] = sum.y;
    by_texel[3u * id.x + 2u] = sum.z;
}

fn of_pixels(tile: u32, texel: vec2<u32>) -> vec3<f32> {
    let first = TILE * vec2<u32>(tile % view.size.z, tile / view.size.z);
    let end = min(first + vec2<u32>(TILE), view.size.xy);
    let pixels = view.size.x * view.size.y;
    var sum = vec3<f32>(0.0);
    for (var y = first.y; y < end.y; y++) {
        for (var x = first.x; x < end.x; x++) {
            let pixel = y * view.size.x + x;
            let direction = ray_of(vec2<u32>(x, y));
            if (blended[pixel] <= view.limits.x || all(direction == vec3<f32>(0.0))) {
                continue;
            }
            let taps = taps_of(direction);
            // 0 or 1 where the texel is one of the four.
            let beside = texel - vec2<u32>(taps.column, taps.row);
            if (any(beside > vec2<u32>(1u))) {
                continue;
            }
            let weights = select(vec2<f32>(1.0) - taps.weight, taps.weight, beside == vec2<u32>(1u));
            let g = vec3<f32>(
                start[pixel], start[pixels + pixel], start[2u * pixels + pixel],
            );
            sum += weights.x * weights.y * blended[pixel] * g;
        }
    }
    return sum;
}
