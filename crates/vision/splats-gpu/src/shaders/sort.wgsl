// One pass of a stable radix sort by four bits (Knuth, The Art of Computer Programming 3, 5.2.5):
// counts of each digit in each block, and after their exclusive sums the move of each pair. A
// thread takes neighboring keys one after the other, so that no atomic and no order of threads
// matters.

struct Length {
    kind: u32,
    at: u32,
    shift: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> length: Length;
@group(0) @binding(1) var<storage, read> status: array<u32>;
@group(0) @binding(2) var<storage, read> keys: array<u32>;
// Digit by digit, the blocks of each.
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
@group(0) @binding(4) var<storage, read> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> keys_out: array<u32>;
@group(0) @binding(6) var<storage, read_write> values_out: array<u32>;

const THREADS: u32 = 64u;
const EACH: u32 = 16u;
const BLOCK: u32 = 1024u;
const DIGITS: u32 = 16u;

// Digit by digit, the threads of each.
var<workgroup> of_thread: array<u32, 1024>;

fn digit(key: u32) -> u32 {
    return (key >> length.shift) & 15u;
}

fn count_own(first: u32, n: u32, thread: u32) {
    var own: array<u32, 16>;
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            own[digit(keys[first + k])] += 1u;
        }
    }
    for (var d = 0u; d < DIGITS; d++) {
        of_thread[d * THREADS + thread] = own[d];
    }
}

@compute @workgroup_size(64)
fn count_digits(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = status[length.at];
    count_own(group.x * BLOCK + thread * EACH, n, thread);
    workgroupBarrier();
    let blocks = (n + BLOCK - 1u) / BLOCK;
    if (thread < DIGITS && group.x < blocks) {
        var sum = 0u;
        for (var k = 0u; k < THREADS; k++) {
            sum += of_thread[thread * THREADS + k];
        }
        counts[thread * blocks + group.x] = sum;
    }
}

@compute @workgroup_size(64)
fn move_pairs(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) thread: u32,
) {
    let n = status[length.at];
    let first = group.x * BLOCK + thread * EACH;
    count_own(first, n, thread);
    workgroupBarrier();
    let blocks = (n + BLOCK - 1u) / BLOCK;
    if (thread < DIGITS && group.x < blocks) {
        var next = counts[thread * blocks + group.x];
        for (var k = 0u; k < THREADS; k++) {
            let value = of_thread[thread * THREADS + k];
            of_thread[thread * THREADS + k] = next;
            next += value;
        }
    }
    workgroupBarrier();
    for (var k = 0u; k < EACH; k++) {
        if (first + k < n) {
            let key = keys[first + k];
            let at = digit(key) * THREADS + thread;
            let to = of_thread[at];
            of_thread[at] = to + 1u;
            keys_out[to] = key;
            values_out[to] = values[first + k];
        }
    }
}
