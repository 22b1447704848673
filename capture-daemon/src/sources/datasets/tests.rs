use std::fs;

use test_data::shared;

use super::*;

/// A folder of synthetic files.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes files, with the folders above them.
    fn with(self, files: &[(&str, &str)]) -> Self {
        for (name, text) in files {
            let path = self.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        }
        self
    }
}

fn message(result: Result<StereoDataset, DatasetError>) -> String {
    result.unwrap_err().to_string()
}

fn assert_contains(found: &str, expected: &str) {
    assert!(
        found.contains(expected),
        "found {found:?}, expected {expected:?}"
    );
}

fn times(dataset: &StereoDataset) -> Vec<(u64, i64)> {
    dataset
        .frames
        .iter()
        .map(|frame| (frame.number, frame.device_time_ns))
        .collect()
}

#[test]
fn real_euroc_images_and_imu() {
    let Some(path) = shared("03_stereo_imu/euroc_V1_01_micro") else {
        return;
    };
    assert_eq!(detect(&path).unwrap(), DatasetKind::Asl);
    let dataset = open(&path, None).unwrap();
    assert_eq!(dataset.frames.len(), 20);
    assert!((dataset.rate_hz - 20.0).abs() < 1e-3, "{}", dataset.rate_hz);
    for frame in &dataset.frames {
        let name = format!("{}.png", frame.device_time_ns);
        assert!(frame.left.ends_with(Path::new("cam0/data").join(&name)) && frame.left.is_file());
        assert!(frame.right.ends_with(Path::new("cam1/data").join(&name)) && frame.right.is_file());
    }
    assert_eq!(dataset.frames[0].device_time_ns, 1_403_715_273_262_142_976);
    assert_eq!(dataset.notes.len(), 2);
    assert_contains(
        &dataset.notes[0],
        "cam0/data.csv lists 95 images, 75 of them are not on disk",
    );
    assert_contains(
        &dataset.notes[1],
        "cam1/data.csv lists 99 images, 79 of them are not on disk",
    );
    let names: Vec<_> = dataset
        .calibration_files
        .iter()
        .map(|file| file.strip_prefix(&path).unwrap())
        .collect();
    let expected = [
        "mav0/body.yaml",
        "mav0/cam0/sensor.yaml",
        "mav0/cam1/sensor.yaml",
        "mav0/imu0/sensor.yaml",
    ];
    assert_eq!(names, expected.map(Path::new));

    // Every line of the list, with its exact digits.
    let list = fs::read_to_string(path.join("mav0/imu0/data.csv")).unwrap();
    let lines: Vec<&str> = list.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!((lines.len(), dataset.imu.len()), (29_120, 29_120));
    for (line, sample) in lines.iter().zip(&dataset.imu) {
        let (stamp, values) = line.split_once(',').unwrap();
        assert_eq!(stamp.parse(), Ok(sample.device_time_ns));
        let expected: Vec<u64> = values
            .split(',')
            .map(|v| v.parse::<f64>().unwrap().to_bits())
            .collect();
        let found: Vec<u64> = sample
            .gyro_rad_s
            .iter()
            .chain(&sample.accel_m_s2)
            .map(|v| v.to_bits())
            .collect();
        assert_eq!(found, expected, "{line}");
    }

    let image = load_png(&dataset.frames[7].right).unwrap();
    assert_eq!(
        (image.width, image.height, image.samples),
        (752, 480, Samples::Grey8)
    );
    assert_eq!(image.data.len(), 752 * 480);
    let (calibration, _) =
        calibration_files::read_stereo(&dataset.root, image.width, image.height).unwrap();
    assert_eq!(calibration.imu.unwrap().rate_hz, 200.0);
}

#[test]
fn real_kitti_pairs() {
    let Some(path) = shared("02_stereo_odometry_kitti/KITTI_sequence_1") else {
        return;
    };
    assert_eq!(detect(&path).unwrap(), DatasetKind::Kitti);
    assert!(matches!(
        open(&path, None),
        Err(DatasetError::NeedsRate { .. })
    ));
    let dataset = open(&path, Some(10.0)).unwrap();
    let expected: Vec<(u64, i64)> = (0..30).map(|n| (n, n as i64 * 100_000_000)).collect();
    assert_eq!(times(&dataset), expected);
    assert!(dataset.frames[29].left.ends_with("image_l/000029.png"));
    assert!(dataset.frames[29].right.ends_with("image_r/000029.png"));
    assert_eq!(dataset.calibration_files, [path.join("calib.txt")]);
    assert!(dataset.imu.is_empty() && dataset.notes.is_empty());
    for file in [&dataset.frames[0].left, &dataset.frames[29].right] {
        let image = load_png(file).unwrap();
        assert_eq!(
            (image.width, image.height, image.samples),
            (1226, 370, Samples::Grey8)
        );
    }
    assert!(
        calibration_files::read_stereo(&dataset.root, 1226, 370)
            .unwrap()
            .0
            .is_rectified()
    );
}

#[test]
fn real_desk_pair() {
    let Some(path) = shared("01_stereo_depth/foundationstereo_demo") else {
        return;
    };
    assert_eq!(detect(&path).unwrap(), DatasetKind::Pair);
    let dataset = open(&path, Some(15.0)).unwrap();
    assert_eq!(times(&dataset), [(0, 0)]);
    assert_eq!(
        (dataset.rate_hz, dataset.calibration_files.as_slice()),
        (15.0, &[path.join("K.txt")][..])
    );
    let (left, right) = (
        load_png(&dataset.frames[0].left).unwrap(),
        load_png(&dataset.frames[0].right).unwrap(),
    );
    for image in [&left, &right] {
        assert_eq!(
            (image.width, image.height, image.samples),
            (960, 540, Samples::Rgb8)
        );
        assert_eq!(image.data.len(), 960 * 540 * 3);
    }
    assert_ne!(left.data, right.data);
    assert!(
        calibration_files::read_stereo(&dataset.root, 960, 540)
            .unwrap()
            .0
            .is_rectified()
    );
}

/// `cam0` and `cam1` with the given stamps listed and on disk.
fn asl(left: (&[&str], &[&str]), right: (&[&str], &[&str])) -> Folder {
    let mut folder = Folder::new();
    for (camera, (listed, on_disk)) in [("cam0", left), ("cam1", right)] {
        let rows: String = listed
            .iter()
            .map(|stamp| format!("{stamp}, {stamp}.png\r\n"))
            .collect();
        folder = folder.with(&[(
            &format!("{camera}/data.csv"),
            &format!("#timestamp [ns],filename\r\n{rows}"),
        )]);
        for stamp in on_disk {
            folder = folder.with(&[(&format!("{camera}/data/{stamp}.png"), "")]);
        }
    }
    folder
}

#[test]
fn asl_pairs_by_equal_stamps() {
    let all = ["100", "200", "300", "400"];
    let dataset = open(asl((&all, &all), (&all, &all)).path(), Some(5.0)).unwrap();
    assert_eq!(times(&dataset), [(0, 100), (1, 200), (2, 300), (3, 400)]);
    assert_eq!(dataset.rate_hz, 1e7);
    assert_eq!(
        dataset.notes,
        [
            "no IMU samples: imu0/data.csv is absent or empty",
            "the rate of 5 Hz is ignored: the frames have stamps"
        ]
    );

    // Images absent on both sides are a gap in the numbers; absent on one side they are an error.
    let some = ["100", "400"];
    let dataset = open(asl((&all, &some), (&some, &some)).path(), None).unwrap();
    assert_eq!(times(&dataset), [(0, 100), (3, 400)]);
    let error = message(open(asl((&all, &all), (&all, &some)).path(), None));
    assert_contains(
        &error,
        "2 only on the left and 0 only on the right, the first is 200 ns",
    );
    let near = ["100", "201", "300", "400"];
    let error = message(open(asl((&all, &all), (&near, &near)).path(), None));
    assert_contains(
        &error,
        "1 only on the left and 1 only on the right, the first is 200 ns",
    );

    assert!(matches!(
        open(asl((&all, &[]), (&all, &all)).path(), None),
        Err(DatasetError::Read { .. })
    ));
    let one = ["100"];
    assert!(matches!(
        open(asl((&one, &one), (&one, &one)).path(), None),
        Err(DatasetError::NeedsRate { .. })
    ));
}

#[test]
fn asl_error_names_the_line() {
    let good = ["100", "200"];
    let check = |file: &str, text: &str, expected: &str| {
        let folder = asl((&good, &good), (&good, &good)).with(&[(file, text)]);
        let error = message(open(folder.path(), None));
        assert_contains(&error, expected);
        assert!(error.ends_with(file), "{error}");
    };
    check(
        "cam0/data.csv",
        "#h\n100,100.png\n1.5e9,a.png\n",
        "line 3: found \"1.5e9\", expected a time as an integer",
    );
    check(
        "cam1/data.csv",
        "100,100.png\n\n100,100.png\n",
        "line 3: found \"100\", expected a time after 100 ns",
    );
    check(
        "cam0/data.csv",
        "100\n",
        "line 1: found \"100\", expected timestamp_ns,filename",
    );
    check(
        "cam0/data.csv",
        "100,../100.png\n",
        "line 1: found \"../100.png\", expected the name of a file",
    );
    check(
        "cam0/data.csv",
        "700,700.png\n",
        "found none, expected at least one",
    );
    check(
        "imu0/data.csv",
        "#h\n5,0,0,0,0,0,9.8\n6,0,0,0,0,9.8\n",
        "line 3: found \"6,0,0,0,0,9.8\", expected timestamp_ns, three",
    );
    check(
        "imu0/data.csv",
        "5,0,0,x,0,0,9.8\n",
        "line 1: found \"x\", expected a finite number",
    );
    check(
        "imu0/data.csv",
        "5,0,0,nan,0,0,9.8\n",
        "line 1: found \"nan\", expected a finite number",
    );
    check(
        "imu0/data.csv",
        "5,0,0,0,0,0,9.8\n4,0,0,0,0,0,9.8\n",
        "line 2: found \"4\", expected a time after 5 ns",
    );
}

#[test]
fn kitti_times_follow_the_numbers() {
    let images = |numbers: &[&str], sides: (&str, &str)| {
        numbers.iter().fold(Folder::new(), |folder, number| {
            folder.with(&[
                (&format!("{}/{number}.png", sides.0), ""),
                (&format!("{}/{number}.png", sides.1), ""),
            ])
        })
    };
    let with_hole = images(&["000000", "000001", "000003"], ("image_2", "image_3"))
        .with(&[("image_2/notes.txt", "")]);
    let dataset = open(with_hole.path(), Some(30.0)).unwrap();
    assert_eq!(times(&dataset), [(0, 0), (1, 33_333_333), (3, 100_000_000)]);
    assert_eq!(dataset.notes, ["of the images 0 to 3, 1 are absent"]);

    let stamped = with_hole.with(&[(
        "times.txt",
        "0.000000e+00\n1.036224e-01\n2.07e-01\n3.1e-01\n",
    )]);
    let dataset = open(stamped.path(), None).unwrap();
    assert_eq!(
        times(&dataset),
        [(0, 0), (1, 103_622_400), (3, 310_000_000)]
    );
    let short = stamped.with(&[("times.txt", "0\n0.1\n0.2\n")]);
    assert_contains(
        &message(open(short.path(), None)),
        "line 4: found \"the end of the file\", expected a time for image 3",
    );
    let falling = short.with(&[("times.txt", "0\n0.2\n0.1\n0.3\n")]);
    assert_contains(
        &message(open(falling.path(), None)),
        "line 3: found \"100000000\", expected a time after 200000000 ns",
    );

    let one_sided = images(&["000000"], ("image_0", "image_1")).with(&[("image_1/000007.png", "")]);
    let error = message(open(one_sided.path(), Some(10.0)));
    assert_contains(
        &error,
        "0 only on the left and 1 only on the right, the first is number 7",
    );
    let named = images(&["000000", "left"], ("image_l", "image_r"));
    assert_contains(
        &message(open(named.path(), Some(10.0))),
        "found left.png, expected images named by their number",
    );
    let doubled = images(&["000001", "01"], ("image_l", "image_r"));
    assert_contains(
        &message(open(doubled.path(), Some(10.0))),
        "each number once",
    );
}

#[test]
fn plain_folders_are_paired_in_order() {
    let folder = Folder::new().with(&[
        ("left/b.png", ""),
        ("left/a.png", ""),
        ("left/readme.txt", ""),
        ("right/x.png", ""),
        ("right/y.png", ""),
        ("SN123.conf", ""),
        ("K.txt", ""),
    ]);
    assert_eq!(detect(folder.path()).unwrap(), DatasetKind::Folders);
    let dataset = open(folder.path(), Some(60.0)).unwrap();
    assert_eq!(times(&dataset), [(0, 0), (1, 16_666_667)]);
    assert!(
        dataset.frames[1].left.ends_with("left/b.png")
            && dataset.frames[1].right.ends_with("right/y.png")
    );
    assert_eq!(
        dataset.calibration_files,
        [
            folder.path().join("K.txt"),
            folder.path().join("SN123.conf")
        ]
    );
    assert!(matches!(
        open(folder.path(), None),
        Err(DatasetError::NeedsRate { .. })
    ));

    let unequal = folder.with(&[("right/z.png", "")]);
    let error = message(open(unequal.path(), Some(60.0)));
    assert_contains(
        &error,
        "0 only on the left and 1 only on the right, the first is z.png",
    );
    let jpeg = Folder::new().with(&[("left/a.jpg", ""), ("right/a.jpg", "")]);
    assert!(matches!(
        open(jpeg.path(), Some(60.0)),
        Err(DatasetError::Empty { .. })
    ));
}

/// A check reads the head of each list: the rest is neither read nor reported as absent.
#[test]
fn head_of_a_long_list_is_sufficient_for_a_check() {
    const LINES: u64 = 100_000;
    // Behind the head an invalid line.
    let list = |line: &dyn Fn(u64) -> String| -> String {
        let mut text: String = (0..LINES).map(line).collect();
        text.push_str("nonsense\n");
        text
    };
    // Lines of two lengths, so that the heads end with different frames.
    let left = list(&|stamp| format!("{stamp:06},{stamp:06}.png\n"));
    let right = list(&|stamp| format!("{stamp:06},  {stamp:06}.png\n"));
    let imu = list(&|stamp| format!("{stamp:06},0,0,0,0,0,9.8\n"));
    let names = |stamp: u64| [0, 1].map(|eye| format!("cam{eye}/data/{stamp:06}.png"));
    let mut folder = Folder::new().with(&[
        ("cam0/data.csv", left.as_str()),
        ("cam1/data.csv", right.as_str()),
        ("imu0/data.csv", imu.as_str()),
    ]);
    for stamp in [0, 50, LINES - 1] {
        for name in names(stamp) {
            folder = folder.with(&[(name.as_str(), "")]);
        }
    }
    assert!(message(open(folder.path(), None)).contains("nonsense"));
    let dataset = open_head(folder.path(), None).unwrap();
    assert!(dataset.is_head);
    assert_eq!(times(&dataset), [(0, 0), (50, 50)]);
    assert!(dataset.imu.len() > 10_000 && dataset.imu.len() < LINES as usize);

    // If no image is within the head, it cannot decide.
    for stamp in [0, 50] {
        for name in names(stamp) {
            fs::remove_file(folder.path().join(name)).unwrap();
        }
    }
    assert!(matches!(
        open_head(folder.path(), None),
        Err(DatasetError::Head { .. })
    ));

    let seconds = list(&|n| format!("{n}.0000000000000\n"));
    let kitti = Folder::new().with(&[
        ("times.txt", seconds.as_str()),
        ("image_0/000007.png", ""),
        ("image_1/000007.png", ""),
        ("image_0/000008.png", ""),
        ("image_1/000008.png", ""),
        ("image_0/099999.png", ""),
        ("image_1/099999.png", ""),
    ]);
    let dataset = open_head(kitti.path(), None).unwrap();
    assert!(dataset.is_head);
    assert_eq!(times(&dataset), [(7, 7_000_000_000), (8, 8_000_000_000)]);

    // A list that fits into a head is complete.
    let short = Folder::new().with(&[
        ("times.txt", "0.0\n0.1\n"),
        ("image_0/0.png", ""),
        ("image_1/0.png", ""),
        ("image_0/1.png", ""),
        ("image_1/1.png", ""),
    ]);
    assert!(!open_head(short.path(), None).unwrap().is_head);
}

#[test]
fn layouts_are_distinguished() {
    let error = message(open(Path::new("no/such/folder"), Some(10.0)));
    assert_contains(
        &error,
        "recognising a data set: found no folder, expected mav0/cam0 and cam1",
    );
    assert_contains(
        &message(open(Folder::new().path(), Some(10.0))),
        "found a folder without any of them",
    );
    let both = Folder::new().with(&[
        ("left.png", ""),
        ("right.png", ""),
        ("left/a.png", ""),
        ("right/a.png", ""),
    ]);
    assert_contains(
        &message(open(both.path(), Some(10.0))),
        "found the layouts [Folders, Pair] simultaneously",
    );
    for rate in [0.0, -1.0, 1e7, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            open(both.path(), Some(rate)),
            Err(DatasetError::Rate { .. })
        ));
    }
}
