//! The program `paws-sim` on a bundle of a synthetic room.

mod bundle;
mod film;
mod view;
