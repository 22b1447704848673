//! What a keyframe says of the surfaces before it, and what others say of those.

use cad_transforms::RigidTransform;
use scene_bundle::outputs::depth::{DepthIndex, DepthKey, DepthPicture, DepthView, read};
use scene_bundle::{BundleError, OutputReader};

use super::sway::Sway;

/// Two depths agree when they are apart by at most so many sigma of both together.
pub(super) const AGREE_SIGMA: f64 = 2.0;
/// A view sees through a place when all that it sees there is farther by more than so many sigma of both together.
pub(super) const THROUGH_SIGMA: f64 = 3.0;
/// So many views of other instants must confirm a surface. With one, feet that stand for a moment and people who walk along the line
/// of sight stay.
pub(super) const LEAST_CONFIRMED: u32 = 2;
/// So many views must confirm a surface for each that sees through it: matchers err, and two in four err less often alike.
pub(super) const CONFIRMED_PER_THROUGH: u32 = 3;
/// So many views of other instants must see through what moves.
const LEAST_THROUGH: u32 = 2;

/// A picture of depth, and from where it was taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shot {
    pub(super) key: DepthKey,
    /// When its middle row was exposed.
    pub(super) world_from_view: RigidTransform,
    pub(super) sway: Sway,
}

/// Depth of a keyframe in the world.
pub(super) struct Look {
    picture: DepthPicture,
    /// Focal lengths and principal point, px.
    focal: [f64; 2],
    centre: [f64; 2],
    world_from_view: Motion,
    view_from_world: Motion,
    left_from_view: Motion,
    sway: Sway,
}

/// A rigid transform as it is quick to apply.
#[derive(Clone, Copy)]
struct Motion {
    rows: [f64; 9],
    shift: [f64; 3],
}

/// Something that a look saw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Surface {
    /// m.
    pub(super) x_in_world: [f64; 3],
    /// Along the view's axis, m.
    pub(super) depth_m: f64,
    /// One standard deviation along the view's axis, m.
    pub(super) sigma_m: f64,
    /// The axis of the view along which sigma is, of length 1.
    axis_in_world: [f64; 3],
}

/// What all others together say of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is there and stands still.
    Stands,
    /// It was there, and was not at other times.
    Moves,
    /// Too few say anything, or they do not agree.
    Unknown,
}

/// What a look says of a surface that another one saw.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Said {
    /// It is outside, behind something, or where nothing is known.
    Nothing,
    /// It is there.
    Confirms,
    /// It is not there: what is behind it can be seen.
    SeesThrough,
}

impl Motion {
    fn of(transform: &RigidTransform) -> Self {
        Self {
            rows: transform.rotation_rows(),
            shift: transform.translation_m(),
        }
    }

    fn turn(&self, v: [f64; 3]) -> [f64; 3] {
        let r = &self.rows;
        [0, 3, 6].map(|k| r[k] * v[0] + r[k + 1] * v[1] + r[k + 2] * v[2])
    }

    fn apply(&self, x: [f64; 3]) -> [f64; 3] {
        let turned = self.turn(x);
        [0, 1, 2].map(|k| turned[k] + self.shift[k])
    }
}

impl Look {
    pub(super) fn read(
        depth: &OutputReader,
        index: &DepthIndex,
        shot: &Shot,
    ) -> Result<Self, BundleError> {
        let picture = read(depth, index, &shot.key)?;
        let view = &index.views[shot.key.view];
        Ok(Self::new(picture, view, &shot.world_from_view, shot.sway))
    }

    pub(super) fn new(
        picture: DepthPicture,
        view: &DepthView,
        world_from_view: &RigidTransform,
        sway: Sway,
    ) -> Self {
        let model = &view.model;
        Self {
            picture,
            focal: [model.fx, model.fy],
            centre: [model.cx, model.cy],
            world_from_view: Motion::of(world_from_view),
            view_from_world: Motion::of(&world_from_view.inverse()),
            left_from_view: Motion::of(&view.view_from_left.inverse()),
            sway,
        }
    }

    /// Makes all of it as uncertain as this.
    #[cfg(test)]
    pub(super) fn blur(&mut self, sigma_m: f64) {
        let sigma = scene_bundle::outputs::depth::stored_sigma(sigma_m as f32);
        self.picture.sigma.fill(sigma);
    }

    pub(super) fn width(&self) -> u32 {
        self.picture.width
    }

    pub(super) fn height(&self) -> u32 {
        self.picture.height
    }

    /// Whether the other one may see something of what this one sees: their axes are less than a right angle apart, or nearly so.
    pub(super) fn may_share(&self, other: &Self) -> bool {
        let axis = |look: &Self| look.world_from_view.turn([0.0, 0.0, 1.0]);
        let (a, b) = (axis(self), axis(other));
        a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() > -0.2
    }

    fn ray(&self, column: u32, row: u32) -> [f64; 3] {
        let at = [f64::from(column), f64::from(row)];
        let [x, y] = [0, 1].map(|k| (at[k] - self.centre[k]) / self.focal[k]);
        [x, y, 1.0]
    }

    /// Direction of a pixel in the recorded left optical frame.
    pub(super) fn ray_in_left(&self, column: u32, row: u32) -> [f64; 3] {
        self.left_from_view.turn(self.ray(column, row))
    }

    /// What a pixel shows, where that is known to `largest_sigma_m`.
    pub(super) fn surface(&self, column: u32, row: u32, largest_sigma_m: f64) -> Option<Surface> {
        let depth = self.picture.depth_m(column, row)?;
        let sigma_m = self.picture.sigma_m(column, row)?;
        let x_in_view = self.ray(column, row).map(|v| v * depth);
        let x_in_view = self.sway.at_middle(f64::from(row), x_in_view);
        (sigma_m <= largest_sigma_m).then(|| Surface {
            x_in_world: self.world_from_view.apply(x_in_view),
            depth_m: depth,
            sigma_m,
            axis_in_world: self.world_from_view.turn([0.0, 0.0, 1.0]),
        })
    }

    fn say(&self, surface: &Surface) -> Said {
        let in_view = self.view_from_world.apply(surface.x_in_world);
        if in_view[2] <= 0.0 {
            return Said::Nothing;
        }
        // In which row it is seen hardly depends on when that was.
        let row = self.focal[1] * in_view[1] / in_view[2] + self.centre[1];
        let [x, y, z] = self.sway.at_row(row, in_view);
        let at = [
            self.focal[0] * x / z + self.centre[0],
            self.focal[1] * y / z + self.centre[1],
        ];
        let size = [self.picture.width, self.picture.height];
        if (0..2).any(|k| !(at[k] >= 0.0 && at[k] < f64::from(size[k]) - 1.0)) {
            return Said::Nothing;
        }
        let (column, row) = (at[0] as u32, at[1] as u32);
        // Across its axis a surface is known much better than along it.
        let along = self.view_from_world.turn(surface.axis_in_world)[2];
        let of_surface = along * surface.sigma_m;
        let (mut known, mut beyond) = (0, 0);
        // What lies between pixels may be on the surface of any of the four.
        for (right, down) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let (column, row) = (column + right, row + down);
            let seen = self.picture.depth_m(column, row);
            let (Some(depth), Some(sigma)) = (seen, self.picture.sigma_m(column, row)) else {
                continue;
            };
            let both = of_surface.hypot(sigma);
            if (depth - z).abs() <= AGREE_SIGMA * both {
                return Said::Confirms;
            }
            known += 1;
            beyond += u32::from(depth - z > THROUGH_SIGMA * both);
        }
        match known == 4 && beyond == 4 {
            true => Said::SeesThrough,
            false => Said::Nothing,
        }
    }
}

impl Surface {
    /// What others say of it; of each is known whether it looked at another instant: what moves is confirmed by those who look
    /// at the same one.
    pub(super) fn judged(&self, others: &[(bool, &Look)]) -> Verdict {
        let (mut confirmed, mut through, mut through_later) = (0, 0, 0);
        for (is_later, other) in others {
            match other.say(self) {
                Said::Confirms => confirmed += u32::from(*is_later),
                Said::SeesThrough => {
                    through += 1;
                    through_later += u32::from(*is_later);
                }
                Said::Nothing => {}
            }
        }
        if confirmed >= LEAST_CONFIRMED && confirmed >= CONFIRMED_PER_THROUGH * through {
            Verdict::Stands
        } else if through_later >= LEAST_THROUGH && through_later > confirmed {
            Verdict::Moves
        } else {
            Verdict::Unknown
        }
    }
}
