//! Chessboards: plain ones by their size, ChArUco boards by their markers.

use boards::{Dictionary, Target};

use super::blur::Border;
use super::config::{Config, LatticeConfig, MarkerConfig};
use super::lattice::{self, Lattice};
use super::refine::{self, Window};
use super::saddle;
use super::scene::{BoardCandidate, CornerCandidate, Scene};
use fiducials::decode::{self, Book, Layout};
use fiducials::square::{Square, distance};
use imaging::ImageView;

/// Placement of the board's axes in a lattice: `lattice = origin + rotated by quarter turns
/// (board)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Placement {
    /// Lattice coordinates of the board's corner (0, 0).
    origin: [i32; 2],
    /// Quarter turns clockwise.
    turns: usize,
}

impl Placement {
    fn lattice_at(&self, [x, y]: [i32; 2]) -> [i32; 2] {
        let [u, v] = rotated([x, y], self.turns);
        [self.origin[0] + u, self.origin[1] + v]
    }

    fn board_at(&self, [x, y]: [i32; 2]) -> [i32; 2] {
        rotated([x - self.origin[0], y - self.origin[1]], 4 - self.turns)
    }
}

/// Rotation by quarter turns clockwise, x to y.
fn rotated([x, y]: [i32; 2], turns: usize) -> [i32; 2] {
    match turns % 4 {
        0 => [x, y],
        1 => [-y, x],
        2 => [-x, -y],
        _ => [y, -x],
    }
}

/// Finds a whole chessboard.
pub(super) fn find(scene: &Scene, target: &Target, columns: i32, rows: i32) -> BoardCandidate {
    let needed = (columns * rows) as usize;
    let config = &scene.config.lattice;
    let least = (config.min_found_ratio * needed as f64) as usize;
    let mut found: Option<BoardCandidate> = None;
    let mut remark = None;
    for mut lattice in lattice::grow(&scene.saddles, &scene.links, least, config) {
        let mut places: Vec<[f64; 2]> = scene.saddles.iter().map(|s| s.at).collect();
        cut_fringe(&mut lattice, config);
        if lattice.nodes.len() < least {
            continue;
        }
        let (low, high) = lattice.extent();
        let size = [0, 1].map(|k| high[k] - low[k] + 1);
        if size != [columns, rows] && size != [rows, columns] {
            remark = Some("a chessboard of another size, or a part of one");
            continue;
        }
        fill(scene, &mut lattice, &mut places);
        if lattice.nodes.len() != needed {
            remark = Some("a chessboard with corners missing");
            continue;
        }
        if found.is_some() {
            return BoardCandidate {
                remark: Some("two chessboards of this size"),
                ..BoardCandidate::default()
            };
        }
        found = Some(place_chessboard(
            target,
            &lattice,
            &places,
            columns,
            rows,
            &scene.config,
        ));
    }
    found.unwrap_or(BoardCandidate {
        remark,
        ..BoardCandidate::default()
    })
}

/// Removes rows and columns at the edge with only a few crossings, caused by a shadow or an object
/// beside the board.
fn cut_fringe(lattice: &mut Lattice, config: &LatticeConfig) {
    for _ in 0..config.max_fringe_lines {
        if lattice.nodes.is_empty() {
            return;
        }
        let (low, high) = lattice.extent();
        // The least and the largest column, then row.
        let edges = [(1, low[0]), (1, high[0]), (0, low[1]), (0, high[1])];
        let on = |at: &(i32, i32), (axis, value): (usize, i32)| [at.0, at.1][axis] == value;
        let few = |edge: &(usize, i32)| {
            let corners = lattice.nodes.keys().filter(|at| on(at, *edge)).count();
            corners <= config.max_fringe_corners
        };
        let Some(edge) = edges.iter().copied().find(few) else {
            return;
        };
        lattice.nodes.retain(|at, _| !on(at, edge));
    }
}

/// Searches for missing inner corners again with lower thresholds.
fn fill(scene: &Scene, lattice: &mut Lattice, places: &mut Vec<[f64; 2]>) {
    let (low, high) = lattice.extent();
    let config = &scene.config.lattice;
    for _ in 0..config.max_searches {
        let mut more = Vec::new();
        for y in low[1]..=high[1] {
            for x in low[0]..=high[0] {
                if lattice.nodes.contains_key(&(y, x)) {
                    continue;
                }
                let Some((guess, step)) = lattice.guess(|n| places[n], (y, x)) else {
                    continue;
                };
                let [least, most] = config.search_shift_px;
                let near = (config.search_shift_ratio * step).clamp(least, most);
                let [least, most] = config.search_window_px;
                let reach = (config.search_window_ratio * step).clamp(least, most);
                let window = Window::round(reach, &scene.config.refinement);
                let Some(at) = refine::refine_corner(&scene.smooth, guess, &window, near) else {
                    continue;
                };
                let radius = config.search_radius_ratio * step as f32;
                let radius = config.max_search_radius_px.min(radius);
                let saddles = &scene.config.saddles;
                if saddle::fit_rays(&scene.smooth, at, radius, saddles).is_some() {
                    more.push(((y, x), at));
                }
            }
        }
        if more.is_empty() {
            return;
        }
        for (key, at) in more {
            lattice.nodes.insert(key, places.len());
            places.push(at);
        }
    }
}

fn place_chessboard(
    target: &Target,
    lattice: &Lattice,
    places: &[[f64; 2]],
    columns: i32,
    rows: i32,
    config: &Config,
) -> BoardCandidate {
    let (low, high) = lattice.extent();
    // Possible positions of the board's corner (0, 0): one for each quarter turn.
    let origins = [low, [high[0], low[1]], high, [low[0], high[1]]];
    let fits = |turns: usize| {
        let size = [high[0] - low[0] + 1, high[1] - low[1] + 1];
        if turns.is_multiple_of(2) {
            size == [columns, rows]
        } else {
            size == [rows, columns]
        }
    };
    // The square beyond corner (0, 0) towards the board's top left is black, so the one diagonally
    // opposite is black too.
    let is_black = |turns: usize| {
        // Sector of the lattice's directions between board x and board y.
        let known = lattice.nodes.iter().find_map(|((y, x), _)| {
            let dark = lattice.is_dark((*y, *x))?;
            // The colour alternates with every step and with every quarter turn.
            let steps = (x - origins[turns][0]) + (y - origins[turns][1]) + turns as i32;
            Some(dark == (steps.rem_euclid(2) == 0))
        });
        known.unwrap_or(false)
    };
    let all: Vec<usize> = (0..4).filter(|t| fits(*t)).collect();
    let right: Vec<usize> = all.iter().copied().filter(|t| is_black(*t)).collect();
    let candidates = if right.is_empty() { all } else { right };
    // Of symmetric placements, the one whose diagonal points most to the right and down.
    let at = |p: &Placement, x: i32, y: i32| {
        let [u, v] = p.lattice_at([x, y]);
        places[lattice.nodes[&(v, u)]]
    };
    let placement = candidates
        .iter()
        .map(|&turns| Placement {
            origin: origins[turns],
            turns,
        })
        .max_by(|a, b| {
            let down_right = |p: &Placement| {
                let (from, to) = (at(p, 0, 0), at(p, columns - 1, rows - 1));
                to[0] - from[0] + to[1] - from[1]
            };
            down_right(a).total_cmp(&down_right(b))
        })
        .expect("the lattice has the board's size one way or the other");
    let mut found = collect(lattice, places, &placement, [columns, rows], 0.5, config);
    found.half_turn = target.is_rotationally_symmetric();
    found
}

/// Corners and borders of a placed lattice. `room` is the fraction of a step without other print.
fn collect(
    lattice: &Lattice,
    places: &[[f64; 2]],
    placement: &Placement,
    size: [i32; 2],
    room: f64,
    config: &Config,
) -> BoardCandidate {
    let mut found = BoardCandidate::default();
    for ((y, x), node) in &lattice.nodes {
        let [column, row] = placement.board_at([*x, *y]);
        if column < 0 || row < 0 || column >= size[0] || row >= size[1] {
            continue;
        }
        let at = places[*node];
        // The shorter of the two steps along each axis.
        let mut sides: [Option<[f64; 2]>; 2] = [None; 2];
        for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
            let Some(other) = lattice.nodes.get(&(y + dy, x + dx)) else {
                continue;
            };
            let step = [0, 1].map(|k| room * (places[*other][k] - at[k]));
            let side = &mut sides[usize::from(dx == 0)];
            if side.is_none_or(|s| distance(step, [0.0; 2]) < distance(s, [0.0; 2])) {
                *side = Some(step);
            }
            if dx + dy > 0 {
                let ends = [at, places[*other]];
                let clear = room.min(config.blur.max_reach_ratio) * distance(at, places[*other]);
                found.borders.push(Border { ends, clear });
            }
        }
        // A crossing with neighbours along one axis only has the same distance to the others.
        let rotated = |s: [f64; 2]| [-s[1], s[0]];
        let sides = match sides {
            [Some(a), Some(b)] => [a, b],
            [Some(a), None] | [None, Some(a)] => [a, rotated(a)],
            [None, None] => continue,
        };
        found.corners.push(CornerCandidate {
            id: (row * size[0] + column) as u32,
            at,
            sides,
            gap: sides
                .map(|s| distance(s, [0.0; 2]) / room)
                .into_iter()
                .fold(f64::INFINITY, f64::min),
        });
    }
    found.corners.sort_by_key(|c| c.id);
    found
}

/// Finds a ChArUco board, of which any part may be visible.
pub(super) fn find_with_markers(
    image: &ImageView<'_>,
    scene: &Scene,
    target: &Target,
    config: &Config,
) -> BoardCandidate {
    let &Target::Charuco {
        columns,
        rows,
        square_m,
        marker_m,
        dictionary,
        ..
    } = target
    else {
        return BoardCandidate::default();
    };
    let board = Board {
        columns: columns as i32,
        rows: rows as i32,
        book: Book::of(dictionary),
        layout: layout(dictionary, marker_m / square_m),
        max_errors: config.max_bit_errors.min((dictionary.distance() - 1) / 2),
        own_id: own_ids(target),
    };
    let mut found = BoardCandidate::default();
    let mut twice = Vec::new();
    for mut lattice in lattice::grow(&scene.saddles, &scene.links, 4, &config.lattice) {
        let mut places: Vec<[f64; 2]> = scene.saddles.iter().map(|s| s.at).collect();
        fill(scene, &mut lattice, &mut places);
        let Some(placement) = board.vote(image, &lattice, &places, &config.markers) else {
            continue;
        };
        let margin = 0.5 * (1.0 - marker_m / square_m);
        let part = collect(
            &lattice,
            &places,
            &placement,
            [board.columns - 1, board.rows - 1],
            (config.markers.clear_margin_ratio * margin).min(0.5),
            config,
        );
        for corner in part.corners {
            match found
                .corners
                .iter()
                .any(|c: &CornerCandidate| c.id == corner.id)
            {
                true => twice.push(corner.id),
                false => found.corners.push(corner),
            }
        }
        found.borders.extend(part.borders);
    }
    if !twice.is_empty() {
        found.corners.retain(|c| !twice.contains(&c.id));
        found.remark = Some("some ids occur twice in the image");
    }
    found
}

fn layout(dictionary: Dictionary, marker: f64) -> Layout {
    let margin = 0.5 * (1.0 - marker);
    Layout {
        from: margin,
        to: 1.0 - margin,
        bits: dictionary.bits(),
        border: 1,
        white: margin,
    }
}

/// The marker of each white square of the board by (x, y); squares in rows.
fn own_ids(target: &Target) -> Vec<((i32, i32), u32)> {
    let &Target::Charuco {
        columns,
        rows,
        first_id,
        ..
    } = target
    else {
        return Vec::new();
    };
    (0..rows as i32)
        .flat_map(|y| (0..columns as i32).map(move |x| (x, y)))
        .filter(|(x, y)| (x + y) % 2 == 1)
        .zip(first_id..)
        .collect()
}

struct Board {
    columns: i32,
    rows: i32,
    book: Book,
    layout: Layout,
    max_errors: u32,
    own_id: Vec<((i32, i32), u32)>,
}

impl Board {
    /// The placement that the markers agree on: enough of them, and several for each contradicting
    /// one. Few squares that should have a marker may have another one.
    fn vote(
        &self,
        image: &ImageView<'_>,
        lattice: &Lattice,
        places: &[[f64; 2]],
        config: &MarkerConfig,
    ) -> Option<Placement> {
        let mut readings: Vec<([i32; 2], u64)> = Vec::new();
        let mut votes: Vec<(Placement, u32, u32)> = Vec::new();
        for (y, x) in lattice.nodes.keys() {
            let corner =
                |dx: i32, dy: i32| lattice.nodes.get(&(y + dy, x + dx)).map(|n| places[*n]);
            let (Some(a), Some(b), Some(c), Some(d)) =
                (corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1))
            else {
                continue;
            };
            if lattice_is_dark(lattice, (*y, *x)) != Some(false) {
                continue;
            }
            let Some(reading) = Square::new([a, b, c, d])
                .and_then(|square| decode::read(image, &square, &self.layout, &config.reading()))
            else {
                continue;
            };
            readings.push(([*x, *y], reading.code));
            if reading.border_errors > config.max_marker_border_errors {
                continue;
            }
            let Some(found) = self.book.find(reading.code, self.max_errors) else {
                continue;
            };
            let Some(((column, row), _)) = self.own_id.iter().find(|(_, id)| *id == found.id)
            else {
                votes.push((
                    Placement {
                        origin: [i32::MAX; 2],
                        turns: 0,
                    },
                    1,
                    0,
                ));
                continue;
            };
            let placement = placement(found.turns, [*x, *y], [*column, *row]);
            match votes.iter_mut().find(|(p, ..)| *p == placement) {
                Some((_, count, errors)) => {
                    *count += 1;
                    *errors += found.errors;
                }
                None => votes.push((placement, 1, found.errors)),
            }
        }
        let all: u32 = votes.iter().map(|(_, count, _)| count).sum();
        let &(best, count, errors) = votes.iter().max_by_key(|(_, count, _)| *count)?;
        if best.origin[0] == i32::MAX
            || count < config.min_votes
            || count < config.min_vote_ratio * (all - count)
            || errors > config.max_mean_errors * count
        {
            return None;
        }
        // Every decoded square confirms or contradicts the placement.
        let mut wrong = 0;
        for ([x, y], code) in &readings {
            let [u, v] = square_at(&best, [*x, *y]);
            let expected = self
                .own_id
                .iter()
                .find(|(at, _)| *at == (u, v))
                .map(|(_, id)| *id);
            let errors = expected.and_then(|id| self.book.errors(*code, id, best.turns));
            let many = self.layout.bits * self.layout.bits / config.max_wrong_bits_divisor;
            wrong += u32::from(errors.is_none_or(|e| e > many));
        }
        (wrong <= count / config.max_wrong_squares_divisor).then_some(best)
    }
}

/// As [`Lattice::is_dark`], by a neighbour if a crossing was added later.
fn lattice_is_dark(lattice: &Lattice, (y, x): (i32, i32)) -> Option<bool> {
    lattice.is_dark((y, x)).or_else(|| {
        let even = |u: i32, v: i32| (x - u + y - v).rem_euclid(2) == 0;
        lattice
            .nodes
            .keys()
            .find_map(|&(v, u)| Some(lattice.is_dark((v, u))? == even(u, v)))
    })
}

/// The placement that follows if the square at lattice (x, y) (its crossing of least x and y) is
/// the board's square (column, row), rotated clockwise by quarter turns.
fn placement(turns: usize, [x, y]: [i32; 2], [column, row]: [i32; 2]) -> Placement {
    // The board's inner corner (c, r) is the crossing between squares (c, r) and (c + 1, r + 1):
    // the square's own top left crossing is corner (column - 1, row - 1). In the lattice that
    // crossing is the corner of the square to which `turns` quarter turns rotate the top left.
    let at = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]][turns % 4];
    let [u, v] = rotated([column - 1, row - 1], turns);
    Placement {
        origin: [at[0] - u, at[1] - v],
        turns: turns % 4,
    }
}

/// The board's square at the lattice's square (x, y).
fn square_at(placement: &Placement, [x, y]: [i32; 2]) -> [i32; 2] {
    let corners = [[x, y], [x + 1, y], [x + 1, y + 1], [x, y + 1]];
    let [c, r] = placement.board_at(corners[placement.turns % 4]);
    [c + 1, r + 1]
}
