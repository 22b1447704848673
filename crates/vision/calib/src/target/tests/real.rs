use super::*;
use crate::test_data::shared;

/// An image file as grey.
fn load(path: &std::path::Path) -> RenderedImage {
    let bytes = std::fs::read(path).unwrap();
    let (size, channels, data) = if path.extension().is_some_and(|e| e == "png") {
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().unwrap();
        let mut data = vec![0; reader.output_buffer_size().unwrap()];
        let info = reader.next_frame(&mut data).unwrap();
        data.truncate(info.buffer_size());
        (
            [info.width as usize, info.height as usize],
            info.color_type.samples(),
            data,
        )
    } else {
        let mut decoder = zune_jpeg::JpegDecoder::new(std::io::Cursor::new(bytes));
        let data = decoder.decode().unwrap();
        let info = decoder.info().unwrap();
        let size = [usize::from(info.width), usize::from(info.height)];
        (size, data.len() / (size[0] * size[1]), data)
    };
    let grey = |p: &[u8]| match p {
        [r, g, b, ..] => {
            ((299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b) + 500) / 1000) as u8
        }
        _ => p[0],
    };
    RenderedImage {
        size,
        pixels: data.chunks_exact(channels).map(grey).collect(),
    }
}

#[test]
fn the_real_aprilgrids() {
    let Some(folder) = shared("05_apriltag/aprilgrid_real/tests/data") else {
        return;
    };
    for (name, columns, rows) in [("EuRoC.png", 6, 6), ("iphone.png", 11, 6)] {
        let target = Target::AprilGrid {
            columns,
            rows,
            tag_m: 0.088,
            spacing: 0.3,
            first_id: 0,
        };
        let image = load(&folder.join(name));
        let found = detect(&image.view(), &target, &Config::default());
        assert_eq!(found.corners.len(), target.corners().len(), "{name}");
        if name == "iphone.png" {
            // Tag 0 at the bottom left, measured by hand: bottom left, bottom right, top right, top
            // left.
            for (seen, by_eye) in
                found
                    .corners
                    .iter()
                    .zip([[262, 888], [357, 883], [352, 790], [256, 795]])
            {
                let off = fiducials::square::distance(seen.pixel, by_eye.map(f64::from));
                assert!(off < 6.0, "{seen:?} {by_eye:?}");
            }
        }
    }
}

#[test]
fn the_real_chessboards() {
    let Some(folder) = shared("06_calibration/stereo_chessboard_rigB") else {
        return;
    };
    let target = Target::Chessboard {
        columns: 9,
        rows: 6,
        square_m: 0.05,
    };
    for side in ["left", "right"] {
        for i in 1..=12 {
            let name = format!("{side}{i:02}.jpg");
            let image = load(&folder.join(&name));
            let found = detect(&image.view(), &target, &Config::default());
            assert_eq!(found.corners.len(), 54, "{name}: {:?}", found.remark);
            // Equal steps along a row keep their cross ratio in perspective: for four corners (|ac|
            // |bd|) / (|ad| |bc|) is 4/3. A corner with an error of a pixel would change it by more
            // than this.
            for row in found.corners.chunks(9) {
                for four in row.windows(4) {
                    let d = |i: usize, j: usize| {
                        fiducials::square::distance(four[i].pixel, four[j].pixel)
                    };
                    let ratio = d(0, 2) * d(1, 3) / (d(0, 3) * d(1, 2));
                    assert!(
                        (ratio - 4.0 / 3.0).abs() < 0.04,
                        "{name} {}: {ratio}",
                        four[0].id
                    );
                }
            }
        }
    }
}

/// Images without any of these boards, with the names of those that were tested.
#[test]
fn other_real_images_give_nothing() {
    let folders = [
        ("02_stereo_odometry_kitti/KITTI_sequence_1", "png"),
        ("03_stereo_imu/euroc_V1_01_micro", "png"),
        ("05_apriltag/apriltag_nasa", "jpg"),
        ("05_apriltag/wpilib_pose", "png"),
        ("07_multiview/fox", "jpg"),
        ("10_segmentation/camvid", "png"),
    ];
    let targets = [
        GRID,
        CHARUCO,
        Target::AprilGrid {
            columns: 24,
            rows: 24,
            tag_m: 0.088,
            spacing: 0.3,
            first_id: 0,
        },
        Target::Charuco {
            columns: 12,
            rows: 9,
            square_m: 0.06,
            marker_m: 0.045,
            dictionary: Dictionary::Aruco4x4 { count: 250 },
            first_id: 0,
        },
        CHESS,
        Target::Chessboard {
            columns: 3,
            rows: 3,
            square_m: 0.05,
        },
        Target::Chessboard {
            columns: 4,
            rows: 3,
            square_m: 0.05,
        },
    ];
    let mut tested = 0;
    for (folder, extension) in folders {
        let Some(folder) = shared(folder) else {
            continue;
        };
        let mut files = Vec::new();
        collect(&folder, extension, &mut files);
        files.sort();
        // Consecutive images show the same.
        let every = (files.len() / 12).max(1);
        for file in files.iter().step_by(every) {
            let image = load(file);
            tested += 1;
            for (target, found) in
                targets
                    .iter()
                    .zip(detect_all(&image.view(), &targets, &Config::default()))
            {
                assert!(
                    found.corners.is_empty(),
                    "{}: {target:?} {:?}",
                    file.display(),
                    found.corners
                );
            }
        }
    }
    println!("{tested} images");
}

fn collect(folder: &std::path::Path, extension: &str, files: &mut Vec<std::path::PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            collect(&path, extension, files);
        } else if path.extension().is_some_and(|e| e == extension) {
            files.push(path);
        }
    }
}
