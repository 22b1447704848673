//! Tests of `paws` on synthetic sessions, through the library and through the program.

mod better_copy;
mod calibration_check;
mod catalogue;
mod command_line;
mod exporting;
mod full_disk;
mod handing;
mod hostile;
mod images;
mod importing;
mod pulling;
mod reports;
mod support;
mod validating;
mod verbs;
