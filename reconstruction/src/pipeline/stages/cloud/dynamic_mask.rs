//! Masks of what does not belong to the static scene: dynamic objects, and the wearer.
//!
//! Contract: a pixel of a keyframe is *dynamic* if at least two keyframes of other instants see
//! through its surface, more than support it ([`super::free_space`]), and most pixels around
//! it are dynamic, too: matchers make edges slightly too wide, and those are seen through as well.
//! Pixels without depth have no vote; beside dynamic pixels they are taken as dynamic, too, since
//! matchers find nothing where only one image shows a surface. The wearer is where near objects are
//! dynamic repeatedly in the same area of the image. Masks are of the recorded left image.

use camera_models::{CameraModel, Lens};
use scene_bundle::outputs::depth::DepthView;
use scene_bundle::outputs::masks::Mask;

use super::config::MaskConfig;

/// Masks of one camera.
pub(super) struct DynamicMasker {
    config: MaskConfig,
    width: usize,
    height: usize,
    columns: usize,
    views: u32,
    /// Number of views in which each cell showed the wearer.
    counts: Vec<u32>,
    /// For each pixel of the recorded left image its pixel of the view, or the nearest one; `None`
    /// far outside.
    view_pixels: Vec<Option<usize>>,
    recorded: [u32; 2],
}

/// Motion of a pixel of a view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PixelMotion {
    /// No depth, or not classified.
    Unknown,
    /// Static, or not known to be dynamic.
    Static,
    /// Dynamic, far away or nearby.
    DynamicFar,
    DynamicNear,
}

impl PixelMotion {
    /// A surface at a depth, m, dynamic or not.
    pub(super) fn of(config: &MaskConfig, is_dynamic: bool, depth_m: f64) -> Self {
        match is_dynamic {
            false => Self::Static,
            true if depth_m < config.max_wearer_distance_m => Self::DynamicNear,
            true => Self::DynamicFar,
        }
    }
}

impl DynamicMasker {
    /// For a camera with the intrinsics of its recorded left images.
    pub(super) fn new(config: MaskConfig, view: &DepthView, recorded: &CameraModel) -> Self {
        let (width, height) = (view.model.width as usize, view.model.height as usize);
        let columns = width.div_ceil(config.cell_px);
        let (eye, straight) = (Lens::new(recorded), Lens::new(&view.model));
        let pixels = (0..recorded.height).flat_map(|y| (0..recorded.width).map(move |x| (x, y)));
        let pixel = |(x, y): (u32, u32)| {
            let ray = eye.unproject([f64::from(x), f64::from(y)])?;
            let [x, y] = straight.project(view.view_from_left.rotate(ray))?;
            let near = |v: f64, count: usize| {
                let most = (count - 1) as f64;
                (v > -config.border_extension_px && v < most + config.border_extension_px)
                    .then(|| v.round().clamp(0.0, most))
            };
            let (x, y) = (near(x, width)?, near(y, height)?);
            Some(y as usize * width + x as usize)
        };
        Self {
            config,
            width,
            height,
            columns,
            views: 0,
            counts: vec![0; columns * height.div_ceil(config.cell_px)],
            view_pixels: pixels.map(pixel).collect(),
            recorded: [recorded.width, recorded.height],
        }
    }

    /// Adds a view: motion of its pixels, rows first, and movable pixels of the recorded left image
    /// according to a network, if there is one. Returns the dynamic mask of the view, `None`
    /// without dynamic pixels.
    pub(super) fn add(&mut self, pixels: &[PixelMotion], movable: Option<&[bool]>) -> Option<Mask> {
        let config = self.config;
        self.views += 1;
        let (width, height) = (self.width, self.height);
        let mut near = vec![0_usize; self.counts.len()];
        for (i, pixel) in pixels.iter().enumerate() {
            let cell = i / width / config.cell_px * self.columns + i % width / config.cell_px;
            near[cell] += usize::from(*pixel == PixelMotion::DynamicNear);
        }
        for (count, near) in self.counts.iter_mut().zip(near) {
            *count += u32::from(
                near as f64 >= config.min_cell_ratio * (config.cell_px * config.cell_px) as f64,
            );
        }
        let is_dynamic = pixels
            .iter()
            .map(|p| [PixelMotion::DynamicNear, PixelMotion::DynamicFar].contains(p));
        let is_dynamic: Vec<bool> = is_dynamic.collect();
        let half = (2 * config.smoothing_radius_px + 1).pow(2) / 2;
        let most = around(
            &is_dynamic,
            [width, height],
            config.smoothing_radius_px,
            |count| count > half,
        );
        let mut dilated = around(&most, [width, height], config.dilation_px, |count| {
            count > 0
        });
        let reached = around(
            &most,
            [width, height],
            config.dilation_unknown_px,
            |count| count > 0,
        );
        for ((dilated, reached), pixel) in dilated.iter_mut().zip(reached).zip(pixels) {
            *dilated |= reached && *pixel == PixelMotion::Unknown;
        }
        let movable = movable.filter(|movable| movable.contains(&true));
        if !dilated.contains(&true) && movable.is_none() {
            return None;
        }
        let mut mask = self.mask(&dilated);
        for (pixel, movable) in mask.pixels.iter_mut().zip(movable.unwrap_or_default()) {
            if *movable {
                *pixel = 0;
            }
        }
        Some(mask)
    }

    /// The wearer mask; `None` if the wearer is nowhere.
    pub(super) fn wearer_mask(&self) -> Option<Mask> {
        let config = self.config;
        if self.views < config.min_wearer_views {
            return None;
        }
        let min_count = config.min_wearer_ratio * f64::from(self.views);
        let shows_wearer: Vec<bool> = self
            .counts
            .iter()
            .map(|c| f64::from(*c) >= min_count)
            .collect();
        let rows = self.height.div_ceil(config.cell_px);
        // Neighbouring cells show the wearer at least in part.
        let dilated = around(&shows_wearer, [self.columns, rows], 1, |count| count > 0);
        let pixel = |i: usize| {
            dilated
                [i / self.width / config.cell_px * self.columns + i % self.width / config.cell_px]
        };
        let view: Vec<bool> = (0..self.width * self.height).map(pixel).collect();
        shows_wearer.contains(&true).then(|| self.mask(&view))
    }

    /// From the view to the recorded image; pixels far outside the view may be used.
    fn mask(&self, is_dynamic: &[bool]) -> Mask {
        let value = |pixel: &Option<usize>| match pixel.is_some_and(|pixel| is_dynamic[pixel]) {
            true => 0,
            false => 255,
        };
        Mask {
            width: self.recorded[0],
            height: self.recorded[1],
            pixels: self.view_pixels.iter().map(value).collect(),
        }
    }
}

/// For each cell whether the number of true cells around it, up to `reach` away in both directions,
/// satisfies `fits`.
fn around(
    of: &[bool],
    [width, height]: [usize; 2],
    reach: usize,
    fits: impl Fn(usize) -> bool,
) -> Vec<bool> {
    // Sums of all that is above and to the left.
    let mut sums = vec![0_usize; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0;
        for x in 0..width {
            row += usize::from(of[y * width + x]);
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let mut out = Vec::with_capacity(of.len());
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(reach), (y + reach + 1).min(height));
        for x in 0..width {
            let (left, right) = (x.saturating_sub(reach), (x + reach + 1).min(width));
            let at = |x: usize, y: usize| sums[y * (width + 1) + x];
            let count = at(right, bottom) + at(left, top) - at(left, bottom) - at(right, top);
            out.push(fits(count));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use camera_models::Distortion;

    use super::*;

    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;

    fn moving() -> DynamicMasker {
        let model = CameraModel {
            width: WIDTH,
            height: HEIGHT,
            fx: 50.0,
            fy: 50.0,
            cx: 31.5,
            cy: 23.5,
            distortion: Distortion::None,
        };
        let view = DepthView {
            camera: "feet".to_owned(),
            model,
            view_from_left: RigidTransform::identity(),
        };
        DynamicMasker::new(MaskConfig::default(), &view, &model)
    }

    /// Dynamic pixels in a rectangle of columns and rows.
    fn pixels(
        columns: std::ops::Range<usize>,
        rows: std::ops::Range<usize>,
        depth_m: f64,
    ) -> Vec<PixelMotion> {
        let all = (0..HEIGHT as usize).flat_map(|y| (0..WIDTH as usize).map(move |x| (x, y)));
        all.map(|(x, y)| {
            PixelMotion::of(
                &MaskConfig::default(),
                columns.contains(&x) && rows.contains(&y),
                depth_m,
            )
        })
        .collect()
    }

    fn masked(mask: &Mask) -> usize {
        mask.pixels.iter().filter(|p| **p == 0).count()
    }

    #[test]
    fn dynamic_areas_are_masked_and_thin_edges_are_not() {
        let mut moving = moving();
        let mask = moving
            .add(&pixels(20..32, 10..30, 4.0), None)
            .expect("a mask");
        // Dilated on all sides, with round corners.
        assert!(
            (12 * 20..16 * 24 + 1).contains(&masked(&mask)),
            "{}",
            masked(&mask)
        );
        assert_eq!(mask.pixels[20 * WIDTH as usize + 25], 0);
        assert_eq!(mask.pixels[20 * WIDTH as usize + 40], 255);
        // Pixels without depth are masked beside it, elsewhere not.
        let mut partly = pixels(20..32, 10..30, 4.0);
        let at = |x: usize, y: usize| y * WIDTH as usize + x;
        partly[at(38, 20)] = PixelMotion::Unknown;
        partly[at(60, 20)] = PixelMotion::Unknown;
        let mask = moving.add(&partly, None).expect("a mask");
        assert_eq!(
            [at(38, 20), at(39, 20), at(60, 20)].map(|i| mask.pixels[i]),
            [0, 255, 255]
        );
        assert_eq!(moving.add(&pixels(20..22, 10..30, 4.0), None), None);
        assert_eq!(moving.add(&pixels(0..0, 0..0, 4.0), None), None);
    }

    #[test]
    fn movable_pixels_of_a_network_are_masked_as_well() {
        let mut moving = moving();
        let mut movable = vec![false; (WIDTH * HEIGHT) as usize];
        let nothing = pixels(0..0, 0..0, 4.0);
        assert_eq!(moving.add(&nothing, Some(&movable)), None);
        movable[77] = true;
        let mask = moving.add(&nothing, Some(&movable)).expect("a mask");
        assert_eq!((masked(&mask), mask.pixels[77]), (1, 0));
    }

    #[test]
    fn the_wearer_is_dynamic_repeatedly_in_the_same_area() {
        let mut moving = moving();
        for k in 0..100 {
            // A shoe in one view of five; a near person who crosses once; a far person in all
            // views.
            let pixels = match k % 5 {
                0 => pixels(16..32, 32..48, 1.2),
                1 if k < 50 => pixels(k..k + 9, 0..9, 1.5),
                _ => pixels(48..60, 0..20, 5.0),
            };
            moving.add(&pixels, None);
            if k < 15 {
                assert_eq!(moving.wearer_mask(), None);
            }
        }
        let mask = moving.wearer_mask().expect("a mask");
        let at = |x: usize, y: usize| mask.pixels[y * WIDTH as usize + x];
        assert_eq!([at(20, 40), at(31, 47), at(36, 40)], [0; 3]);
        assert_eq!([at(50, 10), at(5, 5), at(20, 10), at(50, 40)], [255; 4]);
    }
}
