//! Small networks as ONNX files, written by hand.
//!
//! Only the parts of the format that the tests need: field numbers as in `onnx.proto`
//! (https://github.com/onnx/onnx), wire types 0 (varint), 2 (bytes with their length) and 5 (32
//! bits) of protocol buffers.

use std::path::{Path, PathBuf};

/// Element type numbers, `TensorProto.DataType`.
pub(crate) const F32: u64 = 1;
pub(crate) const U8: u64 = 2;
pub(crate) const I64: u64 = 7;

/// An encoded message.
#[derive(Clone, Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn number(mut self, field: u64, value: i64) -> Self {
        self.varint(field << 3);
        self.varint(value as u64);
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn real(mut self, field: u64, value: f32) -> Self {
        self.varint(field << 3 | 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn message(self, field: u64, message: &Self) -> Self {
        self.bytes(field, &message.0)
    }

    fn numbers(self, field: u64, values: &[i64]) -> Self {
        values.iter().fold(self, |m, v| m.number(field, *v))
    }
}

/// An attribute of a node.
pub(crate) enum Attribute<'a> {
    Number(&'a str, i64),
    Values(&'a str, &'a [i64]),
    Text(&'a str, &'a str),
}

impl Attribute<'_> {
    /// `AttributeProto`.
    fn message(&self) -> Message {
        let named = |name: &str, kind| {
            Message::default()
                .bytes(1, name.as_bytes())
                .number(20, kind)
        };
        match self {
            Self::Number(name, value) => named(name, 2).number(3, *value),
            Self::Values(name, values) => named(name, 7).numbers(8, values),
            Self::Text(name, text) => named(name, 3).bytes(4, text.as_bytes()),
        }
    }
}

/// Graph builder.
#[derive(Clone, Default)]
pub(crate) struct Graph(Message);

impl Graph {
    /// Adds an input tensor; -1 is a dynamic length.
    pub(crate) fn input(self, name: &str, kind: u64, lengths: &[i64]) -> Self {
        Self(self.0.message(11, &value_info(name, kind, lengths)))
    }

    /// Adds an output tensor.
    pub(crate) fn output(self, name: &str, kind: u64, lengths: &[i64]) -> Self {
        Self(self.0.message(12, &value_info(name, kind, lengths)))
    }

    /// Adds a constant list of integers.
    pub(crate) fn numbers(self, name: &str, values: &[i64]) -> Self {
        let tensor = Message::default()
            .number(1, values.len() as i64)
            .number(2, I64 as i64)
            .numbers(7, values)
            .bytes(8, name.as_bytes());
        Self(self.0.message(5, &tensor))
    }

    /// Adds a constant scalar.
    pub(crate) fn real(self, name: &str, value: f32) -> Self {
        let tensor = Message::default()
            .number(2, F32 as i64)
            .real(4, value)
            .bytes(8, name.as_bytes());
        Self(self.0.message(5, &tensor))
    }

    /// Adds the node `output = operator(inputs)`.
    pub(crate) fn node(
        self,
        operator: &str,
        inputs: &[&str],
        output: &str,
        attributes: &[Attribute<'_>],
    ) -> Self {
        let node = inputs
            .iter()
            .fold(Message::default(), |m, input| m.bytes(1, input.as_bytes()))
            .bytes(2, output.as_bytes())
            .bytes(4, operator.as_bytes());
        let node = attributes
            .iter()
            .fold(node, |m, a| m.message(5, &a.message()));
        Self(self.0.message(1, &node))
    }

    /// Writes the model file, with operator set version 13.
    pub(crate) fn write(self, folder: &Path, name: &str) -> PathBuf {
        let operators = Message::default().bytes(1, b"").number(2, 13);
        let model = Message::default()
            .number(1, 7)
            .message(7, &Self(self.0.bytes(2, b"test")).0)
            .message(8, &operators);
        let path = folder.join(name);
        std::fs::write(&path, model.0).unwrap();
        path
    }
}

/// `ValueInfoProto`.
fn value_info(name: &str, kind: u64, lengths: &[i64]) -> Message {
    let shape = lengths.iter().fold(Message::default(), |m, length| {
        let known = *length >= 0;
        let dimension = Message::default();
        m.message(
            1,
            &if known {
                dimension.number(1, *length)
            } else {
                dimension
            },
        )
    });
    let tensor = Message::default().number(1, kind as i64).message(2, &shape);
    let kind = Message::default().message(1, &tensor);
    Message::default()
        .bytes(1, name.as_bytes())
        .message(2, &kind)
}
