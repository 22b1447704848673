//! Real photos of AprilTags: agreement with the corners that the reference implementation gave for
//! them, numbers of tags, and tags that are not there.

use std::fs;
use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use fiducials::square::distance;
use imaging::ImageView;
use serde::Serialize;

use super::methods::{self, Answer};
use super::peers;
use crate::meter::median;

/// A photo, and the numbers of the tags of 36h11 that it shows.
struct Photo {
    path: &'static str,
    ids: Range<u32>,
}

/// In the folder `05_apriltag` of the recordings. The last three show tags of another family.
/// AprilGrids are left out: squares touch the corners of their tags, so they need a detector of
/// boards, which is tested on them.
const PHOTOS: [Photo; 6] = [
    photo("apriltag_nasa/33369213973_9d9bb4cc96_c.jpg", 0..1),
    photo("apriltag_nasa/34139872896_defdb2f8d9_c.jpg", 0..1),
    photo("wpilib_pose/tag1_640_480.jpg", 1..2),
    photo("wpilib_pose/tag2_16h5_straight.png", 0..0),
    photo("wpilib_pose/tag2_45deg_X.png", 0..0),
    photo("wpilib_pose/tag2_45deg_y.png", 0..0),
];

const fn photo(path: &'static str, ids: Range<u32>) -> Photo {
    Photo { path, ids }
}

/// Distance of corners that are the same, px.
const SAME_PX: f64 = 2.0;

/// What a method reports of a photo.
#[derive(Debug, Serialize)]
pub(super) struct Row {
    photo: String,
    size: [usize; 2],
    method: String,
    /// Tags with numbers that the photo shows, and others.
    tags: usize,
    other_ids: usize,
    /// Tags in the file of reference corners, if there is one, and those of them that the method
    /// reports.
    reference: Option<usize>,
    agreeing: Option<usize>,
    /// Median distance of their corners from those in the file, px.
    corner_median_px: Option<f64>,
    ms: f64,
}

/// All methods that search whole images, on all photos; none where there are no recordings.
///
/// # Errors
/// A photo that cannot be read, or a peer that fails.
pub(super) fn run() -> Result<Vec<Row>> {
    let folder = match test_data::sets(["05_apriltag"]) {
        Ok([folder]) => folder,
        Err(reason) => {
            eprintln!("photos: {reason}");
            return Ok(Vec::new());
        }
    };
    let mut rows = Vec::new();
    for photo in &PHOTOS {
        let path = folder.join(photo.path);
        let (pixels, size) = read(&path)?;
        let image = ImageView::packed(size[0], size[1], &pixels).context("an image")?;
        let reference = reference(&path.with_extension("txt"))?;
        let own = methods::search(&methods::searcher(), &image);
        rows.push(row(photo, size, (methods::SEARCH, &own), &reference));
        for peer in peers::answers(&[&pixels], size)?.answers {
            rows.push(row(photo, size, (&peer.name, &peer.images[0]), &reference));
        }
    }
    rows.iter().for_each(print);
    Ok(rows)
}

fn print(row: &Row) {
    println!(
        "{:<46} {:<28} tags {:2}, other ids {}, agreeing {:?} of {:?}, {:.2?} px, {:6.2} ms",
        row.photo,
        row.method,
        row.tags,
        row.other_ids,
        row.agreeing,
        row.reference,
        row.corner_median_px,
        row.ms
    );
}

type Corners = [[f64; 2]; 4];

fn row(
    photo: &Photo,
    size: [usize; 2],
    (method, answer): (&str, &Answer),
    reference: &Option<Vec<Corners>>,
) -> Row {
    let tags = answer
        .tags
        .iter()
        .filter(|tag| photo.ids.contains(&tag.id))
        .count();
    let mut row = Row {
        photo: photo.path.to_owned(),
        size,
        method: method.to_owned(),
        tags,
        other_ids: answer.tags.len() - tags,
        reference: reference.as_ref().map(Vec::len),
        agreeing: None,
        corner_median_px: None,
        ms: answer.ms,
    };
    if let Some(reference) = reference {
        let farthest = |a: &Corners, b: &Corners| {
            let all = a.iter().zip(b).map(|(a, b)| distance(*a, *b));
            all.fold(0.0, f64::max)
        };
        let pairs = reference.iter().filter_map(|truth| {
            let own = answer.tags.iter().filter(|tag| photo.ids.contains(&tag.id));
            let mut corners = own.map(|tag| tag.corners_in_order_of(truth));
            let same = corners.find(|corners| farthest(corners, truth) < SAME_PX)?;
            Some((same, *truth))
        });
        let pairs: Vec<(Corners, Corners)> = pairs.collect();
        let distances = pairs.iter().flat_map(|(own, truth)| {
            let both = own.iter().zip(truth);
            both.map(|(a, b)| distance(*a, *b))
        });
        row.corner_median_px = Some(median(distances));
        row.agreeing = Some(pairs.len());
    }
    row
}

/// Corners by the reference implementation, from lines `id, (x y), (x y), (x y), (x y)` with pixel
/// centers at halves; `None` without a file.
fn reference(path: &Path) -> Result<Option<Vec<Corners>>> {
    if !path.exists() {
        return Ok(None);
    }
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    let corners = text
        .lines()
        .filter(|line| !line.trim().is_empty())
        .map(|line| {
            let rest = line.split_once(',').map_or("", |(_, rest)| rest);
            let numbers = rest
                .split(|c: char| "(), ".contains(c))
                .filter(|t| !t.is_empty());
            let numbers: Vec<f64> = numbers.map(str::parse).collect::<Result<_, _>>()?;
            ensure!(numbers.len() == 8, "four corners in {line:?}");
            Ok(std::array::from_fn(|k| {
                [numbers[2 * k] - 0.5, numbers[2 * k + 1] - 0.5]
            }))
        });
    Ok(Some(corners.collect::<Result<_>>()?))
}

/// Gray levels of a photo, and its size.
fn read(path: &Path) -> Result<(Vec<u8>, [usize; 2])> {
    let bytes = fs::read(path).with_context(|| format!("reading {}", path.display()))?;
    let bytes = std::io::Cursor::new(bytes);
    let (size, data) = if path.extension().is_some_and(|own| own == "png") {
        let mut decoder = png::Decoder::new(bytes);
        decoder.set_transformations(png::Transformations::normalize_to_color8());
        let mut reader = decoder.read_info().context("reading a PNG file")?;
        let mut data = vec![0; reader.output_buffer_size().context("its size")?];
        let info = reader
            .next_frame(&mut data)
            .context("decoding a PNG file")?;
        data.truncate(info.buffer_size());
        ([info.width as usize, info.height as usize], data)
    } else {
        let mut decoder = zune_jpeg::JpegDecoder::new(bytes);
        let data = decoder.decode().context("decoding a JPEG file")?;
        let info = decoder.info().context("the header of a JPEG file")?;
        ([usize::from(info.width), usize::from(info.height)], data)
    };
    let luma = |p: &[u8]| match p {
        [r, g, b, ..] => {
            ((299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b) + 500) / 1000) as u8
        }
        _ => p[0],
    };
    let channels = data.len() / (size[0] * size[1]);
    Ok((data.chunks_exact(channels).map(luma).collect(), size))
}
