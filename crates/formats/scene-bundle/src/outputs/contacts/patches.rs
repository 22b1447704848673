//! `patches.npy` and `patch-vertices.npy` of the output `contacts`: the parts of soles that bear.

use crate::draft::Draft;
use crate::error::BundleError;
use crate::npy::{Column, Fields, Kind, TableWriter, rows};
use crate::outputs::Fault;
use crate::scene::OutputReader;

const TABLE: &str = "patches.npy";
const VERTICES: &str = "patch-vertices.npy";

const COLUMNS: [Column; 4] = [
    Column("vertices", Kind::U32, 1),
    Column("area_share", Kind::F32, 1),
    Column("ground_share", Kind::F32, 1),
    Column("gap_m", Kind::F32, 1),
];
const VERTEX_COLUMNS: [Column; 1] = [Column("position_m", Kind::F64, 3)];

/// The part of a sole at rest that bears.
#[derive(Clone, Debug, PartialEq)]
pub struct ContactPatch {
    /// Corners on the plane of the sole in the world, m; three or more.
    pub outline_m: Vec<[f64; 3]>,
    /// Its area as a share of the sole's, 0 to 1.
    pub area_share: f32,
    /// Share of it below which depth shows ground, 0 to 1.
    pub ground_share: f32,
    /// Height of the sole above that ground, median, m. None where depth shows none.
    pub gap_m: Option<f32>,
}

/// What is wrong with patches; `contacts` is their number.
fn check(patches: &[ContactPatch], contacts: usize) -> Result<(), Fault> {
    if patches.len() != contacts {
        let found = format!("{} rows", patches.len());
        return Err(Fault::new("table", found, "a row for each contact"));
    }
    for (row, patch) in patches.iter().enumerate() {
        let corners = &patch.outline_m;
        let fault = |found, expected| Err(Fault::new(&format!("row {row}"), found, expected));
        if corners.len() < 3 {
            let found = format!("an outline of {} vertices", corners.len());
            return fault(found, "three vertices or more");
        }
        if !corners.as_flattened().iter().all(|v| v.is_finite()) {
            return fault("a vertex that is not finite".to_owned(), "metres");
        }
        let shares = [patch.area_share, patch.ground_share];
        if !shares.iter().all(|share| (0.0..=1.0).contains(share)) {
            return fault(format!("shares {shares:?}"), "0 to 1");
        }
        if let Some(gap_m) = patch.gap_m.filter(|gap_m| !gap_m.is_finite()) {
            return fault(format!("gap_m {gap_m}"), "metres, or NaN");
        }
    }
    Ok(())
}

pub(super) fn write(
    draft: &Draft,
    patches: &[ContactPatch],
    contacts: usize,
) -> Result<(), BundleError> {
    check(patches, contacts).map_err(|fault| fault.refused(draft, TABLE))?;
    let mut table = TableWriter::create(draft, TABLE, &COLUMNS)?;
    for patch in patches {
        table.row(|row| {
            row.u32(patch.outline_m.len() as u32);
            row.f32(&[patch.area_share, patch.ground_share]);
            row.f32(&[patch.gap_m.unwrap_or(f32::NAN)]);
        })?;
    }
    table.finish()?;
    let mut vertices = TableWriter::create(draft, VERTICES, &VERTEX_COLUMNS)?;
    for vertex in patches.iter().flat_map(|patch| &patch.outline_m) {
        vertices.row(|row| row.f64(vertex))?;
    }
    vertices.finish()
}

/// Reads the patches of contacts, in the order of `contacts.npy`; `contacts` is their number.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_patches(
    reader: &OutputReader,
    contacts: usize,
) -> Result<Vec<ContactPatch>, BundleError> {
    let bytes = reader.read(VERTICES)?;
    let path = reader.file_path(VERTICES);
    let vertices = rows(&bytes, &VERTEX_COLUMNS, &path)?;
    let vertices: Vec<[f64; 3]> = vertices.map(|mut fields| fields.f64()).collect();
    let bytes = reader.read(TABLE)?;
    let path = reader.file_path(TABLE);
    let mut rest = vertices.as_slice();
    let mut patches = Vec::new();
    for (row, fields) in rows(&bytes, &COLUMNS, &path)?.enumerate() {
        let (count, patch) = patch(fields);
        let Some((own, others)) = rest.split_at_checked(count) else {
            let found = format!("{count} vertices, of which {} are there", rest.len());
            let fault = Fault::new(
                &format!("row {row}"),
                found,
                "vertices of patch-vertices.npy",
            );
            return Err(fault.malformed(reader, TABLE));
        };
        rest = others;
        patches.push(ContactPatch {
            outline_m: own.to_vec(),
            ..patch
        });
    }
    if !rest.is_empty() {
        let found = format!("{} rows too many", rest.len());
        let fault = Fault::new("table", found, "the vertices of the patches of patches.npy");
        return Err(fault.malformed(reader, VERTICES));
    }
    check(&patches, contacts).map_err(|fault| fault.malformed(reader, TABLE))?;
    Ok(patches)
}

/// Number of vertices, and a patch without them.
fn patch(mut fields: Fields<'_>) -> (usize, ContactPatch) {
    let count = fields.u32() as usize;
    let [area_share, ground_share, gap_m] = [(); 3].map(|()| {
        let [value] = fields.f32();
        value
    });
    let patch = ContactPatch {
        outline_m: Vec::new(),
        area_share,
        ground_share,
        gap_m: (!gap_m.is_nan()).then_some(gap_m),
    };
    (count, patch)
}
