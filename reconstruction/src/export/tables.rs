//! Tables: frame sets, IMU samples, calibration.

use std::fs;
use std::path::Path;

use session_archive::time::HostTime;

use super::calibration;
use super::error::{ExportError, writing};
use super::selection::Selection;
use super::summary::Summary;
use super::text::Text;
use crate::input::Input;

/// Writes everything except images; fills the summary except for cameras.
pub(super) fn write(
    input: &Input,
    folder: &Path,
    selection: &Selection,
) -> Result<Summary, ExportError> {
    let mut summary = Summary::default();
    let mut lens = Text::create(folder.join("calibration.json"))?;
    lens.line(format_args!("{:#}", calibration::json(input)))?;
    lens.finish()?;

    let mut sets = Text::create(folder.join("sets.csv"))?;
    let index = input.index();
    let names = index.cameras.iter().map(|c| format!(",{}", c.name));
    sets.line(format_args!("set,time_ns{}", names.collect::<String>()))?;
    for set in &index.sets {
        let counted = set.number.is_multiple_of(selection.every.get());
        if counted && selection.holds(input, HostTime(set.time_ns)) {
            let members = set
                .frames
                .iter()
                .zip(&index.cameras)
                .map(|(member, camera)| {
                    let number = |position: u32| camera.frames[position as usize].number;
                    member.map_or(",".to_owned(), |position| format!(",{}", number(position)))
                });
            let members: String = members.collect();
            sets.line(format_args!("{},{}{members}", set.number, set.time_ns))?;
            summary.sets += 1;
        }
    }
    sets.finish()?;

    for imu in &input.manifest().imus {
        let path = folder.join(format!("imu/{}.csv", imu.name));
        let parent = path.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(writing(parent))?;
        let mut text = Text::create(path)?;
        text.line(format_args!(
            "number,ticks,time_ns,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,\
             accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,time_unreliable"
        ))?;
        let mut written = 0;
        for batch in input.session().imu_batches(&imu.name)? {
            let samples = batch.unwrap_or_else(|error| {
                summary.lost.push(scene_bundle::error_chain(&error));
                Vec::new()
            });
            for s in samples
                .iter()
                .filter(|s| selection.holds(input, HostTime(s.time_ns)))
            {
                let ([gx, gy, gz], [ax, ay, az]) = (s.gyro_rad_s, s.accel_m_s2);
                let (number, ticks, time) = (s.number, s.ticks, s.time_ns);
                let unreliable = u8::from(s.time_unreliable);
                text.line(format_args!(
                    "{number},{ticks},{time},{gx},{gy},{gz},{ax},{ay},{az},{unreliable}"
                ))?;
                written += 1;
            }
        }
        text.finish()?;
        summary.imus.push((imu.name.clone(), written));
    }
    Ok(summary)
}
