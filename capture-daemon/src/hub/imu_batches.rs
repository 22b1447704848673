//! IMU samples through the hub: number, time, batches.

use session_archive::record::ImuBatch;
use session_archive::time::HostTime;

use super::Hub;
use super::imu_state::{MAX_BATCH_NS, flush};
use crate::sources::{ImuValues, RawImu};

/// Maximum number of samples in an IMU batch.
const MAX_BATCH_SAMPLES: usize = 512;

impl Hub {
    pub(super) fn imu(&mut self, camera: usize, raw: &RawImu, now: HostTime) {
        let Some(position) = self.cameras[camera].imu else {
            return;
        };
        let imu = &mut self.imus[position];
        imu.note_return(now, &self.out);
        let name = &imu.setup.name;
        imu.monitor.sample_arrived(now, name, &self.out);
        let number =
            imu.monitor
                .number(&mut imu.numbers, raw.number, raw.host_time, name, &self.out);
        let (ticks, mapped) = imu.clock.map(raw.device_ticks, raw.host_time, &self.out);
        // In a batch it would invalidate good samples.
        let Some(number) = number else { return };
        let n = imu.batch.times.len();
        let continues = n > 0
            && number == imu.batch.first_number + n as u64
            && mapped.map_version == imu.batch.clock_map
            && mapped.flagged == imu.batch.time_unreliable
            && n < MAX_BATCH_SAMPLES
            && raw.host_time.since(imu.batch_since) < MAX_BATCH_NS;
        if !continues {
            flush(imu, &self.out);
            imu.batch_since = raw.host_time;
            imu.batch = ImuBatch {
                first_number: number,
                clock_map: mapped.map_version,
                time_unreliable: mapped.flagged,
                gyro_scale: imu.setup.info.scale.map_or(0.0, |s| s.0),
                accel_scale: imu.setup.info.scale.map_or(0.0, |s| s.1),
                temperature_scale_c: imu.setup.info.temperature_scale_c.unwrap_or(0.0),
                ..ImuBatch::default()
            };
        }
        let batch = &mut imu.batch;
        if raw.frame_sync {
            batch.frame_sync.push(batch.times.len() as u32);
        }
        // Either all samples have a temperature or none: with holes, the list would shift values to
        // other samples.
        if imu.setup.info.temperature_scale_c.is_some() {
            batch.temperature_counts.push(raw.temperature.unwrap_or(0));
        }
        batch.device_ticks.push(ticks);
        batch.host_times.push(raw.host_time.0);
        batch.times.push(mapped.time.0);
        batch.sigma_ns = batch.sigma_ns.max(mapped.sigma_ns);
        match raw.values {
            ImuValues::Counts { gyro, accel } => {
                batch.gyro_counts.extend(gyro);
                batch.accel_counts.extend(accel);
            }
            ImuValues::Si { gyro, accel } => {
                batch.gyro.extend(gyro);
                batch.accel.extend(accel);
            }
        }
    }
}
