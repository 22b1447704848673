//! The configuration of the daemon.
#![allow(missing_docs)]

use std::path::PathBuf;

#[derive(Clone, Debug)]
pub struct Config {
    pub session: Session,
    pub disk: Disk,
    pub encoder: Encoder,
    pub control: Control,
    pub rig: Option<PathBuf>,
    pub cameras: Vec<Camera>,
}
#[derive(Clone, Debug)]
pub struct Session {
    pub out: Option<PathBuf>,
    pub name: String,
    pub chunk_ns: i64,
    pub pre_roll_ns: i64,
}
#[derive(Clone, Debug)]
pub struct Disk {
    pub reserve_bytes: u64,
}
#[derive(Clone, Debug)]
pub struct Encoder {
    pub element: Option<String>,
    pub quality_db: f64,
    pub threads: u32,
}
#[derive(Clone, Debug)]
pub struct Control {
    pub socket: PathBuf,
}
#[derive(Clone, Debug)]
pub struct Camera {
    pub name: String,
    pub trigger: Option<String>,
    pub calibration: Option<PathBuf>,
    pub latency_ns: i64,
    pub latency_sigma_ns: u64,
    pub imu_latency_ns: i64,
    pub imu_latency_sigma_ns: u64,
    pub source: SourceConfig,
}
#[derive(Clone, Debug)]
pub enum SourceConfig {
    Replay(ReplayConfig),
    Synthetic(SyntheticConfig),
}
#[derive(Clone, Debug)]
pub struct ReplayConfig {
    pub path: PathBuf,
    pub rate_hz: Option<f64>,
    pub repeat: bool,
    pub imu: bool,
}
#[derive(Clone, Debug)]
pub struct SyntheticConfig {
    pub width: u32,
    pub height: u32,
    pub rate_hz: f64,
    pub imu_rate_hz: f64,
    pub seed: u64,
}
