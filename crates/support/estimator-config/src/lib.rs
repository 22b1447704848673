//! Tables of tuned constants.
//!
//! An estimator has one `Config`, a struct of small structs, one per concern. Each field states
//! what it does, its unit, where its value comes from, and what happens when it is wrong.
//! [`config!`] keeps the value beside these lines, and makes the struct readable and printable
//! through serde, so that the whole of it can be stored with a result and changed for an
//! experiment.
//!
//! Physical constants, array sizes and layouts on disk are not tuned and remain constants. Pixels
//! are pixels of the image as given, at any resolution: the accuracy of matching is a fraction of a
//! pixel whatever its angle. What depends on the view is an angle or a fraction of the image width.

#[doc(hidden)]
pub use serde;

/// Defines structs of tuned constants with their default values.
///
/// ```
/// estimator_config::config! {
///     /// How corners are tracked.
///     pub struct KltConfig {
///         /// Maximum number of iterations per pyramid level. Source: a published default. Lower
///         /// loses fast motion, higher costs time.
///         pub max_iterations: usize = 10,
///         /// Minimum normalized cross-correlation of the two patches, 0 to 1. Lower lets
///         /// mismatches through, higher loses corners that change their appearance.
///         pub min_ncc: f32 = 0.8,
///     }
/// }
///
/// assert_eq!(KltConfig::default().max_iterations, 10);
/// // An experiment names what it changes; a name that does not exist is an error.
/// let changed: KltConfig = toml::from_str("min_ncc = 0.7").unwrap();
/// assert_eq!((changed.max_iterations, changed.min_ncc), (10, 0.7));
/// assert!(toml::from_str::<KltConfig>("min_nnc = 0.7").is_err());
/// ```
#[macro_export]
macro_rules! config {
    ($(
        $(#[$struct_attribute:meta])*
        $visibility:vis struct $name:ident {
            $($(#[$field_attribute:meta])* pub $field:ident: $type:ty = $value:expr,)*
        }
    )*) => {$(
        $(#[$struct_attribute])*
        #[derive(Clone, Copy, Debug, PartialEq, $crate::serde::Serialize, $crate::serde::Deserialize)]
        #[serde(crate = "estimator_config::serde", default, deny_unknown_fields)]
        #[non_exhaustive]
        $visibility struct $name {
            $(
                $(#[$field_attribute])*
                #[doc = concat!("\n\nDefault: `", stringify!($value), "`.")]
                pub $field: $type,
            )*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $value,)* }
            }
        }
    )*};
}
