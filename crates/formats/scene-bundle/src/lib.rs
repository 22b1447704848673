//! Contract 3: reconstruction results with their provenance.
//!
//! A bundle is a folder: a manifest, and one folder for each output of a stage. `FORMAT.md` beside
//! this crate is the contract; the crate is its writer ([`Bundle`]), reader ([`Scene`]) and
//! verifier, and exports to other formats. It knows nothing of how anything was reconstructed, nor
//! of sessions or the catalogue.
//!
//! Writing an output, and reading it back with every byte checked:
//!
//! ```
//! use scene_bundle::{Bundle, Record, Scene};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("walk.scene");
//! # let provenance = scene_bundle::Provenance {
//! #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
//! #     handoff_blake3: "ab".repeat(32),
//! #     judgement: None,
//! #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
//! #     program: "example".to_owned(),
//! #     program_version: "1.0".to_owned(),
//! #     started_civil_ns: 1_790_000_000_000_000_000,
//! #     ended_civil_ns: None,
//! # };
//! let bundle = Bundle::create_or_open(&path, provenance)?;
//! let draft = bundle.begin("notes")?;
//! draft.write("notes.txt", b"stairs from 14:05 on\n")?;
//! draft.commit(Record {
//!     stage: "example".to_owned(),
//!     stage_version: 1,
//!     settings: serde_json::json!({}),
//!     inputs: Default::default(),
//! })?;
//! bundle.finish(1_790_000_009_000_000_000)?;
//!
//! let scene = Scene::open(&path)?;
//! let notes = scene.output("notes")?;
//! assert_eq!(notes.read("notes.txt")?, b"stairs from 14:05 on\n");
//! assert_eq!(scene.manifest().provenance.rig.revision, "B");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod bundle;
pub mod draft;
pub mod error;
pub mod export;
pub mod film;
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
