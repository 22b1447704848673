//! capture-daemon
