//! The way to the rig: the phone's page, pulling sessions, TLS, both ends.
