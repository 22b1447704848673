//! Keyframes that show the place of a contact, before or after the foot stood there.
//!
//! Contract: a place is visible in a keyframe if half of the sole's outline projects into the depth
//! view and is not hidden by what the depth map shows in front of it. While the foot bears on the
//! ground, it hides its place. Places without depth are not visible. Keyframes long before or after
//! the contact do not count.

use std::collections::BTreeMap;

use camera_models::Lens;
use estimator_config::config;
use rayon::prelude::*;
use scene_bundle::outputs::contacts::{ContactView, FootContact};
use scene_bundle::outputs::depth::{
    DEPTH_UNIT_M, DepthImage, DepthIndex, DepthView, SIGMA_UNIT_M, read,
};
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::{BundleError, OutputReader};

use crate::pipeline::StageError;
use crate::pipeline::stages::depth_frames::DepthFrame;

config! {
    /// Constants of the search.
    pub(super) struct ContactViewConfig {
        /// Least share of the sole's outline that has to be visible.
        pub min_share: f64 = 0.5,
        /// Maximum distance from the camera, m: a sole of 0.3 m is 20 px long there.
        pub max_distance_m: f64 = 8.0,
        /// Maximum time before the heel strike and after toe off, s: places that are passed
        /// repeatedly have views of that passage, so that the number of views grows with the
        /// length of the walk and not with its square.
        pub max_gap_s: f64 = 60.0,
        /// Sigmas by which a depth may be less than that of the sole.
        pub sigmas: f64 = 3.0,
        /// One standard deviation of the place of a sole beside that of depth, m.
        pub place_sigma_m: f64 = 0.01,
        /// Share of the outline's size at which it is tested, so that the ground beside it does
        /// not count.
        pub outline_share: f64 = 0.8,
    }
}

/// Keyframes and their depth.
pub(super) struct Keyframes<'a> {
    pub(super) rig: &'a RigModel,
    pub(super) depth: &'a OutputReader,
    pub(super) index: &'a DepthIndex,
    pub(super) frames: &'a [DepthFrame],
}

/// Views of all contacts, sorted by contact, time and camera. `outlines` are those of the soles of
/// the contacts' feet, in the frame of a foot, m.
pub(super) fn contact_views(
    contacts: &[FootContact],
    outlines: &[Vec<[f64; 2]>; 2],
    keyframes: &Keyframes<'_>,
) -> Result<Vec<ContactView>, StageError> {
    let config = ContactViewConfig::default();
    let sole = |contact: &FootContact| sole(contact, &outlines[contact.foot as usize], &config);
    let soles: Vec<Vec<[f64; 3]>> = contacts.iter().map(sole).collect();
    let places = soles.iter().map(|sole| sole[0]);
    let index = ContactIndex::new(contacts, places, &config);
    let of_frame = |frame: &DepthFrame| -> Result<Vec<ContactView>, BundleError> {
        let position = frame.world_from_view.translation_m();
        let near = index.near(position, frame.key.time_ns);
        if near.is_empty() {
            return Ok(Vec::new());
        }
        let place = Place {
            rig: keyframes.rig,
            view: &keyframes.index.views[frame.key.view],
            frame,
            image: &read(keyframes.depth, keyframes.index, &frame.key)?,
        };
        let view = |number: &usize| place.view(*number as u64, &soles[*number], &config);
        Ok(near.iter().filter_map(view).collect())
    };
    let views = keyframes.frames.par_iter().map(of_frame);
    let mut views: Vec<ContactView> = views.collect::<Result<Vec<_>, _>>()?.concat();
    views.sort_by_key(|view| (view.contact, view.time_ns, view.camera));
    Ok(views)
}

/// Contacts by place and time, so that a frame does not test all contacts of a long walk.
struct ContactIndex<'a> {
    contacts: &'a [FootContact],
    /// Numbers of contacts by cell, ascending.
    cells: BTreeMap<[i64; 2], Vec<usize>>,
    cell_m: f64,
    gap_ns: i64,
    /// Time of the longest contact, ns.
    longest_ns: i64,
}

impl<'a> ContactIndex<'a> {
    /// `contacts` are sorted by heel strike.
    fn new(
        contacts: &'a [FootContact],
        places: impl Iterator<Item = [f64; 3]>,
        config: &ContactViewConfig,
    ) -> Self {
        let mut index = Self {
            contacts,
            cells: BTreeMap::new(),
            cell_m: config.max_distance_m,
            gap_ns: (1e9 * config.max_gap_s) as i64,
            longest_ns: 0,
        };
        for (number, place) in places.enumerate() {
            index
                .cells
                .entry(index.cell(place))
                .or_default()
                .push(number);
            let [strike_ns, toe_off_ns] = index.times(number);
            index.longest_ns = index.longest_ns.max(toe_off_ns - strike_ns);
        }
        index
    }

    fn cell(&self, [x, y, _]: [f64; 3]) -> [i64; 2] {
        [x, y].map(|v| (v / self.cell_m).floor() as i64)
    }

    /// Heel strike and toe off, ns.
    fn times(&self, number: usize) -> [i64; 2] {
        let [strike, .., toe_off] = self.contacts[number].events.map(|event| event.time_ns);
        [strike, toe_off]
    }

    /// Contacts around a camera that do not bear at a time and are not long before or after it.
    fn near(&self, position: [f64; 3], time_ns: i64) -> Vec<usize> {
        let [row, column] = self.cell(position);
        let around = (-1..=1).flat_map(|i| (-1..=1).map(move |j| [row + i, column + j]));
        let cells = around.filter_map(|cell| self.cells.get(&cell));
        let from_ns = time_ns - self.gap_ns;
        let until_ns = time_ns + self.gap_ns;
        let strike = |number: &usize| self.times(*number)[0];
        let in_time = cells.flat_map(|numbers| {
            let first = numbers.partition_point(|own| strike(own) < from_ns - self.longest_ns);
            let end = numbers.partition_point(|own| strike(own) <= until_ns);
            &numbers[first..end]
        });
        let is_used = |number: &usize| {
            let [strike_ns, toe_off_ns] = self.times(*number);
            toe_off_ns >= from_ns && !(strike_ns..=toe_off_ns).contains(&time_ns)
        };
        in_time.copied().filter(is_used).collect()
    }
}

/// The middle of a sole and points of its outline, in the world.
fn sole(contact: &FootContact, outline: &[[f64; 2]], config: &ContactViewConfig) -> Vec<[f64; 3]> {
    let shrunk = outline
        .iter()
        .map(|point| point.map(|v| v * config.outline_share));
    let points = std::iter::once([0.0; 2]).chain(shrunk);
    points
        .map(|[x, y]| contact.world_from_foot.apply([x, y, 0.0]))
        .collect()
}

/// A depth map with its place.
struct Place<'a> {
    rig: &'a RigModel,
    view: &'a DepthView,
    frame: &'a DepthFrame,
    image: &'a DepthImage,
}

impl Place<'_> {
    fn view(
        &self,
        contact: u64,
        sole: &[[f64; 3]],
        config: &ContactViewConfig,
    ) -> Option<ContactView> {
        let Self {
            view, frame, image, ..
        } = *self;
        let view_from_world = frame.world_from_view.inverse();
        let is_visible = |point: &&[f64; 3]| {
            let [x, y, z] = view_from_world.apply(**point);
            if z <= 0.0 {
                return false;
            }
            let model = &view.model;
            let pixel = [
                (model.fx * x / z + model.cx).round(),
                (model.fy * y / z + model.cy).round(),
            ];
            let size = [image.width, image.height].map(f64::from);
            if !(0..2).all(|k| (0.0..size[k]).contains(&pixel[k])) {
                return false;
            }
            let at = pixel[1] as usize * image.width as usize + pixel[0] as usize;
            let depth = f64::from(image.depth[at]) * DEPTH_UNIT_M;
            let sigma = f64::from(image.sigma[at]) * SIGMA_UNIT_M;
            depth > 0.0 && depth >= z - config.sigmas * sigma.hypot(config.place_sigma_m)
        };
        let share = sole.iter().filter(is_visible).count() as f64 / sole.len() as f64;
        if share < config.min_share {
            return None;
        }
        let (camera, model) = self.rig.camera(&view.camera)?;
        let in_view = view_from_world.apply(sole[0]);
        let distance_m = in_view.iter().map(|v| v * v).sum::<f64>().sqrt();
        if distance_m > config.max_distance_m {
            return None;
        }
        let in_left = view.view_from_left.inverse().apply(in_view);
        let [column, row] = Lens::new(&model.left).project(in_left)?;
        Some(ContactView {
            contact,
            camera: u8::try_from(camera).ok()?,
            frame: frame.key.frame,
            time_ns: frame.key.time_ns,
            pixel: [column as f32, row as f32],
            distance_m: distance_m as f32,
            visible_share: share as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::Covariance;
    use cad_transforms::rig::Foot;
    use scene_bundle::outputs::contacts::ContactEvent;

    use super::*;
    use crate::pipeline::stages::down_looking::{HEIGHT_M, SIZE, at, frame, rig, view};

    /// The place of a sole that is `ahead_m` in front of the camera, on level ground with something
    /// of this height to the right of the middle.
    fn seen(ahead_m: f64, right_m: f64, obstacle_m: f64) -> Option<ContactView> {
        let (rig, view) = (rig(), view());
        let depth = |pixel: u32| match pixel % SIZE[0] >= SIZE[0] / 2 {
            true => HEIGHT_M - obstacle_m,
            false => HEIGHT_M,
        };
        let pixels = SIZE[0] * SIZE[1];
        let image = DepthImage {
            width: SIZE[0],
            height: SIZE[1],
            depth: (0..pixels)
                .map(|pixel| (depth(pixel) / DEPTH_UNIT_M) as u16)
                .collect(),
            sigma: vec![(0.004 / SIGMA_UNIT_M) as u16; pixels as usize],
        };
        let frame = frame(5);
        let place = Place {
            rig: &rig,
            view: &view,
            frame: &frame,
            image: &image,
        };
        let outline = &rig.shoes[0].outline_m;
        let foot = at(ahead_m, -right_m, -HEIGHT_M);
        let points = std::iter::once([0.0; 2]).chain(outline.iter().copied());
        let sole: Vec<[f64; 3]> = points.map(|[x, y]| foot.apply([x, y, 0.0])).collect();
        assert_eq!(rig.shoes[0].foot, Foot::Left);
        place.view(9, &sole, &ContactViewConfig::default())
    }

    #[test]
    fn a_place_in_the_image_is_visible_at_its_pixel() {
        let found = seen(0.1, -0.2, 0.0).expect("in the image");
        assert_eq!(
            (found.contact, found.camera, found.frame, found.time_ns),
            (9, 0, 3, 5)
        );
        assert_eq!(found.visible_share, 1.0);
        // 60 px per unit at 1.2 m: 0.1 m ahead is up, 0.2 m to the left.
        let [column, row] = found.pixel;
        assert!(
            (column - 19.5).abs() < 1e-3 && (row - 14.5).abs() < 1e-3,
            "{found:?}"
        );
        let distance = (0.1_f32 * 0.1 + 0.2 * 0.2 + 1.2 * 1.2).sqrt();
        assert!((found.distance_m - distance).abs() < 1e-4, "{found:?}");
    }

    #[test]
    fn places_that_are_passed_repeatedly_have_views_of_that_passage() {
        let contact = |strike_s: i64| FootContact {
            foot: Foot::Left,
            events: [0, 0, 1, 1].map(|later| ContactEvent {
                time_ns: (strike_s + later) * 1_000_000_000,
                sigma_s: 0.02,
                is_seen: true,
            }),
            world_from_foot: at(1.0, 0.0, 0.0),
            covariance: Covariance::zero(),
        };
        let contacts = [0, 100, 130, 300].map(contact);
        let config = ContactViewConfig::default();
        let index = ContactIndex::new(&contacts, contacts.iter().map(|_| [1.0, 0.0, 0.0]), &config);
        let near = |x: f64, s: f64| index.near([x, 0.0, 1.2], (1e9 * s) as i64);
        assert_eq!(near(0.0, 90.0), [1, 2]);
        assert_eq!(near(0.0, 61.0), [0, 1], "39 s before and 60 s after");
        assert_eq!(near(0.0, 130.5), [1], "the foot hides its place");
        assert_eq!(near(0.0, 200.0), [0; 0]);
        assert_eq!(near(40.0, 90.0), [0; 0], "far away");
    }

    #[test]
    fn what_is_outside_or_behind_something_is_not_visible() {
        assert!(seen(0.1, 0.2, 0.0).is_some());
        assert_eq!(seen(0.1, 0.2, 0.1), None, "behind a shoe");
        assert!(seen(0.1, 0.2, 0.01).is_some(), "within the noise");
        assert_eq!(seen(2.0, 0.0, 0.0), None, "outside");
        // Half of the outline behind something.
        let half = seen(0.1, 0.0, 0.1).map(|view| view.visible_share);
        assert!(half.is_none_or(|share| share < 1.0), "{half:?}");
    }
}
