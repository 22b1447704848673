//! Inspection of device cameras, without starting them.

use std::path::Path;

use v4l2::usb::{self, Demand};
use v4l2::{Camera, Fourcc, Mode};

use super::report::Level;
use crate::config::{Config, SourceConfig, V4l2Config, ZedImuConfig};
use crate::error_chain::with_causes;
use crate::sources::device::camera::{find_node, interval, key};

/// Remedy for an absent device.
const NOT_THERE: &str = "; plug it in, `pawsd devices` lists what is there";

/// Findings about a camera and its IMU.
pub(super) fn inspect(config: &V4l2Config) -> Vec<(Level, String)> {
    let mut findings = Vec::new();
    for config in config.eyes() {
        match find_node(&config.device, None) {
            // A daemon waits for it, and a recording would lack it.
            Err(error) => {
                findings.push((Level::Error, format!("{}{NOT_THERE}", with_causes(&error))));
            }
            Ok(path) => camera(&config, &path, &mut findings),
        }
    }
    if let Some(right) = &config.right {
        findings.push((
            Level::Warning,
            format!(
                "two devices without a common trigger: images within {:.1} ms of each other are paired, the others are \
                 gaps; `paws validate` reports their time differences",
                right.within_ns as f64 * 1e-6
            ),
        ));
    }
    if let Some(config) = &config.imu {
        findings.push(imu(config));
    }
    findings
}

fn camera(config: &V4l2Config, path: &Path, findings: &mut Vec<(Level, String)>) {
    let camera = match Camera::open(path) {
        Ok(camera) => camera,
        Err(error) => {
            let hint = match error.is_gone() || !path.exists() {
                true => NOT_THERE,
                false => "",
            };
            return findings.push((Level::Error, format!("{}{hint}", with_causes(&error))));
        }
    };
    let configured = mode(config);
    match camera.modes() {
        Err(error) => findings.push((Level::Error, with_causes(&error))),
        Ok(modes) if modes.iter().any(|m| m.offers(&configured)) => findings.push((
            Level::Ok,
            format!(
                "{} offers {configured}: {}",
                camera.capability().card,
                path.display()
            ),
        )),
        // Some drivers scale to more sizes than they list, so only the start can decide.
        Ok(_) => findings.push((
            Level::Warning,
            format!(
                "{} does not list {configured}; `pawsd devices` shows what it does: {}",
                camera.capability().card,
                path.display()
            ),
        )),
    }
    match camera.controls() {
        Err(error) => findings.push((Level::Error, with_causes(&error))),
        Ok(known) => {
            for (name, _) in &config.controls {
                if !known.iter().any(|control| key(&control.name) == *name) {
                    let names: Vec<String> = known.iter().map(|c| key(&c.name)).collect();
                    let text = format!(
                        "no control is called {name}; there are {}",
                        names.join(", ")
                    );
                    findings.push((Level::Error, text));
                }
            }
        }
    }
}

fn imu(config: &ZedImuConfig) -> (Level, String) {
    let fits = |serial: &Option<String>| config.serial.is_none() || *serial == config.serial;
    match zed::imu::list() {
        Err(error) => (Level::Error, with_causes(&error)),
        Ok(found) => match found.iter().filter(|f| fits(&f.serial)).collect::<Vec<_>>()[..] {
            [] => (Level::Error, format!("its IMU is not there{NOT_THERE}")),
            [one] => (Level::Ok, format!("its IMU is {}", one.path)),
            [..] => (
                Level::Error,
                "there are several ZED IMUs, expected imu_serial in the configuration to say which"
                    .to_owned(),
            ),
        },
    }
}

/// Whether the cameras fit on their USB controllers.
pub(super) fn usb_budget(config: &Config) -> Vec<(Level, String)> {
    let loads = usb::check(&demands(config));
    let finding = |load: &usb::Load| {
        let level = if load.fits() { Level::Ok } else { Level::Error };
        (level, load.to_string())
    };
    loads.iter().map(finding).collect()
}

/// USB bandwidth of the configured cameras that are connected.
pub(crate) fn demands(config: &Config) -> Vec<Demand> {
    let nodes = v4l2::node::list(Path::new("/sys"), Path::new("/dev")).unwrap_or_default();
    let of = |(camera, config): (&crate::config::Camera, V4l2Config)| {
        let path = find_node(&config.device, None).ok()?;
        let path = path.canonicalize().ok()?;
        let device = nodes.iter().find(|node| node.path == path)?.usb.clone()?;
        let mode = mode(&config);
        let bits = u64::from(mode.fourcc.bits_per_pixel()?);
        let image = u64::from(mode.width) * u64::from(mode.height) * bits / 8;
        Some(Demand {
            camera: camera.name.clone(),
            mode: mode.to_string(),
            needs: usb::budget::bytes_per_second(image, mode.interval)?,
            device,
        })
    };
    let cameras = config.cameras.iter().flat_map(|camera| {
        let eyes = match &camera.source {
            SourceConfig::V4l2(config) => config.eyes(),
            _ => Vec::new(),
        };
        eyes.into_iter().map(move |eye| (camera, eye))
    });
    cameras.filter_map(of).collect()
}

fn mode(config: &V4l2Config) -> Mode {
    Mode {
        fourcc: Fourcc(config.format.fourcc()),
        width: config.width,
        height: config.height,
        interval: interval(config.rate_hz),
    }
}
