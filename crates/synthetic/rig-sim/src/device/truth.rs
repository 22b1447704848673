//! Ground truth of a device's frames, as files that a recording can include.

use std::fmt::Write as _;

use super::{Device, Stream};
use crate::render::{contacts, foot_poses, terrain};
use crate::simulation::seconds;

impl Device {
    /// Names and contents of the files. Times are relative to `begin_ns`, the beginning of the walk
    /// on the clock of the recording:
    ///
    /// * `truth.CAMERA.csv`: every frame of the walk, including lost ones: device clock in the
    ///   middle of the exposure (empty while the device is disconnected), true time, and
    ///   `world_from_rig` then (position in m, quaternion);
    /// * `truth.contacts.csv`: times and poses of foot contacts with the ground;
    ///   `truth.foot-poses.csv`: poses of both soles at 200 Hz; `truth.soles.csv`: their outline;
    ///   `truth.planes.csv`, `truth.step-edges.csv`: planes and step edges of the terrain; the same
    ///   for all cameras.
    pub fn truth(&self, begin_ns: i64) -> Vec<(String, String)> {
        let simulation = &*self.simulation;
        let settings = simulation.settings();
        let mut text =
            "#device_ticks,time [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n"
                .to_owned();
        for index in 0..settings.frame_count() {
            let taken_ns = settings.frame_ns(index);
            let epoch = self.disconnects.epoch(taken_ns);
            let ticks = epoch.map(|epoch| self.ticks(Stream::Frames, epoch, taken_ns));
            let ticks = ticks.map_or(String::new(), |ticks| ticks.to_string());
            // The reported frame time may have an offset.
            let taken_ns = taken_ns - simulation.cameras()[self.camera].time_offset_ns;
            let rig = simulation.walker().rig(seconds(taken_ns));
            let (p, q) = (rig.position, rig.rotation);
            // Writing to a string does not fail.
            let _ = writeln!(
                text,
                "{ticks},{},{},{},{},{},{},{},{}",
                begin_ns + taken_ns,
                p.x,
                p.y,
                p.z,
                q.w,
                q.i,
                q.j,
                q.k
            );
        }
        let name = &simulation.cameras()[self.camera].name;
        let mut common = vec![
            ("contacts", contacts(simulation, begin_ns)),
            ("foot-poses", foot_poses(simulation, begin_ns)),
            ("soles", terrain::soles()),
        ];
        if simulation.plan().is_none() {
            let scene = simulation.scene();
            common.push(("planes", terrain::planes(&scene.planes())));
            common.push(("step-edges", terrain::step_edges(&scene.step_edges())));
        }
        let common = common.into_iter();
        let common = common.map(|(name, text)| (format!("truth.{name}.csv"), text));
        let mut files = vec![(format!("truth.{name}.csv"), text)];
        files.extend(common);
        files
    }
}
