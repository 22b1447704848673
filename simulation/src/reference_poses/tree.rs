//! k-d tree over points of six coordinates: position and direction, each with its weight.

const DIMENSIONS: usize = 6;
/// Points of a leaf.
const LEAF: usize = 8;
/// Depth of the tree at most: halves of 2^32 points.
const MAX_DEPTH: usize = 32;

/// Points with a balanced tree: each node halves its points at the median of the coordinate in
/// which they extend furthest.
#[derive(Clone, Debug)]
pub(super) struct Tree {
    /// Points in the order of the leaves.
    points: Vec<[f64; DIMENSIONS]>,
    /// Their indices as given.
    indices: Vec<u32>,
    /// Nodes in preorder. The second child of a node is stored by its index.
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
enum Node {
    Leaf { first: u32, end: u32 },
    Split { axis: u8, value: f64, second: u32 },
}

impl Tree {
    /// A tree that is divided for queries of these weights; queries may have others.
    pub(super) fn new(points: Vec<[f64; DIMENSIONS]>, weights: [f64; 2]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut nodes = Vec::new();
        split(&points, weights, &mut order, 0, &mut nodes);
        Self {
            points: order.iter().map(|&index| points[index as usize]).collect(),
            indices: order,
            nodes,
        }
    }

    /// Index of the nearest point, of equal ones the least.
    pub(super) fn nearest(&self, at: &[f64; DIMENSIONS], weights: [f64; 2]) -> usize {
        let squares = weights.map(|weight| weight * weight);
        let mut best = (f64::INFINITY, u32::MAX);
        // Nodes to be visited, with the squared distance of their half-space.
        let mut stack = [(0_u32, 0.0_f64); MAX_DEPTH + 1];
        let mut count = 1;
        while count > 0 {
            count -= 1;
            let (mut node, bound) = stack[count];
            if bound > best.0 {
                continue;
            }
            loop {
                match self.nodes[node as usize] {
                    Node::Leaf { first, end } => {
                        for position in first as usize..end as usize {
                            let distance = squared_distance(&self.points[position], at, squares);
                            let candidate = (distance, self.indices[position]);
                            if candidate < best {
                                best = candidate;
                            }
                        }
                        break;
                    }
                    Node::Split {
                        axis,
                        value,
                        second,
                    } => {
                        let difference = at[axis as usize] - value;
                        let (near, far) = match difference < 0.0 {
                            true => (node + 1, second),
                            false => (second, node + 1),
                        };
                        let square = squares[axis as usize / 3] * (difference * difference);
                        stack[count] = (far, square);
                        count += 1;
                        node = near;
                    }
                }
            }
        }
        best.1 as usize
    }
}

fn squared_distance(a: &[f64; DIMENSIONS], b: &[f64; DIMENSIONS], squares: [f64; 2]) -> f64 {
    let d: [f64; DIMENSIONS] = std::array::from_fn(|k| a[k] - b[k]);
    squares[0] * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        + squares[1] * (d[3] * d[3] + d[4] * d[4] + d[5] * d[5])
}

/// Adds the nodes of the points `order`, which begin at position `first` of all.
fn split(
    points: &[[f64; DIMENSIONS]],
    weights: [f64; 2],
    order: &mut [u32],
    first: u32,
    nodes: &mut Vec<Node>,
) {
    if order.len() <= LEAF {
        let end = first + order.len() as u32;
        nodes.push(Node::Leaf { first, end });
        return;
    }
    let extent = |axis: usize| {
        let values = order.iter().map(|&index| points[index as usize][axis]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(v), high.max(v))
        });
        weights[axis / 3] * (high - low)
    };
    let axis = (1..DIMENSIONS).fold(0, |best, axis| match extent(axis) > extent(best) {
        true => axis,
        false => best,
    });
    let key = |index: u32| points[index as usize][axis];
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| key(a).total_cmp(&key(b)).then(a.cmp(&b)));
    let value = key(order[middle]);
    let node = nodes.len();
    nodes.push(Node::Split {
        axis: axis as u8,
        value,
        second: 0,
    });
    let (low, high) = order.split_at_mut(middle);
    split(points, weights, low, first, nodes);
    let second = nodes.len() as u32;
    if let Node::Split { second: child, .. } = &mut nodes[node] {
        *child = second;
    }
    split(points, weights, high, first + middle as u32, nodes);
}
