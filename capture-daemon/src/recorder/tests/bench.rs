//! A recorder with two cameras and an IMU in virtual time, on a disk that can fail.

use super::*;

pub(super) const MS: i64 = 1_000_000;

pub(super) const START: HostTime = HostTime(1_000_000 * MS);

/// Results that a test inspects.
#[derive(Clone, Default)]
pub(super) struct Bench {
    pub(super) disks: Arc<Mutex<Vec<FaultStorage>>>,
    pub(super) progress: Arc<Mutex<Vec<Progress>>>,
    pub(super) free: Arc<Mutex<Option<u64>>>,
    pub(super) machine: Arc<Mutex<MachineReading>>,
    /// Deleting fails.
    pub(super) keeps: Arc<Mutex<bool>>,
    /// The folder of the session was removed.
    pub(super) is_removed: Arc<Mutex<bool>>,
    /// Faults of the first disk.
    pub(super) faults: Vec<Fault>,
}

impl SessionStore for Bench {
    fn create(&mut self, _: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)> {
        let disk = FaultStorage::with_faults(std::mem::take(&mut self.faults));
        let mut disks = self.disks.lock().expect("disks");
        disks.push(disk.clone());
        let path = PathBuf::from(format!("session{}", disks.len()));
        Ok((path, Arc::new(disk), format!("id{}", disks.len())))
    }

    fn discard(&mut self, _: &Path) -> io::Result<()> {
        if *self.keeps.lock().expect("keeps") {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        self.disks.lock().expect("disks").pop();
        Ok(())
    }

    fn is_there(&self, _: &Path) -> bool {
        !*self.is_removed.lock().expect("is_removed")
    }

    fn free_bytes(&self) -> Option<u64> {
        *self.free.lock().expect("free")
    }

    fn machine(&mut self, _: HostTime, _: bool) -> MachineReading {
        let mut reading = self.machine.lock().expect("machine").clone();
        reading.status.temperature_c = Some(41.5);
        reading
    }
}

/// A recorder for two cameras and an IMU, fed with synthetic samples in virtual time.
pub(super) struct Rig {
    pub(super) recorder: Recorder,
    pub(super) clock: Arc<VirtualClock>,
    pub(super) bench: Bench,
    pub(super) encoding: Encoding,
    /// Bytes in the queue to the recorder.
    pub(super) queued: Arc<AtomicU64>,
    /// Next frame numbers of both cameras.
    pub(super) next: [u64; 2],
    pub(super) next_imu: u64,
}

pub(super) const PERIOD: i64 = 50 * MS;

pub(super) fn rig(pre_roll_ns: i64, bench: Bench) -> Rig {
    let clock = Arc::new(VirtualClock::new(START, CivilTime(1_790_000_000_000 * MS)));
    let camera = |name: &str| Camera {
        name: name.to_owned(),
        width: 64,
        height: 32,
        codec: "h264".to_owned(),
        colour: "grey".to_owned(),
        rate_hz: 20.0,
        tick: TickLength::NANOSECOND,
        trigger: None,
        source: "synthetic".to_owned(),
        encoder: "none".to_owned(),
    };
    let setup = Setup {
        cameras: vec![camera("left_shoulder"), camera("feet")],
        imus: vec![Imu {
            name: "feet/imu".to_owned(),
            rate_hz: 200.0,
            tick: TickLength::NANOSECOND,
            source: "synthetic".to_owned(),
            noise: None,
        }],
        calibrations: Vec::new(),
        transforms: FrameTransforms::default(),
        rig_files: Vec::new(),
        chunk_ns: 500 * MS,
        pre_roll_ns,
        reserve_bytes: 1 << 30,
        name: "walk".to_owned(),
        software: "tests".to_owned(),
    };
    let delivered = bench.progress.clone();
    let (encoding, queued) = (Encoding::new(2), Arc::<AtomicU64>::default());
    let of_queue = queued.clone();
    let queues = Queues {
        bytes: Box::new(move || of_queue.load(Ordering::SeqCst)),
        encoding: encoding.clone(),
    };
    let recorder = Recorder::new(
        setup,
        clock.clone(),
        Box::new(bench.clone()),
        queues,
        Box::new(move |p| delivered.lock().expect("progress").push(p)),
    );
    Rig {
        recorder,
        clock,
        bench,
        encoding,
        queued,
        next: [0; 2],
        next_imu: 0,
    }
}

impl Rig {
    pub(super) fn now(&self) -> HostTime {
        self.clock.now()
    }

    /// One period: a frame of each camera (every tenth a key frame), ten IMU samples.
    pub(super) fn step(&mut self) {
        for camera in 0..2 {
            self.frame(camera);
        }
        let times: Vec<i64> = (0..10).map(|i| self.now().0 + i * 5 * MS).collect();
        let batch = ImuBatch {
            first_number: self.next_imu,
            device_ticks: times.clone(),
            host_times: times.clone(),
            times,
            gyro: vec![0.5; 30],
            accel: vec![9.8; 30],
            ..ImuBatch::default()
        };
        self.next_imu += 10;
        self.recorder.handle(Outgoing::Imu { imu: 0, batch });
        self.clock.advance_to(self.now() + PERIOD);
        self.recorder.tick();
    }

    pub(super) fn frame(&mut self, camera: usize) {
        let number = self.next[camera];
        self.next[camera] += 1;
        let time = self.now() + camera as i64 * MS;
        let frame = Frame {
            number,
            time: time.0,
            host_time: time.0,
            ..Frame::default()
        };
        let unit = Bytes::from(vec![number as u8; 100]);
        let key = number.is_multiple_of(10);
        self.recorder.handle(Outgoing::Frame {
            camera,
            frame,
            unit,
            key,
        });
    }

    pub(super) fn steps(&mut self, n: usize) {
        for _ in 0..n {
            self.step();
        }
    }

    pub(super) fn session(&self) -> SessionReader {
        let disk = self
            .bench
            .disks
            .lock()
            .expect("disks")
            .last()
            .cloned()
            .expect("a session");
        SessionReader::open(Arc::new(disk)).expect("open")
    }

    pub(super) fn messages<R: session_archive::record::Record>(&self, of: &str) -> Vec<R> {
        let reader = self.session();
        let id = reader.manifest().stream::<R>(of).expect("stream").id;
        reader
            .entries()
            .filter_map(|e| match e.expect("read") {
                Entry::Message(m) if m.stream == id => Some(m.decode().expect("decode")),
                _ => None,
            })
            .collect()
    }

    pub(super) fn health(&mut self) {
        let streams = ["left_shoulder", "feet", "feet/imu"].map(|name| StreamHealth {
            name: name.to_owned(),
            rate_hz: 20.0,
            ..StreamHealth::default()
        });
        self.recorder.handle(Outgoing::Health {
            at: self.now(),
            streams: streams.to_vec(),
        });
    }

    /// Samples stored and missing, as reported at the end.
    pub(super) fn account(&self) -> (u64, u64) {
        let reported = self.progress().into_iter().find_map(|p| match p {
            Progress::Finished {
                stored, missing, ..
            } => Some((stored, missing)),
            _ => None,
        });
        reported.expect("the session ended")
    }

    pub(super) fn progress(&self) -> Vec<Progress> {
        self.bench.progress.lock().expect("progress").clone()
    }
}

pub(super) fn started(rig: &mut Rig) {
    assert!(matches!(
        rig.recorder.request(
            Request::Start {
                name: String::new()
            },
            "button"
        ),
        Response::Ok { .. }
    ));
}
