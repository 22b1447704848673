//! Placement of the tags on the shoes, corrected by the ground below the feet at rest.

use ::feet::PlacementConfig;
use ::feet::events::Contact;
use ::feet::tag_placement::{
    Estimate, PlacementError, Quantity, Slip, are_exchanged, gross_placement_error,
    placement_error, slip,
};
use cad_transforms::Covariance;
use cad_transforms::rig::Foot;
use scene_bundle::outputs::rig::RigModel;
use scene_bundle::outputs::terrain::TerrainMesh;

use super::super::soles::shoe;
use super::ground_below::{GroundBelow, corrected, places};
use crate::pipeline::Findings;

/// What the ground says of the placement of tags.
pub(super) struct Placements {
    /// Whether a placement was corrected.
    pub(super) is_corrected: bool,
    /// What is uncertain of the pose of each foot by what remains of its tag's tolerance.
    pub(super) uncertain: [Covariance; 2],
    /// Whether its tag slipped.
    pub(super) slipped: [bool; 2],
}

/// Corrects the placement of the tags by the ground below the feet at rest. Reports tags that
/// slipped, that are exchanged, and those that the ground contradicts.
pub(super) fn correct_placement(
    work: &Findings,
    rig: &mut RigModel,
    ground: &TerrainMesh,
    contacts: &[Vec<Contact>; 2],
) -> Placements {
    let config = PlacementConfig::default();
    let mut uncertain = [Covariance::zero(); 2];
    let mut slipped = [false; 2];
    let [left, right] = contacts.each_ref().map(|own| places(own));
    if are_exchanged([&left, &right], &config) {
        work.record_loss(
            "the tags of the left and the right shoe are exchanged: their feet step to the wrong \
             sides; exchange `foot` of [[shoe_tag]] in the rig file",
        );
    }
    let ground = GroundBelow::new(ground);
    let mut is_corrected = false;
    for (k, foot) in Foot::ALL.into_iter().enumerate() {
        let samples = ground.samples(&contacts[k]);
        let none = PlacementError::default();
        if let Some(tag) = shoe(rig, foot).and_then(|shoe| shoe.tags.first()) {
            uncertain[k] = corrected(tag, &none, &config).uncertain;
        }
        if let Some(slip) = slip(&samples, &config) {
            work.record_loss(slip_message(foot, &slip));
            slipped[k] = true;
            // Before and after it the placement differs.
            continue;
        }
        let error = placement_error(&samples, &config);
        let gross = gross_placement_error(&samples, &config);
        let shoes = rig.shoes.iter_mut().filter(|shoe| shoe.foot == foot);
        let mut contradicts = false;
        for (number, tag) in shoes.flat_map(|shoe| &mut shoe.tags).enumerate() {
            let correction = corrected(tag, &error, &config);
            contradicts |= correction.contradicts || corrected(tag, &gross, &config).contradicts;
            // Of two tags the less certain one counts for the pose.
            if number == 0 || height_sigma(&correction.uncertain) > height_sigma(&uncertain[k]) {
                uncertain[k] = correction.uncertain;
            }
            is_corrected |= correction.foot_from_tag != tag.foot_from_tag;
            tag.foot_from_tag = correction.foot_from_tag;
        }
        if contradicts {
            work.record_loss(placement_message(foot, &gross));
        } else if let Some(height) = error.height_m {
            let tilt = error
                .tilt_rad
                .map(|own| own.map_or(0.0, |own| own.value.to_degrees()));
            work.note(format!(
                "{}: by the ground below its contacts the sole was {:.1} ± {:.1} mm too {} and \
                 tilted by {:.1} and {:.1} degrees; its tag's placement is corrected by that as far \
                 as its tolerance allows",
                foot.as_str(),
                1e3 * height.value.abs(),
                1e3 * height.sigma,
                high_or_low(height.value),
                tilt[0],
                tilt[1]
            ));
        }
    }
    Placements {
        is_corrected,
        uncertain,
        slipped,
    }
}

/// One standard deviation of the height, m.
fn height_sigma(covariance: &Covariance) -> f64 {
    covariance.sigmas()[2]
}

fn slip_message(foot: Foot, slip: &Slip) -> String {
    let Estimate { value, sigma } = slip.change;
    let change = match slip.quantity {
        Quantity::Height => format!("rises by {:.1} ± {:.1} mm", 1e3 * value, 1e3 * sigma),
        quantity => {
            let axis = match quantity {
                Quantity::Roll => "about its length",
                Quantity::Pitch => "about its width",
                _ => "about the vertical",
            };
            let [value, sigma] = [value, sigma].map(f64::to_degrees);
            format!("rotates by {value:.1} ± {sigma:.1} degrees {axis}")
        }
    };
    format!(
        "{}: at {:.3} s of the clock the sole {change}: its tag has slipped, or the ground is of \
         another kind from there on",
        foot.as_str(),
        slip.time_s
    )
}

/// The side of a height error, for messages that state its size without its sign.
const fn high_or_low(height_m: f64) -> &'static str {
    if height_m < 0.0 { "low" } else { "high" }
}

fn placement_message(foot: Foot, error: &PlacementError) -> String {
    let height_m = error.height_m.map_or(0.0, |own| own.value);
    let tilt = error
        .tilt_rad
        .map(|own| own.map_or(0.0, |own| own.value.to_degrees()));
    format!(
        "{}: by the ground below its contacts the sole is {:.1} mm too {} and tilted by {:.1} \
         and {:.1} degrees, which is more than the tolerance of its tag: check size_m, \
         translation_m and rotation_wxyz of [[shoe_tag]] in the rig file; not corrected",
        foot.as_str(),
        1e3 * height_m.abs(),
        high_or_low(height_m),
        tilt[0],
        tilt[1]
    )
}
