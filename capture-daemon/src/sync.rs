//! When things happened, what belongs together, and what is missing.
//!
//! Three pure parts; none of them starts a thread, reads a clock or does I/O, so each runs the
//! same on virtual time as on a person's chest:
//!
//! * [`clock`]: device ticks → host time with a sigma, from nothing but arrival times;
//! * [`sets`]: frames of several cameras → frame sets;
//! * [`gaps`]: sequence numbers and drop reports → gap records, so that frames + gaps = expected.
//!
//! What they share: integer nanoseconds at every border, memory that does not grow with the
//! length of a session, and doubt as a result. A time, a set or a number that cannot be vouched
//! for is marked, never guessed in silence.

pub mod clock;
pub mod gaps;
pub mod sets;
