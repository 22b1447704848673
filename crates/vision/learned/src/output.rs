//! Output tensor of a network.

use ort::value::{DynValue, TensorElementType};

/// Shape and values of an output, row-major.
#[derive(Clone, Debug)]
pub(crate) struct Output {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Values,
}

/// Values by type.
#[derive(Clone, Debug)]
pub(crate) enum Values {
    /// Disparities or scores.
    Float(Vec<f32>),
    /// Class numbers.
    Integer(Vec<i64>),
}

impl Output {
    /// Whether outputs of this type are read as class numbers.
    pub(crate) fn is_integer(kind: TensorElementType) -> bool {
        use TensorElementType::{Int32, Int64, Uint8};
        matches!(kind, Uint8 | Int32 | Int64)
    }

    /// # Errors
    /// The error of ONNX Runtime, if the value is not a tensor of a supported type.
    pub(crate) fn new(tensor: &DynValue) -> ort::Result<Self> {
        let kind = tensor.dtype().tensor_type();
        let (shape, values) = match kind {
            Some(TensorElementType::Uint8) => {
                let (shape, values) = tensor.try_extract_tensor::<u8>()?;
                (shape, integers(values))
            }
            Some(TensorElementType::Int32) => {
                let (shape, values) = tensor.try_extract_tensor::<i32>()?;
                (shape, integers(values))
            }
            Some(TensorElementType::Int64) => {
                let (shape, values) = tensor.try_extract_tensor::<i64>()?;
                (shape, integers(values))
            }
            _ => {
                let (shape, values) = tensor.try_extract_tensor::<f32>()?;
                (shape, Values::Float(values.to_vec()))
            }
        };
        Ok(Self {
            shape: shape.iter().map(|length| *length as usize).collect(),
            values,
        })
    }
}

fn integers<T: Copy + Into<i64>>(values: &[T]) -> Values {
    Values::Integer(values.iter().map(|value| (*value).into()).collect())
}
