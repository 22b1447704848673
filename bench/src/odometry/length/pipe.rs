//! Pictures from a process of their own, which renders them, so that neither its time nor its memory counts here.

use std::io::{BufReader, BufWriter, Read as _, Write as _};
use std::process::{Child, ChildStdout, Command, Stdio};

use anyhow::{Context, Result, ensure};
use tests::sequences::{OwnedFrameSet, OwnedView, Sequence};

/// First argument of the process; the name of the walk follows.
const RENDER: &str = "--render";

/// The sets of a walk, as the other process renders them.
pub(super) struct Pipe<'a> {
    sequence: &'a Sequence,
    times: std::vec::IntoIter<i64>,
    child: Child,
    output: BufReader<ChildStdout>,
    /// How many samples of each IMU were given.
    given: Vec<usize>,
}

/// Renders, if that is what this process is for.
pub(super) fn answer(
    args: &[String],
    sequence: impl Fn(&str) -> Result<Sequence>,
) -> Option<Result<()>> {
    let [first, name] = args else { return None };
    (first == RENDER).then(|| {
        let mut output = BufWriter::with_capacity(1 << 20, std::io::stdout().lock());
        sequence(name)?.for_each(|set| {
            for view in set.views.iter() {
                let view = view.as_ref().context("a walk without faults is whole")?;
                output.write_all(&view.left)?;
                output.write_all(&view.right)?;
            }
            Ok(())
        })?;
        Ok(output.flush()?)
    })
}

impl<'a> Pipe<'a> {
    /// Starts rendering.
    ///
    /// # Errors
    /// The process does not start.
    pub(super) fn new(name: &str, sequence: &'a Sequence) -> Result<Self> {
        let program = std::env::current_exe().context("finding this program")?;
        let mut child = Command::new(program)
            .args(["odometry_length", RENDER, name])
            .stdout(Stdio::piped())
            .spawn()
            .context("starting the process that renders")?;
        let output = child.stdout.take().context("it has an output")?;
        Ok(Self {
            sequence,
            times: sequence.times().collect::<Vec<_>>().into_iter(),
            child,
            output: BufReader::with_capacity(1 << 20, output),
            given: vec![0; sequence.imu().len()],
        })
    }

    /// The next sets, with what the IMUs measured up to them.
    ///
    /// # Errors
    /// The walk is over, or the process has ended.
    pub(super) fn take(&mut self, count: usize) -> Result<Vec<OwnedFrameSet>> {
        let sets: Vec<_> = (0..count)
            .map_while(|_| self.next())
            .collect::<Result<_>>()?;
        let found = sets.len();
        ensure!(
            found == count,
            "the walk has {found} further sets, expected {count}"
        );
        Ok(sets)
    }

    fn next(&mut self) -> Option<Result<OwnedFrameSet>> {
        let time_ns = self.times.next()?;
        Some(self.read(time_ns))
    }

    fn read(&mut self, time_ns: i64) -> Result<OwnedFrameSet> {
        let mut views = Vec::with_capacity(self.sequence.rig().cameras.len());
        for camera in &self.sequence.rig().cameras {
            let (width, height) = (camera.left.width as usize, camera.left.height as usize);
            let mut eyes = [vec![0; width * height], vec![0; width * height]];
            for eye in &mut eyes {
                let read = self.output.read_exact(eye);
                read.context("reading rendered pictures from the other process")?;
            }
            let [left, right] = eyes;
            views.push(Some(OwnedView {
                time_ns,
                width,
                height,
                left,
                right,
            }));
        }
        let mut imu = Vec::with_capacity(self.given.len());
        for (samples, given) in self.sequence.imu().iter().zip(&mut self.given) {
            let older = samples.partition_point(|s| s.time_ns < time_ns);
            let until = (older + 1).min(samples.len()).max(*given);
            imu.push(samples[*given..until].to_vec());
            *given = until;
        }
        Ok(OwnedFrameSet {
            time_ns,
            views,
            imu,
        })
    }
}

impl Drop for Pipe<'_> {
    fn drop(&mut self) {
        // It may wait for somebody to read.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
