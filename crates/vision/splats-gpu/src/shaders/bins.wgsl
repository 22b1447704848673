// Pairs of a Gaussian and a tile: a Gaussian belongs to the tiles whose pixels its ellipse crosses,
// exactly along x in each row of tiles.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> footprints: array<Footprint>;
// Gaussians, nearest first.
@group(0) @binding(2) var<storage, read> order: array<u32>;
// Number of tiles of each, then, after the exclusive sums, its first pair.
@group(0) @binding(3) var<storage, read_write> first_pair: array<u32>;
@group(0) @binding(4) var<storage, read_write> status: array<u32>;
// Tile of each pair and the pair, for the sort; the Gaussian of each pair.
@group(0) @binding(5) var<storage, read_write> keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> values: array<u32>;
@group(0) @binding(7) var<storage, read_write> splat_of_pair: array<u32>;

// Pixels whose centers are in `mean + low ..= mean + high`: first and end.
fn pixels(mean: f32, low: f32, high: f32, size: u32) -> vec2<u32> {
    let lowest = clamp(mean + low - SLACK_PX, 0.0, f32(size));
    let highest = clamp(mean + high + SLACK_PX, -1.0, f32(size - 1u));
    return vec2<u32>(u32(ceil(lowest)), u32(floor(highest + 1.0)));
}

// Columns of pixels that the ellipse reaches within a row of tiles.
fn across(f: Footprint, row: u32) -> vec2<u32> {
    let a = f.conic.x;
    let b = f.conic.y;
    let top = f32(row * TILE) - f.mean.y - SLACK_PX;
    let bottom = top + f32(TILE - 1u) + 2.0 * SLACK_PX;
    // The height at which the ellipse is rightmost; leftmost at the negative of it.
    let rightmost = -b / f.conic.z * f.extent.x;
    var high = f.extent.x;
    if (rightmost < top || rightmost > bottom) {
        let dy = clamp(rightmost, top, bottom);
        high = (width_at(f, dy) - b * dy) / a;
    }
    var low = -f.extent.x;
    if (-rightmost < top || -rightmost > bottom) {
        let dy = clamp(-rightmost, top, bottom);
        low = (-width_at(f, dy) - b * dy) / a;
    }
    let slack = 1e-5 * f.extent.x;
    return pixels(f.mean.x, low - slack, high + slack, view.size.x);
}

fn width_at(f: Footprint, dy: f32) -> f32 {
    return sqrt(max(f.reach * f.conic.x - f.conic.w * dy * dy, 0.0));
}

// Tiles of a Gaussian in a row of tiles: first and end.
fn tiles_of(f: Footprint, row: u32) -> vec2<u32> {
    let columns = across(f, row);
    if (columns.x >= columns.y) {
        return vec2<u32>(0u);
    }
    let start = row * view.size.z;
    return vec2<u32>(start + columns.x / TILE, start + (columns.y + TILE - 1u) / TILE);
}

// Rows of tiles of a Gaussian: first and end.
fn rows_of(f: Footprint) -> vec2<u32> {
    let rows = pixels(f.mean.y, -f.extent.y, f.extent.y, view.size.y);
    if (f.z == 0.0 || rows.x >= rows.y) {
        return vec2<u32>(0u);
    }
    return vec2<u32>(rows.x / TILE, (rows.y + TILE - 1u) / TILE);
}

@compute @workgroup_size(64)
fn count_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    let rank = id.x;
    if (rank > view.counts.x) {
        return;
    }
    var count = 0u;
    if (rank < view.counts.x) {
        let f = footprints[order[rank]];
        let rows = rows_of(f);
        for (var row = rows.x; row < rows.y; row++) {
            let tiles = tiles_of(f, row);
            count += tiles.y - tiles.x;
        }
    }
    first_pair[rank] = count;
}

@compute @workgroup_size(64)
fn list_pairs(@builtin(global_invocation_id) id: vec3<u32>) {
    let rank = id.x;
    if (rank >= view.counts.x) {
        return;
    }
    let splat = order[rank];
    let f = footprints[splat];
    let rows = rows_of(f);
    var pair = first_pair[rank];
    for (var row = rows.x; row < rows.y; row++) {
        let tiles = tiles_of(f, row);
        for (var tile = tiles.x; tile < tiles.y; tile++) {
            if (pair < view.counts.z) {
                keys[pair] = tile;
                values[pair] = pair;
                splat_of_pair[pair] = splat;
            }
            pair++;
        }
    }
    // Pairs that there are, that fit, and the most of all images. One thread writes them.
    if (rank == view.counts.x - 1u) {
        let pairs = first_pair[view.counts.x];
        status[4] = pairs;
        status[0] = min(pairs, view.counts.z);
        status[9] = max(status[9], pairs);
        if (pairs > view.counts.z) {
            status[5] = 1u;
        }
    }
}
