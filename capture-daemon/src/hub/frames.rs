//! Frames through the hub: number, time, frozen images, and what is not encoded.

use session_archive::record::Frame;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};

use super::Hub;
use super::load_shedding::Step;
use super::outgoing::Outgoing;
use crate::sources::{DroppedFrame, FrameArrival, Pixels, RawFrame};

impl Hub {
    /// Handles a frame that nobody stores: the clock map learns from its time, and its number is
    /// counted.
    pub(super) fn frame_arrival(
        &mut self,
        position: usize,
        frame_arrival: &FrameArrival,
        now: HostTime,
    ) {
        let camera = &mut self.cameras[position];
        camera.note_return(now, &self.out);
        let name = &camera.setup.name;
        camera.monitor.sample_arrived(now, name, &self.out);
        let numbers = &mut camera.numbers;
        let at = frame_arrival.host_time;
        let _ = camera
            .monitor
            .number(numbers, frame_arrival.number, at, name, &self.out);
        let _ = camera.clock.map(frame_arrival.device_ticks, at, &self.out);
    }

    pub(super) fn frame<P: Pixels>(&mut self, position: usize, raw: RawFrame<P>, now: HostTime) {
        let camera = &mut self.cameras[position];
        camera.note_return(now, &self.out);
        let name = &camera.setup.name;
        camera.monitor.sample_arrived(now, name, &self.out);
        let number = camera.monitor.number(
            &mut camera.numbers,
            raw.number,
            raw.host_time,
            name,
            &self.out,
        );
        let digest = raw.image.digest();
        let is_same = digest.is_some() && camera.digest == digest;
        camera.digest = digest;
        let frozen = is_same && !camera.setup.still;
        camera.note_frozen(frozen, raw.host_time, &self.out);
        let (ticks, mapped) = camera.clock.map(raw.device_ticks, raw.host_time, &self.out);
        // The recorder could not store it, and the frames encoded after it would refer to it.
        let Some(number) = number else { return };
        if let Some(previews) = &self.previews {
            previews.offer(
                position,
                raw.image.preview_pixels(),
                now,
                self.mitigations.lower_preview,
            );
        }
        if self.is_idle || raw.host_time < self.storing_since {
            return;
        }
        if let Some(detail) = self.rate_lowered(position)
            && !self.is_kept(position, mapped.time)
        {
            return (self.out)(Outgoing::Dropped {
                at: mapped.time,
                stream: self.cameras[position].setup.name.clone(),
                first: number,
                last: number,
                cause: Cause::LoadShed,
                detail: detail.to_owned(),
            });
        }
        let camera = &mut self.cameras[position];
        let frame = Frame {
            number,
            device_ticks: ticks,
            kernel_time: raw.kernel_time.map(|t| t.0),
            host_time: raw.host_time.0,
            time: mapped.time.0,
            sigma_ns: mapped.sigma_ns,
            exposure_ns: raw.exposure_ns,
            eyes_apart_ns: raw.eyes_apart_ns,
            clock_map: mapped.map_version,
            frozen,
            time_unreliable: mapped.flagged,
            ..Frame::default()
        };
        self.encoding.begin(position);
        if self.waits {
            camera.encoder.push_and_wait(frame, raw.image.input(), now);
        } else {
            camera.encoder.push(frame, raw.image.input(), now);
        }
    }

    /// Handles a frame that arrived and is unusable.
    pub(super) fn unusable_frame(
        &mut self,
        camera: usize,
        unusable_frame: DroppedFrame,
        now: HostTime,
    ) {
        let DroppedFrame {
            number,
            host_time: at,
            cause,
            detail,
        } = unusable_frame;
        let camera = &mut self.cameras[camera];
        camera.note_return(now, &self.out);
        let name = &camera.setup.name;
        camera.monitor.sample_arrived(now, name, &self.out);
        let Some(number) = camera
            .monitor
            .number(&mut camera.numbers, number, at, name, &self.out)
        else {
            return;
        };
        (self.out)(Outgoing::Dropped {
            at,
            stream: name.clone(),
            first: number,
            last: number,
            cause,
            detail,
        });
    }

    /// Reason why every other frame of this camera is dropped, if there is one.
    pub(super) fn rate_lowered(&self, camera: usize) -> Option<&'static str> {
        let is_last = camera + 1 == self.cameras.len();
        if self.mitigations.lower_frame_rate {
            Some("every other frame is dropped to reduce the load on the machine")
        } else if self.load_shedder.has(Step::AllRates)
            || (is_last && self.load_shedder.has(Step::OneRate))
        {
            Some("every other frame is dropped: the machine is too slow to encode all of them")
        } else {
            None
        }
    }

    /// Whether this frame is encoded while every other frame is dropped.
    pub(super) fn is_kept(&mut self, camera: usize, time: HostTime) -> bool {
        let camera = &self.cameras[camera];
        let period_ns = (NS_PER_S as f64 / camera.setup.rate_hz.max(0.001)) as i64;
        let first = camera.together_with;
        self.cameras[first].decimator.is_kept(time, period_ns)
    }
}
