//! Tests of `paws` on made-up sessions, through the library and through the program.

mod importing;
mod support;
mod validating;
