// Exclusive sums of a buffer in place: sums of blocks, sums of these, sums within blocks.

struct Length {
    // 0: the number of Gaussians and one; 1: the digits' counts of a sort.
    kind: u32,
    // Where `status` has the number of keys of that sort.
    at: u32,
    shift: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> length: Length;
@group(0) @binding(1) var<storage, read> status: array<u32>;
@group(0) @binding(2) var<storage, read_write> data: array<u32>;
@group(0) @binding(3) var<storage, read_write> sums: array<u32>;

const THREADS: u32 = 64u;
const EACH: u32 = 16u;
const BLOCK: u32 = 1024u;

var<workgroup> of_thread: array<u32, 64>;

fn count() -> u32 {
    let n = status[length.at];
    return select(n + 1u, 16u * ((n + BLOCK - 1u) / BLOCK), length.kind == 1u);
}

// The sum of all threads before this one.
fn before(thread: u32) -> u32 {
    var sum = 0u;
    for (var k = 0u; k < thread; k++) {
        sum += of_thread[k];
    }
    return sum;
}

@compute @workgroup_size(64)
fn block_sums(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = count();
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        let i = group.x * BLOCK + thread * EACH + k;
        if (i < n) {
            sum += data[i];
        }
    }
    of_thread[thread] = sum;
    workgroupBarrier();
    if (thread == 0u && group.x * BLOCK < n) {
        sums[group.x] = before(THREADS);
    }
}

@compute @workgroup_size(64)
fn sum_of_blocks(@builtin(local_invocation_index) thread: u32) {
    let blocks = (count() + BLOCK - 1u) / BLOCK;
    let each = (blocks + THREADS - 1u) / THREADS;
    var sum = 0u;
    for (var k = 0u; k < each; k++) {
        let i = thread * each + k;
        if (i < blocks) {
            sum += sums[i];
        }
    }
    of_thread[thread] = sum;
    workgroupBarrier();
    var next = before(thread);
    for (var k = 0u; k < each; k++) {
        let i = thread * each + k;
        if (i < blocks) {
            let value = sums[i];
            sums[i] = next;
            next += value;
        }
    }
}

@compute @workgroup_size(64)
fn within_blocks(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = count();
    let first = group.x * BLOCK + thread * EACH;
    var sum = 0u;
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            sum += data[first + k];
        }
    }
    of_thread[thread] = sum;
    workgroupBarrier();
    if (first >= n) {
        return;
    }
    var next = sums[group.x] + before(thread);
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            let value = data[first + k];
            data[first + k] = next;
            next += value;
        }
    }
}
