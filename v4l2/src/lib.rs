//! V4L2 cameras by the kernel's own interface, and what USB allows.
