//! `paws calib convert`: a calibration file of one kind as a file of another.
//!
//! Contract: nothing that exists is overwritten. The input is printed as a table with every note of
//! the reader. If the new format has no such lens model, the command fails and names the model for
//! `--model`. Each conversion states its error over the whole image. No session is needed.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use calibration_files::{Format, detect_format, read_cameras, write_cameras, zed_conf};
use camera_models::{CameraSet, LensModel, Note, convert_within};
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use console_output::{Console, Outcome};

const SERIAL_NOT_CHECKED: &str = "serial not checked: the file's name has none";

/// Options of `paws calib convert`.
#[derive(Clone, Debug, Args)]
pub(crate) struct Options {
    /// Calibration file, or a folder that holds one
    #[arg(value_name = "SRC")]
    pub(crate) source: PathBuf,
    /// The format to write
    #[arg(long, value_parser = format_parser())]
    pub(crate) to: Format,
    /// The file, or where the format makes several the folder; must not exist
    #[arg(long, value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Fit this lens model
    #[arg(long, value_parser = ModelParser)]
    pub(crate) model: Option<LensModel>,
    /// Fit only up to this angle off the axis
    #[arg(long, value_name = "DEGREES", requires = "model", value_parser = angle)]
    pub(crate) within: Option<f64>,
    /// Size of one image, pixels, for files that do not state it
    #[arg(long, value_name = "WxH", value_parser = size)]
    pub(crate) size: Option<[u32; 2]>,
    /// The camera's serial number: reject a file with another one in its name
    #[arg(long, value_name = "SN")]
    pub(crate) serial: Option<String>,
}

fn format_parser() -> impl TypedValueParser<Value = Format> {
    PossibleValuesParser::new(Format::ALL.map(Format::name))
        .map(|name| Format::from_name(&name).expect("only names of formats are possible"))
}

/// Parser of lens models that lists our names and also accepts those of other programs.
#[derive(Clone)]
struct ModelParser;

impl TypedValueParser for ModelParser {
    type Value = LensModel;

    fn parse_ref(
        &self,
        command: &clap::Command,
        arg: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<LensModel, clap::Error> {
        TypedValueParser::parse_ref(&model, command, arg, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let names = LensModel::ALL.map(LensModel::name);
        Some(Box::new(names.into_iter().map(PossibleValue::new)))
    }
}

fn model(text: &str) -> Result<LensModel, String> {
    LensModel::from_name(text).ok_or_else(|| {
        let names = LensModel::ALL.map(LensModel::name).join(", ");
        format!("expected one of {names}")
    })
}

fn angle(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(degrees) if degrees > 0.0 && degrees <= 180.0 => Ok(degrees),
        _ => Err("expected degrees above 0, at most 180".to_owned()),
    }
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let number = |text: &str| text.parse::<u32>().ok().filter(|n| *n > 0);
    text.split_once(['x', 'X'])
        .and_then(|(width, height)| Some([number(width)?, number(height)?]))
        .ok_or_else(|| "expected a width and a height, for example 1280x720".to_owned())
}

/// Runs `paws calib convert`.
///
/// # Errors
/// The file cannot be read, a lens cannot be converted, or the new file cannot be written.
pub(crate) fn run(options: &Options, console: &mut Console<'_>) -> Result<Outcome> {
    let (mut set, notes) = read(options)?;
    for line in table(&set) {
        console.line(line)?;
    }
    for note in notes {
        console.line(format!("note: {note}"))?;
    }
    if let Some(model) = options.model {
        let widest_rad = options.within.unwrap_or(180.0).to_radians();
        for camera in &mut set.cameras {
            let conversion = convert_within(&camera.model, model, widest_rad)
                .with_context(|| format!("camera {}", camera.name))?;
            console.line(format!("{}: {conversion}", camera.name))?;
            camera.model = conversion.model;
        }
    }
    let (files, notes) = match write_cameras(&set, options.to, &options.out) {
        Ok(written) => written,
        Err(error @ calibration_files::WriteError::Lens { nearest, .. }) => {
            bail!("{error} (--model {nearest})")
        }
        Err(error) => return Err(error.into()),
    };
    for note in notes {
        console.line(format!("note: {note}"))?;
    }
    for file in files {
        console.line(format!("wrote {}", file.display()))?;
    }
    Ok(Outcome::Fine)
}

/// Reads the cameras; the serial number is that of the file itself, not of the folder it is in.
fn read(options: &Options) -> Result<(CameraSet, Vec<Note>)> {
    let mut unchecked = None;
    if let Some(serial) = &options.serial {
        let (_, file) = detect_format(&options.source)?;
        match zed_conf::serial_in_name(&file) {
            Some(_) => zed_conf::expect_serial(&file, serial)?,
            None => unchecked = Some(Note(SERIAL_NOT_CHECKED.to_owned())),
        }
    }
    let (set, mut notes) = read_cameras(&options.source, options.size)?;
    notes.extend(unchecked);
    Ok((set, notes))
}

/// The input, one line for each camera and one for the IMU.
fn table(set: &CameraSet) -> Vec<String> {
    let mut rows = vec![
        [
            "camera",
            "size",
            "fx",
            "fy",
            "cx",
            "cy",
            "lens",
            "position mm",
            "rotation deg",
        ]
        .map(str::to_owned),
    ];
    for camera in &set.cameras {
        let m = &camera.model;
        let (place, turned) = match &camera.camera_from_first {
            Some(t) => {
                let [x, y, z] = t.inverse().translation_m().map(|v| 1e3 * v);
                let degrees = t.angle_rad().to_degrees();
                (format!("{x:.2} {y:.2} {z:.2}"), format!("{degrees:.3}"))
            }
            None => ("unknown".to_owned(), "unknown".to_owned()),
        };
        let [fx, fy, cx, cy] = [m.fx, m.fy, m.cx, m.cy].map(|v| format!("{v:.3}"));
        rows.push([
            camera.name.clone(),
            format!("{}x{}", m.width, m.height),
            fx,
            fy,
            cx,
            cy,
            m.distortion.name().to_owned(),
            place,
            turned,
        ]);
    }
    let widths: [usize; 9] = std::array::from_fn(|i| {
        let lengths = rows.iter().map(|row| row[i].chars().count());
        lengths.max().unwrap_or(0)
    });
    let mut lines: Vec<String> = rows
        .iter()
        .map(|row| {
            let cells: Vec<String> = row
                .iter()
                .zip(widths)
                .map(|(cell, width)| format!("{cell:<width$}"))
                .collect();
            cells.join("  ").trim_end().to_owned()
        })
        .collect();
    for camera in &set.cameras {
        let lens = &camera.model.distortion;
        let numbers: Vec<String> = lens
            .coefficient_names()
            .iter()
            .zip(lens.coefficients())
            .map(|(name, value)| format!("{name} {value:.6}"))
            .collect();
        if !numbers.is_empty() {
            lines.push(format!("{}: {}", camera.name, numbers.join(", ")));
        }
    }
    if let Some(imu) = &set.imu {
        let [x, y, z] = imu
            .imu_from_first
            .inverse()
            .translation_m()
            .map(|v| 1e3 * v);
        let mut line = format!("imu: {x:.2} {y:.2} {z:.2} mm from the first camera");
        if let Some(rate) = imu.rate_hz {
            line.push_str(&format!(", {rate} Hz"));
        }
        if let Some(offset) = imu.time_offset_s {
            line.push_str(&format!(", {:.3} ms ahead of the cameras", 1e3 * offset));
        }
        if imu.noise.is_none() {
            line.push_str(", noise unknown");
        }
        lines.push(line);
    }
    let kind = set.provenance.format.as_deref().unwrap_or("");
    let files: Vec<String> = set
        .provenance
        .files
        .iter()
        .map(|file: &PathBuf| shown(file))
        .collect();
    lines.insert(0, format!("{kind}: {}", files.join(", ")));
    lines
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn serial_is_that_of_the_input_file() {
        let folder = tempfile::tempdir().unwrap();
        let camera = "fx=700\nfy=700\ncx=640\ncy=360\nk1=0.1\nk2=0\np1=0\np2=0\nk3=0\n";
        let text = format!(
            "[LEFT_CAM_HD]\n{camera}[RIGHT_CAM_HD]\n{camera}[STEREO]\nBaseline=63\nTY=0\nTZ=0\nCV_HD=0\nRX_HD=0\n\
             RZ_HD=0\n"
        );
        let file = folder.path().join("SN999.conf");
        std::fs::write(&file, &text).unwrap();
        let read = |source: &Path, serial: &str| {
            read(&Options {
                source: source.to_owned(),
                to: Format::Kalibr,
                out: PathBuf::new(),
                model: None,
                within: None,
                size: Some([1280, 720]),
                serial: Some(serial.to_owned()),
            })
        };
        for source in [folder.path(), file.as_path()] {
            let error = read(source, "41234567").unwrap_err().to_string();
            assert!(
                error.contains("found serial 999, expected 41234567"),
                "{error}"
            );
            assert!(read(source, "999").unwrap().1.is_empty());
        }
        let renamed = folder.path().join("left.conf");
        std::fs::rename(&file, &renamed).unwrap();
        for source in [folder.path(), renamed.as_path()] {
            let (_, notes) = read(source, "41234567").unwrap();
            assert_eq!(notes, [Note(SERIAL_NOT_CHECKED.to_owned())]);
        }
    }

    #[test]
    fn arguments() {
        assert_eq!(size("1280x720"), Ok([1280, 720]));
        assert!(size("1280").is_err() && size("0x720").is_err() && size("axb").is_err());
        assert_eq!(model("radtan4"), Ok(LensModel::RadTan4));
        assert!(model("brown").unwrap_err().contains("rad_tan5"));
        assert!(angle("70").is_ok() && angle("nan").is_err() && angle("0").is_err());
    }
}
