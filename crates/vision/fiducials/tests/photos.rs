//! The search on photos for which the reference implementation of AprilTag gave corners.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use boards::Dictionary;
use fiducials::square::distance;
use fiducials::{Detection, SearchConfig, Searcher};
use imaging::ImageView;

/// Photos of the NASA Swarmathon, and how many tags of the file the search finds at least.
const PHOTOS: [(&str, usize, usize); 2] = [
    ("33369213973_9d9bb4cc96_c", 12, 12),
    ("34139872896_defdb2f8d9_c", 10, 9),
];
/// Maximum distance of corners that are the same, px.
const SAME_PX: f64 = 1.5;

/// Gray levels of a JPEG file, and its size.
fn gray(path: &Path) -> (Vec<u8>, usize, usize) {
    let bytes = fs::read(path).expect("a photo");
    let mut decoder = zune_jpeg::JpegDecoder::new(Cursor::new(bytes));
    let data = decoder.decode().expect("a JPEG file");
    let info = decoder.info().expect("a header");
    let luma = |p: &[u8]| {
        let [r, g, b] = [0, 1, 2].map(|k: usize| u32::from(p[k]));
        ((299 * r + 587 * g + 114 * b + 500) / 1000) as u8
    };
    let pixels = data.chunks_exact(3).map(luma).collect();
    (pixels, usize::from(info.width), usize::from(info.height))
}

/// Corners of a line `id, (x y), (x y), (x y), (x y)`, whose pixel centers are at halves.
fn corners(line: &str) -> [[f64; 2]; 4] {
    let (_, rest) = line.split_once(',').expect("a number and corners");
    let numbers: Vec<f64> = rest
        .split(|c: char| "(), ".contains(c))
        .filter_map(|text| text.parse().ok())
        .collect();
    assert_eq!(numbers.len(), 8, "{line}");
    std::array::from_fn(|k| [numbers[2 * k] - 0.5, numbers[2 * k + 1] - 0.5])
}

#[test]
fn photos_give_the_tags_of_the_reference_implementation() {
    let Some(folder) = test_data::shared("05_apriltag/apriltag_nasa") else {
        return;
    };
    let searcher = Searcher::new(Dictionary::AprilTag36h11, &SearchConfig::default());
    for (name, count, at_least) in PHOTOS {
        let (pixels, width, height) = gray(&folder.join(format!("{name}.jpg")));
        let image = ImageView::packed(width, height, &pixels).expect("an image");
        let found = searcher.search(&image);
        assert!(found.iter().all(|tag| tag.id == 0), "{name}: {found:?}");

        let text = fs::read_to_string(folder.join(format!("{name}.txt"))).expect("corners");
        let reference: Vec<[[f64; 2]; 4]> = text.lines().map(corners).collect();
        assert_eq!(reference.len(), count, "{name}");
        let is_same = |tag: &Detection, corners: &[[f64; 2]; 4]| {
            let mut pairs = tag.corners.iter().zip(corners);
            pairs.all(|(a, b)| distance(*a, *b) < SAME_PX)
        };
        let agreeing = reference
            .iter()
            .filter(|corners| found.iter().any(|tag| is_same(tag, corners)))
            .count();
        assert!(agreeing >= at_least, "{name}: {agreeing} of {count}");
    }
}
