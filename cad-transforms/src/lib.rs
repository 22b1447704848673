//! cad-transforms
