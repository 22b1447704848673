//! Output `contacts`: `contacts.npy`, a row per contact of a foot with the ground, `patches.npy`
//! with `patch-vertices.npy`, the part of the sole that bears in each, and `views.npy`, a row per
//! contact and keyframe that shows its place.
//!
//! Contract: contacts are sorted by the time of the heel strike and the foot, each once, patches
//! as contacts, views by contact, time and camera.

mod patches;
mod views;

pub use patches::{ContactPatch, read_patches};
pub use views::{ContactView, read_views};

use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};

use super::tag_detections::{foot_code, foot_of};
use super::trajectory::{from_upper, upper};
use super::{malformed, refused};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::scene::OutputReader;

const TABLE: &str = "contacts.npy";

/// Names of the events of a contact, in their order.
pub const EVENTS: [&str; 4] = ["heel_strike", "foot_flat", "heel_off", "toe_off"];

const COLUMNS: [Column; 16] = [
    Column("foot", Kind::U8, 1),
    Column("heel_strike_ns", Kind::I64, 1),
    Column("heel_strike_sigma_s", Kind::F32, 1),
    Column("heel_strike_seen", Kind::Bool, 1),
    Column("foot_flat_ns", Kind::I64, 1),
    Column("foot_flat_sigma_s", Kind::F32, 1),
    Column("foot_flat_seen", Kind::Bool, 1),
    Column("heel_off_ns", Kind::I64, 1),
    Column("heel_off_sigma_s", Kind::F32, 1),
    Column("heel_off_seen", Kind::Bool, 1),
    Column("toe_off_ns", Kind::I64, 1),
    Column("toe_off_sigma_s", Kind::F32, 1),
    Column("toe_off_seen", Kind::Bool, 1),
    Column("position_m", Kind::F64, 3),
    Column("rotation_wxyz", Kind::F64, 4),
    Column("covariance", Kind::F64, 21),
];

/// An instant of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactEvent {
    /// Its time, ns.
    pub time_ns: i64,
    /// Standard deviation of that, s.
    pub sigma_s: f32,
    /// Whether frames show it; otherwise it follows from the gait.
    pub is_seen: bool,
}

/// A contact of a foot with the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootContact {
    /// The foot.
    pub foot: Foot,
    /// Heel strike, foot flat, heel off and toe off, see [`EVENTS`].
    pub events: [ContactEvent; 4],
    /// Takes points in the frame of the foot at rest to the world, metres.
    pub world_from_foot: RigidTransform,
    /// Covariance of a small motion of the foot in its own axes, in the rig.
    pub covariance: Covariance,
}

/// Writes contacts, sorted by the time of the heel strike and the foot, with a patch each, and the
/// keyframes that show their places, sorted by contact, time and camera.
///
/// # Errors
/// [`BundleError::Refused`] if they are not sorted, or if a patch is missing;
/// [`BundleError::Io`].
pub fn write(
    draft: &Draft,
    contacts: &[FootContact],
    patches: &[ContactPatch],
    views: &[ContactView],
) -> Result<(), BundleError> {
    if let Some((_, found)) = unsorted(contacts) {
        return Err(refused(draft, TABLE, found, SORTED));
    }
    let mut table = TableWriter::create(draft, TABLE, &COLUMNS)?;
    for contact in contacts {
        table.row(|row| {
            row.u8(foot_code(contact.foot));
            for event in &contact.events {
                row.i64(event.time_ns);
                row.f32(&[event.sigma_s]);
                row.bool(event.is_seen);
            }
            row.f64(&contact.world_from_foot.translation_m());
            row.f64(&contact.world_from_foot.rotation_wxyz());
            row.f64(&upper(&contact.covariance));
        })?;
    }
    table.finish()?;
    patches::write(draft, patches, contacts.len())?;
    views::write(draft, views, contacts.len())
}

/// Reads contacts, sorted by the time of the heel strike and the foot.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Vec<FootContact>, BundleError> {
    let bytes = reader.read(TABLE)?;
    let path = reader.file_path(TABLE);
    let rows = rows(&bytes, &COLUMNS, &path)?.enumerate();
    let contacts = rows.map(|(row, fields)| {
        contact(fields).map_err(|(found, expected)| {
            malformed(path.clone(), format!("row {row}"), found, expected)
        })
    });
    let contacts: Vec<FootContact> = contacts.collect::<Result<_, _>>()?;
    match unsorted(&contacts) {
        Some((row, found)) => Err(malformed(path, format!("row {row}"), found, SORTED)),
        None => Ok(contacts),
    }
}

const SORTED: &str = "contacts sorted by heel strike and foot, each once";

/// The first row that is not behind the one before, and both keys.
fn unsorted(contacts: &[FootContact]) -> Option<(usize, String)> {
    let key = |contact: &FootContact| (contact.events[0].time_ns, contact.foot);
    let row = 1 + contacts
        .windows(2)
        .position(|pair| key(&pair[0]) >= key(&pair[1]))?;
    let found = format!(
        "{:?} before {:?}",
        key(&contacts[row - 1]),
        key(&contacts[row])
    );
    Some((row, found))
}

/// A row, or what was found and expected.
fn contact(mut fields: Fields<'_>) -> Result<FootContact, (String, &'static str)> {
    let code = fields.u8();
    let foot = foot_of(code).ok_or((format!("foot {code}"), "0 or 1"))?;
    let events = std::array::from_fn(|_| {
        let time_ns = fields.i64();
        let [sigma_s] = fields.f32();
        ContactEvent {
            time_ns,
            sigma_s,
            is_seen: fields.bool(),
        }
    });
    let (position, rotation): ([f64; 3], [f64; 4]) = (fields.f64(), fields.f64());
    let world_from_foot = RigidTransform::from_wxyz(rotation, position);
    let covariance = from_upper(&fields.f64::<21>());
    Ok(FootContact {
        foot,
        events,
        world_from_foot: world_from_foot.map_err(|e| (e.to_string(), "a pose"))?,
        covariance: covariance.map_err(|e| (e.to_string(), "a covariance"))?,
    })
}
