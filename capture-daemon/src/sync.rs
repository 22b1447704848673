//! Times of samples, frame sets, and gaps.
//!
//! Three pure parts; none of them starts a thread, reads a clock or does I/O, so each runs the same
//! in virtual time as on a person's chest:
//!
//! * [`clock`]: device ticks → host time with a sigma, from arrival times only;
//! * [`sets`]: frames of several cameras → frame sets;
//! * [`gaps`]: sequence numbers and drop reports → gap records, so that frames + gaps = expected.
//!
//! They share integer nanoseconds at every interface, memory that does not grow with the length of
//! a session, and uncertainty as a result: a time, a set or a number that is unreliable is marked,
//! never guessed silently.

pub mod clock;
pub mod gaps;
pub mod sets;
