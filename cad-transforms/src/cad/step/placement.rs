//! Placements: axes, operators, relationships, mapped items.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::fields::Fields;
use super::units::Units;
use crate::cad::part21::{Exchange, Instance};
use crate::cad::{Fault, step_of_path};
use crate::transform::RigidTransform;

/// Scale factors are written with few digits; beyond this an operator does scale.
const SCALE_TOLERANCE: f64 = 1e-9;

/// A shape placed in another.
pub(super) struct MappedItem {
    pub(super) item: u64,
    pub(super) name: String,
    /// The shape that is placed.
    pub(super) shape: u64,
    pub(super) shape_name: String,
    pub(super) parent_from_child: RigidTransform,
    pub(super) place: String,
}

/// Where the axes of an AXIS2_PLACEMENT_3D are: takes coordinates in them to those they are written
/// in.
pub(super) fn axes(exchange: &Exchange<'_>, id: u64, metre: f64) -> Result<RigidTransform, Fault> {
    let fields = Fields::of(exchange, id, "AXIS2_PLACEMENT_3D")?;
    let origin = point(exchange, fields.reference(1)?, metre)?;
    let z = direction(exchange, fields.optional_reference(2)?)?.unwrap_or_else(Vector3::z);
    let towards_x = direction(exchange, fields.optional_reference(3)?)?;
    // ISO 10303-42, 4.5.21: without a reference direction it is x, or y where z lies along x.
    let towards_x = towards_x.unwrap_or_else(|| {
        if z.cross(&Vector3::x()).norm() > 1e-9 {
            Vector3::x()
        } else {
            Vector3::y()
        }
    });
    let x = towards_x - z * z.dot(&towards_x);
    let length = x.norm();
    if length < 1e-6 {
        return Err(fields.fault("the axis and the reference direction are parallel"));
    }
    frame(&fields, x / length, z, origin)
}

fn frame(
    fields: &Fields,
    x: Vector3<f64>,
    z: Vector3<f64>,
    origin: [f64; 3],
) -> Result<RigidTransform, Fault> {
    let y = z.cross(&x);
    let rows = [x.x, y.x, z.x, x.y, y.y, z.y, x.z, y.z, z.z];
    RigidTransform::from_rotation_rows(rows, origin)
        .map_err(|error| fields.fault(error.to_string()))
}

fn point(exchange: &Exchange<'_>, id: u64, metre: f64) -> Result<[f64; 3], Fault> {
    let coordinates = Fields::of(exchange, id, "CARTESIAN_POINT")?.three(1)?;
    Ok(coordinates.map(|v| v * metre))
}

fn direction(exchange: &Exchange<'_>, id: Option<u64>) -> Result<Option<Vector3<f64>>, Fault> {
    let Some(id) = id else { return Ok(None) };
    let fields = Fields::of(exchange, id, "DIRECTION")?;
    let vector = Vector3::from(fields.three(1)?);
    let length = vector.norm();
    if !(length.is_finite() && length > 1e-9) {
        return Err(fields.fault("is a direction without length"));
    }
    Ok(Some(vector / length))
}

/// `parent_from_child` of a relationship with transformation between a shape of the parent and one
/// of the child.
pub(super) fn relationship(
    exchange: &Exchange<'_>,
    units: &Units<'_, '_>,
    id: u64,
    of_parent: &BTreeSet<u64>,
    of_child: &BTreeSet<u64>,
) -> Result<RigidTransform, Fault> {
    let instance = exchange.instance(id)?;
    let with = instance.record("REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION");
    let Some(with) = with else {
        let message =
            "places an occurrence, but is no REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION";
        return Err(Fault::new(instance.place(), message));
    };
    // Alone it has all five parameters; in a complex instance the first four are its supertype's.
    let (ends, operator) = match instance.record("REPRESENTATION_RELATIONSHIP") {
        Some(ends) => (
            Fields::new(&instance, ends),
            Fields::new(&instance, with).reference(0)?,
        ),
        None => {
            let all = Fields::new(&instance, with);
            let operator = all.reference(4)?;
            (all, operator)
        }
    };
    let (first, second) = (ends.reference(2)?, ends.reference(3)?);
    // The operator takes the first shape to the second, and programs differ in which is the
    // child's.
    let child_is_first = match (of_child.contains(&first), of_child.contains(&second)) {
        (true, false) => true,
        (false, true) => false,
        _ => match (of_parent.contains(&first), of_parent.contains(&second)) {
            (false, true) => true,
            (true, false) => false,
            _ => {
                let message =
                    "relates two shapes, neither of which is known as the part's or the assembly's";
                return Err(ends.fault(message));
            }
        },
    };
    let second_from_first = operator_of(exchange, units, operator, first, second)?;
    Ok(if child_is_first {
        second_from_first
    } else {
        second_from_first.inverse()
    })
}

/// What an operator does to the first shape to put it into the second.
fn operator_of(
    exchange: &Exchange<'_>,
    units: &Units<'_, '_>,
    operator: u64,
    first: u64,
    second: u64,
) -> Result<RigidTransform, Fault> {
    let instance = exchange.instance(operator)?;
    let (of_first, of_second) = (units.metres(first)?, units.metres(second)?);
    if let Some(record) = instance.record("ITEM_DEFINED_TRANSFORMATION") {
        let fields = Fields::new(&instance, record);
        let from = axes(exchange, fields.reference(2)?, of_first)?;
        let to = axes(exchange, fields.reference(3)?, of_second)?;
        return Ok(to * from.inverse());
    }
    if let Some(found) = cartesian(exchange, &instance, of_second)? {
        return Ok(found);
    }
    let message = "is a transformation of an unknown kind, expected ITEM_DEFINED_TRANSFORMATION or \
                   CARTESIAN_TRANSFORMATION_OPERATOR_3D";
    Err(Fault::new(instance.place(), message))
}

/// A CARTESIAN_TRANSFORMATION_OPERATOR_3D, alone or with its supertypes in a complex instance.
fn cartesian(
    exchange: &Exchange<'_>,
    instance: &Instance,
    metre: f64,
) -> Result<Option<RigidTransform>, Fault> {
    let Some(own) = instance.record("CARTESIAN_TRANSFORMATION_OPERATOR_3D") else {
        return Ok(None);
    };
    // name, axis1, axis2, origin, scale of the supertype, then axis3. As a functional
    // transformation there is a description between; the complex form spreads them over two
    // records.
    let (base, at, axis3) = match instance.record("CARTESIAN_TRANSFORMATION_OPERATOR") {
        Some(base) => {
            let at = base.parameters.len().saturating_sub(4);
            (Fields::new(instance, base), at, 0)
        }
        None => {
            let at = own.parameters.len().saturating_sub(5);
            (Fields::new(instance, own), at, at + 4)
        }
    };
    let third = Fields::new(instance, own).optional_reference(axis3)?;
    if let Some(scale) = base.optional_number(at + 3)?
        && (scale - 1.0).abs() > SCALE_TOLERANCE
    {
        return Err(base.fault(format!("scales by {scale}, expected 1")));
    }
    let origin = point(exchange, base.reference(at + 2)?, metre)?;
    // ISO 10303-42, 4.4.24 (base_axis): z leads, x is made square to it, y to both; a given y only
    // determines the handedness.
    let z = direction(exchange, third)?.unwrap_or_else(Vector3::z);
    let x = direction(exchange, base.optional_reference(at)?)?.unwrap_or_else(|| {
        if z.cross(&Vector3::x()).norm() > 1e-9 {
            Vector3::x()
        } else {
            Vector3::y()
        }
    });
    let x = x - z * z.dot(&x);
    if x.norm() < 1e-6 {
        return Err(base.fault("its first and third axes are parallel"));
    }
    let x = x.normalize();
    if let Some(y) = direction(exchange, base.optional_reference(at + 1)?)?
        && z.cross(&x).dot(&y) < 0.0
    {
        return Err(base.fault("mirrors the part: its axes are left-handed"));
    }
    frame(&base, x, z, origin).map(Some)
}

/// A MAPPED_ITEM in shape `parent`.
pub(super) fn mapped_item(
    exchange: &Exchange<'_>,
    units: &Units<'_, '_>,
    instance: &Instance,
    parent: u64,
) -> Result<MappedItem, Fault> {
    let item = Fields::of(exchange, instance.id, "MAPPED_ITEM")?;
    let (map, target) = (item.reference(1)?, item.reference(2)?);
    let map = Fields::of(exchange, map, "REPRESENTATION_MAP")?;
    let (origin, shape) = (map.reference(0)?, map.reference(1)?);
    let (of_parent, of_shape) = (units.metres(parent)?, units.metres(shape)?);
    let shape_from_origin = axes(exchange, origin, of_shape)?;
    let target = exchange.instance(target)?;
    // An operator takes the whole shape; axes are where the origin's axes go.
    let parent_from_child = match cartesian(exchange, &target, of_parent)? {
        Some(operator) => operator,
        None => axes(exchange, target.id, of_parent)? * shape_from_origin.inverse(),
    };
    let shape_instance = exchange.instance(shape)?;
    let shape_name = match shape_instance.records.as_slice() {
        [only] => Fields::new(&shape_instance, only).text(0)?,
        _ => String::new(),
    };
    Ok(MappedItem {
        item: instance.id,
        name: step_of_path(&item.text(0)?),
        shape,
        shape_name: step_of_path(&shape_name),
        parent_from_child,
        place: instance.place(),
    })
}
