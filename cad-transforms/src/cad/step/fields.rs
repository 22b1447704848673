//! Parameters of a record by their place, with complaints that name the entity.

use crate::cad::Fault;
use crate::cad::part21::{Exchange, Instance, Record, Value};

/// A record of an instance.
pub(super) struct Fields {
    place: String,
    record: Record,
}

impl Fields {
    pub(super) fn new(instance: &Instance, record: &Record) -> Self {
        Self {
            place: instance.place(),
            record: record.clone(),
        }
    }

    /// The record called `name` of instance `id`.
    pub(super) fn of(exchange: &Exchange<'_>, id: u64, name: &str) -> Result<Self, Fault> {
        let instance = exchange.instance(id)?;
        match instance.record(name) {
            Some(record) => Ok(Self::new(&instance, record)),
            None => {
                let found: Vec<&str> = instance.records.iter().map(|r| r.name.as_str()).collect();
                let message = format!("is {}, expected {name}", found.join(" "));
                Err(Fault::new(instance.place(), message))
            }
        }
    }

    pub(super) fn place(&self) -> String {
        self.place.clone()
    }

    pub(super) fn fault(&self, message: impl Into<String>) -> Fault {
        Fault::new(
            format!("{}, {}", self.place, self.record.name),
            message.into(),
        )
    }

    fn get(&self, index: usize) -> Result<&Value, Fault> {
        self.record.parameters.get(index).ok_or_else(|| {
            let found = self.record.parameters.len();
            self.fault(format!("has {found} parameters, expected more"))
        })
    }

    fn wrong(&self, index: usize, expected: &str) -> Fault {
        self.fault(format!("parameter {} is not {expected}", index + 1))
    }

    pub(super) fn reference(&self, index: usize) -> Result<u64, Fault> {
        match self.get(index)? {
            Value::Reference(id) => Ok(*id),
            _ => Err(self.wrong(index, "a reference")),
        }
    }

    /// `None` for `$`.
    pub(super) fn optional_reference(&self, index: usize) -> Result<Option<u64>, Fault> {
        match self.get(index)? {
            Value::Reference(id) => Ok(Some(*id)),
            Value::Omitted | Value::Derived => Ok(None),
            _ => Err(self.wrong(index, "a reference or $")),
        }
    }

    pub(super) fn references(&self, index: usize) -> Result<Vec<u64>, Fault> {
        let Value::List(list) = self.get(index)? else {
            return Err(self.wrong(index, "a list of references"));
        };
        // Measures stand among the items of some representations.
        Ok(list
            .iter()
            .filter_map(|value| match value {
                Value::Reference(id) => Some(*id),
                _ => None,
            })
            .collect())
    }

    /// Empty for `$`.
    pub(super) fn text(&self, index: usize) -> Result<String, Fault> {
        match self.record.parameters.get(index) {
            Some(Value::Text(text)) => Ok(text.clone()),
            Some(Value::Omitted | Value::Derived) | None => Ok(String::new()),
            _ => Err(self.wrong(index, "a text")),
        }
    }

    /// `None` for `$`.
    pub(super) fn optional_number(&self, index: usize) -> Result<Option<f64>, Fault> {
        match self.record.parameters.get(index) {
            Some(Value::Number(number)) => Ok(Some(*number)),
            Some(Value::Omitted | Value::Derived) | None => Ok(None),
            Some(Value::Typed(_, inner)) => match inner.as_slice() {
                [Value::Number(number)] => Ok(Some(*number)),
                _ => Err(self.wrong(index, "a number")),
            },
            _ => Err(self.wrong(index, "a number")),
        }
    }

    /// An enumeration's name; `None` for `$`.
    pub(super) fn enumeration(&self, index: usize) -> Result<Option<String>, Fault> {
        match self.get(index)? {
            Value::Enumeration(name) => Ok(Some(name.clone())),
            Value::Omitted | Value::Derived => Ok(None),
            _ => Err(self.wrong(index, "an enumeration or $")),
        }
    }

    pub(super) fn three(&self, index: usize) -> Result<[f64; 3], Fault> {
        let Value::List(list) = self.get(index)? else {
            return Err(self.wrong(index, "a list of numbers"));
        };
        let numbers: Option<Vec<f64>> = list
            .iter()
            .map(|value| match value {
                Value::Number(number) => Some(*number),
                _ => None,
            })
            .collect();
        let numbers = numbers.ok_or_else(|| self.wrong(index, "a list of numbers"))?;
        match *numbers.as_slice() {
            [x, y, z] => Ok([x, y, z]),
            _ => {
                let found = numbers.len();
                let hint = match found {
                    4..=6 => " (decimal commas instead of points?)",
                    _ => "",
                };
                Err(self.fault(format!("has {found} coordinates, expected 3{hint}")))
            }
        }
    }
}
