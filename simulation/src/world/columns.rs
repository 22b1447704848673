//! Structures of arrays, divided into rows of neighboring environments for threads.

/// Defines a structure of vectors, one value per environment, and its slices.
macro_rules! columns {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $columns:ident, $slices:ident {
            $($(#[$field_attribute:meta])* $field:ident: $type:ty = $value:expr,)*
        }
    ) => {
        $(#[$attribute])*
        $visibility struct $columns {
            $($(#[$field_attribute])* pub $field: Vec<$type>,)*
        }

        /// The same of some neighboring environments.
        pub(crate) struct $slices<'a> {
            $(pub(crate) $field: &'a mut [$type],)*
        }

        impl $columns {
            pub(crate) fn new(environments: usize) -> Self {
                Self { $($field: vec![$value; environments],)* }
            }

            pub(crate) fn slices(&mut self) -> $slices<'_> {
                $slices { $($field: &mut self.$field,)* }
            }
        }

        impl<'a> $slices<'a> {
            pub(crate) fn split_at(self, middle: usize) -> (Self, Self) {
                $(let $field = self.$field.split_at_mut(middle);)*
                (
                    Self { $($field: $field.0,)* },
                    Self { $($field: $field.1,)* },
                )
            }
        }
    };
}

pub(crate) use columns;
