//! Captures from a chain of GStreamer elements and reports what arrived: rate, loss, and the
//! quality of the times.
//!
//! `cargo run -p video --example capture CHAIN WIDTH HEIGHT RATE SECONDS [ENCODER]`
//!
//! With the name of an encoder, frames stay in their own buffers and are encoded from there, with
//! a preview beside. From v4l2src, every frame is held against the driver's own sequence number and
//! time stamp, which the element writes to its log (GStreamer 1.22).

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use gstreamer as gst;
use video::capture::{Capture, CaptureEvent, CaptureSettings, Content, Delivery};
use video::preview::{Preview, PreviewSettings};
use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings};

/// Reports of the driver: sequence number to time stamp, ns.
type Driver = Arc<Mutex<BTreeMap<u64, i64>>>;

#[expect(clippy::disallowed_methods, reason = "this is the clock")]
fn now() -> i64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [chain, width, height, rate, seconds, encoder @ ..] = &arguments[..] else {
        eprintln!("expected CHAIN WIDTH HEIGHT RATE SECONDS [ENCODER]");
        std::process::exit(2);
    };
    let (width, height) = (width.parse().unwrap(), height.parse().unwrap());
    let (rate, seconds): (f64, i64) = (rate.parse().unwrap(), seconds.parse().unwrap());
    video::init().unwrap();
    let driver = listen();
    let settings = CaptureSettings {
        delivery: match encoder.first() {
            Some(_) => Delivery::Native,
            None => Delivery::Images,
        },
        ..CaptureSettings::new(chain, width, height, rate)
    };
    let mut way = encoder.first().map(|element| Way::new(element, rate));
    let mut capture = Capture::start(&settings, Arc::new(now)).unwrap();
    println!("{}: {:?}", capture.element(), capture.policy());
    let end = now() + seconds * 1_000_000_000;
    let mut frames = Vec::new();
    while now() < end {
        match capture.next(Duration::from_secs(1)) {
            None => println!("nothing for 1 s"),
            Some(CaptureEvent::Lost(lost)) => println!("{lost:?}"),
            Some(CaptureEvent::Frame(frame)) => {
                frames.push((frame.number, frame.clock_time_ns, frame.host_time_ns));
                if let (Some(way), Content::Native(native)) = (&mut way, &frame.content) {
                    way.push(frame.clock_time_ns, native, width, height);
                }
            }
            Some(end) => {
                println!("{end:?}");
                break;
            }
        }
    }
    println!("{:?}", capture.counts());
    drop(capture);
    report(&frames);
    against(&driver.lock().unwrap(), &frames);
    if let Some(way) = way {
        way.finish();
    }
}

/// The encoder and the preview, started with the first frame.
struct Way {
    element: String,
    rate: f64,
    running: Option<(Encoder, Preview)>,
    units: Arc<Mutex<Vec<AccessUnit>>>,
    given: Vec<i64>,
    full: u64,
    previews: u64,
    most_bytes: usize,
}

impl Way {
    fn new(element: &str, rate: f64) -> Way {
        Way {
            element: element.to_owned(),
            rate,
            running: None,
            units: Arc::default(),
            given: Vec::new(),
            full: 0,
            previews: 0,
            most_bytes: 0,
        }
    }

    fn push(&mut self, time: i64, frame: &video::NativeFrame, width: u32, height: u32) {
        let (encoder, preview) = self.running.get_or_insert_with(|| {
            println!("native frames: {}", frame.format());
            let settings = EncoderSettings {
                element: self.element.clone(),
                width,
                height,
                rate_hz: self.rate,
                quality_db: 42.0,
                threads: 1,
                max_key_interval_frames: 300,
                preset: video::encoder::Preset::default(),
            };
            let units = self.units.clone();
            let on_output = move |event| match event {
                EncoderEvent::AccessUnit(unit) => units.lock().unwrap().push(unit),
                EncoderEvent::Failed(reason) => println!("encoder: {reason}"),
            };
            let preview = PreviewSettings {
                width: width / 4 / 2 * 2,
                height: height / 4 / 2 * 2,
                rate_hz: 4.0,
                quality: 70,
            };
            (
                Encoder::start_native(&settings, frame.format(), Box::new(on_output)).unwrap(),
                Preview::start(&preview, frame.format()).unwrap(),
            )
        });
        preview.offer(time, frame);
        self.previews += u64::from(preview.take().is_some());
        match encoder.try_push(time, frame, self.given.len().is_multiple_of(30)) {
            Ok(()) => self.given.push(time),
            Err(video::EncodeError::Full { .. }) => self.full += 1,
            Err(error) => println!("{error}"),
        }
        self.most_bytes = self.most_bytes.max(encoder.queued_bytes());
    }

    fn finish(self) {
        let Some((encoder, preview)) = self.running else {
            return;
        };
        encoder.finish(Duration::from_secs(20)).unwrap();
        let units = self.units.lock().unwrap();
        let times: Vec<i64> = units.iter().map(|unit| unit.pts_ns).collect();
        println!(
            "{}: {} frames in, {} access units out, times {}, {} refused as too many, at most {} \
             bytes inside, {} previews, preview failure {:?}",
            self.element,
            self.given.len(),
            units.len(),
            if times == self.given {
                "exact"
            } else {
                "WRONG"
            },
            self.full,
            self.most_bytes,
            self.previews,
            preview.failure()
        );
    }
}

fn spread(name: &str, mut values: Vec<i64>) {
    values.sort_unstable();
    if let (Some(first), Some(last)) = (values.first(), values.last()) {
        let at = |share: usize| values[(values.len() - 1) * share / 100];
        println!(
            "{name}: least {first}, 5 % {}, median {}, 95 % {}, most {last} ns ({} values)",
            at(5),
            at(50),
            at(95),
            values.len()
        );
    }
}

fn report(frames: &[(u64, i64, i64)]) {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else {
        return;
    };
    let span = (last.1 - first.1) as f64 / 1e9;
    println!(
        "{} frames, numbers {} to {}, {:.3} Hz",
        frames.len(),
        first.0,
        last.0,
        (last.0 - first.0) as f64 / span
    );
    spread(
        "arrival less PTS",
        frames.iter().map(|f| f.2 - f.1).collect(),
    );
    let steps = frames.windows(2).map(|two| {
        let numbers = (two[1].0 as i64 - two[0].0 as i64).max(1);
        (two[1].1 - two[0].1) / numbers
    });
    spread("PTS to PTS per number", steps.collect());
}

/// Collects what v4l2src's buffer pool logs about every buffer that it gets from the driver.
fn listen() -> Driver {
    let driver = Driver::default();
    let noting = driver.clone();
    gst::log::remove_default_log_function();
    gst::log::set_threshold_for_name("v4l2bufferpool", gst::DebugLevel::Log);
    gst::log::add_log_function(move |_, _, _, _, _, _, message| {
        let text = message.get().unwrap_or_default();
        if let Some((sequence, time)) = dequeued(text.as_str()) {
            noting.lock().unwrap().insert(sequence, time);
        }
    });
    driver
}

/// `dequeued buffer 0x7f… seq:12 …, ts 1:02:03.123456000, …`
fn dequeued(text: &str) -> Option<(u64, i64)> {
    let rest = text.strip_prefix("dequeued buffer")?;
    let word = |name: &str| {
        let found = &rest[rest.find(name)? + name.len()..];
        found.split([' ', ',']).next()
    };
    let (sequence, time) = (word("seq:")?, word("ts ")?);
    let mut parts = time.split([':', '.']).map(|part| part.parse::<i64>());
    let mut next = || parts.next()?.ok();
    let (hours, minutes, seconds, ns) = (next()?, next()?, next()?, next()?);
    let seconds = (hours * 60 + minutes) * 60 + seconds;
    Some((sequence.parse().ok()?, seconds * 1_000_000_000 + ns))
}

fn against(driver: &BTreeMap<u64, i64>, frames: &[(u64, i64, i64)]) {
    if driver.is_empty() {
        return;
    }
    let known = |frame: &&(u64, i64, i64)| driver.contains_key(&frame.0);
    let known: Vec<_> = frames.iter().filter(known).collect();
    println!(
        "{} of {} frames have a number that the driver gave as sequence",
        known.len(),
        frames.len()
    );
    let off = known.iter().map(|frame| frame.1 - driver[&frame.0]);
    spread("PTS less the driver's stamp", off.collect());
}
