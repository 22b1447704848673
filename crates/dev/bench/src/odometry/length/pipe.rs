//! Images from a separate rendering process, so that neither its time nor its memory counts here.

use std::io::{BufReader, BufWriter, Read as _, Write as _};
use std::process::{Child, ChildStdout, Command, Stdio};

use anyhow::{Context, Result};
use harness::sequences::{OwnedFrameSet, OwnedView, Sequence};

/// First argument of the process; the name of the walk follows.
const RENDER: &str = "--render";

/// The sets of a walk, as the other process renders them.
pub(super) struct Pipe<'a> {
    sequence: &'a Sequence,
    times: std::vec::IntoIter<i64>,
    child: Child,
    output: BufReader<ChildStdout>,
    /// Number of samples of each IMU returned so far.
    given: Vec<usize>,
}

/// Renders, if this process was started for that.
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

    /// Replaces the sets by the next ones, with the IMU samples up to them, reusing their memory.
    ///
    /// # Errors
    /// The walk is over, or the process has ended.
    pub(super) fn fill(&mut self, sets: &mut [OwnedFrameSet]) -> Result<()> {
        let count = sets.len();
        for (k, set) in sets.iter_mut().enumerate() {
            let time_ns = self.times.next();
            set.time_ns = time_ns
                .with_context(|| format!("the walk has {k} further sets, expected {count}"))?;
            self.read(set)?;
        }
        Ok(())
    }

    fn read(&mut self, set: &mut OwnedFrameSet) -> Result<()> {
        let cameras = &self.sequence.rig().cameras;
        set.views.resize(cameras.len(), None);
        for (view, camera) in set.views.iter_mut().zip(cameras) {
            let (width, height) = (camera.left.width as usize, camera.left.height as usize);
            let view = view.get_or_insert_with(|| OwnedView {
                time_ns: 0,
                width,
                height,
                left: vec![0; width * height],
                right: vec![0; width * height],
            });
            view.time_ns = set.time_ns;
            for eye in [&mut view.left, &mut view.right] {
                let read = self.output.read_exact(eye);
                read.context("reading rendered images from the other process")?;
            }
        }
        set.imu.resize(self.given.len(), Vec::new());
        let each = set.imu.iter_mut().zip(self.sequence.imu());
        for ((of_set, samples), given) in each.zip(&mut self.given) {
            let older = samples.partition_point(|s| s.time_ns < set.time_ns);
            let until = (older + 1).min(samples.len()).max(*given);
            of_set.clear();
            of_set.extend_from_slice(&samples[*given..until]);
            *given = until;
        }
        Ok(())
    }
}

impl Drop for Pipe<'_> {
    fn drop(&mut self) {
        // It may be blocked on writing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
