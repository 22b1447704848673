//! The verbs of `paws-sim`, one module each.

pub(crate) mod film;
pub(crate) mod import;
pub(crate) mod info;
pub(crate) mod view;
mod walk;
