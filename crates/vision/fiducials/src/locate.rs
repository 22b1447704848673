//! Where a tag of known identity is in an image, near a plane: also where blur hides its bits.
//!
//! A detector of quadrilaterals needs edges, which motion by a cell and more takes away. Here the
//! orientation of the tag and its motion are approximately known, and its place is not: the printed
//! pattern, blurred as its motion says, is correlated with all places of a region.

use std::rc::Rc;

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use crate::blur::Blur;
use crate::tag::Tag;
use crate::view::{Motion, View, pixel_axes};

mod region;

pub use self::region::LocateConfig;
use self::region::{Candidate, Frame, Kernel, Region};

/// A place of a tag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Takes points of the tag to the reference frame, in the orientation that it was searched in.
    pub reference_from_tag: RigidTransform,
    /// Correlation with the pattern.
    pub correlation: f64,
}

/// The place of a tag in one image that correlates best with its pattern; `None` if none does well.
///
/// `starts` are approximate poses; the tag is searched up to `reach_m` around each of them in the
/// plane through it with this normal, both in the reference frame, in the orientation of the start.
/// The pattern is that at the start: it may be wrong by a tenth of the distance of the tag.
pub fn locate(
    view: &View<'_>,
    tag: &Tag,
    starts: &[RigidTransform],
    motion: &Motion,
    (normal, reach_m): ([f64; 3], f64),
    config: &LocateConfig,
) -> Option<Place> {
    let mut searches: Vec<Search<'_>> = Vec::new();
    for start in starts {
        let own = Search::new(view, tag, start, motion, (reach_m, &searches), config);
        searches.extend(own);
    }
    // The best candidates of all starts.
    let mut candidates: Vec<(usize, Candidate)> = searches
        .iter()
        .enumerate()
        .flat_map(|(n, search)| {
            let own = search.coarse.candidates(&search.coarse_kernel, config);
            own.into_iter().map(move |candidate| (n, candidate))
        })
        .collect();
    candidates.sort_by(|a, b| b.1.correlation.total_cmp(&a.1.correlation));
    candidates.truncate(config.candidates);
    let refined = candidates.iter().filter_map(|(n, candidate)| {
        let Search { region, kernel, .. } = &searches[*n];
        Some((*n, region.best_near(kernel, candidate.pixel, config)?))
    });
    let (n, best) = refined.max_by(|a, b| a.1.correlation.total_cmp(&b.1.correlation))?;
    let correlation = f64::from(best.correlation);
    if correlation <= config.min_correlation {
        return None;
    }
    Some(Place {
        reference_from_tag: at_pixel(view, searches[n].start, normal, best.pixel)?,
        correlation,
    })
}

/// A search around one start: in pixels of the least size, and of twice that.
struct Search<'s> {
    start: &'s RigidTransform,
    kernel: Kernel,
    region: Rc<Region>,
    coarse_kernel: Kernel,
    coarse: Rc<Region>,
}

impl<'s> Search<'s> {
    fn new(
        view: &View<'_>,
        tag: &Tag,
        start: &'s RigidTransform,
        motion: &Motion,
        (reach_m, earlier): (f64, &[Self]),
        config: &LocateConfig,
    ) -> Option<Self> {
        let frame = Frame::around(view, start, reach_m)?;
        // Starts that differ in their direction share the part of the image.
        let region = |factor: usize| {
            let regions = earlier.iter().flat_map(|own| [&own.region, &own.coarse]);
            let known = regions
                .filter(|own| own.factor == factor && own.frame.is_near(&frame))
                .map(Rc::clone)
                .next();
            known.or_else(|| Region::new(view, &frame, factor).map(Rc::new))
        };
        let axes = pixel_axes(view, start, motion)?.map(|axis| axis.map(|v| v / tag.cell_m()));
        let [x, y] = axes;
        let px_per_cell = 1.0 / (x[0] * y[1] - x[1] * y[0]).abs().max(1e-9).sqrt();
        let factor = ((px_per_cell / config.px_per_cell) as usize).max(1);
        let around = |factor: usize| {
            let joined_px = ((factor * factor - 1) as f64 / 12.0).sqrt();
            let blur = Blur::new(view, tag, start, motion, config.blur_px.hypot(joined_px))?;
            let kernel = Kernel::new(tag, &blur, &axes, factor)?;
            Some((kernel, region(factor)?))
        };
        let (coarse_kernel, coarse) = around(2 * factor)?;
        let (kernel, region) = around(factor)?;
        Some(Self {
            start,
            kernel,
            region,
            coarse_kernel,
            coarse,
        })
    }
}

/// A pose moved in a plane to where a pixel shows its origin.
fn at_pixel(
    view: &View<'_>,
    start: &RigidTransform,
    normal: [f64; 3],
    pixel: [f64; 2],
) -> Option<RigidTransform> {
    let reference_from_eye = view.eye_from_reference.inverse();
    let ray = reference_from_eye.rotation() * Vector3::from(view.lens.unproject(pixel)?);
    let eye = reference_from_eye.translation();
    let normal = Vector3::from(normal);
    let slope = normal.dot(&ray);
    if slope.abs() < 1e-3 {
        return None;
    }
    let distance = normal.dot(&(start.translation() - eye)) / slope;
    let moved = eye + ray * distance - start.translation();
    let moved = RigidTransform::from_translation_m(moved.into()).ok()?;
    (distance > 0.0).then_some(moved * *start)
}

#[cfg(test)]
mod tests;
