//! The unit of length of a representation.

use super::fields::Fields;
use crate::cad::Fault;
use crate::cad::part21::{Exchange, Instance};

/// Looks units up.
pub(super) struct Units<'e, 'b> {
    exchange: &'e Exchange<'b>,
}

/// Deepest chain of units defined by units.
const DEEPEST: usize = 8;

impl<'e, 'b> Units<'e, 'b> {
    pub(super) fn new(exchange: &'e Exchange<'b>) -> Self {
        Self { exchange }
    }

    /// Metres in one unit of length of this representation.
    pub(super) fn metres(&self, representation: u64) -> Result<f64, Fault> {
        let instance = self.exchange.instance(representation)?;
        let record = instance.record("REPRESENTATION").or_else(|| {
            instance
                .records
                .iter()
                .find(|r| r.name.ends_with("REPRESENTATION"))
        });
        let Some(record) = record else {
            return Err(Fault::new(instance.place(), "is no representation"));
        };
        let context = Fields::new(&instance, record).reference(2)?;
        let context = self.exchange.instance(context)?;
        let Some(record) = context.record("GLOBAL_UNIT_ASSIGNED_CONTEXT") else {
            let message = "has no GLOBAL_UNIT_ASSIGNED_CONTEXT: the unit of length is not known";
            return Err(Fault::new(context.place(), message));
        };
        // A context on its own has the identifier and the type of the context before the units.
        let index = if context.records.len() == 1 { 2 } else { 0 };
        for unit in Fields::new(&context, record).references(index)? {
            let unit = self.exchange.instance(unit)?;
            if unit.record("LENGTH_UNIT").is_some() {
                return self.metres_of(&unit, DEEPEST);
            }
        }
        let message = "names no LENGTH_UNIT: the unit of length is not known";
        Err(Fault::new(context.place(), message))
    }

    fn metres_of(&self, unit: &Instance, deep: usize) -> Result<f64, Fault> {
        if deep == 0 {
            return Err(Fault::new(unit.place(), "is a unit defined by itself"));
        }
        if let Some(record) = unit.record("SI_UNIT") {
            let fields = Fields::new(unit, record);
            // On its own it is SI_UNIT(dimensions, prefix, name); in a complex instance without the
            // first.
            let at = record.parameters.len().saturating_sub(2);
            let name = fields.enumeration(at + 1)?;
            if name.as_deref() != Some("METRE") {
                return Err(
                    fields.fault(format!("is {}, expected METRE", name.unwrap_or_default()))
                );
            }
            return match fields.enumeration(at)? {
                None => Ok(1.0),
                Some(prefix) => prefix_factor(&prefix)
                    .ok_or_else(|| fields.fault(format!("has the unknown prefix {prefix}"))),
            };
        }
        if let Some(record) = unit.record("CONVERSION_BASED_UNIT") {
            let fields = Fields::new(unit, record);
            let at = record.parameters.len().saturating_sub(1);
            let measure = self.exchange.instance(fields.reference(at)?)?;
            let record = ["MEASURE_WITH_UNIT", "LENGTH_MEASURE_WITH_UNIT"]
                .into_iter()
                .filter_map(|name| measure.record(name))
                .find(|record| !record.parameters.is_empty());
            let Some(record) = record else {
                let message = "is no LENGTH_MEASURE_WITH_UNIT";
                return Err(Fault::new(measure.place(), message));
            };
            let fields = Fields::new(&measure, record);
            let factor = fields.optional_number(0)?;
            let factor = factor
                .filter(|f| *f > 0.0)
                .ok_or_else(|| fields.fault("is not a length above 0"))?;
            let unit = self.exchange.instance(fields.reference(1)?)?;
            return Ok(factor * self.metres_of(&unit, deep - 1)?);
        }
        let message =
            "is a unit of length of an unknown kind, expected SI_UNIT or CONVERSION_BASED_UNIT";
        Err(Fault::new(unit.place(), message))
    }
}

fn prefix_factor(prefix: &str) -> Option<f64> {
    Some(match prefix {
        "KILO" => 1e3,
        "HECTO" => 1e2,
        "DECA" => 1e1,
        "DECI" => 1e-1,
        "CENTI" => 1e-2,
        "MILLI" => 1e-3,
        "MICRO" => 1e-6,
        "NANO" => 1e-9,
        _ => return None,
    })
}
