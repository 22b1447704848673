//! `calib.txt` of the Middlebury stereo benchmark (version 3): two camera matrices, the baseline in
//! millimetres, and the image size.
//!
//! Contract: the pair is rectified; `doffs` must be the difference of the two principal points.

use std::collections::BTreeMap;
use std::path::Path;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, CameraSet, Distortion, LensModel, Provenance, StereoCalibration};

use crate::entry::{Entry, InFolder, SetResult, Signs};
use crate::error::CalibError;
use crate::files::Files;
use crate::format::Format;
use crate::output::{FormatFiles, WriteError, stereo};
use crate::text::{millimetres, number_text};

/// The format.
pub(crate) const ENTRY: Entry = Entry {
    format: Format::Middlebury,
    models: MODELS,
    imu_fields: &[],
    in_folder: InFolder::Named(&["calib.txt"]),
    signs: Signs {
        words: Some(|words| {
            words
                .first()
                .is_some_and(|start| start.starts_with("cam0=["))
        }),
        ..Signs::NONE
    },
    read,
    read_pair: None,
    write,
};

/// The lens models of the format, the smallest of a family first.
const MODELS: &[LensModel] = &[LensModel::None];

/// Rounding of `doffs`, which is printed with three decimals.
const DOFFS_PRINTED_PX: f64 = 2e-3;

/// Reads a file.
///
/// # Errors
/// [`CalibError`].
fn read(files: &dyn Files, path: &Path, _: Option<[u32; 2]>) -> SetResult {
    let source = files.text(path)?;
    let mut values: BTreeMap<&str, (usize, &str)> = BTreeMap::new();
    for (line, text) in source.lines().filter(|(_, text)| !text.is_empty()) {
        let Some((key, value)) = text.split_once('=') else {
            return Err(source.malformed(line, text, "key=value"));
        };
        if values.insert(key.trim(), (line, value.trim())).is_some() {
            return Err(source.malformed(line, key, "each key once"));
        }
    }
    let get = |key: &str| {
        values.get(key).copied().ok_or_else(|| {
            let keys: Vec<&str> = values.keys().copied().collect();
            source.missing(key, &keys.join(", "))
        })
    };
    let number = |key: &str| {
        let (line, text) = get(key)?;
        source.number_for(line, text, &format!(" as {key}"))
    };
    let size = |key: &str| {
        let (line, text) = get(key)?;
        text.parse::<u32>()
            .ok()
            .filter(|n| *n > 0)
            .ok_or_else(|| source.malformed(line, text, &format!("a whole number as {key}")))
    };
    let (width, height) = (size("width")?, size("height")?);
    let camera = |key: &str| {
        let (line, text) = get(key)?;
        let expected = format!("[f 0 cx; 0 f cy; 0 0 1] as {key}");
        let inside = text.strip_prefix('[').and_then(|t| t.strip_suffix(']'));
        let inside = inside.ok_or_else(|| source.malformed(line, text, &expected))?;
        let k = source.numbers(line, &inside.replace(';', " "))?;
        let [fx, skew, cx, zero, fy, cy, a, b, c] = k[..] else {
            return Err(source.malformed(line, text, &expected));
        };
        if (skew, zero, a, b, c) != (0.0, 0.0, 0.0, 0.0, 1.0) {
            return Err(source.malformed(line, text, &expected));
        }
        Ok(CameraModel::new(
            (width, height),
            [fx, fy, cx, cy],
            Distortion::None,
        ))
    };
    let (left, right) = (camera("cam0")?, camera("cam1")?);
    let doffs = number("doffs")?;
    if (right.cx - left.cx - doffs).abs() > DOFFS_PRINTED_PX {
        let (line, text) = get("doffs")?;
        let expected = format!("{} from the two cx", right.cx - left.cx);
        return Err(source.malformed(line, text, &expected));
    }
    let baseline_mm = number("baseline")?;
    if baseline_mm < 1.0 {
        let (line, text) = get("baseline")?;
        return Err(source.malformed(line, text, "millimetres, at least 1"));
    }
    let stereo = StereoCalibration {
        left,
        right,
        right_from_left: RigidTransform::from_translation_m([-baseline_mm / 1000.0, 0.0, 0.0])
            .expect("the baseline is finite"),
        imu: None,
        provenance: Provenance {
            format: Some(Format::Middlebury.name().to_owned()),
            files: vec![path.to_owned()],
            part: None,
        },
    };
    Ok((
        CameraSet::of_stereo(&stereo)
            .validate()
            .map_err(CalibError::invalid(path))?,
        Vec::new(),
    ))
}

fn write(set: &CameraSet) -> Result<FormatFiles, WriteError> {
    let stereo = &stereo(set, Format::Middlebury)?;
    let (left, right) = (&stereo.left, &stereo.right);
    if !stereo.is_rectified()
        || left.fx != left.fy
        || (left.width, left.height) != (right.width, right.height)
    {
        return Err(WriteError::Refused {
            format: Format::Middlebury.name(),
            found: "a pair that is not rectified to one focal length".to_owned(),
            expected: "a rectified pair: rectify it first".to_owned(),
        });
    }
    let matrix = |m: &CameraModel| {
        let [f, cx, cy] = [m.fx, m.cx, m.cy].map(number_text);
        format!("[{f} 0 {cx}; 0 {f} {cy}; 0 0 1]")
    };
    let [x, ..] = stereo.right_from_left.translation_m();
    let text = format!(
        "cam0={}\ncam1={}\ndoffs={}\nbaseline={}\nwidth={}\nheight={}\n",
        matrix(left),
        matrix(right),
        number_text(right.cx - left.cx),
        millimetres(-x),
        left.width,
        left.height
    );
    Ok(FormatFiles::file("calib.txt", text))
}
