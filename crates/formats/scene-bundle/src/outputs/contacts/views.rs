//! `views.npy` of the output `contacts`: keyframes that show the place of a contact.

use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::outputs::{malformed, refused};
use crate::scene::OutputReader;

const TABLE: &str = "views.npy";

const COLUMNS: [Column; 7] = [
    Column("contact", Kind::U64, 1),
    Column("camera", Kind::U8, 1),
    Column("frame", Kind::U64, 1),
    Column("time_ns", Kind::I64, 1),
    Column("pixel", Kind::F32, 2),
    Column("distance_m", Kind::F32, 1),
    Column("visible_share", Kind::F32, 1),
];

/// A keyframe that shows the place of a contact before or after the foot stood there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactView {
    /// The contact: its row in `contacts.npy`, from 0.
    pub contact: u64,
    /// The camera: its index in the output `rig`, from 0.
    pub camera: u8,
    /// Number of the frame among those of its camera.
    pub frame: u64,
    /// Time of the frame, ns.
    pub time_ns: i64,
    /// Middle of the sole in the recorded left image: column and row, px.
    pub pixel: [f32; 2],
    /// Distance of the camera from it, m.
    pub distance_m: f32,
    /// Share of the sole's outline that is in the image and not hidden.
    pub visible_share: f32,
}

const SORTED: &str = "views of contacts sorted by contact, time and camera, each once";

fn key(view: &ContactView) -> (u64, i64, u8) {
    (view.contact, view.time_ns, view.camera)
}

/// The first row that is not as it has to be, with what was found and expected.
fn fault(views: &[ContactView], contacts: usize) -> Option<(usize, String, &'static str)> {
    let is_known = |view: &ContactView| (view.contact as usize) < contacts;
    if let Some(row) = views.iter().position(|view| !is_known(view)) {
        let found = format!("contact {} of {contacts}", views[row].contact);
        return Some((row, found, "a contact of contacts.npy"));
    }
    let unsorted = |pair: &[ContactView]| key(&pair[0]) >= key(&pair[1]);
    let row = 1 + views.windows(2).position(unsorted)?;
    let found = format!("{:?} before {:?}", key(&views[row - 1]), key(&views[row]));
    Some((row, found, SORTED))
}

pub(super) fn write(
    draft: &Draft,
    views: &[ContactView],
    contacts: usize,
) -> Result<(), BundleError> {
    if let Some((_, found, expected)) = fault(views, contacts) {
        return Err(refused(draft, TABLE, found, expected));
    }
    let mut table = TableWriter::create(draft, TABLE, &COLUMNS)?;
    for view in views {
        table.row(|row| {
            row.u64(view.contact);
            row.u8(view.camera);
            row.u64(view.frame);
            row.i64(view.time_ns);
            row.f32(&view.pixel);
            row.f32(&[view.distance_m, view.visible_share]);
        })?;
    }
    table.finish()
}

/// Reads the keyframes that show the places of contacts, sorted by contact, time and camera;
/// `contacts` is the number of contacts.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_views(reader: &OutputReader, contacts: usize) -> Result<Vec<ContactView>, BundleError> {
    let bytes = reader.read(TABLE)?;
    let path = reader.file_path(TABLE);
    let views: Vec<ContactView> = rows(&bytes, &COLUMNS, &path)?.map(view).collect();
    match fault(&views, contacts) {
        Some((row, found, expected)) => Err(malformed(path, format!("row {row}"), found, expected)),
        None => Ok(views),
    }
}

fn view(mut fields: Fields<'_>) -> ContactView {
    let (contact, camera, frame) = (fields.u64(), fields.u8(), fields.u64());
    let (time_ns, pixel) = (fields.i64(), fields.f32());
    let [distance_m] = fields.f32();
    let [visible_share] = fields.f32();
    ContactView {
        contact,
        camera,
        frame,
        time_ns,
        pixel,
        distance_m,
        visible_share,
    }
}
