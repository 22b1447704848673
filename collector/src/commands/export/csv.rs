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
use session_input::imu::{complete_samples, temperature_c};

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

/// Adds the rows of a message to its table, if it has one and can be decoded.
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
    match schema {
        n if n == Frame::SCHEMA.name => put_frame(table, m),
        n if n == ImuBatch::SCHEMA.name => put_samples(table, m),
        n if n == Event::SCHEMA.name => put_event(table, m),
        n if n == Gap::SCHEMA.name => put_gap(table, m),
        _ => put_frame_set(table, cameras, m),
    }
}

fn put_frame(table: &mut Table, m: &Message) -> Result<()> {
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
}

fn put_samples(table: &mut Table, m: &Message) -> Result<()> {
    let Ok(batch) = m.decode::<ImuBatch>() else {
        return Ok(());
    };
    for (k, sample) in complete_samples(&batch) {
        let Some(host_time) = batch.host_times.get(k) else {
            continue;
        };
        let [gx, gy, gz] = sample.gyro_rad_s;
        let [ax, ay, az] = sample.accel_m_s2;
        table.row(&[
            &sample.number,
            &sample.time_ns,
            &batch.sigma_ns,
            host_time,
            &sample.ticks,
            &gx,
            &gy,
            &gz,
            &ax,
            &ay,
            &az,
            &maybe(temperature_c(&batch, k)),
            &u8::from(batch.time_unreliable),
        ])?;
    }
    Ok(())
}

fn put_event(table: &mut Table, m: &Message) -> Result<()> {
    let Ok(e) = m.decode::<Event>() else {
        return Ok(());
    };
    let kind = paws::event::Kind::try_from(e.kind).unwrap_or_default();
    let kind = enum_words(kind.as_str_name(), "KIND_");
    table.row(&[&m.time.0, &kind, &quoted(&e.source), &quoted(&e.text)])
}

fn put_gap(table: &mut Table, m: &Message) -> Result<()> {
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
}

fn put_frame_set(table: &mut Table, cameras: &[&str], m: &Message) -> Result<()> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_with_commas_and_quotes_are_quoted() {
        assert_eq!(quoted("plain"), "plain");
        assert_eq!(quoted("a, \"b\""), "\"a, \"\"b\"\"\"");
    }
}
