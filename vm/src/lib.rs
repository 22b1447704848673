//! Tests on real kernel drivers: virtual machines with cameras, an IMU, a button and faulty disks.
