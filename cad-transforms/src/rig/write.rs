//! Writing the rig file.

use std::fmt::Write as _;
use std::path::Path;

use super::{RIG_FORMAT, Rig, RigError, RigParts};
use crate::covariance::Covariance;
use crate::output::{self, Existing};
use crate::transform::RigidTransform;

impl Rig {
    /// The text of a rig file. The same rig gives the same bytes, and reading them gives the same
    /// rig to the last bit.
    pub fn to_toml(&self) -> String {
        text(&self.to_parts())
    }

    /// Writes a rig file. An existing file is kept unless `existing` says otherwise.
    ///
    /// # Errors
    /// [`RigError::Invalid`] when a loop is open or a text is empty, [`RigError::Write`]. Nothing
    /// is written then.
    pub fn write(&self, path: &Path, existing: Existing) -> Result<(), RigError> {
        self.closed()?;
        let rig = Self::from_parts(self.to_parts())?;
        Ok(output::write(path, rig.to_toml().as_bytes(), existing)?)
    }
}

/// Writing to a string does not fail.
macro_rules! put {
    ($out:expr, $($text:tt)*) => {{ let _ = writeln!($out, $($text)*); }};
}

pub(super) fn text(parts: &RigParts) -> String {
    let mut out = String::new();
    put!(
        out,
        "# b_from_a takes coordinates in a to coordinates in b; metres, radians."
    );
    put!(
        out,
        "# rig: x forward, y left, z up. NAME/left, NAME/right: x right, y down, z into the image."
    );
    put!(out, "");
    put!(out, "format = {RIG_FORMAT}");
    put!(out, "name = {}", quoted(&parts.name));
    put!(out, "revision = {}", quoted(&parts.revision));
    put!(out, "");
    put!(out, "[provenance]");
    put!(out, "kind = {}", quoted(parts.provenance.kind.as_str()));
    put!(out, "note = {}", quoted(&parts.provenance.note));
    if let Some(cad) = &parts.provenance.cad {
        put!(out, "cad_file = {}", quoted(&cad.file));
        put!(out, "cad_blake3 = {}", quoted(&cad.blake3));
    }
    for camera in &parts.cameras {
        put!(out, "\n[[camera]]");
        put!(out, "name = {}", quoted(&camera.name));
        if let Some(serial) = &camera.serial {
            put!(out, "serial = {}", quoted(serial));
        }
        if let Some(model) = &camera.model {
            put!(out, "model = {}", quoted(model));
        }
    }
    for edge in &parts.edges {
        put!(out, "\n[[parent_from_child]]");
        put!(out, "parent = {}", quoted(edge.parent.as_str()));
        put!(out, "child = {}", quoted(edge.child.as_str()));
        transform(&mut out, &edge.parent_from_child);
        tolerance(&mut out, edge.covariance.as_ref());
    }
    for closure in &parts.closures {
        put!(out, "\n[[closes_loop]]");
        put!(out, "parent = {}", quoted(closure.parent.as_str()));
        put!(out, "child = {}", quoted(closure.child.as_str()));
        transform(&mut out, &closure.parent_from_child);
        put!(out, "within_m = {:?}", closure.within_m);
        put!(out, "within_rad = {:?}", closure.within_rad);
    }
    for tag in &parts.shoe_tags {
        put!(out, "\n[[shoe_tag]]");
        put!(out, "family = {}", quoted(tag.family.as_str()));
        put!(out, "id = {}", tag.id);
        put!(out, "foot = {}", quoted(tag.foot.as_str()));
        put!(out, "size_m = {:?}", tag.size_m);
        transform(&mut out, &tag.foot_from_tag);
        if let Some(sigma_m) = tag.size_sigma_m {
            put!(out, "sigma_size_m = {sigma_m:?}");
        }
        tolerance(&mut out, tag.covariance.as_ref());
    }
    for sole in &parts.soles {
        put!(out, "\n[[sole]]");
        put!(out, "foot = {}", quoted(sole.foot.as_str()));
        let vertices: Vec<String> = sole.outline_m.iter().map(|at| list(at)).collect();
        put!(out, "outline_m = [{}]", vertices.join(", "));
        if let Some(sigma_m) = sole.sigma_m {
            put!(out, "sigma_m = {sigma_m:?}");
        }
    }
    out
}

fn transform(out: &mut String, transform: &RigidTransform) {
    put!(out, "rotation_wxyz = {}", list(&transform.rotation_wxyz()));
    put!(out, "translation_m = {}", list(&transform.translation_m()));
}

fn tolerance(out: &mut String, covariance: Option<&Covariance>) {
    let Some(covariance) = covariance else {
        return;
    };
    let sigmas = covariance.sigmas();
    let (shift, turn) = sigmas.split_at(3);
    let as_sigmas =
        Covariance::from_sigmas([shift[0], shift[1], shift[2]], [turn[0], turn[1], turn[2]]);
    if as_sigmas.as_ref() == Ok(covariance) {
        put!(out, "sigma_translation_m = {}", short(shift));
        put!(out, "sigma_rotation_rad = {}", short(turn));
        return;
    }
    put!(out, "covariance = [");
    for row in covariance.rows() {
        put!(out, "    {},", list(&row));
    }
    put!(out, "]");
}

/// One number where all three are the same.
fn short(sigmas: &[f64]) -> String {
    match sigmas {
        [x, y, z] if x == y && y == z => format!("{x:?}"),
        all => list(all),
    }
}

/// Shortest digits that read back as the same numbers.
fn list(numbers: &[f64]) -> String {
    // Adding 0 takes the sign off a zero.
    let numbers: Vec<String> = numbers.iter().map(|v| format!("{:?}", v + 0.0)).collect();
    format!("[{}]", numbers.join(", "))
}

/// A TOML basic string.
pub(crate) fn quoted(text: &str) -> String {
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\t' => out.push_str("\\t"),
            c if c.is_control() => {
                let _ = write!(out, "\\u{:04X}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push('"');
    out
}
