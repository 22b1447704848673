//! Times of samples, frame sets, and gaps.
//!
//! Pure parts; none of them starts a thread, reads a clock or does I/O, so each runs the same
//! in virtual time as on a person's chest:
//!
//! * [`clock`]: device ticks → host time with a sigma, from arrival times only;
//! * [`sets`]: frames of several cameras → frame sets;
//! * [`renumber`]: a device's counter → increasing numbers;
//! * [`sequence_tracker`]: numbers and drop reports → gaps, so that frames + gaps = expected. The
//!   recorder writes them (`recorder/gap_records.rs`).
//!
//! They share integer nanoseconds at every interface, memory that does not grow with the length of
//! a session, and uncertainty as a result: a time, a set or a number that is unreliable is marked,
//! never guessed silently.

pub mod clock;
pub mod renumber;
pub mod sequence_tracker;
pub mod sets;
