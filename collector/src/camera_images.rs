//! The section of a report with some frames of each camera.
//!
//! Contract: it never fails a report. Errors are shown in place of the images. The work is bounded,
//! independent of the session's length (see [`video::still`]).

use charts::{Image, Page};
use console_output::text;
use session_archive::index::{Access, Index};
use session_archive::manifest::Camera;
use session_archive::reader::SessionReader;
use session_input::stills::camera_stills;
use video::still::{Still, Stills};

/// Selected stills of one camera.
struct CameraStills<'a> {
    camera: &'a Camera,
    stills: Result<Stills, String>,
}

/// Adds the section. Times are from `start_ns`, the first sample's.
pub(crate) fn section(mut page: Page, reader: &SessionReader, start_ns: i64) -> Page {
    page = page.section("Camera images");
    page = page.text(
        "The first and the last frame, the key frame in the middle, and the least sharp of the examined key \
         frames. Sharpness is the mean difference between a pixel and its neighbours, in grey levels of 255, of one eye; a \
         cover, blur, darkness and too much light lower it, and so does a plain wall. The left eye is shown, and of the \
         least sharp frame the eye that is less sharp.",
    );
    for one in select_stills(reader) {
        page = page.heading(&one.camera.name);
        let found = match one.stills {
            Ok(found) => found,
            Err(why) => {
                page = page.text(&format!("No image can be shown: {why}."));
                continue;
            }
        };
        let images: Vec<Image> = found
            .stills
            .iter()
            .map(|still| image(one.camera, still, start_ns))
            .collect();
        if images.is_empty() {
            page = page.text(match found.undecodable {
                0 => "No image can be shown: no frame can be decoded.",
                _ => "No image can be shown: none of the examined frames could be decoded.",
            });
            continue;
        }
        page = page.images(&images);
        let mut line = format!("{} examined", text::count(found.looked_at as u64, "frame"));
        if found.undecodable > 0 {
            line.push_str(&format!(
                ", {} more could not be decoded",
                found.undecodable
            ));
        }
        page = page.text(&format!("{line}."));
    }
    page
}

fn image(camera: &Camera, still: &Still, start_ns: i64) -> Image {
    let roles: Vec<&str> = still.roles.iter().map(|role| role.name()).collect();
    let roles = roles.join(", ");
    let seconds = still.time_ns.saturating_sub(start_ns) as f64 * 1e-9;
    let quality = &still.look;
    let name = format!(
        "{}, {roles}: {} eye at {seconds:.1} s",
        camera.name, still.eye
    );
    let caption = format!(
        "{roles}: {seconds:.1} s, frame {}, {} eye; sharpness {:.1}, brightness {:.0}, {:.1} % clipped",
        still.number,
        still.eye,
        quality.sharpness,
        quality.brightness,
        100.0 * quality.clipped
    );
    Image::jpeg(&still.jpeg, &name, &caption)
}

fn select_stills(reader: &SessionReader) -> Vec<CameraStills<'_>> {
    let opened = Index::read(reader)
        .or_else(|_| Index::build(reader, |_| {}))
        .map_err(|e| e.to_string())
        .and_then(|index| {
            let access = Access::open(&**reader.storage(), &index).map_err(|e| e.to_string())?;
            Ok((index, access))
        });
    let stills_of = |camera: &Camera| {
        let (index, access) = opened.as_ref().map_err(Clone::clone)?;
        let mut cameras = index.cameras.iter();
        let index = cameras.find(|c| c.name == camera.name);
        let index = index.ok_or_else(|| "the index does not know the camera".to_owned())?;
        camera_stills(camera, index, access).map_err(|e| e.to_string())
    };
    let cameras = reader.manifest().cameras.iter();
    let stills = cameras.map(|camera| CameraStills {
        camera,
        stills: stills_of(camera),
    });
    stills.collect()
}
