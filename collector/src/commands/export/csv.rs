//! CSV tables. Times are the recorded integers (ns, host clock), measurements are in SI units with
//! full precision; a cell with a comma or a quote is quoted (RFC 4180).

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use anyhow::{Context, Result};
use console_output::{Console, Outcome};
use session_archive::reader::{Entry, Message, SessionReader};
use session_archive::record::{Event, Frame, FrameSet, Gap, ImuBatch, Record, paws};
use session_archive::text::enum_words;

use super::common::{file_name, left_out};

const FRAMES: &str = "number,time_ns,sigma_ns,host_time_ns,kernel_time_ns,device_ticks,exposure_ns,\
                      bytes,key_frame,frozen,clock_map,time_unreliable";
const IMU: &str = "number,time_ns,sigma_ns,host_time_ns,device_ticks,gyro_x_rad_s,gyro_y_rad_s,\
                   gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2,temperature_c,\
                   time_unreliable";
const EVENTS: &str = "time_ns,kind,source,text";
const GAPS: &str = "stream,first,last,samples,cause,time_before_ns,time_after_ns,detail";

/// A table that is being written.
struct Table {
    out: BufWriter<File>,
    rows: u64,
}

impl Table {
    fn create(folder: &Path, name: &str, head: &str) -> Result<Self> {
        let path = folder.join(format!("{name}.csv"));
        let file = File::create(&path).with_context(|| format!("creating {}", path.display()))?;
        let mut table = Self {
            out: BufWriter::new(file),
            rows: 0,
        };
        writeln!(table.out, "{head}")?;
        Ok(table)
    }

    fn row(&mut self, cells: &[&dyn Display]) -> Result<()> {
        for (i, cell) in cells.iter().enumerate() {
            let comma = if i == 0 { "" } else { "," };
            write!(self.out, "{comma}{cell}")?;
        }
        writeln!(self.out)?;
        self.rows += 1;
        Ok(())
    }
}

/// A cell with any text, quoted if necessary.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// A cell, empty for `None`.
fn maybe(value: Option<impl Display>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

pub(super) fn export(
    reader: &SessionReader,
    out: &Path,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let manifest = reader.manifest();
    let mut tables: BTreeMap<String, Table> = BTreeMap::new();
    let mut add = |name: &str, head: &str| -> Result<()> {
        tables.insert(name.to_owned(), Table::create(out, name, head)?);
        Ok(())
    };
    for camera in &manifest.cameras {
        add(&format!("{}_frames", file_name(&camera.name)), FRAMES)?;
    }
    for imu in &manifest.imus {
        add(&file_name(&imu.name), IMU)?;
    }
    add("events", EVENTS)?;
    add("gaps", GAPS)?;
    let cameras: Vec<&str> = manifest.cameras.iter().map(|c| c.name.as_str()).collect();
    let columns: Vec<String> = cameras
        .iter()
        .map(|c| format!("{c}_number,{c}_time_ns"))
        .collect();
    add(
        "frame_sets",
        &format!("number,time_ns,{}", columns.join(",")),
    )?;

    let mut damaged = 0_u64;
    {
        let progress = console.progress("exporting", reader.bytes()?);
        for entry in reader.entries() {
            match entry? {
                Entry::Message(m) => {
                    progress.add(m.data.len() as u64);
                    put(&mut tables, reader, &cameras, &m)?;
                }
                Entry::Damage { .. } | Entry::SegmentMissing { .. } => damaged += 1,
                Entry::SegmentEnd { .. } => {}
            }
        }
    }
    for (name, mut table) in tables {
        table.out.flush()?;
        console.line(format!("{name}.csv: {} rows", table.rows))?;
    }
    if damaged > 0 {
        console.line(left_out(damaged))?;
        return Ok(Outcome::Loss);
    }
    Ok(Outcome::Fine)
}

fn put(
    tables: &mut BTreeMap<String, Table>,
    reader: &SessionReader,
    cameras: &[&str],
    m: &Message,
) -> Result<()> {
    let Some(stream) = reader.stream(m.stream) else {
        return Ok(());
    };
    let schema = stream.schema.as_str();
    let name = match schema {
        n if n == Frame::SCHEMA.name => format!("{}_frames", file_name(&stream.of)),
        n if n == ImuBatch::SCHEMA.name => file_name(&stream.of),
        n if n == Event::SCHEMA.name => "events".to_owned(),
        n if n == Gap::SCHEMA.name => "gaps".to_owned(),
        n if n == FrameSet::SCHEMA.name => "frame_sets".to_owned(),
        _ => return Ok(()),
    };
    let Some(table) = tables.get_mut(&name) else {
        return Ok(());
    };
    if schema == Frame::SCHEMA.name {
        let Ok(f) = m.decode::<Frame>() else {
            return Ok(());
        };
        table.row(&[
            &f.number,
            &f.time,
            &f.sigma_ns,
            &f.host_time,
            &maybe(f.kernel_time),
            &f.device_ticks,
            &maybe(f.exposure_ns),
            &f.payload_bytes,
            &u8::from(f.key_frame),
            &u8::from(f.frozen),
            &f.clock_map,
            &u8::from(f.time_unreliable),
        ])
    } else if schema == ImuBatch::SCHEMA.name {
        let Ok(batch) = m.decode::<ImuBatch>() else {
            return Ok(());
        };
        let numbers = (0..).map(|k| batch.first_number.saturating_add(k));
        for (sample, number) in samples(&batch).zip(numbers) {
            let [gx, gy, gz] = sample.gyro;
            let [ax, ay, az] = sample.accel;
            table.row(&[
                &number,
                &sample.time,
                &batch.sigma_ns,
                &sample.host_time,
                &sample.device_ticks,
                &gx,
                &gy,
                &gz,
                &ax,
                &ay,
                &az,
                &maybe(sample.temperature_c),
                &u8::from(batch.time_unreliable),
            ])?;
        }
        Ok(())
    } else if schema == Event::SCHEMA.name {
        let Ok(e) = m.decode::<Event>() else {
            return Ok(());
        };
        let kind = paws::event::Kind::try_from(e.kind).unwrap_or_default();
        let kind = enum_words(kind.as_str_name(), "KIND_");
        table.row(&[&m.time.0, &kind, &quoted(&e.source), &quoted(&e.text)])
    } else if schema == Gap::SCHEMA.name {
        let Ok(g) = m.decode::<Gap>() else {
            return Ok(());
        };
        let cause = paws::gap::Cause::try_from(g.cause).unwrap_or_default();
        table.row(&[
            &quoted(&g.stream),
            &g.first,
            &g.last,
            &g.count(),
            &enum_words(cause.as_str_name(), "CAUSE_"),
            &maybe(g.time_before),
            &maybe(g.time_after),
            &quoted(&g.detail),
        ])
    } else {
        let Ok(set) = m.decode::<FrameSet>() else {
            return Ok(());
        };
        let members: Vec<String> = cameras
            .iter()
            .map(|camera| {
                let member = set.members.iter().find(|m| m.camera == *camera);
                member.map_or(",".to_owned(), |m| format!("{},{}", m.number, m.time))
            })
            .collect();
        table.row(&[&set.number, &set.time, &members.join(",")])
    }
}

/// One IMU sample in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ImuSample {
    pub(super) time: i64,
    pub(super) host_time: i64,
    pub(super) device_ticks: i64,
    /// rad/s.
    pub(super) gyro: [f64; 3],
    /// m/s².
    pub(super) accel: [f64; 3],
    pub(super) temperature_c: Option<f64>,
}

/// The samples of a batch; those without all six values are left out.
pub(super) fn samples(batch: &ImuBatch) -> impl Iterator<Item = ImuSample> + '_ {
    let vector = |counts: &[i32], scale: f64, values: &[f64], k: usize| -> Option<[f64; 3]> {
        let at = 3 * k..3 * k + 3;
        match counts.get(at.clone()) {
            Some(c) => Some([c[0], c[1], c[2]].map(|c| f64::from(c) * scale)),
            None => values.get(at).map(|v| [v[0], v[1], v[2]]),
        }
    };
    batch
        .times
        .iter()
        .enumerate()
        .filter_map(move |(k, &time)| {
            Some(ImuSample {
                time,
                host_time: *batch.host_times.get(k)?,
                device_ticks: *batch.device_ticks.get(k)?,
                gyro: vector(&batch.gyro_counts, batch.gyro_scale, &batch.gyro, k)?,
                accel: vector(&batch.accel_counts, batch.accel_scale, &batch.accel, k)?,
                temperature_c: batch
                    .temperature_counts
                    .get(k)
                    .map(|c| f64::from(*c) * batch.temperature_scale_c),
            })
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_commas_and_quotes_are_quoted() {
        assert_eq!(quoted("plain"), "plain");
        assert_eq!(quoted("a, \"b\""), "\"a, \"\"b\"\"\"");
    }

    #[test]
    fn counts_are_scaled_and_values_are_not() {
        let counts = ImuBatch {
            times: vec![1, 2],
            host_times: vec![3, 4],
            device_ticks: vec![5, 6],
            gyro_counts: vec![1, 2, 3, -4, -5, -6],
            gyro_scale: 0.5,
            accel: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
            temperature_counts: vec![2500, 2600],
            temperature_scale_c: 0.01,
            ..ImuBatch::default()
        };
        let all: Vec<ImuSample> = samples(&counts).collect();
        assert_eq!(all.len(), 2);
        assert_eq!(all[1].gyro, [-2.0, -2.5, -3.0]);
        assert_eq!(all[1].accel, [0.4, 0.5, 0.6]);
        assert_eq!((all[1].time, all[1].device_ticks), (2, 6));
        assert_eq!(all[0].temperature_c, Some(25.0));
    }
}
