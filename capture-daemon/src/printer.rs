//! Output of lines to a terminal or a pipe that may have no reader.
//!
//! Contract: printing never blocks, because a recording must not. A thread prints the lines in
//! order, each immediately. *Without a reader* up to [`CAPACITY_BYTES`] bytes are queued, half as
//! much for routine lines; further lines are discarded, but never the final line. *Foreign names*
//! cannot act on the terminal: control characters are printed as `\u001b`. *When writing fails* (a
//! closed pipe) the lines are discarded. *At the end* [`Printer::finish`] waits until all is
//! printed.

use std::io::{self, Write};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::Context as _;
use capture_daemon::queue::{PopResult, Queue};
use session_archive::text::Screen;

/// Capacity of the queue, bytes.
const CAPACITY_BYTES: usize = 1 << 20;

/// Importance of a line when there is no reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Priority {
    /// A similar line follows soon.
    Routine,
    /// An event.
    Event,
    /// The result, printed once.
    Final,
}

/// Input of a printer; clones belong to the same printer.
#[derive(Clone)]
pub(crate) struct Lines(Arc<Queue<Vec<u8>>>);

/// Prints lines on a thread of its own.
pub(crate) struct Printer {
    lines: Lines,
    thread: JoinHandle<()>,
}

impl Printer {
    /// A printer to `out`.
    ///
    /// # Errors
    /// The system provides no thread.
    pub(crate) fn start(out: impl Write + Send + 'static) -> anyhow::Result<Self> {
        let mut out = Screen(out);
        let lines = Lines(Arc::new(Queue::new(CAPACITY_BYTES)));
        let queue = lines.0.clone();
        let print = move || {
            loop {
                match queue.pop(Duration::from_secs(60)) {
                    PopResult::Item(line) => {
                        let _ = out.write_all(&line).and_then(|()| out.flush());
                    }
                    PopResult::Nothing => {}
                    PopResult::Closed => break,
                }
            }
        };
        let thread = std::thread::Builder::new()
            .name("printer".into())
            .spawn(print)
            .context("starting the thread that prints")?;
        Ok(Self { lines, thread })
    }

    /// Input for lines.
    pub(crate) fn lines(&self) -> Lines {
        self.lines.clone()
    }

    /// Waits until everything is printed; later lines are discarded.
    pub(crate) fn finish(self) {
        self.lines.0.close();
        let _ = self.thread.join();
    }
}

impl Lines {
    /// Prints a line, given without its line break.
    pub(crate) fn print_line(&self, line: &str, priority: Priority) {
        self.put(format!("{line}\n").into_bytes(), priority);
    }

    fn put(&self, bytes: Vec<u8>, priority: Priority) {
        let len = bytes.len();
        // Rejected: there is no reader, or the printer has finished.
        let _ = match priority {
            Priority::Routine if self.0.bytes() > CAPACITY_BYTES / 2 => return,
            Priority::Routine | Priority::Event => self.0.try_push(bytes, len),
            // With size zero it always fits.
            Priority::Final => self.0.push_reserved(bytes, 0),
        };
    }
}

/// For a logger, which writes whole lines.
impl Write for Lines {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.put(bytes.to_vec(), Priority::Event);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::mpsc::{Receiver, sync_channel};

    use super::*;

    /// Blocks until its channel is closed.
    struct Unread(Receiver<()>, Arc<Mutex<Vec<u8>>>);

    impl Write for Unread {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let _ = self.0.recv();
            self.1.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn printing_never_waits_and_event_and_final_lines_outlast_routine_ones() {
        let (read, unread) = sync_channel(0);
        let printed = Arc::default();
        let printer = Printer::start(Unread(unread, Arc::clone(&printed))).unwrap();
        let lines = printer.lines();
        for _ in 0..CAPACITY_BYTES {
            lines.print_line("routine", Priority::Routine);
        }
        lines.print_line("alarm", Priority::Event);
        for _ in 0..CAPACITY_BYTES {
            lines.print_line("flapping", Priority::Event);
        }
        lines.print_line("finished", Priority::Final);
        drop(read);
        printer.finish();
        let text = String::from_utf8(printed.lock().unwrap().clone()).unwrap();
        assert!(text.len() < CAPACITY_BYTES + 100, "{} bytes", text.len());
        assert!(text.contains("\nalarm\n"));
        assert!(text.ends_with("flapping\nfinished\n"));
    }

    #[test]
    fn control_characters_are_escaped_in_printed_lines() {
        let (read, unread) = sync_channel(0);
        drop(read);
        let printed = Arc::default();
        let printer = Printer::start(Unread(unread, Arc::clone(&printed))).unwrap();
        let mut lines = printer.lines();
        lines.print_line("recording: /data/a\u{1b}[2J", Priority::Event);
        writeln!(lines, "a log line\u{9b}2J").unwrap();
        printer.finish();
        let text = String::from_utf8(printed.lock().unwrap().clone()).unwrap();
        assert_eq!(text, "recording: /data/a\\u001b[2J\na log line\\u009b2J\n");
    }
}
