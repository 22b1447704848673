// Slope of a Gaussian's depth over the image, and its gradient, as the processor has them: that of
// the conditional mean of the depth given the pixel.

struct Slope {
    // m/px
    value: vec2<f32>,
    // Without the bound.
    free: vec2<f32>,
    // The covariance in the image times that.
    spread: vec2<f32>,
    // Variance of depth over the Gaussian's pixels without the bound, m².
    variance: f32,
    bounded: bool,
    factor: f32,
    // Inverse covariance with the slope's own dilation: xx, xy, yy.
    inverse: vec3<f32>,
}

struct BySlope {
    root: Rows,
    depth_root: vec3<f32>,
    z: f32,
}

// A symmetric matrix, xx, xy, yy, times a vector.
fn symmetric(matrix: vec3<f32>, v: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(matrix.x * v.x + matrix.y * v.y, matrix.y * v.x + matrix.z * v.y);
}

// `shape` is that of the root with the dilation of the image.
fn slope_of(root: Rows, depth_root: vec3<f32>, shape: Shape, z: f32) -> Slope {
    var out: Slope;
    let damped = dilated(root, view.bound.z);
    let over = 1.0 / damped.determinant;
    let covariance = damped.covariance;
    out.inverse = vec3<f32>(covariance.z, -covariance.y, covariance.x) * over;
    let with_depth = vec2<f32>(dot(root.first, depth_root), dot(root.second, depth_root));
    out.free = symmetric(out.inverse, with_depth);
    out.spread = symmetric(shape.covariance, out.free);
    out.variance = dot(out.free, out.spread);
    let deviation = sqrt(max(out.variance, 0.0));
    let limit = (z - view.limits.z) * view.bound.w;
    out.bounded = limit < deviation;
    out.factor = 1.0;
    if (out.bounded) {
        out.factor = limit / deviation;
    }
    out.value = out.free * out.factor;
    return out;
}

// From the gradient with respect to the slope.
fn slope_gradient(
    slope: Slope, by: vec2<f32>, root: Rows, depth_root: vec3<f32>, z: f32,
) -> BySlope {
    var out: BySlope;
    var by_free = slope.factor * by;
    var along = 0.0;
    if (slope.bounded) {
        let through_bound = slope.factor * dot(by, slope.free);
        along = through_bound / slope.variance;
        by_free -= along * slope.spread;
        out.z = through_bound / (z - view.limits.z);
    }
    let g = slope.free;
    let by_covariance = symmetric(slope.inverse, by_free);
    let across = by_covariance.x * root.first + by_covariance.y * root.second;
    let on_plane = g.x * root.first + g.y * root.second;
    let beside = depth_root - on_plane;
    let turned = along * on_plane + across;
    out.root = Rows(
        by_covariance.x * beside - g.x * turned,
        by_covariance.y * beside - g.y * turned,
    );
    out.depth_root = across;
    return out;
}
