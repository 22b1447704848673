//! AprilGrids: dark squares between four crossings, decoded as tags and checked against their
//! neighbours.
//!
//! Contract: a tag is accepted if borders connect its four crossings around a dark square, its
//! border is black, its code is a tag of the board, and no neighbour across a gap contradicts it.
//! Missing tags are searched around accepted ones.

use std::collections::{BTreeMap, BTreeSet};

use boards::Target;

use super::blur::Border;
use super::config::Config;
use super::refine::{self, Window};
use super::saddle;
use super::scene::{BoardCandidate, CornerCandidate, Scene};
use fiducials::decode::{self, Book, Layout};
use fiducials::square::{Square, distance};
use imaging::ImageView;

/// A tag in the image.
#[derive(Clone, Debug)]
struct Tag {
    id: u32,
    /// Its corners top left, top right, bottom right, bottom left, in the tag's own orientation.
    corners: [[f64; 2]; 4],
    /// The crossings at these corners, with the ray that leaves clockwise along the tag's side;
    /// `None` for a tag found at its predicted position.
    nodes: Option<[(usize, usize); 4]>,
    errors: u32,
}

pub(super) fn find(
    image: &ImageView<'_>,
    scene: &Scene,
    target: &Target,
    config: &Config,
) -> BoardCandidate {
    let &Target::AprilGrid {
        columns,
        rows,
        spacing,
        first_id,
        ..
    } = target
    else {
        return BoardCandidate::default();
    };
    let Some((dictionary, border)) = target.dictionary() else {
        return BoardCandidate::default();
    };
    let grid = Grid {
        columns,
        rows,
        spacing,
        first_id,
        book: Book::of(dictionary),
        layout: Layout {
            from: 0.0,
            to: 1.0,
            bits: dictionary.bits(),
            border,
            white: spacing,
        },
        max_errors: config.max_bit_errors.min((dictionary.distance() - 1) / 2),
    };
    let (tags, doubles) = grid.consistent(scene, grid.read_squares(image, scene));
    let tags = grid.find_missing(image, scene, tags);
    let mut found = BoardCandidate::default();
    if doubles {
        found.remark = Some("some ids occur twice in the image");
    }
    for tag in &tags {
        let sides = [0, 1, 2, 3].map(|i| distance(tag.corners[i], tag.corners[(i + 1) % 4]));
        for i in 0..4 {
            found.borders.push(Border {
                ends: [tag.corners[i], tag.corners[(i + 1) % 4]],
                // Inside two cells of border, outside the gap.
                clear: sides[(i + 1) % 4].min(sides[(i + 3) % 4]) * spacing.min(0.2),
            });
        }
        // Kalibr's order: bottom left, bottom right, top right, top left.
        for (k, i) in [3, 2, 1, 0].into_iter().enumerate() {
            // The bits begin two cells from both sides; the crossing square ends a gap away.
            let share = spacing.min(0.28);
            let side = |to: usize| [0, 1].map(|k| share * (tag.corners[to][k] - tag.corners[i][k]));
            found.corners.push(CornerCandidate {
                id: 4 * tag.id + k as u32,
                at: tag.corners[i],
                sides: [side((i + 1) % 4), side((i + 3) % 4)],
                gap: spacing * sides[i].min(sides[(i + 3) % 4]),
            });
        }
    }
    found.corners.sort_by_key(|c| c.id);
    found
}

struct Grid {
    columns: u32,
    rows: u32,
    spacing: f64,
    first_id: u32,
    book: Book,
    layout: Layout,
    max_errors: u32,
}

impl Grid {
    /// All dark squares that decode as a tag of this board.
    fn read_squares(&self, image: &ImageView<'_>, scene: &Scene) -> Vec<Tag> {
        let mut seen = BTreeSet::new();
        let mut tags = Vec::new();
        for start in 0..scene.saddles.len() {
            for ray in [0, 2] {
                let Some(nodes) = around(scene, start, ray) else {
                    continue;
                };
                let mut key = nodes.map(|(n, _)| n);
                key.sort_unstable();
                if !seen.insert(key) {
                    continue;
                }
                let corners = nodes.map(|(n, _)| scene.saddles[n].at);
                let Some(square) = Square::new(corners) else {
                    continue;
                };
                let Some(reading) = decode::read(
                    image,
                    &square,
                    &self.layout,
                    &scene.config.markers.reading(),
                ) else {
                    continue;
                };
                if reading.border_errors > scene.config.markers.max_border_errors {
                    continue;
                }
                let Some(found) = self.book.find(reading.code, self.max_errors) else {
                    continue;
                };
                if self.place(found.id).is_none() {
                    continue;
                }
                let own = [0, 1, 2, 3].map(|i| (i + found.turns) % 4);
                tags.push(Tag {
                    id: found.id,
                    corners: own.map(|i| corners[i]),
                    nodes: Some(own.map(|i| nodes[i])),
                    errors: found.errors,
                });
            }
        }
        tags
    }

    /// Column and row (upwards) of a tag.
    fn place(&self, id: u32) -> Option<[i64; 2]> {
        let index = id.checked_sub(self.first_id)?;
        (index < self.columns * self.rows).then(|| {
            [
                i64::from(index % self.columns),
                i64::from(index / self.columns),
            ]
        })
    }

    fn id_at(&self, [column, row]: [i64; 2]) -> Option<u32> {
        let inside = (0..i64::from(self.columns)).contains(&column)
            && (0..i64::from(self.rows)).contains(&row);
        inside.then(|| self.first_id + (row * i64::from(self.columns) + column) as u32)
    }

    /// Removes tags that neighbours contradict, and duplicate tags; returns whether there were any.
    fn consistent(&self, scene: &Scene, tags: Vec<Tag>) -> (Vec<Tag>, bool) {
        let mut owner: BTreeMap<usize, usize> = BTreeMap::new();
        for (t, tag) in tags.iter().enumerate() {
            for (node, _) in tag.nodes.iter().flatten() {
                owner.insert(*node, t);
            }
        }
        // Left, up, right, down as (column, row upwards).
        const LEFT: [i64; 2] = [-1, 0];
        const UP: [i64; 2] = [0, 1];
        const RIGHT: [i64; 2] = [1, 0];
        const DOWN: [i64; 2] = [0, -1];
        // From each corner of a tag two rays continue across the gaps: the leaving ray's other end
        // and the next.
        const ONWARD: [[[i64; 2]; 2]; 4] = [[LEFT, UP], [UP, RIGHT], [RIGHT, DOWN], [DOWN, LEFT]];
        let mut agree = vec![0u32; tags.len()];
        let mut differ = vec![0u32; tags.len()];
        for (t, tag) in tags.iter().enumerate() {
            let Some([column, row]) = self.place(tag.id) else {
                continue;
            };
            for ((node, leaving), onward) in tag.nodes.iter().flatten().zip(ONWARD) {
                for (turn, [dx, dy]) in [2, 3].into_iter().zip(onward) {
                    let Some((to, _)) = scene.links[*node][(leaving + turn) % 4] else {
                        continue;
                    };
                    let Some(&other) = owner.get(&to) else {
                        continue;
                    };
                    if Some(tags[other].id) == self.id_at([column + dx, row + dy]) {
                        agree[t] += 1;
                    } else {
                        differ[t] += 1;
                    }
                }
            }
        }
        let mut doubles = false;
        let kept: Vec<Tag> = (0..tags.len())
            .filter(|&t| {
                let other = (0..tags.len()).find(|&o| o != t && tags[o].id == tags[t].id);
                // Of two tags with one id, the one confirmed by neighbours.
                let double = other.is_some_and(|o| agree[o] >= agree[t]);
                doubles |= other.is_some();
                let lone = agree[t] == 0 && tags[t].errors > scene.config.markers.max_lone_errors;
                differ[t] == 0 && !double && !lone
            })
            .map(|t| tags[t].clone())
            .collect();
        (kept, doubles)
    }

    /// Searches for missing neighbours of the tags until none is found.
    fn find_missing(&self, image: &ImageView<'_>, scene: &Scene, mut tags: Vec<Tag>) -> Vec<Tag> {
        let mut known: BTreeSet<u32> = tags.iter().map(|t| t.id).collect();
        let mut next = 0;
        while next < tags.len() {
            let tag = tags[next].clone();
            next += 1;
            let (Some([column, row]), Some(square)) =
                (self.place(tag.id), Square::new(tag.corners))
            else {
                continue;
            };
            for [dx, dy] in [[1, 0], [0, 1], [-1, 0], [0, -1]] {
                let Some(id) = self.id_at([column + dx, row + dy]) else {
                    continue;
                };
                if known.contains(&id) {
                    continue;
                }
                // Rows count upwards, v downwards.
                let shift = [dx, -dy].map(|d| d as f64 * (1.0 + self.spacing));
                if let Some(found) = self.read_expected(image, scene, &square, shift, id) {
                    known.insert(id);
                    tags.push(found);
                }
            }
        }
        tags
    }

    fn read_expected(
        &self,
        image: &ImageView<'_>,
        scene: &Scene,
        from: &Square,
        shift: [f64; 2],
        id: u32,
    ) -> Option<Tag> {
        let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let guesses = unit.map(|uv| from.at([uv[0] + shift[0], uv[1] + shift[1]]));
        let side = (0..4)
            .map(|i| distance(guesses[i], guesses[(i + 1) % 4]))
            .fold(f64::INFINITY, f64::min);
        let config = &scene.config;
        let markers = &config.markers;
        if side < markers.min_expected_side_px {
            return None;
        }
        let mut corners = guesses;
        for corner in &mut corners {
            let [low, high] = markers.expected_shift_px;
            let near = (markers.expected_shift_ratio * side).clamp(low, high);
            let [low, high] = markers.expected_window_px;
            let reach = (markers.expected_window_ratio * side).clamp(low, high);
            let window = Window::round(reach, &config.refinement);
            *corner = refine::refine_corner(&scene.smooth, *corner, &window, near)?;
            let [low, high] = markers.expected_radius_px;
            let radius = (markers.expected_radius_ratio * side as f32).clamp(low, high);
            saddle::fit_rays(&scene.smooth, *corner, radius, &config.saddles)?;
        }
        let reading = decode::read(
            image,
            &Square::new(corners)?,
            &self.layout,
            &markers.reading(),
        )?;
        let errors = self.book.errors(reading.code, id, 0)?;
        (reading.border_errors <= markers.max_border_errors
            && errors <= markers.max_expected_errors)
            .then_some(Tag {
                id,
                corners,
                nodes: None,
                errors,
            })
    }
}

/// Walks around the dark square clockwise of a crossing's even ray: its corners clockwise in the
/// image, each with the ray that leaves to the next one. One of the four sides may be missing, if
/// both its ends have no other link.
fn around(scene: &Scene, start: usize, ray: usize) -> Option<[(usize, usize); 4]> {
    let mut corners = [(start, ray); 4];
    for i in 1..4 {
        let (node, leaving) = corners[i - 1];
        let (to, arriving) = scene.links[node][leaving]?;
        // The dark sector is between the previous ray and the arriving one.
        corners[i] = (to, (arriving + 3) % 4);
    }
    let (last, leaving) = corners[3];
    let closes = match scene.links[last][leaving] {
        Some(end) => end == (start, (ray + 1) % 4),
        None => scene.links[start][(ray + 1) % 4].is_none(),
    };
    let distinct = (0..4).all(|i| (0..i).all(|j| corners[i].0 != corners[j].0));
    (closes && distinct).then_some(corners)
}
