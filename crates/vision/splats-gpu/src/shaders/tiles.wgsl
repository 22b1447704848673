// The first entry of each tile in the sorted pairs.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> status: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
@group(0) @binding(3) var<storage, read_write> first_entry: array<u32>;

@compute @workgroup_size(64)
fn find_tiles(@builtin(global_invocation_id) id: vec3<u32>) {
    let tile = id.x;
    if (tile > view.size.z * view.size.w) {
        return;
    }
    var low = 0u;
    var high = status[0];
    while (low < high) {
        let middle = (low + high) / 2u;
        if (keys[middle] < tile) {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    first_entry[tile] = low;
}
