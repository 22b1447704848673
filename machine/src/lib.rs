//! What the machine says of itself: heat, power, disk, clocks; and what to do when it gets tight.
