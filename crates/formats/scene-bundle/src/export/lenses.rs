//! Conversion of a camera model to one that a format supports.

use calibration_files::Format;
use camera_models::{CameraModel, LensModel, convert, exactly};

use super::error::ExportError;

/// Maximum error of a fitted camera model, pixels; a larger one counts as a loss. *Why:* features
/// are matched to about a tenth of a pixel.
const MAX_FIT_ERROR_PX: f64 = 0.1;

/// A camera model that the format supports.
pub(super) struct FittedLens {
    pub(super) model: CameraModel,
    /// Error of the fit, where it is not exact.
    pub(super) note: Option<String>,
    /// Loss, where the error of the fit is too large.
    pub(super) lost: Option<String>,
}

/// The camera with a lens model of the format: exactly where the format has an equivalent one, else
/// the nearest of its kind, fitted over the whole image.
pub(super) fn fitted(
    name: &str,
    model: &CameraModel,
    format: Format,
) -> Result<FittedLens, ExportError> {
    let held = format.models();
    let exact = held
        .iter()
        .find_map(|target| exactly(&model.distortion, *target));
    if let Some(distortion) = exact {
        return Ok(FittedLens {
            model: CameraModel {
                distortion,
                ..*model
            },
            note: None,
            lost: None,
        });
    }
    let refused = |found: String| ExportError::Refused {
        format: format.name(),
        found,
        expected: "a lens that it can hold".to_owned(),
    };
    let what = model.distortion.name();
    let is_narrow = model.distortion.rational().is_some();
    // The largest of its kind comes nearest.
    let target = if is_narrow {
        held.iter().rev().find(|m| {
            ![
                LensModel::KannalaBrandt4,
                LensModel::DoubleSphere,
                LensModel::Eucm,
            ]
            .contains(m)
        })
    } else {
        held.iter().find(|m| **m == LensModel::KannalaBrandt4)
    };
    let target = *target.ok_or_else(|| refused(format!("the lens {what} of {name}")))?;
    let found = convert(model, target)
        .map_err(|e| refused(format!("the lens {what} of {name}, where {e}")))?;
    let text = format!(
        "the lens {what} of {name} is written as {}, with an error of at most {:.3} px, {:.3} px root mean square",
        target.name(),
        found.max_px,
        found.rms_px
    );
    let outside = (found.lost > 0.0).then(|| {
        format!(
            "{:.1} % of the image of {name} cannot be represented in {}",
            100.0 * found.lost,
            target.name()
        )
    });
    let far = (found.max_px > MAX_FIT_ERROR_PX).then(|| text.clone());
    Ok(FittedLens {
        model: found.model,
        note: (found.max_px <= MAX_FIT_ERROR_PX).then_some(text),
        lost: outside.or(far),
    })
}
