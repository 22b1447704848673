//! Hand-written bags: replayed samples, dropped frames with their reasons, and rejected bags.

use std::path::Path;

use session_archive::mcap::{MAGIC, op};

use super::*;
use crate::config::BagImages;

const MS: i64 = 1_000_000;
const IMAGE: &str = "sensor_msgs/msg/Image";
const IMU: &str = "sensor_msgs/msg/Imu";

/// A file under construction; channels are numbered from 1.
struct File {
    bytes: Vec<u8>,
    channels: u16,
    messages: u32,
}

fn text(bytes: &mut Vec<u8>, text: &str) {
    bytes.extend((text.len() as u32).to_le_bytes());
    bytes.extend(text.as_bytes());
}

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = vec![opcode];
    bytes.extend((body.len() as u64).to_le_bytes());
    bytes.extend(body);
    bytes
}

fn chunk(compression: &str, records: &[u8], crc: u32, packed: &[u8]) -> Vec<u8> {
    let mut body = vec![0; 16];
    body.extend((records.len() as u64).to_le_bytes());
    body.extend(crc.to_le_bytes());
    text(&mut body, compression);
    body.extend((packed.len() as u64).to_le_bytes());
    body.extend(packed);
    record(op::CHUNK, &body)
}

impl File {
    fn new() -> Self {
        let mut bytes = MAGIC.to_vec();
        let mut body = Vec::new();
        text(&mut body, "ros2");
        text(&mut body, "by hand");
        bytes.extend(record(op::HEADER, &body));
        Self {
            bytes,
            channels: 0,
            messages: 0,
        }
    }

    fn channel(&mut self, topic: &str, schema: &str) -> u16 {
        self.channel_of(topic, schema, "cdr")
    }

    fn channel_of(&mut self, topic: &str, schema: &str, encoding: &str) -> u16 {
        self.channels += 1;
        let id = self.channels;
        let mut body = id.to_le_bytes().to_vec();
        text(&mut body, schema);
        text(&mut body, "ros2msg");
        text(&mut body, "");
        self.bytes.extend(record(op::SCHEMA, &body));
        let mut body = id.to_le_bytes().to_vec();
        body.extend(id.to_le_bytes());
        text(&mut body, topic);
        text(&mut body, encoding);
        text(&mut body, "");
        self.bytes.extend(record(op::CHANNEL, &body));
        id
    }

    fn message(&mut self, channel: u16, data: &[u8]) -> Vec<u8> {
        self.messages += 1;
        let mut body = channel.to_le_bytes().to_vec();
        body.extend(self.messages.to_le_bytes());
        body.extend(u64::from(self.messages).to_le_bytes());
        body.extend(u64::from(self.messages).to_le_bytes());
        body.extend(data);
        record(op::MESSAGE, &body)
    }

    fn put(&mut self, channel: u16, data: &[u8]) {
        let message = self.message(channel, data);
        self.bytes.extend(message);
    }

    fn write(mut self, path: &Path) {
        self.bytes.extend(record(op::DATA_END, &[0; 4]));
        self.bytes.extend(record(op::FOOTER, &[0; 20]));
        self.bytes.extend(MAGIC);
        std::fs::write(path, self.bytes).expect("a file");
    }
}

fn header(stamp_ns: i64) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend((stamp_ns.div_euclid(1_000_000_000) as i32).to_le_bytes());
    bytes.extend((stamp_ns.rem_euclid(1_000_000_000) as u32).to_le_bytes());
    bytes.extend([2, 0, 0, 0, b'c', 0, 0, 0]);
    bytes
}

/// A uniform gray image.
fn image(stamp_ns: i64, encoding: &str, [width, height]: [u32; 2], grey: u8) -> Vec<u8> {
    let mut bytes = header(stamp_ns);
    bytes.extend(height.to_le_bytes());
    bytes.extend(width.to_le_bytes());
    text(&mut bytes, &format!("{encoding}\0"));
    bytes.push(0);
    while !(bytes.len() - 4).is_multiple_of(4) {
        bytes.push(0);
    }
    bytes.extend(width.to_le_bytes());
    bytes.extend((width * height).to_le_bytes());
    bytes.extend(vec![grey; (width * height) as usize]);
    bytes
}

fn imu(stamp_ns: i64, rate: f64) -> Vec<u8> {
    let mut bytes = header(stamp_ns);
    let mut values = [0.0; 37];
    (values[13], values[27]) = (rate, 9.8);
    bytes.extend(values.iter().flat_map(|v: &f64| v.to_le_bytes()));
    bytes
}

const SIZE: [u32; 2] = [8, 4];

fn grey(stamp_ns: i64, value: u8) -> Vec<u8> {
    image(stamp_ns, "mono8", SIZE, value)
}

/// Ten pairs at 10 Hz from 100 s on, the right ones 2 ms later, and an IMU at 100 Hz.
fn walk(change: impl Fn(&str, i64) -> Option<Vec<u8>>) -> File {
    let mut file = File::new();
    let left = file.channel("/left/image_raw", IMAGE);
    let right = file.channel("/right/image_raw", IMAGE);
    let samples = file.channel("/imu", IMU);
    for n in 0..100 {
        let time = 100_000 * MS + n * 10 * MS;
        if n % 10 == 0 {
            let of = |eye, value| change(eye, n / 10).unwrap_or(value);
            file.put(left, &of("left", grey(time, n as u8)));
            file.put(right, &of("right", grey(time + 2 * MS, 100 + n as u8)));
        }
        let sample = change("imu", n).unwrap_or_else(|| imu(time + MS, n as f64));
        file.put(samples, &sample);
    }
    file
}

fn config(path: &Path) -> BagConfig {
    BagConfig {
        path: path.to_owned(),
        images: BagImages::Found,
        imu: true,
        imu_topic: None,
        pair_within_ns: None,
    }
}

fn open(file: File) -> Result<Bag, BagError> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    file.write(&path);
    // The file remains open.
    Bag::open("feet", &config(&path), HostTime(1_000_000 * MS))
}

fn samples(mut bag: Bag) -> Vec<Sample> {
    let mut samples = Vec::new();
    while let Some(sample) = bag.next_sample().expect("a sample") {
        samples.push(sample);
    }
    samples
}

/// Digest that distinguishes recordings of bags in virtual time.
#[test]
fn digest_of_a_bag_depends_on_its_content() {
    let [here, there] = [(); 2].map(|()| tempfile::tempdir().expect("folder"));
    let digest = |folder: &tempfile::TempDir, file: File, change: &dyn Fn(&mut BagConfig)| {
        let path = folder.path().join("walk.mcap");
        file.write(&path);
        let mut config = config(&path);
        change(&mut config);
        let bag = Bag::open("feet", &config, HostTime(0)).expect("a bag");
        bag.digest()
    };
    let usual = digest(&here, walk(|_, _| None), &|_| {});
    assert_eq!(digest(&there, walk(|_, _| None), &|_| {}), usual);
    // Another value of one sample, another time of one image.
    let sample = |eye: &str, n| (eye == "imu" && n == 50).then(|| imu(100_501 * MS, 3.0));
    let image = |eye: &str, n| (eye == "left" && n == 5).then(|| grey(100_501 * MS, 50));
    for other in [walk(sample), walk(image)] {
        assert_ne!(digest(&there, other, &|_| {}), usual);
    }
    let without_imu = |config: &mut BagConfig| config.imu = false;
    assert_ne!(digest(&there, walk(|_, _| None), &without_imu), usual);
}

/// Numbers of frames, and of dropped frames with their reasons.
fn frames(samples: &[Sample]) -> (Vec<u64>, Vec<(u64, String)>) {
    let (mut numbers, mut lost) = (Vec::new(), Vec::new());
    for sample in samples {
        match sample {
            Sample::Frame(f) => numbers.push(f.number),
            Sample::Dropped(l) => lost.push((l.number, l.detail.clone())),
            _ => {}
        }
    }
    (numbers, lost)
}

#[test]
fn samples_arrive_at_their_recorded_times() {
    let bag = open(walk(|_, _| None)).expect("a bag");
    let info = bag.info().clone();
    assert_eq!((info.camera.width, info.camera.height), (16, 4));
    assert!((info.camera.rate_hz - 10.0).abs() < 1e-9 && !info.camera.colour);
    assert!((info.imu.expect("an IMU").rate_hz - 100.0).abs() < 1e-9);
    let samples = samples(bag);
    let Sample::Notice(notice) = &samples[0] else {
        panic!("{:?}", samples[0]);
    };
    assert!(
        notice
            .text
            .contains("right ones are 2.000 ms later in the median"),
        "{}",
        notice.text
    );
    let mut newest = HostTime::MIN;
    let mut counts = [0, 0];
    for sample in &samples[1..] {
        assert!(sample.host_time() >= newest);
        newest = sample.host_time();
        let offset_ns = newest.since(HostTime(1_000_000 * MS));
        match sample {
            Sample::Frame(f) => {
                assert_eq!(offset_ns, 100 * MS * f.number as i64);
                assert_eq!(f.device_ticks, 100_000 * MS + offset_ns);
                assert_eq!(f.eyes_apart_ns, Some(2 * MS));
                let value = 10 * f.number as u8;
                assert_eq!(f.image.data[7..9], [value, 100 + value]);
                counts[0] += 1;
            }
            Sample::Imu(s) => {
                let gyro = [s.number as f64, 0.0, 0.0];
                let accel = [0.0, 0.0, 9.8];
                assert_eq!(s.values, ImuValues::Si { gyro, accel });
                assert_eq!(s.device_ticks, 100_000 * MS + offset_ns);
                counts[1] += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(counts, [10, 100]);
}

/// While nobody stores frames their images are neither read nor decoded.
#[test]
fn without_pixels_numbers_and_times_are_the_same() {
    let of = |samples: &[Sample]| -> Vec<(u64, i64, HostTime)> {
        let of = samples.iter().filter_map(|sample| match sample {
            Sample::Frame(f) => Some((f.number, f.device_ticks, f.host_time)),
            Sample::Arrival(s) => Some((s.number, s.device_ticks, s.host_time)),
            _ => None,
        });
        of.collect()
    };
    let with = samples(open(walk(|_, _| None)).expect("a bag"));
    let mut bag = open(walk(|_, _| None)).expect("a bag");
    bag.set_pixels_needed(false);
    let without = samples(bag);
    assert!(!without.iter().any(|s| matches!(s, Sample::Frame(_))));
    assert_eq!(of(&without), of(&with));
    assert_eq!((with.len(), without.len()), (111, 111));
}

#[test]
fn unusable_image_keeps_its_number_and_reports_the_reason() {
    let at = |n: i64| 100_000 * MS + n * 100 * MS;
    let bag = open(walk(|topic, n| match (topic, n) {
        ("left", 2) => Some(grey(0, 0)),
        ("left", 3) => Some(grey(at(1), 0)),
        ("right", 5) => Some(grey(at(5) + 45 * MS, 0)),
        ("left", 6) => Some(image(at(6), "mono8", [16, 4], 0)),
        ("left", 7) => Some(image(at(7), "bayer_rggb8", SIZE, 0)),
        ("right", 8) => Some(header(at(8))),
        ("imu", 50) => Some(imu(0, 0.0)),
        ("imu", 51) => Some(imu(at(1), 0.0)),
        _ => None,
    }));
    let samples = samples(bag.expect("a bag"));
    let (numbers, lost) = frames(&samples);
    assert_eq!(numbers, [0, 1, 4, 9]);
    let expected = [
        (2, "its header has no time"),
        (3, "its time is not after that of the one before"),
        (5, "no right image was taken within 40.0 ms of the left one"),
        (
            6,
            "the left image is 16x4 and the right one 8x4, expected the same",
        ),
        (7, "its encoding is \"bayer_rggb8\", expected one of mono8"),
        (8, "right image: it ends"),
    ];
    assert_eq!(lost.len(), expected.len(), "{lost:?}");
    for ((number, why), (expected_number, expected)) in lost.iter().zip(expected) {
        assert_eq!(*number, expected_number);
        assert!(why.starts_with(expected), "{why}");
    }
    let numbers = samples.iter().filter_map(|s| match s {
        Sample::Imu(s) => Some(s.number),
        _ => None,
    });
    let expected: Vec<u64> = (0..100).filter(|n| ![50, 51].contains(n)).collect();
    assert_eq!(numbers.collect::<Vec<_>>(), expected);
    let notices = samples.iter().filter_map(|s| match s {
        Sample::Notice(n) => Some(n.text.as_str()),
        _ => None,
    });
    let notices = notices.collect::<Vec<_>>().join("; ");
    assert!(
        notices.contains("/imu: left out: 1 without a time, 1 with a time that does not rise"),
        "{notices}"
    );
    assert!(
        notices.contains("/right/image_raw: 3 images have no left one within 40.0 ms"),
        "{notices}"
    );
}

#[test]
fn unusable_bag_is_rejected_when_opened() {
    let at = |n: i64| 100_000 * MS + n * 100 * MS;
    let error = |file| open(file).err().expect("an error").to_string();
    let missing = error(walk(|topic, _| (topic == "left").then(|| grey(0, 0))));
    assert!(
        missing.contains("of 10 messages on /left/image_raw, 10 have no time in their header"),
        "{missing}"
    );
    let falling = error(walk(|topic, n| (topic == "right").then(|| grey(at(-n), 0))));
    assert!(
        falling
            .contains("/right/image_raw, 0 have no time in their header, 9 one that is not after"),
        "{falling}"
    );
    let apart = error(walk(|topic, n| {
        (topic == "right").then(|| grey(at(n) + 50 * MS, 0))
    }));
    assert!(
        apart.contains("of 10 left images, 0 have a right one within 40.0 ms")
            && apart
                .contains("50.0 ms away in the median, so the two cameras are not synchronised")
            && apart.contains("(/left/image_raw at 10.00 Hz and /right/image_raw at 10.00 Hz)")
            && apart.contains("name the topics of one stereo camera as left_topic and right_topic")
            && !apart.contains("pair_within_ms"),
        "{apart}"
    );
    let bayer = error(walk(|topic, n| {
        (topic == "left").then(|| image(at(n), "bayer_rggb8", SIZE, 0))
    }));
    assert!(
        bayer.contains("the first image of /left/image_raw: its encoding is \"bayer_rggb8\""),
        "{bayer}"
    );
    let samples = error(walk(|topic, _| (topic == "imu").then(|| imu(0, 0.0))));
    assert!(
        samples.contains("of 100 messages on /imu, 100 have no time"),
        "{samples}"
    );
    let mut ros1 = File::new();
    ros1.channel_of("/left/image_raw", IMAGE, "ros1");
    let channel = ros1.channels;
    ros1.put(channel, &[]);
    let ros1 = error(ros1);
    assert!(ros1.contains("\"ros1\", expected \"cdr\""), "{ros1}");
}

#[test]
fn other_storages_name_the_command_that_converts_them() {
    let folder = tempfile::tempdir().expect("folder");
    let error = |name: &str, bytes: &[u8]| {
        let bag = folder.path().join(name);
        std::fs::create_dir(&bag).expect("a folder");
        std::fs::write(bag.join(name), bytes).expect("a file");
        let of = |path: &Path| {
            let opened = Bag::open("feet", &config(path), HostTime(0));
            opened.err().expect("an error").to_string()
        };
        [of(&bag), of(&bag.join(name))]
    };
    for message in error("walk_0.db3", b"SQLite format 3\0") {
        assert!(
            message.contains("`ros2 bag convert -i BAG -o convert.yaml`"),
            "{message}"
        );
    }
    let [folder_message, file_message] = error("walk.bag", b"#ROSBAG V2.0\n");
    assert!(
        folder_message.contains("a folder without .mcap files"),
        "{folder_message}"
    );
    assert!(file_message.contains("rosbags-convert"), "{file_message}");
    for message in error("walk.mcap.zstd", &[0x28, 0xb5, 0x2f, 0xfd]) {
        assert!(message.contains("zstd -d"), "{message}");
    }
}

#[test]
fn compressed_chunks_are_read_and_damaged_ones_skipped() {
    let at = |n: i64| 100_000 * MS + n * 100 * MS;
    let build = |pack: &dyn Fn(usize, &[u8]) -> Vec<u8>| {
        let mut file = File::new();
        let stereo = file.channel("/stereo", IMAGE);
        for k in 0..4 {
            let mut records = Vec::new();
            for n in 0..3 {
                let number = 3 * k + n;
                let data = image(at(number), "mono8", SIZE, number as u8);
                records.extend(file.message(stereo, &data));
            }
            file.bytes.extend(pack(k as usize, &records));
        }
        file
    };
    let zstd = |records: &[u8]| zstd::bulk::compress(records, 3).expect("packed");
    for pack in [
        &(|_: usize, records: &[u8]| chunk("", records, crc32fast::hash(records), records))
            as &dyn Fn(usize, &[u8]) -> Vec<u8>,
        &|_, records| chunk("zstd", records, crc32fast::hash(records), &zstd(records)),
        &|_, records| chunk("zstd", records, 0, &zstd(records)),
    ] {
        let samples = samples(open(build(pack)).expect("a bag"));
        assert_eq!(frames(&samples).0, (0..12).collect::<Vec<u64>>());
    }
    let bag = open(build(&|k, records| {
        let crc = crc32fast::hash(records) ^ u32::from(k == 1);
        chunk("zstd", records, crc, &zstd(records))
    }));
    let bag = bag.expect("a bag");
    assert_eq!(bag.notes(), ["walk.mcap: 1 damaged chunks are left out"]);
    assert_eq!(frames(&samples(bag)).0.len(), 9);
    let lz4 = open(build(&|_, records| chunk("lz4", records, 0, records)));
    let lz4 = lz4.err().expect("an error").to_string();
    assert!(
        lz4.contains("\"lz4\", expected zstd or none") && lz4.contains("mcap compress"),
        "{lz4}"
    );
    // An impossible size is not accepted.
    let huge = open(build(&|k, records| {
        let mut chunk = chunk("zstd", records, 0, &zstd(records));
        if k == 1 {
            chunk[9 + 16..9 + 24].copy_from_slice(&u64::MAX.to_le_bytes());
        }
        chunk
    }));
    assert_eq!(huge.expect("a bag").notes().len(), 1);
}

#[test]
fn truncated_file_is_replayed_up_to_the_cut() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    walk(|_, _| None).write(&path);
    let whole = std::fs::read(&path).expect("a file");
    std::fs::write(&path, &whole[..whole.len() * 3 / 5]).expect("a file");
    let bag = Bag::open("feet", &config(&path), HostTime(0)).expect("a bag");
    assert!(
        bag.notes()[0].contains("walk.mcap is cut off at byte"),
        "{:?}",
        bag.notes()
    );
    let (numbers, lost) = frames(&samples(bag));
    assert!(
        (5..8).contains(&numbers.len()) && lost.len() < 2,
        "{numbers:?} {lost:?}"
    );
}

/// A check reads the head of a file only: the rest is neither read nor judged.
#[test]
fn head_of_a_bag_is_opened_like_a_whole_bag() {
    use std::os::unix::fs::FileExt as _;

    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    // Behind the walk a record of an unknown kind, all hole, and then a chunk that cannot be
    // unpacked.
    let hole: u64 = 1 << 30;
    let mut bytes = walk(|_, _| None).bytes;
    bytes.push(0xf0);
    bytes.extend(hole.to_le_bytes());
    let behind = bytes.len() as u64 + hole;
    let file = std::fs::File::create(&path).expect("a file");
    file.write_all_at(&bytes, 0).expect("written");
    file.write_all_at(&chunk("lz4", b"", 0, b""), behind)
        .expect("written");
    let whole = Bag::open("feet", &config(&path), HostTime(0)).err();
    assert!(
        matches!(whole, Some(BagError::Compression { .. })),
        "{whole:?}"
    );
    let bag = Bag::open_head("feet", &config(&path)).expect("a bag");
    assert!(bag.is_head() && bag.notes().is_empty(), "{:?}", bag.notes());
    assert_eq!((bag.info().camera.width, bag.info().camera.height), (16, 4));
    assert_eq!(frames(&samples(bag)).0, (0..10).collect::<Vec<u64>>());

    // A file with nothing behind its head is judged like in a recording.
    walk(|_, _| None).write(&path);
    let bag = Bag::open_head("feet", &config(&path)).expect("a bag");
    assert!(!bag.is_head());
    walk(|topic, _| (topic == "left").then(|| grey(0, 0))).write(&path);
    let untimed = Bag::open_head("feet", &config(&path)).err();
    assert!(
        matches!(untimed, Some(BagError::Times { .. })),
        "{untimed:?}"
    );
}

/// It cannot decide whether images beyond the head are usable.
#[test]
fn head_without_images_is_reported_as_a_head() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    let mut file = File::new();
    let stereo = file.channel("/stereo", IMAGE);
    for n in 1..4 {
        let large = image(n * 100 * MS, "mono8", [2048, 600], 0);
        file.put(stereo, &large);
    }
    file.write(&path);
    Bag::open("feet", &config(&path), HostTime(0)).expect("a bag");
    let error = Bag::open_head("feet", &config(&path));
    let error = error.err().expect("an error");
    assert!(matches!(error, BagError::Head { .. }), "{error:?}");
    let error = with_causes(&error);
    assert!(
        error.starts_with("looking at the first 1 MiB of each file of a bag")
            && error.contains(&path.display().to_string()),
        "{error}"
    );
}

#[test]
fn non_plain_file_is_rejected_immediately() {
    let error = Bag::open("feet", &config(Path::new("/dev/null")), HostTime(0));
    let error = with_causes(&error.err().expect("an error"));
    assert!(
        error.contains("found a character device, expected a regular file"),
        "{error}"
    );
}

proptest::proptest! {
    /// A changed byte loses messages, or the bag.
    #[test]
    fn never_panics_on_a_damaged_file(at in 0_usize..100_000, value: u8) {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("walk.mcap");
        walk(|_, _| None).write(&path);
        let mut bytes = std::fs::read(&path).expect("a file");
        let at = at % bytes.len();
        bytes[at] = value;
        std::fs::write(&path, bytes).expect("a file");
        if let Ok(mut bag) = Bag::open("feet", &config(&path), HostTime(0)) {
            while let Ok(Some(_)) = bag.next_sample() {}
        }
    }
}
