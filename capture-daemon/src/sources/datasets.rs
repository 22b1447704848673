//! Recorded data sets as lists of stereo frames and IMU samples.
