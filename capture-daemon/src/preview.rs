//! The newest picture of each camera, for whoever wants to look.
//!
//! Contract: keeping a picture costs a reference to it, a few times a second; nothing is copied or
//! compressed for it here, and a reader who holds on to a picture holds up nobody.

use std::sync::{Mutex, PoisonError};

use session_archive::time::{HostTime, NS_PER_S};
use video::Picture;

/// How often a picture is kept, unless the machine is to be spared.
const PERIOD_NS: i64 = NS_PER_S / 4;
/// And then.
const SPARING_PERIOD_NS: i64 = 2 * NS_PER_S;

/// The newest pictures.
#[derive(Debug)]
pub struct Previews {
    cameras: Vec<Mutex<Kept>>,
}

#[derive(Debug, Default)]
struct Kept {
    picture: Option<Picture>,
    /// Counts the pictures that were kept.
    number: u64,
    next: Option<HostTime>,
}

impl Previews {
    /// For so many cameras, without a picture yet.
    pub fn new(cameras: usize) -> Self {
        let cameras = (0..cameras).map(|_| Mutex::default()).collect();
        Self { cameras }
    }

    /// Keeps a picture, if it is time for one.
    pub fn offer(&self, camera: usize, picture: &Picture, now: HostTime, sparing: bool) {
        // Whoever is looking at the old one may have it a little longer.
        let Some(Ok(mut kept)) = self.cameras.get(camera).map(Mutex::try_lock) else {
            return;
        };
        if kept.next.is_some_and(|next| now < next) {
            return;
        }
        let period = if sparing {
            SPARING_PERIOD_NS
        } else {
            PERIOD_NS
        };
        kept.next = Some(now + period);
        kept.number += 1;
        kept.picture = Some(picture.clone());
    }

    /// The newest picture of a camera and its number, which grows.
    pub fn newest(&self, camera: usize) -> Option<(u64, Picture)> {
        let kept = self.cameras.get(camera)?;
        let kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        Some((kept.number, kept.picture.clone()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(level: u8) -> Picture {
        let format = video::PixelFormat::I420;
        let data = vec![level; format.bytes(4, 2).expect("size")].into();
        Picture {
            width: 4,
            height: 2,
            format,
            data,
        }
    }

    #[test]
    fn keeps_a_few_pictures_a_second() {
        let previews = Previews::new(1);
        assert!(previews.newest(0).is_none());
        let kept = |at: i64, sparing| {
            let before = previews.newest(0).map_or(0, |(number, _)| number);
            previews.offer(0, &picture(at as u8), HostTime(at * 10_000_000), sparing);
            previews.newest(0).expect("a picture").0 > before
        };
        let times: Vec<i64> = (0..100).filter(|at| kept(*at, false)).collect();
        assert_eq!(times, [0, 25, 50, 75]);
        let times: Vec<i64> = (100..500).filter(|at| kept(*at, true)).collect();
        assert_eq!(times, [100, 300]);
        let (number, newest) = previews.newest(0).expect("a picture");
        assert_eq!((number, newest.data[0]), (6, 300_i64 as u8));
        previews.offer(7, &picture(0), HostTime(0), false);
        assert!(previews.newest(7).is_none());
    }
}
