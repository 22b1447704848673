//! Contract 3: reconstruction results with their provenance.
//!
//! A bundle is a folder: a manifest, and one folder for each output of a stage. `FORMAT.md` beside
//! this crate is the contract; the crate is its writer ([`Bundle`]), reader ([`Scene`]) and
//! verifier, and exports to other formats. It knows nothing of how anything was reconstructed, nor
//! of sessions or the catalogue.

pub mod bundle;
pub mod draft;
pub mod error;
pub mod export;
pub mod formats;
pub mod judgement;
pub mod layout;
pub mod manifest;
pub mod outputs;
pub mod scene;
pub mod trajectory;
pub mod verify;

mod error_chain;
mod npy;
mod storage;

pub use bundle::Bundle;
pub use draft::{Draft, DraftFile};
pub use error::BundleError;
pub use error_chain::error_chain;
pub use formats::FormatError;
pub use judgement::Judgement;
pub use manifest::{Manifest, Output, Provenance, Record, RigRevision};
pub use scene::{OutputReader, Scene};
pub use trajectory::{Pose, Span, Status, Trajectory, TrajectoryError};
