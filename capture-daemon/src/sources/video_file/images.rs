//! The images of one file, each with its number, and its time or the reason why it is unusable.

use std::path::Path;

use video::RawImage;
use video::file::{FileError, FileFrame, VideoFile};

use super::error::VideoError;

/// Images of one file.
pub(super) struct EyeFile {
    pub(super) file: VideoFile,
    pub(super) times: Times,
    pub(super) ended: bool,
}

/// Numbers and times of one file's images.
pub(super) struct Times {
    /// Added to the container's times, ns.
    pub(super) later_ns: i64,
    pub(super) next: u64,
    pub(super) newest_ns: Option<i64>,
}

/// Next step of a file.
pub(super) enum Step {
    Image(Image),
    /// The number and the reason why there is no image.
    Bad(u64, &'static str),
    End,
}

pub(super) struct Image {
    pub(super) number: u64,
    pub(super) time_ns: i64,
    pub(super) image: RawImage,
}

impl EyeFile {
    pub(super) fn open(path: &Path, later_ns: i64) -> Result<Self, VideoError> {
        Ok(Self {
            file: VideoFile::open(path)?,
            times: Times::new(later_ns),
            ended: false,
        })
    }

    /// Time of the first image, ns.
    pub(super) fn first_ns(&self, path: &Path) -> Result<i64, VideoError> {
        self.times.first_ns(self.file.first_time_ns(), path)
    }

    pub(super) fn next(&mut self) -> Result<Step, FileError> {
        let Some(frame) = self.file.next()? else {
            self.ended = true;
            return Ok(Step::End);
        };
        Ok(self.times.classify(frame))
    }
}

impl Times {
    pub(super) fn new(later_ns: i64) -> Self {
        Self {
            later_ns,
            next: 0,
            newest_ns: None,
        }
    }

    /// Time of the first image, ns; `container_ns` is the time that the container states.
    pub(super) fn first_ns(
        &self,
        container_ns: Option<i64>,
        path: &Path,
    ) -> Result<i64, VideoError> {
        let first = container_ns.ok_or_else(|| VideoError::Times {
            path: path.to_owned(),
            found: "a first image without a time",
        })?;
        Ok(first.saturating_add(self.later_ns))
    }

    /// The next image, or the reason why it is unusable.
    pub(super) fn classify(&mut self, frame: FileFrame) -> Step {
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
            image: frame.image,
        })
    }
}
