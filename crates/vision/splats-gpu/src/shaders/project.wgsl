// Projection of a Gaussian into the image, and its key for the sort by depth.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> planes: array<f32>;
@group(0) @binding(2) var<storage, read_write> footprints: array<Footprint>;
@group(0) @binding(3) var<storage, read_write> keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> status: array<atomic<u32>>;

const MAX_DETERMINANT: f32 = 1e30;

fn plane(index: u32, splat: u32) -> f32 {
    return planes[index * view.counts.x + splat];
}

fn plane3(index: u32, splat: u32) -> vec3<f32> {
    return vec3<f32>(plane(index, splat), plane(index + 1u, splat), plane(index + 2u, splat));
}

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) id: vec3<u32>) {
    let index = id.x;
    if (index >= view.counts.x) {
        return;
    }
    keys[index] = 0xffffffffu;
    values[index] = index;
    footprints[index].z = 0.0;

    let offset = plane3(0u, index) - view.center.xyz;
    let p = to_camera() * offset;
    if (p.z < view.limits.z || p.z > view.limits.w) {
        return;
    }
    let linear = linearize(p);
    if (!linear.valid) {
        return;
    }
    let logs = plane3(3u, index);
    let scale = vec3<f32>(exponential(logs.x), exponential(logs.y), exponential(logs.z));
    let rolling = view.kinds.y != 0u;
    if (!rolling && !near_image(linear, scale)) {
        return;
    }
    let quaternion = vec4<f32>(plane3(6u, index), plane(9u, index));
    let axes = axes_of(quaternion);
    let rotation = to_camera();
    // Row times matrix.
    var root = Rows(
        (linear.first * rotation * axes) * scale,
        (linear.second * rotation * axes) * scale,
    );
    var mean = linear.mean;
    if (rolling) {
        let shear = shear_of(p, linear);
        if (shear.denominator <= view.bound.x) {
            return;
        }
        mean += shear.velocity * (shear.stretch * shear.time);
        root = sheared(shear, root);
    }
    let shape = shape_of(root);
    let determinant = shape.determinant;
    if (!(determinant > 0.0 && determinant < MAX_DETERMINANT)) {
        atomicAdd(&status[2], 1u);
        return;
    }
    let opacity = sigmoid(plane(10u, index)) * compensation_of(shape);
    if (opacity < view.shape.w) {
        return;
    }
    let reach = max(2.0 * log(opacity / view.shape.w), 0.0);
    let extent = sqrt(reach * shape.covariance.xz);
    let last = vec2<f32>(view.size.xy - vec2<u32>(1u));
    if (!(all(mean + extent >= vec2<f32>(0.0)) && all(mean - extent <= last))) {
        return;
    }
    let inverse = 1.0 / determinant;
    let covariance = shape.covariance * inverse;
    var out: Footprint;
    out.mean = mean;
    out.extent = extent;
    out.conic = vec4<f32>(covariance.z, -covariance.y, covariance.x, inverse);
    out.color = color_of(offset, index);
    out.opacity = opacity;
    out.z = p.z;
    out.reach = reach;
    let depth_root = (view.rotation[2].xyz * axes) * scale;
    out.slope = slope_of(root, depth_root, shape, p.z).value;
    footprints[index] = out;
    keys[index] = bitcast<u32>(p.z);
    atomicAdd(&status[3], 1u);
}

// Whether the ellipse can reach the image: the largest scale bounds it in every direction.
fn near_image(linear: Linear, scale: vec3<f32>) -> bool {
    let largest = max(scale.x, max(scale.y, scale.z));
    let rows = vec2<f32>(dot(linear.first, linear.first), dot(linear.second, linear.second));
    let variance = rows * (largest * largest) + view.shape.x;
    let extent = sqrt(variance * view.bound.y) + 1.0;
    return all(-extent < linear.mean) && all(linear.mean < vec2<f32>(view.size.xy) + extent);
}

fn color_of(offset: vec3<f32>, index: u32) -> vec3<f32> {
    let degree = view.counts.y;
    let direction = offset * (1.0 / sqrt(dot(offset, offset)));
    var basis = basis_of(direction, degree);
    var color = vec3<f32>(0.5);
    for (var k = 0u; k < (degree + 1u) * (degree + 1u); k++) {
        color += basis[k] * plane3(11u + 3u * k, index);
    }
    return max(color, vec3<f32>(0.0));
}
