//! MP4 files, read back with GStreamer's own demuxer.

use std::path::{Path, PathBuf};

use crate::material::texture;
use crate::{elements, encode, settings};
use gstreamer::prelude::*;
use video::mp4::{LONGEST_NS, Mp4Error, TIMESCALE, write_mp4};
use video::{AccessUnit, Codec};

/// A folder that is removed afterwards.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Folder {
        let path = std::env::temp_dir().join(format!("video-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Folder(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn units(element: &str, times: &[i64]) -> (Codec, Vec<AccessUnit>) {
    let images = texture(160, 64, times.len());
    let input = times
        .iter()
        .zip(&images)
        .enumerate()
        .map(|(n, (&time, image))| (time, image, n % 8 == 0));
    let codec = video::encoder::element_codec(element).unwrap();
    (codec, encode(&settings(element, &images[0]), input))
}

/// Access units of a file, Annex B, with the times in the file.
fn read(path: &Path, codec: Codec) -> Vec<(i64, Vec<u8>)> {
    let (media, parser) = match codec {
        Codec::H264 => ("video/x-h264", "h264parse"),
        Codec::H265 => ("video/x-h265", "h265parse"),
    };
    let line = format!(
        "filesrc location={} ! qtdemux ! {parser} ! {media},stream-format=byte-stream,alignment=au \
         ! appsink name=out sync=false",
        path.display()
    );
    let pipeline = gstreamer::parse::launch(&line)
        .unwrap()
        .downcast::<gstreamer::Bin>()
        .unwrap();
    let sink = pipeline
        .by_name("out")
        .unwrap()
        .downcast::<gstreamer_app::AppSink>()
        .unwrap();
    pipeline.set_state(gstreamer::State::Playing).unwrap();
    let mut found = Vec::new();
    while let Some(sample) = sink.try_pull_sample(gstreamer::ClockTime::from_seconds(60)) {
        let buffer = sample.buffer().unwrap();
        let segment = sample
            .segment()
            .unwrap()
            .downcast_ref::<gstreamer::ClockTime>()
            .unwrap();
        let time = segment.to_stream_time(buffer.pts().unwrap()).unwrap();
        found.push((
            time.nseconds() as i64,
            buffer.map_readable().unwrap().to_vec(),
        ));
    }
    assert!(sink.is_eos());
    pipeline.set_state(gstreamer::State::Null).unwrap();
    found
}

#[test]
fn times_and_images_come_back() {
    let folder = Folder::new("mp4");
    let step = 1_000_000_000 / i64::from(TIMESCALE);
    for element in elements() {
        let mut times: Vec<i64> = (0..30)
            .map(|n| 123_456_789_012_345 + n * 33_333_333 + n * n * 7_919)
            .collect();
        // A gap of a minute, and two of more than an hour: beyond 32 bits of microseconds.
        times[10..]
            .iter_mut()
            .for_each(|time| *time += 60_000_000_001);
        times[20..]
            .iter_mut()
            .for_each(|time| *time += 4_000_000_000_003);
        times[25..]
            .iter_mut()
            .for_each(|time| *time += 4_000_000_000_003);
        let (codec, units) = units(element, &times);
        let path = folder.0.join(format!("{element}.mp4"));
        let summary = write_mp4(&path, codec, 160, 64, units.iter().cloned()).unwrap();
        assert_eq!((summary.units, summary.origin_ns), (30, times[0]));
        let found = read(&path, codec);
        assert_eq!(found.len(), 30, "{element}");
        for ((time, bytes), unit) in found.iter().zip(&units) {
            let expected = unit.pts_ns - times[0];
            // Half a unit, and what the demuxer itself rounds away.
            assert!(
                (time - expected).abs() <= step / 2 + 1,
                "{element}: {time} for {expected}"
            );
            assert_eq!(video::annexb::is_key(codec, bytes), unit.key);
        }
        let again: Vec<AccessUnit> = found
            .into_iter()
            .map(|(pts_ns, data)| AccessUnit {
                pts_ns,
                key: false,
                data: data.into(),
            })
            .collect();
        let images = |units: &[AccessUnit]| -> Vec<_> {
            let decoded = video::Decoder::new(codec).decode(units).unwrap();
            decoded.into_iter().map(|(_, image)| image).collect()
        };
        assert!(images(&again) == images(&units), "{element}");
        assert!(!folder.0.join(format!("{element}.mp4.part")).exists());
    }
}

#[test]
fn without_a_good_end_there_is_no_file() {
    let folder = Folder::new("mp4-errors");
    let path = folder.0.join("x.mp4");
    let (codec, units) = units("x264enc", &[10, 20, 30]);
    let write =
        |path: &Path, units: &[AccessUnit]| write_mp4(path, codec, 160, 64, units.iter().cloned());
    assert!(matches!(write(&path, &[]), Err(Mp4Error::Empty(_))));
    assert!(matches!(
        write(&path, &units[1..]),
        Err(Mp4Error::NotKey(_))
    ));
    let backwards = [units[0].clone(), units[2].clone(), units[1].clone()];
    assert!(matches!(
        write(&path, &backwards),
        Err(Mp4Error::Time { found: 20, .. })
    ));
    let mut long = units.clone();
    long[2].pts_ns = units[0].pts_ns + LONGEST_NS + 1;
    assert!(matches!(write(&path, &long), Err(Mp4Error::TooLong(_))));
    let nowhere = folder.0.join("no/such/folder/x.mp4");
    let error = write(&nowhere, &units).unwrap_err();
    assert!(matches!(error, Mp4Error::Mux { .. }));
    assert!(
        error.to_string().ends_with(&nowhere.display().to_string()),
        "{error}"
    );
    assert_eq!(std::fs::read_dir(&folder.0).unwrap().count(), 0);
}

/// More than the queue inside holds, so that the writer has to wait for the disk.
#[test]
fn long_videos_pass_through_a_bounded_queue() {
    let folder = Folder::new("mp4-long");
    let (codec, units) = units("x264enc", &[0, 1, 2, 3, 4, 5, 6, 7]);
    let bytes: usize = units.iter().map(|unit| unit.data.len()).sum();
    let rounds = (20 << 20) / bytes as i64 + 1;
    let path = folder.0.join("long.mp4");
    let many = (0..rounds).flat_map(|round| {
        units.iter().map(move |unit| AccessUnit {
            pts_ns: (round * 8 + unit.pts_ns) * 33_333_333,
            ..unit.clone()
        })
    });
    let summary = write_mp4(&path, codec, 160, 64, many).unwrap();
    assert_eq!(summary.units, rounds as u64 * 8);
    assert!(std::fs::metadata(&path).unwrap().len() > 20 << 20);
}
