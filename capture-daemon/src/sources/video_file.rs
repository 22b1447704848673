//! Replay of video files: both eyes side by side in one, or one file for each eye.
//!
//! Contract: frames carry the container's own times as device time, and the first one arrives at
//! the start; a file has no IMU and no date of recording. Images count from 0 in each file: images
//! lost by a camera before the file was written are unknown. Two files are paired by time alone
//! (`pairing`), each time counted from the beginning of its own file; the delay of the right file's
//! beginning is a setting.
//!
//! *Early*: files that cannot be decoded, whose first image has no time, or that differ in size or
//! rate are rejected before anything is recorded. *At a gap*: an image without a time, with a time
//! that does not increase, reported as damaged by its decoder, of another size than the first one
//! or (on the left) without a partner keeps its number and is dropped with the reason; right images
//! without a partner are counted in a notice at the end. *At the end* of one file the other's
//! images are unpaired. *Two files without any pair* when both have ended are unusable: the error
//! contains the times of their images and a remedy. *On failure* in the middle the source is
//! unusable.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};

use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, TickLength};
use video::capture::Eye;
use video::file::{FileError, FileFrame, VideoFile};
use video::picture::side_by_side;
use video::{Picture, PictureError};

use super::pairing::{ImagePairer, Paired, TimedImage, alone, limit_ns};
use super::{
    CameraInfo, DevicePart, DroppedFrame, Notice, RawFrame, Sample, Source, SourceError, SourceInfo,
};
use crate::config::VideoConfig;
use crate::error_chain::with_causes;
use crate::run::identity::Digest;

/// Maximum relative difference of the rates of two files. With more they are from different kinds
/// of cameras.
const MAX_RATE_DIFFERENCE: f64 = 0.01;

/// Error of replaying a video file. A retry will not help.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// It cannot be opened or decoded.
    #[error(transparent)]
    File(#[from] FileError),
    /// There are no usable times: write the file with times, for example as MKV or MP4.
    #[error("replaying a video file: found {found}, expected a time for every image: {}", path.display())]
    Times {
        /// The file.
        path: PathBuf,
        /// Content found instead.
        found: &'static str,
    },
    /// The two files are not from one pair of cameras.
    #[error("replaying two video files: found {found}, expected the same of both: {} and {}", left.display(), right.display())]
    Differ {
        /// The difference.
        found: String,
        /// File of the left eye.
        left: PathBuf,
        /// File of the right eye.
        right: PathBuf,
    },
    /// The width is not possible for a stereo image.
    #[error("replaying a video file: found images that are {width} wide, expected {expected}: {}", path.display())]
    Width {
        /// The file.
        path: PathBuf,
        /// Columns found.
        width: u32,
        /// Possible widths.
        expected: &'static str,
    },
    /// A setting does not match the file.
    #[error("replaying a video file: {what}: {}", path.display())]
    Setting {
        /// The file.
        path: PathBuf,
        /// What was found and what was expected.
        what: String,
    },
}

/// Video files as a source. See the module for the contract.
pub struct VideoReplay {
    name: String,
    info: SourceInfo,
    left: EyeFile,
    right: Option<EyeFile>,
    account: Account,
    ended: bool,
    config: VideoConfig,
}

/// Images of one file.
struct EyeFile {
    file: VideoFile,
    times: Times,
    ended: bool,
}

/// Numbers and times of one file's images.
struct Times {
    /// Added to the container's times, ns.
    later_ns: i64,
    next: u64,
    newest_ns: Option<i64>,
}

/// Next step of a file.
enum Step {
    Image(Image),
    /// The number and the reason why there is no image.
    Bad(u64, &'static str),
    End,
}

struct Image {
    number: u64,
    time_ns: i64,
    image: Picture,
}

/// Samples to be delivered, in the order of the left file's numbers.
struct Account {
    pairs: ImagePairer<(u64, Picture)>,
    start: HostTime,
    /// Time of the first frame, ns.
    first_ns: i64,
    newest_ns: i64,
    /// Unusable left images that wait for those before them.
    bad: VecDeque<(u64, &'static str)>,
    out: VecDeque<Sample>,
    apart_ns: Vec<i64>,
    without_left: u64,
    bad_right: u64,
    /// By eye: the images available for pairing.
    spans: [FileSpan; 2],
    /// Minimum time difference of a left and a right image, ns.
    nearest_ns: Option<i64>,
    /// Largest pairing limit that this rate permits, ns.
    max_within_ns: i64,
    /// Columns and rows, the same for all frames.
    size: (u32, u32),
}

/// The images of one file with a time.
#[derive(Clone, Copy, Default)]
struct FileSpan {
    count: u64,
    first_ns: i64,
    newest_ns: i64,
}

impl VideoReplay {
    /// Opens the files as camera `name`, the first frame to arrive at `start`.
    ///
    /// # Errors
    /// [`VideoError`], naming the file.
    pub fn open(name: &str, config: &VideoConfig, start: HostTime) -> Result<Self, VideoError> {
        let left = EyeFile::open(&config.path, 0)?;
        let right = config.right_path.as_ref();
        let right = right.map(|path| EyeFile::open(path, config.right_later_ns));
        let right = right.transpose()?;
        let of = left.file.info();
        let rate_hz = of.rate_hz.ok_or_else(|| VideoError::Times {
            path: config.path.clone(),
            found: "neither a rate nor times that rise",
        })?;
        if let (Some(right), Some(path)) = (&right, &config.right_path) {
            check_alike(&left, &right.file.info().clone(), &config.path, path)?;
        }
        let eyes = 1 + u32::from(right.is_some());
        let width = of.width * eyes;
        if !width.is_multiple_of(4) {
            return Err(VideoError::Width {
                path: config.path.clone(),
                width: of.width,
                expected: match eyes {
                    1 => {
                        "a multiple of four, for both eyes side by side (or right_path for the other eye)"
                    }
                    _ => "an even number for each eye",
                },
            });
        }
        let limit = |configured_ns| {
            limit_ns(rate_hz, configured_ns).map_err(|what| VideoError::Setting {
                path: config.path.clone(),
                what,
            })
        };
        let within_ns = limit(config.pair_within_ns)?;
        let max_within_ns = limit(None)?;
        let first_ns = left.first_ns(&config.path)?;
        if let (Some(right), Some(path)) = (&right, &config.right_path) {
            right.first_ns(path)?;
        }
        let size = (width, of.height);
        let colour = of.colour || right.as_ref().is_some_and(|r| r.file.info().colour);
        let info = SourceInfo {
            description: describe(config),
            camera: CameraInfo {
                width,
                height: size.1,
                rate_hz,
                tick: TickLength::NANOSECOND,
                tick_bits: None,
                number_bits: None,
                colour,
                still: false,
                stamped: None,
            },
            imu: None,
            calibration_files: Vec::new(),
        };
        Ok(Self {
            name: name.to_owned(),
            info,
            left,
            right,
            account: Account::new(within_ns, max_within_ns, start, first_ns, size),
            ended: false,
            config: config.clone(),
        })
    }

    /// Takes the next image of the file that lags, or of the only one.
    fn step(&mut self) -> Result<(), FileError> {
        let Some(right) = &mut self.right else {
            match self.left.next()? {
                Step::Image(image) => self.account.single(image),
                Step::Bad(number, why) => self.account.bad.push_back((number, why)),
                Step::End => self.ended = true,
            }
            return Ok(());
        };
        let behind = |eye: &EyeFile| (eye.ended, eye.times.newest_ns);
        if behind(&self.left) <= behind(right) {
            match self.left.next()? {
                Step::Image(image) => self.account.push(Eye::Left, image),
                Step::Bad(number, why) => self.account.bad.push_back((number, why)),
                Step::End => {}
            }
        } else {
            match right.next()? {
                Step::Image(image) => self.account.push(Eye::Right, image),
                Step::Bad(..) => self.account.bad_right += 1,
                Step::End => {}
            }
        }
        self.ended = self.left.ended && right.ended;
        Ok(())
    }
}

impl Source for VideoReplay {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn digest(&self) -> Vec<u8> {
        digest_of(&self.config)
    }

    fn next_sample(&mut self) -> Result<Option<Sample>, SourceError> {
        loop {
            if let Some(sample) = self.account.out.pop_front() {
                return Ok(Some(sample));
            }
            if self.ended {
                return match (&self.right, self.account.never_paired()) {
                    (Some(_), Some(what)) => Err(SourceError::Unusable {
                        source_name: self.name.clone(),
                        what,
                    }),
                    _ => Ok(None),
                };
            }
            self.step().map_err(|error| SourceError::Unusable {
                source_name: self.name.clone(),
                what: with_causes(&error),
            })?;
            if self.ended {
                self.account.finish(self.right.is_some());
            }
        }
    }

    fn begin_at(&mut self, start: HostTime) {
        self.account.start = start;
    }
}

impl EyeFile {
    fn open(path: &Path, later_ns: i64) -> Result<Self, VideoError> {
        Ok(Self {
            file: VideoFile::open(path)?,
            times: Times::new(later_ns),
            ended: false,
        })
    }

    /// Time of the first image, ns.
    fn first_ns(&self, path: &Path) -> Result<i64, VideoError> {
        self.times.first_ns(self.file.first_time_ns(), path)
    }

    fn next(&mut self) -> Result<Step, FileError> {
        let Some(frame) = self.file.next()? else {
            self.ended = true;
            return Ok(Step::End);
        };
        Ok(self.times.classify(frame))
    }
}

impl Times {
    fn new(later_ns: i64) -> Self {
        Self {
            later_ns,
            next: 0,
            newest_ns: None,
        }
    }

    /// Time of the first image, ns; `container_ns` is the time that the container states.
    fn first_ns(&self, container_ns: Option<i64>, path: &Path) -> Result<i64, VideoError> {
        let first = container_ns.ok_or_else(|| VideoError::Times {
            path: path.to_owned(),
            found: "a first image without a time",
        })?;
        Ok(first.saturating_add(self.later_ns))
    }

    /// The next image, or the reason why it is unusable.
    fn classify(&mut self, frame: FileFrame) -> Step {
        let number = self.next;
        self.next += 1;
        if frame.damaged {
            return Step::Bad(number, "its decoder says that the image is damaged");
        }
        let Some(time_ns) = frame.time_ns else {
            return Step::Bad(number, "the container gives no time for the image");
        };
        let time_ns = time_ns.saturating_add(self.later_ns);
        if self.newest_ns.is_some_and(|newest| time_ns <= newest) {
            return Step::Bad(number, "its time is not after that of the one before");
        }
        self.newest_ns = Some(time_ns);
        Step::Image(Image {
            number,
            time_ns,
            image: frame.picture,
        })
    }
}

impl FileSpan {
    fn add(&mut self, time_ns: i64) {
        if self.count == 0 {
            self.first_ns = time_ns;
        }
        self.count += 1;
        self.newest_ns = time_ns;
    }

    /// As `60 at 15.00 Hz from 0.030 s to 3.963 s`.
    fn text(&self) -> String {
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
    fn new(
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

    fn single(&mut self, image: Image) {
        let Image {
            number,
            time_ns,
            image,
        } = image;
        self.frame(number, time_ns, None, Ok(image));
    }

    fn push(&mut self, eye: Eye, image: Image) {
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

    fn paired(&mut self, paired: Paired<(u64, Picture)>) {
        match paired {
            Paired::Both(left, right) => {
                let apart_ns = right.time_ns - left.time_ns;
                self.apart_ns.push(apart_ns);
                let (number, image) = left.of;
                let joined = side_by_side(&image, &right.of.1);
                self.frame(number, left.time_ns, Some(apart_ns), joined);
            }
            Paired::Unpaired(Eye::Left, left) => {
                self.newest_ns = left.time_ns;
                let why = alone(Eye::Left, self.pairs.within_ns());
                self.lost(left.of.0, why);
            }
            Paired::Unpaired(Eye::Right, _) => self.without_left += 1,
        }
    }

    fn frame(
        &mut self,
        number: u64,
        time_ns: i64,
        eyes_apart_ns: Option<i64>,
        image: Result<Picture, PictureError>,
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

    fn lost(&mut self, number: u64, detail: String) {
        self.bad_before(number);
        self.out.push_back(Sample::Dropped(DroppedFrame {
            number,
            host_time: self.now(),
            cause: Cause::Device,
            detail,
        }));
    }

    /// Reports unusable images before `number` as dropped.
    fn bad_before(&mut self, number: u64) {
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
    fn now(&self) -> HostTime {
        self.start + self.newest_ns.saturating_sub(self.first_ns).max(0)
    }

    fn finish(&mut self, two_eyes: bool) {
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
    fn never_paired(&self) -> Option<String> {
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

    fn notice(&mut self, text: String) {
        self.out.push_back(Sample::Notice(Notice {
            host_time: self.now(),
            part: DevicePart::Camera,
            text,
        }));
    }
}

/// Rejects two files that cannot be a pair.
fn check_alike(
    left: &EyeFile,
    right: &video::file::FileInfo,
    left_path: &Path,
    right_path: &Path,
) -> Result<(), VideoError> {
    let left = left.file.info();
    let differ = |found: String| {
        Err(VideoError::Differ {
            found,
            left: left_path.to_owned(),
            right: right_path.to_owned(),
        })
    };
    if (left.width, left.height) != (right.width, right.height) {
        return differ(format!(
            "{}x{} and {}x{}",
            left.width, left.height, right.width, right.height
        ));
    }
    if let (Some(a), Some(b)) = (left.rate_hz, right.rate_hz)
        && (a / b - 1.0).abs() > MAX_RATE_DIFFERENCE
    {
        return differ(format!("{a:.2} Hz and {b:.2} Hz"));
    }
    Ok(())
}

fn digest_of(config: &VideoConfig) -> Vec<u8> {
    let mut digest = Digest::new("video");
    digest.value(&(config.right_later_ns, config.pair_within_ns));
    let files = [Some(&config.path), config.right_path.as_ref()];
    for file in files.into_iter().flatten() {
        digest.file(file);
    }
    digest.finish().to_vec()
}

fn describe(config: &VideoConfig) -> String {
    let name = |path: &Path| {
        let name = path.file_name().unwrap_or_default();
        name.display().to_string()
    };
    match &config.right_path {
        Some(right) => format!("video files {} and {}", name(&config.path), name(right)),
        None => format!("video file {}", name(&config.path)),
    }
}

#[cfg(test)]
mod tests {
    use video::PixelFormat;

    use super::*;

    fn account(within_ns: i64) -> Account {
        Account::new(within_ns, 40, HostTime(1_000), 50, (2, 2))
    }

    fn image(number: u64, time_ns: i64) -> Image {
        image_of(number, time_ns, 2)
    }

    fn image_of(number: u64, time_ns: i64, height: u32) -> Image {
        let data = vec![number as u8; 3 * height as usize];
        let image = Picture::new(2, height, PixelFormat::I420, data);
        Image {
            number,
            time_ns,
            image: image.expect("an image"),
        }
    }

    /// Output: number, arrival, and the time difference of the eyes or the reason.
    fn outputs(account: &Account) -> Vec<String> {
        let outputs = |sample: &Sample| match sample {
            Sample::Frame(f) => format!("{} {} {:?}", f.number, f.host_time.0, f.eyes_apart_ns),
            Sample::Dropped(l) => format!("{} {} {}", l.number, l.host_time.0, l.detail),
            Sample::Notice(n) => n.text.clone(),
            other => panic!("{other:?}"),
        };
        account.out.iter().map(outputs).collect()
    }

    #[test]
    fn unusable_image_is_dropped_at_its_number() {
        let mut account = account(40);
        account.bad.push_back((0, "no time"));
        account.single(image(1, 50));
        account.bad.push_back((2, "damaged"));
        account.single(image(3, 250));
        account.bad.push_back((4, "no time"));
        account.finish(false);
        assert_eq!(
            outputs(&account),
            [
                "0 1000 no time",
                "1 1000 None",
                "2 1200 damaged",
                "3 1200 None",
                "4 1200 no time"
            ]
        );
    }

    /// The encoder could not take it, and the recording would end with it.
    #[test]
    fn image_of_another_size_is_dropped_alone() {
        let mut account = account(40);
        account.single(image(0, 50));
        account.single(image_of(1, 150, 4));
        account.single(image(2, 250));
        account.finish(false);
        assert_eq!(
            outputs(&account),
            [
                "0 1000 None",
                "1 1100 it is 2x4, expected 2x2 like the first one",
                "2 1200 None"
            ]
        );
    }

    #[test]
    fn two_files_are_paired_by_time() {
        let mut account = account(40);
        account.size = (4, 2);
        for n in 0..3 {
            let time = 50 + 100 * n as i64;
            account.push(Eye::Left, image(n, time));
            // The second right image is too late for its left one.
            let later = if n == 1 { 45 } else { -10 };
            account.push(Eye::Right, image(n, time + later));
        }
        account.finish(true);
        let found = outputs(&account);
        assert_eq!(found[0], "0 1000 Some(-10)");
        assert!(
            found[1].starts_with("1 1100 no right image was taken within"),
            "{found:?}"
        );
        assert_eq!(found[2], "2 1200 Some(-10)");
        assert!(found[3].contains("at most 0.000 ms apart"), "{found:?}");
        assert!(
            found[4].starts_with("of the right images 1 have no left one"),
            "{found:?}"
        );
    }

    #[test]
    fn files_without_pairs_report_their_time_spans_and_a_remedy() {
        const MS: i64 = 1_000_000;
        let account = |within_ns: i64, later_ns: i64| {
            let max_ns = 40 * MS;
            let mut account = Account::new(within_ns, max_ns, HostTime(0), 0, (2, 2));
            for n in 0..5 {
                account.push(Eye::Left, image(n, n as i64 * 100 * MS));
                account.push(Eye::Right, image(n, n as i64 * 100 * MS + later_ns));
            }
            account.finish(true);
            account.never_paired()
        };
        assert_eq!(account(40 * MS, 30 * MS), None);
        let text = account(40 * MS, 45 * MS).expect("no pair");
        for part in [
            "no image of the right file was taken within 40.0 ms of one of the left file; the nearest two are 45.0 ms apart",
            "(left images: 5 at 10.00 Hz from 0.000 s to 0.400 s; right images: 5 at 10.00 Hz from 0.045 s to 0.445 s)",
            "say by right_later_ms how much later the right file began",
        ] {
            assert!(text.contains(part), "{text}");
        }
        // No larger limit is possible.
        assert!(!text.contains("pair_within_ms"), "{text}");
        let text = account(2 * MS, 30 * MS).expect("no pair");
        let more = "allow more with pair_within_ms (up to 40.0 at this rate)";
        assert!(text.contains(more), "{text}");
    }

    #[test]
    fn unusable_right_file_pairs_with_nothing() {
        let mut account = account(40);
        account.push(Eye::Left, image(0, 50));
        account.bad_right += 1;
        account.finish(true);
        let text = account.never_paired().expect("no pair");
        assert!(text.contains("right images: none)"), "{text}");
    }

    #[test]
    fn image_without_usable_time_keeps_its_number_and_reports_the_reason() {
        let frame = |time_ns, damaged| FileFrame {
            time_ns,
            damaged,
            picture: image(0, 0).image,
        };
        let mut times = Times::new(7);
        let mut classify = |time_ns, damaged| match times.classify(frame(time_ns, damaged)) {
            Step::Image(image) => format!("{} {}", image.number, image.time_ns),
            Step::Bad(number, why) => format!("{number} {why}"),
            Step::End => "end".to_owned(),
        };
        assert_eq!(classify(Some(0), false), "0 7");
        let untimed = "the container gives no time for the image";
        assert_eq!(classify(None, false), format!("1 {untimed}"));
        let falling = "its time is not after that of the one before";
        assert_eq!(classify(Some(0), false), format!("2 {falling}"));
        assert_eq!(classify(Some(-100), false), format!("3 {falling}"));
        let damaged = "its decoder says that the image is damaged";
        assert_eq!(classify(Some(100), true), format!("4 {damaged}"));
        assert_eq!(classify(Some(100), false), "5 107");
    }

    #[test]
    fn file_without_times_is_rejected() {
        let folder = tempfile::tempdir().expect("folder");
        // JPEG files one after another, as some cameras write them: no rate, and a time for the
        // first image only.
        let mut bytes = Vec::new();
        for grey in [40, 80, 120] {
            jpeg_encoder::Encoder::new(&mut bytes, 90)
                .encode(&[grey; 64 * 48], 64, 48, jpeg_encoder::ColorType::Luma)
                .expect("encoding");
        }
        let path = folder.path().join("walk.mjpeg");
        std::fs::write(&path, bytes).expect("a file");
        let config = VideoConfig {
            path: path.clone(),
            right_path: None,
            right_later_ns: 0,
            pair_within_ns: None,
        };
        let opened = VideoReplay::open("feet", &config, HostTime(0));
        let error = opened.err().expect("an error");
        assert!(matches!(error, VideoError::Times { .. }), "{error}");
        let text = error.to_string();
        assert!(
            text.contains(
                "found neither a rate nor times that rise, expected a time for every image"
            ) && text.ends_with("walk.mjpeg"),
            "{text}"
        );

        let times = Times::new(3);
        assert_eq!(times.first_ns(Some(4), &path).expect("a time"), 7);
        let error = times.first_ns(None, &path).expect_err("no time");
        let text = error.to_string();
        assert!(
            text.contains("found a first image without a time"),
            "{text}"
        );
    }

    #[test]
    fn digest_differs_for_other_files_or_settings() {
        let folder = tempfile::tempdir().expect("folder");
        let (left, right) = (folder.path().join("l.mp4"), folder.path().join("r.mp4"));
        std::fs::write(&left, b"left").expect("a file");
        std::fs::write(&right, b"right").expect("a file");
        let of = |right_path: Option<&PathBuf>, right_later_ns| {
            digest_of(&VideoConfig {
                path: left.clone(),
                right_path: right_path.cloned(),
                right_later_ns,
                pair_within_ns: None,
            })
        };
        let digests = || [of(None, 0), of(Some(&right), 0), of(Some(&right), 1)];
        let before = digests();
        assert_ne!(before[0], before[1]);
        assert_ne!(before[1], before[2]);
        std::fs::write(&right, b"RIGHT").expect("a file");
        let after = digests();
        assert_eq!(after[0], before[0]);
        assert_ne!(after[1], before[1]);
    }

    #[test]
    fn non_video_file_is_rejected() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("walk.mp4");
        std::fs::write(&path, b"not a video").expect("a file");
        let open = |path: &Path| {
            let config = VideoConfig {
                path: path.to_owned(),
                right_path: None,
                right_later_ns: 0,
                pair_within_ns: None,
            };
            let opened = VideoReplay::open("feet", &config, HostTime(0));
            opened.err().expect("an error").to_string()
        };
        let error = open(&path);
        assert!(
            error.starts_with("reading a video file: ") && error.ends_with("walk.mp4"),
            "{error}"
        );
        let error = open(Path::new("/dev/null"));
        assert!(
            error.contains("found a character device, expected a regular file"),
            "{error}"
        );
        let error = open(&folder.path().join("none.mp4"));
        assert!(error.starts_with("opening a video file: "), "{error}");
    }
}
