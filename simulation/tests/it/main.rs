//! The program `paws-sim` on a bundle of a synthetic room, and worlds in several processes.

mod bundle;
mod film;
mod import;
mod processes;
mod view;
