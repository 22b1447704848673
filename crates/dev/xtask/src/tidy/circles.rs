//! Files that use each other in a circle: strongly connected components of more than one file.

use super::modules::Edges;

/// The circles among `files` files, the largest first, each with its files in order.
pub(crate) fn circles(files: usize, edges: &Edges) -> Vec<Vec<usize>> {
    let mut uses = vec![Vec::new(); files];
    for (from, to) in edges.keys() {
        uses[*from].push(*to);
    }
    let mut search = Search {
        uses,
        order: vec![None; files],
        low: vec![0; files],
        stack: Vec::new(),
        on_stack: vec![false; files],
        next: 0,
        circles: Vec::new(),
    };
    for file in 0..files {
        if search.order[file].is_none() {
            search.visit(file);
        }
    }
    let mut circles = search.circles;
    circles.sort_by_key(|circle| (std::cmp::Reverse(circle.len()), circle[0]));
    circles
}

/// Tarjan's algorithm (1972). It recurses as deep as a chain of files is long.
struct Search {
    uses: Vec<Vec<usize>>,
    order: Vec<Option<usize>>,
    low: Vec<usize>,
    stack: Vec<usize>,
    on_stack: Vec<bool>,
    next: usize,
    circles: Vec<Vec<usize>>,
}

impl Search {
    fn visit(&mut self, file: usize) {
        let order = self.next;
        self.next += 1;
        self.order[file] = Some(order);
        self.low[file] = order;
        self.stack.push(file);
        self.on_stack[file] = true;
        for at in 0..self.uses[file].len() {
            let to = self.uses[file][at];
            match self.order[to] {
                None => {
                    self.visit(to);
                    self.low[file] = self.low[file].min(self.low[to]);
                }
                Some(seen) if self.on_stack[to] => self.low[file] = self.low[file].min(seen),
                Some(_) => {}
            }
        }
        if self.low[file] != order {
            return;
        }
        let mut circle = Vec::new();
        while let Some(member) = self.stack.pop() {
            self.on_stack[member] = false;
            circle.push(member);
            if member == file {
                break;
            }
        }
        if circle.len() > 1 {
            circle.sort_unstable();
            self.circles.push(circle);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(files: usize, edges: &[(usize, usize)]) -> Vec<Vec<usize>> {
        let edges = edges.iter().map(|edge| (*edge, 1)).collect();
        circles(files, &edges)
    }

    #[test]
    fn a_chain_has_no_circle() {
        assert_eq!(
            of(4, &[(0, 1), (1, 2), (0, 2), (3, 2)]),
            Vec::<Vec<usize>>::new()
        );
    }

    #[test]
    fn circles_are_whole_and_the_largest_is_first() {
        assert_eq!(
            of(
                7,
                &[
                    (0, 1),
                    (1, 0),
                    (1, 2),
                    (2, 3),
                    (3, 4),
                    (4, 2),
                    (5, 4),
                    (4, 6)
                ]
            ),
            [vec![2, 3, 4], vec![0, 1]]
        );
    }

    #[test]
    fn circles_that_share_a_file_are_one() {
        assert_eq!(of(3, &[(0, 1), (1, 0), (1, 2), (2, 1)]), [vec![0, 1, 2]]);
    }
}
