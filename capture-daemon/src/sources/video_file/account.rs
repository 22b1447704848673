//! Frames, drops and notices of a replayed video, in the order of the left file's numbers.

use std::collections::VecDeque;

use session_archive::record::paws::gap::Cause;
use session_archive::time::HostTime;
use video::capture::Eye;
use video::raw_image::side_by_side;
use video::{RawImage, RawImageError};

use super::images::Image;
use crate::sources::pairing::{ImagePairer, PairingOutput, TimedImage, alone};
use crate::sources::{DevicePart, DroppedFrame, Notice, RawFrame, Sample};

/// Samples to be delivered, in the order of the left file's numbers.
pub(super) struct Account {
    pub(super) pairs: ImagePairer<(u64, RawImage)>,
    pub(super) start: HostTime,
    /// Time of the first frame, ns.
    pub(super) first_ns: i64,
    pub(super) newest_ns: i64,
    /// Unusable left images that wait for those before them.
    pub(super) bad: VecDeque<(u64, &'static str)>,
    pub(super) out: VecDeque<Sample>,
    pub(super) apart_ns: Vec<i64>,
    pub(super) without_left: u64,
    pub(super) bad_right: u64,
    /// By eye: the images available for pairing.
    pub(super) spans: [FileSpan; 2],
    /// Minimum time difference of a left and a right image, ns.
    pub(super) nearest_ns: Option<i64>,
    /// Largest pairing limit that this rate permits, ns.
    pub(super) max_within_ns: i64,
    /// Columns and rows, the same for all frames.
    pub(super) size: (u32, u32),
}

/// The images of one file with a time.
#[derive(Clone, Copy, Default)]
pub(super) struct FileSpan {
    pub(super) count: u64,
    pub(super) first_ns: i64,
    pub(super) newest_ns: i64,
}

impl FileSpan {
    pub(super) fn add(&mut self, time_ns: i64) {
        if self.count == 0 {
            self.first_ns = time_ns;
        }
        self.count += 1;
        self.newest_ns = time_ns;
    }

    /// As `60 at 15.00 Hz from 0.030 s to 3.963 s`.
    pub(super) fn text(&self) -> String {
        let s = |ns: i64| ns as f64 * 1e-9;
        match self.count {
            0 => "none".to_owned(),
            1 => format!("1 at {:.3} s", s(self.first_ns)),
            count => {
                let span_s = s(self.newest_ns.saturating_sub(self.first_ns));
                format!(
                    "{count} at {:.2} Hz from {:.3} s to {:.3} s",
                    (count - 1) as f64 / span_s,
                    s(self.first_ns),
                    s(self.newest_ns)
                )
            }
        }
    }
}

impl Account {
    pub(super) fn new(
        within_ns: i64,
        max_within_ns: i64,
        start: HostTime,
        first_ns: i64,
        size: (u32, u32),
    ) -> Self {
        Self {
            pairs: ImagePairer::new(within_ns),
            start,
            first_ns,
            newest_ns: first_ns,
            bad: VecDeque::new(),
            out: VecDeque::new(),
            apart_ns: Vec::new(),
            without_left: 0,
            bad_right: 0,
            spans: [FileSpan::default(); 2],
            nearest_ns: None,
            max_within_ns,
            size,
        }
    }

    pub(super) fn single(&mut self, image: Image) {
        let Image {
            number,
            time_ns,
            image,
        } = image;
        self.frame(number, time_ns, None, Ok(image));
    }

    pub(super) fn push(&mut self, eye: Eye, image: Image) {
        let [own, other] = match eye {
            Eye::Left => [0, 1],
            Eye::Right => [1, 0],
        };
        self.spans[own].add(image.time_ns);
        // The lagging file is read, so the newest image of the other one is nearest to this one.
        if self.spans[other].count > 0 {
            let apart_ns = image.time_ns.saturating_sub(self.spans[other].newest_ns);
            let apart_ns = apart_ns.saturating_abs();
            self.nearest_ns = Some(self.nearest_ns.map_or(apart_ns, |n| n.min(apart_ns)));
        }
        let image = TimedImage {
            time_ns: image.time_ns,
            of: (image.number, image.image),
        };
        let mut paired = Vec::new();
        self.pairs.push(eye, image, |one| paired.push(one));
        paired.into_iter().for_each(|one| self.paired(one));
    }

    pub(super) fn paired(&mut self, paired: PairingOutput<(u64, RawImage)>) {
        match paired {
            PairingOutput::Both(left, right) => {
                let apart_ns = right.time_ns - left.time_ns;
                self.apart_ns.push(apart_ns);
                let (number, image) = left.of;
                let joined = side_by_side(&image, &right.of.1);
                self.frame(number, left.time_ns, Some(apart_ns), joined);
            }
            PairingOutput::Unpaired(Eye::Left, left) => {
                self.newest_ns = left.time_ns;
                let why = alone(Eye::Left, self.pairs.within_ns());
                self.lost(left.of.0, why);
            }
            PairingOutput::Unpaired(Eye::Right, _) => self.without_left += 1,
        }
    }

    pub(super) fn frame(
        &mut self,
        number: u64,
        time_ns: i64,
        eyes_apart_ns: Option<i64>,
        image: Result<RawImage, RawImageError>,
    ) {
        self.newest_ns = time_ns;
        match image {
            Ok(image) if (image.width, image.height) != self.size => {
                let why = format!(
                    "it is {}x{}, expected {}x{} like the first one",
                    image.width, image.height, self.size.0, self.size.1
                );
                self.lost(number, why);
            }
            Ok(image) => {
                self.bad_before(number);
                self.out.push_back(Sample::Frame(RawFrame {
                    number,
                    device_ticks: time_ns,
                    kernel_time: None,
                    host_time: self.now(),
                    exposure_ns: None,
                    eyes_apart_ns,
                    image,
                }));
            }
            Err(error) => self.lost(number, error.to_string()),
        }
    }

    pub(super) fn lost(&mut self, number: u64, detail: String) {
        self.bad_before(number);
        self.out.push_back(Sample::Dropped(DroppedFrame {
            number,
            host_time: self.now(),
            cause: Cause::Device,
            detail,
        }));
    }

    /// Reports unusable images before `number` as dropped.
    pub(super) fn bad_before(&mut self, number: u64) {
        while let Some((bad, why)) = self.bad.pop_front_if(|(bad, _)| *bad < number) {
            self.out.push_back(Sample::Dropped(DroppedFrame {
                number: bad,
                host_time: self.now(),
                cause: Cause::Device,
                detail: why.to_owned(),
            }));
        }
    }

    /// Arrival of the newest image.
    pub(super) fn now(&self) -> HostTime {
        self.start + self.newest_ns.saturating_sub(self.first_ns).max(0)
    }

    pub(super) fn finish(&mut self, two_eyes: bool) {
        let mut paired = Vec::new();
        self.pairs.finish(|one| paired.push(one));
        paired.into_iter().for_each(|one| self.paired(one));
        self.bad_before(u64::MAX);
        if !two_eyes {
            return;
        }
        self.apart_ns.sort_unstable();
        let ms = |ns: i64| ns as f64 * 1e-6;
        let middle = self.apart_ns.get(self.apart_ns.len() / 2).copied();
        let max_abs = self.apart_ns.iter().map(|apart| apart.abs()).max();
        if let (Some(middle), Some(max_abs)) = (middle, max_abs) {
            self.notice(format!(
                "left and right images are paired by their times: right ones are {:.3} ms later in the median, at most \
                 {:.3} ms apart",
                ms(middle),
                ms(max_abs)
            ));
        }
        if self.without_left + self.bad_right > 0 {
            self.notice(format!(
                "of the right images {} have no left one within {:.1} ms, and {} have no usable time or are damaged",
                self.without_left,
                ms(self.pairs.within_ns()),
                self.bad_right
            ));
        }
    }

    /// Problem of two files without any pair, with a remedy.
    pub(super) fn never_paired(&self) -> Option<String> {
        if !self.apart_ns.is_empty() {
            return None;
        }
        let ms = |ns: i64| ns as f64 * 1e-6;
        let (within_ns, max_ns) = (self.pairs.within_ns(), self.max_within_ns);
        let nearest = self
            .nearest_ns
            .map(|nearest_ns| format!("; the nearest two are {:.1} ms apart", ms(nearest_ns)));
        let nearest = nearest.unwrap_or_default();
        let more = match within_ns < max_ns {
            true => format!(
                "allow more with pair_within_ms (up to {:.1} at this rate), ",
                ms(max_ns)
            ),
            false => String::new(),
        };
        let [left, right] = self.spans.map(|span| span.text());
        Some(format!(
            "no image of the right file was taken within {:.1} ms of one of the left file{nearest} (left images: {left}; \
             right images: {right}); {more}say by right_later_ms how much later the right file began, or name two files of \
             one recording as path and right_path",
            ms(within_ns)
        ))
    }

    pub(super) fn notice(&mut self, text: String) {
        self.out.push_back(Sample::Notice(Notice {
            host_time: self.now(),
            part: DevicePart::Camera,
            text,
        }));
    }
}
