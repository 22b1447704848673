//! Our methods: the search in the whole image, and the template fit.

use anyhow::{Context, Result};
use boards::Dictionary;
use cad_transforms::RigidTransform;
use fiducials::square::distance;
use fiducials::{Config, Fit, Motion, SearchConfig, Searcher, View, fit, poses_from_corners};
use imaging::ImageView;
use serde::Deserialize;

use super::scene::{Camera, EXPOSURE_S, Scene, corners_at, right_from_left, tag};
use crate::meter;

/// A tag that a method reports.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct TagEstimate {
    pub(super) id: u32,
    /// Corners of the black square in the left image, in the order of [`fiducials::Tag::corners`],
    /// px, pixel centers at integers.
    pub(super) corners: [[f64; 2]; 4],
    /// Takes points of the tag to the left eye, if the method gives a pose.
    #[serde(skip)]
    pub(super) left_from_tag: Option<RigidTransform>,
}

impl TagEstimate {
    /// Its corners, beginning with the one that makes them agree best with others:
    /// kornia-apriltag begins with the one at the top right of the image, whichever of the tag
    /// that is.
    pub(super) fn corners_in_order_of(&self, others: &[[f64; 2]; 4]) -> [[f64; 2]; 4] {
        let orders = [0, 1, 2, 3].map(|first| {
            let corners: [[f64; 2]; 4] = std::array::from_fn(|k| self.corners[(first + k) % 4]);
            let sum: f64 = (0..4).map(|k| distance(corners[k], others[k])).sum();
            (corners, sum)
        });
        let [first, rest @ ..] = orders;
        let best = rest
            .iter()
            .fold(first, |a, b| if b.1 < a.1 { *b } else { a });
        best.0
    }
}

/// What a method reports of an image, and its processor time on one thread.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Answer {
    pub(super) tags: Vec<TagEstimate>,
    pub(super) ms: f64,
}

/// A method and its answers, by image.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Answers {
    pub(super) name: String,
    pub(super) images: Vec<Answer>,
}

pub(super) const SEARCH: &str = "search";
pub(super) const SEARCH_AND_FIT: &str = "search, then fit";
pub(super) const FIT_BOTH: &str = "fit, both eyes";
pub(super) const FIT_LEFT: &str = "fit, left eye";

/// The searcher of the tracker.
pub(super) fn searcher() -> Searcher {
    Searcher::new(Dictionary::AprilTag36h11, &SearchConfig::default())
}

/// All tags in an image.
pub(super) fn search(searcher: &Searcher, image: &ImageView<'_>) -> Answer {
    let (found, ms) = timed(|| searcher.search(image));
    let tags = found.iter().map(|seen| TagEstimate {
        id: seen.id,
        corners: seen.corners,
        left_from_tag: None,
    });
    Answer {
        tags: tags.collect(),
        ms,
    }
}

/// Our methods on scenes.
pub(super) fn answers(
    camera: &Camera,
    scenes: &[Scene],
    images: &[[Vec<u8>; 2]],
) -> Result<Vec<Answers>> {
    let searcher = searcher();
    let names = [SEARCH, SEARCH_AND_FIT, FIT_BOTH, FIT_LEFT];
    let mut all = names.map(|name| Answers {
        name: name.to_owned(),
        images: Vec::new(),
    });
    for (scene, images) in scenes.iter().zip(images) {
        let views = Views::new(camera, scene, images)?;
        let searched = search(&searcher, &views.eyes[0].image);
        let (refined, ms) = timed(|| views.fit_at(&searched.tags));
        let refined = views.answer(refined, searched.ms + ms);
        let predicted = |eyes: usize| {
            let (found, ms) = timed(|| views.fit(eyes, &scene.start, &scene.predicted));
            views.answer(found, ms)
        };
        let answers = [searched, refined, predicted(2), predicted(1)];
        for (all, answer) in all.iter_mut().zip(answers) {
            all.images.push(answer);
        }
    }
    Ok(all.into())
}

/// Both eyes, and the tag that is tracked.
struct Views<'a> {
    camera: &'a Camera,
    eyes: [View<'a>; 2],
    tag: fiducials::Tag,
    config: Config,
}

impl<'a> Views<'a> {
    fn new(camera: &'a Camera, scene: &Scene, images: &'a [Vec<u8>; 2]) -> Result<Self> {
        let [width, height] = camera.size;
        let view = |pixels: &'a [u8], eye_from_reference| {
            Ok::<_, anyhow::Error>(View {
                image: ImageView::packed(width, height, pixels).context("an image")?,
                lens: &camera.lens,
                eye_from_reference,
                line_s: 0.0,
                exposure_s: EXPOSURE_S,
            })
        };
        Ok(Self {
            camera,
            eyes: [
                view(&images[0], RigidTransform::identity())?,
                view(&images[1], right_from_left()?)?,
            ],
            tag: tag(scene.id)?,
            config: Config::default(),
        })
    }

    fn fit(&self, eyes: usize, start: &RigidTransform, motion: &Motion) -> Option<Fit> {
        fit(&self.eyes[..eyes], &self.tag, start, motion, &self.config)
    }

    /// The tag where a search found it, as the tracker does: from both poses that its corners
    /// allow, without a prediction of its motion.
    fn fit_at(&self, tags: &[TagEstimate]) -> Option<Fit> {
        let own = tags.iter().find(|found| found.id == self.tag.id)?;
        let poses = poses_from_corners(&self.camera.lens, &self.tag, &own.corners)?;
        let fits = poses
            .iter()
            .filter_map(|pose| self.fit(2, pose, &Motion::default()));
        fits.min_by(|a, b| a.rms_levels.total_cmp(&b.rms_levels))
    }

    fn answer(&self, fit: Option<Fit>, ms: f64) -> Answer {
        let found = fit.and_then(|fit| {
            Some(TagEstimate {
                id: self.tag.id,
                corners: corners_at(self.camera, self.tag.id, &fit.reference_from_tag)?,
                left_from_tag: Some(fit.reference_from_tag),
            })
        });
        Answer {
            tags: found.into_iter().collect(),
            ms,
        }
    }
}

/// A result, and the processor time that it took, ms.
fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let begin = meter::thread_cpu_s();
    let result = work();
    (result, 1e3 * (meter::thread_cpu_s() - begin))
}
