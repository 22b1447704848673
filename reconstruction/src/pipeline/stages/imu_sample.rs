//! IMU samples of a session as input of the odometry.

/// The same sample.
pub(super) fn of(sample: &session_input::ImuSample) -> odometry::ImuSample {
    odometry::ImuSample {
        time_ns: sample.time_ns,
        gyro: sample.gyro_rad_s,
        accel: sample.accel_m_s2,
    }
}
