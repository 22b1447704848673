// Blending front to back, a thread per pixel, and from blended values to the image.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
@group(0) @binding(2) var<storage, read> splat_of_pair: array<u32>;
// Pairs, tile by tile, nearest first.
@group(0) @binding(3) var<storage, read> entries: array<u32>;
@group(0) @binding(4) var<storage, read> first_entry: array<u32>;
@group(0) @binding(5) var<storage, read> sky: array<f32>;
@group(0) @binding(6) var<storage, read> rays: array<f32>;
// Planes: red, green, blue, expected and median depth (0 where there is none), alpha.
@group(0) @binding(7) var<storage, read_write> image: array<f32>;
// Planes: transmittance, blended red, green, blue, depth.
@group(0) @binding(8) var<storage, read_write> blended: array<f32>;

@compute @workgroup_size(16, 16)
fn blend(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(global_invocation_id) id: vec3<u32>,
) {
    if (any(id.xy >= view.size.xy)) {
        return;
    }
    let at = vec2<f32>(id.xy);
    let tile = group.y * view.size.z + group.x;
    let end = first_entry[tile + 1u];
    var transmittance = 1.0;
    var color = vec3<f32>(0.0);
    var depth = 0.0;
    var median = 0.0;
    for (var entry = first_entry[tile]; entry < end; entry++) {
        let splat = splat_of_pair[entries[entry]];
        let conic = footprints[splat].conic;
        let d = at - footprints[splat].mean;
        let across = fma(0.5 * conic.x, d.x, conic.y * d.y);
        let sigma = fma(across, d.x, 0.5 * conic.z * d.y * d.y);
        let alpha = min(footprints[splat].opacity * exponential(-sigma), view.shape.z);
        if (alpha < view.shape.w) {
            continue;
        }
        let weight = transmittance * alpha;
        let next = transmittance - weight;
        if (next <= view.limits.x) {
            break;
        }
        let slope = footprints[splat].slope;
        let z = fma(slope.x, d.x, footprints[splat].z + slope.y * d.y);
        color += weight * footprints[splat].color;
        depth = fma(weight, z, depth);
        if (transmittance > 0.5 && next <= 0.5) {
            median = z;
        }
        transmittance = next;
    }

    let pixels = view.size.x * view.size.y;
    let pixel = id.y * view.size.x + id.x;
    blended[pixel] = transmittance;
    blended[pixels + pixel] = color.x;
    blended[2u * pixels + pixel] = color.y;
    blended[3u * pixels + pixel] = color.z;
    blended[4u * pixels + pixel] = depth;

    let alpha = 1.0 - transmittance;
    let seen = vec4<f32>(color + background_of(id.xy, transmittance) * transmittance, 1.0);
    for (var c = 0u; c < 3u; c++) {
        image[c * pixels + pixel] = dot(view.exposure[c], seen);
    }
    image[3u * pixels + pixel] = select(0.0, depth / alpha, alpha >= view.limits.y);
    image[4u * pixels + pixel] = median;
    image[5u * pixels + pixel] = alpha;
}
