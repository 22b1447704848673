//! Stereolabs factory files, `SNnnnn.conf`: INI text with one section per eye and resolution.
//!
//! Contract: section and key names are case-insensitive, values with or without blanks around `=`.
//! The resolution is selected by the image size: 2K, FHD, HD, VGA of the USB cameras and FHD1200,
//! FHD, SVGA of the GMSL ones, whose FHD and SVGA are derived from FHD1200 if they are absent.
//! Baseline and TY, TZ are in millimetres, (RX, CV, RZ) is a rotation vector in radians. Values
//! that are absent and taken as zero, or derived, are noted. The serial number is in the name of
//! the file alone; a written file has that of the factory file that the set was read from, or 0 and a note.
//!
//! Derived SVGA follows the maker's rule of halving all four intrinsics. Between pixel centres,
//! exact 2x2 binning would move the principal point another quarter of a pixel, equally in both
//! eyes.
//!
//! Signs: the maker's own calibration tool writes OpenCV's R and T (`x_right = R x_left + T`) with
//! `Baseline = -T.x`, `TY = T.y`, `TZ = T.z`, and reads them back that way (stereolabs/
//! zed-opencv-calibration, `opencv_calibration.cpp` and `.hpp`). zed-open-capture's sample uses
//! `+Baseline` instead, which rectifies alike only while TY and TZ are zero.

use std::path::Path;

use cad_transforms::RigidTransform;
use cad_transforms::rig::same_serial;
use camera_models::plausibility::MAX_BASELINE_M;
use camera_models::{
    CameraModel, CameraSet, Distortion, LensModel, Note, Provenance, StereoCalibration,
};

use crate::entry::{Entry, InFolder, PairResult, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, lens, stereo};
use crate::text::{Source, millimetres, number_text};
use ini::{Ini, Section};

mod ini;

/// Stereolabs factory files.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::ZedConf,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Extension("conf"),
    signs: Signs {
        start: Some(|extension, first| {
            extension.eq_ignore_ascii_case("conf")
                || first.to_ascii_uppercase().starts_with("[LEFT_CAM_")
        }),
        ..Signs::NONE
    },
    read,
    read_pair: Some(read_pair),
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[
    LensModel::None,
    LensModel::RadTan5,
    LensModel::Rational8,
    LensModel::KannalaBrandt4,
];

/// Resolution tags by the size of one image.
const RESOLUTIONS: [(u32, u32, &str); 6] = [
    (2208, 1242, "2K"),
    (1920, 1080, "FHD"),
    (1280, 720, "HD"),
    (672, 376, "VGA"),
    (1920, 1200, "FHD1200"),
    (960, 600, "SVGA"),
];

/// Minimum baseline: below it the value is not in millimetres; the closest pair the maker sells has
/// 18.
const MIN_BASELINE_MM: f64 = 1.0;

/// Reads a factory file for images of `width` x `height` pixels (one eye, not side by side).
///
/// # Errors
/// [`CalibError`].
fn read_pair(files: &dyn Files, path: &Path, [width, height]: [u32; 2]) -> PairResult {
    let source = files.text(path)?;
    let ini = Ini::parse(&source)?;
    let Some((_, _, tag)) = RESOLUTIONS
        .iter()
        .find(|(w, h, _)| (*w, *h) == (width, height))
    else {
        let known = RESOLUTIONS
            .map(|(w, h, tag)| format!("{tag} {w}x{h}"))
            .join(", ");
        let found = format!("no such resolution of these cameras ({known})");
        return Err(CalibError::Resolution {
            path: path.to_owned(),
            width,
            height,
            found,
        });
    };
    let mut notes = Vec::new();
    let shape = Shape::of(tag, &ini, &mut notes).ok_or_else(|| CalibError::Resolution {
        path: path.to_owned(),
        width,
        height,
        found: format!(
            "no section for {tag} among {}",
            ini.section_names().join(", ")
        ),
    })?;
    let left = camera(&ini, "LEFT", &shape, (width, height), &mut notes)?;
    let right = camera(&ini, "RIGHT", &shape, (width, height), &mut notes)?;
    let calibration = StereoCalibration {
        left,
        right,
        right_from_left: right_from_left(&ini, &source, tag, &shape, &mut notes)?,
        imu: None,
        provenance: Provenance {
            format: Some(Format::ZedConf.name().to_owned()),
            files: vec![path.to_owned()],
            part: Some(shape.section_tag.to_owned()),
        },
    };
    calibration
        .validate()
        .map_err(CalibError::invalid(path))
        .map(|calibration| (calibration, notes))
}

/// Reads a file as a set of two cameras.
fn read(files: &dyn Files, path: &Path, size: Option<[u32; 2]>) -> SetResult {
    let Some(size) = size else {
        let all: Vec<String> = resolutions(files, path)?
            .into_iter()
            .map(|(w, h, tag)| format!("{tag} {w}x{h}"))
            .collect();
        return Err(CalibError::SizeUnknown {
            path: path.to_owned(),
            found: format!("sections for {}", all.join(", ")),
        });
    };
    let (stereo, notes) = read_pair(files, path, size)?;
    Ok((CameraSet::of_stereo(&stereo), notes))
}

/// The serial number in the name of a factory file, `SN10028708.conf`. The text itself has none.
pub fn serial_in_name(path: &Path) -> Option<&str> {
    let stem = path.file_stem()?.to_str()?;
    let digits = stem.strip_prefix("SN").or(stem.strip_prefix("sn"))?;
    (!digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit())).then_some(digits)
}

/// Checks that a factory file belongs to the camera of this serial number, by its name.
///
/// # Errors
/// [`CalibError::Serial`] if the name has another one.
pub fn expect_serial(path: &Path, serial: &str) -> Result<(), CalibError> {
    match serial_in_name(path) {
        Some(found) if !same_serial(found, serial) => Err(CalibError::Serial {
            path: path.to_owned(),
            found: found.to_owned(),
            expected: serial.to_owned(),
        }),
        _ => Ok(()),
    }
}

/// The resolutions for which a file has sections, with their tags.
///
/// # Errors
/// [`CalibError`].
fn resolutions(
    files: &dyn Files,
    path: &Path,
) -> Result<Vec<(u32, u32, &'static str)>, CalibError> {
    let source = files.text(path)?;
    let ini = Ini::parse(&source)?;
    let there = |tag: &str| ini.section(&format!("LEFT_CAM_{tag}")).is_some();
    Ok(RESOLUTIONS
        .into_iter()
        .filter(|(_, _, tag)| there(tag))
        .collect())
}

/// The serial number of the factory file that a set was read from; `None` if there was none, or
/// several of different cameras.
fn serial_of(set: &CameraSet) -> Option<&str> {
    let files = set.provenance.files.iter();
    let mut serials = files.filter_map(|file| serial_in_name(file));
    let first = serials.next()?;
    serials
        .all(|other| same_serial(other, first))
        .then_some(first)
}

/// A factory file with the sections of one resolution, spelt as the maker's newer files are.
fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let stereo = &stereo(set, Format::ZedConf)?;
    let refused = |found: String, expected: &str| WriteError::Refused {
        format: Format::ZedConf.name(),
        found,
        expected: expected.to_owned(),
    };
    let size = (stereo.left.width, stereo.left.height);
    let tag = RESOLUTIONS
        .iter()
        .find(|(w, h, _)| (*w, *h) == size && size == (stereo.right.width, stereo.right.height));
    let Some((_, _, tag)) = tag else {
        let known = RESOLUTIONS.map(|(w, h, _)| format!("{w}x{h}")).join(", ");
        let found = format!(
            "{}x{} and {}x{}",
            size.0, size.1, stereo.right.width, stereo.right.height
        );
        return Err(refused(found, &format!("one of {known}")));
    };
    let mut text = String::new();
    for (eye, camera) in [("left", &stereo.left), ("right", &stereo.right)] {
        let distortion = lens(eye, &camera.distortion, Format::ZedConf, MODELS)?;
        // The list of coefficients does not name its model; the reader infers it from the zeros.
        let (names, numbers) = match distortion {
            Distortion::KannalaBrandt4 { k1, k2, k3, k4 } => {
                if k3 == 0.0 || k4 == 0.0 {
                    return Err(refused(
                        format!("a fisheye with k3 = {k3} and k4 = {k4}"),
                        "neither to be 0, by which these files distinguish the model",
                    ));
                }
                const NAMES: [&str; 6] = ["k1", "k2", "p1", "p2", "k3", "k4"];
                (&NAMES[..], vec![k1, k2, 0.0, 0.0, k3, k4])
            }
            Distortion::Rational8 {
                p1, p2, k3, k5, k6, ..
            } if [p1, p2, k5, k6] == [0.0; 4] && k3 != 0.0 => {
                return Err(refused(
                    "a rational lens with k1 to k4 alone".to_owned(),
                    "another term, without it these files mean a fisheye",
                ));
            }
            Distortion::None => (&["k1", "k2", "p1", "p2", "k3"][..], vec![0.0; 5]),
            ref other => (other.coefficient_names(), other.coefficients()),
        };
        text.push_str(&format!("[{}_CAM_{tag}]\n", eye.to_ascii_uppercase()));
        let (keys, values) = (["fx", "fy", "cx", "cy"], camera.parameters());
        for (key, value) in keys.iter().zip(&values).chain(names.iter().zip(&numbers)) {
            text.push_str(&format!("{key}={}\n", number_text(*value)));
        }
        text.push('\n');
    }
    let [x, y, z] = stereo.right_from_left.translation_m();
    if -x * 1000.0 < MIN_BASELINE_MM {
        return Err(refused(format!("a baseline of {} m", -x), "at least 1 mm"));
    }
    let [rx, ry, rz] = stereo.right_from_left.rotation_vector();
    text.push_str(&format!(
        "[STEREO]\nBaseline={}\nTY_{tag}={}\nTZ_{tag}={}\nCV_{tag}={}\nRX_{tag}={}\nRZ_{tag}={}\n",
        millimetres(-x),
        millimetres(y),
        millimetres(z),
        number_text(ry),
        number_text(rx),
        number_text(rz)
    ));
    let serial = serial_of(set);
    let mut files = FormatFiles::file(&format!("SN{}.conf", serial.unwrap_or("0")), text);
    if serial.is_none() {
        files.notes.push(Note(
            "the serial number of the camera is not known: its software looks for a file named SNnnnn.conf".to_owned(),
        ));
    }
    Ok(files)
}

/// Source section of the intrinsics, and their conversion to the image size.
struct Shape {
    section_tag: &'static str,
    scale: f64,
    /// Rows cropped at the top, before scaling.
    cut_rows: f64,
}

impl Shape {
    fn of(tag: &'static str, ini: &Ini<'_>, notes: &mut Vec<Note>) -> Option<Self> {
        let has = |tag: &str| ini.section(&format!("LEFT_CAM_{tag}")).is_some();
        if has(tag) {
            return Some(Self {
                section_tag: tag,
                scale: 1.0,
                cut_rows: 0.0,
            });
        }
        // The maker's calibration tool derives these two by the same rule.
        let (scale, cut_rows, how) = match tag {
            "FHD" => (1.0, 60.0, "by cutting 60 rows off above"),
            "SVGA" => (0.5, 0.0, "by halving"),
            _ => return None,
        };
        has("FHD1200").then(|| {
            notes.push(Note(format!(
                "no section for {tag}: derived from FHD1200 {how}"
            )));
            Self {
                section_tag: "FHD1200",
                scale,
                cut_rows,
            }
        })
    }
}

fn camera(
    ini: &Ini<'_>,
    eye: &str,
    shape: &Shape,
    (width, height): (u32, u32),
    notes: &mut Vec<Note>,
) -> Result<CameraModel, CalibError> {
    let section = ini.require(&format!("{eye}_CAM_{}", shape.section_tag))?;
    let lens = if section.has("K1") {
        section
    } else {
        ini.require(&format!("{eye}_DISTO"))?
    };
    let model = CameraModel {
        width,
        height,
        fx: section.number("FX")? * shape.scale,
        fy: section.number("FY")? * shape.scale,
        cx: section.number("CX")? * shape.scale,
        cy: (section.number("CY")? - shape.cut_rows) * shape.scale,
        distortion: distortion(lens, notes)?,
    };
    match model.invalid_parameter() {
        Some((name, reason)) => Err(section.implausible(&name.to_ascii_uppercase(), &reason)),
        None => Ok(model),
    }
}

/// The section has one list of coefficients for three models, which are distinguished by its zeros.
fn distortion(lens: &Section<'_>, notes: &mut Vec<Note>) -> Result<Distortion, CalibError> {
    let (k1, k2) = (lens.number("K1")?, lens.number("K2")?);
    let absent: Vec<&str> = ["P1", "P2", "K3"]
        .into_iter()
        .filter(|key| !lens.has(key))
        .collect();
    if !absent.is_empty() {
        notes.push(Note(format!(
            "[{}] has no {}: taken as 0",
            lens.name(),
            absent.join(", ")
        )));
    }
    let or_zero = |key| {
        if lens.has(key) {
            lens.number(key)
        } else {
            Ok(0.0)
        }
    };
    let (p1, p2, k3) = (or_zero("P1")?, or_zero("P2")?, or_zero("K3")?);
    let (k4, k5, k6) = (or_zero("K4")?, or_zero("K5")?, or_zero("K6")?);
    let all_zero = |values: &[f64]| values.iter().all(|v| *v == 0.0);
    Ok(if all_zero(&[k1, k2, p1, p2, k3, k4, k5, k6]) {
        notes.push(Note(format!(
            "[{}] has only zeros: a rectified camera, or a file that lost its digits to a decimal comma",
            lens.name()
        )));
        Distortion::None
    } else if all_zero(&[k4, k5, k6]) {
        Distortion::RadTan5 { k1, k2, p1, p2, k3 }
    } else if all_zero(&[p1, p2, k5, k6]) && k3 != 0.0 {
        // The maker's rule for its fisheye lenses, whose four coefficients share this list.
        notes.push(Note(format!(
            "[{}] has k1 to k4 alone: read as a fisheye lens",
            lens.name()
        )));
        Distortion::KannalaBrandt4 { k1, k2, k3, k4 }
    } else {
        Distortion::Rational8 {
            k1,
            k2,
            p1,
            p2,
            k3,
            k4,
            k5,
            k6,
        }
    })
}

fn right_from_left(
    ini: &Ini<'_>,
    source: &Source,
    tag: &str,
    shape: &Shape,
    notes: &mut Vec<Note>,
) -> Result<RigidTransform, CalibError> {
    let stereo = ini.require("STEREO")?;
    let baseline_mm = stereo.number("BASELINE")?;
    let farthest_mm = MAX_BASELINE_M * 1000.0;
    if !(MIN_BASELINE_MM..=farthest_mm).contains(&baseline_mm) {
        let (line, text) = stereo.text("BASELINE")?;
        let expected = format!(
            "BASELINE in [STEREO] in millimetres, positive, at least {MIN_BASELINE_MM}, at most {farthest_mm}"
        );
        return Err(source.malformed(line, text, &expected));
    }
    // Keys carry the resolution, in old files with a longer suffix. A derived resolution may have
    // its own keys or only those of the one it is derived from.
    let per_resolution = |name: &str| {
        [tag, shape.section_tag]
            .iter()
            .flat_map(|tag| [format!("{name}_{tag}"), format!("{name}_RESOLUTION_{tag}")])
            .find(|key| stereo.has(key))
    };
    let mut offset_mm = |name: &str| match per_resolution(name)
        .or(stereo.has(name).then(|| name.to_owned()))
    {
        Some(key) => match stereo.number(&key)? {
            mm if mm.abs() <= farthest_mm => Ok(mm),
            _ => {
                let (line, text) = stereo.text(&key)?;
                let expected =
                    format!("{key} in [STEREO] in millimetres, at most {farthest_mm} either way");
                Err(source.malformed(line, text, &expected))
            }
        },
        None => {
            notes.push(Note(format!("[STEREO] has no {name}: taken as 0")));
            Ok(0.0)
        }
    };
    let (ty_mm, tz_mm) = (offset_mm("TY")?, offset_mm("TZ")?);
    let angle =
        |name: &str| stereo.number(&per_resolution(name).unwrap_or(format!("{name}_{tag}")));
    let rotation_rad = [angle("RX")?, angle("CV")?, angle("RZ")?];
    let translation_m = [-baseline_mm / 1000.0, ty_mm / 1000.0, tz_mm / 1000.0];
    RigidTransform::from_rotation_vector(rotation_rad, translation_m).map_err(|error| {
        CalibError::Implausible {
            path: source.path.clone(),
            reason: format!("RX, CV, RZ in [STEREO] of {rotation_rad:?}: {error}"),
        }
    })
}

#[cfg(test)]
mod tests;
